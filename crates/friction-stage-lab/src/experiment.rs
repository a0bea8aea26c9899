//! One experiment of the paper, or all of them, on several specimens.
//!
//! In comes which experiment on what; out come its results, the statements of the paper where they
//! were asked for, and what a user should know.

use std::ops::RangeInclusive;

use rayon::prelude::*;
use serde::Serialize;

use super::dahl::{AMPLITUDES, DahlCurves, dahl};
use super::distributed_fit::{DistributedFit, best_single};
use super::fast_move::{FastMove, fast_move};
use super::fine_step::{FineStep, fine_step};
use super::frequency_response::{FrequencyResponse, frequency_response};
use super::hunting::{BANDWIDTHS, HuntingResult, INTEGRALS, hunting};
use super::paper::Conditioning;
use super::quick_loops::{QUICK_LOOPS, quick_loops};
use super::rig::{RIG_TICKS, RigBias, rig};
use super::specimen::{LabError, LabRecording, Settings, Specimen};
use super::statements::{
    PaperResults, STATED_STIFFNESS, Statement, StiffnessError, fit_stated, statements,
    stiffness_errors,
};
use super::stribeck::{SPEEDS, StribeckCurve, stribeck};
use friction_stage_core::model::{Catalogue, StageModel};

/// The experiments.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Experiment {
    Stribeck,
    Dahl,
    FrequencyResponse,
    FastMove,
    FineStep,
    Hunting,
    Rig,
    Paper,
}

impl Experiment {
    /// All of them.
    pub const ALL: [Experiment; 8] = [
        Experiment::Stribeck,
        Experiment::Dahl,
        Experiment::FrequencyResponse,
        Experiment::FastMove,
        Experiment::FineStep,
        Experiment::Hunting,
        Experiment::Rig,
        Experiment::Paper,
    ];

    /// Name, as in `summary.json`.
    pub fn name(self) -> &'static str {
        match self {
            Experiment::Stribeck => "stribeck",
            Experiment::Dahl => "dahl",
            Experiment::FrequencyResponse => "frequency-response",
            Experiment::FastMove => "fast-move",
            Experiment::FineStep => "fine-step",
            Experiment::Hunting => "hunting",
            Experiment::Rig => "rig",
            Experiment::Paper => "paper",
        }
    }

    /// What it does.
    pub fn description(self) -> &'static str {
        match self {
            Experiment::Stribeck => {
                "Force over constant velocity, 0.1 mm/s to 1 m/s, both directions"
            }
            Experiment::Dahl => {
                "Hysteresis loops from 10 nm to 1 mm: stiffness, area, Dahl resonance"
            }
            Experiment::FrequencyResponse => "Stage under a sinusoidal force at several amplitudes",
            Experiment::FastMove => {
                "50 mm in 100 ms, forward and return, with and without viscous feedforward"
            }
            Experiment::FineStep => "10 µm in 3 ms, with and without viscous feedforward",
            Experiment::Hunting => "Integral action at rest near the target: limit cycles",
            Experiment::Rig => {
                "How far coupling, force cell, speed and servo of the rig bias the curves"
            }
            Experiment::Paper => "All of them, and every statement of the paper",
        }
    }

    /// The experiment of this name.
    pub fn from_name(name: &str) -> Option<Experiment> {
        Experiment::ALL.into_iter().find(|experiment| experiment.name() == name)
    }

    /// Whether `paper` or the experiment itself asks for a part.
    fn includes(self, part: Experiment) -> bool {
        self == part || self == Experiment::Paper
    }
}

/// What to measure, on what.
#[derive(Clone, Debug)]
pub struct ExperimentPlan {
    pub experiment: Experiment,
    pub specimens: Vec<Specimen>,
    pub settings: Settings,
    /// Rest before the fast move and the fine step, s.
    pub rest: f64,
    /// Amplitudes of the loops of `dahl`, m, ascending.
    pub amplitudes: Vec<f64>,
}

/// Refuses an amplitude, m, that no loop has.
pub fn check_amplitude(value: f64) -> Result<(), LabError> {
    within(value, 1e-9..=0.05, "between 1e-9 and 0.05 m")
}

/// Refuses a rest before the fast move and the fine step, s, that nobody waits for.
pub fn check_rest(value: f64) -> Result<(), LabError> {
    within(value, 0.01..=3600.0, "between 0.01 and 3600 s")
}

