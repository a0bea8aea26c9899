//! What proposals look at.

use crate::error::IdentifyError;
use crate::hypothesis::{Hypothesis, Sides};
use crate::record::measured::Measured;
use crate::residual::driven::Driven;
use friction_stage_core::plant::{Residual, Samples};

/// Columns that proposals look at, on the train record.
pub(super) struct Columns {
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
    pub(super) fn new(
        hypothesis: &Hypothesis,
        measured: &Measured,
    ) -> Result<Columns, IdentifyError> {
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

    pub(super) fn residual(&self, motor: bool) -> Residual<'_> {
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
