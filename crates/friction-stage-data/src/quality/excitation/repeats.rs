//! Values that repeat from row to row: a carriage at rest, a motor at its limit, or a sensor that
//! is dead.
//!
//! A value that repeats is no fault by itself: a carriage rests, and a command is held. A sensor is
//! dead where a repeat contradicts what the same signal shows elsewhere. Its noise has gone: from
//! row to row it would have turned back many times, and does not. Or the carriage would have
//! stopped or started with an acceleration that it has nowhere else.

use std::ops::Range;

use super::Examiner;
use crate::quality::finding::{DataFinding, DeadEvidence};
use crate::signals::Signal;

/// Shortest repeat, s, that is called dead away from the extremes. Assumed: a shorter one changes
/// no identification.
const LONG: f64 = 0.25;
/// Rows at an extreme, in a row, that make it a limit and no chance.
const CLIPPED_RUN: usize = 3;
/// Noise, in counts, of which a repeat over so many rows is no chance: what counts alone make of a
/// motion shows as 0.41 of one at the most, and of noise of 0.6 of one every second row is another.
const SILENT: (f64, usize) = (0.6, 40);
/// Roundings of double-precision numbers, in those of the largest value: what arithmetic makes of a
/// motion is no noise of a sensor. Assumed: a few operations per value.
const ROUNDINGS: f64 = 16.0;
/// Rows to either side in which the count of a place is looked for: numbers with a fixed number of
/// digits have another one at each size.
const AROUND: usize = 32;
/// Part of a stretch, at either end, that says nothing of whether a force goes on: a tenth, in
/// which the lag of a motor ends. Assumed.
const ENDS: usize = 10;
/// Part of the rows, the slowest, that show the noise. Assumed: a recording has rests or slow moves
/// in it.
const SLOWEST: f64 = 0.1;
/// Second differences, in those that the record shows away from repeats, that no machine makes, and
/// the part of them that counts as usual. Assumed.
const ABRUPT: (f64, f64) = (3.0, 0.999);

