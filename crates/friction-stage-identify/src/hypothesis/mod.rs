//! What might be true: declared parameters within their tolerances and a list of effects.

pub(crate) mod nominal_parameter;

use friction_stage_core::model::{
    Curve, EffectParameters, Guide, GuideSource, MAX_GUIDES, ModelError, StageModel,
};
use friction_stage_core::plant::effects::{ParameterKind, RecordSpecific, Role};
use friction_stage_core::plant::{EffectDescriptor, Side, SlippingRipple};

use crate::error::IdentifyError;
use crate::hypothesis::nominal_parameter::NominalParameter;
use crate::record::measured::{Floor, Measured};

/// How far the real machine may be from the declared one, as shares of the declared values; at 1
/// and above a factor of 1 + this either way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerances {
    /// Of the moving mass.
    pub mass: f64,
    /// Of each LuGre parameter, as the mean over the guides.
    pub guides: f64,
    /// Of bristle stiffness, bristle damping, static friction and Stribeck velocity, where they are
    /// known worse than sliding friction is.
    pub presliding: f64,
}

impl Default for Tolerances {
    /// Assumed: a carriage is weighed to half a percent; guides of one type differ by 16 %.
    fn default() -> Self {
        Tolerances { mass: 0.005, guides: 0.16, presliding: 0.16 }
    }
}

impl Tolerances {
    /// Largest tolerance of the mass and of the sliding friction: a factor of ten either way. What
    /// is known worse has no use for what is declared.
    pub const MOST: f64 = 9.0;

    /// Refuses what is no tolerance.
    pub fn check(&self) -> Result<(), IdentifyError> {
        let given = [
            ("mass_tolerance", self.mass, Self::MOST),
            ("guide_tolerance", self.guides, Self::MOST),
            ("presliding_tolerance", self.presliding, f64::INFINITY),
        ];
        match given
            .into_iter()
            .find(|(_, value, most)| !(*value > 0.0 && value <= most && value.is_finite()))
        {
            None => Ok(()),
            Some((name, value, most)) => Err(IdentifyError::Tolerance { name, value, most }),
        }
    }
}

/// Least change of friction, or of mass as a part of it: nearly all of it gone.
pub(crate) const NO_FRICTION: f64 = -0.99;

/// Largest shift between the instants of encoder and force readings, in samples. Assumed: what is
/// beyond it is a lag of its own.
const SHIFT_LIMIT: f64 = 0.05;

/// Largest factor on stiffness and damping of bristles of which nothing is known, and on its
/// inverse. Assumed: a guide that sticks over millimetres or over nanometres is within it.
const ANY_BRISTLES: f64 = 1000.0;

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

/// An effect with values in the order of its descriptor's parameters.
#[derive(Clone, Debug)]
pub struct Part {
    /// The law.
    pub descriptor: &'static EffectDescriptor,
    /// Its parameters; the knots of a map stand after them.
    pub values: Vec<f64>,
}

impl PartialEq for Part {
    fn eq(&self, other: &Part) -> bool {
        self.descriptor.name == other.descriptor.name && self.values == other.values
    }
}

impl Part {
    /// As an entry of a model.
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

    /// Its first parameter of this kind.
    pub fn value_of_kind(&self, kind: ParameterKind) -> Option<f64> {
        self.values.get(self.descriptor.place_of(kind)?).copied()
    }

    /// The empirical curve that it is; `None` of a law.
    pub fn curve(&self) -> Option<Curve> {
        self.descriptor.curve_of(&self.values)
    }

    /// What it acts on.
    pub fn role(&self) -> Role {
        self.descriptor.role_of(&self.values)
    }

    /// What each record has for itself of it: of balls that slip the whole force.
    pub(crate) fn slipping_ripple(&self) -> Option<SlippingRipple> {
        self.descriptor.slipping_ripple(&self.values)
    }

    /// Whether the law leaves amplitude and phase of the force to each record.
    pub fn slips(&self) -> bool {
        self.slipping_ripple().is_some()
    }

    /// Whether the phase of the law counts from the start of each record.
    pub fn has_phase_of_record(&self) -> bool {
        matches!(self.descriptor.record_specific, RecordSpecific::Phase)
    }

    /// The heights of a curve that is the effect of this index; nothing of a law.
    fn heights(&self, effect: usize) -> Vec<FreeParameter> {
        let Some((curve, heights)) = self.curve().zip(self.descriptor.curve) else {
            return Vec::new();
        };
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
        (heights.heights)(&self.values).into_iter().map(height).collect()
    }

