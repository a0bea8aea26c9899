//! How the missing force changes with the parameters of the guides' bristles, of all of them in one
//! pass along the motion.
//!
//! Along a measured motion guides know nothing of each other, and the laws are differentiated step
//! by step ([`BristleSlopes`]). Left out is, of differences between guides, that they share the
//! force which they hold as a record starts, a matter of its first micrometres, and when each does
//! the work that a viscous friction feels.

use nalgebra::DVector;
use rayon::prelude::*;

use crate::fit::difference::step_of;
use crate::hypothesis::{FreeParameter, Hypothesis, ParameterId};
use crate::record::measured::Measured;
use crate::residual::driven::{Driven, FrictionSensitivity};
use friction_stage_core::model::{MAX_GUIDES, ModelError};
use friction_stage_core::plant::{BRISTLE_PARAMETERS, BristleSlopes};

/// By coordinate of those asked for, N per scale at the rows of the carriage side.
pub(crate) fn guide_sensitivities(
    hypothesis: &Hypothesis,
    coordinates: &[FreeParameter],
    asked: &[usize],
    driven: &Driven,
    measured: &Measured,
) -> Result<Vec<(usize, DVector<f64>)>, ModelError> {
    if asked.is_empty() {
        return Ok(Vec::new());
    }
    let directions: Vec<_> =
        asked.iter().map(|index| direction(hypothesis, &coordinates[*index])).collect();
    let Some(sensitivities) = driven.friction_sensitivities(&directions, measured)? else {
        return Ok(Vec::new());
    };
    // What is felt of a parameter of all guides, by what work these do; of one guide as much as its
    // work is of that.
    let work = |sensitivity: &FrictionSensitivity| {
        sensitivity.at_nodes.iter().zip(&measured.velocity).map(|(a, b)| a * b).sum::<f64>()
    };
    let felt = asked
        .iter()
        .zip(&sensitivities)
        .filter(|(index, _)| matches!(coordinates[**index].id, ParameterId::Nominal(_)));
    let felt = felt.map(|(index, sensitivity)| {
        let coordinate = &coordinates[*index];
        let step = step_of(coordinate) / coordinate.scale;
        let felt = driven.felt_sensitivity(&sensitivity.over_steps, step, measured)?;
        Ok(felt.map(|felt| (coordinate.id.of_bristles(), felt, work(sensitivity))))
    });
    let felt: Vec<_> =
        felt.collect::<Result<Vec<_>, ModelError>>()?.into_iter().flatten().collect();
    let column = |(index, sensitivity): (usize, FrictionSensitivity)| {
        let own =
            felt.iter().find(|(parameter, ..)| *parameter == coordinates[index].id.of_bristles());
        let mut at_nodes = sensitivity.at_nodes.clone();
        if let Some((_, felt, of_all)) = own.filter(|(.., of_all)| *of_all != 0.0) {
            let share = work(&sensitivity) / of_all;
            at_nodes.iter_mut().zip(felt).for_each(|(friction, felt)| *friction += share * felt);
        }
        (index, DVector::from_vec(driven.at_rows(at_nodes, measured)))
    };
    let sensitivities: Vec<(usize, FrictionSensitivity)> =
        asked.iter().copied().zip(sensitivities).collect();
    Ok(sensitivities.into_par_iter().map(column).collect())
}

/// By how much the logarithms of the parameters of each guide grow per scale of a coordinate.
fn direction(
    hypothesis: &Hypothesis,
    coordinate: &FreeParameter,
) -> [[f64; MAX_GUIDES]; BRISTLE_PARAMETERS] {
    let step = step_of(coordinate);
    let mut moved = hypothesis.clone();
    moved.set(coordinate.id, coordinate.value + step);
    let mut direction = [[0.0; MAX_GUIDES]; BRISTLE_PARAMETERS];
    for (guide, (there, here)) in moved.guides().iter().zip(&hypothesis.guides()).enumerate() {
        let (there, here) = (BristleSlopes::parameters(there), BristleSlopes::parameters(here));
        for parameter in 0..BRISTLE_PARAMETERS {
            direction[parameter][guide] =
                (there[parameter] / here[parameter]).ln() * (coordinate.scale / step);
        }
    }
    direction
}
