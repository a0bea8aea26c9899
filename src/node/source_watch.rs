//! Whether the samples of one topic come from one stage after another, or from two at once.
//!
//! In: who published each sample. A stage that is started again is a new publisher whose
//! predecessor is silent; one that publishes although another has taken its place is a second one.

/// A participant of DDS: the first bytes of the names of all its publishers. One stage may replace
/// a publisher by another.
type Participant = [u8; 12];

/// Predecessors that are remembered.
const FORMER: usize = 16;

/// Watches the publishers of one topic.
#[derive(Debug, Default)]
pub struct SourceWatch {
    current: Option<Participant>,
    former: Vec<Participant>,
}

impl SourceWatch {
    /// Takes the publisher of the next sample; whether it publishes beside another.
    pub fn is_second(&mut self, publisher: [u8; 16]) -> bool {
        let Some(participant) = publisher.first_chunk::<12>().copied() else { return false };
        if self.current == Some(participant) {
            return false;
        }
        if self.former.contains(&participant) {
            return true;
        }
        if let Some(before) = self.current.replace(participant) {
            if self.former.len() == FORMER {
                self.former.remove(0);
            }
            self.former.push(before);
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn publisher(participant: u8, number: u8) -> [u8; 16] {
        let mut publisher = [participant; 16];
        publisher[15] = number;
        publisher
    }

    #[test]
    fn stages_one_after_another_are_one_source_and_two_at_once_are_two() {
        let mut watch = SourceWatch::default();
        // The second publisher of the first stage, and stages that were started again.
        for (stage, number) in [(1, 1), (1, 2), (1, 1), (2, 1), (2, 1), (3, 1), (3, 2)] {
            assert!(!watch.is_second(publisher(stage, number)));
        }
        assert!(watch.is_second(publisher(2, 1)));
        for stage in 4..60 {
            assert!(!watch.is_second(publisher(stage, 1)));
        }
        assert!(watch.is_second(publisher(58, 1)));
        assert!(watch.former.len() <= FORMER);
    }
}
