//! How much of a file is taken in, so that a small file costs little and a damaged one no more than
//! a whole one. Each limit is *assumed*: far above what recorders write, and together below 1 GB of
//! memory.

const MIB: u64 = 1024 * 1024;

/// Largest chunk, packed and unpacked, and largest message, bytes. Recorders write chunks of some
/// MiB at most; a message may be an image.
pub(super) const CHUNK: u64 = 128 * MIB;
/// Messages in one chunk.
pub(super) const CHUNK_MESSAGES: usize = 1 << 20;
/// Bytes of all chunks that are open at once since their times overlap, with [`BESIDE_MESSAGE`] for
/// each of their messages.
pub(super) const OPEN: u64 = 256 * MIB;
/// Memory that a queued message takes in addition to its own bytes, bytes.
pub(super) const BESIDE_MESSAGE: u64 = 128;
/// Schemas, channels and metadata of a file, in their records, bytes.
pub(super) const DIRECTORY: u64 = 32 * MIB;
/// Largest index at the end of a file, bytes.
pub(super) const INDEX: u64 = 64 * MIB;
/// Definitions of all topics of a recording, bytes: each topic has its own copy.
pub(super) const DEFINITIONS: u64 = 32 * MIB;
/// Parts of a file with messages in them.
pub(super) const SPANS: usize = 1 << 21;
/// Files that `metadata.yaml` may name.
pub(super) const FILES: usize = 10_000;
/// Damaged places that are listed one by one.
pub(super) const PLACES: usize = 1000;

/// Bytes to which all that is compressed in `size` bytes may unpack: a thousand times as many, and
/// a quarter of a GiB in any case. Beyond it are files that are made to keep a reader busy.
pub(super) fn unpacked(size: u64) -> u64 {
    size.saturating_mul(1000).max(256 * MIB)
}
