//! Force over small displacements, as the paper's Figures 4 and 5: slow loops of one guide on the
//! rig.
//!
//! The rig moves back and forth so slowly that acceleration and viscous forces vanish, and dwells
//! at both tips. Effective stiffness is, as the paper defines it, the total force difference over
//! the total position difference, here between the dwells. From stiffness and loop area follow
//! frequency and damping of the Dahl resonance of the stage.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};

use friction_stage_core::control::Gains;

use super::specimen::{
    LabError, LabRecording, MeasuredValue, Row, SERVO_BANDWIDTH, Settings, Specimen, mean, rest,
    within_motor,
};

/// Amplitudes of the paper's loops, m (sections 2 and 3).
pub const PAPER_AMPLITUDES: [f64; 4] = [10e-9, 1e-6, 40e-6, 420e-6];
/// Amplitudes of the curves over amplitude, m: 10 nm to 1 mm.
pub const AMPLITUDES: [f64; 12] =
    [10e-9, 30e-9, 100e-9, 300e-9, 1e-6, 3e-6, 10e-6, 20e-6, 40e-6, 100e-6, 420e-6, 1e-3];
/// Standard error of the force difference that the dwells are long enough for, relative.
const STIFFNESS_ERROR: f64 = 0.01;
/// Up to this amplitude, m, the guide is a spring and the servo can be quiet; from `AREA_FROM` on
/// the loop area counts.
const QUIET_TO: f64 = 5e-6;
pub(super) const AREA_FROM: f64 = 200e-9;
/// Parts of the proportional and integral gain of the 60 Hz servo in the quiet one, and its
/// lowpass, Hz; no derivative.
///
/// Assumed: encoder noise of 1 nm through the derivative shakes the carriage at about 0.1 µm/s, as
/// fast as a loop of 1 µm moves and far enough to relax a bristle that breaks away at 0.1 µm. A
/// spring needs no derivative to be held.
const QUIET_SERVO: (f64, f64, f64) = (0.1, 0.5, 60.0);
/// Largest speed of a loop, m/s, and time of a quick conditioning travel, s. Assumed: a tenth of
/// the usual Stribeck velocity.
const FASTEST: f64 = 0.5e-3;
const QUICK: f64 = 0.5;
/// Samples of force and position are averaged over this many parts of a cycle before the loop is
/// integrated.
const PARTS: usize = 800;
/// Most samples of a loop that are kept for a recording.
const KEPT: usize = 400_000;

/// Timing of a loop, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopTiming {
    /// From tip to tip.
    pub travel: f64,
    /// At a tip before the force is averaged.
    pub settle: f64,
    /// At a tip while the force is averaged.
    pub measure: f64,
    /// Whole cycles that count, after one that does not.
    pub cycles: usize,
    /// Quick cycles without dwells before them, which bring the bristles from rest onto the
    /// symmetric loop.
    pub conditioning: usize,
}

/// A measured hysteresis loop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HysteresisLoop {
    /// Half of the measured distance between the dwells, m.
    pub amplitude: f64,
    /// N/m
    pub stiffness: MeasuredValue,
    /// J per cycle.
    pub area: MeasuredValue,
    /// Whether the area stands out of the noise and of the servo's own shaking.
    pub area_is_resolved: bool,
    /// Half of the force difference between the dwells, N.
    pub tip_force: MeasuredValue,
    /// Position (m) and force (N) around the loop.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub points: Vec<(f64, f64)>,
}

/// Loops over amplitude, ascending.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DahlCurves {
    /// Name of the specimen.
    pub name: String,
    /// Measured loops of one guide.
    pub loops: Vec<HysteresisLoop>,
    /// What the loops say of the stage, one per loop.
    pub resonances: Vec<DahlResonance>,
}

