//! The generator of blind test data, held against closed forms and against the committed
//! independent oracle.

use std::path::Path;

use blind_tests::effects::{
    ActuatorLag, AsymmetricFriction, Backlash, CATALOGUE, CableChain, Cogging, ConstantForce,
    DeadZone, EncoderCompliance, EncoderCyclicError, EncoderSde, ForceCellDrift, ForceCellLag,
    FrictionDrift, FrictionalLag, HardeningSpring, LISTED, LoadDependentFriction, MotorDroop,
    MotorGain, MotorSaturation, Payload, SpeedRipple, by_name, composition,
};
use blind_tests::guides::{Change, Elements, GUIDES, Slip};
use blind_tests::noise::Noise;
use blind_tests::stage::{Moment, Stage};
use blind_tests::{
    Columns, Effect, Guide, NOMINAL_MASS, Programme, RecordTruth, SensorNoise, Setup, Side, rms,
};

const RATE: f64 = 2000.0;
const STEP: f64 = 20e-6;

fn nominal(effects: Vec<Effect>, step: f64) -> Stage {
    Stage::new(NOMINAL_MASS, [Guide::NOMINAL; GUIDES], effects, 1.0 / RATE, step)
}

fn quiet(seed: u64) -> Setup {
    Setup { noise: SensorNoise { encoder: 0.0, count: 0.0, cell: 0.0 }, ..Setup::new(seed) }
}

fn guides(seed: u64) -> [Guide; GUIDES] {
    let mut noise = Noise::new(seed, 1);
    [(); GUIDES].map(|()| Guide::draw(0.16, &mut noise))
}

/// Motion under held forces, one row per tick.
fn open_loop(stage: &mut Stage, forces: &[f64]) -> Vec<Moment> {
    let mut noise = Noise::new(0, 0);
    forces
        .iter()
        .map(|&force| {
            stage.advance(force, &mut noise);
            stage.moment(&mut [])
        })
        .collect()
}

/// A force far below break-away meets four bristle springs: a damped oscillator of the second
/// order.
#[test]
fn small_force_rings_like_the_bristle_springs() {
    let force = 0.01;
    let guide = Guide::NOMINAL;
    let (k, c) = (4.0 * guide.stiffness, 4.0 * (guide.bristle_damping + guide.viscous));
    let (w, decay) = ((k / NOMINAL_MASS).sqrt(), c / (2.0 * NOMINAL_MASS));
    let damped = (w * w - decay * decay).sqrt();
    let rows = open_loop(&mut nominal(Vec::new(), STEP), &[force; 200]);
    for (tick, row) in rows.iter().enumerate() {
        let t = (tick + 1) as f64 / RATE;
        let decayed = (-decay * t).exp();
        let expected = force / k
            * (1.0 - decayed * ((damped * t).cos() + decay / damped * (damped * t).sin()));
        // The bristles give by the order of the force over the break-away force of 67 N.
        assert!(
            (row.position - expected).abs() < 1e-3 * force / k,
            "{t} s: {} m, expected {expected}",
            row.position
        );
    }
}

#[test]
fn held_speed_needs_the_steady_friction_of_all_guides() {
    let guides = guides(3);
    let setup = quiet(3);
    let setpoints = Programme::Recorded.train(RATE, &mut Noise::new(3, 2));
    let (columns, truth) = setup.record(40.0, guides, &setpoints, "train", 3).unwrap();
    let mut seen = 0;
    for speed in [0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4] {
        for direction in [1.0, -1.0] {
            // The last quarter of the time at that speed: the loop has settled.
            let rows: Vec<usize> = (0..columns.time.len())
                .filter(|&k| {
                    (setpoints.velocity[k] - direction * speed).abs() < 1e-12
                        && setpoints.acceleration[k] == 0.0
                })
                .collect();
            let rows = &rows[rows.len() * 3 / 4..];
            assert!(rows.len() > 20, "{speed} m/s: {} rows", rows.len());
            let mean =
                rows.iter().map(|&k| truth.friction_force[k]).sum::<f64>() / rows.len() as f64;
            let expected: f64 = guides.iter().map(|g| g.steady(direction * speed)).sum();
            let tolerance = if speed < 0.01 { 0.5 } else { 0.05 };
            assert!(
                (mean - expected).abs() < tolerance,
                "{speed} m/s: {mean} N, expected {expected} N"
            );
            seen += 1;
        }
    }
    assert_eq!(seen, 16);
}

