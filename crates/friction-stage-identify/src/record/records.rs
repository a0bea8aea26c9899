//! The records that identification gets: read, examined, joined, and compared with each other.
//!
//! What comes in are paths of bags or CSV files for both sides of the split, and the declared
//! model; what goes out are [`Records`] that can be compared sample by sample, with what a user
//! should know of them. Data that nothing can be identified from are an error.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use crate::error::IdentifyError;
use crate::finding::IdentifyFinding;
use crate::hypothesis::{Tolerances, allows};
use crate::record::joined::joined;
use crate::record::measured::Measured;
use friction_stage_core::model::StageModel;
use friction_stage_data::quality::{DataFinding, Severity, examine, outlier_rows};
use friction_stage_data::signals::{
    MOST_SAMPLES, Mapping, Recording, Signal, SignalError, Trace, Window, from_columns, load_part,
};

/// Samples in a row that must agree for two records to be the same there. Assumed: of positions in
/// motion, counted to a nanometre with a nanometre of noise, so many do not agree by accident.
const SAME: usize = 48;
/// Places of the hold-out that are looked up in the train record.
const PLACES: usize = 200;
/// Share of them that must be found there for the hold-out not to be held out.
const TOO_MANY: f64 = 0.1;

/// Part by which the rates of train and hold-out may differ: clocks do, settings differ by more.
/// Assumed.
const SAME_RATE: f64 = 0.01;

/// Share of the rows that may be filled in and left out: a filter of 200 Hz spans some 40 of them
/// at 2 kHz, so that hardly a row would be left with more.
const MOST_FILLED: f64 = 0.06;

/// Train and hold-out, ready for the search.
#[derive(Debug)]
pub struct Records {
    /// The record that is fitted.
    pub train: Record,
    /// The record that no fit sees.
    pub holdout: Record,
    /// What a user should know about the data.
    pub findings: Vec<IdentifyFinding>,
}

/// Where a recording comes from.
#[derive(Clone, Debug)]
pub enum RecordSource {
    /// A bag or a CSV file.
    File(PathBuf),
    /// Columns in memory, with a name for findings.
    Columns {
        /// Stands for the path.
        name: PathBuf,
        /// Rows need not be on a grid; an empty column is not recorded.
        columns: Trace,
    },
}

impl RecordSource {
    /// Its path, or what stands for it.
    pub fn path(&self) -> &Path {
        match self {
            RecordSource::File(path) | RecordSource::Columns { name: path, .. } => path,
        }
    }

    fn read(&self, mapping: Option<&Mapping>, part: Window) -> Result<Recording, SignalError> {
        let most = part.most.unwrap_or(MOST_SAMPLES).min(MOST_SAMPLES);
        let part = Window { most: Some(most), ..part };
        match self {
            RecordSource::File(path) => load_part(path, mapping, part),
            RecordSource::Columns { name, columns } => from_columns(name, columns, part),
        }
    }

    /// Whether both are the same file; columns are their own.
    fn is(&self, other: &RecordSource) -> bool {
        match (self, other) {
            (RecordSource::File(path), RecordSource::File(other)) => is_same(path, other),
            _ => false,
        }
    }
}

/// One side of the split: its recordings and what they are together.
#[derive(Debug)]
pub struct Record {
    /// Where its recordings are.
    pub paths: Vec<PathBuf>,
    /// Its recordings, each on its grid.
    pub recordings: Vec<Recording>,
    /// All of them along one motion.
    pub measured: Measured,
}

