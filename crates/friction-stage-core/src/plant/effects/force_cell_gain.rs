//! Force cell gain: the cell shows more or less force than there is, by a fixed part.
//!
//! Reading F (1 + g) at the true force F: g fraction.
//! Source: error of the cell's calibration, linear (assumed). Sizes: assumed, up to 1 to 2 %.
//! Not modelled: crosstalk, hysteresis of the cell.

use super::regression::least_squares;
use super::{
    Action, EffectDescriptor, EffectParameter, Multiplicity, ReadingLaw, RecordSpecific, Residual,
    Role, descriptor,
};

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "force_cell_gain",
    role: Role::ForceCell,
    law: "reading = F (1 + fraction)",
    source: "linear calibration error (assumed)",
    telltale: "cell less command proportional to the command, and mass and friction seem larger by \
               the same part",
    parameters: &[EffectParameter::required(
        "fraction",
        "1",
        "reading beyond the force, as a part of it",
        (-0.9, 0.9),
        0.01,
    )],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[0.01],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::ForceCell(Box::new(ForceCellGain { fraction: values[0] })),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

#[derive(Debug)]
struct ForceCellGain {
    fraction: f64,
}

impl ReadingLaw for ForceCellGain {
    fn reading(&self, _time: f64, force: f64) -> f64 {
        force + self.fraction * force
    }
}

/// Slope of cell less command over the command.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let base = least_squares(residual.force, |_| [1.0])?;
    let fit = least_squares(residual.force, |k| [1.0, residual.command[k]])?;
    fit.improves_on(&base).then(|| vec![fit.coefficients[1].clamp(-0.9, 0.9)])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;
    use crate::model::{EffectParameters, StageModel};
    use crate::plant::{Rates, Stage};

    #[test]
    fn the_cell_reads_more_and_the_stage_moves_as_before() {
        let plain = StageModel::default().without_noise();
        let model = StageModel {
            effects: vec![EffectParameters::new("force_cell_gain", [("fraction", 0.02)])],
            ..plain.clone()
        };
        let [plain, gained] = [plain, model].map(|model| {
            let mut stage = Stage::new(&model, Rates::DEFAULT, 0).unwrap();
            stage.advance(300.0);
            (stage.sample().force_cell, stage.state().position)
        });
        assert_eq!(plain, (300.0, gained.1));
        assert!((gained.0 - 306.0).abs() < 1e-9);
    }

    #[test]
    fn proposal_finds_the_fraction_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[0.015]);
        assert!((found[0] / 0.015 - 1.0).abs() < 0.03, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
