//! Noise of encoder and force cell, and how it compares with what the model declares.

use super::{Examiner, NoiseFound};
use crate::quality::finding::DataFinding;
use crate::signals::Signal;
use friction_stage_core::numerics::noise;

impl Examiner<'_> {
    pub(super) fn encoder_noise(&self) -> Option<NoiseFound> {
        let x = self.column(Signal::Position);
        let present = self.noise_with_counts(Signal::Position, || noise::encoder_noise(x, 0.0))?;
        let declared =
            self.model.map(|m| m.encoder.noise.hypot(m.encoder.resolution / 12f64.sqrt()));
        Some(NoiseFound { present, declared, smallest_step: self.smallest_step(x) })
    }

    pub(super) fn cell_noise(&self) -> Option<NoiseFound> {
        let cell = self.column(Signal::ForceCell);
        let command = self.recording.has(Signal::Force).then(|| self.column(Signal::Force));
        let present =
            self.noise_with_counts(Signal::ForceCell, || noise::cell_noise(cell, command))?;
        let declared = self.model.map(|m| m.force_cell.noise);
        Some(NoiseFound { present, declared, smallest_step: self.smallest_step(cell) })
    }

    /// Noise of a recorded signal by its rows; where they are interpolated, of its samples.
    fn noise_with_counts(&self, signal: Signal, of_rows: impl Fn() -> f64) -> Option<f64> {
        if !self.recording.has(signal) {
            return None;
        }
        let of_samples = self.recording.quality.signal(signal)?.noise?;
        let keeps_values = self.recording.quality.clock.keeps_values();
        Some(if keeps_values { of_rows() } else { of_samples })
    }

    fn smallest_step(&self, column: &[f64]) -> f64 {
        let steps = self
            .segments
            .iter()
            .flat_map(|s| column[s.clone()].windows(2))
            .map(|p| (p[1] - p[0]).abs());
        let least = steps.filter(|d| *d > 0.0).fold(f64::INFINITY, f64::min);
        if least.is_finite() { least } else { 0.0 }
    }

    pub(super) fn noise(&mut self, encoder: Option<NoiseFound>, cell: Option<NoiseFound>) {
        let found = [(Signal::Position, "m", encoder), (Signal::ForceCell, "N", cell)];
        for (signal, unit, found) in found {
            let Some(NoiseFound { present, declared: Some(declared), .. }) = found else {
                continue;
            };
            // In between the declaration is good enough. Assumed.
            if !(0.5 * declared..=2.0 * declared).contains(&present) {
                self.findings.push(DataFinding::Noise { signal, unit, present, declared });
            }
        }
    }
}
