//! The loop measured as a drive's autotuner does it: a sine added to the controller's force, one
//! frequency after the other, on the emulator or on a running stage.

use std::f64::consts::TAU;

use nalgebra::Complex;

use friction_stage_core::control::{Controller, ControllerSettings, Follower};
use friction_stage_core::model::StageModel;
use friction_stage_core::numerics::sinusoid::SinusoidSums;
use friction_stage_core::plant::{Rates, Stage};

use super::margins::LoopResponse;
use super::stage::{SampledStage, StageMotion};
use crate::frequency_response::coherence;
use crate::specimen::{LabError, Settings};

/// Periods that are measured, each by itself, and the least time, s, of them all.
const PERIODS: usize = 8;
const MEASURE: f64 = 0.2;
/// Time before them, s and periods, whichever is longer.
const SETTLE: (f64, f64) = (0.3, 4.0);
/// Largest force on the motor, as a part of its limit. Assumed: leaves room for the model's errors.
const WITHIN_MOTOR: f64 = 0.5;
/// Time over which the sine grows and falls, s.
const RAMP: f64 = 0.1;

/// The loop at one frequency as measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredLoopPoint {
    /// Hz
    pub frequency: f64,
    /// Amplitude of the position, m.
    pub amplitude: f64,
    /// L: what the controller gives back of the force that acts, with its sign turned.
    pub open_loop: Complex<f64>,
    /// Position over that force, m/N.
    pub stage: Complex<f64>,
    /// Of that, 0 to 1.
    pub coherence: f64,
    /// Harmonics of the position, second to fifth and below half the rate, over its sine: a
    /// describing function neglects them.
    pub distortion: f64,
}

impl MeasuredLoopPoint {
    /// Whether the stage moved and all values are numbers.
    pub fn is_usable(&self) -> bool {
        let Complex { re, im } = self.open_loop + self.stage;
        let values = [re, im, self.amplitude, self.coherence, self.distortion];
        values.iter().all(|value| value.is_finite()) && self.amplitude > 0.0
    }
}

/// A sine of the force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopSine {
    /// Hz
    pub frequency: f64,
    /// Amplitude, N.
    pub force: f64,
}

impl LoopSine {
    /// Time until everything swings as the sine does, s.
    fn settle(&self) -> f64 {
        SETTLE.0.max(SETTLE.1 / self.frequency)
    }

    /// End of the measurement, s.
    fn end(&self) -> f64 {
        let periods = PERIODS.max((MEASURE * self.frequency).ceil() as usize);
        self.settle() + periods as f64 / self.frequency
    }

    /// From its start until it has fallen to nothing, s.
    pub fn duration(&self) -> f64 {
        self.end() + RAMP
    }
}

/// Sums over the samples of one sine.
#[derive(Debug, Default)]
struct SineSums {
    /// Of position, controller's force and whole force.
    all: [SinusoidSums; 3],
    overtones: [SinusoidSums; 4],
    /// Of position and whole force, in each part of the measurement.
    each: [[SinusoidSums; 2]; PERIODS],
}

impl SineSums {
    /// Harmonics are summed up to the order `highest`.
    fn add(&mut self, phase: f64, part: usize, highest: u32, [position, output, total]: [f64; 3]) {
        for (sums, value) in self.all.iter_mut().zip([position, output, total]) {
            sums.add(phase, value);
        }
        for (sums, order) in self.overtones.iter_mut().zip(2..=highest) {
            sums.add(f64::from(order) * phase, position);
        }
        let part = &mut self.each[part.min(PERIODS - 1)];
        part[0].add(phase, position);
        part[1].add(phase, total);
    }

    fn point(&self, frequency: f64) -> MeasuredLoopPoint {
        let [position, output, total] = self.all.each_ref().map(phasor);
        let pairs = self.each.each_ref().map(|[x, u]| (phasor(u), phasor(x)));
        MeasuredLoopPoint {
            frequency,
            amplitude: position.norm(),
            open_loop: -output / total,
            stage: position / total,
            coherence: coherence(&pairs),
            distortion: self
                .overtones
                .iter()
                .map(|sums| phasor(sums).norm_sqr())
                .sum::<f64>()
                .sqrt()
                / position.norm(),
        }
    }
}

/// Measures a closed loop sample by sample: says which force to add to the controller's, and takes
/// what the stage did. One sine after the other, each growing and falling smoothly. Nothing here
/// allocates after construction.
#[derive(Debug)]
pub struct LoopProbe {
    sines: Vec<LoopSine>,
    /// Samples per second, Hz.
    rate: f64,
    sums: SineSums,
    /// Start of the sine that is measured, s.
    begin: Option<f64>,
    points: Vec<MeasuredLoopPoint>,
}

impl LoopProbe {
    /// Measures with these sines, in their order, a loop with `rate` samples per second (Hz).
    pub fn new(sines: Vec<LoopSine>, rate: f64) -> LoopProbe {
        let points = Vec::with_capacity(sines.len());
        LoopProbe { sines, rate, sums: SineSums::default(), begin: None, points }
    }

