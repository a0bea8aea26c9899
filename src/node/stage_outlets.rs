//! What the stage publishes for each sample.

use std::time::{Duration, Instant};

use super::outlet::{Outlet, Published};
use super::participant::{Participant, ParticipantError};
use super::qos::{CLOCK, Qos, SAMPLES};
use super::runtime::Startup;
use super::stage_settings::{Mode, StageSettings};
use super::wire::{StageNames, Tick};
use friction_stage_data::message::{
    Clock, JointState, KeyValue, RosMessage, StageState, WrenchStamped,
};

/// Longest time that a sample is held in lockstep for subscribers that lag.
const LONGEST_PATIENCE: Duration = Duration::from_secs(20);
/// Longest wait in lockstep for them and for new writers.
const SETTLE: Duration = LONGEST_PATIENCE.saturating_add(Duration::from_secs(1));
/// Longest wait after a sample in lockstep for subscribers that catch up: between two samples the
/// stage follows orders.
const PACE_WITHIN: Duration = Duration::from_millis(50);

/// The publishers of the stage's samples.
pub struct StageOutlets {
    encoder: Outlet<JointState>,
    force_cell: Outlet<WrenchStamped>,
    state: Outlet<StageState>,
    clock: Option<Outlet<Clock>>,
    names: StageNames,
    clock_pause: Duration,
}

impl StageOutlets {
    pub fn new(
        startup: &Startup,
        participant: &Participant,
        names: StageNames,
        settings: &StageSettings,
    ) -> Result<StageOutlets, ParticipantError> {
        Ok(StageOutlets {
            encoder: outlet(startup, participant, settings, "~/encoder", &SAMPLES)?,
            force_cell: outlet(startup, participant, settings, "~/force_cell", &SAMPLES)?,
            state: outlet(startup, participant, settings, "~/state", &SAMPLES)?,
            clock: match settings.publish_clock {
                true => Some(outlet(startup, participant, settings, "/clock", &CLOCK)?),
                false => None,
            },
            names,
            clock_pause: settings.clock_pause,
        })
    }

    pub fn set_clock_pause(&mut self, pause: Duration) {
        self.clock_pause = pause;
    }

    /// Publishes a sample. The encoder goes first, because a controller waits for it.
    pub fn publish(&mut self, tick: &Tick) {
        let names = &self.names;
        let _ = self.encoder.publish(tick.encoder(names));
        let _ = self.force_cell.publish(tick.force_cell(names));
        let _ = self.state.publish(tick.state(names));
        if let Some(clock) = &mut self.clock {
            let _ = clock.publish(tick.clock());
        }
    }

    /// Publishes a sample in lockstep: nothing is left waiting in an outlet, no subscriber falls
    /// far behind, and the clock may come a pause later.
    pub fn publish_and_settle(&mut self, tick: &Tick) {
        let (names, deadline) = (&self.names, Instant::now() + SETTLE);
        settled(&mut self.encoder, tick.encoder(names), deadline);
        settled(&mut self.force_cell, tick.force_cell(names), deadline);
        settled(&mut self.state, tick.state(names), deadline);
        if !self.clock_pause.is_zero() {
            std::thread::sleep(self.clock_pause);
        }
        if let Some(clock) = &mut self.clock {
            settled(clock, tick.clock(), deadline);
        }
        let until = Instant::now() + PACE_WITHIN;
        self.encoder.keep_pace(until);
        self.force_cell.keep_pace(until);
        self.state.keep_pace(until);
        if let Some(clock) = &mut self.clock {
            clock.keep_pace(until);
        }
    }

    /// Messages lost and writers replaced, for `/diagnostics`.
    pub fn counts(&self) -> Vec<KeyValue> {
        let counts = [
            Some(self.encoder.counts()),
            Some(self.force_cell.counts()),
            Some(self.state.counts()),
            self.clock.as_ref().map(Outlet::counts),
        ];
        let sum = |part: fn(super::outlet::Counts) -> u64| {
            counts.iter().flatten().map(|counts| part(*counts)).sum::<u64>()
        };
        vec![
            KeyValue::new("refused_by_dds", sum(|counts| counts.refused)),
            KeyValue::new("writers_replaced", sum(|counts| counts.recreated)),
        ]
    }
}

/// In lockstep samples wait for subscribers, and their order counts more than the moment.
fn outlet<M: RosMessage>(
    startup: &Startup,
    participant: &Participant,
    settings: &StageSettings,
    name: &str,
    qos: &Qos,
) -> Result<Outlet<M>, ParticipantError> {
    let outlet = Outlet::new(participant, &startup.topic(name), qos)?;
    Ok(if settings.mode == Mode::Lockstep { outlet.patient(LONGEST_PATIENCE) } else { outlet })
}

fn settled<M: RosMessage>(outlet: &mut Outlet<M>, message: M, deadline: Instant) {
    let left = || deadline.saturating_duration_since(Instant::now());
    if outlet.publish(message) == Published::Held && !outlet.settle(left()) {
        tracing::error!("{}: subscribers got no sample for {SETTLE:?}", outlet.name());
    }
}
