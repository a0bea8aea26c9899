//! `select`, `merge` and `fit-guide` at the process boundary: results, messages and exit codes.

use std::path::{Path, PathBuf};
use std::process::Output;

use friction_stage_core::model::{Catalogue, StageModel};
use friction_stage_data::bag::{BagOptions, BagWriter, OfferedQos, Provenance, topics};
use friction_stage_data::message::{Header, JointState, WrenchStamped};
use friction_stage_lab::RigRecord;

mod program;

use program::{program, run};

fn config(name: &str) -> String {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("launch_config").join(name).display().to_string()
}

fn written(directory: &Path, name: &str, text: &str) -> String {
    let path = directory.join(name);
    std::fs::write(&path, text).unwrap();
    path.display().to_string()
}

/// The fine step with much shorter times, for tests that are about files and codes.
fn short_application(directory: &Path) -> String {
    let text = std::fs::read_to_string(config("application_fine_step_clean.yaml")).unwrap();
    let text = text
        .replace(
            "settle: 0.3",
            "settle: 0.1\n  conditioning: {distance: 1.0e-3, duration: 0.02, rest: 0.0}",
        )
        .replace("peak_error: 6.0e-6", "peak_error: 1.0");
    written(directory, "short.yaml", &text)
}

fn bytes(directory: &Path) -> Vec<(String, Vec<u8>)> {
    ["plan.yaml", "variants.csv", "variants.parquet", "summary.json", "trade_off.svg"]
        .map(|name| {
            (
                name.to_owned(),
                std::fs::read(directory.join(name)).unwrap_or_else(|e| panic!("{name}: {e}")),
            )
        })
        .into()
}

#[test]
fn the_papers_choice_comes_out_with_its_advice() {
    let directory = tempfile::tempdir().unwrap();
    for (application, choice) in [
        ("application_fine_step_clean.yaml", "guide_2"),
        ("application_fine_step_sealed.yaml", "guide_1"),
    ] {
        let out = directory.path().join(choice).display().to_string();
        let (code, stdout, stderr) = run(&[
            "select",
            "--application",
            &config(application),
            "--variants",
            "30",
            "--out",
            &out,
            "--json",
        ]);
        assert_eq!(code, 0, "{stderr}");
        let summary: serde_json::Value = serde_json::from_str(&stdout).unwrap();
        assert_eq!(summary["choice"], choice);
        assert!(summary["notes"][0].as_str().unwrap().starts_with("guide_3"), "{stdout}");
    }
}

#[test]
fn shards_merged_in_any_order_are_one_run_bit_for_bit() {
    let directory = tempfile::tempdir().unwrap();
    let application = short_application(directory.path());
    let at = |name: &str| directory.path().join(name);
    let select = |name: &str, more: &[&str]| {
        let out = at(name).display().to_string();
        let mut arguments =
            vec!["select", "--application", &application, "--variants", "100", "--out", &out];
        arguments.extend(more);
        run(&arguments)
    };
    assert_eq!(select("whole", &[]).0, 0);
    for shard in ["3/3", "1/3", "2/3"] {
        let (code, _, stderr) = select(&shard.replace('/', "_of_"), &["--shard", shard]);
        assert_eq!(code, 0, "{stderr}");
    }
    let (two, one, three) = (at("2_of_3"), at("1_of_3"), at("3_of_3"));
    let merge = |shards: &[&PathBuf], out: &str| {
        let out = at(out).display().to_string();
        let mut arguments = vec!["merge", "--out", &out];
        let shards: Vec<String> = shards.iter().map(|path| path.display().to_string()).collect();
        arguments.extend(shards.iter().map(String::as_str));
        run(&arguments)
    };
    let (code, _, stderr) = merge(&[&two, &one], "missing");
    assert!(code == 1 && stderr.contains("1 of 3 shards missing: 3/3"), "{code} {stderr}");
    let (code, _, stderr) = merge(&[&two, &one, &two], "twice");
    assert!(code == 1 && stderr.contains("both shard 2/3"), "{code} {stderr}");
    let (code, _, stderr) = merge(&[&two, &three, &one], "merged");
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(bytes(&at("merged")), bytes(&at("whole")));

    let (code, _, stderr) = select("other_seed", &["--seed", "2", "--shard", "3/3"]);
    assert_eq!(code, 0, "{stderr}");
    let (code, _, stderr) = merge(&[&one, &two, &at("other_seed")], "mixed");
    assert!(
        code == 1 && stderr.contains("seed: 1") && stderr.contains("seed: 2"),
        "{code} {stderr}"
    );
}

