//! `friction-stage compensate` from outside.

use std::path::Path;
use std::process::{Command, Output};

use friction_stage_data::motion_file;

const MOTION: &str = "\
joint_names: [stage]
points:
- positions: [0.0]
  velocities: [0.0]
  accelerations: [0.0]
  time_from_start: {nanosec: 50000000}
- positions: [0.05]
  velocities: [0.0]
  accelerations: [0.0]
  time_from_start: {nanosec: 150000000}
- positions: [0.05]
  velocities: [0.0]
  accelerations: [0.0]
  time_from_start: {nanosec: 650000000}
";

fn compensate(directory: &Path, arguments: &[&str], out: &str) -> Output {
    std::fs::write(directory.join("motion.yaml"), MOTION).unwrap();
    Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .current_dir(directory)
        .args(["compensate", "motion.yaml", "--out", out])
        .args(arguments)
        .output()
        .unwrap()
}

#[test]
fn what_is_known_of_a_stage_makes_its_error_small_and_is_exported() {
    let directory = tempfile::tempdir().unwrap();
    let real = "guides: [guide_2, guide_2, guide_2, guide_2]\nmass: 40.2\neffects:\n  - cogging: \
                {amplitude: 6.0, period: 0.02}\n";
    std::fs::write(directory.path().join("real.yaml"), real).unwrap();
    std::fs::write(directory.path().join("known.yaml"), real.replace("40.2", "40.0")).unwrap();
    let run = compensate(
        directory.path(),
        &["--model", "known.yaml", "--real", "real.yaml", "--json"],
        "out",
    );
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let summary: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    let peak = |run: &str| summary[run]["peak"].as_f64().unwrap();
    assert!(peak("with") < peak("without") / 3.0, "{summary}");
    let page = std::fs::read_to_string(directory.path().join("out/report.html")).unwrap();
    assert!(page.contains("<h1>Compensation of real.yaml by known.yaml</h1>"), "{page}");
    let out = directory.path().join("out");
    let table = std::fs::read_to_string(out.join("over_position.csv")).unwrap();
    let largest = table
        .lines()
        .skip(1)
        .map(|line| line.split(',').nth(1).unwrap().parse::<f64>().unwrap().abs())
        .fold(0.0, f64::max);
    assert!((largest - 6.0).abs() < 0.1, "{largest}");
    // The parser of the nodes takes the trajectory with effort.
    let points = motion_file::load(&out.join("motion_with_effort.yaml")).unwrap();
    let effort = points.iter().map(|point| point.effort).fold(0.0, f64::max);
    assert!((1100.0..1300.0).contains(&effort), "{effort}");
    // A second run does not write over the first.
    let again =
        compensate(directory.path(), &["--model", "known.yaml", "--real", "real.yaml"], "out");
    assert_eq!(again.status.code(), Some(2), "{again:?}");
}

#[test]
fn a_model_of_another_machine_is_refused_with_what_differs() {
    let directory = tempfile::tempdir().unwrap();
    std::fs::write(directory.path().join("light.yaml"), "mass: 12.0\nguides: [guide_1]\n").unwrap();
    let run = compensate(directory.path(), &["--model", "light.yaml", "--real", "guide_1"], "out");
    assert_eq!(run.status.code(), Some(1), "{run:?}");
    let reported = String::from_utf8(run.stderr).unwrap();
    for words in ["12 kg", "40 kg", "1 guides", "4"] {
        assert!(reported.contains(words), "{reported}");
    }
    assert!(!directory.path().join("out").exists());
}
