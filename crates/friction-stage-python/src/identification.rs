//! `identify`: what recordings show that a model lacks.

use std::num::NonZeroUsize;
use std::path::Path;

use friction_stage_core::model::JointType;
use friction_stage_data::signals::Mapping;
use friction_stage_identify::{
    Identification, IdentifyError, Limits, NextExperimentError, RecordSource, Records,
    RecordsError, Tolerances, Watch,
};
use friction_stage_report::identification::{
    identification_figures, identification_page, identification_summary, identification_text,
    identified_model_file, usable_model_file,
};
use friction_stage_report::words::records_error;
use pyo3::prelude::*;

use crate::error::{Raise as _, raised, words};
use crate::model::{Model, TextOrPath};
use crate::motion::Motion;
use crate::recording::{self, Source};
use crate::waiting::{Caller, wait_for_on};

/// Name of the identified model among the files of a verdict.
const MODEL_FILE: &str = "identified.yaml";
/// Name of the model with laws that explain a part only.
const PARTIAL_MODEL_FILE: &str = "partial.yaml";

impl Watch for Caller {
    fn progress(&self, what: &str, share: f64) {
        Caller::progress(self, what, share);
    }

    fn stopped(&self) -> bool {
        self.has_enough()
    }
}

enum Refused {
    Records(RecordsError, JointType),
    Identify(IdentifyError),
    Limits(NextExperimentError),
}

impl Refused {
    fn raise(self) -> PyErr {
        match self {
            Refused::Records(RecordsError::Signals(error), _) => error.raise(),
            // The words for findings, and the cause that follows them.
            Refused::Records(error @ RecordsError::Unusable { .. }, joint) => {
                raised::IdentificationError::new_err(records_error(&error, joint))
            }
            Refused::Records(error, _) => raised::IdentificationError::new_err(words(&error)),
            Refused::Identify(error) => raised::IdentificationError::new_err(words(&error)),
            Refused::Limits(error) => {
                raised::IdentificationError::new_err(format!("next experiment: {error}"))
            }
        }
    }
}

/// What the next experiment may do; what is left out follows from data and model.
type GivenLimits = (Option<(f64, f64)>, Option<f64>, Option<f64>, Option<f64>);

struct Question {
    model: Model,
    train: Vec<RecordSource>,
    holdout: Vec<RecordSource>,
    mapping: Option<Mapping>,
    tolerances: Tolerances,
    limits: Option<GivenLimits>,
}

impl Question {
    fn answer(self, caller: &Caller) -> Result<(Identification, Records), Refused> {
        let declared = &self.model.0;
        let records = Records::read(
            &self.train,
            &self.holdout,
            self.mapping.as_ref(),
            friction_stage_data::signals::Window::default(),
            declared,
            self.tolerances,
        )
        .map_err(|error| Refused::Records(error, declared.joint))?;
        let limits = self
            .limits
            .map(|(stroke, speed, force, duration)| {
                Limits::given(stroke, speed, force, duration, declared, &records.train)
            })
            .transpose()
            .map_err(Refused::Limits)?;
        let mut found = Identification::new(declared, self.tolerances, &records, caller)
            .map_err(Refused::Identify)?;
        if let Some(limits) = limits {
            caller.progress("next experiment", 1.0);
            found.plan_next(&records, limits);
        }
        Ok((found, records))
    }
}

/// An identification with its records: what its report is made of.
#[pyclass(frozen, module = "friction_stage._native")]
pub(crate) struct Identified {
    found: Identification,
    records: Records,
    name: String,
}

impl Identified {
    fn failed(error: &(dyn std::error::Error + 'static)) -> PyErr {
        raised::FrictionStageError::new_err(words(error))
    }
}

#[pymethods]
impl Identified {
    /// The text of `summary.json`.
    fn summary_json(&self) -> PyResult<String> {
        let summary = identification_summary(&self.found, &self.records, MODEL_FILE);
        let text = serde_json::to_string_pretty(&summary).map_err(|e| Identified::failed(&e))?;
        Ok(text + "\n")
    }

    /// The text of `identified.yaml`.
    fn model_file(&self) -> PyResult<String> {
        let summary = identification_summary(&self.found, &self.records, MODEL_FILE);
        let model = &self.found.model;
        let text = match &self.found.partial {
            Some(_) => usable_model_file(model, &summary, PARTIAL_MODEL_FILE),
            None => identified_model_file(model, &summary),
        };
        text.map_err(|e| Identified::failed(&e))
    }

    /// The text of `partial.yaml`; none where there is no such file.
    fn partial_model_file(&self) -> PyResult<Option<String>> {
        let summary = identification_summary(&self.found, &self.records, MODEL_FILE);
        let text = |partial| identified_model_file(partial, &summary);
        let text = self.found.partial.as_ref().map(text).transpose();
        text.map_err(|e| Identified::failed(&e))
    }

    #[getter]
    fn model(&self) -> Model {
        Model(self.found.model.clone())
    }

    #[getter]
    fn partial_model(&self) -> Option<Model> {
        self.found.partial.clone().map(Model)
    }

    /// What the command line prints.
    fn text(&self, page: &str) -> String {
        let summary = identification_summary(&self.found, &self.records, MODEL_FILE);
        identification_text(&summary, Path::new(page))
    }

    /// The page, and the figures by name.
    fn report(&self) -> PyResult<(String, Vec<(String, String)>)> {
        let summary = identification_summary(&self.found, &self.records, MODEL_FILE);
        let figures = identification_figures(&self.found, &self.records)
            .map_err(|e| Identified::failed(&e))?;
        let page = identification_page(&self.name, &self.found, &self.records, &summary, &figures)
            .map_err(|e| Identified::failed(&e))?;
        Ok((page, figures.into_iter().map(|figure| (figure.name, figure.svg)).collect()))
    }

    #[getter]
    fn next_motion(&self) -> PyResult<Option<Motion>> {
        let plan = self.found.next.as_ref();
        plan.map(|plan| Motion::checked(plan.points.clone(), Vec::new())).transpose()
    }
}

#[pyfunction]
#[expect(clippy::too_many_arguments, reason = "they are keywords in Python")]
pub(crate) fn identify(
    py: Python<'_>,
    model: &Model,
    train: Vec<Source<'_>>,
    holdout: Vec<Source<'_>>,
    mapping: Option<TextOrPath>,
    mass_tolerance: Option<f64>,
    guide_tolerance: Option<f64>,
    presliding_tolerance: Option<f64>,
    limits: Option<GivenLimits>,
    threads: Option<NonZeroUsize>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<Identified> {
    let usual = Tolerances::default();
    let guides = guide_tolerance.unwrap_or(usual.guides);
    let question = Question {
        model: model.clone(),
        train: train.into_iter().map(Source::into_record_source).collect(),
        holdout: holdout.into_iter().map(Source::into_record_source).collect(),
        mapping: recording::mapping(mapping)?,
        tolerances: Tolerances {
            mass: mass_tolerance.unwrap_or(usual.mass),
            guides,
            presliding: presliding_tolerance.unwrap_or(guides),
        },
        limits,
    };
    let name = model.0.name.clone();
    let (found, records) =
        wait_for_on(py, threads, progress, move |caller| question.answer(caller))?
            .map_err(Refused::raise)?;
    Ok(Identified { found, records, name })
}
