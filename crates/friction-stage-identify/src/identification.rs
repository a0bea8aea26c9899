//! A whole identification: search, closed loop, and everything that a user should know of the
//! verdict.
//!
//! What comes in are a declared model and [`Records`]; what goes out is an [`Identification`] with
//! the identified model, the errors before and after, and typed findings. The command line adds
//! nothing to it but files and words.

use crate::closed_loop::{self, ClosedLoopError, LinearController};
use crate::error::IdentifyError;
use crate::finding::{IdentifyFinding, RecordSide};
use crate::fit::sensor_noise::MORE_THAN_DECLARED;
use crate::hypothesis::nominal_parameter::NominalParameter;
use crate::hypothesis::{Hypothesis, Part, Tolerances};
use crate::next_experiment::{self, Limits, NextExperiment, Plan};
use crate::record::records::{Record, Records};
use crate::residual_location::SideResidual;
use crate::search::nulls::known_controller;
use crate::search::phase::{RippleElsewhere, ripple_elsewhere};
use crate::search::{Criteria, Inseparable, MOST_LAWS, Outcome, Selection, Verdict, Watch, search};
use crate::summary::{Change, PositionErrors, Summary, parameter_findings, side_name};
use friction_stage_core::model::{Coordinate, Curve, Jump, ModelError, StageModel};
use friction_stage_core::numerics::range;
use friction_stage_core::plant::effects::{Multiplicity, ParameterKind};

/// Ratio up to which the periods of ball passages are those of guides of one type. Assumed.
const ONE_TYPE: f64 = 1.2;
/// Part by which the periods of one ripple may differ. Assumed.
const SAME_PERIOD: f64 = 1e-3;

/// Simulated less recorded encoder of one record, m.
#[derive(Clone, Debug, PartialEq)]
pub struct LoopError {
    /// With the declared model, refitted.
    pub before: Vec<f64>,
    /// With the identified model.
    pub after: Vec<f64>,
}

impl LoopError {
    /// Rms before and after, m.
    pub fn change(&self) -> Change {
        Change {
            before: Some(closed_loop::rms(&self.before)),
            after: Some(closed_loop::rms(&self.after)),
        }
    }
}

/// Closed-loop position errors of both records.
#[derive(Clone, Debug, PartialEq)]
pub struct LoopErrors {
    /// On the train record.
    pub train: LoopError,
    /// On the hold-out record.
    pub holdout: LoopError,
}

/// What the recordings show that the declared model lacks.
pub struct Identification {
    /// What the search found.
    pub selection: Selection,
    /// The declared model with the effects that it lacked, refitted; without laws that explain a
    /// part only.
    pub model: StageModel,
    /// The same with these, where there are any.
    pub partial: Option<StageModel>,
    /// Closed-loop position errors, where the loop can be simulated.
    pub loops: Option<LoopErrors>,
    /// What a user should know.
    pub findings: Vec<IdentifyFinding>,
    /// The motion that would settle most of what is open, where one was asked for.
    pub next: Option<Plan>,
    declared: StageModel,
}

impl Identification {
    /// Searches for what the declared model lacks, simulates the closed loop, and gathers what a
    /// user should know.
    pub fn new(
        declared: &StageModel,
        tolerances: Tolerances,
        records: &Records,
        watch: &dyn Watch,
    ) -> Result<Identification, IdentifyError> {
        let (train, holdout) = (&records.train.measured, &records.holdout.measured);
        let selection = search(declared, tolerances, train, holdout, watch)?;
        let identified = &selection.after.fitted.hypothesis;
        let model = selection.usable.model();
        let laws = selection.partial_laws();
        let partial = (!laws.is_empty()).then(|| identified.model());
        let mut findings = records.findings.clone();
        for (record, measured) in [(RecordSide::Train, train), (RecordSide::Holdout, holdout)] {
            let (share, count) = (measured.hidden_rest_share, measured.count);
            if share > 0.0 {
                findings.push(IdentifyFinding::HiddenRest { record, share, count });
            }
        }
        let on_holdout = identified.in_record(holdout)?;
        findings.extend(of_each_record(
            identified,
            &on_holdout,
            holdout.time.last().copied().unwrap_or(0.0),
        ));
        let loops = match simulate(&selection, records, &on_holdout.model()) {
            Ok(loops) => Some(loops),
            Err(error) => {
                findings.push(IdentifyFinding::NoClosedLoop { reason: error.to_string() });
                None
            }
        };
        findings.extend(of_search(&selection, train.rate));
        if partial.is_some() {
            findings.push(IdentifyFinding::PartialLaws { effects: laws });
        }
        findings.extend(moved_ripples(&selection, records)?);
        findings.extend(residual_locations(&selection, records)?);
        let mut identification = Identification {
            selection,
            model,
            partial,
            loops,
            findings,
            next: None,
            declared: declared.clone(),
        };
        let worse = identification.summary(records, "", &|_| String::new()).worse();
        identification.findings.extend(worse);
        Ok(identification)
    }

