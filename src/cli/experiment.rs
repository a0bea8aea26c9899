//! `friction-stage experiment`: the laboratory of the paper, one experiment or all of them.

pub(super) mod bags;
mod parts;

use std::io::Write;
use std::path::Path;

use anyhow::Context as _;
use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};

use self::bags::write_bag;
use self::parts::{PLAN, Parts, plan_text};
use super::progress::Progress;
use super::{Outcome, WrongArguments};
use crate::directory::ResultsArgs;
use crate::interrupt;
use friction_stage_core::plant::model_named;
use friction_stage_lab::{
    self as lab, Experiment, ExperimentPlan, ExperimentResults, Keep, KeptParts, LabError,
    LabRecording, Settings, Specimen,
};
use friction_stage_report::experiment::{ExperimentSummary, experiment_page};

/// Run an experiment of the paper on the measuring rig or on the 40 kg stage, in this process.
///
/// Reduces what encoder and force cell read, noise included, to curves, and writes bags, figures
/// (SVG), summary.json and one self-contained report.html. `paper` runs all of them and checks
/// every statement of the paper.
///
/// What is measured of a guide is kept in `parts` until the end, so that --resume continues a run
/// that was stopped.
///
/// Exit code: 0 done, 1 failed, 2 wrong arguments, 3 done with warnings, for instance a statement
/// that does not hold.
#[derive(Debug, Clone, Args)]
#[command(
    after_help = "Examples:\n  friction-stage experiment stribeck\n  friction-stage experiment \
                  dahl --guides guide_1,guide_1+distributed_bristles --out dahl\n  friction-stage \
                  experiment fast-move --model my_stage.yaml\n  friction-stage experiment paper \
                  --out paper && xdg-open paper/report.html\n  friction-stage experiment paper \
                  --out paper --resume   # after Ctrl-C\n  friction-stage experiment fine-step \
                  --distance 1e-6 --duration 2e-3 --bandwidth 90"
)]
pub struct ExperimentArgs {
    /// What to run
    #[arg(value_enum, value_name = "NAME")]
    pub experiment: Named,
    /// Guides by catalogue name; +distributed_bristles takes the catalogue's parallel bristles
    /// [default: the paper's three]
    #[arg(long, value_delimiter = ',', value_name = "GUIDES", value_parser = guide_name)]
    pub guides: Vec<String>,
    /// Stages, or rigs with a coupling, in addition to the guides: model files or names as those
    /// of the guides
    #[arg(long, value_name = "MODEL")]
    pub model: Vec<String>,
    #[command(flatten)]
    pub results: ResultsArgs,
    /// Go on with a run that was stopped, in --out: what it has measured is not measured again
    #[arg(long, conflicts_with = "force", requires = "out")]
    pub resume: bool,
    /// Amplitudes of the loops of `dahl`, m [default: twelve from 10e-9 to 1e-3]
    #[arg(long, value_delimiter = ',', value_name = "METRES", value_parser = amplitude)]
    pub amplitudes: Vec<f64>,
    /// Way of the move of fast-move or the step of fine-step, m [default: 50e-3 or 10e-6]
    #[arg(long, value_name = "METRES")]
    pub distance: Option<f64>,
    /// Time of that move or step, s [default: 0.1 or 3e-3]
    #[arg(long, value_name = "SECONDS")]
    pub duration: Option<f64>,
    /// Mass of the stage in fast-move and fine-step, kg [default: that of the model]
    #[arg(long, value_name = "KG")]
    pub mass: Option<f64>,
    /// Bandwidth of the controller in fast-move and fine-step, Hz [default: 60]
    #[arg(long, value_name = "HZ")]
    pub bandwidth: Option<f64>,
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

/// An experiment of the laboratory as an argument.
#[derive(Debug, Clone, Copy)]
pub struct Named(pub Experiment);

impl ValueEnum for Named {
    fn value_variants<'a>() -> &'a [Named] {
        const NAMED: [Named; Experiment::ALL.len()] = {
            let mut all = [Named(Experiment::Paper); Experiment::ALL.len()];
            let mut index = 0;
            while index < all.len() {
                all[index] = Named(Experiment::ALL[index]);
                index += 1;
            }
            all
        };
        &NAMED
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.0.name()).help(self.0.description()))
    }
}

fn guide_name(text: &str) -> Result<String, String> {
    Specimen::named(text).map(|_| text.to_owned()).map_err(|error| error.to_string())
}

fn number(text: &str, check: fn(f64) -> Result<(), LabError>) -> Result<f64, String> {
    let value = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    check(value).map_err(|error| error.to_string())?;
    Ok(value)
}

fn rest_seconds(text: &str) -> Result<f64, String> {
    number(text, lab::check_rest)
}

fn amplitude(text: &str) -> Result<f64, String> {
    number(text, lab::check_amplitude)
}

/// Parts that are named where a run is interrupted.
const MOST_NAMED: usize = 6;

