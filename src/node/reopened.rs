//! A server of requests that is opened again where a lost client is back.
//!
//! A client that was silent for longer than its lease and goes on is found again, but the library
//! matches it with new endpoints only. So a server of the same name is opened then. The one before
//! is heard for a while yet, since other clients may find the new one a little later: what they
//! ask reaches both, and is taken once.
//!
//! In: what opens a server, and how a request is taken from it. Out: requests, each with the server
//! that is to answer it.

use std::{
    collections::{BTreeSet, VecDeque},
    future::Future,
    pin::Pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    task::{Context, Poll, Waker},
    time::Duration,
};

use ros2_client::{ReadError, RmwRequestId};
use tokio::time::{Sleep, sleep};

use super::participant::Participant;
use super::service_error::ServiceError;

/// How long the server before is heard: twice the time after which a heartbeat repeats what of the
/// discovery was lost, 1 s with rustdds.
const RETIREMENT: Duration = Duration::from_secs(2);

/// A server, shared with those who have yet to answer one of its requests.
pub struct Shared<S>(Arc<Mutex<S>>);

impl<S> Clone for Shared<S> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

impl<S> Shared<S> {
    fn new(server: S) -> Self {
        Self(Arc::new(Mutex::new(server)))
    }

    /// Hold it briefly.
    pub fn lock(&self) -> MutexGuard<'_, S> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A request with its id, as a server takes it.
type Request<R> = (RmwRequestId, R);

/// A request and the server that it came to.
pub struct Taken<S, R> {
    pub server: Shared<S>,
    pub id: RmwRequestId,
    pub request: R,
}

/// The server that is open now, and those before it that are still heard.
pub struct Reopened<S> {
    participant: Participant,
    name: String,
    open: Box<dyn Fn() -> Result<S, ServiceError> + Send>,
    current: Shared<S>,
    former: VecDeque<(Pin<Box<Sleep>>, Shared<S>)>,
    /// Requests that were taken while there is more than one server.
    taken: BTreeSet<RmwRequestId>,
    /// Returns of lost participants that were looked at.
    returns: u64,
    /// Who was told to be woken when a lost client is back.
    waker: Option<Waker>,
}

impl<S> Reopened<S> {
    /// Opens the server `name`.
    ///
    /// # Errors
    /// What `open` says.
    pub fn new(
        participant: &Participant,
        name: &str,
        open: impl Fn() -> Result<S, ServiceError> + Send + 'static,
    ) -> Result<Self, ServiceError> {
        let returns = participant.watch().returns();
        Ok(Self {
            participant: participant.clone(),
            name: name.to_owned(),
            current: Shared::new(open()?),
            open: Box::new(open),
            former: VecDeque::new(),
            taken: BTreeSet::new(),
            returns,
            waker: None,
        })
    }

    /// The server that is open now.
    pub fn current(&self) -> &Shared<S> {
        &self.current
    }

    /// Opens the server again where a lost client is back; whether it did. To be polled before each
    /// request, on a tokio runtime with time.
    pub fn meet_returned(&mut self, cx: &mut Context<'_>) -> bool {
        let watch = self.participant.watch();
        if !self.waker.as_ref().is_some_and(|waker| waker.will_wake(cx.waker())) {
            let before = self.waker.replace(cx.waker().clone());
            watch.wake_on_returns(before.as_ref(), cx.waker());
        }
        while let Some((retires, _)) = self.former.front_mut()
            && retires.as_mut().poll(cx).is_ready()
        {
            self.former.pop_front();
            if self.former.is_empty() {
                self.taken.clear();
            }
        }
        let returns = watch.returns();
        if std::mem::replace(&mut self.returns, returns) == returns {
            return false;
        }
        match (self.open)() {
            Ok(server) => {
                let before = std::mem::replace(&mut self.current, Shared::new(server));
                let mut retires = Box::pin(sleep(RETIREMENT));
                if self.former.is_empty() {
                    // The first to retire wakes this task; those after it are polled then.
                    let _ = retires.as_mut().poll(cx);
                }
                self.former.push_back((retires, before));
                tracing::debug!("{}: a lost client may be back; opened again", self.name);
                true
            }
            Err(error) => {
                tracing::error!("a client that was lost is back, not heard: {error}");
                false
            }
        }
    }

    /// The next request: `take` polls one server for one.
    ///
    /// # Errors
    /// [`ReadError`] for a request that cannot be decoded; it is consumed, the next call goes on.
    pub fn poll<R>(
        &mut self,
        cx: &mut Context<'_>,
        mut take: impl FnMut(&mut S, &mut Context<'_>) -> Poll<Result<Request<R>, ReadError>>,
    ) -> Poll<Result<Taken<S, R>, ReadError>> {
        for server in self.former.iter().map(|(_, server)| server).chain([&self.current]) {
            loop {
                let Poll::Ready(request) = take(&mut server.lock(), cx) else { break };
                let (id, request) = match request {
                    Ok(taken) => taken,
                    Err(error) => return Poll::Ready(Err(error)),
                };
                if self.former.is_empty() || self.taken.insert(id) {
                    return Poll::Ready(Ok(Taken { server: server.clone(), id, request }));
                }
            }
        }
        Poll::Pending
    }
}
