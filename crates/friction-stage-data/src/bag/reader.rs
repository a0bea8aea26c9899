//! Reads recordings: rosbag2 directories of any version and single files, MCAP or sqlite3,
//! compressed by file, by message or by chunk, whole or cut off.
//!
//! Messages come in the order of log time, over all files of the bag. In memory are only the parts
//! of the files whose times overlap at the place that is being read.

use std::cmp::Reverse;
use std::collections::hash_map::Entry;
use std::collections::{BTreeMap, BinaryHeap, HashMap, VecDeque};
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rusqlite::Connection;

use super::error::BagError;
use super::file::{Attached, Channels, Damage, Directory, Layout, Span};
use super::limits;
use super::metadata::Found;
use super::provenance::{METADATA_NAME, MODEL_NAME, Provenance};
use super::sqlite::{Database, Position};
use super::storage::{Content, Files, StoredFile, ZSTD_MAGIC, check_compression, unpack_message};
use super::topics;
use super::writer::{HASH_KEY, QOS_KEY};
use crate::message::type_layout::TypeLayout;
use crate::message::{RosMessage, current_type_name, from_cdr, known};
use friction_stage_core::model::{ModelError, StageModel};

/// A topic of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topic {
    /// Name, with its leading `/`.
    pub name: String,
    /// Type, e.g. `sensor_msgs/msg/JointState`; empty if neither the file nor `metadata.yaml` says,
    /// and the messages do not show it.
    pub type_name: String,
    /// Language of the definition, `ros2msg` or `ros2idl`.
    pub schema_encoding: String,
    /// Definition of the type.
    pub definition: Vec<u8>,
    /// Encoding of the messages, `cdr`.
    pub message_encoding: String,
    /// What else the file says about it: offered QoS, type hash.
    pub metadata: BTreeMap<String, String>,
    /// Messages in the recording; for a recording without index, those that can be read.
    pub messages: u64,
    /// Where nothing but the messages shows the type: the known types that they fit, the type that
    /// is taken first.
    pub fitting_types: Vec<String>,
}

impl Topic {
    /// The offered QoS profiles as YAML, if the file has them.
    pub fn offered_qos(&self) -> Option<&str> {
        self.metadata.get(QOS_KEY).map(String::as_str)
    }

    /// The type hash, if the file has it.
    pub fn type_hash(&self) -> Option<&str> {
        self.metadata.get(HASH_KEY).map(String::as_str)
    }

    /// Whether the type is one that is read without a definition.
    pub(crate) fn is_of_known_type(&self) -> bool {
        self.type_name
            .split_once("/msg/")
            .is_some_and(|(package, name)| known::fields(&format!("{package}/{name}")).is_some())
    }
}

/// A message of a recording. Its bytes (CDR with encapsulation) are reached by dereferencing.
#[derive(Debug, Clone)]
pub struct BagMessage {
    /// The topic it was sent on.
    pub topic: Arc<Topic>,
    /// When it was recorded, ns.
    pub log_time: u64,
    /// When it was sent, ns.
    pub publish_time: u64,
    /// Number given by the recorder.
    pub sequence: u32,
    chunk: Arc<Vec<u8>>,
    from: usize,
    to: usize,
}

impl Deref for BagMessage {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.chunk[self.from..self.to]
    }
}

impl BagMessage {
    /// Decodes the message as `M`, which must be the type that the bag declares, by its name of
    /// today or of before.
    pub fn decode<M: RosMessage>(&self) -> Result<M, BagError> {
        let expected = M::type_name();
        if current_type_name(&self.topic.type_name) != expected {
            return Err(BagError::WrongType {
                topic: self.topic.name.clone(),
                found: self.topic.type_name.clone(),
                expected,
            });
        }
        from_cdr(self).map_err(|source| BagError::Decode {
            topic: self.topic.name.clone(),
            log_time: self.log_time,
            source,
        })
    }
}

