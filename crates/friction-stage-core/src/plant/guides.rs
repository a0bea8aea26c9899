//! Up to four LuGre guides, advanced together: one lane each.

mod slopes;

use std::f64::consts::LOG2_E;

use wide::f64x4;

use crate::model::{Guide, MAX_GUIDES};

use super::exp2::exp2_of_negative;

use slopes::{Along, ElementForce, GradualStep, SuddenStep};
pub use slopes::{BRISTLE_PARAMETERS, BristleSlopes};

/// Most bristle elements of one guide.
pub const MAX_ELEMENTS: usize = 4;

/// A deflection this close to its limit has reached it.
const ROUNDING: f64 = 1e-9;

/// Halvings that leave nothing of a force beside others of its size.
const NOTHING_LEFT: f64 = 64.0;

/// Largest sum of bristle damping and viscous friction times step over mass: the explicit carriage
/// step is stable below 1.
pub(super) const MAX_STEP_DAMPING: f64 = 0.5;

/// The guides of one stage with their bristles. Lanes without a guide stay at zero force.
///
/// Law (Canudas de Wit et al., IEEE TAC 40(3), 1995): dz/dt = v - sigma0 |v| z / g(v), F = sigma0
/// z + sigma1 dz/dt + sigma2 v.
///
/// Two users: the plant, which solves for the velocity, and identification, which drives the bank
/// along a measured motion ([`GuideBank::drive`]).
#[derive(Clone, Debug)]
pub struct GuideBank {
    count: usize,
    /// sigma0, N/m; its inverse; -log2(e) sigma0, which times |v| t / g is the power of two of the
    /// bristle's decay over t.
    stiffness: f64x4,
    compliance: f64x4,
    relaxation: f64x4,
    /// sigma1, N s/m.
    bristle_damping: f64x4,
    /// sum of sigma2, N s/m.
    viscous_friction: f64,
    /// Fc and Fs - Fc, N.
    coulomb_force: f64x4,
    stribeck_force: f64x4,
    /// -log2(e)/vs^2, s^2/m^2; n of the curve, and whether that of any guide is not 2.
    stribeck_coefficient: f64x4,
    stribeck_exponent: f64x4,
    is_shaped: bool,
    /// -log2(e)/vd^2, s^2/m^2; 0 where the bristle damping is constant.
    damping_exponent: f64x4,
    damping_fades: bool,
    /// Bristle deflection z, m; with several elements their mean, weighted by the shares of
    /// stiffness.
    bristle: f64x4,
    /// Several bristle elements per guide in place of one.
    elements: Option<Elements>,
    /// Factors on the laws in the last step.
    scale: FrictionScale,
    start: StartFriction,
}

/// Factors on the laws of all guides over one step; 1 leaves them as the model has them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrictionScale {
    /// On Fc.
    pub coulomb: f64,
    /// On Fs.
    pub stat: f64,
    /// On sigma2.
    pub viscous: f64,
    /// Speed at which the Stribeck curve is taken, m/s; `None`: that of the carriage.
    pub stribeck_speed: Option<f64>,
}

impl FrictionScale {
    /// The guides as the model has them.
    pub const ONE: FrictionScale =
        FrictionScale { coulomb: 1.0, stat: 1.0, viscous: 1.0, stribeck_speed: None };
}

/// Shares of one bristle element in its guide: element i is a bristle of stiffness a sigma0,
/// damping d sigma1 and level b g(v).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BristleShare {
    /// a, of the stiffness; not negative. Their sum may differ from 1: that is the stiffness at the
    /// smallest motion over sigma0.
    pub stiffness: f64,
    /// d, of the damping; 0 to 1.
    pub damping: f64,
    /// b, of the friction level; 0 to 1.
    pub strength: f64,
}

/// How a bristle element goes from sticking to slipping.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Slip {
    /// As LuGre's bristle: dz/dt = v - |v| z / zs.
    #[default]
    Gradual,
    /// As a spring with a slider (Iwan, J. Appl. Mech. 33, 1966): dz/dt = v up to zs, where z
    /// stays.
    Sudden,
}

/// Bristle elements that each guide has in place of a single bristle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BristleElements {
    /// Not negative; those of damping and of strength sum to 1.
    pub shares: [BristleShare; MAX_ELEMENTS],
    /// How each element slips.
    pub slip: Slip,
}

