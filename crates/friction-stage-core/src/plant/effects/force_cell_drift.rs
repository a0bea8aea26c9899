//! Force cell drift: the zero of the cell moves with time.
//!
//! Reading F + b + r t + A (1 - exp(-t / T)): b offset (N), r rate (N/s), t time since the start
//! (s), A amplitude (N) and T time_constant (s) of a warm-up. Source: assumed form: zero error,
//! linear drift, and one thermal mode. Sizes: assumed, some 0.1 N over minutes. Not modelled: drift
//! that follows the load.

use super::regression::{largest_over_decades, least_squares};
use super::{
    Action, EffectDescriptor, EffectParameter, Multiplicity, ReadingLaw, RecordSpecific, Residual,
    Role, descriptor,
};

/// Shortest and longest time constant, s.
const TIMES: (f64, f64) = (0.1, 1e5);

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "force_cell_drift",
    role: Role::ForceCell,
    law: "reading = F + offset + rate t + amplitude (1 - exp(-t / time_constant))",
    source: "assumed: zero error, linear drift and one thermal mode",
    telltale: "cell less command follows slow time alone, and so does the carriage's residual, \
               with the opposite sign",
    parameters: &[
        EffectParameter::optional(
            "rate",
            "N/s",
            "drift of the reading",
            (-100.0, 100.0),
            0.01,
            0.0,
        ),
        EffectParameter::optional(
            "offset",
            "N",
            "reading without force at time 0",
            (-1000.0, 1000.0),
            0.1,
            0.0,
        ),
        EffectParameter::optional(
            "amplitude",
            "N",
            "change of the reading by warm-up",
            (-1000.0, 1000.0),
            0.1,
            0.0,
        ),
        EffectParameter::optional("time_constant", "s", "time of the warm-up", TIMES, 1.0, 10.0),
    ],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[0.01, 0.1, 0.0, 10.0],
    check: descriptor::any,
    // A warm-up that is not there stays away.
    free: |values, index| index < 2 || values[2] != 0.0,
    build: |values| Action::ForceCell(Box::new(ForceCellDrift::new(values))),
    proposal: Some(propose),
    starts: line_and_warm_up,
    curve: None,
};

#[derive(Debug)]
struct ForceCellDrift {
    rate: f64,
    offset: f64,
    amplitude: f64,
    time_constant: f64,
}

impl ForceCellDrift {
    fn new(values: &[f64]) -> ForceCellDrift {
        ForceCellDrift {
            rate: values[0],
            offset: values[1],
            amplitude: values[2],
            time_constant: values[3],
        }
    }
}

impl ReadingLaw for ForceCellDrift {
    fn reading(&self, time: f64, force: f64) -> f64 {
        force + self.offset + self.rate * time
            - self.amplitude * (-time / self.time_constant).exp_m1()
    }
}

/// Straight line over time; with a warm-up where that explains more than chance beyond it.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let line = least_squares(residual.force, |k| [1.0, residual.time[k]])?;
    let duration = residual.time.last()? - residual.time.first()?;
    let warm_up = |time_constant: f64| {
        least_squares(residual.force, |k| {
            [1.0, residual.time[k], -(-residual.time[k] / time_constant).exp_m1()]
        })
    };
    // Beyond half the record a warm-up is hard to tell from a line.
    let (shortest, longest) = ((duration / 300.0).max(TIMES.0), 0.5 * duration);
    if longest > shortest {
        let explained = |time_constant: f64| {
            warm_up(time_constant).map_or(f64::NEG_INFINITY, |fit| fit.explained)
        };
        let time_constant = largest_over_decades(shortest, longest, explained);
        if let Some(fit) = warm_up(time_constant).filter(|fit| fit.improves_on(&line)) {
            let [offset, rate, amplitude] = fit.coefficients;
            return Some(vec![rate, offset, amplitude, time_constant]);
        }
    }
    line.is_something().then(|| vec![line.coefficients[1], line.coefficients[0], 0.0, 10.0])
}

/// The line alone, and with the warm-up where one was proposed.
fn line_and_warm_up(values: &[f64], _step: f64) -> Vec<Vec<f64>> {
    let mut line = values.to_vec();
    line[2] = 0.0;
    if values[2] == 0.0 { vec![line] } else { vec![line, values.to_vec()] }
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;

    #[test]
    fn reading_drifts_from_its_offset_by_the_rate_and_the_warm_up() {
        let drift = ForceCellDrift::new(&[0.01, -0.2, 0.5, 10.0]);
        assert!((drift.reading(0.0, 7.0) - 6.8).abs() < 1e-12);
        let expected = 7.0 - 0.2 + 0.2 + 0.5 * (1.0 - (-2.0f64).exp());
        assert!((drift.reading(20.0, 7.0) - expected).abs() < 1e-12);
    }

    #[test]
    fn proposal_finds_line_and_warm_up_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[0.05, -0.3, 0.0, 10.0]);
        assert!(
            (found[0] / 0.05 - 1.0).abs() < 0.1 && (found[1] / -0.3 - 1.0).abs() < 0.1,
            "{found:?}"
        );
        assert_eq!(found[2], 0.0);
        let found = proposal(&DESCRIPTOR, &[0.0, 0.2, 1.0, 1.5]);
        assert!(
            (found[2] / 1.0 - 1.0).abs() < 0.2 && (found[3] / 1.5 - 1.0).abs() < 0.2,
            "{found:?}"
        );
        assert_silent_on_noise(&DESCRIPTOR);
    }

    #[test]
    fn a_fit_starts_from_the_line_and_from_the_warm_up_that_was_proposed() {
        let forms = |values: &[f64]| (DESCRIPTOR.starts)(values, 5e-4);
        assert_eq!(forms(&[0.1, 0.2, 0.3, 4.0]), [[0.1, 0.2, 0.0, 4.0], [0.1, 0.2, 0.3, 4.0]]);
        assert_eq!(forms(&[0.1, 0.2, 0.0, 10.0]), [[0.1, 0.2, 0.0, 10.0]]);
    }
}
