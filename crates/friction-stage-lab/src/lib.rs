//! Stage and controller in one process, without DDS: the reference for lockstep, for experiments
//! and for identification.
//!
//! In come a model, controller settings, a seed and a motion, out come samples with every term; no
//! clock, no I/O. Each experiment of the paper is one file: it runs the measuring rig or the stage
//! and reduces what the sensors say.
//!
//! ```
//! use friction_stage_lab::{Settings, Specimen, stribeck};
//!
//! let guide = Specimen::of_guide("guide_2")?;
//! let (curve, _recording) = stribeck(&guide, &Settings::default(), &[0.01, 0.2, 0.4], &|| ())?;
//! for point in &curve.points {
//!     println!("{:.2} N at {:.3} m/s", point.force.value, point.velocity);
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![warn(missing_docs)]

mod application;
mod balance;
mod compensation_trial;
mod dahl;
mod distributed_fit;
mod experiment;
mod fast_move;
mod finding;
mod fine_step;
mod frequency_response;
mod friction_curve;
mod guide_fit;
mod hidden_effect;
mod hunting;
mod least_squares;
mod loop_analysis;
mod motion_quality;
mod paper;
mod paper_fit;
mod quick_loops;
mod rig;
mod rows;
mod selection;
mod settling;
mod specimen;
mod statements;
mod stribeck;
mod sweep;
mod tuning;
mod variant;

pub use application::{
    Application, ApplicationError, ApplicationMotion, Constraints, GuideTolerances, Loop,
    Requirement, Sealing,
};
pub use compensation_trial::{CompensationTrial, TrialError, TrialRun};
pub use dahl::{
    AMPLITUDES, DahlCurves, DahlResonance, HysteresisLoop, LoopTiming, PAPER_AMPLITUDES, dahl,
    hysteresis_loop,
};
pub use distributed_fit::{DistributedFit, NoDistributedFit, best_single, fit as fit_distributed};
pub use experiment::{
    Experiment, ExperimentFindings, ExperimentPlan, ExperimentResults, Keep, KeptParts, LoadPart,
    OwnMove, SavePart, SpecimenHunting, SpecimenRig, StiffnessFit, check_amplitude, check_rest,
};
pub use fast_move::{FastMove, WAVE, fast_move};
pub use finding::{
    Drawback, ExperimentFinding, GuideFitFinding, Omission, Omitted, SelectionFinding,
};
pub use fine_step::{FineStep, STEPS, fine_step};
pub use frequency_response::{
    FrequencyResponse, Resonance, ResponseLevel, ResponsePoint, frequency_response,
};
pub use friction_curve::{CurveError, CurvePoint, FrictionCurve, Stribeck, friction_curve};
pub use guide_fit::{Fitted, GuideConstruction, GuideFit, GuideFitError, RigRecord, fit_guide};
pub use hidden_effect::HiddenEffect;
pub use hunting::{BANDWIDTHS, HuntingResult, INTEGRALS, LimitCycle, hunting};
pub use least_squares::{FitError, Minimum, minimise};
pub use loop_analysis::{
    COHERENT, ComparedPoint, LoopComparison, LoopPoint, LoopProbe, LoopResponse, LoopSine, Margins,
    MeasuredLoop, MeasuredLoopError, MeasuredLoopPoint, SampledStage, StageMotion, UNDISTORTED,
    loop_frequencies, measure_loop,
};
pub use motion_quality::{FollowedSample, MotionQuality, motion_quality, moves_along};
pub use paper::{Conditioning, Move, MoveError, MoveKind, PaperMotion};
pub use paper_fit::{
    ASSUMED_WIDTH, DatumKind, ElementGuide, FREE_WIDTH, ORDER_MARGIN, ORDER_WIDTH, PaperDatum,
    PaperFit, PaperFitError, STATED_WIDTH, fit_paper,
};
pub use quick_loops::{QUICK_LOOPS, quick_loops};
pub use rig::{RIG_TICKS, RigBias, rig};
#[cfg(feature = "parquet")]
pub use rows::ParquetTable;
pub use rows::{
    Cell, Column, ColumnKind, NumberedPlan, OtherJob, Rows, RowsError, Sheet, TableFormat,
    VariantRows, kind_of, merge_shards, write_table,
};
pub use selection::{
    Candidate, GuideSelection, Quantiles, Ranked, SelectionError, SelectionPlan, Shard, Tally,
};
pub use settling::{MoveResult, SETTLING_BANDS, settling};
pub use specimen::{
    LabError, LabRecording, MeasuredValue, Platform, Row, SERVO_BANDWIDTH, Settings, Specimen,
    closed_loop,
};
pub use statements::{
    PaperResults, STATED_STIFFNESS, Statement, StiffnessError, fit_stated, loop_at, statements,
    stiffness_errors,
};
pub use stribeck::{SPEEDS, StribeckCurve, StribeckPoint, stribeck};
pub use sweep::{
    Axis, AxisSummary, AxisValues, CONTROLLER_KEYS, GivenParameters, PointSummary, SweepError,
    SweepMotion, SweepOutcome, SweepPlan, SweepQuantiles, SweepRows, SweepSummary, SweepValue,
    TrajectoryPoint, given_by, sweep_unit,
};
pub use tuning::{
    AmplitudeMargins, Objective, OnVariants, Tuned, Tuning, TuningError, TuningPlan, break_away,
    errors_along, step_response,
};
pub use variant::{VariantError, VariantExperiment, VariantResult, variant_seed};
