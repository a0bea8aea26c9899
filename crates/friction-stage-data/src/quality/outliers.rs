//! Samples that no machine made: single ones, or two in a row, far from those around them.
//!
//! A sample is compared with the range of those around it without the two that are furthest out: a
//! motion, turned or braked however sharply, stays within a part of that range of it, and noise
//! within a few times the range where the signal is calm. A sensor that drops out, or a line that
//! loses a bit, does not. What a force does for a sample or two may be real: it counts as one only
//! where the other force shows nothing of it.

use crate::signals::{Recording, Signal};

/// Samples around one, itself included, and how many of them may be out. Assumed: a line drops out
/// for one or two.
const AROUND: usize = 7;
const OUT: usize = 2;
/// How many ranges away one must be. Assumed: noise reaches two or three of them.
const TIMES: f64 = 20.0;
/// Part of the samples around which a signal is as calm as it gets. Assumed: a record rests, or
/// moves evenly, for so long.
const CALM: f64 = 0.1;

/// Rows in which a position or a force is none that the stage can have had, in order.
pub fn outlier_rows(recording: &Recording, signal: Signal) -> Vec<usize> {
    let trace = &recording.trace;
    match signal {
        Signal::Position => outliers(&trace.position, None),
        // A single force may be a pulse: nothing tells.
        Signal::ForceCell => outliers(&trace.force_cell, Some(&trace.force)),
        Signal::Force => outliers(&trace.force, Some(&trace.force_cell)),
        _ => Vec::new(),
    }
}

/// Rows of the outliers, in order. `other` is the signal that must show the same, if there is one.
fn outliers(column: &[f64], other: Option<&[f64]>) -> Vec<usize> {
    let half = AROUND / 2;
    let window = |values: &[f64], row: usize| -> Option<[f64; AROUND]> {
        let mut sorted: [f64; AROUND] =
            values.get(row.checked_sub(half)?..=row + half)?.try_into().ok()?;
        sorted.sort_by(f64::total_cmp);
        sorted.iter().all(|value| value.is_finite()).then_some(sorted)
    };
    // Lowest and highest of those that are not out.
    let usual: Vec<Option<(f64, f64)>> = (0..column.len())
        .map(|row| {
            let sorted = window(column, row)?;
            let widths = (0..=OUT).map(|first| (sorted[first], sorted[first + AROUND - OUT - 1]));
            widths.min_by(|a, b| (a.1 - a.0).total_cmp(&(b.1 - b.0)))
        })
        .collect();
    let mut ranges: Vec<f64> = usual.iter().flatten().map(|(low, high)| high - low).collect();
    if ranges.is_empty() {
        return Vec::new();
    }
    let calm = (CALM * (ranges.len() - 1) as f64) as usize;
    let calm = *ranges.select_nth_unstable_by(calm, f64::total_cmp).1;
    // Where nothing changes for a while, a count is the least that it can change by.
    let steps = column.windows(2).map(|pair| (pair[1] - pair[0]).abs()).filter(|step| *step > 0.0);
    let least = calm.max(steps.fold(f64::INFINITY, f64::min));
    let is_out = |row: usize| {
        let (Some((low, high)), value) = (usual[row], column[row]) else {
            return false;
        };
        let shown = match other {
            // It may show a row earlier or later.
            Some(other) => match window(other, row) {
                Some(sorted) => sorted[AROUND - 1] - sorted[0],
                None => return false,
            },
            None => 0.0,
        };
        (low - value).max(value - high) > TIMES * (high - low + shown + least)
    };
    (0..column.len()).filter(|row| is_out(*row)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A motion there and back in counts of a nanometre, with a rest and a sharp turn, then a
    /// dropout of one and one of two samples.
    #[test]
    fn what_drops_out_is_found_and_a_motion_is_not() {
        let position = |k: i32| match k {
            0..2500 => 0.0,
            2500..10_000 => 1e-5 * f64::from((k - 6250).abs() - 3750),
            _ => 0.05 * (f64::from(k - 10_000) * 1e-3).sin(),
        };
        let mut column: Vec<f64> = (0..20_000)
            .map(|k| ((position(k) + 2e-9 * f64::from(k).sin()) * 1e9).round() * 1e-9)
            .collect();
        assert_eq!(outliers(&column, None), Vec::<usize>::new());
        column[1000] += 1e-6;
        column[7000] += 0.01;
        (column[13_000], column[13_001]) = (0.0, 0.0);
        assert_eq!(outliers(&column, None), [1000, 7000, 13_000, 13_001]);
        assert_eq!(outliers(&[], None), Vec::<usize>::new());
    }

    /// A pulse of the motor, which cell and command show, and one of the cell alone.
    #[test]
    fn a_pulse_that_both_forces_show_is_no_outlier() {
        let mut command: Vec<f64> = (0..5000)
            .map(|k| 50.0 * (f64::from(k) * 1e-2).sin() + (7.0 * f64::from(k)).sin())
            .collect();
        let mut cell: Vec<f64> = command.iter().map(|force| force + 0.1).collect();
        (command[2000], cell[2001]) = (900.0, 900.0);
        cell[3000] = 900.0;
        assert_eq!(outliers(&cell, Some(&command)), [3000]);
        assert_eq!(outliers(&command, Some(&cell)), Vec::<usize>::new());
    }
}
