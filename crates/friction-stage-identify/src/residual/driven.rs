//! What guides, effects and sensors do along a recorded motion, in parts. A part depends on a few
//! values of a hypothesis; where these are as they were, it is taken over, so that a derivative
//! costs no more than what its coordinate moves.

use std::sync::Arc;

use rayon::prelude::*;

use friction_stage_core::model::{Guide, MAX_GUIDES, ModelError};
use friction_stage_core::plant::effects::{CommandStage, Effects, FrictionTerms, Role};
use friction_stage_core::plant::{
    BRISTLE_PARAMETERS, BristleSlopes, FrictionScale, GuideBank, Motion, Side,
};

use crate::hypothesis::{Hypothesis, Part, Sides};
use crate::record::measured::{Measured, Step};
use crate::residual::slipping::Slipping;

/// Guides, effects and sensors of one hypothesis along one record.
#[derive(Clone, Debug, Default)]
pub(crate) struct Driven {
    moved: Arc<Moved>,
    cell: Arc<CellTruth>,
    friction: Option<Friction>,
    forces: Vec<Arc<Force>>,
    /// What balls that slip add to the carriage side.
    slipping: Option<Arc<Slipping>>,
    /// kg
    added_mass: f64,
    moving: Arc<MovingMass>,
}

/// The motion behind what the encoder reads.
#[derive(Debug, Default)]
struct Moved {
    /// What it reads wrong.
    sensors: Vec<Part>,
    /// What makes the command late that shakes the carriage at rest.
    lags: Vec<Part>,
    /// Where it is not the motion as measured.
    steps: Option<Vec<Step>>,
    /// What the encoder reads too much at the samples, m; empty where it reads right.
    errors: Vec<f64>,
}

/// The force behind what a force cell reads that is wrong.
#[derive(Debug, Default)]
struct CellTruth {
    sensors: Vec<Part>,
    /// Where the cell reads wrong, N.
    forces: Option<Vec<f64>>,
}

/// Mass that is not always there.
#[derive(Debug, Default)]
struct MovingMass {
    parts: Vec<Part>,
    /// At the nodes, kg; empty where there is none.
    at_nodes: Vec<f64>,
}

impl MovingMass {
    fn new(parts: Vec<Part>, measured: &Measured, moved: &Moved) -> Result<MovingMass, ModelError> {
        if parts.is_empty() {
            return Ok(MovingMass::default());
        }
        let effects = effects_of(&parts)?;
        let at = |k: usize| {
            let (position, velocity) = moved.at_sample(measured, k);
            effects.mass_along(&Motion {
                time: measured.time[k],
                position,
                velocity,
                ..Motion::default()
            })
        };
        Ok(MovingMass { at_nodes: (0..measured.len()).map(at).collect(), parts })
    }
}

impl Moved {
    fn steps<'a>(&'a self, measured: &'a Measured) -> &'a [Step] {
        self.steps.as_deref().unwrap_or(&measured.steps)
    }

    /// True position and velocity at a sample, m and m/s.
    fn at_sample(&self, measured: &Measured, k: usize) -> (f64, f64) {
        let apparent = match self.errors.get(k.saturating_sub(1)..k + 2) {
            Some([before, _, after]) => 0.5 * (after - before) * measured.rate,
            _ => 0.0,
        };
        let error = self.errors.get(k).copied().unwrap_or(0.0);
        (measured.position[k] - error, measured.velocity[k] - apparent)
    }
}

/// Friction of all guides, in two parts: bristles know nothing of what is viscous.
#[derive(Clone, Debug)]
struct Friction {
    bristles: Arc<Bristles>,
    viscous: Arc<Viscous>,
    /// Sum of sigma2, N s/m.
    coefficient: f64,
}

/// What the bristles of all guides give.
#[derive(Debug)]
struct Bristles {
    /// Without viscous friction.
    guides: Vec<Guide>,
    laws: Vec<Part>,
    /// Over each step, and as means at the nodes, N.
    over_steps: Vec<f64>,
    at_nodes: Vec<f64>,
}

