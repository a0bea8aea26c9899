//! `Model`: what a stage is.

use std::path::PathBuf;

use friction_stage_core::model::{Catalogue, StageModel};
use friction_stage_core::plant::effects::Effects;
use friction_stage_core::plant::load_model;
use pyo3::prelude::*;

use crate::error::{OrRaise, Raise};
use crate::from_json;

/// A stage: mass, guides, effects, motor, force cell, encoder.
#[pyclass(frozen, eq, module = "friction_stage")]
#[derive(Clone, PartialEq)]
pub(crate) struct Model(pub StageModel);

/// The text of a file, or the file.
#[derive(FromPyObject)]
pub(crate) enum TextOrPath {
    Text(String),
    Path(PathBuf),
}

impl TextOrPath {
    /// A string is text where it holds a mapping or nothing, else the path of a file.
    pub(crate) fn or_file(self) -> TextOrPath {
        match self {
            TextOrPath::Text(text)
                if !text.trim().is_empty()
                    && !text.contains(['\n', '{'])
                    && !text.contains(": ")
                    && !text.ends_with(':') =>
            {
                TextOrPath::Path(text.into())
            }
            other => other,
        }
    }
}

impl Model {
    fn checked(model: StageModel) -> PyResult<Model> {
        model.check().or_raise()?;
        Effects::new(&model.effects).or_raise()?;
        Ok(Model(model))
    }
}

#[pymethods]
impl Model {
    #[staticmethod]
    fn from_yaml(source: TextOrPath) -> PyResult<Model> {
        let model = match source.or_file() {
            TextOrPath::Text(text) => StageModel::from_yaml(&text, "the model"),
            TextOrPath::Path(path) => load_model(&path),
        };
        Model::checked(model.or_raise()?)
    }

    #[staticmethod]
    fn guide(name: &str) -> PyResult<Model> {
        Model::checked(StageModel::on_guides(name))
    }

    #[staticmethod]
    fn rig(name: &str) -> PyResult<Model> {
        Model::checked(StageModel::measuring_rig(name).or_raise()?)
    }

    #[staticmethod]
    fn guides() -> Vec<String> {
        Catalogue::builtin().names().map(str::to_owned).collect()
    }

    #[staticmethod]
    fn from_dict(model: &Bound<'_, PyAny>) -> PyResult<Model> {
        // JSON is YAML.
        let text: String =
            model.py().import("json")?.getattr("dumps")?.call1((model,))?.extract()?;
        Model::checked(StageModel::from_yaml(&text, "the model").or_raise()?)
    }

    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let text = serde_json::to_string(&self.0)
            .map_err(|error| crate::error::raised::ModelError::new_err(error.to_string()))?;
        from_json(py, &text)
    }

    fn to_yaml(&self) -> PyResult<String> {
        self.0.to_yaml().or_raise()
    }

    #[getter]
    fn notes(&self) -> PyResult<Vec<String>> {
        self.0.notes().or_raise()
    }

    #[getter]
    fn name(&self) -> &str {
        &self.0.name
    }

    #[getter]
    fn mass(&self) -> f64 {
        self.0.mass
    }

    #[getter]
    fn effects(&self) -> Vec<String> {
        self.0.effects.iter().map(|effect| effect.name.clone()).collect()
    }

    fn without_noise(&self) -> Model {
        Model(self.0.clone().without_noise())
    }

    fn __repr__(&self) -> String {
        let effects = match self.effects().join(", ") {
            none if none.is_empty() => String::new(),
            names => format!(", with {names}"),
        };
        format!(
            "<Model {}: {} kg on {} guides{effects}>",
            self.0.name,
            self.0.mass,
            self.0.guides.len()
        )
    }

    fn __reduce__(slf: &Bound<'_, Self>) -> PyResult<(Py<PyAny>, (String,))> {
        let class = slf.get_type().getattr("from_yaml")?.unbind();
        Ok((class, (slf.get().0.to_yaml().map_err(Raise::raise)?,)))
    }
}
