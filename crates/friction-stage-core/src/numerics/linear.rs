//! Linear least squares with columns of length one: the units of the columns then do not decide
//! what is too close to tell apart.

use nalgebra::{DMatrix, DVector, SMatrix, SVector};

/// Pivot of scaled normal equations below which a column is the others to within this part of its
/// length.
const LEAST_PIVOT: f64 = 1e-6;

/// Most iterations of a decomposition, which needs some tens. Without a bound one of a matrix that
/// is not finite never ends.
pub const DECOMPOSITION: usize = 10_000;

/// Solves the normal equations `normal` x = `right`; `None` where a column is a sum of the others,
/// or zero.
pub fn solve_normal<const N: usize>(
    normal: &SMatrix<f64, N, N>,
    right: &SVector<f64, N>,
) -> Option<SVector<f64, N>> {
    let length = SVector::<f64, N>::from_fn(|index, _| normal[(index, index)].sqrt());
    if length.iter().any(|length| *length <= 0.0 || !length.is_finite()) {
        return None;
    }
    let scaled = SMatrix::<f64, N, N>::from_fn(|row, column| {
        normal[(row, column)] / (length[row] * length[column])
    });
    let cholesky = scaled.cholesky()?;
    if (0..N).any(|index| cholesky.l_dirty()[(index, index)] < LEAST_PIVOT) {
        return None;
    }
    Some(cholesky.solve(&right.component_div(&length)).component_div(&length))
}

/// The shortest x, in lengths of the columns, that leaves least of `matrix` x - `right`: directions
/// whose singular value is below `rank` times the largest one have no part in it. `None` where the
/// numbers are not finite.
pub fn least_norm(
    mut matrix: DMatrix<f64>,
    right: &DVector<f64>,
    rank: f64,
) -> Option<DVector<f64>> {
    let scales: Vec<f64> =
        matrix.column_iter().map(|column| column.norm().max(f64::MIN_POSITIVE)).collect();
    for (mut column, scale) in matrix.column_iter_mut().zip(&scales) {
        column /= *scale;
    }
    let decomposed = matrix.try_svd(true, true, 5.0 * f64::EPSILON, DECOMPOSITION)?;
    let tolerance = rank * decomposed.singular_values.max();
    let mut solution = decomposed.solve(right, tolerance).ok()?;
    solution.iter_mut().zip(&scales).for_each(|(value, scale)| *value /= scale);
    Some(solution)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_that_are_not_finite_have_no_solution() {
        for bad in [f64::NAN, f64::INFINITY, 1e308] {
            let columns =
                DMatrix::from_fn(
                    20,
                    3,
                    |row, column| if row == 7 { bad } else { (row + column) as f64 },
                );
            let right = DVector::from_element(20, 1.0);
            let found = least_norm(columns, &right, 1e-9);
            assert!(found.is_none_or(|found| bad == 1e308 && found.len() == 3));
        }
    }

    /// Columns in nanometres and in kilometres, and one that is their sum.
    #[test]
    fn units_do_not_decide_what_is_known() {
        let columns = DMatrix::from_fn(50, 3, |row, column| match column {
            0 => 1e-9 * (0.3 * row as f64).sin(),
            1 => 1e3 * (0.05 * row as f64).cos(),
            _ => 1e-9 * (0.3 * row as f64).sin() + 1e-9 * (0.05 * row as f64).cos(),
        });
        let right = columns.column(0) * 2.0 - columns.column(1) * 3e-12;
        let normal: SMatrix<f64, 3, 3> =
            (columns.transpose() * &columns).fixed_view::<3, 3>(0, 0).into();
        let products: SVector<f64, 3> = columns.tr_mul(&right).fixed_rows::<3>(0).into();
        assert!(solve_normal(&normal, &products).is_none());
        let two: SMatrix<f64, 2, 2> = normal.fixed_view::<2, 2>(0, 0).into();
        let found = solve_normal(&two, &products.fixed_rows::<2>(0).into()).unwrap();
        assert!((found[0] - 2.0).abs() < 1e-9 && (found[1] + 3e-12).abs() < 1e-21, "{found}");
        let shortest = least_norm(columns.clone(), &right, 1e-9).unwrap();
        assert!((&columns * shortest - &right).norm() < 1e-9 * right.norm());
    }
}
