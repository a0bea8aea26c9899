//! `friction-stage demo recordings` and the `identify` line of the README, as written, at the
//! process boundary.

use std::path::Path;
use std::process::{Command, Output};

use friction_stage_core::model::StageModel;
use serde_json::Value;

fn friction_stage(directory: &Path, arguments: &str) -> Output {
    Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .args(arguments.split_whitespace())
        .current_dir(directory)
        .output()
        .expect("the program starts")
}

/// The lines of the README that make recordings, identify and reveal, without their comments.
fn lines_of_the_readme() -> Vec<String> {
    let readme = Path::new(env!("CARGO_MANIFEST_DIR")).join("README.md");
    let text = std::fs::read_to_string(readme).expect("the README").replace("\\\n", " ");
    text.lines()
        .filter(|line| line.contains("recordings/train") || line.contains("demo recordings"))
        .filter_map(|line| line.strip_prefix("friction-stage "))
        .map(|line| line.split('#').next().unwrap_or(line).trim().to_owned())
        .collect()
}

#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "minutes in the dev profile; runs with --release, as in tests/run"
)]
fn the_lines_of_the_readme_find_what_is_hidden() {
    let lines = lines_of_the_readme();
    let [make, identify, reveal] = &lines[..] else { panic!("{lines:?}") };
    // One of each effect that can be hidden.
    let mut hidden = std::collections::BTreeSet::new();
    for seed in [1, 3, 10] {
        let place = tempfile::tempdir().expect("a directory");
        let made = friction_stage(place.path(), &format!("{make} --seed {seed}"));
        assert!(made.status.success(), "{made:?}");
        let declared = std::fs::read_to_string(place.path().join("recordings/declared.yaml"));
        assert!(!declared.expect("the declared model").contains("effects"));

        let found = friction_stage(place.path(), &format!("{identify} --json"));
        let reported = String::from_utf8_lossy(&found.stderr);
        assert!(matches!(found.status.code(), Some(0 | 3)), "{reported}");
        let summary: Value = serde_json::from_slice(&found.stdout).expect("the summary");
        let answer = friction_stage(place.path(), reveal);
        let answer = String::from_utf8(answer.stdout).expect("the answer");
        assert_eq!(summary["verdict"], "found", "seed {seed}: {summary:#}\n{answer}");
        let effects = summary["effects"].as_array().expect("effects");
        let name = effects[0]["name"].as_str().expect("a name");
        assert_eq!(effects.len(), 1, "seed {seed}: {summary:#}\n{answer}");
        assert!(answer.contains(&format!("{name}:")), "seed {seed}: {name} is not in {answer}");

        hidden.insert(name.to_owned());
        assert_model_file(place.path(), identify, &summary);

        let again = friction_stage(place.path(), make);
        assert_eq!(again.status.code(), Some(2), "{again:?}");
        assert!(String::from_utf8_lossy(&again.stderr).contains("exists already"), "{again:?}");
    }
    assert_eq!(hidden.len(), 3, "{hidden:?}");
}

/// The identified model says who made it and its intervals, in digits that these deserve.
fn assert_model_file(place: &Path, line: &str, summary: &Value) {
    let command = line.split_whitespace().collect::<Vec<_>>().join(" ");
    let path = place.join("result/identified.yaml");
    let text = std::fs::read_to_string(&path).expect("the identified model");
    let lines: Vec<&str> = text.lines().collect();
    let version = format!("# friction-stage {}, 20", env!("CARGO_PKG_VERSION"));
    assert!(lines[0].starts_with(&version), "{text}");
    assert!(lines[1].starts_with(&format!("# friction-stage {command}")), "{text}");
    let model = StageModel::load(&path).expect("the model loads");
    let mass = &summary["declared_parameters"]["mass"];
    let number = |value: &Value| value.as_f64().expect("a number");
    let half = 0.5 * (number(&mass["ci95"][1]) - number(&mass["ci95"][0]));
    assert!((model.mass - number(&mass["value"])).abs() <= 0.01 * half, "{text}");
    assert!(format!("{:?}", model.mass).len() < 12, "{text}");
    assert!(text.contains("#   mass ") && text.contains(" kg ") && text.contains(" to "), "{text}");
    let made_by = std::fs::read_to_string(place.join("result/made_by.json")).expect("who made it");
    let made_by: Value = serde_json::from_str(&made_by).expect("JSON");
    let reported = made_by["command"].as_str().expect("a command");
    assert!(reported.starts_with(&format!("friction-stage {command}")), "{reported}");
}

#[test]
fn the_effects_of_a_model_of_ones_own_are_hidden() {
    let place = tempfile::tempdir().expect("a directory");
    let own = "mass: 12.0\nguides: [guide_2, guide_2]\nmotor: {force_limit: 900.0}\neffects:\n  - \
               cable_chain: {center: 0.01, stiffness: 80.0}\n";
    std::fs::write(place.path().join("own.yaml"), own).expect("own.yaml");
    let made = friction_stage(place.path(), "demo recordings --hide own.yaml --seed 7 --out one");
    assert!(made.status.success(), "{made:?}");
    let read = |name: &str| {
        let path = place.path().join(name);
        StageModel::load(&path).unwrap_or_else(|error| panic!("{error}"))
    };
    let (own, declared) = (read("own.yaml"), read("one/declared.yaml"));
    assert_eq!(declared, StageModel { effects: Vec::new(), ..own.clone() });
    let answer = friction_stage(place.path(), "demo recordings --out one --reveal");
    let answer = String::from_utf8(answer.stdout).expect("the answer");
    let real = StageModel::from_yaml(&answer, "answer").expect("a model");
    assert_eq!(real.effects, own.effects);
    assert!(real.mass != own.mass && (real.mass / own.mass - 1.0).abs() <= 0.002, "{}", real.mass);
    let checked = friction_stage(place.path(), "check one/train --json");
    assert_eq!(checked.status.code(), Some(0), "{checked:?}");

    std::fs::write(place.path().join("bare.yaml"), "guides: [guide_2]\n").expect("bare.yaml");
    for (hide, says) in [("bare.yaml", "nothing to hide"), ("none.yaml", "none.yaml")] {
        let run = friction_stage(place.path(), &format!("demo recordings --hide {hide} --out two"));
        assert!(matches!(run.status.code(), Some(1 | 2)), "{run:?}");
        let message = String::from_utf8_lossy(&run.stderr).into_owned();
        assert!(message.contains(says), "{message}");
        assert!(!place.path().join("two").exists(), "{hide}");
    }
}
