//! The report of an experiment of the laboratory: its summary, its page and its figures.

mod page;
mod summary;

pub use page::{ExperimentFigure, experiment_page};
pub use summary::ExperimentSummary;
