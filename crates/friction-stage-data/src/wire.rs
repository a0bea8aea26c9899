//! Samples of the stage and terms of the controller as ROS 2 messages, and back.
//!
//! Stamps on the wire are the stage's own time plus the epoch of the run, ns.

use crate::message::{
    Clock, ControllerState, Header, JointState, JointTrajectory, StageState, Time, WrenchStamped,
};
use friction_stage_core::control::{Point, Reference, Terms, Trajectory, TrajectoryError};
use friction_stage_core::plant;

/// One sample of the stage as it goes out: `Copy`, so that it passes through a ring without
/// allocation.
#[derive(Clone, Copy, Debug)]
pub struct Tick {
    /// Stamp, ns.
    pub stamp: i64,
    /// What the sensors read.
    pub sample: plant::Sample,
    /// The truth.
    pub state: plant::StageState,
}

/// Names that every message of one stage carries.
#[derive(Clone, Debug)]
pub struct StageNames {
    /// Name of the joint.
    pub joint: String,
    /// Frame of the messages.
    pub frame: String,
    /// Names of the effects, in the order of the model.
    pub effects: Vec<String>,
}

impl Tick {
    /// The encoder with velocity and effort.
    pub fn encoder(&self, names: &StageNames) -> JointState {
        JointState {
            header: Header::new(self.stamp, names.frame.as_str()),
            name: vec![names.joint.clone()],
            position: vec![self.sample.position],
            velocity: vec![self.sample.velocity],
            effort: vec![self.sample.force_cell],
        }
    }

    /// The force cell.
    pub fn force_cell(&self, names: &StageNames) -> WrenchStamped {
        WrenchStamped::along_x(
            Header::new(self.stamp, names.frame.as_str()),
            self.sample.force_cell,
        )
    }

    /// The clock at the sample.
    pub fn clock(&self) -> Clock {
        Clock { clock: Time::from_nanos(self.stamp) }
    }

    /// The truth: motion, bristles and force per guide, force per effect.
    pub fn state(&self, names: &StageNames) -> StageState {
        let state = &self.state;
        StageState {
            header: Header::new(self.stamp, names.frame.as_str()),
            sample: state.index,
            position: state.position,
            velocity: state.velocity,
            acceleration: state.acceleration,
            motor_force: state.motor_force,
            bristle_deflection: state.bristle_deflection[..state.guides].to_vec(),
            guide_force: state.guide_force[..state.guides].to_vec(),
            effect_name: names.effects.clone(),
            effect_force: state.effect_force[..state.effects].to_vec(),
        }
    }
}

/// The terms of one answered sample.
pub fn controller_state(
    header: Header,
    sample: u64,
    terms: &Terms,
    enabled: bool,
    setpoint: i64,
) -> ControllerState {
    ControllerState {
        header,
        sample,
        reference_position: terms.reference.position,
        reference_velocity: terms.reference.velocity,
        reference_acceleration: terms.reference.acceleration,
        position: terms.position,
        error: terms.error,
        proportional: terms.proportional,
        integral: terms.integral,
        derivative: terms.derivative,
        feedback: terms.feedback,
        mass_feedforward: terms.mass_feedforward,
        viscous_feedforward: terms.viscous_feedforward,
        effort: terms.reference.effort,
        output: terms.output,
        saturated: terms.saturated,
        enabled,
        holding: terms.holding,
        setpoint_stamp: Time::from_nanos(setpoint),
        bristles_feedforward: terms.compensation.bristles,
        forces_feedforward: terms.compensation.forces,
        motor_feedforward: terms.compensation.motor,
        disturbance: terms.disturbance,
    }
}

/// What a `JointTrajectory` asks for.
#[derive(Clone, Debug, PartialEq)]
pub enum Setpoint {
    /// One point without a time of its own: the setpoint of now.
    Now(Reference),
    /// A motion from its start on.
    Motion(Trajectory),
}

/// Why a `JointTrajectory` is refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SetpointError {
    /// A trajectory for other joints.
    #[error("no joint `{expected}` among [{found}]")]
    WrongJoint {
        /// The joint of the stage.
        expected: String,
        /// Those of the trajectory.
        found: String,
    },
    /// A point with another number of values than joints.
    #[error("point {index}: {found} {quantity} for {joints} joints")]
    Length {
        /// Which point.
        index: usize,
        /// Positions, velocities, accelerations or effort.
        quantity: &'static str,
        /// Values of it.
        found: usize,
        /// Joints of the trajectory.
        joints: usize,
    },
    /// Points that are no motion.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
}

