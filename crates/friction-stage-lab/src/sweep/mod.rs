//! How a stage, its controller and its motion act over their parameters: any of their keys over a
//! list, a range or a distribution.
//!
//! In come a model, a controller, a motion and axes; out goes one row per point: the values of the
//! axes and how well the motion was followed. Points are numbered and each depends on its number
//! alone.

mod axis;
mod controller;
mod document;
mod summary;
mod unit;

use friction_stage_core::numerics::plain;
use std::ops::Range;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::Value;

pub use self::axis::{Axis, AxisValues, SweepValue};
pub use self::controller::{CONTROLLER_KEYS, GivenParameters, given_by};
pub use self::summary::{AxisSummary, PointSummary, SweepQuantiles, SweepSummary};
pub use self::unit::sweep_unit;
use super::application::{Application, ApplicationMotion};
use super::motion_quality::{FollowedSample, MotionQuality, motion_quality, moves_along};
use super::paper::{Conditioning, Move, MoveKind};
use super::rows::{Cell, Column, ColumnKind, NumberedPlan, OtherJob, Rows};
use super::settling::SETTLING_BANDS;
use super::specimen::{Settings, closed_loop};
use super::variant::variant_seed;
use friction_stage_core::control::{ControllerSettings, Follower, Point, Trajectory};
use friction_stage_core::model::{GuideSource, StageModel, nearest};
use friction_stage_core::plant::{Effects, Rates};

/// What is computed, the same in every shard of it. Point `j` is sample `j % samples` of place
/// `j / samples` of the grid, whose last axis runs fastest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SweepPlan {
    /// The stage; its guides with all their parameters.
    pub model: StageModel,
    /// Parameters of the controller that are given; the rest follows from the model.
    pub controller: GivenParameters,
    /// The motion.
    pub motion: SweepMotion,
    /// What changes.
    pub axes: Vec<Axis>,
    /// Samples at each place of the grid, each with noise and draws of its own.
    pub samples: u64,
    /// Of draws and noise.
    pub seed: u64,
}

/// The motion of a sweep.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum SweepMotion {
    /// A move as an application asks for it.
    Move(ApplicationMotion),
    /// A trajectory.
    Trajectory {
        /// Factor on its times: the same way at another speed.
        stretch: f64,
        /// Its points.
        points: Vec<TrajectoryPoint>,
        /// Start, arrival and end of the moves that are judged, ns.
        moves: Vec<[i64; 3]>,
    },
}

/// A point of a trajectory.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrajectoryPoint {
    /// After the start, ns.
    time: i64,
    position: f64,
    velocity: Option<f64>,
    acceleration: Option<f64>,
    effort: f64,
}

/// What a point gave: how well its motion was followed, or why it could not be.
pub type SweepOutcome = Result<MotionQuality, String>;

/// The rows of a sweep: one per point.
pub type SweepRows = Rows<SweepPlan>;

/// A sweep that cannot be.
#[expect(missing_docs, reason = "the message of each says what its fields are")]
#[derive(Debug, thiserror::Error)]
pub enum SweepError {
    #[error("`{text}`: {reason}")]
    Axis { text: String, reason: String },
    #[error("{key} {reason}")]
    Values { key: String, reason: String },
    #[error("there is no key `{key}`{hint}")]
    Key { key: String, hint: String },
    #[error("the key `{key}` is swept twice: give it one list of values")]
    Twice { key: String },
    #[error("nothing is swept: give at least one KEY=VALUES")]
    NoAxis,
    #[error(
        "{key} is a distribution: say by --samples how many values are drawn from it, such as \
         --samples 1000"
    )]
    NoSamples { key: String },
    #[error("the sweep has {points:e} points, at most {most:e} can be numbered")]
    TooMany { points: f64, most: f64 },
    #[error("{key} = {value}: {reason}")]
    Value { key: String, value: SweepValue, reason: String },
    #[error("{0}")]
    Base(String),
}

/// Most points of a sweep: a double still counts them.
const MOST: u64 = 1 << 52;
/// Largest time of a motion, s. Assumed: guards against a slip of the unit.
const LONGEST: f64 = 36_000.0;

