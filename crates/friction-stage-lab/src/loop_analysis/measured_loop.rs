//! A loop that was measured on a running stage: its file, its margins, and how it differs from the
//! loop of a model.

use friction_stage_core::numerics::plain;
use nalgebra::Complex;
use serde::{Deserialize, Serialize};

use friction_stage_core::control::{
    AntiWindup, ControllerError, ControllerSettings, Gains, ObserverSettings,
};
use friction_stage_core::model::{ModelError, StageModel};
use friction_stage_core::yaml;

use super::margins::{LoopPoint, LoopResponse, Margins};
use super::measurement::MeasuredLoopPoint;
use super::stage::{SampledStage, StageMotion};

/// Coherence from which a point counts: the standard deviation of its magnitude is then 2.5 % at
/// most, of eight averages (Bendat, Piersol, Random Data, 4th ed. 2010, table 9.6).
pub const COHERENT: f64 = 0.99;
/// Distortion up to which a describing function describes a point: harmonics in the motion change
/// the first harmonic of the friction by up to twice their share.
pub const UNDISTORTED: f64 = 0.01;
/// Most points of a file.
const MOST_POINTS: usize = 10_000;

/// A file of a measured loop that cannot be used.
#[expect(missing_docs, reason = "the message of each says what its fields are")]
#[derive(Debug, thiserror::Error)]
pub enum MeasuredLoopError {
    #[error("{origin}: not a measured loop: {problem}")]
    File { origin: String, problem: String },
    #[error("{origin}: schema_version is {found}, must be 1")]
    Version { origin: String, found: u32 },
    #[error("{origin}: controller: {problem}")]
    Controller { origin: String, problem: ControllerError },
    #[error("{origin}: {found} points, must be 1 to {MOST_POINTS}")]
    Count { origin: String, found: usize },
    #[error("{origin}: points[{index}].{key} is {}, must be {limit}", plain(*value))]
    Point { origin: String, index: usize, key: &'static str, value: f64, limit: String },
}

/// A measured loop, with the controller that closed it.
#[derive(Clone, Debug, PartialEq)]
pub struct MeasuredLoop {
    /// Of the controller; feedforward and limits do not count.
    pub settings: ControllerSettings,
    /// Amplitude of the force, N.
    pub force: f64,
    /// Of ascending frequency.
    pub points: Vec<MeasuredLoopPoint>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    schema_version: u32,
    controller: FileController,
    force: f64,
    /// For readers; worked out again from the points.
    #[serde(default)]
    margins: Option<serde_json::Value>,
    points: Vec<FilePoint>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileController {
    rate: f64,
    p: f64,
    i: f64,
    d: f64,
    lowpass_frequency: f64,
    lowpass_damping: f64,
    #[serde(default)]
    disturbance_observer: Option<FileObserver>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FileObserver {
    bandwidth: f64,
    mass: f64,
    delay: f64,
}

/// Complex numbers as real and imaginary part.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FilePoint {
    frequency: f64,
    amplitude: f64,
    open_loop: [f64; 2],
    stage: [f64; 2],
    coherence: f64,
    distortion: f64,
}

/// One frequency as measured and as the model says, for the amplitude of the measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ComparedPoint {
    /// As measured.
    pub measured: MeasuredLoopPoint,
    /// L of the model.
    pub model: Complex<f64>,
}

impl ComparedPoint {
    /// Measured over computed: magnitude, and phase in degrees.
    pub fn difference(&self) -> (f64, f64) {
        let ratio = self.measured.open_loop / self.model;
        (ratio.norm(), ratio.arg().to_degrees())
    }

