//! Columns of numbers in memory as a recording, as the rows of a CSV file with their names are.

use std::path::Path;

use super::error::SignalError;
use super::mapping::{Column, Place};
use super::source::{Request, Stream, refuse_impossible, seconds_to_nanos};
use super::trace::{COLUMNS, Trace};
use super::window::Span;

/// The columns of a trace whose rows need not be on a grid.
pub(crate) struct Columns<'a> {
    trace: &'a Trace,
}

impl<'a> Columns<'a> {
    /// Refuses columns of different lengths, and values that no unit can mean; an empty column is
    /// not there.
    pub fn new(name: &Path, trace: &'a Trace) -> Result<Self, SignalError> {
        let rows = trace.time.len();
        for (column, values) in COLUMNS.into_iter().zip(trace.columns()) {
            if !values.is_empty() && values.len() != rows {
                let count = values.len();
                return Err(SignalError::Columns { name: name.to_owned(), column, count, rows });
            }
            for (row, value) in values.iter().enumerate() {
                refuse_impossible(column, *value).map_err(|reason| {
                    let name = name.to_owned();
                    SignalError::ImpossibleValue { name, row, reason }
                })?;
            }
        }
        Ok(Self { trace })
    }

    fn values(&self, column: &Column) -> Option<&'a [f64]> {
        let Column::Name(name) = column else { return None };
        let index = COLUMNS.iter().position(|known| known == name)?;
        Some(self.trace.columns()[index]).filter(|values| values.iter().any(|v| v.is_finite()))
    }

    /// Rows of a column, if it is there.
    pub fn expected(&self, column: &Column) -> Option<u64> {
        self.values(column).map(|values| values.len() as u64)
    }

    /// Its columns, for people.
    pub fn inventory(&self) -> String {
        let present = COLUMNS.into_iter().zip(self.trace.columns());
        let names: Vec<&str> =
            present.filter(|(_, values)| !values.is_empty()).map(|(name, _)| name).collect();
        if names.is_empty() { "no columns".into() } else { names.join(", ") }
    }

    /// Each request as a stream.
    pub fn read(&self, requests: &[Request], span: Span) -> Vec<Stream> {
        let origin = self.trace.origin_ns;
        let stream = |request: &Request| {
            let mut stream = Stream::new(request, self.trace.time.len() as u64, span);
            let columns: Vec<&[f64]> = request
                .signals
                .iter()
                .map(|(_, source)| match &source.place {
                    Place::Column(column) => self.values(column).unwrap_or_default(),
                    Place::Topic { .. } => &[],
                })
                .collect();
            for (row, seconds) in self.trace.time.iter().enumerate() {
                let values = columns.iter().map(|column| column.get(row).copied());
                let stamp = origin.saturating_add(seconds_to_nanos(*seconds));
                stream.push(stamp, values.map(|value| value.unwrap_or(f64::NAN)));
            }
            stream
        };
        requests.iter().map(stream).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Recording, Window, from_columns, load};
    use super::*;

    fn whole(name: &str, columns: &Trace) -> Result<Recording, SignalError> {
        from_columns(name, columns, Window::default())
    }

    /// To and fro, with a gap and a row that comes twice.
    fn run() -> Trace {
        let mut time: Vec<f64> = (0..4000).map(|row| f64::from(row) * 0.5e-3).collect();
        time.drain(1200..1300);
        time[77] = time[76];
        let over = |of: &dyn Fn(f64) -> f64| time.iter().map(|t| of(*t)).collect::<Vec<f64>>();
        Trace {
            origin_ns: 0,
            position: over(&|t| (2e7 * (6.0 * t).sin()).round() * 1e-9),
            force: over(&|t| 40.0 * (6.0 * t).cos()),
            force_cell: Vec::new(),
            reference_position: Vec::new(),
            reference_velocity: Vec::new(),
            reference_acceleration: Vec::new(),
            time,
        }
    }

    #[test]
    fn columns_in_memory_are_the_recording_of_their_file() {
        let run = run();
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("run.csv");
        let rows = run.time.iter().zip(&run.position).zip(&run.force);
        let text: String = rows.map(|((t, x), f)| format!("{t},{x},{f}\n")).collect();
        std::fs::write(&path, format!("time,position,force\n{text}")).unwrap();
        let (file, memory) = (load(&path, None).unwrap(), whole("run", &run).unwrap());
        let bits = |trace: &Trace| {
            trace.columns().map(|column| column.iter().map(|v| v.to_bits()).collect::<Vec<_>>())
        };
        assert_eq!(bits(&memory.trace), bits(&file.trace));
        assert_eq!((memory.rate, &memory.valid), (file.rate, &file.valid));
        assert!(memory.quality.signals[0].gaps == 1, "{:?}", memory.quality);
        assert_eq!(memory.quality, file.quality);
    }

    #[test]
    fn columns_of_different_lengths_and_without_a_position_are_refused() {
        let mut short = run();
        short.force.pop();
        let reported = whole("frame", &short).unwrap_err().to_string();
        assert!(reported.contains("frame: 3899 values of force for 3900"), "{reported}");
        let mut fixed = run();
        fixed.position.fill(f64::NAN);
        let reported = whole("frame", &fixed).unwrap_err().to_string();
        assert!(reported.contains("no position") && reported.contains("force"), "{reported}");
    }
}
