//! What is said of a recording is never the opposite of what it holds: a carriage at rest is no
//! dead sensor, a command is no sensor, noise makes no reversals, coarse numbers make no limits.

use std::f64::consts::TAU;
use std::fmt::Write as _;

use friction_stage_core::model::{JointType, StageModel};
use friction_stage_data::bag::{BagOptions, BagWriter, OfferedQos};
use friction_stage_data::message::{Float64MultiArray, Header, JointState};
use friction_stage_data::quality::{
    DataFinding, DeadEvidence, Excitation, Judgement, Obstacle, Presliding, Subject, examine,
};
use friction_stage_data::signals::{
    JointDoubt, Mapping, Recording, Signal, SignalError, SignalNote, load,
};

/// Normal noise without a dependency: twelve uniform numbers.
struct Noise(u64);

impl Noise {
    fn uniform(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

/// A table of time, position and force, as its mapping reads it.
fn examined_by(mapping: &str, rows: impl Iterator<Item = [String; 3]>) -> Excitation {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("table.csv");
    let mut text = String::from("t,x,f\n");
    for [t, x, f] in rows {
        let _ = writeln!(text, "{t},{x},{f}");
    }
    std::fs::write(&path, text).unwrap();
    let mapping = Mapping::from_yaml(mapping, "mapping").unwrap();
    examine(&load(&path, Some(&mapping)).unwrap(), None)
}

fn examined(rows: impl Iterator<Item = (f64, f64, f64)>) -> Excitation {
    let mapping = "signals: {time: {column: t}, position: {column: x}, force: {column: f}}";
    examined_by(mapping, rows.map(|(t, x, f)| [t.to_string(), x.to_string(), f.to_string()]))
}

fn broken(found: &Excitation) -> Vec<&DataFinding> {
    found.findings.iter().filter(|finding| finding.broken_signal().is_some()).collect()
}

fn answer(found: &Excitation, subject: Subject) -> &Judgement {
    found.judgements.iter().find(|judgement| judgement.subject == subject).unwrap()
}

fn count(x: f64, count: f64) -> f64 {
    (x / count).round() * count
}

/// To and fro by raised cosines with a rest of half a second at either end, in which the force
/// climbs as an integrator's does.
fn stick_slip(time: f64) -> (f64, f64) {
    let (period, rest, stroke) = (1.5, 0.5, 0.02);
    let (number, t) = ((time / period).floor(), time % period);
    let sign = if number as i64 % 2 == 0 { 1.0 } else { -1.0 };
    let start = if sign > 0.0 { 0.0 } else { stroke };
    if t < rest {
        return (start, sign * 14.0 * t / rest);
    }
    let phase = (t - rest) / (period - rest);
    let along = 0.5 * stroke * (1.0 - (0.5 * TAU * phase).cos());
    (start + sign * along, sign * (15.0 + 80.0 * 0.03 * (0.5 * TAU * phase).sin()))
}

#[test]
fn a_carriage_that_rests_is_no_dead_sensor() {
    for (rate, counts) in [(1000.0, 1e-6), (1000.0, 1e-7), (4000.0, 1e-5), (100.0, 1e-5)] {
        let rows = (0..(9.0 * rate) as usize).map(|k| {
            let time = k as f64 / rate;
            let (x, force) = stick_slip(time);
            (time, count(x, counts), force)
        });
        let found = examined(rows);
        assert!(broken(&found).is_empty(), "{rate} {counts}: {:?}", found.findings);
        assert!(found.rest_s > 2.0, "{rate} {counts}: {}", found.rest_s);
    }
}

#[test]
fn a_sensor_that_dies_is_told_by_its_jump_or_by_its_silence() {
    let rate = 1000.0;
    let counts = 1e-6;
    let jump = |k: usize| {
        let time = k as f64 / rate;
        let (x, force) = stick_slip(if (2600..2900).contains(&k) { 2.6 } else { time });
        (time, count(x, counts), force)
    };
    let found = examined((0..9000).map(jump));
    match broken(&found)[..] {
        [DataFinding::Stuck { signal: Signal::Position, evidence, stretches, .. }] => {
            assert_eq!(*evidence, DeadEvidence::Abrupt);
            assert_eq!(stretches.len(), 1);
            assert!(stretches[0].start.abs_diff(2600) < 3 && stretches[0].len().abs_diff(300) < 5);
        }
        ref other => panic!("{other:?}"),
    }
    // At rest there is no jump: what has gone is the noise.
    let mut noise = Noise(4);
    let mut dead = f64::NAN;
    let rows = (0..9000).map(|k| {
        let time = k as f64 / rate;
        let (x, force) = stick_slip(time);
        let read = count(x + 2e-6 * noise.normal(), 1e-7);
        if !(3050..3450).contains(&k) || dead.is_nan() {
            dead = read;
        }
        (time, if (3050..3450).contains(&k) { dead } else { read }, force)
    });
    let found = examined(rows);
    match broken(&found)[..] {
        [DataFinding::Stuck { signal: Signal::Position, evidence, .. }] => {
            assert_eq!(*evidence, DeadEvidence::Silent);
        }
        ref other => panic!("{other:?}"),
    }
}

/// 20 kg with Coulomb and viscous friction, driven in open loop.
fn driven(levels: &[f64], hold: f64, rate: f64, seconds: f64) -> Vec<(f64, f64, f64)> {
    let (mut x, mut v) = (0.0, 0.0f64);
    let steps = 20;
    (0..(seconds * rate) as usize)
        .map(|k| {
            let time = k as f64 / rate;
            let force = levels[(time / hold) as usize % levels.len()];
            let row = (time, count(x, 1e-7), force);
            for _ in 0..steps {
                let dt = 1.0 / rate / f64::from(steps);
                let friction = 15.0 * (v / 1e-3).tanh() + 80.0 * v;
                v += dt * (force - friction) / 20.0;
                x += dt * v;
            }
            row
        })
        .collect()
}

#[test]
fn a_command_that_is_held_was_commanded_so() {
    for levels in [&[30.0, -30.0][..], &[20.0, -25.0, 30.0, -25.0], &[30.0, 0.0, -30.0, 0.0]] {
        let found = examined(driven(levels, 0.5, 1000.0, 24.0).into_iter());
        assert!(broken(&found).is_empty(), "{levels:?}: {:?}", found.findings);
        let fit = found.command_fit.unwrap();
        assert!((fit.mass - 20.0).abs() < 1.0, "{levels:?}: {fit:?}");
        assert!((fit.coulomb - 15.0).abs() < 1.5, "{levels:?}: {fit:?}");
    }
}

#[test]
fn reversals_are_those_of_the_motion_whatever_the_clock() {
    for (jitter, noise) in [(0.0, 1e-6), (0.4, 1e-6), (0.4, 2e-5), (0.2, 5e-8)] {
        let mut random = Noise(9);
        let rows = (0..8000).map(|k| {
            let time = 1e-3 * (f64::from(k) + jitter * random.uniform());
            let x = 0.02 * (TAU * time).sin() + noise * random.normal();
            (time, x, 15.0 * (TAU * time).cos().signum() - 15.0 * (TAU * time).sin())
        });
        let found = examined(rows);
        assert_eq!(found.reversals, 16, "{jitter} {noise}: {:?}", found.amplitude);
        let shown = found.encoder_noise.unwrap().present;
        assert!((shown / noise - 1.0).abs() < 0.15, "{jitter} {noise}: {shown:e}");
    }
}

#[test]
fn numbers_of_few_digits_are_no_limit_of_the_travel() {
    for digits in [4usize, 5, 6] {
        for top in [50.0, 12.0, 8.7] {
            let mapping = "signals: {time: {column: t}, position: {column: x, unit: deg}, \
                           force: {column: f, unit: N m}}";
            let rows = (0..20_000).map(|k| {
                let time = f64::from(k) / 5000.0;
                let x = 0.5 * top * (1.0 - (TAU * time).cos()) + 0.01 * (TAU * 3.0 * time).sin();
                let decimals = digits as i32 - 1 - x.abs().max(1e-9).log10().floor() as i32;
                let decimals = decimals.max(0) as usize;
                [time.to_string(), format!("{x:.decimals$}"), (TAU * time).sin().to_string()]
            });
            let found = examined_by(mapping, rows);
            assert!(broken(&found).is_empty(), "{digits} {top}: {:?}", found.findings);
            assert_eq!(found.joint, JointType::Revolute);
        }
    }
}

#[test]
fn a_slow_axis_on_coarse_counts_knows_its_friction_and_not_its_mass() {
    for (rate, counts, frequency) in [(100.0, 1e-5, 0.2), (250.0, 5e-6, 0.1), (50.0, 1e-5, 0.05)] {
        let rows = (0..(40.0 * rate) as usize).map(|k| {
            let time = k as f64 / rate;
            let omega = TAU * frequency;
            let (x, v) = (5e-3 * (omega * time).sin(), 5e-3 * omega * (omega * time).cos());
            (time, count(x, counts), 80.0 * v.signum() + 498.0 * v)
        });
        let found = examined(rows);
        for subject in [Subject::CoulombFriction, Subject::ViscousFriction, Subject::Asymmetry] {
            assert!(answer(&found, subject).possible(), "{rate}: {:?}", answer(&found, subject));
        }
        let fit = found.command_fit.unwrap();
        assert!((fit.coulomb - 80.0).abs() < 2.0, "{rate}: {fit:?}");
        assert!((fit.viscous - 498.0).abs() < 150.0, "{rate}: {fit:?}");
        let mass = &answer(&found, Subject::Mass).answer;
        let is_obstacle = matches!(
            mass,
            Err(Obstacle::LittleInertia { .. } | Obstacle::AccelerationIsNoise { .. })
        );
        assert!(is_obstacle, "{rate}: {mass:?}");
    }
}

#[test]
fn what_cannot_be_told_names_what_stands_in_the_way() {
    let one_way = examined((0..3000).map(|k| {
        let time = f64::from(k) * 1e-3;
        (time, 0.01 * (time + 0.1 * (TAU * time).sin()), 20.0 + (TAU * time).cos())
    }));
    let asked = |subject| answer(&one_way, subject).answer.clone().unwrap_err();
    assert_eq!(asked(Subject::CoulombFriction), Obstacle::OneDirection);
    assert_eq!(asked(Subject::BristleStiffness), Obstacle::FewReversals { count: 0, needed: 2 });
    assert_eq!(asked(Subject::MotorSide), Obstacle::NoForceCell);
    assert_eq!(asked(Subject::StictionAging), Obstacle::NoRest);
    assert_eq!(asked(Subject::ClosedLoop), Obstacle::NoSetpoint);
    // After a fatal finding every line names that.
    let short = examined((0..100).map(|k| (f64::from(k) * 1e-3, f64::from(k) * 1e-4, 1.0)));
    assert!(short.judgements.iter().all(|judgement| {
        matches!(judgement.answer, Err(Obstacle::Unusable { code: "too_short" }))
    }));
}

#[test]
fn a_revolute_joint_has_its_units_and_is_none_of_a_prismatic_model() {
    // 1e-4 kg m² with 0.02 N m of Coulomb friction.
    let mapping = "signals: {time: {column: t}, position: {column: x, unit: rev}, \
                   current: {column: f, unit: mA, scale: 0.05}}";
    let rows: Vec<[String; 3]> = (0..8000)
        .map(|k| {
            let time = f64::from(k) * 1e-3;
            let omega = TAU * 2.0;
            let (angle, speed) = (3.0 * (omega * time).sin(), 3.0 * omega * (omega * time).cos());
            let torque = -1e-4 * 3.0 * omega * omega * (omega * time).sin() + 0.02 * speed.signum();
            [time.to_string(), count(angle / TAU, 1e-6).to_string(), (torque / 5e-5).to_string()]
        })
        .collect();
    let found = examined_by(mapping, rows.iter().cloned());
    assert_eq!(found.joint, JointType::Revolute);
    let fit = found.command_fit.unwrap();
    assert!((fit.mass / 1e-4 - 1.0).abs() < 0.02, "{fit:?}");
    assert!((fit.coulomb / 0.02 - 1.0).abs() < 0.02, "{fit:?}");

    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("table.csv");
    let lines: Vec<String> = rows.iter().map(|row| row.join(",")).collect();
    std::fs::write(&path, format!("t,x,f\n{}\n", lines.join("\n"))).unwrap();
    let recording = load(&path, Some(&Mapping::from_yaml(mapping, "mapping").unwrap())).unwrap();
    let found = examine(&recording, Some(&StageModel::default()));
    let is_other = |finding: &DataFinding| {
        matches!(finding, DataFinding::OtherJoint { recorded: JointType::Revolute, .. })
    };
    assert!(found.findings.iter().any(is_other), "{:?}", found.findings);
}

/// There and back by the polynomial of least jerk, with rests between: position, m, velocity, m/s,
/// and force, N, of 12 kg with 8 N of Coulomb friction.
fn least_jerk(time: f64, stroke: f64, moves: f64, rest: f64) -> (f64, f64, f64) {
    let period = moves + rest;
    let (number, t) = ((time / period) as u64, time % period);
    let sign = if number % 2 == 0 { 1.0 } else { -1.0 };
    let start = if number % 2 == 0 { 0.0 } else { stroke };
    let s = ((t - rest) / moves).max(0.0);
    let along = s.powi(3) * (10.0 - 15.0 * s + 6.0 * s * s);
    let speed = 30.0 * s * s * (1.0 - s).powi(2) / moves;
    let rate = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / moves.powi(2);
    let v = sign * stroke * speed;
    (start + sign * stroke * along, v, 12.0 * sign * stroke * rate + 8.0 * (v / 1e-4).tanh())
}

#[test]
fn a_rest_is_no_limit_however_fine_the_numbers() {
    // Counts of a picometre to double precision, far from zero and not; 0 is what is computed.
    for (offset, counts, rest) in [(0.0, 0.0, 0.3), (1.7, 0.0, 0.15), (0.3, 1e-12, 0.4)] {
        let rows = (0..4000).map(|k| {
            let time = f64::from(k) * 1e-3;
            let (x, _, force) = least_jerk(time, 0.035, 0.45, rest);
            let x = if counts > 0.0 { count(offset + x, counts) } else { offset + x };
            (time, x, force)
        });
        let found = examined(rows);
        assert!(broken(&found).is_empty(), "{offset} {counts}: {:?}", found.findings);
    }
    for rest in [0.2, 0.5] {
        let found = examined_velocity((0..4000).map(|k| {
            let time = f64::from(k) * 1e-3;
            let (_, v, force) = least_jerk(time, 0.035, 0.45, rest);
            (time, v, force)
        }));
        assert!(broken(&found).is_empty(), "{rest}: {:?}", found.findings);
    }
}

#[test]
fn a_motion_that_is_cut_off_at_full_speed_has_reached_a_limit() {
    for (limit, counts) in [(0.015, 1e-9), (0.0199, 1e-6), (0.01, 1e-5)] {
        let found = examined((0..6000).map(|k| {
            let time = f64::from(k) * 1e-3;
            let (x, v) = (0.02 * (TAU * time).sin(), 0.02 * TAU * (TAU * time).cos());
            (time, count(x.min(limit), counts), 15.0 * v.signum() - 20.0 * TAU * TAU * x)
        }));
        let is_limit = |finding: &DataFinding| {
            matches!(finding, DataFinding::Clipped { signal: Signal::Position, value, .. }
                if (value - limit).abs() < 2.0 * counts)
        };
        assert!(found.findings.iter().any(is_limit), "{limit} {counts}: {:?}", found.findings);
    }
    // An even motion is no coarse one.
    for speed in [0.0213, 0.0137] {
        let found = examined((0..6000).map(|k| {
            let time = f64::from(k) * 1e-3;
            let phase = (time * speed / 0.04).fract();
            let x = 0.04 * (0.5 - (phase - 0.5).abs());
            (time, count(x.min(0.019), 1e-6), 15.0 * (0.5 - phase).signum())
        }));
        assert!(
            broken(&found)
                .iter()
                .any(|finding| matches!(finding, DataFinding::Clipped { value, .. }
                    if (value - 0.019).abs() < 1e-5)),
            "{speed}: {:?}",
            found.findings
        );
    }
}

/// A table of time, velocity and force.
fn examined_velocity(rows: impl Iterator<Item = (f64, f64, f64)>) -> Excitation {
    let mapping = "signals: {time: {column: t}, velocity: {column: x}, force: {column: f}}";
    examined_by(mapping, rows.map(|(t, v, f)| [t.to_string(), v.to_string(), f.to_string()]))
}

#[test]
fn of_a_velocity_the_velocity_is_cut_off_and_not_its_integral() {
    for (limit, stroke) in [(0.05, 0.035), (0.12, 0.06)] {
        let found = examined_velocity((0..4000).map(|k| {
            let time = f64::from(k) * 1e-3;
            let (_, v, force) = least_jerk(time, stroke, 0.5, 0.25);
            (time, count(v.clamp(-limit, limit), 1e-7), force)
        }));
        let found = broken(&found);
        assert_eq!(found.len(), 2, "{limit}: {found:?}");
        assert!(found.iter().all(|finding| matches!(
            finding,
            DataFinding::Clipped { signal: Signal::Velocity, value, .. }
                if (value.abs() - limit).abs() < 1e-9
        )));
    }
    // A speed that is held is none that is cut off.
    for rate in [0.4, 1.5] {
        let found = examined_velocity((0..6000).map(|k| {
            let time = f64::from(k) * 1e-3;
            let wave = (TAU * 0.5 * time).sin();
            let ramp = rate * wave.asin() / TAU * 2.0;
            let (v, held) = (ramp.clamp(-0.1, 0.1), ramp.abs() > 0.1);
            let slope = if held { 0.0 } else { rate * (TAU * 0.5 * time).cos().signum() };
            (time, v, 12.0 * slope + 8.0 * v.signum())
        }));
        assert!(broken(&found).is_empty(), "{rate}: {:?}", found.findings);
    }
}

#[test]
fn reversals_of_a_noisy_velocity_are_those_of_the_motion() {
    for (noise, seed) in [(2e-4, 3), (1e-3, 5), (5e-3, 8)] {
        let mut random = Noise(seed);
        let found = examined_velocity((0..6000).map(|k| {
            let time = f64::from(k) * 1e-3;
            let (_, v, force) = least_jerk(time, 0.05, 0.5, 0.3);
            (time, v + noise * random.normal(), force)
        }));
        // Moves of 0.5 s with rests of 0.3 s between: seven in 6 s, and half of another.
        assert_eq!(found.reversals, 7, "{noise}: {:?}", found.amplitude);
    }
}

#[test]
fn a_counter_that_wraps_is_said_to_wrap_and_not_to_be_cut_off() {
    for (length, counts) in [(0.008, 1e-6), (0.013, 1e-5)] {
        let found = examined((0..6000).map(|k| {
            let time = f64::from(k) * 1e-3;
            let (x, _, force) = least_jerk(time, 0.06, 0.5, 0.25);
            (time, count(x, counts).rem_euclid(length), force)
        }));
        let wrapped = found.findings.iter().find_map(|finding| match finding {
            DataFinding::Wrapped { signal: Signal::Position, jump, rows } => Some((jump, rows)),
            _ => None,
        });
        let (jump, rows) = wrapped.unwrap_or_else(|| panic!("{length}: {:?}", found.findings));
        assert!((jump / length - 1.0).abs() < 0.02 && rows.len() > 10, "{jump} {rows:?}");
        assert!(broken(&found).is_empty(), "{length}: {:?}", found.findings);
    }
    // A line that drops out is no counter.
    for value in [0.0, 0.03] {
        let found = examined((0..6000).map(|k| {
            let time = f64::from(k) * 1e-3;
            let (x, _, force) = least_jerk(time, 0.06, 0.5, 0.25);
            (time, if k % 700 == 420 { value } else { count(x, 1e-6) }, force)
        }));
        let is_wrap = |finding: &DataFinding| matches!(finding, DataFinding::Wrapped { .. });
        assert!(!found.findings.iter().any(is_wrap), "{value}: {:?}", found.findings);
    }
}

/// 20 kg on a bristle that breaks away after `length`, m, driven along a sine; counts of `counts`.
fn with_bristle(length: f64, counts: f64) -> Excitation {
    let (mut z, mut last) = (0.0f64, 0.0);
    examined((0..8000).map(|k| {
        let time = f64::from(k) * 1e-3;
        let omega = TAU * 0.5;
        let x = 0.01 * (1.0 - (omega * time).cos());
        // Dahl (1968), dz = dx - |dx| z / length, over a way in one direction.
        let dx: f64 = x - last;
        z += (dx.signum() * length - z) * (1.0 - (-dx.abs() / length).exp());
        last = x;
        let force = 20.0 * 0.01 * omega * omega * (omega * time).cos() + 15.0 * z / length;
        (time, count(x, counts), force)
    }))
}

#[test]
fn bristles_are_seen_by_an_encoder_that_is_finer_than_their_travel() {
    for (length, counts) in [(4e-5, 1e-9), (4e-5, 1e-6), (5e-6, 1e-8)] {
        let found = with_bristle(length, counts);
        let judged = answer(&found, Subject::BristleStiffness);
        assert!(judged.possible(), "{length} {counts}: {judged:?} {:?}", found.presliding);
        let Presliding { travel, .. } = found.presliding.unwrap();
        assert!((0.5..3.0).contains(&(travel / length)), "{length} {counts}: {travel}");
    }
    for (length, counts) in [(4e-7, 1e-6), (2e-6, 1e-5), (5e-6, 2e-5)] {
        let found = with_bristle(length, counts);
        let judged = answer(&found, Subject::BristleStiffness);
        let is_noise = matches!(
            judged.answer,
            Err(Obstacle::PreslidingIsNoise { declared: false, noise, .. }) if noise >= 0.2 * counts
        );
        assert!(is_noise, "{length} {counts}: {judged:?}");
    }
}

#[test]
fn a_motion_that_no_stage_makes_asks_for_the_unit() {
    let is_impossible =
        |finding: &DataFinding| matches!(finding, DataFinding::ImpossibleMotion { .. });
    for (scale, expected) in [(1.0, false), (10.0, false), (1e3, true), (1e6, true)] {
        let found = examined((0..4000).map(|k| {
            let time = f64::from(k) * 1e-3;
            let (x, _, force) = least_jerk(time, 0.05, 0.5, 0.25);
            (time, scale * x, force)
        }));
        let found = found.findings.iter().any(is_impossible);
        assert_eq!(found, expected, "{scale}");
    }
}

/// A bag of messages of two joints with what else `write` puts in it.
fn bag(
    mapping: &str,
    joints: impl Fn(i64) -> JointState,
    data: impl Fn(i64) -> (i64, Vec<f64>),
) -> Result<Recording, SignalError> {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("bag");
    let mut bag = BagWriter::create(&path, &BagOptions::default()).unwrap();
    let states = bag.add_topic::<JointState>("/states", &OfferedQos::reliable(10)).unwrap();
    let array = bag.add_topic::<Float64MultiArray>("/array", &OfferedQos::reliable(10)).unwrap();
    for k in 0..1000 {
        let mut state = joints(k);
        state.header = Header::new(k * 1_000_000, "");
        bag.write(states, (k * 1_000_000) as u64, &state).unwrap();
        let (time, data) = data(k);
        let message = Float64MultiArray { data, ..Float64MultiArray::default() };
        bag.write(array, time as u64, &message).unwrap();
    }
    bag.finish().unwrap();
    load(&path, Some(&Mapping::from_yaml(mapping, "mapping").unwrap()))
}

fn state(names: &[&str], position: &[f64]) -> JointState {
    let name = names.iter().map(|name| (*name).to_owned()).collect();
    JointState { name, position: position.to_vec(), ..JointState::default() }
}

fn to_and_fro(k: i64) -> f64 {
    0.01 * (TAU * 2e-3 * k as f64).sin()
}

#[test]
fn a_force_that_is_recorded_and_not_used_is_not_called_absent() {
    let one = |k: i64| state(&["x"], &[to_and_fro(k)]);
    let mapping = |index: usize| {
        format!(
            "signals: {{position: {{topic: /states, field: \"position[0]\"}}, \
             force: {{topic: /array, field: \"data[{index}]\"}}}}"
        )
    };
    for later_s in [10, 1_700_000_000] {
        let data = |k: i64| (later_s * 1_000_000_000 + k * 1_000_000, vec![1.0, k as f64]);
        let recording = bag(&mapping(1), one, data).unwrap();
        let is_elsewhere = |note: &SignalNote| {
            matches!(note, SignalNote::NoTimeInCommon { signal: Signal::Force, samples: 1000, .. })
        };
        assert!(recording.quality.notes.iter().any(is_elsewhere), "{:?}", recording.quality.notes);
        let found = examine(&recording, None).findings;
        assert!(found.contains(&DataFinding::ForceUnused), "{found:?}");
        assert!(!found.contains(&DataFinding::NoForce), "{found:?}");
    }
    for index in [2, 7] {
        let recording =
            bag(&mapping(index), one, |k| (k * 1_000_000, vec![1.0, k as f64])).unwrap();
        let is_beyond = |note: &SignalNote| {
            matches!(note, SignalNote::NoElement { signal: Signal::Force, elements: 2, .. })
        };
        assert!(recording.quality.notes.iter().any(is_beyond), "{:?}", recording.quality.notes);
        assert!(examine(&recording, None).findings.contains(&DataFinding::ForceUnused));
    }
}

#[test]
fn a_pause_is_none_of_the_rows_that_lack_a_value() {
    for pause in [9.0, 400.0] {
        let found = examined((0..4000).map(|k| {
            let time = f64::from(k) * 1e-3;
            let (x, _, force) = least_jerk(time, 0.04, 0.5, 0.25);
            (time + if k < 2300 { 0.0 } else { pause }, count(x, 1e-8), force)
        }));
        assert!(found.recorded.contains(&Signal::Force), "{pause}: {:?}", found.findings);
        let is_sparse = |finding: &DataFinding| {
            matches!(finding, DataFinding::Sparse { .. } | DataFinding::NoForce)
        };
        assert!(!found.findings.iter().any(is_sparse), "{pause}: {:?}", found.findings);
        assert!((found.duration_s - 4.0).abs() < 0.01);
    }
}

#[test]
fn names_that_do_not_say_whose_a_value_is_are_told() {
    let none = |k: i64| (k * 1_000_000, vec![0.0]);
    let by = |field: &str, joint: &str| {
        format!("{joint}signals: {{position: {{topic: /states, field: \"{field}\"}}}}")
    };
    let doubts = |mapping: String, joints: &dyn Fn(i64) -> JointState| -> Vec<JointDoubt> {
        let notes = bag(&mapping, joints, none).unwrap().quality.notes;
        let doubts = notes.into_iter().filter_map(|note| match note {
            SignalNote::Joints { doubt, .. } => Some(doubt),
            _ => None,
        });
        doubts.collect()
    };
    let turns = |k: i64| match k % 3 {
        0 => state(&["x", "y"], &[to_and_fro(k), 1.0]),
        _ => state(&["y", "x"], &[1.0, to_and_fro(k)]),
    };
    let (first, other) = ("y".to_owned(), "x".to_owned());
    let order = JointDoubt::Order { index: 1, first, other };
    assert_eq!(doubts(by("position[1]", ""), &turns), [order]);
    assert_eq!(doubts(by("position[joint]", "joint: x\n"), &turns), []);
    let short = |k: i64| state(&["x", "y", "z"], &[to_and_fro(k), 1.0]);
    let lengths = JointDoubt::Lengths { names: 3, values: 2 };
    for mapping in [by("position[joint]", "joint: x\n"), by("position[0]", "")] {
        assert_eq!(doubts(mapping, &short), std::slice::from_ref(&lengths));
    }
    let twice = |k: i64| state(&["y", "x", "x"], &[1.0, to_and_fro(k), 2.0]);
    let named = [JointDoubt::Twice { joint: "x".into() }];
    assert_eq!(doubts(by("position[joint]", "joint: x\n"), &twice), named);
    assert_eq!(doubts(by("position[2]", ""), &twice), named);

    let refused = |mapping: String, joints: &dyn Fn(i64) -> JointState| {
        bag(&mapping, joints, none).map(|recording| recording.rate).unwrap_err().to_string()
    };
    let unnamed = |k: i64| state(&[], &[to_and_fro(k)]);
    for joint in ["", "joint: x\n"] {
        let message = refused(by("position[joint]", joint), &unnamed);
        assert!(message.contains("`position[0]`"), "{message}");
    }
    let two = |k: i64| state(&["left", "right"], &[to_and_fro(k), 1.0]);
    for joint in ["", "joint: middle\n"] {
        let message = refused(by("position[joint]", joint), &two);
        assert!(message.contains("`joint: left`") && message.contains("right"), "{message}");
    }
    let message = refused(by("position[2]", ""), &two);
    assert!(message.contains("element 2") && message.contains("has 2"), "{message}");
    let message = refused("signals: {position: {topic: /stats, field: data}}".into(), &two);
    assert!(message.contains("/states") && message.contains("/array"), "{message}");
}