impl SweepMotion {
    /// The motions of the paper by name: `fine-step` and `fast-move`.
    pub const NAMES: [&'static str; 2] = ["fine-step", "fast-move"];

    /// A motion of the paper.
    pub fn named(name: &str) -> Option<SweepMotion> {
        let fine = Application::fine_step().motion;
        match name {
            "fine-step" => Some(SweepMotion::Move(fine)),
            "fast-move" => Some(SweepMotion::Move(ApplicationMotion {
                distance: 50e-3,
                duration: 0.1,
                settle: 0.5,
                and_return: true,
                ..fine
            })),
            _ => None,
        }
    }

    /// A trajectory, judged over these moves; without any, over all that it has.
    pub fn of_points(points: &[Point], moves: &[Move]) -> SweepMotion {
        let along = moves_along(points);
        let judged: Vec<&Move> = match moves.is_empty() {
            true => along.iter().collect(),
            false => moves.iter().filter(|a| a.kind != MoveKind::Conditioning).collect(),
        };
        SweepMotion::Trajectory {
            stretch: 1.0,
            points: points
                .iter()
                .map(|point| TrajectoryPoint {
                    time: point.time,
                    position: point.position,
                    velocity: point.velocity,
                    acceleration: point.acceleration,
                    effort: point.effort,
                })
                .collect(),
            moves: judged.iter().map(|a| [a.start, a.arrival, a.end]).collect(),
        }
    }

    /// Points, and the moves that are judged.
    fn points(&self) -> Result<(Vec<Point>, Vec<Move>), String> {
        let positive = |name: &str, value: f64, most: f64| match value > 0.0 && value <= most {
            true => Ok(()),
            false => Err(format!(
                "motion.{name} is {}, must be greater than 0, at most {most}",
                plain(value)
            )),
        };
        match self {
            SweepMotion::Move(motion) => {
                positive("duration", motion.duration, LONGEST)?;
                positive("settle", motion.settle, LONGEST)?;
                let Conditioning { distance, duration, rest } = motion.conditioning;
                positive("conditioning.duration", duration, LONGEST)?;
                if !(0.0..=LONGEST).contains(&rest) {
                    return Err(format!(
                        "motion.conditioning.rest is {rest}, must be between 0 and {LONGEST}"
                    ));
                }
                for (name, value) in
                    [("distance", motion.distance), ("conditioning.distance", distance)]
                {
                    if !value.is_finite() {
                        return Err(format!("motion.{name} is {value}, must be finite"));
                    }
                }
                let path = motion.path();
                let judged = path
                    .moves
                    .into_iter()
                    .filter(|a_move| a_move.kind == MoveKind::Application)
                    .collect();
                Ok((path.points, judged))
            }
            SweepMotion::Trajectory { stretch, points, moves } => {
                positive("stretch", *stretch, 1e6)?;
                let time = |time: i64| (time as f64 * stretch).round() as i64;
                let scaled = points.iter().map(|point| Point {
                    time: time(point.time),
                    position: point.position,
                    velocity: point.velocity.map(|velocity| velocity / stretch),
                    acceleration: point.acceleration.map(|a| a / (stretch * stretch)),
                    effort: point.effort,
                });
                let judged = moves.iter().map(|[start, arrival, end]| Move {
                    kind: MoveKind::Application,
                    start: time(*start),
                    arrival: time(*arrival),
                    end: time(*end),
                    target: 0.0,
                });
                Ok((scaled.collect(), judged.collect()))
            }
        }
    }

    /// Its keys and values.
    fn document(&self) -> Result<Value, serde_json::Error> {
        match self {
            SweepMotion::Move(motion) => serde_json::to_value(motion),
            SweepMotion::Trajectory { stretch, .. } => {
                Ok(serde_json::json!({ "stretch": stretch }))
            }
        }
    }

    /// The motion with other values of its keys.
    fn of_document(&self, document: Value) -> Result<SweepMotion, serde_json::Error> {
        #[derive(Deserialize)]
        struct Stretch {
            stretch: f64,
        }
        Ok(match self {
            SweepMotion::Move(_) => SweepMotion::Move(serde_json::from_value(document)?),
            SweepMotion::Trajectory { points, moves, .. } => {
                let Stretch { stretch } = serde_json::from_value(document)?;
                SweepMotion::Trajectory { stretch, points: points.clone(), moves: moves.clone() }
            }
        })
    }
}

/// A point ready to run.
struct Prepared {
    model: StageModel,
    settings: ControllerSettings,
    points: Vec<Point>,
    moves: Vec<Move>,
}

impl SweepPlan {
    /// Checks a sweep: its keys, values and number of points. Values that are possible one by one
    /// and not together are for the run to find.
    pub fn new(
        model: StageModel,
        controller: GivenParameters,
        motion: SweepMotion,
        axes: Vec<Axis>,
        samples: Option<u64>,
        seed: u64,
    ) -> Result<SweepPlan, SweepError> {
        let model = StageModel {
            guides: model
                .resolved_guides()
                .map_err(|error| SweepError::Base(error.to_string()))?
                .into_iter()
                .map(GuideSource::Inline)
                .collect(),
            ..model
        };
        if axes.is_empty() {
            return Err(SweepError::NoAxis);
        }
        if let (None, Some(axis)) = (samples, axes.iter().find(|axis| axis.is_drawn())) {
            return Err(SweepError::NoSamples { key: axis.key.clone() });
        }
        let samples = samples.unwrap_or(1).max(1);
        let plan = SweepPlan { model, controller, motion, axes, samples, seed };
        let points: f64 =
            plan.axes.iter().map(|axis| axis.count() as f64).product::<f64>() * samples as f64;
        if points > MOST as f64 {
            return Err(SweepError::TooMany { points, most: MOST as f64 });
        }
        plan.prepare(&[]).map_err(SweepError::Base)?;
        for (index, axis) in plan.axes.iter().enumerate() {
            axis.check()?;
            if plan.axes[..index].iter().any(|other| other.key == axis.key) {
                return Err(SweepError::Twice { key: axis.key.clone() });
            }
            // Of numbers the type is the same; each name is a slip of its own.
            let checked = if axis.is_numeric() { 1 } else { axis.count() };
            for place in 0..checked {
                plan.check_value(axis, axis.value(place, seed, 0))?;
            }
        }
        Ok(plan)
    }

