//! `friction-stage identify` on recordings that cannot tell what is asked, at the process boundary:
//! bags and CSV files without a signal, with a wrong sign or unit, cut off, of another machine. A
//! clear sentence, the right exit code, and never an effect that only the broken signal made:
//! nothing is hidden in these recordings.
//!
//! Each comes from `crates/blind-tests`, which shares no equation with the library.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use blind_tests::noise::Noise;
use blind_tests::programme::Setpoints;
use blind_tests::{Columns, Guide, Setup};
use friction_stage_data::bag::{BagOptions, BagWriter, OfferedQos, topics};
use friction_stage_data::message::{Header, JointState};
use tempfile::TempDir;

const MODEL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/launch_config/stage_measured_runs.yaml");
/// Samples per second, Hz.
const RATE: f64 = 2000.0;

/// Rest-to-rest moves to places within 50 mm in 0.15 to 1 s, each with a short rest.
fn moves(seconds: f64, seed: u64) -> Setpoints {
    let mut noise = Noise::new(seed, 9);
    let mut rows = Setpoints::default();
    let mut at = 0.0;
    while (rows.position.len() as f64) < seconds * RATE {
        let distance = noise.between(-0.05, 0.05) - at;
        let duration = noise.between(0.15, 1.0);
        let count = (duration * RATE) as usize;
        for k in 0..count {
            let u = k as f64 / count as f64;
            rows.position.push(at + distance * u.powi(3) * (10.0 - 15.0 * u + 6.0 * u * u));
            rows.velocity.push(distance / duration * 30.0 * (u * (1.0 - u)).powi(2));
            rows.acceleration
                .push(distance / duration.powi(2) * 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u));
        }
        at += distance;
        for _ in 0..(0.1 * RATE) as usize {
            rows.position.push(at);
            rows.velocity.push(0.0);
            rows.acceleration.push(0.0);
        }
    }
    rows
}

/// There and back over some 40 mm at 50 mm/s, from one direction to the other by half a cosine.
fn one_speed(seconds: f64) -> Setpoints {
    let (speed, ramp, period) = (0.05, 0.05, 1.7);
    let mut rows = Setpoints::default();
    let (mut position, mut last) = (0.0, 0.0);
    for k in 0..(seconds * RATE) as usize {
        let time = k as f64 / RATE;
        let (sign, since) = if time % period < 0.5 * period {
            (1.0, time % period)
        } else {
            (-1.0, time % period - 0.5 * period)
        };
        let turn = (std::f64::consts::PI * since / ramp).cos();
        let velocity = match since < ramp {
            true if time < ramp => speed * 0.5 * (1.0 - turn),
            true => -sign * speed * turn,
            false => sign * speed,
        };
        position += 0.5 * (velocity + last) / RATE;
        rows.position.push(position);
        rows.velocity.push(velocity);
        rows.acceleration.push((velocity - last) * RATE);
        last = velocity;
    }
    rows
}

/// What encoder, cell and controller show along the setpoints, on a stage within its tolerances and
/// without a hidden effect.
fn along(setpoints: &Setpoints, seed: u64) -> Columns {
    along_with_noise(setpoints, seed, 1.0)
}

/// The same with so many times the declared noise of both sensors.
fn along_with_noise(setpoints: &Setpoints, seed: u64, times: f64) -> Columns {
    let mut setup = Setup::new(5);
    setup.noise.encoder *= times;
    setup.noise.cell *= times;
    let mut drawn = Noise::new(5, 1);
    let guides = [(); 4].map(|()| Guide::draw(setup.guide_tolerance, &mut drawn));
    setup.record(40.1, guides, setpoints, "train", seed).unwrap().0
}

fn train() -> Columns {
    along(&moves(10.0, 3), 3)
}

fn holdout() -> Columns {
    along(&moves(8.0, 4), 4)
}

