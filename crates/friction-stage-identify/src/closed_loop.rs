//! Position error in closed loop: the model under the recorded setpoint and the recorded
//! controller, beside the recorded encoder.
//!
//! The controller is not declared anywhere, but the recording shows what it read and what it
//! answered. If it is linear, its force obeys u(k) = sum a_i u(k-i) + sum b_i e(k-i) + sum c_i
//! v_ref(k+1-i) + sum d_i a_ref(k+1-i), e = reference - encoder, and least squares finds the
//! coefficients. Whether that is the controller is not judged by this fit, which sees each past
//! force, but by letting the found controller run freely on the recorded errors.

use nalgebra::{DMatrix, DVector};

use crate::residual::driven::holding;
use friction_stage_core::model::{ModelError, StageModel};
use friction_stage_core::numerics::linear::least_norm;
use friction_stage_core::plant::effects::Effects;
use friction_stage_core::plant::{EffectDescriptor, Rates, RatesError, Stage};
use friction_stage_data::signals::Trace;

/// Past forces: a PID (integrator, derivative filter) behind a second-order lowpass has three.
const PAST: usize = 3;
/// Errors of now and before; reference velocities and accelerations of the next sample, of now and
/// before.
const INPUTS: usize = 5;
/// Part of the largest singular value, of columns of length 1, below which the recording does not
/// tell coefficients apart.
const RANK: f64 = 1e-12;
/// Rows of the least squares that are taken at once.
const ROWS_AT_ONCE: usize = 4096;
/// Largest rms of the found controller's own force less the recorded one, as a share of the
/// recorded rms, with which it counts as found.
const FAITHFUL: f64 = 0.01;

/// Samples without a position in a row over which the simulated stage goes on: behind more of them
/// it begins again. Assumed: the setpoint is as unknown there.
const LONGEST_BRIDGED: usize = 3;