/// How friction changes along a direction in the parameters of the guides.
pub(crate) struct FrictionSensitivity {
    /// Of the bristles, at the nodes and over each step, N; the latter only where a viscous
    /// friction feels them.
    pub at_nodes: Vec<f64>,
    pub over_steps: Vec<f64>,
}

/// Viscous friction of guides with a sigma2 of 1 N s/m in all.
#[derive(Debug)]
struct Viscous {
    laws: Vec<Part>,
    /// Of laws that feel the friction: that of which bristles, and how much of this one.
    felt: Option<(Arc<Bristles>, f64)>,
    /// Means at the nodes, N.
    at_nodes: Vec<f64>,
}

/// Force of one effect, or of all that make the motor's force of its command: each of these hangs
/// on those before it.
#[derive(Debug)]
pub(crate) struct Force {
    parts: Vec<Part>,
    side: Side,
    /// Mean over the two intervals around a sample, N.
    pub at_nodes: Vec<f64>,
    /// Of the motor side: at the samples, where the cell reads, N.
    at_samples: Vec<f64>,
}

impl Force {
    pub fn side(&self) -> Side {
        self.side
    }

    /// What the cell reads of it, as the measured cell stands at the nodes: mean of both ends of
    /// the interval behind sample `k`.
    pub fn read_at(&self, k: usize) -> f64 {
        self.at_samples.get(k + 1).map_or(0.0, |next| 0.5 * (self.at_samples[k] + next))
    }
}

impl Moved {
    fn new(sensors: Vec<Part>, lags: Vec<Part>, measured: &Measured) -> Result<Moved, ModelError> {
        let effects = effects_of(&sensors)?;
        let compliance = effects.encoder_compliance();
        // By how much an encoder on the motor is ahead of the carriage at a sample: of what has
        // acted until then; before the first one that was the same (assumed).
        let ahead: Vec<f64> = (0..measured.len())
            .map(|k| compliance * measured.raw_command[k.saturating_sub(1)])
            .collect();
        // As the encoder says, or as the command says where it comes late.
        let steps = if lags.is_empty() && compliance == 0.0 {
            None
        } else {
            let late = force(lags.clone(), measured, &Moved::default())?;
            let arriving: Vec<f64> = measured
                .command
                .iter()
                .zip(&late.at_nodes)
                .map(|(command, late)| command + late)
                .collect();
            let behind = |(read, by): (&f64, &f64)| read - by;
            let elsewhere = (compliance != 0.0)
                .then(|| measured.position.iter().zip(&ahead).map(behind).collect());
            Some(measured.moved_by(elsewhere, &arriving).1)
        };
        if sensors.is_empty() {
            return Ok(Moved { sensors, lags, steps, errors: Vec::new() });
        }
        // What the encoder reads wrong is no motion: neither the mass nor the guides feel it.
        let error = |time: f64, reading: f64| {
            reading - undo(reading, |position| effects.read(time, position, 0.0).0)
        };
        let mut errors = ahead.clone();
        let mut corrected = steps.clone().unwrap_or_else(|| measured.steps.clone());
        let mut at_end = error(measured.time[0], measured.position[0] - ahead[0]);
        errors[0] += at_end;
        for step in &mut corrected {
            let motion = &mut step.motion;
            // Each step begins where the one before it ended.
            let from = at_end;
            at_end = error(motion.time, motion.position + 0.5 * motion.velocity * step.duration);
            errors[step.node + 1] = ahead[step.node + 1] + at_end;
            motion.position -= 0.5 * (from + at_end);
            motion.velocity -= (at_end - from) / step.duration;
            step.sliding -= (at_end - from) / step.duration;
        }
        let moves_as_read = errors.iter().all(|error| *error == 0.0);
        let (steps, errors) =
            if moves_as_read { (steps, Vec::new()) } else { (Some(corrected), errors) };
        Ok(Moved { sensors, lags, steps, errors })
    }
}

