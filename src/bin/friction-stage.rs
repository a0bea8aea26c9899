//! `friction-stage`: the command line.

use std::process::ExitCode;

use clap::Parser;
use friction_stage::cli::{Arguments, exit_code};

fn main() -> ExitCode {
    exit_code(Arguments::parse().run(&mut std::io::stdout().lock()))
}
