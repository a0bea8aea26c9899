//! Signals that end a node in good order, whatever it is doing: SIGINT and SIGTERM, handled from
//! its first moment on.

use anyhow::Context as _;
use tokio::runtime::Runtime;
use tokio::signal::unix::{Signal, SignalKind, signal};

/// The runtime of everything that waits, and the signals that it hears: made before anything else,
/// so that a signal in the first moments is kept and not the end of the process.
pub struct Signals {
    runtime: Runtime,
    stream: SignalStream,
}

impl Signals {
    /// Takes over SIGINT and SIGTERM of this process.
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
        drop(entered);
        Ok(Signals { runtime, stream: SignalStream { interrupt, terminate } })
    }

    /// The runtime apart from what it waits for.
    pub fn split(self) -> (Runtime, SignalStream) {
        (self.runtime, self.stream)
    }
}

/// The signals that have come and will come.
pub struct SignalStream {
    interrupt: Signal,
    terminate: Signal,
}

impl SignalStream {
    /// Waits for the next signal.
    pub async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupt.recv() => {}
            _ = self.terminate.recv() => {}
        }
    }
}
