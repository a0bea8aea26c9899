//! The command line, one file per command.

pub mod check;
pub mod compensate;
pub mod demo;
pub mod effects;
pub mod experiment;
pub mod fit_guide;
pub mod friction_curve;
pub mod guides;
pub mod identify;
pub mod import;
pub mod merge;
pub mod model;
mod numbered;
pub mod play;
mod progress;
pub mod recover;
pub mod replay;
pub mod select;
mod selection_output;
pub mod sweep;
pub mod sync;
pub mod tune;
pub mod view;

use std::io::Write;

use clap::{Args, Parser, Subcommand};
use friction_stage_core::model::StageModel;
use friction_stage_data::bag::BagError;
use friction_stage_data::signals::{SignalError, Window};
use friction_stage_lab::RowsError;
use friction_stage_report::words::{in_one_line, printable};

use crate::interrupt;
pub use crate::outcome::{Interrupted, Outcome, WrongArguments, exit_code};

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

const EXIT_CODES: &str = "Exit codes: 0 done, 1 failed, 2 wrong arguments, 3 done with warnings,\n\
    130 stopped with Ctrl-C.\n\
    The nodes are the programs stage_node and controller_node; they take --ros-args as every ROS 2 \
                          node does. Their\n\
    --help lists the parameters.";

#[derive(Debug, Subcommand)]
enum Command {
    Demo(demo::DemoArgs),
    FitGuide(fit_guide::FitGuideArgs),
    FrictionCurve(friction_curve::FrictionCurveArgs),
    Select(select::SelectArgs),
    Sweep(sweep::SweepArgs),
    Tune(tune::TuneArgs),
    Compensate(compensate::CompensateArgs),
    Merge(merge::MergeArgs),
    Experiment(experiment::ExperimentArgs),
    Identify(identify::IdentifyArgs),
    Play(play::PlayArgs),
    Replay(replay::ReplayArgs),
    Import(import::ImportArgs),
    Check(check::CheckArgs),
    View(view::ViewArgs),
    Recover(recover::RecoverArgs),
    Effects(effects::EffectsArgs),
    Guides(guides::GuidesArgs),
    Model(model::ModelArgs),
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

impl Arguments {
    /// Runs the command; results go to `out`, progress and logs to stderr.
    pub fn run(self, out: &mut dyn Write) -> anyhow::Result<Outcome> {
        let command = self.command.unwrap_or_else(|| Command::Demo(demo::DemoArgs::default()));
        if !matches!(command, Command::StageNode(_) | Command::ControllerNode(_)) {
            // The nodes have signals of their own.
            interrupt::listen()?;
        }
        let result = match command {
            Command::Demo(arguments) => demo::run(&arguments, out),
            Command::FitGuide(arguments) => fit_guide::run(&arguments, out),
            Command::FrictionCurve(arguments) => friction_curve::run(&arguments, out),
            Command::Select(arguments) => select::run(&arguments, out),
            Command::Sweep(arguments) => sweep::run(&arguments, out),
            Command::Tune(arguments) => tune::run(&arguments, out),
            Command::Compensate(arguments) => compensate::run(&arguments, out),
            Command::Merge(arguments) => merge::run(&arguments, out),
            Command::Experiment(arguments) => experiment::run(&arguments, out),
            Command::Identify(arguments) => identify::run(&arguments, out),
            Command::Play(arguments) => play::run(&arguments, out),
            Command::Replay(arguments) => replay::run(&arguments, out),
            Command::Import(arguments) => import::run(&arguments, out),
            Command::Check(arguments) => check::run(&arguments, out),
            Command::View(arguments) => view::run(&arguments, out),
            Command::Recover(arguments) => recover::run(&arguments, out),
            Command::Effects(arguments) => effects::run(&arguments, out),
            Command::Guides(arguments) => guides::run(&arguments, out),
            Command::Model(arguments) => model::run(&arguments, out),
            Command::StageNode(node) => return crate::node::stage::run(node.arguments),
            Command::ControllerNode(node) => return crate::node::controller::run(node.arguments),
        };
        result.map_err(interrupt::ended).map_err(|error| match names_taken_place(&error) {
            true => WrongArguments(in_one_line(error.as_ref())).into(),
            false => error,
        })
    }
}

/// Whether the arguments name a place for the results that holds others already.
fn names_taken_place(error: &anyhow::Error) -> bool {
    let is_bag = |error: &BagError| matches!(error, BagError::Exists { .. });
    let is_file = |error: &std::io::Error| error.kind() == std::io::ErrorKind::AlreadyExists;
    error.chain().any(|cause| {
        cause.downcast_ref().is_some_and(is_bag)
            || cause.downcast_ref().is_some_and(is_file)
            || matches!(cause.downcast_ref(), Some(SignalError::Bag(error)) if is_bag(error))
            || matches!(
                cause.downcast_ref(),
                Some(RowsError::Exists { .. } | RowsError::OtherArguments { .. })
            )
    })
}

/// What a command prints, in characters that do nothing to a terminal, until whoever reads it goes
/// away, as `head` does behind a pipe: what comes then is dropped, and the command goes on to its
/// end, with its files and its exit code.
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
        let text = String::from_utf8_lossy(bytes);
        self.tell((), |reader| reader.write_all(printable(&text).as_bytes()))?;
        Ok(bytes.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.tell((), Write::flush)
    }
}

/// The part of each recording that is examined. Without it: its first samples, of which the output
/// says how many.
#[derive(Debug, Clone, Copy, Default, Args)]
pub struct PartArgs {
    /// Examine each recording from this time on, s since its first sample
    #[arg(long, value_name = "S")]
    pub from: Option<f64>,
    /// Examine each recording up to this time, s since its first sample
    #[arg(long, value_name = "S")]
    pub to: Option<f64>,
}

impl PartArgs {
    fn window(self) -> anyhow::Result<Window> {
        let (from, to) = (self.from.unwrap_or(0.0), self.to.unwrap_or(f64::INFINITY));
        if from >= 0.0 && to > from {
            return Ok(Window::examined(self.from, self.to));
        }
        Err(WrongArguments(format!("--from {from} --to {to}: must be 0 <= from < to")).into())
    }
}

/// Says on stderr what a model does not say of its guides and is assumed.
fn tell_assumptions(model: Option<&StageModel>) {
    for assumption in model.iter().flat_map(|model| model.assumptions()) {
        eprintln!("note: {}", printable(&assumption));
    }
}
