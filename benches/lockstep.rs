//! Lockstep over ROS 2: cycles per second of a bare ros2-client ping-pong with the messages, the
//! quality of service and the process layout of the stage and its controller, nothing computed.
//! What this reaches is the limit for the real nodes.
//!
//! Two child processes per layout, on a domain of their own, loopback only:
//! - stage: publishes the sample (JointState, WrenchStamped, StageState, Clock), waits for the
//!   force (WrenchStamped) with the stamp of the sample;
//! - controller: waits for the sample, answers it, publishes ControllerState.
//!
//! Between them run the real nodes, `friction-stage stage-node` and `controller-node`, with and
//! without a recording. Their share of the bare layout on the same cores stands below the table.
//!
//! `cargo bench --bench lockstep -- [--seconds S] [--rounds N] [--only TEXT] [--list]`
//! runs every layout (whose name contains TEXT) N times in turn, S seconds each, and prints
//! medians over the rounds. `--only '*'` takes the short list: the real nodes and what they are
//! compared with.

use std::{
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, ExitCode, Stdio},
    task::Poll,
    thread,
    time::{Duration, Instant},
};

use friction_stage::node::{
    driver::{Driver, LockstepRun},
    inlet::Inlet,
    outlet::{Outlet, Published},
    participant::{Network, Participant, Reach},
    qos::{CLOCK, COMMANDS, Qos, SAMPLES},
    waiter::Waiter,
};
use friction_stage_core::control::Point;
use friction_stage_data::message::{
    Clock, ControllerState, Header, JointState, RosMessage, StageState, Time, WrenchStamped,
};
use futures::executor::block_on;
use ros2_client::{NodeOptions, Publisher, Subscription};
use rustdds::mio1;

/// When the stage publishes what besides the sample itself.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Order {
    /// Sample, clock, force cell, state; then wait.
    SampleFirst,
    /// Force cell, state, clock, sample; then wait.
    SampleLast,
    /// Sample, clock; wait; then force cell and state of that sample.
    RestAfterAnswer,
}

/// How a thread waits for a message.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Wait {
    /// Parked, woken through the subscription's waker (`node::inlet`).
    Park,
    /// In the poll of mio.
    Mio,
    /// Asking again and again, giving the core away in between.
    Yield,
}

/// How the stage receives ControllerState, to record it.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Records {
    No,
    /// A thread that every message wakes.
    Woken,
    /// A thread that takes what has come every 20 ms.
    Drained,
    /// The same, best effort: nothing is acknowledged.
    DrainedBestEffort,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Cores {
    Free,
    /// Both processes on core 0.
    One,
    /// Stage on core 0, controller on core 1.
    OneEach,
}

/// One way to lay the two processes out.
#[derive(Clone, Copy)]
struct Layout {
    name: &'static str,
    clock: bool,
    cell: bool,
    state: bool,
    controller_state: bool,
    order: Order,
    wait: Wait,
    cores: Cores,
    /// Through `node::outlet` instead of ros2-client's publisher.
    outlets: bool,
    /// Subscriptions that the stage waits for at once (the force and idle ones).
    listens: usize,
    records: Records,
    /// Both processes run ros2-client's spinner, which subscribes to `/clock`.
    spinner: bool,
}

/// What the real nodes publish in every cycle.
const FULL: Layout = Layout {
    name: "full",
    clock: true,
    cell: true,
    state: true,
    controller_state: true,
    order: Order::SampleFirst,
    wait: Wait::Park,
    cores: Cores::Free,
    outlets: false,
    listens: 1,
    records: Records::No,
    spinner: false,
};
const SAMPLE_ONLY: Layout = Layout {
    name: "sample only",
    clock: false,
    cell: false,
    state: false,
    controller_state: false,
    ..FULL
};

/// The two nodes as users start them.
struct Real {
    name: &'static str,
    /// The bare layout that it is compared with.
    bare: &'static str,
    /// Least share of the bare layout's cycles per second.
    wanted: f64,
    cores: Cores,
    recorded: bool,
}

const REALS: &[Real] = &[
    Real { name: "real nodes", bare: "full", wanted: 0.8, cores: Cores::Free, recorded: false },
    Real {
        name: "real nodes, recorded",
        bare: "real nodes",
        wanted: 0.95,
        cores: Cores::Free,
        recorded: true,
    },
    Real {
        name: "real nodes, one core",
        bare: "full, one core",
        wanted: 0.8,
        cores: Cores::One,
        recorded: false,
    },
    Real {
        name: "real nodes, one core, recorded",
        bare: "real nodes, one core",
        wanted: 0.95,
        cores: Cores::One,
        recorded: true,
    },
];

