//! Writes generated records as rosbag2 directories with the topics and types of the recorded stage
//! runs, and the truth into a folder of its own.

use std::fmt::Write as _;
use std::path::Path;

use friction_stage_data::bag::{BagOptions, BagWriter, OfferedQos, topics};
use friction_stage_data::message::{
    Header, JointState, JointTrajectory, JointTrajectoryPoint, WrenchStamped,
};
use friction_stage_data::signals::Trace;

use super::{Columns, GenerateError, GeneratedRun, RecordTruth};

/// Stamp of the first row, ns: the one of the recorded stage runs.
const ORIGIN_NS: i64 = 1_760_000_000_000_000_000;

impl Columns {
    /// The same columns as the library holds them.
    pub fn to_trace(&self) -> Trace {
        Trace {
            origin_ns: ORIGIN_NS,
            time: self.time.clone(),
            reference_position: self.reference_position.clone(),
            reference_velocity: self.reference_velocity.clone(),
            reference_acceleration: self.reference_acceleration.clone(),
            position: self.position.clone(),
            force_cell: self.force_cell.clone(),
            force: self.force.clone(),
        }
    }

    /// Writes a bag; the directory must not exist. Nothing in it tells what is hidden.
    pub fn write_bag(&self, directory: impl AsRef<Path>) -> Result<(), GenerateError> {
        let mut bag = BagWriter::create(directory, &BagOptions::default())?;
        let qos = OfferedQos::reliable(100);
        let setpoint = bag.add_topic::<JointTrajectory>(topics::SETPOINT, &qos)?;
        let encoder = bag.add_topic::<JointState>(topics::ENCODER, &qos)?;
        let cell = bag.add_topic::<WrenchStamped>(topics::FORCE_CELL, &qos)?;
        let force = bag.add_topic::<WrenchStamped>(topics::FORCE, &qos)?;
        for (k, time) in self.time.iter().enumerate() {
            let stamp = ORIGIN_NS + (time * 1e9).round() as i64;
            let at = stamp as u64;
            let header = Header::new(stamp, topics::JOINT);
            let point = JointTrajectoryPoint {
                positions: vec![self.reference_position[k]],
                velocities: vec![self.reference_velocity[k]],
                accelerations: vec![self.reference_acceleration[k]],
                ..JointTrajectoryPoint::default()
            };
            let trajectory = JointTrajectory {
                header: header.clone(),
                joint_names: vec![topics::JOINT.into()],
                points: vec![point],
            };
            bag.write(setpoint, at, &trajectory)?;
            let state = JointState {
                header: header.clone(),
                name: vec![topics::JOINT.into()],
                position: vec![self.position[k]],
                effort: vec![self.force_cell[k]],
                ..JointState::default()
            };
            bag.write(encoder, at, &state)?;
            bag.write(cell, at, &WrenchStamped::along_x(header.clone(), self.force_cell[k]))?;
            bag.write(force, at, &WrenchStamped::along_x(header, self.force[k]))?;
        }
        Ok(bag.finish()?)
    }
}

impl RecordTruth {
    /// The true signals as CSV text: time (s), position (m), velocity, acceleration, motor and
    /// friction force (N), then the force of each hidden effect (N) and its errors of encoder (m)
    /// and cell (N).
    fn csv(&self, time: &[f64]) -> String {
        let mut text =
            String::from("time,position,velocity,acceleration,motor_force,friction_force");
        for hidden in &self.hidden {
            let name = hidden.name;
            let _ = write!(text, ",{name},{name}_encoder,{name}_cell");
        }
        text.push('\n');
        for (k, time) in time.iter().enumerate() {
            let columns = [
                &self.position,
                &self.velocity,
                &self.acceleration,
                &self.motor_force,
                &self.friction_force,
            ];
            let _ = write!(text, "{time}");
            for column in columns {
                let _ = write!(text, ",{}", column[k]);
            }
            for hidden in &self.hidden {
                let _ =
                    write!(text, ",{},{},{}", hidden.force[k], hidden.encoder[k], hidden.cell[k]);
            }
            text.push('\n');
        }
        text
    }
}

impl GeneratedRun {
    /// Writes the bags `train` and `check` under `bags`, and `truth.json`, `truth_train.csv` and
    /// `truth_check.csv` under `truth`, which must not lie in the bags' folder.
    pub fn write(&self, bags: &Path, truth: &Path) -> Result<(), GenerateError> {
        self.train.write_bag(bags.join("train"))?;
        self.check.write_bag(bags.join("check"))?;
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |source: std::io::Error| GenerateError::Write { path, source }
        };
        std::fs::create_dir_all(truth).map_err(failed(truth))?;
        let json = serde_json::to_string_pretty(&self.truth)
            .map_err(std::io::Error::other)
            .map_err(failed(truth))?;
        for (name, text) in [
            ("truth.json", json),
            ("truth_train.csv", self.truth.train.csv(&self.train.time)),
            ("truth_check.csv", self.truth.check.csv(&self.check.time)),
        ] {
            let path = truth.join(name);
            std::fs::write(&path, text).map_err(failed(&path))?;
        }
        Ok(())
    }
}
