//! Noise of encoder and force cell, and how it compares with what the model declares.

use std::ops::Range;

use super::{Examiner, NoiseFound};
use crate::quality::finding::DataFinding;
use crate::signals::Signal;

impl Examiner<'_> {
    pub(super) fn encoder_noise(&self) -> Option<NoiseFound> {
        let x = self.column(Signal::Position);
        let present = self.is_raw().then(|| white_noise(&self.segments, |row| x[row]))??;
        let declared =
            self.model.map(|m| m.encoder.noise.hypot(m.encoder.resolution / 12f64.sqrt()));
        Some(NoiseFound { present, declared, smallest_step: self.smallest_step(x) })
    }

    pub(super) fn cell_noise(&self) -> Option<NoiseFound> {
        if !self.recording.has(Signal::ForceCell) || !self.is_raw() {
            return None;
        }
        let (cell, command) = (self.column(Signal::ForceCell), self.column(Signal::Force));
        // the cell shows the force of the interval that ends at its row
        let with_command = self.recording.has(Signal::Force);
        let difference = white_noise(&self.segments, |row| match row {
            0 => f64::NAN,
            row => cell[row] - command[row - 1],
        });
        let alone = white_noise(&self.segments, |row| cell[row]);
        // a lag, a gain or another unit leaves more in the difference than in the cell alone
        let present = match (alone, difference.filter(|_| with_command)) {
            (Some(alone), Some(difference)) => alone.min(difference),
            (alone, _) => alone?,
        };
        let declared = self.model.map(|m| m.force_cell.noise);
        Some(NoiseFound { present, declared, smallest_step: self.smallest_step(cell) })
    }

    pub(super) fn noise(&mut self, encoder: Option<NoiseFound>, cell: Option<NoiseFound>) {
        let found = [(Signal::Position, "m", encoder), (Signal::ForceCell, "N", cell)];
        for (signal, unit, found) in found {
            let Some(NoiseFound { present, declared: Some(declared), .. }) = found else {
                continue;
            };
            // In between the declaration is good enough. Assumed.
            if !(0.5 * declared..=2.0 * declared).contains(&present) {
                self.findings.push(DataFinding::Noise { signal, unit, present, declared });
            }
        }
    }
}

/// Standard deviation of white noise, from sixth differences: the median over blocks of their mean
/// squares, so that edges of the motion do not count. The sum of squares of the binomial
/// coefficients of order 6 is 924.
pub(super) fn white_noise(segments: &[Range<usize>], value: impl Fn(usize) -> f64) -> Option<f64> {
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
