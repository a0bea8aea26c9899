//! Effects as a model file gives them: a name with parameters, or an empirical curve.

use std::collections::BTreeMap;
use std::marker::PhantomData;

use serde::de::IntoDeserializer;
use serde::de::value::MapDeserializer;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// An effect by its canonical name with its parameters by name, SI units. The plant's effect of
/// that name knows the bounds.
///
/// In a file: `cogging: {amplitude: 5.0, period: 0.024}`, or
/// `map: {coordinate: position, from: 0.0, to: 0.3, values: [0.1, -0.2]}`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EffectParameters {
    /// Canonical name of the effect.
    pub name: String,
    /// By the name of the parameter; what is not here has its default.
    pub values: BTreeMap<String, ParameterValue>,
    /// An empirical curve, in place of values.
    pub curve: Option<Curve>,
}

/// Value of an effect's parameter.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum ParameterValue {
    /// A number in the unit of the parameter.
    Number(f64),
    /// A form of the law by name, such as `form: slider`.
    Name(String),
}

impl ParameterValue {
    /// The number, where it is one.
    pub fn number(&self) -> Option<f64> {
        match self {
            ParameterValue::Number(number) => Some(*number),
            ParameterValue::Name(_) => None,
        }
    }
}

impl From<f64> for ParameterValue {
    fn from(number: f64) -> ParameterValue {
        ParameterValue::Number(number)
    }
}

impl From<&str> for ParameterValue {
    fn from(name: &str) -> ParameterValue {
        ParameterValue::Name(name.to_owned())
    }
}

/// An empirical curve of force along +x, N, over one coordinate: equidistant knots, the first at
/// `from`, the last at `to`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Curve {
    /// What the curve runs over.
    pub coordinate: Coordinate,
    /// Where the force enters.
    #[serde(default, skip_serializing_if = "CurveSide::is_carriage")]
    pub side: CurveSide,
    /// First knot, in the unit of the coordinate.
    pub from: f64,
    /// Last knot, in the unit of the coordinate; above `from`.
    pub to: f64,
    /// Force at the knots, N; two or more.
    pub values: Vec<f64>,
    /// Over the time only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub jump: Option<Jump>,
}

impl Curve {
    /// The knot before a coordinate, and the part of the way from there to the next; the first and
    /// the last one beyond the ends.
    pub fn locate(&self, coordinate: f64) -> (usize, f64) {
        locate(coordinate, self.from, self.to, self.values.len())
    }

    /// Places between which the curve is straight, with the values there: the knots, and both ends
    /// of the jump.
    pub fn corners(&self) -> Vec<(f64, f64)> {
        let step = (self.to - self.from) / (self.values.len().max(2) - 1) as f64;
        let mut corners: Vec<(f64, f64)> = self
            .values
            .iter()
            .enumerate()
            .map(|(knot, value)| (self.from + knot as f64 * step, *value))
            .collect();
        if let Some(Jump { at, height }) = self.jump {
            let before = corners.iter().take_while(|(place, _)| *place < at).count();
            corners[before..].iter_mut().for_each(|(_, value)| *value += height);
            if let (Some(&(from, low)), Some(&(_, high))) =
                (corners[..before].last(), corners.get(before))
            {
                let value = low + (at - from) / step * (high - height - low);
                corners.splice(before..before, [(at, value), (at, value + height)]);
            }
        }
        corners
    }
}

/// As [`Curve::locate`], of so many equidistant knots from the first to the last one.
pub fn locate(coordinate: f64, from: f64, to: f64, knots: usize) -> (usize, f64) {
    let place = ((coordinate - from) / (to - from)).clamp(0.0, 1.0) * (knots - 1) as f64;
    let knot = (place as usize).min(knots - 2);
    (knot, place - knot as f64)
}

/// A place from which on a curve is higher than its knots say: something came loose, or took hold.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Jump {
    /// In the unit of the coordinate.
    pub at: f64,
    /// In the unit of the knots.
    pub height: f64,
}

