//! Friction over constant velocity, as the paper's Figure 3: one guide on the rig, both directions.
//!
//! For each speed: accelerate, let the bristles come to their steady deflection, then average the
//! force cell while the velocity is constant. At constant velocity the cell reads the friction of
//! the guide alone.

use serde::{Deserialize, Serialize};

use friction_stage_core::control::Point;

use super::specimen::{
    LabError, LabRecording, MeasuredValue, Row, SERVO_BANDWIDTH, Settings, Specimen, mean, moving,
    rest, within_motor,
};

/// Speeds, m/s: 0.1 mm/s to 1 m/s, denser where the Stribeck effect falls.
pub const SPEEDS: [f64; 17] = [
    0.1e-3, 0.2e-3, 0.5e-3, 1e-3, 2e-3, 3e-3, 4e-3, 5e-3, 7e-3, 10e-3, 15e-3, 20e-3, 50e-3, 100e-3,
    200e-3, 500e-3, 1.0,
];

/// Travel until the bristles are steady, in units of the longest break-away distance, Fs/sigma0 for
/// one bristle: they approach it as exp(-travel), here to 3e-4.
const STEADY_TRAVEL: f64 = 8.0;
/// Time for the servo to forget the acceleration, s: ten periods of its bandwidth.
const SERVO_SETTLE: f64 = 10.0 / SERVO_BANDWIDTH;
/// Time over which the force is averaged, s, but at least `MEASURED_TRAVEL`, and at most `LONGEST`
/// s.
const MEASURE: f64 = 0.25;
const MEASURED_TRAVEL: f64 = 0.1e-3;
const LONGEST: f64 = 1.0;
/// Acceleration, m/s^2, on average; at least 50 ms long.
const ACCELERATION: f64 = 10.0;
/// Speed from which on F(v) is taken as a line, m/s: far above every Stribeck velocity.
const LINE_FROM: f64 = 0.1;

/// The measured curve of one guide type.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StribeckCurve {
    /// Name of the specimen.
    pub name: String,
    /// Ascending in velocity, return direction negative.
    pub points: Vec<StribeckPoint>,
    /// Mean |F| of both directions at the lowest speed, N: what it takes to keep moving slowly.
    pub slow_force: MeasuredValue,
    /// Smallest mean |F| of both directions, N.
    pub least_force: MeasuredValue,
    /// Its speed, m/s.
    pub least_force_speed: f64,
    /// Slope of |F| over |v| above 0.1 m/s, N s/m.
    pub viscous_slope: f64,
    /// |F| of that line extrapolated to zero speed, N.
    pub viscous_level: f64,
    /// Whether F(v) falls at low speed: the least force lies below the slow one by more than four
    /// standard errors and 2 %.
    pub falls: bool,
}

/// The friction at one velocity.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StribeckPoint {
    /// Measured by the encoder from end to end, m/s.
    pub velocity: f64,
    /// Mean of the force cell, N.
    pub force: MeasuredValue,
    /// Scatter of the force cell, N.
    pub ripple: f64,
}

/// A window of constant velocity: first and last sample.
struct Window {
    from: u64,
    to: u64,
}

/// Measures the curve; `tick` is called after each of [`SPEEDS`].
pub fn stribeck(
    specimen: &Specimen,
    settings: &Settings,
    speeds: &[f64],
    tick: &dyn Fn(),
) -> Result<(StribeckCurve, LabRecording), LabError> {
    let break_away = specimen.break_away_distance()?;
    let rate = settings.rates.control();
    let mut points: Vec<Point> = vec![rest(0.05, 0.0)];
    let (mut time, mut position) = (0.05, 0.0);
    let mut windows = Vec::new();
    for &speed in speeds {
        for velocity in [speed, -speed] {
            let accelerate = (speed / ACCELERATION).max(0.05);
            let settle = SERVO_SETTLE.max(STEADY_TRAVEL * break_away / speed);
            let measure = (MEASURED_TRAVEL / speed).clamp(MEASURE, LONGEST);
            // Whole samples, so that windows begin at samples.
            let [accelerate, settle, measure] =
                [accelerate, settle, measure].map(|t: f64| (t * rate).ceil() / rate);
            let mut go = |after: f64, distance: f64, end_velocity: f64| {
                time += after;
                position += distance;
                points.push(moving(time, position, end_velocity));
                time
            };
            go(accelerate, 0.5 * velocity * accelerate, velocity);
            let from = go(settle, velocity * settle, velocity);
            let to = go(measure, velocity * measure, velocity);
            go(accelerate, 0.5 * velocity * accelerate, 0.0);
            go(0.05, 0.0, 0.0);
            windows.push(Window {
                from: (from * rate).round() as u64,
                to: (to * rate).round() as u64,
            });
        }
    }
    let last = (time * rate).ceil() as u64;
    let mut rig = specimen.on_rig(settings, specimen.servo(SERVO_BANDWIDTH), points)?;
    let mut rows = Vec::with_capacity(last as usize);
    let mut done = 0;
    for index in 0..last {
        rows.push(Row::of(&rig.cycle()?));
        if windows.get(done).is_some_and(|window| index == window.to) {
            done += 1;
            if done % 2 == 0 {
                tick();
            }
        }
    }
    within_motor("stribeck", specimen, &specimen.rig, &rows)?;
    let mut points: Vec<StribeckPoint> = windows
        .iter()
        .map(|window| reduce(&rows[window.from as usize..=window.to as usize], rate))
        .collect();
    points.sort_by(|a, b| a.velocity.total_cmp(&b.velocity));
    let curve = summarise(specimen.name.clone(), points).ok_or_else(|| LabError::Signal {
        experiment: "stribeck",
        specimen: specimen.name.clone(),
        what: "needs at least two speeds above 0.1 m/s in both directions".to_owned(),
    })?;
    let recording = LabRecording {
        name: "stribeck".to_owned(),
        model: specimen.rig.clone(),
        settings: *settings,
        rows,
    };
    Ok((curve, recording))
}

