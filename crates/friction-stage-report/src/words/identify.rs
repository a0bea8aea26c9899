//! Words for what a user should know about records, fit and verdict.

use friction_stage_core::model::{CurveSide, JointType};
use friction_stage_core::numerics::rounded;
use friction_stage_core::plant::EffectDescriptor;
use friction_stage_identify::{
    BoundSide, ComparisonNote, FigureOfMerit, IdentifyFinding, ModelComparison, MostPower,
    NominalParameter, PositiveDirection, RecordSide, RecordsError, ResidualLocation, in_digits,
};

use super::{Words, all_words, four_digits, in_prefix};

/// An instant of a record of this length, s, or outside it.
fn instant(at: f64, length: f64) -> String {
    match at {
        _ if at < 0.0 => "before its start".to_owned(),
        _ if at > length => "after its end".to_owned(),
        _ => format!("at {at:.3} s"),
    }
}

/// What happens where a curve over the time jumps by `height` after the value `before`.
fn jump(at: f64, height: f64, before: f64, side: CurveSide, joint: JointType) -> String {
    let [n, kg] = ["N", "kg"].map(|unit| joint.unit(unit));
    let moves = if height > 0.0 { "rises" } else { "falls" };
    let size = four_digits((1e3 * height.abs()).round() / 1e3);
    let part = 100.0 * height.abs() / (1.0 + before);
    let by = match side {
        CurveSide::Carriage => format!("the force on the carriage {moves} by {size} {n}"),
        CurveSide::Motor => format!("the force of the motor {moves} by {size} {n}"),
        CurveSide::Friction => format!("the Coulomb friction {moves} by {part:.1} %"),
        CurveSide::Viscous => format!("the viscous friction {moves} by {part:.1} %"),
        CurveSide::Mass => format!("the moving mass {moves} by {size} {kg}"),
    };
    format!("at {at:.3} s {by}")
}

/// A value with its unit on this joint; the unit "1" is none.
fn with_unit(value: String, unit: &str, joint: JointType) -> String {
    if unit == "1" { value } else { format!("{value} {}", joint.unit(unit)) }
}

/// What is left against the noise of the sensors.
pub(crate) fn times_noise(left: f64, noise_floor: f64) -> String {
    if noise_floor > 0.0 {
        format!("{:.1} times what the noise of the sensors leaves", left / noise_floor)
    } else {
        "more than sensors without any noise leave".to_owned()
    }
}

/// The option that says how far a declared parameter may be from its declaration.
fn tolerance_option(parameter: &str) -> &'static str {
    let is = |one: NominalParameter| one.name() == parameter;
    if is(NominalParameter::Mass) {
        "--mass-tolerance"
    } else if is(NominalParameter::CoulombForce) || is(NominalParameter::ViscousFriction) {
        "--guide-tolerance"
    } else {
        "--presliding-tolerance"
    }
}

/// Where a residual sits, as parts of a sentence.
fn sits(location: &ResidualLocation, joint: JointType) -> String {
    let percent = |share: f64| format!("{} %", four_digits(rounded(100.0 * share, 2)));
    let m = joint.unit("m");
    let mut parts = Vec::new();
    if let Some(MostPower { from, to, .. }) = location.band {
        let (from, to) = (four_digits(rounded(from, 3)), four_digits(rounded(to, 3)));
        parts.push(format!("three quarters of its power is between {from} and {to} Hz"));
    }
    if let Some(MostPower { from, to, share }) = location.time {
        let share = percent(share);
        parts.push(format!(
            "three quarters is between {from:.2} and {to:.2} s, {share} of the time"
        ));
    }
    if let Some([from, to]) = location.event {
        parts.push(format!("nearly all of it is a single event between {from:.2} and {to:.2} s"));
    }
    if let Some(MostPower { from, to, share }) = location.place {
        let (from, to) = (in_prefix(from, &m), in_prefix(to, &m));
        let share = percent(share);
        parts.push(format!("three quarters is from {from} to {to}, {share} of the distance"));
    }
    if let Some(PositiveDirection { power, time }) = location.direction {
        let (power, time) = (percent(power), percent(time));
        parts.push(format!(
            "{power} of its power in motion is in the positive direction, {time} of that time"
        ));
    }
    let correlations = location.correlations.iter();
    let correlations: Vec<String> = correlations
        .map(|one| format!("{:+.2} with the {}", one.correlation, one.signal.name()))
        .collect();
    if !correlations.is_empty() {
        parts.push(format!("its correlation is {}", correlations.join(", ")));
    }
    parts.join("; ")
}

fn telltale(name: &str) -> &'static str {
    EffectDescriptor::find(name).map_or("", |found| found.telltale)
}

