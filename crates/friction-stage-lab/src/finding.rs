//! What a user should know about a fit of a guide, an experiment or a choice of a guide: each as a
//! kind with its numbers, SI units. The words for them are those of `friction-stage-report`.

use serde::Serialize;

use crate::specimen::Platform;

/// Something that a user should know about a fitted guide.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
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
#[serde(untagged)]
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

/// Why a guide is not the one to take.
#[derive(Clone, Debug, PartialEq)]
pub enum Drawback {
    /// The application excludes it: why.
    Excluded(String),
    /// Its peak error is too large.
    PeakError {
        /// In which share of its variants.
        share: f64,
        /// Median, m.
        median: f64,
        /// What the application allows, m.
        allowed: f64,
    },
    /// It settles too late.
    Settling {
        /// In which share of its variants.
        share: f64,
        /// Band, m.
        band: f64,
        /// Median, s; infinite where it does not settle while watched.
        median: f64,
        /// What the application allows, s.
        allowed: f64,
    },
    /// The motor reaches its limit.
    Saturated {
        /// In which share of its variants.
        share: f64,
    },
    /// It meets the requirement in all variants, as another guide does with more margin.
    LessMargin {
        /// The other guide.
        best: String,
        /// Medians of the peak error, its own and that of the other, m.
        peak_error: [f64; 2],
        /// Medians of the settling time, its own and that of the other, s.
        settling_time: [f64; 2],
    },
    /// What of it is notably larger than that of the guide to take.
    Larger {
        /// The other guide.
        best: String,
        /// Name, value, value of the other, unit.
        parameters: Vec<(&'static str, f64, f64, &'static str)>,
    },
}

/// Something that a user should know about a choice of a guide.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum SelectionFinding {
    /// The guide to take does not meet the requirement for certain.
    UnsafeChoice {
        /// The guide.
        guide: String,
        /// Share of its variants that meet the requirement.
        chance: f64,
    },
    /// A guide with less viscous friction positions worse (paper, sections 2 and 4).
    LowFriction {
        /// The guide.
        guide: String,
        /// The guide to take.
        best: String,
        /// Its viscous friction as a share of that of the other.
        viscous_share: f64,
        /// Static friction, its own and that of the other, N.
        static_force: [f64; 2],
        /// Medians of the peak error, its own and that of the other, m.
        peak_error: [f64; 2],
    },
}

impl SelectionFinding {
    /// Stable name of the kind, for other programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::UnsafeChoice { .. } => "unsafe_choice",
            Self::LowFriction { .. } => "low_friction",
        }
    }

    /// Whether a script must notice it; the others are advice.
    pub fn is_warning(&self) -> bool {
        matches!(self, Self::UnsafeChoice { .. })
    }
}
