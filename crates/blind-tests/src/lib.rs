//! A generator of recordings like those of a real stage, for blind tests of identification.
//!
//! What goes in is a [`Setup`] (a seed, the hidden effects, the motion programme); what comes out
//! is a [`GeneratedRun`] with a train and a check record and the [`Truth`]. Nothing here uses the
//! library's plant, controller, motion or noise: equations, integrator, controller, programme,
//! effects and random numbers are written apart, so that what identification finds is not its own
//! model read back. `bags` alone uses the library, to write what it will read.
//!
//! As in the recorded stage runs: 2 kHz; at tick k encoder and force cell are read first, then the
//! command of tick k acts until k + 1, so the cell at k shows the motor force at the end of the
//! interval that ends at k. Encoder: counts of 1 nm and 1 nm rms noise. Cell: 0.05 N rms. Mass
//! within 0.5 %, guide parameters within 16 % of nominal, each guide its own.

pub mod bags;
pub mod controller;
pub mod effects;
pub mod guides;
pub mod noise;
pub mod programme;
pub mod recordings;
pub mod stage;

use std::collections::BTreeMap;

use serde::Serialize;

pub use effects::{Effect, Side};
pub use guides::Guide;
pub use programme::Programme;

use controller::Controller;
use guides::GUIDES;
use noise::Noise;
use programme::Setpoints;
use stage::Stage;

/// Declared mass of the recorded stage runs, kg; the feedforward uses it.
pub const NOMINAL_MASS: f64 = 40.0;
/// Crossover of the controller, Hz.
pub const BANDWIDTH: f64 = 60.0;
/// Rates of other machines, Hz.
const RATES: [f64; 6] = [250.0, 500.0, 1000.0, 2000.0, 4000.0, 10_000.0];
/// Finest and coarsest count of their encoders, m.
const FINEST: f64 = 0.2e-9;
const COARSEST: f64 = 10e-6;
/// How far their encoders read from their instants at most, samples.
const LATEST: f64 = 0.05;
/// Force by which their controllers answer one count at most, N: they are damped above a sixth of
/// the filter's corner, where a count weighs 6 m wc^2.
const KICK: f64 = 10.0;
/// Samples in a period of the crossover at least: with fewer the delay of the loop makes it ring.
const SAMPLES_PER_CROSSOVER: f64 = 33.0;
/// A position error above this (m) means that the loop lost the stage.
const LOST: f64 = 5e-3;

/// Noise of the sensors.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SensorNoise {
    /// Encoder, rms, m.
    pub encoder: f64,
    /// Count of the encoder, m; 0 for none.
    pub count: f64,
    /// Force cell, rms, N.
    pub cell: f64,
}

impl Default for SensorNoise {
    fn default() -> Self {
        Self { encoder: 1e-9, count: 1e-9, cell: 0.05 }
    }
}

/// What to generate.
#[derive(Debug, Clone)]
pub struct Setup {
    /// Seed of everything random.
    pub seed: u64,
    /// Hidden effects.
    pub effects: Vec<Effect>,
    /// Motion.
    pub programme: Programme,
    /// Sensors.
    pub noise: SensorNoise,
    /// Tolerance of the mass, a share of the nominal one.
    pub mass_tolerance: f64,
    /// Tolerance of the guides' parameters, a share.
    pub guide_tolerance: f64,
    /// Ticks per second, Hz.
    pub rate: f64,
    /// Longest step of the integrator, s.
    pub step: f64,
    /// Crossover of the controller, Hz.
    pub bandwidth: f64,
    /// How late the encoder is read, samples; negative: early.
    pub late: f64,
}

impl Setup {
    /// Nothing hidden, everything else as in the recorded stage runs.
    pub fn new(seed: u64) -> Self {
        Self {
            seed,
            effects: Vec::new(),
            programme: Programme::default(),
            noise: SensorNoise::default(),
            mass_tolerance: 0.005,
            guide_tolerance: 0.16,
            rate: 2000.0,
            step: 20e-6,
            bandwidth: BANDWIDTH,
            late: 0.0,
        }
    }

    /// A machine of another kind: its rate (250 Hz to 10 kHz), its encoder (white noise or counts
    /// of 0.2 nm to 10 µm) and how exactly that keeps its instant are drawn. Its controller is as
    /// fast as rate and counts allow: a count makes it kick by no more than 10 N.
    pub fn drawing_machine(mut self) -> Self {
        let mut drawn = Noise::new(self.seed, 12);
        self.rate = RATES[drawn.index(RATES.len())];
        let count = drawn.log_between(FINEST, COARSEST);
        let is_white = drawn.unit() < 0.5;
        self.noise.encoder = if is_white { count / 12f64.sqrt() } else { 0.0 };
        self.noise.count = if is_white { 0.0 } else { count };
        self.late = drawn.between(-LATEST, LATEST);
        let by_count = (KICK / (6.0 * NOMINAL_MASS * count)).sqrt() / std::f64::consts::TAU;
        self.bandwidth = BANDWIDTH.min(self.rate / SAMPLES_PER_CROSSOVER).min(by_count);
        self
    }

