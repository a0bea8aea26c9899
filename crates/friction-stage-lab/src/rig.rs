//! How far the measuring rig itself bends the curves: coupling stiffness, force-cell noise, speed,
//! servo.
//!
//! Each row measures something whose true value is known in closed form on a rig with one property
//! changed: the effective stiffness and loop area at 1 µm, the friction at a speed where F(v) may
//! fall.

use std::borrow::Cow;

use serde::{Deserialize, Serialize};

use super::dahl::{HysteresisLoop, LoopTiming, hysteresis_loop};
use super::specimen::{LabError, LabRecording, SERVO_BANDWIDTH, Settings, Specimen};
use super::stribeck::stribeck;
use friction_stage_core::control::Gains;
use friction_stage_core::model::Guide;

/// Coupling stiffness over the guide's Dahl stiffness; the paper: roughly two orders of magnitude
/// (section 1.2).
pub const COUPLINGS: [f64; 5] = [10.0, 30.0, 100.0, 300.0, 1000.0];
/// Noise of the force cell, N; the paper: 0.05 N.
pub const NOISES: [f64; 4] = [0.0, 0.05, 0.2, 0.5];
/// Time from tip to tip of the loop, s.
pub const TRAVELS: [f64; 5] = [20.0, 4.0, 1.0, 0.2, 0.05];
/// Bandwidth of the servo, Hz.
pub const SERVOS: [f64; 3] = [20.0, 60.0, 120.0];
/// Amplitude of the loops, m, and speeds of the Stribeck points, m/s: 3 mm/s and two that fix the
/// viscous line.
const AMPLITUDE: f64 = 1e-6;
const SPEEDS: [f64; 3] = [3e-3, 0.2, 0.5];

/// What one setting of the rig does to the measurement; biases relative to the closed form, so 0.01
/// is 1 % too much.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RigBias {
    /// What was changed: `coupling`, `noise`, `travel`, `servo`.
    pub property: Cow<'static, str>,
    /// Setting of the property, in `unit`.
    pub value: f64,
    /// Unit of `value`: `times the guide`, `N`, `s` or `Hz`.
    pub unit: Cow<'static, str>,
    /// Stiffness at 1 µm against Fs tanh(sigma0 A/Fs)/A, summed over the bristles, with the encoder
    /// at the guide.
    pub stiffness_bias: f64,
    /// Its standard error, relative.
    pub stiffness_error: f64,
    /// The same if the position were taken at the motor, behind the coupling: x + F/kc.
    pub stiffness_bias_at_motor: f64,
    /// Area of the 1 µm loop against its closed form.
    pub area_bias: f64,
    /// Friction at 3 mm/s against g(v) + sigma2 v; `None` where not measured.
    pub friction_bias: Option<f64>,
    /// Scatter of the force cell at 3 mm/s, N; `None` where not measured.
    pub ripple: Option<f64>,
}

/// Number of calls of `tick` in [`rig`].
pub const RIG_TICKS: usize = COUPLINGS.len() + NOISES.len() + TRAVELS.len() + SERVOS.len();

/// Measures with every setting; `tick` is called after each. The recording is that of the paper's
/// rig.
pub fn rig(
    specimen: &Specimen,
    settings: &Settings,
    tick: &dyn Fn(),
) -> Result<(Vec<RigBias>, LabRecording), LabError> {
    let guide = specimen.guide()?;
    let bristles = specimen.bristles()?.ok_or_else(|| LabError::Signal {
        experiment: "rig",
        specimen: specimen.name.clone(),
        what: "has more effects than LuGre bristles, so no closed form to compare with".to_owned(),
    })?;
    let quick = LoopTiming { travel: 4.0, settle: 0.5, measure: 0.5, cycles: 2, conditioning: 40 };
    let mut biases = Vec::new();
    let mut kept = None;
    let mut add =
        |property, value, unit, of: &Specimen, timing: &LoopTiming, servo: Gains, speeds: bool| {
            let (found, recording) = hysteresis_loop(of, settings, servo, AMPLITUDE, timing)?;
            let friction = match speeds {
                true => Some(stribeck(of, settings, &SPEEDS, &|| ())?.0.points[3]),
                false => None,
            };
            let coupling =
                of.rig.coupling.as_ref().map_or(f64::INFINITY, |coupling| coupling.stiffness);
            biases.push(RigBias {
                friction_bias: friction
                    .map(|point| point.force.value / guide.steady_force(point.velocity) - 1.0),
                ripple: friction.map(|point| point.ripple),
                ..bias(property, value, unit, &found, &bristles, coupling)
            });
            kept.get_or_insert(recording);
            tick();
            Ok::<(), LabError>(())
        };
    // Coupling and force cell under the servo with which a loop of 1 µm is measured: the quick one
    // shakes the carriage, and bristles that break away early let go.
    let servo = specimen.servo(SERVO_BANDWIDTH);
    let as_curves = super::dahl::quiet(servo);
    for ratio in COUPLINGS {
        let mut changed = specimen.clone();
        if let Some(coupling) = &mut changed.rig.coupling {
            coupling.stiffness = ratio * guide.stiffness;
        }
        add("coupling", ratio, "times the guide", &changed, &quick, as_curves, true)?;
    }
    for noise in NOISES {
        let mut changed = specimen.clone();
        changed.rig.force_cell.noise = noise;
        add("noise", noise, "N", &changed, &quick, as_curves, true)?;
    }
    for travel in TRAVELS {
        add("travel", travel, "s", specimen, &LoopTiming { travel, ..quick }, servo, false)?;
    }
    for bandwidth in SERVOS {
        let slow =
            LoopTiming { travel: 20.0, settle: 0.5, measure: 0.5, cycles: 2, conditioning: 40 };
        add("servo", bandwidth, "Hz", specimen, &slow, specimen.servo(bandwidth), false)?;
    }
    let name = "rig".to_owned();
    let recording = kept.map(|recording| LabRecording { name, ..recording }).ok_or_else(|| {
        LabError::Signal {
            experiment: "rig",
            specimen: specimen.name.clone(),
            what: "has nothing to measure".to_owned(),
        }
    })?;
    Ok((biases, recording))
}

