//! Where a residual sits: in which band, when, at which places, in which direction of travel, and
//! which signals of the motion it is correlated with.
//!
//! Each statement is made only where the residual shows more of it than chance does:
//! - the band against the residual of a null record, piece by piece (test of Kolmogorov and Smirnov
//!   on the cumulative periodogram: Bartlett, An Introduction to Stochastic Processes, 1955, 9.2),
//!   by exchanging the two in pieces drawn at random;
//! - the time against normal noise of the same spectrum;
//! - place and direction against the same residual in pieces of random length in random order: rare
//!   bursts remain rare, and only their relation to the motion is lost;
//! - a correlation against its standard deviation for noise of the same spectrum and envelope, less
//!   the correlation that the noise in the measured motion makes on a null record, and against what
//!   a law must explain.

use std::ops::Range;

use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;
use serde::Serialize;

use crate::closed_loop::LinearController;
use crate::hypothesis::{Hypothesis, Sides};
use crate::record::measured::{Floor, Measured};
use crate::record::spectrum::{mean_of, moving, periodograms};
use crate::search::{ALL_BUT_NOISE, Criteria};
use friction_stage_core::model::ModelError;
use friction_stage_core::numerics::correlation::correlation_length;
use friction_stage_core::plant::Side;

/// Draws of chance: a statement is made where none of them reaches it, a level of one in 400.
const DRAWS: u64 = 399;
/// Standard deviations that a normal variable exceeds, on either side, once in 400 times.
const ONE_IN_400: f64 = 3.023;
/// Pieces into which a record is divided for spectra. Assumed: 2^16 ways to exchange them.
const PIECES: usize = 16;
/// Fewest pieces without a gap: there are 2^9 different ways to exchange them, more than draws.
const FEWEST_PIECES: usize = 10;
/// Fewest rows in motion that place and direction are asked of. Assumed.
const FEWEST_ROWS: usize = 64;
/// Equal parts of the distance travelled. Assumed: finer than a place that matters.
const CELLS: usize = 2000;
/// Correlation lengths of a residual over which its envelope is taken, on either side. Assumed:
/// more than a period of what oscillates.
const ENVELOPE: f64 = 4.0;
/// Correlation lengths of powers in a piece of them that is shuffled. Assumed: most of what is
/// correlated is in one piece.
const SHUFFLED: f64 = 4.0;
/// Of the noise of the null record.
const NULL_SEED: u64 = 1;
/// Part of the power beyond that of noise that is most of it. Assumed: more than one of two equal
/// bursts.
const MOST: f64 = 0.75;
/// Largest share of a record that a single event fills. Assumed.
const EVENT: f64 = 0.1;

/// The shortest interval that holds three quarters of the power of a residual beyond that of noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MostPower {
    /// Where it begins.
    pub from: f64,
    /// Where it ends.
    pub to: f64,
    /// Share of all frequencies, of all the time or of the distance travelled that is in it.
    pub share: f64,
}

/// Power of a residual in the positive direction of travel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PositiveDirection {
    /// Share of the power in motion.
    pub power: f64,
    /// Share of the time in motion.
    pub time: f64,
}

/// A signal that a residual may be correlated with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum MotionSignal {
    /// Force command.
    Command,
    /// Velocity.
    Velocity,
    /// Acceleration.
    Acceleration,
    /// Derivative of the acceleration.
    Jerk,
}

impl MotionSignal {
    /// As in the summary.
    pub fn name(self) -> &'static str {
        match self {
            Self::Command => "command",
            Self::Velocity => "velocity",
            Self::Acceleration => "acceleration",
            Self::Jerk => "jerk",
        }
    }
}

/// Correlation of a residual with a signal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SignalCorrelation {
    /// The signal.
    pub signal: MotionSignal,
    /// -1 to 1.
    pub correlation: f64,
}

