//! What a person has to check of a table as a whole.

use std::path::Path;

use super::choice::proposed;
use super::series::{captures, steps};
use super::table::{Samples, counts_captures, names_signals};
use super::time::rate_in;
use super::{LOOKED_AT, Proposal, TableColumn, joint_of, shown};
use crate::signals::column_name::{ColumnName, Quantity};
use crate::signals::mapping::{Delimiter, Signal};
use crate::signals::text_layout::TextLayout;
use crate::signals::text_lines::Splitter;

impl Proposal {
    /// A column that is called a time and does not rise from row to row is one all the same: what
    /// is wrong with it is for a person to see.
    pub(super) fn take_a_time_that_does_not_rise(&mut self, samples: &[Samples]) {
        if self.signals.iter().any(|found| found.signal == Signal::Time) {
            return;
        }
        let is_time = |column: &&mut TableColumn| {
            column.signal.is_none()
                && samples[column.number - 1].has_values()
                && ColumnName::of(&column.name).quantity == Some(Quantity::Time)
        };
        let Some(column) = self.columns.iter_mut().find(is_time) else { return };
        column.signal = Some(Signal::Time);
        let values = &samples[column.number - 1].values;
        let mut found = proposed(Signal::Time, column, &samples[column.number - 1], joint_of(&[]));
        let falling = steps(values).filter(|step| *step < 0.0).count();
        let same = steps(values).filter(|step| *step == 0.0).count();
        found.add_check(&match falling {
            0 => format!(
                "{same} of {} rows have the time of the row before: too coarse (leave it out and \
                 give the `rate`), or rows of several axes",
                values.len()
            ),
            _ => format!("it goes back {falling} times: several captures in one file?"),
        });
        self.signals.insert(0, found);
    }

    /// Says which column counts captures or axes that stand in one file.
    pub(super) fn find_captures(&mut self, samples: &[Samples]) {
        let may_count = |column: &&TableColumn| {
            let has_words = !samples[column.number - 1].words.is_empty();
            column.signal.is_none()
                && (counts_captures(&column.name) || has_words && names_signals(&column.name))
        };
        for column in self.columns.iter().filter(may_count) {
            if let words @ [_, _, ..] = samples[column.number - 1].words.as_slice() {
                self.table_checks.push(format!(
                    "{} has different words ({}, ...): rows of several axes or signals, which must \
                     be files of their own",
                    shown(column),
                    words.join(", ")
                ));
                continue;
            }
            let count = captures(&samples[column.number - 1].values);
            if let Some(count) = count.filter(|count| *count > 1) {
                self.table_checks.push(format!(
                    "{} has {count} values: rows of several captures or axes, which must be files \
                     of their own",
                    shown(column)
                ));
            }
        }
    }

    /// The same with what to check where the names are not as many as the columns.
    pub(super) fn with_names_unplaced(mut self, layout: &TextLayout) -> Proposal {
        if let Some((line, names)) = layout.unplaced {
            self.table_checks.push(format!(
                "line {line} has {names} names for {} columns: which is of which it does not say, \
                 so the columns have numbers",
                layout.columns
            ));
        }
        self
    }

    /// The same with what to check where there are fewer rows than columns.
    pub(super) fn with_few_rows(mut self) -> Proposal {
        if self.rows < self.columns.len() {
            self.table_checks.push(format!(
                "{} rows of {} columns: where each signal is a row, turn the table round",
                self.rows,
                self.columns.len()
            ));
        }
        self
    }

    /// The same with what to check where blanks separate columns and rows differ in their number:
    /// of a cell that is blank it is not known which it is.
    pub(super) fn with_rows_of_other_lengths(
        mut self,
        layout: &TextLayout,
        path: &Path,
    ) -> std::io::Result<Proposal> {
        if layout.delimiter != Delimiter::Blanks {
            return Ok(self);
        }
        let (mut lines, mut row) = (layout.rows(path)?, Splitter::new(layout.delimiter));
        let (mut rows, mut others) = (0, 0);
        while let Some((_, line)) = lines.next()? {
            row.split(line);
            let is_value = |field: &[u8]| layout.value(field).is_value();
            if row.fields().any(is_value) {
                rows += 1;
                others += usize::from(row.len() != layout.columns);
            }
            if rows >= LOOKED_AT {
                break;
            }
        }
        // The last row may be cut off.
        if others > 1 {
            self.table_checks.push(format!(
                "{others} of {rows} rows have not {} values: where a cell is blank, it is not \
                 known which",
                layout.columns
            ));
        }
        Ok(self)
    }

