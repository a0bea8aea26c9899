//! The stage in lockstep: sample k goes out, the answer to sample k comes in, the stage moves on to
//! k + 1.
//!
//! Until the first finite command time runs with the wall clock and the force is zero, because a
//! controller manager needs a running clock before it says anything (or it stands still, with
//! `wait_for_command`). Then time stops at the sample that is out, and every step from there on has
//! its own answer.
//!
//! What an answer is depends on the topic. On `~/force` it is the command with the stamp of the
//! sample; a missing one is an error, and time stands still until it comes. On `~/joint_commands`
//! stamps say nothing of the sample, and a controller manager commands once per tick: there it is
//! what comes after the sample went out, whatever its stamp, and where nothing comes within
//! `answer_timeout` time moves on (decision 0011).

use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use super::LOCKSTEP_EPOCH as EPOCH;
use super::clock;
use super::commands::{Arbiter, Command, CommandSource, CommandTopic, Refusal, StampRule};
use super::control::{Control, Steps, StepsEnd};
use super::stage::StageLoop;
use super::stage_inbox::Event;
use super::waiter::Waiter;
use super::wire::Tick;

/// Interval at which a sample is sent again to controllers that were not there when it went out.
/// Topic hardware that has said nothing for as long has no command on its way any more.
const ANNOUNCE: Duration = Duration::from_millis(100);

/// Samples between two reports of the publishers' counters.
const COUNT: u64 = 512;

/// What a wait came to.
enum Answer {
    /// Force for the sample, N.
    Force(f64),
    /// The first command answers a sample to come, ns: run unforced until then.
    Ahead(i64, f64),
    /// None has come from a source that cannot be asked again.
    Missing,
    Shutdown,
}

/// What ended a wait of the free run.
enum Free {
    /// The next sample is due.
    Next,
    /// The first finite command.
    Command(CommandSource, Command),
    Shutdown,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Phase {
    /// Time runs with the wall clock, unforced.
    Free,
    /// A command has come, or time was to stand still: waiting for the first answer to the sample
    /// that is out.
    Arming,
    Armed,
}

struct Run {
    arbiter: Arbiter,
    waiter: Waiter,
    enabled: bool,
    /// Where the last answer came from.
    answers_on: Option<CommandTopic>,
    /// Stamp of the sample that was answered last, ns.
    answered: i64,
    /// A command of topic hardware for the sample before may be on its way still, so that the
    /// answer is the last one before a silence.
    settling: bool,
    /// Sample from which those that wait for an answer are counted: 0, or the first that topic
    /// hardware answered, because its next tick is one period of the manager later.
    origin: u64,
    /// Time stands still between two samples, but for the steps.
    paused: bool,
    steps: Option<ActiveSteps>,
    /// Time continues after a pause: the wall clock of the free run starts again.
    resumed: bool,
}

/// Samples to go on by while time is paused.
struct ActiveSteps {
    /// The first of them: a sample that was out when they were asked for is none.
    first: u64,
    left: u64,
    asked: Steps,
}

impl Run {
    fn end_steps(&mut self, end: StepsEnd) {
        if let Some(steps) = self.steps.take() {
            // Who asked may have gone.
            let _ = steps.asked.end.send(end);
        }
    }

    /// A sample is over.
    fn step_done(&mut self, tick: &Tick) {
        let Some(steps) = &mut self.steps else { return };
        if tick.sample.index < steps.first {
            return;
        }
        steps.left -= 1;
        steps.asked.done.store(steps.asked.count - steps.left, Ordering::Relaxed);
        if steps.left == 0 {
            self.end_steps(StepsEnd::Done);
        }
    }

    /// Samples since the last one that waited for an answer.
    fn since_due(&self, tick: &Tick, every: u64) -> u64 {
        tick.sample.index.saturating_sub(self.origin) % every
    }

