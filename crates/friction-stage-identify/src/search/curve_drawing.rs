//! An empirical curve of the missing force, or of a change of friction, over position, velocity or
//! time, smooth as the data ask for.

use std::ops::Range;

use nalgebra::{DMatrix, DVector, DVectorView};

use friction_stage_core::model::{
    Coordinate, Curve, CurveSide, EffectParameters, Jump, ModelError, locate,
};
use friction_stage_core::plant::Residual;
use friction_stage_core::plant::effects::{CURVE, viscous_friction};

use crate::fit::objective::{derivatives, stacked};
use crate::hypothesis::nominal_parameter::NominalParameter;
use crate::hypothesis::{self, Hypothesis, NO_FRICTION, ParameterId, Part, Sides};
use crate::record::measured::Measured;
use crate::residual::driven::Driven;

/// Knot counts that are tried; the error that cross-validation leaves decides.
const KNOTS: [usize; 6] = [8, 16, 32, 64, 128, 256];
/// Knots of the curves beside which a jump is looked for: a line, behind which a step that hardly
/// shows where it is does not hide, and one that bends.
const BESIDE_A_JUMP: [usize; 2] = [2, KNOTS[0]];
/// Blocks that the record is cut into, and how many of them in a row are left out in turn: so many
/// that a motion that repeats shows all it does in what stays.
const BLOCKS: usize = 40;
const FOLDS: usize = 5;
/// Weight of the squared second differences of the knots, in units of the mean weight of a knot.
/// Assumed: only bridges gaps.
const STIFFNESS: f64 = 1e-6;
/// The same of each value by itself: only keeps the equations solvable.
const RIDGE: f64 = 1e-9;
/// Weights of a step beside the curve, in units of what it changes, each a curve of its own: steps
/// that hardly show are long, far from linear. Without one everything else is held. Assumed.
pub const DAMPINGS: [Option<f64>; 4] = [None, Some(1e-3), Some(1e-2), Some(1e-1)];

/// Part of what a curve leaves of left-out blocks that it may leave with a jump for that to be
/// there, unless it has fewer knots then. Assumed: a jump is worth as much as a law.
pub const WITH_A_JUMP: f64 = 0.9;
/// Part of its own squares that a jump must have which neither curve nor anything beside it has: at
/// the ends of a record there is none. Assumed.
const OF_ITS_OWN: f64 = 1e-3;

/// What a fit may move while a curve is drawn: the guides were biased to what the curve is to stand
/// for.
pub struct Beside {
    coordinates: Vec<hypothesis::FreeParameter>,
    /// Change of the missing force per scale of each coordinate, N, row by row in columns.
    sensitivities: DMatrix<f64>,
    /// Weight of each coordinate's distance from what is declared, N^2 per square of its scale.
    declared: Vec<f64>,
    /// Products of the sensitivities with each other, fold by fold.
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
        let sensitivities = derivatives(
            hypothesis,
            &coordinates,
            &driven,
            measured,
            Sides::CARRIAGE,
            &residual,
            noise,
        )?;
        let rows = missing.carriage.len();
        let declared = (0..coordinates.len())
            .map(|index| sensitivities[(rows + index, index)].powi(2))
            .collect();
        Ok(Beside::new(coordinates, sensitivities.rows(0, rows).transpose(), declared))
    }

    /// Nothing that moves, beside so many rows.
    pub fn nothing(rows: usize) -> Beside {
        Beside::new(Vec::new(), DMatrix::zeros(0, rows), Vec::new())
    }

    fn new(
        coordinates: Vec<hypothesis::FreeParameter>,
        sensitivities: DMatrix<f64>,
        declared: Vec<f64>,
    ) -> Beside {
        let mut products =
            vec![DMatrix::zeros(sensitivities.nrows(), sensitivities.nrows()); FOLDS];
        for (fold, rows) in blocks(sensitivities.ncols()) {
            let rows = sensitivities.columns_range(rows);
            products[fold] += rows * rows.transpose();
        }
        Beside { coordinates, sensitivities, declared, products }
    }
}

