//! The motion of a recording: travel between reversals, speeds that are held, rests.

use super::Examiner;
use crate::signals::Signal;

/// Shortest stretch of one speed, and of rest, s. Assumed.
const SHORTEST_STRETCH: f64 = 0.05;
/// Speeds within this ratio are the same. Assumed.
const SAME_SPEED: f64 = 1.1;

/// The motion at one row, over [`HALF_BASE`](super::HALF_BASE) to either side.
pub(super) struct Moment {
    pub row: usize,
    pub velocity: f64,
    pub acceleration: f64,
}

impl Examiner<'_> {
    /// Moments every half base, in the order of time; moments of different pieces never touch.
    pub(super) fn moments(&self) -> Vec<Moment> {
        let (x, w) = (self.column(Signal::Position), self.half);
        let base = w as f64 * self.step;
        let mut moments = Vec::new();
        for segment in &self.segments {
            for row in (segment.start + w..segment.end.saturating_sub(w)).step_by(w) {
                let (before, here, after) = (x[row - w], x[row], x[row + w]);
                moments.push(Moment {
                    row,
                    velocity: (after - before) / (2.0 * base),
                    acceleration: ((after - here) - (here - before)) / (base * base),
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
            let (mut direction, mut turned, mut farthest) =
                (0.0, x[segment.start], x[segment.start]);
            for &here in &x[segment.clone()] {
                let moved = here - farthest;
                if direction == 0.0 {
                    if moved.abs() >= least {
                        direction = moved.signum();
                        farthest = here;
                    }
                } else if moved * direction > 0.0 {
                    farthest = here;
                } else if moved.abs() >= least {
                    amplitudes.push((farthest - turned).abs());
                    distance += (farthest - turned).abs();
                    reversals += 1;
                    direction = -direction;
                    turned = farthest;
                    farthest = here;
                }
            }
            distance += (farthest - turned).abs();
        }
        (amplitudes, reversals, distance)
    }

    /// Speeds that are held, slowest first, and each stretch with its length in s.
    pub(super) fn speeds(
        &self,
        moments: &[Moment],
        rest_speed: f64,
    ) -> (Vec<f64>, Vec<(f64, f64)>) {
        let moment_s = self.half as f64 * self.step;
        let mut stretches: Vec<(f64, f64)> = Vec::new();
        let mut from = 0;
        while from < moments.len() {
            let start = &moments[from];
            // A rest is none, and a long one not to be walked again from each of its moments.
            if start.velocity.abs() <= 3.0 * rest_speed {
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
            if time >= SHORTEST_STRETCH {
                let mean =
                    moments[from..to].iter().map(|m| m.velocity).sum::<f64>() / (to - from) as f64;
                stretches.push((mean.abs(), time));
                from = to;
            } else {
                from += 1;
            }
        }
        let mut sorted: Vec<f64> = stretches.iter().map(|(speed, _)| *speed).collect();
        sorted.sort_by(f64::total_cmp);
        let mut groups: Vec<Vec<f64>> = Vec::new();
        for speed in sorted {
            match groups.last_mut() {
                Some(group) if speed <= SAME_SPEED * group[0] => group.push(speed),
                _ => groups.push(vec![speed]),
            }
        }
        (groups.iter().map(|group| group[group.len() / 2]).collect(), stretches)
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
