//! A run of the laboratory as a bag of the stage's topics, with everything that repeats it.

use std::path::Path;

use crate::made_by;
use friction_stage_data::bag::{BagOptions, BagWriter, OfferedQos, Provenance, topics};
use friction_stage_data::message::{ControllerState, Header, JointState, WrenchStamped};
use friction_stage_data::wire::controller_state;
use friction_stage_lab::LabRecording;

/// Depth of the queues as the nodes offer them.
const DEPTH: u32 = 10;

/// Writes the topics that the nodes would have recorded; stamps count from the start of the run.
pub(super) fn write_bag(
    directory: &Path,
    recording: &LabRecording,
    experiment: &str,
) -> anyhow::Result<()> {
    let rates = recording.settings.rates;
    let provenance = Provenance {
        model_yaml: recording.model.to_yaml()?,
        seed: recording.settings.seed.to_string(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        arguments: format!("experiment {experiment}"),
        extra: [
            ("control_rate", rates.control().to_string()),
            ("physics_rate", rates.physics().to_string()),
            ("date", made_by::now()),
        ]
        .map(|(key, value)| (key.to_owned(), value))
        .into(),
    };
    write_topics(directory, recording, Some(provenance))
}

/// The same with what is said of its origin, or nothing.
pub(in crate::cli) fn write_topics(
    directory: &Path,
    recording: &LabRecording,
    provenance: Option<Provenance>,
) -> anyhow::Result<()> {
    let options = BagOptions { provenance, ..BagOptions::default() };
    let mut bag = BagWriter::create(directory, &options)?;
    let qos = OfferedQos::reliable(DEPTH);
    let encoder = bag.add_topic::<JointState>(topics::ENCODER, &qos)?;
    let cell = bag.add_topic::<WrenchStamped>(topics::FORCE_CELL, &qos)?;
    let force = bag.add_topic::<WrenchStamped>(topics::FORCE, &qos)?;
    let controlled = recording.rows.first().is_some_and(|row| row.terms.is_some());
    let controller = controlled
        .then(|| bag.add_topic::<ControllerState>(topics::CONTROLLER_STATE, &qos))
        .transpose()?;
    for row in &recording.rows {
        let sample = &row.sample;
        let header = Header::new(sample.time, topics::JOINT);
        let time = sample.time as u64;
        let joint = JointState {
            header: header.clone(),
            name: vec![topics::JOINT.to_owned()],
            position: vec![sample.position],
            velocity: vec![sample.velocity],
            effort: vec![sample.force_cell],
        };
        bag.write(encoder, time, &joint)?;
        bag.write(cell, time, &WrenchStamped::along_x(header.clone(), sample.force_cell))?;
        bag.write(force, time, &WrenchStamped::along_x(header.clone(), row.force))?;
        if let (Some(controller), Some(terms)) = (controller, &row.terms) {
            let state = controller_state(header, sample.index, terms, true, 0);
            bag.write(controller, time, &state)?;
        }
    }
    Ok(bag.finish()?)
}
