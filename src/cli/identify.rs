//! `friction-stage identify`: what does a recording show that a declared model lacks?

mod figures;
mod input;
mod next;
mod page;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};

use self::figures::LoopErrors;
use self::input::{Input, Record};
use super::Outcome;
use crate::node::stage_settings;
use friction_stage_core::model::{Curve, CurveSide, Jump, StageModel};
use friction_stage_core::plant::effects::{Multiplicity, ParameterKind, RecordSpecific};
use friction_stage_data::bag::topics;
use friction_stage_data::signals::Mapping;
use friction_stage_identify::Outcome::TooSmall;
use friction_stage_identify::{
    CARRIAGE_GAIN, Change, Inseparable, LinearController, MORE_THAN_DECLARED, MOST_LAWS,
    NOISE_LIKE, NextExperiment, Part, PositionErrors, RippleElsewhere, Selection, Summary,
    Tolerances, Verdict, Watch, closed_loop, in_digits, next_experiment, parameter_warnings,
    readable, ripple_elsewhere, search, taking_part,
};

/// Find what a declared model lacks: refit it to a recording, trace the residual to an effect, add
/// it, and show the error before and after on held-out data.
///
/// Verdicts: found, none (the residual is noise), unknown (something is there that no law of the
/// list explains), not_separable (two laws explain it equally). Writes identified.yaml, which the
/// stage node and every experiment load, summary.json, report.html and the figures. Ctrl-C ends the
/// search after the running step and writes what there is.
///
/// Exit code: 0 done, 1 failed, 2 wrong arguments, 3 done with warnings.
#[derive(Debug, Clone, Args)]
#[command(
    after_help = "Examples:\n  friction-stage identify --model stage.yaml --train run/train \
                        --holdout run/check --out result\n  friction-stage identify --model \
                        drive.yaml --train a.csv --holdout b.csv --mapping drive_csv.yaml --out \
                        result --json | jq .verdict\n  friction-stage identify --model stage.yaml \
                        --train run/train --holdout run/check --out result --next-experiment \
                        --stroke -0.05 0.05"
)]
pub struct IdentifyArgs {
    /// Model file or catalogue guide: what the stage is declared to be
    #[arg(long, value_name = "MODEL")]
    pub model: String,
    /// Bags or CSV files to identify on; several are joined
    #[arg(long, value_name = "BAG", num_args = 1.., required = true)]
    pub train: Vec<PathBuf>,
    /// Bags or CSV files that no fit sees: they decide what is kept
    #[arg(long, value_name = "BAG", num_args = 1.., required = true)]
    pub holdout: Vec<PathBuf>,
    /// Directory for the results
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// YAML file that says which topic and field, or column, is which signal
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// How far the mass may be from the declared one, as a share of it
    #[arg(
        long,
        value_name = "SHARE",
        default_value_t = Tolerances::default().mass,
        value_parser = share,
    )]
    pub mass_tolerance: f64,
    /// How far each parameter of the guides may be from the declared one, as a share of it
    #[arg(
        long,
        value_name = "SHARE",
        default_value_t = Tolerances::default().guides,
        value_parser = share,
    )]
    pub guide_tolerance: f64,
    /// The same for bristle stiffness, bristle damping, static friction and Stribeck velocity,
    /// where they are known worse; 1 and more is a factor of 1 + SHARE either way
    /// [default: that of the guides]
    #[arg(long, value_name = "SHARE", value_parser = positive)]
    pub presliding_tolerance: Option<f64>,
    /// Write the motion that would best settle what these data leave open, as a
    /// trajectory_msgs/JointTrajectory in YAML for `ros2 topic pub` and rclpy
    /// [default FILE: next_experiment.yaml in the directory of the results]
    #[arg(long, value_name = "FILE", num_args = 0..=1)]
    pub next_experiment: Option<Option<PathBuf>>,
    #[command(flatten)]
    pub limits: next::LimitArgs,
    /// Print summary.json instead of text
    #[arg(long)]
    pub json: bool,
}

/// Name of the identified model in the output directory.
const MODEL_FILE: &str = "identified.yaml";

fn share(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    if value > 0.0 && value < 1.0 {
        Ok(value)
    } else {
        Err(format!("{value} must be between 0 and 1, such as 0.16"))
    }
}

fn positive(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    if value > 0.0 && value.is_finite() {
        Ok(value)
    } else {
        Err(format!("{value} must be above 0, such as 0.5"))
    }
}

