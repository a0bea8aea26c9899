//! A publisher that a dead or frozen subscriber cannot stall.
use std::{
    collections::VecDeque,
    time::{Duration, Instant},
};

use ros2_client::{Publisher, WriteError};
use rustdds::Topic;
use serde::Serialize;

use super::{
    participant::{Participant, ParticipantError},
    qos::Qos,
};

/// What became of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Published {
    Sent,
    Refused,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    pub sent: u64,
    pub refused: u64,
    pub recreated: u64,
}

const RETIRED_FOR: Duration = Duration::from_secs(2);

pub struct Outlet<M: Serialize> {
    participant: Participant,
    topic: Topic,
    writer: Publisher<M>,
    retired: VecDeque<(Instant, Publisher<M>)>,
    counts: Counts,
}

impl<M: Serialize> Outlet<M> {
    pub fn new(
        participant: &Participant,
        name: &str,
        package: &str,
        type_name: &str,
        qos: &Qos,
    ) -> Result<Self, ParticipantError> {
        let topic = participant.topic(name, package, type_name, qos)?;
        let writer = participant.node().create_publisher(&topic, None).map_err(|e| ParticipantError::Endpoint {
            what: "publisher",
            topic: name.to_owned(),
            reason: e.to_string(),
        })?;
        Ok(Self {
            participant: participant.clone(),
            topic,
            writer,
            retired: VecDeque::new(),
            counts: Counts::default(),
        })
    }

    pub fn publish(&mut self, message: M) -> Published {
        while self.retired.front().is_some_and(|(since, _)| since.elapsed() > RETIRED_FOR) {
            self.retired.pop_front();
        }
        let message = match self.writer.publish(message) {
            Ok(()) => {
                self.counts.sent += 1;
                return Published::Sent;
            }
            Err(WriteError::WouldBlock { data }) => data,
            Err(_) => {
                self.counts.refused += 1;
                return Published::Refused;
            }
        };
        let fresh = self.participant.node().create_publisher(&self.topic, None);
        match fresh {
            Ok(fresh) => {
                let old = std::mem::replace(&mut self.writer, fresh);
                self.retired.push_back((Instant::now(), old));
                self.counts.recreated += 1;
            }
            Err(_) => {
                self.counts.refused += 1;
                return Published::Refused;
            }
        }
        match self.writer.publish(message) {
            Ok(()) => {
                self.counts.sent += 1;
                Published::Sent
            }
            Err(_) => {
                self.counts.refused += 1;
                Published::Refused
            }
        }
    }

    pub fn counts(&self) -> Counts {
        self.counts
    }
}
