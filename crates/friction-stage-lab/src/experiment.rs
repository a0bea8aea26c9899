//! One experiment of the paper, or all of them, on several specimens.
//!
//! In comes which experiment on what; out come its results, the statements of the paper where they
//! were asked for, and what a user should know.

use std::ops::RangeInclusive;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::dahl::{AMPLITUDES, DahlCurves, dahl};
use super::distributed_fit::{DistributedFit, best_single};
use super::fast_move::{FastMove, fast_move_along};
use super::finding::ExperimentFinding;
use super::fine_step::{FineStep, STEPS, fine_step_along};
use super::frequency_response::{FrequencyResponse, frequency_response};
use super::hunting::{BANDWIDTHS, HuntingResult, INTEGRALS, hunting};
use super::paper::{Conditioning, FAST, FINE, PaperMotion};
use super::quick_loops::{QUICK_LOOPS, quick_loops};
use super::rig::{RIG_TICKS, RigBias, rig};
use super::specimen::{LabError, LabRecording, Platform, Settings, Specimen};
use super::statements::{
    PaperResults, STATED_STIFFNESS, Statement, StiffnessError, fit_stated, statements,
    stiffness_errors,
};
use super::stribeck::{SPEEDS, StribeckCurve, stribeck};
use friction_stage_core::model::StageModel;

/// The experiments.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Experiment {
    /// Friction over constant velocity, on the rig.
    Stribeck,
    /// Hysteresis loops at several amplitudes, on the rig.
    Dahl,
    /// Stage under a sinusoidal force of several amplitudes.
    FrequencyResponse,
    /// The paper's move of 50 mm in 100 ms, on the stage.
    FastMove,
    /// The paper's steps of 10 µm in 3 ms, on the stage.
    FineStep,
    /// Limit cycles under integral action at rest, on the stage.
    Hunting,
    /// Biases of the rig against closed forms.
    Rig,
    /// All of these, with the statements of the paper.
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

    /// Whether it runs on a platform.
    pub fn runs_on(self, platform: Platform) -> bool {
        match self {
            Experiment::Stribeck | Experiment::Dahl | Experiment::Rig => platform == Platform::Rig,
            Experiment::FrequencyResponse
            | Experiment::FastMove
            | Experiment::FineStep
            | Experiment::Hunting => platform == Platform::Stage,
            Experiment::Paper => true,
        }
    }

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
    /// What is measured.
    pub experiment: Experiment,
    /// What it is measured on, each with a name of its own.
    pub specimens: Vec<Specimen>,
    /// Noise seed and rates of every run.
    pub settings: Settings,
    /// Rest before the fast move and the fine step, s.
    pub rest: f64,
    /// Amplitudes of the loops of `dahl`, m, ascending.
    pub amplitudes: Vec<f64>,
    /// Way and time of the moves of `fast-move` or the steps of `fine-step`, where they are not the
    /// paper's.
    pub own_move: Option<OwnMove>,
}

/// The way (m) and time (s) of a move.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct OwnMove {
    /// Way of the move, m, above 0.
    pub distance: f64,
    /// Time from start to arrival, s.
    pub duration: f64,
}

/// Refuses an amplitude, m, that no loop has.
pub fn check_amplitude(value: f64) -> Result<(), LabError> {
    within(value, 1e-9..=0.05, "between 1e-9 and 0.05 m")
}

/// Refuses a rest before the fast move and the fine step, s, that is shorter than 10 ms or longer
/// than an hour.
pub fn check_rest(value: f64) -> Result<(), LabError> {
    within(value, 0.01..=3600.0, "between 0.01 and 3600 s")
}

fn within(value: f64, limits: RangeInclusive<f64>, words: &'static str) -> Result<(), LabError> {
    if limits.contains(&value) { Ok(()) } else { Err(LabError::Limit { value, limit: words }) }
}

/// Takes the recordings of a specimen, to be kept.
pub type Keep<'a, E> = dyn Fn(&Specimen, &[LabRecording]) -> Result<(), E> + Sync + 'a;

/// What was measured of a specimen in an experiment that is a part of the whole: kept as soon as it
/// is there, and not measured again by a run that goes on.
pub struct KeptParts<'a, E> {
    /// A part that is kept.
    pub load: &'a LoadPart<'a, E>,
    /// Keeps a part.
    pub save: &'a SavePart<'a, E>,
}

/// Looks for a part that is kept.
pub type LoadPart<'a, E> =
    dyn Fn(&Specimen, Experiment) -> Result<Option<ExperimentResults>, E> + Sync + 'a;
