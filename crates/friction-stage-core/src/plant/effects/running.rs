//! The effects of one stage, advanced together.

use nalgebra::Complex;

use crate::model::{EffectParameters, ModelError};

use super::super::guides::{BristleElements, FrictionScale};
use super::{
    Action, CommandLaw, CommandStage, EffectDescriptor, ForceLaw, ForceOverStep, FrictionLaw,
    FrictionTerms, MassLaw, Motion, ReadingLaw, Role,
};

/// Most effects that one stage may have: their forces pass through fixed-size buffers.
pub const MAX_EFFECTS: usize = 16;

/// The effects of one stage, by their roles, with the forces of the last step.
#[derive(Debug)]
pub struct Effects {
    names: Vec<&'static str>,
    /// In the order of the model, N.
    forces: Vec<f64>,
    /// The chain that makes the motor's force, as its stages follow each other.
    commands: Vec<Command>,
    pushes: Vec<Push>,
    friction: Vec<Box<dyn FrictionLaw>>,
    friction_terms: FrictionTerms,
    bristles: Option<BristleElements>,
    /// kg
    added_mass: f64,
    masses: Vec<Box<dyn MassLaw>>,
    /// N/m
    stiffness: f64,
    encoder: Vec<Box<dyn ReadingLaw>>,
    /// Of the encoder against the carriage, m/N.
    compliance: f64,
    force_cell: Vec<Box<dyn ReadingLaw>>,
    motor_side: f64,
    carriage_side: f64,
}

/// An effect that changes the command.
#[derive(Debug)]
struct Command {
    /// Place in the model.
    index: usize,
    stage: CommandStage,
    law: Box<dyn CommandLaw>,
}

/// An effect that adds a force.
#[derive(Debug)]
struct Push {
    /// Place in the model.
    index: usize,
    on_motor: bool,
    law: Box<dyn ForceLaw>,
}

/// The force of the motor on its way through the chain of its command.
struct Chain {
    stage: Option<CommandStage>,
    /// What arrives at this stage, and that with what it adds.
    arriving: ForceOverStep,
    passed_on: ForceOverStep,
}

impl Chain {
    fn new(command: f64) -> Chain {
        let command = ForceOverStep { mean: command, moment: 0.0 };
        Chain { stage: None, arriving: command, passed_on: command }
    }

    /// What arrives at a stage that is not before the last one.
    fn arriving(&mut self, stage: CommandStage) -> ForceOverStep {
        if self.stage != Some(stage) {
            (self.stage, self.arriving) = (Some(stage), self.passed_on);
        }
        self.arriving
    }

    fn pass_on(&mut self, added: ForceOverStep) {
        self.passed_on.add(added);
    }
}

impl Effects {
    /// The effects of a model, at rest at position 0 at time 0.
    pub fn new(given: &[EffectParameters]) -> Result<Effects, ModelError> {
        let parts =
            given.iter().map(EffectDescriptor::read).collect::<Result<Vec<_>, ModelError>>()?;
        Effects::assembled(parts.iter().map(|(descriptor, values)| (*descriptor, &values[..])))
    }

