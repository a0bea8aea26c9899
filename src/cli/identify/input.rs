//! The records that identification gets: read, examined, joined, and compared with each other.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::Context as _;

use crate::cli::WrongArguments;
use friction_stage_core::model::StageModel;
use friction_stage_data::quality::{self, DataProblem, Severity};
use friction_stage_data::signals::{self, Mapping, Recording, Signal, Trace};
use friction_stage_identify::{IdentifyError, Measured, joined};

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

/// Most samples of a bag that are used: a search over twice as many takes more than a gigabyte.
/// Five minutes at 2 kHz are more than a fit needs.
const MOST_SAMPLES: usize = 600_000;
/// Share of the rows that may be filled in and left out: a filter of 200 Hz spans some 40 of them
/// at 2 kHz, so that hardly a row would be left with more.
const MOST_FILLED: f64 = 0.06;

/// Train and hold-out, ready for the search.
pub struct Input {
    pub train: Record,
    pub holdout: Record,
    /// What a user should know about the data.
    pub warnings: Vec<String>,
}

/// One side of the split: its bags and what they are together.
pub struct Record {
    pub paths: Vec<PathBuf>,
    pub recordings: Vec<Recording>,
    pub measured: Measured,
}

impl Input {
    pub fn load(
        train: &[PathBuf],
        holdout: &[PathBuf],
        mapping: Option<&Mapping>,
        model: &StageModel,
    ) -> anyhow::Result<Input> {
        for (index, path) in train.iter().enumerate() {
            if train[..index].iter().any(|other| is_same(path, other)) {
                return Err(WrongArguments(format!(
                    "{} stands twice among the train bags",
                    path.display()
                ))
                .into());
            }
        }
        for path in holdout {
            if train.iter().any(|other| is_same(path, other)) {
                return Err(WrongArguments(format!(
                    "{} is both train and hold-out: an error on data that the fit has seen says \
                     nothing; hold out another bag",
                    path.display()
                ))
                .into());
            }
        }
        let mut warnings = Vec::new();
        let mut train_bags = Self::read(train, mapping, model, &mut warnings)?;
        let mut holdout_bags = Self::read(holdout, mapping, model, &mut warnings)?;
        for (path, bag) in holdout.iter().zip(&holdout_bags) {
            for (other, seen) in train.iter().zip(&train_bags) {
                let share = share_seen(&bag.trace.position, &seen.trace.position);
                anyhow::ensure!(
                    share <= TOO_MANY,
                    "{:.0} % of the hold-out {} is in the train bag {} sample by sample: an error \
                     on data that the fit has seen says nothing; hold out another recording",
                    100.0 * share,
                    path.display(),
                    other.display()
                );
            }
        }
        common_signals(&mut train_bags, &mut holdout_bags, &mut warnings)?;
        let rate_of = |bags: &[Recording]| bags.first().map_or(f64::NAN, |bag| bag.rate);
        let (first, other) = (rate_of(&train_bags), rate_of(&holdout_bags));
        if (other / first - 1.0).abs() > SAME_RATE {
            return Err(IdentifyError::Rates { first, other }.into());
        }
        let train = Record::new("the train record", train, train_bags, model)?;
        let holdout = Record::new("the hold-out record", holdout, holdout_bags, model)?;
        if train.recordings.len().max(holdout.recordings.len()) > 1 {
            warnings.push(
                "several bags of a record are joined one behind the other: effects over time \
                 (drift, warm-up, vibration, a map over time) are fitted as if time ran on from \
                 bag to bag"
                    .to_owned(),
            );
        }
        Ok(Input { train, holdout, warnings })
    }

