//! Services of a node: one future per service that answers its requests.
//!
//! [`serve`] opens the service on the node and gives back a future that answers for as long as it
//! is polled; a node polls all of its services together on one thread (`futures::join!`). The
//! parameter services and the node's own (`~/reset`, `~/enable`, `~/record`) are both served by it.

use std::{future::Future, pin::pin, time::Duration};

use futures::{StreamExt, stream};
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{Message, Name, QosProfile, RmwRequestId, ServiceMapping, ServiceTypeName};
use rustdds::GUID;

use super::participant::Participant;
use super::reopened::{Reopened, Shared, Taken};
pub use super::service_error::ServiceError;

/// How long an answer waits for the reader that it is for. A packet of the discovery that was lost
/// comes again with the next heartbeat, after 3 s with Fast DDS.
pub const READER_COMES_WITHIN: Duration = Duration::from_secs(10);
/// Answers that may wait for their readers at the same time, before new requests wait too.
pub const WAITING_ANSWERS: usize = 1000;

type Server<S> = ros2_client::Server<<S as Service>::Request, <S as Service>::Response>;

/// A ROS 2 service type: request, response and name, as in `std_srvs/srv/Trigger`.
pub trait Service {
    type Request: Message + Clone + Send + Sync + 'static;
    type Response: Message + Send + Sync + 'static;
    /// Package that defines the type, as in `std_srvs`.
    const PACKAGE: &'static str;
    /// Name of the type without package, as in `Trigger`.
    const NAME: &'static str;
}

/// Declares the service types of a package, each with its request and response.
macro_rules! services {
    ($package:literal: $($name:ident($request:ty) -> $response:ty),+ $(,)?) => {$(
        struct $name;

        impl $crate::node::service::Service for $name {
            type Request = $request;
            type Response = $response;
            const PACKAGE: &'static str = $package;
            const NAME: &'static str = stringify!($name);
        }
    )+};
}
pub(super) use services;

/// Opens the service `name` (absolute) and gives back the future that answers its requests, one
/// after the other.
///
/// The future ends only when it is dropped; it is polled on a tokio runtime with time. A request
/// that cannot be read, or an answer that cannot be sent because the asking node has gone, is
/// reported in the log and costs the others nothing.
///
/// A request may come before its client's reader of answers is known here, and an answer that is
/// sent then is lost. So an answer waits for that reader, as in rmw_fastrtps
/// (`__rmw_send_response`), while other requests are answered. A client that was silent for longer
/// than its lease is heard again.
pub fn serve<S, H, F>(
    participant: &Participant,
    name: &str,
    mut handler: H,
) -> Result<impl Future<Output = ()> + Send + use<S, H, F>, ServiceError>
where
    S: Service,
    H: FnMut(S::Request) -> F + Send,
    F: Future<Output = S::Response> + Send,
{
    // rmw_qos_profile_services_default. Fail: a frozen client must not hold up the others.
    let qos = QosProfile::publisher_default()
        .reliability_reliable(WhenFull::Fail)
        .durability(Durability::Volatile)
        .history(History::KeepLast { depth: 10 });
    let parsed = absolute(name)?;
    let service_type = ServiceTypeName::new(S::PACKAGE, S::NAME);
    // Enhanced is what rmw_fastrtps speaks.
    let (name, participant) = (name.to_owned(), participant.clone());
    let mut servers = Reopened::new(&participant, &name, {
        let (name, participant) = (name.clone(), participant.clone());
        move || {
            participant
                .node()
                .create_server::<S::Request, S::Response>(
                    ServiceMapping::Enhanced,
                    &parsed,
                    &service_type,
                    qos.clone(),
                    qos.clone(),
                )
                .map_err(ServiceError::creating(&name))
        }
    })?;
    Ok(async move {
        let (name, participant) = (&name, &participant);
        let requests = stream::poll_fn(move |cx| {
            servers.meet_returned(cx);
            // A new future each time is sound here: rustdds' stream keeps no state between polls.
            servers.poll(cx, |server, cx| pin!(server.async_receive_request()).poll(cx)).map(Some)
        });
        let answers = requests.filter_map(|request| {
            let answer = match request {
                Ok(Taken { server, id, request }) => Some((server, id, handler(request))),
                Err(error) => {
                    tracing::warn!("service {name}: a request could not be read: {error}");
                    None
                }
            };
            async move {
                let (server, id, response) = answer?;
                Some((server, id, response.await))
            }
        });
        let send = |(server, id, response): (Shared<Server<S>>, _, _)| async move {
            if !reader_is_there(participant, name, &id).await {
                return;
            }
            if let Err(error) = server.lock().send_response(id, response) {
                tracing::warn!("service {name}: the answer was not sent: {error}");
            }
        };
        answers.for_each_concurrent(WAITING_ANSWERS, send).await;
    })
}

/// The name of a service or action, absolute.
pub fn absolute(name: &str) -> Result<Name, ServiceError> {
    let refuse = |problem| ServiceError::Name { name: name.to_owned(), problem };
    let parsed = Name::parse(name).map_err(|source| refuse(source.to_string()))?;
    match parsed.is_absolute() {
        true => Ok(parsed),
        false => Err(refuse("it does not start with /".to_owned())),
    }
}

/// Waits until the reader of answers of who asked is known here; false, and logged, when it does
/// not come.
pub async fn reader_is_there(participant: &Participant, name: &str, id: &RmwRequestId) -> bool {
    let reader = GUID::from(id.writer_gid);
    // Fast DDS names the reader of answers in its requests, others the writer of the request.
    let there = !reader.entity_id.entity_kind.is_reader()
        || participant.watch().wait_for_peer(reader, READER_COMES_WITHIN).await;
    if !there {
        tracing::warn!(
            "service {name}: who asked did not open a reader for the answer within {} s, or has \
             gone",
            READER_COMES_WITHIN.as_secs()
        );
    }
    there
}
