//! `Motion`: the points that a controller follows, and the moves among them that are judged.

use friction_stage_core::control::{Point, Trajectory};
use friction_stage_data::bag::topics;
use friction_stage_data::motion_file;
use friction_stage_identify::next_experiment::trajectory_yaml;
use friction_stage_lab::{Move, PaperMotion};
use numpy::PyReadonlyArray1;
use pyo3::prelude::*;

use crate::error::{OrRaise, raised};
use crate::model::TextOrPath;

/// Latest point, s: the largest time that a trajectory_msgs/JointTrajectory can say.
const LONGEST: f64 = i32::MAX as f64;

/// A motion from time 0 on.
#[pyclass(frozen, eq, module = "friction_stage")]
#[derive(Clone, PartialEq)]
pub(crate) struct Motion {
    pub points: Vec<Point>,
    pub moves: Vec<Move>,
}

impl Motion {
    pub(crate) fn checked(points: Vec<Point>, moves: Vec<Move>) -> PyResult<Motion> {
        let trajectory = Trajectory::new(0, points).or_raise()?;
        Ok(Motion { points: trajectory.points().to_vec(), moves })
    }

    fn of_paper(motion: PaperMotion) -> PyResult<Motion> {
        Motion::checked(motion.points, motion.moves)
    }

    /// s
    pub(crate) fn seconds(&self) -> f64 {
        self.points.last().map_or(0.0, |point| point.time as f64 * 1e-9)
    }
}

#[pymethods]
impl Motion {
    #[new]
    #[pyo3(signature = (time, position, velocity = None, acceleration = None, effort = None))]
    fn new(
        time: PyReadonlyArray1<'_, f64>,
        position: PyReadonlyArray1<'_, f64>,
        velocity: Option<PyReadonlyArray1<'_, f64>>,
        acceleration: Option<PyReadonlyArray1<'_, f64>>,
        effort: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<Motion> {
        let time: Vec<f64> = time.as_array().to_vec();
        let column = |name: &str, values: Option<PyReadonlyArray1<'_, f64>>| {
            let Some(values) = values else { return Ok(None) };
            let values = values.as_array().to_vec();
            if values.len() == time.len() {
                return Ok(Some(values));
            }
            Err(raised::MotionError::new_err(format!(
                "{} values of {name} for {} of time: give one for each point",
                values.len(),
                time.len()
            )))
        };
        let (velocity, acceleration) =
            (column("velocity", velocity)?, column("acceleration", acceleration)?);
        let (position, effort) = (column("position", Some(position))?, column("effort", effort)?);
        let at = |values: &Option<Vec<f64>>, index: usize| values.as_ref().map(|all| all[index]);
        let points = time
            .iter()
            .enumerate()
            .map(|(index, seconds)| {
                if !seconds.is_finite() || seconds.abs() > LONGEST {
                    return Err(raised::MotionError::new_err(format!(
                        "point {index}: time is {seconds} s, must be finite and at most {} s",
                        LONGEST
                    )));
                }
                Ok(Point {
                    time: (seconds * 1e9).round() as i64,
                    position: at(&position, index).unwrap_or(f64::NAN),
                    velocity: at(&velocity, index),
                    acceleration: at(&acceleration, index),
                    effort: at(&effort, index).unwrap_or(0.0),
                })
            })
            .collect::<PyResult<Vec<Point>>>()?;
        Motion::checked(points, Vec::new())
    }

    #[staticmethod]
    fn from_yaml(source: TextOrPath) -> PyResult<Motion> {
        let points = match source.or_file() {
            TextOrPath::Text(text) => motion_file::from_yaml(&text, "the motion"),
            TextOrPath::Path(path) => motion_file::load(&path),
        };
        Motion::checked(points.or_raise()?, Vec::new())
    }

    fn to_yaml(&self) -> String {
        trajectory_yaml(&self.points, topics::JOINT, &[])
    }

    fn stretched(&self, factor: f64) -> PyResult<Motion> {
        motion_file::check_stretch(factor).or_raise()?;
        let longer = |time: i64| (time as f64 * factor).round() as i64;
        let moves = self.moves.iter().map(|the_move| Move {
            start: longer(the_move.start),
            arrival: longer(the_move.arrival),
            end: longer(the_move.end),
            ..*the_move
        });
        Motion::checked(motion_file::stretched(&self.points, factor), moves.collect())
    }

    #[staticmethod]
    #[pyo3(signature = (moves, *, lead = PaperMotion::LEAD))]
    fn of_moves(moves: Vec<(f64, f64, f64)>, lead: f64) -> PyResult<Motion> {
        Motion::of_paper(PaperMotion::of_moves(lead, &moves).or_raise()?)
    }

    #[staticmethod]
    #[pyo3(signature = (rest = friction_stage_lab::Conditioning::PAPER_REST))]
    fn fast_move(rest: f64) -> PyResult<Motion> {
        Motion::of_paper(PaperMotion::fast(rest))
    }

    #[staticmethod]
    #[pyo3(signature = (rest = friction_stage_lab::Conditioning::PAPER_REST, steps = 5))]
    fn fine_step(rest: f64, steps: usize) -> PyResult<Motion> {
        Motion::of_paper(PaperMotion::fine(rest, steps))
    }

    #[getter]
    fn duration(&self) -> f64 {
        self.seconds()
    }

    fn __len__(&self) -> usize {
        self.points.len()
    }

    fn __repr__(&self) -> String {
        format!("<Motion of {} points over {} s>", self.points.len(), self.seconds())
    }
}
