//! The records of one MCAP file, found one by one with their offsets, so that whatever is wrong has
//! a place.
//!
//! [`scan`] hops from record to record without reading the messages. Where the chain breaks it goes
//! on at the next chunk that the file's own index knows, if the index survived. Message data are
//! read later, a chunk at a time.

use std::cell::RefCell;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs::File;
use std::io::Read;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::MAGIC;
use mcap::records::{ChunkIndex, MessageHeader, Record, Statistics, op};
use serde::Serialize;

use super::error::BagError;
use super::limits;
use super::records;

/// Opcode and length before every record.
const HEAD: u64 = 9;
/// Fixed part of a message record: channel, sequence, log time, publish time.
const MESSAGE_HEAD: u64 = 22;
/// Footer record with its head, and the magic after it.
const FOOTER: u64 = HEAD + 20;
/// Loose messages that are read together.
const LOOSE: u64 = 1024 * 1024;
/// Bytes read ahead while scanning.
const WINDOW: u64 = 64 * 1024;

/// A place in a file that is not as it should be.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Damage {
    /// The file.
    pub path: PathBuf,
    /// Where it begins, in bytes from the start of the file.
    pub offset: u64,
    /// Bytes that cannot be used.
    pub bytes: u64,
    /// What should be there.
    pub expected: String,
    /// What is there.
    pub found: String,
}

impl Damage {
    pub(crate) fn error(&self) -> BagError {
        BagError::Broken {
            path: self.path.clone(),
            offset: self.offset,
            expected: self.expected.clone(),
            found: self.found.clone(),
        }
    }
}

/// Damaged places, each once. Of a file with very many of them the first ones are reported.
#[derive(Debug, Default)]
pub(crate) struct Places {
    list: Vec<Damage>,
    known: HashSet<(PathBuf, u64)>,
}

impl Places {
    pub fn new(list: Vec<Damage>) -> Self {
        let known = list.iter().map(|damage| (damage.path.clone(), damage.offset)).collect();
        Self { list, known }
    }

    /// Adds a place; how many bytes it has is only asked for where it is new.
    pub fn note(&mut self, mut damage: Damage, bytes: impl FnOnce(&Damage) -> u64) {
        if self.list.len() < 2 * limits::PLACES
            && self.known.insert((damage.path.clone(), damage.offset))
        {
            damage.bytes = bytes(&damage);
            self.list.push(damage);
        }
    }

    pub fn into_list(self) -> Vec<Damage> {
        self.list
    }
}

/// Schema of a channel.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Schema {
    pub name: String,
    pub encoding: String,
    pub data: Vec<u8>,
}

/// A part of the file with messages in it: a chunk, or a run of messages outside of chunks.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Span {
    pub offset: u64,
    pub length: u64,
    pub is_chunk: bool,
    /// First log time in it, ns.
    pub start: u64,
    /// Last log time in it, ns.
    pub end: u64,
    /// Bytes that it says it unpacks to; those that it has, outside of chunks.
    pub unpacked: u64,
}

/// One message of a span: its header and where its data are in the span's bytes.
#[derive(Debug, Clone)]
pub(crate) struct Located {
    pub header: MessageHeader,
    pub from: usize,
    pub to: usize,
}

/// An unpacked span.
pub(crate) struct Unpacked {
    pub bytes: Arc<Vec<u8>>,
    pub messages: Vec<Located>,
    /// What was wrong in it; the messages before it are there.
    pub damage: Option<Damage>,
}

/// Channels and schemas seen so far.
#[derive(Debug, Clone, Default)]
pub(crate) struct Directory {
    pub schemas: HashMap<u16, Schema>,
    pub channels: BTreeMap<u16, mcap::records::Channel>,
    /// Bytes of all of them.
    bytes: u64,
}

/// Where [`Layout::unpack`] knows the channels from.
pub(crate) enum Channels<'a> {
    /// Whatever the span declares is added.
    Noted(&'a mut Directory),
    /// All are known.
    Known(&'a Directory),
}

impl Channels<'_> {
    fn has(&self, channel: u16) -> bool {
        let directory = match self {
            Self::Noted(directory) => &**directory,
            Self::Known(directory) => directory,
        };
        directory.channels.contains_key(&channel)
    }
}

