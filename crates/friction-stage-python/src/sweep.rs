//! `sweep`: a stage over the values of its keys.

use std::sync::Arc;

use friction_stage_lab::{
    Axis, AxisValues, Cell, ColumnKind, GivenParameters, NumberedPlan as _, RowsError, SweepError,
    SweepMotion, SweepPlan, SweepSummary, SweepValue, given_by,
};
use friction_stage_report::sweep::sweep_text;
use numpy::IntoPyArray as _;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};

use crate::controller::Controller;
use crate::error::{raised, words};
use crate::model::Model;
use crate::motion::Motion;
use crate::waiting::wait_for;

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

/// All points of a sweep: columns in the order of the rows of the command line, the text of
/// summary.json, and what the command line prints.
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
    let plan = Arc::new(plan);
    let work = Arc::clone(&plan);
    let outcomes = wait_for(py, progress, move |caller| {
        let count = work.count();
        let mut outcomes = Vec::new();
        let mut next = 0;
        while next < count {
            caller.progress("points", next as f64 / count as f64);
            let chunk = next..(next + AT_ONCE).min(count);
            next = chunk.end;
            outcomes.extend(work.run(chunk));
        }
        outcomes
    })?;
    let summary =
        SweepSummary::of_outcomes(&plan, &outcomes).map_err(|error: RowsError| refused(&error))?;
    let text = sweep_text(&plan, &summary);
    let json = serde_json::to_string_pretty(&summary).map_err(|error| refused(&error))?;
    let rows: Vec<Vec<Cell>> =
        (0..).zip(&outcomes).map(|(point, outcome)| plan.row(point, outcome)).collect();
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
    Ok((columns, json, text))
}