/// Where a residual sits; what chance does as well is left out.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ResidualLocation {
    /// Band that holds most of the power, Hz.
    pub band: Option<MostPower>,
    /// Interval of time that holds most of the power, s.
    pub time: Option<MostPower>,
    /// Interval of time that holds nineteen twentieths of the power beyond that of the noise, s,
    /// where it is short against the record: a single event.
    pub event: Option<[f64; 2]>,
    /// Positions between which most of the power over the distance travelled is, m.
    pub place: Option<MostPower>,
    /// Power in the positive direction.
    pub direction: Option<PositiveDirection>,
    /// The largest first.
    pub correlations: Vec<SignalCorrelation>,
}

impl ResidualLocation {
    /// Whether chance does all of it as well.
    pub fn is_empty(&self) -> bool {
        *self == ResidualLocation::default()
    }
}

/// What a hypothesis leaves of a record on the side of the stage where that is most.
#[derive(Clone, Debug, PartialEq)]
pub struct SideResidual {
    /// Motor or carriage.
    pub side: Side,
    /// What is left there, N rms.
    pub left: f64,
    /// What noise leaves there, N rms.
    pub noise_floor: f64,
    /// Where it sits.
    pub location: ResidualLocation,
}

impl Hypothesis {
    /// Where what it leaves of a record sits; `None` where that is no more than noise, which leaves
    /// `floor`. `controller` is that of the record, where it is known.
    pub fn residual_location(
        &self,
        measured: &Measured,
        floor: Floor,
        controller: Option<&LinearController>,
    ) -> Result<Option<SideResidual>, ModelError> {
        let missing = self.missing(measured, Sides::BOTH)?;
        if missing.rms() <= ALL_BUT_NOISE * floor.total() {
            return Ok(None);
        }
        let null = self.null_record(measured, controller, NULL_SEED)?;
        let of_null = self.missing(&null, Sides::BOTH)?;
        let (motor, carriage) = missing.squares();
        let on_motor = motor - floor.motor.powi(2) > carriage - floor.carriage.powi(2);
        let (side, left, noise_floor, residual, of_null) = if on_motor {
            (Side::Motor, motor, floor.motor, missing.motor, of_null.motor)
        } else {
            (Side::Carriage, carriage, floor.carriage, missing.carriage, of_null.carriage)
        };
        let location = LocatedResidual::new(measured, &residual)
            .location(&LocatedResidual::new(&null, &of_null), noise_floor);
        Ok(Some(SideResidual { side, left: left.sqrt(), noise_floor, location }))
    }
}

/// A residual with the motion that it is of, row by row.
struct LocatedResidual {
    /// Samples that the rows are of, `factor` apart where none is left out.
    rows: Vec<usize>,
    factor: usize,
    /// Of the rows, Hz.
    rate: f64,
    time: Vec<f64>,
    position: Vec<f64>,
    velocity: Vec<f64>,
    signals: [(MotionSignal, Vec<f64>); 4],
    /// Less its mean, N.
    residual: Vec<f64>,
}

impl LocatedResidual {
    /// Of a residual at the rows of a record, N.
    fn new(measured: &Measured, residual: &[f64]) -> LocatedResidual {
        let (acceleration, count) = (&measured.acceleration, measured.len());
        let jerk: Vec<f64> = (0..count)
            .map(|k| {
                let (before, after) = (k.saturating_sub(1), (k + 1).min(count - 1));
                0.5 * (acceleration[after] - acceleration[before]) * measured.rate
            })
            .collect();
        LocatedResidual {
            rows: measured.rows.clone(),
            factor: measured.lowpass.factor(),
            rate: measured.lowpass.kept_rate(),
            time: measured.at_rows(&measured.time),
            position: measured.at_rows(&measured.position),
            velocity: measured.at_rows(&measured.velocity),
            signals: [
                (MotionSignal::Command, measured.filtered(&measured.command)),
                (MotionSignal::Velocity, measured.filtered(&measured.velocity)),
                (MotionSignal::Acceleration, measured.filtered(acceleration)),
                (MotionSignal::Jerk, measured.filtered(&jerk)),
            ],
            residual: centered(residual),
        }
    }

