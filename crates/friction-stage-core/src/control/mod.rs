//! How a stage is driven: PID with lowpass, feedforward, and the motion that it follows.
//!
//! In come references and measured positions at a fixed rate, out goes a force with every term that
//! it is made of. Time is an argument in nanoseconds; nothing here allocates while controlling.

mod compensation;
mod controller;
mod disturbance_observer;
mod lowpass;
mod pid;
mod supervisor;
mod trajectory;

pub use compensation::{
    Compensated, Compensation, CompensationError, CompensationTerms, CompensationTermsOn,
};
pub use controller::{Controller, ControllerError, ControllerSettings, Terms};
pub use disturbance_observer::{DisturbanceObserver, ObserverSettings};
pub use lowpass::Lowpass;
pub use pid::{AntiWindup, Gains, Pid};
pub use supervisor::{Cause, DampedStop, Health, MOVING, Supervisor, SupervisorSettings};
pub use trajectory::{Follower, Point, Reference, Trajectory, TrajectoryError};
