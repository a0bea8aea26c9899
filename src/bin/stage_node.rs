//! `stage_node`: the stage on ROS 2.

use std::process::ExitCode;

use friction_stage::outcome::exit_code;

fn main() -> ExitCode {
    exit_code(friction_stage::node::stage::run(std::env::args().skip(1).collect()))
}
