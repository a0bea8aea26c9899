//! The controller node: encoder in, force out, one answer per sample.
//!
//! It runs on the samples of the stage: it computes at the first sample at or after each tick of
//! its own rate and answers the samples in between with the held force, so that the same loop
//! serves real time and lockstep. Every answer carries the stamp of its sample. A disabled
//! controller is silent: in real time the stage's force goes to zero, in lockstep its time stands
//! still.

use std::sync::atomic::{AtomicBool, AtomicI64, AtomicU8, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use futures::channel::mpsc::{UnboundedReceiver, UnboundedSender};
use futures::stream::Stream;
use ros2_client::ReadError;
use tokio::sync::oneshot;

use super::action::{self, GoalEnd, GoalId, News, Wish};
use super::clock;
use super::control::Control;
use super::controller_settings as settings;
use super::delay::Delay;
use super::follow_joint_trajectory::{
    self as follow, ActiveGoal, Constraints, FollowGoal, FollowJointTrajectory, FollowResult,
    Progress, Sampled,
};
use super::help;
use super::identify_loop::{self, Measurement};
use super::inlet::Inlet;
use super::lifecycle::Lifecycle;
use super::lock::lock;
use super::memory_watch;
use super::outlet::{Outlet, Published};
use super::parameters::ParameterValues;
use super::participant::Participant;
use super::qos::{COMMANDS, CONTROLLER_STATE, DIAGNOSTICS, FORCES, Qos, SAMPLES};
use super::runtime::{Background, End, Startup};
use super::signals::Signals;
use super::source_watch::SourceWatch;
use super::stage_status::{SECOND_SOURCE, gid_text};
use super::waiter::{Turns, Waiter};
use super::wire::{Setpoint, SetpointError, controller_state, setpoint};
use super::words::{Recent, quoted};
use crate::outcome::Outcome;
use friction_stage_core::control::{
    Cause, Compensation, CompensationTermsOn, Controller, ControllerSettings, DampedStop, Follower,
    Health, Supervisor, Terms, TrajectoryError,
};
use friction_stage_data::message::{
    ControllerState, DiagnosticArray, DiagnosticStatus, Duration as Span, Header, JointState,
    JointTrajectory, JointTrajectoryControllerState, KeyValue, WrenchStamped,
};

const ABOUT: &str = "The controller of the stage on ROS 2: takes what the encoder reads and \
                     setpoints, commands the force.";

/// Interval of `/diagnostics`.
const DIAGNOSTICS_INTERVAL: Duration = Duration::from_millis(200);
/// States that go out together: DDS then packs them into one datagram with one acknowledgement,
/// which a subscriber (the recorder) pays for. Fewer than the 10 that a default subscription keeps.
const BURST: usize = 8;
/// Longest time that a state waits for others.
const BURST_WITHIN: Duration = Duration::from_millis(5);
/// Longest wait for a writer that replaces one with a dead subscriber: the stage waits for the
/// answer.
const SETTLE: Duration = Duration::from_secs(1);

/// Longest time that states are held for subscribers that lag: shorter than a stage waits for them
/// when it records.
const STATES_PATIENCE: Duration = Duration::from_millis(1500);

/// Longest wait after a burst of states in lockstep for subscribers that catch up: less than the
/// stage waits for an answer, whatever it is set to.
const PACE_WITHIN: Duration = Duration::from_millis(5);
/// Stamps below this, 10^9 s after the epoch, are of lockstep, which begins at 1 s; ns. The clock
/// of this machine is not asked: where it is wrong, a loop in real time would wait.
const LOCKSTEP_BELOW: i64 = 1_000_000_000_000_000_000;

/// Why a goal is refused, in the words of joint_trajectory_controller where it has any.
const NOT_RUNNING: &str = "Can't accept new action goals. Controller is not running.";
const NO_SAMPLE: &str = "Can't accept new action goals. No sample of the stage has come yet.";

/// How long the last states can be asked for again: three heartbeats of the DDS library.
const LINGER: Duration = Duration::from_millis(300);
/// Messages of `/diagnostics` that are kept until they are taken, and after: they are large.
const FEW: u32 = 32;
/// Bytes at the begin of a GID that all publishers of a participant share.
const PREFIX: usize = 12;
/// Positions beyond this, m, are no positions of a stage.
const FAR: f64 = 1e6;
/// Without a sample for longer, diagnostics say so.
const SILENT: Duration = Duration::from_secs(1);
/// Least share of its bandwidth that a late loop keeps.
const LEAST_SHARE: f64 = 0.02;

/// Counters for `/diagnostics`.
#[derive(Debug, Default)]
struct Status {
    answered: AtomicU64,
    refused_samples: AtomicU64,
    refused_setpoints: AtomicU64,
    refused_goals: AtomicU64,
    ended_goals: AtomicU64,
    slow_samples: AtomicU64,
    saturated: AtomicU64,
    restarts: AtomicU64,
    /// Times that the stage was put elsewhere, as a reset does.
    displaced: AtomicU64,
    /// Times that samples came so late that the loop gave up bandwidth.
    late: AtomicU64,
    /// Peak of late of the delay of samples, us, and the share of the bandwidth that is left, 1e-6.
    delay_us: AtomicU64,
    share_ppm: AtomicU64,
    /// What the supervision warns about now, what is an error of a loop that it is not to stop, and
    /// why it stopped the loop.
    warning: Mutex<Option<String>>,
    error: Mutex<Option<String>>,
    fault: Mutex<Option<String>>,
    last_refusal: Recent,
    real_time: bool,
    /// What becomes of the samples.
    phase: AtomicU8,
    /// When the last sample came, ns of the monotonic clock, 0 before; whether its time is that of
    /// lockstep.
    heard: AtomicI64,
    simulated: AtomicBool,
}

/// What becomes of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
enum Phase {
    Answered,
    Disabled,
    WaitingForSetpoint,
}

impl Status {
    /// Takes note of a sample, stamped in ns.
    fn hear(&self, stamp: i64) {
        self.heard.store(clock::monotonic(), Ordering::Relaxed);
        self.simulated.store(stamp < LOCKSTEP_BELOW, Ordering::Relaxed);
    }

    /// Takes note of what becomes of it. A loop that is not closed has nothing to warn about.
    fn enter(&self, phase: Phase) {
        if self.phase.swap(phase as u8, Ordering::Relaxed) != phase as u8
            && phase != Phase::Answered
        {
            *lock(&self.warning) = None;
            *lock(&self.error) = None;
            self.share_ppm.store(0, Ordering::Relaxed);
            self.delay_us.store(0, Ordering::Relaxed);
        }
    }

    /// Why no force is sent, and whether that is wrong; `None` while samples are answered.
    fn idle(&self) -> Option<(String, bool)> {
        let heard = self.heard.load(Ordering::Relaxed);
        let silence = Duration::from_nanos((clock::monotonic() - heard).max(0) as u64);
        let simulated = self.simulated.load(Ordering::Relaxed);
        let phase = self.phase.load(Ordering::Relaxed);
        if heard == 0 {
            Some(("waits for the first sample of the stage".to_owned(), false))
        } else if silence > SILENT && simulated {
            Some(("time stands still".to_owned(), false))
        } else if silence > SILENT {
            Some((format!("no sample of the stage for {:.0} s", silence.as_secs_f64()), true))
        } else if phase == Phase::Disabled as u8 {
            Some(("not enabled: sends no force".to_owned(), false))
        } else if phase == Phase::WaitingForSetpoint as u8 {
            Some(("waits for its first setpoint".to_owned(), false))
        } else {
            None
        }
    }

    fn refuse(&self, counter: &AtomicU64, reason: String) {
        let count = counter.fetch_add(1, Ordering::Relaxed) + 1;
        let reason = quoted(&reason);
        let is_new = self.last_refusal.set(&reason);
        if count.is_power_of_two() || is_new && count < 100 {
            tracing::warn!("refused: {reason} ({count} so far)");
        }
    }

    /// Why the supervision stopped the loop, if it did.
    fn stopped(&self) -> Option<String> {
        lock(&self.fault).clone()
    }

    fn diagnostic(&self, name: &str) -> DiagnosticStatus {
        let values = [
            ("answered_samples", &self.answered),
            ("refused_samples", &self.refused_samples),
            ("refused_setpoints", &self.refused_setpoints),
            ("refused_goals", &self.refused_goals),
            ("ended_goals", &self.ended_goals),
            ("slow_samples", &self.slow_samples),
            ("saturated_samples", &self.saturated),
            ("stage_restarts", &self.restarts),
            ("stage_resets", &self.displaced),
            ("late_times", &self.late),
            ("delay_us", &self.delay_us),
        ];
        let share = self.share_ppm.load(Ordering::Relaxed);
        let late = (share > 0 && share < 1_000_000).then(|| {
            format!("samples come late: {:.0} % of the bandwidth is left", 1e-4 * share as f64)
        });
        let idle = self.idle();
        let of_loop = if idle.is_none() { lock(&self.warning).clone() } else { None };
        let late = late.filter(|_| idle.is_none());
        let silence = idle.as_ref().filter(|(_, is_wrong)| *is_wrong).map(|(words, _)| words);
        let warnings = [of_loop, late, silence.cloned(), self.last_refusal.get()];
        let fault = self.stopped().or_else(|| lock(&self.error).clone());
        let level = if fault.is_some() {
            DiagnosticStatus::ERROR
        } else if warnings.iter().any(Option::is_some) {
            DiagnosticStatus::WARN
        } else {
            DiagnosticStatus::OK
        };
        let words: Vec<String> = fault.into_iter().chain(warnings.into_iter().flatten()).collect();
        let message = if words.is_empty() {
            idle.map_or_else(|| "running".to_owned(), |(words, _)| words)
        } else {
            words.join("; ")
        };
        let mut values: Vec<KeyValue> =
            values.map(|(key, counter)| KeyValue::new(key, counter.load(Ordering::Relaxed))).into();
        values.push(KeyValue::new("real_time_scheduling", self.real_time));
        values.push(KeyValue::new("bandwidth_share", 1e-6 * share as f64));
        DiagnosticStatus {
            level,
            name: format!("{name}: controller"),
            message,
            hardware_id: name.to_owned(),
            values,
        }
    }
}

/// Runs the controller node with the given command line (without the program's name) until a signal
/// ends it.
pub fn run(command_line: Vec<String>) -> anyhow::Result<Outcome> {
    let signals = Signals::listen()?;
    if help::given(&command_line, "controller_node", ABOUT, &settings::specs()) {
        return Ok(Outcome::Done);
    }
    let startup = Startup::parse("controller", command_line)?;
    startup.start_logging();
    let mut parameters = settings::declared(&startup.overrides())?;
    let initial = settings::settings(&parameters);
    let compensation = settings::compensation(&parameters, &initial)?;
    for name in compensation.iter().flat_map(Compensation::left_out) {
        tracing::warn!("{name} of the model is not compensated");
    }
    let controller = Controller::new(match &compensation {
        Some(compensation) => initial.informed(compensation),
        None => initial,
    })?;
    let (stage, joint) = (parameters.string("stage"), parameters.string("joint"));
    let (enabled, jump_limit) =
        (parameters.boolean("enabled"), parameters.double("setpoint_jump_limit"));
    let stroke = (parameters.double("stroke_min"), parameters.double("stroke_max"));
    let watch = Watch {
        supervisor: Supervisor::new(settings::supervision(&parameters)),
        stops: parameters.boolean("supervision.enabled"),
        stopping: None,
        delay: Delay::default(),
        delay_limit: parameters.double("supervision.delay"),
        share: 1.0,
        settings: controller.settings().clone(),
    };

    startup.pin(parameters.integer("cpu"))?;
    let real_time = startup.schedule(parameters.integer("priority"));
    let managed = parameters.boolean("lifecycle");
    let wait_for_setpoint = parameters.boolean("wait_for_setpoint");
    let participant = startup.join()?;
    let status = Arc::new(Status { real_time, ..Status::default() });
    let (control, control_inbox) = futures::channel::mpsc::unbounded();
    let retuned: Arc<Mutex<Option<Retuned>>> = Arc::default();
    {
        let (retuned, control) = (retuned.clone(), control.clone());
        parameters.on_change(move |changes, values| {
            settings::check_changes(changes, values)?;
            *lock(&retuned) = Some(Retuned::of(values));
            control
                .unbounded_send(Control::Retune)
                .map_err(|_| "the node is shutting down".to_owned())
        });
    }
    let constraints = Constraints::of(&parameters);
    let intervals = ["action_monitor_rate", "state_publish_rate"]
        .map(|name| (1e9 / parameters.double(name)).round() as i64);
    let parameters = Arc::new(Mutex::new(parameters));
    let (measure, measurements) = futures::channel::mpsc::unbounded();
    let identify_loop = identify_loop::handler(
        parameters.clone(),
        settings::settings,
        startup.name.clone(),
        measure,
    );
    let mut background = Background::new(signals, &participant, parameters, control.clone())?;
    let lifecycle = background.serve_enable_or_lifecycle(&startup, &participant, managed)?;
    background.serve_reset(&startup, &participant)?;
    background.serve_trigger(&startup, &participant, "~/identify_loop", identify_loop)?;
    background.spawn(diagnose(&startup, &participant, status.clone(), lifecycle)?);
    background.spawn(end_as_second(&startup, &participant, control)?);
    let (wish, wishes) = futures::channel::mpsc::unbounded();
    let (news, reported) = futures::channel::mpsc::unbounded();
    let name = startup.topic("~/follow_joint_trajectory");
    let wish = move |wanted| {
        // Where the loop has ended there is no answer.
        let _ = wish.unbounded_send(wanted);
    };
    background.spawn(action::serve::<FollowJointTrajectory, _>(
        &participant,
        &name,
        wish,
        reported,
    )?);

    let work = ControllerLoop {
        encoder: Inlet::new(&participant, &startup.topic(&format!("{stage}/encoder")), &SAMPLES)?,
        setpoint: Inlet::new(
            &participant,
            &startup.topic(&format!("{stage}/setpoint")),
            &COMMANDS,
        )?,
        trajectory: Inlet::new(&participant, &startup.topic("~/joint_trajectory"), &COMMANDS)?,
        control: control_inbox,
        measurements,
        measurement: None,
        goals: Goals {
            wishes,
            news,
            active: None,
            constraints,
            interval: intervals[0],
            due: i64::MIN,
        },
        force: Outlet::new(&participant, &startup.topic(&format!("{stage}/force")), &FORCES)?,
        state: Outlet::new(&participant, &startup.topic("~/state"), &SAMPLES)?
            .patient(STATES_PATIENCE),
        joint_state: Outlet::new(
            &participant,
            &startup.topic("~/controller_state"),
            &CONTROLLER_STATE,
        )?,
        joint_state_interval: intervals[1],
        joint_state_due: i64::MIN,
        period: (1e9 / controller.settings().rate).round() as i64,
        compensation,
        controller,
        follower: Follower::new(jump_limit).within(stroke.0, stroke.1),
        jump_limit,
        watch,
        joint,
        // A managed one begins inactive.
        enabled: enabled && !managed,
        wait_for_setpoint,
        status,
        retuned,
        last: None,
        due: i64::MIN,
        held: Terms::default(),
        sources: SourceWatch::default(),
        waiting: Vec::new(),
        states: Vec::with_capacity(BURST),
        states_due: None,
        setpoint_stamp: 0,
        frame: String::new(),
    };
    let (ended, loop_ended) = oneshot::channel();
    tracing::info!(
        "{} controls {stage} at {} Hz",
        startup.full_name(),
        work.controller.settings().rate
    );
    let thread = std::thread::Builder::new().name("controller".to_owned()).spawn(move || {
        let reason = work.run();
        let _ = ended.send(());
        reason
    })?;
    let end = background.run(loop_ended)?;
    let reason = thread
        .join()
        .map_err(|_| anyhow::anyhow!("the loop of the controller ended by a panic"))?;
    match end {
        End::Signal => Ok(Outcome::Done),
        End::Memory(bytes) => memory_watch::end(bytes),
        End::Loop => {
            anyhow::bail!(reason.unwrap_or_else(|| "the loop of the controller ended".to_owned()))
        }
    }
}

fn diagnose(
    startup: &Startup,
    participant: &Participant,
    status: Arc<Status>,
    lifecycle: Option<Lifecycle>,
) -> anyhow::Result<impl Future<Output = ()> + Send + 'static> {
    let mut outlet =
        Outlet::<DiagnosticArray>::new(participant, &startup.topic("/diagnostics"), &DIAGNOSTICS)?;
    let name = startup.full_name();
    Ok(async move {
        let mut interval = tokio::time::interval(DIAGNOSTICS_INTERVAL);
        loop {
            interval.tick().await;
            let header = Header::new(clock::system(), "");
            if let Some(lifecycle) = &lifecycle {
                // A loop that the supervision is not to stop is not deactivated either.
                lifecycle.looked(status.stopped().as_deref());
            }
            let status = vec![status.diagnostic(&name)];
            let _ = outlet.publish(DiagnosticArray { header, status });
        }
    })
}

