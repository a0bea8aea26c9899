//! How the missing force changes with the heights of a curve that changes friction, for many knots
//! in one pass along the motion.
//!
//! A height acts while the stage is near its knot, and the bristles forget it within micrometres.
//! Knots far from each other are therefore moved together, and what changes belongs to the one of
//! them that the stage passed last (differences of columns that share no row: Curtis, Powell, Reid,
//! J. Inst. Maths Applics 13, 1974). Left out is what the bristles have not forgotten when the next
//! one comes.

use std::collections::BTreeMap;

use nalgebra::DVector;
use rayon::prelude::*;

use crate::fit::difference::step_of;
use crate::hypothesis::{FreeParameter, Hypothesis, ParameterId, Sides};
use crate::record::measured::Measured;
use crate::residual::driven::Driven;
use friction_stage_core::model::Curve;
use friction_stage_core::plant::effects::along;

/// Every how many knots one is moved. Assumed: so far apart the knots of all records seen were
/// forgotten.
const APART: usize = 8;

/// By coordinate, N per scale at the rows of the carriage side: of none where values do not go
/// together, or more than the friction hangs on a height.
pub(crate) fn knot_sensitivities(
    hypothesis: &Hypothesis,
    coordinates: &[FreeParameter],
    driven: &Driven,
    measured: &Measured,
) -> BTreeMap<usize, DVector<f64>> {
    let mut together: BTreeMap<(usize, usize), Vec<(usize, usize)>> = BTreeMap::new();
    for (index, coordinate) in coordinates.iter().enumerate() {
        if let Some((effect, knot)) = knot_of(hypothesis, coordinate.id) {
            together.entry((effect, knot % APART)).or_default().push((index, knot));
        }
    }
    let (false, Some(here)) = (together.is_empty(), driven.friction_at_nodes()) else {
        return BTreeMap::new();
    };
    let columns = together.par_iter().map(|((effect, first), knots)| {
        let mut moved = hypothesis.clone();
        for &(index, _) in knots {
            let coordinate = &coordinates[index];
            moved.set(coordinate.id, coordinate.value + step_of(coordinate));
        }
        let there = moved.driven(measured, Sides::CARRIAGE, driven).ok()?.friction_at_nodes()?;
        let curve = hypothesis.effects[*effect].curve()?;
        let passed = passed_last(&curve, *first, driven, measured);
        let column = |&(index, knot): &(usize, usize)| {
            let scale = coordinates[index].scale / step_of(&coordinates[index]);
            let change =
                |k: usize| if passed[k] == Some(knot) { scale * (there[k] - here[k]) } else { 0.0 };
            (
                index,
                DVector::from_vec(driven.at_rows((0..here.len()).map(change).collect(), measured)),
            )
        };
        Some(knots.iter().map(column).collect::<Vec<_>>())
    });
    let columns: Option<Vec<_>> = columns.collect();
    columns.into_iter().flatten().flatten().collect()
}

/// The curve that changes friction and its knot whose height this is.
fn knot_of(hypothesis: &Hypothesis, id: ParameterId) -> Option<(usize, usize)> {
    let ParameterId::Effect { effect, value } = id else { return None };
    let part = &hypothesis.effects[effect];
    let curve = part.curve().filter(|curve| curve.side.is_of_friction())?;
    let knot = value.checked_sub(part.values.len() - curve.values.len())?;
    Some((effect, knot))
}

/// For each node which of the knots `first`, `first` + [`APART`], ... the stage was near last while
/// it slid; none before the first of them.
fn passed_last(
    curve: &Curve,
    first: usize,
    driven: &Driven,
    measured: &Measured,
) -> Vec<Option<usize>> {
    let mut passed = vec![None; measured.len()];
    let mut last = None;
    for step in driven.steps(measured) {
        if step.sliding != 0.0 {
            let (knot, part) = curve.locate(along(curve.coordinate, &step.motion));
            let near = [(knot, part < 1.0), (knot + 1, part > 0.0)];
            let of_these = near.iter().find(|(knot, acts)| *acts && knot % APART == first);
            last = of_these.map(|(knot, _)| *knot).or(last);
        }
        (passed[step.node], passed[step.node + 1]) = (last, last);
    }
    passed
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::objective::{derivatives, stacked};
    use crate::test_records::{hypothesis, record};

    /// Each column against the difference quotient of the whole missing force: Coulomb friction
    /// over 64 knots along 0.1 m, viscous over 64 knots along 2 s.
    #[test]
    fn what_changes_with_each_height_is_told_apart_though_many_move_at_once() {
        let measured = record();
        let knots: Vec<f64> = (0..64).map(|knot| 0.1 * f64::from(knot % 5)).collect();
        for head in [
            [0.0, 2.0, 0.0, 0.1, 0.0, 0.0],
            [2.0, 3.0, 0.0, 2.0, 0.0, 0.0],
            [2.0, 2.0, 0.0, 2.0, 0.3, 0.7],
        ] {
            let with = hypothesis(&[("map", &[&head[..], &knots].concat())]).holding_curves(false);
            let coordinates = with.coordinates(Sides::BOTH, true);
            let driven = with.driven(&measured, Sides::BOTH, &Driven::default()).unwrap();
            let sensitivities = knot_sensitivities(&with, &coordinates, &driven, &measured);
            let missing_at = |index: usize, step: f64| {
                let mut moved = with.clone();
                moved.set(
                    coordinates[index].id,
                    coordinates[index].value + step * coordinates[index].scale,
                );
                DVector::from_vec(moved.missing(&measured, Sides::BOTH).unwrap().carriage)
            };
            assert_eq!(sensitivities.len(), 64);
            let residual =
                stacked(&with.missing(&measured, Sides::BOTH).unwrap(), &coordinates, 0.05);
            let all =
                derivatives(&with, &coordinates, &driven, &measured, Sides::BOTH, &residual, 0.05)
                    .unwrap();
            let rows = measured.rows.len();
            for (index, sensitivity) in sensitivities {
                let expected = (missing_at(index, 1e-4) - missing_at(index, -1e-4)) / 2e-4;
                let off = (&sensitivity - &expected).norm() / expected.norm();
                assert!(
                    off < 1e-2,
                    "{head:?}, {:?}: {off:e} of {}",
                    coordinates[index].id,
                    expected.norm()
                );
                assert_eq!(all.column(index).rows(rows, rows), sensitivity);
            }
        }
    }
}
