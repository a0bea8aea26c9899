//! A counter that wraps: the position goes on at the other end of its range.

use super::Examiner;
use super::repeats::extremes;
use crate::quality::finding::DataFinding;
use crate::signals::Signal;

/// Rows to either side of a jump over which the motion is taken, and the part of the range that it
/// may pass in one of them: a counter that wraps more often than every fourth row tells no
/// direction.
const ROWS: usize = 3;
const FASTEST: f64 = 0.25;
/// Part of the range that a jump must be, the motion across it taken out. Assumed: some counts at
/// the ends may not have been met.
const WHOLE: f64 = 0.9;
/// Jumps, at least: one alone may be a position that was set. Assumed.
const LEAST: usize = 2;

impl Examiner<'_> {
    /// Whether the position jumps from one end of its range to the other while it moves on in the
    /// opposite direction before and after, again and again; said so.
    pub(super) fn wraps(&mut self) -> bool {
        let (signal, x) = self.measured();
        let [low, high] = extremes(x);
        let range = high - low;
        if signal != Signal::Position || x.len() <= 2 * ROWS || range.is_nan() || range <= 0.0 {
            return false;
        }
        let mean = |from: usize| (x[from + ROWS] - x[from]) / ROWS as f64;
        let jump_after = |row: usize| {
            let jump = x[row + 1] - x[row];
            let (before, after) = (mean(row - ROWS), mean(row + 1));
            let moves_on = |step: f64| step * jump < 0.0 && step.abs() < FASTEST * range;
            let size = (jump - 0.5 * (before + after)).abs();
            (moves_on(before) && moves_on(after) && size >= WHOLE * range).then_some((row, size))
        };
        let jumps: Vec<(usize, f64)> = (ROWS..x.len() - ROWS - 1).filter_map(jump_after).collect();
        if jumps.len() < LEAST {
            return false;
        }
        let mut sizes: Vec<f64> = jumps.iter().map(|(_, size)| *size).collect();
        sizes.sort_by(f64::total_cmp);
        let rows = jumps.into_iter().map(|(row, _)| row + 1).collect();
        self.findings.push(DataFinding::Wrapped { signal, jump: sizes[sizes.len() / 2], rows });
        true
    }
}
