//! Position-dependent friction: the guides rub more at some places of the rail than at others.
//!
//! Fc and Fs times 1 + f shape(x): f fraction; with period p = 0 a bump, shape = exp(-((x - xc) /
//! w)^2), xc center (m), w width (m); with p > 0 a wave, shape = sin(2 pi x / p + phi), p period
//! (m), phi phase at x = 0 (rad). Source: both shapes are assumed: a damaged or dirty place, and a
//! rail whose screws or joints repeat. Sizes: assumed, 10 to 30 %. It only takes energy (|f| below
//! 1). Not modelled: viscous friction or stiffness that depend on position.

use std::f64::consts::TAU;

use super::regression::{
    Wave, golden_maximum, largest_over_decades, least_squares, strongest_wave, viscous_friction,
};
use super::{
    Action, EffectDescriptor, EffectParameter, FrictionLaw, FrictionTerms, Motion, Multiplicity,
    ParameterKind, RecordSpecific, Residual, Role, descriptor,
};
use crate::plant::guides::FrictionScale;

/// Friction must stay positive.
const LIMIT: f64 = 0.95;
/// Shortest and longest period of a proposal, m.
const PERIODS: (f64, f64) = (1e-3, 10.0);
/// Narrowest and widest bump, m.
const WIDTHS: (f64, f64) = (1e-4, 10.0);
/// Width of a bump where a model does not say it, m. Assumed.
const WIDTH: f64 = 0.05;

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "position_dependent_friction",
    role: Role::Friction(FrictionTerms::BRISTLES),
    law: "Fc, Fs (1 + fraction shape(x)); shape = exp(-((x - center) / width)^2), or with period > \
          0 sin(2 pi x / period + phase)",
    source: "assumed shapes: a place on the rail, or a rail that repeats",
    telltale: "changes sign with the velocity, its size follows the position, not seen by the \
               force cell",
    parameters: &[
        EffectParameter::required(
            "fraction",
            "1",
            "part by which Fc and Fs rise at the peak",
            (-LIMIT, LIMIT),
            0.05,
        ),
        EffectParameter::optional("center", "m", "middle of the bump", (-10.0, 10.0), 0.02, 0.0),
        EffectParameter::optional(
            "width",
            "m",
            "half width of the bump at 1/e",
            WIDTHS,
            0.02,
            WIDTH,
        ),
        EffectParameter::optional(
            "period",
            "m",
            "distance after which a wave repeats; 0 makes it a bump",
            (0.0, 10.0),
            1e-3,
            0.0,
        )
        .of_kind(ParameterKind::Period),
        EffectParameter::optional(
            "phase",
            "rad",
            "phase of the wave at position 0",
            (-TAU, TAU),
            1.0,
            0.0,
        )
        .of_kind(ParameterKind::Phase),
    ],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[0.1, 0.0, 0.02, 0.0, 0.0],
    check: descriptor::any,
    // The shape stays what it is.
    free: |values, index| index == 0 || (values[3] > 0.0) == (index > 2),
    build: |values| Action::Friction(Box::new(PositionDependentFriction::new(values))),
    proposal: Some(propose),
    starts: bump_or_wave,
    curve: None,
};

#[derive(Debug)]
struct PositionDependentFriction {
    fraction: f64,
    shape: Shape,
}

impl PositionDependentFriction {
    fn new(values: &[f64]) -> PositionDependentFriction {
        PositionDependentFriction {
            fraction: values[0],
            shape: if values[3] > 0.0 {
                Shape::Wave { wave_number: TAU / values[3], phase: values[4] }
            } else {
                Shape::Bump { center: values[1], width: values[2] }
            },
        }
    }
}

#[derive(Debug)]
enum Shape {
    Bump { center: f64, width: f64 },
    Wave { wave_number: f64, phase: f64 },
}

