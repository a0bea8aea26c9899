//! Structural mode: a part of the moving mass is not rigid with the carriage but hangs on a spring.
//!
//! u part of mass M on the carriage at x: M d2u/dt2 = -k (u - x) - c (du/dt - dx/dt), F = k (u -
//! x) + c (du/dt - dx/dt) along +x on the carriage, whose own mass is m - M; k = M (2 pi f)^2, c =
//! 2 D M (2 pi f): M mass (kg), f frequency of the part on a fixed carriage (Hz), D damping ratio.
//! The total mass stays m. Exact over a step of constant carriage velocity; F is the momentum that
//! the part takes, so that none is lost. Source: two masses on a spring (any textbook of
//! vibration). Free-free frequency f sqrt(m / (m - M)). Sizes: assumed, 5 to 20 % of the mass, 30
//! to 300 Hz, ratio 0.01 to 0.05. Stored energy: of the spring and of the part. Not modelled:
//! several modes, modes that turn.

use std::f64::consts::TAU;

use rustfft::{FftPlanner, num_complex::Complex};

use super::regression::{beyond_chance, evenly, step_of};
use super::{
    Action, EffectDescriptor, EffectParameter, ForceLaw, ForceOverStep, Motion, Multiplicity,
    RecordSpecific, Residual, Role, descriptor,
};

/// Largest part, kg.
const HEAVIEST: f64 = 1000.0;
/// Lowest and highest frequency, Hz.
const FREQUENCIES: (f64, f64) = (1.0, 1000.0);
/// Least and largest damping ratio; the part must swing.
const DAMPINGS: (f64, f64) = (0.0, 0.9);

pub(super) const DESCRIPTOR: EffectDescriptor = EffectDescriptor {
    name: "structural_mode",
    role: Role::CarriageForce,
    law: "mass d2u/dt2 = -k (u - x) - c (u - x)', F = k (u - x) + c (u - x)', k = mass (2 pi \
          frequency)^2, c = 2 damping mass 2 pi frequency",
    source: "two masses on a spring",
    telltale: "rings at one frequency after every change of acceleration, at any speed, dies out \
               at rest",
    parameters: &[
        EffectParameter::required(
            "mass",
            "kg",
            "part of the moving mass carried by the spring",
            (0.0, HEAVIEST),
            1.0,
        ),
        EffectParameter::required(
            "frequency",
            "Hz",
            "its frequency on a fixed carriage",
            FREQUENCIES,
            10.0,
        ),
        EffectParameter::optional("damping", "1", "damping ratio", DAMPINGS, 0.01, 0.02),
    ],
    multiplicity: Multiplicity::One,
    record_specific: RecordSpecific::Nothing,
    typical: &[4.0, 100.0, 0.02],
    check: descriptor::any,
    free: descriptor::all_free,
    build: |values| Action::CarriageForce(Box::new(StructuralMode::new(values))),
    proposal: Some(propose),
    starts: descriptor::as_proposed,
    curve: None,
};

#[derive(Debug)]
struct StructuralMode {
    mass: f64,
    /// 2 pi f, rad/s.
    rate: f64,
    damping: f64,
    /// u - x, m.
    stretch: f64,
    /// du/dt, m/s; `None` before the first step, which it begins with the carriage.
    velocity: Option<f64>,
    swing: Swing,
}

impl StructuralMode {
    fn new(values: &[f64]) -> StructuralMode {
        StructuralMode {
            mass: values[0],
            rate: TAU * values[1],
            damping: values[2],
            stretch: 0.0,
            velocity: None,
            swing: Swing::default(),
        }
    }
}

/// What a free part does over a step: it depends on the length of the step alone, which is nearly
/// always that of the step before.
#[derive(Debug, Default)]
struct Swing {
    /// s
    step: f64,
    /// Of stretch, and of its rate, how much is left, and of each how much the other one gives (s,
    /// 1/s).
    stretch: f64,
    rate: f64,
    stretch_by_rate: f64,
    rate_by_stretch: f64,
}