/// A file of the recording.
struct OpenFile {
    stored: StoredFile,
    /// Channels of an MCAP file; a complete file has them in its index.
    directory: Directory,
    /// Topic of each channel, or of each number of a database.
    topics: BTreeMap<i64, Arc<Topic>>,
}

/// A recording, opened.
pub struct BagReader {
    path: PathBuf,
    files: Vec<OpenFile>,
    topics: Vec<Arc<Topic>>,
    provenance: Option<Provenance>,
    has_metadata: bool,
    metadata_count: Option<u64>,
    missing: Vec<Damage>,
    /// Whether a definition was damaged and is that of the program now.
    has_mended: bool,
}

impl std::fmt::Debug for BagReader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("BagReader")
            .field("path", &self.path)
            .field("files", &self.files.len())
            .field("topics", &self.topics.len())
            .finish_non_exhaustive()
    }
}

impl BagReader {
    /// Opens a rosbag2 directory or one of its files. A cut-off recording opens:
    /// [`damage`](Self::damage) says where it ends. An error means that nothing of it can be read.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, BagError> {
        let path = path.as_ref();
        let kind = std::fs::metadata(path).map_err(|e| BagError::reading(path, e))?;
        let Files { paths, mut missing, metadata } = if kind.is_dir() {
            Files::of_directory(path)?
        } else {
            Files { paths: vec![path.to_owned()], missing: Vec::new(), metadata: None }
        };
        if let Some(metadata) = &metadata {
            check_compression(path, metadata)?;
        }
        let mut files = Vec::new();
        let several = paths.len() > 1;
        for file in paths {
            let opened = StoredFile::open(&file);
            let storage = metadata.as_ref().map_or("", Found::storage_identifier);
            match opened {
                Ok(stored) => files.push(OpenFile::new(stored)),
                // one file of several does not make the rest unreadable
                Err(error) if several => missing.push(Damage {
                    path: file,
                    offset: error.offset().unwrap_or(0),
                    bytes: 0,
                    expected: "a readable file of a bag".into(),
                    found: error.to_string(),
                }),
                Err(BagError::UnknownFormat { .. }) if !READ_STORAGES.contains(&storage) => {
                    return Err(BagError::NotABag {
                        path: path.to_owned(),
                        reason: format!(
                            "its storage is {storage:?}, read are mcap and sqlite3; \
                             `ros2 bag convert` makes one from the other"
                        ),
                    });
                }
                Err(error) => return Err(error),
            }
        }
        if files.is_empty() {
            let what = missing.iter().map(|damage| damage.found.as_str());
            return Err(BagError::NotABag {
                path: path.to_owned(),
                reason: format!(
                    "none of its files can be read: {}",
                    what.collect::<Vec<_>>().join("; ")
                ),
            });
        }
        for file in &files {
            if let Some(metadata) = file.own_metadata() {
                check_compression(file.path(), &metadata)?;
            }
        }
        let provenance = files.iter().filter_map(OpenFile::layout).find_map(|layout| {
            let (_, map) = layout.metadata.iter().find(|(n, _)| n == METADATA_NAME)?;
            let model = layout.attachments.iter().find(|a| a.name == MODEL_NAME);
            let model = model
                .and_then(|model| layout.attached(model).ok())
                .map_or_else(String::new, |model| {
                    String::from_utf8_lossy(&model.data).into_owned()
                });
            Some(Provenance::from_map(map.clone(), model))
        });
        let mut reader = Self {
            path: path.to_owned(),
            files,
            topics: Vec::new(),
            provenance,
            has_metadata: metadata.is_some(),
            metadata_count: metadata.as_ref().and_then(Found::message_count),
            missing,
            has_mended: false,
        };
        reader.find_topics(metadata.as_ref())?;
        Ok(reader)
    }

    /// Takes in the topics of all files. Where a file does not say the type, `metadata` does, the
    /// copy of it in a file, or the messages.
    fn find_topics(&mut self, metadata: Option<&Found>) -> Result<(), BagError> {
        let mut found: Vec<(usize, i64, Topic)> = Vec::new();
        for (index, file) in self.files.iter_mut().enumerate() {
            let topics = file.topics_in_it()?;
            found.extend(topics.into_iter().map(|(id, topic)| (index, id, topic)));
        }
        let definitions: u64 = found.iter().map(|(.., topic)| topic.definition.len() as u64).sum();
        refuse_definitions(&self.path, found.len(), definitions)?;
        let mut merged: Vec<Topic> = Vec::new();
        let mut places: HashMap<&str, usize> = HashMap::new();
        for (_, _, topic) in &found {
            match places.entry(&topic.name) {
                Entry::Occupied(known) => merged[*known.get()].messages += topic.messages,
                Entry::Vacant(place) => {
                    place.insert(merged.len());
                    merged.push(topic.clone());
                }
            }
        }
        let inside: Vec<Found> = self.files.iter().filter_map(OpenFile::own_metadata).collect();
        for topic in &mut merged {
            if topic.type_name.is_empty() {
                let mut all = metadata.into_iter().chain(&inside);
                let kind = all.find_map(|metadata| metadata.type_of(&topic.name));
                topic.type_name = kind.unwrap_or_default().to_owned();
            }
            topic.type_name = known::full_name(&topic.type_name);
        }
        let share = |topics: Vec<Topic>, files: &mut [OpenFile]| -> Vec<Arc<Topic>> {
            let topics: Vec<Arc<Topic>> = topics.into_iter().map(Arc::new).collect();
            for (file, id, topic) in &found {
                if let Some(place) = places.get(topic.name.as_str()) {
                    files[*file].topics.insert(*id, Arc::clone(&topics[*place]));
                }
            }
            topics
        };
        self.topics = share(merged.clone(), &mut self.files);
        let mut shown = self.types_by_messages();
        for topic in &mut merged {
            if let Some((kind, fitting)) = shown.remove(&topic.name) {
                topic.type_name = kind.unwrap_or_default();
                topic.fitting_types = fitting;
            }
            let (kind, encoding) = (&topic.type_name, &topic.schema_encoding);
            if let Some(text) = known::mended(kind, encoding, &topic.definition) {
                self.has_mended |= !topic.definition.is_empty();
                topic.schema_encoding = "ros2msg".into();
                topic.definition = text.into_bytes();
                // A type of ROS 2 is in nothing else.
                topic.message_encoding = "cdr".into();
            }
        }
        self.topics = share(merged, &mut self.files);
        Ok(())
    }

    /// For topics without a type: the known types that their first messages fit to the last byte.
    /// One of them is the type if there is no other, or if it has more text in it than any other:
    /// numbers hardly ever pass for text.
    fn types_by_messages(&self) -> BTreeMap<String, (Option<String>, Vec<String>)> {
        struct Candidate {
            name: String,
            layout: TypeLayout,
            text: usize,
        }
        let is_unknown = |topic: &&Arc<Topic>| {
            topic.type_name.is_empty() && topic.message_encoding == "cdr" && topic.messages > 0
        };
        let mut candidates: BTreeMap<&str, (usize, Vec<Candidate>)> = BTreeMap::new();
        for topic in self.topics.iter().filter(is_unknown) {
            let all = known::names().filter_map(|name| {
                let name = known::full_name(&name);
                let layout = TypeLayout::parse(&name, "").ok()?;
                Some(Candidate { name, layout, text: 0 })
            });
            candidates.insert(topic.name.as_str(), (0, all.collect()));
        }
        if candidates.is_empty() {
            return BTreeMap::new();
        }
        for message in self.messages().take(LOOKED_AT).filter_map(Result::ok) {
            if let Some((count, candidates)) = candidates.get_mut(message.topic.name.as_str())
                && *count < ENOUGH
            {
                candidates.retain_mut(|candidate| {
                    let text = candidate.layout.text_if_it_fits(&message);
                    candidate.text += text.unwrap_or(0);
                    text.is_some()
                });
                *count += 1;
            }
            if candidates.values().all(|(count, _)| *count >= ENOUGH) {
                break;
            }
        }
        let chosen = |(topic, (count, mut found)): (&str, (usize, Vec<Candidate>))| {
            if count == 0 {
                found.clear();
            }
            found.sort_by_key(|candidate| Reverse(candidate.text));
            let is_sure = match found.as_slice() {
                [] => false,
                [_] => true,
                [first, second, ..] => first.text > second.text,
            };
            let names: Vec<String> = found.into_iter().map(|candidate| candidate.name).collect();
            (topic.to_owned(), (names.first().filter(|_| is_sure).cloned(), names))
        };
        candidates.into_iter().map(chosen).collect()
    }

    /// The path that was opened.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The topics, in the order of their appearance.
    pub fn topics(&self) -> &[Arc<Topic>] {
        &self.topics
    }

    /// The topic of this name.
    pub fn topic(&self, name: &str) -> Option<&Arc<Topic>> {
        self.topics.iter().find(|t| t.name == name)
    }

    /// The namespace of the stage that was recorded; empty without one, or with several stages.
    pub fn namespace(&self) -> &str {
        topics::namespace(self.topics.iter().map(|topic| topic.name.as_str()))
    }

    /// The place of each topic among [`topics`](Self::topics), by its name.
    pub(crate) fn places(&self) -> HashMap<&str, usize> {
        self.topics.iter().enumerate().map(|(place, topic)| (topic.name.as_str(), place)).collect()
    }

    /// Where the recording comes from, if it says.
    pub fn provenance(&self) -> Option<&Provenance> {
        self.provenance.as_ref()
    }

    /// The stage that was recorded, if the recording says.
    pub fn model(&self) -> Result<Option<StageModel>, ModelError> {
        let text = self.provenance.as_ref().map(|provenance| provenance.model_yaml.as_str());
        text.filter(|text| !text.is_empty())
            .map(|text| {
                StageModel::from_yaml(text, &format!("{MODEL_NAME} in {}", self.path.display()))
            })
            .transpose()
    }

    /// Messages over all topics.
    pub fn message_count(&self) -> u64 {
        self.topics.iter().map(|t| t.messages).sum()
    }

    /// Bytes of the data files.
    pub fn size(&self) -> u64 {
        self.files.iter().map(OpenFile::size).sum()
    }

    /// First and last log time, ns, as the files say.
    pub fn time_range(&self) -> Option<(u64, u64)> {
        let ranges = self.files.iter().filter_map(OpenFile::time_range);
        ranges.reduce(|(begin, end), (first, last)| (begin.min(first), end.max(last)))
    }

    /// Places that are not as they should be, as far as they show without reading the messages.
    pub fn damage(&self) -> Vec<Damage> {
        self.missing.iter().chain(self.files.iter().flat_map(OpenFile::damage)).cloned().collect()
    }

    /// Whether every file ends with its index and nothing is known to be damaged. What is inside
    /// the chunks shows only when the messages are read.
    pub fn is_complete(&self) -> bool {
        self.missing.is_empty() && self.files.iter().all(OpenFile::is_complete)
    }

    /// Whether a definition in it is damaged, in whose place that of the program is read.
    pub(crate) fn has_mended(&self) -> bool {
        self.has_mended
    }

    /// Whether the recording is a directory with a readable `metadata.yaml`.
    pub fn has_metadata(&self) -> bool {
        self.has_metadata
    }

    /// Messages that `metadata.yaml` counts, if there is one that does.
    pub fn declared_count(&self) -> Option<u64> {
        self.metadata_count
    }

    /// Compares the checksums of the files; reads all of their bytes.
    pub fn verify_checksums(&self) -> Result<Vec<Damage>, BagError> {
        let mut damage = Vec::new();
        for file in &self.files {
            damage.extend(match &file.stored.content {
                Content::Mcap(layout) => layout.verify_checksum()?,
                // of what is known to be damaged it would say so again
                Content::Sqlite(database) if database.damage.is_empty() => database.verify(),
                Content::Sqlite(_) => None,
            });
        }
        Ok(damage)
    }

    /// Bytes of the part of a file that begins at `offset`; 0 if none does.
    pub(crate) fn span_length(&self, path: &Path, offset: u64) -> u64 {
        self.files
            .iter()
            .filter_map(OpenFile::layout)
            .filter(|layout| layout.path == path)
            .find_map(|layout| {
                // They are in the order of the file.
                let place = layout.spans.binary_search_by_key(&offset, |span| span.offset).ok()?;
                Some(layout.spans[place].length)
            })
            .unwrap_or(0)
    }

    /// MCAP metadata records: name and entries.
    pub fn metadata(&self) -> impl Iterator<Item = &(String, BTreeMap<String, String>)> {
        self.files.iter().filter_map(OpenFile::layout).flat_map(|layout| &layout.metadata)
    }

    /// Attachments, for copying.
    pub(crate) fn attachments(&self) -> impl Iterator<Item = Result<Attached, BagError>> {
        self.files.iter().filter_map(OpenFile::layout).flat_map(|layout| {
            layout.attachments.iter().map(|attachment| layout.attached(attachment))
        })
    }

    /// All messages in the order of log time; messages of the same time as they stand in the file.
    /// A damaged place is an error in the sequence: those that follow an error are the messages
    /// after the place. Damage that [`damage`](Self::damage) lists comes last.
    pub fn messages(&self) -> Messages<'_> {
        let mut parts = BinaryHeap::new();
        for (file, open) in self.files.iter().enumerate() {
            let mut add = |begin: u64, order: u64, part: PartKind| {
                parts.push(Reverse(Part { begin, file, order, part }));
            };
            match &open.stored.content {
                Content::Mcap(layout) => {
                    layout.spans.iter().for_each(|span| {
                        add(span.start, span.offset, PartKind::Span(*span));
                    });
                }
                Content::Sqlite(database) => {
                    let begin = database.range.map_or(0, |(first, _)| log_time(first));
                    add(begin, 0, PartKind::Rows(database.begin()));
                }
            }
        }
        Messages {
            reader: self,
            parts,
            connections: BTreeMap::new(),
            heap: BinaryHeap::new(),
            open: HashMap::new(),
            open_bytes: 0,
            room: limits::unpacked(self.size()),
            errors: VecDeque::new(),
            last: self.damage().into(),
            ordinal: 0,
        }
    }
}

