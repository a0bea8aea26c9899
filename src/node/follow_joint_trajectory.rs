//! `control_msgs/action/FollowJointTrajectory`: which goals are taken, and how one is judged while
//! it is followed.
//!
//! Result codes, texts and tolerances are those of joint_trajectory_controller 4 (Jazzy); like it,
//! a goal that cannot be followed is refused, and tolerances without meaning leave the defaults.
//! Nothing here knows of a topic: the controller's loop asks for every sample.

use ros2_client::Message;
use serde::{Deserialize, Serialize};

use super::action::{Action, GoalId};
use super::parameters::ParameterValues;
use super::words::quoted;
use friction_stage_core::control::Reference;
use friction_stage_data::message::{
    Duration, Header, JointTrajectory, JointTrajectoryControllerState, JointTrajectoryPoint,
    MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint,
};

/// Result codes of the action.
pub const SUCCESSFUL: i32 = 0;
pub const INVALID_GOAL: i32 = -1;
pub const INVALID_JOINTS: i32 = -2;
pub const OLD_HEADER_TIMESTAMP: i32 = -3;
pub const PATH_TOLERANCE_VIOLATED: i32 = -4;
pub const GOAL_TOLERANCE_VIOLATED: i32 = -5;

/// Tolerances of one joint; 0 is the default, -1 none.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct JointTolerance {
    pub name: String,
    /// m
    pub position: f64,
    /// m/s
    pub velocity: f64,
    /// m/s²
    pub acceleration: f64,
}

/// Tolerances of a joint with several degrees of freedom: of no meaning here.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct JointComponentTolerance {
    pub joint_name: String,
    pub component: u16,
    pub position: f64,
    pub velocity: f64,
    pub acceleration: f64,
}

/// Goal of the action.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct FollowGoal {
    pub trajectory: JointTrajectory,
    pub multi_dof_trajectory: MultiDOFJointTrajectory,
    pub path_tolerance: Vec<JointTolerance>,
    pub component_path_tolerance: Vec<JointComponentTolerance>,
    pub goal_tolerance: Vec<JointTolerance>,
    pub component_goal_tolerance: Vec<JointComponentTolerance>,
    pub goal_time_tolerance: Duration,
}

/// Result of the action.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FollowResult {
    pub error_code: i32,
    pub error_string: String,
}

impl FollowResult {
    pub fn new(error_code: i32, error_string: impl Into<String>) -> FollowResult {
        FollowResult { error_code, error_string: error_string.into() }
    }
}

/// Feedback of the action.
///
/// From control_msgs 6.3 on (Kilted) an index of the current point follows `error` and
/// another at the end. As everything of joints with several degrees of freedom is empty, which is
/// all zeros, two more zeros at the end give these readers an index of 0, and others ignore them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct FollowFeedback {
    pub header: Header,
    pub joint_names: Vec<String>,
    pub desired: JointTrajectoryPoint,
    pub actual: JointTrajectoryPoint,
    pub error: JointTrajectoryPoint,
    multi_dof_joint_names: Vec<String>,
    multi_dof_desired: MultiDOFJointTrajectoryPoint,
    multi_dof_actual: MultiDOFJointTrajectoryPoint,
    multi_dof_error: MultiDOFJointTrajectoryPoint,
    indices: [i32; 2],
}

impl Message for FollowGoal {}
impl Message for FollowResult {}
impl Message for FollowFeedback {}

/// The action type.
#[derive(Debug)]
pub struct FollowJointTrajectory;

impl Action for FollowJointTrajectory {
    type Goal = FollowGoal;
    type Result = FollowResult;
    type Feedback = FollowFeedback;
    const PACKAGE: &'static str = "control_msgs";
    const NAME: &'static str = "FollowJointTrajectory";
}

/// Tolerances of a motion; 0 is none.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Constraints {
    /// While moving: m, m/s.
    path: (f64, f64),
    /// At the end: m, m/s.
    goal: (f64, f64),
    /// Time after the end of the motion to come within those of the goal, s.
    goal_time: f64,
}

