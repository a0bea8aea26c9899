//! A recording of slow moves tells little of inertia and of the instants at which the sensors are
//! read. What a fit makes of that must not pass for an effect on a recording of fast moves.

use std::path::Path;
use std::process::{Command, Output};

use friction_stage_identify::next_experiment::trajectory_yaml;
use friction_stage_lab::PaperMotion;
use serde_json::Value;

fn friction_stage(directory: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .args(arguments)
        .current_dir(directory)
        .output()
        .expect("the program starts")
}

#[test]
fn a_stage_that_equals_its_model_is_none_on_fast_moves_after_a_fit_to_slow_ones() {
    let home = tempfile::tempdir().expect("a directory");
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/closing_the_loop");
    let slow = example.join("slow_moves.yaml").display().to_string();
    let model = example.join("real.yaml").display().to_string();
    // 29 mm in 111 ms, there and back, as the example's own next experiment.
    let moves = [(0.029, 0.111, 0.3), (-0.029, 0.111, 0.3), (-0.01, 0.06, 0.3)];
    let fast = PaperMotion::of_moves(0.3, &moves).expect("a motion").points;
    std::fs::write(home.path().join("fast.yaml"), trajectory_yaml(&fast, "stage", &[]))
        .expect("a motion");
    for (motion, bag) in [(slow.as_str(), "slow"), ("fast.yaml", "fast")] {
        let played = friction_stage(
            home.path(),
            &["play", motion, "--model", &model, "--rate", "2000", "--record", bag],
        );
        assert_eq!(played.status.code(), Some(0), "{played:?}");
    }
    let found = friction_stage(
        home.path(),
        &["identify", "--model", &model, "--train", "slow", "--holdout", "fast", "--out", "found"],
    );
    let told = String::from_utf8_lossy(&found.stderr);
    let summary = std::fs::read_to_string(home.path().join("found/summary.json"));
    let summary: Value = serde_json::from_str(&summary.expect("a summary")).expect("JSON");
    assert_eq!(summary["verdict"], "none", "{summary:#}\n{told}");
    assert_eq!(found.status.code(), Some(0), "{told}");
}
