//! The raw samples of signals in the messages of a bag: any field of any type that the bag
//! defines.

use std::collections::BTreeSet;

use super::data_quality::{JointDoubt, SignalNote};
use super::error::SignalError;
use super::mapping::{Place, Signal, SignalSource, Stamp};
use super::source::{Request, Stream, refuse_impossible, seconds_to_nanos};
use super::window::Span;
use crate::bag::{BagReader, Topic, topics};
use crate::message::type_layout::{FieldPath, TypeLayout, Value};

/// Topics that an error lists.
const LISTED: usize = 50;

/// What a bag has, for people.
pub(super) fn inventory(reader: &BagReader) -> String {
    let topics = reader.topics();
    if topics.is_empty() {
        return "no topics".into();
    }
    let listed = topics.iter().take(LISTED);
    let mut names: Vec<String> =
        listed.map(|topic| format!("{} ({})", topic.name, topic.type_name)).collect();
    if topics.len() > LISTED {
        names.push(format!("{} more", topics.len() - LISTED));
    }
    names.join(", ")
}

/// How many messages the topic of a place has; `None` where there are none.
pub(super) fn messages(reader: &BagReader, source: &SignalSource) -> Option<u64> {
    let Place::Topic { topic, .. } = &source.place else { return None };
    reader.topic(topic).map(|topic| topic.messages).filter(|messages| *messages > 0)
}

/// Whether a bag has messages with the field of a place.
pub(super) fn has_samples(reader: &BagReader, source: &SignalSource) -> bool {
    let Place::Topic { topic, field, .. } = &source.place else { return false };
    let Some(topic) = reader.topic(topic).filter(|topic| topic.messages > 0) else { return false };
    layout(topic, &[field]).is_ok_and(|layout| layout.path(field).is_ok())
}

/// The layout of a topic's messages: by the definition in the bag, or our own for types that this
/// program knows. Where nothing says the type, that of the fitting ones which alone has the
/// `fields`.
fn layout(topic: &Topic, fields: &[&str]) -> Result<TypeLayout, String> {
    if topic.type_name.is_empty() {
        let fitting = topic.fitting_types.iter().filter_map(|name| {
            let layout = TypeLayout::parse(name, "").ok()?;
            let has_all = fields.iter().all(|field| layout.path(field).is_ok());
            has_all.then_some((name.as_str(), layout))
        });
        let mut fitting: Vec<(&str, TypeLayout)> = fitting.collect();
        let names: Vec<&str> = fitting.iter().map(|(name, _)| *name).collect();
        return match names.as_slice() {
            [_] => Ok(fitting.remove(0).1),
            names => Err(format!(
                "the bag does not say of which type its messages are{}; a metadata.yaml beside \
                 the file whose topics_with_message_count gives the type of {} does",
                match names {
                    [] => ", and they are of no known type with these fields".to_owned(),
                    names => format!(", and they may be {}", names.join(" or ")),
                },
                topic.name
            )),
        };
    }
    let (text, is_known) = (&topic.definition, topic.is_of_known_type());
    if topic.schema_encoding == "ros2msg" && !text.is_empty() {
        TypeLayout::parse(&topic.type_name, &String::from_utf8_lossy(text))
    } else if is_known {
        TypeLayout::parse(&topic.type_name, "")
    } else {
        let what = match topic.schema_encoding.as_str() {
            "" => "the bag has no definition of its type".to_owned(),
            _ if text.is_empty() => "the bag has no definition of its type".to_owned(),
            encoding => format!("the bag defines its type in {encoding}, read is ros2msg"),
        };
        Err(format!(
            "{what}; with the package {} installed, `ros2 bag convert` to mcap (from Iron on) \
             adds one",
            topic.type_name.split('/').next().unwrap_or("of the type")
        ))
    }
}

