//! The page of what every command prints with `--json`: each is run, and the keys of its output are
//! named with what the comments of the sources say of them.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::process::Command;

use serde_json::Value;

use super::structs::Structs;
use super::{assert_current, cell};

/// A short motion for the stage.
const MOTION: &str = "joint_names: [stage]\npoints:\n- {positions: [1e-3], velocities: [0.0], \
                      accelerations: [0.0], time_from_start: {sec: 0, nanosec: 50000000}}\n- \
                      {positions: [1e-3], velocities: [0.0], accelerations: [0.0], \
                      time_from_start: {sec: 0, nanosec: 150000000}}\n";

/// The commands in an order in which each finds its inputs, as a user would write them; `$` stands
/// for the repository. A title of several words is that of a command within a command.
const COMMANDS: [(&str, &str); 21] = [
    ("effects", "effects cogging"),
    ("guides", "guides guide_2"),
    ("model", "model $/launch_config/stage_with_cogging_and_cable_chain.yaml"),
    ("demo recordings", "demo recordings --out recordings"),
    (
        "identify",
        "identify --model recordings/declared.yaml --train recordings/train --holdout \
                  recordings/check --out result",
    ),
    ("check", "check recordings/train --model recordings/declared.yaml"),
    ("import", "import table.csv"),
    ("friction-curve", "friction-curve recordings/train"),
    ("replay", "replay recordings/train --model recordings/declared.yaml"),
    ("view", "view recordings/train --out page.html"),
    ("recover", "recover recordings/train"),
    (
        "compensate",
        "compensate --model result/identified.yaml --real result/identified.yaml \
                    motion.yaml --out compensation",
    ),
    ("play", "play motion.yaml --model recordings/declared.yaml --record run"),
    ("experiment stribeck", "experiment stribeck --guides guide_1 --out rig"),
    ("experiment dahl", "experiment dahl --guides guide_1 --amplitudes 1e-5 --out loops"),
    (
        "fit-guide",
        "fit-guide --stribeck rig/bags/guide_1_stribeck --dahl loops/bags/guide_1_dahl_10um \
                   --name own --out own.yaml",
    ),
    ("sweep", "sweep controller.bandwidth=40,60 --out sweep"),
    (
        "select",
        "select --application $/launch_config/application_fine_step_clean.yaml --variants \
                6 --out choice",
    ),
    ("merge", "merge choice --out whole"),
    ("tune", "tune guide_2 --out tuning"),
    ("demo", "demo --out demo"),
];

