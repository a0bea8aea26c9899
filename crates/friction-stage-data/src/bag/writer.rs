//! Writes a rosbag2 directory of one or more MCAP files.
//!
//! Messages gather in a chunk in memory; a full chunk is compressed and goes to the file as a
//! whole. A chunk is also closed when half a second has passed: a process that is killed loses its
//! open chunk and what has not reached the writer. A loss of power also takes what the operating
//! system has not brought to the disk; [`Sync`] says when it does.

use std::collections::{BTreeMap, HashMap};
use std::fs::{self, File};
use std::io::{BufWriter, Write as _};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, McapError, WriteOptions};

use super::error::BagError;
use super::metadata::{Information, RecordedFile, RecordedTopic};
use super::provenance::{FLUSH_INTERVAL_KEY, METADATA_NAME, MODEL_NAME, Provenance};
use super::qos::OfferedQos;
use crate::message::RosMessage;
use crate::message::cdr::to_cdr_into;

/// How chunks are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Compression {
    /// Smallest files.
    Zstd,
    /// Fastest that still compresses.
    Lz4,
    /// As they are.
    None,
}

/// When what is written is brought to the disk, so that it outlives a loss of power.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sync {
    /// When the operating system likes, within half a minute as a rule.
    Never,
    /// When a file is closed.
    #[default]
    End,
    /// When a file is closed, and whenever the flush interval has passed.
    Interval,
}

impl Sync {
    /// Names of the choices, in the order of the variants.
    pub const NAMES: [&'static str; 3] = ["never", "end", "interval"];

    /// The choice of this name.
    pub fn from_name(name: &str) -> Option<Sync> {
        let index = Sync::NAMES.iter().position(|known| *known == name)?;
        Some([Sync::Never, Sync::End, Sync::Interval][index])
    }
}

/// How to record.
#[derive(Debug, Clone)]
pub struct BagOptions {
    /// Stored at the start of the file.
    pub provenance: Option<Provenance>,
    /// Compression of chunks.
    pub compression: Compression,
    /// Bytes of messages that make a chunk full.
    pub chunk_bytes: u64,
    /// Longest time that a message stays in memory only, while messages keep coming.
    pub flush_interval: Duration,
    /// When what is written is brought to the disk.
    pub sync: Sync,
    /// Size of a file, bytes, from which the next one is begun.
    pub split_bytes: Option<u64>,
    /// Span of log time of a file from which the next one is begun.
    pub split_duration: Option<Duration>,
}

impl Default for BagOptions {
    fn default() -> Self {
        Self {
            provenance: None,
            compression: Compression::Zstd,
            chunk_bytes: 256 * 1024,
            flush_interval: Duration::from_millis(500),
            sync: Sync::default(),
            split_bytes: None,
            split_duration: None,
        }
    }
}

/// A topic of a [`BagWriter`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct TopicId(usize);

struct OpenTopic {
    channel: u16,
    sequence: u32,
    schema_encoding: String,
    definition: Vec<u8>,
    message_encoding: String,
    metadata: BTreeMap<String, String>,
    recorded: RecordedTopic,
}

/// What a bag stores about a topic, for topics whose type is known as text only.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TopicDescription<'a> {
    pub name: &'a str,
    pub type_name: &'a str,
    pub schema_encoding: &'a str,
    pub definition: &'a [u8],
    pub message_encoding: &'a str,
    pub metadata: &'a BTreeMap<String, String>,
}

/// Channel metadata keys of rosbag2.
pub(crate) const QOS_KEY: &str = "offered_qos_profiles";
pub(crate) const HASH_KEY: &str = "topic_type_hash";

/// A recording in progress. Call [`finish`](Self::finish) in the end, which tells whether all is in
/// the file; a writer that is dropped closes the file as well, but cannot say so.
pub struct BagWriter {
    directory: PathBuf,
    /// Files that are complete, and the one that is open.
    files: Vec<RecordedFile>,
    path: PathBuf,
    file: File,
    mcap: Option<McapWriter>,
    topics: Vec<OpenTopic>,
    /// Their places by name.
    places: HashMap<String, usize>,
    options: BagOptions,
    last_flush: Instant,
    unflushed: bool,
    /// Bytes of messages since the length of the file was looked at.
    unlooked: u64,
    buffer: Vec<u8>,
}

