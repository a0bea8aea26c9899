//! What identification found, as other programs read it: `summary.json`. Keys and their meaning
//! stay.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};

use crate::finding::{BoundSide, FigureOfMerit, IdentifyFinding, RecordSide};
use crate::fit::Estimate;
use crate::hypothesis::nominal_parameter::NominalParameter;
use crate::hypothesis::{FreeParameter, ParameterId};
use crate::next_experiment::NextExperiment;
use crate::record::measured::Measured;
use crate::search::{Selection, Verdict};
use friction_stage_core::model::{Curve, JointType};
use friction_stage_core::numerics::TWO_SIDED_95;
use friction_stage_core::plant::{EffectDescriptor, Side};
use friction_stage_data::quality::Severity;

/// Version of the schema.
pub const SCHEMA_VERSION: u32 = 1;

/// Correlation from which two parameters are reported as tied. Assumed: at 0.98 each is known five
/// times worse than if the other were given.
const TIED: f64 = 0.98;

/// The whole file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Of this layout.
    pub schema_version: u32,
    /// `found`, `none`, `unknown` or `not_separable`.
    pub verdict: String,
    /// Joint type, of which the units are; a prismatic joint where it is missing.
    #[serde(default)]
    pub joint: JointType,
    /// Effects that the declared model lacked, in the order in which they were found.
    pub effects: Vec<FoundEffect>,
    /// Before and after.
    pub errors: SummaryErrors,
    /// What noise alone leaves.
    pub floor: FloorErrors,
    /// Share of the residual of the hold-out above the noise floor that the effects explain.
    pub explained_share: f64,
    /// By name; those of a declared effect as `effect.parameter`.
    pub declared_parameters: BTreeMap<String, FoundParameter>,
    /// File name of the identified model, in the directory of the summary.
    pub model: String,
    /// The sentences of the findings.
    pub warnings: Vec<String>,
    /// What a user should know.
    #[serde(default)]
    pub findings: Vec<SummaryFinding>,
    /// The motion that would settle most of what is open, where one was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub next_experiment: Option<NextExperiment>,
}

/// Something that a user should know, as other programs read it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SummaryFinding {
    /// Stable name of the kind.
    pub code: String,
    /// `note`, `warning` or `fatal`.
    pub severity: String,
    /// The recording that it is about, where it is about one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub recording: Option<String>,
    /// Its numbers and names, by what they are.
    pub numbers: serde_json::Map<String, serde_json::Value>,
    /// The sentence for it.
    pub text: String,
}

impl SummaryFinding {
    /// Whether it says what a recording or the search is like, and nothing is wrong.
    pub fn is_note(&self) -> bool {
        self.severity == Severity::Note.name()
    }
}

/// An effect that the declared model lacked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FoundEffect {
    /// Name of the law or effect.
    pub name: String,
    /// `motor`, `carriage` or `sensor`.
    pub side: String,
    /// Of a map: `position`, `velocity` or `time`.
    pub coordinate: Option<String>,
    /// By name.
    pub parameters: BTreeMap<String, FoundParameter>,
    /// The best of the other candidates of its round.
    pub runner_up: Option<RunnerUp>,
    /// Laws that explain the data as well: the verdict is `not_separable`.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rivals: Vec<Rival>,
}

/// A law that explains the data as well as one that was found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Rival {
    /// Name of the law or effect.
    pub name: String,
    /// Of what the two take out of the train residual, -1 to 1.
    pub correlation: f64,
}

/// A value with its interval.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FoundParameter {
    /// In the unit.
    pub value: f64,
    /// SI.
    pub unit: String,
    /// 95 % confidence interval; `null` where the fit did not move the value or the data say
    /// nothing about it.
    pub ci95: Option<[f64; 2]>,
}

/// The best other law in the place of one that was found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunnerUp {
    /// Name of the law or effect.
    pub name: String,
    /// N
    pub holdout_force_rms: f64,
    /// How many times less likely it is than the law that was found, each record and side as one
    /// measurement.
    pub times_less_likely: f64,
}

/// Errors on both records.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SummaryErrors {
    /// On the train record.
    pub train: RecordErrors,
    /// On the hold-out.
    pub holdout: RecordErrors,
}

/// Errors on one record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordErrors {
    /// Rms of the missing force, motor and carriage side together, N.
    pub force_rms: Change,
    /// The same in % of the rms of the measured force.
    pub force_relative: Change,
    /// Rms of simulated closed loop less encoder, m; `null` where it cannot be simulated.
    pub position_rms: Change,
}