impl Swing {
    /// Of a part of this circular frequency, rad/s, and damping ratio.
    fn over(step: f64, rate: f64, damping: f64) -> Swing {
        let decay = damping * rate;
        let swing = rate * (1.0 - damping * damping).sqrt();
        let (sine, cosine) = (swing * step).sin_cos();
        let (fade, aside) = ((-decay * step).exp(), sine / swing);
        Swing {
            step,
            stretch: fade * (cosine + decay * aside),
            rate: fade * (cosine - decay * aside),
            stretch_by_rate: fade * aside,
            rate_by_stretch: -fade * rate * rate * aside,
        }
    }
}

impl StructuralMode {
    /// Lets the part swing over a step about a stretch, m, from this rate of its stretch to the one
    /// that is returned, m/s.
    fn swing(&mut self, rate: f64, about: f64, step: f64) -> f64 {
        if self.swing.step != step {
            self.swing = Swing::over(step, self.rate, self.damping);
        }
        let (swing, aside) = (&self.swing, self.stretch - about);
        self.stretch = about + swing.stretch * aside + swing.stretch_by_rate * rate;
        swing.rate_by_stretch * aside + swing.rate * rate
    }
}

impl ForceLaw for StructuralMode {
    fn force(&mut self, motion: &Motion, step: f64) -> f64 {
        if step <= 0.0 {
            let rate = self.velocity.map_or(0.0, |velocity| velocity - motion.velocity);
            return self.mass * self.rate * (self.rate * self.stretch + 2.0 * self.damping * rate);
        }
        let start = self.velocity.unwrap_or(motion.velocity - 0.5 * step * motion.acceleration);
        let rate = start - motion.velocity;
        let rate = self.swing(rate, 0.0, step);
        let end = rate + motion.velocity;
        self.velocity = Some(end);
        self.mass * (start - end) / step
    }

    /// Exact for a constant acceleration of the carriage, under which the part swings about where
    /// it hangs behind.
    fn force_over(&mut self, motion: &Motion, step: f64) -> ForceOverStep {
        let gained = 0.5 * step * motion.acceleration;
        let start = self.velocity.unwrap_or(motion.velocity - gained);
        let before = self.stretch;
        let behind = -motion.acceleration / (self.rate * self.rate);
        let rate = self.swing(start - (motion.velocity - gained), behind, step);
        let end = rate + motion.velocity + gained;
        self.velocity = Some(end);
        // -M d2u/dt2 integrated by itself, and by parts with the time since the middle.
        let way = self.stretch - before + motion.velocity * step;
        ForceOverStep {
            mean: self.mass * (start - end) / step,
            moment: self.mass * (way - 0.5 * step * (start + end)) / (step * step),
        }
    }

    fn carried_mass(&self) -> f64 {
        self.mass
    }

    fn stiffness(&self) -> f64 {
        self.mass * self.rate * self.rate
    }

    fn stored_energy(&self, _position: f64) -> f64 {
        let velocity = self.velocity.unwrap_or(0.0);
        0.5 * self.mass * (velocity * velocity + (self.rate * self.stretch).powi(2))
    }

    fn reset(&mut self) {
        (self.stretch, self.velocity) = (0.0, None);
    }
}

/// Damping ratios that are tried.
const TRIED_DAMPINGS: [f64; 4] = [0.005, 0.015, 0.05, 0.15];
/// Bands of the spectrum per hertz, and steps of the frequency by this factor.
const BANDS_PER_HERTZ: f64 = 4.0;
const FREQUENCY_STEP: f64 = 1.01;

/// Cross spectrum of residual and acceleration in a band, and power of the acceleration.
#[derive(Clone, Copy, Default)]
struct Band {
    frequency: f64,
    cross: Complex<f64>,
    power: f64,
}

