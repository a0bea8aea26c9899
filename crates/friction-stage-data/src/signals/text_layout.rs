//! How a text table is written: where its rows begin, what separates columns, what a number looks
//! like.
//!
//! In goes the begin of a file and what a mapping says of it; out comes a [`TextLayout`], found by
//! reading the lines in every way there is and taking the one that gives the most numbers, and of
//! those that give as many the one with the fewest words beside them.
//! Loggers, drives and spreadsheets write lines of settings above the names, a line of units below,
//! decimal commas, blanks between columns; none of it has to be told.

use std::cmp::Reverse;
use std::fs::File;
use std::io::{self, Cursor, Read};
use std::path::Path;

use encoding_rs::{Encoding, UTF_16BE, UTF_16LE, WINDOWS_1252};
use encoding_rs_io::DecodeReaderBytesBuilder;

use super::mapping::{CsvLayout, Delimiter};
use super::text_lines::{Lines, Splitter};
use super::text_value::{Decimal, Value};
use super::unit::Unit;
use friction_stage_core::text_file;

/// So much of a file is looked at, bytes.
const LOOKED_AT: usize = 64 * 1024;

/// So many lines above a table are read for what they say of it.
const SETTINGS: usize = 1000;

/// How a text table is written.
#[derive(Debug, Clone, PartialEq)]
pub struct TextLayout {
    /// What separates columns.
    pub delimiter: Delimiter,
    /// What numbers look like.
    pub decimal: Decimal,
    /// Whether the numbers that were looked at can be read with a decimal point and with a decimal
    /// comma, as different ones.
    pub either_decimal: bool,
    /// Lines that begin with this hold no values.
    pub comment: Option<u8>,
    /// Line of the names, from 1.
    pub names_line: Option<u64>,
    /// Line of the units, from 1.
    pub units_line: Option<u64>,
    /// First line of values, from 1.
    pub data_line: u64,
    /// Name of each column; empty where there is none.
    pub names: Vec<String>,
    /// Unit of each column, as the file writes it; empty where there is none.
    pub units: Vec<String>,
    /// Columns of a row.
    pub columns: usize,
}

/// The text of a file, as UTF-8 where it is UTF-16, without a byte order mark. Other bytes stay:
/// numbers are ASCII in every other encoding, names are decoded by [`name`].
fn decoded(path: &Path) -> io::Result<Box<dyn Read>> {
    text_file::regular(path)?;
    let mut file = File::open(path)?;
    let mut begin = [0; 1024];
    let mut length = 0;
    while length < begin.len() {
        match file.read(&mut begin[length..])? {
            0 => break,
            read => length += read,
        }
    }
    let begin = begin[..length].to_vec();
    let wide = utf_16(&begin);
    let whole = Cursor::new(begin).chain(file);
    Ok(match wide {
        Some(encoding) => Box::new(
            DecodeReaderBytesBuilder::new()
                .encoding(Some(encoding))
                .bom_sniffing(true)
                .build(whole),
        ),
        None => Box::new(
            DecodeReaderBytesBuilder::new().utf8_passthru(true).strip_bom(true).build(whole),
        ),
    })
}

/// UTF-16 by its mark, or by the zeros that digits have in it.
fn utf_16(begin: &[u8]) -> Option<&'static Encoding> {
    let zeros = |offset: usize| begin.iter().skip(offset).step_by(2).filter(|b| **b == 0).count();
    let most = begin.len() / 4;
    match begin {
        [0xff, 0xfe, ..] => Some(UTF_16LE),
        [0xfe, 0xff, ..] => Some(UTF_16BE),
        [] => None,
        _ if zeros(1) > most => Some(UTF_16LE),
        _ if zeros(0) > most => Some(UTF_16BE),
        _ => None,
    }
}

/// A text field: UTF-8, else as Windows writes it in the west; without control characters.
pub(super) fn name(field: &[u8]) -> String {
    let text = match std::str::from_utf8(field) {
        Ok(text) => text.to_owned(),
        Err(_) => WINDOWS_1252.decode_without_bom_handling(field).0.into_owned(),
    };
    // A name goes to terminals and into files.
    let shown = |c: char| if c.is_control() { char::REPLACEMENT_CHARACTER } else { c };
    text.trim().trim_start_matches('\u{feff}').chars().map(shown).collect()
}

/// A line with its number.
struct Line {
    number: u64,
    text: Vec<u8>,
}

