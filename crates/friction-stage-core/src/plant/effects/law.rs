//! What an effect does, step by step: one small trait per role.
//!
//! The plant and identification drive the same objects, once per step and with the steps in order:
//! laws of friction first, then the others. A step of 0 s (after a reset) asks for the force of a
//! state and leaves it as it is.

use std::fmt::Debug;

use nalgebra::Complex;

use super::super::guides::{BristleElements, FrictionScale};
use super::{ForceOverStep, Motion};

/// An effect at work, by its role.
#[derive(Debug)]
pub(crate) enum Action {
    /// Changes the command of the motor.
    Command(Box<dyn CommandLaw>),
    /// Adds a force before the force cell.
    MotorForce(Box<dyn ForceLaw>),
    /// Adds a force on the carriage.
    CarriageForce(Box<dyn ForceLaw>),
    /// Multiplies laws of the guides.
    Friction(Box<dyn FrictionLaw>),
    /// Elements that stand in parallel in each guide, in place of its one bristle.
    Bristles(BristleElements),
    /// Mass that always moves with the carriage beyond that of the model, kg; negative for a part
    /// of it that does not.
    Mass(f64),
    /// Mass that moves with the carriage at times.
    VaryingMass(Box<dyn MassLaw>),
    /// What the encoder reads at a true position, m, before noise and quantisation.
    Encoder(Box<dyn ReadingLaw>),
    /// Compliance between the carriage and the motor that the encoder is on, m/N.
    Compliance(f64),
    /// What the force cell reads under a true force, N, before noise.
    ForceCell(Box<dyn ReadingLaw>),
}

/// A change of the motor's command on its way to becoming a force.
pub(crate) trait CommandLaw: Debug + Send + Sync {
    /// Mean force, N, by which what leaves differs from the command that arrives, N, over a step of
    /// `step` seconds.
    fn change(&mut self, command: f64, motion: &Motion, step: f64) -> f64;

    /// As [`CommandLaw::change`], over a step as long as a control cycle, with where in it the
    /// force acts.
    fn change_over(&mut self, command: f64, motion: &Motion, step: f64) -> ForceOverStep {
        ForceOverStep { mean: self.change(command, motion, step), moment: 0.0 }
    }

    /// What is added to a sinusoidal command of this angular frequency, rad/s, over the command.
    /// What changes with the position, and averages out over it, adds nothing.
    fn added(&self, _angular_frequency: f64) -> Complex<f64> {
        Complex::new(0.0, 0.0)
    }

    /// Back to the state at construction.
    fn reset(&mut self) {}
}

/// A force on motor or carriage.
pub(crate) trait ForceLaw: Debug + Send + Sync {
    /// Mean force along +x over a step of `step` seconds, N.
    fn force(&mut self, motion: &Motion, step: f64) -> f64;

    /// As [`ForceLaw::force`], over a step as long as a control cycle, with where in it the force
    /// acts.
    fn force_over(&mut self, motion: &Motion, step: f64) -> ForceOverStep {
        ForceOverStep { mean: self.force(motion, step), moment: 0.0 }
    }

    /// Part of the model's moving mass that the law carries in place of the carriage, kg.
    fn carried_mass(&self) -> f64 {
        0.0
    }

    /// Largest slope of the force over position, N/m: limits the step of the plant.
    fn stiffness(&self) -> f64 {
        0.0
    }

    /// Energy that the law holds and can give back, J.
    fn stored_energy(&self, _position: f64) -> f64 {
        0.0
    }

    /// Back to the state at construction.
    fn reset(&mut self) {}
}

/// Factors on the laws of the guides.
pub(crate) trait FrictionLaw: Debug + Send + Sync {
    /// Multiplies the factors on the guides' laws over a step of `step` seconds.
    fn scale(&mut self, motion: &Motion, step: f64, scale: &mut FrictionScale);

    /// Whether the factors depend on the friction of all guides ([`Motion::friction`]). Only of
    /// what scales the viscous friction alone: bristles do not depend on it.
    fn feels_friction(&self) -> bool {
        false
    }

    /// Back to the state at construction.
    fn reset(&mut self) {}
}

/// A mass that moves with the carriage at times.
pub(crate) trait MassLaw: Debug + Send + Sync {
    /// Mass beyond that of the model as the carriage moves now, kg.
    fn mass(&self, motion: &Motion) -> f64;

    /// The least that this comes to, kg.
    fn least(&self) -> f64;
}

/// What a sensor reads.
pub(crate) trait ReadingLaw: Debug + Send + Sync {
    /// Reading at a time since the start, s, for a true value; both in the unit of the sensor.
    fn reading(&self, time: f64, truth: f64) -> f64;

    /// Keeps a true value that stood for a step of `step` seconds, before the next reading.
    fn follow(&mut self, _truth: f64, _step: f64) {}

    /// Changes readings, one after each step of `step` seconds, into what a sensor that is not late
    /// would have shown.
    fn made_up_for(&self, _readings: &mut [f64], _step: f64) {}

    /// Back to the state at construction.
    fn reset(&mut self) {}
}
