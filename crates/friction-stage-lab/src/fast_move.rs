//! The fast move of the paper's section 4: 50 mm in 100 ms, forward and return, after a return move
//! and a rest.

use serde::{Deserialize, Serialize};

use super::application::PEAK_ACCELERATION;
use super::paper::{Move, MoveKind, PaperMotion};
use super::settling::{MoveResult, settling};
use super::specimen::{LabError, LabRecording, Row, Settings, Specimen, within_motor};

/// The interval in which the paper compares the viscous friction, s after the start of the move.
pub const WAVE: (f64, f64) = (0.025, 0.150);

/// One guide type in the fast move, with or without viscous feedforward.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FastMove {
    /// Name of the specimen.
    pub name: String,
    /// N s/m
    pub viscous_feedforward: f64,
    /// Move forward, after the return move and the rest.
    pub forward: MoveResult,
    /// Move back after it.
    #[serde(rename = "return")]
    pub return_move: MoveResult,
    /// Largest |error| between [`WAVE`]'s ends, forward move, m.
    pub wave_peak: f64,
    /// Rms of the error between [`WAVE`]'s ends, forward move, m.
    pub wave_rms: f64,
    /// Settling times of the forward move into finer steps of the band: (band in m, time in s).
    pub settling_over_band: Vec<(f64, Option<f64>)>,
    /// Time (s after the start of the forward move) and error (m).
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub points: Vec<(f64, f64)>,
}

/// Bands of `settling_over_band`, m, from coarse to fine.
pub const BANDS: [f64; 13] =
    [30e-6, 20e-6, 10e-6, 5e-6, 3e-6, 2e-6, 1e-6, 0.5e-6, 0.3e-6, 0.2e-6, 0.1e-6, 50e-9, 30e-9];

/// Runs the move after `rest` s at rest. `feedforward` switches viscous feedforward on, ideal: the
/// sum of sigma2 of the guides.
pub fn fast_move(
    specimen: &Specimen,
    settings: &Settings,
    rest: f64,
    feedforward: bool,
) -> Result<(FastMove, LabRecording), LabError> {
    fast_move_along(specimen, settings, &PaperMotion::fast(rest), feedforward)
}

/// As [`fast_move`], along moves of one's own.
pub(super) fn fast_move_along(
    specimen: &Specimen,
    settings: &Settings,
    motion: &PaperMotion,
    feedforward: bool,
) -> Result<(FastMove, LabRecording), LabError> {
    let viscous = ideal_viscous(specimen, feedforward)?;
    let rows = run("fast-move", specimen, settings, motion, viscous)?;
    let signal = |what: &str| LabError::Signal {
        experiment: "fast-move",
        specimen: specimen.name.clone(),
        what: what.to_owned(),
    };
    let find = |kind| {
        motion.moves.iter().find(|m| m.kind == kind).ok_or_else(|| signal("has no such move"))
    };
    let (forward, back) = (find(MoveKind::FastForward)?, find(MoveKind::FastReturn)?);
    let result =
        |of| settling(of, errors(&rows)).ok_or_else(|| signal("holds no sample of the move"));
    let points = after(forward, &rows, 0.6);
    let wave: Vec<f64> =
        points.iter().filter(|(t, _)| *t >= WAVE.0 && *t <= WAVE.1).map(|(_, e)| *e).collect();
    let found = FastMove {
        name: specimen.name.clone(),
        viscous_feedforward: viscous,
        forward: result(forward)?,
        return_move: result(back)?,
        wave_peak: wave.iter().fold(0.0, |peak: f64, e| peak.max(e.abs())),
        wave_rms: (wave.iter().map(|e| e * e).sum::<f64>() / wave.len() as f64).sqrt(),
        settling_over_band: BANDS.map(|band| (band, settling_into(forward, &rows, band))).into(),
        points,
    };
    let suffix = if feedforward { "_with_viscous_feedforward" } else { "" };
    let name = format!("fast_move{suffix}");
    Ok((found, LabRecording { name, model: specimen.stage.clone(), settings: *settings, rows }))
}

pub(super) fn ideal_viscous(specimen: &Specimen, feedforward: bool) -> Result<f64, LabError> {
    let sum = specimen.stage.resolved_guides()?.iter().map(|guide| guide.viscous_friction).sum();
    Ok(if feedforward { sum } else { 0.0 })
}