/// What the motor puts in is in the motion, in the bristles, or is lost in them: with sigma1 =
/// sigma2 = 0 the loss is sigma0^2 |v| z^2/g, so the energy of mass and bristles never grows once
/// the motor stops, and while it works the balance closes.
#[test]
fn energy_balance_closes() {
    let guide = Guide { bristle_damping: 0.0, viscous: 0.0, ..Guide::NOMINAL };
    let (rate, steps) = (80_000.0, 40_000);
    let mut stage = Stage::new(NOMINAL_MASS, [guide; GUIDES], Vec::new(), 1.0 / rate, 1.0 / rate);
    let forces: Vec<f64> = (0..steps)
        .map(|k| if k < 20_000 { 400.0 * (k as f64 * 1e-3).sin() } else { 0.0 })
        .collect();
    let mut noise = Noise::new(0, 0);
    let (mut put_in, mut lost) = (0.0, 0.0);
    let (mut last, mut last_loss) = (Moment::default(), 0.0);
    let (mut peak, mut energy_at_rest) = (0.0, f64::INFINITY);
    for (k, &force) in forces.iter().enumerate() {
        stage.advance(force, &mut noise);
        let row = stage.moment(&mut []);
        // Force is held, so its work is exact.
        put_in += force * (row.position - last.position);
        let z = row.friction_force / (4.0 * guide.stiffness);
        let loss = 4.0 * guide.stiffness.powi(2) * row.velocity.abs() * z * z
            / (guide.coulomb_force
                + (guide.static_force - guide.coulomb_force)
                    * (-(row.velocity / guide.stribeck_velocity).powi(2)).exp());
        lost += 0.5 * (loss + last_loss) / rate;
        let energy = 0.5 * NOMINAL_MASS * row.velocity.powi(2) + 2.0 * guide.stiffness * z * z;
        peak = f64::max(peak, energy);
        assert!(
            (put_in - energy - lost).abs() < 2e-4 * peak.max(1e-3),
            "tick {k}: {put_in} J in, {energy} + {lost} J"
        );
        if k >= 20_000 {
            assert!(
                energy <= energy_at_rest * (1.0 + 1e-12),
                "tick {k}: {energy} J after {energy_at_rest} J"
            );
            energy_at_rest = energy;
        }
        (last, last_loss) = (row, loss);
    }
    assert!(peak > 0.5 && lost > 0.5, "{peak} J, {lost} J: the test moves too little");
}

/// Presliding, slow sliding and reversals: what a fixed step has most trouble with.
fn slow_forces() -> Vec<f64> {
    (0..1200).map(|k| 75.0 * (k as f64 * 0.011).sin() + 20.0 * (k as f64 * 0.07).sin()).collect()
}

/// Reversals, placed by a secant, cost one of the four orders of the method.
#[test]
fn integrator_converges_with_the_third_order() {
    let motion = |step: f64| open_loop(&mut nominal(Vec::new(), step), &slow_forces());
    let finest = motion(2e-6);
    let travel = finest.iter().map(|row| row.position.abs()).fold(0.0, f64::max);
    let fastest = finest.iter().map(|row| row.velocity.abs()).fold(0.0, f64::max);
    let errors = [100e-6, 50e-6, 25e-6, 12.5e-6].map(|step| {
        let rows = motion(step);
        rows.iter().zip(&finest).map(|(a, b)| (a.position - b.position).abs()).fold(0.0, f64::max)
    });
    println!("{travel} m, {fastest} m/s; largest error at 100, 50, 25, 12.5 us: {errors:?} m");
    assert!(travel > 1e-3, "{travel}");
    assert!(errors[0] / errors[1] > 6.0 && errors[1] / errors[2] > 6.0, "{errors:?}");
    assert!(errors[3] < 1e-12, "{errors:?}");
}

#[test]
fn open_loop_motion_agrees_with_the_oracle() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../friction-stage-core/tests/oracle");
    let case: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(folder.join("case.json")).unwrap()).unwrap();
    let number = |value: &serde_json::Value| value.as_f64().unwrap();
    let guides: Vec<Guide> = case["guides"]
        .as_array()
        .unwrap()
        .iter()
        .map(|g| Guide {
            stiffness: number(&g["stiffness"]),
            bristle_damping: number(&g["bristle_damping"]),
            viscous: number(&g["viscous_friction"]),
            coulomb_force: number(&g["coulomb_force"]),
            static_force: number(&g["static_force"]),
            stribeck_velocity: number(&g["stribeck_velocity"]),
        })
        .collect();
    for run in case["cases"].as_array().unwrap() {
        let name = run["name"].as_str().unwrap();
        let text = std::fs::read_to_string(folder.join(format!("{name}.csv"))).unwrap();
        let mut rows = text.lines().filter(|line| !line.starts_with('#'));
        let header: Vec<&str> = rows.next().unwrap().split(',').collect();
        let column = |name: &str| header.iter().position(|h| *h == name).unwrap();
        let (position, force) = (column("position"), column("force"));
        let rows: Vec<Vec<f64>> =
            rows.map(|r| r.split(',').map(|f| f.parse().unwrap()).collect()).collect();
        let rate = number(&case["controller"]["rate"]);
        let guides: [Guide; GUIDES] = guides.clone().try_into().unwrap();
        let mut stage = Stage::new(number(&case["mass"]), guides, Vec::new(), 1.0 / rate, STEP);
        let z: Vec<f64> =
            run["initial_bristle_deflections"].as_array().unwrap().iter().map(number).collect();
        stage.deflect(z.try_into().unwrap());
        let mut noise = Noise::new(0, 0);
        let mut worst: f64 = 0.0;
        for (row, next) in rows.iter().zip(&rows[1..]) {
            stage.advance(row[force], &mut noise);
            worst = worst.max((stage.moment(&mut []).position - next[position]).abs());
        }
        println!("{name}: {worst:e} m over {} ticks", rows.len());
        assert!(rows.len() > 500 && worst < 0.05e-9, "{name}: {worst} m");
    }
}

