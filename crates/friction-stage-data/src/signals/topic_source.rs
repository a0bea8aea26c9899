//! The raw samples of signals in the messages of a bag: any field of any type that the bag
//! defines.

use super::data_quality::SignalNote;
use super::error::SignalError;
use super::mapping::{Place, SignalSource, Stamp};
use super::source::{Request, Stream, seconds_to_nanos};
use crate::bag::definition::{Definition, FieldPath, Value};
use crate::bag::{BagReader, Topic};
use crate::message::*;

/// The definition of a topic's type: that of the bag, or our own for types that this program knows.
fn definition(topic: &Topic) -> Result<Definition, String> {
    let known = || {
        Some(match topic.type_name.as_str() {
            "sensor_msgs/msg/JointState" => JointState::definition(),
            "geometry_msgs/msg/WrenchStamped" => WrenchStamped::definition(),
            "trajectory_msgs/msg/JointTrajectory" => JointTrajectory::definition(),
            "std_msgs/msg/Float64MultiArray" => Float64MultiArray::definition(),
            "friction_stage/msg/StageState" => StageState::definition(),
            "friction_stage/msg/ControllerState" => ControllerState::definition(),
            _ => return None,
        })
    };
    if topic.schema_encoding == "ros2msg" && !topic.definition.is_empty() {
        Definition::parse(&topic.type_name, &String::from_utf8_lossy(&topic.definition))
    } else if let Some(text) = known() {
        Definition::parse(&topic.type_name, &text)
    } else {
        let what = if topic.schema_encoding.is_empty() { "none" } else { &topic.schema_encoding };
        Err(format!("the bag defines its type in {what}, read is ros2msg"))
    }
}

/// A request with its paths found in the type of its topic.
struct Extraction {
    topic: String,
    definition: Definition,
    stamp: Option<FieldPath>,
    publish_time: bool,
    sources: Vec<(FieldPath, SignalSource)>,
    automatic: bool,
}

impl Extraction {
    fn new(reader: &BagReader, request: &Request) -> Result<Self, SignalError> {
        let mut found: Option<Self> = None;
        for (_, source) in &request.signals {
            let Place::Topic { topic: name, field, stamp } = &source.place else {
                continue;
            };
            let unknown = |topic: Option<&Topic>, reason: String| SignalError::Field {
                topic: name.clone(),
                type_name: topic.map_or_else(String::new, |t| t.type_name.clone()),
                field: field.clone(),
                reason,
            };
            let topic = reader
                .topic(name)
                .ok_or_else(|| unknown(None, "the bag has no such topic".into()))?;
            if topic.message_encoding != "cdr" {
                return Err(unknown(
                    Some(topic),
                    format!("its messages are in {}, read is cdr", topic.message_encoding),
                ));
            }
            if found.is_none() {
                let definition =
                    definition(topic).map_err(|reason| unknown(Some(topic), reason))?;
                let (path, publish_time, automatic) = match stamp {
                    Stamp::Auto => match definition.path("header.stamp") {
                        Ok(path) => (Some(path), false, true),
                        Err(_) => (None, false, false),
                    },
                    Stamp::LogTime => (None, false, false),
                    Stamp::PublishTime => (None, true, false),
                    Stamp::Field(text) => {
                        let path = definition.path(text).map_err(|reason| SignalError::Field {
                            topic: name.clone(),
                            type_name: topic.type_name.clone(),
                            field: text.clone(),
                            reason,
                        })?;
                        (Some(path), false, false)
                    }
                };
                found = Some(Self {
                    topic: name.clone(),
                    definition,
                    stamp: path,
                    publish_time,
                    sources: Vec::new(),
                    automatic,
                });
            }
            if let Some(extraction) = &mut found {
                let path = extraction
                    .definition
                    .path(field)
                    .map_err(|reason| unknown(Some(topic), reason))?;
                extraction.sources.push((path, source.clone()));
            }
        }
        found.ok_or_else(|| SignalError::Mapping {
            origin: reader.path().display().to_string(),
            key: "signals".into(),
            reason: "a bag needs topics".into(),
        })
    }
}

pub(super) fn read_bag(
    reader: &BagReader,
    requests: &[Request],
    joint: &str,
) -> Result<Vec<Stream>, SignalError> {
    let mut extractions = Vec::new();
    let mut streams = Vec::new();
    for request in requests {
        let extraction = Extraction::new(reader, request)?;
        streams
            .push(Stream::new(request, reader.topic(&extraction.topic).map_or(0, |t| t.messages)));
        extractions.push(extraction);
    }
    let mut row = Vec::new();
    for message in reader.messages() {
        let message = message?;
        for (extraction, stream) in extractions.iter().zip(&mut streams) {
            if extraction.topic != message.topic.name {
                continue;
            }
            let failed = |reason: String| SignalError::Field {
                topic: extraction.topic.clone(),
                type_name: message.topic.type_name.clone(),
                field: stream.places.join(", "),
                reason: format!("message at {} ns: {reason}", message.log_time),
            };
            row.clear();
            for (path, source) in &extraction.sources {
                let value = extraction.definition.value(path, joint, &message).map_err(failed)?;
                row.push(value.map(|value| source.to_si(value.as_f64())));
            }
            if row.iter().all(Option::is_none) {
                continue;
            }
            let stamp = match &extraction.stamp {
                Some(path) => {
                    match extraction.definition.value(path, joint, &message).map_err(failed)? {
                        Some(Value::Nanoseconds(stamp)) => stamp,
                        Some(value) => seconds_to_nanos(value.as_f64()),
                        None => continue,
                    }
                }
                None => {
                    let time = if extraction.publish_time {
                        message.publish_time
                    } else {
                        message.log_time
                    };
                    i64::try_from(time).unwrap_or(i64::MAX)
                }
            };
            stream.stamps.push(stamp);
            for (column, value) in stream.values.iter_mut().zip(&row) {
                column.push(value.unwrap_or(f64::NAN));
            }
        }
    }
    for (index, extraction) in extractions.iter().enumerate() {
        let stamps = &streams[index].stamps;
        let unfilled = stamps.len() > 1 && stamps.iter().all(|stamp| *stamp == stamps[0]);
        if extraction.automatic && unfilled {
            let mut request = requests[index].clone();
            for (_, source) in &mut request.signals {
                if let Place::Topic { stamp, .. } = &mut source.place {
                    *stamp = Stamp::LogTime;
                }
            }
            let topic = extraction.topic.clone();
            let note = SignalNote::UnfilledStamps { topic, stamp_ns: stamps[0] };
            streams[index] = read_bag(reader, &[request], joint)?.remove(0);
            streams[index].notes.push(note);
        }
    }
    Ok(streams)
}
