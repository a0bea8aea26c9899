//! Signals that end a node, heard from its first moment on.
//!
//! SIGINT and SIGTERM end the node in good order, whatever it is doing. SIGCONT after a real stop
//! ends it too, because a stop interrupts the threads of the DDS library, which then end; a SIGCONT
//! that reached a process that had not been stopped changes nothing.

use std::collections::BTreeSet;
use std::time::Duration;

use anyhow::Context as _;
use tokio::runtime::Runtime;
use tokio::signal::unix::{Signal, SignalKind, signal};

/// What a signal asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asked {
    /// SIGINT or SIGTERM: end.
    End,
    /// SIGCONT: see whether the process was stopped.
    Continued,
}

/// The runtime of everything that waits, and the signals that it hears: made before anything else,
/// so that a signal in the first moments is kept and not the end of the process.
pub struct Signals {
    runtime: Runtime,
    interrupt: Signal,
    terminate: Signal,
    continued: Signal,
}

impl Signals {
    /// Takes over SIGINT, SIGTERM and SIGCONT of this process.
    ///
    /// # Errors
    /// When the system refuses a runtime or a handler.
    pub fn listen() -> anyhow::Result<Signals> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .context("cannot start the runtime of the services")?;
        let entered = runtime.enter();
        let interrupt = signal(SignalKind::interrupt())?;
        let terminate = signal(SignalKind::terminate())?;
        let continued = signal(SignalKind::from_raw(libc::SIGCONT))?;
        drop(entered);
        Ok(Signals { runtime, interrupt, terminate, continued })
    }

    /// The runtime apart from what it waits for.
    pub fn split(self) -> (Runtime, SignalStream) {
        let Signals { runtime, interrupt, terminate, continued } = self;
        (runtime, SignalStream { interrupt, terminate, continued })
    }
}

/// The signals that have come and will come.
pub struct SignalStream {
    interrupt: Signal,
    terminate: Signal,
    continued: Signal,
}

impl SignalStream {
    /// The next signal; one that asks for the end before one that does not, because `timeout` and
    /// service managers send SIGCONT right after SIGTERM.
    pub async fn next(&mut self) -> Asked {
        tokio::select! {
            biased;
            _ = self.interrupt.recv() => Asked::End,
            _ = self.terminate.recv() => Asked::End,
            _ = self.continued.recv() => Asked::Continued,
        }
    }
}

/// The threads that a library started, to see later whether they are still there.
#[derive(Clone, Debug, Default)]
pub struct Threads(BTreeSet<u32>);

/// A thread whose wait was interrupted ends within milliseconds; the rest is for a busy machine.
const ENDS_WITHIN: Duration = Duration::from_millis(300);

impl Threads {
    /// Runs `start`; what it returns, and the threads of this process that are new since.
    pub fn started_by<T>(start: impl FnOnce() -> T) -> (T, Threads) {
        let before = Threads::of_this_process();
        let result = start();
        let after = Threads::of_this_process();
        (result, Threads(after.0.difference(&before.0).copied().collect()))
    }

    fn of_this_process() -> Threads {
        let entries = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
        Threads(entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).collect())
    }

    /// Whether any of them has ended.
    pub async fn have_ended(&self) -> bool {
        tokio::time::sleep(ENDS_WITHIN).await;
        !self.0.is_subset(&Threads::of_this_process().0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc;

    #[test]
    fn a_thread_that_ended_is_missed_and_one_that_runs_is_not() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        let ((end, thread), threads) = Threads::started_by(|| {
            let (end, wait) = mpsc::channel::<()>();
            (end, std::thread::spawn(move || wait.recv()))
        });
        assert!(!runtime.block_on(threads.have_ended()));
        drop(end);
        let _ = thread.join();
        assert!(runtime.block_on(threads.have_ended()));
    }
}
