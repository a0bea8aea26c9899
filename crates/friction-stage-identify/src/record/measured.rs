//! A recording as identification needs it: a motion that friction can be driven along, and forces
//! at the instants in between.

use std::ops::Range;

use friction_stage_core::model::{Guide, StageModel};
use friction_stage_core::numerics::noise::{cell_noise, count_size, encoder_noise};
use friction_stage_core::plant::Motion;
use friction_stage_core::plant::effects::ForceOverStep;
use friction_stage_data::signals::Trace;

use crate::error::IdentifyError;
use crate::record::at_rest::{AtRest, REST_SPEED};
use crate::record::lowpass::ZeroPhaseLowpass;

/// Corner of the lowpass on measured and modelled forces, Hz, where the rate allows it. Assumed:
/// above the controller's bandwidth, below the band where the encoder's noise, differentiated
/// twice, hides everything.
const FORCE_CORNER: f64 = 200.0;
/// Steps into which an interval is divided in which the velocity changes its sign or by more than
/// [`STEADY`].
const SUBSTEPS: usize = 4;
/// Share of its mean by which the velocity of an interval may change for one step to do.
const STEADY: f64 = 0.1;
/// Break-away lengths after which a bristle has forgotten where it came from: exp(-7) is left. The
/// parameters are nominal, hence no less.
const FORGETTING: f64 = 7.0;
/// Longest hole in the position that the stage crosses as the samples on either side say, s.
/// Assumed: no stage turns and comes back in it.
const HOLE: f64 = 5e-3;
/// Part of the forgetting length by which the ends of a hole may differ for the stage to have stood
/// in it. Assumed.
const STOOD: f64 = 1e-3;
/// Fewest samples that are worth an attempt: less does not even fill the filters several times.
pub const MIN_SAMPLES: usize = 1000;

/// One step of the measured motion at constant velocity.
#[derive(Clone, Copy, Debug)]
pub struct Step {
    /// What an effect sees, at the middle of the step: as the encoder says, so that what rings a
    /// few nanometres rings here too.
    pub motion: Motion,
    /// Velocity at which the guides slide, m/s: without apparent motion from the encoder's noise at
    /// rest, which would relax the bristles.
    pub sliding: f64,
    /// s
    pub duration: f64,
    /// Sample at the start of the interval that the step belongs to.
    pub node: usize,
    /// Share of the step's force in the mean force of the two intervals around `node`, and of those
    /// around the next node.
    pub early: f64,
    /// Share of the later node.
    pub late: f64,
}

impl Step {
    /// Adds the step's part of a force to its means at the nodes, N.
    #[inline]
    pub(crate) fn share_out(&self, force: f64, at_nodes: &mut [f64]) {
        at_nodes[self.node] += self.early * force;
        at_nodes[self.node + 1] += self.late * force;
    }

    /// The same of a force that changes over the step: the later it comes, the more of it the later
    /// node gets.
    #[inline]
    pub(crate) fn share_out_over(&self, force: ForceOverStep, at_nodes: &mut [f64]) {
        self.share_out(force.mean, at_nodes);
        let share = self.early + self.late;
        let moved = share * share * force.moment;
        at_nodes[self.node] -= moved;
        at_nodes[self.node + 1] += moved;
    }
}

/// A recording on a uniform grid, with everything that does not depend on a model worked out.
///
/// Forces stand at the samples ("nodes") as the means of the two intervals around them, because the
/// second difference of the position is exactly that mean over mass where the force is held between
/// samples.
#[derive(Clone, Debug)]
pub struct Measured {
    /// s since the first sample
    pub time: Vec<f64>,
    /// As the encoder says, m.
    pub position: Vec<f64>,
    /// m/s
    pub velocity: Vec<f64>,
    /// m/s^2
    pub acceleration: Vec<f64>,
    /// Force cell, N; `None` where there is none, and then the command is the force.
    pub cell: Option<Vec<f64>>,
    /// Command, N; what the cell read where there is no command.
    pub command: Vec<f64>,
    /// Reference position, m; NaN where the recording has none.
    pub reference: [Vec<f64>; 3],
    /// Command and cell as recorded, sample by sample, holes filled, N; without a command in its
    /// place what the cell read a sample later.
    pub raw_command: Vec<f64>,
    raw_cell: Option<Vec<f64>>,
    has_command: bool,
    /// Standard deviation of the encoder's noise as the record shows it, m; above 0.
    pub noise: f64,
    /// Count of the encoder as declared, or as the record shows it where that is more, m; 0 for
    /// none.
    pub count: f64,
    /// Standard deviation of the cell's noise as the record shows it, N; 0 without a cell.
    pub cell_noise: f64,
    /// Moving mass as declared, kg.
    mass: f64,
    /// Of the position.
    at_rest: AtRest,
    /// In order of time; each interval between samples has one or several.
    pub steps: Vec<Step>,
    /// Samples per second, Hz.
    pub rate: f64,
    /// Filter of measured and modelled forces.
    pub lowpass: ZeroPhaseLowpass,
    /// Nodes that are compared, after filtering and thinning out.
    pub rows: Vec<usize>,
    /// Share of the samples at which the carriage rests within a count of the encoder while its
    /// friction changes, and until the bristles have forgotten it: these are not compared.
    pub hidden_rest_share: f64,
}