fn within(value: f64, limits: RangeInclusive<f64>, words: &'static str) -> Result<(), LabError> {
    if limits.contains(&value) { Ok(()) } else { Err(LabError::Limit { value, limit: words }) }
}

/// Takes the recordings of a specimen, to be kept.
pub type Keep<'a, E> = dyn Fn(&Specimen, &[LabRecording]) -> Result<(), E> + Sync + 'a;

/// What an experiment found.
#[derive(Debug)]
pub struct ExperimentFindings {
    pub results: ExperimentResults,
    /// Of `paper`, where its specimens are there.
    pub statements: Vec<Statement>,
    /// Where guide 1 was measured with one bristle and with three.
    pub stiffness_of_guide_1: Option<StiffnessFit>,
    pub warnings: Vec<String>,
}

/// Everything measured, by experiment; SI units.
#[derive(Debug, Default, Serialize)]
pub struct ExperimentResults {
    /// Force over constant velocity.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub stribeck: Vec<StribeckCurve>,
    /// Hysteresis loops.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub dahl: Vec<DahlCurves>,
    /// The stage under a sinusoidal force.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub frequency_response: Vec<FrequencyResponse>,
    /// 50 mm in 100 ms.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub fast_move: Vec<FastMove>,
    /// 10 µm in 3 ms.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub fine_step: Vec<FineStep>,
    /// Integral action at rest.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub hunting: Vec<SpecimenHunting>,
    /// Biases of the rig.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub rig: Vec<SpecimenRig>,
}

/// How a specimen behaves under integral action.
#[derive(Debug, Serialize)]
pub struct SpecimenHunting {
    /// Name of the specimen.
    pub name: String,
    /// Per bandwidth and integral gain.
    pub results: Vec<HuntingResult>,
}

/// How the rig biases the curves of a specimen.
#[derive(Debug, Serialize)]
pub struct SpecimenRig {
    /// Name of the specimen.
    pub name: String,
    /// Per property of the rig.
    pub biases: Vec<RigBias>,
}

/// The stiffnesses of guide 1 that the paper states, with one bristle and with three.
#[derive(Debug, Serialize)]
pub struct StiffnessFit {
    /// sigma0 of the single bristle that comes nearest, N/m.
    pub best_single_stiffness: f64,
    /// The bristles in parallel.
    pub distributed: DistributedFit,
    /// Per stated stiffness.
    pub errors: Vec<StiffnessError>,
}

impl ExperimentResults {
    /// The results of several specimens together.
    pub fn merged(all: Vec<ExperimentResults>) -> ExperimentResults {
        let mut merged = ExperimentResults::default();
        for one in all {
            merged.stribeck.extend(one.stribeck);
            merged.dahl.extend(one.dahl);
            merged.frequency_response.extend(one.frequency_response);
            merged.fast_move.extend(one.fast_move);
            merged.fine_step.extend(one.fine_step);
            merged.hunting.extend(one.hunting);
            merged.rig.extend(one.rig);
        }
        merged
    }
}

impl Specimen {
    /// The paper's three guides.
    pub const PAPER_GUIDES: [&'static str; 3] = ["guide_1", "guide_2", "guide_3"];
    /// What after a guide's name asks for its parallel bristles.
    pub const BRISTLES: &'static str = "+distributed_bristles";

    /// A guide of the catalogue by name; with [`Specimen::BRISTLES`] after it, on several bristles
    /// in parallel.
    pub fn named(name: &str) -> Result<Specimen, LabError> {
        let Some(guide) = name.strip_suffix(Specimen::BRISTLES) else {
            return Ok(Specimen::of_guide(name)?);
        };
        Specimen::of_guide(guide)?;
        let (inline, effect) = Catalogue::builtin()
            .distributed_bristles(guide)
            .ok_or_else(|| LabError::NoDistributedBristles { guide: guide.to_owned() })?;
        let stage = StageModel { effects: vec![effect], ..StageModel::on_guides(guide) };
        let mut found = Specimen::of_model(&stage)?.with_guide(inline);
        found.name = format!("{} distributed", guide.replace('_', " "));
        Ok(found)
    }

    /// Its name as part of a path.
    pub fn file_name(&self) -> String {
        let allowed = |c: char| c.is_ascii_alphanumeric() || "-.".contains(c);
        self.name.chars().map(|c| if allowed(c) { c } else { '_' }).collect()
    }
}

impl ExperimentPlan {
    /// An experiment with the paper's settings; without specimens on the paper's guides. Two
    /// specimens of one name are refused.
    pub fn new(
        experiment: Experiment,
        mut specimens: Vec<Specimen>,
    ) -> Result<ExperimentPlan, LabError> {
        if specimens.is_empty() {
            let names = Specimen::PAPER_GUIDES.into_iter().map(str::to_owned);
            let distributed =
                (experiment == Experiment::Paper).then(|| format!("guide_1{}", Specimen::BRISTLES));
            specimens = names
                .chain(distributed)
                .map(|name| Specimen::named(&name))
                .collect::<Result<_, _>>()?;
        }
        for (index, of) in specimens.iter().enumerate() {
            if specimens[..index].iter().any(|other| other.file_name() == of.file_name()) {
                return Err(LabError::SameName { name: of.name.clone() });
            }
        }
        Ok(ExperimentPlan {
            experiment,
            specimens,
            settings: Settings::default(),
            rest: Conditioning::PAPER_REST,
            amplitudes: AMPLITUDES.into(),
        })
    }

