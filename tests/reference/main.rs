//! The pages of the reference that the program writes: they say what the program says.
//!
//! `UPDATE_REFERENCE=1 cargo test --release --test reference` rewrites them.

mod json_output;
mod structs;

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::Path;
use std::process::{Command, Output};

use serde_json::{Value, json};

use structs::{Structs, inside, name_of};

fn friction_stage(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .args(arguments)
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .expect("the program starts")
}

fn printed(arguments: &[&str]) -> String {
    let output = friction_stage(arguments);
    assert!(output.status.success(), "{arguments:?}: {output:?}");
    String::from_utf8(output.stdout).expect("text")
}

fn json(arguments: &[&str]) -> Value {
    serde_json::from_str(&printed(arguments)).expect("JSON")
}

/// Compares a page with the committed one, or writes it.
fn assert_current(name: &str, title: &str, text: &str) {
    let page = format!(
        "<!-- Written by `UPDATE_REFERENCE=1 cargo test --release --test reference`. -->\n\n# \
         {title}\n\n{}\n",
        text.trim_end()
    );
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/reference").join(name);
    if std::env::var_os("UPDATE_REFERENCE").is_some() {
        std::fs::write(&path, &page).expect("the page is written");
    }
    let committed = std::fs::read_to_string(&path).unwrap_or_default();
    assert!(
        committed == page,
        "{} is not current: UPDATE_REFERENCE=1 cargo test --release --test reference rewrites it",
        path.display()
    );
}

fn text<'a>(value: &'a Value, key: &str) -> &'a str {
    value[key].as_str().unwrap_or_else(|| panic!("no {key} in {value}"))
}

/// A cell of a table.
fn cell(text: &str) -> String {
    text.replace('|', "\\|").replace('\n', " ")
}

#[test]
fn the_page_of_effects_is_current() {
    let all = json(&["effects", "--json"]);
    let mut page = "What a model file may add to its guides; `friction-stage effects NAME` shows \
                    one. A value\nbeyond its bounds is an error.\n"
        .to_owned();
    for effect in all.as_array().expect("a list") {
        let name = text(effect, "name");
        assert_eq!(&json(&["effects", name, "--json"]), effect);
        write!(page, "\n## {name}\n\n```text\n{}\n```\n\n", text(effect, "law")).unwrap();
        for (label, key) in [
            ("Acts on", "acts_on"),
            ("Telltale", "telltale"),
            ("Source", "source"),
            ("Number", "how_many"),
        ] {
            writeln!(page, "- {label}: {}", text(effect, key)).unwrap();
        }
        page += "\n| parameter | what | unit | values | default |\n|---|---|---|---|---|\n";
        for parameter in effect["parameters"].as_array().expect("parameters") {
            let forms = parameter["forms"].as_array();
            let names = |forms: &Vec<Value>| -> Vec<String> {
                forms.iter().filter_map(|form| form.as_str().map(|f| format!("`{f}`"))).collect()
            };
            let values = match forms {
                Some(forms) => names(forms).join(", "),
                None => format!("{} to {}", parameter["min"], parameter["max"]),
            };
            let default = match (parameter["default"].as_f64(), forms) {
                (None, _) => "required".to_owned(),
                (Some(place), Some(forms)) => names(forms)[place as usize].clone(),
                (Some(value), None) => value.to_string(),
            };
            writeln!(
                page,
                "| `{}` | {} | {} | {values} | {default} |",
                text(parameter, "name"),
                cell(text(parameter, "description")),
                text(parameter, "unit"),
            )
            .unwrap();
        }
        if let Some(example) = effect["example"].as_str() {
            write!(page, "\n```yaml\n{}\n```\n", example.trim_end()).unwrap();
        }
    }
    assert_current("effects.md", "Effects", &page);
}

#[test]
fn the_page_of_guides_is_current() {
    let mut page = "The built-in catalogue; `friction-stage guides NAME` shows one guide. \
                    *Stated* values are in the\npaper, *derived* ones follow from it, *assumed* \
                    ones are chosen.\n"
        .to_owned();
    for guide in json(&["guides", "--json"]).as_array().expect("a list") {
        let name = text(guide, "name");
        assert_eq!(&json(&["guides", name, "--json"]), guide);
        let shown = printed(&["guides", name]);
        write!(page, "\n## {name}\n\n{}.\n\n", text(guide, "description")).unwrap();
        page += "| parameter | value | provenance | source |\n|---|---|---|---|\n";
        for key in [
            "stiffness",
            "bristle_damping",
            "viscous_friction",
            "coulomb_force",
            "static_force",
            "stribeck_velocity",
        ] {
            let quantity = &guide[key];
            assert!(shown.contains(text(quantity, "source")), "{shown}");
            writeln!(
                page,
                "| `{key}` | {} {} | {} | {} |",
                quantity["value"],
                text(quantity, "unit"),
                text(quantity, "provenance"),
                cell(text(quantity, "source"))
            )
            .unwrap();
        }
    }
    assert_current("guides.md", "Guides", &page);
}

