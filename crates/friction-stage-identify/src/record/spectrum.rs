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
    let piece = PIECE.min(values.len());
    let pieces = periodograms(&measured.rows, measured.lowpass.factor(), rate, values, piece, true);
    if pieces.is_empty() {
        return Vec::new();
    }
    mean_of(&pieces)
        .into_iter()
        .enumerate()
        .skip(1)
        .map(|(bin, mean)| (bin as f64 * rate / piece as f64, mean.sqrt()))
        .collect()
}

/// Power densities, N^2/Hz, at the frequencies k `rate` / `piece`, of pieces without a gap, with
/// Hann windows, overlapping by half or not at all. `rows` are the samples, `factor` apart, of the
/// values, `rate` is that of the values.
pub(crate) fn periodograms(
    rows: &[usize],
    factor: usize,
    rate: f64,
    values: &[f64],
    piece: usize,
    overlapping: bool,
) -> Vec<Vec<f64>> {
    if piece < 16 || values.len() != rows.len() {
        return Vec::new();
    }
    let window: Vec<f64> =
        (0..piece).map(|k| 0.5 - 0.5 * (TAU * k as f64 / piece as f64).cos()).collect();
    let power: f64 = window.iter().map(|w| w * w).sum();
    let fft = FftPlanner::new().plan_fft_forward(piece);
    let mut pieces = Vec::new();
    let mut start = 0;
    while start + piece <= values.len() {
        let whole = rows[start + piece - 1] - rows[start] == factor * (piece - 1);
        if whole {
            let mut buffer: Vec<Complex<f64>> = values[start..start + piece]
                .iter()
                .zip(&window)
                .map(|(value, weight)| Complex::new(value * weight, 0.0))
                .collect();
            fft.process(&mut buffer);
            buffer.truncate(piece / 2);
            pieces.push(buffer.iter().map(|bin| 2.0 * bin.norm_sqr() / (rate * power)).collect());
        }
        start += match (whole, overlapping) {
            (true, true) => piece / 2,
            (true, false) => piece,
            (false, _) => 16,
        };
    }
    pieces
}

/// Mean of power densities, bin by bin.
pub(crate) fn mean_of(pieces: &[Vec<f64>]) -> Vec<f64> {
    let mut mean = vec![0.0; pieces.first().map_or(0, Vec::len)];
    for piece in pieces {
        mean.iter_mut().zip(piece).for_each(|(sum, bin)| *sum += bin);
    }
    mean.iter_mut().for_each(|sum| *sum /= pieces.len() as f64);
    mean
}

/// Rows at which the carriage moves: at more than [`MOVING`] of its largest speed.
pub(crate) fn moving(velocity: &[f64]) -> Vec<usize> {
    let fastest = velocity.iter().fold(0.0, |most: f64, v| most.max(v.abs()));
    (0..velocity.len()).filter(|row| velocity[*row].abs() > MOVING * fastest).collect()
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
    let moving = moving(velocity);
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
