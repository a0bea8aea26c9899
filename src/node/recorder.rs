//! Recording of a run: its own thread between the node's loops and the bag.
//!
//! Samples come through a ring of fixed size, so that the loop that integrates neither waits nor
//! allocates; everything else comes as messages. The thread encodes and writes. A bag that cannot
//! be written any more (a full disk) is closed, the fault is reported, and the stage goes on.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU64, Ordering};
use std::sync::mpsc;
use std::sync::{Arc, Mutex, OnceLock};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use ros2_client::Gid;

use super::cpu;
use super::inlet::Inlet;
use super::lock::lock;
use super::participant::{Network, Participant};
use super::qos::{CLOCK, COMMANDS, DIAGNOSTICS, Qos, SAMPLES};
use super::stage_status::StageStatus;
use super::wire::{StageNames, Tick};
use friction_stage_data::bag::{BagError, BagOptions, BagWriter, OfferedQos, TopicId};
use friction_stage_data::message::{
    Clock, ControllerState, DiagnosticArray, Float64MultiArray, JointState, JointTrajectory,
    RosMessage, StageState, WrenchStamped,
};

/// Ticks that may wait for the recorder: 1.6 s at 10 kHz.
const RING: usize = 16_384;
/// Messages that may wait for the recorder.
const MOST_HEARD: usize = 4 * RING;
/// Ticks that a loop which may wait lets the bag lag behind, those of the controller's states
/// included: what a killed process can lose is then a number of samples and not a matter of load.
const BACKLOG: i64 = 512;
/// Longest sleep of the recorder between two looks at the ring.
const NAP: Duration = Duration::from_millis(2);

/// Longest wait, when a bag is opened, for a controller that is there: discovery on one machine
/// takes 0.1 s.
const FIND: Duration = Duration::from_millis(300);
/// Longest wait for the first state of a controller that was found, while samples are published:
/// a state that it sends before it has found the recorder does not arrive.
const FIRST_STATE: Duration = Duration::from_secs(1);
/// A state whose stamp is further from the stage's time has the log time of its arrival, ns.
const NEAR: i64 = 10_000_000_000;
/// Longest wait without any news of the controller, when a bag is closed or time waits in lockstep,
/// for the states of samples that it has answered. A lost datagram is repeated within two
/// heartbeats of 100 ms; the rest is for a machine that is busy.
const LAST_STATES: Duration = Duration::from_secs(2);
/// States of the controller that may wait for the recorder: 1 s at 10 kHz, and many times what
/// lockstep lets wait.
const HEARD: Qos = Qos::reliable(10_000);

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
    /// Samples that it lacks.
    pub missing: u64,
}

impl std::fmt::Display for Written {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{} messages in {}", self.messages, self.directory.display())?;
        match self.missing {
            0 => Ok(()),
            missing => write!(f, "; {missing} samples are missing"),
        }
    }
}

/// What everybody may look at while the recorder runs.
#[derive(Debug, Default)]
pub struct RecorderStatus {
    /// A bag is open: ticks and messages are wanted.
    pub recording: AtomicBool,
    /// Samples that the recordings lack, since the start of the node: ticks for which there was no
    /// room, and states of the controller that did not arrive. Counted by the recorder.
    dropped: AtomicU64,
    /// The same of the open bag, or of the last one.
    dropped_of_bag: AtomicU64,
    /// Ticks for which there was no room, that the recorder has not counted yet: it may wait for
    /// its disk.
    refused: AtomicU64,
    /// Number of the last tick that was handed over or found no room.
    offered: AtomicU64,
    /// Why the last bag was closed early.
    pub fault: Mutex<Option<String>>,
    /// The same of the first bag that was.
    pub first_fault: OnceLock<String>,
    /// The node ends: no loop waits for the disk any more.
    is_ending: AtomicBool,
    /// Stamp of the last tick in the bag, ns.
    written: AtomicI64,
    /// Stamp of the controller's last state that was heard for the bag, ns; `i64::MIN` before.
    heard: AtomicI64,
    /// A loop that may wait does so for the controller's states too.
    waits_for_states: AtomicBool,
}

impl RecorderStatus {
    /// States of a controller have come since the bag was opened.
    pub fn hears_controller(&self) -> bool {
        self.heard.load(Ordering::Relaxed) > i64::MIN
    }

