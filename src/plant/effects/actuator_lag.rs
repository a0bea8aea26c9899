//! Actuator lag: the motor's force follows its command late, by a first-order lag, a pure delay, or both.
//!
//! F = y - u on the motor side, T dy/dt = u(t - d) - y: u commanded force (N), T time_constant (s), d delay (s); either may be 0.
//! Exact for a held command: the mean over a step of the delayed command, then of the lag under it.
//! Source: current loop as first-order lag, bus and drive cycle as delay (assumed). Sizes: EMPS 0.5 to 0.75 ms in all.
//! Not modelled: slew rate, a second-order current loop. Before the first step the command was 0.

use super::regression::{along, largest_over_decades, least_squares};
use super::{Effect, EffectDescriptor, EffectParameter, Motion, Residual, Side};

/// Longest time constant and delay, s.
const LONGEST: f64 = 0.05;
/// Held commands that the delay keeps: 50 ms at the highest control rate of 20 kHz, which are 1000, and some.
const KEPT: usize = 1024;
/// Shortest lag of a proposal, s: a tenth of a sample at 20 kHz.
const SHORTEST: f64 = 5e-6;
/// Times closer than this are the same, s.
const INSTANT: f64 = 1e-9;

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "actuator_lag",
    side: Side::Motor,
    law: "F = y - command, time_constant dy/dt = command(t - delay) - y",
    source: "first-order current loop, pure delay of bus and drive (assumed)",
    telltale: "proportional to the rate of the command: peaks at the edges of acceleration, seen by the force cell",
    parameters: &[
        EffectParameter::optional("time_constant", "s", "first-order lag", (0.0, LONGEST), 1e-4, 0.0),
        EffectParameter::optional("delay", "s", "pure delay", (0.0, LONGEST), 1e-4, 0.0),
    ],
    check: super::any,
    // A form that is not there stays away.
    free: |values, index| values[index] > 0.0,
    build: |values| Box::new(ActuatorLag::new(values[0], values[1])),
    propose,
    starts: lag_or_delay,
};

#[derive(Debug)]
struct ActuatorLag {
    time_constant: f64,
    delay: f64,
    /// Held commands in a ring: start, s, and force, N.
    held: Vec<(f64, f64)>,
    oldest: usize,
    count: usize,
    /// y, N.
    output: f64,
}

impl ActuatorLag {
    fn new(time_constant: f64, delay: f64) -> ActuatorLag {
        let held = if delay > 0.0 { vec![(0.0, 0.0); KEPT] } else { Vec::new() };
        ActuatorLag { time_constant, delay, held, oldest: 0, count: 0, output: 0.0 }
    }

    /// Mean of the delayed command over a step that begins at `start`, s.
    fn delayed(&mut self, start: f64, step: f64, command: f64) -> f64 {
        if self.delay <= 0.0 {
            return command;
        }
        let entry = |lag: &ActuatorLag, index: usize| lag.held[(lag.oldest + index) % KEPT];
        if self.count == 0 || entry(self, self.count - 1).1 != command {
            if self.count == KEPT {
                // More changes than the ring holds: the oldest goes, its successor stands for both.
                self.oldest = (self.oldest + 1) % KEPT;
                self.count -= 1;
            }
            let place = (self.oldest + self.count) % KEPT;
            self.held[place] = (start, command);
            self.count += 1;
        }
        let (from, to) = (start - self.delay, start + step - self.delay);
        while self.count > 1 && entry(self, 1).0 <= from {
            self.oldest = (self.oldest + 1) % KEPT;
            self.count -= 1;
        }
        let mut area = 0.0;
        for index in 0..self.count {
            let (since, force) = entry(self, index);
            let until = if index + 1 < self.count { entry(self, index + 1).0 } else { f64::INFINITY };
            let overlap = until.min(to) - since.max(from);
            if overlap > 0.0 {
                area += force * overlap;
            }
            if until >= to {
                break;
            }
        }
        area / step
    }
}

impl ActuatorLag {
    /// y at the end of the last step, at `time` (s), N; 0 before the first.
    fn present(&self, time: f64) -> f64 {
        if self.time_constant > 0.0 {
            return self.output;
        }
        let reached = (0..self.count).map(|index| self.held[(self.oldest + index) % KEPT]);
        // What arrives at this very instant was not there before it.
        reached.take_while(|(since, _)| *since < time - self.delay - INSTANT).last().map_or(0.0, |(_, force)| force)
    }
}

impl Effect for ActuatorLag {
    fn pieces(&self) -> u32 {
        // A delayed command jumps within a cycle: with 8 pieces a delay of 0.75 ms came out at 0.740 ms, with 32 at 0.752.
        32
    }

    fn force(&mut self, motion: &Motion, step: f64) -> f64 {
        if step <= 0.0 {
            return self.present(motion.time) - motion.motor_force;
        }
        let delayed = self.delayed(motion.time - 0.5 * step, step, motion.motor_force);
        if self.time_constant <= 0.0 {
            return delayed - motion.motor_force;
        }
        // y over the step: u + (y0 - u) exp(-t / T); its mean is exact.
        let part = -(-step / self.time_constant).exp_m1();
        let excess = self.output - delayed;
        self.output = delayed + excess * (1.0 - part);
        delayed + excess * part * self.time_constant / step - motion.motor_force
    }

