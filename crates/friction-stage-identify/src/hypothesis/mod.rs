//! What might be true: declared parameters within their tolerances and a list of effects, and the
//! residual that this leaves.

pub(crate) mod nominal_parameter;

use std::f64::consts::TAU;

use nalgebra::{Matrix3, Vector3};

use friction_stage_core::model::{
    CurveSide, EffectParameters, Guide, GuideSource, MAX_GUIDES, ModelError, StageModel,
};
use friction_stage_core::plant::effects::heights;
use friction_stage_core::plant::{Drive, EffectDescriptor, Side, SlippingRipple};

use crate::hypothesis::nominal_parameter::NominalParameter;
use crate::record::measured::{Floor, Measured, mean_square};
use crate::residual::driven::{self, Driven};
use crate::residual::slipping::Slipping;

/// How far the real machine may be from the declared one, as shares of the declared values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerances {
    pub mass: f64,
    /// Of each LuGre parameter, as the mean over the guides.
    pub guides: f64,
    /// Of bristle stiffness, bristle damping, static friction and Stribeck velocity, where they are
    /// known worse than sliding friction is; at 1 and above a factor of 1 + this either way.
    pub presliding: f64,
}

impl Default for Tolerances {
    /// Assumed: a carriage is weighed to half a percent; guides of one type differ by 16 %.
    fn default() -> Self {
        Tolerances { mass: 0.005, guides: 0.16, presliding: 0.16 }
    }
}

/// Least change of friction, or of mass as a part of it: nearly all of it gone.
pub(crate) const NO_FRICTION: f64 = -0.99;

/// Largest shift between the instants of encoder and force readings, in samples. Assumed: what is
/// beyond it is a lag of its own.
const SHIFT_LIMIT: f64 = 0.05;

/// Declared parameters in which the guides may differ from each other with an effect on the
/// friction of all. Viscous friction adds up to one number.
pub(crate) const SPREAD: [NominalParameter; 4] = [
    NominalParameter::Stiffness,
    NominalParameter::CoulombForce,
    NominalParameter::StaticForce,
    NominalParameter::StribeckVelocity,
];
/// Contrasts between guides: guide i differs from the mean in contrast j by the entry (j, i).
/// Helmert's, of at most 1.
const CONTRASTS: [[f64; MAX_GUIDES]; MAX_GUIDES - 1] =
    [[1.0, -1.0, 0.0, 0.0], [0.5, 0.5, -1.0, 0.0], [1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0, -1.0]];
/// Contrast that a fit starts from, in tolerances: at none at all no direction is better than its
/// opposite.
const START_SPREAD: f64 = 0.25;

/// Effects whose phase counts from the start of a record and therefore means nothing in another
/// one: each record has its own.
const PHASE_OF_RECORD: [&str; 1] = ["external_vibration"];

/// Part of what is left with a jump at an instant that must be left with it at another one, for
/// this to be that of the record. Assumed.
const ANOTHER_INSTANT: f64 = 0.9;

/// An effect with values in the order of its descriptor's parameters.
#[derive(Clone, Debug)]
pub struct Part {
    pub descriptor: &'static EffectDescriptor,
    pub values: Vec<f64>,
}

impl PartialEq for Part {
    fn eq(&self, other: &Part) -> bool {
        self.descriptor.name == other.descriptor.name && self.values == other.values
    }
}

impl Part {
    pub fn parameters(&self) -> EffectParameters {
        self.descriptor.parameters_of(&self.values)
    }

    /// Parameters that a fit moves.
    pub(crate) fn free(&self) -> usize {
        (0..self.values.len()).filter(|value| (self.descriptor.free)(&self.values, *value)).count()
    }

    /// Its parameter of this name.
    pub fn value_of(&self, name: &str) -> Option<f64> {
        let place =
            self.descriptor.parameters.iter().position(|parameter| parameter.name == name)?;
        self.values.get(place).copied()
    }

    /// What each record has for itself of it: of balls that slip the whole force.
    pub(crate) fn slipping_ripple(&self) -> Option<SlippingRipple> {
        (self.descriptor.build)(&self.values).slipping_ripple()
    }

    /// Of what reads wrong: whether it is the encoder.
    pub(crate) fn is_of_encoder(&self) -> bool {
        (self.descriptor.build)(&self.values).is_of_encoder()
    }

    /// Its place in the chain from the command to the motor's force, if it has one.
    pub(crate) fn drive(&self) -> Option<Drive> {
        (self.descriptor.build)(&self.values).drive()
    }

