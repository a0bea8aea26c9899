//! Encoder subdivision error: within each signal period the encoder reads a little to the left and
//! to the right.
//!
//! Reading x + A sin(2 pi x / p + phi): A amplitude (m), p signal period (m), phi phase at x = 0
//! (rad). In a residual it shows as m d2(reading - x)/dt2 = m A (k a cos(k x + phi) - k^2 v^2 sin(k
//! x + phi)) along +x, k = 2 pi / p: it grows with v^2. Source: offset of the sine and cosine
//! signals before interpolation (R. Heydemann, Applied Optics 20(19), 1981), first harmonic. Sizes:
//! assumed, 1 to 2 % of the signal period at worst, p = 2 to 20 µm. Not modelled: second harmonic
//! (unequal amplitudes, quadrature error), change along the scale.

use std::f64::consts::TAU;

use rustfft::{FftPlanner, num_complex::Complex};

use super::regression::{Fit, beyond_chance, golden_maximum, least_squares};
use super::{
    Action, EffectDescriptor, EffectParameter, Multiplicity, ParameterKind, ReadingLaw,
    RecordSpecific, Residual, Role, descriptor,
};

/// Shortest and longest signal period, m.
const PERIODS: (f64, f64) = (1e-7, 1e-2);

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "encoder_sde",
    role: Role::Encoder,
    law: "reading = x + amplitude sin(2 pi x / period + phase)",
    source: "Heydemann 1981, first harmonic",
    telltale: "apparent force of micrometre period over position that grows with v^2",
    parameters: &[
        EffectParameter::required(
            "amplitude",
            "m",
            "largest error of the reading",
            (0.0, 1e-3),
            1e-8,
        )
        .of_kind(ParameterKind::Amplitude),
        EffectParameter::required("period", "m", "signal period of the scale", PERIODS, 1e-7)
            .of_kind(ParameterKind::Period),
        EffectParameter::optional("phase", "rad", "phase at position 0", (-TAU, TAU), 1.0, 0.0)
            .of_kind(ParameterKind::Phase),
    ],
    multiplicity: Multiplicity::Several,
    record_specific: RecordSpecific::Nothing,
    typical: &[2e-8, 4e-6, 0.0],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::Encoder(Box::new(EncoderSde::new(values))),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

#[derive(Debug)]
struct EncoderSde {
    amplitude: f64,
    wave_number: f64,
    phase: f64,
}

impl EncoderSde {
    fn new(values: &[f64]) -> EncoderSde {
        EncoderSde { amplitude: values[0], wave_number: TAU / values[1], phase: values[2] }
    }
}

impl ReadingLaw for EncoderSde {
    fn reading(&self, _time: f64, position: f64) -> f64 {
        position + self.amplitude * (self.wave_number * position + self.phase).sin()
    }
}

/// Longest period that is looked for, m: longer ones are cogging's and the balls' range.
const LONGEST: f64 = 256e-6;
/// Shortest period that is looked for, m.
const SHORTEST: f64 = 1e-6;
/// Bins per shortest period of an octave, and most bins.
const BINS_PER_PERIOD: f64 = 8.0;
const MOST_BINS: usize = 1 << 21;

