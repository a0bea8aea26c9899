//! The raw samples of signals in a table, read row by row: a CSV file, or a file of arrays.

use std::io::Read;
use std::path::{Path, PathBuf};

use super::array_table::{self, ArrayTable, is_array_file};
use super::arrays::ArrayFile;
use super::data_quality::SignalNote;
use super::error::SignalError;
use super::mapping::{Column, Mapping, Place, Signal, SignalSource};
use super::source::{NO_TIME, Request, Stream, seconds_to_nanos};
use super::text_layout::{TextLayout, bare_unit, name};
use super::text_lines::{Lines, Splitter};
use super::text_value::{Decimal, Value};
use super::unit::Unit;
use crate::bag::BagError;
use friction_stage_core::model::JointType;

/// A time that goes back by more than so many usual intervals is not a row that was written late.
const LATE_ROWS: i64 = 50;
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
        let time = mapping.signals.get(&Signal::Time).and_then(|sources| sources.first().cloned());
        let joint = mapping.joint_type.unwrap_or_default();
        if is_array_file(path) {
            let file = ArrayFile::open(path)?;
            let is_there = |time: &SignalSource| array_table::column(&file, &time.place).is_ok();
            let time = time.filter(|time| mapping.asked_for || is_there(time));
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
        let is_named = layout.names.iter().any(|name| name == Signal::Time.name());
        let time = time.filter(|_| mapping.asked_for || is_named);
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
    ) -> Result<CsvRows<'_>, SignalError> {
        let mut table = match &self.layout {
            Layout::Text(layout) => {
                Table::Text(Box::new(CsvTable::open(&self.path, layout, self.joint)?))
            }
            Layout::Arrays(file) => Table::Arrays(ArrayTable::new(file)),
        };
        let clock = match (&self.time, self.rate) {
            (Some(source), _) => {
                RowClock::Column(table.place(Signal::Time, source)?, source.clone())
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
                    column: table.place(*signal, source)?,
                    minus: minus.map(|place| table.place_plain(place)).transpose()?,
                    source: source.clone(),
                })
            })
            .collect::<Result<Vec<_>, SignalError>>()?;
        if let Table::Arrays(table) = &mut table {
            table.read()?;
        }
        Ok(CsvRows {
            values: vec![f64::NAN; columns.len()],
            table,
            clock,
            columns,
            count: 0,
            order: RowOrder::default(),
        })
    }

    /// Each request as a stream; one pass over the file.
    pub fn read(&self, requests: &[Request]) -> Result<Vec<Stream>, SignalError> {
        let mut rows = self.rows(requests.iter().flat_map(|request| &request.signals))?;
        let mut streams: Vec<Stream> =
            requests.iter().map(|request| Stream::new(request, 0)).collect();
        while let Some(stamp) = rows.next()? {
            let mut values = rows.values.iter();
            for stream in &mut streams {
                stream.stamps.push(stamp);
                for (column, value) in stream.values.iter_mut().zip(values.by_ref()) {
                    column.push(*value);
                }
            }
        }
        if let Some(first) = streams.first_mut() {
            first.notes.extend(rows.notes());
        }
        Ok(streams)
    }
}

/// What says when a row was taken.
enum RowClock {
    Column(usize, SignalSource),
    /// Hz.
    Rate(f64),
}

/// Where the values of a signal stand.
struct PlacedColumn {
    column: usize,
    minus: Option<usize>,
    source: SignalSource,
}

/// The rows of a table: the time of each, and its values in SI units. Whoever takes signals from a
/// table, to store them or to examine them, takes them from here.
pub(super) struct CsvRows<'a> {
    table: Table<'a>,
    clock: RowClock,
    columns: Vec<PlacedColumn>,
    count: u64,
    order: RowOrder,
    /// Values of the row that was read last; NaN for an empty field.
    pub values: Vec<f64>,
}

