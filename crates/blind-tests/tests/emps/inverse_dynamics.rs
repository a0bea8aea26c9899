//! Inverse dynamics by linear least squares, as published for EMPS: the figures that another tool
//! must reach on the same record.
//!
//! F = M a + Fv v + Fc sign(v) + c, with Fv and Fc either alike in both directions or one each; M
//! in kg, Fv in N s/m, Fc and c in N. The measured position goes forward and backward through a
//! Butterworth lowpass, velocity and acceleration are its central differences, the first samples
//! are dropped, every column and the force are decimated, and the error is norm(F - F_model) /
//! norm(F). Source: A. Janot, M. Gautier, M. Brunot, "Data set and reference models of EMPS",
//! Workshop on Nonlinear System Identification Benchmarks, 2019; what their text leaves open is as
//! in `filtfilt` and `decimate` of Matlab and SciPy. Not modelled: anything with a memory. The
//! force of a sample is compared with the motion of the same sample, so the hold of the command
//! counts as a lag of half a sample here, which `Measured` takes out.

use std::f64::consts::PI;

use nalgebra::{DMatrix, DVector};

use friction_stage_core::model::StageModel;
use friction_stage_data::signals::Trace;
use friction_stage_identify::{Hypothesis, IdentifyError, MIN_SAMPLES, Measured, Sides};

/// Ripple of the filter before decimation, dB, its order, and its corner as a share of the new
/// Nyquist frequency (`decimate`).
const DECIMATION: (f64, usize, f64) = (0.05, 8, 0.8);

/// What is done to a record before its forces are compared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Protocol {
    /// Corner of the 4th-order Butterworth lowpass on the position, Hz.
    pub corner: f64,
    /// Samples that are dropped at the start.
    pub dropped: usize,
    /// Every how many samples one is kept.
    pub factor: usize,
}

/// The protocol of the EMPS benchmark.
pub const EMPS: Protocol = Protocol { corner: 100.0, dropped: 49, factor: 10 };

/// Friction of the regression.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrictionLaw {
    /// Coefficients: M, Fv, Fc, c.
    Symmetric,
    /// Coefficients: M, Fv at v > 0, Fv at v < 0, force at v > 0, force at v < 0 (negative).
    PerDirection,
}

/// Decimated columns of the regression and the force that they are to explain, N.
#[derive(Clone, Debug)]
pub struct Regression {
    pub columns: DMatrix<f64>,
    pub force: DVector<f64>,
}

impl Regression {
    /// From a record with position and command at a uniform rate.
    pub fn new(
        trace: &Trace,
        law: FrictionLaw,
        protocol: Protocol,
    ) -> Result<Regression, IdentifyError> {
        let rate = rate_of(trace)?;
        let position = ZeroPhase::butterworth(4, protocol.corner / rate).filter(&trace.position);
        let velocity = central_differences(&position, rate);
        let acceleration = central_differences(&velocity, rate);
        let when = |holds: fn(f64) -> bool, value: fn(f64) -> f64| -> Vec<f64> {
            velocity.iter().map(|v| if holds(*v) { value(*v) } else { 0.0 }).collect()
        };
        let forward: fn(f64) -> bool = |v| v > 0.0;
        let backward: fn(f64) -> bool = |v| v < 0.0;
        let mut columns = vec![acceleration];
        match law {
            FrictionLaw::Symmetric => {
                columns.push(velocity.clone());
                columns.push(when(|v| v != 0.0, f64::signum));
                columns.push(vec![1.0; velocity.len()]);
            }
            FrictionLaw::PerDirection => {
                columns.push(when(forward, |v| v));
                columns.push(when(backward, |v| v));
                columns.push(when(forward, |_| 1.0));
                columns.push(when(backward, |_| 1.0));
            }
        }
        let columns: Vec<DVector<f64>> =
            columns.iter().map(|column| DVector::from_vec(protocol.decimated(column))).collect();
        Ok(Regression {
            columns: DMatrix::from_columns(&columns),
            force: DVector::from_vec(protocol.decimated(&trace.force)),
        })
    }