/// The lines of the begin of a file; the last one is not whole unless the file ends with it.
fn lines(head: &[u8], is_whole: bool) -> io::Result<Vec<Line>> {
    let mut lines = Lines::new(head);
    let mut found = Vec::new();
    while let Some((number, text)) = lines.next()? {
        found.push(Line { number, text: text.to_vec() });
    }
    if !is_whole && found.len() > 1 {
        found.pop();
    }
    Ok(found)
}

/// The fields of a line, without what an end of line that is a delimiter adds.
fn fields<'a>(splitter: &'a mut Splitter, line: &[u8]) -> Vec<&'a [u8]> {
    splitter.split(line);
    let mut fields: Vec<&[u8]> = splitter.fields().collect();
    if fields.len() > 1 && fields.last().is_some_and(|field| field.is_empty()) {
        fields.pop();
    }
    fields
}

/// One way to read the lines.
struct Reading {
    delimiter: Delimiter,
    decimal: Decimal,
    /// Index of the first line of values.
    first: usize,
    columns: usize,
    /// Values in the longest stretch of rows alike.
    numbers: usize,
    /// Words in each of them: what a wrong delimiter leaves of numbers, too.
    words: usize,
    /// Whether a number has a mark that the other reading takes in another way.
    is_marked: bool,
}

impl Reading {
    fn of(lines: &[Line], comment: Option<u8>, delimiter: Delimiter, decimal: Decimal) -> Reading {
        let mut splitter = Splitter::new(delimiter);
        let rows: Vec<Row> = lines
            .iter()
            .map(|line| {
                let is_comment = comment.is_some_and(|mark| line.text.first() == Some(&mark));
                splitter.split(if is_comment { b"" } else { &line.text });
                Row::of(splitter.fields(), decimal)
            })
            .collect();
        // Rows follow each other, some of them may be broken; words end them.
        let stretches: Vec<&[Row]> = rows.chunk_by(|_, next| !next.is_words()).collect();
        let most = stretches.iter().flat_map(|stretch| longest(stretch)).max_by_key(|(_, n)| *n);
        let Some((example, numbers)) = most else {
            return Reading {
                delimiter,
                decimal,
                first: rows.len(),
                columns: 0,
                numbers: 0,
                words: 0,
                is_marked: false,
            };
        };
        // The table begins with the first row of this kind, even where words come after it: then it
        // is for whoever reads the rows to refuse them.
        let mut first = rows.iter().position(|row| row.is_alike(example)).unwrap_or(rows.len());
        // Rows above with missing last values, or with a word between numbers, belong to it.
        while first > 0 && rows[first - 1].is_broken(example) {
            first -= 1;
        }
        let is_marked = rows[first..].iter().any(|row| row.is_marked);
        Reading {
            delimiter,
            decimal,
            first,
            columns: rows
                .iter()
                .filter(|row| row.is_alike(example))
                .map(Row::columns)
                .max()
                .unwrap_or(0),
            numbers,
            words: example.count(false),
            is_marked,
        }
    }
}

/// The kind of each field of a line.
struct Row {
    /// Whether it is a value, or words; `None` where it is missing.
    kinds: Vec<Option<bool>>,
    is_marked: bool,
}

impl Row {
    fn of<'a>(fields: impl Iterator<Item = &'a [u8]>, decimal: Decimal) -> Row {
        let values: Vec<Value> = fields.map(|field| Value::of(field, decimal)).collect();
        let kind = |value: &Value| match value {
            Value::Missing => None,
            Value::Text => Some(false),
            Value::Number { .. } | Value::Time { .. } => Some(true),
        };
        Row {
            kinds: values.iter().map(kind).collect(),
            is_marked: values.iter().any(|v| matches!(v, Value::Number { marked: true, .. })),
        }
    }

    fn count(&self, kind: bool) -> usize {
        self.kinds.iter().filter(|it| **it == Some(kind)).count()
    }

    fn is_words(&self) -> bool {
        self.count(true) == 0 && self.count(false) > 0
    }

    /// A table may have columns of words, but not mostly.
    fn is_row(&self) -> bool {
        self.count(true) > 0 && self.count(false) <= self.count(true)
    }

    /// Fields without what an end of line that is a delimiter adds, or a last value that is
    /// missing.
    fn columns(&self) -> usize {
        self.kinds.len() - usize::from(self.kinds.last() == Some(&None))
    }

    /// Whether it has values and words in the same columns as another row.
    fn is_alike(&self, other: &Row) -> bool {
        let (fewer, more) = match self.kinds.len() < other.kinds.len() {
            true => (self, other),
            false => (other, self),
        };
        let as_many = fewer.kinds.len() == more.kinds.len() || fewer.kinds.len() == more.columns();
        self.is_row() && as_many && self.agrees(other)
    }

    fn agrees(&self, other: &Row) -> bool {
        let pairs = self.kinds.iter().zip(&other.kinds);
        pairs.into_iter().all(|(one, two)| one.is_none() || two.is_none() || one == two)
    }

    /// Whether it is a row like another one with a fault: too short, or a word among its numbers.
    fn is_broken(&self, other: &Row) -> bool {
        let is_short = self.columns() < other.columns() && self.agrees(other);
        let has_word = self.columns() == other.columns() && self.count(true) > self.count(false);
        self.is_row() && (is_short || has_word)
    }
}

