//! What a check, an import or a recovery found, as text for a person.

use std::fmt::Write as _;
use std::path::Path;

use friction_stage_core::model::JointType;
use friction_stage_data::bag::{Damage, RecoverReport};
use friction_stage_data::quality::{
    CheckReport, Excitation, Judgement, Obstacle, RecordingCheck, TopicCheck,
};
use friction_stage_data::signals::{ClockKind, DataQuality, ImportReport, Proposal, SignalQuality};

use super::data::{severity, signals, subject};
use super::{Words, in_line, short};

/// What a recording holds, what is wrong with it and what can be identified from it.
pub fn recording_text(check: &RecordingCheck) -> String {
    let mut text = String::new();
    if let Some(messages) = &check.messages {
        text += &messages_text(messages);
    }
    if let Some(rows) = &check.rows {
        text += &rows_text(rows);
    }
    if let (Some(data), Some(identification)) = (&check.data, &check.identification) {
        text += &data_text(data);
        text += &identification_text(identification);
    }
    if let Some(reason) = &check.no_data {
        text += &format!("nothing can be identified from it: {}\n", in_one(&reason.to_string()));
    }
    text
}

/// The times of a whole table.
fn rows_text(rows: &TopicCheck) -> String {
    let rate = rows.rate_hz.map_or("no usual rate".to_owned(), |rate| format!("{rate:.3} Hz"));
    format!(
        "all {} rows: {rate}, {} gaps (the longest {:.6} s), {} times repeat, {} go back, {} \
         values missing\n",
        rows.messages,
        rows.gaps,
        rows.longest_gap_s.unwrap_or(0.0),
        rows.repeated_stamps,
        rows.backward_stamps,
        rows.non_finite,
    )
}

/// What the messages of a bag are and what is wrong with them.
pub fn messages_text(report: &CheckReport) -> String {
    let mut text = format!(
        "{}: {} messages in {:.3} s, {:.1} MB, {}, {}\n",
        report.path.display(),
        report.messages,
        report.duration_s,
        report.bytes as f64 * 1e-6,
        if report.complete { "complete" } else { "cut off or damaged" },
        if report.has_provenance {
            "with model, seed, version and arguments"
        } else {
            "without provenance"
        },
    );
    text += &topics_table(report);
    for damage in &report.damage {
        text += &format!("damaged: {}\n", in_one(&place(damage)));
    }
    for finding in &report.findings {
        text += &format!("warning: {}\n", in_one(&finding.words(JointType::default())));
    }
    text
}

/// A sentence in one line: names from the file in it may have several.
fn in_one(sentence: &str) -> String {
    sentence.replace('\n', "\\n")
}

fn place(damage: &Damage) -> String {
    format!(
        "{} at byte {}: expected {}, found {}",
        damage.path.display(),
        damage.offset,
        damage.expected,
        damage.found
    )
}

fn topics_table(report: &CheckReport) -> String {
    let header = [
        "topic",
        "type",
        "messages",
        "rate Hz",
        "jitter µs",
        "gaps",
        "longest s",
        "repeat",
        "back",
        "not finite",
        "undecoded",
    ];
    let mut rows = vec![header.map(String::from)];
    for topic in &report.topics {
        let number = |value: Option<f64>, scale: f64, digits: usize| {
            value.map_or_else(|| "-".into(), |value| format!("{:.digits$}", value * scale))
        };
        let decoded = |value: u64| {
            if topic.decoded { value.to_string() } else { "-".into() }
        };
        rows.push([
            in_line(&topic.name).into_owned(),
            in_line(&topic.type_name).into_owned(),
            topic.messages.to_string(),
            if topic.in_bursts { "in bursts".into() } else { number(topic.rate_hz, 1.0, 1) },
            number(topic.jitter_s, 1e6, 1),
            topic.gaps.to_string(),
            number(topic.longest_gap_s, 1.0, 6),
            topic.repeated_stamps.to_string(),
            topic.backward_stamps.to_string(),
            decoded(topic.non_finite),
            decoded(topic.decode_failures),
        ]);
    }
    let width =
        |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..header.len()).map(width).collect();
    let mut text = String::new();
    for row in &rows {
        let mut line = String::new();
        for (column, (cell, &width)) in row.iter().zip(&widths).enumerate() {
            if column < 2 {
                line.push_str(&format!("{cell:width$}  "));
            } else {
                line.push_str(&format!("{cell:>width$}  "));
            }
        }
        text += line.trim_end();
        text.push('\n');
    }
    text
}

