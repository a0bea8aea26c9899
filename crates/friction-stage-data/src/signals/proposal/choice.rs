//! Which column is which signal: by its unit, its name, and how it moves.

use super::series::{
    captures, counts_rows, falls, increases, is_smooth, is_uniform, roughness, usual_step,
};
use super::table::{Samples, Table, counts_captures};
use super::time::{TICK, joined_time, offset_of_ticks, split_time, unit_of_epoch};
use super::{Proposal, ProposedSignal, TableColumn, has_motion, joint_of, shown};
use crate::signals::column_name::{ColumnName, Quantity, Role};
use crate::signals::mapping::Signal;
use crate::signals::unit::{Dimension, Unit};
use friction_stage_core::model::JointType;

/// Rows per second that are proposed where nothing says them.
const RATE: f64 = 1000.0;

/// How likely a column must be as a signal for a person to choose, as part of the likeliest.
/// Assumed: half.
const RIVAL: f64 = 0.5;

/// What the axis of the motion adds to the likeness of another signal: it decides between two that
/// are alike otherwise.
const SAME_AXIS: f64 = 0.25;

/// Part of the travel of its reference that a position makes at least. Assumed: half.
const FOLLOWS: f64 = 0.5;

/// What to check where no column can be the motion.
const NO_MOTION: &str = "no column moves that could be a position or a velocity: name it, or the \
                         file that has it first";

/// Longest travel of a stage, m. Assumed.
const LONGEST_TRAVEL: f64 = 10.0;

