//! Reads recordings: rosbag2 directories (any version, MCAP) and single MCAP files, whole or cut
//! off.
//!
//! Messages come in the order of log time, over all files of the bag. In memory are only the chunks
//! whose times overlap at the place that is being read.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};
use std::ops::Deref;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::error::BagError;
use super::file::{Damage, Directory, Layout, Schema, Span, StoredAttachment, scan};
use super::metadata::Information;
use super::provenance::{METADATA_NAME, MODEL_NAME, Provenance};
use super::writer::{HASH_KEY, QOS_KEY};
use crate::message::{RosMessage, current_type_name, from_cdr};
use friction_stage_core::model::{ModelError, StageModel};

/// A topic of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Topic {
    /// Name, with its leading `/`.
    pub name: String,
    /// Type, e.g. `sensor_msgs/msg/JointState`; empty if the file does not say.
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
    /// Decodes the message as `M`, which must be the type that the bag declares, by its name of today
    /// or of before.
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

/// A file of the recording with its channels resolved to topics.
struct OpenFile {
    layout: Layout,
    directory: Directory,
}

/// A recording, opened.
pub struct BagReader {
    path: PathBuf,
    files: Vec<OpenFile>,
    topics: Vec<Arc<Topic>>,
    provenance: Option<Provenance>,
    metadata_count: Option<u64>,
    missing: Vec<Damage>,
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
    /// Opens a rosbag2 directory or an MCAP file. A cut-off recording opens:
    /// [`damage`](Self::damage) says where it ends. An error means that nothing of it can be read.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, BagError> {
        let path = path.as_ref();
        let kind = std::fs::metadata(path).map_err(|e| BagError::reading(path, e))?;
        let (paths, metadata_count) =
            if kind.is_dir() { data_files(path)? } else { (vec![path.to_owned()], None) };
        let mut files = Vec::new();
        let mut missing = Vec::new();
        let several = paths.len() > 1;
        for file in paths {
            match scan(&file) {
                Ok(layout) => files.push(OpenFile { directory: layout.directory.clone(), layout }),
                // one file of several does not make the rest unreadable
                Err(error) if several => missing.push(Damage {
                    path: file,
                    offset: error.offset().unwrap_or(0),
                    bytes: 0,
                    expected: "a readable MCAP file".into(),
                    found: error.to_string(),
                }),
                Err(error) => return Err(error),
            }
        }
        let mut counts: BTreeMap<String, u64> = BTreeMap::new();
        for file in &mut files {
            let mut per_channel = BTreeMap::new();
            match &file.layout.statistics {
                Some(statistics)
                    if file.layout.damage.is_empty()
                        && statistics.channel_count as usize == file.directory.channels.len() =>
                {
                    per_channel.clone_from(&statistics.channel_message_counts);
                }
                _ => {
                    // without an index the channels stand in the chunks only
                    for span in &file.layout.spans {
                        let unpacked = file.layout.unpack(span, &mut file.directory)?;
                        for message in unpacked.messages {
                            *per_channel.entry(message.header.channel_id).or_insert(0) += 1;
                        }
                    }
                }
            }
            for (id, channel) in &file.directory.channels {
                *counts.entry(channel.topic.clone()).or_insert(0) +=
                    per_channel.get(id).copied().unwrap_or(0);
            }
        }
        let mut topics: Vec<Arc<Topic>> = Vec::new();
        for file in &files {
            for channel in file.directory.channels.values() {
                if topics.iter().any(|t| t.name == channel.topic) {
                    continue;
                }
                let schema =
                    file.directory.schemas.get(&channel.schema_id).cloned().unwrap_or_else(|| {
                        Schema { name: String::new(), encoding: String::new(), data: Vec::new() }
                    });
                topics.push(Arc::new(Topic {
                    messages: counts.get(&channel.topic).copied().unwrap_or(0),
                    name: channel.topic.clone(),
                    type_name: schema.name,
                    schema_encoding: schema.encoding,
                    definition: schema.data,
                    message_encoding: channel.message_encoding.clone(),
                    metadata: channel.metadata.clone(),
                }));
            }
        }
        let provenance = files.iter().find_map(|f| {
            let (_, map) = f.layout.metadata.iter().find(|(n, _)| n == METADATA_NAME)?;
            let model = f.layout.attachments.iter().find(|a| a.name == MODEL_NAME);
            let model =
                model.map_or_else(String::new, |a| String::from_utf8_lossy(&a.data).into_owned());
            Some(Provenance::from_map(map.clone(), model))
        });
        Ok(Self { path: path.to_owned(), files, topics, provenance, metadata_count, missing })
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
        self.files.iter().map(|f| f.layout.size()).sum()
    }

    /// First and last log time, ns, as the chunks say.
    pub fn time_range(&self) -> Option<(u64, u64)> {
        let spans = || self.files.iter().flat_map(|f| &f.layout.spans);
        // a chunk of schemas only has no times
        let timed = || spans().filter(|s| s.end > 0);
        Some((timed().map(|s| s.start).min()?, timed().map(|s| s.end).max()?))
    }

    /// Places that are not as they should be, as far as they show without reading the messages.
    pub fn damage(&self) -> Vec<Damage> {
        self.missing
            .iter()
            .chain(self.files.iter().flat_map(|f| &f.layout.damage))
            .cloned()
            .collect()
    }

    /// Whether every file ends with its index and nothing is known to be damaged. What is inside
    /// the chunks shows only when the messages are read.
    pub fn is_complete(&self) -> bool {
        self.missing.is_empty()
            && self
                .files
                .iter()
                .all(|f| f.layout.damage.is_empty() && f.layout.statistics.is_some())
    }

    /// Messages that `metadata.yaml` counts, if there is one.
    pub fn declared_count(&self) -> Option<u64> {
        self.metadata_count
    }

    /// Compares the checksums of the files; reads all of their bytes.
    pub fn verify_checksums(&self) -> Result<Vec<Damage>, BagError> {
        let mut damage = Vec::new();
        for file in &self.files {
            damage.extend(file.layout.verify_checksum()?);
        }
        Ok(damage)
    }

    /// Bytes of the part of a file that begins at `offset`; 0 if none does.
    pub(crate) fn span_length(&self, path: &Path, offset: u64) -> u64 {
        self.files
            .iter()
            .filter(|f| f.layout.path == path)
            .flat_map(|f| &f.layout.spans)
            .find(|s| s.offset == offset)
            .map_or(0, |s| s.length)
    }

    /// MCAP metadata records, for copying.
    pub(crate) fn metadata(&self) -> impl Iterator<Item = &(String, BTreeMap<String, String>)> {
        self.files.iter().flat_map(|f| &f.layout.metadata)
    }

    /// Attachments, for copying.
    pub(crate) fn attachments(&self) -> impl Iterator<Item = &StoredAttachment> {
        self.files.iter().flat_map(|f| &f.layout.attachments)
    }

    /// All messages in the order of log time; messages of the same time as they stand in the file.
    /// A damaged place is an error in the sequence: those that follow an error are the messages
    /// after the place. Damage that [`damage`](Self::damage) lists comes last.
    pub fn messages(&self) -> Messages<'_> {
        let mut spans: Vec<(usize, Span)> = self
            .files
            .iter()
            .enumerate()
            .flat_map(|(i, f)| f.layout.spans.iter().map(move |s| (i, *s)))
            .collect();
        // the earliest is taken from the end
        spans.sort_by_key(|&(file, s)| Reverse((s.start, file, s.offset)));
        let by_channel = self
            .files
            .iter()
            .map(|f| {
                f.directory
                    .channels
                    .values()
                    .filter_map(|c| Some((c.id, Arc::clone(self.topic(&c.topic)?))))
                    .collect()
            })
            .collect();
        Messages {
            reader: self,
            by_channel,
            spans,
            heap: BinaryHeap::new(),
            errors: Vec::new(),
            last: self.damage(),
            ordinal: 0,
        }
    }
}

