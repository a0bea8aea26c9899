//! The raw samples of signals in a table, read row by row: a CSV file, or a file of arrays.

use std::collections::VecDeque;
use std::io::Read;
use std::path::{Path, PathBuf};

use super::array_table::{self, ArrayTable, is_array_file};
use super::arrays::ArrayFile;
use super::data_quality::SignalNote;
use super::error::SignalError;
use super::mapping::{Column, Mapping, Place, Signal, SignalSource};
use super::source::{NO_TIME, Request, Stream, refuse_impossible, seconds_to_nanos};
use super::text_layout::{TextLayout, bare_unit, name};
use super::text_lines::{Lines, Splitter};
use super::text_value::{Decimal, Value};
use super::unit::Unit;
use super::window::Span;
use crate::bag::BagError;
use friction_stage_core::model::JointType;

/// A time that goes back by more than so many usual intervals is not a row that was written late.
const LATE_ROWS: i64 = 50;
/// Share of the fields of a signal that may be empty because samples are missing. With a larger one
/// the signals were sampled at times of their own, and a row is a sample of some of them. Assumed:
/// no logger loses a third of its samples.
const MOST_BLANK: f64 = 1.0 / 3.0;
/// A file ends with no more rows of another kind, as the least and the largest of each column.
/// Assumed; they are kept until it is known that no row of the table follows.
const MOST_AT_END: usize = 64;
const HALF_A_DAY: i64 = 43_200_000_000_000;

/// What a file looks like.
enum Layout {
    Text(TextLayout),
    Arrays(ArrayFile),
}

/// A table by a mapping: where its columns are, and what says the time of a row.
pub(super) struct CsvFile {
    pub path: PathBuf,
    layout: Layout,
    time: Option<SignalSource>,
    rate: Option<f64>,
    joint: JointType,
}

impl CsvFile {
    /// The file at `path`. A mapping that names topics does not fit.
    pub fn new(path: &Path, mapping: &Mapping) -> Result<Self, SignalError> {
        let topic = mapping
            .signals
            .iter()
            .find(|(_, places)| places.iter().any(|s| matches!(s.place, Place::Topic { .. })));
        if let Some((signal, _)) = topic {
            return Err(SignalError::Mapping {
                origin: path.display().to_string(),
                key: format!("signals.{signal}"),
                reason: "the recording is a table, but the mapping names topics".into(),
            });
        }
        let times = || mapping.signals.get(&Signal::Time).into_iter().flatten();
        let joint = mapping.joint_type.unwrap_or_default();
        if is_array_file(path) {
            let file = ArrayFile::open(path)?;
            let is_there = |time: &SignalSource| array_table::column(&file, &time.place).is_ok();
            let time = times().find(|time| mapping.asked_for || is_there(time)).cloned();
            let (path, layout) = (path.to_owned(), Layout::Arrays(file));
            return Ok(Self { path, layout, time, rate: mapping.rate, joint });
        }
        let layout =
            TextLayout::find(path, &mapping.csv).map_err(|e| BagError::reading(path, e))?;
        if layout.either_decimal && mapping.csv.decimal_comma.is_none() {
            return Err(SignalError::Csv {
                path: path.to_owned(),
                line: layout.data_line,
                reason: "its numbers may have a decimal mark or a mark between thousands: say \
                         `csv: {decimal_comma: true}` or `false` in the mapping"
                    .into(),
            });
        }
        let is_there = |time: &SignalSource| match &time.place {
            Place::Column(Column::Name(name)) => layout.names.contains(name),
            _ => column_of(path, &layout, time).is_ok(),
        };
        let time = times().find(|time| mapping.asked_for || is_there(time)).cloned();
        let (path, layout) = (path.to_owned(), Layout::Text(layout));
        Ok(Self { path, layout, time, rate: mapping.rate, joint })
    }