/// With a force of the motor over the position hidden.
fn with_cogging(mut columns: Columns) -> Columns {
    let hidden = columns.position.iter().map(|x| 4.0 * (std::f64::consts::TAU * x / 0.024).sin());
    columns.force.iter_mut().zip(hidden).for_each(|(force, hidden)| *force -= hidden);
    columns
}

fn csv(home: &Path, name: &str, columns: &Columns) -> PathBuf {
    let path = home.join(format!("{name}.csv"));
    columns.to_trace().write_csv(&path).unwrap();
    path
}

fn identify(model: &str, train: &Path, holdout: &Path, out: &Path) -> Output {
    identify_with(model, train, holdout, out, &[])
}

fn identify_with(model: &str, train: &Path, holdout: &Path, out: &Path, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .args(["identify", "--force", "--model", model, "--json", "--train"])
        .arg(train)
        .arg("--holdout")
        .arg(holdout)
        .arg("--out")
        .arg(out)
        .args(more)
        .output()
        .unwrap()
}

/// Refused with every one of the words, without a verdict.
fn assert_refused(name: &str, output: &Output, out: &Path, words: &[&str]) {
    let reported = String::from_utf8_lossy(&output.stderr);
    assert_eq!(
        output.status.code(),
        Some(1),
        "{name}: {reported}{}",
        String::from_utf8_lossy(&output.stdout)
    );
    for word in words {
        assert!(reported.contains(word), "{name}: {word:?} is not in {reported}");
    }
    assert!(
        !reported.contains("panicked") && !out.join("summary.json").exists(),
        "{name}: {reported}"
    );
}

/// Done with warnings, all words in them, without an effect; gives the verdict.
fn warned(name: &str, output: &Output, words: &[&str]) -> String {
    let reported = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{name}: {reported}");
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let warnings = summary["warnings"].to_string();
    for word in words {
        assert!(warnings.contains(word), "{name}: {word:?} is not in {warnings}");
    }
    assert_eq!(summary["effects"].as_array().map(Vec::len), Some(0), "{name}: {summary:#}");
    assert!(summary["verdict"] != "found", "{name}: {summary:#}");
    summary["verdict"].as_str().unwrap().to_owned()
}

fn each(column: &mut [f64], change: impl Fn(f64) -> f64) {
    column.iter_mut().for_each(|value| *value = change(*value));
}

fn both_forces(columns: &mut Columns, change: impl Fn(f64) -> f64) {
    each(&mut columns.force_cell, &change);
    each(&mut columns.force, &change);
}

fn setpoint(columns: &mut Columns, change: impl Fn(f64) -> f64) {
    each(&mut columns.reference_position, &change);
    each(&mut columns.reference_velocity, &change);
    each(&mut columns.reference_acceleration, &change);
}

