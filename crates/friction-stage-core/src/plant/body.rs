//! The moving bodies: the carriage on its guides and, on the measuring rig, the motor behind a
//! flexure.

use crate::model::{Guide, MAX_GUIDES, ModelError, StageModel, Stroke};

use super::effects::{Effects, Motion};
use super::guides::{GuideBank, MAX_STEP_DAMPING};

/// Largest product of step and highest natural frequency of the flexure, rad; the explicit step is
/// stable below 2.
const MAX_STEP_PHASE: f64 = 1.0;

/// The mechanics of a stage, advanced in fixed steps under a held motor force.
///
/// One step is second order: the velocity of the step's middle comes from the forces at its start;
/// the bristles move with it over the whole step, exactly; the velocity at the end takes the mean
/// elastic force of start and end, the exact impulse of the bristle damping, and everything else at
/// the middle; the position takes Simpson's rule over the three velocities. A step in which the
/// carriage reverses is done in two parts. Eight exponentials per step.
#[derive(Debug)]
pub struct Body {
    step: f64,
    /// Of the carriage with what always moves with it, kg.
    rest_mass: f64,
    /// As it moves now, kg.
    mass: f64,
    inverse_mass: f64,
    guides: GuideBank,
    guide_viscous: [f64; MAX_GUIDES],
    effects: Effects,
    /// Whether an effect changes the guides' laws or bristles, or they have a Stribeck curve of
    /// their own: a slower step then.
    shapes_friction: bool,
    /// Whether there is neither that nor an effect.
    is_plain: bool,
    /// Whether the mass is not always the same.
    changes_mass: bool,
    flexure: Option<Flexure>,
    stroke: Option<Stroke>,
    steps: u64,
    position: f64,
    velocity: f64,
    /// Force on the carriage from the motor side at the end of the last step, N: what the cell
    /// reads.
    cell_force: f64,
    motor_force: f64,
}

#[derive(Clone, Debug)]
struct Flexure {
    stiffness: f64,
    damping: f64,
    inverse_motor_mass: f64,
    motor_mass: f64,
    /// Motor position less carriage position, m, and its rate, m/s.
    stretch: f64,
    rate: f64,
}

/// What guides and effects do over a step.
struct StepForces {
    /// Momentum that the bristles take from the carriage, N s.
    friction_impulse: f64,
    /// Viscous friction beside it, N s/m.
    viscous_friction: f64,
    /// Force of the effects on the motor side and on the carriage side, N.
    motor_side: f64,
    carriage_side: f64,
}

impl StepForces {
    /// Without effects.
    #[inline]
    fn of_guides(guides: &mut GuideBank, velocity: f64, span: f64) -> StepForces {
        StepForces {
            friction_impulse: guides.advance(velocity, span),
            viscous_friction: guides.viscous_friction(),
            motor_side: 0.0,
            carriage_side: 0.0,
        }
    }
}

impl Body {
    /// A body at rest at position 0 with unloaded bristles; `step` in s.
    pub fn new(model: &StageModel, step: f64) -> Result<Body, ModelError> {
        model.check()?;
        let guides = model.resolved_guides()?;
        let effects = Effects::new(&model.effects)?;
        let mass = model.mass + effects.added_mass();
        let least_mass = mass + effects.least_mass().min(0.0);
        if least_mass <= 0.0 {
            let (key, value) = ("mass (with the effects' part)".to_owned(), least_mass);
            let limit = format!(
                "be greater than 0: effects take up to {} kg away, mass is {} kg",
                model.mass - least_mass,
                model.mass
            );
            return Err(ModelError::Value { key, value, limit });
        }
        let limit = largest_step(least_mass, effects.stiffness(), &guides, model);
        if !(step > 0.0 && step <= limit) {
            return Err(ModelError::Step { step, limit });
        }
        let bank = effects.bristle_elements().map_or_else(
            || GuideBank::new(&guides),
            |elements| GuideBank::with_elements(&guides, &elements),
        );
        let shapes_friction = effects.shapes_friction() || bank.is_shaped();
        Ok(Body {
            step,
            rest_mass: mass,
            mass,
            inverse_mass: mass.recip(),
            guide_viscous: std::array::from_fn(|lane| {
                guides.get(lane).map_or(0.0, |guide| guide.viscous_friction)
            }),
            guides: bank,
            shapes_friction,
            is_plain: effects.is_empty() && !shapes_friction,
            changes_mass: effects.changes_mass(),
            effects,
            flexure: model.coupling.as_ref().map(|coupling| Flexure {
                stiffness: coupling.stiffness,
                damping: coupling.damping,
                inverse_motor_mass: coupling.motor_mass.recip(),
                motor_mass: coupling.motor_mass,
                stretch: 0.0,
                rate: 0.0,
            }),
            stroke: model.stroke,
            steps: 0,
            position: 0.0,
            velocity: 0.0,
            cell_force: 0.0,
            motor_force: 0.0,
        })
    }