/// Ends the controller if a stage says that it is refused because another source commands at once.
///
/// The stage, not the network, tells: a controller that is started again while the stage still
/// waits for its predecessor is refused as well, and is no second one.
fn end_as_second(
    startup: &Startup,
    participant: &Participant,
    control: UnboundedSender<Control>,
) -> anyhow::Result<impl Future<Output = ()> + Send + 'static> {
    // Of a reliable one in the participant that publishes, too, the library waits in vain for an
    // acknowledgement.
    let qos = Qos::best_effort(FEW).window(FEW);
    let mut inlet =
        Inlet::<DiagnosticArray>::new(participant, &startup.topic("/diagnostics"), &qos)?;
    // All publishers of this participant begin with it.
    let own = gid_text(&participant.gid())[..3 * PREFIX].to_owned();
    Ok(async move {
        loop {
            let Ok(message) = std::future::poll_fn(|context| inlet.poll_take(context)).await else {
                continue;
            };
            let stage = message.status.iter().find(|status| {
                let mut values = status.values.iter();
                values.any(|value| value.key == SECOND_SOURCE && value.value.starts_with(&own))
            });
            if let Some(stage) = stage {
                let reason = format!(
                    "another source commands {} and this controller is refused: stop one of them, \
                     or give this one another stage with -p stage:=NAME; the controller ends",
                    quoted(&stage.hardware_id)
                );
                // Where the loop has ended nothing is left to end.
                let _ = control.unbounded_send(Control::End(reason));
                return;
            }
        }
    })
}

