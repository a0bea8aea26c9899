//! Hunting: does the controller's integral action drive the stage around its target, at which
//! amplitude and period?
//!
//! The stage stands at rest so near its target that the proportional gain cannot move it. The
//! integrator pushes until it breaks away; where friction falls with speed it may then jump past
//! the target, stick there, and so on (paper, section 2, on guides with a falling F(v); Olsson,
//! Astrom, IEEE TCST 9(4), 2001, on limit cycles of the kind).

use serde::{Deserialize, Serialize};

use friction_stage_core::control::{ControllerSettings, Gains};

use super::specimen::{
    LabError, LabRecording, Row, Settings, Specimen, closed_loop, rest, within_motor,
};

/// Bandwidths of the controller, Hz: the paper's, and softer ones, down to that of a position loop
/// without any hurry.
pub const BANDWIDTHS: [f64; 5] = [60.0, 10.0, 5.0, 3.0, 2.0];
/// Integral gain over that of the paper's kind of controller, whose integrator corner lies at a
/// tenth of the bandwidth.
pub const INTEGRALS: [f64; 2] = [1.0, 3.0];
/// Distance from the target at which the stage starts, as the proportional force there over the
/// static friction of the guides. Assumed: below 1, so that only the integrator can bring the stage
/// on.
const START: f64 = 0.5;
/// Time before the target appears, s.
const LEAD: f64 = 0.05;
/// Time at rest, s: in periods of the bandwidth, at least so long.
const HOLD: (f64, f64) = (400.0, 20.0);
/// Most samples that are kept for a recording.
const KEPT: usize = 60_000;
/// A motion at rest counts from this peak to peak on, m: far above the encoder's noise of 1 nm.
const SEEN: f64 = 30e-9;
/// Whole periods that make a cycle of an accident.
const PERIODS: usize = 3;

/// What the stage did at rest under one controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HuntingResult {
    /// Bandwidth of the controller, Hz.
    pub bandwidth: f64,
    /// Integral gain over that of [`Gains::from_bandwidth`].
    pub integral: f64,
    /// Position peak to peak over the last half of the rest, m.
    pub peak_to_peak: f64,
    /// The limit cycle; `None` where the stage comes to rest.
    pub cycle: Option<LimitCycle>,
    /// Time (s after the step) and error (m), thinned.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub points: Vec<(f64, f64)>,
}

/// A periodic motion around the target that does not die away.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LimitCycle {
    /// Half of peak to peak, m.
    pub amplitude: f64,
    /// s
    pub period: f64,
}

/// Runs the stage at each of `integrals` and `bandwidths`; `tick` is called after each. Recordings
/// hold the first 15 s.
pub fn hunting(
    specimen: &Specimen,
    settings: &Settings,
    bandwidths: &[f64],
    integrals: &[f64],
    tick: &dyn Fn(),
) -> Result<(Vec<HuntingResult>, Vec<LabRecording>), LabError> {
    let mut results = Vec::new();
    let mut recordings = Vec::new();
    let controllers = integrals
        .iter()
        .flat_map(|integral| bandwidths.iter().map(move |bandwidth| (*integral, *bandwidth)));
    for (integral, bandwidth) in controllers {
        let model = &specimen.stage;
        let rate = settings.rates.control();
        let hold = (HOLD.0 / bandwidth).max(HOLD.1);
        let paper = ControllerSettings::paper(model.mass, rate, model.motor.force_limit);
        let gains = Gains::from_bandwidth(bandwidth, model.mass);
        let gains = Gains { i: integral * gains.i, ..gains };
        // A step of the setpoint, without feedforward: the target simply lies there.
        let controller = ControllerSettings { gains, mass_feedforward: 0.0, ..paper };
        let break_away: f64 = model.resolved_guides()?.iter().map(|guide| guide.static_force).sum();
        let distance = START * break_away / gains.p;
        let points =
            vec![rest(LEAD, 0.0), rest(LEAD + 1.0 / rate, distance), rest(LEAD + hold, distance)];
        let mut stage = closed_loop(model, settings, controller, points)?;
        let start = (LEAD * rate).round() as usize;
        let count = start + (hold * rate).round() as usize;
        let mut rows = Vec::with_capacity(KEPT.min(count));
        let mut position = Vec::with_capacity(count - start);
        for k in 0..count {
            let row = Row::of(&stage.cycle()?);
            if k >= start {
                position.push(row.sample.position);
            }
            if rows.len() < KEPT {
                rows.push(row);
            }
        }
        within_motor("hunting", specimen, model, &rows)?;
        let (peak_to_peak, cycle) = limit_cycle(&position, rate);
        let thin = (position.len() / 3000).max(1);
        let points = position
            .iter()
            .step_by(thin)
            .enumerate()
            .map(|(k, x)| ((k * thin) as f64 / rate, distance - x))
            .collect();
        results.push(HuntingResult { bandwidth, integral, peak_to_peak, cycle, points });
        let name = format!("hunting_{bandwidth}Hz_{integral}");
        recordings.push(LabRecording { name, model: model.clone(), settings: *settings, rows });
        tick();
    }
    Ok((results, recordings))
}

