//! Where the recordings of real and emulated stages are: too large for the repository, and of EMPS
//! without a licence.

use std::io::Write as _;
use std::path::{Path, PathBuf};

/// The directory in `FRICTION_STAGE_RECORDINGS`, else `../shared/measured`; where it lacks `part`,
/// `None` and a message, and the test checks nothing.
pub fn with(part: &str) -> Option<PathBuf> {
    let home = std::env::var_os("FRICTION_STAGE_RECORDINGS").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/measured"),
        PathBuf::from,
    );
    if home.join(part).exists() {
        return Some(home);
    }
    // Past the test harness, which would keep it to itself.
    let message = format!(
        "SKIPPED: no {part} in {}; FRICTION_STAGE_RECORDINGS names the directory that it is in",
        home.display()
    );
    writeln!(std::io::stderr(), "{message}").ok();
    None
}