/// Shows what is tried, and knows whether to stop.
struct Progress {
    bar: ProgressBar,
    stop: Arc<AtomicBool>,
    /// What was told last where stderr is no terminal: a line per round and not per candidate.
    told: Mutex<String>,
}

impl Watch for Progress {
    fn progress(&self, what: &str, share: f64) {
        // Candidates report from several threads, so that a share may come late.
        let position = (1000.0 * share.clamp(0.0, 1.0)) as u64;
        if position > self.bar.position() {
            self.bar.set_position(position);
        }
        self.bar.set_message(what.to_owned());
        if !self.bar.is_hidden() {
            return;
        }
        let stage = what.split(':').next().unwrap_or(what);
        let Ok(mut told) = self.told.lock() else { return };
        // Threads of a round that has ended may come late.
        if *told != stage
            && !(told.starts_with("round") && stage < told.as_str() && stage.starts_with("round"))
        {
            stage.clone_into(&mut told);
            // Nobody may be reading: that is no reason to stop.
            let _ = writeln!(std::io::stderr(), "{stage}");
        }
    }

    fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }
}

/// Runs the command; results go to `out`, progress to stderr.
pub fn run(args: &IdentifyArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let mapping = args.mapping.as_deref().map(Mapping::load).transpose()?;
    let declared = stage_settings::model(&args.model)?;
    may_write(&args.out)?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        // The second one ends the program at once, with the code of a shell for an interrupt.
        signal_hook::flag::register_conditional_shutdown(signal, 130, Arc::clone(&stop))?;
        signal_hook::flag::register(signal, Arc::clone(&stop))?;
    }
    let bar = ProgressBar::new(1000);
    bar.set_style(
        ProgressStyle::with_template("{msg:48} [{bar:30}] {percent:>3} %  {elapsed}")?
            .progress_chars("=> "),
    );
    bar.enable_steady_tick(Duration::from_millis(200));
    bar.set_message("reading");
    tell_of_stop(&bar, &stop);

    let input = Input::load(&args.train, &args.holdout, mapping.as_ref(), &declared)?;
    let limits =
        args.next_experiment.as_ref().map(|_| args.limits.limits(&declared, &input)).transpose()?;
    let tolerances = Tolerances {
        mass: args.mass_tolerance,
        guides: args.guide_tolerance,
        presliding: args.presliding_tolerance.unwrap_or(args.guide_tolerance),
    };
    // Where nothing can be written, nobody should wait for it.
    let motion_file =
        args.next_experiment.clone().map(|file| file.unwrap_or_else(|| args.out.join(next::FILE)));
    std::fs::create_dir_all(args.out.join("figures"))
        .with_context(|| format!("cannot create {}", args.out.join("figures").display()))?;
    if let Some(directory) =
        motion_file.as_deref().and_then(Path::parent).filter(|path| *path != Path::new(""))
    {
        anyhow::ensure!(
            directory.is_dir(),
            "--next-experiment: there is no directory {}",
            directory.display()
        );
    }
    let watch = Progress { bar: bar.clone(), stop, told: Mutex::default() };
    let selection =
        search(&declared, tolerances, &input.train.measured, &input.holdout.measured, &watch)?;
    bar.set_message("closed loop");
    let mut warnings = input.warnings.clone();
    let model = selection.after.fitted.hypothesis.model();
    let there = selection.after.fitted.hypothesis.in_record(&input.holdout.measured)?;
    let differs = selection.after.fitted.hypothesis.own_of(&there);
    let has_own_phase =
        |part: &&&Part| matches!(part.descriptor.record_specific, RecordSpecific::Phase);
    if let Some(part) = differs.iter().find(has_own_phase) {
        warnings.push(format!(
            "{} counts its phase from the start of a record: the errors on the hold-out are those \
             with the phase that fits the hold-out best, and the model has that of the train record",
            part.descriptor.name
        ));
    }
    for at in differs.iter().filter_map(|part| Some(part.curve()?.jump?.at)) {
        warnings.push(format!(
            "the map jumps at another instant of the hold-out, {}: the errors on the hold-out are \
             those with this one, and the model has that of the train record",
            instant_in_words(at, input.holdout.measured.time.last().copied().unwrap_or(0.0))
        ));
    }
    if let Some(part) = selection.after.fitted.hypothesis.effects.iter().find(|part| part.slips()) {
        warnings.push(format!(
            "{} slips: its amplitude and phase are each record's own, the errors of either record \
             are those with the ones that fit it best, the closed loop is simulated without it, \
             and a stage that loads the model shows one example of such phases; its slip is the \
             one of a few that does best. A ripple of the carriage on a machine that was homed \
             anew between the records looks the same",
            part.descriptor.name
        ));
    }
    let loops = simulate(&selection, &input, &there.model(), &mut warnings);
    warnings.extend(remarks(&selection, input.train.measured.rate));
    warnings.extend(moved_ripples(&selection, &input)?);
    let position = PositionErrors {
        train: loops.as_ref().map_or_else(Change::default, |loops| loops.train.change()),
        holdout: loops.as_ref().map_or_else(Change::default, |loops| loops.holdout.change()),
    };
    let (train, holdout) = (&input.train.measured, &input.holdout.measured);
    let mut summary = Summary::new(&selection, train, holdout, position, MODEL_FILE, warnings);
    summary.warnings.extend(summary.worse());
    let mut motion = None;
    if let (Some(limits), Some(file)) = (limits, motion_file) {
        bar.set_message("next experiment");
        match next_experiment::plan(&selection, &declared, train, limits) {
            Ok(plan) => {
                summary.warnings.extend(next::warnings(&plan.next));
                summary.next_experiment =
                    Some(NextExperiment { file: file.display().to_string(), ..plan.next });
                motion = Some((file, plan.points));
            }
            // The search took its time: its results are not thrown away for this.
            Err(error) => summary.warnings.push(format!("no next experiment: {error}")),
        }
    }

    bar.set_message("report");
    let figures = figures::draw(&selection, &input, loops.as_ref())?;
    let html = page::page(&args.model, &declared, &model, &selection, &summary, &input, &figures)?;
    if motion.is_none() {
        // That of an earlier identification is not this one's.
        let _ = std::fs::remove_file(args.out.join(next::FILE));
    }
    write(&args.out.join(MODEL_FILE), &model.to_yaml()?)?;
    for figure in &figures {
        write(&args.out.join("figures").join(format!("{}.svg", figure.name)), &figure.svg)?;
    }
    write(&args.out.join("report.html"), &html)?;
    if let (Some((file, points)), Some(next)) = (&motion, &summary.next_experiment) {
        write(file, &next_experiment::trajectory_yaml(points, topics::JOINT, &next::lines(next)))?;
    }
    let json = serde_json::to_string_pretty(&summary)? + "\n";
    write(&args.out.join("summary.json"), &json)?;
    bar.finish_and_clear();

    if args.json {
        write!(out, "{json}")?;
    } else {
        tell(&summary, &args.out, out)?;
    }
    Ok(if summary.warnings.is_empty() { Outcome::Done } else { Outcome::Warnings })
}

