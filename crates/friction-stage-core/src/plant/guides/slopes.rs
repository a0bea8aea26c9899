//! How the friction of bristles that are driven along a motion changes with the parameters of their
//! guide: the laws differentiated step by step, all parameters in one pass.
//!
//! Each parameter works in three ways: on the deflection that a bristle ends on, on how fast it
//! gets there, and on the force of a deflection. The first two are one number: where the level g
//! grows by the part w, the deflection grows by w and the decay's exponent falls by w; sigma0 does
//! the opposite of g.

use std::f64::consts::LN_2;

use wide::f64x4;

use crate::model::{Guide, MAX_GUIDES};

use super::{FrictionScale, GuideBank, MAX_ELEMENTS};

/// Parameters of a guide that its bristles have: see [`BristleSlopes::parameters`].
pub const BRISTLE_PARAMETERS: usize = 5;
/// Those that move a deflection, which are the first.
const OF_DEFLECTION: usize = 4;

/// Derivatives of the friction of bristles by the logarithms of their guides' parameters, one lane
/// per guide.
#[derive(Clone, Debug)]
pub struct BristleSlopes {
    /// Derivatives of the deflections, m.
    bristle: [[f64x4; OF_DEFLECTION]; MAX_ELEMENTS],
    /// Derivatives of ln g, less that of ln sigma0.
    level: [f64x4; OF_DEFLECTION],
    /// Derivatives of the momentum that the step takes from the carriage, N s.
    impulse: [f64x4; BRISTLE_PARAMETERS],
}

impl BristleSlopes {
    /// Places of parameters in the order of the derivatives.
    pub const STIFFNESS: usize = 0;
    /// Place of static friction.
    pub const STATIC_FORCE: usize = 2;
    const BRISTLE_DAMPING: usize = 4;

    /// Of bristles whose deflections change by so much with each parameter, m per logarithm, those
    /// of all elements alike.
    pub fn new(bristle: [[f64; MAX_GUIDES]; BRISTLE_PARAMETERS]) -> BristleSlopes {
        let bristle = std::array::from_fn(|parameter| f64x4::new(bristle[parameter]));
        let nothing = f64x4::ZERO;
        BristleSlopes {
            bristle: [bristle; MAX_ELEMENTS],
            level: [nothing; OF_DEFLECTION],
            impulse: [nothing; BRISTLE_PARAMETERS],
        }
    }

    /// The parameters of a guide in the order of the derivatives.
    pub fn parameters(guide: &Guide) -> [f64; BRISTLE_PARAMETERS] {
        [
            guide.stiffness,
            guide.coulomb_force,
            guide.static_force,
            guide.stribeck_velocity,
            guide.bristle_damping,
        ]
    }

    /// By how much the mean friction of all guides over the last step, of so many seconds, changes
    /// along a direction, N: by how much the logarithms grow, by parameter and guide.
    #[inline]
    pub fn along(&self, direction: &[[f64; MAX_GUIDES]; BRISTLE_PARAMETERS], step: f64) -> f64 {
        let grown = self.impulse.iter().zip(direction);
        let impulse =
            grown.fold(f64x4::ZERO, |sum, (impulse, grows)| sum + *impulse * f64x4::new(*grows));
        impulse.reduce_add() / step
    }
}

impl GuideBank {
    /// As [`GuideBank::drive_each`], with the slopes of that friction.
    #[inline]
    pub fn drive_with_slopes(
        &mut self,
        velocity: f64,
        step: f64,
        scale: &FrictionScale,
        slopes: &mut BristleSlopes,
    ) -> [f64; MAX_GUIDES] {
        slopes.impulse = [f64x4::ZERO; BRISTLE_PARAMETERS];
        let (impulse, ..) = self.step_bristles::<true>(velocity, step, scale, slopes);
        (impulse * f64x4::splat(step.recip())).to_array()
    }
}

/// What is reported of a step of the bristles while it is computed.
pub(super) trait Along {
    /// The level g, N, and the part of Fs - Fc that is in it.
    fn level(
        &mut self,
        _bank: &GuideBank,
        _velocity_squared: f64x4,
        _level: f64x4,
        _stribeck: f64x4,
    ) {
    }
    fn gradual(&mut self, _element: usize, _step: &GradualStep, _force: &ElementForce) {}
    fn sudden(&mut self, _element: usize, _step: &SuddenStep, _force: &ElementForce) {}
}