impl BristleElements {
    /// Break-away distance of the element that breaks away last, as a part of that of a single
    /// bristle; 1 where no element has strength and stiffness.
    pub fn last_break_away(&self) -> f64 {
        let carrying =
            self.shares.iter().filter(|share| share.stiffness > 1e-9 && share.strength > 1e-9);
        carrying.map(|share| share.strength / share.stiffness).reduce(f64::max).unwrap_or(1.0)
    }
}

/// Bristle elements in parallel, the same shares in every guide.
#[derive(Clone, Copy, Debug)]
struct Elements {
    /// How they slip.
    law: Slip,
    /// a, a / b, d and d / b; all 0 for an element without stiffness or without strength, which
    /// holds no force.
    share: [f64; MAX_ELEMENTS],
    ratio: [f64; MAX_ELEMENTS],
    damping: [f64; MAX_ELEMENTS],
    slip: [f64; MAX_ELEMENTS],
    bristle: [f64x4; MAX_ELEMENTS],
}

impl Elements {
    /// On which of its limits an element lies, -1 or 1, or 0 between them; `single` is the limit of
    /// a single bristle, m.
    fn end(&self, index: usize, single: f64x4) -> f64x4 {
        let reached =
            self.bristle[index].abs() * f64x4::splat(self.ratio[index] * (1.0 + ROUNDING));
        reached.simd_ge(single).select(f64x4::splat(1.0).copysign(self.bristle[index]), f64x4::ZERO)
    }
}

/// Friction of all guides over velocity at the present deflections, with g and sigma1 as of the
/// middle of the last step: elastic + damping v - slip |v|.
#[derive(Clone, Copy, Debug, Default)]
struct StartFriction {
    /// Sum of sigma0 z, N.
    elastic: f64,
    /// Sum of sigma1 + sigma2, N s/m.
    damping: f64,
    /// Sum of sigma1 sigma0 z / g, N s/m.
    slip: f64,
}

impl GuideBank {
    /// Bristles start unloaded. The guides must have passed [`Guide::check`]; at most
    /// [`MAX_GUIDES`].
    pub fn new(guides: &[Guide]) -> GuideBank {
        assert!(guides.len() <= MAX_GUIDES, "{} guides, at most {MAX_GUIDES}", guides.len());
        let lanes = |absent: f64, value: &dyn Fn(&Guide) -> f64| {
            f64x4::new(std::array::from_fn(|lane| guides.get(lane).map_or(absent, value)))
        };
        let mut bank = GuideBank {
            count: guides.len(),
            stiffness: lanes(0.0, &|guide| guide.stiffness),
            compliance: lanes(0.0, &|guide| guide.stiffness.recip()),
            relaxation: lanes(0.0, &|guide| -LOG2_E * guide.stiffness),
            bristle_damping: lanes(0.0, &|guide| guide.bristle_damping),
            viscous_friction: guides.iter().map(|guide| guide.viscous_friction).sum(),
            coulomb_force: lanes(1.0, &|guide| guide.coulomb_force),
            stribeck_force: lanes(0.0, &|guide| guide.static_force - guide.coulomb_force),
            stribeck_coefficient: lanes(0.0, &|guide| -LOG2_E * guide.stribeck_velocity.powi(-2)),
            stribeck_exponent: lanes(2.0, &|guide| guide.stribeck_exponent.unwrap_or(2.0)),
            is_shaped: guides.iter().any(|guide| guide.stribeck_exponent.is_some_and(|n| n != 2.0)),
            damping_exponent: lanes(0.0, &|guide| {
                guide.damping_velocity.map_or(0.0, |velocity| -LOG2_E * velocity.powi(-2))
            }),
            damping_fades: guides.iter().any(|guide| guide.damping_velocity.is_some()),
            bristle: f64x4::ZERO,
            elements: None,
            scale: FrictionScale::ONE,
            start: StartFriction::default(),
        };
        bank.refresh(0.0);
        bank
    }

