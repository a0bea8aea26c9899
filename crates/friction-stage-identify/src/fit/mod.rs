//! Least squares with bounds: Levenberg-Marquardt (Marquardt 1963) whose steps stay inside, with
//! the coordinates at a bound held there while the error pulls outwards (active set; Nocedal,
//! Wright, "Numerical Optimization", ch. 16.7).

mod difference;
mod guide_sensitivities;
mod knot_sensitivities;
pub(crate) mod objective;
pub(crate) mod sensor_noise;
pub(crate) mod uncertainty;

use std::slice;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use rayon::prelude::*;

use crate::fit::objective::{derivatives, normal_of, stacked};
use crate::fit::uncertainty::uncertainty;
use crate::hypothesis::{FreeParameter, Hypothesis, ParameterId, Sides};
use crate::record::measured::Measured;
use crate::residual::driven::Driven;
use crate::residual::missing::Missing;
use friction_stage_core::model::ModelError;

/// Part of what a fit must still fall by to be worth anything that it must come to between two
/// derivatives: with less it gives up.
const HOPELESS: f64 = 0.05;
/// Derivatives behind which a fit that still goes on is taken to follow a narrow valley, part of a
/// step at which it looks how the valley bends, and part of the step that twice the bend may have
/// at most (Transtrum, Sethna, arXiv:1201.5885, 2012, their h and alpha).
const IN_A_VALLEY: usize = 3;
const LOOKS_AT: f64 = 0.1;
const MOST_BENT: f64 = 0.75;

/// Dampings that are tried, each five times the one before, until a step makes the error smaller.
const DAMPINGS: usize = 10;
/// Steps that derivatives may serve behind the one that they were taken for, and part of the fall
/// they promise that a step must bring for another one.
const OLDEST: usize = 3;
const TRUSTED: f64 = 0.5;
/// Least curvature that the damping acts on, as a part of the largest one: a coordinate with hardly
/// any sensitivity, such as a difference between guides near 0, must not jump to its bound. All
/// coordinates are scaled by their tolerance, so their curvatures compare.
const LEAST_CURVATURE: f64 = 1e-3;

/// How far a fit goes.
#[derive(Clone, Copy, Debug)]
pub struct FitBudget {
    /// How often the derivatives are taken at most.
    derivatives: usize,
    /// Share by which the sum of squares must fall for another step to be worth it, and the same in
    /// N^2: the larger one counts.
    progress: f64,
    least_fall: f64,
    /// Sum of squares that it must come below to be worth anything, N^2.
    worth: f64,
}

impl FitBudget {
    /// Of a fit that is compared with others.
    pub const COMPARED: FitBudget =
        FitBudget { derivatives: 8, progress: 1e-4, least_fall: 0.0, worth: f64::INFINITY };
    /// Of a fit that others build on: what it left undone would pass for another effect.
    pub const KEPT: FitBudget =
        FitBudget { derivatives: 30, progress: 1e-5, least_fall: 0.0, worth: f64::INFINITY };

    /// The same of a fit that may stop where a step brings less than this, N^2.
    pub fn ending_below(self, fall: f64) -> FitBudget {
        FitBudget { least_fall: fall, ..self }
    }

    /// The same of a fit that may stop where it will hardly come below this sum of squares, N^2.
    pub fn gain_below(self, squares: f64) -> FitBudget {
        FitBudget { worth: squares.min(self.worth), ..self }
    }
}

/// A hypothesis at its best.
#[derive(Clone, Debug)]
pub struct Fitted {
    pub hypothesis: Hypothesis,
    pub missing: Missing,
    pub coordinates: Vec<FreeParameter>,
    /// Coordinates that ended on a bound.
    pub at_bound: Vec<bool>,
}

/// A fit with how well the data know it.
#[derive(Clone, Debug)]
pub struct Estimate {
    pub fitted: Fitted,
    /// Standard deviation of each coordinate around what records like this one give; infinite where
    /// the data say nothing.
    pub deviations: Vec<f64>,
    /// How far the sensors' noise takes that from the truth, by coordinate; 0 where nobody has
    /// asked.
    pub shifts: Vec<f64>,
    /// Correlation matrix of the coordinates, row by row.
    pub correlations: Vec<Vec<f64>>,
}