impl Measured {
    /// Largest speed, m/s.
    pub(crate) fn largest_speed(&self) -> f64 {
        let finite = self.velocity.iter().filter(|speed| speed.is_finite());
        finite.fold(0.0, |most, speed| most.max(speed.abs()))
    }

    /// From a trace at a uniform rate; samples with a NaN position, and where it has the force at
    /// all a NaN force, are left out of the comparison. `model` gives the moving mass and the
    /// declared noise.
    pub fn new(trace: &Trace, model: &StageModel, name: &str) -> Result<Measured, IdentifyError> {
        let count = trace.len();
        if count < MIN_SAMPLES {
            return Err(IdentifyError::TooShort {
                name: name.to_owned(),
                samples: count,
                least: MIN_SAMPLES,
            });
        }
        let span = trace.time[count - 1] - trace.time[0];
        let rate = (count - 1) as f64 / span;
        let absent = |values: &[f64]| values.iter().all(|value| value.is_nan());
        if absent(&trace.force) && absent(&trace.force_cell) {
            return Err(IdentifyError::NoForce { name: name.to_owned() });
        }
        let mut valid: Vec<bool> =
            trace.position.iter().map(|position| position.is_finite()).collect();
        let position = filled(&trace.position);
        let (lowest, highest) = friction_stage_core::numerics::range(&position);
        let least = model.encoder.resolution.max(1e-12);
        if highest - lowest <= 10.0 * (least + model.encoder.noise) {
            return Err(IdentifyError::NoMotion {
                name: name.to_owned(),
                travel: highest - lowest,
            });
        }
        let mut note = |values: &[f64]| {
            for (valid, value) in valid.iter_mut().zip(values) {
                *valid &= value.is_finite();
            }
        };
        // Without a command the cell is all there is to know of the force.
        let raw_command = if absent(&trace.force) {
            note(&trace.force_cell);
            let cell = filled(&trace.force_cell);
            (0..count).map(|k| cell[(k + 1).min(count - 1)]).collect()
        } else {
            note(&trace.force);
            filled(&trace.force)
        };
        let has_cell = !absent(&trace.force_cell) && !absent(&trace.force);
        let has_command = !absent(&trace.force);
        let raw_cell = has_cell.then(|| {
            note(&trace.force_cell);
            filled(&trace.force_cell)
        });
        // An encoder without any noise is no division by 0.
        let noise = encoder_noise(&trace.position, model.encoder.resolution).max(f64::MIN_POSITIVE);
        let cell_noise =
            if has_cell { cell_noise(&trace.force_cell, Some(&trace.force)) } else { 0.0 };
        for unknown in unknown_bristles(&trace.position, rate, model)? {
            valid[unknown].fill(false);
        }
        let lowpass = ZeroPhaseLowpass::new(FORCE_CORNER.min(rate / 5.0), rate);
        let mut measured = Measured {
            at_rest: AtRest::new(&position, rate, noise),
            time: trace.time.iter().map(|time| time - trace.time[0]).collect(),
            position,
            velocity: Vec::new(),
            acceleration: Vec::new(),
            cell: None,
            command: Vec::new(),
            has_command,
            reference: [
                trace.reference_position.clone(),
                trace.reference_velocity.clone(),
                trace.reference_acceleration.clone(),
            ],
            raw_command,
            raw_cell,
            noise,
            count: model.encoder.resolution.max(count_size(&trace.position)),
            cell_noise,
            mass: model.mass,
            steps: Vec::new(),
            rate,
            lowpass,
            rows: Vec::new(),
            hidden_rest_share: 0.0,
        };
        let hidden = measured.hidden_rests(&trace.position, model)?;
        measured.hidden_rest_share =
            hidden.iter().map(|rest| rest.len()).sum::<usize>() as f64 / count as f64;
        hidden.into_iter().for_each(|rest| valid[rest].fill(false));
        measured.rows = rows_of(&valid, &measured.lowpass);
        let samples = measured.rows.len() * measured.lowpass.factor();
        if samples < MIN_SAMPLES / 2 {
            return Err(IdentifyError::TooShort {
                name: name.to_owned(),
                samples,
                least: MIN_SAMPLES / 2,
            });
        }
        measured.work_out(model.mass);
        Ok(measured)
    }

