//! A recording of any origin on one uniform grid, with the rows that can be used.

use std::ops::Range;

use super::data_quality::{DataQuality, SignalQuality};
use super::grid::stretches;
use super::mapping::Signal;
use super::resample::coverage;
use super::trace::Trace;
use friction_stage_core::model::JointType;

/// A signal with values in less than this share of the rows does not count as recorded. Assumed.
pub(super) const LEAST_COVERAGE: f64 = 0.5;

/// A uniform trace with the rows that can be used and the account of the data.
#[derive(Debug, Clone)]
pub struct Recording {
    /// Joint type of which the units are, where the mapping or its units say it.
    pub joint: Option<JointType>,
    /// Columns on a uniform grid. NaN where a signal is not known: absent, or in a gap of more than
    /// three samples.
    pub trace: Trace,
    /// The measured velocity, m/s, of which the position is the integral; empty where the position
    /// itself is recorded.
    pub velocity: Vec<f64>,
    /// Rows per second, Hz.
    pub rate: f64,
    /// Per row whether the position and every force that the recording has are known.
    pub valid: Vec<bool>,
    /// Per row whether a position or a force there was filled in for a sample that is missing.
    pub filled: Vec<bool>,
    /// What the data were like.
    pub quality: DataQuality,
}

impl Recording {
    /// Takes the forces of the rows that were filled in as missing, so that nothing is compared
    /// there; the position stays as it was filled, since the guides are to be driven along it.
    pub fn leave_out_filled(&mut self) {
        for (row, _) in self.filled.iter().enumerate().filter(|(_, filled)| **filled) {
            (self.trace.force_cell[row], self.trace.force[row]) = (f64::NAN, f64::NAN);
        }
        self.count_valid();
    }

    /// Share of the rows in which a position or a force was filled in.
    pub fn share_filled(&self) -> f64 {
        self.filled.iter().filter(|filled| **filled).count() as f64
            / self.filled.len().max(1) as f64
    }

    /// Takes these rows of a signal as missing.
    pub fn leave_out_rows(&mut self, signal: Signal, rows: &[usize]) {
        if signal == Signal::Velocity {
            // Its integral is as wrong there.
            rows.iter().for_each(|row| self.velocity[*row] = f64::NAN);
            return self.leave_out_rows(Signal::Position, rows);
        }
        if let Some(column) = self.column_mut(signal) {
            rows.iter().for_each(|row| column[*row] = f64::NAN);
            self.count_values(signal);
        }
    }

    /// Only the first rows, as if the recording had ended there.
    pub fn truncate(&mut self, rows: usize) {
        for signal in Signal::ALL {
            if let Some(column) = self.column_mut(signal) {
                column.truncate(rows);
                column.shrink_to_fit();
            }
        }
        self.velocity.truncate(rows);
        self.velocity.shrink_to_fit();
        self.trace.time.truncate(rows);
        self.trace.time.shrink_to_fit();
        self.filled.truncate(rows);
        self.quality.rows = self.trace.len();
        self.count_valid();
    }

    fn column_mut(&mut self, signal: Signal) -> Option<&mut Vec<f64>> {
        let trace = &mut self.trace;
        Some(match signal {
            Signal::Time | Signal::Velocity => return None,
            Signal::Position => &mut trace.position,
            Signal::ForceCell => &mut trace.force_cell,
            Signal::Force => &mut trace.force,
            Signal::ReferencePosition => &mut trace.reference_position,
            Signal::ReferenceVelocity => &mut trace.reference_velocity,
            Signal::ReferenceAcceleration => &mut trace.reference_acceleration,
        })
    }

    fn count_valid(&mut self) {
        self.valid = valid_rows(&self.trace, &self.quality.signals);
        self.quality.valid_rows = self.valid.iter().filter(|&&v| v).count();
        self.quality.segments = stretches(&self.valid).len();
    }

    /// Stretches of valid rows, in order; filters and simulations run within one of them.
    pub fn segments(&self) -> Vec<Range<usize>> {
        stretches(&self.valid)
    }

    /// Takes the values of a signal for which `unusable` holds as missing, as if they had not been
    /// recorded.
    pub fn leave_out(&mut self, signal: Signal, unusable: impl Fn(f64) -> bool) {
        if signal == Signal::Velocity {
            let rows = self.velocity.iter().enumerate().filter(|(_, value)| unusable(**value));
            let rows: Vec<usize> = rows.map(|(row, _)| row).collect();
            return self.leave_out_rows(signal, &rows);
        }
        if let Some(column) = self.column_mut(signal) {
            column.iter_mut().filter(|value| unusable(**value)).for_each(|value| *value = f64::NAN);
            self.count_values(signal);
        }
    }

    /// Counts again what a signal still covers; one without any value is not recorded.
    fn count_values(&mut self, signal: Signal) {
        let Some(column) = self.column_mut(signal) else {
            return;
        };
        let column = std::mem::take(column);
        let coverage = coverage(&column, &self.quality.pauses);
        if let Some(place) = self.column_mut(signal) {
            *place = column;
        }
        let signals = &mut self.quality.signals;
        let found = signals.iter_mut().filter(|found| found.signal == signal);
        found.for_each(|found| found.coverage = coverage);
        signals.retain(|found| found.signal != signal || coverage > 0.0);
        self.count_valid();
    }

    /// Whether a signal is recorded, in at least half of the rows.
    pub fn has(&self, signal: Signal) -> bool {
        signal == Signal::Time
            || self.quality.signal(signal).is_some_and(|q| q.coverage >= LEAST_COVERAGE)
    }
}

/// Per row whether the position and every recorded force are known.
pub(super) fn valid_rows(trace: &Trace, quality: &[SignalQuality]) -> Vec<bool> {
    let has =
        |signal: Signal| quality.iter().any(|q| q.signal == signal && q.coverage >= LEAST_COVERAGE);
    let (has_cell, has_force) = (has(Signal::ForceCell), has(Signal::Force));
    (0..trace.len())
        .map(|row| {
            trace.position[row].is_finite()
                && (!has_cell || trace.force_cell[row].is_finite())
                && (!has_force || trace.force[row].is_finite())
        })
        .collect()
}