    /// Whether a missing answer can be asked for again and again.
    fn can_ask_again(&self) -> bool {
        self.answers_on.is_none_or(CommandTopic::acknowledges)
    }
}

impl StageLoop {
    /// Runs in lockstep until shutdown.
    pub fn run_lockstep(mut self) {
        let mut run = Run {
            arbiter: Arbiter::new(self.live.answer_timeout().as_nanos() as i64),
            waiter: Waiter::new(),
            enabled: true,
            answers_on: None,
            answered: EPOCH,
            settling: true,
            origin: 0,
            paused: false,
            steps: None,
            resumed: false,
        };
        let mut phase = if self.settings.wait_for_command { Phase::Arming } else { Phase::Free };
        let mut started = Instant::now();
        let mut held = 0.0;
        let mut ahead: Option<(i64, f64)> = None;
        loop {
            if self.wait_while_paused(&mut run) {
                return;
            }
            let tick = self.observe();
            let every = self.settings.every;
            if run.since_due(&tick, every) == 1 % every {
                self.leave_out_surplus(&mut run, &tick);
            }
            self.outlets.publish_and_settle(&tick);
            self.feed.insist(&tick);
            if tick.sample.index.is_multiple_of(COUNT) {
                self.live.set_counts(self.outlets.counts());
            }
            match ahead {
                Some((stamp, force)) if tick.stamp >= stamp => {
                    (ahead, held, phase) = (None, force, Phase::Armed);
                }
                Some(_) => {}
                None => {
                    let mut first = None;
                    if phase == Phase::Free {
                        let time_of =
                            |k| Duration::from_nanos(self.settings.rates.time_of(k) as u64);
                        let now = Instant::now();
                        if std::mem::take(&mut run.resumed) {
                            started = now.checked_sub(time_of(tick.sample.index)).unwrap_or(now);
                        }
                        let next = match run.steps {
                            Some(_) => now,
                            None => started + time_of(tick.sample.index + 1),
                        };
                        match self.wait_free(&mut run, &tick, next) {
                            Free::Command(source, command) => {
                                first = Some((source, command));
                                phase = Phase::Arming;
                            }
                            Free::Next => {}
                            Free::Shutdown => return,
                        }
                    }
                    let due = run.since_due(&tick, every) == 0;
                    if phase == Phase::Arming || (phase == Phase::Armed && due) {
                        match self.wait_answer(&mut run, &tick, phase == Phase::Armed, first) {
                            Answer::Force(force) => (held, phase) = (force, Phase::Armed),
                            Answer::Ahead(stamp, force) => ahead = Some((stamp, force)),
                            Answer::Missing => {
                                if self.is_stale(&run, &tick) {
                                    held = 0.0;
                                }
                            }
                            Answer::Shutdown => return,
                        }
                        self.status.commanded.store(phase == Phase::Armed, Ordering::Relaxed);
                    }
                }
            }
            self.stage.advance(if run.enabled && ahead.is_none() { held } else { 0.0 });
            self.status.clamped.store(self.stage.clamped(), Ordering::Relaxed);
            run.step_done(&tick);
            if self.settings.pause_at.is_some_and(|time| tick.sample.time >= time) {
                self.settings.pause_at = None;
                self.pause(&mut run, true);
            }
        }
    }

    fn pause(&self, run: &mut Run, paused: bool) {
        run.resumed |= run.paused && !paused;
        run.paused = paused;
        self.status.paused.store(paused, Ordering::Relaxed);
    }

    /// Stands still between two samples while time is paused and no step is asked for; `true` for
    /// shutdown.
    fn wait_while_paused(&mut self, run: &mut Run) -> bool {
        while run.paused && run.steps.is_none() {
            let control = self.inbox.next_control(&run.waiter);
            if self.handle(run, Event::Control(control)) {
                return true;
            }
        }
        false
    }

    fn observe(&mut self) -> Tick {
        let sample = self.stage.sample();
        let stamp = EPOCH + sample.time;
        self.status.sample.store(sample.index, Ordering::Relaxed);
        self.status.stamp.store(stamp, Ordering::Relaxed);
        let state = self.stage.state();
        self.status.set_motion(&state);
        Tick { stamp, sample, state }
    }

    /// Takes what topic hardware sent before the sample that it would have to answer went out.
    /// Kept, it would delay the loop by a sample for good.
    fn leave_out_surplus(&mut self, run: &mut Run, tick: &Tick) {
        if run.can_ask_again() {
            return;
        }
        while let Some(event) = self.inbox.joint_command(&run.waiter) {
            let Event::Command(source, Ok(command)) = event else {
                self.handle(run, event);
                continue;
            };
            match self.judge(run, source, command, tick) {
                Ok(_) => _ = self.status.surplus.fetch_add(1, Ordering::Relaxed),
                Err(refusal) => self.status.refuse_command(&refusal),
            }
        }
    }

