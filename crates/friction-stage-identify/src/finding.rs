//! What a user should know about the records, the fit and the verdict: each as a kind with its
//! numbers. The words for them are those of `friction-stage-report`.

use std::path::PathBuf;

use serde::Serialize;

use friction_stage_core::model::{Coordinate, CurveSide};
use friction_stage_data::quality::{DataFinding, Severity};
use friction_stage_data::signals::{Signal, SignalNote};

use crate::residual_location::ResidualLocation;

/// One of the two sides of the split.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum RecordSide {
    /// The record that is fitted.
    Train,
    /// The record that no fit sees.
    Holdout,
}

/// A figure of merit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FigureOfMerit {
    /// Rms of the missing force, N.
    ForceResidual,
    /// Rms of the closed-loop position error, m.
    PositionError,
}

/// An end of the range in which a parameter is fitted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum BoundSide {
    /// The lowest value.
    Lower,
    /// The highest value.
    Upper,
}

/// Something that a user should know about an identification; SI units.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum IdentifyFinding {
    /// How the signals of a recording were read.
    Reading {
        /// The recording.
        recording: PathBuf,
        /// What was met.
        note: SignalNote,
    },
    /// What is wrong with the signals of a recording.
    Data {
        /// The recording.
        recording: PathBuf,
        /// What is wrong.
        finding: DataFinding,
        /// Whether the values that it is about are left out.
        left_out: bool,
    },
    /// Rows that are filled in for samples that are missing.
    Filled {
        /// The recording.
        recording: PathBuf,
        /// Share of the rows.
        share: f64,
        /// Whether the forces there are compared all the same: there are too many to leave out.
        compared: bool,
    },
    /// Rests in which friction changes within a count of the encoder: not compared, until the
    /// guides have slid far enough to have forgotten what they held.
    HiddenRest {
        /// The record.
        record: RecordSide,
        /// Share of its samples.
        share: f64,
        /// Count of the encoder, m.
        count: f64,
    },
    /// A force that only some of the recordings have: left out of all of them.
    NotCommon {
        /// The force.
        signal: Signal,
    },
    /// Several recordings of a side are joined.
    Joined,
    /// A vibration whose phase is each record's own.
    PhaseOfRecord {
        /// The effect.
        effect: &'static str,
    },
    /// A map that jumps at another instant of the hold-out.
    JumpElsewhere {
        /// The instant in the hold-out, s.
        at: f64,
        /// Length of the hold-out, s.
        length: f64,
    },
    /// A ripple whose phase wanders: amplitude and phase are each record's own.
    Slips {
        /// The effect.
        effect: &'static str,
    },
    /// The closed loop cannot be simulated.
    NoClosedLoop {
        /// Why not.
        reason: String,
    },
    /// The search was stopped before its end.
    Stopped,
    /// Two effects that the data do not tell apart.
    Inseparable {
        /// The effect that was added.
        effect: &'static str,
        /// The one that would do as well.
        rival: &'static str,
        /// Correlation of what the two explain.
        correlation: f64,
    },
    /// Several ripples of nearly one period: together they are the ripple.
    OneRipple {
        /// The effect.
        effect: &'static str,
        /// How many.
        count: usize,
    },
    /// A ripple that repeats too rarely within the travel to be shown as one.
    FewPeriods {
        /// The effect.
        effect: &'static str,
        /// Periods within the travel.
        periods: f64,
    },
    /// A map stands for what no law explains.
    UnexplainedOver {
        /// Over what.
        coordinate: Coordinate,
    },
    /// The map jumps.
    MapJumps {
        /// When, s.
        at: f64,
        /// By how much, in the unit of the side.
        height: f64,
        /// Value of the map before the jump.
        before: f64,
        /// What the map changes.
        side: CurveSide,
    },
    /// More than the declared noise is left where there is nothing but the declared model: the
    /// sensors are noisier, or too coarse or too slow for the motion.
    NoiseAboveDeclared {
        /// Residual that is left of the hold-out where there is nothing to find, N.
        found: f64,
        /// Residual that the declared noise leaves, N.
        declared: f64,
        /// Least force of an effect that is seen, N rms.
        least: f64,
    },
    /// More is left of the hold-out than where nothing is missing, and too little to say what of it
    /// is missing.
    MoreThanUsual {
        /// Residual of the hold-out, N.
        left: f64,
        /// Residual that is left of it where there is nothing to find, N.
        noise_floor: f64,
        /// What may be missing, N rms.
        may_be_missing: f64,
    },
    /// More than noise is left of the hold-out, and no more than the train record leaves open: it
    /// has too little of the motions of the hold-out.
    LeftOpen {
        /// Residual of the hold-out, N.
        left: f64,
        /// What the noise of the sensors leaves, N.
        noise_floor: f64,
        /// Force on the hold-out that is not known after the fit, N rms.
        open: f64,
    },
    /// Stiffness or damping of the bristles is not what the model declares: with what the records
    /// show of them no more than noise is left.
    OtherBristles {
        /// Name of the parameter.
        parameter: &'static str,
        /// What the records show, mean of the guides.
        found: f64,
        /// What the model declares, mean of the guides.
        declared: f64,
        /// Its unit.
        unit: &'static str,
        /// Its tolerance, as a share of the declared value.
        tolerance: f64,
        /// What the model leaves of the hold-out with bristles within their tolerance, N.
        left_within_tolerance: f64,
    },
    /// Something is left that neither a law nor a map explains.
    Unexplained {
        /// What is left on the hold-out, N.
        left: f64,
        /// What the noise of the sensors leaves, N.
        noise_floor: f64,
    },
    /// The zero of the force cell wanders on the hold-out.
    WanderingZero {
        /// N rms.
        wander: f64,
    },
    /// The laws that were found hold only roughly.
    RoughLaws {
        /// What is left on the hold-out, N.
        left: f64,
        /// What the noise of the sensors leaves, N.
        noise_floor: f64,
    },
    /// Where it sits what the laws leave of a record, where that is more than noise.
    ResidualLocation {
        /// The record.
        record: RecordSide,
        /// The side of the stage on which most of it is: `motor` or `carriage`.
        side: &'static str,
        /// What is left there without maps, N.
        left: f64,
        /// What the noise of the sensors leaves there, N.
        noise_floor: f64,
        /// Where it sits.
        location: ResidualLocation,
    },
    /// Laws that explain a part only: the identified model does not have them.
    PartialLaws {
        /// Their names.
        effects: Vec<&'static str>,
    },
    /// No more laws are added.
    MostLaws {
        /// How many are.
        laws: usize,
    },
    /// A parameter that ended on a bound.
    AtBound {
        /// Its name.
        parameter: String,
        /// Which bound.
        bound: BoundSide,
        /// Its value.
        value: f64,
        /// Its unit.
        unit: &'static str,
        /// Its tolerance, as a share of what is declared, where that is the bound.
        tolerance: Option<f64>,
    },
    /// A parameter about which the data say nothing.
    NotIdentifiable {
        /// Its name.
        parameter: String,
        /// Where the fit left it.
        value: f64,
        /// Its unit.
        unit: &'static str,
    },
    /// A parameter that the data know no better than its tolerance.
    HardlyIdentifiable {
        /// Its name.
        parameter: String,
        /// Its value.
        value: f64,
        /// Its unit.
        unit: &'static str,
        /// Half width of its 95 % interval, as a share of the value.
        half_width: f64,
        /// Its tolerance, as a share of the value.
        tolerance: f64,
    },
    /// Two parameters that the data tie to each other.
    Tied {
        /// A parameter of an effect.
        parameter: String,
        /// The other one.
        other: String,
        /// Their correlation.
        correlation: f64,
    },
    /// A ripple that is on both records with different phases.
    MovedRipple {
        /// Effects that would explain it.
        effects: Vec<&'static str>,
        /// Its period, m.
        period: f64,
        /// Phase on the hold-out less that on the train record, rad.
        phase_shift: f64,
    },
    /// A figure of merit that is worse with the identified model.
    Worse {
        /// Which.
        figure: FigureOfMerit,
        /// On which record.
        record: RecordSide,
        /// With the declared model, refitted.
        before: f64,
        /// With the identified model.
        after: f64,
    },
    /// Two effects that no motion within the limits separates.
    NoSeparatingMotion {
        /// The effect that was added.
        effect: String,
        /// Its rival.
        rival: String,
    },
    /// No next experiment can be worked out.
    NoNextExperiment {
        /// Why not.
        reason: String,
    },
}