    /// Refuses a key that there is not, a value of the wrong type, and names of guides and forms
    /// that nothing has.
    fn check_value(&self, axis: &Axis, value: SweepValue) -> Result<(), SweepError> {
        let key = &axis.key;
        let unknown = |hint: String| SweepError::Key { key: key.clone(), hint };
        let internal = |error: serde_json::Error| SweepError::Base(error.to_string());
        let (section, path) = key.split_once('.').unwrap_or((key, ""));
        // A hint names a key as it is given, with its section.
        let within = |hint: String| hint.replace("mean `", &format!("mean `{section}."));
        match section {
            "model" if !path.is_empty() => {
                let mut document = serde_json::to_value(&self.model).map_err(internal)?;
                document::set(&mut document, path, &value).map_err(|hint| unknown(within(hint)))?;
                match serde_json::from_value::<StageModel>(document) {
                    Ok(model) if value.number().is_none() && has_own_bristles(&model, path) => {
                        let reason = "the model has distributed_bristles, whose shares are those \
                                      of its own guides: sweep over a model without them"
                            .to_owned();
                        return Err(SweepError::Value { key: key.clone(), value, reason });
                    }
                    Ok(model) if value.number().is_none() => {
                        let guides = model.resolved_guides().map(drop);
                        let names = guides.and_then(|()| Effects::new(&model.effects).map(drop));
                        return names.map_err(|error| {
                            let reason = error.to_string();
                            SweepError::Value { key: key.clone(), value, reason }
                        });
                    }
                    read => read.map(drop),
                }
            }
            "motion" if !path.is_empty() => {
                let mut document = self.motion.document().map_err(internal)?;
                document::set(&mut document, path, &value).map_err(|hint| unknown(within(hint)))?;
                self.motion.of_document(document).map(drop)
            }
            "controller" if !path.is_empty() => {
                return match controller::obstacle(path, &self.controller) {
                    None => Ok(()),
                    Some(hint) => Err(unknown(within(hint))),
                };
            }
            _ => return Err(unknown(self.nearest(key))),
        }
        .map_err(|error| {
            let reason = match sweep_unit(key) {
                Some(unit) if value.number().is_none() => {
                    format!("must be a number, in {}", self.model.joint.unit(unit))
                }
                _ => error.to_string(),
            };
            SweepError::Value { key: key.clone(), value, reason }
        })
    }

