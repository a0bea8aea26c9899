//! Guides that are not those of the model.

use crate::error::IdentifyError;
use crate::fit::{FitBudget, fit};
use crate::hypothesis::nominal_parameter::NominalParameter;
use crate::hypothesis::{Hypothesis, ParameterId, Sides, Tolerances};
use friction_stage_core::model::StageModel;

use super::curves::UNEXPLAINED;
use super::different_guides::with_different_guides;
use super::state::{Search, errors};

/// Tolerance of a guide of which nothing is known.
const ANY_GUIDE: f64 = 9.0;
/// Tolerances beyond which a parameter of sliding is another guide's, whatever else there may be.
/// Assumed.
const FAR: f64 = 3.0;

impl Search<'_> {
    /// Guides whose friction is beyond its tolerance are no effect that a model lacks. Where the
    /// declared ones leave more than noise and end on a bound, and others explain everything, these
    /// are the answer, and the search would dress them up as laws.
    pub(super) fn refuse_other_guides(
        &self,
        declared: &StageModel,
        tolerances: Tolerances,
    ) -> Result<(), IdentifyError> {
        let of_friction = |id: ParameterId| match id {
            ParameterId::Nominal(one) => NominalParameter::SLIDING.contains(&one),
            _ => false,
        };
        let biased = self
            .before
            .coordinates
            .iter()
            .zip(&self.before.at_bound)
            .any(|(one, bound)| *bound && of_friction(one.id));
        if !biased || self.is_noise(&self.errors_before) {
            return Ok(());
        }
        let wide = Tolerances { guides: ANY_GUIDE, presliding: ANY_GUIDE, ..tolerances };
        let other =
            fit(&Hypothesis::new(declared, wide)?, self.train, Sides::BOTH, FitBudget::KEPT)?
                .hypothesis;
        // Parameters that make no guide are no answer.
        let Ok(stated) = Hypothesis::new(&other.model(), tolerances) else { return Ok(()) };
        let again = fit(&stated, self.train, Sides::BOTH, FitBudget::COMPARED)?;
        let again =
            with_different_guides(&again.hypothesis, self.train, FitBudget::KEPT)?.hypothesis;
        let left = errors(&again, self.train, self.holdout)?;
        let mut farthest = 1.0f64;
        let beyond: Vec<String> = NominalParameter::SLIDING
            .into_iter()
            .filter_map(|one| {
                let value =
                    |hypothesis: &Hypothesis| hypothesis.declared_value(one, self.train.rate);
                let (name, unit) = (one.name(), one.unit());
                let (is, was) =
                    (value(&again), value(&Hypothesis::new(declared, tolerances).ok()?));
                let factor = (is / was).max(was / is);
                // The others show only where a stage hardly moves: what a law does there bends them
                // far.
                if matches!(one, NominalParameter::CoulombForce | NominalParameter::ViscousFriction)
                {
                    farthest = farthest.max(factor);
                }
                (factor > 1.0 + tolerances.guides)
                    .then(|| format!("{name} is {is:.4} {unit}, declared {was:.4} {unit}"))
            })
            .collect();
        // A law may bend a parameter a little beyond its tolerance, and leaves something then; no
        // law bends it far.
        let all = self.is_all_but_noise(&left);
        let nearly =
            self.beyond_noise(&left) < UNEXPLAINED * self.beyond_noise(&self.errors_before);
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
}
