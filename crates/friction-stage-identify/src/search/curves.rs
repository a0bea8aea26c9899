//! Curves over one coordinate for what no law has.

use rayon::prelude::*;

use crate::error::IdentifyError;
use crate::fit::{FitBudget, Fitted, fit};
use crate::hypothesis::{Hypothesis, Part, Sides};
use crate::search::curve_drawing::{self, Beside};
use friction_stage_core::model::{Coordinate, CurveSide, EffectParameters};
use friction_stage_core::plant::effects::ParameterKind;

use super::columns::Columns;
use super::score::{Judged, errors};
use super::selection::{Errors, Evidence, Outcome};
use super::state::Search;

/// First and last step with which the place of a jump is sought around where it stands, s. Assumed.
const COARSE_PLACE: f64 = 16e-3;
const FINE_PLACE: f64 = 2.5e-4;
/// How long a stage hardly moves between two strokes, s. Assumed.
const HARDLY_MOVES: f64 = 0.6;
/// How often a curve is drawn again at most, and how often laws are looked for beside it.
pub(super) const MOST_CURVES: usize = 4;

/// A curve as it is drawn, before anything is fitted again.
struct DrawnCurve {
    with: Hypothesis,
    damping: Option<f64>,
    /// Fall of the score of the hold-out.
    gain: f64,
}

