//! `friction-stage`: the command line.

use std::process::ExitCode;

use clap::Parser;
use friction_stage::cli::{Arguments, Printed, exit_code};

fn main() -> ExitCode {
    exit_code(Arguments::parse().run(&mut Printed::new(std::io::stdout().lock())))
}
