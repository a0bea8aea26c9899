//! What the stage node tells about itself: counters that its threads write and `/diagnostics` reads.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};

use super::runtime::lock;
use crate::message::{DiagnosticStatus, KeyValue};

/// Upper bounds of the lateness histogram, ns: powers of 2 from 256 ns to 2 s.
const BUCKETS: usize = 24;
const FIRST_BUCKET: u32 = 8;

/// Counters of one stage node since its start. Written without locks on the tick.
#[derive(Debug, Default)]
pub struct StageStatus {
    /// Number of the sample published last, and its stamp, ns.
    pub sample: AtomicU64,
    pub stamp: AtomicI64,
    /// Commands that were refused.
    pub refused: AtomicU64,
    /// Samples at which the command was beyond the motor's limit.
    pub clamped: AtomicU64,
    /// Times that the commands stopped coming.
    pub stale: AtomicU64,
    /// The commands have stopped: the motor force is zero.
    pub is_stale: AtomicBool,
    /// Lockstep: answers that took longer than the timeout, and whether one is missing now.
    pub missing_answers: AtomicU64,
    pub is_unanswered: AtomicBool,
    /// A source commands the stage.
    pub commanded: AtomicBool,
    pub disabled: AtomicBool,
    /// Real time: ticks that came later than a whole period.
    pub overruns: AtomicU64,
    /// Samples that were not published because the publishing thread could not follow.
    pub unpublished: AtomicU64,
    /// The tick thread runs under SCHED_FIFO.
    pub real_time_scheduling: AtomicBool,
    /// Another stage publishes under the same name.
    pub duplicate: AtomicBool,
    lateness: [AtomicU64; BUCKETS],
    largest_lateness: AtomicI64,
    last_refusal: Mutex<Option<String>>,
}

/// Lateness of the ticks, us. Quantiles are upper bounds of their histogram bucket.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lateness {
    pub p50: f64,
    pub p99: f64,
    pub max: f64,
}