/// With the declared model, refitted, and with the identified one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Of the declared model, fitted; null where it cannot be said.
    pub before: Option<f64>,
    /// Of the model that was found.
    pub after: Option<f64>,
}

/// What the noise of the sensors leaves.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FloorErrors {
    /// N
    pub force_rms: f64,
}

/// Closed-loop position errors, m rms.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PositionErrors {
    /// On the train record.
    pub train: Change,
    /// On the hold-out.
    pub holdout: Change,
}

impl Verdict {
    /// As in the summary.
    pub fn name(self) -> &'static str {
        match self {
            Verdict::Found => "found",
            Verdict::None => "none",
            Verdict::Unknown => "unknown",
            Verdict::NotSeparable => "not_separable",
        }
    }
}

/// A number as a person reads it: six digits, or powers of ten where these would hide it.
pub fn readable(value: f64) -> String {
    if value != 0.0 && !(1e-3..1e6).contains(&value.abs()) {
        return format!("{value:.4e}");
    }
    let decimals = (5.0 - value.abs().max(0.1).log10().floor()) as usize;
    let digits = format!("{value:.decimals$}");
    if decimals == 0 {
        digits
    } else {
        digits.trim_end_matches('0').trim_end_matches('.').to_owned()
    }
}

/// A number in the digits that its interval deserves.
pub fn in_digits(value: f64, ci95: Option<[f64; 2]>) -> String {
    let Some([low, high]) = ci95 else { return readable(value) };
    let size = (0.5 * (high - low)).max(value.abs() * 1e-9);
    if value != 0.0 && !(1e-3..1e6).contains(&value.abs()) {
        let relative = if size > 0.0 {
            (value.abs().log10().floor() - size.log10().floor() + 1.0).clamp(2.0, 9.0)
        } else {
            3.0
        };
        return format!("{value:.*e}", relative as usize);
    }
    let digits = if size > 0.0 { (2.0 - size.log10().ceil()).clamp(0.0, 12.0) as usize } else { 3 };
    format!("{value:.digits$}")
}

/// Name of a side, as in the summary.
pub fn side_name(side: Side) -> &'static str {
    match side {
        Side::Motor => "motor",
        Side::Carriage => "carriage",
        Side::Sensor => "sensor",
    }
}

impl Summary {
    /// What a search found on these records. `model` is the name of the file with the identified
    /// model.
    pub fn new(
        selection: &Selection,
        train: &Measured,
        holdout: &Measured,
        position: PositionErrors,
        model: &str,
    ) -> Summary {
        let estimate = &selection.after;
        let declared_effects = selection.before.hypothesis.effects.len();
        let mut declared_parameters: BTreeMap<String, FoundParameter> = NominalParameter::ALL
            .into_iter()
            .map(|one| (one.name().to_owned(), declared(estimate, one, train.rate)))
            .collect();
        for index in 0..declared_effects {
            let label = estimate.fitted.hypothesis.label(index);
            for (name, parameter) in parameters(estimate, index) {
                declared_parameters.insert(format!("{label}.{name}"), parameter);
            }
        }
        let mut effects: Vec<FoundEffect> = estimate
            .fitted
            .hypothesis
            .effects
            .iter()
            .enumerate()
            .skip(declared_effects)
            .map(|(index, part)| FoundEffect {
                name: part.descriptor.name.to_owned(),
                side: side_name(part.side()).to_owned(),
                coordinate: part.curve().map(|curve| curve.coordinate.name().to_owned()),
                parameters: parameters(estimate, index),
                runner_up: selection.runners_up.get(index).copied().flatten().map(|one| RunnerUp {
                    name: one.name.to_owned(),
                    holdout_force_rms: one.holdout_rms,
                    times_less_likely: one.times_less_likely,
                }),
                rivals: selection
                    .inseparable
                    .iter()
                    .filter(|pair| pair.effect == part.descriptor.name)
                    .map(|pair| Rival {
                        name: pair.rival.to_owned(),
                        correlation: pair.correlation,
                    })
                    .collect(),
            })
            .collect();
        let joint = estimate.fitted.hypothesis.model().joint;
        let of_effects =
            effects.iter_mut().flat_map(|effect: &mut FoundEffect| effect.parameters.values_mut());
        for parameter in of_effects.chain(declared_parameters.values_mut()) {
            parameter.unit = joint.unit(&parameter.unit).into_owned();
        }
        let (before, after) = (selection.errors_before, selection.errors_after);
        let record = |measured: &Measured, before: f64, after: f64, position_rms: Change| {
            let force_rms = Change { before: Some(before.sqrt()), after: Some(after.sqrt()) };
            let whole = measured.force_rms();
            let relative =
                |rms: Option<f64>| rms.filter(|_| whole > 0.0).map(|rms| 100.0 * rms / whole);
            RecordErrors {
                force_rms,
                force_relative: Change {
                    before: relative(force_rms.before),
                    after: relative(force_rms.after),
                },
                position_rms,
            }
        };
        Summary {
            schema_version: SCHEMA_VERSION,
            verdict: selection.verdict.name().to_owned(),
            joint,
            effects,
            errors: SummaryErrors {
                train: record(train, before.train(), after.train(), position.train),
                holdout: record(holdout, before.holdout(), after.holdout(), position.holdout),
            },
            floor: FloorErrors { force_rms: selection.declared_floor.total() },
            explained_share: selection.explained_share(),
            declared_parameters,
            model: model.to_owned(),
            warnings: Vec::new(),
            findings: Vec::new(),
            next_experiment: None,
        }
    }

