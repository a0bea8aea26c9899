//! How a text table is written: where its rows begin, what separates columns, what a number looks
//! like.
//!
//! In goes the begin of a file and what a mapping says of it; out comes a [`TextLayout`], found by
//! reading the lines in every way there is and taking the one that gives the most numbers, and of
//! those that give as many the one with the fewest words beside them.
//! Loggers, drives and spreadsheets write lines of settings above the names, a line of units below,
//! decimal commas, blanks between columns; none of it has to be declared.

use std::cmp::Reverse;
use std::fs::File;
use std::io::{self, Cursor, Read};
use std::path::Path;

use encoding_rs::{Encoding, UTF_16BE, UTF_16LE, WINDOWS_1252};
use encoding_rs_io::DecodeReaderBytesBuilder;

use super::column_name::{ColumnName, Quantity};
use super::mapping::{CsvLayout, Delimiter};
use super::text_headings::{Found, Heading, Headings, unit_behind};
use super::text_lines::{Lines, Splitter};
use super::text_value::{Decimal, Value};
use super::unit::{Dimension, Unit};
use friction_stage_core::text_file;

/// So much of a file is looked at, bytes.
const LOOKED_AT: usize = 256 * 1024;

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
    /// Indices of columns in which each number has one mark between thousands, as `1.234`, which
    /// may also be a decimal one, where other columns have decimal marks.
    pub thousands_in_doubt: Vec<usize>,
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
    /// Line and number of names of which it is not known to which columns they belong.
    pub unplaced: Option<(u64, usize)>,
    /// Rows like those of the table that stand above it as settings, and the line of the first.
    pub rows_above: (u64, u64),
    /// Words that stand for a missing value, besides those that are known.
    pub missing: Vec<String>,
    /// Whether rows begin with a value: a row that begins with a word is another one.
    pub begins_with_value: bool,
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
    if let Some(format) = foreign_format(&begin) {
        return Err(io::Error::new(io::ErrorKind::InvalidData, format));
    }
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

/// What a file is that begins as other formats than text do, and what makes a table of it.
fn foreign_format(begin: &[u8]) -> Option<&'static str> {
    const ARRAYS: &str = "an array file whose name has another ending: name it as the program that \
                          wrote it does, .mat, .npy or .npz";
    // The first bytes, as the formats themselves and the list of the program `file` have them.
    let formats: [(&[u8], &str); 18] = [
        (
            b"PK\x03\x04",
            "a ZIP archive, as spreadsheets (.xlsx, .ods) are: save the sheet as CSV, or \
                         unpack it",
        ),
        (b"\xd0\xcf\x11\xe0", "a document of an office program (.xls): save the sheet as CSV"),
        (b"\x1f\x8b", "a gzip file: unpack it"),
        (b"BZh", "a bzip2 file: unpack it"),
        (b"\xfd7zXZ\0", "an xz file: unpack it"),
        (b"\x28\xb5\x2f\xfd", "a zstd file: unpack it"),
        (b"7z\xbc\xaf\x27\x1c", "a 7z archive: unpack it"),
        (b"TDSm", "a TDMS file of LabVIEW: export it as CSV or text"),
        (b"MDF     ", "an MDF file (.mf4, .mdf): export it as CSV or MAT"),
        (
            b"\x89HDF\r\n\x1a\n",
            "an HDF5 file: where it is one of MATLAB, name it .mat; others export \
                                as CSV",
        ),
        (b"MATLAB 5.0 MAT-file", ARRAYS),
        (b"\x93NUMPY", ARRAYS),
        (
            b"SQLite format 3\0",
            "an SQLite database: of a bag give the directory; others export as \
                               CSV",
        ),
        (b"#ROSBAG V", "a bag of ROS 1: convert it with `rosbags-convert`"),
        (b"%PDF", "a PDF: export the values as CSV"),
        (b"PAR1", "a Parquet file: export it as CSV"),
        (b"ARROW1", "an Arrow file: export it as CSV"),
        (b"\x89PNG", "a picture: export the values as CSV"),
    ];
    // Letters alone may be the first name of a table.
    let is_binary = begin.iter().any(|byte| *byte < b' ' && !b"\t\n\r\x0b\x0c".contains(byte));
    let is_letters = |first: &[u8]| first.iter().all(u8::is_ascii_alphanumeric);
    let reported = formats
        .into_iter()
        .find(|(first, _)| begin.starts_with(first) && (is_binary || !is_letters(first)));
    reported.map(|(_, format)| format)
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
    marks: Marks,
    begins_with_value: bool,
    /// Rows like those of the table above it, and the line of the first.
    rows_above: (u64, u64),
    /// Fields that every row has.
    width: usize,
}

