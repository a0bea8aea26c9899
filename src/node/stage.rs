//! The stage node: puts settings, plant, topics, services and threads together.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use anyhow::Context as _;
use tokio::sync::oneshot;

use super::clock;
use super::control::Control;
use super::help;
use super::lifecycle::Lifecycle;
use super::live::{self, LiveFeed, LiveSetup, SharedFollower};
use super::lock::lock;
use super::memory_watch;
use super::outlet::Outlet;
use super::parameters::ParameterSet;
use super::participant::Participant;
use super::qos::DIAGNOSTICS;
use super::recorder::{Heard, RecordedTopics, Recorder, RecorderHandle, RecorderSetup, TickFeed};
use super::runtime::{Background, End, Startup};
use super::signals::Signals;
use super::simulation;
use super::stage_inbox::Inbox;
use super::stage_outlets::StageOutlets;
use super::stage_settings::{self, Drive, Mode, StageSettings};
use super::stage_status::StageStatus;
use super::wire::StageNames;
use crate::made_by;
use crate::outcome::Outcome;
use friction_stage_core::plant::Stage;
use friction_stage_data::bag::{BagOptions, Provenance};
use friction_stage_data::message::{DiagnosticArray, Header, KeyValue};

const ABOUT: &str = "The stage on ROS 2: takes force commands and setpoints, publishes what \
                     encoder and force cell read.";

/// Interval of `/diagnostics`.
const DIAGNOSTICS_INTERVAL: Duration = Duration::from_millis(200);
/// How long a new stage looks for another of its name before it publishes. Discovery on one machine
/// takes 0.1 s.
const LOOK_AROUND: Duration = Duration::from_millis(400);

/// Settings that change while the node runs, readable without a lock.
#[derive(Debug)]
pub struct LiveSettings {
    command_timeout: AtomicU64,
    answer_timeout: AtomicU64,
    clock_pause: AtomicU64,
    counts: Mutex<Vec<KeyValue>>,
}

impl LiveSettings {
    fn new(settings: &StageSettings) -> LiveSettings {
        let nanos = |duration: Duration| AtomicU64::new(duration.as_nanos() as u64);
        LiveSettings {
            command_timeout: nanos(settings.command_timeout),
            answer_timeout: nanos(settings.answer_timeout),
            clock_pause: nanos(settings.clock_pause),
            counts: Mutex::default(),
        }
    }

    pub fn command_timeout(&self) -> Duration {
        Duration::from_nanos(self.command_timeout.load(Ordering::Relaxed))
    }

    pub fn answer_timeout(&self) -> Duration {
        Duration::from_nanos(self.answer_timeout.load(Ordering::Relaxed))
    }

    pub fn clock_pause(&self) -> Duration {
        Duration::from_nanos(self.clock_pause.load(Ordering::Relaxed))
    }

    /// Counters of the publishers, for `/diagnostics`.
    pub fn set_counts(&self, counts: Vec<KeyValue>) {
        *lock(&self.counts) = counts;
    }

    fn set(&self, name: &str, seconds: f64) {
        let slot = match name {
            "command_timeout" => &self.command_timeout,
            "answer_timeout" => &self.answer_timeout,
            "clock_pause" => &self.clock_pause,
            _ => return,
        };
        slot.store(Duration::from_secs_f64(seconds).as_nanos() as u64, Ordering::Relaxed);
    }
}

/// What the loop of the stage works with, in either mode.
pub struct StageLoop {
    pub stage: Stage,
    pub settings: StageSettings,
    pub outlets: StageOutlets,
    pub inbox: Inbox,
    pub feed: TickFeed,
    pub status: Arc<StageStatus>,
    pub live: Arc<LiveSettings>,
    pub live_page: Option<LiveFeed>,
    /// What the stage follows in `drive: servo`, for the live page.
    pub followed: SharedFollower,
}

