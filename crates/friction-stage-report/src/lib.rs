//! Figures and pages.
//!
//! In come columns of numbers, out goes SVG text. Nothing here reads a file or knows where its
//! numbers come from.

pub mod chart;
pub mod figure;
pub mod page;