    /// Coefficients by least squares; `None` where the record does not tell the columns apart.
    pub fn solve(&self) -> Option<DVector<f64>> {
        let normal = self.columns.tr_mul(&self.columns);
        Some(normal.cholesky()?.solve(&self.columns.tr_mul(&self.force)))
    }

    /// norm(F - F_model) / norm(F) with these coefficients, which may come from another record.
    pub fn relative_error(&self, coefficients: &DVector<f64>) -> f64 {
        (&self.force - &self.columns * coefficients).norm() / self.force.norm()
    }
}

impl Protocol {
    fn decimated(&self, signal: &[f64]) -> Vec<f64> {
        let (ripple, order, corner) = DECIMATION;
        let filter = ZeroPhase::chebyshev(order, ripple, 0.5 * corner / self.factor as f64);
        filter.filter(&signal[self.dropped..]).into_iter().step_by(self.factor).collect()
    }

    /// norm(missing force) / norm(F) of a hypothesis on a record without a force cell, prepared and
    /// thinned out like the regression.
    pub fn relative_error(
        &self,
        hypothesis: &Hypothesis,
        trace: &Trace,
        model: &StageModel,
    ) -> Result<f64, IdentifyError> {
        let rate = rate_of(trace)?;
        let mut smooth = trace.clone();
        smooth.position = ZeroPhase::butterworth(4, self.corner / rate).filter(&trace.position);
        smooth.force_cell.fill(f64::NAN);
        let measured = Measured::new(&smooth, model, "the record")?;
        let left = hypothesis.missing_unfiltered(&measured, Sides::CARRIAGE)?;
        let norm = |signal: &[f64]| {
            self.decimated(signal).iter().map(|value| value * value).sum::<f64>().sqrt()
        };
        Ok(norm(&left.carriage) / norm(&trace.force))
    }
}

fn rate_of(trace: &Trace) -> Result<f64, IdentifyError> {
    let samples = trace.len();
    if samples < MIN_SAMPLES {
        return Err(IdentifyError::TooShort {
            name: "the record".to_owned(),
            samples,
            least: MIN_SAMPLES,
        });
    }
    if !trace.force.iter().chain(&trace.position).all(|value| value.is_finite()) {
        return Err(IdentifyError::NoForce { name: "the record".to_owned() });
    }
    Ok((samples - 1) as f64 / (trace.time[samples - 1] - trace.time[0]))
}

/// (x[k+1] - x[k-1]) rate / 2; the ends repeat their neighbours.
fn central_differences(values: &[f64], rate: f64) -> Vec<f64> {
    let last = values.len() - 2;
    (0..values.len())
        .map(|k| {
            let k = k.clamp(1, last);
            0.5 * (values[k + 1] - values[k - 1]) * rate
        })
        .collect()
}

/// Lowpass of second-order sections, run forward and backward: no phase, the square of the gain.
#[derive(Clone, Debug)]
struct ZeroPhase {
    /// Gain at zero frequency of the whole.
    gain: f64,
    sections: Vec<Section>,
}

/// b (1 + z^-1)^2 / (1 + a1 z^-1 + a2 z^-2) with gain 1 at zero frequency.
#[derive(Clone, Copy, Debug)]
struct Section {
    input: f64,
    feedback: [f64; 2],
}

impl Section {
    /// w2 / (s^2 + d s + w2), corner at s = j, by the bilinear transform with prewarping at
    /// `corner` (share of the rate).
    fn new(d: f64, w2: f64, corner: f64) -> Section {
        let k = (PI * corner).tan();
        let norm = (1.0 + d * k + w2 * k * k).recip();
        Section {
            input: w2 * k * k * norm,
            feedback: [2.0 * (w2 * k * k - 1.0) * norm, (1.0 - d * k + w2 * k * k) * norm],
        }
    }

