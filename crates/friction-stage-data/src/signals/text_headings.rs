//! The lines above the values of a text table: which of them names the columns, and which says the
//! units.
//!
//! In go the lines, the nearest first, and how many columns there are; out come the names and units
//! of the columns. Nearest above the values stand names, in most files; in others units, types,
//! and settings of each channel stand between, or a line has a label that says what it is.

use super::text_layout::{TextLayout, bare_unit, name};
use super::text_lines::Splitter;
use super::text_value::Value;
use super::unit::Unit;

/// A line above the values.
pub(super) struct Heading {
    number: u64,
    /// Its fields, without the empty ones at its end.
    texts: Vec<String>,
    /// Its fields, with them.
    cells: usize,
    /// Whether it has a number or a time.
    has_value: bool,
    /// Whether it has nothing else.
    is_of_values: bool,
}

impl Heading {
    /// Line `number` of the file, with this text.
    pub fn of(number: u64, line: &[u8], splitter: &mut Splitter, layout: &TextLayout) -> Heading {
        // What marks a comment is no part of the first name.
        let marks = line.iter().take_while(|byte| matches!(byte, b'#' | b'%' | b' '));
        let marks = if matches!(line.first(), Some(b'#' | b'%')) { marks.count() } else { 0 };
        splitter.split(&line[marks..]);
        let mut texts: Vec<String> = splitter.fields().map(name).collect();
        let cells = texts.len();
        texts.truncate(texts.iter().rposition(|text| !text.is_empty()).map_or(0, |last| last + 1));
        let values: Vec<Value> =
            splitter.fields().map(|f| Value::among(f, layout.decimal, &layout.missing)).collect();
        let has_value = values.iter().any(Value::is_value);
        let has_words = values.iter().any(|value| matches!(value, Value::Text));
        let is_of_values = has_value && !has_words;
        Heading { number, texts, cells, has_value, is_of_values }
    }

    fn filled(&self) -> impl Iterator<Item = &String> {
        self.texts.iter().filter(|text| !text.is_empty())
    }

    /// Whether the first field says what the others are.
    fn is_labelled(&self, words: &[&str]) -> bool {
        let label = self.texts.first().map(|text| text.to_lowercase()).unwrap_or_default();
        self.texts.len() > 1 && words.iter().any(|word| label.contains(word))
    }

    /// The word that says what all fields are, `Unit: mm`, `SampleRate = 1000 Hz`, and what is
    /// behind it.
    fn attributes(&self) -> Option<(&str, Vec<String>)> {
        let part = |text: &'_ str| -> Option<usize> { text.find([':', '=']) };
        let first = self.filled().next()?;
        let key = &first[..part(first)?];
        let is_one = |text: &String| {
            text[..].strip_prefix(key).is_some_and(|t| {
                t.starts_with([':', '=']) || t.starts_with(" =") || t.starts_with(" :")
            })
        };
        if key.is_empty() || !self.filled().all(is_one) {
            return None;
        }
        let behind = |text: &String| match part(text) {
            Some(at) => text[at + 1..].trim().to_owned(),
            None => String::new(),
        };
        Some((key.trim(), self.texts.iter().map(behind).collect()))
    }

    /// Of a line of pairs, as a program writes it whose channels have two columns each: the word
    /// that every pair begins with, and what follows it.
    fn pairs(&self) -> Option<(&str, Vec<String>)> {
        let key = self.texts.first().filter(|key| !key.is_empty())?;
        let is_key = |(at, text): (usize, &String)| at % 2 == 1 || text == key;
        if self.texts.len() < 3 || !self.texts.iter().enumerate().all(is_key) {
            return None;
        }
        let value = |(at, text): (usize, &String)| {
            if at % 2 == 1 { text.clone() } else { String::new() }
        };
        Some((key, self.texts.iter().enumerate().map(value).collect()))
    }

    /// Whether it says of which type the values are: `float;float;int32`.
    fn is_of_types(&self) -> bool {
        const TYPES: [&str; 22] = [
            "float", "double", "single", "real", "lreal", "int", "sint", "dint", "lint", "uint",
            "usint", "udint", "ulint", "integer", "long", "short", "bool", "boolean", "string",
            "byte", "word", "dword",
        ];
        let is_type = |text: &String| {
            let text = text.to_lowercase();
            let bare = text.trim_end_matches("_t").trim_end_matches(|c: char| c.is_ascii_digit());
            TYPES.contains(&bare)
        };
        self.filled().all(is_type)
    }

