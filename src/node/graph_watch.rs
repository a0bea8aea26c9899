//! Which endpoints of other nodes are matched with ours, and which do not fit.
//!
//! A thread follows the discovery events of one participant. It replaces ros2-client's spinner,
//! which also subscribes to `/clock`: every tick of a lockstep clock would wake it in every
//! process. In: discovery events and acknowledgements. Out: counts of matches and single peers to
//! wait for, which subscribers lag, endpoints of ours whose lost peer is back, and a warning when
//! the quality of service of a peer does not fit, which is not reported otherwise.

use std::{
    collections::{BTreeMap, BTreeSet},
    pin::pin,
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, AtomicU64, Ordering},
        mpsc::sync_channel,
    },
    task::{Poll, Waker},
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use futures::Stream;
use rustdds::{
    DomainParticipant, DomainParticipantStatusEvent as Event, GUID, QosPolicies, StatusEvented,
};
use tokio::sync::Notify;

use super::{
    early,
    socket_filter::{Acknowledgement, on_acknowledgement},
    waiter::Waiter,
};

/// A matched endpoint of another node.
#[derive(Default)]
struct Peer {
    /// The first sample of ours that it may miss, and when it came this far; `None` until it has
    /// acknowledged something.
    first_missing: Option<(u64, Instant)>,
}

/// What matched subscribers have not acknowledged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lag {
    /// One of them misses something, or has acknowledged nothing yet: it is new or best effort.
    pub any: bool,
    /// Most samples that one misses which came closer within the time asked for.
    pub healthy: u64,
}

/// What is known of one endpoint of ours.
#[derive(Default)]
struct Endpoint {
    topic: Option<String>,
    peers: BTreeMap<GUID, Peer>,
    /// Meetings with endpoints whose quality of service does not fit.
    misfits: usize,
    /// Participants of peers that were lost: they were silent for longer than their lease.
    lost: BTreeSet<[u8; 12]>,
    /// One of these has been found again, and the library matches only new endpoints with its own.
    has_returned: bool,
    /// Who waits at the endpoint.
    waker: Option<Waker>,
}

impl Endpoint {
    /// Counts a misfit, and words the warning.
    fn misfit(&mut self, what: &str, requested: &QosPolicies, offered: &QosPolicies) -> String {
        self.misfits += 1;
        let topic = self.topic.as_deref().unwrap_or("a topic");
        let policy = offered.compliance_failure_wrt(requested);
        format!(
            "{topic}: {what}: its quality of service does not fit ({policy:?}): requested {:?} \
             {:?}, offered {:?} {:?}",
            requested.reliability(),
            requested.durability(),
            offered.reliability(),
            offered.durability()
        )
    }
}

#[derive(Default)]
struct State {
    endpoints: Mutex<BTreeMap<GUID, Endpoint>>,
    /// For threads that wait.
    changed: Condvar,
    /// For tasks that wait.
    changed_async: Notify,
    /// How often a lost participant was found again.
    returns: AtomicU64,
    /// Who waits for that.
    wakers: Mutex<Vec<Waker>>,
    stop: AtomicBool,
}

impl State {
    fn wakers(&self) -> MutexGuard<'_, Vec<Waker>> {
        self.wakers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn acknowledge(&self, what: Acknowledgement) {
        let mut endpoints = self.endpoints();
        let endpoint = endpoints.get_mut(&what.writer);
        let Some(peer) = endpoint.and_then(|endpoint| endpoint.peers.get_mut(&what.reader)) else {
            return;
        };
        if peer.first_missing.is_none_or(|(first, _)| what.first_missing > first) {
            peer.first_missing = Some((what.first_missing, Instant::now()));
        }
    }

    fn endpoints(&self) -> MutexGuard<'_, BTreeMap<GUID, Endpoint>> {
        self.endpoints.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Follows the discovery events of one participant until it is dropped.
pub struct GraphWatch {
    state: Arc<State>,
    /// Hears acknowledgements as long as it is kept.
    _listener: Arc<dyn Fn(Acknowledgement) + Send + Sync>,
    waker: Waker,
    thread: Option<JoinHandle<()>>,
}

impl GraphWatch {
    /// Starts following. There must be no other listener for these events: each gets only a part.
    ///
    /// # Errors
    /// When no thread can be started.
    pub fn start(participant: DomainParticipant) -> std::io::Result<Self> {
        let state = Arc::new(State::default());
        let shared = Arc::clone(&state);
        let (hand_over, waker) = sync_channel(1);
        let thread =
            thread::Builder::new().name("ROS graph watch".to_owned()).spawn(move || {
                let waiter = Waiter::new();
                // The receiver waits for it below.
                let _ = hand_over.send(waiter.waker());
                follow(&participant, &shared, &waiter);
            })?;
        let waker = waker.recv().map_err(std::io::Error::other)?;
        let shared = Arc::clone(&state);
        let listener = on_acknowledgement(move |what| shared.acknowledge(what));
        Ok(Self { state, _listener: listener, waker, thread: Some(thread) })
    }

