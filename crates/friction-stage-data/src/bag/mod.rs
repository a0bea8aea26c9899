//! Storage: rosbag2 directories, written and repaired as MCAP, read as MCAP or sqlite3, compressed
//! or not.
//!
//! What comes in are messages as CDR bytes with a time; what goes out is a directory that
//! `ros2 bag play` takes from Humble on, or the messages of one in the order of time. What the
//! messages mean is not looked at here: see [`signals`](crate::signals).

mod error;
mod file;
mod limits;
mod metadata;
mod provenance;
mod qos;
mod reader;
mod records;
mod recover;
mod sqlite;
mod storage;
pub mod topics;
mod writer;

pub use error::BagError;
pub use file::Damage;
pub(crate) use file::Places;
pub use provenance::{LOCKSTEP_EPOCH, Provenance};
pub use qos::{Durability, History, OfferedQos, Reliability};
pub use reader::{BagMessage, BagReader, Messages, Topic};
pub use recover::{KeptTopic, RecoverReport, recover, recovered};
pub(crate) use storage::is_recording;
pub use writer::{BagOptions, BagWriter, Compression, Sync, TopicId};
