//! A recording of any origin, ready for identification: every signal on one uniform grid, with what
//! was done to get there.
//!
//! What comes in is a bag of our own, a foreign bag or a CSV file with a [`Mapping`]; what goes out
//! is a [`Recording`]. Only one topic at a time is in memory besides the result, or several while
//! they are small.

use std::fmt;
use std::ops::Range;
use std::path::Path;

use serde::Serialize;

use super::error::BagError;
use super::mapping::{Mapping, Place, Signal, SignalSource};
use super::outliers::outliers;
use super::resample::{self, Between, ClockKind, Grid, Ordered, Placed, SignalQuality, stretches};
use super::source::{Request, Source, Stream};
use super::trace::Trace;

/// Raw samples that are held at once besides the result, in bytes.
const AT_ONCE: u64 = 128 * 1024 * 1024;
/// A signal with values in less than this share of the rows does not count as recorded. Assumed.
const LEAST_COVERAGE: f64 = 0.5;

/// A uniform trace with the rows that can be used and the account of the data.
#[derive(Debug, Clone)]
pub struct Recording {
    /// Columns on a uniform grid. NaN where a signal is not known: absent, or in a gap of more than
    /// three samples.
    pub trace: Trace,
    /// Rows per second, Hz.
    pub rate: f64,
    /// Per row whether the position and every force that the recording has are known.
    pub valid: Vec<bool>,
    /// Per row whether a position or a force there was filled in for a sample that is missing.
    pub filled: Vec<bool>,
    /// What the data were like.
    pub quality: DataQuality,
}

impl Recording {
    /// Takes the forces of the rows that were filled in as missing, so that nothing is compared
    /// there; the position stays as it was filled, since the guides are to be driven along it.
    pub fn leave_out_filled(&mut self) {
        for (row, _) in self.filled.iter().enumerate().filter(|(_, filled)| **filled) {
            (self.trace.force_cell[row], self.trace.force[row]) = (f64::NAN, f64::NAN);
        }
        self.count_valid();
    }

    /// Share of the rows in which a position or a force was filled in.
    pub fn share_filled(&self) -> f64 {
        self.filled.iter().filter(|filled| **filled).count() as f64
            / self.filled.len().max(1) as f64
    }

    /// Rows in which a position or a force is none that the stage can have had.
    pub fn outliers(&self, signal: Signal) -> Vec<usize> {
        let trace = &self.trace;
        match signal {
            Signal::Position => outliers(&trace.position, None),
            // A single force may be a pulse: nothing tells.
            Signal::ForceCell => outliers(&trace.force_cell, Some(&trace.force)),
            Signal::Force => outliers(&trace.force, Some(&trace.force_cell)),
            _ => Vec::new(),
        }
    }

    /// Takes these rows of a signal as missing.
    pub fn leave_out_rows(&mut self, signal: Signal, rows: &[usize]) {
        if let Some(column) = self.column_mut(signal) {
            rows.iter().for_each(|row| column[*row] = f64::NAN);
            self.count_valid();
        }
    }

    /// Only the first rows, as if the recording had ended there.
    pub fn truncate(&mut self, rows: usize) {
        for signal in Signal::ALL {
            if let Some(column) = self.column_mut(signal) {
                column.truncate(rows);
                column.shrink_to_fit();
            }
        }
        self.trace.time.truncate(rows);
        self.trace.time.shrink_to_fit();
        self.filled.truncate(rows);
        self.quality.rows = self.trace.len();
        self.count_valid();
    }

    fn column_mut(&mut self, signal: Signal) -> Option<&mut Vec<f64>> {
        let trace = &mut self.trace;
        Some(match signal {
            Signal::Time => return None,
            Signal::Position => &mut trace.position,
            Signal::ForceCell => &mut trace.force_cell,
            Signal::Force => &mut trace.force,
            Signal::ReferencePosition => &mut trace.reference_position,
            Signal::ReferenceVelocity => &mut trace.reference_velocity,
            Signal::ReferenceAcceleration => &mut trace.reference_acceleration,
        })
    }

    fn count_valid(&mut self) {
        self.valid = valid_rows(&self.trace, &self.quality.signals);
        self.quality.valid_rows = self.valid.iter().filter(|&&v| v).count();
        self.quality.segments = stretches(&self.valid).len();
    }

    /// Stretches of valid rows, in order; filters and simulations run within one of them.
    pub fn segments(&self) -> Vec<Range<usize>> {
        stretches(&self.valid)
    }