impl Examiner<'_> {
    /// Whether the measured motion repeats where the carriage cannot have done so: at an extreme of
    /// its range, or anywhere for long. A velocity that becomes constant is an acceleration that
    /// ends, which the force shows: it is cut off where a force changes as if nothing had ended.
    pub(super) fn dead_encoder(&mut self) {
        let (signal, x) = self.measured();
        let is_velocity = signal == Signal::Velocity;
        let forces = self.with_spans(&[Signal::ForceCell, Signal::Force]);
        let mut runs = repeats(x);
        let usual = usual_second_difference(x, &runs);
        let is_noisy = noise_in_counts(x, &runs) >= SILENT.0;
        if is_velocity {
            runs.retain(|run| {
                let lag = run.len() / ENDS;
                let inner = run.start + lag..run.end - lag;
                x[run.start] != 0.0 && Self::driven(&inner, &forces)
            });
        }
        let rounding = rounding(x);
        let abrupt = |run: &Range<usize>| {
            second_difference_at_ends(x, run) > ABRUPT.0 * usual.max(count_at(x, run, rounding))
        };
        let silent = |run: &Range<usize>| is_noisy && run.len() >= SILENT.1;
        let [low, high] = extremes(x);
        let mut clipped = Vec::new();
        for extreme in [low, high] {
            // Where another stretch ends just there, it is the one that was cut off.
            let after_another = |run: &&Range<usize>| {
                runs.iter().any(|other| other.end <= run.start && run.start < other.end + 2)
            };
            let at = runs.iter().filter(|run| x[run.start] == extreme);
            let at = at.filter(|run| silent(run) || (abrupt(run) && !after_another(run)));
            let rows: usize = at.map(Range::len).sum();
            if rows > 0 {
                clipped.push(extreme);
                self.findings.push(DataFinding::Clipped { signal, value: extreme, rows });
            }
        }
        let long: Vec<Range<usize>> = runs
            .iter()
            .filter(|run| run.len() as f64 > LONG * self.recording.rate)
            .filter(|run| !clipped.contains(&x[run.start]))
            .cloned()
            .collect();
        let jumps: Vec<Range<usize>> = long.iter().filter(|run| abrupt(run)).cloned().collect();
        let others =
            self.with_spans(&[Signal::ReferencePosition, Signal::ForceCell, Signal::Force]);
        let silent: Vec<Range<usize>> = long
            .into_iter()
            .filter(|run| !jumps.contains(run) && silent(run) && Self::driven(run, &others))
            .collect();
        self.dead(signal, jumps, DeadEvidence::Abrupt);
        self.dead(signal, silent, DeadEvidence::Silent);
    }

    /// Whether a force loses its noise at an extreme: there its range ends, or that of a drive.
    /// Returns the extremes at which it does.
    pub(super) fn clipped(&mut self, signal: Signal) -> Vec<f64> {
        let column = self.column(signal);
        let runs = repeats(column);
        let is_noisy = noise_in_counts(column, &runs) >= SILENT.0;
        let mut clipped = Vec::new();
        for value in extremes(column).into_iter().filter(|_| is_noisy) {
            let at = runs.iter().filter(|run| column[run.start] == value);
            let rows: usize = at.map(Range::len).sum();
            // Zero for a long time is a motor without a command.
            if value != 0.0 && rows >= SILENT.1 {
                clipped.push(value);
                self.findings.push(DataFinding::Clipped { signal, value, rows });
            }
        }
        clipped
    }

    /// Whether a force cell is cut off at an extreme, or loses its noise anywhere for long while
    /// the stage is driven.
    pub(super) fn dead_cell(&mut self) {
        let signal = Signal::ForceCell;
        let column = self.column(signal);
        let clipped = self.clipped(signal);
        let runs = repeats(column);
        let others = [Signal::Position, Signal::ReferencePosition, Signal::ReferenceVelocity];
        let others = self.with_spans(&others);
        let is_noisy = noise_in_counts(column, &runs) >= SILENT.0;
        let silent = runs
            .into_iter()
            .filter(|run| is_noisy && run.len() as f64 > LONG * self.recording.rate)
            .filter(|run| column[run.start] != 0.0 && !clipped.contains(&column[run.start]))
            .filter(|run| Self::driven(run, &others))
            .collect();
        self.dead(signal, silent, DeadEvidence::Silent);
    }

    /// Says of which stretches a signal is dead, if there are any.
    fn dead(&mut self, signal: Signal, stretches: Vec<Range<usize>>, evidence: DeadEvidence) {
        let Some(longest) = stretches.iter().max_by_key(|run| run.len()) else {
            return;
        };
        self.findings.push(DataFinding::Stuck {
            signal,
            value: self.column(signal)[longest.start],
            seconds: longest.len() as f64 * self.step,
            rows: longest.len(),
            evidence,
            stretches: stretches.clone(),
        });
    }

    /// The columns of the signals that are recorded, each with what it spans.
    fn with_spans(&self, signals: &[Signal]) -> Vec<(&[f64], f64)> {
        let recorded = signals.iter().filter(|signal| self.recording.has(**signal));
        recorded.map(|signal| self.column(*signal)).map(|column| (column, span(column))).collect()
    }

    /// Whether one of the columns moves on during a stretch, by at least a tenth of what it does in
    /// all.
    fn driven(run: &Range<usize>, columns: &[(&[f64], f64)]) -> bool {
        columns
            .iter()
            .any(|(column, whole)| span(&column[run.clone()]) > 0.1 * whole.max(f64::MIN_POSITIVE))
    }

    /// Whether the command reaches the declared limit of the motor, or a limit that is not
    /// declared. A command that is held is none: it has no sensor that could be dead.
    pub(super) fn saturated(&mut self) {
        let column = self.column(Signal::Force);
        let limit = self.model.map_or(f64::INFINITY, |model| model.motor.force_limit);
        let rows = column.iter().filter(|force| force.abs() >= limit).count();
        if rows == 0 {
            self.clipped(Signal::Force);
        } else {
            let largest = extremes(column).into_iter().map(f64::abs).fold(0.0, f64::max);
            self.findings.push(DataFinding::Saturated { largest, limit, rows });
        }
    }
}

