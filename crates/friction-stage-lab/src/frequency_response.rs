//! Response of the stage to a sinusoidal force at several amplitudes: stiffness of the guides below
//! the Dahl resonance, mass above.
//!
//! Stepped sine without a controller: the guides hold the stage while the force stays below
//! break-away. Force cell and encoder are projected on the sine, which gives the dynamic stiffness
//! D = F/X; with friction it depends on the amplitude.

use std::f64::consts::PI;

use friction_stage_core::numerics::sinusoid::SinusoidSums;
use nalgebra::Complex;
use serde::{Deserialize, Serialize};

use friction_stage_core::plant::Stage;

use super::specimen::{LabError, LabRecording, Row, Settings, Specimen, within_motor};

/// Force amplitudes as shares of the static friction of all guides.
const LEVELS: [f64; 4] = [0.01, 0.1, 0.3, 0.6];
/// First and last frequency, Hz, and their number, spaced evenly in the logarithm.
const FREQUENCIES: (f64, f64, usize) = (5.0, 250.0, 28);
/// Periods over which the sine grows and fades, so that it leaves no velocity behind.
const RAMP: f64 = 3.0;
/// Time to reach the steady state, s and periods, whichever is longer.
const SETTLE: (f64, f64) = (0.15, 4.0);
/// Time that is projected, s and periods, whichever is longer.
const MEASURE: (f64, f64) = (0.25, 5.0);
/// Parts of that time that are projected by themselves for the coherence: one period or more.
const PARTS: usize = 5;

/// The responses of one stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrequencyResponse {
    /// Name of the specimen.
    pub name: String,
    /// Responses at ascending force amplitudes.
    pub levels: Vec<ResponseLevel>,
    /// kg, from the dynamic stiffness at the highest frequencies and the largest force, where noise
    /// matters least.
    pub mass: f64,
}

/// The response at one force amplitude.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResponseLevel {
    /// N
    pub force: f64,
    /// Response at ascending frequencies.
    pub points: Vec<ResponsePoint>,
    /// Where the dynamic stiffness has no real part; `None` where the stage has no spring left.
    pub resonance: Option<Resonance>,
}

/// The response at one frequency.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResponsePoint {
    /// Hz
    pub frequency: f64,
    /// Amplitude of the position, m.
    pub amplitude: f64,
    /// Real and imaginary part of F/X, N/m.
    pub stiffness: (f64, f64),
    /// Phase of X/F, degrees: 0 of a spring, -90 of a damper, -180 of a mass.
    pub phase: f64,
    /// Coherence of force and position over parts of the time that is projected, 0 to 1: what of
    /// the position follows the force, and is neither noise nor drift.
    pub coherence: f64,
}

/// Where the springs of the guides and the mass cancel: the dynamic stiffness has no real part.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Resonance {
    /// Hz
    pub frequency: f64,
    /// Amplitude of the position there, m.
    pub amplitude: f64,
    /// Damping ratio Im D / (2 m w^2).
    pub damping: f64,
}

impl FrequencyResponse {
    /// Number of calls of `tick` in [`frequency_response`].
    pub const TICKS: usize = LEVELS.len();
}

/// Sweeps the stage; `tick` is called after each force amplitude.
pub fn frequency_response(
    specimen: &Specimen,
    settings: &Settings,
    tick: &dyn Fn(),
) -> Result<(FrequencyResponse, LabRecording), LabError> {
    let model = &specimen.stage;
    let break_away: f64 = model.resolved_guides()?.iter().map(|guide| guide.static_force).sum();
    let mut stage = Stage::new(model, settings.rates, settings.seed)?;
    let mut rows = Vec::new();
    let mut levels = Vec::new();
    for share in LEVELS {
        let force = share * break_away;
        let points: Vec<ResponsePoint> =
            frequencies().map(|frequency| point(&mut stage, &mut rows, force, frequency)).collect();
        levels.push(ResponseLevel { force, points, resonance: None });
        tick();
    }
    within_motor("frequency-response", specimen, model, &rows)?;
    let mass = line_mass(&levels[LEVELS.len() - 1].points);
    for level in &mut levels {
        level.resonance = resonance(&level.points, mass);
    }
    let name = "frequency_response".to_owned();
    let recording = LabRecording { name, model: model.clone(), settings: *settings, rows };
    Ok((FrequencyResponse { name: specimen.name.clone(), levels, mass }, recording))
}

