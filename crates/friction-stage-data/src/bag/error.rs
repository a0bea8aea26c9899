//! What can go wrong with a recording, with the file, the place in it and what would be right.

use std::io;
use std::path::{Path, PathBuf};

use thiserror::Error;

use crate::message::CdrError;

/// Why a recording could not be written or read.
#[derive(Debug, Error)]
pub enum BagError {
    /// The file that is recorded into was removed.
    #[error("{} was removed while it was being recorded", path.display())]
    Removed {
        /// The file.
        path: PathBuf,
    },
    /// The directory to record into exists.
    #[error(
        "{} exists; a recording never overwrites: choose another name or remove it",
        path.display()
    )]
    Exists {
        /// The directory.
        path: PathBuf,
    },
    /// The directory or a file in it could not be made.
    #[error("cannot create {}: {source}", path.display())]
    Create {
        /// The directory or file.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// No space is left, or a limit on file size or quota is reached.
    #[error(
        "no space left for {}: {source}, {written} bytes are written; free space, then run \
         `friction-stage recover` on it",
        path.display()
    )]
    Full {
        /// The file being written.
        path: PathBuf,
        /// Bytes that are in it.
        written: u64,
        /// What the operating system says.
        source: io::Error,
    },
    /// Writing failed for another reason.
    #[error("cannot write {} after {written} bytes: {source}", path.display())]
    Write {
        /// The file being written.
        path: PathBuf,
        /// Bytes that are in it.
        written: u64,
        /// What the operating system says.
        source: io::Error,
    },
    /// The MCAP library refused what was asked.
    #[error("cannot write {}: {source}", path.display())]
    Mcap {
        /// The file being written.
        path: PathBuf,
        /// What the library says.
        source: mcap::McapError,
    },
    /// A write after an earlier one failed.
    #[error(
        "recording to {} stopped after an earlier error: nothing more is written",
        path.display()
    )]
    Stopped {
        /// The file.
        path: PathBuf,
    },
    /// A topic was added twice with two types.
    #[error("topic {topic} is recorded as {known}, not as {asked}")]
    TopicType {
        /// The topic.
        topic: String,
        /// Its type so far.
        known: String,
        /// The type asked for now.
        asked: String,
    },
    /// A file could not be read.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// Not a recording that this program reads.
    #[error("{} is not a recording that can be read: {reason}", path.display())]
    NotABag {
        /// The directory or file.
        path: PathBuf,
        /// What is missing or different.
        reason: String,
    },
    /// A file of another kind.
    #[error(
        "{} is not an MCAP file, nor sqlite3 of rosbag2, nor one of them under zstd: it begins \
         with {found}",
        path.display()
    )]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// What it begins with.
        found: String,
    },
    /// A compressed file could not be unpacked to where temporary files go.
    #[error(
        "cannot unpack {} into {}: {source}; the variable TMPDIR names another place",
        path.display(),
        place.display()
    )]
    Unpack {
        /// The file.
        path: PathBuf,
        /// Directory of temporary files.
        place: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
    /// A compressed file unpacks to more than there is room for.
    #[error(
        "{} ({packed} bytes) unpacks to more than the {room} bytes that it may take in {}; the \
         variable TMPDIR names another place, or unpack it with `zstd -d`",
        path.display(),
        place.display()
    )]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Its size, bytes.
        packed: u64,
        /// Most bytes that it may unpack to.
        room: u64,
        /// Directory of temporary files.
        place: PathBuf,
    },
    /// A place in a file that is not as it should be.
    #[error("{} is damaged at byte {offset}: expected {expected}, found {found}; `friction-stage \
             recover` keeps what is whole", path.display())]
    Broken {
        /// The file.
        path: PathBuf,
        /// Offset in the file, in bytes.
        offset: u64,
        /// What should be there.
        expected: String,
        /// What is there.
        found: String,
    },
    /// A message that does not decode as its type.
    #[error("message at {log_time} ns on {topic} does not decode: {source}")]
    Decode {
        /// The topic.
        topic: String,
        /// Log time, ns.
        log_time: u64,
        /// Why not.
        source: CdrError,
    },
    /// A message of another type than asked for.
    #[error("topic {topic} carries {found}, not {expected}")]
    WrongType {
        /// The topic.
        topic: String,
        /// The type that the bag declares.
        found: String,
        /// The type that was asked for.
        expected: String,
    },
    /// A message could not be encoded.
    #[error("message for {topic} does not encode: {source}")]
    Encode {
        /// The topic.
        topic: String,
        /// Why not.
        source: CdrError,
    },
}

impl BagError {
    /// Classifies an error of the operating system while writing.
    pub(crate) fn writing(path: &Path, written: u64, source: io::Error) -> Self {
        let path = path.to_owned();
        let full = matches!(source.raw_os_error(), Some(libc::ENOSPC | libc::EFBIG | libc::EDQUOT));
        if full {
            Self::Full { path, written, source }
        } else {
            Self::Write { path, written, source }
        }
    }

    pub(crate) fn reading(path: &Path, source: io::Error) -> Self {
        Self::Read { path: path.to_owned(), source }
    }

    /// Where in the file it is, in bytes, if it is about a place in a file.
    pub fn offset(&self) -> Option<u64> {
        match self {
            Self::Broken { offset, .. } => Some(*offset),
            Self::UnknownFormat { .. } => Some(0),
            _ => None,
        }
    }
}
