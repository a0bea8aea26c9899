//! What a user should know about a fit of a guide or an experiment: each as a kind with its
//! numbers, SI units. The words for them are those of `friction-stage-report`.

use serde::Serialize;

use crate::specimen::Platform;

/// Something that a user should know about a fitted guide.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum GuideFitFinding {
    /// The recordings hardly show a parameter.
    WideInterval {
        /// Its name.
        parameter: &'static str,
        /// Its value.
        value: f64,
        /// Half of its 95 % interval, as a share of the value.
        share: f64,
    },
    /// The noise of the cell hides the bristle damping.
    HiddenDamping {
        /// What the bristle damping makes of the loops' force, rms, N.
        damping: f64,
        /// Noise of the cell, rms, N.
        noise: f64,
    },
    /// One bristle does not fit: the stiffness depends on the amplitude.
    SeveralBristles {
        /// What one bristle leaves of the loops' force, rms, N.
        left: f64,
        /// Noise of the cell, rms, N.
        noise: f64,
    },
    /// The largest loop does not slide far.
    SmallLoop {
        /// Its width, m.
        span: f64,
        /// Distance of break-away, m.
        break_away: f64,
        /// The least width that would do, m.
        least: f64,
    },
}

impl GuideFitFinding {
    /// Stable name of the kind, for other programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::WideInterval { .. } => "wide_interval",
            Self::HiddenDamping { .. } => "hidden_damping",
            Self::SeveralBristles { .. } => "several_bristles",
            Self::SmallLoop { .. } => "small_loop",
        }
    }
}

/// What of a model is not on the rig or on the stage of its specimen.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Omission {
    /// Where it is missing.
    pub platform: Platform,
    /// Name of the model.
    pub model: String,
    /// What is missing.
    pub omitted: Omitted,
}

/// What of a model has no place on the rig or on the stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Omitted {
    /// Effects that do not belong to a guide, by name.
    Effects(Vec<String>),
    /// All guides but the first, which differ from it.
    OtherGuides,
}

/// Something that a user should know about an experiment.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum ExperimentFinding {
    /// Something of a model was left out.
    LeftOut(Omission),
    /// Without the guides of the paper, its statements have no table.
    NoStatements,
}

impl ExperimentFinding {
    /// Stable name of the kind, for other programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::LeftOut(Omission { omitted: Omitted::Effects(_), .. }) => "effects_left_out",
            Self::LeftOut(Omission { omitted: Omitted::OtherGuides, .. }) => "guides_left_out",
            Self::NoStatements => "no_statements",
        }
    }
}
