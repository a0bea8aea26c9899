//! Words for what is wrong with a file, its signals, and for what they can identify.

use friction_stage_data::quality::{
    DataFinding, Disagreement, FileFinding, Judgement, JudgementBasis, Severity, Subject,
};
use friction_stage_data::signals::{ClockKind, Signal, SignalNote};

use super::{Words, short};

/// A noise above this many declared ones is high, one below its inverse low: as the finding has it.
fn consequence_of_noise(present: f64, declared: f64) -> &'static str {
    if present > declared {
        "the noise floor is higher than the model says; small effects are hidden"
    } else {
        "the signal is filtered, or the declaration is too careful; residuals may be overlooked"
    }
}

impl Words for DataFinding {
    fn words(&self) -> String {
        match self {
            Self::TooShort { rows, seconds, needed } => format!(
                "the longest stretch without a gap has {rows} rows ({seconds:.3} s), {needed} are \
                 needed: record longer"
            ),
            Self::Holes { share, gaps, segments } => format!(
                "{:.1} % of the rows lack the position or a force, in {gaps} gaps; what is left is \
                 used in {segments} pieces",
                100.0 * share
            ),
            Self::NoForce => "there is no force: neither force cell nor command has values; \
                              friction cannot be told from the motion alone: record \
                              /stage/force_cell or /stage/force, or name them in a mapping"
                .to_owned(),
            Self::NoMotion { range, noise } => format!(
                "nothing moves: the position stays within {range:.3e} m, of which its noise of \
                 {noise:.3e} m explains all: record a motion"
            ),
            Self::Constant { signal, value } => format!(
                "{signal} is constant ({value}) although the position moves: it is not connected, \
                 or another field carries it"
            ),
            Self::Clipped { signal, value, rows } => format!(
                "{signal} stays at its extreme {value} in {rows} rows and is cut off there: a \
                 range or limit is reached"
            ),
            Self::Stuck { signal, value, seconds, rows } => format!(
                "{signal} stays at {value} for {seconds:.2} s ({rows} rows) while the stage is \
                 driven, and changes from row to row elsewhere: it was cut off there"
            ),
            Self::Outliers { signal, samples, value, seconds } => format!(
                "{signal} is {value:.6e} at {seconds:.4} s, far from what is around it, in \
                 {samples} of the samples in all: a sensor or a line dropped out there"
            ),
            Self::Saturated { largest, limit, rows } => format!(
                "the command reaches {largest:.1} N, the declared motor limits the force to \
                 {limit:.1} N in {rows} rows"
            ),
            Self::NotFinite { signal, samples, total } => format!(
                "{samples} of {total} samples of {signal} are NaN or infinite; they are taken as \
                 missing"
            ),
            Self::Conflicting { signal, samples } => format!(
                "{samples} samples of {signal} have a stamp that another sample with another value \
                 has; the first counts: two sources on one topic (try `stamp: log_time` in a \
                 mapping), or stamps that are too coarse (in a CSV file leave `time` out of the \
                 mapping and give the `rate` of the rows)"
            ),
            Self::Sparse { signal, share } => format!(
                "{signal} has values in {:.1} % of the rows only and does not count as recorded",
                100.0 * share
            ),
            Self::NoForceCell => "there is no force cell: the command counts as the force, and \
                                  motor-side effects cannot be told from carriage-side ones"
                .to_owned(),
            Self::NoCommand => "there is no force command: effects of the motor (cogging, gain, \
                                lag) cannot be seen"
                .to_owned(),
            Self::NoSetpoint => "there is no setpoint: the closed loop cannot be simulated, only \
                                 forces are compared"
                .to_owned(),
            Self::OneSpeed { speed, share } => format!(
                "the carriage moves at one speed only ({speed:.4} m/s for {:.0} % of the time that \
                 it moves): viscous friction cannot be told from Coulomb friction, nor a force \
                 periodic in position from one periodic in time; record at least two speeds, a \
                 factor of 2 apart",
                100.0 * share
            ),
            Self::OneDirection => "the carriage moves in one direction only: friction cannot be \
                                   told from a constant force; record both directions"
                .to_owned(),
            Self::SwappedSign { signal, mass, or_every_force } => format!(
                "{signal} has the wrong sign: force over acceleration gives {mass:.4} kg{}; give \
                 it `scale: -1` in a mapping",
                if *or_every_force { ", unless it is every force that has it" } else { "" }
            ),
            Self::WrongUnit { signal, unit, mass, declared, friction_fits } => format!(
                "{signal} seems to be in {unit}: force over acceleration gives {mass:.4e} kg where \
                 {declared:.4} kg is declared{}; give its unit in a mapping",
                if *friction_fits { ", and Coulomb friction is right" } else { "" }
            ),
            Self::Disagree { first, second, evidence } => {
                let evidence = match evidence {
                    Disagreement::Factor(factor) => format!(
                        "{first} goes with {factor:.4e} times {second}; a sign or a unit of one of \
                         them is wrong"
                    ),
                    Disagreement::Before(times) => format!(
                        "the cell shows each command a sample before it is given, {times:.1} times \
                         as well as a sample behind it: they are swapped, or the stamps of the \
                         command are late"
                    ),
                };
                format!("{first} and {second} do not fit together: {evidence}")
            }
            Self::OtherMachine { declared, measured, deviation } => format!(
                "the model declares {declared:.4} kg, force over acceleration shows {measured:.4} \
                 +- {deviation:.4} kg: another machine, a payload, or a wrong unit (the model's \
                 mass is in kg)"
            ),
            Self::OtherFriction { declared, measured } => format!(
                "the model declares {declared:.2} N of Coulomb friction, a rough fit shows \
                 {measured:.2} N: another machine?"
            ),
            Self::Unrelated { signal, share } => format!(
                "mass, Coulomb and viscous friction explain only {:.0} % of {signal} while moving: \
                 it is not the force on this carriage, or much is missing from the model",
                100.0 * share
            ),
            Self::Noise { signal, unit, present, declared } => format!(
                "{signal} has {present:.3e} {unit} of noise where {declared:.3e} {unit} is \
                 declared: {}",
                consequence_of_noise(*present, *declared)
            ),
            Self::Jitter { jitter, clock } => format!(
                "the stamps of the position jitter by {jitter:.2e} s: {}",
                match clock {
                    ClockKind::UniformBehindJitter => {
                        "the positions are smoother without it, so the samples count as uniform \
                         and are left as they are"
                    }
                    _ => "the positions follow it, so they are interpolated from their stamps",
                }
            ),
            Self::OddRate { rate } => format!(
                "the position is sampled at {rate:.3e} Hz: friction needs 100 Hz to 100 kHz; is \
                 the unit of the time right?"
            ),
        }
    }
}