#[test]
fn cell_shows_the_command_of_the_interval_that_ended() {
    let run = quiet(5).generate().unwrap();
    for k in 1..run.train.time.len() {
        assert_eq!(run.train.force_cell[k], run.train.force[k - 1], "row {k}");
    }
}

/// Under held commands a lowpass covers a part of 1 - exp(-h/T) of the way to each, h the interval.
#[test]
fn a_late_cell_follows_each_command_by_an_exponential() {
    let late = ForceCellLag { time_constant: 1e-3 };
    let run = quiet(5).with(late).generate().unwrap();
    let (mut shown, part) = (0.0, 1.0 - (-0.5f64).exp());
    let mut largest: f64 = 0.0;
    for k in 1..run.train.time.len() {
        shown += part * (run.train.force[k - 1] - shown);
        let off = (run.train.force_cell[k] - shown).abs();
        assert!(off < 1e-6, "row {k}: {off} N");
        largest = largest.max((shown - run.train.force[k - 1]).abs());
    }
    assert!(largest > 1.0, "{largest} N");
}

/// Motor, friction and hidden force together are mass times acceleration, whatever is hidden.
#[test]
fn hidden_forces_account_for_the_motion() {
    for (name, _) in CATALOGUE {
        let effect = by_name(name, 9).unwrap();
        let setup = quiet(9).with(effect.clone());
        let setpoints = Programme::Recorded.check(RATE, &mut Noise::new(9, 2));
        let (_, truth) = setup.record(40.0, guides(9), &setpoints, "check", 4).unwrap();
        let hidden = &truth.hidden[0].force;
        let mut checked = 0;
        for (k, &hidden) in hidden.iter().enumerate() {
            // Friction that changes is in the friction force already, what the motor adds in the
            // motor force.
            let own = if effect.side() == Side::Carriage && !effect.changes_friction() {
                hidden
            } else {
                0.0
            };
            let force = truth.motor_force[k] - truth.friction_force[k] + own;
            assert!(
                (force - 40.0 * truth.acceleration[k]).abs() < 1e-9 * (1.0 + force.abs()),
                "{name} row {k}"
            );
            checked += 1;
        }
        assert!(checked > 30_000);
        let size = rms(hidden);
        println!(
            "{name}: {size:.3} N rms, largest {:.2} N",
            hidden.iter().fold(0.0f64, |a, b| a.max(b.abs()))
        );
        if effect.side() == Side::Sensor {
            assert_eq!(size, 0.0, "{name}");
            let hidden = &truth.hidden[0];
            assert!(rms(&hidden.encoder) > 1e-9 || rms(&hidden.cell) > 0.05, "{name}");
        } else {
            assert!(size > 0.1, "{name}: {size} N");
        }
    }
}

#[test]
fn effect_of_no_size_changes_nothing() {
    let setpoints = Programme::Recorded.check(RATE, &mut Noise::new(2, 2));
    let guides = guides(2);
    let (plain, _) = quiet(2).record(40.0, guides, &setpoints, "check", 4).unwrap();
    for (name, _) in CATALOGUE {
        // Scaled to nothing some laws divide by it, so to next to nothing.
        let effect = by_name(name, 2).unwrap().scaled(1e-9);
        if name == "distributed_bristles" && effect.parameters().contains(&("sudden", 1.0)) {
            // Elements that slip suddenly are another law even when they are all equal.
            continue;
        }
        let (columns, _) =
            quiet(2).with(effect).record(40.0, guides, &setpoints, "check", 4).unwrap();
        let worst = columns
            .position
            .iter()
            .zip(&plain.position)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f64::max);
        assert!(worst < 1e-9, "{name}: {worst} m");
    }
}

