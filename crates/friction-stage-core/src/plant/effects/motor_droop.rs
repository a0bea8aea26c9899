//! Motor droop: the force per command falls with the speed.
//!
//! F = -u min(1, c |v|), along +x on the motor side: u commanded force after `actuator_lag`,
//! `motor_saturation` and `motor_gain` (N), v velocity (m/s), c coefficient (s/m). The part of the
//! force that is lost grows in proportion to the speed: 1 / c is the speed at which none would be
//! left. Source: the back electromotive force takes the voltage that drives the current, a loop of
//! finite gain makes up for a part of it (R. Krishnan, "Electric Motor Drives", 2001, torque over
//! speed); assumed: linear. Sizes: assumed, some per cent at the highest speed. It is no
//! potential: the motor pays for it. Not modelled: a limit of the voltage, which cuts large forces
//! at high speed alone.
//!
//! What the back electromotive force takes of a motor without a current loop is proportional to v
//! whatever the command: viscous friction, before the cell, if a stage has one. Two speeds
//! distinguish this effect from `motor_gain`, accelerating at high speed from `motor_saturation`
//! and a mass, braking from viscous friction: there it adds to the motion.

use super::regression::least_squares;
use super::{
    Action, CommandLaw, CommandStage, EffectDescriptor, EffectParameter, Motion, Multiplicity,
    RecordSpecific, Residual, Role, descriptor,
};

/// Largest loss per speed, s/m.
const LARGEST: f64 = 1e3;

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "motor_droop",
    role: Role::Command(CommandStage::Ripple),
    law: "F = -command min(1, coefficient |v|)",
    source: "back electromotive force with a current loop of finite gain (Krishnan 2001), linear \
             (assumed)",
    telltale: "proportional to the command times the speed, seen by the force cell",
    parameters: &[EffectParameter::required(
        "coefficient",
        "s/m",
        "part of the force that is lost per speed",
        (0.0, LARGEST),
        0.01,
    )],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[0.05],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::Command(Box::new(MotorDroop { coefficient: values[0] })),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

#[derive(Debug)]
struct MotorDroop {
    coefficient: f64,
}

impl CommandLaw for MotorDroop {
    fn change(&mut self, command: f64, motion: &Motion, _step: f64) -> f64 {
        -command * (self.coefficient * motion.velocity.abs()).min(1.0)
    }
}

/// Slope of the residual over command times speed, beside an error of the gain.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let base = least_squares(residual.force, |k| [1.0, residual.command[k]])?;
    let fit = least_squares(residual.force, |k| {
        let command = residual.command[k];
        [1.0, command, -command * residual.velocity[k].abs()]
    })?;
    let coefficient = fit.coefficients[2];
    (fit.improves_on(&base) && coefficient > 0.0).then(|| vec![coefficient.min(LARGEST)])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;

    #[test]
    fn a_motor_loses_force_with_speed_in_either_direction_and_no_more_than_it_has() {
        let mut motor = MotorDroop { coefficient: 0.1 };
        let mut lost =
            |velocity: f64| motor.change(200.0, &Motion { velocity, ..Motion::default() }, 1e-4);
        assert_eq!(lost(0.0), 0.0);
        assert!((lost(0.5) + 10.0).abs() < 1e-12 && (lost(-0.5) + 10.0).abs() < 1e-12);
        assert_eq!(lost(20.0), -200.0);
    }

    #[test]
    fn proposal_finds_the_coefficient_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[0.08]);
        assert!((found[0] / 0.08 - 1.0).abs() < 0.05, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
