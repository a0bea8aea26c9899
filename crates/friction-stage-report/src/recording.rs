//! What a recording holds and what is wrong with it, as JSON for other programs.

use serde::Serialize;
use serde_json::{Value, json};

use crate::words::{Words, all_words, subject};
use friction_stage_core::model::JointType;
use friction_stage_data::quality::{DataFinding, FileFinding, RecordingCheck};
use friction_stage_data::signals::SignalNote;

/// A finding with its code, how much it matters, and the sentence for it.
#[derive(Serialize)]
struct Worded<'a, F> {
    code: &'static str,
    severity: &'static str,
    text: String,
    #[serde(flatten)]
    finding: &'a F,
}

fn worded<F: Words + Serialize>(
    code: &'static str,
    severity: &'static str,
    finding: &F,
    joint: JointType,
) -> Result<Value, serde_json::Error> {
    serde_json::to_value(Worded { code, severity, text: finding.words(joint), finding })
}

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
                    worded(finding.code(), finding.severity().name(), finding, joint)
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
                .map(|finding: &SignalNote| worded(finding.code(), "warning", finding, joint))
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
                    worded(finding.code(), finding.severity().name(), finding, joint)
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
