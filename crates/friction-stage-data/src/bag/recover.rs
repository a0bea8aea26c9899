//! Makes a whole recording from one that was cut off, lacks its index or is damaged in places.
//!
//! The original is only read. Every message that can be read is copied, with its times and number,
//! into a new directory beside it, together with everything else that the file holds.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::error::BagError;
use super::file::{Attached, Damage, Places};
use super::provenance::FLUSH_INTERVAL_KEY;
use super::reader::{BagReader, Topic};
use super::writer::{BagOptions, BagWriter, TopicDescription};
use crate::message::type_layout::TypeLayout;

/// Messages kept of one topic.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct KeptTopic {
    /// Name of the topic.
    pub name: String,
    /// Its type.
    pub type_name: String,
    /// Messages in the new recording.
    pub messages: u64,
    /// Log time of the last one, ns.
    pub last_log_time: Option<u64>,
}

/// What a recovery found and kept.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RecoverReport {
    /// The recording that was read.
    pub source: PathBuf,
    /// The new recording; none if the source is whole.
    pub output: Option<PathBuf>,
    /// Topics with what was kept.
    pub topics: Vec<KeptTopic>,
    /// Messages kept.
    pub messages: u64,
    /// First and last log time kept, ns.
    pub time_range: Option<(u64, u64)>,
    /// Every place that could not be read.
    pub damage: Vec<Damage>,
    /// Bytes of all these places.
    pub bytes_dropped: u64,
    /// Longest step between two messages across a damaged place inside the recording, s.
    pub longest_hole_s: Option<f64>,
    /// At most this much wall time before the end is missing if the recorder was killed, s; known
    /// for recordings of this program, which bring their messages to the file at least that often.
    /// A file that was cut afterwards can lack more.
    pub lost_at_end_s: Option<f64>,
}

/// Directory that [`recover`] makes of a recording.
pub fn recovered(path: &Path, out: Option<&Path>) -> Result<PathBuf, BagError> {
    match out {
        Some(out) => Ok(out.to_owned()),
        None => default_output(path),
    }
}

/// Copies what is whole in `path` into `out`, by default `<path>_recovered`. A recording that is
/// whole already is left alone and reported without `output`.
pub fn recover(path: &Path, out: Option<&Path>) -> Result<RecoverReport, BagError> {
    let reader = BagReader::open(path)?;
    if out.is_none() && is_whole(&reader)? {
        return Ok(report(&reader, None, Tally::of_whole(&reader)));
    }
    let output = recovered(path, out)?;
    let mut writer = BagWriter::create(&output, &BagOptions::default())?;
    for (name, metadata) in reader.metadata() {
        writer.write_metadata(name, metadata.clone())?;
    }
    for attachment in reader.attachments() {
        let Attached { header, data } = attachment?;
        writer.write_attachment(&mcap::Attachment {
            log_time: header.log_time,
            create_time: header.create_time,
            name: header.name,
            media_type: header.media_type,
            data: data.into(),
        })?;
    }
    let mut ids = Vec::new();
    for topic in reader.topics() {
        ids.push(writer.add_described(&TopicDescription {
            name: &topic.name,
            type_name: &topic.type_name,
            schema_encoding: &topic.schema_encoding,
            definition: readable(topic),
            message_encoding: &topic.message_encoding,
            metadata: &topic.metadata,
        })?);
    }
    let mut tally = Tally::new(reader.topics().len());
    let places = reader.places();
    for message in reader.messages() {
        let message = match message {
            Ok(message) => message,
            Err(BagError::Broken { path, offset, expected, found }) => {
                tally.hole_open = true;
                tally.damage.note(Damage { path, offset, bytes: 0, expected, found }, |_| 0);
                continue;
            }
            Err(error) => return Err(error),
        };
        let index = places.get(message.topic.name.as_str()).copied().unwrap_or_default();
        writer.write_numbered(
            ids[index],
            message.sequence,
            message.log_time,
            message.publish_time,
            &message,
        )?;
        tally.count(index, message.log_time);
    }
    writer.finish()?;
    Ok(report(&reader, Some(output), tally))
}

