//! `friction-stage play`: a motion from a file, on a stage and its controller over ROS 2.

use std::io::Write;
use std::path::PathBuf;

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;

use super::progress::Progress;
use super::{Outcome, WrongArguments};
use crate::cpu;
use crate::node::driver::{Driver, LockstepRun};
use friction_stage_core::control::{Follower, Point, Trajectory};
use friction_stage_core::model::StageModel;
use friction_stage_core::plant::Rates;
use friction_stage_data::motion_file;

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

fn stretch(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| format!("`{text}` is no number"))?;
    motion_file::check_stretch(value).map_err(|error| error.to_string())?;
    Ok(value)
}

/// Longest motion, ns: times on the clock of the samples must not overflow.
const LONGEST: i64 = i64::MAX / 4;

/// Refuses what the controller would refuse, before anything is started.
fn check_motion(points: &[Point], model: &StageModel) -> anyhow::Result<()> {
    let trajectory = Trajectory::new(0, points.to_vec())?;
    anyhow::ensure!(
        trajectory.end() <= LONGEST,
        "the motion takes {:.3e} s, must take less than {:.3e} s",
        trajectory.end() as f64 * 1e-9,
        LONGEST as f64 * 1e-9
    );
    let (low, high) = stroke(model);
    // A jump at the start is for the node to judge, which knows where the stage is.
    Follower::new(f64::INFINITY).within(low, high).follow(0, trajectory)?;
    Ok(())
}

/// Lowest and highest position of a model, m.
fn stroke(model: &StageModel) -> (f64, f64) {
    model.stroke.map_or((-1e6, 1e6), |stroke| (stroke.low, stroke.high))
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

/// Runs the command; results go to `out`, progress to stderr.
pub fn run(args: &PlayArgs, out: &mut dyn Write) -> anyhow::Result<Outcome> {
    let points = motion_file::stretched(&motion_file::load(&args.motion)?, args.stretch);
    // Told here, not from the log of a node.
    let model = StageModel::named(&args.model)?;
    let mass = model.moving_mass();
    check_motion(&points, &model).with_context(|| args.motion.display().to_string())?;
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
    let progress = Progress::of((1000.0 * seconds) as u64, "starting");
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
            format!("stroke_min:={:?}", stroke(&model).0),
            format!("stroke_max:={:?}", stroke(&model).1),
            cpu,
        ]),
        points,
        log_stem: args.record.clone(),
    };
    let count = run.points.len();
    let done =
        Driver::on_loopback(&std::env::current_exe()?, args.domain)?.run(&run, &mut |time| {
            progress.say(format!("{time:.1}/{seconds:.1} s"));
            progress.reach((1000.0 * time.min(seconds)) as u64);
        })?;
    drop(progress);
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
    use friction_stage_data::bag::topics;
    use friction_stage_data::motion_file::{from_yaml, stretched};
    use friction_stage_identify::next_experiment::trajectory_yaml;

    use super::*;

    #[test]
    fn a_motion_that_no_controller_takes_is_refused_before_anything_starts() {
        let model = StageModel::on_guides("guide_1");
        let check = |points: &[Point]| check_motion(points, &model).unwrap_err().to_string();
        let fast = |velocity| Point { velocity: Some(velocity), ..Point::at_rest(1_000_000, 1e-3) };
        // Finite points, between which the motion is not.
        let error = check(&[fast(1e308), Point::at_rest(2_000_000, 0.0)]);
        assert!(error.contains("velocity") || error.contains("position"), "{error}");
        let error = check(&[Point::at_rest(1_000_000_000, 0.5)]);
        assert!(error.contains("must stay between -0.4 and 0.4 m"), "{error}");
        let error = check(&[Point::at_rest(i64::MAX / 2, 0.1)]);
        assert!(error.contains("must take less than"), "{error}");
        check_motion(&[Point::at_rest(1_000_000_000, 0.1)], &model).unwrap();
    }

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
        assert_eq!(from_yaml(&text, "next.yaml").unwrap(), given);
        let slower = stretched(&given, 2.0);
        assert_eq!(
            (slower[0].time, slower[0].velocity, slower[0].acceleration),
            (3_000_000_000, Some(-0.125), Some(0.375))
        );
    }
}
