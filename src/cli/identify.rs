//! `friction-stage identify`: what does a recording show that a declared model lacks?

mod next;

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use indicatif::ProgressBar;

use super::progress::Progress;
use super::{Interrupted, Outcome, PartArgs, WrongArguments};
use crate::interrupt::{self, Patience};
use crate::made_by;
use friction_stage_core::model::JointType;
use friction_stage_core::plant::model_named;
use friction_stage_core::text_file;
use friction_stage_data::bag::topics;
use friction_stage_data::signals::Mapping;
use friction_stage_identify::{
    Identification, Records, RecordsError, Tolerances, Watch, next_experiment,
};
use friction_stage_report::identification::{
    identification_figures, identification_page, identification_summary, identification_text,
    identified_model_file, next_experiment_lines, usable_model_file,
};
use friction_stage_report::words::records_error;

/// Find what a declared model lacks: refit it to a recording, trace the residual to an effect, add
/// it, and show the error before and after on held-out data.
///
/// Verdicts: found, none (the residual is noise), unknown (something is there that no law of the
/// list explains), not_separable (two laws explain it equally). Writes identified.yaml, which the
/// stage node and every experiment load, summary.json, report.html and the figures. Ctrl-C ends the
/// search after the running step and writes what there is.
///
/// Exit code: 0 done, 1 failed, 2 wrong arguments, 3 done with warnings, 130 stopped with Ctrl-C.
/// Notes, such as that there is no setpoint, are no warnings.
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
    /// Bags or tables to identify on; several are joined
    #[arg(long, value_name = "BAG", num_args = 1.., required = true)]
    pub train: Vec<PathBuf>,
    /// Bags or tables that no fit sees: they decide what is kept
    #[arg(long, value_name = "BAG", num_args = 1.., required = true)]
    pub holdout: Vec<PathBuf>,
    /// Directory for the results
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Replace an earlier identification in that directory
    #[arg(long)]
    pub force: bool,
    /// YAML file that says which topic and field, or column, is which signal
    #[arg(long, value_name = "FILE")]
    pub mapping: Option<PathBuf>,
    /// How far the mass may be from the declared one, as a share of it; 1 and more, up to 9, is a
    /// factor of 1 + SHARE either way
    #[arg(
        long,
        value_name = "SHARE",
        default_value_t = Tolerances::default().mass,
        value_parser = share,
    )]
    pub mass_tolerance: f64,
    /// The same for each parameter of the guides, as where nothing is known of their friction
    #[arg(
        long,
        value_name = "SHARE",
        default_value_t = Tolerances::default().guides,
        value_parser = share,
    )]
    pub guide_tolerance: f64,
    /// The same for bristle stiffness, bristle damping, static friction and Stribeck velocity,
    /// where they are known worse, without an upper limit [default: that of the guides]
    #[arg(long, value_name = "SHARE", value_parser = positive)]
    pub presliding_tolerance: Option<f64>,
    /// Write the motion that would best settle what these data leave open, as a
    /// trajectory_msgs/JointTrajectory in YAML for `ros2 topic pub` and rclpy
    /// [default FILE: next_experiment.yaml in the directory of the results]
    #[arg(long, value_name = "FILE", num_args = 0..=1)]
    pub next_experiment: Option<Option<PathBuf>>,
    #[command(flatten)]
    pub part: PartArgs,
    #[command(flatten)]
    pub limits: next::LimitArgs,
    /// Print summary.json instead of text
    #[arg(long)]
    pub json: bool,
}

/// Name of the identified model in the output directory.
const MODEL_FILE: &str = "identified.yaml";
/// Name of the model with laws that explain a part only.
const PARTIAL_MODEL_FILE: &str = "partial.yaml";