    /// Adds findings, with their words.
    pub fn add_findings(
        &mut self,
        findings: &[IdentifyFinding],
        words: &dyn Fn(&IdentifyFinding) -> String,
    ) {
        for finding in findings {
            let text = words(finding);
            self.warnings.push(text.clone());
            self.findings.push(SummaryFinding {
                code: finding.code().to_owned(),
                severity: finding.severity().name().to_owned(),
                recording: finding.recording().map(|path| path.display().to_string()),
                numbers: finding.numbers(),
                text,
            });
        }
    }

    /// Whether there is more to know than notes: what a script must not pass over.
    pub fn has_warnings(&self) -> bool {
        !self.findings.iter().all(SummaryFinding::is_note)
    }

    /// Figures of merit that are worse after than before.
    pub fn worse(&self) -> Vec<IdentifyFinding> {
        let mut worse = Vec::new();
        for (record, errors) in
            [(RecordSide::Train, &self.errors.train), (RecordSide::Holdout, &self.errors.holdout)]
        {
            let figures = [
                (FigureOfMerit::ForceResidual, errors.force_rms),
                (FigureOfMerit::PositionError, errors.position_rms),
            ];
            for (figure, change) in figures {
                if let (Some(before), Some(after)) = (change.before, change.after)
                    && after > before
                {
                    worse.push(IdentifyFinding::Worse { figure, record, before, after });
                }
            }
        }
        worse
    }
}

/// FreeParameter of a place in a fit with its standard deviation and whether it ended on a bound.
fn coordinate(estimate: &Estimate, id: ParameterId) -> Option<(&FreeParameter, f64, bool)> {
    let index = estimate.fitted.coordinates.iter().position(|coordinate| coordinate.id == id)?;
    Some((
        &estimate.fitted.coordinates[index],
        estimate.deviation(index),
        estimate.fitted.at_bound[index],
    ))
}

/// Standard deviation of the mean over the guides of a declared parameter, as a share of it (of the
/// shift: s): how the guides differ is estimate too, and what one of them does not know of itself
/// the sum of all may know. First order in the deviations of all coordinates. Infinite where the
/// parameter is on a bound or the data say nothing.
fn deviation_of_declared(estimate: &Estimate, declared: NominalParameter, rate: f64) -> f64 {
    match coordinate(estimate, ParameterId::Nominal(declared)) {
        Some((_, deviation, false)) if deviation.is_finite() => {}
        _ => return f64::INFINITY,
    }
    let value = estimate.fitted.hypothesis.declared_value(declared, rate);
    let whole = if declared.is_factor() { value } else { 1.0 };
    let sensitivities: Vec<f64> = estimate
        .fitted
        .coordinates
        .iter()
        .zip(&estimate.deviations)
        .map(|(coordinate, deviation)| {
            let ours =
                matches!(coordinate.id, ParameterId::Nominal(_) | ParameterId::Spread { .. });
            if !ours || !deviation.is_finite() {
                return 0.0;
            }
            let step = 1e-4 * coordinate.scale;
            let at = |moved: f64| {
                let mut hypothesis = estimate.fitted.hypothesis.clone();
                hypothesis.set(coordinate.id, coordinate.value + moved);
                hypothesis.declared_value(declared, rate)
            };
            (at(step) - at(-step)) / (2.0 * step * whole)
        })
        .collect();
    let scattered: Vec<f64> = sensitivities
        .iter()
        .zip(&estimate.deviations)
        .map(
            |(sensitivity, deviation)| {
                if *sensitivity == 0.0 { 0.0 } else { sensitivity * deviation }
            },
        )
        .collect();
    let variance: f64 = scattered
        .iter()
        .zip(&estimate.correlations)
        .map(|(one, row)| {
            one * scattered
                .iter()
                .zip(row)
                .map(|(other, correlation)| other * correlation)
                .sum::<f64>()
        })
        .sum();
    // All coordinates are shifted together.
    let shift: f64 = sensitivities
        .iter()
        .zip(&estimate.shifts)
        .map(|(sensitivity, shift)| sensitivity * shift)
        .sum();
    variance.max(0.0).sqrt().hypot(shift)
}

