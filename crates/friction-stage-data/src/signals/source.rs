//! The raw samples of signals, as a bag or a table has them: with their own stamps, in SI units,
//! not yet on one grid.
//!
//! What comes in is an open recording and where each signal stands; what goes out are [`Stream`]s.
//! A caller who asks for a few signals at a time keeps only those in memory.

use std::path::Path;

use super::array_table::is_array_file;
use super::columns::Columns;
use super::csv_table::CsvFile;
use super::data_quality::SignalNote;
use super::error::SignalError;
use super::import::joint_type;
use super::mapping::{Mapping, Place, Signal, SignalSource};
use super::topic_source::{has_samples, inventory, messages, read_bag};
use super::window::{Side, Span};
use crate::bag::BagReader;

/// Most samples that memory is set aside for before they are read.
const RESERVE: u64 = 16_000_000;
/// The smallest time there is stands for none.
pub(super) const NO_TIME: i64 = i64::MIN;

/// Samples of signals that come with the same stamps.
#[derive(Debug, Clone, Default)]
pub(crate) struct Stream {
    pub signals: Vec<Signal>,
    /// Where each signal comes from, for people.
    pub places: Vec<String>,
    /// When each sample was taken, ns, in the order of the recording.
    pub stamps: Vec<i64>,
    /// Values of each signal, SI; NaN where a message has none.
    pub values: Vec<Vec<f64>>,
    /// Whether the values acted over the time of a row before their stamps.
    pub ends_interval: bool,
    /// What a user should know about how they were read.
    pub notes: Vec<SignalNote>,
    /// Which samples are wanted.
    span: Span,
    /// Whether the last one before the span is wanted, too, and the place in the samples of the one
    /// that is.
    held: bool,
    before: Option<usize>,
    /// Whether no more will come.
    pub is_done: bool,
}

/// Signals to be read with one stamp.
#[derive(Debug, Clone)]
pub(crate) struct Request {
    pub signals: Vec<(Signal, SignalSource)>,
}

impl Request {
    /// A request for each of the topics and its stamps, or columns.
    pub fn grouped(signals: impl IntoIterator<Item = (Signal, SignalSource)>) -> Vec<Request> {
        let mut requests: Vec<Request> = Vec::new();
        for one in signals {
            let same = |request: &&mut Request| one.1.place.has_stamps_of(&request.first().place);
            match requests.iter_mut().find(same) {
                Some(request) => request.signals.push(one),
                None => requests.push(Request { signals: vec![one] }),
            }
        }
        requests
    }

    /// The place of its first signal; there is one.
    pub fn first(&self) -> &SignalSource {
        &self.signals[0].1
    }

    /// Whether it asks for a signal.
    pub fn has(&self, signal: Signal) -> bool {
        self.signals.iter().any(|(of, _)| *of == signal)
    }
}

/// An open recording.
pub(crate) enum Source<'a> {
    Bag(BagReader),
    Csv(CsvFile),
    Columns(Columns<'a>),
}

impl Source<'_> {
    /// Opens a bag, or a table if `path` is one ([`is_table`]).
    pub fn open(path: &Path, mapping: Option<&Mapping>) -> Result<(Self, Mapping), SignalError> {
        let is_csv = is_table(path, mapping);
        // What does not exist is neither.
        if path.exists() && !is_csv && mapping.is_some_and(Mapping::is_for_csv) {
            return Err(SignalError::Mapping {
                origin: path.display().to_string(),
                key: "signals".into(),
                reason: "the recording is a bag, but the mapping names columns".into(),
            });
        }
        if is_csv {
            let mapping = mapping.cloned().unwrap_or_else(Mapping::own_csv);
            return Ok((Self::Csv(CsvFile::new(path, &mapping)?), mapping));
        }
        let reader = BagReader::open(path)?;
        let own = || Mapping {
            joint_type: joint_type(&reader),
            ..Mapping::own_bag(reader.provenance(), reader.namespace())
        };
        let mapping = mapping.cloned().unwrap_or_else(own);
        Ok((Self::Bag(reader), mapping))
    }

    /// How many samples a place has, as far as that is known without reading them; none if it is
    /// not there.
    pub fn expected(&self, source: &SignalSource) -> Option<u64> {
        match (self, &source.place) {
            (Self::Bag(reader), Place::Topic { .. }) => messages(reader, source),
            (Self::Csv(file), Place::Column(_)) => file.has(source).then_some(0),
            (Self::Columns(columns), Place::Column(column)) => columns.expected(column),
            _ => None,
        }
    }

    /// Whether it has samples of a place.
    pub fn has_samples(&self, source: &SignalSource) -> bool {
        match self {
            Self::Bag(reader) => has_samples(reader, source),
            Self::Csv(_) | Self::Columns(_) => self.expected(source).is_some(),
        }
    }

    /// What there is in place of something that is missing.
    pub fn inventory(&self) -> String {
        match self {
            Self::Bag(reader) => inventory(reader),
            Self::Csv(file) => file.inventory(),
            Self::Columns(columns) => columns.inventory(),
        }
    }

    /// Reads each request as a stream, its part in a span; one pass over the recording. The last
    /// sample before the part comes with it unless it begins there: a value that is held is older.
    pub fn read(
        &self,
        requests: &[Request],
        joint: Option<&str>,
        span: Span,
    ) -> Result<Vec<Stream>, SignalError> {
        match self {
            Self::Bag(reader) => read_bag(reader, requests, joint, span),
            Self::Csv(file) => file.read(requests, span),
            Self::Columns(columns) => Ok(columns.read(requests, span)),
        }
    }
}

