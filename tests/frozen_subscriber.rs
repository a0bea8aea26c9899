//! A frozen and a killed subscriber neither stall the publisher nor starve the healthy ones, and
//! neither does one that comes late.
//!
//! Subscribers are processes of their own: this test program, started again for the test
//! `subscriber_process` with a role in the environment. Each prints a line per event.

mod domains;

use std::{
    io::{BufRead, BufReader},
    process::{Child, Command, Stdio},
    sync::mpsc::{Receiver, channel},
    thread,
    time::{Duration, Instant},
};

use domains::domain;
use friction_stage::node::{
    outlet::{Outlet, Published},
    participant::{Network, Participant, Reach},
    qos::{Qos, SAMPLES},
};
use friction_stage_data::message::Float64MultiArray;
use futures::{StreamExt, executor::block_on};
use ros2_client::{NodeOptions, Subscription};

const TOPIC: &str = "/numbers";
/// Of patient outlets.
const PATIENCE: Duration = Duration::from_secs(5);
const DOMAIN: &str = "FROZEN_SUBSCRIBER_DOMAIN";
const NAME: &str = "FROZEN_SUBSCRIBER_NAME";
/// Sent last, again and again, until everybody has said what arrived.
const END: f64 = -1.0;

fn network(domain: u16) -> Network {
    Network { domain, reach: Reach::Localhost }
}

/// Counts 0, 1, 2, ... and prints what was missing; only in a process started by the test below.
#[test]
fn subscriber_process() {
    let (Ok(domain), Ok(name)) = (std::env::var(DOMAIN), std::env::var(NAME)) else {
        return;
    };
    let domain = domain.parse().expect("a domain");
    let participant =
        Participant::join(network(domain), "/", &name, NodeOptions::new()).expect("a participant");
    let topic = participant
        .topic(TOPIC, "std_msgs", "Float64MultiArray", &Qos::reliable(10_000))
        .expect("a topic");
    let subscription: Subscription<Float64MultiArray> =
        participant.node().create_subscription(&topic, None).expect("a subscription");
    let mut stream = Box::pin(subscription.async_stream());
    let (mut received, mut next, mut out_of_order) = (0_u64, 0_u64, 0_u64);
    loop {
        let Some(Ok((message, _))) = block_on(stream.next()) else {
            continue;
        };
        let number = message.data[0];
        if number == END {
            println!("\nEND received {received} next {next} out_of_order {out_of_order}");
            return;
        }
        if received == 0 {
            println!("\nFIRST {number}");
        }
        received += 1;
        let number = number as u64;
        out_of_order += u64::from(number != next);
        next = number + 1;
    }
}

struct Subscriber {
    process: Child,
    lines: Receiver<String>,
}

impl Subscriber {
    fn start(domain: u16, name: &str) -> Self {
        let mut process = Command::new(std::env::current_exe().expect("a test program"))
            .args(["--exact", "subscriber_process", "--nocapture"])
            .env(DOMAIN, domain.to_string())
            .env(NAME, name)
            .stdout(Stdio::piped())
            .spawn()
            .expect("the test program starts again");
        let stdout = process.stdout.take().expect("a pipe");
        let (send, lines) = channel();
        thread::spawn(move || {
            for line in BufReader::new(stdout).lines().map_while(Result::ok) {
                if send.send(line).is_err() {
                    return;
                }
            }
        });
        Self { process, lines }
    }

    fn signal(&self, signal: libc::c_int) {
        let pid = libc::pid_t::try_from(self.process.id()).expect("a process id");
        // SAFETY: sends a signal to a child that has not been waited for.
        assert_eq!(unsafe { libc::kill(pid, signal) }, 0, "signal {signal}");
    }

    fn line_with(&self, start: &str) -> Option<String> {
        self.lines.try_iter().find(|line| line.starts_with(start))
    }
}

