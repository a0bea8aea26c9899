//! Laws of the hidden effects: what a stage has beyond four LuGre guides, a rigid carriage and an
//! ideal motor.
//!
//! Each is one [`Law`], in the file of the place where it acts. [`CATALOGUE`] lists them with the
//! way to draw one of usual size. "Listed" effects have the names of the library's candidates,
//! "unlisted" ones are in no list. Forces are in N, positive along +x on the carriage; the
//! laws are written here from the literature and share nothing with the library.

mod carriage;
mod friction;
mod motor;
mod sensor;
mod unlisted;

pub use carriage::{
    Backlash, BallPassage, CableChain, ConstantForce, ExternalVibration, HardeningSpring, Payload,
    QuadraticDrag, StructuralMode,
};
pub use friction::{
    AsymmetricFriction, DistributedBristles, FrictionDrift, FrictionalLag, LoadDependentFriction,
    PositionDependentFriction, Shape, StictionAging, ViscousWarmUp,
};
pub use motor::{
    ActuatorLag, Cogging, DeadZone, ForceRipple, MotorDroop, MotorGain, MotorSaturation,
    SpeedRipple,
};
pub use sensor::{
    EncoderCompliance, EncoderCyclicError, EncoderScale, EncoderSde, ForceCellDrift, ForceCellGain,
    ForceCellLag,
};
pub use unlisted::{
    ForceStep, FrictionStep, LostMotion, PayloadStep, PositionVelocity, RailJoint, SaturatingBrake,
    SealMemory,
};

use super::guides::{Change, Elements};
use super::noise::Noise;

/// Where an effect acts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// Between command and force cell.
    Motor,
    /// Between force cell and motion.
    Carriage,
    /// In a reading.
    Sensor,
}

/// What a law sees at a moment within an interval.
#[derive(Debug, Clone, Copy)]
pub struct Now<'a> {
    /// Time in the record, s.
    pub time: f64,
    /// True position, m.
    pub x: f64,
    /// True velocity, m/s.
    pub v: f64,
    /// Time since the last tick, in the middle of the integration step, s.
    pub since: f64,
    /// Interval between ticks, s.
    pub tick: f64,
    /// Commands, N: of this interval, of the one before, ...
    pub commands: &'a [f64; HELD],
}

/// Commands that are remembered: delays up to this many ticks less one.
pub const HELD: usize = 12;

impl Now<'_> {
    /// The command as it was `delay` (s) ago, N.
    pub fn held(&self, delay: f64) -> f64 {
        let back = ((delay - self.since) / self.tick).ceil().max(0.0) as usize;
        self.commands[back.min(HELD - 1)]
    }
}

/// What the states of a law are driven by.
#[derive(Debug, Clone, Copy)]
pub struct Drive {
    /// Power that the guides turn into heat, W.
    pub friction_power: f64,
    /// Force between motor and carriage, N.
    pub motor_force: f64,
}