    /// As [`GuideBank::new`], each guide with several bristle elements in parallel.
    pub fn with_elements(guides: &[Guide], elements: &BristleElements) -> GuideBank {
        let mut bank = GuideBank::new(guides);
        let shares = elements.shares;
        let carries = |share: &BristleShare| share.stiffness > 0.0 && share.strength > 0.0;
        bank.elements = Some(Elements {
            law: elements.slip,
            share: shares.map(|share| if carries(&share) { share.stiffness } else { 0.0 }),
            ratio: shares
                .map(|share| if carries(&share) { share.stiffness / share.strength } else { 0.0 }),
            damping: shares.map(|share| if carries(&share) { share.damping } else { 0.0 }),
            slip: shares
                .map(|share| if carries(&share) { share.damping / share.strength } else { 0.0 }),
            bristle: [f64x4::ZERO; MAX_ELEMENTS],
        });
        bank.refresh(0.0);
        bank
    }

    /// Number of guides.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Bristle deflections z, m, one per guide; times sigma0 they are the elastic force, also with
    /// several elements.
    pub fn bristles(&self) -> &[f64] {
        &self.bristle.as_array()[..self.count]
    }

    /// Sets the bristle deflections, m, for a stage that moves at `velocity`, those of all elements
    /// alike; lanes beyond `bristles` stay as they are. Factors on the laws go back to 1.
    pub fn set_bristles(&mut self, bristles: &[f64], velocity: f64) {
        for (lane, bristle) in self.bristle.as_mut_array().iter_mut().zip(bristles) {
            *lane = *bristle;
        }
        if let Some(elements) = &mut self.elements {
            for element in &mut elements.bristle {
                for (lane, bristle) in element.as_mut_array().iter_mut().zip(bristles) {
                    *lane = *bristle;
                }
            }
        }
        self.scale = FrictionScale::ONE;
        self.refresh(velocity);
    }

    /// Recomputes what one step hands to the next, after a state was set from outside.
    fn refresh(&mut self, velocity: f64) {
        let squared = f64x4::splat(velocity * velocity);
        let (level, damping) = (self.scaled_level(squared), self.damping_at(squared));
        self.bristle = self.mean_bristle();
        self.prepare_scaled_start(level, damping);
    }

    /// Bristle deflection that several elements have together, m.
    fn mean_bristle(&self) -> f64x4 {
        self.elements.as_ref().map_or(self.bristle, |elements| {
            let weighted = elements.bristle.iter().zip(elements.share);
            weighted.fold(f64x4::ZERO, |sum, (bristle, share)| sum + f64x4::splat(share) * *bristle)
        })
    }

    #[inline]
    fn prepare_start(&mut self, level: f64x4, damping: f64x4) {
        let elastic = self.stiffness * self.bristle;
        self.start = StartFriction {
            elastic: elastic.reduce_add(),
            damping: damping.reduce_add() + self.viscous_friction,
            slip: (damping / level * elastic).reduce_add(),
        };
    }

    /// As `prepare_start`, for scaled laws and several elements.
    fn prepare_scaled_start(&mut self, level: f64x4, damping: f64x4) {
        let viscous = self.viscous_friction * self.scale.viscous;
        let Some(elements) = &self.elements else {
            self.prepare_start(level, damping);
            self.start.damping += viscous - self.viscous_friction;
            return;
        };
        let mut start = StartFriction { elastic: 0.0, damping: viscous, slip: 0.0 };
        for (index, bristle) in elements.bristle.iter().enumerate() {
            let elastic = self.stiffness * (f64x4::splat(elements.share[index]) * *bristle);
            start.elastic += elastic.reduce_add();
            let damped = f64x4::splat(elements.damping[index]) * damping;
            match elements.law {
                Slip::Gradual => {
                    start.damping += elements.damping[index] * damping.reduce_add();
                    start.slip += elements.slip[index] * (damping / level * elastic).reduce_add();
                }
                Slip::Sudden => {
                    // At its limit it moves in one direction only: (v - |v|) / 2 at the upper one.
                    let end = elements.end(index, level * self.compliance);
                    start.damping +=
                        (damped * (f64x4::splat(1.0) - f64x4::splat(0.5) * end * end)).reduce_add();
                    start.slip += (damped * f64x4::splat(0.5) * end).reduce_add();
                }
            }
        }
        self.start = start;
    }

    /// g at the factors of the last step.
    fn scaled_level(&self, velocity_squared: f64x4) -> f64x4 {
        self.level_with(self.stribeck_part(velocity_squared))
    }

    /// Part of Fs - Fc that is in g.
    #[inline]
    fn stribeck_part(&self, velocity_squared: f64x4) -> f64x4 {
        let exponent = self.stribeck_power(velocity_squared);
        // At most speeds nothing is left of the Stribeck curve, and to see that costs less than the
        // power.
        let is_over = exponent.simd_lt(f64x4::splat(-NOTHING_LEFT)).all();
        if is_over { f64x4::ZERO } else { exp2_of_negative(exponent) }
    }