    /// Whether the law leaves amplitude and phase of the force to each record.
    pub fn slips(&self) -> bool {
        self.slipping_ripple().is_some()
    }

    /// The heights of a curve that is the effect of this index; nothing of a law.
    fn heights(&self, effect: usize) -> Vec<FreeParameter> {
        let Some(curve) = self.parameters().curve else { return Vec::new() };
        let (scale, bounds) = if curve.side.is_of_friction() {
            (0.1, (NO_FRICTION, 1e6))
        } else {
            (1.0, (-1e6, 1e6))
        };
        let height = |value: usize| FreeParameter {
            id: ParameterId::Effect { effect, value },
            value: self.values[value],
            scale,
            bounds,
        };
        heights(&self.values).map(height).collect()
    }

    /// Side of the force cell, or sensor, where it acts: a map has it among its values.
    pub fn side(&self) -> Side {
        (self.descriptor.build)(&self.values).side().unwrap_or(self.descriptor.side)
    }
}

/// Declared model, moved, with effects in it.
#[derive(Clone, Debug)]
pub struct Hypothesis {
    declared: StageModel,
    guides: Vec<Guide>,
    tolerances: Tolerances,
    /// Logarithms of the factors on mass and the six LuGre parameters (of all guides alike), then
    /// the shift of the sensors in samples.
    moved: [f64; NominalParameter::ALL.len()],
    /// Differences between the guides in the parameters of `SPREAD`: logarithms of factors, per
    /// contrast.
    spread: [[f64; MAX_GUIDES - 1]; SPREAD.len()],
    /// Whether a fit may move the differences between the guides.
    guides_differ: bool,
    /// Whether a fit may move the heights of curves that the model does not declare.
    curves_bend: bool,
    pub effects: Vec<Part>,
}

/// One number that a fit may change.
#[derive(Clone, Debug)]
pub struct FreeParameter {
    pub id: ParameterId,
    pub value: f64,
    pub scale: f64,
    pub bounds: (f64, f64),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterId {
    Nominal(NominalParameter),
    /// Difference between guides: index in `SPREAD`, contrast.
    Spread {
        parameter: usize,
        contrast: usize,
    },
    Effect {
        effect: usize,
        value: usize,
    },
}

impl ParameterId {
    /// The parameter of the bristles that it moves, of all guides or between them.
    pub(crate) fn of_bristles(self) -> Option<NominalParameter> {
        match self {
            ParameterId::Nominal(declared) => (SPREAD.contains(&declared)
                || declared == NominalParameter::BristleDamping)
                .then_some(declared),
            ParameterId::Spread { parameter, .. } => Some(SPREAD[parameter]),
            ParameterId::Effect { .. } => None,
        }
    }
}

/// What is compared: the motor side, the carriage side or both.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sides {
    pub motor: bool,
    pub carriage: bool,
}

impl Sides {
    pub const BOTH: Sides = Sides { motor: true, carriage: true };
    pub const MOTOR: Sides = Sides { motor: true, carriage: false };
    pub const CARRIAGE: Sides = Sides { motor: false, carriage: true };
}

/// Force that a hypothesis misses, N along +x, filtered, at the rows of the recording. Motor side:
/// cell less command less effects. Carriage side: mass times acceleration plus friction less
/// effects less cell; without a cell, less command and motor effects.
#[derive(Clone, Debug, Default)]
pub struct Missing {
    pub motor: Vec<f64>,
    pub carriage: Vec<f64>,
}

impl Missing {
    /// Mean squares, N^2.
    pub fn squares(&self) -> (f64, f64) {
        (mean_square(self.motor.iter().copied()), mean_square(self.carriage.iter().copied()))
    }

    /// Root of the sum of both mean squares, N.
    pub fn rms(&self) -> f64 {
        let (motor, carriage) = self.squares();
        (motor + carriage).sqrt()
    }
}

impl Hypothesis {
    /// The declared model with the effects that it declares.
    pub fn new(declared: &StageModel, tolerances: Tolerances) -> Result<Hypothesis, ModelError> {
        declared.check()?;
        let effects = declared
            .effects
            .iter()
            .map(|given| {
                let descriptor = EffectDescriptor::find(&given.name)?;
                Ok(Part { descriptor, values: descriptor.values_of(given)? })
            })
            .collect::<Result<_, ModelError>>()?;
        Ok(Hypothesis {
            declared: declared.clone(),
            guides: declared.resolved_guides()?,
            tolerances,
            moved: [0.0; NominalParameter::ALL.len()],
            spread: [[0.0; MAX_GUIDES - 1]; SPREAD.len()],
            guides_differ: false,
            curves_bend: false,
            effects,
        })
    }

