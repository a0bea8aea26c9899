//! The stage in real time: three threads and the rings between them.
//!
//! The tick thread integrates at absolute deadlines. It never publishes, allocates, locks or
//! writes: samples leave it through one ring, orders reach it through another. The publishing
//! thread empties the first; the command thread judges what comes in and fills the second.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{JoinHandle, Thread};
use std::time::{Duration, Instant};

use super::clock::{self, Ticks};
use super::commands::{Arbiter, StampRule};
use super::control::Control;
use super::live::{LiveFeed, SharedFollower};
use super::lock::lock;
use super::recorder::TickFeed;
use super::stage::{LiveSettings, StageLoop};
use super::stage_inbox::{Event, Inbox};
use super::stage_outlets::StageOutlets;
use super::stage_settings::{Drive, SERVO_BANDWIDTH, StageSettings};
use super::stage_status::{StageStatus, is_logged};
use super::waiter::Waiter;
use super::wire::{Setpoint, Tick, setpoint};
use friction_stage_core::control::{
    Controller, ControllerSettings, DampedStop, Follower, Gains, Health, Point, Supervisor,
    SupervisorSettings, Trajectory,
};
use friction_stage_core::plant::{Sample, Stage};
use friction_stage_report::words::in_prefix;

/// Samples that may wait for the publishing thread: 0.8 s at 10 kHz.
const SAMPLES: usize = 8192;
/// Orders that may wait for the tick thread.
const ORDERS: usize = 4096;
/// Longest sleep of the publishing thread without a sample.
const NAP: Duration = Duration::from_millis(20);
/// Interval at which the publishing thread hands over its counters.
const COUNT: Duration = Duration::from_millis(100);
/// Lateness beyond which missed ticks are given up instead of caught up, ns: the process was
/// stopped.
const GIVE_UP: i64 = 200_000_000;

/// What the command thread tells the tick thread. `Copy` or boxed beforehand: taking one allocates
/// nothing.
enum Order {
    /// Hold this force, N.
    Force(f64),
    Enable(bool),
    Reset,
    /// Follow this; the old one goes back to be dropped elsewhere.
    Follow(Box<Follower>),
    /// Checked settings for the stage's own loop, which own nothing themselves.
    Retune(Box<ControllerSettings>),
    Shutdown,
}