    /// Gives the endpoint `guid` the name that warnings call it by.
    pub fn name(&self, guid: GUID, topic: &str) {
        self.state.endpoints().entry(guid).or_default().topic = Some(topic.to_owned());
    }

    /// Endpoints of other nodes matched with ours now, dead ones included until their lease ends.
    pub fn matches(&self, guid: GUID) -> usize {
        self.state.endpoints().get(&guid).map_or(0, |endpoint| endpoint.peers.len())
    }

    /// What its subscribers have not acknowledged of the first `written` samples of the publisher
    /// `guid`. Healthy is who came closer within `healthy_for`.
    pub fn lag(&self, guid: GUID, written: u64, healthy_for: Duration) -> Lag {
        let endpoints = self.state.endpoints();
        let peers = endpoints.get(&guid).into_iter().flat_map(|endpoint| endpoint.peers.values());
        lag(peers, written, healthy_for)
    }

    /// How often an endpoint appeared whose quality of service does not fit ours: it is not
    /// matched.
    pub fn misfits(&self, guid: GUID) -> usize {
        self.state.endpoints().get(&guid).map_or(0, |endpoint| endpoint.misfits)
    }

    /// Who is to be woken when a lost peer of the endpoint `guid` is back.
    pub fn wake_on_return(&self, guid: GUID, waker: Waker) {
        self.state.endpoints().entry(guid).or_default().waker = Some(waker);
    }

    /// Who is to be woken whenever a lost peer of any endpoint is back, in place of `before`.
    pub fn wake_on_returns(&self, before: Option<&Waker>, waker: &Waker) {
        let mut wakers = self.state.wakers();
        if let Some(before) = before
            && let Some(index) = wakers.iter().position(|waker| waker.will_wake(before))
        {
            wakers.swap_remove(index);
        }
        wakers.push(waker.clone());
    }

    /// How often a lost participant was found again. A change means that
    /// [`GraphWatch::take_return`] is worth a look.
    pub fn returns(&self) -> u64 {
        self.state.returns.load(Ordering::Acquire)
    }

    /// Whether a lost peer of the endpoint `guid` is back, since the last look. It is matched with
    /// a new endpoint only.
    pub fn take_return(&self, guid: GUID) -> bool {
        let mut endpoints = self.state.endpoints();
        endpoints.get_mut(&guid).is_some_and(|endpoint| std::mem::take(&mut endpoint.has_returned))
    }

    /// The endpoint `new` takes the place of `old`: it waits for the same lost peers, by the same
    /// name. A peer that came back since the last look may have come after `new` was made.
    pub fn succeed(&self, old: GUID, new: GUID) {
        let mut endpoints = self.state.endpoints();
        let Some(before) = endpoints.get_mut(&old) else { return };
        let lost = std::mem::take(&mut before.lost);
        let has_returned = std::mem::take(&mut before.has_returned);
        let (topic, waker) = (before.topic.clone(), before.waker.take());
        let endpoint = endpoints.entry(new).or_default();
        (endpoint.topic, endpoint.waker) = (topic, waker);
        endpoint.lost.extend(lost);
        endpoint.has_returned |= has_returned;
    }

    /// The endpoint `guid` is no more.
    pub fn forget(&self, guid: GUID) {
        self.state.endpoints().remove(&guid);
    }

    /// Waits until at least `wanted` are matched, or `limit` has passed; how many there are.
    pub fn wait_for_matches(&self, guid: GUID, wanted: usize, limit: Duration) -> usize {
        let endpoints = self.state.endpoints();
        let matches = |endpoints: &BTreeMap<GUID, Endpoint>| {
            endpoints.get(&guid).map_or(0, |e| e.peers.len())
        };
        let (endpoints, _) = self
            .state
            .changed
            .wait_timeout_while(endpoints, limit, |endpoints| matches(endpoints) < wanted)
            .unwrap_or_else(PoisonError::into_inner);
        matches(&endpoints)
    }

    /// Waits until the endpoint `peer` of another node is matched with one of ours, or `limit` has
    /// passed; whether it is. To be awaited on a tokio runtime with time.
    pub async fn wait_for_peer(&self, peer: GUID, limit: Duration) -> bool {
        let matched =
            || self.state.endpoints().values().any(|endpoint| endpoint.peers.contains_key(&peer));
        let until_matched = async {
            loop {
                // Before the look: what comes between the two counts.
                let change = self.state.changed_async.notified();
                if matched() {
                    return;
                }
                change.await;
            }
        };
        tokio::time::timeout(limit, until_matched).await.is_ok()
    }
}

impl Drop for GraphWatch {
    fn drop(&mut self) {
        self.state.stop.store(true, Ordering::SeqCst);
        self.waker.wake_by_ref();
        if let Some(thread) = self.thread.take() {
            // It cannot have panicked without a defect in rustdds; there is nothing to save here.
            let _ = thread.join();
        }
    }
}

fn lag<'a>(peers: impl Iterator<Item = &'a Peer>, written: u64, healthy_for: Duration) -> Lag {
    let mut lag = Lag::default();
    for peer in peers {
        let Some((first_missing, at)) = peer.first_missing else {
            lag.any = true;
            continue;
        };
        let missing = (written + 1).saturating_sub(first_missing);
        lag.any |= missing > 0;
        if at.elapsed() < healthy_for {
            lag.healthy = lag.healthy.max(missing);
        }
    }
    lag
}

