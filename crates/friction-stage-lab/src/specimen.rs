//! What an experiment runs on: a guide type on the measuring rig and on the 40 kg stage.

use serde::{Deserialize, Deserializer, Serialize};

use friction_stage_core::control::{
    Controller, ControllerError, ControllerSettings, Gains, Point, Terms, Trajectory,
    TrajectoryError,
};
use friction_stage_core::model::{Guide, GuideSource, MAX_GUIDES, ModelError, StageModel};
use friction_stage_core::plant::effects::{EffectDescriptor, Effects, Role};
use friction_stage_core::plant::{BristleShare, Rates, Sample, Slip, Stage};

use super::distributed_fit::NoDistributedFit;
use super::finding::{Omission, Omitted};
use friction_stage_core::ClosedLoop;

/// Bandwidth of the rig's position servo, Hz. Assumed: the paper says closed loop and no more; as
/// the node's `drive: servo`.
pub const SERVO_BANDWIDTH: f64 = 60.0;

/// What an experiment runs on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Platform {
    /// One guide under a position servo, with a force cell.
    Rig,
    /// The stage on its guides.
    Stage,
}

/// One guide type, ready for the rig and for the stage.
#[derive(Clone, Debug, PartialEq)]
pub struct Specimen {
    /// Name in figures and tables.
    pub name: String,
    /// One guide behind a flexure coupling (paper, section 1.2).
    pub rig: StageModel,
    /// 40 kg on four of the guides (paper, section 4).
    pub stage: StageModel,
    /// Bandwidth of the stage's controller, Hz (paper, section 4: 60 Hz).
    pub bandwidth: f64,
    /// What was left out to come from one to the other, and on which of them.
    pub omissions: Vec<Omission>,
}

/// Seed of the sensor noise and rates of an experiment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Seed of the sensor noise.
    pub seed: u64,
    /// Rates of controller and simulation, Hz.
    pub rates: Rates,
}

/// An experiment that cannot be run or whose signals cannot be reduced.
#[derive(Debug, thiserror::Error)]
pub enum LabError {
    /// A model that cannot be.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A controller that cannot be.
    #[error(transparent)]
    Controller(#[from] ControllerError),
    /// A motion that cannot be.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
    /// Stiffnesses that no three bristles meet.
    #[error(transparent)]
    Distributed(#[from] NoDistributedFit),
    /// A run in which the motor was at its limit.
    #[error(
        "{experiment} on {specimen} needs more force than the motor has ({limit} N) in {samples} \
         samples: raise motor.force_limit or use a lighter stage"
    )]
    MotorLimit {
        /// Name of the experiment.
        experiment: &'static str,
        /// Name of the specimen.
        specimen: String,
        /// Largest force of the motor, N.
        limit: f64,
        /// Samples at the limit.
        samples: u64,
    },
    /// A move that needs more force than the motor has.
    #[error(
        "{experiment} on {specimen}: {the_move} of {} mm in {} ms needs {needed:.0} N to \
         accelerate {mass} kg, and the friction on top; the motor has {limit} N \
         (motor.force_limit): at least {:.1} ms would do",
        distance * 1e3, duration * 1e3, slowest * 1e3
    )]
    MoveForce {
        /// Name of the experiment.
        experiment: &'static str,
        /// Name of the specimen.
        specimen: String,
        /// Which of the moves, in words.
        the_move: &'static str,
        /// Way of the move, m.
        distance: f64,
        /// Time of the move, s.
        duration: f64,
        /// Peak force to accelerate the mass, N.
        needed: f64,
        /// Moving mass, kg.
        mass: f64,
        /// Largest force of the motor, N.
        limit: f64,
        /// Shortest time for which that limit is enough, friction left out, s.
        slowest: f64,
    },
    /// A value out of its range.
    #[error("{value} must be {limit}")]
    Limit {
        /// The value as given, SI units.
        value: f64,
        /// Its range, in words after "must be".
        limit: &'static str,
    },
    /// A move of one's own for an experiment that makes no such move.
    #[error(
        "distance, duration, mass and bandwidth are for fast-move and fine-step, not for \
         {experiment}"
    )]
    NoMove {
        /// Name of the experiment.
        experiment: &'static str,
    },
    /// Amplitudes for an experiment without loops.
    #[error("amplitudes are for the loops of dahl, not for {experiment}")]
    NoLoops {
        /// Name of the experiment.
        experiment: &'static str,
    },
    /// Two specimens of one name.
    #[error("two of the guides and models are called `{name}`: give each a name of its own")]
    SameName {
        /// The name that both have.
        name: String,
    },
    /// Signals that cannot be reduced.
    #[error("{experiment} on {specimen}: {what}")]
    Signal {
        /// Name of the experiment.
        experiment: &'static str,
        /// Name of the specimen.
        specimen: String,
        /// What is wrong with them, in words.
        what: String,
    },
}

/// One sample with the force that answers it; `terms` where a controller made that force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// What the sensors read.
    pub sample: Sample,
    /// Parts of the force; `None` where no controller made it.
    pub terms: Option<Terms>,
    /// N, held until the next sample.
    pub force: f64,
}

