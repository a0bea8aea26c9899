//! What an experiment has measured so far, one file for each specimen and part, until it is whole.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use serde::Serialize;

use crate::outcome::WrongArguments;
use friction_stage_core::model::StageModel;
use friction_stage_core::text_file;
use friction_stage_lab::{Experiment, ExperimentPlan, ExperimentResults, OwnMove, Specimen};

/// The directory of the parts, in that of the results.
const DIRECTORY: &str = "parts";
/// What the parts follow from.
pub const PLAN: &str = "plan.json";
/// Largest file of a part that is read, bytes: the curves of one guide take less than 10 MB.
const LARGEST: u64 = 256 << 20;

/// The parts of a run.
#[derive(Clone)]
pub struct Parts {
    directory: PathBuf,
}

/// What the parts follow from: another one gives other parts.
#[derive(Serialize)]
struct PlanOfParts<'a> {
    version: &'static str,
    experiment: &'static str,
    seed: u64,
    rest: f64,
    amplitudes: &'a [f64],
    own_move: Option<OwnMove>,
    bandwidths: Vec<f64>,
    specimens: Vec<(&'a str, &'a StageModel, &'a StageModel)>,
}

/// What a run follows from, as text.
pub fn plan_text(plan: &ExperimentPlan) -> anyhow::Result<String> {
    Ok(serde_json::to_string_pretty(&PlanOfParts {
        version: env!("CARGO_PKG_VERSION"),
        experiment: plan.experiment.name(),
        seed: plan.settings.seed,
        rest: plan.rest,
        amplitudes: &plan.amplitudes,
        own_move: plan.own_move,
        bandwidths: plan.specimens.iter().map(|of| of.bandwidth).collect(),
        specimens: plan.specimens.iter().map(|of| (of.name.as_str(), &of.rig, &of.stage)).collect(),
    })?)
}

impl Parts {
    /// The parts of a plan, in the directory of its results; none yet unless it resumes.
    pub fn open(
        results: &Path,
        plan: &ExperimentPlan,
        resume: bool,
        force: bool,
    ) -> anyhow::Result<Parts> {
        let directory = results.join(DIRECTORY);
        let path = directory.join(PLAN);
        let text = plan_text(plan)?;
        if path.exists() && !force {
            let place = results.display();
            if !resume {
                return Err(WrongArguments(format!(
                    "{place} holds a run that was stopped: continue it with --resume, replace it \
                     with --force, or choose another --out"
                ))
                .into());
            }
            let before = text_file::read(&path)
                .with_context(|| format!("cannot read {}", path.display()))?;
            if let Some((was, is)) =
                before.lines().zip(text.lines()).find(|(before, now)| before != now)
            {
                return Err(WrongArguments(format!(
                    "{place} was begun with other arguments, {} where it is now {}: resume with \
                     the same, or choose another --out",
                    was.trim().trim_end_matches(','),
                    is.trim().trim_end_matches(',')
                ))
                .into());
            }
            return Ok(Parts { directory });
        }
        if directory.exists() {
            std::fs::remove_dir_all(&directory)
                .with_context(|| format!("cannot replace {}", directory.display()))?;
        }
        std::fs::create_dir_all(&directory)
            .with_context(|| format!("cannot create {}", directory.display()))?;
        std::fs::write(&path, text).with_context(|| format!("cannot write {}", path.display()))?;
        Ok(Parts { directory })
    }

    fn path(&self, of: &Specimen, part: Experiment) -> PathBuf {
        self.directory.join(format!("{}_{}.json", of.file_name(), part.name()))
    }

    /// A part that was measured.
    pub fn load(
        &self,
        of: &Specimen,
        part: Experiment,
    ) -> anyhow::Result<Option<ExperimentResults>> {
        let path = self.path(of, part);
        let Ok(file) = std::fs::metadata(&path) else { return Ok(None) };
        anyhow::ensure!(
            file.is_file() && file.len() <= LARGEST,
            "{} is no part of an experiment: remove it",
            path.display()
        );
        let text = std::fs::read_to_string(&path)
            .with_context(|| format!("cannot read {}", path.display()))?;
        let found = serde_json::from_str(&text).with_context(|| {
            format!("{} is no part of an experiment: remove it", path.display())
        })?;
        Ok(Some(found))
    }

    /// Keeps a part, whole or not at all.
    pub fn save(
        &self,
        of: &Specimen,
        part: Experiment,
        found: &ExperimentResults,
    ) -> anyhow::Result<()> {
        let path = self.path(of, part);
        let unfinished = path.with_extension("unfinished");
        let cannot = || format!("cannot write {}", path.display());
        std::fs::write(&unfinished, serde_json::to_string(found)?).with_context(cannot)?;
        std::fs::rename(&unfinished, &path).with_context(cannot)
    }

    /// Names of the parts that are measured, in alphabetic order.
    pub fn measured(&self) -> Vec<String> {
        let entries = std::fs::read_dir(&self.directory).into_iter().flatten().flatten();
        let mut names: Vec<String> = entries
            .filter(|entry| entry.file_name() != PLAN)
            .filter_map(|entry| Some(entry.file_name().to_str()?.strip_suffix(".json")?.to_owned()))
            .collect();
        names.sort();
        names
    }

    /// Removes the parts of a run that is whole.
    pub fn remove(&self) -> anyhow::Result<()> {
        std::fs::remove_dir_all(&self.directory)
            .with_context(|| format!("cannot remove {}", self.directory.display()))
    }
}