    /// Time of the whole measurement, s.
    pub fn duration(&self) -> f64 {
        self.sines.iter().map(LoopSine::duration).sum()
    }

    /// The sine that is measured now; `None`: it is over.
    pub fn sine(&self) -> Option<LoopSine> {
        self.sines.get(self.points.len()).copied()
    }

    /// What was measured so far, one point for each sine that is over.
    pub fn into_points(self) -> Vec<MeasuredLoopPoint> {
        self.points
    }

    /// The force, N, to add to the controller's `output` (N) for the sample at `time` (s), which
    /// grows, with the measured `position` (m). The sum of both must reach the motor.
    pub fn update(&mut self, time: f64, position: f64, output: f64) -> f64 {
        let Some(mut sine) = self.sine() else { return 0.0 };
        let mut begin = *self.begin.get_or_insert(time);
        if time - begin >= sine.duration() {
            self.points.push(self.sums.point(sine.frequency));
            self.sums = SineSums::default();
            (self.begin, begin) = (Some(time), time);
            match self.sine() {
                Some(next) => sine = next,
                None => return 0.0,
            }
        }
        let elapsed = time - begin;
        let phase = TAU * sine.frequency * elapsed;
        let (settle, end) = (sine.settle(), sine.end());
        let size = (elapsed / RAMP).min(1.0).min(1.0 - (elapsed - end) / RAMP).max(0.0);
        let force = size * sine.force * phase.sin();
        if elapsed >= settle && elapsed < end {
            let part = ((elapsed - settle) / (end - settle) * PERIODS as f64) as usize;
            // Harmonics from half the rate on appear at other frequencies.
            let highest = ((0.5 * self.rate / sine.frequency).ceil() as u32).saturating_sub(1);
            self.sums.add(phase, part, highest, [position, output, output + force]);
        }
        force
    }
}

/// Measures the loop at `frequencies` (Hz) on a stage that holds its position, with a sine of the
/// force that moves the carriage by about `amplitude` (m), as the model says, or by what half of
/// the motor's force can.
pub fn measure_loop(
    model: &StageModel,
    settings: &Settings,
    controller: &ControllerSettings,
    amplitude: f64,
    frequencies: &[f64],
) -> Result<Vec<MeasuredLoopPoint>, LabError> {
    let rate = settings.rates.control();
    let motion = StageMotion::Amplitude(amplitude);
    let stage = SampledStage::new(model, rate, 0.0, motion, frequencies)?;
    let expected = LoopResponse::new(&stage, controller);
    let mut points = Vec::with_capacity(frequencies.len());
    for point in &expected.points {
        let within_motor = WITHIN_MOTOR * model.motor.force_limit / point.sensitivity.norm();
        let force = (amplitude / point.process.norm()).min(within_motor);
        let sine = LoopSine { frequency: point.frequency, force };
        points.extend(measure(model, settings, controller, sine)?);
    }
    Ok(points)
}

/// The point of one sine, on a stage of its own.
fn measure(
    model: &StageModel,
    settings: &Settings,
    controller: &ControllerSettings,
    sine: LoopSine,
) -> Result<Vec<MeasuredLoopPoint>, LabError> {
    let rates: Rates = settings.rates;
    let mut stage = Stage::new(model, rates, settings.seed)?;
    let mut controller = Controller::new(controller.clone())?;
    let mut follower = Follower::new(f64::INFINITY);
    let mut probe = LoopProbe::new(vec![sine], rates.control());
    for k in 0.. {
        let sample = stage.sample();
        if k == 0 {
            follower.hold(sample.time, sample.position);
        }
        let output = controller.update(sample.time, sample.position, &mut follower).output;
        let added = probe.update(k as f64 / rates.control(), sample.position, output);
        if probe.sine().is_none() {
            break;
        }
        stage.advance(output + added);
    }
    Ok(probe.into_points())
}

fn phasor(sums: &SinusoidSums) -> Complex<f64> {
    sums.solve().map_or(Complex::new(0.0, 0.0), |found| Complex::new(found.sine, found.cosine))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sine_has_no_harmonics_at_any_part_of_the_rate() {
        const RATE: f64 = 1000.0;
        for part in [0.01, 0.1, 1.0 / 6.0, 0.2, 0.25, 1.0 / 3.0, 0.37, 0.4] {
            let sine = LoopSine { frequency: part * RATE, force: 20.0 };
            let mut probe = LoopProbe::new(vec![sine], RATE);
            // A stage that gives 1 µm/N, one sample later.
            let mut position = 0.0;
            for k in 0.. {
                position = 1e-6 * probe.update(f64::from(k) / RATE, position, 0.0);
                if probe.sine().is_none() {
                    break;
                }
            }
            let [point] = probe.into_points()[..] else { panic!("one sine is one point") };
            assert!(point.distortion < 0.01 && point.is_usable(), "{point:?}");
            assert!((point.stage.norm() / 1e-6 - 1.0).abs() < 1e-3, "{point:?}");
            assert!(point.coherence > 0.999, "{point:?}");
        }
    }
}