impl BagWriter {
    /// Makes `directory` (and those above it) and starts `<name>_0.mcap` in it. An existing
    /// directory is refused.
    pub fn create(directory: impl AsRef<Path>, options: &BagOptions) -> Result<Self, BagError> {
        let directory = directory.as_ref();
        let create_error = |path: &Path, source| BagError::Create { path: path.to_owned(), source };
        if let Some(parent) = directory.parent().filter(|p| !p.as_os_str().is_empty()) {
            fs::create_dir_all(parent).map_err(|e| {
                match parent.ancestors().find(|p| p.is_file()) {
                    Some(file) => {
                        let reason = format!("{} is a file, not a directory", file.display());
                        create_error(directory, std::io::Error::other(reason))
                    }
                    None => create_error(parent, e),
                }
            })?;
        }
        if directory.file_name().is_none() {
            let source = std::io::Error::other("the path has no last part to name the bag after");
            return Err(create_error(directory, source));
        }
        fs::create_dir(directory).map_err(|e| match e.kind() {
            std::io::ErrorKind::AlreadyExists => BagError::Exists { path: directory.to_owned() },
            _ => create_error(directory, e),
        })?;
        let (name, path, file, mcap) = open_file(directory, 0, options)?;
        let mut writer = Self {
            directory: directory.to_owned(),
            files: vec![RecordedFile { name, ..RecordedFile::default() }],
            path,
            file,
            mcap: Some(mcap),
            topics: Vec::new(),
            places: HashMap::new(),
            options: options.clone(),
            last_flush: Instant::now(),
            unflushed: false,
            unlooked: 0,
            buffer: Vec::with_capacity(1024),
        };
        writer.write_provenance()?;
        writer.flush()?;
        writer.write_metadata_yaml()?;
        Ok(writer)
    }

    /// Every file says where it comes from: it may be taken out of its bag.
    fn write_provenance(&mut self) -> Result<(), BagError> {
        let Some(provenance) = self.options.provenance.clone() else { return Ok(()) };
        let mut map = provenance.to_map();
        let interval = self.options.flush_interval.as_secs_f64();
        map.insert(FLUSH_INTERVAL_KEY.into(), interval.to_string());
        self.write_metadata(METADATA_NAME, map)?;
        self.write_attachment(&Attachment {
            log_time: 0,
            create_time: 0,
            name: MODEL_NAME.into(),
            media_type: "application/yaml".into(),
            data: provenance.model_yaml.as_bytes().into(),
        })
    }

    /// Closes the open file and begins the next one, with the same topics.
    fn begin_next_file(&mut self) -> Result<(), BagError> {
        self.close_file()?;
        let (name, path, file, mcap) = open_file(&self.directory, self.files.len(), &self.options)?;
        self.files.push(RecordedFile { name, ..RecordedFile::default() });
        (self.path, self.file, self.mcap) = (path, file, Some(mcap));
        self.write_provenance()?;
        for index in 0..self.topics.len() {
            let channel = self.add_channel(index)?;
            self.topics[index].channel = channel;
        }
        self.flush()?;
        self.write_metadata_yaml()
    }

    /// Whether a message at `log_time`, ns, belongs into the next file.
    fn is_full(&mut self, log_time: u64) -> bool {
        let Some((first, _)) = self.files.last().and_then(|file| file.range) else { return false };
        let span = self.options.split_duration.map(|span| span.as_nanos());
        if span.is_some_and(|span| u128::from(log_time.saturating_sub(first)) >= span) {
            return true;
        }
        let Some(limit) = self.options.split_bytes else { return false };
        if self.unlooked < self.options.chunk_bytes.min(limit) {
            return false;
        }
        self.unlooked = 0;
        length(&self.file) >= limit
    }

    /// The directory that is being written.
    pub fn directory(&self) -> &Path {
        &self.directory
    }

    /// Messages written so far.
    pub fn message_count(&self) -> u64 {
        self.topics.iter().map(|t| t.recorded.messages).sum()
    }

    /// Adds a topic of type `M`, offered with `qos`. A topic that exists is returned as it is.
    pub fn add_topic<M: RosMessage>(
        &mut self,
        name: &str,
        qos: &OfferedQos,
    ) -> Result<TopicId, BagError> {
        let metadata = BTreeMap::from([
            (QOS_KEY.to_owned(), qos.yaml()),
            (HASH_KEY.to_owned(), M::TYPE_HASH.to_owned()),
        ]);
        self.add_described(&TopicDescription {
            name,
            type_name: &M::type_name(),
            schema_encoding: "ros2msg",
            definition: M::definition().as_bytes(),
            message_encoding: "cdr",
            metadata: &metadata,
        })
    }

