//! The command line, one file per command.

pub mod check;
pub mod demo;
pub mod experiment;
pub mod fit_guide;
pub mod identify;
pub mod import;
pub mod merge;
pub mod play;
pub mod recover;
pub mod replay;
pub mod select;
mod selection_output;
mod variant_rows;

use std::io::Write;
use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// A positioning stage on friction-loaded guides as software: on ROS 2, recorded, and compared with
/// recordings.
///
/// Without a command it runs the demo.
#[derive(Debug, Parser)]
#[command(name = "friction-stage", version, after_help = EXIT_CODES)]
pub struct Arguments {
    #[command(subcommand)]
    command: Option<Command>,
}

const EXIT_CODES: &str = "Exit codes: 0 done, 1 failed, 2 wrong arguments, 3 done with warnings.\n\
    The nodes are the programs stage_node and controller_node; they take --ros-args as every ROS 2 \
                          node does. Their\n\
    --help lists the parameters.";

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::DemoArgs),
    FitGuide(fit_guide::FitGuideArgs),
    Select(select::SelectArgs),
    Merge(merge::MergeArgs),
    Experiment(experiment::ExperimentArgs),
    Identify(identify::IdentifyArgs),
    Play(play::PlayArgs),
    Replay(replay::ReplayArgs),
    Import(import::ImportArgs),
    Check(check::CheckArgs),
    Recover(recover::RecoverArgs),
    /// Run the stage node, as the program stage_node does
    #[command(hide = true, disable_help_flag = true)]
    StageNode(NodeArgs),
    /// Run the controller node, as the program controller_node does
    #[command(hide = true, disable_help_flag = true)]
    ControllerNode(NodeArgs),
}

/// Everything behind the command belongs to the node.
#[derive(Debug, clap::Args)]
struct NodeArgs {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    arguments: Vec<String>,
}

/// How a command ended, when it did not fail; `main` makes the exit code of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// Done: exit 0.
    Done,
    /// Done, with warnings that the output lists: exit 3.
    Warnings,
}

impl Arguments {
    /// Runs the command; results go to `out`, progress and logs to stderr.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        match self.command.unwrap_or_else(|| Command::Demo(demo::DemoArgs::default())) {
            Command::Demo(arguments) => demo::run(&arguments, out),
            Command::FitGuide(arguments) => fit_guide::run(&arguments, out),
            Command::Select(arguments) => select::run(&arguments, out),
            Command::Merge(arguments) => merge::run(&arguments, out),
            Command::Experiment(arguments) => experiment::run(&arguments, out),
            Command::Identify(arguments) => identify::run(&arguments, out),
            Command::Play(arguments) => play::run(&arguments, out),
            Command::Replay(arguments) => replay::run(&arguments, out),
            Command::Import(arguments) => import::run(&arguments, out),
            Command::Check(arguments) => check::run(&arguments, out),
            Command::Recover(arguments) => recover::run(&arguments, out),
            Command::StageNode(node) => {
                crate::node::stage::run(node.arguments).map(|()| Outcome::Done)
            }
            Command::ControllerNode(node) => {
                crate::node::controller::run(node.arguments).map(|()| Outcome::Done)
            }
        }
    }
}

/// What a command prints, until whoever reads it goes away, as `head` does behind a pipe: what
/// comes then is dropped, and the command goes on to its end, with its files and its exit code.
#[derive(Debug)]
pub struct Printed<W> {
    reader: Option<W>,
}

impl<W: Write> Printed<W> {
    pub fn new(reader: W) -> Printed<W> {
        Printed { reader: Some(reader) }
    }

    fn tell<T>(
        &mut self,
        unread: T,
        action: impl FnOnce(&mut W) -> std::io::Result<T>,
    ) -> std::io::Result<T> {
        let Some(reader) = &mut self.reader else { return Ok(unread) };
        match action(reader) {
            Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => {
                self.reader = None;
                Ok(unread)
            }
            done => done,
        }
    }
}

impl<W: Write> Write for Printed<W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.tell(bytes.len(), |reader| reader.write(bytes))
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.tell((), Write::flush)
    }
}

/// Arguments that are well-formed and yet wrong, found out after parsing: exit 2, as for those that
/// clap refuses.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct WrongArguments(pub String);

/// Exit code of a program that ended with `result`; a failure is told on stderr. Wrong arguments
/// have ended it with 2 before.
pub fn exit_code(result: anyhow::Result<Outcome>) -> ExitCode {
    match result {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Warnings) => ExitCode::from(3),
        Err(error) => {
            // Nobody may read stderr any more, and `eprintln!` would panic of that.
            let _ = writeln!(std::io::stderr(), "error: {}", in_one_line(&error));
            if error.is::<WrongArguments>() { ExitCode::from(2) } else { ExitCode::FAILURE }
        }
    }
}

/// An error with its causes, outermost first. Many an error of the library names its cause in its
/// own text: not again then.
fn in_one_line(error: &anyhow::Error) -> String {
    error.chain().map(ToString::to_string).fold(String::new(), |told, cause| {
        match told.contains(&cause) {
            true => told,
            false if told.is_empty() => cause,
            false => format!("{told}: {cause}"),
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_is_told_with_each_of_its_causes_once() {
        #[derive(Debug, thiserror::Error)]
        #[error("cannot read a.yaml: {source}")]
        struct Read {
            source: std::io::Error,
        }
        let error = anyhow::Error::new(Read { source: std::io::Error::other("no such file") })
            .context("parameter model");
        assert_eq!(in_one_line(&error), "parameter model: cannot read a.yaml: no such file");
    }
}