/// A hidden effect. What is not overridden does nothing.
pub trait Law: std::fmt::Debug + Send + Sync {
    /// Canonical name.
    fn name(&self) -> &'static str;
    /// Where it acts.
    fn side(&self) -> Side;
    /// Whether the library's list of candidates has it.
    fn listed(&self) -> bool {
        true
    }
    /// What its force follows, for an effect that no candidate expresses.
    fn coordinate(&self) -> Option<&'static str> {
        None
    }
    /// Its true parameters, SI.
    fn parameters(&self) -> Vec<(&'static str, f64)>;
    /// The same effect, `factor` times as large.
    fn scaled(&self, factor: f64) -> Effect;
    /// A copy.
    fn copy(&self) -> Effect;

    /// Called before each record (train, check): phases that no two records share.
    fn begin(&mut self, _noise: &mut Noise) {}
    /// Number of continuous states.
    fn states(&self) -> usize {
        0
    }
    /// States at the start of a record at rest at x = 0.
    fn start(&self, _state: &mut [f64]) {}
    /// Rates of the states.
    fn rate(&self, _now: &Now<'_>, _drive: &Drive, _state: &[f64], _rate: &mut [f64]) {}
    /// Once per tick, for phases that wander.
    fn tick(&mut self, _now: &Now<'_>, _noise: &mut Noise) {}

    /// By how much it has commands come late, s: the force jumps within an interval.
    fn delay(&self) -> Option<f64> {
        None
    }
    /// Place in the chain of the motor; the lowest comes first.
    fn rank(&self) -> u8 {
        9
    }
    /// Motor force behind this link of the chain, N, from the force before it.
    fn motor(&self, _now: &Now<'_>, force: f64, _state: &[f64]) -> f64 {
        force
    }
    /// Force on the carriage, N.
    fn carriage(&self, _now: &Now<'_>, _state: &[f64]) -> f64 {
        0.0
    }
    /// Mass that moves with the carriage beyond the true mass of the model, kg.
    fn added_mass(&self) -> f64 {
        0.0
    }
    /// The same of a mass that is not always there: what joins the carriage moves as it does
    /// already, kg.
    fn added_mass_now(&self, _now: &Now<'_>) -> f64 {
        0.0
    }
    /// Positive where it touches the carriage, negative where it does not, for a force that jumps
    /// there.
    fn touch(&self, _now: &Now<'_>, _state: &[f64]) -> Option<f64> {
        None
    }
    /// Whether [`Self::friction`] or [`Self::elements`] is overridden.
    fn changes_friction(&self) -> bool {
        false
    }
    /// Changes the friction law of all guides.
    fn friction(&self, _now: &Now<'_>, _state: &[f64], _change: &mut Change) {}
    /// Replaces the bristle of each guide.
    fn elements(&self) -> Option<Elements> {
        None
    }
    /// Error of the encoder, m, at a force of the motor, N.
    fn encoder(&self, _now: &Now<'_>, _force: f64) -> f64 {
        0.0
    }
    /// Error of the force cell, N, at a true force.
    fn cell(&self, _now: &Now<'_>, _force: f64, _state: &[f64]) -> f64 {
        0.0
    }
}

/// A hidden effect with its parameters.
pub type Effect = Box<dyn Law>;

impl Clone for Effect {
    fn clone(&self) -> Self {
        self.copy()
    }
}

/// Draws an effect of usual size.
pub type Draw = fn(&mut Noise) -> Effect;

/// Every effect with the way to draw one of usual size: first those that the library lists, then
/// the others.
pub const CATALOGUE: [(&str, Draw); 40] = [
    ("cogging", Cogging::draw),
    ("force_ripple", ForceRipple::draw),
    ("motor_gain", MotorGain::draw),
    ("actuator_lag", ActuatorLag::draw),
    ("payload", Payload::draw),
    ("constant_force", ConstantForce::draw),
    ("cable_chain", CableChain::draw),
    ("asymmetric_friction", AsymmetricFriction::draw),
    ("position_dependent_friction", PositionDependentFriction::draw),
    ("distributed_bristles", DistributedBristles::draw),
    ("stiction_aging", StictionAging::draw),
    ("viscous_warm_up", ViscousWarmUp::draw),
    ("quadratic_drag", QuadraticDrag::draw),
    ("ball_passage", BallPassage::draw),
    ("structural_mode", StructuralMode::draw),
    ("external_vibration", ExternalVibration::draw),
    ("encoder_sde", EncoderSde::draw),
    ("encoder_scale", EncoderScale::draw),
    ("force_cell_gain", ForceCellGain::draw),
    ("force_cell_drift", ForceCellDrift::draw),
    ("motor_saturation", MotorSaturation::draw),
    ("motor_droop", MotorDroop::draw),
    ("dead_zone", DeadZone::draw),
    ("hardening_spring", HardeningSpring::draw),
    ("encoder_cyclic_error", EncoderCyclicError::draw),
    ("friction_drift", FrictionDrift::draw),
    ("speed_ripple", SpeedRipple::draw),
    ("backlash", Backlash::draw),
    ("frictional_lag", FrictionalLag::draw),
    ("force_cell_lag", ForceCellLag::draw),
    ("encoder_compliance", EncoderCompliance::draw),
    ("rail_joint", RailJoint::draw),
    ("force_step", ForceStep::draw),
    ("friction_step", FrictionStep::draw),
    ("payload_step", PayloadStep::draw),
    ("saturating_brake", SaturatingBrake::draw),
    ("seal_memory", SealMemory::draw),
    ("lost_motion", LostMotion::draw),
    ("position_velocity", PositionVelocity::draw),
    ("load_dependent_friction", LoadDependentFriction::draw),
];

/// Number of effects at the head of [`CATALOGUE`] that the library lists.
pub const LISTED: usize = 31;

/// An effect of usual size by name, drawn from a seed.
pub fn by_name(name: &str, seed: u64) -> Option<Effect> {
    let (_, draw) = CATALOGUE.iter().find(|(known, _)| *known == name)?;
    Some(draw(&mut Noise::new(seed, 11)))
}

/// `count` different effects of usual size out of a list, drawn from a seed.
pub fn composition(list: &[(&str, Draw)], count: usize, seed: u64) -> Vec<Effect> {
    let mut noise = Noise::new(seed, 12);
    let mut open = list.to_vec();
    (0..count.min(list.len()))
        .map(|_| {
            let (_, draw) = open.swap_remove(noise.index(open.len()));
            draw(&mut noise)
        })
        .collect()
}

/// The head that all laws share.
macro_rules! identity {
    ($name:literal, $side:ident) => {
        fn name(&self) -> &'static str {
            $name
        }
        fn side(&self) -> Side {
            Side::$side
        }
        fn copy(&self) -> Effect {
            Box::new(self.clone())
        }
    };
}
pub(crate) use identity;