/// Keeps a part.
pub type SavePart<'a, E> =
    dyn Fn(&Specimen, Experiment, &ExperimentResults) -> Result<(), E> + Sync + 'a;

/// What an experiment found.
#[derive(Debug)]
pub struct ExperimentFindings {
    /// Everything measured, by experiment.
    pub results: ExperimentResults,
    /// Of `paper`, where its specimens are there.
    pub statements: Vec<Statement>,
    /// Where guide 1 was measured with one bristle and with three.
    pub stiffness_of_guide_1: Option<StiffnessFit>,
    /// What a script must notice: effects left out, statements that need other guides.
    pub findings: Vec<ExperimentFinding>,
    /// Values that are assumed, guides that are not passive.
    pub notes: Vec<String>,
}

/// Everything measured, by experiment; SI units.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
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
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpecimenHunting {
    /// Name of the specimen.
    pub name: String,
    /// Per bandwidth and integral gain.
    pub results: Vec<HuntingResult>,
}

/// How the rig biases the curves of a specimen.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
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
    /// The same without the points of curves, as a summary has it.
    pub fn without_points(&self) -> ExperimentResults {
        let mut results = self.clone();
        results.fast_move.iter_mut().for_each(|found| found.points.clear());
        results.fine_step.iter_mut().for_each(|found| found.points.clear());
        let loops = results.dahl.iter_mut().flat_map(|found| &mut found.loops);
        loops.for_each(|found| found.points.clear());
        results
    }

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

/// What after a specimen's name says that it is on bristles in parallel.
const DISTRIBUTED: &str = " distributed";

impl Specimen {
    /// The paper's three guides.
    pub const PAPER_GUIDES: [&'static str; 3] = ["guide_1", "guide_2", "guide_3"];

    /// The paper's three guides on parallel bristles, which have all that the paper states of them.
    pub fn paper_guides() -> Result<Vec<Specimen>, LabError> {
        let on_bristles =
            |name| Specimen::named(&format!("{name}{}", StageModel::PARALLEL_BRISTLES));
        Specimen::PAPER_GUIDES.into_iter().map(on_bristles).collect()
    }

    /// A guide of the catalogue by name; with [`StageModel::PARALLEL_BRISTLES`] after it, on
    /// several bristles in parallel.
    pub fn named(name: &str) -> Result<Specimen, LabError> {
        let Some(guide) = name.strip_suffix(StageModel::PARALLEL_BRISTLES) else {
            return Ok(Specimen::of_guide(name)?);
        };
        let single = Specimen::of_guide(guide)?;
        Ok(Specimen {
            name: guide.replace('_', " ") + DISTRIBUTED,
            rig: StageModel::named(&format!("rig:{name}"))?,
            stage: StageModel::named(name)?,
            ..single
        })
    }

    /// Its name as part of a path.
    pub fn file_name(&self) -> String {
        let allowed = |c: char| c.is_ascii_alphanumeric() || "-.".contains(c);
        self.name.chars().map(|c| if allowed(c) { c } else { '_' }).collect()
    }
}

impl ExperimentPlan {
    /// An experiment with the paper's settings; without specimens on
    /// [the paper's guides](Specimen::paper_guides), and for the stiffness of guide 1 on one
    /// bristle as well. Two specimens of one name are refused.
    pub fn new(
        experiment: Experiment,
        mut specimens: Vec<Specimen>,
    ) -> Result<ExperimentPlan, LabError> {
        if specimens.is_empty() {
            specimens = Specimen::paper_guides()?;
            if experiment == Experiment::Paper {
                specimens.push(Specimen::named(Specimen::PAPER_GUIDES[0])?);
            }
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
            own_move: None,
        })
    }

