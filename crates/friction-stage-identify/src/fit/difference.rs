//! Steps of the difference quotients of a fit.

use crate::hypothesis::FreeParameter;

/// Step of the difference quotients, in scales of the coordinates.
const DIFFERENCE: f64 = 1e-4;

/// Step of a difference quotient, backward at the upper bound.
pub(crate) fn step_of(coordinate: &FreeParameter) -> f64 {
    let step = DIFFERENCE * coordinate.scale;
    if coordinate.value + step > coordinate.bounds.1 { -step } else { step }
}
