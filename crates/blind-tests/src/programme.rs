//! The motion of the records: setpoint position (m), velocity (m/s) and acceleration (m/s^2), one
//! row per tick.
//!
//! The pieces and their numbers are those of the recorded stage runs (read off their setpoints):
//! strokes with a sinusoidal acceleration, oscillations of 1 µm to 0.42 mm for the presliding
//! regime, strokes of constant speed from 2 to 800 mm/s there and back, 50 mm moves in 100 ms,
//! steps of 10 µm in 3 ms, and a sum of sines with random phases. Everything stays within +-0.2 m
//! and 1 m/s.

use std::f64::consts::TAU;

use super::noise::Noise;

/// Which motion a pair of records holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Programme {
    /// The speeds, strokes and rests of the recorded stage runs; only phases and check moves are
    /// random.
    #[default]
    Recorded,
    /// The same kinds of pieces, with every speed, amplitude, stroke and rest drawn within 0.7 to
    /// 1.3 of it.
    Varied,
    /// As recorded, with a rest of 8 s in each record.
    Resting,
}

/// Setpoints, one row per tick, starting and ending at rest.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Setpoints {
    /// Position, m.
    pub position: Vec<f64>,
    /// Velocity, m/s.
    pub velocity: Vec<f64>,
    /// Acceleration, m/s^2.
    pub acceleration: Vec<f64>,
}

/// Shortest time in which a stroke of constant speed gets up to speed, s.
const SHORTEST_RAMP: f64 = 0.02;
/// Time to get up to speed per speed, s per m/s: a peak of 4.2 m/s^2.
const RAMP_PER_SPEED: f64 = 0.475;
/// Constant speeds (m/s) and strokes (m) of the train record.
const SPEEDS: [(f64, f64); 9] = [
    (0.002, 0.003),
    (0.005, 0.006),
    (0.010, 0.012),
    (0.020, 0.030),
    (0.050, 0.100),
    (0.100, 0.200),
    (0.200, 0.220),
    (0.400, 0.220),
    (0.800, 0.220),
];
/// Constant speeds (m/s) and strokes (m) of the check record.
const CHECK_SPEEDS: [(f64, f64); 4] =
    [(0.003, 0.0036), (0.015, 0.018), (0.070, 0.084), (0.300, 0.100)];
/// Amplitude (m), frequency (Hz) and periods of the presliding oscillations of the train record.
const OSCILLATIONS: [(f64, f64, f64); 4] =
    [(1e-6, 2.0, 3.0), (10e-6, 2.0, 3.0), (40e-6, 1.5, 3.0), (420e-6, 1.0, 3.0)];
/// As [`OSCILLATIONS`], of the check record.
const CHECK_OSCILLATIONS: [(f64, f64, f64); 2] = [(3e-6, 1.5, 2.0), (80e-6, 1.5, 2.0)];
/// Lines of the sum of sines of the train record, Hz: no two are multiples of each other.
/// Amplitudes go with 1/f.
const LINES: [f64; 6] = [0.7, 1.9, 3.2, 5.3, 7.9, 11.3];
/// As [`LINES`], of the check record.
const CHECK_LINES: [f64; 4] = [0.9, 2.3, 4.9, 8.3];
/// Highest speed of the random moves of the check record, m/s.
const FASTEST: f64 = 0.95;

/// Setpoints under construction.
struct Path {
    tick: f64,
    at: f64,
    rows: Setpoints,
    vary: Option<Noise>,
}

/// A motion from 0 for a time, with its end: (position, velocity, acceleration) over time.
type Shape<'a> = &'a dyn Fn(f64) -> [f64; 3];

impl Path {
    fn new(rate: f64, vary: Option<Noise>) -> Self {
        Self { tick: 1.0 / rate, at: 0.0, rows: Setpoints::default(), vary }
    }

    /// A number of the programme, as it is or varied.
    fn about(&mut self, value: f64) -> f64 {
        self.vary.as_mut().map_or(value, |noise| value * noise.between(0.7, 1.3))
    }