    /// Whether there is a column for a signal.
    pub fn has(&self, source: &SignalSource) -> bool {
        match &self.layout {
            Layout::Text(layout) => column_of(&self.path, layout, source).is_ok(),
            Layout::Arrays(file) => array_table::column(file, &source.place).is_ok(),
        }
    }

    /// Its columns, for people.
    pub fn inventory(&self) -> String {
        match &self.layout {
            Layout::Text(layout) => layout.inventory(),
            Layout::Arrays(file) => array_table::inventory(file),
        }
    }

    /// The rows from the first one on, with the values of these signals.
    pub fn rows<'a>(
        &self,
        columns: impl IntoIterator<Item = &'a (Signal, SignalSource)>,
        captures: Captures,
    ) -> Result<CsvRows<'_>, SignalError> {
        let mut table = match &self.layout {
            Layout::Text(layout) => {
                Table::Text(Box::new(CsvTable::open(&self.path, layout, self.joint, captures)?))
            }
            Layout::Arrays(file) => Table::Arrays(ArrayTable::new(file)),
        };
        let clock = match (&self.time, self.rate) {
            (Some(source), _) => {
                let plus = source.plus.as_ref().map(|plus| {
                    Ok::<_, SignalError>((table.place_plain(&plus.column)?, plus.source()))
                });
                let column = table.place(Signal::Time, source)?;
                let (source, plus) = (source.clone(), plus.transpose()?);
                RowClock::Column(Box::new(ClockColumn { column, source, plus }))
            }
            (None, Some(rate)) => RowClock::Rate(rate),
            (None, None) => {
                return Err(SignalError::MissingSignal {
                    path: self.path.clone(),
                    signal: Signal::Time.name(),
                    needs: "a column `time`, or a mapping that says which column it is, or the \
                            `rate` of the rows"
                        .into(),
                    has: self.inventory(),
                });
            }
        };
        let columns = columns
            .into_iter()
            .map(|(signal, source)| {
                let minus = source.minus.as_ref();
                Ok(PlacedColumn {
                    signal: *signal,
                    column: table.place(*signal, source)?,
                    minus: minus
                        .map(|minus| {
                            Ok::<_, SignalError>((table.place_plain(&minus.column)?, minus.size))
                        })
                        .transpose()?,
                    source: source.clone(),
                })
            })
            .collect::<Result<Vec<_>, SignalError>>()?;
        if let Table::Arrays(table) = &mut table {
            table.read()?;
        }
        Ok(CsvRows {
            row: Fields::none(columns.len()),
            table,
            clock,
            columns,
            captures,
            capture: 0,
            count: 0,
            order: RowOrder::default(),
            ahead: None,
        })
    }

    /// Each request as a stream; one pass over the file.
    pub fn read(&self, requests: &[Request], span: Span) -> Result<Vec<Stream>, SignalError> {
        let mut rows =
            self.rows(requests.iter().flat_map(|request| &request.signals), Captures::One)?;
        let mut streams: Vec<Stream> =
            requests.iter().map(|request| Stream::new(request, 0, span)).collect();
        let (mut blanks, mut count) = (vec![0; streams.len()], 0);
        while let Some(stamp) = rows.next()? {
            let mut from = 0;
            for (stream, blanks) in streams.iter_mut().zip(&mut blanks) {
                let columns = from..from + stream.signals.len();
                from = columns.end;
                *blanks += usize::from(rows.row.blank[columns.clone()].iter().all(|blank| *blank));
                stream.push(stamp, rows.row.values[columns].iter().copied());
            }
            count += 1;
            // All streams have the times of the rows.
            if streams.iter().all(|stream| stream.is_done) {
                break;
            }
        }
        for (stream, blanks) in streams.iter_mut().zip(blanks) {
            if blanks as f64 > MOST_BLANK * count as f64 {
                stream.keep_values();
            }
        }
        if let Some(first) = streams.first_mut() {
            first.notes.extend(rows.notes());
        }
        Ok(streams)
    }
}

