//! Effects beyond the LuGre guides: one file each, one line in the list below.
//!
//! A file holds everything about its effect: law with symbols, units and source; parameters with bounds; the side it acts
//! on; its force and its energy; how to guess its parameters from a residual; what it would be confused with. The model
//! file, the plant, the node and identification know an effect through its [`EffectDescriptor`] alone.

use std::collections::BTreeMap;
use std::fmt::Debug;

use crate::model::{EffectParameters, ModelError, nearest};

/// Most effects that one stage may have: their forces pass through fixed-size buffers.
pub const MAX_EFFECTS: usize = 16;

macro_rules! effects {
    ($($module:ident),+ $(,)?) => {
        $(mod $module;)+
        /// Every effect, in alphabetical order.
        pub const ALL: &[&EffectDescriptor] = &[$(&$module::DESCRIPTOR),+];
    };
}

effects!(cable_chain, cogging);

/// Where an effect enters, which decides who can see it: the force cell sees the motor side only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Between command and force cell.
    Motor,
    /// Between force cell and carriage.
    Carriage,
}

/// The motion that an effect sees: middle of a step (of each part of a step in which the carriage reverses).
#[derive(Clone, Copy, Debug)]
pub struct Motion {
    /// s since the start
    pub time: f64,
    /// m
    pub position: f64,
    /// m/s
    pub velocity: f64,
    /// Commanded motor force, N.
    pub motor_force: f64,
}

/// A force that the model of guides, mass and motor lacks.
pub trait Effect: Debug + Send + Sync {
    /// Force along +x on the side of the effect, N, at the middle of a step of `step` seconds. Called once per step, with the steps in order.
    fn force(&mut self, motion: &Motion, step: f64) -> f64;

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
}

/// What is left of a measured force after the declared model, sample by sample.
#[derive(Clone, Copy, Debug)]
pub struct Residual<'a> {
    /// s
    pub time: &'a [f64],
    /// m
    pub position: &'a [f64],
    /// m/s
    pub velocity: &'a [f64],
    /// Measured less modelled force on the effect's side, N.
    pub force: &'a [f64],
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
    /// Canonical names of the effects that can look alike.
    pub confused_with: &'static [&'static str],
    pub parameters: &'static [EffectParameter],
    /// Builds the effect from checked values, in the order of `parameters`.
    pub build: fn(&[f64]) -> Box<dyn Effect>,
    /// Guesses the parameters from a residual; `None` where it shows nothing of this kind.
    pub propose: fn(&Residual) -> Option<Vec<f64>>,
}

/// The effects of one stage with the forces of the last step.
#[derive(Debug)]
pub struct Effects {
    list: Vec<(&'static EffectDescriptor, Box<dyn Effect>)>,
    forces: Vec<f64>,
    motor_side: f64,
    carriage_side: f64,
}

impl EffectDescriptor {
    /// The descriptor of a canonical name.
    pub fn find(name: &str) -> Result<&'static EffectDescriptor, ModelError> {
        ALL.iter().copied().find(|effect| effect.name == name).ok_or_else(|| ModelError::UnknownEffect {
            name: name.to_owned(),
            hint: nearest(name, ALL.iter().map(|effect| effect.name)),
            known: ALL.iter().map(|effect| effect.name).collect::<Vec<_>>().join(", "),
        })
    }

    /// Values in the order of `parameters`: defaults filled in, unknown names, missing and impossible values refused.
    pub fn values(&self, given: &BTreeMap<String, f64>) -> Result<Vec<f64>, ModelError> {
        let names = || self.parameters.iter().map(|parameter| parameter.name);
        if let Some(unknown) = given.keys().find(|name| !names().any(|known| known == name.as_str())) {
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
                let (key, unit) = (format!("effects.{}.{}", self.name, parameter.name), parameter.unit);
                Err(ModelError::Value { key, value, limit: format!("be between {min} and {max} {unit}") })
            })
            .collect()
    }
}

impl Effects {
    pub fn new(given: &[EffectParameters]) -> Result<Effects, ModelError> {
        if given.len() > MAX_EFFECTS {
            let (key, value) = ("effects (their number)".to_owned(), given.len() as f64);
            return Err(ModelError::Value { key, value, limit: format!("not be above {MAX_EFFECTS}") });
        }
        let list = given
            .iter()
            .map(|effect| {
                let descriptor = EffectDescriptor::find(&effect.name)?;
                Ok((descriptor, (descriptor.build)(&descriptor.values(&effect.values)?)))
            })
            .collect::<Result<Vec<_>, ModelError>>()?;
        let forces = vec![0.0; list.len()];
        let mut effects = Effects { list, forces, motor_side: 0.0, carriage_side: 0.0 };
        effects.reset();
        Ok(effects)
    }

    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Canonical names, in the order of the model.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.list.iter().map(|(descriptor, _)| descriptor.name)
    }

    /// Forces of the last step along +x, N, in the order of the model.
    pub fn forces(&self) -> &[f64] {
        &self.forces
    }

    /// Advances every effect by a step; sums of the motor side and of the carriage side, N.
    pub(super) fn advance(&mut self, motion: &Motion, step: f64) -> (f64, f64) {
        (self.motor_side, self.carriage_side) = (0.0, 0.0);
        for ((descriptor, effect), force) in self.list.iter_mut().zip(&mut self.forces) {
            *force = effect.force(motion, step);
            match descriptor.side {
                Side::Motor => self.motor_side += *force,
                Side::Carriage => self.carriage_side += *force,
            }
        }
        self.last()
    }

    /// Sums of the last step: motor side, carriage side, N.
    pub(super) fn last(&self) -> (f64, f64) {
        (self.motor_side, self.carriage_side)
    }

    #[inline]
    pub(super) fn last_total(&self) -> f64 {
        self.motor_side + self.carriage_side
    }

    pub(super) fn stored_energy(&self, time: f64, position: f64) -> f64 {
        self.list.iter().map(|(_, effect)| effect.stored_energy(time, position)).sum()
    }

    /// Back to rest at position 0, with the forces that act there.
    pub(super) fn reset(&mut self) {
        self.list.iter_mut().for_each(|(_, effect)| effect.reset());
        self.advance(&Motion { time: 0.0, position: 0.0, velocity: 0.0, motor_force: 0.0 }, 0.0);
    }
}

/// Fits `forces` by three columns over the coordinates: coefficients and the sum of squares that they take out, N^2.
/// `None` where the columns do not differ enough to be told apart.
fn least_squares<C: Copy>(
    coordinates: &[C],
    forces: &[f64],
    columns: impl Fn(C) -> [f64; 3],
) -> Option<([f64; 3], f64)> {
    let mut normal = nalgebra::Matrix3::zeros();
    let mut right = nalgebra::Vector3::zeros();
    for (coordinate, force) in coordinates.iter().zip(forces) {
        let row = nalgebra::Vector3::from(columns(*coordinate));
        normal += row * row.transpose();
        right += row * *force;
    }
    let solution = normal.cholesky()?.solve(&right);
    let mean = right[0] / normal[(0, 0)];
    Some((solution.into(), solution.dot(&right) - mean * right[0]))
}