/// The first is the reference of the ratios.
const LAYOUTS: &[Layout] = &[
    FULL,
    Layout { name: "full, sample last", order: Order::SampleLast, ..FULL },
    Layout { name: "full, rest after answer", order: Order::RestAfterAnswer, ..FULL },
    Layout { name: "full, mio", wait: Wait::Mio, ..FULL },
    Layout { name: "full, yield", wait: Wait::Yield, ..FULL },
    Layout { name: "full, one core", cores: Cores::One, ..FULL },
    Layout {
        name: "full, one core, rest after answer",
        cores: Cores::One,
        order: Order::RestAfterAnswer,
        ..FULL
    },
    Layout { name: "full, one core, mio", cores: Cores::One, wait: Wait::Mio, ..FULL },
    Layout { name: "full, one core, yield", cores: Cores::One, wait: Wait::Yield, ..FULL },
    Layout { name: "full, one core each", cores: Cores::OneEach, ..FULL },
    Layout { name: "full, outlets", outlets: true, ..FULL },
    Layout { name: "full, one core, outlets", cores: Cores::One, outlets: true, ..FULL },
    Layout { name: "full, listens to 4", listens: 4, ..FULL },
    Layout { name: "full, recorded, woken", records: Records::Woken, ..FULL },
    Layout { name: "full, recorded, drained", records: Records::Drained, ..FULL },
    Layout {
        name: "full, recorded, drained, best effort",
        records: Records::DrainedBestEffort,
        ..FULL
    },
    Layout {
        name: "full, one core, recorded, drained, best effort",
        records: Records::DrainedBestEffort,
        cores: Cores::One,
        ..FULL
    },
    Layout { name: "full, spinner", spinner: true, ..FULL },
    Layout { name: "full, no clock", clock: false, ..FULL },
    Layout {
        name: "full, one core, outlets, listens to 4, drained",
        cores: Cores::One,
        outlets: true,
        listens: 4,
        records: Records::Drained,
        ..FULL
    },
    SAMPLE_ONLY,
    Layout { name: "sample + clock", clock: true, ..SAMPLE_ONLY },
    Layout { name: "sample + cell", cell: true, ..SAMPLE_ONLY },
    Layout { name: "sample + state", state: true, ..SAMPLE_ONLY },
    Layout { name: "sample + controller state", controller_state: true, ..SAMPLE_ONLY },
    Layout { name: "one core, sample only", cores: Cores::One, ..SAMPLE_ONLY },
    Layout { name: "one core, sample + clock", cores: Cores::One, clock: true, ..SAMPLE_ONLY },
    Layout { name: "one core, sample + cell", cores: Cores::One, cell: true, ..SAMPLE_ONLY },
    Layout { name: "one core, sample + state", cores: Cores::One, state: true, ..SAMPLE_ONLY },
    Layout {
        name: "one core, sample + controller state",
        cores: Cores::One,
        controller_state: true,
        ..SAMPLE_ONLY
    },
    Layout {
        name: "one core, sample only, listens to 4",
        cores: Cores::One,
        listens: 4,
        ..SAMPLE_ONLY
    },
];

const CYCLES_BEFORE_MEASURING: u64 = 2000;
/// Simulated time of a cycle, ns.
const PERIOD: i64 = 250_000;

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    match words[..] {
        ["stage", layout, domain, seconds] => {
            stage(&find(layout), network(domain), seconds.parse().expect("seconds"))
        }
        ["controller", layout, domain] => controller(&find(layout), network(domain)),
        _ => return drive(&words),
    }
    ExitCode::SUCCESS
}

fn find(name: &str) -> Layout {
    *LAYOUTS.iter().find(|layout| layout.name == name).expect("a layout")
}

fn network(domain: &str) -> Network {
    Network { domain: domain.parse().expect("a domain"), reach: Reach::Localhost }
}

// ---------------------------------------------------------------------------------------------
// The driver

struct Figures {
    cycles_per_second: f64,
    /// The rest is NaN where it is not known: of the real nodes.
    median_us: f64,
    p99_us: f64,
    cpu_us: f64,
}