impl Drop for Subscriber {
    fn drop(&mut self) {
        // SIGKILL ends a stopped process too.
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// An outlet that waits for subscribers that lag, and its participant, which lives as long.
fn patient_outlet(domain: u16, window: u32) -> (Participant, Outlet<Float64MultiArray>) {
    let participant =
        Participant::join(network(domain), "/", "publisher", NodeOptions::new()).unwrap();
    let qos = Qos::reliable(10).window(window);
    let outlet = Outlet::new(&participant, TOPIC, &qos).unwrap().patient(PATIENCE);
    (participant, outlet)
}

fn number(value: f64) -> Float64MultiArray {
    Float64MultiArray { data: vec![value; 10], ..Float64MultiArray::default() }
}

#[test]
fn healthy_subscribers_lose_nothing_when_others_freeze_or_die() {
    const MESSAGES: u64 = 5000;
    const TROUBLE_AT: u64 = 1000;
    const WINDOW: u32 = 512;
    let period = Duration::from_millis(1);

    let domain = domain(0);
    let healthy = [Subscriber::start(domain, "healthy_a"), Subscriber::start(domain, "healthy_b")];
    let frozen = Subscriber::start(domain, "frozen");
    let killed = Subscriber::start(domain, "killed");
    let participant =
        Participant::join(network(domain), "/", "publisher", NodeOptions::new()).unwrap();
    let mut outlet =
        Outlet::<Float64MultiArray>::new(&participant, TOPIC, &Qos::reliable(10).window(WINDOW))
            .unwrap();

    // Every subscriber has to see number 0 before counting starts: repeat it until all say so.
    let all = [&healthy[0], &healthy[1], &frozen, &killed];
    let mut seen = [false; 4];
    let deadline = Instant::now() + Duration::from_secs(30);
    // A message before the match would be lost, and rightly so (volatile).
    assert_eq!(
        outlet.wait_for_subscribers(4, Duration::from_secs(30)),
        4,
        "subscribers were not found"
    );
    assert_eq!(outlet.publish(number(0.0)), Published::Sent);
    while seen != [true; 4] {
        assert!(Instant::now() < deadline, "not everybody got the first: {seen:?}");
        for (seen, subscriber) in seen.iter_mut().zip(all) {
            *seen |= subscriber.line_with("FIRST 0").is_some();
        }
        thread::sleep(Duration::from_millis(5));
    }

    let start = Instant::now();
    let mut durations = Vec::with_capacity(MESSAGES as usize);
    for k in 1..MESSAGES {
        if k == TROUBLE_AT {
            frozen.signal(libc::SIGSTOP);
            killed.signal(libc::SIGKILL);
        }
        let due = period * u32::try_from(k).expect("small");
        thread::sleep(due.saturating_sub(start.elapsed()));
        let before = Instant::now();
        let published = outlet.publish(number(k as f64));
        durations.push(before.elapsed());
        assert_ne!(published, Published::Refused, "message {k}");
    }
    assert!(outlet.settle(Duration::from_secs(1)), "messages still held");
    let counts = outlet.counts();
    assert_eq!((counts.sent, counts.refused), (MESSAGES, 0), "{counts:?}");
    // A writer publishes for half a window, so that those who do not acknowledge fill none.
    let halves = MESSAGES / u64::from(WINDOW / 2);
    assert!(
        counts.recreated == 0 && (halves - 1..=halves + 4).contains(&counts.renewed),
        "writers were to be replaced after {}: {counts:?}",
        WINDOW / 2
    );

    // Publishing costs what it cost before the trouble, and does not wait for those that are gone.
    let median = |durations: &mut [Duration]| {
        durations.sort_unstable();
        durations[durations.len() / 2]
    };
    let (before, after) = durations.split_at_mut(TROUBLE_AT as usize);
    let (before, after) = (median(before), median(after));
    assert!(after < 10 * before, "{before:?} before, {after:?} after");

    for (i, subscriber) in healthy.iter().enumerate() {
        assert_eq!(
            last_report(subscriber, &mut outlet),
            format!("END received {MESSAGES} next {MESSAGES} out_of_order 0"),
            "healthy {i}"
        );
    }
    println!("{counts:?}, publish {before:?} before, {after:?} after (median)");
}

/// What a subscriber has heard, which it says when it hears the end.
fn last_report(subscriber: &Subscriber, outlet: &mut Outlet<Float64MultiArray>) -> String {
    let deadline = Instant::now() + Duration::from_secs(30);
    loop {
        assert!(Instant::now() < deadline, "a subscriber does not report: {:?}", outlet.counts());
        let _ = outlet.publish(number(END));
        if let Some(line) = subscriber.line_with("END") {
            return line;
        }
        thread::sleep(Duration::from_millis(5));
    }
}

#[test]
fn a_subscriber_that_comes_late_interrupts_nobody() {
    const WINDOW: u32 = 512;
    const PERIOD: Duration = Duration::from_millis(1);

    let domain = domain(1);
    let healthy = Subscriber::start(domain, "healthy");
    let participant =
        Participant::join(network(domain), "/", "publisher", NodeOptions::new()).unwrap();
    let mut outlet =
        Outlet::<Float64MultiArray>::new(&participant, TOPIC, &Qos::reliable(10).window(WINDOW))
            .unwrap();
    let patience = Duration::from_secs(30);
    assert_eq!(outlet.wait_for_subscribers(1, patience), 1, "the healthy one was not found");
    let mut next = 0_u64;
    let mut publish = |outlet: &mut Outlet<Float64MultiArray>| {
        thread::sleep(PERIOD);
        assert_ne!(outlet.publish(number(next as f64)), Published::Refused, "message {next}");
        next += 1;
        next
    };
    // Any number of samples may have gone before it comes, more than the window above all.
    let mut late = Vec::new();
    for several_windows in [3, 1, 4] {
        for _ in 0..several_windows * WINDOW + WINDOW / 3 {
            publish(&mut outlet);
        }
        let joining = Subscriber::start(domain, &format!("late_{several_windows}"));
        let deadline = Instant::now() + patience;
        let first = loop {
            assert!(Instant::now() < deadline, "the late one hears nothing");
            publish(&mut outlet);
            if let Some(line) = joining.line_with("FIRST ") {
                break line["FIRST ".len()..].parse::<u64>().expect("a number");
            }
        };
        late.push((joining, first));
    }
    let sent = publish(&mut outlet);
    assert!(outlet.settle(Duration::from_secs(1)), "messages still held");
    let counts = outlet.counts();
    assert_eq!((counts.sent, counts.refused, counts.recreated), (sent, 0, 0), "{counts:?}");

    for (subscriber, first) in std::iter::once(&(healthy, 0)).chain(&late) {
        // The first sample of a late one is not number 0.
        let out_of_order = u64::from(*first > 0);
        assert_eq!(
            last_report(subscriber, &mut outlet),
            format!("END received {} next {sent} out_of_order {out_of_order}", sent - first),
            "who came at {first}"
        );
    }
    println!("{counts:?}");
}

#[test]
fn a_patient_outlet_keeps_the_order_for_one_that_lags() {
    const WINDOW: u32 = 4096;
    const MESSAGES: u64 = WINDOW as u64;

    let domain = domain(2);
    let (slow, healthy) = (Subscriber::start(domain, "slow"), Subscriber::start(domain, "healthy"));
    let (_participant, mut outlet) = patient_outlet(domain, WINDOW);
    let limit = Duration::from_secs(30);
    assert_eq!(outlet.wait_for_subscribers(2, limit), 2, "subscribers were not found");
    assert_eq!(outlet.publish(number(0.0)), Published::Sent);
    let deadline = Instant::now() + limit;
    for subscriber in [&slow, &healthy] {
        while subscriber.line_with("FIRST 0").is_none() {
            assert!(Instant::now() < deadline, "a subscriber hears nothing");
            thread::sleep(Duration::from_millis(5));
        }
    }

    // Fast, like a stage in lockstep, until the next writer is to publish.
    let mut numbers = 1_u64..;
    let mut publish = |outlet: &mut Outlet<Float64MultiArray>| {
        thread::sleep(Duration::from_micros(100));
        outlet.publish(number(numbers.next().expect("endless") as f64))
    };
    let mut frozen = None;
    loop {
        match publish(&mut outlet) {
            Published::Sent => {}
            Published::Held => break,
            Published::Refused => panic!("a message was refused"),
        }
        if frozen.is_none() && outlet.counts().sent == MESSAGES / 2 - 256 {
            // Shortly before the change: a busy machine must not make the pause too long.
            slow.signal(libc::SIGSTOP);
            frozen = Some(Instant::now());
        }
    }
    // Longer than the two heartbeats that everybody gets, shorter than a healthy one may take.
    while frozen.expect("frozen").elapsed() < Duration::from_millis(600) {
        outlet.settle(Duration::from_millis(5));
    }
    slow.signal(libc::SIGCONT);
    assert!(outlet.settle(limit), "messages still held");
    let enough = outlet.counts().sent + MESSAGES / 4;
    while outlet.counts().sent < enough {
        assert_ne!(publish(&mut outlet), Published::Refused);
        assert!(outlet.settle(limit), "messages still held");
    }
    let counts = outlet.counts();
    let sent = counts.sent;
    assert_eq!((counts.refused, counts.recreated), (0, 0), "{counts:?}");
    assert!(counts.renewed > 0, "{counts:?}");
    for subscriber in [&slow, &healthy] {
        assert_eq!(
            last_report(subscriber, &mut outlet),
            format!("END received {sent} next {sent} out_of_order 0")
        );
    }
}

#[test]
fn a_planned_change_waits_for_a_healthy_subscriber_that_lags() {
    const WINDOW: u32 = 4096;

    let domain = domain(3);
    let subscriber = Subscriber::start(domain, "lagging");
    let (_participant, mut outlet) = patient_outlet(domain, WINDOW);
    let limit = Duration::from_secs(30);
    assert_eq!(outlet.wait_for_subscribers(1, limit), 1, "the subscriber was not found");
    let mut next = 0_u64;
    // Whether so many were sent; a change under way refuses what it cannot hold.
    let mut publish_until = |outlet: &mut Outlet<Float64MultiArray>, sent: u64, pause: Duration| {
        while outlet.counts().sent < sent {
            if outlet.publish(number(next as f64)) == Published::Refused {
                return false;
            }
            next += 1;
            thread::sleep(pause);
        }
        true
    };
    // No faster than it acknowledges and than a successor is made: beyond half of the window a
    // change is planned.
    let pause = Duration::from_micros(300);
    assert!(publish_until(&mut outlet, u64::from(WINDOW / 4), pause));
    subscriber.signal(libc::SIGSTOP);
    let frozen = Instant::now();
    let all_sent = publish_until(&mut outlet, u64::from(5 * WINDOW / 8), pause);
    let (renewed, within) = (outlet.counts().renewed, frozen.elapsed());
    subscriber.signal(libc::SIGCONT);
    // Later it counts as stopped, and the change does not wait for it.
    if within < Duration::from_secs(2) {
        assert!(all_sent && renewed == 0, "{:?} within {within:?}", outlet.counts());
    }

    let deadline = Instant::now() + limit;
    while outlet.counts().renewed == 0 {
        assert!(Instant::now() < deadline, "{:?}", outlet.counts());
        let enough = outlet.counts().sent + 1;
        if !publish_until(&mut outlet, enough, Duration::from_millis(1)) {
            thread::sleep(Duration::from_millis(1));
        }
    }
    assert!(outlet.settle(limit), "messages still held");
    let sent = outlet.counts().sent;
    assert_eq!(
        last_report(&subscriber, &mut outlet),
        format!("END received {sent} next {sent} out_of_order 0")
    );
}

#[test]
fn a_publisher_that_keeps_the_pace_leaves_no_subscriber_far_behind() {
    const MESSAGES: u64 = 20_000;
    const FAR: u64 = 128;

    let domain = domain(4);
    let subscriber = Subscriber::start(domain, "busy");
    let (participant, mut outlet) = patient_outlet(domain, SAMPLES.window);
    let limit = Duration::from_secs(30);
    assert_eq!(outlet.wait_for_subscribers(1, limit), 1, "the subscriber was not found");
    let writer = rustdds::GUID::from_bytes(outlet.writer());
    // Who has not acknowledged anything yet is not waited for, as it may be frozen.
    assert_eq!(outlet.publish(number(0.0)), Published::Sent);
    let deadline = Instant::now() + limit;
    while participant.watch().lag(writer, 1, limit).any {
        assert!(Instant::now() < deadline, "the subscriber acknowledges nothing");
        thread::sleep(Duration::from_millis(1));
    }
    let mut stopped_since = None;
    let mut far = 0;
    for k in 1..MESSAGES {
        // Like a program on a busy machine: it does not run for 0.2 s, again and again.
        let pause = Duration::from_millis(200);
        match stopped_since {
            None if k % (MESSAGES / 10) == MESSAGES / 20 => {
                subscriber.signal(libc::SIGSTOP);
                stopped_since = Some(Instant::now());
            }
            Some(since) if since.elapsed() >= pause => {
                subscriber.signal(libc::SIGCONT);
                stopped_since = None;
            }
            _ => {}
        }
        assert_eq!(outlet.publish(number(k as f64)), Published::Sent, "message {k}");
        let wait = stopped_since.map_or(limit, |since| pause.saturating_sub(since.elapsed()));
        outlet.keep_pace(Instant::now() + wait);
        let lag = participant.watch().lag(writer, outlet.counts().sent, limit);
        far += u64::from(lag.healthy > FAR + 1);
    }
    subscriber.signal(libc::SIGCONT);
    assert_eq!(outlet.counts().renewed, 0);
    // A few where the machine stops it for longer than a subscriber is waited for.
    assert!(far < MESSAGES / 10, "{far} of {MESSAGES} messages found it far behind");
    assert_eq!(
        last_report(&subscriber, &mut outlet),
        format!("END received {MESSAGES} next {MESSAGES} out_of_order 0")
    );
}

#[test]
fn what_a_patient_outlet_holds_is_sent_without_a_further_message() {
    let domain = domain(5);
    let subscriber = Subscriber::start(domain, "subscriber");
    let (_participant, mut outlet) = patient_outlet(domain, 64);
    let limit = Duration::from_secs(30);
    assert_eq!(outlet.wait_for_subscribers(1, limit), 1, "the subscriber was not found");
    let deadline = Instant::now() + limit;
    assert_ne!(outlet.publish(number(0.0)), Published::Refused);
    while subscriber.line_with("FIRST").is_none() {
        assert!(Instant::now() < deadline, "the subscriber hears nothing");
        thread::sleep(Duration::from_millis(1));
    }
    subscriber.signal(libc::SIGSTOP);
    while outlet.publish(number(1.0)) != Published::Held {
        assert_eq!(outlet.held_until(), None);
        assert!(Instant::now() < deadline, "nothing is held: {:?}", outlet.counts());
        thread::sleep(Duration::from_millis(1));
    }
    while let Some(until) = outlet.held_until() {
        assert!(Instant::now() < deadline, "it is held: {:?}", outlet.counts());
        thread::sleep(until.saturating_duration_since(Instant::now()));
        outlet.settle(Duration::ZERO);
    }
    let counts = outlet.counts();
    assert_eq!((counts.refused, counts.renewed, counts.most_held), (0, 1, 1), "{counts:?}");
    drop(subscriber);
}

/// What a participant that comes now hears of the publishers of others, when it has heard `enough`.
fn publishers_of_nodes(domain: u16, enough: impl Fn(&[Vec<u8>]) -> bool) -> Vec<Vec<u8>> {
    use ros2_client::builtin_topics::ros_discovery::{QOS_PUB, TOPIC_NAME, TYPE_NAME};
    use ros2_client::entities_info::ParticipantEntitiesInfo;

    let observer = Participant::join(network(domain), "/", "observer", NodeOptions::new()).unwrap();
    let participant = observer.domain_participant();
    let topic = participant
        .create_topic(TOPIC_NAME.into(), TYPE_NAME.into(), &QOS_PUB, rustdds::TopicKind::NoKey)
        .unwrap();
    let subscriber = participant.create_subscriber(&QOS_PUB).unwrap();
    let mut reader =
        subscriber.create_datareader_no_key_cdr::<ParticipantEntitiesInfo>(&topic, None).unwrap();
    let deadline = Instant::now() + Duration::from_secs(30);
    let mut last = Vec::new();
    loop {
        while let Ok(Some(sample)) = reader.take_next_sample() {
            let info = serde_json::to_value(sample.value()).unwrap();
            if info["node_entities_info_seq"][0]["node_name"] == "publisher" {
                let writers = info["node_entities_info_seq"][0]["writer_gid_seq"].clone();
                last = serde_json::from_value(writers).unwrap();
            }
        }
        if enough(&last) {
            return last;
        }
        assert!(Instant::now() < deadline, "heard at last: {last:?}");
        thread::sleep(Duration::from_millis(10));
    }
}

#[test]
fn a_node_lists_its_publishers_of_now_however_often_they_were_replaced() {
    let domain = domain(6);
    let participant =
        Participant::join(network(domain), "/", "publisher", NodeOptions::new()).unwrap();
    let qos = Qos::reliable(10).window(64);
    let mut outlet = Outlet::<Float64MultiArray>::new(&participant, TOPIC, &qos).unwrap();
    let first = publishers_of_nodes(domain, |writers| !writers.is_empty());
    let deadline = Instant::now() + Duration::from_secs(90);
    while outlet.counts().renewed < 50 {
        assert!(Instant::now() < deadline, "{:?}", outlet.counts());
        assert_ne!(outlet.publish(number(0.0)), Published::Refused);
        thread::sleep(Duration::from_micros(100));
    }
    let is_first = first.contains(&outlet.writer().to_vec());
    assert!(!is_first, "{first:?}");
    // Those before it are kept for slow subscribers, for half a minute.
    while outlet.counts().renewed < 60 && outlet.replaced() > 0 {
        assert!(Instant::now() < deadline, "{:?}", outlet.counts());
        assert_ne!(outlet.publish(number(0.0)), Published::Refused);
        thread::sleep(Duration::from_millis(1500));
    }
    let current = outlet.writer().to_vec();
    let last = publishers_of_nodes(domain, |writers| {
        writers.len() == first.len() && writers.contains(&current)
    });
    let others = |writers: &[Vec<u8>]| writers.iter().filter(|w| first.contains(w)).count();
    assert_eq!(others(&last), first.len() - 1, "{first:?} {last:?}");
}

#[test]
fn an_outlet_refuses_a_latched_profile() {
    let domain = domain(7);
    let participant =
        Participant::join(network(domain), "/", "latched", NodeOptions::new()).unwrap();
    let Err(error) = Outlet::<Float64MultiArray>::new(&participant, TOPIC, &Qos::latched(1)) else {
        panic!("a latched outlet was made");
    };
    assert!(error.to_string().contains("volatile"), "{error}");
}
