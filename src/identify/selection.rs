//! Which effects are there? Forward selection with a refit of everything at each step, judged on held-out data, pruned backwards.

use rayon::prelude::*;

use crate::model::{Coordinate, CurveSide, StageModel};
use crate::plant::effects::ALL;
use crate::plant::{EffectDescriptor, Residual, Samples, Side};

use super::IdentifyError;
use super::curve::{self, Beside};
use super::declared::Declared;
use super::driven::Driven;
use super::fit::{Effort, Estimate, Fitted, fit, race};
use super::hypothesis::{Hypothesis, Part, Place, Sides, Tolerances};
use super::measured::{Floor, Measured};
use super::uncertainty::correlation_length;
use super::{sensor_noise, slipping};

/// Most effects that are added.
pub const MOST_EFFECTS: usize = 4;
/// What an effect must take off the mean square of train and of hold-out, in squares of the floor of its side. Behind the force cell the
/// model of the motor is exact; on the carriage the measured motion stands for the true one, and guides of which no two are alike leave up to a fifth of a square.
const MOTOR_GAIN: f64 = 0.02;
pub const CARRIAGE_GAIN: f64 = 0.5;
/// How many times that a curve must take: it says less than a law, and of a law that is just too small a curve would tell.
const CURVE_GAIN: f64 = 2.0;
/// Share of what is still explainable on each record that an effect must take out: below it the law only bends towards what it is not.
const LEAST_SHARE: f64 = 0.1;
/// The same on the carriage beside laws that explain nearly all: what is left there is what these are not quite, or nearly all of other effects, of which
/// there are three at most.
const LEAST_SHARE_OF_LITTLE: f64 = 0.25;
/// Effects of which there may be several: harmonics of a period, lines of a spectrum.
pub(super) const SEVERAL: [&str; 5] = ["cogging", "force_ripple", "ball_passage", "external_vibration", "encoder_sde"];
/// Share of the best gain that a law with fewer parameters must reach to be preferred.
const SIMPLER: f64 = 0.97;
/// Share of the winner's gain that a rival must reach, with no more parameters, for the two not to be separable.
pub(super) const RIVAL: f64 = 0.985;
/// Share of the explainable residual that a map must take out beyond the laws for the verdict to become unknown; where it is so already, of what they leave.
const UNEXPLAINED: f64 = 0.1;
/// Share of the explainable residual, and floors of noise, that laws which are the answer may leave, where it is more than noise: right ones left 0.02
/// and 6 floors at most, false ones 0.03 and 38, or 0.09 and 103.
pub const LEFT_AT_MOST: f64 = 0.05;
const FLOORS_AT_MOST: f64 = 15.0;
/// Share of what laws leave, where that is no noise, that a map must take out for the same, and share of what a map leaves that a law beside
/// it must: the rest of a curve of few knots has a shape that many a law bends towards.
const HALF_OF_THE_REST: f64 = 0.5;
/// Part of what laws leave unexplained that a curve in their place may leave at most: a law says more than a curve of many knots.
const CURVE_ALONE: f64 = 0.5;
/// Periods within the travel from which on a ripple has shown that it is one. Assumed.
const LEAST_PERIODS: f64 = 3.0;
/// Slips of balls that are tried, rad/sqrt(m): from one that hardly shows within a record to one that turns the phase within a few strokes.
const SLIPS: [f64; 5] = [0.1, 0.25, 0.35, 0.5, 1.0];
/// Part by which the periods of guides of one type differ at most. Assumed.
const OF_ONE_TYPE: f64 = 0.1;
/// How often a curve is drawn anew at most, and how often laws are looked for beside it.
const MOST_CURVES: usize = 4;
/// Floors up to which a residual passes for noise. Recordings with nothing hidden leave 1.0 to 1.2: friction driven along a measured
/// motion costs the rest; a real machine is worth more.
pub const NOISE_LIKE: f64 = 2.0;
/// Floors that a recording leaves at most when nothing is hidden in it: 1.0 to 1.2 were seen.
const ALL_BUT_NOISE: f64 = 1.3;
/// Tolerance of a guide of which nothing is known.
const ANY_GUIDE: f64 = 9.0;
/// Tolerances beyond which a parameter of sliding is another guide's, whatever else there may be. Assumed.
const FAR: f64 = 3.0;
/// Share of the squares of one fit below which another one is better on the train record.
const BETTER_START: f64 = 0.99;
/// How many times the noise above what was found a fit without one of its effects may leave on the train record while it is worth going on, and how many times
/// that one with another curve in place of an effect: to pass they may leave half of the noise more on the hold-out, or twice as much.
const MANY_TIMES: f64 = 3.0;
/// Share of the squares without a law to which one start must come, and above which another comes close to it.
const WORTH_A_LOOK: f64 = 0.7;
/// The same, with the guides fitted anew, for the fits of several to be brought to their ends.
const WORTH_THE_END: f64 = 0.9;

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
    /// Less than chance, the floor or what is left to explain ask for.
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
    pub after: Estimate,
    pub errors_before: Errors,
    pub errors_after: Errors,
    pub evidence: Vec<Evidence>,
    /// Coordinate of the map, where one was needed.
    pub coordinate: Option<Coordinate>,
    /// For each effect of `after`: the best other candidate of its round with its held-out rms, N.
    pub runners_up: Vec<Option<(&'static str, f64)>>,
    /// Pairs that the data do not tell apart: effect of `after`, rival.
    pub inseparable: Vec<(&'static str, &'static str)>,
    /// Ripples over the position that go through few periods within the travel, with how many.
    pub unproven: Vec<(&'static str, f64)>,
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
fn by_chance(hypothesis: &Hypothesis, free: usize, measured: &Measured) -> Result<f64, IdentifyError> {
    let missing = hypothesis.missing(measured, Sides::BOTH)?;
    let (motor, carriage) = missing.squares();
    let per_parameter = motor * correlation_length(&missing.motor) + carriage * correlation_length(&missing.carriage);
    Ok(2.0 * free as f64 * per_parameter / measured.rows.len() as f64)
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

/// A curve as it is drawn, before anything is fitted anew.
struct DrawnCurve {
    with: Hypothesis,
    over: Coordinate,
    damping: Option<f64>,
    /// Fall of the held-out mean square, N^2.
    gain: f64,
}

/// Searches for what the declared model lacks.
pub fn search(
    declared: &StageModel,
    tolerances: Tolerances,
    train: &Measured,
    holdout: &Measured,
    watch: &dyn Watch,
) -> Result<Selection, IdentifyError> {
    watch.progress("fit of the declared model", 0.0);
    let mut search = Search::new(&Hypothesis::new(declared, tolerances)?, train, holdout, watch)?;
    search.refuse_other_guides(declared, tolerances)?;
    search.add_laws()?;
    if !search.stopped {
        search.choose_forms_anew()?;
        search.add_curve()?;
        // Beside a curve laws show, or change, that what it stands for had hidden; beside these it is another curve. It settles first:
        // a round of all laws costs far more.
        let mut turns = 0;
        while search.coordinate.is_some() {
            search.settle_curve()?;
            turns += 1;
            if turns > MOST_CURVES || !(search.add_laws()? | search.choose_forms_anew()?) {
                break;
            }
        }
    }
    if !search.stopped && search.let_balls_slip()? {
        search.add_laws()?;
        if !search.stopped {
            search.choose_forms_anew()?;
            search.add_curve()?;
            search.settle_curve()?;
        }
    }
    if !search.stopped {
        search.prune()?;
    }
    search.selection()
}

/// A search on its way.
struct Search<'a> {
    train: &'a Measured,
    holdout: &'a Measured,
    watch: &'a dyn Watch,
    floor: Floor,
    before: Fitted,
    errors_before: Errors,
    best: Fitted,
    best_errors: Errors,
    /// Rounds in which candidates were tried, and laws that were added.
    rounds: usize,
    laws: usize,
    evidence: Vec<Evidence>,
    coordinate: Option<Coordinate>,
    /// For each effect the other candidates of its round, the best first, with their held-out rms, N.
    runners_up: Vec<Vec<(&'static str, f64)>>,
    inseparable: Vec<(&'static str, &'static str)>,
    stopped: bool,
}

impl<'a> Search<'a> {
    fn new(
        declared: &Hypothesis,
        train: &'a Measured,
        holdout: &'a Measured,
        watch: &'a dyn Watch,
    ) -> Result<Search<'a>, IdentifyError> {
        let alike = fit(declared, train, Sides::BOTH, Effort::COMPARED)?;
        let before = with_different_guides(&alike.hypothesis, train, Effort::KEPT)?;
        let errors_before = errors(&before.hypothesis, train, holdout)?;
        Ok(Search {
            train,
            holdout,
            watch,
            floor: declared.floor(holdout),
            runners_up: vec![Vec::new(); before.hypothesis.effects.len()],
            best: before.clone(),
            best_errors: errors_before,
            before,
            errors_before,
            rounds: 0,
            laws: 0,
            evidence: Vec::new(),
            coordinate: None,
            inseparable: Vec::new(),
            stopped: false,
        })
    }

    /// Guides whose friction is beyond its tolerance are no effect that a model lacks. Where the declared ones leave more than noise and end on a bound, and
    /// others explain everything, these are the answer, and the search would dress them up as laws.
    fn refuse_other_guides(&self, declared: &StageModel, tolerances: Tolerances) -> Result<(), IdentifyError> {
        let of_friction = |place: Place| matches!(place, Place::Declared(one) if Declared::SLIDING.contains(&one));
        let bent = self
            .before
            .coordinates
            .iter()
            .zip(&self.before.at_bound)
            .any(|(one, bound)| *bound && of_friction(one.place));
        if !bent || self.is_noise(&self.errors_before) {
            return Ok(());
        }
        let wide = Tolerances { guides: ANY_GUIDE, presliding: ANY_GUIDE, ..tolerances };
        let other = fit(&Hypothesis::new(declared, wide)?, self.train, Sides::BOTH, Effort::KEPT)?.hypothesis;
        // Parameters that make no guide are no answer.
        let Ok(stated) = Hypothesis::new(&other.model(), tolerances) else { return Ok(()) };
        let again = fit(&stated, self.train, Sides::BOTH, Effort::COMPARED)?;
        let again = with_different_guides(&again.hypothesis, self.train, Effort::KEPT)?.hypothesis;
        let left = errors(&again, self.train, self.holdout)?;
        let mut farthest = 1.0f64;
        let beyond: Vec<String> = Declared::SLIDING
            .into_iter()
            .filter_map(|one| {
                let value = |hypothesis: &Hypothesis| hypothesis.declared_value(one, self.train.rate);
                let (name, unit) = (one.name(), one.unit());
                let (is, was) = (value(&again), value(&Hypothesis::new(declared, tolerances).ok()?));
                let factor = (is / was).max(was / is);
                // The others show only where a stage hardly moves: what a law does there bends them far.
                if matches!(one, Declared::CoulombForce | Declared::ViscousFriction) {
                    farthest = farthest.max(factor);
                }
                (factor > 1.0 + tolerances.guides)
                    .then(|| format!("{name} is {is:.4} {unit}, declared {was:.4} {unit}"))
            })
            .collect();
        // A law may bend a parameter a little beyond its tolerance, and leaves something then; no law bends it far.
        let all = self.is_all_but_noise(&left);
        let nearly = self.beyond_noise(&left) < UNEXPLAINED * self.beyond_noise(&self.errors_before);
        let other = all || (nearly && farthest > 1.0 + FAR * tolerances.guides);
        if beyond.is_empty() || !other {
            return Ok(());
        }
        let (before, left) = (self.errors_before.holdout().sqrt(), left.holdout().sqrt());
        Err(IdentifyError::OtherGuides {
            beyond: beyond.join("; "),
            tolerance: 100.0 * tolerances.guides,
            before,
            left,
        })
    }

    fn has_cell(&self) -> bool {
        self.train.cell.is_some()
    }

    /// Effects that the model declares: they stand first.
    fn declared_effects(&self) -> usize {
        self.before.hypothesis.effects.len()
    }

    /// Least fall of a mean square on this side, N^2.
    fn threshold(&self, side: Side) -> f64 {
        match side {
            Side::Motor if self.has_cell() => MOTOR_GAIN * self.floor.motor.powi(2),
            _ => CARRIAGE_GAIN * self.floor.carriage.powi(2),
        }
    }

    /// Least fall of the mean square that is worth an effect with whose arrival the errors fall so, N^2. Wherever it acts: what the cell shows is judged as
    /// exactly as the motor, the rest as the carriage.
    fn least_gain(&self, without: &Errors, with: &Errors) -> f64 {
        self.threshold(if self.is_shown_by_cell(without, with) { Side::Motor } else { Side::Carriage })
    }

    fn is_shown_by_cell(&self, without: &Errors, with: &Errors) -> bool {
        let on_motor = without.holdout_motor - with.holdout_motor;
        on_motor > 0.0 && on_motor >= self.threshold(Side::Motor)
    }

    /// What a candidate must take off the mean square of train or hold-out where this is what is left, N^2.
    fn least_of(&self, one: &Evidence, left: f64) -> f64 {
        let share = if self.coordinate.is_some() {
            HALF_OF_THE_REST
        } else if self.is_explained(&self.best_errors) && !self.is_shown_by_cell(&self.best_errors, &one.errors) {
            LEAST_SHARE_OF_LITTLE
        } else {
            LEAST_SHARE
        };
        self.least_gain(&self.best_errors, &one.errors).max(share * (left - self.floor.total().powi(2)))
    }

    fn least_on_train(&self, one: &Evidence) -> f64 {
        self.least_of(one, self.best_errors.train()).max(one.chance)
    }

    fn least_on_holdout(&self, one: &Evidence) -> f64 {
        self.least_of(one, self.best_errors.holdout())
    }

    /// What these errors leave on the hold-out beyond the noise of the sensors, N^2.
    fn beyond_noise(&self, left: &Errors) -> f64 {
        left.holdout() - self.floor.total().powi(2)
    }

    fn is_noise(&self, left: &Errors) -> bool {
        left.holdout() <= (NOISE_LIKE * self.floor.total()).powi(2)
    }

    /// Whether no more is left than where nothing is hidden.
    fn is_all_but_noise(&self, left: &Errors) -> bool {
        left.holdout().sqrt() <= ALL_BUT_NOISE * self.floor.total()
    }

    /// Whether little enough is left for what was found to be the answer.
    fn is_explained(&self, left: &Errors) -> bool {
        leaves_little(left.holdout(), self.errors_before.holdout(), self.floor.total())
    }

    fn take(&mut self, best: Fitted) -> Result<(), IdentifyError> {
        self.best_errors = errors(&best.hypothesis, self.train, self.holdout)?;
        self.best = best;
        Ok(())
    }

    /// Sides that a fit with this effect has to look at beside those that were found before: what a sensor reads wrong moves with the fit of
    /// either side, and one side alone would bend it.
    fn sides_of(&self, side: Side) -> Sides {
        let has_cell = self.has_cell();
        let sensors = self.best.hypothesis.effects.iter().any(|part| part.side() == Side::Sensor);
        match side {
            _ if has_cell && sensors => Sides::BOTH,
            Side::Motor if has_cell => Sides::MOTOR,
            Side::Motor | Side::Carriage if !has_cell => Sides::BOTH,
            Side::Sensor if has_cell => Sides::BOTH,
            _ => Sides::CARRIAGE,
        }
    }

    /// Adds laws one by one while any explains enough; whether there was one.
    fn add_laws(&mut self) -> Result<bool, IdentifyError> {
        let mut added = false;
        while self.laws < MOST_EFFECTS && self.add_one()? {
            added = true;
        }
        Ok(added)
    }

    /// One round: the candidate that explains most is added, if any explains enough.
    fn add_one(&mut self) -> Result<bool, IdentifyError> {
        let mut tried = self.try_all(self.rounds)?;
        self.rounds += 1;
        if self.watch.stopped() {
            self.stopped = true;
            return Ok(false);
        }
        for (one, _) in &mut tried {
            if one.train_gain < self.least_on_train(one) || one.holdout_gain < self.least_on_holdout(one) {
                one.outcome = Outcome::TooSmall;
            }
        }
        let strongest = tried.iter().find(|(one, _)| one.outcome != Outcome::TooSmall).map(|(one, _)| one.holdout_gain);
        let Some(strongest) = strongest else {
            self.evidence.extend(tried.into_iter().map(|(one, _)| one));
            return Ok(false);
        };
        let winner = winner(&tried, strongest);
        tried[winner].0.outcome = Outcome::Chosen;
        let (gain, free, name) = (tried[winner].0.holdout_gain, tried[winner].0.free, tried[winner].0.name);
        let mut others = Vec::new();
        for (index, (one, _)) in tried.iter_mut().enumerate() {
            if index == winner {
                continue;
            }
            others.push((one.name, one.errors.holdout().sqrt()));
            let closeness = (one.holdout_gain / gain).min(gain / one.holdout_gain);
            if one.outcome == Outcome::Beaten && closeness >= RIVAL && one.free <= free {
                one.outcome = Outcome::Equal;
                self.inseparable.push((name, one.name));
            }
        }
        let chosen = tried[winner].1.holding_guides(false);
        let added = &chosen.effects[self.best.hypothesis.effects.len()..];
        for part in added {
            // Ripples that came together are each a row, with what all of them do.
            let row = if *part == tried[winner].0.part { continue } else { tried[winner].0.clone() };
            tried.push((Evidence { part: part.clone(), ..row }, chosen.clone()));
        }
        self.laws += added.len();
        self.runners_up.extend(added.iter().map(|_| others.clone()));
        self.evidence.extend(tried.into_iter().map(|(one, _)| one));
        self.take(with_different_guides(&chosen, self.train, Effort::KEPT)?)?;
        Ok(true)
    }

    /// Every candidate beside what was found, refitted, the best on the hold-out first.
    fn try_all(&self, round: usize) -> Result<Vec<(Evidence, Hypothesis)>, IdentifyError> {
        let columns = Columns::new(&self.best.hypothesis, self.train)?;
        let there = |name: &str| self.best.hypothesis.effects.iter().any(|part| part.descriptor.name == name);
        let candidates: Vec<&'static EffectDescriptor> = ALL
            .iter()
            .copied()
            .filter(|candidate| candidate.name != "map")
            .filter(|candidate| SEVERAL.contains(&candidate.name) || !there(candidate.name))
            .collect();
        let done = std::sync::atomic::AtomicUsize::new(0);
        let tried: Vec<Option<(Evidence, Hypothesis)>> = candidates
            .par_iter()
            .map(|descriptor| {
                if self.watch.stopped() {
                    return Ok(None);
                }
                let share = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) as f64 / candidates.len() as f64;
                let what = format!("round {}: {}", round + 1, descriptor.name);
                self.watch.progress(&what, ((round as f64 + share) / 3.0).min(0.85));
                self.try_one(round, descriptor, &columns)
            })
            .collect::<Result<_, IdentifyError>>()?;
        let mut tried: Vec<(Evidence, Hypothesis)> = tried.into_iter().flatten().collect();
        tried.sort_by(|a, b| b.0.holdout_gain.total_cmp(&a.0.holdout_gain));
        Ok(tried)
    }

    /// One candidate on the side where it explains most; `None` where it proposes nothing.
    fn try_one(
        &self,
        round: usize,
        descriptor: &'static EffectDescriptor,
        columns: &Columns,
    ) -> Result<Option<(Evidence, Hypothesis)>, IdentifyError> {
        // Differences between the guides stay as they are while candidates are tried: the joint refit moves them.
        let held = self.best.hypothesis.holding_guides(true);
        let late = descriptor.parameters.iter().any(|parameter| parameter.name == "delay");
        let mut best: Option<(Evidence, Hypothesis)> = None;
        for on_motor in looks(descriptor.side, late, self.has_cell()) {
            let Some(values) = (descriptor.propose)(&columns.residual(*on_motor)) else { continue };
            let part = Part { descriptor, values };
            let side = part.side();
            let sides = if late { Sides::BOTH } else { self.sides_of(side) };
            let starts = starts(&part, self.train).into_iter().map(|part| held.with(part)).collect();
            let Some(fitted) = self.best_start(starts, sides) else { continue };
            let found = errors(&fitted.hypothesis, self.train, self.holdout)?;
            let Some(part) = fitted.hypothesis.effects.last().cloned() else { continue };
            let mut evidence = self.evidence_of(round, part, side, 1, &fitted.hypothesis, found)?;
            let mut hypothesis = fitted.hypothesis;
            if descriptor.name == slipping::LAW {
                (evidence, hypothesis) = self.of_all_guides(evidence, hypothesis)?;
            }
            if best.as_ref().is_none_or(|(best, _)| evidence.holdout_gain >= best.holdout_gain) {
                best = Some((evidence, hypothesis));
            }
        }
        Ok(best)
    }

    /// The best fit from several starts beside what was found; of about equal ones that which leaves least on the hold-out, and of these the first. Forms of a
    /// law that come close to each other are compared with the guides fitted anew: held as they are, these speak for the form that is most like what they
    /// were bent to.
    fn best_start(&self, starts: Vec<Hypothesis>, sides: Sides) -> Option<Fitted> {
        let (train, without) = (self.train, &self.best.missing);
        let squares = |side: &[f64], counts: bool| if counts { side.iter().map(|left| left * left).sum() } else { 0.0 };
        let without: f64 = squares(&without.motor, sides.motor) + squares(&without.carriage, sides.carriage);
        // A law whose values do not go together has lost; it does not end the search.
        let mut fitted: Vec<Fitted> =
            race(&starts, train, sides, Effort::COMPARED, WORTH_A_LOOK.recip()).into_iter().flatten().collect();
        let least = fitted.iter().map(Fitted::squares).fold(f64::INFINITY, f64::min);
        if least < WORTH_A_LOOK * without {
            fitted.retain(|one| one.squares() * WORTH_A_LOOK < least);
        }
        let floor = fitted.first().map_or(Floor { motor: 0.0, carriage: 0.0 }, |one| one.hypothesis.floor(train));
        let floor =
            if sides.motor { floor.motor } else { 0.0 }.hypot(if sides.carriage { floor.carriage } else { 0.0 });
        let noise = train.rows.len() as f64 * (ALL_BUT_NOISE * floor).powi(2);
        // Squares, the start as it was fitted, and the same with guides that differ afresh and go on.
        let afresh = |one: &Hypothesis| one.different_guides().unwrap_or_else(|| one.clone());
        let mut judged: Vec<(f64, Fitted, Hypothesis)> =
            fitted.into_iter().map(|one| (one.squares(), one.clone(), afresh(&one.hypothesis))).collect();
        for effort in [Effort::COMPARED, Effort::KEPT] {
            if judged.len() < 2 || least > WORTH_A_LOOK * without {
                break;
            }
            let free: Vec<Hypothesis> = judged.iter().map(|(.., free)| free.clone()).collect();
            let further = race(&free, train, sides, effort, WORTH_THE_END.recip());
            for ((squares, _, free), further) in judged.iter_mut().zip(further) {
                if let Ok(further) = further {
                    *squares = squares.min(further.squares());
                    *free = further.hypothesis;
                }
            }
            let mut order: Vec<f64> = judged.iter().map(|(squares, ..)| *squares).collect();
            order.sort_by(f64::total_cmp);
            // Where one leaves no more than noise, the end of the fits is noise too.
            if order[0] <= noise {
                break;
            }
            // The two best, if they come close to each other.
            judged.retain(|(squares, ..)| *squares <= order[1] && squares * WORTH_THE_END < order[0]);
        }
        let least = judged.iter().map(|(squares, ..)| *squares).fold(f64::INFINITY, f64::min);
        judged.retain(|(squares, ..)| BETTER_START * squares <= least);
        let mut best: Option<(f64, Fitted)> = None;
        for (_, one, _) in judged {
            let Ok(found) = errors(&one.hypothesis, train, self.holdout) else { continue };
            let left = found.holdout();
            if best.as_ref().is_none_or(|(least, _)| left < SIMPLER * least) {
                best = Some((left, one));
            }
        }
        best.map(|(_, one)| one)
    }

    /// Evidence of a candidate that adds the last `count` effects of a hypothesis, all of the same law.
    fn evidence_of(
        &self,
        round: usize,
        part: Part,
        side: Side,
        count: usize,
        hypothesis: &Hypothesis,
        errors: Errors,
    ) -> Result<Evidence, IdentifyError> {
        let free_of =
            |part: &Part| (0..part.values.len()).filter(|value| (part.descriptor.free)(&part.values, *value)).count();
        let free = hypothesis.effects.iter().rev().take(count).map(free_of).sum();
        Ok(Evidence {
            round,
            name: part.descriptor.name,
            side,
            free,
            part,
            errors,
            train_gain: self.best_errors.train() - errors.train(),
            holdout_gain: self.best_errors.holdout() - errors.holdout(),
            chance: by_chance(hypothesis, free, self.train)?,
            outcome: Outcome::Beaten,
        })
    }

    /// Guides whose periods differ a little beat, and the ripple of one of them that fits the train record does not fit the hold-out. Where it is so, the
    /// fewest ripples at once that do, as far as effects may be added.
    fn of_all_guides(&self, one: Evidence, with: Hypothesis) -> Result<(Evidence, Hypothesis), IdentifyError> {
        if one.train_gain < self.least_on_train(&one) || one.holdout_gain >= self.least_on_holdout(&one) {
            return Ok((one, with));
        }
        let (descriptor, round, side) = (one.part.descriptor, one.round, one.side);
        let mut groups: Vec<(Evidence, Hypothesis)> = Vec::new();
        let mut last = with.clone();
        for count in 2..=MOST_EFFECTS - self.laws {
            if self.watch.stopped() {
                break;
            }
            let columns = Columns::new(&last, self.train)?;
            let Some(values) = (descriptor.propose)(&columns.residual(side == Side::Motor)) else { break };
            let next = last.with(Part { descriptor, values });
            let Ok(fitted) = fit(&next, self.train, self.sides_of(side), Effort::COMPARED) else { break };
            last = fitted.hypothesis;
            let group = &last.effects[last.effects.len() - count..];
            if !are_of_one_type(group) {
                break;
            }
            let found = errors(&last, self.train, self.holdout)?;
            let evidence = self.evidence_of(round, group[0].clone(), side, count, &last, found)?;
            if evidence.train_gain >= self.least_on_train(&evidence)
                && evidence.holdout_gain >= self.least_on_holdout(&evidence)
            {
                groups.push((evidence, last.clone()));
            }
        }
        let most = groups.iter().map(|(group, _)| group.holdout_gain).fold(0.0, f64::max);
        let fewest = groups.into_iter().find(|(group, _)| group.holdout_gain >= SIMPLER * most);
        Ok(fewest.unwrap_or((one, with)))
    }

    /// The form of a law was chosen while effects that came later were still in the residual: where more than noise is left, it is proposed anew
    /// without them. Whether that changed one.
    fn choose_forms_anew(&mut self) -> Result<bool, IdentifyError> {
        let mut changed = false;
        for index in self.declared_effects()..self.best.hypothesis.effects.len() {
            if self.is_all_but_noise(&self.best_errors) {
                break;
            }
            let part = &self.best.hypothesis.effects[index];
            let (descriptor, on_motor) = (part.descriptor, part.side() == Side::Motor && self.has_cell());
            self.watch.progress(&format!("forms of {}", descriptor.name), 0.85);
            let columns = Columns::new(&self.best.hypothesis.without(index), self.train)?;
            let Some(values) = (descriptor.propose)(&columns.residual(on_motor)) else { continue };
            let starts = starts(&Part { descriptor, values }, self.train);
            if starts.len() < 2 {
                continue;
            }
            let held = self.best.hypothesis.holding_guides(true);
            let other = |part: Part| {
                let mut other = held.clone();
                other.effects[index] = part;
                other
            };
            let Some(found) = self.best_start(starts.into_iter().map(other).collect(), Sides::BOTH) else { continue };
            let worth = self.best.squares() / BETTER_START;
            let found = with_different_guides(&found.hypothesis, self.train, Effort::KEPT.worth_below(worth))?;
            let found_errors = errors(&found.hypothesis, self.train, self.holdout)?;
            // On the train record clearly better, or as good and clearly better on the hold-out.
            let half = HALF_OF_THE_REST * self.beyond_noise(&self.best_errors);
            let least = if self.beyond_noise(&found_errors) < half { BETTER_START.recip() } else { BETTER_START };
            if found.squares() < least * self.best.squares() && found_errors.holdout() < self.best_errors.holdout() {
                (self.best, self.best_errors) = (found, found_errors);
                changed = true;
            }
        }
        Ok(changed)
    }

    /// What is left over one coordinate that no law has?
    fn add_curve(&mut self) -> Result<(), IdentifyError> {
        self.watch.progress("curves over position, velocity and time", 0.9);
        // Where laws leave more than noise, half of that is worth a curve, however little it is of the whole; where they are no answer, less is.
        let rest = self.beyond_noise(&self.best_errors).max(0.0);
        let of_the_rest = match (self.is_noise(&self.best_errors), self.is_explained(&self.best_errors)) {
            (true, _) => f64::INFINITY,
            (false, true) => HALF_OF_THE_REST,
            (false, false) => UNEXPLAINED,
        };
        let least = (UNEXPLAINED * self.beyond_noise(&self.errors_before).max(0.0)).min(of_the_rest * rest);
        if let Some((with, over)) = self.with_curve(&self.best.hypothesis, &self.best_errors, least, Effort::KEPT)? {
            self.runners_up.push(Vec::new());
            self.coordinate = Some(over);
            self.take(with)?;
        }
        // Laws that explain a part each bend towards what is none of them: one curve alone may say it better.
        let laws = self.best.hypothesis.effects.len() - self.declared_effects();
        let unexplained = !self.is_noise(&self.best_errors) && !self.is_explained(&self.best_errors);
        if laws > 0
            && (unexplained || !self.unproven_ripples().is_empty())
            && let Some((alone, over)) =
                self.with_curve(&self.before.hypothesis, &self.errors_before, least, Effort::KEPT)?
        {
            let found = errors(&alone.hypothesis, self.train, self.holdout)?;
            if self.beyond_noise(&found) < CURVE_ALONE * self.beyond_noise(&self.best_errors) {
                (self.best, self.best_errors, self.coordinate) = (alone, found, Some(over));
                let kept = |one: &&mut Evidence| matches!(one.outcome, Outcome::Chosen | Outcome::Equal);
                self.evidence.iter_mut().filter(kept).for_each(|one| one.outcome = Outcome::Pruned);
                self.inseparable.clear();
                self.runners_up.truncate(self.declared_effects());
                self.runners_up.push(Vec::new());
            }
        }
        Ok(())
    }

    /// Laws that were added which repeat over the position, and hardly do so in this record, with how often they do: a few of these add up to any curve.
    fn unproven_ripples(&self) -> Vec<(&'static str, f64)> {
        let (from, to) = crate::range(&self.train.position);
        let added = self.best.hypothesis.effects[self.declared_effects()..].iter();
        let ripples = added
            .filter(|part| SEVERAL.contains(&part.descriptor.name))
            .filter_map(|part| Some((part.descriptor.name, (to - from) / part.value_of("period")?)));
        ripples.filter(|(_, periods)| *periods < LEAST_PERIODS).collect()
    }

    /// Draws the curve anew while that is worth it.
    fn settle_curve(&mut self) -> Result<(), IdentifyError> {
        for _ in 0..MOST_CURVES {
            if self.watch.stopped() || !self.draw_curve_anew()? {
                break;
            }
        }
        Ok(())
    }

    /// Where the curve stands that the search has added; one that the model declares is not for it to change.
    fn curve(&self) -> Option<usize> {
        let last = self.best.hypothesis.effects.iter().rposition(|part| part.descriptor.name == "map");
        last.filter(|index| *index >= self.declared_effects())
    }

    /// Takes a fit with another curve, which stands last there, in place of the one that stands at `index`.
    fn replace_curve(&mut self, index: usize, with: Fitted, over: Coordinate) -> Result<(), IdentifyError> {
        self.runners_up.remove(index);
        self.runners_up.push(Vec::new());
        self.coordinate = Some(over);
        self.take(with)
    }

    /// The curve once more, of what is left without it; whether that is worth going on.
    fn draw_curve_anew(&mut self) -> Result<bool, IdentifyError> {
        let Some(index) = self.curve() else { return Ok(false) };
        self.watch.progress("the curve once more", 0.92);
        let without = self.best.hypothesis.without(index);
        let left = errors(&without, self.train, self.holdout)?;
        let Some((with, over)) = self.with_curve(&without, &left, 0.0, Effort::KEPT)? else { return Ok(false) };
        let found = errors(&with.hypothesis, self.train, self.holdout)?;
        let (now, before) = (self.beyond_noise(&found), self.beyond_noise(&self.best_errors));
        if now < before {
            self.replace_curve(index, with, over)?;
        }
        Ok(now < (1.0 - UNEXPLAINED) * before && !self.is_noise(&found))
    }

    /// The curve over position, velocity or time that takes most out of the hold-out, if that is more than chance, and with everything refitted more than `least` (N^2).
    fn with_curve(
        &self,
        start: &Hypothesis,
        start_errors: &Errors,
        least: f64,
        effort: Effort,
    ) -> Result<Option<(Fitted, Coordinate)>, IdentifyError> {
        let drawn = self.drawn_curves(start, start_errors)?;
        // The best one of each damping: moves are far from linear, so that one that is better at first need not be the better one.
        let fitted = curve::DAMPINGS.par_iter().filter_map(|damping| {
            let alike = drawn.iter().filter(|one| one.damping == *damping);
            let one = alike.max_by(|one, other| one.gain.total_cmp(&other.gain))?;
            let fitted = || -> Result<_, IdentifyError> {
                let fitted = fit(&one.with, self.train, Sides::BOTH, effort)?;
                let left = errors(&fitted.hypothesis, self.train, self.holdout)?.holdout();
                Ok((fitted, start_errors.holdout() - left, one.over))
            };
            Some(fitted())
        });
        let fitted = fitted.collect::<Result<Vec<_>, _>>()?.into_iter();
        let best = fitted.filter(|(_, gain, _)| *gain > least).max_by(|one, other| one.1.total_cmp(&other.1));
        Ok(best.map(|(fitted, _, over)| (fitted, over)))
    }

    /// Curves over everything that there is, those that take more than chance out of the hold-out.
    fn drawn_curves(&self, start: &Hypothesis, start_errors: &Errors) -> Result<Vec<DrawnCurve>, IdentifyError> {
        let columns = Columns::new(start, self.train)?;
        let (nothing, moving) = (Beside::nothing(self.train.rows.len()), Beside::of(start, self.train)?);
        let sides = [CurveSide::Carriage, CurveSide::Motor, CurveSide::Friction, CurveSide::Viscous];
        let mut sought: Vec<(Coordinate, CurveSide)> = [Coordinate::Position, Coordinate::Velocity, Coordinate::Time]
            .into_iter()
            .flat_map(|over| sides.map(|side| (over, side)))
            .collect();
        sought.retain(|(over, side)| match side {
            CurveSide::Motor => self.has_cell(),
            // Friction over velocity is what the guides are fitted for.
            CurveSide::Friction | CurveSide::Viscous => *over != Coordinate::Velocity,
            CurveSide::Carriage => true,
        });
        let drawn = sought.into_par_iter().map(|(over, side)| -> Result<Vec<DrawnCurve>, IdentifyError> {
            // Behind the cell nothing of the carriage moves.
            let on_motor = side == CurveSide::Motor;
            let (beside, at) = if on_motor { (&nothing, Side::Motor) } else { (&moving, Side::Carriage) };
            let drawn = curve::propose(&columns.residual(on_motor), over, side, beside)?;
            let worth = drawn.into_iter().filter_map(|one| {
                let mut with = start.with(one.part);
                one.moved.iter().for_each(|coordinate| with.set(coordinate.place, coordinate.value));
                // Values that do not go together are no curve.
                let left = errors(&with, self.train, self.holdout).ok()?.holdout();
                let gain = start_errors.holdout() - left;
                let worth = gain > CURVE_GAIN * self.threshold(at);
                worth.then_some(DrawnCurve { with, over, damping: one.damping, gain })
            });
            Ok(worth.collect())
        });
        Ok(drawn.collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect())
    }

    /// Where more than noise is left: is it a ripple on the carriage whose phase each record has for itself? Such a ripple is granted more than any law, so
    /// that it comes after all of them and after the curves. Whether there is one. Without a cell nobody could tell it from a ripple of the motor on a machine that was homed anew.
    fn let_balls_slip(&mut self) -> Result<bool, IdentifyError> {
        if !self.has_cell() || self.is_noise(&self.best_errors) {
            return Ok(false);
        }
        // What passed for one with a fixed phase, or for a curve, goes: this would be in their place.
        let goes = |part: &Part| ["map", slipping::LAW].contains(&part.descriptor.name);
        let mut with = self.best.hypothesis.holding_guides(true);
        for index in (self.declared_effects()..with.effects.len()).rev() {
            if goes(&with.effects[index]) {
                with = with.without(index);
            }
        }
        let others = with.effects.len();
        let mut left = errors(&with, self.train, self.holdout)?;
        let mut evidence = Vec::new();
        let mut slips = SLIPS.to_vec();
        while with.effects.len() < self.declared_effects() + MOST_EFFECTS {
            if self.watch.stopped() {
                self.stopped = true;
                return Ok(false);
            }
            self.watch.progress(&format!("balls that slip, ripple {}", evidence.len() + 1), 0.93);
            let Some((part, slip, share)) = self.slipping_ripple(&with, &slips)? else { break };
            // The guides are of one type.
            slips = vec![slip];
            let fitted = fit(&with.with(part.clone()), self.train, self.sides_of(Side::Carriage), Effort::COMPARED)?;
            let found = errors(&fitted.hypothesis, self.train, self.holdout)?;
            let before = with.own_numbers(self.train);
            let free = 1 + fitted.hypothesis.own_numbers(self.train).saturating_sub(before);
            let mut one = Evidence {
                round: self.rounds + evidence.len(),
                name: part.descriptor.name,
                side: part.side(),
                free,
                part,
                errors: found,
                train_gain: left.train() - found.train(),
                holdout_gain: left.holdout() - found.holdout(),
                chance: by_chance(&fitted.hypothesis, free, self.train)?,
                outcome: Outcome::Chosen,
            };
            let least_of =
                |left: f64| (LEAST_SHARE * (left - self.floor.total().powi(2))).max(self.threshold(Side::Carriage));
            let is_enough = share >= LEAST_SHARE
                && one.holdout_gain >= least_of(left.holdout())
                && one.train_gain >= least_of(left.train()).max(one.chance);
            if !is_enough {
                one.outcome = Outcome::TooSmall;
            }
            evidence.push(one);
            if !is_enough {
                break;
            }
            (with, left) = (fitted.hypothesis, found);
        }
        if with.effects.len() == others {
            return Ok(false);
        }
        let fitted = with_different_guides(&with.holding_guides(false), self.train, Effort::KEPT)?;
        let found = errors(&fitted.hypothesis, self.train, self.holdout)?;
        if self.beyond_noise(&found) > HALF_OF_THE_REST * self.beyond_noise(&self.best_errors) {
            return Ok(false);
        }
        for index in (self.declared_effects()..self.best.hypothesis.effects.len()).rev() {
            if goes(&self.best.hypothesis.effects[index]) {
                self.strike(index);
                self.best.hypothesis = self.best.hypothesis.without(index);
            }
        }
        self.coordinate = None;
        self.rounds += evidence.len();
        self.evidence.extend(evidence);
        self.runners_up.resize(fitted.hypothesis.effects.len(), Vec::new());
        self.laws = fitted.hypothesis.effects.len() - self.declared_effects();
        self.take(fitted)?;
        Ok(true)
    }

    /// The ripple with a phase of each record's own that takes most out of the hold-out along the way, with the smallest of `slips` that does about as well, that, and the share
    /// it takes; its period is that of the train record.
    fn slipping_ripple(&self, beside: &Hypothesis, slips: &[f64]) -> Result<Option<(Part, f64, f64)>, IdentifyError> {
        let train = beside.missing(self.train, Sides::CARRIAGE)?.carriage;
        let holdout = beside.in_record(self.holdout)?.missing(self.holdout, Sides::CARRIAGE)?.carriage;
        let mut best: Option<(Part, f64, f64)> = None;
        for slip in slips {
            if self.watch.stopped() {
                break;
            }
            let Some(part) = slipping::strongest(&train, self.train, *slip)? else { continue };
            let share = slipping::share_along_the_way(&holdout, self.holdout, &part);
            if best.as_ref().is_none_or(|(.., best)| SIMPLER * share > *best) {
                best = Some((part, *slip, share));
            }
        }
        Ok(best)
    }

    /// Backwards: an effect that the others have made superfluous goes.
    fn prune(&mut self) -> Result<(), IdentifyError> {
        // The laws without the curve, with where it stands, for as long as nothing else changes.
        let mut alone: Option<(usize, Fitted, Errors)> = None;
        let mut index = self.declared_effects();
        while index < self.best.hypothesis.effects.len() {
            self.watch.progress("pruning", 0.95);
            if let (None, Some(curve)) = (&alone, self.curve()) {
                let (laws, left) = self.without(curve, Effort::KEPT)?;
                alone = Some((curve, laws, left));
            }
            let superfluous = Effort::KEPT.worth_below(self.best.squares() + MANY_TIMES * self.noise_squares());
            let (fewer, found) = match &alone {
                Some((curve, laws, left)) if *curve == index => (laws.clone(), *left),
                _ => self.without(index, superfluous)?,
            };
            if found.holdout() - self.best_errors.holdout() < self.least_gain(&found, &self.best_errors) {
                self.strike(index);
                (self.best, self.best_errors) = (fewer, found);
                alone = None;
                continue;
            }
            if let Some((curve, _, left)) = alone.as_ref().filter(|(curve, ..)| *curve != index)
                && let Some((with, over)) = self.with_curve_in_place_of(index, *curve, left)?
            {
                let curve = curve - usize::from(*curve > index);
                self.strike(index);
                self.replace_curve(curve, with, over)?;
                alone = None;
            } else {
                index += 1;
            }
        }
        Ok(())
    }

    /// Squares that noise leaves on the train record, N^2.
    fn noise_squares(&self) -> f64 {
        self.train.rows.len() as f64 * self.floor.total().powi(2)
    }

    /// What was found, fitted without one of its effects.
    fn without(&self, index: usize, effort: Effort) -> Result<(Fitted, Errors), IdentifyError> {
        let fewer = if self.best.hypothesis.effects.len() == self.declared_effects() + 1 {
            self.before.clone()
        } else {
            with_different_guides(&self.best.hypothesis.without(index), self.train, effort)?
        };
        let left = errors(&fewer.hypothesis, self.train, self.holdout)?;
        Ok((fewer, left))
    }

    /// A curve stands for what a law beside it has left: without that law it is another one. The fit with that one in place of both, if the law does not take
    /// as much of what it leaves as one that comes beside a curve must, and the laws alone leave far more: such a law was bent towards what none of them is.
    fn with_curve_in_place_of(
        &self,
        law: usize,
        curve: usize,
        alone: &Errors,
    ) -> Result<Option<(Fitted, Coordinate)>, IdentifyError> {
        let bare = self.best.hypothesis.without(law.max(curve)).without(law.min(curve));
        let left = errors(&bare, self.train, self.holdout)?;
        let effort = Effort::KEPT.worth_below(MANY_TIMES * (self.best.squares() + self.noise_squares()));
        let Some((with, over)) = self.with_curve(&bare, &left, 0.0, effort)? else { return Ok(None) };
        let found = errors(&with.hypothesis, self.train, self.holdout)?;
        let least = self.least_gain(&found, &self.best_errors).max(HALF_OF_THE_REST * self.beyond_noise(&found));
        let is_bent = found.holdout() - self.best_errors.holdout() < least
            && self.beyond_noise(&found) < CURVE_ALONE * self.beyond_noise(alone);
        Ok(is_bent.then_some((with, over)))
    }

    /// Notes in the evidence that an effect goes, before it does.
    fn strike(&mut self, index: usize) {
        let name = self.best.hypothesis.effects[index].descriptor.name;
        // Of several of a name the one that stands there: they were added in this order.
        let alike = |part: &Part| part.descriptor.name == name;
        let before = &self.best.hypothesis.effects[self.declared_effects()..];
        let place = before[..index - self.declared_effects()].iter().filter(|part| alike(part)).count();
        let mut chosen = self.evidence.iter_mut().filter(|one| one.name == name && one.outcome == Outcome::Chosen);
        if let Some(one) = chosen.nth(place) {
            one.outcome = Outcome::Pruned;
            let round = one.round;
            let in_round = |one: &Evidence, outcome: Outcome| one.round == round && one.outcome == outcome;
            // Of ripples that came together others may stay.
            if !self.evidence.iter().any(|one| in_round(one, Outcome::Chosen)) {
                let equals = self.evidence.iter_mut().filter(|one| in_round(one, Outcome::Equal));
                equals.for_each(|one| one.outcome = Outcome::Beaten);
            }
        }
        if before.iter().filter(|part| alike(part)).count() == 1 {
            self.inseparable.retain(|(chosen, _)| *chosen != name);
        }
        self.runners_up.remove(index);
    }

    fn selection(mut self) -> Result<Selection, IdentifyError> {
        self.best.hypothesis = self.best.hypothesis.with_own_amplitudes(self.declared_effects(), self.train)?;
        let there = |name: &str| self.best.hypothesis.effects.iter().any(|part| part.descriptor.name == name);
        // Two laws that are both there are no rivals: each has taken out what the other one could not.
        self.inseparable.retain(|(_, rival)| !there(rival));
        if !there("map") {
            self.coordinate = None;
        }
        // Nor is what came later a runner-up.
        let runners_up =
            self.runners_up.iter().map(|others| others.iter().find(|(name, _)| !there(name)).copied()).collect();
        let added = self.best.hypothesis.effects.len() - self.declared_effects();
        // Nothing is `none`, and little is `found`, while what is left is not noise.
        let settled = self.is_noise(&self.best_errors) || (added > 0 && self.is_explained(&self.best_errors));
        let verdict = if self.coordinate.is_some() || !settled {
            Verdict::Unknown
        } else if added == 0 {
            Verdict::None
        } else if !self.inseparable.is_empty() {
            Verdict::NotSeparable
        } else {
            Verdict::Found
        };
        let unproven = self.unproven_ripples();
        let mut after = self.best.estimate(self.train, Sides::BOTH)?;
        if !self.stopped && !self.watch.stopped() {
            self.watch.progress("what the sensors' noise does to the parameters", 0.97);
            after = sensor_noise::widened(after, self.train)?;
        }
        Ok(Selection {
            verdict,
            before: self.before,
            after,
            errors_before: self.errors_before,
            errors_after: self.best_errors,
            evidence: self.evidence,
            coordinate: self.coordinate,
            runners_up,
            unproven,
            inseparable: self.inseparable,
            floor: self.floor,
            stopped: self.stopped,
        })
    }
}

/// Whether ripples have periods as guides of one type have them.
fn are_of_one_type(ripples: &[Part]) -> bool {
    let periods: Vec<f64> = ripples.iter().filter_map(|part| part.value_of("period")).collect();
    let (shortest, longest) = crate::range(&periods);
    periods.len() == ripples.len() && longest <= (1.0 + OF_ONE_TYPE) * shortest
}

/// Whether laws that leave a mean square on the hold-out, of one before, both N^2, over a floor of noise, N, are the answer though more than noise is left.
fn leaves_little(left: f64, before: f64, floor: f64) -> bool {
    let share = left - floor.powi(2) <= LEFT_AT_MOST * (before - floor.powi(2)).max(0.0);
    // Sensors without any noise say nothing of sizes.
    share && (floor <= 0.0 || left <= (FLOORS_AT_MOST * floor).powi(2))
}

/// The simplest law among those that explain about as much as the strongest, of several the one that explains most.
fn winner(tried: &[(Evidence, Hypothesis)], strongest: f64) -> usize {
    let explains = |index: &usize| {
        let one = &tried[*index].0;
        one.outcome != Outcome::TooSmall && one.holdout_gain >= SIMPLER * strongest
    };
    let fewest = (0..tried.len()).filter(explains).map(|index| tried[index].0.free).min();
    let simplest: Vec<usize> =
        (0..tried.len()).filter(explains).filter(|index| Some(tried[*index].0.free) == fewest).collect();
    let most = simplest.iter().map(|index| tried[*index].0.holdout_gain).fold(0.0, f64::max);
    // Of equals first what acts, then what only reads wrong: the answer must not hang on the last digit.
    let equals = simplest.into_iter().filter(|index| tried[*index].0.holdout_gain >= RIVAL * most);
    let order = |index: &usize| {
        let one = &tried[*index].0;
        (one.side == Side::Sensor, ALL.iter().position(|listed| listed.name == one.name))
    };
    equals.min_by_key(order).unwrap_or(0)
}

/// The fit with guides that differ from each other, from the differences that there are and afresh: the sum of the guides depends
/// on the products of their differences, and what an effect not yet known bent them to is no good start. Guides that are all the same are
/// none either: there no direction is better than its opposite.
fn with_different_guides(start: &Hypothesis, train: &Measured, effort: Effort) -> Result<Fitted, IdentifyError> {
    let Some(afresh) = start.different_guides() else { return Ok(fit(start, train, Sides::BOTH, effort)?) };
    if start.guides_are_alike() {
        return Ok(fit(&afresh, train, Sides::BOTH, effort)?);
    }
    let fitted = race(&[start.holding_guides(false), afresh], train, Sides::BOTH, effort, 1.0);
    let fitted = fitted.into_iter().collect::<Result<Vec<_>, _>>()?;
    // Of equals the first one.
    let best = fitted.into_iter().reduce(|best, other| if other.squares() < best.squares() { other } else { best });
    Ok(best.expect("two fits"))
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

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::super::closed_loop::tests::recording;
    use super::*;
    use crate::model::{Curve, EffectParameters};

    /// Candidates of a round with the free parameters and the gains of their laws.
    fn tried(candidates: &[(&str, usize, f64)]) -> Vec<(Evidence, Hypothesis)> {
        let hypothesis = Hypothesis::new(&StageModel::default(), Tolerances::default()).unwrap();
        let one = |&(name, free, holdout_gain): &(&str, usize, f64)| {
            let descriptor = EffectDescriptor::find(name).unwrap();
            let values = descriptor.parameters.iter().map(|parameter| parameter.default.unwrap_or(0.0)).collect();
            let evidence = Evidence {
                round: 0,
                name: descriptor.name,
                side: descriptor.side,
                free,
                part: Part { descriptor, values },
                errors: Errors::default(),
                train_gain: holdout_gain,
                holdout_gain,
                chance: 0.0,
                outcome: Outcome::Beaten,
            };
            (evidence, hypothesis.clone())
        };
        candidates.iter().map(one).collect()
    }

    /// Of two laws, the stronger first.
    #[test]
    fn the_winner_is_simple_then_strong_then_one_that_acts() {
        let cases = [
            // A simpler law wins if it explains about as much, and only then.
            ([("stiction_aging", 3, 1.0), ("payload", 1, 0.98)], "payload"),
            ([("stiction_aging", 3, 1.0), ("payload", 1, 0.96)], "stiction_aging"),
            // Of laws that are as simple the one that explains more.
            ([("payload", 1, 1.0), ("quadratic_drag", 1, 0.975)], "payload"),
            ([("quadratic_drag", 1, 1.0), ("payload", 1, 0.975)], "quadratic_drag"),
            // Of equals one that acts before one that reads wrong.
            ([("encoder_scale", 1, 1.0), ("payload", 1, 0.999)], "payload"),
            ([("payload", 1, 1.0), ("encoder_scale", 1, 0.999)], "payload"),
        ];
        for (candidates, expected) in cases {
            let tried = tried(&candidates);
            assert_eq!(tried[winner(&tried, candidates[0].2)].0.name, expected, "{candidates:?}");
        }
    }

    #[test]
    fn a_curve_that_the_model_declares_stays_as_it_is() {
        let with_curve = |height: f64| {
            let values = (0..41).map(|knot| height * (0.4 * f64::from(knot)).sin()).collect();
            let curve =
                Curve { coordinate: Coordinate::Position, side: CurveSide::Carriage, from: -0.005, to: 0.025, values };
            StageModel { effects: vec![EffectParameters::map(curve)], ..StageModel::default() }
        };
        // Off by so little that it does not matter, and so much that another one would be nearer.
        let (model, real) = (with_curve(2.0), with_curve(2.02));
        let record = |seed, moves| Measured::new(&recording(&real, seed, 0.0, moves), &model, "the record").unwrap();
        let found = search(&model, Tolerances::default(), &record(3, 4), &record(4, 2), &Silent).unwrap();
        assert_eq!((found.verdict, found.coordinate), (Verdict::None, None));
        assert_eq!(found.after.fitted.hypothesis.model().effects, model.effects);
    }

    /// A force that steps in time is nobody's law; one that is constant, or a spring, takes a part of it.
    #[test]
    fn beside_a_curve_laws_stay_that_are_there_and_no_others() {
        let values = (0..41).map(|knot| if knot < 10 { 0.0 } else { 3.0 }).collect();
        let curve = Curve { coordinate: Coordinate::Time, side: CurveSide::Carriage, from: 0.0, to: 8.0, values };
        let cogging = EffectDescriptor::find("cogging").unwrap().parameters_of(&[3.0, 4e-3, 0.3]);
        let real = StageModel { effects: vec![cogging, EffectParameters::map(curve)], ..StageModel::default() };
        let model = StageModel::default();
        let record = |seed, moves| Measured::new(&recording(&real, seed, 0.0, moves), &model, "the record").unwrap();
        let found = search(&model, Tolerances::default(), &record(3, 4), &record(4, 2), &Silent).unwrap();
        let effects: Vec<String> =
            found.after.fitted.hypothesis.model().effects.iter().map(|e| e.name.clone()).collect();
        assert_eq!(effects, ["cogging", "map"], "{:?}", found.verdict);
        assert_eq!((found.verdict, found.coordinate), (Verdict::Unknown, Some(Coordinate::Time)));
    }

    /// A bump that is wide against the travel is nearly the sum of a few ripples.
    #[test]
    fn a_curve_is_not_taken_for_the_ripples_that_add_up_to_it() {
        let values = (0..41).map(|knot| 4.0 * (-(f64::from(knot) - 20.0).powi(2) / 8.0).exp()).collect();
        let curve =
            Curve { coordinate: Coordinate::Position, side: CurveSide::Carriage, from: -0.005, to: 0.025, values };
        let real = StageModel { effects: vec![EffectParameters::map(curve)], ..StageModel::default() };
        let model = StageModel::default();
        let record = |seed, moves| Measured::new(&recording(&real, seed, 0.0, moves), &model, "the record").unwrap();
        let found = search(&model, Tolerances::default(), &record(3, 4), &record(4, 2), &Silent).unwrap();
        let effects: Vec<String> =
            found.after.fitted.hypothesis.model().effects.iter().map(|e| e.name.clone()).collect();
        assert_eq!((found.verdict, found.coordinate), (Verdict::Unknown, Some(Coordinate::Position)));
        assert_eq!(effects, ["map"]);
    }

    /// Balls that slip show the train record and the hold-out other phases: with that of the train record the hold-out becomes worse.
    #[test]
    fn balls_that_slip_are_named_though_each_record_has_its_own_phase() {
        let model = StageModel::default();
        let record = |phase, seed, moves| {
            let slip = [6.0, 1.3e-3, phase, 0.0, 0.0, 2.0];
            let passage = EffectDescriptor::find("ball_passage").unwrap().parameters_of(&slip);
            let real = StageModel { effects: vec![passage], ..StageModel::default() };
            Measured::new(&recording(&real, seed, 0.0, moves), &model, "the record").unwrap()
        };
        let (train, holdout) = (record(0.3, 3, 6), record(2.3, 4, 4));
        let found = search(&model, Tolerances::default(), &train, &holdout, &Silent).unwrap();
        let effects = &found.after.fitted.hypothesis.effects;
        assert_eq!(found.verdict, Verdict::Found, "{effects:?}");
        assert!(effects.iter().all(|part| part.descriptor.name == "ball_passage" && part.slips()), "{effects:?}");
        assert!(found.explained_share() > 0.9, "{}", found.explained_share());
        let (amplitude, period) = (effects[0].values[0], effects[0].values[1]);
        assert!((period / 1.3e-3 - 1.0).abs() < 0.01, "{period}");
        // Four guides of 1.5 N in any phase.
        assert!((2.0..12.0).contains(&amplitude), "{amplitude}");
    }

    /// Two guides whose ripples beat over 30 mm: one ripple that fits the first 20 mm does not fit the next ones, two do.
    #[test]
    fn ripples_that_beat_are_named_together() {
        let model = StageModel::default();
        let periods = [1.30e-3, 1.36e-3];
        let record = |from: f64, seed, moves| {
            let passages = periods.map(|period| {
                let phase = (TAU * from / period) % TAU;
                EffectDescriptor::find("ball_passage").unwrap().parameters_of(&[3.0, period, phase, 0.0, 0.0, 0.0])
            });
            let real = StageModel { effects: passages.to_vec(), ..StageModel::default() };
            let mut trace = recording(&real, seed, 0.0, moves);
            for positions in [&mut trace.position, &mut trace.reference_position] {
                positions.iter_mut().for_each(|position| *position += from);
            }
            Measured::new(&trace, &model, "the record").unwrap()
        };
        let found = search(&model, Tolerances::default(), &record(0.0, 3, 6), &record(0.02, 4, 4), &Silent).unwrap();
        let effects = &found.after.fitted.hypothesis.effects;
        assert_eq!(found.verdict, Verdict::Found, "{effects:?}");
        assert!(effects.iter().all(|part| part.descriptor.name == "ball_passage" && !part.slips()), "{effects:?}");
        let mut named: Vec<f64> = effects.iter().filter_map(|part| part.value_of("period")).collect();
        named.sort_by(f64::total_cmp);
        assert_eq!(named.len(), 2, "{effects:?}");
        for (period, expected) in named.iter().zip(periods) {
            assert!((period / expected - 1.0).abs() < 1e-3, "{named:?}");
        }
        // A row for each, of one round.
        let rows: Vec<&Evidence> = found.evidence.iter().filter(|one| one.outcome == Outcome::Chosen).collect();
        assert!(rows.len() == 2 && rows[0].round == rows[1].round && rows[0].part != rows[1].part, "{rows:?}");
        assert_eq!(found.runners_up.len(), 2);
    }

    /// In floors: what is left, and what was before.
    #[test]
    fn laws_are_the_answer_where_they_leave_little_in_shares_and_in_floors() {
        let over_a_floor = |left: f64, before: f64| leaves_little(left * left, before * before, 1.0);
        assert!(over_a_floor(6.0, 50.0));
        // A seal that remembers, taken for a hysteresis, and for four laws at once.
        assert!(!over_a_floor(103.0, 341.0) && !over_a_floor(38.0, 211.0));
        // Little in floors, but not of what there was.
        assert!(!over_a_floor(6.0, 20.0));
        assert!(leaves_little(1e-4, 1.0, 0.0) && !leaves_little(0.1, 1.0, 0.0));
    }

    /// Of 100 N^2 over a floor of 0.1 N: laws that leave a half ask the next one for a tenth of that, laws that leave nearly nothing for a quarter, unless
    /// the cell shows it.
    #[test]
    fn beside_laws_that_explain_nearly_all_the_next_one_must_take_more() {
        let model = StageModel::default();
        let record = |seed, moves| Measured::new(&recording(&model, seed, 0.0, moves), &model, "the record").unwrap();
        let (train, holdout) = (record(3, 4), record(4, 2));
        let declared = Hypothesis::new(&model, Tolerances::default()).unwrap();
        let mut search = Search::new(&declared, &train, &holdout, &Silent).unwrap();
        search.floor = Floor { motor: 0.05, carriage: 0.1 };
        let on_both = |motor: f64, carriage: f64| Errors {
            train_motor: motor,
            train_carriage: carriage,
            holdout_motor: motor,
            holdout_carriage: carriage,
        };
        search.errors_before = on_both(0.0, 100.0);
        let mut is_enough = |before: Errors, after: Errors| {
            search.best_errors = before;
            let mut one = tried(&[("cable_chain", 2, before.holdout() - after.holdout())]).remove(0).0;
            one.errors = after;
            let enough = one.holdout_gain >= search.least_on_holdout(&one);
            assert_eq!(enough, one.train_gain >= search.least_on_train(&one));
            enough
        };
        for (left, share) in [(50.0, 0.1), (1.0, 0.25)] {
            for (taken, expected) in [(0.9 * share, false), (1.1 * share, true)] {
                let after = on_both(0.0, (1.0 - taken) * left);
                assert_eq!(is_enough(on_both(0.0, left), after), expected, "{taken} of {left} N^2");
            }
        }
        assert!(is_enough(on_both(0.3, 0.7), on_both(0.15, 0.7)));
    }

    #[test]
    fn what_explains_too_little_never_wins() {
        let mut tried = tried(&[("cable_chain", 2, 1.0), ("payload", 1, 0.999)]);
        tried[1].0.outcome = Outcome::TooSmall;
        assert_eq!(tried[winner(&tried, 1.0)].0.name, "cable_chain");
    }
}