    pub(crate) fn add_described(
        &mut self,
        topic: &TopicDescription<'_>,
    ) -> Result<TopicId, BagError> {
        if let Some(&index) = self.places.get(topic.name) {
            let known = &self.topics[index].recorded.kind;
            if known != topic.type_name {
                return Err(BagError::TopicType {
                    topic: topic.name.into(),
                    known: known.clone(),
                    asked: topic.type_name.into(),
                });
            }
            return Ok(TopicId(index));
        }
        self.topics.push(OpenTopic {
            channel: 0,
            sequence: 0,
            schema_encoding: topic.schema_encoding.into(),
            definition: topic.definition.into(),
            message_encoding: topic.message_encoding.into(),
            metadata: topic.metadata.clone(),
            recorded: RecordedTopic {
                name: topic.name.into(),
                kind: topic.type_name.into(),
                qos_yaml: topic.metadata.get(QOS_KEY).cloned().unwrap_or_default(),
                messages: 0,
            },
        });
        let index = self.topics.len() - 1;
        match self.add_channel(index) {
            Ok(channel) => {
                self.topics[index].channel = channel;
                self.places.insert(topic.name.into(), index);
            }
            Err(error) => {
                self.topics.pop();
                return Err(error);
            }
        }
        self.unflushed = true;
        Ok(TopicId(index))
    }

    /// Makes the topic known to the open file.
    fn add_channel(&mut self, index: usize) -> Result<u16, BagError> {
        let topics = std::mem::take(&mut self.topics);
        let topic = &topics[index];
        let channel = self.with(|mcap| {
            let schema =
                mcap.add_schema(&topic.recorded.kind, &topic.schema_encoding, &topic.definition)?;
            mcap.add_channel(schema, &topic.recorded.name, &topic.message_encoding, &topic.metadata)
        });
        self.topics = topics;
        channel
    }

    /// Writes a message that is CDR already (with its encapsulation). Times in ns.
    pub fn write_cdr(
        &mut self,
        topic: TopicId,
        log_time_ns: u64,
        publish_time_ns: u64,
        cdr: &[u8],
    ) -> Result<(), BagError> {
        let sequence = self.topics[topic.0].sequence;
        self.write_numbered(topic, sequence, log_time_ns, publish_time_ns, cdr)
    }

    pub(crate) fn write_numbered(
        &mut self,
        topic: TopicId,
        sequence: u32,
        log_time: u64,
        publish_time: u64,
        cdr: &[u8],
    ) -> Result<(), BagError> {
        if self.is_full(log_time) {
            self.begin_next_file()?;
        }
        let header = MessageHeader {
            channel_id: self.topics[topic.0].channel,
            sequence,
            log_time,
            publish_time,
        };
        self.with(|mcap| mcap.write_to_known_channel(&header, cdr))?;
        let open = &mut self.topics[topic.0];
        open.sequence = sequence.wrapping_add(1);
        open.recorded.messages += 1;
        self.unlooked += cdr.len() as u64;
        if let Some(file) = self.files.last_mut() {
            file.messages += 1;
            file.range = Some(match file.range {
                None => (log_time, log_time),
                Some((first, last)) => (first.min(log_time), last.max(log_time)),
            });
        }
        self.unflushed = true;
        self.flush_if_due()
    }

    /// Encodes and writes a message; log and publish time are the same.
    pub fn write<M: RosMessage>(
        &mut self,
        topic: TopicId,
        time_ns: u64,
        message: &M,
    ) -> Result<(), BagError> {
        let mut buffer = std::mem::take(&mut self.buffer);
        let result = match to_cdr_into(message, &mut buffer) {
            Ok(()) => self.write_cdr(topic, time_ns, time_ns, &buffer),
            Err(source) => {
                Err(BagError::Encode { topic: self.topics[topic.0].recorded.name.clone(), source })
            }
        };
        self.buffer = buffer;
        result
    }

    /// Brings everything written so far to the file if the flush interval has passed. Every write
    /// does this; a recorder whose messages can stop coming calls it while it waits.
    pub fn flush_if_due(&mut self) -> Result<(), BagError> {
        if self.unflushed && self.last_flush.elapsed() >= self.options.flush_interval {
            self.flush()?;
        }
        Ok(())
    }

    /// Brings everything written so far to the file, and to the disk where [`Sync::Interval`] is
    /// asked for. A file that was removed meanwhile is an error: what it holds could not be found.
    pub fn flush(&mut self) -> Result<(), BagError> {
        self.with(|mcap| mcap.flush())?;
        if self.file.metadata().is_ok_and(|file| file.nlink() == 0) {
            self.abandon();
            return Err(BagError::Removed { path: self.path.clone() });
        }
        if self.options.sync == Sync::Interval {
            self.sync()?;
        }
        self.last_flush = Instant::now();
        self.unflushed = false;
        Ok(())
    }

