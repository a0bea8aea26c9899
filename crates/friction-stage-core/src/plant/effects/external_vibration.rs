//! External vibration: a machine nearby shakes the stage at its own frequency.
//!
//! F = A sin(2 pi f t + phi) along +x on the carriage, also at rest: A amplitude (N), f frequency
//! (Hz), t time since the start (s), phi phase (rad). Source: inertia force of a base that moves
//! harmonically, m times its acceleration (assumed harmonic). A force from outside: it can give
//! energy and has no potential. Not modelled: several lines, drift of the frequency, the base's own
//! resonances.

use std::f64::consts::TAU;

use rustfft::{FftPlanner, num_complex::Complex};

use super::regression::{beyond_chance, evenly, golden_maximum, least_squares, step_of};
use super::{
    Action, EffectDescriptor, EffectParameter, ForceLaw, ForceOverStep, Motion, Multiplicity,
    ParameterKind, RecordSpecific, Residual, Role, descriptor,
};

/// Half angle of a step, rad, below which its mean and moment are taken from their series: what
/// that leaves out is below 1e-9 of the amplitude, and so is what the difference in the closed form
/// loses above it.
const SMALL_ANGLE: f64 = 2e-3;
/// Lowest and highest frequency, Hz.
const FREQUENCIES: (f64, f64) = (0.1, 1000.0);

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "external_vibration",
    role: Role::CarriageForce,
    law: "F = amplitude sin(2 pi frequency t + phase)",
    source: "inertia force of a harmonic base motion",
    telltale: "a narrow line in time at every speed and at rest, not seen by the force cell",
    parameters: &[
        EffectParameter::required("amplitude", "N", "peak force", (0.0, 1000.0), 1.0)
            .of_kind(ParameterKind::Amplitude),
        EffectParameter::required("frequency", "Hz", "frequency", FREQUENCIES, 0.1)
            .of_kind(ParameterKind::Frequency),
        EffectParameter::optional("phase", "rad", "phase at time 0", (-TAU, TAU), 1.0, 0.0)
            .of_kind(ParameterKind::Phase),
    ],
    multiplicity: Multiplicity::Several,
    record_specific: RecordSpecific::Phase,
    typical: &[0.5, 30.0, 0.0],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::CarriageForce(Box::new(ExternalVibration::new(values))),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

#[derive(Debug)]
struct ExternalVibration {
    amplitude: f64,
    /// rad/s
    rate: f64,
    phase: f64,
}

impl ExternalVibration {
    fn new(values: &[f64]) -> ExternalVibration {
        ExternalVibration { amplitude: values[0], rate: TAU * values[1], phase: values[2] }
    }
}

impl ForceLaw for ExternalVibration {
    fn force(&mut self, motion: &Motion, _step: f64) -> f64 {
        self.amplitude * (self.rate * motion.time + self.phase).sin()
    }

    fn force_over(&mut self, motion: &Motion, step: f64) -> ForceOverStep {
        let (sine, cosine) = (self.rate * motion.time + self.phase).sin_cos();
        // Integrals of sin(w t + phi) and of t sin(w t + phi) over a step about its middle, with
        // h = w step / 2.
        let half = 0.5 * self.rate * step;
        let (mean, moment) = if half < SMALL_ANGLE {
            (1.0 - half * half / 6.0, half / 6.0)
        } else {
            let (sine, cosine) = half.sin_cos();
            (sine / half, (sine - half * cosine) / (2.0 * half * half))
        };
        ForceOverStep {
            mean: self.amplitude * sine * mean,
            moment: self.amplitude * cosine * moment,
        }
    }
}

/// Bins of the spectrum on either side whose median is the background of a line.
const NEIGHBOURS: usize = 40;