    /// Advances by `steps` steps under the constant motor force, N.
    #[inline]
    pub fn advance(&mut self, motor_force: f64, steps: u32) {
        self.motor_force = motor_force;
        for _ in 0..steps {
            if self.changes_mass {
                self.weigh();
            }
            if self.flexure.is_none() {
                self.step_rigid(motor_force)
            } else {
                self.step_flexible(motor_force)
            }
            self.steps += 1;
        }
    }

    /// Takes the mass as it is at the start of a step. What joins it moves as the carriage does
    /// already.
    fn weigh(&mut self) {
        let motion = Motion {
            time: self.time(),
            position: self.position,
            velocity: self.velocity,
            ..Motion::default()
        };
        self.mass = self.rest_mass + self.effects.mass_along(&motion);
        self.inverse_mass = self.mass.recip();
    }

    #[inline]
    fn step_rigid(&mut self, motor_force: f64) {
        let mut push = motor_force + self.effects.last_total();
        push += self.stop_force(self.position, self.velocity);
        let acceleration = (push - self.guides.start_force(self.velocity)) * self.inverse_mass;
        let end_velocity = self.velocity + self.step * acceleration;
        if self.velocity * end_velocity < 0.0 {
            self.reverse(
                motor_force,
                push,
                acceleration,
                self.step * self.velocity / (self.velocity - end_velocity),
            );
        } else {
            self.move_rigid(motor_force, acceleration, 0.0, self.step);
        }
    }

    /// A step in which the velocity changes its sign `before` seconds after its start, in two
    /// parts.
    ///
    /// The bristle's law has a corner at v = 0; a step across it leaves an error of second order
    /// whose size depends on where in the step the reversal falls.
    #[cold]
    fn reverse(&mut self, motor_force: f64, push: f64, acceleration: f64, before: f64) {
        self.move_rigid(motor_force, acceleration, 0.0, before);
        let acceleration = (push - self.guides.start_force(self.velocity)) * self.inverse_mass;
        self.move_rigid(motor_force, acceleration, before, self.step - before);
    }

    /// Moves the carriage over `span` seconds that begin `since` seconds after the start of the
    /// step.
    #[inline]
    fn move_rigid(&mut self, motor_force: f64, acceleration: f64, since: f64, span: f64) {
        let start_velocity = self.velocity;
        let middle_velocity = start_velocity + 0.5 * span * acceleration;
        let step = if self.is_plain {
            StepForces::of_guides(&mut self.guides, middle_velocity, span)
        } else {
            let step =
                self.step_with_effects(middle_velocity, acceleration, motor_force, since, span);
            self.effects.follow(motor_force + step.motor_side, span);
            step
        };
        let StepForces { friction_impulse, viscous_friction, motor_side, carriage_side } = step;
        let stop = self.stop_force(self.position + 0.5 * span * middle_velocity, middle_velocity);
        let carriage_side = carriage_side + stop;
        let force = motor_force + motor_side + carriage_side - viscous_friction * middle_velocity;
        // The impulse of the guides comes last: everything else is there before it.
        self.velocity = start_velocity + self.inverse_mass * span * force
            - self.inverse_mass * friction_impulse;
        // Simpson's rule over start, middle and end.
        self.position += span / 6.0 * (start_velocity + 4.0 * middle_velocity + self.velocity);
        self.cell_force = motor_force + motor_side;
    }