    /// Power of two of the Stribeck curve at the carriage's speed squared, m^2/s^2, or at the speed
    /// that the last step had for it.
    #[inline]
    fn stribeck_power(&self, velocity_squared: f64x4) -> f64x4 {
        let taken = self.scale.stribeck_speed.map(|speed| f64x4::splat(speed * speed));
        self.stribeck_power_at(taken.unwrap_or(velocity_squared))
    }

    /// Power of two of the Stribeck curve at this speed squared, m^2/s^2: -log2(e) |v/vs|^n.
    #[inline]
    fn stribeck_power_at(&self, velocity_squared: f64x4) -> f64x4 {
        let gaussian = self.stribeck_coefficient * velocity_squared;
        if self.is_shaped { self.shaped_power(gaussian) } else { gaussian }
    }

    #[inline(never)]
    fn shaped_power(&self, gaussian: f64x4) -> f64x4 {
        let (gaussian, exponent) = (gaussian.to_array(), self.stribeck_exponent.to_array());
        f64x4::new(std::array::from_fn(|lane| {
            -LOG2_E * (gaussian[lane] / -LOG2_E).powf(0.5 * exponent[lane])
        }))
    }

    /// g with this part of Fs - Fc, at the factors of the last step.
    #[inline]
    fn level_with(&self, stribeck_part: f64x4) -> f64x4 {
        let FrictionScale { coulomb, stat, .. } = self.scale;
        // In this form factors of 1 leave every bit as it is.
        let stribeck = self.stribeck_force * f64x4::splat(stat)
            + self.coulomb_force * f64x4::splat(stat - coulomb);
        self.coulomb_force * f64x4::splat(coulomb) + stribeck * stribeck_part
    }

    /// g of guides whose curve is a Gaussian, without factors.
    fn level(&self, velocity_squared: f64x4) -> f64x4 {
        self.coulomb_force
            + self.stribeck_force * exp2_of_negative(self.stribeck_coefficient * velocity_squared)
    }

    /// Whether the curve of any guide is no Gaussian: these are advanced by
    /// [`GuideBank::advance_scaled`].
    pub(super) fn is_shaped(&self) -> bool {
        self.is_shaped
    }

    fn damping_at(&self, velocity_squared: f64x4) -> f64x4 {
        if self.damping_fades {
            self.bristle_damping * exp2_of_negative(self.damping_exponent * velocity_squared)
        } else {
            self.bristle_damping
        }
    }

    /// Bristle velocities dz/dt at velocity v, m/s (of several elements: the mean, weighted by the
    /// shares of damping), bristle damping there, N s/m, and the power that loads the bristles of
    /// each guide, W.
    fn bristle_velocities(&self, velocity: f64) -> (f64x4, f64x4, f64x4) {
        let v = f64x4::splat(velocity);
        let squared = v * v;
        let slip = self.stiffness * v.abs() / self.scaled_level(squared);
        let damping = self.damping_at(squared);
        let Some(elements) = &self.elements else {
            let rate = v - slip * self.bristle;
            return (rate, damping, self.stiffness * self.bristle * rate);
        };
        let (mut mean, mut power) = (f64x4::ZERO, f64x4::ZERO);
        for (index, bristle) in elements.bristle.iter().enumerate() {
            let rate = match elements.law {
                Slip::Gradual => v - f64x4::splat(elements.ratio[index]) * slip * *bristle,
                Slip::Sudden => {
                    let end = elements.end(index, self.scaled_level(squared) * self.compliance);
                    (end * v).simd_gt(f64x4::ZERO).select(f64x4::ZERO, v)
                }
            };
            mean += f64x4::splat(elements.damping[index]) * rate;
            power += f64x4::splat(elements.share[index]) * self.stiffness * *bristle * rate;
        }
        (mean, damping, power)
    }

    /// Friction of each guide on the carriage at velocity v, N, from each guide's sigma2; positive
    /// against positive motion.
    pub fn forces(&self, velocity: f64, viscous: &[f64; MAX_GUIDES]) -> [f64; MAX_GUIDES] {
        let (rate, damping, _) = self.bristle_velocities(velocity);
        let viscous = f64x4::new(*viscous) * f64x4::splat(self.scale.viscous * velocity);
        (self.stiffness * self.bristle + damping * rate + viscous).to_array()
    }