    /// The model with all that was found.
    pub fn found_model(&self) -> &StageModel {
        self.partial.as_ref().unwrap_or(&self.model)
    }

    /// The declared model.
    pub fn declared(&self) -> &StageModel {
        &self.declared
    }

    /// Works out the motion that settles most of what is open; where there is none, a finding says
    /// so.
    pub fn plan_next(&mut self, records: &Records, limits: Limits) {
        let train = &records.train.measured;
        match next_experiment::plan(&self.selection, &self.declared, train, limits) {
            Ok(plan) => {
                self.findings.extend(of_next(&plan.next));
                self.next = Some(plan);
            }
            // The search took its time: its results are not thrown away for this.
            Err(error) => {
                self.findings.push(IdentifyFinding::NoNextExperiment { reason: error.to_string() });
            }
        }
    }

    /// The summary for other programs. `model_file` is the name of the file with the identified
    /// model, `words` the sentence for a finding.
    pub fn summary(
        &self,
        records: &Records,
        model_file: &str,
        words: &dyn Fn(&IdentifyFinding) -> String,
    ) -> Summary {
        let change = |of: fn(&LoopErrors) -> &LoopError| {
            self.loops.as_ref().map_or_else(Change::default, |loops| of(loops).change())
        };
        let position =
            PositionErrors { train: change(|loops| &loops.train), holdout: change(|l| &l.holdout) };
        let (train, holdout) = (&records.train.measured, &records.holdout.measured);
        let mut summary = Summary::new(&self.selection, train, holdout, position, model_file);
        summary.add_findings(&self.findings, words);
        summary.next_experiment = self.next.as_ref().map(|plan| plan.next.clone());
        summary
    }
}

/// What of the model is each record's own: phases, instants, and balls that slip.
fn of_each_record(
    identified: &Hypothesis,
    on_holdout: &Hypothesis,
    length: f64,
) -> Vec<IdentifyFinding> {
    let mut findings = Vec::new();
    let differs = identified.own_of(on_holdout);
    if let Some(part) = differs.iter().find(|part| part.has_phase_of_record()) {
        findings.push(IdentifyFinding::PhaseOfRecord { effect: part.descriptor.name });
    }
    for at in differs.iter().filter_map(|part| Some(part.curve()?.jump?.at)) {
        findings.push(IdentifyFinding::JumpElsewhere { at, length });
    }
    if let Some(part) = identified.effects.iter().find(|part| part.slips()) {
        findings.push(IdentifyFinding::Slips { effect: part.descriptor.name });
    }
    findings
}

/// Closed-loop position errors before and after, on both records.
fn simulate(
    selection: &Selection,
    records: &Records,
    on_holdout: &StageModel,
) -> Result<LoopErrors, ClosedLoopError> {
    let (train, holdout) = (&records.train, &records.holdout);
    let all: Vec<_> = train.traces().chain(holdout.traces()).collect();
    // Slow moves do not show all of a controller: another train record may.
    let mut found = train.traces().map(|trace| closed_loop::controller_of(trace, &all));
    let first = found.next().unwrap_or(Err(ClosedLoopError::NoSetpoint));
    let controller = first.or_else(|error| found.find_map(Result::ok).ok_or(error))?;
    let (before, after) =
        (selection.before.hypothesis.model(), selection.after.fitted.hypothesis.model());
    let errors = |record: &Record, after: &StageModel, controller: &LinearController| {
        let each = |model: &StageModel| {
            record
                .traces()
                .map(|trace| closed_loop::position_error(model, trace, controller))
                .collect::<Result<Vec<_>, _>>()
                .map(|errors| errors.concat())
        };
        Ok::<_, ClosedLoopError>(LoopError { before: each(&before)?, after: each(after)? })
    };
    Ok(LoopErrors {
        train: errors(train, &after, &controller)?,
        holdout: errors(holdout, on_holdout, &controller)?,
    })
}

