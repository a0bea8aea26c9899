//! A bag of the stage row by row, as it was recorded: each sample of the encoder with what else has
//! its stamp, bit for bit.
//!
//! What comes in is an open bag with the topics of the stage; what goes out is a [`Trace`], on the
//! stamps of the encoder and not on a grid.

use std::collections::HashMap;

use super::error::SignalError;
use super::mapping::{Mapping, Signal, SignalSource};
use super::source::{NO_TIME, Request, Stream};
use super::topic_source::{has_samples, inventory, read_bag};
use super::trace::Trace;
use super::window::Span;
use crate::bag::{BagReader, topics};

/// Rows further apart than this many of the shortest steps have a hole between them.
const HOLE: f64 = 1.5;

/// The rows of a bag. A value is that of the first place of its signal that has one for the stamp.
pub(super) fn trace_by_stamp(reader: &BagReader) -> Result<Trace, SignalError> {
    let mapping = Mapping::own_bag(reader.provenance(), reader.namespace());
    let report = format!("{}{}", reader.namespace(), topics::CONTROLLER_STATE);
    let places = |signal: Signal| -> Vec<SignalSource> {
        let all = mapping.signals.get(&signal).into_iter().flatten();
        let mut there: Vec<_> = all.filter(|source| has_samples(reader, source)).cloned().collect();
        // What acted is known, or nothing is: what was asked for may have come late.
        if let Some(acted) = there.iter().position(|source| source.place.ends_interval()) {
            there = vec![there.swap_remove(acted)];
        }
        // A controller also reports samples that it did not answer.
        if signal == Signal::Force && there.len() > 1 {
            there.retain(|source| !source.place.is_of_topic(&report));
        }
        there
    };
    let wanted: Vec<(Signal, SignalSource)> = Signal::ALL
        .into_iter()
        .flat_map(|signal| places(signal).into_iter().map(move |source| (signal, source)))
        .collect();
    let requests = Request::grouped(wanted.iter().cloned());
    if !requests.iter().any(|request| request.has(Signal::Position)) {
        return Err(missing(reader, Signal::Position, &mapping));
    }
    let streams = read_bag(reader, &requests, None, Span::default())?;
    let columns = columns(&wanted, &requests, &streams);
    let rows = rows(&columns);
    if columns.iter().all(|column| {
        column.signal != Signal::Position || column.values.iter().all(|value| value.is_nan())
    }) {
        return Err(missing(reader, Signal::Position, &mapping));
    }
    let mut trace = Trace { origin_ns: rows.first().copied().unwrap_or(0), ..Trace::default() };
    trace.time = rows.iter().map(|stamp| (stamp - trace.origin_ns) as f64 * 1e-9).collect();
    let of_trace = [
        (Signal::ReferencePosition, &mut trace.reference_position),
        (Signal::ReferenceVelocity, &mut trace.reference_velocity),
        (Signal::ReferenceAcceleration, &mut trace.reference_acceleration),
        (Signal::Position, &mut trace.position),
        (Signal::ForceCell, &mut trace.force_cell),
        (Signal::Force, &mut trace.force),
    ];
    for (signal, column) in of_trace {
        *column = at_rows(&rows, &columns, signal);
    }
    Ok(trace)
}

/// A recording without a signal.
pub(super) fn missing(reader: &BagReader, signal: Signal, mapping: &Mapping) -> SignalError {
    SignalError::MissingSignal {
        path: reader.path().to_owned(),
        signal: signal.name(),
        needs: mapping.places(signal),
        has: inventory(reader),
    }
}

/// What one place has of a signal.
struct Column<'a> {
    signal: Signal,
    stamps: &'a [i64],
    values: &'a [f64],
    ends_interval: bool,
    /// Of several values with one stamp the last number counts: what came before it was not the
    /// answer. Else the first value.
    last_counts: bool,
}

/// The columns of the places that were wanted, in their order: the first has the first say.
fn columns<'a>(
    wanted: &[(Signal, SignalSource)],
    requests: &[Request],
    streams: &'a [Stream],
) -> Vec<Column<'a>> {
    let column = |one: &(Signal, SignalSource)| {
        requests.iter().zip(streams).find_map(|(request, stream)| {
            let at = request.signals.iter().position(|signal| signal == one)?;
            Some(Column {
                signal: one.0,
                stamps: &stream.stamps,
                values: &stream.values[at],
                ends_interval: stream.ends_interval,
                last_counts: one.1.place.is_by_log_time(),
            })
        })
    };
    wanted.iter().filter_map(column).collect()
}