/// Standard deviation of a coordinate if it were known how the guides differ: what the motion says
/// about the parameter at all.
fn deviation_of_alike(estimate: &Estimate, index: usize) -> f64 {
    let deviation = estimate.deviations[index];
    let spread: Vec<usize> = (0..estimate.fitted.coordinates.len())
        .filter(|other| {
            matches!(estimate.fitted.coordinates[*other].id, ParameterId::Spread { .. })
                && estimate.deviations[*other].is_finite()
        })
        .collect();
    if spread.is_empty() || !deviation.is_finite() {
        return deviation;
    }
    let among = DMatrix::from_fn(spread.len(), spread.len(), |row, column| {
        estimate.correlations[spread[row]][spread[column]]
    });
    let with = DVector::from_fn(spread.len(), |row, _| estimate.correlations[index][spread[row]]);
    match among.cholesky() {
        Some(factors) => deviation * (1.0 - with.dot(&factors.solve(&with))).max(0.0).sqrt(),
        None => deviation,
    }
}

fn declared(estimate: &Estimate, declared: NominalParameter, rate: f64) -> FoundParameter {
    let value = estimate.fitted.hypothesis.declared_value(declared, rate);
    let reach = TWO_SIDED_95 * deviation_of_declared(estimate, declared, rate);
    let ci95 = if declared.is_factor() {
        [value * (-reach).exp(), value * reach.exp()]
    } else {
        [value - reach, value + reach]
    };
    let ci95 = Some(ci95).filter(|[low, high]| low.is_finite() && high.is_finite());
    FoundParameter { value, unit: declared.unit().to_owned(), ci95 }
}

/// Names of an effect's parameters that have a part in the form of its law, in the order of the
/// law.
pub fn taking_part(effect: &FoundEffect) -> Vec<&str> {
    let Ok(descriptor) = EffectDescriptor::find(&effect.name) else {
        return effect.parameters.keys().map(String::as_str).collect();
    };
    let value = |name: &str| effect.parameters.get(name).map(|parameter| parameter.value);
    let values: Vec<f64> = descriptor
        .parameters
        .iter()
        .map(|parameter| value(parameter.name).or(parameter.default).unwrap_or(0.0))
        .collect();
    if descriptor.is_curve() {
        return effect.parameters.keys().map(String::as_str).collect();
    }
    let named = descriptor.parameters.iter().enumerate();
    named
        .filter(|(index, _)| descriptor.takes_part(&values, *index))
        .map(|(_, parameter)| parameter.name)
        .collect()
}

fn parameters(estimate: &Estimate, effect: usize) -> BTreeMap<String, FoundParameter> {
    let part = &estimate.fitted.hypothesis.effects[effect];
    if let Some(curve) = part.curve() {
        return of_curve(&curve);
    }
    part.descriptor
        .parameters
        .iter()
        .enumerate()
        .map(|(index, parameter)| {
            let value = part.values[index];
            let reach = coordinate(estimate, ParameterId::Effect { effect, value: index })
                .map_or(f64::INFINITY, |(_, deviation, _)| TWO_SIDED_95 * deviation);
            // An interval wider than what is possible says nothing.
            let says = reach.is_finite() && 2.0 * reach < parameter.bounds.1 - parameter.bounds.0;
            let ci95 = says.then_some([value - reach, value + reach]);
            (
                parameter.name.to_owned(),
                FoundParameter { value, unit: parameter.unit.to_owned(), ci95 },
            )
        })
        .collect()
}

