//! Backlash: a part of the moving mass has play on the carriage.
//!
//! u part of mass M, x carriage, d = u - x: M d2u/dt2 = -F, and F along +x on the carriage, whose
//! own mass is m - M: F = max(0, k (d - w) + c d') for d > w, F = min(0, k (d + w) + c d') for d <
//! -w, else 0, with half the play w and the stiffness k = M (2 pi f)^2 and damping c = 2 D M (2 pi
//! f) of the stops: M mass (kg), f frequency of the part at a stop (Hz), D damping ratio there. The
//! total mass stays m. Starts in the middle of the play (assumed). Source: dead zone of a shaft
//! with backlash (M. Nordin, P.-O. Gutman, Automatica 38(10), 2002, two masses; a stop that does
//! not pull: C. Hunt, F. Crossley, J. Appl. Mech. 42(2), 1975). Sizes: assumed, 10 to 500 µm.
//! Stored energy: of the stops and of the part. Not modelled: friction of the part in its play, a
//! position of its own in which each record begins, a motor on the part.
//!
//! A `structural_mode` rings at any amplitude, this part is lost and found again where the
//! acceleration changes its sign: two accelerations distinguish them.

use std::f64::consts::TAU;

use super::regression::{along, largest_over_decades, least_squares, step_of};
use super::{
    Action, EffectDescriptor, EffectParameter, ForceLaw, ForceOverStep, Motion, Multiplicity,
    RecordSpecific, Residual, Role, descriptor,
};

/// Largest part, kg.
const HEAVIEST: f64 = 1000.0;
/// Smallest and largest play, m.
const PLAYS: (f64, f64) = (0.0, 0.1);
/// Lowest and highest frequency at a stop, Hz.
const FREQUENCIES: (f64, f64) = (1.0, 1000.0);
/// Least and largest damping ratio of a stop; 1 and above does not swing back.
const DAMPINGS: (f64, f64) = (0.0, 2.0);
/// Longest step at a stop, as a part of the time in which its phase turns by 1 rad: an error of its
/// square, 0.3 %.
const FINEST: f64 = 0.05;

/// Values of a typical size.
const TYPICAL: [f64; 4] = [3.0, 1e-4, 100.0, 0.2];

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "backlash",
    role: Role::CarriageForce,
    law: "mass d2u/dt2 = -F, d = u - x; F = k (d - play / 2) + c d' for d > play / 2, the same on \
          the other side, 0 between, never pulling; k = mass (2 pi frequency)^2, c = 2 damping \
          mass 2 pi frequency",
    source: "Nordin, Gutman 2002, two masses with play; stops that do not pull: Hunt, Crossley \
             1975",
    telltale: "a part of the mass is missing for a moment after every change of the sign of the \
               acceleration, then hits, not seen by the force cell",
    parameters: &[
        EffectParameter::required(
            "mass",
            "kg",
            "part of the moving mass that has play",
            (0.0, HEAVIEST),
            1.0,
        ),
        EffectParameter::required("play", "m", "way from stop to stop", PLAYS, 5e-5),
        EffectParameter::optional(
            "frequency",
            "Hz",
            "its frequency at a stop",
            FREQUENCIES,
            20.0,
            100.0,
        ),
        EffectParameter::optional("damping", "1", "damping ratio at a stop", DAMPINGS, 0.05, 0.2),
    ],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &TYPICAL,
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::CarriageForce(Box::new(Backlash::new(values))),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

#[derive(Debug)]
struct Backlash {
    mass: f64,
    half_play: f64,
    /// 2 pi f, rad/s.
    rate: f64,
    damping: f64,
    /// u - x, m.
    apart: f64,
    /// du/dt, m/s; `None` before the first step, which it begins with the carriage.
    velocity: Option<f64>,
}

impl Backlash {
    fn new(values: &[f64]) -> Backlash {
        Backlash {
            mass: values[0],
            half_play: 0.5 * values[1],
            rate: TAU * values[2],
            damping: values[3],
            apart: 0.0,
            velocity: None,
        }
    }

    /// Force on the carriage per mass of the part, m/s^2, this far apart, m, as that grows by so
    /// much, m/s.
    fn push(&self, apart: f64, rate: f64) -> f64 {
        let pressed = apart - apart.clamp(-self.half_play, self.half_play);
        let push = self.rate * (self.rate * pressed + 2.0 * self.damping * rate);
        if pressed > 0.0 {
            push.max(0.0)
        } else if pressed < 0.0 {
            push.min(0.0)
        } else {
            0.0
        }
    }

