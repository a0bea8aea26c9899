//! What a recording holds and what is wrong with it, as JSON for other programs.

use serde_json::{Value, json};

use crate::words::{Worded, Words as _, all_words, subject};
use friction_stage_core::model::JointType;
use friction_stage_data::quality::{DataFinding, FileFinding, RecordingCheck, Severity};
use friction_stage_data::signals::SignalNote;

/// The JSON of a check: the messages of a bag with `findings` and `warnings`, the signals as
/// `data`, and what they can identify as `identification`.
pub fn recording_json(check: &RecordingCheck) -> Result<Value, serde_json::Error> {
    let joint = check.identification.as_ref().map_or(JointType::default(), |found| found.joint);
    let mut document = match &check.messages {
        Some(messages) => {
            let mut found = serde_json::to_value(messages)?;
            found["findings"] = messages
                .findings
                .iter()
                .map(|finding: &FileFinding| {
                    serde_json::to_value(Worded::new(
                        finding.code(),
                        finding.severity(),
                        finding,
                        joint,
                    ))
                })
                .collect::<Result<_, _>>()?;
            found["warnings"] = json!(all_words(&messages.findings, joint));
            found
        }
        None => json!({}),
    };
    document["rows"] = serde_json::to_value(&check.rows)?;
    document["data"] = match &check.data {
        Some(data) => {
            let mut found = serde_json::to_value(data)?;
            found["findings"] = data
                .notes
                .iter()
                .map(|finding: &SignalNote| {
                    serde_json::to_value(Worded::new(
                        finding.code(),
                        Severity::Warning,
                        finding,
                        joint,
                    ))
                })
                .collect::<Result<_, _>>()?;
            found["notes"] = json!(all_words(&data.notes, joint));
            found
        }
        None => Value::Null,
    };
    document["identification"] = match &check.identification {
        Some(identification) => {
            let mut found = serde_json::to_value(identification)?;
            found["problems"] = identification
                .findings
                .iter()
                .map(|finding: &DataFinding| {
                    serde_json::to_value(Worded::new(
                        finding.code(),
                        finding.severity(),
                        finding,
                        joint,
                    ))
                })
                .collect::<Result<_, _>>()?;
            found["judgements"] = identification
                .judgements
                .iter()
                .map(|judgement| {
                    json!({
                        "subject": subject(judgement.subject),
                        "possible": judgement.possible(),
                        "because": judgement.words(joint),
                        "evidence": judgement.answer.as_ref().ok(),
                        "obstacle": judgement.answer.as_ref().err(),
                    })
                })
                .collect();
            found
        }
        None => Value::Null,
    };
    document["no_data"] = json!(check.no_data.as_ref().map(ToString::to_string));
    Ok(document)
}
