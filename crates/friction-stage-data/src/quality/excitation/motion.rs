//! The motion of a recording: travel between reversals, speeds that are held, rests.

use std::ops::Range;

use super::{Examiner, LONGEST_BASE, NOISE_IN_ACCELERATION, rms_of_acceleration_noise};
use crate::signals::Signal;
use friction_stage_core::model::JointType;

/// Shortest stretch of one speed, and of rest, s. Assumed.
const SHORTEST_STRETCH: f64 = 0.05;
/// Travel after a turn, m, in which the bristles of guides are loaded and no speed counts as held.
/// Assumed: more than twice the break-away distance of the paper's guides, 40 µm. It depends on
/// the radius for a turning joint, of which nothing is assumed.
const LOADING: f64 = 1e-4;
/// Travel, m, from the start of a held speed on within which its force becomes steady. Assumed:
/// eight break-away distances, after which a bristle is within e^-8 of its deflection.
pub(super) const STEADY: f64 = 3.0 * LOADING;
/// Moments, at least, for which a speed is held: a few are alike in any slow motion. Assumed.
const HELD_MOMENTS: usize = 10;
/// Speeds within this ratio are the same. Assumed.
const SAME_SPEED: f64 = 1.1;

/// The motion at one row, over [`HALF_BASE`](super::HALF_BASE) to either side.
pub(super) struct Moment {
    pub row: usize,
    pub velocity: f64,
    pub acceleration: f64,
    /// Travel since the carriage turned round last, or since the start, m.
    pub since_turn: f64,
    /// Travel in the half in which it is less, in that of the other one; negative where they have
    /// other directions.
    pub evenness: f64,
}

/// Standard deviations by which an integrated velocity must come back from its farthest point to
/// have turned round. Assumed: a walk of noise alone reaches four of them now and then.
const WALK: f64 = 6.0;

/// A position that goes to and fro.
pub(super) struct Travel {
    direction: f64,
    /// Where it turned last, or began.
    turned: f64,
    farthest: f64,
    /// Rows since the farthest point.
    pub rows: usize,
    /// Travel that is no turn: m, and per root of the rows, the walk of an integrated velocity.
    least: f64,
    walk: f64,
}

impl Travel {
    pub fn from(start: f64, least: f64, walk: f64) -> Self {
        Self { direction: 0.0, turned: start, farthest: start, rows: 0, least, walk }
    }

    /// The next position; how far it had gone if it has turned round.
    pub fn goes_to(&mut self, here: f64) -> Option<f64> {
        self.rows += 1;
        let least = self.least.max(self.walk * (self.rows as f64).sqrt());
        let found = self.turns_at(here, least);
        if self.farthest == here {
            self.rows = 0;
        }
        found
    }

    fn turns_at(&mut self, here: f64, least: f64) -> Option<f64> {
        let moved = here - self.farthest;
        if self.direction == 0.0 {
            if moved.abs() >= least {
                self.direction = moved.signum();
                self.farthest = here;
            }
        } else if moved * self.direction > 0.0 {
            self.farthest = here;
        } else if moved.abs() >= least {
            let amplitude = (self.farthest - self.turned).abs();
            self.direction = -self.direction;
            (self.turned, self.farthest) = (self.farthest, here);
            return Some(amplitude);
        }
        None
    }
}

/// A stretch at a speed that is held.
pub(super) struct Held {
    /// Mean, m/s.
    pub velocity: f64,
    /// s.
    pub time: f64,
    pub rows: Range<usize>,
}

/// The speeds of stretches, slowest first; those that are alike once.
pub(super) fn speeds(held: &[Held]) -> Vec<f64> {
    let mut sorted: Vec<f64> = held.iter().map(|stretch| stretch.velocity.abs()).collect();
    sorted.sort_by(f64::total_cmp);
    let mut groups: Vec<Vec<f64>> = Vec::new();
    for speed in sorted {
        match groups.last_mut() {
            Some(group) if speed <= SAME_SPEED * group[0] => group.push(speed),
            _ => groups.push(vec![speed]),
        }
    }
    groups.iter().map(|group| group[group.len() / 2]).collect()
}

