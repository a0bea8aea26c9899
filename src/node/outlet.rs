//! A publisher that a dead or frozen subscriber cannot stall.
//!
//! A reliable DDS writer keeps every sample until the slowest matched subscriber has acknowledged
//! it. A frozen or killed subscriber acknowledges nothing, so the window fills (8192 samples in
//! rustdds if nothing else is said; [`SAMPLES`](super::qos::SAMPLES) outlast most leases) and every
//! further publish is refused, for all subscribers, until the lease of the dead one ends: 20 s for
//! rclpy, 50 s for rustdds. An outlet answers a full window with a successor: a
//! new writer, made and matched on a helper thread while messages are held in order, typically
//! 2 ms. The old writer lives on for a while, so that healthy subscribers get what they still
//! miss. They lose nothing; the dead one gets a new window to fill. DDS keeps the order of one
//! writer only: what a healthy subscriber asks the old writer for may reach it after the first
//! samples of the new one. Where that matters more than the moment, as in lockstep, an outlet is
//! [patient](Outlet::patient).
//!
//! In: messages, from any thread that may allocate. Out: the topic, and counts of what happened.

use std::{
    collections::VecDeque,
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    thread,
    time::{Duration, Instant},
};

use ros2_client::{Publisher, WriteError};
use rustdds::Topic;

use super::{
    participant::{Participant, ParticipantError},
    qos::{Durability, Qos},
    qos_overrides::Role,
};
use friction_stage_data::message::RosMessage;

/// How long an old writer answers requests for samples that a healthy subscriber misses: twenty of
/// its heartbeats of 100 ms (rustdds, `HEARTBEAT_PERIOD_FAST`).
const RETIREMENT: Duration = Duration::from_secs(2);
/// Longest wait for the successor to find the subscribers of the old writer. Measured: 1 to 3 ms;
/// a subscriber that leaves meanwhile would be waited for in vain.
const MATCH_WITHIN: Duration = Duration::from_millis(200);
/// How long a patient outlet lets the old writer repeat what is missing before its successor sends:
/// two of its heartbeats, each of which a subscriber answers with what it misses.
const PATIENCE: Duration = Duration::from_millis(200);
/// Pause after a successor that could not be made.
const RETRY_AFTER: Duration = Duration::from_millis(100);

/// What became of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Published {
    /// It is on its way.
    Sent,
    /// It waits in order for the successor, a few milliseconds. The next [`Outlet::publish`]
    /// sends it, or [`Outlet::settle`].
    Held,
    /// It is lost, and counted.
    Refused,
}

/// What happened since the outlet was made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Messages handed to DDS.
    pub sent: u64,
    /// Messages lost: no successor could be made and as many messages as the window holds waited.
    pub refused: u64,
    /// Writers that were replaced because a subscriber stopped acknowledging.
    pub recreated: u64,
    /// Most messages that ever waited for a successor.
    pub most_held: usize,
}

/// A reliable publisher of `M` that never waits for a subscriber.
///
/// Left out: topics that keep samples for late subscribers (a successor would start without
/// them). Each successor adds 24 bytes to the node's entry in `ros_discovery_info`, because
/// ros2-client has no way to take a writer out.
pub struct Outlet<M: RosMessage> {
    participant: Participant,
    topic: Topic,
    name: String,
    most_held: usize,
    patience: Duration,
    writer: Publisher<M>,
    waiting: VecDeque<M>,
    successor: Option<Receiver<Result<Publisher<M>, String>>>,
    retired: VecDeque<(Instant, Publisher<M>)>,
    not_before: Option<Instant>,
    fault: Option<String>,
    counts: Counts,
}

impl<M: RosMessage> Outlet<M> {
    /// A publisher on `name` (absolute, or relative to the node's namespace).
    ///
    /// # Errors
    /// [`ParticipantError`] when the name is none, the profile is transient local, or DDS refuses.
    pub fn new(participant: &Participant, name: &str, qos: &Qos) -> Result<Self, ParticipantError> {
        if qos.durability == Durability::TransientLocal {
            return Err(ParticipantError::Endpoint {
                what: "outlet",
                topic: name.to_owned(),
                reason:
                    "an outlet is volatile: it may replace its writer, and with it the samples \
                         kept for late subscribers"
                        .to_owned(),
            });
        }
        let qos = &participant.qos_overrides().of(name, Role::Publisher, qos);
        let topic = participant.topic(name, M::PACKAGE, M::NAME, qos)?;
        let writer = participant.node().create_publisher(&topic, None).map_err(|e| {
            ParticipantError::Endpoint {
                what: "publisher",
                topic: name.to_owned(),
                reason: e.to_string(),
            }
        })?;
        participant.watch().name(writer.guid(), name);
        Ok(Self {
            participant: participant.clone(),
            topic,
            name: name.to_owned(),
            most_held: qos.window as usize,
            patience: Duration::ZERO,
            writer,
            waiting: VecDeque::new(),
            successor: None,
            retired: VecDeque::new(),
            not_before: None,
            fault: None,
            counts: Counts::default(),
        })
    }

    /// With a successor that sends only when healthy subscribers had the time to get from the old
    /// writer what they miss, so that they see the order kept; messages are held meanwhile, 0.2 s.
    pub fn patient(mut self) -> Self {
        self.patience = PATIENCE;
        self
    }

