//! How long a controlled stage rests until it is in balance.

use friction_stage_core::control::Gains;
use friction_stage_core::model::{ModelError, StageModel};

/// Time constants of the rest: what is left of a force is e^-10 of it.
const TIME_CONSTANTS: f64 = 10.0;
/// Shortest and longest rest, s. Assumed: of a loop that is slower than the longest the integral
/// does next to nothing.
const RESTS: (f64, f64) = (0.1, 10.0);

/// A rest, s, after which the integral holds the constant forces on a stage, such as its cogging:
/// a stage that is switched on has none of them in its motor yet, and moves. In presliding the
/// guides are springs with the stiffness k, and the integral takes a force over with the time
/// constant (p + k) / i.
pub(crate) fn rest_to_balance(model: &StageModel, gains: &Gains) -> Result<f64, ModelError> {
    let stiffness: f64 = model.resolved_guides()?.iter().map(|guide| guide.stiffness).sum();
    let rest = TIME_CONSTANTS * (gains.p + stiffness) / gains.i;
    // Without an integral there is nothing to wait for.
    Ok(if rest.is_finite() { rest.clamp(RESTS.0, RESTS.1) } else { RESTS.0 })
}