impl Directory {
    /// Takes note of a schema or channel; the first with an id stays.
    fn note(&mut self, record: Record<'_>) {
        match record {
            Record::Schema { header, data } => {
                self.schemas.entry(header.id).or_insert_with(|| {
                    self.bytes += data.len() as u64;
                    Schema { name: header.name, encoding: header.encoding, data: data.into_owned() }
                });
            }
            Record::Channel(channel) => {
                self.channels.entry(channel.id).or_insert_with(|| {
                    let metadata = channel.metadata.iter();
                    let texts = metadata.map(|(key, value)| 100 + key.len() + value.len());
                    self.bytes += (channel.topic.len() + texts.sum::<usize>()) as u64;
                    channel
                });
            }
            _ => {}
        }
    }

    /// Whether it has taken in as much as a file may declare.
    fn is_full(&self) -> bool {
        self.bytes > limits::DIRECTORY
    }
}

/// An attachment: its name, and where its record is.
#[derive(Debug, Clone)]
pub(crate) struct StoredAttachment {
    pub name: String,
    /// Of the body of the record.
    offset: u64,
    length: u64,
}

/// An attachment with what is in it.
pub(crate) struct Attached {
    pub header: mcap::records::AttachmentHeader,
    pub data: Vec<u8>,
}

/// What a file holds, short of the messages themselves.
pub(crate) struct Layout {
    pub path: PathBuf,
    file: Arc<File>,
    size: u64,
    pub spans: Vec<Span>,
    pub directory: Directory,
    pub metadata: Vec<(String, BTreeMap<String, String>)>,
    pub attachments: Vec<StoredAttachment>,
    /// From the index at the end, if it is whole.
    pub statistics: Option<Statistics>,
    pub damage: Vec<Damage>,
    /// Offset of the end of the data section and its checksum.
    data_end: Option<(u64, u32)>,
}

/// Reads forward in a file through a window.
struct Window<'a> {
    path: &'a Path,
    file: &'a File,
    start: u64,
    bytes: Vec<u8>,
}

impl Window<'_> {
    fn get(&mut self, offset: u64, length: u64) -> Result<&[u8], BagError> {
        let inside =
            offset >= self.start && offset + length <= self.start + self.bytes.len() as u64;
        if !inside {
            let wanted = length.max(WINDOW);
            self.bytes.resize(wanted as usize, 0);
            let mut filled = 0;
            while filled < self.bytes.len() {
                match self.file.read_at(&mut self.bytes[filled..], offset + filled as u64) {
                    Ok(0) => break,
                    Ok(n) => filled += n,
                    Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
                    Err(e) => return Err(BagError::reading(self.path, e)),
                }
            }
            self.bytes.truncate(filled);
            self.start = offset;
        }
        let from = (offset - self.start) as usize;
        self.bytes
            .get(from..from + length as usize)
            .ok_or_else(|| BagError::reading(self.path, std::io::ErrorKind::UnexpectedEof.into()))
    }
}

/// Name of a record type, for messages to people.
fn record_name(opcode: u8) -> &'static str {
    match opcode {
        op::HEADER => "header",
        op::FOOTER => "footer",
        op::SCHEMA => "schema",
        op::CHANNEL => "channel",
        op::MESSAGE => "message",
        op::CHUNK => "chunk",
        op::MESSAGE_INDEX => "message index",
        op::CHUNK_INDEX => "chunk index",
        op::ATTACHMENT => "attachment",
        op::ATTACHMENT_INDEX => "attachment index",
        op::STATISTICS => "statistics",
        op::METADATA => "metadata",
        op::METADATA_INDEX => "metadata index",
        op::SUMMARY_OFFSET => "summary offset",
        op::DATA_END => "end of data",
        _ => "unknown",
    }
}

fn is_record(opcode: u8) -> bool {
    matches!(opcode, op::HEADER..=op::DATA_END) || opcode >= 0x80
}

fn u64_at(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_le_bytes(bytes.get(at..)?.first_chunk::<8>().copied()?))
}