/// Why a controller that hears two stages ends: a loop over samples of both holds neither. The
/// stage that it commanded has no force once its `command_timeout` is over.
const TWO_STAGES: &str = "the samples come from two stages at once: give one of them another name \
                          with --ros-args -r __node:=NAME or -r __ns:=/NAMESPACE, or another \
                          ROS_DOMAIN_ID; the controller ends";

enum Event {
    Encoder(Result<(JointState, [u8; 16]), ReadError>),
    Setpoint(Result<JointTrajectory, ReadError>),
    Trajectory(Result<JointTrajectory, ReadError>),
    Wish(Wish<FollowJointTrajectory>),
    Measure(identify_loop::Wish),
    Control(Control),
}

#[derive(Clone, Copy)]
enum Source {
    Control,
    Wishes,
    Measurements,
    Setpoint,
    Trajectory,
    Encoder,
}

const SOURCES: &[Source] = &[
    Source::Control,
    Source::Wishes,
    Source::Measurements,
    Source::Setpoint,
    Source::Trajectory,
    Source::Encoder,
];

/// Parameters that can change while running.
struct Retuned {
    settings: ControllerSettings,
    /// Whether a loop that does not hold is stopped.
    stops: bool,
    constraints: Constraints,
    terms: CompensationTermsOn,
}

