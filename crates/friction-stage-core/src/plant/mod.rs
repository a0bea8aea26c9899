//! How a stage moves: motor, force cell, carriage on its guides, effects, sensors.
//!
//! In comes a [`StageModel`](crate::model::StageModel), a step and a seed, then one force per
//! control sample; out come samples and the true state. No clock, no I/O and no random source of
//! its own: two plants with the same arguments give the same bits. Nothing here allocates after
//! construction.

mod body;
pub mod effects;
mod exp2;
mod guides;
mod model_file;
mod sensors;
mod stage;

pub use body::Body;
pub use effects::{
    EffectDescriptor, EffectParameter, Effects, Motion, Residual, Samples, Side, SlippingRipple,
};
pub use guides::{
    BRISTLE_PARAMETERS, BristleElements, BristleShare, BristleSlopes, FrictionScale, GuideBank,
    MAX_ELEMENTS, Slip,
};
pub use model_file::{load_model, model_named};
pub use stage::{Rates, RatesError, Sample, Stage, StageState};
