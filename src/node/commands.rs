//! Who may command the stage, and with what: the rules for force commands, apart from DDS.
//!
//! In come commands as the topics bring them; out goes a force for the stage or a [`Refusal`] that
//! says what was wrong, with the numbers. A refused command changes nothing.

use friction_stage_data::message::{Float64MultiArray, JointState, WrenchStamped};

/// Topics that carry force commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CommandTopic {
    /// `~/force`
    Force,
    /// `~/joint_commands`
    JointCommands,
    /// `~/commands`
    Commands,
}

impl CommandTopic {
    /// Whether the stamp of a command says which sample it answers. On `~/joint_commands` it is the
    /// time that the hardware's own node shows, which may be a tick behind; and a controller
    /// manager commands once per tick, so that it cannot be asked for the same sample again.
    pub fn acknowledges(self) -> bool {
        self == CommandTopic::Force
    }
}

/// A publisher of commands: its topic and its DDS identity.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandSource {
    pub topic: CommandTopic,
    pub writer: [u8; 16],
}

/// A command as it came in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Stamp, ns; 0 where the message has none.
    pub stamp: i64,
    /// Wanted motor force, N; `None` asks for none and still answers a sample.
    pub force: Option<f64>,
}

/// Why a command was refused.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    #[error("{topic}: force is {value}, must be finite")]
    NotFinite { topic: CommandTopic, value: f64 },
    #[error("{topic}: no joint `{expected}` among [{found}]")]
    WrongJoint { topic: CommandTopic, expected: String, found: String },
    #[error(
        "{topic}: {names} joint names but {efforts} efforts, must be as many (or no effort at all)"
    )]
    Lengths { topic: CommandTopic, names: usize, efforts: usize },
    #[error("{topic}/effort: interface_name is `{found}`, must be effort")]
    Interface { topic: CommandTopic, found: String },
    #[error("{topic}: {found} values, must be exactly 1: the force in N")]
    Count { topic: CommandTopic, found: usize },
    #[error(
        "{topic}: carries no stamp, so it cannot answer a sample in lockstep; use ~/force or \
         ~/joint_commands"
    )]
    NoStamp { topic: CommandTopic },
    #[error("{topic}: stamp {stamp} ns repeats the last one")]
    StampRepeats { topic: CommandTopic, stamp: i64 },
    #[error("{topic}: stamp {stamp} ns goes back behind {last} ns")]
    StampGoesBack { topic: CommandTopic, stamp: i64, last: i64 },
    #[error(
        "{topic}: stamp {stamp} ns answers no sample; the stage waits for the answer to {expected} \
         ns"
    )]
    AnswersNoSample { topic: CommandTopic, stamp: i64, expected: i64 },
    #[error("{topic}: refused, {owner} commands the stage since {since} ns of its time")]
    OtherSource {
        topic: CommandTopic,
        owner: CommandTopic,
        since: i64,
        /// The publisher that was refused, if the owner has commanded between two commands of it:
        /// there are two at once.
        second: Option<[u8; 16]>,
    },
}

impl std::fmt::Display for CommandTopic {
    fn fmt(&self, formatter: &mut std::fmt::Formatter) -> std::fmt::Result {
        formatter.write_str(match self {
            CommandTopic::Force => "~/force",
            CommandTopic::JointCommands => "~/joint_commands",
            CommandTopic::Commands => "~/commands",
        })
    }
}

impl Command {
    pub fn from_wrench(message: &WrenchStamped) -> Result<Command, Refusal> {
        let value = message.wrench.force.x;
        if !value.is_finite() {
            return Err(Refusal::NotFinite { topic: CommandTopic::Force, value });
        }
        Ok(Command { stamp: message.header.stamp.to_nanos(), force: Some(value) })
    }

    /// The effort of `joint`, looked up by name. No efforts, or NaN, ask for no force, as
    /// ros2_control sends it at first.
    pub fn from_joint_state(message: &JointState, joint: &str) -> Result<Command, Refusal> {
        let topic = CommandTopic::JointCommands;
        let stamp = message.header.stamp.to_nanos();
        let Some(index) = message.name.iter().position(|name| name == joint) else {
            let found = message.name.join(", ");
            return Err(Refusal::WrongJoint { topic, expected: joint.to_owned(), found });
        };
        if message.effort.is_empty() {
            return Ok(Command { stamp, force: None });
        }
        if message.effort.len() != message.name.len() {
            return Err(Refusal::Lengths {
                topic,
                names: message.name.len(),
                efforts: message.effort.len(),
            });
        }
        match message.effort[index] {
            value if value.is_nan() => Ok(Command { stamp, force: None }),
            value if value.is_infinite() => Err(Refusal::NotFinite { topic, value }),
            value => Ok(Command { stamp, force: Some(value) }),
        }
    }