/// Why there is no closed-loop position error. The message of each variant says what it is.
#[expect(missing_docs, reason = "the message of each says what its fields are")]
#[derive(Debug, thiserror::Error)]
pub enum ClosedLoopError {
    #[error("there is no setpoint")]
    NoSetpoint,
    #[error("there is no force command")]
    NoCommand,
    #[error(
        "only {rows} samples have setpoint, encoder and command in a row, at least {least} are \
         needed"
    )]
    TooFew { rows: usize, least: usize },
    #[error(
        "the controller cannot be worked out from the record: the best linear one of order {PAST} \
         misses {} of the command, at most {:.0} % would do",
        missed(*share), 100.0 * FAITHFUL
    )]
    NotLinear { share: f64 },
    #[error("the simulated loop does not stay finite")]
    Unstable,
    #[error(transparent)]
    Rates(#[from] RatesError),
    #[error(transparent)]
    Model(#[from] ModelError),
}

/// A share in words: of a setpoint that is elsewhere it may be any number.
fn missed(share: f64) -> String {
    match share {
        share if share < 0.1 => format!("{:.2} %", 100.0 * share),
        share if share < 10.0 => format!("{:.0} %", 100.0 * share),
        _ => "many times all".to_owned(),
    }
}

/// The recorded controller as a linear difference equation.
#[derive(Clone, Debug, PartialEq)]
pub struct LinearController {
    /// Of u(k-1) ...
    past: [f64; PAST],
    /// Of e at k, k-1 ..., and of v_ref and a_ref at k+1, k ...
    inputs: [[f64; INPUTS]; 3],
    /// Force beyond which the recorded controller does not go, N.
    limit: f64,
}

/// What the controller is to follow, at the rows of a trace.
pub(crate) struct Setpoint {
    position: Vec<f64>,
    velocity: Vec<f64>,
    acceleration: Vec<f64>,
}

impl Setpoint {
    pub(crate) fn of(trace: &Trace) -> Result<Setpoint, ClosedLoopError> {
        let absent = |values: &[f64]| values.iter().all(|value| value.is_nan());
        if absent(&trace.reference_position) {
            return Err(ClosedLoopError::NoSetpoint);
        }
        // Where a recording has the position only, the rest follows from it.
        let step = trace.step();
        let derivative = |values: &[f64]| -> Vec<f64> {
            let last = values.len() - 1;
            (0..=last)
                .map(|row| {
                    let (before, after) = (row.saturating_sub(1), (row + 1).min(last));
                    (values[after] - values[before]) / ((after - before).max(1) as f64 * step)
                })
                .collect()
        };
        let position = trace.reference_position.clone();
        let or_derivative = |values: &[f64], of: &[f64]| {
            if absent(values) { derivative(of) } else { values.to_vec() }
        };
        let velocity = or_derivative(&trace.reference_velocity, &position);
        let acceleration = or_derivative(&trace.reference_acceleration, &velocity);
        Ok(Setpoint { position, velocity, acceleration })
    }

    /// Error of now; velocity and acceleration of the next sample, because a feedforward may look
    /// that far ahead.
    pub(crate) fn inputs(&self, row: usize, position: f64) -> [f64; 3] {
        let ahead = (row + 1).min(self.position.len() - 1);
        [self.position[row] - position, self.velocity[ahead], self.acceleration[ahead]]
    }
}

impl LinearController {
    /// The controller that made the commands of a recording.
    pub fn fit(trace: &Trace) -> Result<LinearController, ClosedLoopError> {
        let setpoint = Setpoint::of(trace)?;
        if trace.force.iter().all(|force| force.is_nan()) {
            return Err(ClosedLoopError::NoCommand);
        }
        let inputs: Vec<[f64; 3]> =
            (0..trace.len()).map(|row| setpoint.inputs(row, trace.position[row])).collect();
        let largest = trace
            .force
            .iter()
            .copied()
            .filter(|f| f.is_finite())
            .fold(0.0, |most: f64, f| most.max(f.abs()));
        // A force that is the largest one again and again is a limit, and what the controller
        // wanted there is not recorded.
        let often = trace.force.iter().filter(|force| force.abs() == largest).count();
        let limit = if often > 2 { largest } else { f64::INFINITY };
        let first = INPUTS.max(PAST + 1) - 1;
        let fine = |row: &usize| {
            (row - first..=*row).all(|row| {
                trace.force[row].is_finite()
                    && trace.force[row].abs() < limit
                    && inputs[row].iter().all(|value| value.is_finite())
            })
        };
        let rows: Vec<usize> = (first..trace.len()).filter(fine).collect();
        let unknowns = PAST + 3 * INPUTS;
        let least = 20 * unknowns;
        if rows.len() < least {
            return Err(ClosedLoopError::TooFew { rows: rows.len(), least });
        }
        // The last column is what they are to give.
        let entry = |row: usize, column: usize| match column.checked_sub(PAST) {
            None => trace.force[row - 1 - column],
            Some(input) if input < 3 * INPUTS => inputs[row - input % INPUTS][input / INPUTS],
            Some(_) => trace.force[row],
        };
        // Orthogonal throughout: neighbouring samples are nearly the same, and normal equations
        // would square that. Every row: feedforwards that are alike along a motion differ in the
        // few where one starts.
        let mut triangle = DMatrix::zeros(0, unknowns + 1);
        for some in rows.chunks(ROWS_AT_ONCE) {
            let above = triangle.nrows();
            let stacked = DMatrix::from_fn(above + some.len(), unknowns + 1, |row, column| {
                if row < above { triangle[(row, column)] } else { entry(some[row - above], column) }
            });
            triangle = stacked.qr().r();
        }
        let matrix = triangle.view((0, 0), (unknowns, unknowns)).into_owned();
        let top: DVector<f64> = triangle.view((0, unknowns), (unknowns, 1)).column(0).into_owned();
        let Some(solution) = least_norm(matrix, &top, RANK) else {
            return Err(ClosedLoopError::NotLinear { share: 1.0 });
        };
        let found = |column: usize| solution[column];
        Ok(LinearController {
            past: std::array::from_fn(found),
            inputs: std::array::from_fn(|input| {
                std::array::from_fn(|lag| found(PAST + input * INPUTS + lag))
            }),
            limit,
        })
    }

    /// Rms of the force that this controller gives on the recorded errors, running freely, less the
    /// recorded one, as a share of the rms of the recorded one.
    pub fn share_missed(&self, trace: &Trace) -> Result<f64, ClosedLoopError> {
        let setpoint = Setpoint::of(trace)?;
        let mut running = Running::new(self);
        let (mut missed, mut all) = (0.0, 0.0);
        for row in 0..trace.len() {
            let recorded = trace.force[row];
            let force = running.force(setpoint.inputs(row, trace.position[row]), recorded);
            if recorded.is_finite() && force.is_finite() {
                missed += (force - recorded).powi(2);
                all += recorded * recorded;
            }
        }
        Ok(if all > 0.0 && missed.is_finite() { (missed / all).sqrt() } else { f64::INFINITY })
    }
}

/// A controller with its memory.
pub(crate) struct Running<'a> {
    controller: &'a LinearController,
    past: [f64; PAST],
    inputs: [[f64; 3]; INPUTS],
    /// Samples in a row for which everything is known.
    known: usize,
}

