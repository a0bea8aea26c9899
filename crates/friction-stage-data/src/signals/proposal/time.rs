//! The time of a table: units, two columns that are one time, and rates in lines above it.

use super::TableColumn;
use super::series::{increases, steps, usual_step};
use super::table::Samples;
use crate::signals::unit::{Dimension, Unit};

/// How many usual steps the step from one second to the next may be, where columns without names
/// are seconds and nanoseconds: of other parts of a whole it is 1000 and more. Assumed.
const CARRY: f64 = 100.0;

/// What some programs count times in, s.
pub(super) const TICK: f64 = 1e-7;

/// What makes ticks of 100 ns times since 1970, s, where numbers are as large as those from 1970 to
/// 2120: since 1601, as Windows counts, or since the year 1, as .NET does.
pub(super) fn offset_of_ticks(values: &[f64]) -> Option<f64> {
    let first = values.iter().copied().find(|value| value.is_finite())?;
    [-11_644_473_600.0, -62_135_596_800.0].into_iter().find(|offset| {
        let since_1970 = first * TICK + offset;
        (0.0..150.0 * 31_556_952.0).contains(&since_1970)
    })
}

/// Unit of times, by how large they are: since 1970, days of a spreadsheet or of MATLAB, else by
/// their steps.
pub(super) fn unit_of_epoch(values: &[f64]) -> &'static str {
    // Assumed: a motion is sampled with 20 Hz to 1 MHz.
    const SLOWEST: f64 = 0.05;
    const FASTEST: f64 = 1e-6;
    let first = values.iter().copied().find(|value| value.is_finite()).unwrap_or(0.0);
    let step = usual_step(values).map_or(0.0, f64::abs);
    match first {
        // From 2001 to 2286 in each unit.
        first if (1e18..1e19).contains(&first) => "ns",
        first if (1e15..1e16).contains(&first) => "us",
        first if (1e12..1e13).contains(&first) => "ms",
        first if (1e9..1e10).contains(&first) => "s",
        // From 1982 to 2119, counted from 1900, or from 1943 to 2107, counted from the year 0.
        first if (30_000.0..80_000.0).contains(&first) && step < 1e-3 => "d",
        first if (710_000.0..770_000.0).contains(&first) && step < 1e-3 => "d",
        // A part of a day.
        _ if step > 0.0 && step < FASTEST => "d",
        _ if step <= SLOWEST => "s",
        _ if step * 1e-3 <= SLOWEST => "ms",
        _ if step * 1e-6 <= SLOWEST => "us",
        _ => "ns",
    }
}

/// Numbers of the columns of seconds and of nanoseconds that are one time, as messages of ROS have
/// it: of the same name but for the word for the unit, with whole numbers below 10^9.
pub(super) fn split_time(columns: &[TableColumn], samples: &[Samples]) -> Option<(usize, usize)> {
    const SECONDS: &[&str] = &["seconds", "secs", "sec", "s"];
    const NANOSECONDS: &[&str] = &["nanoseconds", "nanosecs", "nanosec", "nsecs", "nsec", "nanos"];
    let stem = |column: &TableColumn, words: &[&str]| {
        let name = column.name.trim().to_lowercase();
        let stem = words.iter().find_map(|word| name.strip_suffix(word)).map(str::to_owned)?;
        stem.chars().next_back().is_none_or(|c| !c.is_alphanumeric()).then_some(stem)
    };
    let values = |column: &TableColumn| samples[column.number - 1].values.as_slice();
    let is_whole = |value: &f64| value.is_nan() || value.fract() == 0.0;
    let is_part = |value: &f64| value.is_nan() || is_whole(value) && (0.0..1e9).contains(value);
    // Without names they stand next to each other, and the one begins again as the other goes on.
    let begins_again = |whole: &TableColumn, part: &TableColumn| {
        let joined = joined_time(values(whole), values(part));
        let usual = usual_step(&joined).unwrap_or(f64::NAN);
        let steps = || steps(values(whole)).zip(steps(values(part))).zip(steps(&joined));
        steps().all(|((whole, part), _)| (whole > 0.0) == (part < 0.0))
            && steps().all(|((whole, _), joined)| whole <= 0.0 || joined < CARRY * usual)
    };
    columns.iter().find_map(|part| {
        let named = stem(part, NANOSECONDS);
        if named.is_none() && !part.name.is_empty() {
            return None;
        }
        let is_seconds = |whole: &&TableColumn| match part.name.is_empty() {
            true => {
                whole.name.is_empty()
                    && whole.number + 1 == part.number
                    && whole.smallest < whole.largest
                    && begins_again(whole, part)
            }
            false => stem(whole, SECONDS) == named,
        };
        let whole = columns.iter().find(is_seconds)?;
        let is_time = increases(&joined_time(values(whole), values(part)));
        let fit = values(whole).iter().all(is_whole) && values(part).iter().all(is_part);
        (fit && is_time).then_some((whole.number, part.number))
    })
}

