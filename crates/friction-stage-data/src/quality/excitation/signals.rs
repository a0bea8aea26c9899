//! Signals that are constant, sparse, not finite, or have samples that no machine made.

use super::Examiner;
use crate::quality::finding::DataFinding;
use crate::quality::outliers::outlier_rows;
use crate::signals::{ClockKind, Signal, SignalNote};

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
        // a thousandth of a period moves a carriage at 1 m/s by less than 1 µm (assumed)
        if jitters && jitter > 1e-3 * self.step {
            self.findings.push(DataFinding::Jitter { jitter, clock });
        }
        if !(100.0..=1e5).contains(&self.recording.rate) {
            self.findings.push(DataFinding::OddRate { rate: self.recording.rate });
        }
    }

    /// Whether a force is recorded that could not be put in the rows, as the notes say.
    pub(super) fn force_is_unused(&self) -> bool {
        self.recording.quality.notes.iter().any(|note| match note {
            SignalNote::NoTimeInCommon { signal, .. } | SignalNote::NoElement { signal, .. } => {
                matches!(signal, Signal::Force | Signal::ForceCell)
            }
            _ => false,
        })
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
}
