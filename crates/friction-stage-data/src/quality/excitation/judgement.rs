//! What the data can and cannot tell.

use serde::Serialize;

use super::{Excitation, Presliding, RoughFit, Spread};
use crate::quality::finding::{DataFinding, Severity};
use crate::signals::Signal;
use friction_stage_core::model::{JointType, StageModel};

/// Stribeck velocity of a prismatic joint, m/s, where no model declares one. Assumed: the low end
/// of the usual 1 to 10 mm/s. That of a revolute joint is as many times it as its radius is smaller
/// than 1 m, so there is no usual one.
const USUAL_STRIBECK_VELOCITY: f64 = 1e-3;

/// What can be asked of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Subject {
    /// Moving mass.
    Mass,
    /// Coulomb friction.
    CoulombFriction,
    /// Viscous friction.
    ViscousFriction,
    /// Friction over velocity near the Stribeck velocity.
    StribeckCurve,
    /// Stiffness of the bristles.
    BristleStiffness,
    /// Friction that differs between the directions.
    Asymmetry,
    /// Effects of the motor: cogging, force ripple, gain, lag.
    MotorSide,
    /// Effects over position.
    OverPosition,
    /// Whether a periodic force depends on position or on time.
    PositionOrTime,
    /// Static friction that grows at rest.
    StictionAging,
    /// Viscous friction that falls with the work done.
    WarmUp,
    /// The closed loop of stage and controller.
    ClosedLoop,
}

/// Why something can be identified; SI units.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum JudgementBasis {
    /// The rough fit of the force on the acceleration.
    Inertia {
        /// Largest acceleration, m/s².
        acceleration: f64,
        /// Share of the mean square of the force that acceleration brings.
        share: f64,
        /// Mass by the rough fit, kg.
        mass: f64,
        /// Its standard deviation, kg.
        deviation: f64,
    },
    /// Turns round.
    Reversals {
        /// How many.
        count: usize,
    },
    /// Velocities, and speeds that are held.
    Speeds {
        /// Largest speed, m/s.
        fastest: f64,
        /// Speeds that are held, m/s.
        speeds: Vec<f64>,
    },
    /// Speeds that are held.
    HeldSpeeds {
        /// m/s.
        speeds: Vec<f64>,
    },
    /// A slow speed that is held.
    SlowSpeed {
        /// The slowest, m/s.
        slowest: f64,
        /// Stribeck velocity, m/s.
        stribeck_velocity: f64,
        /// Whether a model declares it; assumed otherwise.
        declared: bool,
    },
    /// Velocities in both directions.
    Velocities {
        /// Lowest, m/s.
        lowest: f64,
        /// Highest, m/s.
        highest: f64,
    },
    /// Both forces are recorded.
    BothForces,
    /// Highest minus lowest position.
    Stroke {
        /// m.
        stroke: f64,
    },
    /// Stretches of rest.
    Rests {
        /// How many.
        count: usize,
        /// The shortest, s.
        least: f64,
        /// The longest, s.
        largest: f64,
    },
    /// Time and distance.
    Travel {
        /// Length of the valid rows, s.
        duration_s: f64,
        /// Distance travelled, m.
        distance: f64,
    },
    /// The setpoint is recorded.
    Setpoint,
}

/// Why something cannot be identified; SI units.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Obstacle {
    /// A finding that stands in the way of everything, by its code.
    Unusable {
        /// See [`DataFinding::code`].
        code: &'static str,
    },
    /// There is no force to compare with.
    NoForce,
    /// Too few moments are clear of rest and noise.
    TooSlow {
        /// Largest speed, m/s.
        fastest: f64,
        /// Speed above which the carriage clearly moves, m/s.
        clear: f64,
    },
    /// Acceleration brings too little of the force.
    LittleInertia {
        /// Largest acceleration, m/s².
        acceleration: f64,
        /// Share of the mean square of the force that it brings.
        share: f64,
    },
    /// What there is of acceleration is the encoder's noise.
    AccelerationIsNoise {
        /// Share of its mean square that is.
        share: f64,
    },
    /// All motion is in one direction.
    OneDirection,
    /// All motion is at one speed.
    OneSpeed,
    /// No slow speed is held.
    NoSlowSpeed {
        /// Stribeck velocity, m/s.
        stribeck_velocity: f64,
        /// Whether a model declares it; assumed otherwise.
        declared: bool,
    },
    /// No model declares a Stribeck velocity, and the joint has no usual one.
    UnknownStribeckVelocity {
        /// The slowest speed that is held, m/s; absent where none is.
        slowest: Option<f64>,
    },
    /// No speed is well above the Stribeck velocity.
    NoFastSpeed {
        /// Largest speed, m/s.
        fastest: f64,
        /// Stribeck velocity, m/s.
        stribeck_velocity: f64,
    },
    /// It turns round too seldom.
    FewReversals {
        /// How often.
        count: usize,
        /// How often it should.
        needed: usize,
    },
    /// The encoder does not see the pre-sliding.
    PreslidingIsNoise {
        /// Travel in which the force turns, m.
        travel: f64,
        /// Whether a model declares it; measured otherwise.
        declared: bool,
        /// Noise of the encoder, m, counts included.
        noise: f64,
    },
    /// There is no force cell.
    NoForceCell,
    /// There is no command.
    NoCommand,
    /// The carriage never rests.
    NoRest,
    /// It rests too seldom.
    FewRests {
        /// How often.
        count: usize,
        /// How often it should.
        needed: usize,
    },
    /// All rests are as long as each other, or short.
    RestsAlike {
        /// The shortest, s.
        least: f64,
        /// The longest, s.
        largest: f64,
    },
    /// It lasts too short.
    Short {
        /// Length of the valid rows, s.
        duration_s: f64,
        /// Length that is needed, s.
        needed_s: f64,
    },
    /// It travels too little.
    LittleTravel {
        /// Distance travelled, m.
        distance: f64,
        /// Distance that is needed, m.
        needed: f64,
    },
    /// There is no setpoint.
    NoSetpoint,
}

