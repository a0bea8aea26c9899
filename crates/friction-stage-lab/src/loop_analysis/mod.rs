//! The loop of stage and controller as an engineer looks at it: open loop, sensitivities, margins.
//!
//! In come a model, a controller and an amplitude of the carriage, out come responses over the
//! frequency. The guides are not linear: they enter by their describing function (Gelb, Vander
//! Velde, Multiple-Input Describing Functions, 1968, ch. 2), the first harmonic of their force over
//! a sinusoidal motion, which depends on the amplitude. Everything else is exact: the hold of the
//! force, the samples of the encoder, the controller as it is sampled.

mod margins;
mod measured_loop;
mod measurement;
mod stage;

pub use margins::{LoopPoint, LoopResponse, Margins};
pub use measured_loop::{
    COHERENT, ComparedPoint, LoopComparison, MeasuredLoop, MeasuredLoopError, UNDISTORTED,
};
pub use measurement::{LoopProbe, LoopSine, MeasuredLoopPoint, measure_loop};
pub use stage::{SampledStage, StageMotion, loop_frequencies};
