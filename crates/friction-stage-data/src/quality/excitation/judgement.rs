//! What the data can and cannot tell.

use serde::Serialize;

use super::Excitation;
use crate::quality::finding::{DataFinding, Severity};
use crate::signals::Signal;
use friction_stage_core::model::StageModel;

/// Stribeck velocity, m/s, where no model declares one. Assumed: the low end of the usual 1 to 10
/// mm/s.
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

/// What a judgement rests on; SI units.
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
    /// There is no force over a motion.
    NoForce,
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
    /// The slowest speed that is held, against the Stribeck velocity.
    SlowSpeed {
        /// A speed below the Stribeck velocity that is held, m/s, if there is one.
        slowest: Option<f64>,
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
    /// Which forces are recorded.
    Forces {
        /// The force cell.
        cell: bool,
        /// The command.
        command: bool,
    },
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
    /// The carriage never rests.
    NoRest,
    /// Time and distance.
    Travel {
        /// Length of the valid rows, s.
        duration_s: f64,
        /// Distance travelled, m.
        distance: f64,
    },
    /// Whether the setpoint is recorded.
    Setpoint {
        /// It is.
        recorded: bool,
    },
}

/// Whether something can be identified, and why or why not.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judgement {
    /// What is asked for.
    pub subject: Subject,
    /// Whether the data can tell.
    pub possible: bool,
    /// Why, or what is missing.
    pub evidence: JudgementBasis,
}

/// What the data can and cannot tell.
pub(super) fn judge(found: &Excitation, model: Option<&StageModel>) -> Vec<Judgement> {
    let has = |signal: Signal| found.recorded.contains(&signal);
    let fatal = found.findings.iter().any(|finding| finding.severity() == Severity::Fatal);
    let is_found = |wanted: fn(&DataFinding) -> bool| found.findings.iter().any(wanted);
    let one_direction = is_found(|finding| matches!(finding, DataFinding::OneDirection));
    let one_speed = is_found(|finding| matches!(finding, DataFinding::OneSpeed { .. }));
    let fit = found.cell_fit.or(found.command_fit);
    let fastest = found.velocity_range.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let declared = model
        .and_then(|m| m.resolved_guides().ok())
        .map(|guides| guides.iter().map(|g| g.stribeck_velocity).fold(f64::INFINITY, f64::min));
    let stribeck_velocity = declared.unwrap_or(USUAL_STRIBECK_VELOCITY);
    let slowest = found.speeds.iter().copied().find(|s| *s < stribeck_velocity);
    let (cell, command) = (has(Signal::ForceCell), has(Signal::Force));
    let stroke = found.position_range[1] - found.position_range[0];
    let rests = found.rests.filter(|r| r.largest > 2.0 * r.least && r.largest > 0.2);
    let (speeds, count) = (found.speeds.clone(), found.reversals);
    let judgements = [
        (
            Subject::Mass,
            fit.is_some_and(|fit| fit.inertial > 0.01),
            fit.map_or(JudgementBasis::NoForce, |fit| JudgementBasis::Inertia {
                acceleration: found.largest_acceleration,
                share: fit.inertial,
                mass: fit.mass,
                deviation: fit.mass_deviation,
            }),
        ),
        (
            Subject::CoulombFriction,
            fit.is_some() && !one_direction,
            JudgementBasis::Reversals { count },
        ),
        (
            Subject::ViscousFriction,
            fit.is_some() && !one_speed,
            JudgementBasis::Speeds { fastest, speeds: speeds.clone() },
        ),
        (
            Subject::StribeckCurve,
            fit.is_some() && slowest.is_some() && fastest > 3.0 * stribeck_velocity,
            JudgementBasis::SlowSpeed { slowest, stribeck_velocity, declared: declared.is_some() },
        ),
        (
            Subject::BristleStiffness,
            fit.is_some() && count >= 2,
            JudgementBasis::Reversals { count },
        ),
        (
            Subject::Asymmetry,
            fit.is_some() && !one_direction,
            JudgementBasis::Velocities {
                lowest: found.velocity_range[0],
                highest: found.velocity_range[1],
            },
        ),
        (
            Subject::MotorSide,
            cell && command && found.cell_fit.is_some() && found.command_fit.is_some(),
            JudgementBasis::Forces { cell, command },
        ),
        (
            Subject::OverPosition,
            fit.is_some() && stroke > 0.0 && count >= 1,
            JudgementBasis::Stroke { stroke },
        ),
        (
            Subject::PositionOrTime,
            fit.is_some() && !one_speed,
            JudgementBasis::HeldSpeeds { speeds },
        ),
        (
            Subject::StictionAging,
            fit.is_some() && rests.is_some() && found.rest_count >= 4,
            found.rests.map_or(JudgementBasis::NoRest, |rests| JudgementBasis::Rests {
                count: found.rest_count,
                least: rests.least,
                largest: rests.largest,
            }),
        ),
        (
            Subject::WarmUp,
            fit.is_some() && found.duration_s > 10.0 && found.distance > 4.0 * stroke,
            JudgementBasis::Travel { duration_s: found.duration_s, distance: found.distance },
        ),
        (
            Subject::ClosedLoop,
            has(Signal::ReferencePosition),
            JudgementBasis::Setpoint { recorded: has(Signal::ReferencePosition) },
        ),
    ];
    judgements
        .into_iter()
        .map(|(subject, possible, evidence)| Judgement {
            subject,
            possible: possible && !fatal,
            evidence,
        })
        .collect()
}