    /// Where it sits, against the residual of a null record of the same motion. `floor` is what
    /// noise leaves, N rms.
    fn location(&self, null: &LocatedResidual, floor: f64) -> ResidualLocation {
        let (mine, of_null) = (self.spectra(), null.spectra());
        let time = self.time(&mine, floor);
        ResidualLocation {
            band: self.band(&mine, &of_null),
            event: time.and_then(|_| self.event(floor)),
            time,
            place: self.place(floor),
            direction: self.direction(),
            correlations: self.correlations(null, floor),
        }
    }

    /// Bin of the spectra in which a line of the whole record is.
    fn bin(&self, line: usize, density: &[f64]) -> usize {
        let bin = line as f64 * self.piece() as f64 / self.residual.len() as f64;
        (bin.round() as usize).min(density.len() - 1)
    }

    fn piece(&self) -> usize {
        self.residual.len() / PIECES
    }

    fn spectra(&self) -> Vec<Vec<f64>> {
        self.spectra_of(&self.residual)
    }

    fn spectra_of(&self, values: &[f64]) -> Vec<Vec<f64>> {
        periodograms(&self.rows, self.factor, self.rate, values, self.piece(), false)
    }

    fn band(&self, mine: &[Vec<f64>], of_null: &[Vec<f64>]) -> Option<MostPower> {
        let count = mine.len().min(of_null.len());
        if count < FEWEST_PIECES {
            return None;
        }
        let total = |pieces: &[Vec<f64>]| pieces.iter().flatten().sum::<f64>();
        let (mine, of_null) = (&mine[..count], &of_null[..count]);
        let scale = total(mine) / total(of_null);
        if !(scale.is_finite() && scale > 0.0) {
            return None;
        }
        let bins = mine[0].len();
        let distance = |exchanged: &[bool]| {
            let (mut one, mut other) = (vec![0.0; bins], vec![0.0; bins]);
            for ((mine, null), exchanged) in mine.iter().zip(of_null).zip(exchanged) {
                let (to, from) =
                    if *exchanged { (&mut other, &mut one) } else { (&mut one, &mut other) };
                to.iter_mut().zip(mine).for_each(|(sum, bin)| *sum += bin);
                from.iter_mut().zip(null).for_each(|(sum, bin)| *sum += scale * bin);
            }
            let sums = |of: &[f64]| of.iter().sum::<f64>();
            let (all, all_other) = (sums(&one), sums(&other));
            let (mut share, mut share_other) = (0.0, 0.0);
            one.iter().zip(&other).fold(0.0, |most: f64, (bin, bin_other)| {
                share += bin / all;
                share_other += bin_other / all_other;
                most.max((share - share_other).abs())
            })
        };
        let found = distance(&vec![false; count]);
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let by_chance = (0..DRAWS).any(|_| {
            let exchanged: Vec<bool> = (0..count).map(|_| random.random()).collect();
            // All or none of them exchanged is what was found.
            let mixed = exchanged.iter().any(|one| *one != exchanged[0]);
            mixed && distance(&exchanged) >= found
        });
        if by_chance {
            return None;
        }
        let beyond: Vec<f64> = mean_of(mine)
            .into_iter()
            .zip(mean_of(of_null))
            .map(|(mine, null)| mine - null)
            .collect();
        let band = most(&beyond)?;
        let step = self.rate / self.piece() as f64;
        Some(MostPower {
            from: (band.start as f64 - 0.5).max(0.0) * step,
            to: (band.end as f64 - 0.5) * step,
            share: band.len() as f64 / bins as f64,
        })
    }

