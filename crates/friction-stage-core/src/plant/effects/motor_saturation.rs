//! Motor saturation: the iron of the motor saturates, and the force per current falls as the
//! current grows.
//!
//! F = u / sqrt(1 + (u / Fs)^2) - u, along +x on the motor side: u commanded force as it arrives
//! after an `actuator_lag` (N), Fs saturation_force (N), the limit that the force tends to. At
//! small u the motor makes what is commanded and lacks u^3 / (2 Fs^2), 5 % at u = Fs / 3. Source:
//! saturation of the force constant at high current (Gieras, Piech, Tomczuk, "Linear Synchronous
//! Motors", 2nd ed. 2011); assumed: the curve, one of those that start straight and end level.
//! Sizes: assumed, 5 to 20 % at peak force. It is no potential: the motor pays for it. Not
//! modelled: hysteresis of the iron, saturation that depends on the position.
//!
//! Distinguished from `motor_gain` by commands of two sizes, from `motor_droop` by large forces at
//! low speed. A force cell shows it alone; without one a `payload` looks alike where all
//! accelerations are as large.

use super::regression::least_squares;
use super::{
    Action, CommandLaw, CommandStage, EffectDescriptor, EffectParameter, Motion, Multiplicity,
    RecordSpecific, Residual, Role, descriptor,
};

/// Smallest and largest limit, N.
const FORCES: (f64, f64) = (1.0, 1e6);

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "motor_saturation",
    role: Role::Command(CommandStage::Curve),
    law: "F = command / sqrt(1 + (command / saturation_force)^2) - command",
    source: "Gieras, Piech, Tomczuk 2011, saturation of the force constant; the curve assumed",
    telltale: "too little force at large commands alone, with their third power, at every speed, \
               seen by the force cell",
    parameters: &[EffectParameter::required(
        "saturation_force",
        "N",
        "force that the motor tends to at large commands",
        FORCES,
        3000.0,
    )],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[3000.0],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::Command(Box::new(MotorSaturation { force: values[0] })),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

#[derive(Debug)]
struct MotorSaturation {
    /// Fs, N.
    force: f64,
}

impl CommandLaw for MotorSaturation {
    fn change(&mut self, command: f64, _motion: &Motion, _step: f64) -> f64 {
        command / (command / self.force).hypot(1.0) - command
    }
}

/// Slope of the residual over the third power of the command, beside an error of the gain.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let base = least_squares(residual.force, |k| [1.0, residual.command[k]])?;
    let fit = least_squares(residual.force, |k| {
        let command = residual.command[k];
        [1.0, command, -command.powi(3)]
    })?;
    let third = fit.coefficients[2];
    (fit.improves_on(&base) && third > 0.0)
        .then(|| vec![(2.0 * third).sqrt().recip().clamp(FORCES.0, FORCES.1)])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;

    /// 3-4-5: u / Fs = 3/4 gives 4/5 of the command.
    #[test]
    fn force_falls_behind_large_commands_and_tends_to_the_limit() {
        let mut motor = MotorSaturation { force: 400.0 };
        let mut force = |command: f64| command + motor.change(command, &Motion::default(), 1e-4);
        assert!((force(300.0) - 240.0).abs() < 1e-9 && (force(-300.0) + 240.0).abs() < 1e-9);
        assert!((force(1e9) - 400.0).abs() < 1e-3);
        // u^3 / (2 Fs^2) = 3.1e-6 N at 1 N.
        assert!((force(1.0) - 1.0 + 3.125e-6).abs() < 1e-10);
    }

    #[test]
    fn proposal_finds_the_limit_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[600.0]);
        assert!((found[0] / 600.0 - 1.0).abs() < 0.1, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
