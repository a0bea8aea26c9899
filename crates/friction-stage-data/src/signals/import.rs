//! A table as a bag of our own layout, which plays, replays and is identified like any other.
//!
//! Every row becomes the messages of one sample, with the time of the row as stamp and log time and
//! with the values in SI; nothing is resampled. A value that a row lacks is a message that is not
//! written. The rows of tables that the mapping joins come between, in the order of their times.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::csv_table::{Captures, CsvFile, CsvRows};
use super::data_quality::SignalNote;
use super::error::SignalError;
use super::load::Integral;
use super::mapping::{Mapping, Signal, SignalSource};
use super::source::NO_TIME;
use crate::bag::{
    BagError, BagOptions, BagReader, BagWriter, OfferedQos, TopicId, is_recording, topics,
};
use crate::message::{Header, JointState, JointTrajectory, JointTrajectoryPoint, WrenchStamped};
use friction_stage_core::model::JointType;

/// Name of the MCAP metadata record that says what was imported.
pub(super) const METADATA_NAME: &str = "friction_stage_import";
/// Key in it of the type of the joint, where the mapping says one.
const JOINT_TYPE: &str = "joint_type";

/// The type of the joint whose table was imported into a bag.
pub(super) fn joint_type(reader: &BagReader) -> Option<JointType> {
    let (_, imported) = reader.metadata().find(|(name, _)| name == METADATA_NAME)?;
    JointType::named(imported.get(JOINT_TYPE)?)
}
/// Rows between two words of progress.
const TOLD_EVERY: u64 = 100_000;

/// What an import wrote.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ImportReport {
    /// The bag.
    pub bag: PathBuf,
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
/// memory; `progress` gets the rows written so far, now and then.
pub fn import(
    csv: &Path,
    mapping: &Mapping,
    about: &BTreeMap<String, String>,
    out: &Path,
    progress: &mut dyn FnMut(u64),
) -> Result<ImportReport, SignalError> {
    let import = Import::open(csv, mapping, about)?;
    whole_or_none(out, || write_bag(&import, out, progress))
}

fn write_bag(
    import: &Import,
    out: &Path,
    progress: &mut dyn FnMut(u64),
) -> Result<ImportReport, SignalError> {
    let mut tables = import.tables.iter().map(TableRows::open).collect::<Result<Vec<_>, _>>()?;
    let mut bag = import.bag(out.to_owned())?;
    let mut count = 0;
    // The earliest row is next; one without a time at once.
    while let Some((stamp, table)) =
        tables.iter().zip(0..).filter_map(|(table, index)| Some((table.stamp?, index))).min()
    {
        bag.write(table, stamp, &tables[table].rows.row.values)?;
        tables[table].next()?;
        count += 1;
        if u64::is_multiple_of(count, TOLD_EVERY) {
            progress(count);
        }
    }
    if bag.report.rows > 0 && bag.report.without_time == bag.report.rows {
        return Err(SignalError::Mapping {
            origin: import.path.display().to_string(),
            key: "signals.time".into(),
            reason: "no row has one: leave it out and give the `rate`".into(),
        });
    }
    import.refuse_other_times(&bag)?;
    bag.finish(tables.iter().flat_map(|table| table.rows.notes()).chain(import.marks()).collect())
}

/// What `write` writes at `out` if that is refused on the way is no recording: it is removed.
fn whole_or_none<T>(
    out: &Path,
    write: impl FnOnce() -> Result<T, SignalError>,
) -> Result<T, SignalError> {
    let written = write();
    // A bag made by another process is kept.
    let is_own = |error: &SignalError| !matches!(error, SignalError::Bag(BagError::Exists { .. }));
    if written.as_ref().is_err_and(is_own) {
        // What cannot be removed is what the error that is on its way is about.
        let _ = std::fs::remove_dir_all(out);
    }
    written
}