impl Fitted {
    /// Sum of the squares of the missing force, N^2.
    pub fn squares(&self) -> f64 {
        self.missing.motor.iter().chain(&self.missing.carriage).map(|left| left * left).sum()
    }

    /// The same with its curves held.
    pub(crate) fn holding_curves(self) -> Fitted {
        let is_of_curve = |id: ParameterId| match id {
            ParameterId::Effect { effect, .. } => {
                self.hypothesis.effects[effect].descriptor.is_curve()
            }
            _ => false,
        };
        let both = self.coordinates.into_iter().zip(self.at_bound);
        let (coordinates, at_bound) =
            both.filter(|(coordinate, _)| !is_of_curve(coordinate.id)).unzip();
        Fitted {
            hypothesis: self.hypothesis.holding_curves(true),
            missing: self.missing,
            coordinates,
            at_bound,
        }
    }

    /// How well the record of the fit knows its coordinates. `sides` as in the fit.
    pub fn estimate(self, measured: &Measured, sides: Sides) -> Result<Estimate, ModelError> {
        let problem = Problem { measured, sides, noise: self.hypothesis.floor(measured).carriage };
        let point = Point::at(
            self.hypothesis.clone(),
            self.coordinates.clone(),
            &Driven::default(),
            problem,
        )?;
        let jacobian = point.derivatives(problem)?;
        let (deviations, correlations) = uncertainty(
            &jacobian,
            &point.residual,
            &point.missing,
            &self.coordinates,
            &self.at_bound,
            problem.noise,
        );
        let shifts = vec![0.0; self.coordinates.len()];
        // Of the hypothesis as it stands, whatever was set in it behind the fit.
        let fitted = Fitted { missing: point.missing, ..self };
        Ok(Estimate { fitted, deviations, shifts, correlations })
    }
}

impl Estimate {
    /// How far a coordinate may be from the truth: standard deviation and shift.
    pub fn deviation(&self, index: usize) -> f64 {
        self.deviations[index].hypot(self.shifts[index])
    }
}

/// What a fit compares, on a record.
#[derive(Clone, Copy)]
struct Problem<'a> {
    measured: &'a Measured,
    sides: Sides,
    /// Weight of what is declared, N.
    noise: f64,
}

/// A step that stays inside of the bounds.
struct StepInside {
    /// In scales of the coordinates.
    step: DVector<f64>,
    /// Of the matrix that it solves, with ones for what is fixed.
    factors: Cholesky<f64, Dyn>,
    /// Coordinates that are held, or end on a bound.
    fixed: Vec<bool>,
}

/// A place that a fit has come to.
struct Point {
    hypothesis: Hypothesis,
    coordinates: Vec<FreeParameter>,
    driven: Driven,
    missing: Missing,
    residual: DVector<f64>,
    squares: f64,
}

impl Point {
    /// `before` is of a hypothesis nearby, or the default.
    fn at(
        hypothesis: Hypothesis,
        coordinates: Vec<FreeParameter>,
        before: &Driven,
        problem: Problem,
    ) -> Result<Point, ModelError> {
        let driven = hypothesis.driven(problem.measured, problem.sides, before)?;
        let missing = hypothesis.missing_of(&driven, problem.measured, problem.sides);
        let residual = stacked(&missing, &coordinates, problem.noise);
        let squares = residual.norm_squared();
        Ok(Point { hypothesis, coordinates, driven, missing, residual, squares })
    }

    /// Where a fit begins: inside the bounds, since a coordinate on its bound has only one way to
    /// go. A declared parameter that was bent to its bound has stood for something that the model
    /// lacked: it begins as declared, if that is nearer now.
    fn inside(start: &Hypothesis, problem: Problem) -> Result<Point, ModelError> {
        let given = start.coordinates(problem.sides, problem.measured.cell.is_some());
        let is_bent = |one: &FreeParameter| {
            matches!(one.id, ParameterId::Nominal(_))
                && (one.value <= one.bounds.0 || one.value >= one.bounds.1)
        };
        let begin = |as_declared: bool| {
            let (mut hypothesis, mut coordinates) = (start.clone(), given.clone());
            for coordinate in &mut coordinates {
                let (lower, upper) = coordinate.bounds;
                let margin = 1e-3 * (upper - lower).min(coordinate.scale);
                let value = if as_declared && is_bent(coordinate) { 0.0 } else { coordinate.value };
                coordinate.value = value.clamp(lower + margin, upper - margin);
                hypothesis.set(coordinate.id, coordinate.value);
            }
            Point::at(hypothesis, coordinates, &Driven::default(), problem)
        };
        let bent = begin(false);
        let point = match given.iter().any(is_bent).then(|| begin(true)) {
            Some(Ok(declared))
                if bent.as_ref().is_ok_and(|bent| declared.squares > bent.squares) =>
            {
                bent
            }
            Some(Ok(declared)) => Ok(declared),
            _ => bent,
        };
        // Values may not go together any more a little inside their bounds: then the start is as it
        // was given.
        point.or_else(|_| Point::at(start.clone(), given, &Driven::default(), problem))
    }

