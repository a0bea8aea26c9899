//! Effects as a model file gives them: a name with parameters, or an empirical curve.

use std::collections::BTreeMap;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

/// Canonical name of the empirical curve, the one effect that takes a [`Curve`].
const CURVE: &str = "map";

/// An effect by its canonical name with its parameters by name, SI units. The plant's effect of
/// that name knows the bounds.
///
/// In a file: `cogging: {amplitude: 5.0, period: 0.024}`, or
/// `map: {coordinate: position, from: 0.0, to: 0.3, values: [0.1, -0.2]}`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EffectParameters {
    pub name: String,
    pub values: BTreeMap<String, f64>,
    /// Given for `map`, and for nothing else.
    pub curve: Option<Curve>,
}

/// An empirical curve of force along +x, N, over one coordinate: equidistant knots, the first at
/// `from`, the last at `to`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Curve {
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

    pub fn unit(self) -> &'static str {
        match self {
            Coordinate::Position => "m",
            Coordinate::Velocity => "m/s",
            Coordinate::Time => "s",
        }
    }
}

impl EffectParameters {
    /// An effect with these parameters.
    pub fn new<'a>(
        name: &str,
        values: impl IntoIterator<Item = (&'a str, f64)>,
    ) -> EffectParameters {
        let values = values.into_iter().map(|(name, value)| (name.to_owned(), value)).collect();
        EffectParameters { name: name.to_owned(), values, curve: None }
    }

    /// An empirical curve.
    pub fn map(curve: Curve) -> EffectParameters {
        EffectParameters { name: CURVE.to_owned(), values: BTreeMap::new(), curve: Some(curve) }
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
                let effect = if name == CURVE {
                    EffectParameters::map(map.next_value()?)
                } else {
                    EffectParameters { values: map.next_value()?, name, curve: None }
                };
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
        ];
        for (text, expected) in cases {
            let message = StageModel::from_yaml(text, "test.yaml").unwrap_err().to_string();
            for words in *expected {
                assert!(message.contains(words), "{text:?} gave {message:?}, without {words:?}");
            }
        }
    }
}