/// What to do with a file of several captures, one after the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Captures {
    /// It is refused: their times have nothing to do with each other.
    One,
    /// Rows say of which capture they are.
    Several,
}

/// Visits every row of a table, in bounded memory: its time, ns, none where it has none, and its
/// values in SI.
pub(crate) fn visit_rows(
    path: &Path,
    mapping: &Mapping,
    visit: &mut dyn FnMut(Option<i64>, &[f64]),
) -> Result<(), SignalError> {
    let file = CsvFile::new(path, mapping)?;
    let columns: Vec<(Signal, SignalSource)> = mapping
        .signals
        .iter()
        .filter(|(signal, _)| **signal != Signal::Time)
        .filter_map(|(signal, sources)| {
            Some((*signal, sources.iter().find(|source| file.has(source))?.clone()))
        })
        .collect();
    let mut rows = file.rows(&columns, Captures::One)?;
    while let Some(stamp) = rows.next()? {
        visit((stamp != NO_TIME).then_some(stamp), &rows.row.values);
    }
    Ok(())
}

/// What says when a row was taken.
enum RowClock {
    Column(Box<ClockColumn>),
    /// Hz.
    Rate(f64),
}

/// Where the times of rows stand.
struct ClockColumn {
    column: usize,
    source: SignalSource,
    /// What is added.
    plus: Option<(usize, SignalSource)>,
}

/// Where the values of a signal stand.
struct PlacedColumn {
    signal: Signal,
    column: usize,
    /// Column and size of its unit in those of `column`.
    minus: Option<(usize, f64)>,
    source: SignalSource,
}

/// The rows of a table: the time of each, and its values in SI units. Whoever takes signals from a
/// table, to store them or to examine them, takes them from here.
pub(super) struct CsvRows<'a> {
    table: Table<'a>,
    clock: RowClock,
    columns: Vec<PlacedColumn>,
    captures: Captures,
    /// Of which capture the row is, counted from 0.
    pub capture: u64,
    /// Rows of the capture.
    count: u64,
    order: RowOrder,
    /// A row that was looked at ahead of its turn.
    ahead: Option<(RowTime, Fields)>,
    /// The row that was read last.
    pub row: Fields,
}

/// What a row has of each column.
#[derive(Clone)]
pub(super) struct Fields {
    /// In SI; NaN where there is no number.
    pub values: Vec<f64>,
    /// Whether the field is empty.
    pub blank: Vec<bool>,
}

impl Fields {
    fn none(columns: usize) -> Self {
        Self { values: vec![f64::NAN; columns], blank: vec![true; columns] }
    }
}

/// When a row was taken, as the table has it.
#[derive(Clone, Copy)]
struct RowTime {
    /// ns, [`NO_TIME`] where it has none.
    stamp: i64,
    is_time_of_day: bool,
    line: u64,
    /// Whether lines of words before the row begin another capture.
    begins: bool,
}

