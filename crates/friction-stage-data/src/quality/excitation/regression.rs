//! The force regressed on the motion, and one signal on another.

use std::ops::{Range, RangeInclusive};

use nalgebra::{Matrix4, Matrix5, Vector4, Vector5};

use super::judgement::LEAST_INERTIA;
use super::motion::Moment;
use super::{Examiner, NOISE_IN_ACCELERATION, RoughFit, clear_speed, rms_of_acceleration_noise};
use crate::signals::Signal;
use friction_stage_core::model::Guide;
use friction_stage_core::numerics::correlation::correlation_length;

/// Evenness from which on no turn is within a moment, of which the force is a mean: of a carriage
/// that accelerates evenly from rest, at the moment's start, it is a third.
const ONE_WAY: f64 = 1.0 / 3.0;
/// Break-away distances after a turn from which on a guide slides: its bristles are then at
/// 1 - e^-5 of their force.
const BREAK_AWAYS: f64 = 5.0;

/// Part of a value of all data that one half of them gives, by itself, where the value is more than
/// what else happens in one stretch of the motion. Assumed.
pub(super) const ALIKE: RangeInclusive<f64> = 0.5..=2.0;

impl RoughFit {
    /// Whether the mass is known well enough to say that a sign, a unit or the machine is another:
    /// where the acceleration explains little, or less than the fit leaves, what the fit lacks
    /// passes for a mass.
    pub(super) fn knows_the_mass(&self) -> bool {
        self.acceleration_is_seen()
            && self.mass_deviation < 0.1 * self.mass.abs()
            && self.masses_of_halves.iter().all(|half| ALIKE.contains(&(half / self.mass)))
            && self.by_acceleration_alone >= LEAST_INERTIA.max(1.0 - self.explained)
    }

    /// Whether the acceleration is one of the carriage, not of the encoder's noise, which would
    /// make the mass too small.
    pub(super) fn acceleration_is_seen(&self) -> bool {
        self.apparent_acceleration < NOISE_IN_ACCELERATION
    }
}

