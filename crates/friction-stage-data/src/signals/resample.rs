//! Irregular samples onto one uniform grid, with an account of everything that was not as it should
//! be.
//!
//! What comes in are the samples of each signal with their own stamps: out of order, repeated,
//! missing, jittering, at other rates. What goes out is a column per signal on the grid that the
//! position defines. Nothing is invented silently: what was filled in is counted, and where more
//! than [`MOST_MISSING`] samples in a row are missing the column is NaN.
//!
//! A position between samples lies on the cubic through its four neighbours: at 20 m/s² a straight
//! line is off by 0.6 µm between samples at 2 kHz, which a second difference turns into 100 N. A
//! force reading is interpolated linearly. A command is held until the next one, so its value in a
//! row is its mean from that row to the next.

use std::ops::Range;

use super::data_quality::SignalQuality;
use super::grid::{Grid, ON_GRID_NS, usual_interval};
use super::mapping::Signal;

/// Samples missing in a row that are filled from their neighbours; more of them are a gap. Assumed:
/// at 2 kHz this is 2 ms, well within the 17 ms period of a 60 Hz position loop.
pub const MOST_MISSING: usize = 3;

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

/// Rows between stamps that are too far apart for the samples between them to be filled in.
pub(super) fn pauses(grid: &Grid, stamps: &[i64]) -> Vec<Range<usize>> {
    let spacing = usual_interval(stamps).unwrap_or(0.0) * 1e-9 / grid.step;
    let mut places = Places { grid, cursor: 0 };
    let rows: Vec<f64> = stamps.iter().map(|stamp| places.row(*stamp)).collect();
    let apart = rows.windows(2).filter(|pair| pair[1] - pair[0] > longest(spacing));
    apart
        .map(|pair| pair[0].floor() as usize + 1..(pair[1].ceil() as usize).min(grid.rows))
        .collect()
}

/// Share of the rows that are in no pause in which a column has a value.
pub(super) fn coverage(column: &[f64], pauses: &[Range<usize>]) -> f64 {
    let known = |rows: &[f64]| rows.iter().filter(|value| value.is_finite()).count();
    let in_pauses = || pauses.iter().filter_map(|rows| column.get(rows.clone()));
    let (mut rows, mut values) = (column.len(), known(column));
    for pause in in_pauses() {
        rows -= pause.len();
        values -= known(pause);
    }
    values as f64 / rows.max(1) as f64
}

/// The longest interval that is filled from its neighbours, in rows, by the usual one.
fn longest(spacing: f64) -> f64 {
    spacing * (MOST_MISSING as f64 + 1.5)
}

/// One signal on the grid.
#[derive(Default)]
pub(crate) struct Placed {
    /// NaN where it is not known.
    pub column: Vec<f64>,
    /// Rows in place of samples that are missing.
    pub filled: Vec<usize>,
    /// Samples that are further apart than the rows, missing ones between them or not.
    pub apart: Vec<Apart>,
}

/// Two samples and the rows between them.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Apart {
    /// Where the samples lie, in rows; whole ones where they are in a row.
    samples: (f64, f64),
    rows: Range<usize>,
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
    let longest = longest(spacing);
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
            let rows = rows.start..(b.0.ceil() as usize).min(rows.end);
            apart.push(Apart { samples: (a.0, b.0), rows });
        }
    }
    quality.coverage = coverage(&column, &grid.pauses);
    Placed { column, filled, apart }
}

/// A force cell between its samples: a straight line beside the command, which it shows one row
/// later. What the motor makes of its command changes slowly, the command itself with every row.
pub(crate) fn along_command(cell: &mut [f64], apart: &[Apart], command: &[f64]) {
    // What was commanded in the interval that ends at a row, or that a time is in.
    let commanded = |row: f64| match row.ceil() {
        row if row >= 1.0 => command.get(row as usize - 1).copied().unwrap_or(f64::NAN),
        _ => f64::NAN,
    };
    for Apart { samples: (a, b), rows } in apart {
        let (start, end) = (commanded(*a), commanded(*b));
        for row in rows.clone() {
            let share = (row as f64 - a) / (b - a);
            let beside = commanded(row as f64) - (start + share * (end - start));
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