/// The marks in numbers, which another reading takes in another way.
#[derive(Default)]
struct Marks {
    points: bool,
    commas: bool,
    /// Whether a column has numbers with a mark, and numbers without one. A program that writes
    /// three decimals writes them in every row, and one that drops zeros leaves fewer than three
    /// at times: where a number can be read in two ways, these are marks between thousands.
    in_some: bool,
    /// Indices of columns in which every number can be read in two ways, among others.
    in_doubt: Vec<usize>,
}

impl Marks {
    fn of<'a>(rows: impl Iterator<Item = &'a Row>, decimal: Decimal) -> Marks {
        let mut columns: Vec<Written> = Vec::new();
        for row in rows {
            if columns.len() < row.written.len() {
                columns.resize(row.written.len(), Written::default());
            }
            for (column, written) in columns.iter_mut().zip(&row.written) {
                column.plain |= written.plain;
                column.point |= written.point;
                column.comma |= written.comma;
                column.one_way |= written.one_way;
            }
        }
        let has_decimals = |column: &Written| match decimal {
            Decimal::Point => column.point,
            Decimal::Comma => column.comma,
        };
        let in_doubt = |column: &Written| !column.one_way && !has_decimals(column);
        let is_any_decimal = columns.iter().any(has_decimals);
        Marks {
            in_doubt: (0..columns.len())
                .filter(|at| {
                    let column = &columns[*at];
                    is_any_decimal && (column.point || column.comma) && in_doubt(column)
                })
                .collect(),
            points: columns.iter().any(|column| column.point),
            commas: columns.iter().any(|column| column.comma),
            in_some: columns.iter().any(|c| c.plain && (c.point || c.comma)),
        }
    }

    fn is_any(&self) -> bool {
        self.points || self.commas
    }

    /// What the marks likely are where they can be both. `;` and tabs separate columns where the
    /// comma is the decimal mark.
    fn likely(&self, delimiter: Delimiter) -> Decimal {
        let for_commas = matches!(delimiter, Delimiter::Byte(b';' | b'\t'));
        match (self.points, self.commas) {
            (true, false) if self.in_some => Decimal::Comma,
            (false, true) if for_commas && !self.in_some => Decimal::Comma,
            _ => Decimal::Point,
        }
    }
}

/// How a number is written.
#[derive(Clone, Copy, Default)]
struct Written {
    plain: bool,
    point: bool,
    comma: bool,
    /// Whether it is a number in one reading only, or the same in both.
    one_way: bool,
}

impl Written {
    fn of(field: &[u8], value: &Value, decimal: Decimal) -> Written {
        if !matches!(value, Value::Number { .. }) {
            return Written::default();
        }
        let (point, comma) = (field.contains(&b'.'), field.contains(&b','));
        let is_plain = !point && !comma;
        let one_way = is_plain || !Value::of(field, decimal.other()).is_value();
        Written { plain: is_plain, point, comma, one_way }
    }
}

/// A table that begins with words above it, after no more rows than this that have names of their
/// own, is not continued by them: they are settings. Assumed: no recording of a motion is as short,
/// and no device has as many channels.
const ROWS_OF_SETTINGS: usize = 20;