    /// The nearest key of all.
    fn nearest(&self, key: &str) -> String {
        let mut all: Vec<String> = Vec::new();
        let of = |name: &str, document: Result<Value, serde_json::Error>| -> Vec<String> {
            let keys = document.map(|document| document::keys(&document)).unwrap_or_default();
            keys.into_iter().map(|key| format!("{name}.{key}")).collect()
        };
        all.extend(of("model", serde_json::to_value(&self.model)));
        all.extend(of("motion", self.motion.document()));
        all.extend(CONTROLLER_KEYS.iter().map(|key| format!("controller.{key}")));
        // Without its section a key is still one of them.
        let tail = all.iter().find(|known| {
            known.split_once('.').is_some_and(|(_, path)| path == key || known.ends_with(key))
        });
        match tail {
            Some(known) => format!("; did you mean `{known}`?"),
            None => match nearest(key, all.iter().map(String::as_str)) {
                hint if hint.is_empty() => {
                    "; keys begin with `model.`, `controller.` or `motion.`".to_owned()
                }
                hint => hint,
            },
        }
    }

    /// The values of the axes at a point.
    pub fn values(&self, point: u64) -> Vec<SweepValue> {
        let (mut place, sample) = (point / self.samples, point % self.samples);
        let mut values: Vec<SweepValue> = self
            .axes
            .iter()
            .rev()
            .map(|axis| {
                let count = axis.count();
                let value = axis.value(place % count, self.seed, sample);
                place /= count;
                value
            })
            .collect();
        values.reverse();
        values
    }

    /// Seed of the noise of a point: the same at every place of the grid, so that what differs
    /// between them is not the noise.
    pub fn noise_seed(&self, point: u64) -> u64 {
        variant_seed(self.seed, "noise", point % self.samples)
    }

    fn prepare(&self, values: &[SweepValue]) -> Result<Prepared, String> {
        let text = |error: serde_json::Error| error.to_string();
        let mut model = None;
        let mut motion = None;
        let mut given = self.controller.clone();
        for (axis, value) in self.axes.iter().zip(values) {
            let refused = |hint: String| format!("there is no key `{}`{hint}", axis.key);
            match axis.key.split_once('.') {
                Some(("model", path)) => {
                    let document = match &mut model {
                        Some(document) => document,
                        None => model.insert(serde_json::to_value(&self.model).map_err(text)?),
                    };
                    document::set(document, path, value).map_err(refused)?;
                }
                Some(("motion", path)) => {
                    let document = match &mut motion {
                        Some(document) => document,
                        None => motion.insert(self.motion.document().map_err(text)?),
                    };
                    document::set(document, path, value).map_err(refused)?;
                }
                Some(("controller", name)) => {
                    given.insert(name.to_owned(), value.clone());
                }
                _ => return Err(refused(String::new())),
            }
        }
        let model = match model {
            Some(document) => serde_json::from_value(document).map_err(text)?,
            None => self.model.clone(),
        };
        model.check().map_err(|error| format!("model.{error}"))?;
        let motion = match motion {
            Some(document) => self.motion.of_document(document).map_err(text)?,
            None => self.motion.clone(),
        };
        let settings = controller::settings_for(&model, &given)?;
        let (points, moves) = motion.points()?;
        Ok(Prepared { model, settings, points, moves })
    }

