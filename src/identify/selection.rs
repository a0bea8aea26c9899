//! Which effects are there? Forward selection with a refit of everything at each step, judged on held-out data, pruned backwards.

use rayon::prelude::*;

use crate::model::{Coordinate, CurveSide, StageModel};
use crate::plant::effects::ALL;
use crate::plant::{EffectDescriptor, Residual, Samples, Side};

use super::IdentifyError;
use super::curve;
use super::driven::Driven;
use super::fit::{Fitted, correlation_length, fit};
use super::hypothesis::{Hypothesis, Missing, Part, Sides, Tolerances};
use super::measured::{Floor, Measured};

/// Most effects that are added.
const MOST_EFFECTS: usize = 4;
/// What an effect must take off the mean square of train and of hold-out, in squares of the floor of its side. Behind the force cell the
/// model of the motor is exact; on the carriage the measured motion stands for the true one, and guides of which no two are alike leave up to a fifth of a square.
const MOTOR_GAIN: f64 = 0.02;
pub(super) const CARRIAGE_GAIN: f64 = 0.5;
/// Share of what is still explainable on each record that an effect must take out: below it the law only bends towards what it is not.
const LEAST_SHARE: f64 = 0.1;
/// Effects of which there may be several: harmonics of a period, lines of a spectrum.
pub(super) const SEVERAL: [&str; 5] = ["cogging", "force_ripple", "ball_passage", "external_vibration", "encoder_sde"];
/// Share of the best gain that a law with fewer parameters must reach to be preferred.
const SIMPLER: f64 = 0.97;
/// Share of the winner's gain that a rival must reach, with no more parameters, for the two not to be separable.
pub(super) const RIVAL: f64 = 0.985;
/// Share of the explainable residual that a map must take out beyond the laws for the verdict to become unknown.
const UNEXPLAINED: f64 = 0.1;
/// Share of what laws leave, where that is no noise, that a map must take out for the same.
const HALF_OF_THE_REST: f64 = 0.5;
/// Part of what laws leave unexplained that a curve in their place may leave at most: a law says more than a curve of many knots.
const CURVE_ALONE: f64 = 0.5;
/// Floors up to which a residual passes for noise. Recordings with nothing hidden leave 1.0 to 1.2: friction driven along a measured
/// motion costs the rest; a real machine is worth more.
pub const NOISE_LIKE: f64 = 2.0;
/// Share of the squares of a fit from a simpler start below which a later one replaces it.
const BETTER_START: f64 = 0.99;
/// Share of the squares without a law to which one start must come, and above which another comes close to it.
const WORTH_A_LOOK: f64 = 0.7;
const ITERATIONS: usize = 8;

/// Errors of a hypothesis: mean squares of the missing force, N^2.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Errors {
    pub train_motor: f64,
    pub train_carriage: f64,
    pub holdout_motor: f64,
    pub holdout_carriage: f64,
}

impl Errors {
    pub fn train(&self) -> f64 {
        self.train_motor + self.train_carriage
    }

    pub fn holdout(&self) -> f64 {
        self.holdout_motor + self.holdout_carriage
    }
}

/// What became of a candidate in one round.
#[derive(Clone, Debug)]
pub struct Evidence {
    pub round: usize,
    pub name: &'static str,
    pub side: Side,
    /// Parameters that the fit moved.
    pub free: usize,
    pub part: Part,
    pub errors: Errors,
    /// Fall of the mean square with this candidate, N^2.
    pub train_gain: f64,
    pub holdout_gain: f64,
    /// Fall of the mean square of train that as many parameters would take out of what is left by chance, N^2.
    pub chance: f64,
    pub outcome: Outcome,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    Chosen,
    /// Within chance.
    TooSmall,
    /// Another one does better.
    Beaten,
    /// Explains as much as the chosen one.
    Equal,
    /// Chosen, and not needed any more once the others were there.
    Pruned,
}

/// How the search ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    Found,
    None,
    Unknown,
    NotSeparable,
}

