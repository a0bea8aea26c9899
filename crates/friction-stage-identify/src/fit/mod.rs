//! A hypothesis is fitted to a record: bounded least squares of the missing force over everything
//! that may move.

mod difference;
mod guide_sensitivities;
mod knot_sensitivities;
pub(crate) mod objective;
pub(crate) mod sensor_noise;
pub(crate) mod uncertainty;

use std::slice;

use nalgebra::DMatrix;
use rayon::prelude::*;

use crate::fit::objective::{derivatives, normal_of, stacked};
use crate::fit::uncertainty::{covariance_by_noise, uncertainty};
use crate::hypothesis::{FreeParameter, Hypothesis, ParameterId, Sides};
use crate::record::measured::Measured;
use crate::residual::driven::Driven;
use crate::residual::missing::Missing;
use friction_stage_core::model::ModelError;
use friction_stage_core::numerics::least_squares::{Budget, Descent, Evaluation, Problem, Range};
use friction_stage_core::plant::effects::ParameterKind;

/// Part of what a fit must still fall by to be worth anything that it must come to between two
/// derivatives: with less it gives up.
const HOPELESS: f64 = 0.05;

/// How far a fit goes.
#[derive(Clone, Copy, Debug)]
pub struct FitBudget {
    /// Of sums of squares in N^2.
    steps: Budget,
    /// Sum of squares that a fit must come below to be of use, N^2.
    goal: f64,
}

impl FitBudget {
    /// Of a fit that is compared with others.
    pub const COMPARED: FitBudget = FitBudget::of(8, 1e-4);
    /// Of a fit that only shows whether further steps may pay.
    pub(crate) const GLANCE: FitBudget = FitBudget::of(2, 1e-3);
    /// Of a fit that others build on: what it left undone would pass for another effect.
    pub const KEPT: FitBudget = FitBudget::of(30, 1e-5);

    const fn of(derivatives: usize, progress: f64) -> FitBudget {
        FitBudget { steps: Budget { derivatives, progress, least_fall: 0.0 }, goal: f64::INFINITY }
    }

    /// The same of a fit that may stop where a step brings less than this, N^2.
    pub fn ending_below(self, fall: f64) -> FitBudget {
        FitBudget { steps: Budget { least_fall: fall, ..self.steps }, ..self }
    }

    /// The same of a fit that may stop where it will hardly come below this sum of squares, N^2.
    pub fn gain_below(self, squares: f64) -> FitBudget {
        FitBudget { goal: squares.min(self.goal), ..self }
    }
}

/// A hypothesis at its best.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// The hypothesis with its values at their best.
    pub hypothesis: Hypothesis,
    /// Force that it misses on the record of the fit.
    pub missing: Missing,
    /// What the fit moved, where it ended.
    pub coordinates: Vec<FreeParameter>,
    /// Coordinates that ended on a bound.
    pub at_bound: Vec<bool>,
}

/// A fit with how well the data know it.
#[derive(Clone, Debug)]
pub struct Estimate {
    /// The fit.
    pub fitted: Fitted,
    /// Standard deviation of each coordinate around what records like this one give; infinite where
    /// the data say nothing.
    pub deviations: Vec<f64>,
    /// How far the sensors' noise takes that from the truth, by coordinate; 0 where it is not
    /// computed.
    pub shifts: Vec<f64>,
    /// Correlation matrix of the coordinates, row by row.
    pub correlations: Vec<Vec<f64>>,
}

impl Fitted {
    /// Sum of the squares of the missing force, N^2.
    pub fn squares(&self) -> f64 {
        self.missing.motor.iter().chain(&self.missing.carriage).map(|left| left * left).sum()
    }

    /// Whether a law among the effects from `first` on has a value on a bound: beyond it the law
    /// would be another one, or none. A term that has come to 0 is no doubt about the rest, and a
    /// phase has no end.
    pub(crate) fn has_law_at_bound(&self, first: usize) -> bool {
        let both = self.coordinates.iter().zip(&self.at_bound);
        both.filter(|(_, at_bound)| **at_bound).any(|(coordinate, _)| match coordinate.id {
            ParameterId::Effect { effect, value } if effect >= first => {
                let law = self.hypothesis.effects[effect].descriptor;
                let kind = law.parameters.get(value).map(|parameter| parameter.kind);
                kind.is_some_and(|kind| kind != ParameterKind::Phase)
                    && !law.is_curve()
                    && !coordinate.has_come_to_nothing()
            }
            _ => false,
        })
    }

