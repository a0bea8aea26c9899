//! One DDS participant: domain, networks, context and node.
//!
//! In goes what the environment says (`ROS_DOMAIN_ID`, `ROS_AUTOMATIC_DISCOVERY_RANGE`,
//! `ROS_LOCALHOST_ONLY`) and a node name; out comes a node that talks to real ROS 2 peers.
//! ros2-client reads none of these variables, and the discovery events of a participant reach one
//! listener only: hence one participant and one context per node.

use std::{
    net::{IpAddr, Ipv4Addr, Ipv6Addr},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use anyhow::Context as _;
use ros2_client::{Context, Name, Node, NodeName, NodeOptions, names::NameError};
use rustdds::no_key::DataWriterCdr;
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, GUID, QosPolicies, RTPSEntity, Topic,
    TopicDescription, TopicKind,
};
use thiserror::Error;

use super::graph_info::GraphInfo;
use super::graph_watch::GraphWatch;
use super::qos::Qos;
use super::qos_overrides::QosOverrides;
pub use super::reach::Reach;
use super::{socket_filter, static_peers, uninterrupted};

/// Largest domain whose UDP ports exist: 7400 + 250 * domain + 11 must stay below 65536
/// (DDSI-RTPS 2.5, 9.6.2.3).
pub const LARGEST_DOMAIN: u16 = 232;

/// Where a participant takes part: the domain and how far it is seen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Network {
    pub domain: u16,
    pub reach: Reach,
}

/// What is wrong with the environment variables that say where to take part.
#[derive(Debug, Error, PartialEq, Eq)]
pub enum NetworkError {
    #[error(
        "ROS_DOMAIN_ID is \"{value}\": it must be an integer from 0 to {LARGEST_DOMAIN} (unset or \
         empty means 0)"
    )]
    DomainId { value: String },
    #[error(
        "ROS_AUTOMATIC_DISCOVERY_RANGE is \"{value}\": it must be SUBNET, LOCALHOST or \
         SYSTEM_DEFAULT{}",
        nearest.as_ref().map(|n| format!("; did you mean {n}?")).unwrap_or_default()
    )]
    Range { value: String, nearest: Option<&'static str> },
    #[error(
        "ROS_AUTOMATIC_DISCOVERY_RANGE is \"OFF\": this node cannot run without discovery; use \
         LOCALHOST to stay on this machine"
    )]
    RangeOff,
    #[error("ROS_LOCALHOST_ONLY is \"{value}\": it must be 0 or 1 (unset or empty means 0)")]
    LocalhostOnly { value: String },
    #[error(
        "ROS_SECURITY_ENABLE is true: DDS security is not supported; unset it to take part without \
         protection, best with ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST"
    )]
    Security,
    #[error(
        "ROS_SECURITY_ENABLE is \"{value}\": it must be true or false (unset or empty means false)"
    )]
    SecurityEnable { value: String },
}

impl Network {
    /// Reads `ROS_DOMAIN_ID`, `ROS_AUTOMATIC_DISCOVERY_RANGE`, `ROS_LOCALHOST_ONLY` and
    /// `ROS_SECURITY_ENABLE`.
    ///
    /// # Errors
    /// [`NetworkError`] when one of them has a value that ROS 2 does not know, or that is not
    /// supported.
    pub fn from_environment() -> Result<Self, NetworkError> {
        Self::from_variables(environment)
    }

