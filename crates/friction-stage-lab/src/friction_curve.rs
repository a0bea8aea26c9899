//! The static friction curve of a machine, from runs at held speeds.
//!
//! F(v) = offset + sign(v) (Fc + (Fs - Fc) exp(-(v/vs)^2)) + sigma2 v (Armstrong-Hélouvry, Dupont,
//! Canudas de Wit, "A survey of models, analysis tools and compensation methods for the control of
//! machines with friction", Automatica 30, 1994, with Gauss's curve). Each run is a point with the
//! standard deviation of its mean. Runs scatter more than that among each other; what they scatter
//! beyond, the same for all, is estimated with the curve (Paule, Mandel, "Consensus values and
//! weighting factors", J. Res. NBS 87, 1982), and the intervals hold it.

use nalgebra::{DMatrix, DVector};
use serde::Serialize;

use super::guide_fit::{Fitted, SIGNIFICANT};
use friction_stage_core::numerics::TWO_SIDED_95;

/// Stribeck velocities that are tried for each factor of e.
const TRIED: usize = 20;
/// Speeds within this ratio are one.
const SAME_SPEED: f64 = 1.1;
/// Halvings in the search for the scatter between runs.
const HALVINGS: usize = 60;

/// A run at a held speed. Units are those of a prismatic joint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CurvePoint {
    /// m/s, with its direction.
    pub velocity: f64,
    /// Mean force, N.
    pub force: f64,
    /// Standard deviation of the mean, N.
    pub deviation: f64,
}

/// A friction curve with 95 % intervals.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FrictionCurve {
    /// Coulomb friction Fc, N; with one speed only, all friction there.
    pub coulomb_force: Fitted,
    /// sigma2, N s/m; absent with one speed only.
    pub viscous_friction: Option<Fitted>,
    /// Where friction falls with velocity by more than chance.
    pub stribeck: Option<Stribeck>,
    /// Force that does not turn round with the motion, N; absent where all runs have one direction:
    /// then it is part of the Coulomb friction.
    pub offset: Option<Fitted>,
    /// By how much runs scatter among each other beyond the noise in them, N rms.
    pub scatter: f64,
    /// Speeds that differ by more than a tenth.
    pub speeds: usize,
}

/// The falling part of a friction curve.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stribeck {
    /// Fs, N.
    pub static_force: Fitted,
    /// vs, m/s.
    pub velocity: Fitted,
}

/// Runs that make no curve.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CurveError {
    /// Less points than numbers.
    #[error(
        "{runs} runs at held speeds, at least {needed} are needed: record some at constant \
         velocity, in both directions"
    )]
    FewRuns {
        /// Runs that were found.
        runs: usize,
        /// Runs for the simplest curve.
        needed: usize,
    },
    /// The curve is not determined.
    #[error("the runs do not determine a friction curve: speeds or forces are not finite or alike")]
    Singular,
}

/// The parts of a curve, in the order of their columns: Coulomb, offset, viscous, fall.
#[derive(Clone, Copy)]
struct Shape {
    offset: bool,
    viscous: bool,
    stribeck_velocity: Option<f64>,
}

impl Shape {
    fn row(self, velocity: f64) -> Vec<f64> {
        let direction = velocity.signum();
        let mut row = vec![direction];
        row.extend(self.offset.then_some(1.0));
        row.extend(self.viscous.then_some(velocity));
        row.extend(self.stribeck_velocity.map(|vs| direction * fall(velocity, vs)));
        row
    }
}

fn fall(velocity: f64, stribeck_velocity: f64) -> f64 {
    (-(velocity / stribeck_velocity).powi(2)).exp()
}

/// A linear fit with given weights.
struct Fit {
    values: DVector<f64>,
    cost: f64,
}