/// Storages that a bag may name; a reindexed one names none.
const READ_STORAGES: [&str; 3] = ["", "mcap", "sqlite3"];
/// Messages that show the type of a topic.
const ENOUGH: usize = 16;
/// Messages that are looked at for that, over all topics.
const LOOKED_AT: usize = 20_000;

/// Refuses more definitions than are taken in: each topic has a copy of its own.
fn refuse_definitions(path: &Path, topics: usize, bytes: u64) -> Result<(), BagError> {
    if bytes <= limits::DEFINITIONS {
        return Ok(());
    }
    let reason = format!(
        "the definitions of its {topics} topics have {bytes} bytes together, read are at most {}",
        limits::DEFINITIONS
    );
    Err(BagError::NotABag { path: path.to_owned(), reason })
}

/// A time of a database as log time, ns.
fn log_time(time: i64) -> u64 {
    u64::try_from(time).unwrap_or(0)
}

impl OpenFile {
    fn new(stored: StoredFile) -> Self {
        let directory = match &stored.content {
            Content::Mcap(layout) => layout.directory.clone(),
            Content::Sqlite(_) => Directory::default(),
        };
        Self { stored, directory, topics: BTreeMap::new() }
    }

    fn layout(&self) -> Option<&Layout> {
        match &self.stored.content {
            Content::Mcap(layout) => Some(layout),
            Content::Sqlite(_) => None,
        }
    }