#[test]
fn twice_the_effect_is_twice_the_force() {
    let setpoints = Programme::Recorded.check(RATE, &mut Noise::new(4, 2));
    let size = |effect: Effect| {
        let (_, truth) =
            quiet(4).with(effect).record(40.0, guides(4), &setpoints, "check", 4).unwrap();
        truth.hidden[0].force_rms()
    };
    for name in [
        "cogging",
        "constant_force",
        "quadratic_drag",
        "payload",
        "saturating_brake",
        "ball_passage",
        "dead_zone",
        "hardening_spring",
        "speed_ripple",
    ] {
        let effect = by_name(name, 4).unwrap();
        let ratio = size(effect.scaled(2.0)) / size(effect.clone());
        assert!((ratio - 2.0).abs() < 0.05, "{name}: {ratio}");
    }
}

#[test]
fn payload_and_tilt_act_as_newton_says() {
    let setup = quiet(6).with(Payload { mass: 2.0 }).with(ConstantForce { mass: 40.0, tilt: 1e-3 });
    let setpoints = Programme::Recorded.check(RATE, &mut Noise::new(6, 2));
    let (_, truth) = setup.record(40.0, guides(6), &setpoints, "check", 4).unwrap();
    for k in 0..truth.position.len() {
        assert!((truth.hidden[0].force[k] + 2.0 * truth.acceleration[k]).abs() < 1e-9);
        assert!(
            (truth.hidden[1].force[k] - 0.392_266).abs() < 1e-6,
            "{}",
            truth.hidden[1].force[k]
        );
    }
}

fn check_record(seed: u64, effect: impl Into<Effect>) -> (Columns, RecordTruth) {
    let setpoints = Programme::Recorded.check(RATE, &mut Noise::new(seed, 2));
    quiet(seed).with(effect).record(40.0, guides(seed), &setpoints, "check", 4).unwrap()
}

#[test]
fn asymmetric_friction_has_the_same_sign_in_both_directions() {
    let (a, b) = (0.05, 0.2);
    let (columns, truth) = check_record(8, AsymmetricFriction { coulomb: a, viscous: b });
    let guides = guides(8);
    let (fc, viscous): (f64, f64) =
        guides.iter().fold((0.0, 0.0), |(f, d), g| (f + g.coulomb_force, d + g.viscous));
    let mut directions = [0; 2];
    for k in 0..columns.time.len() {
        let v = truth.velocity[k];
        if v.abs() > 0.1 && truth.acceleration[k].abs() < 0.05 {
            let expected = -(a * fc + b * viscous * v.abs());
            let force = truth.hidden[0].force[k];
            assert!(
                (force - expected).abs() < 0.02,
                "row {k} at {v} m/s: {force} N, expected {expected} N"
            );
            directions[usize::from(v > 0.0)] += 1;
        }
    }
    assert!(directions.iter().all(|&rows| rows > 20), "{directions:?}");
}

/// Where the speed is held, the effect adds `share` of the Coulomb part of all guides, at a time
/// (s) and a command (N).
fn coulomb_part_of(effect: impl Into<Effect>, share: impl Fn(f64, f64) -> f64) {
    let (columns, truth) = check_record(8, effect);
    let coulomb: f64 = guides(8).iter().map(|g| g.coulomb_force).sum();
    let mut directions = [0; 2];
    for k in 2..columns.time.len() {
        let v = truth.velocity[k];
        // The bristles need some intervals to follow another command.
        let is_steady = (columns.force[k - 1] - columns.force[k - 2]).abs() < 0.3;
        if v.abs() > 0.05 && truth.acceleration[k].abs() < 0.05 && is_steady {
            let expected = -share(columns.time[k], columns.force[k - 1]) * coulomb * v.signum();
            let force = truth.hidden[0].force[k];
            assert!(
                (force - expected).abs() < 0.05,
                "row {k} at {v} m/s: {force} N, expected {expected} N"
            );
            directions[usize::from(v > 0.0)] += 1;
        }
    }
    assert!(directions.iter().all(|&rows| rows > 20), "{directions:?}");
}

#[test]
fn friction_grows_with_command_and_time() {
    coulomb_part_of(LoadDependentFriction { rate: 1e-3 }, |_, u| 1e-3 * u.abs());
    coulomb_part_of(FrictionDrift { fraction: -0.2, time_constant: 5.0 }, |t, _| {
        -0.2 * (1.0 - (-t / 5.0).exp())
    });
}

