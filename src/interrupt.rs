//! Ctrl-C and SIGTERM in a command: exit 130, no empty directory, and a word on what is kept.
//!
//! A command that can end in good order holds a [`Patience`] and looks at [`seen`]; any other ends
//! at once. A second signal ends every command at once.

use std::path::{Path, PathBuf};
use std::process::exit;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use anyhow::Context as _;
use friction_stage_report::words::printable;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;

use crate::outcome::{INTERRUPTED, Interrupted};

/// A signal has come.
static SEEN: AtomicBool = AtomicBool::new(false);
/// Whether a signal waits for the command.
static STATE: Mutex<State> = Mutex::new(State { patient: 0, ends: false });
/// What the command writes into.
static OUTPUTS: Mutex<Vec<Output>> = Mutex::new(Vec::new());

/// What a user can do with what is kept, said when it is asked for.
type Reminder = Box<dyn Fn() -> String + Send>;
static REMINDER: Mutex<Option<Reminder>> = Mutex::new(None);

/// A file or directory that a command writes.
struct Output {
    path: PathBuf,
    /// It was there before.
    existed: bool,
}

struct State {
    /// How many parts of the command end in good order.
    patient: usize,
    /// The command ends now, whatever it is about to do.
    ends: bool,
}

fn state() -> MutexGuard<'static, State> {
    STATE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Takes over SIGINT and SIGTERM of this process.
pub fn listen() -> anyhow::Result<()> {
    let mut signals = Signals::new([SIGINT, SIGTERM]).context("cannot take over signals")?;
    let waits = move || {
        for _ in signals.forever() {
            let again = SEEN.swap(true, Ordering::SeqCst);
            let mut state = state();
            state.ends |= again || state.patient == 0;
            let ends = state.ends;
            drop(state);
            if ends {
                // The line may hold a bar.
                eprintln!("\nerror: interrupted; {}", printable(&tidy()));
                exit(INTERRUPTED.into());
            }
        }
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(waits)?;
    Ok(())
}

/// Whether a signal has come.
pub fn seen() -> bool {
    SEEN.load(Ordering::Relaxed)
}

/// The first signal waits for the command while this is held.
#[derive(Debug)]
pub struct Patience(());

impl Patience {
    /// The command looks at [`seen`] from now on. A command that ends meanwhile comes no further:
    /// what it would make now would be left.
    pub fn begin() -> Patience {
        let mut state = state();
        while state.ends {
            drop(state);
            std::thread::park();
            state = self::state();
        }
        state.patient += 1;
        Patience(())
    }
}

impl Drop for Patience {
    fn drop(&mut self) {
        state().patient -= 1;
    }
}

/// An error if a signal has come; what is kept is added when the command has ended.
pub fn check() -> Result<(), Interrupted> {
    if seen() { Err(Interrupted(String::new())) } else { Ok(()) }
}

/// The end of a command that was interrupted: what is empty is removed, and the error says what is
/// kept.
pub fn ended(error: anyhow::Error) -> anyhow::Error {
    let Some(Interrupted(text)) = error.downcast_ref() else { return error };
    let kept = tidy();
    if text.is_empty() { Interrupted(format!("interrupted; {kept}")).into() } else { error }
}

/// Announces a file or directory before it is made.
pub fn writes(path: &Path) {
    if let Ok(mut outputs) = OUTPUTS.lock()
        && !outputs.iter().any(|output| output.path == path)
    {
        outputs.push(Output { path: path.to_owned(), existed: path.exists() });
    }
}

/// What a user can do with what is kept.
pub fn remind(words: impl Fn() -> String + Send + 'static) {
    if let Ok(mut reminder) = REMINDER.lock() {
        *reminder = Some(Box::new(words));
    }
}

/// Removes the empty ones of the directories that the command made; says what is kept.
pub fn tidy() -> String {
    let Ok(outputs) = OUTPUTS.lock() else { return "nothing is kept".to_owned() };
    let mut kept = Vec::new();
    for Output { path, existed } in outputs.iter().rev() {
        if path.is_dir() {
            remove_empty(path, *existed);
        }
        if path.is_dir() {
            let names = names_in(path);
            if !names.is_empty() {
                kept.push(format!("{} holds {}", path.display(), names.join(", ")));
            }
        } else if path.exists() && !existed {
            kept.push(format!("{} is kept", path.display()));
        }
    }
    kept.reverse();
    if kept.is_empty() {
        return "nothing was written".to_owned();
    }
    let reminder = REMINDER.lock().ok().and_then(|reminder| Some(reminder.as_ref()?()));
    kept.into_iter().chain(reminder).collect::<Vec<_>>().join("; ")
}

/// Removes empty directories in a directory, and it itself unless it is to be kept.
fn remove_empty(directory: &Path, keep: bool) {
    for entry in std::fs::read_dir(directory).into_iter().flatten().flatten() {
        if !keep && entry.file_type().is_ok_and(|kind| kind.is_dir()) {
            remove_empty(&entry.path(), false);
        }
    }
    if !keep {
        // One that is not empty is kept by the system.
        let _ = std::fs::remove_dir(directory);
    }
}

/// Names in a directory that are said at most.
const MOST_NAMED: usize = 6;

fn names_in(directory: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(directory).into_iter().flatten().flatten();
    let mut names: Vec<String> =
        entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    let more = names.len().saturating_sub(MOST_NAMED);
    names.truncate(MOST_NAMED);
    names.extend((more > 0).then(|| format!("{more} more")));
    names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn empty_directories_that_the_command_made_are_removed_and_others_are_kept() {
        let home = tempfile::tempdir().unwrap();
        let at = |name: &str| home.path().join(name);
        std::fs::create_dir(at("before")).unwrap();
        for path in ["before", "empty", "full", "file.yaml"] {
            writes(&at(path));
        }
        std::fs::create_dir_all(at("empty/figures")).unwrap();
        std::fs::create_dir_all(at("full/bags")).unwrap();
        std::fs::write(at("full/rows.csv"), "x").unwrap();
        let reported = tidy();
        assert!(at("before").is_dir() && !at("empty").exists(), "{reported}");
        assert!(at("full/rows.csv").exists() && !at("full/bags").exists());
        assert!(reported.contains("full holds rows.csv"), "{reported}");
    }
}