impl CellTruth {
    fn new(sensors: Vec<Part>, measured: &Measured) -> Result<CellTruth, ModelError> {
        if sensors.is_empty() {
            return Ok(CellTruth::default());
        }
        let effects = effects_of(&sensors)?;
        let truth = |(time, reading): (&f64, &f64)| {
            undo(*reading, |force| effects.read(*time, 0.0, force).1)
        };
        let forces = measured.cell.as_ref().map(|cell| {
            let mut forces: Vec<f64> = measured.time.iter().zip(cell).map(truth).collect();
            effects.made_up_for(&mut forces, measured.rate.recip());
            forces
        });
        Ok(CellTruth { sensors, forces })
    }
}

impl Driven {
    /// Force of the cell at the nodes without what it reads wrong, N; `None` where there is no
    /// cell.
    pub fn cell<'a>(&'a self, measured: &'a Measured) -> Option<&'a [f64]> {
        self.cell.forces.as_deref().or(measured.cell.as_deref())
    }

    /// Apparent acceleration from the encoder at a sample other than the first and the last, m/s^2.
    pub fn apparent_acceleration(&self, k: usize, rate: f64) -> f64 {
        match self.moved.errors.get(k.saturating_sub(1)..k + 2) {
            Some([before, here, after]) => (after - 2.0 * here + before) * rate * rate,
            _ => 0.0,
        }
    }

    /// Parts of the guides' friction at the nodes with what each is to be multiplied by, N; none
    /// where the carriage side was not asked for.
    pub fn friction(&self) -> impl Iterator<Item = (&[f64], f64)> {
        self.friction.iter().flat_map(Friction::parts)
    }

    pub fn forces(&self) -> impl Iterator<Item = &Force> {
        self.forces.iter().map(Arc::as_ref)
    }

    /// Takes out of a force of the carriage side at the rows, N, what this record has for itself.
    pub fn take_out_own(&self, carriage: &mut [f64]) {
        if let Some(slipping) = &self.slipping {
            slipping.take_from(carriage);
        }
    }

    /// A force of the carriage side at the nodes, N, as the missing force has it at the rows: with
    /// nothing at both ends, where there is no second difference.
    pub fn at_rows(&self, mut at_nodes: Vec<f64>, measured: &Measured) -> Vec<f64> {
        let last = at_nodes.len() - 1;
        (at_nodes[0], at_nodes[last]) = (0.0, 0.0);
        let mut at_rows = measured.filtered(&at_nodes);
        self.take_out_own(&mut at_rows);
        at_rows
    }

    /// The steps of the true motion.
    pub fn steps<'a>(&'a self, measured: &'a Measured) -> &'a [Step] {
        self.moved.steps(measured)
    }

    /// Friction of all guides at the nodes, N; `None` where a law beside them feels it, or the
    /// carriage side was not asked for.
    pub fn friction_at_nodes(&self) -> Option<Vec<f64>> {
        let friction = self.friction.as_ref().filter(|friction| friction.viscous.felt.is_none())?;
        Some(friction.at_nodes())
    }

    /// Mass that moves with the carriage at a node beyond that of the model, kg.
    pub fn added_mass(&self, node: usize) -> f64 {
        self.added_mass + self.moving.at_nodes.get(node).copied().unwrap_or(0.0)
    }