fn follow(participant: &DomainParticipant, state: &State, waiter: &Waiter) {
    let listener = participant.status_listener();
    let mut events = pin!(listener.as_async_status_stream());
    loop {
        let event = waiter.wait(None, |cx| {
            if state.stop.load(Ordering::SeqCst) {
                return Poll::Ready(None);
            }
            events.as_mut().poll_next(cx)
        });
        match event {
            Some(Some(event)) => note(state, event),
            // Stopped, or the participant is gone.
            Some(None) | None => return,
        }
    }
}

/// The bytes that all endpoints of a participant share.
fn participant_of(guid: GUID) -> [u8; 12] {
    std::array::from_fn(|index| guid.to_bytes()[index])
}

fn note(state: &State, event: Event) {
    match &event {
        Event::RemoteWriterMatched { remote_writer, .. } => early::matched(*remote_writer),
        Event::WriterLost { guid, .. } => early::lost(|writer| writer == guid),
        Event::ParticipantLost { id, .. } => early::lost(|writer| writer.prefix == *id),
        _ => {}
    }
    let mut endpoints = state.endpoints();
    let mut warning = None;
    match event {
        Event::RemoteReaderMatched { local_writer: ours, remote_reader: peer }
        | Event::RemoteWriterMatched { local_reader: ours, remote_writer: peer } => {
            endpoints.entry(ours).or_default().peers.entry(peer).or_default();
        }
        Event::ReaderLost { guid, .. } | Event::WriterLost { guid, .. } => {
            endpoints.values_mut().for_each(|endpoint| {
                endpoint.peers.remove(&guid);
            });
        }
        Event::ParticipantLost { id, .. } => {
            for endpoint in endpoints.values_mut() {
                let Endpoint { peers, lost, .. } = endpoint;
                peers.retain(|peer, _| {
                    let is_lost = peer.prefix == id;
                    if is_lost {
                        lost.insert(participant_of(*peer));
                    }
                    !is_lost
                });
            }
        }
        Event::ParticipantDiscovered { dpd } => {
            let mut wakers = Vec::new();
            let mut is_back = false;
            for endpoint in endpoints.values_mut() {
                if endpoint.lost.remove(&participant_of(dpd.guid)) {
                    endpoint.has_returned = true;
                    is_back = true;
                    wakers.extend(endpoint.waker.clone());
                }
            }
            if is_back {
                state.returns.fetch_add(1, Ordering::Release);
                wakers.extend(state.wakers().iter().cloned());
                wakers.into_iter().for_each(Waker::wake);
            }
        }
        Event::RemoteReaderQosIncompatible {
            local_writer: ours,
            requested_qos,
            offered_qos,
            ..
        } => {
            let what = "a subscriber gets nothing";
            let endpoint = endpoints.entry(ours).or_default();
            warning = Some(endpoint.misfit(what, &requested_qos, &offered_qos));
        }
        Event::RemoteWriterQosIncompatible {
            local_reader: ours,
            requested_qos,
            offered_qos,
            ..
        } => {
            let what = "nothing comes from a publisher";
            let endpoint = endpoints.entry(ours).or_default();
            warning = Some(endpoint.misfit(what, &requested_qos, &offered_qos));
        }
        _ => return,
    }
    // Not under the lock, which the thread that receives takes as well.
    drop(endpoints);
    if let Some(warning) = warning {
        tracing::warn!("{warning}");
    }
    state.changed.notify_all();
    state.changed_async.notify_waiters();
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_subscriber_that_came_closer_lately_is_healthy() {
        let ago = |seconds| Instant::now().checked_sub(Duration::from_secs(seconds)).unwrap();
        let peer = |first, seconds| Peer { first_missing: Some((first, ago(seconds))) };
        let of = |peers: &[Peer]| lag(peers.iter(), 1000, Duration::from_secs(2));
        assert_eq!(of(&[]), Lag { any: false, healthy: 0 });
        // All of it, a moment and an hour ago.
        assert_eq!(of(&[peer(1001, 0), peer(1001, 3600)]), Lag { any: false, healthy: 0 });
        assert_eq!(of(&[peer(1001, 0), peer(700, 1)]), Lag { any: true, healthy: 301 });
        // One that is stopped, and one that is new.
        assert_eq!(of(&[peer(700, 3)]), Lag { any: true, healthy: 0 });
        assert_eq!(of(&[Peer::default()]), Lag { any: true, healthy: 0 });
    }
}
