//! Force cell lag: the cell shows the force late, by a lowpass, a latency, or both.
//!
//! Reading y(t - d), T dy/dt = F - y: F true force (N), T time_constant (s), d delay (s); either
//! may be 0. The lowpass is exact for a force that is held over a step, the latency is in whole
//! steps. Before the first step the force was that of the first one. Source: first-order lowpass
//! of the amplifier, latency of converter and bus (assumed). Sizes: a lowpass of 100 to 1000 Hz (T
//! = 1.6 to 0.16 ms), one to some samples. Not modelled: filters of higher order, a latency that
//! changes.
//!
//! An `actuator_lag` looks the same in cell less command, but there the carriage is late, too: with
//! this one it obeys the command, and the cell comes after.

use super::regression::{along, largest_over_decades, least_squares};
use super::{
    Action, EffectDescriptor, EffectParameter, Multiplicity, ParameterKind, ReadingLaw,
    RecordSpecific, Residual, Role, descriptor,
};

/// Longest time constant and delay, s.
const LONGEST: f64 = 0.05;
/// Shortest lag of a proposal, s: a tenth of a sample at 20 kHz.
const SHORTEST: f64 = 5e-6;
/// Forces that the latency keeps: 50 ms of steps of 25 µs are 2000, and some.
const KEPT: usize = 2048;
/// Times closer than this are the same, s.
const INSTANT: f64 = 1e-9;

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "force_cell_lag",
    role: Role::ForceCell,
    law: "reading = y(t - delay), time_constant dy/dt = F - y",
    source: "first-order lowpass of the amplifier, latency of converter and bus (assumed)",
    telltale: "cell less command proportional to the rate of the command, while the carriage obeys \
               the command at once",
    parameters: &[
        EffectParameter::optional(
            "time_constant",
            "s",
            "first-order lowpass",
            (0.0, LONGEST),
            1e-4,
            0.0,
        ),
        EffectParameter::optional("delay", "s", "latency", (0.0, LONGEST), 1e-4, 0.0)
            .of_kind(ParameterKind::Delay),
    ],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[5e-4, 0.0],
    check: descriptor::any,
    // A form that is absent remains so.
    free: |values, index| values[index] > 0.0,
    build: |values| Action::ForceCell(Box::new(ForceCellLag::new(values[0], values[1]))),
    proposal: Some(propose),
    starts: lowpass_or_latency,
    curve: None,
};

#[derive(Debug)]
struct ForceCellLag {
    time_constant: f64,
    delay: f64,
    /// y, N; `None` before the first step.
    output: Option<f64>,
    /// Outputs with the time for which they stood, s, in a ring, the oldest one from before the
    /// delay on.
    kept: Vec<(f64, f64)>,
    oldest: usize,
    count: usize,
    /// Time for which all of them stood, s.
    stood: f64,
}

impl ForceCellLag {
    fn new(time_constant: f64, delay: f64) -> ForceCellLag {
        let kept = if delay > 0.0 { vec![(0.0, 0.0); KEPT] } else { Vec::new() };
        let (output, oldest, count, stood) = (None, 0, 0, 0.0);
        ForceCellLag { time_constant, delay, output, kept, oldest, count, stood }
    }

    /// What remains of an excess of y over a step, s.
    fn remains(&self, step: f64) -> f64 {
        if self.time_constant > 0.0 { (-step / self.time_constant).exp() } else { 0.0 }
    }

    /// Keeps an output that has stood for a step, s, and drops what is older than the delay.
    fn keep(&mut self, output: f64, step: f64) {
        self.stood += step;
        if self.count == KEPT {
            // More steps than the ring holds: the newest output stands for both.
            let newest = (self.oldest + self.count - 1) % KEPT;
            self.kept[newest] = (output, self.kept[newest].1 + step);
        } else {
            self.kept[(self.oldest + self.count) % KEPT] = (output, step);
            self.count += 1;
        }
        while self.count > 1 && self.stood - self.kept[self.oldest].1 > self.delay + INSTANT {
            self.stood -= self.kept[self.oldest].1;
            self.oldest = (self.oldest + 1) % KEPT;
            self.count -= 1;
        }
    }

    /// What the cell shows now, N; `None` before the first step.
    fn shown(&self) -> Option<f64> {
        match self.delay > 0.0 {
            true => (self.count > 0).then(|| self.kept[self.oldest].0),
            false => self.output,
        }
    }
}

impl ReadingLaw for ForceCellLag {
    fn reading(&self, _time: f64, force: f64) -> f64 {
        self.shown().unwrap_or(force)
    }

    fn follow(&mut self, force: f64, step: f64) {
        let excess = self.output.map_or(0.0, |output| output - force);
        let output = force + excess * self.remains(step);
        self.output = Some(output);
        if self.delay > 0.0 {
            self.keep(output, step);
        }
    }

    /// The force held over the step before each reading; between the readings of a latency that is
    /// no whole number of steps a straight line (assumed).
    fn made_up_for(&self, readings: &mut [f64], step: f64) {
        let late = self.delay / step;
        let (whole, part) = (late.floor(), late.fract());
        let last = readings.len().saturating_sub(1);
        for k in 0..readings.len() {
            let [here, next] = [0, 1].map(|more| readings[(k + whole as usize + more).min(last)]);
            readings[k] = here + part * (next - here);
        }
        let remains = self.remains(step);
        let mut before = readings.first().copied().unwrap_or(0.0);
        for reading in readings {
            let now = *reading;
            *reading = (now - remains * before) / (1.0 - remains);
            before = now;
        }
    }