/// The data files of a rosbag2 directory and the message count of its `metadata.yaml`. A directory
/// without `metadata.yaml`, or with a broken one, is its `*.mcap` files.
fn data_files(directory: &Path) -> Result<(Vec<PathBuf>, Option<u64>), BagError> {
    let not_a_bag = |reason: String| BagError::NotABag { path: directory.to_owned(), reason };
    let information = Information::read(directory);
    if let Ok(Some(information)) = &information {
        if information.storage_identifier != "mcap" {
            return Err(not_a_bag(format!(
                "its storage is {:?}, read is \"mcap\"; `ros2 bag convert` makes one from the \
                 other",
                information.storage_identifier
            )));
        }
        if !information.compression_mode.is_empty()
            && !information.compression_mode.eq_ignore_ascii_case("none")
        {
            return Err(not_a_bag(format!(
                "it is compressed by {} ({}), read are bags that are compressed by chunk inside \
                 the MCAP; `ros2 bag convert` makes one from the other",
                information.compression_mode, information.compression_format
            )));
        }
        let paths = information.paths(directory)?;
        if !paths.is_empty() && paths.iter().all(|p| p.is_file()) {
            return Ok((paths, Some(information.message_count)));
        }
    }
    let mut paths = Vec::new();
    let entries = std::fs::read_dir(directory).map_err(|e| BagError::reading(directory, e))?;
    for entry in entries {
        let path = entry.map_err(|e| BagError::reading(directory, e))?.path();
        if path.extension().is_some_and(|e| e == "mcap") && path.is_file() {
            paths.push(path);
        }
    }
    if paths.is_empty() {
        return match information {
            Err(error) => Err(error),
            Ok(Some(information)) => Err(not_a_bag(format!(
                "metadata.yaml names {:?}, which are not there",
                information.relative_file_paths
            ))),
            Ok(None) => Err(not_a_bag("it has neither metadata.yaml nor a file *.mcap".into())),
        };
    }
    // numbered as rosbag2 does: name_2 before name_10
    paths.sort_by_key(|p| {
        let stem = p.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let number = stem.rsplit('_').next().and_then(|n| n.parse::<u64>().ok());
        (number, stem)
    });
    Ok((paths, None))
}