#[test]
fn a_run_that_was_cut_off_goes_on_where_it_was() {
    let directory = tempfile::tempdir().unwrap();
    let application = short_application(directory.path());
    let out = |name: &str| directory.path().join(name).display().to_string();
    let select = |name: &str, more: &[&str]| {
        let out = out(name);
        let mut arguments =
            vec!["select", "--application", &application, "--variants", "60", "--out", &out];
        arguments.extend(more);
        run(&arguments)
    };
    assert_eq!(select("whole", &[]).0, 0);
    assert_eq!(select("cut", &[]).0, 0);
    // As a killed process leaves it: some rows, the last one torn.
    let rows = directory.path().join("cut/variants.csv");
    let text = std::fs::read_to_string(&rows).unwrap();
    std::fs::write(&rows, &text[..text.len() / 3]).unwrap();
    let (code, _, stderr) = run(&["merge", &out("cut"), "--out", &out("merged")]);
    assert!(code == 1 && stderr.contains("cut off within a row"), "{code} {stderr}");
    let whole_rows = text[..text.len() / 3].rfind('\n').unwrap() + 1;
    std::fs::write(&rows, &text[..whole_rows]).unwrap();
    let (code, _, stderr) = run(&["merge", &out("cut"), "--out", &out("merged")]);
    assert!(code == 1 && stderr.contains("of its 60 variants"), "{code} {stderr}");
    std::fs::write(&rows, &text[..text.len() / 3]).unwrap();
    let (code, _, stderr) = select("cut", &[]);
    assert!(code == 2 && stderr.contains("--resume"), "{code} {stderr}");
    let (code, _, stderr) = select("cut", &["--resume", "--seed", "7"]);
    assert!(
        code == 2 && stderr.contains("seed: 1") && stderr.contains("seed: 7"),
        "{code} {stderr}"
    );
    let (code, _, stderr) = select("cut", &["--resume"]);
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(bytes(&directory.path().join("cut")), bytes(&directory.path().join("whole")));
}

#[test]
fn ctrl_c_keeps_what_is_done() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("out");
    let (application, place) =
        (config("application_fine_step_clean.yaml"), out.display().to_string());
    let child = program(&[
        "select",
        "--application",
        &application,
        "--variants",
        "1000000",
        "--out",
        &place,
    ])
    .stderr(std::process::Stdio::piped())
    .stdout(std::process::Stdio::null())
    .spawn()
    .unwrap();
    let rows = out.join("variants.csv");
    let deadline = std::time::Instant::now() + std::time::Duration::from_secs(60);
    while std::fs::metadata(&rows).map_or(0, |found| found.len()) == 0 {
        assert!(std::time::Instant::now() < deadline, "no rows within a minute");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    // SAFETY: the child has not been waited for, so that its number is its own.
    assert_eq!(unsafe { libc::kill(child.id() as i32, libc::SIGINT) }, 0);
    let Output { status, stderr, .. } = child.wait_with_output().unwrap();
    let stderr = String::from_utf8(stderr).unwrap();
    assert_eq!(status.code(), Some(130), "{stderr}");
    let text = std::fs::read_to_string(&rows).unwrap();
    let done = text.lines().count() - 1;
    assert!(
        done > 0 && text.ends_with('\n') && stderr.contains(&format!("after {done} of 1000000")),
        "{stderr}"
    );
}

