//! The motion that a controller follows: streamed setpoints and trajectories, interpolated between
//! their points.

/// Where the stage should be: m, m/s, m/s^2; `effort` is a force feedforward of the sender, N.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reference {
    /// m
    pub position: f64,
    /// m/s
    pub velocity: f64,
    /// m/s^2
    pub acceleration: f64,
    /// Force that is added to the controller's, N.
    pub effort: f64,
}

/// A point of a trajectory, `time` ns after its start. Absent velocity or acceleration lowers the
/// order of interpolation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point {
    /// After the start of the trajectory, ns.
    pub time: i64,
    /// m
    pub position: f64,
    /// m/s
    pub velocity: Option<f64>,
    /// m/s^2
    pub acceleration: Option<f64>,
    /// Force that is added to the controller's, N.
    pub effort: f64,
}

impl Point {
    /// At rest at a position, m, `time` ns after the start of the trajectory.
    pub fn at_rest(time: i64, position: f64) -> Point {
        Point { time, position, velocity: Some(0.0), acceleration: Some(0.0), ..Point::default() }
    }
}

/// A checked list of points with its start, ns on the clock of the samples.
///
/// Between two points as joint_trajectory_controller does: quintic where both give velocity and
/// acceleration, cubic where both give velocity, linear else. Before the first point the motion
/// comes from where the reference was at the start.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    start: i64,
    points: Vec<Point>,
}

/// Why a setpoint or a trajectory is refused. Index counts points from 0.
#[expect(missing_docs, reason = "the message of each says what its fields are")]
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TrajectoryError {
    #[error("the trajectory has no points")]
    Empty,
    #[error("point {index}: {quantity} is {value}, must be finite")]
    NotFinite { index: usize, quantity: &'static str, value: f64 },
    #[error(
        "point {index}: time_from_start {time} ns does not come after {previous} ns of the point \
         before"
    )]
    TimeOrder { index: usize, time: i64, previous: i64 },
    #[error(
        "setpoint jumps by {jump:.3e} m from {from:.6e} m, at most {limit:.3e} m without a motion: \
         send a trajectory"
    )]
    Jump { jump: f64, from: f64, limit: f64 },
    #[error("the trajectory ends at {end} ns, before now ({now} ns)")]
    Past { end: i64, now: i64 },
    #[error(
        "the motion to point {index} reaches {position:.6e} m, must stay between {low} and {high} m"
    )]
    Stroke { index: usize, position: f64, low: f64, high: f64 },
    #[error(
        "the motion to point {index}: {quantity} reaches {value:.3e}, must stay below {limit:e}"
    )]
    TooFast { index: usize, quantity: &'static str, value: f64, limit: f64 },
}

/// Follows what it is given: holds a reference, follows a trajectory, takes streamed setpoints.
#[derive(Clone, Debug)]
pub struct Follower {
    held: Reference,
    held_since: i64,
    active: Option<Active>,
    /// Largest step of a streamed setpoint, m, beyond what its own velocity explains.
    jump_limit: f64,
    /// Lowest and highest reference, m.
    stroke: (f64, f64),
}

/// Positions, m, speeds, m/s, and accelerations, m/s^2, that no stage reaches: a reference beyond
/// them is a slip, and controllers compute with its squares.
const LARGEST: [(&str, f64); 3] = [("position", 1e6), ("velocity", 1e6), ("acceleration", 1e9)];
/// The same of efforts, N: interpolation between larger ones of opposite signs overflows.
const LARGEST_EFFORT: f64 = 1e9;

#[derive(Clone, Debug)]
struct Active {
    trajectory: Trajectory,
    /// Reference at the start, the first point of the first segment.
    origin: Point,
    segment: usize,
}

impl Trajectory {
    /// `start` in ns on the clock of the samples.
    pub fn new(start: i64, points: Vec<Point>) -> Result<Trajectory, TrajectoryError> {
        if points.is_empty() {
            return Err(TrajectoryError::Empty);
        }
        let mut previous = -1;
        for (index, point) in points.iter().enumerate() {
            let quantities = [
                ("position", Some(point.position)),
                ("velocity", point.velocity),
                ("acceleration", point.acceleration),
                ("effort", Some(point.effort)),
            ];
            for (quantity, value) in quantities {
                if let Some(value) = value.filter(|value| !value.is_finite()) {
                    return Err(TrajectoryError::NotFinite { index, quantity, value });
                }
            }
            if point.time <= previous {
                return Err(TrajectoryError::TimeOrder { index, time: point.time, previous });
            }
            previous = point.time;
        }
        Ok(Trajectory { start, points })
    }