#[test]
fn late_stribeck_curve_is_that_of_another_velocity_until_the_speed_is_held() {
    // Of a bristle that has settled at g(0) = Fs.
    let (guide, v) = (Guide::NOMINAL, 0.1);
    let change = Change { sliding_velocity: Some(0.0), ..Change::default() };
    let z = [guide.static_force / guide.stiffness; GUIDES];
    let mut rate = [1.0; GUIDES];
    let force = Elements::single().force(&[guide; GUIDES], v, &change, &z, &mut rate);
    assert!((force - 4.0 * (guide.static_force + guide.viscous * v)).abs() < 1e-9, "{force} N");
    assert!(rate.iter().all(|rate| rate.abs() < 1e-12), "{rate:?}");
    // The record has both signs of the difference, and none at speed.
    let (_, truth) = check_record(8, FrictionalLag { time_constant: 0.01 });
    let (mut more, mut less) = (0.0f64, 0.0f64);
    for (force, v) in truth.hidden[0].force.iter().zip(&truth.velocity) {
        if v.abs() > 1e-3 {
            more = more.max(-force * v.signum());
            less = less.min(-force * v.signum());
        }
    }
    assert!(more > 1.0 && less < -1.0, "{more} N, {less} N");
    let held = (200..truth.velocity.len()).filter(|&k| {
        let past = &truth.velocity[k - 200..=k];
        past.iter().all(|v| v.abs() > 0.03 && v.signum() == past[0].signum())
    });
    let at_speed: Vec<f64> = held.map(|k| truth.hidden[0].force[k].abs()).collect();
    assert!(at_speed.len() > 200, "{} rows", at_speed.len());
    assert!(at_speed.iter().all(|force| *force < 0.01));
}

#[test]
fn speed_ripple_is_a_damping_that_varies_along_the_track() {
    for odd in [true, false] {
        let ripple = SpeedRipple { coefficient: 30.0, period: 0.02, phase: 0.4, odd };
        let (columns, truth) = check_record(8, ripple);
        for k in 1..columns.time.len() {
            let (x, v) = (truth.position[k], truth.velocity[k]);
            let speed = if odd { v } else { v.abs() };
            let expected = 30.0 * speed * (std::f64::consts::TAU * x / 0.02 - 0.4).cos();
            let force = columns.force_cell[k] - columns.force[k - 1];
            assert!((force - expected).abs() < 1e-9, "row {k}: {force} N, expected {expected} N");
        }
    }
}

/// Pushed with 400 N from rest, the carriage is lighter by a part with play until it has travelled
/// half the play; later the part moves with it.
#[test]
fn part_with_play_is_missing_until_a_stop_takes_it_along() {
    let part = Backlash { mass: 2.0, play: 2e-4, frequency: 100.0, damping: 0.2 };
    let motion = |step: f64| {
        let mut stage = nominal(vec![part.clone().into()], step);
        let mut noise = Noise::new(0, 0);
        (0..200)
            .map(|_| {
                stage.advance(400.0, &mut noise);
                let mut forces = [0.0];
                (stage.moment(&mut forces), forces[0])
            })
            .collect::<Vec<_>>()
    };
    let rows = motion(STEP);
    let free = rows.iter().take_while(|(row, _)| row.position < 1e-4);
    let mut apart = 0;
    for (row, force) in free {
        assert!((force - 2.0 * row.acceleration).abs() < 1e-9, "{row:?}: {force} N");
        apart += 1;
    }
    assert!(apart > 5, "{apart} rows");
    // A stop never pulls, and pushes at first by more than what moves the part.
    assert!(rows.iter().all(|(row, force)| force - 2.0 * row.acceleration < 1e-9));
    assert!(rows.iter().any(|(row, force)| *force < -row.acceleration));
    for (row, force) in &rows[180..] {
        assert!(force.abs() < 0.02 * row.acceleration, "{row:?}: {force} N");
    }
    let worst = motion(2e-6)
        .iter()
        .zip(&rows)
        .map(|(fine, row)| (fine.0.position - row.0.position).abs())
        .fold(0.0, f64::max);
    assert!(worst < 4e-10, "{worst} m");
}

#[test]
fn lag_is_a_first_order_and_a_delay_of_the_held_command() {
    let (columns, _) = check_record(8, ActuatorLag { time_constant: 0.4e-3, delay: 0.0 });
    let stay = (-0.5f64 / 0.4).exp();
    for k in 1..columns.time.len() {
        let expected =
            columns.force[k - 1] + (columns.force_cell[k - 1] - columns.force[k - 1]) * stay;
        assert!(
            (columns.force_cell[k] - expected).abs() < 1e-3,
            "row {k}: {} N, {expected} N",
            columns.force_cell[k]
        );
    }
    // 1.2 ms before the end of an interval of 0.5 ms the command of two ticks earlier was held.
    let (columns, _) = check_record(8, ActuatorLag { time_constant: 0.0, delay: 1.2e-3 });
    for k in 3..columns.time.len() {
        assert_eq!(columns.force_cell[k], columns.force[k - 3], "row {k}");
    }
    // With a gain the order does not matter.
    let setpoints = Programme::Recorded.check(RATE, &mut Noise::new(8, 2));
    let both = quiet(8)
        .with(MotorGain { fraction: 0.03 })
        .with(ActuatorLag { time_constant: 0.0, delay: 0.3e-3 });
    let (columns, _) = both.record(40.0, guides(8), &setpoints, "check", 4).unwrap();
    for k in 1..columns.time.len() {
        let expected = 1.03 * columns.force[k - 1];
        assert!(
            (columns.force_cell[k] - expected).abs() < 1e-9 * (1.0 + expected.abs()),
            "row {k}"
        );
    }
}

