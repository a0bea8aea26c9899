//! Effects beyond the LuGre guides: one file each, named in the two lists below.
//!
//! A file holds everything about its effect: law with symbols, units and source; parameters with
//! bounds; the side it acts on; its force and its energy; how to guess its parameters from a
//! residual. The model file, the plant, the node and identification know an effect through its
//! [`EffectDescriptor`] alone.

use std::collections::BTreeMap;
use std::fmt::Debug;

use crate::model::{EffectParameters, ModelError, nearest};

use super::guides::{BristleElements, BristleShare, FrictionScale, MAX_ELEMENTS, Slip};

/// Most effects that one stage may have: their forces pass through fixed-size buffers.
pub const MAX_EFFECTS: usize = 16;

mod actuator_lag;
mod asymmetric_friction;
mod ball_passage;
mod cable_chain;
mod cogging;
mod constant_force;
mod distributed_bristles;
mod encoder_scale;
mod encoder_sde;
mod external_vibration;
mod force_cell_drift;
mod force_cell_gain;
mod force_ripple;
mod map;
mod motor_gain;
mod payload;
mod position_dependent_friction;
mod quadratic_drag;
mod regression;
mod stiction_aging;
mod structural_mode;
mod viscous_warm_up;

/// Every effect, in alphabetical order.
pub const ALL: &[&EffectDescriptor] = &[
    &actuator_lag::DESCRIPTOR,
    &asymmetric_friction::DESCRIPTOR,
    &ball_passage::DESCRIPTOR,
    &cable_chain::DESCRIPTOR,
    &cogging::DESCRIPTOR,
    &constant_force::DESCRIPTOR,
    &distributed_bristles::DESCRIPTOR,
    &encoder_scale::DESCRIPTOR,
    &encoder_sde::DESCRIPTOR,
    &external_vibration::DESCRIPTOR,
    &force_cell_drift::DESCRIPTOR,
    &force_cell_gain::DESCRIPTOR,
    &force_ripple::DESCRIPTOR,
    &map::DESCRIPTOR,
    &motor_gain::DESCRIPTOR,
    &payload::DESCRIPTOR,
    &position_dependent_friction::DESCRIPTOR,
    &quadratic_drag::DESCRIPTOR,
    &stiction_aging::DESCRIPTOR,
    &structural_mode::DESCRIPTOR,
    &viscous_warm_up::DESCRIPTOR,
];

pub use map::{along, heights};
pub use regression::{golden_maximum, viscous_friction};

/// Where an effect enters, which decides who can see it: the force cell sees the motor side only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Between command and force cell.
    Motor,
    /// Between force cell and carriage.
    Carriage,
    /// In what encoder or force cell read; no force.
    Sensor,
}

/// The motion that an effect sees: middle of a step (of each part of a step in which the carriage
/// reverses).
#[derive(Clone, Copy, Debug, Default)]
pub struct Motion {
    /// s since the start
    pub time: f64,
    /// Of the carriage, m.
    pub position: f64,
    /// Of the carriage, m/s; over the step the position changes by velocity times step.
    pub velocity: f64,
    /// Of the carriage, m/s^2, at the start of the step.
    pub acceleration: f64,
    /// Commanded motor force over the step, N; for an effect of the chain ([`Effect::drive`]) as it
    /// arrives there.
    pub motor_force: f64,
    /// Friction of the guides as the step begins, N, positive against positive motion. For laws of
    /// friction: forces are not told it.
    pub friction: f64,
}

/// A force along +x over a step: what comes early and what comes late in it move the samples on
/// either side unequally.
#[derive(Clone, Copy, Debug, Default)]
pub struct ForceOverStep {
    /// N
    pub mean: f64,
    /// Mean of the force times the time since the middle of the step, N times steps: between -1/4
    /// and 1/4 of the largest force.
    pub moment: f64,
}

/// Place of an effect in the chain that makes the motor's force of its command. What it takes for
/// the command is what the places before it pass on; those of one place stand side by side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Drive {
    /// The command arrives late.
    Lag,
    /// More or less force per command, everywhere; the force is proportional to the command.
    Gain,
    /// The same over the position.
    Ripple,
}