/// What keys are whose objects have no struct of their own. Where a key means different things, the
/// command and the whole path stand before it.
const SAID: &[(&str, &str)] = &[
    ("schema_version", "Version of the format."),
    ("warnings", "What a user should know, in sentences."),
    ("name", "Its name."),
    ("law", "Its equation."),
    ("source", "Where the law is from."),
    ("telltale", "By what it shows in a recording."),
    ("acts_on", "Side of the stage, and what of it."),
    ("how_many", "How many of them a model may have."),
    ("example", "A model file with it."),
    ("is_curve", "Whether it is the empirical curve."),
    ("parameters", "Its parameters."),
    ("default", "Value where none is given; nothing where it is required."),
    ("description", "What it is, for people."),
    ("forms", "Names that stand for its values, where it is a choice."),
    ("min", "Least value."),
    ("max", "Largest value."),
    ("unit", "Its SI unit."),
    ("value", "Its value."),
    ("ci95", "Lower and upper end of its 95 % interval."),
    ("standard_error", "Its standard error."),
    ("before", "Of the declared model, refitted."),
    ("after", "Of the identified model."),
    ("q05", "5 % are below."),
    ("q50", "Median."),
    ("q95", "95 % are below."),
    ("bytes", "Size of the files."),
    ("complete", "Whether the recording was closed."),
    ("damage", "What is broken in it, in a sentence."),
    ("bag", "Directory of the recording."),
    ("figure", "File of the figure."),
    ("page", "File of the page."),
    ("cycles", "Cycles of stage and controller."),
    ("cycles_per_second", "How fast they ran."),
    ("guide", "Name of the guide."),
    ("guides", "Each guide."),
    ("rank", "Place in the ranking, from 1 on."),
    ("ranking", "The guides, the best first."),
    ("variants", "Variants that were computed."),
    ("never_settled", "Variants that did not settle."),
    ("application", "Name of the application."),
    ("chance_ci95", "95 % interval of the chance to meet the requirement."),
    ("findings", "What was found out, each with a code."),
    ("code", "Stable name of the kind."),
    ("severity", "`note`, `warning` or `fatal`."),
    ("text", "The sentence for it."),
    ("reasons", "Why it is not the one to take; empty for the chosen one."),
    ("notes", "What is worth knowing, in sentences."),
    ("data", "The signals of the stage."),
    ("clock", "How the samples are spaced."),
    ("rate_hz", "Samples per second."),
    ("segments", "Pieces without a hole."),
    ("signals", "Each signal."),
    ("valid_rows", "Rows that have every signal."),
    ("stiffness", "Bristle stiffness sigma0, N/m."),
    ("bristle_damping", "Bristle damping sigma1, N s/m."),
    ("viscous_friction", "Viscous friction sigma2, N s/m."),
    ("coulomb_force", "Coulomb friction Fc, N."),
    ("static_force", "Static friction Fs, N."),
    ("stribeck_velocity", "Stribeck velocity vs, m/s."),
    ("cage", "Whether its balls are in a cage."),
    ("seals", "Whether it has seals."),
    ("lubricant", "Its lubricant."),
    ("distributed_bristles", "Its bristles in parallel, where they are known."),
    ("effective_stiffness", "Stiffness at amplitudes that the paper states."),
    ("train", "Recording to fit."),
    ("holdout", "Recording to judge on."),
    ("model", "File of the model."),
    ("position_rms_m", "Rms of the position error."),
    ("position_max_m", "Largest position error."),
    ("without", "The run without compensation."),
    ("with", "The run with compensation."),
    ("not_compensated", "Effects that are not compensated."),
    ("controller", "What controls."),
    ("force_limit", "Largest force, N."),
    ("p", "Proportional gain, N/m."),
    ("i", "Integral gain, N/(m s)."),
    ("d", "Derivative gain, N s/m."),
    ("lowpass_frequency", "Of the lowpass behind the PID, Hz."),
    ("mass_feedforward", "Mass that is fed forward, kg."),
    ("rate", "Samples per second, Hz."),
    ("arrival", "When the reference arrives, s."),
    ("catalogue", "File of the catalogue."),
    ("force_rms_n", "What the fit leaves."),
    ("noise_rms_n", "What the noise of the cell leaves."),
    ("curve", "The fitted curve."),
    ("offset", "Constant force, N."),
    ("velocity", "Its velocity, m/s."),
    ("joint_type", "`prismatic` or `revolute`."),
    ("improved", "Whether the gains are better than the rule of thumb."),
    ("mass", "Moving mass, kg."),
    ("objective", "What is made small."),
    ("rule_keeps_margins", "Whether the rule of thumb keeps its margins."),
    ("tunings", "Each set of gains."),
    ("gains", "The gains."),
    ("nominal", "On the stage as declared, at each amplitude."),
    ("margins", "Margins of the loop."),
    ("on_variants", "On variants that the search did not see."),
    ("ratio", "Objective over that of the rule of thumb, median."),
    ("loops", "Its loops."),
    ("peak_error_um", "Largest error, µm."),
    ("check rows", "Of a table: what its rows are, as a topic is."),
    ("check data.rows", "Rows on the common grid."),
    ("no_data", "Why there are no signals, in a sentence."),
    ("identification", "What the motion covers and what can be identified."),
    ("judgements", "What can be identified and what cannot."),
    ("subject", "What it is about."),
    ("possible", "Whether it can be identified."),
    ("because", "Why, in a sentence."),
    ("evidence", "The figures that make it possible."),
    ("check identification.judgements[].evidence.speeds", "Velocities, and speeds that are held."),
    ("check identification.judgements[].evidence.held_speeds.speeds", "Speeds that are held, m/s."),
    ("check identification.judgements[].evidence.reversals.count", "How many."),
    ("check identification.judgements[].evidence.stroke", "Highest less lowest position."),
    ("check identification.judgements[].evidence.stroke.stroke", "m"),
    ("obstacle", "The figures of what stands in the way."),
    ("runs", "Each stretch at a held speed."),
    ("recording", "The recording that it is in."),
    ("without_held_speed", "Recordings in which no speed is held."),
    ("drifting_stretches", "Stretches that are left out, since their force drifts up to the end."),
    ("replay samples", "Samples of the encoder."),
    ("play samples", "File of the samples."),
    ("play points", "Points of the motion."),
    ("moves", "Each move."),
    ("experiment", "Name of the experiment."),
    ("results", "What it measured, by its parts."),
    ("seed", "Seed of the noise, or of the draws."),
    ("version", "Version of the program."),
    ("fit-guide rows", "Rows that the fit used."),
    ("fit-guide runs", "Recordings that the fit used."),
    ("tune tunings[].on_variants.saturated", "Variants whose motor came to its limit."),
    ("select ranking[].obstacle", "Why it cannot be used, whatever it reaches."),
    ("merge ranking[].obstacle", "Why it cannot be used, whatever it reaches."),
    (
        "select findings[].static_force",
        "Static friction, its own and that of the guide to take, N.",
    ),
    ("merge findings[].static_force", "Static friction, its own and that of the guide to take, N."),
    ("select ranking[].saturated", "Variants whose motor came to its limit."),
    ("merge ranking[].saturated", "Variants whose motor came to its limit."),
    ("worst", "Worst margins over guides within their tolerances, and amplitudes."),
    ("without_lowpass", "The same without the lowpass."),
];

/// Kinds of values that a key had.
#[derive(Default)]
struct Seen {
    kinds: Vec<&'static str>,
    about: Option<String>,
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "nothing",
        Value::Bool(_) => "true or false",
        Value::Number(_) => "number",
        Value::String(_) => "text",
        Value::Array(_) => "list",
        Value::Object(_) => "object",
    }
}

