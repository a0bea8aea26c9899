//! `friction-stage experiment`: the laboratory of the paper, one experiment or all of them.

pub(super) mod bags;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context as _;
use clap::{Args, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use rayon::prelude::*;

use self::bags::write_bag;
use super::{Outcome, WrongArguments};
use crate::directory;
use friction_stage_core::model::{Catalogue, StageModel};
use friction_stage_core::plant::Rates;
use friction_stage_lab::{self as lab, LabError, LabRecording, PaperResults, Settings, Specimen};
use friction_stage_report::experiment::{
    ExperimentResults, ExperimentSummary, SpecimenHunting, SpecimenRig, StiffnessFit,
    experiment_page,
};

/// Run an experiment of the paper on the measuring rig or on the 40 kg stage, in this process.
///
/// Reduces what encoder and force cell read, noise included, to curves, and writes bags, figures
/// (SVG), summary.json and one self-contained report.html. `paper` runs all of them and checks
/// every statement of the paper.
///
/// Exit code: 0 done, 1 failed, 2 wrong arguments, 3 done with warnings, for instance a statement
/// that does not hold.
#[derive(Debug, Clone, Args)]
#[command(
    after_help = "Examples:\n  friction-stage experiment stribeck\n  friction-stage experiment \
                  dahl --guides guide_1,guide_1+distributed_bristles --out dahl\n  friction-stage \
                  experiment fast-move --model my_stage.yaml\n  friction-stage experiment paper \
                  --out paper && xdg-open paper/report.html"
)]
pub struct ExperimentArgs {
    /// What to run
    #[arg(value_enum, value_name = "NAME")]
    pub experiment: Experiment,
    /// Guides by catalogue name; +distributed_bristles takes the catalogue's parallel bristles
    /// [default: the paper's three]
    #[arg(long, value_delimiter = ',', value_name = "GUIDES", value_parser = guide_name)]
    pub guides: Vec<String>,
    /// Model files: a stage, or a rig with a coupling; beside the guides
    #[arg(long, value_name = "FILE")]
    pub model: Vec<PathBuf>,
    /// Directory for bags, figures and report [default: experiment_NAME_ and the date]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Amplitudes of the loops of `dahl`, m [default: twelve from 10e-9 to 1e-3]
    #[arg(long, value_delimiter = ',', value_name = "METRES", value_parser = amplitude)]
    pub amplitudes: Vec<f64>,
    /// Seed of the sensor noise
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Rest between the conditioning move and the fast move or fine step, simulated seconds; the
    /// paper: a minute
    #[arg(
        long,
        default_value_t = lab::Conditioning::PAPER_REST,
        value_name = "SECONDS",
        value_parser = rest_seconds,
    )]
    pub rest: f64,
    /// Write no bags
    #[arg(long)]
    pub no_bags: bool,
    /// Print summary.json instead of a table
    #[arg(long)]
    pub json: bool,
}

/// The experiments.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Experiment {
    /// Force over constant velocity, 0.1 mm/s to 1 m/s, both directions
    Stribeck,
    /// Hysteresis loops from 10 nm to 1 mm: stiffness, area, Dahl resonance
    Dahl,
    /// Stage under a sinusoidal force at several amplitudes
    FrequencyResponse,
    /// 50 mm in 100 ms, forward and return, with and without viscous feedforward
    FastMove,
    /// 10 um in 3 ms, with and without viscous feedforward
    FineStep,
    /// Integral action at rest near the target: limit cycles
    Hunting,
    /// How far coupling, force cell, speed and servo of the rig bias the curves
    Rig,
    /// All of them, and every statement of the paper
    Paper,
}

const GUIDES: [&str; 3] = ["guide_1", "guide_2", "guide_3"];
const BRISTLES: &str = "+distributed_bristles";

fn guide_name(text: &str) -> Result<String, String> {
    specimen(text).map(|_| text.to_owned()).map_err(|error| error.to_string())
}

fn rest_seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    if (0.01..=3600.0).contains(&value) {
        Ok(value)
    } else {
        Err(format!("{value} must be between 0.01 and 3600 s"))
    }
}

