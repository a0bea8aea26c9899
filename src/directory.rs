//! Names of directories for results.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

/// A directory that is named after what it holds and when: `<name>_<date>` in `parent`, UTC.
pub fn dated(parent: &Path, name: &str) -> PathBuf {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let seconds = i64::try_from(now.as_secs()).unwrap_or_default();
    let date = chrono::DateTime::from_timestamp(seconds, 0).unwrap_or_default();
    parent.join(format!("{name}_{}", date.format("%Y_%m_%d-%H_%M_%S")))
}
