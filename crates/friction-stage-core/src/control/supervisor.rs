//! Watches a position loop: whether it does its work, and when it must be stopped.
//!
//! In: the terms of each sample. Out: fine, a warning, or the cause for which the loop has to stop.
//! What is watched are shares of time, because a loop that swings passes through zero, too: each
//! condition has a share of the last samples (a first-order lag) and stops the loop where more than
//! half of them meet it for as long as the settings say. An error counts for a moment after it, so
//! that a swing whose peaks alone are beyond the limit stops the loop as well.

use super::controller::Terms;

/// What a supervisor allows. Times in s. The values are assumed; those of the
/// controller node are parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SupervisorSettings {
    /// Samples per second, Hz.
    pub rate: f64,
    /// Largest error while the reference rests, m; while it moves, [`MOVING`] times as much.
    pub error: f64,
    /// How long output or error may be beyond their limits, s.
    pub patience: f64,
    /// Size of the output, rms about its mean at rest, from which a loop swings, N.
    pub swing: f64,
}

impl SupervisorSettings {
    /// Largest error at rest where a user says nothing, m.
    pub const ERROR: f64 = 1e-3;
    /// Patience where a user says nothing, s.
    pub const PATIENCE: f64 = 0.5;
    /// Swing of the force at rest, rms, in largest forces, from which a loop is taken for unstable:
    /// what holds a stage at rest is less than its static friction, and does not swing.
    const SWING: f64 = 0.1;

    /// For a loop of `rate` samples per second whose force is at most `force_limit`, N.
    pub fn new(rate: f64, force_limit: f64) -> SupervisorSettings {
        SupervisorSettings {
            rate,
            error: SupervisorSettings::ERROR,
            patience: SupervisorSettings::PATIENCE,
            swing: SupervisorSettings::SWING * force_limit,
        }
    }
}

/// The error that is allowed while the reference moves, in errors that are allowed at rest.
pub const MOVING: f64 = 10.0;
/// Lag of the shares, s.
const LAG: f64 = 0.2;
/// After a motion the error has this long to settle, s.
const SETTLE: f64 = 0.5;

/// Why a loop is warned about or stopped.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cause {
    /// The output is no number.
    NotFinite,
    /// The output is at its limit.
    Saturated {
        /// For how long, s.
        seconds: f64,
    },
    /// The error is beyond its limit.
    Error {
        /// m
        error: f64,
        /// m
        limit: f64,
    },
    /// The output swings while the reference rests.
    Swings {
        /// Of the output about its mean, N.
        rms: f64,
    },
}

impl std::fmt::Display for Cause {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Cause::NotFinite => write!(f, "the force is no number"),
            Cause::Saturated { seconds } => {
                write!(f, "the force has been at its limit for {seconds:.1} s")
            }
            Cause::Error { error, limit } => write!(
                f,
                "the position error is {:.3} mm, the limit {:.3} mm",
                1e3 * error,
                1e3 * limit
            ),
            Cause::Swings { rms } => {
                write!(f, "the force swings at rest, {rms:.0} N rms: the loop is not stable")
            }
        }
    }
}

/// How a loop does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Health {
    /// As it should.
    Fine,
    /// Something is beyond its limit.
    Warning(Cause),
    /// It has been for too long: stop.
    Stop(Cause),
}

/// Share of the last samples that meet a condition, and for how long it has been above a half.
#[derive(Clone, Copy, Debug, Default)]
struct Share {
    share: f64,
    seconds: f64,
}

impl Share {
    fn update(&mut self, met: bool, period: f64) {
        let weight = (period / LAG).min(1.0);
        self.share += weight * (f64::from(u8::from(met)) - self.share);
        self.seconds = if self.share > 0.5 { self.seconds + period } else { 0.0 };
    }
}

/// Watches one loop.
#[derive(Clone, Debug)]
pub struct Supervisor {
    settings: SupervisorSettings,
    saturated: Share,
    astray: Share,
    swinging: Share,
    /// Mean and mean square of the output, N and N^2.
    mean: f64,
    square: f64,
    /// Time since the reference came to rest, s.
    rested: f64,
    /// The last error beyond its limit, m, and the time since, s.
    beyond: (f64, f64),
}

