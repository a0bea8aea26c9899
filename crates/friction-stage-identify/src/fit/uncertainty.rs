//! How well a record knows what was fitted to it: standard deviations and correlations of the
//! coordinates, from the derivatives and the residual.

use nalgebra::linalg::SymmetricEigen;
use nalgebra::{DMatrix, DMatrixView, DVector};

use crate::fit::objective::normal_of;
use crate::hypothesis::{FreeParameter, ParameterId};
use crate::residual::missing::Missing;
use friction_stage_core::numerics::correlation::correlation_length;
use friction_stage_core::numerics::linear;

/// Eigenvalue of the normal matrix with columns of length 1 below which the data say nothing about
/// a direction: derivatives by differences are no better than that.
const UNKNOWN: f64 = 1e-12;
/// Part of a coordinate in such a direction below which it is known all the same.
const HAS_NO_PART: f64 = 1e-3;
/// Pieces of a record that count as independent of each other: about a second each.
const PIECES: usize = 40;
/// Parts of a record, and parts of each of these, whose means tell a walk from noise.
const TENTHS: usize = 10;
/// How many times what noise makes of the differences of these means is a walk. Assumed: white
/// noise comes to it once in a few hundred records at most.
const WALKS: f64 = 4.0;

/// Standard deviations and correlations of the coordinates. Those on a bound are held, but what is
/// declared: how far that may be from what it says is known on its bound, too, and what the data do
/// not tell from it is known no better. A delay of the motor of which the time shift of the sensors
/// took 25 us had an interval of 0.1 us. Differences between the guides stay held: no answer names
/// them.
///
/// The covariance is H^-1 S H^-1 with the normal matrix H of the Jacobian and S the covariance of
/// the gradient: the larger, coordinate by coordinate, of two estimates. One takes the residual of
/// each side as noise of its own size and correlation length, and what wanders within the record as
/// a random walk on top. The other leaves out one piece of the record after the other (jackknife of
/// clusters: Bell, McCaffrey, Survey Methodology 28, 2002) and so counts what a model misses here
/// and there, also where few pieces say most about a coordinate; of a walk it sees little, since
/// its pieces are not independent.
pub(crate) fn uncertainty(
    jacobian: &DMatrix<f64>,
    residual: &DVector<f64>,
    missing: &Missing,
    coordinates: &[FreeParameter],
    at_bound: &[bool],
    noise: f64,
) -> (Vec<f64>, Vec<Vec<f64>>) {
    let count = coordinates.len();
    let mut deviations = vec![f64::INFINITY; count];
    let mut correlations = vec![vec![0.0; count]; count];
    let free = free_of(jacobian, coordinates, at_bound);
    if free.is_empty() || residual.is_empty() {
        return (deviations, correlations);
    }
    let columns = jacobian.select_columns(free.iter());
    let normal = normal_of(&columns);
    let (inverse, known) = inverse_where_known(&normal);

    let none = || DMatrix::zeros(free.len(), free.len());
    let mut pieces = vec![(none(), DVector::zeros(free.len())); PIECES];
    let mut from = 0;
    for side in [&missing.motor, &missing.carriage] {
        let rows = side.len();
        let sensitivities = columns.rows(from, rows);
        if rows > 0 {
            for (piece, (normal, gradient)) in pieces.iter_mut().enumerate() {
                let (start, end) = (piece * rows / PIECES, (piece + 1) * rows / PIECES);
                let sensitivities = sensitivities.rows(start, end - start);
                *normal += sensitivities.tr_mul(&sensitivities);
                *gradient += sensitivities.tr_mul(&residual.rows(from + start, end - start));
            }
        }
        from += rows;
    }
    let expected = columns.rows(from, coordinates.len());
    let expected = expected.tr_mul(&expected) * (noise * noise);
    let as_noise = by_noise(&columns, &inverse, missing, noise);
    let mut in_pieces = &inverse * expected * &inverse;
    for (of_piece, gradient) in &pieces {
        // How far the rest of the record would move the coordinates.
        let (without, _) = inverse_where_known(&(&normal - of_piece));
        let moved = without * gradient;
        in_pieces += &moved * moved.transpose() * ((PIECES - 1) as f64 / PIECES as f64);
    }
    for (row, index) in free.iter().enumerate().filter(|(row, _)| known[*row]) {
        let variance = as_noise[(row, row)].max(in_pieces[(row, row)]);
        deviations[*index] = variance.sqrt() * coordinates[*index].scale;
        for (column, other) in free.iter().enumerate().filter(|(column, _)| known[*column]) {
            correlations[*index][*other] =
                inverse[(row, column)] / (inverse[(row, row)] * inverse[(column, column)]).sqrt();
        }
    }
    (deviations, correlations)
}