    /// How the friction of the bristles changes along these directions, each by how much the
    /// logarithms of the parameters grow, by parameter and guide. `None` where the carriage side
    /// was not asked for.
    pub fn friction_sensitivities(
        &self,
        directions: &[[[f64; MAX_GUIDES]; BRISTLE_PARAMETERS]],
        measured: &Measured,
    ) -> Result<Option<Vec<FrictionSensitivity>>, ModelError> {
        let Some(Friction { bristles, viscous, .. }) = &self.friction else { return Ok(None) };
        let steps = self.moved.steps(measured);
        let held = held_at_start(measured);
        let mut of_parameters =
            BristleSlopes::new(sensitivities_of_holding(&bristles.guides, held));
        let is_felt = viscous.felt.is_some();
        let sensitivity = |_: &_| FrictionSensitivity {
            at_nodes: vec![0.0; measured.len()],
            over_steps: Vec::with_capacity(if is_felt { steps.len() } else { 0 }),
        };
        let mut sensitivities: Vec<FrictionSensitivity> =
            directions.iter().map(sensitivity).collect();
        drive(&bristles.guides, &bristles.laws, measured, steps, |bank, step, scale| {
            bank.drive_with_slopes(step.sliding, step.duration, scale, &mut of_parameters);
            for (sensitivity, direction) in sensitivities.iter_mut().zip(directions) {
                let friction = of_parameters.along(direction, step.duration);
                step.share_out(friction, &mut sensitivity.at_nodes);
                if is_felt {
                    sensitivity.over_steps.push(friction);
                }
            }
        })?;
        Ok(Some(sensitivities))
    }

    /// How the viscous friction at the nodes changes, N, where it feels that of the bristles over
    /// the steps change by `sensitivity`, N; `step`: part of that which a difference quotient goes.
    /// `None` where it feels nothing.
    pub fn felt_sensitivity(
        &self,
        sensitivity: &[f64],
        step: f64,
        measured: &Measured,
    ) -> Result<Option<Vec<f64>>, ModelError> {
        let Some(Friction { bristles, viscous, .. }) = &self.friction else { return Ok(None) };
        let Some((_, coefficient)) = viscous.felt else { return Ok(None) };
        let over_steps: Vec<f64> = bristles
            .over_steps
            .iter()
            .zip(sensitivity)
            .map(|(friction, sensitivity)| friction + step * sensitivity)
            .collect();
        let steps = self.moved.steps(measured);
        let there =
            viscous_friction(&viscous.laws, Some((&over_steps, coefficient)), measured, steps)?;
        let quotient = |(there, here): (&f64, &f64)| coefficient * (there - here) / step;
        Ok(Some(there.iter().zip(&viscous.at_nodes).map(quotient).collect()))
    }
}

impl Hypothesis {
    /// Along a record, for these sides. `before` is of the same record, or the default.
    pub(crate) fn driven(
        &self,
        measured: &Measured,
        sides: Sides,
        before: &Driven,
    ) -> Result<Driven, ModelError> {
        let added_mass = effects_of(&self.effects)?.added_mass();
        let of = |wanted: &dyn Fn(Role) -> bool| -> Vec<Part> {
            self.effects.iter().filter(|part| wanted(part.role())).cloned().collect()
        };
        let (of_encoder, of_cell) =
            (of(&|role| role == Role::Encoder), of(&|role| role == Role::ForceCell));
        let lags = of(&|role| role == Role::Command(CommandStage::Lag));
        let moved = match before.moved.sensors == of_encoder && before.moved.lags == lags {
            true => before.moved.clone(),
            false => Arc::new(Moved::new(of_encoder, lags, measured)?),
        };
        let cell = match before.cell.sensors == of_cell {
            true => before.cell.clone(),
            false => Arc::new(CellTruth::new(of_cell, measured)?),
        };
        let moves_alike = Arc::ptr_eq(&moved, &before.moved)
            || moved.steps.is_none() && before.moved.steps.is_none();
        let of_mass = of(&|role| role == Role::VaryingMass);
        let moving = match moves_alike && before.moving.parts == of_mass {
            true => before.moving.clone(),
            false => Arc::new(MovingMass::new(of_mass, measured, &moved)?),
        };
        let steps = moved.steps(measured);
        let friction = || -> Result<Option<Friction>, ModelError> {
            if !sides.carriage {
                return Ok(None);
            }
            let known = before.friction.as_ref().filter(|_| moves_alike);
            let of_bristles = of(&Role::shapes_bristles);
            let of_viscous = of(&|role| role.friction_terms().viscous);
            Friction::new(&self.guides(), of_bristles, of_viscous, measured, steps, known).map(Some)
        };
        let of_command = of(&|role| role.command_stage().is_some());
        let alone = self.effects.iter().filter(|part| part.role().is_force() && !part.slips());
        let mut of_forces: Vec<Vec<Part>> = alone.map(|part| vec![part.clone()]).collect();
        of_forces.extend((!of_command.is_empty()).then_some(of_command));
        let forces = of_forces.into_par_iter().map(|parts| {
            let known = before.forces.iter().find(|known| moves_alike && known.parts == parts);
            known.map_or_else(
                || Ok(Arc::new(force(parts, measured, &moved)?)),
                |known| Ok(known.clone()),
            )
        });
        let (friction, forces) =
            rayon::join(friction, || forces.collect::<Result<_, ModelError>>());
        let (friction, forces) = (friction?, forces?);
        let ripples: Vec<_> = match sides.carriage {
            true => self.effects.iter().filter_map(Part::slipping_ripple).collect(),
            false => Vec::new(),
        };
        let known = before.slipping.as_ref().filter(|known| known.ripples == ripples);
        let slipping = known.cloned().or_else(|| Slipping::new(ripples, measured).map(Arc::new));
        Ok(Driven { moved, cell, friction, forces, slipping, added_mass, moving })
    }
}