    /// Whether it looks like names, more with a larger number: those with units, other words, what
    /// names only one column of several or says something else.
    fn likeness(&self, columns: usize) -> u8 {
        let filled: Vec<&String> = self.filled().collect();
        let is_one_word = filled.windows(2).all(|pair| pair[0] == pair[1]) && columns > 1;
        let is_other = self.has_value
            || is_one_word
            || self.is_of_types()
            || filled.len() > 1 && self.attributes().is_some()
            || are_units(&self.texts);
        let has_unit = |text: &&String| {
            unit_behind(text)
                .is_some_and(|unit| Unit::named(unit).is_some() && text.len() > unit.len() + 2)
        };
        match is_other {
            true => 0,
            // Where one is missing it is not known which.
            false if self.cells >= columns && filled.iter().any(has_unit) => 2,
            false => 1,
        }
    }
}

/// The lines above the values, the nearest first.
pub(super) struct Headings {
    pub above: Vec<Heading>,
    pub columns: usize,
    /// Whether the first field of a row is empty, or a word.
    pub begins_empty: bool,
}

/// Names and units, and the fields of their lines.
pub(super) struct Found {
    pub names_line: u64,
    pub names: Vec<String>,
    pub units_line: Option<u64>,
    pub units: Vec<String>,
    pub cells: usize,
    pub units_cells: usize,
}

const NAME: [&str; 5] = ["name", "path", "channel", "signal", "kanal"];
const UNIT: [&str; 2] = ["unit", "einheit"];

impl Headings {
    /// `asked`: the line of the names, if the mapping gives it.
    pub fn find(&self, asked: Option<u64>, width: usize) -> Option<Found> {
        let fits = |head: &Heading| {
            !head.texts.is_empty()
                && head.cells + 1 >= self.columns
                && head.texts.len() <= width.max(self.columns + 1)
        };
        let near: Vec<&Heading> = match asked {
            Some(line) => {
                let at = self.above.iter().position(|head| head.number == line)?;
                self.above[..=at].iter().collect()
            }
            None => self
                .above
                .iter()
                .take_while(|head| fits(head) && !(head.is_of_values && self.columns > 1))
                .collect(),
        };
        if let Some(found) = self.numbered(asked, &near) {
            return Some(found);
        }
        if let Some(found) = self.pairs(asked) {
            return Some(found);
        }
        if let Some(found) = self.labelled(asked) {
            return Some(found);
        }
        let rank = |head: &Heading| head.likeness(self.columns);
        let at = match asked {
            Some(_) => near.len() - 1,
            None => {
                let nearest = match near.as_slice() {
                    [] => return None,
                    [last, _, ..] if are_units(&last.texts) => 1,
                    _ => 0,
                };
                let best = near.iter().map(|head| rank(head)).max()?;
                match rank(near[nearest]) == best {
                    true => nearest,
                    false => near.iter().position(|head| rank(head) == best)?,
                }
            }
        };
        let below = near[..at].iter().rev();
        let units = below
            .clone()
            .find(|head| are_units(&head.texts))
            .map(|head| (head, head.texts.clone()));
        let attribute = || {
            below.clone().find_map(|head| {
                let (key, units) = head.attributes()?;
                UNIT.contains(&key.to_lowercase().as_str()).then_some((head, units))
            })
        };
        let (units, texts) =
            match units.or_else(attribute).or_else(|| Some((&near[at], Vec::new()))) {
                Some((head, texts)) => (*head, texts),
                None => return None,
            };
        let mut found = Found {
            names_line: near[at].number,
            names: near[at].texts.clone(),
            units_line: (!texts.is_empty()).then_some(units.number),
            units: texts,
            cells: near[at].cells,
            units_cells: units.cells,
        };
        // Settings above may have a line of units with its label, as LabVIEW writes it.
        if found.units_line.is_none()
            && let Some(units) = self.above.iter().find(|head| self.is_labelled_units(head))
        {
            found.units_line = Some(units.number);
            found.units = without_label(&units.texts);
            found.units_cells = self.columns;
        }
        Some(found)
    }

    /// Whether a line with a label has units for the columns behind the first. That of the
    /// horizontal axis of an oscilloscope is of its time.
    fn is_labelled_units(&self, head: &Heading) -> bool {
        head.is_labelled(&UNIT)
            && !head.is_labelled(&["horizontal"])
            && head.texts.len() <= self.columns
            && are_units(&head.texts[1..])
            && head.pairs().is_none()
    }

