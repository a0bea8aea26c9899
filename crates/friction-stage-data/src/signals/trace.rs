//! A run as columns of numbers: one row per sample of the encoder, joined with the other signals by
//! time stamp.
//!
//! What comes in are bags with the topics of the stage, or CSV; what goes out is what a fit or a
//! figure needs.

use std::path::Path;

use super::by_stamp::{missing, trace_by_stamp};
use super::error::SignalError;
use super::mapping::{Mapping, Signal};
use crate::bag::{BagError, BagReader};
use friction_stage_core::control::Terms;
use friction_stage_core::model::StageModel;
use friction_stage_core::plant::Sample;

/// Columns of one run, all of the same length, in SI units. A value that the recording lacks is
/// NaN.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Trace {
    /// Time stamp of the first row, ns: on the clock of the recording.
    pub origin_ns: i64,
    /// Time from the first row, s; strictly increasing.
    pub time: Vec<f64>,
    /// Reference position, m.
    pub reference_position: Vec<f64>,
    /// Reference velocity, m/s.
    pub reference_velocity: Vec<f64>,
    /// Reference acceleration, m/s².
    pub reference_acceleration: Vec<f64>,
    /// Position that the encoder shows, m.
    pub position: Vec<f64>,
    /// Force cell, N, + along +x; at row k the motor force of the interval that ends there.
    pub force_cell: Vec<f64>,
    /// Force command, N, + along +x; that of row k acts until row k+1.
    pub force: Vec<f64>,
}

/// Names of the columns in a CSV file, in the order of [`Trace::columns`].
pub const COLUMNS: [&str; 7] = [
    "time",
    "reference_position",
    "reference_velocity",
    "reference_acceleration",
    "position",
    "force_cell",
    "force",
];

impl Trace {
    /// Number of rows.
    pub fn len(&self) -> usize {
        self.time.len()
    }

    /// Whether there are no rows.
    pub fn is_empty(&self) -> bool {
        self.time.is_empty()
    }

    /// Adds a row: what the sensors of a stage said and what its controller answered.
    pub fn push(&mut self, sample: &Sample, terms: &Terms) {
        self.time.push(sample.time as f64 * 1e-9);
        self.reference_position.push(terms.reference.position);
        self.reference_velocity.push(terms.reference.velocity);
        self.reference_acceleration.push(terms.reference.acceleration);
        self.position.push(sample.position);
        self.force_cell.push(sample.force_cell);
        self.force.push(terms.output);
    }

    /// Mean step between rows, s; NaN where there are fewer than two.
    pub fn step(&self) -> f64 {
        match self.len() {
            0 | 1 => f64::NAN,
            count => (self.time[count - 1] - self.time[0]) / (count - 1) as f64,
        }
    }

    /// The columns, in the order of [`COLUMNS`].
    pub fn columns(&self) -> [&[f64]; 7] {
        [
            &self.time,
            &self.reference_position,
            &self.reference_velocity,
            &self.reference_acceleration,
            &self.position,
            &self.force_cell,
            &self.force,
        ]
    }

    /// Reads the topics of the stage from a bag.
    ///
    /// Rows are the samples of `/stage/encoder`, on their own stamps: [`load`](super::load) brings
    /// the same signals onto a grid. The reference of a row comes from the one-point
    /// `/stage/setpoint` of its stamp, else from the `/controller/state` of its stamp; the force
    /// from the `/stage/force` of its stamp, else from the last of `/stage/joint_commands` or
    /// `/stage/commands` with its log time, where none of these is recorded from the output of the
    /// controller, and of a stage in real time from what acted. The force cell comes from its own
    /// topic, else from the effort of the encoder's. Of several messages with one stamp the first
    /// counts. A bag without positions, with a value that no unit can mean, or with a damaged place
    /// is an error. A namespace of the nodes stands before all names.
    pub fn from_bag(path: impl AsRef<Path>) -> Result<Self, SignalError> {
        Self::from_reader(&BagReader::open(path)?)
    }

    /// As [`from_bag`](Self::from_bag), from a bag that must have the force cell; with the model
    /// that the bag holds, if it does.
    pub fn with_force_cell(
        path: impl AsRef<Path>,
    ) -> Result<(Self, Option<StageModel>), SignalError> {
        let reader = BagReader::open(path)?;
        let trace = Self::from_reader(&reader)?;
        if trace.force_cell.iter().all(|force| force.is_nan()) {
            let mapping = Mapping::own_bag(reader.provenance(), reader.namespace());
            return Err(missing(&reader, Signal::ForceCell, &mapping));
        }
        Ok((trace, reader.model()?))
    }

    /// As [`from_bag`](Self::from_bag), from a bag that is open.
    pub fn from_reader(reader: &BagReader) -> Result<Self, SignalError> {
        trace_by_stamp(reader)
    }

    /// Writes a CSV file with a header line; numbers in the shortest form that reads back exactly,
    /// NaN as an empty field.
    pub fn write_csv(&self, path: impl AsRef<Path>) -> Result<(), SignalError> {
        let path = path.as_ref();
        let mut writer = csv::Writer::from_path(path).map_err(|e| csv_error(path, e))?;
        writer.write_record(COLUMNS).map_err(|e| csv_error(path, e))?;
        let columns = self.columns();
        for row in 0..self.len() {
            let fields = columns.iter().map(|column| match column[row] {
                value if value.is_nan() => String::new(),
                value => value.to_string(),
            });
            writer.write_record(fields).map_err(|e| csv_error(path, e))?;
        }
        writer.flush().map_err(|e| BagError::writing(path, 0, e).into())
    }
}

fn csv_error(path: &Path, error: csv::Error) -> SignalError {
    let line = error.position().map_or(0, csv::Position::line);
    let reason = error.to_string();
    match error.into_kind() {
        csv::ErrorKind::Io(source) => BagError::writing(path, 0, source).into(),
        _ => SignalError::Csv { path: path.to_owned(), line, reason },
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Trace {
        Trace {
            origin_ns: 0,
            time: vec![0.0, 1.0 / 3.0, 0.5],
            reference_position: vec![1e-9, 0.025, 0.05],
            reference_velocity: vec![0.0, 1.0, -1.0],
            reference_acceleration: vec![f64::NAN; 3],
            position: vec![0.0, 0.1 + 0.2, -1e-300],
            force_cell: vec![f64::NAN, 12.0, -0.0],
            force: vec![1.0, 2.0, 3.0],
        }
    }

    #[test]
    fn csv_has_the_columns_by_name_and_every_bit_of_their_numbers() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("trace.csv");
        example().write_csv(&path).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let mut lines = text.lines();
        assert_eq!(lines.next(), Some(COLUMNS.join(",").as_str()));
        let rows: Vec<&str> = lines.collect();
        assert_eq!(rows.len(), example().len());
        for (row, line) in rows.into_iter().enumerate() {
            assert_eq!(line.split(',').count(), COLUMNS.len(), "{line}");
            for (field, column) in line.split(',').zip(example().columns()) {
                let read = if field.is_empty() { f64::NAN } else { field.parse().unwrap() };
                assert_eq!(read.to_bits(), column[row].to_bits(), "row {row}: {line}");
            }
        }
    }
}
