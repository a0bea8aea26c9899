//! Which node the publishers belong to that take the place of others.
//!
//! Each participant lists on `ros_discovery_info` the endpoints of its nodes; `ros2 node info` and
//! the names in `ros2 topic info -v` come from there (rmw_dds_common). ros2-client does this for
//! what it has made, and never removes a publisher. So publishers that take the place of others are
//! not made with it, and this participant has a second writer on the topic, which sends the list of
//! ros2-client with those that have come and without those that have gone. It is made with the
//! first of them.
//!
//! A reader keeps the last list that it received from a participant. ros2-client sends its own when
//! an endpoint is made, and a new reader gets the last list of both writers in any order. So a
//! thread checks every second for new readers and endpoints, and sends the list again, a few times.

use std::collections::BTreeSet;
use std::sync::mpsc::{RecvTimeoutError, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use ros2_client::builtin_topics::ros_discovery::{QOS_PUB, TOPIC_NAME, TYPE_NAME};
use ros2_client::entities_info::ParticipantEntitiesInfo;
use ros2_client::{Context, Gid};
use rustdds::no_key::DataWriterCdr;
use rustdds::{DomainParticipant, GUID, Publisher, TopicKind};
use serde_json::Value;

/// Time between two checks for new readers and endpoints.
const CHECKS_AGAIN: Duration = Duration::from_secs(1);

/// Checks after a change with which the list is sent, ever more seldom: the sample of ros2-client
/// may have been on its way, on a busy machine for long. Assumed: not for more than a minute.
fn is_sent_with(check: u32) -> bool {
    check.is_power_of_two() && check <= 64
}

/// Publishers to add to the list of ros2-client, and to remove from it.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
struct Changes {
    come: BTreeSet<GUID>,
    gone: BTreeSet<GUID>,
}

/// Sends the list of one participant until it is dropped.
pub(super) struct GraphInfo {
    changes: Arc<Mutex<Changes>>,
    wake: Option<SyncSender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl GraphInfo {
    /// # Errors
    /// DDS refuses the writer, or no thread can be started.
    pub fn start(
        participant: &DomainParticipant,
        publisher: &Publisher,
        context: &Context,
    ) -> Result<GraphInfo, String> {
        let writer = participant
            .create_topic(TOPIC_NAME.to_owned(), TYPE_NAME.to_owned(), &QOS_PUB, TopicKind::NoKey)
            .and_then(|topic| publisher.create_datawriter_no_key_cdr(&topic, None))
            .map_err(|error| error.to_string())?;
        let changes = Arc::<Mutex<Changes>>::default();
        let (wake, woken) = sync_channel(1);
        let sender = Sender {
            participant: participant.clone(),
            context: context.clone(),
            writer,
            changes: Arc::clone(&changes),
        };
        let run = move || {
            let mut said = None;
            let mut checks = 0_u32;
            loop {
                match woken.recv_timeout(CHECKS_AGAIN) {
                    Ok(()) | Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => return,
                }
                let now = sender.check();
                checks = if said.as_ref() == Some(&now) { checks.saturating_add(1) } else { 1 };
                if is_sent_with(checks) {
                    sender.send(&now);
                }
                said = Some(now);
            }
        };
        let thread = std::thread::Builder::new()
            .name("ROS graph info".to_owned())
            .spawn(run)
            .map_err(|error| error.to_string())?;
        Ok(GraphInfo { changes, wake: Some(wake), thread: Some(thread) })
    }

    /// A publisher has come.
    pub fn add(&self, writer: GUID) {
        lock(&self.changes).come.insert(writer);
        self.wake();
    }

    /// A publisher has gone.
    pub fn remove(&self, writer: GUID) {
        let mut changes = lock(&self.changes);
        if !changes.come.remove(&writer) {
            changes.gone.insert(writer);
        }
        drop(changes);
        self.wake();
    }

    fn wake(&self) {
        if let Some(wake) = &self.wake {
            // Full: it is about to look.
            let _ = wake.try_send(());
        }
    }
}

impl Drop for GraphInfo {
    fn drop(&mut self) {
        self.wake = None;
        if let Some(thread) = self.thread.take() {
            // It cannot have panicked without a defect in rustdds; there is nothing to save here.
            let _ = thread.join();
        }
    }
}

fn lock(changes: &Mutex<Changes>) -> MutexGuard<'_, Changes> {
    changes.lock().unwrap_or_else(PoisonError::into_inner)
}

struct Sender {
    participant: DomainParticipant,
    context: Context,
    writer: DataWriterCdr<ParticipantEntitiesInfo>,
    changes: Arc<Mutex<Changes>>,
}

/// What the list depends on, and who reads it.
#[derive(PartialEq)]
struct Seen {
    by_ros2_client: Value,
    changes: Changes,
    readers: BTreeSet<GUID>,
}

impl Sender {
    fn check(&self) -> Seen {
        let info = self.context.participant_entities_info();
        let readers = self.participant.discovered_readers();
        let readers = readers
            .iter()
            .filter(|reader| *reader.subscription_topic_data.topic_name() == TOPIC_NAME);
        Seen {
            by_ros2_client: serde_json::to_value(info).unwrap_or_default(),
            changes: lock(&self.changes).clone(),
            readers: readers.map(|reader| reader.reader_proxy.remote_reader_guid).collect(),
        }
    }

    fn send(&self, seen: &Seen) {
        let result = serde_json::from_value(with(&seen.changes, seen.by_ros2_client.clone()))
            .map_err(|error| error.to_string())
            .and_then(|info| self.writer.write(info, None).map_err(|error| error.to_string()));
        if let Err(reason) = result {
            tracing::warn!("{TOPIC_NAME}: publishers have the wrong names: {reason}");
        }
    }
}

/// The list of ros2-client with the changes: as JSON, since its fields are private.
fn with(changes: &Changes, mut info: Value) -> Value {
    let gids = |guids: &BTreeSet<GUID>| -> Vec<Value> {
        guids.iter().filter_map(|guid| serde_json::to_value(Gid::from(*guid)).ok()).collect()
    };
    let gone = gids(&changes.gone);
    // A participant of ours has one node.
    if let Some(Value::Array(writers)) =
        info.pointer_mut("/node_entities_info_seq/0/writer_gid_seq")
    {
        writers.retain(|gid| !gone.contains(gid));
        writers.extend(gids(&changes.come));
    }
    info
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_list_is_sent_at_once_and_for_a_minute_ever_more_seldom() {
        let sent: Vec<u32> = (1..10_000).filter(|check| is_sent_with(*check)).collect();
        assert_eq!(sent, [1, 2, 4, 8, 16, 32, 64]);
    }
}
