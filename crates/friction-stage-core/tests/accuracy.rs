//! The plant is right: against an independent oracle, closed forms, and the balance of energy.
//!
//! The oracle is `tests/oracle/`: Python, Gauss-Legendre collocation of order 24, converged far
//! below 1e-3 nm.

use std::f64::consts::PI;
use std::path::PathBuf;

use friction_stage_core::ClosedLoop;
use friction_stage_core::control::{
    AntiWindup, Controller, ControllerSettings, Gains, Point, Trajectory,
};
use friction_stage_core::model::{Guide, GuideSource, StageModel, Stroke};
use friction_stage_core::plant::{Body, Rates, Stage};
use serde::Deserialize;

#[derive(Deserialize)]
struct OracleCases {
    mass: f64,
    guides: Vec<Guide>,
    controller: OracleController,
    cases: Vec<OracleCase>,
}

#[derive(Deserialize)]
struct OracleController {
    rate: f64,
    bandwidth: f64,
    kp: f64,
    ki: f64,
    kd: f64,
    lowpass_frequency: f64,
    lowpass_damping: f64,
    mass_feedforward: f64,
    viscous_feedforward: f64,
    force_limit: f64,
}

#[derive(Deserialize)]
struct OracleCase {
    name: String,
    initial_bristle_deflections: Vec<f64>,
    motion: Vec<OracleMove>,
}

#[derive(Deserialize)]
struct OracleMove {
    start: f64,
    duration: f64,
    distance: f64,
}

/// One row of an oracle's table: state at t, force from t on.
#[derive(Clone, Copy)]
struct Row {
    position: f64,
    velocity: f64,
    bristles: [f64; 4],
    force: f64,
}

fn oracle_file(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/oracle").join(name)
}

fn oracle() -> OracleCases {
    serde_json::from_str(&std::fs::read_to_string(oracle_file("case.json")).unwrap()).unwrap()
}

fn rows(case: &str) -> Vec<Row> {
    let text = std::fs::read_to_string(oracle_file(&format!("{case}.csv"))).unwrap();
    let lines = text.lines().filter(|line| !line.starts_with('#') && !line.starts_with('t'));
    lines
        .map(|line| {
            let c: Vec<f64> = line.split(',').map(|cell| cell.parse().unwrap()).collect();
            Row { position: c[1], velocity: c[2], bristles: [c[3], c[4], c[5], c[6]], force: c[7] }
        })
        .collect()
}

fn oracle_model(cases: &OracleCases) -> StageModel {
    StageModel {
        mass: cases.mass,
        guides: cases.guides.iter().cloned().map(GuideSource::Inline).collect(),
        ..StageModel::default().without_noise()
    }
}

/// The closed loop of a case with `substeps` internal steps per control sample: state and force per
/// tick.
fn run(cases: &OracleCases, case: &OracleCase, substeps: u32, ticks: usize) -> Vec<Row> {
    let c = &cases.controller;
    let rates = Rates::new(c.rate, c.rate * f64::from(substeps)).unwrap();
    let mut stage = Stage::new(&oracle_model(cases), rates, 0).unwrap();
    stage.set_state(0.0, 0.0, &case.initial_bristle_deflections);
    let settings = ControllerSettings {
        rate: c.rate,
        gains: Gains {
            p: c.kp,
            i: c.ki,
            d: c.kd,
            lowpass_frequency: c.lowpass_frequency,
            lowpass_damping: c.lowpass_damping,
        },
        anti_windup: AntiWindup::ConditionalIntegration,
        limits: (-c.force_limit, c.force_limit),
        mass_feedforward: c.mass_feedforward,
        viscous_feedforward: c.viscous_feedforward,
        observer: None,
    };
    let mut points = Vec::new();
    let mut position = 0.0;
    for motion in &case.motion {
        for (time, distance) in
            [(motion.start, 0.0), (motion.start + motion.duration, motion.distance)]
        {
            position += distance;
            points.push(Point {
                time: (time * 1e9).round() as i64,
                position,
                velocity: Some(0.0),
                acceleration: Some(0.0),
                effort: 0.0,
            });
        }
    }
    let mut closed_loop = ClosedLoop::new(
        stage,
        Controller::new(settings).unwrap(),
        Trajectory::new(0, points).unwrap(),
    );
    (0..ticks)
        .map(|_| {
            let body = closed_loop.stage().body();
            let (position, velocity) = (body.position(), body.velocity());
            let bristles = body.guides().bristles().try_into().unwrap();
            let force = closed_loop.cycle().unwrap().terms.output;
            Row { position, velocity, bristles, force }
        })
        .collect()
}