    fn push(&mut self, position: f64, velocity: f64, acceleration: f64) {
        self.rows.position.push(position);
        self.rows.velocity.push(velocity);
        self.rows.acceleration.push(acceleration);
    }

    fn rest(&mut self, duration: f64) {
        let duration = self.about(duration);
        for _ in 0..(duration / self.tick).round() as usize {
            self.push(self.at, 0.0, 0.0);
        }
    }

    fn follow(&mut self, duration: f64, end: f64, shape: Shape<'_>) {
        let ticks = (duration / self.tick).ceil() as usize;
        for k in 0..ticks {
            let [position, velocity, acceleration] = shape(k as f64 * self.tick);
            self.push(self.at + position, velocity, acceleration);
        }
        self.at += end;
        self.push(self.at, 0.0, 0.0);
    }

    /// A stroke with acceleration 2 pi D/T^2 sin(2 pi t/T) (cycloid).
    fn stroke_to(&mut self, to: f64, duration: f64) {
        let distance = to - self.at;
        self.follow(duration, distance, &|t| {
            let s = TAU * t / duration;
            [
                distance * (t / duration - s.sin() / TAU),
                distance / duration * (1.0 - s.cos()),
                distance * TAU / duration.powi(2) * s.sin(),
            ]
        });
    }

    /// A stroke of at least `distance` (signed) with a constant speed in the middle; the speed
    /// ramps up as t/T - sin(2 pi t/T)/2 pi.
    fn constant_speed(&mut self, speed: f64, distance: f64) {
        let ramp = (RAMP_PER_SPEED * speed).max(SHORTEST_RAMP);
        let length = distance.abs().max(speed * ramp);
        let cruise = (length / speed - ramp).max(0.0);
        let total = cruise + 2.0 * ramp;
        let sign = distance.signum();
        let rising = |t: f64| {
            let s = TAU * t / ramp;
            [
                speed * ramp * (0.5 * (t / ramp).powi(2) - (1.0 - s.cos()) / TAU.powi(2)),
                speed * (t / ramp - s.sin() / TAU),
                speed / ramp * (1.0 - s.cos()),
            ]
        };
        self.follow(total, sign * length, &|t| {
            let [x, v, a] = if t < ramp {
                rising(t)
            } else if t <= ramp + cruise {
                [speed * (t - 0.5 * ramp), speed, 0.0]
            } else {
                let [x, v, a] = rising((total - t).max(0.0));
                [length - x, v, -a]
            };
            [sign * x, sign * v, sign * a]
        });
    }

    /// `periods` of a sine about where the stage is, faded in and out over half a period with 3
    /// s^2 - 2 s^3.
    fn oscillation(&mut self, amplitude: f64, frequency: f64, periods: f64) {
        let (duration, w) = (periods / frequency, TAU * frequency);
        let wave = |t: f64| [(w * t).sin(), w * (w * t).cos(), -w * w * (w * t).sin()];
        self.follow(duration, 0.0, &|t| {
            faded(t, duration, 0.5 / frequency, wave(t)).map(|q| amplitude * q)
        });
    }

    /// A sum of sines with amplitudes that go with 1/f, at most `amplitude` from where the stage
    /// is.
    fn sum_of_sines(&mut self, amplitude: f64, duration: f64, lines: &[f64], noise: &mut Noise) {
        let lines: Vec<(f64, f64)> = lines.iter().map(|&f| (TAU * f, noise.angle())).collect();
        let wave = |t: f64| {
            let mut sum = [0.0; 3];
            for &(w, phase) in &lines {
                let (sin, cos) = (w * t + phase).sin_cos();
                sum[0] += (sin - phase.sin()) / w;
                sum[1] += cos;
                sum[2] -= w * sin;
            }
            faded(t, duration, 0.4, sum)
        };
        let ticks = (duration / self.tick).ceil() as usize;
        let peak = (0..ticks).map(|k| wave(k as f64 * self.tick)[0].abs()).fold(0.0, f64::max);
        self.follow(duration, 0.0, &|t| wave(t).map(|q| amplitude / peak * q));
    }
}

