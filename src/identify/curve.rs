//! An empirical curve of the missing force, or of a change of friction, over position, velocity or time, smooth as the data ask for.

use nalgebra::{DMatrix, DVector};

use crate::model::{Coordinate, Curve, CurveSide, EffectParameters, ModelError};
use crate::plant::effects::viscous_friction;
use crate::plant::{EffectDescriptor, Residual};

use super::hypothesis::Part;

/// Knot counts that are tried; the error that cross-validation leaves decides.
const KNOTS: [usize; 6] = [8, 16, 32, 64, 128, 256];
/// Blocks that the record is cut into, and how many of them in a row are left out in turn: so many that a motion that repeats shows all it does
/// in what stays.
const BLOCKS: usize = 40;
const FOLDS: usize = 5;
/// Weight of the squared second differences of the knots, in units of the mean weight of a knot. Assumed: only bridges gaps.
const STIFFNESS: f64 = 1e-6;

/// Least change of friction: nearly all of it gone.
const NO_FRICTION: f64 = -0.99;

/// The curve over one coordinate that predicts left-out blocks of the residual best, with the share of its mean square that it takes
/// out there; `None` where it takes out nothing.
pub fn propose(
    residual: &Residual,
    coordinate: Coordinate,
    side: CurveSide,
) -> Result<Option<(Part, f64)>, ModelError> {
    let along = match coordinate {
        Coordinate::Position => residual.position,
        Coordinate::Velocity => residual.velocity,
        Coordinate::Time => residual.time,
    };
    let (from, to) = crate::range(along);
    let total: f64 = residual.force.iter().map(|force| force * force).sum();
    if !(to > from && (to - from).is_finite() && total > 0.0) {
        return Ok(None);
    }
    // Force that a knot of 1 adds: 1 N, or as a change of friction all of its Coulomb or its viscous part, against the motion.
    let viscous = viscous_friction(residual).unwrap_or(0.0);
    let gain: Vec<f64> = match side {
        CurveSide::Carriage | CurveSide::Motor => vec![1.0; along.len()],
        CurveSide::Friction => {
            residual.friction.iter().zip(residual.velocity).map(|(friction, v)| viscous * v - friction).collect()
        }
        CurveSide::Viscous => residual.velocity.iter().map(|v| -viscous * v).collect(),
    };
    let count = along.len();
    let fold = |index: usize| index * BLOCKS / count % FOLDS;
    let mut best: Option<(f64, Vec<f64>)> = None;
    for knots in KNOTS {
        let mut folds = vec![Squares::new(knots); FOLDS];
        for index in 0..count {
            let at = place(along[index], from, to, knots);
            folds[fold(index)].add(at, gain[index], residual.force[index]);
        }
        let all = folds.iter().fold(Squares::new(knots), |all, fold| all.and(fold, 1.0));
        let others: Vec<Option<Vec<f64>>> = folds.iter().map(|fold| all.clone().and(fold, -1.0).solve()).collect();
        let (Some(values), Some(others)) = (all.solve(), others.into_iter().collect::<Option<Vec<_>>>()) else {
            continue;
        };
        let left = (0..count).map(|index| {
            let curve = interpolate(&others[fold(index)], from, to, along[index]);
            (residual.force[index] - gain[index] * curve).powi(2)
        });
        let left: f64 = left.sum();
        if best.as_ref().is_none_or(|(least, _)| left < *least) {
            best = Some((left, values));
        }
    }
    let Some((left, values)) = best.filter(|(left, _)| *left < total) else { return Ok(None) };
    let values = match side {
        CurveSide::Friction | CurveSide::Viscous => values.into_iter().map(|value| value.max(NO_FRICTION)).collect(),
        CurveSide::Carriage | CurveSide::Motor => values,
    };
    let curve = Curve { coordinate, side, from, to, values };
    let descriptor = EffectDescriptor::find("map")?;
    let values = descriptor.values_of(&EffectParameters::map(curve))?;
    Ok(Some((Part { descriptor, values }, 1.0 - left / total)))
}