/// Laws of the guides that an effect multiplies by a factor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Scaled {
    /// What bristles give: Fc, Fs.
    pub bristles: bool,
    /// sigma2
    pub viscous: bool,
}

impl Scaled {
    pub const NOTHING: Scaled = Scaled { bristles: false, viscous: false };
    pub const BRISTLES: Scaled = Scaled { bristles: true, viscous: false };
    pub const VISCOUS: Scaled = Scaled { bristles: false, viscous: true };
    pub const BOTH: Scaled = Scaled { bristles: true, viscous: true };
}

impl ForceOverStep {
    fn add(&mut self, other: ForceOverStep) {
        self.mean += other.mean;
        self.moment += other.moment;
    }
}

/// A ripple over the position whose amplitude and phase change with the distance travelled,
/// otherwise in each record.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlippingRipple {
    /// m
    pub period: f64,
    /// Distance over which they change little, m.
    pub piece: f64,
}

/// What the model of guides, mass, motor and sensors lacks.
///
/// The plant and identification drive the same object: `friction` once per step, then `force` once
/// per step, with the steps in order. A step of 0 s (after a reset) asks for the force of a state
/// and leaves it as it is.
pub trait Effect: Debug + Send + Sync {
    /// Mean force along +x on the side of the effect over a step of `step` seconds, N. On the motor
    /// side it adds to the command, before the force cell; on the carriage side it acts behind the
    /// cell.
    fn force(&mut self, _motion: &Motion, _step: f64) -> f64 {
        0.0
    }

    /// As [`Effect::force`], over a step as long as a control cycle, with where in it the force
    /// acts.
    fn force_over(&mut self, motion: &Motion, step: f64) -> ForceOverStep {
        ForceOverStep { mean: self.force(motion, step), moment: 0.0 }
    }

    /// Its place in the chain from the command to the motor's force, if it has one.
    fn drive(&self) -> Option<Drive> {
        None
    }

    /// Multiplies the factors on the guides' laws over a step; called only if it `scales` any.
    fn friction(&mut self, _motion: &Motion, _step: f64, _scale: &mut FrictionScale) {}

    /// Which factors `friction` multiplies.
    fn scales(&self) -> Scaled {
        Scaled::NOTHING
    }

    /// Whether what `friction` does hangs on the friction of all guides ([`Motion::friction`]).
    /// Only of what scales the viscous friction alone: bristles know nothing of it.
    fn feels_friction(&self) -> bool {
        false
    }

    /// Shares of the elements that stand in parallel in each guide, in place of its one bristle.
    fn bristle_elements(&self) -> Option<BristleElements> {
        None
    }

    /// The ripple of balls that slip, whose phase is each record's own: what a record shows of it
    /// is found in that record, not by the law.
    fn slipping_ripple(&self) -> Option<SlippingRipple> {
        None
    }

    /// Mass that moves rigidly with the carriage beyond that of the model, kg; negative for a part
    /// of it that does not.
    fn added_mass(&self) -> f64 {
        0.0
    }

    /// The same of a mass that is not always there: as the carriage moves now, kg.
    fn mass_along(&self, _motion: &Motion) -> f64 {
        0.0
    }

    /// The least that [`Effect::mass_along`] comes to, kg; `None` where it is nothing everywhere.
    fn least_mass(&self) -> Option<f64> {
        None
    }

    /// Largest slope of the force over position, N/m: limits the step of the plant.
    fn stiffness(&self) -> f64 {
        0.0
    }

    /// What the encoder reads at a true position, m, before noise and quantisation.
    fn encoder(&self, _time: f64, position: f64) -> f64 {
        position
    }

    /// Of what reads wrong: whether it is the encoder, and not the force cell.
    fn is_of_encoder(&self) -> bool {
        false
    }

    /// What the force cell reads under a true force, N, before noise.
    fn force_cell(&self, _time: f64, force: f64) -> f64 {
        force
    }

    /// Side where it is not the descriptor's.
    fn side(&self) -> Option<Side> {
        None
    }

    /// Energy that the effect holds and can give back, J.
    fn stored_energy(&self, _time: f64, _position: f64) -> f64 {
        0.0
    }