/// Result of the search.
#[derive(Clone, Debug)]
pub struct Selection {
    pub verdict: Verdict,
    pub before: Fitted,
    pub after: Fitted,
    pub errors_before: Errors,
    pub errors_after: Errors,
    pub evidence: Vec<Evidence>,
    /// Coordinate of the map, where one was needed.
    pub coordinate: Option<Coordinate>,
    /// For each effect of `after`: the best other candidate of its round with its held-out rms, N.
    pub runners_up: Vec<Option<(&'static str, f64)>>,
    /// Pairs that the data do not tell apart: effect of `after`, rival.
    pub inseparable: Vec<(&'static str, &'static str)>,
    pub floor: Floor,
    pub stopped: bool,
}

/// What the search tells while it runs.
pub trait Watch: Sync {
    /// A line about what is tried now, and the share of the work that is done.
    fn progress(&self, _what: &str, _share: f64) {}
    /// Whether to stop and return what there is.
    fn stopped(&self) -> bool {
        false
    }
}

/// A watch that says nothing and never stops.
pub struct Silent;
impl Watch for Silent {}

fn errors(hypothesis: &Hypothesis, train: &Measured, holdout: &Measured) -> Result<Errors, IdentifyError> {
    let (train_motor, train_carriage) = hypothesis.missing(train, Sides::BOTH)?.squares();
    let (holdout_motor, holdout_carriage) = hypothesis.in_record(holdout)?.missing(holdout, Sides::BOTH)?.squares();
    Ok(Errors { train_motor, train_carriage, holdout_motor, holdout_carriage })
}

/// What `free` parameters take out of the mean square of a residual by chance, N^2, twice over: each its share of the values that are
/// independent of each other. What drifts or wanders has few of them.
fn by_chance(hypothesis: &Hypothesis, free: usize, train: &Measured) -> Result<f64, IdentifyError> {
    let missing = hypothesis.missing(train, Sides::BOTH)?;
    let (motor, carriage) = missing.squares();
    let per_parameter = motor * correlation_length(&missing.motor) + carriage * correlation_length(&missing.carriage);
    Ok(2.0 * free as f64 * per_parameter / train.rows.len() as f64)
}

/// Columns that proposals look at, on the train record.
struct Columns {
    time: Vec<f64>,
    position: Vec<f64>,
    velocity: Vec<f64>,
    acceleration: Vec<f64>,
    command: Vec<f64>,
    friction: Vec<f64>,
    motor: Vec<f64>,
    carriage: Vec<f64>,
    mass: f64,
    /// Of the carriage at every sample, N.
    unfiltered: Vec<f64>,
    /// Encoder at every sample, m.
    encoder: Vec<f64>,
    /// s
    step: f64,
}

impl Columns {
    fn new(hypothesis: &Hypothesis, measured: &Measured) -> Result<Columns, IdentifyError> {
        let driven = hypothesis.driven(measured, Sides::BOTH, &Driven::default())?;
        let missing = hypothesis.missing_of(&driven, measured, Sides::BOTH);
        let motor = if measured.cell.is_some() { missing.motor } else { missing.carriage.clone() };
        Ok(Columns {
            time: measured.at_rows(&measured.time),
            position: measured.at_rows(&measured.position),
            velocity: measured.at_rows(&measured.velocity),
            acceleration: measured.filtered(&measured.acceleration),
            command: measured.filtered(&measured.command),
            friction: measured.filtered(&hypothesis.friction(measured)?),
            motor,
            carriage: missing.carriage,
            mass: hypothesis.mass(),
            unfiltered: hypothesis.missing_at_samples(&driven, measured, Sides::CARRIAGE).carriage,
            encoder: measured.position.clone(),
            step: measured.rate.recip(),
        })
    }

    fn residual(&self, motor: bool) -> Residual<'_> {
        Residual {
            time: &self.time,
            position: &self.position,
            velocity: &self.velocity,
            acceleration: &self.acceleration,
            command: &self.command,
            friction: &self.friction,
            force: if motor { &self.motor } else { &self.carriage },
            mass: self.mass,
            samples: Samples { position: &self.encoder, force: &self.unfiltered, step: self.step },
        }
    }
}

/// Sides that a fit with this effect has to look at beside effects that were found before: what a sensor reads wrong moves with the fit of either
/// side, and one side alone would bend it.
fn sides_of(side: Side, beside: &[Part], has_cell: bool) -> Sides {
    match side {
        _ if has_cell && beside.iter().any(|part| part.side() == Side::Sensor) => Sides::BOTH,
        Side::Motor if has_cell => Sides::MOTOR,
        Side::Motor | Side::Carriage if !has_cell => Sides::BOTH,
        Side::Sensor if has_cell => Sides::BOTH,
        _ => Sides::CARRIAGE,
    }
}

