//! A service answers a client whose reader of answers is found after its request, and one that
//! never opens a reader holds up no other client.
//!
//! The client is made of DDS endpoints, so that it can ask first and open its reader later; what
//! Fast DDS does when the packet that announces the reader is lost.

mod domains;

use std::time::Duration;

use domains::domain;
use friction_stage::node::{
    participant::{Network, Participant, Reach},
    service::{self, READER_COMES_WITHIN, Service},
    std_srvs::{SetBoolRequest, SetBoolResponse},
};
use futures::StreamExt;
use ros2_client::NodeOptions;
use rustdds::{
    GUID, QosPolicies, QosPolicyBuilder, RTPSEntity, SequenceNumber, Subscriber, TopicKind,
    WriteOptionsBuilder,
    no_key::{DataReader, DataWriter},
    policy,
    rpc::SampleIdentity,
};

const PATIENCE: Duration = Duration::from_secs(20);
const SERVICE: &str = "/enable";

struct SetBool;

impl Service for SetBool {
    type Request = SetBoolRequest;
    type Response = SetBoolResponse;
    const PACKAGE: &'static str = "std_srvs";
    const NAME: &'static str = "SetBool";
}

fn join(test: u16, name: &str) -> Participant {
    let network = Network { domain: domain(test), reach: Reach::Localhost };
    Participant::join(network, "/", name, NodeOptions::new()).unwrap()
}

/// Serves [`SERVICE`] on the runtime of the test: it says back what it was asked for.
fn serve(test: u16) {
    let handler = |request: SetBoolRequest| {
        std::future::ready(SetBoolResponse { success: request.data, message: String::new() })
    };
    tokio::spawn(service::serve::<SetBool, _, _>(&join(test, "server"), SERVICE, handler).unwrap());
}

/// The DDS side of a client.
struct Client {
    participant: Participant,
    requests: DataWriter<SetBoolRequest>,
    subscriber: Subscriber,
}

impl Client {
    fn new(test: u16) -> Self {
        let participant = join(test, "client");
        let dds = participant.domain_participant();
        let kind = "std_srvs::srv::dds_::SetBool_Request_".to_owned();
        let topic = dds
            .create_topic(format!("rq{SERVICE}Request"), kind, &reliable(), TopicKind::NoKey)
            .unwrap();
        let requests = dds
            .create_publisher(&reliable())
            .unwrap()
            .create_datawriter_no_key_cdr(&topic, None)
            .unwrap();
        let subscriber = dds.create_subscriber(&reliable()).unwrap();
        Self { participant, requests, subscriber }
    }

    fn open_reader(&self, service: &str) -> DataReader<SetBoolResponse> {
        let kind = "std_srvs::srv::dds_::SetBool_Response_".to_owned();
        let name = format!("rr{service}Reply");
        let dds = self.participant.domain_participant();
        let topic = dds.create_topic(name, kind, &reliable(), TopicKind::NoKey).unwrap();
        self.subscriber.create_datareader_no_key_cdr(&topic, None).unwrap()
    }

    /// The reader that will be opened next: numbers of endpoints count up.
    fn next_reader(&self) -> GUID {
        let mut guid = self.open_reader("/another").guid();
        guid.entity_id.entity_key[2] += 1;
        guid
    }

    /// Asks, and names `reader` as the one for the answer.
    async fn ask(&self, data: bool, reader: GUID) {
        assert!(
            self.participant.watch().wait_for_matches(self.requests.guid(), 1, PATIENCE) >= 1,
            "no service"
        );
        let identity =
            SampleIdentity { writer_guid: reader, sequence_number: SequenceNumber::new(1) };
        let options = WriteOptionsBuilder::new().related_sample_identity(identity).build();
        self.requests.async_write_with_options(SetBoolRequest { data }, options).await.unwrap();
    }
}

fn reliable() -> QosPolicies {
    let max_blocking_time = rustdds::Duration::from_millis(100);
    QosPolicyBuilder::new()
        .reliability(policy::Reliability::Reliable { max_blocking_time })
        .durability(policy::Durability::Volatile)
        .history(policy::History::KeepLast { depth: 10 })
        .build()
}

async fn first_answer(reader: DataReader<SetBoolResponse>, limit: Duration) -> bool {
    let mut answers = reader.async_sample_stream();
    let answer = tokio::time::timeout(limit, answers.next()).await.expect("no answer came");
    answer.unwrap().unwrap().into_value().success
}

#[tokio::test]
async fn an_answer_waits_for_a_reader_that_is_found_after_the_request() {
    serve(0);
    let client = Client::new(0);
    let reader = client.next_reader();
    client.ask(true, reader).await;
    // Long enough for the answer to go out at once, as it does to a reader that is there.
    tokio::time::sleep(Duration::from_millis(500)).await;
    let opened = client.open_reader(SERVICE);
    assert_eq!(opened.guid(), reader, "rustdds numbers endpoints in another way");
    assert!(first_answer(opened, PATIENCE).await);
}

#[tokio::test]
async fn a_client_that_never_opens_a_reader_holds_nobody_up() {
    serve(1);
    let client = Client::new(1);
    let mut nobody = client.next_reader();
    nobody.entity_id.entity_key[0] = 0x7f;
    client.ask(false, nobody).await;
    let reader = client.open_reader(SERVICE);
    client.ask(true, reader.guid()).await;
    assert!(first_answer(reader, READER_COMES_WITHIN / 2).await);
}
