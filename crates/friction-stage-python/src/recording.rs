//! Recordings: bags and CSV files read onto one grid, and columns in memory.

use std::collections::HashMap;
use std::path::PathBuf;

use friction_stage_core::model::StageModel;
use friction_stage_data::quality::RecordingCheck;
use friction_stage_data::signals::{COLUMNS, Mapping, Recording, Trace, load};
use friction_stage_identify::RecordSource;
use friction_stage_lab::LabRecording;
use friction_stage_report::recording::recording_json;
use numpy::{IntoPyArray as _, PyReadonlyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::{OrRaise, raised};
use crate::from_json;
use crate::model::{Model, TextOrPath};
use crate::waiting::wait_for;

/// A file, or columns in memory with a name for messages.
#[derive(FromPyObject)]
pub(crate) enum Source<'py> {
    Columns(String, HashMap<String, PyReadonlyArray1<'py, f64>>),
    File(PathBuf),
}

impl Source<'_> {
    /// What identification reads.
    pub(crate) fn into_record_source(self) -> RecordSource {
        match self {
            Source::File(path) => RecordSource::File(path),
            Source::Columns(name, columns) => {
                RecordSource::Columns { name: name.into(), columns: trace(&columns) }
            }
        }
    }
}

/// The columns of a trace that are among these; the others are empty.
pub(crate) fn trace(columns: &HashMap<String, PyReadonlyArray1<'_, f64>>) -> Trace {
    let column =
        |name: &str| columns.get(name).map_or_else(Vec::new, |values| values.as_array().to_vec());
    let [
        time,
        reference_position,
        reference_velocity,
        reference_acceleration,
        position,
        cell,
        force,
    ] = COLUMNS.map(column);
    Trace {
        origin_ns: 0,
        time,
        reference_position,
        reference_velocity,
        reference_acceleration,
        position,
        force_cell: cell,
        force,
    }
}

/// A trace as columns by name, which own their numbers.
pub(crate) fn columns(py: Python<'_>, trace: Trace) -> PyResult<Bound<'_, PyDict>> {
    let Trace {
        origin_ns: _,
        time,
        reference_position,
        reference_velocity,
        reference_acceleration,
        position,
        force_cell,
        force,
    } = trace;
    let arrays = PyDict::new(py);
    for (name, values) in COLUMNS.into_iter().zip([
        time,
        reference_position,
        reference_velocity,
        reference_acceleration,
        position,
        force_cell,
        force,
    ]) {
        arrays.set_item(name, values.into_pyarray(py))?;
    }
    Ok(arrays)
}

/// The samples of a run of the laboratory.
pub(crate) fn of_laboratory(recording: &LabRecording) -> Trace {
    let mut trace = Trace::default();
    for row in &recording.rows {
        match &row.terms {
            Some(terms) => trace.push(&row.sample, terms),
            None => {
                let nothing =
                    friction_stage_core::control::Terms { output: row.force, ..Default::default() };
                trace.push(&row.sample, &nothing);
            }
        }
    }
    if recording.rows.first().is_some_and(|row| row.terms.is_none()) {
        for column in [
            &mut trace.reference_position,
            &mut trace.reference_velocity,
            &mut trace.reference_acceleration,
        ] {
            column.fill(f64::NAN);
        }
    }
    trace
}

/// A mapping in YAML or its file.
pub(crate) fn mapping(source: Option<TextOrPath>) -> PyResult<Option<Mapping>> {
    let read = |source: TextOrPath| match source.or_file() {
        TextOrPath::Text(text) => Mapping::from_yaml(&text, "the mapping"),
        TextOrPath::Path(path) => Mapping::load(&path),
    };
    source.map(read).transpose().or_raise()
}

/// Columns, samples per second, what the recording was like, and the time stamp of the first row.
#[pyfunction]
pub(crate) fn read_bag<'py>(
    py: Python<'py>,
    path: PathBuf,
    mapping: Option<TextOrPath>,
) -> PyResult<(Bound<'py, PyDict>, f64, Bound<'py, PyAny>, i64)> {
    let mapping = self::mapping(mapping)?;
    let Recording { trace, rate, valid, quality, .. } =
        wait_for(py, None, move |_| load(&path, mapping.as_ref()))?.or_raise()?;
    let text = serde_json::to_string(&quality)
        .map_err(|error| raised::RecordingError::new_err(error.to_string()))?;
    let origin_ns = trace.origin_ns;
    let arrays = columns(py, trace)?;
    arrays.set_item("valid", valid.into_pyarray(py))?;
    Ok((arrays, rate, from_json(py, &text)?, origin_ns))
}

/// Writes the columns of a trace as a CSV file that every command reads.
#[pyfunction]
pub(crate) fn write_csv(
    path: PathBuf,
    columns: HashMap<String, PyReadonlyArray1<'_, f64>>,
) -> PyResult<()> {
    let mut trace = trace(&columns);
    let rows = trace.len();
    for column in [
        &mut trace.reference_position,
        &mut trace.reference_velocity,
        &mut trace.reference_acceleration,
        &mut trace.position,
        &mut trace.force_cell,
        &mut trace.force,
    ] {
        column.resize(rows, f64::NAN);
    }
    trace.write_csv(path).or_raise()
}

/// What the command `check` prints as JSON.
#[pyfunction]
pub(crate) fn check<'py>(
    py: Python<'py>,
    path: PathBuf,
    mapping: Option<TextOrPath>,
    model: Option<&Model>,
) -> PyResult<Bound<'py, PyAny>> {
    let mapping = self::mapping(mapping)?;
    let model: Option<StageModel> = model.map(|model| model.0.clone());
    let report = wait_for(py, None, move |_| {
        let check = RecordingCheck::new(
            &path,
            mapping.as_ref(),
            friction_stage_data::signals::Window::examined(None, None),
            model,
            &mut |_| {},
        )?;
        Ok::<_, Box<dyn std::error::Error + Send + Sync>>(recording_json(&check)?.to_string())
    })?
    .map_err(|error| raised::RecordingError::new_err(crate::error::words(error.as_ref())))?;
    from_json(py, &report)
}