/// The index at the end of a file.
struct Summary {
    start: u64,
    directory: Directory,
    statistics: Option<Statistics>,
    chunks: Vec<ChunkIndex>,
}

/// Reads the index at the end, if the end of the file is whole; `Err` in the inner result says what
/// is not.
fn read_summary(
    window: &mut Window<'_>,
    size: u64,
) -> Result<Option<Result<Summary, Damage>>, BagError> {
    let path = window.path.to_owned();
    let magic = MAGIC.len() as u64;
    if size < 2 * magic + FOOTER {
        return Ok(None);
    }
    let at = size - magic - FOOTER;
    let tail = window.get(at, FOOTER + magic)?.to_vec();
    if !tail.ends_with(MAGIC) || tail[0] != op::FOOTER || u64_at(&tail, 1) != Some(FOOTER - HEAD) {
        return Ok(None);
    }
    let Ok(Record::Footer(footer)) = records::parse(op::FOOTER, &tail[9..29]) else {
        return Ok(None);
    };
    let damage = |expected: String, found: String| Damage {
        path: path.clone(),
        offset: footer.summary_start.min(size),
        bytes: 0,
        expected,
        found,
    };
    if footer.summary_start == 0 {
        return Ok(Some(Err(damage("an index".into(), "none in the footer".into()))));
    }
    if footer.summary_start < magic || footer.summary_start > at {
        return Ok(Some(Err(damage(
            format!("an index between bytes {magic} and {at}"),
            format!("{} in the footer", footer.summary_start),
        ))));
    }
    let length = at - footer.summary_start;
    if length > limits::INDEX {
        return Ok(Some(Err(damage(
            format!("an index of at most {} bytes", limits::INDEX),
            format!("{length} bytes"),
        ))));
    }
    let bytes = window.get(footer.summary_start, length)?.to_vec();
    if footer.summary_crc != 0 {
        let mut crc = crc32fast::Hasher::new();
        crc.update(&bytes);
        crc.update(&tail[..(FOOTER - 4) as usize]);
        let calculated = crc.finalize();
        if calculated != footer.summary_crc {
            return Ok(Some(Err(damage(
                format!("an index with checksum {:08x}", footer.summary_crc),
                format!("{calculated:08x}"),
            ))));
        }
    }
    let mut summary = Summary {
        start: footer.summary_start,
        directory: Directory::default(),
        statistics: None,
        chunks: Vec::new(),
    };
    let mut at = 0usize;
    while at < bytes.len() {
        let body = u64_at(&bytes, at + 1)
            .and_then(|length| usize::try_from(length).ok())
            .and_then(|length| (at + 9).checked_add(length))
            .and_then(|end| bytes.get(at + 9..end));
        let Some(body) = body else {
            return Ok(Some(Err(damage(
                "whole records in the index".into(),
                format!("one cut short at byte {}", footer.summary_start + at as u64),
            ))));
        };
        match records::parse(bytes[at], body) {
            Ok(Record::Statistics(statistics)) => summary.statistics = Some(statistics),
            Ok(Record::ChunkIndex(chunk)) => summary.chunks.push(chunk),
            Ok(record @ (Record::Schema { .. } | Record::Channel(_))) => {
                summary.directory.note(record);
                if summary.directory.is_full() {
                    return Ok(Some(Err(damage(
                        format!("schemas and channels of at most {} bytes", limits::DIRECTORY),
                        "more in the index".into(),
                    ))));
                }
            }
            Ok(_) => {}
            Err(e) => {
                return Ok(Some(Err(damage(
                    format!("a {} record in the index", record_name(bytes[at])),
                    e,
                ))));
            }
        }
        at += 9 + body.len();
    }
    summary.chunks.sort_by_key(|c| c.chunk_start_offset);
    Ok(Some(Ok(summary)))
}

