//! Two axes in one domain: each controller finds the stage of its own namespace, and a bag with a
//! namespace is checked, replayed and identified like any other.

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use friction_stage::node::domain::OwnDomain;
use friction_stage::node::outlet::Outlet;
use friction_stage::node::participant::{Network, Participant, Reach};
use friction_stage::node::qos::COMMANDS;
use friction_stage_core::control::Point;
use friction_stage_data::bag::BagReader;
use friction_stage_data::message::{ControllerState, JointTrajectory};
use friction_stage_data::signals::Trace;
use friction_stage_data::wire::joint_trajectory;

/// A node that is asked to end when dropped.
struct Node(Child);

impl Node {
    fn start(program: &str, domain: u16, axis: &str, parameters: &[&str]) -> Node {
        let mut command = Command::new(program);
        command
            .args(["--ros-args", "-r", &format!("__ns:=/{axis}")])
            .args(parameters.iter().flat_map(|parameter| ["-p", parameter]))
            .env("ROS_DOMAIN_ID", domain.to_string())
            .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
            .stdout(Stdio::null())
            .stderr(Stdio::null());
        Node(command.spawn().unwrap())
    }

    fn end(&mut self) -> Option<i32> {
        // SAFETY: the child has not been waited for, so that its number is its own.
        unsafe { libc::kill(self.0.id() as i32, libc::SIGINT) };
        self.0.wait().unwrap().code()
    }
}

impl Drop for Node {
    fn drop(&mut self) {
        if matches!(self.0.try_wait(), Ok(None)) {
            self.end();
        }
    }
}

/// States of the controller in a bag that is being recorded.
fn states(bag: &Path, topic: &str) -> Vec<ControllerState> {
    // It is cut off at any place.
    let Ok(reader) = BagReader::open(bag) else { return Vec::new() };
    let messages = reader.messages().filter_map(Result::ok);
    messages
        .filter(|message| message.topic.name == topic)
        .filter_map(|message| message.decode::<ControllerState>().ok())
        .collect()
}

/// Their references, m.
fn references(bag: &Path, topic: &str) -> Vec<f64> {
    states(bag, topic).iter().map(|state| state.reference_position).collect()
}

fn wait_for(what: &str, mut is_so: impl FnMut() -> bool) {
    let deadline = Instant::now() + Duration::from_secs(60);
    while !is_so() {
        assert!(Instant::now() < deadline, "{what} within a minute");
        std::thread::sleep(Duration::from_millis(50));
    }
}

/// Exit code, stdout and stderr.
fn run(arguments: &[&str]) -> (i32, String, String) {
    let Output { status, stdout, stderr } =
        Command::new(env!("CARGO_BIN_EXE_friction-stage")).args(arguments).output().unwrap();
    let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
    (status.code().unwrap_or(-1), text(stdout), text(stderr))
}