fn effects_of(parts: &[Part]) -> Result<Effects, ModelError> {
    Effects::from_values(parts.iter().map(|part| (part.descriptor, &part.values[..])))
}

/// Friction of the guides at the nodes without any law beside them, N.
pub(crate) fn friction(guides: &[Guide], measured: &Measured) -> Result<Vec<f64>, ModelError> {
    Ok(Friction::new(guides, Vec::new(), Vec::new(), measured, &measured.steps, None)?.at_nodes())
}

impl Friction {
    /// `known` is of the same motion.
    fn new(
        guides: &[Guide],
        of_bristles: Vec<Part>,
        of_viscous: Vec<Part>,
        measured: &Measured,
        steps: &[Step],
        known: Option<&Friction>,
    ) -> Result<Friction, ModelError> {
        let coefficient = guides.iter().map(|guide| guide.viscous_friction).sum();
        let bare: Vec<Guide> =
            guides.iter().map(|guide| Guide { viscous_friction: 0.0, ..guide.clone() }).collect();
        let bristles = match known.map(|known| &known.bristles) {
            Some(known) if known.guides == bare && known.laws == of_bristles => known.clone(),
            _ => Arc::new(Bristles::new(bare, of_bristles, measured, steps)?),
        };
        let is_felt = effects_of(&of_viscous)?.feel_friction();
        let felt = is_felt.then(|| (bristles.clone(), coefficient));
        let feels_alike = |known: &Viscous| match (&known.felt, &felt) {
            (Some((known, by)), Some((bristles, coefficient))) => {
                Arc::ptr_eq(known, bristles) && by == coefficient
            }
            (known, felt) => known.is_none() && felt.is_none(),
        };
        let viscous = match known.map(|known| &known.viscous) {
            Some(known) if known.laws == of_viscous && feels_alike(known) => known.clone(),
            _ => {
                let over_steps = felt
                    .as_ref()
                    .map(|(bristles, coefficient)| (&bristles.over_steps[..], *coefficient));
                let at_nodes = viscous_friction(&of_viscous, over_steps, measured, steps)?;
                Arc::new(Viscous { laws: of_viscous, felt, at_nodes })
            }
        };
        Ok(Friction { bristles, viscous, coefficient })
    }

    /// Of both parts together, N.
    fn at_nodes(&self) -> Vec<f64> {
        let [(bristles, one), (viscous, coefficient)] = self.parts();
        bristles
            .iter()
            .zip(viscous)
            .map(|(bristles, viscous)| one * bristles + coefficient * viscous)
            .collect()
    }

