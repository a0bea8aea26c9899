//! `friction-stage play`: a motion from a file, on a stage and its controller over ROS 2.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

use anyhow::Context as _;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use serde::{Deserialize, Serialize};

use super::{Outcome, WrongArguments};
use crate::cpu;
use crate::node::driver::{Driver, LockstepRun};
use friction_stage_core::control::Point;
use friction_stage_core::model::StageModel;
use friction_stage_core::plant::Rates;
use friction_stage_data::bag::topics;
use friction_stage_data::message::{self, JointTrajectory, JointTrajectoryPoint};
use friction_stage_data::wire::{Setpoint, setpoint};

/// Play a motion on a stage over ROS 2 and record it.
///
/// The motion is a trajectory_msgs/JointTrajectory in YAML, such as `identify --next-experiment`
/// writes: the file that `ros2 topic pub /stage/setpoint trajectory_msgs/msg/JointTrajectory` takes
/// for a stage that runs already. Here the stage node and the controller node are started as two
/// processes in lockstep on loopback, the stage at position 0 on the model that is given.
#[derive(Debug, Clone, Args)]
#[command(after_help = "Examples:\n  friction-stage play next_experiment.yaml --model stage.yaml \
                  --record second\n  friction-stage play next_experiment.yaml --model stage.yaml \
                  --record third --stretch 1.25 --seed 2")]
pub struct PlayArgs {
    /// The motion
    #[arg(value_name = "MOTION")]
    pub motion: PathBuf,
    /// Model file or catalogue guide of the stage
    #[arg(long, value_name = "MODEL", default_value = "guide_1")]
    pub model: String,
    /// Bag directory to record into; it must not exist
    #[arg(long, value_name = "BAG")]
    pub record: PathBuf,
    /// Samples per second of stage and controller, Hz
    #[arg(long, value_name = "HZ", default_value_t = 4000.0)]
    pub rate: f64,
    /// Play it in this many times its time: the same way at other speeds
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0, value_parser = stretch)]
    pub stretch: f64,
    /// Seed of the sensor noise
    #[arg(long, default_value_t = 1)]
    pub seed: u32,
    /// ROS domain of the run [default: one that nobody else on this machine uses]
    #[arg(long, value_name = "ID", value_parser = clap::value_parser!(u16).range(0..=232))]
    pub domain: Option<u16>,
    /// Print JSON instead of text
    #[arg(long)]
    pub json: bool,
}

/// Largest factor that is not a slip.
const LARGEST_STRETCH: f64 = 1000.0;

fn stretch(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    if (LARGEST_STRETCH.recip()..=LARGEST_STRETCH).contains(&value) {
        Ok(value)
    } else {
        Err(format!("{value} must be between {} and {LARGEST_STRETCH}", LARGEST_STRETCH.recip()))
    }
}

/// A `trajectory_msgs/JointTrajectory` in YAML; what a file leaves out is empty or 0, as
/// `ros2 topic pub` has it.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    /// When to start is said by whoever plays it.
    #[serde(default, rename = "header")]
    _header: serde::de::IgnoredAny,
    joint_names: Vec<String>,
    points: Vec<FilePoint>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct FilePoint {
    positions: Vec<f64>,
    #[serde(default)]
    velocities: Vec<f64>,
    #[serde(default)]
    accelerations: Vec<f64>,
    #[serde(default)]
    effort: Vec<f64>,
    #[serde(default)]
    time_from_start: FileDuration,
}

#[derive(Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct FileDuration {
    sec: i32,
    nanosec: u32,
}

/// What was played.
#[derive(Debug, Serialize)]
struct PlayReport {
    bag: PathBuf,
    /// s
    duration: f64,
    points: usize,
    cycles: u64,
    cycles_per_second: f64,
    /// Every sample of every topic is in the bag.
    complete: bool,
}

/// The points of a motion file, checked as the nodes check them.
fn load(path: &Path) -> anyhow::Result<Vec<Point>> {
    let text =
        std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    points(&text).with_context(|| format!("{} is no motion", path.display()))
}

fn points(text: &str) -> anyhow::Result<Vec<Point>> {
    let file: File = serde_saphyr::from_str(text)
        .map_err(|error| anyhow::anyhow!("{}", error.without_snippet()))?;
    let points = file
        .points
        .into_iter()
        .map(|point| JointTrajectoryPoint {
            positions: point.positions,
            velocities: point.velocities,
            accelerations: point.accelerations,
            effort: point.effort,
            time_from_start: message::Duration {
                sec: point.time_from_start.sec,
                nanosec: point.time_from_start.nanosec,
            },
        })
        .collect();
    let message =
        JointTrajectory { joint_names: file.joint_names, points, ..JointTrajectory::default() };
    match setpoint(&message, topics::JOINT, 0)? {
        Setpoint::Motion(motion) => Ok(motion.points().to_vec()),
        Setpoint::Now(_) => {
            anyhow::bail!("one point without a time_from_start is a setpoint and no motion")
        }
    }
}

/// The same way in `factor` times the time.
fn stretched(points: &[Point], factor: f64) -> Vec<Point> {
    points
        .iter()
        .map(|point| Point {
            time: (point.time as f64 * factor).round() as i64,
            velocity: point.velocity.map(|velocity| velocity / factor),
            acceleration: point.acceleration.map(|acceleration| acceleration / (factor * factor)),
            ..*point
        })
        .collect()
}