impl Retuned {
    fn of(values: &ParameterValues) -> Retuned {
        Retuned {
            settings: settings::settings(values),
            stops: values.boolean("supervision.enabled"),
            constraints: Constraints::of(values),
            terms: settings::compensation_terms(values),
        }
    }
}

/// The goals of `~/follow_joint_trajectory`: one at a time.
struct Goals {
    wishes: UnboundedReceiver<Wish<FollowJointTrajectory>>,
    news: UnboundedSender<News<FollowJointTrajectory>>,
    active: Option<ActiveGoal>,
    /// Where a goal asks for none.
    constraints: Constraints,
    /// Of the feedback, ns, and the stamp from which on the next is due.
    interval: i64,
    due: i64,
}

/// The sample that came last.
#[derive(Clone, Copy)]
struct Last {
    stamp: i64,
    position: f64,
    /// m/s
    velocity: f64,
    answered: bool,
}

/// What keeps an eye on the loop.
struct Watch {
    supervisor: Supervisor,
    /// Whether a loop that does not hold is stopped.
    stops: bool,
    stopping: Option<DampedStop>,
    delay: Delay,
    /// s
    delay_limit: f64,
    /// Of the bandwidth that the loop has now.
    share: f64,
    /// With the whole of its bandwidth.
    settings: ControllerSettings,
}

struct ControllerLoop {
    encoder: Inlet<JointState>,
    setpoint: Inlet<JointTrajectory>,
    trajectory: Inlet<JointTrajectory>,
    control: UnboundedReceiver<Control>,
    measurements: UnboundedReceiver<identify_loop::Wish>,
    /// Of the loop, while one is under way.
    measurement: Option<Measurement>,
    goals: Goals,
    force: Outlet<WrenchStamped>,
    state: Outlet<ControllerState>,
    joint_state: Outlet<JointTrajectoryControllerState>,
    /// Of its messages, ns, and the stamp from which on the next is due.
    joint_state_interval: i64,
    joint_state_due: i64,
    controller: Controller,
    compensation: Option<Compensation>,
    follower: Follower,
    joint: String,
    enabled: bool,
    /// Silent until the first setpoint.
    wait_for_setpoint: bool,
    status: Arc<Status>,
    retuned: Arc<Mutex<Option<Retuned>>>,
    jump_limit: f64,
    watch: Watch,
    /// ns
    period: i64,
    last: Option<Last>,
    /// Stamp from which on the next computation is due, ns.
    due: i64,
    held: Terms,
    sources: SourceWatch,
    /// Setpoints that came before the first sample.
    waiting: Vec<JointTrajectory>,
    /// States that wait for others, and until when.
    states: Vec<ControllerState>,
    states_due: Option<Instant>,
    setpoint_stamp: i64,
    frame: String,
}

impl ControllerLoop {
    /// Works until the node ends, or why it cannot go on.
    fn run(mut self) -> Option<String> {
        let waiter = Waiter::new();
        let mut turns = Turns::new(SOURCES);
        loop {
            // States that have waited long enough go out, however much there is to hear.
            let is_due = self.states_due.is_some_and(|due| Instant::now() >= due);
            let patience = self.states_due.into_iter().chain(self.held_until()).min();
            let event = if is_due {
                None
            } else {
                waiter.wait(patience, |context| self.poll(&mut turns, context))
            };
            match event {
                None => {
                    self.publish_states();
                    self.settle();
                }
                Some(Event::Encoder(Ok((_, publisher)))) if self.sources.is_second(publisher) => {
                    self.publish_states();
                    return Some(TWO_STAGES.to_owned());
                }
                Some(Event::Encoder(Ok((message, _)))) => self.hear(&message),
                Some(Event::Encoder(Err(error))) => {
                    self.status.refuse(
                        &self.status.refused_samples,
                        format!("a sample could not be read: {error}"),
                    );
                }
                Some(Event::Setpoint(Ok(message))) => self.follow(message),
                Some(Event::Trajectory(Ok(message))) => self.follow_trajectory(&message),
                Some(Event::Wish(wish)) => self.consider(wish),
                Some(Event::Measure(wish)) => self.begin_measurement(wish),
                Some(Event::Setpoint(Err(error)) | Event::Trajectory(Err(error))) => {
                    self.status.refuse(
                        &self.status.refused_setpoints,
                        format!("a setpoint could not be read: {error}"),
                    );
                }
                Some(Event::Control(Control::Shutdown)) => {
                    self.publish_states();
                    // A writer that ends can repeat nothing.
                    std::thread::sleep(LINGER);
                    return None;
                }
                Some(Event::Control(Control::End(reason))) => {
                    self.publish_states();
                    return Some(reason);
                }
                Some(Event::Control(control)) => self.handle(control),
            }
        }
    }