impl Proposal {
    /// Which of the columns `own` of a table are which signals.
    pub(super) fn of_columns(table: &Table, own: &[usize], taken: &[Signal]) -> Proposal {
        let samples = table.samples;
        let rows = samples.first().map_or(0, |column| column.values.len());
        let mut columns: Vec<TableColumn> = own.iter().map(|at| table.column(*at)).collect();
        let mut signals: Vec<ProposedSignal> = Vec::new();
        let has_values = |column: &TableColumn| samples[column.number - 1].has_values();
        let first = columns.iter().find(|column| has_values(column)).map(|column| column.number);
        let split = split_time(&columns, samples).filter(|_| !taken.contains(&Signal::Time));
        if let Some((seconds, nanoseconds)) = split {
            for column in &mut columns {
                if [seconds, nanoseconds].contains(&column.number) {
                    column.signal = Some(Signal::Time);
                }
            }
            signals.push(ProposedSignal {
                signal: Signal::Time,
                column: seconds,
                minus: None,
                minus_unit: None,
                plus: Some(nanoseconds),
                is_current: false,
                unit: Some("s".to_owned()),
                scale: None,
                offset: None,
                check: table.names[nanoseconds - 1]
                    .is_empty()
                    .then(|| "by their numbers these are seconds and nanoseconds".to_owned()),
            });
        }
        let mut is_motion_guessed = false;
        // The name of the motion, of whose axis the forces are to be.
        let mut motion: Option<ColumnName> = None;
        for signal in [
            Signal::Time,
            Signal::Position,
            Signal::Velocity,
            Signal::ReferencePosition,
            Signal::ReferenceVelocity,
            Signal::ForceCell,
            Signal::Force,
        ] {
            // A force is sought among what is no motion.
            if signal == Signal::ForceCell && taken.is_empty() && !has_motion(&signals) {
                signals.extend(from_following_error(&signals, &mut columns));
                if !has_motion(&signals) {
                    let guessed = moves_most_like_a_position(&signals, &mut columns, samples);
                    is_motion_guessed = guessed.is_some();
                    signals.extend(guessed);
                }
            }
            let has_position = |found: &ProposedSignal| found.signal == Signal::Position;
            let is_moving = !taken.is_empty() || signals.iter().any(has_position);
            let is_motion = signal == Signal::Velocity && is_moving
                || signal == Signal::Position && !taken.is_empty();
            if is_motion || taken.contains(&signal) || signal == Signal::Time && split.is_some() {
                continue;
            }
            let free = columns.iter().filter(|column| column.signal.is_none());
            let mut candidates: Vec<(f64, usize)> = free
                .map(|column| {
                    let is_first = Some(column.number) == first;
                    let as_signal =
                        |signal| likeness(signal, column, is_first, &samples[column.number - 1]);
                    let likeness = match signal {
                        // Where the command is known, another force is a measured one.
                        Signal::ForceCell if taken.contains(&Signal::Force) => {
                            as_signal(Signal::ForceCell).max(as_signal(Signal::Force))
                        }
                        signal => as_signal(signal),
                    };
                    let of_axis = motion
                        .as_ref()
                        .is_some_and(|motion| ColumnName::of(&column.name).is_of_same_axis(motion));
                    (
                        likeness + if likeness > 0.0 && of_axis { SAME_AXIS } else { 0.0 },
                        column.number,
                    )
                })
                .filter(|(likeness, _)| *likeness > 0.0)
                .collect();
            candidates.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
            let Some(&(best, number)) = candidates.first() else { continue };
            let rivals: Vec<String> = candidates[1..]
                .iter()
                .filter(|(likeness, number)| match signal {
                    Signal::Time => false,
                    // A second position is worth a question, however it is called.
                    Signal::Position if has_unit_of(signal, &table.column(number - 1)) => true,
                    _ => *likeness >= RIVAL * best,
                })
                .map(|(_, number)| shown(&table.column(number - 1)))
                .collect();
            let joint = joint_of(&signals);
            let Some(column) = columns.iter_mut().find(|column| column.number == number) else {
                continue;
            };
            column.signal = Some(signal);
            let mut found = proposed(signal, column, &samples[number - 1], joint);
            let name = ColumnName::of(&column.name);
            if motion.as_ref().is_some_and(|motion| name.is_of_other_axis(motion)) {
                found.add_check("by its name it is of another axis than the motion");
            }
            found.add_rivals(&rivals);
            if [Signal::Position, Signal::Velocity].contains(&signal) {
                motion = Some(name);
            }
            signals.push(found);
        }
        let mut table_checks = Vec::new();
        if taken.is_empty() {
            signals.extend(the_only_column_left(&signals, &mut columns));
            if !has_motion(&signals) {
                table_checks.push(NO_MOTION.to_owned());
            }
        }
        ask_for_a_following_error(&mut signals, &columns);
        let mut proposal = Proposal {
            format: "",
            not_used: Vec::new(),
            delimiter: String::new(),
            decimal_comma: false,
            either_decimal: false,
            names_line: None,
            units_line: None,
            data_line: 0,
            rows,
            rate_hz: None,
            columns,
            signals,
            stated_rate: None,
            table_checks,
            is_motion_guessed,
            own_clocks: Vec::new(),
        };
        proposal.take_a_time_that_does_not_rise(samples);
        proposal.find_captures(samples);
        let time = proposal.signals.iter().find(|found| found.signal == Signal::Time);
        proposal.rate_hz = time.and_then(|time| {
            let unit = time.unit.as_deref().and_then(Unit::named).map_or(1.0, |unit| unit.size);
            let unit = unit * time.scale.unwrap_or(1.0);
            let whole = samples[time.column - 1].values.as_slice();
            let step = match time.plus {
                Some(part) => usual_step(&joined_time(whole, &samples[part - 1].values)),
                None => usual_step(whole),
            };
            let rate = 1.0 / (unit * step?.abs());
            rate.is_finite().then_some(rate)
        });
        if time.is_none() {
            let counter =
                proposal.columns.iter().find(|c| counts_rows(&samples[c.number - 1].values));
            let of_counter = counter
                .map_or(String::new(), |column| format!("; {} counts the rows", shown(column)));
            let check = format!("rows per second; no column is a time{of_counter}");
            proposal.stated_rate = Some((RATE, check));
        }
        proposal
    }
}

