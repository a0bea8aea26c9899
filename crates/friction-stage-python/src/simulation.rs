//! `simulate`: stage and controller in one process, as the two nodes are in lockstep.

use friction_stage_core::control::ControllerSettings;
use friction_stage_core::plant::Rates;
use friction_stage_core::{ClosedLoop, Cycle};
use friction_stage_lab::{LabError, MoveResult, Settings, closed_loop, settling};
use numpy::{IntoPyArray as _, PyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::controller::Controller;
use crate::error::OrRaise;
use crate::model::Model;
use crate::motion::Motion;
use crate::waiting::{Caller, wait_for};

/// Cycles between two looks whether to stop: some milliseconds.
const AT_ONCE: usize = 1024;

macro_rules! columns {
    ($($name:ident: $value:expr),* $(,)?) => {
        /// Names of the columns of numbers.
        const NAMES: &[&str] = &[$(stringify!($name)),*];

        /// A run as columns, and whether the motor was at its limit.
        #[derive(Default)]
        struct Columns {
            $($name: Vec<f64>,)*
            saturated: Vec<bool>,
        }

        impl Columns {
            fn with_capacity(rows: usize) -> Columns {
                Columns {
                    $($name: Vec::with_capacity(rows),)*
                    saturated: Vec::with_capacity(rows),
                }
            }

            fn push(&mut self, cycle: &Cycle) {
                $(self.$name.push($value(cycle));)*
                self.saturated.push(cycle.terms.saturated);
            }

            fn into_arrays(self) -> Vec<Vec<f64>> {
                vec![$(self.$name),*]
            }
        }
    };
}

columns! {
    time: |c: &Cycle| c.sample.time as f64 * 1e-9,
    reference_position: |c: &Cycle| c.terms.reference.position,
    reference_velocity: |c: &Cycle| c.terms.reference.velocity,
    reference_acceleration: |c: &Cycle| c.terms.reference.acceleration,
    position: |c: &Cycle| c.sample.position,
    force_cell: |c: &Cycle| c.sample.force_cell,
    force: |c: &Cycle| c.terms.output,
    velocity: |c: &Cycle| c.sample.velocity,
    error: |c: &Cycle| c.terms.error,
    proportional: |c: &Cycle| c.terms.proportional,
    integral: |c: &Cycle| c.terms.integral,
    derivative: |c: &Cycle| c.terms.derivative,
    feedback: |c: &Cycle| c.terms.feedback,
    mass_feedforward: |c: &Cycle| c.terms.mass_feedforward,
    viscous_feedforward: |c: &Cycle| c.terms.viscous_feedforward,
}

fn run(mut stage: ClosedLoop, count: usize, caller: &Caller) -> Result<Columns, LabError> {
    let mut columns = Columns::with_capacity(count);
    for cycle in 0..count {
        if cycle.is_multiple_of(AT_ONCE) {
            caller.progress("simulating", cycle as f64 / count as f64);
        }
        columns.push(&stage.cycle()?);
    }
    Ok(columns)
}

/// Name, start and arrival (s), target (m), peak error (m) and settling times (s) of a move.
type MoveRow = (&'static str, f64, f64, f64, f64, (Option<f64>, Option<f64>, Option<f64>));

/// Columns by name, samples per second, and what became of each move.
#[pyfunction]
#[pyo3(signature = (model, motion, controller, noise, seed, duration, progress))]
#[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
pub(crate) fn simulate<'py>(
    py: Python<'py>,
    model: &Model,
    motion: &Motion,
    controller: Option<&Controller>,
    noise: bool,
    seed: u64,
    duration: Option<f64>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyDict>, f64, Vec<MoveRow>)> {
    let model = if noise { model.0.clone() } else { model.0.clone().without_noise() };
    let settings = match controller {
        Some(controller) => controller.0.clone(),
        None => ControllerSettings::of_model(
            &model,
            ControllerSettings::PAPER_BANDWIDTH,
            Rates::DEFAULT.control(),
        ),
    };
    let rates = Rates::of_control(settings.rate).or_raise()?;
    let count = samples(duration.unwrap_or_else(|| motion.seconds()), rates.control())?;
    let stage = closed_loop(&model, &Settings { seed, rates }, settings, motion.points.clone())
        .or_raise()?;
    let mut columns =
        wait_for(py, progress, move |caller| run(stage, count, caller))?.or_raise()?;
    let moves = motion
        .moves
        .iter()
        .filter_map(|the_move| {
            let errors = columns.error.iter().enumerate();
            let timed = errors.map(|(row, error)| (rates.time_of(row as u64), *error));
            let MoveResult { peak_error, settling } = settling(the_move, timed)?;
            let seconds = |time: i64| time as f64 * 1e-9;
            Some((
                the_move.kind.name(),
                seconds(the_move.start),
                seconds(the_move.arrival),
                the_move.target,
                peak_error,
                settling.into(),
            ))
        })
        .collect();
    let saturated = std::mem::take(&mut columns.saturated);
    let arrays = PyDict::new(py);
    for (name, column) in NAMES.iter().zip(columns.into_arrays()) {
        arrays.set_item(name, column.into_pyarray(py))?;
    }
    let saturated: Bound<'py, PyArray1<bool>> = saturated.into_pyarray(py);
    arrays.set_item("saturated", saturated)?;
    Ok((arrays, rates.control(), moves))
}

/// Samples over `duration` s, as the experiments of the laboratory count them.
fn samples(duration: f64, rate: f64) -> PyResult<usize> {
    let count = (duration * rate).ceil();
    // 16 columns of 8 bytes over so many rows are some tens of gigabytes.
    const MOST: f64 = 2e8;
    if (1.0..=MOST).contains(&count) {
        return Ok(count as usize);
    }
    Err(crate::error::raised::MotionError::new_err(format!(
        "{duration} s at {rate} Hz are {count} samples, must be 1 to {MOST:e}"
    )))
}
