//! What a recording can identify and what not: the motion that it covers, the noise that is in it,
//! and what is wrong with it.
//!
//! What comes in is a [`Recording`] and, if there is one, the declared model; what goes out is an
//! [`Excitation`] with figures, [`DataFinding`]s and a [`Judgement`] per kind of parameter. Nothing
//! is fitted finely here: one linear regression of the force on acceleration, direction and
//! velocity shows signs, units and sizes.

mod judgement;
mod motion;
mod noise;
mod presliding;
mod regression;
mod repeats;
mod signals;
mod units;
mod wraps;

use std::ops::Range;

use serde::Serialize;

use super::finding::{DataFinding, Severity};
use crate::signals::{Recording, Signal};
use friction_stage_core::model::{JointType, StageModel};
use friction_stage_core::numerics::correlation::correlation_length;
use friction_stage_core::numerics::noise::white_noise;
use friction_stage_core::numerics::steady_state::steady_from;

pub use judgement::{Judgement, JudgementBasis, Obstacle, Subject};
pub use presliding::Presliding;

/// Least rows in one piece. Assumed: some fifty parameters' worth of filtered samples.
const LEAST_ROWS: usize = 500;

/// Half of the time over which velocity and acceleration are taken, s. Assumed: short against a 60
/// Hz loop's 17 ms period, long enough that 1 nm of noise is 0.1 mm/s² of acceleration.
const HALF_BASE: f64 = 5e-3;

/// Part of the rms of the acceleration that noise may make up, and part of the time between two
/// reversals that half of the base may last: it grows within the latter until the former holds.
/// Assumed: noise of a tenth makes a mass by 1 % too small.
const NOISE_IN_ACCELERATION: f64 = 0.1;
const LONGEST_BASE: f64 = 0.05;

/// Slower than this, m/s, the carriage rests. Assumed: a hundredth of a usual Stribeck velocity of
/// 1 mm/s and more.
const REST_SPEED: f64 = 1e-5;

/// Least, median and largest of something.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// The least.
    pub least: f64,
    /// The one in the middle.
    pub median: f64,
    /// The largest.
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
    /// Its standard deviation, kg: neighbours whose residuals are alike count as one datum;
    /// infinite (`null` in JSON) where there are too few.
    pub mass_deviation: f64,
    /// Mass that either half of the data gives by itself, kg.
    #[serde(skip)]
    pub masses_of_halves: [f64; 2],
    /// Mass and its standard deviation, kg, where a force over the position is allowed
    /// for: a cable chain, a spring, a slope.
    pub mass_with_spring: [f64; 2],
    /// Coulomb friction, N.
    pub coulomb: f64,
    /// Its standard deviation, N, in the same way.
    pub coulomb_deviation: f64,
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
    /// Share of the mean square of the acceleration that is noise of the encoder.
    pub apparent_acceleration: f64,
}

/// What a recording covers and can identify.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Excitation {
    /// Joint type, of which the units are: the model's, else that of the recording's units.
    pub joint: JointType,
    /// Length of the valid rows, s.
    pub duration_s: f64,
    /// Lowest and highest position, m.
    pub position_range: [f64; 2],
    /// Lowest and highest velocity, m/s, over 10 ms, or longer where the encoder is noisy.
    pub velocity_range: [f64; 2],
    /// Largest acceleration, m/s², over 10 ms, or longer where the encoder is noisy.
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
    /// Time at rest, s: slower than 10 µm/s, or than the noise allows to tell.
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
    #[serde(rename = "problems")]
    pub findings: Vec<DataFinding>,
    /// Speed, m/s, above which the carriage clearly moves: no noise, and no spring of the bristles.
    pub clear_speed: f64,
    /// What the encoder sees of the pre-sliding, where anything shows how long that is.
    #[serde(skip)]
    pub presliding: Option<Presliding>,
    /// What can be identified and what cannot.
    #[serde(skip)]
    pub judgements: Vec<Judgement>,
}

impl Excitation {
    /// Highest minus lowest position, m.
    pub fn stroke(&self) -> f64 {
        self.position_range[1] - self.position_range[0]
    }

    /// The worst severity, if anything was found.
    pub fn severity(&self) -> Option<Severity> {
        self.findings.iter().map(DataFinding::severity).max()
    }
}

/// Examines a recording, against the declared model if there is one.
pub fn examine(recording: &Recording, model: Option<&StageModel>) -> Excitation {
    Examiner::new(recording, model).run()
}

/// A stretch at a speed that is held, with the force that it takes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct HeldSpeed {
    /// Mean velocity, m/s.
    pub velocity: f64,
    /// Mean force of the cell, N; of the command, where there is no cell.
    pub force: f64,
    /// Standard deviation of this mean, N, from the scatter within the stretch.
    pub deviation: f64,
    /// Length of the stretch without the transient, s.
    pub duration_s: f64,
}

