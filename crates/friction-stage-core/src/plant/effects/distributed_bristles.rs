//! Distributed bristles: each guide has several bristle elements in parallel, which slip one after
//! another.
//!
//! F = sum of a_i (c sigma0 z_i + sigma1 dz_i/dt) + sigma2 v, i = 1 to 4, where z_i slips at the
//! deflection l_i = b_i g(v) / (c a_i sigma0), in one of two forms:
//! - `gradual`: dz_i/dt = v - |v| z_i / l_i, as LuGre's bristle;
//! - `sudden` (Maxwell slip): dz_i/dt = v up to |z_i| = l_i, where it stays.
//!
//! a_i stiffness_share_i, b_i strength_share_i, of which the fourth element has what the others
//! leave (each kind sums to 1); c stiffness, the stiffness at the smallest motion over sigma0. A
//! share of 0 takes an element away. The same shares in every guide. Effective stiffness of a slow
//! loop of amplitude A: gradual: sum of b_i Fs tanh(c a_i sigma0 A / (b_i Fs)) / A, sudden: sum of
//! min(c a_i sigma0, b_i Fs / A): it falls over a wider range of A than one bristle's. Source:
//! parallel elements of a spring and a slider (W. Iwan, J. Appl. Mech. 33, 1966), of the level of
//! the Stribeck curve (generalized Maxwell slip: Al-Bender, Lampaert, Swevers, IEEE TAC 50(11),
//! 2005); gradual: with LuGre's bristles in their place. Sizes: assumed. Stored energy: that of the
//! bristles. Memory of loops within loops is exact with sudden slip; with gradual slip as good as
//! the elements are many: each forgets over its own break-away distance. Not modelled: shares that
//! differ between guides, elements of their own damping.

use nalgebra::{DMatrix, DVector};

use super::regression::{beyond_chance, break_away, sliding_loop, slow_loop};
use super::{
    Action, EffectDescriptor, EffectParameter, Multiplicity, RecordSpecific, Residual, Role,
    descriptor,
};
use crate::model::{Catalogue, EffectParameters, Guide, ModelError};
use crate::plant::guides::{BristleElements, BristleShare, MAX_ELEMENTS, Slip};

/// Names of the forms, in the order of their numbers in a slice of values.
const FORMS: [&str; 2] = ["gradual", "sudden"];

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "distributed_bristles",
    role: Role::Bristles,
    law: "up to four bristles in parallel per guide: stiffness c a_i sigma0, damping a_i sigma1, \
          level b_i g(v); they slip gradually (LuGre) or suddenly (Maxwell slip)",
    source: "Iwan 1966; Al-Bender, Lampaert, Swevers 2005; gradual: LuGre elements",
    telltale: "stiffer at the smallest loops and softer at larger ones than one bristle, loops \
               within loops",
    parameters: &[
        EffectParameter::optional(
            "stiffness_share_1",
            "1",
            "part of the stiffness in element 1",
            (0.0, 1.0),
            0.1,
            1.0,
        ),
        EffectParameter::optional(
            "strength_share_1",
            "1",
            "part of g in element 1",
            (0.0, 1.0),
            0.1,
            1.0,
        ),
        EffectParameter::optional(
            "stiffness_share_2",
            "1",
            "part of the stiffness in element 2",
            (0.0, 1.0),
            0.1,
            0.0,
        ),
        EffectParameter::optional(
            "strength_share_2",
            "1",
            "part of g in element 2",
            (0.0, 1.0),
            0.1,
            0.0,
        ),
        EffectParameter::optional(
            "stiffness_share_3",
            "1",
            "part of the stiffness in element 3",
            (0.0, 1.0),
            0.1,
            0.0,
        ),
        EffectParameter::optional(
            "strength_share_3",
            "1",
            "part of g in element 3",
            (0.0, 1.0),
            0.1,
            0.0,
        ),
        EffectParameter::optional(
            "stiffness",
            "1",
            "stiffness of all elements over sigma0",
            (0.2, 5.0),
            0.5,
            1.0,
        ),
        EffectParameter::choice("form", "elements that slip gradually or suddenly", &FORMS),
    ],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[0.5, 0.2, 0.3, 0.3, 0.2, 0.5, 1.0, 0.0],
    check,
    free: |_, index| index != FORM,
    build: |values| Action::Bristles(elements(values)),
    proposal: Some(propose),
    starts: |values, _| {
        descriptor::every_form(values, FORM, 2).into_iter().chain([evenly_spread(values)]).collect()
    },
    curve: None,
};

