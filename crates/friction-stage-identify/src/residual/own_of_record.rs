//! What each record has for itself of a hypothesis: phases that count from its start, the instant
//! of a jump, and the knots of ripples whose phase wanders.

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};

use friction_stage_core::model::{CurveSide, ModelError};
use friction_stage_core::plant::effects::{ParameterKind, RecordSpecific};

use crate::hypothesis::{Hypothesis, Part, Sides};
use crate::record::measured::Measured;
use crate::residual::driven::Driven;
use crate::residual::slipping::Slipping;

/// Part of what is left with a jump at an instant that must be left with it at another one, for
/// this to be that of the record. Assumed.
const ANOTHER_INSTANT: f64 = 0.9;

impl Hypothesis {
    /// The same in another record: phases that count from the start of a record are those that fit
    /// this one best, and an instant at which a curve over the time jumps is another one where that
    /// is much better. Amplitudes, frequencies and heights stay.
    pub fn in_record(&self, measured: &Measured) -> Result<Hypothesis, ModelError> {
        let mut here = self.clone();
        for effect in 0..self.effects.len() {
            let descriptor = self.effects[effect].descriptor;
            if let Some(jumping) = here.jumping_elsewhere(effect, measured)? {
                let left = |hypothesis: &Hypothesis| {
                    Ok::<_, ModelError>(hypothesis.missing(measured, Sides::BOTH)?.squares())
                };
                let ((motor, carriage), (motor_there, carriage_there)) =
                    (left(&here)?, left(&jumping)?);
                if motor_there + carriage_there < ANOTHER_INSTANT * (motor + carriage) {
                    here = jumping;
                }
            }
            if !matches!(descriptor.record_specific, RecordSpecific::Phase) {
                continue;
            }
            let (Some(frequency), Some(phase)) = (
                descriptor.place_of(ParameterKind::Frequency),
                descriptor.place_of(ParameterKind::Phase),
            ) else {
                continue;
            };
            let frequency = here.effects[effect].values[frequency];
            let missing = here.without(effect).missing(measured, Sides::CARRIAGE)?;
            let time = measured.at_rows(&measured.time);
            let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
            for (time, force) in time.iter().zip(&missing.carriage) {
                let (sine, cosine) = (TAU * frequency * time).sin_cos();
                let row = Vector3::new(sine, cosine, 1.0);
                normal += row * row.transpose();
                right += row * *force;
            }
            if let Some(factors) = normal.cholesky() {
                let best = factors.solve(&right);
                here.effects[effect].values[phase] = best[1].atan2(best[0]);
            }
        }
        Ok(here)
    }

    /// Effects of this one in a record ([`Hypothesis::in_record`]) that differ from these: what
    /// that record has for itself.
    pub fn own_of<'a>(&self, in_record: &'a Hypothesis) -> Vec<&'a Part> {
        let both = in_record.effects.iter().zip(&self.effects);
        both.filter(|(there, here)| there != here).map(|(there, _)| there).collect()
    }

    /// The same with the jump of a curve over the time at the instant of this record, to a sample,
    /// that leaves least; `None` where there is no jump, or there cannot be one at any instant.
    /// Before it is what a curve without the jump leaves, and behind it what one leaves that has
    /// jumped from the start: bristles forget the difference within micrometres.
    pub(crate) fn jumping_elsewhere(
        &self,
        effect: usize,
        measured: &Measured,
    ) -> Result<Option<Hypothesis>, ModelError> {
        let part = &self.effects[effect];
        let Some(curve) = part.curve().filter(|curve| curve.jump.is_some()) else {
            return Ok(None);
        };
        let Some(at) = part.descriptor.place_of(ParameterKind::Instant) else { return Ok(None) };
        let jumping_at = |instant: f64| {
            let mut jumping = self.clone();
            jumping.effects[effect].values[at] = instant;
            jumping
        };
        let on_motor = curve.side == CurveSide::Motor && measured.cell.is_some();
        let left = |instant: f64| -> Result<Vec<f64>, ModelError> {
            let jumping = jumping_at(instant);
            let sides = if on_motor { Sides::MOTOR } else { Sides::CARRIAGE };
            let driven = jumping.driven(measured, sides, &Driven::default())?;
            let missing = jumping.missing_at_samples(&driven, measured, sides);
            Ok(if on_motor { missing.motor } else { missing.carriage })
        };
        let step = measured.rate.recip();
        let (first, last) = (measured.time[0] - step, measured.time[measured.len() - 1] + step);
        // Friction that would be gone altogether is no friction.
        let (Ok(without), Ok(with)) = (left(last), left(first)) else { return Ok(None) };
        // Samples that rows stand for: in a hole nothing is known.
        let spacing = measured.lowpass.factor();
        let samples = measured
            .rows
            .iter()
            .flat_map(|row| (0..spacing).map(move |offset| row + offset - spacing / 2));
        let (mut more, mut least, mut instant) = (0.0, 0.0, first);
        for sample in samples {
            // By which more is left if it jumps behind this sample than if it had jumped from the
            // start.
            more += without[sample].powi(2) - with[sample].powi(2);
            if more < least {
                (least, instant) = (more, measured.time[sample] + 0.5 * step);
            }
        }
        Ok(Some(jumping_at(instant)))
    }

    /// Numbers that a record has for itself: of each ripple of balls that slip its knots.
    pub(crate) fn own_numbers(&self, measured: &Measured) -> usize {
        let ripples = self.effects.iter().filter_map(Part::slipping_ripple).collect();
        Slipping::new(ripples, measured).map_or(0, |slipping| slipping.columns())
    }

    /// The same with the amplitudes of balls that slip, of the effects from `first` on, as this
    /// record shows them, on the mean: with all guides in phase they would be twice the root of the
    /// sum of the squares of four that are not.
    pub(crate) fn with_own_amplitudes(
        &self,
        first: usize,
        measured: &Measured,
    ) -> Result<Hypothesis, ModelError> {
        let ripples = self.effects.iter().filter_map(Part::slipping_ripple).collect();
        let Some(slipping) = Slipping::new(ripples, measured) else { return Ok(self.clone()) };
        let mut without = self.clone();
        without.effects.retain(|part| !part.slips());
        let missing = without.missing(measured, Sides::CARRIAGE)?;
        let mut here = self.clone();
        let slips = here.effects.iter_mut().enumerate().filter(|(_, part)| part.slips());
        for ((index, part), amplitude) in slips.zip(slipping.amplitudes(&missing.carriage)) {
            let place = part.descriptor.place_of(ParameterKind::Amplitude);
            if let (Some(place), Some(amplitude), true) = (place, amplitude, index >= first) {
                let (least, most) = part.descriptor.parameters[place].bounds;
                part.values[place] = (2.0 * amplitude).clamp(least, most);
            }
        }
        Ok(here)
    }
}
