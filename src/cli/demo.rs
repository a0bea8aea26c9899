//! `friction-stage demo`: the main job, with nothing else installed.

mod recordings;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;

use anyhow::Context as _;
use clap::{Args, Subcommand};
use serde::Serialize;

use super::progress::Progress;
use super::sync::SyncArgs;
use super::{Outcome, WrongArguments};
use crate::cpu;
use crate::directory;
use crate::interrupt::{self, Patience};
use crate::made_by;
use crate::node::driver::{Driver, LockstepRun};
use friction_stage_core::model::StageModel;
use friction_stage_core::plant::model_named;
use friction_stage_data::bag::{BagReader, LOCKSTEP_EPOCH, topics};
use friction_stage_data::message::ControllerState;
use friction_stage_lab::{
    Conditioning, Move, MoveKind, MoveResult, PaperMotion, Specimen, settling,
};
use friction_stage_report::figure::svg;
use friction_stage_report::paper_motion::{PositionErrorSeries, demo_page, position_error_charts};
use friction_stage_report::words::guide_label;

/// Run the stage of the paper on its three guides, over ROS 2.
///
/// Starts the stage node and the controller node as two processes in lockstep on loopback, for each
/// guide: 50 mm return move and rest, 50 mm forward and return in 100 ms each, then steps of 10 µm
/// in 3 ms. Records a bag of each run, draws the position error over time, as the paper's Figures 6
/// and 7, and writes a page with both.
#[derive(Debug, Clone, Args)]
#[command(
    args_conflicts_with_subcommands = true,
    after_help = "Examples:\n  friction-stage demo --guides guide_2 --out one_guide\n  \
                  friction-stage demo recordings   # recordings to try identify on\n\nWatch it \
                  from another terminal, in the domain that it prints:\n  \
                  ROS_DOMAIN_ID=... ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ros2 topic echo \
                  /controller/state"
)]
pub struct DemoArgs {
    #[command(subcommand)]
    other: Option<Demo>,
    /// Guides to run, by catalogue name, with commas between them; +distributed_bristles takes the
    /// catalogue's parallel bristles
    #[arg(long, value_delimiter = ',', value_name = "GUIDES", default_value = &**GUIDES)]
    pub guides: Vec<String>,
    /// Directory for bags and figures [default: demo_ and the date]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Replace the bags and figures that the directory holds
    #[arg(long)]
    pub force: bool,
    /// Rest after a return move, before the fast move and before the steps, simulated seconds; the
    /// paper: a minute
    #[arg(long, default_value_t = Conditioning::DEMO_REST, value_name = "SECONDS",
          value_parser = rest_seconds)]
    pub rest: f64,
    /// Steps of 10 µm
    #[arg(long, default_value_t = FINE_STEPS, value_name = "N")]
    pub fine_steps: usize,
    /// Seed of the sensor noise
    #[arg(long, default_value_t = 1)]
    pub seed: u32,
    #[command(flatten)]
    pub sync: SyncArgs,
    /// ROS domain of the run [default: one that no other process here uses]
    #[arg(long, value_name = "ID", value_parser = clap::value_parser!(u16).range(0..=232))]
    pub domain: Option<u16>,
    /// Print JSON instead of a table
    #[arg(long)]
    pub json: bool,
}

/// What the demo makes in place of runs over ROS 2.
#[derive(Debug, Clone, Subcommand)]
enum Demo {
    Recordings(recordings::RecordingsArgs),
}

const FINE_STEPS: usize = 5;

/// The models of the paper's three guides, as --guides takes them.
static GUIDES: LazyLock<String> = LazyLock::new(|| {
    Specimen::PAPER_GUIDES.map(|name| name.to_owned() + StageModel::PARALLEL_BRISTLES).join(",")
});

fn rest_seconds(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    match (0.0..=3600.0).contains(&value) {
        true => Ok(value),
        false => Err(format!("{value} must be between 0 and 3600 s")),
    }
}

/// The guide of a model of --guides.
fn plain(model: &str) -> &str {
    model.strip_suffix(StageModel::PARALLEL_BRISTLES).unwrap_or(model)
}

impl Default for DemoArgs {
    fn default() -> Self {
        DemoArgs {
            other: None,
            guides: GUIDES.split(',').map(str::to_owned).collect(),
            out: None,
            force: false,
            rest: Conditioning::DEMO_REST,
            fine_steps: FINE_STEPS,
            seed: 1,
            sync: SyncArgs::default(),
            domain: None,
            json: false,
        }
    }
}