    /// The same from any source of variables; an empty value counts as unset, as in rcl.
    ///
    /// `ROS_LOCALHOST_ONLY=1` is deprecated in ROS 2 and still wins over the range.
    ///
    /// # Errors
    /// [`NetworkError`] when one of them has a value that ROS 2 does not know, or that is not
    /// supported.
    pub fn from_variables(variable: impl Fn(&str) -> Option<String>) -> Result<Self, NetworkError> {
        let set = |name: &str| set(&variable, name);
        match set("ROS_SECURITY_ENABLE").as_deref() {
            None | Some("false") => {}
            Some("true") => return Err(NetworkError::Security),
            Some(value) => {
                return Err(NetworkError::SecurityEnable { value: value.to_owned() });
            }
        }
        let domain = match set("ROS_DOMAIN_ID") {
            None => 0,
            Some(value) => match value.parse::<u16>() {
                Ok(domain) if domain <= LARGEST_DOMAIN => domain,
                _ => return Err(NetworkError::DomainId { value }),
            },
        };
        let localhost_only = match set("ROS_LOCALHOST_ONLY").as_deref() {
            None | Some("0") => false,
            Some("1") => true,
            Some(value) => {
                return Err(NetworkError::LocalhostOnly { value: value.to_owned() });
            }
        };
        let range = match set("ROS_AUTOMATIC_DISCOVERY_RANGE").as_deref() {
            None | Some("SUBNET" | "SYSTEM_DEFAULT") => Reach::Subnet,
            Some("LOCALHOST") => Reach::Localhost,
            Some("OFF") => return Err(NetworkError::RangeOff),
            Some(value) => {
                let upper = value.to_uppercase();
                let nearest = Reach::NAMES
                    .into_iter()
                    .map(|name| (strsim::damerau_levenshtein(&upper, name), name))
                    .min()
                    .filter(|(distance, _)| *distance <= 3)
                    .map(|(_, name)| name);
                return Err(NetworkError::Range { value: value.to_owned(), nearest });
            }
        };
        let reach = if localhost_only { Reach::Localhost } else { range };
        Ok(Self { domain, reach })
    }

    /// The variables that make another process take part in the same network.
    pub fn variables(self) -> [(&'static str, String); 3] {
        let range = match self.reach {
            Reach::Localhost => "LOCALHOST",
            Reach::Subnet => "SUBNET",
        };
        [
            ("ROS_DOMAIN_ID", self.domain.to_string()),
            ("ROS_AUTOMATIC_DISCOVERY_RANGE", range.to_owned()),
            ("ROS_LOCALHOST_ONLY", "0".to_owned()),
        ]
    }

    fn domain_participant(self) -> Result<DomainParticipant, ParticipantError> {
        let builder = DomainParticipantBuilder::new(self.domain);
        let builder = match self.reach {
            Reach::Subnet => builder,
            Reach::Localhost => builder.with_only_networks([
                IpAddr::V4(Ipv4Addr::LOCALHOST),
                IpAddr::V6(Ipv6Addr::LOCALHOST),
            ]),
        };
        builder.build().map_err(|e| ParticipantError::Join { network: self, reason: e.to_string() })
    }
}

/// What `enclave`, or a variable, asks for that has no effect in `network`, for a warning at the
/// start.
pub fn without_effect(
    network: Network,
    enclave: Option<&str>,
    variable: impl Fn(&str) -> Option<String>,
) -> Vec<String> {
    let enclave = enclave.map(|enclave| {
        format!("the enclave {enclave} has no effect: DDS security is not supported")
    });
    let peers = set(variable, "ROS_STATIC_PEERS").filter(|_| network.reach == Reach::Localhost);
    let peers = peers.map(|peers| {
        format!(
            "ROS_STATIC_PEERS is \"{peers}\" and has no effect: the range is LOCALHOST, and only \
             this machine is heard"
        )
    });
    enclave.into_iter().chain(peers).collect()
}

/// From now on this process announces its participants in `network` to the machines in
/// `ROS_STATIC_PEERS`, too.
///
/// # Errors
/// One of them has no address, or there is no socket to send from.
pub fn announce_to_static_peers(network: Network) -> anyhow::Result<()> {
    let names = set(environment, "ROS_STATIC_PEERS").filter(|_| network.reach == Reach::Subnet);
    let peers = static_peers::resolve(&names.unwrap_or_default())?;
    static_peers::announce_to(&peers, network.domain)
        .context("cannot announce the node to the machines in ROS_STATIC_PEERS")
}

/// A variable of this process.
pub(super) fn environment(name: &str) -> Option<String> {
    std::env::var_os(name).map(|value| value.to_string_lossy().into_owned())
}

/// Value of a variable that is there and not empty, as rcl reads it.
fn set(variable: impl Fn(&str) -> Option<String>, name: &str) -> Option<String> {
    variable(name).map(|value| value.trim().to_owned()).filter(|value| !value.is_empty())
}

/// Why a participant, or something in it, could not be made.
#[derive(Debug, Error)]
pub enum ParticipantError {
    #[error("cannot join ROS domain {} ({:?}): {reason}", network.domain, network.reach)]
    Join { network: Network, reason: String },
    #[error(
        "cannot filter what the sockets in ROS domain {} receive: {source}",
        network.domain
    )]
    Filter { network: Network, source: std::io::Error },
    #[error("node name \"{name}\" in namespace \"{namespace}\" is not a ROS name: {source}")]
    NodeName { namespace: String, name: String, source: NameError },
    #[error("cannot make the node {name}: {reason}")]
    Node { name: String, reason: String },
    #[error("topic name \"{name}\" is not a ROS name: {source}")]
    TopicName { name: String, source: NameError },
    #[error("cannot make the {what} on {topic}: {reason}")]
    Endpoint { what: &'static str, topic: String, reason: String },
}

