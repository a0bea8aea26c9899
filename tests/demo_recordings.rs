//! `friction-stage demo recordings` and the `identify` line of the README, as written, at the
//! process boundary.

use std::path::Path;
use std::process::{Command, Output};

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
        let told = String::from_utf8_lossy(&found.stderr);
        assert!(matches!(found.status.code(), Some(0 | 3)), "{told}");
        let summary: Value = serde_json::from_slice(&found.stdout).expect("the summary");
        let answer = friction_stage(place.path(), reveal);
        let answer = String::from_utf8(answer.stdout).expect("the answer");
        assert_eq!(summary["verdict"], "found", "seed {seed}: {summary:#}\n{answer}");
        let effects = summary["effects"].as_array().expect("effects");
        let name = effects[0]["name"].as_str().expect("a name");
        assert_eq!(effects.len(), 1, "seed {seed}: {summary:#}\n{answer}");
        assert!(answer.contains(&format!("{name}:")), "seed {seed}: {name} is not in {answer}");

        hidden.insert(name.to_owned());

        let again = friction_stage(place.path(), make);
        assert_eq!(again.status.code(), Some(2), "{again:?}");
        assert!(String::from_utf8_lossy(&again.stderr).contains("exists already"), "{again:?}");
    }
    assert_eq!(hidden.len(), 3, "{hidden:?}");
}