    /// With one more hidden effect.
    pub fn with(mut self, effect: impl Into<Effect>) -> Self {
        self.effects.push(effect.into());
        self
    }

    /// With these hidden effects.
    pub fn with_all(mut self, effects: Vec<Effect>) -> Self {
        self.effects.extend(effects);
        self
    }

    /// Runs both records.
    pub fn generate(&self) -> Result<GeneratedRun, GenerateError> {
        let mut drawn = Noise::new(self.seed, 1);
        let mass = NOMINAL_MASS * (1.0 + self.mass_tolerance * drawn.between(-1.0, 1.0));
        let guides = [(); GUIDES].map(|()| Guide::draw(self.guide_tolerance, &mut drawn));
        let mut motion = Noise::new(self.seed, 2);
        let (train, train_truth) =
            self.record(mass, guides, &self.programme.train(self.rate, &mut motion), "train", 3)?;
        let (check, check_truth) =
            self.record(mass, guides, &self.programme.check(self.rate, &mut motion), "check", 4)?;
        let effects = self.effects.iter().map(EffectTruth::of).collect();
        let truth = Truth {
            seed: self.seed,
            mass,
            guides,
            noise: self.noise,
            effects,
            hidden_force_rms: HiddenRms {
                train: train_truth.hidden_rms(),
                check: check_truth.hidden_rms(),
            },
            train: train_truth,
            check: check_truth,
        };
        Ok(GeneratedRun { train, check, truth })
    }

    /// Runs one record; `purpose` picks its random numbers.
    pub fn record(
        &self,
        mass: f64,
        guides: [Guide; GUIDES],
        setpoints: &Setpoints,
        record: &'static str,
        purpose: u64,
    ) -> Result<(Columns, RecordTruth), GenerateError> {
        let mut sensors = Noise::new(self.seed, 100 + purpose);
        let mut wander = Noise::new(self.seed, 200 + purpose);
        let mut effects = self.effects.clone();
        effects.iter_mut().for_each(|effect| effect.begin(&mut wander));
        let count = effects.len();
        let mut stage = Stage::new(mass, guides, effects, 1.0 / self.rate, self.step);
        let mut controller = Controller::new(NOMINAL_MASS, self.bandwidth, self.rate);
        let mut columns = Columns {
            reference_position: setpoints.position.clone(),
            reference_velocity: setpoints.velocity.clone(),
            reference_acceleration: setpoints.acceleration.clone(),
            ..Columns::default()
        };
        let mut truth = RecordTruth::new(&self.effects);
        let (mut forces, mut encoder, mut cell) =
            (vec![0.0; count], vec![0.0; count], vec![0.0; count]);
        for (k, &reference) in setpoints.position.iter().enumerate() {
            let moment = stage.moment(&mut forces);
            stage.reading_errors(moment.motor_force, &mut encoder, &mut cell);
            let exact = moment.position - self.late / self.rate * moment.velocity
                + encoder.iter().sum::<f64>()
                + self.noise.encoder * sensors.normal();
            let position = if self.noise.count > 0.0 {
                (exact / self.noise.count).round() * self.noise.count
            } else {
                exact
            };
            let force_cell =
                moment.motor_force + cell.iter().sum::<f64>() + self.noise.cell * sensors.normal();
            let error = reference - position;
            if error.is_nan() || error.abs() > LOST {
                let names = self.effects.iter().map(|e| e.name()).collect();
                return Err(GenerateError::Lost {
                    record,
                    time: k as f64 / self.rate,
                    error,
                    effects: names,
                });
            }
            let command = controller.force(error, setpoints.acceleration[k]);
            columns.time.push(k as f64 / self.rate);
            columns.position.push(position);
            columns.force_cell.push(force_cell);
            columns.force.push(command);
            truth.push(&moment, &forces, &encoder, &cell);
            stage.advance(command, &mut wander);
        }
        Ok((columns, truth))
    }
}

impl<L: effects::Law + 'static> From<L> for Effect {
    fn from(law: L) -> Self {
        Box::new(law)
    }
}

/// One record, as the topics of the stage show it; all columns have the same length.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Columns {
    /// s from the first row.
    pub time: Vec<f64>,
    /// Setpoint, m.
    pub reference_position: Vec<f64>,
    /// Setpoint, m/s.
    pub reference_velocity: Vec<f64>,
    /// Setpoint, m/s^2.
    pub reference_acceleration: Vec<f64>,
    /// Encoder, m.
    pub position: Vec<f64>,
    /// Force cell, N: at row k the motor force at the end of the interval that ends there.
    pub force_cell: Vec<f64>,
    /// Command, N: that of row k acts until row k + 1.
    pub force: Vec<f64>,
}