/// Says at once that Ctrl-C was seen: the running step may take a while.
fn tell_of_stop(bar: &ProgressBar, stop: &Arc<AtomicBool>) {
    let (bar, stop) = (bar.clone(), Arc::clone(stop));
    std::thread::spawn(move || {
        while !bar.is_finished() {
            if stop.load(Ordering::Relaxed) {
                bar.suspend(|| {
                    eprintln!(
                        "stopping after the running step; Ctrl-C again ends at once, without \
                               a report"
                    )
                });
                return;
            }
            std::thread::sleep(Duration::from_millis(100));
        }
    });
}

/// Refuses a directory that is a recording or holds the results of another command; those of an
/// earlier identification are replaced.
fn may_write(directory: &Path) -> anyhow::Result<()> {
    anyhow::ensure!(
        !directory.join("metadata.yaml").exists(),
        "{} is a recording: choose another --out",
        directory.display()
    );
    let Ok(text) = std::fs::read_to_string(directory.join("summary.json")) else {
        let foreign = ["report.html", "identified.yaml"]
            .into_iter()
            .find(|name| directory.join(name).exists());
        anyhow::ensure!(
            foreign.is_none(),
            "{} holds a {} and no summary.json of an identification: choose another --out",
            directory.display(),
            foreign.unwrap_or_default()
        );
        return Ok(());
    };
    let own = serde_json::from_str::<serde_json::Value>(&text)
        .is_ok_and(|value| value.get("verdict").is_some());
    anyhow::ensure!(
        own,
        "{} holds results of another command: choose another --out",
        directory.display()
    );
    Ok(())
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}