    pub fn from_array(message: &Float64MultiArray) -> Result<Command, Refusal> {
        let topic = CommandTopic::Commands;
        match message.data[..] {
            [value] if value.is_finite() => Ok(Command { stamp: 0, force: Some(value) }),
            [value] => Err(Refusal::NotFinite { topic, value }),
            _ => Err(Refusal::Count { topic, found: message.data.len() }),
        }
    }
}

/// Lets one source at a time command the stage: the first keeps it until it has been silent for a
/// while.
///
/// Time is wall time in ns, an argument. A source owns the stage from its first finite force on.
#[derive(Clone, Debug)]
pub struct Arbiter {
    silence: i64,
    owner: Option<Owner>,
}

#[derive(Clone, Copy, Debug)]
struct Owner {
    source: CommandSource,
    since: i64,
    last_heard: i64,
    last_stamp: i64,
    /// The publisher that the owner has replaced.
    former: Option<[u8; 16]>,
    /// The other source that was refused last, and when.
    refused: Option<(CommandSource, i64)>,
}

/// Vendor number of RustDDS (OMG, list of DDS-RTPS vendor ids), with which the identities of its
/// participants begin.
const RUSTDDS: [u8; 2] = [0x01, 0x12];

impl Owner {
    /// Whether `source` goes on for the owner: a node of this project replaces its publishers by
    /// others, which have the same participant, the first 12 bytes of their identity. The one that
    /// was replaced does not come back. Of another vendor two publishers of a participant are two
    /// sources.
    fn is_succeeded_by(&self, source: CommandSource) -> bool {
        let participant = |source: CommandSource| source.writer.first_chunk::<12>().copied();
        source != self.source
            && source.topic == self.source.topic
            && source.writer.starts_with(&RUSTDDS)
            && participant(source) == participant(self.source)
            && self.former != Some(source.writer)
    }
}

/// How stamps of commands are judged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StampRule {
    /// In real time: a stamp, if there is one, must not go back. One that repeats is of a newer
    /// command within the same tick of the source's clock.
    NotBack,
    /// In lockstep: the stamp must be that of the sample that waits for an answer, ns, where the
    /// topic has such stamps at all.
    Answers(i64),
}

impl Arbiter {
    /// `silence`: ns after which another source may take over.
    pub fn new(silence: i64) -> Arbiter {
        Arbiter { silence, owner: None }
    }

    pub fn set_silence(&mut self, silence: i64) {
        self.silence = silence;
    }

    /// Judges a command of `source` that came in at `now` (wall clock, ns); `since` is the stage's
    /// time for the report.
    pub fn judge(
        &mut self,
        source: CommandSource,
        command: Command,
        rule: StampRule,
        now: i64,
        since: i64,
    ) -> Result<Command, Refusal> {
        let topic = source.topic;
        if let Some(owner) = &mut self.owner
            && owner.is_succeeded_by(source)
        {
            owner.former = Some(owner.source.writer);
            owner.source = source;
        }
        let is_silent = self.owner.is_none_or(|owner| now - owner.last_heard >= self.silence);
        if let Some(owner) = &mut self.owner
            && owner.source != source
            && !is_silent
        {
            let before = owner.refused.replace((source, now));
            let is_second =
                before.is_some_and(|(other, at)| other == source && owner.last_heard > at);
            return Err(Refusal::OtherSource {
                topic,
                owner: owner.source.topic,
                since: owner.since,
                second: is_second.then_some(source.writer),
            });
        }
        let last_stamp =
            self.owner.filter(|owner| owner.source == source).map_or(0, |owner| owner.last_stamp);
        let stamp = command.stamp;
        match rule {
            StampRule::Answers(_) if topic == CommandTopic::Commands => {
                return Err(Refusal::NoStamp { topic });
            }
            StampRule::Answers(_) if !topic.acknowledges() => {}
            StampRule::Answers(expected) if stamp == expected => {}
            StampRule::Answers(_) if stamp != 0 && stamp == last_stamp => {
                return Err(Refusal::StampRepeats { topic, stamp });
            }
            // After a silence it may: a clock that was set back must not lock its source out for
            // good.
            _ if stamp != 0 && stamp < last_stamp && !is_silent => {
                return Err(Refusal::StampGoesBack { topic, stamp, last: last_stamp });
            }
            StampRule::Answers(expected) => {
                return Err(Refusal::AnswersNoSample { topic, stamp, expected });
            }
            StampRule::NotBack => {}
        }
        match &mut self.owner {
            Some(owner) if owner.source == source => {
                owner.last_heard = now;
                if stamp != 0 {
                    owner.last_stamp = stamp;
                }
            }
            // A source that asks for no force does not take the stage.
            _ if command.force.is_some() => {
                self.owner = Some(Owner {
                    source,
                    since,
                    last_heard: now,
                    last_stamp: stamp,
                    former: None,
                    refused: None,
                });
            }
            _ => {}
        }
        Ok(command)
    }