/// A pair of records with what is true about them.
#[derive(Debug, Clone)]
pub struct GeneratedRun {
    /// To identify on.
    pub train: Columns,
    /// To score on.
    pub check: Columns,
    /// What identification is not given.
    pub truth: Truth,
}

/// What is true about a pair of records.
#[derive(Debug, Clone, Serialize)]
pub struct Truth {
    /// Seed of the run.
    pub seed: u64,
    /// True mass of the carriage without payload, kg.
    pub mass: f64,
    /// True guides.
    pub guides: [Guide; GUIDES],
    /// Noise of the sensors.
    pub noise: SensorNoise,
    /// Hidden effects.
    pub effects: Vec<EffectTruth>,
    /// Rms of the hidden forces together, N.
    pub hidden_force_rms: HiddenRms,
    /// Signals of the train record.
    #[serde(skip)]
    pub train: RecordTruth,
    /// Signals of the check record.
    #[serde(skip)]
    pub check: RecordTruth,
}

/// Rms of the hidden forces together, N.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct HiddenRms {
    /// Over the train record.
    pub train: f64,
    /// Over the check record.
    pub check: f64,
}

/// A hidden effect.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct EffectTruth {
    /// Canonical name.
    pub name: &'static str,
    /// Where it acts.
    pub side: Side,
    /// Whether a candidate of that name exists.
    pub listed: bool,
    /// What the force of an unlisted effect follows.
    pub coordinate: Option<&'static str>,
    /// True parameters, SI.
    pub parameters: BTreeMap<&'static str, f64>,
}

impl EffectTruth {
    fn of(effect: &Effect) -> Self {
        Self {
            name: effect.name(),
            side: effect.side(),
            listed: effect.listed(),
            coordinate: effect.coordinate(),
            parameters: effect.parameters().into_iter().collect(),
        }
    }
}

/// True signals of a record, at the rows of its [`Columns`].
#[derive(Debug, Clone, Default)]
pub struct RecordTruth {
    /// m.
    pub position: Vec<f64>,
    /// m/s.
    pub velocity: Vec<f64>,
    /// m/s^2, at the end of the interval that ends at the row.
    pub acceleration: Vec<f64>,
    /// N, at the end of the interval that ends at the row.
    pub motor_force: Vec<f64>,
    /// Friction of all guides with the hidden effects, N; positive opposes +v.
    pub friction_force: Vec<f64>,
    /// What each hidden effect does, in the order of [`Truth::effects`].
    pub hidden: Vec<Hidden>,
}

/// What one hidden effect does in a record.
#[derive(Debug, Clone, Default)]
pub struct Hidden {
    /// Canonical name.
    pub name: &'static str,
    /// Force that it adds, N, positive along +x: to the motor force, or to the forces on a rigid
    /// carriage of the true mass.
    pub force: Vec<f64>,
    /// Error of the encoder, m.
    pub encoder: Vec<f64>,
    /// Error of the force cell, N.
    pub cell: Vec<f64>,
}

impl Hidden {
    /// Rms of the force, N.
    pub fn force_rms(&self) -> f64 {
        rms(&self.force)
    }
}

/// Root of the mean square.
pub fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
}

impl RecordTruth {
    fn new(effects: &[Effect]) -> Self {
        let hidden =
            effects.iter().map(|e| Hidden { name: e.name(), ..Hidden::default() }).collect();
        Self { hidden, ..Self::default() }
    }

    fn push(&mut self, moment: &stage::Moment, forces: &[f64], encoder: &[f64], cell: &[f64]) {
        self.position.push(moment.position);
        self.velocity.push(moment.velocity);
        self.acceleration.push(moment.acceleration);
        self.motor_force.push(moment.motor_force);
        self.friction_force.push(moment.friction_force);
        for (index, hidden) in self.hidden.iter_mut().enumerate() {
            hidden.force.push(forces[index]);
            hidden.encoder.push(encoder[index]);
            hidden.cell.push(cell[index]);
        }
    }

    /// Force of all hidden effects together, N.
    pub fn hidden_force(&self) -> Vec<f64> {
        (0..self.position.len()).map(|k| self.hidden.iter().map(|h| h.force[k]).sum()).collect()
    }

    fn hidden_rms(&self) -> f64 {
        rms(&self.hidden_force())
    }
}

/// Why there is no run.
#[derive(Debug, thiserror::Error)]
pub enum GenerateError {
    /// The position error became too large.
    #[error(
        "{record}: {error} m of position error at {time} s, more than 5 mm: the controller lost \
         the stage with {effects:?}"
    )]
    Lost {
        /// Which record.
        record: &'static str,
        /// s.
        time: f64,
        /// m.
        error: f64,
        /// Names of the hidden effects.
        effects: Vec<&'static str>,
    },
    /// A bag could not be written.
    #[error(transparent)]
    Bag(#[from] friction_stage_data::bag::BagError),
    /// A file of the truth could not be written.
    #[error("{path}: {source}")]
    Write {
        /// Which.
        path: std::path::PathBuf,
        /// Why.
        source: std::io::Error,
    },
}
