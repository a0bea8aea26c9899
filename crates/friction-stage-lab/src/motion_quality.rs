//! How well a whole motion was followed: the moves that any trajectory consists of, and over them
//! error, time to settle, force and saturation.

use serde::Serialize;

use super::paper::{Move, MoveKind};
use super::settling::settling;
use friction_stage_core::control::Point;

/// What of a sample counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowedSample {
    /// ns after the start of the motion.
    pub time: i64,
    /// Reference less position, m.
    pub error: f64,
    /// Commanded force, N.
    pub force: f64,
    /// The force was at a limit.
    pub saturated: bool,
}

/// How well moves were followed, over all of them or of one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MotionQuality {
    /// Largest |error|, m.
    pub peak_error: f64,
    /// Root mean square of the error, m.
    pub rms_error: f64,
    /// Time from the arrival of the reference until the error is within 10 µm, 1 µm and 0.1 µm for
    /// good, s, the longest of the moves; `None` where it never is, or where no rest follows in
    /// which it could settle.
    pub settling: [Option<f64>; 3],
    /// Largest |force|, N.
    pub peak_force: f64,
    /// Samples in which the force was at a limit.
    pub saturated: u64,
}

/// The rest-to-rest moves of a trajectory that begins at rest at position 0: from the last instant
/// of a rest to the first of the next.
pub fn moves_along(points: &[Point]) -> Vec<Move> {
    let still = |point: &Point| {
        point.velocity.unwrap_or(0.0) == 0.0 && point.acceleration.unwrap_or(0.0) == 0.0
    };
    let mut moves: Vec<Move> = Vec::new();
    let mut before = Point::at_rest(0, 0.0);
    let mut moving = false;
    for point in points.iter().filter(|point| point.time > 0) {
        let rests = point.position == before.position && still(point) && still(&before);
        if !rests && !moving {
            if let Some(last) = moves.last_mut() {
                last.end = before.time;
            }
            moves.push(Move {
                kind: MoveKind::Application,
                start: before.time,
                arrival: point.time,
                end: point.time,
                target: point.position,
            });
        }
        if let Some(last) = moves.last_mut() {
            if !rests {
                (last.arrival, last.target) = (point.time, point.position);
            }
            last.end = point.time;
        }
        (moving, before) = (!rests, *point);
    }
    moves
}

/// Evaluates the moves on samples of ascending time; `None` where no sample is in one of them.
pub fn motion_quality(moves: &[Move], samples: &[FollowedSample]) -> Option<MotionQuality> {
    let mut all = MotionQuality {
        peak_error: 0.0,
        rms_error: 0.0,
        settling: [Some(0.0); 3],
        peak_force: 0.0,
        saturated: 0,
    };
    let (mut count, mut squares) = (0u64, 0.0);
    for the_move in moves {
        let first = samples.partition_point(|sample| sample.time < the_move.start);
        let last = samples.partition_point(|sample| sample.time <= the_move.end);
        let within = samples.get(first..last).unwrap_or_default();
        let errors = within.iter().map(|sample| (sample.time, sample.error));
        let Some(found) = settling(the_move, errors) else { continue };
        let rests = the_move.end > the_move.arrival;
        for (longest, time) in all.settling.iter_mut().zip(found.settling) {
            *longest = longest.zip(time.filter(|_| rests)).map(|(a, b)| a.max(b));
        }
        all.peak_error = all.peak_error.max(found.peak_error);
        for sample in within {
            count += 1;
            squares += sample.error * sample.error;
            all.peak_force = all.peak_force.max(sample.force.abs());
            all.saturated += u64::from(sample.saturated);
        }
    }
    all.rms_error = (squares / count.max(1) as f64).sqrt();
    (count > 0).then_some(all)
}

#[cfg(test)]
mod tests {
    use super::super::paper::PaperMotion;
    use super::*;

    #[test]
    fn the_moves_of_the_papers_motion_are_found_in_its_points() {
        let motion = PaperMotion::new(0.5, 2);
        let found = moves_along(&motion.points);
        assert_eq!(found.len(), motion.moves.len());
        for (found, the_move) in found.iter().zip(&motion.moves) {
            let of = |a_move: &Move| (a_move.start, a_move.arrival, a_move.end, a_move.target);
            assert_eq!(of(found), of(the_move));
        }
        assert!(moves_along(&[Point::at_rest(1, 0.0), Point::at_rest(9, 0.0)]).is_empty());
    }

    #[test]
    fn a_move_that_passes_through_points_is_one_and_without_a_rest_it_settles_nowhere() {
        let passing = Point { velocity: Some(0.1), ..Point::at_rest(1_000, 1e-3) };
        let points = [passing, Point::at_rest(2_000, 2e-3)];
        let moves = moves_along(&points);
        assert_eq!(moves.len(), 1);
        assert_eq!((moves[0].start, moves[0].arrival, moves[0].end), (0, 2_000, 2_000));
        let sample = |time| FollowedSample { time, error: 3e-6, force: -5.0, saturated: false };
        let samples: Vec<FollowedSample> = (0..=8).map(|k| sample(250 * k)).collect();
        let found = motion_quality(&moves, &samples).unwrap();
        assert_eq!((found.settling, found.peak_force), ([None; 3], 5.0));
        assert!((found.rms_error - 3e-6).abs() < 1e-18);
        assert_eq!(motion_quality(&moves, &[]), None);
    }

    #[test]
    fn several_moves_count_with_the_worst_of_each() {
        let a_move = |start| Move {
            kind: MoveKind::Application,
            start,
            arrival: start + 10,
            end: start + 100,
            target: 0.0,
        };
        let moves = [a_move(0), a_move(100)];
        let samples: Vec<FollowedSample> = (0..=200)
            .map(|time| FollowedSample {
                time,
                error: if time < 40 {
                    2e-6
                } else if time < 160 {
                    0.5e-6
                } else {
                    0.0
                },
                force: time as f64,
                saturated: time == 50,
            })
            .collect();
        let found = motion_quality(&moves, &samples).unwrap();
        assert_eq!((found.peak_error, found.peak_force, found.saturated), (2e-6, 200.0, 1));
        let ns = found.settling.map(|time| time.map(|time| (time * 1e9).round()));
        assert_eq!(ns, [Some(0.0), Some(29.0), None]);
    }
}