impl CsvRows<'_> {
    /// Reads the next row; its time in ns, [`NO_TIME`] where it has none.
    pub fn next(&mut self) -> Result<Option<i64>, SignalError> {
        let Some(row) = self.read()? else { return Ok(None) };
        if row.begins {
            self.capture += 1;
            self.order = RowOrder::default();
        } else if let Some(back) = self.order.behind(&row) {
            let fields = self.row.clone();
            let second = self.read()?;
            self.ahead = second.map(|second| (second, std::mem::replace(&mut self.row, fields)));
            if second.is_some_and(|next| !next.begins && self.order.falls(&row, &next)) {
                let reason = "the times fall from row to row: the newest row comes first; reverse \
                              the rows of the file"
                    .to_owned();
                return Err(self.table.wrong(row.line, reason));
            }
            let begins = second.is_some_and(|next| !next.begins && self.order.goes_on(&row, &next));
            if begins {
                self.begin_by_time(back, row.line)?;
            }
        }
        Ok(Some(self.order.take(&row)))
    }

    /// Another capture begins in `line`, where the time goes back, by so many ns.
    fn begin_by_time(&mut self, back: i64, line: u64) -> Result<(), SignalError> {
        if self.captures == Captures::One {
            let reason = format!(
                "the time goes back by {:.6} s: several captures in one file, or a counter that \
                 restarts; `friction-stage import` with --split makes a bag of each, or leave \
                 `time` out of the mapping and give the `rate` of the rows",
                back as f64 * 1e-9
            );
            return Err(self.table.wrong(line, reason));
        }
        self.capture += 1;
        self.order = RowOrder::default();
        Ok(())
    }

    /// The next row of the table, with its values.
    fn read(&mut self) -> Result<Option<RowTime>, SignalError> {
        if let Some((row, fields)) = self.ahead.take() {
            self.row = fields;
            return Ok(Some(row));
        }
        if !self.table.next()? {
            return Ok(None);
        }
        let begins = self.table.begins_capture();
        if begins {
            self.count = 0;
        }
        let (stamp, is_time_of_day) = match &self.clock {
            RowClock::Column(clock) => {
                let ClockColumn { column, source, plus } = &**clock;
                let stamp = self.table.stamp(*column, source)?;
                let added = plus.as_ref().map(|(column, plus)| self.table.stamp(*column, plus));
                let stamp = match added.transpose()? {
                    None => stamp,
                    Some(added) if stamp == NO_TIME || added == NO_TIME => NO_TIME,
                    Some(added) => stamp.saturating_add(added),
                };
                (stamp, self.table.is_time_of_day(*column))
            }
            RowClock::Rate(rate) => (seconds_to_nanos(self.count as f64 / rate), false),
        };
        self.count += 1;
        if stamp == i64::MAX {
            let reason = "the time is beyond 292 years: a wrong unit or a damaged value";
            return Err(self.table.wrong(self.table.line(), reason.into()));
        }
        for ((value, blank), PlacedColumn { signal, column, minus, source }) in
            self.row.values.iter_mut().zip(&mut self.row.blank).zip(&self.columns)
        {
            *blank = self.table.is_blank(*column);
            let minus = minus.map_or(Ok(0.0), |(minus, size)| {
                self.table.number(minus).map(|value| size * value)
            })?;
            *value = source.to_si(self.table.number(*column)? - minus);
            refuse_impossible(*signal, *value).map_err(|reason| {
                self.table.wrong(self.table.line(), format!("column {}: {reason}", column + 1))
            })?;
        }
        Ok(Some(RowTime { stamp, is_time_of_day, line: self.table.line(), begins }))
    }

    /// What a user should know of the rows up to here.
    pub fn notes(&self) -> Vec<SignalNote> {
        match &self.table {
            Table::Text(table) => table.notes(),
            Table::Arrays(table) => table.notes.clone(),
        }
    }
}

/// A table that is read row by row.
enum Table<'a> {
    Text(Box<CsvTable>),
    Arrays(ArrayTable<'a>),
}

