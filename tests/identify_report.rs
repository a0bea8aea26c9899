//! What `friction-stage identify` writes, how it ends on data that cannot be identified on, and
//! what Ctrl-C leaves.
//!
//! The recordings are too large for the repository: they are read from the directory in
//! FRICTION_STAGE_RECORDINGS, or from `../shared/measured`; where there are none the tests say so
//! and check nothing.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Command, Output, Stdio};

use friction_stage_core::model::StageModel;
use friction_stage_identify::Summary;
use serde_json::Value;
use tempfile::TempDir;

const MODEL: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/launch_config/stage_measured_runs.yaml");

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn identify(train: &Path, holdout: &Path, out: &Path, more: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_friction-stage"));
    command.args([
        "identify",
        "--model",
        MODEL,
        "--train",
        text(train),
        "--holdout",
        text(holdout),
    ]);
    command.args(["--out", text(out)]).args(more);
    command
}

fn stderr(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Identifies a stage run with default settings and gives its summary; checks what holds for every
/// run.
fn summary_of(run: &str) -> Option<(Summary, TempDir)> {
    let home = blind_tests::recordings::with("a/train")?.join(run);
    let out = TempDir::new().unwrap();
    let output = identify(&home.join("train"), &home.join("check"), out.path(), &["--json"])
        .output()
        .unwrap();
    assert!(matches!(output.status.code(), Some(0 | 3)), "{}", stderr(&output));
    let written = std::fs::read_to_string(out.path().join("summary.json")).unwrap();
    assert_eq!(String::from_utf8(output.stdout).unwrap(), written);
    let summary: Summary = serde_json::from_str(&written).unwrap();
    println!("{run}: {written}");
    assert_eq!(output.status.code(), Some(if summary.warnings.is_empty() { 0 } else { 3 }));
    assert_eq!(summary.schema_version, 1);
    let model = StageModel::load(&out.path().join(&summary.model)).unwrap();
    let found: Vec<&str> = model.effects.iter().map(|effect| effect.name.as_str()).collect();
    let reported: Vec<&str> = summary.effects.iter().map(|effect| effect.name.as_str()).collect();
    assert_eq!(found, reported);
    Some((summary, out))
}

#[test]
fn harmonics_are_one_effect_and_a_side_has_its_colours_in_every_figure() {
    let Some((_, out)) = summary_of("a") else { return };
    let page = std::fs::read_to_string(out.path().join("report.html")).unwrap();
    let heading = "<h3>cogging, 24.00 mm with its second harmonic, motor side</h3>";
    assert!(page.contains(heading) && page.matches("<h3>cogging").count() == 1);
    let figure = |name: &str| {
        let path = out.path().join("figures").join(name);
        std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{name}: {error}"))
    };
    // Before and after: vermillion and blue of the motor side, orange and sky blue of the carriage.
    let (motor, carriage) = (["#D55E00", "#0072B2"], ["#E69F00", "#56B4E9"]);
    for (side, own, other) in [("motor", motor, carriage), ("carriage", carriage, motor)] {
        let figure = figure(&format!("residual_over_time_{side}_side_holdout.svg"));
        let lines: String = figure
            .lines()
            .filter(|line| line.starts_with("<polyline"))
            .collect::<Vec<_>>()
            .concat();
        assert!(own.iter().all(|colour| lines.contains(colour)), "{side}");
        assert!(other.iter().all(|colour| !lines.contains(colour)), "{side}");
    }
    assert!(
        [motor, carriage]
            .iter()
            .flatten()
            .all(|colour| { figure("spectrum_over_time.svg").contains(colour) })
    );
}

#[test]
fn a_verdict_without_a_law_says_where_the_residual_is() {
    let Some((summary, out)) = summary_of("f") else { return };
    assert_eq!(summary.verdict, "unknown");
    let page = std::fs::read_to_string(out.path().join("report.html")).unwrap();
    let verdict = page.split("No law of the list").nth(1).unwrap().split("</p>").next().unwrap();
    for words in ["hold-out record, carriage side", "of its power is between", "of the distance"] {
        assert!(verdict.contains(words), "no {words}: {verdict}");
    }
    // Once, and the values of the map in lines.
    assert_eq!(page.matches("without a map, on the hold-out record").count(), 1);
    let model = std::fs::read_to_string(out.path().join("identified.yaml")).unwrap();
    assert!(model.contains("values: [") && model.lines().count() < 120, "{model}");
}

#[test]
fn a_spring_along_the_way_is_found_and_everything_is_written() {
    let Some((summary, out)) = summary_of("c") else { return };
    assert_eq!(summary.verdict, "found");
    let [effect] = summary.effects.as_slice() else { panic!("{:?}", summary.effects) };
    assert_eq!((effect.name.as_str(), effect.side.as_str()), ("cable_chain", "carriage"));
    let stiffness = &effect.parameters["stiffness"];
    let [low, high] = stiffness.ci95.unwrap();
    assert!(
        low < stiffness.value && stiffness.value < high && high - low < 0.1 * stiffness.value,
        "{stiffness:?}"
    );
    assert!(summary.explained_share > 0.9);
    let position = summary.errors.holdout.position_rms;
    assert!(position.after.unwrap() < 0.3 * position.before.unwrap(), "{position:?}");

    // The file as other programs read it.
    let json: Value =
        serde_json::from_str(&std::fs::read_to_string(out.path().join("summary.json")).unwrap())
            .unwrap();
    for key in [
        "/schema_version",
        "/verdict",
        "/effects/0/name",
        "/effects/0/side",
        "/effects/0/coordinate",
        "/effects/0/parameters/stiffness/value",
        "/effects/0/parameters/stiffness/unit",
        "/effects/0/parameters/stiffness/ci95/1",
        "/effects/0/runner_up/name",
        "/effects/0/runner_up/holdout_force_rms",
        "/errors/train/force_rms/before",
        "/errors/train/force_relative/after",
        "/errors/train/position_rms/before",
        "/errors/holdout/force_rms/after",
        "/errors/holdout/force_relative/before",
        "/errors/holdout/position_rms/after",
        "/floor/force_rms",
        "/explained_share",
        "/declared_parameters/mass/value",
        "/declared_parameters/mass/unit",
        "/declared_parameters/mass/ci95/0",
        "/model",
        "/warnings",
    ] {
        assert!(json.pointer(key).is_some(), "no {key} in {json}");
    }

    let page = std::fs::read_to_string(out.path().join("report.html")).unwrap();
    for words in [
        "cable_chain",
        "explained share",
        "Declared parameters",
        "Residual over jerk",
        "Spectrum over position",
        "Round 1",
    ] {
        assert!(page.contains(words), "no {words}");
    }
    // Nothing from elsewhere: the name space of SVG is no address that anybody loads.
    let addresses = page
        .replace("http://www.w3.org/2000/svg", "")
        .replace(friction_stage_report::interactive::LIBRARY, "");
    for word in ["http://", "https://", "<link", "<img", "@import", "url("] {
        assert!(!addresses.contains(word), "{word}");
    }
    let text = page.split("<script").next().unwrap();
    assert!(!text.contains("NaN"));
    assert!(out.path().join("figures/residual_over_position.svg").is_file());
}

/// A record of a stage as CSV with the columns of a trace: a mass of 40 kg with friction under a
/// force, in place of any.
fn csv(path: &Path, rows: usize, change: impl Fn(usize, &mut [f64; 4])) {
    let mut text = String::from("time,position,force_cell,force\n");
    for k in 0..rows {
        let t = k as f64 / 2000.0;
        let w = std::f64::consts::TAU * (0.5 + 0.1 * (0.3 * t).sin());
        let (s, c) = (w * t).sin_cos();
        let (x, a) = (0.02 * s, -0.02 * w * w * s);
        let force = 40.0 * a + 54.0 * (c / 0.02).tanh() + 72.0 * 0.02 * w * c;
        let mut row = [t, x, force, force];
        change(k, &mut row);
        text += &format!("{},{},{},{}\n", row[0], row[1], row[2], row[3]);
    }
    std::fs::write(path, text).unwrap();
}

#[test]
fn bad_data_end_with_a_sentence_and_never_with_a_verdict() {
    let home = TempDir::new().unwrap();
    let good = home.path().join("good.csv");
    csv(&good, 12_000, |_, _| ());
    type Change = fn(usize, &mut [f64; 4]);
    let cases: [(&str, usize, Change, &str); 6] = [
        ("still", 12_000, |_, row| row[1] = 0.0, "moves"),
        ("swapped", 12_000, |_, row| (row[2], row[3]) = (-row[2], -row[3]), "sign"),
        ("millimetres", 12_000, |_, row| row[1] *= 1e3, "unit"),
        ("short", 10, |_, _| (), "rows"),
        ("without_force", 12_000, |_, row| (row[2], row[3]) = (f64::NAN, f64::NAN), "force"),
        ("heavy", 12_000, |_, row| (row[2], row[3]) = (9.0 * row[2], 9.0 * row[3]), "kg"),
    ];
    for (name, rows, change, words) in cases {
        let bad = home.path().join(format!("{name}.csv"));
        csv(&bad, rows, change);
        let out = home.path().join(format!("out_{name}"));
        for (train, holdout) in [(&bad, &good), (&good, &bad)] {
            let output = identify(train, holdout, &out, &[]).output().unwrap();
            assert_eq!(output.status.code(), Some(1), "{name}: {}", stderr(&output));
            let reported = stderr(&output);
            assert!(reported.contains(words) && reported.contains(name), "{name}: {reported}");
            assert!(!reported.contains("panicked"), "{reported}");
            assert!(!out.join("summary.json").exists(), "{name}");
        }
    }
}

#[test]
fn a_hold_out_that_is_the_train_record_is_refused() {
    let home = TempDir::new().unwrap();
    let (one, copy, part) =
        (home.path().join("one.csv"), home.path().join("copy.csv"), home.path().join("part.csv"));
    csv(&one, 12_000, |_, _| ());
    std::fs::copy(&one, &copy).unwrap();
    csv(&part, 9000, |_, _| ());
    let out = home.path().join("out");
    let same = identify(&one, &one, &out, &[]).output().unwrap();
    assert_eq!(same.status.code(), Some(2), "{}", stderr(&same));
    assert!(stderr(&same).contains("both train and hold-out"));
    for other in [&copy, &part] {
        let output = identify(&one, other, &out, &[]).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
        assert!(stderr(&output).contains("sample by sample"), "{}", stderr(&output));
    }
    assert!(!out.exists());
}

#[test]
fn wrong_arguments_end_with_2_and_missing_files_with_1() {
    let home = TempDir::new().unwrap();
    let out = home.path().join("out");
    let nothing = home.path().join("nothing");
    for more in
        [["--guide-tolerance", "16"].as_slice(), &["--mass-tolerance", "-1"], &["--no-such-option"]]
    {
        assert_eq!(
            identify(&nothing, &nothing, &out, more).output().unwrap().status.code(),
            Some(2),
            "{more:?}"
        );
    }
    let bare = Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .args(["identify", "--train", "a"])
        .output()
        .unwrap();
    assert_eq!(bare.status.code(), Some(2));
    let other = home.path().join("other");
    let absent = identify(&nothing, &other, &out, &[]).output().unwrap();
    assert_eq!(absent.status.code(), Some(1));
    assert!(stderr(&absent).contains("nothing"), "{}", stderr(&absent));
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join("summary.json"), "{\"statements\": []}").unwrap();
    let foreign = identify(&nothing, &other, &out, &[]).output().unwrap();
    assert_eq!(foreign.status.code(), Some(2));
    assert!(stderr(&foreign).contains("another command"), "{}", stderr(&foreign));
    std::fs::write(out.join("summary.json"), "{\"verdict\": \"none\"}").unwrap();
    let earlier = identify(&nothing, &other, &out, &[]).output().unwrap();
    assert_eq!(earlier.status.code(), Some(2));
    assert!(stderr(&earlier).contains("--force"), "{}", stderr(&earlier));
    let replaced = identify(&nothing, &other, &out, &["--force"]).output().unwrap();
    assert_eq!(replaced.status.code(), Some(1), "{}", stderr(&replaced));
    for (file, words) in [
        ("metadata.yaml", "is a recording"),
        ("report.html", "no summary.json of an identification"),
    ] {
        let taken = home.path().join(file.replace('.', "_"));
        std::fs::create_dir(&taken).unwrap();
        std::fs::write(taken.join(file), "").unwrap();
        let refused = identify(&nothing, &other, &taken, &[]).output().unwrap();
        assert_eq!(refused.status.code(), Some(2));
        assert!(stderr(&refused).contains(words), "{}", stderr(&refused));
    }
}

