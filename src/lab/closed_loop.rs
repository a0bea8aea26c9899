//! One stage and one controller, cycle by cycle, exactly as the two nodes do it in lockstep.

use crate::control::{Controller, Follower, Terms};
use crate::plant::{Sample, Stage};

/// What happened at one sample: what the sensors said and what the controller answered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cycle {
    pub sample: Sample,
    pub terms: Terms,
}

/// A stage under a controller that samples at the stage's control rate.
#[derive(Debug)]
pub struct ClosedLoop {
    pub stage: Stage,
    pub controller: Controller,
    pub follower: Follower,
}

impl ClosedLoop {
    /// Sample, control, hold the force until the next sample.
    #[inline]
    pub fn cycle(&mut self) -> Cycle {
        let sample = self.stage.sample();
        let terms = self.controller.update(sample.time, sample.position, &mut self.follower);
        self.stage.advance(terms.output);
        Cycle { sample, terms }
    }
}