/// How much a column looks like a signal; 0: not at all. By its unit, its name, how it moves.
/// `is_first`: whether it is the first column with values.
fn likeness(signal: Signal, column: &TableColumn, is_first: bool, samples: &Samples) -> f64 {
    use Quantity::{Acceleration, Current, Force, ForceCell, Position, Time, Velocity};
    let name = ColumnName::of(&column.name);
    let unit = Unit::named(&column.unit);
    let dimension = unit.map(|unit| unit.dimension);
    let has_unit = |of: Signal| dimension.is_some_and(|dimension| of.has_dimension(dimension));
    // A motor may turn where the stage moves along: other units need a scale, not another signal.
    let is_none_of_motion = dimension.is_some_and(is_none_of_motion);
    let is = |named: bool| f64::from(u8::from(named));
    let is_named = |quantity: Quantity| is(name.quantity == Some(quantity));
    if signal == Signal::Time {
        let is_time = name.quantity == Some(Time);
        let is_monotone = increases(&samples.values) || is_time && falls(&samples.values);
        let score = 2.0 * is(samples.is_clock)
            + is(is_time || has_unit(Signal::Time))
            + 0.5 * is(is_uniform(&samples.values));
        // What counts the rows says no time, unless it has no other name.
        let may_be_first = is_first && !(name.has_words && counts_rows(&samples.values));
        return if is_monotone && (score >= 1.0 || may_be_first) { score } else { 0.0 };
    }
    let moves = column.smallest < column.largest;
    if !moves || name.role == Role::Other || matches!(name.quantity, Some(Time | Acceleration)) {
        return 0.0;
    }
    let is_asked = name.role == Role::Asked;
    // Of two the one that is said to be measured.
    let measured = 0.5 * is(name.role == Role::Measured);
    match (signal, name.quantity) {
        (Signal::Position, None | Some(Position)) if !is_asked && !is_none_of_motion => {
            let counts = is(unit.is_some_and(|unit| unit.name == "count"));
            let smooth =
                is(column.unit.is_empty() && !name.has_words && is_smooth(&samples.values));
            let said = 2.0 * is(has_unit(signal)) + 2.0 * is_named(Position) + counts;
            said + 0.5 * smooth + if said > 0.0 { measured } else { 0.0 }
        }
        (Signal::Velocity, None | Some(Velocity)) if !is_asked => {
            let said = 2.0 * is(has_unit(signal)) + 1.5 * is_named(Velocity);
            said + if said > 0.0 { measured } else { 0.0 }
        }
        (Signal::ReferencePosition, None | Some(Position)) if is_asked && !is_none_of_motion => {
            2.0 * is(has_unit(signal)) + is_named(Position) + 0.5
        }
        (Signal::ReferenceVelocity, None | Some(Velocity)) if is_asked => {
            is(has_unit(signal)) + is_named(Velocity)
        }
        (Signal::ForceCell, Some(ForceCell)) => 1.0 + is(has_unit(signal)),
        (Signal::Force, None | Some(Force | ForceCell | Current)) => {
            let of_drive = [Dimension::Current, Dimension::Voltage, Dimension::Number];
            let drive = dimension.is_some_and(|dimension| of_drive.contains(&dimension));
            2.0 * is(has_unit(signal)) + 1.5 * is(name.quantity.is_some()) + is(drive)
        }
        _ => 0.0,
    }
}

