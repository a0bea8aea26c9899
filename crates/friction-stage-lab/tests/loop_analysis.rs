//! The loop as it is computed, against python-control for linear stages and against a sine on the
//! emulator for guides with friction.

use friction_stage_core::control::{
    Compensation, CompensationTermsOn, Controller, ControllerSettings, Follower, ObserverSettings,
};
use friction_stage_core::model::{EffectParameters, Guide, GuideSource, StageModel};
use friction_stage_core::plant::{Rates, Stage};
use friction_stage_lab::{
    LoopProbe, LoopResponse, LoopSine, MeasuredLoop, MeasuredLoopPoint, SampledStage, Settings,
    StageMotion, loop_frequencies, measure_loop,
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
            stribeck_exponent: None,
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

/// The loop of a stage that runs on, one sine after the other, with a disturbance observer that
/// knows the motor's delay: what an autotuner would measure.
fn measured_on_a_running_stage(model: &StageModel) -> MeasuredLoop {
    let observer = ObserverSettings {
        bandwidth: 15.0,
        limit: 200.0,
        mass: 40.0,
        delay: 0.0,
        forward_delay: 0.0,
    };
    let plain = ControllerSettings {
        observer: Some(observer),
        ..ControllerSettings::of_model(model, 60.0, 4000.0)
    };
    let on = CompensationTermsOn::ALL;
    let settings = plain.informed(&Compensation::new(model, &plain, on).unwrap());
    let mut stage = Stage::new(model, Rates::DEFAULT, 5).unwrap();
    let mut controller = Controller::new(settings.clone()).unwrap();
    let mut follower = Follower::new(f64::INFINITY);
    let force = 20.0;
    let frequencies = [12.0, 20.0, 32.0, 50.0, 80.0, 120.0, 180.0, 260.0, 380.0];
    let sines = frequencies.map(|frequency| LoopSine { frequency, force }).to_vec();
    let mut probe = LoopProbe::new(sines, settings.rate);
    let length = probe.duration();
    let mut samples = 0.0;
    while probe.sine().is_some() {
        let sample = stage.sample();
        if sample.index == 0 {
            follower.hold(sample.time, sample.position);
        }
        let output = controller.update(sample.time, sample.position, &mut follower).output;
        let time = sample.time as f64 * 1e-9;
        stage.advance(output + probe.update(time, sample.position, output));
        samples += 1.0;
    }
    // A sine ends with the first sample after it.
    assert!((0.0..0.01).contains(&(samples / 4000.0 - length)), "{samples} samples, {length} s");
    MeasuredLoop { settings, force, points: probe.into_points() }
}

#[test]
fn a_loop_measured_on_a_running_stage_is_that_of_its_model_with_observer_and_late_motor() {
    let mut model = StageModel::on_guides("guide_2");
    let lag = [("time_constant", 3e-4), ("delay", 2e-4)];
    model.effects = vec![EffectParameters::new("actuator_lag", lag)];
    let measured = measured_on_a_running_stage(&model);
    let comparison = measured.compare(&model).unwrap();
    for point in &comparison.points {
        println!(
            "{:?} {:?} {:?}",
            point.difference(),
            point.measured.coherence,
            point.measured.distortion
        );
    }
    let (gain, phase, count) = comparison.largest();
    assert!(count >= 6 && gain < TOLERANCE && phase < 2.0, "{gain} {phase} {count}");
    let (found, expected) = (comparison.measured.unwrap(), comparison.model.unwrap());
    let near = |found: f64, expected: f64| (found / expected - 1.0).abs() < TOLERANCE;
    assert!(near(found.crossover.unwrap(), expected.crossover.unwrap()), "{found:?}");
    assert!((found.modulus_margin - expected.modulus_margin).abs() < TOLERANCE, "{found:?}");
    // Between the few frequencies of the measurement lies what many show.
    let motion = StageMotion::Amplitude(measured.points[4].amplitude);
    let stage = SampledStage::new(&model, 4000.0, 0.0, motion, &loop_frequencies(4000.0)).unwrap();
    let all = LoopResponse::new(&stage, &measured.settings).margins();
    assert!(all.stable && (all.modulus_margin - found.modulus_margin).abs() < 0.05, "{all:?}");
    // Another stage is distinguished from this one.
    let other = measured.compare(&StageModel { mass: 44.0, ..model.clone() }).unwrap();
    assert!(other.largest().0 > 2.0 * TOLERANCE, "{:?}", other.largest());
    // The same controller on the measured stage is the measured loop.
    let again = measured.margins_with(&measured.settings).unwrap();
    assert!((again.modulus_margin - found.modulus_margin).abs() < 1e-3, "{again:?} {found:?}");

    let text = measured.to_json().unwrap();
    let read = MeasuredLoop::from_json(&text, "loop.json").unwrap();
    assert_eq!(read.points, measured.points);
    assert_eq!(read.margins(), measured.margins());
    for (from, to, named) in [
        ("\"schema_version\": 1", "\"schema_version\": 2", "schema_version is 2"),
        ("\"rate\": 4000.0", "\"rate\": 40.0", "controller"),
        ("\"frequency\": 20.0", "\"frequency\": 2.0", "points[1].frequency is 2"),
        ("\"frequency\": 380.0", "\"frequency\": 3800.0", "points[8].frequency is 3800"),
        ("\"coherence\": ", "\"coherence\": -", "points[0].coherence"),
        ("\"amplitude\": ", "\"amplitude\": 1e999, \"x\": ", "not a measured loop"),
        ("{", "[", "not a measured loop"),
    ] {
        assert!(text.contains(from), "{from} in {text}");
        let error = MeasuredLoop::from_json(&text.replacen(from, to, 1), "loop.json").unwrap_err();
        let reported = error.to_string();
        assert!(reported.contains("loop.json") && reported.contains(named), "{reported}");
    }
}