/// What one guide showed.
#[derive(Debug, Serialize)]
struct GuideResult {
    /// Its name in the catalogue.
    guide: String,
    /// What the stage node had as its model.
    model: String,
    moves: Vec<MoveRow>,
    cycles: u64,
    cycles_per_second: f64,
    bag: PathBuf,
    figure: PathBuf,
}

#[derive(Debug, Serialize)]
struct MoveRow {
    name: &'static str,
    peak_error_um: f64,
    /// Within 10 µm, 1 µm and 0.1 µm of the reference after its arrival; null where it stayed
    /// outside.
    settling_ms: [Option<f64>; 3],
}

/// Runs the command; results go to `out`, progress to stderr.
pub fn run(args: &DemoArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    if let Some(Demo::Recordings(recordings)) = &args.other {
        return recordings::run(recordings, out);
    }
    let models = &args.guides;
    let guides: Vec<&str> = models.iter().map(|model| plain(model)).collect();
    for (index, (model, guide)) in models.iter().zip(&guides).enumerate() {
        StageModel::on_guides(guide).check()?;
        model_named(model)?;
        if guides[..index].contains(guide) {
            return Err(WrongArguments(format!(
                "--guides has two models on {guide}, whose bag would be the same: run the other \
                 one in another --out"
            ))
            .into());
        }
    }
    let directory = args.out.clone().unwrap_or_else(|| directory::dated(Path::new(""), "demo"));
    for bag in guides.iter().map(|guide| directory.join(guide)).filter(|bag| bag.exists()) {
        if !args.force {
            return Err(WrongArguments(format!(
                "{} holds a demo already: choose another --out, or replace it with --force",
                directory.display()
            ))
            .into());
        }
        std::fs::remove_dir_all(&bag)
            .with_context(|| format!("cannot replace {}", bag.display()))?;
    }
    if directory.join(made_by::FILE).exists() && !args.force {
        return Err(WrongArguments(format!(
            "{} holds results already: choose another --out, or replace them with --force",
            directory.display()
        ))
        .into());
    }
    let patience = Patience::begin();
    interrupt::writes(&directory);
    std::fs::create_dir_all(&directory)
        .with_context(|| format!("cannot create {}", directory.display()))?;
    let motion = PaperMotion::new(args.rest, args.fine_steps);
    let seconds = motion.duration() as f64 * 1e-9;
    let steps = (1000.0 * seconds * args.guides.len() as f64) as u64;
    let progress = Progress::of(steps, "starting");
    let program = std::env::current_exe()?;
    // Both nodes on the last processor, the recorder on the others.
    let cpu = format!("cpu:={}", cpu::online() - 1);
    let mut results = Vec::new();
    let mut errors = Vec::new();
    let mut incomplete = Vec::new();
    for (index, (model, &guide)) in models.iter().zip(&guides).enumerate() {
        interrupt::check()?;
        progress.say(format!("{guide}: starting"));
        let bag = directory.join(guide);
        let run = LockstepRun {
            stage_arguments: parameters(&[
                format!("model:={model}"),
                format!("seed:={}", args.seed),
                format!("record:={}", bag.display()),
                args.sync.parameter(),
                cpu.clone(),
            ]),
            controller_arguments: parameters(std::slice::from_ref(&cpu)),
            points: motion.points.clone(),
            log_stem: bag.clone(),
        };
        // Loopback only, whatever the environment says: a demo must not show up on the network.
        let driver = Driver::on_loopback(&program, args.domain)?;
        let domain = driver.domain();
        progress.line(&format!(
            "{guide}: ROS domain {domain} on loopback; watch it with ROS_DOMAIN_ID={domain} \
             ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST ros2 topic echo /controller/state"
        ));
        let done = driver.run(&run, &mut |time| {
            progress.say(format!("{guide}: {:.1}/{seconds:.1} s", time.min(seconds)));
            progress.reach((1000.0 * (index as f64 * seconds + time.min(seconds))) as u64);
        })?;
        if done.incomplete {
            incomplete.push(bag.display().to_string());
        }
        let measured = read_errors(&bag)?;
        let figure = directory.join(format!("{guide}.svg"));
        let name = guide_label(guide);
        let one = [(name.clone(), measured.clone())];
        write_figure(&figure, &format!("40 kg stage on four guides: {name}"), &motion, &one)?;
        results.push(GuideResult {
            guide: guide.to_owned(),
            model: model.clone(),
            moves: rows(&motion, &measured)
                .with_context(|| format!("{} is not whole", bag.display()))?,
            cycles: done.cycles,
            cycles_per_second: done.rate,
            bag,
            figure,
        });
        errors.push((name, measured));
    }
    drop((progress, patience));
    interrupt::check()?;
    let overview = directory.join("all_guides.svg");
    write_figure(&overview, "40 kg stage on four guides", &motion, &errors)?;
    let page = directory.join("report.html");
    let rows: Vec<_> = results
        .iter()
        .flat_map(|result| result.moves.iter().map(|row| (guide_label(&result.guide), row)))
        .map(|(guide, row)| (guide, row.name, row.peak_error_um, row.settling_ms))
        .collect();
    let bags: Vec<String> = results.iter().map(|result| result.bag.display().to_string()).collect();
    let html = demo_page(&position_error_charts(&motion, &errors), &rows, &bags)?;
    made_by::write(&directory)?;
    std::fs::write(&page, made_by::signed("report.html", &html))
        .with_context(|| format!("cannot write {}", page.display()))?;
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&results)?)?;
    } else {
        print(out, &results, &overview)?;
        writeln!(out, "\nopen {}", page.display())?;
    }
    for bag in &incomplete {
        eprintln!("warning: {bag} lacks samples; its log says how many");
    }
    Ok(Outcome::warned(!incomplete.is_empty()))
}