/// Whether something can be identified, and why or why not.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// What is asked for.
    pub subject: Subject,
    /// Why it can be identified, or what stands in the way.
    pub answer: Result<JudgementBasis, Obstacle>,
}

impl Judgement {
    /// Whether the data can tell.
    pub fn possible(&self) -> bool {
        self.answer.is_ok()
    }
}

/// Share of the mean square of the force that acceleration must bring for a mass. Assumed.
pub(super) const LEAST_INERTIA: f64 = 0.01;
/// Stribeck velocities that the fastest speed must reach. Assumed: there the curve is flat.
const FAST: f64 = 3.0;
/// Rests that show ageing, the ratio of the longest to the shortest, and the length of the longest,
/// s. Assumed.
const RESTS: (usize, f64, f64) = (4, 2.0, 0.2);
/// Time, s, and strokes that warm a stage up. Assumed.
const WARM: (f64, f64) = (10.0, 4.0);

/// What the data can and cannot tell.
pub(super) fn judge(found: &Excitation, model: Option<&StageModel>) -> Vec<Judgement> {
    let fatal = found.findings.iter().find(|finding| finding.severity() == Severity::Fatal);
    let unusable = fatal.map(|finding| Obstacle::Unusable { code: finding.code() });
    let judge = Judge::new(found, model);
    let answers = [
        (Subject::Mass, judge.mass()),
        (Subject::CoulombFriction, judge.both_directions().map(|()| judge.reversals())),
        (Subject::ViscousFriction, judge.speeds()),
        (Subject::StribeckCurve, judge.stribeck_curve()),
        (Subject::BristleStiffness, judge.bristle_stiffness()),
        (Subject::Asymmetry, judge.both_directions().map(|()| judge.velocities())),
        (Subject::MotorSide, judge.motor_side()),
        (Subject::OverPosition, judge.turns_round(1).map(|()| judge.stroke())),
        (Subject::PositionOrTime, judge.held_speeds()),
        (Subject::StictionAging, judge.rests()),
        (Subject::WarmUp, judge.warm_up()),
        (Subject::ClosedLoop, judge.closed_loop()),
    ];
    answers
        .into_iter()
        .map(|(subject, answer)| match &unusable {
            Some(obstacle) => Judgement { subject, answer: Err(obstacle.clone()) },
            None => Judgement { subject, answer },
        })
        .collect()
}

type Answer = Result<JudgementBasis, Obstacle>;

struct Judge<'a> {
    found: &'a Excitation,
    fastest: f64,
    /// m/s; `None` where it is not declared and there is no usual one.
    stribeck_velocity: Option<f64>,
    declared: bool,
}

impl<'a> Judge<'a> {
    fn new(found: &'a Excitation, model: Option<&StageModel>) -> Self {
        let guides = model.and_then(|model| model.resolved_guides().ok());
        let declared = guides
            .map(|guides| guides.iter().map(|g| g.stribeck_velocity).fold(f64::INFINITY, f64::min));
        Self {
            found,
            fastest: found.velocity_range.iter().fold(0.0f64, |m, v| m.max(v.abs())),
            stribeck_velocity: declared.or(match found.joint {
                JointType::Prismatic => Some(USUAL_STRIBECK_VELOCITY),
                JointType::Revolute => None,
            }),
            declared: declared.is_some(),
        }
    }

    fn has(&self, signal: Signal) -> bool {
        self.found.recorded.contains(&signal)
    }

    fn finds(&self, wanted: fn(&DataFinding) -> bool) -> bool {
        self.found.findings.iter().any(wanted)
    }

    /// The force over the motion; every question about friction needs it.
    fn fit(&self) -> Result<RoughFit, Obstacle> {
        let too_slow =
            || Obstacle::TooSlow { fastest: self.fastest, clear: self.found.clear_speed };
        match self.found.cell_fit.or(self.found.command_fit) {
            Some(fit) => Ok(fit),
            None if self.has(Signal::ForceCell) || self.has(Signal::Force) => Err(too_slow()),
            None => Err(Obstacle::NoForce),
        }
    }

