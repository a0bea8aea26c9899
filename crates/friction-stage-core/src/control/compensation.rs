//! Feedforward of what a model knows, along the reference: what the motor must give so that the
//! stage of the model follows without an error.
//!
//! In come a model and where the reference goes over the coming sample, out come forces, term by
//! term. Mass and viscous friction are as in textbooks; the bristles of the guides are driven along
//! the reference (LuGre or distributed ones; Canudas de Wit et al., IEEE TAC 40(3), 1995, section
//! V, drive theirs by the measured motion, which can hunt); effects that are a force are evaluated
//! where the reference is; gain, ripple and lag of the motor are inverted. Nothing of it depends on
//! the measured position, so it can neither hunt nor change the stability of the loop. At rest the
//! bristles of a real stage let go while sensor noise makes the carriage tremble, and so do these.
//! Nothing here allocates after construction.
//!
//! Not compensated: what depends on the time alone or has a phase of each recording's own, and what
//! is wrong with encoder or force cell.

use crate::model::{Coordinate, ModelError, StageModel};
use crate::plant::effects::{CommandStage, EffectDescriptor, Effects, Motion, Role};
use crate::plant::{FrictionScale, GuideBank, Rates, RatesError, Stage};

use super::controller::{Controller, ControllerError, ControllerSettings};
use super::disturbance_observer::ObserverSettings;
use super::trajectory::Follower;

/// Relative difference of the moving masses of model and controller from which on they are not of
/// one machine. Assumed: three times what the mass of a stage is uncertain by.
const MASS_TOLERANCE: f64 = 0.3;
/// Angular frequencies, rad/s, at which gain and delay, and the lag, of a motor are read.
const SLOW: f64 = 1e-2;
const FAST: f64 = 1e3;
/// Simulated time at rest in which the trembling of the stage is looked at, s, and the first part
/// of it that is left out.
const AT_REST: (f64, f64) = (0.3, 0.1);

/// Which terms are added.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CompensationTermsOn {
    /// Moving mass times acceleration.
    pub mass: bool,
    /// Viscous friction.
    pub viscous: bool,
    /// Bristles of the guides.
    pub bristles: bool,
    /// Effects that are a force: cogging, cable, maps and the like.
    pub forces: bool,
    /// Gain, ripple and lag of the motor.
    pub motor: bool,
}

impl CompensationTermsOn {
    /// All of them.
    pub const ALL: CompensationTermsOn = CompensationTermsOn {
        mass: true,
        viscous: true,
        bristles: true,
        forces: true,
        motor: true,
    };
}

/// Forces of the terms other than mass and viscous friction, N.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CompensationTerms {
    /// Of the bristles.
    pub bristles: f64,
    /// Against effects that are a force.
    pub forces: f64,
    /// By which the command must differ from the force that is wanted.
    pub motor: f64,
}

/// What the compensation adds for one sample, N.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Compensated {
    /// Mass times acceleration.
    pub mass: f64,
    /// Viscous friction.
    pub viscous: f64,
    /// The rest.
    pub terms: CompensationTerms,
}

/// A model that cannot compensate.
#[expect(missing_docs, reason = "the message of each says what its fields are")]
#[derive(Debug, thiserror::Error)]
pub enum CompensationError {
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error(transparent)]
    Rates(#[from] RatesError),
    #[error(transparent)]
    Controller(#[from] ControllerError),
    #[error(
        "the model moves {model} kg and the controller is for {controller} kg (feedforward.mass): \
         they are not of one machine"
    )]
    Mass { model: f64, controller: f64 },
    #[error(
        "the model has a coupling between motor and carriage, as the measuring rig has: its motion \
         between them is not compensated"
    )]
    Coupling,
}

/// The compensation of one stage at one rate.
#[derive(Debug)]
pub struct Compensation {
    on: CompensationTermsOn,
    /// Sampling period, s and ns.
    period: f64,
    period_ns: i64,
    /// kg
    mass: f64,
    guides: GuideBank,
    /// Those along the reference.
    effects: Effects,
    /// Gain and ripple of the motor.
    motor: Effects,
    /// exp(-T / time constant) of the motor's lag, and its output, N.
    decay: f64,
    output: f64,
    /// How far ahead the reference is looked at, ns: the motor's delay and what is left of its lag.
    ahead: i64,
    /// Delay of the motor, its lag included, s.
    late: f64,
    /// Mean speed of the carriage at rest, m/s.
    trembling: f64,
    /// Names of the model's effects that are not compensated.
    left_out: Vec<&'static str>,
    /// Reference at the end of the last step, m.
    last: Option<f64>,
    samples: u64,
}

