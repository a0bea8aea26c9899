//! Ripples over the position whose phase each record has for itself: balls that slip.
//!
//! Guides whose phases walk are together one ripple, F = S(s) sin(2 pi x / p) + C(s) cos(2 pi x /
//! p), of which S and C change slowly with the distance travelled s. No law tells them. They are
//! linear here between knots a piece apart, and in each record those that leave least of the
//! missing force (variable projection: Golub, Pereyra, SIAM Journal on Numerical Analysis 10,
//! 1973): what is fitted of the law is its period. That there is such a ripple is judged along the
//! way: where the carriage rests, and in a record with few periods, it could be any force.

use std::f64::consts::TAU;
use std::ops::Range;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix2, Vector2};
use rayon::prelude::*;

use friction_stage_core::model::ModelError;
use friction_stage_core::plant::effects::{ALL, ParameterKind, RecordSpecific, golden_maximum};
use friction_stage_core::plant::{EffectDescriptor, EffectParameter, SlippingRipple};

use crate::hypothesis::Part;
use crate::record::measured::Measured;

/// Part of the largest curvature that is added to each, far above rounding and far below what a
/// record tells: knots that the record says nothing of stay at 0.
const RIDGE: f64 = 1e-9;
/// Steps of a search for a period per turn of the phase over the travel.
const STEPS_PER_TURN: f64 = 4.0;
/// Most steps of it.
const MOST_STEPS: f64 = 2000.0;
/// Fewest periods within the travel. Assumed: fewer are no ripple but a curve.
const LEAST_PERIODS: f64 = 8.0;
/// Fewest periods in a piece: a narrow band. Assumed.
const PERIODS_IN_A_PIECE: f64 = 20.0;
/// Most pieces of a record, assumed: longer ones have longer pieces, so that time and memory stay
/// linear.
const MOST_PIECES: f64 = 100.0;
/// Rows that are farther apart than this have a hole between them, s. Assumed.
const HOLE: f64 = 0.25;

/// What the ripples of a hypothesis can be on a record.
#[derive(Clone, Debug)]
pub(crate) struct Slipping {
    pub ripples: Vec<SlippingRipple>,
    /// One for each ripple; `None` for one that the record does not show.
    waves: Vec<Option<Waves>>,
    factors: Cholesky<f64, Dyn>,
}

/// The way of a record at its rows.
#[derive(Clone, Debug)]
struct Way {
    /// Distance travelled, m.
    travelled: Vec<f64>,
    /// Rows without a hole between them: after one the phase is not known.
    runs: Vec<Range<usize>>,
    /// Distance from the row before, m: what a row counts where a ripple is looked for along the
    /// way. Where the carriage rests any force is one.
    weights: Vec<f64>,
    /// Travel, m.
    range: f64,
}

/// One ripple at the rows of a record.
#[derive(Clone, Debug)]
struct Waves {
    sine: Vec<f64>,
    cosine: Vec<f64>,
    /// Of each row the knot before it, and how far it is on the way to the next.
    places: Vec<(usize, f64)>,
    /// Column of the first knot: two for each knot.
    first: usize,
    knots: usize,
}

/// Distance travelled at each position, m.
fn travelled(position: &[f64]) -> Vec<f64> {
    let mut travelled = vec![0.0; position.len()];
    for k in 1..position.len() {
        travelled[k] = travelled[k - 1] + (position[k] - position[k - 1]).abs();
    }
    travelled
}

impl Way {
    fn new(measured: &Measured) -> Way {
        let travelled = measured.at_rows(&travelled(&measured.position));
        let holes =
            measured.rows.windows(2).map(|two| (two[1] - two[0]) as f64 > HOLE * measured.rate);
        let starts: Vec<usize> =
            holes.enumerate().filter(|(_, hole)| *hole).map(|(row, _)| row + 1).collect();
        let ends = starts.iter().copied().chain([travelled.len()]);
        let runs: Vec<Range<usize>> =
            [0].into_iter().chain(starts.iter().copied()).zip(ends).map(|(a, b)| a..b).collect();
        let mut weights = vec![0.0; travelled.len()];
        for run in &runs {
            for row in run.clone().skip(1) {
                weights[row] = travelled[row] - travelled[row - 1];
            }
        }
        let (lowest, highest) =
            friction_stage_core::numerics::range(&measured.at_rows(&measured.position));
        Way { travelled, runs, weights, range: highest - lowest }
    }