enum Contender {
    Bare(&'static Layout),
    Real(&'static Real),
}

impl Contender {
    fn all() -> Vec<Self> {
        LAYOUTS.iter().map(Self::Bare).chain(REALS.iter().map(Self::Real)).collect()
    }

    fn name(&self) -> &'static str {
        match self {
            Self::Bare(layout) => layout.name,
            Self::Real(real) => real.name,
        }
    }

    fn is_wanted(&self, only: &str) -> bool {
        let name = self.name();
        match only {
            "*" => REALS.iter().any(|real| name == real.name || name == real.bare),
            text => name.contains(text),
        }
    }

    fn run(&self, domain: u16, seconds: f64) -> Result<Figures, String> {
        match self {
            Self::Bare(layout) => run_bare(layout, domain, seconds),
            Self::Real(real) => run_real(real, domain, seconds).map_err(|e| format!("{e:#}")),
        }
    }
}

fn drive(words: &[&str]) -> ExitCode {
    let (mut seconds, mut rounds, mut only) = (2.0_f64, 3_usize, String::new());
    let mut rest = words.iter();
    while let Some(word) = rest.next() {
        let mut value = || rest.next().copied().unwrap_or_default();
        match *word {
            "--seconds" => seconds = value().parse().expect("--seconds wants a number"),
            "--rounds" => rounds = value().parse().expect("--rounds wants a number"),
            "--only" => only = value().to_owned(),
            "--list" => {
                Contender::all().iter().for_each(|contender| println!("{}", contender.name()));
                return ExitCode::SUCCESS;
            }
            other => {
                eprintln!("unknown argument {other}: known are --seconds --rounds --only --list");
                return ExitCode::from(2);
            }
        }
    }
    let mut contenders = Contender::all();
    contenders.retain(|contender| contender.is_wanted(&only));
    let mut results: Vec<Vec<Figures>> = contenders.iter().map(|_| Vec::new()).collect();
    let mut runs = std::process::id();
    for round in 0..rounds {
        for (contender, results) in contenders.iter().zip(&mut results) {
            // Another domain each time: no peer sees what is left of the run before.
            let domain = 1 + u16::try_from(runs % 100).expect("below 100");
            runs += 1;
            match contender.run(domain, seconds) {
                Ok(figures) => results.push(figures),
                Err(reason) => eprintln!("{}: {reason}", contender.name()),
            }
        }
        eprintln!("round {} of {rounds} done", round + 1);
    }
    println!(
        "{:<52} {:>9} {:>6} {:>8} {:>8} {:>8}",
        "layout", "cycles/s", "ratio", "p50 us", "p99 us", "cpu us"
    );
    let reference = median(results.first().map_or(&[][..], |first| first), |f| f.cycles_per_second);
    for (contender, results) in contenders.iter().zip(&results) {
        let cycles = median(results, |f| f.cycles_per_second);
        println!(
            "{:<52} {:>9.0} {:>6.2} {:>8.1} {:>8.1} {:>8.1}",
            contender.name(),
            cycles,
            cycles / reference,
            median(results, |f| f.median_us),
            median(results, |f| f.p99_us),
            median(results, |f| f.cpu_us)
        );
    }
    // Share by round, because both sides of it then ran under the same load; then the median.
    let find = |name: &str| contenders.iter().position(|contender| contender.name() == name);
    for real in REALS {
        let (Some(it), Some(bare)) = (find(real.name), find(real.bare)) else { continue };
        let pairs = results[it].iter().zip(&results[bare]);
        let mut shares: Vec<f64> =
            pairs.map(|(it, bare)| it.cycles_per_second / bare.cycles_per_second).collect();
        shares.sort_unstable_by(f64::total_cmp);
        let share = shares.get(shares.len() / 2).copied().unwrap_or(f64::NAN);
        println!(
            "{}: {:.0} % of {} (wanted: {:.0} %)",
            real.name,
            100.0 * share,
            real.bare,
            100.0 * real.wanted
        );
    }
    ExitCode::SUCCESS
}

fn median(figures: &[Figures], of: impl Fn(&Figures) -> f64) -> f64 {
    let mut values: Vec<f64> = figures.iter().map(of).collect();
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Ends the process that it holds.
struct Process(Child);

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

impl Process {
    fn start(arguments: &[&str]) -> Result<Self, String> {
        Command::new(std::env::current_exe().map_err(|e| e.to_string())?)
            .args(arguments)
            .stdout(Stdio::piped())
            .spawn()
            .map(Process)
            .map_err(|e| e.to_string())
    }
}

fn run_bare(layout: &Layout, domain: u16, seconds: f64) -> Result<Figures, String> {
    let domain = domain.to_string();
    let controller = Process::start(&["controller", layout.name, &domain])?;
    let mut stage = Process::start(&["stage", layout.name, &domain, &seconds.to_string()])?;
    let stdout = stage.0.stdout.take().ok_or("no pipe")?;
    let line = BufReader::new(stdout)
        .lines()
        .map_while(Result::ok)
        .find(|line| line.starts_with("figures "))
        .ok_or("the stage ended without figures")?;
    let controller_cpu = cpu_seconds(controller.0.id());
    let numbers: Vec<f64> = line.split(' ').skip(1).filter_map(|word| word.parse().ok()).collect();
    let [cycles_per_second, median_us, p99_us, stage_cpu, all_cycles] = numbers[..] else {
        return Err(format!("not five figures: {line}"));
    };
    let cpu_us = (stage_cpu + controller_cpu) / all_cycles * 1e6;
    Ok(Figures { cycles_per_second, median_us, p99_us, cpu_us })
}

/// A slow move, long enough to last `seconds` if the real nodes were as fast as the bare ones.
fn run_real(real: &Real, domain: u16, seconds: f64) -> anyhow::Result<Figures> {
    const FASTEST: f64 = 12_000.0;
    let directory = tempfile::tempdir()?;
    let parameters =
        |list: &[String]| list.iter().flat_map(|given| ["-p".to_owned(), given.clone()]).collect();
    let mut given = Vec::new();
    if real.cores == Cores::One {
        given.push("cpu:=0".to_owned());
    }
    let controller_arguments = parameters(&given);
    if real.recorded {
        given.push(format!("record:={}", directory.path().join("bag").display()));
    }
    let end = PERIOD * (seconds * FASTEST) as i64;
    let at = |time, position| Point { time, position, velocity: Some(0.0), ..Point::default() };
    let run = LockstepRun {
        stage_arguments: parameters(&given),
        controller_arguments,
        points: vec![at(0, 0.0), at(end, 0.05)],
        log_stem: directory.path().join("log"),
    };
    let program = Path::new(env!("CARGO_BIN_EXE_friction-stage"));
    let network = Network { domain, reach: Reach::Localhost };
    let result = Driver::new(program, network)?.run(&run, &mut |_| {})?;
    Ok(Figures {
        cycles_per_second: result.rate,
        median_us: f64::NAN,
        p99_us: f64::NAN,
        cpu_us: f64::NAN,
    })
}

/// Processor time that a process has used, s; NaN when /proc does not say.
fn cpu_seconds(pid: u32) -> f64 {
    let ticks = || {
        let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
        // utime and stime, fields 14 and 15; the name in parentheses may contain spaces.
        let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
        Some(fields.get(11)?.parse::<f64>().ok()? + fields.get(12)?.parse::<f64>().ok()?)
    };
    // SAFETY: sysconf only reads.
    ticks().map_or(f64::NAN, |ticks| ticks / unsafe { libc::sysconf(libc::_SC_CLK_TCK) } as f64)
}

// ---------------------------------------------------------------------------------------------
// The two processes

/// A publisher of either kind.
enum Out<M: RosMessage> {
    Off,
    Bare(Box<Publisher<M>>),
    Outlet(Box<Outlet<M>>),
}

impl<M: RosMessage> Out<M> {
    fn new(on: bool, layout: &Layout, participant: &Participant, name: &str, qos: &Qos) -> Self {
        if !on {
            Self::Off
        } else if layout.outlets {
            Self::Outlet(Box::new(Outlet::new(participant, name, qos).expect("an outlet")))
        } else {
            let topic = participant.topic(name, M::PACKAGE, M::NAME, qos).expect("a topic");
            Self::Bare(Box::new(
                participant.node().create_publisher(&topic, None).expect("a publisher"),
            ))
        }
    }

    fn publish(&mut self, message: impl FnOnce() -> M) {
        match self {
            Self::Off => {}
            Self::Bare(publisher) => {
                assert!(publisher.publish(message()).is_ok(), "the window is full")
            }
            Self::Outlet(outlet) => assert_eq!(outlet.publish(message()), Published::Sent),
        }
    }
}

/// Several subscriptions to `M`, of which the first brings the messages.
struct In<M: RosMessage> {
    subscriptions: Vec<Subscription<M>>,
    wait: Wait,
    waiter: Waiter,
    poll: mio1::Poll,
    events: mio1::Events,
}

impl<M: RosMessage> In<M> {
    fn new(
        layout: &Layout,
        participant: &Participant,
        name: &str,
        qos: &Qos,
        listens: usize,
    ) -> Self {
        let poll = mio1::Poll::new().expect("a poll");
        let subscriptions = (0..listens)
            .map(|i| {
                let name = if i == 0 { name.to_owned() } else { format!("{name}_idle_{i}") };
                let topic = participant.topic(&name, M::PACKAGE, M::NAME, qos).expect("a topic");
                let mut subscription = participant
                    .node()
                    .create_subscription::<M>(&topic, None)
                    .expect("a subscription");
                if layout.wait == Wait::Mio {
                    poll.registry()
                        .register(&mut subscription, mio1::Token(i), mio1::Interest::READABLE)
                        .expect("a registration");
                }
                subscription
            })
            .collect();
        Self {
            subscriptions,
            wait: layout.wait,
            waiter: Waiter::new(),
            poll,
            events: mio1::Events::with_capacity(8),
        }
    }

    /// The next message of any subscription, `None` at the deadline.
    fn next(&mut self, deadline: Option<Instant>) -> Option<M> {
        match self.wait {
            Wait::Park => {
                let subscriptions = &self.subscriptions;
                self.waiter.wait(deadline, |cx| {
                    for subscription in subscriptions {
                        let taken = std::pin::pin!(subscription.async_take());
                        if let Poll::Ready(taken) = taken.poll(cx) {
                            return Poll::Ready(taken.expect("a message").0);
                        }
                    }
                    Poll::Pending
                })
            }
            Wait::Mio => loop {
                // A take drains the notification, so no message is overlooked.
                for subscription in &self.subscriptions {
                    if let Some((message, _)) = subscription.take().expect("a message") {
                        return Some(message);
                    }
                }
                let left =
                    deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()));
                if left.is_some_and(|left| left.is_zero()) {
                    return None;
                }
                self.poll.poll(&mut self.events, left).expect("a poll");
            },
            Wait::Yield => loop {
                for subscription in &self.subscriptions {
                    if let Some((message, _)) = subscription.take().expect("a message") {
                        return Some(message);
                    }
                }
                if deadline.is_some_and(|deadline| Instant::now() >= deadline) {
                    return None;
                }
                thread::yield_now();
            },
        }
    }
}

