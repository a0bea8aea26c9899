//! `friction-stage experiment` at the boundary of the process: exit codes, files, and bags that
//! repeat.

use std::path::Path;
use std::process::{Command, Output};

fn friction_stage(arguments: &[&str], directory: &Path) -> Output {
    Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .args(arguments)
        .current_dir(directory)
        .output()
        .unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn an_experiment_leaves_summary_report_figures_and_bags_that_repeat_bit_for_bit() {
    let directory = tempfile::tempdir().unwrap();
    let arguments = [
        "experiment",
        "fine-step",
        "--guides",
        "guide_2",
        "--rest",
        "0.2",
        "--out",
        "out",
        "--json",
    ];
    let output = friction_stage(&arguments, directory.path());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let out = directory.path().join("out");
    let summary: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(out.join("summary.json")).unwrap()).unwrap();
    let printed: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(summary, printed);
    let peak = summary["results"]["fine_step"][0]["steps"][0]["peak_error"].as_f64().unwrap();
    assert!((0.5e-6..5e-6).contains(&peak), "{peak}");
    let page = std::fs::read_to_string(out.join("report.html")).unwrap();
    let page = page.replace(friction_stage_report::interactive::LIBRARY, "");
    assert!(page.contains("<svg") && !page.contains("src=") && !page.contains("https://"));
    assert!(std::fs::read_to_string(out.join("fine_step.svg")).unwrap().starts_with("<svg"));
    let bag = out.join("bags/guide_2_fine_step");
    let replay = friction_stage(&["replay", bag.to_str().unwrap(), "--json"], directory.path());
    let replayed: serde_json::Value = serde_json::from_slice(&replay.stdout).unwrap();
    assert_eq!(replayed["identical"], replayed["samples"], "{replayed}");
    // The same directory again is refused: nothing is overwritten but with --force.
    let again = friction_stage(&arguments, directory.path());
    assert_eq!(again.status.code(), Some(2));
    assert!(text(&again.stderr).contains("choose another --out"), "{}", text(&again.stderr));
    let forced = friction_stage(&[&arguments[..], &["--force"]].concat(), directory.path());
    assert_eq!(forced.status.code(), Some(0), "{}", text(&forced.stderr));
    assert_eq!(forced.stdout, output.stdout);
    // Of a run that is complete nothing is left to resume.
    let resumed = friction_stage(&[&arguments[..], &["--resume"]].concat(), directory.path());
    assert_eq!(resumed.status.code(), Some(0), "{}", text(&resumed.stderr));
    let shown: serde_json::Value = serde_json::from_slice(&resumed.stdout).unwrap();
    assert_eq!(shown, summary);
    let mut other = arguments;
    other[1] = "fast-move";
    let refused = friction_stage(&[&other[..], &["--resume"]].concat(), directory.path());
    assert_eq!(refused.status.code(), Some(2), "{}", text(&refused.stdout));
}

#[test]
fn wrong_arguments_are_told_and_end_with_2() {
    let directory = tempfile::tempdir().unwrap();
    for (arguments, words) in [
        (["experiment", "stribek", "--rest", "1"], "stribeck"),
        (["experiment", "dahl", "--guides", "guide_4"], "did you mean `guide_"),
        (
            ["experiment", "dahl", "--guides", "guide_4+distributed_bristles"],
            "did you mean `guide_",
        ),
        (["experiment", "fast-move", "--rest", "0"], "between 0.01 and 3600 s"),
        (["experiment", "dahl", "--amplitudes", "1e-3,0"], "between 1e-9 and 0.05 m"),
        (["experiment", "stribeck", "--amplitudes", "1e-3"], "for the loops of dahl"),
    ] {
        let output = friction_stage(&arguments, directory.path());
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", text(&output.stderr));
        assert!(text(&output.stderr).contains(words), "{arguments:?}: {}", text(&output.stderr));
    }
}

#[test]
fn a_motor_that_the_motion_exceeds_is_named() {
    let directory = tempfile::tempdir().unwrap();
    std::fs::write(directory.path().join("weak.yaml"), "name: weak\nmotor: {force_limit: 500}\n")
        .unwrap();
    let output = friction_stage(
        &["experiment", "fast-move", "--model", "weak.yaml", "--rest", "0.1", "--out", "o"],
        directory.path(),
    );
    assert_eq!(output.status.code(), Some(1));
    let message = text(&output.stderr);
    assert!(
        message.contains("500 N") && message.contains("weak") && message.contains("force_limit"),
        "{message}"
    );
    assert!(!directory.path().join("o").exists());
}