/// Finds the records of an MCAP file, which people know as `path`, where it takes `stored` bytes.
pub(crate) fn scan(path: &Path, file: File, stored: Option<u64>) -> Result<Layout, BagError> {
    let size = file.metadata().map_err(|e| BagError::reading(path, e))?.len();
    let mut window = Window { path, file: &file, start: 0, bytes: Vec::new() };
    let summary = read_summary(&mut window, size)?;
    let mut scanner = Scanner {
        window,
        size,
        spans: Vec::new(),
        directory: Directory::default(),
        metadata: Vec::new(),
        attachments: Vec::new(),
        damage: Vec::new(),
        data_end: None,
        room: limits::unpacked(stored.unwrap_or(size)),
        declared: 0,
    };
    scanner.run(match &summary {
        Some(Ok(summary)) => Some(summary),
        _ => None,
    })?;
    let Scanner { spans, mut directory, metadata, attachments, mut damage, data_end, .. } = scanner;
    let mut statistics = None;
    match summary {
        Some(Ok(summary)) => {
            statistics = summary.statistics;
            for (id, schema) in summary.directory.schemas {
                directory.schemas.entry(id).or_insert(schema);
            }
            for (id, channel) in summary.directory.channels {
                directory.channels.entry(id).or_insert(channel);
            }
        }
        Some(Err(problem)) => damage.push(problem),
        None => {}
    }
    Ok(Layout {
        path: path.to_owned(),
        file: Arc::new(file),
        size,
        spans,
        directory,
        metadata,
        attachments,
        statistics,
        damage,
        data_end,
    })
}

struct Scanner<'a> {
    window: Window<'a>,
    size: u64,
    spans: Vec<Span>,
    directory: Directory,
    metadata: Vec<(String, BTreeMap<String, String>)>,
    attachments: Vec<StoredAttachment>,
    damage: Vec<Damage>,
    data_end: Option<(u64, u32)>,
    /// Bytes that chunks may still unpack to.
    room: u64,
    /// Bytes of the records of metadata.
    declared: u64,
}

/// What the record at an offset is.
enum Step {
    /// Go on at this offset.
    To(u64),
    /// The file ends as it should.
    End,
}