fn largest_difference(a: &[Row], b: &[Row], quantity: impl Fn(&Row) -> f64) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (quantity(a) - quantity(b)).abs()).fold(0.0, f64::max)
}

#[test]
fn trace_at_the_default_step_stays_within_0_2_nm_of_the_oracle() {
    let cases = oracle();
    for case in &cases.cases {
        let reference = rows(&case.name);
        let found = run(&cases, case, Rates::DEFAULT.substeps(), reference.len());
        let position = largest_difference(&found, &reference, |row| row.position);
        let bristle = (0..4)
            .map(|guide| largest_difference(&found, &reference, |row| row.bristles[guide]))
            .fold(0.0, f64::max);
        let velocity = largest_difference(&found, &reference, |row| row.velocity);
        let force = largest_difference(&found, &reference, |row| row.force);
        println!(
            "{}: position {:.4} nm, velocity {:.2} nm/s, bristles {:.4} nm, force {force:.2e} N",
            case.name,
            position * 1e9,
            velocity * 1e9,
            bristle * 1e9
        );
        assert!(position < 0.2e-9, "{}: {position} m", case.name);
        assert!(bristle < 0.2e-9, "{}: {bristle} m", case.name);
    }
}

#[test]
fn error_falls_with_the_square_of_the_step() {
    let cases = oracle();
    for case in &cases.cases {
        let reference = rows(&case.name);
        let errors = [5, 10, 20, 40].map(|substeps| {
            largest_difference(&run(&cases, case, substeps, reference.len()), &reference, |row| {
                row.position
            })
        });
        for pair in errors.windows(2) {
            let order = (pair[0] / pair[1]).log2();
            println!(
                "{}: {:.5} -> {:.5} nm, order {order:.3}",
                case.name,
                pair[0] * 1e9,
                pair[1] * 1e9
            );
            assert!(order >= 1.9, "{}: order {order} from {errors:?}", case.name);
        }
    }
}

#[test]
fn bandwidth_gives_the_gains_that_the_oracle_worked_out() {
    let c = oracle().controller;
    let gains = Gains::from_bandwidth(c.bandwidth, 40.0);
    let pairs = [
        (gains.p, c.kp),
        (gains.i, c.ki),
        (gains.d, c.kd),
        (gains.lowpass_frequency, c.lowpass_frequency),
    ];
    for (found, expected) in pairs {
        assert!((found / expected - 1.0).abs() < 1e-12, "{found} {expected}");
    }
}

/// Moves a body of one guide at constant velocity by a force that a stiff servo works out, until it
/// is steady.
fn body_of(guide: &Guide, mass: f64, step: f64) -> Body {
    let model = StageModel {
        mass,
        guides: vec![GuideSource::Inline(guide.clone())],
        ..StageModel::default().without_noise()
    };
    Body::new(&model, step).unwrap()
}

#[test]
fn steady_bristle_deflection_is_g_over_sigma0() {
    let guide = oracle().guides[0].clone();
    for velocity in [-0.5, -0.003, 0.001, 0.02, 0.9] {
        // A huge mass keeps its velocity to within what the friction takes from it.
        let mut body = body_of(&guide, 1e12, 25e-6);
        body.set_state(0.0, velocity, &[0.0]);
        body.advance(0.0, 40_000);
        let expected = guide.level(velocity) * velocity.signum() / guide.stiffness;
        let found = body.guides().bristles()[0];
        assert!((found / expected - 1.0).abs() < 1e-9, "{velocity} m/s: {found} {expected}");
        let force = body.guide_forces()[0];
        assert!(
            (force / guide.steady_force(velocity) - 1.0).abs() < 1e-9,
            "{velocity} m/s: {force}"
        );
    }
}

