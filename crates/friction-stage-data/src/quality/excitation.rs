//! What a recording can identify and what not: the motion that it covers, the noise that is in it,
//! and what is wrong with it.
//!
//! What comes in is a [`Recording`] and, if there is one, the declared model; what goes out is an
//! [`Excitation`] with figures, [`DataProblem`]s and a [`Judgement`] per kind of parameter. Nothing
//! is fitted finely here: one linear regression of the force on acceleration, direction and
//! velocity shows signs, units and sizes.

use std::fmt;
use std::ops::Range;

use nalgebra::{Matrix4, Vector4};
use serde::Serialize;

use super::problem::{DataProblem, Severity};
use crate::signals::{ClockKind, Recording, Signal};
use friction_stage_core::model::{Guide, StageModel};
use friction_stage_core::plant::EffectDescriptor;

/// Least rows in one piece. Assumed: some fifty parameters' worth of filtered samples.
const LEAST_ROWS: usize = 500;
/// Half of the time over which velocity and acceleration are taken, s. Assumed: short against a 60
/// Hz loop's 17 ms period, long enough that 1 nm of noise is 0.1 mm/s² of acceleration.
const HALF_BASE: f64 = 5e-3;
/// Stribeck velocity, m/s, where no model declares one. Assumed: the low end of the usual 1 to 10
/// mm/s.
const USUAL_STRIBECK_VELOCITY: f64 = 1e-3;
/// Slower than this, m/s, the carriage rests. Assumed: a hundredth of a usual Stribeck velocity of
/// 1 mm/s and more.
const REST_SPEED: f64 = 1e-5;
/// Longest time, s, for which a signal that changes from row to row elsewhere may have one value
/// while the stage is driven; and share of the rows elsewhere that may repeat the one before.
/// Assumed: noise repeats no number of seven digits, let alone for so long.
const STUCK: (f64, f64) = (0.25, 0.1);
/// Shortest stretch of one speed, and of rest, s. Assumed.
const SHORTEST_STRETCH: f64 = 0.05;
/// Speeds within this ratio are the same. Assumed.
const SAME_SPEED: f64 = 1.1;
/// Part of what a cell is off the command before it that it must be off the one behind it for the
/// two to be swapped. Assumed: what a motor adds is as far from either.
const SWAPPED: f64 = 0.3;
/// Break-away distances that a stage has to span for its Coulomb friction to be seen. Assumed.
const SLIDES: f64 = 50.0;
/// Rows at an extreme, in a row, that make it a limit and no chance.
const CLIPPED_RUN: usize = 3;

/// Least, median and largest of something.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    pub least: f64,
    pub median: f64,
    pub largest: f64,
}

/// Noise of a sensor, SI.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct NoiseFound {
    /// Standard deviation, from sixth differences.
    pub present: f64,
    /// Declared standard deviation, quantisation included.
    pub declared: Option<f64>,
    /// Smallest step between two values; the resolution if the signal is quantised.
    pub smallest_step: f64,
}

/// Force regressed on the motion: F = mass a + coulomb sign(v) + viscous v + offset, while the
/// carriage moves.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RoughFit {
    /// Mass, kg.
    pub mass: f64,
    /// Its standard deviation, kg, as if the residual were white.
    pub mass_deviation: f64,
    /// Coulomb friction, N.
    pub coulomb: f64,
    /// Viscous friction, N s/m.
    pub viscous: f64,
    /// Constant force, N.
    pub offset: f64,
    /// Explained share of the mean square of the force.
    pub explained: f64,
    /// Share of the mean square that acceleration brings.
    pub inertial: f64,
    /// Share of the mean square that nothing but acceleration explains.
    pub by_acceleration_alone: f64,
}

impl RoughFit {
    /// Whether the mass is known well enough to say that a sign, a unit or the machine is another:
    /// where the acceleration explains less than the fit leaves, what the fit lacks passes for a
    /// mass.
    fn knows_the_mass(&self) -> bool {
        self.mass_deviation < 0.1 * self.mass.abs()
            && self.by_acceleration_alone >= 1.0 - self.explained
    }
}

/// Whether something can be identified, and why or why not.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judgement {
    /// What is asked for.
    pub subject: &'static str,
    /// Whether the data can tell.
    pub possible: bool,
    /// Why, or what is missing.
    pub because: String,
}

/// What a recording covers and can identify.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Excitation {
    /// Length of the valid rows, s.
    pub duration_s: f64,
    /// Lowest and highest position, m.
    pub position_range: [f64; 2],
    /// Lowest and highest velocity, m/s, over 10 ms.
    pub velocity_range: [f64; 2],
    /// Largest acceleration, m/s², over 10 ms.
    pub largest_acceleration: f64,
    /// Travel between two reversals, m.
    pub amplitude: Option<Spread>,
    /// Turns round.
    pub reversals: usize,
    /// Distance travelled, m.
    pub distance: f64,
    /// Speeds that were held for at least 50 ms, m/s, both directions taken together, slowest
    /// first.
    pub speeds: Vec<f64>,
    /// Time at rest, s: slower than 10 um/s, or than the noise allows to tell.
    pub rest_s: f64,
    /// Stretches of rest of at least 50 ms: shortest, median, longest, s.
    pub rests: Option<Spread>,
    /// How many of them.
    pub rest_count: usize,
    /// Noise of the encoder, m.
    pub encoder_noise: Option<NoiseFound>,
    /// Noise of the force cell, N: of the cell less the command, if there is one.
    pub force_cell_noise: Option<NoiseFound>,
    /// Which signals are recorded.
    pub recorded: Vec<Signal>,
    /// The force cell over the motion.
    pub cell_fit: Option<RoughFit>,
    /// The command over the motion.
    pub command_fit: Option<RoughFit>,
    /// What is wrong, worst first.
    pub problems: Vec<DataProblem>,
    /// What can be identified and what cannot.
    pub judgements: Vec<Judgement>,
}

impl Excitation {
    /// The worst severity, if there is a problem.
    pub fn severity(&self) -> Option<Severity> {
        self.problems.iter().map(DataProblem::severity).max()
    }
}

/// Looks at a recording, against the declared model if there is one.
pub fn examine(recording: &Recording, model: Option<&StageModel>) -> Excitation {
    Examiner::new(recording, model).run()
}