/// For each row of a stretch that is unlike those before: it, and the values in all rows like it.
fn longest(stretch: &[Row]) -> Vec<(&Row, usize)> {
    let mut found: Vec<(&Row, usize)> = Vec::new();
    for row in stretch.iter().filter(|row| row.is_row()) {
        match found.iter_mut().find(|(example, _)| row.is_alike(example)) {
            Some((_, numbers)) => *numbers += row.count(true),
            None => found.push((row, row.count(true))),
        }
    }
    found
}

impl TextLayout {
    /// Looks at the file at `path`; what `asked` says counts.
    pub fn find(path: &Path, asked: &CsvLayout) -> io::Result<TextLayout> {
        let mut head = Vec::new();
        decoded(path)?.take(LOOKED_AT as u64).read_to_end(&mut head)?;
        Ok(TextLayout::of(lines(&head, head.len() < LOOKED_AT)?, asked))
    }

    /// The lines of the file at `path`, from the first row on.
    pub(super) fn rows(&self, path: &Path) -> io::Result<Lines<Box<dyn Read>>> {
        let mut lines = Lines::new(decoded(path)?);
        lines.skip_before(self.data_line)?;
        Ok(lines)
    }

    /// The lines above the first row, with their numbers.
    pub(super) fn lines_above(&self, path: &Path) -> io::Result<Vec<(u64, String)>> {
        let mut lines = Lines::new(decoded(path)?);
        let mut above = Vec::new();
        while let Some((number, text)) = lines.next()? {
            if number >= self.data_line || above.len() >= SETTINGS {
                break;
            }
            above.push((number, name(text)));
        }
        Ok(above)
    }

    /// The layout of a text that begins with these lines.
    fn of(mut lines: Vec<Line>, asked: &CsvLayout) -> TextLayout {
        let data_from = asked.data_line.unwrap_or(0);
        let skipped = lines.iter().take_while(|line| line.number < data_from).count();
        let above: Vec<Line> = lines.drain(..skipped).collect();
        let comment = asked.comment.or_else(|| {
            let begins = |mark: u8| lines.iter().any(|line| line.text.first() == Some(&mark));
            [b'#', b'%'].into_iter().find(|mark| begins(*mark))
        });
        let delimiters = match asked.delimiter {
            Some(delimiter) => vec![delimiter],
            None => [b',', b';', b'\t', b'|']
                .into_iter()
                .map(Delimiter::Byte)
                .chain([Delimiter::Blanks])
                .collect(),
        };
        let decimals = match asked.decimal_comma {
            Some(true) => vec![Decimal::Comma],
            Some(false) => vec![Decimal::Point],
            None => vec![Decimal::Point, Decimal::Comma],
        };
        let mut readings: Vec<Reading> = delimiters
            .iter()
            .flat_map(|delimiter| decimals.iter().map(move |decimal| (*delimiter, *decimal)))
            .map(|(delimiter, decimal)| Reading::of(&lines, comment, delimiter, decimal))
            .collect();
        let sense = |reading: &Reading| (reading.numbers, Reverse(reading.words));
        let most = readings.iter().map(sense).max();
        readings.retain(|reading| Some(sense(reading)) == most);
        let chosen = readings.swap_remove(0);
        let other = readings.iter().find(|reading| {
            reading.delimiter == chosen.delimiter && reading.decimal != chosen.decimal
        });
        let either_decimal = other.is_some_and(|other| other.is_marked || chosen.is_marked);
        let Reading { delimiter, decimal, first, columns, .. } = chosen;
        let has_names = asked.header != Some(false);
        // Without a row there are names at most.
        let data_line = match lines.get(first) {
            Some(line) => line.number,
            None => lines.last().or(above.last()).map_or(0, |line| line.number) + 1,
        };
        let before: Vec<&Line> = above.iter().chain(&lines[..first.min(lines.len())]).collect();
        let mut layout = TextLayout {
            delimiter,
            decimal,
            either_decimal,
            comment,
            names_line: None,
            units_line: None,
            data_line,
            names: vec![String::new(); columns],
            units: vec![String::new(); columns],
            columns,
        };
        if has_names {
            layout.name_columns(&before, asked.names_line);
        }
        layout
    }