    /// The same with one more effect.
    pub fn with(&self, part: Part) -> Hypothesis {
        let mut more = self.clone();
        more.effects.push(part);
        more
    }

    /// The same without one effect.
    pub fn without(&self, effect: usize) -> Hypothesis {
        let mut less = self.clone();
        less.effects.remove(effect);
        less
    }

    /// The same in another record: phases that count from the start of a record are those that fit
    /// this one best, and an instant at which a curve over the time jumps is another one where that
    /// is much better. Amplitudes, frequencies and heights stay.
    pub fn in_record(&self, measured: &Measured) -> Result<Hypothesis, ModelError> {
        let mut here = self.clone();
        for effect in 0..self.effects.len() {
            let descriptor = self.effects[effect].descriptor;
            if let Some(jumping) = here.jumping_elsewhere(effect, measured)? {
                let left = |hypothesis: &Hypothesis| {
                    Ok::<_, ModelError>(hypothesis.missing(measured, Sides::BOTH)?.squares())
                };
                let ((motor, carriage), (motor_there, carriage_there)) =
                    (left(&here)?, left(&jumping)?);
                if motor_there + carriage_there < ANOTHER_INSTANT * (motor + carriage) {
                    here = jumping;
                }
            }
            if !PHASE_OF_RECORD.contains(&descriptor.name) {
                continue;
            }
            let index_of = |name: &str| {
                descriptor.parameters.iter().position(|parameter| parameter.name == name)
            };
            let (Some(frequency), Some(phase)) = (index_of("frequency"), index_of("phase")) else {
                continue;
            };
            let frequency = here.effects[effect].values[frequency];
            let missing = here.without(effect).missing(measured, Sides::CARRIAGE)?;
            let time = measured.at_rows(&measured.time);
            let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
            for (time, force) in time.iter().zip(&missing.carriage) {
                let (sine, cosine) = (TAU * frequency * time).sin_cos();
                let row = Vector3::new(sine, cosine, 1.0);
                normal += row * row.transpose();
                right += row * *force;
            }
            if let Some(factors) = normal.cholesky() {
                let best = factors.solve(&right);
                here.effects[effect].values[phase] = best[1].atan2(best[0]);
            }
        }
        Ok(here)
    }