pub(super) fn run(
    experiment: &'static str,
    specimen: &Specimen,
    settings: &Settings,
    motion: &PaperMotion,
    viscous: f64,
) -> Result<Vec<Row>, LabError> {
    let mut stage = specimen.on_stage(settings, viscous, motion.points.clone())?;
    let count = (motion.duration() as f64 * 1e-9 * settings.rates.control()).ceil() as usize;
    let rows =
        (0..count).map(|_| Ok(Row::of(&stage.cycle()?))).collect::<Result<Vec<_>, LabError>>()?;
    moves_within_motor(experiment, specimen, motion)?;
    within_motor(experiment, specimen, &specimen.stage, &rows)?;
    Ok(rows)
}

/// Refuses moves whose acceleration alone takes more than the motor has, by their name.
fn moves_within_motor(
    experiment: &'static str,
    specimen: &Specimen,
    motion: &PaperMotion,
) -> Result<(), LabError> {
    let (mass, limit) = (specimen.stage.moving_mass(), specimen.stage.motor.force_limit);
    let mut from = 0.0;
    for the_move in &motion.moves {
        let distance = (the_move.target - from).abs();
        let duration = (the_move.arrival - the_move.start) as f64 * 1e-9;
        from = the_move.target;
        let impulse = PEAK_ACCELERATION * mass * distance;
        let needed = impulse / (duration * duration);
        if needed > limit {
            return Err(LabError::MoveForce {
                experiment,
                specimen: specimen.name.clone(),
                the_move: match the_move.kind {
                    MoveKind::Conditioning => "the return move before it",
                    MoveKind::FastForward => "the move forward",
                    MoveKind::FastReturn => "the move back",
                    MoveKind::FineStep => "the step",
                    MoveKind::Application => "the move",
                },
                distance,
                duration,
                needed,
                mass,
                limit,
                slowest: (impulse / limit).sqrt(),
            });
        }
    }
    Ok(())
}

/// Time (ns) and position error (m) as the controller saw it.
pub(super) fn errors(rows: &[Row]) -> impl Iterator<Item = (i64, f64)> {
    rows.iter().filter_map(|row| Some((row.sample.time, row.terms?.error)))
}

/// Time (s after the start of the move) and error (m) over `window` s, with a little before.
pub(super) fn after(of: &Move, rows: &[Row], window: f64) -> Vec<(f64, f64)> {
    errors(rows)
        .map(|(time, error)| ((time - of.start) as f64 * 1e-9, error))
        .filter(|(time, _)| *time >= -0.05 * window && *time <= window)
        .collect()
}

/// Time from the arrival of the reference to the last sample outside of `band`, s; `None` where it
/// stays outside.
pub(super) fn settling_into(of: &Move, rows: &[Row], band: f64) -> Option<f64> {
    let mut within =
        errors(rows).filter(|(time, _)| (of.arrival..=of.end).contains(time)).peekable();
    within.peek()?;
    let (mut last, mut outside) = (of.arrival, None);
    for (time, error) in within {
        last = time;
        if error.abs() > band {
            outside = Some(time);
        }
    }
    match outside {
        Some(time) if time == last => None,
        Some(time) => Some((time - of.arrival) as f64 * 1e-9),
        None => Some(0.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settling_into_a_band_agrees_with_the_three_bands_of_every_move() {
        let specimen = Specimen::of_guide("guide_2").unwrap();
        let (found, _) = fast_move(&specimen, &Settings::default(), 1.0, false).unwrap();
        let at = |band: f64| found.settling_over_band.iter().find(|x| x.0 == band).unwrap().1;
        assert_eq!(found.forward.settling, [10e-6, 1e-6, 0.1e-6].map(at));
        let times: Vec<f64> = found.settling_over_band.iter().map_while(|x| x.1).collect();
        assert!(times.is_sorted() && times.len() > 8, "{times:?}");
    }

    /// Viscous friction sigma2 v is a force known in advance: with it fed forward a stage without
    /// other friction has next to no error; without it the error is that of the force sigma2 v on
    /// the loop.
    #[test]
    fn viscous_feedforward_cancels_viscous_friction() {
        let mut guide = Specimen::of_guide("guide_2").unwrap().guide().unwrap();
        (guide.coulomb_force, guide.static_force) = (1e-6, 1e-6);
        let specimen = Specimen::of_guide("guide_2").unwrap().with_guide(guide);
        let run = |on| fast_move(&specimen, &Settings::default(), 0.5, on).unwrap().0.wave_rms;
        let (without, with) = (run(false), run(true));
        assert!(with < 0.05 * without, "{with:e} {without:e}");
    }
}