/// Rows of each block of a record of so many, with the fold that it belongs to.
fn blocks(count: usize) -> impl Iterator<Item = (usize, Range<usize>)> {
    (0..BLOCKS).map(move |block| {
        (block % FOLDS, (block * count).div_ceil(BLOCKS)..((block + 1) * count).div_ceil(BLOCKS))
    })
}

/// A curve, and where the coordinates beside it move.
pub struct Drawn {
    pub part: Part,
    /// One of [`DAMPINGS`].
    pub damping: Option<f64>,
    /// What stands beside it.
    pub moved: Vec<hypothesis::FreeParameter>,
}

/// The curves over one coordinate that predict left-out blocks of the residual best: one with
/// everything else held, and one for each damping of what moves beside it. Left out are those that
/// predict nothing of it.
pub fn propose(
    residual: &Residual,
    coordinate: Coordinate,
    side: CurveSide,
    beside: &Beside,
) -> Result<Vec<Drawn>, ModelError> {
    let Some(rows) = Rows::new(residual, coordinate, side, beside) else { return Ok(Vec::new()) };
    let Rows { from, to, .. } = rows;
    let total: f64 = residual.force.iter().map(|force| force * force).sum();
    let dampings = if beside.coordinates.is_empty() { &DAMPINGS[..1] } else { &DAMPINGS[..] };
    let alone = rows.smooth(dampings, None);
    // What changes at a place or at a speed does so each time that the stage comes there, and a
    // curve has it; what happens at a time happens once.
    let jumps =
        |knots: usize| rows.jump(dampings, knots).filter(|_| coordinate == Coordinate::Time);
    let with_jumps: Vec<(f64, Vec<Option<Smooth>>)> = BESIDE_A_JUMP
        .into_iter()
        .filter_map(jumps)
        .map(|jump| (jump.at, rows.smooth(dampings, Some(jump.at))))
        .collect();
    let descriptor = CURVE;
    let drawn = dampings.iter().enumerate().filter_map(|(index, &damping)| {
        let without = alone[index].as_ref();
        let is_worth_it = |with: &Smooth| match without {
            Some(without) if with.knots < without.knots => with.left <= without.left,
            _ => with.left < WITH_A_JUMP * without.map_or(total, |without| without.left),
        };
        let with =
            with_jumps.iter().filter_map(|(at, smooth)| Some((*at, smooth[index].as_ref()?)));
        let with = with
            .filter(|(_, smooth)| is_worth_it(smooth))
            .min_by(|a, b| a.1.left.total_cmp(&b.1.left));
        let Smooth { solution, knots, left } = with.map(|(_, smooth)| smooth).or(without)?;
        if *left >= total {
            return None;
        }
        let (values, others) = solution.as_slice().split_at(*knots);
        let (jump, moves) = others.split_at(usize::from(with.is_some()));
        let jump = with.zip(jump.first()).map(|((at, _), height)| Jump { at, height: *height });
        let mut curve = Curve { coordinate, side, from, to, values: values.to_vec(), jump };
        match side {
            CurveSide::Carriage | CurveSide::Motor => {}
            CurveSide::Friction | CurveSide::Viscous => keep_above(&mut curve, NO_FRICTION),
            CurveSide::Mass => keep_above(&mut curve, NO_FRICTION * residual.mass),
        }
        let moves = beside.coordinates.iter().zip(moves);
        let moved = moves.map(|(coordinate, moves)| hypothesis::FreeParameter {
            value: (coordinate.value + moves * coordinate.scale)
                .clamp(coordinate.bounds.0, coordinate.bounds.1),
            ..coordinate.clone()
        });
        let mut moved: Vec<_> = moved.collect();
        if moved.is_empty() {
            moved.clone_from(&beside.coordinates);
        }
        level(&mut curve, &mut moved, &beside.coordinates, residual.mass);
        let values = descriptor.values_of(&EffectParameters::map(curve));
        Some(values.map(|values| Drawn { part: Part { descriptor, values }, damping, moved }))
    });
    drawn.collect()
}