    fn shows(&self, ripple: SlippingRipple) -> bool {
        self.range >= LEAST_PERIODS * ripple.period
    }
}

impl Waves {
    /// The same number of knots whatever the period: a fit moves that.
    fn new(
        ripple: SlippingRipple,
        sine: Vec<f64>,
        cosine: Vec<f64>,
        way: &Way,
        first: usize,
    ) -> Waves {
        let all = way
            .travelled
            .last()
            .zip(way.travelled.first())
            .map_or(0.0, |(last, first)| last - first);
        let piece = ripple.piece.max(all / MOST_PIECES);
        let (mut places, mut knots) = (Vec::with_capacity(way.travelled.len()), 0);
        for run in &way.runs {
            let of_run = &way.travelled[run.clone()];
            let (Some(start), Some(end)) = (of_run.first(), of_run.last()) else { continue };
            let pieces = ((end - start) / piece).round();
            for travelled in of_run {
                let along =
                    if end > start { (travelled - start) / (end - start) * pieces } else { 0.0 };
                let knot = along.floor().min((pieces - 1.0).max(0.0));
                places.push((knots + knot as usize, along - knot));
            }
            knots += pieces as usize + 1;
        }
        Waves { sine, cosine, places, first, knots }
    }

    /// The columns that are not 0 in a row, with their entries.
    fn row(&self, row: usize) -> [(usize, f64); 4] {
        let (knot, part) = self.places[row];
        let (sine, cosine, at) = (self.sine[row], self.cosine[row], self.first + 2 * knot);
        // Where there is one knot alone the second pair is 0, and stands on the first.
        let next = if part > 0.0 { at + 2 } else { at };
        [
            (at, (1.0 - part) * sine),
            (at + 1, (1.0 - part) * cosine),
            (next, part * sine),
            (next + 1, part * cosine),
        ]
    }
}

impl Slipping {
    /// Ripples of a hypothesis, filtered as the forces are; `None` without any that goes through
    /// enough periods in this record.
    pub fn new(ripples: Vec<SlippingRipple>, measured: &Measured) -> Option<Slipping> {
        if ripples.is_empty() {
            return None;
        }
        let way = Way::new(measured);
        let wave = |ripple: &SlippingRipple| {
            let turn = |of: fn(f64) -> f64| -> Vec<f64> {
                let values: Vec<f64> =
                    measured.position.iter().map(|x| of(TAU * x / ripple.period)).collect();
                measured.filtered(&values)
            };
            way.shows(*ripple).then(|| (turn(f64::sin), turn(f64::cos)))
        };
        let waves: Vec<_> = ripples.iter().map(wave).collect();
        let mut columns = 0;
        let mut all: Vec<Option<Waves>> = Vec::new();
        for (ripple, waves) in ripples.iter().zip(waves) {
            let waves =
                waves.map(|(sine, cosine)| Waves::new(*ripple, sine, cosine, &way, columns));
            columns += waves.as_ref().map_or(0, |waves| 2 * waves.knots);
            all.push(waves);
        }
        if columns == 0 {
            return None;
        }
        // Of a symmetric matrix the lower triangle is enough.
        let mut normal = DMatrix::zeros(columns, columns);
        for row in 0..way.travelled.len() {
            for (index, waves) in all.iter().enumerate() {
                for (column, entry) in waves.iter().flat_map(|waves| waves.row(row)) {
                    for (before, value) in
                        all[..=index].iter().flatten().flat_map(|waves| waves.row(row))
                    {
                        normal[(column, before)] += entry * value;
                    }
                }
            }
        }
        let ridge = RIDGE * normal.diagonal().max() + f64::MIN_POSITIVE;
        (0..columns).for_each(|column| normal[(column, column)] += ridge);
        Some(Slipping { ripples, waves: all, factors: normal.cholesky()? })
    }