fn parameters(given: &[String]) -> Vec<String> {
    given.iter().flat_map(|parameter| ["-p".to_owned(), parameter.clone()]).collect()
}

/// Position errors in a bag, as the controller saw them.
fn read_errors(bag: &Path) -> anyhow::Result<PositionErrorSeries> {
    let reader = BagReader::open(bag)?;
    let mut errors = Vec::new();
    for message in reader.messages() {
        let message = message?;
        if message.topic.name == topics::CONTROLLER_STATE {
            let state: ControllerState = message.decode()?;
            if state.enabled && state.sample > 0 {
                errors.push((state.header.stamp.to_nanos() - LOCKSTEP_EPOCH, state.error));
            }
        }
    }
    anyhow::ensure!(!errors.is_empty(), "{} holds no state of the controller", bag.display());
    errors.sort_by_key(|(time, _)| *time);
    Ok(errors)
}

fn shown(motion: &PaperMotion) -> impl Iterator<Item = (&'static str, &Move)> {
    [
        ("50 mm forward", MoveKind::FastForward),
        ("50 mm return", MoveKind::FastReturn),
        ("10 µm step", MoveKind::FineStep),
    ]
    .into_iter()
    .filter_map(|(name, kind)| {
        motion.moves.iter().find(|the_move| the_move.kind == kind).map(|found| (name, found))
    })
}

fn rows(motion: &PaperMotion, errors: &PositionErrorSeries) -> anyhow::Result<Vec<MoveRow>> {
    shown(motion)
        .map(|(name, the_move)| {
            let MoveResult { peak_error, settling } = settling(the_move, errors.iter().copied())
                .with_context(|| format!("no state of the controller during {name}"))?;
            let settling_ms = settling.map(|time| time.map(|seconds| seconds * 1e3));
            Ok(MoveRow { name, peak_error_um: peak_error * 1e6, settling_ms })
        })
        .collect()
}

fn write_figure(
    path: &Path,
    title: &str,
    motion: &PaperMotion,
    runs: &[(String, PositionErrorSeries)],
) -> anyhow::Result<()> {
    let text = svg(title, &position_error_charts(motion, runs))?;
    std::fs::write(path, made_by::signed("errors.svg", &text))
        .with_context(|| format!("cannot write {}", path.display()))
}

fn print(out: &mut dyn Write, results: &[GuideResult], overview: &Path) -> std::io::Result<()> {
    writeln!(
        out,
        "                          peak error    time to settle within, ms     lockstep"
    )?;
    writeln!(
        out,
        "guide    move                     µm     10 µm      1 µm    0.1 µm    cycles/s"
    )?;
    for result in results {
        for (index, row) in result.moves.iter().enumerate() {
            let guide = if index == 0 { result.guide.as_str() } else { "" };
            let rate =
                if index == 0 { format!("{:.0}", result.cycles_per_second) } else { String::new() };
            let [ten, one, tenth] = row
                .settling_ms
                .map(|time| time.map_or("never".to_owned(), |ms| format!("{ms:.1}")));
            writeln!(
                out,
                "{guide:8} {:16} {:10.2} {ten:>9} {one:>9} {tenth:>9} {rate:>11}",
                row.name, row.peak_error_um
            )?;
        }
    }
    writeln!(out)?;
    for result in results {
        writeln!(
            out,
            "{}: model {}, bag {}, figure {}",
            result.guide,
            result.model,
            result.bag.display(),
            result.figure.display()
        )?;
    }
    writeln!(out, "all guides: figure {}", overview.display())
}