    fn step_flexible(&mut self, motor_force: f64) {
        let Some(mut flexure) = self.flexure.take() else { return };
        let half = 0.5 * self.step;
        let pull = flexure.stiffness * flexure.stretch + flexure.damping * flexure.rate;
        let (motor_side, carriage_side) = self.effects.last();
        let stop = self.stop_force(self.position, self.velocity);
        let carriage_start = (pull + carriage_side + stop - self.guides.start_force(self.velocity))
            * self.inverse_mass;
        let motor_start = (motor_force + motor_side - pull) * flexure.inverse_motor_mass;
        let middle_velocity = self.velocity + half * carriage_start;
        let middle_rate = flexure.rate + half * (motor_start - carriage_start);

        let StepForces { friction_impulse, viscous_friction, motor_side, carriage_side } =
            self.step_with_effects(middle_velocity, carriage_start, motor_force, 0.0, self.step);
        let stop = self.stop_force(self.position + half * middle_velocity, middle_velocity);
        let carriage_side = carriage_side + stop;
        let stretch = flexure.stretch + self.step * middle_rate;
        let pull =
            0.5 * flexure.stiffness * (flexure.stretch + stretch) + flexure.damping * middle_rate;
        let carriage_impulse = self.step
            * (pull + carriage_side - viscous_friction * middle_velocity)
            - friction_impulse;
        let motor_impulse = self.step * (motor_force + motor_side - pull);

        self.position += self.step * middle_velocity;
        let carriage_change = carriage_impulse * self.inverse_mass;
        self.velocity += carriage_change;
        flexure.rate += motor_impulse * flexure.inverse_motor_mass - carriage_change;
        flexure.stretch = stretch;
        self.cell_force = flexure.stiffness * flexure.stretch + flexure.damping * flexure.rate;
        self.effects.follow(self.cell_force, self.step);
        self.flexure = Some(flexure);
    }

    /// Force of the end stops along +x, N.
    #[inline]
    fn stop_force(&self, position: f64, velocity: f64) -> f64 {
        self.stroke.as_ref().map_or(0.0, |stroke| stroke.force(position, velocity))
    }

    /// Moves guides and effects over a span of `span` seconds that begins `since` seconds after the
    /// start of the step.
    #[inline(never)]
    fn step_with_effects(
        &mut self,
        velocity: f64,
        acceleration: f64,
        motor_force: f64,
        since: f64,
        span: f64,
    ) -> StepForces {
        let half = 0.5 * span;
        let motion = Motion {
            time: self.time() + since + half,
            position: self.position + half * velocity,
            velocity,
            acceleration,
            motor_force,
            friction: 0.0,
        };
        let mut step = if self.shapes_friction {
            let friction = self.guides.start_force(self.velocity);
            let scale = self.effects.friction(&Motion { friction, ..motion }, span);
            StepForces {
                friction_impulse: self.guides.advance_scaled(velocity, span, &scale),
                viscous_friction: scale.viscous * self.guides.viscous_friction(),
                motor_side: 0.0,
                carriage_side: 0.0,
            }
        } else {
            StepForces::of_guides(&mut self.guides, velocity, span)
        };
        (step.motor_side, step.carriage_side) = self.effects.advance(&motion, span);
        step
    }

    /// Sets position (m), velocity (m/s) and bristle deflections (m); lanes beyond `bristles` stay.
    pub fn set_state(&mut self, position: f64, velocity: f64, bristles: &[f64]) {
        self.position = position;
        self.velocity = velocity;
        self.guides.set_bristles(bristles, velocity);
    }

    /// Position 0, at rest, bristles and flexure unloaded, effects as at the start; time goes on.
    pub fn reset(&mut self) {
        self.set_state(0.0, 0.0, &[0.0; MAX_GUIDES]);
        if let Some(flexure) = &mut self.flexure {
            (flexure.stretch, flexure.rate) = (0.0, 0.0);
        }
        self.effects.reset(self.time());
        (self.cell_force, self.motor_force) = (0.0, 0.0);
    }

