//! How well identification does on recordings whose hidden effects it does not know: false alarms,
//! right names, detection over size, effects that are in no list, and several at once.
//!
//! `cargo bench -p blind-tests --bench identify -- none --runs 200`, `names --runs 3`,
//! `power --only cogging --floors 0.5,1,2`, `unlisted`, `mixed --runs 20`, and `criteria --runs 12`
//! for what 30 % more or less of each criterion of the search changes; `--json` writes one JSON
//! object per run instead of text. The recordings come from this crate, which shares no equation,
//! integrator, controller or noise source with the library; the declared model is the nominal one
//! of the recorded stage runs. One line per run on stdout, as soon as it is known, then a summary;
//! progress on stderr.

#[path = "../tests/declared/mod.rs"]
mod declared;

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context as _, Result, bail};
use clap::{Parser, Subcommand};
use friction_stage_core::model::{Coordinate, StageModel};
use friction_stage_core::numerics::TWO_SIDED_95;
use friction_stage_identify::{
    Criteria, Estimate, Evidence, Hypothesis, IdentifyError, Measured, NominalParameter, Outcome,
    ParameterId, Selection, Tolerances, Verdict, Watch, search_by,
};
use serde::Serialize;

use blind_tests::effects::{self, CATALOGUE, LISTED};
use blind_tests::noise::Noise;
use blind_tests::{Columns, Effect, GeneratedRun, Programme, RecordTruth, SensorNoise, Setup};
use declared::declared;

#[derive(Parser)]
#[command(about = "Blind tests of identification")]
struct Arguments {
    #[command(subcommand)]
    what: What,
    /// First seed; each run takes the next.
    #[arg(long, global = true, default_value_t = 1)]
    first: u64,
    /// Vary speeds, amplitudes, strokes and rests of the motion from run to run.
    #[arg(long, global = true)]
    varied: bool,
    /// Draw the noise of either sensor from a third of what is declared to ten times it.
    #[arg(long, global = true)]
    noises: bool,
    /// Draw rate, encoder and its instants of another machine for each run.
    #[arg(long, global = true)]
    machines: bool,
    /// Counts of the encoder, m, in place of 1 nm.
    #[arg(long, global = true)]
    counts: Option<f64>,
    /// No force cell.
    #[arg(long, global = true)]
    no_cell: bool,
    /// One JSON object per run and one for the summary.
    #[arg(long, global = true)]
    json: bool,
    /// Also write the recordings of each run, to bags/EFFECTS-SEED and truth/EFFECTS-SEED in this
    /// folder.
    #[arg(long, global = true)]
    keep: Option<PathBuf>,
    /// Cargo says so to every bench.
    #[arg(long, global = true, hide = true)]
    bench: bool,
}

#[derive(Subcommand)]
enum What {
    /// Nothing hidden: how often is something found?
    None {
        #[arg(long, default_value_t = 8)]
        runs: u64,
    },
    /// Each listed effect at its usual size: is it named?
    Names {
        /// Per effect.
        #[arg(long, default_value_t = 1)]
        runs: u64,
        /// Only these effects, with commas between them.
        #[arg(long, value_delimiter = ',')]
        only: Vec<String>,
    },
    /// Each listed effect over its size: how often is it detected and named? By itself it looks for
    /// the size, from 1 floor on by factors of 2, at which half of the runs detect the effect, and
    /// goes to five times that on other stages.
    Power {
        /// Only these effects, with commas between them.
        #[arg(long, value_delimiter = ',')]
        only: Vec<String>,
        /// These sizes in place of the search: held-out force in floors of the sensors' noise.
        #[arg(long, value_delimiter = ',')]
        floors: Vec<f64>,
        /// Per effect and size.
        #[arg(long, default_value_t = 3)]
        runs: u64,
        /// Per effect at five times the size that half of the runs detect.
        #[arg(long, default_value_t = 4)]
        large: u64,
    },
    /// Effects that no candidate expresses: is the answer "unknown", with the right coordinate?
    Unlisted {
        /// Per effect.
        #[arg(long, default_value_t = 1)]
        runs: u64,
        /// Only these effects, with commas between them.
        #[arg(long, value_delimiter = ',')]
        only: Vec<String>,
    },
    /// One to three effects at once.
    Mixed {
        #[arg(long, default_value_t = 6)]
        runs: u64,
        /// Out of these effects, with commas between them; without it out of all that are listed.
        #[arg(long, value_delimiter = ',')]
        only: Vec<String>,
    },
    /// What 30 % less and 30 % more of each criterion of the search changes: the same recordings,
    /// with one to three effects, nothing, or an effect that no candidate expresses.
    Criteria {
        /// Recordings: half of them of effects that are listed, a quarter of nothing.
        #[arg(long, default_value_t = 12)]
        runs: u64,
        /// Only these criteria, with commas between them.
        #[arg(long, value_delimiter = ',')]
        only: Vec<String>,
    },
}

