//! Where the transient at the start of a signal ends.

/// Index of the first value after the transient, which has `most` values at most: with what is left
/// out up to there, the standard error of the mean of the rest is least (MSER; K. P. White, "An
/// effective truncation heuristic for bias reduction in simulation output", Simulation 69, 1997).
/// `None` where it would take half of the values or more: they still drift at the end.
pub fn steady_from(values: &[f64], most: usize) -> Option<usize> {
    let half = values.len() / 2;
    // Beyond the half, so that noise does not decide about what drifts.
    let last = if most < half { most } else { 3 * values.len() / 4 };
    // Mean and sum of squared deviations of the values from an index on, last to first (Welford,
    // Technometrics 4, 1962).
    let (mut count, mut mean, mut squares) = (0.0, 0.0, 0.0);
    let mut best = None;
    for (index, value) in values.iter().enumerate().rev() {
        count += 1.0;
        let from_mean = value - mean;
        mean += from_mean / count;
        squares += from_mean * (value - mean);
        let error = squares / (count * count);
        // Of equals the longest.
        if index <= last && best.is_none_or(|(_, least)| error <= least) {
            best = Some((index, error));
        }
    }
    best.map(|(index, _)| index).filter(|index| *index < half || values.len() < 2)
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng as _;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution as _, StandardNormal};

    use super::*;

    fn noise(count: usize, seed: u64) -> Vec<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        (0..count).map(|_| StandardNormal.sample(&mut random)).collect()
    }

    /// By the definition: for each start the variance of the rest over its length.
    fn by_definition(values: &[f64]) -> usize {
        let error = |from: usize| {
            let rest = &values[from..];
            let mean = rest.iter().sum::<f64>() / rest.len() as f64;
            rest.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (rest.len() as f64).powi(2)
        };
        (0..=3 * values.len() / 4).min_by(|a, b| error(*a).total_cmp(&error(*b))).unwrap()
    }

    #[test]
    fn a_transient_is_left_out_and_noise_is_kept() {
        for seed in 0..100 {
            let noise = noise(400, seed);
            let from = steady_from(&noise, usize::MAX).expect("noise does not drift");
            assert_eq!(from, by_definition(&noise));
            let charging: Vec<f64> = noise
                .iter()
                .enumerate()
                .map(|(k, n)| n - 50.0 * (-(k as f64) / 20.0).exp())
                .collect();
            let from = steady_from(&charging, usize::MAX).expect("it has settled");
            assert_eq!(from, by_definition(&charging));
            // Where 50 exp(-k/20) is 1 and 0.05 of the noise's deviation.
            assert!((60..200).contains(&from), "{from}");
        }
    }

    #[test]
    fn what_drifts_to_the_end_is_not_steady() {
        for seed in 0..100 {
            let drift: Vec<f64> =
                noise(400, seed).iter().enumerate().map(|(k, n)| n + 0.05 * k as f64).collect();
            assert_eq!(steady_from(&drift, usize::MAX), None);
            // Of what is no transient no more than one may take.
            assert!(steady_from(&drift, 20).is_some_and(|from| from <= 20));
            let wave: Vec<f64> = noise(400, seed)
                .iter()
                .zip(0..)
                .map(|(n, k)| 0.05 * n + (0.0157 * f64::from(k)).sin())
                .collect();
            let from = steady_from(&wave, 20).expect("a wave is no drift");
            let rest = &wave[from..];
            assert!((rest.iter().sum::<f64>() / rest.len() as f64).abs() < 0.05);
        }
        assert_eq!(steady_from(&[], 9), None);
        assert_eq!(steady_from(&[3.0], 9), Some(0));
        assert_eq!(steady_from(&[3.0; 10], 9), Some(0));
    }
}
