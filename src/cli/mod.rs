//! The command line, one file per command.

pub mod check;
pub mod recover;

/// How a command ended, when it did not fail; `main` makes the exit code of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Done: exit 0.
    Done,
    /// Done, with warnings that the output lists: exit 3.
    Warnings,
}

impl Outcome {
    /// Exit code of the program.
    pub const fn exit_code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::Warnings => 3,
        }
    }
}