/// The stretches of a recording at held speeds.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct HeldSpeeds {
    /// With a force that is steady after a transient, which is left out; in the order of time.
    pub steady: Vec<HeldSpeed>,
    /// How many others there are: their force drifts up to the end, as in presliding.
    pub drifting: usize,
}

/// The stretches of a recording at held speeds; none where no force is recorded. The force of the
/// acceleration, which is near 0 there, is part of the mean.
pub fn held_speeds(recording: &Recording) -> HeldSpeeds {
    // A speed is held by its mean over a stretch, in which the noise of a measured one is no rest.
    let examiner = Examiner { velocity_noise: 0.0, ..Examiner::new(recording, None) };
    let signal = match recording.has(Signal::ForceCell) {
        true => Signal::ForceCell,
        false => Signal::Force,
    };
    let mut found = HeldSpeeds::default();
    if !recording.has(signal) {
        return found;
    }
    let noise = examiner.encoder_noise().map_or(0.0, |n| n.present);
    let turn = smallest_turn(noise);
    let (_, reversals, _) = examiner.travel(turn);
    let examiner = Examiner { half: examiner.half_base(noise, reversals), ..examiner };
    let held = examiner.held(&examiner.moments(turn), examiner.rest_speed(noise));
    let force = examiner.column(signal);
    for stretch in &held {
        let values: Vec<f64> =
            force[stretch.rows.clone()].iter().copied().filter(|f| f.is_finite()).collect();
        if values.len() < 2 {
            continue;
        }
        // A force that changes along the way is none of the transient.
        let rows = motion::STEADY / (stretch.velocity.abs() * examiner.step);
        let most = if examiner.loading() > 0.0 { rows.ceil() as usize } else { 0 };
        let Some(from) = steady_from(&values, most) else {
            found.drifting += 1;
            continue;
        };
        let steady = &values[from..];
        let count = steady.len() as f64;
        let mean = steady.iter().sum::<f64>() / count;
        let from_mean: Vec<f64> = steady.iter().map(|f| f - mean).collect();
        let squares: f64 = from_mean.iter().map(|f| f * f).sum();
        let variance = squares / (count - 1.0) * correlation_length(&from_mean) / count;
        found.steady.push(HeldSpeed {
            velocity: stretch.velocity,
            force: mean,
            deviation: variance.sqrt(),
            duration_s: stretch.time * count / values.len() as f64,
        });
    }
    found
}

/// A turn round by less than this, m, is noise of this standard deviation, m.
fn smallest_turn(noise: f64) -> f64 {
    (20.0 * noise).max(1e-7)
}

