//! A frozen and a killed subscriber neither stall the publisher nor starve the healthy ones.
//!
//! Subscribers are processes of their own: this test program, started again for the test
//! `subscriber_process` with a role in the environment. Each prints a line per event.

use std::{
    io::{BufRead, BufReader},
    process::{Child, Command, Stdio},
    sync::mpsc::{Receiver, channel},
    thread,
    time::{Duration, Instant},
};

use friction_stage::node::{
    outlet::{Outlet, Published},
    participant::{Network, Participant, Reach},
    qos::Qos,
};
use friction_stage_data::message::Float64MultiArray;
use futures::{StreamExt, executor::block_on};
use ros2_client::{NodeOptions, Subscription};

const TOPIC: &str = "/numbers";
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

fn number(value: f64) -> Float64MultiArray {
    Float64MultiArray { data: vec![value; 10], ..Float64MultiArray::default() }
}

#[test]
fn healthy_subscribers_lose_nothing_when_others_freeze_or_die() {
    const MESSAGES: u64 = 5000;
    const TROUBLE_AT: u64 = 1000;
    const WINDOW: u32 = 512;
    let period = Duration::from_millis(1);

    // Of its own among the domains whose ports lie below the ephemeral ones.
    let domain = 1 + u16::try_from(std::process::id() % 100).expect("below 100");
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
    // About (5000 - 1000) / 512 windows were filled by the two that do not acknowledge.
    assert!(
        (4..=8).contains(&counts.recreated),
        "the window of {WINDOW} was filled about 7 times: {counts:?}"
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
        let deadline = Instant::now() + Duration::from_secs(10);
        let report = loop {
            assert!(Instant::now() < deadline, "healthy {i} does not report");
            let _ = outlet.publish(number(END));
            if let Some(line) = subscriber.line_with("END") {
                break line;
            }
            thread::sleep(Duration::from_millis(5));
        };
        assert_eq!(
            report,
            format!("END received {MESSAGES} next {MESSAGES} out_of_order 0"),
            "healthy {i}"
        );
    }
    println!("{counts:?}, publish {before:?} before, {after:?} after (median)");
}

#[test]
fn an_outlet_refuses_a_latched_profile() {
    let domain = 101;
    let participant =
        Participant::join(network(domain), "/", "latched", NodeOptions::new()).unwrap();
    let Err(error) = Outlet::<Float64MultiArray>::new(&participant, TOPIC, &Qos::latched(1)) else {
        panic!("a latched outlet was made");
    };
    assert!(error.to_string().contains("volatile"), "{error}");
}
