//! Pieces of motion laid out within the limits, and run in closed loop with the identified model.

use super::limits::{Limits, NextExperimentError};
use super::motion::{Path, QUINTIC, RAMP_PEAK, REST, SHORTEST_RAMP, Segment};
use crate::record::measured::{MIN_SAMPLES, Measured};
use crate::search::{Selection, Verdict};
use friction_stage_core::control::{Controller, ControllerSettings, Follower, Gains, Trajectory};
use friction_stage_core::model::{Coordinate as Over, StageModel};
use friction_stage_core::plant::effects::Effects;
use friction_stage_core::plant::{Rates, Stage};
use friction_stage_data::signals::Trace;

/// Part of the force beyond friction that a piece is laid out for: the rest is for the controller
/// and the effects.
pub(super) const FORCE_SHARE: f64 = 0.8;
/// Part of that with which runs of constant speed start and stop.
pub(super) const GENTLE: f64 = 0.3;
/// Bandwidth of the simulated controller, Hz, and its largest share of the rate.
pub(super) const BANDWIDTH: (f64, f64) = (60.0, 1.0 / 14.0);

/// What the carriage may be beyond the stroke, m: what it overshoots by where it reverses on a
/// stroke of a few break-away distances. Assumed.
const SLACK: f64 = 1e-6;

/// A motion run with the identified model.
pub(super) struct Simulated {
    pub(super) measured: Measured,
    /// N
    pub(super) peak_force: f64,
    /// m/s
    pub(super) peak_speed: f64,
    /// m
    pub(super) range: (f64, f64),
}

/// What candidates are laid out for and simulated with.
pub(super) struct Layout<'a> {
    /// Limits of the reference, and those that the carriage must not leave either.
    pub(super) limits: Limits,
    hard: Limits,
    pub(super) model: StageModel,
    pub(super) declared: &'a StageModel,
    /// kg, with what the effects add.
    pub(super) mass: f64,
    /// Largest acceleration of a move, m/s^2, and of the start of a run.
    pub(super) acceleration: f64,
    pub(super) gentle: f64,
    /// Way after which the guides have forgotten where they came from, m.
    pub(super) forget: f64,
    pub(super) rate: f64,
    pub(super) has_cell: bool,
}