/// Stage on its guides as a spring with hysteresis, from the loop of one guide.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct DahlResonance {
    /// m
    pub amplitude: f64,
    /// Stiffness of all guides, N/m.
    pub stiffness: f64,
    /// sqrt(k/m)/(2 pi), Hz.
    pub frequency: f64,
    /// W/(2 pi k A^2): the viscous damper that loses as much per cycle at resonance (Jacobsen,
    /// Trans. ASME 52, 1930).
    pub damping: MeasuredValue,
}

impl LoopTiming {
    /// Slow enough for the amplitude, m, and long enough for the noise of the force cell, N, at
    /// about `stiffness` N/m; `break_away` distance in m, `rate` of the samples in Hz.
    ///
    /// Assumed limits: at most 0.5 mm/s, a tenth of the usual Stribeck velocity; and a travel time
    /// that keeps the share of the bristle damping in the loop area near 3 % from 300 nm on. Below
    /// that the area drowns in noise anyway.
    pub fn slow(
        amplitude: f64,
        stiffness: f64,
        noise: f64,
        rate: f64,
        break_away: f64,
    ) -> LoopTiming {
        // Peak velocity of the minimum-jerk travel is 15/8 of the mean.
        let by_speed = 1.875 * 2.0 * amplitude / FASTEST;
        let by_damping = match amplitude {
            a if a < AREA_FROM => 0.2,
            a if a < QUIET_TO => 20.0,
            _ => 6.0,
        };
        let needed = (2.0 * noise / (STIFFNESS_ERROR * 2.0 * stiffness * amplitude)).powi(2);
        let measure = if needed > 5000.0 { 0.7 } else { 0.25 };
        let cycles = (needed / (2.0 * measure * rate)).ceil().clamp(2.0, 1e5) as usize;
        let settle = if amplitude < QUIET_TO { 0.5 } else { 0.3 };
        // A bristle forgets over its break-away distance, and a cycle travels four amplitudes: here
        // down to exp(-4).
        let conditioning =
            if amplitude < AREA_FROM { 0.0 } else { (break_away / amplitude).ceil().min(300.0) };
        let conditioning = conditioning as usize;
        LoopTiming { conditioning, travel: by_speed.max(by_damping), settle, measure, cycles }
    }
}

/// Measures loops at `amplitudes` (ascending, m) and derives the stage's resonance; `tick` is
/// called after each. Recordings hold the paper's amplitudes, or all where there are no more than
/// those, at most 100 s of each.
pub fn dahl(
    specimen: &Specimen,
    settings: &Settings,
    amplitudes: &[f64],
    tick: &dyn Fn(),
) -> Result<(DahlCurves, Vec<LabRecording>), LabError> {
    let guide = specimen.guide()?;
    let break_away = specimen.break_away_distance()?;
    let guides = specimen.stage.guides.len() as f64;
    let mut curves =
        DahlCurves { name: specimen.name.clone(), loops: Vec::new(), resonances: Vec::new() };
    let mut recordings = Vec::new();
    for &amplitude in amplitudes {
        let expected = guide.effective_stiffness(amplitude);
        let timing = LoopTiming::slow(
            amplitude,
            expected,
            specimen.rig.force_cell.noise,
            settings.rates.control(),
            break_away,
        );
        let servo = specimen.servo(SERVO_BANDWIDTH);
        let servo = if amplitude < QUIET_TO { quiet(servo) } else { servo };
        let (mut found, recording) =
            hysteresis_loop(specimen, settings, servo, amplitude, &timing)?;
        found.area_is_resolved =
            amplitude >= AREA_FROM && found.area.standard_error < 0.2 * found.area.value;
        curves.resonances.push(resonance(&found, guides, specimen.stage.mass));
        curves.loops.push(found);
        if PAPER_AMPLITUDES.contains(&amplitude) || amplitudes.len() <= PAPER_AMPLITUDES.len() {
            recordings.push(recording);
        }
        tick();
    }
    Ok((curves, recordings))
}