    /// Computes one point.
    pub fn point(&self, point: u64) -> SweepOutcome {
        let Prepared { model, settings, points, moves } = self.prepare(&self.values(point))?;
        let words = |error: &dyn std::fmt::Display| error.to_string();
        let rates = Rates::of_control(settings.rate).map_err(|error| words(&error))?;
        let trajectory = Trajectory::new(0, points.clone()).map_err(|error| words(&error))?;
        let end = trajectory.end();
        if end as f64 * 1e-9 > LONGEST {
            return Err(format!("the motion takes {:.3e} s, at most {LONGEST}", end as f64 * 1e-9));
        }
        if let Some(stroke) = model.stroke {
            // A jump at its start is one for which the stage waits.
            let mut follower = Follower::new(f64::INFINITY).within(stroke.low, stroke.high);
            follower.follow(0, trajectory).map_err(|error| words(&error))?;
        }
        let lab = Settings { seed: self.noise_seed(point), rates };
        let mut stage =
            closed_loop(&model, &lab, settings, points).map_err(|error| words(&error))?;
        let mut samples = Vec::with_capacity((end as f64 * 1e-9 * rates.control()) as usize + 2);
        loop {
            let cycle = stage.cycle().map_err(|error| words(&error))?;
            samples.push(FollowedSample {
                time: cycle.sample.time,
                error: cycle.terms.error,
                force: cycle.terms.output,
                saturated: cycle.terms.saturated,
            });
            if cycle.sample.time >= end {
                break;
            }
        }
        motion_quality(&moves, &samples).ok_or_else(|| "the motion has no move".to_owned())
    }

    /// Computes points on all processors; outcomes in the order of the points, whatever order they
    /// ended in.
    pub fn run(&self, points: Range<u64>) -> Vec<SweepOutcome> {
        points.into_par_iter().map(|point| self.point(point)).collect()
    }
}

impl NumberedPlan for SweepPlan {
    type Outcome = SweepOutcome;
    const KIND: &'static str = "sweep";
    const ROWS: &'static str = "points";

    fn count(&self) -> u64 {
        self.axes.iter().map(Axis::count).product::<u64>() * self.samples
    }

    fn obstacle(&self) -> Option<String> {
        let size = self.axes.iter().try_fold(self.samples, |size, axis| {
            size.checked_mul(axis.count()).filter(|size| *size <= MOST)
        });
        match size {
            None => Some("has too many points".to_owned()),
            Some(0) => Some("has no points".to_owned()),
            Some(_) => self.axes.iter().find_map(|axis| Some(axis.check().err()?.to_string())),
        }
    }

    fn columns(&self) -> Vec<Column> {
        let axes = self.axes.iter().map(|axis| {
            let kind = if axis.is_numeric() { ColumnKind::Number } else { ColumnKind::Text };
            Column::new(axis.key.clone(), kind)
        });
        let bands =
            SETTLING_BANDS.map(|band| Column::new(settling_column(band), ColumnKind::Optional));
        [Column::new("point", ColumnKind::Count), Column::new("seed", ColumnKind::Count)]
            .into_iter()
            .chain(axes)
            .chain(
                ["peak_error_m", "rms_error_m"].map(|name| Column::new(name, ColumnKind::Optional)),
            )
            .chain(bands)
            .chain([
                Column::new("peak_force_n", ColumnKind::Optional),
                Column::new("saturated_samples", ColumnKind::Count),
                Column::new("failure", ColumnKind::Text),
            ])
            .collect()
    }

    fn row(&self, job: u64, outcome: &SweepOutcome) -> Vec<Cell> {
        let mut row = vec![Cell::Count(job), Cell::Count(self.noise_seed(job))];
        row.extend(self.values(job).into_iter().zip(&self.axes).map(|(value, axis)| {
            match value.number().filter(|_| axis.is_numeric()) {
                Some(number) => Cell::Number(number),
                None => Cell::Text(value.to_string()),
            }
        }));
        let found = outcome.as_ref().ok();
        let number = |of: fn(&MotionQuality) -> f64| Cell::Optional(found.map(of));
        row.extend([number(|q| q.peak_error), number(|q| q.rms_error)]);
        for band in 0..SETTLING_BANDS.len() {
            row.push(Cell::Optional(found.and_then(|quality| quality.settling[band])));
        }
        row.extend([
            number(|q| q.peak_force),
            Cell::Count(found.map_or(0, |quality| quality.saturated)),
            Cell::Text(outcome.as_ref().err().cloned().unwrap_or_default()),
        ]);
        row
    }

