//! The same motion as the machine of a hypothesis alone would have made it, read by sensors like
//! those of the record: what a residual or a law gets out of it is what noise, counts, the rate and
//! the measured motion in place of the true one give, and nothing else.
//!
//! Where setpoint and controller are known the loop runs with them, since what the sensors read
//! wrong is in the controller's answer too. Elsewhere the stage of the hypothesis follows the
//! recorded motion under the recorded command, with what the hypothesis misses of it added, and a
//! slow controller that keeps it from drifting away.

use std::f64::consts::{SQRT_2, TAU};

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::closed_loop::{LinearController, Running, Setpoint};
use crate::hypothesis::{Hypothesis, Sides};
use crate::record::lowpass::ZeroPhaseLowpass;
use crate::record::measured::Measured;
use crate::residual::driven::holding;
use friction_stage_core::model::ModelError;
use friction_stage_core::numerics::range;
use friction_stage_core::plant::Body;

/// Longest step of the simulation, s.
const LONGEST_STEP: f64 = 25e-6;
/// Corner below which what the hypothesis misses acts on the stage that follows, Hz. Assumed: far
/// below the band in which the encoder's noise, differentiated twice, is a force.
const CORNER: f64 = 20.0;
/// Bandwidth of the controller that keeps the stage from drifting away, Hz, and samples in a period
/// of it at least. Assumed: slow enough to make no force that counts of the noise of any encoder.
const BANDWIDTH: f64 = 5.0;
const SAMPLES_PER_PERIOD: f64 = 50.0;
/// Part of the travel by which the simulated loop may be off. Assumed: hidden effects move a
/// stage under control by less.
const ASTRAY: f64 = 0.05;
/// Bandwidths above which that controller answers nothing.
const FILTER: f64 = 6.0;

impl Hypothesis {
    /// What the sensors of a record would have read had nothing been there but this hypothesis;
    /// `seed` draws their noise.
    pub(crate) fn null_record(
        &self,
        measured: &Measured,
        controller: Option<&LinearController>,
        seed: u64,
    ) -> Result<Measured, ModelError> {
        // A loop of another machine need not hold this one.
        let in_loop = controller
            .and_then(|controller| Some((controller, Setpoint::of(&measured.controlled()?).ok()?)))
            .map(|(controller, setpoint)| {
                let mut running = Running::new(controller);
                let recorded = &measured.raw_command;
                let mut last = recorded[0];
                self.simulated(measured, recorded[0], seed, |k, read| {
                    let force = running.force(setpoint.inputs(k, read), recorded[k]);
                    last = if force.is_finite() { force } else { last };
                    last
                })
            })
            .transpose()?;
        let travel = {
            let (lowest, highest) = range(&measured.position);
            highest - lowest
        };
        let follows = |record: &Measured| {
            let both = record.position.iter().zip(&measured.position);
            both.into_iter().all(|(one, other)| (one - other).abs() < ASTRAY * travel)
        };
        if let Some(record) = in_loop.filter(follows) {
            return Ok(record);
        }
        let missed = self.missed_over_intervals(measured)?;
        let pushed = |k: usize| measured.raw_command[k] + missed[k];
        let mut holder = Holder::new(self.mass(), measured.rate);
        self.simulated(measured, pushed(0), seed, |k, read| {
            pushed(k) + holder.force(measured.position[k] - read)
        })
    }

    /// The same where the motor holds the force, N, that `push` gives for a sample and what the
    /// encoder reads there, m; before the first one it has held `held`, N.
    fn simulated(
        &self,
        measured: &Measured,
        held: f64,
        seed: u64,
        mut push: impl FnMut(usize, f64) -> f64,
    ) -> Result<Measured, ModelError> {
        // Where balls slip the phase is not identifiable.
        let mut known = self.clone();
        known.effects.retain(|part| !part.slips());
        let model = known.model().without_noise();
        let dt = measured.rate.recip();
        let steps_of = |longest: f64| (dt / longest).ceil().max(1.0);
        let mut steps = steps_of(LONGEST_STEP);
        let mut body = match Body::new(&model, dt / steps) {
            Err(ModelError::Step { limit, .. }) => {
                steps = steps_of(limit);
                Body::new(&model, dt / steps)?
            }
            body => body?,
        };
        let start = measured.position[0];
        let reads_too_much = body.effects().read(0.0, start, held).0 - start;
        body.set_state(start - reads_too_much, 0.0, &holding(&self.guides(), held));
        let mut noise = SensorNoise::new(self, measured, seed);
        let shift = self.sensor_shift() * dt;
        let count = measured.len();
        let column = || Vec::with_capacity(count);
        let (mut position, mut command, mut cell) = (column(), column(), column());
        for k in 0..count {
            // Before the first interval the motor has held what it begins with.
            let force = if k == 0 { held } else { body.cell_force() };
            let at = body.position() + shift * body.velocity();
            let (read, cell_read) = body.effects().read(measured.time[k], at, force);
            let read = noise.of_encoder(read);
            position.push(read);
            cell.push(noise.of_cell(cell_read));
            let force = push(k, read);
            command.push(force);
            body.advance(force, steps as u32);
        }
        Ok(measured.read_as(position, command, cell, self.mass()))
    }