/// The stamps of the samples of the encoder, each once, ns.
fn rows(columns: &[Column]) -> Vec<i64> {
    let of_position = columns.iter().filter(|column| column.signal == Signal::Position);
    let stamps = of_position.flat_map(|column| column.stamps.iter().copied());
    let mut rows: Vec<i64> = stamps.filter(|stamp| *stamp != NO_TIME).collect();
    rows.sort_unstable();
    rows.dedup();
    rows
}

/// What a signal has for each row; NaN where it has nothing.
fn at_rows(rows: &[i64], columns: &[Column], signal: Signal) -> Vec<f64> {
    let mut at_rows = vec![f64::NAN; rows.len()];
    for column in columns.iter().filter(|column| column.signal == signal) {
        let mut known: HashMap<i64, f64> = HashMap::with_capacity(column.values.len());
        for (stamp, value) in column.stamps.iter().zip(column.values) {
            let first = known.entry(*stamp).or_insert(*value);
            if column.last_counts && !value.is_nan() {
                *first = *value;
            }
        }
        let stamps = if column.ends_interval { ends(rows) } else { rows.to_vec() };
        for (place, stamp) in at_rows.iter_mut().zip(stamps).filter(|(place, _)| place.is_nan()) {
            *place = known.get(&stamp).copied().unwrap_or(f64::NAN);
        }
    }
    at_rows
}

/// Where the interval after each row ends, ns; none before a hole and after the last row.
fn ends(rows: &[i64]) -> Vec<i64> {
    let shortest = rows.windows(2).map(|pair| pair[1] - pair[0]).min().unwrap_or(0);
    let end = |row: usize| {
        let next = rows.get(row + 1).copied()?;
        ((next - rows[row]) as f64 <= HOLE * shortest as f64).then_some(next)
    };
    (0..rows.len()).map(|row| end(row).unwrap_or(NO_TIME)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn column<'a>(
        signal: Signal,
        stamps: &'a [i64],
        values: &'a [f64],
        ends_interval: bool,
    ) -> Column<'a> {
        Column { signal, stamps, values, ends_interval, last_counts: false }
    }

    #[test]
    fn rows_are_the_stamps_of_the_position_and_the_first_value_of_a_stamp_counts() {
        let streams = [
            column(Signal::Position, &[30, 10, 20, 20], &[3.0, 1.0, 2.0, 9.0], false),
            column(Signal::Force, &[10, 30], &[f64::NAN, 7.0], false),
            column(Signal::Force, &[10, 20, 30], &[4.0, 5.0, 6.0], false),
        ];
        let rows = rows(&streams);
        assert_eq!(rows, [10, 20, 30]);
        assert_eq!(at_rows(&rows, &streams, Signal::Position), [1.0, 2.0, 3.0]);
        assert_eq!(at_rows(&rows, &streams, Signal::Force), [4.0, 5.0, 7.0]);
    }

    /// As joint commands in lockstep: those on their way, one without a number, the answer.
    #[test]
    fn of_commands_with_one_log_time_the_last_number_counts() {
        let (stamps, values) = ([10, 20, 20, 20], [1.0, 2.0, f64::NAN, 3.0]);
        let commands =
            Column { last_counts: true, ..column(Signal::Force, &stamps, &values, false) };
        assert_eq!(at_rows(&[10, 20], &[commands], Signal::Force), [1.0, 3.0]);
    }

    #[test]
    fn what_acted_until_a_stamp_is_of_the_row_before_it_and_of_none_before_a_hole() {
        let rows = [0, 10, 20, 50, 60];
        let acted = [column(Signal::Force, &rows, &[0.0, 1.0, 2.0, 3.0, 4.0], true)];
        let force = at_rows(&rows, &acted, Signal::Force);
        assert_eq!((force[0], force[1], force[3]), (1.0, 2.0, 4.0));
        assert!(force[2].is_nan() && force[4].is_nan(), "{force:?}");
    }
}
