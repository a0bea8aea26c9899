//! Ball passage: as balls enter and leave the loaded zone, they push the carriage to and fro.
//!
//! F = A / 4 sum over the guides g of sin(2 pi x / p_g + phi + W_g(x) + S_g(s)) along +x on the
//! carriage: A amplitude (N) with all four in phase, p_g = p (1 + r (g - 1.5) / 3) with g = 0 to 3,
//! p period (m), r spread, phi phase at x = 0 (rad). W_g is a random walk of the phase over
//! position, of standard deviation q sqrt(|x|), q wander (rad/sqrt(m)), zero at x = 0, one fixed
//! walk per guide, linear between points a quarter of a period apart, constant beyond 1000 periods.
//! S_g is the phase of balls that slip: anything at first, then a random walk of standard deviation
//! z sqrt(s) over the distance travelled s (m), z slip (rad/sqrt(m)), linear between points a
//! quarter of a period apart; 0 without slip. Source: assumed form. A carriage moves twice as far
//! as its balls, so the period is about twice the ball pitch, 8 to 10 mm at size 25. Sizes:
//! assumed, 0.1 to 1 N. Without slip it is a function of position and has a potential. Of balls
//! that slip a real stage shows other phases in each record: those here are one example, the same
//! in each run.

use std::f64::consts::{PI, TAU};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::regression::strongest_wave;
use super::{
    Action, EffectDescriptor, EffectParameter, ForceLaw, Motion, Multiplicity, ParameterKind,
    RecordSpecific, Residual, Role, SlippingRipple, descriptor,
};

/// Shortest and longest period, m.
const PERIODS: (f64, f64) = (1e-3, 0.1);
/// Sinusoids, one per guide of a full stage.
const GUIDES: usize = 4;
/// Points of the walk per period, and periods on each side of position 0.
const POINTS_PER_PERIOD: usize = 4;
const REACH: usize = 1000;
/// Walk of the phase, rad, that the pieces may show over which a record has its own.
const WALK_OF_A_PIECE: f64 = 0.5;
/// Deviations that a random number is taken to stay below.
const FARTHEST: f64 = 5.0;

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "ball_passage",
    role: Role::CarriageForce,
    law: "F = amplitude / 4 sum sin(2 pi x / period_g + phase + W_g(x) + S_g(distance)), periods \
          within spread, W_g and S_g random walks of wander and slip",
    source: "assumed; period of twice the ball pitch",
    telltale: "narrow band over position at twice the ball pitch, phase wanders, not seen by the \
               force cell",
    parameters: &[
        EffectParameter::required(
            "amplitude",
            "N",
            "peak force with all guides in phase",
            (0.0, 100.0),
            0.5,
        )
        .of_kind(ParameterKind::Amplitude),
        EffectParameter::required(
            "period",
            "m",
            "mean distance after which the force repeats",
            PERIODS,
            1e-3,
        )
        .of_kind(ParameterKind::Period),
        EffectParameter::optional("phase", "rad", "phase at position 0", (-TAU, TAU), 1.0, 0.0)
            .of_kind(ParameterKind::Phase),
        EffectParameter::optional(
            "wander",
            "rad/sqrt(m)",
            "random walk of the phase over position",
            (0.0, 100.0),
            1.0,
            0.0,
        ),
        EffectParameter::optional(
            "spread",
            "1",
            "part by which the guides' periods differ at most",
            (0.0, 0.5),
            0.01,
            0.0,
        ),
        EffectParameter::optional(
            "slip",
            "rad/sqrt(m)",
            "random walk of the phase over the distance",
            (0.0, 10.0),
            0.1,
            0.0,
        )
        .of_kind(ParameterKind::PhaseWalk),
    ],
    multiplicity: Multiplicity::OnePerGuide,
    record_specific: RecordSpecific::Ripple(slipping_ripple),
    typical: &[0.5, 9e-3, 0.0, 0.0, 0.0, 0.0],
    check: descriptor::any,
    // The walk of a real stage is another one: its size cannot be fitted by a fixed walk. Of balls
    // that slip each record has its own force.
    free: |values, index| match values[5] > 0.0 {
        true => index == 1,
        false => index < 3 || (index == 4 && values[4] > 0.0),
    },
    build: |values| Action::CarriageForce(Box::new(BallPassage::new(values))),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