/// Why no records can be made of the recordings that were given.
#[derive(Debug, thiserror::Error)]
pub enum RecordsError {
    /// A recording that stands twice on the train side.
    #[error("{} stands twice among the train bags", path.display())]
    Twice {
        /// The recording.
        path: PathBuf,
    },
    /// A recording that is on both sides.
    #[error(
        "{} is both train and hold-out: an error on data that the fit has seen says nothing; hold \
         out another bag",
        path.display()
    )]
    BothSides {
        /// The recording.
        path: PathBuf,
    },
    /// A hold-out that is a part of the train record.
    #[error(
        "{:.0} % of the hold-out {} is in the train bag {} sample by sample: an error on data that \
         the fit has seen says nothing; hold out another recording",
        100.0 * share, holdout.display(), train.display()
    )]
    Seen {
        /// Share of the hold-out.
        share: f64,
        /// The hold-out.
        holdout: PathBuf,
        /// The train recording.
        train: PathBuf,
    },
    /// Signals that cannot be read.
    #[error(transparent)]
    Signals(#[from] SignalError),
    /// Signals from which nothing can be identified. `friction-stage-report` has the words for the
    /// findings.
    #[error("nothing can be identified from {}: {}", path.display(), codes(findings))]
    Unusable {
        /// The recording.
        path: PathBuf,
        /// What stands in the way, worst first.
        findings: Vec<DataFinding>,
    },
    /// No force that all recordings have.
    #[error(
        "train and hold-out have no force in common: all need the force cell, or all the force \
         command"
    )]
    NoCommonForce,
    /// Records that do not compare.
    #[error(transparent)]
    Compare(IdentifyError),
    /// A side from which nothing can be identified.
    #[error("nothing can be identified from {side}")]
    Side {
        /// The side, for people.
        side: &'static str,
        /// Why not.
        source: IdentifyError,
    },
}

fn codes(findings: &[DataFinding]) -> String {
    findings.iter().map(DataFinding::code).collect::<Vec<_>>().join(", ")
}

impl Records {
    /// Reads both sides: bags or tables, several of a side are joined. Of each recording `part` is
    /// read, [`MOST_SAMPLES`] of it at most. Every guard of the command line is here. A mass or a
    /// friction that the tolerances allow is that of no other machine.
    pub fn load(
        train: &[PathBuf],
        holdout: &[PathBuf],
        mapping: Option<&Mapping>,
        part: Window,
        model: &StageModel,
        tolerances: Tolerances,
    ) -> Result<Records, RecordsError> {
        let files = |paths: &[PathBuf]| -> Vec<RecordSource> {
            paths.iter().cloned().map(RecordSource::File).collect()
        };
        Records::read(&files(train), &files(holdout), mapping, part, model, tolerances)
    }

    /// As [`load`](Self::load), from files or from columns in memory.
    pub fn read(
        train: &[RecordSource],
        holdout: &[RecordSource],
        mapping: Option<&Mapping>,
        part: Window,
        model: &StageModel,
        tolerances: Tolerances,
    ) -> Result<Records, RecordsError> {
        for (index, source) in train.iter().enumerate() {
            if train[..index].iter().any(|other| source.is(other)) {
                return Err(RecordsError::Twice { path: source.path().to_owned() });
            }
        }
        for source in holdout {
            if train.iter().any(|other| source.is(other)) {
                return Err(RecordsError::BothSides { path: source.path().to_owned() });
            }
        }
        let mut findings = Vec::new();
        let mut read = |sources: &[RecordSource]| -> Result<Vec<Recording>, RecordsError> {
            sources
                .iter()
                .map(|source| read(source, mapping, part, (model, tolerances), &mut findings))
                .collect()
        };
        let (mut train_bags, mut holdout_bags) = (read(train)?, read(holdout)?);
        let paths = |sources: &[RecordSource]| -> Vec<PathBuf> {
            sources.iter().map(|source| source.path().to_owned()).collect()
        };
        let (train, holdout) = (&paths(train), &paths(holdout));
        for (path, bag) in holdout.iter().zip(&holdout_bags) {
            for (other, seen) in train.iter().zip(&train_bags) {
                let share = share_seen(&bag.trace.position, &seen.trace.position);
                if share > TOO_MANY {
                    let (holdout, train) = (path.clone(), other.clone());
                    return Err(RecordsError::Seen { share, holdout, train });
                }
            }
        }
        common_signals(&mut train_bags, &mut holdout_bags, &mut findings)?;
        let rate_of = |bags: &[Recording]| bags.first().map_or(f64::NAN, |bag| bag.rate);
        let (first, other) = (rate_of(&train_bags), rate_of(&holdout_bags));
        if (other / first - 1.0).abs() > SAME_RATE {
            return Err(RecordsError::Compare(IdentifyError::Rates { first, other }));
        }
        let train = Record::new("the train record", train, train_bags, model)?;
        let holdout = Record::new("the hold-out record", holdout, holdout_bags, model)?;
        if train.recordings.len().max(holdout.recordings.len()) > 1 {
            findings.push(IdentifyFinding::Joined);
        }
        Ok(Records { train, holdout, findings })
    }
}