/// What a run shows.
#[derive(Serialize)]
struct Report {
    seed: u64,
    /// Of the usual size.
    factor: f64,
    /// Size that was asked for, floors; 0 where none was.
    size: f64,
    noise: SensorNoise,
    /// Hz
    rate: f64,
    hidden: Vec<Hidden>,
    verdict: &'static str,
    /// Names that were found, without maps.
    found: Vec<&'static str>,
    coordinate: Option<&'static str>,
    inseparable: Vec<(&'static str, &'static str)>,
    /// Something other than "none".
    detected: bool,
    /// Verdict and names (or coordinate) as they should be.
    right: bool,
    /// The verdict says that what is hidden is not separable from what was found.
    open: bool,
    explained_share: f64,
    /// Held-out force residual of motor and carriage side, N rms.
    before: [f64; 2],
    after: [f64; 2],
    floor: [f64; 2],
    /// Parameters that a truth of the same name exists for: distance in standard deviations.
    deviations: BTreeMap<String, f64>,
    evidence: Vec<Candidate>,
    parameters: Vec<String>,
    seconds: f64,
}

/// A hidden effect as the filtered held-out record shows it.
#[derive(Serialize)]
struct Hidden {
    name: &'static str,
    listed: bool,
    coordinate: Option<&'static str>,
    parameters: BTreeMap<&'static str, f64>,
    /// Force that it adds or feigns, N rms in the band that is compared.
    force: f64,
    /// The same in floors of its side.
    floors: f64,
}

#[derive(Serialize)]
struct Candidate {
    round: usize,
    name: &'static str,
    free: usize,
    train_gain: f64,
    holdout_gain: f64,
    /// Of the score, which decides.
    fall: f64,
    outcome: String,
}

/// Progress on stderr where it is a terminal.
struct Progress(indicatif::ProgressBar);

impl Watch for Progress {
    fn progress(&self, what: &str, share: f64) {
        self.0.set_position((1000.0 * share) as u64);
        self.0.set_message(what.to_owned());
    }
}

fn main() -> Result<()> {
    let arguments = Arguments::parse();
    let mut session = Session {
        arguments: &arguments,
        criteria: Criteria::USUAL,
        size: 0.0,
        reports: Vec::new(),
    };
    match &arguments.what {
        What::None { runs } => {
            for seed in session.seeds(*runs) {
                session.run(seed, 1.0, Vec::new())?;
            }
        }
        What::Names { runs, only } => session.each(&CATALOGUE[..LISTED], *runs, only)?,
        What::Unlisted { runs, only } => session.each(&CATALOGUE[LISTED..], *runs, only)?,
        What::Power { only, floors, runs, large } => {
            for name in chosen(&CATALOGUE[..LISTED], only)? {
                for &size in floors {
                    session.of_size(name, size, session.arguments.first, *runs)?;
                }
                if floors.is_empty() {
                    session.threshold(name, *runs, *large)?;
                }
            }
        }
        What::Mixed { runs, only } => {
            let wanted = chosen(&CATALOGUE[..LISTED], only)?;
            let list: Vec<_> =
                CATALOGUE.iter().copied().filter(|(name, _)| wanted.contains(name)).collect();
            for seed in session.seeds(*runs) {
                let count = 1 + (seed % 3) as usize;
                session.run(seed, 1.0, effects::composition(&list, count, seed))?;
            }
        }
        What::Criteria { runs, only } => return session.criteria(*runs, only),
    }
    session.summary()
}

fn drawn(name: &str, seed: u64) -> Result<Effect> {
    effects::by_name(name, seed).with_context(|| {
        let known: Vec<&str> = CATALOGUE.iter().map(|(name, _)| *name).collect();
        format!("no effect {name}: one of {}", known.join(", "))
    })
}