impl EffectParameters {
    /// Bristles in parallel, by the parts of stiffness and strength in elements 1 to 3; what they
    /// leave is element 4.
    pub fn parallel_bristles(shares: [(f64, f64); 3]) -> EffectParameters {
        let [(a1, b1), (a2, b2), (a3, b3)] = shares;
        let values = [
            ("stiffness_share_1", a1),
            ("strength_share_1", b1),
            ("stiffness_share_2", a2),
            ("strength_share_2", b2),
            ("stiffness_share_3", a3),
            ("strength_share_3", b3),
        ];
        EffectParameters::new(DESCRIPTOR.name, values)
    }
}

impl Catalogue {
    /// A guide with its parallel bristles: its parameters and the effect that belongs to them.
    /// `None` where the catalogue has no such guide or none for it.
    pub fn distributed_bristles(&self, name: &str) -> Option<(Guide, EffectParameters)> {
        let entry = self.entry(name)?;
        let (of, guide) = (entry.distributed_bristles.as_ref()?, entry.distributed_guide()?);
        let shares = [
            ("stiffness_share_1", Some(&of.stiffness_share_1)),
            ("strength_share_1", Some(&of.strength_share_1)),
            ("stiffness_share_2", Some(&of.stiffness_share_2)),
            ("strength_share_2", Some(&of.strength_share_2)),
            ("stiffness_share_3", of.stiffness_share_3.as_ref()),
            ("strength_share_3", of.strength_share_3.as_ref()),
        ];
        let values = shares.into_iter().filter_map(|(key, quantity)| Some((key, quantity?.value)));
        let effect = EffectParameters::new(DESCRIPTOR.name, values);
        Some((guide, effect))
    }
}

/// Where these values stand.
const STIFFNESS: usize = 6;
const FORM: usize = 7;

/// Sums of given shares may exceed 1 by this: decimals in a file.
const ROUNDING: f64 = 1e-9;

fn check(values: &[f64]) -> Result<(), ModelError> {
    for (kind, sum) in [
        ("stiffness", values[0] + values[2] + values[4]),
        ("strength", values[1] + values[3] + values[5]),
    ] {
        if sum > 1.0 + ROUNDING {
            let key = format!(
                "effects.distributed_bristles: {kind}_share_1 + {kind}_share_2 + {kind}_share_3"
            );
            return Err(ModelError::Value {
                key,
                value: sum,
                limit: "not be above 1: the fourth element has the rest".to_owned(),
            });
        }
    }
    Ok(())
}

/// As stiff at the smallest motion, with elements of one stiffness that slip suddenly, one after
/// another at even distances. With sudden slips the squares are rugged: from few widths a fit does
/// not come to these by itself.
fn evenly_spread(values: &[f64]) -> Vec<f64> {
    vec![0.25, 0.1, 0.25, 0.2, 0.25, 0.3, values[STIFFNESS], 1.0]
}

/// Shares of all elements. Where a search goes beyond a sum of 1, they are scaled back to it.
fn shares(values: &[f64]) -> [BristleShare; MAX_ELEMENTS] {
    let complete = |given: [f64; MAX_ELEMENTS - 1]| -> [f64; MAX_ELEMENTS] {
        let sum: f64 = given.iter().sum();
        let over = sum.max(1.0);
        std::array::from_fn(|element| {
            given.get(element).map_or((1.0 - sum / over).max(0.0), |share| share / over)
        })
    };
    let stiffness = complete([values[0], values[2], values[4]]);
    let strength = complete([values[1], values[3], values[5]]);
    std::array::from_fn(|element| BristleShare {
        stiffness: values[6] * stiffness[element],
        damping: stiffness[element],
        strength: strength[element],
    })
}

fn elements(values: &[f64]) -> BristleElements {
    BristleElements {
        shares: shares(values),
        slip: if values[FORM] < 0.5 { Slip::Gradual } else { Slip::Sudden },
    }
}

/// Widths that are tried on either side of the single bristle's, each a factor of 1.6 apart.
const WIDTHS: i32 = 8;
const WIDTH_STEP: f64 = 1.6;