impl FrictionLaw for PositionDependentFriction {
    fn scale(&mut self, motion: &Motion, _step: f64, scale: &mut FrictionScale) {
        let shape = match self.shape {
            Shape::Bump { center, width } => bump(motion.position, center, width),
            Shape::Wave { wave_number, phase } => (wave_number * motion.position + phase).sin(),
        };
        scale.coulomb *= 1.0 + self.fraction * shape;
        scale.stat *= 1.0 + self.fraction * shape;
    }
}

fn bump(position: f64, center: f64, width: f64) -> f64 {
    let distance = (position - center) / width;
    (-distance * distance).exp()
}

/// Places along the motion at which a bump is tried.
const CENTERS: usize = 64;
/// Bins over the position for the bump.
const BINS: usize = 512;

/// The bump and the wave whose products with the modelled friction, less its viscous part, take
/// most out of the residual, in one: with the fraction of the stronger one; a width or a period of
/// 0 where there is none.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let viscous = viscous_friction(residual)?;
    let gain = |k: usize| -(residual.friction[k] - viscous * residual.velocity[k]);
    let wave = strongest_wave(residual.position, gain, residual.force, PERIODS.0..=PERIODS.1);
    let bump = strongest_bump(residual, gain);
    let of_wave = |wave: Wave| {
        (wave.explained, vec![wave.amplitude().min(LIMIT), 0.0, 0.0, wave.period, wave.phase()])
    };
    match (wave.map(of_wave), bump) {
        (Some((of_wave, wave)), Some((of_bump, bump))) => {
            let fraction = if of_wave > of_bump { wave[0] } else { bump[0] };
            Some(vec![fraction, bump[1], bump[2], wave[3], wave[4]])
        }
        (Some((_, only)), None) | (None, Some((_, only))) => Some(only),
        (None, None) => None,
    }
}

/// What explains most while the guides are biased by it need not be the form: each that was
/// proposed.
fn bump_or_wave(values: &[f64], _step: f64) -> Vec<Vec<f64>> {
    let [fraction, center, width, period, phase] = *values else { return Vec::new() };
    let bump = (width > 0.0).then(|| vec![fraction, center, width, 0.0, 0.0]);
    let wave = (period > 0.0).then(|| vec![fraction, 0.0, WIDTH, period, phase]);
    bump.into_iter().chain(wave).collect()
}