impl IdentifyFinding {
    /// Where a curve jumps, with its value before that.
    pub fn of_jump(curve: &Curve) -> Option<IdentifyFinding> {
        let Jump { at, height } = curve.jump?;
        let corner = curve.corners().into_iter().find(|(place, _)| *place >= at);
        let before = corner.map_or(0.0, |(_, value)| value);
        Some(IdentifyFinding::MapJumps { at, height, before, side: curve.side })
    }
}

/// What a user should know about the model and the search.
fn of_search(selection: &Selection, rate: f64) -> Vec<IdentifyFinding> {
    let mut findings = Vec::new();
    let left = selection.errors_after.holdout().sqrt();
    let noise_floor = selection.floor.total();
    if selection.stopped {
        findings.push(IdentifyFinding::Stopped);
    }
    for Inseparable { effect, rival, correlation } in selection.inseparable.iter().copied() {
        findings.push(IdentifyFinding::Inseparable { effect, rival, correlation });
    }
    let added =
        &selection.after.fitted.hypothesis.effects[selection.before.hypothesis.effects.len()..];
    let of_guides: Vec<&Part> = added
        .iter()
        .filter(|part| part.descriptor.multiplicity == Multiplicity::OnePerGuide)
        .collect();
    let periods: Vec<f64> =
        of_guides.iter().filter_map(|part| part.value_of_kind(ParameterKind::Period)).collect();
    let (shortest, longest) = range(&periods);
    if let [first, _, ..] = of_guides[..]
        && longest < ONE_TYPE * shortest
    {
        let effect = first.descriptor.name;
        findings.push(IdentifyFinding::OneRipple { effect, count: periods.len() });
    }
    for (effect, periods) in selection.unproven.iter().copied() {
        findings.push(IdentifyFinding::FewPeriods { effect, periods });
    }
    let coordinate: Option<Coordinate> = selection.coordinate;
    if let (Verdict::Unknown, Some(coordinate)) = (selection.verdict, coordinate) {
        findings.push(IdentifyFinding::UnexplainedOver { coordinate });
        let curves = added.iter().filter_map(|part| part.curve());
        findings.extend(curves.filter_map(|curve| IdentifyFinding::of_jump(&curve)));
    }
    let declared = selection.declared_floor.total();
    if noise_floor > MORE_THAN_DECLARED * declared {
        let least = Criteria::USUAL.seen_on_carriage().sqrt() * selection.floor.carriage;
        findings.push(IdentifyFinding::NoiseAboveDeclared { found: noise_floor, declared, least });
    }
    if selection.leaves_more_than_usual() {
        let may_be_missing = (left * left - noise_floor * noise_floor).max(0.0).sqrt();
        findings.push(IdentifyFinding::MoreThanUsual { left, noise_floor, may_be_missing });
    }
    if let Some(open) = selection.left_open {
        findings.push(IdentifyFinding::LeftOpen { left, noise_floor, open });
    }
    findings.extend(other_bristles(selection, rate));
    let is_something = coordinate.is_none() && !selection.at_bound && !selection.stopped;
    if selection.verdict == Verdict::Unknown && is_something {
        findings.push(IdentifyFinding::Unexplained { left, noise_floor });
    }
    let more_than_noise = left > Criteria::USUAL.noise_like * noise_floor;
    if matches!(selection.verdict, Verdict::Found | Verdict::NotSeparable) && more_than_noise {
        findings.push(match selection.wander_of_zero {
            Some(wander) => IdentifyFinding::WanderingZero { wander },
            None => IdentifyFinding::RoughLaws { left, noise_floor },
        });
    }
    if selection.added_laws() >= MOST_LAWS && more_than_noise {
        findings.push(IdentifyFinding::MostLaws { laws: MOST_LAWS });
    }
    findings.extend(parameter_findings(&selection.after, rate));
    findings
}

/// Bristles that are beyond their tolerance.
fn other_bristles(selection: &Selection, rate: f64) -> Vec<IdentifyFinding> {
    let Some(within) = selection.errors_within_tolerance else { return Vec::new() };
    let hypothesis = &selection.after.fitted.hypothesis;
    let of = |(parameter, factor): (NominalParameter, f64)| {
        let found = hypothesis.declared_value(parameter, rate);
        IdentifyFinding::OtherBristles {
            parameter: parameter.name(),
            found,
            declared: found / factor,
            unit: parameter.unit(),
            tolerance: hypothesis.tolerance_of(parameter),
            left_within_tolerance: within.holdout().sqrt(),
        }
    };
    hypothesis.bristles_beyond_tolerance().into_iter().map(of).collect()
}

