//! Which effects are there? Forward selection with a refit of everything at each step, judged on
//! held-out data, pruned backwards.

mod alternatives;
mod cell;
mod columns;
mod curve_drawing;
mod curves;
mod forms;
mod gain;
mod guides;
pub(crate) mod phase;
mod pruning;
mod rounds;
mod slips;

use std::collections::BTreeSet;

use friction_stage_core::model::{Coordinate, StageModel};
use friction_stage_core::plant::Side;

use crate::error::IdentifyError;
use crate::fit::sensor_noise;
use crate::fit::uncertainty::correlation_length_along;
use crate::fit::{Estimate, FitBudget, Fitted, fit};
use crate::hypothesis::{Hypothesis, Missing, Part, Sides, Tolerances};
use crate::record::measured::{Floor, Measured};

use curves::MOST_CURVES;
use guides::with_different_guides;

pub(super) use gain::RIVAL;
pub use gain::{CARRIAGE_GAIN, LEFT_AT_MOST, NOISE_LIKE};

/// Most laws that are added.
pub const MOST_LAWS: usize = 4;
/// Effects of which there may be several: harmonics of a period, lines of a spectrum.
pub(super) const SEVERAL: [&str; 5] =
    ["cogging", "force_ripple", "ball_passage", "external_vibration", "encoder_sde"];
/// Most effects of such a law.
const MOST_OF_ONE: usize = 4;

/// Part of a force beyond which the noise of the sensors hides it: a friction that is a part of it
/// would be nothing but noise. Assumed.
const HIDDEN: f64 = 0.5;

/// Parts of a record of which one alone is not to speak for a law. Assumed: a rest, or a move, is
/// within one or two of them.
const TENTHS: usize = 10;

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
    /// That of train without the tenth of the record that shows most of it, N^2.
    pub train_gain_elsewhere: f64,
    /// That of the hold-out by itself, with everything else as it is beside it, N^2.
    pub holdout_gain_alone: f64,
    /// Fall of the mean square of train that as many parameters would take out of what is left by
    /// chance, N^2.
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
    /// Chosen, and once the others were there not needed any more, or no more than a simpler law.
    Pruned,
}

/// Two laws that explain the data equally.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inseparable {
    /// Effect that was added.
    pub effect: &'static str,
    /// Law that would do as well.
    pub rival: &'static str,
    /// Correlation of what the one takes out of the train residual with what the other does.
    pub correlation: f64,
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
    /// Pairs that the data do not tell apart.
    pub inseparable: Vec<Inseparable>,
    /// Ripples over the position that go through few periods within the travel, with how many.
    pub unproven: Vec<(&'static str, f64)>,
    /// How far the zero of the cell is off on the hold-out beyond the law that was found for it,
    /// where that is all that is left, N rms.
    pub wander_of_zero: Option<f64>,
    /// Against which everything is judged: of the declared noise, or of what the hold-out shows
    /// where that is more.
    pub floor: Floor,
    /// Of the declared noise.
    pub declared_floor: Floor,
    pub stopped: bool,
}

impl Selection {
    /// Laws that were added, those of which there are several counted once.
    pub fn added_laws(&self) -> usize {
        let effects = &self.after.fitted.hypothesis.effects;
        different_laws(&effects[self.before.hypothesis.effects.len()..])
    }