    fn path(&self) -> &Path {
        match &self.stored.content {
            Content::Mcap(layout) => &layout.path,
            Content::Sqlite(database) => &database.path,
        }
    }

    fn size(&self) -> u64 {
        match &self.stored.content {
            Content::Mcap(layout) => layout.size(),
            Content::Sqlite(database) => database.size,
        }
    }

    fn damage(&self) -> &[Damage] {
        match &self.stored.content {
            Content::Mcap(layout) => &layout.damage,
            Content::Sqlite(database) => &database.damage,
        }
    }

    fn is_complete(&self) -> bool {
        self.damage().is_empty() && self.layout().is_none_or(|layout| layout.statistics.is_some())
    }

    fn time_range(&self) -> Option<(u64, u64)> {
        match &self.stored.content {
            Content::Mcap(layout) => {
                // a chunk of schemas only has no times
                let timed = || layout.spans.iter().filter(|s| s.end > 0);
                Some((timed().map(|s| s.start).min()?, timed().map(|s| s.end).max()?))
            }
            Content::Sqlite(database) => {
                database.range.map(|(first, last)| (log_time(first), log_time(last)))
            }
        }
    }

    /// What the file itself says of the recording, as `metadata.yaml` does.
    fn own_metadata(&self) -> Option<Found> {
        match &self.stored.content {
            Content::Mcap(layout) => {
                let (_, map) = layout.metadata.iter().find(|(name, _)| name == "rosbag2")?;
                Found::of_information(map.get("serialized_metadata")?)
            }
            Content::Sqlite(database) => database.metadata.clone(),
        }
    }

