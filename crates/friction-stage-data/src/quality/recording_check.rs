//! A recording with all that is wrong with it: its messages, its signals, and what they can
//! identify.

use std::path::Path;

use super::check::{CheckReport, TopicCheck, check_messages, check_rows};
use super::excitation::{Excitation, examine};
use super::finding::{DataFinding, FileFinding, Severity};
use crate::bag::BagReader;
use crate::signals::{
    DataQuality, Mapping, Recording, SignalError, SignalNote, Window, is_table, load_part,
};
use friction_stage_core::model::StageModel;

/// What a recording holds, what is wrong with it, and what can be identified from it.
#[derive(Debug)]
pub struct RecordingCheck {
    /// The messages, of a bag.
    pub messages: Option<CheckReport>,
    /// The times of all rows, of a table of which only a part is examined.
    pub rows: Option<TopicCheck>,
    /// The signals on one grid.
    pub data: Option<DataQuality>,
    /// What they can identify.
    pub identification: Option<Excitation>,
    /// Why there are none.
    pub no_data: Option<SignalError>,
    /// Whether the signals were asked for, by a model or a mapping.
    pub asked: bool,
}

impl RecordingCheck {
    /// Checks a rosbag2 directory, a file of one, or a table. Without a model the one in the bag
    /// counts. Messages are those of the whole bag, signals those of `part`. A bag without the
    /// signals of a stage is an error if they were asked for.
    pub fn new(
        path: &Path,
        mapping: Option<&Mapping>,
        part: Window,
        model: Option<StageModel>,
        progress: &mut dyn FnMut(u64),
    ) -> Result<RecordingCheck, SignalError> {
        let asked = mapping.is_some() || model.is_some();
        let mut model = model;
        let mut messages =
            if is_table(path, mapping) { None } else { Some(check_messages(path, progress)?) };
        if let (None, Some(messages)) = (&model, &mut messages) {
            model = BagReader::open(path)?.model().unwrap_or_else(|error| {
                let reason = error.to_string();
                messages.findings.push(FileFinding::UnusableModel { reason });
                None
            });
        }
        let (recording, no_data) = match load_part(path, mapping, part) {
            Ok(recording) => (Some(recording), None),
            // Asked for the messages only, a bag need not be one of a stage.
            Err(error) if messages.is_some() && !asked => (None, Some(error)),
            Err(error) => return Err(error),
        };
        let identification = recording.as_ref().map(|recording| examine(recording, model.as_ref()));
        // Of a table that is read whole, the account of its signals says it all.
        let is_part = recording.as_ref().is_some_and(|recording| {
            let is_part = |note: &SignalNote| matches!(note, SignalNote::OnlyPart { .. });
            recording.quality.notes.iter().any(is_part)
        });
        let rows = if messages.is_none() && is_part {
            let own = Mapping::own_csv();
            Some(check_rows(path, mapping.unwrap_or(&own), progress)?)
        } else {
            None
        };
        let data = recording.map(|recording| recording.quality);
        Ok(RecordingCheck { messages, rows, data, identification, no_data, asked })
    }

    /// Whether something is wrong: with the messages, or with the signals if they were asked for.
    /// Notes say what a recording is like, and are no fault of it.
    pub fn has_warnings(&self) -> bool {
        let messages = self.messages.as_ref().is_some_and(|found| !found.findings.is_empty());
        let signals = self.identification.as_ref().and_then(Excitation::severity);
        messages || (self.asked && signals >= Some(Severity::Warning))
    }
}

/// Where a recording contradicts itself or the model so that no figure of a comparison says
/// anything: a wrong sign or unit, another machine, samples that no machine made.
pub fn contradictions(recording: &Recording, model: &StageModel) -> Vec<DataFinding> {
    let found = examine(recording, Some(model));
    found.findings.into_iter().filter(DataFinding::is_contradiction).collect()
}
