//! Ripples over the position whose phase each record has for itself: balls that slip.
//!
//! Guides whose phases walk are together one ripple, F = S(s) sin(2 pi x / p) + C(s) cos(2 pi x / p), of which S and C change slowly with the
//! distance travelled s. No law tells them. They are linear here between knots a piece apart, and in each record those that leave least of
//! the missing force (variable projection: Golub, Pereyra, SIAM Journal on Numerical Analysis 10, 1973): what is fitted of the law is its period.

use std::f64::consts::TAU;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;

use crate::model::{EffectParameters, ModelError};
use crate::plant::effects::golden_maximum;
use crate::plant::{EffectDescriptor, SlippingRipple};

use super::hypothesis::Part;
use super::measured::Measured;

/// The law that has balls which slip.
pub(super) const LAW: &str = "ball_passage";
/// Part of the largest curvature that is added to each: knots that the record says nothing of stay at 0.
const RIDGE: f64 = 1e-9;
/// Steps of a search for a period per turn of the phase over the travel.
const STEPS_PER_TURN: f64 = 4.0;
/// Most steps of it.
const MOST_STEPS: f64 = 2000.0;
/// Fewest periods within the travel. Assumed: fewer are no ripple but a curve.
const LEAST_PERIODS: f64 = 8.0;

/// What the ripples of a hypothesis can be on a record.
#[derive(Clone, Debug)]
pub(super) struct Slipping {
    pub ripples: Vec<SlippingRipple>,
    waves: Vec<Waves>,
    factors: Cholesky<f64, Dyn>,
}

/// One ripple at the rows of a record.
#[derive(Clone, Debug)]
struct Waves {
    sine: Vec<f64>,
    cosine: Vec<f64>,
    /// Of each row the knot before it, and how far it is on the way to the next.
    places: Vec<(usize, f64)>,
    /// Column of the first knot: two for each knot.
    first: usize,
}

impl Waves {
    fn new(ripple: SlippingRipple, sine: Vec<f64>, cosine: Vec<f64>, travelled: &[f64], first: usize) -> Waves {
        let all = travelled.last().copied().unwrap_or(0.0);
        let pieces = (all / ripple.piece).round().max(0.0);
        let place = |travelled: &f64| {
            let along = if all > 0.0 { travelled / all * pieces } else { 0.0 };
            let knot = along.floor().min((pieces - 1.0).max(0.0));
            (knot as usize, along - knot)
        };
        Waves { sine, cosine, places: travelled.iter().map(place).collect(), first }
    }

    fn columns(&self) -> usize {
        2 * (self.places.last().map_or(0, |(knot, part)| knot + usize::from(*part > 0.0)) + 1)
    }

    /// The columns that are not 0 in a row, with their entries.
    fn row(&self, row: usize) -> [(usize, f64); 4] {
        let (knot, part) = self.places[row];
        let (sine, cosine, at) = (self.sine[row], self.cosine[row], self.first + 2 * knot);
        // Where there is one knot alone the second pair is 0, and stands on the first.
        let next = if part > 0.0 { at + 2 } else { at };
        [(at, (1.0 - part) * sine), (at + 1, (1.0 - part) * cosine), (next, part * sine), (next + 1, part * cosine)]
    }
}

impl Slipping {
    /// Ripples of a hypothesis, filtered as the forces are; `None` without any.
    pub fn new(ripples: Vec<SlippingRipple>, measured: &Measured) -> Option<Slipping> {
        let travelled = measured.at_rows(&travelled(&measured.position));
        let wave = |ripple: &SlippingRipple| {
            let turn = |of: fn(f64) -> f64| -> Vec<f64> {
                let values: Vec<f64> = measured.position.iter().map(|x| of(TAU * x / ripple.period)).collect();
                measured.filtered(&values)
            };
            (turn(f64::sin), turn(f64::cos))
        };
        let waves = ripples.iter().map(wave).collect();
        Slipping::of(ripples, waves, &travelled)
    }

    /// `waves`: sine and cosine of each ripple at the rows; `travelled`: distance there, m.
    fn of(ripples: Vec<SlippingRipple>, waves: Vec<(Vec<f64>, Vec<f64>)>, travelled: &[f64]) -> Option<Slipping> {
        let mut first = 0;
        let mut all: Vec<Waves> = Vec::new();
        for (ripple, (sine, cosine)) in ripples.iter().zip(waves) {
            let waves = Waves::new(*ripple, sine, cosine, travelled, first);
            first += waves.columns();
            all.push(waves);
        }
        if first == 0 {
            return None;
        }
        let mut normal = DMatrix::zeros(first, first);
        for row in 0..travelled.len() {
            for (index, waves) in all.iter().enumerate() {
                for (column, entry) in waves.row(row) {
                    for other in &all[..=index] {
                        other.row(row).iter().for_each(|(before, value)| normal[(column, *before)] += entry * value);
                    }
                }
            }
        }
        let ridge = RIDGE * normal.diagonal().max() + f64::MIN_POSITIVE;
        (0..first).for_each(|column| normal[(column, column)] += ridge);
        // Of a symmetric matrix the lower triangle is enough.
        Some(Slipping { ripples, waves: all, factors: normal.cholesky()? })
    }

