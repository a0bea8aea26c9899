//! One recirculating ball guide as a LuGre friction element, and where its parameters come from.

use serde::{Deserialize, Serialize, de};

use super::error::{self, ModelError, nearest};
use super::{Catalogue, JointType};
use crate::numerics::rounded;

/// LuGre parameters of one guide (Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE TAC 40(3), 1995,
/// eqs. 1 to 4).
///
/// dz/dt = v - sigma0 |v| z / g(v), g(v) = Fc + (Fs - Fc) exp(-|v/vs|^n), F = sigma0 z + sigma1
/// dz/dt + sigma2 v. F opposes the motion of the carriage; v is positive along +x.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Guide {
    /// Bristle stiffness sigma0, N/m.
    pub stiffness: f64,
    /// Bristle damping sigma1, N s/m.
    pub bristle_damping: f64,
    /// Viscous friction sigma2, N s/m.
    pub viscous_friction: f64,
    /// Coulomb friction Fc, N: the level at speed, without the viscous part.
    pub coulomb_force: f64,
    /// Static friction Fs, N: the level near zero velocity; not below `coulomb_force`.
    pub static_force: f64,
    /// Stribeck velocity vs, m/s.
    pub stribeck_velocity: f64,
    /// Exponent n of the Stribeck curve, 0.1 to 10. Absent: 2, a Gaussian; 1 is Tustin's curve, and
    /// published fits lie between 0.5 and 2 (Armstrong-Hélouvry, Dupont, Canudas de Wit, Automatica
    /// 30(7), 1994, eq. 3). Declared: a fit does not change it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stribeck_exponent: Option<f64>,
    /// Velocity vd, m/s, above which the bristle damping fades: sigma1 exp(-(v/vd)^2)
    /// (Olsson, PhD thesis, Lund 1996, section 3.4). Absent: sigma1 is constant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damping_velocity: Option<f64>,
}

/// A guide of a model: by name from the catalogue, or with its own parameters.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum GuideSource {
    /// By name from the catalogue.
    Catalogue(String),
    /// With its own parameters.
    Inline(Guide),
    /// With those of its own parameters that are known.
    Partial(PartialGuide),
}

/// What is known of a guide: its Coulomb friction at least. Values for the rest are assumed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PartialGuide {
    /// Coulomb friction Fc, N.
    pub coulomb_force: f64,
    /// Viscous friction sigma2, N s/m; 0 is assumed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub viscous_friction: Option<f64>,
    /// Static friction Fs, N; that of Coulomb is assumed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub static_force: Option<f64>,
    /// Stribeck velocity vs, m/s; 5 mm/s is assumed, or 0.1 rad/s.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stribeck_velocity: Option<f64>,
    /// Bristle stiffness sigma0, N/m; assumed so that the guide breaks away after 30 µm, or 1 mrad.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stiffness: Option<f64>,
    /// Bristle damping sigma1, N s/m; assumed so that the bristles relax within 1 ms.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bristle_damping: Option<f64>,
    /// Exponent n of the Stribeck curve; 2 is assumed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stribeck_exponent: Option<f64>,
    /// Velocity vd, m/s; the Stribeck velocity is assumed where the bristle damping is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub damping_velocity: Option<f64>,
}

impl PartialGuide {
    /// Assumed: deflection at which a guide breaks away, m or rad. Of the guides of the catalogue
    /// it is 6 to 40 µm.
    fn break_away(joint: JointType) -> f64 {
        match joint {
            JointType::Prismatic => 30e-6,
            JointType::Revolute => 1e-3,
        }
    }

    /// Assumed: Stribeck velocity, m/s or rad/s.
    fn usual_stribeck_velocity(joint: JointType) -> f64 {
        match joint {
            JointType::Prismatic => 5e-3,
            JointType::Revolute => 0.1,
        }
    }

    /// Assumed: time in which the bristles relax, sigma1 / sigma0, s.
    const RELAXATION: f64 = 1e-3;