    fn judge(
        &self,
        run: &mut Run,
        source: CommandSource,
        command: Command,
        tick: &Tick,
    ) -> Result<Command, Refusal> {
        let rule = StampRule::Answers(tick.stamp);
        run.arbiter.judge(source, command, rule, clock::monotonic(), tick.stamp)
    }

    /// Whether no sample has been answered for `command_timeout` of simulated time.
    fn is_stale(&self, run: &Run, tick: &Tick) -> bool {
        let silence = (tick.stamp - run.answered) as u128;
        let stale = silence >= self.live.command_timeout().as_nanos();
        if stale && !self.status.is_stale.swap(true, Ordering::Relaxed) {
            self.status.stale.fetch_add(1, Ordering::Relaxed);
        }
        stale
    }

    /// Waits for the next sample's turn, or for the first finite command.
    ///
    /// A command that could answer no sample at all must not stop time: nothing would start it
    /// again.
    fn wait_free(&mut self, run: &mut Run, tick: &Tick, next: Instant) -> Free {
        loop {
            match self.inbox.next(&run.waiter, Some(next)) {
                None => return Free::Next,
                Some(Event::Command(source, Ok(command @ Command { stamp, force: Some(_) }))) => {
                    let topic = source.topic;
                    if topic == CommandTopic::Commands {
                        self.status.refuse(&Refusal::NoStamp { topic }.to_string());
                    } else if !topic.acknowledges() || self.is_sample(stamp) {
                        return Free::Command(source, command);
                    } else {
                        let expected = tick.stamp;
                        self.status.refuse(
                            &Refusal::AnswersNoSample { topic, stamp, expected }.to_string(),
                        );
                    }
                }
                Some(Event::Command(_, Ok(_)) | Event::Setpoint(_)) => {}
                Some(other) => {
                    if self.handle(run, other) {
                        return Free::Shutdown;
                    }
                }
            }
        }
    }

    /// Waits for the answer to a sample; `first` is the command that ended the free run, which may
    /// be that answer.
    fn wait_answer(
        &mut self,
        run: &mut Run,
        tick: &Tick,
        armed: bool,
        mut first: Option<(CommandSource, Command)>,
    ) -> Answer {
        let began = Instant::now();
        let mut since = began;
        // Only a stage that was told to stand still from the start may wait for its first command
        // in silence.
        let is_owed = armed || !self.settings.wait_for_command;
        // The newest command of topic hardware, and until when it waits for a newer one.
        let mut newest: Option<(f64, Instant)> = None;
        // Times that nothing came while the stage was there to hear it: what the machine, or a
        // debugger, takes from this process is no silence of the other one.
        let mut silences = 0;
        loop {
            let timeout = self.live.answer_timeout();
            let patience = match armed {
                true if run.can_ask_again() => timeout,
                true => ANNOUNCE.min(timeout / 2),
                false => ANNOUNCE,
            };
            let deadline = newest.map_or(since + patience, |(_, until)| until);
            let event = match first.take() {
                Some((source, command)) => Some(Event::Command(source, Ok(command))),
                None => self.inbox.next(&run.waiter, Some(deadline)),
            };
            let Some(event) = event else {
                if let Some((force, _)) = newest {
                    return self.answered(run, CommandTopic::JointCommands, tick, force);
                }
                silences += 1;
                if armed && !run.can_ask_again() && patience * silences >= timeout {
                    self.status.move_on(&format!(
                        "lockstep: no answer on ~/joint_commands to the sample of {} ns within \
                         {timeout:?}; time moves on (does the manager's update_rate answer one \
                         sample in {}?)",
                        tick.stamp, self.settings.every
                    ));
                    // It may come late.
                    run.settling = true;
                    return Answer::Missing;
                }
                if is_owed
                    && began.elapsed() >= timeout
                    && !self.status.is_unanswered.swap(true, Ordering::Relaxed)
                {
                    self.status.missing_answers.fetch_add(1, Ordering::Relaxed);
                    run.end_steps(StepsEnd::Failed(format!(
                        "no answer to the sample of {} ns within {timeout:?}",
                        tick.stamp
                    )));
                    tracing::error!(
                        "lockstep: no answer to the sample of {} ns within {timeout:?}; time \
                         stands still until it comes",
                        tick.stamp
                    );
                }
                self.outlets.publish_and_settle(tick);
                since = Instant::now();
                continue;
            };
            let (source, command) = match event {
                Event::Command(source, Ok(command)) => (source, command),
                Event::Setpoint(_) => continue,
                other => {
                    if self.handle(run, other) {
                        return Answer::Shutdown;
                    }
                    continue;
                }
            };
            if !armed {
                let acknowledges = source.topic.acknowledges();
                match command {
                    Command { force: None, .. } if newest.is_none() => continue,
                    // Answers to samples that went by before time stopped.
                    Command { stamp, .. } if acknowledges && stamp != 0 && stamp < tick.stamp => {
                        continue;
                    }
                    Command { stamp, force: Some(force) }
                        if acknowledges && stamp > tick.stamp && self.is_sample(stamp) =>
                    {
                        return Answer::Ahead(stamp, force);
                    }
                    _ => {}
                }
            }
            match self.judge(run, source, command, tick) {
                Ok(command) => {
                    let force = command.force.unwrap_or(0.0);
                    let last = began + timeout;
                    let now = Instant::now();
                    if source.topic.acknowledges() || now >= last {
                        return self.answered(run, source.topic, tick, force);
                    }
                    let quiet = if run.settling { ANNOUNCE } else { Duration::ZERO };
                    newest = Some((force, last.min(now + quiet)));
                }
                Err(refusal) => self.status.refuse_command(&refusal),
            }
        }
    }

