//! `simulate`: stage and controller in one process, as the two nodes are in lockstep.

use friction_stage_core::control::ControllerSettings;
use friction_stage_core::plant::Rates;
use friction_stage_core::{ClosedLoop, Cycle};
use friction_stage_lab::{LabError, MoveResult, Settings, closed_loop, settling};
use numpy::{IntoPyArray as _, PyArray1, PyArray2, PyArrayMethods as _};
use pyo3::prelude::*;

use crate::controller::Controller;
use crate::error::OrRaise;
use crate::model::Model;
use crate::motion::Motion;
use crate::waiting::{Caller, wait_for};

/// Cycles between two looks whether to stop: less than a millisecond, and few enough for the cache.
const AT_ONCE: usize = 256;

macro_rules! columns {
    ($($name:ident: $value:expr),* $(,)?) => {
        /// Names of the columns of numbers.
        const NAMES: &[&str] = &[$(stringify!($name)),*];

        impl Columns {
            /// Adds the next rows.
            fn extend(&mut self, cycles: &[Cycle]) {
                let mut columns = self.values.chunks_exact_mut(self.rows);
                $(self::fill(columns.next(), self.done, cycles, $value);)*
                self.saturated.extend(cycles.iter().map(|cycle| cycle.terms.saturated));
                self.done += cycles.len();
            }
        }
    };
}

/// A run as columns, one after the other, and whether the motor was at its limit.
///
/// The numbers are one piece of memory, so that the next run gets it again from the allocator; many
/// pieces would go back to the system, and each page of them cost a fault.
struct Columns {
    values: Vec<f64>,
    saturated: Vec<bool>,
    rows: usize,
    done: usize,
}

impl Columns {
    fn new(rows: usize) -> Columns {
        let values = vec![0.0; NAMES.len() * rows];
        Columns { values, saturated: Vec::with_capacity(rows), rows, done: 0 }
    }

    fn column(&self, name: &str) -> Option<&[f64]> {
        let index = NAMES.iter().position(|known| *known == name)?;
        self.values.chunks_exact(self.rows).nth(index)
    }
}

fn fill(column: Option<&mut [f64]>, from: usize, cycles: &[Cycle], value: impl Fn(&Cycle) -> f64) {
    let places = column.and_then(|column| column.get_mut(from..)).unwrap_or_default();
    places.iter_mut().zip(cycles).for_each(|(place, cycle)| *place = value(cycle));
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

fn run(mut stage: ClosedLoop, mut columns: Columns, caller: &Caller) -> Result<Columns, LabError> {
    let mut cycles = Vec::with_capacity(AT_ONCE);
    while columns.done < columns.rows {
        caller.progress("simulating", columns.done as f64 / columns.rows as f64);
        cycles.clear();
        for _ in columns.done..columns.rows.min(columns.done + AT_ONCE) {
            cycles.push(stage.cycle()?);
        }
        columns.extend(&cycles);
    }
    Ok(columns)
}

/// Name, start and arrival (s), target (m), peak error (m) and settling times (s) of a move.
type MoveRow = (&'static str, f64, f64, f64, f64, (Option<f64>, Option<f64>, Option<f64>));

/// Names and values of the columns, whether the motor was at its limit, samples per second, and
/// what became of each move.
type Run<'py> = (
    &'static [&'static str],
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<bool>>,
    f64,
    Vec<MoveRow>,
);

/// A stage under its controller.
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
) -> PyResult<Run<'py>> {
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
    let columns = Columns::new(count);
    let columns = wait_for(py, progress, move |caller| run(stage, columns, caller))?.or_raise()?;
    let error = columns.column("error").unwrap_or_default();
    let moves = motion
        .moves
        .iter()
        .filter_map(|the_move| {
            // From its first sample to its last, one more at either end.
            let row = |time: i64| (time as f64 * 1e-9 * rates.control()) as usize;
            let rows = row(the_move.start).saturating_sub(1)
                ..count.min(row(the_move.end).saturating_add(2));
            let errors = rows.clone().zip(error.get(rows)?);
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
    let Columns { values, saturated, .. } = columns;
    let values = values.into_pyarray(py).reshape([NAMES.len(), count])?;
    Ok((NAMES, values, saturated.into_pyarray(py), rates.control(), moves))
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
