//! What the rest of the program knows of an effect without building it: name, role, parameters with
//! bounds, how its values are guessed, and what a fit may do with them.

use std::collections::BTreeMap;

use crate::model::{Curve, EffectParameters, ModelError, ParameterValue, nearest};

use super::{ALL, Action, Residual, Role};

/// Everything the rest of the program knows of an effect.
#[derive(Debug)]
pub struct EffectDescriptor {
    /// Canonical name, as in model files and in summaries.
    pub name: &'static str,
    /// What it acts on; see [`EffectDescriptor::role_of`] for an effect that its values give
    /// another role.
    pub role: Role,
    /// The law in one line.
    pub law: &'static str,
    /// Where the law comes from.
    pub source: &'static str,
    /// What gives the effect away in a residual.
    pub telltale: &'static str,
    /// In the order of all slices of values. Of a curve the heights of its knots follow.
    pub parameters: &'static [EffectParameter],
    /// How many effects of this law one stage may have.
    pub multiplicity: Multiplicity,
    /// What each recording has for itself, whatever the values say.
    pub record_specific: RecordSpecific,
    /// Values of a typical size, in the order of `parameters`; none for a curve, which has no
    /// typical shape.
    pub typical: &'static [f64],
    /// Refuses values within their bounds that do not go together.
    pub(crate) check: fn(&[f64]) -> Result<(), ModelError>,
    /// Whether a fit that starts at these values may change the value of this index: some choose
    /// between forms of a law.
    pub free: fn(&[f64], usize) -> bool,
    /// Builds the effect from checked values, in the order of `parameters`.
    pub(crate) build: fn(&[f64]) -> Action,
    /// Guesses values from a residual, for a joint refit to start from; it gives `None` where the
    /// residual shows nothing of this kind. `None` for what a search over laws does not add.
    pub proposal: Option<Proposal>,
    /// From a proposal and the time between samples, s, the values that fits start from: one for
    /// each form of a law that has several, and for each place that a fit does not leave by itself.
    pub starts: fn(&[f64], f64) -> Vec<Vec<f64>>,
    /// For an effect that is an empirical curve: how the curve stands in its values.
    pub curve: Option<CurveValues>,
}

/// Guesses values from a residual.
pub type Proposal = fn(&Residual) -> Option<Vec<f64>>;

/// A parameter of an effect.
#[derive(Clone, Copy, Debug)]
pub struct EffectParameter {
    /// Name in model files and summaries.
    pub name: &'static str,
    /// Unit, `1` for a plain number.
    pub unit: &'static str,
    /// What it is, in a few words.
    pub description: &'static str,
    /// Smallest and largest possible value.
    pub bounds: (f64, f64),
    /// Value where the model does not give one; `None` makes it obligatory.
    pub default: Option<f64>,
    /// Typical size of the value or of its changes, in its unit, greater than 0: scales a fit.
    pub scale: f64,
    /// What kind of quantity it is.
    pub kind: ParameterKind,
}

/// Kinds of parameters that others than the effect itself have to know.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterKind {
    /// Peak of what is added, in the unit of that.
    Amplitude,
    /// Distance after which a force or a reading error repeats, m.
    Period,
    /// Frequency over time, Hz.
    Frequency,
    /// Phase of a sinusoid where its coordinate is 0, rad.
    Phase,
    /// Random walk of a phase with the distance travelled, rad/sqrt(m); 0 where there is none.
    PhaseWalk,
    /// Instant at which something changes, s.
    Instant,
    /// Time by which something comes late as a whole, s.
    Delay,
    /// One of several forms of the law, by name; its value is the place in this list.
    Choice(&'static [&'static str]),
    /// Anything else.
    Other,
}

/// How many effects of one law a stage may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Multiplicity {
    /// One, in which everything of this kind adds up.
    One,
    /// Several: harmonics of a period, lines of a spectrum.
    Several,
    /// Several, of which each may stand for one guide: their periods differ by little.
    OnePerGuide,
}

/// What each recording has for itself of an effect.
#[derive(Clone, Copy, Debug)]
pub enum RecordSpecific {
    /// Nothing: the law says everything.
    Nothing,
    /// The phase, which counts from the start of the recording.
    Phase,
    /// For some values the phase and amplitude of a ripple all along the way: then the law gives
    /// the ripple, and each recording what it is.
    Ripple(fn(&[f64]) -> Option<SlippingRipple>),
}

/// A ripple over the position whose amplitude and phase change with the distance travelled,
/// differently in each recording.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SlippingRipple {
    /// Distance after which it repeats, m.
    pub period: f64,
    /// Distance over which amplitude and phase change little, m.
    pub piece: f64,
}