    /// Sum of the friction at velocity v, N, exact in v.
    pub fn force(&self, velocity: f64) -> f64 {
        let (rate, damping, _) = self.bristle_velocities(velocity);
        let viscous = self.viscous_friction * self.scale.viscous;
        (self.stiffness * self.bristle + damping * rate).reduce_add() + viscous * velocity
    }

    /// Energy stored in the bristles, J: sum of sigma0 z^2 / 2 over guides and elements.
    pub fn stored_energy(&self) -> f64 {
        let squares = match &self.elements {
            None => self.bristle * self.bristle,
            Some(elements) => elements
                .bristle
                .iter()
                .zip(elements.share)
                .fold(f64x4::ZERO, |sum, (bristle, share)| {
                    sum + f64x4::splat(share) * *bristle * *bristle
                }),
        };
        (self.stiffness * squares).reduce_add() / 2.0
    }

    /// Power that the guides turn into heat at velocity v, W: friction power less the power that
    /// loads the bristles.
    pub fn dissipated_power(&self, velocity: f64) -> f64 {
        let (_, _, loading) = self.bristle_velocities(velocity);
        self.force(velocity) * velocity - loading.reduce_add()
    }

    /// Sum of sigma2, N s/m, without the factor of the last step.
    pub fn viscous_friction(&self) -> f64 {
        self.viscous_friction
    }

    /// Friction at the start of a step, N, with the Stribeck level of the last step's middle in
    /// place of a new exponential.
    ///
    /// First order in the level, which enters the carriage's velocity in second order only: half a
    /// step times sigma1/m.
    #[inline]
    pub(super) fn start_force(&self, velocity: f64) -> f64 {
        self.start.elastic + self.start.damping * velocity - self.start.slip * velocity.abs()
    }

    /// Moves the bristles over `step` seconds at the constant velocity v, exactly: z' = zs + (z -
    /// zs) exp(-sigma0 |v| step / g), zs = g sign(v) / sigma0. Stable at any speed and step.
    ///
    /// Returns the momentum that bristles and their damping take from the carriage, N s: the sum
    /// over the guides of step sigma0 (z + z')/2 + sigma1 (z' - z), of which the second part is
    /// exact. For guides whose Stribeck curve is a Gaussian.
    #[inline]
    pub(super) fn advance(&mut self, velocity: f64, step: f64) -> f64 {
        let squared = f64x4::splat(velocity * velocity);
        let level = self.level(squared);
        let damping = self.damping_at(squared);
        let decay = exp2_of_negative(self.relaxation * f64x4::splat(velocity.abs() * step) / level);
        let steady = level * self.compliance * f64x4::splat(1f64.copysign(velocity));
        let excess = self.bristle - steady;
        // The impulse is linear in z and z': what does not need the decay is added up while that is
        // on its way.
        let half = self.stiffness * f64x4::splat(0.5 * step);
        let (of_start, of_end) = (half - damping, half + damping);
        let impulse = (of_start * self.bristle + of_end * steady).reduce_add()
            + (of_end * excess * decay).reduce_add();
        self.bristle = steady + excess * decay;
        self.prepare_start(level, damping);
        impulse
    }

    /// As [`GuideBank::advance`], with factors on the laws over this step and with several elements
    /// where there are some. The viscous part is left to the caller, who has to apply
    /// `scale.viscous` to it.
    pub(super) fn advance_scaled(
        &mut self,
        velocity: f64,
        step: f64,
        scale: &FrictionScale,
    ) -> f64 {
        let (impulse, level, damping) = self.step_bristles::<false>(velocity, step, scale, &mut ());
        self.prepare_scaled_start(level, damping);
        impulse.reduce_add()
    }

    /// Moves the guides over `step` seconds (greater than 0) at the constant velocity v and returns
    /// their mean friction over the step, N, positive against positive motion, viscous part
    /// included. Exact for this motion at any step.
    ///
    /// What the plant starts its next step from is left as it was: this motion is not solved for.
    pub fn drive(&mut self, velocity: f64, step: f64, scale: &FrictionScale) -> f64 {
        let of_bristles: f64 = self.drive_each(velocity, step, scale).iter().sum();
        of_bristles + scale.viscous * self.viscous_friction * velocity
    }

