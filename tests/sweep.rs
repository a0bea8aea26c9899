//! `sweep` at the process boundary: results, shards, resume, messages and exit codes.

use std::path::Path;

use friction_stage_core::model::StageModel;
use friction_stage_lab::PaperMotion;

mod program;

use program::run;

/// A sweep of a short move into `directory/name`.
fn sweep(directory: &Path, name: &str, axes: &[&str], more: &[&str]) -> (i32, String, String) {
    let motion = directory.join("short.yaml").display().to_string();
    if !Path::new(&motion).exists() {
        let points = PaperMotion::of_moves(0.01, &[(1e-5, 0.003, 0.02)]).unwrap().points;
        let text = friction_stage_identify::next_experiment::trajectory_yaml(&points, "stage", &[]);
        std::fs::write(&motion, text).unwrap();
    }
    let out = directory.join(name).display().to_string();
    let fixed = ["sweep", "--motion", &motion, "--model", "guide_2", "--out", &out];
    run(&[&fixed[..], axes, more].concat())
}

const FILES: [&str; 5] = ["plan.yaml", "points.csv", "points.parquet", "summary.json", "sweep.svg"];

fn bytes(directory: &Path) -> Vec<Vec<u8>> {
    FILES
        .map(|name| std::fs::read(directory.join(name)).unwrap_or_else(|e| panic!("{name}: {e}")))
        .into()
}

#[test]
fn a_grid_over_the_model_and_the_controller_gives_a_row_for_each_point() {
    let home = tempfile::tempdir().unwrap();
    let axes = ["model.mass=20,40", "controller.bandwidth=30:60:2"];
    let (code, stdout, stderr) = sweep(home.path(), "grid", &axes, &["--json"]);
    assert_eq!(code, 0, "{stderr}");
    let summary: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!((summary["points"].as_u64(), summary["failed"].as_u64()), (Some(4), Some(0)));
    let peak = |row: usize| summary["rows"][row]["result"]["peak_error"].as_f64().unwrap();
    assert!(peak(1) < peak(0) && peak(3) < peak(2), "{stdout}");
    let mut table = csv::Reader::from_path(home.path().join("grid/points.csv")).unwrap();
    assert_eq!(&table.headers().unwrap()[2], "model.mass");
    let rows: Vec<csv::StringRecord> = table.records().map(Result::unwrap).collect();
    let values = |row: &csv::StringRecord| (row[2].to_owned(), row[3].to_owned());
    assert_eq!(values(&rows[1]), ("20.0".to_owned(), "60.0".to_owned()));
    let place = table.headers().unwrap().iter().position(|c| c == "peak_error_m").unwrap();
    for (index, row) in rows.iter().enumerate() {
        assert_eq!(row[place].parse::<f64>().unwrap(), peak(index));
    }
    let figure = std::fs::read_to_string(home.path().join("grid/sweep.svg")).unwrap();
    assert!(figure.contains("over bandwidth of the controller"));
    assert!(!figure.contains("controller.bandwidth"));
}

#[test]
fn shards_in_any_order_and_a_resumed_run_are_one_run_bit_for_bit() {
    let home = tempfile::tempdir().unwrap();
    let at = |name: &str| home.path().join(name);
    let axes = ["model.guides.stiffness=lognormal(17e6,0.1)", "model.mass=30,40"];
    let of = |name: &str, more: &[&str]| {
        sweep(home.path(), name, &axes, &[&["--samples", "20"], more].concat())
    };
    assert_eq!(of("whole", &[]).0, 0);
    for shard in ["2/3", "3/3", "1/3"] {
        let (code, stdout, stderr) = of(&shard.replace('/', "_of_"), &["--shard", shard]);
        assert!(code == 0 && stdout.contains(&format!("shard {shard} of 40")), "{stderr}");
    }
    let path = |name: &str| at(name).display().to_string();
    let (code, _, stderr) =
        run(&["merge", &path("2_of_3"), &path("1_of_3"), "--out", &path("missing")]);
    assert!(code == 1 && stderr.contains("1 of 3 shards missing: 3/3"), "{stderr}");
    let parts = [path("2_of_3"), path("3_of_3"), path("1_of_3"), path("merged")];
    let (code, _, stderr) = run(&["merge", &parts[0], &parts[1], &parts[2], "--out", &parts[3]]);
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(bytes(&at("merged")), bytes(&at("whole")));

    // As a killed process leaves it: some rows, the last one torn.
    assert_eq!(of("cut", &[]).0, 0);
    let rows = at("cut/points.csv");
    let text = std::fs::read_to_string(&rows).unwrap();
    std::fs::write(&rows, &text[..text.len() / 2]).unwrap();
    let (code, _, stderr) = of("cut", &[]);
    assert!(code == 2 && stderr.contains("holds a sweep already"), "{stderr}");
    let (code, _, stderr) = of("cut", &["--resume", "--seed", "9"]);
    assert!(code == 2 && stderr.contains("seed: 1") && stderr.contains("seed: 9"), "{stderr}");
    assert_eq!(of("cut", &["--resume"]).0, 0);
    assert_eq!(bytes(&at("cut")), bytes(&at("whole")));
    let (code, _, stderr) = of("cut", &["--force", "--seed", "9"]);
    assert_eq!(code, 0, "{stderr}");
    assert_ne!(bytes(&at("cut")), bytes(&at("whole")));
}