/// Writes a bag for each capture of a table that has several, one after the other: `capture_1`,
/// `capture_2` and so on in the directory `out`, which must not exist. What a user should know of
/// the whole table is in the last report.
pub fn import_captures(
    csv: &Path,
    mapping: &Mapping,
    about: &BTreeMap<String, String>,
    out: &Path,
    progress: &mut dyn FnMut(u64),
) -> Result<Vec<ImportReport>, SignalError> {
    let import = Import::open(csv, mapping, about)?;
    let [table] = import.tables.as_slice() else {
        let reason = "captures of several files cannot be told to be the same: import each file \
                      with --split and a mapping of its own";
        return Err(SignalError::Mapping {
            origin: csv.display().to_string(),
            key: "join".into(),
            reason: reason.into(),
        });
    };
    if out.exists() {
        return Err(BagError::Exists { path: out.to_owned() }.into());
    }
    whole_or_none(out, || write_bags(&import, table, out, progress))
}

fn write_bags(
    import: &Import,
    table: &Table,
    out: &Path,
    progress: &mut dyn FnMut(u64),
) -> Result<Vec<ImportReport>, SignalError> {
    let mut rows = table.file.rows(&table.columns, Captures::Several)?;
    let path = |capture: u64| out.join(format!("capture_{}", capture + 1));
    let mut bag = import.bag(path(0))?;
    let (mut reports, mut capture, mut count) = (Vec::new(), 0, 0);
    while let Some(stamp) = rows.next()? {
        if rows.capture != capture {
            capture = rows.capture;
            let next = import.bag(path(capture))?;
            reports.push(std::mem::replace(&mut bag, next).finish(Vec::new())?);
        }
        bag.write(0, stamp, &rows.row.values)?;
        count += 1;
        if u64::is_multiple_of(count, TOLD_EVERY) {
            progress(count);
        }
    }
    reports.push(bag.finish(rows.notes().into_iter().chain(import.marks()).collect())?);
    Ok(reports)
}

/// A table, and the columns of it that are imported.
struct Table {
    file: CsvFile,
    columns: Vec<(Signal, SignalSource)>,
    /// What is added to its times, ns.
    clock_offset: i64,
}

impl Table {
    fn open(path: &Path, mapping: &Mapping, clock_offset: i64) -> Result<Table, SignalError> {
        if is_recording(path) {
            return Err(SignalError::IsRecording { path: path.to_owned() });
        }
        let file = CsvFile::new(path, mapping)?;
        let columns = mapping
            .signals
            .iter()
            .filter(|(signal, _)| **signal != Signal::Time)
            .filter_map(|(signal, sources)| Some((*signal, sources.first()?.clone())))
            .collect();
        Ok(Table { file, columns, clock_offset })
    }
}

/// The rows of a table, of which one is at hand.
struct TableRows<'a> {
    rows: CsvRows<'a>,
    clock_offset: i64,
    /// Time of the row at hand, ns; `None` after the last one.
    stamp: Option<i64>,
}

impl<'a> TableRows<'a> {
    fn open(table: &'a Table) -> Result<Self, SignalError> {
        let rows = table.file.rows(&table.columns, Captures::One)?;
        let mut rows = Self { rows, clock_offset: table.clock_offset, stamp: None };
        rows.next()?;
        Ok(rows)
    }

    fn next(&mut self) -> Result<(), SignalError> {
        let on_clock = |stamp: i64| match stamp {
            NO_TIME => NO_TIME,
            stamp => stamp.saturating_add(self.clock_offset),
        };
        self.stamp = self.rows.next()?.map(on_clock);
        Ok(())
    }
}

/// The tables that become a bag: the recording, and what is joined with it.
struct Import<'a> {
    path: &'a Path,
    about: &'a BTreeMap<String, String>,
    tables: Vec<Table>,
    joint_type: Option<JointType>,
    unconfirmed: Vec<String>,
}

