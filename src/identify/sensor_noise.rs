//! How far the sensors' noise moves the parameters that a fit finds.
//!
//! Guides and effects are driven along the motion as it was measured: what noise does there is neither white nor does it cancel, a bristle
//! remembers it and |v| rectifies it. Its effect is measured: the record once more with as much noise again, and what that moves
//! (simulation-extrapolation: Cook, Stefanski, JASA 89, 1994).

use nalgebra::DVector;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use rayon::prelude::*;

use super::driven::Driven;
use super::fit::{Fitted, inverse_where_known};
use super::hypothesis::Sides;
use super::measured::Measured;
use super::objective::{derivatives, stacked};
use crate::model::ModelError;

/// Records with noise added, each with its opposite, so that what is linear in the noise is in their difference and a shift in their sum.
const PAIRS: u64 = 8;

/// The same fit, with the deviations of its coordinates as large as the spread that the noise of the sensors gives them, and with the shift
/// that it gives them on top.
pub(super) fn widened(mut fitted: Fitted, measured: &Measured) -> Result<Fitted, ModelError> {
    let hypothesis = &fitted.hypothesis;
    let noise = hypothesis.floor(measured).carriage;
    let free: Vec<usize> =
        (0..fitted.coordinates.len()).filter(|index| fitted.deviations[*index].is_finite()).collect();
    if free.is_empty() {
        return Ok(fitted);
    }
    let driven = hypothesis.driven(measured, Sides::BOTH, &Driven::default())?;
    let residual = |measured: &Measured, driven: &Driven| {
        stacked(&hypothesis.missing_of(driven, measured, Sides::BOTH), &fitted.coordinates, noise)
    };
    let here = residual(measured, &driven);
    let columns = derivatives(hypothesis, &fitted.coordinates, &driven, measured, Sides::BOTH, &here, noise)?
        .select_columns(free.iter());
    let (inverse, _) = inverse_where_known(&columns.tr_mul(&columns));
    let moved_by = |seed: u64, sign: f64| -> Result<DVector<f64>, ModelError> {
        let declared = hypothesis.declared();
        let mut of_encoder = ChaCha8Rng::seed_from_u64(2 * seed);
        let mut of_cell = ChaCha8Rng::seed_from_u64(2 * seed + 1);
        let draw = |random: &mut ChaCha8Rng| -> f64 { StandardNormal.sample(random) };
        let noisy = measured.with_noise(
            || sign * measured.noise * draw(&mut of_encoder),
            || sign * declared.force_cell.noise * draw(&mut of_cell),
            declared.mass,
        );
        let there = residual(&noisy, &hypothesis.driven(&noisy, Sides::BOTH, &Driven::default())?);
        Ok(-(&inverse * columns.tr_mul(&(there - &here))))
    };
    let moved = (0..PAIRS)
        .into_par_iter()
        .map(|seed| Ok((moved_by(seed, 1.0)?, moved_by(seed, -1.0)?)))
        .collect::<Result<Vec<_>, ModelError>>()?;
    for (row, index) in free.iter().enumerate() {
        let mean = |of: &dyn Fn(f64, f64) -> f64| {
            moved.iter().map(|(there, opposite)| of(there[row], opposite[row])).sum::<f64>() / PAIRS as f64
        };
        let shift = mean(&|there, opposite| 0.5 * (there + opposite));
        let spread = mean(&|there, opposite| (0.5 * (there - opposite)).powi(2));
        let scale = fitted.coordinates[*index].scale;
        let variance = (fitted.deviations[*index] / scale).powi(2).max(spread) + shift * shift;
        fitted.deviations[*index] = variance.sqrt() * scale;
    }
    Ok(fitted)
}

#[cfg(test)]
mod tests {
    use super::super::closed_loop::tests::recording;
    use super::super::{Coordinate, Declared, Effort, Hypothesis, Place, Tolerances, fit};
    use super::*;
    use crate::TWO_SIDED_95;
    use crate::model::StageModel;

    /// Bristles follow what a noisy encoder feigns: static friction comes out too large, in each record a little, and together by more than their
    /// intervals allow.
    #[test]
    fn intervals_hold_what_a_noisy_encoder_shifts() {
        let mut model = StageModel::default();
        model.encoder.noise = 10e-9;
        let records = 8u32;
        let (mut narrow, mut wide) = (0.0, 0.0);
        for seed in 0..u64::from(records) {
            let measured = Measured::new(&recording(&model, seed, 0.0, 6), &model, "noisy").unwrap();
            let hypothesis = Hypothesis::new(&model, Tolerances::default()).unwrap();
            let fitted = fit(&hypothesis, &measured, Sides::BOTH, Effort::KEPT).unwrap();
            let widened = widened(fitted.clone(), &measured).unwrap();
            let of_static_force = |one: &Coordinate| one.place == Place::Declared(Declared::StaticForce);
            let index = fitted.coordinates.iter().position(of_static_force).unwrap();
            // What is declared is true: nothing has to move.
            let off = fitted.coordinates[index].value / f64::from(records).sqrt();
            narrow += off / fitted.deviations[index];
            wide += off / widened.deviations[index];
        }
        assert!(narrow > 4.0 && wide < TWO_SIDED_95, "{narrow} and {wide} deviations of the mean");
    }
}
