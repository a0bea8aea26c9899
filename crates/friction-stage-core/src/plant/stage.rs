//! A stage as its controller sees it: read a sample, give a force, read the next sample.

use crate::model::{MAX_GUIDES, ModelError, StageModel};
use crate::numerics::plain;

use super::body::Body;
use super::effects::MAX_EFFECTS;
use super::sensors::Sensors;

/// Control rate and internal rate of the plant. The internal rate is an integer multiple of the
/// control rate.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rates {
    control: f64,
    substeps: u32,
}

/// Rates that do not fit each other.
#[expect(missing_docs, reason = "the message of each says what its fields are")]
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum RatesError {
    #[error("{name} is {} Hz, must be between {min} and {max} Hz", plain(*value))]
    Range { name: &'static str, value: f64, min: f64, max: f64 },
    #[error(
        "physics_rate {physics} Hz is {ratio:.6} times control_rate {control} Hz, must be a whole \
         multiple: {below} or {above} Hz"
    )]
    NotAMultiple { physics: f64, control: f64, ratio: f64, below: f64, above: f64 },
}

/// What the sensors of the stage say at one sampling instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Counted from construction.
    pub index: u64,
    /// Time since construction, ns.
    pub time: i64,
    /// Encoder, m.
    pub position: f64,
    /// Encoder by difference over one sample, m/s.
    pub velocity: f64,
    /// Force cell, N: motor side on carriage over the interval that ends here.
    pub force_cell: f64,
}

/// The truth behind a sample. `Copy`, so that it passes through a ring buffer without allocation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StageState {
    /// Number of the sample, counted from construction.
    pub index: u64,
    /// Time since construction, ns.
    pub time: i64,
    /// True position, m.
    pub position: f64,
    /// True velocity, m/s.
    pub velocity: f64,
    /// True acceleration, m/s^2.
    pub acceleration: f64,
    /// Commanded force of the motor, within its limit, N.
    pub motor_force: f64,
    /// Number of guides.
    pub guides: usize,
    /// Mean deflection of the bristles of each guide, m.
    pub bristle_deflection: [f64; MAX_GUIDES],
    /// Friction of each guide, N, positive against positive motion.
    pub guide_force: [f64; MAX_GUIDES],
    /// Number of effects.
    pub effects: usize,
    /// Force of each effect along +x, N.
    pub effect_force: [f64; MAX_EFFECTS],
}

/// Plant and sensors at a control rate. Two stages of the same model, rates, seed and forces give
/// the same bits.
#[derive(Debug)]
pub struct Stage {
    body: Body,
    sensors: Sensors,
    rates: Rates,
    force_limit: f64,
    index: u64,
    last_position: Option<f64>,
    clamped: u64,
}

impl Rates {
    /// 4 kHz control on a 25 us step: 0.2 nm from the converged solution over the 50 mm move.
    pub const DEFAULT: Rates = Rates { control: 4000.0, substeps: 10 };
    /// Control rates that the nodes accept, Hz.
    pub const CONTROL_RANGE: (f64, f64) = (1.0, 20_000.0);
    /// Internal rates that the nodes accept, Hz.
    pub const PHYSICS_RANGE: (f64, f64) = (1_000.0, 10_000_000.0);

    /// Both in Hz.
    pub fn new(control: f64, physics: f64) -> Result<Rates, RatesError> {
        let ranges = [
            ("control_rate", control, Self::CONTROL_RANGE),
            ("physics_rate", physics, Self::PHYSICS_RANGE),
        ];
        for (name, value, (min, max)) in ranges {
            if !(min..=max).contains(&value) {
                return Err(RatesError::Range { name, value, min, max });
            }
        }
        let ratio = physics / control;
        let substeps = ratio.round();
        if substeps < 1.0 || (ratio - substeps).abs() > 1e-9 * ratio {
            let below = (ratio.floor().max(1.0)) * control;
            return Err(RatesError::NotAMultiple {
                physics,
                control,
                ratio,
                below,
                above: ratio.ceil() * control,
            });
        }
        Ok(Rates { control, substeps: substeps as u32 })
    }

    /// Physics at the default rate, or above it by as little as a whole multiple of the control
    /// rate allows; Hz.
    pub fn of_control(control: f64) -> Result<Rates, RatesError> {
        Rates::new(control, control * (Self::DEFAULT.physics() / control).ceil().max(1.0))
    }

    /// Hz
    pub fn control(&self) -> f64 {
        self.control
    }

    /// Hz
    pub fn physics(&self) -> f64 {
        self.control * f64::from(self.substeps)
    }

    /// Internal steps per control sample.
    pub fn substeps(&self) -> u32 {
        self.substeps
    }

    /// Instant of control sample `index`, ns, rounded to whole nanoseconds without drift.
    pub fn time_of(&self, index: u64) -> i64 {
        (index as f64 * 1e9 / self.control).round() as i64
    }
}

impl Stage {
    /// A stage at rest at position 0 with unloaded bristles; `seed` starts the noise of its
    /// sensors.
    pub fn new(model: &StageModel, rates: Rates, seed: u64) -> Result<Stage, ModelError> {
        Ok(Stage {
            body: Body::new(model, rates.physics().recip())?,
            sensors: Sensors::new(model, seed),
            rates,
            force_limit: model.motor.force_limit,
            index: 0,
            last_position: None,
            clamped: 0,
        })
    }