/// A set of elements that a proposal weighs.
struct Combination {
    /// What it leaves of the residual, N^2.
    rest: f64,
    /// Form of the law.
    form: usize,
    /// Indices of the widths, and strengths, N.
    widths: Vec<usize>,
    strengths: Vec<f64>,
}

/// Elements that turn over two to four different distances, from what they would add to one
/// bristle.
///
/// The modelled friction gives the distance w of the single bristle, whose slow loops are dh/dx =
/// (sign(v) - h) / w. The residual is then F0 h_w less the sum of B_i h_wi, h of the form that is
/// tried: b_i is B_i, a_i is B_i / w_i, each over its sum, and c the sum of B_i / w_i over F0 / w.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let count = residual.force.len();
    if count < 100 {
        return None;
    }
    let (width, strength) = break_away(residual)?;
    let widths: Vec<f64> = (-WIDTHS..=WIDTHS).map(|index| width * WIDTH_STEP.powi(index)).collect();
    let single = slow_loop(residual, width);
    let target: Vec<f64> = single
        .iter()
        .zip(residual.force)
        .map(|(column, force)| strength * column - force)
        .collect();
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let target_square = dot(&target, &target);
    let total = dot(residual.force, residual.force);
    let mut best: [Option<Combination>; MAX_ELEMENTS - 1] = [None, None, None];
    let mut tried = 0;
    for (form, turning) in [slow_loop, sliding_loop].into_iter().enumerate() {
        let columns: Vec<Vec<f64>> = widths.iter().map(|width| turning(residual, *width)).collect();
        let normal =
            DMatrix::from_fn(columns.len(), columns.len(), |i, j| dot(&columns[i], &columns[j]));
        let right = DVector::from_fn(columns.len(), |i, _| dot(&columns[i], &target));
        // `None` unless all strengths are positive.
        let fit = |widths: Vec<usize>| -> Option<Combination> {
            let left =
                DMatrix::from_fn(widths.len(), widths.len(), |i, j| normal[(widths[i], widths[j])]);
            let side = DVector::from_fn(widths.len(), |i, _| right[widths[i]]);
            let strengths = left.cholesky()?.solve(&side);
            let rest = target_square - strengths.dot(&side);
            let positive = strengths.iter().all(|strength| *strength > 0.0);
            positive.then(|| Combination {
                rest,
                form,
                widths,
                strengths: strengths.as_slice().to_vec(),
            })
        };
        for i in 0..widths.len() {
            for j in i + 1..widths.len() {
                let triples = (j + 1..widths.len()).map(|k| vec![i, j, k]);
                let quadruples = (j + 1..widths.len())
                    .flat_map(|k| (k + 1..widths.len()).map(move |l| vec![i, j, k, l]));
                for set in std::iter::once(vec![i, j]).chain(triples).chain(quadruples) {
                    tried += 1;
                    let place = &mut best[set.len() - 2];
                    let found = fit(set);
                    if found.as_ref().is_some_and(|found| {
                        place.as_ref().is_none_or(|best| found.rest < best.rest)
                    }) {
                        *place = found;
                    }
                }
            }
        }
    }
    // Two numbers more per element than one bristle has.
    let mut reached = total;
    let mut chosen = None;
    for combination in best.into_iter().flatten() {
        if beyond_chance(reached - combination.rest, combination.rest, count, 2, tried) {
            reached = combination.rest;
            chosen = Some(combination);
        }
    }
    let Combination { form, widths: set, strengths, .. } = chosen?;
    let strength_sum: f64 = strengths.iter().sum();
    let stiffnesses: Vec<f64> =
        strengths.iter().zip(&set).map(|(strength, index)| strength / widths[*index]).collect();
    let stiffness_sum: f64 = stiffnesses.iter().sum();
    let share = |values: &[f64], element: usize, sum: f64| {
        values.get(element).map_or(0.0, |value| value / sum)
    };
    // Two elements: the second has what the first leaves, and is the fourth.
    let given = set.len() - 1;
    let mut values: Vec<f64> = (0..MAX_ELEMENTS - 1)
        .flat_map(|element| match element < given {
            true => [
                share(&stiffnesses, element, stiffness_sum),
                share(&strengths, element, strength_sum),
            ],
            false => [0.0, 0.0],
        })
        .collect();
    values.push((stiffness_sum * width / strength).clamp(0.2, 5.0));
    values.push(form as f64);
    Some(values)
}

