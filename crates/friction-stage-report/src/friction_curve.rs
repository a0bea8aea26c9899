//! A friction curve in words and as a figure.

use std::path::PathBuf;

use serde::Serialize;

use super::chart::{Chart, Style};
use super::figure::FigureError;
use super::words::short;
use friction_stage_core::model::JointType;
use friction_stage_lab::{CurvePoint, Fitted, FrictionCurve};

/// A run at a held speed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Run {
    /// Of which recording it is.
    pub recording: PathBuf,
    /// Length, s.
    pub duration_s: f64,
    /// What it says.
    #[serde(flatten)]
    pub point: CurvePoint,
}

/// A friction curve with the runs that it goes through.
#[derive(Clone, Debug, PartialEq)]
pub struct CurveOfRuns {
    /// Of which the units are.
    pub joint: JointType,
    /// In the order of the recordings.
    pub runs: Vec<Run>,
    /// Recordings in which no speed is held.
    pub left_out: Vec<PathBuf>,
    /// Stretches at held speeds that make no run: their force drifts up to the end.
    pub drifting: usize,
    /// The curve.
    pub curve: FrictionCurve,
}

/// Recordings of different joints.
#[derive(Debug, thiserror::Error)]
#[error(
    "{} is of a {} joint, {} of a {} one: one curve is of one machine",
    first.0.display(), first.1.name(), other.0.display(), other.1.name()
)]
pub struct MixedJoints {
    first: (PathBuf, JointType),
    other: (PathBuf, JointType),
}

impl MixedJoints {
    /// The joint type that all recordings which say one agree in.
    pub fn one_of(joints: &[(PathBuf, JointType)]) -> Result<JointType, Box<MixedJoints>> {
        let Some(first) = joints.first() else { return Ok(JointType::default()) };
        match joints.iter().find(|joint| joint.1 != first.1) {
            Some(other) => {
                Err(Box::new(MixedJoints { first: first.clone(), other: other.clone() }))
            }
            None => Ok(first.1),
        }
    }
}

/// Points of the drawn curve in each direction.
const DRAWN: u32 = 200;

/// The curve, its intervals, and the runs, slowest first.
pub fn curve_text(found: &CurveOfRuns) -> String {
    let [n, speed, viscous] = ["N", "m/s", "N s/m"].map(|unit| found.joint.unit(unit));
    let curve = &found.curve;
    let mut text = format!(
        "{} runs at held speeds ({} speeds) of {} recordings\n\n",
        found.runs.len(),
        curve.speeds,
        found.recordings()
    );
    text += "parameter               value  95 % interval\n";
    let mut line = |name: &str, fitted: Option<Fitted>, unit: &str| {
        if let Some(Fitted { value, ci95: [low, high] }) = fitted {
            let value = short(value);
            text += &format!("{name:18} {value:>10}  {} to {} {unit}\n", short(low), short(high));
        }
    };
    line("coulomb_force", Some(curve.coulomb_force), &n);
    line("viscous_friction", curve.viscous_friction, &viscous);
    line("static_force", curve.stribeck.as_ref().map(|s| s.static_force), &n);
    line("stribeck_velocity", curve.stribeck.as_ref().map(|s| s.velocity), &speed);
    line("offset", curve.offset, &n);
    if curve.stribeck.is_none() {
        text += "no Stribeck curve: friction does not fall with velocity by more than chance\n";
    }
    if curve.offset.is_none() {
        text += "all runs go in one direction: a constant force is part of coulomb_force\n";
    }
    text += &format!(
        "scatter between runs: {} {n} rms beyond the noise in them\n\n",
        short(curve.scatter)
    );
    let mut runs: Vec<&Run> = found.runs.iter().collect();
    runs.sort_by(|a, b| a.point.velocity.total_cmp(&b.point.velocity));
    text += &format!(
        "{:>12} {:>12} {:>12}  time, s  recording\n",
        format!("v, {speed}"),
        format!("{}, {n}", found.joint.quantity("force")),
        format!("curve, {n}")
    );
    for run in runs {
        text += &format!(
            "{:>12} {:>12} {:>12} {:>8.2}  {}\n",
            short(run.point.velocity),
            short(run.point.force),
            short(curve.force(run.point.velocity)),
            run.duration_s,
            run.recording.display()
        );
    }
    if found.drifting > 0 {
        let stretches = if found.drifting == 1 { "stretch" } else { "stretches" };
        text +=
            &format!("{} {stretches} left out: the force drifts up to the end\n", found.drifting);
    }
    if !curve.resists() {
        text += "warning: this friction drives the motion instead of resisting it: check signs and \
                 units of the mapping, and whether the speeds are held long enough\n";
    }
    for path in &found.left_out {
        text += &format!("warning: {} holds no speed: left out\n", path.display());
    }
    text
}

/// The least ratio of fastest to slowest speed that is drawn on a logarithmic axis.
const WIDE: f64 = 10.0;

/// Points and curve of each direction, along the motion, as an SVG document.
///
/// # Errors
/// It cannot be drawn.
pub fn curve_figure(found: &CurveOfRuns) -> Result<String, FigureError> {
    let [n, speed] = ["N", "m/s"].map(|unit| found.joint.unit(unit));
    let force = found.joint.quantity("force");
    let (slowest, fastest) = speeds_of(found.runs.iter());
    let mut chart = Chart::new(
        "Friction over speed",
        format!("speed, {speed}"),
        format!("{force} along the motion, {n}"),
    )
    .logarithmic(fastest > WIDE * slowest, false);
    let directions = [("forward", 1.0), ("return", -1.0)];
    let drawn = directions.into_iter().enumerate().filter_map(|(colour, (name, direction))| {
        let runs: Vec<&Run> =
            found.runs.iter().filter(|run| direction * run.point.velocity > 0.0).collect();
        (!runs.is_empty()).then_some((colour, name, direction, runs))
    });
    for (colour, name, direction, runs) in drawn {
        let points = runs.iter().map(|run| (run.point.velocity, run.point.force));
        let along = points.map(|(velocity, force)| (direction * velocity, direction * force));
        chart.add(name, colour, Style::Marks, along);
        let (slowest, fastest) = speeds_of(runs.iter().copied());
        if fastest > slowest {
            let at = |k: u32| slowest * (fastest / slowest).powf(f64::from(k) / f64::from(DRAWN));
            let curve =
                (0..=DRAWN).map(at).map(|v| (v, direction * found.curve.force(direction * v)));
            chart.add(format!("{name}, fitted"), colour, Style::Line, curve);
        }
    }
    chart.svg()
}

/// Slowest and fastest speed of some runs, m/s.
fn speeds_of<'a>(runs: impl Iterator<Item = &'a Run>) -> (f64, f64) {
    runs.map(|run| run.point.velocity.abs())
        .fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), v| (low.min(v), high.max(v)))
}

impl CurveOfRuns {
    /// How many recordings have a run.
    fn recordings(&self) -> usize {
        let mut names: Vec<&PathBuf> = self.runs.iter().map(|run| &run.recording).collect();
        names.dedup();
        names.len()
    }
}
