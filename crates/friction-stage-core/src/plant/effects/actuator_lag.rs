//! Actuator lag: the motor's force follows its command late, by a first-order lag, a pure delay, or
//! both.
//!
//! F = y - u on the motor side, T dy/dt = u(t - d) - y: u commanded force (N), T time_constant (s),
//! d delay (s); either may be 0. Exact for a held command, which is delayed in pieces: under each,
//! y is an exponential, integrated in closed form. Source: current loop as first-order lag, bus and
//! drive cycle as delay (assumed). Sizes: EMPS 0.5 to 0.75 ms in all. Not modelled: slew rate, a
//! second-order current loop. Before the first step the command was 0.

use nalgebra::Complex;

use super::regression::{along, largest_over_decades, least_squares};
use super::{
    Action, CommandLaw, CommandStage, EffectDescriptor, EffectParameter, ForceOverStep, Motion,
    Multiplicity, ParameterKind, RecordSpecific, Residual, Role, descriptor,
};

/// Longest time constant and delay, s.
const LONGEST: f64 = 0.05;
/// Held commands that the delay keeps: 50 ms at the highest control rate of 20 kHz, which are 1000,
/// and some.
const KEPT: usize = 1024;
/// Shortest lag of a proposal, s: a tenth of a sample at 20 kHz.
const SHORTEST: f64 = 5e-6;
/// A short lag that a fit starts from, and how long before a tick the delay ends that it is behind,
/// samples. Assumed: a cell sees half of what such a lag holds back.
const SHORT_LAG: f64 = 0.15;
const BEFORE_A_TICK: f64 = 0.1;
/// Times closer than this are the same, s.
const INSTANT: f64 = 1e-9;

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "actuator_lag",
    role: Role::Command(CommandStage::Lag),
    law: "F = y - command, time_constant dy/dt = command(t - delay) - y",
    source: "first-order current loop, pure delay of bus and drive (assumed)",
    telltale: "proportional to the rate of the command: peaks at the edges of acceleration, seen \
               by the force cell",
    parameters: &[
        EffectParameter::optional(
            "time_constant",
            "s",
            "first-order lag",
            (0.0, LONGEST),
            1e-4,
            0.0,
        ),
        EffectParameter::optional("delay", "s", "pure delay", (0.0, LONGEST), 1e-4, 0.0)
            .of_kind(ParameterKind::Delay),
    ],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[2e-4, 0.0],
    check: descriptor::any,
    // A form that is not there stays away.
    free: |values, index| values[index] > 0.0,
    build: |values| Action::Command(Box::new(ActuatorLag::new(values[0], values[1]))),
    proposal: Some(propose),
    starts: lag_or_delay,
    curve: None,
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
    /// The last time under one force, s, and the part of the way to it that y went: most are alike.
    faded: (f64, f64),
}

impl ActuatorLag {
    fn new(time_constant: f64, delay: f64) -> ActuatorLag {
        let held = if delay > 0.0 { vec![(0.0, 0.0); KEPT] } else { Vec::new() };
        ActuatorLag {
            time_constant,
            delay,
            held,
            oldest: 0,
            count: 0,
            output: 0.0,
            faded: (0.0, 0.0),
        }
    }

    /// Takes a command that is held from `start`, s, into the ring.
    fn hold(&mut self, start: f64, command: f64) {
        if self.count > 0 && self.entry(self.count - 1).1 == command {
            return;
        }
        if self.count == KEPT {
            // More changes than the ring holds: the oldest goes, its successor stands for both.
            let since = self.held[self.oldest].0;
            self.oldest = (self.oldest + 1) % KEPT;
            self.count -= 1;
            self.held[self.oldest].0 = since;
        }
        self.held[(self.oldest + self.count) % KEPT] = (start, command);
        self.count += 1;
    }

    fn entry(&self, index: usize) -> (f64, f64) {
        self.held[(self.oldest + index) % KEPT]
    }