/// Least squares for the knots of a piecewise linear curve.
#[derive(Clone)]
struct Squares {
    normal: DMatrix<f64>,
    right: DVector<f64>,
    weight: f64,
}

impl Squares {
    fn new(knots: usize) -> Squares {
        Squares { normal: DMatrix::zeros(knots, knots), right: DVector::zeros(knots), weight: 0.0 }
    }

    /// Takes in a force, N, behind a knot by a share of the way to the next one, where a knot of 1 adds `gain`, N.
    fn add(&mut self, (knot, share): (usize, f64), gain: f64, force: f64) {
        let pair = [(knot, (1.0 - share) * gain), (knot + 1, share * gain)];
        for (row, a) in pair {
            self.right[row] += a * force;
            for (column, b) in pair {
                self.normal[(row, column)] += a * b;
            }
        }
        self.weight += gain * gain;
    }

    /// With others, so many times.
    fn and(mut self, other: &Squares, times: f64) -> Squares {
        self.normal += times * &other.normal;
        self.right.axpy(times, &other.right, 1.0);
        self.weight += times * other.weight;
        self
    }

    /// The knots, with a weak penalty on bending.
    fn solve(mut self) -> Option<Vec<f64>> {
        let knots = self.right.len();
        let penalty = STIFFNESS * self.weight / knots as f64;
        for knot in 1..knots - 1 {
            let bend = [(knot - 1, 1.0), (knot, -2.0), (knot + 1, 1.0)];
            for (row, a) in bend {
                for (column, b) in bend {
                    self.normal[(row, column)] += penalty * a * b;
                }
            }
        }
        for knot in 0..knots {
            self.normal[(knot, knot)] += 1e-9 * self.weight;
        }
        Some(self.normal.cholesky()?.solve(&self.right).as_slice().to_vec())
    }
}

fn place(value: f64, from: f64, to: f64, knots: usize) -> (usize, f64) {
    let at = ((value - from) / (to - from)).clamp(0.0, 1.0) * (knots - 1) as f64;
    let knot = (at as usize).min(knots - 2);
    (knot, at - knot as f64)
}

fn interpolate(values: &[f64], from: f64, to: f64, at: f64) -> f64 {
    let (knot, share) = place(at, from, to, values.len());
    values[knot] * (1.0 - share) + values[knot + 1] * share
}

#[cfg(test)]
mod tests {
    use crate::plant::Samples;

    use super::*;

    /// A motion that goes to and fro once in two blocks: every other block is all that there is of one half of the velocities.
    #[test]
    fn a_curve_is_found_whatever_the_rhythm_of_the_motion() {
        let count = 8000;
        let speed = |index: usize| 0.01 + 0.09 * (index % 200) as f64 / 200.0;
        let velocity: Vec<f64> =
            (0..count).map(|index| if index / 200 % 2 == 0 { speed(index) } else { -speed(index) }).collect();
        let force: Vec<f64> = velocity.iter().map(|v| 3.0 * v.signum() * (-(v / 0.03).powi(2)).exp()).collect();
        let time: Vec<f64> = (0..count).map(|index| index as f64 * 1e-3).collect();
        let still = vec![0.0; count];
        let residual = Residual {
            time: &time,
            position: &still,
            velocity: &velocity,
            acceleration: &still,
            command: &still,
            friction: &still,
            force: &force,
            mass: 40.0,
            samples: Samples { position: &still, force: &force, step: 1e-3 },
        };
        let (part, share) = propose(&residual, Coordinate::Velocity, CurveSide::Carriage).unwrap().unwrap();
        assert!(share > 0.99, "{share}");
        let curve = part.parameters().curve.unwrap();
        assert!((interpolate(&curve.values, curve.from, curve.to, -0.02) + 3.0 * (-4.0f64 / 9.0).exp()).abs() < 0.1);
    }
}
