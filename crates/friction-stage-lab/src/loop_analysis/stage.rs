//! The stage between the held force and the sampled position, for sinusoidal motions of one
//! amplitude.

use std::f64::consts::{PI, TAU};

use nalgebra::Complex;

use friction_stage_core::model::{Coupling, ModelError, StageModel};
use friction_stage_core::plant::effects::{Effects, Motion};
use friction_stage_core::plant::{EffectDescriptor, FrictionScale, GuideBank};

/// Lowest frequency that is looked at, as a part of the sampling rate, and the number of
/// frequencies. Assumed: five times below the integrator of the slowest loop that makes sense.
const LOWEST: f64 = 2e-5;
const COUNT: usize = 400;
/// Steps per period of the sine that the guides are driven along: a polygon of so many corners has
/// the fundamental of the sine to 2e-4.
const STEPS: usize = 128;
/// Periods until the bristles repeat themselves, and those that are projected.
const SETTLE: usize = 2;
const MEASURE: usize = 1;
/// Time, s, and most periods over which effects with a state of their own come to rest. Assumed.
const EFFECTS_SETTLE: (f64, usize) = (0.3, 60);
/// Images of the sampling on either side that count: the terms fall with the third power of their
/// number.
const IMAGES: i32 = 12;

/// How the carriage moves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StageMotion {
    /// A free mass, without guides and effects on the carriage: what the rule of thumb for a
    /// bandwidth takes it for.
    PlainMass,
    /// Sinusoidal with this amplitude, m.
    Amplitude(f64),
}

/// Position over force of a stage at some frequencies, from the samples of the force that is held
/// to those of the encoder.
#[derive(Clone, Debug, PartialEq)]
pub struct SampledStage {
    /// Motion of the carriage that the response holds for.
    pub motion: StageMotion,
    /// Hz
    pub rate: f64,
    /// Ascending, Hz, at most half the rate.
    pub frequencies: Vec<f64>,
    /// m/N
    pub response: Vec<Complex<f64>>,
    /// Poles at z = 1: two of a free mass, none of a stage on the springs of its guides.
    pub integrators: u32,
}

/// Frequencies from 2e-5 to half the sampling rate, Hz, even in their logarithm.
pub fn loop_frequencies(rate: f64) -> Vec<f64> {
    let (first, last) = (LOWEST * rate, 0.5 * rate);
    (0..COUNT).map(|k| first * (last / first).powf(k as f64 / (COUNT - 1) as f64)).collect()
}

impl SampledStage {
    /// The stage of a model, sampled at `rate` (Hz), with `delay` (s) between a sample and the
    /// force that answers it.
    pub fn new(
        model: &StageModel,
        rate: f64,
        delay: f64,
        motion: StageMotion,
        frequencies: &[f64],
    ) -> Result<SampledStage, ModelError> {
        model.check()?;
        let guides = model.resolved_guides()?;
        let mut effects = Effects::new(&model.effects)?;
        let carriage = Carriage {
            mass: match motion {
                // What swings with the carriage on a spring of its own is part of the mass.
                StageMotion::PlainMass => model.mass + constant_mass(model)?,
                StageMotion::Amplitude(_) => model.mass + effects.added_mass(),
            },
            coupling: model.coupling.clone(),
        };
        let elements = effects.bristle_elements();
        let bank = || match elements {
            Some(elements) => GuideBank::with_elements(&guides, &elements),
            None => GuideBank::new(&guides),
        };
        let mut of_friction = |frequency: &f64| match motion {
            StageMotion::PlainMass => Complex::new(0.0, 0.0),
            StageMotion::Amplitude(amplitude) => {
                describing_function(bank(), &mut effects, amplitude, *frequency)
            }
        };
        let friction: Vec<_> = frequencies.iter().map(&mut of_friction).collect();
        let late = |w: f64| effects.command_transfer(w) * Complex::from_polar(1.0, -w * delay);
        let response = frequencies
            .iter()
            .zip(&friction)
            .map(|(frequency, friction)| sampled(&carriage, late, *friction, rate, *frequency))
            .collect();
        Ok(SampledStage {
            motion,
            rate,
            frequencies: frequencies.to_vec(),
            response,
            integrators: match motion {
                StageMotion::PlainMass => 2,
                StageMotion::Amplitude(_) => 0,
            },
        })
    }
}