/// What a curve runs over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Coordinate {
    /// m
    Position,
    /// m/s
    Velocity,
    /// s since the start
    Time,
}

/// What a curve is: a force on one side of the force cell, or a change of friction or mass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CurveSide {
    /// Force on the carriage, N.
    #[default]
    Carriage,
    /// Force of the motor, N.
    Motor,
    /// Change of Coulomb and static friction, as a part of them.
    Friction,
    /// Change of viscous friction, as a part of it.
    Viscous,
    /// Mass that moves with the carriage beyond its own, kg.
    Mass,
}

impl CurveSide {
    /// Whether it is a change of the guides' friction, as a part of it.
    pub fn is_of_friction(self) -> bool {
        matches!(self, CurveSide::Friction | CurveSide::Viscous)
    }

    fn is_carriage(&self) -> bool {
        *self == CurveSide::Carriage
    }

    /// Of the knots: a force, a part of the friction, or a mass.
    pub fn unit(self) -> &'static str {
        match self {
            CurveSide::Carriage | CurveSide::Motor => "N",
            CurveSide::Friction | CurveSide::Viscous => "1",
            CurveSide::Mass => "kg",
        }
    }
}

impl Coordinate {
    /// As in model files.
    pub fn name(self) -> &'static str {
        match self {
            Coordinate::Position => "position",
            Coordinate::Velocity => "velocity",
            Coordinate::Time => "time",
        }
    }

    /// Its unit.
    pub fn unit(self) -> &'static str {
        match self {
            Coordinate::Position => "m",
            Coordinate::Velocity => "m/s",
            Coordinate::Time => "s",
        }
    }
}

impl EffectParameters {
    /// An effect with these numbers.
    pub fn new<'a>(
        name: &str,
        values: impl IntoIterator<Item = (&'a str, f64)>,
    ) -> EffectParameters {
        let values =
            values.into_iter().map(|(name, value)| (name.to_owned(), value.into())).collect();
        EffectParameters { name: name.to_owned(), values, curve: None }
    }

    /// The same with a parameter, a number or the name of a form.
    pub fn with(mut self, parameter: &str, value: impl Into<ParameterValue>) -> EffectParameters {
        self.values.insert(parameter.to_owned(), value.into());
        self
    }

    /// An effect that is this curve.
    pub fn of_curve(name: &str, curve: Curve) -> EffectParameters {
        EffectParameters { name: name.to_owned(), values: BTreeMap::new(), curve: Some(curve) }
    }
}

impl Serialize for EffectParameters {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match &self.curve {
            Some(curve) => serializer.collect_map([(&self.name, curve)]),
            None => serializer.collect_map([(&self.name, &self.values)]),
        }
    }
}

impl<'de> Deserialize<'de> for EffectParameters {
    /// Reads `cogging: {amplitude: 5.0, ...}`: a map with exactly one entry.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl<'de> de::Visitor<'de> for Visitor {
            type Value = EffectParameters;

            fn expecting(&self, formatter: &mut std::fmt::Formatter) -> std::fmt::Result {
                formatter.write_str(
                    "an effect with its parameters, such as `cogging: {amplitude: \
                                     5.0, period: 0.024}`",
                )
            }

            fn visit_map<A: de::MapAccess<'de>>(
                self,
                mut map: A,
            ) -> Result<EffectParameters, A::Error> {
                use de::Error;
                let Some(name) = map.next_key::<String>()? else {
                    return Err(A::Error::custom(
                        "an effect needs a name: `- cogging: {amplitude: 5.0, period: 0.024}`",
                    ));
                };
                let effect = effect_of(name, map.next_value()?)?;
                match map.next_key::<String>()? {
                    None => Ok(effect),
                    Some(second) => Err(A::Error::custom(format!(
                        "one list entry holds one effect, found `{}` and `{second}`: begin each \
                         with a dash",
                        effect.name
                    ))),
                }
            }
        }
        deserializer.deserialize_map(Visitor)
    }
}