fn data_text(data: &DataQuality) -> String {
    let clock = match data.clock {
        ClockKind::Regular => "uniform as recorded",
        ClockKind::UniformBehindJitter => "uniform behind stamps that jitter, values as recorded",
        ClockKind::AtStamps => "not uniform, interpolated from the stamps",
        ClockKind::OtherRate => "interpolated to the rate that was asked for",
    };
    let mut text = format!(
        "data: {} rows at {:.3} Hz ({clock}), {} usable in {} pieces\n",
        data.rows, data.rate_hz, data.valid_rows, data.segments
    );
    for signal in &data.signals {
        if let Some(account) = account(signal, data.rate_hz) {
            text += &format!(
                "data: {} from {}: {} samples, {account}\n",
                signal.signal, signal.place, signal.samples
            );
        }
    }
    for note in &data.notes {
        text += &format!("data: {}\n", note.words(JointType::default()));
    }
    text
}

/// What was not as it should be with a signal; none if all was.
fn account(signal: &SignalQuality, rate_hz: f64) -> Option<String> {
    let counts = [
        (signal.out_of_order, "out of order"),
        (signal.repeated, "with a repeated stamp"),
        (signal.not_finite, "not finite"),
        (signal.missing, "missing"),
    ];
    let mut parts: Vec<String> = counts
        .iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, what)| format!("{count} {what}"))
        .collect();
    if signal.filled > 0 {
        parts.push(format!("{} rows filled from neighbours", signal.filled));
    }
    if signal.gaps > 0 {
        parts.push(format!("{} gaps, the longest {:.4} s", signal.gaps, signal.longest_interval_s));
    }
    // Signals that come slower than the rows are filled in between.
    if signal.interval_s * rate_hz > 1.5 {
        parts.push(format!("one sample every {:.6} s", signal.interval_s));
    }
    (!parts.is_empty()).then(|| parts.join(", "))
}

fn identification_text(found: &Excitation) -> String {
    let joint = found.joint;
    let [m, n, speed, rate] = ["m", "N", "m/s", "m/s^2"].map(|unit| joint.unit(unit));
    let mut text = format!(
        "signals: {}; {:.3} s of usable rows\n",
        signals(&found.recorded),
        found.duration_s
    );
    text += &format!(
        "motion: {} to {} {m}, {} to {} {speed}, up to {} {rate}; {} reversals, {} {m} travelled, \
         {:.2} s at rest\n",
        short(found.position_range[0]),
        short(found.position_range[1]),
        short(found.velocity_range[0]),
        short(found.velocity_range[1]),
        short(found.largest_acceleration),
        found.reversals,
        short(found.distance),
        found.rest_s
    );
    let speeds: Vec<String> = found.speeds.iter().copied().map(short).collect();
    text += &match speeds.as_slice() {
        [] => "speeds held for 50 ms or more: none\n".to_owned(),
        speeds => {
            format!(
                "speeds held for 50 ms or more: {} ({} {speed})\n",
                speeds.len(),
                speeds.join(", ")
            )
        }
    };
    if let Some(travel) = found.amplitude {
        text += &format!(
            "travel between reversals: {} to {} {m}, median {} {m}\n",
            short(travel.least),
            short(travel.largest),
            short(travel.median)
        );
    }
    let noises = [("encoder", m, found.encoder_noise), ("force cell", n, found.force_cell_noise)];
    for (name, unit, noise) in noises {
        let Some(noise) = noise else { continue };
        let declared = noise.declared.map_or_else(
            || "no model declares how much it should be".into(),
            |declared| format!("{} {unit} is declared", short(declared)),
        );
        text += &format!("noise of the {name}: {} {unit} rms, {declared}\n", short(noise.present));
    }
    let unusable =
        |judgement: &&Judgement| matches!(judgement.answer, Err(Obstacle::Unusable { .. }));
    if let Some(judgement) = found.judgements.iter().find(unusable) {
        text += &format!("nothing can be identified: {}\n", judgement.words(joint));
    }
    for judgement in found.judgements.iter().filter(|judgement| !unusable(judgement)) {
        let verdict =
            if judgement.possible() { "can be identified" } else { "cannot be identified" };
        text +=
            &format!("{}: {verdict} ({})\n", subject(judgement.subject), judgement.words(joint));
    }
    for finding in &found.findings {
        text += &format!("{}: {}\n", severity(finding.severity()), finding.words(joint));
    }
    text
}

