//! What a fit makes small: the missing force and how far the declared parameters are from what is
//! declared, and its derivatives.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use crate::fit::difference::step_of;
use crate::fit::guide_sensitivities::guide_sensitivities;
use crate::fit::knot_sensitivities::knot_sensitivities;
use crate::hypothesis::{FreeParameter, Hypothesis, ParameterId, Sides};
use crate::record::measured::Measured;
use crate::residual::driven::Driven;
use crate::residual::missing::Missing;
use friction_stage_core::model::ModelError;

/// Pieces of the rows that cores share, and rows of a block: as many as stay in the cache.
const PIECES: usize = 8;
const BLOCK: usize = 256;

/// The missing force of both sides and, for each declared parameter, how far it is from its
/// declared value: a row of one standard deviation of the noise per standard deviation of the
/// tolerance, taken as a uniform distribution. It decides only where the data do not: a payload
/// against the mass itself, a difference between guides that no motion shows.
pub(crate) fn stacked(
    missing: &Missing,
    coordinates: &[FreeParameter],
    noise: f64,
) -> DVector<f64> {
    let declared = coordinates
        .iter()
        .map(|coordinate| expectation(coordinate, noise) * coordinate.value / coordinate.scale);
    DVector::from_iterator(
        missing.motor.len() + missing.carriage.len() + coordinates.len(),
        missing.motor.iter().chain(&missing.carriage).copied().chain(declared),
    )
}

/// Weight of a declared parameter's distance from its declared value, N per scale; 0 for what
/// was not declared.
fn expectation(coordinate: &FreeParameter, noise: f64) -> f64 {
    match coordinate.id {
        ParameterId::Nominal(_) | ParameterId::Spread { .. } => 3f64.sqrt() * noise,
        ParameterId::Effect { .. } => 0.0,
    }
}

/// Derivatives of the residual by the scaled coordinates, by difference quotients.
pub(crate) fn derivatives(
    hypothesis: &Hypothesis,
    coordinates: &[FreeParameter],
    driven: &Driven,
    measured: &Measured,
    sides: Sides,
    residual: &DVector<f64>,
    noise: f64,
) -> Result<DMatrix<f64>, ModelError> {
    let mut of_carriage = knot_sensitivities(hypothesis, coordinates, driven, measured);
    let (of_guides, others): (Vec<usize>, Vec<usize>) = (0..coordinates.len())
        .filter(|index| !of_carriage.contains_key(index))
        .partition(|index| coordinates[*index].id.of_bristles().is_some());
    let column = |index: usize| -> Result<DVector<f64>, ModelError> {
        let coordinate = &coordinates[index];
        let step = step_of(coordinate);
        let quotient = |step: f64| -> Result<DVector<f64>, ModelError> {
            let mut moved = hypothesis.clone();
            moved.set(coordinate.id, coordinate.value + step);
            let mut there = coordinates.to_vec();
            there[index].value += step;
            let missing =
                moved.missing_of(&moved.driven(measured, sides, driven)?, measured, sides);
            Ok((stacked(&missing, &there, noise) - residual) * (coordinate.scale / step))
        };
        // Some values are possible only together: then the other direction is, or none.
        Ok(quotient(step)
            .or_else(|_| quotient(-step))
            .unwrap_or_else(|_| DVector::zeros(residual.len())))
    };
    let (of_guides, others) = rayon::join(
        || guide_sensitivities(hypothesis, coordinates, &of_guides, driven, measured),
        || {
            others
                .par_iter()
                .map(|index| Ok((*index, column(*index)?)))
                .collect::<Result<Vec<_>, ModelError>>()
        },
    );
    let mut derivatives = DMatrix::zeros(residual.len(), coordinates.len());
    for (index, column) in others? {
        derivatives.set_column(index, &column);
    }
    of_carriage.extend(of_guides?);
    let declared = residual.len() - coordinates.len();
    for (index, column) in of_carriage {
        derivatives
            .view_mut((declared - column.len(), index), (column.len(), 1))
            .copy_from(&column);
    }
    for (index, coordinate) in coordinates.iter().enumerate() {
        derivatives[(declared + index, index)] = expectation(coordinate, noise);
    }
    Ok(derivatives)
}