    /// With another way (m) and time (s) of the moves of `fast-move` or the steps of `fine-step`,
    /// another mass that the stage moves (kg) and another bandwidth of its controller (Hz); what is
    /// not given is the paper's.
    pub fn with_move(
        mut self,
        distance: Option<f64>,
        duration: Option<f64>,
        mass: Option<f64>,
        bandwidth: Option<f64>,
    ) -> Result<ExperimentPlan, LabError> {
        let given = [distance, duration, mass, bandwidth];
        if given.iter().all(Option::is_none) {
            return Ok(self);
        }
        let paper = match self.experiment {
            Experiment::FastMove => FAST,
            Experiment::FineStep => FINE,
            other => return Err(LabError::NoMove { experiment: other.name() }),
        };
        let own = OwnMove {
            distance: distance.unwrap_or(paper.0),
            duration: duration.unwrap_or(paper.1),
        };
        within(own.distance, 1e-9..=10.0, "between 1e-9 and 10 m")?;
        within(own.duration, 1e-4..=100.0, "between 1e-4 and 100 s")?;
        self.own_move = Some(own);
        for of in &mut self.specimens {
            if let Some(mass) = mass {
                of.stage.mass = mass;
                of.stage.check()?;
            }
            if let Some(bandwidth) = bandwidth {
                within(bandwidth, 0.1..=1000.0, "between 0.1 and 1000 Hz")?;
                of.bandwidth = bandwidth;
            }
        }
        Ok(self)
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

    /// The move that is made, the paper's where no other is asked for.
    fn moved(&self, (distance, duration): (f64, f64)) -> OwnMove {
        self.own_move.unwrap_or(OwnMove { distance, duration })
    }

    /// Steps of progress.
    pub fn ticks(&self) -> usize {
        self.specimens.len() * self.parts().map(|part| self.ticks_of(part)).sum::<usize>()
    }

    /// The experiments that this one consists of.
    fn parts(&self) -> impl Iterator<Item = Experiment> {
        let asked = self.experiment;
        Experiment::ALL
            .into_iter()
            .filter(move |part| *part != Experiment::Paper && asked.includes(*part))
    }

    fn ticks_of(&self, part: Experiment) -> usize {
        match part {
            Experiment::Stribeck => SPEEDS.len(),
            Experiment::Dahl => self.amplitudes.len(),
            Experiment::FrequencyResponse => FrequencyResponse::TICKS,
            Experiment::FastMove | Experiment::FineStep => 2,
            Experiment::Hunting => BANDWIDTHS.len() * INTEGRALS.len(),
            Experiment::Rig => RIG_TICKS,
            Experiment::Paper => 0,
        }
    }

    /// Measures all specimens, several at once; `tick` is called [`ExperimentPlan::ticks`] times.
    pub fn run<E: From<LabError> + Send>(
        &self,
        keep: Option<&Keep<'_, E>>,
        tick: &(dyn Fn() + Sync),
    ) -> Result<ExperimentFindings, E> {
        self.run_on(keep, None, tick)
    }

    /// As [`ExperimentPlan::run`]; parts that are kept are not measured again.
    pub fn run_on<E: From<LabError> + Send>(
        &self,
        keep: Option<&Keep<'_, E>>,
        kept: Option<&KeptParts<'_, E>>,
        tick: &(dyn Fn() + Sync),
    ) -> Result<ExperimentFindings, E> {
        let one = |of: &Specimen| {
            let mut results = Vec::new();
            for part in self.parts() {
                let found = match kept.map(|kept| (kept.load)(of, part)).transpose()?.flatten() {
                    Some(found) => {
                        (0..self.ticks_of(part)).for_each(|_| tick());
                        found
                    }
                    None => {
                        let found = self.measure(of, part, keep, tick)?;
                        if let Some(kept) = kept {
                            (kept.save)(of, part, &found)?;
                        }
                        found
                    }
                };
                results.push(found);
            }
            Ok(ExperimentResults::merged(results))
        };
        let results: Vec<ExperimentResults> =
            self.specimens.par_iter().map(one).collect::<Result<_, E>>()?;
        Ok(self.conclude(ExperimentResults::merged(results))?)
    }

    /// What was left out of a specimen on what the experiment runs on.
    fn findings_of(&self, of: &Specimen) -> Vec<ExperimentFinding> {
        let concerned = of.omissions.iter().filter(|one| self.experiment.runs_on(one.platform));
        concerned.cloned().map(ExperimentFinding::LeftOut).collect()
    }

    fn conclude(&self, results: ExperimentResults) -> Result<ExperimentFindings, LabError> {
        let mut findings: Vec<ExperimentFinding> =
            self.specimens.iter().flat_map(|of| self.findings_of(of)).collect();
        let mut notes = Vec::new();
        for of in &self.specimens {
            notes.extend(of.stage.notes()?.into_iter().map(|note| format!("{}: {note}", of.name)));
        }
        let mut found = Vec::new();
        if self.experiment == Experiment::Paper {
            match paper_results(&results) {
                Some(results) => found = statements(&results),
                None => findings.push(ExperimentFinding::NoStatements),
            }
        }
        let stiffness_of_guide_1 = paper_fit(&results, &self.specimens)?;
        Ok(ExperimentFindings { results, statements: found, stiffness_of_guide_1, findings, notes })
    }

    fn measure<E: From<LabError>>(
        &self,
        of: &Specimen,
        part: Experiment,
        keep: Option<&Keep<'_, E>>,
        tick: &(dyn Fn() + Sync),
    ) -> Result<ExperimentResults, E> {
        let settings = &self.settings;
        let wanted = keep.is_some();
        let keep = |recordings: &[LabRecording]| keep.map_or(Ok(()), |keep| keep(of, recordings));
        let mut results = ExperimentResults::default();
        match part {
            Experiment::Stribeck => {
                let (found, recording) = stribeck(of, settings, &SPEEDS, tick)?;
                keep(&[recording])?;
                results.stribeck.push(found);
            }
            Experiment::Dahl => {
                let (found, recordings) = dahl(of, settings, &self.amplitudes, tick)?;
                keep(&recordings)?;
                if wanted {
                    keep(&[quick_loops(of, settings, &QUICK_LOOPS)?])?;
                }
                results.dahl.push(found);
            }
            Experiment::FrequencyResponse => {
                let (found, recording) = frequency_response(of, settings, tick)?;
                keep(&[recording])?;
                results.frequency_response.push(found);
            }
            Experiment::FastMove => {
                let OwnMove { distance, duration } = self.moved(FAST);
                let motion = match self.own_move {
                    None => PaperMotion::fast(self.rest),
                    Some(_) => PaperMotion::fast_of(self.rest, distance, duration),
                };
                for feedforward in [false, true] {
                    let (found, recording) = fast_move_along(of, settings, &motion, feedforward)?;
                    keep(&[recording])?;
                    results.fast_move.push(found);
                    tick();
                }
            }
            Experiment::FineStep => {
                let OwnMove { distance, duration } = self.moved(FINE);
                let motion = PaperMotion::fine_of(self.rest, STEPS, distance, duration);
                for feedforward in [false, true] {
                    let (found, recording) = fine_step_along(of, settings, &motion, feedforward)?;
                    keep(&[recording])?;
                    results.fine_step.push(found);
                    tick();
                }
            }
            Experiment::Hunting => {
                let (found, recordings) = hunting(of, settings, &BANDWIDTHS, &INTEGRALS, tick)?;
                keep(&recordings)?;
                results.hunting.push(SpecimenHunting { name: of.name.clone(), results: found });
            }
            Experiment::Rig if of.bristles().map_err(LabError::from)?.is_some() => {
                let (found, recording) = rig(of, settings, tick)?;
                keep(&[recording])?;
                results.rig.push(SpecimenRig { name: of.name.clone(), biases: found });
            }
            // Biases are against closed forms, and those are of bristles that slip gradually.
            Experiment::Rig if self.experiment == Experiment::Rig => {
                return Err(LabError::Signal {
                    experiment: "rig",
                    specimen: of.name.clone(),
                    what: "has more effects than LuGre bristles, so no closed form to compare with"
                        .to_owned(),
                }
                .into());
            }
            Experiment::Rig => (0..RIG_TICKS).for_each(|_| tick()),
            Experiment::Paper => {}
        }
        Ok(results)
    }
}

/// What the table of statements needs, if it exists: of the guides with several bristles in
/// parallel, or of those with one each.
fn paper_results(results: &ExperimentResults) -> Option<PaperResults<'_>> {
    let single = ["guide 1", "guide 2", "guide 3"].map(str::to_owned);
    let parallel = single.clone().map(|name| name + DISTRIBUTED);
    [parallel, single].iter().find_map(|names| paper_results_of(results, names))
}

