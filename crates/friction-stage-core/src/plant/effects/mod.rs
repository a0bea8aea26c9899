//! Effects beyond the LuGre guides: one file each, named in the two lists below.
//!
//! A file holds everything about its effect: law with symbols, units and source; parameters with
//! bounds; what it acts on; its force and its energy; how to guess its parameters from a residual.
//! The model file, the plant, the node and identification know an effect through its
//! [`EffectDescriptor`] alone.

mod descriptor;
mod law;
mod motion;
mod regression;
mod residual;
mod role;
mod running;

pub use descriptor::{
    CurveValues, EffectDescriptor, EffectParameter, Multiplicity, ParameterKind, Proposal,
    RecordSpecific, SlippingRipple,
};
pub(crate) use law::{Action, CommandLaw, ForceLaw, FrictionLaw, MassLaw, ReadingLaw};
pub use motion::{ForceOverStep, Motion};
pub use regression::{golden_maximum, viscous_friction};
pub use residual::{Residual, Samples};
pub use role::{CommandStage, FrictionTerms, Role, Side};
pub use running::{Effects, MAX_EFFECTS};

mod actuator_lag;
mod asymmetric_friction;
mod backlash;
mod ball_passage;
mod cable_chain;
mod cogging;
mod constant_force;
mod dead_zone;
mod distributed_bristles;
mod encoder_compliance;
mod encoder_cyclic_error;
mod encoder_scale;
mod encoder_sde;
mod external_vibration;
mod force_cell_drift;
mod force_cell_gain;
mod force_cell_lag;
mod force_ripple;
mod friction_drift;
mod frictional_lag;
mod hardening_spring;
mod load_dependent_friction;
mod map;
mod motor_droop;
mod motor_gain;
mod motor_saturation;
mod payload;
mod position_dependent_friction;
mod quadratic_drag;
mod speed_ripple;
mod stiction_aging;
mod structural_mode;
mod viscous_warm_up;

/// Every effect, in alphabetical order.
pub const ALL: &[&EffectDescriptor] = &[
    &actuator_lag::DESCRIPTOR,
    &asymmetric_friction::DESCRIPTOR,
    &backlash::DESCRIPTOR,
    &ball_passage::DESCRIPTOR,
    &cable_chain::DESCRIPTOR,
    &cogging::DESCRIPTOR,
    &constant_force::DESCRIPTOR,
    &dead_zone::DESCRIPTOR,
    &distributed_bristles::DESCRIPTOR,
    &encoder_compliance::DESCRIPTOR,
    &encoder_cyclic_error::DESCRIPTOR,
    &encoder_scale::DESCRIPTOR,
    &encoder_sde::DESCRIPTOR,
    &external_vibration::DESCRIPTOR,
    &force_cell_drift::DESCRIPTOR,
    &force_cell_gain::DESCRIPTOR,
    &force_cell_lag::DESCRIPTOR,
    &force_ripple::DESCRIPTOR,
    &friction_drift::DESCRIPTOR,
    &frictional_lag::DESCRIPTOR,
    &hardening_spring::DESCRIPTOR,
    &load_dependent_friction::DESCRIPTOR,
    &map::DESCRIPTOR,
    &motor_droop::DESCRIPTOR,
    &motor_gain::DESCRIPTOR,
    &motor_saturation::DESCRIPTOR,
    &payload::DESCRIPTOR,
    &position_dependent_friction::DESCRIPTOR,
    &quadratic_drag::DESCRIPTOR,
    &speed_ripple::DESCRIPTOR,
    &stiction_aging::DESCRIPTOR,
    &structural_mode::DESCRIPTOR,
    &viscous_warm_up::DESCRIPTOR,
];

/// The empirical curve: what a model holds that no law of the list explains.
pub const CURVE: &EffectDescriptor = &map::DESCRIPTOR;

pub use map::along;