/// A request with its paths found in the type of its topic.
struct Extraction {
    topic: String,
    layout: TypeLayout,
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
            let topic = reader.topic(name).ok_or_else(|| unknown(None, no_such_topic(reader)))?;
            if topic.message_encoding != "cdr" {
                return Err(unknown(
                    Some(topic),
                    format!("its messages are in {}, read is cdr", topic.message_encoding),
                ));
            }
            if found.is_none() {
                let fields: Vec<&str> = request
                    .signals
                    .iter()
                    .filter_map(|(_, source)| match &source.place {
                        Place::Topic { field, .. } => Some(field.as_str()),
                        Place::Column(_) => None,
                    })
                    .collect();
                let layout =
                    layout(topic, &fields).map_err(|reason| unknown(Some(topic), reason))?;
                let (path, publish_time, automatic) = match stamp {
                    Stamp::Auto | Stamp::IntervalEnd => match layout.path("header.stamp") {
                        Ok(path) => (Some(path), false, true),
                        Err(_) => (None, false, false),
                    },
                    Stamp::LogTime => (None, false, false),
                    Stamp::PublishTime => (None, true, false),
                    Stamp::Field(text) => {
                        let path = layout.path(text).map_err(|reason| SignalError::Field {
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
                    layout,
                    stamp: path,
                    publish_time,
                    sources: Vec::new(),
                    automatic,
                });
            }
            if let Some(extraction) = &mut found {
                let path =
                    extraction.layout.path(field).map_err(|reason| unknown(Some(topic), reason))?;
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

fn no_such_topic(reader: &BagReader) -> String {
    let names: Vec<&str> =
        reader.topics().iter().map(|topic| topic.name.as_str()).take(Joints::MOST).collect();
    match reader.topics().len().saturating_sub(names.len()) {
        0 => format!("the bag has no such topic; it has {}", names.join(", ")),
        more => {
            format!("the bag has no such topic; it has {} and {more} more", names.join(", "))
        }
    }
}

/// What the messages of a topic say of one field: how often it is there, and whose it is.
#[derive(Default)]
struct Seen {
    messages: u64,
    values: u64,
    /// Elements of the longest array that should have it.
    elements: usize,
    /// Names in the first message that has some.
    names: Vec<String>,
    doubts: Vec<JointDoubt>,
}

impl Seen {
    fn value(&mut self, value: Option<&Value>, elements: Option<usize>) {
        self.messages += 1;
        self.values += u64::from(value.is_some());
        self.elements = self.elements.max(elements.unwrap_or(0));
    }

    /// The names of a message, of which the one that is read has this index or name.
    fn names(&mut self, names: Vec<String>, element: Option<usize>, joint: &str, values: usize) {
        let mut doubts = Vec::new();
        let unnamed = element.is_some() && names.is_empty();
        if values > 0 && names.len() != values && !unnamed {
            doubts.push(JointDoubt::Lengths { names: names.len(), values });
        }
        let wanted = element.and_then(|index| names.get(index)).map_or(joint, String::as_str);
        if names.iter().filter(|name| *name == wanted).count() > 1 {
            doubts.push(JointDoubt::Twice { joint: wanted.to_owned() });
        }
        if let Some(index) = element
            && let (Some(first), Some(other)) = (self.names.get(index), names.get(index))
            && first != other
        {
            let (first, other) = (first.clone(), other.clone());
            doubts.push(JointDoubt::Order { index, first, other });
        }
        for doubt in doubts {
            let is_known = |known: &JointDoubt| {
                std::mem::discriminant(known) == std::mem::discriminant(&doubt)
            };
            if !self.doubts.iter().any(is_known) {
                self.doubts.push(doubt);
            }
        }
        if self.names.is_empty() {
            self.names = names;
        }
    }

    /// Why a field is in no message, although there are messages.
    fn why_absent(&self, path: &FieldPath, place: &str) -> Option<String> {
        if self.messages == 0 || self.values > 0 {
            return None;
        }
        let number = place.replace("[joint]", "[0]");
        Some(match path.element() {
            Some(index) => format!(
                "no message has an element {index}: the longest array has {} (they count from 0)",
                self.elements
            ),
            None if self.elements > 0 => format!(
                "the longest array has {} elements, too few for this joint's place among the names",
                self.elements
            ),
            None if place != number && self.names.is_empty() => format!(
                "its messages name no joint, so `[joint]` finds none: give the number, as in \
                 `{number}`"
            ),
            None => return None,
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
            Err(format!(
                "no joint {wanted}; its messages name {}: say which in the mapping, with a line \
                 `joint: {}`",
                others.join(", "),
                others[0]
            ))
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
    span: Span,
) -> Result<Vec<Stream>, SignalError> {
    let mut extractions = Vec::new();
    let mut streams = Vec::new();
    for request in requests {
        let extraction = Extraction::new(reader, request)?;
        let expected = reader.topic(&extraction.topic).map_or(0, |t| t.messages);
        streams.push(Stream::new(request, expected, span));
        extractions.push(extraction);
    }
    let mut joints: Vec<Joints> = extractions.iter().map(|_| Joints::new(joint)).collect();
    let mut seen: Vec<Vec<Seen>> = extractions
        .iter()
        .map(|extraction| extraction.sources.iter().map(|_| Seen::default()).collect())
        .collect();
    let mut row = Vec::new();
    for message in reader.messages() {
        let message = message?;
        let places = extractions.iter().zip(&mut joints).zip(&mut streams).zip(&mut seen);
        for (((extraction, joints), stream), seen) in places {
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
            let layout = &extraction.layout;
            let plain = layout.plain(&message).map_err(failed)?;
            let sources = extraction.sources.iter().zip(&stream.signals).zip(seen);
            for (((path, source), signal), seen) in sources {
                let joint = joints.wanted(|| layout.joints(path, &plain)).map_err(failed)?;
                let (value, elements) =
                    layout.value_in_array(path, joint, &plain).map_err(failed)?;
                seen.value(value.as_ref(), elements);
                let names = layout.listed(path, &plain).map_err(failed)?;
                if !names.is_empty() {
                    seen.names(names, path.element(), joint, elements.unwrap_or(0));
                }
                let value = value.map(|value| source.to_si(value.as_f64()));
                refuse_impossible(*signal, value.unwrap_or(0.0)).map_err(failed)?;
                row.push(value);
            }
            if row.iter().all(Option::is_none) {
                for (path, _) in &extraction.sources {
                    joints.heard(layout.joints(path, &plain).map_err(failed)?);
                }
                continue;
            }
            let stamp = match &extraction.stamp {
                Some(path) => match layout.value(path, joints.read(), &plain).map_err(failed)? {
                    Some(Value::Nanoseconds(stamp)) => stamp,
                    Some(value) => seconds_to_nanos(value.as_f64()),
                    None => continue,
                },
                None => {
                    let time = if extraction.publish_time {
                        message.publish_time
                    } else {
                        message.log_time
                    };
                    i64::try_from(time).unwrap_or(i64::MAX)
                }
            };
            stream.push(stamp, row.iter().map(|value| value.unwrap_or(f64::NAN)));
        }
        if streams.iter().all(|stream| stream.is_done) {
            break;
        }
    }
    for (index, extraction) in extractions.iter().enumerate() {
        // Without a mapping only the position must be there.
        let is_needed = |(signal, _): &(Signal, SignalSource)| {
            [Signal::Position, Signal::Velocity].contains(signal)
        };
        let is_empty = streams[index].stamps.is_empty();
        let mut absent = None;
        let sources = extraction.sources.iter().zip(&seen[index]).zip(&requests[index].signals);
        for (((path, source), seen), (signal, _)) in sources {
            let place = source.place.to_string();
            let doubts = seen.doubts.iter().cloned();
            let doubts = doubts.map(|doubt| SignalNote::Joints { place: place.clone(), doubt });
            streams[index].notes.extend(doubts);
            if is_empty && is_needed(&(*signal, source.clone())) {
                let field = place.rsplit(' ').next().unwrap_or(&place);
                absent = absent.or(seen.why_absent(path, field));
            } else if path.element().is_some() && seen.messages > 0 && seen.values == 0 {
                streams[index].notes.push(SignalNote::NoElement {
                    signal: *signal,
                    place,
                    elements: seen.elements,
                    messages: seen.messages,
                });
            }
        }
        let judged = if joint.is_some() || requests[index].signals.iter().any(is_needed) {
            joints[index].judge(is_empty).and(absent.map_or(Ok(()), Err))
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
            streams[index] = read_bag(reader, &[request], joint, span)?.remove(0);
            streams[index].notes.push(note);
        }
    }
    Ok(streams)
}