    /// Back to the state at construction.
    fn reset(&mut self) {}
}

/// A parameter of an effect.
#[derive(Clone, Copy, Debug)]
pub struct EffectParameter {
    pub name: &'static str,
    pub unit: &'static str,
    pub description: &'static str,
    /// Smallest and largest possible value.
    pub bounds: (f64, f64),
    /// Value where the model does not give one; `None` makes it obligatory.
    pub default: Option<f64>,
    /// Typical size of the value or of its changes, in its unit, greater than 0: scales a fit.
    pub scale: f64,
}

impl EffectParameter {
    /// A parameter that a model must give.
    pub(super) const fn required(
        name: &'static str,
        unit: &'static str,
        description: &'static str,
        bounds: (f64, f64),
        scale: f64,
    ) -> EffectParameter {
        EffectParameter { name, unit, description, bounds, default: None, scale }
    }

    /// A parameter with the value `default` where a model gives none.
    pub(super) const fn optional(
        name: &'static str,
        unit: &'static str,
        description: &'static str,
        bounds: (f64, f64),
        scale: f64,
        default: f64,
    ) -> EffectParameter {
        EffectParameter { name, unit, description, bounds, default: Some(default), scale }
    }
}

/// What is left of a measured force after the declared model, sample by sample at a uniform rate;
/// all slices of one length.
///
/// `force` has the sign of [`Effect::force`]: what the effect would have to add along +x on its
/// side. Motor side: force cell less command. Carriage side and encoder: mass times acceleration
/// plus friction less force cell. Readings of the force cell: cell less command.
#[derive(Clone, Copy, Debug)]
pub struct Residual<'a> {
    /// Since the start of the record, s.
    pub time: &'a [f64],
    /// m
    pub position: &'a [f64],
    /// m/s
    pub velocity: &'a [f64],
    /// m/s^2
    pub acceleration: &'a [f64],
    /// Commanded motor force, N.
    pub command: &'a [f64],
    /// Friction of the guides along the motion as modelled, N, positive against positive motion.
    pub friction: &'a [f64],
    /// What an effect would have to add, N.
    pub force: &'a [f64],
    /// Moving mass as modelled, kg.
    pub mass: f64,
    /// The carriage side before the lowpass and at every sample: what is too fast for the rows
    /// above shows here.
    pub samples: Samples<'a>,
}

/// A residual at the rate of the recording.
#[derive(Clone, Copy, Debug)]
pub struct Samples<'a> {
    /// As the encoder says, m.
    pub position: &'a [f64],
    /// What an effect would have to add, N.
    pub force: &'a [f64],
    /// Time between samples, s.
    pub step: f64,
}

/// Everything the rest of the program knows of an effect.
#[derive(Debug)]
pub struct EffectDescriptor {
    /// Canonical name, as in model files and in summaries.
    pub name: &'static str,
    pub side: Side,
    /// The law in one line.
    pub law: &'static str,
    /// Where the law comes from.
    pub source: &'static str,
    /// What gives the effect away in a residual.
    pub telltale: &'static str,
    /// In the order of all slices of values. A `map` has knots behind them, see
    /// [`EffectDescriptor::values_of`].
    pub parameters: &'static [EffectParameter],
    /// Refuses values within their bounds that do not go together.
    pub check: fn(&[f64]) -> Result<(), ModelError>,
    /// Whether a fit that starts at these values may change the value of this index: some choose
    /// between forms of a law.
    pub free: fn(&[f64], usize) -> bool,
    /// Builds the effect from checked values, in the order of `parameters`.
    pub build: fn(&[f64]) -> Box<dyn Effect>,
    /// Guesses values from a residual, for a joint refit to start from; `None` where it shows
    /// nothing of this kind.
    pub propose: fn(&Residual) -> Option<Vec<f64>>,
    /// From a proposal and the time between samples, s, the values that fits start from: one for
    /// each form of a law that has several, and for each place that a fit does not leave by itself.
    pub starts: fn(&[f64], f64) -> Vec<Vec<f64>>,
}

/// Every value set within its bounds is possible.
fn any(_values: &[f64]) -> Result<(), ModelError> {
    Ok(())
}

