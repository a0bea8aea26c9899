//! The commands that take data in: what they print, and how they end.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use friction_stage_data::bag::BagReader;
use tempfile::TempDir;

fn friction_stage(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_friction-stage")).args(arguments).output().unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// A drive of 40 kg with 50 N of Coulomb friction as CSV in mm and kN times `force_scale`, and its
/// mapping.
fn drive(home: &Path, force_scale: f64) -> (PathBuf, PathBuf) {
    let (csv, mapping) = (home.join("drive.csv"), home.join("drive.yaml"));
    let mut text = String::from("t,x,f\n");
    for k in 0..8000 {
        let t = f64::from(k) / 1000.0;
        let w = std::f64::consts::TAU * 2.0;
        let (s, c) = (w * t).sin_cos();
        let (x, a) = (0.02 * s, -0.02 * w * w * s);
        text +=
            &format!("{t},{},{}\n", x * 1e3, force_scale * (40.0 * a + 50.0 * c.signum()) * 1e-3);
    }
    std::fs::write(&csv, text).unwrap();
    let yaml = "signals:\n  time: {column: t}\n  position: {column: x, unit: mm}\n  force_cell: \
                {column: f, unit: kN}\n";
    std::fs::write(&mapping, yaml).unwrap();
    (csv, mapping)
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

#[test]
fn noise_is_judged_by_the_model_in_the_bag_unless_another_is_named() {
    let home = TempDir::new().unwrap();
    let out = home.path().join("step");
    let experiment =
        ["experiment", "fine-step", "--guides", "guide_2", "--rest", "0.3", "--out", text(&out)];
    let made = friction_stage(&experiment);
    assert!(out.join("bags/guide_2_fine_step").is_dir(), "{}", stderr(&made));
    let bag = out.join("bags/guide_2_fine_step");
    let reported = stdout(&friction_stage(&["check", text(&bag)]));
    assert!(reported.contains("0.0500 N is declared"), "{reported}");
    let quieter = home.path().join("quieter.yaml");
    std::fs::write(&quieter, "force_cell: {noise: 0.01}\n").unwrap();
    let reported = stdout(&friction_stage(&["check", text(&bag), "--model", text(&quieter)]));
    assert!(reported.contains("0.0100 N is declared"), "{reported}");
}

#[test]
fn a_replay_takes_the_phases_that_a_record_has_for_itself_and_says_so() {
    let home = TempDir::new().unwrap();
    let (csv, mapping) = drive(home.path(), 1.0);
    // 30 N at 31 Hz shake the carriage behind the cell.
    let shaken = |line: &str| {
        let columns: Vec<Option<f64>> = line.split(',').map(|column| column.parse().ok()).collect();
        match columns[..] {
            [Some(t), Some(x), Some(f)] => {
                format!("{t},{x},{}\n", f - 0.03 * (std::f64::consts::TAU * 31.0 * t + 0.7).sin())
            }
            _ => format!("{line}\n"),
        }
    };
    let with_vibration: String =
        std::fs::read_to_string(&csv).unwrap().lines().map(shaken).collect();
    std::fs::write(&csv, with_vibration).unwrap();
    let bag = home.path().join("drive");
    friction_stage(&["import", text(&csv), "--mapping", text(&mapping), "--out", text(&bag)]);
    let replayed = |effects: &str| {
        let model = home.path().join("model.yaml");
        std::fs::write(&model, format!("effects: [{effects}]\n")).unwrap();
        let replay = friction_stage(&["replay", "--json", "--model", text(&model), text(&bag)]);
        let report: serde_json::Value = serde_json::from_slice(&replay.stdout)
            .unwrap_or_else(|_| panic!("{}", stderr(&replay)));
        (report["missing_force_rms_n"].as_f64().unwrap(), report["notes"].to_string())
    };
    let (misses, notes) = replayed("");
    assert!(!notes.contains("phase"), "{notes}");
    let vibration = |phase: f64| {
        replayed(&format!("external_vibration: {{amplitude: 30, frequency: 31, phase: {phase}}}"))
    };
    let ((right, silent), (wrong, notes)) = (vibration(0.7), vibration(2.9));
    assert!(right < 0.8 * misses && (right / wrong - 1.0).abs() < 0.02, "{misses} {right} {wrong}");
    assert!(notes.contains("external_vibration has the phase here"), "{notes}");
    assert!(!silent.contains("phase"), "{silent}");
    let (slipping, notes) = replayed("ball_passage: {amplitude: 3, period: 0.002, slip: 0.5}");
    assert!(slipping <= misses, "{misses} {slipping}");
    assert!(notes.contains("balls that slip"), "{notes}");
}

#[test]
fn a_csv_file_is_imported_checked_and_told_in_sentences_and_json() {
    let home = TempDir::new().unwrap();
    let (csv, mapping) = drive(home.path(), 1.0);
    let bag = home.path().join("drive");
    let imported =
        friction_stage(&["import", text(&csv), "--mapping", text(&mapping), "--out", text(&bag)]);
    assert_eq!(imported.status.code(), Some(0), "{}", stderr(&imported));
    assert!(
        stdout(&imported).contains("8000 on /stage/encoder")
            && stdout(&imported).contains("8000 on /stage/force_cell")
    );
    let again =
        friction_stage(&["import", text(&csv), "--mapping", text(&mapping), "--out", text(&bag)]);
    assert_eq!(again.status.code(), Some(2));
    assert!(stderr(&again).contains("exists already"));
    // without a question about identification a sound bag is a sound bag
    let plain = friction_stage(&["check", text(&bag)]);
    assert_eq!(plain.status.code(), Some(0), "{}", stdout(&plain));
    let asked = friction_stage(&["check", text(&bag), "--model", "guide_1", "--json"]);
    assert_eq!(asked.status.code(), Some(3));
    let report: serde_json::Value = serde_json::from_str(&stdout(&asked)).unwrap();
    assert_eq!(report["complete"], true);
    assert_eq!(report["data"]["rate_hz"], 1000.0);
    let mass = report["identification"]["cell_fit"]["mass"].as_f64().unwrap();
    assert!((mass - 40.0).abs() < 0.1, "{mass}");
    let problems = report["identification"]["problems"].as_array().unwrap();
    let kinds: Vec<&str> = problems.iter().map(|p| p["kind"].as_str().unwrap()).collect();
    assert!(kinds.contains(&"no_command") && kinds.contains(&"no_setpoint"), "{kinds:?}");
    assert!(!report["identification"]["judgements"].to_string().contains("assumed"), "{report}");
    let direct = friction_stage(&["check", text(&csv), "--mapping", text(&mapping)]);
    let reported = stdout(&direct);
    assert!(
        reported.contains("Stribeck velocity of 1.0e-3 m/s (assumed: no model declares one)"),
        "{reported}"
    );
    // What a recording lacks is no fault of it.
    assert!(
        reported.contains("note: there is no setpoint") && !reported.contains("warning:"),
        "{reported}"
    );
    assert_eq!(direct.status.code(), Some(0), "{reported}");
    assert!(
        reported.contains("mass: can be identified")
            && reported.contains("closed loop: cannot be identified"),
        "{reported}"
    );
}

#[test]
fn a_wrong_unit_a_wrong_mapping_and_a_wrong_file_are_told() {
    let home = TempDir::new().unwrap();
    let (csv, mapping) = drive(home.path(), 1e-3);
    let check = |arguments: &[&str]| {
        let mut all = vec!["check", text(&csv), "--mapping", text(&mapping)];
        all.extend(arguments);
        friction_stage(&all)
    };
    let wrong = check(&["--model", "guide_1"]);
    assert_eq!(wrong.status.code(), Some(3));
    assert!(stdout(&wrong).contains("fatal: force_cell seems to be in kN"), "{}", stdout(&wrong));
    std::fs::write(&mapping, "signals: {position: {column: y}}").unwrap();
    let wrong = check(&[]);
    assert_eq!(wrong.status.code(), Some(1));
    assert!(stderr(&wrong).contains("rate"), "{}", stderr(&wrong));
    let missing = friction_stage(&["check", text(&home.path().join("nothing.csv"))]);
    assert_eq!(missing.status.code(), Some(1));
    assert!(stderr(&missing).contains("nothing.csv"), "{}", stderr(&missing));
    let half = friction_stage(&["import", text(&csv), "--mapping", text(&mapping)]);
    assert_eq!(half.status.code(), Some(2));
}

#[test]
fn a_mapping_is_proposed_and_then_imported() {
    let home = TempDir::new().unwrap();
    let (csv, _) = drive(home.path(), 1.0);
    let rows = std::fs::read_to_string(&csv).unwrap();
    let rows = rows.split_once('\n').unwrap().1;
    let head = "Drive 1\n\nTime,Position actual value,Force\ns,m,N\n";
    std::fs::write(&csv, format!("{head}{rows}")).unwrap();
    let mapping = home.path().join("proposed.yaml");
    let propose = || friction_stage(&["import", text(&csv), "--write", text(&mapping)]);
    let proposed = propose();
    assert_eq!(proposed.status.code(), Some(0), "{}{}", stdout(&proposed), stderr(&proposed));
    let reported = stdout(&proposed);
    for words in ["names in line 3", "units in line 4", "1000 Hz", "Position actual value"] {
        assert!(reported.contains(words), "{reported}");
    }
    let bag = home.path().join("bag");
    let imported =
        friction_stage(&["import", text(&csv), "--mapping", text(&mapping), "--out", text(&bag)]);
    assert_eq!(imported.status.code(), Some(0), "{}", stderr(&imported));
    assert!(stdout(&imported).contains("8000 on /stage/encoder"), "{}", stdout(&imported));
    let reader = BagReader::open(&bag).unwrap();
    let (_, about) = reader.metadata().find(|(name, _)| name == "friction_stage_import").unwrap();
    assert!(
        about["command"].starts_with("friction-stage import ")
            && about["mapping"].contains("signals:")
    );
    assert!(std::fs::read_to_string(&mapping).unwrap().contains("# friction-stage import "));
    // With --force what is there goes once what replaces it is whole, and nothing but a recording.
    let bad = home.path().join("bad.yaml");
    std::fs::write(&bad, "signals: {time: {column: Time}, position: {column: nowhere}}").unwrap();
    let forced = |mapping: &Path, out: &Path| {
        let files = ["--mapping", text(mapping), "--out", text(out), "--force"];
        friction_stage(&[&["import", text(&csv)][..], &files].concat())
    };
    assert_eq!(forced(&bad, &bag).status.code(), Some(1));
    assert!(BagReader::open(&bag).is_ok());
    let replaced = forced(&mapping, &bag);
    assert_eq!(replaced.status.code(), Some(0), "{}", stderr(&replaced));
    assert!(!home.path().join("bag.before").exists());
    let thesis = bag.join("thesis.tex");
    std::fs::write(&thesis, "mine").unwrap();
    for out in [&bag, &csv, &home.path().to_owned()] {
        let refused = forced(&mapping, out);
        assert_eq!(refused.status.code(), Some(2), "{}", stderr(&refused));
    }
    assert!(thesis.exists() && csv.exists());
    // Nothing is overwritten.
    let again = propose();
    assert_eq!(again.status.code(), Some(2));
    assert!(stderr(&again).contains("--write"), "{}", stderr(&again));
    std::fs::write(&csv, "words\nwithout numbers\n").unwrap();
    let nothing = friction_stage(&["import", text(&csv)]);
    assert_eq!(nothing.status.code(), Some(1));
    assert!(stderr(&nothing).contains("no rows of numbers"), "{}", stderr(&nothing));
}

/// Times that count from a trigger, rows whose clock goes back or stands still, rows without a
/// time.
#[test]
fn an_import_keeps_every_row_that_has_a_time_and_tells_what_is_wrong_with_it() {
    let home = TempDir::new().unwrap();
    let (csv, mapping) = drive(home.path(), 1.0);
    let rows = std::fs::read_to_string(&csv).unwrap();
    let import = |name: &str, of_row: &dyn Fn(usize, &str) -> String| {
        let changed: Vec<String> =
            rows.lines().enumerate().map(|(row, line)| of_row(row, line)).collect();
        std::fs::write(&csv, changed.join("\n")).unwrap();
        let bag = home.path().join(name);
        let output = friction_stage(&[
            "import",
            text(&csv),
            "--mapping",
            text(&mapping),
            "--out",
            text(&bag),
            "--json",
        ]);
        let report: serde_json::Value = serde_json::from_str(&stdout(&output))
            .unwrap_or_else(|_| panic!("{}", stderr(&output)));
        (output.status.code(), report)
    };
    let at = |line: &str, time: &dyn Fn(f64) -> String| match line.split_once(',') {
        Some((t, rest)) => {
            t.parse().map_or_else(|_| line.to_owned(), |t| format!("{},{rest}", time(t)))
        }
        None => line.to_owned(),
    };
    let (code, report) = import("trigger", &|_, line| at(line, &|t| (t - 2.5).to_string()));
    assert_eq!((code, &report["messages"]["/stage/encoder"]), (Some(0), &8000.into()), "{report}");
    assert!((report["moved_s"].as_f64().unwrap() - 2.5).abs() < 1e-9, "{report}");
    let (code, report) = import("back", &|row, line| {
        if row == 4000 { at(line, &|t| (t - 1.0).to_string()) } else { line.into() }
    });
    assert_eq!((code, &report["not_later"]), (Some(3), &1.into()), "{report}");
    let (code, report) = import("timeless", &|row, line| {
        if row == 4000 { at(line, &|_| "nan".into()) } else { line.into() }
    });
    assert_eq!(
        (code, &report["without_time"], &report["messages"]["/stage/encoder"]),
        (Some(3), &1.into(), &7999.into()),
        "{report}"
    );
}

#[test]
fn a_replay_of_data_that_contradict_the_model_says_so() {
    let home = TempDir::new().unwrap();
    for (force_scale, expected) in [(1.0, None), (1e-3, Some("force_cell seems to be in kN"))] {
        let (csv, mapping) = drive(home.path(), force_scale);
        let bag = home.path().join(force_scale.to_string());
        friction_stage(&["import", text(&csv), "--mapping", text(&mapping), "--out", text(&bag)]);
        let replay = friction_stage(&["replay", text(&bag), "--model", "guide_1"]);
        let reported = stdout(&replay);
        assert_eq!(
            replay.status.code(),
            Some(if expected.is_some() { 3 } else { 0 }),
            "{reported}{}",
            stderr(&replay)
        );
        assert!(
            expected.is_none_or(|words| reported.contains(words))
                && reported.contains("warning") == expected.is_some(),
            "{reported}"
        );
    }
    let full = friction_stage(&[
        "replay",
        text(&home.path().join("1")),
        "--model",
        "guide_1",
        "--csv",
        "/dev/full",
    ]);
    assert_eq!(full.status.code(), Some(1));
    assert!(stderr(&full).contains("cannot write /dev/full"), "{}", stderr(&full));
}

#[test]
fn a_file_without_rows_a_standing_clock_and_one_column_for_two_signals_are_told() {
    let home = TempDir::new().unwrap();
    let (csv, mapping) = drive(home.path(), 1.0);
    let rows = std::fs::read_to_string(&csv).unwrap();
    let check = || friction_stage(&["check", text(&csv), "--mapping", text(&mapping)]);
    std::fs::write(&csv, "t,x,f\n").unwrap();
    assert!(stderr(&check()).contains("no rows of numbers"), "{}", stderr(&check()));
    let stands: Vec<String> = rows
        .lines()
        .map(|line| {
            line.split_once(',').map_or(String::new(), |(t, rest)| {
                if t == "t" { line.into() } else { format!("5.0,{rest}") }
            })
        })
        .collect();
    std::fs::write(&csv, stands.join("\n")).unwrap();
    let reported = stderr(&check());
    assert!(
        reported.contains(
            "1 usable samples of position (a value, at a time of its own), of 8000 in all"
        ),
        "{reported}"
    );
    std::fs::write(&csv, &rows).unwrap();
    std::fs::write(
        &mapping,
        "signals: {time: {column: t}, position: {column: x, unit: mm}, force_cell: {column: x}}",
    )
    .unwrap();
    let reported = stdout(&check());
    assert!(reported.contains("takes position and force_cell from the same place"), "{reported}");
}

#[test]
fn a_table_is_replayed_from_where_it_starts() {
    let home = TempDir::new().unwrap();
    let place = |name: &str| home.path().join(name);
    // What does not depend on the position: a small error is not led further.
    let stage = "guides: [guide_1, guide_1]\neffects:\n  - constant_force: {amplitude: 5.0}\n";
    std::fs::write(place("stage.yaml"), stage).unwrap();
    let (stage, made) = (place("stage.yaml"), place("made"));
    let hide = ["demo", "recordings", "--hide", text(&stage), "--out", text(&made)];
    let made = friction_stage(&hide);
    assert!(made.status.success(), "{}", stderr(&made));
    let real = friction_stage(&["demo", "recordings", "--out", text(&place("made")), "--reveal"]);
    std::fs::write(place("real.yaml"), stdout(&real)).unwrap();
    // Its samples as the table of another logger, from the middle of the first move on.
    let (bag, all) = (place("made").join("train"), place("all.csv"));
    let model = place("real.yaml");
    let whole = ["replay", text(&bag), "--model", text(&model), "--csv", text(&all)];
    assert!(friction_stage(&whole).status.success());
    let samples = std::fs::read_to_string(&all).unwrap();
    let mut table = String::from("t,x,u\n");
    let (mut lowest, mut highest) = (f64::INFINITY, f64::NEG_INFINITY);
    for row in samples.lines().skip(1) {
        let values: Vec<f64> = row.split(',').map(|value| value.parse().unwrap()).collect();
        if values[0] >= 0.8 && values[1].is_finite() {
            table += &format!("{},{},{}\n", values[0], 1e3 * values[2], values[1]);
            (lowest, highest) = (lowest.min(values[2]), highest.max(values[2]));
        }
    }
    std::fs::write(place("drive.csv"), &table).unwrap();
    let mapping = "signals:\n  time: {column: t}\n  position: {column: x, unit: mm}\n";
    std::fs::write(place("drive.yaml"), format!("{mapping}  force: {{column: u}}\n")).unwrap();
    let replay = |mapping: &str, more: &[&str]| {
        let (table, mapping) = (place("drive.csv"), place(mapping));
        friction_stage(&[&["replay", text(&table), "--mapping", text(&mapping)], more].concat())
    };
    let run = replay("drive.yaml", &["--model", text(&model), "--json"]);
    assert!(matches!(run.status.code(), Some(0 | 3)), "{}", stderr(&run));
    let report: serde_json::Value = serde_json::from_slice(&run.stdout).unwrap();
    let rms = report["position_rms_m"].as_f64().unwrap();
    // Forces alone lead it along all of the way.
    assert!(highest - lowest > 0.1 && rms < 1e-3, "{rms} m of {} m", highest - lowest);

    let run = replay("drive.yaml", &[]);
    assert_eq!(run.status.code(), Some(2), "{}", stderr(&run));
    assert!(stderr(&run).contains("is read with --mapping: give a model"), "{}", stderr(&run));
    std::fs::write(place("positions.yaml"), mapping).unwrap();
    let run = replay("positions.yaml", &["--model", text(&model)]);
    assert_eq!(run.status.code(), Some(1), "{}", stderr(&run));
    assert!(stderr(&run).contains("force"), "{}", stderr(&run));
}

/// Below 1 mm/s the servo takes long to reach the speed, and the bristles longer to reach their
/// force: what is averaged has to begin after that.
#[test]
fn the_friction_curve_of_a_guide_on_the_rig_is_that_of_the_catalogue() {
    let home = TempDir::new().unwrap();
    let runs = home.path().join("runs");
    let arguments = ["experiment", "stribeck", "--guides", "guide_1", "--out", text(&runs)];
    assert!(friction_stage(&arguments).status.success());
    let bag = runs.join("bags/guide_1_stribeck");
    let output = friction_stage(&["friction-curve", text(&bag), "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let found: serde_json::Value = serde_json::from_str(&stdout(&output)).unwrap();
    let curve = &found["curve"];
    // What the catalogue declares of it.
    for (fitted, expected) in [
        (&curve["coulomb_force"], 13.5),
        (&curve["viscous_friction"], 18.0),
        (&curve["stribeck"]["static_force"], 16.8),
        (&curve["stribeck"]["velocity"], 5e-3),
    ] {
        let value = fitted["value"].as_f64().unwrap();
        assert!((value / expected - 1.0).abs() < 0.03, "{value}, {expected}");
    }
    assert!(found["drifting_stretches"].as_u64().unwrap() > 0);
    let output = stdout(&friction_stage(&["friction-curve", text(&bag)]));
    assert!(output.contains("left out: the force drifts up to the end"), "{output}");
}

/// Half a move is force, friction and cogging in unknown parts: what a fit makes of it is no
/// statement on signs, units or the machine.
#[test]
fn a_stretch_of_a_sound_recording_is_not_said_to_be_of_another_sign_unit_or_machine() {
    let home = TempDir::new().unwrap();
    let made = home.path().join("made");
    assert!(friction_stage(&["demo", "recordings", "--out", text(&made)]).status.success());
    let (bag, model) = (made.join("train"), made.join("declared.yaml"));
    let mut checked = 0;
    for seconds in [0.6, 1.2] {
        for start in (0..18).map(|index| 0.7 * f64::from(index)) {
            let (from, to) = (format!("{start:.2}"), format!("{:.2}", start + seconds));
            let output = friction_stage(&[
                "check",
                text(&bag),
                "--model",
                text(&model),
                "--from",
                &from,
                "--to",
                &to,
                "--json",
            ]);
            let reported: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
            let findings = reported["data"]["findings"].as_array().unwrap();
            let fatal = findings.iter().filter(|finding| finding["severity"] == "fatal");
            let codes: Vec<&str> = fatal.filter_map(|finding| finding["code"].as_str()).collect();
            // A stretch of a rest does not move.
            assert!(codes.iter().all(|code| *code == "no_motion"), "{from} to {to} s: {codes:?}");
            checked += 1;
        }
    }
    assert_eq!(checked, 36);
}
