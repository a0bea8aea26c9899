//! Noise of encoder and force cell, and how it compares with what the model declares.

use super::{Examiner, NoiseFound};
use crate::quality::finding::DataFinding;
use crate::signals::Signal;
use friction_stage_core::numerics::noise::{cell_noise, encoder_noise, white_noise};

impl Examiner<'_> {
    pub(super) fn encoder_noise(&self) -> Option<NoiseFound> {
        let x = self.column(Signal::Position);
        if !self.is_raw() || white_noise(x).is_none() {
            return None;
        }
        let resolution = self.model.map_or(0.0, |model| model.encoder.resolution);
        let declared =
            self.model.map(|m| m.encoder.noise.hypot(m.encoder.resolution / 12f64.sqrt()));
        let present = encoder_noise(x, resolution);
        Some(NoiseFound { present, declared, smallest_step: self.smallest_step(x) })
    }

    pub(super) fn cell_noise(&self) -> Option<NoiseFound> {
        if !self.recording.has(Signal::ForceCell) || !self.is_raw() {
            return None;
        }
        let cell = self.column(Signal::ForceCell);
        let with_command = self.recording.has(Signal::Force);
        white_noise(cell)?;
        let present = cell_noise(cell, with_command.then(|| self.column(Signal::Force)));
        let declared = self.model.map(|m| m.force_cell.noise);
        Some(NoiseFound { present, declared, smallest_step: self.smallest_step(cell) })
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
