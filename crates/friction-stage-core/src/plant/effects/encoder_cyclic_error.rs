//! Encoder cyclic error: the encoder reads a little to the left and to the right over millimetres
//! to decimetres, as an eccentric disc, a screw or the divisions of a scale make it.
//!
//! Reading x + A sin(2 pi x / p + phi): A amplitude (m), p period (m), phi phase at x = 0 (rad). In
//! a residual it shows as m d2(reading - x)/dt2 = m A (k a cos(k x + phi) - k^2 v^2 sin(k x +
//! phi)) along +x, k = 2 pi / p. Source: first harmonic of the error of an eccentric graduated disc
//! and of the lead of a screw over one turn (A. Slocum, "Precision Machine Design", 1992, ch. 4 and
//! 10). Sizes: assumed, 1 to 50 µm; p the lead of the screw or the travel of one turn, 2 to 50 mm.
//! Not modelled: harmonics (several of these), error that grows along the scale (`encoder_scale`),
//! a reading that depends on the direction.
//!
//! The law of `encoder_sde` over periods a thousand times as long, from another cause.
//! Two speeds distinguish it from a `cogging` of the same period, which does not grow with v^2;
//! below some 0.1 m/s it is within the noise. A period longer than the travel is an
//! `encoder_scale`.

use std::f64::consts::TAU;

use super::regression::{
    BINS, Fit, MOST_CYCLES, STEPS_PER_CYCLE, beyond_chance, golden_maximum, least_squares,
};
use super::{
    Action, EffectDescriptor, EffectParameter, Multiplicity, ParameterKind, ReadingLaw,
    RecordSpecific, Residual, Role, descriptor,
};
use crate::model::ModelError;

/// Shortest and longest period, m; of a turning joint one turn is 6.3 rad.
const PERIODS: (f64, f64) = (5e-4, 10.0);

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "encoder_cyclic_error",
    role: Role::Encoder,
    law: "reading = x + amplitude sin(2 pi x / period + phase)",
    source: "Slocum 1992, eccentric disc and lead of a screw, first harmonic",
    telltale: "apparent force, periodic over millimetres to decimetres of position, that grows \
               with v^2",
    parameters: &[
        EffectParameter::required(
            "amplitude",
            "m",
            "largest error of the reading",
            (0.0, 1e-2),
            1e-6,
        )
        .of_kind(ParameterKind::Amplitude),
        EffectParameter::required(
            "period",
            "m",
            "distance after which the error repeats",
            PERIODS,
            1e-3,
        )
        .of_kind(ParameterKind::Period),
        EffectParameter::optional("phase", "rad", "phase at position 0", (-TAU, TAU), 1.0, 0.0)
            .of_kind(ParameterKind::Phase),
    ],
    multiplicity: Multiplicity::Several,
    record_specific: RecordSpecific::Nothing,
    typical: &[5e-6, 1e-2, 0.0],
    check: reads_forwards,
    free: descriptor::all_free,
    build: |values| Action::Encoder(Box::new(EncoderCyclicError::new(values))),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

/// Largest slope of the error over the position: with 1 the reading would stand still somewhere.
const STEEPEST: f64 = 0.9;

/// Refuses an error whose slope is so large that one reading has two positions.
fn reads_forwards(values: &[f64]) -> Result<(), ModelError> {
    let slope = TAU * values[0] / values[1];
    if slope < STEEPEST {
        return Ok(());
    }
    Err(ModelError::Value {
        key: "effects.encoder_cyclic_error (2 pi amplitude / period)".to_owned(),
        value: slope,
        limit: format!("be below {STEEPEST}: otherwise one reading has two positions"),
    })
}

#[derive(Debug)]
struct EncoderCyclicError {
    amplitude: f64,
    wave_number: f64,
    phase: f64,
}

impl EncoderCyclicError {
    fn new(values: &[f64]) -> EncoderCyclicError {
        EncoderCyclicError { amplitude: values[0], wave_number: TAU / values[1], phase: values[2] }
    }
}

impl ReadingLaw for EncoderCyclicError {
    fn reading(&self, _time: f64, position: f64) -> f64 {
        position + self.amplitude * (self.wave_number * position + self.phase).sin()
    }
}

/// Fewest periods within the travel: less cannot be distinguished from a scale.
const FEWEST_CYCLES: f64 = 0.75;

/// Sums over the rows of one bin: products of acceleration a, square of the velocity w and force f.
#[derive(Clone, Copy, Debug, Default)]
struct Bin {
    aa: f64,
    aw: f64,
    ww: f64,
    af: f64,
    wf: f64,
}

