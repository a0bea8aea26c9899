//! Bags whose topics are shared by several joints: no joint has the values of another.

use friction_stage_data::bag::{BagOptions, BagWriter, OfferedQos};
use friction_stage_data::message::{Header, JointState};
use friction_stage_data::signals::{Mapping, Recording, SignalError, load};

const ROWS: i64 = 400;

/// A bag in which message `k` names these joints, at 1 kHz; each joint has a position of its own:
/// that of `joint` in row k is its place in the alphabet plus k micrometres.
fn read(names: impl Fn(i64) -> Vec<&'static str>, mapping: &str) -> Result<Recording, SignalError> {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("bag");
    let mut bag = BagWriter::create(&path, &BagOptions::default()).unwrap();
    let topic = bag.add_topic::<JointState>("/joint_states", &OfferedQos::reliable(10)).unwrap();
    for k in 0..ROWS {
        let names = names(k);
        let position = names.iter().map(|name| position(name, k)).collect();
        let name = names.iter().map(|name| (*name).to_owned()).collect();
        let header = Header::new(k * 1_000_000, "");
        let state = JointState { header, name, position, ..JointState::default() };
        bag.write(topic, (k * 1_000_000) as u64, &state).unwrap();
    }
    bag.finish().unwrap();
    load(&path, Some(&Mapping::from_yaml(mapping, "mapping").unwrap()))
}

fn position(name: &str, k: i64) -> f64 {
    f64::from(name.as_bytes()[0]) + 1e-6 * k as f64
}

const SIGNALS: &str = "signals: {position: {topic: /joint_states, field: \"position[joint]\"}}";

fn asked(joint: &str) -> String {
    format!("joint: {joint}\n{SIGNALS}")
}

fn assert_is(recording: &Recording, joint: &str) {
    let trace = &recording.trace;
    let first = trace.origin_ns as f64 * 1e-6;
    for (time, x) in trace.time.iter().zip(&trace.position) {
        let wanted = position(joint, (first + 1e3 * time).round() as i64);
        assert!(x.is_nan() || (x - wanted).abs() < 1e-7, "{time} s: {x}, not {wanted}");
    }
    assert!(trace.position.iter().filter(|x| x.is_finite()).count() > 10);
}

fn error(result: Result<Recording, SignalError>) -> String {
    result.map(|recording| recording.trace.len()).unwrap_err().to_string()
}

#[test]
fn broadcasters_that_share_a_topic_are_told_apart() {
    let turns = |k: i64| if k % 2 == 0 { vec!["x_axis"] } else { vec!["gripper"] };
    assert_is(&read(turns, &asked("x_axis")).unwrap(), "x_axis");
    assert_is(&read(turns, &asked("gripper")).unwrap(), "gripper");
    let both = |k: i64| if k % 2 == 0 { vec!["gripper", "x_axis"] } else { vec!["gripper"] };
    assert_is(&read(both, &asked("x_axis")).unwrap(), "x_axis");
    let ours = |k: i64| if k % 3 == 0 { vec!["stage"] } else { vec!["stage", "gripper"] };
    assert_is(&read(ours, SIGNALS).unwrap(), "stage");
}

#[test]
fn a_joint_that_is_nowhere_is_an_error_that_names_those_that_are() {
    let message = error(read(|_| vec!["gripper"], &asked("x_axis")));
    assert!(message.contains("no joint x_axis") && message.contains("gripper"), "{message}");
    let message = error(read(|_| vec!["left", "right"], SIGNALS));
    assert!(message.contains("left, right"), "{message}");
}

#[test]
fn the_only_joint_counts_where_nobody_asked_for_one() {
    assert_is(&read(|_| vec!["x_axis"], SIGNALS).unwrap(), "x_axis");
    let turns = |k: i64| if k % 2 == 0 { vec!["x_axis"] } else { vec!["gripper"] };
    let message = error(read(turns, SIGNALS));
    assert!(message.contains("x_axis and gripper") && message.contains("`joint`"), "{message}");
}