/// The signal with its unit, and what the file does not say of it.
pub(super) fn proposed(
    signal: Signal,
    column: &TableColumn,
    samples: &Samples,
    joint: JointType,
) -> ProposedSignal {
    let written = Some(column.unit.as_str()).filter(|unit| !unit.is_empty());
    let known = written.and_then(Unit::named);
    let names_current = || ColumnName::of(&column.name).quantity == Some(Quantity::Current);
    let is_current = signal == Signal::Force
        && known.map_or(written.is_none() && names_current(), |unit| {
            unit.dimension == Dimension::Current
        });
    // The first signal of the motion says what joint it is.
    let is_motion = [Signal::Position, Signal::Velocity].contains(&signal);
    let joint = known.and_then(Unit::joint).filter(|_| is_motion).unwrap_or(joint);
    let si = signal.si_unit(joint);
    let is_bare_time = signal == Signal::Time && written.is_none();
    let ticks = offset_of_ticks(&samples.values).filter(|_| is_bare_time);
    let (unit, scale, check) = match known {
        None if signal == Signal::Time && samples.is_clock => (None, None, None),
        Some(unit) if unit.dimension == signal.dimension(joint) => (written, None, None),
        None if signal == Signal::Time && written.is_some() => {
            let unit = written.unwrap_or_default();
            (None, Some(1.0), Some(format!("it is in {unit}: its `scale`, s per {unit}")))
        }
        _ if ticks.is_some() => {
            (None, Some(TICK), Some("ticks of 100 ns by the size of its numbers".to_owned()))
        }
        _ if signal == Signal::Time => {
            let unit = unit_of_epoch(&samples.values);
            let by_size = format!("{unit} by the size of its numbers");
            let order = if falls(&samples.values) {
                "; the newest row comes first: reverse the rows"
            } else {
                ""
            };
            (Some(unit), None, Some(by_size + order))
        }
        Some(_) if is_current => (written, None, Some(format!("give the `scale`, {si} per A"))),
        None if is_current => (Some("A"), None, Some(format!("A? And its `scale`, {si} per A"))),
        Some(Unit { name: "%", .. }) => {
            (written, Some(1.0), Some(format!("the `scale` is the {si} of 100 %")))
        }
        // A unit of the other kind of joint would make it that joint.
        Some(unit) if signal.has_dimension(unit.dimension) => {
            let unit = written.unwrap_or_default();
            (None, Some(1.0), Some(format!("it is in {unit}: its `scale`, {si} per {unit}")))
        }
        Some(unit) => {
            let per = unit.dimension.si();
            (written, Some(1.0), Some(format!("the `scale`, {si} per {per}")))
        }
        None => match written {
            Some(unit) => {
                (None, Some(1.0), Some(format!("it is in {unit}: its `scale`, {si} per {unit}")))
            }
            None => {
                let unit = match column.smallest.zip(column.largest) {
                    Some((low, high)) if si == "m" => unit_of_travel(high - low),
                    _ => si,
                };
                (Some(unit), None, Some(format!("the file gives no unit, {unit}?")))
            }
        },
    };
    let unit = unit.map(str::to_owned);
    ProposedSignal {
        signal,
        column: column.number,
        minus: None,
        minus_unit: None,
        plus: None,
        is_current,
        unit,
        scale,
        offset: ticks,
        check,
    }
}

/// Whether the file gives a unit that a signal has.
fn has_unit_of(signal: Signal, column: &TableColumn) -> bool {
    Unit::named(&column.unit).is_some_and(|unit| signal.has_dimension(unit.dimension))
}

/// Whether a position has no such unit.
fn is_none_of_motion(dimension: Dimension) -> bool {
    [Signal::Time, Signal::Velocity, Signal::Force].iter().any(|of| of.has_dimension(dimension))
        || dimension == Dimension::Current
}

/// The largest unit in which numbers that reach so far are the travel of a stage.
fn unit_of_travel(range: f64) -> &'static str {
    match range {
        range if range <= LONGEST_TRAVEL => "m",
        range if range * 1e-3 <= LONGEST_TRAVEL => "mm",
        _ => "um",
    }
}

/// Without a position, but with a reference and a following error: the one less the other.
fn from_following_error(
    signals: &[ProposedSignal],
    columns: &mut [TableColumn],
) -> Option<ProposedSignal> {
    let found = |signal: Signal| signals.iter().find(|found| found.signal == signal);
    if found(Signal::Position).or(found(Signal::Velocity)).is_some() {
        return None;
    }
    let reference = found(Signal::ReferencePosition)?;
    let unit = |column: &TableColumn| Unit::named(&column.unit);
    let dimension = |column: &TableColumn| unit(column).map(|unit| unit.dimension);
    let asked = columns.iter().find(|column| column.number == reference.column)?.clone();
    let is_error = |column: &&mut TableColumn| {
        let name = ColumnName::of(&column.name);
        column.signal.is_none()
            && column.smallest < column.largest
            && name.role == Role::Other
            && matches!(name.quantity, None | Some(Quantity::Position))
            && dimension(column) == dimension(&asked)
    };
    let error = columns.iter_mut().find(is_error)?;
    error.signal = Some(Signal::Position);
    let sign = "the reference less the error; its sign?".to_owned();
    Some(ProposedSignal {
        signal: Signal::Position,
        minus: Some(error.number),
        minus_unit: (unit(error) != unit(&asked)).then(|| error.unit.clone()),
        check: Some(reference.check.as_ref().map_or(sign.clone(), |unit| format!("{sign} {unit}"))),
        ..reference.clone()
    })
}

