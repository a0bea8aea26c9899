//! The columns of a table: names, units and the values of the first rows.

use std::collections::HashMap;
use std::path::Path;

use super::series::increases;
use super::{LOOKED_AT, QUOTED, TableColumn};
use crate::signals::column_name::{ColumnName, Quantity, unit_of_name, unit_of_suffix};
use crate::signals::text_layout::{TextLayout, bare_unit, name};
use crate::signals::text_lines::Splitter;
use crate::signals::text_value::Value;
use crate::signals::unit::{Dimension, Unit};

/// Most different words of a column that are kept.
const MOST_WORDS: usize = 4;

/// The values of a column, and whether some are dates or times of day.
pub(super) struct Samples {
    pub(super) values: Vec<f64>,
    pub(super) is_clock: bool,
    /// Different words, so many at most.
    pub(super) words: Vec<String>,
}

impl Samples {
    pub(super) fn none() -> Samples {
        Samples { values: Vec::new(), is_clock: false, words: Vec::new() }
    }

    fn add_word(&mut self, field: &[u8]) {
        let word: String = name(field).chars().take(QUOTED).collect();
        if self.words.len() < MOST_WORDS && !self.words.contains(&word) {
            self.words.push(word);
        }
    }

    pub(super) fn has_values(&self) -> bool {
        self.values.iter().any(|value| value.is_finite())
    }
}

/// Names, units as the file writes them, and values of all columns.
pub(super) struct Table<'a> {
    pub(super) names: &'a [String],
    pub(super) units: &'a [String],
    pub(super) samples: &'a [Samples],
    /// Columns of each name.
    pub(super) counts: HashMap<&'a str, usize>,
}

impl<'a> Table<'a> {
    pub(super) fn new(
        names: &'a [String],
        units: &'a [String],
        samples: &'a [Samples],
    ) -> Table<'a> {
        let mut counts = HashMap::new();
        for name in names {
            *counts.entry(name.as_str()).or_default() += 1;
        }
        Table { names, units, samples, counts }
    }

    /// The column at an index.
    pub(super) fn column(&self, at: usize) -> TableColumn {
        let samples = &self.samples[at];
        let finite = || samples.values.iter().copied().filter(|v| v.is_finite());
        let has_values = samples.has_values() && !samples.is_clock;
        let unit = match bare_unit(&self.units[at]) {
            // A number in brackets is an index.
            none if none.bytes().all(|byte| byte.is_ascii_digit()) => {
                let written = unit_of_name(&self.names[at]);
                unit_of_suffix(written).unwrap_or(written)
            }
            written => written,
        };
        TableColumn {
            number: at + 1,
            name: self.names[at].clone(),
            unit: unit.to_owned(),
            smallest: has_values.then(|| finite().fold(f64::INFINITY, f64::min)),
            largest: has_values.then(|| finite().fold(f64::NEG_INFINITY, f64::max)),
            signal: None,
            is_alone: self.counts.get(self.names[at].as_str()) == Some(&1),
        }
    }

    /// The columns of each time where several times stand in the table: each with the columns that
    /// it is named after or has the path of, or else with those behind it. None where there is one
    /// clock: times next to each other that are named after nothing are of the same rows.
    pub(super) fn blocks(&self) -> Vec<Vec<usize>> {
        let is_time = |at: &usize| {
            let column = self.column(*at);
            let said = ColumnName::of(&column.name).quantity == Some(Quantity::Time)
                || Unit::named(&column.unit).is_some_and(|u| u.dimension == Dimension::Time);
            said && increases(&self.samples[*at].values)
        };
        let times: Vec<usize> = (0..self.names.len()).filter(is_time).collect();
        let is_same = |one: usize, two: usize| {
            let pairs = self.samples[one].values.iter().zip(&self.samples[two].values);
            pairs.into_iter().all(|(a, b)| a == b || a.is_nan() || b.is_nan())
        };
        if times.len() < 2 || times.iter().skip(1).all(|at| is_same(times[0], *at)) {
            return Vec::new();
        }
        let names: Vec<ClockName> = self.names.iter().map(|name| ClockName::of(name)).collect();
        let is_any_time: Vec<bool> = (0..names.len()).map(|at| times.contains(&at)).collect();
        let own_time = |at: usize| {
            times.iter().copied().find(|time| match is_any_time[at] {
                true => *time == at,
                false => names[*time].is_time_of(&names[at]),
            })
        };
        let own: Vec<Option<usize>> = (0..names.len()).map(own_time).collect();
        let have_own = own.iter().zip(&is_any_time).any(|(own, is_time)| !is_time && own.is_some());
        let stand_apart = times.windows(2).all(|pair| pair[1] > pair[0] + 1)
            && times.last().is_some_and(|at| at + 1 < self.names.len());
        if !have_own && !stand_apart {
            return Vec::new();
        }
        let mut blocks = vec![Vec::new(); times.len()];
        let mut before = 0;
        for (at, time) in own.iter().enumerate() {
            let block = time.and_then(|time| times.binary_search(&time).ok());
            if is_any_time[at] {
                before = block.unwrap_or(before);
            }
            blocks[block.unwrap_or(before)].push(at);
        }
        blocks
    }
}

