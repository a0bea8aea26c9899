//! The raw samples of signals, as a bag or a CSV file has them: with their own stamps, in SI units,
//! not yet on one grid.
//!
//! What comes in is an open recording and where each signal stands; what goes out are [`Stream`]s.
//! A caller who asks for a few signals at a time keeps only those in memory.

use std::path::{Path, PathBuf};

use super::definition::{Definition, FieldPath, Value};
use super::error::BagError;
use super::mapping::{Column, CsvLayout, Mapping, Place, Signal, SignalSource, Stamp};
use super::reader::{BagReader, Topic};
use super::trace::csv_error;
use crate::message::*;

/// Most samples that memory is set aside for before they are read.
const RESERVE: u64 = 16_000_000;

/// Samples of signals that come with the same stamps.
#[derive(Debug, Clone, Default)]
pub(crate) struct Stream {
    pub signals: Vec<Signal>,
    /// Where each signal comes from, for people.
    pub places: Vec<String>,
    /// When each sample was taken, ns, in the order of the recording.
    pub stamps: Vec<i64>,
    /// Values of each signal, SI; NaN where a message has none.
    pub values: Vec<Vec<f64>>,
    /// What a user should know about how they were read.
    pub notes: Vec<String>,
}

/// Signals to be read with one stamp.
#[derive(Debug, Clone)]
pub(crate) struct Request {
    pub signals: Vec<(Signal, SignalSource)>,
}

/// An open recording.
pub(crate) enum Source {
    Bag(BagReader),
    Csv { path: PathBuf, layout: CsvLayout, time: Option<SignalSource>, rate: Option<f64> },
}

impl Source {
    /// Opens a bag, or a CSV file if `path` is one (`.csv`, `.tsv`, `.txt`).
    pub fn open(path: &Path, mapping: Option<&Mapping>) -> Result<(Self, Mapping), BagError> {
        let is_csv = is_csv(path);
        let mapping = match mapping {
            Some(mapping) => mapping.clone(),
            None if is_csv => Mapping::own_csv(),
            None => Mapping::own_bag(),
        };
        // What is not there is neither.
        if path.exists() && mapping.is_for_csv() != is_csv {
            let (is, wants) = if is_csv { ("a CSV file", "topics") } else { ("a bag", "columns") };
            return Err(BagError::Mapping {
                origin: path.display().to_string(),
                key: "signals".into(),
                reason: format!("the recording is {is}, but the mapping names {wants}"),
            });
        }
        let source = if is_csv {
            Self::Csv {
                path: path.to_owned(),
                layout: mapping.csv.clone(),
                time: mapping
                    .signals
                    .get(&Signal::Time)
                    .and_then(|sources| sources.first().cloned())
                    .filter(|_| {
                        mapping.asked_for || has_column(path, &mapping.csv, Signal::Time.name())
                    }),
                rate: mapping.rate,
            }
        } else {
            Self::Bag(BagReader::open(path)?)
        };
        Ok((source, mapping))
    }

    /// How many samples a place has, as far as that is known without reading them; none if it is
    /// not there.
    pub fn expected(&self, source: &SignalSource) -> Option<u64> {
        match (self, &source.place) {
            (Self::Bag(reader), Place::Topic { topic, .. }) => {
                reader.topic(topic).map(|t| t.messages).filter(|&messages| messages > 0)
            }
            (Self::Csv { path, layout, .. }, Place::Column(_)) => {
                CsvTable::open(path, layout).and_then(|table| table.column(source)).ok().map(|_| 0)
            }
            _ => None,
        }
    }

    /// What there is in place of something that is missing.
    pub fn inventory(&self) -> String {
        match self {
            Self::Bag(reader) if reader.topics().is_empty() => "no topics".into(),
            Self::Bag(reader) => {
                let names: Vec<String> = reader
                    .topics()
                    .iter()
                    .map(|t| format!("{} ({})", t.name, t.type_name))
                    .collect();
                names.join(", ")
            }
            Self::Csv { path, layout, .. } => match CsvTable::open(path, layout) {
                Ok(table) => table.names(),
                Err(error) => error.to_string(),
            },
        }
    }

