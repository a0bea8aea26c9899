//! Irregular samples onto one uniform grid, with an account of everything that was not as it should
//! be.
//!
//! What comes in are the samples of each signal with their own stamps: out of order, repeated,
//! missing, jittering, at other rates. What goes out is a column per signal on the grid that the
//! position defines. Nothing is invented silently: what was filled in is counted, and where more
//! than [`MOST_MISSING`] samples in a row are missing the column is NaN.
//!
//! A position between samples lies on the cubic through its four neighbours: at 20 m/s² a straight
//! line is off by 0.6 um between samples at 2 kHz, which a second difference turns into 100 N. A
//! force reading is interpolated linearly. A command is held until the next one, so its value in a
//! row is its mean from that row to the next.

use std::ops::Range;

use serde::Serialize;

use super::error::BagError;
use super::mapping::Signal;

/// Samples missing in a row that are filled from their neighbours; more of them are a gap. Assumed:
/// at 2 kHz this is 2 ms, well within the 17 ms period of a 60 Hz position loop.
pub const MOST_MISSING: usize = 3;
/// Stamps within this of the grid, ns, are on it: they are rounded to 1 ns, and so is the grid.
const ON_GRID_NS: f64 = 2.0;
/// A clock that goes back by more than this, ns, is another run, not a late message.
const LATEST_NS: i64 = 1_000_000_000;
/// Largest time stamp, ns: differences of two still fit 64 bits.
const LARGEST_NS: u64 = 1 << 62;
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

/// What was met and done in bringing one signal onto the grid.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SignalQuality {
    /// The signal.
    pub signal: Signal,
    /// Topic and field, or column.
    pub place: String,
    /// Samples read.
    pub samples: u64,
    /// Samples that are NaN or infinite; taken as missing.
    pub not_finite: u64,
    /// Samples with a stamp that another one has; the first counts.
    pub repeated: u64,
    /// Those of them with another value.
    pub conflicting: u64,
    /// Samples with a stamp before that of an earlier one; put in order.
    pub out_of_order: u64,
    /// Usual (median) interval, s.
    pub interval_s: f64,
    /// Standard deviation of stamps from the clock that they follow, s; only of the position.
    pub jitter_s: Option<f64>,
    /// Samples that are missing, by the usual interval.
    pub missing: u64,
    /// Rows filled from neighbours in place of missing samples.
    pub filled: u64,
    /// Places where more than three samples in a row are missing; NaN in the trace.
    pub gaps: u64,
    /// Longest interval between two samples, s.
    pub longest_interval_s: f64,
    /// Share of the rows that have a value.
    pub coverage: f64,
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
    ticks: Option<(Vec<i64>, Vec<u32>)>,
}

/// Samples in the order of time, each stamp once, with the account of it.
pub(crate) struct Ordered {
    pub stamps: Vec<i64>,
    pub values: Vec<Vec<f64>>,
    pub quality: Vec<SignalQuality>,
}