    /// Leads y through a step from `start`, s, under the command as it arrives, N.
    fn lead(&mut self, start: f64, step: f64, command: f64) -> ForceOverStep {
        if self.delay <= 0.0 {
            let (area, moment) = self.under(command, step);
            return ForceOverStep { mean: area / step, moment: moment / (step * step) };
        }
        self.hold(start, command);
        let (from, to) = (start - self.delay, start + step - self.delay);
        while self.count > 1 && self.entry(1).0 <= from {
            self.oldest = (self.oldest + 1) % KEPT;
            self.count -= 1;
        }
        let (mut area, mut moment, mut at) = (0.0, 0.0, from);
        for index in 0..=self.count {
            // Before the first command it was 0.
            let force = if index == 0 { 0.0 } else { self.entry(index - 1).1 };
            // What arrives as the step ends is not there yet.
            let until = if index < self.count { self.entry(index).0 } else { to };
            let until = if until < to - INSTANT { until } else { to };
            if until <= at {
                continue;
            }
            let (piece, of_its_own) = self.under(force, until - at);
            area += piece;
            moment += of_its_own + piece * 0.5 * ((until - to) + (at - from));
            at = until;
            if at >= to {
                break;
            }
        }
        ForceOverStep { mean: area / step, moment: moment / (step * step) }
    }

    /// Leads y through a time, s, under one force, N: its integral, N s, and its first moment about
    /// the middle of the time, N s^2.
    fn under(&mut self, force: f64, time: f64) -> (f64, f64) {
        let lag = self.time_constant;
        if lag <= 0.0 {
            self.output = force;
            return (force * time, 0.0);
        }
        // y = u + (y0 - u) exp(-t / T)
        if time != self.faded.0 {
            self.faded = (time, -(-time / lag).exp_m1());
        }
        let (excess, (_, part)) = (self.output - force, self.faded);
        self.output = force + excess * (1.0 - part);
        (force * time + excess * lag * part, excess * lag * (lag * part - time + 0.5 * time * part))
    }
}

impl CommandLaw for ActuatorLag {
    fn change(&mut self, command: f64, motion: &Motion, step: f64) -> f64 {
        self.change_over(command, motion, step).mean
    }

    fn change_over(&mut self, command: f64, motion: &Motion, step: f64) -> ForceOverStep {
        if step <= 0.0 {
            return ForceOverStep { mean: self.output - command, moment: 0.0 };
        }
        let arrived = self.lead(motion.time - 0.5 * step, step, command);
        ForceOverStep { mean: arrived.mean - command, ..arrived }
    }

    fn added(&self, angular_frequency: f64) -> Complex<f64> {
        let late = Complex::from_polar(1.0, -angular_frequency * self.delay);
        late / Complex::new(1.0, angular_frequency * self.time_constant) - 1.0
    }

    fn reset(&mut self) {
        (self.oldest, self.count, self.output) = (0, 0, 0.0);
    }
}

/// The lag or the delay, whichever explains more, by a search over its length.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let nothing: f64 =
        residual.force.iter().filter(|force| force.is_finite()).map(|force| force * force).sum();
    let forms: [fn(f64) -> Vec<f64>; 2] = [|length| vec![length, 0.0], |length| vec![0.0, length]];
    forms
        .into_iter()
        .filter_map(|form| {
            let column = |length: f64| {
                let mut lag = ActuatorLag::new(form(length)[0], form(length)[1]);
                along(residual, |motion, step| lag.change(motion.motor_force, motion, step))
            };
            let explained = |length: f64| {
                let rest = residual
                    .force
                    .iter()
                    .zip(column(length))
                    .map(|(force, lag)| (force - lag) * (force - lag));
                nothing - rest.filter(|rest| rest.is_finite()).sum::<f64>()
            };
            let length = largest_over_decades(SHORTEST, LONGEST, explained);
            let column = column(length);
            let fit = least_squares(residual.force, |k| [column[k]])?;
            // A coefficient far from 1 is no lag of this length.
            (fit.is_something() && (0.5..2.0).contains(&fit.coefficients[0]))
                .then(|| (explained(length), form(length)))
        })
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .map(|(_, values)| values)
}

