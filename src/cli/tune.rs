//! `friction-stage tune`: gains for a stage and an application.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context as _;
use clap::{Args, ValueEnum};

use super::progress::Progress;
use super::{Outcome, WrongArguments, tell_assumptions};
use crate::directory::ResultsArgs;
use crate::node::controller_settings;
use friction_stage_core::model::{EffectParameters, StageModel};
use friction_stage_core::plant::effects::{ALL, ParameterKind, Role};
use friction_stage_core::plant::model_named;
use friction_stage_core::text_file;
use friction_stage_lab::{Application, MeasuredLoop, Objective, TuningPlan};
use friction_stage_report::measured_loop::MeasuredReport;
use friction_stage_report::tuning::{
    controller_parameters, ros2_control_parameters, tuning_json, tuning_page, tuning_text,
    tuning_warnings,
};
use friction_stage_report::words::printable;

/// Propose gains for a stage: as good as the margins allow, over the tolerances of its guides.
///
/// Looks at the loop of stage, sampling and controller at several amplitudes, keeps the largest |S|
/// at 6 dB or less on guides drawn from their tolerances, and takes of all such loops the one that
/// moves best. Writes controller.yaml for controller_node, ros2_control.yaml, report.html, figures
/// and summary.json.
#[derive(Debug, Clone, Args)]
#[command(
    after_help = "Examples:\n  friction-stage tune guide_2\n  friction-stage tune stage.yaml \
                        --application launch_config/application_fast_move_clean.yaml --out \
                        tuning\n  friction-stage tune stage.yaml --compare my_controller.yaml\n  \
                        friction-stage tune stage.yaml --measured controller_loop.json\n  \
                        controller_node --ros-args --params-file tuning/controller.yaml"
)]
pub struct TuneArgs {
    /// Model file or catalogue guide of the stage
    #[arg(value_name = "MODEL")]
    pub model: String,
    /// What the stage is to do, with tolerances and rate (YAML); its mass, guides and motor are
    /// those of MODEL [default: the paper's fine step]
    #[arg(long, value_name = "FILE")]
    pub application: Option<PathBuf>,
    /// What is to be small, each over what the application requires
    #[arg(long, value_enum, default_value_t = Aim::Both)]
    pub objective: Aim,
    /// Parameter file of a controller_node to compare with them
    #[arg(long, value_name = "FILE")]
    pub compare: Option<PathBuf>,
    /// Loop that `~/identify_loop` of a controller_node measured, to show with that of MODEL
    #[arg(long, value_name = "FILE")]
    pub measured: Option<PathBuf>,
    /// Time between a sample and the force that answers it, s, beyond what MODEL says
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0, value_parser = delay)]
    pub delay: f64,
    /// Variants, not seen by the search, on which the gains are compared
    #[arg(long, value_name = "N", default_value_t = 1000,
          value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    pub variants: u64,
    /// Seed of tolerances and noise
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    #[command(flatten)]
    pub results: ResultsArgs,
    /// Print summary.json instead of a table
    #[arg(long)]
    pub json: bool,
}

/// What is to be small.
#[derive(Debug, Clone, Copy, ValueEnum)]
pub enum Aim {
    /// The largest error of the moves
    Peak,
    /// The time to settle
    Settling,
    /// The larger of the two
    Both,
}

fn delay(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    match (0.0..=0.05).contains(&value) {
        true => Ok(value),
        false => Err(format!("{value} s must be between 0 and 0.05")),
    }
}

