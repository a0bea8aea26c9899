//! Constant force: a tilted rail, a hanging cable or a weight pulls the carriage one way.
//!
//! F = A along +x on the carriage: A amplitude (N), of either sign. On a rail that falls by the
//! angle a towards +x, A = m g sin(a). Source: weight on an incline. Sizes: 0.4 N per mrad at 40
//! kg. It has the potential -A x. Not modelled: tilt that changes along the rail.

use super::regression::least_squares;
use super::{
    Action, EffectDescriptor, EffectParameter, ForceLaw, Motion, Multiplicity, RecordSpecific,
    Residual, Role, descriptor,
};

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "constant_force",
    role: Role::CarriageForce,
    law: "F = amplitude",
    source: "weight on an incline, m g sin(a)",
    telltale: "the same at every position, speed and direction, not seen by the force cell",
    parameters: &[EffectParameter::required(
        "amplitude",
        "N",
        "force along +x",
        (-1000.0, 1000.0),
        1.0,
    )],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[0.5],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::CarriageForce(Box::new(ConstantForce { amplitude: values[0] })),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

#[derive(Debug)]
struct ConstantForce {
    amplitude: f64,
}

impl ForceLaw for ConstantForce {
    fn force(&mut self, _motion: &Motion, _step: f64) -> f64 {
        self.amplitude
    }

    fn stored_energy(&self, position: f64) -> f64 {
        -self.amplitude * position
    }
}

/// Mean of the residual, apart from what changes sign with the velocity.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let base = least_squares(residual.force, |k| [residual.friction[k]])?;
    let fit = least_squares(residual.force, |k| [residual.friction[k], 1.0])?;
    fit.improves_on(&base).then(|| vec![fit.coefficients[1].clamp(-1000.0, 1000.0)])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;
    use crate::model::{EffectParameters, StageModel};
    use crate::plant::Body;

    #[test]
    fn force_is_the_slope_of_the_stored_energy() {
        let mut force = ConstantForce { amplitude: -3.0 };
        let slope = (force.stored_energy(0.2) - force.stored_energy(0.1)) / 0.1;
        assert!((force.force(&Motion::default(), 1e-4) + slope).abs() < 1e-12);
    }

    /// At rest the bristles hold it, and the force cell does not see it.
    #[test]
    fn a_stage_under_a_small_constant_force_rests_where_its_bristles_hold_it() {
        let model = StageModel {
            effects: vec![EffectParameters::new("constant_force", [("amplitude", 2.0)])],
            ..StageModel::default().without_noise()
        };
        let stiffness = model.resolved_guides().unwrap()[0].stiffness;
        let mut body = Body::new(&model, 25e-6).unwrap();
        body.advance(0.0, 40_000);
        let held = 4.0 * stiffness * body.guides().bristles()[0];
        assert!(
            (held / 2.0 - 1.0).abs() < 1e-3 && body.position() > 0.0,
            "{held} N at {} m",
            body.position()
        );
        assert_eq!(body.cell_force(), 0.0);
    }

    #[test]
    fn proposal_finds_the_force_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[-0.8]);
        assert!((found[0] / -0.8 - 1.0).abs() < 0.02, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