    fn derivatives(&self, problem: Problem) -> Result<DMatrix<f64>, ModelError> {
        let Problem { measured, sides, noise } = problem;
        derivatives(
            &self.hypothesis,
            &self.coordinates,
            &self.driven,
            measured,
            sides,
            &self.residual,
            noise,
        )
    }

    /// Coordinates at a bound with an error that pulls outwards.
    fn held(&self, gradient: &DVector<f64>) -> Vec<bool> {
        let outwards = |coordinate: &FreeParameter, gradient: f64| {
            (coordinate.value <= coordinate.bounds.0 && gradient > 0.0)
                || (coordinate.value >= coordinate.bounds.1 && gradient < 0.0)
        };
        self.coordinates
            .iter()
            .zip(gradient.iter())
            .map(|(coordinate, gradient)| outwards(coordinate, *gradient))
            .collect()
    }

    /// Some way from here, in scales of the coordinates, as far as the bounds allow.
    fn moved(&self, step: &DVector<f64>, problem: Problem) -> Result<Point, ModelError> {
        let (mut hypothesis, mut coordinates) = (self.hypothesis.clone(), self.coordinates.clone());
        for (coordinate, step) in coordinates.iter_mut().zip(step.iter()) {
            let (lower, upper) = coordinate.bounds;
            coordinate.value = (coordinate.value + step * coordinate.scale).clamp(lower, upper);
            hypothesis.set(coordinate.id, coordinate.value);
        }
        Point::at(hypothesis, coordinates, &self.driven, problem)
    }

    /// The way to another point, in scales of the coordinates.
    fn way_to(&self, other: &Point) -> DVector<f64> {
        let ways = other
            .coordinates
            .iter()
            .zip(&self.coordinates)
            .map(|(to, from)| (to.value - from.value) / to.scale);
        DVector::from_iterator(self.coordinates.len(), ways)
    }

    /// The step that solves matrix step = -gradient for the coordinates that are not held, in their
    /// scales: one that would go beyond its bound goes there, and the others as is best then.
    fn step_inside(
        &self,
        matrix: &DMatrix<f64>,
        gradient: &DVector<f64>,
        held: &[bool],
    ) -> Option<StepInside> {
        let count = self.coordinates.len();
        let (mut fixed, mut there) = (held.to_vec(), DVector::zeros(count));
        loop {
            let (mut free, mut right) = (matrix.clone(), -(gradient + matrix * &there));
            for index in (0..count).filter(|index| fixed[*index]) {
                free.row_mut(index).fill(0.0);
                free.column_mut(index).fill(0.0);
                free[(index, index)] = 1.0;
                right[index] = there[index];
            }
            let factors = free.cholesky()?;
            let step = factors.solve(&right);
            let mut beyond = false;
            for (index, coordinate) in self.coordinates.iter().enumerate() {
                let (lower, upper) = coordinate.bounds;
                let to = coordinate.value + step[index] * coordinate.scale;
                if !fixed[index] && (to < lower || to > upper) {
                    there[index] = (to.clamp(lower, upper) - coordinate.value) / coordinate.scale;
                    (fixed[index], beyond) = (true, true);
                }
            }
            if !beyond {
                return Some(StepInside { step, factors, fixed });
            }
        }
    }