/// Reads a recording and leaves out what no motion made.
fn read(
    source: &RecordSource,
    mapping: Option<&Mapping>,
    part: Window,
    (model, tolerances): (&StageModel, Tolerances),
    findings: &mut Vec<IdentifyFinding>,
) -> Result<Recording, RecordsError> {
    let path = source.path();
    let mut recording = source.read(mapping, part)?;
    let examined = |recording: &Recording| {
        let mut found = examine(recording, Some(model)).findings;
        // What may be another value is not wrong.
        found.retain(|finding| match finding {
            DataFinding::OtherMachine { declared, measured, .. } => {
                !allows(tolerances.mass, *declared, *measured)
            }
            DataFinding::OtherFriction { declared, measured, .. } => {
                !allows(tolerances.guides, *declared, *measured)
            }
            _ => true,
        });
        found
    };
    let mut found = examined(&recording);
    let (broken, _): (Vec<DataFinding>, Vec<_>) =
        found.iter().cloned().partition(|finding| finding.broken_signal().is_some());
    if !broken.is_empty() {
        broken.iter().for_each(|finding| leave_out(&mut recording, finding));
        found = examined(&recording);
    }
    let fatal: Vec<DataFinding> =
        found.iter().filter(|finding| finding.severity() == Severity::Fatal).cloned().collect();
    if !fatal.is_empty() {
        let findings = fatal.into_iter().chain(broken).collect();
        return Err(RecordsError::Unusable { path: path.to_owned(), findings });
    }
    let share = recording.share_filled();
    if share > 0.0 {
        let compared = share > MOST_FILLED;
        if !compared {
            recording.leave_out_filled();
        }
        findings.push(IdentifyFinding::Filled { recording: path.to_owned(), share, compared });
    }
    for note in recording.quality.notes.iter().cloned() {
        findings.push(IdentifyFinding::Reading { recording: path.to_owned(), note });
    }
    let broken = broken.into_iter().map(|finding| (finding, true));
    for (finding, left_out) in broken.chain(found.into_iter().map(|finding| (finding, false))) {
        findings.push(IdentifyFinding::Data { recording: path.to_owned(), finding, left_out });
    }
    Ok(recording)
}

fn is_same(path: &Path, other: &Path) -> bool {
    match (path.canonicalize(), other.canonicalize()) {
        (Ok(a), Ok(b)) => a == b,
        _ => path == other,
    }
}

impl Record {
    fn new(
        side: &'static str,
        paths: &[PathBuf],
        recordings: Vec<Recording>,
        model: &StageModel,
    ) -> Result<Record, RecordsError> {
        let traces: Vec<&Trace> = recordings.iter().map(|recording| &recording.trace).collect();
        let measured = match traces.as_slice() {
            [trace] => Measured::new(trace, model, side),
            traces => joined(traces, model).and_then(|trace| Measured::new(&trace, model, side)),
        };
        let measured = measured.map_err(|source| RecordsError::Side { side, source })?;
        Ok(Record { paths: paths.to_vec(), recordings, measured })
    }

    /// Its recordings as columns.
    pub fn traces(&self) -> impl Iterator<Item = &Trace> {
        self.recordings.iter().map(|recording| &recording.trace)
    }

    /// Lowest and highest position, m.
    pub fn stroke(&self) -> (f64, f64) {
        let finite = self.traces().flat_map(|trace| &trace.position).filter(|x| x.is_finite());
        finite
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(*x), high.max(*x)))
    }
}

/// Takes the values that a finding is about as missing.
fn leave_out(recording: &mut Recording, finding: &DataFinding) {
    match finding {
        DataFinding::Constant { signal, value } | DataFinding::Clipped { signal, value, .. } => {
            recording.leave_out(*signal, |found| found == *value);
        }
        DataFinding::Stuck { signal, stretches, .. } => {
            let rows: Vec<usize> = stretches.iter().cloned().flatten().collect();
            recording.leave_out_rows(*signal, &rows);
        }
        DataFinding::Outliers { signal, .. } => {
            let rows = outlier_rows(recording, *signal);
            recording.leave_out_rows(*signal, &rows);
        }
        _ => {}
    }
}

