//! The report of a motion that was played: the table of its moves, and error and force over time.

use std::fmt::Write as _;

use serde::Serialize;

use crate::chart::{Axis, Chart, Style};
use crate::figure::{FigureError, svg};
use crate::paper_motion::{envelope, micrometres, settled_at, settling_bands};
use crate::sweep::milliseconds;
use crate::words::{fixed, in_prefix_short};
use friction_stage_core::model::JointType;
use friction_stage_lab::{MotionQuality, Move, SETTLING_BANDS};

/// Moves that the table lists one by one.
const LISTED: usize = 20;

/// A sample of the run, SI units; times after its start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlayedSample {
    /// ns
    pub time: i64,
    /// m
    pub reference: f64,
    /// As the encoder read it, m.
    pub position: f64,
    /// By difference of the positions, m/s.
    pub velocity: f64,
    /// Reference less position, m.
    pub error: f64,
    /// Command, N.
    pub force: f64,
    /// As the force cell read it, N.
    pub force_cell: f64,
    /// The force was at a limit.
    pub saturated: bool,
}

/// A move, and how well it was followed.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct PlayedMove {
    /// s
    pub start: f64,
    /// Arrival of the reference, s.
    pub arrival: f64,
    /// m
    pub from: f64,
    /// m
    pub to: f64,
    /// Where the reference is farthest from where the move begins, m.
    pub farthest: f64,
    /// What became of it.
    #[serde(flatten)]
    pub quality: MotionQuality,
}

/// The moves of a motion that begins at 0, with their qualities; samples of ascending time.
pub fn played_moves(
    moves: &[Move],
    qualities: &[MotionQuality],
    samples: &[PlayedSample],
) -> Vec<PlayedMove> {
    let mut from = 0.0;
    moves
        .iter()
        .zip(qualities)
        .map(|(a_move, quality)| {
            let seconds = |time: i64| time as f64 * 1e-9;
            let first = samples.partition_point(|sample| sample.time < a_move.start);
            let after = samples.partition_point(|sample| sample.time <= a_move.arrival);
            let farthest = samples[first..after.max(first)]
                .iter()
                .map(|sample| sample.reference)
                .chain([a_move.target])
                .max_by(|a, b| (a - from).abs().total_cmp(&(b - from).abs()));
            let played = PlayedMove {
                start: seconds(a_move.start),
                arrival: seconds(a_move.arrival),
                from,
                to: a_move.target,
                farthest: farthest.unwrap_or(a_move.target),
                quality: *quality,
            };
            from = a_move.target;
            played
        })
        .collect()
}

/// The table of the moves, and of all of them together.
pub fn played_text(moves: &[PlayedMove], all: Option<&MotionQuality>, joint: JointType) -> String {
    let mut out = String::new();
    // A string takes whatever is written.
    let _ = write_table(&mut out, moves, all, joint);
    out
}

fn write_table(
    out: &mut String,
    moves: &[PlayedMove],
    all: Option<&MotionQuality>,
    joint: JointType,
) -> std::fmt::Result {
    let Some(all) = all else { return writeln!(out, "the motion has no move") };
    let [peak_force, force, length] =
        [joint.quantity("peak force"), joint.unit("N"), joint.unit("µm")];
    writeln!(
        out,
        "{:22} {:>11} {:>10} {:>29} {peak_force:>13}",
        "", "peak error", "rms error", "time to settle within, ms"
    )?;
    let [ten, one, tenth] = ["10", "1", "0.1"].map(|size| format!("{size} {length}"));
    writeln!(
        out,
        "{:22} {length:>11} {length:>10} {ten:>9} {one:>9} {tenth:>9} {force:>13}",
        "move"
    )?;
    for (index, a_move) in moves.iter().take(LISTED).enumerate() {
        let name = format!("{}: {}", index + 1, way(a_move, joint));
        row(out, &name, &a_move.quality)?;
    }
    if moves.len() > LISTED {
        writeln!(out, "... and {} more; --json lists all", moves.len() - LISTED)?;
    }
    if moves.len() > 1 {
        row(out, "all moves", all)?;
    }
    match all.saturated {
        0 => Ok(()),
        count => {
            writeln!(out, "the {} was at its limit in {count} samples", joint.quantity("force"))
        }
    }
}

fn row(out: &mut String, name: &str, quality: &MotionQuality) -> std::fmt::Result {
    let MotionQuality { peak_error, rms_error, settling, peak_force, .. } = quality;
    let [ten, one, tenth] = settling.map(milliseconds);
    writeln!(
        out,
        "{name:22} {:>11} {:>10} {ten:>9} {one:>9} {tenth:>9} {:>13}",
        fixed(peak_error * 1e6, 3),
        fixed(rms_error * 1e6, 3),
        fixed(*peak_force, 1)
    )
}