/// Frequency and damping at which acceleration, through the mode, explains most of the residual
/// beside a payload.
///
/// Residual over acceleration is M s^2 / (s^2 + 2 D w s + w^2), w = 2 pi f: M a less the force of
/// the spring.
fn propose(residual: &Residual) -> Option<Vec<f64>> {
    let count = residual.force.len();
    if count < 100
        || residual.force.iter().chain(residual.acceleration).any(|value| !value.is_finite())
    {
        return None;
    }
    let rate = step_of(residual).recip();
    let [force, acceleration] =
        [residual.force, residual.acceleration].map(|values| evenly(residual, values));
    let count = force.len();
    let fft = FftPlanner::new().plan_fft_forward(count);
    let [force, acceleration] = [force, acceleration].map(|values| {
        let mut spectrum: Vec<Complex<f64>> =
            values.into_iter().map(|value| Complex::new(value, 0.0)).collect();
        fft.process(&mut spectrum);
        spectrum
    });
    let per_bin = rate / count as f64;
    let highest = FREQUENCIES.1.min(0.4 * rate);
    let mut bands = vec![Band::default(); (highest * BANDS_PER_HERTZ) as usize + 1];
    let mut total = 0.0;
    for bin in 1..count / 2 {
        let frequency = bin as f64 * per_bin;
        total += force[bin].norm_sqr();
        let Some(band) = bands.get_mut((frequency * BANDS_PER_HERTZ) as usize) else { continue };
        band.frequency += acceleration[bin].norm_sqr() * frequency;
        band.cross += force[bin] * acceleration[bin].conj();
        band.power += acceleration[bin].norm_sqr();
    }
    let bands: Vec<Band> = bands
        .into_iter()
        .filter(|band| band.power > 0.0)
        .map(|band| Band { frequency: band.frequency / band.power, ..band })
        .collect();
    // Least squares of payload and mode: the payload's column is the acceleration itself.
    let power: f64 = bands.iter().map(|band| band.power).sum();
    let payload: f64 = bands.iter().map(|band| band.cross.re).sum();
    if power <= 0.0 {
        return None;
    }
    let fit = |frequency: f64, damping: f64| {
        let (mut with_force, mut square, mut with_payload) = (0.0, 0.0, 0.0);
        for band in &bands {
            let ratio = band.frequency / frequency;
            let response = Complex::new(-ratio * ratio, 0.0)
                / Complex::new(1.0 - ratio * ratio, 2.0 * damping * ratio);
            with_force += (response.conj() * band.cross).re;
            square += response.norm_sqr() * band.power;
            with_payload += response.re * band.power;
        }
        let left = square - with_payload * with_payload / power;
        let right = with_force - payload * with_payload / power;
        // A mode that is the payload to within 1e-6 tells nothing.
        if left <= 1e-6 * square { (0.0, 0.0) } else { (right * right / left, right / left) }
    };
    let mut best = (0.0, 0.0, 0.0, 0.0);
    let mut tried = 0;
    let mut try_at = |frequency: f64, damping: f64, best: &mut (f64, f64, f64, f64)| {
        let (explained, mass) = fit(frequency, damping);
        tried += 1;
        if explained > best.0 && mass > 0.0 {
            *best = (explained, mass, frequency, damping);
        }
    };
    for damping in TRIED_DAMPINGS {
        let mut frequency = 2.0 * FREQUENCIES.0;
        while frequency < highest {
            try_at(frequency, damping, &mut best);
            frequency *= FREQUENCY_STEP;
        }
    }
    // Finer steps around the best.
    for scale in [0.5, 0.25, 0.125, 0.06] {
        let (_, _, frequency, damping) = best;
        for across in -2..=2 {
            for along in -2..=2 {
                let frequency = frequency * FREQUENCY_STEP.powf(scale * f64::from(across));
                try_at(frequency, damping * 3f64.powf(scale * f64::from(along)), &mut best);
            }
        }
    }
    let (explained, mass, frequency, damping) = best;
    // Each bin holds two samples' worth of power.
    let rest = total - payload * payload / power - explained;
    beyond_chance(explained, rest, count / 2, 1, tried)
        .then(|| vec![mass.min(HEAVIEST), frequency, damping.clamp(DAMPINGS.0, DAMPINGS.1)])
}

#[cfg(test)]
mod tests {
    use super::super::regression::record::{assert_silent_on_noise, on_a_slippery_guide, proposal};
    use super::*;
    use crate::model::{EffectParameters, StageModel};
    use crate::plant::Body;

    /// 40 kg of which 8 kg on a spring of 50 Hz, on a guide that hardly rubs.
    fn body(damping: f64) -> Body {
        on_a_slippery_guide(EffectParameters::new(
            "structural_mode",
            [("mass", 8.0), ("frequency", 50.0), ("damping", damping)],
        ))
    }

