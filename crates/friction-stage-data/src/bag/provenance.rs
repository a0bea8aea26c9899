//! Where a recording comes from: enough to repeat the run from its bag alone.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Stamp of the first sample, ns. ROS takes a clock at 0 for one that has not started.
pub const LOCKSTEP_EPOCH: i64 = 1_000_000_000;
/// Name of the MCAP metadata record that holds everything but the model.
pub(crate) const METADATA_NAME: &str = "friction_stage";
/// Name of the MCAP attachment that holds the model.
pub(crate) const MODEL_NAME: &str = "model.yaml";
/// Key of the interval, s, within which the writer brings everything to the file.
pub(crate) const FLUSH_INTERVAL_KEY: &str = "flush_interval_s";

/// What made a recording; stored at the start of the file, so that a cut-off recording has it too.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Provenance {
    /// The stage model, as a model file that the nodes load.
    pub model_yaml: String,
    /// Seed of the noise.
    pub seed: String,
    /// Version of this program.
    pub version: String,
    /// Arguments that the run was started with.
    pub arguments: String,
    /// Anything else.
    pub extra: BTreeMap<String, String>,
}

impl Provenance {
    /// Whether it is a run in lockstep of a stage that forces drive: they lead to the same samples
    /// again.
    pub fn is_of_lockstep(&self) -> bool {
        self.is_of("lockstep")
    }

    /// Whether it is a run in real time of a stage that forces drive: a force that comes late acts
    /// later than its stamp says.
    pub fn is_of_forces_in_real_time(&self) -> bool {
        self.is_of("realtime")
    }

    /// Whether it is a run in this mode of a stage that forces drive.
    fn is_of(&self, mode: &str) -> bool {
        let is = |key: &str, value: &str| self.extra.get(key).is_some_and(|found| found == value);
        is("mode", mode) && is("drive", "force")
    }

    pub(crate) fn to_map(&self) -> BTreeMap<String, String> {
        let mut map = self.extra.clone();
        map.insert("seed".into(), self.seed.clone());
        map.insert("version".into(), self.version.clone());
        map.insert("arguments".into(), self.arguments.clone());
        map
    }

    pub(crate) fn from_map(mut map: BTreeMap<String, String>, model_yaml: String) -> Self {
        let mut take = |key: &str| map.remove(key).unwrap_or_default();
        Self {
            model_yaml,
            seed: take("seed"),
            version: take("version"),
            arguments: take("arguments"),
            extra: map,
        }
    }
}
