//! Nonlinear least squares with bounds: Levenberg-Marquardt (Marquardt, SIAM J. 11, 1963) whose
//! steps stay inside, with the variables at a bound held there while the error pulls outwards
//! (active set; Nocedal, Wright, "Numerical Optimization", ch. 16.7).
//!
//! Derivatives are dear: each set serves several steps, corrected by what a step has shown
//! (Broyden, Mathematics of Computation 19, 1965), and after a few sets the steps follow the bend
//! of a narrow valley (geodesic acceleration: Transtrum, Sethna, arXiv:1201.5885, 2012). Not
//! covered: linear constraints between variables, and residuals so many that J^T J is too
//! large to factor.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Sets of derivatives after which a fit that still goes on is taken to follow a narrow valley,
/// part of a step at which it measures how the valley bends, and part of the step that twice the
/// bend may have at most (Transtrum, Sethna, their h and alpha).
const IN_A_VALLEY: usize = 3;
const BEND_STEP: f64 = 0.1;
const LARGEST_BEND: f64 = 0.75;
/// Damping at the start, in units of the curvature of each variable. Assumed.
const FIRST_DAMPING: f64 = 1e-3;
/// Dampings that are tried, each five times the one before, until a step makes the error smaller.
const DAMPINGS: usize = 10;
/// Steps that derivatives may serve after the one that they were taken for, and part of the fall
/// they promise that a step must bring for another one.
const OLDEST: usize = 3;
const TRUSTED: f64 = 0.5;
/// Least curvature that the damping acts on, as a part of the largest one: a variable with hardly
/// any sensitivity must not jump to its bound. All variables are scaled, so their curvatures
/// compare.
const LEAST_CURVATURE: f64 = 1e-3;

/// Where a variable may be, and a usual change of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// A usual change, greater than 0: variables are divided by it.
    pub scale: f64,
    /// Lowest and highest value.
    pub bounds: (f64, f64),
}

impl Range {
    /// Without bounds.
    pub fn free(scale: f64) -> Range {
        Range { scale, bounds: (f64::NEG_INFINITY, f64::INFINITY) }
    }
}

/// Residuals whose sum of squares is to be least.
pub trait Problem {
    /// What an evaluation leaves for the derivatives there and for evaluations nearby.
    type State;
    /// Why residuals cannot be computed.
    type Error;

    /// Of each variable, in their order.
    fn ranges(&self) -> &[Range];

    /// Residuals of these values. `near` was left by values nearby.
    fn at(
        &self,
        values: &[f64],
        near: &Self::State,
    ) -> Result<Evaluation<Self::State>, Self::Error>;

    /// Derivatives of the residuals by each variable in its scale, in columns.
    fn derivatives(&self, point: &Evaluation<Self::State>) -> Result<DMatrix<f64>, Self::Error>;

    /// J^T J.
    fn normal(&self, jacobian: &DMatrix<f64>) -> DMatrix<f64> {
        jacobian.tr_mul(jacobian)
    }
}

/// Values with their residuals.
#[derive(Clone, Debug)]
pub struct Evaluation<S> {
    /// The variables.
    pub values: Vec<f64>,
    /// What the evaluation left for those nearby.
    pub state: S,
    /// The residuals.
    pub residual: DVector<f64>,
    /// Sum of the squares of the residuals.
    pub squares: f64,
}

/// How far a fit goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Budget {
    /// How often the derivatives are taken at most.
    pub derivatives: usize,
    /// Share by which the sum of squares must fall for another step to be taken, and the same as a
    /// sum of squares: the larger one counts.
    pub progress: f64,
    /// The smallest fall of the sum of squares that counts, in squares of the residuals' unit.
    pub least_fall: f64,
}

/// A fit on its way.
#[derive(Clone, Debug)]
pub struct Descent<S> {
    /// Where it is.
    pub point: Evaluation<S>,
    damping: f64,
    /// How often the derivatives were taken.
    pub taken: usize,
    /// How far the squares fell along the last derivatives.
    pub fallen: f64,
    /// No further step is worth it.
    pub converged: bool,
}

/// Derivatives of the residual, and J^T J.
struct Sensitivities {
    jacobian: DMatrix<f64>,
    normal: DMatrix<f64>,
}

/// A step that stays inside of the bounds.
struct StepInside {
    /// In scales of the variables.
    step: DVector<f64>,
    /// Of the matrix that it solves, with ones for what is fixed.
    factors: Cholesky<f64, Dyn>,
    /// Variables that are held, or end on a bound.
    fixed: Vec<bool>,
}

impl<S> Evaluation<S> {
    /// Variables at a bound with an error that pulls outwards.
    fn held(&self, gradient: &DVector<f64>, ranges: &[Range]) -> Vec<bool> {
        let variables = self.values.iter().zip(ranges).zip(gradient.iter());
        variables
            .map(|((value, Range { bounds: (lower, upper), .. }), gradient)| {
                (value <= lower && *gradient > 0.0) || (value >= upper && *gradient < 0.0)
            })
            .collect()
    }

