//! What is said of a recording is never the opposite of what it holds: a carriage at rest is no
//! dead sensor, a command is no sensor, noise makes no reversals, coarse numbers make no limits.

use std::f64::consts::TAU;
use std::fmt::Write as _;

use friction_stage_core::model::{JointType, StageModel};
use friction_stage_data::quality::{
    DataFinding, DeadEvidence, Excitation, Judgement, Obstacle, Subject, examine,
};
use friction_stage_data::signals::{Mapping, Signal, load};

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
