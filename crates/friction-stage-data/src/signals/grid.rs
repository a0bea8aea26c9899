//! The uniform grid that the samples of the position define, and how their stamps lie on it.
//!
//! What comes in are stamps and positions; what goes out is a [`Grid`]: an origin, a step, and
//! whether the values may stay as they were recorded.

use std::ops::Range;

use serde::Serialize;

use super::error::SignalError;
use super::mapping::Signal;
use super::resample::{MOST_MISSING, pauses};

/// Stamps within this of the grid, ns, are on it: they are rounded to 1 ns, and so is the grid.
pub(super) const ON_GRID_NS: f64 = 2.0;
/// Rows that a grid may always have; beyond, at most [`MOST_ROWS_PER_SAMPLE`] per sample.
const ROWS_ALLOWED: u64 = 5_000_000;
/// Rows per sample beyond which a recording is mostly holes.
const MOST_ROWS_PER_SAMPLE: u64 = 3;
/// Part by which a rate that is asked for may differ from that of the samples and be the same:
/// between it and a clock that is off by as much, or stamps that jitter, nothing is to be
/// interpolated. Assumed: ten times what a quartz is off.
const SAME_RATE: f64 = 1e-3;
/// How fast the phase of a sampling clock behind jittering stamps is followed, per sample. Assumed:
/// slow against jitter, fast against the drift of a quartz (100 ppm).
const PHASE_GAIN: f64 = 0.01;

/// Share of the samples that a clock must number one after the other, and part of the square of the
/// fourth difference that may be left, for a clock that the usual interval does not show. Assumed.
const MOSTLY: f64 = 0.8;
const MUCH_SMOOTHER: f64 = 0.5;

/// How the samples of the position lie in time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ClockKind {
    /// All stamps are on a uniform grid: values are as recorded.
    Regular,
    /// Stamps jitter, and the positions are smoother if taken as uniform: the samples were uniform,
    /// only their stamps jitter. Values are as recorded, in the row of their number.
    UniformBehindJitter,
    /// Stamps jitter, and the positions are smoother if taken at their stamps: sampling itself
    /// jitters. Values are interpolated.
    AtStamps,
    /// Another rate was asked for. Values are interpolated.
    OtherRate,
}

impl ClockKind {
    /// Whether every value is as it was recorded; interpolated otherwise.
    pub fn keeps_values(self) -> bool {
        matches!(self, Self::Regular | Self::UniformBehindJitter)
    }
}

/// The uniform grid.
#[derive(Debug, Clone)]
pub(crate) struct Grid {
    pub origin_ns: i64,
    /// Time from row to row, s.
    pub step: f64,
    /// The same in ns, not rounded to whole ones.
    pub step_ns: f64,
    pub rows: usize,
    pub clock: ClockKind,
    pub jitter_s: f64,
    /// For a clock behind jitter: stamps of the position and the row of each.
    pub(super) ticks: Option<(Vec<i64>, Vec<u32>)>,
    /// Rows between the samples of the position on either side of a pause.
    pub pauses: Vec<Range<usize>>,
}

impl Grid {
    /// Time of the last row, ns.
    pub fn last_ns(&self) -> i64 {
        let duration = self.rows.saturating_sub(1) as f64 * self.step_ns;
        self.origin_ns.saturating_add(duration.round() as i64)
    }
}

/// Usual (median) interval of ordered stamps, ns; none for less than two.
pub(crate) fn usual_interval(stamps: &[i64]) -> Option<f64> {
    let mut intervals: Vec<i64> = stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
    if intervals.is_empty() {
        return None;
    }
    let middle = intervals.len() / 2;
    Some(*intervals.select_nth_unstable(middle).1 as f64)
}

/// Numbers samples along a clock of period `step` (ns) whose phase is followed; a sample that comes
/// too early to be another one has the number of the one before. `visit` gets index, number and how
/// far the stamp is from the clock, ns.
fn follow(stamps: &[i64], step: f64, mut visit: impl FnMut(usize, u64, f64)) {
    let (mut number, mut phase) = (0u64, first_phase(stamps, step));
    for (index, &stamp) in stamps.iter().enumerate() {
        if index > 0 {
            // relative to the sample before, so that no long time loses digits
            let since = (stamp - stamps[index - 1]) as f64 + phase;
            let steps = (since / step).round().max(0.0);
            number += steps as u64;
            phase = since - steps * step;
            let off = phase;
            phase *= 1.0 - PHASE_GAIN;
            // the clock itself moves by what was taken from the phase
            visit(index, number, off);
        } else {
            visit(0, 0, phase);
        }
    }
}