    /// What is missing from the command to the motion, slow enough to be no noise, as means over
    /// the intervals after the samples, N to be added to the command.
    fn missed_over_intervals(&self, measured: &Measured) -> Result<Vec<f64>, ModelError> {
        let missing = self.missing_unfiltered(measured, Sides::BOTH)?;
        let mut whole = missing.carriage;
        whole.iter_mut().zip(&missing.motor).for_each(|(whole, motor)| *whole += motor);
        let lowpass = ZeroPhaseLowpass::new(CORNER.min(measured.rate / 5.0), measured.rate);
        let (count, half) = (whole.len(), lowpass.half());
        let slow: Vec<f64> = (0..count)
            .map(|k| if k < half || k + half >= count { 0.0 } else { lowpass.at(&whole, k) })
            .collect();
        Ok((0..count).map(|k| 0.5 * (slow[k] + slow[(k + 1).min(count - 1)])).collect())
    }
}

/// A slow controller of position.
struct Holder {
    stiffness: f64,
    damping: f64,
    smoothing: f64,
    rate: f64,
    /// Errors, smoothed once and twice, m.
    error: f64,
    smooth: f64,
}

impl Holder {
    fn new(mass: f64, rate: f64) -> Holder {
        let bandwidth = TAU * BANDWIDTH.min(rate / SAMPLES_PER_PERIOD);
        Holder {
            stiffness: mass * bandwidth * bandwidth,
            damping: SQRT_2 * mass * bandwidth,
            smoothing: 1.0 - (-FILTER * bandwidth / rate).exp(),
            rate,
            error: 0.0,
            smooth: 0.0,
        }
    }

    /// Force for an error, m.
    fn force(&mut self, error: f64) -> f64 {
        self.error += self.smoothing * (error - self.error);
        let before = self.smooth;
        self.smooth += self.smoothing * (self.error - self.smooth);
        self.stiffness * self.smooth + self.damping * (self.smooth - before) * self.rate
    }
}

/// Sensors as the record shows them, no better than declared.
struct SensorNoise {
    /// White noise before counting, m.
    white: f64,
    /// m
    count: f64,
    /// N
    cell: f64,
    random: ChaCha8Rng,
}

impl SensorNoise {
    fn new(hypothesis: &Hypothesis, measured: &Measured, seed: u64) -> SensorNoise {
        let declared = hypothesis.declared();
        let beyond_counts = measured.noise.powi(2) - measured.count.powi(2) / 12.0;
        SensorNoise {
            white: declared.encoder.noise.max(beyond_counts.max(0.0).sqrt()),
            count: measured.count,
            cell: declared.force_cell.noise.max(measured.cell_noise),
            random: ChaCha8Rng::seed_from_u64(seed),
        }
    }

    fn draw(&mut self) -> f64 {
        StandardNormal.sample(&mut self.random)
    }

    fn of_encoder(&mut self, truth: f64) -> f64 {
        let read = truth + self.white * self.draw();
        if self.count > 0.0 { (read / self.count).round() * self.count } else { read }
    }

    fn of_cell(&mut self, truth: f64) -> f64 {
        truth + self.cell * self.draw()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hypothesis::Tolerances;
    use crate::test_records::recording;
    use friction_stage_core::model::StageModel;

    /// A machine without anything hidden leaves as much as its null record, be it noise of the
    /// encoder or counts, and whether its controller is known or not.
    #[test]
    fn a_machine_that_is_as_declared_leaves_what_its_null_record_leaves() {
        for (resolution, noise) in [(1e-9, 1e-9), (1e-7, 0.0), (0.0, 3e-8)] {
            let mut model = StageModel::default();
            (model.encoder.resolution, model.encoder.noise) = (resolution, noise);
            let trace = recording(&model, 5, 0.0, 4);
            let controller = LinearController::fit(&trace).unwrap();
            let measured = Measured::new(&trace, &model, "the record").unwrap();
            let hypothesis = Hypothesis::new(&model, Tolerances::default()).unwrap();
            let left = |record: &Measured| hypothesis.missing(record, Sides::BOTH).unwrap().rms();
            // Where the loop is not known the noise is another one than the controller has
            // answered.
            for (controller, within) in [(None, 1.0), (Some(&controller), 0.2)] {
                let null = hypothesis.null_record(&measured, controller, 1).unwrap();
                let ratio = left(&measured) / left(&null);
                assert!(
                    ratio < 1.0 + within && ratio.recip() < 1.0 + within,
                    "{resolution:e} m, {noise:e} m, to {within}: {ratio}"
                );
                let both = null.position.iter().zip(&measured.position);
                let farthest = both.map(|(one, other)| (one - other).abs()).fold(0.0, f64::max);
                assert!(farthest < 2e-5, "{farthest} m away");
            }
        }
    }
}
