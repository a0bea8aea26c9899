//! What the stage node tells about itself: counters that its threads write and `/diagnostics`
//! reads.

use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};

use super::commands::Refusal;
use super::lateness::LatenessHistogram;
use super::lock::lock;
use super::words::{Recent, quoted};
use friction_stage_core::control::Health;
use friction_stage_core::plant::StageState;
use friction_stage_data::message::{DiagnosticStatus, KeyValue};

/// Key in `/diagnostics` of the publisher that was refused because another one commands the stage
/// at once with it.
pub const SECOND_SOURCE: &str = "second_source";

/// Whether what has happened `count` times is logged: a flood is at powers of two only.
pub fn is_logged(count: u64) -> bool {
    count < 100 || count.is_power_of_two()
}

/// A publisher's GID as ROS tools write it: 16 bytes, hexadecimal, with dots.
pub fn gid_text(gid: &[u8; 16]) -> String {
    gid.map(|byte| format!("{byte:02x}")).join(".")
}

/// Counters of one stage node since its start. Written without locks on the tick.
#[derive(Debug, Default)]
pub struct StageStatus {
    /// Number of the sample published last, and its stamp, ns.
    pub sample: AtomicU64,
    pub stamp: AtomicI64,
    /// Position, velocity and acceleration of that sample, in bits.
    motion: [AtomicU64; 3],
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
    /// Lockstep: samples after which time moved on without an answer, and commands left out because
    /// they came before the sample that they would have answered.
    unanswered: AtomicU64,
    pub surplus: AtomicU64,
    /// A source commands the stage.
    pub commanded: AtomicBool,
    pub disabled: AtomicBool,
    /// Lockstep: time is paused.
    pub paused: AtomicBool,
    /// Real time: how late the ticks were.
    pub ticks: LatenessHistogram,
    /// Samples that were not published because the publishing thread could not follow.
    pub unpublished: AtomicU64,
    /// How many of them the diagnostics know of.
    unpublished_told: AtomicU64,
    /// The tick thread runs under SCHED_FIFO.
    pub real_time_scheduling: AtomicBool,
    last_refusal: Recent,
    /// The publisher that was refused last because another one commands the stage at once with it.
    second_source: Mutex<Option<[u8; 16]>>,
    last_unanswered: Recent,
    /// Samples were not published a moment ago.
    last_unpublished: Recent,
    /// `drive: servo`: how the stage's own loop does.
    servo: Mutex<Option<Health>>,
    /// Times that it did not hold.
    servo_faults: AtomicU64,
}

impl StageStatus {
    /// The true motion of the sample published last.
    pub fn set_motion(&self, state: &StageState) {
        let values = [state.position, state.velocity, state.acceleration];
        for (slot, value) in self.motion.iter().zip(values) {
            slot.store(value.to_bits(), Ordering::Relaxed);
        }
    }

    /// The same: m, m/s, m/s². In real time the three may be of neighbouring samples.
    pub fn motion(&self) -> [f64; 3] {
        self.motion.each_ref().map(|slot| f64::from_bits(slot.load(Ordering::Relaxed)))
    }

    /// How the stage's own loop does; logs it when that is of another kind than before.
    pub fn set_servo(&self, health: Health) {
        let before = lock(&self.servo).replace(health).unwrap_or(Health::Fine);
        if std::mem::discriminant(&before) == std::mem::discriminant(&health) {
            return;
        }
        match health {
            Health::Fine => {}
            Health::Warning(cause) => {
                if is_logged(self.servo_faults.fetch_add(1, Ordering::Relaxed) + 1) {
                    tracing::warn!("{cause}");
                }
            }
            Health::Stop(cause) => {
                tracing::error!("{cause}: damped stop; `~/enable` with true starts the loop again");
            }
        }
    }

    /// Counts a command that was refused by the rules of commands, and logs it.
    pub fn refuse_command(&self, refusal: &Refusal) {
        if let Refusal::OtherSource { second: Some(publisher), .. } = refusal {
            *lock(&self.second_source) = Some(*publisher);
        }
        self.refuse(&refusal.to_string());
    }

    /// Counts a refused command and logs it.
    pub fn refuse(&self, reason: &str) {
        let count = self.refused.fetch_add(1, Ordering::Relaxed) + 1;
        let is_new = self.last_refusal.set(reason);
        if is_new && is_logged(count) || count.is_power_of_two() {
            tracing::warn!("command refused: {} ({count} refused so far)", quoted(reason));
        }
    }

    /// Counts a sample after which time moves on without an answer, and logs it as refusals are.
    pub fn move_on(&self, reason: &str) {
        let count = self.unanswered.fetch_add(1, Ordering::Relaxed) + 1;
        self.last_unanswered.set(reason);
        if is_logged(count) {
            tracing::warn!("{reason} ({count} samples without an answer so far)");
        }
    }