/// Puts samples in order and drops repeated stamps. Values that are not finite stay as NaN.
pub(crate) fn order(stream: super::source::Stream) -> Result<Ordered, BagError> {
    let super::source::Stream { signals, places, mut stamps, mut values, .. } = stream;
    let samples = stamps.len() as u64;
    let (mut backward, mut latest) = (0, i64::MIN);
    for (index, &stamp) in stamps.iter().enumerate() {
        let clock = |reason: String| BagError::Clock {
            signal: signals.first().map_or("", |s| s.name()),
            place: places.first().cloned().unwrap_or_default(),
            reason,
        };
        if stamp.unsigned_abs() > LARGEST_NS {
            return Err(clock(format!("sample {} has none, or one beyond 146 years", index + 1)));
        }
        if latest > i64::MIN && latest.saturating_sub(stamp) > LATEST_NS {
            return Err(clock(format!(
                "they go back by {:.3} s at sample {} of {samples}: these are several runs, or the \
                 clock was set; split the recording, or take the time of recording (`stamp: \
                 log_time` in a mapping)",
                latest.saturating_sub(stamp) as f64 * 1e-9,
                index + 1
            )));
        }
        backward += u64::from(stamp < latest);
        latest = latest.max(stamp);
    }
    if backward > 0 {
        let mut by_time: Vec<u32> = (0..stamps.len() as u32).collect();
        by_time.sort_by_key(|&i| stamps[i as usize]);
        stamps = by_time.iter().map(|&i| stamps[i as usize]).collect();
        for column in &mut values {
            *column = by_time.iter().map(|&i| column[i as usize]).collect();
        }
    }
    let mut quality: Vec<SignalQuality> = signals
        .iter()
        .zip(places)
        .zip(&values)
        .map(|((&signal, place), column)| SignalQuality {
            signal,
            place,
            samples,
            not_finite: column.iter().filter(|v| !v.is_finite()).count() as u64,
            repeated: 0,
            conflicting: 0,
            out_of_order: backward,
            interval_s: f64::NAN,
            jitter_s: None,
            missing: 0,
            filled: 0,
            gaps: 0,
            longest_interval_s: f64::NAN,
            coverage: 0.0,
        })
        .collect();
    let mut kept = 0;
    for index in 0..stamps.len() {
        if kept > 0 && stamps[index] == stamps[kept - 1] {
            for (column, quality) in values.iter_mut().zip(&mut quality) {
                quality.repeated += 1;
                let (first, again) = (column[kept - 1], column[index]);
                quality.conflicting +=
                    u64::from(first.is_finite() && again.is_finite() && first != again);
                if !first.is_finite() {
                    column[kept - 1] = again;
                }
            }
            continue;
        }
        stamps[kept] = stamps[index];
        for column in &mut values {
            column[kept] = column[index];
        }
        kept += 1;
    }
    stamps.truncate(kept);
    for column in &mut values {
        column.truncate(kept);
        for value in column.iter_mut().filter(|v| !v.is_finite()) {
            *value = f64::NAN;
        }
    }
    Ok(Ordered { stamps, values, quality })
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

/// The grid that the stamps of the position define, or that `rate` (Hz) asks for.
pub(crate) fn grid(
    stamps: &[i64],
    position: &[f64],
    rate: Option<f64>,
    place: &str,
) -> Result<Grid, BagError> {
    let clock = |reason: String| BagError::Clock {
        signal: Signal::Position.name(),
        place: place.to_owned(),
        reason,
    };
    let (Some(usual), Some(&first), Some(&last)) =
        (usual_interval(stamps), stamps.first(), stamps.last())
    else {
        return Err(clock("at least two different ones are needed".into()));
    };
    // the period, from the ends of every stretch without a gap
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
    follow(stamps, usual, |index, number, _| {
        if before.is_none_or(|(_, n)| number - n > MOST_MISSING as u64 + 1) {
            stretch(from, before);
            from = Some((index, number));
        }
        before = Some((index, number));
    });
    stretch(from, before);
    let mut step = if steps > 0.0 { time / steps } else { usual };
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
    let mut numbers = Vec::with_capacity(stamps.len());
    follow(stamps, step, |_, number, _| numbers.push(number));
    let (mut uniform, mut stamped) = (0.0, 0.0);
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
    }
    uniform <= stamped
}

/// How a signal goes on between its samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Between {
    /// Cubic through the four neighbours.
    Smooth,
    /// Straight line.
    Linear,
    /// Held until the next sample: the mean from the row to the next.
    Held,
}

impl Between {
    pub fn of(signal: Signal) -> Self {
        match signal {
            Signal::Force => Self::Held,
            Signal::ForceCell => Self::Linear,
            _ => Self::Smooth,
        }
    }
}

/// Where a sample lies on the grid, in rows.
struct Places<'a> {
    grid: &'a Grid,
    cursor: usize,
}

