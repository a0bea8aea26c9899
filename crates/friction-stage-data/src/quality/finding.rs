//! What is wrong with the signals of a recording for identification, each as a kind with its
//! numbers; the words for them are those of `friction-stage-report`.
//!
//! A fatal finding means that nothing can be identified; a warning says what cannot, or what to
//! examine first.

use std::ops::Range;

use serde::Serialize;

use crate::signals::{ClockKind, Signal};
use friction_stage_core::model::JointType;

/// How much a finding stands in the way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// What the recording is like, and what follows from it; nothing is wrong with it.
    Note,
    /// Something cannot be identified, or should be looked at.
    Warning,
    /// Nothing can be identified.
    Fatal,
}

impl Severity {
    /// As in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Note => "note",
            Self::Warning => "warning",
            Self::Fatal => "fatal",
        }
    }
}

/// What shows that two signals do not agree.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Disagreement {
    /// The first is this many times the second.
    Factor(f64),
    /// The first shows each sample of the second before it, this many times as well as after it.
    Before(f64),
}

/// What shows that a sensor is dead where its value repeats.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum DeadEvidence {
    /// The noise that the signal has around it is gone.
    Silent,
    /// The motion would have to stop or start more abruptly than it does anywhere else.
    Abrupt,
}

/// Something about the signals that stands in the way of identification.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum DataFinding {
    /// Too few rows in one piece.
    TooShort {
        /// Rows of the longest stretch.
        rows: usize,
        /// Its length, s.
        seconds: f64,
        /// Least number of rows.
        needed: usize,
    },
    /// Rows enough, in a time in which no stage moves.
    TooBrief {
        /// Length of the longest stretch, s.
        seconds: f64,
        /// Least length, s.
        needed: f64,
    },
    /// Much of the recording is missing.
    Holes {
        /// Share of the rows that are not valid.
        share: f64,
        /// Gaps of the position.
        gaps: u64,
        /// Valid pieces.
        segments: usize,
    },
    /// Neither a force cell nor a command.
    NoForce,
    /// A force is recorded, and none of its values could be put in the rows: the notes say why.
    ForceUnused,
    /// The position jumps from one end of its range to the other and moves on.
    Wrapped {
        /// The signal.
        signal: Signal,
        /// Size of the jump, m: the length after which the counter begins again.
        jump: f64,
        /// Rows after the jumps.
        rows: Vec<usize>,
    },
    /// A motion that no stage makes.
    ImpossibleMotion {
        /// Speed, m/s, that is exceeded in a hundredth of the time.
        speed: f64,
        /// The most that is expected of a stage, m/s.
        fastest: f64,
        /// Acceleration, m/s², that is exceeded in a hundredth of the time.
        acceleration: f64,
        /// The most that is expected of a stage, m/s².
        sharpest: f64,
    },
    /// The carriage does not move.
    NoMotion {
        /// Highest minus lowest position, m.
        range: f64,
        /// Standard deviation of the noise, m.
        noise: f64,
        /// Highest speed, m/s.
        fastest: f64,
        /// Speed up to which such noise counts as rest, m/s.
        rest_speed: f64,
    },
    /// A signal that never changes.
    Constant {
        /// The signal.
        signal: Signal,
        /// Its only value, SI.
        value: f64,
    },
    /// A signal that stays at its largest or smallest value.
    Clipped {
        /// The signal.
        signal: Signal,
        /// The extreme, SI.
        value: f64,
        /// Rows that have it.
        rows: usize,
    },
    /// A sensor that is dead for a while.
    Stuck {
        /// The signal.
        signal: Signal,
        /// Its value in the longest stretch, SI.
        value: f64,
        /// Length of it, s.
        seconds: f64,
        /// Rows in it.
        rows: usize,
        /// What shows it.
        evidence: DeadEvidence,
        /// The rows of every stretch.
        stretches: Vec<Range<usize>>,
    },
    /// Samples far from those around them.
    Outliers {
        /// The signal.
        signal: Signal,
        /// How many.
        samples: usize,
        /// Value of the first, SI.
        value: f64,
        /// When it was, s since the start.
        seconds: f64,
    },
    /// The command reaches the motor's limit.
    Saturated {
        /// Largest command, N.
        largest: f64,
        /// Declared limit, N.
        limit: f64,
        /// Rows at or above it.
        rows: usize,
    },
    /// NaN or infinite samples.
    NotFinite {
        /// The signal.
        signal: Signal,
        /// How many.
        samples: u64,
        /// Of how many.
        total: u64,
    },
    /// Samples with the same stamp and different values.
    Conflicting {
        /// The signal.
        signal: Signal,
        /// How many.
        samples: u64,
    },
    /// A signal with a few values only.
    Sparse {
        /// The signal.
        signal: Signal,
        /// Share of the rows with a value.
        share: f64,
    },
    /// No force cell.
    NoForceCell,
    /// No command.
    NoCommand,
    /// No setpoint.
    NoSetpoint,
    /// All motion at one speed.
    OneSpeed {
        /// The speed, m/s.
        speed: f64,
        /// Share of the moving time at it.
        share: f64,
    },
    /// All motion in one direction.
    OneDirection,
    /// A sign that is swapped.
    SwappedSign {
        /// The signal.
        signal: Signal,
        /// Force over acceleration, kg.
        mass: f64,
        /// Whether every force with the wrong sign would show the same.
        or_every_force: bool,
    },
    /// A unit that is wrong.
    WrongUnit {
        /// The signal.
        signal: Signal,
        /// The unit that it seems to be in.
        unit: &'static str,
        /// Force over acceleration, kg.
        mass: f64,
        /// Declared mass, kg.
        declared: f64,
        /// Whether Coulomb friction is as declared.
        friction_fits: bool,
    },
    /// Two signals that should agree do not, and nothing tells which is wrong.
    Disagree {
        /// One of them.
        first: Signal,
        /// The other.
        second: Signal,
        /// What shows it.
        evidence: Disagreement,
    },
    /// The data are of another machine than the model.
    OtherMachine {
        /// Declared mass, kg.
        declared: f64,
        /// Mass by a rough fit, kg.
        measured: f64,
        /// Its standard deviation, kg.
        deviation: f64,
    },
    /// The units of the recording are those of another joint type than the model's.
    OtherJoint {
        /// The model's.
        declared: JointType,
        /// That of the recording's units.
        recorded: JointType,
    },
    /// Friction of another size than the model declares.
    OtherFriction {
        /// Declared, N.
        declared: f64,
        /// By a rough fit, N.
        measured: f64,
        /// Its standard deviation, N.
        deviation: f64,
    },
    /// The force does not follow the motion.
    Unrelated {
        /// The signal.
        signal: Signal,
        /// Explained share of its mean square.
        share: f64,
    },
    /// Noise that is not as declared.
    Noise {
        /// The signal.
        signal: Signal,
        /// Its unit.
        unit: &'static str,
        /// Standard deviation found, SI.
        present: f64,
        /// Declared standard deviation with quantisation, SI.
        declared: f64,
    },
    /// Stamps that jitter.
    Jitter {
        /// Standard deviation, s.
        jitter: f64,
        /// What was done about it.
        clock: ClockKind,
    },
    /// A rate that no stage is sampled at.
    OddRate {
        /// Rows per second, Hz.
        rate: f64,
    },
}