    /// At the nodes, with what each is to be multiplied by, N.
    fn parts(&self) -> [(&[f64], f64); 2] {
        [(&self.bristles.at_nodes, 1.0), (&self.viscous.at_nodes, self.coefficient)]
    }
}

impl Bristles {
    fn new(
        guides: Vec<Guide>,
        laws: Vec<Part>,
        measured: &Measured,
        steps: &[Step],
    ) -> Result<Bristles, ModelError> {
        let (mut over_steps, mut at_nodes) =
            (Vec::with_capacity(steps.len()), vec![0.0; measured.len()]);
        drive(&guides, &laws, measured, steps, |bank, step, scale| {
            let friction = bank.drive_each(step.sliding, step.duration, scale).iter().sum();
            step.share_out(friction, &mut at_nodes);
            over_steps.push(friction);
        })?;
        Ok(Bristles { guides, laws, over_steps, at_nodes })
    }
}

/// Viscous friction of guides with a sigma2 of 1 N s/m in all at the nodes, N. `felt`: what the
/// bristles give over each step, N, and the sum of sigma2, N s/m.
fn viscous_friction(
    laws: &[Part],
    felt: Option<(&[f64], f64)>,
    measured: &Measured,
    steps: &[Step],
) -> Result<Vec<f64>, ModelError> {
    let mut effects = effects_of(laws)?;
    let mut at_nodes = vec![0.0; measured.len()];
    let mut friction = 0.0;
    for (index, step) in steps.iter().enumerate() {
        let factor = if laws.is_empty() {
            1.0
        } else {
            let motion = Motion { velocity: step.sliding, friction, ..step.motion };
            effects.friction(&motion, step.duration).viscous
        };
        let viscous = factor * step.sliding;
        step.share_out(viscous, &mut at_nodes);
        if let Some((bristles, coefficient)) = felt {
            friction = bristles[index] + coefficient * viscous;
        }
    }
    Ok(at_nodes)
}

/// Takes the guides' bristles under these laws from step to step. They begin with what the motor
/// gives: at rest they hold it.
fn drive(
    guides: &[Guide],
    laws: &[Part],
    measured: &Measured,
    steps: &[Step],
    mut advance: impl FnMut(&mut GuideBank, &Step, &FrictionScale),
) -> Result<(), ModelError> {
    let mut effects = effects_of(laws)?;
    let mut bank = match effects.bristle_elements() {
        Some(elements) => GuideBank::with_elements(guides, &elements),
        None => GuideBank::new(guides),
    };
    bank.set_bristles(&holding(guides, held_at_start(measured)), 0.0);
    let is_scaled = effects.friction_terms() != FrictionTerms::NOTHING;
    for step in steps {
        let scale = if is_scaled {
            effects.friction(&Motion { velocity: step.sliding, ..step.motion }, step.duration)
        } else {
            FrictionScale::ONE
        };
        advance(&mut bank, step, &scale);
    }
    Ok(())
}

/// Force that the motor gives as a record begins, N.
fn held_at_start(measured: &Measured) -> f64 {
    let start = measured.cell.as_deref().unwrap_or(&measured.command);
    let end = ((0.01 * measured.rate) as usize + 2).min(measured.len() - 1);
    start[1..end].iter().sum::<f64>() / (end - 1) as f64
}

/// Deflections of bristles that hold this force at rest, m: each guide its part of what all can
/// hold, and no more than that.
pub(crate) fn holding(guides: &[Guide], force: f64) -> Vec<f64> {
    let most: f64 = guides.iter().map(|guide| guide.static_force).sum();
    let part = (force / most).clamp(-1.0, 1.0);
    guides.iter().map(|guide| part * guide.static_force / guide.stiffness).collect()
}