    #[test]
    fn after_an_impulse_it_rings_at_the_free_free_frequency_about_the_speed_of_the_whole_mass() {
        let mut body = body(0.0);
        body.advance(4000.0, 40);
        // 4 N s on 40 kg.
        let mean = 0.1;
        let mut crossings = Vec::new();
        let mut last = body.velocity() - mean;
        for _ in 0..40_000 {
            body.advance(0.0, 1);
            let now = body.velocity() - mean;
            if last < 0.0 && now >= 0.0 {
                crossings.push(body.time() - 25e-6 * now / (now - last));
            }
            last = now;
        }
        let frequency =
            (crossings.len() - 1) as f64 / (crossings[crossings.len() - 1] - crossings[0]);
        let expected = 50.0 * (40.0f64 / 32.0).sqrt();
        assert!(
            (frequency / expected - 1.0).abs() < 1e-4,
            "{frequency} Hz, expected {expected} Hz"
        );
    }

    #[test]
    fn without_damping_energy_stays_and_with_damping_the_whole_moves_as_one() {
        let mut free = body(0.0);
        free.advance(4000.0, 40);
        let energy = free.energy();
        free.advance(0.0, 40_000);
        assert!((free.energy() / energy - 1.0).abs() < 1e-3, "{} J of {energy} J", free.energy());
        let mut damped = body(0.1);
        damped.advance(4000.0, 40);
        damped.advance(0.0, 40_000);
        // 0.1 m/s of 40 kg.
        assert!((damped.velocity() / 0.1 - 1.0).abs() < 1e-6, "{} m/s", damped.velocity());
        assert!((damped.energy() / 0.2 - 1.0).abs() < 1e-6, "{} J", damped.energy());
    }

    /// The closed form of a step against the force in many pieces of it, each at its own velocity.
    #[test]
    fn over_a_long_step_it_is_the_force_of_its_pieces() {
        let built = || StructuralMode::new(&[8.0, 70.0, 0.05]);
        let (mut whole, mut in_pieces) = (built(), built());
        let (step, pieces) = (5e-4, 1000);
        let mut velocity = 0.1;
        for k in 0..200 {
            let motion = Motion {
                velocity,
                acceleration: 30.0 * (0.2 * f64::from(k)).sin(),
                ..Motion::default()
            };
            let found = whole.force_over(&motion, step);
            let mut expected = ForceOverStep::default();
            for piece in 0..pieces {
                let aside = (f64::from(piece) + 0.5) / f64::from(pieces) - 0.5;
                let there =
                    Motion { velocity: velocity + aside * step * motion.acceleration, ..motion };
                let force = in_pieces.force(&there, step / f64::from(pieces)) / f64::from(pieces);
                expected.mean += force;
                expected.moment += aside * force;
            }
            let largest = 8.0 * 30.0;
            assert!(
                (found.mean - expected.mean).abs() < 1e-5 * largest,
                "step {k}: {found:?}, expected {expected:?}"
            );
            assert!(
                (found.moment - expected.moment).abs() < 1e-5 * largest,
                "step {k}: {found:?}, {expected:?}"
            );
            velocity += motion.acceleration * step;
        }
    }

    #[test]
    fn more_mass_on_the_spring_than_there_is_is_refused() {
        let mode = EffectParameters::new("structural_mode", [("mass", 41.0), ("frequency", 50.0)]);
        let model = StageModel { effects: vec![mode], ..StageModel::default() };
        let message = Body::new(&model, 25e-6).unwrap_err().to_string();
        assert!(message.contains("41 kg") && message.contains("40 kg"), "{message}");
    }

    #[test]
    fn proposal_finds_mass_frequency_and_damping_under_noise_and_nothing_in_noise() {
        let found = proposal(&DESCRIPTOR, &[4.0, 37.0, 0.02]);
        assert!(
            (found[0] / 4.0 - 1.0).abs() < 0.1 && (found[1] / 37.0 - 1.0).abs() < 0.01,
            "{found:?}"
        );
        assert!((found[2] / 0.02 - 1.0).abs() < 0.3, "{found:?}");
        assert_silent_on_noise(&DESCRIPTOR);
    }
}