    fn time(&self, mine: &[Vec<f64>], floor: f64) -> Option<MostPower> {
        let (count, density) = (self.residual.len(), mean_of(mine));
        let found = most(&beyond(&self.residual, floor)).filter(|_| !density.is_empty())?;
        let back = FftPlanner::new().plan_fft_inverse(count);
        let sizes: Vec<f64> =
            (0..count / 2).map(|line| density[self.bin(line, &density)].sqrt()).collect();
        let size = rms(&self.residual);
        let lasts_as_short = |seed: u64| {
            let mut random = ChaCha8Rng::seed_from_u64(seed);
            let mut normal = || StandardNormal.sample(&mut random);
            let mut noise = vec![Complex::new(0.0, 0.0); count];
            for line in 1..count / 2 {
                let value = sizes[line] * Complex::new(normal(), normal());
                (noise[line], noise[count - line]) = (value, value.conj());
            }
            back.process(&mut noise);
            let noise: Vec<f64> = noise.iter().map(|value| value.re).collect();
            let scale = size / rms(&noise);
            let noise: Vec<f64> = noise.iter().map(|value| scale * value).collect();
            most(&beyond(&noise, floor)).is_some_and(|most| most.len() <= found.len())
        };
        if (0..DRAWS).into_par_iter().any(lasts_as_short) {
            return None;
        }
        Some(MostPower {
            from: self.time[found.start],
            to: self.time[found.end - 1],
            share: found.len() as f64 / count as f64,
        })
    }

    fn event(&self, floor: f64) -> Option<[f64; 2]> {
        let beyond = beyond(&self.residual, floor);
        let event = shortest_with(
            &beyond,
            (1.0 - Criteria::USUAL.left_at_most) * beyond.iter().sum::<f64>(),
        )?;
        let short = (event.len() as f64) < EVENT * beyond.len() as f64;
        short.then(|| [self.time[event.start], self.time[event.end - 1]])
    }

    fn place(&self, floor: f64) -> Option<MostPower> {
        let moving = moving(&self.velocity);
        if moving.len() < FEWEST_ROWS {
            return None;
        }
        let beyond = beyond(&self.residual, floor);
        let along = |values: &[f64]| {
            let rows = moving.iter().map(|row| (self.velocity[*row].abs(), values[*row]));
            by_distance(&rows.collect::<Vec<_>>())
        };
        let (powers, position) = (along(&beyond), along(&self.position));
        let mut by_position: Vec<usize> = (0..CELLS).collect();
        by_position.sort_by(|a, b| position[*a].total_cmp(&position[*b]));
        let there = |powers: &[f64]| {
            most(&by_position.iter().map(|cell| powers[*cell]).collect::<Vec<_>>())
        };
        let found = there(&powers)?;
        let as_narrow = |drawn: &[f64]| there(drawn).is_some_and(|most| most.len() <= found.len());
        if any_in_other_order(&powers, as_narrow) {
            return None;
        }
        let at = |index: usize| position[by_position[index]];
        Some(MostPower {
            from: at(found.start),
            to: at(found.end - 1),
            share: found.len() as f64 / CELLS as f64,
        })
    }

    fn direction(&self) -> Option<PositiveDirection> {
        let moving = moving(&self.velocity);
        let positive: Vec<bool> = moving.iter().map(|row| self.velocity[*row] > 0.0).collect();
        let time =
            positive.iter().filter(|positive| **positive).count() as f64 / moving.len() as f64;
        // One way alone says nothing about the other.
        if moving.len() < FEWEST_ROWS || time == 0.0 || time == 1.0 {
            return None;
        }
        let power = |powers: &[f64]| {
            let there = powers.iter().zip(&positive).filter(|(_, positive)| **positive);
            there.map(|(power, _)| power).sum::<f64>() / powers.iter().sum::<f64>()
        };
        let powers: Vec<f64> = moving.iter().map(|row| self.residual[*row].powi(2)).collect();
        let found = power(&powers);
        let as_much = |drawn: &[f64]| (power(drawn) - time).abs() >= (found - time).abs();
        let shown = found.is_finite() && !any_in_other_order(&powers, as_much);
        shown.then_some(PositiveDirection { power: found, time })
    }