/// Times, s since the first whole second, of whole seconds and the nanoseconds next to them.
pub(super) fn joined_time(whole: &[f64], part: &[f64]) -> Vec<f64> {
    let first = whole.iter().copied().find(|value| value.is_finite()).unwrap_or(0.0);
    whole.iter().zip(part).map(|(whole, part)| whole - first + 1e-9 * part).collect()
}

/// Rows per second given by a settings line, and whether the line mentions samples: it has one
/// number, and a word for a rate or for a sampling interval.
pub(super) fn rate_in(line: &str, decimal_comma: bool) -> Option<(f64, bool)> {
    const RATE: &[&str] = &[
        "rate",
        "samplerate",
        "frequency",
        "frequenz",
        "abtastrate",
        "fs",
        "abtastfrequenz",
        "frequence",
        "frecuencia",
    ];
    const INTERVAL: &[&str] = &[
        "interval",
        "increment",
        "period",
        "intervall",
        "periode",
        "abtastzeit",
        "dt",
        "deltax",
        "deltat",
        "sampletime",
        "samplingtime",
        "timestep",
        "schrittweite",
        "zykluszeit",
        "cycletime",
    ];
    let line = line.to_lowercase();
    let line = if decimal_comma { line.replace(',', ".") } else { line };
    let fields: Vec<&str> =
        line.split(|c: char| ",;\t:= []()\"|#%_".contains(c)).filter(|f| !f.is_empty()).collect();
    let pairs: Vec<String> = fields.windows(2).map(<[&str]>::concat).collect();
    let says = |known: &[&str]| {
        fields.iter().copied().chain(pairs.iter().map(String::as_str)).any(|f| known.contains(&f))
    };
    let is_interval = says(INTERVAL);
    if !is_interval && !says(RATE) {
        return None;
    }
    // One for each column says the same.
    let mut numbers: Vec<f64> = fields.iter().filter_map(|field| field.parse().ok()).collect();
    numbers.dedup();
    let [number] = numbers.as_slice() else { return None };
    let unit = fields.iter().find_map(|field| {
        Some(match *field {
            "hz" | "sa/s" | "s/s" | "1/s" => 1.0,
            "khz" | "ks/s" | "ksa/s" => 1e3,
            "mhz" | "ms/s" => 1e6,
            other => Unit::named(other).filter(|unit| unit.dimension == Dimension::Time)?.size,
        })
    });
    let size = unit.unwrap_or(1.0) * number;
    let rate = if is_interval { 1.0 / size } else { size };
    // Assumed: no motion is recorded outside of these.
    let of_samples = ["sampl", "abtast", "scan", "delta", "increment"];
    let is_of_samples = of_samples.iter().any(|word| line.contains(word));
    (1.0..1e7).contains(&rate).then_some((rate, is_of_samples))
}
