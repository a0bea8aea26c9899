//! `sweep`: a stage over the values of its keys.

use std::num::NonZeroUsize;
use std::ops::Range;
use std::sync::Arc;

use friction_stage_lab::{
    Axis, AxisValues, Cell, Column, ColumnKind, GivenParameters, NumberedPlan as _, RowsError,
    SweepError, SweepMotion, SweepOutcome, SweepPlan, SweepSummary, SweepValue, given_by,
};
use friction_stage_report::figure::FigureError;
use friction_stage_report::sweep::{sweep_figure, sweep_text};
use numpy::{IntoPyArray as _, PyReadonlyArray1};
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::controller::Controller;
use crate::error::{raised, words};
use crate::model::Model;
use crate::motion::Motion;
use crate::waiting::wait_for_on;

/// Points between two looks whether to stop.
const AT_ONCE: u64 = 16;

/// A value of a list.
#[derive(FromPyObject)]
pub(crate) enum GivenValue {
    Flag(bool),
    Number(f64),
    Text(String),
}

/// The values of a key: as on the command line, or one by one.
#[derive(FromPyObject)]
pub(crate) enum GivenValues {
    Text(String),
    List(Vec<GivenValue>),
}

/// A motion: by name, or of one's own.
#[derive(FromPyObject)]
pub(crate) enum GivenMotion<'py> {
    Name(String),
    Own(Bound<'py, Motion>),
}

fn refused(error: &(dyn std::error::Error + 'static)) -> PyErr {
    raised::SweepError::new_err(words(error))
}

fn axis_of(key: String, values: GivenValues) -> Result<Axis, SweepError> {
    match values {
        GivenValues::Text(text) => format!("{key}={text}").parse(),
        GivenValues::List(values) => {
            let values = values.into_iter().map(|value| match value {
                GivenValue::Flag(flag) => SweepValue::Flag(flag),
                GivenValue::Number(number) => SweepValue::Number(number),
                GivenValue::Text(text) => SweepValue::Text(text),
            });
            let axis = Axis { key, values: AxisValues::List(values.collect()) };
            axis.check()?;
            Ok(axis)
        }
    }
}

/// What is computed, from what a caller gave.
fn planned(
    model: &Model,
    axes: Vec<(String, GivenValues)>,
    motion: GivenMotion<'_>,
    controller: Option<&Controller>,
    samples: Option<u64>,
    seed: u64,
) -> PyResult<Arc<SweepPlan>> {
    let axes = axes
        .into_iter()
        .map(|(key, values)| axis_of(key, values))
        .collect::<Result<Vec<_>, _>>()
        .map_err(|error| refused(&error))?;
    let motion = match motion {
        GivenMotion::Own(motion) => {
            SweepMotion::of_points(&motion.get().points, &motion.get().moves)
        }
        GivenMotion::Name(name) => SweepMotion::named(&name).ok_or_else(|| {
            let known = SweepMotion::NAMES.join(", ");
            raised::SweepError::new_err(format!("motion is `{name}`, must be {known} or a Motion"))
        })?,
    };
    let given = controller.map_or_else(GivenParameters::new, |own| given_by(&own.0));
    let plan = SweepPlan::new(model.0.clone(), given, motion, axes, samples, seed)
        .map_err(|error| refused(&error))?;
    Ok(Arc::new(plan))
}

/// Points of a plan, on so many threads.
fn computed(
    py: Python<'_>,
    plan: &Arc<SweepPlan>,
    points: Range<u64>,
    threads: Option<NonZeroUsize>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<Vec<SweepOutcome>> {
    let work = Arc::clone(plan);
    wait_for_on(py, threads, progress, move |caller| {
        let mut outcomes = Vec::new();
        let mut next = points.start;
        while next < points.end {
            let share = (next - points.start) as f64 / (points.end - points.start) as f64;
            caller.progress("points", share);
            let chunk = next..(next + AT_ONCE).min(points.end);
            next = chunk.end;
            outcomes.extend(work.run(chunk));
        }
        outcomes
    })
}

/// Outcomes as columns in the order of the rows of the command line.
fn columns<'py>(
    py: Python<'py>,
    plan: &SweepPlan,
    first: u64,
    outcomes: &[SweepOutcome],
) -> PyResult<Bound<'py, PyDict>> {
    let rows: Vec<Vec<Cell>> =
        (first..).zip(outcomes).map(|(point, outcome)| plan.row(point, outcome)).collect();
    let columns = PyDict::new(py);
    for (index, column) in plan.columns().iter().enumerate() {
        let cells = || rows.iter().map(|row| &row[index]);
        let name = &column.name;
        match column.kind {
            ColumnKind::Text => {
                columns.set_item(name, PyList::new(py, cells().map(Cell::text))?)?;
            }
            ColumnKind::Count => {
                let counts: Vec<u64> = cells().map(Cell::count).collect();
                columns.set_item(name, counts.into_pyarray(py))?;
            }
            ColumnKind::Number | ColumnKind::Optional => {
                let numbers: Vec<f64> =
                    cells().map(|cell| cell.number().unwrap_or(f64::NAN)).collect();
                columns.set_item(name, numbers.into_pyarray(py))?;
            }
            ColumnKind::Flag => {
                let flags: Vec<bool> = cells().map(Cell::flag).collect();
                columns.set_item(name, flags.into_pyarray(py))?;
            }
        }
    }
    Ok(columns)
}

