//! What a model declares and a fit may move: the mass, the friction of the guides and the shift
//! between the sensors.

/// A declared parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Declared {
    Mass,
    Stiffness,
    BristleDamping,
    ViscousFriction,
    CoulombForce,
    StaticForce,
    StribeckVelocity,
    /// From the instants of the encoder's readings to those of the force cell's.
    SensorShift,
}

impl Declared {
    pub const ALL: [Declared; 8] = [
        Declared::Mass,
        Declared::Stiffness,
        Declared::BristleDamping,
        Declared::ViscousFriction,
        Declared::CoulombForce,
        Declared::StaticForce,
        Declared::StribeckVelocity,
        Declared::SensorShift,
    ];
    /// Those of a guide that slides.
    pub const SLIDING: [Declared; 4] = [
        Declared::ViscousFriction,
        Declared::CoulombForce,
        Declared::StaticForce,
        Declared::StribeckVelocity,
    ];

    /// As in a model file.
    pub fn name(self) -> &'static str {
        match self {
            Declared::Mass => "mass",
            Declared::Stiffness => "stiffness",
            Declared::BristleDamping => "bristle_damping",
            Declared::ViscousFriction => "viscous_friction",
            Declared::CoulombForce => "coulomb_force",
            Declared::StaticForce => "static_force",
            Declared::StribeckVelocity => "stribeck_velocity",
            Declared::SensorShift => "sensor_shift",
        }
    }

    pub fn unit(self) -> &'static str {
        match self {
            Declared::Mass => "kg",
            Declared::Stiffness => "N/m",
            Declared::BristleDamping | Declared::ViscousFriction => "N s/m",
            Declared::CoulombForce | Declared::StaticForce => "N",
            Declared::StribeckVelocity => "m/s",
            Declared::SensorShift => "s",
        }
    }

    /// Whether a fit moves it as the logarithm of a factor on the declared value; else it adds to
    /// it.
    pub fn is_factor(self) -> bool {
        self != Declared::SensorShift
    }
}
