//! The words for findings: one sentence each, with its numbers and what would be right.
//!
//! The rooms below decide what a finding is and how much it matters; only here is it said in a
//! language. What comes in are typed findings, what goes out is text without the word "warning".

mod data;
mod identify;
mod recording;

pub(crate) use data::subject;
pub(crate) use identify::times_noise;
pub use identify::{comparison_notes, records_error};
pub use recording::{import_text, messages_text, proposal_text, recording_text, recover_text};

/// What can be said in a sentence.
pub trait Words {
    /// The sentence, without a full stop, as a part of a list or after a colon.
    fn words(&self) -> String;
}

/// The sentences of several findings.
pub fn all_words<'a, F: Words + 'a>(findings: impl IntoIterator<Item = &'a F>) -> Vec<String> {
    findings.into_iter().map(Words::words).collect()
}

/// A number to three digits.
pub(crate) fn short(value: f64) -> String {
    if (1e-3..1e4).contains(&value.abs()) {
        let decimals = (2 - value.abs().log10().floor() as i32).max(0) as usize;
        format!("{value:.decimals$}")
    } else {
        format!("{value:.2e}")
    }
}