/// How these deflections change with the logarithms of the guides' parameters, m, those of all
/// guides at once: what each holds is its part of one force.
fn sensitivities_of_holding(
    guides: &[Guide],
    force: f64,
) -> [[f64; MAX_GUIDES]; BRISTLE_PARAMETERS] {
    let bristles = holding(guides, force);
    let is_all = force.abs() > guides.iter().map(|guide| guide.static_force).sum();
    let mut sensitivities = [[0.0; MAX_GUIDES]; BRISTLE_PARAMETERS];
    for (lane, bristle) in bristles.into_iter().enumerate() {
        sensitivities[BristleSlopes::STIFFNESS][lane] = -bristle;
        sensitivities[BristleSlopes::STATIC_FORCE][lane] = if is_all { bristle } else { 0.0 };
    }
    sensitivities
}

/// Force of effects of one side along the motion.
fn force(parts: Vec<Part>, measured: &Measured, moved: &Moved) -> Result<Force, ModelError> {
    let mut effects = effects_of(&parts)?;
    let steps = moved.steps(measured);
    let side = parts.first().map_or(Side::Carriage, Part::side);
    let read = side == Side::Motor;
    let mut at_nodes = vec![0.0; measured.len()];
    let mut at_samples = vec![0.0; if read { measured.len() } else { 0 }];
    for (index, step) in steps.iter().enumerate() {
        let node = step.node;
        step.share_out_over(effects.advance_long(&step.motion, step.duration), &mut at_nodes);
        let ends = steps.get(index + 1).is_none_or(|next| next.node != node);
        if read && ends {
            let (position, velocity) = moved.at_sample(measured, node + 1);
            let end = Motion { time: measured.time[node + 1], position, velocity, ..step.motion };
            let (motor_side, carriage_side) = effects.advance(&end, 0.0);
            at_samples[node + 1] = motor_side + carriage_side;
        }
    }
    Ok(Force { parts, side, at_nodes, at_samples })
}

/// The truth behind a reading, where read(truth) = reading: by secants (Press and others,
/// "Numerical Recipes", ch. 9.2) from the reading itself and from what is left of it without the
/// error that it has there. That error changes by less than the truth does.
fn undo(reading: f64, read: impl Fn(f64) -> f64) -> f64 {
    let (mut before, mut excess_before) = (reading, read(reading) - reading);
    let mut truth = before - excess_before;
    for _ in 0..MOST_TURNS {
        if (truth - before).abs() <= CLOSE * (1.0 + reading.abs()) {
            break;
        }
        let excess = read(truth) - reading;
        let slope = (excess - excess_before) / (truth - before);
        // Where rounding has made the slope what it cannot be, the error as it is.
        let step = if (LEAST_SLOPE..=2.0).contains(&slope) { excess / slope } else { excess };
        (before, excess_before) = (truth, excess);
        truth -= step;
    }
    truth
}