    /// As [`GuideBank::drive`]: the mean friction of the bristles of each guide, N, without the
    /// viscous part; 0 where there is no guide.
    #[inline]
    pub fn drive_each(
        &mut self,
        velocity: f64,
        step: f64,
        scale: &FrictionScale,
    ) -> [f64; MAX_GUIDES] {
        let (impulse, ..) = self.step_bristles::<true>(velocity, step, scale, &mut ());
        (impulse * f64x4::splat(step.recip())).to_array()
    }

    /// Moves the bristles along a path, m, over `step` seconds (greater than 0), exactly, while
    /// they slip at the rate of `speed`, m/s: a guide that trembles slips while its mean stands
    /// still. For guides of one bristle each.
    pub fn move_trembling(&mut self, path: f64, speed: f64, step: f64) {
        let velocity = path / step;
        let level = self.scaled_level(f64x4::splat(velocity * velocity));
        let power = self.relaxation * f64x4::splat(speed * step) / level;
        let decay = exp2_of_negative(power);
        self.bristle = self.bristle * decay + f64x4::splat(path) * mean_of_decay(power, decay);
    }

    /// Sum of the friction at velocity v, N, of guides of one bristle each that slip at the rate of
    /// `speed`, m/s.
    pub fn trembling_force(&self, velocity: f64, speed: f64) -> f64 {
        let squared = f64x4::splat(velocity * velocity);
        let slip = self.stiffness * f64x4::splat(speed) / self.scaled_level(squared);
        let rate = f64x4::splat(velocity) - slip * self.bristle;
        let of_bristles = self.stiffness * self.bristle + self.damping_at(squared) * rate;
        of_bristles.reduce_add() + self.viscous_friction * velocity
    }

    /// One step of all bristles at constant velocity: momentum that each guide takes from the
    /// carriage, N s, with g and sigma1. The mean deflection of the step is that of its ends, or
    /// with `EXACT` that of the exponential between them.
    #[inline]
    fn step_bristles<const EXACT: bool>(
        &mut self,
        velocity: f64,
        step: f64,
        scale: &FrictionScale,
        along: &mut impl Along,
    ) -> (f64x4, f64x4, f64x4) {
        self.scale = *scale;
        let squared = f64x4::splat(velocity * velocity);
        let stribeck_part = self.stribeck_part(squared);
        let level = self.level_with(stribeck_part);
        along.level(self, squared, level, stribeck_part);
        let damping = self.damping_at(squared);
        let power = self.relaxation * f64x4::splat(velocity.abs() * step) / level;
        let single_steady = level * self.compliance * f64x4::splat(1f64.copysign(velocity));
        let (stiffness, time) = (self.stiffness, f64x4::splat(step));
        let mut impulse = f64x4::ZERO;
        let path = f64x4::splat(velocity * step);
        let mut element = |index: usize,
                           bristle: &mut f64x4,
                           slip: Slip,
                           share: f64,
                           ratio: f64,
                           damped: f64| {
            if ratio == 0.0 {
                return;
            }
            let steady = single_steady * f64x4::splat(ratio.recip());
            let half = f64x4::splat(0.5);
            let before = *bristle;
            let force = |end: f64x4, exact_mean: f64x4| ElementForce {
                elastic: f64x4::splat(share) * stiffness * time,
                damping: f64x4::splat(damped) * damping,
                mean: if EXACT { exact_mean } else { (before + end) * half },
                change: end - before,
            };
            let force = match slip {
                Slip::Gradual => {
                    let power = power * f64x4::splat(ratio);
                    let excess = before - steady;
                    let decay = exp2_of_negative(power);
                    let mean = if EXACT { mean_of_decay(power, decay) } else { decay };
                    *bristle = steady + excess * decay;
                    let force = force(*bristle, steady + excess * mean);
                    along.gradual(
                        index,
                        &GradualStep { steady, excess, power, decay, mean },
                        &force,
                    );
                    force
                }
                Slip::Sudden => {
                    let limit = steady.abs();
                    let start = before.max(-limit).min(limit);
                    let unlimited = start + path;
                    let end = unlimited.max(-limit).min(limit);
                    let stuck = path.simd_eq(f64x4::ZERO).select(f64x4::ZERO, (end - start) / path);
                    *bristle = end;
                    let force = force(end, end - (end - start) * half * stuck);
                    along.sudden(index, &SuddenStep { before, limit, unlimited, stuck }, &force);
                    force
                }
            };
            impulse += force.elastic * force.mean + force.damping * force.change;
        };
        match &mut self.elements {
            None => element(0, &mut self.bristle, Slip::Gradual, 1.0, 1.0, 1.0),
            Some(elements) => {
                for (index, bristle) in elements.bristle.iter_mut().enumerate() {
                    element(
                        index,
                        bristle,
                        elements.law,
                        elements.share[index],
                        elements.ratio[index],
                        elements.damping[index],
                    );
                }
                self.bristle = self.mean_bristle();
            }
        }
        (impulse, level, damping)
    }
}