    /// The whole guide.
    pub fn complete(&self, joint: JointType) -> Guide {
        let static_force = self.static_force.unwrap_or(self.coulomb_force);
        let stiffness = self.stiffness.unwrap_or(static_force / Self::break_away(joint));
        let stribeck_velocity =
            self.stribeck_velocity.unwrap_or(Self::usual_stribeck_velocity(joint));
        let fading = self.bristle_damping.is_none().then_some(stribeck_velocity);
        Guide {
            stiffness,
            bristle_damping: self.bristle_damping.unwrap_or(Self::RELAXATION * stiffness),
            viscous_friction: self.viscous_friction.unwrap_or(0.0),
            coulomb_force: self.coulomb_force,
            static_force,
            stribeck_velocity,
            stribeck_exponent: self.stribeck_exponent,
            damping_velocity: self.damping_velocity.or(fading),
        }
    }

    /// The guide, if all that a guide must say is known.
    fn whole(&self) -> Option<Guide> {
        Some(Guide {
            stiffness: self.stiffness?,
            bristle_damping: self.bristle_damping?,
            viscous_friction: self.viscous_friction?,
            coulomb_force: self.coulomb_force,
            static_force: self.static_force?,
            stribeck_velocity: self.stribeck_velocity?,
            stribeck_exponent: self.stribeck_exponent,
            damping_velocity: self.damping_velocity,
        })
    }

    /// What is assumed of the guide, with its values; `key` says where it stands in the model.
    pub(super) fn assumption(&self, key: &str, joint: JointType) -> String {
        let guide = self.complete(joint);
        let values = [
            ("viscous_friction", self.viscous_friction, Some(guide.viscous_friction), "N s/m"),
            ("static_force", self.static_force, Some(guide.static_force), "N"),
            ("stribeck_velocity", self.stribeck_velocity, Some(guide.stribeck_velocity), "m/s"),
            ("stiffness", self.stiffness, Some(guide.stiffness), "N/m"),
            ("bristle_damping", self.bristle_damping, Some(guide.bristle_damping), "N s/m"),
            ("damping_velocity", self.damping_velocity, guide.damping_velocity, "m/s"),
        ];
        let assumed = values.iter().filter(|(_, given, ..)| given.is_none());
        let assumed: Vec<String> = assumed
            .filter_map(|(name, _, value, unit)| {
                Some(format!("{name} {} {}", rounded((*value)?, 4), joint.unit(unit)))
            })
            .collect();
        format!("{key} does not say all of a guide; assumed: {}", assumed.join(", "))
    }
}

impl Guide {
    /// Steady friction level g(v), N, without the viscous part.
    pub fn level(&self, velocity: f64) -> f64 {
        let ratio = velocity / self.stribeck_velocity;
        let power = match self.stribeck_exponent {
            Some(exponent) => ratio.abs().powf(exponent),
            None => ratio * ratio,
        };
        self.coulomb_force + (self.static_force - self.coulomb_force) * (-power).exp()
    }

    /// Friction at constant velocity v, N: g(v) sign(v) + sigma2 v. The Stribeck curve.
    pub fn steady_force(&self, velocity: f64) -> f64 {
        self.level(velocity) * velocity.signum() + self.viscous_friction * velocity
    }

    /// Effective stiffness of a slow symmetric loop of amplitude A, N/m: Fs tanh(sigma0 A / Fs) /
    /// A.
    ///
    /// The bristle of a slow loop obeys dz/dx = 1 - sigma0 z sign(v) / Fs; between reversals at +-A
    /// its tips are at +-(Fs/sigma0) tanh(sigma0 A / Fs). Total force difference over total
    /// position difference, as the paper defines it.
    pub fn effective_stiffness(&self, amplitude: f64) -> f64 {
        self.static_force * (self.stiffness * amplitude / self.static_force).tanh() / amplitude
    }

