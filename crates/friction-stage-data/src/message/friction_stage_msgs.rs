//! `friction_stage_msgs`: our own two messages, as `msg/*.msg` define them.
//!
//! Until version 0.2 their package was called `friction_stage`, as that of the programs is. This is
//! the one place that knows.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::{Definition, Header, RosMessage, Time};

/// Package of these messages, and what it was called in recordings of before.
const PACKAGE: &str = "friction_stage_msgs";
const FORMER_PACKAGE: &str = "friction_stage";

/// The name that a type has today, e.g. `friction_stage_msgs/msg/StageState` for what a recording
/// calls `friction_stage/msg/StageState`.
pub fn current_type_name(recorded: &str) -> Cow<'_, str> {
    match recorded.strip_prefix(FORMER_PACKAGE) {
        Some(rest) if rest.starts_with('/') => Cow::Owned(format!("{PACKAGE}{rest}")),
        _ => Cow::Borrowed(recorded),
    }
}

/// The true state of the emulated stage at one sample; forces act on the carriage, + along +x.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct StageState {
    /// Time of the sample.
    pub header: Header,
    /// Number of the control sample, counted from start-up.
    pub sample: u64,
    /// m.
    pub position: f64,
    /// m/s.
    pub velocity: f64,
    /// m/s², at the end of the interval that ends at this sample.
    pub acceleration: f64,
    /// N, command of the interval that ends at this sample, after the motor's limit, without
    /// effects.
    pub motor_force: f64,
    /// m, one per guide.
    pub bristle_deflection: Vec<f64>,
    /// N, friction of each guide on the carriage.
    pub guide_force: Vec<f64>,
    /// Active effects, in the order of the model.
    pub effect_name: Vec<String>,
    /// N, one per effect.
    pub effect_force: Vec<f64>,
}

impl RosMessage for StageState {
    const PACKAGE: &'static str = PACKAGE;
    const NAME: &'static str = "StageState";
    const TYPE_HASH: &'static str =
        "RIHS01_d214e3360eb4c342a08d3e0da5a468358f292d01c01607f43ac5e6b2762aa49d";
    const TEXT: &'static str = include_str!("../../msg/StageState.msg");
    const DEPENDENCIES: &'static [Definition] =
        &[Definition::of::<Header>(), Definition::of::<Time>()];
}

/// Everything that the controller adds up for one sample.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct ControllerState {
    /// Stamp of the sample that this output answers.
    pub header: Header,
    /// Number of answered samples.
    pub sample: u64,
    /// m.
    pub reference_position: f64,
    /// m/s.
    pub reference_velocity: f64,
    /// m/s².
    pub reference_acceleration: f64,
    /// m, as the encoder gave it.
    pub position: f64,
    /// m, reference - position.
    pub error: f64,
    /// N.
    pub proportional: f64,
    /// N.
    pub integral: f64,
    /// N.
    pub derivative: f64,
    /// N, sum of the three after the lowpass.
    pub feedback: f64,
    /// N.
    pub mass_feedforward: f64,
    /// N.
    pub viscous_feedforward: f64,
    /// N, added by the setpoint itself.
    pub effort: f64,
    /// N, sum after saturation.
    pub output: f64,
    /// The sum exceeded the force limit.
    pub saturated: bool,
    /// False: output is zero.
    pub enabled: bool,
    /// No setpoint is being followed: the last one is held.
    pub holding: bool,
    /// Start of the setpoint or trajectory accepted last, 0 before the first.
    pub setpoint_stamp: Time,
    /// N, of a compensation: bristles of the guides.
    pub bristles_feedforward: f64,
    /// N, of a compensation: against effects that are a force.
    pub forces_feedforward: f64,
    /// N, of a compensation: by which the command differs from the wanted force.
    pub motor_feedforward: f64,
    /// N, added by a disturbance observer.
    pub disturbance: f64,
}

impl RosMessage for ControllerState {
    const PACKAGE: &'static str = PACKAGE;
    const NAME: &'static str = "ControllerState";
    const TYPE_HASH: &'static str =
        "RIHS01_331766e95481c567e5db960692867e7950801cf04352573373be978b1cf207ad";
    const TEXT: &'static str = include_str!("../../msg/ControllerState.msg");
    const ADDED_NUMBERS: usize = 4;
    const DEPENDENCIES: &'static [Definition] =
        &[Definition::of::<Header>(), Definition::of::<Time>()];
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Field names of a definition, in order.
    fn fields(text: &str) -> Vec<String> {
        text.lines()
            .map(|l| l.split('#').next().unwrap_or(""))
            .filter_map(|l| l.split_whitespace().nth(1))
            .map(str::to_owned)
            .collect()
    }

    /// Field names of a struct, in order.
    fn members<M: RosMessage + Default>() -> Vec<String> {
        let text = serde_json::to_string(&M::default()).unwrap();
        let value: serde_json::Value = serde_json::from_str(&text).unwrap();
        let mut names: Vec<(usize, String)> = value
            .as_object()
            .unwrap()
            .keys()
            .map(|k| (text.find(&format!("\"{k}\":")).unwrap(), k.clone()))
            .collect();
        names.sort();
        names.into_iter().map(|(_, k)| k).collect()
    }

    #[test]
    fn types_of_before_have_their_name_of_today() {
        let current = "friction_stage_msgs/msg/StageState";
        assert_eq!(current_type_name("friction_stage/msg/StageState"), current);
        assert_eq!(current_type_name(current), current);
        assert_eq!(current_type_name("sensor_msgs/msg/JointState"), "sensor_msgs/msg/JointState");
    }

    #[test]
    fn structs_have_the_fields_of_their_definition_in_order() {
        assert_eq!(members::<StageState>(), fields(StageState::TEXT));
        assert_eq!(members::<ControllerState>(), fields(ControllerState::TEXT));
    }
}