    /// Share of the held-out residual above the floor of the declared noise that the added effects
    /// take out; 0 where there is nothing to explain.
    pub fn explained_share(&self) -> f64 {
        let floor = self.declared_floor.total().powi(2);
        let explainable = self.errors_before.holdout() - floor;
        if explainable <= 0.0 {
            return 0.0;
        }
        (self.errors_before.holdout() - self.errors_after.holdout()) / explainable
    }
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

/// Searches for what the declared model lacks.
pub fn search(
    declared: &StageModel,
    tolerances: Tolerances,
    train: &Measured,
    holdout: &Measured,
    watch: &dyn Watch,
) -> Result<Selection, IdentifyError> {
    watch.progress("fit of the declared model", 0.0);
    let start = Hypothesis::new(declared, tolerances)?;
    for (name, record) in [("the train record", train), ("the hold-out record", holdout)] {
        let (floor, force) = (start.floor(record).total(), record.force_rms());
        if floor > HIDDEN * force {
            return Err(IdentifyError::HiddenByNoise {
                name,
                encoder: record.noise,
                cell: record.cell_noise,
                floor,
                force,
            });
        }
    }
    let mut search = Search::new(&start, train, holdout, watch)?;
    search.refuse_other_guides(declared, tolerances)?;
    search.add_laws()?;
    if !search.stopped {
        search.choose_forms_anew()?;
        search.add_curve()?;
        // Beside a curve laws show, or change, that what it stands for had hidden; beside these it
        // is another curve. It settles first: a round of all laws costs far more.
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
        search.conclude()?;
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
    /// Rounds in which candidates were tried.
    rounds: usize,
    evidence: Vec<Evidence>,
    coordinate: Option<Coordinate>,
    /// For each effect the other candidates of its round, the best first, with their held-out rms,
    /// N.
    runners_up: Vec<Vec<(&'static str, f64)>>,
    inseparable: Vec<Inseparable>,
    /// Number of effects whose forms were chosen anew before a further one was added.
    forms_chosen: usize,
    stopped: bool,
}

impl<'a> Search<'a> {
    fn new(
        declared: &Hypothesis,
        train: &'a Measured,
        holdout: &'a Measured,
        watch: &'a dyn Watch,
    ) -> Result<Search<'a>, IdentifyError> {
        let alike = fit(declared, train, Sides::BOTH, FitBudget::COMPARED)?;
        let before = with_different_guides(&alike.hypothesis, train, FitBudget::KEPT)?;
        let errors_before = errors(&before.hypothesis, train, holdout)?;
        Ok(Search {
            train,
            holdout,
            watch,
            floor: sensor_noise::floor(&before.hypothesis.in_record(holdout)?, holdout)?,
            runners_up: vec![Vec::new(); before.hypothesis.effects.len()],
            best: before.clone(),
            best_errors: errors_before,
            before,
            errors_before,
            rounds: 0,
            evidence: Vec::new(),
            coordinate: None,
            inseparable: Vec::new(),
            forms_chosen: 0,
            stopped: false,
        })
    }

    fn has_cell(&self) -> bool {
        self.train.cell.is_some()
    }

    /// Effects that the model declares: they stand first.
    fn declared_effects(&self) -> usize {
        self.before.hypothesis.effects.len()
    }

    /// Effects of this name that were added.
    fn added_of(&self, name: &str) -> usize {
        self.best.hypothesis.effects[self.declared_effects()..]
            .iter()
            .filter(|part| part.descriptor.name == name)
            .count()
    }

    /// Whether there are as many laws as may be.
    fn is_full(&self) -> bool {
        different_laws(&self.best.hypothesis.effects[self.declared_effects()..]) >= MOST_LAWS
    }

    fn take(&mut self, best: Fitted) -> Result<(), IdentifyError> {
        self.best_errors = errors(&best.hypothesis, self.train, self.holdout)?;
        self.best = best;
        Ok(())
    }

    /// Fits what was found further than was worth it on the way there.
    fn go_on_fitting(&mut self, effort: FitBudget) -> Result<(), IdentifyError> {
        if self.best.hypothesis.effects.len() == self.declared_effects() {
            return Ok(());
        }
        let fitted = fit(&self.best.hypothesis, self.train, Sides::BOTH, effort)?;
        // A fit begins inside of all bounds, and may end elsewhere.
        if fitted.squares() < self.best.squares() {
            self.take(fitted)?;
        }
        Ok(())
    }

    /// Fits what was found to the end.
    fn finish(&mut self) -> Result<(), IdentifyError> {
        self.watch.progress("fit of what was found", 0.94);
        self.go_on_fitting(FitBudget::KEPT)
    }

    /// Fits what was found to the end and prunes it. What goes makes room for laws that there was
    /// none for.
    fn conclude(&mut self) -> Result<(), IdentifyError> {
        self.finish()?;
        let was_full = self.is_full();
        self.prune()?;
        if was_full && !self.is_full() && self.add_laws()? {
            self.finish()?;
            self.prune()?;
        }
        self.weigh_alternatives()
    }

    /// Sides that a fit with this effect has to look at beside those that were found before: what a
    /// sensor reads wrong moves with the fit of either side, and one side alone would bend it.
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

    fn selection(mut self) -> Result<Selection, IdentifyError> {
        self.best.hypothesis =
            self.best.hypothesis.with_own_amplitudes(self.declared_effects(), self.train)?;
        let there = |name: &str| {
            self.best.hypothesis.effects.iter().any(|part| part.descriptor.name == name)
        };
        // Two laws that are both there are no rivals: each has taken out what the other one could
        // not.
        self.inseparable.retain(|pair| !there(pair.rival));
        if !there("map") {
            self.coordinate = None;
        }
        // Nor is what came later a runner-up.
        let runners_up = self
            .runners_up
            .iter()
            .map(|others| others.iter().find(|(name, _)| !there(name)).copied())
            .collect();
        let added = self.best.hypothesis.effects.len() - self.declared_effects();
        // Nothing is `none`, and little is `found`, while what is left is not noise, or while not
        // everything was tried.
        let wander_of_zero = self.wander_of_zero()?;
        let settled = match added {
            0 => self.is_noise(&self.best_errors) && !self.stopped,
            _ => {
                self.is_noise(&self.best_errors)
                    || self.is_explained(&self.best_errors)
                    || wander_of_zero.is_some()
            }
        };
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
        let declared_floor = self.before.hypothesis.declared_floor(self.holdout);
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
            wander_of_zero,
            inseparable: self.inseparable,
            floor: self.floor,
            declared_floor,
            stopped: self.stopped,
        })
    }
}