fn join(name: &str, layout: &Layout, network: Network, core: Option<usize>) -> Participant {
    if let Some(core) = core {
        pin_to(core);
    }
    let participant =
        Participant::join(network, "/", name, NodeOptions::new()).expect("a participant");
    if layout.spinner {
        let spinner = participant.node().spinner().expect("a spinner");
        thread::spawn(move || block_on(spinner.spin()));
    }
    participant
}

/// This thread, and those that it starts, run on `core` only.
fn pin_to(core: usize) {
    // SAFETY: the set is local; the calls only write it and read it.
    let result = unsafe {
        let mut set = std::mem::zeroed::<libc::cpu_set_t>();
        libc::CPU_SET(core, &mut set);
        libc::sched_setaffinity(0, size_of::<libc::cpu_set_t>(), &raw const set)
    };
    assert_eq!(result, 0, "core {core}");
}

fn stage(layout: &Layout, network: Network, seconds: f64) {
    let core = (layout.cores != Cores::Free).then_some(0);
    let participant = join("stage", layout, network, core);
    let mut sample = Out::<JointState>::new(true, layout, &participant, "/stage/encoder", &SAMPLES);
    let mut clock = Out::<Clock>::new(layout.clock, layout, &participant, "/clock", &CLOCK);
    let mut cell =
        Out::<WrenchStamped>::new(layout.cell, layout, &participant, "/stage/force_cell", &SAMPLES);
    let mut state =
        Out::<StageState>::new(layout.state, layout, &participant, "/stage/state", &SAMPLES);
    let mut force =
        In::<WrenchStamped>::new(layout, &participant, "/stage/force", &COMMANDS, layout.listens);
    record(layout, &participant);

    let mut cycle = |k: u64, patience: Duration| -> bool {
        let stamp = PERIOD * i64::try_from(k).expect("a cycle");
        let header = || Header::new(stamp, "stage");
        let position = k as f64 * 1e-9;
        let send_sample = |sample: &mut Out<JointState>| {
            sample.publish(|| JointState {
                header: header(),
                name: vec!["stage".to_owned()],
                position: vec![position],
                velocity: vec![0.5],
                effort: vec![12.0],
            });
        };
        let send_clock =
            |clock: &mut Out<Clock>| clock.publish(|| Clock { clock: Time::from_nanos(stamp) });
        let mut send_rest = || {
            cell.publish(|| WrenchStamped::along_x(header(), 12.0));
            state.publish(|| StageState {
                header: header(),
                sample: k,
                position,
                velocity: 0.5,
                acceleration: 0.1,
                motor_force: 12.0,
                bristle_deflection: vec![1e-6; 4],
                guide_force: vec![-3.0; 4],
                effect_name: vec!["cogging".to_owned(), "cable_chain".to_owned()],
                effect_force: vec![0.1; 2],
            });
        };
        match layout.order {
            Order::SampleFirst => {
                send_sample(&mut sample);
                send_clock(&mut clock);
                send_rest();
            }
            Order::SampleLast => {
                send_rest();
                send_clock(&mut clock);
                send_sample(&mut sample);
            }
            Order::RestAfterAnswer => {
                send_sample(&mut sample);
                send_clock(&mut clock);
            }
        }
        let deadline = Instant::now() + patience;
        let answered = loop {
            match force.next(Some(deadline)) {
                Some(answer) if answer.header.stamp.to_nanos() == stamp => break true,
                Some(_) => {}
                None => break false,
            }
        };
        if layout.order == Order::RestAfterAnswer {
            send_rest();
        }
        answered
    };

    // The first samples find no controller, or one whose answers do not reach us yet.
    let mut k = 1;
    while !cycle(k, Duration::from_millis(20)) {
        k += 1;
        assert!(k < 500, "no answer from the controller within 10 s");
    }
    let first = k;
    while k < first + CYCLES_BEFORE_MEASURING {
        k += 1;
        assert!(cycle(k, Duration::from_secs(2)), "cycle {k} was not answered");
    }
    let mut periods = Vec::with_capacity(4_000_000);
    let start = Instant::now();
    let mut before = start;
    while before - start < Duration::from_secs_f64(seconds) {
        k += 1;
        assert!(cycle(k, Duration::from_secs(2)), "cycle {k} was not answered");
        let now = Instant::now();
        periods.push(now - before);
        before = now;
    }
    let elapsed = (before - start).as_secs_f64();
    let cycles = periods.len();
    periods.sort_unstable();
    let at = |part: usize| periods[cycles * part / 100].as_secs_f64() * 1e6;
    let cpu = cpu_seconds(std::process::id());
    println!("figures {} {} {} {cpu} {k}", cycles as f64 / elapsed, at(50), at(99));
}