    /// A rest-to-rest move: quintic from where the reference is to `position`, over `duration` ns.
    pub fn rest_to_rest(start: i64, position: f64, duration: i64) -> Trajectory {
        let point = Point {
            time: duration,
            position,
            velocity: Some(0.0),
            acceleration: Some(0.0),
            effort: 0.0,
        };
        Trajectory { start, points: vec![point] }
    }

    /// The same motion, starting `by` ns later.
    pub fn shifted(self, by: i64) -> Trajectory {
        Trajectory { start: self.start + by, ..self }
    }

    /// Start on the clock of the samples, ns.
    pub fn start(&self) -> i64 {
        self.start
    }

    /// The points, in the order of time.
    pub fn points(&self) -> &[Point] {
        &self.points
    }

    /// Instant of the last point, ns.
    pub fn end(&self) -> i64 {
        self.start.saturating_add(self.points.last().map_or(0, |point| point.time))
    }
}

/// The motion from one point to the next: a polynomial over u in 0..1.
struct Segment {
    /// s
    span: f64,
    /// Of the powers 0 to 5 of u, m.
    coefficients: [f64; 6],
    degree: usize,
    effort: (f64, f64),
}

impl Segment {
    fn new(a: &Point, b: &Point) -> Segment {
        let span = (b.time - a.time) as f64 * 1e-9;
        let delta = b.position - a.position;
        let (degree, rest) = match (a.velocity.zip(b.velocity), a.acceleration.zip(b.acceleration))
        {
            (Some((va, vb)), Some((aa, ab))) => {
                let (va, vb) = (va * span, vb * span);
                let (aa, ab) = (aa * span * span, ab * span * span);
                let c2 = 0.5 * aa;
                let c3 = 10.0 * delta - 6.0 * va - 4.0 * vb - 1.5 * aa + 0.5 * ab;
                let c4 = -15.0 * delta + 8.0 * va + 7.0 * vb + 1.5 * aa - ab;
                let c5 = 6.0 * delta - 3.0 * (va + vb) - 0.5 * (aa - ab);
                (5, [va, c2, c3, c4, c5])
            }
            (Some((va, vb)), None) => {
                let (va, vb) = (va * span, vb * span);
                let c2 = 3.0 * delta - 2.0 * va - vb;
                let c3 = -2.0 * delta + va + vb;
                (3, [va, c2, c3, 0.0, 0.0])
            }
            (None, _) => (1, [delta, 0.0, 0.0, 0.0, 0.0]),
        };
        let [c1, c2, c3, c4, c5] = rest;
        let coefficients = [a.position, c1, c2, c3, c4, c5];
        Segment { span, coefficients, degree, effort: (a.effort, b.effort) }
    }

    #[inline]
    fn at(&self, u: f64) -> Reference {
        let [start, c1, c2, c3, c4, c5] = self.coefficients;
        let span = self.span;
        let effort = self.effort.0 + (self.effort.1 - self.effort.0) * u;
        match self.degree {
            5 => Reference {
                position: start + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5)))),
                velocity: (c1 + u * (2.0 * c2 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5))))
                    / span,
                acceleration: (2.0 * c2 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5)))
                    / (span * span),
                effort,
            },
            3 => Reference {
                position: start + u * (c1 + u * (c2 + u * c3)),
                velocity: (c1 + u * (2.0 * c2 + u * 3.0 * c3)) / span,
                acceleration: (2.0 * c2 + u * 6.0 * c3) / (span * span),
                effort,
            },
            _ => Reference {
                position: start + u * c1,
                velocity: c1 / span,
                acceleration: 0.0,
                effort,
            },
        }
    }

    /// Least and greatest position, m, velocity, m/s, and acceleration, m/s^2; NaN where they are
    /// not finite.
    fn extremes(&self) -> [(f64, f64); 3] {
        let derivative = |of: [f64; 6]| -> [f64; 6] {
            std::array::from_fn(|k| match of.get(k + 1) {
                Some(next) => (k + 1) as f64 * next / self.span,
                None => 0.0,
            })
        };
        let velocity = derivative(self.coefficients);
        [range(self.coefficients), range(velocity), range(derivative(velocity))]
    }
}