impl Words for FileFinding {
    fn words(&self) -> String {
        match self {
            Self::Incomplete => {
                "it is cut off or damaged: `friction-stage recover` keeps what is whole".to_owned()
            }
            Self::Damaged => {
                "parts of it are damaged: `friction-stage recover` keeps what is whole".to_owned()
            }
            Self::MessageCount { declared, read } => {
                format!("metadata.yaml counts {declared} messages, {read} can be read")
            }
            Self::NoMetadata => "it has no readable metadata.yaml".to_owned(),
            Self::Undecodable { topic, messages, total, type_name } => {
                format!("{topic}: {messages} of {total} messages do not decode as {type_name}")
            }
            Self::NotFinite { topic, values } => format!("{topic}: {values} values are not finite"),
            Self::BackwardStamps { topic, stamps } => format!("{topic}: {stamps} stamps go back"),
            Self::RepeatedStamps { topic, stamps } => format!("{topic}: {stamps} stamps repeat"),
            Self::Gaps { topic, gaps, longest_s, usual_s } => format!(
                "{topic}: {gaps} gaps, the longest {longest_s:.6} s where {usual_s:.6} s is usual"
            ),
            Self::UnusableModel { reason } => format!("its model cannot be used: {reason}"),
        }
    }
}

impl Words for SignalNote {
    fn words(&self) -> String {
        match self {
            Self::SamePlace { first, second } => format!(
                "the mapping takes {first} and {second} from the same place: is one of them meant?"
            ),
            Self::UnfilledStamps { topic, stamp_ns } => format!(
                "{topic}: all header stamps are {stamp_ns} ns, so the time of recording counts \
                 instead"
            ),
            Self::Integrated => "there is no position: the velocity is integrated, from 0 on, so \
                                 effects over the position drift with its errors"
                .to_owned(),
            Self::UnitOfFile { signal, unit, taken } => format!(
                "the file gives {signal} in {unit}, the mapping neither unit nor scale, so its \
                 numbers are taken in {taken}: say `unit` or `scale`"
            ),
            Self::RowsLeftOut { rows, first_line } => format!(
                "{rows} rows are left out, the first is line {first_line}: cut off, or words at \
                 the end of the table"
            ),
        }
    }
}