/// Names of a list, those that are asked for.
fn chosen(list: &[(&'static str, effects::Draw)], only: &[String]) -> Result<Vec<&'static str>> {
    if let Some(strange) = only.iter().find(|name| list.iter().all(|(known, _)| known != name)) {
        let known: Vec<&str> = list.iter().map(|(name, _)| *name).collect();
        bail!("no effect {strange} here: one of {}", known.join(", "));
    }
    let wanted = |name: &str| only.is_empty() || only.iter().any(|one| one == name);
    Ok(list.iter().map(|(name, _)| *name).filter(|name| wanted(name)).collect())
}

struct Session<'a> {
    arguments: &'a Arguments,
    criteria: Criteria,
    /// Size that the next run is made for, floors.
    size: f64,
    reports: Vec<Report>,
}

/// Factors on a criterion whose effect is shown.
const CHANGES: [f64; 2] = [0.7, 1.3];

impl Session<'_> {
    /// The same recordings with the usual criteria, and with one of them changed.
    fn criteria(&mut self, runs: u64, only: &[String]) -> Result<()> {
        if let Some(strange) = only.iter().find(|name| !Criteria::NAMES.contains(&name.as_str())) {
            bail!("no criterion {strange}: one of {}", Criteria::NAMES.join(", "));
        }
        let usual = self.answers(runs)?;
        let right = |answers: &[(String, bool)]| answers.iter().filter(|(_, right)| *right).count();
        println!(
            "\n{:20} {:>8} {:>8} {:>8}  answers that change",
            "criterion", "", "value", "right"
        );
        println!("{:20} {:>8} {:>8} {:>8}  of {}", "all", "", "usual", right(&usual), usual.len());
        for name in Criteria::NAMES {
            if !only.is_empty() && !only.iter().any(|one| one == name) {
                continue;
            }
            for change in CHANGES {
                self.criteria = Criteria::USUAL;
                let value = self.criteria.by_name(name).context("a criterion of the list")?;
                *value *= change;
                let value = *value;
                let answers = self.answers(runs)?;
                let changed = answers.iter().zip(&usual).filter(|(one, other)| one.0 != other.0);
                let changed: Vec<String> =
                    changed.map(|(now, before)| format!("{} -> {}", before.0, now.0)).collect();
                println!(
                    "{name:20} {change:8.1} {value:8.3} {:8}  {}",
                    right(&answers),
                    if changed.is_empty() { "none".to_owned() } else { changed.join("; ") }
                );
            }
        }
        Ok(())
    }

    /// Verdict and names of each recording, and whether they are right.
    fn answers(&mut self, runs: u64) -> Result<Vec<(String, bool)>> {
        let mut answers = Vec::new();
        for seed in self.seeds(runs) {
            let list = match seed % 4 {
                0 => Vec::new(),
                1 => {
                    let list = &CATALOGUE[LISTED..];
                    let (name, _) = list[(seed / 4) as usize % list.len()];
                    vec![drawn(name, seed)?]
                }
                few => effects::composition(&CATALOGUE[..LISTED], few as usize - 1, seed),
            };
            self.reports.clear();
            self.run(seed, 1.0, list)?;
            answers.push(match self.reports.first() {
                Some(report) => (
                    format!("{seed}: {} [{}]", report.verdict, report.found.join(" + ")),
                    report.right || report.open,
                ),
                None => (format!("{seed}: refused"), false),
            });
        }
        Ok(answers)
    }

    fn seeds(&self, runs: u64) -> std::ops::Range<u64> {
        self.arguments.first..self.arguments.first + runs
    }

    fn each(
        &mut self,
        list: &[(&'static str, effects::Draw)],
        runs: u64,
        only: &[String],
    ) -> Result<()> {
        for seed in self.seeds(runs) {
            for name in chosen(list, only)? {
                self.run(seed, 1.0, vec![drawn(name, seed)?])?;
            }
        }
        Ok(())
    }

    fn setup(&self, seed: u64, hidden: Vec<Effect>) -> Setup {
        let mut setup = Setup::new(seed).with_all(hidden);
        if self.arguments.varied {
            setup.programme = Programme::Varied;
        }
        if self.arguments.noises {
            let mut drawn = Noise::new(seed, 11);
            setup.noise.encoder *= drawn.log_between(1.0 / 3.0, 10.0);
            setup.noise.cell *= drawn.log_between(1.0 / 3.0, 10.0);
        }
        if self.arguments.machines {
            setup = setup.drawing_machine();
        }
        if let Some(counts) = self.arguments.counts {
            (setup.noise.encoder, setup.noise.count) = (0.0, counts);
        }
        setup
    }

    /// The model that is declared of a stage with these sensors, and whether its cell is recorded.
    /// Of `--machines` every second one has none.
    fn known(&self, setup: &Setup) -> (StageModel, bool) {
        let mut model = declared();
        if self.arguments.machines || self.arguments.counts.is_some() {
            (model.encoder.noise, model.encoder.resolution) =
                (setup.noise.encoder, setup.noise.count);
        }
        let by_cell = !self.arguments.machines || setup.seed.is_multiple_of(2);
        (model, by_cell && !self.arguments.no_cell)
    }

    /// Runs of the first stages from a seed on of which an effect can be made of this size, floors;
    /// the seed behind the last of them. A sudden slip is none of a smooth bristle, however alike
    /// its elements are.
    fn of_size(&mut self, name: &str, size: f64, first: u64, runs: u64) -> Result<u64> {
        self.size = size;
        let mut left = runs;
        for seed in first..first + TRIED_FOR_ONE * runs {
            if left == 0 {
                return Ok(seed);
            }
            let usual = drawn(name, seed)?;
            match self.factor_of(&usual, size, seed)? {
                Some(factor) => {
                    self.run(seed, factor, vec![usual.scaled(factor)])?;
                    left -= 1;
                }
                None => eprintln!("{name} seed {seed}: cannot be made of {size} floors"),
            }
        }
        Ok(first + TRIED_FOR_ONE * runs)
    }

    /// Factor on the usual size of an effect at which its held-out force is of this size, floors;
    /// `None` where there is none. The force of most effects is proportional to it, that of some to
    /// its square.
    fn factor_of(&self, usual: &Effect, size: f64, seed: u64) -> Result<Option<f64>> {
        let mut factor = 1.0;
        for _ in 0..8 {
            // One that the controller cannot hold has no size either.
            let Some(off) =
                self.floors_of(seed, usual.scaled(factor)).ok().map(|floors| size / floors)
            else {
                return Ok(None);
            };
            if !off.is_finite() {
                return Ok(None);
            }
            if (off - 1.0).abs() < 0.05 {
                return Ok(Some(factor));
            }
            factor *= off.powf(if factor == 1.0 { 1.0 } else { 0.7 });
        }
        Ok(None)
    }

    /// Doubles or halves the size until it is between one that fewer than half of the runs detect
    /// and one that half of them do, then goes to five times the size in between.
    fn threshold(&mut self, name: &str, runs: u64, large: u64) -> Result<()> {
        let first = self.arguments.first;
        let mut others = first + runs;
        let mut size = 1.0;
        let mut known = None;
        while SIZES.contains(&size) {
            others = others.max(self.of_size(name, size, first, runs)?);
            let of_name = || self.reports.iter().filter(|report| report.hidden[0].name == name);
            let at =
                share(of_name().filter(|report| report.size == size), |report| report.detected);
            let is_enough = at >= 0.5;
            if known.is_some_and(|known| known != is_enough) {
                let half = half(&of_name().collect::<Vec<_>>());
                return half.map_or(Ok(()), |half| {
                    self.of_size(name, 5.0 * half, others, large).map(|_| ())
                });
            }
            known = Some(is_enough);
            size *= if is_enough { 0.5 } else { 2.0 };
        }
        Ok(())
    }

    /// Held-out force of an effect in floors.
    fn floors_of(&self, seed: u64, effect: Effect) -> Result<f64> {
        let setup = self.setup(seed, vec![effect]);
        let run = setup.generate()?;
        let known = self.known(&setup);
        let check = measured(&run.check, &known, "check")?;
        Ok(hidden(&run, &check, &known.0).iter().map(|hidden| hidden.floors).sum())
    }

    fn run(&mut self, seed: u64, factor: f64, hidden: Vec<Effect>) -> Result<()> {
        let setup = self.setup(seed, hidden);
        let names: Vec<&str> = setup.effects.iter().map(|effect| effect.name()).collect();
        let title = if names.is_empty() { "nothing".to_owned() } else { names.join(" + ") };
        // A setup that the controller cannot hold is no recording: said, counted nowhere.
        let run = match setup.generate() {
            Ok(run) => run,
            Err(error) => {
                eprintln!("{title} seed {seed}: {error}");
                return Ok(());
            }
        };
        if let Some(folder) = &self.arguments.keep {
            let name = format!("{}-{seed}", title.replace(" + ", "-"));
            run.write(&folder.join("bags").join(&name), &folder.join("truth").join(&name))?;
        }
        let bar = indicatif::ProgressBar::new(1000)
            .with_style(indicatif::ProgressStyle::with_template(
                "{prefix} [{elapsed}] {bar:20} {msg}",
            )?)
            .with_prefix(format!("{title} seed {seed}"));
        let known = self.known(&setup);
        let judged =
            judge(&run, &known, (factor, self.size), &self.criteria, &Progress(bar.clone()));
        let report = match judged {
            // A record that cannot carry the question is refused, which is an answer.
            Err(error @ IdentifyError::HiddenByNoise { .. }) => {
                bar.finish_and_clear();
                println!("refused {title} seed {seed}: {error}");
                return Ok(());
            }
            judged => judged.with_context(|| format!("{title} seed {seed}"))?,
        };
        bar.finish_and_clear();
        let mut out = std::io::stdout().lock();
        if self.arguments.json {
            writeln!(out, "{}", serde_json::to_string(&report)?)?;
        } else {
            write!(out, "{}", report.text(&title))?;
        }
        out.flush()?;
        self.reports.push(report);
        Ok(())
    }

    fn summary(&self) -> Result<()> {
        let mut groups: BTreeMap<String, Vec<&Report>> = BTreeMap::new();
        for report in &self.reports {
            let names: Vec<&str> = report.hidden.iter().map(|hidden| hidden.name).collect();
            let title = match &self.arguments.what {
                What::None { .. } => "nothing".to_owned(),
                What::Mixed { .. } => format!("{} effects", names.len()),
                What::Power { .. } => format!("{} of {:5.2}", names.join(" + "), report.size),
                _ => names.join(" + "),
            };
            groups.entry(title).or_default().push(report);
        }
        if self.arguments.json {
            let all = self.reports.len();
            let right = self.reports.iter().filter(|report| report.right).count();
            println!("{}", serde_json::json!({ "runs": all, "right": right }));
            return Ok(());
        }
        println!(
            "\n{:32} {:>4} {:>8} {:>5} {:>5} {:>8} {:>8} {:>9} {:>7}",
            "hidden", "runs", "detected", "right", "open", "floors", "share", "covered", "s"
        );
        let all: Vec<&Report> = self.reports.iter().collect();
        for (title, group) in
            groups.iter().map(|(title, group)| (title.as_str(), group)).chain([("all", &all)])
        {
            let count = group.len().max(1) as f64;
            let mean = |value: &dyn Fn(&Report) -> f64| {
                group.iter().map(|report| value(report)).sum::<f64>() / count
            };
            let deviations: Vec<f64> = group
                .iter()
                .filter(|report| report.right)
                .flat_map(|report| report.deviations.values().copied())
                .collect();
            let covered =
                deviations.iter().filter(|deviation| deviation.abs() <= TWO_SIDED_95).count();
            println!(
                "{title:32} {:4} {:8} {:5} {:5} {:8.2} {:8.3} {:>9} {:7.1}",
                group.len(),
                group.iter().filter(|report| report.detected).count(),
                group.iter().filter(|report| report.right).count(),
                group.iter().filter(|report| report.open).count(),
                mean(&|report| report
                    .hidden
                    .iter()
                    .map(|hidden| hidden.floors.powi(2))
                    .sum::<f64>()
                    .sqrt()),
                mean(&|report| report.explained_share),
                format!("{covered}/{}", deviations.len()),
                mean(&|report| report.seconds),
            );
        }
        self.coverage();
        if matches!(self.arguments.what, What::Power { .. }) {
            self.curves();
        }
        Ok(())
    }

    /// Per parameter of the laws that were named: how many of the 95 % intervals hold the truth.
    fn coverage(&self) {
        let mut parameters: BTreeMap<&str, (usize, usize)> = BTreeMap::new();
        let named = self.reports.iter().filter(|report| report.right);
        for (name, deviation) in named.flat_map(|report| &report.deviations) {
            let (held, all) = parameters.entry(name.as_str()).or_default();
            *held += usize::from(deviation.abs() <= TWO_SIDED_95);
            *all += 1;
        }
        println!("\nintervals that hold the truth");
        for (name, (held, all)) in parameters {
            println!("{name:44} {held:4} of {all}");
        }
    }

    /// Per effect: shares that are detected and named over the size, the size at which half are
    /// detected, and the share that is named from five times that size on. Named is also what the
    /// verdict says cannot be distinguished from its rival.
    fn curves(&self) {
        println!("\ndetected / named, %, at floors");
        let mut effects: BTreeMap<&str, Vec<&Report>> = BTreeMap::new();
        for report in &self.reports {
            effects.entry(report.hidden[0].name).or_default().push(report);
        }
        let named = |report: &Report| report.right || report.open;
        let mut all_large = Vec::new();
        for (name, reports) in effects {
            print!("{name:28}");
            for size in sizes(&reports) {
                let at = || reports.iter().copied().filter(|report| report.size == size);
                let (detected, named) = (share(at(), |report| report.detected), share(at(), named));
                print!("  {size:.3}: {:.0}/{:.0}", 100.0 * detected, 100.0 * named);
            }
            let half = half(&reports).unwrap_or(f64::INFINITY);
            let large: Vec<&Report> =
                reports.into_iter().filter(|report| report.size >= 5.0 * half).collect();
            let share = share(large.iter().copied(), named);
            println!(
                "  half at {half:.2}, named from five times that on {:.0} % of {}",
                100.0 * share,
                large.len()
            );
            all_large.extend(large);
        }
        let share = share(all_large.iter().copied(), named);
        println!(
            "named from five times that on, all: {:.0} % of {}",
            100.0 * share,
            all_large.len()
        );
    }
}

/// Sizes in which an effect is looked for, floors.
const SIZES: std::ops::RangeInclusive<f64> = 0.01..=300.0;
/// Stages that are tried at most for each on which an effect can be made of a size.
const TRIED_FOR_ONE: u64 = 4;

/// Share of the runs that are so.
fn share<'a>(runs: impl Iterator<Item = &'a Report>, is_so: impl Fn(&Report) -> bool) -> f64 {
    let (so, all) = runs.fold((0, 0), |(so, all), run| (so + usize::from(is_so(run)), all + 1));
    f64::from(so as u32) / f64::from(all.max(1))
}

/// Sizes of these runs, floors, each once.
fn sizes(runs: &[&Report]) -> Vec<f64> {
    let mut sizes: Vec<f64> = runs.iter().map(|run| run.size).collect();
    sizes.sort_by(f64::total_cmp);
    sizes.dedup();
    sizes
}

/// Size at which half of the runs of an effect detect it, floors: between two sizes on a
/// logarithmic scale.
fn half(runs: &[&Report]) -> Option<f64> {
    let mut last: Option<(f64, f64)> = None;
    for size in sizes(runs) {
        let detected =
            share(runs.iter().copied().filter(|run| run.size == size), |run| run.detected);
        if detected >= 0.5 {
            return Some(last.map_or(size, |(before, share)| {
                before * (size / before).powf((0.5 - share) / (detected - share))
            }));
        }
        last = Some((size, detected));
    }
    None
}

/// A record as the one who identifies gets it.
fn measured(
    columns: &Columns,
    (model, by_cell): &(StageModel, bool),
    name: &str,
) -> Result<Measured, IdentifyError> {
    let mut trace = columns.to_trace();
    if !by_cell {
        trace.force_cell.fill(f64::NAN);
    }
    Measured::new(&trace, model, name)
}

fn judge(
    run: &GeneratedRun,
    known: &(StageModel, bool),
    (factor, size): (f64, f64),
    criteria: &Criteria,
    watch: &dyn Watch,
) -> Result<Report, IdentifyError> {
    let model = &known.0;
    let start = Instant::now();
    let (train, check) =
        (measured(&run.train, known, "train")?, measured(&run.check, known, "check")?);
    let selection = search_by(criteria, model, Tolerances::default(), &train, &check, watch)?;
    let seconds = start.elapsed().as_secs_f64();

    let found: Vec<&'static str> = selection
        .after
        .fitted
        .hypothesis
        .effects
        .iter()
        .map(|part| part.descriptor.name)
        .filter(|name| *name != "map")
        .collect();
    let coordinate = selection.coordinate.map(|coordinate| match coordinate {
        Coordinate::Position => "position",
        Coordinate::Velocity => "velocity",
        Coordinate::Time => "time",
    });
    let hidden = hidden(run, &check, model);
    let right = right(&hidden, &selection, &found, coordinate);
    let rms = |motor: f64, carriage: f64| [motor.sqrt(), carriage.sqrt()];
    Ok(Report {
        seed: run.truth.seed,
        factor,
        size,
        noise: run.truth.noise,
        rate: check.rate,
        verdict: match selection.verdict {
            Verdict::Found => "found",
            Verdict::None => "none",
            Verdict::Unknown => "unknown",
            Verdict::NotSeparable => "not_separable",
        },
        coordinate,
        inseparable: selection.inseparable.iter().map(|pair| (pair.effect, pair.rival)).collect(),
        detected: selection.verdict != Verdict::None,
        open: is_open(&hidden, &selection, &found),
        right,
        explained_share: selection.explained_share(),
        before: rms(
            selection.errors_before.holdout_motor,
            selection.errors_before.holdout_carriage,
        ),
        after: rms(selection.errors_after.holdout_motor, selection.errors_after.holdout_carriage),
        floor: [selection.floor.motor, selection.floor.carriage],
        deviations: deviations(&hidden, run.truth.mass, &selection.after),
        evidence: strongest(&selection.evidence),
        parameters: described(&selection.after.fitted.hypothesis),
        hidden,
        found,
        seconds,
    })
}

/// What the held-out record shows of each hidden effect.
fn hidden(run: &GeneratedRun, check: &Measured, model: &StageModel) -> Vec<Hidden> {
    let floor = check.floor(model);
    run.truth
        .effects
        .iter()
        .zip(&run.truth.check.hidden)
        .map(|(truth, signal)| {
            let force = shown(signal, &run.truth.check, check, run.truth.mass);
            let floor = match truth.side {
                effects::Side::Motor => floor.motor,
                _ => floor.carriage,
            };
            Hidden {
                name: truth.name,
                listed: truth.listed,
                coordinate: truth.coordinate,
                parameters: truth.parameters.clone(),
                force,
                floors: force / floor,
            }
        })
        .collect()
}

/// Names that tell all that is hidden: a constant force beside a spring is a spring with another
/// centre.
fn wanted(hidden: &[Hidden]) -> Vec<&'static str> {
    let spring = hidden.iter().any(|hidden| hidden.name == "cable_chain");
    hidden
        .iter()
        .map(|hidden| hidden.name)
        .filter(|name| !(spring && *name == "constant_force"))
        .collect()
}

/// Whether this is the answer that an engineer who knows the truth would accept.
fn right(
    hidden: &[Hidden],
    selection: &Selection,
    found: &[&str],
    coordinate: Option<&str>,
) -> bool {
    if hidden.is_empty() {
        return selection.verdict == Verdict::None;
    }
    if let Some(strange) = hidden.iter().find(|hidden| !hidden.listed) {
        // A curve over one coordinate cannot say "travelled distance": any will do there.
        let followed = match strange.coordinate {
            Some(one @ ("position" | "velocity" | "time")) => coordinate == Some(one),
            _ => true,
        };
        // Nor is there one over the force.
        let no_curve = strange.coordinate == Some("force");
        return selection.verdict == Verdict::Unknown
            && followed
            && (no_curve || selection.errors_after.holdout() < selection.errors_before.holdout());
    }
    let mut wanted = wanted(hidden);
    let mut all: Vec<&str> = hidden.iter().map(|hidden| hidden.name).collect();
    let mut named = found.to_vec();
    wanted.sort_unstable();
    all.sort_unstable();
    named.sort_unstable();
    // Several harmonics or lines are one effect.
    named.dedup();
    selection.verdict == Verdict::Found && (named == wanted || named == all)
}

/// Whether the verdict is that what is hidden cannot be distinguished from something else: each
/// hidden name is found or the rival of one that is, and nothing else is.
fn is_open(hidden: &[Hidden], selection: &Selection, found: &[&str]) -> bool {
    let wanted = wanted(hidden);
    let rivals = |one: &str, two: &str| {
        selection.inseparable.iter().any(|pair| (pair.effect, pair.rival) == (one, two))
    };
    let stands_for = |found: &str, name: &str| found == name || rivals(found, name);
    selection.verdict == Verdict::NotSeparable
        && wanted.iter().all(|name| found.iter().any(|found| stands_for(found, name)))
        && found.iter().all(|found| wanted.iter().any(|name| stands_for(found, name)))
}

/// Force that a hidden effect adds or feigns in the record that is compared, N rms.
fn shown(signal: &blind_tests::Hidden, truth: &RecordTruth, measured: &Measured, mass: f64) -> f64 {
    let count = truth.position.len();
    let rate = measured.rate;
    let force: Vec<f64> = (0..count)
        .map(|k| {
            let (before, after) = (k.saturating_sub(1), (k + 1).min(count - 1));
            let bend = signal.encoder[after] - 2.0 * signal.encoder[k] + signal.encoder[before];
            0.5 * (signal.force[k] + signal.force[after] + signal.cell[k] + signal.cell[after])
                - mass * bend * rate * rate
        })
        .collect();
    blind_tests::rms(&measured.filtered(&force))
}

/// Parameters of the hidden effects, by name, and the mass: how many standard deviations the fit is
/// off.
fn deviations(hidden: &[Hidden], mass: f64, estimate: &Estimate) -> BTreeMap<String, f64> {
    let mut all = BTreeMap::new();
    for (index, coordinate) in estimate.fitted.coordinates.iter().enumerate() {
        let deviation = estimate.deviation(index);
        if !deviation.is_finite() || deviation <= 0.0 {
            continue;
        }
        match coordinate.id {
            ParameterId::Nominal(NominalParameter::Mass) => {
                let value = estimate.fitted.hypothesis.mass();
                all.insert("mass".to_owned(), (value - mass) / (deviation * value));
            }
            ParameterId::Nominal(_) | ParameterId::Spread { .. } => {}
            ParameterId::Effect { effect, value } => {
                let part = &estimate.fitted.hypothesis.effects[effect];
                let parameter = part.descriptor.parameters[value].name;
                // Of guides that each have a period of their own none is the one that the truth
                // names; the centre of a spring is that of the truth only without a constant force.
                let other_centre = parameter == "center" && wanted(hidden).len() < hidden.len();
                if part.descriptor.name == "ball_passage" || other_centre {
                    continue;
                }
                let truth = hidden
                    .iter()
                    .find(|hidden| hidden.name == part.descriptor.name)
                    .and_then(|hidden| hidden.parameters.get(parameter));
                // Where a phase begins is a convention. Of several harmonics or lines the first is
                // the one that the truth names.
                if let (Some(truth), false) = (truth, parameter == "phase") {
                    all.entry(format!("{}.{parameter}", part.descriptor.name))
                        .or_insert((coordinate.value - truth) / deviation);
                }
            }
        }
    }
    all
}

/// Of each round, the three candidates with most gain.
fn strongest(evidence: &[Evidence]) -> Vec<Candidate> {
    let rounds = evidence.iter().map(|one| one.round + 1).max().unwrap_or(0);
    (0..rounds)
        .flat_map(|round| {
            let mut tried: Vec<&Evidence> =
                evidence.iter().filter(|one| one.round == round).collect();
            tried.sort_by(|a, b| b.fall.total_cmp(&a.fall));
            let kept = tried
                .iter()
                .enumerate()
                .filter(|(rank, one)| *rank < 3 || one.outcome == Outcome::Chosen);
            kept.map(|(_, one)| Candidate {
                round,
                name: one.name,
                free: one.free,
                train_gain: one.train_gain,
                holdout_gain: one.holdout_gain,
                fall: one.fall,
                outcome: format!("{:?}", one.outcome),
            })
            .collect::<Vec<_>>()
        })
        .collect()
}

fn described(hypothesis: &Hypothesis) -> Vec<String> {
    hypothesis
        .effects
        .iter()
        .map(|part| {
            let values: Vec<String> = part
                .descriptor
                .parameters
                .iter()
                .zip(&part.values)
                .map(|(parameter, value)| format!("{} {value:.4e}", parameter.name))
                .collect();
            format!("{}: {}", part.descriptor.name, values.join(", "))
        })
        .collect()
}

impl Report {
    fn text(&self, title: &str) -> String {
        use std::fmt::Write as _;
        let mut text = String::new();
        let mut line = |content: std::fmt::Arguments<'_>| {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{content}");
        };
        line(format_args!(
            "{} {title} seed {} x {}: {} [{}]{} share {:.3} in {:.1} s",
            if self.right {
                "right"
            } else if self.open {
                "open "
            } else {
                "WRONG"
            },
            self.seed,
            self.factor,
            self.verdict,
            self.found.join(" + "),
            self.coordinate.map(|coordinate| format!(" map over {coordinate}")).unwrap_or_default(),
            self.explained_share,
            self.seconds,
        ));
        for hidden in &self.hidden {
            line(format_args!(
                "    hidden {} {:.3} N rms = {:.2} floors {:?}",
                hidden.name, hidden.force, hidden.floors, hidden.parameters
            ));
        }
        line(format_args!(
            "    {:.0} Hz, encoder with counts of {:.1} nm and {:.1} nm of noise, cell with \
             {:.3} N",
            self.rate,
            1e9 * self.noise.count,
            1e9 * self.noise.encoder,
            self.noise.cell
        ));
        line(format_args!(
            "    held out motor/carriage {:.4}/{:.4} -> {:.4}/{:.4} N, floor {:.4}/{:.4}",
            self.before[0],
            self.before[1],
            self.after[0],
            self.after[1],
            self.floor[0],
            self.floor[1],
        ));
        for one in &self.parameters {
            line(format_args!("    found {one}"));
        }
        line(format_args!("    off by {:.1?} standard deviations", self.deviations));
        for one in &self.evidence {
            line(format_args!(
                "    round {} {:28} free {:2} gain train {:.5} held out {:.5} fall {:.3} {}",
                one.round,
                one.name,
                one.free,
                one.train_gain,
                one.holdout_gain,
                one.fall,
                one.outcome
            ));
        }
        if !self.inseparable.is_empty() {
            line(format_args!("    not separable {:?}", self.inseparable));
        }
        text
    }
}
