//! One stage and one controller, cycle by cycle, exactly as the two nodes do it in lockstep.

use crate::control::{Compensation, Controller, Follower, Terms, Trajectory, TrajectoryError};
use crate::plant::{Sample, Stage};

/// What happened at one sample: what the sensors said and what the controller answered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cycle {
    /// What the sensors read.
    pub sample: Sample,
    /// What the controller answered.
    pub terms: Terms,
}

/// A stage under a controller that samples at the stage's control rate.
///
/// The controller holds the first measured position until the trajectory starts.
#[derive(Debug)]
pub struct ClosedLoop {
    stage: Stage,
    controller: Controller,
    follower: Follower,
    trajectory: Option<Trajectory>,
    compensation: Option<Compensation>,
}

impl ClosedLoop {
    /// The trajectory's start counts on the clock of the stage, which begins at 0.
    pub fn new(stage: Stage, controller: Controller, trajectory: Trajectory) -> ClosedLoop {
        ClosedLoop {
            stage,
            controller,
            follower: Follower::new(f64::INFINITY),
            trajectory: Some(trajectory),
            compensation: None,
        }
    }

    /// The same with the feedforward of a compensation.
    pub fn compensated(self, compensation: Compensation) -> ClosedLoop {
        ClosedLoop { compensation: Some(compensation), ..self }
    }

    /// Sample, control, hold the force until the next sample.
    #[inline]
    pub fn cycle(&mut self) -> Result<Cycle, TrajectoryError> {
        let sample = self.stage.sample();
        if let Some(trajectory) = self.trajectory.take() {
            self.follower.hold(sample.time, sample.position);
            self.follower.follow(sample.time, trajectory)?;
        }
        let terms = self.controller.update_with(
            sample.time,
            sample.position,
            &mut self.follower,
            self.compensation.as_mut(),
        );
        self.stage.advance(terms.output);
        Ok(Cycle { sample, terms })
    }

    /// The stage as it is now.
    pub fn stage(&self) -> &Stage {
        &self.stage
    }
}
