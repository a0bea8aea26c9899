//! Words for what is wrong with a file, its signals, and for what they can identify.

use friction_stage_data::quality::{
    DataFinding, DeadEvidence, Disagreement, FileFinding, Judgement, JudgementBasis, Obstacle,
    Severity, Subject,
};
use friction_stage_data::signals::{ClockKind, JointDoubt, Signal, SignalNote};

use friction_stage_core::model::JointType;

use super::{Words, four_digits, short};
use friction_stage_identify::in_digits;

/// A noise above this many declared ones is high, one below its inverse low: as the finding has it.
fn consequence_of_noise(present: f64, declared: f64) -> &'static str {
    if present > declared {
        "the noise floor is higher than the model says; small effects are hidden"
    } else {
        "the signal is filtered, or the declaration is too careful; residuals may be overlooked"
    }
}

impl Words for DataFinding {
    fn words(&self, joint: JointType) -> String {
        let [m, n, kg, speed, rate] = ["m", "N", "kg", "m/s", "m/s^2"].map(|unit| joint.unit(unit));
        match self {
            Self::TooShort { rows, seconds, needed } => format!(
                "the longest stretch without a gap has {rows} rows ({seconds:.3} s), {needed} are \
                 needed: record longer, or at a higher rate"
            ),
            Self::TooBrief { seconds, needed } => format!(
                "the longest stretch without a gap lasts {seconds:.3e} s, {needed} s are needed to \
                 tell a speed: is the unit of the time right?"
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
            Self::ForceUnused => {
                "the force that is recorded cannot be used: a line about the data \
                                  above says why; friction cannot be told from the motion alone"
                    .to_owned()
            }
            Self::Wrapped { signal, jump, rows } => format!(
                "{signal} jumps by {} {m} and moves on, {} times (rows {}): a counter begins again \
                 there; put the turns together before (no key of a mapping does), since speeds, \
                 reversals and friction are wrong until then",
                four_digits(*jump),
                rows.len(),
                first_rows(rows)
            ),
            Self::ImpossibleMotion { speed: at, fastest, acceleration, sharpest } => format!(
                "the motion reaches {} {speed} and {} {rate}, more than {} {speed} or {} {rate} is \
                 expected of no stage: is the unit of the position or of the time right?",
                short(*at),
                short(*acceleration),
                short(*fastest),
                short(*sharpest)
            ),
            Self::NoMotion { range, noise, fastest, rest_speed } => format!(
                "nothing moves: the position remains within {range:.3e} {m} at up to \
                 {fastest:.3e} {speed}, and its noise of {noise:.3e} {m} alone shows up to \
                 {rest_speed:.3e} {speed}: record a motion"
            ),
            Self::Constant { signal, value } => format!(
                "{signal} is constant ({value}) although the position moves: it is not connected, \
                 or another field carries it"
            ),
            Self::Clipped { signal, value, rows } => format!(
                "{signal} stays at its extreme {value} in {rows} rows and is cut off there: a \
                 range or limit is reached"
            ),
            Self::Stuck { signal, value, seconds, rows, evidence, stretches } => {
                let others = match stretches.len() {
                    1 => String::new(),
                    count => format!(", the longest of {count} such stretches"),
                };
                let why = match evidence {
                    DeadEvidence::Silent => "the noise that it has around it is gone",
                    DeadEvidence::Abrupt => {
                        "no stop and no start elsewhere is as abrupt as those there"
                    }
                };
                format!(
                    "{signal} stays at {value} for {seconds:.2} s ({rows} rows{others}), and \
                     {why}: the sensor was dead"
                )
            }
            Self::Outliers { signal, samples, value, seconds } => format!(
                "{signal} is {value:.6e} at {seconds:.4} s, far from what is around it, in \
                 {samples} of the samples in all: a sensor or a line dropped out there"
            ),
            Self::Saturated { largest, limit, rows } => format!(
                "the command reaches {} {n}, the declared motor limits the force to \
                 {} {n} in {rows} rows",
                short(*largest),
                short(*limit)
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
            Self::OneSpeed { speed: at, share } => format!(
                "the carriage moves at one speed only ({} {speed} for {:.0} % of the time that \
                 it moves): viscous friction cannot be told from Coulomb friction, nor a force \
                 periodic in position from one periodic in time; record at least two speeds, a \
                 factor of 2 apart",
                short(*at),
                100.0 * share
            ),
            Self::OneDirection => "the carriage moves in one direction only: friction cannot be \
                                   told from a constant force; record both directions"
                .to_owned(),
            Self::SwappedSign { signal, mass, or_every_force } => format!(
                "{signal} has the wrong sign: force over acceleration gives {} {kg}{}; give \
                 it `scale: -1` in a mapping",
                short(*mass),
                if *or_every_force { ", unless it is every force that has it" } else { "" }
            ),
            Self::WrongUnit { signal, unit, mass, declared, friction_fits } => format!(
                "{signal} seems to be in {unit}: force over acceleration gives {} {kg} where {} \
                 {kg} is declared{}; give its unit in a mapping",
                short(*mass),
                four_digits(*declared),
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
                "the model declares {} {kg}, force over acceleration shows {} {kg}: another \
                 machine, a payload, or a wrong unit (the model's mass is in {kg})",
                four_digits(*declared),
                with_deviation(*measured, *deviation)
            ),
            Self::OtherFriction { declared, measured, deviation } => format!(
                "the model declares {} {n} of Coulomb friction, a rough fit shows {} {n}: another \
                 machine?",
                four_digits(*declared),
                with_deviation(*measured, *deviation)
            ),
            Self::OtherJoint { declared, recorded } => format!(
                "the model has a {} joint, the units of the recording are those of a {} one: say \
                 `joint: {}` in the model, or give `scale` in the mapping",
                declared.name(),
                recorded.name(),
                recorded.name()
            ),
            Self::Unrelated { signal, share } => format!(
                "mass, Coulomb and viscous friction explain only {:.0} % of {signal} while moving: \
                 it is not the force on this carriage, or much is missing from the model",
                100.0 * share
            ),
            Self::Noise { signal, unit, present, declared } => format!(
                "{signal} has {present:.3e} {0} of noise where {declared:.3e} {0} is declared: {1}",
                joint.unit(unit),
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
                "the position is sampled at {} Hz, 100 Hz to 100 kHz show presliding and the \
                 Stribeck curve: {}is the unit of the time right?",
                short(*rate),
                if *rate < 100.0 { "here only friction at held speeds can be seen; " } else { "" }
            ),
        }
    }
}

impl Words for FileFinding {
    fn words(&self, _: JointType) -> String {
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
            Self::NoMetadata => "it has no readable metadata.yaml: its files are taken in the \
                                 order of their numbers; `ros2 bag reindex` writes one"
                .to_owned(),
            Self::TypeByMessages { topic, type_name, fitting } => match fitting.as_slice() {
                [] => format!(
                    "{topic}: neither the file nor metadata.yaml says the type of its messages, \
                     and they fit none of the known types"
                ),
                _ if !type_name.is_empty() => format!(
                    "{topic}: neither the file nor metadata.yaml says the type of its messages; \
                     they are read as {type_name}, which they fit to the last byte"
                ),
                fitting => format!(
                    "{topic}: neither the file nor metadata.yaml says the type of its messages; \
                     they may be {}",
                    fitting.join(" or ")
                ),
            },
            Self::Undecodable { topic, messages, total, type_name } => {
                format!("{topic}: {messages} of {total} messages do not decode as {type_name}")
            }
            Self::NotFinite { topic, values } => format!("{topic}: {values} values are not finite"),
            Self::BackwardStamps { topic, stamps } => format!("{topic}: {stamps} stamps go back"),
            Self::RepeatedStamps { topic, stamps } => format!("{topic}: {stamps} stamps repeat"),
            Self::Gaps { topic, gaps, longest_s, usual_s } => format!(
                "{topic}: {gaps} gaps, the longest {longest_s:.6} s where {usual_s:.6} s is usual"
            ),
            Self::LogTimes { topic, messages, seconds } => format!(
                "{topic}: log times of {messages} messages do not fit their stamps, by up to \
                 {seconds:.1} s: the recording looks longer than it is"
            ),
            Self::UnusableModel { reason } => format!("its model cannot be used: {reason}"),
        }
    }
}

impl Words for SignalNote {
    fn words(&self, _: JointType) -> String {
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
            Self::NoForceConstant => "the force is a current, and nothing says how much force it \
                                      makes (`scale`): forces and masses are multiples of what \
                                      the motor makes of 1 A"
                .to_owned(),
            Self::UnitOfFile { signal, unit, taken } => format!(
                "the file gives {signal} in {unit}, the mapping neither unit nor scale, so its \
                 numbers are taken in {taken}: say `unit` or `scale`"
            ),
            Self::ThousandsInDoubt { signal, is_comma } => {
                let written = if *is_comma { "1,234" } else { "1.234" };
                format!(
                    "{signal}: each number is written as {written} and taken for 1234, while other \
                     columns have another decimal mark: give its `unit` and `scale: 1` where that \
                     is right, `scale: 0.001` where it is 1.234"
                )
            }
            Self::Unconfirmed { marks } => format!(
                "the mapping is as it was proposed, with something to check; take the mark away \
                 once it is right: {}",
                marks.join("; ")
            ),
            Self::RowsLeftOut { rows, first_line } => format!(
                "{rows} rows are left out, the first is line {first_line}: cut off, or words at \
                 the end of the table"
            ),
            Self::NoTimeInCommon { signal, place, samples, during_s, position_s } => format!(
                "{signal} ({place}) has {samples} values from {} s to {} s, the position is \
                 recorded from {} s to {} s: they have no time in common, so their clocks differ \
                 (try `stamp: log_time` in a mapping)",
                during_s[0], during_s[1], position_s[0], position_s[1]
            ),
            Self::NoElement { signal, place, elements, messages } => format!(
                "{signal} has no value: the arrays of {place} have {elements} elements at the most \
                 in {messages} messages, and they count from 0"
            ),
            Self::Joints { place, doubt } => match doubt {
                JointDoubt::Order { index, first, other } => format!(
                    "{place}: element {index} is of joint {first} first and of {other} later: give \
                     `joint` in the mapping and write `[joint]` in place of the number"
                ),
                JointDoubt::Lengths { names, values } => format!(
                    "{place}: there are {names} names for {values} values, so whose they are is \
                     not sure; they are taken in the order of the names"
                ),
                JointDoubt::Twice { joint } => format!(
                    "{place}: joint {joint} is named more than once in a message; the first counts"
                ),
            },
            Self::OnlyPart { samples, recorded } => format!(
                "{samples} samples are read{}: choose others with --from and --to",
                match recorded {
                    Some(recorded) => format!(" of {recorded}"),
                    None => ", and the recording has more".to_owned(),
                }
            ),
        }
    }
}

