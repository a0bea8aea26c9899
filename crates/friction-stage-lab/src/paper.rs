//! The two motions of the paper's section 4: the fast move and the fine step, with what comes
//! before them.

use friction_stage_core::numerics::plain;
use serde::{Deserialize, Serialize};

use friction_stage_core::control::Point;

/// Stroke (m) and duration (s) of the fast move: 50 mm in 100 ms.
pub(super) const FAST: (f64, f64) = (50e-3, 100e-3);
/// Step (m) and duration (s) of the fine move: 10 µm in 3 ms.
pub(super) const FINE: (f64, f64) = (10e-6, 3e-3);
/// Time to settle after a fast move and after a fine step, s. Assumed: longer than the slowest
/// guide needs.
const SETTLE: (f64, f64) = (0.9, 0.5);
/// What comes before a move that is judged, as the paper prepares its moves (section 4): a move the
/// other way and a rest.
///
/// A LuGre guide has no memory of rest, and without sensor noise every rest after which the error
/// of the return move is gone gives the same. With it the controller answers the noise of the
/// encoder, the carriage shivers by nanometres, and the bristles that the return move left bent let
/// go within minutes: the longer the rest, the less of the return move is left.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Conditioning {
    /// Way of the move, m, against the direction of the move that is judged.
    pub distance: f64,
    /// Time of the move, s.
    pub duration: f64,
    /// Time at rest after it, s.
    pub rest: f64,
}

impl Conditioning {
    /// The paper's rest, s.
    pub const PAPER_REST: f64 = 60.0;
    /// Rest of the demo, s: over ROS 2 a minute of stage time takes half a minute.
    pub const DEMO_REST: f64 = 2.0;
    /// Rest of each of the thousands of variants of a selection, s: by then the error of the return
    /// move is gone. A shorter one leaves the bristles loaded another way, with another error.
    pub const VARIANT_REST: f64 = 0.4;

    /// The paper's return move, 50 mm in 100 ms, and `rest` s of rest.
    pub fn resting(rest: f64) -> Conditioning {
        Conditioning { distance: FAST.0, duration: FAST.1, rest }
    }
}

impl Default for Conditioning {
    fn default() -> Self {
        Conditioning::resting(Conditioning::VARIANT_REST)
    }
}

/// Which of the paper's motions a move is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MoveKind {
    /// The return move before everything else, as the paper conditions its guides.
    Conditioning,
    /// First half of the fast move, forward: 50 mm in 100 ms in the paper.
    FastForward,
    /// Second half of the fast move: back to its start in the same time.
    FastReturn,
    /// One of the fine steps, forward: 10 µm in 3 ms in the paper.
    FineStep,
    /// A move that an application asks for.
    Application,
}

/// One move within a motion; times in ns after the motion's start.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    /// What the move is for.
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
/// The paper does not give its profile; the minimum-jerk (quintic) one of a JointTrajectory with
/// zero end velocities and accelerations is assumed.
#[derive(Clone, Debug, PartialEq)]
pub struct PaperMotion {
    /// Points of the trajectory, the first at rest at 0 m.
    pub points: Vec<Point>,
    /// The moves in their order.
    pub moves: Vec<Move>,
}

impl MoveKind {
    /// Name for other programs.
    pub fn name(self) -> &'static str {
        match self {
            MoveKind::Conditioning => "conditioning",
            MoveKind::FastForward => "fast_forward",
            MoveKind::FastReturn => "fast_return",
            MoveKind::FineStep => "fine_step",
            MoveKind::Application => "move",
        }
    }
}

/// A move that cannot be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("move {index}: the {quantity} is {}, must be {limit}", plain(*value))]
pub struct MoveError {
    /// Number of the move, from 0.
    pub index: usize,
    /// What is out of range: `lead`, `distance`, `duration` or `rest`.
    pub quantity: &'static str,
    /// Its value as given, m for a distance, else s.
    pub value: f64,
    /// Its range, in words after "must be".
    pub limit: &'static str,
}

impl PaperMotion {
    /// Lead-in at rest before the first move, s.
    pub const LEAD: f64 = 0.05;
    /// Longest duration or rest of a move of one's own, s: an hour.
    const LONGEST: f64 = 3600.0;