    /// In place, from the steady state of the first value.
    fn run(&self, values: &mut [f64]) {
        let [a1, a2] = self.feedback;
        let first = values.first().copied().unwrap_or(0.0);
        let mut late = (self.input - a2) * first;
        let mut early = (2.0 * self.input - a1) * first + late;
        for value in values {
            let output = self.input * *value + early;
            early = 2.0 * self.input * *value - a1 * output + late;
            late = self.input * *value - a2 * output;
            *value = output;
        }
    }
}

impl ZeroPhase {
    /// Even order; `corner` as a share of the rate, where each run has 3 dB. Poles:
    /// Butterworth 1930.
    fn butterworth(order: usize, corner: f64) -> ZeroPhase {
        let sections =
            angles(order).map(|angle| Section::new(2.0 * angle.sin(), 1.0, corner)).collect();
        ZeroPhase { gain: 1.0, sections }
    }

    /// Chebyshev filter of the first kind, even order, `ripple` in dB up to `corner`; each run has
    /// the gain -ripple at zero frequency.
    fn chebyshev(order: usize, ripple: f64, corner: f64) -> ZeroPhase {
        let epsilon = (10f64.powf(0.1 * ripple) - 1.0).sqrt();
        let mu = epsilon.recip().asinh() / order as f64;
        let sections = angles(order)
            .map(|angle| {
                let (real, imaginary) = (mu.sinh() * angle.sin(), mu.cosh() * angle.cos());
                Section::new(2.0 * real, real * real + imaginary * imaginary, corner)
            })
            .collect();
        ZeroPhase { gain: (1.0 + epsilon * epsilon).sqrt().recip(), sections }
    }

    fn once(&self, values: &mut [f64]) {
        for section in &self.sections {
            section.run(values);
        }
        values.iter_mut().for_each(|value| *value *= self.gain);
    }

    /// Forward and backward, with the ends continued by their point reflection over three times the
    /// filter's length.
    fn filter(&self, signal: &[f64]) -> Vec<f64> {
        let count = signal.len();
        let edge = (3 * (2 * self.sections.len() + 1)).min(count.saturating_sub(1));
        let mut values: Vec<f64> = (1..=edge)
            .rev()
            .map(|k| 2.0 * signal[0] - signal[k])
            .chain(signal.iter().copied())
            .chain((1..=edge).map(|k| 2.0 * signal[count - 1] - signal[count - 1 - k]))
            .collect();
        for _ in 0..2 {
            self.once(&mut values);
            values.reverse();
        }
        values[edge..edge + count].to_vec()
    }
}