/// The jump over the time that takes most of what a curve leaves, with everything moving that
/// stands beside it, and the curve itself among that.
pub fn jump(residual: &Residual, side: CurveSide, beside: &Beside) -> Option<Jump> {
    Rows::new(residual, Coordinate::Time, side, beside)?.jump(&DAMPINGS[1..], KNOTS[0])
}

/// Raises a curve to the least that there may be: where a record tells little, its knots are
/// anywhere.
fn keep_above(curve: &mut Curve, lowest: f64) {
    curve.values.iter_mut().for_each(|value| *value = value.max(lowest));
    // What is still lower stands behind the jump.
    let least = curve.corners().into_iter().map(|(_, value)| value).fold(f64::INFINITY, f64::min);
    if let Some(jump) = &mut curve.jump {
        jump.height += (lowest - least).max(0.0);
    }
}

/// A change of friction or mass that is everywhere is none: it goes to the guides or the carriage,
/// as far as these are not as declared. Together nothing changes. `mass`: as it was when the curve
/// was drawn, beside `coordinates`, kg.
fn level(
    curve: &mut Curve,
    moved: &mut [hypothesis::FreeParameter],
    coordinates: &[hypothesis::FreeParameter],
    mass: f64,
) {
    let scaled: &[NominalParameter] = match curve.side {
        CurveSide::Carriage | CurveSide::Motor => return,
        CurveSide::Friction => &[NominalParameter::CoulombForce, NominalParameter::StaticForce],
        CurveSide::Viscous => &[NominalParameter::ViscousFriction],
        CurveSide::Mass => &[NominalParameter::Mass],
    };
    let is_among = |one: &hypothesis::FreeParameter, names: &[NominalParameter]| match one.id {
        ParameterId::Nominal(declared) => names.contains(&declared),
        _ => false,
    };
    let value_in = |all: &[hypothesis::FreeParameter]| {
        all.iter().find(|one| is_among(one, &scaled[..1])).map(|one| one.value)
    };
    let (Some(drawn), Some(biased)) = (value_in(coordinates), value_in(moved)) else { return };
    let mut up = -biased;
    for one in moved.iter().filter(|one| is_among(one, scaled)) {
        up = up.clamp(one.bounds.0 - one.value, one.bounds.1 - one.value);
    }
    moved.iter_mut().filter(|one| is_among(one, scaled)).for_each(|one| one.value += up);
    if curve.side == CurveSide::Mass {
        let (before, after) = (mass * (biased - drawn).exp(), mass * (biased + up - drawn).exp());
        curve.values.iter_mut().for_each(|value| *value += before - after);
        return;
    }
    curve.values.iter_mut().for_each(|value| *value = (1.0 + *value) / up.exp() - 1.0);
    if let Some(jump) = &mut curve.jump {
        jump.height /= up.exp();
    }
}

/// What a curve is drawn through.
struct Rows<'a> {
    along: &'a [f64],
    /// Force that a knot of 1 takes away, N.
    gain: Vec<f64>,
    /// Missing, N.
    force: &'a [f64],
    from: f64,
    to: f64,
    beside: &'a Beside,
}

/// A curve through rows.
struct Smooth {
    /// Of blocks that were left out, N^2.
    left: f64,
    /// Knots, jump, moves beside them.
    solution: DVector<f64>,
    knots: usize,
}