    /// Numbers that a record has for itself.
    pub fn columns(&self) -> usize {
        self.waves.iter().map(Waves::columns).sum()
    }

    /// Knots of sine and cosine, N, that leave least of a force at the rows.
    fn knots(&self, force: &[f64]) -> DVector<f64> {
        let mut right = DVector::zeros(self.columns());
        for waves in &self.waves {
            for (row, force) in force.iter().enumerate() {
                waves.row(row).iter().for_each(|(column, entry)| right[*column] += entry * force);
            }
        }
        self.factors.solve(&right)
    }

    /// Takes out of a force at the rows, N, what the ripples can be of it.
    pub fn take_from(&self, force: &mut [f64]) {
        let knots = self.knots(force);
        for waves in &self.waves {
            for (row, force) in force.iter_mut().enumerate() {
                *force -= waves.row(row).iter().map(|(column, entry)| knots[*column] * entry).sum::<f64>();
            }
        }
    }

    /// Root of the mean of S^2 + C^2 along the rows, for each ripple, N, as it fits a force best.
    pub fn amplitudes(&self, force: &[f64]) -> Vec<f64> {
        let knots = self.knots(force);
        let amplitude = |waves: &Waves| {
            let squares = waves.places.iter().map(|(knot, part)| {
                let at = waves.first + 2 * knot;
                let next = if *part > 0.0 { at + 2 } else { at };
                let along = |offset: usize| (1.0 - part) * knots[at + offset] + part * knots[next + offset];
                along(0).powi(2) + along(1).powi(2)
            });
            (squares.sum::<f64>() / waves.places.len().max(1) as f64).sqrt()
        };
        self.waves.iter().map(amplitude).collect()
    }
}

/// Distance travelled at each position, m.
fn travelled(position: &[f64]) -> Vec<f64> {
    let mut travelled = vec![0.0; position.len()];
    for k in 1..position.len() {
        travelled[k] = travelled[k - 1] + (position[k] - position[k - 1]).abs();
    }
    travelled
}

/// What balls that slip can take out of the squares of a force at the rows of a record, N^2.
pub(super) fn taken(force: &[f64], measured: &Measured, part: &Part) -> f64 {
    let Some(slipping) = Slipping::new(part.slipping_ripple().into_iter().collect(), measured) else { return 0.0 };
    let mut left = force.to_vec();
    slipping.take_from(&mut left);
    squares(force) - squares(&left)
}

fn squares(force: &[f64]) -> f64 {
    force.iter().map(|force| force * force).sum()
}

/// Balls of a ripple of this period, m, whose phase walks so, rad/sqrt(m).
fn balls(period: f64, slip: f64) -> Result<Part, ModelError> {
    let descriptor = EffectDescriptor::find(LAW)?;
    let given = EffectParameters::new(LAW, [("amplitude", 1.0), ("period", period), ("slip", slip)]);
    Ok(Part { descriptor, values: descriptor.values_of(&given)? })
}

/// The balls whose phase walks so, rad/sqrt(m), that take most out of a force at the rows of a record, N; `None` where the travel is too short.
pub(super) fn strongest(force: &[f64], measured: &Measured, slip: f64) -> Result<Option<Part>, ModelError> {
    let bounds = EffectDescriptor::find(LAW)?.parameters.iter().find(|one| one.name == "period").map(|one| one.bounds);
    let Some((shortest, longest)) = bounds else { return Ok(None) };
    let (travelled, position) =
        (measured.at_rows(&travelled(&measured.position)), measured.at_rows(&measured.position));
    let (lowest, highest) = crate::range(&position);
    let range = highest - lowest;
    let (fewest, most) = ((range / longest).max(LEAST_PERIODS), range / shortest);
    if most.is_nan() || most <= fewest {
        return Ok(None);
    }
    // Not filtered, which moves no peak.
    let left = |turns: f64| {
        let ripple = balls(range / turns, slip).ok()?.slipping_ripple()?;
        let waves = position.iter().map(|x| (TAU * x / ripple.period).sin_cos()).unzip();
        let slipping = Slipping::of(vec![ripple], vec![waves], &travelled)?;
        let mut left = force.to_vec();
        slipping.take_from(&mut left);
        Some(squares(&left))
    };
    let explained = |turns: f64| left(turns).map_or(f64::NEG_INFINITY, |left| -left);
    let steps = ((most - fewest) * STEPS_PER_TURN).ceil().clamp(1.0, MOST_STEPS);
    let turns = |step: f64| fewest + (most - fewest) * step / steps;
    let all: Vec<f64> = (0..=steps as usize).into_par_iter().map(|step| explained(turns(step as f64))).collect();
    let Some(best) = (0..all.len()).max_by(|a, b| all[*a].total_cmp(&all[*b])) else { return Ok(None) };
    let (from, to) = ((best as f64 - 1.0).max(0.0), (best as f64 + 1.0).min(steps));
    let step = golden_maximum(from, to, |step| explained(turns(step)));
    Ok(Some(balls((range / turns(step)).clamp(shortest, longest), slip)?))
}