    /// `lead` s at rest at 0, then moves of one's own: each a distance (m), its duration (s) and
    /// the rest after it (s).
    pub fn of_moves(lead: f64, moves: &[(f64, f64, f64)]) -> Result<PaperMotion, MoveError> {
        let mut motion = PaperMotion { points: Vec::new(), moves: Vec::new() };
        let long = |value: f64| (0.0..=PaperMotion::LONGEST).contains(&value);
        let refuse = |index, quantity, value, limit| MoveError { index, quantity, value, limit };
        let at_most = "0 to 3600 s";
        if !long(lead) {
            return Err(refuse(0, "lead", lead, at_most));
        }
        motion.point(lead, 0.0);
        for (index, &(distance, duration, rest)) in moves.iter().enumerate() {
            if !distance.is_finite() {
                return Err(refuse(index, "distance", distance, "finite"));
            }
            // Half a nanosecond is the resolution of a point.
            if !(duration >= 1e-9 && long(duration)) {
                return Err(refuse(index, "duration", duration, "1e-9 to 3600 s"));
            }
            if !long(rest) {
                return Err(refuse(index, "rest", rest, at_most));
            }
            motion.travel(MoveKind::Application, distance, duration, rest);
        }
        Ok(motion)
    }

    /// Return move of 50 mm, `rest` s of rest, forward and return move of 50 mm, then `fine_steps`
    /// steps of 10 µm forward.
    ///
    /// The return move prepares the steps as well: they come after `rest` s, but not before the
    /// move is watched.
    pub fn new(rest: f64, fine_steps: usize) -> PaperMotion {
        let mut motion = PaperMotion::conditioned(PaperMotion::LEAD, &Conditioning::resting(rest));
        let watched = if fine_steps > 0 { rest.max(SETTLE.0) } else { SETTLE.0 };
        motion.travel(MoveKind::FastForward, FAST.0, FAST.1, SETTLE.0);
        motion.travel(MoveKind::FastReturn, -FAST.0, FAST.1, watched);
        motion.fine_steps(fine_steps)
    }

    /// As the paper prepares its fast move: return move of 50 mm, `rest` s of rest, then forward
    /// and return move.
    pub fn fast(rest: f64) -> PaperMotion {
        PaperMotion::new(rest, 0)
    }

    /// As the paper prepares its fine steps: return move of 50 mm, `rest` s of rest, then `steps`
    /// steps forward.
    pub fn fine(rest: f64, steps: usize) -> PaperMotion {
        PaperMotion::conditioned(PaperMotion::LEAD, &Conditioning::resting(rest)).fine_steps(steps)
    }

    /// As [`PaperMotion::fast`], with moves of another distance (m) and duration (s); the return
    /// move before them is as long.
    pub fn fast_of(rest: f64, distance: f64, duration: f64) -> PaperMotion {
        let before = Conditioning { distance, duration, rest };
        let mut motion = PaperMotion::conditioned(PaperMotion::LEAD, &before);
        motion.travel(MoveKind::FastForward, distance, duration, SETTLE.0);
        motion.travel(MoveKind::FastReturn, -distance, duration, SETTLE.0);
        motion
    }

    /// As [`PaperMotion::fine`], with steps of another distance (m) and duration (s).
    pub fn fine_of(rest: f64, steps: usize, distance: f64, duration: f64) -> PaperMotion {
        let before = Conditioning::resting(rest);
        let mut motion = PaperMotion::conditioned(PaperMotion::LEAD, &before);
        for _ in 0..steps {
            motion.travel(MoveKind::FineStep, distance, duration, SETTLE.1);
        }
        motion
    }

    /// `lead` s at rest at 0, then the conditioning; whatever is judged comes behind it.
    pub(super) fn conditioned(lead: f64, conditioning: &Conditioning) -> PaperMotion {
        let mut motion = PaperMotion { points: Vec::new(), moves: Vec::new() };
        motion.point(lead, 0.0);
        motion.travel(
            MoveKind::Conditioning,
            -conditioning.distance,
            conditioning.duration,
            conditioning.rest,
        );
        motion
    }

    fn fine_steps(mut self, steps: usize) -> PaperMotion {
        for _ in 0..steps {
            self.travel(MoveKind::FineStep, FINE.0, FINE.1, SETTLE.1);
        }
        self
    }

    /// Time from start to end, ns.
    pub fn duration(&self) -> i64 {
        self.points.last().map_or(0, |point| point.time)
    }

    /// A move of `distance` m in `duration` s and `rest` s after it.
    pub(super) fn travel(&mut self, kind: MoveKind, distance: f64, duration: f64, rest: f64) {
        let (start, from) =
            self.points.last().map_or((0, 0.0), |point| (point.time, point.position));
        let target = from + distance;
        self.point(duration, target);
        let arrival = self.duration();
        self.point(rest, target);
        self.moves.push(Move { kind, start, arrival, end: self.duration(), target });
    }

