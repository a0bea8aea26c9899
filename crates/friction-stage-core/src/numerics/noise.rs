//! Noise of a recorded signal as the signal itself shows it. Missing samples are NaN.

/// Share of a record, the slowest, that shows the noise of the encoder. Assumed: a recording of a
/// stage has rests or slow moves in it.
const SLOWEST: f64 = 0.1;
/// Samples of a third difference and one to either side.
const WINDOW: usize = 6;
/// Part by which a multiple of a count may be off: numbers in a file have some digits only.
/// Assumed.
const WHOLE: f64 = 1e-3;
/// Part of the steps before which a signal of coarse counts stood still. Assumed: a motion at one
/// speed goes on for longer than so few samples.
const STANDS: f64 = 0.1;

/// Standard deviation of what an encoder reads wrong, m: its white noise, and no less than counts
/// make of a position, be they those of the record or the declared `resolution`, m.
pub fn encoder_noise(position: &[f64], resolution: f64) -> f64 {
    let counts = resolution.max(count_size(position)) / 12f64.sqrt();
    white_noise(position).unwrap_or(0.0).max(counts)
}

/// Standard deviation of what a force cell reads wrong, N. Noise of the controller is in the
/// command too, a sample before the cell shows it; what a gain or a lag leaves of it is not the
/// cell's.
pub fn cell_noise(cell: &[f64], command: Option<&[f64]>) -> f64 {
    let alone = white_noise(cell).unwrap_or(0.0);
    let without_command = command.and_then(|command| {
        let cell = cell.iter().skip(1).zip(command);
        white_noise(&cell.map(|(cell, command)| cell - command).collect::<Vec<_>>())
    });
    alone.min(without_command.unwrap_or(f64::INFINITY)).max(count_size(cell) / 12f64.sqrt())
}

/// Count in which a signal is read: the least step, of which all others are multiples; 0 where
/// there is none. Steps that are all the same are those of a motion at one speed, unless the signal
/// stands still again and again between them.
pub fn count_size(values: &[f64]) -> f64 {
    let all_steps = || values.windows(2).map(|pair| (pair[1] - pair[0]).abs());
    let least = all_steps().filter(|step| *step > 0.0).fold(f64::INFINITY, f64::min);
    let (mut whole, mut several) = (true, false);
    let (mut moves, mut after_standing, mut stood) = (0usize, 0usize, false);
    for step in all_steps() {
        if step > 0.0 {
            let multiple = step / least;
            whole &= (multiple - multiple.round()).abs() < WHOLE * multiple.max(1.0);
            several |= multiple > 1.5;
            moves += 1;
            after_standing += usize::from(stood);
        }
        stood = step == 0.0;
    }
    let stands = after_standing as f64 > STANDS * moves as f64;
    if whole && (several || stands) { least } else { 0.0 }
}

/// White noise of a signal with samples at equal intervals. From its third differences, whose
/// variance is 20 times that of the noise: median-based so that steps do not count, and of the
/// slowest part of the record, so that an encoder's error that repeats with the position does not.
/// How slow it is, the samples to either side of a difference say, whose noise is another.
/// A window with a missing value (NaN) does not count; `None` where too few are left.
pub fn white_noise(values: &[f64]) -> Option<f64> {
    let windows = values.windows(WINDOW).map(|w| {
        let third = w[4] - 3.0 * w[3] + 3.0 * w[2] - w[1];
        ((w[5] - w[0]).abs(), third.abs() / 20f64.sqrt())
    });
    of_slowest(windows)
}

/// White noise of a signal with samples at any times, s: as [`white_noise`], from third divided
/// differences over the root of the sum of squares of their weights.
pub fn white_noise_at(times: &[f64], values: &[f64]) -> Option<f64> {
    let windows = times.windows(WINDOW).zip(values.windows(WINDOW)).map(|(t, x)| {
        let (mut third, mut squares) = (0.0, 0.0);
        for i in 1..5 {
            let others = (1..5).filter(|j| *j != i).map(|j| t[i] - t[j]);
            // In units of the window, so that no short interval overflows.
            let weight = (t[4] - t[1]).powi(3) / others.product::<f64>();
            third += weight * (x[i] - x[1]);
            squares += weight * weight;
        }
        ((x[5] - x[0]).abs() / (t[5] - t[0]), third.abs() / squares.sqrt())
    });
    of_slowest(windows)
}