    fn outcome(&self, job: u64, row: &[Cell]) -> Result<SweepOutcome, OtherJob> {
        let found = row[0].count();
        if found != job {
            let words = |point: u64| format!("point {point}");
            return Err(OtherJob { found: words(found), planned: words(job) });
        }
        let at = 2 + self.axes.len();
        let failure = row[at + 7].text();
        if !failure.is_empty() {
            return Ok(Err(failure.to_owned()));
        }
        let number = |cell: usize| row[cell].number().unwrap_or(f64::NAN);
        Ok(Ok(MotionQuality {
            peak_error: number(at),
            rms_error: number(at + 1),
            settling: [at + 2, at + 3, at + 4].map(|cell| row[cell].number()),
            peak_force: number(at + 5),
            saturated: row[at + 6].count(),
        }))
    }
}

/// Name of the column of the time to settle into a band.
fn settling_column(band: f64) -> String {
    format!("settling_{}nm_s", (band * 1e9).round())
}

/// Whether a path names guides, and the model has bristles that belong to those that it has.
fn has_own_bristles(model: &StageModel, path: &str) -> bool {
    let names_guides = path == "guides" || path.strip_prefix("guides.").is_some_and(is_number);
    let bristles = || Effects::new(&model.effects).ok()?.bristle_elements();
    names_guides && bristles().is_some()
}

fn is_number(text: &str) -> bool {
    text.parse::<usize>().is_ok()
}

#[cfg(test)]
mod tests {
    use super::super::paper::PaperMotion;
    use super::*;
    use friction_stage_core::model::Stroke;

    fn plan(axes: &[&str], samples: Option<u64>) -> Result<SweepPlan, SweepError> {
        let mut motion = SweepMotion::named("fine-step").unwrap();
        if let SweepMotion::Move(motion) = &mut motion {
            motion.conditioning = Conditioning { distance: 1e-3, duration: 0.02, rest: 0.01 };
            motion.settle = 0.05;
        }
        let axes = axes.iter().map(|axis| axis.parse()).collect::<Result<_, _>>()?;
        SweepPlan::new(
            StageModel::on_guides("guide_2"),
            Default::default(),
            motion,
            axes,
            samples,
            1,
        )
    }

    #[test]
    fn a_grid_has_every_combination_and_its_last_axis_runs_fastest() {
        let plan = plan(&["model.mass=20,40", "controller.bandwidth=40:80:3"], None).unwrap();
        assert_eq!(plan.count(), 6);
        let values: Vec<Vec<f64>> = (0..6)
            .map(|point| plan.values(point).iter().filter_map(SweepValue::number).collect())
            .collect();
        assert_eq!(values[0], [20.0, 40.0]);
        assert_eq!(values[2], [20.0, 80.0]);
        assert_eq!(values[3], [40.0, 40.0]);
    }

    #[test]
    fn the_controller_follows_the_mass_and_twice_the_bandwidth_makes_the_error_smaller() {
        let plan = plan(&["controller.bandwidth=30,60"], None).unwrap();
        let slow = plan.point(0).unwrap();
        let fast = plan.point(1).unwrap();
        assert!(fast.peak_error < 0.9 * slow.peak_error, "{slow:?} {fast:?}");
        let heavy = self::plan(&["model.mass=80"], None).unwrap();
        let prepared = heavy.prepare(&heavy.values(0)).unwrap();
        assert_eq!(prepared.settings, ControllerSettings::paper(80.0, 4000.0, 2000.0));
    }

    /// The sweep of nothing but the value that the model has is the run of the laboratory.
    #[test]
    fn a_point_is_the_run_of_the_laboratory() {
        let plan = plan(&["model.mass=40"], None).unwrap();
        let found = plan.point(0).unwrap();
        let (points, moves) = plan.motion.points().unwrap();
        let settings = Settings { seed: plan.noise_seed(0), rates: Rates::DEFAULT };
        let model = StageModel::on_guides("guide_2");
        let paper = ControllerSettings::paper(40.0, 4000.0, 2000.0);
        let mut stage = closed_loop(&model, &settings, paper, points.clone()).unwrap();
        let end = points.last().unwrap().time;
        let mut peak = 0.0f64;
        loop {
            let cycle = stage.cycle().unwrap();
            if cycle.sample.time >= moves[0].start {
                peak = peak.max(cycle.terms.error.abs());
            }
            if cycle.sample.time >= end {
                break;
            }
        }
        assert_eq!(found.peak_error, peak);
    }

