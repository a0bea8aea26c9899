//! How far a command is: a bar of at most 60 columns on a terminal, else a line after two seconds,
//! every few seconds from then on, and at the beginning of each step.

use std::collections::BTreeSet;
use std::io::Write as _;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use friction_stage_report::words::{in_line, printable};
use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};

/// Before the first line where stderr is no terminal: a command that is over by then needs none.
const FIRST_LINE: Duration = Duration::from_secs(2);
/// Between two lines.
const BETWEEN_LINES: Duration = Duration::from_secs(5);

/// Shows on stderr how far a command is. Any thread may report.
pub(super) struct Progress {
    bar: ProgressBar,
    reported: Arc<Mutex<Reported>>,
    /// Ends the thread that writes lines through a long step, where there is one.
    _lines: Option<Sender<()>>,
}

/// What was written where there is no terminal.
struct Reported {
    /// When the next line is due, after the start.
    due: Duration,
    /// Steps, which are what stands before a colon.
    steps: BTreeSet<String>,
}

impl Progress {
    /// Of so many steps.
    pub fn of(steps: u64, message: impl Into<String>) -> Progress {
        let template = "{msg:24!} [{bar:10}] {percent:>3} % {elapsed}{left}";
        Progress::new(ProgressBar::new(steps), template, message)
    }

    /// Of an unknown number of steps.
    pub fn endless(message: impl Into<String>) -> Progress {
        Progress::new(ProgressBar::no_length(), "{msg:40!} {elapsed}", message)
    }

    fn new(bar: ProgressBar, template: &str, message: impl Into<String>) -> Progress {
        // A template that cannot be read would be shown as the default one.
        if let Ok(style) = ProgressStyle::with_template(template) {
            // Before the first step nothing says how long it will take.
            let left = |state: &ProgressState, out: &mut dyn std::fmt::Write| {
                if state.pos() > 0 {
                    // A bar takes whatever is written.
                    let _ = write!(out, ", {:#} left", HumanDuration(state.eta()));
                }
            };
            bar.set_style(style.with_key("left", left).progress_chars("=> "));
        }
        bar.set_message(shown(message));
        bar.enable_steady_tick(Duration::from_millis(200));
        let reported = Reported { due: FIRST_LINE, steps: BTreeSet::new() };
        let reported = Arc::new(Mutex::new(reported));
        let lines = bar.is_hidden().then(|| lines(bar.clone(), Arc::clone(&reported)));
        Progress { bar, reported, _lines: lines }
    }

    /// What is done now.
    pub fn say(&self, message: impl Into<String>) {
        self.bar.set_message(shown(message));
        self.tell();
    }

    /// So many steps are done; a report that comes late changes nothing.
    pub fn reach(&self, steps: u64) {
        if steps > self.bar.position() {
            self.bar.set_position(steps);
        }
        self.tell();
    }

    /// One more step is done.
    pub fn step(&self) {
        self.bar.inc(1);
        self.tell();
    }

    /// Writes a line that stays.
    pub fn line(&self, text: &str) {
        self.bar.suspend(|| {
            // The reader may be closed: that is no reason to stop.
            let _ = writeln!(std::io::stderr(), "{}", printable(text));
        });
    }

    /// A handle for a thread that outlives this one's borrow.
    pub fn bar(&self) -> ProgressBar {
        self.bar.clone()
    }

    fn tell(&self) {
        if self.bar.is_hidden() {
            tell(&self.bar, &self.reported);
        }
    }
}

/// Writes a line every few seconds until what it returns is dropped: a step may take long.
fn lines(bar: ProgressBar, reported: Arc<Mutex<Reported>>) -> Sender<()> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        let mut wait = FIRST_LINE;
        while receiver.recv_timeout(wait) == Err(RecvTimeoutError::Timeout) {
            tell(&bar, &reported);
            wait = BETWEEN_LINES;
        }
    });
    sender
}

/// Writes a line where one is due or a step begins.
fn tell(bar: &ProgressBar, reported: &Mutex<Reported>) {
    let elapsed = bar.elapsed();
    let message = bar.message();
    let Ok(mut reported) = reported.lock() else { return };
    let begins = message.split_once(':').is_some_and(|(step, _)| {
        !reported.steps.contains(step) && reported.steps.insert(step.to_owned())
    });
    if elapsed < reported.due && !begins {
        return;
    }
    reported.due = elapsed + BETWEEN_LINES;
    let share = match bar.length() {
        Some(steps) if steps > 0 => format!("{} %, ", 100 * bar.position() / steps),
        _ => String::new(),
    };
    let _ = writeln!(std::io::stderr(), "{message} ({share}{} s)", elapsed.as_secs());
}

/// A message in one line; names from files may be in it.
fn shown(message: impl Into<String>) -> String {
    in_line(&message.into()).into_owned()
}

impl Drop for Progress {
    fn drop(&mut self) {
        self.bar.finish_and_clear();
    }
}
