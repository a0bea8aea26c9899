//! The raw samples of signals in the messages of a bag: any field of any type that the bag
//! defines.

use std::collections::BTreeSet;

use super::data_quality::SignalNote;
use super::error::SignalError;
use super::mapping::{Place, Signal, SignalSource, Stamp};
use super::source::{Request, Stream, seconds_to_nanos};
use crate::bag::definition::{Definition, FieldPath, Value};
use crate::bag::{BagReader, Topic, topics};
use crate::message::*;

/// The definition of a topic's type: that of the bag, or our own for types that this program knows.
fn definition(topic: &Topic) -> Result<Definition, String> {
    let known = || {
        Some(match current_type_name(&topic.type_name).as_ref() {
            "sensor_msgs/msg/JointState" => JointState::definition(),
            "geometry_msgs/msg/WrenchStamped" => WrenchStamped::definition(),
            "trajectory_msgs/msg/JointTrajectory" => JointTrajectory::definition(),
            "std_msgs/msg/Float64MultiArray" => Float64MultiArray::definition(),
            "friction_stage_msgs/msg/StageState" => StageState::definition(),
            "friction_stage_msgs/msg/ControllerState" => ControllerState::definition(),
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

/// Which joint is read, and which others the messages name.
struct Joints {
    /// The one that is asked for, or found.
    wanted: Option<String>,
    is_asked_for: bool,
    /// Names in messages that do not name the wanted one, in order; the first of them.
    others: BTreeSet<String>,
}

impl Joints {
    /// Other names that an error lists.
    const MOST: usize = 20;

    fn new(asked: Option<&str>) -> Self {
        Joints {
            wanted: asked.map(str::to_owned),
            is_asked_for: asked.is_some(),
            others: BTreeSet::new(),
        }
    }

    /// The joint that is read. If the mapping gives none: [`topics::JOINT`], or the only joint of
    /// the first message.
    fn wanted(
        &mut self,
        names: impl FnOnce() -> Result<Vec<String>, String>,
    ) -> Result<&str, String> {
        if self.wanted.is_none() {
            let names = names()?;
            self.wanted = match names.as_slice() {
                [] => None,
                [only] => Some(only.clone()),
                _ => Some(topics::JOINT.to_owned()),
            };
        }
        Ok(self.read())
    }

    fn read(&self) -> &str {
        self.wanted.as_deref().unwrap_or(topics::JOINT)
    }

    /// A message without the wanted joint names these.
    fn heard(&mut self, names: Vec<String>) {
        let room = Joints::MOST.saturating_sub(self.others.len());
        self.others.extend(names.into_iter().take(room));
    }

    /// What is wrong at the end of a recording, from which nothing was read or something.
    fn judge(&self, is_empty: bool) -> Result<(), String> {
        let others: Vec<&str> = self.others.iter().map(String::as_str).collect();
        let wanted = self.read();
        if others.is_empty() || others.contains(&wanted) {
            Ok(())
        } else if is_empty {
            Err(format!("no joint {wanted}; its messages name {}", others.join(", ")))
        } else if self.is_asked_for || wanted == topics::JOINT {
            Ok(())
        } else {
            Err(format!(
                "its messages name {wanted} and {}: say which with `joint` in a mapping",
                others.join(", ")
            ))
        }
    }
}

pub(super) fn read_bag(
    reader: &BagReader,
    requests: &[Request],
    joint: Option<&str>,
) -> Result<Vec<Stream>, SignalError> {
    let mut extractions = Vec::new();
    let mut streams = Vec::new();
    for request in requests {
        let extraction = Extraction::new(reader, request)?;
        streams
            .push(Stream::new(request, reader.topic(&extraction.topic).map_or(0, |t| t.messages)));
        extractions.push(extraction);
    }
    let mut joints: Vec<Joints> = extractions.iter().map(|_| Joints::new(joint)).collect();
    let mut row = Vec::new();
    for message in reader.messages() {
        let message = message?;
        let places = extractions.iter().zip(&mut joints).zip(&mut streams);
        for ((extraction, joints), stream) in places {
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
                let definition = &extraction.definition;
                let joint = joints.wanted(|| definition.joints(path, &message)).map_err(failed)?;
                let value = definition.value(path, joint, &message).map_err(failed)?;
                row.push(value.map(|value| source.to_si(value.as_f64())));
            }
            if row.iter().all(Option::is_none) {
                for (path, _) in &extraction.sources {
                    joints.heard(extraction.definition.joints(path, &message).map_err(failed)?);
                }
                continue;
            }
            let stamp = match &extraction.stamp {
                Some(path) => {
                    match extraction
                        .definition
                        .value(path, joints.read(), &message)
                        .map_err(failed)?
                    {
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
        // Without a mapping only the position must be there.
        let is_needed = |(signal, _): &(Signal, SignalSource)| {
            [Signal::Position, Signal::Velocity].contains(signal)
        };
        let judged = if joint.is_some() || requests[index].signals.iter().any(is_needed) {
            joints[index].judge(streams[index].stamps.is_empty())
        } else {
            Ok(())
        };
        judged.map_err(|reason| SignalError::Field {
            topic: extraction.topic.clone(),
            type_name: reader
                .topic(&extraction.topic)
                .map_or_else(String::new, |topic| topic.type_name.clone()),
            field: streams[index].places.join(", "),
            reason,
        })?;
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