#[test]
fn parquet_holds_the_rows_of_the_csv() {
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use parquet::record::RowAccessor;
    let directory = tempfile::tempdir().unwrap();
    let application = short_application(directory.path());
    let out = directory.path().join("out");
    let place = out.display().to_string();
    run(&["select", "--application", &application, "--variants", "20", "--out", &place]);
    let file = std::fs::File::open(out.join("variants.parquet")).unwrap();
    let reader = SerializedFileReader::new(file).unwrap();
    let mut table = csv::Reader::from_path(out.join("variants.csv")).unwrap();
    let mut count = 0;
    for (row, record) in reader.get_row_iter(None).unwrap().zip(table.records()) {
        let (row, record) = (row.unwrap(), record.unwrap());
        assert_eq!(row.get_string(0).unwrap(), &record[0]);
        assert_eq!(row.get_ulong(1).unwrap().to_string(), record[1]);
        assert_eq!(row.get_ulong(2).unwrap().to_string(), record[2]);
        assert_eq!(row.get_double(3).unwrap(), record[3].parse::<f64>().unwrap());
        match record[4].parse::<f64>() {
            Ok(time) => assert_eq!(row.get_double(4).unwrap(), time),
            Err(_) => assert!(row.get_double(4).is_err()),
        }
        assert_eq!(row.get_double(11).unwrap(), record[11].parse::<f64>().unwrap());
        count += 1;
    }
    assert_eq!(count, 20);
}

#[test]
fn bad_input_is_said_with_the_right_code() {
    let directory = tempfile::tempdir().unwrap();
    let clean = config("application_fine_step_clean.yaml");
    let text = std::fs::read_to_string(&clean).unwrap();
    let edited = |name: &str, from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        written(directory.path(), name, &text.replace(from, to))
    };
    let impossible = edited("impossible.yaml", "peak_error: 6.0e-6", "peak_error: 1.0e-9");
    let dry = edited("dry.yaml", "sealing: not_needed", "lubricants: [dry]");
    let fast = edited("fast.yaml", "distance: 10.0e-6", "distance: 1.0");
    let empty = written(directory.path(), "empty.yaml", "# no guide yet\n");
    let torn = written(directory.path(), "torn.yaml", "my_guide: {description: x, seals: tr");
    let taken = written(directory.path(), "taken.yaml", &Catalogue::builtin().to_yaml().unwrap());
    let cases: &[(&[&str], i32, &[&str])] = &[
        (&["--application", &impossible], 1, &["no guide meets", "guide_2", "0.00 µm allowed"]),
        (&["--application", &dry], 1, &["no guide can be used", "`dry`"]),
        (&["--application", &fast], 1, &["force_limit", "2000 N", "at least"]),
        (&["--application", &clean, "--catalogue", &empty], 1, &["holds no guide", "empty.yaml"]),
        (&["--application", &clean, "--catalogue", &torn], 1, &["torn.yaml", "line 1"]),
        (
            &["--application", &clean, "--catalogue", &taken],
            1,
            &["`guide_1` is in the catalogue already"],
        ),
        (
            &["--application", &clean, "--guides", "guide_4"],
            2,
            &["unknown guide `guide_4`", "did you mean"],
        ),
        (&["--application", "nowhere.yaml"], 1, &["cannot read nowhere.yaml"]),
        (&["--application", &clean, "--shard", "4/3"], 2, &["4/3", "i/n"]),
        (&["--application", &clean, "--variants", "0"], 2, &["--variants"]),
        (&["--application", &clean, "--variants", "2"], 1, &["2 variants", "3 guides"]),
        (&[], 2, &["--application"]),
    ];
    for (index, (arguments, expected, words)) in cases.iter().enumerate() {
        let out = directory.path().join(format!("out_{index}")).display().to_string();
        let mut all = vec!["select", "--out", &out];
        if !arguments.contains(&"--variants") {
            all.extend(["--variants", "6"]);
        }
        all.extend(*arguments);
        let (code, _, stderr) = run(&all);
        assert_eq!(code, *expected, "{arguments:?}: {stderr}");
        for word in *words {
            assert!(stderr.contains(word), "{arguments:?} gave {stderr:?}, without {word:?}");
        }
    }
    let (code, _, stderr) = run(&["merge", "nowhere", "--out", "no"]);
    assert!(code == 1 && stderr.contains("nowhere holds no selection"), "{code} {stderr}");
}

