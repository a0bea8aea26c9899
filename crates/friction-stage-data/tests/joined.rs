//! Signals of one motion that stand in two files with clocks of their own.

use std::collections::BTreeMap;
use std::path::Path;

use friction_stage_data::signals::{
    Mapping, Proposal, Recording, SignalError, Window, import, load, load_part,
};

const ROWS: usize = 4000;
const RATE: f64 = 1000.0;
/// Of the second file.
const CELL_RATE: f64 = 640.0;
/// What the second file's clock shows when that of the first shows 0, s.
const LEAD: f64 = 7.25;

fn position(t: f64) -> f64 {
    0.05 * (3.0 * t).sin()
}

/// Of the interval that begins at row `k`.
fn command(k: i64) -> f64 {
    12.0 * (2.0 * k as f64 / RATE).sin()
}

/// The command of the interval that ends at a time, or that it is in, and what the guides bring.
fn cell(t: f64) -> f64 {
    command((t * RATE - 1e-6).ceil() as i64 - 1) + 20.0 * (5.0 * t).cos()
}

/// `drive.csv` with position and command, and the force cell in `cell.txt` as another tool writes
/// it.
fn two_files(directory: &Path) -> std::path::PathBuf {
    let mut drive = "t,x,u\n".to_owned();
    for k in 0..ROWS {
        let t = k as f64 / RATE;
        drive += &format!("{t:.3},{:.9},{:.6}\n", position(t), command(k as i64));
    }
    let path = directory.join("drive.csv");
    std::fs::write(&path, drive).unwrap();
    let mut text = "Load cell 3\nTime [s];Force [N]\n".to_owned();
    let first = -(0.5 * CELL_RATE) as i64;
    for k in first..(4.5 * CELL_RATE) as i64 {
        let t = k as f64 / CELL_RATE;
        text += &format!("{:.7};{:.6}\n", t + LEAD, cell(t)).replace('.', ",");
    }
    std::fs::write(directory.join("cell.txt"), text).unwrap();
    path
}

fn mapping(clock_offset: f64) -> String {
    format!(
        "signals: {{time: {{column: t}}, position: {{column: x}}, force: {{column: u}}}}\n\
         join:\n\
         \x20 - file: cell.txt\n\
         \x20   clock_offset: {clock_offset}\n\
         \x20   signals: {{time: {{column: 1}}, force_cell: {{column: 2, unit: N}}}}\n"
    )
}

/// That the force cell of every row is that of its time.
fn assert_in_time(recording: &Recording, from: usize, rows: usize) {
    assert_eq!(recording.trace.len(), rows);
    assert!((recording.rate - RATE).abs() < 1e-6);
    for k in 0..rows {
        let t = (from + k) as f64 / RATE;
        assert!((recording.trace.position[k] - position(t)).abs() < 1e-8, "row {k}");
        // Between samples of a cell the command goes on; what is left lies on straight lines over
        // 1.6 ms, up to 20 N (5/s 1.6 ms)^2 / 8 beside.
        // In the first two rows nothing is known of the command before.
        let beside = (recording.trace.force_cell[k] - cell(t)).abs();
        assert!(k < 2 || beside < 2e-4, "row {k}: {beside} N");
    }
}

#[test]
fn the_signals_of_both_files_are_on_the_grid_of_the_position() {
    let directory = tempfile::tempdir().unwrap();
    let path = two_files(directory.path());
    let mapping = Mapping::from_yaml(&mapping(-LEAD), "m.yaml").unwrap();
    let recording = load(&path, Some(&mapping)).unwrap();
    assert_in_time(&recording, 0, ROWS);
    let of_cell = recording.quality.signals.iter().find(|q| q.place.contains("cell.txt")).unwrap();
    assert_eq!(of_cell.coverage, 1.0);
    // A part of it takes the same part of both.
    let window = Window { from: Some(1.0), to: Some(1.999), most: None };
    let part = load_part(&path, Some(&mapping), window).unwrap();
    assert_in_time(&part, 1000, 1000);
}