    fn poll(&mut self, turns: &mut Turns<Source>, context: &mut Context<'_>) -> Poll<Event> {
        fn next<T>(inbox: &mut UnboundedReceiver<T>, context: &mut Context<'_>) -> Poll<Option<T>> {
            std::pin::Pin::new(inbox).poll_next(context)
        }
        turns.poll(|source| match source {
            Source::Control => next(&mut self.control, context)
                .map(|control| Event::Control(control.unwrap_or(Control::Shutdown))),
            // Where nobody can ask any more, nothing comes.
            Source::Wishes => match next(&mut self.goals.wishes, context) {
                Poll::Ready(Some(wish)) => Poll::Ready(Event::Wish(wish)),
                _ => Poll::Pending,
            },
            Source::Measurements => match next(&mut self.measurements, context) {
                Poll::Ready(Some(wish)) => Poll::Ready(Event::Measure(wish)),
                _ => Poll::Pending,
            },
            Source::Setpoint => self.setpoint.poll_take(context).map(Event::Setpoint),
            Source::Trajectory => self.trajectory.poll_take(context).map(Event::Trajectory),
            Source::Encoder => self.encoder.poll_take_from(context).map(Event::Encoder),
        })
    }

    /// Forgets integral and lowpass, and how the bristles of the compensation are loaded.
    fn forget(&mut self) {
        self.give_up_measurement("the stage or the controller was reset");
        self.controller.reset();
        if let Some(compensation) = &mut self.compensation {
            compensation.reset();
        }
    }

    fn hear(&mut self, message: &JointState) {
        let stamp = message.header.stamp.to_nanos();
        let index = message.name.iter().position(|name| *name == self.joint);
        let Some(position) =
            index.and_then(|index| message.position.get(index)).copied().filter(|x| x.abs() < FAR)
        else {
            let (joint, names) = (&self.joint, message.name.join(", "));
            let reason = format!(
                "the sample of {stamp} ns has no finite position of joint `{joint}` among \
                 [{}]",
                quoted(&names)
            );
            return self.status.refuse(&self.status.refused_samples, reason);
        };
        self.status.hear(stamp);
        if self.frame.is_empty() {
            self.frame.clone_from(&message.header.frame_id);
        }
        let velocity = index.and_then(|index| message.velocity.get(index)).copied();
        let velocity = velocity.filter(|velocity| velocity.is_finite()).unwrap_or_else(|| {
            self.last.filter(|last| stamp > last.stamp).map_or(0.0, |last| {
                (position - last.position) / ((stamp - last.stamp) as f64 * 1e-9)
            })
        });
        match self.last {
            None => {
                self.follower.hold(stamp, position);
                self.due = stamp;
            }
            // Sent again because the answer is missing.
            Some(last) if last.stamp == stamp && last.answered => return self.answer(stamp),
            Some(last) if stamp < last.stamp => {
                let count = self.status.restarts.fetch_add(1, Ordering::Relaxed) + 1;
                if count.is_power_of_two() {
                    let from = last.stamp;
                    tracing::warn!(
                        "time goes back from {from} to {stamp} ns: the stage was started again; \
                         holding ({count} so far)"
                    );
                }
                self.forget();
                self.follower.hold(stamp, position);
                self.due = stamp;
                (self.goals.due, self.joint_state_due) = (i64::MIN, i64::MIN);
                self.give_up(follow::INVALID_GOAL, "The stage was started again.");
            }
            // No stage moves like that: it was put elsewhere, as `~/reset` does.
            Some(last) if self.is_displaced(&last, stamp, position) => {
                let count = self.status.displaced.fetch_add(1, Ordering::Relaxed) + 1;
                if count.is_power_of_two() {
                    tracing::warn!(
                        "the stage was at {:.6} m and is at {position:.6} m: it was reset; \
                         holding ({count} so far)",
                        last.position
                    );
                }
                self.forget();
                self.watch.supervisor.reset();
                self.follower.hold(stamp, position);
                self.give_up(follow::INVALID_GOAL, "The stage was reset.");
            }
            Some(last) if stamp - last.stamp > self.period + self.period / 2 => {
                let count = self.status.slow_samples.fetch_add(1, Ordering::Relaxed) + 1;
                if count.is_power_of_two() {
                    let gap = (stamp - last.stamp) as f64 * 1e-6;
                    let rate = self.controller.settings().rate;
                    tracing::warn!(
                        "{gap} ms between two samples, too slow for a controller at {rate} Hz \
                         ({count} so far)"
                    );
                }
            }
            Some(_) => {}
        }
        self.last = Some(Last { stamp, position, velocity, answered: false });
        for setpoint in std::mem::take(&mut self.waiting) {
            self.follow(setpoint);
        }
        if self.last.is_some_and(|last| !last.answered) {
            self.compute();
        }
    }

    /// Whether a stage that was at `last` cannot have come to `position` by moving: the jump is
    /// larger than a single setpoint's may be and than what velocity and largest force explain.
    fn is_displaced(&self, last: &Last, stamp: i64, position: f64) -> bool {
        let elapsed = (stamp - last.stamp).max(0) as f64 * 1e-9;
        let ControllerSettings { limits, mass_feedforward, .. } = self.controller.settings();
        let acceleration = limits.1.max(-limits.0) / mass_feedforward.max(1.0);
        let way = self.jump_limit.max(1e-3)
            + 1.5 * last.velocity.abs() * elapsed
            + acceleration * elapsed * elapsed;
        (position - last.position).abs() > way
    }