    /// The shares of bristles in parallel are those of one guide.
    #[test]
    fn guides_with_bristles_of_their_own_are_not_exchanged() {
        let model = StageModel::named("guide_2+distributed_bristles").unwrap();
        let plan = |axis: &str| {
            let motion = SweepMotion::named("fine-step").unwrap();
            let axes = vec![axis.parse().unwrap()];
            SweepPlan::new(model.clone(), Default::default(), motion, axes, None, 1)
        };
        for axis in ["model.guides=guide_1", "model.guides.2=guide_1"] {
            let error = plan(axis).unwrap_err().to_string();
            assert!(error.contains("distributed_bristles"), "{axis}: {error}");
        }
        plan("model.guides.stiffness=1e6").unwrap();
    }

    #[test]
    fn keys_of_guides_mean_all_of_them_and_names_change_them() {
        let plan =
            plan(&["model.guides=guide_1,guide_3", "model.guides.0.stiffness=1e6,2e6"], None);
        // A name leaves no numbers to change.
        assert!(plan.unwrap().point(0).unwrap_err().contains("no key"));
        let all = self::plan(&["model.guides.stiffness=1e6"], None).unwrap();
        let guides = all.prepare(&all.values(0)).unwrap().model.resolved_guides().unwrap();
        assert!(guides.iter().all(|guide| guide.stiffness == 1e6));
        let one = self::plan(&["model.guides.1.stiffness=1e6"], None).unwrap();
        let guides = one.prepare(&one.values(0)).unwrap().model.resolved_guides().unwrap();
        assert_eq!(guides.iter().filter(|guide| guide.stiffness == 1e6).count(), 1);
        let named = self::plan(&["model.guides=guide_1"], None).unwrap();
        let guides = named.prepare(&named.values(0)).unwrap().model.guides;
        assert_eq!(guides[3], GuideSource::Catalogue("guide_1".to_owned()));
        self::plan(&["model.guides.damping_velocity=0.1,0.2"], None).unwrap();
    }

    #[test]
    fn effects_are_found_by_their_name_and_where_there_are_two_by_their_number() {
        let yaml = "effects:\n- cogging: {amplitude: 5.0, period: 0.024}\n- cogging: {amplitude: \
                    1.0, period: 0.012}\n- payload: {mass: 2.0}\n";
        let model = StageModel::from_yaml(yaml, "test").unwrap();
        let sweep = |axis: &str| {
            let motion = SweepMotion::named("fine-step").unwrap();
            let axes = vec![axis.parse()?];
            SweepPlan::new(model.clone(), Default::default(), motion, axes, None, 1)
        };
        let changed = |axis: &str| {
            let plan = sweep(axis).unwrap();
            plan.prepare(&plan.values(0)).unwrap().model.effects
        };
        assert_eq!(changed("model.effects.payload.mass=9")[2].values["mass"].number(), Some(9.0));
        let second = changed("model.effects.1.amplitude=3");
        assert_eq!(second[1].values["amplitude"].number(), Some(3.0));
        assert_eq!(second[0].values["amplitude"].number(), Some(5.0));
        // A parameter that the file leaves out.
        changed("model.effects.1.phase=0.5");
        assert!(sweep("model.effects.cogging.amplitude=3").is_err());
        let error = sweep("model.effects.1.amplitud=3").unwrap_err().to_string();
        assert!(error.contains("did you mean `model.effects.1.amplitude`"), "{error}");
        let error = sweep("model.effects.payload.masss=3").unwrap_err().to_string();
        assert!(error.contains("did you mean `model.effects.payload.mass`"), "{error}");
    }

