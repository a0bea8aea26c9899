//! Topics of the stage, as the nodes name them by default. Nodes in a namespace, such as `/x`, have
//! it in front of them: `/x/stage/encoder`.

/// Encoder reading, `sensor_msgs/JointState`.
pub const ENCODER: &str = "/stage/encoder";
/// Force-cell reading, `geometry_msgs/WrenchStamped`.
pub const FORCE_CELL: &str = "/stage/force_cell";
/// Force command, `geometry_msgs/WrenchStamped`.
pub const FORCE: &str = "/stage/force";
/// Force command of topic hardware, `sensor_msgs/JointState`. Its stamps are of the hardware's own
/// clock and may repeat; when the stage took it is the log time of the stage's own bags.
pub const JOINT_COMMANDS: &str = "/stage/joint_commands";
/// Setpoint, `trajectory_msgs/JointTrajectory`.
pub const SETPOINT: &str = "/stage/setpoint";
/// State of the stage with the force that acted, `friction_stage_msgs/StageState`.
pub const STATE: &str = "/stage/state";
/// What the controller adds up, `friction_stage_msgs/ControllerState`.
pub const CONTROLLER_STATE: &str = "/controller/state";
/// Name of the joint in every message.
pub const JOINT: &str = "stage";

/// The namespace of the only stage among topics: what stands before its encoder. Empty for a stage
/// without one, and where there are several or none.
pub fn namespace<'a>(names: impl IntoIterator<Item = &'a str>) -> &'a str {
    let mut stages = names.into_iter().filter_map(|name| name.strip_suffix(ENCODER));
    match (stages.next(), stages.next()) {
        (Some(only), None) => only,
        _ => "",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_namespace_is_that_of_the_only_stage() {
        assert_eq!(namespace(["/clock", "/x/stage/encoder", "/x/stage/force"]), "/x");
        assert_eq!(namespace(["/lab/x/stage/encoder"]), "/lab/x");
        assert_eq!(namespace(["/stage/encoder"]), "");
        assert_eq!(namespace(["/x/stage/encoder", "/y/stage/encoder"]), "");
        assert_eq!(namespace(["/x/joint_states"]), "");
    }
}
