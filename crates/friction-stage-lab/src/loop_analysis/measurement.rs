//! The loop measured on the emulator as a drive's autotuner does it: a sine added to the
//! controller's force, one frequency after the other.

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
/// Time over which the sine grows, s.
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
    /// Harmonics of the position, second to fifth, over its sine: a describing function takes them
    /// for nothing.
    pub distortion: f64,
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
    expected
        .points
        .iter()
        .map(|point| {
            let within_motor = WITHIN_MOTOR * model.motor.force_limit / point.sensitivity.norm();
            let force = (amplitude / point.process.norm()).min(within_motor);
            measure(model, settings, controller, force, point.frequency)
        })
        .collect()
}

fn measure(
    model: &StageModel,
    settings: &Settings,
    controller: &ControllerSettings,
    force: f64,
    frequency: f64,
) -> Result<MeasuredLoopPoint, LabError> {
    let rates: Rates = settings.rates;
    let rate = rates.control();
    let mut stage = Stage::new(model, rates, settings.seed)?;
    let mut controller = Controller::new(controller.clone())?;
    let mut follower = Follower::new(f64::INFINITY);
    let settle = SETTLE.0.max(SETTLE.1 / frequency);
    let periods = PERIODS.max((MEASURE * frequency).ceil() as usize);
    let end = settle + periods as f64 / frequency;
    let mut all: [SinusoidSums; 3] = Default::default();
    let mut overtones: [SinusoidSums; 4] = Default::default();
    let mut each: Vec<[SinusoidSums; 2]> = vec![Default::default(); PERIODS];
    for k in 0..(end * rate).ceil() as usize {
        let time = k as f64 / rate;
        let phase = TAU * frequency * time;
        let sample = stage.sample();
        if k == 0 {
            follower.hold(sample.time, sample.position);
        }
        let output = controller.update(sample.time, sample.position, &mut follower).output;
        let total = output + (time / RAMP).min(1.0) * force * phase.sin();
        if time >= settle {
            for (sums, value) in all.iter_mut().zip([sample.position, output, total]) {
                sums.add(phase, value);
            }
            for (sums, order) in overtones.iter_mut().zip(2..) {
                sums.add(f64::from(order) * phase, sample.position);
            }
            let part = ((time - settle) / (end - settle) * PERIODS as f64) as usize;
            let part = &mut each[part.min(PERIODS - 1)];
            part[0].add(phase, sample.position);
            part[1].add(phase, total);
        }
        stage.advance(total);
    }
    let [position, output, total] = all.map(|sums| phasor(&sums));
    let pairs: Vec<_> = each.iter().map(|[x, u]| (phasor(u), phasor(x))).collect();
    Ok(MeasuredLoopPoint {
        frequency,
        amplitude: position.norm(),
        open_loop: -output / total,
        stage: position / total,
        coherence: coherence(&pairs),
        distortion: overtones.iter().map(|sums| phasor(sums).norm_sqr()).sum::<f64>().sqrt()
            / position.norm(),
    })
}

fn phasor(sums: &SinusoidSums) -> Complex<f64> {
    sums.solve().map_or(Complex::new(0.0, 0.0), |found| Complex::new(found.sine, found.cosine))
}