/// Closed-loop position errors before and after, on both records; without them a warning says why.
fn simulate(
    selection: &Selection,
    input: &Input,
    on_holdout: &StageModel,
    warnings: &mut Vec<String>,
) -> Option<LoopErrors> {
    let run = || -> Result<LoopErrors, friction_stage_identify::ClosedLoopError> {
        let all: Vec<_> = input.train.traces().chain(input.holdout.traces()).collect();
        // Slow moves do not show all of a controller: another train record may.
        let mut found = input.train.traces().map(|trace| closed_loop::controller_of(trace, &all));
        let first =
            found.next().unwrap_or(Err(friction_stage_identify::ClosedLoopError::NoSetpoint));
        let controller = first.or_else(|error| found.find_map(Result::ok).ok_or(error))?;
        let (before, after) =
            (selection.before.hypothesis.model(), selection.after.fitted.hypothesis.model());
        let errors = |record: &Record, after: &StageModel, controller: &LinearController| {
            let each = |model: &StageModel| {
                record
                    .traces()
                    .map(|trace| closed_loop::position_error(model, trace, controller))
                    .collect::<Result<Vec<_>, _>>()
                    .map(|errors| errors.concat())
            };
            Ok::<_, friction_stage_identify::ClosedLoopError>(figures::LoopError {
                before: each(&before)?,
                after: each(after)?,
            })
        };
        Ok(LoopErrors {
            train: errors(&input.train, &after, &controller)?,
            holdout: errors(&input.holdout, on_holdout, &controller)?,
        })
    };
    match run() {
        Ok(loops) => Some(loops),
        Err(error) => {
            warnings.push(format!(
                "no position error, because the closed loop cannot be simulated: {error}"
            ));
            None
        }
    }
}

/// Ratio up to which the periods of ball passages are those of guides of one type. Assumed.
const ONE_TYPE: f64 = 1.2;

/// An instant of a record of this length, s, or beside it.
pub(super) fn instant_in_words(at: f64, length: f64) -> String {
    match at {
        _ if at < 0.0 => "before its start".to_owned(),
        _ if at > length => "behind its end".to_owned(),
        _ => format!("at {at:.3} s"),
    }
}

/// What happens where a curve over the time jumps.
fn jump_in_words(curve: &Curve) -> Option<String> {
    let Jump { at, height } = curve.jump?;
    let goes = if height > 0.0 { "rises" } else { "falls" };
    let before =
        curve.corners().into_iter().find(|(place, _)| *place >= at).map_or(0.0, |(_, value)| value);
    let size = readable((1e3 * height.abs()).round() / 1e3);
    let part = 100.0 * height.abs() / (1.0 + before);
    let by = match curve.side {
        CurveSide::Carriage => format!("the force on the carriage {goes} by {size} N"),
        CurveSide::Motor => format!("the force of the motor {goes} by {size} N"),
        CurveSide::Friction => format!("the Coulomb friction {goes} by {part:.1} %"),
        CurveSide::Viscous => format!("the viscous friction {goes} by {part:.1} %"),
        CurveSide::Mass => format!("the moving mass {goes} by {size} kg"),
    };
    Some(format!("at {at:.3} s {by}"))
}

