//! A recording of any origin, ready for identification: every signal on one uniform grid, with what
//! was done to get there.
//!
//! What comes in is a bag of our own, a foreign bag or a table with a [`Mapping`]; what goes out
//! is a [`Recording`]. Only one topic at a time is in memory besides the result, or several while
//! they are small.

use std::path::Path;

use super::columns::Columns;
use super::data_quality::{DataQuality, SignalNote, SignalQuality};
use super::error::SignalError;
use super::grid::{self, Grid, stretches};
use super::mapping::{Joined, Mapping, Signal, SignalSource};
use super::order::{Ordered, order};
use super::recording::{LEAST_COVERAGE, Recording, valid_rows};
use super::resample::{self, Apart, Between, Placed};
use super::source::{NO_TIME, Request, Source, Stream};
use super::trace::Trace;
use super::window::{Span, Window};
use friction_stage_core::numerics::noise;

/// Raw samples that are held at once besides the result, in bytes.
const AT_ONCE: u64 = 128 * 1024 * 1024;

/// Reads a rosbag2 directory, one of its files or a table onto a uniform grid. Without a mapping
/// the topics are those of our own bags, and the columns those of a [`Trace`].
///
/// The grid is that of the position, or `rate` of the mapping. Errors: no position, a mapping that
/// does not fit, a damaged place, a clock that is set back. Gaps, jitter, repeated and missing
/// samples are no errors: [`DataQuality`] counts them.
pub fn load(path: impl AsRef<Path>, mapping: Option<&Mapping>) -> Result<Recording, SignalError> {
    load_part(path, mapping, Window::default())
}

/// Reads a part of a recording, as [`load`] does the whole: no more than it is in memory. What is
/// not read, [`SignalNote::OnlyPart`] tells.
pub fn load_part(
    path: impl AsRef<Path>,
    mapping: Option<&Mapping>,
    window: Window,
) -> Result<Recording, SignalError> {
    let path = path.as_ref();
    let (source, mapping) = Source::open(path, mapping)?;
    let joined = joined(path, &mapping)?;
    let joined: Vec<Origin> =
        joined.iter().map(|(source, other)| Origin::joined(source, other)).collect();
    on_grid(path, &Origin::recording(&source, &mapping), &joined, window)
}

/// The recordings that a mapping joins, opened.
fn joined<'a>(
    path: &Path,
    mapping: &'a Mapping,
) -> Result<Vec<(Source<'static>, &'a Joined)>, SignalError> {
    let open = |other: &'a Joined| {
        let (source, _) = Source::open(&other.path(path), Some(&other.mapping))?;
        Ok((source, other))
    };
    mapping.join.iter().map(open).collect()
}

/// A recording that signals are taken from.
struct Origin<'a> {
    source: &'a Source<'a>,
    mapping: &'a Mapping,
    /// Its name, where it is joined.
    file: Option<&'a Path>,
    /// What is added to its times, ns.
    clock_offset: i64,
}

impl<'a> Origin<'a> {
    fn recording(source: &'a Source<'a>, mapping: &'a Mapping) -> Self {
        Self { source, mapping, file: None, clock_offset: 0 }
    }

    fn joined(source: &'a Source<'a>, other: &'a Joined) -> Self {
        let clock_offset = other.clock_offset_ns();
        Self { source, mapping: &other.mapping, file: Some(&other.file), clock_offset }
    }

    /// The places of a signal that the recording has; those of a mapping file in any case, so that
    /// a missing one shows. Of several, those whose messages have the field: older ones lack some.
    fn candidates(&self, signal: Signal) -> impl Iterator<Item = SignalSource> {
        let asked_for = self.mapping.asked_for;
        let places = self.mapping.signals.get(&signal).map_or(&[][..], Vec::as_slice);
        let is_there = move |source: &&SignalSource| match places {
            _ if asked_for => true,
            [_] => self.source.expected(source).is_some(),
            _ => self.source.has_samples(source),
        };
        places.iter().filter(is_there).cloned()
    }