/// The commands of the program.
fn commands() -> Vec<String> {
    let overview = printed(&["--help"]);
    let commands = overview.lines().skip_while(|line| *line != "Commands:").skip(1);
    let names: Vec<String> = commands
        .take_while(|line| !line.is_empty())
        .filter(|line| line.starts_with("  ") && !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|name| *name != "help")
        .map(str::to_owned)
        .collect();
    assert!(names.len() >= 14, "{names:?}");
    names
}

#[test]
fn the_page_of_the_command_line_is_current() {
    let (overview, names) = (printed(&["--help"]), commands());
    let mut page = format!("```text\n{}\n```\n", overview.trim_end());
    let each = names.iter().map(|name| vec![name.as_str()]);
    for arguments in each.chain([vec!["demo", "recordings"]]) {
        let title = arguments.join(" ");
        let help = printed(&[&arguments[..], &["--help"]].concat());
        let help: Vec<&str> = help.lines().map(str::trim_end).collect();
        write!(page, "\n## {title}\n\n```text\n{}\n```\n", help.join("\n").trim_end()).unwrap();
    }
    assert_current("command-line.md", "Command line", &page);
}

/// What a type is in a file, in words.
fn kind_in_words(kind: &syn::Type) -> String {
    if let Some(inner) = inside(kind, "Vec") {
        return format!("list of {}", kind_in_words(&inner));
    }
    if let Some(inner) = inside(kind, "BTreeMap") {
        return format!("names with {}", kind_in_words(&inner));
    }
    match name_of(kind).as_str() {
        "f64" => "number".to_owned(),
        "u64" | "usize" => "whole number".to_owned(),
        "bool" => "true or false".to_owned(),
        "String" => "text".to_owned(),
        "PathBuf" => "file".to_owned(),
        "JointType" => "`prismatic` or `revolute`".to_owned(),
        "GuideSource" => "name or guide".to_owned(),
        "EffectParameters" => "[effects](effects.md)".to_owned(),
        other => format!("`{other}`"),
    }
}

/// Tables of the keys of structs, each with what it is.
fn tables(structs: &Structs, names: &[(&str, &str)]) -> String {
    let mut page = String::new();
    for (name, title) in names {
        let found = structs.named(name).unwrap_or_else(|| panic!("there is no {name}"));
        write!(page, "\n## {title}\n\n{}\n\n", found.about).unwrap();
        page += "| key | value | what |\n|---|---|---|\n";
        for key in &found.keys {
            let mut kind = kind_in_words(&key.kind);
            for (name, title) in names {
                let link = format!("[{title}](#{})", title.to_lowercase().replace(' ', "-"));
                kind = kind.replace(&format!("`{name}`"), &link);
            }
            let optional = if key.is_optional { "" } else { " **Required.**" };
            assert!(!key.about.is_empty(), "{name}.{} has no comment", key.name);
            writeln!(page, "| `{}` | {kind} | {}{optional} |", key.name, cell(&key.about)).unwrap();
        }
    }
    page
}

#[test]
fn the_page_of_the_model_file_is_current() {
    let structs = Structs::below(&["crates/friction-stage-core/src/model"]);
    let names = [
        ("StageModel", "Stage"),
        ("Guide", "Guide"),
        ("PartialGuide", "Guide of which little is known"),
        ("Stroke", "Stroke"),
        ("Motor", "Motor"),
        ("ForceCell", "Force cell"),
        ("Encoder", "Encoder"),
        ("Coupling", "Coupling"),
    ];
    let page = format!(
        "A model is a YAML file; `friction-stage model FILE` checks it and shows what it says. \
         Keys\nthat are not here are refused.\n{}",
        tables(&structs, &names)
    );
    assert_current("model-file.md", "Model file", &page);
}

#[test]
fn the_page_of_the_mapping_is_current() {
    let structs = Structs::below(&["crates/friction-stage-data/src/signals/mapping_file.rs"]);
    let names = [
        ("MappingFile", "Mapping"),
        ("SignalFile", "Signal"),
        ("CsvFile", "Table"),
        ("JoinFile", "Joined recording"),
    ];
    let page = format!(
        "A mapping is a YAML file that says which topic and field, or column, is which signal;\n\
         `friction-stage import FILE` proposes one. How to use it:\n\
         [Recordings of others](../how-to/recordings-of-others.md).\n{}",
        tables(&structs, &names)
    );
    assert_current("mapping.md", "Mapping", &page);
}

#[test]
fn the_page_of_the_parameters_is_current() {
    let mut page = String::new();
    for (program, path) in [
        ("stage_node", env!("CARGO_BIN_EXE_stage_node")),
        ("controller_node", env!("CARGO_BIN_EXE_controller_node")),
    ] {
        let output = Command::new(path).arg("--help").output().expect("the program starts");
        let help = String::from_utf8(output.stdout).expect("text");
        let help: Vec<&str> = help.lines().map(str::trim_end).collect();
        write!(page, "\n## {program}\n\n```text\n{}\n```\n", help.join("\n").trim_end()).unwrap();
    }
    assert_current("parameters.md", "Parameters of the nodes", page.trim_start());
}

