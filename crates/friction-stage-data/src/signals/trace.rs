//! A run as columns of numbers: one row per sample of the encoder, joined with the other signals by
//! time stamp.
//!
//! What comes in are bags with the topics of the stage, or CSV; what goes out is what a fit or a
//! figure needs.

use std::collections::HashMap;
use std::path::Path;

use super::error::SignalError;
use crate::bag::topics;
use crate::bag::{BagError, BagMessage, BagReader};
use crate::message::{ControllerState, Header, JointState, JointTrajectory, WrenchStamped};
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

    fn columns_mut(&mut self) -> [&mut Vec<f64>; 7] {
        [
            &mut self.time,
            &mut self.reference_position,
            &mut self.reference_velocity,
            &mut self.reference_acceleration,
            &mut self.position,
            &mut self.force_cell,
            &mut self.force,
        ]
    }

    /// Reads the topics of the stage from a bag.
    ///
    /// Rows are the samples of `/stage/encoder`. The reference of a row comes from the one-point
    /// `/stage/setpoint` of its stamp, else from the `/controller/state` of its stamp; the force
    /// from the `/stage/force` of its stamp, else from the last of `/stage/joint_commands` with its
    /// log time. Of several other messages with one stamp the first counts. A bag without encoder,
    /// or with a damaged place, is an error. A namespace of the nodes stands before all names.
    pub fn from_bag(path: impl AsRef<Path>) -> Result<Self, SignalError> {
        Self::from_reader(&BagReader::open(path)?)
    }

    /// As [`from_bag`](Self::from_bag), from a bag that must have the force cell; with the model
    /// that the bag holds, if it does.
    pub fn with_force_cell(
        path: impl AsRef<Path>,
    ) -> Result<(Self, Option<StageModel>), SignalError> {
        let reader = BagReader::open(path)?;
        if reader.own_topic(topics::FORCE_CELL).is_none_or(|topic| topic.messages == 0) {
            return Err(missing(
                &reader,
                "force cell",
                format!("messages on {} (geometry_msgs/msg/WrenchStamped)", topics::FORCE_CELL),
            ));
        }
        let trace = Self::from_reader(&reader)?;
        Ok((trace, reader.model()?))
    }

    /// As [`from_bag`](Self::from_bag), from a bag that is open.
    pub fn from_reader(reader: &BagReader) -> Result<Self, SignalError> {
        let missing = |signal, needs: String| missing(reader, signal, needs);
        let mut rows: Vec<(i64, f64)> = Vec::new();
        let mut cell = HashMap::new();
        let mut force = HashMap::new();
        let mut effort = HashMap::new();
        let mut setpoint = HashMap::new();
        let mut controller = HashMap::new();
        let namespace = reader.namespace();
        for message in reader.messages() {
            let message = message?;
            match message.topic.name.strip_prefix(namespace).unwrap_or_default() {
                topics::ENCODER => {
                    let state: JointState = message.decode()?;
                    let joint = joint_index(&state.name).ok_or_else(|| {
                        missing(
                            "encoder position",
                            format!(
                                "a joint {:?} in {}; at {} ns it has {:?}",
                                topics::JOINT,
                                topics::ENCODER,
                                message.log_time,
                                state.name
                            ),
                        )
                    })?;
                    if let Some(&position) = state.position.get(joint) {
                        rows.push((stamp(&state.header), position));
                    }
                }
                topics::FORCE_CELL => insert_force(&mut cell, &message)?,
                topics::FORCE => insert_force(&mut force, &message)?,
                topics::JOINT_COMMANDS => {
                    let command: JointState = message.decode()?;
                    let joint = joint_index(&command.name);
                    if let Some(&value) = joint.and_then(|joint| command.effort.get(joint)) {
                        effort.insert(message.log_time as i64, value);
                    }
                }
                topics::SETPOINT => {
                    let trajectory: JointTrajectory = message.decode()?;
                    if let [point] = trajectory.points.as_slice() {
                        let joint = joint_index(&trajectory.joint_names).unwrap_or(0);
                        let value = |v: &[f64]| v.get(joint).copied().unwrap_or(f64::NAN);
                        setpoint.entry(stamp(&trajectory.header)).or_insert([
                            value(&point.positions),
                            value(&point.velocities),
                            value(&point.accelerations),
                        ]);
                    }
                }
                topics::CONTROLLER_STATE => {
                    let state: ControllerState = message.decode()?;
                    controller.entry(stamp(&state.header)).or_insert([
                        state.reference_position,
                        state.reference_velocity,
                        state.reference_acceleration,
                    ]);
                }
                _ => {}
            }
        }
        if rows.is_empty() {
            return Err(missing(
                "encoder position",
                format!("sensor_msgs/msg/JointState on {}", topics::ENCODER),
            ));
        }
        rows.sort_by_key(|&(stamp, _)| stamp);
        rows.dedup_by_key(|&mut (stamp, _)| stamp);
        let origin_ns = rows[0].0;
        let mut trace = Self { origin_ns, ..Self::default() };
        for (stamp, position) in rows {
            let reference = setpoint
                .get(&stamp)
                .or_else(|| controller.get(&stamp))
                .copied()
                .unwrap_or([f64::NAN; 3]);
            let row = [
                (stamp - origin_ns) as f64 * 1e-9,
                reference[0],
                reference[1],
                reference[2],
                position,
                cell.get(&stamp).copied().unwrap_or(f64::NAN),
                force.get(&stamp).or_else(|| effort.get(&stamp)).copied().unwrap_or(f64::NAN),
            ];
            for (column, value) in trace.columns_mut().into_iter().zip(row) {
                column.push(value);
            }
        }
        Ok(trace)
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

    /// Reads a CSV file with a header line that names the columns as [`COLUMNS`] does, in any
    /// order. `time` and `position` are needed, other columns that are not there are NaN.
    pub fn read_csv(path: impl AsRef<Path>) -> Result<Self, SignalError> {
        let path = path.as_ref();
        let wrong = |line, reason| SignalError::Csv { path: path.to_owned(), line, reason };
        let mut reader = csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .from_path(path)
            .map_err(|e| csv_error(path, e))?;
        let headers = reader.headers().map_err(|e| csv_error(path, e))?.clone();
        let places = COLUMNS.map(|name| headers.iter().position(|h| h == name));
        for (name, place) in COLUMNS.iter().zip(places) {
            if place.is_none() && ["time", "position"].contains(name) {
                return Err(wrong(
                    1,
                    format!(
                        "no column {name:?}; columns are {:?}, known names are {COLUMNS:?}",
                        headers.iter().collect::<Vec<_>>()
                    ),
                ));
            }
        }
        let mut trace = Self::default();
        let mut record = csv::StringRecord::new();
        while reader.read_record(&mut record).map_err(|e| csv_error(path, e))? {
            let line = record.position().map_or(0, csv::Position::line);
            for ((column, place), name) in trace.columns_mut().into_iter().zip(places).zip(COLUMNS)
            {
                let field = place.and_then(|p| record.get(p)).unwrap_or("");
                let value = if field.is_empty() {
                    f64::NAN
                } else {
                    field.parse().map_err(|_| {
                        wrong(line, format!("{field:?} in column {name:?} is not a number"))
                    })?
                };
                if name == "time"
                    && column
                        .last()
                        .map_or(!f64::is_finite(value), |&l| value.is_nan() || value <= l)
                {
                    return Err(wrong(
                        line,
                        format!(
                            "time {field:?} s does not come after {} s",
                            column.last().copied().unwrap_or(f64::NEG_INFINITY)
                        ),
                    ));
                }
                column.push(value);
            }
        }
        if trace.is_empty() {
            return Err(wrong(2, "no rows after the header line".into()));
        }
        Ok(trace)
    }
}