/// A run from its first sample on: enough to write a bag that repeats it.
#[derive(Clone, Debug, PartialEq)]
pub struct LabRecording {
    /// Name of the run, fit for a path.
    pub name: String,
    /// The stage or rig that ran.
    pub model: StageModel,
    /// Noise seed and rates of the run.
    pub settings: Settings,
    /// The samples in their order.
    pub rows: Vec<Row>,
}

/// A value with its standard error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredValue {
    /// Estimate, in the unit of the quantity; NaN (`null` in JSON) without samples.
    #[serde(deserialize_with = "number")]
    pub value: f64,
    /// Standard deviation of the estimate, in its unit; NaN (`null` in JSON) where unknown.
    #[serde(deserialize_with = "number")]
    pub standard_error: f64,
}

/// A number, which JSON has as null where it is none.
fn number<'de, D: Deserializer<'de>>(source: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(source)?.unwrap_or(f64::NAN))
}

impl Default for Settings {
    fn default() -> Settings {
        Settings { seed: 1, rates: Rates::DEFAULT }
    }
}

impl Specimen {
    /// A guide of the catalogue.
    pub fn of_guide(name: &str) -> Result<Specimen, ModelError> {
        Ok(Specimen {
            bandwidth: ControllerSettings::PAPER_BANDWIDTH,
            name: name.replace('_', " "),
            rig: StageModel::measuring_rig(name)?,
            stage: StageModel::on_guides(name),
            omissions: Vec::new(),
        })
    }

    /// The guides of a model: a stage as it is with its first guide on the rig, or a rig as it is
    /// with four of its guide under the stage of the paper. Sensors and motor are the model's own.
    ///
    /// Of the effects only those that belong to a guide go from one to the other; the rest is named
    /// in the omissions.
    pub fn of_model(model: &StageModel) -> Result<Specimen, ModelError> {
        model.check()?;
        let guides = model.resolved_guides()?;
        let first = model.guides[0].clone();
        let of_the_guide = |name: &str| {
            EffectDescriptor::find(name).is_ok_and(|effect| effect.role == Role::Bristles)
        };
        let effects: Vec<_> =
            model.effects.iter().filter(|effect| of_the_guide(&effect.name)).cloned().collect();
        let mut omissions = Vec::new();
        let mut omit = |platform, omitted| {
            omissions.push(Omission { platform, model: model.name.clone(), omitted });
        };
        let names = model.effects.iter().map(|effect| effect.name.clone());
        let left: Vec<String> = names.filter(|name| !of_the_guide(name)).collect();
        if !left.is_empty() {
            let other = match model.coupling {
                Some(_) => Platform::Stage,
                None => Platform::Rig,
            };
            omit(other, Omitted::Effects(left));
        }
        if guides.iter().any(|guide| guide != &guides[0]) {
            omit(Platform::Rig, Omitted::OtherGuides);
        }
        let same = StageModel { effects, ..model.clone() };
        let (rig, stage) = if model.coupling.is_some() {
            let stage = StageModel {
                name: format!("stage on the guide of {}", model.name),
                mass: StageModel::default().mass,
                guides: vec![first; MAX_GUIDES],
                coupling: None,
                ..same
            };
            (model.clone(), stage)
        } else {
            let mut rig = StageModel::measuring_rig("guide_1")?;
            if let Some(coupling) = &mut rig.coupling {
                coupling.stiffness = 100.0 * guides[0].stiffness;
            }
            rig = StageModel {
                name: format!("measuring rig with guides[0] of {}", model.name),
                guides: vec![first],
                mass: rig.mass,
                coupling: rig.coupling,
                // The rig moves as far as its experiments ask.
                stroke: None,
                ..same
            };
            (rig, model.clone())
        };
        let bandwidth = ControllerSettings::PAPER_BANDWIDTH;
        Ok(Specimen { name: model.name.clone(), rig, stage, bandwidth, omissions })
    }

    /// The guide type, parameters resolved.
    pub fn guide(&self) -> Result<Guide, ModelError> {
        Ok(self.rig.resolved_guides()?.swap_remove(0))
    }

    /// Longest break-away distance of the rig's bristles, m: Fs/sigma0 of one bristle; of several
    /// in parallel that of the one with the most strength for its stiffness.
    pub fn break_away_distance(&self) -> Result<f64, ModelError> {
        let guide = self.guide()?;
        let single = guide.static_force / guide.stiffness;
        let elements = Effects::new(&self.rig.effects)?.bristle_elements();
        Ok(single * elements.map_or(1.0, |elements| elements.last_break_away()))
    }

