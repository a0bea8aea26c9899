//! An empirical curve of the missing force, or of a change of friction, over position, velocity or time, smooth as the data ask for.

use std::ops::Range;

use nalgebra::{DMatrix, DVector, DVectorView};

use crate::model::{Coordinate, Curve, CurveSide, EffectParameters, ModelError};
use crate::plant::effects::viscous_friction;
use crate::plant::{EffectDescriptor, Residual};

use super::driven::Driven;
use super::hypothesis::{self, Hypothesis, Part, Sides};
use super::measured::Measured;
use super::objective::{derivatives, stacked};

/// Knot counts that are tried; the error that cross-validation leaves decides.
const KNOTS: [usize; 6] = [8, 16, 32, 64, 128, 256];
/// Blocks that the record is cut into, and how many of them in a row are left out in turn: so many that a motion that repeats shows all it does
/// in what stays.
const BLOCKS: usize = 40;
const FOLDS: usize = 5;
/// Weight of the squared second differences of the knots, in units of the mean weight of a knot. Assumed: only bridges gaps.
const STIFFNESS: f64 = 1e-6;
/// The same of each value by itself: only keeps the equations solvable.
const RIDGE: f64 = 1e-9;
/// Weights of a step beside the curve, in units of what it changes, each a curve of its own: steps that hardly show are long, far from linear. Without one everything
/// else is held. Assumed.
pub const DAMPINGS: [Option<f64>; 4] = [None, Some(1e-3), Some(1e-2), Some(1e-1)];

/// Least change of friction: nearly all of it gone.
const NO_FRICTION: f64 = -0.99;

/// What a fit may move while a curve is drawn: the guides were bent to what the curve is to stand for.
pub struct Beside {
    coordinates: Vec<hypothesis::Coordinate>,
    /// Change of the missing force per scale of each coordinate, N, row by row in columns.
    slopes: DMatrix<f64>,
    /// Weight of each coordinate's distance from what is declared, N^2 per square of its scale.
    declared: Vec<f64>,
    /// Products of the slopes with each other, fold by fold.
    products: Vec<DMatrix<f64>>,
}

impl Beside {
    /// Everything that a fit of the carriage side moves.
    pub fn of(hypothesis: &Hypothesis, measured: &Measured) -> Result<Beside, ModelError> {
        let coordinates = hypothesis.coordinates(Sides::CARRIAGE, measured.cell.is_some());
        let driven = hypothesis.driven(measured, Sides::CARRIAGE, &Driven::default())?;
        let missing = hypothesis.missing_of(&driven, measured, Sides::CARRIAGE);
        let noise = hypothesis.floor(measured).carriage;
        let residual = stacked(&missing, &coordinates, noise);
        let slopes = derivatives(hypothesis, &coordinates, &driven, measured, Sides::CARRIAGE, &residual, noise)?;
        let rows = missing.carriage.len();
        let declared = (0..coordinates.len()).map(|index| slopes[(rows + index, index)].powi(2)).collect();
        Ok(Beside::new(coordinates, slopes.rows(0, rows).transpose(), declared))
    }

    /// Nothing that moves, beside so many rows.
    pub fn nothing(rows: usize) -> Beside {
        Beside::new(Vec::new(), DMatrix::zeros(0, rows), Vec::new())
    }

    fn new(coordinates: Vec<hypothesis::Coordinate>, slopes: DMatrix<f64>, declared: Vec<f64>) -> Beside {
        let mut products = vec![DMatrix::zeros(slopes.nrows(), slopes.nrows()); FOLDS];
        for (fold, rows) in blocks(slopes.ncols()) {
            let rows = slopes.columns_range(rows);
            products[fold] += rows * rows.transpose();
        }
        Beside { coordinates, slopes, declared, products }
    }
}

/// Rows of each block of a record of so many, with the fold that it belongs to.
fn blocks(count: usize) -> impl Iterator<Item = (usize, Range<usize>)> {
    (0..BLOCKS)
        .map(move |block| (block % FOLDS, (block * count).div_ceil(BLOCKS)..((block + 1) * count).div_ceil(BLOCKS)))
}

/// A curve, and where the coordinates beside it move.
pub struct Drawn {
    pub part: Part,
    /// One of [`DAMPINGS`].
    pub damping: Option<f64>,
    /// Empty where they are held.
    pub moved: Vec<hypothesis::Coordinate>,
}