impl Scanner<'_> {
    fn run(&mut self, summary: Option<&Summary>) -> Result<(), BagError> {
        let mut offset = MAGIC.len() as u64;
        loop {
            if let Some((expected, found)) = self.excess() {
                self.damage.push(Damage {
                    path: self.window.path.to_owned(),
                    offset,
                    bytes: self.size - offset,
                    expected,
                    found,
                });
                return Ok(());
            }
            match self.record(offset)? {
                Ok(Step::To(next)) => offset = next,
                Ok(Step::End) => return Ok(()),
                Err((expected, found)) => {
                    let next = summary.and_then(|s| {
                        s.chunks
                            .iter()
                            .map(|c| c.chunk_start_offset)
                            .chain([s.start])
                            .find(|&o| o > offset && o < self.size)
                    });
                    self.damage.push(Damage {
                        path: self.window.path.to_owned(),
                        offset,
                        bytes: next.unwrap_or(self.size) - offset,
                        expected,
                        found,
                    });
                    match next {
                        Some(next) => offset = next,
                        None => return Ok(()),
                    }
                }
            }
        }
    }

    /// What a file has too much of for the rest of it to be read.
    fn excess(&self) -> Option<(String, String)> {
        if self.damage.len() >= limits::PLACES {
            return Some((
                "a recording".into(),
                format!("{} damaged places before it; the rest is not read", limits::PLACES),
            ));
        }
        let at_most =
            |bytes: u64| format!("schemas, channels and metadata of at most {bytes} bytes");
        if self.directory.is_full() || self.declared > limits::DIRECTORY {
            return Some((at_most(limits::DIRECTORY), "more; the rest is not read".into()));
        }
        (self.spans.len() >= limits::SPANS).then(|| {
            let expected = format!("at most {} chunks", limits::SPANS);
            (expected, "more; the rest is not read".into())
        })
    }

    /// Takes in the record at `offset`. The inner error says what was expected and what is there.
    #[allow(clippy::type_complexity)]
    fn record(&mut self, offset: u64) -> Result<Result<Step, (String, String)>, BagError> {
        let left = self.size - offset;
        if left < HEAD {
            let found = match left {
                0 => "the end of the file".to_owned(),
                _ => format!("the last {left} bytes of the file"),
            };
            return Ok(Err(("a record".into(), found)));
        }
        let head = self.window.get(offset, HEAD)?;
        let opcode = head[0];
        let length = u64_at(head, 1).unwrap_or(u64::MAX);
        if !is_record(opcode) {
            return Ok(Err(("a record (type 0x01 to 0x0f)".into(), format!("type {opcode:#04x}"))));
        }
        let name = record_name(opcode);
        if length > left - HEAD {
            return Ok(Err((
                format!("a {name} record of {length} bytes"),
                format!("{} bytes up to the end of the file", left - HEAD),
            )));
        }
        let body = offset + HEAD;
        let next = body + length;
        let unreadable = |e: String| (format!("a {name} record"), e);
        match opcode {
            op::CHUNK => {
                // start, end, size, checksum, length of the name of the compression
                const FIXED: u64 = 8 + 8 + 8 + 4 + 4;
                if length < FIXED {
                    return Ok(Err((
                        format!("a chunk record of at least {FIXED} bytes"),
                        format!("{length} bytes"),
                    )));
                }
                let bytes = self.window.get(body, FIXED)?;
                let at = |at: usize| u64_at(bytes, at).unwrap_or(0);
                let (start, end, unpacked) = (at(0), at(8), at(16));
                let span =
                    Span { offset, length: HEAD + length, is_chunk: true, start, end, unpacked };
                match self.room.checked_sub(unpacked) {
                    Some(room) => {
                        self.room = room;
                        self.spans.push(span);
                    }
                    None => self.damage.push(Damage {
                        path: self.window.path.to_owned(),
                        offset,
                        bytes: span.length,
                        expected: format!(
                            "chunks that unpack to at most {} bytes together",
                            limits::unpacked(self.size)
                        ),
                        found: format!("one of {unpacked} bytes beyond them"),
                    }),
                }
            }
            op::MESSAGE => {
                if length < MESSAGE_HEAD {
                    return Ok(Err((
                        format!("a message record of at least {MESSAGE_HEAD} bytes"),
                        format!("{length} bytes"),
                    )));
                }
                let time = u64_at(self.window.get(body, MESSAGE_HEAD)?, 6).unwrap_or(0);
                match self.spans.last_mut() {
                    Some(span)
                        if !span.is_chunk
                            && span.offset + span.length == offset
                            && span.length < LOOSE =>
                    {
                        span.length += HEAD + length;
                        span.unpacked = span.length;
                        span.start = span.start.min(time);
                        span.end = span.end.max(time);
                    }
                    _ => self.spans.push(Span {
                        offset,
                        length: HEAD + length,
                        is_chunk: false,
                        start: time,
                        end: time,
                        unpacked: HEAD + length,
                    }),
                }
            }
            op::SCHEMA | op::CHANNEL | op::METADATA | op::ATTACHMENT | op::DATA_END
                if length
                    <= if opcode == op::ATTACHMENT { limits::CHUNK } else { limits::DIRECTORY } =>
            {
                match records::parse(opcode, self.window.get(body, length)?) {
                    Ok(Record::Metadata(m)) => {
                        self.declared += length;
                        self.metadata.push((m.name, m.metadata));
                    }
                    Ok(Record::Attachment { header, .. }) => {
                        self.declared += header.name.len() as u64 + 64;
                        self.attachments.push(StoredAttachment {
                            name: header.name,
                            offset: body,
                            length,
                        });
                    }
                    Ok(Record::DataEnd(end)) => {
                        self.data_end = Some((offset, end.data_section_crc));
                    }
                    Ok(record) => self.directory.note(record),
                    Err(e) => {
                        // its extent is known: only this record is lost
                        let (expected, found) = unreadable(e);
                        self.damage.push(Damage {
                            path: self.window.path.to_owned(),
                            offset,
                            bytes: HEAD + length,
                            expected,
                            found,
                        });
                    }
                }
            }
            op::FOOTER => {
                let magic = MAGIC.len() as u64;
                if self.size - next < magic || self.window.get(next, magic)? != MAGIC {
                    return Ok(Err((
                        "the MCAP signature after the footer".into(),
                        format!("{} other bytes", self.size - next),
                    )));
                }
                let after = self.size - next - magic;
                if after > 0 {
                    self.damage.push(Damage {
                        path: self.window.path.to_owned(),
                        offset: next + magic,
                        bytes: after,
                        expected: "the end of the file".into(),
                        found: format!("{after} more bytes"),
                    });
                }
                return Ok(Ok(Step::End));
            }
            op::SCHEMA | op::CHANNEL | op::METADATA | op::ATTACHMENT => {
                self.damage.push(Damage {
                    path: self.window.path.to_owned(),
                    offset,
                    bytes: HEAD + length,
                    expected: format!("a {name} record of a size that is read"),
                    found: format!("{length} bytes"),
                });
            }
            _ => {}
        }
        Ok(Ok(Step::To(next)))
    }
}