/// The definition of a topic as long as it can be read: one that cannot keeps readers from opening
/// the whole bag.
fn readable(topic: &Topic) -> &[u8] {
    let parsed = |text| TypeLayout::parse(&topic.type_name, text).ok();
    let is_readable = topic.schema_encoding != "ros2msg"
        || std::str::from_utf8(&topic.definition).ok().and_then(parsed).is_some();
    if is_readable { &topic.definition } else { b"" }
}

/// Whether index, metadata and every chunk are as they should be.
fn is_whole(reader: &BagReader) -> Result<bool, BagError> {
    if !reader.is_complete() || reader.has_mended() || !reader.verify_checksums()?.is_empty() {
        return Ok(false);
    }
    let mut count = 0;
    for message in reader.messages() {
        match message {
            Ok(_) => count += 1,
            Err(BagError::Broken { .. }) => return Ok(false),
            Err(error) => return Err(error),
        }
    }
    let is_directory = reader.path().is_dir();
    Ok(count == reader.message_count() && (!is_directory || reader.declared_count() == Some(count)))
}

fn default_output(path: &Path) -> Result<PathBuf, BagError> {
    let absolute = std::path::absolute(path).map_err(|e| BagError::reading(path, e))?;
    let stem = if absolute.is_dir() { absolute.file_name() } else { absolute.file_stem() };
    let mut name = stem.unwrap_or_default().to_os_string();
    name.push("_recovered");
    // beside the bag, not inside it
    let inside = absolute.is_file()
        && absolute.parent().is_some_and(|p| p.join(super::metadata::FILE_NAME).exists());
    let beside = if inside { absolute.parent().unwrap_or(&absolute).to_owned() } else { absolute };
    Ok(beside.with_file_name(name))
}

/// What has been kept so far.
struct Tally {
    counts: Vec<u64>,
    last: Vec<Option<u64>>,
    range: Option<(u64, u64)>,
    damage: Places,
    hole_open: bool,
    longest_hole_ns: Option<u64>,
}

impl Tally {
    fn new(topics: usize) -> Self {
        Self {
            counts: vec![0; topics],
            last: vec![None; topics],
            range: None,
            damage: Places::default(),
            hole_open: false,
            longest_hole_ns: None,
        }
    }

    fn of_whole(reader: &BagReader) -> Self {
        let mut tally = Self::new(reader.topics().len());
        tally.counts = reader.topics().iter().map(|t| t.messages).collect();
        tally.range = reader.time_range();
        tally
    }

    fn count(&mut self, index: usize, log_time: u64) {
        if self.hole_open {
            self.hole_open = false;
            if let Some((_, last)) = self.range {
                let hole = log_time.saturating_sub(last);
                self.longest_hole_ns = self.longest_hole_ns.max(Some(hole));
            }
        }
        self.counts[index] += 1;
        self.last[index] = self.last[index].max(Some(log_time));
        self.range = Some(match self.range {
            None => (log_time, log_time),
            Some((first, last)) => (first.min(log_time), last.max(log_time)),
        });
    }
}

fn report(reader: &BagReader, output: Option<PathBuf>, tally: Tally) -> RecoverReport {
    // the structural scan knows how many bytes each place has; the reading adds damaged chunks
    let mut damage = Places::new(reader.damage());
    for found in tally.damage.into_list() {
        damage.note(found, |place| reader.span_length(&place.path, place.offset));
    }
    let damage = damage.into_list();
    let flush_interval = reader
        .provenance()
        .and_then(|p| p.extra.get(FLUSH_INTERVAL_KEY))
        .and_then(|s| s.parse().ok());
    RecoverReport {
        source: reader.path().to_owned(),
        topics: reader
            .topics()
            .iter()
            .zip(tally.counts.iter().zip(&tally.last))
            .map(|(topic, (&messages, &last_log_time))| KeptTopic {
                name: topic.name.clone(),
                type_name: topic.type_name.clone(),
                messages,
                last_log_time,
            })
            .collect(),
        messages: tally.counts.iter().sum(),
        time_range: tally.range,
        bytes_dropped: damage.iter().map(|d| d.bytes).sum(),
        longest_hole_s: tally.longest_hole_ns.map(|ns| ns as f64 * 1e-9),
        lost_at_end_s: if reader.is_complete() { None } else { flush_interval },
        damage,
        output,
    }
}