impl StageStatus {
    /// Counts a tick that was `lateness` ns late.
    #[inline]
    pub fn ticked(&self, lateness: i64, period: i64) {
        let bits = 63 - (lateness.max(1) as u64).leading_zeros();
        let bucket = bits.saturating_sub(FIRST_BUCKET - 1).min(BUCKETS as u32 - 1);
        self.lateness[bucket as usize].fetch_add(1, Ordering::Relaxed);
        self.largest_lateness.fetch_max(lateness, Ordering::Relaxed);
        if lateness > period {
            self.overruns.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// `None` before the first tick.
    pub fn lateness(&self) -> Option<Lateness> {
        let counts: Vec<u64> = self.lateness.iter().map(|count| count.load(Ordering::Relaxed)).collect();
        let total: u64 = counts.iter().sum();
        let quantile = |part: f64| {
            let mut seen = 0;
            let bucket = counts.iter().position(|count| {
                seen += count;
                seen as f64 >= part * total as f64
            });
            bucket.map_or(0.0, |bucket| (1u64 << (bucket as u32 + FIRST_BUCKET)) as f64 * 1e-3)
        };
        let max = self.largest_lateness.load(Ordering::Relaxed) as f64 * 1e-3;
        (total > 0).then(|| Lateness { p50: quantile(0.5).min(max), p99: quantile(0.99).min(max), max })
    }

    /// Counts a refused command and logs it; a flood is logged at powers of ten only.
    pub fn refuse(&self, reason: &str) {
        let count = self.refused.fetch_add(1, Ordering::Relaxed) + 1;
        let is_new = lock(&self.last_refusal).replace(reason.to_owned()).as_deref() != Some(reason);
        if is_new && count < 100 || count.is_power_of_two() {
            tracing::warn!("command refused: {reason} ({count} refused so far)");
        }
    }

    pub fn last_refusal(&self) -> Option<String> {
        lock(&self.last_refusal).clone()
    }

    /// The status for `/diagnostics`: the worst thing first, all counters as values.
    pub fn diagnostic(
        &self,
        name: String,
        hardware: String,
        more: Vec<KeyValue>,
        faults: &[String],
    ) -> DiagnosticStatus {
        let get = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let is = |flag: &AtomicBool| flag.load(Ordering::Relaxed);
        let mut level = DiagnosticStatus::OK;
        let mut words = Vec::new();
        let mut note = |when: bool, severity: u8, text: String| {
            if when {
                level = level.max(severity);
                words.push(text);
            }
        };
        note(is(&self.duplicate), DiagnosticStatus::ERROR, "another stage has the same name".to_owned());
        note(
            is(&self.is_unanswered),
            DiagnosticStatus::ERROR,
            "lockstep: the answer to the last sample is missing".to_owned(),
        );
        for fault in faults {
            note(true, DiagnosticStatus::ERROR, fault.clone());
        }
        note(is(&self.is_stale), DiagnosticStatus::WARN, "commands have stopped: motor force is zero".to_owned());
        note(is(&self.disabled), DiagnosticStatus::WARN, "disabled: motor force is zero".to_owned());
        let refusal = self.last_refusal();
        if let Some(reason) = &refusal {
            note(true, DiagnosticStatus::WARN, format!("commands refused, last: {reason}"));
        }
        note(get(&self.unpublished) > 0, DiagnosticStatus::WARN, "samples were not published".to_owned());
        let idle = if is(&self.commanded) { "running" } else { "waiting for the first command" };
        let message = if words.is_empty() { idle.to_owned() } else { words.join("; ") };
        let mut values = vec![
            KeyValue::new("sample", get(&self.sample)),
            KeyValue::new("refused_commands", get(&self.refused)),
            KeyValue::new("clamped_samples", get(&self.clamped)),
            KeyValue::new("stale_commands", get(&self.stale)),
            KeyValue::new("missing_answers", get(&self.missing_answers)),
            KeyValue::new("overruns", get(&self.overruns)),
            KeyValue::new("unpublished_samples", get(&self.unpublished)),
        ];
        if let Some(lateness) = self.lateness() {
            values.push(KeyValue::new("real_time_scheduling", is(&self.real_time_scheduling)));
            values.push(KeyValue::new("lateness_p50_us", lateness.p50));
            values.push(KeyValue::new("lateness_p99_us", lateness.p99));
            values.push(KeyValue::new("lateness_max_us", lateness.max));
        }
        if let Some(reason) = refusal {
            values.push(KeyValue::new("last_refusal", reason));
        }
        values.extend(more);
        DiagnosticStatus { level, name, message, hardware_id: hardware, values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_bound_the_lateness_from_above_within_a_factor_of_two() {
        let status = StageStatus::default();
        assert_eq!(status.lateness(), None);
        (0..990).for_each(|_| status.ticked(3_000, 250_000));
        (0..10).for_each(|_| status.ticked(400_000, 250_000));
        let lateness = status.lateness().unwrap();
        assert!((3.0..6.1).contains(&lateness.p50), "{lateness:?}");
        assert!((3.0..6.1).contains(&lateness.p99), "{lateness:?}");
        assert_eq!(lateness.max, 400.0);
        assert_eq!(status.overruns.load(Ordering::Relaxed), 10);
    }

    #[test]
    fn a_missing_answer_is_an_error_and_a_refused_command_a_warning() {
        let status = StageStatus::default();
        let level = |status: &StageStatus| status.diagnostic("a".into(), "b".into(), vec![], &[]).level;
        assert_eq!(level(&status), DiagnosticStatus::OK);
        status.refuse("force is NaN");
        assert_eq!(level(&status), DiagnosticStatus::WARN);
        status.is_unanswered.store(true, Ordering::Relaxed);
        assert_eq!(level(&status), DiagnosticStatus::ERROR);
    }
}