    /// The status for `/diagnostics`: the worst thing first, all counters as values.
    pub fn diagnostic(
        &self,
        name: String,
        hardware: String,
        more: Vec<KeyValue>,
        faults: &[String],
        warnings: &[String],
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
        note(
            is(&self.is_unanswered),
            DiagnosticStatus::ERROR,
            "lockstep: the answer to the last sample is missing".to_owned(),
        );
        for fault in faults {
            note(true, DiagnosticStatus::ERROR, fault.clone());
        }
        match *lock(&self.servo) {
            Some(Health::Stop(cause)) => {
                note(true, DiagnosticStatus::ERROR, format!("stopped: {cause}"));
            }
            Some(Health::Warning(cause)) => note(true, DiagnosticStatus::WARN, cause.to_string()),
            Some(Health::Fine) | None => {}
        }
        for warning in warnings {
            note(true, DiagnosticStatus::WARN, warning.clone());
        }
        note(
            is(&self.is_stale),
            DiagnosticStatus::WARN,
            "commands have stopped: motor force is zero".to_owned(),
        );
        note(
            is(&self.disabled),
            DiagnosticStatus::WARN,
            "disabled: motor force is zero".to_owned(),
        );
        if let Some(reason) = self.last_unanswered.get() {
            note(true, DiagnosticStatus::WARN, reason);
        }
        let refusal = self.last_refusal.get();
        if let Some(reason) = &refusal {
            note(true, DiagnosticStatus::WARN, format!("commands refused, last: {reason}"));
        }
        let unpublished = get(&self.unpublished);
        if self.unpublished_told.swap(unpublished, Ordering::Relaxed) != unpublished {
            self.last_unpublished.set("samples were not published");
        }
        if let Some(words) = self.last_unpublished.get() {
            note(true, DiagnosticStatus::WARN, words);
        }
        let idle = match (is(&self.paused), is(&self.commanded)) {
            (true, _) => "paused",
            (false, true) => "running",
            (false, false) => "waiting for the first command",
        };
        let message = if words.is_empty() { idle.to_owned() } else { words.join("; ") };
        let mut values = vec![
            KeyValue::new("sample", get(&self.sample)),
            KeyValue::new("paused", is(&self.paused)),
            KeyValue::new("refused_commands", get(&self.refused)),
            KeyValue::new("clamped_samples", get(&self.clamped)),
            KeyValue::new("stale_commands", get(&self.stale)),
            KeyValue::new("missing_answers", get(&self.missing_answers)),
            KeyValue::new("unanswered_samples", get(&self.unanswered)),
            KeyValue::new("surplus_commands", get(&self.surplus)),
            KeyValue::new("overruns", self.ticks.overruns()),
            KeyValue::new("unpublished_samples", get(&self.unpublished)),
        ];
        if let Some(lateness) = self.ticks.lateness() {
            values.push(KeyValue::new("real_time_scheduling", is(&self.real_time_scheduling)));
            values.push(KeyValue::new("lateness_p50_us", lateness.p50));
            values.push(KeyValue::new("lateness_p99_us", lateness.p99));
            values.push(KeyValue::new("lateness_max_us", lateness.max));
        }
        if let Some(reason) = refusal {
            values.push(KeyValue::new("last_refusal", reason));
        }
        if let Some(publisher) = *lock(&self.second_source) {
            values.push(KeyValue::new(SECOND_SOURCE, gid_text(&publisher)));
        }
        values.extend(more);
        DiagnosticStatus { level, name, message, hardware_id: hardware, values }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::node::commands::CommandTopic;

    #[test]
    fn a_second_source_is_named_once_there_are_two_at_once() {
        let status = StageStatus::default();
        let reported = |status: &StageStatus| {
            let values = status.diagnostic("a".into(), "b".into(), vec![], &[], &[]).values;
            values.into_iter().find(|value| value.key == SECOND_SOURCE).map(|value| value.value)
        };
        let topic = CommandTopic::Force;
        let refusal = |second| Refusal::OtherSource { topic, owner: topic, since: 0, second };
        status.refuse_command(&refusal(None));
        assert_eq!(reported(&status), None);
        status.refuse_command(&refusal(Some([0xa5; 16])));
        assert_eq!(reported(&status), Some([["a5"; 16].join(".")].concat()));
    }

    #[test]
    fn a_missing_answer_is_an_error_and_a_refused_command_a_warning() {
        let status = StageStatus::default();
        let level = |status: &StageStatus| {
            status.diagnostic("a".into(), "b".into(), vec![], &[], &[]).level
        };
        assert_eq!(level(&status), DiagnosticStatus::OK);
        status.refuse("force is NaN");
        assert_eq!(level(&status), DiagnosticStatus::WARN);
        status.is_unanswered.store(true, Ordering::Relaxed);
        assert_eq!(level(&status), DiagnosticStatus::ERROR);
    }

    #[test]
    fn time_that_moved_on_without_an_answer_is_counted_and_a_warning() {
        let status = StageStatus::default();
        status.move_on("no answer");
        status.move_on("no answer");
        let reported = status.diagnostic("a".into(), "b".into(), vec![], &[], &[]);
        assert_eq!(
            (reported.level, reported.message.as_str()),
            (DiagnosticStatus::WARN, "no answer")
        );
        assert!(reported.values.contains(&KeyValue::new("unanswered_samples", 2)));
    }
}
