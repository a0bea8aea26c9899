//! The words for findings: one sentence each, with its numbers and what would be right.
//!
//! The rooms below decide what a finding is and how much it matters; only here is it said in a
//! language. What comes in are typed findings, what goes out is text without the word "warning".

use std::borrow::Cow;
use std::error::Error;

use serde::Serialize;

use friction_stage_core::model::JointType;
use friction_stage_core::numerics::rounded;
use friction_stage_data::quality::Severity;

mod data;
mod effects;
mod guide;
mod identify;
mod lab;
mod model;
mod recording;

pub(crate) use data::subject;
pub use effects::{EffectGroup, effect_groups, effect_phrases, harmonic_name};
pub use guide::guide_label;
pub(crate) use identify::times_noise;
pub use identify::{comparison_notes, records_error};
pub use model::{
    acts_on, effect_text, effects_text, guide_text, guides_text, model_text, multiplicity,
};
pub use recording::{import_text, messages_text, proposal_text, recording_text, recover_text};

/// Where the stage, its guides and its moves come from, within a sentence.
pub(crate) const PAPER: &str = "the MI-Partners paper";
/// The same with its title.
pub(crate) const PAPER_WITH_TITLE: &str = "\u{201c}Recirculating linear ball bearings and their \
    effect on the accuracy of positioning systems\u{201d} (MI-Partners)";

/// What can be said in a sentence.
pub trait Words {
    /// The sentence, without a full stop, as a part of a list or after a colon; with the units of a
    /// joint.
    fn words(&self, joint: JointType) -> String;
}

/// A finding with its code, how much it matters, and the sentence for it, for other programs.
#[derive(Debug, Serialize)]
pub struct Worded<'a, F> {
    code: &'static str,
    severity: &'static str,
    text: String,
    #[serde(flatten)]
    finding: &'a F,
}

impl<'a, F: Words> Worded<'a, F> {
    /// A finding in words, with the units of a joint.
    pub fn new(
        code: &'static str,
        severity: Severity,
        finding: &'a F,
        joint: JointType,
    ) -> Worded<'a, F> {
        Worded { code, severity: severity.name(), text: finding.words(joint), finding }
    }
}

/// The sentences of several findings.
pub fn all_words<'a, F: Words + 'a>(
    findings: impl IntoIterator<Item = &'a F>,
    joint: JointType,
) -> Vec<String> {
    findings.into_iter().map(|finding| finding.words(joint)).collect()
}

/// A text for a terminal: what would move its cursor, change its colours or turn the direction of
/// writing is written out, as `\u001b`, which JSON has for the same. Lines and tabs stay.
///
/// Whatever comes from a file or a peer may hold such characters; everything that is printed goes
/// through here.
pub fn printable(text: &str) -> Cow<'_, str> {
    let is_plain = |c: char| match c {
        '\n' | '\t' => true,
        // Marks and overrides of direction, and separators of lines that are none.
        '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}' => {
            false
        }
        c => !c.is_control(),
    };
    if text.chars().all(is_plain) {
        return Cow::Borrowed(text);
    }
    let mut written = String::with_capacity(text.len() + 16);
    for c in text.chars() {
        if is_plain(c) {
            written.push(c);
        } else {
            written.push_str(&format!("\\u{:04x}", u32::from(c)));
        }
    }
    Cow::Owned(written)
}

/// Most characters of a name that is shown in a table or within a sentence.
const LONGEST_NAME: usize = 200;

/// A name from a file or a peer within a line: as [`printable`], in one line, and cut at 200
/// characters.
pub fn in_line(name: &str) -> Cow<'_, str> {
    let mut shown = printable(name);
    if shown.contains(['\n', '\t']) {
        shown = Cow::Owned(shown.replace('\n', "\\n").replace('\t', "\\t"));
    }
    match shown.char_indices().nth(LONGEST_NAME) {
        Some((cut, _)) => Cow::Owned(format!("{}...", &shown[..cut])),
        None => shown,
    }
}

/// An error with its causes, outermost first. Many an error names its cause in its own text: not
/// again then.
pub fn in_one_line(error: &(dyn Error + 'static)) -> String {
    let mut reported = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        let text = cause.to_string();
        if !reported.contains(&text) {
            reported = format!("{reported}: {text}");
        }
        next = cause.source();
    }
    reported
}