/// What a move is: how far it goes, or how far away it takes the stage before it comes back.
fn way(of: &PlayedMove, joint: JointType) -> String {
    let [whole, away] = [of.to, of.farthest].map(|position| position - of.from);
    if away.abs() > 2.0 * whole.abs() {
        format!("up to {}", distance(away, joint))
    } else {
        distance(whole, joint)
    }
}

/// A distance in the unit in which it is read.
fn distance(metres: f64, joint: JointType) -> String {
    let shown = match metres.abs() {
        size if size >= 1e-3 => format!("{:.4} mm", metres * 1e3),
        size if size >= 1e-6 => format!("{:.3} µm", metres * 1e6),
        _ => format!("{:.2} nm", metres * 1e9),
    };
    joint.unit(&shown).into_owned()
}

/// Position error, motion and force over time.
pub fn played_figure(
    title: &str,
    samples: &[PlayedSample],
    moves: &[Move],
    force_limits: (f64, f64),
    joint: JointType,
) -> Result<String, FigureError> {
    let seconds = |time: i64| time as f64 * 1e-9;
    let over_time = |of: fn(&PlayedSample) -> f64| {
        samples.iter().map(move |sample| (seconds(sample.time), of(sample)))
    };
    let label = "time, s";
    let mut error =
        Chart::new(joint.quantity("Position error"), label, joint.heading("position error, µm"));
    error.add("", 0, Style::Line, over_time(|sample| sample.error * 1e6));
    settling_bands(&mut error, joint);
    let mut motion = Chart::new("Motion", label, joint.heading("position, mm"));
    motion.add(
        joint.quantity("position"),
        0,
        Style::Line,
        over_time(|sample| sample.position * 1e3),
    );
    motion.add("reference", 4, Style::Dashed, over_time(|sample| sample.reference * 1e3));
    let mut force = Chart::new(joint.quantity("Force command"), label, joint.heading("force, N"));
    force.add("", 0, Style::Line, over_time(|sample| sample.force));
    // Next to hundreds of newtons both would be one line. A sample's cell reads the force of the
    // interval that ends there, which the sample before it commanded.
    let mut cell = Chart::new(
        joint.quantity("Force cell less the command that acted"),
        label,
        joint.heading("difference, N"),
    );
    let acted =
        samples.windows(2).map(|pair| (seconds(pair[1].time), pair[1].force_cell - pair[0].force));
    cell.add("", 0, Style::Line, acted);
    if samples.iter().any(|sample| sample.saturated) {
        force.line("limit", Axis::Y, force_limits.1);
        force.line("", Axis::Y, force_limits.0);
    }
    let mut charts = vec![error, motion, force];
    if samples.iter().any(|sample| sample.force_cell.is_finite()) {
        charts.push(cell);
    }
    for (number, a_move, sizes) in slowest(moves, samples) {
        let last = settled_at(&sizes).or(sizes.last().map(|point| point.0)).unwrap_or(0.0);
        let mut chart = Chart::new(
            format!(
                "Settling of move {number} to {}{}",
                in_prefix_short(a_move.target, &joint.unit("m")),
                if moves.len() > 2 { ", one of the two slowest" } else { "" }
            ),
            "time after the arrival of the reference, ms",
            joint.heading("largest error still to come, µm"),
        )
        .logarithmic(false, true);
        // Some of the way before the arrival, and what comes after it until it has settled.
        let shown = last.max(5.0);
        let shown =
            sizes.into_iter().filter(|point| (-0.5 * shown..=1.5 * shown).contains(&point.0));
        chart.add("", 0, Style::Line, shown);
        chart.line("arrival", Axis::X, 0.0);
        for band in SETTLING_BANDS {
            chart.line(joint.unit(&micrometres(band)), Axis::Y, band * 1e6);
        }
        charts.push(chart);
    }
    svg(title, &charts)
}

/// A curve over the time after the arrival of a move's reference, ms.
type Curve = Vec<(f64, f64)>;

/// The two moves that settle last, those that never do before all others, in their order, each with
/// its number from 1 on and the largest error that is still to come on it.
fn slowest<'a>(moves: &'a [Move], samples: &[PlayedSample]) -> Vec<(usize, &'a Move, Curve)> {
    let sizes = |a_move: &Move| {
        let from = samples.partition_point(|sample| sample.time < a_move.start);
        // With its end the next one begins.
        let to = samples.partition_point(|sample| sample.time < a_move.end);
        let after = |time: i64| (time - a_move.arrival) as f64 * 1e-6;
        envelope(samples[from..to].iter().map(|s| (after(s.time), s.error.abs() * 1e6)).collect())
    };
    let mut all: Vec<_> = moves
        .iter()
        .enumerate()
        .filter(|(_, a_move)| a_move.end > a_move.arrival)
        .map(|(index, a_move)| {
            let sizes = sizes(a_move);
            (settled_at(&sizes).unwrap_or(f64::INFINITY), (index + 1, a_move, sizes))
        })
        .collect();
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    all.truncate(2);
    all.sort_by_key(|(_, (number, ..))| *number);
    all.into_iter().map(|(_, found)| found).collect()
}