    /// Takes the values of a signal for which `unusable` holds as missing, as if they had not been
    /// recorded.
    pub fn leave_out(&mut self, signal: Signal, unusable: impl Fn(f64) -> bool) {
        let Some(column) = self.column_mut(signal) else { return };
        column.iter_mut().filter(|value| unusable(**value)).for_each(|value| *value = f64::NAN);
        let coverage = column.iter().filter(|value| value.is_finite()).count() as f64
            / column.len().max(1) as f64;
        let quality = &mut self.quality;
        quality
            .signals
            .iter_mut()
            .filter(|found| found.signal == signal)
            .for_each(|found| found.coverage = coverage);
        quality.signals.retain(|found| found.signal != signal || coverage > 0.0);
        self.count_valid();
    }

    /// Whether a signal is recorded, in at least half of the rows.
    pub fn has(&self, signal: Signal) -> bool {
        signal == Signal::Time
            || self.quality.signal(signal).is_some_and(|q| q.coverage >= LEAST_COVERAGE)
    }
}

/// What the data were like and what was done to them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DataQuality {
    /// Rows on the grid.
    pub rows: usize,
    /// Rows in which the position and every recorded force are known.
    pub valid_rows: usize,
    /// Stretches of such rows.
    pub segments: usize,
    /// Rows per second, Hz.
    pub rate_hz: f64,
    /// How the samples of the position lie in time.
    pub clock: ClockKind,
    /// Per signal that was found.
    pub signals: Vec<SignalQuality>,
    /// What a user should know, in words.
    pub notes: Vec<String>,
}

impl DataQuality {
    /// The account of a signal, if there is any sample of it.
    pub fn signal(&self, signal: Signal) -> Option<&SignalQuality> {
        self.signals.iter().find(|q| q.signal == signal)
    }
}

/// Reads a rosbag2 directory, an MCAP file or a CSV file onto a uniform grid. Without a mapping the
/// topics are those of our own bags, and the columns those of a [`Trace`].
///
/// The grid is that of the position, or `rate` of the mapping. Errors: no position, a mapping that
/// does not fit, a damaged place, a clock that is set back. Gaps, jitter, repeated and missing
/// samples are no errors: [`DataQuality`] counts them.
pub fn load(path: impl AsRef<Path>, mapping: Option<&Mapping>) -> Result<Recording, BagError> {
    let path = path.as_ref();
    let (source, mapping) = Source::open(path, mapping)?;
    let mut loading = Loading {
        source: &source,
        mapping: &mapping,
        notes: same_place(&mapping),
        filled: Vec::new(),
        between: Vec::new(),
    };
    let missing = || BagError::MissingSignal {
        path: path.to_owned(),
        signal: Signal::Position.name(),
        needs: needs(&mapping),
        has: source.inventory(),
    };
    let position = loading.candidates(Signal::Position).next().ok_or_else(missing)?;
    let stream = loading.read(&[vec![(Signal::Position, position)]])?.remove(0);
    let total = stream.stamps.len();
    let Ordered { stamps, values, mut quality } = resample::order(stream)?;
    let known = values[0].iter().filter(|v| v.is_finite()).count();
    if stamps.len() < 2 || known < 2 {
        return Err(BagError::TooFewSamples {
            path: path.to_owned(),
            signal: Signal::Position.name(),
            samples: known,
            total,
        });
    }
    let grid = resample::grid(
        &stamps,
        &values[0],
        mapping.rate.filter(|_| !is_clock(&mapping)),
        &quality[0].place,
    )?;
    let mut trace = Trace { origin_ns: grid.origin_ns, ..Trace::default() };
    quality[0].jitter_s = Some(grid.jitter_s);
    let Placed { column, filled: positions, .. } =
        resample::place(&grid, &stamps, &values[0], Between::Smooth, &mut quality[0]);
    trace.position = column;
    drop((stamps, values));
    loading.others(&grid, &mut trace, &mut quality)?;
    resample::along_command(&mut trace.force_cell, &loading.between, &trace.force);
    let mut filled = vec![false; grid.rows];
    positions.iter().chain(&loading.filled).for_each(|row| filled[*row] = true);
    trace.time = (0..grid.rows).map(|row| row as f64 * grid.step_ns * 1e-9).collect();
    let rows = trace.len();
    let valid = valid_rows(&trace, &quality);
    quality.sort_by_key(|q| q.signal);
    let rate = 1.0 / grid.step;
    let quality = DataQuality {
        rows,
        valid_rows: valid.iter().filter(|&&v| v).count(),
        segments: stretches(&valid).len(),
        rate_hz: rate,
        clock: grid.clock,
        signals: quality,
        notes: loading.notes,
    };
    Ok(Recording { trace, rate, valid, filled, quality })
}