/// What can be identified or not, by name.
pub(crate) fn subject(subject: Subject) -> &'static str {
    match subject {
        Subject::Mass => "mass",
        Subject::CoulombFriction => "Coulomb friction",
        Subject::ViscousFriction => "viscous friction",
        Subject::StribeckCurve => "Stribeck curve",
        Subject::BristleStiffness => "bristle stiffness",
        Subject::Asymmetry => "difference between directions",
        Subject::MotorSide => "motor-side effects (cogging, force ripple, gain, lag)",
        Subject::OverPosition => "effects over position",
        Subject::PositionOrTime => "position or time as the cause of a periodic force",
        Subject::StictionAging => "stiction that grows at rest",
        Subject::WarmUp => "warm-up",
        Subject::ClosedLoop => "closed loop",
    }
}

fn held(speeds: &[f64]) -> String {
    if speeds.is_empty() {
        return "none held".to_owned();
    }
    let speeds: Vec<String> = speeds.iter().copied().map(short).collect();
    format!("{} m/s", speeds.join(", "))
}

/// Why something can be identified, or what is missing for it.
impl Words for Judgement {
    fn words(&self) -> String {
        match &self.evidence {
            JudgementBasis::Inertia { acceleration, share, mass, deviation } => format!(
                "acceleration reaches {acceleration:.3} m/s^2 and brings {:.1} % of the force; a \
                 rough fit gives {mass:.4} +- {deviation:.4} kg",
                100.0 * share
            ),
            JudgementBasis::NoForce => "there is no force over a motion".to_owned(),
            JudgementBasis::Reversals { count } if self.subject == Subject::BristleStiffness => {
                format!("{count} reversals pass through pre-sliding")
            }
            JudgementBasis::Reversals { count } => format!("{count} reversals"),
            JudgementBasis::Speeds { fastest, speeds } => {
                format!("velocities up to {fastest:.4} m/s; speeds that are held: {}", held(speeds))
            }
            JudgementBasis::HeldSpeeds { speeds } => {
                format!("speeds that are held: {}", held(speeds))
            }
            JudgementBasis::SlowSpeed { slowest, stribeck_velocity, declared } => {
                let source = if *declared { "" } else { " (assumed: no model declares one)" };
                match slowest {
                    Some(slow) => format!(
                        "it is held at {slow:.2e} m/s, below the Stribeck velocity of \
                         {stribeck_velocity:.1e} m/s{source}"
                    ),
                    None => format!(
                        "no speed below the Stribeck velocity of {stribeck_velocity:.1e} \
                         m/s{source} is held, so only reversals pass through it"
                    ),
                }
            }
            JudgementBasis::Velocities { lowest, highest } => {
                format!("velocities from {lowest:.4} to {highest:.4} m/s")
            }
            JudgementBasis::Forces { cell, command } => match (cell, command) {
                (true, true) => "force cell and command are there",
                (true, false) => "there is no command",
                (false, _) => {
                    "there is no force cell: they cannot be told from carriage-side effects"
                }
            }
            .to_owned(),
            JudgementBasis::Stroke { stroke } => format!(
                "periods up to {:.4} m fit twice into the stroke of {stroke:.4} m",
                0.5 * stroke
            ),
            JudgementBasis::Rests { count, least, largest } => {
                format!("{count} rests of {least:.2} to {largest:.2} s")
            }
            JudgementBasis::NoRest => "the carriage never rests".to_owned(),
            JudgementBasis::Travel { duration_s, distance } => {
                format!("{duration_s:.1} s and {distance:.2} m travelled")
            }
            JudgementBasis::Setpoint { recorded: true } => "the setpoint is there".to_owned(),
            JudgementBasis::Setpoint { recorded: false } => "there is no setpoint".to_owned(),
        }
    }
}

/// A severity as a word before a sentence.
pub(crate) fn severity(severity: Severity) -> &'static str {
    match severity {
        Severity::Fatal => "fatal",
        Severity::Warning => "warning",
    }
}

/// Names of signals, in a row.
pub(crate) fn signals(signals: &[Signal]) -> String {
    signals.iter().map(|signal| signal.name()).collect::<Vec<_>>().join(", ")
}
