//! Lockstep over ROS 2 is the run in one process, bit for bit: two real processes, loopback, a real
//! bag.

mod domains;

use std::path::Path;

use domains::domain;
use friction_stage::node::LOCKSTEP_EPOCH;
use friction_stage::node::driver::{Driver, LockstepRun};
use friction_stage::node::participant::{Network, Reach};
use friction_stage_core::control::{
    Compensation, CompensationTerms, CompensationTermsOn, Controller, ControllerSettings,
    ObserverSettings, Trajectory,
};
use friction_stage_core::model::StageModel;
use friction_stage_core::plant::{Rates, Stage};
use friction_stage_core::{ClosedLoop, Cycle};
use friction_stage_data::bag::{BagReader, topics};
use friction_stage_data::message::{ControllerState, JointState, WrenchStamped};
use friction_stage_lab::PaperMotion;

fn record(directory: &Path, motion: &PaperMotion, domain: u16, controller: &[&str]) {
    let network = Network { domain, reach: Reach::Localhost };
    let program = Path::new(env!("CARGO_BIN_EXE_friction-stage"));
    let given = [
        "model:=guide_3".to_owned(),
        "seed:=42".to_owned(),
        format!("record:={}", directory.display()),
    ];
    let run = LockstepRun {
        stage_arguments: given
            .into_iter()
            .flat_map(|parameter| ["-p".to_owned(), parameter])
            .collect(),
        controller_arguments: controller.iter().map(|text| (*text).to_owned()).collect(),
        points: motion.points.clone(),
        log_stem: directory.to_owned(),
    };
    Driver::new(program, network).unwrap().run(&run, &mut |_| {}).unwrap();
}

fn in_process(
    motion: &PaperMotion,
    count: usize,
    known: Option<&StageModel>,
    observer: Option<ObserverSettings>,
) -> Vec<Cycle> {
    let stage = Stage::new(&StageModel::on_guides("guide_3"), Rates::DEFAULT, 42).unwrap();
    let settings =
        ControllerSettings { observer, ..ControllerSettings::paper(40.0, 4000.0, 2000.0) };
    let compensation =
        known.map(|known| Compensation::new(known, &settings, CompensationTermsOn::ALL).unwrap());
    let controller = Controller::new(match &compensation {
        Some(compensation) => settings.informed(compensation),
        None => settings,
    })
    .unwrap();
    let trajectory = Trajectory::new(0, motion.points.clone()).unwrap();
    let mut closed_loop = ClosedLoop::new(stage, controller, trajectory);
    if let Some(compensation) = compensation {
        closed_loop = closed_loop.compensated(compensation);
    }
    (0..count).map(|_| closed_loop.cycle().unwrap()).collect()
}

#[test]
fn trace_over_ros_is_the_trace_in_one_process_bit_for_bit() {
    let directory = tempfile::tempdir().unwrap();
    let bag = directory.path().join("run");
    let motion = PaperMotion::new(0.05, 1);
    record(&bag, &motion, domain(0), &[]);
    let cycles = (motion.duration() / 250_000) as usize;
    let expected = in_process(&motion, cycles, None, None);

    let (mut samples, mut forces, mut states, mut last) = (0, 0, 0, None);
    let at = |stamp: i64| {
        let time = stamp - LOCKSTEP_EPOCH;
        assert_eq!(time % 250_000, 0, "stamps are sampling instants");
        expected.get((time / 250_000) as usize)
    };
    let reader = BagReader::open(&bag).unwrap();
    assert!(reader.is_complete());
    for message in reader.messages() {
        let message = message.unwrap();
        match message.topic.name.as_str() {
            topics::ENCODER => {
                let found: JointState = message.decode().unwrap();
                let Some(cycle) = at(found.header.stamp.to_nanos()) else { continue };
                assert_eq!(
                    found.position[0].to_bits(),
                    cycle.sample.position.to_bits(),
                    "sample {samples}"
                );
                assert_eq!(
                    found.velocity[0].to_bits(),
                    cycle.sample.velocity.to_bits(),
                    "sample {samples}"
                );
                assert_eq!(
                    found.effort[0].to_bits(),
                    cycle.sample.force_cell.to_bits(),
                    "sample {samples}"
                );
                samples += 1;
            }
            topics::FORCE => {
                let found: WrenchStamped = message.decode().unwrap();
                // The first sample is sent again until it is answered, and the controller may
                // answer each; what it answers is the same.
                let stamp = found.header.stamp.to_nanos();
                let is_again = last.replace(stamp) == Some(stamp);
                let Some(cycle) = at(stamp) else { continue };
                assert_eq!(
                    found.wrench.force.x.to_bits(),
                    cycle.terms.output.to_bits(),
                    "force {forces}"
                );
                forces += usize::from(!is_again);
            }
            topics::CONTROLLER_STATE => {
                let found: ControllerState = message.decode().unwrap();
                let Some(cycle) = at(found.header.stamp.to_nanos()) else { continue };
                assert_eq!(found.error.to_bits(), cycle.terms.error.to_bits(), "state {states}");
                assert_eq!(
                    found.integral.to_bits(),
                    cycle.terms.integral.to_bits(),
                    "state {states}"
                );
                states += 1;
            }
            _ => {}
        }
    }
    // Every sample, every answer and every state of the run is in the bag.
    assert_eq!((samples, forces, states), (cycles, cycles, cycles));

    // The bag alone repeats the run.
    let replay = std::process::Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .args(["replay", "--json", bag.to_str().unwrap()])
        .output()
        .unwrap();
    assert!(replay.status.success(), "{}", String::from_utf8_lossy(&replay.stderr));
    let report: serde_json::Value = serde_json::from_slice(&replay.stdout).unwrap();
    assert!(report["samples"].as_u64().unwrap() >= cycles as u64, "{report}");
    assert_eq!(report["identical"], report["samples"], "{report}");
    // Another model does not.
    let other = std::process::Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .args(["replay", "--json", "--model", "guide_2", bag.to_str().unwrap()])
        .output()
        .unwrap();
    let report: serde_json::Value = serde_json::from_slice(&other.stdout).unwrap();
    assert!(report["position_rms_m"].as_f64().unwrap() > 1e-6, "{report}");

    // Nor does one whose seed was changed: exit code 3, and why.
    for place in std::fs::read_dir(&bag).unwrap() {
        let path = place.unwrap().path();
        let mut bytes = std::fs::read(&path).unwrap();
        let seed = b"seed\x02\x00\x00\x0042";
        let at: Vec<usize> =
            (0..bytes.len() - seed.len()).filter(|at| bytes[*at..].starts_with(seed)).collect();
        at.iter().for_each(|at| bytes[at + seed.len() - 1] = b'3');
        std::fs::write(&path, &bytes).unwrap();
    }
    let changed = std::process::Command::new(env!("CARGO_BIN_EXE_friction-stage"))
        .args(["replay", bag.to_str().unwrap()])
        .output()
        .unwrap();
    let printed = String::from_utf8_lossy(&changed.stdout);
    assert_eq!(changed.status.code(), Some(3), "{printed}");
    assert!(printed.contains("model, seed, forces or samples were changed"), "{printed}");
}