    /// Some way from here, in scales of the variables, as far as the bounds allow.
    fn moved<P: Problem<State = S>>(
        &self,
        step: &DVector<f64>,
        problem: &P,
    ) -> Result<Evaluation<S>, P::Error> {
        let variables = self.values.iter().zip(problem.ranges()).zip(step.iter());
        let values: Vec<f64> = variables
            .map(|((value, Range { scale, bounds: (lower, upper) }), step)| {
                (value + step * scale).clamp(*lower, *upper)
            })
            .collect();
        problem.at(&values, &self.state)
    }

    /// The way to another point, in scales of the variables.
    fn way_to(&self, other: &Evaluation<S>, ranges: &[Range]) -> DVector<f64> {
        let ways = other
            .values
            .iter()
            .zip(&self.values)
            .zip(ranges)
            .map(|((to, from), range)| (to - from) / range.scale);
        DVector::from_iterator(self.values.len(), ways)
    }

    /// The step that solves matrix step = -gradient for the variables that are not held, in their
    /// scales: one that would go beyond its bound goes there, and the others as is best then.
    fn step_inside(
        &self,
        matrix: &DMatrix<f64>,
        gradient: &DVector<f64>,
        held: &[bool],
        ranges: &[Range],
    ) -> Option<StepInside> {
        let count = self.values.len();
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
            for (index, (value, range)) in self.values.iter().zip(ranges).enumerate() {
                let (lower, upper) = range.bounds;
                let to = value + step[index] * range.scale;
                if !fixed[index] && (to < lower || to > upper) {
                    there[index] = (to.clamp(lower, upper) - value) / range.scale;
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
    fn bend<P: Problem<State = S>>(
        &self,
        step: &DVector<f64>,
        jacobian: &DMatrix<f64>,
        problem: &P,
    ) -> Option<DVector<f64>> {
        let part = step * BEND_STEP;
        let near = self.moved(&part, problem).ok()?;
        let is_free = (self.way_to(&near, problem.ranges()) - &part).norm() < 1e-9 * part.norm();
        is_free
            .then(|| (near.residual - &self.residual - jacobian * part) * (2.0 / BEND_STEP.powi(2)))
    }

    /// A place where the error is smaller. `bends` where the step is to follow a valley: the
    /// derivatives must be those of this very point.
    fn better<P: Problem<State = S>>(
        &self,
        sensitivities: &Sensitivities,
        damping: &mut f64,
        bends: bool,
        problem: &P,
    ) -> Option<Evaluation<S>> {
        let Sensitivities { jacobian, normal } = sensitivities;
        let ranges = problem.ranges();
        let gradient = jacobian.tr_mul(&self.residual);
        let held = self.held(&gradient, ranges);
        let least = LEAST_CURVATURE * normal.diagonal().max();
        for attempt in 0..DAMPINGS {
            let mut matrix = normal.clone();
            for index in 0..self.values.len() {
                matrix[(index, index)] +=
                    *damping * matrix[(index, index)].max(least) + f64::MIN_POSITIVE;
            }
            let Some(StepInside { mut step, factors, fixed }) =
                self.step_inside(&matrix, &gradient, &held, ranges)
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
                if 2.0 * aside.norm() < LARGEST_BEND * step.norm() {
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

impl Sensitivities {
    /// As a step has shown the residual to change along its way, with what that was other than
    /// expected.
    fn learn(&mut self, way: &DVector<f64>, surprise: &DVector<f64>) {
        let part = way.norm_squared().recip();
        let shared = self.jacobian.tr_mul(surprise);
        self.normal.ger(part, &shared, way, 1.0);
        self.normal.ger(part, way, &shared, 1.0);
        self.normal.ger(part * part * surprise.norm_squared(), way, way, 1.0);
        self.jacobian.ger(part, surprise, way, 1.0);
    }
}

impl<S> Descent<S> {
    /// A fit that starts at a point.
    pub fn from(point: Evaluation<S>) -> Descent<S> {
        let converged = point.values.is_empty();
        Descent { point, damping: FIRST_DAMPING, taken: 0, fallen: 0.0, converged }
    }

    /// Whether it has come to its end, or as far as the budget allows.
    pub fn ended(&self, budget: &Budget) -> bool {
        self.converged || self.taken >= budget.derivatives
    }

    /// Takes the derivatives and goes as far as they lead.
    pub fn advance<P: Problem<State = S>>(
        &mut self,
        problem: &P,
        budget: &Budget,
    ) -> Result<(), P::Error> {
        let began = self.point.squares;
        let jacobian = problem.derivatives(&self.point)?;
        let mut sensitivities = Sensitivities { normal: problem.normal(&jacobian), jacobian };
        self.taken += 1;
        for age in 0.. {
            let bends = age == 0 && self.taken > IN_A_VALLEY;
            let undamped = self.damping;
            let Some(next) = self.point.better(&sensitivities, &mut self.damping, bends, problem)
            else {
                // Not even along the derivatives of this very point.
                self.converged |= age == 0;
                self.damping = undamped;
                break;
            };
            let before = std::mem::replace(&mut self.point, next);
            let fall = before.squares - self.point.squares;
            if fall < budget.least_fall.max(budget.progress * self.point.squares) {
                self.converged |= age == 0;
                break;
            }
            let way = before.way_to(&self.point, problem.ranges());
            let expected = &sensitivities.jacobian * &way;
            let promised = before.squares - (&before.residual + &expected).norm_squared();
            if age == OLDEST || fall <= TRUSTED * promised {
                break;
            }
            sensitivities.learn(&way, &((&self.point.residual - before.residual) - expected));
        }
        self.fallen = began - self.point.squares;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Steps in scales of 0.5: the first coordinate wants to go 2.5 of them and may go 1; the
    /// second one then goes further than it would have.
    #[test]
    fn a_coordinate_stops_at_its_bound_and_the_others_go_where_that_is_best() {
        let matrix = DMatrix::from_row_slice(3, 3, &[2.0, 1.0, 0.0, 1.0, 2.0, 0.0, 0.0, 0.0, 4.0]);
        let gradient = DVector::from_column_slice(&[-6.0, -4.5, 8.0]);
        let free = (-9.0, 9.0);
        let step = |first: (f64, f64), held: [bool; 3]| {
            let ranges = [first, free, free].map(|bounds| Range { scale: 0.5, bounds });
            let here = Evaluation {
                values: vec![0.0; 3],
                state: (),
                residual: DVector::zeros(0),
                squares: 0.0,
            };
            let StepInside { step, fixed, .. } =
                here.step_inside(&matrix, &gradient, &held, &ranges).unwrap();
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

    #[test]
    fn what_a_step_teaches_is_in_the_jacobian_and_in_the_normal_matrix() {
        let sensitivities =
            DMatrix::from_fn(9, 3, |row, column| f64::from((3 * row + 5 * column) as u8 % 7));
        let mut sensitivities =
            Sensitivities { normal: sensitivities.tr_mul(&sensitivities), jacobian: sensitivities };
        let way = DVector::from_column_slice(&[0.5, -1.0, 2.0]);
        let surprise = DVector::from_fn(9, |row, _| (row as f64).sin());
        let expected = &sensitivities.jacobian * &way + &surprise;
        sensitivities.learn(&way, &surprise);
        assert!((&sensitivities.jacobian * &way - expected).norm() < 1e-12);
        let normal = sensitivities.jacobian.transpose() * &sensitivities.jacobian;
        assert!((&sensitivities.normal - &normal).norm() < 1e-12 * normal.norm());
    }

    /// Rosenbrock's valley, (1 - x)^2 + 100 (y - x^2)^2, from his start.
    struct Valley(Vec<Range>);

    impl Problem for Valley {
        type State = ();
        type Error = ();

        fn ranges(&self) -> &[Range] {
            &self.0
        }

        fn at(&self, values: &[f64], _: &()) -> Result<Evaluation<()>, ()> {
            let [x, y] = [values[0], values[1]];
            let residual = DVector::from_column_slice(&[1.0 - x, 10.0 * (y - x * x)]);
            let squares = residual.norm_squared();
            Ok(Evaluation { values: values.to_vec(), state: (), residual, squares })
        }

        fn derivatives(&self, point: &Evaluation<()>) -> Result<DMatrix<f64>, ()> {
            let x = point.values[0];
            Ok(DMatrix::from_row_slice(2, 2, &[-1.0, 0.0, -20.0 * x, 10.0]))
        }
    }

    fn least(bounds: (f64, f64)) -> Descent<()> {
        let valley = Valley(vec![Range { scale: 1.0, bounds }, Range::free(1.0)]);
        let budget = Budget { derivatives: 100, progress: 1e-12, least_fall: 0.0 };
        let mut descent = Descent::from(valley.at(&[-1.2, 1.0], &()).unwrap());
        while !descent.ended(&budget) {
            descent.advance(&valley, &budget).unwrap();
        }
        descent
    }

    #[test]
    fn a_narrow_valley_is_followed_to_its_end() {
        let found = least((f64::NEG_INFINITY, f64::INFINITY));
        assert!(found.converged && found.point.squares < 1e-20, "{found:?}");
        assert!((found.point.values[0] - 1.0).abs() < 1e-9, "{found:?}");
    }

    /// x at most 0.5: there (1 - x)^2 = 0.25 is least, with y = x^2.
    #[test]
    fn where_a_bound_is_in_the_way_the_other_variable_goes_where_that_is_best() {
        let found = least((-2.0, 0.5)).point;
        assert_eq!(found.values[0], 0.5);
        assert!((found.values[1] - 0.25).abs() < 1e-6, "{found:?}");
        assert!((found.squares - 0.25).abs() < 1e-9, "{found:?}");
    }
}
