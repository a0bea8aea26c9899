//! Ctrl-C in every long command: exit 130, a word on what is kept, no empty directory, and what can
//! be continued is continued.
//!
//! Each command is interrupted in its work: after it has opened its input, after its first log line
//! on stderr, or after the first file of its results. `identify`, which ends with a partial report,
//! is in `identify_report.rs`.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

fn program(directory: &Path, arguments: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .args(arguments)
        .current_dir(directory)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap()
}

fn interrupt(child: &Child) {
    // SAFETY: the child has not been waited for, so that its number is its own.
    assert_eq!(unsafe { libc::kill(child.id() as i32, libc::SIGINT) }, 0);
}

/// Interrupts a command and returns what it says; it must end with 130.
fn interrupted(mut child: Child, what: &str) -> String {
    interrupt(&child);
    let mut said = String::new();
    child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
    assert_eq!(child.wait().unwrap().code(), Some(130), "{what}: {said}");
    said
}

/// Waits until a command says something that contains `words`, in a log line on stderr.
fn wait_for_line(child: &mut Child, words: &str) {
    let mut stderr = BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    loop {
        line.clear();
        assert!(stderr.read_line(&mut line).unwrap() > 0, "ended without a line with {words}");
        if line.contains(words) {
            break;
        }
    }
    child.stderr = Some(stderr.into_inner());
}

