//! The account of a recording: what its samples were like and what was done to them.

use std::fmt;

use serde::Serialize;

use super::grid::ClockKind;
use super::mapping::Signal;

/// What was met and done in bringing one signal onto the grid.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SignalQuality {
    /// The signal.
    pub signal: Signal,
    /// Topic and field, or column.
    pub place: String,
    /// Samples read.
    pub samples: u64,
    /// Samples that are NaN or infinite; taken as missing.
    pub not_finite: u64,
    /// Samples with a stamp that another one has; the first counts.
    pub repeated: u64,
    /// Those of them with another value.
    pub conflicting: u64,
    /// Samples with a stamp before that of an earlier one; put in order.
    pub out_of_order: u64,
    /// Usual (median) interval, s.
    pub interval_s: f64,
    /// Standard deviation of stamps from the clock that they follow, s; only of the position.
    pub jitter_s: Option<f64>,
    /// Samples that are missing, by the usual interval.
    pub missing: u64,
    /// Rows filled from neighbours in place of missing samples.
    pub filled: u64,
    /// Places where more than three samples in a row are missing; NaN in the trace.
    pub gaps: u64,
    /// Longest interval between two samples, s.
    pub longest_interval_s: f64,
    /// Share of the rows that have a value.
    pub coverage: f64,
}

/// What the data were like and what was done to them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DataQuality {
    /// Rows on the grid.
    pub rows: usize,
    /// Rows in which the position and every recorded force are known.
    pub valid_rows: usize,
    /// Stretches of such rows.
    pub segments: usize,
    /// Rows per second, Hz.
    pub rate_hz: f64,
    /// How the samples of the position lie in time.
    pub clock: ClockKind,
    /// Per signal that was found.
    pub signals: Vec<SignalQuality>,
    /// What a user should know, in words.
    pub notes: Vec<String>,
}

impl DataQuality {
    /// The account of a signal, if there is any sample of it.
    pub fn signal(&self, signal: Signal) -> Option<&SignalQuality> {
        self.signals.iter().find(|q| q.signal == signal)
    }
}

impl fmt::Display for DataQuality {
    /// Tells what was not as it should be; one line if all was.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let clock = match self.clock {
            ClockKind::Regular => "uniform as recorded",
            ClockKind::UniformBehindJitter => {
                "uniform behind stamps that jitter, values as recorded"
            }
            ClockKind::AtStamps => "not uniform, interpolated from the stamps",
            ClockKind::OtherRate => "interpolated to the rate that was asked for",
        };
        writeln!(
            f,
            "data: {} rows at {:.3} Hz ({clock}), {} usable in {} pieces",
            self.rows, self.rate_hz, self.valid_rows, self.segments
        )?;
        for q in &self.signals {
            let counts = [
                (q.out_of_order, "out of order"),
                (q.repeated, "with a repeated stamp"),
                (q.not_finite, "not finite"),
                (q.missing, "missing"),
            ];
            let mut told: Vec<String> = counts
                .iter()
                .filter(|(n, _)| *n > 0)
                .map(|(n, what)| format!("{n} {what}"))
                .collect();
            if q.filled > 0 {
                told.push(format!("{} rows filled from neighbours", q.filled));
            }
            if q.gaps > 0 {
                told.push(format!("{} gaps, the longest {:.4} s", q.gaps, q.longest_interval_s));
            }
            // signals that come slower than the rows are filled in between
            if q.interval_s * self.rate_hz > 1.5 {
                told.push(format!("one sample every {:.6} s", q.interval_s));
            }
            if !told.is_empty() {
                writeln!(
                    f,
                    "data: {} from {}: {} samples, {}",
                    q.signal,
                    q.place,
                    q.samples,
                    told.join(", ")
                )?;
            }
        }
        for note in &self.notes {
            writeln!(f, "data: {note}")?;
        }
        Ok(())
    }
}
