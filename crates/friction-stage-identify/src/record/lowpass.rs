//! Zero-phase lowpass with decimation, the same for measured and modelled forces.

use std::f64::consts::{PI, TAU};

/// Lobes of the sinc on each side of its middle. Assumed: a transition band of about a third of the
/// corner frequency.
const LOBES: f64 = 4.0;

/// Sums that advance together.
const AT_ONCE: usize = 8;

/// Symmetric windowed-sinc filter (Blackman window; Oppenheim, Schafer, "Discrete-Time Signal
/// Processing", ch. 7) that keeps every `factor`-th value. Gain 1 at zero frequency, no phase.
#[derive(Clone, Debug)]
pub struct ZeroPhaseLowpass {
    taps: Vec<f64>,
    factor: usize,
    rate: f64,
}

impl ZeroPhaseLowpass {
    /// Corner and rate in Hz; the corner must lie below half the rate.
    pub fn new(corner: f64, rate: f64) -> ZeroPhaseLowpass {
        let half = (LOBES * 0.5 * rate / corner).ceil() as usize;
        let middle = half as f64;
        let mut taps: Vec<f64> = (0..=2 * half)
            .map(|index| {
                let offset = index as f64 - middle;
                let argument = TAU * corner / rate * offset;
                let sinc = if offset == 0.0 { 1.0 } else { argument.sin() / argument };
                let turn = PI * (index as f64 + 1.0) / (middle + 1.0);
                sinc * (0.42 - 0.5 * turn.cos() + 0.08 * (2.0 * turn).cos())
            })
            .collect();
        let sum: f64 = taps.iter().sum();
        taps.iter_mut().for_each(|tap| *tap /= sum);
        // The values that are kept still carry the whole pass band: four fifths of their Nyquist
        // frequency at most.
        let factor = ((rate / (2.5 * corner)).floor() as usize).max(1);
        ZeroPhaseLowpass { taps, factor, rate }
    }

    /// The same that keeps every value.
    pub fn keeping_all(self) -> ZeroPhaseLowpass {
        ZeroPhaseLowpass { factor: 1, ..self }
    }

    /// Values on each side of a kept one that it depends on.
    pub fn half(&self) -> usize {
        self.taps.len() / 2
    }

    /// Spacing of the kept values in samples.
    pub fn factor(&self) -> usize {
        self.factor
    }

    /// Indices of the kept values in a signal of `count` samples whose first and last `margin`
    /// samples are not used.
    pub fn kept(&self, count: usize, margin: usize) -> impl Iterator<Item = usize> + use<> {
        let edge = self.half() + margin;
        (edge..count.saturating_sub(edge)).step_by(self.factor)
    }

    /// The filtered signal at one index, at least [`ZeroPhaseLowpass::half`] from either end.
    #[inline]
    pub fn at(&self, signal: &[f64], index: usize) -> f64 {
        let half = self.half();
        let (left, right) = (&signal[index - half..index], &signal[index + 1..=index + half]);
        let sides: f64 = left
            .iter()
            .zip(right.iter().rev())
            .zip(&self.taps)
            .map(|((left, right), tap)| (left + right) * tap)
            .sum();
        sides + self.taps[half] * signal[index]
    }

    /// The filtered signal at these indices, bit for bit as [`ZeroPhaseLowpass::at`] has it: where
    /// they are as far apart as kept values are, several sums advance together.
    pub fn at_all(&self, signal: &[f64], indices: &[usize]) -> Vec<f64> {
        let mut filtered = Vec::with_capacity(indices.len());
        for run in indices.chunk_by(|row, next| *next == row + self.factor) {
            let whole = run.len() - run.len() % AT_ONCE;
            if whole > 0 {
                self.extend_with_run(&mut filtered, signal, run[0], whole);
            }
            filtered.extend(run[whole..].iter().map(|row| self.at(signal, *row)));
        }
        filtered
    }

    /// Adds the filtered signal at `count` kept values from the index `first` on.
    fn extend_with_run(&self, filtered: &mut Vec<f64>, signal: &[f64], first: usize, count: usize) {
        let half = self.half();
        let used = &signal[first - half..=first + half + (count - 1) * self.factor];
        // Neighbours in a phase are the same distance from neighbouring kept values.
        let phases: Vec<Vec<f64>> = (0..self.factor)
            .map(|phase| used.iter().skip(phase).step_by(self.factor).copied().collect())
            .collect();
        let from = |offset: usize, row: usize| -> &[f64] {
            let start = offset / self.factor + row;
            &phases[offset % self.factor][start..start + AT_ONCE]
        };
        for row in (0..count).step_by(AT_ONCE) {
            // As an iterator begins a sum.
            let mut sums = [-0.0; AT_ONCE];
            for (offset, tap) in self.taps[..half].iter().enumerate() {
                let (left, right) = (from(offset, row), from(2 * half - offset, row));
                for ((sum, left), right) in sums.iter_mut().zip(left).zip(right) {
                    *sum += (left + right) * tap;
                }
            }
            let middle = from(half, row);
            filtered
                .extend(sums.iter().zip(middle).map(|(sum, value)| sum + self.taps[half] * value));
        }
    }