    /// With these amplitudes of the loops of `dahl`, m, in any order; with none of them, as it is.
    pub fn with_amplitudes(mut self, amplitudes: &[f64]) -> Result<ExperimentPlan, LabError> {
        if amplitudes.is_empty() {
            return Ok(self);
        }
        if self.experiment != Experiment::Dahl {
            return Err(LabError::NoLoops { experiment: self.experiment.name() });
        }
        amplitudes.iter().try_for_each(|amplitude| check_amplitude(*amplitude))?;
        self.amplitudes = amplitudes.to_vec();
        self.amplitudes.sort_by(f64::total_cmp);
        self.amplitudes.dedup();
        Ok(self)
    }

    /// With this rest before the fast move and the fine step, s.
    pub fn with_rest(self, rest: f64) -> Result<ExperimentPlan, LabError> {
        check_rest(rest)?;
        Ok(ExperimentPlan { rest, ..self })
    }

    /// Steps of progress.
    pub fn ticks(&self) -> usize {
        let parts = [
            (Experiment::Stribeck, SPEEDS.len()),
            (Experiment::Dahl, self.amplitudes.len()),
            (Experiment::FrequencyResponse, FrequencyResponse::TICKS),
            (Experiment::FastMove, 2),
            (Experiment::FineStep, 2),
            (Experiment::Hunting, BANDWIDTHS.len() * INTEGRALS.len()),
            (Experiment::Rig, RIG_TICKS),
        ];
        let asked = parts.iter().filter(|(part, _)| self.experiment.includes(*part));
        self.specimens.len() * asked.map(|(_, ticks)| ticks).sum::<usize>()
    }

    /// Measures all specimens, several at once; `tick` is called [`ExperimentPlan::ticks`] times.
    pub fn run<E: From<LabError> + Send>(
        &self,
        keep: Option<&Keep<'_, E>>,
        tick: &(dyn Fn() + Sync),
    ) -> Result<ExperimentFindings, E> {
        let results: Vec<ExperimentResults> = self
            .specimens
            .par_iter()
            .map(|of| self.measure(of, keep, tick))
            .collect::<Result<_, E>>()?;
        Ok(self.conclude(ExperimentResults::merged(results))?)
    }

    fn conclude(&self, results: ExperimentResults) -> Result<ExperimentFindings, LabError> {
        let mut warnings: Vec<String> =
            self.specimens.iter().flat_map(|of| of.warnings.clone()).collect();
        for of in &self.specimens {
            warnings.extend(
                of.stage.warnings()?.into_iter().map(|warning| format!("{}: {warning}", of.name)),
            );
        }
        let mut found = Vec::new();
        if self.experiment == Experiment::Paper {
            match paper_results(&results) {
                Some(results) => found = statements(&results),
                None => warnings.push(
                    "the paper's statements need guide_1, guide_2, guide_3 and \
                     guide_1+distributed_bristles: no table"
                        .to_owned(),
                ),
            }
        }
        let stiffness_of_guide_1 = paper_fit(&results, &self.specimens)?;
        Ok(ExperimentFindings { results, statements: found, stiffness_of_guide_1, warnings })
    }