    /// Numbers that a record has for itself.
    pub fn columns(&self) -> usize {
        self.waves.iter().flatten().map(|waves| 2 * waves.knots).sum()
    }

    /// Knots of sine and cosine, N, that leave least of a force at the rows.
    fn knots(&self, force: &[f64]) -> DVector<f64> {
        let mut right = DVector::zeros(self.columns());
        for waves in self.waves.iter().flatten() {
            for (row, force) in force.iter().enumerate() {
                waves.row(row).iter().for_each(|(column, entry)| right[*column] += entry * force);
            }
        }
        self.factors.solve(&right)
    }

    /// Takes out of a force at the rows, N, what the ripples can be of it.
    pub fn take_from(&self, force: &mut [f64]) {
        let knots = self.knots(force);
        for waves in self.waves.iter().flatten() {
            for (row, force) in force.iter_mut().enumerate() {
                *force -= waves
                    .row(row)
                    .iter()
                    .map(|(column, entry)| knots[*column] * entry)
                    .sum::<f64>();
            }
        }
    }

    /// Root of the mean of S^2 + C^2, for each ripple that the record shows, N, as it fits a force
    /// best.
    pub fn amplitudes(&self, force: &[f64]) -> Vec<Option<f64>> {
        let knots = self.knots(force);
        let amplitude = |waves: &Waves| {
            let squares = waves.places.iter().map(|(knot, part)| {
                let at = waves.first + 2 * knot;
                let next = if *part > 0.0 { at + 2 } else { at };
                let along =
                    |offset: usize| (1.0 - part) * knots[at + offset] + part * knots[next + offset];
                along(0).powi(2) + along(1).powi(2)
            });
            (squares.sum::<f64>() / waves.places.len() as f64).sqrt()
        };
        self.waves.iter().map(|waves| waves.as_ref().map(amplitude)).collect()
    }
}

/// Share of the squares of a force at the rows of a record that balls which slip can take out along
/// the way.
pub(crate) fn share_along_the_way(force: &[f64], measured: &Measured, part: &Part) -> f64 {
    let Some(ripple) = part.slipping_ripple() else { return 0.0 };
    let way = Way::new(measured);
    if !way.shows(ripple) {
        return 0.0;
    }
    left_along_the_way(force, &measured.at_rows(&measured.position), &way, ripple)
        .map_or(0.0, |left| 1.0 - left)
}

/// Share of the squares of a force that a ripple leaves along the way. Not filtered as the force
/// is, which moves no peak. As [`Slipping`] has it for one ripple, whose knots know no others than
/// their neighbours: eliminated one by one (Golub, Van Loan, "Matrix Computations", ch. 4.5), each
/// takes its part of the squares.
fn left_along_the_way(
    force: &[f64],
    position: &[f64],
    way: &Way,
    ripple: SlippingRipple,
) -> Option<f64> {
    let (sine, cosine) = position.iter().map(|x| (TAU * x / ripple.period).sin_cos()).unzip();
    let waves = Waves::new(ripple, sine, cosine, way, 0);
    // Of each knot: what it has with itself, with the next one, and with the force.
    let mut own = vec![Matrix2::zeros(); waves.knots];
    let mut shared = own.clone();
    let mut right = vec![Vector2::zeros(); waves.knots];
    let mut squares = 0.0;
    for (row, (force, weight)) in force.iter().zip(&way.weights).enumerate() {
        let (knot, part) = waves.places[row];
        let wave = Vector2::new(waves.sine[row], waves.cosine[row]);
        let product: Matrix2<f64> = wave * wave.transpose() * *weight;
        own[knot] += product * (1.0 - part).powi(2);
        right[knot] += wave * (weight * force * (1.0 - part));
        if part > 0.0 {
            shared[knot] += product * ((1.0 - part) * part);
            own[knot + 1] += product * part.powi(2);
            right[knot + 1] += wave * (weight * force * part);
        }
        squares += weight * force * force;
    }
    let most = own.iter().map(|own| own[(0, 0)].max(own[(1, 1)])).reduce(f64::max)?;
    let ridge = Matrix2::identity() * (RIDGE * most + f64::MIN_POSITIVE);
    let mut taken = 0.0;
    for knot in 0..waves.knots {
        let inverse = (own[knot] + ridge).try_inverse()?;
        let best = inverse * right[knot];
        taken += right[knot].dot(&best);
        if knot + 1 < waves.knots {
            let shared = shared[knot];
            right[knot + 1] -= shared.transpose() * best;
            own[knot + 1] -= shared.transpose() * inverse * shared;
        }
    }
    Some(1.0 - taken / squares)
}

