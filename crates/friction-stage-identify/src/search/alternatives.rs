//! What could stand in the place of a law beside all that was found: a simpler one, or one that
//! says the same.

use crate::error::IdentifyError;
use crate::fit::Fitted;
use crate::hypothesis::{Hypothesis, Part, Sides};
use friction_stage_core::plant::Side;

use super::columns::Columns;
use super::different_guides::with_different_guides;
use super::gain::{HALF_OF_THE_REST, RIVAL};
use super::selection::{Errors, Evidence, Inseparable, Outcome};
use super::state::{Search, correlation_of_taken, errors};

impl Search<'_> {
    /// A law was chosen while effects that came later were still in the residual, and its values,
    /// or those of the others, stood for these: a spring with a far centre is a constant force, a
    /// gain of the cell beside one of the motor is an encoder of another scale. Those that came
    /// close to it in its round, and those that are rivals of another law that was found, are put
    /// in its place: where one with fewer parameters leaves about as much, that one stays; one with
    /// as many that does is a rival.
    pub(super) fn weigh_alternatives(&mut self) -> Result<(), IdentifyError> {
        for index in self.declared_effects()..self.best.hypothesis.effects.len() {
            let Some(row) = self.row_of(index) else { continue };
            let chosen = self.evidence[row].clone();
            let bare = self.best.hypothesis.without(index);
            let rows: Vec<usize> = (0..self.evidence.len())
                .filter(|row| self.may_stand_for(&chosen, &self.evidence[*row], &bare))
                .collect();
            if rows.is_empty() {
                continue;
            }
            self.watch.progress(&format!("other laws than {}", chosen.name), 0.96);
            let columns = Columns::new(&bare, self.train)?;
            for row in rows {
                let one = self.evidence[row].clone();
                let Some((fitted, found)) = self.in_place_of(index, &one, &columns)? else {
                    continue;
                };
                if one.free < chosen.free && self.leaves_about_as_much(&found) {
                    self.give_way(index, row, fitted, found);
                    break;
                }
                if one.free == chosen.free && self.does_as_well(&found, &chosen) {
                    self.evidence[row].outcome = Outcome::Equal;
                    let without = bare.missing(self.train, Sides::BOTH)?;
                    let correlation =
                        correlation_of_taken(&without, &self.best.missing, &fitted.missing);
                    self.inseparable.push(Inseparable {
                        effect: chosen.name,
                        rival: one.name,
                        correlation,
                    });
                }
            }
        }
        Ok(())
    }

    /// Whether a law that was beaten in the round of a chosen one is worth a fit in its place: no
    /// more parameters, not there beside it, and half of its gain or a rival of another law. What
    /// is one force with one of the laws can be one with any of them.
    fn may_stand_for(&self, chosen: &Evidence, one: &Evidence, bare: &Hypothesis) -> bool {
        let was_beaten =
            one.round == chosen.round && matches!(one.outcome, Outcome::Beaten | Outcome::TooSmall);
        let comes_close = one.holdout_gain >= HALF_OF_THE_REST * chosen.holdout_gain;
        let is_rival = self
            .inseparable
            .iter()
            .any(|pair| pair.rival == one.name && pair.effect != chosen.name);
        was_beaten
            && one.free <= chosen.free
            && (comes_close || is_rival)
            && !bare.effects.iter().any(|part| part.descriptor.name == one.name)
    }

    /// What was found with another law in the place of one of its effects.
    fn in_place_of(
        &self,
        index: usize,
        one: &Evidence,
        columns: &Columns,
    ) -> Result<Option<(Fitted, Errors)>, IdentifyError> {
        let descriptor = one.part.descriptor;
        let on_motor = one.side == Side::Motor && self.has_cell();
        // Beside what came later it may not show by itself.
        let values = descriptor
            .propose(&columns.residual(on_motor))
            .unwrap_or_else(|| one.part.values.clone());
        let mut other = self.best.hypothesis.clone();
        other.effects[index] = Part { descriptor, values };
        // Values that do not go together are no law in place of another.
        let Ok(fitted) = with_different_guides(&other, self.train, self.in_place_of_best()) else {
            return Ok(None);
        };
        let found = errors(&fitted.hypothesis, self.train, self.holdout)?;
        Ok(Some((fitted, found)))
    }

    /// Whether a fit with another law in the place of a chosen one does as well: it gives away as
    /// little of the gain as a rival in a round may, and no more than the fit of a carriage does
    /// without reason. Where laws that are not quite right leave more than noise, half of that
    /// tells nothing either.
    fn does_as_well(&self, found: &Errors, chosen: &Evidence) -> bool {
        let given_away = found.holdout() - self.best_errors.holdout();
        let says_nothing = self
            .threshold(Side::Carriage)
            .max(HALF_OF_THE_REST * self.beyond_noise(&self.best_errors));
        given_away <= ((1.0 - RIVAL) * chosen.holdout_gain).min(says_nothing)
    }

    /// An effect goes for the law of a row of the evidence that leaves as much with less.
    fn give_way(&mut self, index: usize, row: usize, fitted: Fitted, found: Errors) {
        let name = self.evidence[row].name;
        let mut others = self.runners_up[index].clone();
        others.retain(|(other, _)| *other != name);
        self.strike(index);
        self.runners_up.insert(index, others);
        self.evidence[row].outcome = Outcome::Chosen;
        (self.best, self.best_errors) = (fitted, found);
    }
}