/// The controller node with what it knows of the stage is the compensation in one process.
#[test]
fn compensation_over_ros_is_that_in_one_process_bit_for_bit() {
    compensation_is_that_in_one_process(domain(1), None);
}

#[test]
fn a_disturbance_observer_over_ros_is_that_in_one_process_bit_for_bit() {
    let observer = ObserverSettings {
        bandwidth: 12.5,
        limit: 80.0,
        mass: 40.0,
        delay: 0.0,
        forward_delay: 0.0,
    };
    compensation_is_that_in_one_process(domain(2), Some(observer));
}

fn compensation_is_that_in_one_process(domain: u16, observer: Option<ObserverSettings>) {
    let directory = tempfile::tempdir().unwrap();
    let bag = directory.path().join("run");
    let motion = PaperMotion::new(0.05, 1);
    let mut given = vec!["-p".to_owned(), "compensation:=guide_3".to_owned()];
    if let Some(observer) = observer {
        let ObserverSettings { bandwidth, limit, .. } = observer;
        for (name, value) in [("bandwidth", bandwidth), ("limit", limit)] {
            given.extend(["-p".to_owned(), format!("disturbance_observer.{name}:={value:?}")]);
        }
    }
    let given: Vec<&str> = given.iter().map(String::as_str).collect();
    record(&bag, &motion, domain, &given);
    let cycles = (motion.duration() / 250_000) as usize;
    let known = StageModel::on_guides("guide_3");
    let expected = in_process(&motion, cycles, Some(&known), observer);
    let plain = in_process(&motion, cycles, None, None);
    let observed = expected.iter().any(|one| one.terms.disturbance != 0.0);
    assert_eq!(observed, observer.is_some(), "what the observer adds");
    let peak = |run: &[Cycle]| run.iter().map(|one| one.terms.error.abs()).fold(0.0, f64::max);
    assert!(peak(&expected) < 0.2 * peak(&plain), "{} {}", peak(&expected), peak(&plain));
    let (mut forces, mut states, mut last) = (0, 0, None);
    let at = |stamp: i64| expected.get(((stamp - LOCKSTEP_EPOCH) / 250_000) as usize);
    for message in BagReader::open(&bag).unwrap().messages() {
        let message = message.unwrap();
        match message.topic.name.as_str() {
            topics::FORCE => {
                let found: WrenchStamped = message.decode().unwrap();
                // As above: one answer of several to the first sample counts.
                let stamp = found.header.stamp.to_nanos();
                let is_again = last.replace(stamp) == Some(stamp);
                let Some(cycle) = at(stamp) else { continue };
                let (found, output) = (found.wrench.force.x, cycle.terms.output);
                assert_eq!(found.to_bits(), output.to_bits(), "force {forces}");
                forces += usize::from(!is_again);
            }
            topics::CONTROLLER_STATE => {
                let found: ControllerState = message.decode().unwrap();
                // All that is added is in the state, each term in its field.
                let sum = found.feedback
                    + found.mass_feedforward
                    + found.viscous_feedforward
                    + found.bristles_feedforward
                    + found.forces_feedforward
                    + found.motor_feedforward
                    + found.disturbance
                    + found.effort;
                assert!((sum - found.output).abs() < 1e-9 || found.saturated, "{found:?}");
                let stamp = found.header.stamp.to_nanos();
                if let Some(Cycle { terms, .. }) = at(stamp).filter(|_| stamp > LOCKSTEP_EPOCH) {
                    assert_eq!(found.mass_feedforward.to_bits(), terms.mass_feedforward.to_bits());
                    let of_compensation = CompensationTerms {
                        bristles: found.bristles_feedforward,
                        forces: found.forces_feedforward,
                        motor: found.motor_feedforward,
                    };
                    assert_eq!(of_compensation, terms.compensation);
                    assert_eq!(found.disturbance.to_bits(), terms.disturbance.to_bits());
                }
                states += 1;
            }
            _ => {}
        }
    }
    assert_eq!(forces, cycles);
    assert!(states >= cycles, "{states} of {cycles} states");
}