/// The motion at one row, over [`HALF_BASE`] to either side.
struct Moment {
    row: usize,
    velocity: f64,
    acceleration: f64,
}

struct Examiner<'a> {
    recording: &'a Recording,
    model: Option<&'a StageModel>,
    segments: Vec<Range<usize>>,
    /// Rows to either side of a moment.
    half: usize,
    step: f64,
    problems: Vec<DataProblem>,
}

impl<'a> Examiner<'a> {
    fn new(recording: &'a Recording, model: Option<&'a StageModel>) -> Self {
        let half = ((HALF_BASE * recording.rate).round() as usize).max(1);
        Self {
            recording,
            model,
            segments: recording.segments(),
            half,
            step: 1.0 / recording.rate,
            problems: Vec::new(),
        }
    }

    fn column(&self, signal: Signal) -> &'a [f64] {
        self.recording.trace.columns()[signal as usize]
    }

    /// Moments every half base, in the order of time; moments of different pieces never touch.
    fn moments(&self) -> Vec<Moment> {
        let (x, w) = (self.column(Signal::Position), self.half);
        let base = w as f64 * self.step;
        let mut moments = Vec::new();
        for segment in &self.segments {
            for row in (segment.start + w..segment.end.saturating_sub(w)).step_by(w) {
                let (before, here, after) = (x[row - w], x[row], x[row + w]);
                moments.push(Moment {
                    row,
                    velocity: (after - before) / (2.0 * base),
                    acceleration: ((after - here) - (here - before)) / (base * base),
                });
            }
        }
        moments
    }

    fn run(mut self) -> Excitation {
        let has = |signal| self.recording.has(signal);
        let recorded: Vec<Signal> = Signal::ALL.into_iter().filter(|&s| has(s)).collect();
        let (has_cell, has_command) = (has(Signal::ForceCell), has(Signal::Force));
        let x = self.column(Signal::Position);
        let valid_rows = self.recording.quality.valid_rows;
        let encoder_noise = self.encoder_noise();
        let force_cell_noise = self.cell_noise();
        let noise = encoder_noise.map_or(0.0, |n| n.present);
        let moments = self.moments();
        let range = |values: &mut dyn Iterator<Item = f64>| {
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| {
                [low.min(v), high.max(v)]
            })
        };
        let known = |[low, high]: [f64; 2]| if low <= high { [low, high] } else { [0.0, 0.0] };
        let position_range = known(range(&mut x.iter().copied().filter(|v| v.is_finite())));
        let velocity_range = known(range(&mut moments.iter().map(|m| m.velocity)));
        let largest_acceleration = moments.iter().map(|m| m.acceleration.abs()).fold(0.0, f64::max);
        let stroke = position_range[1] - position_range[0];
        // five standard deviations of the velocity's noise
        let rest_speed =
            REST_SPEED.max(5.0 * noise * 0.5f64.sqrt() / (self.half as f64 * self.step));
        let moves = stroke > 20.0 * noise
            && stroke > 0.0
            && moments.iter().any(|m| m.velocity.abs() > rest_speed);
        let (amplitudes, reversals, distance) = self.travel((20.0 * noise).max(1e-7));
        let (speeds, held) = self.speeds(&moments, rest_speed);
        let rests = self.rests(&moments, rest_speed);
        let moving = moments.iter().filter(|m| m.velocity.abs() > rest_speed).count();
        let moment_s = self.half as f64 * self.step;

        self.about_quality();
        let rows = self.segments.iter().map(Range::len).max().unwrap_or(0);
        if rows < LEAST_ROWS {
            let seconds = rows as f64 * self.step;
            self.problems.push(DataProblem::TooShort { rows, seconds, needed: LEAST_ROWS });
        }
        if !moves && rows > 0 {
            self.problems.push(DataProblem::NoMotion { range: stroke, noise });
        }
        let mut usable = [(Signal::ForceCell, has_cell), (Signal::Force, has_command)];
        for (signal, usable) in &mut usable {
            if *usable && moves && self.constant(*signal) {
                *usable = false;
            }
            if *usable {
                self.clipped(*signal);
            }
        }
        self.clipped_position(noise);
        for (signal, is_there) in [(Signal::Position, rows > 0), usable[0], usable[1]] {
            if is_there {
                self.outliers(signal);
            }
        }
        for (signal, is_there) in [(Signal::Position, moves), usable[0], usable[1]] {
            if is_there && moves {
                self.stuck(signal);
            }
        }
        let [(_, cell_usable), (_, command_usable)] = usable;
        match (cell_usable, command_usable) {
            (false, false) => self.problems.push(DataProblem::NoForce),
            (false, true) => self.problems.push(DataProblem::NoForceCell),
            (true, false) => self.problems.push(DataProblem::NoCommand),
            (true, true) => {}
        }
        if !has(Signal::ReferencePosition) {
            self.problems.push(DataProblem::NoSetpoint);
        } else if moves {
            self.constant(Signal::ReferencePosition);
        }
        let (mut cell_fit, mut command_fit) = (None, None);
        if moves {
            if velocity_range[0] > -rest_speed || velocity_range[1] < rest_speed {
                self.problems.push(DataProblem::OneDirection);
            }
            let share = held.iter().map(|(_, time)| time).sum::<f64>() / (moving as f64 * moment_s);
            if let [speed] = speeds[..]
                && share > 0.6
            {
                self.problems.push(DataProblem::OneSpeed { speed, share });
            }
            if cell_usable {
                cell_fit = self.regress(Signal::ForceCell, &moments, rest_speed);
            }
            if command_usable {
                command_fit = self.regress(Signal::Force, &moments, rest_speed);
            }
            self.signs_and_units(cell_fit, command_fit, &moments);
            self.noise(encoder_noise, force_cell_noise);
        }
        self.problems.sort_by_key(|problem| std::cmp::Reverse(problem.severity()));
        let rest_spread = spread(rests.clone());
        let mut excitation = Excitation {
            duration_s: valid_rows as f64 * self.step,
            position_range,
            velocity_range,
            largest_acceleration,
            amplitude: spread(amplitudes),
            reversals,
            distance,
            speeds,
            rest_s: (moments.len() - moving) as f64 * moment_s,
            rests: rest_spread,
            rest_count: rests.len(),
            encoder_noise,
            force_cell_noise,
            recorded,
            cell_fit,
            command_fit,
            problems: self.problems,
            judgements: Vec::new(),
        };
        excitation.judgements = judge(&excitation, self.model);
        excitation
    }

    /// Problems that the quality of the data shows.
    fn about_quality(&mut self) {
        let quality = &self.recording.quality;
        for signal in &quality.signals {
            if signal.not_finite > 0 {
                self.problems.push(DataProblem::NotFinite {
                    signal: signal.signal,
                    samples: signal.not_finite,
                    total: signal.samples,
                });
            }
            if signal.conflicting > 0 {
                self.problems.push(DataProblem::Conflicting {
                    signal: signal.signal,
                    samples: signal.conflicting,
                });
            }
            if !self.recording.has(signal.signal) {
                self.problems
                    .push(DataProblem::Sparse { signal: signal.signal, share: signal.coverage });
            }
        }
        let share = 1.0 - quality.valid_rows as f64 / quality.rows.max(1) as f64;
        // a hundredth is a start before the first command; more of it is worth a word (assumed)
        if share > 0.01 {
            let gaps = quality.signal(Signal::Position).map_or(0, |q| q.gaps);
            self.problems.push(DataProblem::Holes { share, gaps, segments: quality.segments });
        }
        let jitter = quality.signal(Signal::Position).and_then(|q| q.jitter_s).unwrap_or(0.0);
        let treatment = match quality.clock {
            ClockKind::UniformBehindJitter => {
                "the positions are smoother without it, so the samples count as uniform and are \
                 left as they are"
            }
            ClockKind::AtStamps => {
                "the positions follow it, so they are interpolated from their stamps"
            }
            ClockKind::Regular | ClockKind::OtherRate => "",
        };
        // a thousandth of a period moves a carriage at 1 m/s by less than 1 um (assumed)
        if !treatment.is_empty() && jitter > 1e-3 * self.step {
            self.problems.push(DataProblem::Jitter { jitter, treatment });
        }
        if !(100.0..=1e5).contains(&self.recording.rate) {
            self.problems.push(DataProblem::OddRate { rate: self.recording.rate });
        }
    }

    /// Values are as recorded, not interpolated.
    fn is_raw(&self) -> bool {
        matches!(self.recording.quality.clock, ClockKind::Regular | ClockKind::UniformBehindJitter)
    }

    fn encoder_noise(&self) -> Option<NoiseFound> {
        let x = self.column(Signal::Position);
        let present = self.is_raw().then(|| noise(&self.segments, |row| x[row]))??;
        let declared =
            self.model.map(|m| m.encoder.noise.hypot(m.encoder.resolution / 12f64.sqrt()));
        Some(NoiseFound { present, declared, smallest_step: self.smallest_step(x) })
    }

    fn cell_noise(&self) -> Option<NoiseFound> {
        if !self.recording.has(Signal::ForceCell) || !self.is_raw() {
            return None;
        }
        let (cell, command) = (self.column(Signal::ForceCell), self.column(Signal::Force));
        // the cell shows the force of the interval that ends at its row
        let with_command = self.recording.has(Signal::Force);
        let difference = noise(&self.segments, |row| match row {
            0 => f64::NAN,
            row => cell[row] - command[row - 1],
        });
        let alone = noise(&self.segments, |row| cell[row]);
        // a lag, a gain or another unit leaves more in the difference than in the cell alone
        let present = match (alone, difference.filter(|_| with_command)) {
            (Some(alone), Some(difference)) => alone.min(difference),
            (alone, _) => alone?,
        };
        let declared = self.model.map(|m| m.force_cell.noise);
        Some(NoiseFound { present, declared, smallest_step: self.smallest_step(cell) })
    }

    fn smallest_step(&self, column: &[f64]) -> f64 {
        let steps = self
            .segments
            .iter()
            .flat_map(|s| column[s.clone()].windows(2))
            .map(|p| (p[1] - p[0]).abs());
        let least = steps.filter(|d| *d > 0.0).fold(f64::INFINITY, f64::min);
        if least.is_finite() { least } else { 0.0 }
    }

    /// Travel between reversals, number of reversals and distance; a turn by less than `least` is
    /// noise.
    fn travel(&self, least: f64) -> (Vec<f64>, usize, f64) {
        let x = self.column(Signal::Position);
        let (mut amplitudes, mut reversals, mut distance) = (Vec::new(), 0, 0.0);
        for segment in &self.segments {
            let (mut direction, mut turned, mut farthest) =
                (0.0, x[segment.start], x[segment.start]);
            for &here in &x[segment.clone()] {
                let moved = here - farthest;
                if direction == 0.0 {
                    if moved.abs() >= least {
                        direction = moved.signum();
                        farthest = here;
                    }
                } else if moved * direction > 0.0 {
                    farthest = here;
                } else if moved.abs() >= least {
                    amplitudes.push((farthest - turned).abs());
                    distance += (farthest - turned).abs();
                    reversals += 1;
                    direction = -direction;
                    turned = farthest;
                    farthest = here;
                }
            }
            distance += (farthest - turned).abs();
        }
        (amplitudes, reversals, distance)
    }

    /// Speeds that are held, slowest first, and each stretch with its length in s.
    fn speeds(&self, moments: &[Moment], rest_speed: f64) -> (Vec<f64>, Vec<(f64, f64)>) {
        let moment_s = self.half as f64 * self.step;
        let mut stretches: Vec<(f64, f64)> = Vec::new();
        let mut from = 0;
        while from < moments.len() {
            let start = &moments[from];
            // A rest is none, and a long one not to be walked again from each of its moments.
            if start.velocity.abs() <= 3.0 * rest_speed {
                from += 1;
                continue;
            }
            let near = |m: &Moment| {
                (m.velocity - start.velocity).abs()
                    <= 0.02 * start.velocity.abs() + 0.5 * rest_speed
            };
            let mut to = from + 1;
            while to < moments.len()
                && moments[to].row - moments[to - 1].row == self.half
                && near(&moments[to])
            {
                to += 1;
            }
            let time = (to - from) as f64 * moment_s;
            if time >= SHORTEST_STRETCH {
                let mean =
                    moments[from..to].iter().map(|m| m.velocity).sum::<f64>() / (to - from) as f64;
                stretches.push((mean.abs(), time));
                from = to;
            } else {
                from += 1;
            }
        }
        let mut sorted: Vec<f64> = stretches.iter().map(|(speed, _)| *speed).collect();
        sorted.sort_by(f64::total_cmp);
        let mut groups: Vec<Vec<f64>> = Vec::new();
        for speed in sorted {
            match groups.last_mut() {
                Some(group) if speed <= SAME_SPEED * group[0] => group.push(speed),
                _ => groups.push(vec![speed]),
            }
        }
        (groups.iter().map(|group| group[group.len() / 2]).collect(), stretches)
    }

    fn rests(&self, moments: &[Moment], rest_speed: f64) -> Vec<f64> {
        let moment_s = self.half as f64 * self.step;
        let mut rests = Vec::new();
        let mut length = 0usize;
        let mut last = None;
        for moment in moments {
            let follows = last.is_some_and(|row| moment.row - row == self.half);
            last = Some(moment.row);
            let rest = moment.velocity.abs() <= rest_speed;
            if length > 0 && (!rest || !follows) {
                rests.push(length as f64 * moment_s);
                length = 0;
            }
            length += usize::from(rest);
        }
        rests.push(length as f64 * moment_s);
        rests.retain(|rest| *rest >= SHORTEST_STRETCH);
        rests
    }

    /// Whether a signal never changes; said so.
    fn constant(&mut self, signal: Signal) -> bool {
        let mut values = self.column(signal).iter().copied().filter(|v| v.is_finite());
        let Some(value) = values.next() else {
            return false;
        };
        let constant = values.all(|v| v == value);
        if constant {
            self.problems.push(DataProblem::Constant { signal, value });
        }
        constant
    }

    /// Samples that no machine made.
    fn outliers(&mut self, signal: Signal) {
        let rows = self.recording.outliers(signal);
        if let Some(&first) = rows.first() {
            let (value, seconds) = (self.column(signal)[first], first as f64 * self.step);
            self.problems.push(DataProblem::Outliers {
                signal,
                samples: rows.len(),
                value,
                seconds,
            });
        }
    }

    /// Whether a signal that changes with every row elsewhere stops to, although another one shows
    /// that the stage is driven.
    fn stuck(&mut self, signal: Signal) {
        let column = self.column(signal);
        let least = (STUCK.0 * self.recording.rate) as usize;
        let (mut runs, mut row, mut repeats) = (Vec::new(), 0, 0);
        for run in column.chunk_by(|a, b| a == b) {
            // zero for a long time is a motor without a command
            match run.len() > least && run[0] != 0.0 {
                true => runs.push(row..row + run.len()),
                false => repeats += run.len() - 1,
            }
            row += run.len();
        }
        let elsewhere = column.len() - runs.iter().map(Range::len).sum::<usize>();
        if repeats as f64 > STUCK.1 * elsewhere as f64 {
            return;
        }
        // what moves on during a run, by at least a tenth of what it does in all
        let others = match signal {
            Signal::Position => [Signal::ReferencePosition, Signal::ForceCell, Signal::Force],
            _ => [Signal::Position, Signal::ReferencePosition, Signal::ReferenceVelocity],
        };
        let span = |values: &[f64]| {
            let [low, high] = values
                .iter()
                .filter(|value| value.is_finite())
                .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
                    [low.min(*value), high.max(*value)]
                });
            if low < high { high - low } else { 0.0 }
        };
        let recorded = others
            .iter()
            .filter(|other| self.recording.has(**other))
            .map(|other| self.column(*other));
        let recorded: Vec<(&[f64], f64)> =
            recorded.map(|other| (other, 0.1 * span(other).max(f64::MIN_POSITIVE))).collect();
        let driven = |run: &Range<usize>| {
            recorded.iter().any(|(other, least)| span(&other[run.clone()]) > *least)
        };
        let stuck: Vec<Range<usize>> = runs.into_iter().filter(driven).collect();
        for run in stuck {
            let (value, rows) = (column[run.start], run.len());
            // an extreme is told as such
            let told = |problem: &DataProblem| match problem {
                DataProblem::Clipped { signal: other, value: at, .. } => {
                    *other == signal && *at == value
                }
                _ => false,
            };
            if !self.problems.iter().any(told) {
                self.problems.push(DataProblem::Stuck {
                    signal,
                    value,
                    seconds: rows as f64 * self.step,
                    rows,
                });
            }
        }
    }

    /// Whether a force stays at its extreme.
    fn clipped(&mut self, signal: Signal) {
        let column = self.column(signal);
        if let Some(model) = self.model.filter(|_| signal == Signal::Force) {
            let limit = model.motor.force_limit;
            let rows = column.iter().filter(|f| f.abs() >= limit).count();
            if rows > 0 {
                let largest =
                    column.iter().filter(|f| f.is_finite()).fold(0.0f64, |m, f| m.max(f.abs()));
                self.problems.push(DataProblem::Saturated { largest, limit, rows });
                return;
            }
        }
        for (value, rows) in extremes(column) {
            // zero for a long time is a motor without a command, not a limit
            if value != 0.0 && rows >= CLIPPED_RUN {
                self.problems.push(DataProblem::Clipped { signal, value, rows });
            }
        }
    }

    /// Whether the position stops dead at an extreme: from full speed to the very same value within
    /// one row.
    fn clipped_position(&mut self, noise: f64) {
        let x = self.column(Signal::Position);
        // Who reads coarse counts sees one or two at once at any end of a motion.
        let least = (20.0 * noise).max(3.0 * self.smallest_step(x)).max(1e-9);
        for (value, rows) in extremes(x) {
            let arrivals = x
                .windows(4)
                .filter(|w| w[1..].iter().all(|v| *v == value) && (w[1] - w[0]).abs() > least);
            if rows >= CLIPPED_RUN && arrivals.count() > 0 {
                self.problems.push(DataProblem::Clipped { signal: Signal::Position, value, rows });
            }
        }
    }

    /// The force of a column around a moment, with the weights that a second difference gives it.
    fn force_at(&self, column: &[f64], row: usize) -> f64 {
        let w = self.half as isize;
        let mut sum = 0.0;
        for offset in -w + 1..w {
            sum += (w - offset.abs()) as f64 * column[(row as isize + offset) as usize];
        }
        sum / (w * w) as f64
    }

    fn regress(&self, signal: Signal, moments: &[Moment], rest_speed: f64) -> Option<RoughFit> {
        let column = self.column(signal);
        // clear of the bristles' own travel: twenty times the speed that still counts as rest
        let moving = || moments.iter().filter(|m| m.velocity.abs() > 20.0 * rest_speed);
        let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
        let (mut count, mut squares) = (0usize, 0.0);
        // scaled, so that the matrix is well conditioned
        let scale_a = moving().map(|m| m.acceleration.abs()).fold(f64::MIN_POSITIVE, f64::max);
        let scale_v = moving().map(|m| m.velocity.abs()).fold(f64::MIN_POSITIVE, f64::max);
        let row = |m: &Moment| {
            Vector4::new(m.acceleration / scale_a, m.velocity.signum(), m.velocity / scale_v, 1.0)
        };
        for moment in moving() {
            let force = self.force_at(column, moment.row);
            let row = row(moment);
            normal += row * row.transpose();
            right += row * force;
            squares += force * force;
            count += 1;
        }
        if count < 20 || squares == 0.0 {
            return None;
        }
        // one direction or one speed only: the least solution is taken, and told elsewhere
        let inverse = normal.pseudo_inverse(1e-9 * count as f64).ok()?;
        let fit = inverse * right;
        let (mut rest, mut inertial) = (0.0, 0.0);
        for moment in moving() {
            let difference = self.force_at(column, moment.row) - row(moment).dot(&fit);
            rest += difference * difference;
            inertial += (fit[0] * moment.acceleration / scale_a).powi(2);
        }
        let variance = rest / (count as f64 - 4.0);
        Some(RoughFit {
            mass: fit[0] / scale_a,
            mass_deviation: (variance * inverse[(0, 0)]).sqrt() / scale_a,
            coulomb: fit[1],
            viscous: fit[2] / scale_v,
            offset: fit[3],
            explained: 1.0 - rest / squares,
            inertial: inertial / squares,
            by_acceleration_alone: fit[0] * fit[0] / inverse[(0, 0)] / squares,
        })
    }

    /// Slope of one column over another, through zero after means are taken off, and how well it
    /// explains the first.
    fn slope(&self, of: &[f64], over: impl Fn(usize) -> f64) -> Option<(f64, f64)> {
        let rows = || {
            let segments = self.segments.iter().cloned().flatten();
            segments
                .skip(1)
                .map(|row| (of[row], over(row)))
                .filter(|(y, x)| y.is_finite() && x.is_finite())
        };
        let count = rows().count() as f64;
        let (y0, x0) = rows().fold((0.0, 0.0), |(a, b), (y, x)| (a + y, b + x));
        let (y0, x0) = (y0 / count, x0 / count);
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for (y, x) in rows() {
            xx += (x - x0) * (x - x0);
            xy += (x - x0) * (y - y0);
            yy += (y - y0) * (y - y0);
        }
        (xx > 0.0 && yy > 0.0).then(|| (xy / xx, xy * xy / (xx * yy)))
    }

    /// Signs and units, by whatever can be compared: reference and position, cell and command,
    /// force and acceleration.
    fn signs_and_units(
        &mut self,
        cell: Option<RoughFit>,
        command: Option<RoughFit>,
        moments: &[Moment],
    ) {
        let declared = self.model.map(|m| {
            let payload = |effect| match EffectDescriptor::read(effect) {
                Ok((descriptor, values)) => descriptor.constant_mass(&values),
                Err(_) => 0.0,
            };
            m.mass + m.effects.iter().map(payload).sum::<f64>()
        });
        let guides = self.model.and_then(|model| model.resolved_guides().ok());
        let of_guides =
            |value: fn(&Guide) -> f64| Some(guides.as_ref()?.iter().map(value).sum::<f64>());
        let (coulomb, viscous) =
            (of_guides(|guide| guide.coulomb_force), of_guides(|guide| guide.viscous_friction));
        let fits: Vec<(Signal, RoughFit)> = [(Signal::ForceCell, cell), (Signal::Force, command)]
            .into_iter()
            .filter_map(|(s, f)| Some((s, f?)))
            .collect();
        // an explained share below a half is no fit to draw conclusions from (assumed)
        for (signal, fit) in &fits {
            if fit.explained < 0.5 {
                self.problems
                    .push(DataProblem::Unrelated { signal: *signal, share: fit.explained });
            }
        }
        // at one speed all acceleration is where the motion begins and ends, and what the bristles
        // do there passes for a mass
        let one_speed =
            self.problems.iter().any(|problem| matches!(problem, DataProblem::OneSpeed { .. }));
        let is_clear = |fit: &RoughFit| !one_speed && fit.knows_the_mass() && fit.explained >= 0.5;
        let clear: Vec<(Signal, RoughFit)> =
            fits.into_iter().filter(|(_, fit)| is_clear(fit)).collect();
        let all = !clear.is_empty();
        let mut told = false;
        // signs
        let negative: Vec<&(Signal, RoughFit)> =
            clear.iter().filter(|(_, f)| f.mass < 0.0).collect();
        let reference = self.reference_slope();
        let against = |fit: &RoughFit| format!("force over acceleration gives {:.4} kg", fit.mass);
        if all
            && negative.len() == clear.len()
            && (clear.len() == 2 || reference.is_some_and(|s| s < 0.0))
        {
            let alone = if reference.is_some_and(|s| s < 0.0) {
                ""
            } else {
                ", unless it is every force that has it"
            };
            let evidence = against(&negative[0].1) + alone;
            self.problems.push(DataProblem::SwappedSign { signal: Signal::Position, evidence });
            told = true;
        } else {
            for (signal, fit) in &negative {
                self.problems
                    .push(DataProblem::SwappedSign { signal: *signal, evidence: against(fit) });
                told = true;
            }
        }
        // units of the forces and of the position against the declared mass; a signal that is cut
        // off has another mass for that
        let cut =
            self.problems.iter().any(|problem| matches!(problem, DataProblem::Clipped { .. }));
        if let Some(declared) = declared {
            let ratios: Vec<(Signal, RoughFit, f64)> =
                clear.iter().map(|(s, f)| (*s, *f, f.mass.abs() / declared)).collect();
            let position_unit = ratios.first().and_then(|(_, fit, ratio)| {
                let same = ratios.iter().all(|(_, _, other)| (other / ratio).ln().abs() < 0.3);
                let friction: f64 = coulomb?;
                let fits = (0.2..5.0).contains(&(fit.coulomb.abs() / friction));
                let (unit, signal) = position_unit(*ratio)?;
                let in_velocities = if signal == Signal::Time { ratio.sqrt() } else { *ratio };
                let fits = fits && !is_as_declared(fit.viscous, viscous?, in_velocities);
                (same && fits && !cut).then_some((unit, signal, *fit))
            });
            if let Some((unit, signal, fit)) = position_unit {
                let evidence = format!(
                    "force over acceleration gives {:.4e} kg where {declared:.4} kg is declared, \
                     and Coulomb friction is right",
                    fit.mass.abs()
                );
                self.problems.push(DataProblem::WrongUnit { signal, unit: unit.into(), evidence });
                told = true;
            } else {
                for (signal, fit, ratio) in &ratios {
                    if let Some(unit) = force_unit(*ratio).filter(|_| {
                        !cut && !coulomb
                            .is_some_and(|coulomb| is_as_declared(fit.coulomb, coulomb, *ratio))
                    }) {
                        let evidence = format!(
                            "force over acceleration gives {:.4e} kg where {declared:.4} kg is \
                             declared",
                            fit.mass.abs()
                        );
                        self.problems.push(DataProblem::WrongUnit {
                            signal: *signal,
                            unit: unit.into(),
                            evidence,
                        });
                        told = true;
                    }
                }
                let (_, fit, ratio) = match ratios.first() {
                    Some(first) => first,
                    None => return self.cell_and_command(told, moments),
                };
                if !told && !(0.8..1.25).contains(ratio) {
                    self.problems.push(DataProblem::OtherMachine {
                        declared,
                        measured: fit.mass,
                        deviation: fit.mass_deviation,
                    });
                }
                if let Some(friction) = coulomb.filter(|f| *f > 0.0 && self.slides())
                    && !told
                    && !(0.4..2.5).contains(&(fit.coulomb / friction))
                {
                    self.problems.push(DataProblem::OtherFriction {
                        declared: friction,
                        measured: fit.coulomb,
                    });
                }
            }
        }
        self.cell_and_command(told, moments);
    }

    /// Whether the stage goes so far that its guides slide most of the way: within their break-away
    /// distances they only spring.
    fn slides(&self) -> bool {
        let guides = self.model.and_then(|model| model.resolved_guides().ok()).unwrap_or_default();
        let longest =
            guides.iter().map(|guide| guide.static_force / guide.stiffness).fold(0.0, f64::max);
        let finite = || self.column(Signal::Position).iter().copied().filter(|x| x.is_finite());
        let span =
            finite().fold(f64::NEG_INFINITY, f64::max) - finite().fold(f64::INFINITY, f64::min);
        span > SLIDES * longest
    }

    fn reference_slope(&self) -> Option<f64> {
        if !self.recording.has(Signal::ReferencePosition) {
            return None;
        }
        let reference = self.column(Signal::ReferencePosition);
        let (slope, explained) = self.slope(self.column(Signal::Position), |row| reference[row])?;
        (explained > 0.9).then_some(slope)
    }

    /// Signals that should be the same: cell and command, position and reference, and the
    /// references among themselves.
    fn cell_and_command(&mut self, told: bool, _moments: &[Moment]) {
        let mut disagree = |first: Signal, second: Signal, slope: f64| {
            if (0.5..2.0).contains(&slope) {
                return;
            }
            let evidence = format!(
                "{first} goes with {slope:.4e} times {second}; a sign or a unit of one of them is \
                 wrong"
            );
            self.problems.push(DataProblem::Disagree { first, second, evidence });
        };
        let trace = &self.recording.trace;
        let examiner = Examiner { problems: Vec::new(), segments: self.segments.clone(), ..*self };
        if !told
            && examiner.recording.has(Signal::ForceCell)
            && examiner.recording.has(Signal::Force)
        {
            // the cell shows a command one row later
            let apart = |ahead: usize, behind: usize| {
                let pairs = trace.force_cell[ahead..].iter().zip(&trace.force[behind..]);
                pairs
                    .map(|(cell, command)| (cell - command).powi(2))
                    .filter(|square| square.is_finite())
                    .sum::<f64>()
            };
            let (behind, ahead) = (apart(1, 0).sqrt(), apart(0, 1).sqrt());
            if ahead < SWAPPED * behind {
                let (first, second) = (Signal::ForceCell, Signal::Force);
                let evidence = format!(
                    "the cell shows each command a sample before it is given, {:.1} times as well \
                     as a sample behind it: they are swapped, or the stamps of the command are \
                     late",
                    behind / ahead
                );
                self.problems.push(DataProblem::Disagree { first, second, evidence });
                return;
            }
            let slope = examiner.slope(&trace.force_cell, |row| trace.force[row.max(1) - 1]);
            if let Some((slope, _)) = slope.filter(|(_, explained)| *explained > 0.5) {
                disagree(Signal::ForceCell, Signal::Force, slope);
            }
        }
        if let Some(slope) = examiner.reference_slope() {
            disagree(Signal::Position, Signal::ReferencePosition, slope);
        }
        let derivatives = [
            (Signal::ReferenceVelocity, Signal::ReferencePosition),
            (Signal::ReferenceAcceleration, Signal::ReferenceVelocity),
        ];
        for (rate, of) in derivatives {
            if !examiner.recording.has(rate) || !examiner.recording.has(of) {
                continue;
            }
            let (column, rate_column) = (examiner.column(of), examiner.column(rate));
            let derivative = |row: usize| match (row.checked_sub(1), column.get(row + 1)) {
                (Some(before), Some(after)) => (after - column[before]) / (2.0 * examiner.step),
                _ => f64::NAN,
            };
            if let Some((slope, _)) =
                examiner.slope(rate_column, derivative).filter(|(_, explained)| *explained > 0.9)
                && !(0.8..1.25).contains(&slope)
            {
                disagree(rate, of, slope);
            }
        }
    }

    fn noise(&mut self, encoder: Option<NoiseFound>, cell: Option<NoiseFound>) {
        let found = [(Signal::Position, "m", encoder), (Signal::ForceCell, "N", cell)];
        for (signal, unit, found) in found {
            let Some(NoiseFound { present, declared: Some(declared), .. }) = found else {
                continue;
            };
            let consequence = if present > 2.0 * declared {
                "the noise floor is higher than the model says; small effects are hidden"
            } else if present < 0.5 * declared {
                "the signal is filtered, or the declaration is too careful; residuals may be \
                 overlooked"
            } else {
                continue;
            };
            self.problems.push(DataProblem::Noise { signal, unit, present, declared, consequence });
        }
    }
}