impl Table<'_> {
    /// Index of the column of a signal.
    fn place(&mut self, signal: Signal, source: &SignalSource) -> Result<usize, SignalError> {
        match self {
            Table::Text(table) => table.place(signal, source),
            Table::Arrays(table) => table.place(signal, source),
        }
    }

    /// Index of another column.
    fn place_plain(&mut self, place: &Column) -> Result<usize, SignalError> {
        match self {
            Table::Text(table) => column(&table.path, &table.layout, place),
            Table::Arrays(table) => table.place_plain(place),
        }
    }

    fn next(&mut self) -> Result<bool, SignalError> {
        match self {
            Table::Text(table) => table.next(),
            Table::Arrays(table) => Ok(table.next()),
        }
    }

    /// Line of the row, or its number.
    fn line(&self) -> u64 {
        match self {
            Table::Text(table) => table.line,
            Table::Arrays(table) => table.row(),
        }
    }

    fn wrong(&self, line: u64, reason: String) -> SignalError {
        match self {
            Table::Text(table) => SignalError::Csv { path: table.path.clone(), line, reason },
            Table::Arrays(table) => table.wrong(format!("row {line}: {reason}")),
        }
    }

    /// Whether lines of words before the row begin another capture.
    fn begins_capture(&self) -> bool {
        matches!(self, Table::Text(table) if table.begins_capture)
    }

    fn is_time_of_day(&self, column: usize) -> bool {
        matches!(self, Table::Text(table) if table.is_time_of_day(column))
    }

    /// Whether a field is empty.
    fn is_blank(&self, column: usize) -> bool {
        matches!(self, Table::Text(table) if table.field(column).trim_ascii().is_empty())
    }

    fn number(&self, column: usize) -> Result<f64, SignalError> {
        match self {
            Table::Text(table) => table.number(column),
            Table::Arrays(table) => table.number(column),
        }
    }

    fn stamp(&self, column: usize, source: &SignalSource) -> Result<i64, SignalError> {
        match self {
            Table::Text(table) => table.stamp(column, source),
            Table::Arrays(table) => Ok(table.stamp(column, source)),
        }
    }
}

/// Whether rows come in the order of time. A file is written by one clock: a row that is far behind
/// is one wrong stamp; if time goes on from there, another capture begins.
#[derive(Default)]
struct RowOrder {
    first: Option<i64>,
    latest: i64,
    rows: i64,
    /// What was added to times of day after midnight, ns.
    days: i64,
}

impl RowOrder {
    /// By how much a row is behind, ns, where that is more than a row that was written late: by
    /// many rows, or not after the first one.
    fn behind(&self, row: &RowTime) -> Option<i64> {
        let first = self.first.filter(|_| row.stamp != NO_TIME && self.rows > 1)?;
        let stamp = self.place(row).0;
        let back = self.latest.saturating_sub(stamp);
        let usual = self.latest.saturating_sub(first) / self.rows;
        let is_far = stamp <= first || back > usual.saturating_mul(LATE_ROWS);
        (back > 0 && is_far).then_some(back)
    }

    /// Whether the row after one that is far behind is behind, too: time goes on from there.
    fn goes_on(&self, behind: &RowTime, next: &RowTime) -> bool {
        let stamp = self.place(next).0;
        next.stamp != NO_TIME && stamp >= self.place(behind).0 && stamp < self.latest
    }

    /// Whether the first rows are in the order of time turned round: each is earlier than the one
    /// before.
    fn falls(&self, behind: &RowTime, next: &RowTime) -> bool {
        let (second, third) = (self.place(behind).0, self.place(next).0);
        let first_rows = self.rows == 2 && next.stamp != NO_TIME && second < self.latest;
        first_rows && third < second && self.first == Some(self.latest)
    }

    /// The time of a row, ns, and the days that it counts on. A time of day that jumps back by half
    /// a day has passed midnight.
    fn place(&self, row: &RowTime) -> (i64, i64) {
        let jump = self.latest.saturating_sub(row.stamp.saturating_add(self.days));
        let is_next_day = row.is_time_of_day && self.first.is_some() && jump > HALF_A_DAY;
        let days = self.days + if is_next_day { 2 * HALF_A_DAY } else { 0 };
        (row.stamp.saturating_add(days), days)
    }

    /// The time of the next row, ns.
    fn take(&mut self, row: &RowTime) -> i64 {
        if row.stamp == NO_TIME {
            return NO_TIME;
        }
        let (stamp, days) = self.place(row);
        self.days = days;
        self.latest = if self.first.is_some() { self.latest.max(stamp) } else { stamp };
        self.first = self.first.or(Some(stamp));
        self.rows += 1;
        stamp
    }
}

