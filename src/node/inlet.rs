//! Waiting for any of several subscriptions on one plain thread, with a deadline.
//!
//! The thread parks; the DDS thread wakes it when a sample has come. That is one thread switch, as
//! with one thread per subscription, and needs no runtime, no channel and no poll set.
//!
//! ```no_run
//! # use std::task::Poll;
//! # use friction_stage::node::{inlet::Inlet, participant::ParticipantError, waiter::Waiter};
//! # use friction_stage_data::message::{JointState, WrenchStamped};
//! # fn f(mut force: Inlet<WrenchStamped>, mut joint: Inlet<JointState>) {
//! enum Command { Force(WrenchStamped), Joint(JointState) }
//! let waiter = Waiter::new();
//! let command = waiter.wait(None, |cx| {
//!     if let Poll::Ready(message) = force.poll_take(cx) {
//!         return Poll::Ready(message.map(Command::Force));
//!     }
//!     joint.poll_take(cx).map(|message| message.map(Command::Joint))
//! });
//! # }
//! ```

use std::{
    pin::pin,
    task::{Context, Poll, Waker},
};

use ros2_client::{ReadError, Subscription, message_info::MessageInfo};
use rustdds::{Topic, TopicDescription};

use super::{
    participant::{Participant, ParticipantError},
    qos::{DEFAULT_WINDOW, Qos},
    qos_overrides::Role,
};
use friction_stage_data::message::RosMessage;

/// A subscription to `M`.
///
/// A publisher that was silent for longer than its lease and goes on is found again, but matched
/// with new subscriptions only: then this one is replaced.
pub struct Inlet<M: RosMessage> {
    subscription: Subscription<M>,
    topic: Topic,
    participant: Participant,
    /// Returns of lost participants that were looked at.
    returns: u64,
    /// Who was told to be woken when a lost publisher is back.
    waker: Option<Waker>,
}

impl<M: RosMessage> Inlet<M> {
    /// Subscribes to `name` (absolute, or relative to the node's namespace).
    ///
    /// # Errors
    /// [`ParticipantError`] when the name is none or DDS refuses.
    pub fn new(participant: &Participant, name: &str, qos: &Qos) -> Result<Self, ParticipantError> {
        let qos = participant.qos_overrides().of(name, Role::Subscription, qos);
        // The window is a publisher's: rustdds 0.15 would keep as many samples that have long been
        // taken.
        let qos = qos.window(qos.window.min(DEFAULT_WINDOW));
        let topic = participant.topic(name, M::PACKAGE, M::NAME, &qos)?;
        let subscription = participant.node().create_subscription(&topic, None).map_err(|e| {
            ParticipantError::Endpoint {
                what: "subscription",
                topic: name.to_owned(),
                reason: e.to_string(),
            }
        })?;
        participant.watch().name(subscription.guid(), name);
        let returns = participant.watch().returns();
        let participant = participant.clone();
        Ok(Self { subscription, topic, participant, returns, waker: None })
    }

    /// Replaces the subscription where a lost publisher is back; whether it did.
    fn meet_returned(&mut self) -> bool {
        let watch = self.participant.watch();
        let returns = watch.returns();
        if std::mem::replace(&mut self.returns, returns) == returns
            || !watch.take_return(self.subscription.guid())
        {
            return false;
        }
        match self.participant.node().create_subscription(&self.topic, None) {
            Ok(subscription) => {
                watch.succeed(self.subscription.guid(), subscription.guid());
                self.subscription = subscription;
                true
            }
            Err(error) => {
                let topic = self.topic.name();
                tracing::error!("{topic}: a publisher that was lost is back, not heard: {error}");
                false
            }
        }
    }

    /// The next message, if one has come.
    ///
    /// # Errors
    /// [`ReadError`] for a sample that cannot be decoded; it is consumed, the next call goes on.
    pub fn take(&mut self) -> Result<Option<M>, ReadError> {
        Ok(self.take_with_info()?.map(|(message, _)| message))
    }

    /// The next message, if one has come, with who sent it and its number among those of its
    /// sender.
    ///
    /// # Errors
    /// As [`Inlet::take`].
    pub fn take_with_info(&mut self) -> Result<Option<(M, MessageInfo)>, ReadError> {
        match self.subscription.take()? {
            None if self.meet_returned() => self.subscription.take(),
            taken => Ok(taken),
        }
    }

    /// The next message, or a promise to wake `cx` when one comes.
    pub fn poll_take(&mut self, cx: &mut Context<'_>) -> Poll<Result<M, ReadError>> {
        self.poll_take_from(cx).map(|result| result.map(|(message, _)| message))
    }

    /// The same with the identity of the publisher that sent it.
    pub fn poll_take_from(
        &mut self,
        cx: &mut Context<'_>,
    ) -> Poll<Result<(M, [u8; 16]), ReadError>> {
        if !self.waker.as_ref().is_some_and(|waker| waker.will_wake(cx.waker())) {
            let waker = cx.waker().clone();
            self.participant.watch().wake_on_return(self.subscription.guid(), waker.clone());
            self.waker = Some(waker);
        }
        let mut polled = self.poll(cx);
        if polled.is_pending() && self.meet_returned() {
            polled = self.poll(cx);
        }
        polled.map(|result| {
            result.map(|(message, info)| (message, info.publisher_gid().to_bytes16()))
        })
    }

    fn poll(&self, cx: &mut Context<'_>) -> Poll<Result<(M, MessageInfo), ReadError>> {
        // A new future each time is sound here: rustdds' stream keeps no state between polls.
        pin!(self.subscription.async_take()).poll(cx)
    }

    /// Its name in DDS, for [`GraphWatch`](super::graph_watch::GraphWatch).
    pub fn guid(&self) -> rustdds::GUID {
        self.subscription.guid()
    }
}