fn errors(
    hypothesis: &Hypothesis,
    train: &Measured,
    holdout: &Measured,
) -> Result<Errors, IdentifyError> {
    let (train_motor, train_carriage) = hypothesis.missing(train, Sides::BOTH)?.squares();
    let (holdout_motor, holdout_carriage) =
        hypothesis.in_record(holdout)?.missing(holdout, Sides::BOTH)?.squares();
    Ok(Errors { train_motor, train_carriage, holdout_motor, holdout_carriage })
}

/// Mean square of what is missing on a hold-out, N^2.
fn errors_on(hypothesis: &Hypothesis, holdout: &Measured) -> Result<f64, IdentifyError> {
    let (motor, carriage) = hypothesis.in_record(holdout)?.missing(holdout, Sides::BOTH)?.squares();
    Ok(motor + carriage)
}

/// Laws among effects, those of which there are several counted once; a map is none.
fn different_laws(effects: &[Part]) -> usize {
    let names: BTreeSet<&str> = effects.iter().map(|part| part.descriptor.name).collect();
    names.iter().filter(|name| **name != "map").count()
}

/// What a law of `free` parameters that leads from one residual to another takes out of the mean
/// square by chance, N^2, twice over: for each the share of the values that are independent of each
/// other for what is as fast as what the law takes. Of what drifts or wanders a slow law finds few
/// of them.
fn by_chance(before: &Missing, after: &Missing, free: usize) -> f64 {
    let of_side = |before: &[f64], after: &[f64]| {
        let squares: f64 = after.iter().map(|left| left * left).sum();
        squares * correlation_length_along(after, &difference(before, after))
    };
    let per_parameter =
        of_side(&before.motor, &after.motor) + of_side(&before.carriage, &after.carriage);
    2.0 * free as f64 * per_parameter / (after.carriage.len() as f64).powi(2)
}

fn difference(before: &[f64], after: &[f64]) -> Vec<f64> {
    before.iter().zip(after).map(|(before, after)| before - after).collect()
}

/// Correlation of what two fits take out of a residual of both sides; 0 where one takes out
/// nothing.
fn correlation_of_taken(before: &Missing, one: &Missing, other: &Missing) -> f64 {
    let taken = |after: &Missing| -> Vec<f64> {
        [difference(&before.motor, &after.motor), difference(&before.carriage, &after.carriage)]
            .concat()
    };
    let (one, other) = (taken(one), taken(other));
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let size = (product(&one, &one) * product(&other, &other)).sqrt();
    if size > 0.0 { product(&one, &other) / size } else { 0.0 }
}