/// Whether a line is the names of the columns once more.
fn is_names(row: &Splitter, names: &[String]) -> bool {
    !names.is_empty() && row.fields().map(name).eq(names.iter().cloned())
}

/// What a line under the names is.
#[derive(Clone, Copy, PartialEq, Eq)]
enum RowKind {
    Whole,
    /// It has values, but begins with a word where other rows have a value.
    Labelled,
    /// It has fewer fields than there are columns.
    Short,
    /// It has words and no values.
    Words,
}

/// A CSV file, read row by row.
struct CsvTable {
    path: PathBuf,
    layout: TextLayout,
    lines: Lines<Box<dyn Read>>,
    row: Splitter,
    /// Line of the row, and its text.
    line: u64,
    text: Vec<u8>,
    /// Rows that are none of the table, and the line of the first.
    left_out: (u64, u64),
    notes: Vec<SignalNote>,
    /// Of which the units are.
    joint: JointType,
    captures: Captures,
    /// The first line of words after values, which only the end of a capture may have.
    words: Option<u64>,
    /// Whether the names of the columns stand among them once more.
    names_again: bool,
    /// Whether the row is the first one after such lines.
    begins_capture: bool,
    /// Lines from a row on that begins with a word, which only the end of a capture may have.
    held: VecDeque<(u64, Vec<u8>)>,
    /// Whether the names of the columns are among them.
    holds_names: bool,
    /// Such lines that are followed by a row of the table.
    again: VecDeque<(u64, Vec<u8>)>,
}

impl CsvTable {
    fn open(
        path: &Path,
        layout: &TextLayout,
        joint: JointType,
        captures: Captures,
    ) -> Result<Self, SignalError> {
        Ok(Self {
            path: path.to_owned(),
            layout: layout.clone(),
            lines: layout.rows(path).map_err(|e| BagError::reading(path, e))?,
            row: Splitter::new(layout.delimiter),
            line: layout.data_line - 1,
            text: Vec::new(),
            left_out: layout.rows_above,
            notes: Vec::new(),
            joint,
            captures,
            words: None,
            names_again: false,
            begins_capture: false,
            held: VecDeque::new(),
            holds_names: false,
            again: VecDeque::new(),
        })
    }

    /// Index of the column of a signal. A unit that the file gives and the mapping does not take is
    /// worth a note, and so are marks that may be decimal ones.
    fn place(&mut self, signal: Signal, source: &SignalSource) -> Result<usize, SignalError> {
        let column = column_of(&self.path, &self.layout, source)?;
        let written = self.layout.units.get(column).map_or("", |unit| bare_unit(unit));
        let unit = Unit::named(written);
        let is_si = |unit: Unit| unit.size == 1.0 && signal.has_dimension(unit.dimension);
        if source.unit.is_none() && unit.is_some_and(|unit| !is_si(unit)) {
            let (unit, taken) = (written.to_owned(), signal.si_unit(self.joint).to_owned());
            self.notes.push(SignalNote::UnitOfFile { signal, unit, taken });
        }
        if source.scale.is_none() && self.layout.thousands_in_doubt.contains(&column) {
            let is_comma = self.layout.decimal == Decimal::Point;
            self.notes.push(SignalNote::ThousandsInDoubt { signal, is_comma });
        }
        Ok(column)
    }

