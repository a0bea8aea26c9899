//! Cogging: the magnets of the motor pull the slider towards the iron teeth.
//!
//! F = A sin(2 pi x / p + phi), along +x on the motor side: A amplitude (N), p period (m), phi phase at x = 0 (rad).
//! The force depends on position alone, not on current and not on speed, and does no work over a period.
//! Source: first harmonic of the detent force of iron-core linear motors (Gieras, Piech, Tomczuk, "Linear Synchronous
//! Motors", 2nd ed. 2011). Sizes: assumed, 1 to 2 % of rated force at a magnet pitch of 24 to 32 mm.
//! Not modelled: higher harmonics, end effects of the slider.

use std::f64::consts::{PI, TAU};

use super::{Effect, EffectDescriptor, EffectParameter, Motion, Residual, Side};

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "cogging",
    side: Side::Motor,
    law: "F = amplitude sin(2 pi x / period + phase)",
    source: "Gieras, Piech, Tomczuk 2011, first harmonic of the detent force",
    telltale: "periodic in position at every speed, independent of the force, seen by the force cell",
    confused_with: &["force_ripple", "ball_passage", "cable_chain"],
    parameters: &[
        EffectParameter {
            name: "amplitude",
            unit: "N",
            description: "peak force",
            bounds: (0.0, 1000.0),
            default: None,
        },
        EffectParameter {
            name: "period",
            unit: "m",
            description: "distance after which the force repeats",
            bounds: (1e-4, 1.0),
            default: None,
        },
        EffectParameter {
            name: "phase",
            unit: "rad",
            description: "phase at position 0",
            bounds: (-TAU, TAU),
            default: Some(0.0),
        },
    ],
    build: |values| Box::new(Cogging { amplitude: values[0], wave_number: TAU / values[1], phase: values[2] }),
    propose,
};

#[derive(Debug)]
struct Cogging {
    amplitude: f64,
    wave_number: f64,
    phase: f64,
}

impl Effect for Cogging {
    fn force(&mut self, motion: &Motion, _step: f64) -> f64 {
        self.amplitude * (self.wave_number * motion.position + self.phase).sin()
    }

    fn stored_energy(&self, _time: f64, position: f64) -> f64 {
        self.amplitude / self.wave_number * (self.wave_number * position + self.phase).cos()
    }
}

/// Steps of the period search per octave: a tenth of a period is then resolved over ten periods of stroke.
const PERIODS_PER_OCTAVE: usize = 100;

/// The period whose sine and cosine over position take most out of the residual, by least squares on a logarithmic grid.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let lowest = residual.position.iter().copied().fold(f64::INFINITY, f64::min);
    let highest = residual.position.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let stroke = highest - lowest;
    let shortest = 1e-4_f64.max(stroke / 200.0);
    if !stroke.is_finite() || stroke <= shortest || residual.force.len() < 10 {
        return None;
    }
    let octaves = (stroke / shortest).log2();
    let count = (octaves * PERIODS_PER_OCTAVE as f64).ceil() as usize;
    (0..=count)
        .filter_map(|index| {
            let period = stroke * (-octaves * index as f64 / count as f64).exp2();
            let columns = |position: f64| [1.0, (TAU / period * position).sin(), (TAU / period * position).cos()];
            let (coefficients, explained) = super::least_squares(residual.position, residual.force, columns)?;
            Some((explained, period, coefficients))
        })
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|(explained, ..)| *explained > 0.0)
        .map(|(_, period, [_, sine, cosine])| {
            let phase = cosine.atan2(sine);
            debug_assert!(phase.abs() <= PI);
            vec![sine.hypot(cosine), period, phase]
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn force_is_the_slope_of_the_stored_energy() {
        let mut cogging = Cogging { amplitude: 6.0, wave_number: TAU / 0.024, phase: 0.4 };
        for position in [-0.03, 0.0, 0.007, 0.021] {
            let h = 1e-6;
            let slope = (cogging.stored_energy(0.0, position + h) - cogging.stored_energy(0.0, position - h)) / (2.0 * h);
            let motion = Motion { time: 0.0, position, velocity: 0.0, motor_force: 0.0 };
            assert!((cogging.force(&motion, 1e-5) + slope).abs() < 1e-6);
        }
    }

    #[test]
    fn proposal_finds_amplitude_period_and_phase_in_a_residual() {
        let position: Vec<f64> = (0..4000).map(|k| 0.05 * (0.5 - 0.5 * (k as f64 * 0.004).cos())).collect();
        // A deterministic disturbance of half the size stands for noise.
        let force: Vec<f64> = position
            .iter()
            .enumerate()
            .map(|(k, x)| 0.3 + 6.0 * (TAU * x / 0.0123 + 1.1).sin() + 3.0 * ((k * k) as f64 * 0.71).sin())
            .collect();
        let zeros = vec![0.0; position.len()];
        let residual = Residual { time: &zeros, position: &position, velocity: &zeros, force: &force };
        let found = propose(&residual).unwrap();
        assert!((found[0] - 6.0).abs() < 0.5 && (found[1] / 0.0123 - 1.0).abs() < 0.01, "{found:?}");
        assert!((found[2] - 1.1).abs() < 0.2, "{found:?}");
    }
}
