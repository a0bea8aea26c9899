//! Whether the log times of a recording fit the stamps of its messages.
//!
//! In: log time and stamp of each message that has one, in the order of log times. Out: messages
//! that were logged at another time than the others with such stamps, which makes a recording look
//! longer than it is. A recorder says when it heard a message, and the two clocks may differ by a
//! constant. Where they run at different rates, as a simulated clock does, nothing is said. Old
//! stamps (of messages that are sent again to late subscribers) are no fault of the log times.

use std::collections::BTreeMap;

/// How far a log time may be off, s: recorders on busy machines hear messages late. Assumed.
const LATE: f64 = 1.0;
/// Share of the messages that must fit for the clocks to run alike. Assumed.
const ALIKE: f64 = 0.9;
/// Places at which the difference of the clocks changes that are remembered.
const REMEMBERED: usize = 1000;
/// Differences that are counted apart.
const COUNTED: usize = 10_000;
/// Width of what is counted as one difference, ns.
const WIDTH: i64 = 50_000_000;

/// A message with the time at which it was logged and its stamp, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Logged {
    topic: usize,
    log_time: i64,
    stamp: i64,
}

impl Logged {
    fn difference(&self) -> i64 {
        self.log_time.saturating_sub(self.stamp)
    }
}

/// Gathers log times and stamps.
#[derive(Debug, Default)]
pub(super) struct LogTimes {
    /// Messages by log time minus stamp, in steps of [`WIDTH`].
    differences: BTreeMap<i64, u64>,
    messages: u64,
    first: Option<Logged>,
    last: Option<Logged>,
    /// Messages on both sides of each change.
    changes: Vec<Logged>,
}

/// Messages of a topic whose log times do not fit.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Misfit {
    pub topic: usize,
    pub messages: u64,
    /// The largest distance, s.
    pub seconds: f64,
}

/// The middle of a step, ns.
fn middle(step: i64) -> i64 {
    step.saturating_mul(WIDTH).saturating_add(WIDTH / 2)
}

impl LogTimes {
    pub fn take(&mut self, topic: usize, log_time: i64, stamp: i64) {
        let logged = Logged { topic, log_time, stamp };
        self.messages += 1;
        self.first.get_or_insert(logged);
        let step = logged.difference().div_euclid(WIDTH);
        if self.differences.len() < COUNTED || self.differences.contains_key(&step) {
            *self.differences.entry(step).or_insert(0) += 1;
        }
        if let Some(last) = self.last.replace(logged)
            && seconds(last.difference(), logged.difference()) > LATE
            && self.changes.len() < 2 * REMEMBERED
        {
            self.changes.extend([last, logged]);
        }
    }

    pub fn finish(mut self) -> Vec<Misfit> {
        let mut seen = 0;
        let median = self.differences.iter().find_map(|(step, count)| {
            seen += count;
            (2 * seen >= self.messages).then_some(middle(*step))
        });
        let Some(median) = median else { return Vec::new() };
        let is_near = |difference: i64| seconds(difference, median) <= LATE;
        let near: u64 = self
            .differences
            .iter()
            .filter(|(step, _)| is_near(middle(**step)))
            .map(|(_, count)| count)
            .sum();
        if (near as f64) < ALIKE * self.messages as f64 {
            return Vec::new();
        }
        let ends = self.first.iter().chain(&self.last);
        let fitting = ends.chain(&self.changes).filter(|logged| is_near(logged.difference()));
        let stamps: Vec<i64> = fitting.map(|logged| logged.stamp).collect();
        let (Some(&first), Some(&last)) = (stamps.iter().min(), stamps.iter().max()) else {
            return Vec::new();
        };
        // An old stamp lies outside of what was recorded; a stamp inside says that the log time
        // is wrong.
        let is_inside = |logged: &Logged| {
            let margin = (LATE * 1e9) as i64;
            (first.saturating_sub(margin)..=last.saturating_add(margin)).contains(&logged.stamp)
        };
        self.changes.sort_by_key(|logged| (logged.topic, logged.log_time, logged.stamp));
        self.changes.dedup();
        let mut found: Vec<Misfit> = Vec::new();
        for logged in &self.changes {
            if is_near(logged.difference()) || !is_inside(logged) {
                continue;
            }
            let off = seconds(logged.difference(), median);
            match found.last_mut().filter(|misfit| misfit.topic == logged.topic) {
                Some(misfit) => {
                    misfit.messages += 1;
                    misfit.seconds = misfit.seconds.max(off);
                }
                None => found.push(Misfit { topic: logged.topic, messages: 1, seconds: off }),
            }
        }
        found
    }
}

fn seconds(one: i64, other: i64) -> f64 {
    one.abs_diff(other) as f64 * 1e-9
}

#[cfg(test)]
mod tests {
    use super::*;

    const MILLISECOND: i64 = 1_000_000;
    const SECOND: i64 = 1000 * MILLISECOND;

    /// Topic 0 at 1 kHz for 2 s, its stamps `rate` times as fast as the log; and other messages.
    fn misfits(rate: f64, others: &[(usize, i64, i64)]) -> Vec<Misfit> {
        let begin = 1_700_000_000 * SECOND;
        let sample =
            |k: i64| (0, begin + k * MILLISECOND, (rate * (k * MILLISECOND) as f64) as i64);
        let mut all: Vec<(usize, i64, i64)> = (0..2000).map(sample).collect();
        all.extend(others.iter().map(|(topic, log, stamp)| (*topic, begin + log, *stamp)));
        all.sort_by_key(|(_, log_time, _)| *log_time);
        let mut times = LogTimes::default();
        all.into_iter().for_each(|(topic, log_time, stamp)| times.take(topic, log_time, stamp));
        times.finish()
    }

    #[test]
    fn a_message_that_was_logged_before_the_recording_is_told() {
        // Its stamp is in the recording, its log time 8 s before it.
        let early = (1, -8 * SECOND, 300 * MILLISECOND);
        let found = misfits(1.0, &[early, (1, SECOND, SECOND)]);
        assert_eq!(found.len(), 1);
        assert_eq!((found[0].topic, found[0].messages), (1, 1));
        assert!((found[0].seconds - 8.3).abs() < 0.1, "{found:?}");
        let late = (1, 9 * SECOND, 300 * MILLISECOND);
        assert!((misfits(1.0, &[late])[0].seconds - 8.7).abs() < 0.1);
    }

    #[test]
    fn clocks_of_other_origins_delays_and_old_stamps_are_no_fault() {
        assert_eq!(misfits(1.0, &[]), []);
        assert_eq!(misfits(1.0, &[(1, 500 * MILLISECOND, 0)]), []);
        // A transform that was sent long ago and is sent to each new subscriber.
        assert_eq!(misfits(1.0, &[(1, 10 * MILLISECOND, -500 * SECOND)]), []);
        // A simulated clock, four times as fast.
        assert_eq!(misfits(4.0, &[(1, -8 * SECOND, 300 * MILLISECOND)]), []);
        assert_eq!(LogTimes::default().finish(), []);
    }
}