    /// How the residual bends along a step: its second derivative, for a step of length 1; `None`
    /// where a bound is in the way.
    fn bend(
        &self,
        step: &DVector<f64>,
        jacobian: &DMatrix<f64>,
        problem: Problem,
    ) -> Option<DVector<f64>> {
        let part = step * LOOKS_AT;
        let near = self.moved(&part, problem).ok()?;
        let is_free = (self.way_to(&near) - &part).norm() < 1e-9 * part.norm();
        is_free
            .then(|| (near.residual - &self.residual - jacobian * part) * (2.0 / LOOKS_AT.powi(2)))
    }

    /// A place where the error is smaller. `bends` where the step is to follow a valley: the
    /// derivatives must be those of this very point.
    fn better(
        &self,
        sensitivities: &Sensitivities,
        damping: &mut f64,
        bends: bool,
        problem: Problem,
    ) -> Option<Point> {
        let Sensitivities { jacobian, normal } = sensitivities;
        let gradient = jacobian.tr_mul(&self.residual);
        let held = self.held(&gradient);
        let least = LEAST_CURVATURE * normal.diagonal().max();
        for attempt in 0..DAMPINGS {
            let mut matrix = normal.clone();
            for index in 0..self.coordinates.len() {
                matrix[(index, index)] +=
                    *damping * matrix[(index, index)].max(least) + f64::MIN_POSITIVE;
            }
            let Some(StepInside { mut step, factors, fixed }) =
                self.step_inside(&matrix, &gradient, &held)
            else {
                *damping = (*damping * 10.0).max(1e-6);
                continue;
            };
            if let Some(bend) = bends.then(|| self.bend(&step, jacobian, problem)).flatten() {
                let mut right = -jacobian.tr_mul(&bend);
                right
                    .iter_mut()
                    .zip(&fixed)
                    .filter(|(_, fixed)| **fixed)
                    .for_each(|(right, _)| *right = 0.0);
                let aside = factors.solve(&right);
                if 2.0 * aside.norm() < MOST_BENT * step.norm() {
                    step += aside * 0.5;
                }
            }
            // Values that do not go together are a step too far, not an end.
            match self.moved(&step, problem) {
                Ok(point) if point.squares < self.squares => {
                    // What took several attempts was too little damped.
                    *damping *= if attempt == 0 { 0.2 } else { 1.0 };
                    return Some(point);
                }
                _ => *damping *= 5.0,
            }
        }
        None
    }
}

/// Derivatives of the residual, and J^T J.
struct Sensitivities {
    jacobian: DMatrix<f64>,
    normal: DMatrix<f64>,
}

impl Sensitivities {
    fn of(jacobian: DMatrix<f64>) -> Sensitivities {
        Sensitivities { normal: normal_of(&jacobian), jacobian }
    }

    /// As a step has shown the residual to change along its way, with what that was other than
    /// expected (Broyden, Mathematics of Computation 19, 1965).
    fn learn(&mut self, way: &DVector<f64>, surprise: &DVector<f64>) {
        let part = way.norm_squared().recip();
        let shared = self.jacobian.tr_mul(surprise);
        self.normal.ger(part, &shared, way, 1.0);
        self.normal.ger(part, way, &shared, 1.0);
        self.normal.ger(part * part * surprise.norm_squared(), way, way, 1.0);
        self.jacobian.ger(part, surprise, way, 1.0);
    }
}

/// A fit on its way.
struct Descent<'a> {
    problem: Problem<'a>,
    effort: FitBudget,
    point: Point,
    damping: f64,
    /// How often the derivatives were taken, and how far the squares have fallen along the last
    /// ones, N^2.
    taken: usize,
    fallen: f64,
    ended: bool,
}

