//! Which files make a recording, and what each of them is.
//!
//! In goes a path; out come open files, each by what it begins with and not by its name, with what
//! `metadata.yaml` says. A file that rosbag2 compressed as a whole is unpacked into a temporary
//! file.

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

use friction_stage_core::text_file;
use tempfile::NamedTempFile;

use super::error::BagError;
use super::file::{Damage, Layout, scan};
use super::metadata::{self, Found};
use super::sqlite::Database;

/// Endings of files with messages.
const ENDINGS: [&str; 2] = ["mcap", "db3"];
/// What rosbag2 adds to the name of a file that it compresses.
const PACKED: &str = "zstd";

/// What a file is by its first bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Format {
    Mcap,
    Sqlite,
    Zstd,
}

impl Format {
    const ALL: [(Self, &[u8]); 3] =
        [(Self::Mcap, mcap::MAGIC), (Self::Sqlite, SQLITE_MAGIC), (Self::Zstd, &ZSTD_MAGIC)];
    /// So many bytes tell.
    const LENGTH: usize = 16;

    fn of(begin: &[u8]) -> Option<Self> {
        Self::ALL.iter().find(|(_, magic)| begin.starts_with(magic)).map(|(format, _)| *format)
    }
}

const SQLITE_MAGIC: &[u8] = b"SQLite format 3\0";
/// What data that are compressed with zstd begin with. No CDR message does.
pub(super) const ZSTD_MAGIC: [u8; 4] = [0x28, 0xb5, 0x2f, 0xfd];

/// The messages of one file.
pub(super) enum Content {
    Mcap(Box<Layout>),
    Sqlite(Box<Database>),
}

/// An open file of a recording.
pub(super) struct StoredFile {
    pub content: Content,
    /// Where it was unpacked to; removed with the recording.
    _unpacked: Option<NamedTempFile>,
}

/// The files of a recording.
pub(super) struct Files {
    pub paths: Vec<PathBuf>,
    /// Those that `metadata.yaml` names and that are not there.
    pub missing: Vec<Damage>,
    pub metadata: Option<Found>,
}

impl Files {
    /// The data files of a rosbag2 directory. One without `metadata.yaml`, or with a broken one, is
    /// its files `*.mcap` and `*.db3`, in the order of their numbers.
    pub fn of_directory(directory: &Path) -> Result<Self, BagError> {
        let not_a_bag = |reason: String| BagError::NotABag { path: directory.to_owned(), reason };
        let metadata = Found::read(directory);
        let mut missing = Vec::new();
        if let Ok(Some(found)) = &metadata {
            let mut paths = Vec::new();
            for path in found.paths(directory)? {
                match stored_as(&path) {
                    Some(path) if paths.contains(&path) => {}
                    Some(path) => paths.push(path),
                    None => missing.push(Damage {
                        path,
                        offset: 0,
                        bytes: 0,
                        expected: "a file that metadata.yaml names".into(),
                        found: "none".into(),
                    }),
                }
            }
            if !paths.is_empty() {
                all_inside(directory, &paths)?;
                return Ok(Self { paths, missing, metadata: metadata.ok().flatten() });
            }
        }
        let mut paths = Vec::new();
        let entries = std::fs::read_dir(directory).map_err(|e| BagError::reading(directory, e))?;
        for entry in entries {
            let path = entry.map_err(|e| BagError::reading(directory, e))?.path();
            if number(&path).is_some() && path.is_file() {
                paths.push(path);
            }
        }
        if paths.is_empty() {
            return match metadata {
                Err(error) => Err(error),
                Ok(Some(metadata)) => Err(not_a_bag(format!(
                    "metadata.yaml names {:?}, which are not there",
                    metadata.relative_file_paths()
                ))),
                Ok(None) => Err(not_a_bag(
                    "it has neither metadata.yaml nor a file *.mcap or *.db3; give the directory \
                     that has them, or a file"
                        .into(),
                )),
            };
        }
        paths.sort_by_cached_key(|path| number(path));
        // The same file, packed and unpacked, counts once.
        let all = paths.clone();
        paths.retain(|path| !is_packed(path) || !all.contains(&path.with_extension("")));
        all_inside(directory, &paths)?;
        // None of the files that the metadata name is there: these have new names.
        Ok(Self { paths, missing: Vec::new(), metadata: metadata.ok().flatten() })
    }
}

/// Refuses a link that leads out of the directory: a bag opens nothing but itself. The directory
/// may be behind links, and where its path cannot be made whole, as in `/proc/1/root`.
fn all_inside(directory: &Path, paths: &[PathBuf]) -> Result<(), BagError> {
    let whole = |path: &Path| path.canonicalize().map_err(|e| BagError::reading(path, e));
    let is_link = |path: &Path| {
        let inside = path.ancestors().take_while(|above| *above != directory);
        inside.into_iter().any(Path::is_symlink)
    };
    for path in paths.iter().filter(|path| is_link(path)) {
        let (home, place) = (whole(directory)?, whole(path)?);
        if !place.starts_with(&home) {
            let reason = format!(
                "{:?} is a link to {place:?}: a bag's files lie in its own directory; give that \
                 file itself",
                path.file_name().unwrap_or_default()
            );
            return Err(BagError::NotABag { path: directory.to_owned(), reason });
        }
    }
    Ok(())
}