impl Supervisor {
    /// A supervisor that has seen nothing.
    pub fn new(settings: SupervisorSettings) -> Supervisor {
        Supervisor {
            settings,
            saturated: Share::default(),
            astray: Share::default(),
            swinging: Share::default(),
            mean: 0.0,
            square: 0.0,
            rested: 0.0,
            beyond: (0.0, f64::INFINITY),
        }
    }

    /// Forgets what it has seen.
    pub fn reset(&mut self) {
        *self = Supervisor::new(self.settings);
    }

    /// Takes the terms of the next sample.
    pub fn observe(&mut self, terms: &Terms) -> Health {
        if !terms.output.is_finite() || !terms.error.is_finite() {
            return Health::Stop(Cause::NotFinite);
        }
        let period = self.settings.rate.recip();
        let rests = terms.reference.velocity == 0.0 && terms.reference.acceleration == 0.0;
        self.rested = if rests { self.rested + period } else { 0.0 };
        let settled = self.rested > SETTLE;
        let limit = self.settings.error * if settled { 1.0 } else { MOVING };
        self.beyond = if terms.error.abs() > limit {
            (terms.error.abs(), 0.0)
        } else {
            (self.beyond.0, self.beyond.1 + period)
        };
        self.astray.update(self.beyond.1 < LAG, period);
        self.saturated.update(terms.saturated, period);
        let weight = (period / LAG).min(1.0);
        self.mean += weight * (terms.output - self.mean);
        self.square += weight * ((terms.output - self.mean).powi(2) - self.square);
        self.swinging.update(settled && self.square.sqrt() > self.settings.swing, period);

        let error = Cause::Error { error: self.beyond.0, limit };
        let saturated = Cause::Saturated { seconds: self.saturated.seconds };
        let swings = Cause::Swings { rms: self.square.sqrt() };
        let found = [(&self.astray, error), (&self.saturated, saturated), (&self.swinging, swings)];
        let patience = self.settings.patience;
        let worst = found.iter().find(|(share, _)| share.seconds > patience);
        if let Some((_, cause)) = worst {
            return Health::Stop(*cause);
        }
        match found.iter().find(|(share, _)| share.share > 0.5) {
            Some((_, cause)) => Health::Warning(*cause),
            None => Health::Fine,
        }
    }
}

/// Brings a stage to rest without a position loop: a force against the velocity that the stage
/// loses in [`DampedStop::TIME`], which is slow enough for a loop that comes late.
#[derive(Clone, Copy, Debug)]
pub struct DampedStop {
    damping: f64,
    limits: (f64, f64),
    /// s
    elapsed: f64,
    slow: f64,
    period: f64,
}

impl DampedStop {
    /// Time in which the velocity falls to a third, s. Assumed.
    pub const TIME: f64 = 0.08;
    /// Velocity that counts as rest, m/s.
    const REST: f64 = 2e-3;
    /// At rest for this long, or after this long at the latest, the force ends, s.
    const RESTED: f64 = 0.1;
    const LONGEST: f64 = 2.0;

    /// For a moving `mass`, kg; `limits` of the force, N; `period` between two samples, s.
    pub fn new(mass: f64, limits: (f64, f64), period: f64) -> DampedStop {
        DampedStop { damping: mass / DampedStop::TIME, limits, elapsed: 0.0, slow: 0.0, period }
    }

    /// Force for a stage that moves with `velocity`, m/s, in N; `None` when it is over.
    pub fn force(&mut self, velocity: f64) -> Option<f64> {
        self.elapsed += self.period;
        self.slow = if velocity.abs() < DampedStop::REST { self.slow + self.period } else { 0.0 };
        let over = self.slow > DampedStop::RESTED || self.elapsed > DampedStop::LONGEST;
        let force = (-self.damping * velocity).clamp(self.limits.0, self.limits.1);
        (!over && force.is_finite()).then_some(force)
    }
}

#[cfg(test)]
mod tests {
    use super::super::trajectory::Reference;
    use super::*;