impl<'a> Descent<'a> {
    fn new(
        start: &Hypothesis,
        measured: &'a Measured,
        sides: Sides,
        effort: FitBudget,
    ) -> Result<Descent<'a>, ModelError> {
        let problem = Problem { measured, sides, noise: start.floor(measured).carriage };
        let point = Point::inside(start, problem)?;
        let ended = point.coordinates.is_empty();
        Ok(Descent { problem, effort, point, damping: 1e-3, taken: 0, fallen: 0.0, ended })
    }

    /// Takes the derivatives and goes as far as they lead.
    fn advance(&mut self) -> Result<(), ModelError> {
        let began = self.point.squares;
        let mut sensitivities = Sensitivities::of(self.point.derivatives(self.problem)?);
        self.taken += 1;
        for age in 0.. {
            let bends = age == 0 && self.taken > IN_A_VALLEY;
            let undamped = self.damping;
            let Some(next) =
                self.point.better(&sensitivities, &mut self.damping, bends, self.problem)
            else {
                // Not even along the derivatives of this very point.
                self.ended |= age == 0;
                self.damping = undamped;
                break;
            };
            let before = std::mem::replace(&mut self.point, next);
            let fall = before.squares - self.point.squares;
            if fall < self.effort.least_fall.max(self.effort.progress * self.point.squares) {
                self.ended |= age == 0;
                break;
            }
            let way = before.way_to(&self.point);
            let expected = &sensitivities.jacobian * &way;
            let promised = before.squares - (&before.residual + &expected).norm_squared();
            if age == OLDEST || fall <= TRUSTED * promised {
                break;
            }
            sensitivities.learn(&way, &((&self.point.residual - before.residual) - expected));
        }
        self.fallen = began - self.point.squares;
        self.ended |= self.taken >= self.effort.derivatives;
        Ok(())
    }

    /// Whether it will hardly come below this sum of squares, N^2.
    fn is_hopeless(&self, worth: f64) -> bool {
        self.fallen < HOPELESS * (self.point.squares - worth)
    }

    fn fitted(self) -> Fitted {
        let Point { hypothesis, coordinates, missing, .. } = self.point;
        let is_at_bound = |c: &FreeParameter| {
            let margin = 1e-6 * c.scale;
            c.value <= c.bounds.0 + margin || c.value >= c.bounds.1 - margin
        };
        let at_bound = coordinates.iter().map(is_at_bound).collect();
        Fitted { hypothesis, missing, coordinates, at_bound }
    }
}

/// Moves everything that may move on these sides until the missing force is least.
pub fn fit(
    start: &Hypothesis,
    measured: &Measured,
    sides: Sides,
    effort: FitBudget,
) -> Result<Fitted, ModelError> {
    race(slice::from_ref(start), measured, sides, effort, 1.0).remove(0)
}

