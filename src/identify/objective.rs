//! What a fit makes small: the missing force and how far the declared parameters are from what is declared, and its derivatives.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

use super::declared::Declared;
use super::driven::{Driven, FrictionOfEach};
use super::hypothesis::{Coordinate, Hypothesis, Missing, Place, SPREAD, Sides};
use super::knot_slopes::KnotSlopes;
use super::measured::Measured;
use crate::model::{MAX_GUIDES, ModelError};

/// Step of the difference quotients, in scales of the coordinates.
const DIFFERENCE: f64 = 1e-4;
/// Pieces of the rows that cores share, and rows of a block: as many as stay in the cache.
const PIECES: usize = 8;
const BLOCK: usize = 256;

/// The missing force of both sides and, for each declared parameter, how far it is from its declared value: a row of one standard
/// deviation of the noise per standard deviation of the tolerance, taken as a uniform distribution. It decides only where the data do
/// not: a payload against the mass itself, a difference between guides that no motion shows.
pub(super) fn stacked(missing: &Missing, coordinates: &[Coordinate], noise: f64) -> DVector<f64> {
    let declared =
        coordinates.iter().map(|coordinate| expectation(coordinate, noise) * coordinate.value / coordinate.scale);
    DVector::from_iterator(
        missing.motor.len() + missing.carriage.len() + coordinates.len(),
        missing.motor.iter().chain(&missing.carriage).copied().chain(declared),
    )
}

/// Weight of a declared parameter's distance from its declared value, N per scale; 0 for what nobody declared.
fn expectation(coordinate: &Coordinate, noise: f64) -> f64 {
    match coordinate.place {
        Place::Declared(_) | Place::Spread { .. } => 3f64.sqrt() * noise,
        Place::Effect { .. } => 0.0,
    }
}

/// Step of a difference quotient, backward at the upper bound.
pub(super) fn step_of(coordinate: &Coordinate) -> f64 {
    let step = DIFFERENCE * coordinate.scale;
    if coordinate.value + step > coordinate.bounds.1 { -step } else { step }
}

/// Derivatives of the residual by the scaled coordinates, by difference quotients.
pub(super) fn derivatives(
    hypothesis: &Hypothesis,
    coordinates: &[Coordinate],
    driven: &Driven,
    measured: &Measured,
    sides: Sides,
    residual: &DVector<f64>,
    noise: f64,
) -> Result<DMatrix<f64>, ModelError> {
    let of_guides = GuideSlopes::new(hypothesis, coordinates, driven, measured)?;
    let of_knots = KnotSlopes::new(hypothesis, coordinates, driven, measured)?;
    let columns = coordinates
        .par_iter()
        .enumerate()
        .map(|(index, coordinate)| {
            let of_knot = of_knots.as_ref().and_then(|slopes| slopes.of(index)).cloned();
            if let Some(carriage) = of_knot.or_else(|| of_guides.as_ref()?.along(coordinate)) {
                let mut column = DVector::zeros(residual.len());
                let declared = residual.len() - coordinates.len();
                column.rows_mut(declared - carriage.len(), carriage.len()).copy_from(&carriage);
                column[declared + index] = expectation(coordinate, noise);
                return Ok(column);
            }
            let step = step_of(coordinate);
            let quotient = |step: f64| -> Result<DVector<f64>, ModelError> {
                let mut moved = hypothesis.clone();
                moved.set(coordinate.place, coordinate.value + step);
                let mut there = coordinates.to_vec();
                there[index].value += step;
                let missing = moved.missing_of(&moved.driven(measured, sides, driven)?, measured, sides);
                Ok((stacked(&missing, &there, noise) - residual) * (coordinate.scale / step))
            };
            // Some values are possible only together: then the other direction is, or none.
            Ok(quotient(step).or_else(|_| quotient(-step)).unwrap_or_else(|_| DVector::zeros(residual.len())))
        })
        .collect::<Result<Vec<_>, ModelError>>()?;
    if columns.is_empty() {
        return Ok(DMatrix::zeros(residual.len(), 0));
    }
    Ok(DMatrix::from_columns(&columns))
}

/// J^T J, on all cores. Knots of a curve act on few rows each: blocks of a column that are all zero are passed over.
pub(super) fn normal_of(jacobian: &DMatrix<f64>) -> DMatrix<f64> {
    let (rows, count) = jacobian.shape();
    // Of so many pieces, not one for each core: the sum must not hang on the machine.
    let pieces: Vec<DMatrix<f64>> = (0..PIECES)
        .into_par_iter()
        .map(|piece| {
            let mut normal = DMatrix::zeros(count, count);
            let (start, end) = (piece * rows / PIECES, (piece + 1) * rows / PIECES);
            for from in (start..end).step_by(BLOCK) {
                let block = jacobian.rows(from, BLOCK.min(end - from));
                let columns = block.column_iter().enumerate();
                let acting: Vec<_> = columns.filter(|(_, column)| column.iter().any(|value| *value != 0.0)).collect();
                for (place, (row, one)) in acting.iter().enumerate() {
                    for (column, other) in &acting[..=place] {
                        normal[(*row, *column)] += one.dot(other);
                    }
                }
            }
            normal
        })
        .collect();
    let mut normal = pieces.into_iter().fold(DMatrix::zeros(count, count), |sum, piece| sum + piece);
    normal.fill_upper_triangle_with_lower_triangle();
    normal
}