/// Standard deviation of white noise, from sixth differences: the median over blocks of their mean
/// squares, so that edges of the motion do not count. The sum of squares of the binomial
/// coefficients of order 6 is 924.
fn noise(segments: &[Range<usize>], value: impl Fn(usize) -> f64) -> Option<f64> {
    const BLOCK: usize = 64;
    let mut blocks = Vec::new();
    for segment in segments {
        let mut from = segment.start;
        while from + BLOCK + 6 <= segment.end {
            let x: Vec<f64> = (from..from + BLOCK + 6).map(&value).collect();
            let squares: f64 = x
                .windows(7)
                .map(|x| (x[0] + x[6]) - 6.0 * (x[1] + x[5]) + 15.0 * (x[2] + x[4]) - 20.0 * x[3])
                .map(|d| d * d)
                .sum();
            if squares.is_finite() {
                blocks.push(squares / BLOCK as f64 / 924.0);
            }
            from += BLOCK;
        }
    }
    if blocks.is_empty() {
        return None;
    }
    let middle = blocks.len() / 2;
    Some(blocks.select_nth_unstable_by(middle, f64::total_cmp).1.sqrt())
}

/// Lowest and highest value with the rows that have it in runs of at least [`CLIPPED_RUN`] times
/// those that half of the other rows are in: a signal of a lower rate stays with each of its values
/// for some rows, one in coarse counts for many.
fn extremes(column: &[f64]) -> [(f64, usize); 2] {
    let finite = || column.iter().copied().filter(|v| v.is_finite());
    let extremes =
        [finite().fold(f64::INFINITY, f64::min), finite().fold(f64::NEG_INFINITY, f64::max)];
    let others = column.chunk_by(|a, b| a == b).filter(|run| !extremes.contains(&run[0]));
    let mut lengths: Vec<usize> = others.map(<[f64]>::len).collect();
    lengths.sort_unstable();
    let (all, mut rows) = (lengths.iter().sum::<usize>(), 0);
    let is_half = |length: &&usize| {
        rows += **length;
        2 * rows >= all
    };
    let usual = lengths.iter().find(is_half).copied().unwrap_or(1);
    extremes.map(|extreme| {
        let runs = column.chunk_by(|a, b| (*a == extreme) == (*b == extreme));
        let at = runs.filter(|run| run[0] == extreme && run.len() >= CLIPPED_RUN * usual);
        (extreme, at.map(<[f64]>::len).sum())
    })
}

