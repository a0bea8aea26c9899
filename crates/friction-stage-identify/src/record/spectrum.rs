//! Spectra of a residual: over time by the method of Welch (1967), over position by least squares,
//! because positions are not evenly spaced.

use std::f64::consts::{PI, TAU};

use rustfft::FftPlanner;
use rustfft::num_complex::Complex;

use crate::record::measured::Measured;

/// Rows of a piece that is transformed at once.
const PIECE: usize = 1024;
/// Share of the largest speed below which the carriage counts as at rest.
const MOVING: f64 = 0.02;
/// Most rows of the least squares over position. Assumed: a figure needs no more.
const MOST_ROWS: usize = 6000;

/// Amplitude density over frequency, as (Hz, N per root of Hz), of values at the rows of a
/// recording: Hann windows, half overlapping, over pieces without a gap.
pub fn over_time(measured: &Measured, values: &[f64]) -> Vec<(f64, f64)> {
    let rate = measured.lowpass.kept_rate();
    let factor = measured.lowpass.factor();
    let piece = PIECE.min(values.len());
    if piece < 16 || values.len() != measured.rows.len() {
        return Vec::new();
    }
    let window: Vec<f64> =
        (0..piece).map(|k| 0.5 - 0.5 * (TAU * k as f64 / piece as f64).cos()).collect();
    let power: f64 = window.iter().map(|w| w * w).sum();
    let fft = FftPlanner::new().plan_fft_forward(piece);
    let mut density = vec![0.0; piece / 2];
    let mut pieces = 0;
    let mut start = 0;
    while start + piece <= values.len() {
        let whole = measured.rows[start + piece - 1] - measured.rows[start] == factor * (piece - 1);
        if whole {
            let mut buffer: Vec<Complex<f64>> = values[start..start + piece]
                .iter()
                .zip(&window)
                .map(|(value, weight)| Complex::new(value * weight, 0.0))
                .collect();
            fft.process(&mut buffer);
            for (sum, bin) in density.iter_mut().zip(&buffer) {
                *sum += 2.0 * bin.norm_sqr() / (rate * power);
            }
            pieces += 1;
        }
        start += if whole { piece / 2 } else { 16 };
    }
    if pieces == 0 {
        return Vec::new();
    }
    density
        .iter()
        .enumerate()
        .skip(1)
        .map(|(bin, sum)| (bin as f64 * rate / piece as f64, (sum / pieces as f64).sqrt()))
        .collect()
}

/// Amplitude of the best sine over position, as (period in m, N), for periods from a fiftieth of a
/// millimetre or the distance between two rows at the usual speed, whichever is longer, to the
/// range of the positions. Only rows in motion count.
pub fn over_position(
    position: &[f64],
    velocity: &[f64],
    kept_rate: f64,
    values: &[f64],
) -> Vec<(f64, f64)> {
    let fastest = velocity.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    let moving: Vec<usize> =
        (0..values.len()).filter(|row| velocity[*row].abs() > MOVING * fastest).collect();
    if moving.len() < 64 {
        return Vec::new();
    }
    let every = moving.len().div_ceil(MOST_ROWS);
    let moving: Vec<usize> = moving.into_iter().step_by(every).collect();
    let (low, high) = moving.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), row| {
        (low.min(position[*row]), high.max(position[*row]))
    });
    let mut speeds: Vec<f64> = moving.iter().map(|row| velocity[*row].abs()).collect();
    let middle = speeds.len() / 2;
    let usual = *speeds.select_nth_unstable_by(middle, f64::total_cmp).1;
    let shortest = (2.0 * usual * every as f64 / kept_rate).max(2e-5);
    if high - low <= 2.0 * shortest {
        return Vec::new();
    }
    let mean = moving.iter().map(|row| values[*row]).sum::<f64>() / moving.len() as f64;
    // Steps of a third of the resolution, as many as a figure shows at the most.
    let step = 0.33 / (high - low);
    let count = (((1.0 / shortest - 0.5 / (high - low)) / step).ceil() as usize).clamp(2, 800);
    let ratio = ((high - low) * 2.0 / shortest).powf(1.0 / count as f64);
    (0..=count)
        .map(|index| {
            let period = shortest * ratio.powi(index as i32);
            let wave = 2.0 * PI / period;
            let (mut ss, mut cc, mut sc, mut s, mut c) = (0.0, 0.0, 0.0, 0.0, 0.0);
            for row in &moving {
                let (sine, cosine) = (wave * position[*row]).sin_cos();
                let value = values[*row] - mean;
                ss += sine * sine;
                cc += cosine * cosine;
                sc += sine * cosine;
                s += sine * value;
                c += cosine * value;
            }
            let determinant = ss * cc - sc * sc;
            let amplitude = if determinant > 1e-3 * ss * cc {
                (((s * cc - c * sc) / determinant).powi(2)
                    + ((c * ss - s * sc) / determinant).powi(2))
                .sqrt()
            } else {
                f64::NAN
            };
            (period, amplitude)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ripple_over_position_stands_out_at_its_period() {
        let time: Vec<f64> = (0..20_000).map(|k| k as f64 * 2e-3).collect();
        let position: Vec<f64> = time.iter().map(|t| 0.05 * (TAU * 0.11 * t).sin()).collect();
        let velocity: Vec<f64> =
            time.iter().map(|t| 0.05 * TAU * 0.11 * (TAU * 0.11 * t).cos()).collect();
        let force: Vec<f64> =
            position.iter().map(|x| 1.5 * (TAU * x / 0.004 + 0.3).sin()).collect();
        let spectrum = over_position(&position, &velocity, 500.0, &force);
        let peak = spectrum.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        assert!((peak.0 / 0.004 - 1.0).abs() < 0.02 && (peak.1 - 1.5).abs() < 0.1, "{peak:?}");
    }
}