    /// Reads each request as a stream; one pass over the recording.
    pub fn read(&self, requests: &[Request], joint: &str) -> Result<Vec<Stream>, BagError> {
        match self {
            Self::Bag(reader) => read_bag(reader, requests, joint),
            Self::Csv { path, layout, time, rate, .. } => {
                read_csv(path, layout, time.as_ref(), *rate, requests)
            }
        }
    }
}

/// Whether a path is a CSV file, by its ending: `.csv`, `.tsv` or `.txt`.
pub fn is_csv(path: &Path) -> bool {
    let ending = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    ending.is_some_and(|e| ["csv", "tsv", "txt"].contains(&e.as_str())) && !path.is_dir()
}

fn has_column(path: &Path, layout: &CsvLayout, name: &str) -> bool {
    CsvTable::open(path, layout).is_ok_and(|table| table.names.iter().any(|n| n == name))
}

impl Stream {
    fn new(request: &Request, expected: u64) -> Self {
        let expected = expected.min(RESERVE) as usize;
        Self {
            signals: request.signals.iter().map(|(signal, _)| *signal).collect(),
            places: request.signals.iter().map(|(_, source)| source.place.to_string()).collect(),
            stamps: Vec::with_capacity(expected),
            values: request.signals.iter().map(|_| Vec::with_capacity(expected)).collect(),
            notes: Vec::new(),
        }
    }
}

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
    fn new(reader: &BagReader, request: &Request) -> Result<Self, BagError> {
        let mut found: Option<Self> = None;
        for (_, source) in &request.signals {
            let Place::Topic { topic: name, field, stamp } = &source.place else {
                continue;
            };
            let unknown = |topic: Option<&Topic>, reason: String| BagError::Field {
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
                        let path = definition.path(text).map_err(|reason| BagError::Field {
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
        found.ok_or_else(|| BagError::Mapping {
            origin: reader.path().display().to_string(),
            key: "signals".into(),
            reason: "a bag needs topics".into(),
        })
    }
}

fn read_bag(
    reader: &BagReader,
    requests: &[Request],
    joint: &str,
) -> Result<Vec<Stream>, BagError> {
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
            let failed = |reason: String| BagError::Field {
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
            let note = format!(
                "{}: all header stamps are {} ns, so the time of recording counts instead",
                extraction.topic, stamps[0]
            );
            streams[index] = read_bag(reader, &[request], joint)?.remove(0);
            streams[index].notes.push(note);
        }
    }
    Ok(streams)
}

/// The smallest time there is stands for none.
pub(super) const NO_TIME: i64 = i64::MIN;

/// Seconds as nanoseconds; NaN is no time.
fn seconds_to_nanos(seconds: f64) -> i64 {
    if seconds.is_nan() { NO_TIME } else { (seconds * 1e9).round() as i64 }
}

fn read_csv(
    path: &Path,
    layout: &CsvLayout,
    time: Option<&SignalSource>,
    rate: Option<f64>,
    requests: &[Request],
) -> Result<Vec<Stream>, BagError> {
    let mut table = CsvTable::open(path, layout)?;
    let time = match time {
        Some(source) => Some((table.column(source)?, source)),
        None => None,
    };
    if time.is_none() && rate.is_none() {
        return Err(BagError::MissingSignal {
            path: path.to_owned(),
            signal: Signal::Time.name(),
            needs: "a column `time`, or a mapping that says which column it is, or the `rate` of \
                    the rows"
                .into(),
            has: table.names(),
        });
    }
    let mut streams: Vec<Stream> = requests.iter().map(|request| Stream::new(request, 0)).collect();
    let mut columns = Vec::new();
    for request in requests {
        let found: Result<Vec<usize>, BagError> =
            request.signals.iter().map(|(_, source)| table.column(source)).collect();
        columns.push(found?);
    }
    let mut row = 0u64;
    while table.next()? {
        let stamp = match (&time, rate) {
            (Some((column, source)), _) => table.stamp(*column, source)?,
            (None, rate) => seconds_to_nanos(row as f64 / rate.unwrap_or(1.0)),
        };
        row += 1;
        for ((request, columns), stream) in requests.iter().zip(&columns).zip(&mut streams) {
            stream.stamps.push(stamp);
            for (((_, source), column), values) in
                request.signals.iter().zip(columns).zip(&mut stream.values)
            {
                values.push(source.to_si(table.number(*column)?));
            }
        }
    }
    Ok(streams)
}

/// A CSV file, read row by row.
pub(crate) struct CsvTable {
    path: PathBuf,
    layout: CsvLayout,
    names: Vec<String>,
    reader: csv::Reader<std::fs::File>,
    record: csv::StringRecord,
}

impl CsvTable {
    pub fn open(path: &Path, layout: &CsvLayout) -> Result<Self, BagError> {
        let mut reader = csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .delimiter(layout.delimiter)
            .comment(layout.comment)
            .has_headers(layout.header)
            .from_path(path)
            .map_err(|e| csv_error(path, e))?;
        let names = reader.headers().map_err(|e| csv_error(path, e))?;
        // an editor's byte order mark is no part of the first name
        let names =
            names.iter().map(|name| name.trim_start_matches('\u{feff}').to_owned()).collect();
        Ok(Self {
            path: path.to_owned(),
            layout: layout.clone(),
            names,
            reader,
            record: csv::StringRecord::new(),
        })
    }

    fn names(&self) -> String {
        if self.layout.header {
            self.names.join(", ")
        } else {
            format!("{} columns without names", self.names.len())
        }
    }

    /// Index of a column.
    pub fn column(&self, source: &SignalSource) -> Result<usize, BagError> {
        let missing = |reason: String| BagError::Csv { path: self.path.clone(), line: 1, reason };
        match &source.place {
            Place::Column(Column::Number(number)) if *number <= self.names.len() => Ok(number - 1),
            Place::Column(Column::Number(number)) => {
                Err(missing(format!("no column {number}, there are {}", self.names.len())))
            }
            Place::Column(Column::Name(name)) => {
                self.names.iter().position(|n| n == name).ok_or_else(|| {
                    let hint = friction_stage_core::model::nearest(
                        name,
                        self.names.iter().map(String::as_str),
                    );
                    missing(format!("no column {name:?}; columns are {:?}{hint}", self.names))
                })
            }
            place @ Place::Topic { .. } => {
                Err(missing(format!("{place} is a topic, not a column")))
            }
        }
    }

    /// Goes to the next row; false at the end.
    pub fn next(&mut self) -> Result<bool, BagError> {
        self.reader.read_record(&mut self.record).map_err(|e| csv_error(&self.path, e))
    }

    fn field(&self, column: usize) -> &str {
        self.record.get(column).unwrap_or("")
    }

    fn wrong(&self, column: usize) -> BagError {
        let name = self.names.get(column).map_or("", String::as_str);
        BagError::Csv {
            path: self.path.clone(),
            line: self.record.position().map_or(0, csv::Position::line),
            reason: format!(
                "{:?} in column {} ({name}) is not a number",
                self.field(column),
                column + 1
            ),
        }
    }

    /// The number in a column of this row; NaN for an empty field.
    pub fn number(&self, column: usize) -> Result<f64, BagError> {
        let field = self.field(column);
        if field.is_empty() {
            return Ok(f64::NAN);
        }
        let parsed =
            if self.layout.decimal_comma { field.replace(',', ".").parse() } else { field.parse() };
        parsed.map_err(|_| self.wrong(column))
    }

    /// The time in a column of this row, ns; exact for whole nanoseconds.
    pub fn stamp(&self, column: usize, source: &SignalSource) -> Result<i64, BagError> {
        if source.unit == 1e-9
            && source.scale == 1.0
            && source.offset == 0.0
            && let Ok(nanoseconds) = self.field(column).parse()
        {
            return Ok(nanoseconds);
        }
        Ok(seconds_to_nanos(source.to_si(self.number(column)?)))
    }
}