    /// Gives up bandwidth while samples come late, and takes it back when they do not.
    fn fit_to_delay(&mut self, stamp: i64) {
        let watch = &mut self.watch;
        let delay = watch.delay.observe(stamp, clock::system());
        let share = (watch.delay_limit / delay.max(1e-9)).clamp(LEAST_SHARE, 1.0);
        let changed = (share / watch.share - 1.0).abs();
        if changed > 0.2 || share == 1.0 && changed > 0.0 {
            if watch.share == 1.0 {
                let count = self.status.late.fetch_add(1, Ordering::Relaxed) + 1;
                if count.is_power_of_two() {
                    tracing::warn!(
                        "samples come {:.1} ms late: the loop gives up bandwidth, the machine is \
                         too busy ({count} times so far)",
                        1e3 * delay
                    );
                }
            }
            watch.share = share;
            // Less of valid gains is valid.
            let _ = self.controller.retune(watch.settings.slowed(share));
        }
        self.status.delay_us.store((1e6 * delay) as u64, Ordering::Relaxed);
        self.status.share_ppm.store((1e6 * share) as u64, Ordering::Relaxed);
    }

    /// Judges the terms that were worked out; what is sent is safe.
    fn supervise(&mut self, velocity: f64) {
        let health = self.watch.supervisor.observe(&self.held);
        let cause = match health {
            Health::Fine => {
                *lock(&self.status.warning) = None;
                *lock(&self.status.error) = None;
                return;
            }
            Health::Warning(cause) => {
                *lock(&self.status.error) = None;
                let warning = cause.to_string();
                let mut last = lock(&self.status.warning);
                if last.is_none() {
                    tracing::warn!("{warning}");
                }
                *last = Some(warning);
                return;
            }
            Health::Stop(cause) => cause,
        };
        if !self.watch.stops && cause != Cause::NotFinite {
            let last = lock(&self.status.error).replace(cause.to_string());
            if last.is_none() {
                tracing::error!("{cause}; the loop continues (supervision.enabled is false)");
            }
            return;
        }
        self.give_up_measurement(&format!("the supervision stopped the stage: {cause}"));
        tracing::error!(
            "{cause}: damped stop; `~/enable` with true starts the loop again (supervision.* say \
             what is allowed)"
        );
        *lock(&self.status.warning) = None;
        *lock(&self.status.error) = None;
        *lock(&self.status.fault) = Some(format!("stopped: {cause}"));
        self.give_up(follow::PATH_TOLERANCE_VIOLATED, &format!("Aborted: {cause}"));
        let settings = self.controller.settings();
        // The mass of the feedforward is the best that is known of the stage.
        let mass = if settings.mass_feedforward > 0.0 { settings.mass_feedforward } else { 1.0 };
        let mut stop = DampedStop::new(mass, settings.limits, settings.rate.recip());
        self.held.output = stop.force(velocity).unwrap_or(0.0);
        self.watch.stopping = Some(stop);
        self.forget();
    }

    /// Computes and answers the last sample.
    fn compute(&mut self) {
        let Some(last) = &mut self.last else { return };
        let (stamp, position, velocity) = (last.stamp, last.position, last.velocity);
        let silent = !self.enabled || self.wait_for_setpoint;
        last.answered = !silent;
        self.status.enter(match (self.enabled, self.wait_for_setpoint) {
            (false, _) => Phase::Disabled,
            (true, true) => Phase::WaitingForSetpoint,
            (true, false) => Phase::Answered,
        });
        if silent {
            self.held = Terms { reference: self.follower.at(stamp), position, ..Terms::default() };
            self.held.error = self.held.reference.position - position;
            return self.tell(stamp);
        }
        // A thousandth of a period is below any rounding of stamps to nanoseconds.
        if stamp >= self.due - self.period / 1000 {
            match &mut self.watch.stopping {
                None => {
                    self.fit_to_delay(stamp);
                    self.held = self.controller.update_with(
                        stamp,
                        position,
                        &mut self.follower,
                        self.compensation.as_mut(),
                    );
                    self.supervise(velocity);
                    self.judge_goal(stamp, position, velocity);
                    self.measure(stamp);
                }
                Some(stop) => match stop.force(velocity) {
                    Some(force) => {
                        self.held = Terms { position, output: force, ..Terms::default() };
                    }
                    // At rest: silent from here on, as a disabled controller is.
                    None => {
                        self.watch.stopping = None;
                        self.enabled = false;
                        self.held = Terms { position, ..Terms::default() };
                    }
                },
            }
            let late = stamp - self.due;
            self.due = if late > self.period { stamp } else { self.due } + self.period;
            self.status.saturated.fetch_add(u64::from(self.held.saturated), Ordering::Relaxed);
            self.status.answered.fetch_add(1, Ordering::Relaxed);
        }
        self.answer(stamp);
        self.tell(stamp);
    }

    /// Begins to measure the loop, where it holds.
    fn begin_measurement(&mut self, wish: identify_loop::Wish) {
        let moving = |last: Last| self.follower.is_moving(last.stamp);
        let obstacle = if !self.enabled {
            "the controller is not enabled"
        } else if self.watch.stopping.is_some() {
            "the supervision stops the stage"
        } else if self.wait_for_setpoint {
            "the controller waits for its first setpoint"
        } else if self.measurement.is_some() {
            "a measurement is already under way"
        } else if self.watch.share < 1.0 {
            "samples come late, and the loop has given up bandwidth"
        } else if self.goals.active.is_some() || self.last.is_some_and(moving) {
            "a motion is followed: wait for its end"
        } else if self.last.is_none() {
            "no sample of the stage has come yet"
        } else {
            let (settings, reference) = (self.controller.settings(), self.held.reference);
            self.measurement = Some(Measurement::new(wish, settings, reference));
            return;
        };
        wish.refuse(obstacle);
    }

    /// Adds what a measurement of the loop wants, if one is under way.
    fn measure(&mut self, stamp: i64) {
        let Some(measurement) = &mut self.measurement else { return };
        match measurement.update(stamp, &self.held, self.controller.settings()) {
            identify_loop::Progress::Add(force) => {
                self.held.reference.effort += force;
                self.held.output += force;
            }
            identify_loop::Progress::Over => self.end_measurement(None),
            identify_loop::Progress::Failed(why) => self.end_measurement(Some(why)),
        }
    }

