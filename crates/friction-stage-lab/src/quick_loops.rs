//! Loops for `fit-guide`: sinusoidal, one amplitude after the other, on the measuring rig.
//!
//! The slow loops of the Dahl curves hide the bristle damping and dwell at their tips; these are so
//! quick that it shows.

use std::f64::consts::PI;

use friction_stage_core::control::Point;

use super::specimen::{
    LabError, LabRecording, Row, SERVO_BANDWIDTH, Settings, Specimen, within_motor,
};

/// Amplitude (m), period (s) and number of the loops. Assumed: far beyond break-away, around it,
/// and far below it; peak speeds of 0.01 to 0.7 mm/s, at which the damping makes some percent of
/// the force.
pub const QUICK_LOOPS: [(f64, f64, usize); 3] = [(420e-6, 4.0, 2), (40e-6, 0.5, 6), (1e-6, 1.0, 2)];

/// Time at rest before, between and after the loops, s. Assumed.
const REST: f64 = 0.05;
/// Points of a trajectory per loop: quintic pieces follow a sine to 1e-7 of its amplitude.
const POINTS_PER_LOOP: usize = 32;

/// Records the loops with encoder and force cell of the rig.
pub fn quick_loops(
    specimen: &Specimen,
    settings: &Settings,
    loops: &[(f64, f64, usize)],
) -> Result<LabRecording, LabError> {
    let points = motion(loops);
    let end = points.last().map_or(0, |point| point.time);
    let mut rig = specimen.on_rig(settings, specimen.servo(SERVO_BANDWIDTH), points)?;
    let mut rows: Vec<Row> = Vec::new();
    while rows.last().is_none_or(|row| row.sample.time < end) {
        rows.push(Row::of(&rig.cycle()?));
    }
    within_motor("quick loops", specimen, &specimen.rig, &rows)?;
    Ok(LabRecording {
        name: "dahl_quick".to_owned(),
        model: specimen.rig.clone(),
        settings: *settings,
        rows,
    })
}

fn motion(loops: &[(f64, f64, usize)]) -> Vec<Point> {
    let mut points: Vec<Point> = Vec::new();
    let rest = |points: &mut Vec<Point>| {
        let (time, position) = points.last().map_or((0, 0.0), |point| (point.time, point.position));
        let time = time + (REST * 1e9) as i64;
        points.push(Point {
            time,
            position,
            velocity: Some(0.0),
            acceleration: Some(0.0),
            effort: 0.0,
        });
        (time, position)
    };
    for &(amplitude, period, count) in loops {
        let (start, from) = rest(&mut points);
        let rate = 2.0 * PI / period;
        for k in 1..=count * POINTS_PER_LOOP {
            let after = period * k as f64 / POINTS_PER_LOOP as f64;
            let (sine, cosine) = (rate * after).sin_cos();
            points.push(Point {
                time: start + (after * 1e9).round() as i64,
                position: from + amplitude * (1.0 - cosine),
                velocity: Some(amplitude * rate * sine),
                acceleration: Some(amplitude * rate * rate * cosine),
                effort: 0.0,
            });
        }
    }
    rest(&mut points);
    points
}
