//! An empirical curve of the missing force, or of a change of friction, over position, velocity or time, smooth as the data ask for.

use nalgebra::{DMatrix, DVector};

use crate::model::{Coordinate, Curve, CurveSide, EffectParameters, ModelError};
use crate::plant::effects::viscous_friction;
use crate::plant::{EffectDescriptor, Residual};

use super::hypothesis::Part;

/// Knot counts that are tried; the error that cross-validation leaves decides.
const KNOTS: [usize; 6] = [8, 16, 32, 64, 128, 256];
/// Blocks that the record is cut into; every other one is left out in turn.
const BLOCKS: usize = 40;
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
    let fold = |index: usize| index * BLOCKS / count % 2;
    let mut best: Option<(f64, usize)> = None;
    for knots in KNOTS {
        let mut left = 0.0;
        for tested in 0..2 {
            let Some(values) = solve(along, residual.force, &gain, (from, to), knots, |index| fold(index) != tested)
            else {
                continue;
            };
            for index in (0..count).filter(|index| fold(*index) == tested) {
                left += (residual.force[index] - gain[index] * interpolate(&values, from, to, along[index])).powi(2);
            }
        }
        if best.is_none_or(|(least, _)| left < least) {
            best = Some((left, knots));
        }
    }
    let Some((left, knots)) = best.filter(|(left, _)| *left < total) else { return Ok(None) };
    let Some(values) = solve(along, residual.force, &gain, (from, to), knots, |_| true) else { return Ok(None) };
    let values = match side {
        CurveSide::Friction | CurveSide::Viscous => values.into_iter().map(|value| value.max(NO_FRICTION)).collect(),
        CurveSide::Carriage | CurveSide::Motor => values,
    };
    let curve = Curve { coordinate, side, from, to, values };
    let descriptor = EffectDescriptor::find("map")?;
    let values = descriptor.values_of(&EffectParameters::map(curve))?;
    Ok(Some((Part { descriptor, values }, 1.0 - left / total)))
}

/// Knots of the piecewise linear curve, by least squares with a weak penalty on bending.
fn solve(
    along: &[f64],
    force: &[f64],
    gain: &[f64],
    (from, to): (f64, f64),
    knots: usize,
    used: impl Fn(usize) -> bool,
) -> Option<Vec<f64>> {
    let mut normal = DMatrix::<f64>::zeros(knots, knots);
    let mut right = DVector::<f64>::zeros(knots);
    let mut weight = 0.0;
    for index in (0..along.len()).filter(|index| used(*index)) {
        let (knot, share) = place(along[index], from, to, knots);
        let pair = [(knot, (1.0 - share) * gain[index]), (knot + 1, share * gain[index])];
        for (row, a) in pair {
            right[row] += a * force[index];
            for (column, b) in pair {
                normal[(row, column)] += a * b;
            }
        }
        weight += gain[index] * gain[index];
    }
    let penalty = STIFFNESS * weight / knots as f64;
    for knot in 1..knots - 1 {
        let bend = [(knot - 1, 1.0), (knot, -2.0), (knot + 1, 1.0)];
        for (row, a) in bend {
            for (column, b) in bend {
                normal[(row, column)] += penalty * a * b;
            }
        }
    }
    for knot in 0..knots {
        normal[(knot, knot)] += 1e-9 * weight;
    }
    Some(normal.cholesky()?.solve(&right).as_slice().to_vec())
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
