//! The raw samples of signals in a CSV file, read row by row.

use std::path::{Path, PathBuf};

use super::error::SignalError;
use super::mapping::{Column, CsvLayout, Mapping, Place, Signal, SignalSource};
use super::source::{Request, Stream, seconds_to_nanos};
use super::trace::csv_error;

/// A CSV file by a mapping: where its columns are, and what says the time of a row.
pub(super) struct CsvFile {
    pub path: PathBuf,
    layout: CsvLayout,
    time: Option<SignalSource>,
    rate: Option<f64>,
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
                reason: "the recording is a CSV file, but the mapping names topics".into(),
            });
        }
        let named = |name: &str| {
            CsvTable::open(path, &mapping.csv)
                .is_ok_and(|table| table.names.iter().any(|known| known == name))
        };
        let time = mapping
            .signals
            .get(&Signal::Time)
            .and_then(|sources| sources.first().cloned())
            .filter(|_| mapping.asked_for || named(Signal::Time.name()));
        Ok(Self { path: path.to_owned(), layout: mapping.csv.clone(), time, rate: mapping.rate })
    }

    /// Whether there is a column for a signal.
    pub fn has(&self, source: &SignalSource) -> bool {
        CsvTable::open(&self.path, &self.layout).and_then(|table| table.column(source)).is_ok()
    }

    /// Its columns, for people.
    pub fn inventory(&self) -> String {
        match CsvTable::open(&self.path, &self.layout) {
            Ok(table) => table.names(),
            Err(error) => error.to_string(),
        }
    }

    /// The rows from the first one on, with the values of these columns.
    pub fn rows<'a>(
        &'a self,
        columns: impl IntoIterator<Item = &'a SignalSource>,
    ) -> Result<CsvRows<'a>, SignalError> {
        let table = CsvTable::open(&self.path, &self.layout)?;
        let clock = match (&self.time, self.rate) {
            (Some(source), _) => RowClock::Column(table.column(source)?, source),
            (None, Some(rate)) => RowClock::Rate(rate),
            (None, None) => {
                return Err(SignalError::MissingSignal {
                    path: self.path.clone(),
                    signal: Signal::Time.name(),
                    needs: "a column `time`, or a mapping that says which column it is, or the \
                            `rate` of the rows"
                        .into(),
                    has: table.names(),
                });
            }
        };
        let columns = columns
            .into_iter()
            .map(|source| Ok((table.column(source)?, source)))
            .collect::<Result<Vec<_>, SignalError>>()?;
        Ok(CsvRows { values: vec![f64::NAN; columns.len()], table, clock, columns, count: 0 })
    }

    /// Each request as a stream; one pass over the file.
    pub fn read(&self, requests: &[Request]) -> Result<Vec<Stream>, SignalError> {
        let sources = requests.iter().flat_map(|request| &request.signals);
        let mut rows = self.rows(sources.map(|(_, source)| source))?;
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
        Ok(streams)
    }
}

/// What says when a row was taken.
enum RowClock<'a> {
    Column(usize, &'a SignalSource),
    /// Hz.
    Rate(f64),
}

/// The rows of a CSV file: the time of each, and its values in SI units. Whoever takes signals from
/// a CSV file, to store them or to examine them, takes them from here.
pub(super) struct CsvRows<'a> {
    table: CsvTable,
    clock: RowClock<'a>,
    columns: Vec<(usize, &'a SignalSource)>,
    count: u64,
    /// Values of the row that was read last; NaN for an empty field.
    pub values: Vec<f64>,
}

impl CsvRows<'_> {
    /// Reads the next row; its time in ns, [`NO_TIME`](super::source::NO_TIME) where it has none.
    pub fn next(&mut self) -> Result<Option<i64>, SignalError> {
        if !self.table.next()? {
            return Ok(None);
        }
        let stamp = match self.clock {
            RowClock::Column(column, source) => self.table.stamp(column, source)?,
            RowClock::Rate(rate) => seconds_to_nanos(self.count as f64 / rate),
        };
        self.count += 1;
        for (value, (column, source)) in self.values.iter_mut().zip(&self.columns) {
            *value = source.to_si(self.table.number(*column)?);
        }
        Ok(Some(stamp))
    }
}