/// Whether a path is a table: of text, if it ends in `.csv`, `.tsv` or `.txt`; of arrays, if it
/// ends in `.mat`, `.npz` or `.npy`; or because `mapping` names columns.
pub fn is_table(path: &Path, mapping: Option<&Mapping>) -> bool {
    let ending = path.extension().and_then(|e| e.to_str()).map(str::to_ascii_lowercase);
    let has_ending = ending.is_some_and(|e| ["csv", "tsv", "txt"].contains(&e.as_str()));
    let is_named = has_ending || is_array_file(path) || mapping.is_some_and(Mapping::is_for_csv);
    is_named && !path.is_dir()
}

impl Stream {
    pub fn new(request: &Request, expected: u64, span: Span) -> Self {
        let expected = expected.min(RESERVE).min(span.most()) as usize;
        Self {
            signals: request.signals.iter().map(|(signal, _)| *signal).collect(),
            places: request.signals.iter().map(|(_, source)| source.place.to_string()).collect(),
            stamps: Vec::with_capacity(expected),
            values: request.signals.iter().map(|_| Vec::with_capacity(expected)).collect(),
            ends_interval: request.signals.iter().any(|(_, source)| source.place.ends_interval()),
            notes: Vec::new(),
            held: span.is_of_others(),
            span,
            before: None,
            is_done: false,
        }
    }

    /// Adds a sample, if it is wanted.
    pub fn push(&mut self, stamp: i64, values: impl IntoIterator<Item = f64>) {
        // What has no time is counted where it is put in order.
        match if stamp == NO_TIME { Side::Inside } else { self.span.side(stamp) } {
            Side::Inside => {
                self.stamps.push(stamp);
                for (column, value) in self.values.iter_mut().zip(values) {
                    column.push(value);
                }
            }
            Side::Before if self.held => {
                let at = *self.before.get_or_insert(self.stamps.len());
                self.stamps.resize(self.stamps.len().max(at + 1), stamp);
                self.stamps[at] = stamp;
                for (column, value) in self.values.iter_mut().zip(values) {
                    column.resize(column.len().max(at + 1), value);
                    column[at] = value;
                }
            }
            Side::Before | Side::After => {}
            Side::Beyond => self.is_done = true,
        }
    }

    /// Keeps the samples that have a value.
    pub fn keep_values(&mut self) {
        let mut kept = 0;
        for row in 0..self.stamps.len() {
            if self.values.iter().all(|column| column[row].is_nan()) {
                continue;
            }
            self.stamps[kept] = self.stamps[row];
            self.values.iter_mut().for_each(|column| column[kept] = column[row]);
            kept += 1;
        }
        self.stamps.truncate(kept);
        self.values.iter_mut().for_each(|column| column.truncate(kept));
    }

    /// Whether the recording has samples that are not in the span.
    pub fn is_part(&self) -> bool {
        self.span.is_part
    }
}

/// Largest size of a value that a signal can have, in SI units. Assumed, as for models: beyond it
/// no machine is, and its powers leave what a double can hold.
const LARGEST: f64 = 1e12;

/// Refuses a value of a signal, in SI, that no unit can mean. Infinite ones are counted elsewhere.
pub(super) fn refuse_impossible(signal: impl std::fmt::Display, value: f64) -> Result<(), String> {
    if !value.is_finite() || value.abs() <= LARGEST {
        return Ok(());
    }
    Err(format!(
        "{signal} is {value:e} in SI units, at most {LARGEST:e} is possible: a wrong unit or \
         scale, or a damaged value"
    ))
}

/// Seconds as nanoseconds; NaN is no time.
pub(super) fn seconds_to_nanos(seconds: f64) -> i64 {
    if seconds.is_nan() { NO_TIME } else { (seconds * 1e9).round() as i64 }
}
