//! Speed ripple: a ripple over the position whose size grows with the speed.
//!
//! F = c s sin(2 pi x / p + phi), along +x on the motor side: c coefficient (N s/m), p period (m),
//! phi phase at x = 0 (rad), s in one of two forms:
//! - `braking`: s = v, which turns with the direction: the brake of eddy currents that changes
//!   along the magnets;
//! - `driving`: s = |v|: harmonics of the induced voltage that a current loop of finite gain lets
//!   through.
//!
//! Source: induced currents and voltages are proportional to the speed (Gieras, Piech, Tomczuk,
//! "Linear Synchronous Motors", 2nd ed. 2011); assumed: one harmonic, no limit at high speed.
//! Sizes: assumed, some newtons at the highest speed. It is no potential: braking takes energy
//! where a viscous friction of more than c is with it, driving is paid for by the motor. With a
//! `cogging` of the same period and phase it is one ripple whose amplitude changes with the speed.
//! Not modelled: higher harmonics, skin effect.
//!
//! Two speeds distinguish it from `cogging`, the direction one form from the other.

use std::f64::consts::TAU;

use super::regression::strongest_wave;
use super::{
    Action, EffectDescriptor, EffectParameter, ForceLaw, Motion, Multiplicity, ParameterKind,
    RecordSpecific, Residual, Role, descriptor,
};

/// Shortest and longest period, m; of a turning joint up to some sixteen turns, rad.
const PERIODS: (f64, f64) = (1e-4, 100.0);
/// Largest coefficient, N s/m.
const LARGEST: f64 = 1e5;
/// Names of the forms, in the order of their numbers in a slice of values.
const FORMS: [&str; 2] = ["braking", "driving"];
/// Where this value stands.
const FORM: usize = 3;

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "speed_ripple",
    role: Role::MotorForce,
    law: "F = coefficient s sin(2 pi x / period + phase); braking: s = v; driving: s = |v|",
    source: "induced currents and voltages proportional to the speed (Gieras, Piech, Tomczuk \
             2011), one harmonic (assumed)",
    telltale: "periodic in position, proportional to the speed, seen by the force cell",
    parameters: &[
        EffectParameter::required(
            "coefficient",
            "N s/m",
            "peak force per speed",
            (0.0, LARGEST),
            5.0,
        ),
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
        EffectParameter::choice("form", "whether it turns with the direction", &FORMS),
    ],
    multiplicity: Multiplicity::Several,
    record_specific: RecordSpecific::Nothing,
    typical: &[10.0, 24e-3, 0.0, 0.0],
    check: descriptor::any,
    free: |_, index| index != FORM,
    build: |values| Action::MotorForce(Box::new(SpeedRipple::new(values))),
    proposal: Some(propose),
    starts: |values, _| descriptor::every_form(values, FORM, FORMS.len() as u8),
    curve: None,
};

#[derive(Debug)]
struct SpeedRipple {
    coefficient: f64,
    wave_number: f64,
    phase: f64,
    drives: bool,
}

impl SpeedRipple {
    fn new(values: &[f64]) -> SpeedRipple {
        SpeedRipple {
            coefficient: values[0],
            wave_number: TAU / values[1],
            phase: values[2],
            drives: values[FORM] > 0.5,
        }
    }
}

/// s of a form.
fn speed(velocity: f64, drives: bool) -> f64 {
    if drives { velocity.abs() } else { velocity }
}

impl ForceLaw for SpeedRipple {
    fn force(&mut self, motion: &Motion, _step: f64) -> f64 {
        self.coefficient
            * speed(motion.velocity, self.drives)
            * (self.wave_number * motion.position + self.phase).sin()
    }
}

/// The sinusoid over position whose product with the speed takes most out of the residual, of the
/// better of both forms.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let of_form = |drives: bool| {
        let gain = |k: usize| speed(residual.velocity[k], drives);
        let periods = PERIODS.0..=PERIODS.1;
        let wave = strongest_wave(residual.position, gain, residual.force, periods)?;
        Some((wave, drives))
    };
    let both = [of_form(false), of_form(true)].into_iter().flatten();
    let (wave, drives) = both.max_by(|one, two| one.0.explained.total_cmp(&two.0.explained))?;
    let coefficient = wave.amplitude().min(LARGEST);
    Some(vec![coefficient, wave.period, wave.phase(), f64::from(u8::from(drives))])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;

    #[test]
    fn it_grows_with_the_speed_and_turns_with_it_in_one_form() {
        // A quarter of a period: the peak.
        let force = |form: f64, velocity: f64| {
            let motion = Motion { position: 0.006, velocity, ..Motion::default() };
            SpeedRipple::new(&[10.0, 0.024, 0.0, form]).force(&motion, 1e-4)
        };
        for (form, velocity, expected) in
            [(0.0, 0.2, 2.0), (0.0, -0.4, -4.0), (1.0, 0.2, 2.0), (1.0, -0.4, 4.0), (0.0, 0.0, 0.0)]
        {
            let found = force(form, velocity);
            assert!((found - expected).abs() < 1e-12, "form {form}, {velocity} m/s: {found} N");
        }
    }

    #[test]
    fn proposal_finds_both_forms_under_noise_and_nothing_in_noise() {
        for form in [0.0, 1.0] {
            let found = proposal(&DESCRIPTOR, &[12.0, 0.03, -0.7, form]);
            assert_eq!(found[FORM], form, "{found:?}");
            assert!(
                (found[0] / 12.0 - 1.0).abs() < 0.1 && (found[1] / 0.03 - 1.0).abs() < 0.005,
                "{found:?}"
            );
            assert!((found[2] + 0.7).abs() < 0.1, "{found:?}");
        }
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
