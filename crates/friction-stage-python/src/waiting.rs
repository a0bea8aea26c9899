//! Long work: it runs on a thread of its own while the caller's thread waits without the
//! interpreter's lock, passes progress on, and answers Ctrl-C.
//!
//! On Ctrl-C, or when the progress callback raises, the work is asked to stop and the exception is
//! raised. The work sees it at its next step and ends there; nothing of it is kept. Where a step
//! takes longer than [`PATIENCE`], the caller does not wait for its end: the thread owns all that
//! it works on, so that it ends by itself.
//!
//! Work spreads over all processors, or over as many threads as the caller says: where many
//! processes share a machine, each takes its own.

use std::any::Any;
use std::num::NonZeroUsize;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use pyo3::prelude::*;
use pyo3::types::PyBool;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::error::raised;

/// Time between two looks for Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);
/// Time that the caller waits for work that was asked to stop.
const PATIENCE: Duration = Duration::from_secs(1);

/// Name of the threads that work, for whoever looks at the process.
const NAME: &str = "friction-stage";

/// Unwinds the work that was asked to stop.
struct Stopped;

enum Message<T> {
    Progress(String, f64),
    Done(Result<T, Box<dyn Any + Send>>),
}

/// Tells the caller a line and a share.
type Tell = Box<dyn Fn(&str, f64) + Send>;

/// What work sees of its caller.
pub(crate) struct Caller {
    /// Stop at once; the result is not wanted.
    abandoned: Arc<AtomicBool>,
    /// Stop early and return what there is.
    enough: Arc<AtomicBool>,
    progress: Mutex<Tell>,
}

impl Caller {
    /// Ends the work here if it was asked to stop. Call it at every step.
    pub(crate) fn check(&self) {
        if self.abandoned.load(Ordering::Relaxed) {
            resume_unwind(Box::new(Stopped));
        }
    }

    /// Whether the caller has enough: what there is will do.
    pub(crate) fn has_enough(&self) -> bool {
        self.check();
        self.enough.load(Ordering::Relaxed)
    }

    /// Tells what is being done and the share that is done.
    pub(crate) fn progress(&self, what: &str, share: f64) {
        self.check();
        if let Ok(tell) = self.progress.lock() {
            tell(what, share);
        }
    }
}

/// Runs `work`. `progress` is called with a line and a share from 0 to 1; where it returns `False`,
/// the work stops early with what there is, if it can.
pub(crate) fn wait_for<T: Send + 'static>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Caller) -> T + Send + 'static,
) -> PyResult<T> {
    wait_for_on(py, None, progress, work)
}

/// As [`wait_for`], on so many threads; without, on all processors.
pub(crate) fn wait_for_on<T: Send + 'static>(
    py: Python<'_>,
    threads: Option<NonZeroUsize>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Caller) -> T + Send + 'static,
) -> PyResult<T> {
    let pool = threads.map(pool_of).transpose()?;
    let (sender, receiver) = channel();
    let (abandoned, enough) = (Arc::new(AtomicBool::new(false)), Arc::new(AtomicBool::new(false)));
    let tell: Tell = match progress {
        Some(_) => {
            let sender = sender.clone();
            Box::new(move |what, share| {
                // The receiver is dropped where the work was abandoned.
                let _ = sender.send(Message::Progress(what.to_owned(), share));
            })
        }
        None => Box::new(|_, _| ()),
    };
    let caller = Caller {
        abandoned: Arc::clone(&abandoned),
        enough: Arc::clone(&enough),
        progress: Mutex::new(tell),
    };
    std::thread::Builder::new().name(NAME.to_owned()).spawn(move || {
        let work = || match &pool {
            Some(pool) => pool.install(|| work(&caller)),
            None => work(&caller),
        };
        let done = catch_unwind(AssertUnwindSafe(work));
        let _ = sender.send(Message::Done(done));
    })?;
    let mut receiver = Some(receiver);
    let interrupted = loop {
        match next(py, &mut receiver, LOOK) {
            Some(Message::Done(Ok(found))) => return Ok(found),
            Some(Message::Done(Err(panic))) => resume_unwind(panic),
            Some(Message::Progress(what, share)) => {
                let answer = progress.map(|callback| callback.call1((what, share))).transpose();
                match answer {
                    Ok(answer) => {
                        let stop = answer.is_some_and(|answer| answer.is(PyBool::new(py, false)));
                        enough.fetch_or(stop, Ordering::Relaxed);
                    }
                    Err(error) => break error,
                }
            }
            None => {}
        }
        if let Err(error) = py.check_signals() {
            break error;
        }
    };
    abandoned.store(true, Ordering::Relaxed);
    let until = Instant::now() + PATIENCE;
    while let Some(left) = until.checked_duration_since(Instant::now()) {
        if let Some(Message::Done(_)) = next(py, &mut receiver, left) {
            break;
        }
    }
    Err(interrupted)
}

/// Threads for one piece of work.
fn pool_of(threads: NonZeroUsize) -> PyResult<ThreadPool> {
    ThreadPoolBuilder::new()
        .num_threads(threads.get())
        .thread_name(|_| NAME.to_owned())
        .build()
        .map_err(|error| {
            raised::FrictionStageError::new_err(format!("no {threads} threads: {error}"))
        })
}

/// The next message, waited for without the interpreter's lock; `None` where there is none in time.
fn next<T: Send>(
    py: Python<'_>,
    receiver: &mut Option<Receiver<Message<T>>>,
    patience: Duration,
) -> Option<Message<T>> {
    let own = receiver.take()?;
    let (own, message) = py.detach(move || {
        let message = own.recv_timeout(patience);
        (own, message)
    });
    *receiver = Some(own);
    message.ok()
}
