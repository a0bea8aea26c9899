//! How many values of a signal are independent of each other.

/// Correlation below which values count as independent, and lag that is looked at most. Assumed.
const INDEPENDENT: f64 = 0.05;
const LONGEST_LAG: usize = 2000;

/// How many neighbouring values of a signal say the same thing: 1 + 2 sum of the autocorrelation
/// while it is more than that of noise.
pub fn correlation_length(values: &[f64]) -> f64 {
    length_weighted(values, |_| 1.0)
}

/// The same for what is asked of it along another signal: the products of both autocorrelations
/// count (Bartlett, J. R. Stat. Soc. Suppl. 8, 1946). What drifts says little of a line, and much
/// of a force that changes from row to row. Along nothing: along a constant.
pub fn correlation_length_along(values: &[f64], along: &[f64]) -> f64 {
    let power = product_at(along, 0);
    let mut products = Products::new(along);
    length_weighted(values, |lag| if power > 0.0 { products.at(lag) / power } else { 1.0 })
}

/// 1 + 2 sum of the autocorrelation of a signal times a weight of the lag.
fn length_weighted(values: &[f64], mut weight: impl FnMut(usize) -> f64) -> f64 {
    let power = product_at(values, 0);
    if power <= 0.0 {
        return 1.0;
    }
    let mut products = Products::new(values);
    let correlations =
        (1..values.len().min(LONGEST_LAG)).map(|lag| (lag, products.at(lag) / power));
    let correlated = correlations.take_while(|(_, correlation)| *correlation > INDEPENDENT);
    correlated
        .fold(1.0, |length, (lag, correlation)| length + 2.0 * correlation * weight(lag))
        .max(1.0)
}

/// Sum of the products of a signal with itself a lag later.
fn product_at(values: &[f64], lag: usize) -> f64 {
    values.iter().zip(&values[lag..]).map(|(one, later)| one * later).sum()
}

/// Lags whose sums advance together.
const LAGS: usize = 8;

/// Sums of the products of a signal with itself later, bit for bit those of [`product_at`], for
/// lags that are asked for one after the other: of several lags at once, since in a sum each
/// addition waits for the one before it.
struct Products<'a> {
    values: &'a [f64],
    first: usize,
    sums: [f64; LAGS],
}

impl<'a> Products<'a> {
    fn new(values: &'a [f64]) -> Products<'a> {
        Products { values, first: usize::MAX, sums: [0.0; LAGS] }
    }

    /// Of a lag that is less than the number of values.
    fn at(&mut self, lag: usize) -> f64 {
        let values = self.values;
        if lag < self.first || lag - self.first >= LAGS {
            self.first = lag;
            // As an iterator begins a sum.
            self.sums = [-0.0; LAGS];
            for (one, later) in values.iter().zip(values[lag..].windows(LAGS)) {
                for (sum, later) in self.sums.iter_mut().zip(later) {
                    *sum += one * later;
                }
            }
            // The last ones of each lag, for which the longest has no more.
            let common = (values.len() - lag).saturating_sub(LAGS - 1);
            for (more, sum) in self.sums.iter_mut().enumerate() {
                let later = values.get(lag + more + common..).unwrap_or_default();
                for (one, later) in values[common..].iter().zip(later) {
                    *sum += one * later;
                }
            }
        }
        self.sums[lag - self.first]
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    use super::*;

    #[test]
    fn products_of_several_lags_have_the_bits_of_each_alone() {
        for count in [1usize, 7, 8, 9, 40] {
            let values: Vec<f64> = (0..count).map(|k| (0.7 * (k * k) as f64).sin() + 0.3).collect();
            let mut products = Products::new(&values);
            for lag in (0..count).chain([3 % count]) {
                let (together, alone) = (products.at(lag), product_at(&values, lag));
                assert_eq!(together.to_bits(), alone.to_bits(), "{count} values, lag {lag}");
            }
        }
    }

    /// Of a first-order autoregression of 0.9 along a wave: 1 + 2 sum 0.9^k cos(w k) = (1 - 0.81) /
    /// (1 - 1.8 cos w + 0.81); along a constant 19.
    #[test]
    fn what_is_slow_says_little_of_a_constant_and_much_of_a_wave() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut last = 0.0;
        let mut next = || {
            let step: f64 = StandardNormal.sample(&mut random);
            last = 0.9 * last + step;
            last
        };
        let values: Vec<f64> = (0..100_000).map(|_| next()).collect();
        let wave = |frequency: f64| -> Vec<f64> {
            (0..values.len()).map(|row| (frequency * row as f64).sin()).collect()
        };
        for frequency in [0.02f64, 0.05, 0.1] {
            let expected = (1.0 - 0.81) / (1.0 - 1.8 * frequency.cos() + 0.81);
            let length = correlation_length_along(&values, &wave(frequency));
            // The sum ends at a correlation of 0.05.
            assert!((length / expected - 1.0).abs() < 0.1, "{frequency}: {length}, {expected}");
        }
        assert_eq!(correlation_length_along(&values, &wave(1.0)), 1.0);
        let (alone, along) = (
            correlation_length(&values),
            correlation_length_along(&values, &vec![1.0; values.len()]),
        );
        assert!(
            (alone / 19.0 - 1.0).abs() < 0.1 && (along / alone - 1.0).abs() < 0.01,
            "{alone}, {along}"
        );
    }
}