/// Signals that a mapping takes from the same place, in words: a slip of the pen, most likely.
fn same_place(mapping: &Mapping) -> Vec<String> {
    let first = |signal: &Signal| mapping.signals.get(signal).and_then(|sources| sources.first());
    let signals: Vec<&Signal> = mapping.signals.keys().collect();
    let pairs = signals
        .iter()
        .enumerate()
        .flat_map(|(index, one)| signals[index + 1..].iter().map(move |two| (*one, *two)));
    pairs
        .filter(|(one, two)| {
            first(one).zip(first(two)).is_some_and(|(one, two)| one.place == two.place)
        })
        .map(|(one, two)| {
            format!("the mapping takes {one} and {two} from the same place: is one of them meant?")
        })
        .collect()
}

/// Per row whether the position and every recorded force are known.
fn valid_rows(trace: &Trace, quality: &[SignalQuality]) -> Vec<bool> {
    let has =
        |signal: Signal| quality.iter().any(|q| q.signal == signal && q.coverage >= LEAST_COVERAGE);
    let (has_cell, has_force) = (has(Signal::ForceCell), has(Signal::Force));
    (0..trace.len())
        .map(|row| {
            trace.position[row].is_finite()
                && (!has_cell || trace.force_cell[row].is_finite())
                && (!has_force || trace.force[row].is_finite())
        })
        .collect()
}

/// Whether the rate of a mapping says when the rows of a file without times were taken.
fn is_clock(mapping: &Mapping) -> bool {
    mapping.is_for_csv() && !mapping.signals.contains_key(&Signal::Time)
}

fn needs(mapping: &Mapping) -> String {
    let places: Vec<String> = mapping
        .signals
        .get(&Signal::Position)
        .into_iter()
        .flatten()
        .map(|s| s.place.to_string())
        .collect();
    let other = if mapping.asked_for { "" } else { "; for other names give a mapping" };
    format!("{}{other}", places.join(" or "))
}

struct Loading<'a> {
    source: &'a Source,
    mapping: &'a Mapping,
    notes: Vec<String>,
    /// Rows of the forces that stand in place of missing samples, and those between samples of the
    /// cell.
    filled: Vec<usize>,
    between: Vec<usize>,
}