    /// Whether noise and harmonics are small enough for a comparison.
    pub fn counts(&self) -> bool {
        self.measured.coherence > COHERENT
            && self.measured.distortion < UNDISTORTED
            && self.difference().0.is_finite()
    }
}

/// A measured loop next to that of a model.
#[derive(Clone, Debug, PartialEq)]
pub struct LoopComparison {
    /// At each measured frequency.
    pub points: Vec<ComparedPoint>,
    /// From the coherent points; `None`: there are too few.
    pub measured: Option<Margins>,
    /// Of the model at the same frequencies.
    pub model: Option<Margins>,
}

impl LoopComparison {
    /// Largest differences over the points that count: of the magnitude, as a share, and of the
    /// phase, degrees; and how many points count.
    pub fn largest(&self) -> (f64, f64, usize) {
        let good = self.points.iter().filter(|point| point.counts());
        good.fold((0.0, 0.0, 0), |(gain, phase, count), point| {
            let (ratio, angle) = point.difference();
            (f64::max(gain, (ratio - 1.0).abs()), f64::max(phase, angle.abs()), count + 1)
        })
    }
}

impl MeasuredLoop {
    /// Its file.
    pub fn to_json(&self) -> Result<String, serde_json::Error> {
        let ControllerSettings { rate, gains, observer, .. } = &self.settings;
        let file = File {
            schema_version: 1,
            controller: FileController {
                rate: *rate,
                p: gains.p,
                i: gains.i,
                d: gains.d,
                lowpass_frequency: gains.lowpass_frequency,
                lowpass_damping: gains.lowpass_damping,
                disturbance_observer: observer.map(|observer| FileObserver {
                    bandwidth: observer.bandwidth,
                    mass: observer.mass,
                    delay: observer.delay,
                }),
            },
            force: self.force,
            margins: self.margins().map(serde_json::to_value).transpose()?,
            points: self.points.iter().map(FilePoint::of).collect(),
        };
        Ok(format!("{}\n", serde_json::to_string_pretty(&file)?))
    }

    /// The loop of a file; `origin` names it in errors.
    pub fn from_json(text: &str, origin: &str) -> Result<MeasuredLoop, MeasuredLoopError> {
        let origin = origin.to_owned();
        // JSON is YAML, whose reader says what is wrong in the words of a file.
        let file: File = match yaml::read(text) {
            Ok(file) => file,
            Err(problem) => return Err(MeasuredLoopError::File { origin, problem }),
        };
        if file.schema_version != 1 {
            return Err(MeasuredLoopError::Version { origin, found: file.schema_version });
        }
        if !(1..=MOST_POINTS).contains(&file.points.len()) {
            return Err(MeasuredLoopError::Count { origin, found: file.points.len() });
        }
        let controller = &file.controller;
        let settings = ControllerSettings {
            rate: controller.rate,
            gains: Gains {
                p: controller.p,
                i: controller.i,
                d: controller.d,
                lowpass_frequency: controller.lowpass_frequency,
                lowpass_damping: controller.lowpass_damping,
            },
            anti_windup: AntiWindup::ConditionalIntegration,
            limits: (-f64::MAX, f64::MAX),
            mass_feedforward: 0.0,
            viscous_feedforward: 0.0,
            observer: controller.disturbance_observer.as_ref().map(|observer| ObserverSettings {
                bandwidth: observer.bandwidth,
                limit: ObserverSettings::LIMIT,
                mass: observer.mass,
                delay: observer.delay,
                forward_delay: observer.delay,
            }),
        };
        if let Err(problem) = settings.check() {
            return Err(MeasuredLoopError::Controller { origin, problem });
        }
        let (mut last, highest) = (0.0, 0.5 * settings.rate);
        for (index, point) in file.points.iter().enumerate() {
            let refuse = |key, value, limit: &str| {
                let (origin, limit) = (origin.clone(), limit.to_owned());
                Err(MeasuredLoopError::Point { origin, index, key, value, limit })
            };
            if !(point.frequency > last && point.frequency <= highest) {
                let limit = format!("above the one before, {last} Hz, and at most {highest} Hz");
                return refuse("frequency", point.frequency, &limit);
            }
            last = point.frequency;
            if !(point.amplitude > 0.0 && point.amplitude <= 1.0) {
                return refuse("amplitude", point.amplitude, "above 0 and at most 1 m");
            }
            if !(0.0..=1.0 + 1e-9).contains(&point.coherence) {
                return refuse("coherence", point.coherence, "between 0 and 1");
            }
            if !(point.distortion.is_finite() && point.distortion >= 0.0) {
                return refuse("distortion", point.distortion, "finite and not negative");
            }
            for (key, value) in [("open_loop", point.open_loop), ("stage", point.stage)] {
                if !value.iter().all(|part| part.is_finite()) || value == [0.0; 2] {
                    return refuse(key, value[0], "finite and not 0");
                }
            }
        }
        let points = file.points.iter().map(FilePoint::point).collect();
        Ok(MeasuredLoop { settings, force: file.force, points })
    }