#[test]
fn parquet_holds_the_rows_of_the_csv() {
    use parquet::file::reader::{FileReader, SerializedFileReader};
    use parquet::record::RowAccessor;
    let home = tempfile::tempdir().unwrap();
    let axes = ["model.guides=guide_1,guide_2", "model.mass=-1,40"];
    let (code, _, stderr) = sweep(home.path(), "out", &axes, &[]);
    assert_eq!(code, 3, "{stderr}");
    let file = std::fs::File::open(home.path().join("out/points.parquet")).unwrap();
    let reader = SerializedFileReader::new(file).unwrap();
    let mut table = csv::Reader::from_path(home.path().join("out/points.csv")).unwrap();
    let mut count = 0;
    for (row, record) in reader.get_row_iter(None).unwrap().zip(table.records()) {
        let (row, record) = (row.unwrap(), record.unwrap());
        assert_eq!(row.get_ulong(0).unwrap().to_string(), record[0]);
        assert_eq!(row.get_string(2).unwrap(), &record[2]);
        assert_eq!(row.get_double(3).unwrap(), record[3].parse::<f64>().unwrap());
        match record[4].parse::<f64>() {
            Ok(peak) => assert_eq!(row.get_double(4).unwrap(), peak),
            Err(_) => assert!(record[11].contains("model.mass is -1"), "{record:?}"),
        }
        count += 1;
    }
    assert_eq!(count, 4);
}

#[test]
fn bad_input_is_said_with_the_right_code() {
    let home = tempfile::tempdir().unwrap();
    let model = home.path().join("own.yaml");
    std::fs::write(&model, StageModel::on_guides("guide_1").to_yaml().unwrap()).unwrap();
    for (index, (axes, more, code, words)) in [
        (&["model.mas=1"][..], &[][..], 2, "did you mean `model.mass`"),
        (&["mass=1"], &[], 2, "did you mean `model.mass`"),
        (&["model.mass=1:2"], &[], 2, "from:to:count"),
        (&["model.mass=normal(40,1)"], &[], 2, "--samples"),
        (&["model.mass=-1"], &[], 1, "none of the 1 points"),
        (&["model.effects.cogging.amplitude=1"], &[], 2, "there is no key"),
        (&["model.mass=1"], &["--shard", "4/3"], 2, "i/n"),
        (&[], &[], 2, "KEY=VALUES"),
        (&["motion.stretch=0"], &[], 1, "motion.stretch is 0"),
        (&["motion.distance=1"], &[], 2, "there are stretch"),
    ]
    .into_iter()
    .enumerate()
    {
        let (found, _, stderr) = sweep(home.path(), &format!("out_{index}"), axes, more);
        assert_eq!(found, code, "{axes:?}: {stderr}");
        assert!(stderr.contains(words), "{axes:?} gave {stderr:?}, without {words:?}");
    }
    let out = home.path().join("no").display().to_string();
    let (code, _, stderr) = run(&["sweep", "model.mass=1", "--motion", "fin", "--out", &out]);
    assert!(code == 2 && stderr.contains("fine-step"), "{stderr}");
    let missing = "nowhere.yaml";
    let (code, _, stderr) = run(&["sweep", "model.mass=1", "--model", missing, "--out", &out]);
    assert!(code == 1 && stderr.contains("nowhere.yaml") && !Path::new(&out).exists(), "{stderr}");
}
