//! The proposal as a mapping file.

use std::fmt::Write as _;
use std::path::Path;

use super::{Proposal, TableColumn, joint_of};
use crate::signals::mapping::Signal;

/// What to check where numbers can be read with a decimal point and with a decimal comma.
pub(super) const EITHER_DECIMAL: &str = "the numbers that were looked at can be read either way";

impl Proposal {
    /// The mapping file, with what to check in comments. `joined` are other recordings of the same
    /// motion, with their paths from the directory of `file` on.
    pub fn to_yaml(&self, file: &str, joined: &[(String, Proposal)]) -> String {
        let mut text = format!(
            "# Proposed for {file}. What it does not say itself is marked CHECK.\n\
             # Positive is along +x; `scale: -1` turns a signal round.\n{}",
            self.table_yaml(&self.not_found(joined))
        );
        let own = Path::new(file).file_name().unwrap_or_default().to_string_lossy().into_owned();
        let with_signals = |others: &'_ [Proposal]| {
            others.iter().filter(|other| other.recorded().next().is_some()).cloned().collect()
        };
        let own_clocks: Vec<Proposal> = with_signals(&self.own_clocks);
        let mut all: Vec<(&str, &Proposal, bool)> =
            own_clocks.iter().map(|other| (own.as_str(), other, true)).collect();
        for (path, other) in joined {
            all.push((path, other, self.has_dates() && other.has_dates()));
            all.extend(other.own_clocks.iter().map(|block| (path.as_str(), block, false)));
        }
        if !all.is_empty() {
            text += "join:\n";
        }
        for (path, other, is_one_clock) in all {
            let check = match is_one_clock {
                true => "s, added to its times",
                false => "CHECK: s, added to its times; 0 takes both clocks as one",
            };
            let path = serde_json::Value::from(path);
            let _ = writeln!(text, "  - file: {path}\n    clock_offset: 0   # {check}");
            for line in other.table_yaml(&[]).lines() {
                let _ = writeln!(text, "    {line}");
            }
        }
        text
    }

    /// What a recording needs and no table has.
    fn not_found(&self, joined: &[(String, Proposal)]) -> Vec<Signal> {
        let all: Vec<Signal> =
            self.recorded().chain(joined.iter().flat_map(|(_, other)| other.recorded())).collect();
        let has = |signals: [Signal; 2]| signals.iter().any(|signal| all.contains(signal));
        let motion = (!has([Signal::Position, Signal::Velocity])).then_some(Signal::Position);
        let force = (!has([Signal::Force, Signal::ForceCell])).then_some(Signal::Force);
        motion.into_iter().chain(force).collect()
    }

    /// The part of a mapping that is of this table, with a line to fill in for what is `not_found`.
    fn table_yaml(&self, not_found: &[Signal]) -> String {
        let mut text = String::new();
        if !self.is_of_arrays() {
            self.write_layout(&mut text);
        }
        self.write_signals(&mut text, not_found);
        text
    }

    /// How a text is written.
    fn write_layout(&self, text: &mut String) {
        let delimiter = match self.delimiter.as_str() {
            quoted if quoted.starts_with('`') => quoted.trim_matches('`').to_owned(),
            word => word.to_owned(),
        };
        let names = match self.names_line {
            Some(line) => format!("names_in_line: {line}"),
            None => "header: false".to_owned(),
        };
        // Files of one logger differ in the lines above the names: the mapping is for all of them.
        let _ = writeln!(
            text,
            "# As it is found in each file, unless a line as this one says it:\n\
             # csv: {{delimiter: \"{delimiter}\", decimal_comma: {}, {names}, data_from_line: {}}}",
            self.decimal_comma, self.data_line
        );
        if self.either_decimal {
            let _ = writeln!(
                text,
                "csv: {{decimal_comma: {}}}   # CHECK: {EITHER_DECIMAL}",
                self.decimal_comma
            );
        }
    }

    fn write_signals(&self, text: &mut String, not_found: &[Signal]) {
        for check in &self.table_checks {
            let _ = writeln!(text, "# CHECK: {check}");
        }
        if let Some((rate, check)) = &self.stated_rate {
            let _ = writeln!(text, "rate: {rate}   # CHECK: {check}");
        }
        *text += "signals:\n";
        for found in &self.signals {
            let place = self.place(found.column);
            let minus = found
                .minus
                .map_or(String::new(), |column| format!(", minus: {}", self.place(column)));
            let quoted = |key: &str, unit: &Option<String>| {
                let unit = unit.as_ref().map(|unit| serde_json::Value::from(unit.as_str()));
                unit.map_or(String::new(), |unit| format!(", {key}: {unit}"))
            };
            let minus = minus + &quoted("minus_unit", &found.minus_unit);
            let plus = found.plus.map_or(String::new(), |column| {
                format!(", plus: {}, plus_unit: ns", self.place(column))
            });
            let unit = quoted("unit", &found.unit);
            let scale = found.scale.map_or(String::new(), |scale| format!(", scale: {scale}"));
            let offset = found.offset.map_or(String::new(), |value| format!(", offset: {value}"));
            let scale = scale + &offset;
            let check = found.check.as_ref().map_or(String::new(), |c| format!("   # CHECK: {c}"));
            let name = if found.is_current { "current" } else { found.signal.name() };
            let _ =
                writeln!(text, "  {name}: {{column: {place}{minus}{unit}{plus}{scale}}}{check}");
        }
        let can_be =
            |column: &TableColumn| column.signal.is_none() && column.smallest < column.largest;
        for signal in not_found.iter().filter(|_| self.columns.iter().any(can_be)) {
            let unit = signal.si_unit(joint_of(&self.signals));
            let _ = writeln!(
                text,
                "  # {signal}: {{column: NAME, unit: {unit}}}   # not found; if it is one of those \
                 below"
            );
        }
        let others: Vec<String> = self
            .columns
            .iter()
            .filter(|column| column.signal.is_none())
            .map(|column| match column.name.as_str() {
                "" => column.number.to_string(),
                name => name.to_owned(),
            })
            .chain(self.not_used.iter().cloned())
            .collect();
        if !others.is_empty() {
            let _ = writeln!(text, "# Not used: {}", others.join(", "));
        }
    }

    /// A column as a mapping names it: by its name where no other has it, else by its number.
    fn place(&self, number: usize) -> String {
        // A string of JSON is one of YAML.
        match self.column(number) {
            // A number in a mapping is that of a column.
            Some(column)
                if column.is_alone
                    && !column.name.is_empty()
                    && column.name.parse::<usize>().is_err() =>
            {
                serde_json::Value::from(column.name.as_str()).to_string()
            }
            _ => number.to_string(),
        }
    }
}