/// Turns to the truth behind a reading, and the change that ends them, m or N: below the encoder's
/// noise by far.
const MOST_TURNS: usize = 300;
const CLOSE: f64 = 1e-14;
/// Least slope of a reading over the truth.
const LEAST_SLOPE: f64 = 0.05;

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;
    use crate::hypothesis::Tolerances;
    use crate::test_records::{hypothesis, record, recording};
    use friction_stage_core::model::StageModel;
    use friction_stage_core::plant::EffectDescriptor;

    #[test]
    fn the_truth_behind_a_reading_is_found_however_wrong_it_is() {
        for gain in [-0.5, 0.2, 0.9] {
            let truth = undo(100.0 * (1.0 + gain), |force| force * (1.0 + gain));
            assert!((truth - 100.0).abs() < 1e-9, "gain {gain}: {truth}");
        }
        // 5 % of a signal period of 4 µm.
        let read = |x: f64| x + 2e-7 * (TAU * x / 4e-6).sin();
        assert!((undo(read(1.3e-6), read) - 1.3e-6).abs() < 1e-13);
    }

    /// A cell of a lowpass of 0.5 ms, or a latency of two samples, on a stage of the library.
    #[test]
    fn a_cell_that_is_late_leaves_nothing_with_its_law() {
        for values in [[5e-4, 0.0], [0.0, 1e-3]] {
            let law = EffectDescriptor::find("force_cell_lag").unwrap();
            let declared = StageModel::default().without_noise();
            let real = StageModel { effects: vec![law.parameters_of(&values)], ..declared.clone() };
            let trace = recording(&real, 1, 0.0, 2);
            let measured = Measured::new(&trace, &declared, "a record").unwrap();
            let bare = Hypothesis::new(&declared, Tolerances::default()).unwrap();
            let with = bare.with(Part { descriptor: law, values: values.to_vec() });
            let left = |one: &Hypothesis| one.missing(&measured, Sides::BOTH).unwrap().squares();
            let (before, after) = (left(&bare), left(&with));
            assert!(after.0 < 1e-4 * before.0, "motor {before:?} {after:?}");
            assert!(after.1 < 1e-2 * before.1, "carriage {before:?} {after:?}");
        }
    }

    #[test]
    fn a_force_acts_where_the_carriage_is_and_not_where_a_wrong_encoder_says() {
        let measured = record();
        let with = hypothesis(&[("cogging", &[2.0, 0.024, 0.7]), ("encoder_scale", &[0.02])]);
        let driven = with.driven(&measured, Sides::BOTH, &Driven::default()).unwrap();
        let cogging = driven.forces().next().unwrap();
        for k in (100..3900).step_by(97) {
            let at = |k: usize| 2.0 * (TAU * measured.position[k] / 1.02 / 0.024 + 0.7).sin();
            let read = 0.5 * (at(k) + at(k + 1));
            assert!((cogging.read_at(k) - read).abs() < 1e-6, "{k}: {} {read}", cogging.read_at(k));
            // Over a cycle the force changes by up to 0.1 N, and by its second difference less than
            // 1e-2 N.
            assert!(
                (cogging.at_nodes[k] - at(k)).abs() < 1e-2,
                "{k}: {} {}",
                cogging.at_nodes[k],
                at(k)
            );
        }
    }

    /// A part that is taken over is the one that would have come out.
    #[test]
    fn what_a_changed_value_does_not_move_is_as_if_worked_out_again() {
        let measured = record();
        let start = hypothesis(&[
            ("cogging", &[2.0, 0.024, 0.7]),
            ("viscous_warm_up", &[0.3, 1.0, 20.0, 3.0, 10.0, 5.0]),
            ("distributed_bristles", &[0.45, 0.04, 0.3, 0.16, 0.15, 0.3, 1.8, 0.0]),
            ("encoder_scale", &[0.02]),
            ("force_cell_gain", &[0.01]),
        ])
        .different_guides()
        .unwrap();
        let before = start.driven(&measured, Sides::BOTH, &Driven::default()).unwrap();
        let coordinates = start.coordinates(Sides::BOTH, true);
        assert!(coordinates.len() > 25, "{}", coordinates.len());
        let mut kept = (0, 0);
        for coordinate in coordinates {
            let mut moved = start.clone();
            moved.set(coordinate.id, coordinate.value + 1e-2 * coordinate.scale);
            let after = moved.driven(&measured, Sides::BOTH, &before).unwrap();
            let again = moved.driven(&measured, Sides::BOTH, &Driven::default()).unwrap();
            let [after_all, again_all] = [&after, &again]
                .map(|driven| moved.missing_at_samples(driven, &measured, Sides::BOTH));
            assert_eq!(after_all.motor, again_all.motor, "{:?}", coordinate.id);
            assert_eq!(after_all.carriage, again_all.carriage, "{:?}", coordinate.id);
            let [after, before] = [&after, &before].map(|driven| driven.friction.as_ref().unwrap());
            kept.0 += usize::from(Arc::ptr_eq(&after.bristles, &before.bristles));
            kept.1 += usize::from(Arc::ptr_eq(&after.viscous, &before.viscous));
        }
        // Mass, shift of the sensors, gain of the cell, and the three values of the cogging leave
        // the friction alone; sigma2 and the three values of the warm-up leave the bristles alone.
        assert_eq!(kept, (10, 6));
    }
}