    /// Moves the part over a step in pieces; `acceleration` of the carriage, m/s^2. Where it comes
    /// to a stop a piece ends, so that the force changes with the values as smoothly as it can.
    fn advance(&mut self, motion: &Motion, acceleration: f64, step: f64) -> ForceOverStep {
        let longest = step / (step * self.rate / FINEST).ceil().max(1.0);
        let mut velocity =
            self.velocity.unwrap_or(motion.velocity - 0.5 * step * motion.acceleration);
        let mut sum = ForceOverStep::default();
        // Since the middle of the step.
        let mut at = -0.5 * step;
        while at < 0.5 * step * (1.0 - 1e-12) {
            let piece = longest.min(0.5 * step - at);
            let rate = velocity - (motion.velocity + at * acceleration);
            if self.apart.abs() < self.half_play {
                at += self.coast(rate, acceleration, piece);
                continue;
            }
            let middle = self.apart + 0.5 * piece * (rate - 0.25 * piece * acceleration);
            let rate = rate - 0.5 * piece * acceleration;
            let push = self.push(middle, rate);
            let push = self.push(middle, rate - 0.5 * piece * push);
            self.apart += piece * (rate - 0.5 * piece * push);
            velocity -= piece * push;
            let share = self.mass * push * piece / step;
            sum.add(ForceOverStep { mean: share, moment: share * (at + 0.5 * piece) / step });
            at += piece;
        }
        self.velocity = Some(velocity);
        sum
    }

    /// Moves the part through its play for a time, s, or up to a stop; how long that takes, s.
    fn coast(&mut self, rate: f64, acceleration: f64, time: f64) -> f64 {
        let stops = [self.half_play, -self.half_play];
        let hits = stops.map(|stop| {
            let instant = time_for(stop - self.apart, rate, -acceleration);
            (instant.filter(|instant| *instant <= time), stop)
        });
        let first = hits.into_iter().filter_map(|(instant, stop)| Some((instant?, stop)));
        match first.min_by(|one, other| one.0.total_cmp(&other.0)) {
            Some((instant, stop)) => {
                self.apart = stop;
                instant
            }
            None => {
                self.apart += time * (rate - 0.5 * time * acceleration);
                time
            }
        }
    }
}

/// The first time, s, after which something has gone a way, m, that moves at a rate, m/s, which
/// grows by `acceleration`, m/s^2.
fn time_for(way: f64, rate: f64, acceleration: f64) -> Option<f64> {
    let root = (rate * rate + 2.0 * acceleration * way).sqrt();
    // Both roots of a t^2 / 2 + r t - w without a difference of like numbers.
    let sum = -(rate + root.copysign(rate));
    let times = [sum / acceleration, -2.0 * way / sum];
    times.into_iter().filter(|time| time.is_finite() && *time > 0.0).min_by(f64::total_cmp)
}

impl ForceLaw for Backlash {
    fn force(&mut self, motion: &Motion, step: f64) -> f64 {
        if step <= 0.0 {
            let rate = self.velocity.map_or(0.0, |velocity| velocity - motion.velocity);
            return self.mass * self.push(self.apart, rate);
        }
        self.advance(motion, 0.0, step).mean
    }

    fn force_over(&mut self, motion: &Motion, step: f64) -> ForceOverStep {
        self.advance(motion, motion.acceleration, step)
    }

    fn carried_mass(&self) -> f64 {
        self.mass
    }

    fn stiffness(&self) -> f64 {
        self.mass * self.rate * self.rate
    }

    fn stored_energy(&self, _position: f64) -> f64 {
        let pressed = self.apart - self.apart.clamp(-self.half_play, self.half_play);
        let velocity = self.velocity.unwrap_or(0.0);
        0.5 * self.mass * (velocity * velocity + (self.rate * pressed).powi(2))
    }

    fn reset(&mut self) {
        (self.apart, self.velocity) = (0.0, None);
    }
}

/// Narrowest and widest play of a proposal, m, and slowest and fastest stop, Hz.
const TRIED_PLAYS: (f64, f64) = (1e-6, 1e-2);
const TRIED_FREQUENCIES: (f64, f64) = (10.0, 500.0);
/// Least and largest damping ratio of a stop that a proposal tries.
const TRIED_DAMPINGS: (f64, f64) = (0.03, 1.0);
/// Turns over play and stops.
const TURNS: usize = 2;