impl<'a> Rows<'a> {
    /// `None` where there is nothing to draw through.
    fn new(
        residual: &'a Residual,
        coordinate: Coordinate,
        side: CurveSide,
        beside: &'a Beside,
    ) -> Option<Rows<'a>> {
        let along = match coordinate {
            Coordinate::Position => residual.position,
            Coordinate::Velocity => residual.velocity,
            Coordinate::Time => residual.time,
        };
        let (from, to) = friction_stage_core::numerics::range(along);
        let is_there = to > from
            && (to - from).is_finite()
            && residual.force.iter().any(|force| *force != 0.0);
        // Force that a knot of 1 adds: 1 N, as a change of friction all of its Coulomb or its
        // viscous part, against the motion, or that of 1 kg.
        let viscous = viscous_friction(residual).unwrap_or(0.0);
        let gain = match side {
            CurveSide::Carriage | CurveSide::Motor => vec![1.0; along.len()],
            CurveSide::Friction => residual
                .friction
                .iter()
                .zip(residual.velocity)
                .map(|(friction, v)| viscous * v - friction)
                .collect(),
            CurveSide::Viscous => residual.velocity.iter().map(|v| -viscous * v).collect(),
            CurveSide::Mass => {
                residual.acceleration.iter().map(|acceleration| -acceleration).collect()
            }
        };
        is_there.then_some(Rows { along, gain, force: residual.force, from, to, beside })
    }

    /// Force that values of 1 of a curve take away in a row, N: of the knots around it and, behind
    /// it, of the jump.
    fn pieces(
        &self,
        row: usize,
        knots: usize,
        jump: Option<f64>,
    ) -> impl Iterator<Item = (usize, f64)> + Clone {
        let (knot, share) = locate(self.along[row], self.from, self.to, knots);
        let gain = self.gain[row];
        let jump = jump.filter(|at| self.along[row] >= *at).map(|_| (knots, gain));
        [(knot, (1.0 - share) * gain), (knot + 1, share * gain)].into_iter().chain(jump)
    }

    /// Equations for the rows of each fold.
    fn folds(&self, knots: usize, jump: Option<f64>) -> Vec<Squares> {
        let new = |products| Squares::new(knots, usize::from(jump.is_some()), products);
        let mut folds: Vec<Squares> = self.beside.products.iter().map(new).collect();
        for (fold, rows) in blocks(self.along.len()) {
            for row in rows {
                folds[fold].add(
                    self.pieces(row, knots, jump),
                    self.gain[row],
                    self.force[row],
                    self.beside.sensitivities.column(row),
                );
            }
        }
        folds
    }

    /// For each damping the curve that predicts left-out blocks best.
    fn smooth(&self, dampings: &[Option<f64>], jump: Option<f64>) -> Vec<Option<Smooth>> {
        let mut best: Vec<Option<Smooth>> = dampings.iter().map(|_| None).collect();
        let line = jump.map(|_| BESIDE_A_JUMP[0]);
        for knots in line.into_iter().chain(KNOTS) {
            let folds = self.folds(knots, jump);
            let all = sum(&folds);
            for (damping, best) in dampings.iter().zip(&mut best) {
                let left_of = |fold: &Squares| {
                    let mut others = all.clone();
                    others.add_times(fold, -1.0);
                    Some(fold.left(&others.solve(self.beside, *damping)?))
                };
                let left: Option<f64> = folds.iter().map(left_of).sum();
                if let (Some(left), Some(solution)) = (left, all.solve(self.beside, *damping))
                    && best.as_ref().is_none_or(|best| left < best.left)
                {
                    *best = Some(Smooth { left, solution, knots });
                }
            }
        }
        best
    }

    /// The jump between two rows, in the order of time, that takes most of what a curve of so many
    /// knots leaves.
    fn jump(&self, dampings: &[Option<f64>], knots: usize) -> Option<Jump> {
        let count = self.along.len();
        let all = sum(&self.folds(knots, None));
        let best = dampings.iter().filter_map(|damping| {
            let (normal, right) = all.equations(self.beside, *damping);
            let factors = normal.cholesky()?;
            let solution = factors.solve(&right);
            // Of a jump before this row: products with what is there, its own squares, and its
            // product with what is left.
            let (mut shared, mut own, mut taken) = (DVector::zeros(solution.len()), 0.0, 0.0);
            let (mut most, mut jump) = (0.0, None);
            let mut solved = shared.clone();
            for row in (1..count).rev() {
                let gain = self.gain[row];
                let sensitivities = self.beside.sensitivities.column(row);
                let moves = sensitivities.iter().take(solution.len() - knots).enumerate();
                let moves = moves.map(|(index, sensitivity)| (knots + index, -sensitivity));
                let mut left = self.force[row];
                for (index, piece) in self.pieces(row, knots, None).chain(moves) {
                    left -= piece * solution[index];
                    shared[index] += gain * piece;
                }
                own += gain * gain;
                taken += gain * left;
                solved.copy_from(&shared);
                factors.solve_mut(&mut solved);
                let alone = own - shared.dot(&solved);
                if alone > OF_ITS_OWN * own && taken * taken > most * alone {
                    let at = 0.5 * (self.along[row - 1] + self.along[row]);
                    (most, jump) =
                        (taken * taken / alone, Some(Jump { at, height: taken / alone }));
                }
            }
            Some((all.left(&solution) - most, jump?))
        });
        best.min_by(|one, other| one.0.total_cmp(&other.0)).map(|(_, jump)| jump)
    }
}

