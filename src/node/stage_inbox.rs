//! Everything that reaches the stage from outside, waited for on one thread: commands, setpoints,
//! control.

use std::task::{Context, Poll};
use std::time::Instant;

use futures::channel::mpsc::UnboundedReceiver;
use futures::stream::Stream;
use ros2_client::ReadError;

use super::commands::{Command, CommandSource, CommandTopic, Refusal};
use super::control::Control;
use super::inlet::Inlet;
use super::participant::{Participant, ParticipantError};
use super::qos::COMMANDS;
use super::recorder::{Heard, RecorderHandle};
use super::runtime::Startup;
use super::waiter::{Turns, Waiter};
use friction_stage_data::message::{
    Float64MultiArray, JointCommand, JointState, JointTrajectory, WrenchStamped,
};

/// Something that reached the stage.
#[derive(Debug)]
pub enum Event {
    Command(CommandSource, Result<Command, Refusal>),
    Setpoint(JointTrajectory),
    Control(Control),
    /// Bytes that are no message of the topic's type.
    Unreadable(CommandTopic, ReadError),
}

#[derive(Clone, Copy)]
enum Source {
    Control,
    Setpoint,
    Force,
    JointCommands,
    Commands,
}

const SOURCES: &[Source] =
    &[Source::Control, Source::Setpoint, Source::Force, Source::JointCommands, Source::Commands];

/// The subscriptions of the stage. What comes in is handed to the recorder as it came.
pub struct Inbox {
    force: Inlet<WrenchStamped>,
    joint_commands: Inlet<JointState>,
    /// The same as newer topic hardware sends it, on a topic for each interface.
    joint_efforts: Inlet<JointCommand>,
    commands: Inlet<Float64MultiArray>,
    setpoint: Inlet<JointTrajectory>,
    control: UnboundedReceiver<Control>,
    recorder: RecorderHandle,
    joint: String,
    turns: Turns<Source>,
    /// A deadline that has passed, and after which an event has come.
    passed: Option<Instant>,
}

impl Inbox {
    pub fn new(
        startup: &Startup,
        participant: &Participant,
        joint: &str,
        control: UnboundedReceiver<Control>,
        recorder: RecorderHandle,
    ) -> Result<Inbox, ParticipantError> {
        Ok(Inbox {
            force: Inlet::new(participant, &startup.topic("~/force"), &COMMANDS)?,
            joint_commands: Inlet::new(participant, &startup.topic("~/joint_commands"), &COMMANDS)?,
            joint_efforts: Inlet::new(
                participant,
                &startup.topic("~/joint_commands/effort"),
                &COMMANDS,
            )?,
            commands: Inlet::new(participant, &startup.topic("~/commands"), &COMMANDS)?,
            setpoint: Inlet::new(participant, &startup.topic("~/setpoint"), &COMMANDS)?,
            control,
            recorder,
            joint: joint.to_owned(),
            turns: Turns::new(SOURCES),
            passed: None,
        })
    }

    /// Waits for the next event; `None` when `deadline` has passed first. One event may still come
    /// after it; more of them do not keep it from having passed.
    pub fn next(&mut self, waiter: &Waiter, deadline: Option<Instant>) -> Option<Event> {
        if deadline.is_some() && self.passed == deadline {
            return None;
        }
        let event = waiter.wait(deadline, |context| self.poll(context))?;
        if deadline.is_some_and(|deadline| Instant::now() >= deadline) {
            self.passed = deadline;
        }
        Some(event)
    }

    /// Waits for control alone; everything else keeps its turn.
    pub fn next_control(&mut self, waiter: &Waiter) -> Control {
        let wanted =
            waiter.wait(None, |context| std::pin::Pin::new(&mut self.control).poll_next(context));
        // Everybody who could control this loop is gone.
        wanted.flatten().unwrap_or(Control::Shutdown)
    }

    /// What has come on `~/joint_commands`, without waiting.
    pub fn joint_command(&mut self, waiter: &Waiter) -> Option<Event> {
        waiter.wait(Some(Instant::now()), |context| self.poll_joint_commands(context))
    }