    /// The filter that gives, from the second differences of a signal, what this one takes out of
    /// the signal itself: the rest that lies above the corner, integrated twice without a drift.
    pub fn rest_of_second_differences(&self) -> ZeroPhaseLowpass {
        let half = self.half();
        let rest =
            |index: usize| if index == half { 1.0 - self.taps[index] } else { -self.taps[index] };
        let (mut sum, mut taps) = (0.0, Vec::with_capacity(self.taps.len()));
        // Summed twice; both sums end at 0 because the taps of the rest are even and add up to 0.
        let mut twice = 0.0;
        for index in 0..self.taps.len() {
            taps.push(twice);
            sum += rest(index);
            twice += sum;
        }
        ZeroPhaseLowpass { taps, ..self.clone() }
    }

    /// Standard deviation of the filtered signal that white noise of standard deviation 1 gives
    /// after a stencil (such as a second difference `[1, -2, 1]`).
    pub fn noise_gain(&self, stencil: &[f64]) -> f64 {
        let mut combined = vec![0.0; self.taps.len() + stencil.len() - 1];
        for (index, tap) in self.taps.iter().enumerate() {
            for (offset, weight) in stencil.iter().enumerate() {
                combined[index + offset] += tap * weight;
            }
        }
        combined.iter().map(|weight| weight * weight).sum::<f64>().sqrt()
    }

    /// Rate of the kept values, Hz.
    pub fn kept_rate(&self) -> f64 {
        self.rate / self.factor as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gain at a frequency, Hz: the part of the filtered sine that is the sine itself.
    fn gain_at(frequency: f64) -> f64 {
        let (rate, corner) = (2000.0, 200.0);
        let lowpass = ZeroPhaseLowpass::new(corner, rate);
        let signal: Vec<f64> =
            (0..4000).map(|k| (TAU * frequency * k as f64 / rate).sin()).collect();
        let (product, square) =
            lowpass.kept(signal.len(), 0).fold((0.0, 0.0), |(product, square), index| {
                (
                    product + lowpass.at(&signal, index) * signal[index],
                    square + signal[index] * signal[index],
                )
            });
        product / square
    }

    #[test]
    fn values_filtered_together_have_the_bits_of_each_alone() {
        let signal: Vec<f64> = (0..2000).map(|k| (0.37 * f64::from(k * k)).sin()).collect();
        for rate in [250.0, 1000.0, 2000.0, 3300.0] {
            let lowpass = ZeroPhaseLowpass::new(f64::min(200.0, rate / 5.0), rate);
            // Whole, with a hole, and too short to advance together.
            let mut rows: Vec<usize> = lowpass.kept(signal.len(), 3).collect();
            rows.drain(40..61);
            rows.drain(45..46);
            let alone: Vec<u64> =
                rows.iter().map(|row| lowpass.at(&signal, *row).to_bits()).collect();
            let together: Vec<u64> =
                lowpass.at_all(&signal, &rows).into_iter().map(f64::to_bits).collect();
            assert_eq!(together, alone, "{rate} Hz");
        }
        assert!(ZeroPhaseLowpass::new(200.0, 2000.0).at_all(&signal, &[]).is_empty());
    }

    #[test]
    fn passes_low_frequencies_and_stops_high_ones() {
        assert!((gain_at(51.0) - 1.0).abs() < 1e-3, "{}", gain_at(51.0));
        assert!((gain_at(201.0) - 0.5).abs() < 0.02, "{}", gain_at(201.0));
        assert!(gain_at(401.0).abs() < 1e-3, "{}", gain_at(401.0));
    }

    #[test]
    fn has_no_phase() {
        let lowpass = ZeroPhaseLowpass::new(200.0, 2000.0);
        let signal: Vec<f64> = (0..400).map(|k| k as f64).collect();
        for index in lowpass.kept(signal.len(), 0) {
            assert!((lowpass.at(&signal, index) - index as f64).abs() < 1e-9);
        }
    }

    /// ZeroPhaseLowpass of a signal and rest of its second differences are the signal again.
    #[test]
    fn the_rest_of_second_differences_is_what_the_lowpass_takes_out() {
        let lowpass = ZeroPhaseLowpass::new(100.0, 2000.0);
        let rest = lowpass.rest_of_second_differences();
        for frequency in [3.0, 90.0, 140.0, 700.0] {
            let signal: Vec<f64> = (0..400)
                .map(|k| (TAU * frequency * k as f64 / 2000.0).sin() + 1e-3 * k as f64)
                .collect();
            let second: Vec<f64> = (0..400)
                .map(|k| {
                    if k == 0 || k == 399 {
                        0.0
                    } else {
                        signal[k + 1] - 2.0 * signal[k] + signal[k - 1]
                    }
                })
                .collect();
            for k in [150, 201, 233] {
                let whole = lowpass.at(&signal, k) + rest.at(&second, k);
                assert!(
                    (whole - signal[k]).abs() < 1e-9,
                    "{frequency} Hz, {k}: {whole} of {}",
                    signal[k]
                );
            }
        }
    }

    #[test]
    fn noise_gain_of_white_noise_is_the_root_of_the_pass_band() {
        let lowpass = ZeroPhaseLowpass::new(200.0, 2000.0);
        // 200 of 1000 Hz pass; the soft edge of the band costs some of it.
        assert!(
            (lowpass.noise_gain(&[1.0]) / 0.2f64.sqrt() - 1.0).abs() < 0.1,
            "{}",
            lowpass.noise_gain(&[1.0])
        );
        // Second difference: root of the integral of (2 sin(w/2))^4 over the band, about
        // (w^5/5/pi)^(1/2).
        let w: f64 = TAU * 200.0 / 2000.0;
        assert!(
            (lowpass.noise_gain(&[1.0, -2.0, 1.0]) / (w.powi(5) / 5.0 / PI).sqrt() - 1.0).abs()
                < 0.2
        );
    }
}
