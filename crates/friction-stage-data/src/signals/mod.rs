//! The signals of a stage in a recording: which topic or column is which signal, in which unit, and
//! all of them on one uniform grid.
//!
//! What comes in is a bag of our own, a foreign bag, or a table (CSV or a file of arrays) with a
//! [`Mapping`]; what goes out is a [`Recording`] with the account of its samples ([`DataQuality`]).

mod array_table;
mod arrays;
mod by_stamp;
mod column_name;
mod columns;
mod csv_table;
mod data_quality;
mod error;
mod grid;
mod import;
mod load;
pub mod mapping;
mod mapping_file;
mod order;
mod proposal;
mod recording;
mod resample;
mod source;
mod text_headings;
mod text_layout;
mod text_lines;
mod text_value;
mod topic_source;
mod trace;
mod unit;
mod window;

pub(crate) use csv_table::visit_rows;
pub use data_quality::{DataQuality, JointDoubt, SignalNote, SignalQuality};
pub use error::SignalError;
pub use grid::ClockKind;
pub use import::{ImportReport, import, import_captures};
pub use load::{from_columns, load, load_part};
pub use mapping::{Mapping, Signal};
pub use proposal::{Proposal, ProposedSignal, TableColumn};
pub use recording::Recording;
pub use source::is_table;
pub use trace::{COLUMNS, Trace};
pub use unit::{Dimension, Unit};
pub use window::{MOST_SAMPLES, Window};