/// The ripple of balls that slip, whose phase is each recording's own.
fn slipping_ripple(values: &[f64]) -> Option<SlippingRipple> {
    let (period, slip) = (values[1], values[5]);
    (slip > 0.0).then(|| SlippingRipple { period, piece: (WALK_OF_A_PIECE / slip).powi(2) })
}

#[derive(Debug)]
struct BallPassage {
    /// A / 4, N.
    amplitude: f64,
    /// Points of the walks per metre.
    density: f64,
    guides: [GuidePassage; GUIDES],
    /// Sinusoids that differ: one stands for all where periods and walks are the same.
    distinct: usize,
    slip: Option<Slip>,
}

/// The phases of balls that slip.
#[derive(Debug)]
struct Slip {
    /// m
    period: f64,
    /// rad/sqrt(m)
    size: f64,
    random: ChaCha8Rng,
    /// S_g at the last point and at the next one, rad.
    phases: [(f64, f64); GUIDES],
    /// Way from the last point, in distances between points.
    way: f64,
    /// Where the carriage was, m.
    position: f64,
}

impl Slip {
    fn new(size: f64, period: f64) -> Slip {
        let mut random = ChaCha8Rng::seed_from_u64(0);
        let phases =
            std::array::from_fn(|_| random.random_range(-PI..PI)).map(|phase| (phase, phase));
        let mut slip = Slip { period, size, random, phases, way: 0.0, position: 0.0 };
        slip.pass_point();
        slip
    }

    fn between_points(&self) -> f64 {
        self.period / POINTS_PER_PERIOD as f64
    }

    fn pass_point(&mut self) {
        let deviation = self.size * self.between_points().sqrt();
        for (last, next) in &mut self.phases {
            let step: f64 = StandardNormal.sample(&mut self.random);
            (*last, *next) = (*next, *next + deviation * step.clamp(-FARTHEST, FARTHEST));
        }
    }

    fn move_to(&mut self, position: f64) {
        self.way += (position - self.position).abs() / self.between_points();
        self.position = position;
        // Where the stage was set elsewhere, no balls have rolled: nothing is lost by forgetting
        // it.
        self.way = self.way.min(REACH as f64);
        while self.way >= 1.0 {
            self.way -= 1.0;
            self.pass_point();
        }
    }

    fn phase(&self, guide: usize) -> f64 {
        let (last, next) = self.phases[guide];
        last + self.way * (next - last)
    }

    /// Largest slope of a phase over the distance, rad/m.
    fn steepest(&self) -> f64 {
        FARTHEST * self.size / self.between_points().sqrt()
    }
}

#[derive(Debug)]
struct GuidePassage {
    wave_number: f64,
    phase: f64,
    /// W at points 1 / density apart, position 0 in the middle; empty without a walk.
    walk: Vec<f64>,
}

impl BallPassage {
    fn new(values: &[f64]) -> BallPassage {
        let [amplitude, period, phase, wander, spread, slip] =
            std::array::from_fn(|index| values[index]);
        let density = POINTS_PER_PERIOD as f64 / period;
        let distinct = if wander == 0.0 && spread == 0.0 && slip == 0.0 { 1 } else { GUIDES };
        let slip = (slip > 0.0).then(|| Slip::new(slip, period));
        let guides = std::array::from_fn(|guide| GuidePassage {
            wave_number: TAU / (period * (1.0 + spread * (guide as f64 - 1.5) / 3.0)),
            phase,
            walk: if wander > 0.0 {
                walk(guide as u64, wander * density.recip().sqrt())
            } else {
                Vec::new()
            },
        });
        BallPassage { amplitude: amplitude / distinct as f64, density, guides, distinct, slip }
    }

    /// Phases of the guides at a position, rad, and their slopes, rad/m.
    fn phases(&self, position: f64) -> impl Iterator<Item = (f64, f64)> {
        self.guides[..self.distinct].iter().enumerate().map(move |(index, guide)| {
            let (phase, slope) = self.phase(guide, position);
            (phase + self.slip.as_ref().map_or(0.0, |slip| slip.phase(index)), slope)
        })
    }