/// What the tick thread hands back.
enum Return {
    /// To be dropped.
    Follower(#[expect(dead_code, reason = "only dropped")] Box<Follower>),
    Settings(#[expect(dead_code, reason = "only dropped")] Box<ControllerSettings>),
    /// How the stage's own loop does.
    Health(Health),
}

/// The stage's own position loop: a PID at `servo_bandwidth` for everything that the motor moves,
/// and its supervision.
#[derive(Clone)]
struct Servo {
    controller: Controller,
    follower: Box<Follower>,
    supervisor: Supervisor,
    health: Health,
    /// Samples since it was last reported.
    reported: u32,
    /// It has been stopped; over when this gives no force.
    stop: Option<DampedStop>,
}

impl Servo {
    fn new(settings: &StageSettings) -> anyhow::Result<Servo> {
        let mass = moved_mass(settings);
        let (rate, limit) = (settings.rates.control(), settings.model.motor.force_limit);
        let paper = ControllerSettings::paper(mass, rate, limit);
        let gains = Gains::from_bandwidth(settings.servo_bandwidth, mass);
        let follower = Follower::new(settings.setpoint_jump_limit);
        let follower = match settings.model.stroke {
            Some(stroke) => follower.within(stroke.low, stroke.high),
            None => follower,
        };
        let controller = Controller::new(ControllerSettings { gains, ..paper })?;
        Ok(Servo {
            supervisor: Servo::supervisor(controller.settings()),
            controller,
            follower: Box::new(follower),
            health: Health::Fine,
            reported: 0,
            stop: None,
        })
    }

    /// A slow loop has large errors: one at which its proportional part asks for a tenth of the
    /// largest force is allowed. Assumed.
    fn supervisor(settings: &ControllerSettings) -> Supervisor {
        let limit = settings.limits.1;
        let usual = SupervisorSettings::new(settings.rate, limit);
        let error = usual.error.max(0.1 * limit / settings.gains.p);
        Supervisor::new(SupervisorSettings { error, ..usual })
    }

    /// Takes settings that were checked where they come from: nothing is refused.
    fn retune(&mut self, settings: &ControllerSettings) {
        let _ = self.controller.retune(settings.clone());
        self.supervisor = Servo::supervisor(settings);
    }

    /// Begins again, at `position`, m.
    fn hold(&mut self, time: i64, position: f64) {
        self.controller.reset();
        self.supervisor.reset();
        self.health = Health::Fine;
        self.stop = None;
        self.follower.hold(time, position);
    }

    /// The force for a sample, N, and how the loop does, where that is news.
    fn update(&mut self, sample: &Sample) -> (f64, Option<Health>) {
        if let Some(stop) = &mut self.stop {
            return (stop.force(sample.velocity).unwrap_or(0.0), None);
        }
        let terms = self.controller.update(sample.time, sample.position, &mut self.follower);
        let health = self.supervisor.observe(&terms);
        let is_other = std::mem::discriminant(&health) != std::mem::discriminant(&self.health);
        self.health = health;
        // The numbers of a warning change while it lasts.
        self.reported += 1;
        let is_due = f64::from(self.reported) >= self.controller.settings().rate * NEWS;
        let is_news = is_other || is_due && health != Health::Fine;
        if is_news {
            self.reported = 0;
        }
        let force = match health {
            Health::Stop(_) => {
                let settings = self.controller.settings();
                let period = settings.rate.recip();
                let mut stop = DampedStop::new(settings.mass_feedforward, settings.limits, period);
                let force = stop.force(sample.velocity).unwrap_or(0.0);
                self.stop = Some(stop);
                force
            }
            Health::Fine | Health::Warning(_) => terms.output,
        };
        (force, is_news.then_some(health))
    }
}

/// Interval at which the state of a loop that does not hold is reported, s.
const NEWS: f64 = 0.1;
/// Answer to a wish that only a stage with its own loop can fulfil.
const NO_SERVO: &str = "drive: force: another node controls this stage";
/// Largest step from the live page, m. Assumed: a fifth of the paper's move.
const LARGEST_STEP: f64 = 0.01;
/// Time of the paper's fine step, s; longer steps have the acceleration of its fast move, 50 mm
/// in 100 ms.
const SHORTEST_STEP: f64 = 3e-3;

impl StageLoop {
    /// Runs in real time until shutdown.
    pub fn run_realtime(self) -> anyhow::Result<()> {
        let StageLoop { stage, settings, outlets, inbox, feed, status, live, live_page, followed } =
            self;
        let (samples_in, samples_out) = rtrb::RingBuffer::new(SAMPLES);
        let (orders_in, orders_out) = rtrb::RingBuffer::new(ORDERS);
        let (returns_in, returns_out) = rtrb::RingBuffer::new(ORDERS);
        let servo = match settings.drive {
            Drive::Force => None,
            Drive::Servo => Some(Servo::new(&settings)?),
        };
        let finished = Arc::new(AtomicBool::new(false));
        let publishing = {
            let (finished, live) = (finished.clone(), live.clone());
            let work = move || publish(samples_out, outlets, feed, live_page, &live, &finished);
            std::thread::Builder::new().name("publish".to_owned()).spawn(work)?
        };
        let epoch = clock::system();
        let ticking: JoinHandle<()> = {
            let (status, live, publisher) =
                (status.clone(), live.clone(), publishing.thread().clone());
            let (servo, real_time) = (servo.clone(), settings.priority > 0);
            let work = move || {
                let mut tick = TickThread {
                    stage,
                    servo,
                    real_time,
                    epoch,
                    orders: orders_out,
                    returns: returns_in,
                    samples: samples_in,
                    publisher,
                    status,
                    live,
                };
                tick.run();
            };
            std::thread::Builder::new().name("tick".to_owned()).spawn(work)?
        };
        let (controller, follower) = match servo {
            Some(servo) => (Some(servo.controller.settings().clone()), Some(servo.follower)),
            None => (None, None),
        };
        *lock(&followed) = follower.as_deref().cloned();
        CommandThread {
            settings,
            inbox,
            orders: orders_in,
            returns: returns_out,
            follower,
            controller,
            followed,
            health: Health::Fine,
            epoch,
            status,
            live,
        }
        .run();
        let ended = ticking.join();
        finished.store(true, Ordering::Release);
        publishing.thread().unpark();
        let published = publishing.join();
        anyhow::ensure!(
            ended.is_ok() && published.is_ok(),
            "a thread of the stage ended by a panic"
        );
        Ok(())
    }
}

/// All that the motor moves, kg.
fn moved_mass(settings: &StageSettings) -> f64 {
    settings.model.mass
        + settings.model.coupling.as_ref().map_or(0.0, |coupling| coupling.motor_mass)
}

struct TickThread {
    stage: Stage,
    servo: Option<Servo>,
    /// A real-time priority is asked for.
    real_time: bool,
    /// System time of sample 0, ns.
    epoch: i64,
    orders: rtrb::Consumer<Order>,
    returns: rtrb::Producer<Return>,
    samples: rtrb::Producer<Tick>,
    publisher: Thread,
    status: Arc<StageStatus>,
    live: Arc<LiveSettings>,
}

impl TickThread {
    fn run(&mut self) {
        let fifo = clock::prepare_tick_thread(self.real_time);
        self.status.real_time_scheduling.store(fifo, Ordering::Relaxed);
        let rate = self.stage.rates().control();
        let period = (1e9 / rate) as i64;
        let mut ticks = Ticks::new(clock::monotonic(), rate);
        let (mut force, mut enabled, mut last_command) = (0.0, true, None::<i64>);
        loop {
            let late = ticks.wait();
            self.status.ticks.record(late, period);
            if late > GIVE_UP {
                ticks.resynchronise();
            }
            while let Ok(order) = self.orders.pop() {
                match order {
                    Order::Force(wanted) => {
                        force = wanted;
                        last_command = Some(clock::monotonic());
                        self.status.commanded.store(true, Ordering::Relaxed);
                        self.status.is_stale.store(false, Ordering::Relaxed);
                    }
                    Order::Enable(wanted) => {
                        enabled = wanted;
                        self.status.disabled.store(!wanted, Ordering::Relaxed);
                        if let Some(servo) = &mut self.servo {
                            servo.hold(0, self.stage.body().position());
                        }
                    }
                    Order::Reset => {
                        self.stage.reset();
                        (force, last_command) = (0.0, None);
                        if let Some(servo) = &mut self.servo {
                            servo.hold(0, 0.0);
                        }
                    }
                    Order::Follow(mut next) => {
                        if let Some(servo) = &mut self.servo {
                            std::mem::swap(&mut servo.follower, &mut next);
                        }
                        // Full only if the command thread has died; then dropping here is the least
                        // of the troubles.
                        let _ = self.returns.push(Return::Follower(next));
                    }
                    Order::Retune(settings) => {
                        if let Some(servo) = &mut self.servo {
                            servo.retune(&settings);
                        }
                        let _ = self.returns.push(Return::Settings(settings));
                    }
                    Order::Shutdown => return,
                }
            }
            if let Some(at) = last_command
                && clock::monotonic() - at > self.live.command_timeout().as_nanos() as i64
            {
                (force, last_command) = (0.0, None);
                self.status.stale.fetch_add(1, Ordering::Relaxed);
                self.status.is_stale.store(true, Ordering::Relaxed);
            }
            let sample = self.stage.sample();
            let tick = Tick { stamp: self.epoch + sample.time, sample, state: self.stage.state() };
            self.status.sample.store(sample.index, Ordering::Relaxed);
            self.status.stamp.store(tick.stamp, Ordering::Relaxed);
            self.status.set_motion(&tick.state);
            if self.samples.push(tick).is_err() {
                self.status.unpublished.fetch_add(1, Ordering::Relaxed);
            }
            self.publisher.unpark();
            if let Some(servo) = self.servo.as_mut().filter(|_| enabled) {
                if sample.index == 0 {
                    servo.hold(sample.time, sample.position);
                }
                let (wanted, health) = servo.update(&sample);
                force = wanted;
                if let Some(health) = health {
                    let _ = self.returns.push(Return::Health(health));
                }
            }
            self.stage.advance(if enabled { force } else { 0.0 });
            self.status.clamped.store(self.stage.clamped(), Ordering::Relaxed);
        }
    }
}

fn publish(
    mut samples: rtrb::Consumer<Tick>,
    mut outlets: StageOutlets,
    mut feed: TickFeed,
    mut live_page: Option<LiveFeed>,
    live: &LiveSettings,
    finished: &AtomicBool,
) {
    let mut counted = Instant::now();
    loop {
        let over = finished.load(Ordering::Acquire);
        while let Ok(tick) = samples.pop() {
            outlets.publish(&tick);
            feed.offer(&tick);
            if let Some(page) = &mut live_page {
                page.offer(&tick);
            }
        }
        if over {
            return;
        }
        if counted.elapsed() >= COUNT {
            live.set_counts(outlets.counts());
            counted = Instant::now();
        }
        std::thread::park_timeout(NAP);
    }
}

struct CommandThread {
    settings: StageSettings,
    inbox: Inbox,
    orders: rtrb::Producer<Order>,
    returns: rtrb::Consumer<Return>,
    /// What the tick thread follows in `drive: servo`, kept here to build the next one from.
    follower: Option<Box<Follower>>,
    /// Of the controller in `drive: servo`.
    controller: Option<ControllerSettings>,
    followed: SharedFollower,
    /// How that loop does.
    health: Health,
    epoch: i64,
    status: Arc<StageStatus>,
    live: Arc<LiveSettings>,
}

impl CommandThread {
    fn run(mut self) {
        let mut arbiter = Arbiter::new(self.live.command_timeout().as_nanos() as i64);
        let waiter = Waiter::new();
        let mut was_stale = false;
        loop {
            // Wakes up now and then to drop what the tick thread is done with and to tell of
            // commands that stopped.
            let event = self.inbox.next(&waiter, Some(Instant::now() + NAP));
            while let Ok(returned) = self.returns.pop() {
                if let Return::Health(health) = returned {
                    self.health = health;
                    self.status.set_servo(health);
                }
            }
            let stale = self.status.is_stale.load(Ordering::Relaxed);
            let times = self.status.stale.load(Ordering::Relaxed);
            if stale && !was_stale && is_logged(times) {
                tracing::warn!(
                    "commands have stopped for {:?}: motor force is zero ({times} times so far)",
                    self.live.command_timeout()
                );
            }
            was_stale = stale;
            match event {
                None => {}
                Some(Event::Command(source, Ok(command))) => {
                    if self.settings.drive == Drive::Servo {
                        self.status.refuse(&format!(
                            "{}: the stage drives itself (drive: servo)",
                            source.topic
                        ));
                        continue;
                    }
                    let since = self.status.stamp.load(Ordering::Relaxed);
                    match arbiter.judge(
                        source,
                        command,
                        StampRule::NotBack,
                        clock::monotonic(),
                        since,
                    ) {
                        Ok(command) => match command.force {
                            Some(force) => self.send(Order::Force(force)),
                            None if arbiter.owns(source) => self.send(Order::Force(0.0)),
                            None => {}
                        },
                        Err(refusal) => self.status.refuse_command(&refusal),
                    }
                }
                Some(Event::Command(_, Err(refusal))) => self.status.refuse_command(&refusal),
                Some(Event::Unreadable(topic, error)) => {
                    self.status.refuse(&format!("{topic}: unreadable: {error}"))
                }
                Some(Event::Setpoint(message)) => self.follow(&message),
                Some(Event::Control(Control::Shutdown | Control::End(_))) => {
                    self.send(Order::Shutdown);
                    return;
                }
                Some(Event::Control(Control::Enable(enabled))) => {
                    self.send(Order::Enable(enabled));
                    self.hold(self.status.motion()[0]);
                }
                Some(Event::Control(Control::Reset(reply))) => {
                    self.send(Order::Reset);
                    self.hold(0.0);
                    arbiter.release();
                    let time = self.status.stamp.load(Ordering::Relaxed) as f64 * 1e-9;
                    let _ = reply.send(Ok(format!(
                        "stage at position 0, at rest; time goes on from {time:.6} s"
                    )));
                }
                // Wall time cannot be paused; the services say so.
                Some(Event::Control(
                    Control::Pause(..) | Control::Step(_) | Control::StopSteps,
                )) => {}
                Some(Event::Control(Control::Bandwidth(bandwidth, reply))) => {
                    let _ = reply.send(self.set_bandwidth(bandwidth));
                }
                Some(Event::Control(Control::Move(distance, reply))) => {
                    let _ = reply.send(self.step(distance));
                }
                Some(Event::Control(Control::Retune)) => {
                    arbiter.set_silence(self.live.command_timeout().as_nanos() as i64);
                }
            }
        }
    }

    /// The loop begins again at `position`, m, on the tick thread: so does what it follows here.
    fn hold(&mut self, position: f64) {
        let Some(follower) = &mut self.follower else { return };
        follower.hold(0, position);
        *lock(&self.followed) = Some((**follower).clone());
        self.health = Health::Fine;
        self.status.set_servo(Health::Fine);
    }

    /// Why the loop follows nothing, if it was stopped.
    fn stopped(&self) -> Result<(), String> {
        match self.health {
            Health::Stop(cause) => {
                Err(format!("the loop was stopped: {cause}; `~/enable` with true starts it again"))
            }
            Health::Fine | Health::Warning(_) => Ok(()),
        }
    }

    /// A setpoint in `drive: servo`; in `drive: force` it is for the controller.
    fn follow(&mut self, message: &friction_stage_data::message::JointTrajectory) {
        let stopped = self.stopped();
        let Some(follower) = &mut self.follower else { return };
        if let Err(reason) = stopped {
            return self.status.refuse(&format!("~/setpoint: {reason}"));
        }
        let now = self.status.stamp.load(Ordering::Relaxed);
        let result = setpoint(message, &self.settings.joint, now)
            .map_err(|error| error.to_string())
            .and_then(|wanted| {
                let now = now - self.epoch;
                let mut next = follower.clone();
                match wanted {
                    Setpoint::Now(reference) => next.set(now, reference),
                    Setpoint::Motion(motion) => next.follow(now, motion.shifted(-self.epoch)),
                }
                .map_err(|error| error.to_string())?;
                Ok(next)
            });
        match result {
            Ok(next) => {
                *follower = next.clone();
                *lock(&self.followed) = Some((*next).clone());
                self.send(Order::Follow(next));
            }
            Err(reason) => self.status.refuse(&format!("~/setpoint: {reason}")),
        }
    }

    /// New gains of the stage's own loop, in the range of the parameter `servo_bandwidth`.
    fn set_bandwidth(&mut self, bandwidth: f64) -> Result<String, String> {
        let controller = self.controller.as_mut().ok_or(NO_SERVO)?;
        let (least, most) = SERVO_BANDWIDTH;
        if !(least..=most).contains(&bandwidth) {
            return Err(format!("a bandwidth of {bandwidth} Hz: must be {least} to {most} Hz"));
        }
        let mass = moved_mass(&self.settings);
        let wanted = ControllerSettings {
            gains: Gains::from_bandwidth(bandwidth, mass),
            ..controller.clone()
        };
        wanted.check().map_err(|error| error.to_string())?;
        *controller = wanted.clone();
        self.send(Order::Retune(Box::new(wanted)));
        Ok(format!("bandwidth {bandwidth} Hz"))
    }

    /// A step of the setpoint, as smooth as the paper's moves.
    fn step(&mut self, distance: f64) -> Result<String, String> {
        self.stopped()?;
        let follower = self.follower.as_mut().ok_or(NO_SERVO)?;
        if !(distance.is_finite() && distance.abs() <= LARGEST_STEP) {
            return Err(format!("a step of {distance} m: must be at most {LARGEST_STEP} m"));
        }
        let now = self.status.stamp.load(Ordering::Relaxed) - self.epoch;
        let time = SHORTEST_STEP.max(0.1 * (distance.abs() / 50e-3).sqrt());
        let target = follower.at(now).position + distance;
        let arrival = Point::at_rest((time * 1e9) as i64, target);
        let mut next = follower.clone();
        Trajectory::new(now, vec![arrival])
            .and_then(|motion| next.follow(now, motion))
            .map_err(|error| error.to_string())?;
        *follower = next.clone();
        *lock(&self.followed) = Some((*next).clone());
        self.send(Order::Follow(next));
        Ok(format!("step of {} in {}", in_prefix(distance, "m"), in_prefix(time, "s")))
    }

    fn send(&mut self, order: Order) {
        let mut order = Some(order);
        // The tick thread empties the ring at every tick; it is full only for less than that.
        while let Some(waiting) = order.take() {
            if let Err(rtrb::PushError::Full(back)) = self.orders.push(waiting) {
                order = Some(back);
                std::thread::sleep(Duration::from_micros(200));
            }
        }
    }
}
