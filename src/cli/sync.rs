//! `--sync` of the commands that start a stage with a recording.

use clap::Args;
use friction_stage_data::bag::Sync;

/// When the recording is brought to the disk.
#[derive(Debug, Clone, Args)]
pub struct SyncArgs {
    /// When the recording is brought to the disk: left to the system, when a file is closed, or
    /// every half second as well
    #[arg(long, value_name = "WHEN", value_parser = Sync::NAMES, default_value = Sync::NAMES[1])]
    pub sync: String,
}

impl Default for SyncArgs {
    fn default() -> Self {
        SyncArgs { sync: Sync::NAMES[1].to_owned() }
    }
}

impl SyncArgs {
    /// The parameter of the stage node.
    pub fn parameter(&self) -> String {
        format!("record_sync:={}", self.sync)
    }
}