fn bias(
    property: &'static str,
    value: f64,
    unit: &'static str,
    found: &HysteresisLoop,
    bristles: &[Guide],
    coupling: f64,
) -> RigBias {
    let stiffness: f64 =
        bristles.iter().map(|bristle| bristle.effective_stiffness(found.amplitude)).sum();
    let area: f64 = bristles.iter().map(|bristle| bristle.loop_area(found.amplitude)).sum();
    let at_motor = found.tip_force.value / (found.amplitude + found.tip_force.value / coupling);
    RigBias {
        property: property.into(),
        value,
        unit: unit.into(),
        stiffness_bias: found.stiffness.value / stiffness - 1.0,
        stiffness_error: found.stiffness.standard_error / stiffness,
        stiffness_bias_at_motor: at_motor / stiffness - 1.0,
        area_bias: found.area.value / area - 1.0,
        friction_bias: None,
        ripple: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Behind a coupling of r times the guide's stiffness the two are springs in series: the
    /// reading is low by 1/(1 + r).
    #[test]
    fn position_behind_the_coupling_reads_springs_in_series() {
        let specimen = Specimen::of_guide("guide_1").unwrap();
        let (biases, _) = rig(&specimen, &Settings::default(), &|| ()).unwrap();
        for row in biases.iter().filter(|row| row.property == "coupling") {
            let series = 1.0 / (1.0 + 1.0 / row.value) - 1.0;
            assert!(
                (row.stiffness_bias_at_motor - series).abs() < 5.0 * row.stiffness_error + 0.01,
                "{row:?}: {series}"
            );
            assert!(row.stiffness_bias.abs() < 5.0 * row.stiffness_error + 0.01, "{row:?}");
        }
        for row in biases.iter().filter(|row| row.property == "noise") {
            assert!(row.stiffness_bias.abs() < 5.0 * row.stiffness_error + 0.01, "{row:?}");
            assert!((row.ripple.unwrap() - row.value).abs() < 0.03 * row.value + 0.02, "{row:?}");
        }
        // Slow loops show the servo, fast ones the bristle damping: pi-like share grows with speed.
        let areas: Vec<f64> =
            biases.iter().filter(|row| row.property == "travel").map(|row| row.area_bias).collect();
        assert!(areas[4] > areas[3] && areas[3] > areas[2], "{areas:?}");
        assert_eq!(biases.len(), RIG_TICKS);
    }
    /// Of several bristles the closed forms add up.
    #[test]
    fn a_guide_with_parallel_bristles_is_read_as_their_sum() {
        let specimen = Specimen::named("guide_1+distributed_bristles").unwrap();
        let bristles = specimen.bristles().unwrap().unwrap();
        assert_eq!(bristles.len(), 4);
        let (biases, _) = rig(&specimen, &Settings::default(), &|| ()).unwrap();
        let stiff = biases.iter().find(|row| row.property == "coupling" && row.value == 1000.0);
        let stiff = stiff.unwrap();
        assert!(stiff.stiffness_bias.abs() < 0.02, "{stiff:?}");
        assert!(stiff.friction_bias.unwrap().abs() < 0.02, "{stiff:?}");
    }
}
