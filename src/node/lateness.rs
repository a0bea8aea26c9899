//! Lateness of ticks: a histogram that a tick thread fills without a lock and anybody reads.

use std::sync::atomic::{AtomicI64, AtomicU64, Ordering};

/// Buckets per doubling: quantiles are at most an eighth too large.
const PER_OCTAVE: u32 = 8;
const OCTAVES: u32 = 40;
const BUCKETS: usize = (PER_OCTAVE * OCTAVES) as usize;

/// Counts of lateness in ns, on a logarithmic scale.
#[derive(Debug)]
pub struct LatenessHistogram {
    counts: [AtomicU64; BUCKETS],
    largest: AtomicI64,
    overruns: AtomicU64,
}

/// Lateness of the ticks, us. Quantiles are upper bounds of their bucket.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lateness {
    pub p50: f64,
    pub p99: f64,
    pub max: f64,
}

impl Default for LatenessHistogram {
    fn default() -> Self {
        LatenessHistogram {
            counts: [const { AtomicU64::new(0) }; BUCKETS],
            largest: AtomicI64::new(0),
            overruns: AtomicU64::new(0),
        }
    }
}

/// Bucket of a lateness of at least 8 ns: the exponent and three bits behind the leading one.
fn bucket(nanos: i64) -> usize {
    let nanos = nanos.max(i64::from(PER_OCTAVE)) as u64;
    let exponent = 63 - nanos.leading_zeros();
    let fraction = (nanos >> (exponent - 3)) & 7;
    (((exponent - 3) * PER_OCTAVE) as usize + fraction as usize).min(BUCKETS - 1)
}

/// First lateness beyond a bucket, ns.
fn upper(bucket: usize) -> f64 {
    let (exponent, fraction) = (bucket as u32 / PER_OCTAVE, bucket as u32 % PER_OCTAVE);
    f64::from(PER_OCTAVE + fraction + 1) * f64::from(exponent).exp2()
}

impl LatenessHistogram {
    /// Counts a tick that was `nanos` late; later than `period` ns is an overrun.
    #[inline]
    pub fn record(&self, nanos: i64, period: i64) {
        self.counts[bucket(nanos)].fetch_add(1, Ordering::Relaxed);
        self.largest.fetch_max(nanos, Ordering::Relaxed);
        if nanos > period {
            self.overruns.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Ticks that came later than a whole period.
    pub fn overruns(&self) -> u64 {
        self.overruns.load(Ordering::Relaxed)
    }

    /// `None` before the first tick.
    pub fn lateness(&self) -> Option<Lateness> {
        let counts: Vec<u64> =
            self.counts.iter().map(|count| count.load(Ordering::Relaxed)).collect();
        let total: u64 = counts.iter().sum();
        let max = self.largest.load(Ordering::Relaxed) as f64 * 1e-3;
        let quantile = |part: f64| {
            let mut seen = 0;
            let found = counts.iter().position(|count| {
                seen += count;
                seen as f64 >= part * total as f64
            });
            (found.map_or(0.0, upper) * 1e-3).min(max)
        };
        (total > 0).then(|| Lateness { p50: quantile(0.5), p99: quantile(0.99), max })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_bound_the_lateness_from_above_within_an_eighth() {
        for nanos in [10, 999, 3_000, 61_234, 5_000_000] {
            let histogram = LatenessHistogram::default();
            assert_eq!(histogram.lateness(), None);
            (0..990).for_each(|_| histogram.record(nanos, 250_000));
            (0..10).for_each(|_| histogram.record(8_000_000, 250_000));
            let found = histogram.lateness().unwrap();
            for quantile in [found.p50, found.p99] {
                let ratio = quantile / (nanos as f64 * 1e-3);
                assert!(ratio > 1.0 && ratio < 1.126, "{nanos}: {found:?}");
            }
            assert_eq!(found.max, 8_000.0);
            assert_eq!(histogram.overruns(), if nanos > 250_000 { 1000 } else { 10 });
        }
    }
}
