//! Recording of a run: its own thread between the node's loops and the bag.
//!
//! Samples come through a ring of fixed size, so that the loop that integrates neither waits nor
//! allocates; everything else comes as messages. The thread encodes and writes. A bag that cannot
//! be written any more (a full disk) is closed, the fault is reported, and the stage goes on.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc;
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use ros2_client::Gid;

use super::clock;
use super::cpu;
use super::inlet::Inlet;
use super::participant::{Network, Participant};
use super::qos::{CLOCK, COMMANDS, DIAGNOSTICS, Qos, SAMPLES};
use super::runtime::lock;
use super::wire::{StageNames, Tick};
use friction_stage_data::bag::{BagError, BagOptions, BagWriter, OfferedQos, Provenance, TopicId};
use friction_stage_data::message::{
    Clock, ControllerState, DiagnosticArray, Float64MultiArray, JointState, JointTrajectory,
    RosMessage, StageState, WrenchStamped,
};

/// Ticks that may wait for the recorder: 1.6 s at 10 kHz.
const RING: usize = 16_384;
/// Longest sleep of the recorder between two looks at the ring.
const NAP: Duration = Duration::from_millis(2);

/// Longest wait, when a bag is opened, for a controller that is there: discovery on one machine
/// takes 0.1 s.
const FIND: Duration = Duration::from_millis(300);
/// Longest wait, when a bag is closed, for the states of samples that the controller has answered.
const LAST_STATES: Duration = Duration::from_millis(50);
/// States of the controller that may wait for the recorder: 1 s at 10 kHz. Best effort, because an
/// acknowledgement of each costs the controller more than the state; what is missing is counted.
const HEARD: Qos = Qos::best_effort(10_000);

/// Absolute names of the topics in a bag.
#[derive(Clone, Debug)]
pub struct RecordedTopics {
    pub encoder: String,
    pub force_cell: String,
    pub state: String,
    pub clock: Option<String>,
    pub force: String,
    pub joint_commands: String,
    pub commands: String,
    pub setpoint: String,
    pub controller_state: String,
    pub diagnostics: String,
}

/// A message of another topic than the stage's samples.
#[derive(Clone, Debug)]
pub enum Heard {
    Force(WrenchStamped),
    JointCommands(JointState),
    Commands(Float64MultiArray),
    Setpoint(JointTrajectory),
    ControllerState(ControllerState),
    Diagnostics(DiagnosticArray),
}

enum Order {
    Start(PathBuf, mpsc::SyncSender<Result<(), String>>),
    Stop(mpsc::SyncSender<Result<Option<Written>, BagError>>),
}

/// What a finished bag holds.
#[derive(Clone, Debug)]
pub struct Written {
    pub directory: PathBuf,
    pub messages: u64,
}

/// What everybody may look at while the recorder runs.
#[derive(Debug, Default)]
pub struct RecorderStatus {
    /// A bag is open: ticks and messages are wanted.
    pub recording: AtomicBool,
    /// Ticks that found the ring full, and states of the controller that did not arrive.
    pub dropped: AtomicU64,
    /// Why the last bag was closed early.
    pub fault: Mutex<Option<String>>,
    /// Stamp of the last tick, ns: the time of messages without a stamp of their own.
    latest: std::sync::atomic::AtomicI64,
}

/// Starts and stops recordings and takes messages. Cheap to clone.
#[derive(Clone)]
pub struct RecorderHandle {
    orders: mpsc::Sender<Order>,
    /// Messages that wait for the recorder, which looks by itself: waking it on another processor
    /// for each would cost the loop more than the message.
    heard: Arc<Mutex<Vec<(i64, Heard)>>>,
    status: Arc<RecorderStatus>,
}

/// What a recorder needs to know before it starts.
#[derive(Clone, Debug)]
pub struct RecorderSetup {
    /// Namespace and name of the recorder's own node. It has a participant of its own, so that what
    /// it hears costs the stage's DDS threads nothing.
    pub namespace: String,
    pub node: String,
    /// Processor that the recorder keeps away from.
    pub busy_cpu: Option<usize>,
    pub topics: RecordedTopics,
    pub names: StageNames,
    pub provenance: Provenance,
    /// Time of messages without a stamp of their own that come before the first sample, ns.
    pub start: i64,
}

/// The recorder's thread; it ends, and closes its bag, when every handle and feed is gone.
pub struct Recorder {
    thread: JoinHandle<()>,
}

/// The end of the ring where a loop puts its ticks.
pub struct TickFeed {
    ring: rtrb::Producer<Tick>,
    status: Arc<RecorderStatus>,
}