    /// The rig's bristle elements as guides, for whose slow loops closed forms hold that add up:
    /// one of a plain guide, several of one with bristles in parallel. `None` where there is more
    /// than LuGre bristles.
    pub fn bristles(&self) -> Result<Option<Vec<Guide>>, ModelError> {
        let guide = self.guide()?;
        if self.rig.effects.is_empty() {
            return Ok(Some(vec![guide]));
        }
        let mut only = true;
        for effect in &self.rig.effects {
            let (descriptor, values) = EffectDescriptor::read(effect)?;
            only &= matches!(descriptor.role_of(&values), Role::Bristles);
        }
        let elements = Effects::new(&self.rig.effects)?.bristle_elements();
        let Some(elements) = elements.filter(|of| only && of.slip == Slip::Gradual) else {
            return Ok(None);
        };
        let carrying =
            elements.shares.iter().filter(|share| share.stiffness > 0.0 && share.strength > 0.0);
        let element = |share: &BristleShare| Guide {
            stiffness: share.stiffness * guide.stiffness,
            bristle_damping: share.damping * guide.bristle_damping,
            coulomb_force: share.strength * guide.coulomb_force,
            static_force: share.strength * guide.static_force,
            ..guide.clone()
        };
        Ok(Some(carrying.map(element).collect()))
    }

    /// The same with other parameters of the guide.
    pub fn with_guide(mut self, guide: Guide) -> Specimen {
        self.rig.guides.fill(GuideSource::Inline(guide.clone()));
        self.stage.guides.fill(GuideSource::Inline(guide));
        self
    }

    /// The rig under its position servo, following `points` from its first sample on.
    ///
    /// The servo is a PID on the encoder with lowpass and ideal mass feedforward, tuned for
    /// everything that the motor moves; the carriage's encoder is the one at the guide, as the
    /// paper places it.
    pub fn on_rig(
        &self,
        settings: &Settings,
        gains: Gains,
        points: Vec<Point>,
    ) -> Result<ClosedLoop, LabError> {
        let mass = self.rig.moving_mass();
        let paper =
            ControllerSettings::paper(mass, settings.rates.control(), self.rig.motor.force_limit);
        closed_loop(&self.rig, settings, ControllerSettings { gains, ..paper }, points)
    }

    /// Gains of the rig's servo for a bandwidth in Hz.
    pub fn servo(&self, bandwidth: f64) -> Gains {
        Gains::from_bandwidth(bandwidth, self.rig.moving_mass())
    }

    /// The stage under the paper's controller (section 4), with `viscous` N s/m of viscous
    /// feedforward.
    pub fn on_stage(
        &self,
        settings: &Settings,
        viscous: f64,
        points: Vec<Point>,
    ) -> Result<ClosedLoop, LabError> {
        let paper = ControllerSettings::paper(
            self.stage.mass,
            settings.rates.control(),
            self.stage.motor.force_limit,
        );
        let controller = ControllerSettings {
            gains: Gains::from_bandwidth(self.bandwidth, self.stage.mass),
            viscous_feedforward: viscous,
            ..paper
        };
        closed_loop(&self.stage, settings, controller, points)
    }
}

/// A stage of `model` under a controller that follows `points` from its first sample on.
pub fn closed_loop(
    model: &StageModel,
    settings: &Settings,
    controller: ControllerSettings,
    points: Vec<Point>,
) -> Result<ClosedLoop, LabError> {
    let stage = Stage::new(model, settings.rates, settings.seed)?;
    Ok(ClosedLoop::new(stage, Controller::new(controller)?, Trajectory::new(0, points)?))
}

impl Row {
    /// The sample of a cycle with the force that its controller made.
    pub fn of(cycle: &friction_stage_core::Cycle) -> Row {
        Row { sample: cycle.sample, terms: Some(cycle.terms), force: cycle.terms.output }
    }
}

/// Refuses a run in which the motor was at its limit: its curves would show the motor.
pub(super) fn within_motor(
    experiment: &'static str,
    specimen: &Specimen,
    model: &StageModel,
    rows: &[Row],
) -> Result<(), LabError> {
    let limit = model.motor.force_limit;
    let samples = rows.iter().filter(|row| row.force.abs() >= limit).count() as u64;
    if samples == 0 {
        return Ok(());
    }
    Err(LabError::MotorLimit { experiment, specimen: specimen.name.clone(), limit, samples })
}

/// Mean with its standard error, for independent samples.
pub(super) fn mean(values: impl Iterator<Item = f64>) -> MeasuredValue {
    let (mut count, mut mean, mut squares) = (0.0, 0.0, 0.0);
    for value in values {
        count += 1.0;
        let difference = value - mean;
        mean += difference / count;
        squares += difference * (value - mean);
    }
    let standard_error =
        if count > 1.0 { (squares / (count - 1.0) / count).sqrt() } else { f64::NAN };
    MeasuredValue { value: if count > 0.0 { mean } else { f64::NAN }, standard_error }
}

/// A point of a trajectory at rest, `time` in s.
pub(super) fn rest(time: f64, position: f64) -> Point {
    moving(time, position, 0.0)
}

/// A point of a trajectory that passes with a constant velocity, `time` in s.
pub(super) fn moving(time: f64, position: f64, velocity: f64) -> Point {
    Point {
        time: (time * 1e9).round() as i64,
        position,
        velocity: Some(velocity),
        acceleration: Some(0.0),
        effort: 0.0,
    }
}