impl Places<'_> {
    /// Stamps must come in order.
    fn row(&mut self, stamp: i64) -> f64 {
        if let Some((stamps, rows)) = &self.grid.ticks {
            while self.cursor + 1 < stamps.len() && stamps[self.cursor + 1] <= stamp {
                self.cursor += 1;
            }
            let (at, row) = (stamps[self.cursor], f64::from(rows[self.cursor]));
            return if at == stamp {
                row
            } else {
                row + (stamp - at) as f64 * 1e-9 / self.grid.step
            };
        }
        let row = (stamp - self.grid.origin_ns) as f64 * 1e-9 / self.grid.step;
        let near = row.round();
        if (row - near).abs() * self.grid.step <= ON_GRID_NS * 1e-9 { near } else { row }
    }
}

/// One signal on the grid.
#[derive(Default)]
pub(crate) struct Placed {
    /// NaN where it is not known.
    pub column: Vec<f64>,
    /// Rows in place of samples that are missing.
    pub filled: Vec<usize>,
    /// Rows between samples that are further apart than the rows, those that are filled among them.
    pub between: Vec<usize>,
}

/// One signal onto the grid.
pub(crate) fn place(
    grid: &Grid,
    stamps: &[i64],
    values: &[f64],
    between: Between,
    quality: &mut SignalQuality,
) -> Placed {
    let (mut filled, mut apart) = (Vec::new(), Vec::new());
    let mut column = vec![f64::NAN; grid.rows];
    let finite = || stamps.iter().zip(values).filter(|(_, v)| v.is_finite());
    let Some(usual) = usual_interval(stamps) else {
        return Placed { column, ..Placed::default() };
    };
    quality.interval_s = usual * 1e-9;
    let spacing = (usual * 1e-9 / grid.step).max(f64::MIN_POSITIVE);
    let longest = spacing * (MOST_MISSING as f64 + 1.5);
    let mut places = Places { grid, cursor: 0 };
    let mut samples = finite().map(|(&stamp, &value)| (places.row(stamp), value));
    // the last four samples; intervals are filled one sample late, so that a cubic has its four
    // neighbours
    let mut window: [Option<(f64, f64)>; 4] = [None; 4];
    quality.longest_interval_s = 0.0;
    let mut held = Held::default();
    let mut ends = 0;
    while ends < 2 {
        let next = samples.next();
        ends += usize::from(next.is_none());
        // samples that share a row (a crowd behind jitter): the first counts
        if let (Some((row, _)), Some((last, _))) = (next, window[3])
            && row <= last
        {
            continue;
        }
        window.rotate_left(1);
        window[3] = next;
        if let (Some(a), Some(b)) = (window[2], window[3]) {
            let interval = b.0 - a.0;
            quality.longest_interval_s = quality.longest_interval_s.max(interval * grid.step);
            let absent = (interval / spacing).round() - 1.0;
            if absent >= 1.0 {
                quality.missing += absent as u64;
            }
            if interval > longest {
                quality.gaps += 1;
            }
        }
        let (Some(a), b) = (window[1], window[2]) else {
            continue;
        };
        let is_gap = b.is_none_or(|b| b.0 - a.0 > longest);
        if between == Between::Held {
            let until = match b {
                Some(b) if !is_gap => b.0,
                _ => a.0 + spacing,
            };
            held.piece(a.0, until, a.1, &mut column);
            if let Some(b) = b.filter(|b| !is_gap && b.0 - a.0 > 1.5 * spacing) {
                quality.filled += (b.0 - a.0 - spacing).round().max(0.0) as u64;
                let rows = (a.0 + spacing).floor().max(0.0) as usize
                    ..(b.0.ceil().max(0.0) as usize).min(grid.rows);
                filled.extend(rows);
            }
            continue;
        }
        if a.0 >= 0.0 && a.0.fract() == 0.0 && (a.0 as usize) < grid.rows {
            column[a.0 as usize] = a.1;
        }
        let Some(b) = b.filter(|_| !is_gap) else {
            continue;
        };
        let from = (a.0.floor() + 1.0).max(0.0);
        let to = b.0.ceil().min(grid.rows as f64);
        if from >= to {
            continue;
        }
        let before = window[0].filter(|p| a.0 - p.0 <= longest);
        let after = window[3].filter(|p| p.0 - b.0 <= longest);
        let is_missing = b.0 - a.0 > 1.5 * spacing;
        let first = from as usize;
        for (offset, value) in column[first..to as usize].iter_mut().enumerate() {
            let at = (first + offset) as f64;
            *value = match (between, before, after) {
                (Between::Smooth, Some(before), Some(after)) => cubic([before, a, b, after], at),
                _ => a.1 + (b.1 - a.1) * (at - a.0) / (b.0 - a.0),
            };
            quality.filled += u64::from(is_missing);
        }
        let rows = first..to as usize;
        if is_missing {
            filled.extend(rows.clone());
        }
        if b.0 - a.0 > 1.5 {
            apart.extend(rows.filter(|row| *row as f64 != b.0));
        }
    }
    quality.coverage =
        column.iter().filter(|v| v.is_finite()).count() as f64 / grid.rows.max(1) as f64;
    Placed { column, filled, between: apart }
}