    fn reset(&mut self) {
        (self.oldest, self.count, self.output) = (0, 0, 0.0);
    }
}

/// The lag or the delay, whichever explains more, by a search over its length.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let nothing: f64 = residual.force.iter().filter(|force| force.is_finite()).map(|force| force * force).sum();
    let forms: [fn(f64) -> Vec<f64>; 2] = [|length| vec![length, 0.0], |length| vec![0.0, length]];
    forms
        .into_iter()
        .filter_map(|form| {
            let column = |length: f64| along(ActuatorLag::new(form(length)[0], form(length)[1]), residual);
            let explained = |length: f64| {
                let rest = residual.force.iter().zip(column(length)).map(|(force, lag)| (force - lag) * (force - lag));
                nothing - rest.filter(|rest| rest.is_finite()).sum::<f64>()
            };
            let length = largest_over_decades(SHORTEST, LONGEST, explained);
            let column = column(length);
            let fit = least_squares(residual.force, |k| [column[k]])?;
            // A coefficient far from 1 is no lag of this length.
            (fit.is_something() && (0.5..2.0).contains(&fit.coefficients[0])).then(|| (explained(length), form(length)))
        })
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, values)| values)
}

/// A lag may be of first order, a delay or both, which a proposal hardly tells apart. A force cell that is sampled at the ticks shows a delay in whole
/// ticks: a fit cannot step from one to the next.
fn lag_or_delay(values: &[f64], step: f64) -> Vec<Vec<f64>> {
    let length: f64 = values.iter().sum();
    let ticks = (length / step).round();
    let delays = [length, (ticks - 0.5) * step, (ticks + 0.5) * step].into_iter().filter(|delay| *delay > 0.0);
    delays.map(|delay| vec![0.0, delay]).chain([1.0, 0.25, 0.5, 0.75].map(|lag| vec![lag * length, (1.0 - lag) * length])).collect()
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{Record, proposal};
    use super::*;

    /// The force of the motor, N, at the end of 1 ms steps of 100 N from t = 0.
    fn step_response(time_constant: f64, delay: f64, step: f64, count: usize) -> Vec<f64> {
        let mut lag = ActuatorLag::new(time_constant, delay);
        (0..count)
            .map(|k| {
                let motion = Motion { time: (k as f64 + 0.5) * step, motor_force: 100.0, ..Motion::default() };
                100.0 + lag.force(&motion, step)
            })
            .collect()
    }

    #[test]
    fn a_step_of_the_command_arrives_after_the_delay_with_its_whole_area() {
        let forces = step_response(0.0, 2.3e-3, 1e-3, 6);
        for (found, expected) in forces.iter().zip([0.0, 0.0, 70.0, 100.0, 100.0, 100.0]) {
            assert!((found - expected).abs() < 1e-9, "{forces:?}");
        }
    }

    #[test]
    fn a_step_of_the_command_rises_with_the_time_constant_exactly_at_any_step() {
        let (time_constant, end) = (2e-3, 8e-3);
        for count in [2usize, 8, 800] {
            let step = end / count as f64;
            let impulse: f64 = step_response(time_constant, 0.0, step, count).iter().map(|force| force * step).sum();
            let expected = 100.0 * (end - time_constant * (1.0 - (-end / time_constant).exp()));
            assert!((impulse / expected - 1.0).abs() < 1e-12, "{count} steps: {impulse} {expected}");
        }
    }

    #[test]
    fn lag_and_delay_add_up_in_the_impulse_that_is_missing() {
        let forces = step_response(1e-3, 0.5e-3, 1e-4, 300);
        let missing: f64 = forces.iter().map(|force| (100.0 - force) * 1e-4).sum();
        assert!((missing / (100.0 * 1.5e-3) - 1.0).abs() < 1e-6, "{missing}");
    }

    #[test]
    fn more_commands_than_the_ring_holds_do_no_harm() {
        let mut lag = ActuatorLag::new(0.0, 0.05);
        for k in 0..10_000 {
            let motion = Motion { time: 1e-5 * (f64::from(k) + 0.5), motor_force: f64::from(k), ..Motion::default() };
            let force = lag.force(&motion, 1e-5) + f64::from(k);
            assert!(force.is_finite() && (0.0..=f64::from(k)).contains(&force), "{k}: {force}");
        }
    }

    #[test]
    fn proposal_tells_lag_from_delay_under_noise_and_finds_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[2e-3, 0.0]);
        assert!((found[0] / 2e-3 - 1.0).abs() < 0.1 && found[1] == 0.0, "{found:?}");
        let found = proposal(&DESCRIPTOR, &[0.0, 1.2e-3]);
        assert!(found[0] == 0.0 && (found[1] / 1.2e-3 - 1.0).abs() < 0.1, "{found:?}");
        for seed in 0..4 {
            let record = Record::motion().with_noise(0.3, seed);
            let found = propose(&record.residual());
            assert!(found.is_none(), "{found:?} from noise");
        }
    }
}