/// What a name says of the time that belongs to it: its path, and the name without a unit.
struct ClockName<'a> {
    path: Option<&'a str>,
    bare: &'a str,
}

impl ClockName<'_> {
    fn of(name: &str) -> ClockName<'_> {
        let bare = name.split(['[', '(', '{']).next().unwrap_or_default().trim();
        ClockName { path: name.rsplit_once(['.', '/']).map(|(path, _)| path), bare }
    }

    /// Whether it is the time of a column: `pos.t` of `pos.x`, `AxisPos_t [s]` of `AxisPos [mm]`.
    fn is_time_of(&self, column: &ClockName) -> bool {
        let behind = self.bare.strip_prefix(column.bare).filter(|_| !column.bare.is_empty());
        self.path.is_some() && self.path == column.path
            || behind.is_some_and(|rest| rest.starts_with(|c: char| !c.is_alphanumeric()))
    }
}

/// The columns of the first rows. Times are in s since the first row.
pub(super) fn samples(path: &Path, layout: &TextLayout) -> std::io::Result<Vec<Samples>> {
    let mut lines = layout.rows(path)?;
    let mut row = Splitter::new(layout.delimiter);
    let mut columns: Vec<Samples> = (0..layout.columns).map(|_| Samples::none()).collect();
    let mut begins: Vec<Option<i64>> = vec![None; layout.columns];
    while let Some((_, line)) = lines.next()? {
        row.split(line);
        let values: Vec<Value> = row.fields().map(|f| Value::of(f, layout.decimal)).collect();
        // Settings between captures and what is at the end of a table begin with words.
        let is_of_table = !layout.begins_with_value || values.first() != Some(&Value::Text);
        if values.len() < layout.columns || !is_of_table || !values.iter().any(Value::is_value) {
            continue;
        }
        let fields = row.fields().zip(&values).zip(&mut columns).zip(&mut begins);
        for (((field, value), column), begin) in fields {
            if *value == Value::Text {
                column.add_word(field);
            }
            column.values.push(match value {
                Value::Number { value, .. } => *value,
                Value::Time { nanoseconds, .. } => {
                    column.is_clock = true;
                    let since = nanoseconds - *begin.get_or_insert(*nanoseconds);
                    since as f64 * 1e-9
                }
                Value::Missing | Value::Text => f64::NAN,
            });
        }
        if columns.first().is_some_and(|column| column.values.len() >= LOOKED_AT) {
            break;
        }
    }
    Ok(columns)
}

/// Whether a column is called as what counts captures or axes.
pub(super) fn counts_captures(name: &str) -> bool {
    const CAPTURE: &[&str] = &[
        "capture", "run", "shot", "cycle", "test", "segment", "block", "record", "trial",
        "episode", "axis", "axe", "achse", "joint", "versuch", "messung", "zyklus", "essai",
    ];
    has_word(name, CAPTURE)
}

/// Whether a column is called as what has the name of a signal in each row.
pub(super) fn names_signals(name: &str) -> bool {
    has_word(name, &["topic", "signal", "variable", "channel", "kanal", "tag", "series"])
}

fn has_word(name: &str, known: &[&str]) -> bool {
    let name = name.to_lowercase();
    name.split(|c: char| !c.is_alphabetic()).any(|word| known.contains(&word))
}