/// The bump that takes most out of the residual beyond a constant factor on the friction: how much,
/// and its values.
fn strongest_bump(residual: &Residual, gain: impl Fn(usize) -> f64) -> Option<(f64, Vec<f64>)> {
    let lowest = residual.position.iter().copied().fold(f64::INFINITY, f64::min);
    let highest = residual.position.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let range = highest - lowest;
    if !range.is_finite() || range <= 0.0 {
        return None;
    }
    // Bins of the root of the weight and of the weighted mean: least squares over them is least
    // squares over the samples.
    let mut sums = vec![(0.0, 0.0); BINS];
    for (k, position) in residual.position.iter().enumerate() {
        let gain = gain(k);
        if position.is_finite() && gain.is_finite() && residual.force[k].is_finite() {
            let bin =
                &mut sums[(((position - lowest) / range * BINS as f64) as usize).min(BINS - 1)];
            bin.0 += gain * gain;
            bin.1 += gain * residual.force[k];
        }
    }
    let place = |bin: usize| lowest + (bin as f64 + 0.5) / BINS as f64 * range;
    let root: Vec<f64> = sums.iter().map(|sum: &(f64, f64)| sum.0.sqrt()).collect();
    let means: Vec<f64> = sums
        .iter()
        .zip(&root)
        .map(|(sum, root)| if *root > 0.0 { sum.1 / root } else { 0.0 })
        .collect();
    let base = least_squares(&means, |bin| [root[bin]])?;
    let fit = |center: f64, width: f64| {
        least_squares(&means, |bin| [root[bin], root[bin] * bump(place(bin), center, width)])
    };
    let explained = |center: f64, width: f64| {
        fit(center, width).map_or(0.0, |fit| fit.explained - base.explained)
    };
    let widths = (WIDTHS.0.max(4.0 * range / BINS as f64), WIDTHS.1.min(range));
    let best_width =
        |center: f64| largest_over_decades(widths.0, widths.1, |width| explained(center, width));
    let spacing = range / CENTERS as f64;
    let mut best = (0.0, lowest, widths.1);
    for index in 0..=CENTERS {
        let center = lowest + index as f64 * spacing;
        let width = best_width(center);
        let found = explained(center, width);
        if found > best.0 {
            best = (found, center, width);
        }
    }
    let center =
        golden_maximum(best.1 - spacing, best.1 + spacing, |center| explained(center, best.2));
    let width = best_width(center);
    // Chance is judged on the samples, not on their bins.
    let total: f64 =
        residual.force.iter().filter(|force| force.is_finite()).map(|force| force * force).sum();
    let (explained, fraction) = (explained(center, width), fit(center, width)?.coefficients[1]);
    let rest = total - base.explained - explained;
    super::regression::beyond_chance(explained, rest, residual.force.len(), 3, CENTERS)
        .then(|| (explained, vec![fraction.clamp(-LIMIT, LIMIT), center, width, 0.0, 0.0]))
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;

    fn scale_at(values: &[f64], position: f64) -> FrictionScale {
        let mut scale = FrictionScale::ONE;
        PositionDependentFriction::new(values).scale(
            &Motion { position, velocity: -0.1, ..Motion::default() },
            1e-4,
            &mut scale,
        );
        scale
    }

    #[test]
    fn friction_rises_at_the_bump_and_nowhere_else() {
        let bump = [0.2, 0.1, 0.02, 0.0, 0.0];
        let expected = [(0.1, 1.2), (0.12, 1.0 + 0.2 * (-1.0f64).exp()), (0.3, 1.0)];
        for (position, factor) in expected {
            let scale = scale_at(&bump, position);
            assert!(
                (scale.coulomb - factor).abs() < 1e-12 && scale.stat == scale.coulomb,
                "{position} m: {scale:?}"
            );
            assert_eq!(scale.viscous, 1.0);
        }
    }

    #[test]
    fn with_a_period_friction_repeats() {
        let wave = [0.1, 0.1, 0.02, 0.08, 0.0];
        for (position, factor) in [(0.0, 1.0), (0.02, 1.1), (0.06, 0.9), (0.10, 1.1)] {
            assert!((scale_at(&wave, position).coulomb - factor).abs() < 1e-12, "{position} m");
        }
    }

    #[test]
    fn a_fit_keeps_the_shape() {
        let free = |values: &[f64]| {
            (0..5).map(|index| (DESCRIPTOR.free)(values, index)).collect::<Vec<_>>()
        };
        assert_eq!(free(&[0.1, 0.0, 0.1, 0.0, 0.0]), [true, true, true, false, false]);
        assert_eq!(free(&[0.1, 0.0, 0.1, 0.2, 0.0]), [true, false, false, true, true]);
    }

    #[test]
    fn proposal_finds_bump_and_wave_under_noise_and_nothing_in_noise() {
        let forms = |values: &[f64]| bump_or_wave(&proposal(&DESCRIPTOR, values), 5e-4);
        let found = &forms(&[0.2, 0.13, 0.02, 0.0, 0.0])[0];
        assert!((found[0] / 0.2 - 1.0).abs() < 0.1 && (found[1] - 0.13).abs() < 2e-3, "{found:?}");
        assert!((found[2] / 0.02 - 1.0).abs() < 0.1 && found[3] == 0.0, "{found:?}");
        let found = &forms(&[0.1, 0.0, 0.05, 0.06, 0.5])[1];
        assert!(
            (found[0] / 0.1 - 1.0).abs() < 0.1 && (found[3] / 0.06 - 1.0).abs() < 0.01,
            "{found:?}"
        );
        assert!((found[4] - 0.5).abs() < 0.15, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
