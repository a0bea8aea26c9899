//! Where a command leaves its results.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::Context as _;
use clap::Args;

use crate::interrupt;
use crate::made_by;
use crate::outcome::WrongArguments;

/// A directory that is named after what it holds and when: `<name>_<date>` in `parent`, UTC, and a
/// number where that is taken.
pub fn dated(parent: &Path, name: &str) -> PathBuf {
    dated_file(parent, name, "")
}

/// The same for a file with such an ending.
pub fn dated_file(parent: &Path, name: &str, ending: &str) -> PathBuf {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    let seconds = i64::try_from(now.as_secs()).unwrap_or_default();
    let date = chrono::DateTime::from_timestamp(seconds, 0).unwrap_or_default();
    let name = format!("{name}_{}", date.format("%Y_%m_%d-%H_%M_%S"));
    let mut place = parent.join(format!("{name}{ending}"));
    let mut number = 2;
    while place.symlink_metadata().is_ok() {
        place = parent.join(format!("{name}_{number}{ending}"));
        number += 1;
    }
    place
}

/// Refuses a file that exists already, unless it is to be replaced; `option` names it. It is
/// announced, so that an interrupted command can say what is kept. A device or a pipe holds nothing
/// that could be lost. A file whose directory is not there is refused before anything is computed.
pub fn may_replace(path: Option<&Path>, force: bool, option: &str) -> Result<(), WrongArguments> {
    let Some(path) = path else { return Ok(()) };
    let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
    if let Some(parent) = parent.filter(|parent| !parent.is_dir()) {
        return Err(WrongArguments(format!(
            "there is no directory {} for {option}: make it first",
            parent.display()
        )));
    }
    let holds = path.metadata().is_ok_and(|found| found.is_file() || found.is_dir());
    if holds && !force {
        return Err(WrongArguments(format!(
            "{} exists already: choose another {option}, or replace it with --force",
            path.display()
        )));
    }
    interrupt::writes(path);
    Ok(())
}

/// Refuses a place that holds something already; `option` names it. With `force` a recording or a
/// file is set aside, as `NAME.before`, until what replaces it is whole ([`SetAside::discard`]).
pub fn set_aside(path: &Path, force: bool, option: &str) -> anyhow::Result<SetAside> {
    let Ok(found) = path.symlink_metadata() else { return Ok(SetAside(None)) };
    let refused = |why: &str| {
        let place = path.display();
        anyhow::Error::from(WrongArguments(format!("{place} {why}: choose another {option}")))
    };
    if !force {
        return Err(WrongArguments(format!(
            "{} exists already: choose another {option}, or replace it with --force",
            path.display()
        ))
        .into());
    }
    if found.is_dir() && !holds_recordings_only(path) {
        return Err(refused("is a directory with other things than a recording"));
    }
    let Some(name) = path.file_name() else { return Err(refused("has no name of its own")) };
    let mut aside = name.to_owned();
    aside.push(".before");
    let aside = path.with_file_name(aside);
    if aside.symlink_metadata().is_ok() {
        let why = format!("cannot be set aside, since {} is there already", aside.display());
        return Err(refused(&why));
    }
    std::fs::rename(path, &aside)
        .with_context(|| format!("cannot set {} aside", path.display()))?;
    Ok(SetAside(Some((path.to_owned(), aside))))
}

/// Whether a directory has the files of a recording and no others, or such directories.
fn holds_recordings_only(path: &Path) -> bool {
    const ENDINGS: [&str; 4] = ["mcap", "db3", "zstd", "zst"];
    let Ok(mut entries) = std::fs::read_dir(path) else { return false };
    let is_part = |entry: std::io::Result<std::fs::DirEntry>| {
        entry.is_ok_and(|entry| match entry.file_type() {
            Ok(kind) if kind.is_dir() => holds_recordings_only(&entry.path()),
            Ok(kind) if kind.is_file() => {
                let ending = entry.path().extension().and_then(|e| e.to_str()).map(str::to_owned);
                entry.file_name() == "metadata.yaml"
                    || ending.is_some_and(|ending| ENDINGS.contains(&ending.as_str()))
            }
            _ => false,
        })
    };
    entries.all(is_part)
}

/// What stood at a place and is set aside. Where it is not discarded it goes back.
#[derive(Debug)]
pub struct SetAside(Option<(PathBuf, PathBuf)>);

impl SetAside {
    /// Removes it: what replaces it is whole.
    pub fn discard(mut self) -> anyhow::Result<()> {
        let Some((_, aside)) = self.0.take() else { return Ok(()) };
        let is_directory = aside.symlink_metadata().is_ok_and(|found| found.is_dir());
        let removed = match is_directory {
            true => std::fs::remove_dir_all(&aside),
            false => std::fs::remove_file(&aside),
        };
        removed.with_context(|| format!("cannot remove {}", aside.display()))
    }
}

impl Drop for SetAside {
    fn drop(&mut self) {
        // What was begun in its place and is there stays; then both are.
        if let Some((path, aside)) = self.0.take()
            && path.symlink_metadata().is_err()
        {
            let _ = std::fs::rename(aside, path);
        }
    }
}

/// The arguments that name the directory.
#[derive(Debug, Clone, Args)]
pub struct ResultsArgs {
    /// Directory for the results [default: named after the command and the date]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Replace the results that the directory holds
    #[arg(long)]
    pub force: bool,
}

/// A directory for the results of a command, of which summary.json is the last.
#[derive(Debug)]
pub struct Results {
    directory: PathBuf,
}

/// What marks a directory with results.
const SUMMARY: &str = "summary.json";

impl ResultsArgs {
    /// The directory, where it holds the results of a run that came to its end.
    pub fn complete(&self) -> Option<PathBuf> {
        self.out.clone().filter(|place| !self.force && place.join(SUMMARY).is_file())
    }

    /// The directory, which is not made yet. One that holds results is refused without `--force`.
    pub fn directory(&self, command: &str) -> Result<Results, WrongArguments> {
        let directory = self.out.clone().unwrap_or_else(|| dated(Path::new(""), command));
        if directory.is_file() {
            return Err(WrongArguments(format!(
                "{} is a file, the results are a directory: choose another --out",
                directory.display()
            )));
        }
        if !self.force && directory.join(SUMMARY).exists() {
            return Err(WrongArguments(format!(
                "{} holds results already: choose another --out, or replace them with --force",
                directory.display()
            )));
        }
        interrupt::writes(&directory);
        Ok(Results { directory })
    }
}

impl Results {
    /// Its path.
    pub fn path(&self) -> &Path {
        &self.directory
    }

    /// Makes it, without the summary of an earlier run.
    pub fn create(&self) -> anyhow::Result<()> {
        std::fs::create_dir_all(&self.directory)
            .with_context(|| format!("cannot create {}", self.directory.display()))?;
        let summary = self.directory.join(SUMMARY);
        if summary.exists() {
            std::fs::remove_file(&summary)
                .with_context(|| format!("cannot replace {}", summary.display()))?;
        }
        Ok(())
    }

    /// Writes a file of it, with who made it where it has a place for that.
    pub fn write(&self, name: &str, text: &str) -> anyhow::Result<()> {
        let path = self.directory.join(name);
        std::fs::write(&path, made_by::signed(name, text))
            .with_context(|| format!("cannot write {}", path.display()))?;
        if name == SUMMARY { made_by::write(&self.directory) } else { Ok(()) }
    }
}
