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
//! [patient](Outlet::patient): it holds messages as long as subscribers come closer to what the old
//! writer has sent.
//!
//! A subscriber that was silent for longer than its lease and goes on is found again, but matched
//! with new writers only: then, too, a successor is made.
//!
//! Where time can wait, a publisher [keeps the pace](Outlet::keep_pace) of its subscribers: one
//! that falls behind on a busy machine would not catch up while samples come as fast as they can.
//!
//! A writer counts its samples, and a subscriber that comes late costs by that number: until its
//! first answer everything since number 1 counts as unacknowledged, and rustdds lists every number
//! that it does not send it, 50 ns each, and sends no sample meanwhile. So a writer is replaced
//! before its numbers grow large, by one that is made and matched while the old one still
//! publishes. A subscriber that stopped acknowledging rarely fills a window then.
//!
//! In: messages, from any thread that may allocate. Out: the topic, and counts of what happened.

use std::{
    collections::VecDeque,
    sync::mpsc::{Receiver, RecvTimeoutError, SendError, channel},
    thread,
    time::{Duration, Instant},
};

use ros2_client::{Publisher, WriteError};
use rustdds::no_key::DataWriterCdr;
use rustdds::{GUID, RTPSEntity as _, Timestamp, Topic};

use super::{
    graph_watch::Lag,
    participant::{Participant, ParticipantError},
    qos::{Durability, Qos},
    qos_overrides::Role,
};
use friction_stage_data::message::RosMessage;

/// How long an old writer answers requests for samples that a healthy subscriber misses: twenty of
/// its heartbeats of 100 ms (rustdds, `HEARTBEAT_PERIOD_FAST`).
const RETIREMENT: Duration = Duration::from_secs(2);
/// The same of a writer that all subscribers still acknowledge: a healthy subscriber may be behind
/// by as many samples as the window holds. Assumed: it hears them within this time.
const PLANNED_RETIREMENT: Duration = Duration::from_secs(30);
/// Longest wait for the successor to find the subscribers of the old writer. Measured: 1 to 3 ms;
/// a subscriber that leaves meanwhile would be waited for in vain.
const MATCH_WITHIN: Duration = Duration::from_millis(200);
/// How long after its last sample a patient outlet lets the old writer repeat what is missing,
/// before its successor sends: two of its heartbeats, each of which a subscriber answers with what
/// it misses.
const PATIENCE: Duration = Duration::from_millis(200);
/// How long ago a subscriber that lags has acknowledged something, where it is healthy. Assumed: on
/// a busy machine one may not run for this long.
const HEALTHY: Duration = Duration::from_secs(2);
/// Samples that a healthy subscriber may miss when a planned successor takes over: what one
/// acknowledgement can ask for (DDSI-RTPS 2.5, 9.4.2.6).
const CLOSE: u64 = 256;
/// Samples that a subscriber may miss where the publisher waits for it. Linux holds some 280 small
/// datagrams for a socket (`net.core.rmem_default`, 212,992 bytes), of all topics together; what
/// does not fit is lost, and rustdds repeats it more slowly than a quick lockstep adds to it.
const PACE: u64 = 128;
/// How long ago a subscriber that is waited for has come closer. Assumed: longer than a busy
/// machine keeps it from running. One that is stopped holds the publisher up for this long.
const PACED: Duration = Duration::from_millis(500);
/// How long a publisher keeps the pace of subscribers that do not catch up, such as one that was
/// stopped for long.
const PACED_AT_MOST: Duration = Duration::from_secs(10);
/// Pause between two checks whether subscribers have caught up.
const PACE_CHECKS_AGAIN: Duration = Duration::from_micros(100);
/// Pause between two looks whether a successor can take over.
const LOOKS_AGAIN: Duration = Duration::from_millis(1);
/// Pause after a successor that could not be made.
const RETRY_AFTER: Duration = Duration::from_millis(100);
/// Samples after which a writer is replaced although all subscribers acknowledge: the list of
/// them takes rustdds 3 ms. Where a healthy subscriber lags: 7/8 of the window.
const RENEWED_AFTER: u32 = 1 << 16;
/// How long a writer that is made ahead waits for subscribers that are slow to find it, at most.
const FOUND_WITHIN: Duration = Duration::from_secs(1);