/// Runs the command; results go to `out`, progress to stderr.
pub fn run(args: &ExperimentArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let experiment = args.experiment.0;
    let name = experiment.name();
    if !args.amplitudes.is_empty() && experiment != Experiment::Dahl {
        return Err(WrongArguments(format!(
            "--amplitudes is for the loops of dahl, not for {name}"
        ))
        .into());
    }
    let named = args.guides.iter().map(|name| Ok(Specimen::named(name)?));
    let modelled = args.model.iter().map(|name| match Specimen::named(name) {
        Ok(specimen) => Ok(specimen),
        Err(_) => Ok(Specimen::of_model(&model_named(name)?)?),
    });
    let specimens = named.chain(modelled).collect::<anyhow::Result<Vec<Specimen>>>()?;
    let plan = ExperimentPlan {
        settings: Settings { seed: args.seed, ..Settings::default() },
        rest: args.rest,
        ..ExperimentPlan::new(experiment, specimens)?
    }
    .with_amplitudes(&args.amplitudes)?
    .with_move(args.distance, args.duration, args.mass, args.bandwidth)
    .map_err(|error| match error {
        LabError::NoMove { .. } | LabError::Limit { .. } | LabError::Model(_) => {
            anyhow::Error::from(WrongArguments(error.to_string()))
        }
        other => other.into(),
    })?;
    let plan_text = plan_text(&plan)?;
    if args.resume
        && let Some(complete) = args.results.complete()
        && std::fs::read_to_string(complete.join(PLAN)).is_ok_and(|known| known == plan_text)
    {
        return shown_again(&complete, args.json, out);
    }
    let results = args.results.directory(&format!("experiment_{name}"))?;
    results.create()?;
    if args.resume && !results.path().exists() {
        eprintln!("note: nothing to resume in {}: from the beginning", results.path().display());
    }
    let parts = Parts::open(results.path(), &plan, args.resume, args.results.force)?;
    let (kept, place) = (parts.clone(), results.path().to_owned());
    interrupt::remind(move || {
        let measured = match kept.measured().as_slice() {
            [] => "no part is measured to its end".to_owned(),
            [one] => format!("measured to its end is {one}"),
            names if names.len() <= MOST_NAMED => {
                format!("measured to their end are {}", names.join(", "))
            }
            names => format!("{} parts are measured to their end", names.len()),
        };
        format!("{measured}; continue with --resume --out {}", place.display())
    });

    let progress = Progress::of(plan.ticks() as u64, name);
    let keep = |of: &Specimen, recordings: &[LabRecording]| -> anyhow::Result<()> {
        recordings.iter().try_for_each(|recording| {
            let name_of_bag = format!("{}_{}", of.file_name(), recording.name);
            let bag = results.path().join("bags").join(name_of_bag);
            if (args.results.force || args.resume) && bag.exists() {
                std::fs::remove_dir_all(&bag)
                    .with_context(|| format!("cannot replace {}", bag.display()))?;
            }
            write_bag(&bag, recording, name)
        })
    };
    let keep: Option<&Keep<'_, anyhow::Error>> = if args.no_bags { None } else { Some(&keep) };
    let kept = KeptParts {
        load: &|of: &Specimen, part: Experiment| parts.load(of, part),
        save: &|of: &Specimen, part: Experiment, found: &ExperimentResults| {
            parts.save(of, part, found)
        },
    };
    let found = plan.run_on(keep, Some(&kept), &|| progress.step()).inspect_err(|_| {
        // Nothing to go on with.
        if parts.measured().is_empty() {
            let _ = parts.remove().map(|()| std::fs::remove_dir(results.path()));
        }
    })?;
    drop(progress);
    let summary = ExperimentSummary::new(&plan, &found, results.path().join("bags").is_dir());
    let (page, figures) = experiment_page(&summary, &plan.specimens)?;
    for figure in &figures {
        results.write(&format!("{}.svg", figure.name), &figure.svg)?;
    }
    results.write("report.html", &page)?;
    results.write(PLAN, &plan_text)?;
    let json = serde_json::to_string_pretty(&summary)?;
    results.write("summary.json", &json)?;
    parts.remove()?;
    if args.json {
        writeln!(out, "{json}")?;
    } else {
        write!(out, "{}", summary.text())?;
        writeln!(out, "\nreport {}", results.path().join("report.html").display())?;
    }
    let failed = found.statements.iter().any(|statement| !statement.holds);
    Ok(Outcome::warned(failed || !found.findings.is_empty()))
}

/// What a run that came to its end found, of which there is nothing to resume.
fn shown_again(results: &Path, as_json: bool, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let path = results.join("summary.json");
    let text = std::fs::read_to_string(&path)
        .with_context(|| format!("cannot read {}", path.display()))?;
    let summary: serde_json::Value =
        serde_json::from_str(&text).with_context(|| format!("cannot read {}", path.display()))?;
    if as_json {
        writeln!(out, "{text}")?;
    } else {
        eprintln!("note: {} is complete: there is nothing to resume", results.display());
        writeln!(out, "report {}", results.join("report.html").display())?;
    }
    let each = |key: &str| summary[key].as_array().cloned().unwrap_or_default();
    let failed = each("statements").iter().any(|statement| statement["holds"] == false);
    Ok(Outcome::warned(failed || !each("warnings").is_empty()))
}