fn solve(points: &[CurvePoint], shape: Shape, scatter: f64) -> Option<Fit> {
    let weights: Vec<f64> =
        points.iter().map(|p| 1.0 / (p.deviation.powi(2) + scatter * scatter).sqrt()).collect();
    let rows: Vec<Vec<f64>> = points.iter().map(|point| shape.row(point.velocity)).collect();
    let columns = rows.first()?.len();
    let matrix = DMatrix::from_fn(points.len(), columns, |r, c| weights[r] * rows[r][c]);
    let right = DVector::from_fn(points.len(), |r, _| weights[r] * points[r].force);
    let qr = matrix.clone().svd(true, true);
    let values = qr.solve(&right, 1e-12 * qr.singular_values.max()).ok()?;
    let cost = (&matrix * &values - right).norm_squared();
    cost.is_finite().then_some(Fit { values, cost })
}

/// The scatter between runs with which a curve of this shape leaves as much as chance does; 0 where
/// the noise in the runs is enough.
fn scatter_of(points: &[CurvePoint], shape: Shape) -> Option<f64> {
    let columns = shape.row(1.0).len();
    let freedom = points.len().saturating_sub(columns) as f64;
    let excess = |scatter: f64| Some(solve(points, shape, scatter)?.cost - freedom);
    let largest = points.iter().map(|p| p.force.abs() + p.deviation).fold(0.0, f64::max);
    // Without any noise within the runs, no scatter at all weighs nothing.
    let (mut low, mut high) = (1e-9 * largest, 10.0 * largest);
    if freedom == 0.0 || excess(low)? <= 0.0 {
        return Some(low);
    }
    for _ in 0..HALVINGS {
        let middle = (low * high).sqrt();
        if excess(middle)? > 0.0 { low = middle } else { high = middle }
    }
    Some(high)
}

/// The Stribeck velocity with which the curve leaves least, among those inside of the speeds.
fn best_fall(points: &[CurvePoint], shape: Shape, scatter: f64) -> Option<(Shape, Fit)> {
    let speeds = points.iter().map(|point| point.velocity.abs());
    let (slowest, fastest) =
        speeds.fold((f64::INFINITY, 0.0), |(low, high): (f64, f64), v| (low.min(v), high.max(v)));
    let count = (TRIED as f64 * (fastest / slowest).ln()).ceil() as usize;
    let tried = (1..count).filter_map(|k| {
        let velocity = slowest * (fastest / slowest).powf(k as f64 / count as f64);
        let shape = Shape { stribeck_velocity: Some(velocity), ..shape };
        let fit = solve(points, shape, scatter)?;
        // A friction that rises there is no Stribeck curve, and one that drives is none at all; a
        // constant force, which is part of it with one direction only, may drive.
        let falls = fit.values.as_slice().last().is_some_and(|excess| *excess > 0.0);
        let resists = !shape.offset || fit.values[0] > 0.0;
        (falls && resists).then_some((shape, fit))
    });
    tried.min_by(|a, b| a.1.cost.total_cmp(&b.1.cost))
}

/// Fits a friction curve to runs at held speeds.
///
/// # Errors
/// Too few runs, or runs whose speeds or forces are not finite.
pub fn friction_curve(points: &[CurvePoint]) -> Result<FrictionCurve, CurveError> {
    let is_finite = |p: &CurvePoint| {
        p.velocity.is_finite() && p.velocity != 0.0 && p.force.is_finite() && p.deviation >= 0.0
    };
    if !points.iter().all(is_finite) {
        return Err(CurveError::Singular);
    }
    let forward = points.iter().filter(|point| point.velocity > 0.0).count();
    let has_both = forward > 0 && forward < points.len();
    let needed = if has_both { 3 } else { 2 };
    if points.len() < needed {
        return Err(CurveError::FewRuns { runs: points.len(), needed });
    }
    let speeds = distinct_speeds(points);
    let straight = Shape {
        offset: has_both,
        viscous: speeds >= 2 && points.len() > needed,
        stribeck_velocity: None,
    };
    let mut scatter = scatter_of(points, straight).ok_or(CurveError::Singular)?;
    let mut chosen = (straight, solve(points, straight, scatter).ok_or(CurveError::Singular)?);
    let columns = straight.row(1.0).len();
    // A fall has two numbers more, and needs speeds on both sides of it.
    if straight.viscous
        && speeds >= 4
        && points.len() >= columns + 4
        && let Some((shape, _)) = best_fall(points, straight, scatter)
        && let Some(with_fall) = scatter_of(points, shape)
        && let Some((shape, fit)) = best_fall(points, straight, with_fall)
        && let Some(flat) = solve(points, straight, with_fall)
        && flat.cost - fit.cost > SIGNIFICANT
    {
        scatter = with_fall;
        chosen = (shape, fit);
    }
    let (shape, fit) = chosen;
    conclude(points, shape, &fit, scatter, speeds).ok_or(CurveError::Singular)
}