fn amplitude(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    if (1e-9..=0.05).contains(&value) {
        Ok(value)
    } else {
        Err(format!("{value} must be between 1e-9 and 0.05 m"))
    }
}

fn specimen(name: &str) -> anyhow::Result<Specimen> {
    let Some(guide) = name.strip_suffix(BRISTLES) else { return Ok(Specimen::of_guide(name)?) };
    Specimen::of_guide(guide)?;
    let bristles = Catalogue::builtin().distributed_bristles(guide).with_context(|| {
        format!(
            "{guide} has no distributed bristles in the catalogue: the paper gives several \
             stiffnesses for guide_1 only"
        )
    })?;
    let stage = StageModel { effects: vec![bristles.1], ..StageModel::on_guides(guide) };
    let mut found = Specimen::of_model(&stage)?.with_guide(bristles.0);
    found.name = format!("{} distributed", guide.replace('_', " "));
    Ok(found)
}

impl Experiment {
    fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// Whether `paper` or the experiment itself asks for a part.
    fn includes(self, part: Experiment) -> bool {
        self == part || self == Experiment::Paper
    }

    /// Steps of the progress bar for one specimen.
    fn ticks(self, amplitudes: usize) -> usize {
        let parts = [
            (Experiment::Stribeck, lab::SPEEDS.len()),
            (Experiment::Dahl, amplitudes),
            (Experiment::FrequencyResponse, lab::FrequencyResponse::TICKS),
            (Experiment::FastMove, 2),
            (Experiment::FineStep, 2),
            (Experiment::Hunting, lab::BANDWIDTHS.len() * lab::INTEGRALS.len()),
            (Experiment::Rig, lab::RIG_TICKS),
        ];
        parts.iter().filter(|(part, _)| self.includes(*part)).map(|(_, ticks)| ticks).sum()
    }
}

/// Runs the command; results go to `out`, progress to stderr.
pub fn run(args: &ExperimentArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let name = args.experiment.name();
    if !args.amplitudes.is_empty() && args.experiment != Experiment::Dahl {
        return Err(WrongArguments(format!(
            "--amplitudes is for the loops of dahl, not for {name}"
        ))
        .into());
    }
    let amplitudes = amplitudes(args);
    let specimens = specimens(args)?;
    let directory = args
        .out
        .clone()
        .unwrap_or_else(|| directory::dated(Path::new(""), &format!("experiment_{name}")));
    anyhow::ensure!(
        !directory.join("summary.json").exists(),
        "{} holds an experiment already: choose another --out",
        directory.display()
    );
    std::fs::create_dir_all(&directory)
        .with_context(|| format!("cannot create {}", directory.display()))?;
    let settings = Settings { seed: args.seed, rates: Rates::DEFAULT };

    let bar = ProgressBar::new((specimens.len() * args.experiment.ticks(amplitudes.len())) as u64);
    bar.set_style(
        ProgressStyle::with_template("{msg:24} [{bar:40}] {percent:>3} %  {elapsed}")?
            .progress_chars("=> "),
    );
    bar.enable_steady_tick(Duration::from_millis(200));
    bar.set_message(name.clone());
    let keep = |of: &Specimen, recordings: &[LabRecording]| -> anyhow::Result<()> {
        if args.no_bags {
            return Ok(());
        }
        recordings.iter().try_for_each(|recording| {
            let directory =
                directory.join("bags").join(format!("{}_{}", file_name(&of.name), recording.name));
            write_bag(&directory, recording, &name)
        })
    };
    let results: Vec<ExperimentResults> = specimens
        .par_iter()
        .map(|of| measure(args, of, &settings, &|recordings| keep(of, recordings), &|| bar.inc(1)))
        .collect::<anyhow::Result<_>>()?;
    bar.finish_and_clear();
    let results = ExperimentResults::merged(results);

    let mut warnings: Vec<String> = specimens.iter().flat_map(|of| of.warnings.clone()).collect();
    for of in &specimens {
        warnings.extend(
            of.stage.warnings()?.into_iter().map(|warning| format!("{}: {warning}", of.name)),
        );
    }
    let mut statements = Vec::new();
    if args.experiment == Experiment::Paper {
        match paper_results(&results) {
            Some(found) => statements = lab::statements(&found),
            None => warnings.push(
                "the paper's statements need guide_1, guide_2, guide_3 and \
                 guide_1+distributed_bristles: no table"
                    .to_owned(),
            ),
        }
    }
    let fit = paper_fit(&results, &specimens)?;
    let summary = ExperimentSummary {
        schema_version: 1,
        experiment: &name,
        version: env!("CARGO_PKG_VERSION"),
        seed: args.seed,
        guides: specimens.iter().map(|of| of.name.as_str()).collect(),
        statements: &statements,
        stiffness_of_guide_1: fit.as_ref(),
        results: &results,
        warnings: &warnings,
    };
    let (page, figures) = experiment_page(&summary, &specimens)?;
    let write = |name: &str, text: &str| {
        let path = directory.join(name);
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
    };
    for figure in &figures {
        write(&format!("{}.svg", figure.name), &figure.svg)?;
    }
    write("report.html", &page)?;
    let json = serde_json::to_string_pretty(&summary)?;
    write("summary.json", &json)?;
    if args.json {
        writeln!(out, "{json}")?;
    } else {
        write!(out, "{}", summary.text())?;
        writeln!(out, "\nreport {}", directory.join("report.html").display())?;
    }
    // A guide that is not passive is a property of the catalogue's own guides: told, but not what
    // this run is about.
    let failed = statements.iter().any(|statement| !statement.holds);
    let told = specimens.iter().any(|of| !of.warnings.is_empty());
    Ok(if failed || told || (statements.is_empty() && args.experiment == Experiment::Paper) {
        Outcome::Warnings
    } else {
        Outcome::Done
    })
}