/// The servo of the smallest loops, from that of the larger ones.
pub(super) fn quiet(servo: Gains) -> Gains {
    let (p, i, lowpass_frequency) = QUIET_SERVO;
    Gains { p: p * servo.p, i: i * servo.i, d: 0.0, lowpass_frequency, ..servo }
}

/// Equivalent spring and damper of a stage of `mass` kg on so many guides with this loop.
pub fn resonance(of: &HysteresisLoop, guides: f64, mass: f64) -> DahlResonance {
    let stiffness = guides * of.stiffness.value;
    let per_area = 1.0 / (2.0 * PI * of.stiffness.value * of.amplitude * of.amplitude);
    DahlResonance {
        amplitude: of.amplitude,
        stiffness,
        frequency: (stiffness / mass).sqrt() / (2.0 * PI),
        damping: MeasuredValue {
            value: per_area * of.area.value,
            standard_error: per_area * of.area.standard_error,
        },
    }
}

/// One loop on the rig: from rest to the upper tip, one cycle to forget the start, then the cycles
/// that count.
pub fn hysteresis_loop(
    specimen: &Specimen,
    settings: &Settings,
    servo: Gains,
    amplitude: f64,
    timing: &LoopTiming,
) -> Result<(HysteresisLoop, LabRecording), LabError> {
    let rate = settings.rates.control();
    let samples = |seconds: f64| (seconds * rate).round().max(1.0) as usize;
    let (travel, settle, measure) =
        (samples(timing.travel), samples(timing.settle), samples(timing.measure));
    let half = travel + settle + measure;
    let mut points = vec![rest(0.0, 0.0)];
    let mut index = 0;
    let mut tip = amplitude;
    let quick = samples(QUICK.max(2.0 * amplitude * 1.875 / FASTEST));
    for _ in 0..2 * timing.conditioning {
        index += quick;
        points.push(rest(index as f64 / rate, tip));
        tip = -tip;
    }
    let start = index + 3 * half;
    // To the upper tip, then for each half cycle to the other tip and a dwell there.
    for _ in 0..2 * (timing.cycles + 1) + 1 {
        points.push(rest((index + travel) as f64 / rate, tip));
        points.push(rest((index + half) as f64 / rate, tip));
        index += half;
        tip = -tip;
    }
    let mut rig = specimen.on_rig(settings, servo, points)?;
    let mut rows = Vec::with_capacity(KEPT.min(index));
    // Sums over the cycles: position and force per part of a cycle; deviations at the tips for the
    // noise.
    let cycle = 2 * half;
    let mut parts = vec![(0.0, 0.0, 0.0f64); PARTS.min(cycle)];
    let mut tips = [Vec::new(), Vec::new()];
    let count = parts.len();
    for k in 0..index {
        let row = Row::of(&rig.cycle()?);
        if rows.len() < KEPT {
            rows.push(row);
        }
        let Some(counted) = k.checked_sub(start) else { continue };
        let phase = counted % cycle;
        let part = &mut parts[phase * count / cycle];
        let (position, force) = (row.sample.position, row.sample.force_cell);
        *part = (part.0 + position, part.1 + force, part.2 + 1.0);
        let (side, within) = (phase / half, phase % half);
        if within >= travel + settle {
            tips[side].push((position, force));
        }
    }
    within_motor("dahl", specimen, &specimen.rig, &rows)?;
    let [lower, upper] =
        tips.map(|tip| (mean(tip.iter().map(|x| x.0)), mean(tip.iter().map(|x| x.1))));
    let position = upper.0.value - lower.0.value;
    let force = upper.1.value - lower.1.value;
    let position_error = upper.0.standard_error.hypot(lower.0.standard_error);
    let force_error = upper.1.standard_error.hypot(lower.1.standard_error);
    let stiffness = force / position;
    let points: Vec<(f64, f64)> = parts.iter().map(|(x, f, n)| (x / n, f / n)).collect();
    let next = |k: usize| points[(k + 1) % points.len()];
    let steps =
        points.iter().enumerate().map(|(k, here)| (next(k).0 - here.0, 0.5 * (next(k).1 + here.1)));
    let area = steps.clone().map(|(step, force)| step * force).sum::<f64>();
    let per_part = (parts.iter().map(|part| part.2).sum::<f64>() / count as f64).sqrt();
    let noise = force_error / 2f64.sqrt() * ((measure * timing.cycles) as f64).sqrt();
    let area_error = noise / per_part * steps.map(|(step, _)| step * step).sum::<f64>().sqrt();
    let found = HysteresisLoop {
        amplitude: 0.5 * position,
        stiffness: MeasuredValue {
            value: stiffness,
            standard_error: stiffness.abs()
                * (force_error / force).hypot(position_error / position),
        },
        area: MeasuredValue { value: area, standard_error: area_error },
        area_is_resolved: area_error < 0.2 * area,
        tip_force: MeasuredValue { value: 0.5 * force, standard_error: 0.5 * force_error },
        points,
    };
    let name = format!("dahl_{}", length(amplitude));
    Ok((found, LabRecording { name, model: specimen.rig.clone(), settings: *settings, rows }))
}