    /// Samples from each rest in which friction changes by more than the noise floor while the
    /// encoder repeats a count, until the bristles have forgotten it. At rest friction equals the
    /// applied force, and the presliding displacement is less than a count: friction is not
    /// determined by the measured position.
    fn hidden_rests(
        &self,
        read: &[f64],
        model: &StageModel,
    ) -> Result<Vec<Range<usize>>, IdentifyError> {
        let length = forgetting_length(&model.resolved_guides()?);
        let force = self.raw_cell.as_ref().unwrap_or(&self.raw_command);
        let (least, half) = (self.floor(model).carriage, self.lowpass.half());
        let mut rests: Vec<Range<usize>> = Vec::new();
        let mut from = 0;
        for run in read.chunk_by(|a, b| a == b) {
            let to = from + run.len();
            let seen = from + half..to.saturating_sub(half);
            let known = rests.last().is_none_or(|last| last.end < to);
            if known && seen.len() > 1 {
                let force: Vec<f64> = seen.map(|k| self.lowpass.at(force, k)).collect();
                let (lowest, highest) = friction_stage_core::numerics::range(&force);
                if highest - lowest > least {
                    let from = from.max(rests.last().map_or(0, |last| last.end));
                    rests.push(from..slid_from(read, to - 1, length).unwrap_or(read.len()));
                }
            }
            from = to;
        }
        Ok(rests)
    }

    /// Everything that follows from position, command and cell as recorded, with a mass in kg.
    fn work_out(&mut self, mass: f64) {
        let (position, raw_command) = (&self.position, &self.raw_command);
        let (count, rate) = (self.len(), self.rate);
        // Interval k runs from sample k to k + 1; the cell shows it at its end, the command at its
        // start.
        let inner = |values: &dyn Fn(usize) -> f64| -> Vec<f64> {
            (0..count).map(|k| if k == 0 || k + 1 == count { 0.0 } else { values(k) }).collect()
        };
        let command = inner(&|k| 0.5 * (raw_command[k - 1] + raw_command[k]));
        let cell = self.raw_cell.as_ref().map(|cell| inner(&|k| 0.5 * (cell[k] + cell[k + 1])));
        let acceleration =
            inner(&|k| (position[k + 1] - 2.0 * position[k] + position[k - 1]) * rate * rate);
        (self.command, self.cell, self.acceleration, self.mass) =
            (command, cell, acceleration, mass);
        (self.velocity, self.steps) = self.moved_by(None, &self.command);
    }

    /// Velocity at the nodes, m/s, and the motion in steps, where the carriage is at these
    /// positions, m, but for the encoder's noise, and this force of the motor at the nodes, N,
    /// shakes it at rest. `None`: where the encoder says.
    pub(crate) fn moved_by(
        &self,
        elsewhere: Option<Vec<f64>>,
        push: &[f64],
    ) -> (Vec<f64>, Vec<Step>) {
        let (count, rate, dt, mass) = (self.len(), self.rate, self.rate.recip(), self.mass);
        // A cell's noise would shake the carriage more than the controller does.
        let shaken = self
            .has_command
            .then(|| push.iter().map(|force| force * dt * dt / mass).collect::<Vec<f64>>());
        let position = elsewhere.as_deref().unwrap_or(&self.position);
        let of_elsewhere =
            elsewhere.as_ref().map(|position| AtRest::new(position, rate, self.noise));
        let at_rest = of_elsewhere.as_ref().unwrap_or(&self.at_rest);
        let smooth = at_rest.smoothed(position, shaken.as_deref());
        // With a force that is held the velocity at a node is the central difference less a quarter
        // of the jump of the acceleration times dt.
        let jump = |k: usize| match &self.raw_cell {
            Some(cell) => cell[k + 1] - cell[k],
            None => self.raw_command[k] - self.raw_command[k - 1],
        };
        let velocity_of = |position: &[f64]| -> Vec<f64> {
            let between = |k: usize| {
                0.5 * (position[k + 1] - position[k - 1]) * rate - 0.25 * jump(k) * dt / mass
            };
            (0..count).map(|k| if k == 0 || k + 1 == count { 0.0 } else { between(k) }).collect()
        };
        let (velocity, read_velocity) = (velocity_of(&smooth), velocity_of(position));
        let steps = self.in_steps(&smooth, &velocity, &read_velocity);
        (velocity, steps)
    }

