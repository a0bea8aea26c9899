//! A recording of slow moves tells little of inertia and of the instants at which the sensors are
//! read, one of fast moves little of static friction. What a fit makes of that must not pass for an
//! effect on a recording of other moves.

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
fn a_stage_that_equals_its_model_is_none_on_moves_other_than_those_of_the_fit() {
    let home = tempfile::tempdir().expect("a directory");
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/closing_the_loop");
    let slow = example.join("slow_moves.yaml").display().to_string();
    let model = example.join("real.yaml").display().to_string();
    // 29 mm in 111 ms, there and back, as the example's own next experiment.
    let moves = [(0.029, 0.111, 0.3), (-0.029, 0.111, 0.3), (-0.01, 0.06, 0.3)];
    let fast = PaperMotion::of_moves(0.3, &moves).expect("a motion").points;
    std::fs::write(home.path().join("fast.yaml"), trajectory_yaml(&fast, "stage", &[]))
        .expect("a motion");
    // At 1.4 times the speed of the example: at its own, the shift of the sensors, which fast moves
    // show, is left open, and a warning says so.
    for (motion, bag, stretch) in
        [(slow.as_str(), "slow", "0.714285714"), ("fast.yaml", "fast", "1")]
    {
        let to = ["--record", bag, "--stretch", stretch];
        let play = ["play", motion, "--model", &model, "--rate", "2000"];
        let played = friction_stage(home.path(), &[&play[..], &to].concat());
        assert_eq!(played.status.code(), Some(0), "{played:?}");
    }
    let identify = |model: &str, train: &str, holdout: &str| {
        let out = format!("{train}_{holdout}_{}", model.len());
        let records = ["identify", "--model", model, "--train", train, "--holdout", holdout];
        let found = friction_stage(home.path(), &[&records[..], &["--out", &out]].concat());
        let summary = std::fs::read_to_string(home.path().join(out).join("summary.json"));
        let summary: Value = serde_json::from_str(&summary.expect("a summary")).expect("JSON");
        let warned = String::from_utf8_lossy(&found.stderr).into_owned();
        (summary, found.status.code(), warned)
    };
    let (summary, code, warned) = identify(&model, "slow", "fast");
    assert_eq!((&summary["verdict"], code), (&"none".into(), Some(0)), "{summary:#}\n{warned}");
    // What fast moves do not show of friction is open on slow ones, and said.
    let (summary, code, warned) = identify(&model, "fast", "slow");
    assert_eq!((&summary["verdict"], code), (&"none".into(), Some(3)), "{summary:#}\n{warned}");
    let findings = summary["findings"].as_array().expect("findings");
    assert!(findings.iter().any(|one| one["code"] == "left_open"), "{summary:#}");
    // What the same record does show is found all the same: the 3 % of force.
    let whole = std::fs::read_to_string(&model).expect("a model");
    let (declared, _) = whole.split_once("effects:").expect("hidden effects");
    std::fs::write(home.path().join("declared.yaml"), declared).expect("a model");
    let (summary, _, warned) = identify("declared.yaml", "fast", "slow");
    let effect = &summary["effects"][0];
    assert_eq!(
        (&summary["verdict"], &effect["name"]),
        (&"found".into(), &"motor_gain".into()),
        "{summary:#}\n{warned}"
    );
}