/// A law of one form: what is proposed is where a fit starts.
fn as_proposed(values: &[f64], _step: f64) -> Vec<Vec<f64>> {
    vec![values.to_vec()]
}

/// What is proposed, in each of `count` forms that the value at `form` numbers from 0.
fn every_form(values: &[f64], form: usize, count: u8) -> Vec<Vec<f64>> {
    let of_form = |code| {
        let mut start = values.to_vec();
        start[form] = f64::from(code);
        start
    };
    (0..count).map(of_form).collect()
}

/// A fit may change every value.
fn all_free(_values: &[f64], _index: usize) -> bool {
    true
}

/// The force of the motor on its way through the chain of its drive.
struct Chain {
    place: Option<Drive>,
    /// What arrives at this place, and that with what it adds.
    arriving: ForceOverStep,
    passed_on: ForceOverStep,
}

impl Chain {
    fn new(command: f64) -> Chain {
        let command = ForceOverStep { mean: command, moment: 0.0 };
        Chain { place: None, arriving: command, passed_on: command }
    }

    /// What arrives at a place that is not before the last one.
    fn arriving(&mut self, place: Drive) -> ForceOverStep {
        if self.place != Some(place) {
            (self.place, self.arriving) = (Some(place), self.passed_on);
        }
        self.arriving
    }

    fn pass_on(&mut self, added: ForceOverStep) {
        self.passed_on.add(added);
    }
}

/// The effects of one stage with the forces of the last step.
#[derive(Debug)]
pub struct Effects {
    list: Vec<Entry>,
    /// Places in `list`: first those of the chain that makes the motor's force, as they follow each
    /// other.
    order: Vec<usize>,
    forces: Vec<f64>,
    scales: Scaled,
    changes_mass: bool,
    reads: bool,
    motor_side: f64,
    carriage_side: f64,
}

#[derive(Debug)]
struct Entry {
    descriptor: &'static EffectDescriptor,
    side: Side,
    drive: Option<Drive>,
    effect: Box<dyn Effect>,
}

impl EffectDescriptor {
    /// Whether a value has a part in the form of the law that these values choose.
    pub fn takes_part(&self, values: &[f64], index: usize) -> bool {
        let always = self.parameters.get(index).is_some_and(|parameter| match parameter.name {
            "form" => true,
            "slip" => values[index] > 0.0,
            // What a model has to give.
            _ => parameter.default.is_none(),
        });
        self.name == "map" || always || (self.free)(values, index)
    }

    /// The descriptor of a canonical name.
    pub fn find(name: &str) -> Result<&'static EffectDescriptor, ModelError> {
        ALL.iter().copied().find(|effect| effect.name == name).ok_or_else(|| {
            ModelError::UnknownEffect {
                name: name.to_owned(),
                hint: nearest(name, ALL.iter().map(|effect| effect.name)),
                known: ALL.iter().map(|effect| effect.name).collect::<Vec<_>>().join(", "),
            }
        })
    }

    /// Values of an effect of a model, in the order of `parameters`, checked. Of a `map`:
    /// coordinate (0 position, 1 velocity, 2 time), side (0 carriage, 1 motor, 2 Coulomb friction,
    /// 3 viscous friction, 4 mass), from, to, height and place of its jump (0 where there is none),
    /// then the force at the knots.
    pub fn values_of(&self, given: &EffectParameters) -> Result<Vec<f64>, ModelError> {
        let values = match &given.curve {
            Some(curve) if self.name == map::DESCRIPTOR.name => map::values(curve),
            _ => self.values(&given.values)?,
        };
        (self.check)(&values)?;
        Ok(values)
    }

    /// The effect of a model that has these values: the inverse of [`EffectDescriptor::values_of`].
    pub fn parameters_of(&self, values: &[f64]) -> EffectParameters {
        if self.name == map::DESCRIPTOR.name {
            return EffectParameters::map(map::curve(values));
        }
        EffectParameters::new(
            self.name,
            self.parameters.iter().map(|parameter| parameter.name).zip(values.iter().copied()),
        )
    }

    /// Values in the order of `parameters`: defaults filled in, unknown names, missing and
    /// impossible values refused.
    pub fn values(&self, given: &BTreeMap<String, f64>) -> Result<Vec<f64>, ModelError> {
        let names = || self.parameters.iter().map(|parameter| parameter.name);
        if let Some(unknown) =
            given.keys().find(|name| !names().any(|known| known == name.as_str()))
        {
            return Err(ModelError::UnknownEffectParameter {
                effect: self.name,
                name: unknown.clone(),
                hint: nearest(unknown, names()),
                known: names().collect::<Vec<_>>().join(", "),
            });
        }
        self.parameters
            .iter()
            .map(|parameter| {
                let value = given.get(parameter.name).copied().or(parameter.default).ok_or(
                    ModelError::MissingEffectParameter {
                        effect: self.name,
                        name: parameter.name,
                        description: parameter.description,
                        unit: parameter.unit,
                    },
                )?;
                let (min, max) = parameter.bounds;
                if (min..=max).contains(&value) {
                    return Ok(value);
                }
                let (key, unit) =
                    (format!("effects.{}.{}", self.name, parameter.name), parameter.unit);
                Err(ModelError::Value {
                    key,
                    value,
                    limit: format!("be between {min} and {max} {unit}"),
                })
            })
            .collect()
    }
}