/// Receives ControllerState as a recorder would, on a thread that ends with the process.
fn record(layout: &Layout, participant: &Participant) {
    let qos = match layout.records {
        Records::No => return,
        Records::Woken | Records::Drained => Qos::reliable(10_000),
        Records::DrainedBestEffort => Qos::best_effort(10_000),
    };
    let woken = layout.records == Records::Woken;
    let mut states =
        Inlet::<ControllerState>::new(participant, "/controller/state", &qos).expect("an inlet");
    thread::spawn(move || {
        let waiter = Waiter::new();
        let mut next = 0;
        let mut missing = 0;
        loop {
            if woken {
                waiter.wait(None, |cx| states.poll_take(cx));
                continue;
            }
            thread::sleep(Duration::from_millis(20));
            while let Some(state) = states.take().expect("a message") {
                missing += if next > 0 { state.sample.saturating_sub(next) } else { 0 };
                next = state.sample + 1;
            }
            if missing > 0 {
                eprintln!("{missing} of {next} states were not received");
                missing = 0;
            }
        }
    });
}

fn controller(layout: &Layout, network: Network) {
    let core = match layout.cores {
        Cores::Free => None,
        Cores::One => Some(0),
        Cores::OneEach => Some(1),
    };
    let participant = join("controller", layout, network, core);
    let mut force =
        Out::<WrenchStamped>::new(true, layout, &participant, "/stage/force", &COMMANDS);
    let mut state = Out::<ControllerState>::new(
        layout.controller_state,
        layout,
        &participant,
        "/controller/state",
        &SAMPLES,
    );
    let mut samples = In::<JointState>::new(layout, &participant, "/stage/encoder", &SAMPLES, 1);
    let mut k = 0;
    while let Some(sample) = samples.next(None) {
        k += 1;
        let header = sample.header;
        let state_header = header.clone();
        force.publish(|| WrenchStamped::along_x(header, 12.0));
        state.publish(|| ControllerState {
            header: state_header,
            sample: k,
            position: sample.position[0],
            output: 12.0,
            enabled: true,
            ..ControllerState::default()
        });
    }
}