/// The line of the spectrum that stands out most from its neighbourhood, refined between the bins.
///
/// What goes with the motion is broad in time; comparing a line with its neighbours keeps it out.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let count = residual.force.len();
    if count < 8 * NEIGHBOURS || residual.force.iter().any(|force| !force.is_finite()) {
        return None;
    }
    let rate = step_of(residual).recip();
    let force = evenly(residual, residual.force);
    let count = force.len();
    // Hann window: a strong low frequency must not leak into all bins.
    let mut spectrum: Vec<Complex<f64>> = force
        .iter()
        .enumerate()
        .map(|(k, force)| {
            Complex::new(force * (0.5 - 0.5 * (TAU * k as f64 / count as f64).cos()), 0.0)
        })
        .collect();
    FftPlanner::new().plan_fft_forward(count).process(&mut spectrum);
    let power: Vec<f64> = spectrum[..count / 2].iter().map(|line| line.norm_sqr()).collect();
    let per_bin = rate / count as f64;
    // Bins 0 to 2 hold the mean under the window.
    let first = ((FREQUENCIES.0 / per_bin).ceil() as usize).max(3);
    let last = ((FREQUENCIES.1 / per_bin) as usize).min(power.len() - 1);
    let mut sorted = Vec::with_capacity(2 * NEIGHBOURS + 1);
    let (bin, ratio) = (first..last)
        .filter(|bin| power[*bin] >= power[bin - 1] && power[*bin] >= power[bin + 1])
        .map(|bin| {
            let from = bin.saturating_sub(NEIGHBOURS).max(3);
            let to = (bin + NEIGHBOURS + 1).min(power.len());
            sorted.clear();
            sorted.extend_from_slice(&power[from..to]);
            let middle = sorted.len() / 2;
            let (_, median, _) = sorted.select_nth_unstable_by(middle, f64::total_cmp);
            (bin, power[bin] / median.max(f64::MIN_POSITIVE))
        })
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    // The power of noise in a bin is exponentially distributed, with its median at ln 2 of the
    // mean: twice its ratio to the mean is a chi-squared variable of two degrees, of a variance
    // that counts as known.
    if !beyond_chance(
        2.0 * ratio * std::f64::consts::LN_2,
        count as f64 - 2.0,
        count,
        2,
        last - first,
    ) {
        return None;
    }
    let fit = |frequency: f64| {
        least_squares(residual.force, |k| {
            let (sine, cosine) = (TAU * frequency * residual.time[k]).sin_cos();
            [1.0, sine, cosine]
        })
    };
    let explained = |frequency: f64| fit(frequency).map_or(f64::NEG_INFINITY, |fit| fit.explained);
    let frequency =
        golden_maximum((bin as f64 - 1.0) * per_bin, (bin as f64 + 1.0) * per_bin, explained);
    let [_, sine, cosine] = fit(frequency)?.coefficients;
    Some(vec![sine.hypot(cosine), frequency, cosine.atan2(sine)])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{Record, assert_silent_on_noise, proposal};
    use super::super::{Effects, cogging};
    use super::*;
    use crate::model::EffectParameters;

    #[test]
    fn force_follows_time_and_not_the_motion() {
        let mut effects = Effects::new(&[EffectParameters::new(
            "external_vibration",
            [("amplitude", 2.0), ("frequency", 5.0), ("phase", std::f64::consts::FRAC_PI_2)],
        )])
        .unwrap();
        for (time, expected) in [(0.0, 2.0), (0.05, 0.0), (0.1, -2.0), (0.2, 2.0)] {
            let (motor, carriage) = effects.advance(
                &Motion { time, velocity: 3.0, position: time, ..Motion::default() },
                1e-4,
            );
            assert!(motor == 0.0 && (carriage - expected).abs() < 1e-12, "{time} s: {carriage} N");
        }
    }

    /// The closed form of a step, and its series for a slow vibration, against the force in many
    /// pieces of it.
    #[test]
    fn over_a_long_step_it_is_the_force_of_its_pieces() {
        let (step, pieces) = (5e-4, 10_000);
        for frequency in [0.1, 1.2, 1.4, 69.0, 900.0] {
            let mut vibration = ExternalVibration::new(&[2.0, frequency, 0.7]);
            for time in [0.0, 0.013, 1.7] {
                let motion = Motion { time, ..Motion::default() };
                let mut expected = ForceOverStep::default();
                for piece in 0..pieces {
                    let aside = (f64::from(piece) + 0.5) / f64::from(pieces) - 0.5;
                    let there = Motion { time: time + aside * step, ..motion };
                    let force =
                        vibration.force(&there, step / f64::from(pieces)) / f64::from(pieces);
                    expected.mean += force;
                    expected.moment += aside * force;
                }
                let found = vibration.force_over(&motion, step);
                assert!(
                    (found.mean - expected.mean).abs() < 1e-8,
                    "{frequency} Hz: {found:?}, {expected:?}"
                );
                assert!(
                    (found.moment - expected.moment).abs() < 1e-8,
                    "{frequency} Hz: {found:?}, {expected:?}"
                );
            }
        }
    }

    #[test]
    fn proposal_finds_the_line_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[0.2, 48.7, 0.6]);
        assert!((found[0] / 0.2 - 1.0).abs() < 0.1 && (found[1] - 48.7).abs() < 0.005, "{found:?}");
        assert!((found[2] - 0.6).abs() < 0.3, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }

    #[test]
    fn rows_that_are_left_out_do_not_move_the_line() {
        let record =
            Record::motion().with_effect(&DESCRIPTOR, &[0.3, 48.7, 0.6]).with_noise(0.3, 5);
        let found = propose(&record.without_rows(2000..5000).residual()).unwrap();
        assert!((found[1] - 48.7).abs() < 0.005, "{found:?}");
    }

    #[test]
    fn a_stronger_force_over_position_does_not_hide_the_line() {
        let record = Record::motion()
            .with_effect(&cogging::DESCRIPTOR, &[3.0, 0.024, 0.0])
            .with_effect(&DESCRIPTOR, &[0.3, 31.0, 0.0])
            .with_noise(0.3, 2);
        let found = propose(&record.residual()).unwrap();
        assert!((found[1] - 31.0).abs() < 0.02, "{found:?}");
    }
}