fn share(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    if value > 0.0 && value <= Tolerances::MOST {
        Ok(value)
    } else {
        Err(format!(
            "{value} must be above 0 and at most {}, such as 0.16 for 16 %",
            Tolerances::MOST
        ))
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

/// Steps of the whole identification, as far as they are shown.
const STEPS: u64 = 1000;

/// Shows what is tried, and knows whether to stop.
struct Watched {
    progress: Progress,
}

impl Watch for Watched {
    fn progress(&self, what: &str, share: f64) {
        self.progress.say(what);
        self.progress.reach((STEPS as f64 * share.clamp(0.0, 1.0)) as u64);
    }

    fn stopped(&self) -> bool {
        interrupt::seen()
    }
}

/// Runs the command; results go to `out`, progress to stderr.
pub fn run(args: &IdentifyArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let mapping = args.mapping.as_deref().map(Mapping::load).transpose()?;
    let part = args.part.window()?;
    let declared = model_named(&args.model)?;
    super::tell_assumptions(Some(&declared));
    may_write(&args.out, args.force)?;
    interrupt::writes(&args.out);
    let _patience = Patience::begin();
    let progress = Progress::of(STEPS, "reading");
    tell_of_stop(progress.bar());

    let tolerances = Tolerances {
        mass: args.mass_tolerance,
        guides: args.guide_tolerance,
        presliding: args.presliding_tolerance.unwrap_or(args.guide_tolerance),
    };
    let (train, holdout) = (&args.train, &args.holdout);
    let records = Records::load(train, holdout, mapping.as_ref(), part, &declared, tolerances)
        .map_err(|error| refused(error, declared.joint))?;
    let limits = args
        .next_experiment
        .as_ref()
        .map(|_| args.limits.limits(&declared, &records.train))
        .transpose()?;
    // Where nothing can be written, the user does not wait for it.
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
    let watch = Watched { progress };
    let mut found = Identification::new(&declared, tolerances, &records, &watch)?;
    if let Some(limits) = limits {
        watch.progress.say("next experiment");
        found.plan_next(&records, limits);
        if let (Some(plan), Some(file)) = (&mut found.next, &motion_file) {
            plan.next.file = file.display().to_string();
        }
    }

    watch.progress.say("report");
    let summary = identification_summary(&found, &records, MODEL_FILE);
    let figures = identification_figures(&found, &records)?;
    let html = identification_page(&args.model, &found, &records, &summary, &figures)?;
    if found.next.is_none() {
        // That of an earlier identification is not this one's.
        let _ = std::fs::remove_file(args.out.join(next::FILE));
    }
    let model = match &found.partial {
        Some(partial) => {
            let model = identified_model_file(partial, &summary)?;
            let signed = made_by::signed(PARTIAL_MODEL_FILE, &model);
            write(&args.out.join(PARTIAL_MODEL_FILE), &signed)?;
            usable_model_file(&found.model, &summary, PARTIAL_MODEL_FILE)?
        }
        None => {
            // That of an earlier identification is not this one's.
            let _ = std::fs::remove_file(args.out.join(PARTIAL_MODEL_FILE));
            identified_model_file(&found.model, &summary)?
        }
    };
    write(&args.out.join(MODEL_FILE), &made_by::signed(MODEL_FILE, &model))?;
    for figure in &figures {
        let name = format!("{}.svg", figure.name);
        write(&args.out.join("figures").join(&name), &made_by::signed(&name, &figure.svg))?;
    }
    let page = args.out.join("report.html");
    write(&page, &made_by::signed("report.html", &html))?;
    if let (Some(file), Some(plan)) = (&motion_file, &found.next) {
        let comments = next_experiment_lines(&plan.next, declared.joint);
        let text = next_experiment::trajectory_yaml(&plan.points, topics::JOINT, &comments);
        write(file, &made_by::signed("motion.yaml", &text))?;
    }
    let json = serde_json::to_string_pretty(&summary)? + "\n";
    write(&args.out.join("summary.json"), &json)?;
    made_by::write(&args.out)?;
    drop(watch);

    if args.json {
        write!(out, "{json}")?;
    } else {
        write!(out, "{}", identification_text(&summary, &page))?;
    }
    if interrupt::seen() {
        return Err(Interrupted(format!(
            "interrupted; the partial report is kept in {}",
            args.out.display()
        ))
        .into());
    }
    Ok(Outcome::warned(summary.has_warnings()))
}

/// Recordings that stand where they must not are wrong arguments.
fn refused(error: RecordsError, joint: JointType) -> anyhow::Error {
    let text = records_error(&error, joint);
    match error {
        RecordsError::Twice { .. } | RecordsError::BothSides { .. } => WrongArguments(text).into(),
        RecordsError::Unusable { .. } => anyhow::Error::msg(text),
        other => other.into(),
    }
}

/// Says at once that Ctrl-C was seen: the running step may take a while.
fn tell_of_stop(bar: ProgressBar) {
    std::thread::spawn(move || {
        while !bar.is_finished() {
            if interrupt::seen() {
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
/// earlier identification are replaced with `force` alone.
fn may_write(directory: &Path, force: bool) -> anyhow::Result<()> {
    let refused = |what: &str| {
        let place = directory.display();
        Err(WrongArguments(format!("{place} {what}: choose another --out")).into())
    };
    if directory.join("metadata.yaml").exists() {
        return refused("is a recording");
    }
    let Ok(text) = text_file::read(&directory.join("summary.json")) else {
        let foreign = ["report.html", "identified.yaml"]
            .into_iter()
            .find(|name| directory.join(name).exists());
        return match foreign {
            Some(found) => {
                refused(&format!("holds a {found} and no summary.json of an identification"))
            }
            None => Ok(()),
        };
    };
    let own = serde_json::from_str::<serde_json::Value>(&text)
        .is_ok_and(|value| value.get("verdict").is_some());
    match (own, force) {
        (false, _) => refused("holds results of another command"),
        (true, false) => Err(WrongArguments(format!(
            "{} holds an identification already: choose another --out, or replace it with --force",
            directory.display()
        ))
        .into()),
        (true, true) => Ok(()),
    }
}

fn write(path: &Path, text: &str) -> anyhow::Result<()> {
    std::fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))
}
