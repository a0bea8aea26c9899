//! How late a controller is: the time that a sample of real time took to its answer.
//!
//! In: the stamp of each sample and the system clock. Out: the delay beyond the least one of the
//! last seconds, as a peak that fades. So the clocks of two machines need not agree, and a stage
//! whose stamps lag for good after a pause has a delay for some seconds only. Stamps of simulated
//! time are far from the system clock and have no delay.

/// Farther from the system clock than this, a stamp is of simulated time, ns.
const SIMULATED: i64 = 60_000_000_000;
/// The least delay is that of this time at least, and of about twice as much at most, ns. A loop
/// that is faster than its samples has soon taken all that wait; the delay of one that is slower
/// grows beyond the least of this time.
const REMEMBERED: i64 = 4_000_000_000;
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
    /// When the newer of the two least ages began, ns.
    since: i64,
    /// Least age before then, and from then on, ns.
    least: [i64; 2],
}

impl Delay {
    /// Takes a sample with `stamp` that is answered at `now`, both ns; the peak of the delay, s.
    pub fn observe(&mut self, stamp: i64, now: i64) -> f64 {
        let age = now.saturating_sub(stamp);
        if age.saturating_abs() > SIMULATED {
            *self = Delay::default();
            return 0.0;
        }
        let mut last = self.last.unwrap_or(Last { now, since: now, least: [age, age] });
        if now - last.since > REMEMBERED {
            (last.since, last.least) = (now, [last.least[1], age]);
        }
        last.least[1] = last.least[1].min(age);
        let least = last.least[0].min(last.least[1]);
        let passed = (now - last.now).max(0) as f64 * 1e-9;
        last.now = now;
        self.last = Some(last);
        self.peak = (self.peak * (-passed / FADES).exp()).max((age - least) as f64 * 1e-9);
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

    /// As after a stage was stopped for a second: its time continues from where it was.
    #[test]
    fn stamps_that_lag_for_good_are_late_for_some_seconds_only() {
        let (mut delay, start, ms) = (Delay::default(), 1_700_000_000_000_000_000, 1_000_000);
        let mut at = |k: i64, late: i64| delay.observe(start + k * ms, start + k * ms + late);
        assert!((0..5_000).all(|k| at(k, ms / 10) < 1e-6));
        let during: Vec<f64> = (5_000..20_000).map(|k| at(k, 1_000 * ms)).collect();
        assert!((during[1_000] - 1.0).abs() < 1e-2, "{}", during[1_000]);
        assert!(during[14_000] < 1e-3, "{}", during[14_000]);
    }

    #[test]
    fn simulated_time_has_no_delay() {
        let mut delay = Delay::default();
        assert_eq!(delay.observe(1_000_000_000, 1_700_000_000_000_000_000), 0.0);
        assert_eq!(delay.observe(1_001_000_000, 1_700_000_005_000_000_000), 0.0);
    }
}