/// As in a pipe whose reader ends first, such as `head`.
#[test]
fn output_that_nobody_reads_is_no_error() {
    let directory = tempfile::tempdir().unwrap();
    let application = short_application(directory.path());
    let at = |name: &str| directory.path().join(name).display().to_string();
    let (whole, merged) = (at("whole"), at("merged"));
    let select = ["select", "--application", &application, "--variants", "20", "--out", &whole];
    let merge = ["merge", &whole, "--out", &merged, "--json"];
    for (arguments, code) in
        [(select.as_slice(), 0), (&merge, 0), (&["merge", "nowhere", "--out", "no"], 1)]
    {
        let mut child = program(arguments)
            .stdout(std::process::Stdio::piped())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        if code == 1 {
            drop(child.stderr.take());
        }
        let Output { status, stderr, .. } = child.wait_with_output().unwrap();
        let reported = String::from_utf8(stderr).unwrap();
        assert_eq!(status.code(), Some(code), "{arguments:?}: {reported}");
        assert!(!reported.contains("pipe") && !reported.contains("panicked"), "{reported}");
    }
    assert!(directory.path().join("merged/summary.json").exists());
}

fn write_bag(directory: &Path, record: &RigRecord, model_yaml: &str, with_cell: bool) -> String {
    let provenance = Provenance { model_yaml: model_yaml.to_owned(), ..Provenance::default() };
    let mut bag = BagWriter::create(
        directory,
        &BagOptions { provenance: Some(provenance), ..BagOptions::default() },
    )
    .unwrap();
    let qos = OfferedQos::reliable(100);
    let encoder = bag.add_topic::<JointState>(topics::ENCODER, &qos).unwrap();
    let cell = with_cell.then(|| bag.add_topic::<WrenchStamped>(topics::FORCE_CELL, &qos).unwrap());
    for ((time, position), force) in record.time.iter().zip(&record.position).zip(&record.force) {
        let stamp = (time * 1e9).round() as i64;
        let header = Header::new(stamp, "stage");
        let state = JointState {
            header: header.clone(),
            name: vec![topics::JOINT.to_owned()],
            position: vec![*position],
            ..JointState::default()
        };
        bag.write(encoder, stamp as u64, &state).unwrap();
        if let Some(cell) = cell {
            bag.write(cell, stamp as u64, &WrenchStamped::along_x(header, *force)).unwrap();
        }
    }
    bag.finish().unwrap();
    directory.display().to_string()
}

/// Runs of the rig by the commands that docs/tutorials/choose-a-guide.md names; the bags of the
/// Stribeck runs and of the loops.
fn measured(directory: &Path, guide: &str) -> (String, String) {
    let out = |name: &str| directory.join(format!("{guide}_{name}")).display().to_string();
    let (runs, loops) = (out("runs"), out("loops"));
    let (code, _, stderr) = run(&["experiment", "stribeck", "--guides", guide, "--out", &runs]);
    assert_eq!(code, 0, "{stderr}");
    let (code, _, stderr) =
        run(&["experiment", "dahl", "--guides", guide, "--amplitudes", "420e-6", "--out", &loops]);
    assert_eq!(code, 0, "{stderr}");
    (format!("{runs}/bags/{guide}_stribeck"), format!("{loops}/bags/{guide}_dahl"))
}