    /// Samples that the recordings lack, since the start of the node.
    pub fn lost(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed) + self.refused.load(Ordering::Relaxed)
    }

    /// The same of the open bag, or of the last one.
    pub fn lost_of_bag(&self) -> u64 {
        self.dropped_of_bag.load(Ordering::Relaxed) + self.refused.load(Ordering::Relaxed)
    }

    /// The node ends, and no loop waits for the bag any more: what was handed over is written.
    pub fn end(&self) {
        self.is_ending.store(true, Ordering::Release);
    }

    fn is_ending(&self) -> bool {
        self.is_ending.load(Ordering::Acquire)
    }

    /// Whether samples find no room, and the recorder does not look.
    pub fn is_full(&self) -> bool {
        self.refused.load(Ordering::Relaxed) > 0
    }

    /// Whether the open bag lacks what was sampled at `stamp` ns.
    fn is_behind(&self, stamp: i64) -> bool {
        self.written.load(Ordering::Relaxed) < stamp
            || self.waits_for_states.load(Ordering::Relaxed)
                && self.heard.load(Ordering::Relaxed) < stamp
    }
}

/// Starts and stops recordings and takes messages. Cheap to clone.
#[derive(Clone)]
pub struct RecorderHandle {
    orders: mpsc::Sender<Order>,
    /// Messages that wait for the recorder, which looks by itself: waking it on another processor
    /// for each would cost the loop more than the message.
    heard: Arc<Mutex<Vec<(i64, Heard)>>>,
    status: Arc<RecorderStatus>,
    stage: Arc<StageStatus>,
    start: i64,
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
    /// How to write the bags, with their provenance.
    pub options: BagOptions,
    /// Where the stage says which sample it is at: the time of messages of peers.
    pub stage: Arc<StageStatus>,
    /// The same before the first sample, ns.
    pub start: i64,
    /// Between two samples, ns.
    pub period: i64,
    /// The process has a real-time priority.
    pub real_time: bool,
}

/// The recorder's thread; it ends, and closes its bag, when every handle and feed is gone.
pub struct Recorder {
    thread: JoinHandle<()>,
}

/// The end of the ring where a loop puts its ticks.
pub struct TickFeed {
    ring: rtrb::Producer<Tick>,
    status: Arc<RecorderStatus>,
    /// What the bag may lag behind a loop that can wait, ns.
    backlog: i64,
}

impl TickFeed {
    /// Hands over a tick if a bag is open. One that finds the ring full is counted.
    #[inline]
    pub fn offer(&mut self, tick: &Tick) {
        if self.status.recording.load(Ordering::Acquire) {
            if self.ring.push(*tick).is_err() {
                self.status.refused.fetch_add(1, Ordering::Relaxed);
            }
            self.status.offered.store(tick.sample.index, Ordering::Release);
        }
    }

