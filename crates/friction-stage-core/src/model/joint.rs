//! What kind of joint a stage is, and the units of its quantities.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

/// Joint type, named as in URDF. The equations are the same; what is m, N and kg of a prismatic
/// joint is rad, N m and kg m² of a revolute one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JointType {
    /// It moves along an axis: m, N, kg.
    #[default]
    Prismatic,
    /// It turns about an axis: rad, N m, kg m².
    Revolute,
}

impl JointType {
    /// Name in model and mapping files.
    pub fn name(self) -> &'static str {
        match self {
            JointType::Prismatic => "prismatic",
            JointType::Revolute => "revolute",
        }
    }

    /// The type with a name as in model and mapping files.
    pub fn named(name: &str) -> Option<JointType> {
        [JointType::Prismatic, JointType::Revolute].into_iter().find(|joint| joint.name() == name)
    }

    /// What a quantity of this joint is called, from its name at a prismatic one: `force` becomes
    /// `torque`.
    pub fn quantity(self, prismatic: &str) -> Cow<'_, str> {
        match self {
            JointType::Prismatic => Cow::Borrowed(prismatic),
            JointType::Revolute => Cow::Owned(
                prismatic
                    .replace("position", "angle")
                    .replace("Position", "Angle")
                    .replace("force", "torque")
                    .replace("Force", "Torque")
                    .replace("mass", "moment of inertia"),
            ),
        }
    }

    /// The unit that a quantity of this joint has, from the one of a prismatic joint: `N s/m`
    /// becomes `N m s/rad`. Other units, such as s or Hz, stay.
    pub fn unit(self, prismatic: &str) -> Cow<'_, str> {
        if self == JointType::Prismatic {
            return Cow::Borrowed(prismatic);
        }
        let is_symbol = |c: char| c.is_alphabetic() || c == 'µ';
        let mut unit = String::new();
        let mut rest = prismatic;
        while let Some(first) = rest.chars().next() {
            let end = match is_symbol(first) {
                true => rest.find(|c| !is_symbol(c)).unwrap_or(rest.len()),
                false => first.len_utf8(),
            };
            unit += match &rest[..end] {
                "m" => "rad",
                "mm" => "mrad",
                "µm" => "µrad",
                "nm" => "nrad",
                "N" => "N m",
                "kg" => "kg m²",
                other => other,
            };
            rest = &rest[end..];
        }
        Cow::Owned(unit)
    }

    /// The heading of a column or an axis, from the one of a prismatic joint: `position error, µm`
    /// becomes `angle error, µrad`.
    pub fn heading(self, prismatic: &str) -> String {
        self.unit(&self.quantity(prismatic)).into_owned()
    }

    /// Whether this is what a model has without saying so.
    pub(super) fn is_prismatic(&self) -> bool {
        *self == JointType::Prismatic
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_of_a_revolute_joint() {
        let cases = [
            ("m", "rad"),
            ("N", "N m"),
            ("kg", "kg m²"),
            ("N s/m", "N m s/rad"),
            ("N s²/m²", "N m s²/rad²"),
            ("m/s^2", "rad/s^2"),
            ("1/m", "1/rad"),
            ("s", "s"),
            ("Hz", "Hz"),
            ("1", "1"),
            ("µm", "µrad"),
        ];
        for (prismatic, revolute) in cases {
            assert_eq!(JointType::Revolute.unit(prismatic), revolute);
            assert_eq!(JointType::Prismatic.unit(prismatic), prismatic);
        }
        assert_eq!(JointType::Revolute.heading("Position error, µm"), "Angle error, µrad");
        assert_eq!(JointType::Prismatic.heading("force, N"), "force, N");
    }
}
