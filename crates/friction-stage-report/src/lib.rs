//! Figures, pages, and the words for findings.
//!
//! In come columns of numbers and typed findings of the rooms below; out goes SVG, HTML and text.
//! Nothing here reads or writes a file.
//!
//! ```
//! use friction_stage_report::chart::{Chart, Style};
//!
//! let mut chart = Chart::new("Friction over velocity", "velocity, m/s", "friction, N");
//! chart.add("viscous", 0, Style::Line, (0..10).map(|k| (0.1 * f64::from(k), 7.2 * f64::from(k))));
//! assert!(chart.svg()?.starts_with("<svg"));
//! # Ok::<(), friction_stage_report::figure::FigureError>(())
//! ```

#![warn(missing_docs)]

pub mod chart;
pub mod compensation;
mod error;
pub mod experiment;
pub mod figure;
pub mod friction_curve;
pub mod identification;
pub mod interactive;
pub mod live;
pub mod measured_loop;
pub mod model;
pub mod page;
pub mod paper_motion;
pub mod played;
pub mod recording;
mod room;
pub mod selection;
pub mod sweep;
mod text_width;
pub mod tuning;
pub mod view;
pub mod words;

pub use error::ReportError;
