//! Who made a result: program, version, date and command, as the results say it themselves.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::LazyLock;
use std::time::SystemTime;

use anyhow::Context as _;
use friction_stage_report::page::{with_footer, with_metadata};
use friction_stage_report::words::printable;
use serde::Serialize;

/// Longest command that is repeated, characters: one may name thousands of recordings.
const LONGEST: usize = 2000;
/// The file that says it in a directory of results.
pub const FILE: &str = "made_by.json";

/// Who made a result.
#[derive(Debug, Serialize)]
pub struct MadeBy {
    program: &'static str,
    version: &'static str,
    /// UTC.
    date: String,
    command: String,
}

static THIS_RUN: LazyLock<MadeBy> = LazyLock::new(|| MadeBy {
    program: "friction-stage",
    version: env!("CARGO_PKG_VERSION"),
    date: now(),
    command: command(),
});

/// Date and time of the clock, UTC.
pub fn now() -> String {
    let since = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let seconds = i64::try_from(since.as_secs()).unwrap_or_default();
    let date = chrono::DateTime::from_timestamp(seconds, 0).unwrap_or_default();
    date.format("%Y-%m-%dT%H:%M:%SZ").to_string()
}

/// The command line of this process, as a shell takes it.
fn command() -> String {
    let quoted = |argument: String| {
        let is_plain = |c: char| c.is_alphanumeric() || "_-./:=,+@%".contains(c);
        match !argument.is_empty() && argument.chars().all(is_plain) {
            true => argument,
            false => format!("'{}'", argument.replace('\'', "'\\''")),
        }
    };
    let arguments = std::env::args_os().skip(1).map(|one| quoted(one.to_string_lossy().into()));
    let whole = std::iter::once("friction-stage".to_owned()).chain(arguments);
    let whole = printable(&whole.collect::<Vec<_>>().join(" ")).into_owned();
    match whole.char_indices().nth(LONGEST) {
        Some((cut, _)) => format!("{} ...", &whole[..cut]),
        None => whole,
    }
}

/// A text for a file of the name, with a line on who made it where the kind of file has a place for
/// one: a page at its end, a YAML file as comments at its beginning, a figure as its metadata.
pub fn signed(name: &str, text: &str) -> String {
    let MadeBy { program, version, date, command } = &*THIS_RUN;
    match name.rsplit_once('.').map(|(_, ending)| ending) {
        Some("html") => with_footer(text, &format!("{program} {version} \u{b7} {date}\n{command}")),
        Some("yaml") => {
            let command = command.replace('\n', " ");
            format!("# {program} {version}, {date}\n# {command}\n{text}")
        }
        Some("svg") => with_metadata(text, &format!("{program} {version}, {date}: {command}")),
        _ => text.to_owned(),
    }
}

/// Who makes a result, for files that keep names with values.
pub fn record() -> BTreeMap<String, String> {
    let MadeBy { program, version, date, command } = &*THIS_RUN;
    [("program", *program), ("version", *version), ("date", date), ("command", command)]
        .map(|(name, value)| (name.to_owned(), value.to_owned()))
        .into()
}

/// Writes who makes the results in a directory.
pub fn write(directory: &Path) -> anyhow::Result<()> {
    let path = directory.join(FILE);
    let text = serde_json::to_string_pretty(&*THIS_RUN)? + "\n";
    std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))
}
