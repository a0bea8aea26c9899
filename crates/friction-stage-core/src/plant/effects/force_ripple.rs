//! Force ripple: the force of the motor per current changes with where the windings stand over the
//! magnets.
//!
//! F = u g sin(2 pi x / p + phi), along +x on the motor side: u commanded force (N), with what an
//! `actuator_lag` and a `motor_gain` make of it, g fraction, p period (m), phi phase at x = 0
//! (rad). Proportional to the commanded force; without command there is none. It is no potential:
//! the motor pays for it. Source: first harmonic of the force constant over position (Gieras,
//! Piech, Tomczuk, "Linear Synchronous Motors", 2nd ed. 2011). Sizes: assumed, 1 to 5 %. Not
//! modelled: higher harmonics, saturation of the iron.

use std::f64::consts::TAU;

use super::regression::strongest_wave;
use super::{
    Action, CommandLaw, CommandStage, EffectDescriptor, EffectParameter, Motion, Multiplicity,
    ParameterKind, RecordSpecific, Residual, Role, descriptor,
};

/// Shortest and longest period, m; of a turning joint up to some sixteen turns, rad.
const PERIODS: (f64, f64) = (1e-4, 100.0);

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "force_ripple",
    role: Role::Command(CommandStage::Ripple),
    law: "F = command fraction sin(2 pi x / period + phase)",
    source: "Gieras, Piech, Tomczuk 2011, first harmonic of the force constant",
    telltale: "periodic in position and proportional to the force, seen by the force cell",
    parameters: &[
        EffectParameter::required(
            "fraction",
            "1",
            "peak, as a part of the commanded force",
            (0.0, 1.0),
            0.01,
        ),
        EffectParameter::required(
            "period",
            "m",
            "distance after which the ripple repeats",
            PERIODS,
            1e-3,
        )
        .of_kind(ParameterKind::Period),
        EffectParameter::optional("phase", "rad", "phase at position 0", (-TAU, TAU), 1.0, 0.0)
            .of_kind(ParameterKind::Phase),
    ],
    multiplicity: Multiplicity::Several,
    record_specific: RecordSpecific::Nothing,
    typical: &[0.02, 24e-3, 0.0],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::Command(Box::new(ForceRipple::new(values))),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

#[derive(Debug)]
struct ForceRipple {
    fraction: f64,
    wave_number: f64,
    phase: f64,
}

impl ForceRipple {
    fn new(values: &[f64]) -> ForceRipple {
        ForceRipple { fraction: values[0], wave_number: TAU / values[1], phase: values[2] }
    }
}

impl CommandLaw for ForceRipple {
    fn change(&mut self, command: f64, motion: &Motion, _step: f64) -> f64 {
        command * self.fraction * (self.wave_number * motion.position + self.phase).sin()
    }
}

/// The sinusoid over position whose product with the command takes most out of the residual.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let wave = strongest_wave(
        residual.position,
        |k| residual.command[k],
        residual.force,
        PERIODS.0..=PERIODS.1,
    )?;
    Some(vec![wave.amplitude().min(1.0), wave.period, wave.phase()])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;

    #[test]
    fn ripple_grows_with_the_command_and_turns_with_it() {
        let mut ripple = ForceRipple::new(&[0.02, 0.024, 0.0]);
        // A quarter of a period: the peak.
        let motion = Motion { position: 0.006, ..Motion::default() };
        assert!((ripple.change(100.0, &motion, 1e-4) - 2.0).abs() < 1e-12);
        assert!((ripple.change(-50.0, &motion, 1e-4) + 1.0).abs() < 1e-12);
        assert_eq!(ripple.change(0.0, &motion, 1e-4), 0.0);
    }

    #[test]
    fn proposal_finds_fraction_period_and_phase_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[0.02, 0.03, -0.7]);
        assert!(
            (found[0] / 0.02 - 1.0).abs() < 0.05 && (found[1] / 0.03 - 1.0).abs() < 0.005,
            "{found:?}"
        );
        assert!((found[2] + 0.7).abs() < 0.1, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