/// Peak to peak over the last half of `position` (m, at `rate` Hz), and the limit cycle if it is
/// one: large enough to be seen, not dying away, and of several periods.
fn limit_cycle(position: &[f64], rate: f64) -> (f64, Option<LimitCycle>) {
    let range = |part: &[f64]| {
        part.iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(*x), high.max(*x)))
    };
    let tail = &position[position.len() / 2..];
    let (low, high) = range(tail);
    let peak_to_peak = high - low;
    let (third, fourth) = tail.split_at(tail.len() / 2);
    let size = |part| {
        let (low, high) = range(part);
        high - low
    };
    if peak_to_peak < SEEN || size(fourth) < 0.8 * size(third) {
        return (peak_to_peak, None);
    }
    // Upward crossings of the upper quarter line, each armed by a visit below the lower one.
    let (lower, upper) = (low + 0.25 * peak_to_peak, high - 0.25 * peak_to_peak);
    let mut armed = false;
    let mut crossings = Vec::new();
    for (k, x) in tail.iter().enumerate() {
        if *x < lower {
            armed = true;
        } else if *x > upper && armed {
            armed = false;
            crossings.push(k as f64 / rate);
        }
    }
    let cycle = (crossings.len() > PERIODS).then(|| LimitCycle {
        amplitude: 0.5 * peak_to_peak,
        period: (crossings[crossings.len() - 1] - crossings[0]) / (crossings.len() - 1) as f64,
    });
    (peak_to_peak, cycle)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The same guide hunts with a falling F(v) and comes to rest without; between jumps the
    /// integrator alone works, so half a period is at least the time in which i times the error
    /// changes the force from one break-away to the other.
    #[test]
    fn a_falling_curve_makes_the_stage_hunt() {
        let falling = Specimen::of_guide("guide_1").unwrap();
        let mut flat = falling.guide().unwrap();
        flat.static_force = flat.coulomb_force;
        let run = |of: &Specimen| {
            hunting(of, &Settings::default(), &[3.0], &[3.0], &|| ()).unwrap().0.remove(0)
        };
        assert!(run(&falling.clone().with_guide(flat)).cycle.is_none());
        let guide = falling.guide().unwrap();
        let cycle = run(&falling).cycle.unwrap();
        let gains = Gains::from_bandwidth(3.0, 40.0);
        let least =
            4.0 * (guide.static_force + guide.coulomb_force) / (3.0 * gains.i * cycle.amplitude);
        let half = 0.5 * cycle.period;
        assert!(half > 0.8 * least && half < 1.6 * least, "{half} s against {least} s");
    }

    #[test]
    fn cycles_are_told_from_rest_drift_and_decay() {
        let wave = |decay: f64| -> Vec<f64> {
            (0..40_000)
                .map(|k| k as f64 * 1e-3)
                .map(|t| 3e-6 * (-decay * t).exp() * (2.5 * t).sin())
                .collect()
        };
        let (peak_to_peak, cycle) = limit_cycle(&wave(0.0), 1000.0);
        let cycle = cycle.unwrap();
        assert!((peak_to_peak - 6e-6).abs() < 1e-9 && (cycle.amplitude - 3e-6).abs() < 1e-9);
        assert!((cycle.period - 2.0 * std::f64::consts::PI / 2.5).abs() < 2e-3, "{cycle:?}");
        assert!(limit_cycle(&wave(0.1), 1000.0).1.is_none());
        let creep: Vec<f64> = (0..40_000).map(|k| k as f64 * 1e-10).collect();
        assert!(limit_cycle(&creep, 1000.0).1.is_none());
        let noise: Vec<f64> = (0..40_000).map(|k| if k % 3 == 0 { 1e-9 } else { -2e-9 }).collect();
        assert!(limit_cycle(&noise, 1000.0).1.is_none());
    }
}