    fn measure<E: From<LabError>>(
        &self,
        of: &Specimen,
        keep: Option<&Keep<'_, E>>,
        tick: &(dyn Fn() + Sync),
    ) -> Result<ExperimentResults, E> {
        let settings = &self.settings;
        let asked = |part| self.experiment.includes(part);
        let wanted = keep.is_some();
        let keep = |recordings: &[LabRecording]| keep.map_or(Ok(()), |keep| keep(of, recordings));
        let mut results = ExperimentResults::default();
        if asked(Experiment::Stribeck) {
            let (found, recording) = stribeck(of, settings, &SPEEDS, tick)?;
            keep(&[recording])?;
            results.stribeck.push(found);
        }
        if asked(Experiment::Dahl) {
            let (found, recordings) = dahl(of, settings, &self.amplitudes, tick)?;
            keep(&recordings)?;
            if wanted {
                keep(&[quick_loops(of, settings, &QUICK_LOOPS)?])?;
            }
            results.dahl.push(found);
        }
        if asked(Experiment::FrequencyResponse) {
            let (found, recording) = frequency_response(of, settings, tick)?;
            keep(&[recording])?;
            results.frequency_response.push(found);
        }
        for feedforward in [false, true] {
            if asked(Experiment::FastMove) {
                let (found, recording) = fast_move(of, settings, self.rest, feedforward)?;
                keep(&[recording])?;
                results.fast_move.push(found);
                tick();
            }
            if asked(Experiment::FineStep) {
                let (found, recording) = fine_step(of, settings, self.rest, feedforward)?;
                keep(&[recording])?;
                results.fine_step.push(found);
                tick();
            }
        }
        if asked(Experiment::Hunting) {
            let (found, recordings) = hunting(of, settings, &BANDWIDTHS, &INTEGRALS, tick)?;
            keep(&recordings)?;
            results.hunting.push(SpecimenHunting { name: of.name.clone(), results: found });
        }
        if asked(Experiment::Rig) {
            match of.is_plain() {
                true => {
                    let (found, recording) = rig(of, settings, tick)?;
                    keep(&[recording])?;
                    results.rig.push(SpecimenRig { name: of.name.clone(), biases: found });
                }
                // Biases are against closed forms, and those are of a single bristle.
                false if self.experiment == Experiment::Rig => {
                    return Err(LabError::Signal {
                        experiment: "rig",
                        specimen: of.name.clone(),
                        what:
                            "has effects beside the LuGre guide, so no closed form to compare with"
                                .to_owned(),
                    }
                    .into());
                }
                false => (0..RIG_TICKS).for_each(|_| tick()),
            }
        }
        Ok(results)
    }
}

/// What the table of statements needs, if it is there.
fn paper_results(results: &ExperimentResults) -> Option<PaperResults<'_>> {
    fn three<'a, T>(all: impl Fn(&str) -> Option<&'a T>) -> Option<[&'a T; 3]> {
        Some([all("guide 1")?, all("guide 2")?, all("guide 3")?])
    }
    let fast = |fed: bool| {
        three(move |name| results.fast_move.iter().filter(|f| f.name == name).nth(usize::from(fed)))
    };
    Some(PaperResults {
        stribeck: three(|name| results.stribeck.iter().find(|found| found.name == name))?,
        dahl: three(|name| results.dahl.iter().find(|found| found.name == name))?,
        distributed: results.dahl.iter().find(|found| found.name == "guide 1 distributed")?,
        response: three(|name| results.frequency_response.iter().find(|found| found.name == name))?,
        fast: fast(false)?,
        fast_fed: fast(true)?,
        fine: three(|name| results.fine_step.iter().find(|found| found.name == name))?,
        hunting: three(|name| results.hunting.iter().find(|found| found.name == name))?
            .map(|found| found.results.as_slice()),
        rig: &results.rig.iter().find(|found| found.name == "guide 1")?.biases,
    })
}

/// Guide 1's three stated stiffnesses against one bristle and three, where both were measured.
fn paper_fit(
    results: &ExperimentResults,
    specimens: &[Specimen],
) -> Result<Option<StiffnessFit>, LabError> {
    let find = |name: &str| results.dahl.iter().find(|found| found.name == name);
    let (Some(single), Some(distributed)) = (find("guide 1"), find("guide 1 distributed")) else {
        return Ok(None);
    };
    let Some(of) = specimens.iter().find(|of| of.name == "guide 1") else { return Ok(None) };
    let static_force = of.guide()?.static_force;
    let best_single = best_single(&STATED_STIFFNESS, static_force);
    Ok(Some(StiffnessFit {
        best_single_stiffness: best_single,
        distributed: fit_stated(static_force)?,
        errors: stiffness_errors(single, distributed, best_single, static_force),
    }))
}