    /// What a controller has read, answered and been asked for, sample by sample; `None` without
    /// a command.
    pub(crate) fn controlled(&self) -> Option<Trace> {
        let [position, velocity, acceleration] = self.reference.clone();
        self.has_command.then(|| Trace {
            time: self.time.clone(),
            reference_position: position,
            reference_velocity: velocity,
            reference_acceleration: acceleration,
            position: self.position.clone(),
            force: self.raw_command.clone(),
            ..Trace::default()
        })
    }

    /// The same record had encoder (m) and cell (N) read this more, sample by sample; a cell that
    /// is not there reads nothing.
    pub(crate) fn with_noise(
        &self,
        mut encoder: impl FnMut() -> f64,
        mut cell: impl FnMut() -> f64,
        mass: f64,
    ) -> Measured {
        let position = self.position.iter().map(|position| position + encoder()).collect();
        let (mut raw_command, mut raw_cell) = (self.raw_command.clone(), self.raw_cell.clone());
        let read = if self.has_command { raw_cell.as_mut() } else { Some(&mut raw_command) };
        read.into_iter().flatten().for_each(|force| *force += cell());
        self.with_signals(position, raw_command, raw_cell, mass)
    }

    /// The same record had its sensors read this: position, m, and cell, N, under a command, N.
    /// What is not recorded of it stays unknown.
    pub(crate) fn read_as(
        &self,
        position: Vec<f64>,
        command: Vec<f64>,
        cell: Vec<f64>,
        mass: f64,
    ) -> Measured {
        let last = cell.len() - 1;
        if self.has_command {
            let raw_cell = self.raw_cell.is_some().then_some(cell);
            self.with_signals(position, command, raw_cell, mass)
        } else {
            let a_sample_later = (0..=last).map(|k| cell[(k + 1).min(last)]).collect();
            self.with_signals(position, a_sample_later, None, mass)
        }
    }

    fn with_signals(
        &self,
        position: Vec<f64>,
        raw_command: Vec<f64>,
        raw_cell: Option<Vec<f64>>,
        mass: f64,
    ) -> Measured {
        // All but what is worked out again.
        let mut other = Measured {
            at_rest: AtRest::new(&position, self.rate, self.noise),
            time: self.time.clone(),
            position,
            velocity: Vec::new(),
            acceleration: Vec::new(),
            cell: None,
            command: Vec::new(),
            reference: self.reference.clone(),
            raw_command,
            raw_cell,
            steps: Vec::new(),
            lowpass: self.lowpass.clone(),
            rows: self.rows.clone(),
            ..*self
        };
        other.work_out(mass);
        other
    }

    /// The motion in steps: more of them where it turns. `smooth` is the position without what the
    /// apparent motion at rest, `velocity` its velocity at the nodes, `read_velocity` that with the
    /// noise.
    fn in_steps(&self, smooth: &[f64], velocity: &[f64], read_velocity: &[f64]) -> Vec<Step> {
        let (rate, dt) = (self.rate, self.rate.recip());
        let still = self.noise * rate * REST_SPEED.0;
        let mut steps = Vec::with_capacity(self.len() + self.len() / 4);
        for k in 0..self.len() - 1 {
            let mean = (smooth[k + 1] - smooth[k]) * rate;
            let (start, end) = (velocity[k], velocity[k + 1]);
            let turns = start * end <= 0.0 || (end - start).abs() > STEADY * mean.abs();
            let parts = if turns && start.abs().max(end.abs()) > still { SUBSTEPS } else { 1 };
            let (slides, moves) =
                (path(smooth, velocity, k, rate), path(&self.position, read_velocity, k, rate));
            for part in 0..parts {
                let (from, to) = (part as f64 / parts as f64, (part + 1) as f64 / parts as f64);
                let middle = 0.5 * (from + to);
                steps.push(Step {
                    motion: Motion {
                        time: self.time[k] + middle * dt,
                        position: self.position[k] + 0.5 * (moves(from) + moves(to)) * dt,
                        velocity: (moves(to) - moves(from)) * parts as f64,
                        acceleration: 0.5 * (self.acceleration[k] + self.acceleration[k + 1]),
                        motor_force: self.raw_command[k],
                        friction: 0.0,
                    },
                    sliding: (slides(to) - slides(from)) * parts as f64,
                    duration: dt / parts as f64,
                    node: k,
                    early: (1.0 - middle) / parts as f64,
                    late: middle / parts as f64,
                });
            }
        }
        steps
    }

