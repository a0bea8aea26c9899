//! Recordings of a stage: bags of rosbag2 (MCAP, sqlite3) with their messages, tables of text and
//! of arrays, the signals in them on one grid, and the quality of these.
//!
//! ```
//! use friction_stage_data::quality::examine;
//! use friction_stage_data::signals::{Mapping, load};
//!
//! // A CSV file of a drive: time in ms, position in mm, current in A.
//! # let home = tempfile::tempdir()?;
//! # let path = home.path().join("drive.csv");
//! let rows = (0..2000).map(|k| f64::from(k) * 0.5e-3);
//! let lines = rows.map(|t| {
//!     format!("{},{},{}\n", 1e3 * t, 20.0 * (6.0 * t).sin(), (6.0 * t).cos())
//! });
//! std::fs::write(&path, "t,x,i\n".to_owned() + &lines.collect::<String>())?;
//!
//! let mapping = Mapping::from_yaml(
//!     "signals:
//!        time: {column: t, unit: ms}
//!        position: {column: x, unit: mm}
//!        force: {column: i, scale: 12.4}",
//!     "drive.yaml",
//! )?;
//! let recording = load(&path, Some(&mapping))?;
//! assert_eq!((recording.rate, recording.trace.len()), (2000.0, 2000));
//! for finding in examine(&recording, None).findings {
//!     println!("{} {:?}", finding.code(), finding.severity());
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![warn(missing_docs)]

pub mod bag;
pub mod message;
pub mod motion_file;
pub mod quality;
pub mod signals;
pub mod wire;