/// Runs the stage node with the given command line (without the program's name) until a signal ends
/// it.
pub fn run(command_line: Vec<String>) -> anyhow::Result<Outcome> {
    let signals = Signals::listen()?;
    if help::given(&command_line, "stage_node", ABOUT, &stage_settings::specs()) {
        return Ok(Outcome::Done);
    }
    let startup = Startup::parse("stage", command_line)?;
    startup.start_logging();
    let parameters = ParameterSet::declare(stage_settings::specs(), &startup.overrides())?;
    let settings = StageSettings::new(&parameters)?;
    let stage = Stage::new(&settings.model, settings.rates, settings.seed)
        .with_context(|| format!("parameter model is {}", parameters.string("model")))?;
    // Whoever takes a stage as it is delivered can do nothing about its guides.
    if parameters.string("model").ends_with(".yaml") {
        for note in settings.model.notes()? {
            tracing::info!("{note}");
        }
    }
    let cpu = parameters.integer("cpu");
    startup.pin(cpu)?;
    let real_time = settings.mode == Mode::Realtime && startup.schedule(settings.priority);
    let managed = parameters.boolean("lifecycle");
    let parameters = Arc::new(Mutex::new(parameters));

    let participant = startup.join()?;
    let status = Arc::new(StageStatus::default());
    let live = Arc::new(LiveSettings::new(&settings));
    let (control, control_inbox) = futures::channel::mpsc::unbounded();
    let mut background =
        Background::new(signals, &participant, parameters.clone(), control.clone())?;

    refuse_a_second_stage(&startup, &participant)?;
    let names = StageNames {
        joint: settings.joint.clone(),
        frame: settings.frame.clone(),
        effects: stage.body().effects().names().map(str::to_owned).collect(),
    };
    let (recorder, handle, feed) = Recorder::start(RecorderSetup {
        namespace: startup.namespace.clone(),
        node: format!("{}_recorder", startup.name),
        busy_cpu: usize::try_from(cpu).ok(),
        topics: recorded_topics(&startup, settings.publish_clock),
        names: names.clone(),
        options: BagOptions {
            provenance: Some(provenance(&startup, &settings)?),
            ..settings.bags.clone()
        },
        stage: status.clone(),
        period: settings.rates.time_of(1),
        real_time,
        start: match settings.mode {
            Mode::Lockstep => super::LOCKSTEP_EPOCH,
            Mode::Realtime => clock::system(),
        },
    })?;
    if let Some(directory) = &settings.record {
        handle.start(directory).map_err(|reason| anyhow::anyhow!("parameter record: {reason}"))?;
        tracing::info!("recording to {}", directory.display());
    }
    let inbox = Inbox::new(&startup, &participant, &settings.joint, control_inbox, handle.clone())?;
    let outlets = StageOutlets::new(&startup, &participant, names, &settings)?;

    let lifecycle = background.serve_enable_or_lifecycle(&startup, &participant, managed)?;
    background.serve_reset(&startup, &participant)?;
    background.serve_simulation(
        &startup,
        simulation::Setup {
            participant: &participant,
            lockstep: settings.mode == Mode::Lockstep,
            control: control.clone(),
            status: status.clone(),
            joint: &settings.joint,
            frame: &settings.frame,
        },
    )?;
    let record = record_switch(&startup, &settings, handle.clone());
    {
        let record = record.clone();
        background.serve_record(&startup, &participant, move |on| record(on))?;
    }
    let followed = SharedFollower::default();
    let live_page = match settings.live_port {
        None => {
            // The recorder ends when its last handle is dropped.
            drop(record);
            None
        }
        Some(port) => Some(live::start(LiveSetup {
            port,
            model: settings.model.clone(),
            bandwidth: (settings.drive == Drive::Servo).then_some(settings.servo_bandwidth),
            rate: settings.rates.control(),
            follower: followed.clone(),
            control: control.clone(),
            record,
            recorder: handle.clone(),
            busy_cpu: usize::try_from(cpu).ok(),
        })?),
    };
    follow_parameters(&parameters, &live, control.clone());
    background.spawn(diagnose(
        &startup,
        &participant,
        status.clone(),
        live.clone(),
        handle.clone(),
        lifecycle,
    )?);
    let recorded = handle.shared_status();
    drop((handle, control));

    tracing::info!(
        "{} of {} kg on {} guides, {} Hz control, {} Hz physics, mode {}, drive {}",
        settings.model.name,
        settings.model.mass,
        settings.model.guides.len(),
        settings.rates.control(),
        settings.rates.physics(),
        format!("{:?}", settings.mode).to_lowercase(),
        format!("{:?}", settings.drive).to_lowercase()
    );
    let (ended, loop_ended) = oneshot::channel();
    let mode = settings.mode;
    let work =
        StageLoop { stage, settings, outlets, inbox, feed, status, live, live_page, followed };
    let work = std::thread::Builder::new().name("stage".to_owned()).spawn(move || {
        let result = match mode {
            Mode::Lockstep => {
                work.run_lockstep();
                Ok(())
            }
            Mode::Realtime => work.run_realtime(),
        };
        let _ = ended.send(());
        result
    })?;
    let end = background.run(loop_ended);
    recorded.end();
    let end = end?;
    work.join().map_err(|_| anyhow::anyhow!("the loop of the stage ended by a panic"))??;
    recorder.join();
    match end {
        End::Signal => {
            if let Some(fault) = recorded.first_fault.get() {
                anyhow::bail!("a recording is not whole: {fault}");
            }
            let lost = recorded.lost();
            if lost > 0 {
                tracing::warn!("the recordings lack {lost} samples");
            }
            Ok(Outcome::warned(lost > 0))
        }
        End::Memory(bytes) => memory_watch::end(bytes),
        End::Loop => anyhow::bail!("the loop of the stage ended"),
    }
}