impl DataFinding {
    /// Stable name of the kind, for other programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::TooShort { .. } => "too_short",
            Self::TooBrief { .. } => "too_brief",
            Self::Holes { .. } => "holes",
            Self::NoForce => "no_force",
            Self::ForceUnused => "unused_force",
            Self::Wrapped { .. } => "wrapped_position",
            Self::ImpossibleMotion { .. } => "impossible_motion",
            Self::NoMotion { .. } => "no_motion",
            Self::Constant { .. } => "constant_signal",
            Self::Clipped { .. } => "clipped_signal",
            Self::Stuck { .. } => "stuck_signal",
            Self::Outliers { .. } => "outliers",
            Self::Saturated { .. } => "saturated_command",
            Self::NotFinite { .. } => "not_finite",
            Self::Conflicting { .. } => "conflicting_stamps",
            Self::Sparse { .. } => "sparse_signal",
            Self::NoForceCell => "no_force_cell",
            Self::NoCommand => "no_command",
            Self::NoSetpoint => "no_setpoint",
            Self::OneSpeed { .. } => "one_speed",
            Self::OneDirection => "one_direction",
            Self::SwappedSign { .. } => "swapped_sign",
            Self::WrongUnit { .. } => "wrong_unit",
            Self::Disagree { .. } => "signals_disagree",
            Self::OtherMachine { .. } => "other_machine",
            Self::OtherJoint { .. } => "other_joint",
            Self::OtherFriction { .. } => "other_friction",
            Self::Unrelated { .. } => "unrelated_force",
            Self::Noise { .. } => "noise_not_as_declared",
            Self::Jitter { .. } => "jittering_stamps",
            Self::OddRate { .. } => "odd_rate",
        }
    }

    /// How much it stands in the way.
    pub fn severity(&self) -> Severity {
        match self {
            Self::TooShort { .. }
            | Self::TooBrief { .. }
            | Self::NoForce
            | Self::ForceUnused
            | Self::NoMotion { .. } => Severity::Fatal,
            Self::NoForceCell | Self::NoCommand | Self::NoSetpoint => Severity::Note,
            Self::Jitter { clock: ClockKind::UniformBehindJitter, .. } => Severity::Note,
            Self::SwappedSign { .. }
            | Self::WrongUnit { .. }
            | Self::Disagree { .. }
            | Self::OtherJoint { .. } => Severity::Fatal,
            // a payload may double the mass, more is no payload; 0.5 to 2 is assumed
            Self::OtherMachine { declared, measured, .. }
                if !(0.5..=2.0).contains(&(measured / declared)) =>
            {
                Severity::Fatal
            }
            _ => Severity::Warning,
        }
    }

    /// The signal of which some values are none that a motion made: those of a cable that is off,
    /// of a range that has ended, or of a line that lost a bit. They can be left out.
    pub fn broken_signal(&self) -> Option<Signal> {
        match self {
            Self::Constant { signal, .. }
            | Self::Clipped { signal, .. }
            | Self::Stuck { signal, .. }
            | Self::Outliers { signal, .. } => Some(*signal),
            _ => None,
        }
    }

    /// Whether it shows that the recording contradicts itself or the model, or has samples that no
    /// machine made: then no figure of a comparison with the model says anything.
    pub fn is_contradiction(&self) -> bool {
        match self {
            Self::TooShort { .. }
            | Self::TooBrief { .. }
            | Self::NoMotion { .. }
            | Self::NoForce
            | Self::ForceUnused => false,
            Self::Outliers { .. } | Self::NotFinite { .. } => true,
            other => other.severity() == Severity::Fatal,
        }
    }
}