    /// Looks for names and units in the lines above the values.
    fn name_columns(&mut self, before: &[&Line], asked: Option<u64>) {
        // What marks a comment is no part of the first name.
        let mut splitter = Splitter::new(self.delimiter);
        let mut texts = |line: &Line| -> Vec<String> {
            let marks = line.text.iter().take_while(|byte| matches!(byte, b'#' | b'%' | b' '));
            let marks =
                if matches!(line.text.first(), Some(b'#' | b'%')) { marks.count() } else { 0 };
            fields(&mut splitter, &line.text[marks..]).into_iter().map(name).collect()
        };
        let fits = |texts: &[String]| {
            texts.len().abs_diff(self.columns) <= 1 && texts.iter().any(|text| !text.is_empty())
        };
        let filled: Vec<(u64, Vec<String>)> = before
            .iter()
            .rev()
            .filter(|line| !line.text.iter().all(u8::is_ascii_whitespace))
            .map(|line| (line.number, texts(line)))
            .take_while(|(_, texts)| asked.is_some() || fits(texts))
            .collect();
        let at = match asked {
            Some(line) => filled.iter().position(|(number, _)| *number == line),
            None => match filled.as_slice() {
                [] => None,
                [(_, last), _, ..] if are_units(last) => Some(1),
                _ => Some(0),
            },
        };
        let Some(at) = at else { return };
        let mut take = |(line, texts): &(u64, Vec<String>),
                        into: fn(&mut Self) -> &mut Vec<String>| {
            let columns = self.columns.max(texts.len());
            let mut texts = texts.clone();
            texts.resize(columns, String::new());
            *into(self) = texts;
            Some(*line)
        };
        let names_line = take(&filled[at], |layout| &mut layout.names);
        let below = at.checked_sub(1).and_then(|below| filled.get(below));
        let units_line = match below {
            Some(units) if are_units(&units.1) => take(units, |layout| &mut layout.units),
            _ => None,
        };
        (self.names_line, self.units_line) = (names_line, units_line);
        // A unit may stand behind the name: `x [mm]`, `force (N)`.
        let columns = self.names.len();
        self.units.resize(columns, String::new());
        for (name, unit) in self.names.iter().zip(&mut self.units) {
            if unit.is_empty()
                && let Some(behind) = unit_behind(name)
            {
                *unit = behind.to_owned();
            }
        }
    }

    /// Names for people.
    pub fn inventory(&self) -> String {
        if self.names_line.is_some() {
            self.names.join(", ")
        } else {
            format!("{} columns without names", self.columns)
        }
    }
}

/// `mm` of `x [mm]` or `x (mm)` or `x / mm`.
fn unit_behind(name: &str) -> Option<&str> {
    let inside = |open: char, close: char| {
        let rest = name.strip_suffix(close)?;
        Some(rest[rest.rfind(open)? + open.len_utf8()..].trim())
    };
    inside('[', ']')
        .or_else(|| inside('(', ')'))
        .or_else(|| Some(name.rsplit_once(" / ")?.1.trim()))
        .filter(|unit| !unit.is_empty())
}

/// Whether a line under the names has units: short words, one of them known.
fn are_units(texts: &[String]) -> bool {
    const LONGEST: usize = 12;
    let bare = |text: &String| bare_unit(text).to_owned();
    texts.iter().all(|text| text.chars().count() <= LONGEST)
        && texts.iter().map(bare).any(|text| Unit::named(&text).is_some())
}

/// A unit without brackets.
pub(super) fn bare_unit(text: &str) -> &str {
    text.trim().trim_matches(['[', ']', '(', ')', '{', '}'])
}