/// Fall of the mean square from one residual of a record to another without the tenth of the record
/// that shows most of it, N^2.
fn gain_elsewhere(before: &Missing, after: &Missing) -> f64 {
    let rows = before.carriage.len();
    let fall = |before: &[f64], after: &[f64], tenth: usize| -> f64 {
        let tenth = tenth * before.len() / TENTHS..(tenth + 1) * before.len() / TENTHS;
        before[tenth.clone()]
            .iter()
            .zip(&after[tenth])
            .map(|(before, after)| before * before - after * after)
            .sum()
    };
    let of_tenth = |tenth| {
        fall(&before.motor, &after.motor, tenth) + fall(&before.carriage, &after.carriage, tenth)
    };
    let falls: Vec<f64> = (0..TENTHS).map(of_tenth).collect();
    (falls.iter().sum::<f64>() - falls.iter().copied().fold(f64::NEG_INFINITY, f64::max))
        / rows as f64
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::closed_loop::tests::recording;
    use friction_stage_core::model::EffectParameters;
    use friction_stage_core::plant::EffectDescriptor;

    pub(super) fn part(name: &str, values: &[(&str, f64)]) -> Part {
        let given = EffectParameters::new(name, values.iter().copied());
        let descriptor = EffectDescriptor::find(name).unwrap();
        Part { descriptor, values: descriptor.values_of(&given).unwrap() }
    }

    #[test]
    fn ripples_of_one_law_are_one_law_and_a_curve_is_none() {
        let ripple = |period: f64| part("cogging", &[("amplitude", 1.0), ("period", period)]);
        let knots = EffectDescriptor::find("map").unwrap();
        let curve =
            Part { descriptor: knots, values: vec![0.0, 2.0, 0.0, 0.1, 0.0, 0.0, 1.0, 2.0] };
        let drag = part("quadratic_drag", &[("coefficient", 1.0)]);
        assert_eq!(different_laws(&[ripple(0.024), drag.clone(), curve, ripple(0.012)]), 2);
        assert_eq!(different_laws(&[]), 0);
    }

    /// What one tenth of a record shows, and what all of it does: 4 N^2 there, 1 N^2 everywhere.
    #[test]
    fn what_shows_in_one_place_shows_nowhere_else() {
        let rows = 200;
        let missing = |of_row: &dyn Fn(usize) -> f64| Missing {
            motor: vec![0.5; rows],
            carriage: (0..rows).map(of_row).collect(),
        };
        let in_one_place = missing(&|row| if (60..80).contains(&row) { 2.0 } else { 0.1 });
        let everywhere = missing(&|_| 1.0);
        let gone = missing(&|_| 0.0);
        assert!((gain_elsewhere(&in_one_place, &gone) - 0.9 * 0.01).abs() < 1e-12);
        assert!((gain_elsewhere(&everywhere, &gone) - 0.9).abs() < 1e-12);
        // What makes the rest worse shows less than nothing there.
        assert!(gain_elsewhere(&in_one_place, &missing(&|_| 0.2)) < 0.0);
    }

    /// Of what is missing on both sides: the same, the opposite, half of it elsewhere, and nothing.
    #[test]
    fn laws_that_take_out_the_same_are_correlated() {
        let missing = |motor: [f64; 2], carriage: [f64; 2]| Missing {
            motor: motor.into(),
            carriage: carriage.into(),
        };
        let before = missing([3.0, 3.0], [3.0, 3.0]);
        let one = missing([2.0, 3.0], [1.0, 3.0]);
        for (other, expected) in [
            (missing([1.0, 3.0], [-1.0, 3.0]), 1.0),
            (missing([4.0, 3.0], [5.0, 3.0]), -1.0),
            // (1, 0, 2, 0) and (0, 0, 2, 1) were taken.
            (missing([3.0, 3.0], [1.0, 2.0]), 0.8),
            (before.clone(), 0.0),
        ] {
            assert!(
                (correlation_of_taken(&before, &one, &other) - expected).abs() < 1e-12,
                "{other:?}"
            );
        }
    }

    /// Four laws, three of which do nothing, and a cogging that nobody has tried.
    #[test]
    fn what_pruning_takes_out_makes_room() {
        let model = StageModel::default();
        let hidden = [
            part("constant_force", &[("amplitude", 2.0)]),
            part("cogging", &[("amplitude", 1.0), ("period", 0.006)]),
        ];
        let real =
            StageModel { effects: hidden.iter().map(Part::parameters).collect(), ..model.clone() };
        let record = |seed, moves| {
            Measured::new(&recording(&real, seed, 0.0, moves), &model, "the record").unwrap()
        };
        let (train, holdout) = (record(3, 6), record(4, 4));
        let start = Hypothesis::new(&model, Tolerances::default()).unwrap();
        let mut search = Search::new(&start, &train, &holdout, &Silent).unwrap();
        let with = [
            part("quadratic_drag", &[("coefficient", 0.1)]),
            part("cable_chain", &[("stiffness", 1.0)]),
            part("motor_gain", &[("fraction", 0.001)]),
        ];
        let four =
            with.into_iter().fold(start.with(hidden[0].clone()), |four, part| four.with(part));
        search.take(fit(&four, &train, Sides::BOTH, FitBudget::KEPT).unwrap()).unwrap();
        search.runners_up.resize(4, Vec::new());
        assert!(search.is_full());
        search.conclude().unwrap();
        let mut names: Vec<&str> =
            search.best.hypothesis.effects.iter().map(|part| part.descriptor.name).collect();
        names.sort_unstable();
        assert_eq!(names, ["cogging", "constant_force"]);
    }
}
