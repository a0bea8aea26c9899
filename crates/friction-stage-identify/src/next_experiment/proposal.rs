//! The motion that is proposed, and what it is for.

use serde::{Deserialize, Serialize};

use friction_stage_core::control::Point;

/// The motion, and what is expected of it.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Times in ns after the start. The first point is the start of the first piece: the stage may
    /// come from anywhere in the stroke.
    pub points: Vec<Point>,
    /// What the motion is for.
    pub next: NextExperiment,
}

/// What the next experiment is and what it is for, as in `summary.json`. SI units.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NextExperiment {
    /// The file with the motion, a `trajectory_msgs/JointTrajectory`.
    pub file: String,
    /// s
    pub duration: f64,
    /// Range of the positions, m.
    pub stroke: [f64; 2],
    /// m/s
    pub peak_speed: f64,
    /// Of the motor, N, in the simulation of the motion with the identified model.
    pub peak_force: f64,
    /// Its pieces in their order.
    pub segments: Vec<Planned>,
    /// Effects of the model with the rivals that could stand in their place.
    pub rivals: Vec<Separation>,
    /// Parameters that the present record hardly knows.
    pub parameters: Vec<Sharpened>,
    /// Effects that the present record would not have shown at a usual size; only where nothing
    /// else is open.
    pub untested: Vec<Shown>,
    /// Of an unexplained force: `position`, `velocity` or `time`, over which the motion repeats.
    pub coordinate: Option<String>,
}

/// A piece of the motion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Planned {
    /// One word for the kind of motion.
    pub kind: String,
    /// The motion with its numbers.
    pub description: String,
    /// s
    pub duration: f64,
}

/// How well an effect is distinguished from a rival: rms of the force that one has and the other,
/// refitted, cannot imitate, in multiples of the noise floor of the sensors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Separation {
    /// Effect of the model.
    pub effect: String,
    /// Law that could stand in its place.
    pub rival: String,
    /// On the present record.
    pub before: f64,
    /// In the new motion.
    pub after: f64,
    /// What the new motion must reach for the two to be distinguished.
    pub needed: f64,
    /// Whether the new motion tells them apart.
    pub separates: bool,
}

/// How much better a parameter is known with the new motion: half widths of its 95 % interval;
/// `null` where nothing is known.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Sharpened {
    /// Parameter, with its effect.
    pub name: String,
    /// `1`: a share of the value.
    pub unit: String,
    /// On the present record.
    pub before: Option<f64>,
    /// With the new motion too.
    pub after: Option<f64>,
}

/// What an effect of a usual size would leave that the model cannot imitate, rms in floors of the
/// sensors' noise.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shown {
    /// Effect of the model.
    pub effect: String,
    /// On the present record.
    pub before: f64,
    /// In the new motion.
    pub after: f64,
}