/// Keys whose values stand under names of their own, such as the parameters of an effect.
const BY_NAME: [&str; 3] = ["declared_parameters", "effects[].parameters", "model.effects[]"];

/// What stands below a name of [`BY_NAME`].
const OF_A_NAME: &str = "What has this name.";
/// A model is described elsewhere.
const OF_AN_EFFECT: &str = "As in the [model file](model-file.md): [Effects](effects.md).";

/// The keys of one output.
struct Walk<'a> {
    command: &'a str,
    structs: &'a Structs,
    found: BTreeMap<String, Seen>,
}

impl Walk<'_> {
    fn look(&mut self, value: &Value, path: &str) {
        match value {
            Value::Array(items) => {
                items.iter().for_each(|item| self.look(item, &format!("{path}[]")));
            }
            Value::Object(entries) => {
                let keys: Vec<&str> = entries.keys().map(String::as_str).collect();
                let by_name = BY_NAME.contains(&path);
                for (key, value) in entries {
                    let below = match (path, by_name) {
                        ("", _) => key.clone(),
                        (_, true) => format!("{path}.NAME"),
                        (_, false) => format!("{path}.{key}"),
                    };
                    let seen = self.found.entry(below.clone()).or_default();
                    let kind = kind(value);
                    if !seen.kinds.contains(&kind) {
                        seen.kinds.push(kind);
                        seen.kinds.sort_unstable();
                    }
                    let about = match path {
                        _ if by_name => Some(OF_A_NAME),
                        _ if path.starts_with("model.effects[].") => Some(OF_AN_EFFECT),
                        _ => {
                            let said = |of: &str| {
                                SAID.iter().find(|(known, _)| *known == of).map(|(_, words)| *words)
                            };
                            said(&format!("{} {below}", self.command))
                                .or_else(|| self.structs.about(key, &keys))
                                .or_else(|| said(key))
                                .or_else(|| self.structs.about_of_part(key, &keys))
                        }
                    };
                    if let Some(about) = about {
                        seen.about = Some(about.to_owned());
                    }
                    self.look(value, &below);
                }
            }
            _ => {}
        }
    }
}

#[test]
fn the_page_of_the_json_is_current() {
    let home = tempfile::tempdir().expect("a directory");
    let write = |name: &str, text: &str| std::fs::write(home.path().join(name), text).expect(name);
    write("motion.yaml", MOTION);
    write("table.csv", "t (ms),x (mm),F (N)\n0,0,1\n1,1e-3,2\n2,2e-3,2\n3,4e-3,1\n4,5e-3,1\n");
    let crates = ["core", "data", "identify", "lab", "report"];
    let crates = crates.map(|name| format!("crates/friction-stage-{name}/src"));
    let directories: Vec<&str> = crates.iter().map(String::as_str).chain(["src"]).collect();
    let structs = Structs::below(&directories);
    let mut page = "Every command prints one JSON document with `--json`, and its exit code as \
                    without. A key with\n`[]` is one of every item of a list, `NAME` stands for a \
                    name, such as that of a parameter.\nNumbers have SI units unless the name of \
                    the key says another. Each command was run as it\nstands here; others may have \
                    further keys. Keys are added within a version of the format\n\
                    (`schema_version`), and not renamed.\n"
        .to_owned();
    let mut wordless = Vec::new();
    for (title, command) in COMMANDS {
        let given = command.replace('$', env!("CARGO_MANIFEST_DIR"));
        let output = Command::new(env!("CARGO_BIN_EXE_friction-stage"))
            .args(given.split_whitespace())
            .arg("--json")
            .current_dir(home.path())
            .output()
            .expect("the program starts");
        let reported = String::from_utf8_lossy(&output.stderr);
        assert!(matches!(output.status.code(), Some(0 | 3)), "{command}: {reported}");
        let printed: Value = serde_json::from_slice(&output.stdout)
            .unwrap_or_else(|error| panic!("{command}: {error}: {reported}"));
        let mut walk = Walk { command: title, structs: &structs, found: BTreeMap::new() };
        walk.look(&printed, "");
        let shown = command.replace("$/", "").split_whitespace().collect::<Vec<_>>().join(" ");
        write!(page, "\n## {title}\n\n`friction-stage {shown} --json`\n\n").unwrap();
        page += "| key | value | what |\n|---|---|---|\n";
        for (path, seen) in &walk.found {
            let Some(about) = &seen.about else {
                wordless.push(format!("{title}: {path}"));
                continue;
            };
            let about = cell(about);
            writeln!(page, "| `{path}` | {} | {about} |", seen.kinds.join(" or ")).unwrap();
        }
    }
    assert!(wordless.is_empty(), "keys without words: {wordless:#?}");
    for name in super::commands() {
        let has_json = super::printed(&[&name, "--help"]).contains("--json");
        let is_shown =
            COMMANDS.iter().any(|(title, _)| title.split(' ').next() == Some(name.as_str()));
        assert!(is_shown || !has_json, "{name} --json is not on the page");
    }
    assert_current("json.md", "JSON of the commands", &page);
}
