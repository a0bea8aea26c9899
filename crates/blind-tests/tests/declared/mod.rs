//! What is declared of the recorded stages, for tests and benches alike: the generator has a model
//! of its own.

use friction_stage_core::model::{Guide, GuideSource, StageModel};

/// The declared model of the recorded stage runs.
pub fn declared() -> StageModel {
    let guide = Guide {
        stiffness: 4.5e5,
        bristle_damping: 900.0,
        viscous_friction: 18.0,
        coulomb_force: 13.5,
        static_force: 16.8,
        stribeck_velocity: 5e-3,
        stribeck_exponent: None,
        damping_velocity: None,
    };
    StageModel { guides: vec![GuideSource::Inline(guide); 4], ..StageModel::default() }
}