impl Running<'_> {
    pub(crate) fn new(controller: &LinearController) -> Running<'_> {
        Running { controller, past: [0.0; PAST], inputs: [[0.0; 3]; INPUTS], known: 0 }
    }

    /// The force for these inputs. While the memory fills, at the start and behind a gap, it is the
    /// recorded one.
    pub(crate) fn force(&mut self, inputs: [f64; 3], recorded: f64) -> f64 {
        self.inputs.rotate_right(1);
        self.inputs[0] = inputs;
        if !inputs.iter().all(|value| value.is_finite()) {
            self.known = 0;
        }
        let force = if self.known < INPUTS {
            recorded
        } else {
            let past: f64 = self.controller.past.iter().zip(&self.past).map(|(a, u)| a * u).sum();
            let driven: f64 = (0..3)
                .map(|input| {
                    (0..INPUTS)
                        .map(|lag| self.controller.inputs[input][lag] * self.inputs[lag][input])
                        .sum::<f64>()
                })
                .sum();
            (past + driven).clamp(-self.controller.limit, self.controller.limit)
        };
        self.known = if force.is_finite() && inputs.iter().all(|value| value.is_finite()) {
            self.known + 1
        } else {
            0
        };
        self.past.rotate_right(1);
        self.past[0] = force;
        force
    }
}

/// Finds the recorded controller of `train` and checks it on every record.
pub fn controller_of(
    train: &Trace,
    records: &[&Trace],
) -> Result<LinearController, ClosedLoopError> {
    let controller = LinearController::fit(train)?;
    for record in records {
        let share = controller.share_missed(record)?;
        if share.is_nan() || share > FAITHFUL {
            return Err(ClosedLoopError::NotLinear { share });
        }
    }
    Ok(controller)
}

/// Encoder reading of the simulated loop less the recorded one at each row, m; NaN where the
/// recording has none. The stage is that of the model without sensor noise and without ripples
/// whose phase the model does not know; setpoint and controller are the recorded ones.
pub fn position_error(
    model: &StageModel,
    trace: &Trace,
    controller: &LinearController,
) -> Result<Vec<f64>, ClosedLoopError> {
    let setpoint = Setpoint::of(trace)?;
    let count = trace.len();
    if count < 2 {
        return Err(ClosedLoopError::TooFew { rows: count, least: 2 });
    }
    let rate = (count - 1) as f64 / (trace.time[count - 1] - trace.time[0]);
    // A grid of whole nanoseconds misses a whole number of hertz by its rounding.
    let rate = if (rate - rate.round()).abs() < 1e-5 * rate { rate.round() } else { rate };
    let rates = Rates::of_control(rate)?;
    let mut quiet = model.clone().without_noise();
    // An effect that is not possible is for the stage to refuse.
    quiet.effects.retain(|effect| {
        !EffectDescriptor::read(effect)
            .is_ok_and(|(descriptor, values)| descriptor.slipping_ripple(&values).is_some())
    });
    // The recorded command is what the controller gave; the model's own limit would cut it where
    // the machine did not.
    quiet.motor.force_limit = quiet.motor.force_limit.max(largest(&trace.force));
    let mut stage = Stage::new(&quiet, rates, 0)?;
    let start = trace.position.iter().copied().find(|x| x.is_finite()).unwrap_or(0.0);
    let sensors = Effects::new(&quiet.effects)?;
    // At rest the guides hold what the motor gives: what the cell reads where there is one, without
    // what it reads wrong.
    let guides = quiet.resolved_guides()?;
    let first = |forces: &[f64]| forces.iter().copied().find(|force| force.is_finite());
    let force = first(&trace.force).unwrap_or(0.0);
    let read = sensors.read(0.0, start, force).0;
    let held_by_guides = first(&trace.force_cell)
        .map_or(force, |cell| cell - (sensors.read(0.0, start, cell).1 - cell));
    stage.set_state(start - (read - start), 0.0, &holding(&guides, held_by_guides));
    let mut running = Running::new(controller);
    let mut held = force;
    let mut error = Vec::with_capacity(count);
    let mut unknown = 0;
    for row in 0..count {
        let recorded = trace.position[row];
        if recorded.is_finite() && unknown > LONGEST_BRIDGED {
            // Behind a hole the stage is where the recording says, as fast as it says; what its
            // bristles hold is not known.
            let held = trace.force[row.saturating_sub(1)];
            let held = if held.is_finite() { held } else { 0.0 };
            let read = sensors.read(trace.time[row], recorded, held).0;
            let next = trace
                .position
                .get(row + 1)
                .copied()
                .filter(|next| next.is_finite())
                .unwrap_or(recorded);
            let force = [trace.force_cell[row], trace.force[row]]
                .into_iter()
                .find(|force| force.is_finite());
            stage.set_state(
                recorded - (read - recorded),
                (next - recorded) * rate,
                &holding(&guides, force.unwrap_or(0.0)),
            );
        }
        unknown = if recorded.is_finite() { 0 } else { unknown + 1 };
        let position = stage.sample().position;
        if !position.is_finite() {
            return Err(ClosedLoopError::Unstable);
        }
        error.push(position - trace.position[row]);
        let answer = running.force(setpoint.inputs(row, position), trace.force[row]);
        if answer.is_finite() {
            held = answer;
        }
        stage.advance(held);
    }
    Ok(error)
}

