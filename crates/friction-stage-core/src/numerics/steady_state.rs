//! Where the transient at the start of a signal ends.

/// Index of the first value after the transient: with what is left out up to there, the standard
/// error of the mean of the rest is least (MSER; K. P. White, "An effective truncation heuristic
/// for bias reduction in simulation output", Simulation 69, 1997). `None` where that is not within
/// the first half: the values still drift at the end.
pub fn steady_from(values: &[f64]) -> Option<usize> {
    let half = values.len() / 2;
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
        if index <= half && best.is_none_or(|(_, least)| error <= least) {
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
        (0..=values.len() / 2).min_by(|a, b| error(*a).total_cmp(&error(*b))).unwrap()
    }

    #[test]
    fn a_transient_is_left_out_and_noise_is_kept() {
        for seed in 0..100 {
            let noise = noise(400, seed);
            let from = steady_from(&noise).expect("noise does not drift");
            assert_eq!(from, by_definition(&noise));
            let charging: Vec<f64> = noise
                .iter()
                .enumerate()
                .map(|(k, n)| n - 50.0 * (-(k as f64) / 20.0).exp())
                .collect();
            let from = steady_from(&charging).expect("it has settled");
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
            assert_eq!(steady_from(&drift), None);
        }
        assert_eq!(steady_from(&[]), None);
        assert_eq!(steady_from(&[3.0]), Some(0));
        assert_eq!(steady_from(&[3.0; 10]), Some(0));
    }
}