/// A force cell between its samples: a straight line beside the command, which it shows one row
/// later. What the motor makes of its command changes slowly, the command itself with every row.
pub(crate) fn along_command(cell: &mut [f64], between: &[usize], command: &[f64]) {
    for run in between.chunk_by(|a, b| *b == a + 1) {
        let (before, after) = (run[0].wrapping_sub(1), run[run.len() - 1] + 1);
        let commanded = |row: usize| {
            row.checked_sub(1).and_then(|row| command.get(row)).copied().unwrap_or(f64::NAN)
        };
        let (start, end) = (commanded(before), commanded(after));
        for &row in run {
            let share = (row - run[0] + 1) as f64 / (run.len() + 1) as f64;
            let beside = commanded(row) - (start + share * (end - start));
            if beside.is_finite() {
                cell[row] += beside;
            }
        }
    }
}

/// Lagrange's cubic through four points; a straight line if two of them are too close to say
/// anything together.
fn cubic(points: [(f64, f64); 4], at: f64) -> f64 {
    let [_, a, b, _] = points;
    let width = b.0 - a.0;
    if points.windows(2).any(|pair| pair[1].0 - pair[0].0 < 0.05 * width) {
        return a.1 + (b.1 - a.1) * (at - a.0) / width;
    }
    let mut value = 0.0;
    for (i, (x, y)) in points.iter().enumerate() {
        let mut weight = 1.0;
        for (j, (other, _)) in points.iter().enumerate() {
            if i != j {
                weight *= (at - other) / (x - other);
            }
        }
        // relative to one of them, so that small steps far from zero keep their digits
        value += weight * (y - a.1);
    }
    a.1 + value
}

/// Gathers the mean of a held signal over each row.
#[derive(Default)]
struct Held {
    /// Row that is being gathered, its sum and how much of it is covered.
    open: Option<(usize, f64, f64)>,
}

impl Held {
    /// `value` holds from `from` to `to`, in rows. Pieces come in order.
    fn piece(&mut self, from: f64, to: f64, value: f64, column: &mut [f64]) {
        if to <= 0.0 {
            return;
        }
        let mut at = from.max(0.0);
        while at < to {
            let row = at.floor();
            if row >= column.len() as f64 {
                return;
            }
            let until = to.min(row + 1.0);
            let width = until - at;
            let row = row as usize;
            if width >= 1.0 - 1e-9 {
                // the whole row: exactly the value
                column[row] = value;
                self.open = None;
            } else {
                let (sum, covered) = match self.open {
                    Some((open, sum, covered)) if open == row => (sum, covered),
                    _ => (0.0, 0.0),
                };
                let (sum, covered) = (sum + width * value, covered + width);
                self.open = Some((row, sum, covered));
                // most of a row is enough: the first command may come a moment after its row, the
                // last is held for one interval
                if covered > 0.5 {
                    column[row] = sum / covered;
                }
            }
            at = until;
        }
    }
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