/// Mass that the effects of a model always add, kg.
fn constant_mass(model: &StageModel) -> Result<f64, ModelError> {
    model.effects.iter().try_fold(0.0, |sum, effect| {
        let (descriptor, values) = EffectDescriptor::read(effect)?;
        Ok(sum + descriptor.constant_mass(&values))
    })
}

/// The mechanics without the guides.
struct Carriage {
    /// kg
    mass: f64,
    coupling: Option<Coupling>,
}

impl Carriage {
    /// Position of the carriage over the force of the motor, m/N, at w (rad/s) with this dynamic
    /// stiffness of guides and effects, N/m.
    fn compliance(&self, w: f64, friction: Complex<f64>) -> Complex<f64> {
        let carriage = friction - w * w * self.mass;
        let Some(Coupling { stiffness, damping, motor_mass }) = &self.coupling else {
            return carriage.inv();
        };
        let flexure = Complex::new(*stiffness, w * damping);
        flexure / ((flexure - w * w * motor_mass) * (flexure + carriage) - flexure * flexure)
    }
}

/// Samples of the position over samples of the held force: the sum over all frequencies that the
/// hold makes and the samples fold back (Franklin, Powell, Workman, Digital Control of Dynamic
/// Systems, 3rd ed. 1998, ch. 5).
fn sampled(
    carriage: &Carriage,
    late: impl Fn(f64) -> Complex<f64>,
    friction: Complex<f64>,
    rate: f64,
    frequency: f64,
) -> Complex<f64> {
    let base = TAU * frequency;
    (-IMAGES..=IMAGES)
        .map(|image| {
            let w = base + TAU * rate * f64::from(image);
            // (1 - exp(-j w T)) / (j w T)
            let half = 0.5 * w / rate;
            let sinc = if half == 0.0 { 1.0 } else { half.sin() / half };
            let hold = Complex::from_polar(1.0, -half) * sinc;
            // A spring and a damper, as they are at the frequency itself.
            let friction = Complex::new(friction.re, friction.im * w / base);
            // Of a real system the response to -w is the conjugate of that to w.
            let late = if w < 0.0 { late(-w).conj() } else { late(w) };
            carriage.compliance(w, friction) * hold * late
        })
        .sum()
}

/// First harmonic of the force of guides and effects against the motion A sin(w t), over A: a
/// dynamic stiffness, N/m, positive where it pulls back.
fn describing_function(
    mut bank: GuideBank,
    effects: &mut Effects,
    amplitude: f64,
    frequency: f64,
) -> Complex<f64> {
    let settle = if effects.is_empty() {
        SETTLE
    } else {
        let periods = (EFFECTS_SETTLE.0 * frequency).ceil() as usize;
        periods.clamp(SETTLE, EFFECTS_SETTLE.1)
    };
    let step = (frequency * STEPS as f64).recip();
    let along = |k: usize| amplitude * (TAU * k as f64 / STEPS as f64).sin();
    let total = (settle + MEASURE) * STEPS;
    let mut sum = Complex::new(0.0, 0.0);
    let mut lead = |moving: bool, effects: &mut Effects| {
        effects.reset(0.0);
        for k in 0..total {
            let (from, to) = if moving { (along(k), along(k + 1)) } else { (0.0, 0.0) };
            let velocity = (to - from) / step;
            let middle = k as f64 + 0.5;
            let phase = TAU * middle / STEPS as f64;
            let w = TAU * frequency;
            let motion = Motion {
                time: middle * step,
                position: 0.5 * (from + to),
                velocity,
                acceleration: if moving { -w * w * amplitude * phase.sin() } else { 0.0 },
                ..Motion::default()
            };
            let scale = if effects.is_empty() {
                FrictionScale::ONE
            } else {
                effects.friction(&motion, step)
            };
            let friction = if moving { bank.drive(velocity, step, &scale) } else { 0.0 };
            let pushed = if effects.is_empty() {
                0.0
            } else {
                let (motor, carriage) = effects.advance(&motion, step);
                motor + carriage
            };
            if k >= settle * STEPS {
                // The part along sin(w t) is a stiffness, that along cos(w t) a damping.
                let against = if moving { friction - pushed } else { pushed };
                sum += Complex::new(phase.sin(), phase.cos()) * against;
            }
        }
    };
    lead(true, effects);
    if !effects.is_empty() {
        // What is there without a motion is no answer to it.
        lead(false, effects);
    }
    // The mean over a step has this share of the fundamental.
    let share = (PI / STEPS as f64).sin() / (PI / STEPS as f64);
    sum * (2.0 / ((MEASURE * STEPS) as f64 * amplitude * share.powi(2)))
}