    /// Goes to the next row; false at the end.
    ///
    /// A row that is cut off, lines of words at the end, and rows that begin with a word there are
    /// left out and counted.
    fn next(&mut self) -> Result<bool, SignalError> {
        loop {
            let is_again = !self.again.is_empty();
            let Some(number) = self.next_line()? else {
                for (number, _) in std::mem::take(&mut self.held) {
                    self.leave_out(number);
                }
                return Ok(false);
            };
            self.line = number;
            self.row.split(&self.text);
            let kind = self.kind();
            // Settings between two captures belong to none.
            if kind == RowKind::Whole && std::mem::take(&mut self.holds_names) {
                for (number, _) in std::mem::take(&mut self.held) {
                    self.words = self.words.or(Some(number));
                    self.leave_out(number);
                }
                self.names_again = true;
            }
            let may_be_end = match kind {
                RowKind::Whole => false,
                RowKind::Labelled => true,
                RowKind::Short | RowKind::Words => !self.held.is_empty(),
            };
            if !is_again && (may_be_end || !self.held.is_empty()) {
                self.holds_names |= is_names(&self.row, &self.layout.names);
                self.held.push_back((number, self.text.clone()));
                if !may_be_end || self.held.len() > MOST_AT_END {
                    self.again = std::mem::take(&mut self.held);
                    self.holds_names = false;
                }
                continue;
            }
            if kind == RowKind::Words {
                self.words = self.words.or(Some(number));
                self.names_again |= is_names(&self.row, &self.layout.names);
            }
            if matches!(kind, RowKind::Words | RowKind::Short) {
                self.leave_out(number);
                continue;
            }
            self.begins_capture = self.words.is_some();
            if let Some(words) = self.words.take()
                && !(self.captures == Captures::Several && std::mem::take(&mut self.names_again))
            {
                return Err(SignalError::Csv {
                    path: self.path.clone(),
                    line: words,
                    reason: format!(
                        "words, and values again in line {number}: another capture or table; {}; \
                         of settings above the table say `csv: {{names_in_line: {}, \
                         data_from_line: {number}}}` in the mapping",
                        if self.names_again {
                            "`friction-stage import` with --split makes a bag of each"
                        } else {
                            "split the file"
                        },
                        number.saturating_sub(1)
                    ),
                });
            }
            return Ok(true);
        }
    }

    /// Takes the next line that is no comment and not empty; its number.
    fn next_line(&mut self) -> Result<Option<u64>, SignalError> {
        if let Some((number, text)) = self.again.pop_front() {
            self.text = text;
            return Ok(Some(number));
        }
        while let Some((number, line)) =
            self.lines.next().map_err(|error| BagError::reading(&self.path, error))?
        {
            let is_comment = self.layout.comment.is_some_and(|mark| line.first() == Some(&mark));
            if !is_comment && !line.trim_ascii().is_empty() {
                self.text.clear();
                self.text.extend(line);
                return Ok(Some(number));
            }
        }
        Ok(None)
    }

    fn kind(&self) -> RowKind {
        let values = || self.row.fields().map(|field| self.layout.value(field));
        let mut has_words = false;
        let is_words = !values().any(|value| {
            has_words |= matches!(value, Value::Text);
            value.is_value()
        });
        if is_words && has_words {
            RowKind::Words
        } else if self.row.len() < self.layout.columns {
            RowKind::Short
        } else if self.layout.begins_with_value
            && values().next() == Some(Value::Text)
            && !Value::of(self.field(0), self.layout.decimal.other()).is_value()
        {
            RowKind::Labelled
        } else {
            RowKind::Whole
        }
    }

    fn notes(&self) -> Vec<SignalNote> {
        let (rows, first_line) = self.left_out;
        let left_out = (rows > 0).then_some(SignalNote::RowsLeftOut { rows, first_line });
        self.notes.iter().cloned().chain(left_out).collect()
    }

    fn leave_out(&mut self, line: u64) {
        let (rows, first) = self.left_out;
        self.left_out = (rows + 1, if rows == 0 { line } else { first });
    }

    fn field(&self, column: usize) -> &[u8] {
        self.row.field(column)
    }

    fn wrong(&self, reason: String) -> SignalError {
        SignalError::Csv { path: self.path.clone(), line: self.line, reason }
    }