/// How an empirical curve stands in a slice of values.
#[derive(Clone, Copy, Debug)]
pub struct CurveValues {
    /// The curve of these values.
    pub curve: fn(&[f64]) -> Curve,
    /// The values of a curve: the inverse.
    pub values: fn(&Curve) -> Vec<f64>,
    /// Places in the values of the heights that make the curve: that of its jump, where there is
    /// one, and those of its knots.
    pub heights: fn(&[f64]) -> Vec<usize>,
    /// The role of a curve of these values.
    pub role: fn(&[f64]) -> Role,
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
        let kind = ParameterKind::Other;
        EffectParameter { name, unit, description, bounds, default: None, scale, kind }
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
        let kind = ParameterKind::Other;
        EffectParameter { name, unit, description, bounds, default: Some(default), scale, kind }
    }

    /// A choice between forms of a law by name, the first of them where a model gives none.
    pub(super) const fn choice(
        name: &'static str,
        description: &'static str,
        names: &'static [&'static str],
    ) -> EffectParameter {
        EffectParameter {
            name,
            unit: "1",
            description,
            bounds: (0.0, (names.len() - 1) as f64),
            default: Some(0.0),
            scale: 1.0,
            kind: ParameterKind::Choice(names),
        }
    }

    /// A value as a model gives it: of a form its name.
    fn as_given(&self, value: f64) -> ParameterValue {
        match self.kind {
            ParameterKind::Choice(names) => {
                names.get(value.round() as usize).map_or(value.into(), |name| (*name).into())
            }
            _ => value.into(),
        }
    }

    /// The same of this kind.
    pub(super) const fn of_kind(self, kind: ParameterKind) -> EffectParameter {
        EffectParameter { kind, ..self }
    }
}

impl EffectDescriptor {
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

    /// The descriptor of an effect of a model, with its values, checked.
    pub fn read(
        given: &EffectParameters,
    ) -> Result<(&'static EffectDescriptor, Vec<f64>), ModelError> {
        let descriptor = EffectDescriptor::find(&given.name)?;
        Ok((descriptor, descriptor.values_of(given)?))
    }

    /// What an effect of these values acts on.
    pub fn role_of(&self, values: &[f64]) -> Role {
        self.curve.map_or(self.role, |curve| (curve.role)(values))
    }

    /// The empirical curve that these values are; `None` of a law.
    pub fn curve_of(&self, values: &[f64]) -> Option<Curve> {
        self.curve.map(|curve| (curve.curve)(values))
    }

    /// Whether it is an empirical curve, and no law.
    pub fn is_curve(&self) -> bool {
        self.curve.is_some()
    }

    /// Whether a stage may have several effects of this law.
    pub fn may_repeat(&self) -> bool {
        self.multiplicity != Multiplicity::One
    }

    /// Guesses values from a residual; `None` where it shows nothing of this kind, or a search does
    /// not add the effect.
    pub fn propose(&self, residual: &Residual) -> Option<Vec<f64>> {
        self.proposal.and_then(|proposal| proposal(residual))
    }

    /// The ripple of which each recording has its own amplitude and phase, for these values.
    pub fn slipping_ripple(&self, values: &[f64]) -> Option<SlippingRipple> {
        match self.record_specific {
            RecordSpecific::Ripple(ripple) => ripple(values),
            RecordSpecific::Nothing | RecordSpecific::Phase => None,
        }
    }

    /// Mass that an effect of these values always adds to the carriage, kg; 0 where it has another
    /// role.
    pub fn constant_mass(&self, values: &[f64]) -> f64 {
        match self.role {
            Role::Mass => match (self.build)(values) {
                Action::Mass(mass) => mass,
                _ => 0.0,
            },
            _ => 0.0,
        }
    }

    /// Place of the first parameter of a kind in slices of values.
    pub fn place_of(&self, kind: ParameterKind) -> Option<usize> {
        self.parameters.iter().position(|parameter| parameter.kind == kind)
    }

    /// Whether a value has a part in the form of the law that these values choose.
    pub fn takes_part(&self, values: &[f64], index: usize) -> bool {
        let always = self.parameters.get(index).is_some_and(|parameter| match parameter.kind {
            ParameterKind::Choice(_) => true,
            ParameterKind::PhaseWalk => values[index] > 0.0,
            // What a model has to give.
            _ => parameter.default.is_none(),
        });
        self.is_curve() || always || (self.free)(values, index)
    }