/// Rows that a sentence lists.
const LISTED: usize = 5;

/// The first of some rows.
fn first_rows(rows: &[usize]) -> String {
    let listed: Vec<String> = rows.iter().take(LISTED).map(usize::to_string).collect();
    let more = if rows.len() > LISTED { ", ..." } else { "" };
    format!("{}{more}", listed.join(", "))
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

fn held(speeds: &[f64], joint: JointType) -> String {
    if speeds.is_empty() {
        return "none held".to_owned();
    }
    let speeds: Vec<String> = speeds.iter().copied().map(short).collect();
    format!("{} {}", speeds.join(", "), joint.unit("m/s"))
}

/// Where a Stribeck velocity comes from, after it.
fn source(declared: bool) -> &'static str {
    if declared { "" } else { " (assumed: no model declares one)" }
}

/// Why something can be identified, or what stands in the way.
impl Words for Judgement {
    fn words(&self, joint: JointType) -> String {
        match &self.answer {
            Ok(basis) => basis_words(self.subject, basis, joint),
            Err(obstacle) => obstacle.words(joint),
        }
    }
}

fn basis_words(subject: Subject, basis: &JudgementBasis, joint: JointType) -> String {
    let [m, kg, speed, rate] = ["m", "kg", "m/s", "m/s^2"].map(|unit| joint.unit(unit));
    match basis {
        JudgementBasis::Inertia { acceleration, share, mass, deviation } => format!(
            "acceleration reaches {} {rate} and brings {:.1} % of the force; a rough \
             fit gives {} {kg}",
            short(*acceleration),
            100.0 * share,
            with_deviation(*mass, *deviation)
        ),
        JudgementBasis::Reversals { count } if subject == Subject::BristleStiffness => {
            format!("{count} reversals pass through pre-sliding")
        }
        JudgementBasis::Reversals { count } => format!("{count} reversals"),
        JudgementBasis::Speeds { fastest, speeds } => {
            format!(
                "velocities up to {} {speed}; speeds that are held: {}",
                short(*fastest),
                held(speeds, joint)
            )
        }
        JudgementBasis::HeldSpeeds { speeds } => {
            format!("speeds that are held: {}", held(speeds, joint))
        }
        JudgementBasis::SlowSpeed { slowest, stribeck_velocity, declared } => format!(
            "it is held at {slowest:.2e} {speed}, below the Stribeck velocity of \
             {stribeck_velocity:.1e} {speed}{}",
            source(*declared)
        ),
        JudgementBasis::Velocities { lowest, highest } => {
            format!("velocities from {} to {} {speed}", short(*lowest), short(*highest))
        }
        JudgementBasis::BothForces => "force cell and command are recorded".to_owned(),
        JudgementBasis::Stroke { stroke } => format!(
            "periods up to {} {m} fit twice into the stroke of {} {m}",
            short(0.5 * stroke),
            short(*stroke)
        ),
        JudgementBasis::Rests { count, least, largest } => {
            format!("{count} rests of {least:.2} to {largest:.2} s")
        }
        JudgementBasis::Travel { duration_s, distance } => {
            format!("{duration_s:.1} s and {} {m} travelled", short(*distance))
        }
        JudgementBasis::Setpoint => "the setpoint is recorded".to_owned(),
    }
}

