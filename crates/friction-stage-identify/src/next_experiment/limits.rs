//! What the motion may do, and why none can be worked out.

use crate::error::IdentifyError;
use crate::record::measured::forgetting_length;
use crate::record::records::Record;
use friction_stage_core::control::{ControllerError, TrajectoryError};
use friction_stage_core::model::{ModelError, StageModel};
use friction_stage_core::plant::RatesError;

/// Shortest and longest motion that may be asked for, s. Assumed: below, no piece fits; above, it
/// is a slip of the unit.
pub const DURATIONS: (f64, f64) = (2.0, 3600.0);
/// Lowest speed limit, m/s. Assumed: a tenth of the slowest speeds that stages are measured at.
const LEAST_SPEED: f64 = 1e-4;
/// Part of stroke and speed that a reference leaves free. Assumed.
const ROOM: f64 = 0.01;

/// What the motion may do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Lowest and highest position, m.
    pub stroke: (f64, f64),
    /// m/s
    pub speed: f64,
    /// Of the motor, N.
    pub force: f64,
    /// About how long the motion may take, s, without the way to its start.
    pub duration: f64,
}

/// Why no motion can be worked out. The message of each variant says what it is.
#[expect(missing_docs, reason = "the message of each says what its fields are")]
#[derive(Debug, thiserror::Error)]
pub enum NextExperimentError {
    #[error(
        "the stroke from {low} m to {high} m is too short or upside down: at least {least:.3e} m \
         are needed for the guides to slide and to forget where they came from"
    )]
    Stroke { low: f64, high: f64, least: f64 },
    #[error("the largest speed is {given} m/s: must be finite and at least {least:e} m/s")]
    Speed { given: f64, least: f64 },
    #[error(
        "the largest force is {given} N: must be above {needed:.1} N, which the friction of the \
         guides takes alone"
    )]
    Force { given: f64, needed: f64 },
    #[error(
        "the largest force is {given} N, and the motor of the model has {limit} N \
         (motor.force_limit): at most that"
    )]
    Motor { given: f64, limit: f64 },
    #[error("the motion may take {given} s: must be between {least} and {most} s")]
    Duration { given: f64, least: f64, most: f64 },
    #[error(
        "no piece of motion keeps to the limits of {low} m to {high} m, {speed} m/s and {force} N: \
         allow more of them"
    )]
    Nothing { low: f64, high: f64, speed: f64, force: f64 },
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error(transparent)]
    Rates(#[from] RatesError),
    #[error(transparent)]
    Controller(#[from] ControllerError),
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
}

impl Limits {
    /// Largest speed where none is given, m/s: the paper's fast move, 50 mm in 100 ms, peaks at
    /// 0.94 m/s.
    pub const SPEED: f64 = 1.0;
    /// Duration where none is given, s. Assumed: long enough for several pieces, short enough to be
    /// played twice.
    pub const DURATION: f64 = 20.0;

    /// Limits as far as they are given; the stroke else is that of the train record, the force that
    /// of the model's motor.
    pub fn given(
        stroke: Option<(f64, f64)>,
        speed: Option<f64>,
        force: Option<f64>,
        duration: Option<f64>,
        model: &StageModel,
        train: &Record,
    ) -> Result<Limits, NextExperimentError> {
        let limits = Limits {
            stroke: stroke.unwrap_or_else(|| train.stroke()),
            speed: speed.unwrap_or(Limits::SPEED),
            force: force.unwrap_or(model.motor.force_limit),
            duration: duration.unwrap_or(Limits::DURATION),
        };
        limits.check(model)?;
        Ok(limits)
    }

    /// Refuses limits within which this stage cannot move, or that it does not have.
    pub fn check(&self, model: &StageModel) -> Result<(), NextExperimentError> {
        let Limits { stroke: (low, high), speed, force, duration } = *self;
        if !(speed.is_finite() && speed >= LEAST_SPEED) {
            return Err(NextExperimentError::Speed { given: speed, least: LEAST_SPEED });
        }
        if !(DURATIONS.0..=DURATIONS.1).contains(&duration) {
            return Err(NextExperimentError::Duration {
                given: duration,
                least: DURATIONS.0,
                most: DURATIONS.1,
            });
        }
        let (forget, moving) = self.friction(model)?;
        if !(force.is_finite() && force > moving) {
            return Err(NextExperimentError::Force { given: force, needed: moving });
        }
        if force > model.motor.force_limit {
            return Err(NextExperimentError::Motor {
                given: force,
                limit: model.motor.force_limit,
            });
        }
        let least = 4.0 * forget;
        if !(low.is_finite() && high.is_finite() && high - low >= least) {
            return Err(NextExperimentError::Stroke { low, high, least });
        }
        Ok(())
    }

    /// The same with room for a carriage that overshoots its reference.
    pub(super) fn with_room(self) -> Limits {
        let (low, high) = self.stroke;
        let room = ROOM * (high - low);
        Limits { stroke: (low + room, high - room), speed: self.speed * (1.0 - ROOM), ..self }
    }

    /// Way after which the guides have forgotten where they came from, m, and the force that moving
    /// takes, N: static friction at rest or viscous friction at the largest speed, whichever is
    /// larger.
    pub(super) fn friction(&self, model: &StageModel) -> Result<(f64, f64), ModelError> {
        let guides = model.resolved_guides()?;
        let moving =
            guides.iter().map(|guide| guide.static_force.max(guide.steady_force(self.speed))).sum();
        Ok((forgetting_length(&guides), moving))
    }
}