/// A motion times a window that rises and falls with 3 s^2 - 2 s^3 over `edge`, with the exact
/// derivatives.
fn faded(t: f64, duration: f64, edge: f64, [x, v, a]: [f64; 3]) -> [f64; 3] {
    let step = |s: f64| {
        if s >= 1.0 {
            [1.0, 0.0, 0.0]
        } else {
            [s * s * (3.0 - 2.0 * s), 6.0 * s * (1.0 - s), 6.0 - 12.0 * s]
        }
    };
    let (rise, fall) = (step(t / edge), step(((duration - t) / edge).max(0.0)));
    // The edges do not overlap, so products of their slopes vanish.
    let w = rise[0] * fall[0];
    let dw = (rise[1] - fall[1]) / edge;
    let ddw = (rise[2] + fall[2]) / edge.powi(2);
    [w * x, w * v + dw * x, w * a + 2.0 * dw * v + ddw * x]
}

impl Programme {
    fn vary(self, noise: &mut Noise) -> Option<Noise> {
        (self == Self::Varied).then(|| Noise::new((noise.unit() * 1e15) as u64, 7))
    }

    /// The rest that may be long, s.
    fn pause(self, usual: f64) -> f64 {
        if self == Self::Resting { 8.0 } else { usual }
    }

    /// The train record at `rate` (Hz), about 46 s.
    pub fn train(self, rate: f64, noise: &mut Noise) -> Setpoints {
        let mut path = Path::new(rate, self.vary(noise));
        path.rest(0.5);
        path.stroke_to(-0.05, 0.4);
        path.rest(0.6);
        for (amplitude, frequency, periods) in OSCILLATIONS {
            let amplitude = path.about(amplitude);
            path.oscillation(amplitude, frequency, periods);
            path.rest(if amplitude > 1e-4 { 0.3 } else { 0.2 });
        }
        path.stroke_to(-0.12, 0.6);
        path.rest(self.pause(0.3));
        for (speed, distance) in SPEEDS {
            let speed = path.about(speed).min(FASTEST);
            for direction in [1.0, -1.0] {
                path.constant_speed(speed, direction * distance);
                path.rest(0.15);
            }
        }
        path.stroke_to(-0.05, 0.4);
        path.rest(0.3);
        let duration = path.about(0.1).max(0.1);
        for _ in 0..3 {
            for to in [0.0, -0.05] {
                path.stroke_to(to, duration);
                path.rest(0.25);
            }
        }
        path.stroke_to(0.0, 0.3);
        path.rest(0.2);
        path.sum_of_sines(0.02, 4.0, &LINES, noise);
        path.rest(0.3);
        path.rows
    }

    /// The check record at `rate` (Hz), about 19 s: other moves than the train record.
    pub fn check(self, rate: f64, noise: &mut Noise) -> Setpoints {
        let mut path = Path::new(rate, self.vary(noise));
        path.rest(0.3);
        path.stroke_to(-0.1, 0.5);
        path.rest(self.pause(0.4));
        for _ in 0..10 {
            let to = noise.between(-0.115, 0.115);
            let shortest = 2.0 * (to - path.at).abs() / FASTEST;
            let duration = [0.12, 0.2, 0.35, 0.7][noise.index(4)];
            path.stroke_to(to, f64::max(duration, shortest));
            path.rest(noise.between(0.1, 0.39));
        }
        let away = -path.at.signum();
        for (index, (speed, distance)) in CHECK_SPEEDS.into_iter().enumerate() {
            let speed = path.about(speed);
            path.constant_speed(speed, if index == 3 { -away * distance } else { away * distance });
            path.rest(0.15);
        }
        for (amplitude, frequency, periods) in CHECK_OSCILLATIONS {
            let amplitude = path.about(amplitude);
            path.oscillation(amplitude, frequency, periods);
            path.rest(0.2);
        }
        for _ in 0..8 {
            path.stroke_to(path.at + 10e-6, 0.003);
            path.rest(0.06);
        }
        path.sum_of_sines(0.03, 3.0, &CHECK_LINES, noise);
        path.rest(0.3);
        path.rows
    }
}
