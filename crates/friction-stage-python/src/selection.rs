//! `select`: which guide for an application; its variants in chunks.

use std::num::NonZeroUsize;
use std::sync::Arc;

use friction_stage_core::model::{Catalogue, ModelError};
use friction_stage_lab::{
    Application, SelectionError, SelectionPlan, Tally, VariantExperiment, VariantResult,
    variant_seed,
};
use friction_stage_report::selection::{SelectionSummary, selection_text};
use numpy::{IntoPyArray as _, PyReadonlyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::{OrRaise as _, raised, words};
use crate::model::TextOrPath;
use crate::waiting::wait_for_on;

/// Variants between two looks whether to stop: some tens of milliseconds of work.
const AT_ONCE: u64 = 128;

/// A selection that is to be computed: an application over the guides of catalogues.
#[pyclass(frozen, module = "friction_stage._native")]
pub(crate) struct Plan {
    plan: Arc<SelectionPlan>,
    experiment: Arc<VariantExperiment>,
}

fn refused(error: &(dyn std::error::Error + 'static)) -> PyErr {
    raised::SelectionError::new_err(words(error))
}

/// The built-in guides and those of the catalogues, or those of them that are named.
fn database(sources: Vec<TextOrPath>, guides: &[String]) -> Result<Catalogue, ModelError> {
    let mut all = Catalogue::builtin();
    for source in sources {
        match source.or_file() {
            TextOrPath::Text(text) => {
                let origin = "the catalogue";
                all.add(Catalogue::from_yaml(&text, origin)?, origin)?;
            }
            TextOrPath::Path(path) => {
                all.add(Catalogue::load(&path)?, &path.display().to_string())?;
            }
        }
    }
    if guides.is_empty() { Ok(all) } else { all.only(guides) }
}

#[pymethods]
impl Plan {
    #[new]
    fn new(
        application: TextOrPath,
        catalogues: Vec<TextOrPath>,
        guides: Vec<String>,
        seed: u64,
        variants: u64,
    ) -> PyResult<Plan> {
        let application = match application.or_file() {
            TextOrPath::Text(text) => Application::from_yaml(&text, "the application"),
            TextOrPath::Path(path) => {
                let origin = path.display().to_string();
                let text = friction_stage_core::text_file::read(&path).map_err(|error| {
                    raised::SelectionError::new_err(format!("cannot read {origin}: {error}"))
                })?;
                Application::from_yaml(&text, &origin)
            }
        };
        let application = application.map_err(|error| refused(&error))?;
        let database = database(catalogues, &guides).or_raise()?;
        let experiment = VariantExperiment::new(&application).map_err(|error| refused(&error))?;
        let plan = SelectionPlan::new(application, &database, seed, variants)
            .map_err(|error| refused(&error))?;
        Ok(Plan { plan: Arc::new(plan), experiment: Arc::new(experiment) })
    }

    #[getter]
    fn variants(&self) -> u64 {
        self.plan.variants
    }

    #[getter]
    fn guides(&self) -> Vec<String> {
        self.plan.candidates.iter().map(|candidate| candidate.name.clone()).collect()
    }

    /// The variants from `start` to `stop` as columns, in their order.
    fn run<'py>(
        &self,
        py: Python<'py>,
        start: u64,
        stop: u64,
        threads: Option<NonZeroUsize>,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        if !(start <= stop && stop <= self.plan.variants) {
            return Err(raised::SelectionError::new_err(format!(
                "variants {start} to {stop} are not among the {} of the plan",
                self.plan.variants
            )));
        }
        let (plan, experiment) = (Arc::clone(&self.plan), Arc::clone(&self.experiment));
        let results = wait_for_on(py, threads, progress, move |caller| {
            let mut results = Vec::with_capacity((stop - start) as usize);
            let mut next = start;
            while next < stop {
                let share = (next - start) as f64 / (stop - start) as f64;
                caller.progress("variants", share);
                let chunk = next..(next + AT_ONCE).min(stop);
                next = chunk.end;
                results.extend(plan.run(&experiment, chunk)?);
            }
            Ok::<_, SelectionError>(results)
        })?
        .map_err(|error| refused(&error))?;
        let jobs = || (start..stop).map(|job| self.plan.job(job));
        let columns = PyDict::new(py);
        let guides: Vec<i64> = jobs().map(|(guide, _)| guide as i64).collect();
        columns.set_item("guide", guides.into_pyarray(py))?;
        let numbers: Vec<u64> = jobs().map(|(_, variant)| variant).collect();
        columns.set_item("variant", numbers.into_pyarray(py))?;
        let seeds: Vec<u64> = jobs()
            .map(|(guide, variant)| {
                variant_seed(self.plan.seed, &self.plan.candidates[guide].name, variant)
            })
            .collect();
        columns.set_item("seed", seeds.into_pyarray(py))?;
        let column =
            |of: fn(&VariantResult) -> f64| -> Vec<f64> { results.iter().map(of).collect() };
        columns.set_item("peak_error_m", column(|r| r.peak_error).into_pyarray(py))?;
        let settling = column(|r| r.settling_time.unwrap_or(f64::NAN));
        columns.set_item("settling_time_s", settling.into_pyarray(py))?;
        let saturated: Vec<bool> = results.iter().map(|result| result.saturated).collect();
        columns.set_item("saturated", saturated.into_pyarray(py))?;
        for (name, values) in [
            ("stiffness", column(|r| r.guide.stiffness)),
            ("bristle_damping", column(|r| r.guide.bristle_damping)),
            ("viscous_friction", column(|r| r.guide.viscous_friction)),
            ("coulomb_force", column(|r| r.guide.coulomb_force)),
            ("static_force", column(|r| r.guide.static_force)),
            ("stribeck_velocity", column(|r| r.guide.stribeck_velocity)),
        ] {
            columns.set_item(name, values.into_pyarray(py))?;
        }
        Ok(columns)
    }

    /// A ranking of no variant yet.
    fn ranking(&self) -> Ranking {
        let tallies = vec![Tally::default(); self.plan.candidates.len()];
        Ranking { plan: Arc::clone(&self.plan), tallies }
    }
}

/// What variants of a plan reached, counted: its size does not grow with their number.
#[pyclass(module = "friction_stage._native")]
pub(crate) struct Ranking {
    plan: Arc<SelectionPlan>,
    tallies: Vec<Tally>,
}

#[pymethods]
impl Ranking {
    /// Counts the variants from `start` on; a settling time that is NaN is none.
    fn add(
        &mut self,
        start: u64,
        peak_error: PyReadonlyArray1<'_, f64>,
        settling_time: PyReadonlyArray1<'_, f64>,
        saturated: PyReadonlyArray1<'_, bool>,
    ) -> PyResult<()> {
        let (peaks, times) = (peak_error.as_array(), settling_time.as_array());
        let saturated = saturated.as_array();
        let lengths = [peaks.len(), times.len(), saturated.len()];
        if lengths.iter().any(|length| *length != lengths[0]) {
            return Err(raised::SelectionError::new_err(format!(
                "{lengths:?} values of peak error, settling time and saturation, must be as many \
                 of each"
            )));
        }
        if start.checked_add(lengths[0] as u64).is_none_or(|stop| stop > self.plan.variants) {
            return Err(raised::SelectionError::new_err(format!(
                "{} variants from {start} on are not among the {} of the plan",
                lengths[0], self.plan.variants
            )));
        }
        for (job, ((peak, time), saturated)) in
            (start..).zip(peaks.iter().zip(times).zip(saturated))
        {
            let (index, variant) = self.plan.job(job);
            let result = VariantResult {
                variant,
                peak_error: *peak,
                settling_time: Some(*time).filter(|time| !time.is_nan()),
                saturated: *saturated,
                guide: self.plan.candidates[index].guide.clone(),
            };
            self.tallies[index].add(&result, &self.plan.application);
        }
        Ok(())
    }

    /// The text of `summary.json` and what the command line prints, of what was counted.
    fn conclude(&self) -> PyResult<(String, String)> {
        let selection = self.plan.rank(&self.tallies);
        let summary = serde_json::to_string_pretty(&SelectionSummary::new(&selection))
            .map_err(|error| refused(&error))?;
        Ok((summary, selection_text(&self.plan, &selection)))
    }
}