/// A node with a context and a DDS participant of its own.
///
/// Cheap to clone: outlets keep one to make themselves a new writer with. When the last clone is
/// dropped, the node takes leave of its peers; a process that ends without that stays in their
/// lists for 50 s.
#[derive(Clone)]
pub struct Participant {
    inner: Arc<Inner>,
}

/// Dropped in this order: the first two keep the DDS participant alive.
struct Inner {
    info: Mutex<Option<GraphInfo>>,
    watch: GraphWatch,
    node: Mutex<Node>,
    node_name: NodeName,
    context: Context,
    domain_participant: DomainParticipant,
    publisher: rustdds::Publisher,
    qos_overrides: QosOverrides,
}

impl Drop for Inner {
    fn drop(&mut self) {
        static_peers::remove(self.domain_participant.guid());
    }
}

impl Participant {
    /// Joins `network` as node `name` in `namespace` (absolute, `/` for none).
    ///
    /// # Errors
    /// [`ParticipantError`] when the name is none or the network cannot be joined.
    pub fn join(
        network: Network,
        namespace: &str,
        name: &str,
        options: NodeOptions,
    ) -> Result<Self, ParticipantError> {
        Self::join_with(network, namespace, name, options, QosOverrides::default())
    }

    /// The same, with quality of service that the user wants of single endpoints.
    pub(super) fn join_with(
        network: Network,
        namespace: &str,
        name: &str,
        options: NodeOptions,
        qos_overrides: QosOverrides,
    ) -> Result<Self, ParticipantError> {
        let node_name =
            NodeName::new(namespace, name).map_err(|source| ParticipantError::NodeName {
                namespace: namespace.to_owned(),
                name: name.to_owned(),
                source,
            })?;
        socket_filter::hear(network.reach)
            .map_err(|source| ParticipantError::Filter { network, source })?;
        uninterrupted::check()
            .map_err(|error| ParticipantError::Join { network, reason: error.to_string() })?;
        let domain_participant = network.domain_participant()?;
        static_peers::add(domain_participant.guid());
        let context = Context::from_domain_participant(domain_participant.clone())
            .map_err(|e| ParticipantError::Join { network, reason: e.to_string() })?;
        let node =
            context.new_node(node_name.clone(), options).map_err(|e| ParticipantError::Node {
                name: node_name.fully_qualified_name(),
                reason: format!("{e:?}"),
            })?;
        let watch = GraphWatch::start(domain_participant.clone())
            .map_err(|e| ParticipantError::Join { network, reason: e.to_string() })?;
        // Every policy is that of the topic.
        let publisher = domain_participant
            .create_publisher(&QosPolicies::qos_none())
            .map_err(|e| ParticipantError::Join { network, reason: e.to_string() })?;
        let (info, node) = (Mutex::default(), Mutex::new(node));
        let inner = Inner {
            info,
            watch,
            node,
            node_name,
            context,
            domain_participant,
            publisher,
            qos_overrides,
        };
        Ok(Self { inner: Arc::new(inner) })
    }

