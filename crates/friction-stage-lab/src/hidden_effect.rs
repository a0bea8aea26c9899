//! Recordings to try identification on: a stage that has an effect which its declared model lacks.
//!
//! In comes a seed, and a model where it is not one of ours; out come the declared model, the real
//! one and two recordings of the real one in closed loop: one to identify on and one to check.

use std::sync::LazyLock;

use rand::{RngExt as _, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Deserialize;

use friction_stage_core::control::{ControllerSettings, Point};
use friction_stage_core::model::{EffectParameters, GuideSource, StageModel};
use friction_stage_core::plant::Rates;

use super::specimen::{LabError, LabRecording, Row, Settings, closed_loop};

/// As errors name it.
const NAME: &str = "recordings";
/// Samples per second, Hz.
const RATE: f64 = 2000.0;
/// Largest relative difference of mass and guides between the declared stage and the real one.
/// Assumed: well within the tolerances that identification allows.
const MASS_TOLERANCE: f64 = 0.002;
const GUIDE_TOLERANCE: f64 = 0.03;

/// Moves as position after it, mm, its time, s, and the rest after it, s. Slow and fast, short
/// within the presliding of the guides and long.
const TRAIN: [(f64, f64, f64); 18] = [
    (-50.0, 0.6, 0.3),
    (-49.99, 0.1, 0.2),
    (-50.0, 0.1, 0.2),
    (-49.96, 0.2, 0.2),
    (-50.0, 0.2, 0.2),
    (-48.0, 0.8, 0.1),
    (-50.0, 0.8, 0.1),
    (-20.0, 1.5, 0.1),
    (-50.0, 1.5, 0.1),
    (50.0, 1.0, 0.15),
    (-50.0, 1.0, 0.15),
    (50.0, 0.5, 0.15),
    (-50.0, 0.5, 0.15),
    (100.0, 0.4, 0.2),
    (-50.0, 0.4, 0.2),
    (0.0, 0.1, 0.3),
    (-50.0, 0.1, 0.3),
    (0.0, 0.5, 0.3),
];
const CHECK: [(f64, f64, f64); 11] = [
    (30.0, 0.5, 0.3),
    (29.98, 0.15, 0.2),
    (30.0, 0.15, 0.2),
    (10.0, 1.2, 0.1),
    (60.0, 1.0, 0.1),
    (-40.0, 0.7, 0.2),
    (-80.0, 1.0, 0.1),
    (20.0, 0.35, 0.2),
    (-30.0, 0.1, 0.3),
    (20.0, 0.1, 0.3),
    (0.0, 0.6, 0.3),
];

/// A stage with an effect that its declared model lacks, and recordings of it.
#[derive(Clone, Debug, PartialEq)]
pub struct HiddenEffect {
    /// What a user knows of the stage.
    pub declared: StageModel,
    /// What it is: within the tolerances of the declared one, and with the effect.
    pub real: StageModel,
    /// To identify on.
    pub train: LabRecording,
    /// To check on, with other moves.
    pub check: LabRecording,
}

impl HiddenEffect {
    /// The stage of a seed, which decides on the effect, its values and the noise of the sensors.
    pub fn new(seed: u64) -> Result<HiddenEffect, LabError> {
        let declared =
            StageModel { name: "stage as declared".to_owned(), ..StageModel::on_guides("guide_1") };
        HiddenEffect::made(declared, |random| vec![hidden(random)], seed)
    }

    /// The stage of `model`, which hides all its effects. The seed decides by how much mass and
    /// guides differ from those of the model, and on the noise of the sensors.
    pub fn of(model: &StageModel, seed: u64) -> Result<HiddenEffect, LabError> {
        let declared = StageModel { effects: Vec::new(), ..model.clone() };
        HiddenEffect::made(declared, |_| model.effects.clone(), seed)
    }

    fn made(
        declared: StageModel,
        effects: impl FnOnce(&mut ChaCha8Rng) -> Vec<EffectParameters>,
        seed: u64,
    ) -> Result<HiddenEffect, LabError> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut guides = declared.resolved_guides()?;
        let mut about = |tolerance: f64| random.random_range(1.0 - tolerance..1.0 + tolerance);
        let mass = declared.mass * about(MASS_TOLERANCE);
        let [viscous, friction, stiffness] = [(); 3].map(|()| about(GUIDE_TOLERANCE));
        for guide in &mut guides {
            guide.viscous_friction *= viscous;
            guide.coulomb_force *= friction;
            guide.static_force *= friction;
            guide.stiffness *= stiffness;
        }
        let real = StageModel {
            name: "stage as it is".to_owned(),
            mass,
            guides: guides.into_iter().map(GuideSource::Inline).collect(),
            effects: effects(&mut random),
            ..declared.clone()
        };
        let train = record("train", &real, &TRAIN, seed.wrapping_mul(2))?;
        let check = record("check", &real, &CHECK, seed.wrapping_mul(2).wrapping_add(1))?;
        Ok(HiddenEffect { declared, real, train, check })
    }
}