    pub(crate) fn write_metadata(
        &mut self,
        name: &str,
        metadata: BTreeMap<String, String>,
    ) -> Result<(), BagError> {
        let record = Metadata { name: name.into(), metadata };
        self.with(|mcap| mcap.write_metadata(&record))
    }

    pub(crate) fn write_attachment(&mut self, attachment: &Attachment<'_>) -> Result<(), BagError> {
        self.with(|mcap| mcap.attach(attachment))
    }

    /// Closes the file with its index and statistics, and writes the final `metadata.yaml`.
    pub fn finish(mut self) -> Result<(), BagError> {
        self.close()
    }

    fn close(&mut self) -> Result<(), BagError> {
        self.flush()?;
        self.close_file()?;
        self.write_metadata_yaml()
    }

    fn close_file(&mut self) -> Result<(), BagError> {
        self.with(|mcap| mcap.finish().map(drop))?;
        if let Some(mcap) = self.mcap.take() {
            let written = mcap.into_inner().flush();
            written.map_err(|e| BagError::writing(&self.path, length(&self.file), e))?;
        }
        if self.options.sync != Sync::Never {
            self.sync()?;
        }
        Ok(())
    }

    fn sync(&self) -> Result<(), BagError> {
        let synced = self.file.sync_data();
        synced.map_err(|e| BagError::writing(&self.path, length(&self.file), e))
    }

    fn write_metadata_yaml(&self) -> Result<(), BagError> {
        let topics: Vec<&RecordedTopic> = self.topics.iter().map(|t| &t.recorded).collect();
        Information::new(&self.files, &topics).write(&self.directory)
    }

    /// Runs `action` on the open file; after its first error nothing is written any more.
    fn with<T>(
        &mut self,
        action: impl FnOnce(&mut McapWriter) -> Result<T, McapError>,
    ) -> Result<T, BagError> {
        let Some(mcap) = &mut self.mcap else {
            return Err(BagError::Stopped { path: self.path.clone() });
        };
        action(mcap).map_err(|e| {
            let error = mcap_error(&self.path, &self.file, e);
            self.abandon();
            error
        })
    }

    /// Drops the MCAP writer without letting it write a summary over a file that already lacks
    /// something.
    fn abandon(&mut self) {
        if let Some(mcap) = self.mcap.take() {
            let (_file, _unwritten) = mcap.into_inner().into_parts();
        }
    }
}

impl Drop for BagWriter {
    fn drop(&mut self) {
        if self.mcap.is_some() {
            let _ = self.close();
        }
    }
}

type McapWriter = mcap::Writer<BufWriter<File>>;

/// An empty MCAP file `<name>_<index>.mcap` in `directory`: its name, its path, a handle to look at
/// it, and its writer.
fn open_file(
    directory: &Path,
    index: usize,
    options: &BagOptions,
) -> Result<(String, PathBuf, File, McapWriter), BagError> {
    let stem = directory.file_name().map(|name| name.to_string_lossy()).unwrap_or_default();
    let name = format!("{stem}_{index}.mcap");
    let path = directory.join(&name);
    let create_error = |source| BagError::Create { path: path.clone(), source };
    let file = File::create_new(&path).map_err(create_error)?;
    let handle = file.try_clone().map_err(create_error)?;
    let mcap = WriteOptions::new()
        .profile("ros2")
        .library(concat!("friction-stage ", env!("CARGO_PKG_VERSION")))
        .compression(match options.compression {
            Compression::Zstd => Some(mcap::Compression::Zstd),
            Compression::Lz4 => Some(mcap::Compression::Lz4),
            Compression::None => None,
        })
        .compression_level(match options.compression {
            Compression::Zstd => 1,
            _ => 0,
        })
        .compression_threads(0)
        .chunk_size(Some(options.chunk_bytes))
        // a chunk then reaches the file in one piece, so that a cut leaves no half-open one
        .disable_seeking(true)
        .create(BufWriter::new(file))
        .map_err(|e| mcap_error(&path, &handle, e))?;
    Ok((name, path, handle, mcap))
}

fn length(file: &File) -> u64 {
    file.metadata().map_or(0, |m| m.len())
}

fn mcap_error(path: &Path, file: &File, error: McapError) -> BagError {
    match error {
        McapError::Io(source) => BagError::writing(path, length(file), source),
        source => BagError::Mcap { path: path.to_owned(), source },
    }
}