/// Waits until a file of the results is there.
fn wait_for_file(child: &mut Child, is_there: impl Fn() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(120);
    while !is_there() {
        assert!(child.try_wait().unwrap().is_none(), "ended before its first result");
        assert!(Instant::now() < deadline, "no result");
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn files_in(directory: &Path) -> Vec<PathBuf> {
    let mut all = Vec::new();
    for entry in std::fs::read_dir(directory).into_iter().flatten().flatten() {
        match entry.path().is_dir() {
            true => {
                let inner = files_in(&entry.path());
                assert!(!inner.is_empty(), "{} is empty", entry.path().display());
                all.extend(inner);
            }
            false => all.push(entry.path()),
        }
    }
    all
}

/// A table that takes long to read.
fn long_table(path: &Path) {
    let mut table = std::io::BufWriter::new(std::fs::File::create(path).unwrap());
    writeln!(table, "time,position,force").unwrap();
    for k in 0..3_000_000u64 {
        let time = k as f64 * 1e-3;
        writeln!(table, "{time:.3},{:.9},{:.4}", 0.01 * (6.0 * time).sin(), 5.0).unwrap();
    }
}

#[test]
fn a_sweep_keeps_its_points_and_goes_on() {
    let home = tempfile::tempdir().unwrap();
    let axes = "model.mass=normal(40,1)";
    let out = ["--samples", "2000", "--out"];
    let short = "motion.conditioning.rest=0.0,0.01";
    let sweep = |name: &str, more: &[&str]| {
        program(home.path(), &[&["sweep", axes, short][..], &out, &[name], more].concat())
    };
    let mut child = sweep("cut", &[]);
    let rows = home.path().join("cut/points.csv");
    wait_for_file(&mut child, || std::fs::metadata(&rows).is_ok_and(|file| file.len() > 0));
    let said = interrupted(child, "sweep");
    let done = std::fs::read_to_string(&rows).unwrap().lines().count() - 1;
    assert!(said.contains(&format!("after {done} of 4000 points")), "{said}");
    assert!(done < 4000 && said.contains("--resume"), "{said}");
    assert!(sweep("cut", &["--resume"]).wait().unwrap().success());
    assert!(sweep("whole", &[]).wait().unwrap().success());
    let read = |name: &str| std::fs::read(home.path().join(name)).unwrap();
    assert_eq!(read("cut/points.csv"), read("whole/points.csv"));
}

#[test]
fn an_experiment_keeps_what_it_has_measured_and_goes_on_to_the_same_summary() {
    let home = tempfile::tempdir().unwrap();
    let guides = ["--guides", "guide_1", "--rest", "0.5", "--no-bags", "--out"];
    let paper = |name: &str, more: &[&str]| {
        program(home.path(), &[&["experiment", "paper"][..], &guides, &[name], more].concat())
    };
    let mut child = paper("cut", &[]);
    let part = home.path().join("cut/parts/guide_1_stribeck.json");
    wait_for_file(&mut child, || part.exists());
    let said = interrupted(child, "experiment");
    assert!(said.contains("cut holds parts") && said.contains("--resume"), "{said}");
    assert!(said.contains("guide_1_stribeck"), "{said}");
    let ended = |mut child: Child| {
        let mut said = String::new();
        child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        (child.wait().unwrap().code(), said)
    };
    let (code, said) = ended(paper("cut", &[]));
    assert!(code == Some(2) && said.contains("--resume"), "{said}");
    let (code, said) = ended(paper("cut", &["--resume", "--seed", "9"]));
    assert!(code == Some(2) && said.contains("other arguments"), "{said}");
    assert_eq!(ended(paper("cut", &["--resume"])).0, Some(3));
    assert_eq!(ended(paper("whole", &[])).0, Some(3));
    let read = |name: &str| std::fs::read_to_string(home.path().join(name)).unwrap();
    assert_eq!(read("cut/summary.json"), read("whole/summary.json"));
    let page = |name: &str| {
        let page = read(name);
        // What follows says when and by which command it was made.
        let (body, made_by) = page.split_once("<footer>").expect("who made it");
        assert!(made_by.contains("friction-stage experiment paper"), "{made_by}");
        body.to_owned()
    };
    assert_eq!(page("cut/report.html"), page("whole/report.html"));
    assert!(!home.path().join("cut/parts").exists());
}

#[test]
fn the_nodes_of_a_run_end_with_it_and_its_bag_is_kept() {
    let home = tempfile::tempdir().unwrap();
    let moves = [(1e-3, 0.1, 3000.0)];
    let points = friction_stage_lab::PaperMotion::of_moves(0.05, &moves).unwrap().points;
    let text = friction_stage_identify::next_experiment::trajectory_yaml(&points, "stage", &[]);
    std::fs::write(home.path().join("long.yaml"), text).unwrap();
    for (arguments, bag) in [
        (&["play", "long.yaml", "--record", "run"][..], "run"),
        (&["demo", "--rest", "3000", "--guides", "guide_2", "--out", "demo"], "demo/guide_2"),
    ] {
        let mut child = program(home.path(), arguments);
        let recorded = home.path().join(bag);
        wait_for_file(&mut child, || {
            let files = std::fs::read_dir(&recorded).into_iter().flatten().flatten();
            files.filter_map(|file| file.metadata().ok()).any(|file| file.len() > 50_000)
        });
        let said = interrupted(child, arguments[0]);
        assert!(said.contains("holds"), "{said}");
        // Recorded to its end, by a stage that ended in order.
        assert!(recorded.join("metadata.yaml").exists(), "{said}");
    }
    files_in(home.path());
}

/// Waits until a command has a file open.
fn wait_for_open(child: &mut Child, file: &Path) {
    let opened = PathBuf::from(format!("/proc/{}/fd", child.id()));
    wait_for_file(child, || {
        let entries = std::fs::read_dir(&opened).into_iter().flatten().flatten();
        entries.filter_map(|entry| std::fs::read_link(entry.path()).ok()).any(|link| link == file)
    });
}

#[test]
fn commands_that_keep_nothing_end_at_once_and_leave_no_empty_directory() {
    let home = tempfile::tempdir().unwrap();
    let at = |name: &str| home.path().canonicalize().unwrap().join(name);
    let whole = |arguments: &[&str], code: i32| {
        let mut child = program(home.path(), arguments);
        let mut said = String::new();
        child.stderr.take().unwrap().read_to_string(&mut said).unwrap();
        assert_eq!(child.wait().unwrap().code(), Some(code), "{arguments:?}: {said}");
    };
    long_table(&at("long.csv"));
    let mapping = "signals:\n  time: {column: time, unit: s}\n  position: {column: position, unit: \
                   m}\n  force: {column: force, unit: N}\n";
    std::fs::write(at("mapping.yaml"), mapping).unwrap();
    whole(&["import", "long.csv", "--mapping", "mapping.yaml", "--out", "big"], 0);
    // Points that are refused at once, so that there are many.
    whole(&["sweep", "model.mass=-2:-1:300000", "--out", "many"], 1);
    let (table, bag, rows) = ("long.csv", "big/big_0.mcap", "many/points.csv");
    for (arguments, opened) in [
        (&["check", "long.csv", "--mapping", "mapping.yaml"][..], table),
        (&["import", "long.csv", "--mapping", "mapping.yaml", "--out", "cut"], table),
        (&["recover", "big", "--out", "recovered"], bag),
        (&["replay", "big", "--model", "guide_1", "--csv", "replayed.csv"], bag),
        (&["view", "big", "--out", "view.html"], bag),
        (&["merge", "many", "--out", "merged"], rows),
    ] {
        let mut child = program(home.path(), arguments);
        wait_for_open(&mut child, &at(opened));
        let said = interrupted(child, arguments[0]);
        assert!(said.contains("interrupted; "), "{arguments:?}: {said}");
    }
    let moves = [(1e-3, 0.1, 3000.0)];
    let points = friction_stage_lab::PaperMotion::of_moves(0.05, &moves).unwrap().points;
    let text = friction_stage_identify::next_experiment::trajectory_yaml(&points, "stage", &[]);
    std::fs::write(at("long.yaml"), text).unwrap();
    for (arguments, line) in [
        (&["tune", "guide_2", "--variants", "1000000", "--out", "tuned"][..], "tuning"),
        (
            &[
                "compensate",
                "long.yaml",
                "--model",
                "guide_2",
                "--real",
                "guide_1",
                "--out",
                "both",
            ],
            "moving",
        ),
    ] {
        let mut child = program(home.path(), arguments);
        wait_for_line(&mut child, line);
        let said = interrupted(child, arguments[0]);
        assert!(said.contains("interrupted; nothing was written"), "{arguments:?}: {said}");
    }
    assert!(!at("tuned").exists() && !at("both").exists() && !at("view.html").exists());
    files_in(home.path());
}