    /// Phase of a guide without slip at a position, rad, and its slope, rad/m.
    fn phase(&self, guide: &GuidePassage, position: f64) -> (f64, f64) {
        let steady = guide.wave_number * position + guide.phase;
        if guide.walk.is_empty() {
            return (steady, guide.wave_number);
        }
        let last = guide.walk.len() - 1;
        let place = position * self.density + 0.5 * last as f64;
        if !(0.0..last as f64).contains(&place) {
            return (steady + guide.walk[if place < 0.0 { 0 } else { last }], guide.wave_number);
        }
        let point = place as usize;
        let change = guide.walk[point + 1] - guide.walk[point];
        let walked = guide.walk[point] + (place - point as f64) * change;
        (steady + walked, guide.wave_number + change * self.density)
    }
}

/// A random walk on both sides of its middle, where it is 0.
fn walk(seed: u64, deviation: f64) -> Vec<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let half = POINTS_PER_PERIOD * REACH;
    let mut walk = vec![0.0; 2 * half + 1];
    for k in 0..half {
        let [up, down]: [f64; 2] = std::array::from_fn(|_| StandardNormal.sample(&mut random));
        walk[half + k + 1] = walk[half + k] + deviation * up;
        walk[half - k - 1] = walk[half - k] + deviation * down;
    }
    walk
}

impl ForceLaw for BallPassage {
    fn force(&mut self, motion: &Motion, _step: f64) -> f64 {
        if let Some(slip) = &mut self.slip {
            slip.move_to(motion.position);
        }
        self.amplitude * self.phases(motion.position).map(|(phase, _)| phase.sin()).sum::<f64>()
    }

    fn stiffness(&self) -> f64 {
        let slope = |guide: &GuidePassage| {
            let steepest =
                guide.walk.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max);
            guide.wave_number + steepest * self.density
        };
        let slip = self.slip.as_ref().map_or(0.0, Slip::steepest);
        self.amplitude
            * self.guides[..self.distinct].iter().map(|guide| slope(guide) + slip).sum::<f64>()
    }

    /// Exact without a walk; with one, exact between its points, with jumps at them. Balls that
    /// slip have no potential: that of their present phases.
    fn stored_energy(&self, position: f64) -> f64 {
        self.amplitude
            * self.phases(position).map(|(phase, slope)| phase.cos() / slope).sum::<f64>()
    }

    fn reset(&mut self) {
        if let Some(slip) = &mut self.slip {
            *slip = Slip::new(slip.size, slip.period);
        }
    }
}