impl TickFeed {
    /// Hands over a tick if a bag is open. Full ring: counts it as dropped.
    #[inline]
    pub fn offer(&mut self, tick: &Tick) {
        if self.status.recording.load(Ordering::Relaxed) && self.ring.push(*tick).is_err() {
            self.status.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// The same for a loop that may wait, because simulated time stands still meanwhile: never
    /// drops.
    #[inline]
    pub fn insist(&mut self, tick: &Tick) {
        while self.status.recording.load(Ordering::Relaxed) {
            if self.ring.push(*tick).is_ok() {
                return;
            }
            std::thread::sleep(Duration::from_micros(100));
        }
    }
}

impl RecorderHandle {
    /// Starts a bag in `directory`, which must not exist.
    pub fn start(&self, directory: &Path) -> Result<(), String> {
        let (reply, answer) = mpsc::sync_channel(1);
        let sent = self.orders.send(Order::Start(directory.to_owned(), reply));
        match sent.ok().and_then(|()| answer.recv().ok()) {
            Some(result) => result,
            None => Err("the recorder has ended".to_owned()),
        }
    }

    /// Closes the bag, if one is open, and says what it holds.
    pub fn stop(&self) -> Result<Option<Written>, String> {
        let (reply, answer) = mpsc::sync_channel(1);
        let sent = self.orders.send(Order::Stop(reply));
        match sent.ok().and_then(|()| answer.recv().ok()) {
            Some(result) => result.map_err(|error| error.to_string()),
            None => Err("the recorder has ended".to_owned()),
        }
    }

    pub fn is_recording(&self) -> bool {
        self.status.recording.load(Ordering::Relaxed)
    }

    pub fn status(&self) -> &RecorderStatus {
        &self.status
    }

    /// The same for longer than the handle lives.
    pub fn shared_status(&self) -> Arc<RecorderStatus> {
        self.status.clone()
    }

    /// Hands over a message if a bag is open. `stamp` in ns; 0 takes the time of the last sample.
    pub fn hear(&self, stamp: i64, message: impl FnOnce() -> Heard) {
        if self.is_recording() {
            let time = if stamp > 0 { stamp } else { self.status.latest.load(Ordering::Relaxed) };
            lock(&self.heard).push((time, message()));
        }
    }
}

impl Recorder {
    /// Starts the thread. From then on a file that reaches the size limit of the process
    /// (`ulimit -f`) is an error to report, as a full disk is, and not the end of the process.
    pub fn start(setup: RecorderSetup) -> std::io::Result<(Recorder, RecorderHandle, TickFeed)> {
        // SAFETY: a plain call; ignoring a signal needs no handler.
        unsafe { libc::signal(libc::SIGXFSZ, libc::SIG_IGN) };
        let (orders, inbox) = mpsc::channel();
        let (producer, consumer) = rtrb::RingBuffer::new(RING);
        let status = Arc::new(RecorderStatus::default());
        status.latest.store(setup.start, Ordering::Relaxed);
        let heard = Arc::new(Mutex::new(Vec::new()));
        let handle = RecorderHandle { orders, heard: heard.clone(), status: status.clone() };
        let mut work = Work {
            setup,
            ring: consumer,
            status: status.clone(),
            bag: None,
            controller: None,
            heard,
            answered: i64::MIN,
        };
        let thread = std::thread::Builder::new()
            .name("recorder".to_owned())
            .spawn(move || work.run(&inbox))?;
        Ok((Recorder { thread }, handle, TickFeed { ring: producer, status }))
    }

    /// Waits until the thread has closed its bag; drop every handle and feed before.
    pub fn join(self) {
        if self.thread.join().is_err() {
            tracing::error!(
                "the recorder ended by a panic; `friction-stage recover` makes its bag whole"
            );
        }
    }
}

struct Work {
    setup: RecorderSetup,
    ring: rtrb::Consumer<Tick>,
    status: Arc<RecorderStatus>,
    bag: Option<OpenBag>,
    controller: Option<Listener>,
    /// Messages that the loop handed over.
    heard: Arc<Mutex<Vec<(i64, Heard)>>>,
    /// Stamp of the last force, ns.
    answered: i64,
}

struct OpenBag {
    writer: BagWriter,
    encoder: TopicId,
    force_cell: TopicId,
    state: TopicId,
    clock: Option<TopicId>,
    force: TopicId,
    joint_commands: TopicId,
    commands: TopicId,
    setpoint: TopicId,
    controller_state: TopicId,
    diagnostics: TopicId,
}

impl OpenBag {
    fn create(
        directory: &Path,
        topics: &RecordedTopics,
        provenance: &Provenance,
    ) -> Result<OpenBag, BagError> {
        let options = BagOptions { provenance: Some(provenance.clone()), ..BagOptions::default() };
        let mut writer = BagWriter::create(directory, &options)?;
        fn add<M: RosMessage>(
            writer: &mut BagWriter,
            name: &str,
            qos: &Qos,
        ) -> Result<TopicId, BagError> {
            writer.add_topic::<M>(name, &OfferedQos::reliable(qos.depth))
        }
        Ok(OpenBag {
            encoder: add::<JointState>(&mut writer, &topics.encoder, &SAMPLES)?,
            force_cell: add::<WrenchStamped>(&mut writer, &topics.force_cell, &SAMPLES)?,
            state: add::<StageState>(&mut writer, &topics.state, &SAMPLES)?,
            clock: topics
                .clock
                .as_ref()
                .map(|name| add::<Clock>(&mut writer, name, &CLOCK))
                .transpose()?,
            force: add::<WrenchStamped>(&mut writer, &topics.force, &COMMANDS)?,
            joint_commands: add::<JointState>(&mut writer, &topics.joint_commands, &COMMANDS)?,
            commands: add::<Float64MultiArray>(&mut writer, &topics.commands, &COMMANDS)?,
            setpoint: add::<JointTrajectory>(&mut writer, &topics.setpoint, &COMMANDS)?,
            controller_state: add::<ControllerState>(
                &mut writer,
                &topics.controller_state,
                &SAMPLES,
            )?,
            diagnostics: add::<DiagnosticArray>(&mut writer, &topics.diagnostics, &DIAGNOSTICS)?,
            writer,
        })
    }

    fn write_tick(&mut self, tick: &Tick, names: &StageNames) -> Result<(), BagError> {
        let time = tick.stamp.max(0) as u64;
        self.writer.write(self.encoder, time, &tick.encoder(names))?;
        self.writer.write(self.force_cell, time, &tick.force_cell(names))?;
        self.writer.write(self.state, time, &tick.state(names))?;
        match self.clock {
            Some(clock) => self.writer.write(clock, time, &tick.clock()),
            None => Ok(()),
        }
    }

    fn write_heard(&mut self, time: i64, message: &Heard) -> Result<(), BagError> {
        let time = time.max(0) as u64;
        match message {
            Heard::Force(message) => self.writer.write(self.force, time, message),
            Heard::JointCommands(message) => self.writer.write(self.joint_commands, time, message),
            Heard::Commands(message) => self.writer.write(self.commands, time, message),
            Heard::Setpoint(message) => self.writer.write(self.setpoint, time, message),
            Heard::ControllerState(message) => {
                self.writer.write(self.controller_state, time, message)
            }
            Heard::Diagnostics(message) => self.writer.write(self.diagnostics, time, message),
        }
    }
}

impl Work {
    fn run(&mut self, inbox: &mpsc::Receiver<Order>) {
        if let Some(busy) = self.setup.busy_cpu
            && let Err(error) = cpu::avoid(busy)
        {
            tracing::warn!("the recorder stays on processor {busy}: {error}");
        }
        loop {
            let first = inbox.recv_timeout(NAP);
            let over = matches!(first, Err(mpsc::RecvTimeoutError::Disconnected));
            for order in first.into_iter().chain(inbox.try_iter()) {
                self.obey(order);
            }
            self.drain();
            if over {
                break;
            }
        }
        match self.close() {
            Ok(Some(written)) => {
                tracing::info!(
                    "recorded {} messages in {}",
                    written.messages,
                    written.directory.display()
                );
            }
            Ok(None) => {}
            Err(error) => tracing::error!("closing the bag: {error}"),
        }
    }

    fn obey(&mut self, order: Order) {
        match order {
            Order::Start(directory, reply) => {
                let result = self.open(&directory);
                let _ = reply.send(result);
            }
            Order::Stop(reply) => {
                self.drain();
                let result = self.close();
                let _ = reply.send(result);
            }
        }
    }

    fn open(&mut self, directory: &Path) -> Result<(), String> {
        if let Some(bag) = &self.bag {
            return Err(format!(
                "already recording to {}: stop that first",
                bag.writer.directory().display()
            ));
        }
        let bag = OpenBag::create(directory, &self.setup.topics, &self.setup.provenance)
            .map_err(|error| error.to_string())?;
        self.bag = Some(bag);
        *lock(&self.status.fault) = None;
        match Listener::start(&self.setup) {
            Ok(listener) => self.controller = Some(listener),
            Err(error) => tracing::error!(
                "{} will not be recorded: {error:#}",
                self.setup.topics.controller_state
            ),
        }
        self.status.recording.store(true, Ordering::Release);
        Ok(())
    }

    fn close(&mut self) -> Result<Option<Written>, BagError> {
        self.status.recording.store(false, Ordering::Release);
        self.drain();
        // The controller's last states come in a burst, a little after its last answer.
        let deadline = Instant::now() + LAST_STATES;
        while self.controller.as_ref().is_some_and(|listener| listener.stamp < self.answered)
            && Instant::now() < deadline
        {
            std::thread::sleep(NAP);
            self.drain();
        }
        self.controller = None;
        let Some(bag) = self.bag.take() else { return Ok(None) };
        let written = Written {
            directory: bag.writer.directory().to_owned(),
            messages: bag.writer.message_count(),
        };
        bag.writer.finish()?;
        Ok(Some(written))
    }

    /// Writes everything that waits: ticks and states of the controller.
    fn drain(&mut self) {
        while let Ok(tick) = self.ring.pop() {
            self.status.latest.store(tick.stamp, Ordering::Relaxed);
            self.write(|bag, names| bag.write_tick(&tick, names));
        }
        let heard = std::mem::take(&mut *lock(&self.heard));
        for (time, message) in heard {
            if let Heard::Force(force) = &message {
                self.answered = force.header.stamp.to_nanos();
            }
            self.write(|bag, _| bag.write_heard(time, &message));
        }
        while let Some((state, missing)) = self.controller.as_mut().and_then(Listener::take) {
            self.status.dropped.fetch_add(missing, Ordering::Relaxed);
            let time = state.header.stamp.to_nanos();
            self.write(|bag, _| bag.write_heard(time, &Heard::ControllerState(state)));
        }
        self.write(|bag, _| bag.writer.flush_if_due());
    }

    /// Does something to the open bag; one that fails is given up with a loud word.
    fn write(&mut self, action: impl FnOnce(&mut OpenBag, &StageNames) -> Result<(), BagError>) {
        let Some(bag) = &mut self.bag else { return };
        if let Err(error) = action(bag, &self.setup.names) {
            let directory = bag.writer.directory().display().to_string();
            tracing::error!(
                "recording ends: {error}. What was written until now is in {directory}; \
                 `friction-stage recover {directory}` makes it whole"
            );
            *lock(&self.status.fault) = Some(error.to_string());
            self.status.recording.store(false, Ordering::Release);
            // Dropping the writer would try the full disk again; its error has been told.
            self.bag = None;
            self.controller = None;
        }
    }
}

/// Hears the states of the controller while a bag is open; the recorder takes them when it looks.
struct Listener {
    inlet: Inlet<ControllerState>,
    /// Who sent the last state, and its number.
    last: Option<(Gid, i64)>,
    /// Stamp of the last state, ns.
    stamp: i64,
}

impl Listener {
    fn start(setup: &RecorderSetup) -> anyhow::Result<Listener> {
        let options =
            ros2_client::NodeOptions::new().start_parameter_services(false).enable_rosout(false);
        let participant = Participant::join(
            Network::from_environment()?,
            &setup.namespace,
            &setup.node,
            options,
        )?;
        let inlet =
            Inlet::<ControllerState>::new(&participant, &setup.topics.controller_state, &HEARD)?;
        participant.watch().wait_for_matches(inlet.guid(), 1, FIND);
        Ok(Listener { inlet, last: None, stamp: i64::MIN })
    }

    /// The next one that has come, and how many before it are missing.
    fn take(&mut self) -> Option<(ControllerState, u64)> {
        loop {
            match self.inlet.take_with_info() {
                Ok(None) => return None,
                Ok(Some((state, info))) => {
                    let (sender, number) = (info.publisher_gid(), info.sequence_number());
                    let missing = match self.last {
                        Some((last_sender, last)) if last_sender == sender => number - last - 1,
                        _ => 0,
                    };
                    self.last = Some((sender, number));
                    self.stamp = state.header.stamp.to_nanos();
                    return Some((state, u64::try_from(missing).unwrap_or(0)));
                }
                Err(error) => {
                    tracing::warn!("a state of the controller could not be read: {error}")
                }
            }
        }
    }
}

/// A directory for a recording that was asked for while running: `<name>_<date>` in `parent`, UTC.
pub fn dated_directory(parent: &Path, name: &str) -> PathBuf {
    let seconds = clock::system().div_euclid(1_000_000_000);
    let date = chrono::DateTime::from_timestamp(seconds, 0).unwrap_or_default();
    parent.join(format!("{name}_{}", date.format("%Y_%m_%d-%H_%M_%S")))
}
