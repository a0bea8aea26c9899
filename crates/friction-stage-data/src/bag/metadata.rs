//! `metadata.yaml` of a rosbag2 directory: version 5 written, any version read, also as
//! `ros2 bag reindex` leaves it.

use std::fs;
use std::io::Write as _;
use std::path::{Component, Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::error::BagError;
use super::limits;
use friction_stage_core::{text_file, yaml};

/// Name of the file in the directory.
pub(crate) const FILE_NAME: &str = "metadata.yaml";

#[derive(Debug, Serialize, Deserialize)]
struct Document<T> {
    rosbag2_bagfile_information: T,
}

/// The keys of version 5 in the order in which rosbag2 writes them.
#[derive(Debug, Serialize)]
pub(crate) struct Information {
    pub version: u32,
    pub storage_identifier: String,
    pub duration: Nanoseconds,
    pub starting_time: SinceEpoch,
    pub message_count: u64,
    pub topics_with_message_count: Vec<TopicCount>,
    pub compression_format: String,
    pub compression_mode: String,
    pub relative_file_paths: Vec<String>,
    pub files: Vec<FileInformation>,
}

#[derive(Debug, Serialize)]
pub(crate) struct Nanoseconds {
    pub nanoseconds: i64,
}

#[derive(Debug, Serialize)]
pub(crate) struct SinceEpoch {
    pub nanoseconds_since_epoch: i64,
}

#[derive(Debug, Serialize)]
pub(crate) struct TopicCount {
    pub topic_metadata: TopicMetadata,
    pub message_count: u64,
}

#[derive(Debug, Serialize)]
pub(crate) struct TopicMetadata {
    pub name: String,
    #[serde(rename = "type")]
    pub kind: String,
    pub serialization_format: String,
    pub offered_qos_profiles: String,
}

#[derive(Debug, Serialize)]
pub(crate) struct FileInformation {
    pub path: String,
    pub starting_time: SinceEpoch,
    pub duration: Nanoseconds,
    pub message_count: u64,
}

/// One recorded topic, for [`Information::new`].
pub(crate) struct RecordedTopic {
    pub name: String,
    pub kind: String,
    pub qos_yaml: String,
    pub messages: u64,
}

/// One recorded file, for [`Information::new`].
#[derive(Debug, Default)]
pub(crate) struct RecordedFile {
    /// Name in the directory.
    pub name: String,
    /// First and last log time, ns.
    pub range: Option<(u64, u64)>,
    pub messages: u64,
}

/// Start and span of a range of log times.
fn span(range: Option<(u64, u64)>) -> (SinceEpoch, Nanoseconds) {
    let (first, last) = range.unwrap_or((0, 0));
    let start = SinceEpoch { nanoseconds_since_epoch: i64::try_from(first).unwrap_or(i64::MAX) };
    (start, Nanoseconds { nanoseconds: i64::try_from(last - first).unwrap_or(i64::MAX) })
}

impl Information {
    /// Metadata of a bag of MCAP files.
    pub fn new(files: &[RecordedFile], topics: &[&RecordedTopic]) -> Self {
        let message_count = topics.iter().map(|t| t.messages).sum();
        let ranges = files.iter().filter_map(|file| file.range);
        let whole = ranges.reduce(|(a, b), (c, d)| (a.min(c), b.max(d)));
        let (starting_time, duration) = span(whole);
        Self {
            version: 5,
            storage_identifier: "mcap".into(),
            duration,
            starting_time,
            message_count,
            topics_with_message_count: topics
                .iter()
                .map(|topic| TopicCount {
                    topic_metadata: TopicMetadata {
                        name: topic.name.clone(),
                        kind: topic.kind.clone(),
                        serialization_format: "cdr".into(),
                        offered_qos_profiles: topic.qos_yaml.clone(),
                    },
                    message_count: topic.messages,
                })
                .collect(),
            compression_format: String::new(),
            compression_mode: String::new(),
            relative_file_paths: files.iter().map(|file| file.name.clone()).collect(),
            files: files
                .iter()
                .map(|file| {
                    let (starting_time, duration) = span(file.range);
                    let (path, message_count) = (file.name.clone(), file.messages);
                    FileInformation { path, starting_time, duration, message_count }
                })
                .collect(),
        }
    }

    /// Writes `metadata.yaml` into `directory`; a reader sees the old one or the new one, never
    /// half of it.
    pub fn write(self, directory: &Path) -> Result<(), BagError> {
        let path = directory.join(FILE_NAME);
        let fail = |source| BagError::writing(&path, 0, source);
        let text = serde_saphyr::to_string(&Document { rosbag2_bagfile_information: self })
            .map_err(|e| fail(std::io::Error::other(e.to_string())))?;
        let temporary = directory.join(".metadata.yaml.new");
        let mut file = fs::File::create(&temporary).map_err(fail)?;
        let written = file.write_all(text.as_bytes());
        drop(file);
        if let Err(source) = written.and_then(|()| fs::rename(&temporary, &path)) {
            let _ = fs::remove_file(&temporary);
            return Err(fail(source));
        }
        Ok(())
    }
}

/// What is read of a `metadata.yaml`: only what the files themselves do not say. Any of it may be
/// missing, whatever the version.
#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default)]
pub(crate) struct Found {
    version: Option<u32>,
    storage_identifier: Option<String>,
    message_count: Option<u64>,
    compression_format: Option<String>,
    compression_mode: Option<String>,
    relative_file_paths: Option<Vec<String>>,
    topics_with_message_count: Option<Vec<FoundTopic>>,
}

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default)]
struct FoundTopic {
    topic_metadata: FoundTopicMetadata,
}