impl Layout {
    /// An attachment with its data, which its checksum has confirmed.
    pub fn attached(&self, attachment: &StoredAttachment) -> Result<Attached, BagError> {
        let mut record = vec![0; attachment.length as usize];
        self.file
            .read_exact_at(&mut record, attachment.offset)
            .map_err(|e| BagError::reading(&self.path, e))?;
        match records::parse(op::ATTACHMENT, &record) {
            Ok(Record::Attachment { header, data, .. }) => {
                Ok(Attached { header, data: data.into_owned() })
            }
            _ => Err(BagError::Broken {
                path: self.path.clone(),
                offset: attachment.offset - HEAD,
                expected: "an attachment record".into(),
                found: "one that has changed since".into(),
            }),
        }
    }

    /// Unpacks a span: its messages, and the schemas and channels in it, if they are noted.
    pub fn unpack(&self, span: &Span, mut channels: Channels<'_>) -> Result<Unpacked, BagError> {
        let damage = |expected: String, found: String| Damage {
            path: self.path.clone(),
            offset: span.offset,
            bytes: span.length,
            expected,
            found,
        };
        let nothing =
            |damage| Unpacked { bytes: Arc::default(), messages: Vec::new(), damage: Some(damage) };
        if span.length > limits::CHUNK {
            return Ok(nothing(damage(
                format!("a chunk of at most {} bytes", limits::CHUNK),
                format!("{} bytes", span.length),
            )));
        }
        let mut raw = vec![0; span.length as usize];
        self.file
            .read_exact_at(&mut raw, span.offset)
            .map_err(|e| BagError::reading(&self.path, e))?;
        let bytes = if span.is_chunk {
            match unpack_chunk(&raw[HEAD as usize..]) {
                Ok(bytes) => bytes,
                Err((expected, found)) => return Ok(nothing(damage(expected, found))),
            }
        } else {
            raw
        };
        let mut messages = Vec::new();
        let mut problem = None;
        let mut at = 0usize;
        while at < bytes.len() {
            if messages.len() >= limits::CHUNK_MESSAGES {
                problem = Some(damage(
                    format!("at most {} messages in a chunk", limits::CHUNK_MESSAGES),
                    format!("more, from {at} bytes into it on"),
                ));
                break;
            }
            let body = u64_at(&bytes, at + 1)
                .and_then(|length| usize::try_from(length).ok())
                .and_then(|length| (at + 9).checked_add(length))
                .filter(|&end| end <= bytes.len());
            let Some(end) = body else {
                problem = Some(damage(
                    "whole records in the chunk".into(),
                    format!("one cut short {at} bytes into it"),
                ));
                break;
            };
            let from = at + HEAD as usize + MESSAGE_HEAD as usize;
            match records::parse(bytes[at], &bytes[at + 9..end]) {
                Ok(Record::Message { header, .. }) if channels.has(header.channel_id) => {
                    messages.push(Located { header, from, to: end });
                }
                Ok(Record::Message { header, .. }) => {
                    problem.get_or_insert_with(|| {
                        damage(
                            "messages of channels that the file declares".into(),
                            format!("channel {}", header.channel_id),
                        )
                    });
                }
                Ok(record) => {
                    if let Channels::Noted(directory) = &mut channels {
                        directory.note(record);
                        if directory.is_full() {
                            problem = Some(damage(
                                format!(
                                    "schemas and channels of at most {} bytes",
                                    limits::DIRECTORY
                                ),
                                format!("more, from {at} bytes into the chunk on"),
                            ));
                            break;
                        }
                    }
                }
                Err(e) => {
                    problem.get_or_insert_with(|| {
                        damage(format!("a {} record in the chunk", record_name(bytes[at])), e)
                    });
                }
            }
            at = end;
        }
        Ok(Unpacked { bytes: Arc::new(bytes), messages, damage: problem })
    }

