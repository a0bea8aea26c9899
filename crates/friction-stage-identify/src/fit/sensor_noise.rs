//! What the sensors' noise leaves of force, and how far it moves the parameters that a fit finds.
//!
//! Guides and effects are driven along the motion as it was measured: what noise does there is
//! neither white nor does it cancel, a bristle remembers it and |v| rectifies it. Its effect is
//! measured: the record once more with as much noise again, and what that moves
//! (simulation-extrapolation: Cook, Stefanski, JASA 89, 1994).

use nalgebra::{DMatrix, DVector};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::fit::Estimate;
use crate::fit::objective::{derivatives, stacked};
use crate::fit::uncertainty::inverse_where_known;
use crate::hypothesis::{Hypothesis, Sides};
use crate::record::measured::Measured;
use crate::residual::driven::Driven;
use friction_stage_core::model::ModelError;

/// Assumed: records with noise added, each with its opposite, so that what is linear in the noise
/// is in their difference and a shift in their sum.
const PAIRS: u64 = 8;
/// Assumed: pairs of which each record has its own derivatives, which are of the measured motion
/// too, and cost most.
const OWN_DERIVATIVES: u64 = 2;

/// Part by which noise may leave more than declared without a word: a record knows its noise to
/// some per cent. Assumed.
pub const MORE_THAN_DECLARED: f64 = 1.2;

/// The record with as much noise again, drawn from a seed: of the encoder as the record shows it,
/// of the cell no less than declared.
fn noisy(hypothesis: &Hypothesis, measured: &Measured, seed: u64, sign: f64) -> Measured {
    let declared = hypothesis.declared();
    let mut of_encoder = ChaCha8Rng::seed_from_u64(2 * seed);
    let mut of_cell = ChaCha8Rng::seed_from_u64(2 * seed + 1);
    let draw = |random: &mut ChaCha8Rng| -> f64 { StandardNormal.sample(random) };
    let cell_noise = declared.force_cell.noise.max(measured.cell_noise);
    measured.with_noise(
        || sign * measured.noise * draw(&mut of_encoder),
        || sign * cell_noise * draw(&mut of_cell),
        declared.mass,
    )
}