/// Amplitudes of the loops, m, ascending.
fn amplitudes(args: &ExperimentArgs) -> Vec<f64> {
    if args.amplitudes.is_empty() {
        return lab::AMPLITUDES.into();
    }
    let mut found = args.amplitudes.clone();
    found.sort_by(f64::total_cmp);
    found.dedup();
    found
}

fn specimens(args: &ExperimentArgs) -> anyhow::Result<Vec<Specimen>> {
    let mut names = args.guides.clone();
    if names.is_empty() && args.model.is_empty() {
        names = GUIDES.map(str::to_owned).into();
        if args.experiment == Experiment::Paper {
            names.push(format!("guide_1{BRISTLES}"));
        }
    }
    let mut found: Vec<Specimen> =
        names.iter().map(|name| specimen(name)).collect::<anyhow::Result<_>>()?;
    for path in &args.model {
        found.push(Specimen::of_model(&StageModel::load(path)?)?);
    }
    for (index, of) in found.iter().enumerate() {
        anyhow::ensure!(
            !found[..index].iter().any(|other| file_name(&other.name) == file_name(&of.name)),
            "two of the guides and models are called `{}`: give each a name of its own",
            of.name
        );
    }
    Ok(found)
}

/// A name as part of a path.
fn file_name(name: &str) -> String {
    name.chars()
        .map(|c| if c.is_ascii_alphanumeric() || "-.".contains(c) { c } else { '_' })
        .collect()
}

