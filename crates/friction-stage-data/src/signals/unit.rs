//! Units with their dimensions: what a mapping or a file may say of a signal.
//!
//! A unit is a size in SI and a dimension. A signal has the dimension that its joint type gives it,
//! a length or an angle, a force or a torque; a value in another dimension (motor turns of a
//! spindle, a current, a share of a rated torque) becomes one by a `scale` that the mapping must
//! give.

use friction_stage_core::model::JointType;

use super::mapping::Signal;

/// What a unit measures.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dimension {
    /// s.
    Time,
    /// m.
    Length,
    /// rad.
    Angle,
    /// m/s.
    Speed,
    /// rad/s.
    AngularSpeed,
    /// m/s².
    Acceleration,
    /// rad/s².
    AngularAcceleration,
    /// N.
    Force,
    /// N m.
    Torque,
    /// A.
    Current,
    /// V.
    Voltage,
    /// 1: counts, and shares of a rated value.
    Number,
}

impl Dimension {
    /// Its SI unit.
    pub fn si(self) -> &'static str {
        UNITS.iter().find(|(.., of)| *of == self).map_or("", |(name, ..)| name)
    }
}

/// Length and angle of one turn, of a degree and of an inch, and the weight of a pound and of a
/// kilogram.
const TURN: f64 = std::f64::consts::TAU;
const DEGREE: f64 = TURN / 360.0;
const INCH: f64 = 0.0254;
const POUND: f64 = 4.448_221_615_260_5;
const KILOGRAM: f64 = 9.80665;

/// Names, size in SI, dimension. The first name of a dimension is its SI unit.
const UNITS: &[(&str, f64, Dimension)] = &[
    ("s", 1.0, Dimension::Time),
    ("ms", 1e-3, Dimension::Time),
    ("us", 1e-6, Dimension::Time),
    ("ns", 1e-9, Dimension::Time),
    ("min", 60.0, Dimension::Time),
    ("h", 3600.0, Dimension::Time),
    ("d", 86_400.0, Dimension::Time),
    ("m", 1.0, Dimension::Length),
    ("cm", 1e-2, Dimension::Length),
    ("mm", 1e-3, Dimension::Length),
    ("um", 1e-6, Dimension::Length),
    ("nm", 1e-9, Dimension::Length),
    ("in", INCH, Dimension::Length),
    ("rad", 1.0, Dimension::Angle),
    ("mrad", 1e-3, Dimension::Angle),
    ("urad", 1e-6, Dimension::Angle),
    ("deg", DEGREE, Dimension::Angle),
    ("arcmin", DEGREE / 60.0, Dimension::Angle),
    ("arcsec", DEGREE / 3600.0, Dimension::Angle),
    ("rev", TURN, Dimension::Angle),
    ("m/s", 1.0, Dimension::Speed),
    ("mm/s", 1e-3, Dimension::Speed),
    ("um/s", 1e-6, Dimension::Speed),
    ("cm/s", 1e-2, Dimension::Speed),
    ("km/h", 1.0 / 3.6, Dimension::Speed),
    ("mm/min", 1e-3 / 60.0, Dimension::Speed),
    ("m/min", 1.0 / 60.0, Dimension::Speed),
    ("in/s", INCH, Dimension::Speed),
    ("rad/s", 1.0, Dimension::AngularSpeed),
    ("deg/s", DEGREE, Dimension::AngularSpeed),
    ("rev/s", TURN, Dimension::AngularSpeed),
    ("rev/min", TURN / 60.0, Dimension::AngularSpeed),
    ("rpm", TURN / 60.0, Dimension::AngularSpeed),
    ("m/s^2", 1.0, Dimension::Acceleration),
    ("mm/s^2", 1e-3, Dimension::Acceleration),
    ("um/s^2", 1e-6, Dimension::Acceleration),
    ("g", KILOGRAM, Dimension::Acceleration),
    ("rad/s^2", 1.0, Dimension::AngularAcceleration),
    ("deg/s^2", DEGREE, Dimension::AngularAcceleration),
    ("rev/s^2", TURN, Dimension::AngularAcceleration),
    ("N", 1.0, Dimension::Force),
    ("mN", 1e-3, Dimension::Force),
    ("kN", 1e3, Dimension::Force),
    ("MN", 1e6, Dimension::Force),
    ("daN", 10.0, Dimension::Force),
    ("dN", 0.1, Dimension::Force),
    ("cN", 1e-2, Dimension::Force),
    ("lbf", POUND, Dimension::Force),
    ("kgf", KILOGRAM, Dimension::Force),
    ("N m", 1.0, Dimension::Torque),
    ("mN m", 1e-3, Dimension::Torque),
    ("uN m", 1e-6, Dimension::Torque),
    ("kN m", 1e3, Dimension::Torque),
    ("N cm", 1e-2, Dimension::Torque),
    ("lbf in", POUND * INCH, Dimension::Torque),
    ("lbf ft", POUND * 12.0 * INCH, Dimension::Torque),
    ("ozf in", POUND * INCH / 16.0, Dimension::Torque),
    ("A", 1.0, Dimension::Current),
    ("mA", 1e-3, Dimension::Current),
    ("V", 1.0, Dimension::Voltage),
    ("mV", 1e-3, Dimension::Voltage),
    ("count", 1.0, Dimension::Number),
    ("%", 1e-2, Dimension::Number),
    ("permille", 1e-3, Dimension::Number),
    ("1", 1.0, Dimension::Number),
];