fn missing(reader: &BagReader, signal: &'static str, needs: String) -> SignalError {
    SignalError::MissingSignal {
        path: reader.path().to_owned(),
        signal,
        needs,
        has: match reader.topics() {
            [] => "no topics".into(),
            topics => {
                let names: Vec<_> = topics.iter().map(|t| t.name.as_str()).collect();
                names.join(", ")
            }
        },
    }
}

/// Index of the stage among the joints: by name, or the only one.
pub(crate) fn joint_index(names: &[String]) -> Option<usize> {
    names.iter().position(|n| n == topics::JOINT).or((names.len() == 1).then_some(0))
}

fn stamp(header: &Header) -> i64 {
    header.stamp.to_nanos()
}

fn insert_force(map: &mut HashMap<i64, f64>, message: &BagMessage) -> Result<(), SignalError> {
    let wrench: WrenchStamped = message.decode()?;
    map.entry(stamp(&wrench.header)).or_insert(wrench.wrench.force.x);
    Ok(())
}

pub(crate) fn csv_error(path: &Path, error: csv::Error) -> SignalError {
    let line = error.position().map_or(0, csv::Position::line);
    let reason = error.to_string();
    match error.into_kind() {
        csv::ErrorKind::Io(source) => BagError::reading(path, source).into(),
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

    fn bits(trace: &Trace) -> Vec<Vec<u64>> {
        trace.columns().iter().map(|c| c.iter().map(|v| v.to_bits()).collect()).collect()
    }

    #[test]
    fn csv_reads_back_bit_for_bit() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("trace.csv");
        example().write_csv(&path).unwrap();
        assert_eq!(bits(&Trace::read_csv(&path).unwrap()), bits(&example()));
    }

    #[test]
    fn csv_columns_are_found_by_name_and_errors_name_line_and_column() {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("trace.csv");
        let read = |text: &str| {
            std::fs::write(&path, text).unwrap();
            Trace::read_csv(&path)
        };
        let trace = read("position, time, other\n1.5, 0, x\n2.5, 0.1, y\n").unwrap();
        assert_eq!(trace.position, [1.5, 2.5]);
        assert!(trace.force.iter().all(|f| f.is_nan()));
        let error = read("time,position\n0,1\n0.1,1,7\n").unwrap_err().to_string();
        assert!(error.contains("line 3"), "{error}");
        let error = read("time,position\n0,1\n0.1,abc\n").unwrap_err().to_string();
        assert!(
            error.contains("line 3") && error.contains("\"abc\"") && error.contains("position"),
            "{error}"
        );
        let error = read("time,position\n0.2,1\n0.1,1\n").unwrap_err().to_string();
        assert!(error.contains("does not come after 0.2"), "{error}");
        let error = read("time,speed\n0.2,1\n").unwrap_err().to_string();
        assert!(error.contains("no column \"position\""), "{error}");
        assert!(read("time,position\n").unwrap_err().to_string().contains("no rows"));
    }
}
