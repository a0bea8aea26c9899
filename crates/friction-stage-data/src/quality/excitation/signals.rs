//! Signals that are constant, cut off, stuck, sparse, or have samples that no machine made.

use std::ops::Range;

use super::Examiner;
use crate::quality::finding::DataFinding;
use crate::quality::outliers::outlier_rows;
use crate::signals::{ClockKind, Signal};

/// Longest time, s, for which a signal that changes from row to row elsewhere may have one value
/// while the stage is driven; and share of the rows elsewhere that may repeat the one before.
/// Assumed: noise repeats no number of seven digits, let alone for so long.
const STUCK: (f64, f64) = (0.25, 0.1);
/// Rows at an extreme, in a row, that make it a limit and no chance.
const CLIPPED_RUN: usize = 3;

impl Examiner<'_> {
    /// Problems that the quality of the data shows.
    pub(super) fn about_quality(&mut self) {
        let quality = &self.recording.quality;
        for signal in &quality.signals {
            if signal.not_finite > 0 {
                self.findings.push(DataFinding::NotFinite {
                    signal: signal.signal,
                    samples: signal.not_finite,
                    total: signal.samples,
                });
            }
            if signal.conflicting > 0 {
                self.findings.push(DataFinding::Conflicting {
                    signal: signal.signal,
                    samples: signal.conflicting,
                });
            }
            if !self.recording.has(signal.signal) {
                self.findings
                    .push(DataFinding::Sparse { signal: signal.signal, share: signal.coverage });
            }
        }
        let share = 1.0 - quality.valid_rows as f64 / quality.rows.max(1) as f64;
        // a hundredth is a start before the first command; more of it is worth a word (assumed)
        if share > 0.01 {
            let gaps = quality.signal(Signal::Position).map_or(0, |q| q.gaps);
            self.findings.push(DataFinding::Holes { share, gaps, segments: quality.segments });
        }
        let jitter = quality.signal(Signal::Position).and_then(|q| q.jitter_s).unwrap_or(0.0);
        let clock = quality.clock;
        let jitters = matches!(clock, ClockKind::UniformBehindJitter | ClockKind::AtStamps);
        // a thousandth of a period moves a carriage at 1 m/s by less than 1 um (assumed)
        if jitters && jitter > 1e-3 * self.step {
            self.findings.push(DataFinding::Jitter { jitter, clock });
        }
        if !(100.0..=1e5).contains(&self.recording.rate) {
            self.findings.push(DataFinding::OddRate { rate: self.recording.rate });
        }
    }

    /// Values are as recorded, not interpolated.
    pub(super) fn is_raw(&self) -> bool {
        matches!(self.recording.quality.clock, ClockKind::Regular | ClockKind::UniformBehindJitter)
    }

    pub(super) fn smallest_step(&self, column: &[f64]) -> f64 {
        let steps = self
            .segments
            .iter()
            .flat_map(|s| column[s.clone()].windows(2))
            .map(|p| (p[1] - p[0]).abs());
        let least = steps.filter(|d| *d > 0.0).fold(f64::INFINITY, f64::min);
        if least.is_finite() { least } else { 0.0 }
    }

    /// Whether a signal never changes; said so.
    pub(super) fn constant(&mut self, signal: Signal) -> bool {
        let mut values = self.column(signal).iter().copied().filter(|v| v.is_finite());
        let Some(value) = values.next() else {
            return false;
        };
        let constant = values.all(|v| v == value);
        if constant {
            self.findings.push(DataFinding::Constant { signal, value });
        }
        constant
    }

    /// Samples that no machine made.
    pub(super) fn outliers(&mut self, signal: Signal) {
        let rows = outlier_rows(self.recording, signal);
        if let Some(&first) = rows.first() {
            let (value, seconds) = (self.column(signal)[first], first as f64 * self.step);
            self.findings.push(DataFinding::Outliers {
                signal,
                samples: rows.len(),
                value,
                seconds,
            });
        }
    }

    /// Whether a signal that changes with every row elsewhere stops to, although another one shows
    /// that the stage is driven.
    pub(super) fn stuck(&mut self, signal: Signal) {
        let column = self.column(signal);
        let least = (STUCK.0 * self.recording.rate) as usize;
        let (mut runs, mut row, mut repeats) = (Vec::new(), 0, 0);
        for run in column.chunk_by(|a, b| a == b) {
            // zero for a long time is a motor without a command
            match run.len() > least && run[0] != 0.0 {
                true => runs.push(row..row + run.len()),
                false => repeats += run.len() - 1,
            }
            row += run.len();
        }
        let elsewhere = column.len() - runs.iter().map(Range::len).sum::<usize>();
        if repeats as f64 > STUCK.1 * elsewhere as f64 {
            return;
        }
        // what moves on during a run, by at least a tenth of what it does in all
        let others = match signal {
            Signal::Position => [Signal::ReferencePosition, Signal::ForceCell, Signal::Force],
            _ => [Signal::Position, Signal::ReferencePosition, Signal::ReferenceVelocity],
        };
        let span = |values: &[f64]| {
            let [low, high] = values
                .iter()
                .filter(|value| value.is_finite())
                .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
                    [low.min(*value), high.max(*value)]
                });
            if low < high { high - low } else { 0.0 }
        };
        let recorded = others
            .iter()
            .filter(|other| self.recording.has(**other))
            .map(|other| self.column(*other));
        let recorded: Vec<(&[f64], f64)> =
            recorded.map(|other| (other, 0.1 * span(other).max(f64::MIN_POSITIVE))).collect();
        let driven = |run: &Range<usize>| {
            recorded.iter().any(|(other, least)| span(&other[run.clone()]) > *least)
        };
        let stuck: Vec<Range<usize>> = runs.into_iter().filter(driven).collect();
        for run in stuck {
            let (value, rows) = (column[run.start], run.len());
            // an extreme is told as such
            let told = |finding: &DataFinding| match finding {
                DataFinding::Clipped { signal: other, value: at, .. } => {
                    *other == signal && *at == value
                }
                _ => false,
            };
            if !self.findings.iter().any(told) {
                self.findings.push(DataFinding::Stuck {
                    signal,
                    value,
                    seconds: rows as f64 * self.step,
                    rows,
                });
            }
        }
    }

    /// Whether a force stays at its extreme.
    pub(super) fn clipped(&mut self, signal: Signal) {
        let column = self.column(signal);
        if let Some(model) = self.model.filter(|_| signal == Signal::Force) {
            let limit = model.motor.force_limit;
            let rows = column.iter().filter(|f| f.abs() >= limit).count();
            if rows > 0 {
                let largest =
                    column.iter().filter(|f| f.is_finite()).fold(0.0f64, |m, f| m.max(f.abs()));
                self.findings.push(DataFinding::Saturated { largest, limit, rows });
                return;
            }
        }
        for (value, rows) in extremes(column) {
            // zero for a long time is a motor without a command, not a limit
            if value != 0.0 && rows >= CLIPPED_RUN {
                self.findings.push(DataFinding::Clipped { signal, value, rows });
            }
        }
    }

    /// Whether the position stops dead at an extreme: from full speed to the very same value within
    /// one row.
    pub(super) fn clipped_position(&mut self, noise: f64) {
        let x = self.column(Signal::Position);
        // Who reads coarse counts sees one or two at once at any end of a motion.
        let least = (20.0 * noise).max(3.0 * self.smallest_step(x)).max(1e-9);
        for (value, rows) in extremes(x) {
            let arrivals = x
                .windows(4)
                .filter(|w| w[1..].iter().all(|v| *v == value) && (w[1] - w[0]).abs() > least);
            if rows >= CLIPPED_RUN && arrivals.count() > 0 {
                self.findings.push(DataFinding::Clipped { signal: Signal::Position, value, rows });
            }
        }
    }
}

/// Lowest and highest value with the rows that have it in runs of at least [`CLIPPED_RUN`] times
/// those that half of the other rows are in: a signal of a lower rate stays with each of its values
/// for some rows, one in coarse counts for many.
fn extremes(column: &[f64]) -> [(f64, usize); 2] {
    let finite = || column.iter().copied().filter(|v| v.is_finite());
    let extremes =
        [finite().fold(f64::INFINITY, f64::min), finite().fold(f64::NEG_INFINITY, f64::max)];
    let others = column.chunk_by(|a, b| a == b).filter(|run| !extremes.contains(&run[0]));
    let mut lengths: Vec<usize> = others.map(<[f64]>::len).collect();
    lengths.sort_unstable();
    let (all, mut rows) = (lengths.iter().sum::<usize>(), 0);
    let is_half = |length: &&usize| {
        rows += **length;
        2 * rows >= all
    };
    let usual = lengths.iter().find(is_half).copied().unwrap_or(1);
    extremes.map(|extreme| {
        let runs = column.chunk_by(|a, b| (*a == extreme) == (*b == extreme));
        let at = runs.filter(|run| run[0] == extreme && run.len() >= CLIPPED_RUN * usual);
        (extreme, at.map(<[f64]>::len).sum())
    })
}