/// Runs the command; results go to `out`, progress to stderr.
pub fn run(args: &PlayArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let points = stretched(&load(&args.motion)?, args.stretch);
    // Told here, not from the log of a node.
    let model = StageModel::named(&args.model)?;
    let mass = model.moving_mass();
    if args.record.exists() {
        return Err(WrongArguments(format!(
            "{} exists already: choose another --record",
            args.record.display()
        ))
        .into());
    }
    if let Some(parent) = args.record.parent() {
        std::fs::create_dir_all(parent)
            .with_context(|| format!("cannot create {}", parent.display()))?;
    }
    let seconds = points.last().map_or(0.0, |point| point.time as f64 * 1e-9);
    let bar = ProgressBar::new((1000.0 * seconds) as u64);
    bar.set_style(
        ProgressStyle::with_template("{msg:24} [{bar:40}] {percent:>3} %  {elapsed}")?
            .progress_chars("=> "),
    );
    bar.enable_steady_tick(Duration::from_millis(200));
    bar.set_message("starting");
    let parameters = |given: &[String]| -> Vec<String> {
        given.iter().flat_map(|parameter| ["-p".to_owned(), parameter.clone()]).collect()
    };
    let cpu = format!("cpu:={}", cpu::online() - 1);
    let run = LockstepRun {
        stage_arguments: parameters(&[
            format!("model:={}", args.model),
            format!("seed:={}", args.seed),
            format!("control_rate:={:?}", args.rate),
            format!("physics_rate:={:?}", Rates::of_control(args.rate)?.physics()),
            format!("record:={}", args.record.display()),
            cpu.clone(),
        ]),
        // The controller of the paper, for what this stage moves.
        controller_arguments: parameters(&[
            format!("rate:={:?}", args.rate),
            format!("mass:={mass:?}"),
            format!("feedforward.mass:={mass:?}"),
            format!("gains.stage.u_clamp_max:={:?}", model.motor.force_limit),
            format!("gains.stage.u_clamp_min:={:?}", -model.motor.force_limit),
            format!("stroke_min:={:?}", model.stroke.map_or(-1e6, |stroke| stroke.low)),
            format!("stroke_max:={:?}", model.stroke.map_or(1e6, |stroke| stroke.high)),
            cpu,
        ]),
        points,
        log_stem: args.record.clone(),
    };
    let count = run.points.len();
    let done =
        Driver::on_loopback(&std::env::current_exe()?, args.domain)?.run(&run, &mut |time| {
            bar.set_message(format!("{time:.1} of {seconds:.1} s"));
            bar.set_position((1000.0 * time.min(seconds)) as u64);
        })?;
    bar.finish_and_clear();
    let report = PlayReport {
        bag: args.record.clone(),
        duration: seconds,
        points: count,
        cycles: done.cycles,
        cycles_per_second: done.rate,
        complete: !done.incomplete,
    };
    if args.json {
        writeln!(out, "{}", serde_json::to_string_pretty(&report)?)?;
    } else {
        writeln!(
            out,
            "{}: {:.1} s of motion, {} samples at {:.0} per second",
            report.bag.display(),
            report.duration,
            report.cycles,
            report.cycles_per_second
        )?;
    }
    if done.incomplete {
        eprintln!("warning: {} lacks samples; its log says how many", report.bag.display());
    }
    Ok(Outcome::warned(done.incomplete))
}

#[cfg(test)]
mod tests {
    use super::*;
    use friction_stage_identify::next_experiment::trajectory_yaml;

    #[test]
    fn what_identify_writes_is_a_motion_that_can_be_played() {
        let point = |time, position| Point {
            time,
            position,
            velocity: Some(-0.25),
            acceleration: Some(1.5),
            effort: 0.0,
        };
        let given = [point(1_500_000_000, -1e-6), point(2_000_000_001, 0.02)];
        let text = trajectory_yaml(&given, topics::JOINT, &["a comment".to_owned()]);
        assert_eq!(points(&text).unwrap(), given);
        let slower = stretched(&given, 2.0);
        assert_eq!(
            (slower[0].time, slower[0].velocity, slower[0].acceleration),
            (3_000_000_000, Some(-0.125), Some(0.375))
        );
    }

    #[test]
    fn a_file_that_is_no_motion_is_refused_with_the_reason() {
        for (text, words) in [
            ("joint_names: [stage]\npoints: []", "no points"),
            (
                "joint_names: [slider]\npoints: [{positions: [0.1], time_from_start: {sec: 1}}]",
                "no joint `stage` among [slider]",
            ),
            ("joint_names: [stage]\npoints: [{position: [0.1]}]", "position"),
            ("joint_names: [stage]\npoints: [{positions: [0.1]}]", "setpoint and no motion"),
            (
                "joint_names: [stage]\npoints: [{positions: [0.1, 0.2], time_from_start: {sec: \
                 1}}]",
                "2 positions for 1 joints",
            ),
            (
                "joint_names: [stage]\npoints: [{positions: [.nan], time_from_start: {sec: 1}}]",
                "finite",
            ),
        ] {
            let told = format!("{:#}", points(text).unwrap_err());
            assert!(told.contains(words), "{words:?} is not in {told:?}");
        }
    }
}
