//! Payload: the carriage carries more mass than the model says, or less.
//!
//! Moving mass m + M: M mass (kg), negative where the model's mass is too large. In a residual it
//! is a force -M a along +x. Source: Newton's second law. Rigidly fixed; the friction of the guides
//! does not change with the load (assumed: preloaded guides). Not modelled: load that slides,
//! swings or changes during the run.

use super::regression::least_squares;
use super::{
    Action, EffectDescriptor, EffectParameter, Multiplicity, RecordSpecific, Residual, Role,
    descriptor,
};

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "payload",
    role: Role::Mass,
    law: "moving mass m + mass, in a residual F = -mass a",
    source: "Newton's second law",
    telltale: "proportional to the acceleration and not to the jerk, not seen by the force cell",
    parameters: &[EffectParameter::required(
        "mass",
        "kg",
        "mass beyond that of the model",
        (-1000.0, 1000.0),
        1.0,
    )],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[1.0],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::Mass(values[0]),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

/// Slope of the residual over the acceleration.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let base = least_squares(residual.force, |_| [1.0])?;
    let fit = least_squares(residual.force, |k| [1.0, residual.acceleration[k]])?;
    fit.improves_on(&base).then(|| vec![(-fit.coefficients[1]).clamp(-1000.0, 1000.0)])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;
    use crate::model::{EffectParameters, StageModel};
    use crate::plant::Body;

    #[test]
    fn a_stage_with_payload_moves_as_a_heavier_stage() {
        let loaded = StageModel {
            effects: vec![EffectParameters::new("payload", [("mass", 5.0)])],
            ..StageModel::default()
        };
        let heavier = StageModel { mass: 45.0, ..StageModel::default() };
        let [loaded, heavier] = [loaded, heavier].map(|model| {
            let mut body = Body::new(&model, 25e-6).unwrap();
            body.advance(500.0, 2000);
            (body.position(), body.velocity(), body.acceleration())
        });
        assert!(loaded.0 > 1e-3, "{loaded:?}");
        assert_eq!(loaded, heavier);
    }

    #[test]
    fn a_carriage_without_mass_is_refused() {
        let model = StageModel {
            effects: vec![EffectParameters::new("payload", [("mass", -40.0)])],
            ..StageModel::default()
        };
        let message = Body::new(&model, 25e-6).unwrap_err().to_string();
        assert!(message.contains("40 kg") && message.contains("greater than 0"), "{message}");
    }

    #[test]
    fn proposal_finds_the_mass_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[-1.5]);
        assert!((found[0] / -1.5 - 1.0).abs() < 0.02, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