    /// The topics with what messages refer to them by.
    fn topics_in_it(&mut self) -> Result<Vec<(i64, Topic)>, BagError> {
        let layout = match &self.stored.content {
            Content::Mcap(layout) => layout,
            Content::Sqlite(database) => {
                let topic = |stored: &super::sqlite::StoredTopic| {
                    let (schema_encoding, definition) = stored.definition.clone();
                    let known = [(QOS_KEY, &stored.qos), (HASH_KEY, &stored.type_hash)];
                    let known = known.into_iter().filter(|(_, value)| !value.is_empty());
                    let topic = Topic {
                        name: stored.name.clone(),
                        type_name: stored.type_name.clone(),
                        schema_encoding,
                        definition: definition.into_bytes(),
                        message_encoding: match stored.encoding.as_str() {
                            "" => "cdr".into(),
                            encoding => encoding.into(),
                        },
                        metadata: known.map(|(k, v)| (k.to_owned(), v.clone())).collect(),
                        messages: stored.messages,
                        fitting_types: Vec::new(),
                    };
                    (stored.id, topic)
                };
                return Ok(database.topics.iter().map(topic).collect());
            }
        };
        let mut counts = BTreeMap::new();
        match &layout.statistics {
            Some(statistics)
                if layout.damage.is_empty()
                    && statistics.channel_count as usize == self.directory.channels.len() =>
            {
                counts.clone_from(&statistics.channel_message_counts);
            }
            _ => {
                // without an index the channels stand in the chunks only
                for span in &layout.spans {
                    let unpacked = layout.unpack(span, Channels::Noted(&mut self.directory))?;
                    for message in unpacked.messages {
                        *counts.entry(message.header.channel_id).or_insert(0) += 1;
                    }
                }
            }
        }
        let schemas = self.directory.channels.values().map(|channel| channel.schema_id);
        let schemas = schemas.filter_map(|id| self.directory.schemas.get(&id));
        let bytes = schemas.map(|schema| schema.data.len() as u64).sum();
        refuse_definitions(self.path(), self.directory.channels.len(), bytes)?;
        let topic = |(id, channel): (&u16, &mcap::records::Channel)| {
            let schema = self.directory.schemas.get(&channel.schema_id).cloned();
            let schema = schema.unwrap_or_default();
            let topic = Topic {
                messages: counts.get(id).copied().unwrap_or(0),
                name: channel.topic.clone(),
                type_name: schema.name,
                schema_encoding: schema.encoding,
                definition: schema.data,
                message_encoding: channel.message_encoding.clone(),
                metadata: channel.metadata.clone(),
                fitting_types: Vec::new(),
            };
            (i64::from(*id), topic)
        };
        Ok(self.directory.channels.iter().map(topic).collect())
    }
}