/// The curves over one coordinate that predict left-out blocks of the residual best: one with everything else held, and one for each damping of what moves beside
/// it. Left out are those that predict nothing of it.
pub fn propose(
    residual: &Residual,
    coordinate: Coordinate,
    side: CurveSide,
    beside: &Beside,
) -> Result<Vec<Drawn>, ModelError> {
    let along = match coordinate {
        Coordinate::Position => residual.position,
        Coordinate::Velocity => residual.velocity,
        Coordinate::Time => residual.time,
    };
    let (from, to) = crate::range(along);
    let total: f64 = residual.force.iter().map(|force| force * force).sum();
    if !(to > from && (to - from).is_finite() && total > 0.0) {
        return Ok(Vec::new());
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
    let dampings = if beside.coordinates.is_empty() { &DAMPINGS[..1] } else { &DAMPINGS[..] };
    // For each damping what is left of blocks that are left out, the solution and its knots.
    let mut best = vec![(total, DVector::zeros(0), 0); dampings.len()];
    for knots in KNOTS {
        let mut folds: Vec<Squares> = beside.products.iter().map(|products| Squares::new(knots, products)).collect();
        for (fold, rows) in blocks(along.len()) {
            for index in rows {
                let at = place(along[index], from, to, knots);
                folds[fold].add(at, gain[index], residual.force[index], beside.slopes.column(index));
            }
        }
        let mut all = folds[0].clone();
        folds[1..].iter().for_each(|fold| all.add_times(fold, 1.0));
        for (damping, best) in dampings.iter().zip(&mut best) {
            let left_of = |fold: &Squares| {
                let mut others = all.clone();
                others.add_times(fold, -1.0);
                Some(fold.left(&others.solve(beside, *damping)?))
            };
            let left: Option<f64> = folds.iter().map(left_of).sum();
            if let (Some(left), Some(solution)) = (left, all.solve(beside, *damping))
                && left < best.0
            {
                *best = (left, solution, knots);
            }
        }
    }
    let least = if matches!(side, CurveSide::Friction | CurveSide::Viscous) { NO_FRICTION } else { f64::NEG_INFINITY };
    let descriptor = EffectDescriptor::find("map")?;
    let drawn = best.into_iter().zip(dampings).filter(|((.., knots), _)| *knots > 0);
    let drawn = drawn.map(|((_, solution, knots), &damping)| {
        let values = solution.rows_range(..knots).iter().map(|value| value.max(least)).collect();
        let curve = Curve { coordinate, side, from, to, values };
        let values = descriptor.values_of(&EffectParameters::map(curve))?;
        let moves = beside.coordinates.iter().zip(solution.iter().skip(knots));
        let moved = moves.map(|(coordinate, moves)| hypothesis::Coordinate {
            value: (coordinate.value + moves * coordinate.scale).clamp(coordinate.bounds.0, coordinate.bounds.1),
            ..coordinate.clone()
        });
        Ok(Drawn { part: Part { descriptor, values }, damping, moved: moved.collect() })
    });
    drawn.collect()
}

/// Least squares for the knots of a piecewise linear curve and, behind them, what moves beside it.
#[derive(Clone)]
struct Squares {
    /// Only the lower triangle is filled.
    normal: DMatrix<f64>,
    right: DVector<f64>,
    /// Of the force, N^2.
    force: f64,
    weight: f64,
    knots: usize,
}

impl Squares {
    /// `products`: of the slopes of what moves beside the curve.
    fn new(knots: usize, products: &DMatrix<f64>) -> Squares {
        let all = knots + products.nrows();
        let mut normal = DMatrix::zeros(all, all);
        normal.view_range_mut(knots.., knots..).copy_from(products);
        Squares { normal, right: DVector::zeros(all), force: 0.0, weight: 0.0, knots }
    }

    /// Takes in a missing force, N, behind a knot by a share of the way to the next one, where a knot of 1 takes away `gain`, N, and what moves beside it
    /// adds `slopes`, N.
    fn add(&mut self, (knot, share): (usize, f64), gain: f64, force: f64, slopes: DVectorView<f64>) {
        let pair = [(knot, (1.0 - share) * gain), (knot + 1, share * gain)];
        for (row, a) in pair {
            self.right[row] += a * force;
            for (column, b) in pair {
                self.normal[(row, column)] += a * b;
            }
            for (column, slope) in slopes.iter().enumerate() {
                self.normal[(self.knots + column, row)] -= a * slope;
            }
        }
        for (row, slope) in slopes.iter().enumerate() {
            self.right[self.knots + row] -= slope * force;
        }
        self.force += force * force;
        self.weight += gain * gain;
    }

    /// Adds others so many times.
    fn add_times(&mut self, other: &Squares, times: f64) {
        self.normal.zip_apply(&other.normal, |one, other| *one += times * other);
        self.right.axpy(times, &other.right, 1.0);
        self.force += times * other.force;
        self.weight += times * other.weight;
    }

    /// What a solution leaves of the force, N^2.
    fn left(&self, solution: &DVector<f64>) -> f64 {
        let count = solution.len();
        let mut normal = self.normal.view((0, 0), (count, count)).into_owned();
        normal.fill_upper_triangle_with_lower_triangle();
        self.force - 2.0 * solution.dot(&self.right.rows(0, count)) + solution.dot(&(normal * solution))
    }

    /// The knots, with a weak penalty on bending, and, unless they are held, the moves, with the weight of what is declared and a damping.
    fn solve(&self, beside: &Beside, damping: Option<f64>) -> Option<DVector<f64>> {
        let knots = self.knots;
        let count = if damping.is_some() { self.right.len() } else { knots };
        let mut normal = self.normal.view((0, 0), (count, count)).into_owned();
        let mut right = self.right.rows(0, count).into_owned();
        let penalty = STIFFNESS * self.weight / knots as f64;
        for knot in 1..knots - 1 {
            let bend = [(knot - 1, 1.0), (knot, -2.0), (knot + 1, 1.0)];
            for (row, a) in bend {
                for (column, b) in bend {
                    normal[(row, column)] += penalty * a * b;
                }
            }
        }
        for knot in 0..knots {
            normal[(knot, knot)] += RIDGE * self.weight;
        }
        if let Some(damping) = damping {
            for (index, (coordinate, weight)) in beside.coordinates.iter().zip(&beside.declared).enumerate() {
                let at = knots + index;
                normal[(at, at)] += weight + damping * self.normal[(at, at)];
                right[at] -= weight * coordinate.value / coordinate.scale;
            }
        }
        Some(normal.cholesky()?.solve(&right))
    }
}

fn place(value: f64, from: f64, to: f64, knots: usize) -> (usize, f64) {
    let at = ((value - from) / (to - from)).clamp(0.0, 1.0) * (knots - 1) as f64;
    let knot = (at as usize).min(knots - 2);
    (knot, at - knot as f64)
}

#[cfg(test)]
mod tests {
    use crate::model::StageModel;
    use crate::plant::Samples;

    use super::super::hypothesis::Tolerances;
    use super::*;

    const COUNT: usize = 8000;

    fn interpolate(values: &[f64], from: f64, to: f64, at: f64) -> f64 {
        let (knot, share) = place(at, from, to, values.len());
        values[knot] * (1.0 - share) + values[knot + 1] * share
    }

    /// N, over the velocity in m/s.
    fn peak(speed: f64) -> f64 {
        3.0 * speed.signum() * (-(speed / 0.03).powi(2)).exp()
    }

    /// Of a motion that goes to and fro once in two blocks, so that every other block is all that there is of one half of the velocities, m/s.
    fn velocity(index: usize) -> f64 {
        let speed = 0.01 + 0.09 * (index % 200) as f64 / 200.0;
        if (index / 200).is_multiple_of(2) { speed } else { -speed }
    }

    /// What is drawn over the velocity of the force that is missing at each sample, N.
    fn drawn_of(force: impl Fn(usize) -> f64, beside: &Beside) -> Vec<Drawn> {
        let velocity: Vec<f64> = (0..COUNT).map(velocity).collect();
        let force: Vec<f64> = (0..COUNT).map(force).collect();
        let time: Vec<f64> = (0..COUNT).map(|index| index as f64 * 1e-3).collect();
        let still = vec![0.0; COUNT];
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
        propose(&residual, Coordinate::Velocity, CurveSide::Carriage, beside).unwrap()
    }

    /// Largest distance of a curve from the peak, N.
    fn off(drawn: &Drawn) -> f64 {
        let curve = drawn.part.parameters().curve.unwrap();
        let off = |speed: f64| (interpolate(&curve.values, curve.from, curve.to, speed) - peak(speed)).abs();
        [-0.08, -0.02, 0.015, 0.05].into_iter().map(off).fold(0.0, f64::max)
    }

    #[test]
    fn a_curve_is_found_whatever_the_rhythm_of_the_motion() {
        let drawn = drawn_of(|index| peak(velocity(index)), &Beside::nothing(COUNT));
        assert!(drawn.len() == 1 && off(&drawn[0]) < 0.1, "{}", off(&drawn[0]));
    }

    /// The fit had bent a value by half its scale to what the curve is: what that does hangs on the velocity, too.
    #[test]
    fn what_the_curve_had_bent_goes_back_where_it_may_move() {
        let model = Hypothesis::new(&StageModel::default(), Tolerances::default()).unwrap();
        let coordinate =
            hypothesis::Coordinate { bounds: (-9.0, 9.0), ..model.coordinates(Sides::CARRIAGE, true)[0].clone() };
        let slope = |index: usize| 4.0 * velocity(index).signum() + (0.01 * index as f64).sin();
        let slopes = DMatrix::from_fn(1, COUNT, |_, index| slope(index));
        let bent = |index: usize| peak(velocity(index)) - 0.5 * slope(index);
        let beside = Beside::new(vec![coordinate.clone()], slopes, vec![0.0]);
        let drawn = drawn_of(bent, &beside);
        let (held, moved) = (&drawn[0], &drawn[1]);
        assert!(held.moved.is_empty() && off(held) > 1.5, "{}", off(held));
        let back = (moved.moved[0].value - coordinate.value) / coordinate.scale;
        assert!((back - 0.5).abs() < 0.02 && off(moved) < 0.15, "{back}, {}", off(moved));
    }
}
