//! The loop as it is computed, against python-control for linear stages and against a sine on the
//! emulator for guides with friction.

use friction_stage_core::control::ControllerSettings;
use friction_stage_core::model::{EffectParameters, Guide, GuideSource, StageModel};
use friction_stage_core::plant::Rates;
use friction_stage_lab::{
    LoopResponse, MeasuredLoopPoint, SampledStage, Settings, StageMotion, loop_frequencies,
    measure_loop,
};
use serde::Deserialize;

/// Of the magnitude of a measured loop.
const TOLERANCE: f64 = 0.02;

#[derive(Deserialize)]
struct Case {
    name: String,
    mass: f64,
    stiffness: f64,
    damping: f64,
    motor_lag: f64,
    delay_samples: u32,
    rate: f64,
    bandwidth: f64,
    frequency: Vec<f64>,
    open_loop: Vec<[f64; 2]>,
    stable: bool,
    crossover: f64,
    phase_margin: f64,
    gain_margin: Option<f64>,
    least_gain: Option<f64>,
    modulus_margin: f64,
}

impl Case {
    /// A bristle that never slips is a spring and a damper.
    fn model(&self) -> StageModel {
        let guide = Guide {
            stiffness: self.stiffness.max(1.0),
            bristle_damping: self.damping,
            viscous_friction: 0.0,
            coulomb_force: 1e9,
            static_force: 1e9,
            stribeck_velocity: 1.0,
            damping_velocity: None,
        };
        let lag = [("time_constant", self.motor_lag)];
        let effects = (self.motor_lag > 0.0).then(|| EffectParameters::new("actuator_lag", lag));
        StageModel {
            mass: self.mass,
            guides: vec![GuideSource::Inline(guide)],
            effects: effects.into_iter().collect(),
            ..StageModel::default()
        }
    }

    fn loop_at(&self, frequencies: &[f64]) -> LoopResponse {
        let motion = match self.stiffness > 0.0 {
            true => StageMotion::Amplitude(1e-7),
            false => StageMotion::PlainMass,
        };
        let delay = f64::from(self.delay_samples) / self.rate;
        let stage =
            SampledStage::new(&self.model(), self.rate, delay, motion, frequencies).unwrap();
        let controller = ControllerSettings::of_model(&self.model(), self.bandwidth, self.rate);
        LoopResponse::new(&stage, &controller)
    }
}

fn cases() -> Vec<Case> {
    serde_json::from_str(include_str!("oracle/loops.json")).unwrap()
}

#[test]
fn open_loop_of_linear_stages_is_that_of_python_control() {
    for case in cases() {
        let found = case.loop_at(&case.frequency);
        for (point, [re, im]) in found.points.iter().zip(&case.open_loop) {
            let error = (point.open_loop.re - re).hypot(point.open_loop.im - im);
            // The images of the sampling that are left out, and the polygon of the motion.
            let tolerance = 1e-3 * re.hypot(*im) + 1e-5;
            assert!(error < tolerance, "{}: {point:?}, expected {re} {im}", case.name);
            let identity = point.sensitivity + point.complementary;
            assert!((identity.re - 1.0).abs() < 1e-9 && identity.im.abs() < 1e-9);
        }
    }
}

#[test]
fn margins_of_linear_loops_are_those_of_python_control() {
    for case in cases() {
        let found = case.loop_at(&loop_frequencies(case.rate)).margins();
        assert_eq!(found.stable, case.stable, "{}: {found:?}", case.name);
        let near = |found: f64, expected: f64, relative: f64| {
            assert!(
                (found / expected - 1.0).abs() < relative,
                "{}: {found}, expected {expected}",
                case.name
            );
        };
        near(found.crossover.unwrap(), case.crossover, 2e-3);
        near(found.phase_margin.unwrap(), case.phase_margin, 1e-2);
        // A distance from -1, where the whole circle has radius 1.
        let distance = (found.modulus_margin - case.modulus_margin).abs();
        assert!(distance < 1e-3, "{}: {found:?}", case.name);
        for (found, expected) in
            [(found.gain_margin, case.gain_margin), (found.least_gain, case.least_gain)]
        {
            assert_eq!(found.is_some(), expected.is_some(), "{}: {found:?}", case.name);
            if let (Some(found), Some(expected)) = (found, expected) {
                near(found, expected, 5e-3);
            }
        }
    }
}

/// Guides from sticking to sliding, and a motor that is late and weak: what the describing function
/// says is what a sine on the emulator shows, sensor noise included.
#[test]
fn measured_loops_are_the_computed_ones_where_the_measurement_is_good() {
    let late = EffectParameters::new("actuator_lag", [("time_constant", 3e-4), ("delay", 2e-4)]);
    let weak = EffectParameters::new("motor_gain", [("fraction", -0.05)]);
    let mut with_effects = StageModel::on_guides("guide_2");
    with_effects.effects = vec![late, weak];
    let frequencies = [5.0, 12.0, 25.0, 40.0, 60.0, 90.0, 150.0, 250.0];
    for model in [StageModel::on_guides("guide_1"), with_effects] {
        let settings = Settings { seed: 3, rates: Rates::DEFAULT };
        let controller = ControllerSettings::of_model(&model, 60.0, 4000.0);
        let mut good = 0;
        for amplitude in [2e-7, 2e-6, 2e-5, 2e-4] {
            let measured =
                measure_loop(&model, &settings, &controller, amplitude, &frequencies).unwrap();
            // A describing function is of a sine: harmonics in the motion change the first harmonic
            // of the friction by up to twice their share.
            let is_good = |point: &&MeasuredLoopPoint| {
                point.coherence > 0.99 && point.distortion < 0.5 * TOLERANCE
            };
            for found in measured.iter().filter(is_good) {
                let motion = StageMotion::Amplitude(found.amplitude);
                let stage =
                    SampledStage::new(&model, 4000.0, 0.0, motion, &[found.frequency]).unwrap();
                let expected = LoopResponse::new(&stage, &controller).points[0].open_loop;
                let ratio = found.open_loop / expected;
                assert!(
                    (ratio.norm() - 1.0).abs() < TOLERANCE && ratio.arg().to_degrees().abs() < 2.0,
                    "{} at {} m, {} Hz: {} and {} degrees",
                    model.name,
                    found.amplitude,
                    found.frequency,
                    ratio.norm(),
                    ratio.arg().to_degrees()
                );
                good += 1;
            }
        }
        assert!(good >= 24, "only {good} points of {} are coherent", model.name);
    }
}