/// Angles of the upper poles of an even order from the imaginary axis.
fn angles(order: usize) -> impl Iterator<Item = f64> {
    (0..order / 2).map(move |k| PI * (2 * k + 1) as f64 / (2 * order) as f64)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// Gain of the filter at a frequency (share of the rate), from the middle of a long sine.
    fn gain(filter: &ZeroPhase, frequency: f64) -> f64 {
        let signal: Vec<f64> =
            (0..8001).map(|k| (TAU * frequency * (k as f64 - 4000.0)).cos()).collect();
        filter.filter(&signal)[4000]
    }

    /// Frequency of the analog prototype, in corners, that the bilinear transform maps to
    /// `frequency`.
    fn warped(frequency: f64, corner: f64) -> f64 {
        (PI * frequency).tan() / (PI * corner).tan()
    }

    #[test]
    fn butterworth_has_the_gain_of_its_closed_form_squared() {
        for corner in [0.1, 0.04] {
            let filter = ZeroPhase::butterworth(4, corner);
            for frequency in [0.0, 0.02, corner, 0.15, 0.2] {
                let expected = (1.0 + warped(frequency, corner).powi(8)).recip();
                let found = gain(&filter, frequency);
                assert!(
                    (found - expected).abs() < 1e-9,
                    "{frequency}: {found}, expected {expected}"
                );
            }
        }
    }

    #[test]
    fn chebyshev_has_the_gain_of_its_closed_form_squared() {
        let corner = 0.04;
        let filter = ZeroPhase::chebyshev(8, 0.05, corner);
        let epsilon_squared = 10f64.powf(0.005) - 1.0;
        for frequency in [0.0, 0.01, 0.03, 0.0385, corner, 0.045, 0.06] {
            let x = warped(frequency, corner);
            let polynomial =
                if x <= 1.0 { (8.0 * x.acos()).cos() } else { (8.0 * x.acosh()).cosh() };
            let expected = (1.0 + epsilon_squared * polynomial * polynomial).recip();
            let found = gain(&filter, frequency);
            assert!((found - expected).abs() < 1e-6, "{frequency}: {found}, expected {expected}");
        }
    }

    #[test]
    fn a_constant_passes_unchanged_up_to_the_ends_and_a_line_inside() {
        let filter = ZeroPhase::butterworth(4, 0.1);
        assert!(filter.filter(&[3.0; 200]).iter().all(|value| (value - 3.0).abs() < 1e-12));
        let line: Vec<f64> = (0..500).map(|k| 3.0 + 0.25 * f64::from(k)).collect();
        for (found, given) in filter.filter(&line).iter().zip(&line).skip(100).take(300) {
            assert!((found - given).abs() < 1e-9, "{found} {given}");
        }
    }

    /// A drive with known coefficients, 1 kHz, force of the same sample. v goes with sin^3, so that
    /// both ends are at rest: the protocol's filters start from a constant.
    fn drive(viscous: [f64; 2], coulomb: [f64; 2]) -> Trace {
        let mut trace = Trace::default();
        for k in 0..=8000 {
            let t = 1e-3 * f64::from(k);
            let w = TAU * 0.75;
            let x = 0.05 * ((w * t).cos() - (3.0 * w * t).cos() / 9.0);
            let v = 0.05 * w * ((3.0 * w * t).sin() / 3.0 - (w * t).sin());
            let a = 0.05 * w * w * ((3.0 * w * t).cos() - (w * t).cos());
            let way = usize::from(v < 0.0);
            trace.time.push(t);
            trace.position.push(x);
            trace.force.push(95.0 * a + viscous[way] * v + coulomb[way] * v.signum() - 3.0);
            trace.force_cell.push(f64::NAN);
        }
        trace
    }

    #[test]
    fn regression_recovers_the_drive_that_made_the_record() {
        let one =
            Regression::new(&drive([200.0; 2], [20.0; 2]), FrictionLaw::Symmetric, EMPS).unwrap();
        let found = one.solve().unwrap();
        for (found, expected) in found.iter().zip([95.0, 200.0, 20.0, -3.0]) {
            assert!(
                (found - expected).abs() < 2e-3 * expected.abs(),
                "{found}, expected {expected}"
            );
        }
        assert!(one.relative_error(&found) < 2e-3);
        let other = drive([167.0, 240.0], [20.0, 21.0]);
        let two = Regression::new(&other, FrictionLaw::PerDirection, EMPS).unwrap();
        for (found, expected) in two.solve().unwrap().iter().zip([95.0, 167.0, 240.0, 17.0, -24.0])
        {
            assert!(
                (found - expected).abs() < 2e-3 * expected.abs(),
                "{found}, expected {expected}"
            );
        }
        let wrong = Regression::new(&other, FrictionLaw::Symmetric, EMPS).unwrap();
        assert!(wrong.relative_error(&wrong.solve().unwrap()) > 0.02);
    }

    #[test]
    fn a_record_that_is_too_short_or_has_no_force_is_refused() {
        let mut trace = drive([200.0; 2], [20.0; 2]);
        trace.force.fill(f64::NAN);
        let none = Regression::new(&trace, FrictionLaw::Symmetric, EMPS).unwrap_err().to_string();
        assert!(none.contains("force"), "{none}");
        let short = Regression::new(&Trace::default(), FrictionLaw::Symmetric, EMPS)
            .unwrap_err()
            .to_string();
        assert!(short.contains("0 samples") && short.contains("1000"), "{short}");
    }
}