    /// Samples.
    pub fn len(&self) -> usize {
        self.time.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.time.is_empty()
    }

    /// Whether a cell has read the force on the carriage.
    pub fn by_cell(&self) -> bool {
        self.cell.is_some() || !self.has_command
    }

    /// A signal, filtered, at the rows.
    pub fn filtered(&self, signal: &[f64]) -> Vec<f64> {
        self.lowpass.at_all(signal, &self.rows)
    }

    /// Rms of the force on the carriage as measured (the command where there is no cell), filtered
    /// as the residuals are, N.
    pub fn force_rms(&self) -> f64 {
        let force = self.filtered(self.cell.as_deref().unwrap_or(&self.command));
        mean_square(force.into_iter()).sqrt()
    }

    /// A signal at the rows as it is.
    pub fn at_rows(&self, signal: &[f64]) -> Vec<f64> {
        self.rows.iter().map(|row| signal[*row]).collect()
    }

    /// Standard deviation of the residuals that the declared sensor noise alone gives, N: motor
    /// side (0 without cell and command) and carriage side.
    pub fn declared_floor(&self, model: &StageModel) -> Floor {
        self.floor_of(model, declared_encoder_noise(model), model.force_cell.noise)
    }

    /// The same of the noise that the record shows, where that is more than the declared: what
    /// sensors hide no law explains.
    pub fn floor(&self, model: &StageModel) -> Floor {
        self.floor_of(
            model,
            declared_encoder_noise(model).max(self.noise),
            model.force_cell.noise.max(self.cell_noise),
        )
    }

    /// Of a noise of encoder, m, and cell, N.
    fn floor_of(&self, model: &StageModel, encoder: f64, cell: f64) -> Floor {
        let inertia = model.mass
            * self.rate
            * self.rate
            * encoder
            * self.lowpass.noise_gain(&[1.0, -2.0, 1.0]);
        let read = cell * self.lowpass.noise_gain(&[0.5, 0.5]);
        Floor {
            motor: if self.cell.is_some() { read } else { 0.0 },
            carriage: if self.by_cell() { inertia.hypot(read) } else { inertia },
        }
    }
}

/// Residuals that sensor noise alone leaves, N rms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Floor {
    /// On the motor side.
    pub motor: f64,
    /// On the carriage side.
    pub carriage: f64,
}

impl Floor {
    /// Of both sides together, N rms.
    pub fn total(&self) -> f64 {
        self.motor.hypot(self.carriage)
    }
}

/// Samples at which the filtered signals are compared: thinned out, and where the filter sees valid
/// samples only.
fn rows_of(valid: &[bool], lowpass: &ZeroPhaseLowpass) -> Vec<usize> {
    let half = lowpass.half() + 1;
    // Running count of samples to leave out, so that each row is judged in one subtraction.
    let missing: Vec<usize> = std::iter::once(0)
        .chain(valid.iter().scan(0, |sum, valid| {
            *sum += usize::from(!valid);
            Some(*sum)
        }))
        .collect();
    lowpass
        .kept(valid.len(), 2)
        .filter(|row| *row >= half && missing[row + half + 1] == missing[row - half])
        .collect()
}

/// Way from sample `k` over the share s of the interval behind it, over the length of the interval,
/// m/s: a cubic with the velocities of both samples at its ends.
fn path(position: &[f64], velocity: &[f64], k: usize, rate: f64) -> impl Fn(f64) -> f64 + use<> {
    let mean = (position[k + 1] - position[k]) * rate;
    let (start, end) = (velocity[k], velocity[k + 1]);
    let (square, cube) = (3.0 * mean - 2.0 * start - end, start + end - 2.0 * mean);
    move |s| s * (start + s * (square + s * cube))
}