type Case = (&'static str, fn(&mut Columns), &'static [&'static str]);

#[test]
fn wrong_signs_and_units_are_named_with_the_signal() {
    let cases: [Case; 14] = [
        (
            "cell_swapped",
            |c| each(&mut c.force_cell, |f| -f),
            &["force_cell has the wrong sign", "scale: -1"],
        ),
        ("command_swapped", |c| each(&mut c.force, |f| -f), &["force has the wrong sign"]),
        // Nothing tells a machine whose position is swapped from one whose forces are.
        (
            "forces_swapped",
            |c| both_forces(c, |f| -f),
            &["position has the wrong sign", "unless it is every force"],
        ),
        (
            "position_swapped",
            |c| each(&mut c.position, |x| -x),
            &["position has the wrong sign", "position and reference_position do not fit"],
        ),
        (
            "position_mm",
            |c| each(&mut c.position, |x| 1e3 * x),
            &["position seems to be in mm", "40 kg is declared"],
        ),
        (
            "all_mm",
            |c| {
                each(&mut c.position, |x| 1e3 * x);
                setpoint(c, |x| 1e3 * x);
            },
            &["position seems to be in mm"],
        ),
        (
            "setpoint_mm",
            |c| setpoint(c, |x| 1e3 * x),
            &["position and reference_position do not fit together"],
        ),
        (
            "forces_kn",
            |c| both_forces(c, |f| 1e-3 * f),
            &["force_cell seems to be in kN", "force seems to be in kN"],
        ),
        ("cell_kn", |c| each(&mut c.force_cell, |f| 1e-3 * f), &["force_cell seems to be in kN"]),
        (
            "command_volt",
            |c| each(&mut c.force, |f| f / 35.0),
            &["force_cell and force do not fit together", "unit"],
        ),
        (
            "exchanged",
            |c| std::mem::swap(&mut c.force_cell, &mut c.force),
            &["force_cell and force do not fit together", "they are swapped"],
        ),
        ("time_ms", |c| each(&mut c.time, |t| 1e3 * t), &["time seems to be in ms"]),
        (
            "less_than_half",
            |c| both_forces(c, |f| 0.45 * f),
            &["declares 40 kg", "another machine, a payload, or a wrong unit"],
        ),
        ("nine_times", |c| both_forces(c, |f| 7.0 * f), &["declares 40 kg", "another machine"]),
    ];
    refused_on_either_side(&cases);
}

#[test]
fn what_lacks_motion_force_or_length_is_refused() {
    let cases: [Case; 6] = [
        ("no_force", |c| both_forces(c, |_| f64::NAN), &["there is no force", "/stage/force_cell"]),
        ("no_position", |c| each(&mut c.position, |_| f64::NAN), &["0 usable samples of position"]),
        ("still", |c| each(&mut c.position, |_| 0.01), &["nothing moves", "record a motion"]),
        (
            "dead_forces",
            |c| both_forces(c, |_| 0.0),
            &["there is no force", "is constant (0)", "not connected"],
        ),
        // Cut off below what friction alone needs: nothing is left that could be fitted.
        (
            "forces_cut_off",
            |c| both_forces(c, |f| f.clamp(-20.0, 20.0)),
            &["stays at its extreme 20"],
        ),
        (
            "ten_samples",
            |c| {
                for column in [
                    &mut c.time,
                    &mut c.position,
                    &mut c.force_cell,
                    &mut c.force,
                    &mut c.reference_position,
                    &mut c.reference_velocity,
                    &mut c.reference_acceleration,
                ] {
                    column.truncate(10);
                }
            },
            &["10 rows", "record longer"],
        ),
    ];
    refused_on_either_side(&cases);
}

fn refused_on_either_side(cases: &[Case]) {
    let home = TempDir::new().unwrap();
    let (train, holdout) = (train(), holdout());
    let good = [csv(home.path(), "good_train", &train), csv(home.path(), "good_holdout", &holdout)];
    for (name, change, words) in cases {
        let bad = [&train, &holdout].map(|columns| {
            let mut changed = columns.clone();
            change(&mut changed);
            changed
        });
        let bad =
            [csv(home.path(), &format!("{name}_train"), &bad[0]), csv(home.path(), name, &bad[1])];
        let out = home.path().join(format!("out_{name}"));
        for (train, holdout, file) in
            [(&bad[0], &good[1], "_train.csv"), (&good[0], &bad[1], ".csv")]
        {
            let output = identify(MODEL, train, holdout, &out);
            let file = format!("{name}{file}");
            assert_refused(name, &output, &out, &[words, &[file.as_str()][..]].concat());
        }
    }
}

#[test]
fn a_signal_that_is_broken_in_part_is_told_and_hides_nothing_new() {
    let cases: [Case; 8] = [
        (
            "cell_constant",
            |c| each(&mut c.force_cell, |_| 3.0),
            &["force_cell is constant (3)", "left out", "there is no force cell"],
        ),
        (
            "cell_stuck",
            |c| c.force_cell[9000..].fill(12.5),
            &["force_cell stays at 12.5 for", "left out"],
        ),
        (
            "position_stuck",
            |c| {
                let value = c.position[12_000];
                c.position[12_000..].fill(value);
            },
            &["position stays at", "left out"],
        ),
        (
            "cell_cut_off",
            |c| each(&mut c.force_cell, |f| f.clamp(-300.0, 300.0)),
            &["its extreme 300", "left out"],
        ),
        (
            "position_cut_off",
            |c| each(&mut c.position, |x| x.clamp(-0.035, 0.035)),
            &["its extreme 0.035", "left out"],
        ),
        (
            "setpoint_constant",
            |c| setpoint(c, |_| 0.0),
            &["reference_position is constant", "there is no setpoint"],
        ),
        (
            "nan",
            |c| c.force_cell[4000..7000].fill(f64::NAN),
            &["3000 of", "force_cell are NaN", "taken as missing"],
        ),
        (
            "infinite",
            |c| c.position.iter_mut().step_by(997).for_each(|x| *x = f64::INFINITY),
            &["of position are NaN or infinite"],
        ),
    ];
    let home = TempDir::new().unwrap();
    let (train, holdout) = (train(), holdout());
    for (name, change, words) in cases {
        let [train, holdout] = [&train, &holdout].map(|columns| {
            let mut changed = columns.clone();
            change(&mut changed);
            changed
        });
        let (train, holdout) =
            (csv(home.path(), "train", &train), csv(home.path(), "holdout", &holdout));
        let verdict =
            warned(name, &identify(MODEL, &train, &holdout, &home.path().join(name)), words);
        assert_eq!(verdict, "none", "{name}");
    }
}

/// Nothing is hidden, and nothing comes of samples that are lost: of all signals, of the cell alone
/// that comes with every fourth row, or of lines that drop out.
#[test]
fn samples_that_are_missing_slow_or_drop_out_make_no_effect() {
    let home = TempDir::new().unwrap();
    let out = home.path().join("out");
    let (train, holdout) = (train(), holdout());
    // Every 53rd line is lost.
    let lossy = |name: &str, columns: &Columns| {
        let path = csv(home.path(), name, columns);
        let text = std::fs::read_to_string(&path).unwrap();
        let kept: Vec<&str> = text
            .lines()
            .enumerate()
            .filter(|(line, _)| *line == 0 || line % 53 != 0)
            .map(|(_, line)| line)
            .collect();
        std::fs::write(&path, kept.join("\n")).unwrap();
        path
    };
    let output =
        identify(MODEL, &lossy("lossy_train", &train), &lossy("lossy_holdout", &holdout), &out);
    assert_eq!(
        warned("lost lines", &output, &["are filled in for samples that are missing"]),
        "none"
    );

    let slow = |name: &str, columns: &Columns| {
        let mut columns = columns.clone();
        columns
            .force_cell
            .iter_mut()
            .enumerate()
            .filter(|(row, _)| row % 4 != 0)
            .for_each(|(_, cell)| *cell = f64::NAN);
        csv(home.path(), name, &columns)
    };
    let output =
        identify(MODEL, &slow("slow_train", &train), &slow("slow_holdout", &holdout), &out);
    assert_eq!(warned("a slow cell", &output, &["force_cell"]), "none");

    let torn = |name: &str, columns: &Columns| {
        let mut columns = columns.clone();
        (columns.position[5000], columns.position[5001], columns.force_cell[9000]) =
            (0.3, 0.3, 900.0);
        csv(home.path(), name, &columns)
    };
    let output =
        identify(MODEL, &torn("torn_train", &train), &torn("torn_holdout", &holdout), &out);
    let words = ["position is 3.000000e-1 at 2.5000 s", "force_cell is 9.000000e2 at 4.5000 s"];
    assert_eq!(warned("drop-outs", &output, &words), "none");
}

/// Of sensors that are noisier than declared the noise is no effect: the residual is judged against
/// what the record shows of it, friction that follows a noisy encoder included.
#[test]
fn sensors_that_are_noisier_than_declared_make_no_effect() {
    let home = TempDir::new().unwrap();
    for times in [3.0, 8.0] {
        let train = csv(home.path(), "train", &along_with_noise(&moves(10.0, 3), 3, times));
        let holdout = csv(home.path(), "holdout", &along_with_noise(&moves(8.0, 4), 4, times));
        let output = identify(MODEL, &train, &holdout, &home.path().join("out"));
        let words = [
            "position has",
            "force_cell has",
            "is declared",
            "everything is judged against the former",
        ];
        assert_eq!(warned(&format!("{times} times the noise"), &output, &words), "none");
    }
}

/// Counts of 0.1 mm hide the force behind what they feign of acceleration; those of 0.5 N of the
/// cell are noise, and no limit of its range.
#[test]
fn coarse_counts_are_refused_or_count_as_noise() {
    let home = TempDir::new().unwrap();
    let out = home.path().join("out");
    let in_counts =
        |column: &mut [f64], count: f64| each(column, |value| (value / count).round() * count);
    let (mut train, mut holdout) = (train(), holdout());
    [&mut train, &mut holdout]
        .into_iter()
        .for_each(|columns| in_counts(&mut columns.force_cell, 0.5));
    let files = |train: &Columns, holdout: &Columns| {
        (csv(home.path(), "train", train), csv(home.path(), "holdout", holdout))
    };
    let (of_train, of_holdout) = files(&train, &holdout);
    let output = identify(MODEL, &of_train, &of_holdout, &out);
    assert_eq!(
        warned("counts of 0.5 N", &output, &["everything is judged against the former"]),
        "none"
    );
    assert!(!String::from_utf8_lossy(&output.stdout).contains("cut off"));

    [&mut train, &mut holdout]
        .into_iter()
        .for_each(|columns| in_counts(&mut columns.position, 1e-4));
    let (of_train, of_holdout) = files(&train, &holdout);
    let out = home.path().join("hidden");
    let output = identify(MODEL, &of_train, &of_holdout, &out);
    assert_refused(
        "counts of 0.1 mm",
        &output,
        &out,
        &["the noise of the sensors hides the force", "finer counts"],
    );
}

/// A motion whose acceleration brings next to no force says nothing of the mass, and so nothing of
/// a sign, a unit or another machine.
#[test]
fn a_motion_that_does_not_show_the_mass_accuses_nobody() {
    let home = TempDir::new().unwrap();
    // 1 mm at 0.4 Hz: 2.5 mm/s and 6 mm/s^2 at most.
    let mut creep = Setpoints::default();
    for k in 0..(8.0 * RATE) as usize {
        let (sine, cosine) = (std::f64::consts::TAU * 0.4 * k as f64 / RATE).sin_cos();
        let rate = std::f64::consts::TAU * 0.4;
        creep.position.push(1e-3 * (1.0 - cosine));
        creep.velocity.push(1e-3 * rate * sine);
        creep.acceleration.push(1e-3 * rate * rate * cosine);
    }
    let [train, holdout] =
        [csv(home.path(), "train", &train()), csv(home.path(), "holdout", &along(&creep, 4))];
    let output = identify(MODEL, &train, &holdout, &home.path().join("out"));
    let reported = String::from_utf8_lossy(&output.stderr);
    assert!(matches!(output.status.code(), Some(0 | 3)), "{reported}");
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["verdict"], "none", "{summary:#}");
}

/// One sided: what the other record has beside it must not become an effect.
#[test]
fn a_dead_command_on_one_side_and_one_speed_only_are_told() {
    let home = TempDir::new().unwrap();
    let (good, mut dead) = (csv(home.path(), "good", &holdout()), train());
    each(&mut dead.force, |_| 3.0);
    let dead = csv(home.path(), "dead", &dead);
    let output = identify(MODEL, &dead, &good, &home.path().join("dead"));
    warned("dead", &output, &["dead.csv: force is constant (3)", "not every recording has force"]);

    let slow = csv(home.path(), "one_speed", &along(&one_speed(10.0), 3));
    let other = csv(home.path(), "one_speed_too", &along(&one_speed(8.0), 4));
    for holdout in [&good, &other] {
        let output = identify(MODEL, &slow, holdout, &home.path().join("one_speed"));
        warned(
            "one speed",
            &output,
            &["one_speed.csv: the carriage moves at one speed only", "at least two speeds"],
        );
    }
}

/// Also one whose mass is in tonnes or in grams: friction shows that it is the mass, and neither
/// the force nor the position.
#[test]
fn another_machine_than_the_declared_one_is_refused() {
    let home = TempDir::new().unwrap();
    let declared = std::fs::read_to_string(MODEL).unwrap();
    assert!(declared.contains("mass: 40"));
    let (train, holdout) =
        (csv(home.path(), "train", &train()), csv(home.path(), "holdout", &holdout()));
    for mass in ["4", "0.04", "40000"] {
        let (model, out) =
            (home.path().join(format!("{mass}.yaml")), home.path().join(format!("out_{mass}")));
        std::fs::write(&model, declared.replace("mass: 40", &format!("mass: {mass}"))).unwrap();
        let output = identify(model.to_str().unwrap(), &train, &holdout, &out);
        let words = [
            "train.csv",
            "another machine, a payload, or a wrong unit",
            &format!("declares {mass}"),
        ];
        assert_refused(mass, &output, &out, &words);
        let reported = String::from_utf8_lossy(&output.stderr);
        assert!(!reported.contains("seems to be in"), "{mass}: {reported}");
    }
}

/// Where nothing is known of mass and friction, tolerances say so, and what is hidden is found.
#[test]
fn another_machine_within_wide_tolerances_is_identified() {
    let home = TempDir::new().unwrap();
    let (train, holdout) = (
        csv(home.path(), "train", &with_cogging(train())),
        csv(home.path(), "holdout", &with_cogging(holdout())),
    );
    let declared = std::fs::read_to_string(MODEL).unwrap();
    let (model, out) = (home.path().join("model.yaml"), home.path().join("out"));
    for (mass, friction) in [("100", 3.0), ("15", 0.4)] {
        let mut other = declared.replace("mass: 40", &format!("mass: {mass}"));
        for (name, value) in [("coulomb", 13.5), ("static", 16.8)] {
            let is = |value: f64| format!("{name}_force: {value} ");
            assert!(other.contains(&is(value)), "{other}");
            other = other.replace(&is(value), &is(value * friction));
        }
        std::fs::write(&model, other).unwrap();
        let output = identify(model.to_str().unwrap(), &train, &holdout, &out);
        let words = ["another machine", &format!("declares {mass}")];
        assert_refused(mass, &output, &out, &words);
        let wide = ["--mass-tolerance", "2", "--guide-tolerance", "3"];
        let output = identify_with(model.to_str().unwrap(), &train, &holdout, &out, &wide);
        let reported = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{mass}: {reported}");
        let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(summary["verdict"], "found", "{mass}: {summary:#}");
        assert_eq!(summary["effects"][0]["name"], "cogging", "{mass}: {summary:#}");
        let fitted = summary["declared_parameters"]["mass"]["value"].as_f64().unwrap();
        assert!((fitted - 40.1).abs() < 0.1, "{mass}: {fitted} kg");
        std::fs::remove_dir_all(&out).unwrap();
    }
}

/// A viscous friction far from the declared one, or left out, is no law, whatever else is hidden:
/// here a force of the motor over the position.
#[test]
fn guides_of_another_friction_are_refused_with_a_law_hidden() {
    let home = TempDir::new().unwrap();
    let declared = std::fs::read_to_string(MODEL).unwrap();
    assert!(declared.contains("viscous_friction: 18 "));
    let (train, holdout) = (
        csv(home.path(), "train", &with_cogging(train())),
        csv(home.path(), "holdout", &with_cogging(holdout())),
    );
    for viscous in ["0", "6", "60"] {
        let (model, out) = (
            home.path().join(format!("{viscous}.yaml")),
            home.path().join(format!("out_{viscous}")),
        );
        let text =
            declared.replace("viscous_friction: 18 ", &format!("viscous_friction: {viscous} "));
        std::fs::write(&model, text).unwrap();
        let output = identify(model.to_str().unwrap(), &train, &holdout, &out);
        let words = [
            "other guides than the model declares",
            "viscous_friction is 1",
            "Declare them",
            "guide-tolerance",
        ];
        assert_refused(viscous, &output, &out, &words);
    }
    // With the declared one the law is named.
    let output = identify(MODEL, &train, &holdout, &home.path().join("out"));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary["effects"][0]["name"], "cogging", "{summary:#}");
}

