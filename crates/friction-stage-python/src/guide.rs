//! `fit_guide`: a guide from recordings of the measuring rig.

use friction_stage_core::model::JointType;
use friction_stage_data::signals::{SignalError, Trace};
use friction_stage_identify::RecordSource;
use friction_stage_lab::{
    Fitted, GuideConstruction, GuideFit, GuideFitError, RigRecord, fit_guide,
};
use friction_stage_report::words::all_words;
use pyo3::prelude::*;

use crate::error::{OrRaise as _, Raise as _, raised, words};
use crate::recording::Source;
use crate::waiting::wait_for;

/// A guide as recordings show it.
#[pyclass(frozen, module = "friction_stage._native")]
pub(crate) struct FittedGuide {
    fit: GuideFit,
    recordings: String,
}

/// Name, value, unit and interval of a parameter.
type ParameterRow = (&'static str, f64, &'static str, [f64; 2]);

#[pymethods]
impl FittedGuide {
    fn parameters(&self) -> Vec<ParameterRow> {
        let row = |(name, Fitted { value, ci95 })| (name, value, GuideFit::unit(name), ci95);
        self.fit.parameters().into_iter().map(row).collect()
    }

    #[getter]
    fn warnings(&self) -> Vec<String> {
        all_words(&self.fit.findings, JointType::Prismatic)
    }

    #[getter]
    fn force_rms(&self) -> f64 {
        self.fit.force_rms
    }

    #[getter]
    fn noise_rms(&self) -> f64 {
        self.fit.noise_rms
    }

    /// A catalogue of this guide alone.
    fn catalogue_yaml(
        &self,
        name: &str,
        description: Option<String>,
        seals: bool,
        cage: bool,
        lubricant: Option<String>,
    ) -> PyResult<String> {
        let unknown = GuideConstruction::default();
        let construction = GuideConstruction {
            description: description.unwrap_or(unknown.description),
            seals,
            cage,
            lubricant: lubricant.unwrap_or(unknown.lubricant),
        };
        self.fit.catalogue(name, &construction, &self.recordings).or_raise()?.to_yaml().or_raise()
    }
}

enum Refused {
    Signals(SignalError),
    NoMass(String),
    Mass(f64),
    Fit(String, GuideFitError),
}

impl Refused {
    fn raise(self) -> PyErr {
        match self {
            Refused::Signals(error) => error.raise(),
            Refused::NoMass(path) => raised::FitError::new_err(format!(
                "{path} does not say what mass moves behind the force cell: give it by mass"
            )),
            Refused::Mass(mass) => raised::FitError::new_err(format!(
                "mass is {mass} kg, must be finite and greater than 0"
            )),
            Refused::Fit(what, error) => {
                raised::FitError::new_err(format!("{what}: {}", words(&error)))
            }
        }
    }
}

/// What the rig recorded, and the mass of the carriage where the recording says it.
fn read(source: RecordSource) -> Result<(RigRecord, Option<f64>), Refused> {
    let (trace, mass) = match source {
        RecordSource::File(path) => {
            let (trace, model) = Trace::with_force_cell(path).map_err(Refused::Signals)?;
            (trace, model.map(|model| model.mass))
        }
        RecordSource::Columns { columns, .. } => (columns, None),
    };
    let Trace { time, position, force_cell: force, .. } = trace;
    Ok((RigRecord { time, position, force }, mass))
}

#[pyfunction]
#[pyo3(name = "fit_guide")]
pub(crate) fn fit(
    py: Python<'_>,
    stribeck: Source<'_>,
    dahl: Source<'_>,
    mass: Option<f64>,
) -> PyResult<FittedGuide> {
    let (stribeck, dahl) = (stribeck.into_record_source(), dahl.into_record_source());
    let name = |source: &RecordSource| source.path().display().to_string();
    let (runs, loops) = (name(&stribeck), name(&dahl));
    let (first, second) = (runs.clone(), loops.clone());
    let fit = wait_for(py, None, move |_| {
        let (stribeck, said) = read(stribeck)?;
        let (dahl, _) = read(dahl)?;
        let mass = mass.or(said).ok_or_else(|| Refused::NoMass(first.clone()))?;
        if !(mass.is_finite() && mass > 0.0) {
            return Err(Refused::Mass(mass));
        }
        fit_guide(&stribeck, &dahl, mass)
            .map_err(|error| Refused::Fit(format!("no guide from {first} and {second}"), error))
    })?
    .map_err(Refused::raise)?;
    let recordings = format!("{} runs of {runs}, {} rows of {loops}", fit.windows, fit.rows);
    Ok(FittedGuide { fit, recordings })
}