fn measure(
    args: &ExperimentArgs,
    of: &Specimen,
    settings: &Settings,
    keep: &(dyn Fn(&[LabRecording]) -> anyhow::Result<()> + Sync),
    tick: &(dyn Fn() + Sync),
) -> anyhow::Result<ExperimentResults> {
    let asked = |part| args.experiment.includes(part);
    let mut results = ExperimentResults::default();
    if asked(Experiment::Stribeck) {
        let (found, recording) = lab::stribeck(of, settings, &lab::SPEEDS, tick)?;
        keep(&[recording])?;
        results.stribeck.push(found);
    }
    if asked(Experiment::Dahl) {
        let (found, recordings) = lab::dahl(of, settings, &amplitudes(args), tick)?;
        keep(&recordings)?;
        if !args.no_bags {
            keep(&[lab::quick_loops(of, settings, &lab::QUICK_LOOPS)?])?;
        }
        results.dahl.push(found);
    }
    if asked(Experiment::FrequencyResponse) {
        let (found, recording) = lab::frequency_response(of, settings, tick)?;
        keep(&[recording])?;
        results.frequency_response.push(found);
    }
    for feedforward in [false, true] {
        if asked(Experiment::FastMove) {
            let (found, recording) = lab::fast_move(of, settings, args.rest, feedforward)?;
            keep(&[recording])?;
            results.fast_move.push(found);
            tick();
        }
        if asked(Experiment::FineStep) {
            let (found, recording) = lab::fine_step(of, settings, args.rest, feedforward)?;
            keep(&[recording])?;
            results.fine_step.push(found);
            tick();
        }
    }
    if asked(Experiment::Hunting) {
        let (found, recordings) =
            lab::hunting(of, settings, &lab::BANDWIDTHS, &lab::INTEGRALS, tick)?;
        keep(&recordings)?;
        results.hunting.push(SpecimenHunting { name: of.name.clone(), results: found });
    }
    if asked(Experiment::Rig) {
        match of.is_plain() {
            true => {
                let (found, recording) = lab::rig(of, settings, tick)?;
                keep(&[recording])?;
                results.rig.push(SpecimenRig { name: of.name.clone(), biases: found });
            }
            // Biases are against closed forms, and those are of a single bristle.
            false if args.experiment == Experiment::Rig => {
                return Err(LabError::Signal {
                    experiment: "rig",
                    specimen: of.name.clone(),
                    what: "has effects beside the LuGre guide, so no closed form to compare with"
                        .to_owned(),
                }
                .into());
            }
            false => (0..lab::RIG_TICKS).for_each(|_| tick()),
        }
    }
    Ok(results)
}

/// What the table of statements needs, if it is there.
fn paper_results(results: &ExperimentResults) -> Option<PaperResults<'_>> {
    fn three<'a, T>(all: impl Fn(&str) -> Option<&'a T>) -> Option<[&'a T; 3]> {
        Some([all("guide 1")?, all("guide 2")?, all("guide 3")?])
    }
    let fast = |fed: bool| {
        three(move |name| results.fast_move.iter().filter(|f| f.name == name).nth(usize::from(fed)))
    };
    Some(PaperResults {
        stribeck: three(|name| results.stribeck.iter().find(|found| found.name == name))?,
        dahl: three(|name| results.dahl.iter().find(|found| found.name == name))?,
        distributed: results.dahl.iter().find(|found| found.name == "guide 1 distributed")?,
        response: three(|name| results.frequency_response.iter().find(|found| found.name == name))?,
        fast: fast(false)?,
        fast_fed: fast(true)?,
        fine: three(|name| results.fine_step.iter().find(|found| found.name == name))?,
        hunting: three(|name| results.hunting.iter().find(|found| found.name == name))?
            .map(|found| found.results.as_slice()),
        rig: &results.rig.iter().find(|found| found.name == "guide 1")?.biases,
    })
}

/// Guide 1's three stated stiffnesses against one bristle and three, where both were measured.
fn paper_fit(
    results: &ExperimentResults,
    specimens: &[Specimen],
) -> anyhow::Result<Option<StiffnessFit>> {
    let find = |name: &str| results.dahl.iter().find(|found| found.name == name);
    let (Some(single), Some(distributed)) = (find("guide 1"), find("guide 1 distributed")) else {
        return Ok(None);
    };
    let Some(of) = specimens.iter().find(|of| of.name == "guide 1") else { return Ok(None) };
    let static_force = of.guide()?.static_force;
    let best_single = lab::best_single(&lab::STATED_STIFFNESS, static_force);
    Ok(Some(StiffnessFit {
        best_single_stiffness: best_single,
        distributed: lab::fit_stated(static_force)?,
        errors: lab::stiffness_errors(single, distributed, best_single, static_force),
    }))
}