/// How the missing force changes with the parameters of each guide alone.
///
/// Along a measured motion guides know nothing of each other. One pass moves a parameter of all of them, the friction of each tells its own part, and
/// every difference between guides is a sum of these: five passes in place of sixteen. Left out is that they share the force which they
/// hold as a record starts, a matter of its first micrometres, and when each does the work that a viscous friction feels.
struct GuideSlopes {
    /// N per unit at the rows, by parameter and guide.
    slopes: Vec<(Declared, Vec<DVector<f64>>)>,
}

impl GuideSlopes {
    /// `None` where guides are not moved apart.
    fn new(
        hypothesis: &Hypothesis,
        coordinates: &[Coordinate],
        driven: &Driven,
        measured: &Measured,
    ) -> Result<Option<GuideSlopes>, ModelError> {
        if !coordinates.iter().any(|coordinate| matches!(coordinate.place, Place::Spread { .. })) {
            return Ok(None);
        }
        // The guides as they are, then with one parameter of all of them a step further.
        let mut passes = vec![hypothesis.guides()];
        let mut steps = Vec::new();
        for parameter in SPREAD {
            let place = Place::Declared(parameter);
            let Some(coordinate) = coordinates.iter().find(|coordinate| coordinate.place == place) else {
                return Ok(None);
            };
            let step = DIFFERENCE * coordinate.scale;
            let mut moved = hypothesis.clone();
            moved.set(place, coordinate.value + step);
            passes.push(moved.guides());
            steps.push((parameter, step));
        }
        let at_rows = passes.par_iter().map(|guides| -> Result<Option<Vec<DVector<f64>>>, ModelError> {
            let Some(FrictionOfEach { bristles, felt }) = driven.friction_of_each(guides, measured)? else {
                return Ok(None);
            };
            let at_rows = |friction| DVector::from_vec(driven.at_rows(friction, measured));
            Ok(Some(bristles.into_iter().chain((!felt.is_empty()).then_some(felt)).map(at_rows).collect()))
        });
        let Some(at_rows) = at_rows.collect::<Result<Option<Vec<_>>, ModelError>>()? else { return Ok(None) };
        let velocity = DVector::from_vec(measured.at_rows(&measured.velocity));
        let slopes = steps.into_iter().zip(&at_rows[1..]).map(|((parameter, step), there)| {
            let slopes = there.iter().zip(&at_rows[0]).map(|(there, here)| (there - here) / step);
            let mut of_guides: Vec<DVector<f64>> = slopes.collect();
            // What is felt is felt of each guide by the work that it does.
            if let Some(felt) = (of_guides.len() > MAX_GUIDES).then(|| of_guides.pop()).flatten() {
                let works: Vec<f64> = of_guides.iter().map(|slope| slope.dot(&velocity)).collect();
                let all: f64 = works.iter().sum();
                for (slope, work) in of_guides.iter_mut().zip(works).filter(|(_, work)| *work != 0.0) {
                    slope.axpy(work / all, &felt, 1.0);
                }
            }
            (parameter, of_guides)
        });
        let slopes = slopes.collect();
        Ok(Some(GuideSlopes { slopes }))
    }

    /// Along a coordinate, N per scale; `None` where it moves no such parameter.
    fn along(&self, coordinate: &Coordinate) -> Option<DVector<f64>> {
        let (parameter, shares) = coordinate.place.of_guides()?;
        let (_, slopes) = self.slopes.iter().find(|(declared, _)| *declared == parameter)?;
        let terms = slopes.iter().zip(shares).map(|(slope, share)| slope * (share * coordinate.scale));
        terms.reduce(|sum, term| sum + term)
    }
}

#[cfg(test)]
mod tests {
    use super::super::driven::tests::{hypothesis, record};
    use super::*;

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
                moved.set(there[index].place, there[index].value);
                stacked(&moved.missing(&measured, Sides::BOTH).unwrap(), &there, 0.05)
            };
            let here = residual_at(0, 0.0);
            let all = derivatives(&start, &coordinates, &driven, &measured, Sides::BOTH, &here, 0.05).unwrap();
            for (index, coordinate) in coordinates.iter().enumerate() {
                let expected = (residual_at(index, 1e-4) - residual_at(index, -1e-4)) / 2e-4;
                let off = (all.column(index) - &expected).norm() / expected.norm();
                // Forward differences are off by the curvature: seen up to 3e-3.
                assert!(off < 1e-2, "{laws:?}, {:?}: {off:e} of {}", coordinate.place, expected.norm());
            }
        }
    }
}