impl CsvRows<'_> {
    /// Reads the next row; its time in ns, [`NO_TIME`] where it has none.
    pub fn next(&mut self) -> Result<Option<i64>, SignalError> {
        if !self.table.next()? {
            return Ok(None);
        }
        let stamp = match &self.clock {
            RowClock::Column(column, source) => {
                let stamp = self.table.stamp(*column, source)?;
                let is_time_of_day = self.table.is_time_of_day(*column);
                let placed = self.order.next(stamp, is_time_of_day, self.table.line());
                placed.map_err(|(back, line)| {
                    let reason = format!(
                        "the time goes back by {:.6} s: several captures in one file, or a \
                         counter that restarts; split the file, or leave `time` out of the \
                         mapping and give the `rate` of the rows",
                        back as f64 * 1e-9
                    );
                    self.table.wrong(line, reason)
                })?
            }
            RowClock::Rate(rate) => seconds_to_nanos(self.count as f64 / rate),
        };
        self.count += 1;
        for (value, PlacedColumn { column, minus, source }) in
            self.values.iter_mut().zip(&self.columns)
        {
            let minus = minus.map_or(Ok(0.0), |minus| self.table.number(minus))?;
            *value = source.to_si(self.table.number(*column)? - minus);
        }
        Ok(Some(stamp))
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

    fn is_time_of_day(&self, column: usize) -> bool {
        matches!(self, Table::Text(table) if table.is_time_of_day(column))
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

/// Whether rows come in the order of time. A file is written by one clock: a row that is behind is
/// one that was written late, or one wrong stamp; two of them that are far behind, or not after the
/// first row, begin another capture.
#[derive(Default)]
struct RowOrder {
    first: Option<i64>,
    latest: i64,
    rows: i64,
    /// By how much the row before was far behind, ns, and its line.
    behind: Option<(i64, u64)>,
    /// What was added to times of day after midnight, ns.
    days: i64,
}

impl RowOrder {
    /// The time of the next row, in `line`; or by how much the time goes back, ns, and in which
    /// line. A time of day that jumps back by half a day has passed midnight.
    fn next(&mut self, stamp: i64, is_time_of_day: bool, line: u64) -> Result<i64, (i64, u64)> {
        if stamp == NO_TIME {
            return Ok(stamp);
        }
        if is_time_of_day && self.latest.saturating_sub(stamp + self.days) > HALF_A_DAY {
            self.days += 2 * HALF_A_DAY;
        }
        let stamp = stamp.saturating_add(self.days);
        let Some(first) = self.first else {
            (self.first, self.latest, self.rows) = (Some(stamp), stamp, 1);
            return Ok(stamp);
        };
        let back = self.latest.saturating_sub(stamp);
        let usual = self.latest.saturating_sub(first) / self.rows;
        let is_far = back > 0 && (stamp <= first || back > usual.saturating_mul(LATE_ROWS));
        match (is_far && self.rows > 1, self.behind) {
            (true, Some(begin)) => return Err(begin),
            (true, None) => self.behind = Some((back, line)),
            (false, _) => self.behind = None,
        }
        self.rows += 1;
        self.latest = self.latest.max(stamp);
        Ok(stamp)
    }
}

/// A CSV file, read row by row.
struct CsvTable {
    path: PathBuf,
    layout: TextLayout,
    lines: Lines<Box<dyn Read>>,
    row: Splitter,
    /// Line of the row.
    line: u64,
    /// Rows that are none of the table, and the line of the first.
    left_out: (u64, u64),
    notes: Vec<SignalNote>,
    /// Of which the units are.
    joint: JointType,
    /// A line of words, which only the end of the file may have: its line.
    words: Option<u64>,
}

impl CsvTable {
    fn open(path: &Path, layout: &TextLayout, joint: JointType) -> Result<Self, SignalError> {
        Ok(Self {
            path: path.to_owned(),
            layout: layout.clone(),
            lines: layout.rows(path).map_err(|e| BagError::reading(path, e))?,
            row: Splitter::new(layout.delimiter),
            line: layout.data_line - 1,
            left_out: (0, 0),
            notes: Vec::new(),
            joint,
            words: None,
        })
    }

    /// Index of the column of a signal. A unit that the file gives and the mapping does not take is
    /// worth a note.
    fn place(&mut self, signal: Signal, source: &SignalSource) -> Result<usize, SignalError> {
        let column = column_of(&self.path, &self.layout, source)?;
        let written = self.layout.units.get(column).map_or("", |unit| bare_unit(unit));
        let unit = Unit::named(written);
        let is_si = |unit: Unit| unit.size == 1.0 && signal.has_dimension(unit.dimension);
        if source.unit.is_none() && unit.is_some_and(|unit| !is_si(unit)) {
            let (unit, taken) = (written.to_owned(), signal.si_unit(self.joint).to_owned());
            self.notes.push(SignalNote::UnitOfFile { signal, unit, taken });
        }
        Ok(column)
    }

    /// Goes to the next row; false at the end.
    ///
    /// A row that is cut off, and lines of words at the end, are left out and counted.
    fn next(&mut self) -> Result<bool, SignalError> {
        while let Some((number, line)) =
            self.lines.next().map_err(|error| BagError::reading(&self.path, error))?
        {
            let is_comment = self.layout.comment.is_some_and(|mark| line.first() == Some(&mark));
            if is_comment || line.trim_ascii().is_empty() {
                continue;
            }
            self.line = number;
            self.row.split(line);
            let values = || self.row.fields().map(|field| Value::of(field, self.layout.decimal));
            let is_of_words = !values().any(|value| value.is_value())
                && values().any(|value| matches!(value, Value::Text));
            if is_of_words {
                self.words = self.words.or(Some(number));
            }
            if is_of_words || self.row.len() < self.layout.columns {
                self.leave_out(number);
                continue;
            }
            if let Some(words) = self.words {
                return Err(SignalError::Csv {
                    path: self.path.clone(),
                    line: words,
                    reason: format!(
                        "words, and values again in line {number}: another capture or table; \
                         split the file"
                    ),
                });
            }
            return Ok(true);
        }
        Ok(false)
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
        let other = match self.layout.decimal {
            Decimal::Comma => Decimal::Point,
            Decimal::Point => Decimal::Comma,
        };
        let why = match (Value::of(self.field(column), other), self.layout.decimal) {
            (Value::Number { .. }, Decimal::Comma) => {
                " with a decimal comma, as the others or the mapping have it"
            }
            (Value::Number { .. }, Decimal::Point) => {
                " with a decimal point, as the others or the mapping have it"
            }
            _ => "",
        };
        let called = self.layout.names.get(column).map_or("", String::as_str);
        self.wrong(format!("{field:?} in column {} ({called}) is not a number{why}", column + 1))
    }

    fn is_time_of_day(&self, column: usize) -> bool {
        let value = Value::of(self.field(column), self.layout.decimal);
        matches!(value, Value::Time { has_date: false, .. })
    }

    /// The number in a column of this row; NaN where there is none.
    fn number(&self, column: usize) -> Result<f64, SignalError> {
        match Value::of(self.field(column), self.layout.decimal) {
            Value::Number { value, .. } => Ok(value),
            Value::Missing => Ok(f64::NAN),
            Value::Time { .. } | Value::Text => Err(self.not_a_number(column)),
        }
    }

    /// The time in a column of this row, ns; exact for whole nanoseconds, dates and times of day.
    fn stamp(&self, column: usize, source: &SignalSource) -> Result<i64, SignalError> {
        if let Value::Time { nanoseconds, .. } = Value::of(self.field(column), self.layout.decimal)
        {
            return Ok(nanoseconds);
        }
        if source.unit == Some(1e-9)
            && source.scale == 1.0
            && source.offset == 0.0
            && let Ok(text) = std::str::from_utf8(self.field(column))
            && let Ok(nanoseconds) = text.parse()
        {
            return Ok(nanoseconds);
        }
        Ok(seconds_to_nanos(source.to_si(self.number(column)?)))
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
