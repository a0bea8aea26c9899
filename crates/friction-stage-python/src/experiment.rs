//! `experiment`: the laboratory of the paper.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use friction_stage_lab::{
    Experiment, ExperimentPlan, Keep, LabError, LabRecording, Settings, Specimen,
};
use friction_stage_report::experiment::{ExperimentSummary, experiment_page};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::{OrRaise as _, raised, words};
use crate::model::Model;
use crate::recording::{columns, of_laboratory};
use crate::waiting::{Caller, wait_for};

/// The text of `summary.json`, what the command line prints, the page, the figures by name, and
/// the recordings that were asked for: name, columns, rate and model.
type Report<'py> =
    (String, String, String, Vec<(String, String)>, Vec<(String, Bound<'py, PyDict>, f64, Model)>);

#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
pub(crate) fn experiment<'py>(
    py: Python<'py>,
    name: &str,
    guides: Vec<String>,
    models: Vec<PyRef<'py, Model>>,
    seed: u64,
    rest: Option<f64>,
    amplitudes: Vec<f64>,
    recordings: bool,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Report<'py>> {
    let experiment = Experiment::from_name(&name.replace('_', "-")).ok_or_else(|| {
        let known: Vec<&str> = Experiment::ALL.iter().map(|experiment| experiment.name()).collect();
        raised::ExperimentError::new_err(format!(
            "no experiment `{name}`; there are {}",
            known.join(", ")
        ))
    })?;
    let named = guides.iter().map(|guide| Specimen::named(guide));
    let modelled = models.iter().map(|model| Ok(Specimen::of_model(&model.0)?));
    let specimens =
        named.chain(modelled).collect::<Result<Vec<Specimen>, LabError>>().or_raise()?;
    let mut plan = ExperimentPlan::new(experiment, specimens)
        .and_then(|plan| plan.with_amplitudes(&amplitudes))
        .or_raise()?;
    plan.settings = Settings { seed, ..Settings::default() };
    if let Some(rest) = rest {
        plan = plan.with_rest(rest).or_raise()?;
    }
    let (plan, found, kept) = wait_for(py, progress, move |caller| {
        let kept = Mutex::new(Vec::new());
        let found = measure(&plan, recordings.then_some(&kept), caller);
        (plan, found, kept.into_inner().unwrap_or_default())
    })?;
    let found = found.or_raise()?;
    let summary = ExperimentSummary::new(&plan, &found, false);
    let failed =
        |error: &(dyn std::error::Error + 'static)| raised::ExperimentError::new_err(words(error));
    let (page, figures) =
        experiment_page(&summary, &plan.specimens).map_err(|error| failed(&error))?;
    let json = serde_json::to_string_pretty(&summary).map_err(|error| failed(&error))?;
    let recordings = kept
        .into_iter()
        .map(|(name, recording): (String, LabRecording)| {
            let rate = recording.settings.rates.control();
            let model = Model(recording.model.clone());
            Ok((name, columns(py, of_laboratory(&recording))?, rate, model))
        })
        .collect::<PyResult<_>>()?;
    let figures = figures.into_iter().map(|figure| (figure.name.to_string(), figure.svg)).collect();
    Ok((json, summary.text(), page, figures, recordings))
}

fn measure(
    plan: &ExperimentPlan,
    kept: Option<&Mutex<Vec<(String, LabRecording)>>>,
    caller: &Caller,
) -> Result<friction_stage_lab::ExperimentFindings, LabError> {
    let (done, all) = (AtomicUsize::new(0), plan.ticks().max(1));
    let tick = || {
        let ticks = done.fetch_add(1, Ordering::Relaxed) + 1;
        caller.progress(plan.experiment.name(), ticks as f64 / all as f64);
    };
    let keep = |of: &Specimen, recordings: &[LabRecording]| {
        if let Some(mut kept) = kept.and_then(|kept| kept.lock().ok()) {
            kept.extend(recordings.iter().map(|recording| {
                (format!("{}_{}", of.file_name(), recording.name), recording.clone())
            }));
        }
        Ok(())
    };
    let keep: Option<&Keep<'_, LabError>> = if kept.is_some() { Some(&keep) } else { None };
    plan.run(keep, &tick)
}