/// What an import wrote into the bag `out`, and what was left out.
pub fn import_text(report: &ImportReport) -> String {
    let topics: Vec<String> =
        report.messages.iter().map(|(topic, count)| format!("{count} on {topic}")).collect();
    let mut text =
        format!("{}: {} rows, {}\n", report.bag.display(), report.rows, topics.join(", "));
    if report.without_time > 0 {
        text += &format!(
            "warning: {} rows without a time, or with one before the first, are left out\n",
            report.without_time
        );
    }
    for note in &report.notes {
        text += &format!("warning: {}\n", note.words(JointType::default()));
    }
    if report.not_later > 0 {
        text += &format!(
            "warning: {} rows have a time that is not after that of the row before: was a clock \
             set back, or are the times too coarse?\n",
            report.not_later
        );
    }
    if report.moved_s > 0.0 {
        text += &format!(
            "the times begin at {} s; a bag holds none before 0, so they are moved to begin \
             there\n",
            -report.moved_s
        );
    }
    text
}

/// What a table looks like and what is proposed for it.
pub fn proposal_text(proposal: &Proposal, file: &Path, written: Option<&Path>) -> String {
    let mark = if proposal.decimal_comma { "comma" } else { "point" };
    let either = if proposal.either_decimal { " (or the other: CHECK)" } else { "" };
    let line = |what: &str, line: Option<u64>| {
        line.map_or(format!("no {what}"), |line| format!("{what} in line {line}"))
    };
    let mut text = if proposal.is_of_arrays() {
        format!("{}: arrays ({})\n", file.display(), proposal.format)
    } else {
        format!(
            "{}: {} between columns, decimal {mark}{either}, {}, {}, values from line {}\n",
            file.display(),
            proposal.delimiter,
            line("names", proposal.names_line),
            line("units", proposal.units_line),
            proposal.data_line
        )
    };
    let rate = proposal.rate_hz.map_or(String::new(), |rate| format!(", {} Hz", short(rate)));
    text += &format!("{} rows looked at{rate}\n\n", proposal.rows);
    text += "  column  signal              from       to         unit   name\n";
    for column in &proposal.columns {
        let value = |value: Option<f64>| value.map_or("-".to_owned(), short);
        text += &format!(
            "  {:>6}  {:<18}  {:<9}  {:<9}  {:<5}  {}\n",
            column.number,
            column.signal.map_or("-", |signal| signal.name()),
            value(column.smallest),
            value(column.largest),
            if column.unit.is_empty() { "-".into() } else { in_line(&column.unit) },
            in_line(&column.name)
        );
    }
    if !proposal.not_used.is_empty() {
        text += &format!("not used: {}\n", proposal.not_used.join(", "));
    }
    for (what, check) in proposal.checks() {
        text += &format!("check {what}: {check}\n");
    }
    if let Some(path) = written {
        let then =
            if proposal.has_motion() { "when it is right" } else { "fill in the motion, then" };
        text += &format!(
            "\n{path} is written; {then}:\n  friction-stage import {} --mapping {path} \
             --out BAG\n",
            file.display(),
            path = path.display()
        );
    }
    text
}

/// What a recovery found and kept; without a line feed at the end.
pub fn recover_text(report: &RecoverReport) -> String {
    let Some(output) = &report.output else {
        return format!(
            "{} is whole: {} messages, nothing to recover",
            report.source.display(),
            report.messages
        );
    };
    let mut text = format!("{} -> {}\n", report.source.display(), output.display());
    for damage in &report.damage {
        text += &format!("  {}; {} bytes dropped\n", in_one(&place(damage)), damage.bytes);
    }
    let names: Vec<_> = report.topics.iter().map(|topic| in_line(&topic.name)).collect();
    let width = names.iter().map(|name| name.chars().count()).max().unwrap_or(0);
    for (topic, name) in report.topics.iter().zip(&names) {
        text += &format!("  {name:width$}  {:>9} messages kept", topic.messages);
        if let Some(last) = topic.last_log_time {
            text += &format!(", the last at {:.6} s", last as f64 * 1e-9);
        }
        text.push('\n');
    }
    let _ =
        write!(text, "{} messages kept, {} bytes dropped", report.messages, report.bytes_dropped);
    if let Some(hole) = report.longest_hole_s {
        text += &format!(", a hole of {hole:.3} s inside");
    }
    if let Some(lost) = report.lost_at_end_s {
        text += &format!(", if the recorder was killed, at most {lost} s before it are missing");
    }
    text
}