impl<'a> Import<'a> {
    fn open(
        path: &'a Path,
        mapping: &Mapping,
        about: &'a BTreeMap<String, String>,
    ) -> Result<Import<'a>, SignalError> {
        // Forces in a bag are in N.
        if mapping.without_force_constant {
            return Err(SignalError::Mapping {
                origin: path.display().to_string(),
                key: "signals.current".into(),
                reason: "a bag holds forces: give the `scale`, N (or N m) per A; 1 if amperes are \
                         to count as the force"
                    .into(),
            });
        }
        let joined = mapping
            .join
            .iter()
            .map(|other| Table::open(&other.path(path), &other.mapping, other.clock_offset_ns()));
        let tables = std::iter::once(Table::open(path, mapping, 0))
            .chain(joined)
            .collect::<Result<_, _>>()?;
        Ok(Import {
            path,
            about,
            tables,
            joint_type: mapping.joint_type,
            unconfirmed: mapping.unconfirmed.clone(),
        })
    }

    /// What the mapping still marks for a person to check.
    fn marks(&self) -> Option<SignalNote> {
        SignalNote::unconfirmed(&self.unconfirmed)
    }

    /// Tables that were not recorded at the same time are none of one motion.
    fn refuse_other_times(&self, bag: &ImportedBag) -> Result<(), SignalError> {
        let seconds = |stamp: i64| (stamp - bag.moved.unwrap_or(0)) as f64 * 1e-9;
        let mut spans = self.tables.iter().zip(&bag.tables).filter_map(|(table, rows)| {
            Some((&table.file, seconds(rows.first?), seconds(rows.last?)))
        });
        let Some((_, from_s, to_s)) = spans.next() else { return Ok(()) };
        match spans.find(|(_, begins_s, ends_s)| *begins_s > to_s || *ends_s < from_s) {
            Some((file, begins_s, _)) => {
                let joined = file.path.clone();
                Err(SignalError::NoTimeInCommon { joined, begins_s, from_s, to_s })
            }
            None => Ok(()),
        }
    }

    fn has(&self, signal: Signal) -> bool {
        self.tables.iter().flat_map(|table| &table.columns).any(|(s, ..)| *s == signal)
    }

    /// A bag for the rows.
    fn bag(&self, out: PathBuf) -> Result<ImportedBag, SignalError> {
        let mut bag = BagWriter::create(&out, &BagOptions::default())?;
        let mut about = self.about.clone();
        about.insert("source".to_owned(), self.path.display().to_string());
        about.extend(self.joint_type.map(|joint| (JOINT_TYPE.to_owned(), joint.name().to_owned())));
        bag.write_metadata(METADATA_NAME, about)?;
        let qos = OfferedQos::reliable(100);
        let encoder = bag.add_topic::<JointState>(topics::ENCODER, &qos)?;
        let topic = |bag: &mut BagWriter, name: &str, wanted: bool| {
            if wanted { bag.add_topic::<WrenchStamped>(name, &qos).map(Some) } else { Ok(None) }
        };
        let cell = topic(&mut bag, topics::FORCE_CELL, self.has(Signal::ForceCell))?;
        let force = topic(&mut bag, topics::FORCE, self.has(Signal::Force))?;
        let has_reference = self.has(Signal::ReferencePosition)
            || self.has(Signal::ReferenceVelocity)
            || self.has(Signal::ReferenceAcceleration);
        let setpoint = if has_reference {
            Some(bag.add_topic::<JointTrajectory>(topics::SETPOINT, &qos)?)
        } else {
            None
        };
        Ok(ImportedBag {
            bag,
            tables: self
                .tables
                .iter()
                .map(|table| WrittenRows {
                    signals: table.columns.iter().map(|(signal, _)| *signal).collect(),
                    first: None,
                    last: None,
                })
                .collect(),
            encoder,
            cell,
            force,
            setpoint,
            travelled: self.has(Signal::Velocity).then(Integral::default),
            moved: None,
            report: ImportReport {
                bag: out,
                rows: 0,
                messages: BTreeMap::new(),
                without_time: 0,
                not_later: 0,
                notes: Vec::new(),
                moved_s: 0.0,
            },
        })
    }
}