fn sum(folds: &[Squares]) -> Squares {
    let mut all = folds[0].clone();
    folds[1..].iter().for_each(|fold| all.add_times(fold, 1.0));
    all
}

/// Least squares for the knots of a piecewise linear curve and, behind them, its jump and what
/// moves beside it.
#[derive(Clone)]
struct Squares {
    /// Only the lower triangle is filled.
    normal: DMatrix<f64>,
    right: DVector<f64>,
    /// Of the force, N^2.
    force: f64,
    weight: f64,
    knots: usize,
    /// Knots and jumps.
    values: usize,
}

impl Squares {
    /// `products`: of the sensitivities of what moves beside the curve.
    fn new(knots: usize, jumps: usize, products: &DMatrix<f64>) -> Squares {
        let values = knots + jumps;
        let all = values + products.nrows();
        let mut normal = DMatrix::zeros(all, all);
        normal.view_range_mut(values.., values..).copy_from(products);
        Squares { normal, right: DVector::zeros(all), force: 0.0, weight: 0.0, knots, values }
    }

    /// Takes in a missing force, N, of which values of 1 take away `pieces`, a curve of 1 `gain`,
    /// and to which what moves beside it adds `sensitivities`, N.
    fn add(
        &mut self,
        pieces: impl Iterator<Item = (usize, f64)> + Clone,
        gain: f64,
        force: f64,
        sensitivities: DVectorView<f64>,
    ) {
        for (row, a) in pieces.clone() {
            self.right[row] += a * force;
            for (column, b) in pieces.clone() {
                self.normal[(row, column)] += a * b;
            }
            for (column, sensitivity) in sensitivities.iter().enumerate() {
                self.normal[(self.values + column, row)] -= a * sensitivity;
            }
        }
        for (row, sensitivity) in sensitivities.iter().enumerate() {
            self.right[self.values + row] -= sensitivity * force;
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
        self.force - 2.0 * solution.dot(&self.right.rows(0, count))
            + solution.dot(&(normal * solution))
    }

    /// The knots, with a weak penalty on bending, the jump, and, unless they are held, the moves,
    /// with the weight of what is declared and a damping.
    fn equations(&self, beside: &Beside, damping: Option<f64>) -> (DMatrix<f64>, DVector<f64>) {
        let (knots, values) = (self.knots, self.values);
        let count = if damping.is_some() { self.right.len() } else { values };
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
        for value in 0..values {
            normal[(value, value)] += RIDGE * self.weight;
        }
        if let Some(damping) = damping {
            for (index, (coordinate, weight)) in
                beside.coordinates.iter().zip(&beside.declared).enumerate()
            {
                let at = values + index;
                normal[(at, at)] += weight + damping * self.normal[(at, at)];
                right[at] -= weight * coordinate.value / coordinate.scale;
            }
        }
        (normal, right)
    }

    fn solve(&self, beside: &Beside, damping: Option<f64>) -> Option<DVector<f64>> {
        let (normal, right) = self.equations(beside, damping);
        Some(normal.cholesky()?.solve(&right))
    }
}

#[cfg(test)]
mod tests {
    use friction_stage_core::model::StageModel;
    use friction_stage_core::plant::Samples;

    use super::*;
    use crate::hypothesis::Tolerances;

    const COUNT: usize = 8000;

    fn interpolate(values: &[f64], from: f64, to: f64, at: f64) -> f64 {
        let (knot, share) = locate(at, from, to, values.len());
        values[knot] * (1.0 - share) + values[knot + 1] * share
    }