    /// The same with its curves held.
    pub(crate) fn holding_curves(self) -> Fitted {
        let is_of_curve = |id: ParameterId| match id {
            ParameterId::Effect { effect, .. } => {
                self.hypothesis.effects[effect].descriptor.is_curve()
            }
            _ => false,
        };
        let both = self.coordinates.into_iter().zip(self.at_bound);
        let (coordinates, at_bound) =
            both.filter(|(coordinate, _)| !is_of_curve(coordinate.id)).unzip();
        Fitted {
            hypothesis: self.hypothesis.holding_curves(true),
            missing: self.missing,
            coordinates,
            at_bound,
        }
    }

    /// Mean square of the force on another record that is not known after this fit, N^2: the trace
    /// of J C J^T over its rows, with the derivatives J there and the covariance C of the
    /// coordinates. `measured` is a record like that of the fit in which there is nothing but the
    /// hypothesis and noise, `there` the hypothesis in the other record, `sides` as in the fit.
    pub(crate) fn left_open(
        &self,
        measured: &Measured,
        there: &Hypothesis,
        other: &Measured,
        sides: Sides,
    ) -> Result<f64, ModelError> {
        let noise = self.hypothesis.floor(measured).carriage;
        let derivatives = |hypothesis: &Hypothesis, measured: &Measured| {
            let fit = ForceFit::new(&self.coordinates, measured, sides, noise);
            let coordinates = self.coordinates.clone();
            let point = fit.along(hypothesis.clone(), coordinates, &Driven::default())?;
            Ok::<_, ModelError>((fit.derivatives(&point)?, point.state.missing))
        };
        let (jacobian, missing) = derivatives(&self.hypothesis, measured)?;
        let (coordinates, at_bound) = (&self.coordinates, &self.at_bound);
        let covariance = covariance_by_noise(&jacobian, &missing, coordinates, at_bound, noise);
        let (jacobian, missing) = derivatives(there, other)?;
        let mut from = 0;
        let mut open = 0.0;
        for rows in [missing.motor.len(), missing.carriage.len()] {
            if rows > 0 {
                let sensitivities = jacobian.rows(from, rows).into_owned();
                open += covariance.component_mul(&normal_of(&sensitivities)).sum() / rows as f64;
            }
            from += rows;
        }
        Ok(open.max(0.0))
    }

    /// How well the record of the fit knows its coordinates. `sides` as in the fit.
    pub fn estimate(self, measured: &Measured, sides: Sides) -> Result<Estimate, ModelError> {
        let noise = self.hypothesis.floor(measured).carriage;
        let fit = ForceFit::new(&self.coordinates, measured, sides, noise);
        // Of the hypothesis as it stands, whatever was set in it after the fit.
        let point =
            fit.along(self.hypothesis.clone(), self.coordinates.clone(), &Driven::default())?;
        let jacobian = fit.derivatives(&point)?;
        let (deviations, correlations) = uncertainty(
            &jacobian,
            &point.residual,
            &point.state.missing,
            &self.coordinates,
            &self.at_bound,
            noise,
        );
        let shifts = vec![0.0; self.coordinates.len()];
        let fitted = Fitted { missing: point.state.missing, ..self };
        Ok(Estimate { fitted, deviations, shifts, correlations })
    }
}

impl Estimate {
    /// How far a coordinate may be from the truth: standard deviation and shift.
    pub fn deviation(&self, index: usize) -> f64 {
        self.deviations[index].hypot(self.shifts[index])
    }
}

/// What a fit compares, on a record.
struct ForceFit<'a> {
    measured: &'a Measured,
    sides: Sides,
    /// Weight of what is declared, N.
    noise: f64,
    ranges: Vec<Range>,
}

/// A hypothesis along the record of its fit.
struct Along {
    hypothesis: Hypothesis,
    coordinates: Vec<FreeParameter>,
    driven: Driven,
    missing: Missing,
}

