//! Cogging: the magnets of the motor pull the slider towards the iron teeth.
//!
//! F = A sin(2 pi x / p + phi), along +x on the motor side: A amplitude (N), p period (m), phi
//! phase at x = 0 (rad). The force depends on position alone, not on current and not on speed, and
//! does no work over a period. Source: first harmonic of the detent force of iron-core linear
//! motors (Gieras, Piech, Tomczuk, "Linear Synchronous Motors", 2nd ed. 2011). Sizes: assumed, 1 to
//! 2 % of rated force at a magnet pitch of 24 to 32 mm. Not modelled: higher harmonics, end effects
//! of the slider.

use std::f64::consts::TAU;

use super::regression::strongest_wave;
use super::{
    Action, EffectDescriptor, EffectParameter, ForceLaw, Motion, Multiplicity, ParameterKind,
    RecordSpecific, Residual, Role, descriptor,
};

/// Shortest and longest period, m; of a turning joint up to some sixteen turns, rad.
const PERIODS: (f64, f64) = (1e-4, 100.0);

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "cogging",
    role: Role::MotorForce,
    law: "F = amplitude sin(2 pi x / period + phase)",
    source: "Gieras, Piech, Tomczuk 2011, first harmonic of the detent force",
    telltale: "periodic in position at every speed, independent of the force, seen by the force \
               cell",
    parameters: &[
        EffectParameter::required("amplitude", "N", "peak force", (0.0, 1000.0), 1.0)
            .of_kind(ParameterKind::Amplitude),
        EffectParameter::required(
            "period",
            "m",
            "distance after which the force repeats",
            PERIODS,
            1e-3,
        )
        .of_kind(ParameterKind::Period),
        EffectParameter::optional("phase", "rad", "phase at position 0", (-TAU, TAU), 1.0, 0.0)
            .of_kind(ParameterKind::Phase),
    ],
    multiplicity: Multiplicity::Several,
    record_specific: RecordSpecific::Nothing,
    typical: &[2.0, 24e-3, 0.0],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::MotorForce(Box::new(Cogging::new(values))),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

#[derive(Debug)]
struct Cogging {
    amplitude: f64,
    wave_number: f64,
    phase: f64,
}

impl Cogging {
    fn new(values: &[f64]) -> Cogging {
        Cogging { amplitude: values[0], wave_number: TAU / values[1], phase: values[2] }
    }
}

impl ForceLaw for Cogging {
    fn force(&mut self, motion: &Motion, _step: f64) -> f64 {
        self.amplitude * (self.wave_number * motion.position + self.phase).sin()
    }

    fn stiffness(&self) -> f64 {
        self.amplitude * self.wave_number
    }

    fn stored_energy(&self, position: f64) -> f64 {
        self.amplitude / self.wave_number * (self.wave_number * position + self.phase).cos()
    }
}

/// The sinusoid over position that takes most out of the residual.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let wave = strongest_wave(residual.position, |_| 1.0, residual.force, PERIODS.0..=PERIODS.1)?;
    Some(vec![wave.amplitude(), wave.period, wave.phase()])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;

    #[test]
    fn force_is_the_slope_of_the_stored_energy() {
        let mut cogging = Cogging { amplitude: 6.0, wave_number: TAU / 0.024, phase: 0.4 };
        for position in [-0.03, 0.0, 0.007, 0.021] {
            let h = 1e-6;
            let slope = (cogging.stored_energy(position + h) - cogging.stored_energy(position - h))
                / (2.0 * h);
            let motion = Motion { position, ..Motion::default() };
            assert!((cogging.force(&motion, 1e-5) + slope).abs() < 1e-6);
        }
    }

    #[test]
    fn proposal_finds_amplitude_period_and_phase_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[1.5, 0.0123, 1.1]);
        assert!(
            (found[0] - 1.5).abs() < 0.1 && (found[1] / 0.0123 - 1.0).abs() < 0.002,
            "{found:?}"
        );
        assert!((found[2] - 1.1).abs() < 0.1, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