/// Other spellings, as drives and loggers write them.
const SPELLINGS: &[(&str, &str)] = &[
    ("\u{b0}", "deg"),
    ("degree", "deg"),
    ("degrees", "deg"),
    ("\u{b0}/s", "deg/s"),
    ("dps", "deg/s"),
    ("mm/sec", "mm/s"),
    ("m/sec", "m/s"),
    ("r/min", "rpm"),
    ("1/min", "rpm"),
    ("min-1", "rpm"),
    ("min^-1", "rpm"),
    ("U/min", "rpm"),
    ("rps", "rev/s"),
    ("revs", "rev"),
    ("turn", "rev"),
    ("turns", "rev"),
    ("counts", "count"),
    ("cnt", "count"),
    ("cts", "count"),
    ("inc", "count"),
    ("incr", "count"),
    ("pulse", "count"),
    ("pulses", "count"),
    ("Nm", "N m"),
    ("mNm", "mN m"),
    ("uNm", "uN m"),
    ("kNm", "kN m"),
    ("Ncm", "N cm"),
    ("lb-in", "lbf in"),
    ("lbf-in", "lbf in"),
    ("in-lb", "lbf in"),
    ("lb-ft", "lbf ft"),
    ("ft-lb", "lbf ft"),
    ("oz-in", "ozf in"),
    ("ozin", "ozf in"),
    ("sec", "s"),
    ("secs", "s"),
    ("second", "s"),
    ("seconds", "s"),
    ("msec", "ms"),
    ("usec", "us"),
    ("Amps", "A"),
    ("Amp", "A"),
    ("Arms", "A"),
    ("A rms", "A"),
    ("percent", "%"),
    ("inch", "in"),
    ("micron", "um"),
    ("microns", "um"),
    ("lbs", "lbf"),
    ("kp", "kgf"),
];

/// Units in words, in small letters and of one; a word may be one of several, or cut short.
const IN_WORDS: &[(&str, &str)] = &[
    ("meter", "m"),
    ("metre", "m"),
    ("centimeter", "cm"),
    ("centimetre", "cm"),
    ("millimeter", "mm"),
    ("millimetre", "mm"),
    ("micrometer", "um"),
    ("micrometre", "um"),
    ("nanometer", "nm"),
    ("nanometre", "nm"),
    ("sec", "s"),
    ("millisecond", "ms"),
    ("microsecond", "us"),
    ("nanosecond", "ns"),
    ("nsec", "ns"),
    ("minute", "min"),
    ("hour", "h"),
    ("radian", "rad"),
    ("revolution", "rev"),
    ("newton", "N"),
    ("millinewton", "mN"),
    ("kilonewton", "kN"),
    ("newton meter", "N m"),
    ("newton metre", "N m"),
    ("pound", "lbf"),
    ("ampere", "A"),
    ("milliampere", "mA"),
    ("volt", "V"),
];

/// A unit that is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unit {
    /// As mappings write it.
    pub name: &'static str,
    /// Size in SI.
    pub size: f64,
    /// What it measures.
    pub dimension: Dimension,
}