/// Least and greatest value of a polynomial over 0..1, to a part in 1e9 of its size; NaN for one
/// that is not finite. Bernstein coefficients enclose it, and are halved until they do closely.
fn range(coefficients: [f64; 6]) -> (f64, f64) {
    const BINOMIALS: [[f64; 6]; 6] = [
        [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        [1.0, 1.0, 0.0, 0.0, 0.0, 0.0],
        [1.0, 2.0, 1.0, 0.0, 0.0, 0.0],
        [1.0, 3.0, 3.0, 1.0, 0.0, 0.0],
        [1.0, 4.0, 6.0, 4.0, 1.0, 0.0],
        [1.0, 5.0, 10.0, 10.0, 5.0, 1.0],
    ];
    let bernstein: [f64; 6] = std::array::from_fn(|i| {
        (0..=i).map(|k| BINOMIALS[i][k] / BINOMIALS[5][k] * coefficients[k]).sum()
    });
    let size = bernstein.iter().fold(0.0_f64, |most, b| most.max(b.abs()));
    if !bernstein.iter().sum::<f64>().is_finite() || !size.is_finite() {
        return (f64::NAN, f64::NAN);
    }
    let mut found = (bernstein[0].min(bernstein[5]), bernstein[0].max(bernstein[5]));
    widen(&bernstein, 1e-9 * size, 40, &mut found);
    found
}

fn widen(bernstein: &[f64; 6], tolerance: f64, depth: u32, found: &mut (f64, f64)) {
    let least = bernstein.iter().copied().fold(f64::INFINITY, f64::min);
    let most = bernstein.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if depth == 0 || least >= found.0 - tolerance && most <= found.1 + tolerance {
        return;
    }
    // De Casteljau at the middle.
    let (mut left, mut right, mut row) = ([0.0; 6], [0.0; 6], *bernstein);
    for k in 0..6 {
        (left[k], right[5 - k]) = (row[0], row[5 - k]);
        for i in 0..5 - k {
            row[i] = 0.5 * (row[i] + row[i + 1]);
        }
    }
    *found = (found.0.min(left[5]), found.1.max(left[5]));
    widen(&left, tolerance, depth - 1, found);
    widen(&right, tolerance, depth - 1, found);
}

/// Refuses an effort that no motor has, N.
fn check_effort(index: usize, value: f64) -> Result<(), TrajectoryError> {
    if value.abs() <= LARGEST_EFFORT {
        return Ok(());
    }
    let (quantity, limit) = ("effort", LARGEST_EFFORT);
    Err(TrajectoryError::TooFast { index, quantity, value, limit })
}

/// The motion from `a` to `b` at `time`, ns after the start of their trajectory.
#[inline]
fn interpolate(a: &Point, b: &Point, time: i64) -> Reference {
    let u = (time - a.time) as f64 / (b.time - a.time) as f64;
    Segment::new(a, b).at(u)
}

impl Follower {
    /// Holds position 0 from time 0 on; [`Follower::hold`] the measured position before the first
    /// reference is used.
    pub fn new(jump_limit: f64) -> Follower {
        Follower {
            held: Reference::default(),
            held_since: 0,
            active: None,
            jump_limit,
            stroke: (f64::NEG_INFINITY, f64::INFINITY),
        }
    }

    /// Refuses references below `low` or above `high`, m.
    pub fn within(mut self, low: f64, high: f64) -> Follower {
        self.stroke = (low, high);
        self
    }

    /// Refuses a motion from `origin` on that leaves the stroke or what any stage can do.
    fn check(&self, origin: &Point, points: &[Point]) -> Result<(), TrajectoryError> {
        let (low, high) = self.stroke;
        let starts = std::iter::once(origin).chain(points);
        for (index, (from, to)) in starts.zip(points).enumerate() {
            let segment = Segment::new(from, to);
            let extremes = segment.extremes();
            for ((quantity, limit), (least, most)) in LARGEST.into_iter().zip(extremes) {
                let value = if least.abs() > most.abs() { least } else { most };
                // Also where it is no number.
                if value.is_nan() || value.abs() > limit {
                    return Err(TrajectoryError::TooFast { index, quantity, value, limit });
                }
            }
            for value in [from.effort, to.effort] {
                check_effort(index, value)?;
            }
            let (least, most) = extremes[0];
            // A stage that stands beyond its stroke may be moved back into it.
            let (low, high) = (low.min(origin.position), high.max(origin.position));
            for position in [least, most] {
                if !(low..=high).contains(&position) {
                    return Err(TrajectoryError::Stroke { index, position, low, high });
                }
            }
        }
        Ok(())
    }

    /// A setpoint of now. It ends a trajectory that is being followed.
    ///
    /// Refused where it jumps: by more than the limit beyond what the velocity of both setpoints
    /// explains since the last one.
    pub fn set(&mut self, now: i64, setpoint: Reference) -> Result<(), TrajectoryError> {
        let point = Point {
            position: setpoint.position,
            velocity: Some(setpoint.velocity),
            acceleration: Some(setpoint.acceleration),
            effort: setpoint.effort,
            time: 0,
        };
        Trajectory::new(now, vec![point])?;
        let current = self.at(now);
        let elapsed = (now - self.held_since).max(0) as f64 * 1e-9;
        let speed = setpoint.velocity.abs().max(current.velocity.abs());
        let (jump, limit) =
            ((setpoint.position - current.position).abs(), self.jump_limit + speed * elapsed);
        if jump > limit {
            return Err(TrajectoryError::Jump { jump, from: current.position, limit });
        }
        let values = [setpoint.position, setpoint.velocity, setpoint.acceleration];
        for ((quantity, limit), value) in LARGEST.into_iter().zip(values) {
            if value.abs() > limit {
                return Err(TrajectoryError::TooFast { index: 0, quantity, value, limit });
            }
        }
        check_effort(0, setpoint.effort)?;
        let (low, high) = self.stroke;
        let (low, high) = (low.min(current.position), high.max(current.position));
        let position = setpoint.position;
        if !(low..=high).contains(&position) {
            return Err(TrajectoryError::Stroke { index: 0, position, low, high });
        }
        (self.held, self.held_since, self.active) = (setpoint, now, None);
        Ok(())
    }

    /// Follows a trajectory from its start on; what was followed before goes on until then only
    /// through its reference then.
    pub fn follow(&mut self, now: i64, trajectory: Trajectory) -> Result<(), TrajectoryError> {
        if trajectory.end() < now {
            return Err(TrajectoryError::Past { end: trajectory.end(), now });
        }
        let from = self.at(trajectory.start);
        let first = trajectory.points[0];
        let jump = (first.position - from.position).abs();
        if first.time == 0 && jump > self.jump_limit {
            return Err(TrajectoryError::Jump {
                jump,
                from: from.position,
                limit: self.jump_limit,
            });
        }
        // Where the first segment starts, the reference has a velocity and an acceleration of its
        // own.
        let origin = Point {
            time: 0,
            position: from.position,
            velocity: Some(from.velocity),
            acceleration: Some(from.acceleration),
            effort: from.effort,
        };
        let points = &trajectory.points[usize::from(first.time == 0)..];
        let begin = if first.time == 0 { first } else { origin };
        self.check(&begin, points)?;
        self.held = from;
        self.held_since = trajectory.start;
        self.active = Some(Active { trajectory, origin, segment: 0 });
        Ok(())
    }

    /// The reference at `time`, ns. Looks ahead and back without changing anything.
    #[inline]
    pub fn at(&self, time: i64) -> Reference {
        let Some(active) = &self.active else { return self.held };
        let points = &active.trajectory.points;
        let since = time - active.trajectory.start;
        if since < 0 {
            return self.held;
        }
        let mut next = active.segment;
        while next < points.len() && points[next].time <= since {
            next += 1;
        }
        match points.get(next) {
            Some(point) => {
                let from = if next == 0 { &active.origin } else { &points[next - 1] };
                interpolate(from, point, since)
            }
            // Past the end the last position is held, at rest.
            None => {
                Reference { position: points[points.len() - 1].position, ..Reference::default() }
            }
        }
    }

    /// Moves on to `now`: forgets segments that lie behind, so that the search in [`Follower::at`]
    /// stays short.
    #[inline]
    pub fn advance(&mut self, now: i64) {
        if let Some(active) = &mut self.active {
            let since = now - active.trajectory.start;
            let points = &active.trajectory.points;
            while active.segment < points.len() && points[active.segment].time <= since {
                active.segment += 1;
            }
        }
    }

    /// Whether a trajectory is being followed at `time`: its mean acceleration over the next sample
    /// is then known.
    pub fn is_moving(&self, time: i64) -> bool {
        self.active.as_ref().is_some_and(|active| time < active.trajectory.end())
    }

    /// Whether the velocity ahead is known at `time`, ns: a trajectory was given, so that one can
    /// look ahead.
    pub fn can_look_ahead(&self) -> bool {
        self.active.is_some()
    }

    /// Whether a trajectory has begun before `time`, ns, be it over or not.
    pub fn has_begun(&self, time: i64) -> bool {
        self.active.as_ref().is_some_and(|active| active.trajectory.start < time)
    }

    /// Gives up what is followed and holds `position`, m.
    pub fn hold(&mut self, now: i64, position: f64) {
        (self.held, self.held_since, self.active) =
            (Reference { position, ..Reference::default() }, now, None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: i64 = 1_000_000;

    #[test]
    fn rest_to_rest_move_is_the_minimum_jerk_polynomial() {
        let mut follower = Follower::new(1e-3);
        follower.follow(0, Trajectory::rest_to_rest(10 * MS, 0.05, 100 * MS)).unwrap();
        for ms in [0, 10, 20, 47, 60, 109, 110, 300] {
            let tau = ((ms as f64 - 10.0) / 100.0).clamp(0.0, 1.0);
            let expected = 0.05 * tau.powi(3) * (10.0 - 15.0 * tau + 6.0 * tau * tau);
            let velocity = 0.05 / 0.1 * 30.0 * tau * tau * (1.0 - tau) * (1.0 - tau);
            let found = follower.at(ms * MS);
            assert!(
                (found.position - expected).abs() < 1e-16
                    && (found.velocity - velocity).abs() < 1e-14,
                "{ms} ms"
            );
        }
    }

    #[test]
    fn interpolation_meets_the_points_with_the_order_that_they_give() {
        let point = |time, position, velocity, acceleration| Point {
            time,
            position,
            velocity,
            acceleration,
            effort: 0.0,
        };
        let points = vec![
            point(100 * MS, 0.01, Some(0.1), Some(0.0)),
            point(200 * MS, 0.02, Some(0.05), Some(-1.0)),
            point(300 * MS, 0.03, Some(0.0), None),
            point(400 * MS, 0.01, None, None),
        ];
        let mut follower = Follower::new(1e-3);
        follower.follow(0, Trajectory::new(0, points.clone()).unwrap()).unwrap();
        for (index, point) in points.iter().enumerate().take(3) {
            let before = follower.at(point.time - 1);
            assert!((before.position - point.position).abs() < 1e-9, "{index}: {before:?}");
            assert!(
                (before.velocity - point.velocity.unwrap()).abs() < 1e-6,
                "{index}: {before:?}"
            );
        }
        // Linear between the last two.
        let middle = follower.at(350 * MS);
        assert!((middle.position - 0.02).abs() < 1e-12 && (middle.velocity + 0.2).abs() < 1e-12);
        // Velocity is the derivative of position, acceleration that of velocity, wherever it is
        // smooth.
        for time in [33 * MS, 150 * MS, 250 * MS] {
            let (a, b, c) =
                (follower.at(time - MS / 10), follower.at(time), follower.at(time + MS / 10));
            assert!(((c.position - a.position) / 2e-4 - b.velocity).abs() < 1e-4);
            assert!(((c.velocity - a.velocity) / 2e-4 - b.acceleration).abs() < 1e-2);
        }
    }

    #[test]
    fn extremes_of_a_segment_are_those_of_a_dense_scan() {
        let mut state = 7_u64;
        let mut next = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 40) as f64 / f64::from(1 << 23) - 1.0
        };
        for _ in 0..200 {
            let mut point = |time| Point {
                time,
                position: next(),
                velocity: Some(10.0 * next()),
                acceleration: Some(100.0 * next()),
                effort: 0.0,
            };
            let segment = Segment::new(&point(0), &point(300 * MS));
            let rows: Vec<Reference> =
                (0..=20_000).map(|k| segment.at(f64::from(k) / 20_000.0)).collect();
            let of: [fn(&Reference) -> f64; 3] =
                [|r| r.position, |r| r.velocity, |r| r.acceleration];
            for (of, (least, most)) in of.into_iter().zip(segment.extremes()) {
                let values = rows.iter().map(of);
                let (low, high) = values
                    .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)));
                let tolerance = 1e-6 * (high - low);
                assert!((least - low).abs() < tolerance && (most - high).abs() < tolerance);
            }
        }
    }

    #[test]
    fn a_motion_that_swings_beyond_the_stroke_between_its_points_is_refused_whole() {
        let swing = |velocity| {
            let at = |time, position| Point {
                time,
                position,
                velocity: Some(velocity),
                ..Point::default()
            };
            Trajectory::new(0, vec![at(100 * MS, 0.05), at(300 * MS, -0.05)]).unwrap()
        };
        let mut follower = Follower::new(1e-3).within(-0.1, 0.1);
        assert_eq!(follower.follow(0, swing(0.3)), Ok(()));
        let Err(TrajectoryError::Stroke { index: 1, position, low, high }) =
            follower.follow(0, swing(5.0))
        else {
            panic!("0.05 m with 5 m/s swings out");
        };
        assert!((low, high) == (-0.1, 0.1) && !(low..=high).contains(&position));
        let far = Reference { position: 0.101, ..Reference::default() };
        let mut near = Follower::new(1.0).within(-0.1, 0.1);
        assert!(matches!(near.set(0, far), Err(TrajectoryError::Stroke { .. })));
        // Who stands outside may come back.
        near.hold(0, 0.2);
        assert_eq!(near.follow(0, Trajectory::rest_to_rest(0, 0.0, MS)), Ok(()));
    }

    #[test]
    fn finite_points_whose_polynomial_is_not_are_refused() {
        let point = |time, position| Point {
            time,
            position,
            velocity: Some(0.0),
            acceleration: Some(0.0),
            effort: 0.0,
        };
        let huge = Trajectory::new(0, vec![point(MS, 1e308), point(2 * MS, -1e308)]).unwrap();
        let mut follower = Follower::new(1e-3);
        assert!(matches!(follower.follow(0, huge), Err(TrajectoryError::TooFast { .. })));
        assert_eq!(follower.at(MS), Reference::default());
        // Half way between these efforts there is no number.
        let pushed = |time, effort| Point { effort, ..point(time, 0.0) };
        let torn = Trajectory::new(0, vec![pushed(MS, -1e308), pushed(2 * MS, 1e308)]).unwrap();
        let refused = follower.follow(0, torn).unwrap_err().to_string();
        assert!(refused.contains("effort reaches -1.000e308"), "{refused}");
        let pushed = Reference { effort: f64::MAX, ..Reference::default() };
        assert!(matches!(follower.set(0, pushed), Err(TrajectoryError::TooFast { .. })));
    }

    #[test]
    fn bad_points_are_refused_with_their_index() {
        let good = Point { time: MS, position: 0.0, ..Point::default() };
        assert_eq!(Trajectory::new(0, vec![]), Err(TrajectoryError::Empty));
        let nan = Point { position: f64::NAN, ..good };
        assert!(
            Trajectory::new(0, vec![good, nan])
                .unwrap_err()
                .to_string()
                .contains("point 1: position is NaN")
        );
        assert!(
            Trajectory::new(0, vec![good, good])
                .unwrap_err()
                .to_string()
                .contains("does not come after")
        );
    }

    #[test]
    fn a_setpoint_that_jumps_is_refused_and_a_stream_is_followed() {
        let mut follower = Follower::new(1e-3);
        let jump = Reference { position: 0.01, ..Reference::default() };
        assert!(matches!(follower.set(MS, jump), Err(TrajectoryError::Jump { .. })));
        assert_eq!(follower.at(MS).position, 0.0);
        for k in 1..100 {
            let setpoint =
                Reference { position: 0.01 * k as f64, velocity: 0.6, ..Reference::default() };
            follower.set(k * 16_666_667, setpoint).unwrap();
        }
        assert!(matches!(
            follower.follow(2_000 * MS, Trajectory::rest_to_rest(0, 0.0, MS)),
            Err(TrajectoryError::Past { .. })
        ));
    }
}