/// Where there is no viscous friction, as declared, a drag that is hidden is a law, and no guides.
#[test]
fn a_drag_of_guides_without_viscous_friction_is_a_law() {
    let home = TempDir::new().unwrap();
    let declared = std::fs::read_to_string(MODEL).unwrap();
    let model = home.path().join("model.yaml");
    std::fs::write(&model, declared.replace("viscous_friction: 18 ", "viscous_friction: 0 "))
        .unwrap();
    let record = |seconds: f64, seed: u64| {
        let setup = Setup::new(5);
        let mut drawn = Noise::new(5, 1);
        let guides = [(); 4]
            .map(|()| Guide { viscous: 0.0, ..Guide::draw(setup.guide_tolerance, &mut drawn) });
        let setpoints = moves(seconds, seed);
        let mut columns = setup.record(40.1, guides, &setpoints, "train", seed).unwrap().0;
        // Cell and command hold what the carriage needs against the drag.
        for (k, v) in setpoints.velocity.iter().take(columns.force.len()).enumerate() {
            let drag = 20.0 * v * v.abs();
            columns.force[k] += drag;
            columns.force_cell[k] += drag;
        }
        columns
    };
    let (train, holdout) =
        (csv(home.path(), "train", &record(10.0, 3)), csv(home.path(), "holdout", &record(8.0, 4)));
    let output = identify(model.to_str().unwrap(), &train, &holdout, &home.path().join("out"));
    let reported = String::from_utf8_lossy(&output.stderr);
    assert!(matches!(output.status.code(), Some(0 | 3)), "{reported}");
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    // A gain of the motor or of the cell may come with it: the drag is added to both forces.
    assert!(matches!(summary["verdict"].as_str(), Some("found" | "not_separable")), "{summary:#}");
    assert_eq!(summary["effects"][0]["name"], "quadratic_drag", "{summary:#}");
}

