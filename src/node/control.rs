//! What services, live page and lifecycle ask of the loop of a node.

use std::sync::Arc;
use std::sync::atomic::AtomicU64;

use tokio::sync::oneshot;

/// What the rest of the process asks of a node's loop.
#[derive(Debug)]
pub enum Control {
    Enable(bool),
    Reset(oneshot::Sender<Result<String, String>>),
    /// Time is paused, or continues; in lockstep.
    Pause(bool, oneshot::Sender<()>),
    /// Samples to go on by while time stands still; in lockstep.
    Step(Steps),
    /// Those are not wanted any more.
    StopSteps,
    /// Bandwidth of the stage's own position loop, Hz.
    Bandwidth(f64, oneshot::Sender<Result<String, String>>),
    /// A step of the stage's own setpoint, m.
    Move(f64, oneshot::Sender<Result<String, String>>),
    /// Parameters that can change while running have changed.
    Retune,
    /// The node must end, and why.
    End(String),
    Shutdown,
}

/// Samples to go on by while time is paused.
#[derive(Debug)]
pub struct Steps {
    pub count: u64,
    /// Done so far.
    pub done: Arc<AtomicU64>,
    pub end: oneshot::Sender<StepsEnd>,
}

/// How steps ended.
#[derive(Debug)]
pub enum StepsEnd {
    Done,
    /// By who asked for them, or because time continues by itself.
    Stopped,
    Failed(String),
}
