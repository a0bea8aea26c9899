//! Each reader of foreign bytes as a function of them. What it says does not matter, as long as it
//! says something.

use std::path::Path;

use clap::Parser;
use friction_stage::cli::Arguments;
use friction_stage::node::arguments::RosArguments;
use friction_stage_core::control::{Follower, Reference, Trajectory};
use friction_stage_core::model::{Catalogue, StageModel};
use friction_stage_core::plant::{Rates, Stage};
use friction_stage_data::bag::{BagReader, recover};
use friction_stage_data::message::{
    Clock, ControllerState, DiagnosticArray, Float64MultiArray, JointCommand, JointState,
    JointTrajectory, RosMessage, StageState, WrenchStamped, field_value, from_cdr, to_cdr,
};
use friction_stage_data::motion_file;
use friction_stage_data::quality::RecordingCheck;
use friction_stage_data::signals::{Mapping, Proposal, Window};
use friction_stage_data::wire::{Setpoint, setpoint};
use friction_stage_lab::Application;

use crate::running_node;

/// A reader of bytes; the directory is one that it may write to.
pub type Target = fn(&[u8], &Path);

/// The targets by the name of their corpus.
pub const TARGETS: [(&str, Target); 14] = [
    ("mcap", mcap),
    ("sqlite", sqlite),
    ("metadata", metadata),
    ("cdr", cdr),
    ("definition", definition),
    ("model", model),
    ("catalogue", catalogue),
    ("mapping", mapping),
    ("csv", csv),
    ("arrays", arrays),
    ("motion", motion),
    ("trajectory", trajectory),
    ("arguments", arguments),
    ("rtps", running_node::rtps),
];

/// Whether a target works on a file, which takes longer.
pub fn needs_file(name: &str) -> bool {
    ["mcap", "sqlite", "metadata", "csv", "arrays"].contains(&name)
}

fn written(bytes: &[u8], directory: &Path, name: &str) -> std::path::PathBuf {
    let path = directory.join(name);
    std::fs::write(&path, bytes).expect("the directory takes files");
    path
}

fn recording(path: &Path, directory: &Path) {
    let _ = RecordingCheck::new(path, None, Window::default(), None, &mut |_| {});
    if let Ok(reader) = BagReader::open(path) {
        let _ = reader.model();
        let _ = reader.verify_checksums();
        // What was recovered is whole.
        let out = directory.join("recovered");
        if let Ok(report) = recover(path, Some(&out))
            && let Some(output) = report.output
        {
            let reader = BagReader::open(output).expect("what was recovered opens");
            assert!(reader.is_complete(), "what was recovered is complete");
            assert_eq!(reader.messages().filter_map(Result::ok).count() as u64, report.messages);
        }
        let _ = std::fs::remove_dir_all(&out);
    }
}

fn mcap(bytes: &[u8], directory: &Path) {
    recording(&written(bytes, directory, "bag.mcap"), directory);
}

fn sqlite(bytes: &[u8], directory: &Path) {
    recording(&written(bytes, directory, "bag.db3"), directory);
}

/// A bag whose metadata these bytes are; its file is an empty one.
fn metadata(bytes: &[u8], directory: &Path) {
    let bag = directory.join("bag");
    std::fs::create_dir_all(&bag).expect("the directory takes directories");
    written(bytes, &bag, "metadata.yaml");
    written(include_bytes!("../corpus/mcap/empty.mcap"), &bag, "bag_0.mcap");
    let _ = RecordingCheck::new(&bag, None, Window::default(), None, &mut |_| {});
}

/// The first byte says which type.
fn cdr(bytes: &[u8], _: &Path) {
    fn both_ways<M: RosMessage>(bytes: &[u8]) {
        let Ok(message) = from_cdr::<M>(bytes) else { return };
        let written = to_cdr(&message).expect("what was decoded encodes");
        let again = from_cdr::<M>(&written).expect("what was encoded decodes");
        assert_eq!(to_cdr(&again).expect("as before"), written);
    }
    let Some((kind, bytes)) = bytes.split_first() else { return };
    match kind % 9 {
        0 => both_ways::<JointState>(bytes),
        1 => both_ways::<JointTrajectory>(bytes),
        2 => both_ways::<WrenchStamped>(bytes),
        3 => both_ways::<Float64MultiArray>(bytes),
        4 => both_ways::<DiagnosticArray>(bytes),
        5 => both_ways::<StageState>(bytes),
        6 => both_ways::<ControllerState>(bytes),
        7 => both_ways::<JointCommand>(bytes),
        _ => both_ways::<Clock>(bytes),
    }
}