impl<'a> ForceFit<'a> {
    fn new(
        coordinates: &[FreeParameter],
        measured: &'a Measured,
        sides: Sides,
        noise: f64,
    ) -> ForceFit<'a> {
        let range = |one: &FreeParameter| Range { scale: one.scale, bounds: one.bounds };
        ForceFit { measured, sides, noise, ranges: coordinates.iter().map(range).collect() }
    }

    /// A hypothesis as it stands; `near` is of one nearby, or the default.
    fn along(
        &self,
        hypothesis: Hypothesis,
        coordinates: Vec<FreeParameter>,
        near: &Driven,
    ) -> Result<Evaluation<Along>, ModelError> {
        let driven = hypothesis.driven(self.measured, self.sides, near)?;
        let missing = hypothesis.missing_of(&driven, self.measured, self.sides);
        let residual = stacked(&missing, &coordinates, self.noise);
        Ok(Evaluation {
            values: coordinates.iter().map(|coordinate| coordinate.value).collect(),
            squares: residual.norm_squared(),
            residual,
            state: Along { hypothesis, coordinates, driven, missing },
        })
    }

    /// Where a fit begins: inside the bounds, since a coordinate on its bound has only one way to
    /// go. A declared parameter that was biased to its bound has stood for something that the model
    /// lacked: it begins as declared, if that is nearer now.
    fn start(
        &self,
        start: &Hypothesis,
        given: Vec<FreeParameter>,
    ) -> Result<Evaluation<Along>, ModelError> {
        let is_biased = |one: &FreeParameter| {
            matches!(one.id, ParameterId::Nominal(_))
                && (one.value <= one.bounds.0 || one.value >= one.bounds.1)
        };
        let begin = |as_declared: bool| {
            let (mut hypothesis, mut coordinates) = (start.clone(), given.clone());
            for coordinate in &mut coordinates {
                let (lower, upper) = coordinate.bounds;
                let margin = 1e-3 * (upper - lower).min(coordinate.scale);
                let value =
                    if as_declared && is_biased(coordinate) { 0.0 } else { coordinate.value };
                coordinate.value = value.clamp(lower + margin, upper - margin);
                hypothesis.set(coordinate.id, coordinate.value);
            }
            self.along(hypothesis, coordinates, &Driven::default())
        };
        let biased = begin(false);
        let point = match given.iter().any(is_biased).then(|| begin(true)) {
            Some(Ok(declared))
                if biased.as_ref().is_ok_and(|biased| declared.squares > biased.squares) =>
            {
                biased
            }
            Some(Ok(declared)) => Ok(declared),
            _ => biased,
        };
        // Values may not go together any more a little inside their bounds: then the start is as it
        // was given.
        point.or_else(|_| self.along(start.clone(), given, &Driven::default()))
    }
}

impl Problem for ForceFit<'_> {
    type State = Along;
    type Error = ModelError;

    fn ranges(&self) -> &[Range] {
        &self.ranges
    }

    fn at(&self, values: &[f64], near: &Along) -> Result<Evaluation<Along>, ModelError> {
        let (mut hypothesis, mut coordinates) = (near.hypothesis.clone(), near.coordinates.clone());
        for (coordinate, value) in coordinates.iter_mut().zip(values) {
            coordinate.value = *value;
            hypothesis.set(coordinate.id, *value);
        }
        self.along(hypothesis, coordinates, &near.driven)
    }

    fn derivatives(&self, point: &Evaluation<Along>) -> Result<DMatrix<f64>, ModelError> {
        let Along { hypothesis, coordinates, driven, .. } = &point.state;
        derivatives(
            hypothesis,
            coordinates,
            driven,
            self.measured,
            self.sides,
            &point.residual,
            self.noise,
        )
    }

    fn normal(&self, jacobian: &DMatrix<f64>) -> DMatrix<f64> {
        normal_of(jacobian)
    }
}

/// One of the fits of a race.
struct Runner<'a> {
    fit: ForceFit<'a>,
    descent: Descent<Along>,
    given_up: bool,
}

impl<'a> Runner<'a> {
    fn new(
        start: &Hypothesis,
        measured: &'a Measured,
        sides: Sides,
    ) -> Result<Runner<'a>, ModelError> {
        let given = start.coordinates(sides, measured.cell.is_some());
        let fit = ForceFit::new(&given, measured, sides, start.floor(measured).carriage);
        let descent = Descent::from(fit.start(start, given)?);
        Ok(Runner { fit, descent, given_up: false })
    }

    /// Whether it will hardly come below this sum of squares, N^2.
    fn is_hopeless(&self, goal: f64) -> bool {
        self.descent.fallen < HOPELESS * (self.descent.point.squares - goal)
    }

    fn fitted(self) -> Fitted {
        let Along { hypothesis, coordinates, missing, .. } = self.descent.point.state;
        let is_at_bound = |c: &FreeParameter| {
            let margin = 1e-6 * c.scale;
            c.value <= c.bounds.0 + margin || c.value >= c.bounds.1 - margin
        };
        let at_bound = coordinates.iter().map(is_at_bound).collect();
        Fitted { hypothesis, missing, coordinates, at_bound }
    }
}