/// What a user should know about the model and the search.
fn remarks(selection: &Selection, rate: f64) -> Vec<String> {
    let mut remarks = Vec::new();
    let left = selection.errors_after.holdout().sqrt();
    if selection.stopped {
        remarks.push(
            "the search was stopped before its end: not every candidate was tried, and the verdict \
             is that of what was tried"
                .to_owned(),
        );
    }
    for Inseparable { effect, rival, correlation } in &selection.inseparable {
        let telltale = |name: &str| {
            friction_stage_core::plant::EffectDescriptor::find(name)
                .map_or("", |found| found.telltale)
        };
        remarks.push(format!(
            "{effect} and {rival} explain these data equally, what they take out is correlated by \
             {correlation:.4}: all values, the mass among them, hold if it is {effect}; \
             --next-experiment writes a motion that would separate them where there is one. What \
             gives {effect} away: {}; {rival}: {}",
            telltale(effect),
            telltale(rival)
        ));
    }
    let added =
        &selection.after.fitted.hypothesis.effects[selection.before.hypothesis.effects.len()..];
    let of_guides: Vec<&Part> = added
        .iter()
        .filter(|part| part.descriptor.multiplicity == Multiplicity::OnePerGuide)
        .collect();
    let passages: Vec<f64> =
        of_guides.iter().filter_map(|part| part.value_of_kind(ParameterKind::Period)).collect();
    let (shortest, longest) = friction_stage_core::numerics::range(&passages);
    if let [first, _, ..] = of_guides[..]
        && longest < ONE_TYPE * shortest
    {
        remarks.push(format!(
            "{} {} of nearly one period stand for guides that differ in theirs: together \
             they are the ripple, and the values of one are not those of a guide",
            passages.len(),
            first.descriptor.name
        ));
    }
    for (name, periods) in &selection.unproven {
        remarks.push(format!(
            "{name} goes through {periods:.1} periods within the travel: that it repeats is not \
             shown, a few such ripples add up to any curve over position. A longer travel would \
             tell"
        ));
    }
    if selection.verdict == Verdict::Unknown
        && let Some(coordinate) = selection.coordinate
    {
        remarks.push(format!(
            "no law of the list explains what is left over {}: an empirical map stands for it, \
             which holds only where the data have been",
            coordinate.name()
        ));
        let curves = added.iter().filter_map(|part| part.curve());
        remarks.extend(
            curves
                .filter_map(|curve| jump_in_words(&curve))
                .map(|words| format!("the map jumps: {words}")),
        );
    }
    let (floor, declared_floor) = (selection.floor.total(), selection.declared_floor.total());
    if floor > MORE_THAN_DECLARED * declared_floor {
        remarks.push(format!(
            "the sensors' noise in the hold-out leaves {floor:.4} N where the declared one leaves \
             {declared_floor:.4} N: everything is judged against the former"
        ));
    }
    if selection.verdict == Verdict::Unknown && selection.coordinate.is_none() && !selection.stopped
    {
        remarks.push(format!(
            "what is left, {left:.4} N, is {}, and neither a law of the list nor a map takes it \
             out of the hold-out: an effect whose phase or state differs between the records would \
             look like this, or one over the force, as a dead zone or a curved characteristic of \
             motor or cell",
            times_noise(selection)
        ));
    }
    if matches!(selection.verdict, Verdict::Found | Verdict::NotSeparable)
        && left > NOISE_LIKE * selection.floor.total()
    {
        remarks.push(match selection.wander_of_zero {
            Some(wander) => format!(
                "the zero of the force cell wanders by {wander:.4} N rms in the hold-out beyond \
                 the law that was found for it, and nothing else is left: the train record cannot \
                 tell how, take the zero before each record"
            ),
            None => format!(
                "what is left, {left:.4} N, is {}: the laws that were found hold roughly, and \
                 their values no better than they do",
                times_noise(selection)
            ),
        });
    }
    if selection.added_laws() >= MOST_LAWS && left > NOISE_LIKE * selection.floor.total() {
        remarks.push(format!(
            "no more than {MOST_LAWS} laws are added: there may be further ones; \
                              declare those that are right in --model, and identify again"
        ));
    }
    remarks.extend(parameter_warnings(&selection.after, rate));
    remarks
}

/// What is left on the hold-out against the noise of the sensors.
fn times_noise(selection: &Selection) -> String {
    match selection.floor.total() {
        floor if floor > 0.0 => {
            format!(
                "{:.1} times what the noise of the sensors leaves",
                selection.errors_after.holdout().sqrt() / floor
            )
        }
        _ => "more than sensors without any noise leave".to_owned(),
    }
}

/// Part by which the periods of one ripple may differ. Assumed.
const SAME_PERIOD: f64 = 1e-3;

/// Ripples of the train record that the hold-out has too, but with another phase: as found they
/// would make it worse.
fn moved_ripples(selection: &Selection, input: &Input) -> anyhow::Result<Vec<String>> {
    let Some(last) = selection.evidence.iter().map(|one| one.round).max() else {
        return Ok(Vec::new());
    };
    let least = CARRIAGE_GAIN * selection.floor.carriage.powi(2);
    // Without a cell a ripple of the motor and one of the carriage are the same one.
    let one_side = input.holdout.measured.cell.is_none();
    let mut moved: Vec<(RippleElsewhere, Vec<&str>)> = Vec::new();
    for one in selection.evidence.iter().filter(|one| one.round == last && one.outcome == TooSmall)
    {
        let found = ripple_elsewhere(
            &one.part,
            &selection.after.fitted.hypothesis,
            &input.holdout.measured,
        )?;
        let Some(ripple) = found.filter(|ripple| one.train_gain > least && ripple.has_moved(least))
        else {
            continue;
        };
        let alike = |other: &RippleElsewhere| {
            one_side && (other.period - ripple.period).abs() < SAME_PERIOD * ripple.period
        };
        match moved.iter_mut().find(|(other, _)| alike(other)) {
            Some((_, names)) => names.push(one.name),
            None => moved.push((ripple, vec![one.name])),
        }
    }
    let told = |(ripple, names): &(RippleElsewhere, Vec<&str>)| {
        format!(
            "{} with a period of {:.4e} m is on both records, but shifted by {:.2} rad on the \
             hold-out: with a fixed phase it would make the hold-out worse, so that it is left out",
            names.join(" or "),
            ripple.period,
            ripple.phase_shift
        )
    };
    Ok(moved.iter().map(told).collect())
}