/// A lag may be of first order, a delay or both, which a proposal hardly tells apart. A force cell
/// that is sampled at the ticks shows a delay in whole ticks, and behind one that ends shortly
/// before a tick little of a lag: a fit cannot step from one tick to the next.
fn lag_or_delay(values: &[f64], step: f64) -> Vec<Vec<f64>> {
    let length: f64 = values.iter().sum();
    let ticks = (length / step).round();
    let late = |delay: f64| vec![0.0, delay];
    let shared = |lag: f64| vec![lag * length, (1.0 - lag) * length];
    let before_a_tick = |tick: f64| vec![SHORT_LAG * step, (tick - BEFORE_A_TICK) * step];
    [
        late(length),
        late((ticks - 0.5) * step),
        late((ticks + 0.5) * step),
        shared(1.0),
        shared(0.25),
        shared(0.5),
        shared(0.75),
    ]
    .into_iter()
    .chain([before_a_tick(ticks), before_a_tick(ticks + 1.0)])
    .filter(|start| {
        start.iter().all(|value| *value >= 0.0) && start.iter().any(|value| *value > 0.0)
    })
    .collect()
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
                let motion = Motion {
                    time: (k as f64 + 0.5) * step,
                    motor_force: 100.0,
                    ..Motion::default()
                };
                100.0 + lag.change(100.0, &motion, step)
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
            let impulse: f64 = step_response(time_constant, 0.0, step, count)
                .iter()
                .map(|force| force * step)
                .sum();
            let expected = 100.0 * (end - time_constant * (1.0 - (-end / time_constant).exp()));
            assert!(
                (impulse / expected - 1.0).abs() < 1e-12,
                "{count} steps: {impulse} {expected}"
            );
        }
    }

    #[test]
    fn lag_and_delay_add_up_in_the_impulse_that_is_missing() {
        let forces = step_response(1e-3, 0.5e-3, 1e-4, 300);
        let missing: f64 = forces.iter().map(|force| (100.0 - force) * 1e-4).sum();
        assert!((missing / (100.0 * 1.5e-3) - 1.0).abs() < 1e-6, "{missing}");
    }

    /// Against a first-order lag that is integrated in steps of 0.1 us under a command that is
    /// looked up in the past.
    #[test]
    fn where_in_a_step_the_force_acts_is_exact_however_the_command_jumps_in_it() {
        let (cycle, fine) = (5e-4, 1e-7);
        let command = |cycle: i64| if cycle < 0 { 0.0 } else { 80.0 * (1.3 * cycle as f64).sin() };
        for (time_constant, delay) in
            [(0.0, 2.3e-4), (3e-4, 0.0), (2e-4, 1.7e-4), (5e-3, 1.22e-3), (5e-5, 5e-4)]
        {
            let mut lag = ActuatorLag::new(time_constant, delay);
            let mut output = 0.0;
            for k in 0..12 {
                let (mut mean, mut moment) = (0.0, 0.0);
                for part in 0..5000 {
                    let aside = (f64::from(part) + 0.5) / 5000.0;
                    let arrived = command((f64::from(k) + aside - delay / cycle).floor() as i64);
                    let before = output;
                    let decay =
                        if time_constant > 0.0 { (-fine / time_constant).exp() } else { 0.0 };
                    output = arrived + (output - arrived) * decay;
                    let force = if time_constant > 0.0 { 0.5 * (before + output) } else { arrived };
                    mean += force / 5000.0;
                    moment += force * (aside - 0.5) / 5000.0;
                }
                let motion = Motion {
                    time: (f64::from(k) + 0.5) * cycle,
                    motor_force: command(k.into()),
                    ..Motion::default()
                };
                let over = lag.change_over(motion.motor_force, &motion, cycle);
                let (found, expected) =
                    ([over.mean + motion.motor_force, over.moment], [mean, moment]);
                for (found, expected) in found.iter().zip(expected) {
                    assert!(
                        (found - expected).abs() < 1e-4,
                        "{time_constant} {delay} cycle {k}: {found} {expected}"
                    );
                }
            }
        }
    }

    #[test]
    fn more_commands_than_the_ring_holds_do_no_harm() {
        let mut lag = ActuatorLag::new(0.0, 0.05);
        for k in 0..10_000 {
            let motion = Motion {
                time: 1e-5 * (f64::from(k) + 0.5),
                motor_force: f64::from(k),
                ..Motion::default()
            };
            let force = lag.change(motion.motor_force, &motion, 1e-5) + f64::from(k);
            assert!(force.is_finite() && (0.0..=f64::from(k)).contains(&force), "{k}: {force}");
        }
        // 50 ms are 5000 changes, of which the ring has the last 1024: the oldest of them stands
        // for all before it.
        assert_eq!(lag.entry(0).1, (10_000 - KEPT) as f64);
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