    fn poll(&mut self, context: &mut Context<'_>) -> Poll<Event> {
        // Apart, so that the rest can be borrowed meanwhile.
        let mut turns = std::mem::replace(&mut self.turns, Turns::new(SOURCES));
        let event = turns.poll(|source| match source {
            Source::Control => self.poll_control(context),
            Source::Setpoint => self.poll_setpoint(context),
            Source::Force => self.poll_force(context),
            Source::JointCommands => self.poll_joint_commands(context),
            Source::Commands => self.poll_commands(context),
        });
        self.turns = turns;
        event
    }

    fn poll_control(&mut self, context: &mut Context<'_>) -> Poll<Event> {
        // Without a sender, everybody who could control this loop is gone.
        let control = std::pin::Pin::new(&mut self.control).poll_next(context);
        control.map(|control| Event::Control(control.unwrap_or(Control::Shutdown)))
    }

    fn poll_setpoint(&mut self, context: &mut Context<'_>) -> Poll<Event> {
        match self.setpoint.poll_take(context) {
            Poll::Ready(Ok(message)) => {
                // A setpoint's stamp is when it starts, which may be long after it came: record it
                // as of now.
                self.recorder.hear(|| Heard::Setpoint(message.clone()));
                Poll::Ready(Event::Setpoint(message))
            }
            Poll::Ready(Err(error)) => {
                tracing::warn!("a setpoint could not be read: {error}");
                // There may be more.
                context.waker().wake_by_ref();
                Poll::Pending
            }
            Poll::Pending => Poll::Pending,
        }
    }

    fn poll_force(&mut self, context: &mut Context<'_>) -> Poll<Event> {
        self.force.poll_take_from(context).map(|taken| match taken {
            Ok((message, writer)) => {
                let command = Command::from_wrench(&message);
                // Its stamp is what the peer says: record it as of now.
                self.recorder.hear(|| Heard::Force(message));
                Event::Command(CommandSource { topic: CommandTopic::Force, writer }, command)
            }
            Err(error) => Event::Unreadable(CommandTopic::Force, error),
        })
    }

    fn poll_commands(&mut self, context: &mut Context<'_>) -> Poll<Event> {
        self.commands.poll_take_from(context).map(|taken| match taken {
            Ok((message, writer)) => {
                let command = Command::from_array(&message);
                self.recorder.hear(|| Heard::Commands(message));
                Event::Command(CommandSource { topic: CommandTopic::Commands, writer }, command)
            }
            Err(error) => Event::Unreadable(CommandTopic::Commands, error),
        })
    }

    fn poll_joint_commands(&mut self, context: &mut Context<'_>) -> Poll<Event> {
        const TOPIC: CommandTopic = CommandTopic::JointCommands;
        if let Poll::Ready(taken) = self.joint_efforts.poll_take_from(context) {
            return Poll::Ready(match taken {
                Ok((message, writer)) => match message.into_efforts() {
                    Ok(efforts) => self.joint_efforts_from(efforts, writer),
                    Err(found) => {
                        let refusal = Refusal::Interface { topic: TOPIC, found };
                        Event::Command(CommandSource { topic: TOPIC, writer }, Err(refusal))
                    }
                },
                Err(error) => Event::Unreadable(TOPIC, error),
            });
        }
        self.joint_commands.poll_take_from(context).map(|taken| match taken {
            Ok((message, writer)) => self.joint_efforts_from(message, writer),
            Err(error) => Event::Unreadable(TOPIC, error),
        })
    }

    fn joint_efforts_from(&self, message: JointState, writer: [u8; 16]) -> Event {
        let command = Command::from_joint_state(&message, &self.joint);
        // Its stamp is not that of the sample that it answers: record it as of now.
        self.recorder.hear(|| Heard::JointCommands(message));
        Event::Command(CommandSource { topic: CommandTopic::JointCommands, writer }, command)
    }
}