/// Something that is wrong with the messages of a recording.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum FileFinding {
    /// It is cut off, or damaged at its end.
    Incomplete,
    /// Parts of it are damaged.
    Damaged,
    /// The metadata count other messages than can be read.
    MessageCount {
        /// By the metadata.
        declared: u64,
        /// That can be read.
        read: u64,
    },
    /// A directory without readable metadata.
    NoMetadata,
    /// Nothing but the messages says the type of a topic.
    TypeByMessages {
        /// The topic.
        topic: String,
        /// Known types that its messages fit; the first is taken where it is one.
        fitting: Vec<String>,
        /// Type that is taken; empty for none.
        type_name: String,
    },
    /// Messages that do not decode as their type.
    Undecodable {
        /// The topic.
        topic: String,
        /// How many.
        messages: u64,
        /// Of how many.
        total: u64,
        /// The type.
        type_name: String,
    },
    /// Values that are NaN or infinite.
    NotFinite {
        /// The topic.
        topic: String,
        /// How many.
        values: u64,
    },
    /// Stamps before the one before.
    BackwardStamps {
        /// The topic.
        topic: String,
        /// How many.
        stamps: u64,
    },
    /// Stamps equal to the one before.
    RepeatedStamps {
        /// The topic.
        topic: String,
        /// How many.
        stamps: u64,
    },
    /// Intervals of more than 1.5 usual ones.
    Gaps {
        /// The topic.
        topic: String,
        /// How many.
        gaps: u64,
        /// The longest interval, s.
        longest_s: f64,
        /// The usual one, s.
        usual_s: f64,
    },
    /// Messages that were logged at another time than others with such stamps.
    LogTimes {
        /// The topic.
        topic: String,
        /// How many.
        messages: u64,
        /// How far off the log time is at most, s.
        seconds: f64,
    },
    /// The model in it cannot be used.
    UnusableModel {
        /// Why not.
        reason: String,
    },
}

impl FileFinding {
    /// Stable name of the kind, for other programs.
    pub fn code(&self) -> &'static str {
        match self {
            Self::Incomplete => "incomplete_file",
            Self::Damaged => "damaged_file",
            Self::MessageCount { .. } => "message_count",
            Self::NoMetadata => "no_metadata",
            Self::TypeByMessages { .. } => "type_by_messages",
            Self::Undecodable { .. } => "undecodable_messages",
            Self::NotFinite { .. } => "not_finite",
            Self::BackwardStamps { .. } => "backward_stamps",
            Self::RepeatedStamps { .. } => "repeated_stamps",
            Self::Gaps { .. } => "gaps",
            Self::LogTimes { .. } => "log_times",
            Self::UnusableModel { .. } => "unusable_model",
        }
    }

    /// How much it stands in the way: what can be read counts, so it is never fatal.
    pub fn severity(&self) -> Severity {
        Severity::Warning
    }
}
