//! What an effect acts on: its role, and the side of the force cell on which that shows.

/// What an effect acts on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// The command of the motor, on its way to becoming a force.
    Command(CommandStage),
    /// Force on the motor side, before the force cell.
    MotorForce,
    /// Force on the carriage, which the force cell does not see.
    CarriageForce,
    /// Laws of the guides' friction, which it multiplies by a factor.
    Friction(FrictionTerms),
    /// The bristles of the guides: several elements in place of one.
    Bristles,
    /// Mass that always moves with the carriage beyond that of the model.
    Mass,
    /// Mass that moves with the carriage at times.
    VaryingMass,
    /// Reading of the encoder.
    Encoder,
    /// Reading of the force cell.
    ForceCell,
}

/// Where an effect enters, which decides who can see it: the force cell sees the motor side only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// Between command and force cell.
    Motor,
    /// Between force cell and carriage.
    Carriage,
    /// In what encoder or force cell read; no force.
    Sensor,
}

/// Place of an effect in the chain that makes the motor's force of its command. It acts on what the
/// places before it pass on; effects of one place act side by side.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum CommandStage {
    /// The command arrives late.
    Lag,
    /// Small commands make no force.
    Threshold,
    /// The force is a curve over the command.
    Curve,
    /// More or less force per command, everywhere; the force is proportional to the command.
    Gain,
    /// The same over the position or the speed.
    Ripple,
}

/// Laws of the guides' friction that an effect multiplies by a factor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FrictionTerms {
    /// Friction of the bristles: Fc, Fs.
    pub bristles: bool,
    /// Viscous friction: sigma2.
    pub viscous: bool,
}

impl FrictionTerms {
    /// None of them.
    pub const NOTHING: FrictionTerms = FrictionTerms { bristles: false, viscous: false };
    /// Coulomb and static friction.
    pub const BRISTLES: FrictionTerms = FrictionTerms { bristles: true, viscous: false };
    /// Viscous friction.
    pub const VISCOUS: FrictionTerms = FrictionTerms { bristles: false, viscous: true };
    /// All of them.
    pub const BOTH: FrictionTerms = FrictionTerms { bristles: true, viscous: true };

    /// Those that either of two multiplies.
    pub fn union(self, other: FrictionTerms) -> FrictionTerms {
        FrictionTerms {
            bristles: self.bristles || other.bristles,
            viscous: self.viscous || other.viscous,
        }
    }
}

impl Role {
    /// Side on which it acts.
    pub fn side(self) -> Side {
        match self {
            Role::Command(_) | Role::MotorForce => Side::Motor,
            Role::CarriageForce
            | Role::Friction(_)
            | Role::Bristles
            | Role::Mass
            | Role::VaryingMass => Side::Carriage,
            Role::Encoder | Role::ForceCell => Side::Sensor,
        }
    }

    /// Whether it adds a force beside the command, on either side of the force cell.
    pub fn is_force(self) -> bool {
        matches!(self, Role::MotorForce | Role::CarriageForce)
    }

    /// Its place in the chain from the command to the motor's force, if it has one.
    pub fn command_stage(self) -> Option<CommandStage> {
        match self {
            Role::Command(stage) => Some(stage),
            _ => None,
        }
    }

    /// The laws of the guides that it multiplies.
    pub fn friction_terms(self) -> FrictionTerms {
        match self {
            Role::Friction(terms) => terms,
            _ => FrictionTerms::NOTHING,
        }
    }

    /// Whether what the guides' bristles give is not that of the model alone.
    pub fn shapes_bristles(self) -> bool {
        self == Role::Bristles || self.friction_terms().bristles
    }
}
