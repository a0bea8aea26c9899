//! Motions that a next experiment is made of: pieces that begin and end at rest, and the trajectory
//! that they add up to.

use friction_stage_core::control::Point;

/// Peak of the acceleration of the quintic rest-to-rest move over distance / duration^2, and of its
/// speed over distance / duration.
pub(super) const QUINTIC: (f64, f64) = (5.773_502_691_896_258, 1.875);
/// Peak acceleration of the start of a run at speed v in time T, over v / T.
pub(super) const RAMP_PEAK: f64 = 1.5;
/// Shortest start of a run, s. Assumed: some periods of the controller's bandwidth.
pub(super) const SHORTEST_RAMP: f64 = 0.05;
/// Rest between moves, s. Assumed: some time constants of the controller.
pub(super) const REST: f64 = 0.15;
/// Points per period of an oscillation: quintic pieces follow a sine to 1e-7 of its amplitude.
pub(super) const POINTS_PER_PERIOD: usize = 32;

/// A piece of motion, begun and ended at rest. m, m/s, Hz, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Segment {
    /// There and back at a constant speed, about the middle of the stroke.
    ConstantSpeed {
        speed: f64,
        distance: f64,
    },
    /// There and back between two places, again and again.
    Passes {
        speed: f64,
        from: f64,
        to: f64,
        count: usize,
    },
    Oscillation {
        amplitude: f64,
        frequency: f64,
        count: usize,
    },
    /// A rest, then a slow start over a short way, then the same backwards.
    RestAndBreakAway {
        rest: f64,
        distance: f64,
        speed: f64,
    },
    /// Rest-to-rest moves there and back.
    FastMoves {
        distance: f64,
        duration: f64,
        count: usize,
    },
}

impl Segment {
    pub(super) fn kind(&self) -> &'static str {
        match self {
            Segment::ConstantSpeed { .. } => "constant_speed",
            Segment::Passes { .. } => "passes",
            Segment::Oscillation { amplitude, .. } if *amplitude < 1e-3 => "reversals",
            Segment::Oscillation { .. } => "sinusoid",
            Segment::RestAndBreakAway { .. } => "rest_and_break_away",
            Segment::FastMoves { .. } => "fast_moves",
        }
    }

    pub(super) fn description(&self) -> String {
        let mm = |metres: f64| {
            if metres.abs() < 1e-3 {
                format!("{:.0} µm", metres * 1e6)
            } else {
                format!("{:.1} mm", metres * 1e3)
            }
        };
        match *self {
            Segment::ConstantSpeed { speed, distance } => {
                format!("{} there and back at {:.4} m/s", mm(distance), speed)
            }
            Segment::Passes { speed, from, to, count } => {
                format!("from {} to {} and back at {speed:.4} m/s, {count} times", mm(from), mm(to))
            }
            Segment::Oscillation { amplitude, frequency, count } => {
                format!("{} at {frequency:.2} Hz, {count} periods", mm(amplitude))
            }
            Segment::RestAndBreakAway { rest, distance, speed } => {
                format!(
                    "rest of {rest:.1} s, then {} at {:.1} mm/s, both ways",
                    mm(distance),
                    speed * 1e3
                )
            }
            Segment::FastMoves { distance, duration, count } => {
                format!(
                    "{} in {:.0} ms, there and back, {count} times",
                    mm(distance),
                    duration * 1e3
                )
            }
        }
    }

    /// Where it starts in the stroke.
    pub(super) fn start(&self, stroke: (f64, f64)) -> f64 {
        let middle = 0.5 * (stroke.0 + stroke.1);
        match *self {
            Segment::ConstantSpeed { distance, .. } | Segment::FastMoves { distance, .. } => {
                middle - 0.5 * distance
            }
            Segment::Passes { from, .. } => from,
            Segment::Oscillation { amplitude, .. } => middle - amplitude,
            Segment::RestAndBreakAway { distance, .. } => middle - 0.5 * distance,
        }
    }

    /// Adds itself to a path that stands at its start; `acceleration` is for starts of runs, m/s^2.
    pub(super) fn follow(&self, path: &mut Path, acceleration: f64) {
        match *self {
            Segment::ConstantSpeed { speed, distance } => {
                for way in [distance, -distance] {
                    path.run(way, speed, acceleration);
                    path.rest(REST);
                }
            }
            Segment::Passes { speed, from, to, count } => {
                for _ in 0..count {
                    for way in [to - from, from - to] {
                        path.run(way, speed, acceleration);
                        path.rest(REST);
                    }
                }
            }
            Segment::Oscillation { amplitude, frequency, count } => {
                path.oscillate(amplitude, frequency, count)
            }
            Segment::RestAndBreakAway { rest, distance, speed } => {
                for way in [distance, -distance] {
                    path.rest(rest);
                    path.run(way, speed, acceleration);
                }
                path.rest(REST);
            }
            Segment::FastMoves { distance, duration, count } => {
                for _ in 0..count {
                    for way in [distance, -distance] {
                        path.to(duration, way, 0.0, 0.0);
                        path.rest(REST);
                    }
                }
            }
        }
    }
}