/// Nothing is recorded.
impl Along for () {}

/// A step of an element that slips gradually.
pub(super) struct GradualStep {
    /// Deflection that it tends to, and how much more it had, m.
    pub steady: f64x4,
    pub excess: f64x4,
    /// Power of two of the decay, the decay over the step and its mean.
    pub power: f64x4,
    pub decay: f64x4,
    pub mean: f64x4,
}

/// A step of an element that slips suddenly.
pub(super) struct SuddenStep {
    /// Deflection before the step, what it may be at most, and what it would be if nothing slipped,
    /// m.
    pub before: f64x4,
    pub limit: f64x4,
    pub unlimited: f64x4,
    /// Part of the step in which it sticks.
    pub stuck: f64x4,
}

/// What the deflections of an element give.
pub(super) struct ElementForce {
    /// Momentum per mean deflection, and per change of it, N s/m.
    pub elastic: f64x4,
    pub damping: f64x4,
    /// Mean deflection, and by how much it changes, m.
    pub mean: f64x4,
    pub change: f64x4,
}

impl BristleSlopes {
    /// Notes what an element gives whose end and mean have these derivatives.
    #[inline]
    fn note(
        &mut self,
        element: usize,
        parameter: usize,
        end: f64x4,
        mean: f64x4,
        force: &ElementForce,
    ) {
        let bristle = &mut self.bristle[element][parameter];
        self.impulse[parameter] += force.elastic * mean + force.damping * (end - *bristle);
        *bristle = end;
    }

    /// The same of what acts on forces alone.
    #[inline]
    fn note_force(&mut self, force: &ElementForce) {
        self.impulse[BristleSlopes::STIFFNESS] += force.elastic * force.mean;
        self.impulse[BristleSlopes::BRISTLE_DAMPING] += force.damping * force.change;
    }
}

impl Along for BristleSlopes {
    #[inline]
    fn level(&mut self, bank: &GuideBank, velocity_squared: f64x4, level: f64x4, stribeck: f64x4) {
        let per_level = f64x4::splat(1.0) / level;
        let coulomb = bank.coulomb_force * f64x4::splat(bank.scale.coulomb);
        let stat = (bank.stribeck_force + bank.coulomb_force) * f64x4::splat(bank.scale.stat);
        // d/d ln vs of exp(-|v / vs|^n), in parts of it, is n |v / vs|^n.
        let steepness =
            f64x4::splat(-LN_2) * bank.stribeck_exponent * bank.stribeck_power(velocity_squared);
        self.level = [
            f64x4::splat(-1.0),
            coulomb * (f64x4::splat(1.0) - stribeck) * per_level,
            stat * stribeck * per_level,
            (stat - coulomb) * stribeck * steepness * per_level,
        ];
    }

    #[inline]
    fn gradual(&mut self, element: usize, step: &GradualStep, force: &ElementForce) {
        let one = f64x4::splat(1.0);
        let GradualStep { steady, excess, power, decay, mean } = step;
        let end_per_level =
            *steady * (one - *decay) + *excess * *power * f64x4::splat(-LN_2) * *decay;
        let mean_per_level = *steady * (one - *mean) + *excess * (*mean - *decay);
        for parameter in 0..OF_DEFLECTION {
            let (before, level) = (self.bristle[element][parameter], self.level[parameter]);
            let (end, mean) =
                (*decay * before + level * end_per_level, *mean * before + level * mean_per_level);
            self.note(element, parameter, end, mean, force);
        }
        self.note_force(force);
    }

    #[inline]
    fn sudden(&mut self, element: usize, step: &SuddenStep, force: &ElementForce) {
        let limited = |at: f64x4, moves: f64x4, level: f64x4| {
            at.abs().simd_gt(step.limit).select(step.limit.copysign(at) * level, moves)
        };
        for parameter in 0..OF_DEFLECTION {
            let (before, level) = (self.bristle[element][parameter], self.level[parameter]);
            let start = limited(step.before, before, level);
            let end = limited(step.unlimited, start, level);
            self.note(element, parameter, end, end - (end - start) * step.stuck, force);
        }
        self.note_force(force);
    }
}

