//! `friction-stage compensate`: the same motion without and with what a model knows.

use std::fmt::Write as _;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;

use super::progress::Progress;
use super::{Outcome, tell_assumptions};
use crate::directory::ResultsArgs;
use crate::node::controller_settings;
use friction_stage_core::control::{CompensationTermsOn, ControllerSettings};
use friction_stage_core::plant::model_named;
use friction_stage_data::bag::topics;
use friction_stage_data::motion_file;
use friction_stage_identify::next_experiment::trajectory_yaml;
use friction_stage_lab::CompensationTrial;
use friction_stage_report::compensation::{
    TrialNames, TrialRuns, compensation_json, compensation_page, compensation_text,
    compensation_warnings,
};

/// Play a motion without and with the compensation of what a model knows, in this process.
///
/// The controller of both runs is the same. Writes report.html, error.svg, summary.json,
/// over_position.csv (the force against cogging, cable and maps, for drives) and
/// motion_with_effort.yaml (for joint_trajectory_controller). A stage on ROS 2 takes the same
/// model: controller_node --ros-args -p compensation:=identified.yaml
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:\n  friction-stage compensate --model identified.yaml --real \
                        stage.yaml motion.yaml\n  friction-stage compensate --model \
                        identified.yaml --real stage.yaml motion.yaml --controller \
                        tuning/controller.yaml --off mass,motor")]
pub struct CompensateArgs {
    /// The motion: a trajectory_msgs/JointTrajectory in YAML
    #[arg(value_name = "MOTION")]
    pub motion: PathBuf,
    /// What is known of the stage: model file or catalogue guide
    #[arg(long, value_name = "MODEL")]
    pub model: String,
    /// The stage as it is: model file or catalogue guide
    #[arg(long, value_name = "MODEL")]
    pub real: String,
    /// Parameter file of the controller [default: the rule of thumb for 60 Hz and the mass of
    /// --model]
    #[arg(long, value_name = "FILE")]
    pub controller: Option<PathBuf>,
    /// Terms that are left out
    #[arg(long, value_name = "TERMS", value_delimiter = ',',
          value_parser = ["mass", "viscous", "bristles", "forces", "motor"])]
    pub off: Vec<String>,
    /// Seed of the sensor noise
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    #[command(flatten)]
    pub results: ResultsArgs,
    /// Print summary.json instead of a table
    #[arg(long)]
    pub json: bool,
}

/// What two models are called: their files without the directories, where that tells them apart.
fn names_of(paths: [&String; 2]) -> [String; 2] {
    let file = |path: &String| {
        Path::new(path).file_name().map_or(path.clone(), |name| name.to_string_lossy().into())
    };
    let short = paths.map(file);
    if short[0] == short[1] { paths.map(String::clone) } else { short }
}

/// Runs the command; results go to `out`.
pub fn run(args: &CompensateArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let points = motion_file::load(&args.motion)?;
    let (known, real) = (model_named(&args.model)?, model_named(&args.real)?);
    tell_assumptions(Some(&known));
    let settings = match &args.controller {
        Some(path) => controller_settings::from_file(path)?,
        None => ControllerSettings::of_model(&known, ControllerSettings::PAPER_BANDWIDTH, 4000.0),
    };
    let on = |term: &str| !args.off.iter().any(|off| off == term);
    let trial = CompensationTrial {
        on: CompensationTermsOn {
            mass: on("mass"),
            viscous: on("viscous"),
            bristles: on("bristles"),
            forces: on("forces"),
            motor: on("motor"),
        },
        seed: args.seed,
        known,
        real,
        settings,
        points,
    };
    let results = args.results.directory("compensate")?;
    let progress = Progress::endless("moving");
    let (plain, compensated) = trial.run()?;
    drop(progress);
    let compensation = trial.compensation()?;
    let left_out = compensation.left_out();
    let [known, real] = names_of([&args.model, &args.real]);
    let names = TrialNames { known: &known, real: &real };
    let runs = TrialRuns { plain: &plain, compensated: &compensated, left_out };
    let (page, svg) = compensation_page(names, &runs)?;
    results.create()?;
    results.write("report.html", &page)?;
    results.write("error.svg", &svg)?;
    let json = serde_json::to_string_pretty(&compensation_json(&runs))?;
    results.write("summary.json", &format!("{json}\n"))?;
    let mut table = String::from("position_m,force_n\n");
    for (position, force) in trial.over_position()? {
        let _ = writeln!(table, "{position:.9},{force:.6}");
    }
    results.write("over_position.csv", &table)?;
    let comments = [format!("{} with the effort of {}", args.motion.display(), args.model)];
    results.write(
        "motion_with_effort.yaml",
        &trajectory_yaml(&trial.with_effort()?, topics::JOINT, &comments),
    )?;
    if args.json {
        writeln!(out, "{json}")?;
    } else {
        write!(out, "{}", compensation_text(&runs))?;
        writeln!(
            out,
            "\n{}: report.html, summary.json, over_position.csv, motion_with_effort.yaml",
            results.path().display()
        )?;
    }
    Ok(Outcome::warned(!compensation_warnings(&runs).is_empty()))
}