    fn correlations(&self, null: &LocatedResidual, floor: f64) -> Vec<SignalCorrelation> {
        let (Some(noise), Some(of_null)) = (self.as_noise(), null.as_noise()) else {
            return Vec::new();
        };
        let size = rms(&self.residual);
        let mut found: Vec<SignalCorrelation> = self
            .signals
            .iter()
            .zip(&null.signals)
            .filter_map(|((signal, values), (_, null_values))| {
                let (values, null_values) = (centered(values), centered(null_values));
                let product = self.product(&values) - null.product(&null_values);
                let variance = noise.variance(&values) + of_null.variance(&null_values);
                let correlation = product / (size * rms(&values));
                let gain = (correlation * size).powi(2);
                let shown = product.abs() > ONE_IN_400 * variance.sqrt()
                    && gain > Criteria::USUAL.seen_on_carriage() * floor * floor;
                shown.then_some(SignalCorrelation { signal: *signal, correlation })
            })
            .filter(|one| one.correlation.is_finite())
            .collect();
        found.sort_by(|a, b| b.correlation.abs().total_cmp(&a.correlation.abs()));
        found
    }

    /// Mean product with a signal.
    fn product(&self, values: &[f64]) -> f64 {
        let products = self.residual.iter().zip(values).map(|(one, other)| one * other);
        products.sum::<f64>() / values.len() as f64
    }

    /// The residual as stationary noise times an envelope, which is its rms nearby.
    fn as_noise(&self) -> Option<EnvelopedNoise> {
        let count = self.residual.len();
        let reach = (ENVELOPE * correlation_length(&self.residual)).ceil() as usize;
        let mut sums = vec![0.0];
        for value in &self.residual {
            sums.push(sums[sums.len() - 1] + value * value);
        }
        let nearby = |row: usize| {
            let rows = row.saturating_sub(reach)..(row + reach + 1).min(count);
            ((sums[rows.end] - sums[rows.start]).max(0.0) / rows.len() as f64).sqrt()
        };
        let envelope: Vec<f64> = (0..count).map(nearby).collect();
        let noise: Vec<f64> = self
            .residual
            .iter()
            .zip(&envelope)
            .map(|(value, size)| if *size > 0.0 { value / size } else { 0.0 })
            .collect();
        let density = mean_of(&self.spectra_of(&noise));
        let of_line = |line: usize| density[self.bin(line, &density)] * self.rate / count as f64;
        let lines = (!density.is_empty()).then(|| (0..count.div_ceil(2)).map(of_line).collect())?;
        Some(EnvelopedNoise { envelope, lines })
    }
}

/// Stationary noise times an envelope.
struct EnvelopedNoise {
    /// N, row by row.
    envelope: Vec<f64>,
    /// Power of the stationary noise in the lines of the whole record.
    lines: Vec<f64>,
}

impl EnvelopedNoise {
    /// Variance of its mean product with a signal: line by line half the powers of the noise and
    /// of the signal times the envelope.
    fn variance(&self, values: &[f64]) -> f64 {
        let count = values.len();
        let mut signal: Vec<Complex<f64>> = values
            .iter()
            .zip(&self.envelope)
            .map(|(value, size)| Complex::new(value * size, 0.0))
            .collect();
        FftPlanner::new().plan_fft_forward(count).process(&mut signal);
        let powers = signal.iter().map(|line| line.norm_sqr() / (count as f64).powi(2));
        let of_lines = self.lines.iter().zip(powers).enumerate();
        of_lines
            .map(|(line, (noise, power))| if line == 0 { 0.5 } else { 1.0 } * noise * power)
            .sum()
    }
}

fn centered(values: &[f64]) -> Vec<f64> {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    values.iter().map(|value| value - mean).collect()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
}

/// Powers beyond that of noise of this rms.
fn beyond(values: &[f64], noise: f64) -> Vec<f64> {
    values.iter().map(|value| value * value - noise * noise).collect()
}

/// Means over [`CELLS`] equal parts of a distance, of values (second) each of which stands for a
/// part of it (first).
fn by_distance(rows: &[(f64, f64)]) -> Vec<f64> {
    let cell = rows.iter().map(|(way, _)| way).sum::<f64>() / CELLS as f64;
    let mut means = vec![0.0; CELLS];
    let mut at = 0.0;
    for (way, value) in rows {
        let (from, to) = (at / cell, (at + way) / cell);
        at += way;
        let last = (to as usize).min(CELLS - 1);
        for (index, mean) in means[..=last].iter_mut().enumerate().skip(from as usize) {
            let part = to.min(index as f64 + 1.0) - from.max(index as f64);
            *mean += part.max(0.0) * value;
        }
    }
    means
}