    /// N, over the velocity in m/s.
    fn peak(speed: f64) -> f64 {
        3.0 * speed.signum() * (-(speed / 0.03).powi(2)).exp()
    }

    /// Of a motion that goes to and fro once in two blocks, so that every other block is all that
    /// there is of one half of the velocities, m/s.
    fn velocity(index: usize) -> f64 {
        let speed = 0.01 + 0.09 * (index % 200) as f64 / 200.0;
        if (index / 200).is_multiple_of(2) { speed } else { -speed }
    }

    /// What is drawn over a coordinate of the force that is missing at each sample, N.
    fn drawn_of(force: impl Fn(usize) -> f64, over: Coordinate, beside: &Beside) -> Vec<Drawn> {
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
        propose(&residual, over, CurveSide::Carriage, beside).unwrap()
    }

    /// Largest distance of a curve from the peak, N.
    fn off(drawn: &Drawn) -> f64 {
        let curve = drawn.part.curve().unwrap();
        let off = |speed: f64| {
            (interpolate(&curve.values, curve.from, curve.to, speed) - peak(speed)).abs()
        };
        [-0.08, -0.02, 0.015, 0.05].into_iter().map(off).fold(0.0, f64::max)
    }

    #[test]
    fn a_curve_is_found_whatever_the_rhythm_of_the_motion() {
        let drawn =
            drawn_of(|index| peak(velocity(index)), Coordinate::Velocity, &Beside::nothing(COUNT));
        assert!(drawn.len() == 1 && off(&drawn[0]) < 0.1, "{}", off(&drawn[0]));
    }

    /// The fit had biased a value by half its scale to what the curve is: what that does depends on
    /// the velocity, too.
    #[test]
    fn what_the_curve_had_biased_goes_back_where_it_may_move() {
        let model = Hypothesis::new(&StageModel::default(), Tolerances::default()).unwrap();
        let coordinate = hypothesis::FreeParameter {
            bounds: (-9.0, 9.0),
            ..model.coordinates(Sides::CARRIAGE, true)[0].clone()
        };
        let sensitivity =
            |index: usize| 4.0 * velocity(index).signum() + (0.01 * index as f64).sin();
        let sensitivities = DMatrix::from_fn(1, COUNT, |_, index| sensitivity(index));
        let biased = |index: usize| peak(velocity(index)) - 0.5 * sensitivity(index);
        let beside = Beside::new(vec![coordinate.clone()], sensitivities, vec![0.0]);
        let drawn = drawn_of(biased, Coordinate::Velocity, &beside);
        let (held, moved) = (&drawn[0], &drawn[1]);
        assert!(held.moved[0].value == coordinate.value && off(held) > 1.5, "{}", off(held));
        let back = (moved.moved[0].value - coordinate.value) / coordinate.scale;
        assert!((back - 0.5).abs() < 0.02 && off(moved) < 0.15, "{back}, {}", off(moved));
    }

    /// On a force that drifts one that is there from 3.1 s on, and a slope that looks much like it.
    #[test]
    fn over_the_time_a_jump_is_where_one_is() {
        let drift =
            |index: usize| 2.0 * (1.3e-3 * index as f64).sin() + 0.1 * (7.9 * index as f64).sin();
        let jumps = |index: usize| if index < 3100 { 0.0 } else { -4.0 };
        let rises = |index: usize| -4.0 * ((index as f64 - 2600.0) / 1000.0).clamp(0.0, 1.0);
        let nothing = Beside::nothing(COUNT);
        let jump_of = |force: &dyn Fn(usize) -> f64| {
            let drawn = drawn_of(|index| drift(index) + force(index), Coordinate::Time, &nothing);
            drawn[0].part.curve().unwrap().jump
        };
        let Jump { at, height } = jump_of(&jumps).expect("a jump");
        assert!((at - 3.0995).abs() < 2e-3 && (height + 4.0).abs() < 0.05, "{height} N at {at} s");
        assert_eq!(jump_of(&rises), None);
        assert_eq!(jump_of(&|_| 0.0), None);
    }