/// Topics of both nodes, as a bag holds them.
fn recorded_topics(startup: &Startup, with_clock: bool) -> RecordedTopics {
    RecordedTopics {
        encoder: startup.topic("~/encoder"),
        force_cell: startup.topic("~/force_cell"),
        state: startup.topic("~/state"),
        clock: with_clock.then(|| startup.topic("/clock")),
        force: startup.topic("~/force"),
        joint_commands: startup.topic("~/joint_commands"),
        commands: startup.topic("~/commands"),
        setpoint: startup.topic("~/setpoint"),
        controller_state: startup.topic("controller/state"),
        diagnostics: startup.topic("/diagnostics"),
    }
}

fn provenance(startup: &Startup, settings: &StageSettings) -> anyhow::Result<Provenance> {
    let extra = [
        ("control_rate", settings.rates.control().to_string()),
        ("physics_rate", settings.rates.physics().to_string()),
        ("mode", format!("{:?}", settings.mode).to_lowercase()),
        ("drive", format!("{:?}", settings.drive).to_lowercase()),
        ("node", startup.full_name()),
        ("date", made_by::now()),
    ];
    Ok(Provenance {
        model_yaml: settings.model.to_yaml()?,
        seed: settings.seed.to_string(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        arguments: startup.command_line.join(" "),
        extra: extra.into_iter().map(|(key, value)| (key.to_owned(), value)).collect(),
    })
}

/// Two stages of one name would answer each other's commands: the one that comes second does not
/// start.
fn refuse_a_second_stage(startup: &Startup, participant: &Participant) -> anyhow::Result<()> {
    let topic = startup.topic("~/encoder");
    let deadline = std::time::Instant::now() + LOOK_AROUND;
    while std::time::Instant::now() < deadline {
        anyhow::ensure!(
            participant.other_writers_of(&topic) == 0,
            "another node publishes {topic} already: give this stage another name with --ros-args \
             -r __node:=NAME or -r __ns:=/NAMESPACE"
        );
        // Discovery has no event for this: look again.
        std::thread::sleep(Duration::from_millis(20));
    }
    Ok(())
}

/// Starts and ends a recording into a directory of its own, and says what it did.
fn record_switch(
    startup: &Startup,
    settings: &StageSettings,
    handle: RecorderHandle,
) -> Arc<dyn Fn(bool) -> Result<String, String> + Send + Sync> {
    let (into, name) = (settings.record_into.clone(), startup.name.clone());
    Arc::new(move |on| {
        if on {
            let directory = crate::directory::dated(&into, &name);
            handle.start(&directory)?;
            return Ok(format!("recording to {}", directory.display()));
        }
        Ok(match handle.stop()? {
            Some(written) => written.to_string(),
            None => "was not recording".to_owned(),
        })
    })
}

/// Passes parameter changes on to the loops.
fn follow_parameters(
    parameters: &Arc<Mutex<ParameterSet>>,
    live: &Arc<LiveSettings>,
    control: futures::channel::mpsc::UnboundedSender<Control>,
) {
    let live = live.clone();
    lock(parameters).on_change(move |changes, _| {
        for (name, value) in changes {
            if let ros2_client::ParameterValue::Double(seconds) = value {
                live.set(name, *seconds);
            }
        }
        control.unbounded_send(Control::Retune).map_err(|_| "the node is shutting down".to_owned())
    });
}

/// Publishes `/diagnostics`.
fn diagnose(
    startup: &Startup,
    participant: &Participant,
    status: Arc<StageStatus>,
    live: Arc<LiveSettings>,
    recorder: RecorderHandle,
    lifecycle: Option<Lifecycle>,
) -> anyhow::Result<impl Future<Output = ()> + Send + 'static> {
    let mut outlet =
        Outlet::<DiagnosticArray>::new(participant, &startup.topic("/diagnostics"), &DIAGNOSTICS)?;
    let (name, hardware) = (format!("{}: stage", startup.full_name()), startup.full_name());
    let (participant, topic) = (participant.clone(), startup.topic("~/encoder"));
    Ok(async move {
        let mut interval = tokio::time::interval(DIAGNOSTICS_INTERVAL);
        let (mut is_alone, mut is_full) = (true, false);
        loop {
            interval.tick().await;
            let was_alone =
                std::mem::replace(&mut is_alone, participant.other_writers_of(&topic) == 0);
            let stranger =
                format!("another node publishes {topic} as well: two stages must not share a name");
            if was_alone && !is_alone {
                tracing::error!("{stranger}");
            }
            let mut more = lock(&live.counts).clone();
            let recording = recorder.status();
            more.push(KeyValue::new("recording", recorder.is_recording()));
            more.push(KeyValue::new("recording_dropped_samples", recording.lost()));
            more.push(KeyValue::new(
                "recording_hears_controller",
                recorder.is_recording() && recording.hears_controller(),
            ));
            more.push(KeyValue::new("stamp_ns", status.stamp.load(Ordering::Relaxed)));
            let missing = recording.lost_of_bag();
            let was_full = std::mem::replace(&mut is_full, recording.is_full());
            if is_full && !was_full {
                tracing::warn!(
                    "the recording lacks {missing} samples so far, and its recorder waits: disk or \
                     machine is too busy"
                );
            }
            let mut warnings = Vec::new();
            if recorder.is_recording() && missing > 0 {
                warnings.push(format!("the recording lacks {missing} samples"));
            }
            let mut faults: Vec<String> =
                lock(&recording.fault).iter().map(|fault| format!("recording: {fault}")).collect();
            if !is_alone {
                faults.push(stranger);
            }
            let diagnostic =
                status.diagnostic(name.clone(), hardware.clone(), more, &faults, &warnings);
            if let Some(lifecycle) = &lifecycle {
                lifecycle.looked(diagnostic.fault());
            }
            let message = DiagnosticArray {
                header: Header::new(clock::system(), ""),
                status: vec![diagnostic],
            };
            recorder.hear(|| Heard::Diagnostics(message.clone()));
            let _ = outlet.publish(message);
        }
    })
}