/// Unit of a force whose apparent mass is `ratio` times the declared one.
fn force_unit(ratio: f64) -> Option<&'static str> {
    // a factor of a thousand leaves room for a wrong model, a small factor does not
    let units = [
        ("kN", 1e-3, 2.0),
        ("mN", 1e3, 2.0),
        ("lbf", 1.0 / 4.448_221_615_260_5, 1.08),
        ("kgf", 1.0 / 9.80665, 1.08),
    ];
    units
        .into_iter()
        .find(|(_, factor, tolerance)| within(ratio, *factor, *tolerance))
        .map(|(unit, ..)| unit)
}

/// Unit of a position, or of the time, whose apparent mass is `ratio` times the declared one.
fn position_unit(ratio: f64) -> Option<(&'static str, Signal)> {
    let units = [
        ("mm", Signal::Position, 1e-3, 2.0),
        ("um", Signal::Position, 1e-6, 2.0),
        ("in", Signal::Position, 0.0254, 1.08),
        ("ms", Signal::Time, 1e6, 2.0),
        ("us", Signal::Time, 1e12, 2.0),
    ];
    let found =
        units.into_iter().find(|(_, _, factor, tolerance)| within(ratio, *factor, *tolerance));
    found.map(|(unit, signal, ..)| (unit, signal))
}