    /// Friction that falls to nothing keeps a little, with its jump too.
    #[test]
    fn of_the_friction_a_little_stays() {
        let mut curve = Curve {
            coordinate: Coordinate::Time,
            side: CurveSide::Friction,
            from: 0.0,
            to: 4.0,
            values: vec![-1.4, 0.0, 0.2, -0.4, 0.3],
            jump: Some(Jump { at: 2.5, height: -0.8 }),
        };
        keep_above(&mut curve, NO_FRICTION);
        let least =
            curve.corners().into_iter().map(|(_, value)| value).fold(f64::INFINITY, f64::min);
        assert!((least - NO_FRICTION).abs() < 1e-12, "{curve:?}");
        assert!((curve.jump.unwrap().height + 0.59).abs() < 1e-12, "{curve:?}");
    }

    /// The fit of the guides is 0.8 of their true Coulomb friction; the friction over position is
    /// 1.5 times as large up to a jump. Static friction may rise to 1.5 or 1.1 times its value.
    #[test]
    fn what_changes_friction_everywhere_goes_to_the_guides() {
        let value_of = |moved: &[hypothesis::FreeParameter], which: NominalParameter| {
            moved.iter().find(|one| one.id == ParameterId::Nominal(which)).unwrap().value
        };
        for (most, expected) in [(1.5f64, 1.0 / 0.8), (1.1, 1.1)] {
            let mut moved = Hypothesis::new(&StageModel::default(), Tolerances::default())
                .unwrap()
                .coordinates(Sides::CARRIAGE, true);
            for one in &mut moved {
                match one.id {
                    ParameterId::Nominal(NominalParameter::CoulombForce) => {
                        (one.value, one.bounds) = (0.8f64.ln(), (-1.0, 1.0))
                    }
                    ParameterId::Nominal(NominalParameter::StaticForce) => {
                        (one.value, one.bounds) = (0.0, (-1.0, most.ln()))
                    }
                    _ => {}
                }
            }
            let mut curve = Curve {
                coordinate: Coordinate::Time,
                side: CurveSide::Friction,
                from: 0.0,
                to: 2.0,
                values: vec![0.5; 3],
                jump: Some(Jump { at: 1.0, height: -0.5 }),
            };
            let drawn = moved.clone();
            level(&mut curve, &mut moved, &drawn, 40.0);
            let (coulomb, stat) = (
                value_of(&moved, NominalParameter::CoulombForce),
                value_of(&moved, NominalParameter::StaticForce),
            );
            assert!(
                (coulomb.exp() - 0.8 * expected).abs() < 1e-12
                    && (stat.exp() - expected).abs() < 1e-12
            );
            let behind = curve.corners()[4].1;
            for (change, friction) in [(curve.values[0], 1.5), (behind, 1.0)] {
                assert!(((1.0 + change) * expected - friction).abs() < 1e-12, "{change}");
            }
        }
    }

    /// Bent by 5 %, and by 2 % when the curve was drawn.
    #[test]
    fn a_mass_that_is_everywhere_goes_to_the_carriage() {
        let biased = |part: f64| {
            let mut all = Hypothesis::new(&StageModel::default(), Tolerances::default())
                .unwrap()
                .coordinates(Sides::CARRIAGE, true);
            all.retain(|one| one.id == ParameterId::Nominal(NominalParameter::Mass));
            all[0].value = part.ln();
            all
        };
        let (coordinate, side) = (Coordinate::Time, CurveSide::Mass);
        let jump = Some(Jump { at: 1.0, height: -0.5 });
        let mut curve = Curve { coordinate, side, from: 0.0, to: 2.0, values: vec![0.5; 3], jump };
        let mut moved = biased(1.05);
        level(&mut curve, &mut moved, &biased(1.02), 1.02 * 40.0);
        assert_eq!(moved[0].value, 0.0);
        assert!(
            curve.values.iter().all(|value| (40.0 + value - (1.05 * 40.0 + 0.5)).abs() < 1e-12),
            "{curve:?}"
        );
        assert_eq!(curve.jump, jump);
    }
}