#[cfg(test)]
mod tests {
    use super::super::Effects;
    use super::super::regression::record::{Record, assert_silent_on_noise};
    use super::*;
    use crate::model::StageModel;
    use crate::plant::Body;
    use crate::plant::guides::{FrictionScale, GuideBank};

    const SHARES: [f64; 8] = [0.6, 0.1, 0.3, 0.3, 0.0, 0.0, 1.2, 0.0];

    fn guide() -> Guide {
        Catalogue::builtin().guide("guide_1").unwrap()
    }

    /// Drives a bank to and fro between positions in steps of 1/400 of the way at 0.1 mm/s;
    /// friction at the end of each way, N.
    fn visit(bank: &mut GuideBank, from: f64, places: &[f64]) -> Vec<f64> {
        let mut position = from;
        places
            .iter()
            .map(|place| {
                let velocity = 1e-4f64.copysign(place - position);
                let step = (place - position) / velocity / 400.0;
                (0..400).for_each(|_| _ = bank.drive(velocity, step, &FrictionScale::ONE));
                position = *place;
                guide().stiffness * bank.bristles()[0]
            })
            .collect()
    }

    #[test]
    fn effective_stiffness_is_the_sum_of_the_elements() {
        let guide = guide();
        let amplitudes = [1e-7, 1e-6, 10e-6, 40e-6];
        for (slip, amplitude) in
            [Slip::Gradual, Slip::Sudden].into_iter().flat_map(|slip| amplitudes.map(|a| (slip, a)))
        {
            let elements = BristleElements { slip, ..elements(&SHARES) };
            let mut bank = GuideBank::with_elements(std::slice::from_ref(&guide), &elements);
            let ways: Vec<f64> =
                (0..60).map(|way| if way % 2 == 0 { amplitude } else { -amplitude }).collect();
            let forces = visit(&mut bank, 0.0, &ways);
            let found = (forces[58] - forces[59]) / (2.0 * amplitude);
            let expected: f64 = shares(&SHARES)
                .iter()
                .filter(|share| share.strength > 0.0)
                .map(|share| {
                    let strength = share.strength * guide.static_force;
                    let elastic = share.stiffness * guide.stiffness * amplitude;
                    match slip {
                        Slip::Gradual => strength * (elastic / strength).tanh() / amplitude,
                        Slip::Sudden => elastic.min(strength) / amplitude,
                    }
                })
                .sum();
            // At 2 % of the Stribeck velocity the level is Fs to within 4e-4.
            assert!(
                (found / expected - 1.0).abs() < 1e-3,
                "{amplitude} m: {found} N/m, expected {expected} N/m"
            );
        }
    }

    /// Force by which a branch is missed after a loop within it, as a part of the force that the
    /// loop turns.
    fn missed(mut bank: GuideBank) -> f64 {
        // A long way, back, then a branch on which a small loop closes.
        let mut straight = bank.clone();
        let before = visit(&mut bank, 0.0, &[-200e-6, 20e-6, 12e-6, 20e-6, 60e-6]);
        let without = visit(&mut straight, 0.0, &[-200e-6, 20e-6]);
        assert_eq!(before[1], without[1]);
        (before[3] - before[1]).abs() / (before[1] - before[2])
    }

    #[test]
    fn after_an_inner_loop_closes_the_force_returns_onto_the_outer_branch() {
        // Elements that turn over 0.05, 23 and 1000 times the single bristle's distance: the loop
        // turns the first and hardly moves the others.
        let share = |stiffness, strength| BristleShare { stiffness, damping: stiffness, strength };
        let shares =
            [share(0.98, 0.05), share(0.0195, 0.45), share(0.0005, 0.5), BristleShare::default()];
        let apart = BristleElements { shares, slip: Slip::Gradual };
        let (single, distributed) = (
            missed(GuideBank::new(&[guide()])),
            missed(GuideBank::with_elements(&[guide()], &apart)),
        );
        assert!(single > 0.1, "one bristle forgets: {single}");
        assert!(distributed < 0.1 * single, "{distributed} against {single} of one bristle");
        let sudden = missed(GuideBank::with_elements(
            &[guide()],
            &BristleElements { slip: Slip::Sudden, ..apart },
        ));
        assert!(sudden < 1e-9, "those that slip suddenly forget nothing: {sudden}");
    }