fn record(side: RecordSide) -> &'static str {
    match side {
        RecordSide::Train => "train",
        RecordSide::Holdout => "hold-out",
    }
}

impl Words for IdentifyFinding {
    fn words(&self, joint: JointType) -> String {
        let [m, n] = ["m", "N"].map(|unit| joint.unit(unit));
        match self {
            Self::Reading { recording, note } => {
                format!("{}: {}", recording.display(), note.words(joint))
            }
            Self::Data { recording, finding, left_out } => format!(
                "{}: {}{}",
                recording.display(),
                finding.words(joint),
                if *left_out { "; these values are left out" } else { "" }
            ),
            Self::Filled { recording, share, compared: true } => format!(
                "{}: {:.1} % of the rows are filled in for samples that are missing: what these \
                 are off by counts as residual",
                recording.display(),
                100.0 * share
            ),
            Self::Filled { recording, share, compared: false } => format!(
                "{}: {:.2} % of the rows are filled in for samples that are missing: forces are \
                 not compared there",
                recording.display(),
                100.0 * share
            ),
            Self::HiddenRest { record: side, share, count } => format!(
                "{:.1} % of the {} record: the carriage rests within one count of the encoder \
                 ({}) while its friction changes, and nothing shows what the guides \
                 hold until they have slid on: forces are not compared there",
                100.0 * share,
                record(*side),
                in_prefix(*count, &m)
            ),
            Self::NotCommon { signal } => {
                format!("not every recording has {signal}: it is left out of all of them")
            }
            Self::Joined => {
                "several bags of a record are joined one after the other: effects over \
                             time (drift, warm-up, vibration, a map over time) are fitted as if \
                             time ran on from bag to bag"
                    .to_owned()
            }
            Self::PhaseOfRecord { effect } => format!(
                "{effect} counts its phase from the start of a record: the errors on the hold-out \
                 are those with the phase that fits the hold-out best, and the model has that of \
                 the train record"
            ),
            Self::JumpElsewhere { at, length } => format!(
                "the map jumps at another instant of the hold-out, {}: the errors on the hold-out \
                 are those with this one, and the model has that of the train record",
                instant(*at, *length)
            ),
            Self::Slips { effect } => format!(
                "{effect} slips: its amplitude and phase are each record's own, the errors of \
                 either record are those with the ones that fit it best, the closed loop is \
                 simulated without it, and a stage that loads the model shows one example of such \
                 phases; its slip is the one of a few that does best. A ripple of the carriage on \
                 a machine that was homed again between the records looks the same"
            ),
            Self::NoClosedLoop { reason } => {
                format!("no position error, because the closed loop cannot be simulated: {reason}")
            }
            Self::Stopped => "the search was stopped before its end: not every candidate was \
                              tried, and the verdict is that of what was tried"
                .to_owned(),
            Self::Inseparable { effect, rival, correlation } => format!(
                "{effect} and {rival} explain these data equally, their forces are correlated by \
                 {correlation:.4}: all values, the mass among them, hold if it is {effect}; \
                 --next-experiment writes a motion that would separate them where there is one. \
                 What gives {effect} away: {}; {rival}: {}",
                telltale(effect),
                telltale(rival)
            ),
            Self::OneRipple { effect, count } => format!(
                "{count} {effect} of nearly one period stand for guides that differ in theirs: \
                 together they are the ripple, and the values of one are not those of a guide"
            ),
            Self::FewPeriods { effect, periods } => format!(
                "{effect} goes through {periods:.1} periods within the travel: that it repeats is \
                 not shown, a few such ripples add up to any curve over position. A longer travel \
                 would tell"
            ),
            Self::UnexplainedOver { coordinate } => format!(
                "no law of the list explains what is left over {}: an empirical map stands for it, \
                 which holds only where the data have been",
                coordinate.name()
            ),
            Self::MapJumps { at, height, before, side } => {
                format!("the map jumps: {}", jump(*at, *height, *before, *side, joint))
            }
            Self::NoiseAboveDeclared { found, declared, least } => format!(
                "with these sensors, this rate and this motion a machine that is as declared would \
                 leave {} {n} of the hold-out, where the declared noise alone leaves {} {n}: \
                 everything is judged against the former, and an effect shows from about {} {n} \
                 rms on; finer counts or a higher rate show smaller ones",
                four_digits(*found),
                four_digits(*declared),
                four_digits(*least)
            ),
            Self::MoreThanUsual { left, noise_floor, may_be_missing } => format!(
                "what is left of the hold-out, {} {n}, is {}, where a machine that is as declared \
                 leaves 1.0 to 1.2 times as much: up to {} {n} rms may be missing that these data \
                 are too noisy, too coarse or too short to name",
                four_digits(*left),
                times_noise(*left, *noise_floor),
                four_digits(*may_be_missing)
            ),
            Self::LeftOpen { left, noise_floor, open } => format!(
                "what is left of the hold-out, {} {n}, is {}, but after a fit to this train record \
                 {} {n} are open there: fit to a record that also has motions like those of the \
                 hold-out",
                four_digits(*left),
                times_noise(*left, *noise_floor),
                four_digits(*open)
            ),
            Self::OtherBristles {
                parameter,
                found,
                declared,
                unit,
                tolerance,
                left_within_tolerance,
            } => format!(
                "{parameter} is {} {unit}, declared {} {unit} with a tolerance of {:.0} %: within \
                 it the model leaves {} {n} of the hold-out; the identified model has the former",
                four_digits(*found),
                four_digits(*declared),
                100.0 * tolerance,
                four_digits(*left_within_tolerance),
                unit = joint.unit(unit),
            ),
            Self::Unexplained { left, noise_floor } => format!(
                "what is left, {} {n}, is {}, and neither a law of the list nor a map takes \
                 it out of the hold-out: an effect whose phase or state differs between the \
                 records would look like this, or one over the force, as a dead zone or a curved \
                 characteristic of motor or cell",
                four_digits(*left),
                times_noise(*left, *noise_floor)
            ),
            Self::WanderingZero { wander } => format!(
                "the zero of the force cell wanders by {} {n} rms in the hold-out beyond \
                 the law that was found for it, and nothing else is left: the train record cannot \
                 tell how, take the zero before each record",
                four_digits(*wander)
            ),
            Self::RoughLaws { left, noise_floor } => format!(
                "what is left, {} {n}, is {}: the laws that were found hold roughly, and \
                 their values no better than they do",
                four_digits(*left),
                times_noise(*left, *noise_floor)
            ),
            Self::ResidualLocation { record: of, side, left, noise_floor, location } => format!(
                "residual of the laws alone, without a map, on the {} record, {side} side: {} {n}, \
                 {}; {}",
                record(*of),
                four_digits(*left),
                times_noise(*left, *noise_floor),
                sits(location, joint)
            ),
            Self::PartialLaws { effects } => {
                let (explain, them) = match effects.len() {
                    1 => ("explains", "it"),
                    _ => ("explain", "them"),
                };
                format!(
                    "{} {explain} a part only: the identified model is without {them}, the \
                     partial one has {them}",
                    effects.join(", ")
                )
            }
            Self::MostLaws { laws } => format!(
                "no more than {laws} laws are added: there may be further ones; declare those that \
                 are right in --model, and identify again"
            ),
            Self::AtBound { parameter, bound, value, unit, tolerance } => format!(
                "{parameter}{} ended on its {} bound ({}{}): the truth may lie beyond, or another \
                 effect hides in it",
                match *parameter == NominalParameter::SensorShift.name() {
                    true => " (time by which the force readings lag the encoder)",
                    false => "",
                },
                match bound {
                    BoundSide::Lower => "lower",
                    BoundSide::Upper => "upper",
                },
                with_unit(four_digits(*value), unit, joint),
                tolerance.map_or_else(String::new, |share| format!(
                    ", where its tolerance of {} % ends, {}",
                    four_digits(100.0 * share),
                    tolerance_option(parameter)
                ))
            ),
            Self::NotIdentifiable { parameter, value, unit } => format!(
                "{parameter} is not identifiable from these data; {} is where the fit left it",
                with_unit(four_digits(*value), unit, joint)
            ),
            Self::HardlyIdentifiable { parameter, value, unit, half_width, tolerance } => format!(
                "{parameter} is hardly identifiable from these data: {}, known to {:.1} % at the \
                 best, its tolerance is {:.1} % ({})",
                with_unit(
                    in_digits(
                        *value,
                        Some([1.0, -1.0].map(|side| value * (1.0 - side * half_width)))
                    ),
                    unit,
                    joint
                ),
                100.0 * half_width,
                100.0 * tolerance,
                tolerance_option(parameter)
            ),
            Self::Tied { parameter, other, correlation } => format!(
                "{parameter} and {other} are correlated by {correlation:.3}: these data know the \
                 two together better than each of them"
            ),
            Self::MovedRipple { effects, period, phase_shift } => format!(
                "{} with a period of {} is on both records, but shifted by \
                 {phase_shift:.2} rad on the hold-out: with a fixed phase it would make the \
                 hold-out worse, so that it is left out",
                effects.join(" or "),
                in_prefix(*period, &m)
            ),
            Self::Worse { figure, record: side, before, after } => {
                let (figure, unit) = match figure {
                    FigureOfMerit::ForceResidual => ("force residual", n),
                    FigureOfMerit::PositionError => ("closed-loop position error", m),
                };
                format!(
                    "the {figure} on the {} record is worse with the identified model: {} \
                     {unit} against {} {unit}",
                    record(*side),
                    four_digits(*after),
                    four_digits(*before)
                )
            }
            Self::NoSeparatingMotion { effect, rival } => format!(
                "no motion that was tried within the limits separates {effect} from {rival}: allow \
                 more speed, force or stroke, or measure what else tells them apart: {} \
                 ({effect}); {} ({rival})",
                telltale(effect),
                telltale(rival)
            ),
            Self::NoNextExperiment { reason } => format!("no next experiment: {reason}"),
        }
    }
}