/// Distance after which the bristles of these guides have forgotten where they came from, m.
pub(crate) fn forgetting_length(guides: &[Guide]) -> f64 {
    FORGETTING * guides.iter().map(|guide| guide.static_force / guide.stiffness).fold(0.0, f64::max)
}

/// First sample after `from` at which the carriage is further than a length, m, from where it was.
fn slid_from(position: &[f64], from: usize, length: f64) -> Option<usize> {
    let start = position[from];
    let samples = position[from..].iter().position(|x| (x - start).abs() > length)?;
    Some(from + samples)
}

/// Samples at which the state of the bristles is not known: at the start, and after a hole in which
/// the stage moved and may have turned, until the guides have slid far enough to have forgotten it.
/// A record that never slides so far is whole from its start.
fn unknown_bristles(
    position: &[f64],
    rate: f64,
    model: &StageModel,
) -> Result<Vec<Range<usize>>, IdentifyError> {
    let length = forgetting_length(&model.resolved_guides()?);
    let mut ranges = Vec::new();
    let (mut from, mut hole) = (0, 0);
    for run in position.chunk_by(|a, b| a.is_finite() == b.is_finite()) {
        let finite = run[0].is_finite();
        if finite && ranges.is_empty() {
            ranges.push(from..slid_from(position, from, length).unwrap_or(from));
        } else if finite
            && hole as f64 > HOLE * rate
            && (position[from] - position[from - hole - 1]).abs() > STOOD * length
        {
            ranges.push(from..slid_from(position, from, length).unwrap_or(position.len()));
        }
        hole = if finite { 0 } else { run.len() };
        from += run.len();
    }
    Ok(ranges)
}

/// NaN replaced by the straight line between the neighbours; the ends by the nearest value.
fn filled(values: &[f64]) -> Vec<f64> {
    let mut filled = values.to_vec();
    let mut last: Option<usize> = None;
    for index in 0..values.len() {
        if !values[index].is_finite() {
            continue;
        }
        match last {
            None => filled[..index].fill(values[index]),
            Some(before) => {
                let slope = (values[index] - values[before]) / (index - before) as f64;
                for (offset, between) in filled[before + 1..index].iter_mut().enumerate() {
                    *between = values[before] + slope * (offset + 1) as f64;
                }
            }
        }
        last = Some(index);
    }
    match last {
        Some(last) => filled[last..].fill(values[last]),
        None => filled.fill(0.0),
    }
    filled
}

/// Declared noise of the encoder with that of its counts, m.
fn declared_encoder_noise(model: &StageModel) -> f64 {
    model.encoder.noise.hypot(model.encoder.resolution / 12f64.sqrt())
}