    fn point(&mut self, after: f64, position: f64) {
        let time = self.duration() + (after * 1e9).round() as i64;
        // A rest of no length is no point of its own.
        if self.points.is_empty() || time > self.duration() {
            self.points.push(Point {
                time,
                position,
                velocity: Some(0.0),
                acceleration: Some(0.0),
                effort: 0.0,
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Application, Settings, Specimen, VariantExperiment, fine_step, settling};
    use super::*;
    use friction_stage_core::model::StageModel;

    fn peak(specimen: &Specimen, motion: &PaperMotion) -> f64 {
        let mut stage =
            specimen.on_stage(&Settings::default(), 0.0, motion.points.clone()).unwrap();
        let step =
            motion.moves.iter().find(|the_move| the_move.kind == MoveKind::FineStep).unwrap();
        let mut errors = Vec::new();
        while errors.last().is_none_or(|(time, _)| *time < step.end) {
            let cycle = stage.cycle().unwrap();
            errors.push((cycle.sample.time, cycle.terms.error));
        }
        settling(step, errors.into_iter()).unwrap().peak_error
    }

    /// The motion of the demo, the experiment and a variant without tolerances: what differs
    /// between them is the rest.
    #[test]
    fn the_fine_step_is_the_same_everywhere_after_the_same_rest() {
        let specimen = Specimen::of_guide("guide_2").unwrap();
        let rest = 1.0;
        let experiment =
            fine_step(&specimen, &Settings::default(), rest, false).unwrap().0.steps[0].peak_error;
        let demo = peak(&specimen, &PaperMotion::new(rest, 1));
        let text = include_str!("../../../launch_config/application_fine_step_clean.yaml");
        let mut application = Application::from_yaml(text, "fine").unwrap();
        application.tolerances = Default::default();
        application.motion.conditioning = Conditioning::resting(rest);
        let variants = VariantExperiment::new(&application).unwrap();
        let variant = variants.run("guide_2", &specimen.guide().unwrap(), 1, 0).unwrap().peak_error;
        // Noise of the encoder, and what it has loosened in the runs before the step.
        for other in [demo, variant] {
            assert!((other / experiment - 1.0).abs() < 0.01, "{experiment}, {demo}, {variant}");
        }
    }

    #[test]
    fn without_encoder_noise_a_longer_rest_changes_nothing() {
        let quiet = Specimen::of_model(&StageModel::on_guides("guide_2").without_noise()).unwrap();
        let after = |rest| peak(&quiet, &PaperMotion::fine(rest, 1));
        let (short, long) = (after(Conditioning::VARIANT_REST), after(10.0));
        assert!((long / short - 1.0).abs() < 1e-3, "{short}, {long}");
        let noisy = peak(&Specimen::of_guide("guide_2").unwrap(), &PaperMotion::fine(10.0, 1));
        assert!(noisy > 1.02 * long, "{noisy}, {long}");
    }

    /// With F(v) without a fall, dz/dt = v - sigma0 |v| z / Fc: over a way L back and forth z falls
    /// to exp(-sigma0 L / Fc) of itself.
    #[test]
    fn at_rest_the_bristles_let_go_with_the_way_that_the_noise_makes() {
        let specimen = Specimen::of_guide("guide_2").unwrap();
        let guide = specimen.guide().unwrap();
        let motion = PaperMotion::fine(20.0, 0);
        let mut stage =
            specimen.on_stage(&Settings::default(), 0.0, motion.points.clone()).unwrap();
        let mut until = |time: i64| {
            let (start, mut way) = (stage.stage().state().time, 0.0);
            while stage.stage().state().time < time {
                stage.cycle().unwrap();
                way += stage.stage().state().velocity.abs() / 4000.0;
            }
            assert!(start < time);
            (way, stage.stage().state().position, stage.stage().state().bristle_deflection[0])
        };
        let rest = motion.moves[0].arrival + 1_000_000_000;
        let (_, from, before) = until(rest);
        let (way, to, after) = until(rest + 18_000_000_000);
        let expected = (-guide.stiffness * way / guide.coulomb_force).exp();
        assert!((to - from).abs() < 5e-9, "{from} {to}");
        assert!(
            expected < 0.95 && (after / before / expected - 1.0).abs() < 0.02,
            "{} {expected}",
            after / before
        );
    }
}