impl Constraints {
    /// The defaults, which the parameters `constraints.*` say.
    pub fn of(values: &ParameterValues) -> Constraints {
        Constraints {
            path: (values.double("constraints.stage.trajectory"), 0.0),
            goal: (
                values.double("constraints.stage.goal"),
                values.double("constraints.stopped_velocity_tolerance"),
            ),
            goal_time: values.double("constraints.goal_time"),
        }
    }

    /// What a goal asks for instead; these defaults whole, with a warning, where it asks for
    /// something without meaning.
    pub fn asked_by(&self, goal: &FollowGoal, joint: &str) -> Constraints {
        self.resolved(goal, joint).unwrap_or_else(|why| {
            tracing::warn!("{}. Using default tolerances", quoted(&why));
            *self
        })
    }

    fn resolved(&self, goal: &FollowGoal, joint: &str) -> Result<Constraints, String> {
        let mut asked = *self;
        let time = 1e-9 * goal.goal_time_tolerance.to_nanos() as f64;
        asked.goal_time = resolve(self.goal_time, time)
            .ok_or_else(|| format!("Specified illegal goal_time_tolerance: {time:.6}"))?;
        let lists = [
            ("path_tolerance", &goal.path_tolerance, &mut asked.path),
            ("goal_tolerance", &goal.goal_tolerance, &mut asked.goal),
        ];
        for (list, tolerances, asked) in lists {
            let defaults = *asked;
            for tolerance in tolerances {
                let name = &tolerance.name;
                if name != joint {
                    return Err(format!("joint '{name}' specified in goal.{list} does not exist"));
                }
                let illegal = |interface: &str| {
                    format!(
                        "joint '{name}' specified in goal.{list} has a invalid {interface} \
                         tolerance"
                    )
                };
                asked.0 =
                    resolve(defaults.0, tolerance.position).ok_or_else(|| illegal("position"))?;
                asked.1 =
                    resolve(defaults.1, tolerance.velocity).ok_or_else(|| illegal("velocity"))?;
                // The encoder says nothing of the acceleration: checked, but never applied.
                resolve(0.0, tolerance.acceleration).ok_or_else(|| illegal("acceleration"))?;
            }
        }
        Ok(asked)
    }
}

/// A tolerance of a goal: 0 (and what is no number) is the default, -1 none; nothing for another
/// negative one.
fn resolve(default: f64, asked: f64) -> Option<f64> {
    if asked > 0.0 {
        Some(asked)
    } else if (asked + 1.0).abs() < f64::from(f32::EPSILON) {
        Some(0.0)
    } else if asked < 0.0 {
        None
    } else {
        Some(default)
    }
}

/// Whether an error (m, m/s) is within tolerances.
fn within(error: (f64, f64), tolerance: (f64, f64)) -> bool {
    let exceeds = |error: f64, tolerance: f64| tolerance > 0.0 && error.abs() > tolerance;
    !exceeds(error.0, tolerance.0) && !exceeds(error.1, tolerance.1)
}

