//! Random numbers of the generator: PCG XSL RR 128/64 (O'Neill 2014) with Gaussian numbers by the
//! polar method (Marsaglia and Bray 1964), on purpose not the source and not the method of the
//! library.

use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};

/// A stream of random numbers.
#[derive(Debug, Clone)]
pub struct Noise {
    source: Pcg64,
    spare: Option<f64>,
}

impl Noise {
    /// Stream `purpose` of `seed`: streams of different purposes are independent.
    pub fn new(seed: u64, purpose: u64) -> Self {
        let mut key = [0; 32];
        key[..8].copy_from_slice(&seed.to_le_bytes());
        key[8..16].copy_from_slice(&purpose.to_le_bytes());
        // The increment of a PCG picks the stream and has to differ in more than its lowest bits.
        key[16..24].copy_from_slice(&purpose.wrapping_mul(0x9e37_79b9_7f4a_7c15).to_le_bytes());
        let mut source = Pcg64::from_seed(key);
        for _ in 0..16 {
            source.next_u64();
        }
        Self { source, spare: None }
    }

    /// Uniform in `[0, 1)`.
    pub fn unit(&mut self) -> f64 {
        (self.source.next_u64() >> 11) as f64 * 2f64.powi(-53)
    }

    /// Uniform between two values.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Uniform in the logarithm between two positive values.
    pub fn log_between(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    /// +1 or -1.
    pub fn sign(&mut self) -> f64 {
        if self.unit() < 0.5 { -1.0 } else { 1.0 }
    }

    /// An angle, rad, in `[0, 2 pi)`.
    pub fn angle(&mut self) -> f64 {
        self.between(0.0, std::f64::consts::TAU)
    }

    /// An index below `count`.
    pub fn index(&mut self, count: usize) -> usize {
        ((self.unit() * count as f64) as usize).min(count - 1)
    }

    /// Standard normal.
    pub fn normal(&mut self) -> f64 {
        if let Some(spare) = self.spare.take() {
            return spare;
        }
        loop {
            let (a, b) = (self.between(-1.0, 1.0), self.between(-1.0, 1.0));
            let radius = a * a + b * b;
            if radius > 0.0 && radius < 1.0 {
                let factor = (-2.0 * radius.ln() / radius).sqrt();
                self.spare = Some(b * factor);
                return a * factor;
            }
        }
    }
}
