//! The command line, one file per command.

pub mod check;
pub mod recover;

use std::process::ExitCode;

/// How a command ended, when it did not fail; `main` makes the exit code of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Done: exit 0.
    Done,
    /// Done, with warnings that the output lists: exit 3.
    Warnings,
}

/// Exit code of a program that ended with `result`: 0 done, 1 failed with the reason on stderr.
pub fn exit_code(result: anyhow::Result<()>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
