//! `play` over ROS 2: the controller that it takes, and what it says of a motion.

use std::path::Path;
use std::process::{Command, Output};

use friction_stage_lab::PaperMotion;
use parquet::file::reader::{FileReader, SerializedFileReader};
use serde_json::Value;

/// Exit code, stdout and stderr.
fn play(directory: &Path, arguments: &[&str]) -> (i32, String, String) {
    let motion = directory.join("motion.yaml");
    if !motion.exists() {
        let moves = [(1e-5, 0.003, 0.05), (-2e-3, 0.05, 0.1)];
        let points = PaperMotion::of_moves(0.05, &moves).unwrap().points;
        let text = friction_stage_identify::next_experiment::trajectory_yaml(&points, "stage", &[]);
        std::fs::write(&motion, text).unwrap();
        let model = "mass: 12.0\nguides: [guide_2, guide_2, guide_2, guide_2]\n";
        std::fs::write(directory.join("light.yaml"), model).unwrap();
    }
    let Output { status, stdout, stderr } = Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .args(["play", "motion.yaml", "--model", "light.yaml"])
        .args(arguments)
        .current_dir(directory)
        .output()
        .unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (status.code().unwrap_or(-1), text(stdout), text(stderr))
}

#[test]
fn the_controller_follows_the_model_and_the_moves_are_judged() {
    let home = tempfile::tempdir().unwrap();
    let (code, stdout, stderr) = play(home.path(), &["--record", "run"]);
    assert_eq!(code, 0, "{stdout}{stderr}");
    for words in ["the rule of thumb for 60 Hz and 12 kg", "1: 10.000 µm", "2: -2.0000 mm"] {
        assert!(stdout.contains(words), "{words}: {stdout}");
    }
    let figure = std::fs::read_to_string(home.path().join("run.svg")).unwrap();
    assert!(figure.contains("Position error"));
    let (_, said) = figure.split_once("<metadata>").expect("who made it");
    assert!(
        said.contains("friction-stage play motion.yaml --model light.yaml --record run"),
        "{said}"
    );
    let mut table = csv::Reader::from_path(home.path().join("run.csv")).unwrap();
    let header: Vec<String> = table.headers().unwrap().iter().map(str::to_owned).collect();
    assert_eq!(header[..3], ["time_s", "reference_m", "position_m"]);
    let rows: Vec<csv::StringRecord> = table.records().map(Result::unwrap).collect();
    let number = |row: &csv::StringRecord, column: usize| row[column].parse::<f64>().unwrap();
    assert!(rows.len() > 1000);
    for row in &rows {
        // Reference less position, as the controller has it.
        assert!((number(row, 1) - number(row, 2) - number(row, 4)).abs() < 1e-12, "{row:?}");
        assert!((0..7).all(|column| number(row, column).is_finite()), "{row:?}");
    }

    // The table needs no mapping.
    let read = |arguments: &[&str]| {
        let program = env!("CARGO_BIN_EXE_friction-stage");
        let done = Command::new(program).args(arguments).current_dir(home.path()).output();
        let done = done.unwrap();
        assert!([Some(0), Some(3)].contains(&done.status.code()), "{done:?}");
        String::from_utf8(done.stdout).unwrap()
    };
    let signals = "signals: time, reference_position, position, force_cell, force;";
    let checked = read(&["check", "run.csv"]);
    assert!(checked.contains(signals), "{checked}");
    read(&["view", "run.csv", "--out", "view.html"]);
    let replayed = read(&["replay", "run.csv", "--model", "light.yaml"]);
    assert!(replayed.contains("forces alone"), "{replayed}");

    let (code, _, stderr) = play(home.path(), &["--record", "run"]);
    assert!(code == 2 && stderr.contains("run exists already"), "{stderr}");
    let more = ["--record", "run", "--force", "--bandwidth", "30", "--json"];
    let (code, stdout, stderr) = play(home.path(), &more);
    assert_eq!(code, 0, "{stderr}");
    let slow: Value = serde_json::from_str(&stdout).unwrap();
    // A quarter of the stiffness at half of the bandwidth.
    assert_eq!(slow["controller"]["moving_mass"], 12.0);
    assert_eq!(slow["moves"].as_array().unwrap().len(), 2);

    let parquet = ["--record", "tuned", "--samples", "tuned.parquet", "--json"];
    let gains = ["--gains", "8e5,1.6e7,6e3"];
    let (code, stdout, stderr) = play(home.path(), &[&parquet[..], &gains].concat());
    assert_eq!(code, 0, "{stderr}");
    let own: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(own["controller"]["p"], 8e5);
    let peak = |of: &Value| of["all_moves"]["peak_error"].as_f64().unwrap();
    assert!(peak(&own) < peak(&slow), "{own} {slow}");
    let file = std::fs::File::open(home.path().join("tuned.parquet")).unwrap();
    let table = SerializedFileReader::new(file).unwrap();
    let about = table.metadata().file_metadata().key_value_metadata().unwrap();
    let command = about.iter().find(|entry| entry.key == "command").unwrap();
    assert!(command.value.as_ref().unwrap().contains("--gains 8e5,1.6e7,6e3"), "{command:?}");
}

#[test]
fn a_controller_file_is_taken_as_it_is_and_another_mass_in_it_is_said() {
    let home = tempfile::tempdir().unwrap();
    let file = |mass: f64| {
        let text = format!(
            "/**/controller:\n  ros__parameters:\n    rate: 2000.0\n    tuning: bandwidth\n    \
             bandwidth: 40.0\n    mass: {mass:?}\n    feedforward:\n      mass: {mass:?}\n"
        );
        std::fs::write(home.path().join("controller.yaml"), text).unwrap();
    };
    file(12.0);
    let controller = ["--controller", "controller.yaml", "--json"];
    let (code, stdout, stderr) =
        play(home.path(), &[&controller[..], &["--record", "right"]].concat());
    assert_eq!(code, 0, "{stderr}");
    let right: Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(right["controller"]["rate"], 2000.0);
    file(40.0);
    let (code, _, stderr) = play(home.path(), &[&controller[..], &["--record", "heavy"]].concat());
    assert!(code == 3 && stderr.contains("40 kg forward and the stage moves 12 kg"), "{stderr}");
    for (more, words) in [
        (&["--rate", "4000"][..], "samples at 2000 Hz"),
        (&["--bandwidth", "30"], "cannot be used with"),
    ] {
        let arguments = [&controller[..], &["--record", "wrong"], more].concat();
        let (code, _, stderr) = play(home.path(), &arguments);
        assert!(code == 2 && stderr.contains(words), "{more:?}: {stderr}");
    }
    let (code, _, stderr) = play(home.path(), &["--record", "wrong", "--samples", "a.txt"]);
    assert!(code == 2 && stderr.contains(".parquet"), "{stderr}");
    let (code, _, stderr) = play(home.path(), &["--record", "wrong", "--gains", "1,2,-3"]);
    assert!(code == 2 && stderr.contains("gains.stage.d"), "{stderr}");
    let (code, _, stderr) = play(home.path(), &["--record", "wrong", "--gains", "1,2"]);
    assert!(code == 2 && stderr.contains("three numbers"), "{stderr}");
    assert!(!home.path().join("wrong").exists());
}
