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
use super::waiter::Waiter;
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
        })
    }

    /// Waits for the next event; `None` when `deadline` has passed first.
    pub fn next(&mut self, waiter: &Waiter, deadline: Option<Instant>) -> Option<Event> {
        waiter.wait(deadline, |context| self.poll(context))
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
        // First what comes seldom: where a command is always there already, as in lockstep with a
        // pause, it would never have its turn.
        match std::pin::Pin::new(&mut self.control).poll_next(context) {
            Poll::Ready(Some(control)) => return Poll::Ready(Event::Control(control)),
            // Everybody who could control this loop is gone.
            Poll::Ready(None) => return Poll::Ready(Event::Control(Control::Shutdown)),
            Poll::Pending => {}
        }
        if let Poll::Ready(result) = self.setpoint.poll_take(context) {
            match result {
                Ok(message) => {
                    // A setpoint's stamp is when it starts, which may be long after it came: record
                    // it as of now.
                    self.recorder.hear(|| Heard::Setpoint(message.clone()));
                    return Poll::Ready(Event::Setpoint(message));
                }
                Err(error) => tracing::warn!("a setpoint could not be read: {error}"),
            }
        }
        if let Poll::Ready(result) = self.force.poll_take_from(context) {
            return Poll::Ready(match result {
                Ok((message, writer)) => {
                    let command = Command::from_wrench(&message);
                    // Its stamp is what the peer says: record it as of now.
                    self.recorder.hear(|| Heard::Force(message));
                    Event::Command(CommandSource { topic: CommandTopic::Force, writer }, command)
                }
                Err(error) => Event::Unreadable(CommandTopic::Force, error),
            });
        }
        if let Poll::Ready(event) = self.poll_joint_commands(context) {
            return Poll::Ready(event);
        }
        if let Poll::Ready(result) = self.commands.poll_take_from(context) {
            return Poll::Ready(match result {
                Ok((message, writer)) => {
                    let command = Command::from_array(&message);
                    self.recorder.hear(|| Heard::Commands(message));
                    Event::Command(CommandSource { topic: CommandTopic::Commands, writer }, command)
                }
                Err(error) => Event::Unreadable(CommandTopic::Commands, error),
            });
        }
        Poll::Pending
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
