//! What the stage's sensors read: encoder and force cell with seeded noise.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::model::StageModel;

/// Encoder and force cell. The same seed and the same truth give the same readings.
#[derive(Clone, Debug)]
pub(super) struct Sensors {
    random: ChaCha8Rng,
    resolution: f64,
    position_noise: f64,
    force_noise: f64,
}

/// One reading of both sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reading {
    /// m, quantised
    pub position: f64,
    /// N
    pub force_cell: f64,
}

impl Sensors {
    /// The sensors of a model; `seed` starts their noise.
    pub(super) fn new(model: &StageModel, seed: u64) -> Sensors {
        Sensors {
            random: ChaCha8Rng::seed_from_u64(seed),
            resolution: model.encoder.resolution,
            position_noise: model.encoder.noise,
            force_noise: model.force_cell.noise,
        }
    }

    /// Reads the true position (m) and coupling force (N). Always draws twice, so that noise levels
    /// do not shift the sequence.
    pub(super) fn read(&mut self, position: f64, force: f64) -> Reading {
        let mut normal = || -> f64 { StandardNormal.sample(&mut self.random) };
        let noisy = position + self.position_noise * normal();
        let force_cell = force + self.force_noise * normal();
        let position = if self.resolution > 0.0 {
            (noisy / self.resolution).round() * self.resolution
        } else {
            noisy
        };
        Reading { position, force_cell }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_the_declared_size_and_the_encoder_reads_whole_counts() {
        let mut model = StageModel::default();
        model.encoder.noise = 5e-9;
        let mut sensors = Sensors::new(&model, 7);
        let count = 20_000;
        let readings: Vec<Reading> = (0..count).map(|_| sensors.read(0.012_345, 3.0)).collect();
        let rms = |values: &mut dyn Iterator<Item = f64>| {
            (values.map(|x| x * x).sum::<f64>() / count as f64).sqrt()
        };
        let force_noise = rms(&mut readings.iter().map(|reading| reading.force_cell - 3.0));
        let position_noise = rms(&mut readings.iter().map(|reading| reading.position - 0.012_345));
        // Standard error of an rms over 20,000 samples is 0.5 %; rounding to counts adds 1/sqrt(12)
        // nm.
        assert!((force_noise / 0.05 - 1.0).abs() < 0.02, "{force_noise}");
        assert!(
            (position_noise / (25.0f64 + 1.0 / 12.0).sqrt() / 1e-9 - 1.0).abs() < 0.02,
            "{position_noise}"
        );
        for reading in &readings {
            let counts = reading.position / 1e-9;
            assert!((counts - counts.round()).abs() < 1e-6, "{counts}");
        }
    }

    #[test]
    fn same_seed_same_readings_other_seed_other_readings() {
        let model = StageModel::default();
        let read = |seed| {
            let mut sensors = Sensors::new(&model, seed);
            (0..50).map(|_| sensors.read(1e-3, 1.0).force_cell.to_bits()).collect::<Vec<_>>()
        };
        assert_eq!(read(1), read(1));
        assert_ne!(read(1), read(2));
    }
}