fn reduce(rows: &[Row], rate: f64) -> StribeckPoint {
    let force = mean(rows.iter().map(|row| row.sample.force_cell));
    let travel = rows[rows.len() - 1].sample.position - rows[0].sample.position;
    StribeckPoint {
        velocity: travel * rate / (rows.len() - 1) as f64,
        force,
        ripple: force.standard_error * (rows.len() as f64).sqrt(),
    }
}

fn summarise(name: String, points: Vec<StribeckPoint>) -> Option<StribeckCurve> {
    let half = points.len() / 2;
    // Speeds descend in the first half and ascend in the second: pair them from the middle
    // outwards.
    let pairs: Vec<(f64, MeasuredValue)> = (0..half)
        .map(|k| {
            let (back, forth) = (&points[half - 1 - k], &points[half + k]);
            let value = 0.5 * (forth.force.value - back.force.value);
            let standard_error = 0.5 * forth.force.standard_error.hypot(back.force.standard_error);
            (0.5 * (forth.velocity - back.velocity), MeasuredValue { value, standard_error })
        })
        .collect();
    let slow_force = pairs.first()?.1;
    let (least_force_speed, least_force) =
        pairs.iter().copied().min_by(|a, b| a.1.value.total_cmp(&b.1.value))?;
    let line: Vec<(f64, f64)> = pairs
        .iter()
        .filter(|(v, _)| *v >= 0.99 * LINE_FROM)
        .map(|(v, force)| (*v, force.value))
        .collect();
    if line.len() < 2 {
        return None;
    }
    let count = line.len() as f64;
    let (v, f) =
        line.iter().fold((0.0, 0.0), |(v, f), point| (v + point.0 / count, f + point.1 / count));
    let (cross, square) = line.iter().fold((0.0, 0.0), |(c, s), point| {
        (c + (point.0 - v) * (point.1 - f), s + (point.0 - v) * (point.0 - v))
    });
    let viscous_slope = cross / square;
    let drop = slow_force.value - least_force.value;
    Some(StribeckCurve {
        name,
        slow_force,
        least_force,
        least_force_speed,
        viscous_slope,
        viscous_level: f - viscous_slope * v,
        falls: drop > 4.0 * slow_force.standard_error.hypot(least_force.standard_error)
            && drop > 0.02 * slow_force.value,
        points,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// F(v) = g(v) sign(v) + sigma2 v: the closed form, with noise on both sensors.
    #[test]
    fn measured_curve_is_the_steady_friction_of_the_law() {
        for name in ["guide_1", "guide_2", "guide_3"] {
            let specimen = Specimen::of_guide(name).unwrap();
            let guide = specimen.guide().unwrap();
            let (curve, _) = stribeck(&specimen, &Settings::default(), &SPEEDS, &|| ()).unwrap();
            assert_eq!(curve.points.len(), 2 * SPEEDS.len());
            for point in &curve.points {
                let expected = guide.steady_force(point.velocity);
                let tolerance = 5.0 * point.force.standard_error + 3e-4 * expected.abs();
                assert!(
                    (point.force.value - expected).abs() < tolerance,
                    "{name} {point:?}, expected {expected}"
                );
            }
            for (point, speed) in curve.points[SPEEDS.len()..].iter().zip(SPEEDS) {
                assert!((point.velocity / speed - 1.0).abs() < 2e-3, "{name} {point:?} at {speed}");
            }
            assert!(
                (curve.viscous_slope - guide.viscous_friction).abs() < 0.05,
                "{name} {}",
                curve.viscous_slope
            );
            assert!(
                (curve.viscous_level - guide.coulomb_force).abs() < 0.02,
                "{name} {}",
                curve.viscous_level
            );
            assert_eq!(curve.falls, guide.static_force > guide.coulomb_force, "{name}");
        }
    }

    /// Parallel bristles share g(v): in steady motion their sum is that of one bristle.
    #[test]
    fn parallel_bristles_have_the_same_steady_friction() {
        let (guide, effect) = friction_stage_core::model::Catalogue::builtin()
            .distributed_bristles("guide_1")
            .unwrap();
        let stage = friction_stage_core::model::StageModel {
            effects: vec![effect],
            ..friction_stage_core::model::StageModel::on_guides("guide_1")
        };
        let specimen = Specimen::of_model(&stage).unwrap().with_guide(guide.clone());
        let (curve, _) =
            stribeck(&specimen, &Settings::default(), &[0.5e-3, 0.1, 0.5], &|| ()).unwrap();
        for point in &curve.points {
            let expected = guide.steady_force(point.velocity);
            let tolerance = 5.0 * point.force.standard_error + 1e-3 * expected.abs();
            assert!(
                (point.force.value - expected).abs() < tolerance,
                "{point:?}, expected {expected}"
            );
        }
    }

    #[test]
    fn a_motor_that_is_too_weak_is_named_with_its_limit() {
        let mut specimen = Specimen::of_guide("guide_1").unwrap();
        specimen.rig.motor.force_limit = 20.0;
        let error = stribeck(&specimen, &Settings::default(), &[0.5, 1.0], &|| ()).unwrap_err();
        assert!(
            error.to_string().contains("20 N") && error.to_string().contains("motor.force_limit"),
            "{error}"
        );
    }
}