    /// The ros2-client node, for services and logging. Hold it briefly, and make no spinner of it:
    /// it would take the discovery events away from [`Participant::watch`].
    pub fn node(&self) -> MutexGuard<'_, Node> {
        self.inner.node.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn context(&self) -> &Context {
        &self.inner.context
    }

    /// Quality of service that the user wants of single endpoints.
    pub(super) fn qos_overrides(&self) -> &QosOverrides {
        &self.inner.qos_overrides
    }

    /// Who is matched with the endpoints of this node.
    pub fn watch(&self) -> &GraphWatch {
        &self.inner.watch
    }

    /// Endpoints of the whole domain can be asked here.
    pub fn domain_participant(&self) -> &DomainParticipant {
        &self.inner.domain_participant
    }

    /// Of the participant itself.
    pub fn gid(&self) -> [u8; 16] {
        self.inner.domain_participant.guid().to_bytes()
    }

    /// A publisher on `topic` that takes the place of another one of this node.
    pub(super) fn succeeding_writer<M: serde::Serialize>(
        &self,
        topic: &Topic,
    ) -> Result<DataWriterCdr<M>, String> {
        let writer = self.inner.publisher.create_datawriter_no_key_cdr(topic, None);
        let writer = writer.map_err(|error| error.to_string())?;
        self.with_info(|info| info.add(writer.guid()));
        Ok(writer)
    }

    /// The publisher `guid` has given its place to another one, and is no more.
    pub(super) fn forget_writer(&self, guid: GUID) {
        self.watch().forget(guid);
        self.with_info(|info| info.remove(guid));
    }

    fn with_info(&self, use_it: impl FnOnce(&GraphInfo)) {
        let Inner { info, domain_participant, publisher, context, .. } = &*self.inner;
        let mut info = info.lock().unwrap_or_else(PoisonError::into_inner);
        if info.is_none() {
            match GraphInfo::start(domain_participant, publisher, context) {
                Ok(started) => *info = Some(started),
                Err(reason) => tracing::warn!("new publishers have no node's name: {reason}"),
            }
        }
        if let Some(info) = &*info {
            use_it(info);
        }
    }

    /// Subscribers on `topic` anywhere in the domain, dead ones included until their lease ends.
    pub fn readers_of(&self, topic: &Topic) -> usize {
        let name = topic.name();
        self.inner
            .domain_participant
            .discovered_readers()
            .iter()
            .filter(|reader| *reader.subscription_topic_data.topic_name() == name)
            .count()
    }

    /// Publishers of the ROS topic `name` (absolute) in other participants, dead ones included
    /// until their lease ends.
    pub fn other_writers_of(&self, name: &str) -> usize {
        let (dds_name, prefix) = (format!("rt{name}"), self.inner.domain_participant.guid().prefix);
        self.inner
            .domain_participant
            .discovered_writers()
            .iter()
            .filter(|writer| *writer.publication_topic_data.topic_name() == dds_name)
            .filter(|writer| writer.writer_proxy.remote_writer_guid.prefix != prefix)
            .count()
    }

    /// `/namespace/name`.
    pub fn fully_qualified_name(&self) -> String {
        self.inner.node_name.fully_qualified_name()
    }