impl Reading {
    fn of(lines: &[Line], asked: &CsvLayout, delimiter: Delimiter, decimal: Decimal) -> Reading {
        let mut splitter = Splitter::new(delimiter);
        let rows: Vec<Row> = lines
            .iter()
            .map(|line| {
                let is_comment = asked.comment.is_some_and(|mark| line.text.first() == Some(&mark));
                splitter.split(if is_comment { b"" } else { &line.text });
                Row::of(splitter.fields(), decimal, &asked.missing)
            })
            .collect();
        // Rows follow each other, some of them may be broken; words end them.
        let stretches: Vec<&[Row]> = rows.chunk_by(|_, next| !next.is_words()).collect();
        let most = stretches
            .iter()
            .enumerate()
            .flat_map(|(at, stretch)| longest(stretch).into_iter().map(move |it| (at, it)))
            .max_by_key(|(_, (_, numbers))| *numbers);
        let Some((at, (example, numbers))) = most else {
            return Reading {
                delimiter,
                decimal,
                first: rows.len(),
                columns: 0,
                numbers: 0,
                words: 0,
                marks: Marks::default(),
                begins_with_value: false,
                rows_above: (0, 0),
                width: 0,
            };
        };
        let mut first = begin_of_table(lines, &rows, &stretches, at, example);
        // Rows above with missing last values, or with a word between numbers, belong to it.
        while first > 0
            && rows[first - 1].is_broken(example, first > 1 && rows[first - 2].is_words())
        {
            first -= 1;
        }
        let alike = || rows[first..].iter().filter(|row| row.is_alike(example));
        Reading {
            delimiter,
            decimal,
            first,
            columns: alike().map(Row::columns).max().unwrap_or(0),
            numbers,
            words: example.count(false),
            marks: Marks::of(rows[first..].iter(), decimal),
            begins_with_value: alike().any(|row| row.kinds.first() == Some(&Some(true))),
            rows_above: {
                let above =
                    || lines[..first].iter().zip(&rows).filter(|(_, r)| r.is_alike(example));
                (above().count() as u64, above().next().map_or(0, |(line, _)| line.number))
            },
            width: alike().map(|row| row.kinds.len()).min().unwrap_or(0),
        }
    }
}

/// Index of the row that the table begins with, of which the most rows like `example` are in the
/// stretch `at`.
///
/// It begins with the first row of this kind, even where words come after it: then it is for
/// whoever reads the rows to refuse them. But a few rows that have names of their own, or none
/// where the others have them, are settings.
fn begin_of_table(
    lines: &[Line],
    rows: &[Row],
    stretches: &[&[Row]],
    at: usize,
    example: &Row,
) -> usize {
    let begins: Vec<usize> = stretches
        .iter()
        .scan(0, |next, stretch| Some(std::mem::replace(next, *next + stretch.len())))
        .collect();
    let first_in = |stretch: usize| {
        let within = stretches[stretch].iter().position(|row| row.is_alike(example))?;
        Some(begins[stretch] + within)
    };
    // The lines above a row that may have the names: of words, as many as there are columns.
    let names_above = |row: usize| -> Vec<&[u8]> {
        (0..row)
            .rev()
            .take_while(|above| rows[*above].is_words() || rows[*above].is_blank())
            .filter(|above| {
                let words = rows[*above].columns();
                words.abs_diff(example.columns()) <= 1
                    && (words > 1 || example.columns() == 1)
                    && !rows[*above].has_other
            })
            .map(|above| lines[above].text.as_slice())
            .collect()
    };
    let mut first = first_in(at).unwrap_or(rows.len());
    for earlier in (0..at).rev() {
        let Some(begin) = first_in(earlier) else { continue };
        let alike = || stretches[earlier].iter().filter(|row| row.is_alike(example));
        let (own, others) = (names_above(first), names_above(begin));
        let has_own_names = !own.is_empty() && !own.iter().any(|line| others.contains(line));
        let goes_on = alike().next_back().is_some_and(|last| last.is_before(&rows[first]));
        if has_own_names && !goes_on && alike().count() <= ROWS_OF_SETTINGS {
            break;
        }
        first = begin;
    }
    first
}

/// Whether a line begins with an error of a spreadsheet, such as `#DIV/0!`, which is no comment.
fn begins_with_error(line: &[u8]) -> bool {
    let end = line.iter().position(|byte| b",;\t|".contains(byte)).unwrap_or(line.len());
    let word = line[..end].trim_ascii();
    let is_plain = |byte: &u8| byte.is_ascii_uppercase() || b"#/0_".contains(byte);
    match word.split_last() {
        Some((b'!' | b'?', rest)) => rest.iter().all(is_plain),
        _ => [&b"#N/A"[..], b"#NV"].contains(&word),
    }
}