    fn not_a_number(&self, column: usize) -> SignalError {
        let field = name(self.field(column));
        let other = self.layout.decimal.other();
        let why = match (Value::of(self.field(column), other), self.layout.decimal) {
            (Value::Number { .. }, Decimal::Comma) => {
                " with a decimal comma, as the others or the mapping have it"
            }
            (Value::Number { .. }, Decimal::Point) => {
                " with a decimal point, as the others or the mapping have it"
            }
            _ if self.layout.value(self.field(column)) == Value::Text => &*format!(
                "; if it stands for a value that is missing, say `csv: {{missing: [{}]}}` in the \
                 mapping",
                serde_json::Value::from(field.as_str())
            ),
            _ => "",
        };
        let called = self.layout.names.get(column).map_or("", String::as_str);
        self.wrong(format!("{field:?} in column {} ({called}) is not a number{why}", column + 1))
    }

    fn is_time_of_day(&self, column: usize) -> bool {
        let value = self.layout.value(self.field(column));
        matches!(value, Value::Time { has_date: false, .. })
    }

    /// The number in a column of this row; NaN where there is none.
    fn number(&self, column: usize) -> Result<f64, SignalError> {
        match self.layout.value(self.field(column)) {
            Value::Number { value, .. } => Ok(value),
            Value::Missing => Ok(f64::NAN),
            Value::Time { .. } | Value::Text => Err(self.not_a_number(column)),
        }
    }

    /// The time in a column of this row, ns; exact for whole numbers, dates and times of day.
    fn stamp(&self, column: usize, source: &SignalSource) -> Result<i64, SignalError> {
        match self.layout.value(self.field(column)) {
            Value::Time { nanoseconds, .. } => Ok(nanoseconds),
            Value::Number { value, .. } => {
                let whole = || std::str::from_utf8(self.field(column)).ok()?.trim().parse().ok();
                let exact = whole().and_then(|whole| source.whole_nanos(whole));
                Ok(exact.unwrap_or_else(|| seconds_to_nanos(source.to_si(value))))
            }
            Value::Missing | Value::Text => Ok(seconds_to_nanos(self.number(column)?)),
        }
    }
}

/// Index of the column of a signal.
fn column_of(
    path: &Path,
    layout: &TextLayout,
    source: &SignalSource,
) -> Result<usize, SignalError> {
    match &source.place {
        Place::Column(place) => column(path, layout, place),
        place @ Place::Topic { .. } => Err(SignalError::Csv {
            path: path.to_owned(),
            line: 1,
            reason: format!("{place} is a topic, not a column"),
        }),
    }
}

/// Index of a column.
fn column(path: &Path, layout: &TextLayout, place: &Column) -> Result<usize, SignalError> {
    let names = &layout.names;
    let missing = |reason: String| SignalError::Csv {
        path: path.to_owned(),
        line: layout.names_line.unwrap_or(1),
        reason,
    };
    if layout.columns == 0 {
        return Err(missing(format!(
            "no rows of numbers were found with {} between columns",
            layout.delimiter
        )));
    }
    if let (Column::Name(_), Some((line, count))) = (place, layout.unplaced) {
        return Err(missing(format!(
            "line {line} has {count} names for {} columns, and which column has none is not known: \
             give the columns by number",
            layout.columns
        )));
    }
    match place {
        Column::Number(number) if *number <= layout.columns => Ok(number - 1),
        Column::Number(number) => {
            Err(missing(format!("no column {number}, there are {}", layout.columns)))
        }
        Column::Name(name) => {
            let mut found = (0..names.len()).filter(|column| names[*column] == *name);
            let Some(column) = found.next() else {
                let hint =
                    friction_stage_core::model::nearest(name, names.iter().map(String::as_str));
                return Err(missing(format!("no column {name:?}; columns are {names:?}{hint}")));
            };
            match found.next() {
                Some(again) => Err(missing(format!(
                    "columns {} and {} are both called {name:?}: give the number",
                    column + 1,
                    again + 1
                ))),
                None => Ok(column),
            }
        }
    }
}