/// The cell shows what the motor made of the command of the tick before.
fn motor_of(effect: impl Into<Effect>, expected: impl Fn(f64, f64) -> f64) {
    let (columns, truth) = check_record(8, effect);
    for k in 1..columns.time.len() {
        let expected = expected(columns.force[k - 1], truth.velocity[k]);
        let found = columns.force_cell[k];
        assert!((found - expected).abs() < 1e-6, "row {k}: {found} N, expected {expected} N");
    }
}

#[test]
fn motors_lose_force_with_command_and_speed() {
    motor_of(
        DeadZone { width: 3.0 },
        |u, _| if u.abs() < 3.0 { 0.0 } else { u - 3.0 * u.signum() },
    );
    // 1/F^2 = 1/u^2 + 1/S^2.
    motor_of(MotorSaturation { limit: 3000.0 }, |u, _| {
        if u == 0.0 { 0.0 } else { u.signum() / (u.powi(-2) + 3000f64.powi(-2)).sqrt() }
    });
    motor_of(MotorDroop { coefficient: 0.1 }, |u, v| u - 0.1 * v.abs() * u);
}

#[test]
fn hardening_spring_has_the_cubic_part_of_its_stretch() {
    let spring = HardeningSpring { hardening: 2000.0, center: 0.02 };
    let (_, truth) = check_record(8, spring);
    for (force, position) in truth.hidden[0].force.iter().zip(&truth.position) {
        let stretch = position - 0.02;
        let expected = -2000.0 * stretch * stretch * stretch;
        assert!((force - expected).abs() < 1e-9, "{position} m: {force} N, {expected} N");
    }
}

#[test]
fn cyclic_error_of_the_encoder_repeats_over_its_period() {
    let cyclic = EncoderCyclicError { amplitude: 4e-6, period: 0.02, phase: 0.0 };
    let (columns, truth) = check_record(8, cyclic);
    for k in 0..columns.time.len() {
        let error = columns.position[k] - truth.position[k];
        // Half a turn on it has the other sign.
        let expected = -4e-6 * (std::f64::consts::TAU * (truth.position[k] + 0.01) / 0.02).cos();
        assert!((error - expected).abs() < 1e-12, "row {k}: {error} m, {expected} m");
    }
}

/// The encoder is ahead of the carriage by what the drive yields under the force that moves it.
#[test]
fn an_encoder_on_the_motor_is_ahead_by_the_force_over_the_stiffness() {
    let (columns, truth) = check_record(8, EncoderCompliance { compliance: 1e-8 });
    for k in 1..columns.time.len() {
        let ahead = columns.position[k] - truth.position[k];
        let expected = columns.force[k - 1] / 1e8;
        assert!((ahead - expected).abs() < 1e-14, "row {k}: {ahead} m, {expected} m");
    }
}

#[test]
fn readings_are_the_truth_and_the_error_of_the_sensor() {
    let (columns, truth) =
        check_record(8, EncoderSde { amplitude: 1e-7, period: 2e-5, phase: 0.3 });
    let mut largest: f64 = 0.0;
    for k in 0..columns.time.len() {
        let error = columns.position[k] - truth.position[k];
        assert!((error - truth.hidden[0].encoder[k]).abs() < 1e-15, "row {k}: {error} m");
        largest = largest.max(error.abs());
    }
    assert!(largest > 0.9e-7 && largest < 1.26e-7, "{largest}");
    let (columns, truth) = check_record(8, ForceCellDrift::new(0.1, 0.0));
    for k in 0..columns.time.len() {
        let error = columns.force_cell[k] - truth.motor_force[k];
        assert!((error - 0.1 * columns.time[k]).abs() < 1e-9, "row {k}: {error} N");
    }
}

#[test]
fn cable_chain_pulls_with_its_spring_about_its_center() {
    let chain = CableChain { stiffness: 50.0, center: 0.03, hysteresis: 1.0, length: 0.005 };
    let (_, truth) = check_record(8, chain);
    for k in 0..truth.position.len() {
        let spring = -50.0 * (truth.position[k] - 0.03);
        let rest = truth.hidden[0].force[k] - spring;
        assert!(rest.abs() < 1.001, "row {k}: {rest} N of hysteresis");
        if truth.velocity[k].abs() > 0.3 && truth.acceleration[k].abs() < 0.5 {
            assert!((rest + truth.velocity[k].signum()).abs() < 0.01, "row {k}: {rest} N");
        }
    }
}