/// Refuses what joint_trajectory_controller refuses, in its order and words; `now` is the clock of
/// the samples, ns.
pub fn check(trajectory: &JointTrajectory, joint: &str, now: i64) -> Result<(), FollowResult> {
    let refuse = |code, text: String| Err(FollowResult::new(code, text));
    if trajectory.joint_names.len() != 1 {
        let text = "Joints on incoming trajectory don't match the controller joints.";
        return refuse(INVALID_JOINTS, text.to_owned());
    }
    let Some(last) = trajectory.points.last() else {
        return refuse(INVALID_GOAL, "Empty trajectory received.".to_owned());
    };
    let name = &trajectory.joint_names[0];
    if name != joint {
        let text = format!("Incoming joint {name} doesn't match the controller's joints.");
        return refuse(INVALID_JOINTS, text);
    }
    if let Some(velocity) = last.velocities.iter().find(|v| v.abs() > f64::from(f32::EPSILON)) {
        let text = format!(
            "Velocity of last trajectory point of joint {name} is not zero: {velocity:.15}"
        );
        return refuse(INVALID_GOAL, text);
    }
    let seconds = |nanos: i64| nanos as f64 * 1e-9;
    let (start, span) = (trajectory.header.stamp.to_nanos(), last.time_from_start.to_nanos());
    if start != 0 && start.saturating_add(span) < now {
        return refuse(OLD_HEADER_TIMESTAMP, past(start, start.saturating_add(span)));
    }
    for (index, pair) in trajectory.points.windows(2).enumerate() {
        let (before, after) =
            (pair[0].time_from_start.to_nanos(), pair[1].time_from_start.to_nanos());
        if after <= before {
            let text = format!(
                "Time between points {index} and {} is not strictly increasing, it is {:.6} and \
                 {:.6} respectively",
                index + 1,
                seconds(before),
                seconds(after)
            );
            return refuse(INVALID_GOAL, text);
        }
    }
    for (index, point) in trajectory.points.iter().enumerate() {
        let fields = [
            ("positions", &point.positions, false),
            ("velocities", &point.velocities, true),
            ("accelerations", &point.accelerations, true),
        ];
        for (field, values, may_be_empty) in fields {
            if values.len() != 1 && !(values.is_empty() && may_be_empty) {
                let text = format!(
                    "Mismatch between joint_names size (1) and {field} ({}) at point #{index}.",
                    values.len()
                );
                return refuse(INVALID_GOAL, text);
            }
        }
    }
    Ok(())
}

/// The words for a trajectory that is over already; ns.
fn past(start: i64, end: i64) -> String {
    format!(
        "Received trajectory with non-zero start time ({:.6}) that ends in the past ({:.6})",
        start as f64 * 1e-9,
        end as f64 * 1e-9
    )
}

/// A goal that is followed.
#[derive(Clone, Debug)]
pub struct ActiveGoal {
    pub id: GoalId,
    /// Of its motion, ns on the clock of the samples.
    pub start: i64,
    end: i64,
    constraints: Constraints,
    has_begun: bool,
}

/// Where a goal stands after a sample.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Progress {
    Going,
    Reached(FollowResult),
    Failed(FollowResult),
}

impl ActiveGoal {
    pub fn new(id: GoalId, start: i64, end: i64, constraints: Constraints) -> ActiveGoal {
        ActiveGoal { id, start, end, constraints, has_begun: false }
    }

    /// Judges the sample at `now`, ns, with its errors of position and velocity, m and m/s.
    pub fn judge(&mut self, now: i64, error: (f64, f64)) -> Progress {
        let first = !std::mem::replace(&mut self.has_begun, true);
        let moving = now < self.end;
        // A motion that is to come is held for, not followed.
        let begun = now >= self.start;
        if begun && (moving || first) && !within(error, self.constraints.path) {
            let text = "Aborted due to path tolerance violation";
            return Progress::Failed(FollowResult::new(PATH_TOLERANCE_VIOLATED, text));
        }
        if moving {
            return Progress::Going;
        }
        if within(error, self.constraints.goal) {
            return Progress::Reached(FollowResult::new(SUCCESSFUL, "Goal successfully reached!"));
        }
        let late = (now - self.end) as f64 * 1e-9;
        if self.constraints.goal_time > 0.0 && late > self.constraints.goal_time {
            let text = format!("Aborted due to goal_time_tolerance exceeding by {late:.6} seconds");
            return Progress::Failed(FollowResult::new(GOAL_TOLERANCE_VIOLATED, text));
        }
        Progress::Going
    }
}

/// Reference, measurement and their difference at one sample, as messages of
/// joint_trajectory_controller.
#[derive(Clone, Debug)]
pub struct Sampled {
    pub header: Header,
    pub joint: String,
    /// Since the start of the motion.
    pub time_from_start: Duration,
    pub reference: Reference,
    /// m, m/s
    pub actual: (f64, f64),
    /// N
    pub output: f64,
}

