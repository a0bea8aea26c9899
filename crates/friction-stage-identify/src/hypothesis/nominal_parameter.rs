//! What a model declares and a fit may move: the mass, the friction of the guides and the shift
//! between the sensors.

/// A declared parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NominalParameter {
    /// Moving mass, kg.
    Mass,
    /// Bristle stiffness sigma0, N/m.
    Stiffness,
    /// Bristle damping sigma1, N s/m.
    BristleDamping,
    /// Viscous friction sigma2, N s/m.
    ViscousFriction,
    /// Coulomb friction Fc, N.
    CoulombForce,
    /// Static friction Fs, N.
    StaticForce,
    /// Stribeck velocity vs, m/s.
    StribeckVelocity,
    /// From the instants of the encoder's readings to those of the force cell's.
    SensorShift,
}

impl NominalParameter {
    /// All of them, in the order of the fit.
    pub const ALL: [NominalParameter; 8] = [
        NominalParameter::Mass,
        NominalParameter::Stiffness,
        NominalParameter::BristleDamping,
        NominalParameter::ViscousFriction,
        NominalParameter::CoulombForce,
        NominalParameter::StaticForce,
        NominalParameter::StribeckVelocity,
        NominalParameter::SensorShift,
    ];
    /// Those of the bristles: of a guide that sticks.
    pub const BRISTLES: [NominalParameter; 2] =
        [NominalParameter::Stiffness, NominalParameter::BristleDamping];
    /// Those of a guide that slides.
    pub const SLIDING: [NominalParameter; 4] = [
        NominalParameter::ViscousFriction,
        NominalParameter::CoulombForce,
        NominalParameter::StaticForce,
        NominalParameter::StribeckVelocity,
    ];

    /// As in a model file.
    pub fn name(self) -> &'static str {
        match self {
            NominalParameter::Mass => "mass",
            NominalParameter::Stiffness => "stiffness",
            NominalParameter::BristleDamping => "bristle_damping",
            NominalParameter::ViscousFriction => "viscous_friction",
            NominalParameter::CoulombForce => "coulomb_force",
            NominalParameter::StaticForce => "static_force",
            NominalParameter::StribeckVelocity => "stribeck_velocity",
            NominalParameter::SensorShift => "sensor_shift",
        }
    }

    /// Its SI unit.
    pub fn unit(self) -> &'static str {
        match self {
            NominalParameter::Mass => "kg",
            NominalParameter::Stiffness => "N/m",
            NominalParameter::BristleDamping | NominalParameter::ViscousFriction => "N s/m",
            NominalParameter::CoulombForce | NominalParameter::StaticForce => "N",
            NominalParameter::StribeckVelocity => "m/s",
            NominalParameter::SensorShift => "s",
        }
    }

    /// Whether a fit moves it as the logarithm of a factor on the declared value; else it adds to
    /// it.
    pub fn is_factor(self) -> bool {
        self != NominalParameter::SensorShift
    }
}