impl Effects {
    pub fn new(given: &[EffectParameters]) -> Result<Effects, ModelError> {
        if given.len() > MAX_EFFECTS {
            let (key, value) = ("effects (their number)".to_owned(), given.len() as f64);
            return Err(ModelError::Value {
                key,
                value,
                limit: format!("not be above {MAX_EFFECTS}"),
            });
        }
        let list = given
            .iter()
            .map(|given| {
                let descriptor = EffectDescriptor::find(&given.name)?;
                let effect = (descriptor.build)(&descriptor.values_of(given)?);
                let (side, drive) = (effect.side().unwrap_or(descriptor.side), effect.drive());
                Ok(Entry { descriptor, side, drive, effect })
            })
            .collect::<Result<Vec<_>, ModelError>>()?;
        let forces = vec![0.0; list.len()];
        let scales =
            list.iter().map(|entry| entry.effect.scales()).fold(Scaled::NOTHING, |all, one| {
                Scaled {
                    bristles: all.bristles || one.bristles,
                    viscous: all.viscous || one.viscous,
                }
            });
        let reads = list.iter().any(|entry| entry.side == Side::Sensor);
        let mut order: Vec<usize> = (0..list.len()).collect();
        order.sort_by_key(|index| {
            list[*index].drive.map_or((true, None), |drive| (false, Some(drive)))
        });
        let changes_mass = list.iter().any(|entry| entry.effect.least_mass().is_some());
        let mut effects = Effects {
            list,
            order,
            forces,
            scales,
            changes_mass,
            reads,
            motor_side: 0.0,
            carriage_side: 0.0,
        };
        effects.reset(0.0);
        Ok(effects)
    }

    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Canonical names, in the order of the model.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.list.iter().map(|entry| entry.descriptor.name)
    }

    /// Forces of the last step along +x, N, in the order of the model; 0 for those that act through
    /// friction, mass or sensors.
    pub fn forces(&self) -> &[f64] {
        &self.forces
    }

    /// Mass that the effects add to the carriage, kg.
    pub fn added_mass(&self) -> f64 {
        self.list.iter().map(|entry| entry.effect.added_mass()).sum()
    }

    /// Whether the mass that moves with the carriage is not always the same.
    pub fn changes_mass(&self) -> bool {
        self.changes_mass
    }

    /// What the effects add to the carriage beyond [`Effects::added_mass`] as it moves now, kg.
    pub fn mass_along(&self, motion: &Motion) -> f64 {
        self.list.iter().map(|entry| entry.effect.mass_along(motion)).sum()
    }

    /// The least that this comes to, kg.
    pub fn least_mass(&self) -> f64 {
        self.list.iter().filter_map(|entry| entry.effect.least_mass()).sum()
    }

    /// Sum of the largest slopes of the forces over position, N/m.
    pub fn stiffness(&self) -> f64 {
        self.list.iter().map(|entry| entry.effect.stiffness()).sum()
    }

    /// Shares of the bristle elements of each guide, of the last effect that has some; `None`: one
    /// bristle.
    pub fn bristle_elements(&self) -> Option<BristleElements> {
        self.list.iter().rev().find_map(|entry| entry.effect.bristle_elements())
    }

    /// Which factors on the guides' laws they multiply.
    pub fn scales(&self) -> Scaled {
        self.scales
    }

    /// Whether what the guides' bristles give is not that of the model alone.
    pub fn shapes_bristles(&self) -> bool {
        self.scales.bristles || self.bristle_elements().is_some()
    }

    /// Whether the guides' laws or bristles are not those of the model alone.
    pub fn shapes_friction(&self) -> bool {
        self.scales.viscous || self.shapes_bristles()
    }

    /// Whether what any of them does to the viscous friction hangs on the friction of all guides.
    pub fn feel_friction(&self) -> bool {
        self.list.iter().any(|entry| entry.effect.feels_friction())
    }

    /// Whether the phase of any of them is each record's own.
    pub fn slips(&self) -> bool {
        self.list.iter().any(|entry| entry.effect.slipping_ripple().is_some())
    }

    /// Factors on the guides' laws over a step. Before [`Effects::advance`], once per step.
    pub fn friction(&mut self, motion: &Motion, step: f64) -> FrictionScale {
        let mut scale = FrictionScale::ONE;
        if self.scales != Scaled::NOTHING {
            self.list.iter_mut().for_each(|entry| entry.effect.friction(motion, step, &mut scale));
        }
        scale
    }

    /// Advances every effect by a step; sums of the motor side and of the carriage side, N.
    pub fn advance(&mut self, motion: &Motion, step: f64) -> (f64, f64) {
        (self.motor_side, self.carriage_side) = (0.0, 0.0);
        let mut chain = Chain::new(motion.motor_force);
        for index in &self.order {
            let Entry { side, drive, effect, .. } = &mut self.list[*index];
            let force = if let Some(place) = *drive {
                let motor_force = chain.arriving(place).mean;
                let force = effect.force(&Motion { motor_force, ..*motion }, step);
                chain.pass_on(ForceOverStep { mean: force, moment: 0.0 });
                force
            } else {
                effect.force(motion, step)
            };
            self.forces[*index] = force;
            match side {
                Side::Motor => self.motor_side += force,
                Side::Carriage => self.carriage_side += force,
                Side::Sensor => {}
            }
        }
        self.last()
    }

    /// Advances every effect by a step as long as a control cycle; sum of their forces.
    pub fn advance_long(&mut self, motion: &Motion, step: f64) -> ForceOverStep {
        let (mut sum, mut chain) = (ForceOverStep::default(), Chain::new(motion.motor_force));
        for index in &self.order {
            let Entry { drive, effect, .. } = &mut self.list[*index];
            let Some(place) = *drive else {
                sum.add(effect.force_over(motion, step));
                continue;
            };
            let arriving = chain.arriving(place);
            let mut over =
                effect.force_over(&Motion { motor_force: arriving.mean, ..*motion }, step);
            if place > Drive::Lag {
                // Proportional to the force that arrives, and so is where in the step it acts.
                over.moment +=
                    effect.force(&Motion { motor_force: arriving.moment, ..*motion }, step);
            }
            chain.pass_on(over);
            sum.add(over);
        }
        sum
    }

    /// Sums of the last step: motor side, carriage side, N.
    pub fn last(&self) -> (f64, f64) {
        (self.motor_side, self.carriage_side)
    }

    #[inline]
    pub(super) fn last_total(&self) -> f64 {
        self.motor_side + self.carriage_side
    }

    /// What encoder (m) and force cell (N) read, before noise and quantisation.
    pub fn read(&self, time: f64, position: f64, force: f64) -> (f64, f64) {
        if !self.reads {
            return (position, force);
        }
        // Each is wrong about the truth, none about what another makes of it.
        self.list.iter().fold((position, force), |(read_position, read_force), entry| {
            let (x, f) =
                (entry.effect.encoder(time, position), entry.effect.force_cell(time, force));
            (read_position + (x - position), read_force + (f - force))
        })
    }

    pub fn stored_energy(&self, time: f64, position: f64) -> f64 {
        self.list.iter().map(|entry| entry.effect.stored_energy(time, position)).sum()
    }

    /// Back to rest at position 0 at `time`, s, with the forces that act there.
    pub fn reset(&mut self, time: f64) {
        self.list.iter_mut().for_each(|entry| entry.effect.reset());
        self.advance(&Motion { time, ..Motion::default() }, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_reads_wrong_says_of_which_sensor_it_is() {
        for descriptor in ALL.iter().filter(|descriptor| descriptor.side == Side::Sensor) {
            let values: Vec<f64> = descriptor
                .parameters
                .iter()
                .map(|one| one.scale.clamp(one.bounds.0, one.bounds.1))
                .collect();
            let effect = (descriptor.build)(&values);
            let wrong =
                (effect.encoder(0.37, 1.23e-3) != 1.23e-3, effect.force_cell(0.37, 5.0) != 5.0);
            assert_eq!(
                wrong,
                (effect.is_of_encoder(), !effect.is_of_encoder()),
                "{}",
                descriptor.name
            );
        }
    }

    /// A first-order lag of 1 ms under a command that steps to 100 N, in closed form: y = u (1 -
    /// exp(-t / T)), its mean over a cycle of h u (1 - T / h (1 - exp(-h / T))), its moment u T / h
    /// (1/2 (1 + exp(-h / T)) - T / h (1 - exp(-h / T))).
    #[test]
    fn gain_and_ripple_make_their_part_of_the_force_that_arrives_late() {
        let named = |name: &str, values: &[(&'static str, f64)]| {
            EffectParameters::new(name, values.iter().copied())
        };
        let (lag, cycle, command) = (1e-3, 5e-4, 100.0);
        // In any order of the model.
        let mut effects = Effects::new(&[
            named("force_ripple", &[("fraction", 0.05), ("period", 0.02)]),
            named("cogging", &[("amplitude", 2.0), ("period", 0.02)]),
            named("motor_gain", &[("fraction", 0.2)]),
            named("actuator_lag", &[("time_constant", lag)]),
        ])
        .unwrap();
        // A quarter of a period: the peak of ripple and cogging.
        let motion = Motion {
            time: 0.5 * cycle,
            position: 0.005,
            motor_force: command,
            ..Motion::default()
        };
        let (ratio, rest) = (lag / cycle, (-cycle / lag).exp());
        let mean = command * (1.0 - ratio * (1.0 - rest));
        let moment = command * ratio * (0.5 * (1.0 + rest) - ratio * (1.0 - rest));
        let over = effects.advance_long(&motion, cycle);
        let factor = 1.2 * 1.05;
        assert!((over.mean - (factor * mean + 2.0 - command)).abs() < 1e-9, "{over:?}");
        assert!((over.moment - factor * moment).abs() < 1e-9, "{over:?} {}", factor * moment);
        effects.reset(0.0);
        let (motor_side, _) = effects.advance(&motion, cycle);
        assert!((motor_side - over.mean).abs() < 1e-9);
        let expected = [0.05 * 1.2 * mean, 2.0, 0.2 * mean, mean - command];
        assert!(
            effects
                .forces()
                .iter()
                .zip(expected)
                .all(|(found, expected)| (found - expected).abs() < 1e-9)
        );
    }

    #[test]
    fn each_reading_error_is_about_the_truth_whatever_the_others_make_of_it() {
        let sde = |amplitude: f64, period: f64| {
            EffectParameters::new(
                "encoder_sde",
                [("amplitude", amplitude), ("period", period), ("phase", 0.0)],
            )
        };
        let (first, second) = (sde(2e-7, 15e-6), sde(5e-8, 7.5e-6));
        let error =
            |all: &[EffectParameters]| Effects::new(all).unwrap().read(0.0, 2e-6, 0.0).0 - 2e-6;
        let alone = [error(std::slice::from_ref(&first)), error(std::slice::from_ref(&second))];
        let both = error(&[first, second]);
        assert!((both - alone[0] - alone[1]).abs() < 1e-18, "{alone:?} {both}");
    }
}
