//! Nonlinear least squares by Levenberg and Marquardt for a few parameters and many residuals.
//!
//! The published library of that name asks for another release of the matrix library than the rest
//! of the program; what is needed here is the damped normal equations, which scaled parameters keep
//! well conditioned.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Where the search ended.
#[derive(Clone, Debug)]
pub struct Minimum {
    pub parameters: Vec<f64>,
    /// Sum of the squared residuals.
    pub cost: f64,
    /// Inverse of J'J at the minimum: times the variance of a residual, the covariance of the
    /// parameters.
    pub covariance: DMatrix<f64>,
    pub residuals: Vec<f64>,
}

/// A search without a result.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FitError {
    #[error("the residuals are not finite at the start of the search")]
    Start,
    #[error("the data do not determine all {parameters} parameters (J'J is singular)")]
    Singular { parameters: usize },
    #[error("the search did not end within {iterations} iterations")]
    Unfinished { iterations: usize },
}

/// Most iterations. Assumed: searches that start near end within twenty.
const ITERATIONS: usize = 100;
/// Relative fall of the cost below which the search is at its end.
const TOLERANCE: f64 = 1e-10;
/// Step of the central differences, of parameters that are of the order of one.
const DIFFERENCE: f64 = 1e-5;

/// Minimises the sum of squares from `start` on; parameters should be of the order of one, or
/// logarithms.
pub fn minimise(
    start: &[f64],
    residuals: &(impl Fn(&[f64]) -> Vec<f64> + Sync),
) -> Result<Minimum, FitError> {
    let count = start.len();
    let mut parameters = start.to_vec();
    let mut found = residuals(&parameters);
    let mut cost = squared(&found);
    if !cost.is_finite() {
        return Err(FitError::Start);
    }
    let mut damping = 1e-3;
    for _ in 0..ITERATIONS {
        let (normal, gradient) = normal_equations(&parameters, &found, residuals);
        let mut fell = None;
        while damping < 1e12 {
            let mut damped = normal.clone();
            for k in 0..count {
                damped[(k, k)] += damping * normal[(k, k)].max(f64::MIN_POSITIVE);
            }
            let step = damped.cholesky().map(|factor| factor.solve(&gradient));
            if let Some(step) = step.filter(|step| step.iter().all(|part| part.is_finite())) {
                let next: Vec<f64> =
                    parameters.iter().zip(step.iter()).map(|(value, part)| value - part).collect();
                let there = residuals(&next);
                let next_cost = squared(&there);
                if next_cost <= cost {
                    fell = Some(cost - next_cost);
                    (parameters, found, cost) = (next, there, next_cost);
                    damping = (damping * 0.1).max(1e-12);
                    break;
                }
            }
            damping *= 10.0;
        }
        if fell.is_none_or(|fall| fall <= TOLERANCE * cost) {
            let (normal, _) = normal_equations(&parameters, &found, residuals);
            let covariance = normal
                .cholesky()
                .map(|factor| factor.inverse())
                .filter(|inverse| inverse.iter().all(|value| value.is_finite()))
                .ok_or(FitError::Singular { parameters: count })?;
            return Ok(Minimum { parameters, cost, covariance, residuals: found });
        }
    }
    Err(FitError::Unfinished { iterations: ITERATIONS })
}

fn squared(residuals: &[f64]) -> f64 {
    residuals.iter().map(|residual| residual * residual).sum()
}

/// J'J and J'r by central differences.
fn normal_equations(
    parameters: &[f64],
    found: &[f64],
    residuals: &(impl Fn(&[f64]) -> Vec<f64> + Sync),
) -> (DMatrix<f64>, DVector<f64>) {
    let count = parameters.len();
    let columns: Vec<Vec<f64>> = (0..count)
        .into_par_iter()
        .map(|k| {
            let at = |shift: f64| {
                let mut shifted = parameters.to_vec();
                shifted[k] += shift;
                residuals(&shifted)
            };
            let (above, below) = (at(DIFFERENCE), at(-DIFFERENCE));
            above.iter().zip(&below).map(|(a, b)| (a - b) / (2.0 * DIFFERENCE)).collect()
        })
        .collect();
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let normal =
        DMatrix::from_fn(count, count, |row, column| product(&columns[row], &columns[column]));
    let gradient = DVector::from_fn(count, |row, _| product(&columns[row], found));
    (normal, gradient)
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