impl<'a> Layout<'a> {
    pub(super) fn new(
        selection: &Selection,
        declared: &'a StageModel,
        train: &Measured,
        limits: Limits,
    ) -> Result<Layout<'a>, NextExperimentError> {
        let after = &selection.after.fitted.hypothesis;
        let model = after.model();
        limits.check(&model)?;
        let hard = limits;
        let limits = hard.with_room();
        let (forget, moving) = limits.friction(&model)?;
        let mass = model.mass + Effects::new(&model.effects)?.added_mass();
        let acceleration = FORCE_SHARE * (limits.force - moving) / mass;
        // A grid of whole nanoseconds misses a whole number of hertz by its rounding.
        let rate = train.rate;
        let rate = if (rate - rate.round()).abs() < 1e-5 * rate { rate.round() } else { rate };
        Ok(Layout {
            limits,
            hard,
            model,
            declared,
            mass,
            acceleration,
            gentle: GENTLE * acceleration,
            forget,
            rate,
            has_cell: train.cell.is_some(),
        })
    }

    pub(super) fn span(&self) -> f64 {
        self.limits.stroke.1 - self.limits.stroke.0
    }

    pub(super) fn middle(&self) -> f64 {
        0.5 * (self.limits.stroke.0 + self.limits.stroke.1)
    }

    /// Time for a rest-to-rest move at this part of speed and acceleration, s.
    pub(super) fn time_for(&self, distance: f64, part: f64) -> f64 {
        let by_speed = QUINTIC.1 * distance.abs() / (part * self.limits.speed);
        by_speed.max((QUINTIC.0 * distance.abs() / (part * self.acceleration)).sqrt())
    }

    /// Pieces that the motion may be made of.
    pub(super) fn candidates(&self) -> Vec<Segment> {
        let (speed, span) = (self.limits.speed, self.span());
        let mut found = Vec::new();
        for share in [1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.004, 0.001] {
            let speed = share * speed;
            let ramp = (RAMP_PEAK * speed / self.gentle).max(SHORTEST_RAMP);
            // Long enough to be steady for a while, and no longer than a second where it is slow.
            let distance = (speed * (2.0 * ramp + 1.0)).max(4.0 * self.forget).min(0.9 * span);
            if distance > 1.5 * speed * ramp {
                found.push(Segment::ConstantSpeed { speed, distance });
            }
        }
        for share in [1.0, 0.4, 0.1, 0.02] {
            let speed = share * speed;
            if span > 1.5 * speed * (RAMP_PEAK * speed / self.gentle).max(SHORTEST_RAMP) {
                let (from, to) = self.limits.stroke;
                found.push(Segment::Passes { speed, from, to, count: 3 });
            }
        }
        for amplitude in [1e-6, 5e-6, 20e-6, 100e-6, 400e-6] {
            if 2.0 * amplitude < span {
                found.push(Segment::Oscillation { amplitude, frequency: 2.0, count: 3 });
            }
        }
        for part in [0.02, 0.1, 0.4] {
            let amplitude = part * span;
            let fastest = (speed / amplitude).min((self.acceleration / amplitude).sqrt())
                / std::f64::consts::TAU;
            for share in [0.95, 0.4] {
                // Slow enough for the controller to follow.
                let frequency = (share * fastest).min(0.25 * self.bandwidth());
                found.push(Segment::Oscillation { amplitude, frequency, count: 4 });
            }
        }
        for rest in [0.1, 0.5, 2.0, 5.0] {
            let distance = (4.0 * self.forget).min(0.5 * span);
            found.push(Segment::RestAndBreakAway { rest, distance, speed: (2e-3f64).min(speed) });
        }
        for part in [0.95, 0.5, 0.2] {
            let distance = part * span;
            for slower in [1.0, 2.0] {
                let duration = slower * self.time_for(distance, 1.0).max(SHORTEST_RAMP);
                found.push(Segment::FastMoves { distance, duration, count: 3 });
            }
        }
        found
    }

    /// Pieces that show again and again what no law explains.
    pub(super) fn repeated(&self, selection: &Selection) -> Vec<Segment> {
        if selection.verdict != Verdict::Unknown {
            return Vec::new();
        }
        let curve = selection.after.fitted.hypothesis.effects.iter().find_map(|part| part.curve());
        let (low, high) = self.limits.stroke;
        let (kind, from, to) = match &curve {
            Some(curve) if curve.coordinate == Over::Position => {
                let (from, to) = (curve.from.max(low), curve.to.min(high));
                // A map that lies outside the stroke: then all of the stroke.
                let (from, to) =
                    if to - from >= 4.0 * self.forget { (from, to) } else { (low, high) };
                (Over::Position, from, to)
            }
            Some(curve) => (curve.coordinate, low, high),
            None => (Over::Time, low, high),
        };
        let (runs, count): (usize, usize) = match kind {
            Over::Position => (3, 2),
            Over::Velocity => (5, 1),
            Over::Time => (2, 2),
        };
        // No faster than the way to get up to speed and down again allows, and so slow that the
        // slowest takes half of the time, or a third of the fastest where there is time for less.
        let reachable = (0.5 * (to - from) * self.gentle / RAMP_PEAK).sqrt();
        let fastest = reachable.min(0.9 * self.limits.speed);
        let time = 0.9 * self.limits.duration;
        let slowest = (4.0 * count as f64 * (to - from) / time).min(fastest / 3.0);
        let mut pieces: Vec<Segment> = (0..runs)
            .map(|run| {
                let share = run as f64 / (runs - 1) as f64;
                // Over time the same motion again: what has changed is not the motion.
                let speed = if kind == Over::Time {
                    fastest / 3.0
                } else {
                    slowest * (fastest / slowest).powf(share)
                };
                Segment::Passes { speed, from, to, count }
            })
            .collect();
        // What does not fit goes, the slow ones first.
        while pieces.len() > 1
            && pieces.iter().map(|piece| self.duration(piece)).sum::<f64>() > self.limits.duration
        {
            pieces.remove(0);
        }
        pieces
    }

    /// Of a piece without the way to it, s.
    pub(super) fn duration(&self, piece: &Segment) -> f64 {
        let mut alone = Path::at(piece.start(self.limits.stroke));
        piece.follow(&mut alone, self.gentle);
        alone.seconds()
    }

    pub(super) fn bandwidth(&self) -> f64 {
        BANDWIDTH.0.min(BANDWIDTH.1 * self.rate)
    }

    /// A path from anywhere in the stroke to `start`, the last bit of it always the same way, so
    /// that the guides know where they are.
    pub(super) fn approach(&self, from: f64, start: f64) -> Path {
        let mut path = Path::at(from);
        let excursion = self.forget.min(0.25 * self.span());
        let before = if start - excursion >= self.limits.stroke.0 {
            start - excursion
        } else {
            start + excursion
        };
        path.to(self.time_for(self.span(), 0.5).max(0.5), before - from, 0.0, 0.0);
        path.rest(REST);
        path.to(self.time_for(excursion, 0.1).max(0.2), start - before, 0.0, 0.0);
        path.rest(REST);
        path
    }

    /// The whole motion of these pieces, for a stage that comes from `from`.
    pub(super) fn compose(&self, pieces: &[Segment], from: f64) -> Path {
        let first = pieces.first().map_or(self.middle(), |piece| piece.start(self.limits.stroke));
        let mut path = self.approach(from, first);
        for piece in pieces {
            let way = piece.start(self.limits.stroke) - path.position;
            if way.abs() > 1e-9 {
                path.to(self.time_for(way, 0.5).max(0.1), way, 0.0, 0.0);
                path.rest(REST);
            }
            piece.follow(&mut path, self.gentle);
        }
        path
    }

    /// Runs the motion in closed loop, without noise; `from` s on the rows count. `None`: it goes
    /// beyond the limits.
    pub(super) fn simulate(
        &self,
        path: &Path,
        start: f64,
        from: f64,
    ) -> Result<Option<Simulated>, NextExperimentError> {
        let rates = Rates::of_control(self.rate)?;
        let quiet = self.model.clone().without_noise();
        let mut stage = Stage::new(&quiet, rates, 0)?;
        stage.set_state(start, 0.0, &vec![0.0; quiet.guides.len()]);
        let mut settings =
            ControllerSettings::paper(self.mass, self.rate, self.model.motor.force_limit);
        settings.gains = Gains::from_bandwidth(self.bandwidth(), self.mass);
        let mut controller = Controller::new(settings)?;
        let mut follower = Follower::new(f64::INFINITY);
        let samples = ((path.seconds() + REST) * self.rate).ceil() as usize;
        let samples = samples.max(MIN_SAMPLES + self.rate as usize / 2);
        let mut trace = Trace::default();
        let (mut peak_force, mut peak_speed) = (0f64, 0f64);
        for row in 0..samples {
            let sample = stage.sample();
            if row == 0 {
                follower.hold(sample.time, sample.position);
                follower.follow(sample.time, Trajectory::new(sample.time, path.points.clone())?)?;
            }
            let terms = controller.update(sample.time, sample.position, &mut follower);
            peak_force = peak_force.max(terms.output.abs());
            peak_speed = peak_speed.max(terms.reference.velocity.abs());
            trace.time.push(sample.time as f64 * 1e-9);
            trace.reference_position.push(terms.reference.position);
            trace.reference_velocity.push(terms.reference.velocity);
            trace.reference_acceleration.push(terms.reference.acceleration);
            trace.position.push(sample.position);
            trace.force_cell.push(if self.has_cell { sample.force_cell } else { f64::NAN });
            trace.force.push(terms.output);
            stage.advance(terms.output);
        }
        let ways = trace.reference_position.iter().chain(&trace.position);
        let range = ways
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(*x), high.max(*x)));
        let (low, high) = self.hard.stroke;
        if range.0 < low - SLACK
            || range.1 > high + SLACK
            || peak_force > self.hard.force
            || peak_speed > self.hard.speed
        {
            return Ok(None);
        }
        let mut measured = Measured::new(&trace, self.declared, "the simulated motion")?;
        let (time, until) = (&measured.time, path.seconds());
        let rows = measured
            .rows
            .iter()
            .copied()
            .filter(|row| (from..=until).contains(&time[*row]))
            .collect();
        measured.rows = rows;
        Ok(Some(Simulated { measured, peak_force, peak_speed, range }))
    }
}