    /// The margins of the loop; `None` without enough coherent points.
    pub fn margins(&self) -> Option<Margins> {
        self.margins_of(|point| point.open_loop)
    }

    /// Those of another controller on the measured stage.
    pub fn margins_with(&self, controller: &ControllerSettings) -> Option<Margins> {
        self.margins_of(|point| point.stage * controller.transfer(point.frequency))
    }

    /// Margins between the coherent points. A loop that was measured held: whether another would
    /// cannot be seen from some of its frequencies.
    fn margins_of(
        &self,
        open_loop: impl Fn(&MeasuredLoopPoint) -> Complex<f64>,
    ) -> Option<Margins> {
        let coherent = self.points.iter().filter(|point| point.coherence > COHERENT);
        let points: Vec<LoopPoint> = coherent
            .map(|point| loop_point(point.frequency, open_loop(point), point.stage))
            .collect();
        let margins =
            (points.len() >= 3).then(|| LoopResponse { points, integrators: 0 }.margins());
        margins.map(|margins| Margins { stable: true, ..margins })
    }

    /// Next to the loop of a model with the same controller.
    pub fn compare(&self, model: &StageModel) -> Result<LoopComparison, ModelError> {
        let mut points = Vec::with_capacity(self.points.len());
        for measured in &self.points {
            let motion = StageMotion::Amplitude(measured.amplitude);
            let (rate, frequency) = (self.settings.rate, [measured.frequency]);
            let stage = SampledStage::new(model, rate, 0.0, motion, &frequency)?;
            let model = stage.response[0] * self.settings.transfer(measured.frequency);
            points.push(ComparedPoint { measured: *measured, model });
        }
        let of_model = MeasuredLoop {
            points: points
                .iter()
                .map(|point| MeasuredLoopPoint { open_loop: point.model, ..point.measured })
                .collect(),
            ..self.clone()
        };
        Ok(LoopComparison { points, measured: self.margins(), model: of_model.margins() })
    }
}

impl FilePoint {
    fn of(point: &MeasuredLoopPoint) -> FilePoint {
        FilePoint {
            frequency: point.frequency,
            amplitude: point.amplitude,
            open_loop: [point.open_loop.re, point.open_loop.im],
            stage: [point.stage.re, point.stage.im],
            coherence: point.coherence,
            distortion: point.distortion,
        }
    }

    fn point(&self) -> MeasuredLoopPoint {
        let complex = |[re, im]: [f64; 2]| Complex::new(re, im);
        MeasuredLoopPoint {
            frequency: self.frequency,
            amplitude: self.amplitude,
            open_loop: complex(self.open_loop),
            stage: complex(self.stage),
            coherence: self.coherence,
            distortion: self.distortion,
        }
    }
}

fn loop_point(frequency: f64, open_loop: Complex<f64>, stage: Complex<f64>) -> LoopPoint {
    let sensitivity = (open_loop + 1.0).inv();
    LoopPoint {
        frequency,
        open_loop,
        sensitivity,
        complementary: open_loop * sensitivity,
        process: stage * sensitivity,
    }
}