/// Where a curve begins and ends, its height above its median where it is farthest from it, its
/// center, which is the mean place, weighted by the square of the height, and its jump. The
/// coordinate and the side stand beside these.
fn of_curve(curve: &Curve) -> BTreeMap<String, FoundParameter> {
    let corners = curve.corners();
    let mut sorted: Vec<f64> = corners.iter().map(|(_, value)| *value).collect();
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    let heights = || corners.iter().map(|(place, value)| (place, value - median));
    let height = heights()
        .map(|(_, height)| height)
        .max_by(|a, b| a.abs().total_cmp(&b.abs()))
        .unwrap_or(0.0);
    let (moment, weight) = heights().fold((0.0, 0.0), |(moment, sum), (place, height)| {
        (moment + place * height * height, sum + height * height)
    });
    let center = if weight > 0.0 { moment / weight } else { 0.5 * (curve.from + curve.to) };
    let (along, unit) = (curve.coordinate.unit(), curve.side.unit());
    let jump = curve.jump.map(|jump| [("jump", jump.height, unit), ("jump_at", jump.at, along)]);
    let always = [
        ("from", curve.from, along),
        ("to", curve.to, along),
        ("amplitude", height, unit),
        ("center", center, along),
    ];
    let found = |(name, value, unit): (&str, f64, &str)| {
        (name.to_owned(), FoundParameter { value, unit: unit.to_owned(), ci95: None })
    };
    always.into_iter().chain(jump.into_iter().flatten()).map(found).collect()
}

/// Whether a coordinate is the logarithm of a factor on a declared value.
fn is_share(id: ParameterId) -> bool {
    matches!(id, ParameterId::Nominal(declared) if declared.is_factor())
}

/// What deserves a word about the parameters of a fit: on a bound, hardly or not determined by the
/// data, or tied to another one.
pub(crate) fn parameter_findings(estimate: &Estimate, rate: f64) -> Vec<IdentifyFinding> {
    let mut findings = Vec::new();
    for (index, coordinate) in estimate.fitted.coordinates.iter().enumerate() {
        // How the guides differ is not asked for: their sum is.
        let Some((parameter, value, unit)) = reported(estimate, coordinate.id, rate) else {
            continue;
        };
        let (lower, upper) = coordinate.bounds;
        let deviation = match coordinate.id {
            ParameterId::Nominal(_) => deviation_of_alike(estimate, index),
            _ => estimate.deviation(index),
        };
        if estimate.fitted.at_bound[index] && coordinate.has_come_to_nothing() {
            // A term of the law that is not there is no doubt about the others.
            continue;
        } else if estimate.fitted.at_bound[index] {
            let lower = coordinate.value <= 0.5 * (lower + upper);
            let bound = if lower { BoundSide::Lower } else { BoundSide::Upper };
            let tolerance = match coordinate.id {
                ParameterId::Nominal(declared) if declared != NominalParameter::SensorShift => {
                    Some(estimate.fitted.hypothesis.tolerance_of(declared))
                }
                _ => None,
            };
            findings.push(IdentifyFinding::AtBound { parameter, bound, value, unit, tolerance });
        } else if !deviation.is_finite()
            || (is_share(coordinate.id) && TWO_SIDED_95 * deviation > 1.0)
            || (matches!(coordinate.id, ParameterId::Effect { .. })
                && 2.0 * TWO_SIDED_95 * deviation >= upper - lower)
        {
            findings.push(IdentifyFinding::NotIdentifiable { parameter, value, unit });
        } else if let ParameterId::Nominal(declared) = coordinate.id
            && declared.is_factor()
            && TWO_SIDED_95 * deviation > upper
        {
            findings.push(IdentifyFinding::HardlyIdentifiable {
                parameter,
                value,
                unit,
                half_width: TWO_SIDED_95 * deviation,
                tolerance: estimate.fitted.hypothesis.tolerance_of(declared),
            });
        }
    }
    findings.extend(tied(estimate, rate));
    findings
}

/// Name of a coordinate, its value and unit; `None` for the differences between guides and the
/// knots of a map.
fn reported(
    estimate: &Estimate,
    id: ParameterId,
    rate: f64,
) -> Option<(String, f64, &'static str)> {
    match id {
        ParameterId::Spread { .. } => None,
        ParameterId::Nominal(declared) => {
            let value = estimate.fitted.hypothesis.declared_value(declared, rate);
            Some((declared.name().to_owned(), value, declared.unit()))
        }
        ParameterId::Effect { effect, value } => {
            let part = &estimate.fitted.hypothesis.effects[effect];
            let parameter = part.descriptor.parameters.get(value)?;
            Some((
                format!("{}.{}", part.descriptor.name, parameter.name),
                part.values[value],
                parameter.unit,
            ))
        }
    }
}