/// F = Fs tanh(sigma0 A / Fs) at the tips of a slow symmetric loop: from one tip the loop must
/// reach the other.
#[test]
fn tip_force_of_a_slow_loop_is_fs_tanh_of_sigma0_a_over_fs() {
    let guide = oracle().guides[0].clone();
    for amplitude in [1e-6_f64, 10e-6, 40e-6, 420e-6] {
        let tip_force =
            guide.static_force * (guide.stiffness * amplitude / guide.static_force).tanh();
        // 1 % of the Stribeck velocity and slower: g is Fs to within (Fs - Fc)/Fs times 1e-4 =
        // 2e-5.
        let speed = (amplitude / 0.2).min(0.01 * guide.stribeck_velocity);
        let steps = 2.0 * amplitude / (speed * 25e-6);
        // A huge mass keeps its velocity to within what the friction takes from it.
        let mut body = body_of(&guide, 1e12, 25e-6);
        body.set_state(-amplitude, speed, &[-tip_force / guide.stiffness]);
        body.advance(0.0, steps.round() as u32);
        let found = guide.stiffness * body.guides().bristles()[0];
        assert!(
            (found / tip_force - 1.0).abs() < 3e-5,
            "{amplitude} m: {found} N, expected {tip_force} N"
        );
    }
}

/// Work of the motor less the rise of energy less the heat, over the work: the 50 mm move under a
/// prescribed force.
fn energy_error(substeps: u32) -> f64 {
    let cases = oracle();
    let forces: Vec<f64> = rows("from_rest").iter().map(|row| row.force).collect();
    let step = 250e-6 / f64::from(substeps);
    let mut body = Body::new(&oracle_model(&cases), step).unwrap();
    let start = body.energy();
    let (mut work, mut gross, mut heat) = (0.0, 0.0, 0.0);
    for force in forces {
        for _ in 0..substeps {
            let (position, power) = (body.position(), body.dissipated_power());
            body.advance(force, 1);
            let done = force * (body.position() - position);
            work += done;
            gross += done.abs();
            heat += 0.5 * step * (power + body.dissipated_power());
        }
    }
    (work - (body.energy() - start) - heat).abs() / gross
}

#[test]
fn work_in_is_energy_stored_and_dissipated() {
    let errors = [5, 10, 20, 40].map(energy_error);
    println!("energy errors over the work: {errors:?}");
    assert!(errors[1] < 1e-6, "{errors:?}");
    for pair in errors.windows(2) {
        assert!((pair[0] / pair[1]).log2() > 1.9, "falls with the step squared: {errors:?}");
    }
}

#[test]
fn same_seed_gives_the_same_bits_and_another_seed_does_not() {
    let bits = |seed| {
        let mut stage = Stage::new(&StageModel::default(), Rates::DEFAULT, seed).unwrap();
        (0..500)
            .flat_map(|k| {
                let sample = stage.sample();
                stage.advance(20.0 * f64::from(k).sin());
                [sample.position.to_bits(), sample.force_cell.to_bits()]
            })
            .collect::<Vec<_>>()
    };
    assert_eq!(bits(3), bits(3));
    assert_ne!(bits(3), bits(4));
}

