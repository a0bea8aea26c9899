//! `metadata.yaml` of a rosbag2 directory: version 5 written, any version read.

use std::fs;
use std::io::Write as _;
use std::path::{Component, Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::error::BagError;

/// Name of the file in the directory.
pub(crate) const FILE_NAME: &str = "metadata.yaml";

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Document {
    pub rosbag2_bagfile_information: Information,
}

/// The keys of version 5 in the order in which rosbag2 writes them; later versions add keys, which
/// are ignored.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Information {
    pub version: u32,
    pub storage_identifier: String,
    pub duration: Nanoseconds,
    pub starting_time: SinceEpoch,
    pub message_count: u64,
    pub topics_with_message_count: Vec<TopicCount>,
    #[serde(default)]
    pub compression_format: String,
    #[serde(default)]
    pub compression_mode: String,
    pub relative_file_paths: Vec<String>,
    #[serde(default)]
    pub files: Vec<FileInformation>,
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct Nanoseconds {
    pub nanoseconds: i64,
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct SinceEpoch {
    pub nanoseconds_since_epoch: i64,
}

#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct TopicCount {
    pub topic_metadata: TopicMetadata,
    pub message_count: u64,
}

/// Of the profiles, versions up to 8 hold text and later ones a list; nothing here needs them back.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct TopicMetadata {
    pub name: String,
    #[serde(rename = "type")]
    pub kind: String,
    pub serialization_format: String,
    #[serde(skip_deserializing)]
    pub offered_qos_profiles: String,
}

#[derive(Debug, Serialize, Deserialize)]
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

    /// Reads `metadata.yaml` of `directory`; `None` if there is none.
    pub fn read(directory: &Path) -> Result<Option<Self>, BagError> {
        let path = directory.join(FILE_NAME);
        let text = match fs::read_to_string(&path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(source) => return Err(BagError::reading(&path, source)),
        };
        serde_saphyr::from_str::<Document>(&text)
            .map(|d| Some(d.rosbag2_bagfile_information))
            .map_err(|e| BagError::NotABag {
                path,
                reason: format!("it does not read as rosbag2 metadata: {e}"),
            })
    }

    /// The data files, inside `directory`.
    ///
    /// # Errors
    /// [`BagError::NotABag`] where a path leads out of it: a bag opens nothing but itself.
    pub fn paths(&self, directory: &Path) -> Result<Vec<PathBuf>, BagError> {
        let inside = |text: &String| {
            let path = Path::new(text);
            let mut parts = path.components();
            let is_inside = parts.all(|part| matches!(part, Component::Normal(_)));
            if is_inside && !text.is_empty() {
                return Ok(directory.join(path));
            }
            let reason =
                format!("it names the file {text:?}: a bag's files lie in its own directory");
            Err(BagError::NotABag { path: directory.join(FILE_NAME), reason })
        };
        self.relative_file_paths.iter().map(inside).collect()
    }
}