/// The same bag under another name, and a bag of an encoder alone.
#[test]
fn bags_that_say_nothing_new_or_no_force_are_refused() {
    let home = TempDir::new().unwrap();
    let at = |name: &str| home.path().join(name);
    let (train, holdout) = (train(), holdout());
    for (name, columns) in [("train", &train), ("copy", &train), ("holdout", &holdout)] {
        columns.write_bag(at(name)).unwrap();
    }
    let out = at("out");
    let output = identify(MODEL, &at("train"), &at("copy"), &out);
    assert_refused(
        "copy",
        &output,
        &out,
        &["copy", "sample by sample", "hold out another recording"],
    );
    let same = identify(MODEL, &at("train"), &at("train"), &out);
    assert_eq!(same.status.code(), Some(2), "{}", String::from_utf8_lossy(&same.stderr));

    let mut bag = BagWriter::create(at("encoder_only"), &BagOptions::default()).unwrap();
    let encoder = bag.add_topic::<JointState>(topics::ENCODER, &OfferedQos::reliable(100)).unwrap();
    for (time, position) in train.time.iter().zip(&train.position) {
        let stamp = 1_760_000_000_000_000_000 + (time * 1e9).round() as i64;
        let state = JointState {
            header: Header::new(stamp, topics::JOINT),
            name: vec![topics::JOINT.into()],
            position: vec![*position],
            ..JointState::default()
        };
        bag.write(encoder, stamp as u64, &state).unwrap();
    }
    bag.finish().unwrap();
    let output = identify(MODEL, &at("encoder_only"), &at("holdout"), &out);
    assert_refused("encoder only", &output, &out, &["encoder_only", "there is no force"]);
}