/// An effect that a stage may hide, with the range of each value.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Hideable {
    name: String,
    /// In the order in which they are drawn.
    values: Vec<(String, [f64; 2])>,
}

/// One of `hidden_effects.yaml`.
fn hidden(random: &mut ChaCha8Rng) -> EffectParameters {
    static HIDEABLE: LazyLock<Vec<Hideable>> = LazyLock::new(|| {
        serde_saphyr::from_str(include_str!("hidden_effects.yaml"))
            .expect("a test reads the effects that this crate contains")
    });
    let chosen = random.random_range(0.0..HIDEABLE.len() as f64) as usize;
    let chosen = &HIDEABLE[chosen];
    let mut draw = |&[low, high]: &[f64; 2]| random.random_range(low..high);
    let values = chosen.values.iter().map(|(key, range)| (key.as_str(), draw(range)));
    EffectParameters::new(&chosen.name, values.collect::<Vec<_>>())
}

fn record(
    name: &str,
    model: &StageModel,
    moves: &[(f64, f64, f64)],
    seed: u64,
) -> Result<LabRecording, LabError> {
    let settings = Settings { seed, rates: rates()? };
    within_stroke(model, moves)?;
    let mut time = 0.0;
    let mut points = vec![at_rest(0.5, 0.0)];
    time += 0.5;
    for (target, duration, rest) in moves {
        for wait in [*duration, *rest] {
            time += wait;
            points.push(at_rest(time, 1e-3 * target));
        }
    }
    let paper = ControllerSettings::paper(model.mass, RATE, model.motor.force_limit);
    let mut run = closed_loop(model, &settings, paper, points)?;
    let samples = (time * RATE).ceil() as usize;
    let rows = (0..samples).map(|_| Ok(Row::of(&run.cycle()?)));
    let rows = rows.collect::<Result<Vec<_>, LabError>>()?;
    // A motor at its limit would hide more than the effect.
    let limit = model.motor.force_limit;
    match rows.iter().filter(|row| row.force.abs() >= limit).count() as u64 {
        0 => Ok(LabRecording { name: name.to_owned(), model: model.clone(), settings, rows }),
        samples => {
            let (experiment, specimen) = (NAME, "stage".to_owned());
            Err(LabError::MotorLimit { experiment, specimen, limit, samples })
        }
    }
}

/// Refuses a stage that cannot go as far as the moves.
fn within_stroke(model: &StageModel, moves: &[(f64, f64, f64)]) -> Result<(), LabError> {
    let Some(stroke) = &model.stroke else { return Ok(()) };
    let beyond = moves.iter().map(|(target, ..)| 1e-3 * target);
    match beyond.into_iter().find(|target| !(stroke.low..=stroke.high).contains(target)) {
        None => Ok(()),
        Some(target) => Err(LabError::Signal {
            experiment: NAME,
            specimen: "stage".to_owned(),
            what: format!(
                "the moves go to {target} m, the stroke of the model is {} to {} m",
                stroke.low, stroke.high
            ),
        }),
    }
}

fn rates() -> Result<Rates, LabError> {
    Rates::of_control(RATE).map_err(|error| LabError::Signal {
        experiment: NAME,
        specimen: "stage".to_owned(),
        what: error.to_string(),
    })
}

fn at_rest(time: f64, position: f64) -> Point {
    Point::at_rest((time * 1e9).round() as i64, position)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_always_gives_the_same_stage_and_another_seed_another() {
        let one = HiddenEffect::new(1).unwrap();
        assert_eq!(HiddenEffect::new(1).unwrap(), one);
        assert_ne!(HiddenEffect::new(2).unwrap().real, one.real);
        assert!(one.declared.effects.is_empty());
    }

    #[test]
    fn a_stage_that_cannot_make_the_moves_is_refused() {
        let of = |yaml: &str| {
            let effects = "effects:\n  - constant_force: {amplitude: 5.0}\n";
            let model = StageModel::from_yaml(&format!("{yaml}\n{effects}"), "a test").unwrap();
            HiddenEffect::of(&model, 1).unwrap_err().to_string()
        };
        let weak = of("motor: {force_limit: 351.5}");
        assert!(weak.contains("more force than the motor has (351.5 N)"), "{weak}");
        let short = of("stroke: {low: -0.04, high: 0.2}");
        assert!(short.contains("to -0.05 m") && short.contains("-0.04 to 0.2 m"), "{short}");
    }
}