/// The text of summary.json, and what the command line prints.
fn summed_up(
    plan: &SweepPlan,
    outcomes: impl Iterator<Item = (u64, SweepOutcome)>,
) -> PyResult<(String, String)> {
    let summary =
        SweepSummary::of_outcomes(plan, outcomes).map_err(|error: RowsError| refused(&error))?;
    let json = serde_json::to_string_pretty(&summary).map_err(|error| refused(&error))?;
    Ok((json, sweep_text(plan, &summary)))
}

/// All points of a sweep: their columns, the text of summary.json, and what the command line
/// prints.
#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
pub(crate) fn sweep<'py>(
    py: Python<'py>,
    model: &Model,
    axes: Vec<(String, GivenValues)>,
    motion: GivenMotion<'py>,
    controller: Option<&Controller>,
    samples: Option<u64>,
    seed: u64,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyDict>, String, String)> {
    let plan = planned(model, axes, motion, controller, samples, seed)?;
    let outcomes = computed(py, &plan, 0..plan.count(), None, progress)?;
    let (json, text) = summed_up(&plan, (0..).zip(outcomes.iter().cloned()))?;
    Ok((columns(py, &plan, 0, &outcomes)?, json, text))
}

/// A sweep that is to be computed in chunks.
#[pyclass(name = "SweepPlan", frozen, module = "friction_stage._native")]
pub(crate) struct PlannedSweep(Arc<SweepPlan>);

#[pymethods]
impl PlannedSweep {
    #[new]
    fn new(
        model: &Model,
        axes: Vec<(String, GivenValues)>,
        motion: GivenMotion<'_>,
        controller: Option<&Controller>,
        samples: Option<u64>,
        seed: u64,
    ) -> PyResult<PlannedSweep> {
        planned(model, axes, motion, controller, samples, seed).map(PlannedSweep)
    }

    /// The plan as text, which holds all that a worker needs.
    fn to_json(&self) -> PyResult<String> {
        serde_json::to_string(&*self.0).map_err(|error| refused(&error))
    }

    /// The plan that a text holds.
    #[staticmethod]
    fn from_json(text: &str) -> PyResult<PlannedSweep> {
        let plan: SweepPlan = serde_json::from_str(text).map_err(|error| refused(&error))?;
        match plan.obstacle() {
            Some(obstacle) => {
                Err(raised::SweepError::new_err(format!("this plan of a sweep {obstacle}")))
            }
            None => Ok(PlannedSweep(Arc::new(plan))),
        }
    }

    #[getter]
    fn points(&self) -> u64 {
        self.0.count()
    }

    /// The points from `start` to `stop` as columns, in their order.
    fn run<'py>(
        &self,
        py: Python<'py>,
        start: u64,
        stop: u64,
        threads: Option<NonZeroUsize>,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        if !(start <= stop && stop <= self.0.count()) {
            return Err(raised::SweepError::new_err(format!(
                "points {start} to {stop} are not among the {} of the plan",
                self.0.count()
            )));
        }
        let outcomes = computed(py, &self.0, start..stop, threads, progress)?;
        columns(py, &self.0, start, &outcomes)
    }
}