/// The same fit, with deviations at least as large as the spread that the noise of the sensors
/// gives its coordinates, and with the shifts that it gives them.
pub(crate) fn widened(mut estimate: Estimate, measured: &Measured) -> Result<Estimate, ModelError> {
    let hypothesis = &estimate.fitted.hypothesis;
    // As in the fit.
    let weight = hypothesis.floor(measured).carriage;
    let free: Vec<usize> = (0..estimate.fitted.coordinates.len())
        .filter(|index| estimate.deviations[*index].is_finite())
        .collect();
    if free.is_empty() {
        return Ok(estimate);
    }
    let residual = |measured: &Measured, driven: &Driven| {
        stacked(
            &hypothesis.missing_of(driven, measured, Sides::BOTH),
            &estimate.fitted.coordinates,
            weight,
        )
    };
    let columns = |measured: &Measured, driven: &Driven, residual: &DVector<f64>| {
        let all = derivatives(
            hypothesis,
            &estimate.fitted.coordinates,
            driven,
            measured,
            Sides::BOTH,
            residual,
            weight,
        )?;
        Ok::<_, ModelError>(all.select_columns(free.iter()))
    };
    // Where a fit would go from here in one step (Gauss, Newton).
    let step = |inverse: &DMatrix<f64>, columns: &DMatrix<f64>, residual: &DVector<f64>| {
        -(inverse * columns.tr_mul(residual))
    };
    let driven = hypothesis.driven(measured, Sides::BOTH, &Driven::default())?;
    let here = residual(measured, &driven);
    let columns_here = columns(measured, &driven, &here)?;
    let (inverse_here, _) = inverse_where_known(&columns_here.tr_mul(&columns_here));
    let step_here = step(&inverse_here, &columns_here, &here);

    // Where noise takes a fit, with the derivatives of here, and what its own derivatives add to
    // that.
    let moved_by = |seed: u64, sign: f64| -> Result<(DVector<f64>, DVector<f64>), ModelError> {
        let noisy = noisy(hypothesis, measured, seed, sign);
        let driven = hypothesis.driven(&noisy, Sides::BOTH, &Driven::default())?;
        let there = residual(&noisy, &driven);
        let moved = step(&inverse_here, &columns_here, &there);
        let mut more = DVector::zeros(free.len());
        if seed < OWN_DERIVATIVES {
            let columns = columns(&noisy, &driven, &there)?;
            let (inverse, _) = inverse_where_known(&columns.tr_mul(&columns));
            more = step(&inverse, &columns, &there) - &moved;
        }
        Ok((moved - &step_here, more))
    };
    let zero = || DVector::<f64>::zeros(free.len());
    let (mut shift, mut own, mut spread) = (zero(), zero(), zero());
    for seed in 0..PAIRS {
        // Two at a time: each is a record of its own in memory.
        let (there, opposite) = rayon::join(|| moved_by(seed, 1.0), || moved_by(seed, -1.0));
        let ((there, own_there), (opposite, own_opposite)) = (there?, opposite?);
        shift += (&there + &opposite) / (2 * PAIRS) as f64;
        own += (own_there + own_opposite) / (2 * OWN_DERIVATIVES) as f64;
        spread += ((there - opposite) / 2.0).map(|value| value * value) / PAIRS as f64;
    }
    for (row, index) in free.iter().enumerate() {
        let scale = estimate.fitted.coordinates[*index].scale;
        let (spread, shift) = (spread[row].sqrt() * scale, (shift[row] + own[row]) * scale);
        // A law that noise takes out of its bounds says nothing of its size.
        if spread.is_finite() && shift.is_finite() {
            estimate.deviations[*index] = estimate.deviations[*index].max(spread);
            estimate.shifts[*index] = shift;
        }
    }
    Ok(estimate)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_records::recording;
    use crate::{
        FitBudget, FreeParameter, Hypothesis, NominalParameter, ParameterId, Tolerances, fit,
    };
    use friction_stage_core::model::StageModel;
    use friction_stage_core::numerics::TWO_SIDED_95;

    /// Bristles follow the apparent motion of a noisy encoder: static friction comes out too large,
    /// in each record a little, and together by more than their intervals allow.
    #[test]
    fn intervals_hold_what_a_noisy_encoder_shifts() {
        let mut model = StageModel::default();
        model.encoder.noise = 10e-9;
        let records = 8u32;
        let (mut narrow, mut wide) = (0.0, 0.0);
        for seed in 0..u64::from(records) {
            let measured =
                Measured::new(&recording(&model, seed, 0.0, 6), &model, "noisy").unwrap();
            let hypothesis = Hypothesis::new(&model, Tolerances::default()).unwrap();
            let fitted = fit(&hypothesis, &measured, Sides::BOTH, FitBudget::KEPT).unwrap();
            let estimate = fitted.estimate(&measured, Sides::BOTH).unwrap();
            let widened = widened(estimate.clone(), &measured).unwrap();
            let of_static_force =
                |one: &FreeParameter| one.id == ParameterId::Nominal(NominalParameter::StaticForce);
            let index = estimate.fitted.coordinates.iter().position(of_static_force).unwrap();
            // What is declared is true: nothing has to move.
            let off = estimate.fitted.coordinates[index].value / f64::from(records).sqrt();
            narrow += off / estimate.deviations[index];
            wide += off / widened.deviation(index);
            // Not so wide that it would hold anything.
            assert!(widened.deviation(index) < 20.0 * estimate.deviation(index));
        }
        assert!(narrow > 4.0 && wide < TWO_SIDED_95, "{narrow} and {wide} deviations of the mean");
    }

    #[test]
    fn without_noise_nothing_is_shifted() {
        let model = StageModel::default().without_noise();
        let measured = Measured::new(&recording(&model, 3, 0.0, 4), &model, "exact").unwrap();
        let hypothesis = Hypothesis::new(&model, Tolerances::default()).unwrap();
        let fitted = fit(&hypothesis, &measured, Sides::BOTH, FitBudget::COMPARED).unwrap();
        let estimate = fitted.estimate(&measured, Sides::BOTH).unwrap();
        let widened = widened(estimate.clone(), &measured).unwrap();
        assert_eq!(widened.deviations, estimate.deviations);
        for (shift, deviation) in widened.shifts.iter().zip(&estimate.deviations) {
            assert!(shift.abs() <= 1e-6 * deviation, "{shift:e} of {deviation:e}");
        }
    }
}