    /// Values of an effect of a model, in the order of `parameters`, checked. Of a curve its
    /// coordinate and side, the first and last knot, height and place of its jump (0 where there is
    /// none), then the heights of its knots.
    pub fn values_of(&self, given: &EffectParameters) -> Result<Vec<f64>, ModelError> {
        let values = match (&given.curve, self.curve) {
            (Some(curve), Some(of_curve)) => (of_curve.values)(curve),
            (Some(_), None) => return Err(self.unknown("coordinate")),
            (None, _) => self.values(&given.values)?,
        };
        (self.check)(&values)?;
        Ok(values)
    }

    /// The effect of a model that has these values: the inverse of [`EffectDescriptor::values_of`].
    pub fn parameters_of(&self, values: &[f64]) -> EffectParameters {
        if let Some(curve) = self.curve_of(values) {
            return EffectParameters::of_curve(self.name, curve);
        }
        self.parameters
            .iter()
            .zip(values)
            .fold(EffectParameters::new(self.name, []), |given, (parameter, value)| {
                given.with(parameter.name, parameter.as_given(*value))
            })
    }

    /// Values in the order of `parameters`: defaults filled in, unknown names, missing and
    /// impossible values refused.
    fn values(&self, given: &BTreeMap<String, ParameterValue>) -> Result<Vec<f64>, ModelError> {
        let is_known = |name: &str| self.parameters.iter().any(|one| one.name == name);
        if let Some(unknown) = given.keys().find(|name| !is_known(name)) {
            return Err(self.unknown(unknown));
        }
        let value = |parameter: &EffectParameter| {
            let value = given.get(parameter.name).map(|given| self.number(parameter, given));
            self.checked(parameter, value.transpose()?.or(parameter.default))
        };
        self.parameters.iter().map(value).collect()
    }

    fn unknown(&self, name: &str) -> ModelError {
        let names = || self.parameters.iter().map(|parameter| parameter.name);
        ModelError::UnknownEffectParameter {
            effect: self.name,
            name: name.to_owned(),
            hint: nearest(name, names()),
            known: names().collect::<Vec<_>>().join(", "),
        }
    }

    /// The number that stands for what a model gives.
    fn number(
        &self,
        parameter: &EffectParameter,
        given: &ParameterValue,
    ) -> Result<f64, ModelError> {
        let key = || format!("effects.{}.{}", self.name, parameter.name);
        match (given, parameter.kind) {
            (ParameterValue::Number(number), _) => Ok(*number),
            (ParameterValue::Name(name), ParameterKind::Choice(names)) => {
                let place = names.iter().position(|known| known == name);
                place.map(|place| place as f64).ok_or_else(|| ModelError::UnknownForm {
                    key: key(),
                    name: name.clone(),
                    hint: format!(
                        "{}; it takes {}",
                        nearest(name, names.iter().copied()),
                        names.join(", ")
                    ),
                })
            }
            (ParameterValue::Name(text), _) => {
                let (text, unit) = (text.clone(), parameter.unit);
                Err(ModelError::NotANumber { key: key(), text, unit })
            }
        }
    }

    /// Refuses values, in the order of `parameters`, that a model could not have.
    pub fn check_values(&self, values: &[f64]) -> Result<(), ModelError> {
        if !self.is_curve() {
            for (index, parameter) in self.parameters.iter().enumerate() {
                self.checked(parameter, values.get(index).copied())?;
            }
        }
        (self.check)(values)
    }

    /// A value of a parameter, refused where it is missing or out of bounds.
    fn checked(&self, parameter: &EffectParameter, value: Option<f64>) -> Result<f64, ModelError> {
        let value = value.ok_or(ModelError::MissingEffectParameter {
            effect: self.name,
            name: parameter.name,
            description: parameter.description,
            unit: parameter.unit,
        })?;
        let (min, max) = parameter.bounds;
        if (min..=max).contains(&value) {
            return Ok(value);
        }
        let (key, unit) = (format!("effects.{}.{}", self.name, parameter.name), parameter.unit);
        Err(ModelError::Value { key, value, limit: format!("be between {min} and {max} {unit}") })
    }
}

/// Every value set within its bounds is possible.
pub(super) fn any(_values: &[f64]) -> Result<(), ModelError> {
    Ok(())
}

/// A law of one form: what is proposed is where a fit starts.
pub(super) fn as_proposed(values: &[f64], _step: f64) -> Vec<Vec<f64>> {
    vec![values.to_vec()]
}