fn frequencies() -> impl Iterator<Item = f64> {
    let (first, last, count) = FREQUENCIES;
    (0..count).map(move |k| first * (last / first).powf(k as f64 / (count - 1) as f64))
}

/// One frequency: ramp, steady state, projection, ramp.
fn point(stage: &mut Stage, rows: &mut Vec<Row>, force: f64, frequency: f64) -> ResponsePoint {
    let rate = stage.rates().control();
    let ramp = RAMP / frequency;
    let settle = ramp + SETTLE.0.max(SETTLE.1 / frequency);
    let periods = (MEASURE.0.max(MEASURE.1 / frequency) * frequency).ceil();
    let end = settle + periods / frequency;
    let (mut position, mut cell) = (SinusoidSums::default(), SinusoidSums::default());
    let mut parts: Vec<[SinusoidSums; 2]> = vec![Default::default(); PARTS];
    for k in 0..((end + ramp) * rate).ceil() as usize {
        let time = k as f64 / rate;
        let envelope = (time / ramp).min((end + ramp - time) / ramp).clamp(0.0, 1.0);
        let command = envelope * force * (2.0 * PI * frequency * time).sin();
        let sample = stage.sample();
        if time >= settle && time < end {
            let phase = 2.0 * PI * frequency * time;
            position.add(phase, sample.position);
            cell.add(phase, sample.force_cell);
            let part = ((time - settle) / (end - settle) * PARTS as f64) as usize;
            let [of_cell, of_position] = &mut parts[part.min(PARTS - 1)];
            of_cell.add(phase, sample.force_cell);
            of_position.add(phase, sample.position);
        }
        rows.push(Row { sample, terms: None, force: command });
        stage.advance(command);
    }
    // The cell reads, at a sample, the force held over the interval that ends there: half a sample
    // late, and its fundamental is smaller by the hold.
    let lag = PI * frequency / rate;
    let hold = lag.sin() / lag;
    let driving = phasor(&cell) * Complex::from_polar(hold, lag);
    let stiffness = driving / phasor(&position);
    let pairs: Vec<_> = parts.iter().map(|[cell, x]| (phasor(cell), phasor(x))).collect();
    ResponsePoint {
        frequency,
        amplitude: phasor(&position).norm(),
        stiffness: (stiffness.re, stiffness.im),
        phase: -stiffness.arg().to_degrees(),
        coherence: coherence(&pairs),
    }
}

/// Coherence of phasors of input and output over parts of a record: |sum X* Y|^2 / (sum |X|^2 sum
/// |Y|^2) (Bendat, Piersol, Random Data, 4th ed. 2010, section 6.1).
pub(super) fn coherence(parts: &[(Complex<f64>, Complex<f64>)]) -> f64 {
    let cross: Complex<f64> = parts.iter().map(|(x, y)| x.conj() * y).sum();
    let power = |of: fn(&(Complex<f64>, Complex<f64>)) -> f64| parts.iter().map(of).sum::<f64>();
    let (input, output) = (power(|(x, _)| x.norm_sqr()), power(|(_, y)| y.norm_sqr()));
    if input * output > 0.0 { cross.norm_sqr() / (input * output) } else { 0.0 }
}

/// a + i b of a sin + b cos; zero without enough samples.
fn phasor(sums: &SinusoidSums) -> Complex<f64> {
    sums.solve().map_or(Complex::new(0.0, 0.0), |found| Complex::new(found.sine, found.cosine))
}