/// Play and stops at which a part takes most out of the residual, with errors of friction and mass:
/// one after the other, twice.
///
/// Per mass of the part its force along a motion depends on play and stops alone; what the carriage
/// lacks without it is its own acceleration.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let base = least_squares(residual.force, |k| {
        [1.0, residual.friction[k], residual.velocity[k], residual.acceleration[k]]
    })?;
    if step_of(residual) <= 0.0 {
        return None;
    }
    let fit = |values: [f64; 3]| {
        let [play, frequency, damping] = values;
        let mut part = Backlash::new(&[1.0, play, frequency, damping]);
        let push = along(residual, |motion, step| part.force_over(motion, step).mean);
        least_squares(residual.force, |k| {
            let acceleration = residual.acceleration[k];
            [1.0, residual.friction[k], residual.velocity[k], acceleration, acceleration + push[k]]
        })
    };
    let mut values = [0.0, TYPICAL[2], TYPICAL[3]];
    for turn in 0..TURNS {
        for (index, (least, largest)) in
            [TRIED_PLAYS, TRIED_FREQUENCIES, TRIED_DAMPINGS].into_iter().enumerate()
        {
            let explained = |value: f64| {
                let mut tried = values;
                tried[index] = value;
                fit(tried).map_or(f64::NEG_INFINITY, |fit| fit.explained)
            };
            // Around what the first turn has found.
            let (from, to) = match turn {
                0 => (least, largest),
                _ => ((0.6 * values[index]).max(least), (1.6 * values[index]).min(largest)),
            };
            values[index] = largest_over_decades(from, to, explained);
            if turn == 0 && index == 0 && !fit(values)?.improves_on(&base) {
                return None;
            }
        }
    }
    let mass = fit(values)?.coefficients[4];
    let [play, frequency, damping] = values;
    (mass > 0.0).then(|| vec![mass.min(HEAVIEST), play, frequency, damping])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, on_a_slippery_guide, proposal};
    use super::*;
    use crate::model::EffectParameters;
    use crate::plant::Body;

    /// 40 kg of which 8 kg have 0.2 mm of play, on a guide that hardly rubs.
    fn body(damping: f64) -> Body {
        on_a_slippery_guide(EffectParameters::new(
            "backlash",
            [("mass", 8.0), ("play", 2e-4), ("frequency", 100.0), ("damping", damping)],
        ))
    }

    #[test]
    fn the_carriage_alone_accelerates_until_the_part_has_come_through_its_play() {
        let mut body = body(0.3);
        // 320 N on 32 kg go through half of 0.2 mm in sqrt(2e-4 / 10) = 4.47 ms.
        body.advance(320.0, 178);
        let alone = 10.0 * body.time();
        assert!((body.velocity() / alone - 1.0).abs() < 1e-6, "{} m/s", body.velocity());
        // Then 40 kg as one.
        body.advance(320.0, 40_000);
        let together = 8.0 * body.time();
        assert!((body.velocity() / together - 1.0).abs() < 1e-3, "{} m/s", body.velocity());
        // Braking: the carriage alone again, by the whole play.
        let before = body.velocity();
        body.advance(-320.0, 160);
        let lost = before - body.velocity();
        let alone = 10.0 * 160.0 * 25e-6;
        assert!((lost / alone - 1.0).abs() < 0.05, "{lost} m/s, alone {alone} m/s");
    }

    #[test]
    fn momentum_stays_and_without_damping_so_does_energy() {
        for damping in [0.0, 0.3] {
            let mut body = body(damping);
            body.advance(4000.0, 40);
            let energy = body.energy();
            body.advance(0.0, 40_000);
            let now = body.energy();
            if damping == 0.0 {
                assert!((now / energy - 1.0).abs() < 5e-3, "{now} J of {energy} J");
            } else {
                // 4 N s on 40 kg that end as one, but for the last slow way through the play.
                assert!((body.velocity() / 0.1 - 1.0).abs() < 0.05, "{} m/s", body.velocity());
                assert!(now < energy && now > 0.199, "{now} J of {energy} J");
            }
        }
    }

    /// Without play it is the part on a spring of another effect, as long as that is pressed.
    #[test]
    fn a_pressed_part_swings_about_where_it_hangs() {
        let mut part = Backlash::new(&[8.0, 0.0, 50.0, 0.05]);
        let motion = Motion { acceleration: 3.0, ..Motion::default() };
        let mut last = ForceOverStep::default();
        for k in 0..4000 {
            let velocity = 3.0 * 5e-4 * (f64::from(k) + 0.5);
            last = part.force_over(&Motion { velocity, ..motion }, 5e-4);
        }
        assert!((last.mean + 8.0 * 3.0).abs() < 0.01, "{last:?}");
        let hangs = -3.0 / (TAU * 50.0f64).powi(2);
        assert!((part.apart / hangs - 1.0).abs() < 1e-3, "{} m, {hangs} m", part.apart);
    }

    /// A long step against many short ones along the same motion.
    #[test]
    fn over_a_long_step_it_is_the_force_of_its_pieces() {
        let built = || Backlash::new(&[4.0, 1e-4, 100.0, 0.2]);
        let (mut whole, mut in_pieces) = (built(), built());
        let (step, pieces) = (5e-4, 200);
        let (mut squares, mut all) = (0.0, 0.0);
        let mut velocity = 0.0;
        for k in 0..2000 {
            let acceleration = 3.0 * (0.02 * f64::from(k)).sin();
            let motion = Motion { velocity, acceleration, ..Motion::default() };
            let found = whole.force_over(&motion, step);
            let mut expected = 0.0;
            for piece in 0..pieces {
                let aside = (f64::from(piece) + 0.5) / f64::from(pieces) - 0.5;
                let there = Motion { velocity: velocity + aside * step * acceleration, ..motion };
                expected += in_pieces.force(&there, step / f64::from(pieces)) / f64::from(pieces);
            }
            squares += (found.mean - expected).powi(2);
            all += expected * expected;
            velocity += acceleration * step;
        }
        let off = (squares / all).sqrt();
        assert!(off < 0.02, "{off}");
    }

    #[test]
    fn proposal_finds_mass_and_play_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[4.0, 1e-4, 100.0, 0.2]);
        assert!(
            (found[0] / 4.0 - 1.0).abs() < 0.2 && (found[1] / 1e-4 - 1.0).abs() < 0.2,
            "{found:?}"
        );
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