/// A part of a file that is not yet read.
struct Part {
    /// No message of it is earlier.
    begin: u64,
    file: usize,
    /// Its place among those of the same file and begin.
    order: u64,
    part: PartKind,
}

#[derive(Clone, Copy)]
enum PartKind {
    Span(Span),
    Rows(Position),
}

struct Waiting {
    key: (u64, u64),
    message: BagMessage,
    /// File, and place in it.
    place: (usize, u64),
}

/// By the first of these that differ.
macro_rules! ordered_by {
    ($kind:ty, |$it:ident| $key:expr) => {
        impl PartialEq for $kind {
            fn eq(&self, other: &Self) -> bool {
                self.cmp(other).is_eq()
            }
        }
        impl Eq for $kind {}
        impl PartialOrd for $kind {
            fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
                Some(self.cmp(other))
            }
        }
        impl Ord for $kind {
            fn cmp(&self, other: &Self) -> std::cmp::Ordering {
                let key = |$it: &Self| $key;
                key(self).cmp(&key(other))
            }
        }
    };
}
ordered_by!(Part, |part| (part.begin, part.file, part.order));
ordered_by!(Waiting, |waiting| waiting.key);

/// Messages of a recording in the order of log time, see [`BagReader::messages`].
pub struct Messages<'a> {
    reader: &'a BagReader,
    /// Parts not yet read, the earliest first.
    parts: BinaryHeap<Reverse<Part>>,
    /// To the databases that are being read.
    connections: BTreeMap<usize, Connection>,
    heap: BinaryHeap<Reverse<Waiting>>,
    /// Messages that wait of each part that is open, and the bytes that the part takes.
    open: HashMap<(usize, u64), (usize, u64)>,
    open_bytes: u64,
    /// Bytes that messages which are compressed one by one may still unpack to.
    room: u64,
    errors: VecDeque<BagError>,
    last: VecDeque<Damage>,
    ordinal: u64,
}