    #[test]
    fn wrong_keys_and_values_are_refused_with_the_nearest() {
        for (axes, samples, words) in [
            (&["model.mas=1"][..], None, "did you mean `model.mass`"),
            (&["model.guides.1.stifness=1"], None, "did you mean `model.guides.1.stiffness`"),
            (&["model.guides=guide_1,gide_2"], None, "did you mean `guide_2`"),
            (&["mass=1"], None, "did you mean `model.mass`"),
            (&["model.guides.stifness=1"], None, "did you mean `model.guides.stiffness`"),
            (&["controller.bandwith=1"], None, "did you mean `controller.bandwidth`"),
            (&["motion.distanc=1"], None, "did you mean `motion.distance`"),
            (&["motion.conditioning.res=1"], None, "did you mean `motion.conditioning.rest`"),
            (&["modle.mass=1"], None, "did you mean `model.mass`"),
            (&["model.mass=heavy"], None, "model.mass = heavy: must be a number, in kg"),
            (&["model.mass=1,2", "model.mass=3"], None, "swept twice"),
            (&["model.mass=normal(40,1)"], None, "--samples"),
            (
                &[
                    "model.mass=1:2:1000000",
                    "model.motor.force_limit=1:2:1000000",
                    "controller.rate=1:2:100000",
                ],
                None,
                "points",
            ),
            (&[], None, "nothing is swept"),
        ] {
            let error = plan(axes, samples).unwrap_err().to_string();
            assert!(error.contains(words), "{axes:?}: {error}");
        }
        let settings = ControllerSettings::paper(40.0, 4000.0, 2000.0);
        let error = SweepPlan::new(
            StageModel::default(),
            given_by(&settings),
            SweepMotion::named("fine-step").unwrap(),
            vec!["controller.bandwidth=40,60".parse().unwrap()],
            None,
            1,
        );
        assert!(error.unwrap_err().to_string().contains("gives all gains"));
    }

    #[test]
    fn what_cannot_be_is_a_row_with_its_reason() {
        let plan = plan(&["model.mass=-1,40"], None).unwrap();
        let outcomes = plan.run(0..2);
        assert!(outcomes[0].as_ref().unwrap_err().contains("model.mass is -1"), "{outcomes:?}");
        assert!(outcomes[1].is_ok());
        for (job, outcome) in (0..).zip(&outcomes) {
            let row = plan.row(job, outcome);
            assert_eq!(row.len(), plan.columns().len());
            assert_eq!(plan.outcome(job, &row).as_ref(), Ok(outcome));
        }
    }

    #[test]
    fn a_plan_survives_its_file() {
        let plan = plan(
            &[
                "model.mass=lognormal(40,0.1)",
                "controller.bandwidth=40:80:3:log",
                "motion.return=true,false",
            ],
            Some(5),
        )
        .unwrap();
        let text = serde_saphyr::to_string(&plan).unwrap();
        let read: SweepPlan = serde_saphyr::from_str(&text).unwrap();
        assert_eq!(read, plan, "{text}");
    }

    #[test]
    fn a_motion_that_leaves_the_stroke_fails_its_point() {
        let points = PaperMotion::of_moves(0.01, &[(1e-3, 0.02, 0.03)]).unwrap().points;
        let motion = SweepMotion::of_points(&points, &[]);
        let axes = vec!["model.stroke.high=5e-4,2e-3".parse().unwrap()];
        let mut model = StageModel::on_guides("guide_2");
        model.stroke = Some(Stroke { low: -1e-3, high: 1e-2, stiffness: 2e6, damping: 5e3 });
        let plan = SweepPlan::new(model, Default::default(), motion, axes, None, 1).unwrap();
        let refused = plan.point(0).unwrap_err();
        assert!(refused.contains("must stay between"), "{refused}");
        assert!(plan.point(1).is_ok());
    }

    #[test]
    fn a_trajectory_is_judged_over_its_moves_and_stretched() {
        let points = PaperMotion::of_moves(0.01, &[(1e-4, 0.02, 0.03)]).unwrap().points;
        let motion = SweepMotion::of_points(&points, &[]);
        let axes = vec!["motion.stretch=1,2".parse().unwrap()];
        let model = StageModel::on_guides("guide_2");
        let plan = SweepPlan::new(model, Default::default(), motion, axes, None, 1).unwrap();
        let (quick, slow) = (plan.point(0).unwrap(), plan.point(1).unwrap());
        // A quarter of the acceleration of the reference.
        assert!(slow.peak_force < 0.6 * quick.peak_force, "{quick:?} {slow:?}");
    }
}