    /// Side of the force cell, or sensor, where it acts.
    pub fn side(&self) -> Side {
        self.role().side()
    }
}

/// Declared model, moved, with effects in it.
#[derive(Clone, Debug)]
pub struct Hypothesis {
    declared: StageModel,
    guides: Vec<Guide>,
    pub(crate) tolerances: Tolerances,
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
    /// Whether stiffness and damping of the bristles are taken from the record, whatever their
    /// tolerance.
    any_bristles: bool,
    /// Whether the shift of the sensors stays as declared: none.
    holds_shift: bool,
    /// Effects of the model: those that it declares come first.
    pub effects: Vec<Part>,
}

/// One number that a fit may change.
#[derive(Clone, Debug)]
pub struct FreeParameter {
    /// What it is.
    pub id: ParameterId,
    /// Its value.
    pub value: f64,
    /// A usual change of it: in this unit a fit counts its steps.
    pub scale: f64,
    /// Least and largest value.
    pub bounds: (f64, f64),
}

impl FreeParameter {
    /// Whether it is a term of a law that has come to 0.
    pub(crate) fn has_come_to_nothing(&self) -> bool {
        matches!(self.id, ParameterId::Effect { .. })
            && self.bounds.0 == 0.0
            && self.value < 1e-3 * self.scale
    }
}

/// Logarithms of the least and largest factor on a declared value within a tolerance: a share of
/// it, or at 1 and above a factor of 1 + this either way.
fn factors(tolerance: f64) -> (f64, f64) {
    let upper = (1.0 + tolerance).ln();
    (if tolerance < 1.0 { (1.0 - tolerance).ln() } else { -upper }, upper)
}

/// Whether a value may be another one within its tolerance.
pub(crate) fn allows(tolerance: f64, declared: f64, measured: f64) -> bool {
    let (least, largest) = factors(tolerance);
    (least..=largest).contains(&(measured / declared).ln())
}

/// Which number of a hypothesis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterId {
    /// A parameter that the model declares.
    Nominal(NominalParameter),
    /// A difference between guides.
    Spread {
        /// Which parameter of the guides.
        parameter: usize,
        /// Which contrast between them.
        contrast: usize,
    },
    /// A parameter of an effect.
    Effect {
        /// Index of the effect.
        effect: usize,
        /// Index of its value.
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
    /// Cell less command.
    pub motor: bool,
    /// Mass and friction less cell.
    pub carriage: bool,
}

impl Sides {
    /// Both sides.
    pub const BOTH: Sides = Sides { motor: true, carriage: true };
    /// The motor side alone.
    pub const MOTOR: Sides = Sides { motor: true, carriage: false };
    /// The carriage side alone.
    pub const CARRIAGE: Sides = Sides { motor: false, carriage: true };
}

