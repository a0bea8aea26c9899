//! Writes a small rosbag2 directory with one topic of each type that the stage records.
//!
//! `cargo run --example write_bag -- DIRECTORY [SAMPLES]`

use friction_stage_data::bag::{BagOptions, BagWriter, OfferedQos, Provenance};
use friction_stage_data::message::{
    Clock, ControllerState, DiagnosticArray, DiagnosticStatus, Float64MultiArray, Header,
    JointState, JointTrajectory, JointTrajectoryPoint, KeyValue, StageState, WrenchStamped,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let directory = arguments.next().ok_or("which directory?")?;
    let samples: u64 = arguments.next().map_or(Ok(1000), |n| n.parse())?;
    let options = BagOptions {
        provenance: Some(Provenance {
            model_yaml: "mass: 40.0\n".into(),
            seed: "1".into(),
            version: env!("CARGO_PKG_VERSION").into(),
            arguments: format!("{directory} {samples}"),
            ..Provenance::default()
        }),
        ..BagOptions::default()
    };
    let mut bag = BagWriter::create(&directory, &options)?;
    let qos = OfferedQos::reliable(100);
    let encoder = bag.add_topic::<JointState>("/stage/encoder", &qos)?;
    let cell = bag.add_topic::<WrenchStamped>("/stage/force_cell", &qos)?;
    let commands = bag.add_topic::<Float64MultiArray>("/stage/commands", &qos)?;
    let setpoint = bag.add_topic::<JointTrajectory>("/stage/setpoint", &qos)?;
    let state = bag.add_topic::<StageState>("/stage/state", &qos)?;
    let controller = bag.add_topic::<ControllerState>("/controller/state", &qos)?;
    let clock = bag.add_topic::<Clock>("/clock", &OfferedQos::best_effort(1))?;
    let diagnostics = bag.add_topic::<DiagnosticArray>("/diagnostics", &qos)?;
    for sample in 0..samples {
        let time = sample * 250_000;
        let header = Header::new(time as i64, "stage");
        let position = 0.025 * (sample as f64 * 0.01).sin();
        let force = 40.0 * position;
        bag.write(
            encoder,
            time,
            &JointState {
                header: header.clone(),
                name: vec!["stage".into()],
                position: vec![position],
                velocity: vec![0.0],
                effort: vec![force],
            },
        )?;
        bag.write(cell, time, &WrenchStamped::along_x(header.clone(), force))?;
        bag.write(
            commands,
            time,
            &Float64MultiArray { data: vec![force], ..Float64MultiArray::default() },
        )?;
        bag.write(
            setpoint,
            time,
            &JointTrajectory {
                header: header.clone(),
                joint_names: vec!["stage".into()],
                points: vec![JointTrajectoryPoint {
                    positions: vec![position],
                    ..JointTrajectoryPoint::default()
                }],
            },
        )?;
        bag.write(
            state,
            time,
            &StageState {
                header: header.clone(),
                sample,
                position,
                bristle_deflection: vec![1e-6; 4],
                guide_force: vec![-3.0; 4],
                effect_name: vec!["cogging".into()],
                effect_force: vec![0.5],
                ..StageState::default()
            },
        )?;
        bag.write(
            controller,
            time,
            &ControllerState {
                header: header.clone(),
                sample,
                output: force,
                enabled: true,
                ..ControllerState::default()
            },
        )?;
        bag.write(clock, time, &Clock { clock: header.stamp })?;
        if sample % 1000 == 0 {
            let status = DiagnosticStatus {
                level: DiagnosticStatus::OK,
                name: "stage".into(),
                message: "on time".into(),
                hardware_id: "friction_stage".into(),
                values: vec![KeyValue::new("overruns", 0)],
            };
            bag.write(diagnostics, time, &DiagnosticArray { header, status: vec![status] })?;
        }
    }
    bag.finish()?;
    Ok(())
}