    fn read(
        paths: &[PathBuf],
        mapping: Option<&Mapping>,
        model: &StageModel,
        warnings: &mut Vec<String>,
    ) -> anyhow::Result<Vec<Recording>> {
        let mut bags = Vec::new();
        for path in paths {
            let mut recording = signals::load(path, mapping)?;
            if recording.trace.len() > MOST_SAMPLES {
                warnings.push(format!(
                    "{}: of {} samples the first {MOST_SAMPLES} are used ({:.0} s): cut the \
                     recording to choose others",
                    path.display(),
                    recording.trace.len(),
                    MOST_SAMPLES as f64 / recording.rate
                ));
                recording.truncate(MOST_SAMPLES);
            }
            let mut found = quality::examine(&recording, Some(model));
            let broken: Vec<DataProblem> =
                found.problems.iter().filter(|problem| is_broken(problem)).cloned().collect();
            if !broken.is_empty() {
                broken.iter().for_each(|problem| leave_out(&mut recording, problem));
                found = quality::examine(&recording, Some(model));
            }
            let fatal: Vec<String> = found
                .problems
                .iter()
                .filter(|problem| problem.severity() == Severity::Fatal)
                .chain(&broken)
                .map(ToString::to_string)
                .collect();
            anyhow::ensure!(
                fatal.len() == broken.len(),
                "nothing can be identified from {}: {}",
                path.display(),
                fatal.join("; ")
            );
            let share = recording.share_filled();
            if share > MOST_FILLED {
                warnings.push(format!(
                    "{}: {:.1} % of the rows are filled in for samples that are missing: what \
                     these are off by counts as residual",
                    path.display(),
                    100.0 * share
                ));
            } else if share > 0.0 {
                recording.leave_out_filled();
                warnings.push(format!(
                    "{}: {:.2} % of the rows are filled in for samples that are missing: forces \
                     are not compared there",
                    path.display(),
                    100.0 * share
                ));
            }
            let broken =
                broken.iter().map(|problem| format!("{problem}; these values are left out"));
            let found = found.problems.iter().map(ToString::to_string);
            for warning in recording.quality.notes.iter().cloned().chain(broken).chain(found) {
                warnings.push(format!("{}: {warning}", path.display()));
            }
            bags.push(recording);
        }
        Ok(bags)
    }
}

fn is_same(path: &Path, other: &Path) -> bool {
    match (path.canonicalize(), other.canonicalize()) {
        (Ok(a), Ok(b)) => a == b,
        _ => path == other,
    }
}

impl Record {
    fn new(
        name: &str,
        paths: &[PathBuf],
        recordings: Vec<Recording>,
        model: &StageModel,
    ) -> anyhow::Result<Record> {
        let traces: Vec<&Trace> = recordings.iter().map(|recording| &recording.trace).collect();
        let measured = match traces.as_slice() {
            [trace] => Measured::new(trace, model, name),
            traces => joined(traces, model).and_then(|trace| Measured::new(&trace, model, name)),
        };
        let measured =
            measured.with_context(|| format!("nothing can be identified from {name}"))?;
        Ok(Record { paths: paths.to_vec(), recordings, measured })
    }

    pub fn traces(&self) -> impl Iterator<Item = &Trace> {
        self.recordings.iter().map(|recording| &recording.trace)
    }
}

/// Whether a signal has values that no motion made: those of a cable that is off, or of a range
/// that has ended.
fn is_broken(problem: &DataProblem) -> bool {
    matches!(
        problem,
        DataProblem::Constant { .. }
            | DataProblem::Clipped { .. }
            | DataProblem::Stuck { .. }
            | DataProblem::Outliers { .. }
    )
}

fn leave_out(recording: &mut Recording, problem: &DataProblem) {
    if let DataProblem::Constant { signal, value }
    | DataProblem::Clipped { signal, value, .. }
    | DataProblem::Stuck { signal, value, .. } = problem
    {
        recording.leave_out(*signal, |found| found == *value);
    } else if let DataProblem::Outliers { signal, .. } = problem {
        let rows = recording.outliers(*signal);
        recording.leave_out_rows(*signal, &rows);
    }
}

/// Leaves out a force that only some of the recordings have: errors on one side of the cell do not
/// compare with errors on both.
fn common_signals(
    train: &mut [Recording],
    holdout: &mut [Recording],
    warnings: &mut Vec<String>,
) -> anyhow::Result<()> {
    let mut left = 0;
    for signal in [Signal::ForceCell, Signal::Force] {
        let with =
            train.iter().chain(holdout.iter()).filter(|recording| recording.has(signal)).count();
        if with == train.len() + holdout.len() {
            left += 1;
            continue;
        }
        if with > 0 {
            warnings
                .push(format!("not every recording has {signal}: it is left out of all of them"));
        }
        for recording in train.iter_mut().chain(holdout.iter_mut()) {
            let column = match signal {
                Signal::ForceCell => &mut recording.trace.force_cell,
                _ => &mut recording.trace.force,
            };
            column.fill(f64::NAN);
        }
    }
    anyhow::ensure!(
        left > 0,
        "train and hold-out have no force in common: all need the force cell, or all the force \
         command"
    );
    Ok(())
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
        let mut warnings = Vec::new();
        let bags = Input::read(&[path], None, &StageModel::default(), &mut warnings).unwrap();
        assert_eq!(bags[0].trace.len(), MOST_SAMPLES);
        assert_eq!(bags[0].trace.position, trace.position[..MOST_SAMPLES]);
        assert!(
            warnings[0].contains("of 600100 samples the first 600000 are used (300 s)"),
            "{warnings:?}"
        );
    }
}
