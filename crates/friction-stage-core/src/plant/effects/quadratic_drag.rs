//! Quadratic drag: air that the carriage or its cover pushes aside.
//!
//! F = -c v |v| along +x on the carriage: c coefficient (N s^2/m^2). It only takes energy: c |v|^3.
//! Source: drag of a bluff body at high Reynolds number, c = rho Cd S / 2. Sizes: assumed, 0.1 N
//! s^2/m^2 for a plate of 0.1 m^2, far more where bellows pump air through gaps. Not modelled: the
//! air's inertia, laminar gaps (those are viscous).

use super::regression::least_squares;
use super::{
    Action, EffectDescriptor, EffectParameter, ForceLaw, Motion, Multiplicity, RecordSpecific,
    Residual, Role, descriptor,
};

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "quadratic_drag",
    role: Role::CarriageForce,
    law: "F = -coefficient v |v|",
    source: "drag of a bluff body, c = rho Cd S / 2",
    telltale: "against the motion, grows with the square of the speed, not seen by the force cell",
    parameters: &[EffectParameter::required(
        "coefficient",
        "N s^2/m^2",
        "drag over velocity squared",
        (0.0, 1e5),
        10.0,
    )],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[5.0],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::CarriageForce(Box::new(QuadraticDrag { coefficient: values[0] })),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

#[derive(Debug)]
struct QuadraticDrag {
    coefficient: f64,
}

impl ForceLaw for QuadraticDrag {
    fn force(&mut self, motion: &Motion, _step: f64) -> f64 {
        -self.coefficient * motion.velocity * motion.velocity.abs()
    }
}

/// Slope of the residual over v |v|, beside an error of the friction.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let base = least_squares(residual.force, |k| [residual.friction[k]])?;
    let fit = least_squares(residual.force, |k| {
        let velocity = residual.velocity[k];
        [residual.friction[k], -velocity * velocity.abs()]
    })?;
    let coefficient = fit.coefficients[1];
    (fit.improves_on(&base) && coefficient > 0.0).then(|| vec![coefficient.min(1e5)])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;

    #[test]
    fn drag_opposes_the_motion_and_quadruples_at_double_speed() {
        let mut drag = QuadraticDrag { coefficient: 8.0 };
        let mut at = |velocity| drag.force(&Motion { velocity, ..Motion::default() }, 1e-4);
        assert!((at(0.5) + 2.0).abs() < 1e-12);
        assert!((at(-1.0) - 8.0).abs() < 1e-12);
        assert_eq!(at(0.0), 0.0);
    }

    #[test]
    fn proposal_finds_the_coefficient_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[20.0]);
        assert!((found[0] / 20.0 - 1.0).abs() < 0.05, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