/// A column as it is given back, by its kind.
enum GivenColumn<'py> {
    Texts(Vec<String>),
    Counts(PyReadonlyArray1<'py, u64>),
    Numbers(PyReadonlyArray1<'py, f64>),
    Flags(PyReadonlyArray1<'py, bool>),
}

/// What a sweep says, from its columns chunk by chunk.
#[pyclass(module = "friction_stage._native")]
pub(crate) struct SweepTally {
    plan: Arc<SweepPlan>,
    outcomes: Vec<(u64, SweepOutcome)>,
}

#[pymethods]
impl SweepTally {
    #[new]
    fn new(plan: &PlannedSweep) -> SweepTally {
        SweepTally { plan: Arc::clone(&plan.0), outcomes: Vec::new() }
    }

    /// Adds the points from `start` on, with the columns of `SweepPlan.run`.
    fn add(&mut self, start: u64, columns: &Bound<'_, PyDict>) -> PyResult<()> {
        let kinds = self.plan.columns();
        let mut given = Vec::with_capacity(kinds.len());
        for column in &kinds {
            let name = &column.name;
            let values = columns.get_item(name)?.ok_or_else(|| {
                raised::SweepError::new_err(format!("the column `{name}` is missing"))
            })?;
            given.push(match column.kind {
                ColumnKind::Text => GivenColumn::Texts(values.extract()?),
                ColumnKind::Count => GivenColumn::Counts(values.extract()?),
                ColumnKind::Number | ColumnKind::Optional => {
                    GivenColumn::Numbers(values.extract()?)
                }
                ColumnKind::Flag => GivenColumn::Flags(values.extract()?),
            });
        }
        let lengths: Vec<usize> = given
            .iter()
            .map(|column| match column {
                GivenColumn::Texts(texts) => texts.len(),
                GivenColumn::Counts(counts) => counts.as_array().len(),
                GivenColumn::Numbers(numbers) => numbers.as_array().len(),
                GivenColumn::Flags(flags) => flags.as_array().len(),
            })
            .collect();
        let rows = lengths.first().copied().unwrap_or(0);
        if lengths.iter().any(|length| *length != rows) {
            return Err(raised::SweepError::new_err("the columns have different lengths"));
        }
        for row in 0..rows {
            let cell = |(column, given): (&Column, &GivenColumn<'_>)| match given {
                GivenColumn::Texts(texts) => Cell::Text(texts[row].clone()),
                GivenColumn::Counts(counts) => Cell::Count(counts.as_array()[row]),
                GivenColumn::Flags(flags) => Cell::Flag(flags.as_array()[row]),
                GivenColumn::Numbers(numbers) => {
                    let number = numbers.as_array()[row];
                    match column.kind {
                        ColumnKind::Optional => {
                            Cell::Optional(Some(number).filter(|x| !x.is_nan()))
                        }
                        _ => Cell::Number(number),
                    }
                }
            };
            let cells: Vec<Cell> = kinds.iter().zip(&given).map(cell).collect();
            let point = start + row as u64;
            let outcome = self.plan.outcome(point, &cells).map_err(|other| {
                raised::SweepError::new_err(format!(
                    "the row of {} is that of {}",
                    other.planned, other.found
                ))
            })?;
            self.outcomes.push((point, outcome));
        }
        Ok(())
    }

    /// The text of summary.json, what the command line prints, and its figure, of the points that
    /// were added.
    fn conclude(&mut self) -> PyResult<(String, String, String)> {
        self.outcomes.sort_by_key(|(point, _)| *point);
        let (json, text) = summed_up(&self.plan, self.outcomes.iter().cloned())?;
        let figure = sweep_figure(&self.plan, |each| {
            self.outcomes.iter().for_each(|(point, outcome)| {
                each(*point, outcome.as_ref().ok().copied());
            });
            Ok::<(), FigureError>(())
        })
        .map_err(|error| refused(&error))?;
        Ok((json, text, figure))
    }
}