/// Root of the mean square of the finite values; 0 without any.
pub fn rms(values: &[f64]) -> f64 {
    let (sum, count) = values
        .iter()
        .filter(|v| v.is_finite())
        .fold((0.0, 0usize), |(sum, n), v| (sum + v * v, n + 1));
    if count == 0 { 0.0 } else { (sum / count as f64).sqrt() }
}

fn largest(values: &[f64]) -> f64 {
    values.iter().filter(|value| value.is_finite()).fold(0.0, |most, value| most.max(value.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_records::recording;

    #[test]
    fn our_own_controller_is_found_and_the_true_model_repeats_the_recording() {
        // Without noise, which the recording's controller answers and the simulated one does not.
        let model = StageModel::default().without_noise();
        let trace = recording(&model, 3, 0.0, 2);
        let controller = controller_of(&trace, &[&trace]).unwrap();
        assert!(controller.share_missed(&trace).unwrap() < 1e-6);
        let truth = rms(&position_error(&model, &trace, &controller).unwrap());
        let mut heavy = model.clone();
        heavy.mass *= 1.1;
        let wrong = rms(&position_error(&heavy, &trace, &controller).unwrap());
        assert!(truth < 1e-9, "{truth:e}");
        assert!(wrong > 1e-8, "{wrong:e}");
    }

    /// Along these moves the feedforward of the mass is also a sum of velocities and accelerations;
    /// only where a move starts it is not.
    #[test]
    fn a_controller_is_found_in_a_long_recording_of_few_starts() {
        let trace = recording(&StageModel::default().without_noise(), 3, 0.0, 8);
        let share = LinearController::fit(&trace).unwrap().share_missed(&trace).unwrap();
        assert!(share < 1e-6, "{share:e}");
    }

    #[test]
    fn a_recording_may_start_on_guides_that_hold_a_force() {
        let model = StageModel::default().without_noise();
        let most: f64 =
            model.resolved_guides().unwrap().iter().map(|guide| guide.static_force).sum();
        for held in [-0.5 * most, 0.7 * most, -0.8 * most] {
            let trace = recording(&model, 3, held, 2);
            let controller = controller_of(&trace, &[&trace]).unwrap();
            let error = rms(&position_error(&model, &trace, &controller).unwrap());
            assert!(error < 5e-9, "{held:.1} N held: {error:e} m");
        }
    }

    /// During the hole the recorded stage goes on by some millimetres; the simulated one, which no
    /// setpoint leads there, must not be compared with it from where it was.
    #[test]
    fn behind_a_hole_the_simulated_stage_begins_where_the_recorded_one_is() {
        let model = StageModel::default().without_noise();
        let mut trace = recording(&model, 3, 0.0, 3);
        let controller = controller_of(&trace, &[&trace]).unwrap();
        let hole = 3400..4200;
        let way = trace.position[hole.end] - trace.position[hole.start];
        for column in [
            &mut trace.position,
            &mut trace.reference_position,
            &mut trace.force,
            &mut trace.force_cell,
        ] {
            column[hole.clone()].fill(f64::NAN);
        }
        let error = position_error(&model, &trace, &controller).unwrap();
        assert!(way.abs() > 5e-3, "{way:e} m in the hole");
        assert!(error[hole.clone()].iter().all(|error| error.is_nan()));
        // What the bristles held is not known, and the velocity only from two samples.
        let (before, behind) = (rms(&error[..hole.start]), rms(&error[hole.end..]));
        assert!(before < 5e-9 && behind < 1e-6, "{before:e} m before, {behind:e} m behind");
    }

    #[test]
    fn a_command_that_no_controller_of_the_error_makes_is_refused() {
        let mut trace = recording(&StageModel::default(), 3, 0.0, 2);
        for (row, force) in trace.force.iter_mut().enumerate() {
            *force += 20.0 * (row as f64 * 0.37).sin().signum();
        }
        let refused = controller_of(&trace, &[&trace]);
        assert!(
            matches!(refused, Err(ClosedLoopError::NotLinear { share }) if share > 0.05),
            "{refused:?}"
        );
        trace.reference_position.fill(f64::NAN);
        assert!(matches!(controller_of(&trace, &[&trace]), Err(ClosedLoopError::NoSetpoint)));
    }
}