#[cfg(test)]
mod tests {
    use super::super::driven::tests::record;
    use super::*;
    use crate::plant::Side;

    /// Force of a ripple whose phase turns by `turn` rad per metre travelled, N, at the rows, beside a slow one.
    fn force(measured: &Measured, period: f64, turn: f64) -> (Vec<f64>, Vec<f64>) {
        let of = |(x, s): (&f64, f64)| 0.4 * (TAU * x / period + 0.8 + turn * s).sin();
        let ripple: Vec<f64> = measured.position.iter().zip(travelled(&measured.position)).map(of).collect();
        let other: Vec<f64> = measured.position.iter().map(|x| 2.0 * x + 0.1).collect();
        (measured.filtered(&ripple), measured.filtered(&other))
    }

    fn rms(values: &[f64]) -> f64 {
        (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
    }

    #[test]
    fn a_ripple_whose_phase_turns_is_taken_out_and_what_is_beside_it_stays() {
        let measured = record();
        let (ripple, other) = force(&measured, 4e-3, 2.0);
        let mut left: Vec<f64> = ripple.iter().zip(&other).map(|(ripple, other)| ripple + other).collect();
        let slipping = Slipping::new(vec![SlippingRipple { period: 4e-3, piece: 0.1 }], &measured).unwrap();
        // 0.4 m are travelled: four pieces.
        assert_eq!(slipping.columns(), 10);
        let amplitude = slipping.amplitudes(&ripple)[0];
        assert!((amplitude / 0.4 - 1.0).abs() < 0.02, "{amplitude}");
        slipping.take_from(&mut left);
        let off: Vec<f64> = left.iter().zip(&other).map(|(left, other)| left - other).collect();
        // Where the carriage turns, any force is a ripple.
        assert!(rms(&off) < 0.2 * rms(&other), "{} of {}", rms(&off), rms(&other));
        let rest = |piece: f64| {
            let mut left = ripple.clone();
            Slipping::new(vec![SlippingRipple { period: 4e-3, piece }], &measured).unwrap().take_from(&mut left);
            rms(&left) / rms(&ripple)
        };
        // One phase for the whole record does not do.
        assert!(rest(0.1) < 0.01 && rest(10.0) > 0.15, "{} {}", rest(0.1), rest(10.0));
    }

    #[test]
    fn the_period_of_a_ripple_is_found_whose_phase_turns() {
        let measured = record();
        let (ripple, _) = force(&measured, 4e-3, 2.0);
        // Pieces of 0.11 m.
        let found = strongest(&ripple, &measured, 1.5).unwrap().unwrap();
        let period = found.slipping_ripple().unwrap().period;
        assert!((period / 4e-3 - 1.0).abs() < 3e-3, "{period}");
        assert!(taken(&ripple, &measured, &found) > 0.95 * squares(&ripple));
    }

    #[test]
    fn what_slips_is_no_force_of_the_law_and_leaves_the_other_side_alone() {
        use super::super::Sides;
        use super::super::driven::tests::hypothesis;
        let measured = record();
        let with = hypothesis(&[("ball_passage", &[0.4, 4e-3, 0.0, 0.0, 0.0, 1.0])]);
        let without = with.without(0);
        assert!(with.effects.iter().all(Part::slips) && with.effects[0].side() == Side::Carriage);
        let [with, without] = [with, without].map(|one| one.missing(&measured, Sides::BOTH).unwrap());
        assert_eq!(with.motor, without.motor);
        let mut expected = without.carriage.clone();
        let ripple = SlippingRipple { period: 4e-3, piece: 0.25 };
        Slipping::new(vec![ripple], &measured).unwrap().take_from(&mut expected);
        assert_eq!(with.carriage, expected);
        assert!(rms(&with.carriage) < rms(&without.carriage));
    }
}