/// What became of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[must_use]
pub enum Published {
    /// It is on its way.
    Sent,
    /// It waits in order for the successor: a few milliseconds, or longer where the outlet is
    /// [patient](Outlet::patient). The next [`Outlet::publish`]
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
    /// Messages lost: as many as the window holds waited already, or DDS refused them.
    pub refused: u64,
    /// Writers that were replaced because a subscriber stopped acknowledging, or came back.
    pub recreated: u64,
    /// Writers that were replaced because they had published enough.
    pub renewed: u64,
    /// Most messages that ever waited for a successor.
    pub most_held: usize,
}

/// A reliable publisher of `M` that never blocks; a patient one may hold messages for subscribers
/// that lag.
///
/// Left out: topics that keep samples for late subscribers (a successor would start without
/// them).
pub struct Outlet<M: RosMessage> {
    participant: Participant,
    topic: Topic,
    name: String,
    most_held: usize,
    /// Longest time that messages are held for subscribers that lag, where it is patient.
    patience: Option<Duration>,
    writer: Writer<M>,
    /// Samples that the writer has published, the time of the last, and after how many it is
    /// replaced: as soon as no healthy subscriber lags, and at last.
    written: u32,
    last_written: Instant,
    renewed_after: u32,
    renewed_at_last: u32,
    waiting: VecDeque<M>,
    successor: Option<Successor<M>>,
    /// Old writers, and until when they are kept.
    retired: VecDeque<(Instant, Writer<M>)>,
    not_before: Option<Instant>,
    fault: Option<String>,
    counts: Counts,
    /// Returns of lost participants that were looked at.
    returns: u64,
    /// Since when some subscriber has been far behind.
    far_since: Option<Instant>,
}

/// A writer of the topic.
enum Writer<M: RosMessage> {
    First(Publisher<M>),
    Succeeding(DataWriterCdr<M>),
}

impl<M: RosMessage> Writer<M> {
    fn guid(&self) -> GUID {
        match self {
            Writer::First(writer) => writer.guid(),
            Writer::Succeeding(writer) => writer.guid(),
        }
    }

    fn publish(&self, message: M) -> Result<(), WriteError<M>> {
        match self {
            Writer::First(writer) => writer.publish(message),
            Writer::Succeeding(writer) => {
                writer.write(message, Some(Timestamp::now())).map_err(WriteError::from)
            }
        }
    }
}

/// A writer that will take the place of the one that publishes.
struct Successor<M: RosMessage> {
    making: Receiver<Result<DataWriterCdr<M>, String>>,
    made: Option<(Instant, DataWriterCdr<M>)>,
    /// Since when it is to take over, once that is settled, and why. Messages are held from then
    /// on.
    due: Option<(Instant, Reason)>,
}

/// Why a writer is replaced.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Reason {
    /// It has published enough.
    Enough,
    /// Its window is full.
    Full,
    /// A subscriber that was lost is back.
    Returned,
}

impl<M: RosMessage> Successor<M> {
    /// Waits up to `limit` until it is made; whether it is, or why it cannot be.
    fn wait(&mut self, limit: Duration) -> Result<bool, String> {
        if self.made.is_none() {
            match self.making.recv_timeout(limit) {
                Err(RecvTimeoutError::Timeout) => return Ok(false),
                Err(RecvTimeoutError::Disconnected) => {
                    return Err("the thread that made the successor ended".to_owned());
                }
                Ok(made) => self.made = Some((Instant::now(), made?)),
            }
        }
        Ok(true)
    }
}

/// Samples after which a writer with `window` is replaced: no subscriber that comes late finds the
/// window full.
fn renewed_after(window: u32) -> u32 {
    (window / 2).clamp(1, RENEWED_AFTER)
}