impl IdentifyFinding {
    /// Stable name of the kind, for other programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Reading { note, .. } => note.code(),
            Self::Data { finding, .. } => finding.code(),
            Self::Filled { .. } => "filled_rows",
            Self::HiddenRest { .. } => "hidden_rest",
            Self::NotCommon { .. } => "signal_not_common",
            Self::Joined => "joined_recordings",
            Self::PhaseOfRecord { .. } => "phase_of_record",
            Self::JumpElsewhere { .. } => "jump_elsewhere",
            Self::Slips { .. } => "slipping_ripple",
            Self::NoClosedLoop { .. } => "no_closed_loop",
            Self::Stopped => "search_stopped",
            Self::Inseparable { .. } => "inseparable_effects",
            Self::OneRipple { .. } => "one_ripple",
            Self::FewPeriods { .. } => "few_periods",
            Self::UnexplainedOver { .. } => "unexplained_over_coordinate",
            Self::MapJumps { .. } => "map_jumps",
            Self::NoiseAboveDeclared { .. } => "noise_above_declared",
            Self::MoreThanUsual { .. } => "more_than_usual",
            Self::LeftOpen { .. } => "left_open",
            Self::OtherBristles { .. } => "other_bristles",
            Self::Unexplained { .. } => "unexplained",
            Self::WanderingZero { .. } => "wandering_zero",
            Self::RoughLaws { .. } => "rough_laws",
            Self::ResidualLocation { .. } => "residual_location",
            Self::PartialLaws { .. } => "partial_laws",
            Self::MostLaws { .. } => "most_laws",
            Self::AtBound { .. } => "at_bound",
            Self::NotIdentifiable { .. } => "not_identifiable",
            Self::HardlyIdentifiable { .. } => "hardly_identifiable",
            Self::Tied { .. } => "tied_parameters",
            Self::MovedRipple { .. } => "moved_ripple",
            Self::Worse { .. } => "worse_figure",
            Self::NoSeparatingMotion { .. } => "no_separating_motion",
            Self::NoNextExperiment { .. } => "no_next_experiment",
        }
    }

    /// How much it stands in the way; none of an identification that came to an end is fatal.
    pub fn severity(&self) -> Severity {
        match self {
            Self::Data { finding, .. } => finding.severity().min(Severity::Warning),
            Self::Joined
            | Self::HiddenRest { .. }
            | Self::PhaseOfRecord { .. }
            | Self::Slips { .. }
            | Self::OneRipple { .. }
            | Self::ResidualLocation { .. }
            | Self::NoClosedLoop { .. }
            | Self::NoSeparatingMotion { .. }
            | Self::NoNextExperiment { .. } => Severity::Note,
            _ => Severity::Warning,
        }
    }

    /// The recording that it is about, where it is about one.
    pub fn recording(&self) -> Option<&std::path::Path> {
        match self {
            Self::Reading { recording, .. }
            | Self::Data { recording, .. }
            | Self::Filled { recording, .. } => Some(recording),
            _ => None,
        }
    }

    /// Its numbers and names, by what they are.
    pub fn numbers(&self) -> serde_json::Map<String, serde_json::Value> {
        let value = match self {
            Self::Reading { note, .. } => serde_json::to_value(note),
            Self::Data { finding, .. } => serde_json::to_value(finding),
            other => serde_json::to_value(other),
        };
        let Ok(serde_json::Value::Object(mut fields)) = value else {
            return serde_json::Map::new();
        };
        if !matches!(self, Self::Reading { .. } | Self::Data { .. }) {
            // The name of the variant with what is in it.
            let inner = fields.into_iter().next().map(|(_, inner)| inner);
            let Some(serde_json::Value::Object(of_variant)) = inner else {
                return serde_json::Map::new();
            };
            fields = of_variant;
        }
        fields.remove("kind");
        fields.remove("recording");
        if let Self::Data { left_out, .. } = self {
            fields.insert("left_out".to_owned(), (*left_out).into());
        }
        fields
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_finding_gives_its_numbers_by_name_without_its_kind() {
        let tied = IdentifyFinding::Tied {
            parameter: "cogging.phase".to_owned(),
            other: "mass".to_owned(),
            correlation: 0.99,
        };
        assert_eq!(
            serde_json::Value::Object(tied.numbers()),
            serde_json::json!({"parameter": "cogging.phase", "other": "mass", "correlation": 0.99})
        );
        let clipped = IdentifyFinding::Data {
            recording: "a.csv".into(),
            finding: DataFinding::Clipped { signal: Signal::Force, value: 120.0, rows: 4 },
            left_out: true,
        };
        assert_eq!(
            (clipped.code(), serde_json::Value::Object(clipped.numbers())),
            (
                "clipped_signal",
                serde_json::json!({"signal": "force", "value": 120.0, "rows": 4, "left_out": true})
            )
        );
        assert!(IdentifyFinding::Stopped.numbers().is_empty());
    }
}