#[cfg(test)]
mod tests {
    use super::super::{BristleElements, BristleShare, FrictionScale, Slip};
    use super::*;
    use crate::model::Catalogue;

    /// Of two guides that differ, along a motion that rests, creeps, turns and slides, against the
    /// symmetric difference quotient of the same motion.
    #[test]
    fn slopes_are_the_difference_quotients_of_the_friction() {
        let catalogue = Catalogue::builtin();
        let mut guides = ["guide_1", "guide_2"].map(|name| catalogue.guide(name).unwrap());
        guides[1].stribeck_exponent = Some(1.2);
        let share = |stiffness, damping, strength| BristleShare { stiffness, damping, strength };
        let shares = [
            share(0.7, 0.6, 0.3),
            share(0.4, 0.3, 0.5),
            share(0.1, 0.1, 0.2),
            BristleShare::default(),
        ];
        let changed = FrictionScale { coulomb: 1.1, stat: 1.3, ..FrictionScale::ONE };
        let late = FrictionScale { stribeck_speed: Some(3e-3), ..changed };
        let elements = [None, Some(Slip::Gradual), Some(Slip::Sudden)];
        for (slip, scale) in elements.into_iter().flat_map(|slip| [(slip, changed), (slip, late)]) {
            let bank = |guides: &[Guide]| match slip {
                None => GuideBank::new(guides),
                Some(slip) => GuideBank::with_elements(guides, &BristleElements { shares, slip }),
            };
            let velocity = |k: usize| match k {
                0..100 => 0.0,
                100..500 => 2e-4 * (0.05 * k as f64).sin(),
                _ => 0.02 * (0.007 * k as f64).sin(),
            };
            let mut driven = bank(&guides);
            let mut slopes = BristleSlopes::new([[0.0; MAX_GUIDES]; BRISTLE_PARAMETERS]);
            let mut reported = Vec::new();
            for k in 0..3000 {
                let friction = driven.drive_with_slopes(velocity(k), 5e-4, &scale, &mut slopes);
                reported.push((
                    friction,
                    slopes.impulse.map(|impulse| (impulse / f64x4::splat(5e-4)).to_array()),
                ));
            }
            let mut alone = bank(&guides);
            for (k, (friction, _)) in reported.iter().enumerate() {
                assert_eq!(alone.drive_each(velocity(k), 5e-4, &scale), *friction);
            }
            for parameter in 0..BRISTLE_PARAMETERS {
                let moved = |part: f64| {
                    let mut bank = bank(&guides.clone().map(|guide| with(&guide, parameter, part)));
                    (0..3000)
                        .map(|k| bank.drive_each(velocity(k), 5e-4, &scale))
                        .collect::<Vec<_>>()
                };
                let (up, down) = (moved(1e-6), moved(-1e-6));
                for guide in 0..guides.len() {
                    let mut squares = (0.0, 0.0);
                    for (k, (_, slopes)) in reported.iter().enumerate() {
                        let expected = (up[k][guide] - down[k][guide]) / 2e-6;
                        squares.0 += (slopes[parameter][guide] - expected).powi(2);
                        squares.1 += expected * expected;
                    }
                    let off = (squares.0 / squares.1).sqrt();
                    assert!(
                        off < 1e-4 && squares.1 > 0.0,
                        "{slip:?}, parameter {parameter}: {off:e} of {}",
                        squares.1
                    );
                }
            }
        }
    }

    /// A guide with the logarithm of a parameter so much larger.
    fn with(guide: &Guide, parameter: usize, part: f64) -> Guide {
        let mut moved = guide.clone();
        let of_bristles = [
            &mut moved.stiffness,
            &mut moved.coulomb_force,
            &mut moved.static_force,
            &mut moved.stribeck_velocity,
            &mut moved.bristle_damping,
        ];
        *of_bristles.into_iter().nth(parameter).expect("a parameter") *= part.exp();
        moved
    }
}