/// Stretches of at least [`CLIPPED_RUN`] rows with one value.
fn repeats(column: &[f64]) -> Vec<Range<usize>> {
    let mut row = 0;
    let runs = column.chunk_by(|a, b| a == b).map(|run| {
        row += run.len();
        row - run.len()..row
    });
    runs.filter(|run| run.len() >= CLIPPED_RUN).collect()
}

/// Lowest and highest value.
pub(super) fn extremes(column: &[f64]) -> [f64; 2] {
    let finite = column.iter().filter(|value| value.is_finite());
    finite.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(*v), high.max(*v)])
}

/// The least step from row to row; infinite if there is none.
fn smallest_step(values: &[f64]) -> f64 {
    let steps = values.windows(2).map(|pair| (pair[1] - pair[0]).abs());
    steps.filter(|step| *step > 0.0).fold(f64::INFINITY, f64::min)
}

/// The count of the values around a stretch: steps are multiples of it, and so is what one step
/// differs by from the next, which is less where a motion is even and fast.
fn count_at(column: &[f64], run: &Range<usize>, rounding: f64) -> f64 {
    let before = &column[run.start.saturating_sub(AROUND)..=run.start];
    let after = &column[run.end - 1..column.len().min(run.end + AROUND)];
    let of_steps = |values: &[f64]| {
        let differences = values.windows(3).map(|w| (w[2] - 2.0 * w[1] + w[0]).abs());
        let least = differences.filter(|found| *found > rounding).fold(f64::INFINITY, f64::min);
        least.min(smallest_step(values))
    };
    let count = of_steps(before).min(of_steps(after));
    if count.is_finite() { count.max(rounding) } else { 0.0 }
}

/// What lies between the lowest and the highest value; 0 without one.
fn span(values: &[f64]) -> f64 {
    let [low, high] = extremes(values);
    if low < high { high - low } else { 0.0 }
}

/// What arithmetic makes of the largest value.
fn rounding(column: &[f64]) -> f64 {
    ROUNDINGS * f64::EPSILON * extremes(column).into_iter().map(f64::abs).fold(0.0, f64::max)
}

/// White noise in counts, where the signal moves slowest and does not repeat for long: the median
/// of third differences, over the root of 20, each in the count of its place. 0 where nothing shows
/// it: noise turns from row to row, so most of its third differences have another sign than the
/// next (77 % of white noise), while those of a finely resolved motion do not.
fn noise_in_counts(column: &[f64], runs: &[Range<usize>]) -> f64 {
    let mut free = vec![true; column.len()];
    let long = runs.iter().filter(|run| run.len() >= SILENT.1);
    long.for_each(|run| free[run.clone()].fill(false));
    let rounding = rounding(column);
    let mut windows: Vec<(f64, f64, usize, f64)> = column
        .windows(6)
        .zip(free.windows(6))
        .enumerate()
        .filter(|(_, (_, free))| free.iter().all(|free| *free))
        .map(|(row, (w, _))| {
            let third = w[4] - 3.0 * w[3] + 3.0 * w[2] - w[1];
            let next = w[5] - 3.0 * w[4] + 3.0 * w[3] - w[2];
            let turns = third.signum() * next.signum() * f64::from(u8::from(third * next != 0.0));
            ((w[5] - w[0]).abs(), third.abs() / 20f64.sqrt(), row, turns)
        })
        .filter(|(speed, third, ..)| speed.is_finite() && third.is_finite())
        .collect();
    let slow = (SLOWEST * windows.len() as f64) as usize;
    if slow == 0 {
        return 0.0;
    }
    let goes_on = |windows: &[(f64, f64, usize, f64)]| {
        windows.iter().map(|(.., turns)| turns).sum::<f64>() > 0.0
    };
    // Of a signal that is cut off nearly everywhere the slowest show nothing, of a fast motion all
    // of them show the motion.
    let all_go_on = goes_on(&windows);
    let (slowest, ..) = windows.select_nth_unstable_by(slow, |a, b| a.0.total_cmp(&b.0));
    if all_go_on && goes_on(slowest) {
        return 0.0;
    }
    let in_counts = |(_, third, row, _): &(f64, f64, usize, f64)| {
        let around = row.saturating_sub(AROUND)..column.len().min(row + AROUND);
        third / smallest_step(&column[around]).max(rounding)
    };
    let mut counts: Vec<f64> = slowest.iter().map(in_counts).collect();
    *counts.select_nth_unstable_by(slow / 2, f64::total_cmp).1 / 0.6745
}