/// What a key of an effect may hold in a file.
enum Entry {
    Value(ParameterValue),
    /// Heights of the knots of a curve.
    List(Vec<f64>),
    /// Its jump.
    Group(BTreeMap<String, f64>),
}

/// An effect with what its keys hold. One that has a coordinate, or a list of values, is a curve.
fn effect_of<E: de::Error>(
    name: String,
    entries: BTreeMap<String, Entry>,
) -> Result<EffectParameters, E> {
    if ["coordinate", "values"].iter().any(|key| entries.contains_key(*key)) {
        let curve = Curve::deserialize(MapDeserializer::new(entries.into_iter()))?;
        return Ok(EffectParameters::of_curve(&name, curve));
    }
    let value = |(key, entry): (String, Entry)| match entry {
        Entry::Value(value) => Ok((key, value)),
        Entry::List(_) | Entry::Group(_) => {
            Err(E::custom(format!("`{name}.{key}` must be a number or a name")))
        }
    };
    let values = entries.into_iter().map(value).collect::<Result<_, E>>()?;
    Ok(EffectParameters { name, values, curve: None })
}

impl<'de> Deserialize<'de> for Entry {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Entry, D::Error> {
        struct Visitor;
        impl<'de> de::Visitor<'de> for Visitor {
            type Value = Entry;

            fn expecting(&self, formatter: &mut std::fmt::Formatter) -> std::fmt::Result {
                formatter.write_str("a number, or the name of a form")
            }

            fn visit_f64<E: de::Error>(self, number: f64) -> Result<Entry, E> {
                Ok(Entry::Value(ParameterValue::Number(number)))
            }

            fn visit_i64<E: de::Error>(self, number: i64) -> Result<Entry, E> {
                self.visit_f64(number as f64)
            }

            fn visit_u64<E: de::Error>(self, number: u64) -> Result<Entry, E> {
                self.visit_f64(number as f64)
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<Entry, E> {
                Ok(Entry::Value(match text.parse() {
                    Ok(number) => ParameterValue::Number(number),
                    Err(_) => ParameterValue::Name(text.to_owned()),
                }))
            }

            fn visit_seq<A: de::SeqAccess<'de>>(self, list: A) -> Result<Entry, A::Error> {
                Vec::deserialize(de::value::SeqAccessDeserializer::new(list)).map(Entry::List)
            }

            fn visit_map<A: de::MapAccess<'de>>(self, group: A) -> Result<Entry, A::Error> {
                BTreeMap::deserialize(de::value::MapAccessDeserializer::new(group))
                    .map(Entry::Group)
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}

impl<'de, E: de::Error> IntoDeserializer<'de, E> for Entry {
    type Deserializer = EntryDeserializer<E>;

    fn into_deserializer(self) -> EntryDeserializer<E> {
        EntryDeserializer { entry: self, error: PhantomData }
    }
}

/// Gives an entry to the parts of a curve.
struct EntryDeserializer<E> {
    entry: Entry,
    error: PhantomData<E>,
}

impl<'de, E: de::Error> Deserializer<'de> for EntryDeserializer<E> {
    type Error = E;

    fn deserialize_any<V: de::Visitor<'de>>(self, visitor: V) -> Result<V::Value, E> {
        match self.entry {
            Entry::Value(ParameterValue::Number(number)) => visitor.visit_f64(number),
            Entry::Value(ParameterValue::Name(name)) => visitor.visit_string(name),
            Entry::List(list) => list.into_deserializer().deserialize_any(visitor),
            Entry::Group(group) => group.into_deserializer().deserialize_any(visitor),
        }
    }

    fn deserialize_option<V: de::Visitor<'de>>(self, visitor: V) -> Result<V::Value, E> {
        visitor.visit_some(self)
    }

