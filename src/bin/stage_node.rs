//! `stage_node`: the stage on ROS 2.

use std::process::ExitCode;

fn main() -> ExitCode {
    friction_stage::cli::exit_code(friction_stage::node::stage::run(std::env::args().skip(1).collect()))
}