#[test]
fn a_guide_goes_from_the_rig_through_bags_into_the_catalogue_and_is_chosen_from_it() {
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name);
    let (stribeck, loops) = measured(directory.path(), "guide_1");
    let dahl = format!("{loops}_quick");
    let out = at("fitted.yaml").display().to_string();
    let fit = |stribeck: &str, more: &[&str]| {
        let mut arguments =
            vec!["fit-guide", "--stribeck", stribeck, "--dahl", &dahl, "--out", &out];
        arguments.extend(more);
        run(&arguments)
    };
    let record = RigRecord { time: vec![0.0, 1e-3], position: vec![0.0; 2], force: vec![0.0; 2] };
    let yaml = StageModel::measuring_rig("guide_1").unwrap().to_yaml().unwrap();
    let blind = write_bag(&at("blind"), &record, &yaml, false);
    let (code, _, stderr) = fit(&blind, &[]);
    assert!(
        code == 1
            && stderr.contains("/stage/force_cell")
            && stderr.contains("it has /stage/encoder"),
        "{stderr}"
    );
    let massless = write_bag(&at("massless"), &record, "", true);
    let (code, _, stderr) = fit(&massless, &[]);
    assert!(code == 1 && stderr.contains("--mass"), "{code} {stderr}");
    let (code, _, stderr) = fit(&dahl, &[]);
    assert!(code == 1 && stderr.contains("runs at constant velocity"), "{code} {stderr}");

    let (code, stdout, stderr) =
        fit(&stribeck, &["--name", "fitted", "--seals", "--cage", "--lubricant", "standard"]);
    assert_eq!(code, 0, "{stdout}{stderr}");
    let fitted = Catalogue::load(Path::new(&out)).unwrap();
    assert_near(&fitted, "fitted", "guide_1", 6);
    let (code, _, stderr) = fit(&stribeck, &[]);
    assert!(code == 2 && stderr.contains("exists already"), "{code} {stderr}");

    let application = config("application_fine_step_sealed.yaml");
    let place = at("choice").display().to_string();
    let (_, stdout, stderr) = run(&[
        "select",
        "--application",
        &application,
        "--catalogue",
        &out,
        "--guides",
        "fitted,guide_3",
        "--variants",
        "12",
        "--out",
        &place,
        "--json",
    ]);
    let summary: serde_json::Value =
        serde_json::from_str(&stdout).unwrap_or_else(|error| panic!("{error}: {stderr}"));
    assert_eq!(summary["choice"], "fitted");
}

/// Parameters of a fitted guide within 3 % of those of the catalogue, and `least` of them inside of
/// their intervals.
fn assert_near(fitted: &Catalogue, name: &str, truth: &str, least: usize) {
    let builtin = Catalogue::builtin();
    let (found, truth) = (fitted.entry(name).unwrap(), builtin.entry(truth).unwrap());
    let pairs = [
        (&found.stiffness, &truth.stiffness),
        (&found.bristle_damping, &truth.bristle_damping),
        (&found.viscous_friction, &truth.viscous_friction),
        (&found.coulomb_force, &truth.coulomb_force),
        (&found.static_force, &truth.static_force),
        (&found.stribeck_velocity, &truth.stribeck_velocity),
    ];
    let mut inside = 0;
    for (found, truth) in pairs {
        assert!((found.value / truth.value - 1.0).abs() < 0.03, "{found:?}, {truth:?}");
        inside +=
            usize::from(found.ci95.is_some_and(|[low, high]| (low..=high).contains(&truth.value)));
    }
    assert!(inside >= least, "{inside} of 6: {found:?}");
}

/// The damping hides in slow loops, which must be said; in quick ones it shows.
#[test]
fn loops_too_slow_for_the_damping_are_told() {
    let directory = tempfile::tempdir().unwrap();
    let (stribeck, loops) = measured(directory.path(), "guide_2");
    let fit = |dahl: &str, name: &str| {
        let out = directory.path().join(name);
        let (code, stdout, stderr) = run(&[
            "fit-guide",
            "--stribeck",
            &stribeck,
            "--dahl",
            dahl,
            "--out",
            out.to_str().unwrap(),
        ]);
        assert!(stdout.contains("bristle_damping"), "{stderr}");
        (code, stdout, Catalogue::load(&out).unwrap())
    };
    let (code, stdout, quick) = fit(&format!("{loops}_quick"), "quick.yaml");
    assert_eq!(code, 0, "{stdout}");
    // Guide 2 has no Stribeck effect: its velocity has no interval, and of the other five one may
    // miss.
    assert_near(&quick, "quick", "guide_2", 4);
    let (code, stdout, _) = fit(&format!("{loops}_420um"), "slow.yaml");
    assert!(code == 3 && stdout.contains("make the loops quicker"), "{code} {stdout}");
}