    /// As [`Effects::new`], from values in the order of each descriptor's parameters.
    pub fn from_values<'a>(
        parts: impl IntoIterator<Item = (&'static EffectDescriptor, &'a [f64])>,
    ) -> Result<Effects, ModelError> {
        let checked = |(descriptor, values): (&'static EffectDescriptor, &'a [f64])| {
            descriptor.check_values(values)?;
            Ok((descriptor, values))
        };
        let parts = parts.into_iter().map(checked).collect::<Result<Vec<_>, ModelError>>()?;
        Effects::assembled(parts.into_iter())
    }

    /// From checked values.
    fn assembled<'a>(
        parts: impl ExactSizeIterator<Item = (&'static EffectDescriptor, &'a [f64])>,
    ) -> Result<Effects, ModelError> {
        let count = parts.len();
        if count > MAX_EFFECTS {
            let key = "effects (their number)".to_owned();
            let limit = format!("not be above {MAX_EFFECTS}");
            return Err(ModelError::Value { key, value: count as f64, limit });
        }
        let mut effects = Effects {
            names: Vec::with_capacity(count),
            forces: vec![0.0; count],
            commands: Vec::new(),
            pushes: Vec::new(),
            friction: Vec::new(),
            friction_terms: FrictionTerms::NOTHING,
            bristles: None,
            added_mass: 0.0,
            masses: Vec::new(),
            stiffness: 0.0,
            encoder: Vec::new(),
            compliance: 0.0,
            force_cell: Vec::new(),
            motor_side: 0.0,
            carriage_side: 0.0,
        };
        for (index, (descriptor, values)) in parts.enumerate() {
            effects.names.push(descriptor.name);
            effects.add(index, descriptor.role_of(values), (descriptor.build)(values));
        }
        effects.commands.sort_by_key(|command| command.stage);
        effects.reset(0.0);
        Ok(effects)
    }

    fn add(&mut self, index: usize, role: Role, action: Action) {
        match action {
            Action::Command(law) => {
                let stage = role.command_stage().unwrap_or(CommandStage::Gain);
                self.commands.push(Command { index, stage, law });
            }
            Action::MotorForce(law) => self.add_force(Push { index, on_motor: true, law }),
            Action::CarriageForce(law) => self.add_force(Push { index, on_motor: false, law }),
            Action::Friction(law) => {
                self.friction_terms = self.friction_terms.union(role.friction_terms());
                self.friction.push(law);
            }
            // The last one counts.
            Action::Bristles(elements) => self.bristles = Some(elements),
            Action::Mass(mass) => self.added_mass += mass,
            Action::VaryingMass(law) => self.masses.push(law),
            Action::Encoder(law) => self.encoder.push(law),
            Action::Compliance(compliance) => self.compliance += compliance,
            Action::ForceCell(law) => self.force_cell.push(law),
        }
    }

    fn add_force(&mut self, push: Push) {
        self.added_mass -= push.law.carried_mass();
        self.stiffness += push.law.stiffness();
        self.pushes.push(push);
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }

    /// Canonical names, in the order of the model.
    pub fn names(&self) -> impl Iterator<Item = &'static str> {
        self.names.iter().copied()
    }

    /// Forces of the last step along +x, N, in the order of the model; 0 for those that act through
    /// friction, mass or sensors.
    pub fn forces(&self) -> &[f64] {
        &self.forces
    }

    /// Mass that the effects add to the carriage, kg.
    pub fn added_mass(&self) -> f64 {
        self.added_mass
    }

    /// Whether the mass that moves with the carriage is not always the same.
    pub fn changes_mass(&self) -> bool {
        !self.masses.is_empty()
    }

    /// What the effects add to the carriage beyond [`Effects::added_mass`] as it moves now, kg.
    pub fn mass_along(&self, motion: &Motion) -> f64 {
        self.masses.iter().map(|law| law.mass(motion)).sum()
    }

    /// The least that this comes to, kg.
    pub fn least_mass(&self) -> f64 {
        self.masses.iter().map(|law| law.least()).sum()
    }

    /// Sum of the largest slopes of the forces over position, N/m.
    pub fn stiffness(&self) -> f64 {
        self.stiffness
    }

    /// Shares of the bristle elements of each guide, of the last effect that has some; `None`: one
    /// bristle.
    pub fn bristle_elements(&self) -> Option<BristleElements> {
        self.bristles
    }

    /// Which laws of the guides they multiply.
    pub fn friction_terms(&self) -> FrictionTerms {
        self.friction_terms
    }

    /// Whether the guides' laws or bristles are not those of the model alone.
    pub fn shapes_friction(&self) -> bool {
        self.friction_terms != FrictionTerms::NOTHING || self.bristles.is_some()
    }

    /// Whether what any of them does to the viscous friction depends on the friction of all guides.
    pub fn feel_friction(&self) -> bool {
        self.friction.iter().any(|law| law.feels_friction())
    }

    /// Factors on the guides' laws over a step. Before [`Effects::advance`], once per step.
    pub fn friction(&mut self, motion: &Motion, step: f64) -> FrictionScale {
        let mut scale = FrictionScale::ONE;
        self.friction.iter_mut().for_each(|law| law.scale(motion, step, &mut scale));
        scale
    }

    /// Advances every effect by a step; sums of the motor side and of the carriage side, N.
    pub fn advance(&mut self, motion: &Motion, step: f64) -> (f64, f64) {
        (self.motor_side, self.carriage_side) = (0.0, 0.0);
        let mut chain = Chain::new(motion.motor_force);
        for Command { index, stage, law } in &mut self.commands {
            let force = law.change(chain.arriving(*stage).mean, motion, step);
            chain.pass_on(ForceOverStep { mean: force, moment: 0.0 });
            self.forces[*index] = force;
            self.motor_side += force;
        }
        for Push { index, on_motor, law } in &mut self.pushes {
            let force = law.force(motion, step);
            self.forces[*index] = force;
            *(if *on_motor { &mut self.motor_side } else { &mut self.carriage_side }) += force;
        }
        self.last()
    }

    /// Advances every effect by a step as long as a control cycle; sum of their forces.
    pub fn advance_long(&mut self, motion: &Motion, step: f64) -> ForceOverStep {
        let (mut sum, mut chain) = (ForceOverStep::default(), Chain::new(motion.motor_force));
        for Command { stage, law, .. } in &mut self.commands {
            let arriving = chain.arriving(*stage);
            let mut over = law.change_over(arriving.mean, motion, step);
            if *stage > CommandStage::Lag {
                // These laws have no state. Of a force that is early or late in the step they
                // change that part by their slope.
                let shifted = law.change(arriving.mean + arriving.moment, motion, step);
                over.moment += shifted - over.mean;
            }
            chain.pass_on(over);
            sum.add(over);
        }
        for Push { law, .. } in &mut self.pushes {
            sum.add(law.force_over(motion, step));
        }
        sum
    }

    /// Force of the motor over its command for a sinusoid of this angular frequency, rad/s.
    pub fn command_transfer(&self, angular_frequency: f64) -> Complex<f64> {
        let (mut stage, mut arriving) = (None, Complex::new(1.0, 0.0));
        let mut passed_on = arriving;
        for command in &self.commands {
            if stage != Some(command.stage) {
                (stage, arriving) = (Some(command.stage), passed_on);
            }
            passed_on += arriving * command.law.added(angular_frequency);
        }
        passed_on
    }

    /// Sums of the last step: motor side, carriage side, N.
    pub fn last(&self) -> (f64, f64) {
        (self.motor_side, self.carriage_side)
    }

    #[inline]
    pub(in super::super) fn last_total(&self) -> f64 {
        self.motor_side + self.carriage_side
    }

    /// What encoder (m) and force cell (N) read with the carriage at `position` and under the force
    /// of the motor that has acted until now, before noise and quantisation. Each effect is wrong
    /// about the truth, none about what another makes of it.
    pub fn read(&self, time: f64, position: f64, force: f64) -> (f64, f64) {
        let read = |laws: &[Box<dyn ReadingLaw>], truth: f64| {
            laws.iter().fold(truth, |reading, law| reading + (law.reading(time, truth) - truth))
        };
        let ahead = self.compliance * force;
        (read(&self.encoder, position) + ahead, read(&self.force_cell, force))
    }

    /// By how much the encoder is ahead of the carriage per force of the motor, m/N.
    pub fn encoder_compliance(&self) -> f64 {
        self.compliance
    }

    /// Lets a force cell that is late follow the true force, N, that stood for a step, s. After
    /// [`Effects::advance`], once per step.
    pub fn follow(&mut self, force: f64, step: f64) {
        self.force_cell.iter_mut().for_each(|law| law.follow(force, step));
    }

    /// Changes what a force cell has shown after steps of `step` seconds, N, into what it would
    /// have shown in time.
    pub fn made_up_for(&self, readings: &mut [f64], step: f64) {
        self.force_cell.iter().for_each(|law| law.made_up_for(readings, step));
    }

    /// Energy that they hold and can give back with the carriage at a position, m; J.
    pub fn stored_energy(&self, position: f64) -> f64 {
        self.pushes.iter().map(|push| push.law.stored_energy(position)).sum()
    }

    /// Back to rest at position 0 at `time`, s, with the forces that act there.
    pub fn reset(&mut self, time: f64) {
        self.commands.iter_mut().for_each(|command| command.law.reset());
        self.pushes.iter_mut().for_each(|push| push.law.reset());
        self.friction.iter_mut().for_each(|law| law.reset());
        self.force_cell.iter_mut().for_each(|law| law.reset());
        self.advance(&Motion { time, ..Motion::default() }, 0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A first-order lag of 1 ms under a command that steps to 100 N, in closed form: y = u (1 -
    /// exp(-t / T)), its mean over a cycle of h u (1 - T / h (1 - exp(-h / T))), its moment u T / h
    /// (1/2 (1 + exp(-h / T)) - T / h (1 - exp(-h / T))).
    #[test]
    fn gain_and_ripple_make_their_part_of_the_force_that_arrives_late() {
        let named = |name: &str, values: &[(&'static str, f64)]| {
            EffectParameters::new(name, values.iter().copied())
        };
        let (lag, cycle, command) = (1e-3, 5e-4, 100.0);
        // In any order of the model.
        let mut effects = Effects::new(&[
            named("force_ripple", &[("fraction", 0.05), ("period", 0.02)]),
            named("cogging", &[("amplitude", 2.0), ("period", 0.02)]),
            named("motor_gain", &[("fraction", 0.2)]),
            named("actuator_lag", &[("time_constant", lag)]),
        ])
        .unwrap();
        // A quarter of a period: the peak of ripple and cogging.
        let motion = Motion {
            time: 0.5 * cycle,
            position: 0.005,
            motor_force: command,
            ..Motion::default()
        };
        let (ratio, rest) = (lag / cycle, (-cycle / lag).exp());
        let mean = command * (1.0 - ratio * (1.0 - rest));
        let moment = command * ratio * (0.5 * (1.0 + rest) - ratio * (1.0 - rest));
        let over = effects.advance_long(&motion, cycle);
        let factor = 1.2 * 1.05;
        assert!((over.mean - (factor * mean + 2.0 - command)).abs() < 1e-9, "{over:?}");
        assert!((over.moment - factor * moment).abs() < 1e-9, "{over:?} {}", factor * moment);
        effects.reset(0.0);
        let (motor_side, _) = effects.advance(&motion, cycle);
        assert!((motor_side - over.mean).abs() < 1e-9);
        let expected = [0.05 * 1.2 * mean, 2.0, 0.2 * mean, mean - command];
        assert!(
            effects
                .forces()
                .iter()
                .zip(expected)
                .all(|(found, expected)| (found - expected).abs() < 1e-9)
        );
    }

    #[test]
    fn the_motor_answers_a_sine_late_and_with_its_gain() {
        let effects = Effects::new(&[
            EffectParameters::new("motor_gain", [("fraction", 0.2)]),
            EffectParameters::new("actuator_lag", [("time_constant", 1e-3), ("delay", 2e-3)]),
        ])
        .unwrap();
        let w = 300.0;
        let found = effects.command_transfer(w);
        let expected = 1.2 / (1.0 + (w * 1e-3).powi(2)).sqrt();
        assert!((found.norm() - expected).abs() < 1e-12, "{found}");
        assert!((found.arg() + w * 2e-3 + (w * 1e-3).atan()).abs() < 1e-12, "{found}");
    }

    #[test]
    fn each_reading_error_is_about_the_truth_whatever_the_others_make_of_it() {
        let sde = |amplitude: f64, period: f64| {
            EffectParameters::new(
                "encoder_sde",
                [("amplitude", amplitude), ("period", period), ("phase", 0.0)],
            )
        };
        let (first, second) = (sde(2e-7, 15e-6), sde(5e-8, 7.5e-6));
        let error =
            |all: &[EffectParameters]| Effects::new(all).unwrap().read(0.0, 2e-6, 0.0).0 - 2e-6;
        let alone = [error(std::slice::from_ref(&first)), error(std::slice::from_ref(&second))];
        let both = error(&[first, second]);
        assert!((both - alone[0] - alone[1]).abs() < 1e-18, "{alone:?} {both}");
    }
}
