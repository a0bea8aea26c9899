//! The force that a hypothesis misses along a record: what is left of mass times acceleration,
//! friction and effects.

use friction_stage_core::model::ModelError;
use friction_stage_core::plant::Side;

use crate::hypothesis::{Hypothesis, Sides};
use crate::record::measured::{Measured, mean_square};
use crate::residual::driven::{self, Driven};

/// Force that a hypothesis misses, N along +x, filtered, at the rows of the recording. Motor side:
/// cell less command less effects. Carriage side: mass times acceleration plus friction less
/// effects less cell; without a cell, less command and motor effects.
#[derive(Clone, Debug, Default)]
pub struct Missing {
    /// On the motor side; empty without a cell.
    pub motor: Vec<f64>,
    /// On the carriage side.
    pub carriage: Vec<f64>,
}

impl Missing {
    /// Mean squares, N^2.
    pub fn squares(&self) -> (f64, f64) {
        (mean_square(self.motor.iter().copied()), mean_square(self.carriage.iter().copied()))
    }

    /// Root of the sum of both mean squares, N.
    pub fn rms(&self) -> f64 {
        let (motor, carriage) = self.squares();
        (motor + carriage).sqrt()
    }
}

impl Hypothesis {
    /// Drives guides and effects along the measured motion and says what force is missing.
    pub fn missing(&self, measured: &Measured, sides: Sides) -> Result<Missing, ModelError> {
        Ok(self.missing_of(&self.driven(measured, sides, &Driven::default())?, measured, sides))
    }

    /// The same at every sample and not filtered; 0 at both ends, where there is no second
    /// difference. Ripples whose phase is each record's own are not in it.
    pub fn missing_unfiltered(
        &self,
        measured: &Measured,
        sides: Sides,
    ) -> Result<Missing, ModelError> {
        let driven = self.driven(measured, sides, &Driven::default())?;
        Ok(self.missing_at_samples(&driven, measured, sides))
    }

    /// The same from what was driven already.
    pub(crate) fn missing_of(&self, driven: &Driven, measured: &Measured, sides: Sides) -> Missing {
        let Missing { motor, carriage } = self.missing_at_samples(driven, measured, sides);
        let filtered =
            |signal: Vec<f64>| if signal.is_empty() { signal } else { measured.filtered(&signal) };
        let mut carriage = filtered(carriage);
        driven.take_out_own(&mut carriage);
        Missing { motor: filtered(motor), carriage }
    }

    /// The same at every sample and not filtered; 0 at both ends, where there is no second
    /// difference.
    pub(crate) fn missing_at_samples(
        &self,
        driven: &Driven,
        measured: &Measured,
        sides: Sides,
    ) -> Missing {
        let count = measured.len();
        let cell = driven.cell(measured);
        let on = |side: Side| driven.forces().filter(move |force| force.side() == side);
        let mut missing = Missing::default();
        if let (true, Some(cell)) = (sides.motor, cell) {
            missing.motor = (0..count)
                .map(|k| {
                    cell[k]
                        - measured.command[k]
                        - on(Side::Motor).map(|force| force.read_at(k)).sum::<f64>()
                })
                .collect();
        }
        if sides.carriage {
            let mass = self.mass();
            let mut push: Vec<f64> = cell.unwrap_or(&measured.command).to_vec();
            for force in on(Side::Motor) {
                for (k, push) in push.iter_mut().enumerate() {
                    // The cell reads at the samples; what moves the carriage is the mean over the
                    // intervals.
                    *push +=
                        force.at_nodes[k] - if cell.is_some() { force.read_at(k) } else { 0.0 };
                }
            }
            let mut left: Vec<f64> = (0..count)
                .map(|k| {
                    (mass + driven.added_mass(k))
                        * (measured.acceleration[k]
                            - driven.apparent_acceleration(k, measured.rate))
                })
                .collect();
            let mut take = |forces: &[f64], sign: f64| {
                left.iter_mut().zip(forces).for_each(|(left, force)| *left += sign * force);
            };
            driven.friction().for_each(|(part, factor)| take(part, factor));
            on(Side::Carriage).for_each(|force| take(&force.at_nodes, -1.0));
            let shift = 0.5 * self.sensor_shift();
            missing.carriage = (0..count)
                .map(|k| {
                    if k == 0 || k + 1 == count {
                        return 0.0;
                    }
                    left[k] - push[k] - shift * (push[k + 1] - push[k - 1])
                })
                .collect();
        }
        missing
    }

    /// Friction of the guides along the measured motion without effects, N, at the nodes.
    pub fn friction(&self, measured: &Measured) -> Result<Vec<f64>, ModelError> {
        driven::friction(&self.guides(), measured)
    }
}