    /// Reads the sensors. Once per sample: each call draws noise.
    pub fn sample(&mut self) -> Sample {
        let (position, cell_force) = self.body.effects().read(
            self.body.time(),
            self.body.position(),
            self.body.cell_force(),
        );
        let reading = self.sensors.read(position, cell_force);
        let velocity =
            self.last_position.map_or(0.0, |last| (reading.position - last) * self.rates.control);
        self.last_position = Some(reading.position);
        Sample {
            index: self.index,
            time: self.rates.time_of(self.index),
            position: reading.position,
            velocity,
            force_cell: reading.force_cell,
        }
    }

    /// Holds a motor force, N, until the next sample. Beyond the motor's limit it is clamped and
    /// counted; NaN counts as zero.
    pub fn advance(&mut self, force: f64) {
        let held =
            if force.is_nan() { 0.0 } else { force.clamp(-self.force_limit, self.force_limit) };
        if held != force {
            self.clamped += 1;
        }
        self.body.advance(held, self.rates.substeps);
        self.index += 1;
    }

    /// Samples at which the commanded force was beyond the motor's limit.
    pub fn clamped(&self) -> u64 {
        self.clamped
    }

    /// Control rate and internal rate.
    pub fn rates(&self) -> Rates {
        self.rates
    }

    /// Largest force of the motor in either direction, N.
    pub fn force_limit(&self) -> f64 {
        self.force_limit
    }

    /// Number of the sample that comes next.
    pub fn index(&self) -> u64 {
        self.index
    }

    /// The mechanics.
    pub fn body(&self) -> &Body {
        &self.body
    }

    /// Sets position (m), velocity (m/s) and bristle deflections (m); the state of effects and the
    /// time go on.
    pub fn set_state(&mut self, position: f64, velocity: f64, bristles: &[f64]) {
        self.body.set_state(position, velocity, bristles);
    }

    /// Position 0, at rest, bristles unloaded, effects as at the start; time, noise and counters go
    /// on.
    pub fn reset(&mut self) {
        self.body.reset();
        self.last_position = None;
    }

    /// The truth at the instant of the next sample.
    pub fn state(&self) -> StageState {
        let mut bristle_deflection = [0.0; MAX_GUIDES];
        let bristles = self.body.guides().bristles();
        bristle_deflection[..bristles.len()].copy_from_slice(bristles);
        let mut effect_force = [0.0; MAX_EFFECTS];
        let forces = self.body.effects().forces();
        effect_force[..forces.len()].copy_from_slice(forces);
        StageState {
            index: self.index,
            time: self.rates.time_of(self.index),
            position: self.body.position(),
            velocity: self.body.velocity(),
            acceleration: self.body.acceleration(),
            motor_force: self.body.motor_force(),
            guides: bristles.len(),
            bristle_deflection,
            guide_force: self.body.guide_forces(),
            effects: forces.len(),
            effect_force,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{Guide, GuideSource};

    #[test]
    fn a_physics_rate_that_is_no_multiple_is_refused_with_the_nearest_ones() {
        assert_eq!(Rates::new(4000.0, 40_000.0).unwrap(), Rates::DEFAULT);
        let message = Rates::new(4000.0, 41_000.0).unwrap_err().to_string();
        assert!(message.contains("10.25") && message.contains("40000 or 44000"), "{message}");
        assert!(Rates::new(4000.0, 2000.0).unwrap_err().to_string().contains("whole multiple"));
        assert!(Rates::new(f64::NAN, 2000.0).is_err());
    }

    #[test]
    fn force_beyond_the_limit_is_clamped_and_counted() {
        let mut model = StageModel::default().without_noise();
        model.motor.force_limit = 100.0;
        let mut limited = Stage::new(&model, Rates::DEFAULT, 0).unwrap();
        let mut at_limit = Stage::new(&model, Rates::DEFAULT, 0).unwrap();
        limited.advance(1e6);
        at_limit.advance(100.0);
        assert_eq!(limited.clamped(), 1);
        assert_eq!(at_limit.clamped(), 0);
        assert_eq!(limited.state(), at_limit.state());
        limited.advance(f64::NAN);
        assert_eq!(limited.state().motor_force, 0.0);
        assert_eq!(limited.clamped(), 2);
    }

    #[test]
    fn sample_times_do_not_drift() {
        let rates = Rates::new(3000.0, 30_000.0).unwrap();
        assert_eq!(rates.time_of(3000 * 3600), 3_600_000_000_000);
        assert_eq!(rates.time_of(1), 333_333);
    }

    /// Steady sliding: the force of the motor is that of the Stribeck curve at the speed it comes
    /// to, also without any effect.
    #[test]
    fn guides_with_a_stribeck_exponent_slide_along_their_curve() {
        let guide = Guide {
            stiffness: 4e5,
            bristle_damping: 400.0,
            viscous_friction: 50.0,
            coulomb_force: 10.0,
            static_force: 20.0,
            stribeck_velocity: 0.5,
            stribeck_exponent: Some(0.6),
            damping_velocity: Some(5e-3),
        };
        let model = StageModel {
            guides: vec![GuideSource::Inline(guide.clone())],
            ..StageModel::default().without_noise()
        };
        let mut stage = Stage::new(&model, Rates::of_control(1000.0).unwrap(), 0).unwrap();
        for _ in 0..60_000 {
            stage.advance(60.0);
        }
        let friction = guide.steady_force(stage.state().velocity);
        assert!((friction - 60.0).abs() < 1e-6, "{friction} N");
        let gaussian = Guide { stribeck_exponent: None, ..guide };
        let other = gaussian.steady_force(stage.state().velocity);
        assert!((other - 60.0).abs() > 0.1, "{other} N");
    }
}