/// Mass from Re D = k - m w^2 over the upper third of the frequencies.
fn line_mass(points: &[ResponsePoint]) -> f64 {
    let upper = &points[2 * points.len() / 3..];
    let count = upper.len() as f64;
    let square = |point: &ResponsePoint| (2.0 * PI * point.frequency).powi(2);
    let (x, y) = upper
        .iter()
        .fold((0.0, 0.0), |(x, y), p| (x + square(p) / count, y + p.stiffness.0 / count));
    let (cross, squares) = upper.iter().fold((0.0, 0.0), |(c, s), p| {
        (c + (square(p) - x) * (p.stiffness.0 - y), s + (square(p) - x).powi(2))
    });
    -cross / squares
}

/// Where Re D changes its sign, linear in the square of the frequency between two points.
fn resonance(points: &[ResponsePoint], mass: f64) -> Option<Resonance> {
    let pair =
        points.windows(2).find(|pair| pair[0].stiffness.0 > 0.0 && pair[1].stiffness.0 <= 0.0)?;
    let (a, b) = (&pair[0], &pair[1]);
    let share = a.stiffness.0 / (a.stiffness.0 - b.stiffness.0);
    let between = |of: fn(&ResponsePoint) -> f64| of(a) + share * (of(b) - of(a));
    let frequency = between(|point| point.frequency * point.frequency).sqrt();
    let w = 2.0 * PI * frequency;
    Some(Resonance {
        frequency,
        amplitude: between(|point| point.amplitude),
        damping: between(|point| point.stiffness.1) / (2.0 * mass * w * w),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coherence_falls_to_the_share_that_follows_the_force() {
        let one = Complex::new(1.0, 0.0);
        let parts = |turned: f64| {
            [(one, Complex::from_polar(2.0, 0.3 + turned)), (one, Complex::from_polar(2.0, 0.3))]
        };
        assert!((coherence(&parts(0.0)) - 1.0).abs() < 1e-12);
        // Two unit phasors at an angle: cos^2 of its half.
        assert!((coherence(&parts(1.0)) - 0.5f64.cos().powi(2)).abs() < 1e-12);
        assert_eq!(coherence(&[]), 0.0);
    }

    #[test]
    fn the_phase_goes_from_that_of_a_spring_to_that_of_a_mass_where_the_coherence_is_high() {
        let specimen = Specimen::of_guide("guide_1").unwrap();
        let (response, _) = frequency_response(&specimen, &Settings::default(), &|| ()).unwrap();
        let level = &response.levels[1];
        let (first, last) = (&level.points[0], &level.points[level.points.len() - 1]);
        assert!(first.phase > -30.0 && last.phase < -150.0, "{first:?} {last:?}");
        assert!(level.points.iter().all(|point| (0.9..=1.0 + 1e-12).contains(&point.coherence)));
        // The smallest force disappears in the noise of cell and encoder above the resonance.
        let faint = &response.levels[0].points[27];
        assert!(faint.coherence < last.coherence, "{faint:?}");
    }

    /// Far below break-away a guide is a spring sigma0 with a damper sigma1 + sigma2: a linear
    /// oscillator.
    #[test]
    fn small_amplitudes_show_the_linear_oscillator() {
        for name in ["guide_1", "guide_2"] {
            let specimen = Specimen::of_guide(name).unwrap();
            let guide = specimen.guide().unwrap();
            let (response, _) =
                frequency_response(&specimen, &Settings::default(), &|| ()).unwrap();
            assert!((response.mass / 40.0 - 1.0).abs() < 0.005, "{name}: {} kg", response.mass);
            let smallest = &response.levels[0];
            let found = smallest.resonance.unwrap();
            let k = 4.0 * guide.stiffness;
            let damping =
                4.0 * (guide.bristle_damping + guide.viscous_friction) / (2.0 * (k * 40.0).sqrt());
            assert!(
                (found.frequency / ((k / 40.0).sqrt() / (2.0 * PI)) - 1.0).abs() < 0.015,
                "{name} {found:?}"
            );
            assert!((found.damping / damping - 1.0).abs() < 0.05, "{name} {found:?}: {damping}");
            let low = &smallest.points[0];
            let dynamic = k - 40.0 * (2.0 * PI * low.frequency).powi(2);
            assert!((low.stiffness.0 / dynamic - 1.0).abs() < 0.02, "{name} {low:?}: {dynamic}");
        }
    }
}