/// Elements of one guide: the force after a reversal follows the sum of springs up to their limits
/// (Masing's rule).
#[test]
fn sudden_elements_make_masing_loops() {
    let shares = vec![(0.5, 0.2), (0.5, 0.8)];
    let elements = Elements { shares, slip: Slip::Sudden };
    let guide = Guide { bristle_damping: 0.0, viscous: 0.0, static_force: 13.5, ..Guide::NOMINAL };
    let guides = [guide; GUIDES];
    let change = Change::default();
    let (mut z, mut rate) = (vec![0.0; elements.states()], vec![0.0; elements.states()]);
    let travel = 1e-9;
    let mut go = |distance: f64| {
        // Slow enough for the settling at a limit to be nothing.
        let v = 1e-3 * distance.signum();
        let mut force = 0.0;
        for _ in 0..(distance.abs() / travel).round() as usize {
            elements.force(&guides, v, &change, &z, &mut rate);
            z.iter_mut().zip(&rate).for_each(|(z, rate)| *z += rate * travel / v.abs());
            force = elements.force(&guides, v, &change, &z, &mut rate);
        }
        force / GUIDES as f64
    };
    // Slip limits: 0.2/0.5 and 0.8/0.5 of 30 µm, so 12 and 48 µm.
    let (k, fc) = (guide.stiffness, guide.coulomb_force);
    let close = |force: f64, expected: f64| {
        assert!((force - expected).abs() < 0.01, "{force} N, expected {expected}")
    };
    close(go(6e-6), k * 6e-6);
    close(go(24e-6), 0.2 * fc + 0.5 * k * 30e-6);
    close(go(40e-6), fc);
    // Reversed: both stick over twice their limits.
    close(go(-20e-6), fc - k * 20e-6);
    close(go(-26e-6), fc - 0.4 * fc - 0.5 * k * 46e-6);
    close(go(-80e-6), -fc);
}

#[test]
fn setpoints_are_consistent_and_within_the_stroke() {
    for programme in [Programme::Recorded, Programme::Varied] {
        for seed in 0..4 {
            let mut noise = Noise::new(seed, 2);
            for (setpoints, shortest, longest) in [
                (programme.train(RATE, &mut noise), 35.0, 62.0),
                (programme.check(RATE, &mut noise), 14.0, 26.0),
            ] {
                let (x, v, a) = (&setpoints.position, &setpoints.velocity, &setpoints.acceleration);
                let duration = x.len() as f64 / RATE;
                assert!(
                    duration > shortest && duration < longest,
                    "{programme:?} {seed}: {duration} s"
                );
                assert!(
                    x.iter().all(|x| x.abs() < 0.3) && v.iter().all(|v| v.abs() < 1.01),
                    "{programme:?} {seed}"
                );
                for k in 0..x.len() - 1 {
                    let slope = (x[k + 1] - x[k]) * RATE;
                    let bend = (a[k + 1] - a[k]).abs();
                    // Trapezoidal rule; a piece can end within a tick.
                    let tolerance = (bend + a[k].abs()) / RATE + 1e-9;
                    assert!(
                        (slope - 0.5 * (v[k] + v[k + 1])).abs() < tolerance,
                        "{programme:?} {seed} row {k}: {slope}"
                    );
                    let change = (v[k + 1] - v[k]) * RATE;
                    let tolerance = bend + 0.12 * a[k].abs() + 1e-6;
                    assert!(
                        (change - 0.5 * (a[k] + a[k + 1])).abs() < tolerance,
                        "{programme:?} {seed} row {k}: {change}"
                    );
                }
            }
        }
    }
}

#[test]
fn seed_fixes_everything_and_effects_do_not_move_it() {
    let plain = Setup::new(12).generate().unwrap();
    let again = Setup::new(12).generate().unwrap();
    assert_eq!(plain.train, again.train);
    assert_eq!(plain.check, again.check);
    let other = Setup::new(13).generate().unwrap();
    assert_ne!(plain.truth.guides, other.truth.guides);
    let hidden = Setup::new(12).with(Cogging::new(3.0, 0.02, 0.5)).generate().unwrap();
    assert_eq!(plain.truth.guides, hidden.truth.guides);
    assert_eq!(plain.train.reference_position, hidden.train.reference_position);
    assert_ne!(plain.train.force, hidden.train.force);
    for guide in plain.truth.guides {
        for (value, nominal) in [
            (guide.stiffness, Guide::NOMINAL.stiffness),
            (guide.static_force, Guide::NOMINAL.static_force),
            (guide.stribeck_velocity, Guide::NOMINAL.stribeck_velocity),
        ] {
            assert!((value / nominal - 1.0).abs() <= 0.16, "{value}");
        }
        assert!(guide.static_force > guide.coulomb_force);
    }
    assert!((plain.truth.mass / 40.0 - 1.0).abs() <= 0.005);
}