#[test]
fn a_bag_of_both_files_holds_the_same() {
    let directory = tempfile::tempdir().unwrap();
    let path = two_files(directory.path());
    let text = mapping(-LEAD);
    let mapping = Mapping::from_yaml(&text, "m.yaml").unwrap();
    let bag = directory.path().join("bag");
    let report = import(&path, &mapping, &BTreeMap::new(), &bag, &mut |_| {}).unwrap();
    assert_eq!(report.rows as usize, ROWS + (5.0 * CELL_RATE) as usize);
    assert_eq!((report.not_later, report.without_time), (0, 0));
    // The cell began half a second earlier, and the times of a bag are not negative.
    assert!((report.moved_s - 0.5).abs() < 1e-9, "{}", report.moved_s);
    let recording = load(&bag, None).unwrap();
    assert_in_time(&recording, 0, ROWS);
}

#[test]
fn clocks_without_a_time_in_common_are_told_with_both_times() {
    let directory = tempfile::tempdir().unwrap();
    let path = two_files(directory.path());
    for (offset, begins) in [(0.0, "6.75"), (-20.0, "-13.25")] {
        let mapping = Mapping::from_yaml(&mapping(offset), "m.yaml").unwrap();
        let error = load(&path, Some(&mapping)).unwrap_err();
        assert!(matches!(error, SignalError::NoTimeInCommon { .. }), "{error}");
        let message = error.to_string();
        for words in ["cell.txt", begins, "from 0 s to 3.999 s", "`clock_offset`"] {
            assert!(message.contains(words), "{message}, without {words}");
        }
    }
}

#[test]
fn a_mapping_for_both_files_is_proposed() {
    let directory = tempfile::tempdir().unwrap();
    let path = two_files(directory.path());
    let drive = Proposal::of(&path).unwrap();
    let taken: Vec<_> = drive.recorded().collect();
    let other = Proposal::beside(&directory.path().join("cell.txt"), &taken).unwrap();
    let proposed = drive.to_yaml("drive.csv", &[("cell.txt".to_owned(), other)]);
    assert!(proposed.contains("clock_offset: 0   # CHECK"), "{proposed}");
    let confirmed = proposed.replace("clock_offset: 0 ", &format!("clock_offset: -{LEAD} "));
    let recording = load(&path, Some(&Mapping::from_yaml(&confirmed, "m.yaml").unwrap())).unwrap();
    assert_in_time(&recording, 0, ROWS);
}

#[test]
fn joins_that_cannot_be_are_told_with_the_key() {
    let join = |entry: &str| {
        let text = format!("signals: {{position: {{column: x}}}}\njoin: [{entry}]");
        Mapping::from_yaml(&text, "m.yaml").unwrap_err().to_string()
    };
    let cases: &[(&str, &[&str])] = &[
        ("{file: ../cell.csv, signals: {force: {column: f}}}", &["join[0].file", "below"]),
        ("{file: /cell.csv, signals: {force: {column: f}}}", &["join[0].file", "below"]),
        ("{file: c.csv, signals: {position: {column: f}}}", &["signals.position", "motion"]),
        ("{file: c.csv, signals: {time: {column: t}}}", &["join[0].signals", "none is wanted"]),
        ("{file: c.csv, signals: {force: {column: 0}}}", &["join[0].signals.force", "from 1"]),
        ("{file: c.csv, clock_offset: .nan, signals: {force: {column: f}}}", &["clock_offset"]),
        (
            "{file: c.csv, signals: {force: {column: f}}}, {file: d.csv, signals: {force: \
             {column: f}}}",
            &["join[1].signals.force", "twice"],
        ),
        ("{fil: c.csv, signals: {}}", &["did you mean `file`"]),
    ];
    for (entry, expected) in cases {
        let message = join(entry);
        for words in *expected {
            assert!(message.contains(words), "{entry} gave {message}, without {words}");
        }
    }
}

#[test]
fn a_bag_is_not_made_of_files_without_a_time_in_common() {
    let directory = tempfile::tempdir().unwrap();
    let path = two_files(directory.path());
    let mapping = Mapping::from_yaml(&mapping(1000.0), "m.yaml").unwrap();
    let bag = directory.path().join("bag");
    let reported = import(&path, &mapping, &BTreeMap::new(), &bag, &mut |_| {}).unwrap_err();
    assert!(reported.to_string().contains("no time in common"), "{reported}");
    assert!(!bag.exists());
}