    fn mass(&self) -> Answer {
        let fit = self.fit()?;
        let (acceleration, share) = (self.found.largest_acceleration, fit.inertial);
        if !fit.acceleration_is_seen() {
            let share = fit.apparent_acceleration.min(1.0);
            return Err(Obstacle::AccelerationIsNoise { share });
        }
        let (mass, deviation) = (fit.mass, fit.mass_deviation);
        if share <= LEAST_INERTIA || !deviation.is_finite() {
            return Err(Obstacle::LittleInertia { acceleration, share });
        }
        Ok(JudgementBasis::Inertia { acceleration, share, mass, deviation })
    }

    fn both_directions(&self) -> Result<(), Obstacle> {
        self.fit()?;
        match self.finds(|finding| matches!(finding, DataFinding::OneDirection)) {
            true => Err(Obstacle::OneDirection),
            false => Ok(()),
        }
    }

    fn turns_round(&self, needed: usize) -> Result<(), Obstacle> {
        self.fit()?;
        let count = self.found.reversals;
        if count < needed { Err(Obstacle::FewReversals { count, needed }) } else { Ok(()) }
    }

    fn bristle_stiffness(&self) -> Answer {
        self.turns_round(2)?;
        match self.found.presliding.filter(|presliding| !presliding.is_seen()) {
            Some(Presliding { travel, declared, noise }) => {
                Err(Obstacle::PreslidingIsNoise { travel, declared, noise })
            }
            None => Ok(self.reversals()),
        }
    }

    fn several_speeds(&self) -> Result<Vec<f64>, Obstacle> {
        self.fit()?;
        match self.finds(|finding| matches!(finding, DataFinding::OneSpeed { .. })) {
            true => Err(Obstacle::OneSpeed),
            false => Ok(self.found.speeds.clone()),
        }
    }

    fn reversals(&self) -> JudgementBasis {
        JudgementBasis::Reversals { count: self.found.reversals }
    }

    fn velocities(&self) -> JudgementBasis {
        let [lowest, highest] = self.found.velocity_range;
        JudgementBasis::Velocities { lowest, highest }
    }

    fn stroke(&self) -> JudgementBasis {
        JudgementBasis::Stroke { stroke: self.found.stroke() }
    }

    fn speeds(&self) -> Answer {
        let speeds = self.several_speeds()?;
        Ok(JudgementBasis::Speeds { fastest: self.fastest, speeds })
    }

    fn held_speeds(&self) -> Answer {
        Ok(JudgementBasis::HeldSpeeds { speeds: self.several_speeds()? })
    }

    fn stribeck_curve(&self) -> Answer {
        self.fit()?;
        let declared = self.declared;
        let stribeck_velocity = self.stribeck_velocity.ok_or_else(|| {
            let slowest = self.found.speeds.iter().copied().reduce(f64::min);
            Obstacle::UnknownStribeckVelocity { slowest }
        })?;
        let slowest = self.found.speeds.iter().copied().find(|s| *s < stribeck_velocity);
        let slowest = slowest.ok_or(Obstacle::NoSlowSpeed { stribeck_velocity, declared })?;
        if self.fastest <= FAST * stribeck_velocity {
            return Err(Obstacle::NoFastSpeed { fastest: self.fastest, stribeck_velocity });
        }
        Ok(JudgementBasis::SlowSpeed { slowest, stribeck_velocity, declared })
    }

    fn motor_side(&self) -> Answer {
        self.fit()?;
        match (self.found.cell_fit, self.found.command_fit) {
            (Some(_), Some(_)) => Ok(JudgementBasis::BothForces),
            (None, _) => Err(Obstacle::NoForceCell),
            (_, None) => Err(Obstacle::NoCommand),
        }
    }

    fn rests(&self) -> Answer {
        self.fit()?;
        let Some(Spread { least, largest, .. }) = self.found.rests else {
            return Err(Obstacle::NoRest);
        };
        let (count, (needed, ratio, long)) = (self.found.rest_count, RESTS);
        if count < needed {
            return Err(Obstacle::FewRests { count, needed });
        }
        if largest <= ratio * least || largest <= long {
            return Err(Obstacle::RestsAlike { least, largest });
        }
        Ok(JudgementBasis::Rests { count, least, largest })
    }

    fn warm_up(&self) -> Answer {
        self.fit()?;
        let (duration_s, distance) = (self.found.duration_s, self.found.distance);
        let (needed_s, needed) = (WARM.0, WARM.1 * self.found.stroke());
        if duration_s <= needed_s {
            return Err(Obstacle::Short { duration_s, needed_s });
        }
        if distance <= needed {
            return Err(Obstacle::LittleTravel { distance, needed });
        }
        Ok(JudgementBasis::Travel { duration_s, distance })
    }

    fn closed_loop(&self) -> Answer {
        match self.has(Signal::ReferencePosition) {
            true => Ok(JudgementBasis::Setpoint),
            false => Err(Obstacle::NoSetpoint),
        }
    }
}