fn paper_results_of<'a>(
    results: &'a ExperimentResults,
    names: &[String; 3],
) -> Option<PaperResults<'a>> {
    fn three<'a, T>(
        names: &[String; 3],
        find: impl Fn(&str) -> Option<&'a T>,
    ) -> Option<[&'a T; 3]> {
        let [one, two, three] = names;
        Some([find(one)?, find(two)?, find(three)?])
    }
    let fast = |fed: bool| {
        three(names, move |name| {
            results.fast_move.iter().filter(|f| f.name == name).nth(usize::from(fed))
        })
    };
    let distributed = format!("guide 1{DISTRIBUTED}");
    Some(PaperResults {
        model: if names[0] == distributed { "lugre + distributed_bristles" } else { "lugre" },
        stribeck: three(names, |name| results.stribeck.iter().find(|found| found.name == name))?,
        dahl: three(names, |name| results.dahl.iter().find(|found| found.name == name))?,
        distributed: results.dahl.iter().find(|found| found.name == distributed)?,
        response: three(names, |name| {
            results.frequency_response.iter().find(|found| found.name == name)
        })?,
        fast: fast(false)?,
        fast_fed: fast(true)?,
        fine: three(names, |name| results.fine_step.iter().find(|found| found.name == name))?,
        hunting: three(names, |name| results.hunting.iter().find(|found| found.name == name))?
            .map(|found| found.results.as_slice()),
        rig: &results.rig.iter().find(|found| found.name == names[0])?.biases,
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
    let errors = stiffness_errors(single, distributed, best_single, static_force);
    if errors.is_empty() {
        return Ok(None);
    }
    Ok(Some(StiffnessFit {
        best_single_stiffness: best_single,
        distributed: fit_stated(static_force)?,
        errors,
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_move_of_ones_own_is_made_with_ones_own_mass_and_bandwidth() {
        let plan = |experiment| {
            let specimens = vec![Specimen::named("guide_2").unwrap()];
            let plan = ExperimentPlan::new(experiment, specimens).unwrap();
            plan.with_rest(0.05).unwrap()
        };
        let run = |plan: &ExperimentPlan| plan.run::<LabError>(None, &|| ());
        let peak = |found: &ExperimentFindings| found.results.fine_step[0].steps[0].peak_error;
        let step = |bandwidth| {
            let plan = plan(Experiment::FineStep);
            run(&plan.with_move(Some(1e-6), Some(2e-3), None, Some(bandwidth)).unwrap()).unwrap()
        };
        let (slow, fast) = (peak(&step(40.0)), peak(&step(80.0)));
        assert!(fast < slow, "{fast} {slow}");
        let same = plan(Experiment::FineStep);
        let same = same.with_move(Some(10e-6), None, Some(40.0), Some(60.0)).unwrap();
        let paper = run(&plan(Experiment::FineStep)).unwrap();
        assert_eq!(run(&same).unwrap().results, paper.results);

        // Four times the force of the paper's move in half its time; the motor has 2000 N.
        let quick = plan(Experiment::FastMove).with_move(None, Some(0.05), None, None).unwrap();
        let error = run(&quick).unwrap_err().to_string();
        assert!(error.contains("return move before it of 50 mm in 50 ms needs 4619 N"), "{error}");
        // The move before the steps is the paper's, and too much for the mass.
        let heavy = plan(Experiment::FineStep).with_move(None, None, Some(100.0), None).unwrap();
        let error = run(&heavy).unwrap_err().to_string();
        assert!(error.contains("return move before it of 50 mm in 100 ms"), "{error}");
        let dahl = plan(Experiment::Dahl).with_move(Some(1e-3), None, None, None);
        assert!(dahl.unwrap_err().to_string().contains("not for dahl"));
    }

    /// As `--resume` keeps it: what is read back gives the same report.
    #[test]
    fn results_survive_their_file_with_all_their_bits() {
        let specimens = vec![Specimen::named("guide_2").unwrap()];
        let plan = ExperimentPlan::new(Experiment::Dahl, specimens).unwrap();
        let plan = plan.with_amplitudes(&[1e-6]).unwrap();
        let kept = std::sync::Mutex::new(None);
        let parts = KeptParts::<LabError> {
            load: &|_, _| Ok(None),
            save: &|_, _, found| {
                *kept.lock().unwrap() = Some(serde_json::to_string(found).unwrap());
                Ok(())
            },
        };
        let found = plan.run_on(None, Some(&parts), &|| ()).unwrap();
        let text = kept.lock().unwrap().clone().unwrap();
        let read: ExperimentResults = serde_json::from_str(&text).unwrap();
        assert!(!read.dahl[0].loops[0].points.is_empty());
        assert_eq!(serde_json::to_string(&read).unwrap(), text);
        assert_eq!(read.dahl[0].loops, found.results.dahl[0].loops);
        assert!(read.without_points().dahl[0].loops[0].points.is_empty());
        // A part that is kept is not measured again.
        let parts = KeptParts::<LabError> {
            load: &|_, _| Ok(Some(read.clone())),
            save: &|_, _, _| unreachable!("nothing is measured"),
        };
        let ticks = std::sync::atomic::AtomicUsize::new(0);
        let tick = || {
            ticks.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        };
        let again = plan.run_on(None, Some(&parts), &tick).unwrap();
        assert_eq!(again.results, found.results);
        assert_eq!(ticks.into_inner(), plan.ticks());
    }
}
