//! The same motion without and with the compensation of what a model knows, on another stage.
//!
//! In come the model that is known, the stage as it is and a motion, out come both runs and what
//! each of their moves reached.

use serde::Serialize;

use friction_stage_core::ClosedLoop;
use friction_stage_core::control::{
    Compensation, CompensationError, CompensationTermsOn, Controller, ControllerError,
    ControllerSettings, Follower, Point, Trajectory, TrajectoryError,
};
use friction_stage_core::model::{ModelError, StageModel};
use friction_stage_core::plant::{Rates, RatesError, Stage};

use super::balance::rest_to_balance;
use super::paper::{Move, MoveKind};
use super::settling::{MoveResult, settling};

/// Relative difference of the moving masses from which on two models are not of one machine.
const MASS_TOLERANCE: f64 = 0.3;
/// Time between the points of a trajectory with effort, ns.
const EFFORT_EVERY: i64 = 2_000_000;
/// Positions of a table over the position, m apart.
const TABLE_STEP: f64 = 0.5e-3;

/// A trial that cannot be made.
#[expect(missing_docs, reason = "the message of each says what its fields are")]
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error(transparent)]
    Rates(#[from] RatesError),
    #[error(transparent)]
    Controller(#[from] ControllerError),
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    #[error(transparent)]
    Compensation(#[from] CompensationError),
    #[error("the model does not fit the stage: {}", differences.join("; "))]
    Differs { differences: Vec<String> },
    #[error("the motion has no points")]
    NoMotion,
}

/// What is tried.
#[derive(Clone, Debug)]
pub struct CompensationTrial {
    /// What is known of the stage.
    pub known: StageModel,
    /// The stage as it is.
    pub real: StageModel,
    /// Controller without the compensation.
    pub settings: ControllerSettings,
    /// Motion of both runs.
    pub points: Vec<Point>,
    /// Terms that the compensation has.
    pub on: CompensationTermsOn,
    /// Seed of the sensor noise, the same in both runs.
    pub seed: u64,
}

/// One run of the motion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrialRun {
    /// Largest |error|, m.
    pub peak: f64,
    /// Root mean square of the error, m.
    pub rms: f64,
    /// Samples at which the controller was at its limit.
    pub saturated: u64,
    /// Of each move that ends in a rest.
    pub moves: Vec<MoveResult>,
    /// Time after the start of the motion, ns, and error, m.
    #[serde(skip)]
    pub errors: Vec<(i64, f64)>,
}

impl TrialRun {
    /// Longest settling into each band, s; `None`: some move does not settle.
    pub fn settling(&self) -> [Option<f64>; 3] {
        std::array::from_fn(|band| {
            self.moves.iter().try_fold(0.0, |longest: f64, the_move| {
                the_move.settling[band].map(|time| longest.max(time))
            })
        })
    }
}

impl CompensationTrial {
    /// Refuses a model that is not of this stage.
    pub fn check(&self) -> Result<(), TrialError> {
        let (known, real) = (&self.known, &self.real);
        let mut differences = Vec::new();
        if known.joint != real.joint {
            differences.push("one moves along an axis and the other turns about one".to_owned());
        }
        let (mass, other) = (known.moving_mass(), real.moving_mass());
        if (mass / other - 1.0).abs() > MASS_TOLERANCE {
            differences.push(format!("it moves {mass} kg and the stage {other} kg"));
        }
        if known.guides.len() != real.guides.len() {
            differences.push(format!(
                "it has {} guides and the stage {}",
                known.guides.len(),
                real.guides.len()
            ));
        }
        if known.coupling.is_some() != real.coupling.is_some() {
            differences.push("one of them has a coupling behind its motor".to_owned());
        }
        if self.points.is_empty() {
            return Err(TrialError::NoMotion);
        }
        if differences.is_empty() { Ok(()) } else { Err(TrialError::Differs { differences }) }
    }

    /// The runs without and with the compensation.
    pub fn run(&self) -> Result<(TrialRun, TrialRun), TrialError> {
        self.check()?;
        Ok((self.one(false)?, self.one(true)?))
    }

    /// The run without or with it. Before the motion the stage comes into balance: what its forces
    /// do while it is switched on is no answer to the motion.
    pub fn one(&self, compensated: bool) -> Result<TrialRun, TrialError> {
        let rates = Rates::of_control(self.settings.rate)?;
        let stage = Stage::new(&self.real, rates, self.seed)?;
        let compensation = compensated.then(|| self.compensation()).transpose()?;
        let settings = match &compensation {
            Some(compensation) => self.settings.informed(compensation),
            None => self.settings.clone(),
        };
        let rest = rest_to_balance(&self.real, &settings.gains)?;
        let period = (1e9 / settings.rate).round() as i64;
        let start = period * (rest * settings.rate).ceil() as i64;
        let trajectory = Trajectory::new(start, self.points.clone())?;
        let mut run = ClosedLoop::new(stage, Controller::new(settings)?, trajectory);
        if let Some(compensation) = compensation {
            run = run.compensated(compensation);
        }
        let end = self.points.last().map_or(0, |point| point.time);
        let (mut errors, mut saturated): (Vec<(i64, f64)>, u64) = (Vec::new(), 0);
        while errors.last().is_none_or(|(time, _)| *time < end) {
            let cycle = run.cycle()?;
            let time = cycle.sample.time - start;
            if time >= 0 {
                saturated += u64::from(cycle.terms.saturated);
                errors.push((time, cycle.terms.error));
            }
        }
        let results = moves(&self.points)
            .iter()
            .filter_map(|one| settling(one, errors.iter().copied()))
            .collect();
        let squares: f64 = errors.iter().map(|(_, error)| error * error).sum();
        Ok(TrialRun {
            peak: errors.iter().map(|(_, error)| error.abs()).fold(0.0, f64::max),
            rms: (squares / errors.len() as f64).sqrt(),
            saturated,
            moves: results,
            errors,
        })
    }

    /// The compensation of what is known.
    pub fn compensation(&self) -> Result<Compensation, TrialError> {
        Ok(Compensation::new(&self.known, &self.settings, self.on)?)
    }

    /// The motion with the forces of the compensation as its effort, for
    /// joint_trajectory_controller, at points of 2 ms.
    pub fn with_effort(&self) -> Result<Vec<Point>, TrialError> {
        let mut compensation = self.compensation()?;
        let mut follower = Follower::new(f64::INFINITY);
        follower.follow(0, Trajectory::new(0, self.points.clone())?)?;
        let end = self.points.last().map_or(0, |point| point.time);
        let period = (1e9 / self.settings.rate).round() as i64;
        let (mut points, mut due, mut time): (Vec<Point>, i64, i64) = (Vec::new(), 0, 0);
        while time <= end {
            follower.advance(time);
            let found = compensation.update(time, &follower, self.settings.limits);
            if time >= due {
                let reference = follower.at(time);
                let terms = found.terms;
                points.push(Point {
                    time,
                    position: reference.position,
                    velocity: Some(reference.velocity),
                    acceleration: Some(reference.acceleration),
                    effort: reference.effort
                        + found.mass
                        + found.viscous
                        + terms.bristles
                        + terms.forces
                        + terms.motor,
                });
                due += EFFORT_EVERY;
            }
            time += period;
        }
        Ok(points)
    }

    /// Position, m, and the force, N, that answers the effects there, along the way of the motion.
    pub fn over_position(&self) -> Result<Vec<(f64, f64)>, TrialError> {
        let along = || self.points.iter().map(|point| point.position);
        let (low, high) = (along().fold(0.0, f64::min), along().fold(0.0, f64::max));
        let count = ((high - low) / TABLE_STEP).ceil().clamp(1.0, 1e5) as usize;
        let positions: Vec<f64> =
            (0..=count).map(|k| low + (high - low) * k as f64 / count as f64).collect();
        let forces = Compensation::over_position(&self.known, &positions)?;
        Ok(positions.into_iter().zip(forces).collect())
    }
}

/// The moves of a motion that end in a rest, each watched to the end of its rest.
fn moves(points: &[Point]) -> Vec<Move> {
    let still = |point: &Point| point.velocity.is_none_or(|velocity| velocity == 0.0);
    let mut start = 0;
    let mut found = Vec::new();
    for pair in points.windows(2) {
        let (a, b) = (&pair[0], &pair[1]);
        if a.position == b.position && still(a) && still(b) {
            if a.time > start {
                let (arrival, end, target) = (a.time, b.time, a.position);
                found.push(Move { kind: MoveKind::Application, start, arrival, end, target });
            }
            start = b.time;
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trial() -> CompensationTrial {
        let real = StageModel::on_guides("guide_1");
        let known = StageModel { mass: 40.3, ..real.clone() };
        let points = [(0.05, 0.0), (0.15, 0.05), (0.65, 0.05), (0.75, 0.0), (1.25, 0.0)];
        CompensationTrial {
            settings: ControllerSettings::of_model(&known, 60.0, 4000.0),
            points: points.map(|(time, x)| Point::at_rest((time * 1e9) as i64, x)).to_vec(),
            on: CompensationTermsOn::ALL,
            seed: 1,
            known,
            real,
        }
    }

    #[test]
    fn a_motion_is_followed_better_with_what_is_known() {
        let (plain, with) = trial().run().unwrap();
        assert_eq!((plain.moves.len(), with.moves.len()), (2, 2));
        assert!(with.peak < plain.peak / 3.0, "{} {}", plain.peak, with.peak);
        assert!(with.rms < plain.rms / 3.0, "{} {}", plain.rms, with.rms);
        let settled = |run: &TrialRun| run.settling()[1].unwrap();
        assert!(settled(&with) < 0.5 * settled(&plain), "{plain:?} {with:?}");
    }

    /// What joint_trajectory_controller adds is as good as what the controller works out.
    #[test]
    fn a_trajectory_with_effort_needs_no_feedforward() {
        let trial = trial();
        let (plain, _) = trial.run().unwrap();
        let mut settings = trial.settings.clone();
        settings.mass_feedforward = 0.0;
        let fed = CompensationTrial { settings, points: trial.with_effort().unwrap(), ..trial };
        let errors = fed.one(false).unwrap();
        assert!(errors.peak < plain.peak, "{} {}", plain.peak, errors.peak);
    }

    /// A stage that is switched on is moved by its cogging, which no motor force holds yet.
    #[test]
    fn a_run_starts_from_balance() {
        let mut trial = trial();
        let cogging = [("amplitude", 6.0), ("period", 0.024), ("phase", 1.0)];
        trial.real.effects =
            vec![friction_stage_core::model::EffectParameters::new("cogging", cogging)];
        for compensated in [false, true] {
            let errors = trial.one(compensated).unwrap().errors;
            assert_eq!(errors[0].0, 0);
            let before = errors.iter().filter(|(time, _)| *time < 40_000_000);
            let peak = before.map(|(_, error)| error.abs()).fold(0.0, f64::max);
            assert!(peak < 5e-9, "{peak}");
        }
    }

    #[test]
    fn a_model_of_another_machine_is_refused_with_what_differs() {
        let mut other = trial();
        other.known.mass = 12.0;
        other.known.guides.truncate(2);
        let reported = other.run().unwrap_err().to_string();
        for words in ["12 kg", "40 kg", "2 guides", "4"] {
            assert!(reported.contains(words), "{reported}");
        }
    }
}