    fn deserialize_enum<V: de::Visitor<'de>>(
        self,
        name: &'static str,
        variants: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value, E> {
        match self.entry {
            Entry::Value(ParameterValue::Name(variant)) => {
                variant.into_deserializer().deserialize_enum(name, variants, visitor)
            }
            _ => self.deserialize_any(visitor),
        }
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf unit
        unit_struct newtype_struct seq tuple tuple_struct map struct identifier ignored_any
    }
}

#[cfg(test)]
mod tests {
    use super::super::StageModel;
    use super::*;

    #[test]
    fn a_map_survives_a_round_trip_beside_other_effects() {
        let curve = Curve {
            coordinate: Coordinate::Velocity,
            side: CurveSide::Motor,
            from: -0.5,
            to: 0.1 + 0.2,
            values: vec![1.0, -0.25, 1.0 / 3.0],
            jump: None,
        };
        let falls = Curve {
            coordinate: Coordinate::Time,
            jump: Some(Jump { at: 7.5, height: -0.1 - 0.2 }),
            ..curve.clone()
        };
        let mut model = StageModel::default();
        model.effects.push(EffectParameters::map(curve.clone()));
        model.effects.push(EffectParameters::new("cogging", [("amplitude", 6.0)]));
        model.effects.push(EffectParameters::map(Curve { side: CurveSide::Carriage, ..curve }));
        model.effects.push(EffectParameters::map(falls));
        let text = model.to_yaml().unwrap();
        assert_eq!(StageModel::from_yaml(&text, "round trip").unwrap(), model, "{text}");
    }

    #[test]
    fn a_curve_has_corners_at_its_knots_and_both_ends_of_its_jump() {
        let curve = |at| Curve {
            coordinate: Coordinate::Time,
            side: CurveSide::Carriage,
            from: 1.0,
            to: 3.0,
            values: vec![1.0, 3.0, 4.0],
            jump: Some(Jump { at, height: -5.0 }),
        };
        assert_eq!(
            curve(1.5).corners(),
            [(1.0, 1.0), (1.5, 2.0), (1.5, -3.0), (2.0, -2.0), (3.0, -1.0)]
        );
        assert_eq!(curve(0.5).corners(), [(1.0, -4.0), (2.0, -2.0), (3.0, -1.0)]);
        assert_eq!(curve(3.5).corners(), [(1.0, 1.0), (2.0, 3.0), (3.0, 4.0)]);
        assert_eq!(Curve { values: vec![], ..curve(1.5) }.corners(), []);
    }

    #[test]
    fn a_form_is_given_by_name_or_by_the_number_of_older_files() {
        let read = |form: &str| {
            let text = format!("effects: [{{cable_chain: {{stiffness: 2e1, form: {form}}}}}]");
            StageModel::from_yaml(&text, "test.yaml").unwrap().effects.remove(0).values
        };
        assert_eq!(read("slider")["form"], "slider".into());
        assert_eq!(read("2")["form"], 2.0.into());
        assert_eq!(read("slider")["stiffness"], 20.0.into());
    }

    #[test]
    fn a_wrong_key_of_a_map_is_named() {
        let cases: &[(&str, &[&str])] = &[
            (
                "effects: [{map: {coordinat: position, from: 0, to: 1, values: [1, 2]}}]",
                &["coordinat", "did you mean `coordinate`"],
            ),
            (
                "effects: [{map: {coordinate: positon, from: 0, to: 1, values: [1, 2]}}]",
                &["positon", "did you mean `position`"],
            ),
            ("effects: [{map: {coordinate: position, from: 0, to: 1}}]", &["values"]),
            ("effects: [{cogging: {amplitude: [1, 2]}}]", &["cogging.amplitude", "number"]),
        ];
        for (text, expected) in cases {
            let message = StageModel::from_yaml(text, "test.yaml").unwrap_err().to_string();
            for words in *expected {
                assert!(message.contains(words), "{text:?} gave {message:?}, without {words:?}");
            }
        }
    }
}