/// Reads the part of `joint` out of a trajectory; stamp 0 means `now`.
pub fn setpoint(
    message: &JointTrajectory,
    joint: &str,
    now: i64,
) -> Result<Setpoint, SetpointError> {
    let joints = message.joint_names.len();
    let index = message.joint_names.iter().position(|name| name == joint).ok_or_else(|| {
        let found = message.joint_names.join(", ");
        SetpointError::WrongJoint { expected: joint.to_owned(), found }
    })?;
    let points = message
        .points
        .iter()
        .enumerate()
        .map(|(number, point)| {
            let value = |quantity, values: &[f64]| match values.get(index) {
                Some(value) if values.len() == joints => Ok(Some(*value)),
                None if values.is_empty() => Ok(None),
                _ => Err(SetpointError::Length {
                    index: number,
                    quantity,
                    found: values.len(),
                    joints,
                }),
            };
            let absent =
                SetpointError::Length { index: number, quantity: "positions", found: 0, joints };
            Ok(Point {
                time: point.time_from_start.to_nanos(),
                position: value("positions", &point.positions)?.ok_or(absent)?,
                velocity: value("velocities", &point.velocities)?,
                acceleration: value("accelerations", &point.accelerations)?,
                effort: value("effort", &point.effort)?.unwrap_or(0.0),
            })
        })
        .collect::<Result<Vec<Point>, SetpointError>>()?;
    let stamp = message.header.stamp.to_nanos();
    let start = if stamp == 0 { now } else { stamp };
    let trajectory = Trajectory::new(start, points)?;
    Ok(match trajectory.points() {
        [point] if point.time == 0 => Setpoint::Now(Reference {
            position: point.position,
            velocity: point.velocity.unwrap_or(0.0),
            acceleration: point.acceleration.unwrap_or(0.0),
            effort: point.effort,
        }),
        _ => Setpoint::Motion(trajectory),
    })
}

/// A trajectory as the message that [`setpoint`] reads back.
pub fn joint_trajectory(joint: &str, stamp: i64, points: &[Point]) -> JointTrajectory {
    use crate::message::{Duration, JointTrajectoryPoint};
    JointTrajectory {
        header: Header::new(stamp, ""),
        joint_names: vec![joint.to_owned()],
        points: points
            .iter()
            .map(|point| JointTrajectoryPoint {
                positions: vec![point.position],
                velocities: point.velocity.into_iter().collect(),
                accelerations: point.acceleration.into_iter().collect(),
                effort: if point.effort == 0.0 { Vec::new() } else { vec![point.effort] },
                time_from_start: Duration::from_nanos(point.time),
            })
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_point_without_time_is_the_setpoint_of_now_and_several_are_a_motion() {
        let point =
            Point { time: 0, position: 0.01, velocity: Some(0.1), acceleration: None, effort: 2.0 };
        let now = Reference { position: 0.01, velocity: 0.1, acceleration: 0.0, effort: 2.0 };
        assert_eq!(
            setpoint(&joint_trajectory("stage", 0, &[point]), "stage", 77),
            Ok(Setpoint::Now(now))
        );
        let later = Point { time: 1_000_000, ..point };
        let Ok(Setpoint::Motion(motion)) =
            setpoint(&joint_trajectory("stage", 0, &[point, later]), "stage", 77)
        else {
            panic!("several points are a motion");
        };
        assert_eq!((motion.start(), motion.points()), (77, &[point, later][..]));
    }

    #[test]
    fn trajectories_for_other_joints_or_with_wrong_lengths_are_refused() {
        let point = Point { time: 0, position: 0.01, ..Point::default() };
        let mut message = joint_trajectory("slider", 0, &[point]);
        assert!(
            setpoint(&message, "stage", 0)
                .unwrap_err()
                .to_string()
                .contains("no joint `stage` among [slider]")
        );
        message.joint_names = vec!["stage".into(), "slider".into()];
        assert!(
            setpoint(&message, "stage", 0)
                .unwrap_err()
                .to_string()
                .contains("1 positions for 2 joints")
        );
        message.points.clear();
        assert_eq!(
            setpoint(&message, "stage", 0),
            Err(SetpointError::Trajectory(TrajectoryError::Empty))
        );
        message = joint_trajectory("stage", 0, &[Point { position: f64::NAN, ..point }]);
        assert!(setpoint(&message, "stage", 0).unwrap_err().to_string().contains("must be finite"));
    }
}