/// Standard deviation of normal deviates, given by their size, in the slowest windows: each with
/// its speed.
fn of_slowest(windows: impl Iterator<Item = (f64, f64)>) -> Option<f64> {
    let mut windows: Vec<(f64, f64)> =
        windows.filter(|(speed, size)| speed.is_finite() && size.is_finite()).collect();
    let slow = (SLOWEST * windows.len() as f64) as usize;
    if slow == 0 {
        return None;
    }
    let (slowest, ..) = windows.select_nth_unstable_by(slow, |a, b| a.0.total_cmp(&b.0));
    let (_, median, _) = slowest.select_nth_unstable_by(slow / 2, |a, b| a.1.total_cmp(&b.1));
    Some(median.1 / 0.6745)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use std::f64::consts::TAU;

    use super::*;

    /// A motion to and fro with an error that repeats with the position, rests, a hole, and 2 nm of
    /// noise.
    #[test]
    fn noise_is_told_from_motion_and_holes() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut position: Vec<f64> = (0..20_000)
            .map(|k| {
                let noise: f64 = StandardNormal.sample(&mut random);
                let moves = 0.01 * (5e-4 * f64::from(k)).sin();
                let x = if k % 4000 < 2000 { moves } else { 0.004 };
                x + 2e-8 * (6e5 * x).sin() + 2e-9 * noise
            })
            .collect();
        position[7000..7500].fill(f64::NAN);
        let found = white_noise(&position).unwrap();
        assert!((found / 2e-9 - 1.0).abs() < 0.1, "{found:e}");
        assert!((encoder_noise(&position, 1e-7) - 1e-7 / 12f64.sqrt()).abs() < 1e-20);
        assert_eq!(white_noise(&[f64::NAN; 100]), None);
    }

    /// Where nothing moves, the slowest part is no less noisy than the rest.
    #[test]
    fn noise_at_rest_has_no_bias() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        let rest: Vec<f64> = (0..200_000).map(|_| StandardNormal.sample(&mut random)).collect();
        let found = white_noise(&rest).unwrap();
        assert!((found - 1.0).abs() < 0.02, "{found}");
    }

    /// Samples at times that jitter by a tenth to nine tenths of an interval.
    #[test]
    fn noise_of_samples_at_any_times_is_that_of_uniform_ones() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let times: Vec<f64> = (0..20_000)
            .map(|k| 1e-3 * (f64::from(k) + 0.8 * (f64::from(k * k % 7) / 6.0)))
            .collect();
        let read: Vec<f64> = times
            .iter()
            .map(|t| {
                let noise: f64 = StandardNormal.sample(&mut random);
                0.02 * (TAU * t).sin() + 1e-6 * noise
            })
            .collect();
        let found = white_noise_at(&times, &read).unwrap();
        assert!((found / 1e-6 - 1.0).abs() < 0.1, "{found:e}");
        assert_eq!(white_noise_at(&[0.0; 100], &[1.0; 100]), None);
    }

    /// What the controller makes of the noise is in the command, a sample before the cell has it.
    #[test]
    fn noise_of_the_command_is_not_the_cells() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut normal = || -> f64 { StandardNormal.sample(&mut random) };
        let command: Vec<f64> = (0..5000).map(|_| 3.0 * normal()).collect();
        let cell: Vec<f64> =
            (0..5000).map(|k: usize| command[k.saturating_sub(1)] + 0.05 * normal()).collect();
        let found = cell_noise(&cell, Some(&command));
        assert!((found / 0.05 - 1.0).abs() < 0.15, "{found}");
        assert!(cell_noise(&cell, None) > 2.0);
    }

    #[test]
    fn counts_are_seen_where_all_steps_are_whole_ones() {
        let read = |count: f64| -> Vec<f64> {
            (0..4000)
                .map(|k| {
                    ((0.01 * (1.0 - (TAU * f64::from(k) / 2000.0).cos())) / count).round() * count
                })
                .collect()
        };
        for count in [1e-6, 1e-5, 1e-4] {
            assert!(
                (count_size(&read(count)) / count - 1.0).abs() < 1e-3,
                "{count:e}: {:e}",
                count_size(&read(count))
            );
        }
        // One step again and again may be a motion at one speed; steps of all sizes are no counts.
        // 50 steps there, a rest, 50 back, a rest.
        let to_and_fro =
            (0..400).map(|k: i32| f64::from((k % 200).min(150 - k % 200).clamp(0, 50)));
        assert_eq!(count_size(&to_and_fro.collect::<Vec<_>>()), 0.0);
        assert!(
            count_size(&(0..4000).map(|k| (f64::from(k) * 0.01).sin()).collect::<Vec<_>>()) < 1e-4
        );
        assert_eq!(count_size(&[f64::NAN; 9]), 0.0);
    }
}