/// Whether a law may leave amplitude and phase of its ripple to each record.
pub(crate) fn may_slip(descriptor: &EffectDescriptor) -> bool {
    matches!(descriptor.record_specific, RecordSpecific::Ripple(_))
}

/// The law of balls that slip, with the place of its period; `None` where the plant has none.
fn law_of_balls() -> Option<(&'static EffectDescriptor, usize)> {
    let descriptor = ALL.iter().copied().find(|descriptor| may_slip(descriptor))?;
    Some((descriptor, descriptor.place_of(ParameterKind::Period)?))
}

/// Balls of a ripple of this period, m, whose phase walks so, rad/sqrt(m).
fn balls(
    descriptor: &'static EffectDescriptor,
    period: f64,
    slip: f64,
) -> Result<Part, ModelError> {
    let value = |parameter: &EffectParameter| match parameter.kind {
        ParameterKind::Amplitude => 1.0,
        ParameterKind::Period => period,
        ParameterKind::PhaseWalk => slip,
        _ => parameter.default.unwrap_or(0.0),
    };
    let values: Vec<f64> = descriptor.parameters.iter().map(value).collect();
    descriptor.check_values(&values)?;
    Ok(Part { descriptor, values })
}

/// The balls whose phase walks so, rad/sqrt(m), that take most out of a force at the rows of a
/// record, N, along the way; `None` where the travel is too short.
pub(crate) fn strongest(
    force: &[f64],
    measured: &Measured,
    slip: f64,
) -> Result<Option<Part>, ModelError> {
    let Some((law, period)) = law_of_balls() else { return Ok(None) };
    let (shortest, longest) = law.parameters[period].bounds;
    let Some(ripple) = balls(law, shortest, slip)?.slipping_ripple() else { return Ok(None) };
    let longest = longest.min(ripple.piece / PERIODS_IN_A_PIECE);
    let (way, position) = (Way::new(measured), measured.at_rows(&measured.position));
    let (fewest, most) = ((way.range / longest).max(LEAST_PERIODS), way.range / shortest);
    if most.is_nan() || most <= fewest {
        return Ok(None);
    }
    let explained = |turns: f64| {
        let ripple = SlippingRipple { period: way.range / turns, ..ripple };
        left_along_the_way(force, &position, &way, ripple).map_or(f64::NEG_INFINITY, |left| -left)
    };
    let steps = ((most - fewest) * STEPS_PER_TURN).ceil().clamp(1.0, MOST_STEPS);
    let turns = |step: f64| fewest + (most - fewest) * step / steps;
    let all: Vec<f64> =
        (0..=steps as usize).into_par_iter().map(|step| explained(turns(step as f64))).collect();
    let Some(best) = (0..all.len()).max_by(|a, b| all[*a].total_cmp(&all[*b])) else {
        return Ok(None);
    };
    let (from, to) = ((best as f64 - 1.0).max(0.0), (best as f64 + 1.0).min(steps));
    let step = golden_maximum(from, to, |step| explained(turns(step)));
    Ok(Some(balls(law, (way.range / turns(step)).clamp(shortest, longest), slip)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_records::record;
    use friction_stage_core::plant::Side;

    /// Force of a ripple whose phase turns by `turn` rad per metre travelled, N, at the rows,
    /// beside a slow one.
    fn force(measured: &Measured, period: f64, turn: f64) -> (Vec<f64>, Vec<f64>) {
        let of = |(x, s): (&f64, f64)| 0.4 * (TAU * x / period + 0.8 + turn * s).sin();
        let ripple: Vec<f64> =
            measured.position.iter().zip(travelled(&measured.position)).map(of).collect();
        let other: Vec<f64> = measured.position.iter().map(|x| 2.0 * x + 0.1).collect();
        (measured.filtered(&ripple), measured.filtered(&other))
    }

    fn rms(values: &[f64]) -> f64 {
        (values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64).sqrt()
    }

    #[test]
    fn a_ripple_whose_phase_turns_is_taken_out_and_what_is_beside_it_stays() {
        let measured = record();
        let (ripple, other) = force(&measured, 4e-3, 2.0);
        let mut left: Vec<f64> =
            ripple.iter().zip(&other).map(|(ripple, other)| ripple + other).collect();
        let slipping =
            Slipping::new(vec![SlippingRipple { period: 4e-3, piece: 0.1 }], &measured).unwrap();
        // 0.4 m are travelled: four pieces.
        assert_eq!(slipping.columns(), 10);
        let amplitude = slipping.amplitudes(&ripple)[0].unwrap();
        assert!((amplitude / 0.4 - 1.0).abs() < 0.02, "{amplitude}");
        slipping.take_from(&mut left);
        let off: Vec<f64> = left.iter().zip(&other).map(|(left, other)| left - other).collect();
        // Where the carriage turns, any force is a ripple.
        assert!(rms(&off) < 0.2 * rms(&other), "{} of {}", rms(&off), rms(&other));
        let rest = |piece: f64| {
            let mut left = ripple.clone();
            Slipping::new(vec![SlippingRipple { period: 4e-3, piece }], &measured)
                .unwrap()
                .take_from(&mut left);
            rms(&left) / rms(&ripple)
        };
        // One phase for the whole record does not do.
        assert!(rest(0.1) < 0.01 && rest(10.0) > 0.15, "{} {}", rest(0.1), rest(10.0));
    }

    #[test]
    fn the_period_of_a_ripple_is_found_whose_phase_turns() {
        let measured = record();
        let (ripple, _) = force(&measured, 4e-3, 2.0);
        // Pieces of 0.11 m.
        let found = strongest(&ripple, &measured, 1.5).unwrap().unwrap();
        let period = found.slipping_ripple().unwrap().period;
        assert!((period / 4e-3 - 1.0).abs() < 3e-3, "{period}");
        assert!(share_along_the_way(&ripple, &measured, &found) > 0.95);
    }

    /// Against least squares of all knots at once, by orthogonal triangles.
    #[test]
    fn knots_eliminated_one_by_one_leave_what_all_at_once_do() {
        let measured = record();
        let (ripple, other) = force(&measured, 4e-3, 2.0);
        let force: Vec<f64> =
            ripple.iter().zip(&other).map(|(ripple, other)| ripple + other).collect();
        let (way, position) = (Way::new(&measured), measured.at_rows(&measured.position));
        for (period, piece) in [(4e-3, 0.1), (3.7e-3, 0.03), (6e-3, 10.0)] {
            let ripple = SlippingRipple { period, piece };
            let (sine, cosine) = position.iter().map(|x| (TAU * x / period).sin_cos()).unzip();
            let waves = Waves::new(ripple, sine, cosine, &way, 0);
            let mut columns = DMatrix::zeros(force.len(), 2 * waves.knots);
            let mut right = DVector::zeros(force.len());
            for (row, weight) in way.weights.iter().map(|weight| weight.sqrt()).enumerate() {
                right[row] = weight * force[row];
                waves
                    .row(row)
                    .iter()
                    .for_each(|(column, entry)| columns[(row, *column)] += weight * entry);
            }
            let base = columns.qr().q();
            let expected = 1.0 - base.tr_mul(&right).norm_squared() / right.norm_squared();
            let left = left_along_the_way(&force, &position, &way, ripple).unwrap();
            assert!((left / expected - 1.0).abs() < 1e-5, "{ripple:?}: {left} {expected}");
        }
    }

    /// To and fro over 50 mm in 0.1 s with rests of a second, while a force walks at random: at
    /// each rest it could be any phase of any ripple.
    #[test]
    fn a_force_that_wanders_while_the_carriage_rests_is_no_ripple() {
        use rand::SeedableRng;
        use rand_distr::{Distribution, StandardNormal};
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mut trace = friction_stage_data::signals::Trace::default();
        let (mut walk, mut force) = (0.0, Vec::new());
        for k in 0..80_000 {
            let (turn, in_turn) = (k / 2200, f64::from(k % 2200));
            let way = if in_turn < 200.0 { 0.5 - 0.5 * (TAU * in_turn / 400.0).cos() } else { 1.0 };
            trace.time.push(5e-4 * f64::from(k));
            let read: f64 = StandardNormal.sample(&mut random);
            trace.position.push(0.05 * if turn % 2 == 0 { way } else { 1.0 - way } + 1e-9 * read);
            trace.force.push(80.0 * (0.003 * f64::from(k)).sin());
            trace.force_cell.push(80.0 * (0.003 * f64::from(k)).sin());
            let step: f64 = StandardNormal.sample(&mut random);
            walk += 0.02 * step;
            force.push(walk);
        }
        let measured =
            Measured::new(&trace, &friction_stage_core::model::StageModel::default(), "a record")
                .unwrap();
        let force = measured.filtered(&force);
        for slip in [0.1, 0.5, 1.0] {
            let found = strongest(&force, &measured, slip).unwrap().unwrap();
            let share = share_along_the_way(&force, &measured, &found);
            assert!(share < 0.05, "slip {slip}: {share} of the squares");
        }
    }

    #[test]
    fn where_a_record_goes_through_few_periods_nothing_is_taken_for_a_ripple() {
        let measured = record();
        let ripple = SlippingRipple { period: 0.02, piece: 1.0 };
        assert!(Slipping::new(vec![ripple], &measured).is_none());
        let both = [ripple, SlippingRipple { period: 4e-3, piece: 1.0 }];
        let (force, _) = force(&measured, 4e-3, 0.0);
        let amplitudes = Slipping::new(both.to_vec(), &measured).unwrap().amplitudes(&force);
        assert!(
            amplitudes[0].is_none() && (amplitudes[1].unwrap() / 0.4 - 1.0).abs() < 0.02,
            "{amplitudes:?}"
        );
    }

    #[test]
    fn what_slips_is_no_force_of_the_law_and_leaves_the_other_side_alone() {
        use crate::Sides;
        use crate::test_records::hypothesis;
        let measured = record();
        let with = hypothesis(&[("ball_passage", &[0.4, 4e-3, 0.0, 0.0, 0.0, 1.0])]);
        let without = with.without(0);
        assert!(with.effects.iter().all(Part::slips) && with.effects[0].side() == Side::Carriage);
        let [with, without] =
            [with, without].map(|one| one.missing(&measured, Sides::BOTH).unwrap());
        assert_eq!(with.motor, without.motor);
        let mut expected = without.carriage.clone();
        let ripple = SlippingRipple { period: 4e-3, piece: 0.25 };
        Slipping::new(vec![ripple], &measured).unwrap().take_from(&mut expected);
        assert_eq!(with.carriage, expected);
        assert!(rms(&with.carriage) < rms(&without.carriage));
    }
}
