//! How late a controller is: the time that a sample of real time took to its answer.
//!
//! In: the stamp of each sample and the system clock. Out: the delay beyond the least one of late,
//! so that the clocks of two machines need not agree, as a peak that fades. Stamps of simulated
//! time are far from the system clock and have no delay.

/// Farther from the system clock than this, a stamp is of simulated time, ns.
const SIMULATED: i64 = 60_000_000_000;
/// The least delay rises by this share of time, so that it follows clocks that drift apart.
const DRIFT: f64 = 1e-4;
/// A peak falls to a third of itself within this time, s.
const FADES: f64 = 0.5;

/// The delay of a stream of samples.
#[derive(Clone, Debug, Default)]
pub struct Delay {
    last: Option<Last>,
    /// s
    peak: f64,
}

#[derive(Clone, Copy, Debug)]
struct Last {
    /// System time, ns.
    now: i64,
    /// Least age of late, ns.
    least: f64,
}

impl Delay {
    /// Takes a sample with `stamp` that is answered at `now`, both ns; the peak of the delay, s.
    pub fn observe(&mut self, stamp: i64, now: i64) -> f64 {
        let age = now.saturating_sub(stamp);
        if age.saturating_abs() > SIMULATED {
            *self = Delay::default();
            return 0.0;
        }
        let age = age as f64;
        let (least, passed) = match self.last {
            Some(last) => {
                let passed = (now - last.now).max(0) as f64;
                ((last.least + DRIFT * passed).min(age), passed * 1e-9)
            }
            None => (age, 0.0),
        };
        self.last = Some(Last { now, least });
        self.peak = (self.peak * (-passed / FADES).exp()).max((age - least) * 1e-9);
        self.peak
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_more_than_the_least_age_is_delay_and_it_fades() {
        let (mut delay, start, ms) = (Delay::default(), 1_700_000_000_000_000_000, 1_000_000);
        // A clock that is 3 s behind that of the stage.
        let mut at = |k: i64, late: i64| {
            let stamp = start + k * ms;
            delay.observe(stamp, stamp - 3_000 * ms + late)
        };
        assert!((0..100).all(|k| at(k, ms / 10) < 1e-6));
        let peak = at(100, 8 * ms);
        assert!((peak - 7.9e-3).abs() < 1e-6, "{peak}");
        let later = (101..600).map(|k| at(k, ms / 10)).last().unwrap();
        assert!((0.3..0.45).contains(&(later / peak)), "{later}");
    }

    #[test]
    fn simulated_time_has_no_delay() {
        let mut delay = Delay::default();
        assert_eq!(delay.observe(1_000_000_000, 1_700_000_000_000_000_000), 0.0);
        assert_eq!(delay.observe(1_001_000_000, 1_700_000_005_000_000_000), 0.0);
    }
}