impl Messages<'_> {
    fn read(&mut self, part: &Part) {
        let file = &self.reader.files[part.file];
        match (part.part, &file.stored.content) {
            (PartKind::Span(span), Content::Mcap(layout)) => {
                self.unpack(part.file, layout, &span);
            }
            (PartKind::Rows(position), Content::Sqlite(database)) => {
                self.read_rows(part, database, position);
            }
            _ => {}
        }
    }

    /// Puts a message into the order of time.
    fn wait(&mut self, message: BagMessage, place: (usize, u64)) {
        self.ordinal += 1;
        let key = (message.log_time, self.ordinal);
        self.heap.push(Reverse(Waiting { key, message, place }));
    }

    fn unpack(&mut self, index: usize, layout: &Layout, span: &Span) {
        let file = &self.reader.files[index];
        let needed = span.unpacked;
        if self.open_bytes + needed > limits::OPEN {
            return self.errors.push_back(BagError::Broken {
                path: layout.path.clone(),
                offset: span.offset,
                expected: format!(
                    "chunks whose times overlap to have at most {} bytes together",
                    limits::OPEN
                ),
                found: format!("one of {needed} bytes beyond them"),
            });
        }
        // every channel is known since the bag was opened
        let unpacked = match layout.unpack(span, Channels::Known(&file.directory)) {
            Ok(unpacked) => unpacked,
            Err(error) => return self.errors.push_back(error),
        };
        let mut undeclared = None;
        let place = (index, span.offset);
        let bytes =
            unpacked.bytes.len() as u64 + unpacked.messages.len() as u64 * limits::BESIDE_MESSAGE;
        let mut waiting = 0;
        for located in unpacked.messages {
            let Some(topic) = file.topics.get(&i64::from(located.header.channel_id)) else {
                undeclared = Some(located.header.channel_id);
                continue;
            };
            let message = BagMessage {
                topic: Arc::clone(topic),
                log_time: located.header.log_time,
                publish_time: located.header.publish_time,
                sequence: located.header.sequence,
                chunk: Arc::clone(&unpacked.bytes),
                from: located.from,
                to: located.to,
            };
            self.wait(message, place);
            waiting += 1;
        }
        if waiting > 0 {
            self.open.insert(place, (waiting, bytes));
            self.open_bytes += bytes;
        }
        if let Some(damage) = unpacked.damage {
            self.errors.push_back(damage.error());
        }
        if let Some(channel) = undeclared {
            self.errors.push_back(BagError::Broken {
                path: layout.path.clone(),
                offset: span.offset,
                expected: "messages of channels that the index lists".into(),
                found: format!("channel {channel}"),
            });
        }
    }

    fn read_rows(&mut self, part: &Part, database: &Database, position: Position) {
        let connection = match self.connections.remove(&part.file) {
            Some(connection) => connection,
            None => match database.connect() {
                Ok(connection) => connection,
                Err(error) => {
                    return self.errors.push_back(database.broken(&error).error());
                }
            },
        };
        let page = database.page(&connection, position);
        let (mut begin, index) = (part.begin, part.file);
        let file = &self.reader.files[index];
        for stored in page.messages {
            // Messages of topics that the file does not list are damage since it was opened.
            let Some(topic) = file.topics.get(&stored.topic) else { continue };
            let time = log_time(stored.time);
            begin = begin.max(time);
            let message = BagMessage {
                topic: Arc::clone(topic),
                log_time: time,
                publish_time: time,
                sequence: 0,
                from: 0,
                to: stored.data.len(),
                chunk: Arc::new(stored.data),
            };
            self.wait(message, (index, 0));
        }
        if let Some(next) = page.next {
            self.connections.insert(index, connection);
            let order = part.order + 1;
            let part = PartKind::Rows(next);
            self.parts.push(Reverse(Part { begin, file: index, order, part }));
        }
        if let Some(damage) = page.damage.filter(|damage| !database.damage.contains(damage)) {
            self.errors.push_back(damage.error());
        }
    }

    /// A message of this part has had its turn.
    fn close(&mut self, place: (usize, u64)) {
        if let Some((waiting, bytes)) = self.open.get_mut(&place) {
            *waiting -= 1;
            if *waiting == 0 {
                self.open_bytes -= *bytes;
                self.open.remove(&place);
            }
        }
    }

    /// The message, unpacked if its recorder compressed it.
    fn unpacked(&mut self, waiting: Waiting) -> Result<BagMessage, BagError> {
        let mut message = waiting.message;
        if !message.starts_with(&ZSTD_MAGIC) {
            return Ok(message);
        }
        let most = self.room.min(limits::CHUNK);
        let bytes = unpack_message(&message, most).map_err(|found| BagError::Broken {
            path: self.reader.files[waiting.place.0].path().to_owned(),
            offset: waiting.place.1,
            expected: format!(
                "a message on {} at {} ns that unpacks with zstd to at most {most} bytes",
                message.topic.name, message.log_time
            ),
            found,
        })?;
        self.room -= bytes.len() as u64;
        (message.from, message.to) = (0, bytes.len());
        message.chunk = Arc::new(bytes);
        Ok(message)
    }
}

impl Iterator for Messages<'_> {
    type Item = Result<BagMessage, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(error) = self.errors.pop_front() {
                return Some(Err(error));
            }
            let earliest = self.heap.peek().map(|Reverse(waiting)| waiting.key.0);
            match self.parts.peek() {
                Some(Reverse(part)) if earliest.is_none_or(|time| part.begin <= time) => {
                    if let Some(Reverse(part)) = self.parts.pop() {
                        self.read(&part);
                    }
                }
                _ => break,
            }
        }
        if let Some(Reverse(waiting)) = self.heap.pop() {
            self.close(waiting.place);
            return Some(self.unpacked(waiting));
        }
        self.last.pop_front().map(|damage| Err(damage.error()))
    }
}
