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

/// Multiplier of Knuth's linear congruential generator (MMIX).
const SCATTER: u64 = 6_364_136_223_846_793_005;

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

/// Part of the rows in motion whose speeds are within [`SAME`] of one that counts as held.
const HELD: f64 = 0.05;
/// By which part two speeds may differ that are one.
const SAME: f64 = 0.01;

/// The highest speed that is held, or that a turning motion has for a while; the highest of all
/// where none is.
fn highest_held(mut speeds: Vec<f64>) -> f64 {
    speeds.sort_by(f64::total_cmp);
    let least = (HELD * speeds.len() as f64).ceil() as usize;
    let highest = speeds.last().copied().unwrap_or(0.0);
    let held = speeds.iter().rev().copied().find(|speed| {
        let from = speeds.partition_point(|one| *one < (1.0 - SAME) * speed);
        let to = speeds.partition_point(|one| *one <= (1.0 + SAME) * speed);
        to - from >= least
    });
    held.unwrap_or(highest)
}

/// Amplitude of the best sine over position, as (period in m, N), for periods from a fiftieth of a
/// millimetre or twice the distance between two rows at the highest held speed, whichever is
/// longer, to the range of the positions: a shorter period looks like a longer one there. Only
/// rows in motion count.
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
    // Of each few rows one, at no even distance: even ones would make long periods of short ones.
    let one_of = |(index, rows): (usize, &[usize])| {
        let scattered = (index as u64 + 1).wrapping_mul(SCATTER) >> 33;
        rows[scattered as usize % rows.len()]
    };
    let speeds = moving.iter().map(|row| velocity[*row].abs()).collect();
    let moving: Vec<usize> = moving.chunks(every).enumerate().map(one_of).collect();
    let (low, high) = moving.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), row| {
        (low.min(position[*row]), high.max(position[*row]))
    });
    let shortest = (2.0 * highest_held(speeds) / kept_rate).max(2e-5);
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
            // At twice the distance of even rows a sine has one phase at all of them.
            let both = ss.min(cc) > 1e-3 * moving.len() as f64;
            let amplitude = if both && determinant > 1e-3 * ss * cc {
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

    #[test]
    fn periods_that_the_rows_alias_are_not_shown() {
        // A third of the record at 10 mm/s, the rest at 200 mm/s: rows of 200 Hz are 1 mm apart.
        let mut position = vec![0.0];
        let speed = |k: usize| if k % 3000 < 1000 { 0.01 } else { 0.2 };
        let sign = |k: usize| if (k / 300).is_multiple_of(2) { 1.0 } else { -1.0 };
        let velocity: Vec<f64> = (0..30_000).map(|k| sign(k) * speed(k)).collect();
        for speed in &velocity[1..] {
            position.push(position[position.len() - 1] + speed / 200.0);
        }
        let force: Vec<f64> = position.iter().map(|x| (TAU * x / 0.0006).sin()).collect();
        let spectrum = over_position(&position, &velocity, 200.0, &force);
        assert!((spectrum[0].0 - 2e-3).abs() < 1e-9, "{:?}", spectrum[0]);
        // Twenty thousand rows in motion are thinned out, which makes no peak of its own.
        let slow: Vec<f64> = velocity.iter().map(|v| v.signum() * 0.01).collect();
        let along: Vec<f64> = slow
            .iter()
            .scan(0.0, |at, speed| {
                *at += speed / 200.0;
                Some(*at)
            })
            .collect();
        let force: Vec<f64> = along.iter().map(|x| (TAU * x / 0.0006).sin()).collect();
        let spectrum = over_position(&along, &slow, 200.0, &force);
        let shown: Vec<_> = spectrum.into_iter().filter(|point| point.1.is_finite()).collect();
        let peak = shown.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        assert!((peak.0 / 0.0006 - 1.0).abs() < 0.03 && peak.1 > 0.8, "{peak:?}");
        let far = shown.iter().filter(|point| (point.0 / 0.0006 - 1.0).abs() > 0.3);
        assert!(far.map(|point| point.1).fold(0.0, f64::max) < 0.4, "{peak:?}");
    }
}