impl Sampled {
    fn points(&self) -> [JointTrajectoryPoint; 3] {
        let (reference, (position, velocity)) = (&self.reference, self.actual);
        let time_from_start = self.time_from_start;
        [
            JointTrajectoryPoint {
                positions: vec![reference.position],
                velocities: vec![reference.velocity],
                accelerations: vec![reference.acceleration],
                effort: vec![reference.effort],
                time_from_start,
            },
            JointTrajectoryPoint {
                positions: vec![position],
                velocities: vec![velocity],
                time_from_start,
                ..JointTrajectoryPoint::default()
            },
            JointTrajectoryPoint {
                positions: vec![reference.position - position],
                velocities: vec![reference.velocity - velocity],
                time_from_start,
                ..JointTrajectoryPoint::default()
            },
        ]
    }

    pub fn feedback(self) -> FollowFeedback {
        let [desired, actual, error] = self.points();
        let (header, joint_names) = (self.header, vec![self.joint]);
        FollowFeedback { header, joint_names, desired, actual, error, ..FollowFeedback::default() }
    }

    pub fn state(self) -> JointTrajectoryControllerState {
        let [reference, feedback, error] = self.points();
        JointTrajectoryControllerState {
            header: self.header,
            joint_names: vec![self.joint],
            reference,
            feedback,
            error,
            output: JointTrajectoryPoint {
                effort: vec![self.output],
                ..JointTrajectoryPoint::default()
            },
            speed_scaling_factor: 1.0,
            ..JointTrajectoryControllerState::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use friction_stage_data::message::{from_cdr, to_cdr};

    fn trajectory(points: &[(f64, f64)]) -> JointTrajectory {
        JointTrajectory {
            joint_names: vec!["stage".to_owned()],
            points: points
                .iter()
                .map(|(time, position)| JointTrajectoryPoint {
                    positions: vec![*position],
                    time_from_start: Duration::from_nanos((time * 1e9) as i64),
                    ..JointTrajectoryPoint::default()
                })
                .collect(),
            ..JointTrajectory::default()
        }
    }

    fn goal(name: &str, position: f64, velocity: f64) -> FollowGoal {
        let tolerance = JointTolerance {
            name: name.to_owned(),
            position,
            velocity,
            ..JointTolerance::default()
        };
        FollowGoal { path_tolerance: vec![tolerance], ..FollowGoal::default() }
    }

    #[test]
    fn bad_trajectories_have_the_code_and_words_of_joint_trajectory_controller() {
        let good = trajectory(&[(0.1, 0.01), (0.2, 0.02)]);
        assert_eq!(check(&good, "stage", 5), Ok(()));
        let refused = |trajectory: &JointTrajectory| {
            let why = check(trajectory, "stage", 10_000_000_000).unwrap_err();
            (why.error_code, why.error_string)
        };
        let other = JointTrajectory { joint_names: vec!["arm".to_owned()], ..good.clone() };
        let text = "Incoming joint arm doesn't match the controller's joints.";
        assert_eq!(refused(&other), (INVALID_JOINTS, text.to_owned()));
        let none = JointTrajectory { joint_names: Vec::new(), ..good.clone() };
        assert_eq!(refused(&none).0, INVALID_JOINTS);
        assert_eq!(refused(&trajectory(&[])).1, "Empty trajectory received.");
        let back = refused(&trajectory(&[(0.2, 0.0), (0.1, 0.0)]));
        assert!(
            back.0 == INVALID_GOAL && back.1.contains("it is 0.200000 and 0.100000"),
            "{back:?}"
        );
        let mut late = good.clone();
        late.header = Header::new(1_000_000_000, "");
        let late = refused(&late);
        assert!(late.0 == OLD_HEADER_TIMESTAMP && late.1.contains("(1.200000)"), "{late:?}");
        let mut running = good.clone();
        running.points[1].velocities = vec![0.1];
        assert!(refused(&running).1.contains("is not zero: 0.100000000000000"));
        let mut torn = good;
        torn.points[1].positions = vec![0.0, 0.0];
        assert!(refused(&torn).1.contains("positions (2) at point #1."));
    }

    #[test]
    fn tolerances_without_meaning_leave_the_defaults_and_minus_one_is_none() {
        let defaults = Constraints { path: (1e-3, 0.0), goal: (1e-4, 0.01), goal_time: 0.5 };
        let path = |name, position, velocity| {
            defaults.asked_by(&goal(name, position, velocity), "stage").path
        };
        assert_eq!(path("stage", 2e-3, 0.3), (2e-3, 0.3));
        assert_eq!(path("stage", -1.0, 0.0), (0.0, 0.0));
        assert_eq!(path("stage", f64::NAN, 0.3), (1e-3, 0.3));
        assert_eq!(path("stage", 2e-3, -0.5), defaults.path);
        assert_eq!(path("arm", 2e-3, 0.3), defaults.path);
    }

    #[test]
    fn a_goal_is_reached_within_its_tolerances_and_fails_in_time() {
        let constraints = Constraints { path: (1e-3, 0.0), goal: (1e-4, 0.0), goal_time: 0.5 };
        let new = || ActiveGoal::new(GoalId::ZERO, 1_000, 2_000, constraints);
        // Before its start, an error is not that of the goal.
        assert_eq!(new().judge(0, (1.0, 0.0)), Progress::Going);
        let Progress::Failed(why) = new().judge(1_500, (2e-3, 0.0)) else { panic!("off the path") };
        assert_eq!(why.error_code, PATH_TOLERANCE_VIOLATED);
        let mut goal = new();
        assert_eq!(goal.judge(1_500, (5e-4, 9.0)), Progress::Going);
        assert_eq!(goal.judge(2_000, (5e-4, 9.0)), Progress::Going);
        let Progress::Reached(result) = goal.clone().judge(3_000, (5e-5, 9.0)) else {
            panic!("within the tolerance")
        };
        assert_eq!(
            (result.error_code, result.error_string.as_str()),
            (0, "Goal successfully reached!")
        );
        let Progress::Failed(why) = goal.judge(600_002_000, (5e-4, 0.0)) else {
            panic!("too late")
        };
        assert_eq!(why.error_code, GOAL_TOLERANCE_VIOLATED);
        assert!(why.error_string.contains("exceeding by 0.600000 seconds"), "{why:?}");
    }

    #[test]
    fn feedback_is_read_with_the_indices_of_later_distributions_and_without() {
        #[derive(Debug, Clone, Serialize, Deserialize)]
        struct Later {
            header: Header,
            joint_names: Vec<String>,
            points: [JointTrajectoryPoint; 3],
            index: i32,
            multi_dof_joint_names: Vec<String>,
            multi_dof: [MultiDOFJointTrajectoryPoint; 3],
            multi_dof_index: i32,
        }
        impl friction_stage_data::message::RosMessage for Later {
            const PACKAGE: &'static str = "";
            const NAME: &'static str = "";
            const TYPE_HASH: &'static str = "";
            const TEXT: &'static str = "";
            const DEPENDENCIES: &'static [friction_stage_data::message::Definition] = &[];
        }
        let reference = Reference { position: 0.5, ..Reference::default() };
        let sampled = Sampled {
            header: Header::new(7, "stage"),
            joint: "stage".to_owned(),
            time_from_start: Duration::from_nanos(3),
            reference,
            actual: (0.25, 0.0),
            output: 0.0,
        };
        let bytes = to_cdr(&sampled.feedback()).unwrap();
        let later: Later = from_cdr(&bytes).unwrap();
        assert_eq!(later.points[2].positions, [0.25]);
        assert_eq!((later.index, later.multi_dof_index), (0, 0));
        assert!(later.multi_dof_joint_names.is_empty());
    }
}