    /// Effects of this one in a record ([`Hypothesis::in_record`]) that differ from these: what
    /// that record has for itself.
    pub fn own_of<'a>(&self, in_record: &'a Hypothesis) -> Vec<&'a Part> {
        let both = in_record.effects.iter().zip(&self.effects);
        both.filter(|(there, here)| there != here).map(|(there, _)| there).collect()
    }

    /// The same with the jump of a curve over the time at the instant of this record, to a sample,
    /// that leaves least; `None` where there is no jump, or there cannot be one at any instant.
    /// Before it is what a curve without the jump leaves, and behind it what one leaves that has
    /// jumped from the start: bristles forget the difference within micrometres.
    pub(crate) fn jumping_elsewhere(
        &self,
        effect: usize,
        measured: &Measured,
    ) -> Result<Option<Hypothesis>, ModelError> {
        let part = &self.effects[effect];
        let Some(curve) = part.parameters().curve.filter(|curve| curve.jump.is_some()) else {
            return Ok(None);
        };
        let Some(at) = part.descriptor.parameters.iter().position(|one| one.name == "jump_at")
        else {
            return Ok(None);
        };
        let jumping_at = |instant: f64| {
            let mut jumping = self.clone();
            jumping.effects[effect].values[at] = instant;
            jumping
        };
        let on_motor = curve.side == CurveSide::Motor && measured.cell.is_some();
        let left = |instant: f64| -> Result<Vec<f64>, ModelError> {
            let jumping = jumping_at(instant);
            let sides = if on_motor { Sides::MOTOR } else { Sides::CARRIAGE };
            let driven = jumping.driven(measured, sides, &Driven::default())?;
            let missing = jumping.missing_at_samples(&driven, measured, sides);
            Ok(if on_motor { missing.motor } else { missing.carriage })
        };
        let step = measured.rate.recip();
        let (first, last) = (measured.time[0] - step, measured.time[measured.len() - 1] + step);
        // Friction that would be gone altogether is no friction.
        let (Ok(without), Ok(with)) = (left(last), left(first)) else { return Ok(None) };
        // Samples that rows stand for: in a hole nothing is known.
        let spacing = measured.lowpass.factor();
        let samples = measured
            .rows
            .iter()
            .flat_map(|row| (0..spacing).map(move |offset| row + offset - spacing / 2));
        let (mut more, mut least, mut instant) = (0.0, 0.0, first);
        for sample in samples {
            // By which more is left if it jumps behind this sample than if it had jumped from the
            // start.
            more += without[sample].powi(2) - with[sample].powi(2);
            if more < least {
                (least, instant) = (more, measured.time[sample] + 0.5 * step);
            }
        }
        Ok(Some(jumping_at(instant)))
    }

    /// Numbers that a record has for itself: of each ripple of balls that slip its knots.
    pub(crate) fn own_numbers(&self, measured: &Measured) -> usize {
        let ripples = self.effects.iter().filter_map(Part::slipping_ripple).collect();
        Slipping::new(ripples, measured).map_or(0, |slipping| slipping.columns())
    }

    /// The same with the amplitudes of balls that slip, of the effects from `first` on, as this
    /// record shows them, on the mean: with all guides in phase they would be twice the root of the
    /// sum of the squares of four that are not.
    pub(crate) fn with_own_amplitudes(
        &self,
        first: usize,
        measured: &Measured,
    ) -> Result<Hypothesis, ModelError> {
        let ripples = self.effects.iter().filter_map(Part::slipping_ripple).collect();
        let Some(slipping) = Slipping::new(ripples, measured) else { return Ok(self.clone()) };
        let mut without = self.clone();
        without.effects.retain(|part| !part.slips());
        let missing = without.missing(measured, Sides::CARRIAGE)?;
        let mut here = self.clone();
        let slips = here.effects.iter_mut().enumerate().filter(|(_, part)| part.slips());
        for ((index, part), amplitude) in slips.zip(slipping.amplitudes(&missing.carriage)) {
            let place = part
                .descriptor
                .parameters
                .iter()
                .position(|parameter| parameter.name == "amplitude");
            if let (Some(place), Some(amplitude), true) = (place, amplitude, index >= first) {
                let (least, most) = part.descriptor.parameters[place].bounds;
                part.values[place] = (2.0 * amplitude).clamp(least, most);
            }
        }
        Ok(here)
    }

    /// The model as declared.
    pub(crate) fn declared(&self) -> &StageModel {
        &self.declared
    }

    /// What the noise of the sensors leaves on a record: the declared one, or what the record shows
    /// where that is more.
    pub fn floor(&self, measured: &Measured) -> Floor {
        measured.floor(&self.declared)
    }

    /// What the declared noise alone leaves.
    pub fn declared_floor(&self, measured: &Measured) -> Floor {
        measured.declared_floor(&self.declared)
    }

    fn moved(&self, declared: NominalParameter) -> f64 {
        self.moved[declared as usize]
    }

    pub fn mass(&self) -> f64 {
        self.declared.mass * self.moved(NominalParameter::Mass).exp()
    }

    /// A start for a fit that makes the guides different from each other, whatever the differences
    /// were; `None` for a single guide.
    pub fn different_guides(&self) -> Option<Hypothesis> {
        let contrasts = self.guides.len().saturating_sub(1);
        if contrasts == 0 {
            return None;
        }
        let start = START_SPREAD * self.tolerances.guides;
        let mut freed = self.holding_guides(false);
        freed.spread = [[0.0; MAX_GUIDES - 1]; SPREAD.len()];
        for (parameter, spread) in freed.spread.iter_mut().enumerate() {
            // Each in a contrast of its own as far as they go, so that no two are tied together.
            spread[parameter % contrasts] = start;
        }
        Some(freed)
    }

    /// Whether the guides are all the same.
    pub fn guides_are_alike(&self) -> bool {
        self.spread.iter().flatten().all(|value| *value == 0.0)
            && self.guides.windows(2).all(|two| two[0] == two[1])
    }

    /// The same with the differences between the guides held, or not.
    pub fn holding_guides(&self, hold: bool) -> Hypothesis {
        Hypothesis { guides_differ: !hold, ..self.clone() }
    }

    /// The same with the curves that the model does not declare held, or not.
    pub(crate) fn holding_curves(&self, hold: bool) -> Hypothesis {
        Hypothesis { curves_bend: !hold, ..self.clone() }
    }

    /// The guides as moved; static friction never below Coulomb friction.
    pub fn guides(&self) -> Vec<Guide> {
        let damping = self.moved(NominalParameter::BristleDamping).exp();
        let viscous = self.moved(NominalParameter::ViscousFriction).exp();
        let factor = |parameter: usize, guide: usize| {
            let differs: f64 = self.spread[parameter]
                .iter()
                .zip(&CONTRASTS)
                .map(|(value, row)| value * row[guide])
                .sum();
            (self.moved(SPREAD[parameter]) + differs).exp()
        };
        self.guides
            .iter()
            .enumerate()
            .map(|(index, guide)| {
                let [stiffness, coulomb, stat, stribeck] =
                    std::array::from_fn(|parameter| factor(parameter, index));
                let coulomb_force = guide.coulomb_force * coulomb;
                Guide {
                    stiffness: guide.stiffness * stiffness,
                    bristle_damping: guide.bristle_damping * damping,
                    viscous_friction: guide.viscous_friction * viscous,
                    coulomb_force,
                    static_force: (guide.static_force * stat).max(coulomb_force),
                    stribeck_velocity: guide.stribeck_velocity * stribeck,
                    damping_velocity: guide.damping_velocity,
                }
            })
            .collect()
    }

    /// The model that this hypothesis stands for.
    pub fn model(&self) -> StageModel {
        StageModel {
            mass: self.mass(),
            guides: self.guides().into_iter().map(GuideSource::Inline).collect(),
            effects: self.effects.iter().map(Part::parameters).collect(),
            ..self.declared.clone()
        }
    }

    /// A declared parameter in its unit, of the guides their mean; `rate` is that of the samples,
    /// Hz.
    pub fn declared_value(&self, declared: NominalParameter, rate: f64) -> f64 {
        let guides = self.guides();
        let mean = |value: &dyn Fn(&Guide) -> f64| {
            guides.iter().map(value).sum::<f64>() / guides.len() as f64
        };
        match declared {
            NominalParameter::Mass => self.mass(),
            NominalParameter::Stiffness => mean(&|guide| guide.stiffness),
            NominalParameter::BristleDamping => mean(&|guide| guide.bristle_damping),
            NominalParameter::ViscousFriction => mean(&|guide| guide.viscous_friction),
            NominalParameter::CoulombForce => mean(&|guide| guide.coulomb_force),
            NominalParameter::StaticForce => mean(&|guide| guide.static_force),
            NominalParameter::StribeckVelocity => mean(&|guide| guide.stribeck_velocity),
            NominalParameter::SensorShift => self.moved(declared) / rate,
        }
    }

    /// Everything that a fit on these sides may move.
    pub fn coordinates(&self, sides: Sides, has_cell: bool) -> Vec<FreeParameter> {
        let mut coordinates = Vec::new();
        if sides.carriage {
            for declared in NominalParameter::ALL {
                // Without a cell there is no second clock: what the motion is late by is a lag of
                // the motor.
                if declared == NominalParameter::SensorShift && !has_cell {
                    continue;
                }
                let limit = match declared {
                    NominalParameter::Mass => self.tolerances.mass,
                    NominalParameter::SensorShift => SHIFT_LIMIT,
                    NominalParameter::ViscousFriction | NominalParameter::CoulombForce => {
                        self.tolerances.guides
                    }
                    _ => self.tolerances.presliding,
                };
                let lower = if limit < 1.0 { (1.0 - limit).ln() } else { -(1.0 + limit).ln() };
                coordinates.push(FreeParameter {
                    id: ParameterId::Nominal(declared),
                    value: self.moved(declared),
                    scale: limit,
                    bounds: if declared.is_factor() {
                        (lower, (1.0 + limit).ln())
                    } else {
                        (-limit, limit)
                    },
                });
            }
        }
        if sides.carriage && self.guides_differ {
            let limit = self.tolerances.guides;
            for (parameter, spread) in self.spread.iter().enumerate() {
                for (contrast, value) in
                    spread.iter().enumerate().take(self.guides.len().saturating_sub(1))
                {
                    coordinates.push(FreeParameter {
                        id: ParameterId::Spread { parameter, contrast },
                        value: *value,
                        scale: limit,
                        bounds: ((1.0 - limit).ln(), (1.0 + limit).ln()),
                    });
                }
            }
        }
        for (effect, part) in self.effects.iter().enumerate() {
            // Behind the cell nobody sees the motor, and before it nobody the carriage.
            let seen = match part.side() {
                Side::Motor => sides.motor || !has_cell,
                Side::Carriage => sides.carriage,
                Side::Sensor => true,
            };
            if !seen {
                continue;
            }
            if self.curves_bend && effect >= self.declared.effects.len() {
                coordinates.extend(part.heights(effect));
            }
            // The knots of a map stand behind its parameters: they come from their own least
            // squares.
            for (value, parameter) in part.descriptor.parameters.iter().enumerate() {
                if (part.descriptor.free)(&part.values, value) {
                    coordinates.push(FreeParameter {
                        id: ParameterId::Effect { effect, value },
                        value: part.values[value],
                        scale: parameter.scale,
                        bounds: parameter.bounds,
                    });
                }
            }
        }
        coordinates
    }

    pub fn set(&mut self, id: ParameterId, value: f64) {
        match id {
            ParameterId::Nominal(declared) => self.moved[declared as usize] = value,
            ParameterId::Spread { parameter, contrast } => self.spread[parameter][contrast] = value,
            ParameterId::Effect { effect, value: index } => {
                self.effects[effect].values[index] = value
            }
        }
    }

    /// Drives guides and effects along the measured motion and says what force is missing.
    pub fn missing(&self, measured: &Measured, sides: Sides) -> Result<Missing, ModelError> {
        Ok(self.missing_of(&self.driven(measured, sides, &Driven::default())?, measured, sides))
    }

    /// The same from what was driven already.
    pub(crate) fn missing_of(&self, driven: &Driven, measured: &Measured, sides: Sides) -> Missing {
        let Missing { motor, carriage } = self.missing_at_samples(driven, measured, sides);
        let filtered =
            |signal: Vec<f64>| if signal.is_empty() { signal } else { measured.filtered(&signal) };
        let mut carriage = filtered(carriage);
        driven.take_out_own(&mut carriage);
        Missing { motor: filtered(motor), carriage }
    }

    /// The same at every sample and not filtered; 0 at both ends, where there is no second
    /// difference.
    pub(crate) fn missing_at_samples(
        &self,
        driven: &Driven,
        measured: &Measured,
        sides: Sides,
    ) -> Missing {
        let count = measured.len();
        let cell = driven.cell(measured);
        let on = |side: Side| driven.forces().filter(move |force| force.side() == side);
        let mut missing = Missing::default();
        if let (true, Some(cell)) = (sides.motor, cell) {
            missing.motor = (0..count)
                .map(|k| {
                    cell[k]
                        - measured.command[k]
                        - on(Side::Motor).map(|force| force.read_at(k)).sum::<f64>()
                })
                .collect();
        }
        if sides.carriage {
            let mass = self.mass();
            let mut push: Vec<f64> = cell.unwrap_or(&measured.command).to_vec();
            for force in on(Side::Motor) {
                for (k, push) in push.iter_mut().enumerate() {
                    // The cell reads at the samples; what moves the carriage is the mean over the
                    // intervals.
                    *push +=
                        force.at_nodes[k] - if cell.is_some() { force.read_at(k) } else { 0.0 };
                }
            }
            let mut left: Vec<f64> = (0..count)
                .map(|k| {
                    (mass + driven.added_mass(k))
                        * (measured.acceleration[k]
                            - driven.apparent_acceleration(k, measured.rate))
                })
                .collect();
            let mut take = |forces: &[f64], sign: f64| {
                left.iter_mut().zip(forces).for_each(|(left, force)| *left += sign * force);
            };
            driven.friction().for_each(|(part, factor)| take(part, factor));
            on(Side::Carriage).for_each(|force| take(&force.at_nodes, -1.0));
            let shift = 0.5 * self.moved(NominalParameter::SensorShift);
            missing.carriage = (0..count)
                .map(|k| {
                    if k == 0 || k + 1 == count {
                        return 0.0;
                    }
                    left[k] - push[k] - shift * (push[k + 1] - push[k - 1])
                })
                .collect();
        }
        missing
    }

    /// Friction of the guides along the measured motion without effects, N, at the nodes.
    pub fn friction(&self, measured: &Measured) -> Result<Vec<f64>, ModelError> {
        driven::friction(&self.guides(), measured)
    }
}