/// Runs the command; results go to `out`, progress to stderr.
pub fn run(args: &TuneArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let model = late(model_named(&args.model)?, args.delay)?;
    tell_assumptions(Some(&model));
    let mut application = match &args.application {
        None => Application::fine_step(),
        Some(path) => {
            let origin = path.display().to_string();
            let text = text_file::read(path).with_context(|| format!("cannot read {origin}"))?;
            Application::from_yaml(&text, &origin)?
        }
    };
    let compared = args
        .compare
        .as_ref()
        .map(|path| Ok::<_, anyhow::Error>((name_of(path), controller_settings::from_file(path)?)))
        .transpose()?;
    if let Some((name, settings)) = &compared
        && settings.rate != application.controller.rate
    {
        return Err(WrongArguments(format!(
            "{name} samples at {} Hz and the application at {} Hz (controller.rate): give both the \
             same",
            settings.rate, application.controller.rate
        ))
        .into());
    }
    let measured = args.measured.as_ref().map(|path| measured_loop(path)).transpose()?;
    if let Some((name, measured)) = &measured
        && measured.settings.rate != application.controller.rate
    {
        return Err(WrongArguments(format!(
            "{name} was measured at {} Hz and the application is at {} Hz (controller.rate): give \
             an application with the rate of the measurement",
            measured.settings.rate, application.controller.rate
        ))
        .into());
    }
    let mut notes = Vec::new();
    let mass = model.moving_mass();
    if args.application.is_some() && (application.mass / mass - 1.0).abs() > 0.01 {
        notes.push(format!(
            "the application is for {} {kg} and the model moves {mass} {kg}: that of the model \
             counts",
            application.mass,
            kg = model.joint.unit("kg")
        ));
    }
    application.mass = mass;
    application.controller.force_limit = model.motor.force_limit;
    let results = args.results.directory("tune")?;
    let progress = Progress::of(1000, "tuning");
    let objective = match args.objective {
        Aim::Peak => Objective::Peak,
        Aim::Settling => Objective::Settling,
        Aim::Both => Objective::Both,
    };
    let plan = TuningPlan {
        model: model.clone(),
        application,
        objective,
        unseen: args.variants,
        seed: args.seed,
    };
    let tuning = plan.run(compared, &|part| progress.reach((1000.0 * part) as u64))?;
    let measured = measured
        .map(|(name, measured)| {
            MeasuredReport::new(&name, &measured, &model, &tuning.found().settings)
        })
        .transpose()?;
    let measured = measured.as_ref();
    let (page, figures) = tuning_page(
        &name_of(Path::new(&args.model)),
        &model,
        &plan.application,
        &tuning,
        measured,
        args.seed,
    )?;
    drop(progress);
    results.create()?;
    results.write("report.html", &page)?;
    for (name, svg) in &figures {
        results.write(&format!("{name}.svg"), svg)?;
    }
    results.write("controller.yaml", &controller_parameters(&model, tuning.found()))?;
    results.write("ros2_control.yaml", &ros2_control_parameters(tuning.found()))?;
    let json = serde_json::to_string_pretty(&tuning_json(&tuning, measured))?;
    results.write("summary.json", &format!("{json}\n"))?;
    notes.extend(tuning_warnings(&tuning, measured));
    if args.json {
        writeln!(out, "{json}")?;
    } else {
        write!(out, "{}", tuning_text(&tuning, model.joint))?;
        if let Some(measured) = measured {
            write!(out, "\n{}", measured.text())?;
        }
        writeln!(
            out,
            "\n{}: report.html, controller.yaml, ros2_control.yaml, summary.json",
            results.path().display()
        )?;
    }
    for note in &notes {
        eprintln!("warning: {}", printable(note));
    }
    Ok(Outcome::warned(!notes.is_empty()))
}

fn measured_loop(path: &Path) -> anyhow::Result<(String, MeasuredLoop)> {
    let origin = path.display().to_string();
    let text = text_file::read(path).with_context(|| format!("cannot read {origin}"))?;
    Ok((name_of(path), MeasuredLoop::from_json(&text, &origin)?))
}

fn name_of(path: &Path) -> String {
    path.file_name()
        .map_or_else(|| path.display().to_string(), |name| name.to_string_lossy().into())
}

/// The model with a motor that is later by a delay.
fn late(mut model: StageModel, delay: f64) -> anyhow::Result<StageModel> {
    let of_motor = ALL.iter().filter(|effect| matches!(effect.role, Role::Command(_)));
    let mut delays =
        of_motor.flat_map(|effect| effect.parameters.iter().map(|one| (effect.name, one)));
    let found = delays.find(|(_, parameter)| parameter.kind == ParameterKind::Delay);
    if delay > 0.0
        && let Some((effect, parameter)) = found
    {
        if model.effects.iter().any(|one| one.name == effect) {
            return Err(WrongArguments(format!(
                "{} has an {effect} of its own: put the {delay} s of --delay into its delay",
                model.name
            ))
            .into());
        }
        model.effects.push(EffectParameters::new(effect, [(parameter.name, delay)]));
    }
    Ok(model)
}