/// How far the first stamp is from the clock, ns: against the circular mean of the first ones,
/// since any may jitter.
fn first_phase(stamps: &[i64], step: f64) -> f64 {
    let (mut sine, mut cosine) = (0.0, 0.0);
    for &stamp in stamps.iter().take((1.0 / PHASE_GAIN) as usize) {
        let angle = (stamp - stamps[0]) as f64 / step * std::f64::consts::TAU;
        sine += angle.sin();
        cosine += angle.cos();
    }
    -sine.atan2(cosine) / std::f64::consts::TAU * step
}

/// Period of a clock near `start`, ns, from the ends of every stretch without a gap, and the steps
/// of the longest stretch.
fn period(stamps: &[i64], start: f64) -> (f64, f64) {
    let (mut time, mut steps, mut longest) = (0.0, 0.0, 0.0f64);
    let mut from: Option<(usize, u64)> = None;
    let mut before: Option<(usize, u64)> = None;
    let mut stretch = |a: Option<(usize, u64)>, b: Option<(usize, u64)>| {
        if let (Some((i, m)), Some((j, n))) = (a, b) {
            time += (stamps[j] - stamps[i]) as f64;
            steps += (n - m) as f64;
            longest = longest.max((n - m) as f64);
        }
    };
    follow(stamps, start, |index, number, _| {
        if before.is_none_or(|(_, n)| number - n > MOST_MISSING as u64 + 1) {
            stretch(from, before);
            from = Some((index, number));
        }
        before = Some((index, number));
    });
    stretch(from, before);
    (if steps > 0.0 { time / steps } else { start }, longest)
}

/// Period of the sampling clock, ns, and the steps of the longest stretch without a gap.
///
/// Where stamps are rounded to a digit that is no small part of the period, the usual interval is
/// not the period: 256 Hz in whole ms has intervals of 4 and 3 ms. Then the mean is, of the
/// intervals of one step, or of all that are no gap; whether it is, the positions say, which are
/// smoother when taken so. What lies on the usual interval with samples missing in between is not.
fn period_of_clock(stamps: &[i64], position: &[f64], usual: f64) -> (f64, f64) {
    let by_usual = period(stamps, usual);
    let mean_of = |most: f64| {
        let intervals = stamps.windows(2).map(|pair| (pair[1] - pair[0]) as f64);
        let near = intervals.filter(|one| *one >= 0.5 * usual && *one <= most * usual);
        let (sum, count) = near.fold((0.0, 0.0), |(sum, count), one| (sum + one, count + 1.0));
        period(stamps, sum / count)
    };
    let is_other = |(step, _): &(f64, f64)| {
        step.is_finite() && *step > 0.0 && (step / by_usual.0 - 1.0).abs() > SAME_RATE
    };
    let mut found = by_usual;
    let mut least = f64::INFINITY;
    for by_mean in [1.5, MOST_MISSING as f64 + 1.5].map(mean_of).into_iter().filter(is_other) {
        let Smoothness { uniform, stamped, windows } = smoothness(stamps, position, by_mean.0);
        let is_whole = windows as f64 >= MOSTLY * stamps.len() as f64;
        if is_whole && uniform < MUCH_SMOOTHER * stamped && uniform < least {
            (found, least) = (by_mean, uniform);
        }
    }
    found
}

