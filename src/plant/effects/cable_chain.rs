//! Cable chain: the cables of the carriage pull it towards where they hang free, with some hysteresis.
//!
//! F = -k (x - xc) - A h, along +x on the carriage: k stiffness (N/m), xc center (m), A amplitude of the hysteresis (N).
//! h runs from -1 to 1 with the path: dh/dx = (sign(v) - h) / w, w width of the transition (m); exact for each step.
//! Source of the hysteresis: Dahl's model with exponent 1 (P. Dahl, "A solid friction model", 1968); of the spring: assumed
//! linear over the stroke. Sizes: assumed, 1 to 10 N over the stroke.
//! Not modelled: bumps of single links, dwell-time creep of the cables.

use super::{Effect, EffectDescriptor, EffectParameter, Motion, Residual, Side};

/// Path over which the hysteresis turns where nothing else is known, m. Assumed.
const WIDTH: f64 = 1e-3;

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "cable_chain",
    side: Side::Carriage,
    law: "F = -stiffness (x - center) - amplitude h, dh/dx = (sign(v) - h) / width",
    source: "linear spring (assumed) and Dahl 1968 hysteresis",
    telltale: "low-order polynomial in position at every speed, not seen by the force cell",
    confused_with: &["constant_force", "position_dependent_friction", "cogging"],
    parameters: &[
        EffectParameter {
            name: "stiffness",
            unit: "N/m",
            description: "spring stiffness of the cables",
            bounds: (0.0, 1e5),
            default: None,
        },
        EffectParameter {
            name: "center",
            unit: "m",
            description: "position at which the cables do not pull",
            bounds: (-10.0, 10.0),
            default: Some(0.0),
        },
        EffectParameter {
            name: "amplitude",
            unit: "N",
            description: "force of the hysteresis",
            bounds: (0.0, 1000.0),
            default: Some(0.0),
        },
        EffectParameter {
            name: "width",
            unit: "m",
            description: "path over which the hysteresis turns",
            bounds: (1e-6, 1.0),
            default: Some(WIDTH),
        },
    ],
    build: |values| {
        Box::new(CableChain {
            stiffness: values[0],
            center: values[1],
            amplitude: values[2],
            width: values[3],
            hysteresis: 0.0,
        })
    },
    propose,
};

#[derive(Debug)]
struct CableChain {
    stiffness: f64,
    center: f64,
    amplitude: f64,
    width: f64,
    /// h, -1 to 1.
    hysteresis: f64,
}

impl Effect for CableChain {
    fn force(&mut self, motion: &Motion, step: f64) -> f64 {
        let before = self.hysteresis;
        if self.amplitude > 0.0 {
            let target = motion.velocity.signum();
            let path = motion.velocity.abs() * step;
            self.hysteresis = target + (before - target) * (-path / self.width).exp();
        }
        let middle = 0.5 * (before + self.hysteresis);
        -self.stiffness * (motion.position - self.center) - self.amplitude * middle
    }

    fn stored_energy(&self, _time: f64, position: f64) -> f64 {
        let stretch = position - self.center;
        0.5 * self.stiffness * stretch * stretch + 0.5 * self.amplitude * self.width * self.hysteresis * self.hysteresis
    }

    fn reset(&mut self) {
        self.hysteresis = 0.0;
    }
}

/// Spring from the slope of the residual over position, hysteresis from its step with the direction of motion.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let pairs: Vec<(f64, f64)> =
        residual.position.iter().zip(residual.velocity).map(|(position, velocity)| (*position, velocity.signum())).collect();
    let (coefficients, explained) = super::least_squares(&pairs, residual.force, |(x, direction)| [1.0, x, direction])?;
    let [offset, slope, step] = coefficients;
    (explained > 0.0 && slope < 0.0).then(|| {
        vec![-slope, (-offset / slope).clamp(-10.0, 10.0), (-step).max(0.0), WIDTH]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chain() -> CableChain {
        CableChain { stiffness: 100.0, center: 0.01, amplitude: 2.0, width: 1e-3, hysteresis: 0.0 }
    }

    #[test]
    fn spring_pulls_towards_the_center_and_hysteresis_against_the_motion() {
        let mut chain = chain();
        let step = 1e-4;
        let mut force = 0.0;
        for k in 0..10_000 {
            let position = 0.1 * k as f64 * step;
            force = chain.force(&Motion { time: 0.0, position, velocity: 0.1, motor_force: 0.0 }, step);
        }
        // After 100 mm in one direction the hysteresis is fully turned: -100 (0.1 - 0.01) - 2.
        assert!((force + 11.0).abs() < 1e-2, "{force}");
    }

    #[test]
    fn a_closed_loop_of_motion_costs_the_area_of_the_hysteresis() {
        let mut chain = chain();
        let step = 1e-5;
        let mut work = 0.0;
        // Two round trips of +-10 mm at 0.1 m/s; the second is the closed loop: 2 A x 20 mm less the two turns (2 A w each).
        for k in 0..80_000u32 {
            let phase = k % 40_000;
            let (position, velocity) = if phase < 20_000 {
                (-0.01 + 1e-6 * f64::from(phase), 0.1)
            } else {
                (0.01 - 1e-6 * f64::from(phase - 20_000), -0.1)
            };
            let motion = Motion { time: 0.0, position, velocity, motor_force: 0.0 };
            let force = chain.force(&motion, step);
            if k >= 40_000 {
                work -= force * velocity * step;
            }
        }
        let expected = 2.0 * 2.0 * 0.02 - 2.0 * 2.0 * 2.0 * 1e-3;
        assert!((work / expected - 1.0).abs() < 1e-3, "{work} {expected}");
    }

    #[test]
    fn proposal_finds_spring_and_center() {
        let position: Vec<f64> = (0..2000).map(|k| 0.05 * (k as f64 * 0.01).sin()).collect();
        let velocity: Vec<f64> = (0..2000).map(|k| 0.05 * (k as f64 * 0.01).cos()).collect();
        let force: Vec<f64> =
            position.iter().zip(&velocity).map(|(x, v)| -80.0 * (x - 0.02) - 1.5 * v.signum()).collect();
        let residual = Residual { time: &position, position: &position, velocity: &velocity, force: &force };
        let found = propose(&residual).unwrap();
        assert!((found[0] - 80.0).abs() < 1.0 && (found[1] - 0.02).abs() < 1e-3 && (found[2] - 1.5).abs() < 0.1, "{found:?}");
    }
}