/// Where no name and no unit says a motion: the column that goes on from row to row most as before,
/// for a person to check.
fn moves_most_like_a_position(
    signals: &[ProposedSignal],
    columns: &mut [TableColumn],
    samples: &[Samples],
) -> Option<ProposedSignal> {
    let values = |column: &TableColumn| samples[column.number - 1].values.as_slice();
    let mut candidates: Vec<(f64, usize)> = columns
        .iter()
        .enumerate()
        .filter(|(_, column)| column.signal.is_none() && column.smallest < column.largest)
        .filter(|(_, column)| {
            let name = ColumnName::of(&column.name);
            let values = values(column);
            let is_clock = is_uniform(values) && (increases(values) || falls(values));
            let is_counter =
                counts_captures(&column.name) && captures(values).is_some_and(|count| count > 1);
            matches!(name.quantity, None | Some(Quantity::Position))
                && ![Role::Other, Role::Asked].contains(&name.role)
                && !is_clock
                && !is_counter
                && Unit::named(&column.unit).is_none_or(|unit| !is_none_of_motion(unit.dimension))
        })
        .map(|(at, column)| (roughness(values(column)), at))
        .filter(|(roughness, _)| roughness.is_finite())
        .collect();
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (&(_, at), others) = candidates.split_first()?;
    let others: Vec<String> = others.iter().map(|(_, at)| shown(&columns[*at])).collect();
    let column = &mut columns[at];
    column.signal = Some(Signal::Position);
    let joint = joint_of(signals);
    let mut found = proposed(Signal::Position, column, &samples[column.number - 1], joint);
    found.add_check("no name or unit says a motion: of what moves, this does most like a position");
    found.add_rivals(&others);
    Some(found)
}

/// A position that moves far less than its reference may be the error of following it, or be in
/// another unit.
fn ask_for_a_following_error(signals: &mut [ProposedSignal], columns: &[TableColumn]) {
    let travel = |signal: Signal| {
        let found = signals.iter().find(|found| found.signal == signal)?;
        let unit = found.unit.as_deref().and_then(Unit::named).map_or(1.0, |unit| unit.size);
        let column = columns.iter().find(|column| column.number == found.column)?;
        let range = unit * found.scale.unwrap_or(1.0) * (column.largest? - column.smallest?);
        (found.minus.is_none() && range > 0.0).then_some(range)
    };
    let both = travel(Signal::Position).zip(travel(Signal::ReferencePosition));
    let Some((position, reference)) = both.filter(|(one, other)| *one < FOLLOWS * other) else {
        return;
    };
    let part = 100.0 * position / reference;
    for found in signals.iter_mut().filter(|found| found.signal == Signal::Position) {
        found.add_check(&format!(
            "it moves by {part:.2} % of the reference only: is it the error of following it?"
        ));
    }
}

/// Of a table without names: where one column is left that moves, and no force was found, it is
/// the force, for a person to check.
fn the_only_column_left(
    signals: &[ProposedSignal],
    columns: &mut [TableColumn],
) -> Option<ProposedSignal> {
    let is_found = |signal: Signal| signals.iter().any(|found| found.signal == signal);
    let has_names = columns.iter().any(|column| !column.name.is_empty());
    if has_names || !is_found(Signal::Position) || is_found(Signal::Force) {
        return None;
    }
    let mut left = columns
        .iter_mut()
        .filter(|column| column.signal.is_none() && column.smallest < column.largest);
    let (column, None) = (left.next()?, left.next()) else { return None };
    column.signal = Some(Signal::Force);
    Some(ProposedSignal {
        signal: Signal::Force,
        column: column.number,
        minus: None,
        minus_unit: None,
        plus: None,
        is_current: false,
        unit: Some(Signal::Force.si_unit(joint_of(signals)).to_owned()),
        scale: None,
        offset: None,
        check: Some("the only column that is left; is it the force, and its unit?".to_owned()),
    })
}