/// What is proposed, in each of `count` forms that the value at `form` numbers from 0.
pub(super) fn every_form(values: &[f64], form: usize, count: u8) -> Vec<Vec<f64>> {
    let of_form = |code| {
        let mut start = values.to_vec();
        start[form] = f64::from(code);
        start
    };
    (0..count).map(of_form).collect()
}

/// A fit may change every value.
pub(super) fn all_free(_values: &[f64], _index: usize) -> bool {
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Coordinate, CurveSide};

    #[test]
    fn every_law_has_typical_values_that_are_possible() {
        for effect in ALL.iter().filter(|effect| !effect.is_curve()) {
            assert_eq!(effect.typical.len(), effect.parameters.len(), "{}", effect.name);
            effect.check_values(effect.typical).unwrap();
            let given = effect.parameters_of(effect.typical);
            assert_eq!(effect.values_of(&given).unwrap(), effect.typical, "{}", effect.name);
        }
        let mut law = ALL.iter().filter(|effect| {
            effect.parameters.iter().any(|one| matches!(one.kind, ParameterKind::Choice(_)))
        });
        let law = law.find(|effect| !effect.is_curve()).unwrap();
        let with = |form: &str| law.values_of(&law.parameters_of(law.typical).with("form", form));
        let ParameterKind::Choice(names) =
            law.parameters.iter().find(|one| one.name == "form").unwrap().kind
        else {
            panic!("{}: a form without names", law.name)
        };
        for (number, name) in names.iter().enumerate() {
            let values = with(name).unwrap();
            assert!(values.contains(&(number as f64)), "{name}: {values:?}");
        }
        let wrong = with(&names[1][1..]).unwrap_err().to_string();
        assert!(wrong.contains(names[0]) && wrong.contains("did you mean"), "{wrong}");
        let short = ALL[0].check_values(&[]).unwrap_err().to_string();
        assert!(short.contains("missing") && short.contains(ALL[0].parameters[0].name), "{short}");
    }

    /// All laws, and a curve of each side.
    #[test]
    fn an_effect_is_built_for_the_role_that_its_descriptor_says() {
        let sides = [
            CurveSide::Carriage,
            CurveSide::Motor,
            CurveSide::Friction,
            CurveSide::Viscous,
            CurveSide::Mass,
        ];
        let curve = |side| Curve {
            coordinate: Coordinate::Time,
            side,
            from: 0.0,
            to: 1.0,
            values: vec![0.0, 0.1],
            jump: None,
        };
        for effect in ALL {
            let all = match effect.curve {
                Some(of) => sides.map(|side| (of.values)(&curve(side))).to_vec(),
                None => vec![effect.typical.to_vec()],
            };
            for values in all {
                let (role, action) = (effect.role_of(&values), (effect.build)(&values));
                let agree = matches!(
                    (role, &action),
                    (Role::Command(_), Action::Command(_))
                        | (Role::MotorForce, Action::MotorForce(_))
                        | (Role::CarriageForce, Action::CarriageForce(_))
                        | (Role::Friction(_), Action::Friction(_))
                        | (Role::Bristles, Action::Bristles(_))
                        | (Role::Mass, Action::Mass(_))
                        | (Role::VaryingMass, Action::VaryingMass(_))
                        | (Role::Encoder, Action::Encoder(_) | Action::Compliance(_))
                        | (Role::ForceCell, Action::ForceCell(_))
                );
                assert!(agree, "{}: {role:?}, {action:?}", effect.name);
            }
        }
    }

    /// What a descriptor does not say stays as it is over a step of sliding.
    #[test]
    fn a_law_of_friction_scales_what_its_descriptor_says_and_nothing_else() {
        use super::super::{Effects, Motion};
        for effect in ALL.iter().filter(|effect| !effect.is_curve()) {
            let mut effects = Effects::from_values([(*effect, effect.typical)]).unwrap();
            let terms = effect.role.friction_terms();
            let mut changed = (false, false);
            for k in 0..200 {
                let (time, position) = (0.05 * f64::from(k), 1e-3 * f64::from(k));
                let motion = Motion {
                    time,
                    position,
                    velocity: 0.02,
                    motor_force: 9.0,
                    ..Motion::default()
                };
                let scale = effects.friction(&Motion { friction: 5.0, ..motion }, 0.05);
                changed.0 |= (scale.coulomb, scale.stat) != (1.0, 1.0);
                changed.0 |= scale.stribeck_speed.is_some();
                changed.1 |= scale.viscous != 1.0;
            }
            assert_eq!(changed, (terms.bristles, terms.viscous), "{}", effect.name);
        }
    }
}