/// One that lacks a cable chain, and one that lacks nothing: whether it does is not known before
/// everything was tried.
#[test]
fn ctrl_c_leaves_a_partial_report_that_says_so() {
    let Some(home) = blind_tests::recordings::with("a/train") else { return };
    for run in ["c", "b"] {
        let (out, run) = (TempDir::new().unwrap(), home.join(run));
        let mut child = identify(&run.join("train"), &run.join("check"), out.path(), &["--json"])
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut progress = BufReader::new(child.stderr.take().unwrap()).lines();
        assert!(
            progress.any(|line| line.unwrap().starts_with("round 1")),
            "ended without a first round"
        );
        // SAFETY: the process is a child of ours that has not been waited for.
        let sent = unsafe { libc::kill(child.id() as i32, libc::SIGINT) };
        assert_eq!(sent, 0);
        let output = child.wait_with_output().unwrap();
        assert_eq!(output.status.code(), Some(130));
        let summary: Summary = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!((summary.verdict.as_str(), summary.effects.len()), ("unknown", 0));
        assert!(
            summary.warnings.iter().any(|warning| warning.contains("stopped")),
            "{:?}",
            summary.warnings
        );
        let page = std::fs::read_to_string(out.path().join("report.html")).unwrap();
        assert!(page.contains("Partial report"));
    }
}