/// A trajectory under construction.
#[derive(Clone, Debug)]
pub(super) struct Path {
    pub(super) time: i64,
    pub(super) position: f64,
    pub(super) points: Vec<Point>,
}

impl Path {
    /// Begins at `position` at time 0, without a point there.
    pub(super) fn at(position: f64) -> Path {
        Path { time: 0, position, points: Vec::new() }
    }

    pub(super) fn seconds(&self) -> f64 {
        self.time as f64 * 1e-9
    }

    /// Goes on for about `duration` s, in whole 0.1 ms, over `distance` m.
    pub(super) fn to(&mut self, duration: f64, distance: f64, velocity: f64, acceleration: f64) {
        self.time += ((duration * 1e4).ceil() as i64).max(1) * 100_000;
        self.position += distance;
        self.points.push(Point {
            time: self.time,
            position: self.position,
            velocity: Some(velocity),
            acceleration: Some(acceleration),
            effort: 0.0,
        });
    }

    pub(super) fn rest(&mut self, duration: f64) {
        self.to(duration, 0.0, 0.0, 0.0);
    }

    /// From rest to rest over `way`, at a constant speed in between.
    pub(super) fn run(&mut self, way: f64, speed: f64, acceleration: f64) {
        let velocity = speed * way.signum();
        // A whole number of the path's ticks, so that the speed is what it says.
        let ramp = ((RAMP_PEAK * speed / acceleration).max(SHORTEST_RAMP) * 1e4).ceil() * 1e-4;
        let ramped = 0.5 * velocity * ramp;
        let cruise = ((way - 2.0 * ramped) / velocity).max(0.0);
        if cruise < 2e-4 {
            return self.to(way.abs() / speed + ramp, way, 0.0, 0.0);
        }
        let whole = (cruise * 1e4).ceil() * 1e-4;
        let velocity = (way - 2.0 * ramped) / whole;
        let ramped = 0.5 * velocity * ramp;
        let rest_of_way = way - 2.0 * ramped;
        self.to(ramp, ramped, velocity, 0.0);
        self.to(rest_of_way / velocity, rest_of_way, velocity, 0.0);
        self.to(ramp, ramped, 0.0, 0.0);
    }

    pub(super) fn oscillate(&mut self, amplitude: f64, frequency: f64, count: usize) {
        let (from, start, rate) = (self.position, self.time, std::f64::consts::TAU * frequency);
        for k in 1..=count * POINTS_PER_PERIOD {
            let after = k as f64 / (POINTS_PER_PERIOD as f64 * frequency);
            let (sine, cosine) = (rate * after).sin_cos();
            self.time = start + (after * 1e9).round() as i64;
            self.position = from + amplitude * (1.0 - cosine);
            self.points.push(Point {
                time: self.time,
                position: self.position,
                velocity: Some(amplitude * rate * sine),
                acceleration: Some(amplitude * rate * rate * cosine),
                effort: 0.0,
            });
        }
        self.position = from;
        self.rest(REST);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_goes_where_it_should_at_the_speed_that_it_says() {
        for (way, speed) in [(0.02, 0.05), (-0.02, 0.05), (0.02, 0.013), (0.0005, 0.1)] {
            let mut path = Path::at(0.01);
            path.run(way, speed, 5.0);
            assert!((path.position - 0.01 - way).abs() < 1e-12);
            let fastest = path
                .points
                .iter()
                .filter_map(|point| point.velocity)
                .fold(0.0, |most: f64, v| most.max(v.abs()));
            assert!(fastest <= speed * 1.000_001, "{fastest} {speed}");
            assert!(way.abs() < 0.01 || fastest > 0.98 * speed, "{fastest} {speed}");
            assert!(path.points.windows(2).all(|pair| pair[1].time > pair[0].time));
        }
    }
}