impl Compensation {
    /// The compensation of what `model` knows for a controller of these settings.
    pub fn new(
        model: &StageModel,
        settings: &ControllerSettings,
        on: CompensationTermsOn,
    ) -> Result<Compensation, CompensationError> {
        model.check()?;
        settings.check()?;
        if model.coupling.is_some() {
            return Err(CompensationError::Coupling);
        }
        let (mut along, mut motor, mut lag, mut left_out) =
            (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for effect in &model.effects {
            let (descriptor, values) = EffectDescriptor::read(effect)?;
            match descriptor.role_of(&values) {
                Role::Command(CommandStage::Lag) => lag.push(effect.clone()),
                // Not proportional to the command.
                Role::Command(CommandStage::Threshold | CommandStage::Curve)
                | Role::Encoder
                | Role::ForceCell => left_out.push(descriptor.name),
                Role::Command(_) => motor.push(effect.clone()),
                _ if is_of_the_time(descriptor, &values) => left_out.push(descriptor.name),
                _ => along.push(effect.clone()),
            }
        }
        let (effects, motor, lag) =
            (Effects::new(&along)?, Effects::new(&motor)?, Effects::new(&lag)?);
        let mass = model.mass + effects.added_mass();
        let controller = settings.mass_feedforward;
        if controller > 0.0 && (mass / controller - 1.0).abs() > MASS_TOLERANCE {
            return Err(CompensationError::Mass { model: mass, controller });
        }
        let guides = model.resolved_guides()?;
        let bank = match effects.bristle_elements() {
            Some(elements) => GuideBank::with_elements(&guides, &elements),
            None => GuideBank::new(&guides),
        };
        let period = settings.rate.recip();
        // H = exp(-j w delay) / (1 + j w T).
        let (slow, fast) = (lag.command_transfer(SLOW), lag.command_transfer(FAST));
        let late = -slow.arg() / SLOW;
        let time_constant = (fast.norm_sqr().recip() - 1.0).max(0.0).sqrt() / FAST;
        let ratio = time_constant / period;
        let decay = if ratio > 0.0 { (-ratio.recip()).exp() } else { 0.0 };
        // The output is led to each force by the end of its sample; over the sample it has this
        // share of the force before.
        let share = (ratio * (1.0 - decay) - decay) / (1.0 - decay);
        let ahead = (late - time_constant).max(0.0) + share * period;
        Ok(Compensation {
            on,
            period,
            period_ns: (period * 1e9).round() as i64,
            mass,
            guides: bank,
            effects,
            motor,
            decay,
            output: 0.0,
            ahead: (ahead * 1e9).round() as i64,
            late,
            trembling: trembling(model, settings)?,
            left_out,
            last: None,
            samples: 0,
        })
    }

    /// Force, N, that answers the effects of a model at rest at each position, m: for drives that
    /// take a table.
    pub fn over_position(model: &StageModel, positions: &[f64]) -> Result<Vec<f64>, ModelError> {
        let mut of_position = Vec::new();
        for effect in &model.effects {
            let (descriptor, values) = EffectDescriptor::read(effect)?;
            if descriptor.role_of(&values).is_force() && !is_of_the_time(descriptor, &values) {
                of_position.push(effect.clone());
            }
        }
        let mut effects = Effects::new(&of_position)?;
        let at = |position: &f64| {
            effects.reset(0.0);
            let motion = Motion { position: *position, ..Motion::default() };
            let (motor, carriage) = effects.advance(&motion, 0.0);
            -(motor + carriage)
        };
        Ok(positions.iter().map(at).collect())
    }

    /// Names of the effects of the model that are not compensated.
    pub fn left_out(&self) -> &[&'static str] {
        &self.left_out
    }

    /// A disturbance observer with the mass of the model, the delay of its motor where the observer
    /// has none, and the lead of the feedforward.
    pub fn informed(&self, observer: ObserverSettings) -> ObserverSettings {
        let delay = if observer.delay > 0.0 { observer.delay } else { self.late };
        let forward_delay = if self.on.motor { 1e-9 * self.ahead as f64 } else { delay };
        ObserverSettings { mass: self.mass, delay, forward_delay, ..observer }
    }

    /// Which terms are added.
    pub fn on(&self) -> CompensationTermsOn {
        self.on
    }

    /// Switches terms while running; what is off is still followed.
    pub fn switch(&mut self, on: CompensationTermsOn) {
        self.on = on;
    }

    /// The forces for the sample that begins at `time` (ns), each within `limits` (N).
    pub fn update(&mut self, time: i64, follower: &Follower, limits: (f64, f64)) -> Compensated {
        let from = time + self.ahead;
        let (start, end) = (follower.at(from), follower.at(from + self.period_ns));
        let position = self.last.unwrap_or(start.position);
        let velocity = (end.position - position) / self.period;
        self.last = Some(end.position);
        let acceleration = if follower.can_look_ahead() {
            (end.velocity - start.velocity) / self.period
        } else {
            start.acceleration
        };
        let motion = Motion {
            time: (self.samples as f64 + 0.5) * self.period,
            position: 0.5 * (position + end.position),
            velocity,
            acceleration,
            ..Motion::default()
        };
        self.samples += 1;
        let (bristles, viscous, forces, mass) = self.along(&motion);
        let bounded = |on: bool, force: f64| {
            if on && force.is_finite() { force.clamp(limits.0, limits.1) } else { 0.0 }
        };
        let mass = bounded(self.on.mass, mass * acceleration);
        let viscous = bounded(self.on.viscous, viscous);
        let bristles = bounded(self.on.bristles, bristles);
        let forces = bounded(self.on.forces, forces);
        let wanted = mass + viscous + bristles + forces + start.effort;
        let motor = bounded(self.on.motor, self.command(wanted, &motion) - wanted);
        Compensated { mass, viscous, terms: CompensationTerms { bristles, forces, motor } }
    }

    /// Friction of bristles and oil, force against the effects, N, and the moving mass, kg.
    fn along(&mut self, motion: &Motion) -> (f64, f64, f64, f64) {
        let scale = if self.effects.is_empty() {
            FrictionScale::ONE
        } else {
            self.effects.friction(motion, self.period)
        };
        // What trembles slips at the speed of the trembling while its mean hardly moves.
        let trembling = self.trembling;
        let bristles: f64 = if motion.velocity.abs() < trembling {
            [trembling, -trembling]
                .map(|speed| {
                    let velocity = motion.velocity + speed;
                    let half = 0.5 * self.period;
                    self.guides.drive_each(velocity, half, &scale).iter().sum::<f64>()
                })
                .iter()
                .sum::<f64>()
                * 0.5
        } else {
            self.guides.drive_each(motion.velocity, self.period, &scale).iter().sum()
        };
        let viscous = scale.viscous * self.guides.viscous_friction() * motion.velocity;
        let forces = if self.effects.is_empty() {
            0.0
        } else {
            let (motor, carriage) = self.effects.advance(motion, self.period);
            -(motor + carriage)
        };
        (bristles, viscous, forces, self.mass + self.effects.mass_along(motion))
    }

    /// The command that makes the motor give `wanted`, N.
    fn command(&mut self, wanted: f64, motion: &Motion) -> f64 {
        let gain = if self.motor.is_empty() {
            1.0
        } else {
            // Proportional to the command, without a state of its own.
            let one = Motion { motor_force: 1.0, ..*motion };
            1.0 + self.motor.advance(&one, self.period).0
        };
        // A motor that gives next to nothing cannot be inverted.
        let through = wanted / gain.max(0.1);
        let command = (through - self.decay * self.output) / (1.0 - self.decay);
        self.output = through;
        command
    }

    /// Forgets where the reference was and how the bristles are loaded.
    pub fn reset(&mut self) {
        self.last = None;
        self.output = 0.0;
        self.samples = 0;
        self.guides.set_bristles(&[0.0; crate::model::MAX_GUIDES], 0.0);
        self.effects.reset(0.0);
        self.motor.reset(0.0);
    }
}

/// Whether an effect depends on the time alone or has a phase of each recording's own.
fn is_of_the_time(descriptor: &EffectDescriptor, values: &[f64]) -> bool {
    use crate::plant::effects::RecordSpecific;
    let curve = descriptor.curve_of(values);
    curve.is_some_and(|curve| curve.coordinate == Coordinate::Time)
        || matches!(descriptor.record_specific, RecordSpecific::Phase)
        || descriptor.slipping_ripple(values).is_some()
}

/// Mean speed of the carriage of a model that its controller holds at rest, m/s.
fn trembling(model: &StageModel, settings: &ControllerSettings) -> Result<f64, CompensationError> {
    let rates = Rates::of_control(settings.rate)?;
    let mut stage = Stage::new(model, rates, 1)?;
    let mut controller = Controller::new(settings.clone())?;
    let mut follower = Follower::new(f64::INFINITY);
    let (mut sum, mut count) = (0.0, 0.0);
    let rate = settings.rate;
    for k in 0..(AT_REST.0 * rate) as usize {
        let sample = stage.sample();
        if k == 0 {
            follower.hold(sample.time, sample.position);
        }
        if k as f64 >= AT_REST.1 * rate {
            sum += stage.body().velocity().abs();
            count += 1.0;
        }
        let output = controller.update(sample.time, sample.position, &mut follower).output;
        stage.advance(output);
    }
    let mean: f64 = sum / f64::max(count, 1.0);
    Ok(if mean.is_finite() { mean } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::super::Trajectory;
    use super::*;
    use crate::ClosedLoop;
    use crate::model::{Curve, CurveSide, EffectParameters};

    /// Largest error along a move of 50 mm and back, µm, with the sensors of the model.
    fn peak(real: &StageModel, known: Option<&StageModel>, on: CompensationTermsOn) -> f64 {
        let settings = ControllerSettings::of_model(real, 60.0, 4000.0);
        let known = known.map(|known| Compensation::new(known, &settings, on).unwrap());
        peak_of(real, settings, known)
    }

    fn peak_of(
        real: &StageModel,
        settings: ControllerSettings,
        compensation: Option<Compensation>,
    ) -> f64 {
        let point = |time: i64, position| super::super::Point::at_rest(time * 1_000_000, position);
        let points = vec![
            point(50, 0.0),
            point(150, 0.05),
            point(450, 0.05),
            point(550, 0.0),
            point(800, 0.0),
        ];
        let stage = Stage::new(real, Rates::DEFAULT, 1).unwrap();
        let controller = Controller::new(settings).unwrap();
        let mut run = ClosedLoop::new(stage, controller, Trajectory::new(0, points).unwrap());
        if let Some(compensation) = compensation {
            run = run.compensated(compensation);
        }
        let errors = (0..3200).map(|_| 1e6 * run.cycle().unwrap().terms.error.abs());
        errors.fold(0.0, f64::max)
    }

    fn with(effects: Vec<EffectParameters>) -> StageModel {
        StageModel { effects, ..StageModel::on_guides("guide_1") }
    }

    #[test]
    fn a_stage_that_is_known_follows_with_a_tenth_of_the_error() {
        let bristles: Vec<(&'static str, f64)> = EffectDescriptor::find("distributed_bristles")
            .map(|effect| {
                let names = effect.parameters.iter().zip(effect.typical);
                names
                    .filter(|(one, _)| one.default.is_none())
                    .map(|(one, x)| (one.name, *x))
                    .collect()
            })
            .unwrap();
        let map = Curve {
            coordinate: Coordinate::Position,
            side: CurveSide::Carriage,
            from: -0.01,
            to: 0.06,
            values: vec![0.0, 10.0, -5.0, 8.0, 0.0],
            jump: None,
        };
        let named = |name: &str, values: &[(&'static str, f64)]| {
            EffectParameters::new(name, values.iter().copied())
        };
        let cases = [
            vec![],
            vec![named("distributed_bristles", &bristles)],
            vec![
                named("cogging", &[("amplitude", 8.0), ("period", 0.02), ("phase", 1.0)]),
                named("cable_chain", &[("stiffness", 100.0), ("center", -0.02)]),
                named("payload", &[("mass", 3.0)]),
                EffectParameters::map(map),
            ],
            vec![
                named("motor_gain", &[("fraction", -0.08)]),
                named("force_ripple", &[("fraction", 0.03), ("period", 0.03)]),
            ],
            vec![named("actuator_lag", &[("time_constant", 4e-4), ("delay", 6e-4)])],
            vec![named("actuator_lag", &[("time_constant", 5e-5)])],
            vec![named("motor_droop", &[("coefficient", 0.1)])],
        ];
        for effects in cases {
            let model = with(effects.clone());
            let plain = peak(&model, None, CompensationTermsOn::ALL);
            let compensated = peak(&model, Some(&model), CompensationTermsOn::ALL);
            println!("{effects:?}: {plain} -> {compensated}");
            assert!(compensated < 0.1 * plain, "{effects:?}: {plain} µm, {compensated} µm");
        }
    }

    #[test]
    fn each_term_does_its_part_and_can_be_switched_off() {
        let model = with(vec![EffectParameters::new("motor_gain", [("fraction", -0.08)])]);
        let all = CompensationTermsOn::ALL;
        let best = peak(&model, Some(&model), all);
        for on in [
            CompensationTermsOn { mass: false, ..all },
            CompensationTermsOn { viscous: false, ..all },
            CompensationTermsOn { bristles: false, ..all },
            CompensationTermsOn { motor: false, ..all },
        ] {
            let without = peak(&model, Some(&model), on);
            assert!(without > 2.0 * best, "{on:?}: {without} µm, {best} µm with all");
        }
    }

    #[test]
    fn an_observer_gets_the_lag_of_the_motor_from_the_compensation() {
        let lag = [("time_constant", 5e-4), ("delay", 1e-3)];
        let model = with(vec![EffectParameters::new("actuator_lag", lag)]);
        let settings = ControllerSettings::of_model(&model, 30.0, 4000.0);
        let observer = ObserverSettings {
            bandwidth: 6.0,
            limit: ObserverSettings::LIMIT,
            mass: model.mass,
            delay: 0.0,
            forward_delay: 0.0,
        };
        let observed = ControllerSettings { observer: Some(observer), ..settings.clone() };
        let on = CompensationTermsOn::ALL;
        let compensation = || Compensation::new(&model, &settings, on).unwrap();
        let informed = observed.informed(&compensation());
        let run = |settings: ControllerSettings| peak_of(&model, settings, Some(compensation()));
        // Without it the lag of the feedforward is a disturbance to it.
        let (ignorant, knowing) = (run(observed), run(informed));
        assert!(knowing < 0.05 * ignorant, "{knowing} µm, {ignorant} µm");
    }

    #[test]
    fn at_rest_the_bristles_let_go_as_those_of_a_trembling_stage_do() {
        let model = StageModel::on_guides("guide_1");
        let settings = ControllerSettings::of_model(&model, 60.0, 4000.0);
        let mut loaded = Compensation::new(&model, &settings, CompensationTermsOn::ALL).unwrap();
        assert!((1e-9..1e-4).contains(&loaded.trembling), "{} m/s", loaded.trembling);
        let mut follower = Follower::new(1.0);
        follower.follow(0, Trajectory::rest_to_rest(0, 0.05, 100_000_000)).unwrap();
        let mut at = |seconds: f64, from: &mut i64| {
            let mut force = 0.0;
            while (*from as f64) < seconds * 1e9 {
                follower.advance(*from);
                force = loaded.update(*from, &follower, (-2000.0, 2000.0)).terms.bristles;
                *from += 250_000;
            }
            force
        };
        let mut time = 0;
        let (arrived, later) = (at(0.11, &mut time), at(20.0, &mut time));
        assert!(arrived > 10.0 && later > 0.0 && later < 0.98 * arrived, "{arrived} N, {later} N");
    }

    #[test]
    fn over_the_position_it_is_the_force_against_cogging_and_cable() {
        let model = with(vec![
            EffectParameters::new(
                "cogging",
                [("amplitude", 8.0), ("period", 0.02), ("phase", 0.0)],
            ),
            EffectParameters::new("cable_chain", [("stiffness", 100.0), ("center", 0.01)]),
        ]);
        let found = Compensation::over_position(&model, &[0.005, 0.01, 0.015]).unwrap();
        let sign = found[0].signum();
        // A quarter of the period apart: the cogging turns its sign, and so does the cable.
        assert!((found[0].abs() - 8.5).abs() < 1e-9 || (found[0].abs() - 7.5).abs() < 1e-9);
        assert!(found[1].abs() < 1e-9 && (found[2] + sign * found[0].abs()).abs() < 1e-9);
    }

    #[test]
    fn what_cannot_compensate_is_refused_and_what_is_not_compensated_is_named() {
        let model = StageModel::on_guides("guide_1");
        let settings = ControllerSettings::paper(12.0, 4000.0, 2000.0);
        let on = CompensationTermsOn::ALL;
        let reported = Compensation::new(&model, &settings, on).unwrap_err().to_string();
        assert!(reported.contains("40 kg") && reported.contains("12 kg"), "{reported}");
        let rig = StageModel::measuring_rig("guide_1").unwrap();
        let of_rig = ControllerSettings::of_model(&rig, 60.0, 4000.0);
        assert!(Compensation::new(&rig, &of_rig, on).is_err());
        let sde = EffectParameters::new(
            "encoder_sde",
            [("amplitude", 1e-7), ("period", 15e-6), ("phase", 0.0)],
        );
        let dead_zone = EffectParameters::new("dead_zone", [("width", 2.0)]);
        let saturation = EffectParameters::new("motor_saturation", [("saturation_force", 3000.0)]);
        let model = with(vec![sde, dead_zone, saturation]);
        let settings = ControllerSettings::of_model(&model, 60.0, 4000.0);
        let compensation = Compensation::new(&model, &settings, on).unwrap();
        assert_eq!(compensation.left_out(), ["encoder_sde", "dead_zone", "motor_saturation"]);
    }
}