    /// The topic `name` (absolute, or relative to the node's namespace) of ROS type
    /// `package/msg/type_name`, with every policy of `qos` set on it, the send window included
    /// (which ros2-client's own profile cannot carry).
    ///
    /// # Errors
    /// [`ParticipantError::TopicName`] or [`ParticipantError::Endpoint`].
    pub fn topic(
        &self,
        name: &str,
        package: &str,
        type_name: &str,
        qos: &Qos,
    ) -> Result<Topic, ParticipantError> {
        let dds_name = Name::parse(name)
            .map_err(|source| ParticipantError::TopicName { name: name.to_owned(), source })?
            .to_dds_name("rt", &self.inner.node_name, "");
        let dds_type = ros2_client::MessageTypeName::new(package, type_name).dds_msg_type();
        let policies = QosPolicies::from(qos);
        self.inner
            .domain_participant
            .create_topic(dds_name, dds_type, &policies, TopicKind::NoKey)
            .map_err(|e| ParticipantError::Endpoint {
                what: "topic",
                topic: name.to_owned(),
                reason: e.to_string(),
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn network(variables: &[(&str, &str)]) -> Result<Network, NetworkError> {
        Network::from_variables(|name| {
            variables.iter().find(|(n, _)| *n == name).map(|(_, v)| (*v).to_owned())
        })
    }

    #[test]
    fn nothing_set_is_domain_0_on_the_subnet() {
        let expected = Network { domain: 0, reach: Reach::Subnet };
        assert_eq!(network(&[]), Ok(expected));
        assert_eq!(
            network(&[
                ("ROS_DOMAIN_ID", ""),
                ("ROS_AUTOMATIC_DISCOVERY_RANGE", ""),
                ("ROS_LOCALHOST_ONLY", "")
            ]),
            Ok(expected)
        );
    }

    #[test]
    fn localhost_only_wins_over_the_range() {
        let both = network(&[
            ("ROS_DOMAIN_ID", "42"),
            ("ROS_LOCALHOST_ONLY", "1"),
            ("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"),
        ]);
        let expected = Network { domain: 42, reach: Reach::Localhost };
        assert_eq!(both, Ok(expected));
    }

    #[test]
    fn security_is_refused_whatever_the_strategy() {
        for strategy in ["Enforce", "Permissive", ""] {
            let variables = [("ROS_SECURITY_ENABLE", "true"), ("ROS_SECURITY_STRATEGY", strategy)];
            assert_eq!(network(&variables), Err(NetworkError::Security));
        }
        assert!(network(&[("ROS_SECURITY_ENABLE", "false")]).is_ok());
        let error = network(&[("ROS_SECURITY_ENABLE", "yes")]).unwrap_err().to_string();
        assert!(error.contains("\"yes\": it must be true or false"), "{error}");
    }

    #[test]
    fn what_has_no_effect_is_named() {
        let peers = |name: &str| (name == "ROS_STATIC_PEERS").then(|| "10.0.0.1;box".to_owned());
        let of = |reach, enclave| without_effect(Network { domain: 0, reach }, enclave, peers);
        let warnings = of(Reach::Localhost, Some("/lab"));
        assert!(warnings[0].contains("/lab") && warnings[1].contains("10.0.0.1;box"));
        assert_eq!(warnings.len(), 2);
        assert!(of(Reach::Subnet, None).is_empty());
    }

    #[test]
    fn a_domain_without_ports_is_refused_with_its_limit() {
        assert_eq!(network(&[("ROS_DOMAIN_ID", "232")]).unwrap().domain, 232);
        for value in ["233", "-1", "0x10", "1.5", "abc"] {
            let message = network(&[("ROS_DOMAIN_ID", value)]).unwrap_err().to_string();
            assert!(message.contains(value) && message.contains("232"), "{message}");
        }
    }

    #[test]
    fn a_mistyped_range_names_the_nearest() {
        let error = network(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "localhst")]).unwrap_err();
        assert!(error.to_string().ends_with("did you mean LOCALHOST?"), "{error}");
        assert_eq!(
            network(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")]),
            Err(NetworkError::RangeOff)
        );
    }
}