/// Fits from several starts side by side, each as far as it may become the best one: it gives up
/// where it will hardly come below `within` times the squares of the best so far.
pub fn race(
    starts: &[Hypothesis],
    measured: &Measured,
    sides: Sides,
    effort: FitBudget,
    within: f64,
) -> Vec<Result<Fitted, ModelError>> {
    let mut fits: Vec<_> =
        starts.par_iter().map(|start| Descent::new(start, measured, sides, effort)).collect();
    let going = |fit: &Result<Descent, ModelError>| fit.as_ref().is_ok_and(|fit| !fit.ended);
    while fits.iter().any(going) {
        fits.par_iter_mut().filter(|fit| going(fit)).for_each(|fit| {
            let failed = fit.as_mut().ok().and_then(|fit| fit.advance().err());
            if let Some(error) = failed {
                *fit = Err(error);
            }
        });
        let least =
            fits.iter().flatten().map(|fit| fit.point.squares).fold(f64::INFINITY, f64::min);
        let worth = effort.worth.min(within * least);
        fits.iter_mut().flatten().for_each(|fit| fit.ended |= fit.is_hopeless(worth));
    }
    fits.into_iter().map(|fit| fit.map(Descent::fitted)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hypothesis::nominal_parameter::NominalParameter;
    use crate::hypothesis::{Part, Tolerances};
    use crate::test_records::recording;
    use friction_stage_core::model::StageModel;
    use friction_stage_core::plant::EffectDescriptor;

    fn declared() -> Hypothesis {
        Hypothesis::new(&StageModel::default(), Tolerances::default()).unwrap()
    }

    fn cogging(period: f64) -> Part {
        Part {
            descriptor: EffectDescriptor::find("cogging").unwrap(),
            values: vec![3.0, period, 0.3],
        }
    }

    /// With a force that comes and goes over 4 mm.
    fn record_with_cogging() -> Measured {
        let real =
            StageModel { effects: vec![cogging(4e-3).parameters()], ..StageModel::default() };
        Measured::new(&recording(&real, 3, 0.0, 4), &StageModel::default(), "the record").unwrap()
    }

    fn point_between(bounds: [(f64, f64); 3]) -> Point {
        let coordinate = |bounds| FreeParameter {
            id: ParameterId::Effect { effect: 0, value: 0 },
            value: 0.0,
            scale: 0.5,
            bounds,
        };
        Point {
            hypothesis: declared(),
            coordinates: bounds.map(coordinate).to_vec(),
            driven: Driven::default(),
            missing: Missing::default(),
            residual: DVector::zeros(0),
            squares: 0.0,
        }
    }

    /// Steps in scales of 0.5: the first coordinate wants to go 2.5 of them and may go 1; the
    /// second one then goes further than it would have.
    #[test]
    fn a_coordinate_stops_at_its_bound_and_the_others_go_where_that_is_best() {
        let matrix = DMatrix::from_row_slice(3, 3, &[2.0, 1.0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 4.0]);
        let gradient = DVector::from_column_slice(&[-6.0, -4.5, 8.0]);
        let free = (-9.0, 9.0);
        let step = |first: (f64, f64), held: [bool; 3]| {
            let StepInside { step, fixed, .. } =
                point_between([first, free, free]).step_inside(&matrix, &gradient, &held).unwrap();
            (step, fixed)
        };
        let (anywhere, fixed) = step(free, [false; 3]);
        assert!(
            (&anywhere - DVector::from_column_slice(&[2.5, 1.0, -2.0])).norm() < 1e-12,
            "{anywhere}"
        );
        assert_eq!(fixed, [false; 3]);
        let (inside, fixed) = step((-9.0, 0.5), [false; 3]);
        assert!(
            (&inside - DVector::from_column_slice(&[1.0, 1.75, -2.0])).norm() < 1e-12,
            "{inside}"
        );
        assert_eq!(fixed, [true, false, false]);
        let (held, _) = step(free, [false, false, true]);
        assert!((&held - DVector::from_column_slice(&[2.5, 1.0, 0.0])).norm() < 1e-12, "{held}");
    }

    /// Coulomb friction on its bound, of guides that have as much or what is declared.
    #[test]
    fn what_was_bent_to_its_bound_begins_as_declared_if_that_is_nearer() {
        let place = ParameterId::Nominal(NominalParameter::CoulombForce);
        let bound = |hypothesis: &Hypothesis| {
            let coordinates = hypothesis.coordinates(Sides::BOTH, true);
            coordinates.into_iter().find(|one| one.id == place).expect("a coordinate").bounds.1
        };
        let mut bent = declared();
        bent.set(place, bound(&bent));
        for (real, expected) in [(bent.model(), bound(&bent)), (StageModel::default(), 0.0)] {
            let measured =
                Measured::new(&recording(&real, 3, 0.0, 2), &StageModel::default(), "the record")
                    .unwrap();
            let problem = Problem { measured: &measured, sides: Sides::BOTH, noise: 0.0 };
            let point = Point::inside(&bent, problem).unwrap();
            let began = point.coordinates.iter().find(|one| one.id == place).expect("a coordinate");
            // A little inside.
            assert!((began.value - expected).abs() < 1e-3, "{} of {expected}", began.value);
            assert!(began.value < began.bounds.1);
        }
    }

    #[test]
    fn what_a_step_teaches_the_slopes_is_in_both_of_them() {
        let mut sensitivities = Sensitivities::of(DMatrix::from_fn(9, 3, |row, column| {
            f64::from((3 * row + 5 * column) as u8 % 7)
        }));
        let way = DVector::from_column_slice(&[0.5, -1.0, 2.0]);
        let surprise = DVector::from_fn(9, |row, _| (row as f64).sin());
        let expected = &sensitivities.jacobian * &way + &surprise;
        sensitivities.learn(&way, &surprise);
        assert!((&sensitivities.jacobian * &way - expected).norm() < 1e-12);
        let normal = sensitivities.jacobian.transpose() * &sensitivities.jacobian;
        assert!((&sensitivities.normal - &normal).norm() < 1e-12 * normal.norm());
    }

    /// Side by side with one that lacks a force of 5 N, which gives up, and with one that has it
    /// from another start, which does not.
    #[test]
    fn side_by_side_the_best_one_ends_as_it_does_alone() {
        let push = |force: f64| Part {
            descriptor: EffectDescriptor::find("constant_force").unwrap(),
            values: vec![force],
        };
        let real = StageModel { effects: vec![push(5.0).parameters()], ..StageModel::default() };
        let measured =
            Measured::new(&recording(&real, 3, 0.0, 4), &StageModel::default(), "the record")
                .unwrap();
        let starts = [declared(), declared().with(push(1.0)), declared().with(push(8.0))];
        let alone = starts
            .each_ref()
            .map(|start| fit(start, &measured, Sides::BOTH, FitBudget::KEPT).unwrap());
        let raced: Vec<Fitted> = race(&starts, &measured, Sides::BOTH, FitBudget::KEPT, 1.0)
            .into_iter()
            .flatten()
            .collect();
        let best = if alone[1].squares() < alone[2].squares() { 1 } else { 2 };
        assert_eq!(raced[best].squares(), alone[best].squares());
        assert!(
            (raced[best].hypothesis.effects[0].values[0] - 5.0).abs() < 0.1,
            "{:?}",
            raced[best].hypothesis.effects
        );
        assert!(raced[0].squares() > 10.0 * raced[best].squares());
        assert!(raced.iter().zip(&alone).all(|(raced, alone)| raced.squares() >= alone.squares()));
        let without_a_limit = race(&starts, &measured, Sides::BOTH, FitBudget::KEPT, f64::INFINITY);
        let squares: Vec<f64> = without_a_limit.iter().flatten().map(Fitted::squares).collect();
        assert_eq!(squares, alone.each_ref().map(Fitted::squares));
    }

    /// From a period of 4.25 mm.
    #[test]
    fn a_fit_between_rounds_ends_where_its_steps_bring_too_little() {
        let measured = record_with_cogging();
        let start = declared().with(cogging(4.25e-3));
        let squares = |effort| fit(&start, &measured, Sides::BOTH, effort).unwrap().squares();
        let (to_its_end, at_once) =
            (squares(FitBudget::KEPT), squares(FitBudget::KEPT.ending_below(f64::INFINITY)));
        let between = squares(FitBudget::KEPT.ending_below(1e-3 * to_its_end));
        assert!(at_once > 1.1 * to_its_end, "{at_once} N^2, {to_its_end} N^2");
        assert!((between / to_its_end - 1.0).abs() < 0.01, "{between} N^2, {to_its_end} N^2");
    }

    /// From periods so far off that it has to find its way: of what is still to come a derivative
    /// brings as little as 8 %.
    #[test]
    fn a_fit_that_has_a_long_way_to_what_it_is_worth_is_not_given_up() {
        let measured = record_with_cogging();
        for period in [4.3e-3, 4.32e-3, 4.34e-3, 4.35e-3, 4.38e-3] {
            let start = declared().with(cogging(period));
            let squares = |effort| fit(&start, &measured, Sides::BOTH, effort).unwrap().squares();
            let to_its_end = squares(FitBudget::KEPT);
            assert!(to_its_end < 3.0, "{period}: {to_its_end} N^2");
            assert_eq!(
                squares(FitBudget::KEPT.gain_below(1.5 * to_its_end)),
                to_its_end,
                "{period}"
            );
        }
    }

    /// A spring that the model lacks.
    #[test]
    fn a_fit_that_is_not_worth_going_on_with_ends_early_and_says_where() {
        let measured = {
            let cable = EffectDescriptor::find("cable_chain").unwrap();
            let values =
                cable.parameters.iter().map(|parameter| parameter.default.unwrap_or(0.0)).collect();
            let mut part = Part { descriptor: cable, values };
            part.values[0] = 300.0;
            let real = StageModel { effects: vec![part.parameters()], ..StageModel::default() };
            Measured::new(&recording(&real, 3, 0.0, 4), &StageModel::default(), "the record")
                .unwrap()
        };
        let to_its_end = fit(&declared(), &measured, Sides::BOTH, FitBudget::KEPT).unwrap();
        let given_up =
            fit(&declared(), &measured, Sides::BOTH, FitBudget::KEPT.gain_below(0.0)).unwrap();
        assert!(
            given_up.squares() >= to_its_end.squares()
                && given_up.squares() < 2.0 * to_its_end.squares()
        );
        let reachable = FitBudget::KEPT.gain_below(2.0 * to_its_end.squares());
        assert_eq!(
            fit(&declared(), &measured, Sides::BOTH, reachable).unwrap().squares(),
            to_its_end.squares()
        );
    }
}