/// The sinusoid over position that takes most out of the residual, as four guides in phase.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let wave = strongest_wave(residual.position, |_| 1.0, residual.force, PERIODS.0..=PERIODS.1)?;
    Some(vec![wave.amplitude().min(100.0), wave.period, wave.phase(), 0.0, 0.0, 0.0])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, proposal};
    use super::*;

    fn at(effect: &mut BallPassage, position: f64) -> f64 {
        effect.force(&Motion { position, ..Motion::default() }, 1e-4)
    }

    #[test]
    fn four_guides_in_phase_are_one_sinusoid_of_the_amplitude() {
        let mut passage = BallPassage::new(&[0.8, 8e-3, 0.0, 0.0, 0.0, 0.0]);
        for (position, force) in [(0.0, 0.0), (2e-3, 0.8), (6e-3, -0.8), (18e-3, 0.8)] {
            assert!((at(&mut passage, position) - force).abs() < 1e-12, "{position} m");
        }
    }

    #[test]
    fn guides_of_different_periods_beat() {
        let mut passage = BallPassage::new(&[0.8, 8e-3, 0.0, 0.0, 0.06, 0.0]);
        let peak = |passage: &mut BallPassage, from: f64| {
            (0..400)
                .map(|k| at(passage, from + 8e-3 * f64::from(k) / 400.0).abs())
                .fold(0.0, f64::max)
        };
        let (near, far) = (peak(&mut passage, 0.0), peak(&mut passage, 0.1));
        // Neighbours differ by 2 %: after 12.5 periods four guides are a quarter turn apart each
        // and cancel.
        assert!(near > 0.75 && far < 0.15, "{near} {far}");
    }

    #[test]
    fn force_is_the_slope_of_the_stored_energy() {
        for wander in [0.0, 2.0] {
            let mut passage = BallPassage::new(&[0.8, 8e-3, 0.4, wander, 0.02, 0.0]);
            // Away from the points of the walk, 2 mm apart.
            for position in [-0.0311, 0.0007, 0.0213] {
                let h = 1e-7;
                let slope = (passage.stored_energy(position + h)
                    - passage.stored_energy(position - h))
                    / (2.0 * h);
                let force = at(&mut passage, position);
                assert!((force + slope).abs() < 1e-5, "{position} m: {force} {slope}");
            }
        }
    }

    #[test]
    fn phase_wanders_with_the_root_of_the_distance_and_the_same_way_every_time() {
        let passage = BallPassage::new(&[0.8, 1e-2, 0.0, 3.0, 0.0, 0.0]);
        let squares = (0..GUIDES).flat_map(|guide| {
            let walk = &passage.guides[guide].walk;
            // Pieces of 0.1 m: 40 points.
            walk.chunks(40)
                .filter(|piece| piece.len() == 40)
                .map(|piece| (piece[39] - piece[0]).powi(2))
                .collect::<Vec<_>>()
        });
        let squares: Vec<f64> = squares.collect();
        let deviation = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        let expected = 3.0 * (39.0 * 2.5e-3f64).sqrt();
        // 800 pieces: standard error 2.5 %.
        assert!((deviation / expected - 1.0).abs() < 0.1, "{deviation} {expected}");
        let mut again = BallPassage::new(&[0.8, 1e-2, 0.0, 3.0, 0.0, 0.0]);
        let mut passage = passage;
        assert_eq!(at(&mut passage, 0.123), at(&mut again, 0.123));
    }

    #[test]
    fn balls_that_slip_turn_the_phase_with_the_distance_and_not_with_the_position() {
        let values = [0.8, 1e-2, 0.0, 0.0, 0.0, 0.5];
        let mut passage = BallPassage::new(&values);
        // To and fro over a period, 0.02 m each time.
        let mut phases = Vec::new();
        for _ in 0..20_000 {
            for position in [0.0, 2.5e-3, 5e-3, 1e-2, 3.3e-3] {
                at(&mut passage, position);
            }
            at(&mut passage, 0.0);
            phases.push(passage.slip.as_ref().unwrap().phases.map(|(last, _)| last));
        }
        // Over 1 m: 50 times.
        let squares = phases.windows(51).step_by(50).flat_map(|piece| {
            (0..GUIDES).map(|guide| (piece[50][guide] - piece[0][guide]).powi(2))
        });
        let squares: Vec<f64> = squares.collect();
        let deviation = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        // 1600 pieces: standard error 2 %.
        assert!((deviation / 0.5 - 1.0).abs() < 0.08, "{deviation} of {}", squares.len());
    }

    #[test]
    fn balls_that_slip_do_so_alike_at_any_step_and_after_a_reset() {
        let values = [0.8, 1e-2, 0.4, 0.0, 0.0, 1.5];
        let end = |passage: &mut BallPassage, steps: i32| {
            (1..=steps)
                .map(|k| at(passage, 0.137 * f64::from(k) / f64::from(steps)))
                .last()
                .unwrap()
        };
        let mut passage = BallPassage::new(&values);
        let coarse = end(&mut passage, 100);
        passage.reset();
        let fine = end(&mut passage, 12_345);
        assert!((coarse - fine).abs() < 1e-9 && fine.abs() > 1e-3, "{coarse} {fine}");
        // Where it was is forgotten, how it came there is not.
        let again = at(&mut passage, 0.0);
        passage.reset();
        let first = at(&mut passage, 0.0);
        assert!((again - first).abs() > 1e-3, "{again} {first}");
    }

    #[test]
    fn proposal_finds_amplitude_period_and_phase_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[0.4, 9e-3, 2.0, 0.0, 0.0, 0.0]);
        assert!(
            (found[0] / 0.4 - 1.0).abs() < 0.1 && (found[1] / 9e-3 - 1.0).abs() < 0.002,
            "{found:?}"
        );
        assert!((found[2] - 2.0).abs() < 0.2, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