impl Words for Obstacle {
    fn words(&self, joint: JointType) -> String {
        let [m, speed, rate] = ["m", "m/s", "m/s^2"].map(|unit| joint.unit(unit));
        match self {
            Self::Unusable { code } => {
                format!("the recording is not usable: see the fatal finding `{code}` below")
            }
            Self::NoForce => "there is no force".to_owned(),
            Self::TooSlow { fastest, clear } => format!(
                "velocities up to {} {speed}, too few of them above {} {speed}, where neither the \
                 encoder's noise nor the spring of the bristles passes for motion",
                short(*fastest),
                short(*clear)
            ),
            Self::LittleInertia { acceleration, share } => format!(
                "acceleration reaches {} {rate} only and brings {:.1} % of the force",
                short(*acceleration),
                100.0 * share
            ),
            Self::AccelerationIsNoise { share } => format!(
                "{:.0} % of the mean square of the acceleration are noise of the encoder",
                100.0 * share
            ),
            Self::OneDirection => "all motion is in one direction".to_owned(),
            Self::OneSpeed => "all motion is at one speed".to_owned(),
            Self::NoSlowSpeed { stribeck_velocity, declared } => format!(
                "no speed below the Stribeck velocity of {stribeck_velocity:.1e} {speed}{} is \
                 held, so only reversals pass through it",
                source(*declared)
            ),
            Self::UnknownStribeckVelocity { slowest } => format!(
                "no model declares its Stribeck velocity; {}",
                match slowest {
                    Some(slowest) => {
                        format!("the slowest speed that is held is {} {speed}", short(*slowest))
                    }
                    None => "no speed is held".to_owned(),
                }
            ),
            Self::NoFastSpeed { fastest, stribeck_velocity } => format!(
                "velocities up to {} {speed} only, which is not far above the Stribeck velocity of \
                 {stribeck_velocity:.1e} {speed}",
                short(*fastest)
            ),
            Self::FewReversals { count, needed } => {
                format!("{count} reversals, at least {needed} are needed")
            }
            Self::PreslidingIsNoise { travel, declared, noise } => format!(
                "{} {} {m} of travel, and the encoder has {} {m} of noise: its pre-sliding is \
                 not seen",
                match declared {
                    true => "the model's bristles break away after",
                    false => "at the reversals the force turns within",
                },
                short(*travel),
                short(*noise)
            ),
            Self::NoForceCell => {
                "there is no force cell: they cannot be told from carriage-side effects".to_owned()
            }
            Self::NoCommand => "there is no command".to_owned(),
            Self::NoRest => "the carriage never rests".to_owned(),
            Self::FewRests { count, needed } => {
                format!("{count} rests, at least {needed} are needed")
            }
            Self::RestsAlike { least, largest } => format!(
                "all rests last {least:.2} to {largest:.2} s: some must be much longer than others"
            ),
            Self::Short { duration_s, needed_s } => {
                format!("{duration_s:.1} s only, more than {needed_s:.0} s are needed")
            }
            Self::LittleTravel { distance, needed } => format!(
                "{} {m} travelled only, more than {} {m} are needed",
                short(*distance),
                short(*needed)
            ),
            Self::NoSetpoint => "there is no setpoint".to_owned(),
        }
    }
}

/// A value with its standard deviation, as many digits as the latter makes sense of.
fn with_deviation(value: f64, deviation: f64) -> String {
    let digits = in_digits(value, Some([value - deviation, value + deviation]));
    format!("{digits} +- {}", short(deviation))
}

/// A severity as a word before a sentence.
pub(crate) fn severity(severity: Severity) -> &'static str {
    match severity {
        Severity::Fatal => "fatal",
        Severity::Warning => "warning",
        Severity::Note => "note",
    }
}

/// Names of signals, in a row.
pub(crate) fn signals(signals: &[Signal]) -> String {
    signals.iter().map(|signal| signal.name()).collect::<Vec<_>>().join(", ")
}
