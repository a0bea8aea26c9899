//! The measuring rig driven as the guide tests drive it: runs at constant velocity, and slow loops (paper, chapters 2 and 3).
//!
//! In come a rig, a motion and a seed, out come the columns that the rig's sensors record.

use super::closed_loop::ClosedLoop;
use crate::control::{Controller, ControllerError, ControllerSettings, Gains, Point, Trajectory, TrajectoryError};
use crate::model::{Coupling, Guide, GuideSource, ModelError, StageModel};
use crate::plant::{Rates, Stage};

/// What the rig records, one row per sample, SI units.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RigRecord {
    /// s, evenly spaced.
    pub time: Vec<f64>,
    /// Encoder, m.
    pub position: Vec<f64>,
    /// Force cell, N.
    pub force: Vec<f64>,
}

/// A rig that cannot make a motion.
#[derive(Debug, thiserror::Error)]
pub enum RigError {
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error(transparent)]
    Controller(#[from] ControllerError),
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    #[error(
        "the motion needs more than the motor's {limit} N at {time:.3} s ({clamped} samples in all): slow it down or raise motor.force_limit"
    )]
    Motor { limit: f64, time: f64, clamped: u64 },
}

/// Bandwidth of the rig's position servo, Hz. Assumed: that of the stage node's own servo.
const SERVO_BANDWIDTH: f64 = 60.0;
/// Time to reach a speed and to stop from it, s. Assumed.
const RAMP: f64 = 0.1;
/// Time at rest between runs, s. Assumed.
const REST: f64 = 0.05;
/// Way at constant speed, m, and the shortest time for it, s. Assumed: the friction is steady after some ten Fs/sigma0.
const RUN: (f64, f64) = (1.2e-3, 0.25);
/// Points of a trajectory per loop: quintic pieces follow a sine to 1e-7 of its amplitude.
const POINTS_PER_LOOP: usize = 32;

/// The measuring rig of the paper with a guide of these parameters; masses and flexure as in [`StageModel::measuring_rig`].
pub fn rig_of(guide: &Guide) -> StageModel {
    StageModel {
        name: "measuring rig".to_owned(),
        mass: 1.0,
        guides: vec![GuideSource::Inline(guide.clone())],
        coupling: Some(Coupling { stiffness: 100.0 * guide.stiffness, damping: 300.0, motor_mass: 5.0 }),
        ..StageModel::default()
    }
}

/// Runs at each of the speeds, m/s, forward and back.
pub fn stribeck_motion(speeds: &[f64]) -> Vec<Point> {
    let mut path = Path::default();
    for &speed in speeds {
        for velocity in [speed, -speed] {
            let duration = RUN.1.max(RUN.0 / speed);
            path.to(REST, 0.0, 0.0);
            path.to(RAMP, 0.5 * velocity * RAMP, velocity);
            path.to(duration, velocity * duration, velocity);
            path.to(RAMP, 0.5 * velocity * RAMP, 0.0);
        }
    }
    path.points
}

/// Sinusoidal loops: of each amplitude (m), period (s) and number, one after the other.
pub fn dahl_motion(loops: &[(f64, f64, usize)]) -> Vec<Point> {
    let mut path = Path::default();
    for &(amplitude, period, count) in loops {
        path.to(REST, 0.0, 0.0);
        let (from, start) = (path.position(), path.time());
        let rate = 2.0 * std::f64::consts::PI / period;
        for k in 1..=count * POINTS_PER_LOOP {
            let after = period * k as f64 / POINTS_PER_LOOP as f64;
            let (sine, cosine) = (rate * after).sin_cos();
            path.points.push(Point {
                time: start + (after * 1e9).round() as i64,
                position: from + amplitude * (1.0 - cosine),
                velocity: Some(amplitude * rate * sine),
                acceleration: Some(amplitude * rate * rate * cosine),
                effort: 0.0,
            });
        }
    }
    path.to(REST, 0.0, 0.0);
    path.points
}

/// Drives a rig along the points by its position servo and records its sensors. A motion beyond the motor's force is an error.
pub fn run_rig(model: &StageModel, points: Vec<Point>, rates: Rates, seed: u64) -> Result<RigRecord, RigError> {
    let moved = model.mass + model.coupling.as_ref().map_or(0.0, |coupling| coupling.motor_mass);
    let settings = ControllerSettings {
        gains: Gains::from_bandwidth(SERVO_BANDWIDTH, moved),
        ..ControllerSettings::paper(moved, rates.control(), model.motor.force_limit)
    };
    let trajectory = Trajectory::new(0, points)?;
    let end = trajectory.end();
    let mut closed_loop = ClosedLoop::new(Stage::new(model, rates, seed)?, Controller::new(settings)?, trajectory);
    let mut record = RigRecord::default();
    let (mut clamped, mut first) = (0, None);
    loop {
        let cycle = closed_loop.cycle()?;
        if cycle.sample.time > end {
            break;
        }
        let time = cycle.sample.time as f64 * 1e-9;
        if cycle.terms.saturated {
            clamped += 1;
            first.get_or_insert(time);
        }
        record.time.push(time);
        record.position.push(cycle.sample.position);
        record.force.push(cycle.sample.force_cell);
    }
    match first {
        Some(time) => Err(RigError::Motor { limit: model.motor.force_limit, time, clamped }),
        None => Ok(record),
    }
}

#[derive(Default)]
struct Path {
    points: Vec<Point>,
}

impl Path {
    fn time(&self) -> i64 {
        self.points.last().map_or(0, |point| point.time)
    }

    fn position(&self) -> f64 {
        self.points.last().map_or(0.0, |point| point.position)
    }

    /// Goes on for `duration` s over `distance` m, to arrive with `velocity` and without acceleration.
    fn to(&mut self, duration: f64, distance: f64, velocity: f64) {
        self.points.push(Point {
            time: self.time() + (duration * 1e9).round() as i64,
            position: self.position() + distance,
            velocity: Some(velocity),
            acceleration: Some(0.0),
            effort: 0.0,
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Catalogue;

    #[test]
    fn the_rig_reads_the_steady_friction_at_constant_speed() {
        let guide = Catalogue::builtin().guide("guide_1").unwrap();
        let model = rig_of(&guide).without_noise();
        for speed in [1e-3, 0.1] {
            let record = run_rig(&model, stribeck_motion(&[speed]), Rates::DEFAULT, 1).unwrap();
            // Near the end of the forward run.
            let at = ((REST + RAMP + 0.95 * RUN.1.max(RUN.0 / speed)) * 4000.0) as usize;
            let expected = guide.steady_force(speed);
            assert!((record.force[at] / expected - 1.0).abs() < 2e-3, "{speed}: {} {expected}", record.force[at]);
        }
    }

    #[test]
    fn a_motion_beyond_the_motor_is_refused_with_time_and_limit() {
        let mut model = rig_of(&Catalogue::builtin().guide("guide_1").unwrap());
        model.motor.force_limit = 10.0;
        let message = run_rig(&model, stribeck_motion(&[0.1]), Rates::DEFAULT, 1).unwrap_err().to_string();
        assert!(message.contains("motor's 10 N") && message.contains("force_limit"), "{message}");
    }
}
