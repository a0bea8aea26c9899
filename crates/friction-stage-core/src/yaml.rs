//! YAML that a person writes (models, catalogues, mappings, motions, applications), and the words
//! for what is wrong with it.

use std::borrow::Cow;

use serde::de::DeserializeOwned;
use serde_saphyr::localizer::Localizer;
use serde_saphyr::{Error, Location, MessageFormatter, UserMessageFormatter};

use crate::model::nearest;

/// Longest part of a line that is quoted in a message, characters.
const QUOTED: usize = 60;

/// Reads a text.
///
/// # Errors
/// What is wrong, the line with its number, and the nearest name where one is unknown.
pub fn read<T: DeserializeOwned>(text: &str) -> Result<T, String> {
    serde_saphyr::from_str(text).map_err(|error| problem(&error, text))
}

/// What is wrong with a text, in the words of who writes it.
pub fn problem(error: &Error, text: &str) -> String {
    said(error, text, &Words)
}

/// As [`problem`], without the line and the column.
pub fn problem_alone(error: &Error, text: &str) -> String {
    said(error, text, &WithoutPlace)
}

fn said(error: &Error, text: &str, formatter: &dyn MessageFormatter) -> String {
    let error = error.without_snippet();
    let words = error.render_with_formatter(formatter);
    let hint = match error {
        Error::SerdeUnknownField { field: given, expected, .. }
        | Error::SerdeUnknownVariant { variant: given, expected, .. } => {
            nearest(given, expected.iter().copied())
        }
        _ => error.location().and_then(|place| quoted(text, place.line())).unwrap_or_default(),
    };
    format!("{words}{hint}")
}

/// `: ` with the line of this number, from 1; `None` where it says nothing.
fn quoted(text: &str, number: u64) -> Option<String> {
    let line = text.lines().nth(usize::try_from(number).ok()?.checked_sub(1)?)?.trim();
    let short: String = line.chars().take(QUOTED).collect();
    let more = if short.len() < line.len() { "..." } else { "" };
    (!line.is_empty()).then(|| format!(": `{short}{more}`"))
}

/// Words without the types of the program that reads.
struct Words;

impl MessageFormatter for Words {
    fn format_message<'a>(&self, error: &'a Error) -> Cow<'a, str> {
        let names = |what: &str, given: &str, known: &[&str]| {
            Cow::Owned(format!("unknown {what} `{given}`, expected one of {}", known.join(", ")))
        };
        match error {
            Error::InvalidScalar { ty, .. } => wanted(ty).into(),
            Error::Unexpected { expected, .. } => wanted(expected).into(),
            Error::SerdeInvalidType { expected, .. }
            | Error::SerdeInvalidValue { expected, .. } => wanted(expected).into(),
            Error::SerdeUnknownField { field, expected, .. } => names("key", field, expected),
            Error::SerdeUnknownVariant { variant, expected, .. } => {
                names("name", variant, expected)
            }
            Error::SerdeMissingField { field, .. } => {
                format!("the key `{field}` is missing").into()
            }
            Error::DuplicateMappingKey { key, .. } => match key {
                Some(key) => format!("the key {key} stands here a second time").into(),
                None => "a key stands here a second time".into(),
            },
            Error::NullIntoString { .. } => "a text is expected".into(),
            // What the parser says of the signs of YAML.
            Error::ExternalMessage { msg, .. } => {
                format!("broken ({msg}): look at indentation, colons, brackets and quotes").into()
            }
            _ => UserMessageFormatter.format_message(error),
        }
    }
}

/// As [`Words`], without a place.
struct WithoutPlace;

impl MessageFormatter for WithoutPlace {
    fn localizer(&self) -> &dyn Localizer {
        self
    }

    fn format_message<'a>(&self, error: &'a Error) -> Cow<'a, str> {
        Words.format_message(error)
    }
}

impl Localizer for WithoutPlace {
    fn attach_location<'a>(&self, words: Cow<'a, str>, _: Location) -> Cow<'a, str> {
        words
    }
}

/// What is expected, in the words of the file, from what a deserializer asks for.
fn wanted(expected: &str) -> String {
    let bits = expected.strip_prefix(['u', 'i']).and_then(|bits| bits.parse::<u8>().ok());
    match expected {
        "floating point" | "f64" | "f32" => "a number is expected".to_owned(),
        "bool" | "boolean" => "true or false is expected".to_owned(),
        "string scalar" => "a single value is expected".to_owned(),
        "string" | "a string" => "a text is expected".to_owned(),
        "sequence start" | "seq" | "a sequence" => "a list is expected".to_owned(),
        "mapping start" | "a map" => "keys with values are expected".to_owned(),
        _ if bits.is_some() => "a whole number is expected".to_owned(),
        _ => match expected.strip_prefix("struct ") {
            Some(_) => "keys with values are expected".to_owned(),
            None => format!("expected {expected}"),
        },
    }
}

#[cfg(test)]
mod tests {
    use crate::model::StageModel;

    #[test]
    fn what_is_wrong_is_said_without_the_types_of_the_reader() {
        for (text, expected) in [
            ("mass: heavy", "a number is expected at line 1, column 7: `mass: heavy`"),
            ("mass: 40\nguides: 3", "a list is expected at line 2, column 9: `guides: 3`"),
            ("mass: {a: 1}", "a single value is expected at line 1, column 7: `mass: {a: 1}`"),
            ("motor: [1]", "keys with values are expected at line 1, column 8: `motor: [1]`"),
            ("name: [a]", "a single value is expected at line 1, column 7: `name: [a]`"),
            ("mass: 1\nmass: 2", "the key mass stands here a second time at line 2, column 1"),
            ("mas: 1", "unknown key `mas`, expected one of name, joint, mass"),
        ] {
            let error = StageModel::from_yaml(text, "a model").unwrap_err().to_string();
            assert!(error.contains(expected), "{text}: {error}");
        }
    }
}