    fn reset(&mut self) {
        (self.output, self.oldest, self.count, self.stood) = (None, 0, 0, 0.0);
    }
}

/// The lowpass over the command that takes most out of the residual, of either side: the carriage
/// shows it with the opposite sign. Between the rows, which may be many samples apart, the command
/// is a straight line.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let column = |time_constant: f64| {
        // By how much y is off the command, and the command of the row before.
        let (mut off, mut before) = (0.0, None);
        along(residual, |motion, step| {
            let command = motion.motor_force;
            let slope = before.map_or(0.0, |before| (command - before) / step);
            let steady = -time_constant * slope;
            (off, before) =
                (steady + (off - steady) * (-step / time_constant).exp(), Some(command));
            off
        })
    };
    let of_side = |sign: f64| {
        let explained = |time_constant: f64| -> f64 {
            let both = residual.force.iter().zip(column(time_constant));
            let taken = both.map(|(force, off)| force * force - (force - sign * off).powi(2));
            taken.filter(|taken| taken.is_finite()).sum()
        };
        let time_constant = largest_over_decades(SHORTEST, LONGEST, explained);
        (explained(time_constant), time_constant)
    };
    let sides = [of_side(1.0), of_side(-1.0)];
    let (_, time_constant) = sides.into_iter().max_by(|one, two| one.0.total_cmp(&two.0))?;
    let late = column(time_constant);
    let fit = least_squares(residual.force, |k| [late[k]])?;
    // A coefficient far from 1 is no lag of this length.
    (fit.is_something() && (0.5..2.0).contains(&fit.coefficients[0].abs()))
        .then(|| vec![time_constant, 0.0])
}

/// A lowpass, a latency of as much or of the whole steps nearest to it, or both, which a proposal
/// hardly tells apart. A command that is held over a step comes half a step sooner through a
/// lowpass that is sampled at its end.
fn lowpass_or_latency(values: &[f64], step: f64) -> Vec<Vec<f64>> {
    let length = values[0] + values[1];
    let whole = (length / step).round().max(1.0) * step;
    vec![
        vec![length + 0.5 * step, 0.0],
        vec![length, 0.0],
        vec![0.0, whole],
        vec![0.5 * length, 0.5 * length],
    ]
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{Record, STEP, assert_silent_on_noise, proposal};
    use super::*;
    use crate::model::{EffectParameters, StageModel};
    use crate::plant::{Rates, Stage};

    /// What a cell of these values shows of a step of the force of 10 N, at samples of 0.5 ms.
    fn step_response(values: [(&'static str, f64); 2]) -> Vec<f64> {
        let model = StageModel {
            effects: vec![EffectParameters::new("force_cell_lag", values)],
            ..StageModel::default().without_noise()
        };
        let mut stage = Stage::new(&model, Rates::of_control(2000.0).unwrap(), 0).unwrap();
        let mut force = 0.0;
        let shown = |_| {
            stage.advance(force);
            force = 10.0;
            stage.sample().force_cell
        };
        (0..12).map(shown).collect()
    }

    #[test]
    fn a_step_of_the_force_comes_as_an_exponential_or_whole_and_late() {
        let lowpass = step_response([("time_constant", 1e-3), ("delay", 0.0)]);
        let latency = step_response([("time_constant", 0.0), ("delay", 1e-3)]);
        for k in 0..12 {
            // The first step had no force.
            let since = 5e-4 * k as f64;
            let expected = 10.0 * (1.0 - (-since / 1e-3).exp());
            assert!((lowpass[k] - expected).abs() < 1e-9, "{k}: {} {expected}", lowpass[k]);
            let expected = if k >= 3 { 10.0 } else { 0.0 };
            assert!((latency[k] - expected).abs() < 1e-9, "{k}: {} {expected}", latency[k]);
        }
    }

    #[test]
    fn what_the_cell_would_have_shown_in_time_is_made_up_for() {
        let forces: Vec<f64> = (0..200).map(|k| 20.0 * (0.1 * f64::from(k)).sin()).collect();
        for (time_constant, delay) in [(1e-3, 0.0), (0.0, 1e-3), (2e-3, 1e-3)] {
            let mut cell = ForceCellLag::new(time_constant, delay);
            let mut readings: Vec<f64> = forces
                .iter()
                .map(|force| {
                    cell.follow(*force, 5e-4);
                    cell.reading(0.0, *force)
                })
                .collect();
            cell.made_up_for(&mut readings, 5e-4);
            // At the end nothing is known of what is still on its way.
            for k in 4..195 {
                let off = (readings[k] - forces[k]).abs();
                assert!(off < 1e-9, "{time_constant} s, {delay} s, sample {k}: {off} N");
            }
        }
    }

    #[test]
    fn proposal_finds_the_lag_on_either_side_and_nothing_in_noise() {
        // The command of the record is held over each step, which comes half a step sooner.
        let expected = 2e-3 - 0.5 * STEP;
        let found = proposal(&DESCRIPTOR, &[2e-3, 0.0]);
        assert!((found[0] / expected - 1.0).abs() < 0.05, "{found:?}");
        let mut of_carriage = Record::motion().with_effect(&DESCRIPTOR, &[2e-3, 0.0]);
        of_carriage.force.iter_mut().for_each(|force| *force = -*force);
        let found = propose(&of_carriage.with_noise(0.3, 12).residual()).unwrap();
        assert!((found[0] / expected - 1.0).abs() < 0.05, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
