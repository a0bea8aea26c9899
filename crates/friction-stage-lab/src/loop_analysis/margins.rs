//! Open loop, sensitivities and margins of one controller on one stage.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::Complex;
use serde::Serialize;

use friction_stage_core::control::ControllerSettings;

use super::stage::SampledStage;

/// The loop at one frequency.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopPoint {
    /// Hz
    pub frequency: f64,
    /// L = P C.
    pub open_loop: Complex<f64>,
    /// S = 1 / (1 + L), error over disturbance of the position.
    pub sensitivity: Complex<f64>,
    /// T = L / (1 + L), position over reference.
    pub complementary: Complex<f64>,
    /// P S, position over a force on the motor, m/N.
    pub process: Complex<f64>,
}

/// The loop over the frequency.
#[derive(Clone, Debug, PartialEq)]
pub struct LoopResponse {
    /// The loop at ascending frequencies.
    pub points: Vec<LoopPoint>,
    /// Poles of the open loop at z = 1.
    pub integrators: u32,
}

/// How far a loop is from instability.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Margins {
    /// Whether the closed loop is stable (Nyquist's criterion).
    pub stable: bool,
    /// Highest frequency at which |L| falls through 1, Hz.
    pub crossover: Option<f64>,
    /// Factor by which the gain may grow; `None`: any.
    pub gain_margin: Option<f64>,
    /// Factor to which the gain may fall; `None`: to nothing.
    pub least_gain: Option<f64>,
    /// Least phase between L and -1 where |L| is 1, degrees; `None` where it never is.
    pub phase_margin: Option<f64>,
    /// Modulus margin: least distance of L from -1, which is 1 over the largest |S|.
    pub modulus_margin: f64,
    /// Where that is, Hz.
    pub modulus_frequency: f64,
}

impl Margins {
    /// Largest |S|, dB.
    pub fn peak_sensitivity_db(&self) -> f64 {
        -20.0 * self.modulus_margin.log10()
    }
}

impl LoopResponse {
    /// The loop of a controller that samples at the rate of the stage.
    pub fn new(stage: &SampledStage, controller: &ControllerSettings) -> LoopResponse {
        let response =
            LoopResponse::of(stage, controller, |frequency| controller.transfer(frequency));
        let observed = u32::from(controller.observer.is_some());
        LoopResponse { integrators: response.integrators + observed, ..response }
    }

    /// The same without the lowpass after the PID and without a disturbance observer.
    pub fn without_lowpass(stage: &SampledStage, controller: &ControllerSettings) -> LoopResponse {
        let rate = controller.rate;
        LoopResponse::of(stage, controller, |frequency| controller.gains.transfer(frequency, rate))
    }

    fn of(
        stage: &SampledStage,
        controller: &ControllerSettings,
        transfer: impl Fn(f64) -> Complex<f64>,
    ) -> LoopResponse {
        let along = stage.frequencies.iter().zip(&stage.response);
        let points = along
            .map(|(frequency, response)| {
                let open_loop = response * transfer(*frequency);
                let sensitivity = (open_loop + 1.0).inv();
                LoopPoint {
                    frequency: *frequency,
                    open_loop,
                    sensitivity,
                    complementary: open_loop * sensitivity,
                    process: response * sensitivity,
                }
            })
            .collect();
        let integral = u32::from(controller.gains.i > 0.0);
        LoopResponse { points, integrators: stage.integrators + integral }
    }

    /// The margins of the loop.
    pub fn margins(&self) -> Margins {
        let (mut crossover, mut phase_margin) = (None, None::<f64>);
        let (mut gain_margin, mut least_gain) = (None::<f64>, None::<f64>);
        for pair in self.points.windows(2) {
            let (a, b) = (&pair[0], &pair[1]);
            let (below, above) = (a.open_loop.norm().ln(), b.open_loop.norm().ln());
            let turned = (b.open_loop / a.open_loop).arg();
            if (below > 0.0) != (above > 0.0) {
                let share = below / (below - above);
                let frequency = between(a.frequency, b.frequency, share);
                if below > 0.0 {
                    crossover = Some(frequency);
                }
                let phase = (-a.open_loop).arg() + share * turned;
                let margin = wrapped(phase).abs().to_degrees();
                phase_margin = Some(phase_margin.map_or(margin, |least| least.min(margin)));
            }
            // Where L crosses the negative real axis.
            let start = (-a.open_loop).arg();
            let end = start + turned;
            if (start < 0.0) != (end < 0.0) && start.abs() < FRAC_PI_2 {
                let share = start / (start - end);
                let factor = (-(below + share * (above - below))).exp();
                if factor > 1.0 {
                    gain_margin = Some(gain_margin.map_or(factor, |least| least.min(factor)));
                } else {
                    least_gain = Some(least_gain.map_or(factor, |most| most.max(factor)));
                }
            }
        }
        let least = |least: (f64, f64), one: (f64, f64)| if one.0 < least.0 { one } else { least };
        let (modulus_margin, modulus_frequency) =
            self.points.windows(2).map(nearest).fold((f64::INFINITY, 0.0), least);
        Margins {
            stable: self.unstable_poles() == 0,
            crossover,
            gain_margin,
            least_gain,
            phase_margin,
            modulus_margin,
            modulus_frequency,
        }
    }

    /// Closed-loop poles outside of the unit circle, by the argument principle for 1 + L: all poles
    /// of the open loop are inside or at z = 1, and the path passes those on the outside.
    fn unstable_poles(&self) -> i64 {
        let difference: Vec<Complex<f64>> =
            self.points.iter().map(|point| point.open_loop + 1.0).collect();
        let Some(first) = difference.first() else { return 0 };
        // A quarter of a small circle turns 1 + L by a quarter turn back per pole at z = 1.
        let turned = -f64::from(self.integrators) * FRAC_PI_2;
        let start = turned + wrapped(first.arg() - turned);
        let end =
            difference.windows(2).fold(start, |phase, pair| phase + (pair[1] / pair[0]).arg());
        (-end / PI).round() as i64
    }
}

/// Least distance of L from -1 along the chord between two frequencies, and where that is, Hz.
fn nearest(pair: &[LoopPoint]) -> (f64, f64) {
    let (a, b) = (&pair[0], &pair[1]);
    let (from, way) = (a.open_loop + 1.0, b.open_loop - a.open_loop);
    let along = -(from.conj() * way).re / way.norm_sqr();
    let share = if along.is_finite() { along.clamp(0.0, 1.0) } else { 0.0 };
    ((from + way * share).norm(), between(a.frequency, b.frequency, share))
}

/// Between two frequencies, in their logarithm.
fn between(low: f64, high: f64, share: f64) -> f64 {
    low * (high / low).powf(share)
}

/// An angle between -pi and pi.
fn wrapped(angle: f64) -> f64 {
    let turns = (angle / TAU).round();
    angle - TAU * turns
}