/// A definition, a path and a message, separated by zeros.
fn definition(bytes: &[u8], _: &Path) {
    let mut parts = bytes.splitn(3, |byte| *byte == 0);
    let mut text = || String::from_utf8_lossy(parts.next().unwrap_or_default()).into_owned();
    let (definition, path) = (text(), text());
    let message = parts.next().unwrap_or_default();
    for path in [path.as_str(), "header.stamp", "position[joint]"] {
        let _ = field_value("a_msgs/msg/A", &definition, path, "stage", message);
    }
}

fn text(bytes: &[u8]) -> std::borrow::Cow<'_, str> {
    String::from_utf8_lossy(bytes)
}

/// A model that is taken can be written, and its stage stays finite.
fn model(bytes: &[u8], _: &Path) {
    let Ok(model) = StageModel::from_yaml(&text(bytes), "the input") else { return };
    let written = model.to_yaml().expect("a model is written");
    assert_eq!(StageModel::from_yaml(&written, "what was written").as_ref().ok(), Some(&model));
    let Ok(mut stage) = Stage::new(&model, Rates::DEFAULT, 1) else { return };
    for step in 0..40 {
        let sample = stage.sample();
        assert!(
            sample.position.is_finite() && sample.force_cell.is_finite(),
            "at {step}: {written}"
        );
        stage.advance(if step < 20 { 1e3 } else { -1e3 });
    }
}

fn catalogue(bytes: &[u8], _: &Path) {
    let text = text(bytes);
    if let Ok(catalogue) = Catalogue::from_yaml(&text, "the input") {
        let written = catalogue.to_yaml().expect("a catalogue is written");
        Catalogue::from_yaml(&written, "what was written").expect("and read");
    }
    let _ = Application::from_yaml(&text, "the input");
}

fn mapping(bytes: &[u8], _: &Path) {
    let _ = Mapping::from_yaml(&text(bytes), "the input");
}

fn table(path: &Path) {
    let _ = RecordingCheck::new(path, None, Window::default(), None, &mut |_| {});
    if let Ok(proposal) = Proposal::of(path)
        && let Ok(mapping) = Mapping::from_yaml(&proposal.to_yaml("table", &[]), "the proposal")
    {
        let _ = RecordingCheck::new(path, Some(&mapping), Window::default(), None, &mut |_| {});
    }
}

fn csv(bytes: &[u8], directory: &Path) {
    table(&written(bytes, directory, "table.csv"));
}

/// The name says no more than that it is one of arrays.
fn arrays(bytes: &[u8], directory: &Path) {
    table(&written(bytes, directory, "table.npz"));
}

/// Whatever of a trajectory is not refused is finite, on its points and between them.
fn followed(trajectory: &Trajectory) {
    let (start, end) = (trajectory.start(), trajectory.end());
    assert!(end >= start);
    let mut follower = Follower::new(f64::MAX);
    if follower.follow(start, trajectory.clone()).is_err() {
        return;
    }
    for part in 0..=100 {
        let time = start + ((end - start) as f64 * f64::from(part) / 100.0) as i64;
        let Reference { position, velocity, acceleration, effort } = follower.at(time);
        let all = [position, velocity, acceleration, effort];
        assert!(all.iter().all(|value| value.is_finite()), "{all:?} at {time} ns");
    }
}

fn motion(bytes: &[u8], _: &Path) {
    let Ok(points) = motion_file::from_yaml(&text(bytes), "the input") else { return };
    followed(&Trajectory::new(0, points.clone()).expect("as it was checked"));
    let _ = Trajectory::new(0, motion_file::stretched(&points, 1e3));
}

fn trajectory(bytes: &[u8], _: &Path) {
    let Ok(message) = from_cdr::<JointTrajectory>(bytes) else { return };
    match setpoint(&message, "stage", 1_000_000_000) {
        Ok(Setpoint::Motion(trajectory)) => followed(&trajectory),
        Ok(Setpoint::Now(Reference { position, .. })) => assert!(position.is_finite()),
        Err(_) => {}
    }
}

/// One argument a line; a parameter file is what comes after an empty one.
fn arguments(bytes: &[u8], _: &Path) {
    let text = text(bytes);
    let (line, file) = text.split_once("\n\n").unwrap_or((&text, ""));
    let arguments = || line.lines().map(str::to_owned);
    let _ = RosArguments::parse_with(arguments(), |_| Ok(file.to_owned()));
    let all = ["friction-stage".to_owned()].into_iter().chain(arguments());
    let _ = Arguments::try_parse_from(all);
}