#[test]
fn guides_of_a_catalogue_beside_the_model_file_are_run_and_recorded() {
    let directory = tempfile::tempdir().unwrap();
    let own = include_str!("../launch_config/own_guide_catalogue.yaml");
    std::fs::create_dir(directory.path().join("models")).unwrap();
    std::fs::write(directory.path().join("models/own.yaml"), own).unwrap();
    let model =
        "name: mine\ncatalogue: own.yaml\nguides: [my_guide, my_guide, my_guide, my_guide]\n";
    std::fs::write(directory.path().join("models/stage.yaml"), model).unwrap();
    let arguments =
        ["experiment", "fine-step", "--model", "models/stage.yaml", "--rest", "0.2", "--out", "o"];
    let output = friction_stage(&arguments, directory.path());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    // The bag repeats without the catalogue.
    std::fs::remove_dir_all(directory.path().join("models")).unwrap();
    let replay = friction_stage(&["replay", "o/bags/mine_fine_step", "--json"], directory.path());
    let replayed: serde_json::Value = serde_json::from_slice(&replay.stdout).unwrap();
    assert_eq!(replayed["identical"], replayed["samples"], "{replayed}");
}

#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "minutes in the dev profile; runs with --release, as in tests/run"
)]
fn on_one_bristle_the_papers_statements_hold_but_for_four() {
    let directory = tempfile::tempdir().unwrap();
    let guides = "guide_1,guide_2,guide_3,guide_1+distributed_bristles";
    let output = friction_stage(
        &["experiment", "paper", "--guides", guides, "--no-bags", "--json", "--out", "paper"],
        directory.path(),
    );
    assert_eq!(output.status.code(), Some(3), "{}", text(&output.stderr));
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let statements = summary["statements"].as_array().unwrap();
    let words = |statement: &serde_json::Value, key: &str| {
        statement[key].as_str().unwrap_or_default().to_owned()
    };
    let fail: Vec<&serde_json::Value> =
        statements.iter().filter(|statement| statement["holds"] != true).collect();
    let expected = [
        ("guide 1 at 10 nm: 7.5e5 N/m", "one bristle has"),
        ("guide 1 at 40 µm: 2.3e5 N/m", "one bristle has"),
        ("guide 3 reaches the required position last", "guide 2 does overtake it"),
        ("exceeds the proportional gain", "one bristle cannot"),
    ];
    assert_eq!((statements.len(), fail.len()), (28, expected.len()), "{fail:#?}");
    for (statement, (paper, reason)) in fail.iter().zip(expected) {
        assert!(
            words(statement, "paper").contains(paper)
                && words(statement, "reason").contains(reason),
            "{statement:#}"
        );
    }
    // The table of docs/explanation/stiffness.md, in percent: catalogue, best single bristle,
    // distributed.
    let errors = summary["stiffness_of_guide_1"]["errors"].as_array().unwrap();
    let table = [(-39.8, -43.6, -1.4), (-0.2, -6.0, 0.3), (44.0, 39.6, -0.5)];
    for (row, (catalogue, best_single, distributed)) in errors.iter().zip(table) {
        for (key, expected) in
            [("catalogue", catalogue), ("best_single", best_single), ("distributed", distributed)]
        {
            let found = 100.0 * row[key].as_f64().unwrap();
            assert!((found - expected).abs() < 0.1, "{key} {found} {expected}");
        }
    }
}

#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "minutes in the dev profile; runs with --release, as in tests/run"
)]
fn all_statements_of_the_paper_hold_on_the_guides_of_the_laboratory() {
    let directory = tempfile::tempdir().unwrap();
    let output = friction_stage(
        &["experiment", "paper", "--no-bags", "--json", "--out", "paper"],
        directory.path(),
    );
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let statements = summary["statements"].as_array().unwrap();
    let fail: Vec<&serde_json::Value> =
        statements.iter().filter(|statement| statement["holds"] != true).collect();
    assert_eq!((statements.len(), fail.len()), (28, 0), "{fail:#?}");
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    // Stiffnesses of guide 1 in docs/explanation/stiffness.md.
    let stiffness = &statements[10]["stage"];
    assert!(stiffness.as_str().unwrap().starts_with("lugre + distributed_bristles"), "{stiffness}");
}
