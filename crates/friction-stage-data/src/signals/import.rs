//! A table as a bag of our own layout, which plays, replays and is identified like any other.
//!
//! Every row becomes the messages of one sample, with the time of the row as stamp and log time and
//! with the values in SI; nothing is resampled. A value that a row lacks is a message that is not
//! written.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;

use super::csv_table::CsvFile;
use super::data_quality::SignalNote;
use super::error::SignalError;
use super::load::Integral;
use super::mapping::{Mapping, Signal, SignalSource};
use super::source::NO_TIME;
use crate::bag::{BagOptions, BagWriter, OfferedQos, is_recording, topics};
use crate::message::{Header, JointState, JointTrajectory, JointTrajectoryPoint, WrenchStamped};

/// Name of the MCAP metadata record that says what was imported.
const METADATA_NAME: &str = "friction_stage_import";

/// What an import wrote.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ImportReport {
    /// Rows of the table.
    pub rows: u64,
    /// Messages on each topic.
    pub messages: BTreeMap<String, u64>,
    /// Rows without a time, which are left out.
    pub without_time: u64,
    /// Rows whose time is not behind that of the row before.
    pub not_later: u64,
    /// What a user should know about how they were read.
    pub notes: Vec<SignalNote>,
    /// By how much the times were moved for the first one to be 0 where it was before that, s.
    pub moved_s: f64,
}

/// Writes the bag `out` from a table; `mapping_text` is kept in it. Row by row, in bounded
/// memory.
pub fn import(
    csv: &Path,
    mapping: &Mapping,
    mapping_text: &str,
    out: &Path,
) -> Result<ImportReport, SignalError> {
    if is_recording(csv) {
        return Err(SignalError::IsRecording { path: csv.to_owned() });
    }
    let file = CsvFile::new(csv, mapping)?;
    let columns: Vec<(Signal, SignalSource)> = mapping
        .signals
        .iter()
        .filter(|(signal, _)| **signal != Signal::Time)
        .filter_map(|(signal, sources)| Some((*signal, sources.first()?.clone())))
        .collect();
    let mut rows = file.rows(&columns)?;
    let has = |signal: Signal| columns.iter().any(|(s, ..)| *s == signal);
    let has_reference = has(Signal::ReferencePosition)
        || has(Signal::ReferenceVelocity)
        || has(Signal::ReferenceAcceleration);
    let mut bag = BagWriter::create(out, &BagOptions::default())?;
    bag.write_metadata(
        METADATA_NAME,
        [
            ("source".to_owned(), csv.display().to_string()),
            ("mapping".to_owned(), mapping_text.to_owned()),
            ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
        ]
        .into(),
    )?;
    let qos = OfferedQos::reliable(100);
    let encoder = bag.add_topic::<JointState>(topics::ENCODER, &qos)?;
    let topic = |bag: &mut BagWriter, name: &str, wanted: bool| {
        if wanted { bag.add_topic::<WrenchStamped>(name, &qos).map(Some) } else { Ok(None) }
    };
    let cell = topic(&mut bag, topics::FORCE_CELL, has(Signal::ForceCell))?;
    let force = topic(&mut bag, topics::FORCE, has(Signal::Force))?;
    let setpoint = if has_reference {
        Some(bag.add_topic::<JointTrajectory>(topics::SETPOINT, &qos)?)
    } else {
        None
    };
    let mut report = ImportReport {
        rows: 0,
        messages: BTreeMap::new(),
        without_time: 0,
        not_later: 0,
        notes: Vec::new(),
        moved_s: 0.0,
    };
    let mut travelled = Integral::default();
    let (mut moved, mut last): (Option<i64>, Option<i64>) = (None, None);
    let mut written = |topic: &str| *report.messages.entry(topic.to_owned()).or_insert(0) += 1;
    while let Some(stamp) = rows.next()? {
        report.rows += 1;
        if stamp == NO_TIME {
            report.without_time += 1;
            continue;
        }
        // Log times of a bag are not negative, those that count from a trigger are.
        let moved = *moved.get_or_insert(stamp.saturating_neg().max(0));
        report.moved_s = moved as f64 * 1e-9;
        let stamp = stamp.saturating_add(moved);
        let Ok(log_time) = u64::try_from(stamp) else {
            report.without_time += 1;
            continue;
        };
        report.not_later += u64::from(last.is_some_and(|last| stamp <= last));
        last = Some(stamp);
        let mut values = [f64::NAN; 8];
        for ((signal, _), value) in columns.iter().zip(&rows.values) {
            values[*signal as usize] = *value;
        }
        if has(Signal::Velocity) {
            values[Signal::Position as usize] =
                travelled.next(stamp, values[Signal::Velocity as usize]);
        }
        let value = |signal: Signal| values[signal as usize];
        let header = Header::new(stamp, topics::JOINT);
        let list = |value: f64| {
            if value.is_finite() { vec![value] } else { Vec::new() }
        };
        if value(Signal::Position).is_finite() {
            let state = JointState {
                header: header.clone(),
                name: vec![topics::JOINT.into()],
                position: list(value(Signal::Position)),
                velocity: Vec::new(),
                effort: list(value(Signal::ForceCell)),
            };
            bag.write(encoder, log_time, &state)?;
            written(topics::ENCODER);
        }
        let forces =
            [(cell, Signal::ForceCell, topics::FORCE_CELL), (force, Signal::Force, topics::FORCE)];
        for (topic, signal, name) in forces {
            if let Some(topic) = topic.filter(|_| value(signal).is_finite()) {
                bag.write(topic, log_time, &WrenchStamped::along_x(header.clone(), value(signal)))?;
                written(name);
            }
        }
        let point = JointTrajectoryPoint {
            positions: list(value(Signal::ReferencePosition)),
            velocities: list(value(Signal::ReferenceVelocity)),
            accelerations: list(value(Signal::ReferenceAcceleration)),
            ..JointTrajectoryPoint::default()
        };
        let empty = point.positions.is_empty()
            && point.velocities.is_empty()
            && point.accelerations.is_empty();
        if let Some(topic) = setpoint.filter(|_| !empty) {
            let setpoint = JointTrajectory {
                header,
                joint_names: vec![topics::JOINT.into()],
                points: vec![point],
            };
            bag.write(topic, log_time, &setpoint)?;
            written(topics::SETPOINT);
        }
    }
    bag.finish()?;
    report.notes = rows.notes();
    if has(Signal::Velocity) {
        report.notes.push(SignalNote::Integrated);
    }
    Ok(report)
}