    /// Each request as a stream, with the times of the recording.
    fn read(&self, requests: &[Request], span: Span) -> Result<Vec<Stream>, SignalError> {
        let span = span.on_clock(self.clock_offset);
        let mut streams = self.source.read(requests, self.mapping.joint.as_deref(), span)?;
        for stream in &mut streams {
            if let Some(file) = self.file {
                let named = |place: &String| format!("{} {place}", file.display());
                stream.places = stream.places.iter().map(named).collect();
            }
            let timed = stream.stamps.iter_mut().filter(|stamp| **stamp != NO_TIME);
            timed.for_each(|stamp| *stamp = stamp.saturating_add(self.clock_offset));
        }
        Ok(streams)
    }

    /// A joined recording has samples while the position is recorded, or its clock is another.
    fn in_common(&self, stream: &Stream, grid: &Grid) -> Result<(), SignalError> {
        let during = grid.origin_ns..=grid.last_ns();
        let Some(file) = self.file else { return Ok(()) };
        if stream.stamps.iter().any(|stamp| during.contains(stamp)) {
            return Ok(());
        }
        // What is read is near the grid; of the others the first one says where they are.
        let sources = self.mapping.signals.iter().filter(|(s, _)| stream.signals.contains(s));
        let signals = sources.filter_map(|(signal, s)| Some((*signal, s.first()?.clone())));
        let group = Request { signals: signals.collect() };
        let one = Span::of(Window { most: Some(1), ..Window::default() });
        let first = self.read(&[group], one)?.first().and_then(|s| s.stamps.first().copied());
        let seconds = |stamp: i64| stamp as f64 * 1e-9;
        match first.filter(|stamp| *stamp != NO_TIME) {
            None => Ok(()),
            Some(first) => Err(SignalError::NoTimeInCommon {
                joined: file.to_owned(),
                begins_s: seconds(first),
                from_s: seconds(*during.start()),
                to_s: seconds(*during.end()),
            }),
        }
    }
}

/// Brings columns in memory onto a uniform grid, as [`load`] does with those of a file. Columns
/// that are empty or hold no number are not recorded; `name` stands for the path in errors and
/// findings.
pub fn from_columns(
    name: impl AsRef<Path>,
    columns: &Trace,
    window: Window,
) -> Result<Recording, SignalError> {
    let name = name.as_ref();
    let (source, mapping) = (Source::Columns(Columns::new(name, columns)?), Mapping::own_csv());
    on_grid(name, &Origin::recording(&source, &mapping), &[], window)
}

fn on_grid(
    path: &Path,
    origin: &Origin,
    joined: &[Origin],
    window: Window,
) -> Result<Recording, SignalError> {
    let (source, mapping) = (origin.source, origin.mapping);
    let mut loading = Loading {
        span: Span::of(window),
        notes: same_place(mapping),
        filled: Vec::new(),
        apart: Vec::new(),
    };
    let missing = || SignalError::MissingSignal {
        path: path.to_owned(),
        signal: Signal::Position.name(),
        needs: needs(mapping),
        has: source.inventory(),
    };
    let measured = [Signal::Position, Signal::Velocity]
        .into_iter()
        .find_map(|signal| Some((signal, origin.candidates(signal).next()?)));
    let (signal, place) = measured.ok_or_else(missing)?;
    let recorded = source.expected(&place).filter(|samples| *samples > 0);
    let mut stream = loading.read(origin, &[Request { signals: vec![(signal, place)] }])?.remove(0);
    stream.signals[0] = Signal::Position;
    let (total, is_part) = (stream.stamps.len(), stream.is_part());
    let Ordered { stamps, mut values, mut quality } = order(stream)?;
    if let (Some(first), Some(last)) = (stamps.first(), stamps.last()) {
        loading.span = if is_part { Span::between(*first, *last) } else { Span::default() };
    }
    if is_part {
        loading.notes.push(SignalNote::OnlyPart { samples: total as u64, recorded });
    }
    let mut velocities = Vec::new();
    if signal == Signal::Velocity {
        velocities.clone_from(&values[0]);
        let mut position = Integral::default();
        let rows = stamps.iter().zip(&mut values[0]);
        rows.for_each(|(stamp, value)| *value = position.next(*stamp, *value));
        loading.notes.push(SignalNote::Integrated);
    }
    let known = values[0].iter().filter(|v| v.is_finite()).count();
    if stamps.len() < 2 && (window.from.is_some() || window.to.is_some()) {
        return Err(SignalError::EmptyPart {
            path: path.to_owned(),
            signal: Signal::Position.name(),
            from: window.from,
            to: window.to,
            samples: known,
        });
    }
    if stamps.len() < 2 || known < 2 {
        return Err(SignalError::TooFewSamples {
            path: path.to_owned(),
            signal: Signal::Position.name(),
            samples: known,
            total,
        });
    }
    let grid = grid::grid(
        &stamps,
        &values[0],
        mapping.rate.filter(|_| !is_clock(mapping)),
        &quality[0].place,
    )?;
    let mut trace = Trace { origin_ns: grid.origin_ns, ..Trace::default() };
    quality[0].jitter_s = Some(grid.jitter_s);
    let Placed { column, filled: positions, .. } =
        resample::place(&grid, &stamps, &values[0], Between::Smooth, &mut quality[0]);
    quality[0].noise = noise_of_samples(&grid, &stamps, &values[0], &column);
    trace.position = column;
    let velocity = match signal {
        Signal::Velocity => {
            let account = &mut quality[0].clone();
            resample::place(&grid, &stamps, &velocities, Between::Smooth, account).column
        }
        _ => Vec::new(),
    };
    drop((stamps, values, velocities));
    loading.notes.extend(SignalNote::unconfirmed(&mapping.unconfirmed));
    if mapping.without_force_constant {
        loading.notes.push(SignalNote::NoForceConstant);
    }
    loading.others(origin, &grid, &mut trace, &mut quality)?;
    for other in joined {
        loading.others(other, &grid, &mut trace, &mut quality)?;
    }
    complete(&mut trace, grid.rows);
    resample::along_command(&mut trace.force_cell, &loading.apart, &trace.force);
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
        pauses: grid.pauses,
        signals: quality,
        notes: loading.notes,
    };
    Ok(Recording { joint: mapping.joint_type, trace, velocity, rate, valid, filled, quality })
}