    /// Hands `message` to DDS, after those that wait. Never waits for a subscriber.
    pub fn publish(&mut self, message: M) -> Published {
        self.bury();
        if self.waiting.is_empty() && self.successor.is_none() {
            let Some(refused) = self.write(message) else {
                return Published::Sent;
            };
            self.waiting.push_back(refused);
        } else if self.waiting.len() < self.most_held {
            self.waiting.push_back(message);
        } else {
            self.counts.refused += 1;
            return Published::Refused;
        }
        if self.advance(Duration::ZERO) { Published::Sent } else { Published::Held }
    }

    /// Waits up to `limit` until nothing is held any more; true when so. For a publisher that
    /// waits for an answer to the very message, as in lockstep.
    pub fn settle(&mut self, limit: Duration) -> bool {
        let deadline = Instant::now() + limit;
        loop {
            let left = deadline.saturating_duration_since(Instant::now());
            if self.advance(left) {
                return true;
            }
            if left.is_zero() {
                return false;
            }
            if self.successor.is_none() {
                thread::sleep(RETRY_AFTER.min(left));
            }
        }
    }

    /// What happened so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Why the last successor could not be made, for the diagnostics.
    pub fn fault(&self) -> Option<&str> {
        self.fault.as_deref()
    }

    /// The name it was made with.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Subscribers that are matched now, dead ones included until their lease ends.
    pub fn subscribers(&self) -> usize {
        self.participant.watch().matches(self.writer.guid())
    }

    /// How often a subscriber came whose quality of service does not fit: it gets nothing.
    pub fn misfits(&self) -> usize {
        self.participant.watch().misfits(self.writer.guid())
    }

    /// Waits until at least `wanted` subscribers are matched, or `limit` has passed; how many
    /// there are.
    pub fn wait_for_subscribers(&self, wanted: usize, limit: Duration) -> usize {
        self.participant.watch().wait_for_matches(self.writer.guid(), wanted, limit)
    }

    /// Sends what waits, in order, as far as the writer or its successor takes it within `limit`.
    fn advance(&mut self, limit: Duration) -> bool {
        if let Some(successor) = &self.successor {
            match successor.recv_timeout(limit) {
                Err(RecvTimeoutError::Timeout) => return self.waiting.is_empty(),
                Ok(Ok(writer)) => {
                    let old = std::mem::replace(&mut self.writer, writer);
                    self.retired.push_back((Instant::now(), old));
                    self.counts.recreated += 1;
                    self.fault = None;
                }
                Ok(Err(reason)) => self.fail(reason),
                Err(RecvTimeoutError::Disconnected) => {
                    self.fail("the thread that made the successor ended".to_owned());
                }
            }
            self.counts.most_held = self.counts.most_held.max(self.waiting.len());
            self.successor = None;
        }
        while let Some(message) = self.waiting.pop_front() {
            if let Some(refused) = self.write(message) {
                self.waiting.push_front(refused);
                self.succeed();
                return false;
            }
        }
        true
    }

    /// Gives the message back when the window is full.
    fn write(&mut self, message: M) -> Option<M> {
        match self.writer.publish(message) {
            Ok(()) => {
                self.counts.sent += 1;
                None
            }
            Err(WriteError::WouldBlock { data }) => Some(data),
            Err(error) => {
                self.counts.refused += 1;
                self.fault = Some(error.to_string());
                None
            }
        }
    }

    fn fail(&mut self, reason: String) {
        tracing::error!("{}: no new writer: {reason}", self.name);
        self.fault = Some(reason);
        self.not_before = Some(Instant::now() + RETRY_AFTER);
    }

    /// Starts making the successor, on a thread of its own: discovery takes a millisecond or two.
    fn succeed(&mut self) {
        if self.successor.is_some() || self.not_before.is_some_and(|at| Instant::now() < at) {
            return;
        }
        tracing::warn!(
            "{}: a subscriber has stopped acknowledging; making a new writer for the others",
            self.name
        );
        let (hand_over, successor) = channel();
        let participant = self.participant.clone();
        let topic = self.topic.clone();
        let name = self.name.clone();
        let old = self.writer.guid();
        let due = Instant::now() + self.patience;
        let make = move || {
            let made = participant.node().create_publisher::<M>(&topic, None);
            let made = made.map_err(|e| e.to_string());
            if let Ok(writer) = &made {
                participant.watch().name(writer.guid(), &name);
                // Those of the old writer that are still there.
                let wanted = participant.watch().matches(old).min(participant.readers_of(&topic));
                participant.watch().wait_for_matches(writer.guid(), wanted, MATCH_WITHIN);
                thread::sleep(due.saturating_duration_since(Instant::now()));
            }
            // The outlet may be gone: then nobody needs the writer.
            let _ = hand_over.send(made);
        };
        match thread::Builder::new().name("outlet successor".to_owned()).spawn(make) {
            Ok(_) => self.successor = Some(successor),
            Err(error) => self.fail(error.to_string()),
        }
    }

    fn bury(&mut self) {
        while self.retired.front().is_some_and(|(since, _)| since.elapsed() > RETIREMENT) {
            self.retired.pop_front();
        }
    }
}