    /// Loops within loops lose energy; what is stored never exceeds the work that was put in.
    #[test]
    fn a_driven_bank_stores_less_than_the_work_done() {
        for slip in [Slip::Gradual, Slip::Sudden] {
            let mut bank = GuideBank::with_elements(
                &[guide()],
                &BristleElements { slip, ..elements(&SHARES) },
            );
            let mut work = 0.0;
            for k in 0..20_000 {
                let velocity =
                    1e-3 * ((0.003 * f64::from(k)).sin() + 0.7 * (0.0071 * f64::from(k)).sin());
                work += bank.drive(velocity, 1e-4, &FrictionScale::ONE) * velocity * 1e-4;
                assert!(
                    bank.stored_energy() <= work + 1e-12,
                    "{k}: {} J of {work} J",
                    bank.stored_energy()
                );
            }
            assert!(work > 0.0);
        }
    }

    /// The carriage on sudden elements, against steps ten times as short.
    #[test]
    fn a_stage_on_sudden_elements_moves_alike_at_a_shorter_step() {
        let values = [("stiffness_share_1", 0.6), ("strength_share_1", 0.1), ("form", 1.0)];
        let effects = vec![EffectParameters::new("distributed_bristles", values)];
        let model = StageModel { effects, ..StageModel::default() };
        let [coarse, fine] = [(25e-6, 1), (2.5e-6, 10)].map(|(step, steps)| {
            let mut body = Body::new(&model, step).unwrap();
            let mut positions = Vec::new();
            for k in 0..4000 {
                body.advance(70.0 * (0.01 * f64::from(k)).sin(), steps);
                positions.push(body.position());
            }
            positions
        });
        let largest = fine.iter().fold(0.0f64, |largest, x| largest.max(x.abs()));
        let off = coarse.iter().zip(&fine).fold(0.0f64, |off, (a, b)| off.max((a - b).abs()));
        assert!(largest > 1e-5 && off < 1e-4 * largest, "{off} m of {largest} m");
    }

    #[test]
    fn a_stage_with_one_share_moves_as_the_stage_without() {
        let effects = vec![EffectParameters::new("distributed_bristles", [])];
        let [plain, single] = [Vec::new(), effects].map(|effects| {
            let mut body =
                Body::new(&StageModel { effects, ..StageModel::default() }, 25e-6).unwrap();
            body.advance(60.0, 4000);
            body.advance(-60.0, 4000);
            body.position()
        });
        assert!((plain / single - 1.0).abs() < 1e-9 && plain.abs() > 1e-6, "{plain} {single}");
    }

    #[test]
    fn shares_beyond_one_are_refused_with_their_sum() {
        let effect = EffectParameters::new(
            "distributed_bristles",
            [("stiffness_share_1", 0.7), ("stiffness_share_2", 0.5)],
        );
        let message = Effects::new(&[effect]).unwrap_err().to_string();
        assert!(
            message.contains("stiffness_share_1")
                && message.contains("1.2")
                && message.contains("above 1"),
            "{message}"
        );
    }

    /// Loops from 2 to 300 µm within each other: the shares found give the effective stiffness at
    /// every amplitude.
    #[test]
    fn proposal_gives_the_effective_stiffness_under_noise_and_nothing_in_noise() {
        let mut position = Vec::new();
        for amplitude in [2e-6, 8e-6, 30e-6, 100e-6, 300e-6] {
            position.extend(
                (0..4000)
                    .map(|k| amplitude * (std::f64::consts::TAU * f64::from(k) / 2000.0).sin()),
            );
        }
        let truth = SHARES;
        let record =
            Record::along(position.clone()).with_effect(&DESCRIPTOR, &truth).with_noise(0.3, 8);
        let found = propose(&record.residual()).unwrap();
        let guide = guide();
        let stiffness = |values: &[f64], amplitude: f64| -> f64 {
            let element = |share: &BristleShare| {
                let strength = share.strength * guide.static_force;
                if strength > 0.0 {
                    strength * (share.stiffness * guide.stiffness * amplitude / strength).tanh()
                        / amplitude
                } else {
                    0.0
                }
            };
            shares(values).iter().map(element).sum()
        };
        for amplitude in [3e-6, 10e-6, 40e-6] {
            let ratio = stiffness(&found, amplitude) / stiffness(&truth, amplitude);
            assert!((ratio - 1.0).abs() < 0.15, "{amplitude} m: {ratio} of the truth, {found:?}");
        }
        assert!(propose(&Record::along(position).with_noise(0.3, 8).residual()).is_none());
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