/// Topics, services and actions have their table in docs/ros2.md.
#[test]
fn every_topic_service_and_action_of_the_nodes_is_documented() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let page = std::fs::read_to_string(root.join("docs/ros2.md")).expect("the page");
    let mut names = BTreeSet::new();
    for entry in std::fs::read_dir(root.join("src/node")).expect("the sources") {
        let text = std::fs::read_to_string(entry.expect("an entry").path()).expect("a source");
        let code = text.split("#[cfg(test)]").next().expect("the code");
        for piece in code.split("\"~/").skip(1) {
            let name = piece.split('"').next().expect("a name");
            names.extend((!name.contains(['{', '*', ' '])).then(|| name.to_owned()));
        }
    }
    assert!(names.len() >= 20, "{names:?}");
    for name in names {
        assert!(page.contains(&name), "~/{name} is not in docs/ros2.md");
    }
}

#[test]
fn an_unknown_name_is_refused_with_the_nearest_one() {
    let cases: [(&[&str], i32, &str); 8] = [
        (&["effects", "coging"], 2, "did you mean `cogging`"),
        (&["guides", "guide_9"], 2, "did you mean `guide_"),
        (&["guides", "guide_2+distributed_bristles"], 2, "`friction-stage model guide_2+"),
        (&["model", "guide_2+distributd"], 2, "did you mean `guide_2+distributed_bristles`"),
        (&["experiment", "fine-step", "--model", "guide_9"], 2, "did you mean `guide_"),
        (&["demo", "--guides", "guide_9"], 2, "did you mean `guide_"),
        (&["demo", "--rest", "nan"], 2, "between 0 and 3600 s"),
        // A file is no name.
        (&["model", "missing.yaml"], 1, "missing.yaml"),
    ];
    for (arguments, code, words) in cases {
        let output = friction_stage(arguments);
        let reported = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {reported}");
        assert!(reported.contains(words), "{arguments:?}: {reported}");
    }
}

/// Every block of YAML in the book that is a model of a stage.
#[test]
fn the_models_in_the_book_load() {
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("model.yaml");
    let mut models = 0;
    for page in ["tutorials/a-stage-in-ten-minutes.md", "how-to/own-stage.md"] {
        let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs").join(page);
        let text = std::fs::read_to_string(page).expect("a page");
        let blocks = text.split("```yaml\n").skip(1).filter_map(|rest| rest.split("```").next());
        for model in blocks.filter(|block| block.contains("mass:")) {
            std::fs::write(&path, model).expect("a model");
            let output = friction_stage(&["model", &path.display().to_string()]);
            assert!(matches!(output.status.code(), Some(0 | 3)), "{model}: {output:?}");
            models += 1;
        }
    }
    assert_eq!(models, 2);
}

#[test]
fn a_model_is_shown_with_its_units_and_what_follows_from_it() {
    // Its guides are not passive, which is a note.
    let output =
        friction_stage(&["model", "launch_config/stage_with_cogging_and_cable_chain.yaml"]);
    let shown = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{shown}");
    for words in [
        "note: the guides are not passive",
        "40 kg",
        "effect cogging: amplitude 6 N",
        "Dahl resonance",
        "67.2 N",
    ] {
        assert!(shown.contains(words), "{words:?} is not in {shown}");
    }
    let directory = tempfile::tempdir().expect("a directory");
    let path = directory.path().join("axis.yaml");
    let axis = "joint: revolute\nmass: 0.01\nguides: [{coulomb_force: 0.1}]\n";
    std::fs::write(&path, axis).expect("a model");
    let path = path.display().to_string();
    let output = friction_stage(&["model", &path]);
    let shown = String::from_utf8_lossy(&output.stdout);
    // What is assumed is no warning.
    assert_eq!(output.status.code(), Some(0), "{shown}");
    assert!(shown.contains("kg m²") && shown.contains("note: guides[0]"), "{shown}");
    assert!(shown.contains("assumed"), "{shown}");
    assert!(!shown.contains("50 mm"), "{shown}");
    let output = friction_stage(&["model", &path, "--json"]);
    let value: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!(value["derived"]["break_away_force"], 0.1);
    assert_eq!((&value["notes"], value["assumptions"][0].is_string()), (&json!([]), true));
    assert_eq!(value["derived"]["fast_move_force"], Value::Null);

    std::fs::write(&path, "effects: [{cogging: {amplitude: -5, period: 0.02}}]\n").expect("a file");
    let output = friction_stage(&["model", &path]);
    let reported = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{reported}");
    assert!(
        reported.contains("effects.cogging.amplitude") && reported.contains("-5"),
        "{reported}"
    );
}