fn distinct_speeds(points: &[CurvePoint]) -> usize {
    let mut speeds: Vec<f64> = points.iter().map(|point| point.velocity.abs()).collect();
    speeds.sort_by(f64::total_cmp);
    let mut group = f64::NEG_INFINITY;
    speeds.retain(|speed| {
        let is_new = *speed > SAME_SPEED * group;
        if is_new {
            group = *speed;
        }
        is_new
    });
    speeds.len()
}

/// The intervals, with the Stribeck velocity as one of the numbers.
fn conclude(
    points: &[CurvePoint],
    shape: Shape,
    fit: &Fit,
    scatter: f64,
    speeds: usize,
) -> Option<FrictionCurve> {
    let excess = shape.stribeck_velocity.map(|_| fit.values[fit.values.len() - 1]);
    let jacobian_row = |point: &CurvePoint| {
        let weight = 1.0 / (point.deviation.powi(2) + scatter * scatter).sqrt();
        let mut row = shape.row(point.velocity);
        if let (Some(vs), Some(excess)) = (shape.stribeck_velocity, excess) {
            let v = point.velocity;
            row.push(v.signum() * excess * fall(v, vs) * 2.0 * v * v / vs.powi(3));
        }
        row.iter().map(|value| value * weight).collect::<Vec<f64>>()
    };
    let rows: Vec<Vec<f64>> = points.iter().map(jacobian_row).collect();
    let columns = rows.first()?.len();
    let jacobian = DMatrix::from_fn(rows.len(), columns, |r, c| rows[r][c]);
    // Columns of length one, whatever their units.
    let lengths: Vec<f64> = jacobian.column_iter().map(|column| column.norm()).collect();
    let scaled = DMatrix::from_fn(rows.len(), columns, |r, c| jacobian[(r, c)] / lengths[c]);
    let inverse = (scaled.transpose() * &scaled).cholesky()?.inverse();
    let covariance = |a: usize, b: usize| inverse[(a, b)] / (lengths[a] * lengths[b]);
    let fitted = |value: f64, variance: f64| {
        let half = TWO_SIDED_95 * variance.sqrt();
        Fitted { value, ci95: [value - half, value + half] }
    };
    let at = |index: usize| fitted(fit.values[index], covariance(index, index));
    let viscous = 1 + usize::from(shape.offset);
    let stribeck = shape.stribeck_velocity.zip(excess).map(|(vs, excess)| {
        let last = fit.values.len() - 1;
        let variance = covariance(0, 0) + covariance(last, last) + 2.0 * covariance(0, last);
        Stribeck {
            static_force: fitted(fit.values[0] + excess, variance),
            velocity: fitted(vs, covariance(last + 1, last + 1)),
        }
    });
    Some(FrictionCurve {
        coulomb_force: at(0),
        viscous_friction: shape.viscous.then(|| at(viscous)),
        stribeck,
        offset: shape.offset.then(|| at(1)),
        scatter,
        speeds,
    })
}

impl FrictionCurve {
    /// Whether it resists the motion: within their intervals neither Coulomb nor viscous friction
    /// is negative. With runs in one direction a constant force may drive it.
    pub fn resists(&self) -> bool {
        let may_resist = |fitted: Fitted| fitted.ci95[1] >= 0.0;
        self.viscous_friction.is_none_or(may_resist)
            && (self.offset.is_none() || may_resist(self.coulomb_force))
    }