    /// Bytes of the file.
    pub fn size(&self) -> u64 {
        self.size
    }

    /// Compares the checksum over the whole data section, where the file has one.
    pub fn verify_checksum(&self) -> Result<Option<Damage>, BagError> {
        let Some((end, stored)) = self.data_end.filter(|&(_, crc)| crc != 0) else {
            return Ok(None);
        };
        let mut crc = crc32fast::Hasher::new();
        let mut buffer = vec![0; 1 << 20];
        let mut at = 0;
        while at < end {
            let n = buffer.len().min((end - at) as usize);
            self.file
                .read_exact_at(&mut buffer[..n], at)
                .map_err(|e| BagError::reading(&self.path, e))?;
            crc.update(&buffer[..n]);
            at += n as u64;
        }
        let calculated = crc.finalize();
        Ok((calculated != stored).then(|| Damage {
            path: self.path.clone(),
            offset: end,
            bytes: 0,
            expected: format!("data with checksum {stored:08x}"),
            found: format!("{calculated:08x}"),
        }))
    }
}

thread_local! {
    /// To make one takes longer than to unpack a small chunk.
    static UNPACKER: RefCell<Option<zstd::bulk::Decompressor<'static>>> = const {
        RefCell::new(None)
    };
}

/// Unpacks the body of a chunk record and compares its checksum.
fn unpack_chunk(body: &[u8]) -> Result<Vec<u8>, (String, String)> {
    let (header, data) = match records::parse(op::CHUNK, body) {
        Ok(Record::Chunk { header, data }) => (header, data),
        Ok(_) => return Err(("a chunk record".into(), "another".into())),
        Err(e) => return Err(("a chunk record".into(), e)),
    };
    if header.uncompressed_size > limits::CHUNK {
        return Err((
            format!("a chunk of at most {} bytes unpacked", limits::CHUNK),
            format!("{} bytes", header.uncompressed_size),
        ));
    }
    // one byte more than declared shows a chunk that is too long
    let limit = header.uncompressed_size + 1;
    // Bounded, and what is not filled is not touched.
    let mut bytes = Vec::with_capacity(limit as usize);
    let unpacked = match header.compression.as_str() {
        "" => {
            bytes.extend_from_slice(&data);
            Ok(data.len())
        }
        "zstd" => UNPACKER.with_borrow_mut(|unpacker| {
            let unpacker = match unpacker {
                Some(unpacker) => unpacker,
                none => none.insert(zstd::bulk::Decompressor::new()?),
            };
            unpacker.decompress_to_buffer(&data[..], &mut bytes)
        }),
        "lz4" => lz4::Decoder::new(&data[..])
            .and_then(|decoder| decoder.take(limit).read_to_end(&mut bytes)),
        other => {
            return Err(("compression zstd, lz4 or none".into(), format!("{other:?}")));
        }
    };
    if let Err(e) = unpacked {
        return Err((format!("a chunk that unpacks with {}", header.compression), e.to_string()));
    }
    if bytes.len() as u64 != header.uncompressed_size {
        return Err((
            format!("a chunk of {} bytes unpacked", header.uncompressed_size),
            format!("{} bytes", bytes.len()),
        ));
    }
    if header.uncompressed_crc != 0 {
        let calculated = crc32fast::hash(&bytes);
        if calculated != header.uncompressed_crc {
            return Err((
                format!("a chunk with checksum {:08x}", header.uncompressed_crc),
                format!("{calculated:08x}"),
            ));
        }
    }
    Ok(bytes)
}