#[test]
fn compositions_hide_different_listed_effects() {
    for seed in 0..50 {
        let names: Vec<&str> =
            composition(&CATALOGUE[..LISTED], 3, seed).iter().map(|e| e.name()).collect();
        assert_eq!(names.len(), 3);
        assert!(names[0] != names[1] && names[1] != names[2] && names[0] != names[2], "{names:?}");
    }
    for (index, (name, _)) in CATALOGUE.iter().enumerate() {
        let effect = by_name(name, 1).unwrap();
        assert_eq!(effect.name(), *name);
        assert_eq!(effect.listed(), index < LISTED, "{name}");
        assert_eq!(effect.coordinate().is_some(), index >= LISTED, "{name}");
    }
}

#[test]
fn noise_has_the_moments_of_a_normal_and_streams_are_apart() {
    let (mut one, mut two) = (Noise::new(1, 1), Noise::new(1, 2));
    let count = 200_000;
    let a: Vec<f64> = (0..count).map(|_| one.normal()).collect();
    let b: Vec<f64> = (0..count).map(|_| two.normal()).collect();
    let mean = |f: &dyn Fn(usize) -> f64| (0..count).map(f).sum::<f64>() / count as f64;
    // Five standard deviations of each estimate.
    let five = 5.0 / (count as f64).sqrt();
    assert!(mean(&|i| a[i]).abs() < five);
    assert!((mean(&|i| a[i] * a[i]) - 1.0).abs() < five * 2f64.sqrt());
    assert!((mean(&|i| a[i].powi(4)) - 3.0).abs() < five * 96f64.sqrt());
    assert!(mean(&|i| a[i] * b[i]).abs() < five);
    assert!(mean(&|i| a[i] * a[(i + 1) % count]).abs() < five);
}

#[test]
fn bags_read_back_as_they_were_generated() {
    let folder = tempfile::tempdir().unwrap();
    let run = Setup::new(21).with(Cogging::new(2.0, 0.024, 0.1)).generate().unwrap();
    let (bags, truth) = (folder.path().join("bags"), folder.path().join("truth"));
    run.write(&bags, &truth).unwrap();
    for (name, columns) in [("train", &run.train), ("check", &run.check)] {
        let read = friction_stage_data::signals::Trace::from_bag(bags.join(name)).unwrap();
        let written = columns.to_trace();
        assert_eq!(read.origin_ns, written.origin_ns);
        assert_eq!(read.columns()[1..], written.columns()[1..]);
        // Stamps are whole nanoseconds.
        assert!(read.time.iter().zip(&written.time).all(|(a, b)| (a - b).abs() < 1e-9));
    }
    let text = std::fs::read_to_string(truth.join("truth.json")).unwrap();
    assert!(text.contains("\"cogging\"") && text.contains("\"period\": 0.024"), "{text}");
    let rows = std::fs::read_to_string(truth.join("truth_train.csv")).unwrap().lines().count();
    assert_eq!(rows, run.train.time.len() + 1);
}

/// The generator is no test of the library if it is made of it.
#[test]
fn generator_shares_nothing_with_what_is_identified() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut folders = vec![root];
    let mut files = 0;
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            files += 1;
            let text = std::fs::read_to_string(&path).unwrap();
            for line in text.lines().filter(|line| line.contains("friction_stage_")) {
                let allowed = line.contains("friction_stage_data::bag::")
                    || line.contains("friction_stage_data::signals::")
                    || line.contains("friction_stage_data::message::");
                assert!(allowed, "{}: {line}", path.display());
            }
            for word in ["rand_chacha", "rand_distr"] {
                assert!(!text.contains(word), "{} uses {word}", path.display());
            }
        }
    }
    assert!(files >= 12, "{files} files");
}

/// None to three effects together, on the recorded motion or a varied one, keep the loop.
fn generate_composition(seed: u64) {
    let programme = if seed.is_multiple_of(2) { Programme::Recorded } else { Programme::Varied };
    let hidden = composition(&CATALOGUE[..LISTED], seed as usize % 4, seed);
    Setup { programme, ..Setup::new(seed) }.with_all(hidden).generate().unwrap();
}

#[test]
fn compositions_keep_the_loop_on_either_motion() {
    (2..4).for_each(generate_composition);
}