impl Unit {
    /// By a name as a mapping or a file gives it.
    pub fn named(name: &str) -> Option<Unit> {
        let plain =
            name.trim().replace(['µ', 'μ'], "u").replace('²', "^2").replace(['·', '*'], " ");
        let spelled = SPELLINGS.iter().find(|(other, _)| *other == plain);
        let word = plain.to_lowercase();
        let word = word.trim_end_matches('.');
        let word = word.strip_suffix('s').unwrap_or(word);
        let in_words = IN_WORDS.iter().find(|(known, _)| *known == word);
        let plain = spelled.or(in_words).map_or(plain.as_str(), |(_, name)| *name);
        let (name, size, dimension) = UNITS.iter().find(|(name, ..)| *name == plain)?;
        Some(Unit { name, size: *size, dimension: *dimension })
    }

    /// The joint type that it speaks of, if of one.
    pub fn joint(self) -> Option<JointType> {
        match self.dimension {
            Dimension::Length | Dimension::Speed | Dimension::Acceleration | Dimension::Force => {
                Some(JointType::Prismatic)
            }
            Dimension::Angle
            | Dimension::AngularSpeed
            | Dimension::AngularAcceleration
            | Dimension::Torque => Some(JointType::Revolute),
            _ => None,
        }
    }
}

impl Signal {
    /// What it measures on a joint.
    pub fn dimension(self, joint: JointType) -> Dimension {
        let (prismatic, revolute) = match self {
            Self::Time => (Dimension::Time, Dimension::Time),
            Self::ReferencePosition | Self::Position => (Dimension::Length, Dimension::Angle),
            Self::ReferenceVelocity | Self::Velocity => (Dimension::Speed, Dimension::AngularSpeed),
            Self::ReferenceAcceleration => {
                (Dimension::Acceleration, Dimension::AngularAcceleration)
            }
            Self::ForceCell | Self::Force => (Dimension::Force, Dimension::Torque),
        };
        match joint {
            JointType::Prismatic => prismatic,
            JointType::Revolute => revolute,
        }
    }

    /// Its SI unit on a joint.
    pub fn si_unit(self, joint: JointType) -> &'static str {
        self.dimension(joint).si()
    }

    /// Whether a unit is one of this signal, of whatever joint.
    pub(super) fn has_dimension(self, dimension: Dimension) -> bool {
        [JointType::Prismatic, JointType::Revolute]
            .into_iter()
            .any(|joint| self.dimension(joint) == dimension)
    }

    /// Names of the units that it may have on any joint.
    pub(super) fn unit_names(self) -> String {
        let fits = UNITS.iter().filter(|(.., dimension)| self.has_dimension(*dimension));
        fits.map(|(name, ..)| *name).collect::<Vec<_>>().join(", ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_have_a_size_and_a_dimension_however_they_are_spelled() {
        for (name, size, dimension) in [
            ("deg", 0.017_453_292_519_943_295, Dimension::Angle),
            ("°", 0.017_453_292_519_943_295, Dimension::Angle),
            ("rpm", 0.104_719_755_119_659_77, Dimension::AngularSpeed),
            ("1/min", 0.104_719_755_119_659_77, Dimension::AngularSpeed),
            ("mN·m", 1e-3, Dimension::Torque),
            ("mNm", 1e-3, Dimension::Torque),
            ("oz-in", 7.061_551_814e-3, Dimension::Torque),
            ("µm", 1e-6, Dimension::Length),
            ("%", 1e-2, Dimension::Number),
            ("Meters", 1.0, Dimension::Length),
            ("millimetre", 1e-3, Dimension::Length),
            ("sec.", 1.0, Dimension::Time),
            ("newtons", 1.0, Dimension::Force),
            ("daN", 10.0, Dimension::Force),
        ] {
            let unit = Unit::named(name).unwrap_or_else(|| panic!("{name}"));
            assert!((unit.size / size - 1.0).abs() < 1e-9, "{name}: {unit:?}");
            assert_eq!(unit.dimension, dimension, "{name}");
        }
        assert_eq!(Unit::named("parsec"), None);
        for (spelling, name) in SPELLINGS.iter().chain(IN_WORDS) {
            assert!(UNITS.iter().any(|(known, ..)| known == name), "{spelling}");
        }
    }
}