impl Examiner<'_> {
    /// Rows to either side over which velocity and acceleration are taken: as many more than
    /// usual as the noise asks for and the motion allows.
    pub(super) fn half_base(&self, noise: f64, reversals: usize) -> usize {
        let rows: usize = self.segments.iter().map(ExactSizeIterator::len).sum();
        let longest = LONGEST_BASE * rows as f64 / (reversals + 1) as f64;
        let mut tried = Self { findings: Vec::new(), segments: self.segments.clone(), ..*self };
        loop {
            let moments = tried.moments(f64::INFINITY);
            let squares: f64 = moments.iter().map(|m| m.acceleration * m.acceleration).sum();
            let rms = (squares / moments.len().max(1) as f64).sqrt();
            let of_noise = rms_of_acceleration_noise(noise, tried.half as f64 * self.step);
            if of_noise <= NOISE_IN_ACCELERATION * rms || 2.0 * tried.half as f64 > longest {
                return tried.half;
            }
            tried.half *= 2;
        }
    }

    /// What an integrated velocity walks by its noise and is no turn, m per root of the rows.
    pub(super) fn walk(&self) -> f64 {
        WALK * self.velocity_noise * self.step
    }

    /// Moments every half base, in the order of time; moments of different pieces never touch.
    pub(super) fn moments(&self, turn: f64) -> Vec<Moment> {
        let (x, w) = (self.column(Signal::Position), self.half);
        let base = w as f64 * self.step;
        let mut moments = Vec::new();
        for segment in &self.segments {
            let mut travel = Travel::from(x[segment.start], turn, self.walk());
            let mut seen = segment.start;
            for row in (segment.start + w..segment.end.saturating_sub(w)).step_by(w) {
                x[seen..=row].iter().for_each(|here| {
                    travel.goes_to(*here);
                });
                seen = row + 1;
                let (before, here, after) = (x[row - w], x[row], x[row + w]);
                moments.push(Moment {
                    row,
                    velocity: (after - before) / (2.0 * base),
                    acceleration: ((after - here) - (here - before)) / (base * base),
                    evenness: {
                        let (one, two) = (here - before, after - here);
                        let (less, more) =
                            if one.abs() < two.abs() { (one, two) } else { (two, one) };
                        less / more
                    },
                    since_turn: (here - travel.turned).abs(),
                });
            }
        }
        moments
    }

    /// Travel between reversals, number of reversals and distance; a turn by less than `least` is
    /// noise.
    pub(super) fn travel(&self, least: f64) -> (Vec<f64>, usize, f64) {
        let x = self.column(Signal::Position);
        let (mut amplitudes, mut reversals, mut distance) = (Vec::new(), 0, 0.0);
        for segment in &self.segments {
            let mut travel = Travel::from(x[segment.start], least, self.walk());
            for &here in &x[segment.clone()] {
                if let Some(amplitude) = travel.goes_to(here) {
                    amplitudes.push(amplitude);
                    distance += amplitude;
                    reversals += 1;
                }
            }
            distance += (travel.farthest - travel.turned).abs();
        }
        (amplitudes, reversals, distance)
    }

    /// Stretches at a speed that is held, in the order of time.
    pub(super) fn held(&self, moments: &[Moment], rest_speed: f64) -> Vec<Held> {
        let loading = self.loading();
        let moment_s = self.half as f64 * self.step;
        let mut stretches: Vec<Held> = Vec::new();
        let mut from = 0;
        while from < moments.len() {
            let start = &moments[from];
            // A rest is none, and a long one not to be walked again from each of its moments.
            if start.velocity.abs() <= 3.0 * rest_speed || start.since_turn < loading {
                from += 1;
                continue;
            }
            let near = |m: &Moment| {
                (m.velocity - start.velocity).abs()
                    <= 0.02 * start.velocity.abs() + 0.5 * rest_speed
            };
            let mut to = from + 1;
            while to < moments.len()
                && moments[to].row - moments[to - 1].row == self.half
                && near(&moments[to])
            {
                to += 1;
            }
            let time = (to - from) as f64 * moment_s;
            if time >= SHORTEST_STRETCH && to - from >= HELD_MOMENTS {
                let mean =
                    moments[from..to].iter().map(|m| m.velocity).sum::<f64>() / (to - from) as f64;
                let rows = moments[from].row - self.half..moments[to - 1].row + self.half + 1;
                stretches.push(Held { velocity: mean, time, rows });
                from = to;
            } else {
                from += 1;
            }
        }
        stretches
    }

    /// Travel after a turn in which no speed counts as held.
    pub(super) fn loading(&self) -> f64 {
        match self.joint() {
            JointType::Revolute => 0.0,
            JointType::Prismatic => LOADING,
        }
    }

    pub(super) fn rests(&self, moments: &[Moment], rest_speed: f64) -> Vec<f64> {
        let moment_s = self.half as f64 * self.step;
        let mut rests = Vec::new();
        let mut length = 0usize;
        let mut last = None;
        for moment in moments {
            let follows = last.is_some_and(|row| moment.row - row == self.half);
            last = Some(moment.row);
            let rest = moment.velocity.abs() <= rest_speed;
            if length > 0 && (!rest || !follows) {
                rests.push(length as f64 * moment_s);
                length = 0;
            }
            length += usize::from(rest);
        }
        rests.push(length as f64 * moment_s);
        rests.retain(|rest| *rest >= SHORTEST_STRETCH);
        rests
    }
}
