//! Texts that a user names (models, catalogues, mappings, motions, parameters), read whole.
//!
//! In comes a path, out goes its text. Only regular files of a bounded size are read: a pipe could
//! block for ever, and a device has no end.

use std::fs::File;
use std::io::{Error, ErrorKind, Read};
use std::path::Path;

/// Largest text, bytes. Assumed: larger than any model, motion or mapping that a person or a
/// program writes, and a small part of the memory of any machine.
pub const LARGEST: u64 = 16 * 1024 * 1024;

/// Reads the text of a regular file of at most [`LARGEST`] bytes.
///
/// # Errors
/// The file cannot be opened, is no regular file, is too large, or is not UTF-8.
pub fn read(path: &Path) -> Result<String, Error> {
    // Looked at before it is opened: to open a pipe waits for its writer.
    regular(path)?;
    let file = File::open(path)?;
    let mut bytes = Vec::new();
    file.take(LARGEST + 1).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > LARGEST {
        let size = format!("it has more than {LARGEST} bytes, which no such text has");
        return Err(Error::new(ErrorKind::FileTooLarge, size));
    }
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        Error::new(ErrorKind::InvalidData, format!("it is no text: byte {at} is not UTF-8"))
    })
}

/// Refuses what is no regular file, with what it is.
pub fn regular(path: &Path) -> Result<(), Error> {
    let kind = std::fs::metadata(path)?.file_type();
    if kind.is_file() {
        return Ok(());
    }
    let what = if kind.is_dir() { "a directory" } else { "a pipe, a socket or a device" };
    Err(Error::new(ErrorKind::InvalidInput, format!("it is {what}, must be a regular file")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_regular_files_of_bounded_size_are_read() {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("text.yaml");
        std::fs::write(&path, "mass: 40\n").unwrap();
        assert_eq!(read(&path).unwrap(), "mass: 40\n");
        let error = |path: &Path| read(path).unwrap_err().to_string();
        assert!(error(home.path()).contains("a directory"));
        std::fs::write(&path, b"mass: \xff").unwrap();
        assert!(error(&path).contains("byte 6 is not UTF-8"), "{}", error(&path));
        // A file with a hole takes no space.
        File::create(&path).unwrap().set_len(LARGEST + 1).unwrap();
        assert!(error(&path).contains("more than 16777216 bytes"), "{}", error(&path));
    }

    #[cfg(unix)]
    #[test]
    fn devices_and_pipes_are_refused_without_being_opened() {
        for path in ["/dev/zero", "/dev/null"] {
            let error = read(Path::new(path)).unwrap_err().to_string();
            assert!(error.contains("must be a regular file"), "{path}: {error}");
        }
        let home = tempfile::tempdir().unwrap();
        let pipe = home.path().join("pipe");
        // It has no writer: opening it would block.
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        assert!(read(&pipe).unwrap_err().to_string().contains("a pipe"));
    }
}
