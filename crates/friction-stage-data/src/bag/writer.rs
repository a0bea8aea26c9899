//! Writes a rosbag2 directory with one MCAP file.
//!
//! Messages gather in a chunk in memory; a full chunk is compressed and goes to the file as a
//! whole. A chunk is also closed when half a second has passed, so that a process that is killed
//! loses less than a second. Only the operating system's cache stands between the file and a loss
//! of power: nothing is synced.

use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, McapError, WriteOptions};

use super::error::BagError;
use super::metadata::{Information, RecordedTopic};
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
}

impl Default for BagOptions {
    fn default() -> Self {
        Self {
            provenance: None,
            compression: Compression::Zstd,
            chunk_bytes: 256 * 1024,
            flush_interval: Duration::from_millis(500),
        }
    }
}

/// A topic of a [`BagWriter`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct TopicId(usize);

struct OpenTopic {
    channel: u16,
    sequence: u32,
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
    file_name: String,
    path: PathBuf,
    file: File,
    mcap: Option<mcap::Writer<BufWriter<File>>>,
    topics: Vec<OpenTopic>,
    range: Option<(u64, u64)>,
    flush_interval: Duration,
    last_flush: Instant,
    unflushed: bool,
    buffer: Vec<u8>,
}

impl BagWriter {
    /// Makes `directory` (and those above it) and starts `<name>_0.mcap` in it. An existing
    /// directory is refused.
    pub fn create(directory: impl AsRef<Path>, options: &BagOptions) -> Result<Self, BagError> {
        let mut writer = Self::create_bare(directory.as_ref(), options)?;
        if let Some(provenance) = &options.provenance {
            let mut map = provenance.to_map();
            map.insert(FLUSH_INTERVAL_KEY.into(), options.flush_interval.as_secs_f64().to_string());
            writer.write_metadata(METADATA_NAME, map)?;
            writer.write_attachment(&Attachment {
                log_time: 0,
                create_time: 0,
                name: MODEL_NAME.into(),
                media_type: "application/yaml".into(),
                data: provenance.model_yaml.as_bytes().into(),
            })?;
            writer.flush()?;
        }
        Ok(writer)
    }

    /// As [`create`](Self::create), without any provenance.
    pub(crate) fn create_bare(directory: &Path, options: &BagOptions) -> Result<Self, BagError> {
        let create_error = |path: &Path, source| BagError::Create { path: path.to_owned(), source };
        let name = match directory.file_name() {
            Some(name) => name.to_string_lossy().into_owned(),
            None => {
                let source =
                    std::io::Error::other("the path has no last part to name the bag after");
                return Err(create_error(directory, source));
            }
        };
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
        fs::create_dir(directory).map_err(|e| match e.kind() {
            std::io::ErrorKind::AlreadyExists => BagError::Exists { path: directory.to_owned() },
            _ => create_error(directory, e),
        })?;
        let file_name = format!("{name}_0.mcap");
        let path = directory.join(&file_name);
        let file = File::create_new(&path).map_err(|e| create_error(&path, e))?;
        let handle = file.try_clone().map_err(|e| create_error(&path, e))?;
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
        let mut writer = Self {
            directory: directory.to_owned(),
            file_name,
            path,
            file: handle,
            mcap: Some(mcap),
            topics: Vec::new(),
            range: None,
            flush_interval: options.flush_interval,
            last_flush: Instant::now(),
            unflushed: false,
            buffer: Vec::with_capacity(1024),
        };
        writer.flush()?;
        writer.write_metadata_yaml()?;
        Ok(writer)
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
        if let Some(index) = self.topics.iter().position(|t| t.recorded.name == topic.name) {
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
        let channel = self.with(|mcap| {
            let schema =
                mcap.add_schema(topic.type_name, topic.schema_encoding, topic.definition)?;
            mcap.add_channel(schema, topic.name, topic.message_encoding, topic.metadata)
        })?;
        self.topics.push(OpenTopic {
            channel,
            sequence: 0,
            recorded: RecordedTopic {
                name: topic.name.into(),
                kind: topic.type_name.into(),
                qos_yaml: topic.metadata.get(QOS_KEY).cloned().unwrap_or_default(),
                messages: 0,
            },
        });
        self.unflushed = true;
        Ok(TopicId(self.topics.len() - 1))
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
        self.range = Some(match self.range {
            None => (log_time, log_time),
            Some((first, last)) => (first.min(log_time), last.max(log_time)),
        });
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
        if self.unflushed && self.last_flush.elapsed() >= self.flush_interval {
            self.flush()?;
        }
        Ok(())
    }

    /// Brings everything written so far to the file.
    pub fn flush(&mut self) -> Result<(), BagError> {
        self.with(|mcap| mcap.flush())?;
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
        self.with(|mcap| mcap.finish().map(drop))?;
        if let Some(mcap) = self.mcap.take() {
            let written = mcap.into_inner().flush();
            written.map_err(|e| BagError::writing(&self.path, length(&self.file), e))?;
        }
        self.write_metadata_yaml()
    }

    fn write_metadata_yaml(&self) -> Result<(), BagError> {
        let topics: Vec<&RecordedTopic> = self.topics.iter().map(|t| &t.recorded).collect();
        Information::new(&self.file_name, self.range, &topics).write(&self.directory)
    }

    /// Runs `action` on the open file; after its first error nothing is written any more.
    fn with<T>(
        &mut self,
        action: impl FnOnce(&mut mcap::Writer<BufWriter<File>>) -> Result<T, McapError>,
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

fn length(file: &File) -> u64 {
    file.metadata().map_or(0, |m| m.len())
}

fn mcap_error(path: &Path, file: &File, error: McapError) -> BagError {
    match error {
        McapError::Io(source) => BagError::writing(path, length(file), source),
        source => BagError::Mcap { path: path.to_owned(), source },
    }
}