/// The grid that the stamps of the position define, or that `rate` (Hz) asks for.
pub(crate) fn grid(
    stamps: &[i64],
    position: &[f64],
    rate: Option<f64>,
    place: &str,
) -> Result<Grid, SignalError> {
    let clock = |reason: String| SignalError::Clock {
        signal: Signal::Position.name(),
        place: place.to_owned(),
        reason,
    };
    let (Some(usual), Some(&first), Some(&last)) =
        (usual_interval(stamps), stamps.first(), stamps.last())
    else {
        return Err(clock("at least two different ones are needed".into()));
    };
    let (mut step, longest) = period_of_clock(stamps, position, usual);
    let deviation = |step: f64| {
        let (mut squares, mut worst) = (0.0, 0.0f64);
        follow(stamps, step, |_, _, off| {
            squares += off * off;
            worst = worst.max(off.abs());
        });
        ((squares / stamps.len() as f64).sqrt(), worst)
    };
    let (jitter, _) = deviation(step);
    // a round rate, if it does not slip against the stamps by more than they jitter
    let hertz = 1e9 / step;
    let digits = 10f64.powi(2 - hertz.log10().floor() as i32);
    let round = 1e9 / ((hertz * digits).round() / digits);
    if (round - step).abs() * longest <= jitter.max(ON_GRID_NS) {
        step = round;
    }
    let (jitter, worst) = deviation(step);
    let asked = rate.map(|rate| 1e9 / rate).filter(|asked| (asked / step - 1.0).abs() > SAME_RATE);
    let kind = match asked {
        Some(_) => ClockKind::OtherRate,
        None if worst <= ON_GRID_NS && on_grid(stamps, step) => ClockKind::Regular,
        None if smoother_as_uniform(stamps, position, step) => ClockKind::UniformBehindJitter,
        None => ClockKind::AtStamps,
    };
    let step = asked.unwrap_or(step);
    let rows = (last - first) as f64 / step;
    let samples = stamps.len() as u64;
    if rows > ROWS_ALLOWED.max(MOST_ROWS_PER_SAMPLE * samples) as f64 {
        return Err(clock(format!(
            "{samples} samples every {:.6} s reach over {:.3} s, so most of it is holes: a stamp \
             is wrong, or several runs are in one recording",
            step * 1e-9,
            (last - first) as f64 * 1e-9
        )));
    }
    let mut grid = Grid {
        origin_ns: first,
        step: step * 1e-9,
        step_ns: step,
        rows: (rows + ON_GRID_NS / step).floor() as usize + 1,
        clock: kind,
        jitter_s: jitter * 1e-9,
        ticks: None,
        pauses: Vec::new(),
    };
    if kind == ClockKind::UniformBehindJitter {
        let (mut kept, mut numbers) =
            (Vec::with_capacity(stamps.len()), Vec::with_capacity(stamps.len()));
        follow(stamps, step, |index, number, _| {
            if numbers.last() != Some(&(number as u32)) {
                kept.push(stamps[index]);
                numbers.push(number as u32);
            }
        });
        grid.rows = numbers.last().map_or(0, |&n| n as usize + 1);
        grid.ticks = Some((kept, numbers));
    }
    grid.pauses = pauses(&grid, stamps);
    Ok(grid)
}

fn on_grid(stamps: &[i64], step: f64) -> bool {
    stamps.iter().all(|&stamp| {
        let since = (stamp - stamps[0]) as f64;
        (since - (since / step).round() * step).abs() <= ON_GRID_NS
    })
}

/// Whether the positions are smoother if taken as uniform than if taken at their stamps: by the
/// fourth difference, and the fourth divided difference scaled to the same gain for white noise.
fn smoother_as_uniform(stamps: &[i64], position: &[f64], step: f64) -> bool {
    let Smoothness { uniform, stamped, .. } = smoothness(stamps, position, step);
    uniform <= stamped
}

/// Sums of squares of the fourth difference of the positions.
struct Smoothness {
    /// Taken as uniform.
    uniform: f64,
    /// Taken at their stamps.
    stamped: f64,
    /// Samples that begin five in a row.
    windows: usize,
}

fn smoothness(stamps: &[i64], position: &[f64], step: f64) -> Smoothness {
    let mut numbers = Vec::with_capacity(stamps.len());
    follow(stamps, step, |_, number, _| numbers.push(number));
    let (mut uniform, mut stamped, mut windows) = (0.0, 0.0, 0);
    for ((numbers, stamps), x) in numbers.windows(5).zip(stamps.windows(5)).zip(position.windows(5))
    {
        if numbers[4] - numbers[0] != 4
            || numbers.windows(2).any(|n| n[0] == n[1])
            || x.iter().any(|x| x.is_nan())
        {
            continue;
        }
        let times: [f64; 5] = std::array::from_fn(|i| (stamps[i] - stamps[0]) as f64 / step);
        let mut weights = [1.0; 5];
        for i in 0..5 {
            for j in 0..5 {
                if i != j {
                    weights[i] /= times[i] - times[j];
                }
            }
        }
        let gain: f64 = weights.iter().map(|w| w * w).sum();
        let divided: f64 = weights.iter().zip(x).map(|(w, value)| w * (value - x[0])).sum();
        stamped += divided * divided / gain;
        let difference = x[0] - 4.0 * x[1] + 6.0 * x[2] - 4.0 * x[3] + x[4];
        uniform += difference * difference / 70.0;
        windows += 1;
    }
    Smoothness { uniform, stamped, windows }
}

/// Stretches of rows that are valid, in order.
pub(crate) fn stretches(valid: &[bool]) -> Vec<Range<usize>> {
    let mut found = Vec::new();
    let mut from = None;
    for (row, &valid) in valid.iter().chain([&false]).enumerate() {
        match (from, valid) {
            (None, true) => from = Some(row),
            (Some(start), false) => {
                found.push(start..row);
                from = None;
            }
            _ => {}
        }
    }
    found
}