/// A number with its unit in a size that reads well.
fn metres(value: Option<f64>) -> String {
    match value {
        None => "-".to_owned(),
        Some(value) if value < 1e-6 => format!("{:.2} nm", value * 1e9),
        Some(value) if value < 1e-3 => format!("{:.3} um", value * 1e6),
        Some(value) => format!("{:.3} mm", value * 1e3),
    }
}

fn tell(summary: &Summary, directory: &Path, out: &mut dyn Write) -> std::io::Result<()> {
    writeln!(out, "verdict: {}", summary.verdict)?;
    for effect in &summary.effects {
        writeln!(out, "  {} ({} side)", effect.name, effect.side)?;
        for name in taking_part(effect) {
            let Some(parameter) = effect.parameters.get(name) else { continue };
            let digits = |value: f64| in_digits(value, parameter.ci95);
            let interval = parameter.ci95.map_or_else(String::new, |[low, high]| {
                format!("  95 %: {} to {}", digits(low), digits(high))
            });
            let unit = if parameter.unit == "1" { "" } else { &parameter.unit };
            writeln!(out, "    {name:18} {} {unit}{interval}", digits(parameter.value))?;
        }
    }
    for (name, errors) in [("train", &summary.errors.train), ("hold-out", &summary.errors.holdout)]
    {
        let number = |value: Option<f64>| {
            value.map_or_else(|| "-".to_owned(), |value| format!("{value:.4}"))
        };
        writeln!(
            out,
            "{name:9} force residual {} -> {} N ({} -> {} %){}",
            number(errors.force_rms.before),
            number(errors.force_rms.after),
            number(errors.force_relative.before),
            number(errors.force_relative.after),
            match errors.position_rms {
                Change { before: None, after: None } => String::new(),
                Change { before, after } =>
                    format!(", position {} -> {}", metres(before), metres(after)),
            }
        )?;
    }
    writeln!(
        out,
        "explained share {:.3} of the held-out residual above the floor of {:.4} N",
        summary.explained_share, summary.floor.force_rms
    )?;
    for (index, line) in summary.next_experiment.iter().flat_map(next::lines).enumerate() {
        writeln!(out, "{}{line}", if index == 0 { "" } else { "  " })?;
    }
    for warning in &summary.warnings {
        writeln!(out, "warning: {warning}")?;
    }
    writeln!(out, "{}", directory.join("report.html").display())
}

#[cfg(test)]
mod tests {
    use super::*;
    use friction_stage_core::model::Coordinate;

    #[test]
    fn a_jump_is_told_in_newtons_or_as_a_part_of_the_friction_before_it() {
        let words = |side, height| {
            let jump = Some(Jump { at: 3.0, height });
            let curve = Curve {
                coordinate: Coordinate::Time,
                side,
                from: 0.0,
                to: 8.0,
                values: vec![-0.1, -0.1, 0.3],
                jump,
            };
            jump_in_words(&curve)
        };
        assert_eq!(
            words(CurveSide::Friction, -0.18).as_deref(),
            Some("at 3.000 s the Coulomb friction falls by 20.0 %")
        );
        assert_eq!(
            words(CurveSide::Viscous, 0.45).as_deref(),
            Some("at 3.000 s the viscous friction rises by 50.0 %")
        );
        let instants = [-5e-4, 7.25, 19.1].map(|at| instant_in_words(at, 19.0));
        assert_eq!(instants, ["before its start", "at 7.250 s", "behind its end"]);
        assert_eq!(
            words(CurveSide::Mass, 1.5).as_deref(),
            Some("at 3.000 s the moving mass rises by 1.5 kg")
        );
        assert_eq!(
            words(CurveSide::Motor, -2.5).as_deref(),
            Some("at 3.000 s the force of the motor falls by 2.5 N")
        );
    }
}