impl Words for ComparisonNote {
    fn words(&self, _: JointType) -> String {
        match self {
            Self::Slips => {
                "balls that slip have the amplitude and phase here that fit this record \
                            best, and no part in the closed loop"
                    .to_owned()
            }
            Self::OwnPhase { effect } => {
                format!("{effect} has the phase here that fits this record best")
            }
            Self::OwnJump { at, length } => format!(
                "the map jumps here where that fits this record best, {}",
                instant(*at, *length)
            ),
        }
    }
}

/// What the figures of a comparison take for granted, and why one of them is missing.
pub fn comparison_notes(comparison: &ModelComparison) -> Vec<String> {
    let mut notes = all_words(&comparison.notes, JointType::default());
    if let Err(error) = &comparison.missing_force {
        notes.push(format!("no missing force: {error}"));
    }
    if let Err(error) = &comparison.closed_loop {
        notes.push(format!("no closed loop: {error}"));
    }
    notes
}

/// Why no records can be made of recordings, with the words for what is wrong with their signals.
pub fn records_error(error: &RecordsError, joint: JointType) -> String {
    match error {
        RecordsError::Unusable { path, findings } => format!(
            "nothing can be identified from {}: {}",
            path.display(),
            all_words(findings, joint).join("; ")
        ),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use friction_stage_identify::{MotionSignal, SignalCorrelation};

    #[test]
    fn a_jump_is_told_in_newtons_or_as_a_part_of_the_friction_before_it() {
        let words = |side, height| jump(3.0, height, -0.1, side, JointType::Prismatic);
        for (side, height, expected) in [
            (CurveSide::Friction, -0.18, "at 3.000 s the Coulomb friction falls by 20.0 %"),
            (CurveSide::Viscous, 0.45, "at 3.000 s the viscous friction rises by 50.0 %"),
            (CurveSide::Mass, 1.5, "at 3.000 s the moving mass rises by 1.5 kg"),
            (CurveSide::Motor, -2.5, "at 3.000 s the force of the motor falls by 2.5 N"),
        ] {
            assert_eq!(words(side, height), expected);
        }
        let instants = [-5e-4, 7.25, 19.1].map(|at| instant(at, 19.0));
        assert_eq!(instants, ["before its start", "at 7.250 s", "after its end"]);
    }

    #[test]
    fn a_residual_is_located_in_words() {
        let location = ResidualLocation {
            band: Some(MostPower { from: 35.6, to: 38.4, share: 0.01 }),
            time: Some(MostPower { from: 7.3, to: 7.36, share: 0.003 }),
            event: Some([7.3, 7.5]),
            place: Some(MostPower { from: 0.027, to: 0.033, share: 0.12 }),
            direction: Some(PositiveDirection { power: 0.12, time: 0.5 }),
            correlations: vec![SignalCorrelation {
                signal: MotionSignal::Jerk,
                correlation: -0.894,
            }],
        };
        let finding = IdentifyFinding::ResidualLocation {
            record: RecordSide::Holdout,
            side: "carriage",
            left: 0.57,
            noise_floor: 0.03,
            location,
        };
        assert_eq!(
            finding.words(JointType::Prismatic),
            "residual of the laws alone, without a map, on the hold-out record, carriage side: \
             0.57 N, 19.0 times what the noise of the sensors leaves; three quarters of its power \
             is between 35.6 and 38.4 Hz; three quarters is between 7.30 and 7.36 s, 0.3 % of the \
             time; nearly all of it is a single event between 7.30 and 7.50 s; three quarters is \
             from 27.0 mm to 33.0 mm, 12 % of the distance; 12 % of its power in motion is in the \
             positive direction, 50 % of that time; its correlation is -0.89 with the jerk"
        );
    }
}