struct Examiner<'a> {
    recording: &'a Recording,
    model: Option<&'a StageModel>,
    segments: Vec<Range<usize>>,
    /// Rows to either side of a moment.
    half: usize,
    step: f64,
    /// White noise of the velocity, m/s, where that was measured and the position is its integral.
    velocity_noise: f64,
    findings: Vec<DataFinding>,
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
            velocity_noise: white_noise(&recording.velocity).unwrap_or(0.0),
            findings: Vec::new(),
        }
    }

    /// Speed, m/s, up to which the carriage may rest: five standard deviations of the velocity's
    /// noise, where the encoder's is `noise`, m.
    fn rest_speed(&self, noise: f64) -> f64 {
        let of_positions = noise * 0.5f64.sqrt() / (self.half as f64 * self.step);
        // A measured velocity is the mean over the base.
        let of_velocities = self.velocity_noise / (2.0 * self.half as f64).sqrt();
        REST_SPEED.max(5.0 * of_positions.max(of_velocities))
    }

    /// The joint type: the model's, else that of the recording's units.
    fn joint(&self) -> JointType {
        self.model.map(|model| model.joint).or(self.recording.joint).unwrap_or_default()
    }

    fn column(&self, signal: Signal) -> &'a [f64] {
        self.recording.trace.columns()[signal as usize]
    }

    /// The signal that the motion was recorded by: the position, or a velocity of which it is the
    /// integral.
    fn measured(&self) -> (Signal, &'a [f64]) {
        match self.recording.velocity.as_slice() {
            [] => (Signal::Position, self.column(Signal::Position)),
            velocity => (Signal::Velocity, velocity),
        }
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
        let turn = smallest_turn(noise);
        let (amplitudes, reversals, distance) = self.travel(turn);
        self.half = self.half_base(noise, reversals);
        let moments = self.moments(turn);
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
        let rest_speed = self.rest_speed(noise);
        let moves = stroke > 20.0 * noise
            && stroke > 0.0
            && moments.iter().any(|m| m.velocity.abs() > rest_speed);
        let held = self.held(&moments, rest_speed);
        let speeds = motion::speeds(&held);
        let rests = self.rests(&moments, rest_speed);
        let moving = moments.iter().filter(|m| m.velocity.abs() > rest_speed).count();
        let moment_s = self.half as f64 * self.step;

        let recorded_joint = self.recording.joint;
        let joint = self.joint();
        if let Some(recorded) = recorded_joint.filter(|recorded| *recorded != joint) {
            self.findings.push(DataFinding::OtherJoint { declared: joint, recorded });
        }
        self.about_quality();
        let rows = self.segments.iter().map(Range::len).max().unwrap_or(0);
        if rows < LEAST_ROWS {
            let seconds = rows as f64 * self.step;
            self.findings.push(DataFinding::TooShort { rows, seconds, needed: LEAST_ROWS });
        }
        if !moves && rows >= LEAST_ROWS {
            self.findings.push(if moments.is_empty() {
                let seconds = rows as f64 * self.step;
                DataFinding::TooBrief { seconds, needed: 2.0 * HALF_BASE }
            } else {
                let [backward, forward] = velocity_range;
                let fastest = backward.abs().max(forward.abs());
                DataFinding::NoMotion { range: stroke, noise, fastest, rest_speed }
            });
        }
        let mut usable = [(Signal::ForceCell, has_cell), (Signal::Force, has_command)];
        for (signal, usable) in &mut usable {
            if *usable && moves && self.constant(*signal) {
                *usable = false;
            }
        }
        if usable[0].1 {
            self.dead_cell();
        }
        if usable[1].1 {
            self.saturated();
        }
        let wraps = self.wraps();
        if !wraps {
            self.dead_encoder();
            self.possible_motion(&moments);
        }
        for (signal, is_there) in [(Signal::Position, rows > 0), usable[0], usable[1]] {
            if is_there {
                self.outliers(signal);
            }
        }
        let [(_, cell_usable), (_, command_usable)] = usable;
        match (cell_usable, command_usable) {
            (false, false) if self.force_is_unused() => {
                self.findings.push(DataFinding::ForceUnused);
            }
            (false, false) => self.findings.push(DataFinding::NoForce),
            (false, true) => self.findings.push(DataFinding::NoForceCell),
            (true, false) => self.findings.push(DataFinding::NoCommand),
            (true, true) => {}
        }
        if !has(Signal::ReferencePosition) {
            self.findings.push(DataFinding::NoSetpoint);
        } else if moves {
            self.constant(Signal::ReferencePosition);
        }
        let (mut cell_fit, mut command_fit) = (None, None);
        if moves {
            if velocity_range[0] > -rest_speed || velocity_range[1] < rest_speed {
                self.findings.push(DataFinding::OneDirection);
            }
            let loaded = |m: &&motion::Moment| {
                m.velocity.abs() > rest_speed && m.since_turn >= self.loading()
            };
            let loaded = moments.iter().filter(loaded).count().max(1);
            let share = held.iter().map(|h| h.time).sum::<f64>() / (loaded as f64 * moment_s);
            if let [speed] = speeds[..]
                && share > 0.6
            {
                self.findings.push(DataFinding::OneSpeed { speed, share });
            }
            if cell_usable {
                cell_fit = self.regress(Signal::ForceCell, &moments, rest_speed, noise);
            }
            if command_usable {
                command_fit = self.regress(Signal::Force, &moments, rest_speed, noise);
            }
            self.signs_and_units(cell_fit, command_fit);
            self.noise(encoder_noise, force_cell_noise);
        }
        let fit = cell_fit.map(|fit| (Signal::ForceCell, fit));
        let fit = fit.or(command_fit.map(|fit| (Signal::Force, fit)));
        let presliding = self.presliding(fit, noise, turn);
        self.findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity()));
        let rest_spread = spread(rests.clone());
        let mut excitation = Excitation {
            joint,
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
            findings: self.findings,
            clear_speed: clear_speed(rest_speed),
            presliding,
            judgements: Vec::new(),
        };
        excitation.judgements = judgement::judge(&excitation, self.model);
        excitation
    }
}

/// Speed, m/s, above which the carriage clearly moves, by the one up to which it may rest: the
/// bristles spring no faster.
fn clear_speed(rest_speed: f64) -> f64 {
    rest_speed.max(20.0 * REST_SPEED)
}

/// What white noise of standard deviation `noise`, m, makes of an acceleration over `base` to
/// either side, s.
fn rms_of_acceleration_noise(noise: f64, base: f64) -> f64 {
    6f64.sqrt() * noise / (base * base)
}

fn spread(mut values: Vec<f64>) -> Option<Spread> {
    values.sort_by(f64::total_cmp);
    let (&least, &largest) = (values.first()?, values.last()?);
    Some(Spread { least, median: values[values.len() / 2], largest })
}