/// J^T J, on all cores. Knots of a curve act on few rows each: blocks of a column that are all zero
/// are passed over.
pub(crate) fn normal_of(jacobian: &DMatrix<f64>) -> DMatrix<f64> {
    let (rows, count) = jacobian.shape();
    // Of so many pieces, not one for each core: the sum must not depend on the machine.
    let pieces: Vec<DMatrix<f64>> = (0..PIECES)
        .into_par_iter()
        .map(|piece| {
            let mut normal = DMatrix::zeros(count, count);
            let (start, end) = (piece * rows / PIECES, (piece + 1) * rows / PIECES);
            for from in (start..end).step_by(BLOCK) {
                let block = jacobian.rows(from, BLOCK.min(end - from));
                let columns = block.column_iter().enumerate();
                let acting: Vec<_> = columns
                    .filter(|(_, column)| column.iter().any(|value| *value != 0.0))
                    .collect();
                for (place, (row, one)) in acting.iter().enumerate() {
                    for (column, other) in &acting[..=place] {
                        normal[(*row, *column)] += one.dot(other);
                    }
                }
            }
            normal
        })
        .collect();
    let mut normal =
        pieces.into_iter().fold(DMatrix::zeros(count, count), |sum, piece| sum + piece);
    normal.fill_upper_triangle_with_lower_triangle();
    normal
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_records::{hypothesis, record};

    /// Of 1003 rows: a full column, one of two blocks, one of zeros.
    #[test]
    fn the_normal_matrix_is_the_product_whatever_blocks_are_zero() {
        let jacobian = DMatrix::from_fn(1003, 3, |row, column| match column {
            0 => (0.7 * row as f64).sin(),
            1 if (300..700).contains(&row) => (0.3 * row as f64).cos(),
            _ => 0.0,
        });
        let expected = jacobian.transpose() * &jacobian;
        assert!((normal_of(&jacobian) - &expected).norm() < 1e-12 * expected.norm());
    }

    /// Each column against the symmetric difference quotient of the whole residual.
    #[test]
    fn every_derivative_is_the_difference_of_the_residual() {
        let measured = record();
        let laws: [&[(&str, &[f64])]; 5] = [
            // Pieces of 0.18 m of the 0.4 m that are travelled.
            &[("ball_passage", &[0.5, 9e-3, 0.0, 0.0, 0.0, 1.0]), ("cogging", &[1.0, 0.0093, 0.0])],
            &[("force_cell_gain", &[0.01])],
            &[("asymmetric_friction", &[0.1, 0.05]), ("encoder_scale", &[0.02])],
            &[("distributed_bristles", &[0.45, 0.04, 0.3, 0.16, 0.15, 0.3, 1.8, 0.0])],
            // By work: what one guide does warms all of them.
            &[("viscous_warm_up", &[0.3, 1.0, 20.0, 3.0, 10.0, 5.0])],
        ];
        for laws in laws {
            let start = hypothesis(laws).different_guides().unwrap();
            let coordinates = start.coordinates(Sides::BOTH, true);
            let driven = start.driven(&measured, Sides::BOTH, &Driven::default()).unwrap();
            let residual_at = |index: usize, step: f64| {
                let (mut moved, mut there) = (start.clone(), coordinates.clone());
                there[index].value += step * there[index].scale;
                moved.set(there[index].id, there[index].value);
                stacked(&moved.missing(&measured, Sides::BOTH).unwrap(), &there, 0.05)
            };
            let here = residual_at(0, 0.0);
            let all =
                derivatives(&start, &coordinates, &driven, &measured, Sides::BOTH, &here, 0.05)
                    .unwrap();
            for (index, coordinate) in coordinates.iter().enumerate() {
                let expected = (residual_at(index, 1e-4) - residual_at(index, -1e-4)) / 2e-4;
                let off = (all.column(index) - &expected).norm() / expected.norm();
                // Forward differences are off by the curvature: seen up to 3e-3.
                assert!(
                    off < 1e-2,
                    "{laws:?}, {:?}: {off:e} of {}",
                    coordinate.id,
                    expected.norm()
                );
            }
        }
    }
}