/// Leaves out a force that only some of the recordings have: errors on one side of the cell do not
/// compare with errors on both.
fn common_signals(
    train: &mut [Recording],
    holdout: &mut [Recording],
    findings: &mut Vec<IdentifyFinding>,
) -> Result<(), RecordsError> {
    let mut left = 0;
    for signal in [Signal::ForceCell, Signal::Force] {
        let with =
            train.iter().chain(holdout.iter()).filter(|recording| recording.has(signal)).count();
        if with == train.len() + holdout.len() {
            left += 1;
            continue;
        }
        if with > 0 {
            findings.push(IdentifyFinding::NotCommon { signal });
        }
        for recording in train.iter_mut().chain(holdout.iter_mut()) {
            let column = match signal {
                Signal::ForceCell => &mut recording.trace.force_cell,
                _ => &mut recording.trace.force,
            };
            column.fill(f64::NAN);
        }
    }
    if left == 0 { Err(RecordsError::NoCommonForce) } else { Ok(()) }
}

/// Share of a record's stretches in motion that are in another record, value by value.
fn share_seen(position: &[f64], other: &[f64]) -> f64 {
    if position.len() < SAME || other.len() < SAME {
        return 0.0;
    }
    let mut places: HashMap<u64, Vec<usize>> = HashMap::new();
    for (row, value) in other.iter().enumerate() {
        places.entry(value.to_bits()).or_default().push(row);
    }
    let step = (position.len() / PLACES).max(1);
    let (mut seen, mut all) = (0usize, 0usize);
    for start in (0..position.len() - SAME).step_by(step) {
        let piece = &position[start..start + SAME];
        let mut distinct: Vec<u64> = piece.iter().map(|value| value.to_bits()).collect();
        distinct.sort_unstable();
        distinct.dedup();
        if distinct.len() < SAME / 2 || piece.iter().any(|value| !value.is_finite()) {
            continue;
        }
        all += 1;
        let found = places.get(&piece[0].to_bits()).is_some_and(|rows| {
            rows.iter()
                .any(|row| other.get(*row..row + SAME).is_some_and(|stretch| stretch == piece))
        });
        seen += usize::from(found);
    }
    if all == 0 { 0.0 } else { seen as f64 / all as f64 }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use friction_stage_data::signals::SignalNote;

    use super::*;

    #[test]
    fn a_part_of_the_train_record_is_recognised() {
        let train: Vec<f64> =
            (0..20_000).map(|k| ((k as f64 * 0.003).sin() * 1e7).round() * 1e-9).collect();
        let fresh: Vec<f64> =
            (0..20_000).map(|k| ((k as f64 * 0.0031 + 0.1).sin() * 1e7).round() * 1e-9).collect();
        assert_eq!(share_seen(&train[3000..9000], &train), 1.0);
        assert_eq!(share_seen(&fresh, &train), 0.0);
        assert_eq!(share_seen(&train[..10], &train), 0.0);
    }

    /// 40 kg, 70 N of Coulomb friction, to and fro by 20 mm.
    #[test]
    fn of_a_recording_that_is_too_long_the_first_samples_are_used() {
        let (count, rate, pulse) = (MOST_SAMPLES + 100, 2000.0, TAU * 0.5);
        let over = |of: &dyn Fn(f64) -> f64| -> Vec<f64> {
            (0..count).map(|row| of(row as f64 / rate)).collect()
        };
        let force = over(&|t| {
            0.02 * pulse * (-40.0 * pulse * (pulse * t).sin()) + 70.0 * (pulse * t).cos().signum()
        });
        let none = vec![f64::NAN; count];
        let trace = Trace {
            origin_ns: 0,
            time: over(&|t| t),
            position: over(&|t| 0.02 * (pulse * t).sin()),
            force_cell: none.clone(),
            force,
            reference_position: none.clone(),
            reference_velocity: none.clone(),
            reference_acceleration: none,
        };
        let home = tempfile::TempDir::new().unwrap();
        let path = home.path().join("long.csv");
        trace.write_csv(&path).unwrap();
        let mut findings = Vec::new();
        let bag = read(
            &RecordSource::File(path),
            None,
            Window::default(),
            (&StageModel::default(), Tolerances::default()),
            &mut findings,
        )
        .unwrap();
        assert_eq!(bag.trace.len(), MOST_SAMPLES);
        assert_eq!(bag.trace.position, trace.position[..MOST_SAMPLES]);
        let used = |finding: &IdentifyFinding| match finding {
            IdentifyFinding::Reading { note: SignalNote::OnlyPart { samples, .. }, .. } => {
                Some(*samples)
            }
            _ => None,
        };
        assert_eq!(findings.iter().find_map(used), Some(600_000), "{findings:?}");
    }
}