    /// Where the first field of a row is for labels: a line of names with its label, and one of
    /// units, as dSPACE and oscilloscopes write them.
    fn labelled(&self, asked: Option<u64>) -> Option<Found> {
        if !self.begins_empty {
            return None;
        }
        let is_asked = |head: &Heading| asked.is_none_or(|line| head.number == line);
        let at = self.above.iter().position(|head| {
            is_asked(head)
                && head.is_labelled(&NAME)
                && !head.has_value
                && head.texts.len() == self.columns
        })?;
        let units = self.above[..at].iter().rev().find(|head| self.is_labelled_units(head));
        Some(Found {
            names_line: self.above[at].number,
            names: without_label(&self.above[at].texts),
            units_line: units.map(|head| head.number),
            units: units.map(|head| without_label(&head.texts)).unwrap_or_default(),
            cells: self.columns,
            units_cells: self.columns,
        })
    }

    /// Where every channel has two columns, its time and its value, the names of the values.
    fn pairs(&self, asked: Option<u64>) -> Option<Found> {
        let of = |head: &'_ Heading, words: &[&str]| -> Option<Vec<String>> {
            let (key, values) = head.pairs()?;
            let key = key.to_lowercase();
            let is_one = values.len() <= self.columns && head.cells >= self.columns;
            (is_one && words.iter().any(|word| key.contains(word))).then_some(values)
        };
        let is_asked = |head: &&Heading| asked.is_none_or(|line| head.number == line);
        let (head, names) = self
            .above
            .iter()
            .filter(is_asked)
            .find_map(|head| Some((head, of(head, &["name"])?)))?;
        let units = self.above.iter().find_map(|head| Some((head, of(head, &UNIT)?)));
        Some(Found {
            names_line: head.number,
            names,
            units_line: units.as_ref().map(|(head, _)| head.number),
            units: units.map(|(_, units)| units).unwrap_or_default(),
            cells: self.columns,
            units_cells: self.columns,
        })
    }

    /// Names of which each has a line: `NAME0 = position in mm`, where no line has all of them.
    fn numbered(&self, asked: Option<u64>, near: &[&Heading]) -> Option<Found> {
        if asked.is_none() && near.iter().any(|head| head.likeness(self.columns) > 0) {
            return None;
        }
        let named = |head: &Heading| -> Option<(String, u64, String)> {
            let line = head.texts.join(" ");
            let (key, text) = line.split_once(['=', ':'])?;
            let key = key.trim().to_lowercase();
            let word = key.trim_end_matches(|c: char| c.is_ascii_digit());
            let number = key[word.len()..].parse().ok()?;
            let text = text.trim();
            (!word.is_empty() && text.contains(char::is_alphabetic))
                .then(|| (word.trim_end().to_owned(), number, text.to_owned()))
        };
        let lines: Vec<&Heading> = self.above.iter().rev().collect();
        lines.windows(self.columns.max(1)).find_map(|window| {
            let names: Vec<_> = window.iter().map(|head| named(head)).collect::<Option<_>>()?;
            let (word, first, _) = names.first()?;
            let is_run = *first <= 1
                && names.iter().zip(*first..).all(|(name, at)| name.0 == *word && name.1 == at);
            let is_asked = asked.is_none_or(|line| window[0].number == line);
            (is_run && is_asked).then(|| Found {
                names_line: window[0].number,
                names: names.into_iter().map(|name| name.2).collect(),
                units_line: None,
                units: Vec::new(),
                cells: self.columns,
                units_cells: self.columns,
            })
        })
    }
}

/// Fields of a line that begins with a label, without it.
fn without_label(texts: &[String]) -> Vec<String> {
    std::iter::once(String::new()).chain(texts[1..].iter().cloned()).collect()
}

/// `mm` of `x [mm]` or `x (mm)` or `x / mm` or `x in mm`. `(X)` is a name in brackets.
pub(super) fn unit_behind(name: &str) -> Option<&str> {
    let inside = |open: char, close: char| {
        let rest = name.strip_suffix(close)?;
        let at = rest.rfind(open)?;
        let unit = rest[at + open.len_utf8()..].trim();
        let is_name = rest[..at].trim().is_empty() && Unit::named(unit).is_none();
        (!is_name).then_some(unit)
    };
    let in_unit = || Some(name.rsplit_once(" in ")?.1.trim()).filter(|u| Unit::named(u).is_some());
    inside('[', ']')
        .or_else(|| inside('(', ')'))
        .or_else(|| Some(name.rsplit_once(" / ")?.1.trim()))
        .or_else(in_unit)
        .filter(|unit| !unit.is_empty())
}

/// Whether a line under the names has units: short words, one of them known.
fn are_units(texts: &[String]) -> bool {
    const LONGEST: usize = 12;
    let bare = |text: &String| bare_unit(text).to_owned();
    texts.iter().all(|text| text.chars().count() <= LONGEST)
        && texts.iter().map(bare).any(|text| Unit::named(&text).is_some())
}