impl Search<'_> {
    /// Draws a curve over one coordinate for what no law explains. Returns whether it is enough.
    pub(super) fn add_curve(&mut self) -> Result<bool, IdentifyError> {
        if self.is_noise(&self.best.errors) && self.unproven_ripples().is_empty() {
            return Ok(false);
        }
        self.watch.progress("curves over position, velocity and time", 0.9);
        let beside = match self.is_noise(&self.best.errors) {
            true => None,
            false => self.with_curve(self.found(), &self.best.errors, FitBudget::KEPT)?,
        };
        if let Some(with) = beside {
            self.runners_up.push(Vec::new());
            self.best = with;
        }
        // Laws that explain a part each bend towards what is none of them: one curve alone may say
        // it better. Ripples that have not shown that they are ones say no more than a curve.
        let added = self.found().effects.len() - self.declared_effects();
        let laws = added - usize::from(self.curve().is_some());
        let unproven = !self.unproven_ripples().is_empty();
        let asked = if unproven { self.criteria.fall } else { self.criteria.fall_of_curve };
        let unexplained =
            !self.is_noise(&self.best.errors) && !self.is_explained(&self.best.errors);
        if laws > 0
            && (unexplained || unproven)
            && let Some(alone) = self.with_curve(
                &self.before.fitted.hypothesis,
                &self.before.errors,
                FitBudget::KEPT,
            )?
            && self.best.score.fall_to(&alone.score) >= asked
        {
            self.best = alone;
            let kept =
                |one: &&mut Evidence| matches!(one.outcome, Outcome::Chosen | Outcome::Equal);
            self.evidence.iter_mut().filter(kept).for_each(|one| one.outcome = Outcome::Pruned);
            self.inseparable.clear();
            self.runners_up.truncate(self.declared_effects());
            self.runners_up.push(Vec::new());
        }
        Ok(self.curve().is_some())
    }

    /// Laws that were added which repeat over the position, and hardly do so in this record, with
    /// how often they do: a few of these add up to any curve.
    pub(super) fn unproven_ripples(&self) -> Vec<(&'static str, f64)> {
        let added = self.found().effects[self.declared_effects()..].iter();
        added.filter_map(|part| self.periods_of_unproven(part)).collect()
    }

    pub(super) fn is_unproven(&self, part: &Part) -> bool {
        self.periods_of_unproven(part).is_some()
    }

    fn periods_of_unproven(&self, part: &Part) -> Option<(&'static str, f64)> {
        let (from, to) = friction_stage_core::numerics::range(&self.train.position);
        let period = part.value_of_kind(ParameterKind::Period)?;
        let periods = (to - from) / period;
        (part.descriptor.may_repeat() && periods < self.criteria.least_periods)
            .then_some((part.descriptor.name, periods))
    }

    /// Coordinate of the curve that the search has added.
    pub(super) fn coordinate(&self) -> Option<Coordinate> {
        Some(self.found().effects[self.curve()?].curve()?.coordinate)
    }

    /// Draws the curve again while that is worth it.
    pub(super) fn settle_curve(&mut self) -> Result<(), IdentifyError> {
        for _ in 0..MOST_CURVES {
            if self.watch.stopped() || !self.draw_curve_again()? {
                break;
            }
        }
        Ok(())
    }

    /// Where the curve stands that the search has added; one that the model declares is not for it
    /// to change.
    pub(super) fn curve(&self) -> Option<usize> {
        let last = self.found().effects.iter().rposition(|part| part.descriptor.is_curve());
        last.filter(|index| *index >= self.declared_effects())
    }

    /// The curve once more, of what is left without it; whether that is worth going on.
    fn draw_curve_again(&mut self) -> Result<bool, IdentifyError> {
        let Some(index) = self.curve() else { return Ok(false) };
        self.watch.progress("the curve once more", 0.92);
        let without = self.found().without(index);
        let left = errors(&without, self.train, self.holdout)?;
        let Some(with) = self.with_curve(&without, &left, FitBudget::KEPT)? else {
            return Ok(false);
        };
        let (fall, is_noise) = (self.best.score.fall_to(&with.score), self.is_noise(&with.errors));
        if with.errors.holdout() < self.best.errors.holdout() {
            self.runners_up.remove(index);
            self.runners_up.push(Vec::new());
            self.best = with;
        }
        Ok(fall >= self.criteria.fall && !is_noise)
    }

    /// A curve for what a hypothesis leaves, drawn again as long as that improves it: the guides
    /// were biased by what was missing when it was first drawn.
    pub(super) fn with_settled_curve(
        &self,
        without: &Hypothesis,
    ) -> Result<Option<Judged>, IdentifyError> {
        let drawn = |without: &Hypothesis| {
            let left = errors(without, self.train, self.holdout)?;
            self.with_curve(without, &left, FitBudget::KEPT)
        };
        let Some(mut best) = drawn(without)? else { return Ok(None) };
        for _ in 1..MOST_CURVES {
            let found = &best.fitted.hypothesis;
            let again = drawn(&found.without(found.effects.len() - 1))?;
            let better = again.filter(|again| again.errors.holdout() < best.errors.holdout());
            let Some(again) = better else { break };
            let worth_it = best.score.fall_to(&again.score) >= self.criteria.fall;
            best = again;
            if !worth_it {
                break;
            }
        }
        Ok(Some(best))
    }

    /// The declared model, fitted, without the laws that were found, and with a curve where one was
    /// needed.
    pub(super) fn without_laws(&self) -> Result<Hypothesis, IdentifyError> {
        let before = &self.before.fitted.hypothesis;
        let alone = match self.curve().is_some() && !self.watch.stopped() {
            true => self.with_settled_curve(before)?,
            false => None,
        };
        Ok(alone.map_or_else(|| before.clone(), |alone| alone.fitted.hypothesis))
    }

    /// The curve over position, velocity or time that takes most out of the hold-out, if that is
    /// enough of what is left of both records.
    pub(super) fn with_curve(
        &self,
        start: &Hypothesis,
        start_errors: &Errors,
        effort: FitBudget,
    ) -> Result<Option<Judged>, IdentifyError> {
        let drawn = self.drawn_curves(start, start_errors)?;
        let start_score = self.quick_score(start_errors);
        // The best one of each damping: moves are far from linear, so that one that is better at
        // first need not be the better one. A curve that the train record does not show is drawn
        // through what it says nothing of, and fits the hold-out by chance.
        let judged = |fitted: Fitted| -> Result<Option<Judged>, IdentifyError> {
            let judged = self.judged(fitted)?;
            let asked = self.asked(&judged.fitted.hypothesis, start, start_errors);
            let is_enough = start_score.fall_to(&judged.score) >= asked;
            let shows = is_enough
                && self.shows_without_cell(
                    (start, start_errors),
                    (&judged.fitted.hypothesis, &judged.errors),
                )?;
            Ok(shows.then_some(judged))
        };
        let fitted = curve_drawing::DAMPINGS.par_iter().filter_map(|damping| {
            let alike = drawn.iter().filter(|one| one.damping == *damping);
            let one = alike.max_by(|one, other| one.gain.total_cmp(&other.gain))?;
            let fitted = || -> Result<_, IdentifyError> {
                let fitted = self.with_jump_in_place(
                    fit(&one.with, self.train, Sides::BOTH, effort)?,
                    false,
                    effort,
                )?;
                judged(fitted)
            };
            fitted().transpose()
        });
        let fitted = fitted.collect::<Result<Vec<_>, _>>()?.into_iter();
        let left = |one: &Judged| one.errors.holdout();
        let best = fitted.min_by(|one, other| left(one).total_cmp(&left(other)));
        let Some(held) = best else { return Ok(None) };
        // A change of friction multiplies what the guides have, and these were biased when it was
        // drawn.
        let of_friction =
            |part: &Part| part.curve().is_some_and(|curve| curve.side.is_of_friction());
        if !held.fitted.hypothesis.effects.last().is_some_and(of_friction) {
            return Ok(Some(held));
        }
        let biased = judged(self.with_heights_fitted(&held.fitted.hypothesis, effort)?)?;
        let better = biased.filter(|biased| left(biased) < left(&held));
        Ok(Some(better.unwrap_or(held)))
    }

    /// The heights of a curve fitted with everything else, with a jump if what it leaves shows one.
    fn with_heights_fitted(
        &self,
        held: &Hypothesis,
        effort: FitBudget,
    ) -> Result<Fitted, IdentifyError> {
        let fitted = |start: &Hypothesis| -> Result<Fitted, IdentifyError> {
            let fitted = fit(start, self.train, Sides::BOTH, effort)?;
            // With the guides as they were biased to where it stood, and then as they are.
            let placed = self.with_jump_in_place(fitted, true, effort)?;
            self.with_jump_in_place(placed, false, effort)
        };
        let mut best = fitted(&held.holding_curves(false))?;
        if let Some(jumping) = self.with_a_jump(&best.hypothesis)? {
            let other = fitted(&jumping)?;
            if other.squares() < curve_drawing::WITH_A_JUMP * best.squares() {
                best = other;
            }
        }
        Ok(best.holding_curves())
    }

    /// The same with a jump in its curve, that stands last, where what it leaves shows one; `None`
    /// where there may be none, or is one.
    fn with_a_jump(&self, hypothesis: &Hypothesis) -> Result<Option<Hypothesis>, IdentifyError> {
        let Some(place) = hypothesis.effects.len().checked_sub(1) else { return Ok(None) };
        let Part { descriptor, values } = &hypothesis.effects[place];
        let Some(mut curve) = descriptor.curve_of(values) else { return Ok(None) };
        if curve.coordinate != Coordinate::Time || curve.jump.is_some() {
            return Ok(None);
        }
        let columns = Columns::new(hypothesis, self.train)?;
        let beside = Beside::of(hypothesis, self.train)?;
        curve.jump = curve_drawing::jump(
            &columns.residual(curve.side == CurveSide::Motor),
            curve.side,
            &beside,
        );
        if curve.jump.is_none() {
            return Ok(None);
        }
        // Values that do not go together are no curve.
        let Ok(values) = descriptor.values_of(&EffectParameters::map(curve)) else {
            return Ok(None);
        };
        let mut jumping = hypothesis.clone();
        jumping.effects[place].values = values;
        Ok(Some(jumping))
    }

    /// The same with the jump of its curve where it leaves least, fitted again if that is another
    /// place: sought around where it stands, or everywhere.
    fn with_jump_in_place(
        &self,
        fitted: Fitted,
        everywhere: bool,
        effort: FitBudget,
    ) -> Result<Fitted, IdentifyError> {
        let has_jump = |part: &Part| part.curve().is_some_and(|curve| curve.jump.is_some());
        let Some(curve) = fitted.hypothesis.effects.iter().rposition(has_jump) else {
            return Ok(fitted);
        };
        let at = fitted.hypothesis.effects[curve].descriptor.place_of(ParameterKind::Instant);
        let (Some(at), false) = (at, curve < self.declared_effects()) else { return Ok(fitted) };
        let moved = |stands: &Hypothesis, aside: f64| {
            let mut moved = stands.clone();
            moved.effects[curve].values[at] += aside;
            moved
        };
        // Values that do not go together there are no curve.
        let best_of = |several: Vec<Hypothesis>| -> Option<Hypothesis> {
            let left = several.into_par_iter().filter_map(|one| {
                let (motor, carriage) = one.missing(self.train, Sides::BOTH).ok()?.squares();
                Some((motor + carriage, one))
            });
            left.min_by(|one, other| one.0.total_cmp(&other.0)).map(|(_, best)| best)
        };
        let mut best = fitted.hypothesis.clone();
        if everywhere {
            let elsewhere = best.jumping_elsewhere(curve, self.train)?;
            best = best_of([best.clone()].into_iter().chain(elsewhere).collect()).unwrap_or(best);
            // Where a stage hardly moves bristles forget nothing.
            let count = (HARDLY_MOVES / COARSE_PLACE) as i32;
            let around = (-count..=count)
                .map(|place| moved(&best, f64::from(place) * COARSE_PLACE))
                .collect();
            best = best_of(around).unwrap_or(best);
        }
        let mut step = 0.5 * COARSE_PLACE;
        while step >= FINE_PLACE {
            best = best_of(vec![best.clone(), moved(&best, -step), moved(&best, step)])
                .unwrap_or(best);
            step *= 0.5;
        }
        let stands = best.effects[curve].values[at] == fitted.hypothesis.effects[curve].values[at];
        Ok(if stands { fitted } else { fit(&best, self.train, Sides::BOTH, effort)? })
    }

    /// Curves over everything that there is, those that take more than chance out of the hold-out.
    fn drawn_curves(
        &self,
        start: &Hypothesis,
        start_errors: &Errors,
    ) -> Result<Vec<DrawnCurve>, IdentifyError> {
        let columns = Columns::new(start, self.train)?;
        let start_score = self.quick_score(start_errors);
        let (nothing, moving) =
            (Beside::nothing(self.train.rows.len()), Beside::of(start, self.train)?);
        let sides = [
            CurveSide::Carriage,
            CurveSide::Motor,
            CurveSide::Friction,
            CurveSide::Viscous,
            CurveSide::Mass,
        ];
        let mut sought: Vec<(Coordinate, CurveSide)> =
            [Coordinate::Position, Coordinate::Velocity, Coordinate::Time]
                .into_iter()
                .flat_map(|over| sides.map(|side| (over, side)))
                .collect();
        sought.retain(|(over, side)| match side {
            CurveSide::Motor => self.has_cell(),
            // Friction over velocity is what the guides are fitted for, and no mass depends on it.
            CurveSide::Friction | CurveSide::Viscous | CurveSide::Mass => {
                *over != Coordinate::Velocity
            }
            CurveSide::Carriage => true,
        });
        let drawn =
            sought.into_par_iter().map(|(over, side)| -> Result<Vec<DrawnCurve>, IdentifyError> {
                // Behind the cell nothing of the carriage moves.
                let on_motor = side == CurveSide::Motor;
                let beside = if on_motor { &nothing } else { &moving };
                let drawn =
                    curve_drawing::propose(&columns.residual(on_motor), over, side, beside)?;
                let worth = drawn.into_iter().filter_map(|one| {
                    let mut with = start.with(one.part);
                    one.moved
                        .iter()
                        .for_each(|coordinate| with.set(coordinate.id, coordinate.value));
                    // Values that do not go together are no curve.
                    let left = errors(&with, self.train, self.holdout).ok()?;
                    let gain = start_score.holdout - self.quick_score(&left).holdout;
                    let worth = gain > self.criteria.fall;
                    worth.then_some(DrawnCurve { with, damping: one.damping, gain })
                });
                Ok(worth.collect())
            });
        Ok(drawn.collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hypothesis::Tolerances;
    use crate::record::measured::Measured;
    use crate::search::{Silent, Verdict, search};
    use crate::test_records::recording;
    use friction_stage_core::model::{Curve, Jump, StageModel};
    use friction_stage_core::plant::EffectDescriptor;

    /// A force on the carriage at knots between -5 and 25 mm, N.
    fn with_force_over_position(values: Vec<f64>) -> StageModel {
        let (coordinate, side) = (Coordinate::Position, CurveSide::Carriage);
        let curve = Curve { coordinate, side, from: -0.005, to: 0.025, values, jump: None };
        StageModel { effects: vec![EffectParameters::map(curve)], ..StageModel::default() }
    }

    #[test]
    fn a_curve_that_the_model_declares_stays_as_it_is() {
        let with_curve = |height: f64| {
            with_force_over_position(
                (0..41).map(|knot| height * (0.4 * f64::from(knot)).sin()).collect(),
            )
        };
        // Off by so little that it does not matter, and so much that another one would be nearer.
        let (model, real) = (with_curve(2.0), with_curve(2.02));
        let record = |seed, moves| {
            Measured::new(&recording(&real, seed, 0.0, moves), &model, "the record").unwrap()
        };
        let found =
            search(&model, Tolerances::default(), &record(3, 4), &record(4, 2), &Silent).unwrap();
        assert_eq!((found.verdict, found.coordinate), (Verdict::None, None));
        assert_eq!(found.after.fitted.hypothesis.model().effects, model.effects);
    }

    /// A force that steps in time is no law; one that is constant, or a spring, takes a part
    /// of it.
    #[test]
    fn laws_that_are_there_stay_with_a_curve_and_no_model_has_them() {
        let values = (0..41).map(|knot| if knot < 10 { 0.0 } else { 3.0 }).collect();
        let curve = Curve {
            coordinate: Coordinate::Time,
            side: CurveSide::Carriage,
            from: 0.0,
            to: 8.0,
            values,
            jump: None,
        };
        let cogging = EffectDescriptor::find("cogging").unwrap().parameters_of(&[3.0, 4e-3, 0.3]);
        let real = StageModel {
            effects: vec![cogging, EffectParameters::map(curve)],
            ..StageModel::default()
        };
        let model = StageModel::default();
        let record = |seed, moves| {
            Measured::new(&recording(&real, seed, 0.0, moves), &model, "the record").unwrap()
        };
        let found =
            search(&model, Tolerances::default(), &record(3, 4), &record(4, 2), &Silent).unwrap();
        let names = |one: &Hypothesis| -> Vec<String> {
            one.model().effects.into_iter().map(|effect| effect.name).collect()
        };
        let effects = names(&found.after.fitted.hypothesis);
        assert_eq!((found.verdict, found.coordinate), (Verdict::Unknown, Some(Coordinate::Time)));
        // A law of slow time may say a part of what the knots of a curve cannot.
        let others = effects.iter().filter(|name| *name != "friction_drift").collect::<Vec<_>>();
        assert_eq!(others, ["cogging", "map"], "{effects:?}");
        // None of the laws goes into a model.
        assert_eq!(names(&found.usable), ["map"]);
    }

    /// Friction of which a quarter is gone from one instant on.
    #[test]
    fn what_comes_loose_is_told_with_its_instant() {
        // A record begins half a second after the stage.
        let jump = Some(Jump { at: 3.8 + 0.5, height: -0.25 });
        let (coordinate, side) = (Coordinate::Time, CurveSide::Friction);
        let curve = Curve { coordinate, side, from: 0.0, to: 9.0, values: vec![0.0; 2], jump };
        let real =
            StageModel { effects: vec![EffectParameters::map(curve)], ..StageModel::default() };
        let model = StageModel::default();
        let record =
            |seed| Measured::new(&recording(&real, seed, 0.0, 4), &model, "the record").unwrap();
        let found = search(&model, Tolerances::default(), &record(3), &record(4), &Silent).unwrap();
        let effects = found.after.fitted.hypothesis.model().effects;
        assert_eq!(
            (found.verdict, found.coordinate),
            (Verdict::Unknown, Some(Coordinate::Time)),
            "{effects:?}"
        );
        let [EffectParameters { curve: Some(curve), .. }] = &effects[..] else {
            panic!("{effects:?}")
        };
        let jump = curve.jump.expect("a jump");
        let before = curve.corners().into_iter().rfind(|(place, _)| *place < jump.at).unwrap().1;
        assert!((jump.at - 3.8).abs() < 1e-3, "{jump:?}");
        assert!((jump.height / (1.0 + before) + 0.25).abs() < 0.03, "{curve:?}");
        // The guides are not biased towards it.
        let (left, floor) = (found.errors_after.holdout().sqrt(), found.floor.total());
        assert!(left < 1.5 * floor, "{left} N over {floor} N");
    }

    /// 3 kg are set down while the stage accelerates and brakes.
    #[test]
    fn what_is_set_down_is_told_with_its_mass() {
        let jump = Some(Jump { at: 3.8 + 0.5, height: -3.0 });
        let (coordinate, side) = (Coordinate::Time, CurveSide::Mass);
        let curve = Curve { coordinate, side, from: 0.0, to: 9.0, values: vec![0.0; 2], jump };
        let real =
            StageModel { effects: vec![EffectParameters::map(curve)], ..StageModel::default() };
        let model = StageModel::default();
        let record =
            |seed| Measured::new(&recording(&real, seed, 0.0, 4), &model, "the record").unwrap();
        let found = search(&model, Tolerances::default(), &record(3), &record(4), &Silent).unwrap();
        let effects = found.after.fitted.hypothesis.model().effects;
        assert_eq!(
            (found.verdict, found.coordinate),
            (Verdict::Unknown, Some(Coordinate::Time)),
            "{effects:?}"
        );
        let [EffectParameters { curve: Some(curve), .. }] = &effects[..] else {
            panic!("{effects:?}")
        };
        let jump = curve.jump.expect("a jump");
        assert_eq!(curve.side, CurveSide::Mass);
        assert!((jump.at - 3.8).abs() < 0.01 && (jump.height + 3.0).abs() < 0.1, "{curve:?}");
        let (left, floor) = (found.errors_after.holdout().sqrt(), found.floor.total());
        assert!(left < 1.5 * floor, "{left} N over {floor} N");
    }

    /// In one record it comes loose on the way, at the same or another instant, in others before it
    /// begins or never.
    #[test]
    fn what_comes_loose_does_so_at_an_instant_of_each_record() {
        let loose_at = |at: f64| {
            let (coordinate, side) = (Coordinate::Time, CurveSide::Friction);
            let curve = Curve {
                coordinate,
                side,
                from: 0.0,
                to: 9.0,
                values: vec![0.0; 2],
                jump: Some(Jump { at, height: -0.25 }),
            };
            StageModel { effects: vec![EffectParameters::map(curve)], ..StageModel::default() }
        };
        let model = loose_at(3.8);
        let (hypothesis, step) =
            (Hypothesis::new(&model, Tolerances::default()).unwrap(), 1.0 / 2000.0);
        for (real, expected) in
            [(3.8, 3.8..3.8), (2.3, 2.3 - step..2.3 + step), (-1.0, -step..0.0), (99.0, 4.0..99.0)]
        {
            // A record begins half a second after the stage.
            let measured =
                Measured::new(&recording(&loose_at(real + 0.5), 3, 0.0, 4), &model, "the record")
                    .unwrap();
            let here = hypothesis.in_record(&measured).unwrap();
            let found = here.effects[0].value_of("jump_at").unwrap();
            assert!(expected.contains(&found) || found == expected.start, "{real} s: {found} s");
            let floor = hypothesis.floor(&measured).total();
            let left = here.missing(&measured, Sides::BOTH).unwrap().rms();
            // Half a sample of a quarter of the friction is two floors over this record.
            assert!(left < 3.0 * floor, "{real} s: {left} N over {floor} N");
        }
    }

    /// A bump that is wide against the travel is nearly the sum of a few ripples.
    #[test]
    fn a_curve_is_not_taken_for_the_ripples_that_add_up_to_it() {
        let bump = |knot: i32| 4.0 * (-(f64::from(knot) - 20.0).powi(2) / 8.0).exp();
        let real = with_force_over_position((0..41).map(bump).collect());
        let model = StageModel::default();
        let record = |seed, moves| {
            Measured::new(&recording(&real, seed, 0.0, moves), &model, "the record").unwrap()
        };
        let found =
            search(&model, Tolerances::default(), &record(3, 4), &record(4, 2), &Silent).unwrap();
        let effects: Vec<String> =
            found.after.fitted.hypothesis.model().effects.iter().map(|e| e.name.clone()).collect();
        assert_eq!(
            (found.verdict, found.coordinate),
            (Verdict::Unknown, Some(Coordinate::Position))
        );
        assert_eq!(effects, ["map"]);
    }
}