/// The wave over position whose second difference over time takes most out of the residual: octave
/// by octave of the period a spectrum over position; then refined with the whole law.
///
/// At every sample and before the lowpass: the error is a function of the position however fast the
/// carriage passes, and between samples it may well run through more than one period.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let samples = residual.samples;
    let count = samples.force.len();
    if count < 100 || samples.position.iter().chain(samples.force).any(|value| !value.is_finite()) {
        return None;
    }
    // The sum over k of force_k D2 exp(i q x_k), with D2 the second difference, is that of D2
    // force_k exp(i q x_k).
    let bends: Vec<f64> =
        samples.force.windows(3).map(|three| three[2] - 2.0 * three[1] + three[0]).collect();
    let along = &samples.position[1..count - 1];
    let lowest = along.iter().copied().fold(f64::INFINITY, f64::min);
    let highest = along.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let mut planner = FftPlanner::new();
    let mut best: Option<(f64, f64, f64)> = None;
    let mut tried = 0;
    let mut shortest = SHORTEST;
    while shortest < LONGEST && highest - lowest > 4.0 * shortest {
        let width = shortest / BINS_PER_PERIOD;
        let bins =
            ((((highest - lowest) / width) as usize + 2).next_power_of_two()).clamp(256, MOST_BINS);
        let mut spectrum = vec![Complex::new(0.0, 0.0); bins];
        for (position, bend) in along.iter().zip(&bends) {
            let bin = ((position - lowest) / width) as usize;
            if bin < bins {
                spectrum[bin].re += bend;
            }
        }
        planner.plan_fft_forward(bins).process(&mut spectrum);
        // Cycles over all bins of the octave from 2 `shortest` down to `shortest`.
        let cycles = (bins as f64 / (2.0 * BINS_PER_PERIOD)) as usize
            ..=(bins as f64 / BINS_PER_PERIOD) as usize;
        tried += cycles.end() - cycles.start() + 1;
        for cycle in cycles {
            let power = spectrum[cycle].norm_sqr();
            if best.is_none_or(|best| power > best.0) {
                let length = bins as f64 * width;
                best = Some((power, TAU * cycle as f64 / length, TAU / length));
            }
        }
        shortest *= 2.0;
    }
    let (_, coarse, spacing) = best?;
    let inertia = residual.mass / (samples.step * samples.step);
    let fit = |wave_number: f64| -> Option<Fit<2>> {
        let waves: Vec<(f64, f64)> =
            samples.position.iter().map(|x| (wave_number * x).sin_cos()).collect();
        least_squares(&samples.force[1..count - 1], |index| {
            let (before, here, after) = (waves[index], waves[index + 1], waves[index + 2]);
            [
                inertia * (after.0 - 2.0 * here.0 + before.0),
                inertia * (after.1 - 2.0 * here.1 + before.1),
            ]
        })
    };
    let explained = |wave_number: f64| fit(wave_number).map_or(0.0, |fit| fit.explained);
    let wave_number = golden_maximum(coarse - spacing, coarse + spacing, explained);
    let fit = fit(wave_number)?;
    let [sine, cosine] = fit.coefficients;
    beyond_chance(fit.explained, fit.total - fit.explained, fit.count, 2, tried)
        .then(|| vec![sine.hypot(cosine), TAU / wave_number, cosine.atan2(sine)])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{Record, STEP, assert_silent_on_noise};
    use super::*;

    #[test]
    fn error_repeats_with_the_signal_period_and_has_the_amplitude() {
        let sde = EncoderSde::new(&[30e-9, 4e-6, 0.0]);
        for (position, error) in [(0.0, 0.0), (1e-6, 30e-9), (3e-6, -30e-9), (101e-6, 30e-9)] {
            assert!((sde.reading(0.0, position) - position - error).abs() < 1e-18, "{position} m");
        }
    }

    /// 1 mm to and fro at up to 0.9 mm/s, as a slow loop of a guide test.
    fn slow_motion() -> Record {
        Record::along((0..40_000).map(|k| 1e-3 * (0.9 * k as f64 * STEP).sin()).collect())
    }

    #[test]
    fn proposal_finds_amplitude_and_period_under_noise_and_nothing_in_noise() {
        let record =
            slow_motion().with_effect(&DESCRIPTOR, &[20e-9, 4.1e-6, 0.8]).with_noise(0.3, 6);
        let found = propose(&record.residual()).unwrap();
        assert!((found[1] / 4.1e-6 - 1.0).abs() < 1e-4, "{found:?}");
        // The second difference over 0.5 ms reads up to 5 % less than the acceleration.
        assert!((found[0] / 20e-9 - 1.0).abs() < 0.1 && (found[2] - 0.8).abs() < 0.2, "{found:?}");
        assert!(propose(&slow_motion().with_noise(0.3, 6).residual()).is_none());
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