    /// The same with what to check where the first row counts the columns, as the names of a table
    /// without names do.
    pub(super) fn with_first_row_that_counts(
        mut self,
        samples: &[Samples],
        layout: &TextLayout,
    ) -> Proposal {
        let first: Vec<f64> =
            samples.iter().filter_map(|column| column.values.first().copied()).collect();
        let counts =
            |from: f64| first.iter().zip(0..).all(|(one, at)| *one == from + f64::from(at));
        if layout.names_line.is_none() && first.len() > 2 && (counts(0.0) || counts(1.0)) {
            self.table_checks.push(format!(
                "line {line} counts the columns: where it is no row, `csv: {{names_in_line: \
                 {line}, data_from_line: {}}}`",
                layout.data_line + 1,
                line = layout.data_line
            ));
        }
        self
    }

    /// The same with what to check where a line above the rows has a factor for each column.
    pub(super) fn with_factors(mut self, above: &[(u64, String)]) -> Proposal {
        const FACTOR: [&str; 7] =
            ["factor", "faktor", "scale", "scaling", "skalierung", "gain", "offset"];
        for (line, text) in above {
            let fields: Vec<&str> = text
                .split(|c: char| ";\t|".contains(c) || c == ',' && !self.decimal_comma)
                .collect();
            let Some((label, values)) = fields.split_first() else { continue };
            let label = label.to_lowercase();
            let is_factor = |value: &&str| {
                let value = value.trim().replace(',', ".");
                value.parse::<f64>().is_ok()
            };
            let count = values.iter().filter(|value| is_factor(value)).count();
            let is_label = FACTOR.iter().any(|word| label.contains(word));
            if is_label && !label.contains("horizontal") && count + 1 >= self.columns.len().max(2) {
                let begins = match *line == self.data_line {
                    true => {
                        format!(", and begin the rows with `csv: {{data_from_line: {}}}`", line + 1)
                    }
                    false => String::new(),
                };
                self.table_checks.push(format!(
                    "line {line} has factors or offsets of the columns, which are not applied: \
                     give them as `scale` and `offset`{begins}"
                ));
            }
        }
        self
    }

    /// The same with a scale to check for columns whose marks may be decimal ones.
    pub(super) fn with_thousands_in_doubt(mut self, layout: &TextLayout) -> Proposal {
        let written = if self.decimal_comma { "1.234" } else { "1,234" };
        let others = self.own_clocks.iter_mut().flat_map(|other| &mut other.signals);
        for found in self.signals.iter_mut().chain(others) {
            if layout.thousands_in_doubt.contains(&(found.column - 1)) {
                found.scale.get_or_insert(1.0);
                found.add_check(&format!(
                    "each number is written as {written} and taken for 1234; where it is 1.234, a \
                     thousandth of this `scale`"
                ));
            }
        }
        self
    }

    /// The same with the rate that a line above the table says, where no column is a time.
    pub(super) fn with_stated_rate(mut self, above: &[(u64, String)]) -> Proposal {
        let said: Vec<(u64, f64, bool)> = above
            .iter()
            .filter_map(|(line, text)| {
                let (rate, is_of_samples) = rate_in(text, self.decimal_comma)?;
                Some((*line, rate, is_of_samples))
            })
            .collect();
        // A rate of samples counts before others, and of several none.
        let is_any_of_samples = said.iter().any(|(.., is_of_samples)| *is_of_samples);
        let mut rates = said.iter().filter(|(.., of)| *of || !is_any_of_samples);
        let Some(&(line, rate, _)) = rates.next() else { return self };
        if rates.any(|(_, other, _)| *other != rate) {
            return self;
        }
        // A stated rate is preferred to a row counter without a unit.
        let rows = self.rows as f64;
        let time = self.signals.iter().position(|found| found.signal == Signal::Time);
        let is_counter = time.is_some_and(|at| {
            let column = self.column(self.signals[at].column);
            let range = column.and_then(|column| Some(column.largest? - column.smallest?));
            let is_called_one = column.is_some_and(|column| {
                ColumnName::of(&column.name).quantity == Some(Quantity::Time)
            });
            self.signals[at].check.is_some() && !is_called_one && range == Some(rows - 1.0)
        });
        if let Some(at) = time.filter(|_| is_counter) {
            let number = self.signals.remove(at).column;
            let column = self.columns.iter_mut().find(|column| column.number == number);
            column.into_iter().for_each(|column| column.signal = None);
            self.rate_hz = None;
        }
        if time.is_none() || is_counter {
            let check = format!("rows per second, as line {line} says; no column is a time");
            self.stated_rate = Some((rate, check));
        }
        self
    }
}