fn is_packed(path: &Path) -> bool {
    path.extension().is_some_and(|ending| ending == PACKED)
}

/// The number and the name by which a data file is put in order: name_2 before name_10. None for
/// another file.
fn number(path: &Path) -> Option<(Option<u64>, String)> {
    let plain = if is_packed(path) { path.with_extension("") } else { path.to_owned() };
    let ending = plain.extension()?.to_str()?.to_owned();
    let stem = plain.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let number = stem.rsplit('_').next().and_then(|number| number.parse().ok());
    ENDINGS.contains(&ending.as_str()).then_some((number, stem))
}

/// Where a file is that the metadata name: packed or not, whichever they say.
fn stored_as(path: &Path) -> Option<PathBuf> {
    let mut packed = path.as_os_str().to_owned();
    packed.push(".");
    packed.push(PACKED);
    let unpacked = is_packed(path).then(|| path.with_extension(""));
    let ways = [Some(path.to_owned()), Some(packed.into()), unpacked];
    ways.into_iter().flatten().find(|path| path.is_file())
}

impl StoredFile {
    /// Opens a file of any of the formats. An error means that nothing of it can be read.
    pub fn open(path: &Path) -> Result<Self, BagError> {
        let reading = |error| BagError::reading(path, error);
        text_file::regular(path).map_err(reading)?;
        let mut file = File::open(path).map_err(reading)?;
        let begin = begin_of(&mut file).map_err(reading)?;
        match Format::of(&begin) {
            Some(Format::Mcap) => Ok(Self {
                content: Content::Mcap(Box::new(scan(path, file, None)?)),
                _unpacked: None,
            }),
            Some(Format::Sqlite) => Ok(Self {
                content: Content::Sqlite(Box::new(Database::open(path, path)?)),
                _unpacked: None,
            }),
            Some(Format::Zstd) => Self::open_packed(path),
            None => Err(unknown(path, &begin)),
        }
    }

    fn open_packed(path: &Path) -> Result<Self, BagError> {
        let Unpacked { file, format, damage } = unpack(path)?;
        let reading = |error| BagError::reading(path, error);
        let mut content = match format {
            Format::Sqlite => Content::Sqlite(Box::new(Database::open(path, file.path())?)),
            _ => {
                let stored = std::fs::metadata(path).map_err(reading)?.len();
                Content::Mcap(Box::new(scan(path, file.reopen().map_err(reading)?, Some(stored))?))
            }
        };
        match &mut content {
            Content::Mcap(layout) => layout.damage.extend(damage),
            Content::Sqlite(database) => database.damage.extend(damage),
        }
        Ok(Self { content, _unpacked: Some(file) })
    }
}

/// The first bytes of a file, for [`Format::of`].
fn begin_of(file: &mut impl Read) -> io::Result<Vec<u8>> {
    let mut begin = Vec::new();
    file.take(Format::LENGTH as u64).read_to_end(&mut begin)?;
    Ok(begin)
}

fn unknown(path: &Path, begin: &[u8]) -> BagError {
    const ARRAYS: [&[u8]; 4] = [b"\x93NUMPY", b"PK\x03\x04", b"\x89HDF", b"MATLAB"];
    let hex: Vec<String> = begin.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    let hex = if begin.is_empty() { "nothing".to_owned() } else { hex.join(" ") };
    let is_text = |byte: &u8| matches!(byte, b'\t' | b'\r' | b'\n' | b' '..=b'~');
    let hint = if begin.starts_with(b"#ROSBAG") {
        " (a bag of ROS 1: `rosbags-convert` makes one of ROS 2)"
    } else if path.file_name().is_some_and(|name| name == metadata::FILE_NAME) {
        " (give the directory that it is in)"
    } else if begin.is_empty() {
        " (the file is empty)"
    } else if ARRAYS.iter().any(|magic| begin.starts_with(magic)) {
        " (arrays; of a table in them `friction-stage import` makes a bag)"
    } else if begin.iter().all(is_text) {
        " (text; of a table in it `friction-stage import` makes a bag)"
    } else {
        ""
    };
    BagError::UnknownFormat { path: path.to_owned(), found: hex + hint }
}

/// Whether a path is a directory or a file that recordings are made of.
pub(crate) fn is_recording(path: &Path) -> bool {
    let open = || text_file::regular(path).and_then(|()| File::open(path));
    let begin = || open().and_then(|mut file| begin_of(&mut file));
    path.is_dir() || begin().is_ok_and(|begin| Format::of(&begin).is_some())
}