/// Moves everything that may move on these sides until the missing force is least.
pub fn fit(
    start: &Hypothesis,
    measured: &Measured,
    sides: Sides,
    effort: FitBudget,
) -> Result<Fitted, ModelError> {
    race(slice::from_ref(start), measured, sides, effort, 1.0).remove(0)
}

/// Fits from several starts side by side, each as far as it may become the best one: it gives up
/// where it will hardly come below `within` times the squares of the best so far.
pub fn race(
    starts: &[Hypothesis],
    measured: &Measured,
    sides: Sides,
    effort: FitBudget,
    within: f64,
) -> Vec<Result<Fitted, ModelError>> {
    let mut fits: Vec<_> =
        starts.par_iter().map(|start| Runner::new(start, measured, sides)).collect();
    let going = |fit: &Result<Runner, ModelError>| {
        fit.as_ref().is_ok_and(|fit| !fit.given_up && !fit.descent.ended(&effort.steps))
    };
    while fits.iter().any(going) {
        fits.par_iter_mut().filter(|fit| going(fit)).for_each(|fit| {
            let advanced =
                fit.as_mut().map(|Runner { fit, descent, .. }| descent.advance(fit, &effort.steps));
            if let Ok(Err(error)) = advanced {
                *fit = Err(error);
            }
        });
        let squares = fits.iter().flatten().map(|fit| fit.descent.point.squares);
        let goal = effort.goal.min(within * squares.fold(f64::INFINITY, f64::min));
        fits.iter_mut().flatten().for_each(|fit| fit.given_up |= fit.is_hopeless(goal));
    }
    fits.into_iter().map(|fit| fit.map(Runner::fitted)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hypothesis::nominal_parameter::NominalParameter;
    use crate::hypothesis::{Part, Tolerances};
    use crate::test_records::recording;
    use friction_stage_core::model::StageModel;
    use friction_stage_core::plant::EffectDescriptor;

    fn declared() -> Hypothesis {
        Hypothesis::new(&StageModel::default(), Tolerances::default()).unwrap()
    }

    fn cogging(period: f64) -> Part {
        Part {
            descriptor: EffectDescriptor::find("cogging").unwrap(),
            values: vec![3.0, period, 0.3],
        }
    }

    /// With a force that comes and goes over 4 mm.
    fn record_with_cogging() -> Measured {
        let real =
            StageModel { effects: vec![cogging(4e-3).parameters()], ..StageModel::default() };
        Measured::new(&recording(&real, 3, 0.0, 4), &StageModel::default(), "the record").unwrap()
    }

    /// Coulomb friction on its bound, of guides that have as much or what is declared.
    #[test]
    fn what_was_biased_to_its_bound_begins_as_declared_if_that_is_nearer() {
        let place = ParameterId::Nominal(NominalParameter::CoulombForce);
        let bound = |hypothesis: &Hypothesis| {
            let coordinates = hypothesis.coordinates(Sides::BOTH, true);
            coordinates.into_iter().find(|one| one.id == place).expect("a coordinate").bounds.1
        };
        let mut biased = declared();
        biased.set(place, bound(&biased));
        for (real, expected) in [(biased.model(), bound(&biased)), (StageModel::default(), 0.0)] {
            let measured =
                Measured::new(&recording(&real, 3, 0.0, 2), &StageModel::default(), "the record")
                    .unwrap();
            let given = biased.coordinates(Sides::BOTH, true);
            let fit = ForceFit::new(&given, &measured, Sides::BOTH, 0.0);
            let began = fit.start(&biased, given).unwrap().state.coordinates;
            let began = began.iter().find(|one| one.id == place).expect("a coordinate");
            // A little inside.
            assert!((began.value - expected).abs() < 1e-3, "{} of {expected}", began.value);
            assert!(began.value < began.bounds.1);
        }
    }

    /// Side by side with one that lacks a force of 5 N, which gives up, and with one that has it
    /// from another start, which does not.
    #[test]
    fn side_by_side_the_best_one_ends_as_it_does_alone() {
        let push = |force: f64| Part {
            descriptor: EffectDescriptor::find("constant_force").unwrap(),
            values: vec![force],
        };
        let real = StageModel { effects: vec![push(5.0).parameters()], ..StageModel::default() };
        let measured =
            Measured::new(&recording(&real, 3, 0.0, 4), &StageModel::default(), "the record")
                .unwrap();
        let starts = [declared(), declared().with(push(1.0)), declared().with(push(8.0))];
        let alone = starts
            .each_ref()
            .map(|start| fit(start, &measured, Sides::BOTH, FitBudget::KEPT).unwrap());
        let raced: Vec<Fitted> = race(&starts, &measured, Sides::BOTH, FitBudget::KEPT, 1.0)
            .into_iter()
            .flatten()
            .collect();
        let best = if alone[1].squares() < alone[2].squares() { 1 } else { 2 };
        assert_eq!(raced[best].squares(), alone[best].squares());
        assert!(
            (raced[best].hypothesis.effects[0].values[0] - 5.0).abs() < 0.1,
            "{:?}",
            raced[best].hypothesis.effects
        );
        assert!(raced[0].squares() > 10.0 * raced[best].squares());
        assert!(raced.iter().zip(&alone).all(|(raced, alone)| raced.squares() >= alone.squares()));
        let without_a_limit = race(&starts, &measured, Sides::BOTH, FitBudget::KEPT, f64::INFINITY);
        let squares: Vec<f64> = without_a_limit.iter().flatten().map(Fitted::squares).collect();
        assert_eq!(squares, alone.each_ref().map(Fitted::squares));
    }

    /// From a period of 4.25 mm.
    #[test]
    fn a_fit_between_rounds_ends_where_its_steps_bring_too_little() {
        let measured = record_with_cogging();
        let start = declared().with(cogging(4.25e-3));
        let squares = |effort| fit(&start, &measured, Sides::BOTH, effort).unwrap().squares();
        let (to_its_end, at_once) =
            (squares(FitBudget::KEPT), squares(FitBudget::KEPT.ending_below(f64::INFINITY)));
        let between = squares(FitBudget::KEPT.ending_below(1e-3 * to_its_end));
        assert!(at_once > 1.1 * to_its_end, "{at_once} N^2, {to_its_end} N^2");
        assert!((between / to_its_end - 1.0).abs() < 0.01, "{between} N^2, {to_its_end} N^2");
    }

    /// From periods so far off that it has to find its way: of what is still to come a derivative
    /// brings as little as 8 %.
    #[test]
    fn a_fit_that_has_a_long_way_to_what_it_is_worth_is_not_given_up() {
        let measured = record_with_cogging();
        for period in [4.3e-3, 4.32e-3, 4.34e-3, 4.35e-3, 4.38e-3] {
            let start = declared().with(cogging(period));
            let squares = |effort| fit(&start, &measured, Sides::BOTH, effort).unwrap().squares();
            let to_its_end = squares(FitBudget::KEPT);
            assert!(to_its_end < 3.0, "{period}: {to_its_end} N^2");
            assert_eq!(
                squares(FitBudget::KEPT.gain_below(1.5 * to_its_end)),
                to_its_end,
                "{period}"
            );
        }
    }

    /// A spring that the model lacks.
    #[test]
    fn a_fit_that_is_not_worth_going_on_with_ends_early_and_says_where() {
        let measured = {
            let cable = EffectDescriptor::find("cable_chain").unwrap();
            let values =
                cable.parameters.iter().map(|parameter| parameter.default.unwrap_or(0.0)).collect();
            let mut part = Part { descriptor: cable, values };
            part.values[0] = 300.0;
            let real = StageModel { effects: vec![part.parameters()], ..StageModel::default() };
            Measured::new(&recording(&real, 3, 0.0, 4), &StageModel::default(), "the record")
                .unwrap()
        };
        let to_its_end = fit(&declared(), &measured, Sides::BOTH, FitBudget::KEPT).unwrap();
        let given_up =
            fit(&declared(), &measured, Sides::BOTH, FitBudget::KEPT.gain_below(0.0)).unwrap();
        assert!(
            given_up.squares() >= to_its_end.squares()
                && given_up.squares() < 2.0 * to_its_end.squares()
        );
        let reachable = FitBudget::KEPT.gain_below(2.0 * to_its_end.squares());
        assert_eq!(
            fit(&declared(), &measured, Sides::BOTH, reachable).unwrap().squares(),
            to_its_end.squares()
        );
    }
}