/// The position of a stage whose velocity is measured, from 0 on: the trapezoidal sum.
#[derive(Debug, Default)]
pub(super) struct Integral {
    /// m
    position: f64,
    /// Time, ns, and velocity, m/s, of the last sample that had one.
    last: Option<(i64, f64)>,
}

impl Integral {
    /// The position at `stamp`, ns; NaN where the velocity is.
    pub fn next(&mut self, stamp: i64, velocity: f64) -> f64 {
        if !velocity.is_finite() {
            return f64::NAN;
        }
        if let Some((before, last)) = self.last {
            let step = stamp.saturating_sub(before) as f64 * 1e-9;
            self.position += 0.5 * (last + velocity) * step;
        }
        self.last = Some((stamp, velocity));
        self.position
    }
}

/// White noise of a signal's samples: of the rows where each of them is one, else of the samples at
/// their times, since what lies between them is smoother than they are.
fn noise_of_samples(grid: &Grid, stamps: &[i64], values: &[f64], column: &[f64]) -> Option<f64> {
    if grid.clock.keeps_values() {
        return noise::white_noise(column);
    }
    let first = *stamps.first()?;
    let times: Vec<f64> =
        stamps.iter().map(|stamp| stamp.saturating_sub(first) as f64 * 1e-9).collect();
    noise::white_noise_at(&times, values)
}

/// Says so of a signal whose times are all before or all after those of the position.
fn no_time_in_common(
    grid: &Grid,
    stamps: &[i64],
    found: &SignalQuality,
    samples: usize,
) -> Option<SignalNote> {
    let (&first, &last) = (stamps.first()?, stamps.last()?);
    let seconds = |stamp: i64| stamp as f64 * 1e-9;
    let is_elsewhere = last < grid.origin_ns || first > grid.last_ns();
    (samples > 0 && is_elsewhere).then(|| SignalNote::NoTimeInCommon {
        signal: found.signal,
        place: found.place.clone(),
        samples,
        during_s: [seconds(first), seconds(last)],
        position_s: [seconds(grid.origin_ns), seconds(grid.last_ns())],
    })
}

/// Signals that a mapping takes from the same place: a slip of the pen, most likely.
fn same_place(mapping: &Mapping) -> Vec<SignalNote> {
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
        .map(|(one, two)| SignalNote::SamePlace { first: *one, second: *two })
        .collect()
}