/// Samples after which it is replaced although a healthy subscriber lags.
fn renewed_at_last(window: u32) -> u32 {
    (window - window / 8).max(1)
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
            patience: None,
            writer: Writer::First(writer),
            written: 0,
            last_written: Instant::now(),
            renewed_after: renewed_after(qos.window),
            renewed_at_last: renewed_at_last(qos.window),
            waiting: VecDeque::new(),
            successor: None,
            retired: VecDeque::new(),
            not_before: None,
            fault: None,
            counts: Counts::default(),
            returns: participant.watch().returns(),
            far_since: None,
        })
    }

    /// With a successor that sends only when healthy subscribers have got from the old writer what
    /// they miss, so that they see the order kept; messages are held meanwhile, 0.2 s or as long as
    /// a subscriber that lags comes closer, up to `longest`.
    pub fn patient(mut self, longest: Duration) -> Self {
        self.patience = Some(longest);
        self
    }

    /// Hands `message` to DDS, after those that wait. Never waits for a subscriber.
    pub fn publish(&mut self, message: M) -> Published {
        self.drop_expired();
        self.replace_for_returned();
        self.renew();
        let takes_over = self.successor.as_ref().is_some_and(|successor| successor.due.is_some());
        if self.waiting.is_empty() && !takes_over {
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

    /// Waits until no subscriber that comes closer misses more than 128 samples, at most till
    /// `until`; true when so. For a publisher whose time can wait, after each message. After 10 s
    /// in which some were far behind all the time, it waits no more until they are not.
    pub fn keep_pace(&mut self, until: Instant) -> bool {
        let watch = self.participant.watch();
        let (writer, written) = (self.writer.guid(), self.written.into());
        while watch.lag(writer, written, PACED).healthy > PACE {
            let now = Instant::now();
            let since = *self.far_since.get_or_insert(now);
            if now >= until || now.duration_since(since) >= PACED_AT_MOST {
                return false;
            }
            thread::sleep(PACE_CHECKS_AGAIN);
        }
        self.far_since = None;
        true
    }

    /// When messages that are held may be sent, at the earliest; `None` when there are none. Who
    /// may have no further message to publish has to [settle](Outlet::settle) them then.
    pub fn held_until(&self) -> Option<Instant> {
        (!self.waiting.is_empty()).then(|| Instant::now() + LOOKS_AGAIN)
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

    /// The writer that publishes now, as nodes name it.
    pub fn writer(&self) -> [u8; 16] {
        self.writer.guid().to_bytes()
    }

    /// Writers that were replaced and are kept for slow subscribers.
    pub fn replaced(&self) -> usize {
        self.retired.len()
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
        let deadline = Instant::now() + limit;
        while self.successor.as_ref().is_some_and(|successor| successor.due.is_some()) {
            if self.take_over(deadline) {
                break;
            }
            if Instant::now() >= deadline {
                return self.waiting.is_empty();
            }
            thread::sleep(LOOKS_AGAIN);
        }
        while let Some(message) = self.waiting.pop_front() {
            if let Some(refused) = self.write(message) {
                self.waiting.push_front(refused);
                self.replace(Reason::Full);
                return false;
            }
        }
        true
    }

    /// Lets the successor that is due publish; false where that is later than `deadline`, or
    /// subscribers are to hear more of the old writer first.
    fn take_over(&mut self, deadline: Instant) -> bool {
        let Some(successor) = &mut self.successor else { return true };
        match successor.wait(deadline.saturating_duration_since(Instant::now())) {
            Ok(false) => return false,
            Ok(true) => {}
            Err(reason) => {
                self.fail(reason);
                return true;
            }
        }
        let Some((since, reason)) = successor.due else { return false };
        if self.patience.is_some_and(|longest| self.is_awaited(since, longest)) {
            return false;
        }
        if let Some((_, writer)) = self.successor.take().and_then(|successor| successor.made) {
            let old = std::mem::replace(&mut self.writer, Writer::Succeeding(writer));
            let is_planned = reason == Reason::Enough;
            match reason {
                Reason::Enough => {}
                Reason::Full => tracing::warn!(
                    "{}: a subscriber has stopped acknowledging; the others get a new publisher",
                    self.name
                ),
                Reason::Returned => tracing::warn!(
                    "{}: a subscriber that was lost is back; it gets a new publisher",
                    self.name
                ),
            }
            let kept_for = if is_planned { PLANNED_RETIREMENT } else { RETIREMENT };
            self.retired.push_back((Instant::now() + kept_for, old));
            self.written = 0;
            self.fault = None;
            let Counts { renewed, recreated, .. } = &mut self.counts;
            *if is_planned { renewed } else { recreated } += 1;
            self.counts.most_held = self.counts.most_held.max(self.waiting.len());
        }
        true
    }

    /// Whether healthy subscribers may get more from the old writer, while messages are held since
    /// `since`, for `longest` at most.
    fn is_awaited(&self, since: Instant, longest: Duration) -> bool {
        let lag = self.lag();
        (lag.any && self.last_written.elapsed() < PATIENCE)
            || (lag.healthy > 0 && since.elapsed() < longest)
    }

    fn lag(&self) -> Lag {
        self.participant.watch().lag(self.writer.guid(), self.written.into(), HEALTHY)
    }

    /// Gives the message back when the window is full.
    fn write(&mut self, message: M) -> Option<M> {
        match self.writer.publish(message) {
            Ok(()) => {
                self.written = self.written.saturating_add(1);
                self.last_written = Instant::now();
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
        self.successor = None;
        self.fault = Some(reason);
        self.not_before = Some(Instant::now() + RETRY_AFTER);
    }

    /// Starts making a successor where a lost subscriber is back. One that takes over already may
    /// be too early for it: then the look waits until that has been done.
    fn replace_for_returned(&mut self) {
        if self.successor.is_some() {
            return;
        }
        let returns = self.participant.watch().returns();
        if std::mem::replace(&mut self.returns, returns) != returns
            && self.participant.watch().take_return(self.writer.guid())
        {
            self.replace(Reason::Returned);
        }
    }

    /// Has a successor made ahead, and lets it take over when subscribers have had the time to find
    /// it and the healthy ones have nearly all of the old writer.
    fn renew(&mut self) {
        if self.successor.is_none() && self.written >= self.renewed_after - self.renewed_after / 8 {
            self.make_successor();
        }
        if self.successor.as_ref().is_none_or(|successor| successor.due.is_some()) {
            return;
        }
        let is_time = self.written >= self.renewed_at_last || self.lag().healthy <= CLOSE;
        let Some(successor) = &mut self.successor else { return };
        match successor.wait(Duration::ZERO) {
            Err(reason) => self.fail(reason),
            Ok(_) => {
                let is_found = |(made, _): &(Instant, _)| made.elapsed() >= FOUND_WITHIN;
                let is_over = self.written >= self.renewed_after;
                let is_ready =
                    successor.made.as_ref().is_some_and(|made| is_over || is_found(made));
                if is_ready && is_time {
                    successor.due = Some((Instant::now(), Reason::Enough));
                }
            }
        }
    }

    /// Replaces the writer as soon as a successor is made.
    fn replace(&mut self, reason: Reason) {
        let is_under_way = self.successor.as_ref().is_some_and(|successor| successor.due.is_some());
        if is_under_way || self.not_before.is_some_and(|at| Instant::now() < at) {
            return;
        }
        if self.successor.is_none() {
            self.make_successor();
        }
        if let Some(successor) = &mut self.successor {
            successor.due = Some((Instant::now(), reason));
        }
    }

    /// Starts making a successor, on a thread of its own: discovery takes a millisecond or two.
    fn make_successor(&mut self) {
        if self.not_before.is_some_and(|at| Instant::now() < at) {
            return;
        }
        let (hand_over, making) = channel();
        let participant = self.participant.clone();
        let topic = self.topic.clone();
        let old = self.writer.guid();
        let make = move || {
            let made = participant.succeeding_writer::<M>(&topic);
            if let Ok(writer) = &made {
                participant.watch().succeed(old, writer.guid());
                // Those of the old writer that are still there.
                let wanted = participant.watch().matches(old).min(participant.readers_of(&topic));
                participant.watch().wait_for_matches(writer.guid(), wanted, MATCH_WITHIN);
            }
            // The outlet may be gone: then the writer is not needed.
            if let Err(SendError(Ok(writer))) = hand_over.send(made) {
                participant.forget_writer(writer.guid());
            }
        };
        match thread::Builder::new().name("outlet successor".to_owned()).spawn(make) {
            Ok(_) => {
                self.successor = Some(Successor { making, made: None, due: None });
            }
            Err(error) => self.fail(error.to_string()),
        }
    }

    /// Ends old writers whose time is over.
    fn drop_expired(&mut self) {
        let now = Instant::now();
        let participant = &self.participant;
        self.retired.retain(|(until, writer)| {
            let is_kept = now < *until;
            if !is_kept {
                participant.forget_writer(writer.guid());
            }
            is_kept
        });
    }
}

impl<M: RosMessage> Drop for Outlet<M> {
    fn drop(&mut self) {
        let made = self.successor.take().and_then(|successor| successor.made);
        let writers = self.retired.iter().map(|(_, writer)| writer.guid());
        let made = made.iter().map(|(_, writer)| writer.guid());
        let guids: Vec<GUID> = writers.chain(made).chain([self.writer.guid()]).collect();
        guids.into_iter().for_each(|guid| self.participant.forget_writer(guid));
    }
}