impl Examiner<'_> {
    /// The force of a column around a moment, with the weights that a second difference gives it.
    fn force_at(&self, column: &[f64], row: usize) -> f64 {
        let w = self.half as isize;
        let mut sum = 0.0;
        for offset in -w + 1..w {
            sum += (w - offset.abs()) as f64 * column[(row as isize + offset) as usize];
        }
        sum / (w * w) as f64
    }

    /// Travel after a turn from which on the guides slide, m: before, they are springs.
    fn sliding_distance(&self) -> f64 {
        let guides = self.model.and_then(|model| model.resolved_guides().ok()).unwrap_or_default();
        let break_away = |guide: &Guide| guide.static_force / guide.stiffness;
        BREAK_AWAYS * guides.iter().map(break_away).fold(0.0, f64::max)
    }

    pub(super) fn regress(
        &self,
        signal: Signal,
        moments: &[Moment],
        rest_speed: f64,
        noise: f64,
    ) -> Option<RoughFit> {
        let column = self.column(signal);
        let least = clear_speed(rest_speed);
        let slides = self.sliding_distance();
        let moving = || {
            let clear = |m: &&Moment| {
                m.velocity.abs() > least && m.since_turn > slides && m.evenness > ONE_WAY
            };
            moments.iter().filter(clear)
        };
        // The last column is the position, which the fit itself leaves out.
        let (mut all, mut right_of_all) = (Matrix5::zeros(), Vector5::zeros());
        let (mut count, mut squares) = (0usize, 0.0);
        // scaled, so that the matrix is well conditioned
        let scale_a = moving().map(|m| m.acceleration.abs()).fold(f64::MIN_POSITIVE, f64::max);
        let scale_v = moving().map(|m| m.velocity.abs()).fold(f64::MIN_POSITIVE, f64::max);
        let position = |m: &Moment| self.recording.trace.position[m.row];
        let (lowest, highest) = moving()
            .map(position)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        let scale_x = (highest - lowest).max(f64::MIN_POSITIVE);
        let row = |m: &Moment| {
            Vector4::new(m.acceleration / scale_a, m.velocity.signum(), m.velocity / scale_v, 1.0)
        };
        let row_of_all = |m: &Moment| row(m).push((position(m) - lowest) / scale_x - 0.5);
        for moment in moving() {
            let force = self.force_at(column, moment.row);
            let row = row_of_all(moment);
            all += row * row.transpose();
            right_of_all += row * force;
            squares += force * force;
            count += 1;
        }
        if count < 20 || squares == 0.0 {
            return None;
        }
        // one direction or one speed only: the least solution is taken, and reported elsewhere
        let normal: Matrix4<f64> = all.fixed_view::<4, 4>(0, 0).into_owned();
        let inverse = normal.pseudo_inverse(1e-9 * count as f64).ok()?;
        let fit = inverse * right_of_all.fixed_rows::<4>(0);
        let inverse_of_all = all.pseudo_inverse(1e-9 * count as f64).ok()?;
        let fit_of_all = inverse_of_all * right_of_all;
        let (mut rest, mut rest_of_all) = (Vec::with_capacity(count), Vec::with_capacity(count));
        let (mut inertial, mut accelerations) = (0.0, 0.0);
        for moment in moving() {
            let force = self.force_at(column, moment.row);
            rest.push(force - row(moment).dot(&fit));
            rest_of_all.push(force - row_of_all(moment).dot(&fit_of_all));
            inertial += (fit[0] * moment.acceleration / scale_a).powi(2);
            accelerations += moment.acceleration * moment.acceleration;
        }
        let mass_of = |half: Range<usize>| {
            let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
            for moment in moving().skip(half.start).take(half.len()) {
                let row = row(moment);
                normal += row * row.transpose();
                right += row * self.force_at(column, moment.row);
            }
            let inverse = normal.pseudo_inverse(1e-9 * half.len() as f64);
            inverse.map_or(f64::NAN, |inverse| (inverse * right)[0] / scale_a)
        };
        let middle = count / 2;
        let masses_of_halves = [mass_of(0..middle), mass_of(middle..count)];
        let apparent = rms_of_acceleration_noise(noise, self.half as f64 * self.step).powi(2);
        let variance = variance_of_fit(&rest, 4);
        let variance_of_all = variance_of_fit(&rest_of_all, 5);
        let rest: f64 = rest.iter().map(|left| left * left).sum();
        let deviation_of_all = (variance_of_all * inverse_of_all[(0, 0)]).sqrt();
        Some(RoughFit {
            mass: fit[0] / scale_a,
            masses_of_halves,
            mass_with_spring: [fit_of_all[0], deviation_of_all].map(|value| value / scale_a),
            mass_deviation: (variance * inverse[(0, 0)]).sqrt() / scale_a,
            coulomb: fit[1],
            coulomb_deviation: (variance * inverse[(1, 1)]).sqrt(),
            viscous: fit[2] / scale_v,
            offset: fit[3],
            explained: 1.0 - rest / squares,
            inertial: inertial / squares,
            by_acceleration_alone: fit[0] * fit[0] / inverse[(0, 0)] / squares,
            apparent_acceleration: apparent * count as f64 / accelerations.max(f64::MIN_POSITIVE),
        })
    }

    /// Slope of one column over another, through zero after means are taken off.
    pub(super) fn slope(&self, of: &[f64], over: impl Fn(usize) -> f64) -> Option<Slope> {
        let rows = || {
            let segments = self.segments.iter().cloned().flatten();
            segments
                .skip(1)
                .map(|row| (of[row], over(row)))
                .filter(|(y, x)| y.is_finite() && x.is_finite())
        };
        let count = rows().count() as f64;
        let (y0, x0) = rows().fold((0.0, 0.0), |(a, b), (y, x)| (a + y, b + x));
        let (y0, x0) = (y0 / count, x0 / count);
        let (together, squares) =
            rows().fold((0.0, 0.0), |(xy, xx), (y, x)| (xy + x * y, xx + x * x));
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        let mut halves = [(0.0, 0.0); 2];
        for (index, (y, x)) in rows().enumerate() {
            let (square, product) = ((x - x0) * (x - x0), (x - x0) * (y - y0));
            (xx, xy, yy) = (xx + square, xy + product, yy + (y - y0) * (y - y0));
            let (squares, products) = &mut halves[usize::from(2.0 * index as f64 >= count)];
            (*squares, *products) = (*squares + square, *products + product);
        }
        if !(xx > 0.0 && yy > 0.0) {
            return None;
        }
        let value = xy / xx;
        let left: Vec<f64> = rows().map(|(y, x)| y - y0 - value * (x - x0)).collect();
        let deviation = (variance_of_fit(&left, 2) / xx).sqrt();
        let is_of_both_halves =
            halves.iter().all(|(squares, products)| ALIKE.contains(&(products / squares / value)));
        let ratio = together / squares;
        Some(Slope { value, ratio, deviation, is_of_both_halves, explained: xy * xy / (xx * yy) })
    }
}

/// How one column depends on another.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slope {
    /// In the unit of the one over that of the other.
    pub value: f64,
    /// The same with the means left in.
    pub ratio: f64,
    /// Its standard deviation, infinite where there is too little of independent data.
    pub deviation: f64,
    /// Whether either half of the data has about the same slope.
    pub is_of_both_halves: bool,
    /// Share of the squares of the one that the other explains.
    pub explained: f64,
}

/// Variance of what a fit with so many coefficients leaves, as it counts for their deviations:
/// neighbours that are alike are one datum. Infinite where there are not more data than
/// coefficients.
fn variance_of_fit(left: &[f64], coefficients: usize) -> f64 {
    let alike = correlation_length(left).max(1.0);
    let free = left.len() as f64 / alike - coefficients as f64;
    let squares: f64 = left.iter().map(|left| left * left).sum();
    if free > 0.0 { squares / free } else { f64::INFINITY }
}