    fn give_up_measurement(&mut self, why: &str) {
        self.end_measurement(Some(why.to_owned()));
    }

    fn end_measurement(&mut self, failure: Option<String>) {
        if let Some(measurement) = self.measurement.take() {
            if let Some(why) = &failure {
                tracing::warn!("the measurement of the loop ended: {why}");
            }
            measurement.end(failure);
        }
    }

    fn answer(&mut self, stamp: i64) {
        let message =
            WrenchStamped::along_x(Header::new(stamp, self.frame.as_str()), self.held.output);
        if self.force.publish(message) == Published::Held && !self.force.settle(SETTLE) {
            tracing::error!("{}: the stage got no answer for {SETTLE:?}", self.force.name());
        }
    }

    fn tell(&mut self, stamp: i64) {
        if stamp >= self.joint_state_due {
            self.joint_state_due = next_due(self.joint_state_due, stamp, self.joint_state_interval);
            let sampled = self.sampled(stamp, self.setpoint_stamp);
            let _ = self.joint_state.publish(sampled.state());
        }
        let header = Header::new(stamp, self.frame.as_str());
        let answered = self.status.answered.load(Ordering::Relaxed);
        let state =
            controller_state(header, answered, &self.held, self.enabled, self.setpoint_stamp);
        self.states.push(state);
        self.states_due.get_or_insert_with(|| Instant::now() + BURST_WITHIN);
        if self.states.len() >= BURST {
            self.publish_states();
        }
    }

    fn publish_states(&mut self) {
        self.states_due = None;
        let Some(stamp) = self.states.last().map(|state| state.header.stamp.to_nanos()) else {
            return;
        };
        for state in self.states.drain(..) {
            let _ = self.state.publish(state);
        }
        // There the stage waits for the next answer, and so for these subscribers.
        if stamp < LOCKSTEP_BELOW {
            let until = Instant::now() + PACE_WITHIN;
            self.force.keep_pace(until);
            self.state.keep_pace(until);
            self.joint_state.keep_pace(until);
        }
    }

    /// When something that an outlet holds can be sent, at the earliest.
    fn held_until(&self) -> Option<Instant> {
        let outlets =
            [self.force.held_until(), self.state.held_until(), self.joint_state.held_until()];
        outlets.into_iter().flatten().min()
    }

    /// Sends what outlets hold, as far as its time has come. A stage in lockstep may wait for it,
    /// and then no sample comes with which more would be published.
    fn settle(&mut self) {
        self.force.settle(Duration::ZERO);
        self.state.settle(Duration::ZERO);
        self.joint_state.settle(Duration::ZERO);
    }

    fn follow(&mut self, message: JointTrajectory) {
        let Some(last) = self.last else {
            // Where it may lead depends on where the stage is: judged with the first sample.
            return self.waiting.push(message);
        };
        match self.adopt(&message, last.stamp) {
            Ok(_) => {
                self.preempt("Current goal preempted by a setpoint.");
                self.begin(last);
            }
            Err(reason) => self.refuse_setpoint("setpoint", &reason.to_string()),
        }
    }

    fn refuse_setpoint(&self, topic: &str, reason: &str) {
        self.status.refuse(&self.status.refused_setpoints, format!("{topic}: {reason}"));
    }

    /// Gives the follower what a message asks for; start and end of the motion, ns.
    fn adopt(&mut self, message: &JointTrajectory, now: i64) -> Result<(i64, i64), SetpointError> {
        let (start, end, followed) = match setpoint(message, &self.joint, now)? {
            Setpoint::Now(reference) => (now, now, self.follower.set(now, reference)),
            Setpoint::Motion(motion) => {
                (motion.start(), motion.end(), self.follower.follow(now, motion))
            }
        };
        followed?;
        self.setpoint_stamp = start;
        Ok((start, end))
    }

    /// After a setpoint was accepted: answers the sample that waits for it.
    fn begin(&mut self, last: Last) {
        let was_waiting = std::mem::take(&mut self.wait_for_setpoint);
        if !self.enabled {
            self.tell(last.stamp);
        } else if was_waiting && !last.answered {
            self.due = last.stamp;
            self.compute();
        }
    }

    /// `~/joint_trajectory`: a setpoint by the rules of joint_trajectory_controller.
    fn follow_trajectory(&mut self, message: &JointTrajectory) {
        let Some(last) = self.last else {
            return self.refuse_setpoint("joint_trajectory", NO_SAMPLE);
        };
        let followed = match self.enabled {
            true => self.judge_and_adopt(message, last.stamp),
            false => Err(FollowResult::new(follow::INVALID_GOAL, NOT_RUNNING)),
        };
        match followed {
            Ok(_) => {
                self.preempt("Current goal preempted by a trajectory.");
                self.begin(last);
            }
            Err(why) => self.refuse_setpoint("joint_trajectory", &why.error_string),
        }
    }

    fn judge_and_adopt(
        &mut self,
        message: &JointTrajectory,
        now: i64,
    ) -> Result<(i64, i64), FollowResult> {
        follow::check(message, &self.joint, now)?;
        self.adopt(message, now).map_err(|error| {
            let code = match error {
                SetpointError::Trajectory(TrajectoryError::Past { .. }) => {
                    follow::OLD_HEADER_TIMESTAMP
                }
                SetpointError::WrongJoint { .. } => follow::INVALID_JOINTS,
                _ => follow::INVALID_GOAL,
            };
            FollowResult::new(code, error.to_string())
        })
    }

    /// Answers a client of `~/follow_joint_trajectory`.
    fn consider(&mut self, wish: Wish<FollowJointTrajectory>) {
        match wish {
            Wish::Goal { id, goal, reply } => {
                let (answer, last) = (self.take_on(id, &goal), self.last);
                if let Err(why) = &answer {
                    let reason = format!("goal: {}", why.error_string);
                    self.status.refuse(&self.status.refused_goals, reason);
                }
                let accepted = answer.is_ok();
                let _ = reply.send(answer);
                // What it brings comes after the answer.
                if let (true, Some(last)) = (accepted, last) {
                    self.begin(last);
                }
            }
            Wish::Cancel { id, reply } => {
                let active = self.goals.active.as_ref().is_some_and(|goal| goal.id == id);
                if active {
                    self.hold_here();
                    self.end_goal(GoalEnd::Canceled, FollowResult::default());
                }
                let _ = reply.send(active);
            }
        }
    }

