//! The two motions of the paper's section 4: the fast move and the fine step, with what comes before them.

use crate::control::Point;

/// Stroke (m) and duration (s) of the fast move: 50 mm in 100 ms.
const FAST: (f64, f64) = (50e-3, 100e-3);
/// Step (m) and duration (s) of the fine move: 10 um in 3 ms.
const FINE: (f64, f64) = (10e-6, 3e-3);
/// Time to settle after a fast move and after a fine step, s. Assumed: longer than the slowest guide needs.
const SETTLE: (f64, f64) = (0.9, 0.5);
/// Lead-in at rest before the conditioning move, s.
const LEAD: f64 = 0.05;

/// Which of the paper's motions a move is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MoveKind {
    /// The return move before everything else, as the paper conditions its guides.
    Conditioning,
    FastForward,
    FastReturn,
    FineStep,
}

/// One move within a motion; times in ns after the motion's start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    pub kind: MoveKind,
    /// First instant of the move.
    pub start: i64,
    /// Instant at which the reference arrives.
    pub arrival: i64,
    /// Last instant before the next move.
    pub end: i64,
    /// Reference after the move, m.
    pub target: f64,
}

/// A motion of rest-to-rest moves: points for a trajectory, and what each part of it is.
///
/// The paper does not give its profile; the minimum-jerk (quintic) one of a JointTrajectory with zero end velocities and
/// accelerations is assumed.
#[derive(Clone, Debug, PartialEq)]
pub struct PaperMotion {
    pub points: Vec<Point>,
    pub moves: Vec<Move>,
}

impl PaperMotion {
    /// Return move of 50 mm, `rest` s of rest, forward and return move of 50 mm, then `fine_steps` steps of 10 um forward.
    pub fn new(rest: f64, fine_steps: usize) -> PaperMotion {
        let mut motion = PaperMotion { points: Vec::new(), moves: Vec::new() };
        motion.point(LEAD, 0.0);
        motion.travel(MoveKind::Conditioning, -FAST.0, FAST.1, rest);
        motion.travel(MoveKind::FastForward, FAST.0, FAST.1, SETTLE.0);
        motion.travel(MoveKind::FastReturn, -FAST.0, FAST.1, SETTLE.0);
        for _ in 0..fine_steps {
            motion.travel(MoveKind::FineStep, FINE.0, FINE.1, SETTLE.1);
        }
        motion
    }

    /// As the paper prepares its fast move: return move of 50 mm, `rest` s of rest, then forward and return move.
    pub fn fast(rest: f64) -> PaperMotion {
        PaperMotion::new(rest, 0)
    }

    /// As the paper prepares its fine steps: return move of 50 mm, `rest` s of rest, then `steps` steps forward.
    pub fn fine(rest: f64, steps: usize) -> PaperMotion {
        let mut motion = PaperMotion { points: Vec::new(), moves: Vec::new() };
        motion.point(LEAD, 0.0);
        motion.travel(MoveKind::Conditioning, -FAST.0, FAST.1, rest);
        for _ in 0..steps {
            motion.travel(MoveKind::FineStep, FINE.0, FINE.1, SETTLE.1);
        }
        motion
    }

    /// Time from start to end, ns.
    pub fn duration(&self) -> i64 {
        self.points.last().map_or(0, |point| point.time)
    }

    fn travel(&mut self, kind: MoveKind, distance: f64, duration: f64, rest: f64) {
        let (start, from) = self.points.last().map_or((0, 0.0), |point| (point.time, point.position));
        let target = from + distance;
        self.point(duration, target);
        let arrival = self.duration();
        self.point(rest, target);
        self.moves.push(Move { kind, start, arrival, end: self.duration(), target });
    }

    fn point(&mut self, after: f64, position: f64) {
        let time = self.duration() + (after * 1e9).round() as i64;
        self.points.push(Point { time, position, velocity: Some(0.0), acceleration: Some(0.0), effort: 0.0 });
    }
}