/// A CSV file, read row by row.
struct CsvTable {
    path: PathBuf,
    layout: CsvLayout,
    names: Vec<String>,
    reader: csv::Reader<std::fs::File>,
    record: csv::StringRecord,
}

impl CsvTable {
    fn open(path: &Path, layout: &CsvLayout) -> Result<Self, SignalError> {
        let mut reader = csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .delimiter(layout.delimiter)
            .comment(layout.comment)
            .has_headers(layout.header)
            .from_path(path)
            .map_err(|e| csv_error(path, e))?;
        let names = reader.headers().map_err(|e| csv_error(path, e))?;
        // an editor's byte order mark is no part of the first name
        let names =
            names.iter().map(|name| name.trim_start_matches('\u{feff}').to_owned()).collect();
        Ok(Self {
            path: path.to_owned(),
            layout: layout.clone(),
            names,
            reader,
            record: csv::StringRecord::new(),
        })
    }

    fn names(&self) -> String {
        if self.layout.header {
            self.names.join(", ")
        } else {
            format!("{} columns without names", self.names.len())
        }
    }

    /// Index of a column.
    fn column(&self, source: &SignalSource) -> Result<usize, SignalError> {
        let missing =
            |reason: String| SignalError::Csv { path: self.path.clone(), line: 1, reason };
        match &source.place {
            Place::Column(Column::Number(number)) if *number <= self.names.len() => Ok(number - 1),
            Place::Column(Column::Number(number)) => {
                Err(missing(format!("no column {number}, there are {}", self.names.len())))
            }
            Place::Column(Column::Name(name)) => {
                self.names.iter().position(|n| n == name).ok_or_else(|| {
                    let hint = friction_stage_core::model::nearest(
                        name,
                        self.names.iter().map(String::as_str),
                    );
                    missing(format!("no column {name:?}; columns are {:?}{hint}", self.names))
                })
            }
            place @ Place::Topic { .. } => {
                Err(missing(format!("{place} is a topic, not a column")))
            }
        }
    }

    /// Goes to the next row; false at the end.
    fn next(&mut self) -> Result<bool, SignalError> {
        self.reader.read_record(&mut self.record).map_err(|e| csv_error(&self.path, e))
    }

    fn field(&self, column: usize) -> &str {
        self.record.get(column).unwrap_or("")
    }

    fn wrong(&self, column: usize) -> SignalError {
        let name = self.names.get(column).map_or("", String::as_str);
        SignalError::Csv {
            path: self.path.clone(),
            line: self.record.position().map_or(0, csv::Position::line),
            reason: format!(
                "{:?} in column {} ({name}) is not a number",
                self.field(column),
                column + 1
            ),
        }
    }

    /// The number in a column of this row; NaN for an empty field.
    fn number(&self, column: usize) -> Result<f64, SignalError> {
        let field = self.field(column);
        if field.is_empty() {
            return Ok(f64::NAN);
        }
        let parsed =
            if self.layout.decimal_comma { field.replace(',', ".").parse() } else { field.parse() };
        parsed.map_err(|_| self.wrong(column))
    }

    /// The time in a column of this row, ns; exact for whole nanoseconds.
    fn stamp(&self, column: usize, source: &SignalSource) -> Result<i64, SignalError> {
        if source.unit == 1e-9
            && source.scale == 1.0
            && source.offset == 0.0
            && let Ok(nanoseconds) = self.field(column).parse()
        {
            return Ok(nanoseconds);
        }
        Ok(seconds_to_nanos(source.to_si(self.number(column)?)))
    }
}
