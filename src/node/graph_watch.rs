//! Which endpoints of other nodes are matched with ours, and which do not fit.
//!
//! A thread follows the discovery events of one participant. It replaces ros2-client's spinner,
//! which also subscribes to `/clock`: every tick of a lockstep clock would wake it in every
//! process. In: discovery events. Out: counts of matches and single peers to wait for, and a
//! warning when the quality of service of a peer does not fit, which otherwise nobody would see.

use std::{
    collections::{BTreeMap, BTreeSet},
    pin::pin,
    sync::{
        Arc, Condvar, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
        mpsc::sync_channel,
    },
    task::{Poll, Waker},
    thread::{self, JoinHandle},
    time::Duration,
};

use futures::Stream;
use rustdds::{
    DomainParticipant, DomainParticipantStatusEvent as Event, GUID, QosPolicies, StatusEvented,
};
use tokio::sync::Notify;

use super::inlet::Waiter;

/// What is known of one endpoint of ours.
#[derive(Default)]
struct Endpoint {
    topic: Option<String>,
    peers: BTreeSet<GUID>,
    /// Meetings with endpoints whose quality of service does not fit.
    misfits: usize,
}

impl Endpoint {
    fn misfit(&mut self, what: &str, requested: &QosPolicies, offered: &QosPolicies) {
        self.misfits += 1;
        let topic = self.topic.as_deref().unwrap_or("a topic");
        let policy = offered.compliance_failure_wrt(requested);
        tracing::warn!(
            "{topic}: {what}: its quality of service does not fit ({policy:?}): requested {:?} \
             {:?}, offered {:?} {:?}",
            requested.reliability(),
            requested.durability(),
            offered.reliability(),
            offered.durability()
        );
    }
}

#[derive(Default)]
struct State {
    endpoints: Mutex<BTreeMap<GUID, Endpoint>>,
    /// For threads that wait.
    changed: Condvar,
    /// For tasks that wait.
    changed_async: Notify,
    stop: AtomicBool,
}

impl State {
    fn endpoints(&self) -> MutexGuard<'_, BTreeMap<GUID, Endpoint>> {
        self.endpoints.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Follows the discovery events of one participant until it is dropped.
pub struct GraphWatch {
    state: Arc<State>,
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
        Ok(Self { state, waker, thread: Some(thread) })
    }

    /// Gives the endpoint `guid` the name that warnings call it by.
    pub fn name(&self, guid: GUID, topic: &str) {
        self.state.endpoints().entry(guid).or_default().topic = Some(topic.to_owned());
    }

    /// Endpoints of other nodes matched with ours now, dead ones included until their lease ends.
    pub fn matches(&self, guid: GUID) -> usize {
        self.state.endpoints().get(&guid).map_or(0, |endpoint| endpoint.peers.len())
    }

    /// How often an endpoint appeared whose quality of service does not fit ours: it is not
    /// matched.
    pub fn misfits(&self, guid: GUID) -> usize {
        self.state.endpoints().get(&guid).map_or(0, |endpoint| endpoint.misfits)
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
            || self.state.endpoints().values().any(|endpoint| endpoint.peers.contains(&peer));
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

fn note(state: &State, event: Event) {
    let mut endpoints = state.endpoints();
    match event {
        Event::RemoteReaderMatched { local_writer: ours, remote_reader: peer }
        | Event::RemoteWriterMatched { local_reader: ours, remote_writer: peer } => {
            endpoints.entry(ours).or_default().peers.insert(peer);
        }
        Event::ReaderLost { guid, .. } | Event::WriterLost { guid, .. } => {
            endpoints.values_mut().for_each(|endpoint| {
                endpoint.peers.remove(&guid);
            });
        }
        Event::ParticipantLost { id, .. } => {
            endpoints
                .values_mut()
                .for_each(|endpoint| endpoint.peers.retain(|peer| peer.prefix != id));
        }
        Event::RemoteReaderQosIncompatible {
            local_writer: ours,
            requested_qos,
            offered_qos,
            ..
        } => {
            endpoints.entry(ours).or_default().misfit(
                "a subscriber gets nothing",
                &requested_qos,
                &offered_qos,
            );
        }
        Event::RemoteWriterQosIncompatible {
            local_reader: ours,
            requested_qos,
            offered_qos,
            ..
        } => {
            endpoints.entry(ours).or_default().misfit(
                "nothing comes from a publisher",
                &requested_qos,
                &offered_qos,
            );
        }
        _ => return,
    }
    state.changed.notify_all();
    state.changed_async.notify_waiters();
}