/// Indices of the coordinates that a record can say something about: those on a bound are held, but
/// what is declared. What does not move the residual at all is not known, and must not hide what
/// the data say about the others.
fn free_of(
    jacobian: &DMatrix<f64>,
    coordinates: &[FreeParameter],
    at_bound: &[bool],
) -> Vec<usize> {
    let most = jacobian.column_iter().map(|column| column.norm()).fold(0.0, f64::max);
    let is_held =
        |index: usize| at_bound[index] && !matches!(coordinates[index].id, ParameterId::Nominal(_));
    (0..coordinates.len())
        .filter(|index| !is_held(*index) && jacobian.column(*index).norm() > 1e-9 * most)
        .collect()
}

/// Covariance of the free coordinates, in the units of a fit, where the residual of each side is
/// noise of its own size and correlation length.
fn by_noise(
    columns: &DMatrix<f64>,
    inverse: &DMatrix<f64>,
    missing: &Missing,
    noise: f64,
) -> DMatrix<f64> {
    let mut gradient = DMatrix::zeros(columns.ncols(), columns.ncols());
    let mut from = 0;
    for side in [&missing.motor, &missing.carriage] {
        let rows = side.len();
        if rows > 0 {
            let sensitivities = columns.rows(from, rows);
            let variance = side.iter().map(|left| left * left).sum::<f64>() / rows as f64
                * correlation_length(side);
            gradient += sensitivities.tr_mul(&sensitivities) * variance;
            gradient += gradient_of_walk(sensitivities, walk(side));
        }
        from += rows;
    }
    let expected = columns.rows(from, columns.nrows() - from);
    gradient += expected.tr_mul(&expected) * (noise * noise);
    inverse * gradient * inverse
}

/// Covariance of all coordinates, in the units of a fit, as far as it is by noise and tolerances.
/// What is held, or nothing is known of, has none.
pub(crate) fn covariance_by_noise(
    jacobian: &DMatrix<f64>,
    missing: &Missing,
    coordinates: &[FreeParameter],
    at_bound: &[bool],
    noise: f64,
) -> DMatrix<f64> {
    let mut covariance = DMatrix::zeros(coordinates.len(), coordinates.len());
    let free = free_of(jacobian, coordinates, at_bound);
    if free.is_empty() {
        return covariance;
    }
    let columns = jacobian.select_columns(free.iter());
    let (inverse, _) = inverse_where_known(&normal_of(&columns));
    let of_free = by_noise(&columns, &inverse, missing, noise);
    for (row, index) in free.iter().enumerate() {
        for (column, other) in free.iter().enumerate() {
            covariance[(*index, *other)] = of_free[(row, column)];
        }
    }
    covariance
}