    fn take_on(&mut self, id: GoalId, goal: &FollowGoal) -> Result<(), FollowResult> {
        if !self.enabled {
            return Err(FollowResult::new(follow::INVALID_GOAL, NOT_RUNNING));
        }
        let Some(last) = self.last else {
            return Err(FollowResult::new(follow::INVALID_GOAL, NO_SAMPLE));
        };
        if let Some(name) = goal.multi_dof_trajectory.joint_names.first() {
            let text = format!("Incoming joint {name} doesn't match the controller's joints.");
            return Err(FollowResult::new(follow::INVALID_JOINTS, text));
        }
        let (start, end) = self.judge_and_adopt(&goal.trajectory, last.stamp)?;
        self.preempt("Current goal preempted by new incoming action.");
        let constraints = self.goals.constraints.asked_by(goal, &self.joint);
        self.goals.active = Some(ActiveGoal::new(id, start, end, constraints));
        self.goals.due = i64::MIN;
        Ok(())
    }

    /// What follows takes the place of the goal that is followed.
    fn preempt(&mut self, why: &str) {
        self.end_goal(GoalEnd::Aborted, FollowResult::new(follow::INVALID_GOAL, why));
    }

    /// Ends the goal that is followed as failed.
    fn give_up(&mut self, code: i32, why: &str) {
        self.end_goal(GoalEnd::Aborted, FollowResult::new(code, why));
    }

    fn end_goal(&mut self, end: GoalEnd, result: FollowResult) {
        let Some(goal) = self.goals.active.take() else { return };
        self.status.ended_goals.fetch_add(1, Ordering::Relaxed);
        if end == GoalEnd::Aborted {
            tracing::warn!("goal aborted, {}: {}", result.error_code, result.error_string);
        }
        // Without a receiver the node is shutting down.
        let _ = self.goals.news.unbounded_send(News::Ended(goal.id, end, result));
    }

    fn hold_here(&mut self) {
        if let Some(Last { stamp, position, .. }) = self.last {
            self.follower.hold(stamp, position);
        }
    }

    /// Judges the goal that is followed by the sample that was just computed.
    fn judge_goal(&mut self, stamp: i64, position: f64, velocity: f64) {
        let reference = self.held.reference;
        let error = (reference.position - position, reference.velocity - velocity);
        let Some(goal) = &mut self.goals.active else { return };
        let (start, progress) = (goal.start, goal.judge(stamp, error));
        if stamp >= self.goals.due {
            self.goals.due = next_due(self.goals.due, stamp, self.goals.interval);
            let (id, feedback) = (goal.id, self.sampled(stamp, start).feedback());
            let _ = self.goals.news.unbounded_send(News::Feedback(id, feedback));
        }
        match progress {
            Progress::Going => {}
            Progress::Reached(result) => self.end_goal(GoalEnd::Succeeded, result),
            Progress::Failed(result) => {
                self.hold_here();
                self.end_goal(GoalEnd::Aborted, result);
            }
        }
    }

    /// The last sample with its reference, for a motion that began at `start`, ns.
    fn sampled(&self, stamp: i64, start: i64) -> Sampled {
        let (position, velocity) =
            self.last.map_or((0.0, 0.0), |last| (last.position, last.velocity));
        Sampled {
            header: Header::new(stamp, self.frame.as_str()),
            joint: self.joint.clone(),
            time_from_start: Span::from_nanos(stamp - start),
            reference: self.held.reference,
            actual: (position, velocity),
            output: self.held.output,
        }
    }

    fn handle(&mut self, control: Control) {
        match control {
            Control::Enable(enabled) if enabled && !self.enabled => {
                self.enabled = true;
                self.forget();
                self.watch.supervisor.reset();
                self.watch.stopping = None;
                *lock(&self.status.fault) = None;
                if let Some(Last { stamp, position, answered, .. }) = self.last {
                    self.due = stamp;
                    if self.follower.has_begun(stamp) {
                        self.follower.hold(stamp, position);
                    }
                    if !answered {
                        self.compute();
                    }
                }
            }
            Control::Enable(enabled) => {
                self.enabled = enabled;
                if !enabled {
                    self.give_up_measurement("the controller was disabled");
                    let why = "Current goal cancelled during deactivate transition.";
                    self.give_up(follow::INVALID_GOAL, why);
                }
            }
            Control::Bandwidth(_, reply) | Control::Move(_, reply) => {
                let _ = reply.send(Err("only a stage has a live page".to_owned()));
            }
            Control::Reset(reply) => {
                self.forget();
                let message = match self.last {
                    Some(Last { stamp, position, .. }) => {
                        self.follower.hold(stamp, position);
                        format!("integral and lowpass forgotten, holding {position} m")
                    }
                    None => "integral and lowpass forgotten".to_owned(),
                };
                self.give_up(follow::INVALID_GOAL, "The controller was reset.");
                let _ = reply.send(Ok(message));
            }
            Control::Retune => {
                let Some(retuned) = lock(&self.retuned).take() else { return };
                let Retuned { settings: wanted, stops, constraints, terms } = retuned;
                self.watch.stops = stops;
                self.goals.constraints = constraints;
                let wanted = match &mut self.compensation {
                    Some(compensation) => {
                        compensation.switch(terms);
                        wanted.informed(compensation)
                    }
                    None => wanted,
                };
                match self.controller.retune(wanted.slowed(self.watch.share)) {
                    Ok(()) => self.watch.settings = wanted,
                    Err(error) => tracing::error!("parameters were not taken over: {error}"),
                }
            }
            // Of the stage.
            Control::Pause(..) | Control::Step(_) | Control::StopSteps => {}
            Control::End(_) | Control::Shutdown => {}
        }
    }
}

/// When the next is due after one that was due at `due` and came at `now`, ns.
fn next_due(due: i64, now: i64, interval: i64) -> i64 {
    let next = due.saturating_add(interval);
    if next > now { next } else { now + interval }
}