#[cfg(test)]
mod tests {
    use friction_stage_lab::{FollowedSample, PaperMotion, motion_quality};

    use super::*;

    #[test]
    fn the_table_names_each_move_and_the_worst_of_all() {
        let motion =
            PaperMotion::of_moves(0.01, &[(1e-5, 0.01, 0.02), (-2e-3, 0.01, 0.02)]).unwrap();
        let samples: Vec<FollowedSample> = (0..280)
            .map(|k| FollowedSample {
                time: k * 250_000,
                error: 1e-9 * k as f64,
                force: 3.0,
                saturated: k == 100,
            })
            .collect();
        let of = |moves: &[Move]| motion_quality(moves, &samples).unwrap();
        let each: Vec<_> = motion.moves.iter().map(|a| of(std::slice::from_ref(a))).collect();
        let moves = played_moves(&motion.moves, &each, &[]);
        let text = played_text(&moves, Some(&of(&motion.moves)), JointType::Prismatic);
        for words in ["1: 10.000 µm", "2: -2.0000 mm", "all moves", "limit in 1 samples", "never"]
        {
            assert!(text.contains(words), "{words}: {text}");
        }
        assert!(played_text(&[], None, JointType::Prismatic).contains("no move"));
        // One that comes back is named by how far it went.
        let away = |time, reference| PlayedSample { time, reference, ..ZERO };
        let there_and_back = Move { target: 0.0, ..motion.moves[0] };
        let half = (there_and_back.start + there_and_back.arrival) / 2;
        let samples = [away(there_and_back.start, 0.0), away(half, -5e-3)];
        let moves = played_moves(&[there_and_back], &each[..1], &samples);
        let text = played_text(&moves, Some(&of(&motion.moves)), JointType::Prismatic);
        assert!(text.contains("1: up to -5.0000 mm"), "{text}");
        let text = played_text(&moves, Some(&of(&motion.moves)), JointType::Revolute);
        for words in ["1: up to -5.0000 mrad", "peak torque", "0.1 µrad", "N m"] {
            assert!(text.contains(words), "{words}: {text}");
        }
    }

    const ZERO: PlayedSample = PlayedSample {
        time: 0,
        reference: 0.0,
        position: 0.0,
        velocity: 0.0,
        error: 0.0,
        force: 0.0,
        force_cell: 0.0,
        saturated: false,
    };

    #[test]
    fn the_figure_shows_error_force_and_settling() {
        let motion = PaperMotion::of_moves(0.01, &[(1e-5, 0.01, 0.02)]).unwrap();
        let samples: Vec<PlayedSample> = (0..200)
            .map(|k| PlayedSample {
                time: k * 250_000,
                error: 1e-6,
                force: 1.0,
                force_cell: 1.0,
                saturated: true,
                ..ZERO
            })
            .collect();
        let figure =
            |joint| played_figure("run", &samples, &motion.moves, (-9.0, 9.0), joint).unwrap();
        let prismatic = figure(JointType::Prismatic);
        for words in ["Position error", "Force cell less the command", "limit", "Settling of move"]
        {
            assert!(prismatic.contains(words), "{words}");
        }
        let revolute = figure(JointType::Revolute);
        for words in ["Angle error", "angle error, µrad", "torque, N m", "Torque cell less"] {
            assert!(revolute.contains(words), "{words}");
        }
    }

    #[test]
    fn the_moves_that_settle_last_are_shown() {
        // Four moves; the second settles after 40 ms, the fourth never.
        let rests = [(1e-5, 0.01, 0.1); 4];
        let motion = PaperMotion::of_moves(0.01, &rests).unwrap();
        let error = |time: i64| {
            let number = motion.moves.iter().position(|m| (m.start..m.end).contains(&time));
            let after = number.map_or(0, |n| time - motion.moves[n].arrival);
            match number {
                Some(1) if after < 40_000_000 => 5e-6,
                Some(0 | 2) if after < 10_000_000 => 5e-6,
                Some(3) => 2e-6,
                _ => 0.0,
            }
        };
        let end = motion.moves.last().unwrap().end;
        let samples: Vec<PlayedSample> = (0..end / 250_000)
            .map(|k| PlayedSample {
                time: k * 250_000,
                reference: 0.0,
                position: 0.0,
                velocity: 0.0,
                error: error(k * 250_000),
                force: 0.0,
                force_cell: f64::NAN,
                saturated: false,
            })
            .collect();
        let shown = slowest(&motion.moves, &samples);
        let starts: Vec<i64> = shown.iter().map(|(_, a_move, _)| a_move.start).collect();
        assert_eq!(starts, [motion.moves[1].start, motion.moves[3].start]);
        assert_eq!(settled_at(&shown[1].2), None);
    }
}