fn threshold(side: Side, has_cell: bool, floor: Floor) -> f64 {
    match side {
        Side::Motor if has_cell => MOTOR_GAIN * floor.motor * floor.motor,
        _ => CARRIAGE_GAIN * floor.carriage * floor.carriage,
    }
}

/// Searches for what the declared model lacks.
pub fn search(
    declared: &StageModel,
    tolerances: Tolerances,
    train: &Measured,
    holdout: &Measured,
    watch: &dyn Watch,
) -> Result<Selection, IdentifyError> {
    let has_cell = train.cell.is_some();
    let floor = holdout.floor(declared);
    watch.progress("fit of the declared model", 0.0);
    let alike = fit(&Hypothesis::new(declared, tolerances)?, train, Sides::BOTH, 15)?;
    let before = with_different_guides(&alike.hypothesis, train)?;
    let errors_before = errors(&before.hypothesis, train, holdout)?;
    let declared_effects = before.hypothesis.effects.len();

    let mut best = before.clone();
    let mut best_errors = errors_before;
    let mut evidence: Vec<Evidence> = Vec::new();
    let mut runners_up: Vec<Option<(&'static str, f64)>> = vec![None; declared_effects];
    let mut inseparable = Vec::new();
    let mut stopped = false;

    for round in 0..MOST_EFFECTS {
        // Differences between the guides stay as they are while candidates are tried: the joint refit moves them.
        let held = best.hypothesis.holding_guides(true);
        let columns = Columns::new(&best.hypothesis, train)?;
        let candidates: Vec<&'static EffectDescriptor> = ALL
            .iter()
            .copied()
            .filter(|candidate| candidate.name != "map")
            .filter(|candidate| {
                SEVERAL.contains(&candidate.name)
                    || best.hypothesis.effects.iter().all(|part| part.descriptor.name != candidate.name)
            })
            .collect();
        let done = std::sync::atomic::AtomicUsize::new(0);
        let tried: Vec<Option<(Evidence, Hypothesis)>> = candidates
            .par_iter()
            .map(|descriptor| -> Result<_, IdentifyError> {
                if watch.stopped() {
                    return Ok(None);
                }
                let share = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) as f64 / candidates.len() as f64;
                watch.progress(&format!("round {}: {}", round + 1, descriptor.name), (round as f64 + share) / 3.0);
                let mut trials: Vec<(Evidence, Hypothesis)> = Vec::new();
                let late = descriptor.parameters.iter().any(|parameter| parameter.name == "delay");
                for on_motor in looks(descriptor.side, late, has_cell) {
                    let Some(values) = (descriptor.propose)(&columns.residual(*on_motor)) else { continue };
                    let part = Part { descriptor, values };
                    let side = part.side();
                    let sides = if late { Sides::BOTH } else { sides_of(side, &held.effects, has_cell) };
                    let starts = starts(&part, train).into_iter().map(|part| held.with(part)).collect();
                    let Some(fitted) = best_start(starts, train, sides, &best.missing) else { continue };
                    let found = errors(&fitted.hypothesis, train, holdout)?;
                    let Some(part) = fitted.hypothesis.effects.last().cloned() else { continue };
                    let free = (0..part.values.len()).filter(|value| (descriptor.free)(&part.values, *value)).count();
                    trials.push((
                        Evidence {
                            round,
                            name: descriptor.name,
                            side,
                            free,
                            part,
                            errors: found,
                            train_gain: best_errors.train() - found.train(),
                            holdout_gain: best_errors.holdout() - found.holdout(),
                            chance: by_chance(&fitted.hypothesis, free, train)?,
                            outcome: Outcome::Beaten,
                        },
                        fitted.hypothesis,
                    ));
                }
                Ok(trials.into_iter().max_by(|a, b| a.0.holdout_gain.total_cmp(&b.0.holdout_gain)))
            })
            .collect::<Result<_, _>>()?;
        if watch.stopped() {
            stopped = true;
            break;
        }
        let mut tried: Vec<(Evidence, Hypothesis)> = tried.into_iter().flatten().collect();
        tried.sort_by(|a, b| b.0.holdout_gain.total_cmp(&a.0.holdout_gain));
        let least_of = |left: f64| LEAST_SHARE * (left - floor.total().powi(2));
        let (least_on_train, least_on_holdout) = (least_of(best_errors.train()), least_of(best_errors.holdout()));
        for (one, _) in &mut tried {
            // Wherever an effect acts: what it explains on the carriage alone is judged as what acts there, and what the cell shows as exactly.
            let on_motor = best_errors.holdout_motor - one.errors.holdout_motor;
            let least = threshold(Side::Motor, has_cell, floor);
            let least = if on_motor < least { threshold(Side::Carriage, has_cell, floor) } else { least };
            if one.holdout_gain < least.max(least_on_holdout)
                || one.train_gain < least.max(least_on_train).max(one.chance)
            {
                one.outcome = Outcome::TooSmall;
            }
        }
        let strongest = tried.iter().find(|(one, _)| one.outcome != Outcome::TooSmall).map(|(one, _)| one.holdout_gain);
        let Some(strongest) = strongest else {
            evidence.extend(tried.into_iter().map(|(one, _)| one));
            break;
        };
        // The simplest law among those that explain about the same.
        let winner = (0..tried.len())
            .filter(|index| {
                let one = &tried[*index].0;
                one.outcome != Outcome::TooSmall && one.holdout_gain >= SIMPLER * strongest
            })
            // Of equals first what acts, then what only reads wrong: the answer must not hang on the last digit.
            .min_by_key(|index| {
                let one = &tried[*index].0;
                (one.free, one.side == Side::Sensor, ALL.iter().position(|listed| listed.name == one.name))
            })
            .unwrap_or(0);
        tried[winner].0.outcome = Outcome::Chosen;
        let (gain, free, name) = (tried[winner].0.holdout_gain, tried[winner].0.free, tried[winner].0.name);
        let mut runner_up: Option<(&'static str, f64)> = None;
        for (index, (one, _)) in tried.iter_mut().enumerate() {
            if index == winner {
                continue;
            }
            if runner_up.is_none() {
                runner_up = Some((one.name, one.errors.holdout().sqrt()));
            }
            let closeness = (one.holdout_gain / gain).min(gain / one.holdout_gain);
            if one.outcome == Outcome::Beaten && closeness >= RIVAL && one.free <= free {
                one.outcome = Outcome::Equal;
                inseparable.push((name, one.name));
            }
        }
        let chosen = tried[winner].1.holding_guides(false);
        evidence.extend(tried.into_iter().map(|(one, _)| one));
        best = with_different_guides(&chosen, train)?;
        best_errors = errors(&best.hypothesis, train, holdout)?;
        runners_up.push(runner_up);
    }

    let is_noise = |left: &Errors| left.holdout() <= (NOISE_LIKE * floor.total()).powi(2);
    // The form of a law was chosen while effects that came later were still in the residual: proposed anew without them.
    for index in declared_effects..best.hypothesis.effects.len() {
        if stopped || is_noise(&best_errors) {
            break;
        }
        let part = &best.hypothesis.effects[index];
        let (descriptor, on_motor) = (part.descriptor, part.side() == Side::Motor && has_cell);
        if starts(part, train).len() < 2 {
            continue;
        }
        watch.progress(&format!("forms of {}", descriptor.name), 0.85);
        let columns = Columns::new(&best.hypothesis.without(index), train)?;
        let Some(values) = (descriptor.propose)(&columns.residual(on_motor)) else { continue };
        let held = best.hypothesis.holding_guides(true);
        let other = |part: Part| {
            let mut other = held.clone();
            other.effects[index] = part;
            other
        };
        let others = starts(&Part { descriptor, values }, train).into_iter().map(other).collect();
        let Some(found) = best_start(others, train, Sides::BOTH, &best.missing) else { continue };
        let found = with_different_guides(&found.hypothesis, train)?;
        if found.squares() < BETTER_START * best.squares() {
            best_errors = errors(&found.hypothesis, train, holdout)?;
            best = found;
        }
    }

    // What is left over one coordinate that no law has?
    let mut coordinate = None;
    let excess = (errors_before.holdout() - floor.total().powi(2)).max(0.0);
    let explained = |left: &Errors| left.holdout() - floor.total().powi(2) <= UNEXPLAINED * excess;
    if !stopped {
        watch.progress("curves over position, velocity and time", 0.9);
        // Where laws leave more than noise, half of that is worth a curve, however little it is of the whole.
        let rest = (best_errors.holdout() - floor.total().powi(2)).max(0.0);
        let little = if is_noise(&best_errors) { f64::INFINITY } else { HALF_OF_THE_REST * rest };
        let least = (UNEXPLAINED * excess).min(little);
        if let Some((with, over)) = with_curve(&best, best_errors, least, train, holdout, floor)? {
            coordinate = Some(over);
            best = with;
            best_errors = errors(&best.hypothesis, train, holdout)?;
            runners_up.push(None);
        }
        // Laws that explain a part each bend towards what is none of them: one curve alone may say it better.
        let laws = best.hypothesis.effects.len() - declared_effects;
        if laws > 0
            && !is_noise(&best_errors)
            && !explained(&best_errors)
            && let Some((alone, over)) = with_curve(&before, errors_before, least, train, holdout, floor)?
        {
            let found = errors(&alone.hypothesis, train, holdout)?;
            let left = |errors: &Errors| errors.holdout() - floor.total().powi(2);
            if left(&found) < CURVE_ALONE * left(&best_errors) {
                (best, best_errors, coordinate) = (alone, found, Some(over));
                for one in evidence.iter_mut().filter(|one| matches!(one.outcome, Outcome::Chosen | Outcome::Equal)) {
                    one.outcome = Outcome::Pruned;
                }
                inseparable.clear();
                runners_up.truncate(declared_effects);
                runners_up.push(None);
            }
        }
    }

    // Backwards: an effect that the others have made superfluous goes.
    let mut index = declared_effects;
    while index < best.hypothesis.effects.len() && best.hypothesis.effects.len() > declared_effects + 1 && !stopped {
        watch.progress("pruning", 0.95);
        let part = &best.hypothesis.effects[index];
        let (name, side) = (part.descriptor.name, part.side());
        let fewer = with_different_guides(&best.hypothesis.without(index), train)?;
        let found = errors(&fewer.hypothesis, train, holdout)?;
        if found.holdout() - best_errors.holdout() < threshold(side, has_cell, floor) {
            for one in evidence.iter_mut().filter(|one| one.name == name && one.outcome == Outcome::Chosen) {
                one.outcome = Outcome::Pruned;
            }
            inseparable.retain(|(chosen, _)| *chosen != name);
            runners_up.remove(index);
            best = fewer;
            best_errors = found;
        } else {
            index += 1;
        }
    }

    // Two laws that are both there are no rivals: each has taken out what the other one could not.
    inseparable.retain(|(_, rival)| best.hypothesis.effects.iter().all(|part| part.descriptor.name != *rival));
    let added = best.hypothesis.effects.len() - declared_effects;
    if !best.hypothesis.effects.iter().any(|part| part.descriptor.name == "map") {
        coordinate = None;
    }
    // Nothing is `none`, and little is `found`, while what is left is not noise.
    let settled = is_noise(&best_errors) || (added > 0 && explained(&best_errors));
    let verdict = if coordinate.is_some() || !settled {
        Verdict::Unknown
    } else if added == 0 {
        Verdict::None
    } else if !inseparable.is_empty() {
        Verdict::NotSeparable
    } else {
        Verdict::Found
    };
    Ok(Selection {
        verdict,
        before,
        after: best,
        errors_before,
        errors_after: best_errors,
        evidence,
        coordinate,
        runners_up,
        inseparable,
        floor,
        stopped,
    })
}

/// The curve over position, velocity or time that takes most out of the hold-out, if that is more than chance and than `least` (N^2), refitted.
fn with_curve(
    start: &Fitted,
    start_errors: Errors,
    least: f64,
    train: &Measured,
    holdout: &Measured,
    floor: Floor,
) -> Result<Option<(Fitted, Coordinate)>, IdentifyError> {
    let has_cell = train.cell.is_some();
    let columns = Columns::new(&start.hypothesis, train)?;
    let mut best: Option<(Hypothesis, f64, Coordinate)> = None;
    for over in [Coordinate::Position, Coordinate::Velocity, Coordinate::Time] {
        for side in [CurveSide::Carriage, CurveSide::Motor, CurveSide::Friction, CurveSide::Viscous] {
            // Friction over velocity is what the guides are fitted for.
            let of_guides = matches!(side, CurveSide::Friction | CurveSide::Viscous) && over == Coordinate::Velocity;
            if side == CurveSide::Motor && !has_cell || of_guides {
                continue;
            }
            let Some((part, _)) = curve::propose(&columns.residual(side == CurveSide::Motor), over, side)? else {
                continue;
            };
            let with = start.hypothesis.with(part);
            let gain = start_errors.holdout() - errors(&with, train, holdout)?.holdout();
            let side = if side == CurveSide::Motor { Side::Motor } else { Side::Carriage };
            if gain > threshold(side, has_cell, floor).max(least) && best.as_ref().is_none_or(|best| gain > best.1) {
                best = Some((with, gain, over));
            }
        }
    }
    best.map(|(with, _, over)| Ok((fit(&with, train, Sides::BOTH, ITERATIONS)?, over))).transpose()
}

/// The fit with guides that differ from each other, from the differences that there are and afresh: the sum of the guides depends
/// on the products of their differences, and what an effect not yet known bent them to is no good start.
fn with_different_guides(start: &Hypothesis, train: &Measured) -> Result<Fitted, IdentifyError> {
    let fitted = |start: &Hypothesis| fit(start, train, Sides::BOTH, ITERATIONS);
    let (best, afresh) = rayon::join(
        || fitted(&start.holding_guides(false)),
        || start.different_guides().map(|afresh| fitted(&afresh)).transpose(),
    );
    let best = best?;
    Ok(afresh?.filter(|one| one.squares() < best.squares()).unwrap_or(best))
}

/// The best fit from several starts, of about equal ones the first. Forms of a law that come close to each other are compared with the guides
/// fitted anew: held as they are, these speak for the form that is most like what they were bent to.
fn best_start(starts: Vec<Hypothesis>, train: &Measured, sides: Sides, without: &Missing) -> Option<Fitted> {
    let squares = |side: &[f64], counts: bool| if counts { side.iter().map(|left| left * left).sum() } else { 0.0 };
    let without: f64 = squares(&without.motor, sides.motor) + squares(&without.carriage, sides.carriage);
    // A law whose values do not go together has lost; it does not end the search.
    let mut fitted: Vec<Fitted> =
        starts.par_iter().filter_map(|start| fit(start, train, sides, ITERATIONS).ok()).collect();
    let least = fitted.iter().map(Fitted::squares).fold(f64::INFINITY, f64::min);
    if least < WORTH_A_LOOK * without {
        fitted.retain(|one| one.squares() * WORTH_A_LOOK < least);
    }
    let mut judged: Vec<(f64, Fitted)> = fitted.into_iter().map(|one| (one.squares(), one)).collect();
    if judged.len() > 1 && least < WORTH_A_LOOK * without {
        judged.par_iter_mut().for_each(|(squares, one)| {
            if let Ok(free) = with_different_guides(&one.hypothesis, train) {
                *squares = free.squares();
            }
        });
    }
    let better = |best: (f64, Fitted), one: (f64, Fitted)| if one.0 < BETTER_START * best.0 { one } else { best };
    judged.into_iter().reduce(better).map(|(_, one)| one)
}

/// What a fit starts from, the simplest form of the law first.
fn starts(part: &Part, measured: &Measured) -> Vec<Part> {
    let descriptor = part.descriptor;
    let mut starts = (descriptor.starts)(&part.values, measured.rate.recip());
    starts.sort_by_key(|values| (0..values.len()).filter(|index| (descriptor.free)(values, *index)).count());
    starts.into_iter().map(|values| Part { descriptor, values }).collect()
}

/// Residuals that a candidate looks at: on the motor side (true) or the carriage side (false). What is late by less than a cycle is there
/// when the cell reads: the carriage alone shows it.
fn looks(side: Side, late: bool, has_cell: bool) -> &'static [bool] {
    match side {
        Side::Motor if late && has_cell => &[true, false],
        Side::Motor => &[true],
        Side::Carriage => &[false],
        Side::Sensor if has_cell => &[true, false],
        Side::Sensor => &[false],
    }
}

impl Selection {
    /// Share of the explainable held-out residual that the added effects take out; 0 where there is nothing to explain.
    pub fn explained_share(&self) -> f64 {
        let floor = self.floor.total().powi(2);
        let explainable = self.errors_before.holdout() - floor;
        if explainable <= 0.0 {
            return 0.0;
        }
        (self.errors_before.holdout() - self.errors_after.holdout()) / explainable
    }
}