/// Mean of 2^(p s) over s from 0 to 1, where p is not positive and `decay` = 2^p.
#[inline]
fn mean_of_decay(power: f64x4, decay: f64x4) -> f64x4 {
    let rate = power * f64x4::splat(-std::f64::consts::LN_2);
    let one = f64x4::splat(1.0);
    let series = one - rate * f64x4::splat(0.5) + rate * rate * f64x4::splat(1.0 / 6.0);
    // Below, the difference loses more digits than the series leaves out (1e-12).
    rate.simd_lt(f64x4::splat(1e-4)).select(series, (one - decay) / rate)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Catalogue;

    fn guide() -> Guide {
        Catalogue::builtin().guide("guide_1").unwrap()
    }

    #[test]
    fn driven_steadily_the_friction_is_the_stribeck_curve_with_its_factors() {
        let scale = FrictionScale { coulomb: 1.2, stat: 1.5, viscous: 0.5, ..FrictionScale::ONE };
        let shaped = Guide { stribeck_exponent: Some(0.7), ..guide() };
        for (guide, velocity) in [-0.3, -1e-3, 2e-3, 0.7]
            .into_iter()
            .flat_map(|velocity| [(guide(), velocity), (shaped.clone(), velocity)])
        {
            let mut bank = GuideBank::new(std::slice::from_ref(&guide));
            let force = (0..20_000).map(|_| bank.drive(velocity, 5e-4, &scale)).last().unwrap();
            let scaled = Guide {
                coulomb_force: 1.2 * guide.coulomb_force,
                static_force: 1.5 * guide.static_force,
                viscous_friction: 0.5 * guide.viscous_friction,
                ..guide.clone()
            };
            assert!(
                (force / scaled.steady_force(velocity) - 1.0).abs() < 1e-9,
                "{velocity} m/s: {force}"
            );
            assert!((bank.force(velocity) / force - 1.0).abs() < 1e-9, "{}", bank.force(velocity));
        }
    }

    /// Without trembling it is the motion and the friction of the plant.
    #[test]
    fn guides_that_do_not_tremble_move_and_rub_as_they_do_in_the_plant() {
        let (mut driven, mut still) = (GuideBank::new(&[guide()]), GuideBank::new(&[guide()]));
        for k in 0..2000 {
            let velocity = 2e-3 * (0.01 * f64::from(k)).sin();
            driven.drive(velocity, 1e-4, &FrictionScale::ONE);
            still.move_trembling(1e-4 * velocity, velocity.abs(), 1e-4);
            let deflections = [driven.bristles()[0], still.bristles()[0]];
            assert!((deflections[0] - deflections[1]).abs() < 1e-17, "{k}: {deflections:?}");
            let forces = [driven.force(velocity), still.trembling_force(velocity, velocity.abs())];
            assert!((forces[0] - forces[1]).abs() < 1e-11, "{k}: {forces:?}");
        }
    }

    /// A guide whose mean stands still forgets its deflection as it trembles: z' = -sigma0 s z /
    /// Fs.
    #[test]
    fn a_guide_that_trembles_where_it_stands_lets_go() {
        let guide = guide();
        let mut bank = GuideBank::new(std::slice::from_ref(&guide));
        bank.set_bristles(&[1e-6], 0.0);
        (0..100).for_each(|_| bank.move_trembling(0.0, 1e-5, 1e-2));
        let rate = guide.stiffness * 1e-5 / guide.static_force;
        let expected = 1e-6 * (-rate).exp();
        assert!((bank.bristles()[0] / expected - 1.0).abs() < 1e-12, "{:?}", bank.bristles());
        let force = bank.trembling_force(0.0, 1e-5);
        let expected = expected * (guide.stiffness - guide.bristle_damping * rate);
        assert!((force / expected - 1.0).abs() < 1e-12, "{force} {expected}");
    }

    /// The mean over a long step is the mean over the short steps that it is made of.
    #[test]
    fn friction_of_a_long_step_is_exact() {
        let halves = [BristleShare { stiffness: 0.5, damping: 0.5, strength: 0.5 }; 2];
        let shares = [halves[0], halves[1], BristleShare::default(), BristleShare::default()];
        let sudden = BristleElements { shares, slip: Slip::Sudden };
        let banks = [
            GuideBank::new(&[guide(), guide()]),
            GuideBank::with_elements(&[guide(), guide()], &sudden),
        ];
        for (bank, velocity) in banks.iter().flat_map(|bank| [(bank, 0.02), (bank, -0.5)]) {
            let mut coarse = bank.clone();
            let mut fine = bank.clone();
            let long = coarse.drive(velocity, 1e-3, &FrictionScale::ONE);
            let short: f64 =
                (0..1000).map(|_| fine.drive(velocity, 1e-6, &FrictionScale::ONE) / 1000.0).sum();
            assert!((long / short - 1.0).abs() < 1e-9, "{long} {short}");
            assert!((coarse.bristles()[0] / fine.bristles()[0] - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn one_element_with_every_share_is_the_single_bristle() {
        let one = BristleShare { stiffness: 1.0, damping: 1.0, strength: 1.0 };
        let none = BristleShare::default();
        let halves = [BristleShare { stiffness: 0.5, damping: 0.5, strength: 0.5 }; 2];
        for shares in [[one, none, none, none], [halves[0], halves[1], none, none]] {
            let mut single = GuideBank::new(&[guide()]);
            let elements = BristleElements { shares, slip: Slip::Gradual };
            let mut parallel = GuideBank::with_elements(&[guide()], &elements);
            for k in 0..2000 {
                let velocity = 0.01 * (0.01 * f64::from(k)).sin();
                let forces = [&mut single, &mut parallel]
                    .map(|bank| bank.drive(velocity, 1e-4, &FrictionScale::ONE));
                assert!(
                    (forces[0] - forces[1]).abs() < 1e-12 * forces[0].abs().max(1.0),
                    "{k}: {forces:?}"
                );
            }
            assert!((single.stored_energy() / parallel.stored_energy() - 1.0).abs() < 1e-12);
            assert!(
                (single.dissipated_power(0.01) / parallel.dissipated_power(0.01) - 1.0).abs()
                    < 1e-12
            );
        }
    }

    /// A spring up to its limit and a slider beyond: force and heat of a branch in closed form.
    #[test]
    fn a_sudden_element_sticks_up_to_its_limit_and_slides_there() {
        let one = BristleShare { stiffness: 1.0, damping: 1.0, strength: 1.0 };
        let none = BristleShare::default();
        let guide = Guide { viscous_friction: 0.0, ..guide() };
        let elements = BristleElements { shares: [one, none, none, none], slip: Slip::Sudden };
        let mut bank = GuideBank::with_elements(std::slice::from_ref(&guide), &elements);
        let (velocity, step) = (1e-5, 1e-3);
        let level = guide.steady_force(velocity);
        for k in 0..20_000 {
            let force = bank.drive(velocity, step, &FrictionScale::ONE);
            // Half a step back: the mean of the step.
            let deflection = velocity * step * (f64::from(k) + 0.5);
            let sticking = guide.stiffness * deflection + guide.bristle_damping * velocity;
            let near_limit =
                (guide.stiffness * deflection - level).abs() < guide.stiffness * velocity * step;
            let expected = if guide.stiffness * deflection < level { sticking } else { level };
            assert!(near_limit || (force / expected - 1.0).abs() < 1e-9, "{k}: {force} {expected}");
        }
        assert!((bank.dissipated_power(velocity) / (level * velocity) - 1.0).abs() < 1e-9);
        assert!(
            (bank.stored_energy() / (0.5 * level * level / guide.stiffness) - 1.0).abs() < 1e-9
        );
        // Turned back it springs: what heats is the damping alone.
        let damping = guide.bristle_damping * velocity * velocity;
        assert!((bank.dissipated_power(-velocity) / damping - 1.0).abs() < 1e-9);
    }
}