/// Parameters of effects that the data tie to a parameter of something else: the closest tie of
/// each effect.
fn tied(estimate: &Estimate, rate: f64) -> Vec<IdentifyFinding> {
    let effect_of = |index: usize| match estimate.fitted.coordinates[index].id {
        ParameterId::Effect { effect, .. } => Some(effect),
        _ => None,
    };
    let mut pairs: Vec<(usize, usize)> = Vec::new();
    for effect in 0..estimate.fitted.hypothesis.effects.len() {
        let own = (0..estimate.fitted.coordinates.len())
            .filter(|index| effect_of(*index) == Some(effect));
        let closest = own
            .flat_map(|index| {
                (0..estimate.fitted.coordinates.len()).map(move |other| (index, other))
            })
            .filter(|(_, other)| effect_of(*other) != Some(effect))
            .filter(|(_, other)| {
                reported(estimate, estimate.fitted.coordinates[*other].id, rate).is_some()
            })
            .max_by(|a, b| {
                estimate.correlations[a.0][a.1]
                    .abs()
                    .total_cmp(&estimate.correlations[b.0][b.1].abs())
            });
        // Two effects may be tied to each other.
        if let Some((index, other)) = closest
            && !pairs.contains(&(other, index))
        {
            pairs.push((index, other));
        }
    }
    let finding = |(index, other): (usize, usize)| {
        let correlation = estimate.correlations[index][other];
        let name = |index: usize| {
            reported(estimate, estimate.fitted.coordinates[index].id, rate).map(|(name, ..)| name)
        };
        (correlation.abs() >= TIED).then_some(())?;
        let (parameter, other) = (name(index)?, name(other)?);
        Some(IdentifyFinding::Tied { parameter, other, correlation })
    };
    pairs.into_iter().filter_map(finding).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use friction_stage_core::model::{Coordinate, CurveSide, Jump};

    #[test]
    fn a_curve_is_told_by_its_height_and_its_center() {
        // A joint: down to -4 N at 28 mm, up to 5 N at 34 mm, on a level of 1 N.
        let mut values = vec![1.0; 101];
        (values[28], values[34]) = (-3.0, 6.0);
        let side = CurveSide::Carriage;
        let curve = Curve {
            coordinate: Coordinate::Position,
            side,
            from: 0.0,
            to: 0.1,
            values,
            jump: None,
        };
        let reported = of_curve(&curve);
        let (amplitude, center) = (&reported["amplitude"], &reported["center"]);
        assert!((amplitude.value - 5.0).abs() < 1e-12 && amplitude.unit == "N", "{amplitude:?}");
        let expected = (16.0 * 0.028 + 25.0 * 0.034) / 41.0;
        assert!((center.value - expected).abs() < 1e-12 && center.unit == "m", "{center:?}");
        assert!(!reported.contains_key("jump"), "{reported:?}");
    }

    /// Friction that is level and falls by a quarter at 3 s.
    #[test]
    fn a_jump_is_told_with_its_place_and_in_the_height_of_the_curve() {
        let (coordinate, side) = (Coordinate::Time, CurveSide::Friction);
        let jump = Some(Jump { at: 3.0, height: -0.25 });
        let reported = of_curve(&Curve {
            coordinate,
            side,
            from: 0.0,
            to: 10.0,
            values: vec![0.25; 11],
            jump,
        });
        let expected = [
            ("amplitude", 0.25, "1"),
            ("jump", -0.25, "1"),
            ("jump_at", 3.0, "s"),
            ("center", 1.5, "s"),
        ];
        for (name, value, unit) in expected {
            assert!(
                (reported[name].value - value).abs() < 1e-12 && reported[name].unit == unit,
                "{name}: {:?}",
                reported[name]
            );
        }
    }

    #[test]
    fn numbers_keep_the_digits_that_say_something() {
        assert_eq!(["0.024", "2.0000e-7", "0", "1.0000e6"], [0.024, 2e-7, 0.0, 1e6].map(readable));
        assert_eq!(
            ["410370", "450000", "39.9996", "-0.003"],
            [410370.135, 450000.0, 39.99961, -0.003].map(readable)
        );
        assert_eq!(in_digits(5.99987, Some([5.9985, 6.0012])), "5.9999");
        assert_eq!(in_digits(0.023998, Some([0.023996, 0.024])), "0.0239980");
        assert_eq!(in_digits(2.0004e-7, Some([1.99e-7, 2.01e-7])), "2.000e-7");
    }
}