/// Whether friction is nearer to what is declared than to what a wrong unit would make of that, a
/// factor: then the mass is not the declared one, and the unit right.
fn is_as_declared(measured: f64, declared: f64, by_unit: f64) -> bool {
    let ratio = measured.abs() / declared;
    // Where none is declared it says nothing.
    ratio > 0.0 && ratio.is_finite() && ratio.ln().abs() < (ratio / by_unit).ln().abs()
}

fn within(value: f64, of: f64, tolerance: f64) -> bool {
    (of / tolerance..of * tolerance).contains(&value)
}

/// A number to three digits.
fn short(value: f64) -> String {
    if (1e-3..1e4).contains(&value.abs()) {
        let decimals = (2 - value.abs().log10().floor() as i32).max(0) as usize;
        format!("{value:.decimals$}")
    } else {
        format!("{value:.2e}")
    }
}

fn spread(mut values: Vec<f64>) -> Option<Spread> {
    values.sort_by(f64::total_cmp);
    let (&least, &largest) = (values.first()?, values.last()?);
    Some(Spread { least, median: values[values.len() / 2], largest })
}

/// What the data can and cannot tell.
fn judge(found: &Excitation, model: Option<&StageModel>) -> Vec<Judgement> {
    let has = |signal: Signal| found.recorded.contains(&signal);
    let fatal = found.problems.iter().any(|p| p.severity() == Severity::Fatal);
    let problem = |wanted: fn(&DataProblem) -> bool| found.problems.iter().any(wanted);
    let one_direction = problem(|p| matches!(p, DataProblem::OneDirection));
    let fit = found.cell_fit.or(found.command_fit);
    let fastest = found.velocity_range.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let mut judgements = Vec::new();
    let mut say = |subject: &'static str, possible: bool, because: String| {
        judgements.push(Judgement { subject, possible: possible && !fatal, because });
    };
    let inertial = fit.map_or(0.0, |f| f.inertial);
    say(
        "mass",
        inertial > 0.01,
        match fit {
            Some(f) => format!(
                "acceleration reaches {:.3} m/s^2 and brings {:.1} % of the force; a rough fit \
                 gives {:.4} +- {:.4} kg",
                found.largest_acceleration,
                100.0 * f.inertial,
                f.mass,
                f.mass_deviation
            ),
            None => "there is no force over a motion".into(),
        },
    );
    let speeds: Vec<String> = found.speeds.iter().copied().map(short).collect();
    let speeds = if speeds.is_empty() {
        "none held".to_owned()
    } else {
        format!("{} m/s", speeds.join(", "))
    };
    let one_speed = problem(|p| matches!(p, DataProblem::OneSpeed { .. }));
    say(
        "Coulomb friction",
        fit.is_some() && !one_direction,
        format!("{} reversals", found.reversals),
    );
    say(
        "viscous friction",
        fit.is_some() && !one_speed,
        format!("velocities up to {fastest:.4} m/s; speeds that are held: {speeds}"),
    );
    let declared = model
        .and_then(|m| m.resolved_guides().ok())
        .map(|guides| guides.iter().map(|g| g.stribeck_velocity).fold(f64::INFINITY, f64::min));
    let stribeck = declared.unwrap_or(USUAL_STRIBECK_VELOCITY);
    let source = if declared.is_some() { "" } else { " (assumed: no model declares one)" };
    let slow = found.speeds.iter().copied().find(|s| *s < stribeck);
    say(
        "Stribeck curve",
        fit.is_some() && slow.is_some() && fastest > 3.0 * stribeck,
        match slow {
            Some(slow) => {
                format!(
                    "it is held at {slow:.2e} m/s, below the Stribeck velocity of {stribeck:.1e} \
                     m/s{source}"
                )
            }
            None => format!(
                "no speed below the Stribeck velocity of {stribeck:.1e} m/s{source} is held, so \
                 only reversals pass through it"
            ),
        },
    );
    say(
        "bristle stiffness",
        fit.is_some() && found.reversals >= 2,
        format!("{} reversals pass through pre-sliding", found.reversals),
    );
    say(
        "difference between directions",
        fit.is_some() && !one_direction,
        format!(
            "velocities from {:.4} to {:.4} m/s",
            found.velocity_range[0], found.velocity_range[1]
        ),
    );
    say(
        "motor-side effects (cogging, force ripple, gain, lag)",
        has(Signal::ForceCell)
            && has(Signal::Force)
            && found.cell_fit.is_some()
            && found.command_fit.is_some(),
        match (has(Signal::ForceCell), has(Signal::Force)) {
            (true, true) => "force cell and command are there".into(),
            (true, false) => "there is no command".into(),
            (false, _) => {
                "there is no force cell: they cannot be told from carriage-side effects".into()
            }
        },
    );
    let stroke = found.position_range[1] - found.position_range[0];
    say(
        "effects over position",
        fit.is_some() && stroke > 0.0 && found.reversals >= 1,
        format!("periods up to {:.4} m fit twice into the stroke of {stroke:.4} m", 0.5 * stroke),
    );
    say(
        "position or time as the cause of a periodic force",
        fit.is_some() && !one_speed,
        format!("speeds that are held: {speeds}"),
    );
    let rests = found.rests.filter(|r| r.largest > 2.0 * r.least && r.largest > 0.2);
    say(
        "stiction that grows at rest",
        fit.is_some() && rests.is_some() && found.rest_count >= 4,
        match found.rests {
            Some(r) => {
                format!("{} rests of {:.2} to {:.2} s", found.rest_count, r.least, r.largest)
            }
            None => "the carriage never rests".into(),
        },
    );
    say(
        "warm-up",
        fit.is_some() && found.duration_s > 10.0 && found.distance > 4.0 * stroke,
        format!("{:.1} s and {:.2} m travelled", found.duration_s, found.distance),
    );
    say(
        "closed loop",
        has(Signal::ReferencePosition),
        if has(Signal::ReferencePosition) {
            "the setpoint is there"
        } else {
            "there is no setpoint"
        }
        .into(),
    );
    judgements
}