struct Waiting {
    key: (u64, u64),
    message: BagMessage,
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.key == other.key
    }
}
impl Eq for Waiting {}
impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}
impl Ord for Waiting {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.key.cmp(&other.key)
    }
}

/// Messages of a recording in the order of log time, see [`BagReader::messages`].
pub struct Messages<'a> {
    reader: &'a BagReader,
    /// Topic of each channel, per file.
    by_channel: Vec<BTreeMap<u16, Arc<Topic>>>,
    /// Spans not yet unpacked, the earliest last.
    spans: Vec<(usize, Span)>,
    heap: BinaryHeap<Reverse<Waiting>>,
    errors: Vec<BagError>,
    last: Vec<Damage>,
    ordinal: u64,
}

impl Messages<'_> {
    fn unpack(&mut self, index: usize, span: &Span) {
        let file = &self.reader.files[index];
        // every channel is known since the bag was opened; a complete file has them in its index
        let mut directory = file.directory.clone();
        let unpacked = match file.layout.unpack(span, &mut directory) {
            Ok(unpacked) => unpacked,
            Err(error) => return self.errors.push(error),
        };
        let mut undeclared = None;
        for located in unpacked.messages {
            let Some(topic) = self.by_channel[index].get(&located.header.channel_id) else {
                undeclared = Some(located.header.channel_id);
                continue;
            };
            self.ordinal += 1;
            self.heap.push(Reverse(Waiting {
                key: (located.header.log_time, self.ordinal),
                message: BagMessage {
                    topic: Arc::clone(topic),
                    log_time: located.header.log_time,
                    publish_time: located.header.publish_time,
                    sequence: located.header.sequence,
                    chunk: Arc::clone(&unpacked.bytes),
                    from: located.from,
                    to: located.to,
                },
            }));
        }
        if let Some(damage) = unpacked.damage {
            self.errors.push(damage.error());
        }
        if let Some(channel) = undeclared {
            self.errors.push(BagError::Broken {
                path: file.layout.path.clone(),
                offset: span.offset,
                expected: "messages of channels that the index lists".into(),
                found: format!("channel {channel}"),
            });
        }
    }
}

impl Iterator for Messages<'_> {
    type Item = Result<BagMessage, BagError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(error) = self.errors.pop() {
                return Some(Err(error));
            }
            let earliest = self.heap.peek().map(|Reverse(w)| w.key.0);
            match self.spans.last().copied() {
                Some((index, span)) if earliest.is_none_or(|time| span.start <= time) => {
                    self.spans.pop();
                    self.unpack(index, &span);
                }
                _ => break,
            }
        }
        if let Some(Reverse(waiting)) = self.heap.pop() {
            return Some(Ok(waiting.message));
        }
        if self.last.is_empty() {
            return None;
        }
        Some(Err(self.last.remove(0).error()))
    }
}