/// Ripples of the train record that the hold-out has too, but with another phase: as found they
/// would make it worse.
fn moved_ripples(
    selection: &Selection,
    records: &Records,
) -> Result<Vec<IdentifyFinding>, ModelError> {
    let Some(last) = selection.evidence.iter().map(|one| one.round).max() else {
        return Ok(Vec::new());
    };
    let holdout = &records.holdout.measured;
    let least = Criteria::USUAL.seen_on_carriage() * selection.floor.carriage.powi(2);
    // Without a cell a ripple of the motor and one of the carriage are the same one.
    let one_side = holdout.cell.is_none();
    let mut moved: Vec<(RippleElsewhere, Vec<&'static str>)> = Vec::new();
    let rejected = |outcome: Outcome| matches!(outcome, Outcome::TooSmall);
    for one in selection.evidence.iter().filter(|one| one.round == last && rejected(one.outcome)) {
        let found = ripple_elsewhere(&one.part, &selection.after.fitted.hypothesis, holdout)?;
        let Some(ripple) = found.filter(|ripple| one.train_gain > least && ripple.has_moved(least))
        else {
            continue;
        };
        let alike = |other: &RippleElsewhere| {
            one_side && (other.period - ripple.period).abs() < SAME_PERIOD * ripple.period
        };
        match moved.iter_mut().find(|(other, _)| alike(other)) {
            Some((_, effects)) => effects.push(one.name),
            None => moved.push((ripple, vec![one.name])),
        }
    }
    let finding = |(ripple, effects): (RippleElsewhere, Vec<&'static str>)| {
        let RippleElsewhere { period, phase_shift, .. } = ripple;
        IdentifyFinding::MovedRipple { effects, period, phase_shift }
    };
    Ok(moved.into_iter().map(finding).collect())
}

/// Where what the laws leave of each record sits, where it is more than noise. A map stands for
/// what no law explains: its part is left, too.
fn residual_locations(
    selection: &Selection,
    records: &Records,
) -> Result<Vec<IdentifyFinding>, ModelError> {
    let declared = selection.before.hypothesis.effects.len();
    let mut laws = selection.after.fitted.hypothesis.clone();
    let mut added = laws.effects.split_off(declared);
    added.retain(|part| !part.descriptor.is_curve());
    laws.effects.append(&mut added);
    let (train, holdout) = (&records.train.measured, &records.holdout.measured);
    let controller = known_controller(train, holdout);
    let mut findings = Vec::new();
    for (record, measured, floor) in [
        (RecordSide::Train, train, selection.train_floor),
        (RecordSide::Holdout, holdout, selection.floor),
    ] {
        let here = laws.in_record(measured)?;
        let found = here.residual_location(measured, floor, controller.as_ref())?;
        if let Some(SideResidual { side, left, noise_floor, location }) = found
            && !location.is_empty()
        {
            let side = side_name(side);
            findings.push(IdentifyFinding::ResidualLocation {
                record,
                side,
                left,
                noise_floor,
                location,
            });
        }
    }
    Ok(findings)
}

/// What no motion within the limits does.
fn of_next(next: &NextExperiment) -> Vec<IdentifyFinding> {
    let open = next.rivals.iter().filter(|rival| !rival.separates);
    open.map(|rival| IdentifyFinding::NoSeparatingMotion {
        effect: rival.effect.clone(),
        rival: rival.rival.clone(),
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use friction_stage_core::model::CurveSide;

    #[test]
    fn a_jump_comes_with_the_value_of_the_curve_before_it() {
        let (coordinate, side) = (Coordinate::Time, CurveSide::Friction);
        let jump = Some(Jump { at: 3.0, height: -0.18 });
        let values = vec![-0.1, -0.1, 0.3];
        let curve = Curve { coordinate, side, from: 0.0, to: 8.0, values, jump };
        let Some(IdentifyFinding::MapJumps { at, height, before, side: of }) =
            IdentifyFinding::of_jump(&curve)
        else {
            panic!("a curve with a jump");
        };
        assert_eq!((at, height, of), (3.0, -0.18, side));
        assert!((before + 0.1).abs() < 1e-12, "{before}");
    }
}