#[derive(Debug, Clone, Default, Deserialize)]
#[serde(default)]
struct FoundTopicMetadata {
    name: String,
    #[serde(rename = "type")]
    kind: Option<String>,
}

impl Found {
    /// Versions before this one name files with the directory before them.
    const PLAIN_PATHS: u32 = 4;

    /// Reads `metadata.yaml` of `directory`; `None` if there is none.
    pub fn read(directory: &Path) -> Result<Option<Self>, BagError> {
        let path = directory.join(FILE_NAME);
        let text = match text_file::read(&path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(source) => return Err(BagError::reading(&path, source)),
        };
        yaml::read::<Document<Self>>(&text)
            .map(|document| Some(document.rosbag2_bagfile_information))
            .map_err(|problem| BagError::NotABag {
                path,
                reason: format!(
                    "it does not read as rosbag2 metadata: {problem}; `ros2 bag reindex` writes it \
                     again"
                ),
            })
    }

    /// Reads the copy that a data file holds, with or without the key above it.
    pub fn of_information(text: &str) -> Option<Self> {
        let whole = serde_saphyr::from_str::<Document<Self>>(text);
        let whole = whole.map(|document| document.rosbag2_bagfile_information);
        whole.or_else(|_| serde_saphyr::from_str(text)).ok()
    }

    pub fn message_count(&self) -> Option<u64> {
        self.message_count
    }

    pub fn storage_identifier(&self) -> &str {
        self.storage_identifier.as_deref().unwrap_or_default()
    }

    pub fn compression_mode(&self) -> &str {
        self.compression_mode.as_deref().unwrap_or_default()
    }

    pub fn compression_format(&self) -> &str {
        self.compression_format.as_deref().unwrap_or_default()
    }

    pub fn relative_file_paths(&self) -> &[String] {
        self.relative_file_paths.as_deref().unwrap_or_default()
    }

    /// Type of the messages of a topic, if it says.
    pub fn type_of(&self, topic: &str) -> Option<&str> {
        let topics = self.topics_with_message_count.as_deref().unwrap_or_default();
        let found = topics.iter().find(|found| found.topic_metadata.name == topic)?;
        found.topic_metadata.kind.as_deref().filter(|kind| !kind.is_empty())
    }

    /// The data files, inside `directory`.
    ///
    /// # Errors
    /// [`BagError::NotABag`] where a path leads out of it: a bag opens nothing but itself.
    pub fn paths(&self, directory: &Path) -> Result<Vec<PathBuf>, BagError> {
        let count = self.relative_file_paths().len();
        if count > limits::FILES {
            let reason = format!("it names {count} files, at most {} are read", limits::FILES);
            return Err(BagError::NotABag { path: directory.join(FILE_NAME), reason });
        }
        let has_directory = self.version.is_some_and(|version| version < Self::PLAIN_PATHS);
        let inside = |text: &String| {
            let path = Path::new(text);
            let mut parts = path.components();
            let is_inside = parts.all(|part| matches!(part, Component::Normal(_)));
            if is_inside && !text.is_empty() {
                let plain = path.file_name().filter(|_| has_directory).map(Path::new);
                return Ok(directory.join(plain.unwrap_or(path)));
            }
            let reason =
                format!("it names the file {text:?}: a bag's files lie in its own directory");
            Err(BagError::NotABag { path: directory.join(FILE_NAME), reason })
        };
        self.relative_file_paths().iter().map(inside).collect()
    }
}