/// A value in SI with its unit, in the prefix that reads well and three digits: 2.5e-5 m is
/// 25.0 µm.
pub fn in_prefix(value: f64, unit: &str) -> String {
    const PREFIXES: [(f64, &str); 4] = [(1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n")];
    let size = to_three_digits(value).abs();
    if !size.is_finite() || size == 0.0 {
        return format!("{value} {unit}");
    }
    let (scale, prefix) =
        PREFIXES.into_iter().find(|(scale, _)| size >= *scale).unwrap_or(PREFIXES[3]);
    format!("{} {prefix}{unit}", short(value / scale))
}

/// The same of a value that was stated, without zeros at its end: 0.05 m is 50 mm.
pub(crate) fn in_prefix_short(value: f64, unit: &str) -> String {
    let shown = in_prefix(value, unit);
    match shown.split_once(' ') {
        Some((number, rest)) if number.contains('.') && !number.contains('e') => {
            format!("{} {rest}", number.trim_end_matches('0').trim_end_matches('.'))
        }
        _ => shown,
    }
}

/// Units that no line break parts from their number.
const UNITS: [&str; 38] = [
    "m",
    "mm",
    "µm",
    "nm",
    "rad",
    "mrad",
    "µrad",
    "nrad",
    "N",
    "kN",
    "mN",
    "Hz",
    "kHz",
    "s",
    "ms",
    "µs",
    "kg",
    "g",
    "%",
    "dB",
    "N/m",
    "kN/m",
    "MN/m",
    "N/µm",
    "m/N",
    "mm/s",
    "m/s",
    "rad/s",
    "µm/s",
    "m/s\u{b2}",
    "J",
    "N\u{b2}",
    "degrees",
    "samples",
    "rows",
    "variants",
    "points",
    "times",
];
/// What may come after `N` within a unit.
const AFTER_NEWTON: [&str; 4] = ["m", "s/m", "m/rad", "m\u{b7}s/rad"];

/// A text in which no line break parts a number from its unit.
pub(crate) fn unbroken(text: &str) -> String {
    let bare =
        |word: &str| word.trim_end_matches(['.', ',', ';', ':', ')', '\u{201d}', '"']).to_owned();
    let words: Vec<&str> = text.split(' ').collect();
    let mut joined = String::with_capacity(text.len() + 8);
    let mut is_unit = false;
    for (index, word) in words.iter().enumerate() {
        if index > 0 {
            let before = words[index - 1];
            let of_number = before.ends_with(|c: char| c.is_ascii_digit())
                && UNITS.contains(&bare(word).as_str());
            let of_newton = is_unit && before == "N" && AFTER_NEWTON.contains(&bare(word).as_str());
            is_unit = of_number;
            joined.push(if of_number || of_newton { '\u{a0}' } else { ' ' });
        }
        joined.push_str(word);
    }
    joined
}

/// A share in per cent with its sign, except of none.
pub(crate) fn signed_percent(share: f64, digits: usize) -> String {
    let shown = format!("{:+.digits$} %", 100.0 * share);
    match shown.contains(|c: char| ('1'..='9').contains(&c)) || !share.is_finite() {
        true => shown,
        false => shown[1..].to_owned(),
    }
}

/// A number with so many digits behind the point; four digits and a power of ten from 10^9 on, as
/// a loop that diverges makes them.
pub(crate) fn fixed(value: f64, digits: usize) -> String {
    match value.abs() {
        size if size >= 1e9 => four_digits(value),
        _ => {
            let shown = format!("{value:.digits$}");
            match shown.strip_prefix('-') {
                Some(zero) if !zero.contains(|c: char| ('1'..='9').contains(&c)) => zero.to_owned(),
                _ => shown,
            }
        }
    }
}

/// A number to the four digits that a person needs of a measured one, without zeros at its end;
/// with a power of ten where it is very large or very small.
pub(crate) fn four_digits(value: f64) -> String {
    let value = rounded(value, 4);
    match value.abs() {
        size if size == 0.0 || (1e-3..1e6).contains(&size) || !size.is_finite() => {
            value.to_string()
        }
        _ => format!("{value:e}"),
    }
}

/// A number to three digits.
pub(crate) fn short(value: f64) -> String {
    let size = to_three_digits(value).abs();
    if value == 0.0 {
        "0".to_owned()
    } else if (1e-3..1e4).contains(&size) {
        let decimals = (2 - size.log10().floor() as i32).max(0) as usize;
        format!("{value:.decimals$}")
    } else {
        format!("{value:.2e}")
    }
}

/// The digits of a number are counted after it is rounded: 9.999 has two before the point.
fn to_three_digits(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_that_is_rounded_up_has_three_digits_as_well() {
        let shown = [9.9996e-9, 9.99e-9, 0.9999e-3, 99.96e-6].map(|value| in_prefix(value, "m"));
        assert_eq!(shown, ["10.0 nm", "9.99 nm", "1.00 mm", "100 µm"]);
    }

    #[test]
    fn numbers_have_the_digits_that_a_person_needs() {
        let shown = [0.984665, 170_567.3, -2.0, 4.56789e-8, 1e300, f64::NAN].map(four_digits);
        assert_eq!(shown, ["0.9847", "170600", "-2", "4.568e-8", "1e300", "NaN"]);
        assert_eq!([12.3456, 1e300, 1e-9].map(|value| fixed(value, 2)), ["12.35", "1e300", "0.00"]);
    }

    #[test]
    fn nothing_has_no_sign_and_a_stated_value_no_zeros_at_its_end() {
        assert_eq!([-0.004, 0.0, -1.25].map(|value| fixed(value, 2)), ["0.00", "0.00", "-1.25"]);
        let shown = [-1e-6, 0.0, 0.0123, -0.5].map(|share| signed_percent(share, 2));
        assert_eq!(shown, ["0.00 %", "0.00 %", "+1.23 %", "-50.00 %"]);
        let shown = [0.05, 1e-5, 2.4e-2, 0.0125].map(|value| in_prefix_short(value, "m"));
        assert_eq!(shown, ["50 mm", "10 µm", "24 mm", "12.5 mm"]);
    }

    #[test]
    fn no_line_break_parts_a_number_from_its_unit() {
        let reported = unbroken("a move of 50 mm in 100 ms, 3 N s/m (12.5 %). 2 N moves 4 stages");
        let joined = "a move of 50\u{a0}mm in 100\u{a0}ms, 3\u{a0}N\u{a0}s/m (12.5\u{a0}%). \
                      2\u{a0}N moves 4 stages";
        assert_eq!(reported, joined);
    }

    #[test]
    fn an_error_is_told_with_each_of_its_causes_once() {
        #[derive(Debug, thiserror::Error)]
        #[error("parameter model")]
        struct Parameter {
            source: Read,
        }
        #[derive(Debug, thiserror::Error)]
        #[error("cannot read a.yaml: {source}")]
        struct Read {
            source: std::io::Error,
        }
        let source = Read { source: std::io::Error::other("no such file") };
        assert_eq!(
            in_one_line(&Parameter { source }),
            "parameter model: cannot read a.yaml: no such file"
        );
    }
}