/// A file that was unpacked, and what of it could not be.
struct Unpacked {
    file: NamedTempFile,
    format: Format,
    damage: Option<Damage>,
}

/// So many times its size a file may unpack to, and at least [`UNPACKED`] bytes. Assumed: beyond
/// what a recording reaches, and far below files that are made to fill a disk.
const MOST_TIMES: u64 = 1000;
const UNPACKED: u64 = 1 << 30;

/// Unpacks a file into a temporary one, in a bounded piece of memory. It may take half of what is
/// free there; what is no recording inside is refused before it is unpacked.
fn unpack(path: &Path) -> Result<Unpacked, BagError> {
    let reading = |error| BagError::reading(path, error);
    let place = std::env::temp_dir();
    let cannot = |source| BagError::Unpack { path: path.to_owned(), place: place.clone(), source };
    let packed = File::open(path).map_err(reading)?;
    let packed_size = packed.metadata().map_err(reading)?.len();
    let mut unpacked = zstd::Decoder::new(packed).map_err(reading)?;
    let (begin, mut failure) = match begin_of(&mut unpacked) {
        Ok(begin) => (begin, None),
        Err(error) => (Vec::new(), Some(error)),
    };
    let format = match Format::of(&begin) {
        Some(format @ (Format::Mcap | Format::Sqlite)) => format,
        _ if failure.is_some() => {
            return Err(BagError::Broken {
                path: path.to_owned(),
                offset: 0,
                expected: "a recording under zstd".into(),
                found: "data that do not unpack".into(),
            });
        }
        _ => return Err(unknown(path, &begin)),
    };
    let most = packed_size.saturating_mul(MOST_TIMES).max(UNPACKED);
    let room = (free_bytes(&place).map_err(cannot)? / 2).min(most);
    let mut file = NamedTempFile::with_prefix("friction-stage-").map_err(cannot)?;
    file.write_all(&begin).map_err(cannot)?;
    let mut size = begin.len() as u64;
    let mut buffer = vec![0; 1 << 20];
    loop {
        match unpacked.read(&mut buffer) {
            Ok(0) => break,
            Ok(read) => {
                size += read as u64;
                if size > room {
                    return Err(BagError::TooLarge {
                        path: path.to_owned(),
                        packed: packed_size,
                        room,
                        place,
                    });
                }
                file.write_all(&buffer[..read]).map_err(cannot)?;
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            Err(error) => {
                failure = Some(error);
                break;
            }
        }
    }
    file.flush().map_err(cannot)?;
    let damage = failure.map(|_| Damage {
        path: path.to_owned(),
        offset: size,
        bytes: 0,
        expected: "data that unpack with zstd to their end".into(),
        found: format!("an end or a fault after {size} unpacked bytes"),
    });
    Ok(Unpacked { file, format, damage })
}

/// Bytes that are free on the file system of `directory`.
fn free_bytes(directory: &Path) -> io::Result<u64> {
    let path = std::ffi::CString::new(directory.as_os_str().as_bytes())?;
    let mut found = std::mem::MaybeUninit::<libc::statvfs>::uninit();
    // SAFETY: `path` ends with a zero, and `found` is read only where the call has filled it.
    let found = unsafe {
        if libc::statvfs(path.as_ptr(), found.as_mut_ptr()) != 0 {
            return Err(io::Error::last_os_error());
        }
        found.assume_init()
    };
    // The types of these fields differ between systems.
    #[allow(clippy::useless_conversion, clippy::unnecessary_cast)]
    Ok((found.f_bavail as u64).saturating_mul(found.f_frsize as u64))
}

/// Unpacks a message to at most so many bytes. The error says why it cannot be.
pub(super) fn unpack_message(packed: &[u8], most: u64) -> Result<Vec<u8>, String> {
    let mut message = Vec::new();
    zstd::Decoder::with_buffer(packed)
        .and_then(|decoder| decoder.take(most + 1).read_to_end(&mut message))
        .map_err(|_| format!("{} bytes that do not unpack", packed.len()))?;
    if message.len() as u64 > most {
        return Err(format!("{} bytes that unpack to more", packed.len()));
    }
    Ok(message)
}

/// Refuses a recording that is compressed in another way than with zstd.
pub(super) fn check_compression(path: &Path, metadata: &Found) -> Result<(), BagError> {
    let (mode, format) = (metadata.compression_mode(), metadata.compression_format());
    let is_packed = !mode.is_empty() && !mode.eq_ignore_ascii_case("none");
    if is_packed && !format.is_empty() && !format.eq_ignore_ascii_case(PACKED) {
        return Err(BagError::NotABag {
            path: path.to_owned(),
            reason: format!(
                "{} says that it is compressed with {format}, read is zstd; `ros2 bag convert` \
                 where {format} is installed makes a bag without",
                metadata::FILE_NAME
            ),
        });
    }
    Ok(())
}