/// A length as names of files have it: `10nm`, `1um`, `1000um`.
fn length(metres: f64) -> String {
    if metres < 0.999e-6 {
        format!("{:.0}nm", metres * 1e9)
    } else {
        format!("{:.0}um", metres * 1e6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// k = Fs tanh(sigma0 A/Fs)/A and W = 4 A Fs - 4 Fs^2/sigma0 tanh(sigma0 A/Fs), with noise on
    /// both sensors.
    #[test]
    fn loops_have_the_stiffness_and_the_area_of_the_closed_form() {
        for name in ["guide_1", "guide_2"] {
            let specimen = Specimen::of_guide(name).unwrap();
            let guide = specimen.guide().unwrap();
            let (curves, _) =
                dahl(&specimen, &Settings::default(), &AMPLITUDES[2..], &|| ()).unwrap();
            for (found, resonance) in curves.loops.iter().zip(&curves.resonances) {
                let (k, area) =
                    (guide.effective_stiffness(found.amplitude), guide.loop_area(found.amplitude));
                let error = 4.0 * found.stiffness.standard_error + 0.005 * k;
                assert!(
                    (found.stiffness.value - k).abs() < error,
                    "{name} {:?}: {:?}, {k}",
                    found.amplitude,
                    found.stiffness
                );
                if found.amplitude > 0.9e-6 {
                    // The bristle damping adds 3 % at 1 µm, as the travel time is chosen for.
                    let share = 0.05;
                    let error = 4.0 * found.area.standard_error + share * area;
                    assert!(
                        (found.area.value - area).abs() < error,
                        "{name} {:?}: {:?}, {area}",
                        found.amplitude,
                        found.area
                    );
                }
                let frequency = (4.0 * k / 40.0).sqrt() / (2.0 * PI);
                assert!(
                    (resonance.frequency / frequency - 1.0).abs() < 0.02,
                    "{name} {resonance:?}: {frequency}"
                );
            }
        }
    }

    #[test]
    fn ten_nanometres_are_measured_within_their_stated_error() {
        let specimen = Specimen::of_guide("guide_1").unwrap();
        let guide = specimen.guide().unwrap();
        let (curves, _) = dahl(&specimen, &Settings::default(), &[10e-9], &|| ()).unwrap();
        let k = curves.loops[0].stiffness;
        assert!(k.standard_error < 1.5 * STIFFNESS_ERROR * k.value, "{k:?}");
        assert!((k.value - guide.stiffness).abs() < 4.0 * k.standard_error, "{k:?}");
    }

    #[test]
    fn lengths_read_well() {
        assert_eq!([10e-9, 1e-6, 420e-6, 1e-3].map(length), ["10nm", "1um", "420um", "1000um"]);
    }
}
