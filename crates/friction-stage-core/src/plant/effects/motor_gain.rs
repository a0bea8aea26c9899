//! Motor gain: the motor makes more or less force than its command by a fixed part.
//!
//! F = u g, along +x on the motor side: u commanded force as it arrives behind an `actuator_lag`
//! (N), g fraction. Source: error of the declared force constant, linear (assumed). Sizes: assumed,
//! 1 to 5 %. Not modelled: saturation, change with temperature.

use nalgebra::Complex;

use super::regression::least_squares;
use super::{
    Action, CommandLaw, CommandStage, EffectDescriptor, EffectParameter, Motion, Multiplicity,
    RecordSpecific, Residual, Role, descriptor,
};

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "motor_gain",
    role: Role::Command(CommandStage::Gain),
    law: "F = command fraction",
    source: "linear error of the force constant (assumed)",
    telltale: "proportional to the command at every position and speed, seen by the force cell",
    parameters: &[EffectParameter::required(
        "fraction",
        "1",
        "force beyond the command, as a part of it",
        (-0.9, 0.9),
        0.01,
    )],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[0.01],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::Command(Box::new(MotorGain { fraction: values[0] })),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

#[derive(Debug)]
struct MotorGain {
    fraction: f64,
}

impl CommandLaw for MotorGain {
    fn change(&mut self, command: f64, _motion: &Motion, _step: f64) -> f64 {
        self.fraction * command
    }

    fn added(&self, _angular_frequency: f64) -> Complex<f64> {
        Complex::new(self.fraction, 0.0)
    }
}

/// Slope of the residual over the command.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let base = least_squares(residual.force, |_| [1.0])?;
    let fit = least_squares(residual.force, |k| [1.0, residual.command[k]])?;
    fit.improves_on(&base).then(|| vec![fit.coefficients[1].clamp(-0.9, 0.9)])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;

    #[test]
    fn three_percent_more_force_is_three_percent_of_the_command() {
        let mut gain = MotorGain { fraction: 0.03 };
        let motion = Motion { velocity: 1.0, ..Motion::default() };
        assert!((gain.change(200.0, &motion, 1e-4) - 6.0).abs() < 1e-12);
        assert!((gain.change(-200.0, &motion, 1e-4) + 6.0).abs() < 1e-12);
    }

    #[test]
    fn proposal_finds_the_fraction_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[-0.02]);
        assert!((found[0] / -0.02 - 1.0).abs() < 0.02, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