    /// The same for a loop that may wait, because simulated time stands still meanwhile: never
    /// drops, and comes back when the bag lags no more than `BACKLOG` samples behind. Once the node
    /// ends it waits no longer, and counts what finds no room.
    #[inline]
    pub fn insist(&mut self, tick: &Tick) {
        const PAUSE: Duration = Duration::from_micros(100);
        let is_recording = |status: &RecorderStatus| status.recording.load(Ordering::Acquire);
        loop {
            // What comes after the bag was closed is not missing in it.
            if !is_recording(&self.status) {
                return;
            }
            if self.ring.push(*tick).is_ok() {
                break;
            }
            if self.status.is_ending() {
                self.status.refused.fetch_add(1, Ordering::Relaxed);
                break;
            }
            std::thread::sleep(PAUSE);
        }
        self.status.offered.store(tick.sample.index, Ordering::Release);
        while is_recording(&self.status)
            && self.status.is_behind(tick.stamp - self.backlog)
            && !self.status.is_ending()
        {
            std::thread::sleep(PAUSE);
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

    /// Hands over a message if a bag is open, with the time of the last sample: what a peer says of
    /// its time is no log time.
    pub fn hear(&self, message: impl FnOnce() -> Heard) {
        if self.is_recording() {
            let now = self.stage.stamp.load(Ordering::Relaxed).max(self.start);
            let mut heard = lock(&self.heard);
            if heard.len() < MOST_HEARD {
                heard.push((now, message()));
            } else {
                self.status.dropped.fetch_add(1, Ordering::Relaxed);
                self.status.dropped_of_bag.fetch_add(1, Ordering::Relaxed);
            }
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
        let heard = Arc::new(Mutex::new(Vec::new()));
        let handle = RecorderHandle {
            orders,
            heard: heard.clone(),
            status: status.clone(),
            stage: setup.stage.clone(),
            start: setup.start,
        };
        let backlog = BACKLOG * setup.period;
        let mut work = Work {
            setup,
            ring: consumer,
            status: status.clone(),
            bag: None,
            controller: None,
            heard,
            since: None,
            answered: i64::MIN,
            last_force: None,
            last_tick: None,
        };
        let thread = std::thread::Builder::new()
            .name("recorder".to_owned())
            .spawn(move || work.run(&inbox))?;
        Ok((Recorder { thread }, handle, TickFeed { ring: producer, status, backlog }))
    }

    /// Waits until the thread has closed its bag; drop every handle and feed before. While a disk
    /// does not answer this takes as long as that: it is said, and another signal ends the process.
    pub fn join(self) {
        // Longer than what the controller owes is waited for.
        const LONG: Duration = Duration::from_secs(3);
        let began = Instant::now();
        let mut is_said = false;
        while !self.thread.is_finished() {
            if !is_said && began.elapsed() > LONG {
                is_said = true;
                end_at_the_next_signal();
                tracing::warn!(
                    "the disk of the recording does not answer: the node ends when it does, or at \
                     the next signal, with a bag that `friction-stage recover` makes whole"
                );
            }
            std::thread::sleep(NAP);
        }
        if self.thread.join().is_err() {
            tracing::error!(
                "the recorder ended by a panic; `friction-stage recover` makes its bag whole"
            );
        }
    }
}

/// Ends the process with exit code 1 at the next SIGINT or SIGTERM.
fn end_at_the_next_signal() {
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        let now = Arc::new(AtomicBool::new(true));
        if let Err(error) = signal_hook::flag::register_conditional_shutdown(signal, 1, now) {
            tracing::error!("cannot take over signals: {error}");
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
    /// Stamp of the first tick in the bag, ns.
    since: Option<i64>,
    /// Stamp of the last force, ns.
    answered: i64,
    /// The last force in the bag.
    last_force: Option<WrenchStamped>,
    /// Number of the last tick in the bag.
    last_tick: Option<u64>,
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
        options: &BagOptions,
    ) -> Result<OpenBag, BagError> {
        let mut writer = BagWriter::create(directory, options)?;
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
        // Below the threads that pass samples on, above everything that is not real time.
        if self.setup.real_time
            && let Err(error) = cpu::real_time(1)
        {
            tracing::warn!("the recorder keeps its priority: {error}");
        }
        loop {
            let first = inbox.recv_timeout(NAP);
            let over = matches!(first, Err(mpsc::RecvTimeoutError::Disconnected));
            for order in first.into_iter().chain(inbox.try_iter()) {
                self.handle(order);
            }
            self.drain();
            if over {
                break;
            }
        }
        match self.close() {
            Ok(Some(written)) => {
                tracing::info!("recorded {written}");
            }
            Ok(None) => {}
            Err(error) => tracing::error!("closing the bag: {error}"),
        }
    }

    fn handle(&mut self, order: Order) {
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
        let bag = OpenBag::create(directory, &self.setup.topics, &self.setup.options)
            .map_err(|error| error.to_string())?;
        self.bag = Some(bag);
        *lock(&self.status.fault) = None;
        // Of before the bag was open.
        while self.ring.pop().is_ok() {}
        lock(&self.heard).clear();
        self.since = None;
        self.answered = i64::MIN;
        self.last_force = None;
        self.last_tick = None;
        self.count_refused();
        self.status.dropped_of_bag.store(0, Ordering::Relaxed);
        let status = &self.status;
        status.heard.store(i64::MIN, Ordering::Relaxed);
        status.waits_for_states.store(false, Ordering::Relaxed);
        status.written.store(self.setup.stage.stamp.load(Ordering::Relaxed), Ordering::Relaxed);
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
        while self.controller.as_ref().is_some_and(|listener| listener.owes(self.answered))
            && self.bag.is_some()
        {
            std::thread::sleep(NAP);
            self.drain();
        }
        if let Some(mut listener) = self.controller.take() {
            self.miss(listener.missing_until(self.answered));
            if let Some(state) = listener.latest.take() {
                self.write_state(state);
            }
        }
        if let Some(last) = self.last_tick.take() {
            self.find_gap(self.status.offered.load(Ordering::Acquire).saturating_sub(last));
            self.status.refused.store(0, Ordering::Relaxed);
        }
        let Some(bag) = self.bag.take() else { return Ok(None) };
        let written = Written {
            missing: self.status.dropped_of_bag.load(Ordering::Relaxed),
            directory: bag.writer.directory().to_owned(),
            messages: bag.writer.message_count(),
        };
        bag.writer.finish()?;
        Ok(Some(written))
    }

    /// Writes everything that waits: ticks and states of the controller.
    fn drain(&mut self) {
        while let Ok(tick) = self.ring.pop() {
            let index = tick.sample.index;
            if let Some(last) = self.last_tick.replace(index) {
                self.find_gap(index.saturating_sub(last + 1));
            }
            self.since.get_or_insert(tick.stamp);
            self.write(|bag, names| bag.write_tick(&tick, names));
            self.status.written.store(tick.stamp, Ordering::Relaxed);
        }
        let heard = std::mem::take(&mut *lock(&self.heard));
        for (time, message) in heard {
            if let Heard::Force(force) = &message {
                // Nothing is answered before it was sampled.
                self.answered = self.answered.max(force.header.stamp.to_nanos().min(time));
                // A controller that heard its sample again answers it again.
                if self.last_force.as_ref().is_some_and(|last| last == force) {
                    continue;
                }
                self.last_force = Some(force.clone());
            }
            self.write(|bag, _| bag.write_heard(time, &message));
        }
        // A state may come before the tick of its sample has: it waits for the first one.
        while self.since.is_some()
            && let Some((state, missing)) = self.controller.as_mut().and_then(Listener::take)
        {
            self.miss(missing);
            self.write_state(state);
        }
        if let Some(stamp) = self.controller.as_ref().map(|listener| listener.stamp)
            && self.status.heard.swap(stamp, Ordering::Relaxed) != stamp
        {
            self.status.waits_for_states.store(true, Ordering::Relaxed);
        }
        if let Some(listener) = &self.controller
            && listener.is_silent()
            && self.status.waits_for_states.load(Ordering::Relaxed)
            // By less than the backlog: a loop that waits for states publishes no more samples.
            && self.status.is_behind(self.answered.saturating_sub(BACKLOG / 2 * self.setup.period))
        {
            self.status.waits_for_states.store(false, Ordering::Relaxed);
            tracing::warn!(
                "{}: nothing for {LAST_STATES:?} while its forces go on; time no longer waits \
                 for it",
                self.setup.topics.controller_state
            );
        }
        self.write(|bag, _| bag.writer.flush_if_due());
    }

    fn write_state(&mut self, state: ControllerState) {
        let stamp = state.header.stamp.to_nanos();
        let now = self.setup.stage.stamp.load(Ordering::Relaxed).max(self.setup.start);
        // Of a sample before the bag.
        if self.since.is_none_or(|first| stamp < first) {
            return;
        }
        let time = if now.abs_diff(stamp) <= NEAR as u64 { stamp } else { now };
        self.write(|bag, _| bag.write_heard(time, &Heard::ControllerState(state)));
    }

    /// Counts ticks that are missing between two.
    fn find_gap(&self, count: u64) {
        let less = |refused: u64| Some(refused.saturating_sub(count));
        let _ = self.status.refused.fetch_update(Ordering::Relaxed, Ordering::Relaxed, less);
        self.miss(count);
    }

    /// Ticks that found no room and have no tick after them in the bag are lost for good.
    fn count_refused(&self) {
        let refused = self.status.refused.swap(0, Ordering::Relaxed);
        self.status.dropped.fetch_add(refused, Ordering::Relaxed);
        self.status.dropped_of_bag.fetch_add(refused, Ordering::Relaxed);
    }

    /// Counts samples that the bag lacks; a flood is logged at powers of two only.
    fn miss(&self, count: u64) {
        if count == 0 {
            return;
        }
        self.status.dropped.fetch_add(count, Ordering::Relaxed);
        let before = self.status.dropped_of_bag.fetch_add(count, Ordering::Relaxed);
        let total = before + count;
        if before.checked_ilog2() != total.checked_ilog2() {
            tracing::warn!(
                "the recording lacks {total} samples so far: machine or disk is too busy"
            );
        }
    }

    /// Does something to the open bag; one that fails is given up with a loud word.
    fn write(&mut self, action: impl FnOnce(&mut OpenBag, &StageNames) -> Result<(), BagError>) {
        let Some(bag) = &mut self.bag else { return };
        if let Err(error) = action(bag, &self.setup.names) {
            let directory = bag.writer.directory();
            if directory.exists() {
                let directory = directory.display();
                tracing::error!(
                    "recording ends: {error}. What was written until now is in {directory}; \
                     `friction-stage recover {directory}` makes it whole"
                );
            } else {
                tracing::error!("recording ends: {error}. Nothing of it is left");
            }
            let _ = self.status.first_fault.set(error.to_string());
            *lock(&self.status.fault) = Some(error.to_string());
            self.status.recording.store(false, Ordering::Release);
            self.count_refused();
            // Dropping the writer would try the full disk again; its error has been reported.
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
    /// Two states of this sender have come in a row.
    met: bool,
    /// The last state, which one of the same sample may still replace: a controller that waits
    /// for its setpoint tells of a sample before it answers it.
    latest: Option<ControllerState>,
    /// Stamp of the last state, ns.
    stamp: i64,
    /// Between the last two states, ns.
    interval: i64,
    /// Of the stage's samples, ns.
    period: i64,
    /// When the last state was taken.
    taken: Instant,
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
        let stamp = || setup.stage.stamp.load(Ordering::Relaxed);
        let before = stamp();
        let is_found = participant.watch().wait_for_matches(inlet.guid(), 1, FIND) > 0;
        let samples_come = stamp() != before;
        let mut listener = Listener {
            inlet,
            last: None,
            met: false,
            latest: None,
            stamp: i64::MIN,
            interval: i64::MAX,
            period: setup.period,
            taken: Instant::now(),
        };
        if is_found && samples_come {
            listener.meet();
        }
        Ok(listener)
    }

    /// Waits until a state has come.
    fn meet(&mut self) {
        let found = Instant::now();
        while self.stamp == i64::MIN && found.elapsed() < FIRST_STATE {
            std::thread::sleep(NAP);
            self.take();
        }
    }

    /// No state has come for a long time.
    fn is_silent(&self) -> bool {
        self.taken.elapsed() > LAST_STATES
    }

    /// States of samples until `answered` are still to be expected.
    fn owes(&self, answered: i64) -> bool {
        self.missing_until(answered) > 0 && !self.is_silent()
    }

    /// States until that of the sample `answered`, ns, of a controller that sends one for each; of
    /// another it is unknown.
    fn missing_until(&self, answered: i64) -> u64 {
        if self.interval > self.period + self.period / 2 || answered <= self.stamp {
            return 0;
        }
        ((answered - self.stamp) / self.period.max(1)) as u64
    }

    /// How many of `sender` did not arrive before its message `number`.
    fn missing_before(&mut self, sender: Gid, number: i64) -> u64 {
        let missing = match self.last {
            Some((last_sender, last)) if last_sender == sender => number - last - 1,
            _ => 0,
        };
        // A reader and a writer that are just meeting pass each other: what comes before two in a
        // row is of before they met.
        self.met = match self.last {
            Some((last_sender, _)) if last_sender == sender => self.met || missing == 0,
            _ => false,
        };
        self.last = Some((sender, number));
        if self.met { u64::try_from(missing).unwrap_or(0) } else { 0 }
    }

    /// The last state of the next sample that is over, and how many before it are missing.
    fn take(&mut self) -> Option<(ControllerState, u64)> {
        let mut missing = 0;
        loop {
            match self.inlet.take_with_info() {
                Ok(None) => return None,
                Ok(Some((state, info))) => {
                    missing += self.missing_before(info.publisher_gid(), info.sequence_number());
                    self.taken = Instant::now();
                    let stamp = state.header.stamp.to_nanos();
                    let before = self.latest.replace(state);
                    if stamp == self.stamp {
                        continue;
                    }
                    self.interval = stamp.saturating_sub(self.stamp);
                    self.stamp = stamp;
                    if let Some(before) = before {
                        return Some((before, missing));
                    }
                }
                Err(error) => {
                    tracing::warn!("a state of the controller could not be read: {error}")
                }
            }
        }
    }
}