/// Whether the rate of a mapping says when the rows of a file without times were taken.
fn is_clock(mapping: &Mapping) -> bool {
    mapping.is_for_csv() && !mapping.signals.contains_key(&Signal::Time)
}

fn needs(mapping: &Mapping) -> String {
    let has_position = mapping.signals.contains_key(&Signal::Position);
    let places = mapping.places(if has_position { Signal::Position } else { Signal::Velocity });
    let other = if mapping.asked_for { "" } else { "; for other names give a mapping" };
    format!("{places}{other}")
}

/// Columns of signals that are nowhere recorded hold no number.
fn complete(trace: &mut Trace, rows: usize) {
    for column in [
        &mut trace.reference_position,
        &mut trace.reference_velocity,
        &mut trace.reference_acceleration,
        &mut trace.force_cell,
        &mut trace.force,
    ] {
        column.resize(rows, f64::NAN);
    }
}

struct Loading {
    span: Span,
    notes: Vec<SignalNote>,
    /// Rows of the forces that stand in place of missing samples, and samples of the cell that are
    /// further apart than the rows.
    filled: Vec<usize>,
    apart: Vec<Apart>,
}

impl Loading {
    fn read(&mut self, origin: &Origin, requests: &[Request]) -> Result<Vec<Stream>, SignalError> {
        let mut streams = origin.read(requests, self.span)?;
        for stream in &mut streams {
            // What is so of a file is reported once, however often it is read.
            stream.notes.retain(|note| !self.notes.contains(note));
            self.notes.append(&mut stream.notes);
        }
        Ok(streams)
    }

    /// Reads every signal but the position and puts it into the trace.
    fn others(
        &mut self,
        origin: &Origin,
        grid: &Grid,
        trace: &mut Trace,
        quality: &mut Vec<SignalQuality>,
    ) -> Result<(), SignalError> {
        let mut wanted: Vec<(Signal, Vec<SignalSource>)> = Signal::ALL
            .into_iter()
            .filter(|signal| ![Signal::Time, Signal::Position].contains(signal))
            .map(|signal| (signal, origin.candidates(signal).collect()))
            .collect();
        // each turn reads the first places, then the second ones of signals that the first did not
        // have
        while wanted.iter().any(|(_, sources)| !sources.is_empty()) {
            let next = wanted.iter_mut().filter(|(_, sources)| !sources.is_empty());
            let mut groups =
                Request::grouped(next.map(|(signal, sources)| (*signal, sources.remove(0))));
            while !groups.is_empty() {
                // as many groups in one pass as fit, one at least
                let bytes = |group: &Request| {
                    let expected = origin.source.expected(group.first()).unwrap_or(0);
                    expected.max(grid.rows as u64) * 8 * (1 + group.signals.len() as u64)
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
                for stream in self.read(origin, &now)? {
                    origin.in_common(&stream, grid)?;
                    self.place(grid, stream, trace, quality)?;
                }
            }
            for (signal, sources) in &mut wanted {
                if quality.iter().any(|q| q.signal == *signal && q.coverage >= LEAST_COVERAGE) {
                    sources.clear();
                }
            }
        }
        Ok(())
    }

    fn place(
        &mut self,
        grid: &Grid,
        stream: Stream,
        trace: &mut Trace,
        quality: &mut Vec<SignalQuality>,
    ) -> Result<(), SignalError> {
        let ends_interval = stream.ends_interval;
        let Ordered { mut stamps, mut values, quality: found } = order(stream)?;
        if ends_interval {
            let step = grid.step_ns.round() as i64;
            stamps.iter_mut().for_each(|stamp| *stamp = stamp.saturating_sub(step));
        }
        for (index, mut found) in found.into_iter().enumerate() {
            let raw = std::mem::take(&mut values[index]);
            let Placed { column, filled, apart } =
                resample::place(grid, &stamps, &raw, Between::of(found.signal), &mut found);
            found.noise = noise_of_samples(grid, &stamps, &raw, &column);
            let samples = raw.iter().filter(|value| value.is_finite()).count();
            drop(raw);
            if found.coverage == 0.0 {
                self.notes.extend(no_time_in_common(grid, &stamps, &found, samples));
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
                    self.apart = apart;
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
                Signal::Time | Signal::Position | Signal::Velocity => {}
            }
            quality.push(found);
        }
        Ok(())
    }
}
