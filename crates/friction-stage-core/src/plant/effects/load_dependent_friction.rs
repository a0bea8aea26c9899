//! Load-dependent friction: the guides rub more, the harder the motor pushes.
//!
//! Fc and Fs times 1 + r |u|: r rate (1/N), u commanded force (N). The push presses the carriage
//! into its guides: the motor does not pull through the middle of the friction, and its magnets
//! attract. Source: dry friction linear in the load (P. Hamon, M. Gautier, P. Garrec, IEEE/RSJ
//! IROS 2010; A. Bittencourt, S. Gunnarsson, J. Dyn. Sys. Meas. Control 134(5), 2012); assumed:
//! the load is the command. Sizes: assumed, some per cent at the largest force. It only takes
//! energy. Not modelled: viscous friction or stiffness that depend on the load, a push one way
//! that differs from one the other way.
//!
//! A search does not add it: a controller answers every force on the carriage, so that friction
//! that follows the command takes a part of any force that is missing, whatever it is. A model that
//! declares it has its rate fitted. It is the direction of the motion that distinguishes it from
//! `motor_gain` and from a mass, which follow the acceleration.

use super::{
    Action, EffectDescriptor, EffectParameter, FrictionLaw, FrictionTerms, Motion, Multiplicity,
    RecordSpecific, Role, descriptor,
};
use crate::plant::guides::FrictionScale;

/// Smallest and largest rate, 1/N: of a friction that the load lowers no more than a hundredth is
/// left, see [`LEAST`].
const RATES: (f64, f64) = (-0.1, 1.0);
/// What is left at least of the friction.
const LEAST: f64 = 0.01;

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "load_dependent_friction",
    role: Role::Friction(FrictionTerms::BRISTLES),
    law: "Fc, Fs (1 + rate |command|)",
    source: "Hamon, Gautier, Garrec 2010; Bittencourt, Gunnarsson 2012: linear in the load",
    telltale: "changes sign with the velocity, its size follows the motor's force, not seen by \
               the force cell",
    parameters: &[EffectParameter::required(
        "rate",
        "1/N",
        "part by which Fc and Fs rise per force of the motor",
        RATES,
        1e-4,
    )],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[5e-4],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::Friction(Box::new(LoadDependentFriction { rate: values[0] })),
    proposal: None,
    starts: descriptor::as_proposed,
    curve: None,
};

#[derive(Debug)]
struct LoadDependentFriction {
    rate: f64,
}

impl FrictionLaw for LoadDependentFriction {
    fn scale(&mut self, motion: &Motion, _step: f64, scale: &mut FrictionScale) {
        let factor = (1.0 + self.rate * motion.motor_force.abs()).max(LEAST);
        scale.coulomb *= factor;
        scale.stat *= factor;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn friction_rises_with_the_force_in_either_direction_and_never_turns() {
        let factor = |rate: f64, motor_force: f64| {
            let mut scale = FrictionScale::ONE;
            let motion = Motion { motor_force, ..Motion::default() };
            LoadDependentFriction { rate }.scale(&motion, 1e-4, &mut scale);
            assert_eq!((scale.viscous, scale.stat), (1.0, scale.coulomb));
            scale.coulomb
        };
        assert!((factor(1e-3, 200.0) - 1.2).abs() < 1e-12);
        assert!((factor(1e-3, -200.0) - 1.2).abs() < 1e-12);
        assert_eq!(factor(1e-3, 0.0), 1.0);
        assert_eq!(factor(-0.01, 500.0), LEAST);
    }
}
