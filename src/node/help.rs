//! What `--help` says of a node: how it is started, and its parameters as it declares them.

use std::io::Write as _;

use super::arguments::ROS_ARGUMENTS;
use super::parameters::ParameterSpec;

/// Prints the help of a node if its command line asks for it; whether it did.
pub(super) fn given(
    command_line: &[String],
    program: &str,
    about: &str,
    parameters: &[ParameterSpec],
) -> bool {
    let wanted = command_line.iter().any(|argument| matches!(argument.as_str(), "-h" | "--help"));
    if wanted {
        // Whoever reads it may go away in the middle.
        let _ = std::io::stdout().write_all(text(program, about, parameters).as_bytes());
    }
    wanted
}

fn text(program: &str, about: &str, parameters: &[ParameterSpec]) -> String {
    let mut text = format!(
        "{about}\n\nUsage: {program} [--ros-args ROS_ARGUMENT...]\n\nROS arguments, as of every \
         ROS 2 node:\n"
    );
    for argument in ROS_ARGUMENTS {
        text += &format!("  {argument}\n");
    }
    text += "\nParameters:\n";
    for parameter in parameters {
        text += &format!(
            "  {}: {}\n      {}\n",
            parameter.name,
            parameter.values(),
            parameter.description
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::{controller, controller_settings, stage, stage_settings};

    #[test]
    fn the_help_of_a_node_has_every_parameter_with_its_values() {
        let reported = text("stage_node", "The stage.", &stage_settings::specs());
        for parameter in stage_settings::specs() {
            assert!(
                reported.contains(&format!("\n  {}: ", parameter.name)),
                "{} in {reported}",
                parameter.name
            );
        }
        assert!(reported.starts_with("The stage.\n\nUsage: stage_node "), "{reported}");
        assert!(
            reported.contains(
                "  mode: string, realtime or lockstep, default realtime, at start only\n"
            ),
            "{reported}"
        );
        assert!(
            reported.contains("  clock_pause: double, 0.0 to 1.0 s, default 0.0 s\n"),
            "{reported}"
        );
        assert!(reported.contains("-p [NODE:]NAME:=VALUE"), "{reported}");
        assert!(
            text("", "", &controller_settings::specs()).contains("\n  enabled: bool, default true")
        );
    }

    /// A node that is asked for its help joins no network and ends.
    #[test]
    fn a_node_that_is_asked_for_help_does_not_start() {
        for flag in ["-h", "--help"] {
            stage::run(vec![flag.to_owned()]).unwrap();
            controller::run(vec!["--ros-args".to_owned(), flag.to_owned()]).unwrap();
        }
        assert!(!given(&["--ros-args".to_owned()], "stage_node", "", &[]));
    }
}