/// The rig: the cell behind the flexure reads the friction of the guide when it moves steadily.
#[test]
fn force_cell_of_the_measuring_rig_reads_the_friction_of_its_guide() {
    let model = StageModel::measuring_rig("guide_1").unwrap().without_noise();
    let guide = model.resolved_guides().unwrap()[0].clone();
    let mut body = Body::new(&model, 10e-6).unwrap();
    let velocity = 0.05;
    let force = guide.steady_force(velocity);
    body.set_state(0.0, velocity, &[guide.level(velocity) / guide.stiffness]);
    // The friction level hardly depends on velocity here, so the steady force keeps the velocity.
    body.advance(force, 100_000);
    assert!((body.velocity() / velocity - 1.0).abs() < 1e-3, "{}", body.velocity());
    assert!((body.cell_force() / force - 1.0).abs() < 1e-3, "{} {force}", body.cell_force());
}

/// How far a mass that runs into a stop of the stroke with velocity `v` presses it in, m, and how
/// fast it comes back, m/s: m p'' = -k p - c p' until the stop would pull, without other forces.
fn bounce(stroke: &Stroke, mass: f64, v: f64) -> (f64, f64) {
    let decay = stroke.damping / (2.0 * mass);
    let square = stroke.stiffness / mass;
    let frequency = (square - decay * decay).sqrt();
    let deepest = (frequency / decay).atan() / frequency;
    let depth = v / frequency * (-decay * deepest).exp() * (frequency * deepest).sin();
    let angle = (-2.0 * decay * frequency / (square - 2.0 * decay * decay)).atan() + PI;
    let speed = v * (-decay * angle / frequency).exp();
    (depth, -speed * (angle.cos() - decay / frequency * angle.sin()))
}

#[test]
fn an_end_stop_takes_and_gives_back_what_its_spring_and_damper_say() {
    let guide = Guide {
        stiffness: 1.0,
        bristle_damping: 0.0,
        viscous_friction: 0.0,
        coulomb_force: 1e-6,
        static_force: 1e-6,
        ..oracle().guides[0].clone()
    };
    let mass = 40.0;
    let stroke = Stroke { low: -0.1, high: 0.2, stiffness: 2e6, damping: 5e3 };
    let model = StageModel {
        mass,
        guides: vec![GuideSource::Inline(guide)],
        stroke: Some(stroke),
        ..StageModel::default().without_noise()
    };
    for velocity in [-1.0, -0.2, 0.05, 1.0] {
        let mut body = Body::new(&model, 25e-6).unwrap();
        body.set_state(0.0, velocity, &[0.0]);
        let mut deepest = 0.0_f64;
        // Until it has come back to where it began.
        while body.position() * velocity >= 0.0 {
            body.advance(0.0, 1);
            deepest = deepest.max(stroke.penetration(body.position()).abs());
            assert!(body.time() < 20.0, "it has not come back");
        }
        let (depth, speed) = bounce(&stroke, mass, velocity.abs());
        println!(
            "{velocity} m/s: {deepest:.6} of {depth:.6} m, {:.6} of {speed:.6} m/s back",
            body.velocity()
        );
        assert!((deepest / depth - 1.0).abs() < 5e-3, "{deepest} {depth}");
        assert!((body.velocity() * -velocity.signum() / speed - 1.0).abs() < 5e-3);
    }
}

/// Against the stop with the motor's largest force: where spring and force balance, at rest.
#[test]
fn pressed_against_its_stop_the_stage_rests_where_the_spring_holds_the_force() {
    for model in [StageModel::default(), StageModel::measuring_rig("guide_1").unwrap()] {
        let stroke = Stroke { low: -0.02, high: 0.03, stiffness: 2e6, damping: 5e3 };
        let model = StageModel { stroke: Some(stroke), ..model.without_noise() };
        for force in [-300.0, 300.0] {
            let mut body = Body::new(&model, 10e-6).unwrap();
            body.advance(force, 500_000);
            let pressed = stroke.penetration(body.position());
            // The guides hold a part of the force, at most their static friction.
            let guides: f64 =
                model.resolved_guides().unwrap().iter().map(|guide| guide.static_force).sum();
            assert!((stroke.stiffness * pressed - force).abs() <= guides, "{pressed} m, {force} N");
            assert!(body.velocity().abs() < 1e-9, "{} m/s", body.velocity());
        }
    }
}