/// The wave over position whose apparent force explains most of the residual: with the rows
/// gathered in bins of the position, then refined with all rows.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let lowest = residual.position.iter().copied().fold(f64::INFINITY, f64::min);
    let highest = residual.position.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let range = highest - lowest;
    let most = (range / PERIODS.0).min(MOST_CYCLES);
    if !range.is_finite() || most <= FEWEST_CYCLES {
        return None;
    }
    let width = range / BINS as f64;
    let mut bins = vec![Bin::default(); BINS];
    for (k, position) in residual.position.iter().enumerate() {
        let (force, acceleration) = (residual.force[k], residual.mass * residual.acceleration[k]);
        let square = residual.mass * residual.velocity[k].powi(2);
        if !(force.is_finite() && acceleration.is_finite() && square.is_finite()) {
            continue;
        }
        let bin = &mut bins[(((position - lowest) / width) as usize).min(BINS - 1)];
        bin.aa += acceleration * acceleration;
        bin.aw += acceleration * square;
        bin.ww += square * square;
        bin.af += acceleration * force;
        bin.wf += square * force;
    }
    let steps = ((most - FEWEST_CYCLES) * STEPS_PER_CYCLE as f64).ceil().max(1.0);
    let wave_number =
        |step: f64| TAU * (FEWEST_CYCLES + (most - FEWEST_CYCLES) * step / steps) / range;
    let roughly = |step: f64| explained_in_bins(&bins, wave_number(step), width);
    let best = (0..=steps as usize)
        .map(|step| (step as f64, roughly(step as f64)))
        .max_by(|a, b| a.1.total_cmp(&b.1))?
        .0;
    let fit = |wave_number: f64| -> Option<Fit<2>> {
        least_squares(residual.force, |k| {
            let (sine, cosine) = (wave_number * residual.position[k]).sin_cos();
            let along = residual.mass * wave_number * residual.acceleration[k];
            let across = residual.mass * (wave_number * residual.velocity[k]).powi(2);
            [along * cosine - across * sine, -along * sine - across * cosine]
        })
    };
    let explained = |step: f64| fit(wave_number(step)).map_or(0.0, |fit| fit.explained);
    let step = golden_maximum((best - 1.0).max(0.0), (best + 1.0).min(steps), explained);
    let fit = fit(wave_number(step))?;
    if !beyond_chance(fit.explained, fit.total - fit.explained, fit.count, 2, steps as usize + 1) {
        return None;
    }
    let [sine, cosine] = fit.coefficients;
    let period = TAU / wave_number(step);
    // What passes for more than that is no error of an encoder.
    let amplitude = sine.hypot(cosine).min(0.5 * STEEPEST * period / TAU);
    Some(vec![amplitude, period, cosine.atan2(sine)])
}

/// Reduction of the sum of squares of the bins, `width` (m) apart, by a wave of this number, rad/m.
fn explained_in_bins(bins: &[Bin], wave_number: f64, width: f64) -> f64 {
    let (turn_sine, turn_cosine) = (wave_number * width).sin_cos();
    let (mut sine, mut cosine) = (0.5 * wave_number * width).sin_cos();
    let square = wave_number * wave_number;
    // Products of the two columns k a cos - k^2 w sin and -k a sin - k^2 w cos, and with the force.
    let (mut ss, mut sc, mut cc, mut fs, mut fc) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for bin in bins {
        let (aa, aw, ww) =
            (square * bin.aa, square * wave_number * bin.aw, square * square * bin.ww);
        let (af, wf) = (wave_number * bin.af, square * bin.wf);
        ss += aa * cosine * cosine - 2.0 * aw * sine * cosine + ww * sine * sine;
        cc += aa * sine * sine + 2.0 * aw * sine * cosine + ww * cosine * cosine;
        sc += (ww - aa) * sine * cosine + aw * (sine * sine - cosine * cosine);
        fs += af * cosine - wf * sine;
        fc += -af * sine - wf * cosine;
        (sine, cosine) =
            (sine * turn_cosine + cosine * turn_sine, cosine * turn_cosine - sine * turn_sine);
    }
    let determinant = ss * cc - sc * sc;
    // The columns must differ by more than 1e-6 of their squares.
    if determinant.is_nan() || determinant <= 1e-6 * ss * cc {
        return 0.0;
    }
    (fs * fs * cc - 2.0 * fs * fc * sc + fc * fc * ss) / determinant
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;

    #[test]
    fn error_repeats_with_the_period_and_has_the_amplitude() {
        let cyclic = EncoderCyclicError::new(&[4e-6, 0.02, 0.0]);
        for (position, error) in [(0.0, 0.0), (0.005, 4e-6), (0.015, -4e-6), (0.105, 4e-6)] {
            let found = cyclic.reading(0.0, position) - position;
            assert!((found - error).abs() < 1e-15, "{position} m: {found}");
        }
    }

    #[test]
    fn an_error_that_gives_one_reading_two_positions_is_refused() {
        assert!(reads_forwards(&[1e-4, 1e-3, 0.0]).is_ok());
        let refused = reads_forwards(&[2e-4, 1e-3, 0.0]).unwrap_err().to_string();
        assert!(refused.contains("two positions"), "{refused}");
    }

    #[test]
    fn proposal_finds_amplitude_period_and_phase_under_noise_and_nothing_in_noise() {
        for (amplitude, period) in [(5e-6, 9e-3), (60e-6, 0.11)] {
            let found = proposal(&DESCRIPTOR, &[amplitude, period, 0.6]);
            assert!(
                (found[0] / amplitude - 1.0).abs() < 0.1 && (found[1] / period - 1.0).abs() < 0.02,
                "{found:?}"
            );
            assert!((found[2] - 0.6).abs() < 0.3, "{found:?}");
        }
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