/// Mean of the squares; 0 of nothing.
pub(crate) fn mean_square(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1);
    values.map(|value| value * value).sum::<f64>() / count as f64
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    /// 2 s at 2 kHz: 20 mm to and fro, then rest.
    fn trace(noise: impl Fn(usize) -> f64) -> Trace {
        let count = 4000;
        let at =
            |k: usize| if k < 2000 { 0.01 * (1.0 - (TAU * k as f64 / 2000.0).cos()) } else { 0.0 };
        Trace {
            origin_ns: 0,
            time: (0..count).map(|k| k as f64 / 2000.0).collect(),
            reference_position: vec![f64::NAN; count],
            reference_velocity: vec![f64::NAN; count],
            reference_acceleration: vec![f64::NAN; count],
            position: (0..count).map(|k| at(k) + noise(k)).collect(),
            force_cell: vec![f64::NAN; count],
            force: vec![0.0; count],
        }
    }

    #[test]
    fn an_encoder_without_noise_is_followed_as_it_is() {
        let mut model = StageModel::default();
        (model.encoder.noise, model.encoder.resolution) = (0.0, 0.0);
        let measured = Measured::new(&trace(|_| 0.0), &model, "exact").unwrap();
        for step in &measured.steps {
            assert!(
                step.sliding.is_finite() && (step.sliding - step.motion.velocity).abs() < 1e-9,
                "{step:?}"
            );
        }
    }

    /// Guides at rest see neither the noise nor, in a moving carriage, anything but the motion.
    #[test]
    fn noise_at_rest_does_not_slide_the_guides_and_a_ringing_carriage_does() {
        let chaos = |k: usize| 1e-9 * ((k * 7919 % 1009) as f64 / 504.5 - 1.0);
        let path = |measured: &Measured| -> f64 {
            let rest = measured.steps.iter().filter(|step| (2500..3500).contains(&step.node));
            rest.map(|step| step.sliding.abs() * step.duration).sum()
        };
        let model = StageModel::default();
        let still = path(&Measured::new(&trace(chaos), &model, "still").unwrap());
        let read: f64 = (2500..3500).map(|k| (chaos(k + 1) - chaos(k)).abs()).sum();
        assert!(still < 0.1 * read, "{still} m of {read} m that the encoder reads");
        // 40 nm at 130 Hz.
        let ring = |k: usize| 40e-9 * (TAU * 130.0 * k as f64 / 2000.0).sin();
        let ringing =
            path(&Measured::new(&trace(|k| chaos(k) + ring(k)), &model, "ringing").unwrap());
        let way = 4.0 * 40e-9 * 130.0 * 0.5;
        assert!((ringing / way - 1.0).abs() < 0.1, "{ringing} m of {way} m");
    }

    /// In a hole the stage may have turned: until its guides have slid far, what they hold is
    /// unknown.
    #[test]
    fn after_a_hole_rows_wait_until_the_guides_have_slid() {
        let model = StageModel::default();
        let length = forgetting_length(&model.resolved_guides().unwrap());
        let kept = |hole: Range<usize>| {
            let mut trace = trace(|_| 0.0);
            trace.position[hole].fill(f64::NAN);
            let (position, rows) =
                (trace.position.clone(), Measured::new(&trace, &model, "hole").unwrap().rows);
            (position, rows)
        };
        // About the turn at 10 mm, 50 ms long, and one of two samples.
        let (position, rows) = kept(950..1050);
        let slid = 1050
            + position[1050..].iter().position(|x| (x - position[1050]).abs() > length).unwrap();
        assert!(slid > 1080, "{slid}");
        assert!(rows.iter().all(|row| !(950..slid).contains(row)), "{slid}");
        assert!(rows.iter().any(|row| (slid..slid + 40).contains(row)), "{slid}");
        let (_, rows) = kept(999..1001);
        assert!(rows.iter().any(|row| (1001..1050).contains(row)));
        // In the rest at the end it stands, and from a hole that reaches into the rest it never
        // slides again.
        let (_, rows) = kept(2100..2200);
        assert!(rows.iter().any(|row| *row > 2200));
        let (_, rows) = kept(1900..2100);
        assert!(rows.iter().all(|row| *row < 1900));
    }

    /// A rest of half a second in counts of 1 µm, in which the force rises by 40 N or not at all.
    #[test]
    fn a_rest_within_a_count_is_compared_unless_its_friction_changes() {
        let mut model = StageModel::default();
        (model.encoder.noise, model.encoder.resolution) = (0.0, 1e-6);
        let length = forgetting_length(&model.resolved_guides().unwrap());
        let read = |rise: f64| {
            let at = |k: usize| 0.01 * (1.0 - (TAU * k as f64 / 2000.0).cos());
            let mut trace = trace(|_| 0.0);
            for k in 0..4000 {
                let moved = if k < 1000 { at(k) } else { at(k.max(2000) - 1000) };
                trace.position[k] = 1e-6 * (moved / 1e-6).round();
                trace.force[k] = rise * (k.clamp(1000, 2000) - 1000) as f64 / 1000.0;
            }
            let position = trace.position.clone();
            (position, Measured::new(&trace, &model, "rest").unwrap())
        };
        let (_, steady) = read(0.0);
        assert_eq!(steady.hidden_rest_share, 0.0);
        assert!(steady.rows.iter().any(|row| (1200..1800).contains(row)));
        let (position, changing) = read(40.0);
        let slid = 1900 + position[1900..].iter().position(|x| (x - 0.02).abs() > length).unwrap();
        let hidden = changing.hidden_rest_share * 4000.0;
        assert!((hidden - (slid - 985) as f64).abs() < 30.0, "{hidden}, slid at {slid}");
        assert!(changing.rows.iter().all(|row| !(1000..slid).contains(row)), "{slid}");
        assert!(changing.rows.iter().any(|row| (slid..slid + 40).contains(row)), "{slid}");
    }
}