    const SETTINGS: SupervisorSettings =
        SupervisorSettings { rate: 1000.0, error: 1e-3, patience: 0.5, swing: 200.0 };

    /// The first sample with something other than [`Health::Fine`], and the one that stops, s.
    fn observed(terms: impl Fn(f64) -> Terms) -> (Option<f64>, Option<(f64, Cause)>) {
        let mut supervisor = Supervisor::new(SETTINGS);
        let mut warned = None;
        for k in 0..5000 {
            let time = f64::from(k) * 1e-3;
            match supervisor.observe(&terms(time)) {
                Health::Fine => {}
                Health::Warning(_) => _ = warned.get_or_insert(time),
                Health::Stop(cause) => return (warned, Some((time, cause))),
            }
        }
        (warned, None)
    }

    #[test]
    fn a_loop_that_follows_is_let_alone_also_where_a_move_saturates_for_a_moment() {
        let terms = |time: f64| Terms {
            error: 5e-4 * (40.0 * time).sin(),
            output: 50.0 * (7.0 * time).sin(),
            saturated: time > 1.0 && time < 1.1,
            reference: Reference { velocity: 0.1, ..Reference::default() },
            ..Terms::default()
        };
        assert_eq!(observed(terms), (None, None));
    }

    #[test]
    fn a_loop_that_swings_is_warned_about_and_then_stopped() {
        let terms = |time: f64| {
            let swing = (2.0 * std::f64::consts::PI * 3.0 * time).sin();
            Terms {
                error: 0.9 * swing,
                output: 2000.0 * swing.signum(),
                saturated: true,
                ..Terms::default()
            }
        };
        let (warned, stopped) = observed(terms);
        let (at, cause) = stopped.unwrap();
        assert!(warned.unwrap() < 0.3 && at < 1.0, "{warned:?} {at}");
        assert!(matches!(cause, Cause::Error { .. } | Cause::Saturated { .. }));
    }

    #[test]
    fn a_swing_whose_peaks_alone_are_beyond_the_limit_stops_the_loop() {
        let peak = |peak: f64| {
            move |time: f64| Terms {
                error: peak * (2.0 * std::f64::consts::PI * 4.0 * time).sin(),
                ..Terms::default()
            }
        };
        assert_eq!(observed(peak(0.99e-3)), (None, None));
        let stopped = observed(peak(1.05e-3)).1;
        assert!(matches!(stopped, Some((_, Cause::Error { error, .. })) if error > 1e-3));
    }

    #[test]
    fn a_push_that_ends_is_a_warning() {
        let terms = |time: f64| Terms {
            error: if (time - 2.0).abs() < 0.02 { 2e-3 } else { 0.0 },
            ..Terms::default()
        };
        let (warned, stopped) = observed(terms);
        assert!(warned.is_some() && stopped.is_none(), "{warned:?} {stopped:?}");
    }

    #[test]
    fn a_small_swing_at_rest_is_found_by_its_force() {
        let terms = |time: f64| Terms {
            error: 1e-5,
            output: 400.0 * (2.0 * std::f64::consts::PI * 80.0 * time).sin(),
            ..Terms::default()
        };
        assert!(matches!(observed(terms).1, Some((_, Cause::Swings { .. }))));
    }

    #[test]
    fn a_force_that_is_no_number_stops_at_once() {
        let terms = |_| Terms { output: f64::NAN, ..Terms::default() };
        assert_eq!(observed(terms).1, Some((0.0, Cause::NotFinite)));
    }

    #[test]
    fn a_damped_stop_brings_a_mass_to_rest_even_with_a_delay_of_30_ms() {
        let (mass, mut velocity) = (40.0, 2.0);
        let mut stop = DampedStop::new(mass, (-2000.0, 2000.0), 1e-3);
        let mut seen = std::collections::VecDeque::from(vec![velocity; 30]);
        let mut steps = 0;
        while let Some(force) = stop.force(seen.pop_front().unwrap()) {
            velocity += force / mass * 1e-3;
            seen.push_back(velocity);
            steps += 1;
        }
        assert!(velocity.abs() < 5e-3 && steps < 1500, "{velocity} after {steps} ms");
    }
}