impl Hypothesis {
    /// The declared model with the effects that it declares.
    pub fn new(declared: &StageModel, tolerances: Tolerances) -> Result<Hypothesis, ModelError> {
        declared.check()?;
        let effects = declared
            .effects
            .iter()
            .map(|given| {
                let (descriptor, values) = EffectDescriptor::read(given)?;
                Ok(Part { descriptor, values })
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
            any_bristles: false,
            holds_shift: false,
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

    /// Name of an effect of it; of several of one kind the second has `_2`, and so on.
    ///
    /// # Panics
    /// There is no such effect.
    pub fn label(&self, index: usize) -> String {
        let name = self.effects[index].descriptor.name;
        match self.effects[..index].iter().filter(|part| part.descriptor.name == name).count() {
            0 => name.to_owned(),
            before => format!("{name}_{}", before + 1),
        }
    }

    /// Value of a parameter of an effect, as `cogging.amplitude` by its [label](Self::label).
    pub fn effect_value(&self, key: &str) -> Option<f64> {
        let (label, name) = key.split_once('.')?;
        let index = (0..self.effects.len()).find(|index| self.label(*index) == label)?;
        let part = &self.effects[index];
        let place = part.descriptor.parameters.iter().position(|one| one.name == name)?;
        part.values.get(place).copied()
    }

    /// Shift between the instants of encoder and force readings, in samples.
    pub(crate) fn sensor_shift(&self) -> f64 {
        self.moved(NominalParameter::SensorShift)
    }

    fn moved(&self, declared: NominalParameter) -> f64 {
        self.moved[declared as usize]
    }

    /// Moving mass, kg.
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

    /// The same with stiffness and damping of the bristles from the record, whatever their
    /// tolerance.
    pub(crate) fn with_any_bristles(&self) -> Hypothesis {
        Hypothesis { any_bristles: true, ..self.clone() }
    }

    /// The same with encoder and force cell read at the same instants, whatever the record says.
    pub(crate) fn holding_shift(&self) -> Hypothesis {
        let mut held = Hypothesis { holds_shift: true, ..self.clone() };
        held.set(ParameterId::Nominal(NominalParameter::SensorShift), 0.0);
        held
    }

    /// Whether encoder and force cell are read at the same instants, whatever the record says.
    pub(crate) fn holds_shift(&self) -> bool {
        self.holds_shift
    }

    /// Parameters of the bristles that are beyond their tolerance, each as a factor on what is
    /// declared.
    pub(crate) fn bristles_beyond_tolerance(&self) -> Vec<(NominalParameter, f64)> {
        let beyond = |one: &NominalParameter| {
            let (lower, upper) = factors(self.tolerance_of(*one));
            let moved = self.moved(*one);
            (moved < lower || moved > upper).then(|| (*one, moved.exp()))
        };
        NominalParameter::BRISTLES.iter().filter_map(beyond).collect()
    }

    /// How far a declared parameter may be off, as a share of it; of the shift in samples.
    pub(crate) fn tolerance_of(&self, declared: NominalParameter) -> f64 {
        match declared {
            NominalParameter::Mass => self.tolerances.mass,
            NominalParameter::SensorShift => SHIFT_LIMIT,
            NominalParameter::ViscousFriction | NominalParameter::CoulombForce => {
                self.tolerances.guides
            }
            _ => self.tolerances.presliding,
        }
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
                    stribeck_exponent: guide.stribeck_exponent,
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
                if self.holds_shift && declared == NominalParameter::SensorShift {
                    continue;
                }
                let any = self.any_bristles && NominalParameter::BRISTLES.contains(&declared);
                let limit = if any { ANY_BRISTLES } else { self.tolerance_of(declared) };
                let bounds = if declared.is_factor() { factors(limit) } else { (-limit, limit) };
                coordinates.push(FreeParameter {
                    id: ParameterId::Nominal(declared),
                    value: self.moved(declared),
                    scale: if limit < 1.0 { limit } else { bounds.1 },
                    bounds,
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
                        bounds: factors(limit),
                    });
                }
            }
        }
        for (effect, part) in self.effects.iter().enumerate() {
            // After the cell the motor is not seen, and before it the carriage is not.
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

    /// Gives a parameter a value.
    pub fn set(&mut self, id: ParameterId, value: f64) {
        match id {
            ParameterId::Nominal(declared) => self.moved[declared as usize] = value,
            ParameterId::Spread { parameter, contrast } => self.spread[parameter][contrast] = value,
            ParameterId::Effect { effect, value: index } => {
                self.effects[effect].values[index] = value
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_tolerance_is_refused() {
        let usual = Tolerances::default();
        assert!(usual.check().is_ok());
        assert!(Tolerances { mass: 9.0, guides: 9.0, presliding: 1000.0 }.check().is_ok());
        for wrong in [0.0, -0.1, f64::NAN, f64::INFINITY, 16.0] {
            for (name, tolerances) in [
                ("mass_tolerance", Tolerances { mass: wrong, ..usual }),
                ("guide_tolerance", Tolerances { guides: wrong, ..usual }),
            ] {
                let refused = tolerances.check().unwrap_err().to_string();
                assert!(refused.contains(&format!("{name} is {wrong}")), "{refused}");
                assert!(refused.contains("at most 9"), "{refused}");
            }
        }
        let none = Tolerances { presliding: 0.0, ..usual }.check().unwrap_err().to_string();
        assert!(none.contains("presliding_tolerance is 0, must be above 0"), "{none}");
    }

    #[test]
    fn a_tolerance_is_a_share_below_one_and_a_factor_above() {
        for (tolerance, least, most) in [(0.2, 0.8, 1.2), (3.0, 0.25, 4.0)] {
            for (factor, allowed) in [
                (0.99 * least, false),
                (1.01 * least, true),
                (0.99 * most, true),
                (1.01 * most, false),
            ] {
                assert_eq!(allows(tolerance, 40.0, 40.0 * factor), allowed, "{tolerance} {factor}");
            }
        }
        // A negative mass is none.
        assert!(!allows(3.0, 40.0, -40.0));
    }
}
