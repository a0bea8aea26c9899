//! What can be wrong with a model, each with the numbers that a user needs to mend it.

use super::{Catalogue, StageModel};
use crate::numerics::plain;

/// A model that cannot be read or that no stage could have.
#[expect(missing_docs, reason = "the message of each says what its fields are")]
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    #[error("cannot read the model file {path}: {source}")]
    Read { path: String, source: std::io::Error },
    #[error("cannot read the catalogue {path}: {source}")]
    ReadCatalogue { path: String, source: std::io::Error },
    #[error("{origin}: {message}")]
    Yaml { origin: String, message: String },
    #[error("{origin}: is empty; a model with every value at its default is `{{}}`")]
    Empty { origin: String },
    #[error(
        "{origin}: names the catalogue {path:?}; only a model file may: write the parameters of \
         its guides in the place of their names"
    )]
    CatalogueOutsideFile { origin: String, path: std::path::PathBuf },
    #[error("cannot write the model: {message}")]
    Write { message: String },
    #[error("{origin}: {source}")]
    InFile { origin: String, source: Box<ModelError> },
    #[error("{key} is {}, must {limit}", plain(*value))]
    Value { key: String, value: f64, limit: String },
    #[error("a stage has 1 to 4 guides, found {found}")]
    GuideCount { found: usize },
    #[error("{key}: unknown guide `{name}`; the catalogue has {known}{hint}")]
    UnknownGuide { key: String, name: String, hint: String, known: String },
    #[error("unknown guide `{name}`; known are {known}{hint}")]
    NotInCatalogue { name: String, hint: String, known: String },
    #[error(
        "`{guide}{}`: the catalogue has no parallel bristles of `{guide}`",
        StageModel::PARALLEL_BRISTLES
    )]
    NoParallelBristles { guide: String },
    #[error("effects: unknown effect `{name}`; known are {known}{hint}")]
    UnknownEffect { name: String, hint: String, known: String },
    #[error("effects.{effect}: unknown parameter `{name}`; it takes {known}{hint}")]
    UnknownEffectParameter { effect: &'static str, name: String, hint: String, known: String },
    #[error("{key}: unknown form `{name}`{hint}")]
    UnknownForm { key: String, name: String, hint: String },
    #[error("{key} is `{text}`, must be a number, {unit}")]
    NotANumber { key: String, text: String, unit: &'static str },
    #[error("effects.{effect}: parameter `{name}` is missing ({description}, {unit})")]
    MissingEffectParameter {
        effect: &'static str,
        name: &'static str,
        description: &'static str,
        unit: &'static str,
    },
    #[error(
        "{origin} holds no guide: a catalogue has one entry per guide, as the built-in one has"
    )]
    EmptyCatalogue { origin: String },
    #[error("{origin}: `{name}` is in the catalogue already; give it a name of its own")]
    DuplicateGuide { origin: String, name: String },
    #[error("{key}: the unit is `{found}`, must be `{expected}`")]
    Unit { key: String, found: String, expected: &'static str },
    #[error(
        "the step is {step} s: must be positive and at most {limit} s, so that the carriage stays \
         stable"
    )]
    Step { step: f64, limit: f64 },
}

impl ModelError {
    /// Whether it is about a name that no guide and no effect has, and not about a file.
    pub fn is_unknown_name(&self) -> bool {
        matches!(
            self,
            ModelError::UnknownGuide { .. }
                | ModelError::NotInCatalogue { .. }
                | ModelError::NoParallelBristles { .. }
                | ModelError::UnknownEffect { .. }
        )
    }

    /// The same with the nearest of all models that have a name, where a guide is unknown.
    pub(super) fn with_nearest_model(mut self, given: &str) -> ModelError {
        if let ModelError::UnknownGuide { hint, .. } = &mut self {
            let catalogue = Catalogue::builtin();
            let on_bristles = catalogue
                .names()
                .filter(|name| catalogue.distributed_bristles(name).is_some())
                .map(|name| format!("{name}{}", StageModel::PARALLEL_BRISTLES));
            let names: Vec<String> =
                catalogue.names().map(str::to_owned).chain(on_bristles).collect();
            *hint = nearest(given, names.iter().map(String::as_str));
        }
        self
    }
}

/// `; did you mean ...` when one of the known names is close to the given one, else nothing.
pub fn nearest<'a>(given: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    known
        .into_iter()
        .map(|name| (strsim::jaro_winkler(given, name), name))
        // 0.7 finds one or two wrong letters in short names without offering unrelated ones.
        .filter(|(similarity, _)| *similarity > 0.7)
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, name)| format!("; did you mean `{name}`?"))
        .unwrap_or_default()
}

pub(super) fn finite(key: &str, value: f64) -> Result<(), ModelError> {
    if value.is_finite() { Ok(()) } else { Err(refused(key, value, "be finite")) }
}

/// Sizes of a quantity, in SI units, that a machine can have: beyond them a number is a slip, and
/// squares and quotients of it leave what a double can hold.
const SIZES: std::ops::RangeInclusive<f64> = 1e-12..=1e12;

pub(super) fn positive(key: &str, value: f64) -> Result<(), ModelError> {
    finite(key, value)?;
    if value > 0.0 { sized(key, value) } else { Err(refused(key, value, "be greater than 0")) }
}

pub(super) fn not_negative(key: &str, value: f64) -> Result<(), ModelError> {
    finite(key, value)?;
    match value {
        0.0 => Ok(()),
        value if value > 0.0 => sized(key, value),
        value => Err(refused(key, value, "not be negative")),
    }
}

fn sized(key: &str, value: f64) -> Result<(), ModelError> {
    if SIZES.contains(&value) {
        return Ok(());
    }
    let limit = format!("be between {:e} and {:e} in SI units", SIZES.start(), SIZES.end());
    Err(refused(key, value, &limit))
}

pub(super) fn refused(key: &str, value: f64, limit: &str) -> ModelError {
    ModelError::Value { key: key.to_owned(), value, limit: limit.to_owned() }
}