/// Inverse of a normal matrix without the directions in which the data say nothing, and which
/// coordinates have no part in these.
pub(crate) fn inverse_where_known(normal: &DMatrix<f64>) -> (DMatrix<f64>, Vec<bool>) {
    let count = normal.nrows();
    // Columns of length 1, so that the eigenvalues are those of correlations.
    let length: Vec<f64> = normal.diagonal().iter().map(|square| square.sqrt()).collect();
    let scaled = DMatrix::from_fn(count, count, |row, column| {
        normal[(row, column)] / (length[row] * length[column])
    });
    let (mut inverse, mut known) = (DMatrix::zeros(count, count), vec![true; count]);
    let Some(eigen) = SymmetricEigen::try_new(scaled, f64::EPSILON, linear::DECOMPOSITION) else {
        // Numbers that are not finite: nothing is known.
        return (inverse, vec![false; count]);
    };
    for (value, direction) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value > UNKNOWN {
            inverse += direction * direction.transpose() / *value;
        } else {
            for (known, part) in known.iter_mut().zip(direction.iter()) {
                *known &= part.abs() < HAS_NO_PART;
            }
        }
    }
    (
        DMatrix::from_fn(count, count, |row, column| {
            inverse[(row, column)] / (length[row] * length[column])
        }),
        known,
    )
}

/// Variance by which a residual walks at random from one row to the next, N^2; 0 where its means
/// over tenths of the record differ no more than noise makes them, as the means over tenths of
/// these show that.
fn walk(residual: &[f64]) -> f64 {
    let rows = residual.len() / TENTHS;
    if rows < TENTHS {
        return 0.0;
    }
    // Mean square by which the means of neighbouring parts differ.
    let between = |rows: usize| {
        let means: Vec<f64> = residual
            .chunks_exact(rows)
            .map(|part| part.iter().sum::<f64>() / rows as f64)
            .collect();
        means.windows(2).map(|two| (two[1] - two[0]).powi(2)).sum::<f64>()
            / (means.len() - 1) as f64
    };
    let by_noise = between(rows / TENTHS) * (rows / TENTHS) as f64;
    if between(rows) * rows as f64 <= WALKS * by_noise {
        return 0.0;
    }
    // The means of neighbouring parts of a walk differ by two thirds of what it walks over one. The
    // fit has taken its slowest part.
    let walks = |rows: usize| 1.5 * (between(rows) - by_noise / rows as f64) / rows as f64;
    walks(rows).max(walks(residual.len() / PIECES))
}