    /// True position of the carriage, m.
    pub fn position(&self) -> f64 {
        self.position
    }

    /// True velocity of the carriage, m/s.
    pub fn velocity(&self) -> f64 {
        self.velocity
    }

    /// Time since construction, s.
    pub fn time(&self) -> f64 {
        self.steps as f64 * self.step
    }

    /// Force in the coupling between motor and carriage, N, positive where it pushes the carriage
    /// along +x.
    pub fn cell_force(&self) -> f64 {
        self.cell_force
    }

    /// Motor force of the last step, N, without effects.
    pub fn motor_force(&self) -> f64 {
        self.motor_force
    }

    /// Acceleration of the carriage at the end of the last step, m/s^2.
    pub fn acceleration(&self) -> f64 {
        let (motor_side, carriage_side) = self.effects.last();
        let push =
            if self.flexure.is_some() { self.cell_force } else { self.motor_force + motor_side };
        let stop = self.stop_force(self.position, self.velocity);
        (push + carriage_side + stop - self.guides.force(self.velocity)) * self.inverse_mass
    }

    /// The guides with their bristles.
    pub fn guides(&self) -> &GuideBank {
        &self.guides
    }

    /// Friction of each guide on the carriage, N, positive against positive motion; zero in lanes
    /// without a guide.
    pub fn guide_forces(&self) -> [f64; MAX_GUIDES] {
        self.guides.forces(self.velocity, &self.guide_viscous)
    }

    /// The effects with the forces of the last step.
    pub fn effects(&self) -> &Effects {
        &self.effects
    }

    /// Kinetic and stored energy, J: carriage, motor body, flexure, bristles, effects.
    pub fn energy(&self) -> f64 {
        let bodies = 0.5 * self.mass * self.velocity * self.velocity
            + self.flexure.as_ref().map_or(0.0, |flexure| {
                let motor_velocity = self.velocity + flexure.rate;
                0.5 * flexure.motor_mass * motor_velocity * motor_velocity
                    + 0.5 * flexure.stiffness * flexure.stretch * flexure.stretch
            });
        let stops = self.stroke.as_ref().map_or(0.0, |stroke| {
            0.5 * stroke.stiffness * stroke.penetration(self.position).powi(2)
        });
        bodies + stops + self.guides.stored_energy() + self.effects.stored_energy(self.position)
    }

    /// Power turned into heat by guides and flexure, W.
    pub fn dissipated_power(&self) -> f64 {
        let flexure = self
            .flexure
            .as_ref()
            .map_or(0.0, |flexure| flexure.damping * flexure.rate * flexure.rate);
        self.guides.dissipated_power(self.velocity) + flexure
    }

    /// Velocity at which the motor force does work, m/s.
    pub fn motor_velocity(&self) -> f64 {
        self.velocity + self.flexure.as_ref().map_or(0.0, |flexure| flexure.rate)
    }
}

/// Largest step for which the explicit carriage and flexure steps are stable with a margin, s;
/// `effects` is their stiffness, N/m.
fn largest_step(mass: f64, effects: f64, guides: &[Guide], model: &StageModel) -> f64 {
    let (stop_stiffness, stop_damping) =
        model.stroke.map_or((0.0, 0.0), |stroke| (stroke.stiffness, stroke.damping));
    let damping: f64 = stop_damping
        + guides.iter().map(|guide| guide.bristle_damping + guide.viscous_friction).sum::<f64>();
    let stiffness: f64 =
        effects + stop_stiffness + guides.iter().map(|guide| guide.stiffness).sum::<f64>();
    let flexure = model.coupling.as_ref().map_or((0.0, 0.0), |coupling| {
        let inverse_mass = mass.recip() + coupling.motor_mass.recip();
        (coupling.stiffness * inverse_mass, coupling.damping * inverse_mass)
    });
    let frequency = (stiffness / mass + flexure.0).sqrt();
    (MAX_STEP_PHASE / frequency).min(MAX_STEP_DAMPING / (damping / mass + flexure.1))
}
