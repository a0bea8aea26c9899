//! Whether the encoder sees the pre-sliding: how far the carriage moves after it has turned round
//! before the force has turned, too.

use serde::Serialize;

use super::motion::Travel;
use super::{Examiner, RoughFit};
use crate::signals::Signal;
use friction_stage_core::model::StageModel;

/// Part of Coulomb friction that the force must reach in the new direction: three quarters of its
/// turn. A bristle has gone by 1.4 break-away distances there.
const REACHED: f64 = 0.5;
/// Standard deviations of the encoder's noise that the travel must be. Assumed: any travel shows as
/// one of its counts or none, and this is between one and two of them.
const SEEN: f64 = 5.0;

/// Travel in pre-sliding, and what the encoder sees of it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Presliding {
    /// Travel in which the force turns, m: as the model declares it, else the median of the
    /// reversals.
    pub travel: f64,
    /// Whether a model declares it.
    pub declared: bool,
    /// Noise of the encoder, m, counts included.
    pub noise: f64,
}

impl Presliding {
    /// Whether the encoder tells it from its noise.
    pub(super) fn is_seen(&self) -> bool {
        self.travel > SEEN * self.noise
    }
}

/// Longest break-away distance of the guides, m.
fn declared(model: &StageModel) -> Option<f64> {
    let guides = model.resolved_guides().ok()?;
    guides.iter().map(|guide| guide.static_force / guide.stiffness).reduce(f64::max)
}

impl Examiner<'_> {
    /// The pre-sliding, where a model or the force at the reversals shows it.
    pub(super) fn presliding(
        &self,
        fit: Option<(Signal, RoughFit)>,
        noise: f64,
        turn: f64,
    ) -> Option<Presliding> {
        if let Some(travel) = self.model.and_then(declared) {
            return Some(Presliding { travel, declared: true, noise });
        }
        let (signal, fit) = fit?;
        let mut travels = self.travels_of_turns(self.column(signal), fit, turn);
        if travels.is_empty() {
            return None;
        }
        let middle = travels.len() / 2;
        let travel = *travels.select_nth_unstable_by(middle, f64::total_cmp).1;
        Some(Presliding { travel, declared: false, noise })
    }

    /// Per reversal after which the force turns, how far the carriage has gone by then. What
    /// accelerates it changes little on so short a way and is that at the reversal.
    fn travels_of_turns(&self, force: &[f64], fit: RoughFit, turn: f64) -> Vec<f64> {
        let (x, w) = (self.column(Signal::Position), self.half);
        let base = w as f64 * self.step;
        let mut travels = Vec::new();
        for segment in &self.segments {
            let mut travel = Travel::from(x[segment.start], turn, self.walk());
            for row in segment.clone() {
                let since = travel.rows + 1;
                if travel.goes_to(x[row]).is_none() {
                    continue;
                }
                let turned = row - since;
                if turned < segment.start + w || turned + w >= segment.end {
                    continue;
                }
                let (before, here, after) = (x[turned - w], x[turned], x[turned + w]);
                let acceleration = ((after - here) - (here - before)) / (base * base);
                let direction = (x[row] - here).signum();
                let level = fit.offset + fit.mass * acceleration;
                let mut rows = turned..segment.end;
                let has_turned =
                    |row: &usize| direction * (force[*row] - level) >= REACHED * fit.coulomb;
                // Not beyond the next reversal.
                let goes_on = |row: &usize| direction * (x[*row] - here) >= -turn;
                let found = rows.by_ref().take_while(goes_on).find(has_turned);
                travels.extend(found.map(|row| (x[row] - here).abs()));
            }
        }
        travels
    }
}
