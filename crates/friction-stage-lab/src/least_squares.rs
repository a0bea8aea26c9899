//! Nonlinear least squares of a function of a few parameters, with the covariance of what is found.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use friction_stage_core::numerics::least_squares::{Budget, Descent, Evaluation, Problem, Range};

/// Where the search ended.
#[derive(Clone, Debug)]
pub struct Minimum {
    /// Values at the minimum, in the order of the start.
    pub parameters: Vec<f64>,
    /// Sum of the squared residuals.
    pub cost: f64,
    /// Inverse of J'J at the minimum: times the variance of a residual, the covariance of the
    /// parameters.
    pub covariance: DMatrix<f64>,
    /// Residuals at the minimum, in the order of the function.
    pub residuals: Vec<f64>,
}

/// A search without a result.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    /// Residuals that are not finite where the search begins.
    #[error("the residuals are not finite at the start of the search")]
    Start,
    /// Data that leave some parameter open.
    #[error("the data do not determine all {parameters} parameters (J'J is singular)")]
    Singular {
        /// Number of parameters.
        parameters: usize,
    },
    /// A search without convergence.
    #[error("the search did not end within {iterations} iterations")]
    Unfinished {
        /// Most iterations of a search.
        iterations: usize,
    },
}

/// Assumed: searches that start near end within twenty sets of derivatives.
const BUDGET: Budget = Budget { derivatives: 100, progress: 1e-10, least_fall: 0.0 };
/// Step of the central differences, of parameters that are of the order of one.
const DIFFERENCE: f64 = 1e-5;

/// Minimises the sum of squares from `start` on; parameters should be of the order of one, or
/// logarithms.
pub fn minimise(
    start: &[f64],
    residuals: &(impl Fn(&[f64]) -> Vec<f64> + Sync),
) -> Result<Minimum, FitError> {
    let function = Function { residuals, ranges: vec![Range::free(1.0); start.len()] };
    let begin = function.at(start, &()).map_err(|NotFinite| FitError::Start)?;
    let mut descent = Descent::from(begin);
    while !descent.ended(&BUDGET) {
        descent.advance(&function, &BUDGET).map_err(|NotFinite| FitError::Start)?;
    }
    if !descent.converged {
        return Err(FitError::Unfinished { iterations: BUDGET.derivatives });
    }
    let point = descent.point;
    let jacobian = function.derivatives(&point).map_err(|NotFinite| FitError::Start)?;
    let covariance = jacobian
        .tr_mul(&jacobian)
        .cholesky()
        .map(|factor| factor.inverse())
        .filter(|inverse| inverse.iter().all(|value| value.is_finite()))
        .ok_or(FitError::Singular { parameters: start.len() })?;
    Ok(Minimum {
        parameters: point.values,
        cost: point.squares,
        covariance,
        residuals: point.residual.as_slice().to_vec(),
    })
}

/// Residuals as a function of the parameters alone.
struct Function<'a, F> {
    residuals: &'a F,
    ranges: Vec<Range>,
}

/// Parameters without finite residuals.
struct NotFinite;

impl<F: Fn(&[f64]) -> Vec<f64> + Sync> Problem for Function<'_, F> {
    type State = ();
    type Error = NotFinite;

    fn ranges(&self) -> &[Range] {
        &self.ranges
    }

    fn at(&self, values: &[f64], _: &()) -> Result<Evaluation<()>, NotFinite> {
        let residual = DVector::from_vec((self.residuals)(values));
        let squares = residual.norm_squared();
        if !squares.is_finite() {
            return Err(NotFinite);
        }
        Ok(Evaluation { values: values.to_vec(), state: (), residual, squares })
    }

    /// By central differences.
    fn derivatives(&self, point: &Evaluation<()>) -> Result<DMatrix<f64>, NotFinite> {
        let columns: Vec<DVector<f64>> = (0..point.values.len())
            .into_par_iter()
            .map(|index| {
                let at = |shift: f64| {
                    let mut shifted = point.values.clone();
                    shifted[index] += shift;
                    DVector::from_vec((self.residuals)(&shifted))
                };
                (at(DIFFERENCE) - at(-DIFFERENCE)) / (2.0 * DIFFERENCE)
            })
            .collect();
        Ok(DMatrix::from_columns(&columns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Misra1a of the NIST reference datasets for nonlinear regression, from its first, far start.
    #[test]
    fn certified_values_and_deviations_of_a_reference_problem_are_found() {
        let x = [
            77.6, 114.9, 141.1, 190.8, 239.9, 289.0, 332.8, 378.4, 434.8, 477.3, 536.8, 593.1,
            689.1, 760.0,
        ];
        let y = [
            10.07, 14.73, 17.94, 23.93, 29.61, 35.18, 40.02, 44.82, 50.76, 55.05, 61.01, 66.40,
            75.47, 81.78,
        ];
        // b1 = 500 p0, b2 = 1e-4 p1
        let residuals = |p: &[f64]| -> Vec<f64> {
            x.iter()
                .zip(y)
                .map(|(x, y)| y - 500.0 * p[0] * (1.0 - (-1e-4 * p[1] * x).exp()))
                .collect()
        };
        let found = minimise(&[1.0, 1.0], &residuals).unwrap();
        let certified =
            [2.389_421_291_8e2, 5.501_564_318_1e-4, 2.707_007_524_1, 7.266_868_846_4e-6];
        let variance = found.cost / 12.0;
        let deviation = |k: usize| (found.covariance[(k, k)] * variance).sqrt();
        let values = [
            500.0 * found.parameters[0],
            1e-4 * found.parameters[1],
            500.0 * deviation(0),
            1e-4 * deviation(1),
        ];
        for (value, certified) in values.iter().zip(certified) {
            assert!((value / certified - 1.0).abs() < 1e-4, "{values:?}");
        }
    }

    #[test]
    fn what_the_data_do_not_determine_is_said() {
        let residuals = |p: &[f64]| vec![p[0] + p[1] - 1.0, 2.0 * (p[0] + p[1]) - 2.5];
        assert!(matches!(
            minimise(&[0.3, 0.3], &residuals),
            Err(FitError::Singular { parameters: 2 })
        ));
        assert_eq!(minimise(&[0.0], &|_: &[f64]| vec![f64::NAN]).unwrap_err(), FitError::Start);
    }
}