    /// Whether `source` commands the stage.
    pub fn owns(&self, source: CommandSource) -> bool {
        self.owner.is_some_and(|owner| owner.source == source)
    }

    /// No source commands the stage any more, as after a reset.
    pub fn release(&mut self) {
        self.owner = None;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use friction_stage_data::message::Header;

    fn joint_state(names: &[&str], efforts: &[f64]) -> JointState {
        JointState {
            header: Header::default(),
            name: names.iter().map(|name| (*name).to_owned()).collect(),
            effort: efforts.to_vec(),
            ..JointState::default()
        }
    }

    #[test]
    fn joint_commands_are_looked_up_by_name_and_nan_asks_for_no_force() {
        let force = |names: &[&str], efforts: &[f64]| {
            Command::from_joint_state(&joint_state(names, efforts), "stage")
                .map(|command| command.force)
        };
        assert_eq!(force(&["other", "stage"], &[1.0, 2.0]), Ok(Some(2.0)));
        assert_eq!(force(&["stage"], &[f64::NAN]), Ok(None));
        assert_eq!(force(&["stage"], &[]), Ok(None));
        assert!(force(&["stage"], &[f64::INFINITY]).unwrap_err().to_string().contains("inf"));
        assert!(
            force(&["slider"], &[1.0])
                .unwrap_err()
                .to_string()
                .contains("no joint `stage` among [slider]")
        );
        assert!(
            force(&["stage", "b"], &[1.0])
                .unwrap_err()
                .to_string()
                .contains("2 joint names but 1 efforts")
        );
        assert!(force(&[], &[]).is_err());
    }

    #[test]
    fn arrays_hold_exactly_one_finite_value() {
        let force = |data: &[f64]| {
            Command::from_array(&Float64MultiArray { data: data.to_vec(), ..Default::default() })
                .map(|command| command.force)
        };
        assert_eq!(force(&[3.0]), Ok(Some(3.0)));
        assert!(matches!(force(&[]), Err(Refusal::Count { found: 0, .. })));
        assert!(matches!(force(&[1.0, 2.0]), Err(Refusal::Count { found: 2, .. })));
        assert!(matches!(force(&[f64::NAN]), Err(Refusal::NotFinite { .. })));
    }

    const A: CommandSource = CommandSource { topic: CommandTopic::Force, writer: [1; 16] };
    const B: CommandSource = CommandSource { topic: CommandTopic::JointCommands, writer: [2; 16] };

    fn force(stamp: i64) -> Command {
        Command { stamp, force: Some(1.0) }
    }

    #[test]
    fn a_source_is_a_second_one_once_the_first_commands_between_its_commands() {
        let mut arbiter = Arbiter::new(100);
        let mut second =
            |source, now| match arbiter.judge(source, force(0), StampRule::NotBack, now, 0) {
                Err(Refusal::OtherSource { second, .. }) => second,
                _ => None,
            };
        assert_eq!(second(A, 0), None);
        // The first may have ended, and this be its successor.
        assert_eq!([second(B, 10), second(B, 90)], [None, None]);
        assert_eq!(second(A, 95), None);
        assert_eq!(second(B, 96), Some(B.writer));
        assert_eq!(second(B, 97), None);
    }

    #[test]
    fn the_first_source_keeps_the_stage_until_it_falls_silent() {
        let mut arbiter = Arbiter::new(100);
        assert!(arbiter.judge(A, force(0), StampRule::NotBack, 0, 0).is_ok());
        assert!(matches!(
            arbiter.judge(B, force(0), StampRule::NotBack, 50, 0),
            Err(Refusal::OtherSource { .. })
        ));
        assert!(arbiter.judge(A, force(0), StampRule::NotBack, 90, 0).is_ok());
        assert!(arbiter.judge(B, force(0), StampRule::NotBack, 189, 0).is_err());
        assert!(arbiter.judge(B, force(0), StampRule::NotBack, 190, 0).is_ok());
        assert!(arbiter.judge(A, force(0), StampRule::NotBack, 200, 0).is_err());
    }

    #[test]
    fn a_publisher_that_replaces_that_of_the_owner_goes_on_and_two_at_once_are_refused() {
        let publisher = |number| {
            let mut writer = [1; 16];
            (writer[1], writer[15]) = (RUSTDDS[1], number);
            CommandSource { topic: CommandTopic::Force, writer }
        };
        let mut arbiter = Arbiter::new(100);
        for (now, number) in [(0, 1), (1, 2), (2, 2), (3, 3)] {
            let command = force(1000 + now);
            assert!(arbiter.judge(publisher(number), command, StampRule::NotBack, now, 0).is_ok());
        }
        assert!(arbiter.owns(publisher(3)));
        // Two publishers of a participant of another vendor are two sources.
        let other = |number| CommandSource {
            writer: [1, 15, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, number],
            ..A
        };
        let mut strict = Arbiter::new(100);
        assert!(strict.judge(other(1), force(1000), StampRule::NotBack, 0, 0).is_ok());
        assert!(strict.judge(other(2), force(1001), StampRule::NotBack, 1, 0).is_err());
        assert!(strict.judge(other(1), force(1002), StampRule::NotBack, 2, 0).is_ok());
        let mut refusal = |number, now| {
            arbiter.judge(publisher(number), force(0), StampRule::NotBack, now, 0).err()
        };
        assert!(matches!(refusal(2, 4), Some(Refusal::OtherSource { second: None, .. })));
        assert_eq!(refusal(3, 5), None);
        let second = Some(publisher(2).writer);
        assert!(
            matches!(refusal(2, 6), Some(Refusal::OtherSource { second: s, .. }) if s == second)
        );
    }

    #[test]
    fn a_source_that_asks_for_no_force_does_not_take_the_stage() {
        let mut arbiter = Arbiter::new(100);
        let nothing = Command { stamp: 0, force: None };
        assert!(arbiter.judge(B, nothing, StampRule::NotBack, 0, 0).is_ok());
        assert!(arbiter.judge(A, force(0), StampRule::NotBack, 1, 0).is_ok());
    }

    #[test]
    fn stamps_that_repeat_go_back_or_answer_no_sample_are_refused_with_their_numbers() {
        let mut arbiter = Arbiter::new(100);
        assert!(arbiter.judge(A, force(1000), StampRule::NotBack, 0, 0).is_ok());
        // In real time a newer command; in lockstep the sample has been answered.
        assert!(arbiter.judge(A, force(1000), StampRule::NotBack, 1, 0).is_ok());
        assert!(matches!(
            arbiter.judge(A, force(1000), StampRule::Answers(2000), 1, 0),
            Err(Refusal::StampRepeats { .. })
        ));
        let back = arbiter.judge(A, force(900), StampRule::NotBack, 1, 0).unwrap_err();
        assert!(back.to_string().contains("900") && back.to_string().contains("1000"), "{back}");
        // After a silence a clock may have been set back.
        assert!(arbiter.judge(A, force(900), StampRule::NotBack, 200, 0).is_ok());
        assert!(arbiter.judge(A, force(901), StampRule::NotBack, 201, 0).is_ok());
        assert!(arbiter.judge(A, force(2000), StampRule::Answers(2000), 202, 0).is_ok());
        let other = arbiter.judge(A, force(3500), StampRule::Answers(3000), 203, 0).unwrap_err();
        assert!(matches!(other, Refusal::AnswersNoSample { stamp: 3500, expected: 3000, .. }));
        // Stamps of topic hardware say nothing of the sample.
        let mut hardware = Arbiter::new(100);
        for stamp in [3000, 2000, 2000, 1000, 0, 4000] {
            assert!(hardware.judge(B, force(stamp), StampRule::Answers(3000), 1, 0).is_ok());
        }
        let bare = CommandSource { topic: CommandTopic::Commands, writer: [1; 16] };
        let mut fresh = Arbiter::new(100);
        assert!(matches!(
            fresh.judge(bare, force(0), StampRule::Answers(3000), 1, 0),
            Err(Refusal::NoStamp { .. })
        ));
    }
}
