//! Is a ripple the same in another record, or has it moved? A ripple in position keeps its phase
//! only while the machine keeps its origin: homed again, or with an incremental encoder started
//! elsewhere, the phase is another one, and the law with the old one makes things worse.

use std::f64::consts::TAU;

use crate::hypothesis::{Hypothesis, Part, Sides};
use crate::record::measured::Measured;
use friction_stage_core::model::ModelError;
use friction_stage_core::numerics::sinusoid::SinusoidSums;
use friction_stage_core::plant::effects::ParameterKind;

/// Ratio of amplitudes up to which two ripples pass for the same one, and fewest periods that make
/// a ripple. Assumed.
const ALIKE: f64 = 1.5;
const FEWEST: f64 = 8.0;

/// A ripple of known period as another record shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RippleElsewhere {
    /// m
    pub period: f64,
    /// Amplitude of the law, and the one that fits the other record best, N.
    pub amplitudes: (f64, f64),
    /// Periods along the way that the other record covers.
    pub periods: f64,
    /// Phase there less phase of the law, rad, between -pi and pi.
    pub phase_shift: f64,
    /// What the law as it stands takes off the mean square there, N^2; negative where it makes it
    /// worse.
    pub gain_as_found: f64,
    /// What it would take off with the phase and amplitude of that record, N^2: a fit on that
    /// record, to be reported and not used.
    pub gain_with_own_phase: f64,
}

impl RippleElsewhere {
    /// Whether the ripple is there, but elsewhere: only with its own phase does it lower the error
    /// by `least`, N^2. A few waves, or waves of another size, are what bends otherwise along the
    /// way.
    pub fn has_moved(&self, least: f64) -> bool {
        let (law, there) = self.amplitudes;
        let alike = there < ALIKE * law && law < ALIKE * there;
        alike
            && self.periods >= FEWEST
            && self.gain_as_found < least
            && self.gain_with_own_phase >= least
    }
}

/// How a law that is a force of sinusoidal course over position fares in another record;
/// `None` for other laws. `without` is the hypothesis that lacks it.
pub fn ripple_elsewhere(
    part: &Part,
    without: &Hypothesis,
    other: &Measured,
) -> Result<Option<RippleElsewhere>, ModelError> {
    if !part.role().is_force() {
        return Ok(None);
    }
    let (Some(amplitude), Some(period), Some(phase)) = (
        part.value_of_kind(ParameterKind::Amplitude),
        part.value_of_kind(ParameterKind::Period),
        part.value_of_kind(ParameterKind::Phase),
    ) else {
        return Ok(None);
    };
    let missing = without.missing(other, Sides::BOTH)?;
    let motor = part.side() == friction_stage_core::plant::Side::Motor && other.cell.is_some();
    let residual = if motor { missing.motor } else { missing.carriage };
    Ok(compare(&other.at_rows(&other.position), &residual, amplitude, period, phase))
}

/// The same on plain columns: positions, m, and missing force, N.
fn compare(
    position: &[f64],
    residual: &[f64],
    amplitude: f64,
    period: f64,
    phase: f64,
) -> Option<RippleElsewhere> {
    let count = residual.len() as f64;
    let (mut sums, mut change) = (SinusoidSums::default(), 0.0);
    for (x, force) in position.iter().zip(residual) {
        let turn = TAU * x / period;
        sums.add(turn, *force);
        change += force * force - (force - amplitude * (turn + phase).sin()).powi(2);
    }
    let best = sums.solve()?;
    // Against a model that has the mean, which is no part of the ripple.
    let mean = sums.total() / count;
    let gain = best.explained / count - mean * mean;
    let shift = best.phase() - phase;
    let (lowest, highest) = friction_stage_core::numerics::range(position);
    Some(RippleElsewhere {
        period,
        amplitudes: (amplitude, best.amplitude()),
        periods: (highest - lowest) / period,
        phase_shift: shift - TAU * (shift / TAU).round(),
        gain_as_found: change / count,
        gain_with_own_phase: gain,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ripple of 1 N and 2.5 mm with this phase, seen over 40 mm at an even spacing.
    fn seen(phase: f64) -> (Vec<f64>, Vec<f64>) {
        let position: Vec<f64> = (0..4000).map(|k| 1e-5 * f64::from(k)).collect();
        let force = position.iter().map(|x| (TAU * x / 2.5e-3 + phase).sin() + 0.3).collect();
        (position, force)
    }

    #[test]
    fn a_ripple_with_the_same_phase_has_not_moved() {
        let (position, force) = seen(0.7);
        let found = compare(&position, &force, 1.0, 2.5e-3, 0.7).unwrap();
        assert!(
            found.phase_shift.abs() < 1e-9 && (found.amplitudes.1 - 1.0).abs() < 1e-9,
            "{found:?}"
        );
        assert!(
            (found.gain_as_found - 0.5).abs() < 1e-9
                && (found.gain_with_own_phase - 0.5).abs() < 1e-9,
            "{found:?}"
        );
        assert!(!found.has_moved(0.1));
    }

    #[test]
    fn a_ripple_whose_phase_has_turned_makes_the_other_record_worse_and_is_seen_to_be_there() {
        let (position, force) = seen(0.7 - 2.5);
        let found = compare(&position, &force, 1.0, 2.5e-3, 0.7).unwrap();
        assert!((found.phase_shift + 2.5).abs() < 1e-9, "{found:?}");
        // Mean of 2 sin(a) sin(b) - sin(b)^2 = cos(2.5) - 1/2.
        assert!((found.gain_as_found - (2.5f64.cos() - 0.5)).abs() < 1e-9, "{found:?}");
        assert!(found.has_moved(0.1));
    }

    #[test]
    fn a_ripple_that_is_not_there_has_not_moved_either() {
        let (position, _) = seen(0.0);
        let found = compare(&position, &vec![0.3; position.len()], 1.0, 2.5e-3, 0.7).unwrap();
        assert!(
            found.gain_as_found < -0.4
                && found.gain_with_own_phase.abs() < 1e-9
                && !found.has_moved(0.1),
            "{found:?}"
        );
    }
}