/// Largest second difference of the rows at which a stretch begins and ends.
fn second_difference_at_ends(column: &[f64], run: &Range<usize>) -> f64 {
    let at = |row: usize| match (row.checked_sub(1), column.get(row + 1)) {
        (Some(before), Some(after)) => (after - 2.0 * column[row] + column[before]).abs(),
        _ => 0.0,
    };
    let rows = [run.start.wrapping_sub(1), run.start, run.end - 1, run.end];
    let rows = rows.into_iter().filter(|row| *row < column.len());
    rows.map(at).filter(|found| found.is_finite()).fold(0.0, f64::max)
}

/// What second differences the record shows, but for the largest few, away from stretches that
/// repeat.
fn usual_second_difference(column: &[f64], runs: &[Range<usize>]) -> f64 {
    let mut free = vec![true; column.len()];
    for run in runs {
        free[run.start.saturating_sub(2)..column.len().min(run.end + 2)].fill(false);
    }
    let mut found: Vec<f64> = column
        .windows(3)
        .zip(&free[1..])
        .filter(|(_, free)| **free)
        .map(|(w, _)| (w[2] - 2.0 * w[1] + w[0]).abs())
        .filter(|found| found.is_finite())
        .collect();
    if found.is_empty() {
        return 0.0;
    }
    let usual = (ABRUPT.1 * (found.len() - 1) as f64) as usize;
    *found.select_nth_unstable_by(usual, f64::total_cmp).1
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A carriage on coarse counts that rests, and one whose encoder is dead for as long.
    #[test]
    fn a_rest_begins_and_ends_softly_and_a_dead_encoder_does_not() {
        let motion = |k: usize| 0.02 * (1.0 - (k as f64 * 2e-3).cos());
        let count = |x: f64| (x * 1e6).round() * 1e-6;
        let rest: Vec<f64> = (0..8000)
            .map(|k| match k {
                0..3142 => count(motion(k)),
                3142..4142 => count(motion(3142)),
                _ => count(motion(k - 1000)),
            })
            .collect();
        let mut dead: Vec<f64> = (0..8000).map(|k| count(motion(k))).collect();
        let value = dead[2000];
        dead[2000..2500].fill(value);
        let abrupt = |x: &[f64]| {
            let runs = repeats(x);
            let usual = usual_second_difference(x, &runs).max(1e-6);
            let is_abrupt =
                |run: &&Range<usize>| second_difference_at_ends(x, run) > ABRUPT.0 * usual;
            runs.iter().filter(is_abrupt).cloned().collect::<Vec<_>>()
        };
        assert_eq!(abrupt(&rest), Vec::<Range<usize>>::new());
        assert_eq!(abrupt(&dead), vec![2000..2500]);
    }

    /// Noise of a third of a count comes and goes with the place in the count; noise of a count and
    /// more does not. A motion without noise shows its counts alone, however few digits they have.
    #[test]
    fn noise_is_told_in_the_counts_of_its_place() {
        let noise = |k: usize| (k as f64 * 12.9898).sin() * 43758.5453 % 1.0;
        let read = |size: f64| -> Vec<f64> {
            (0..4000).map(|k| (0.4 + size * noise(k)).round()).collect()
        };
        let seen = |x: &[f64]| noise_in_counts(x, &repeats(x));
        assert!(seen(&read(0.3)) < SILENT.0);
        assert!(seen(&read(3.0)) > SILENT.0);
        for digits in [1e3, 1e4, 1e5] {
            let motion: Vec<f64> = (0..8000)
                .map(|k| {
                    let x = 50.0 * (k as f64 * 2e-3).sin() + 50.1;
                    let scale = digits / 10f64.powi(x.log10().floor() as i32);
                    (x * scale).round() / scale
                })
                .collect();
            assert!(seen(&motion) < SILENT.0, "{digits}: {}", seen(&motion));
        }
    }
}
