//! Peers are noticed when they come, when they leave, and when they do not fit.

mod domains;

use std::time::{Duration, Instant};

use domains::domain;
use friction_stage::node::{
    inlet::Inlet,
    outlet::Outlet,
    participant::{Network, Participant, Reach},
    qos::Qos,
};
use friction_stage_data::message::WrenchStamped;
use ros2_client::NodeOptions;

const PATIENCE: Duration = Duration::from_secs(20);

fn join(test: u16, name: &str) -> Participant {
    let network = Network { domain: domain(test), reach: Reach::Localhost };
    Participant::join(network, "/", name, NodeOptions::new()).unwrap()
}

#[test]
fn a_subscriber_that_leaves_is_gone_at_once_and_not_after_its_lease() {
    let here = join(0, "here");
    let outlet = Outlet::<WrenchStamped>::new(&here, "/force", &Qos::reliable(1)).unwrap();
    let there = join(0, "there");
    let inlet = Inlet::<WrenchStamped>::new(&there, "/force", &Qos::reliable(1)).unwrap();
    assert_eq!(outlet.wait_for_subscribers(1, PATIENCE), 1);
    let watch = there.watch();
    assert_eq!(watch.wait_for_matches(inlet.guid(), 1, PATIENCE), 1);

    drop(inlet);
    drop(there);
    let left = Instant::now();
    while outlet.subscribers() > 0 {
        assert!(
            left.elapsed() < Duration::from_secs(5),
            "the lease is 50 s, a farewell takes milliseconds"
        );
        std::thread::sleep(Duration::from_millis(2));
    }
}

#[test]
fn a_subscriber_that_wants_more_than_is_offered_is_counted_and_not_matched() {
    let here = join(1, "here");
    let outlet = Outlet::<WrenchStamped>::new(&here, "/force", &Qos::best_effort(1)).unwrap();
    let there = join(1, "there");
    let _inlet = Inlet::<WrenchStamped>::new(&there, "/force", &Qos::reliable(1)).unwrap();
    let start = Instant::now();
    while outlet.misfits() == 0 {
        assert!(start.elapsed() < PATIENCE, "the change was not noticed");
        std::thread::sleep(Duration::from_millis(2));
    }
    assert_eq!(outlet.subscribers(), 0);
}

#[test]
fn another_publisher_of_the_same_topic_is_seen() {
    let here = join(2, "here");
    let _ours = Outlet::<WrenchStamped>::new(&here, "/force", &Qos::reliable(1)).unwrap();
    let inlet = Inlet::<WrenchStamped>::new(&here, "/force", &Qos::reliable(1)).unwrap();
    assert_eq!(here.watch().wait_for_matches(inlet.guid(), 1, PATIENCE), 1, "our own");
    assert_eq!(here.other_writers_of("/force"), 0);
    let there = join(2, "there");
    let _theirs = Outlet::<WrenchStamped>::new(&there, "/force", &Qos::reliable(1)).unwrap();
    assert_eq!(here.watch().wait_for_matches(inlet.guid(), 2, PATIENCE), 2);
    assert_eq!(here.other_writers_of("/force"), 1);
}