    /// Area of a slow symmetric loop of amplitude A, J: 4 A Fs - 4 (Fs^2/sigma0) tanh(sigma0 A /
    /// Fs), lost per cycle.
    ///
    /// Twice the integral of the branch F = Fs (1 - c exp(-sigma0 (x + A)/Fs)) that starts at the
    /// tip of [`Guide::effective_stiffness`]. Far from break-away it is 4/3 sigma0^2 A^3 / Fs.
    pub fn loop_area(&self, amplitude: f64) -> f64 {
        let bristle_length = self.static_force / self.stiffness;
        4.0 * self.static_force * (amplitude - bristle_length * (amplitude / bristle_length).tanh())
    }

    /// Refuses impossible values; `key` says where the guide stands in the model.
    pub fn check(&self, key: &str) -> Result<(), ModelError> {
        // First, since what a file does not say of a guide follows from it.
        error::positive(&format!("{key}.coulomb_force"), self.coulomb_force)?;
        error::positive(&format!("{key}.stiffness"), self.stiffness)?;
        error::not_negative(&format!("{key}.bristle_damping"), self.bristle_damping)?;
        error::not_negative(&format!("{key}.viscous_friction"), self.viscous_friction)?;
        error::positive(&format!("{key}.static_force"), self.static_force)?;
        error::positive(&format!("{key}.stribeck_velocity"), self.stribeck_velocity)?;
        if self.static_force < self.coulomb_force {
            let limit = format!("not be below coulomb_force, which is {}", self.coulomb_force);
            return Err(error::refused(&format!("{key}.static_force"), self.static_force, &limit));
        }
        if let Some(exponent) = self.stribeck_exponent
            && !(0.1..=10.0).contains(&exponent)
        {
            let key = format!("{key}.stribeck_exponent");
            return Err(error::refused(&key, exponent, "be between 0.1 and 10"));
        }
        match self.damping_velocity {
            Some(velocity) => error::positive(&format!("{key}.damping_velocity"), velocity),
            None => Ok(()),
        }
    }

    /// The viscous friction above which this guide cannot give out energy, N s/m; none where it
    /// cannot.
    ///
    /// With constant sigma1 the map from velocity to force is passive only if sigma2 > sigma1 (Fs -
    /// Fc) / Fc (Barabanov, Ortega, IEEE TAC 45(4), 2000). A `damping_velocity` removes the
    /// condition's cause.
    pub fn passive_above(&self) -> Option<f64> {
        let needed =
            self.bristle_damping * (self.static_force - self.coulomb_force) / self.coulomb_force;
        let passive = self.damping_velocity.is_some() || self.viscous_friction > needed;
        (!passive && needed > 0.0).then_some(needed)
    }
}

impl GuideSource {
    /// The parameters behind a name, or those given inline; `key` says where it stands in the
    /// model.
    pub fn resolve(
        &self,
        key: &str,
        catalogue: &Catalogue,
        joint: JointType,
    ) -> Result<Guide, ModelError> {
        match self {
            GuideSource::Inline(guide) => Ok(guide.clone()),
            GuideSource::Partial(guide) => Ok(guide.complete(joint)),
            GuideSource::Catalogue(name) => {
                catalogue.guide(name).ok_or_else(|| ModelError::UnknownGuide {
                    key: key.to_owned(),
                    name: name.clone(),
                    hint: nearest(name, catalogue.names()),
                    known: catalogue.names().collect::<Vec<_>>().join(", "),
                })
            }
        }
    }
}

impl<'de> Deserialize<'de> for GuideSource {
    fn deserialize<D: de::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl<'de> de::Visitor<'de> for Visitor {
            type Value = GuideSource;

            fn expecting(&self, formatter: &mut std::fmt::Formatter) -> std::fmt::Result {
                formatter
                    .write_str("the name of a guide in the catalogue, or a map of guide parameters")
            }

            fn visit_str<E: de::Error>(self, name: &str) -> Result<GuideSource, E> {
                Ok(GuideSource::Catalogue(name.to_owned()))
            }

            fn visit_map<A: de::MapAccess<'de>>(self, map: A) -> Result<GuideSource, A::Error> {
                let guide = PartialGuide::deserialize(de::value::MapAccessDeserializer::new(map))?;
                Ok(match guide.whole() {
                    Some(guide) => GuideSource::Inline(guide),
                    None => GuideSource::Partial(guide),
                })
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}