impl fmt::Display for Excitation {
    /// Tells it in plain sentences.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = self.recorded.iter().map(|s| s.name()).collect();
        writeln!(f, "signals: {}; {:.3} s of usable rows", names.join(", "), self.duration_s)?;
        writeln!(
            f,
            "motion: {} to {} m, {} to {} m/s, up to {} m/s^2; {} reversals, {} m travelled, {:.2} \
             s at rest",
            short(self.position_range[0]),
            short(self.position_range[1]),
            short(self.velocity_range[0]),
            short(self.velocity_range[1]),
            short(self.largest_acceleration),
            self.reversals,
            short(self.distance),
            self.rest_s
        )?;
        let speeds: Vec<String> = self.speeds.iter().copied().map(short).collect();
        writeln!(
            f,
            "speeds held for 50 ms or more: {}",
            if speeds.is_empty() {
                "none".into()
            } else {
                format!("{} ({} m/s)", speeds.len(), speeds.join(", "))
            }
        )?;
        if let Some(a) = self.amplitude {
            writeln!(
                f,
                "travel between reversals: {} to {} m, median {} m",
                short(a.least),
                short(a.largest),
                short(a.median)
            )?;
        }
        let noises =
            [("encoder", "m", self.encoder_noise), ("force cell", "N", self.force_cell_noise)];
        for (name, unit, found) in noises {
            if let Some(found) = found {
                let declared = found.declared.map_or_else(
                    || "no model declares how much it should be".into(),
                    |declared| format!("{} {unit} is declared", short(declared)),
                );
                writeln!(
                    f,
                    "noise of the {name}: {} {unit} rms, {declared}",
                    short(found.present)
                )?;
            }
        }
        for judgement in &self.judgements {
            let verdict =
                if judgement.possible { "can be identified" } else { "cannot be identified" };
            writeln!(f, "{}: {verdict} ({})", judgement.subject, judgement.because)?;
        }
        for problem in &self.problems {
            let severity = match problem.severity() {
                Severity::Fatal => "fatal",
                Severity::Warning => "warning",
            };
            writeln!(f, "{severity}: {problem}")?;
        }
        Ok(())
    }
}
