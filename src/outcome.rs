//! How a program ends: the exit code of what it came to.

use std::io::Write as _;
use std::process::ExitCode;

use friction_stage_core::model::ModelError;
use friction_stage_report::words::{in_one_line, printable};

/// How a command or a node ended, when it did not fail; `main` makes the exit code of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Done: exit 0.
    Done,
    /// Done, with warnings that the output or the log lists: exit 3.
    Warnings,
}

impl Outcome {
    /// [`Outcome::Warnings`] where there is something to warn about.
    pub fn warned(warned: bool) -> Outcome {
        if warned { Outcome::Warnings } else { Outcome::Done }
    }
}

/// Arguments that are well-formed and yet wrong, found out after parsing: exit 2, as for those that
/// clap refuses.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct WrongArguments(pub String);

/// Ctrl-C or SIGTERM before the end, with what is kept: exit 130, as a shell has it for an
/// interrupt.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct Interrupted(pub String);

/// Exit code of a program that was interrupted, as a shell has it.
pub const INTERRUPTED: u8 = 130;

/// Longest text of an error, characters: one that lists the columns of a file may have very many.
const LONGEST: usize = 10_000;

/// Whether an argument names a guide or an effect, and no such one exists.
fn is_unknown_name(error: &anyhow::Error) -> bool {
    error.downcast_ref::<ModelError>().is_some_and(ModelError::is_unknown_name)
}

/// Exit code of a program that ended with `result`; a failure is reported on stderr. Wrong
/// arguments have ended it with 2 before.
pub fn exit_code(result: anyhow::Result<Outcome>) -> ExitCode {
    match result {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Warnings) => ExitCode::from(3),
        Err(error) => {
            // The reader of stderr may be closed, and `eprintln!` would panic of that.
            let text = in_one_line(error.as_ref());
            let cut = text.char_indices().nth(LONGEST);
            let (reported, more) = cut.map_or((&text[..], ""), |(cut, _)| (&text[..cut], "..."));
            let _ = writeln!(std::io::stderr(), "error: {}{more}", printable(reported));
            match () {
                () if error.is::<WrongArguments>() || is_unknown_name(&error) => ExitCode::from(2),
                () if error.is::<Interrupted>() => ExitCode::from(INTERRUPTED),
                () => ExitCode::FAILURE,
            }
        }
    }
}
