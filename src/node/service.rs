//! Services of a node: one future per service that answers its requests.
//!
//! [`serve`] opens the service on the node and gives back a future that answers for as long as it is polled; a node
//! polls all of its services together on one thread (`futures::join!`). The parameter services and the node's own
//! (`~/reset`, `~/enable`, `~/record`) are both served by it.

use std::future::Future;

use futures::StreamExt;
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::{Message, Name, Node, QosProfile, ServiceMapping, ServiceTypeName};

/// A ROS 2 service type: request, response and name, as in `std_srvs/srv/Trigger`.
pub trait Service {
    type Request: Message + Clone + Send + Sync + 'static;
    type Response: Message + Send + Sync + 'static;
    /// Package that defines the type, as in `std_srvs`.
    const PACKAGE: &'static str;
    /// Name of the type without package, as in `Trigger`.
    const NAME: &'static str;
}

/// Why a service or its topic could not be opened.
#[derive(Debug, thiserror::Error)]
pub enum ServiceError {
    #[error("service name `{name}`: {problem}; expected an absolute name, as in /stage/reset")]
    Name { name: String, problem: String },
    #[error("cannot open `{name}`: {problem}")]
    Create { name: String, problem: String },
}

/// Opens the service `name` (absolute) and gives back the future that answers its requests, one after the other.
///
/// The future ends only when it is dropped. A request that cannot be read, or an answer that cannot be sent because
/// the asking node has gone, is reported in the log and costs the others nothing.
pub fn serve<S, H, F>(
    node: &mut Node,
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
    let parsed = Name::parse(name)
        .map_err(|source| ServiceError::Name { name: name.to_owned(), problem: source.to_string() })
        .and_then(|parsed| {
            let problem = "it does not start with /".to_owned();
            if parsed.is_absolute() { Ok(parsed) } else { Err(ServiceError::Name { name: name.to_owned(), problem }) }
        })?;
    let service_type = ServiceTypeName::new(S::PACKAGE, S::NAME);
    // Enhanced is what rmw_fastrtps speaks.
    let server = node
        .create_server::<S::Request, S::Response>(ServiceMapping::Enhanced, &parsed, &service_type, qos.clone(), qos)
        .map_err(|source| ServiceError::Create { name: name.to_owned(), problem: source.to_string() })?;
    let name = name.to_owned();
    Ok(async move {
        let mut requests = server.receive_request_stream();
        while let Some(request) = requests.next().await {
            match request {
                Ok((id, request)) => {
                    let response = handler(request).await;
                    if let Err(error) = server.send_response(id, response) {
                        tracing::warn!("service {name}: the answer was not sent: {error}");
                    }
                }
                Err(error) => tracing::warn!("service {name}: a request could not be read: {error}"),
            }
        }
    })
}