/// Covariance of the gradient by a residual that walks by this variance from row to row: a step of
/// it is in all rows behind.
fn gradient_of_walk(sensitivities: DMatrixView<f64>, variance: f64) -> DMatrix<f64> {
    let count = sensitivities.ncols();
    let mut sum = DMatrix::zeros(count, count);
    if variance <= 0.0 {
        return sum;
    }
    let mut behind = DVector::zeros(count);
    for row in (0..sensitivities.nrows()).rev() {
        behind
            .iter_mut()
            .zip(sensitivities.row(row).iter())
            .for_each(|(sum, sensitivity)| *sum += sensitivity);
        sum.ger(variance, &behind, &behind, 1.0);
    }
    sum
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;
    use crate::NominalParameter;

    #[test]
    fn two_coordinates_that_do_the_same_are_unknown_and_the_third_is_known() {
        // Columns (1, 0), (0, 3) and (0, 3): the sum of the last two is known, each of them is not.
        let columns = DMatrix::from_row_slice(2, 3, &[1.0, 0.0, 0.0, 0.0, 3.0, 3.0]);
        let (inverse, known) = inverse_where_known(&columns.tr_mul(&columns));
        assert_eq!(known, [true, false, false]);
        assert!((inverse[(0, 0)] - 1.0).abs() < 1e-12, "{inverse}");
        let sum = DVector::from_column_slice(&[0.0, 1.0, 1.0]);
        assert!((sum.dot(&(&inverse * &sum)) - 1.0 / 9.0).abs() < 1e-12, "{inverse}");
    }

    #[test]
    fn where_everything_is_known_it_is_the_inverse() {
        let normal = DMatrix::from_row_slice(2, 2, &[4e6, 1e-3, 1e-3, 2e-9]);
        let (inverse, known) = inverse_where_known(&normal);
        assert_eq!(known, [true, true]);
        let unit = &normal * &inverse;
        assert!((unit - DMatrix::identity(2, 2)).amax() < 1e-6, "{inverse}");
    }

    /// Two coordinates that do the same, the second on its bound, in 400 rows of white noise of 1
    /// N. Declared, that may be elsewhere within its tolerance, uniform over twice its scale, and
    /// the first is known no better; what was not declared is held, and the first is known as if it
    /// were alone.
    #[test]
    fn what_is_declared_may_be_off_its_bound() {
        let rows = 400;
        let noise = wandering(0.0, 1)[..rows].to_vec();
        let coordinate =
            |place| FreeParameter { id: place, value: 1.0, scale: 1.0, bounds: (-1.0, 1.0) };
        let effect = |value| ParameterId::Effect { effect: 0, value };
        for (place, weight, expected) in [
            (ParameterId::Nominal(NominalParameter::SensorShift), 3f64.sqrt(), 3f64.sqrt().recip()),
            (effect(1), 0.0, 0.05),
        ] {
            let jacobian = DMatrix::from_fn(rows + 2, 2, |row, column| match (row, column) {
                _ if row < rows => 1.0,
                _ if (row - rows, column) == (1, 1) => weight,
                _ => 0.0,
            });
            let residual =
                DVector::from_iterator(rows + 2, noise.iter().copied().chain([0.0, weight]));
            let missing = Missing { motor: Vec::new(), carriage: noise.clone() };
            let coordinates = [coordinate(effect(0)), coordinate(place)];
            let (deviations, _) =
                uncertainty(&jacobian, &residual, &missing, &coordinates, &[false, true], 1.0);
            // From 40 pieces, which scatter.
            assert!(
                (deviations[0] / expected - 1.0).abs() < 0.4,
                "{place:?}: {deviations:?}, {expected}"
            );
        }
    }

    /// White noise of 1 N, and on top a walk of this size from row to row.
    fn wandering(size: f64, seed: u64) -> Vec<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut walk = 0.0;
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let mut value = || {
            walk += size * normal();
            walk + normal()
        };
        (0..4000).map(|_| value()).collect()
    }

    #[test]
    fn what_walks_is_told_from_noise() {
        let of = |size: f64| (0..400).map(move |seed| walk(&wandering(size, seed)));
        assert!(of(0.0).filter(|variance| *variance > 0.0).count() <= 2);
        // Over a tenth of the record the walk of 0.02 goes as far as 160 such values scatter:
        // hardly seen, and at 0.2 always.
        assert!(of(0.02).filter(|variance| *variance > 0.0).count() > 360);
        // The larger of two estimates.
        let seen = of(0.2).sum::<f64>() / 400.0 / 0.04;
        assert!((1.0..1.2).contains(&seen), "{seen}");
    }

    /// What repeats with the moves, four times and more in a tenth of the record, is no walk.
    #[test]
    fn what_repeats_does_not_walk() {
        for period in [7.3, 31.0, 97.0] {
            let wave: Vec<f64> =
                (0..4000).map(|row| (row as f64 * std::f64::consts::TAU / period).sin()).collect();
            assert!(walk(&wave) * 4000.0 < 0.05, "{period}: {}", walk(&wave));
        }
    }

    /// The slope of a line through a walk of size q over n rows scatters by q sqrt(6 / (5 n)):
    /// least squares, whose residual hides most of it.
    #[test]
    fn a_line_through_a_walk_is_as_uncertain_as_a_walk_makes_it() {
        let rows = 4000;
        let line =
            DMatrix::from_fn(rows, 2, |row, column| if column == 0 { 1.0 } else { row as f64 });
        let inverse = line.tr_mul(&line).try_inverse().unwrap();
        let covariance = &inverse * gradient_of_walk(line.as_view(), 0.04) * &inverse;
        let expected = 0.04 * 6.0 / (5.0 * rows as f64);
        assert!(
            (covariance[(1, 1)] / expected - 1.0).abs() < 1e-2,
            "{} {expected}",
            covariance[(1, 1)]
        );
    }
}