#[cfg(test)]
mod tests {
    use super::super::rounds::tests::tried;
    use super::super::tests::part;
    use super::*;
    use crate::fit::{FitBudget, fit};
    use crate::hypothesis::Tolerances;
    use crate::record::measured::Measured;
    use crate::search::Silent;
    use crate::test_records::recording;
    use friction_stage_core::model::StageModel;

    /// A spring whose centre is far off says no more than a constant force; one whose centre is
    /// within the travel says more.
    #[test]
    fn a_law_that_says_no_more_than_a_simpler_one_gives_way_to_it() {
        let model = StageModel::default();
        for (hidden, expected) in [
            (part("constant_force", &[("amplitude", 2.0)]), "constant_force"),
            (part("cable_chain", &[("stiffness", 200.0), ("center", 0.0)]), "cable_chain"),
        ] {
            let real = StageModel { effects: vec![hidden.parameters()], ..model.clone() };
            let record = |seed, moves| {
                Measured::new(&recording(&real, seed, 0.0, moves), &model, "the record").unwrap()
            };
            let (train, holdout) = (record(3, 6), record(4, 4));
            let start = Hypothesis::new(&model, Tolerances::default()).unwrap();
            let mut search = Search::new(&start, &train, &holdout, &Silent).unwrap();
            let spring = match expected {
                "cable_chain" => hidden,
                _ => part("cable_chain", &[("stiffness", 0.2), ("center", -10.0)]),
            };
            search
                .take(fit(&start.with(spring), &train, Sides::BOTH, FitBudget::KEPT).unwrap())
                .unwrap();
            let mut rows = tried(&[("cable_chain", 2, 1.0), ("constant_force", 1, 0.9)]);
            rows[0].one.outcome = Outcome::Chosen;
            search.evidence = rows.into_iter().map(|tried| tried.one).collect();
            search.runners_up.push(vec![("constant_force", 0.1)]);
            search.weigh_alternatives().unwrap();
            let effects = &search.best.hypothesis.effects;
            assert_eq!(
                effects.iter().map(|part| part.descriptor.name).collect::<Vec<_>>(),
                [expected],
                "{effects:?}"
            );
            let chosen = search.evidence.iter().find(|one| one.outcome == Outcome::Chosen).unwrap();
            assert_eq!((chosen.name, search.runners_up.len()), (expected, 1));
        }
    }

    /// A motor that gives more and an encoder of another scale are a cell and a motor of other
    /// gains. Each alone is what it is.
    #[test]
    fn a_law_that_says_the_same_beside_all_that_was_found_is_a_rival() {
        let model = StageModel::default();
        let gain = part("motor_gain", &[("fraction", 0.019)]);
        let scale = part("encoder_scale", &[("fraction", -0.035)]);
        let of_cell = part("force_cell_gain", &[("fraction", 0.019)]);
        let known = Inseparable { effect: "motor_gain", rival: "encoder_scale", correlation: 1.0 };
        let both = (vec![gain.clone(), scale], vec![of_cell.clone(), gain]);
        for ((hidden, found), of_scale, known, expected) in [
            (both.clone(), 0.6, None, true),
            (both.clone(), 0.1, None, false),
            // What is a rival of the one may be one of the other.
            (both, 0.1, Some(known), true),
            ((vec![of_cell.clone()], vec![of_cell]), 0.6, None, false),
        ] {
            let real = StageModel {
                effects: hidden.iter().map(Part::parameters).collect(),
                ..model.clone()
            };
            let record = |seed, moves| {
                Measured::new(&recording(&real, seed, 0.0, moves), &model, "the record").unwrap()
            };
            let (train, holdout) = (record(3, 6), record(4, 4));
            let start = Hypothesis::new(&model, Tolerances::default()).unwrap();
            let mut search = Search::new(&start, &train, &holdout, &Silent).unwrap();
            let laws = found.iter().fold(start.clone(), |laws, part| laws.with(part.clone()));
            search.take(fit(&laws, &train, Sides::BOTH, FitBudget::KEPT).unwrap()).unwrap();
            let mut rows = tried(&[("force_cell_gain", 1, 1.0), ("encoder_scale", 1, of_scale)]);
            rows[0].one.outcome = Outcome::Chosen;
            search.evidence = rows.into_iter().map(|tried| tried.one).collect();
            search.inseparable.extend(known);
            search.weigh_alternatives().unwrap();
            let is_rival = |pair: &Inseparable| {
                (pair.effect, pair.rival) == ("force_cell_gain", "encoder_scale")
            };
            assert_eq!(
                search.inseparable.iter().any(is_rival),
                expected,
                "{:?}",
                search.inseparable
            );
            assert!(
                search.inseparable.iter().all(|pair| pair.correlation > 0.9),
                "{:?}",
                search.inseparable
            );
        }
    }
}