    /// Force at a velocity, N.
    pub fn force(&self, velocity: f64) -> f64 {
        let direction = velocity.signum();
        let excess = self.stribeck.as_ref().map_or(0.0, |stribeck| {
            (stribeck.static_force.value - self.coulomb_force.value)
                * fall(velocity, stribeck.velocity.value)
        });
        self.offset.map_or(0.0, |offset| offset.value)
            + direction * (self.coulomb_force.value + excess)
            + self.viscous_friction.map_or(0.0, |viscous| viscous.value) * velocity
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt as _, SeedableRng as _};

    use super::*;

    const SPEEDS: [f64; 9] = [0.5e-3, 1e-3, 2e-3, 4e-3, 8e-3, 16e-3, 32e-3, 64e-3, 128e-3];

    /// Runs in both directions with this curve, each beside it by what a generator gives.
    fn runs(curve: impl Fn(f64) -> f64, scatter: f64, noise: f64, seed: u64) -> Vec<CurvePoint> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut normal = move || (0..12).map(|_| random.random::<f64>()).sum::<f64>() - 6.0;
        SPEEDS
            .iter()
            .flat_map(|speed| [*speed, -speed])
            .map(|velocity| {
                let beside = scatter * normal() + noise * normal();
                CurvePoint { velocity, force: curve(velocity) + beside, deviation: noise }
            })
            .collect()
    }

    fn stribeck(v: f64) -> f64 {
        1.5 + v.signum() * (40.0 + 12.0 * (-(v / 5e-3).powi(2)).exp()) + 70.0 * v
    }

    #[test]
    fn intervals_hold_the_curve_as_often_as_they_say() {
        let mut held = [0; 5];
        const RUNS: u64 = 400;
        for seed in 0..RUNS {
            let curve = friction_curve(&runs(stribeck, 0.6, 0.05, seed)).unwrap();
            let found = curve.stribeck.expect("a fall of 12 N is seen");
            let truths = [
                (curve.coulomb_force, 40.0),
                (curve.offset.unwrap(), 1.5),
                (curve.viscous_friction.unwrap(), 70.0),
                (found.static_force, 52.0),
                (found.velocity, 5e-3),
            ];
            for (count, (fitted, truth)) in held.iter_mut().zip(truths) {
                *count += u64::from((fitted.ci95[0]..fitted.ci95[1]).contains(&truth));
            }
        }
        // 95 % of 400 is 380; with 13 degrees of freedom a normal interval holds 93 %.
        for count in held {
            assert!((352..=396).contains(&count), "{held:?} of {RUNS}");
        }
    }

    #[test]
    fn what_does_not_fall_has_no_stribeck_velocity() {
        let straight = |v: f64| v.signum() * 40.0 + 70.0 * v;
        let falls =
            |seed| friction_curve(&runs(straight, 0.6, 0.05, seed)).unwrap().stribeck.is_some();
        let found = (0..400).filter(|seed| falls(*seed)).count();
        // One of a thousand by the criterion, some more since the velocity is searched for.
        assert!(found <= 8, "{found} of 400");
    }

    #[test]
    fn few_runs_make_a_simple_curve_or_none() {
        let all = runs(stribeck, 0.0, 0.05, 1);
        let one_way: Vec<CurvePoint> = all.iter().copied().filter(|p| p.velocity > 0.0).collect();
        let curve = friction_curve(&one_way[4..]).unwrap();
        assert!(curve.offset.is_none() && curve.stribeck.is_none());
        assert!((curve.coulomb_force.value - 41.5).abs() < 0.5);
        let at_one_speed = [all[0], all[1], all[0], all[1]];
        assert!(friction_curve(&at_one_speed).unwrap().viscous_friction.is_none());
        let error = friction_curve(&all[..2]).unwrap_err();
        assert_eq!(error, CurveError::FewRuns { runs: 2, needed: 3 });
        let at_rest = CurvePoint { velocity: 0.0, ..all[0] };
        assert_eq!(friction_curve(&[at_rest; 5]).unwrap_err(), CurveError::Singular);
    }
}
