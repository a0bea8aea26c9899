//! What is wrong with data for identification, each as a sentence with its numbers and what would
//! be right.
//!
//! A fatal problem means that nothing can be identified; a warning says what cannot, or what to
//! look at first.

use serde::Serialize;
use thiserror::Error;

use crate::signals::Signal;

/// How much a problem stands in the way.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// Something cannot be identified, or should be looked at.
    Warning,
    /// Nothing can be identified.
    Fatal,
}

/// Something about the data that stands in the way of identification.
#[derive(Debug, Clone, PartialEq, Serialize, Error)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum DataProblem {
    /// Too few rows in one piece.
    #[error(
        "the longest stretch without a gap has {rows} rows ({seconds:.3} s), {needed} are needed: \
         record longer"
    )]
    TooShort {
        /// Rows of the longest stretch.
        rows: usize,
        /// Its length, s.
        seconds: f64,
        /// Least number of rows.
        needed: usize,
    },
    /// Much of the recording is missing.
    #[error(
        "{:.1} % of the rows lack the position or a force, in {gaps} gaps; what is left is used in \
         {segments} pieces", 100.0 * share
    )]
    Holes {
        /// Share of the rows that are not valid.
        share: f64,
        /// Gaps of the position.
        gaps: u64,
        /// Valid pieces.
        segments: usize,
    },
    /// Neither a force cell nor a command.
    #[error(
        "there is no force: neither force cell nor command has values; friction cannot be told \
         from the motion alone: record /stage/force_cell or /stage/force, or name them in a mapping"
    )]
    NoForce,
    /// The carriage does not move.
    #[error(
        "nothing moves: the position stays within {range:.3e} m, of which its noise of {noise:.3e} \
         m explains all: record a motion"
    )]
    NoMotion {
        /// Highest minus lowest position, m.
        range: f64,
        /// Standard deviation of the noise, m.
        noise: f64,
    },
    /// A signal that never changes.
    #[error(
        "{signal} is constant ({value}) although the position moves: it is not connected, or \
         another field carries it"
    )]
    Constant {
        /// The signal.
        signal: Signal,
        /// Its only value, SI.
        value: f64,
    },
    /// A signal that stays at its largest or smallest value.
    #[error(
        "{signal} stays at its extreme {value} in {rows} rows and is cut off there: a range or \
         limit is reached"
    )]
    Clipped {
        /// The signal.
        signal: Signal,
        /// The extreme, SI.
        value: f64,
        /// Rows that have it.
        rows: usize,
    },
    /// A signal that stops changing on the way.
    #[error(
        "{signal} stays at {value} for {seconds:.2} s ({rows} rows) while the stage is driven, and \
         changes from row to row elsewhere: it was cut off there"
    )]
    Stuck {
        /// The signal.
        signal: Signal,
        /// Its value there, SI.
        value: f64,
        /// Length, s.
        seconds: f64,
        /// Rows that have it.
        rows: usize,
    },
    /// Samples far from those around them.
    #[error(
        "{signal} is {value:.6e} at {seconds:.4} s, far from what is around it, in {samples} of \
         the samples in all: a sensor or a line dropped out there"
    )]
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
    #[error(
        "the command reaches {largest:.1} N, the declared motor limits the force to {limit:.1} N \
         in {rows} rows"
    )]
    Saturated {
        /// Largest command, N.
        largest: f64,
        /// Declared limit, N.
        limit: f64,
        /// Rows at or above it.
        rows: usize,
    },
    /// NaN or infinite samples.
    #[error(
        "{samples} of {total} samples of {signal} are NaN or infinite; they are taken as missing"
    )]
    NotFinite {
        /// The signal.
        signal: Signal,
        /// How many.
        samples: u64,
        /// Of how many.
        total: u64,
    },
    /// Samples with the same stamp and different values.
    #[error(
        "{samples} samples of {signal} have a stamp that another sample with another value has; \
         the first counts: two sources on one topic, or stamps that are too coarse (try `stamp: \
         log_time` in a mapping)"
    )]
    Conflicting {
        /// The signal.
        signal: Signal,
        /// How many.
        samples: u64,
    },
    /// A signal with a few values only.
    #[error(
        "{signal} has values in {:.1} % of the rows only and does not count as recorded",
        100.0 * share
    )]
    Sparse {
        /// The signal.
        signal: Signal,
        /// Share of the rows with a value.
        share: f64,
    },
    /// No force cell.
    #[error(
        "there is no force cell: the command counts as the force, and motor-side effects cannot be \
         told from carriage-side ones"
    )]
    NoForceCell,
    /// No command.
    #[error("there is no force command: effects of the motor (cogging, gain, lag) cannot be seen")]
    NoCommand,
    /// No setpoint.
    #[error("there is no setpoint: the closed loop cannot be simulated, only forces are compared")]
    NoSetpoint,
    /// All motion at one speed.
    #[error(
        "the carriage moves at one speed only ({speed:.4} m/s for {:.0} % of the time that it \
         moves): viscous friction cannot be told from Coulomb friction, nor a force periodic in \
         position from one periodic in time; record at least two speeds, a factor of 2 apart",
        100.0 * share
    )]
    OneSpeed {
        /// The speed, m/s.
        speed: f64,
        /// Share of the moving time at it.
        share: f64,
    },
    /// All motion in one direction.
    #[error(
        "the carriage moves in one direction only: friction cannot be told from a constant force; \
         record both directions"
    )]
    OneDirection,
    /// A sign that is swapped.
    #[error("{signal} has the wrong sign: {evidence}; give it `scale: -1` in a mapping")]
    SwappedSign {
        /// The signal.
        signal: Signal,
        /// What shows it.
        evidence: String,
    },
    /// A unit that is wrong.
    #[error("{signal} seems to be in {unit}: {evidence}; give its unit in a mapping")]
    WrongUnit {
        /// The signal.
        signal: Signal,
        /// The unit that it seems to be in.
        unit: String,
        /// What shows it.
        evidence: String,
    },
    /// Two signals that should agree do not, and nothing tells which is wrong.
    #[error("{first} and {second} do not fit together: {evidence}")]
    Disagree {
        /// One of them.
        first: Signal,
        /// The other.
        second: Signal,
        /// What shows it.
        evidence: String,
    },
    /// The data are of another machine than the model.
    #[error(
        "the model declares {declared:.4} kg, force over acceleration shows {measured:.4} +- \
         {deviation:.4} kg: another machine, a payload, or a wrong unit (the model's mass is in kg)"
    )]
    OtherMachine {
        /// Declared mass, kg.
        declared: f64,
        /// Mass by a rough fit, kg.
        measured: f64,
        /// Its standard deviation, kg.
        deviation: f64,
    },
    /// Friction of another size than the model declares.
    #[error(
        "the model declares {declared:.2} N of Coulomb friction, a rough fit shows {measured:.2} \
         N: another machine?"
    )]
    OtherFriction {
        /// Declared, N.
        declared: f64,
        /// By a rough fit, N.
        measured: f64,
    },
    /// The force does not follow the motion.
    #[error(
        "mass, Coulomb and viscous friction explain only {:.0} % of {signal} while moving: it is \
         not the force on this carriage, or much is missing from the model", 100.0 * share
    )]
    Unrelated {
        /// The signal.
        signal: Signal,
        /// Explained share of its mean square.
        share: f64,
    },
    /// Noise that is not as declared.
    #[error(
        "{signal} has {present:.3e} {unit} of noise where {declared:.3e} {unit} is declared: \
         {consequence}"
    )]
    Noise {
        /// The signal.
        signal: Signal,
        /// Its unit.
        unit: &'static str,
        /// Standard deviation found, SI.
        present: f64,
        /// Declared standard deviation with quantisation, SI.
        declared: f64,
        /// What follows.
        consequence: &'static str,
    },
    /// Stamps that jitter.
    #[error("the stamps of the position jitter by {jitter:.2e} s: {treatment}")]
    Jitter {
        /// Standard deviation, s.
        jitter: f64,
        /// What was done about it.
        treatment: &'static str,
    },
    /// A rate that no stage is sampled at.
    #[error(
        "the position is sampled at {rate:.3e} Hz: friction needs 100 Hz to 100 kHz; is the unit \
         of the time right?"
    )]
    OddRate {
        /// Rows per second, Hz.
        rate: f64,
    },
}

impl DataProblem {
    /// How much it stands in the way.
    pub fn severity(&self) -> Severity {
        match self {
            Self::TooShort { .. } | Self::NoForce | Self::NoMotion { .. } => Severity::Fatal,
            Self::SwappedSign { .. } | Self::WrongUnit { .. } | Self::Disagree { .. } => {
                Severity::Fatal
            }
            // a payload may double the mass, more is no payload; 0.5 to 2 is assumed
            Self::OtherMachine { declared, measured, .. }
                if !(0.5..=2.0).contains(&(measured / declared)) =>
            {
                Severity::Fatal
            }
            _ => Severity::Warning,
        }
    }
}