    fn answered(&self, run: &mut Run, topic: CommandTopic, tick: &Tick, force: f64) -> Answer {
        run.answers_on = Some(topic);
        run.answered = tick.stamp;
        if run.settling && !topic.acknowledges() {
            run.origin = tick.sample.index;
        }
        run.settling = false;
        self.status.is_stale.store(false, Ordering::Relaxed);
        if self.status.is_unanswered.swap(false, Ordering::Relaxed) {
            tracing::info!("lockstep: the answer came, time goes on");
        }
        Answer::Force(force)
    }

    /// Whether `stamp` is that of a sample.
    fn is_sample(&self, stamp: i64) -> bool {
        let index = ((stamp - EPOCH) as f64 * 1e-9 * self.settings.rates.control()).round();
        index >= 0.0 && self.settings.rates.time_of(index as u64) == stamp - EPOCH
    }

    /// Handles what is no valid command; `true` for shutdown.
    fn handle(&mut self, run: &mut Run, event: Event) -> bool {
        match event {
            Event::Command(_, Err(refusal)) => self.status.refuse_command(&refusal),
            Event::Unreadable(topic, error) => {
                self.status.refuse(&format!("{topic}: unreadable: {error}"))
            }
            Event::Control(Control::Shutdown | Control::End(_)) => return true,
            Event::Control(Control::Enable(enabled)) => {
                run.enabled = enabled;
                self.status.disabled.store(!enabled, Ordering::Relaxed);
            }
            Event::Control(Control::Reset(reply)) => {
                self.stage.reset();
                run.arbiter.release();
                let time = self.status.stamp.load(Ordering::Relaxed) as f64 * 1e-9;
                let _ = reply
                    .send(Ok(format!("stage at position 0, at rest; time goes on from {time} s")));
            }
            Event::Control(Control::Pause(paused, reply)) => {
                run.end_steps(StepsEnd::Stopped);
                self.pause(run, paused);
                let _ = reply.send(());
            }
            Event::Control(Control::Step(asked)) => {
                let why = match (run.paused, &run.steps) {
                    (true, None) => {
                        let first = self.status.sample.load(Ordering::Relaxed) + 1;
                        run.steps = Some(ActiveSteps { first, left: asked.count, asked });
                        return false;
                    }
                    (true, Some(_)) => "other steps are under way",
                    (false, _) => "time is not paused",
                };
                let _ = asked.end.send(StepsEnd::Failed(why.to_owned()));
            }
            Event::Control(Control::StopSteps) => run.end_steps(StepsEnd::Stopped),
            Event::Control(Control::Bandwidth(_, reply) | Control::Move(_, reply)) => {
                let _ =
                    reply.send(Err("mode: lockstep: the stage has no loop of its own".to_owned()));
            }
            Event::Control(Control::Retune) => {
                run.arbiter.set_silence(self.live.answer_timeout().as_nanos() as i64);
                self.outlets.set_clock_pause(self.live.clock_pause());
            }
            Event::Command(_, Ok(_)) | Event::Setpoint(_) => {}
        }
        false
    }
}