/// The shortest stretch with most of a sum; `None` where the sum is no more than 0.
fn most(powers: &[f64]) -> Option<Range<usize>> {
    shortest_with(powers, MOST * powers.iter().sum::<f64>())
}

/// The shortest stretch whose sum is at least so much, more than 0. A start is of no use once a
/// later one has no larger sum before it, nor once a stretch from it is long enough.
fn shortest_with(values: &[f64], least: f64) -> Option<Range<usize>> {
    if least.is_nan() || least <= 0.0 {
        return None;
    }
    let mut starts = std::collections::VecDeque::from([(0, 0.0)]);
    let (mut sum, mut shortest) = (0.0, None::<Range<usize>>);
    for (index, value) in values.iter().enumerate() {
        sum += value;
        while let Some((start, before)) = starts.front().copied()
            && sum - before >= least
        {
            let stretch = start..index + 1;
            if shortest.as_ref().is_none_or(|known| stretch.len() < known.len()) {
                shortest = Some(stretch);
            }
            starts.pop_front();
        }
        while starts.back().is_some_and(|(_, before)| *before >= sum) {
            starts.pop_back();
        }
        starts.push_back((index + 1, sum));
    }
    shortest
}

/// Whether something holds of these powers in any other order: pieces of random length, on average
/// [`SHUFFLED`] correlation lengths long, are shuffled.
fn any_in_other_order(powers: &[f64], holds: impl Fn(&[f64]) -> bool + Sync) -> bool {
    let ends = (SHUFFLED * correlation_length(&centered(powers))).recip();
    (0..DRAWS).into_par_iter().any(|seed| {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut pieces: Vec<Range<usize>> = Vec::new();
        let mut start = 0;
        for end in 1..=powers.len() {
            if end == powers.len() || random.random_bool(ends) {
                pieces.push(start..end);
                start = end;
            }
        }
        pieces.shuffle(&mut random);
        let shuffled: Vec<f64> =
            pieces.into_iter().flat_map(|piece| powers[piece].iter().copied()).collect();
        holds(&shuffled)
    })
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    const RATE: f64 = 500.0;
    const SECONDS: f64 = 20.0;

    /// Moves of 40 to 60 mm to and fro with rests between them, of the accelerations of a cosine
    /// (position, velocity, acceleration, jerk), with a command over a mass of 40 kg.
    fn motion() -> LocatedResidual {
        let count = (RATE * SECONDS) as usize;
        let (mut position, mut start) = ([0.0; 4].map(|_| vec![0.0; count]), 0.0);
        let (mut from, mut row) = (0.0, 0);
        for step in 0.. {
            let (travel, moves, rests) = (
                [0.05, -0.04, 0.06, -0.07][step % 4],
                0.8 + 0.1 * (step % 3) as f64,
                0.2 + 0.1 * (step % 2) as f64,
            );
            while row < count && row as f64 / RATE < start + moves + rests {
                let wave = TAU / moves;
                let at = (row as f64 / RATE - start).min(moves);
                let size = travel / moves;
                position[0][row] = from + size * (at - (wave * at).sin() / wave);
                position[1][row] = size * (1.0 - (wave * at).cos());
                position[2][row] = size * wave * (wave * at).sin();
                if at < moves {
                    position[3][row] = size * wave * wave * (wave * at).cos();
                }
                row += 1;
            }
            if row == count {
                break;
            }
            (from, start) = (from + travel, start + moves + rests);
        }
        let [position, velocity, acceleration, jerk] = position;
        // What friction and load hold of the command is not of the other three.
        let command = (0..count)
            .map(|row| {
                let slow = 60.0 * (TAU * 0.31 * row as f64 / RATE).sin();
                40.0 * acceleration[row] + 50.0 * velocity[row].signum() + slow
            })
            .collect();
        LocatedResidual {
            rows: (0..count).map(|row| 4 * row).collect(),
            factor: 4,
            rate: RATE,
            time: (0..count).map(|row| row as f64 / RATE).collect(),
            position,
            velocity: velocity.clone(),
            signals: [
                (MotionSignal::Command, command),
                (MotionSignal::Velocity, velocity),
                (MotionSignal::Acceleration, acceleration),
                (MotionSignal::Jerk, jerk),
            ],
            residual: Vec::new(),
        }
    }

    fn white(count: usize, seed: u64) -> Vec<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        (0..count).map(|_| StandardNormal.sample(&mut random)).collect()
    }

    /// White noise of 1 N, filtered to a correlation of `memory` from row to row.
    fn colored(count: usize, seed: u64, memory: f64) -> Vec<f64> {
        let mut last = 0.0;
        let step = |value: f64| {
            last = memory * last + (1.0 - memory * memory).sqrt() * value;
            last
        };
        white(count, seed).into_iter().map(step).collect()
    }

    /// Where a force of the motion, N by row, sits in noise of 1 N.
    fn located(force: impl Fn(&LocatedResidual, usize) -> f64, seed: u64) -> ResidualLocation {
        let (mut real, mut null) = (motion(), motion());
        let count = real.rows.len();
        let noise = white(count, 1000 + seed);
        let residual: Vec<f64> = (0..count).map(|row| force(&real, row) + noise[row]).collect();
        real.residual = centered(&residual);
        null.residual = centered(&white(count, 2000 + seed));
        real.location(&null, 1.0)
    }

    /// Ten times as loud as the sensors: a location is asked for, and there is none.
    #[test]
    fn noise_sits_nowhere() {
        for memory in [0.0, 0.8, 0.95] {
            let statements: Vec<u64> = (0..100)
                .filter(|seed| {
                    let (mut real, mut null) = (motion(), motion());
                    let count = real.rows.len();
                    real.residual = centered(&colored(count, *seed, memory));
                    null.residual = centered(&colored(count, 500 + seed, memory));
                    let found = real.location(&null, 0.1);
                    if !found.is_empty() {
                        println!("{memory} {seed} {found:?}");
                    }
                    !found.is_empty()
                })
                .collect();
            assert!(statements.len() <= 5, "{memory}: {statements:?}");
        }
    }

    #[test]
    fn a_vibration_is_located_by_its_band() {
        let found = located(|real, row| 3.0 * (TAU * 37.0 * real.time[row]).sin(), 1);
        let band = found.band.expect("a band");
        assert!(band.from < 37.0 && band.to > 37.0 && band.to - band.from < 4.0, "{band:?}");
        let rest = ResidualLocation { band: None, ..found };
        assert!(rest.is_empty(), "{rest:?}");
    }

    #[test]
    fn a_knock_is_located_by_its_time_as_an_event() {
        let knock = |real: &LocatedResidual, row: usize| {
            let since = real.time[row] - 7.3;
            if since < 0.0 {
                0.0
            } else {
                200.0 * (-since / 0.05).exp() * (TAU * 20.0 * since).cos()
            }
        };
        let found = located(knock, 2);
        let time = found.time.expect("a time");
        assert!((time.from - 7.3).abs() < 0.005 && time.to < 7.4, "{time:?}");
        let [from, to] = found.event.expect("an event");
        assert!((from - 7.3).abs() < 0.005 && to < 7.8, "{from} {to}");
        assert!(found.place.is_none() && found.direction.is_none(), "{found:?}");
        assert!(found.correlations.is_empty(), "{found:?}");
    }

    /// From half of the record on, so that no single event is there.
    #[test]
    fn what_begins_late_is_located_by_its_time() {
        let late = |real: &LocatedResidual, row: usize| {
            if real.time[row] > 12.0 { 4.0 * (TAU * 11.0 * real.time[row]).sin() } else { 0.0 }
        };
        let found = located(late, 3);
        let time = found.time.expect("a time");
        assert!(time.from > 11.9 && time.share < 0.35, "{time:?}");
        assert_eq!(found.event, None);
    }

    #[test]
    fn a_bad_place_is_located_by_its_position() {
        let bump = |real: &LocatedResidual, row: usize| {
            let off = (real.position[row] - 0.03) / 0.002;
            8.0 * (-off * off).exp() * if real.velocity[row] > 0.0 { 1.0 } else { -1.0 }
        };
        let found = located(bump, 4);
        let place = found.place.expect("a place");
        assert!(place.from > 0.027 && place.to < 0.033 && place.share < 0.2, "{place:?}");
        assert!(found.direction.is_none() && found.event.is_none(), "{found:?}");
    }

    #[test]
    fn a_rattle_one_way_is_located_by_its_direction() {
        let rattle = white(20_000, 77);
        let found = located(
            |real, row| if real.velocity[row] < -1e-3 { 4.0 * rattle[row] } else { 0.0 },
            5,
        );
        let direction = found.direction.expect("a direction");
        assert!(direction.power < 0.15 && direction.time > 0.3, "{direction:?}");
        assert!(found.correlations.is_empty() && found.event.is_none(), "{found:?}");
    }

    #[test]
    fn a_force_of_a_signal_is_located_by_its_correlation() {
        for (index, sign) in [(0, 1.0), (1, -1.0), (2, 1.0), (3, -1.0)] {
            let signal = motion().signals[index].0;
            let size = 2.0 / rms(&centered(&motion().signals[index].1));
            let found =
                located(|real, row| sign * size * real.signals[index].1[row], 10 + index as u64);
            let first = found.correlations.first().expect("a correlation");
            // 4 of 5 parts of the power are of the signal.
            let expected = sign * 0.8f64.sqrt();
            assert!(
                first.signal == signal && (first.correlation - expected).abs() < 0.03,
                "{signal:?}: {found:?}"
            );
        }
    }

    /// What the noise of the motion makes of a correlation is none of the residual.
    #[test]
    fn the_noise_of_the_encoder_is_correlated_with_no_acceleration() {
        let with_noise = |seed: u64| {
            let mut real = motion();
            let noise = white(real.rows.len(), seed);
            real.signals[2].1.iter_mut().zip(&noise).for_each(|(value, noise)| *value += noise);
            real.residual = centered(&noise);
            real
        };
        let found = with_noise(1).location(&with_noise(2), 0.1);
        assert!(found.correlations.is_empty(), "{found:?}");
    }

    #[test]
    fn means_over_the_distance_are_those_of_what_stands_for_it() {
        // A third of the way at 1, two thirds at 4; a mean over all of it is 3.
        let means = by_distance(&[(0.5, 1.0), (0.5, 1.0), (2.0, 4.0)]);
        assert!((means[0] - 1.0).abs() < 1e-9 && (means[CELLS - 1] - 4.0).abs() < 1e-9);
        assert!((means.iter().sum::<f64>() / CELLS as f64 - 3.0).abs() < 1e-9);
    }

    #[test]
    fn the_shortest_stretch_is_found_among_values_of_both_signs() {
        let values = [3.0, -1.0, 2.0, -5.0, 4.0, 1.0, -1.0, 6.0];
        for (least, expected) in
            [(4.0, Some(4..5)), (6.0, Some(7..8)), (10.0, Some(4..8)), (11.0, None), (0.0, None)]
        {
            assert_eq!(shortest_with(&values, least), expected, "{least}");
        }
        // All stretches of all lengths, one after the other.
        let mut random = ChaCha8Rng::seed_from_u64(3);
        for _ in 0..200 {
            let values: Vec<f64> = (0..12).map(|_| random.random_range(-5.0f64..5.0)).collect();
            let least = random.random_range(0.1..12.0);
            let brute = (1..=12).find(|length| {
                (0..=12 - length).any(|k| values[k..k + length].iter().sum::<f64>() >= least)
            });
            assert_eq!(shortest_with(&values, least).map(|found| found.len()), brute);
        }
    }
}