#[test]
fn each_controller_finds_its_stage_and_its_bag_is_read() {
    let home = tempfile::tempdir().unwrap();
    let domain = OwnDomain::take().unwrap();
    let (stage, controller) =
        (env!("CARGO_BIN_EXE_stage_node"), env!("CARGO_BIN_EXE_controller_node"));
    let bag = |axis: &str| home.path().join(axis);
    let mut nodes = Vec::new();
    for axis in ["x", "y"] {
        let record = format!("record:={}", bag(axis).display());
        let rate = "control_rate:=1000.0";
        nodes.push(Node::start(stage, domain.number(), axis, &["model:=guide_2", rate, &record]));
        nodes.push(Node::start(controller, domain.number(), axis, &["rate:=1000.0"]));
    }
    for axis in ["x", "y"] {
        let state = format!("/{axis}/controller/state");
        wait_for(&format!("{state} is recorded"), || references(&bag(axis), &state).len() > 100);
    }

    let network = Network { domain: domain.number(), reach: Reach::Localhost };
    let options =
        ros2_client::NodeOptions::new().start_parameter_services(false).enable_rosout(false);
    let participant = Participant::join(network, "/", "mover", options).unwrap();
    let mut setpoint =
        Outlet::<JointTrajectory>::new(&participant, "/x/stage/setpoint", &COMMANDS).unwrap();
    wait_for("stage and controller hear the setpoint", || {
        setpoint.wait_for_subscribers(2, Duration::from_millis(100)) >= 2
    });
    let target = Point::at_rest(0, 0.5e-3);
    let _ = setpoint.publish(joint_trajectory("stage", 0, &[target]));
    // The reference is there at once, and the stage a little later.
    wait_for("x moves", || {
        states(&bag("x"), "/x/controller/state").iter().any(|state| state.position > 0.45e-3)
    });
    for node in &mut nodes {
        let code = node.end();
        assert!(matches!(code, Some(0 | 3)), "{code:?}");
    }
    let y = references(&bag("y"), "/y/controller/state");
    assert!(y.len() > 100 && y.iter().all(|reference| *reference == 0.0));

    let trace = Trace::from_bag(bag("x")).unwrap();
    // On a busy machine a real-time loop overshoots.
    let reached = trace.position.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    assert!(reached > 0.4e-3, "{reached}");
    let x = bag("x").display().to_string();
    let (code, stdout, stderr) = run(&["check", &x, "--json"]);
    assert!(matches!(code, 0 | 3), "{stderr}");
    let report: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert_eq!(report["complete"], true, "{stdout}");
    let (code, stdout, stderr) = run(&["replay", &x, "--json"]);
    assert!(matches!(code, 0 | 3), "{stderr}");
    let report: serde_json::Value = serde_json::from_str(&stdout).unwrap();
    assert!(report["samples"].as_u64().unwrap() > 100, "{stdout}");
}

/// The recordings of `demo recordings` with a namespace in front of all topics are read as those
/// without.
#[test]
fn a_bag_with_a_namespace_is_read_as_one_without() {
    use friction_stage_data::bag::{BagOptions, BagWriter, OfferedQos, topics};
    use friction_stage_data::message::{JointState, WrenchStamped};
    let home = tempfile::tempdir().unwrap();
    let at = |name: &str| home.path().join(name);
    let path = |name: &str| at(name).display().to_string();
    let (code, _, stderr) = run(&["demo", "recordings", "--out", &path("plain")]);
    assert_eq!(code, 0, "{stderr}");
    for side in ["train", "check"] {
        let reader = BagReader::open(at("plain").join(side)).unwrap();
        let mut writer = BagWriter::create(at(side), &BagOptions::default()).unwrap();
        let qos = OfferedQos::reliable(10);
        let name = |topic: &str| format!("/x{topic}");
        let encoder = writer.add_topic::<JointState>(&name(topics::ENCODER), &qos).unwrap();
        let cell = writer.add_topic::<WrenchStamped>(&name(topics::FORCE_CELL), &qos).unwrap();
        let force = writer.add_topic::<WrenchStamped>(&name(topics::FORCE), &qos).unwrap();
        let state = name(topics::CONTROLLER_STATE);
        let state = writer.add_topic::<ControllerState>(&state, &qos).unwrap();
        for message in reader.messages() {
            let message = message.unwrap();
            let time = message.log_time;
            match message.topic.name.as_str() {
                topics::ENCODER => {
                    writer.write(encoder, time, &message.decode::<JointState>().unwrap()).unwrap();
                }
                topics::CONTROLLER_STATE => {
                    let decoded: ControllerState = message.decode().unwrap();
                    writer.write(state, time, &decoded).unwrap();
                }
                topic => {
                    let id = if topic == topics::FORCE { force } else { cell };
                    let decoded: WrenchStamped = message.decode().unwrap();
                    writer.write(id, time, &decoded).unwrap();
                }
            }
        }
        writer.finish().unwrap();
        let (code, stdout, stderr) = run(&["check", &path(side), "--json"]);
        assert!(matches!(code, 0 | 3), "{stderr}");
        let own = run(&["check", &at("plain").join(side).display().to_string(), "--json"]);
        let value = |text: &str| -> serde_json::Value { serde_json::from_str(text).unwrap() };
        assert_eq!(value(&stdout)["identification"], value(&own.1)["identification"]);
    }
    for side in ["train", "check"] {
        let with = Trace::from_bag(at(side)).unwrap();
        let without = Trace::from_bag(at("plain").join(side)).unwrap();
        assert_eq!(with.position, without.position);
        assert_eq!(with.force, without.force);
    }
}