/// The kind of each field of a line.
struct Row {
    /// Whether it is a value, or words; `None` where it is missing.
    kinds: Vec<Option<bool>>,
    written: Vec<Written>,
    /// The value in its first field, if it is a number.
    begin: Option<f64>,
    /// Whether it has what another reading takes for a number.
    has_other: bool,
}

impl Row {
    fn of<'a>(fields: impl Iterator<Item = &'a [u8]>, decimal: Decimal, missing: &[String]) -> Row {
        let mut has_other = false;
        let (values, written): (Vec<Value>, Vec<Written>) = fields
            .map(|field| {
                let value = Value::among(field, decimal, missing);
                has_other |=
                    matches!(value, Value::Text) && Value::of(field, decimal.other()).is_value();
                (value, Written::of(field, &value, decimal))
            })
            .unzip();
        let kind = |value: &Value| match value {
            Value::Missing => None,
            Value::Text => Some(false),
            Value::Number { .. } | Value::Time { .. } => Some(true),
        };
        Row {
            kinds: values.iter().map(kind).collect(),
            written,
            begin: match values.first() {
                Some(Value::Number { value, .. }) => Some(*value),
                _ => None,
            },
            has_other,
        }
    }

    fn count(&self, kind: bool) -> usize {
        self.kinds.iter().filter(|it| **it == Some(kind)).count()
    }

    fn is_words(&self) -> bool {
        self.count(true) == 0 && self.count(false) > 0
    }

    fn is_blank(&self) -> bool {
        self.kinds.iter().all(Option::is_none)
    }

    /// Whether another row may follow in time, if the first field is the time.
    fn is_before(&self, other: &Row) -> bool {
        self.begin.zip(other.begin).is_some_and(|(one, two)| one < two)
    }

    /// A table may have columns of words, but not mostly.
    fn is_row(&self) -> bool {
        self.count(true) > 0 && self.count(false) <= self.count(true)
    }

    /// Fields without the empty ones at the end, which an end of line that is a delimiter adds, or
    /// as many of them as the widest line of a sheet has.
    fn columns(&self) -> usize {
        self.kinds.iter().rposition(Option::is_some).map_or(0, |last| last + 1)
    }

    /// Whether this row is a labelled setting: it begins with a word, rows like `other` do not, and
    /// its values are in columns that have values in `other`.
    fn is_labelled(&self, other: &Row) -> bool {
        let begins_with_word = |row: &Row| row.kinds.first() == Some(&Some(false));
        let mut pairs = self.kinds.iter().zip(&other.kinds).skip(1);
        let is_of_its_columns = pairs.all(|(one, two)| one.is_none() || two.is_some());
        let is_word = begins_with_word(self) && !self.has_other;
        is_word && !begins_with_word(other) && is_of_its_columns
    }

    /// Whether it has values and words in the same columns as another row.
    fn is_alike(&self, other: &Row) -> bool {
        let (fewer, more) = match self.kinds.len() < other.kinds.len() {
            true => (self, other),
            false => (other, self),
        };
        let as_many = fewer.kinds.len() >= more.columns();
        let is_setting = self.is_labelled(other) || other.is_labelled(self);
        self.is_row() && as_many && !is_setting && self.agrees(other)
    }

    fn agrees(&self, other: &Row) -> bool {
        let pairs = self.kinds.iter().zip(&other.kinds);
        pairs.into_iter().all(|(one, two)| one.is_none() || two.is_none() || one == two)
    }

    /// Whether it is a row like another one with a fault: too short, or a word among its numbers;
    /// at the begin only of the first row, directly under words.
    fn is_broken(&self, other: &Row, is_under_words: bool) -> bool {
        let is_short = self.columns() < other.columns() && self.agrees(other);
        let has_word = self.columns() == other.columns()
            && self.count(true) > self.count(false)
            && (is_under_words && other.kinds.first() == Some(&Some(true))
                || !self.is_labelled(other));
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
        let layout = TextLayout::of(lines(&head, head.len() < LOOKED_AT)?, asked);
        layout.refuse_binary(&head)?;
        Ok(layout)
    }

    /// What a field of a row says.
    pub(super) fn value(&self, field: &[u8]) -> Value {
        Value::among(field, self.decimal, &self.missing)
    }

    /// No text has bytes that are zero, but for those that fill up a block at its end, and fields
    /// of fixed length in settings above the rows.
    fn refuse_binary(&self, head: &[u8]) -> io::Result<()> {
        let end = head.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
        let mut lines = Lines::new(&head[..end]);
        while let Some((number, line)) = lines.next()? {
            if (self.columns == 0 || number >= self.data_line) && line.contains(&0) {
                return Err(io::Error::new(
                    io::ErrorKind::InvalidData,
                    format!("not a text file: line {number} has bytes that are zero"),
                ));
            }
        }
        Ok(())
    }

    /// The lines of the file at `path`, from the first row on.
    pub(super) fn rows(&self, path: &Path) -> io::Result<Lines<Box<dyn Read>>> {
        let mut lines = Lines::new(decoded(path)?);
        lines.skip_before(self.data_line)?;
        Ok(lines)
    }

    /// The lines above the first row, with their numbers.
    pub(super) fn lines_above(&self, path: &Path) -> io::Result<Vec<(u64, String)>> {
        self.lines_before(self.data_line, path)
    }

    /// The lines above a line of this number, with their numbers.
    pub(super) fn lines_before(&self, line: u64, path: &Path) -> io::Result<Vec<(u64, String)>> {
        let mut lines = Lines::new(decoded(path)?);
        let mut above = Vec::new();
        while let Some((number, text)) = lines.next()? {
            if number >= line || above.len() >= SETTINGS {
                break;
            }
            // A tab is no part of a word.
            above.push((number, name(text).replace(char::REPLACEMENT_CHARACTER, " ")));
        }
        Ok(above)
    }

    /// The layout of a text that begins with these lines.
    fn of(mut lines: Vec<Line>, asked: &CsvLayout) -> TextLayout {
        let data_from = asked.data_line.unwrap_or(0);
        let skipped = lines.iter().take_while(|line| line.number < data_from).count();
        let above: Vec<Line> = lines.drain(..skipped).collect();
        let comment = asked.comment.or_else(|| {
            let begins = |mark: u8| {
                let marked = |line: &&Line| line.text.first() == Some(&mark);
                lines.iter().filter(marked).any(|line| !begins_with_error(&line.text))
            };
            [b'#', b'%'].into_iter().find(|mark| begins(*mark))
        });
        let asked = &CsvLayout { comment, ..asked.clone() };
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
            .map(|(delimiter, decimal)| Reading::of(&lines, asked, delimiter, decimal))
            .collect();
        let sense = |reading: &Reading| (reading.numbers, Reverse(reading.words));
        let most = readings.iter().map(sense).max();
        readings.retain(|reading| Some(sense(reading)) == most);
        let mut chosen = readings.swap_remove(0);
        let other = readings.into_iter().find(|reading| {
            reading.delimiter == chosen.delimiter && reading.decimal != chosen.decimal
        });
        let mut either_decimal = false;
        if let Some(other) = other {
            either_decimal = other.marks.is_any() || chosen.marks.is_any();
            if chosen.marks.likely(chosen.delimiter) == other.decimal {
                chosen = other;
            }
        }
        let Reading { delimiter, decimal, first, columns, marks, .. } = chosen;
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
            thousands_in_doubt: marks.in_doubt,
            comment,
            names_line: None,
            units_line: None,
            data_line,
            names: vec![String::new(); columns],
            units: vec![String::new(); columns],
            columns,
            unplaced: None,
            missing: asked.missing.clone(),
            begins_with_value: chosen.begins_with_value,
            rows_above: chosen.rows_above,
        };
        if has_names {
            let rows = &lines[first.min(lines.len())..];
            layout.name_columns(&before, rows, chosen.width, asked.names_line);
        }
        layout
    }

    /// Looks for names and units in the lines above the values. `width`: fields that every row has.
    fn name_columns(&mut self, before: &[&Line], rows: &[Line], width: usize, asked: Option<u64>) {
        let mut splitter = Splitter::new(self.delimiter);
        let above: Vec<Heading> = before
            .iter()
            .rev()
            .filter(|line| !line.text.iter().all(u8::is_ascii_whitespace))
            .map(|line| Heading::of(line.number, &line.text, &mut splitter, self))
            .collect();
        // Without them the first field of a row is for the names of such lines.
        let heads =
            Headings { above, columns: self.columns, begins_empty: !self.begins_with_value };
        let Some(found) = heads.find(asked, width) else { return };
        let Found { names_line, mut names, units_line, mut units, cells, units_cells } = found;
        if cells + 1 == self.columns {
            if !self.begins_with_names(rows, &names) {
                self.unplaced = Some((names_line, names.len()));
                return;
            }
            names.insert(0, String::new());
        }
        if units_cells + 1 == self.columns && units_line.is_some() {
            units.insert(0, String::new());
        }
        // `# fields: t x u` has a label.
        if names.len() == self.columns + 1 && names[0].ends_with(':') {
            names.remove(0);
        }
        let named = names.iter().rposition(|name| !name.is_empty()).map_or(0, |last| last + 1);
        // Behind a time the others stand in order: those at the end have no column.
        let is_time = |name: &String| ColumnName::of(name).quantity == Some(Quantity::Time);
        let begins_with_time = names.first().is_some_and(is_time);
        if named > width.max(self.columns) && !begins_with_time {
            self.unplaced = Some((names_line, named));
            return;
        }
        // Columns without a value in the rows that were looked at.
        self.columns = self.columns.max(named.min(width));
        names.resize(names.len().max(self.columns), String::new());
        names.truncate(named.max(self.columns));
        units.resize(names.len(), String::new());
        (self.names_line, self.names) = (Some(names_line), names);
        (self.units_line, self.units) = (units_line, units);
        // A unit may stand behind the name: `x [mm]`, `force (N)`.
        for (name, unit) in self.names.iter().zip(&mut self.units) {
            if unit.is_empty()
                && let Some(behind) = unit_behind(name)
            {
                *unit = behind.to_owned();
            }
        }
    }

    /// Whether rows that have one value more than there are names begin with the name of the row: a
    /// word, or the number of the row. Where the first name has a unit of time, the second value
    /// must be one.
    fn begins_with_names(&self, rows: &[Line], names: &[String]) -> bool {
        let mut splitter = Splitter::new(self.delimiter);
        let mut number = None;
        let mut time = f64::NEG_INFINITY;
        let first = names.first().map_or("", String::as_str);
        let behind = || Some(first.rsplit_once(['_', '.'])?.1);
        let unit = unit_behind(first).or_else(behind).and_then(Unit::named);
        let is_time = unit.is_some_and(|unit| unit.dimension == Dimension::Time);
        let mut count = 0;
        for line in rows {
            splitter.split(&line.text);
            let of = |field: &[u8]| Value::among(field, self.decimal, &self.missing);
            let (first, second) = (of(splitter.field(0)), of(splitter.field(1)));
            if splitter.len() < self.columns || !splitter.fields().any(|field| of(field).is_value())
            {
                continue;
            }
            count += 1;
            match (first, number) {
                (Value::Text, None) => {}
                (Value::Number { value, .. }, None)
                    if count == 1 && (value == 0.0 || value == 1.0) =>
                {
                    number = Some(value);
                }
                (Value::Number { value, .. }, Some(before)) if value == before + 1.0 => {
                    number = Some(value);
                }
                _ => return false,
            }
            if let Value::Number { value, .. } = second
                && is_time
            {
                if value < time {
                    return false;
                }
                time = value;
            }
        }
        count > 1
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

/// A unit without brackets.
pub(super) fn bare_unit(text: &str) -> &str {
    text.trim().trim_matches(['[', ']', '(', ')', '{', '}'])
}