/// A bag that rows of a table are written into.
struct ImportedBag {
    bag: BagWriter,
    tables: Vec<WrittenRows>,
    encoder: TopicId,
    cell: Option<TopicId>,
    force: Option<TopicId>,
    setpoint: Option<TopicId>,
    /// The position where the velocity is measured.
    travelled: Option<Integral>,
    /// ns
    moved: Option<i64>,
    report: ImportReport,
}

/// What the rows of a table hold, and how far they are written.
struct WrittenRows {
    signals: Vec<Signal>,
    /// Time of the first row, ns.
    first: Option<i64>,
    /// Time of the row before, ns.
    last: Option<i64>,
}

impl ImportedBag {
    /// Writes the messages of a row of a table, by its number; values in SI, one for each column.
    fn write(&mut self, table: usize, stamp: i64, row: &[f64]) -> Result<(), SignalError> {
        self.report.rows += 1;
        if stamp == NO_TIME {
            self.report.without_time += 1;
            return Ok(());
        }
        // Log times of a bag are not negative, those that count from a trigger are.
        let moved = *self.moved.get_or_insert(stamp.saturating_neg().max(0));
        self.report.moved_s = moved as f64 * 1e-9;
        let stamp = stamp.saturating_add(moved);
        let Ok(log_time) = u64::try_from(stamp) else {
            self.report.without_time += 1;
            return Ok(());
        };
        let table = &mut self.tables[table];
        self.report.not_later += u64::from(table.last.is_some_and(|last| stamp <= last));
        table.first.get_or_insert(stamp);
        table.last = Some(stamp);
        let mut values = [f64::NAN; 8];
        for (signal, value) in table.signals.iter().zip(row) {
            values[*signal as usize] = *value;
        }
        if let Some(travelled) = &mut self.travelled {
            values[Signal::Position as usize] =
                travelled.next(stamp, values[Signal::Velocity as usize]);
        }
        let value = |signal: Signal| values[signal as usize];
        let header = Header::new(stamp, topics::JOINT);
        let list = |value: f64| {
            if value.is_finite() { vec![value] } else { Vec::new() }
        };
        let report = &mut self.report;
        let mut written = |topic: &str| match report.messages.get_mut(topic) {
            Some(count) => *count += 1,
            None => _ = report.messages.insert(topic.to_owned(), 1),
        };
        if value(Signal::Position).is_finite() {
            let state = JointState {
                header: header.clone(),
                name: vec![topics::JOINT.into()],
                position: list(value(Signal::Position)),
                velocity: Vec::new(),
                effort: list(value(Signal::ForceCell)),
            };
            self.bag.write(self.encoder, log_time, &state)?;
            written(topics::ENCODER);
        }
        let forces = [
            (self.cell, Signal::ForceCell, topics::FORCE_CELL),
            (self.force, Signal::Force, topics::FORCE),
        ];
        for (topic, signal, name) in forces {
            if let Some(topic) = topic.filter(|_| value(signal).is_finite()) {
                let wrench = WrenchStamped::along_x(header.clone(), value(signal));
                self.bag.write(topic, log_time, &wrench)?;
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
        if let Some(topic) = self.setpoint.filter(|_| !empty) {
            let setpoint = JointTrajectory {
                header,
                joint_names: vec![topics::JOINT.into()],
                points: vec![point],
            };
            self.bag.write(topic, log_time, &setpoint)?;
            written(topics::SETPOINT);
        }
        Ok(())
    }

    fn finish(self, notes: Vec<SignalNote>) -> Result<ImportReport, SignalError> {
        self.bag.finish()?;
        let mut report = self.report;
        report.notes = notes;
        report.notes.extend(self.travelled.map(|_| SignalNote::Integrated));
        Ok(report)
    }
}