impl Loading<'_> {
    /// The places of a signal that the recording has; those that somebody asked for in any case, so
    /// that a missing one shows.
    fn candidates(&self, signal: Signal) -> impl Iterator<Item = SignalSource> {
        let asked_for = self.mapping.asked_for;
        let places = self.mapping.signals.get(&signal).into_iter().flatten();
        places.filter(move |source| asked_for || self.source.expected(source).is_some()).cloned()
    }

    fn read(&mut self, groups: &[Vec<(Signal, SignalSource)>]) -> Result<Vec<Stream>, BagError> {
        let requests: Vec<Request> =
            groups.iter().map(|signals| Request { signals: signals.clone() }).collect();
        let mut streams = self.source.read(&requests, &self.mapping.joint)?;
        for stream in &mut streams {
            self.notes.append(&mut stream.notes);
        }
        Ok(streams)
    }

    /// Reads every signal but the position and puts it into the trace.
    fn others(
        &mut self,
        grid: &Grid,
        trace: &mut Trace,
        quality: &mut Vec<SignalQuality>,
    ) -> Result<(), BagError> {
        let mut wanted: Vec<(Signal, Vec<SignalSource>)> = Signal::ALL
            .into_iter()
            .filter(|signal| ![Signal::Time, Signal::Position].contains(signal))
            .map(|signal| (signal, self.candidates(signal).collect()))
            .collect();
        // each turn reads the first places, then the second ones of signals that the first did not
        // have
        while wanted.iter().any(|(_, sources)| !sources.is_empty()) {
            let mut groups: Vec<Vec<(Signal, SignalSource)>> = Vec::new();
            for (signal, sources) in &mut wanted {
                if sources.is_empty() {
                    continue;
                }
                let source = sources.remove(0);
                let same = |group: &&mut Vec<(Signal, SignalSource)>| match (
                    &group[0].1.place,
                    &source.place,
                ) {
                    (
                        Place::Topic { topic: a, stamp: s, .. },
                        Place::Topic { topic: b, stamp: t, .. },
                    ) => a == b && s == t,
                    _ => false,
                };
                match groups.iter_mut().find(same) {
                    Some(group) => group.push((*signal, source)),
                    None => groups.push(vec![(*signal, source)]),
                }
            }
            while !groups.is_empty() {
                // as many groups in one pass as fit, one at least
                let bytes = |group: &Vec<(Signal, SignalSource)>| {
                    let samples =
                        self.source.expected(&group[0].1).unwrap_or(0).max(grid.rows as u64);
                    samples * 8 * (1 + group.len() as u64)
                };
                let (mut total, mut count) = (0, 0);
                for group in &groups {
                    total += bytes(group);
                    if count > 0 && total > AT_ONCE {
                        break;
                    }
                    count += 1;
                }
                let now: Vec<_> = groups.drain(..count).collect();
                for stream in self.read(&now)? {
                    self.place(grid, stream, trace, quality)?;
                }
            }
            for (signal, sources) in &mut wanted {
                if quality.iter().any(|q| q.signal == *signal && q.coverage >= LEAST_COVERAGE) {
                    sources.clear();
                }
            }
        }
        for column in [
            &mut trace.reference_position,
            &mut trace.reference_velocity,
            &mut trace.reference_acceleration,
            &mut trace.force_cell,
            &mut trace.force,
        ] {
            column.resize(grid.rows, f64::NAN);
        }
        Ok(())
    }

    fn place(
        &mut self,
        grid: &Grid,
        stream: Stream,
        trace: &mut Trace,
        quality: &mut Vec<SignalQuality>,
    ) -> Result<(), BagError> {
        let Ordered { stamps, mut values, quality: found } = resample::order(stream)?;
        for (index, mut found) in found.into_iter().enumerate() {
            let raw = std::mem::take(&mut values[index]);
            let Placed { column, filled, between } =
                resample::place(grid, &stamps, &raw, Between::of(found.signal), &mut found);
            drop(raw);
            if found.coverage == 0.0 {
                continue;
            }
            let earlier = quality.iter().position(|q| q.signal == found.signal);
            if earlier.is_some_and(|at| quality[at].coverage >= found.coverage) {
                continue;
            }
            if let Some(at) = earlier {
                quality.remove(at);
            }
            match found.signal {
                Signal::ForceCell => {
                    self.filled.extend(filled);
                    self.between = between;
                }
                Signal::Force => self.filled.extend(filled),
                _ => {}
            }
            match found.signal {
                Signal::ReferencePosition => trace.reference_position = column,
                Signal::ReferenceVelocity => trace.reference_velocity = column,
                Signal::ReferenceAcceleration => trace.reference_acceleration = column,
                Signal::ForceCell => trace.force_cell = column,
                Signal::Force => trace.force = column,
                Signal::Time | Signal::Position => {}
            }
            quality.push(found);
        }
        Ok(())
    }
}

impl fmt::Display for DataQuality {
    /// Tells what was not as it should be; one line if all was.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let clock = match self.clock {
            ClockKind::Regular => "uniform as recorded",
            ClockKind::UniformBehindJitter => {
                "uniform behind stamps that jitter, values as recorded"
            }
            ClockKind::AtStamps => "not uniform, interpolated from the stamps",
            ClockKind::OtherRate => "interpolated to the rate that was asked for",
        };
        writeln!(
            f,
            "data: {} rows at {:.3} Hz ({clock}), {} usable in {} pieces",
            self.rows, self.rate_hz, self.valid_rows, self.segments
        )?;
        for q in &self.signals {
            let counts = [
                (q.out_of_order, "out of order"),
                (q.repeated, "with a repeated stamp"),
                (q.not_finite, "not finite"),
                (q.missing, "missing"),
            ];
            let mut told: Vec<String> = counts
                .iter()
                .filter(|(n, _)| *n > 0)
                .map(|(n, what)| format!("{n} {what}"))
                .collect();
            if q.filled > 0 {
                told.push(format!("{} rows filled from neighbours", q.filled));
            }
            if q.gaps > 0 {
                told.push(format!("{} gaps, the longest {:.4} s", q.gaps, q.longest_interval_s));
            }
            // signals that come slower than the rows are filled in between
            if q.interval_s * self.rate_hz > 1.5 {
                told.push(format!("one sample every {:.6} s", q.interval_s));
            }
            if !told.is_empty() {
                writeln!(
                    f,
                    "data: {} from {}: {} samples, {}",
                    q.signal,
                    q.place,
                    q.samples,
                    told.join(", ")
                )?;
            }
        }
        for note in &self.notes {
            writeln!(f, "data: {note}")?;
        }
        Ok(())
    }
}
