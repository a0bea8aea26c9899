//! Samples in the order of time, each stamp once.

use super::data_quality::SignalQuality;
use super::error::SignalError;
use super::source::Stream;

/// A clock that goes back by more than this, ns, is another run, not a late message.
const LATEST_NS: i64 = 1_000_000_000;
/// Largest time stamp, ns: differences of two still fit 64 bits.
const LARGEST_NS: u64 = 1 << 62;

/// Samples in the order of time, each stamp once, with the account of it.
pub(crate) struct Ordered {
    pub stamps: Vec<i64>,
    pub values: Vec<Vec<f64>>,
    pub quality: Vec<SignalQuality>,
}

/// Puts samples in order and drops repeated stamps. Values that are not finite stay as NaN.
pub(crate) fn order(stream: Stream) -> Result<Ordered, SignalError> {
    let Stream { signals, places, mut stamps, mut values, .. } = stream;
    let samples = stamps.len() as u64;
    let (mut backward, mut latest) = (0, i64::MIN);
    for (index, &stamp) in stamps.iter().enumerate() {
        let clock = |reason: String| SignalError::Clock {
            signal: signals.first().map_or("", |s| s.name()),
            place: places.first().cloned().unwrap_or_default(),
            reason,
        };
        if stamp.unsigned_abs() > LARGEST_NS {
            return Err(clock(format!("sample {} has none, or one beyond 146 years", index + 1)));
        }
        if latest > i64::MIN && latest.saturating_sub(stamp) > LATEST_NS {
            return Err(clock(format!(
                "they go back by {:.3} s at sample {} of {samples}: these are several runs, or the \
                 clock was set; split the recording, or, in a bag, take the time of recording \
                 (`stamp: log_time` in a mapping)",
                latest.saturating_sub(stamp) as f64 * 1e-9,
                index + 1
            )));
        }
        backward += u64::from(stamp < latest);
        latest = latest.max(stamp);
    }
    if backward > 0 {
        let mut by_time: Vec<u32> = (0..stamps.len() as u32).collect();
        by_time.sort_by_key(|&i| stamps[i as usize]);
        stamps = by_time.iter().map(|&i| stamps[i as usize]).collect();
        for column in &mut values {
            *column = by_time.iter().map(|&i| column[i as usize]).collect();
        }
    }
    let mut quality: Vec<SignalQuality> = signals
        .iter()
        .zip(places)
        .zip(&values)
        .map(|((&signal, place), column)| SignalQuality {
            signal,
            place,
            samples,
            not_finite: column.iter().filter(|v| !v.is_finite()).count() as u64,
            repeated: 0,
            conflicting: 0,
            out_of_order: backward,
            interval_s: f64::NAN,
            jitter_s: None,
            missing: 0,
            filled: 0,
            gaps: 0,
            longest_interval_s: f64::NAN,
            coverage: 0.0,
            noise: None,
        })
        .collect();
    let mut kept = 0;
    for index in 0..stamps.len() {
        if kept > 0 && stamps[index] == stamps[kept - 1] {
            for (column, quality) in values.iter_mut().zip(&mut quality) {
                quality.repeated += 1;
                let (first, again) = (column[kept - 1], column[index]);
                quality.conflicting +=
                    u64::from(first.is_finite() && again.is_finite() && first != again);
                if !first.is_finite() {
                    column[kept - 1] = again;
                }
            }
            continue;
        }
        stamps[kept] = stamps[index];
        for column in &mut values {
            column[kept] = column[index];
        }
        kept += 1;
    }
    stamps.truncate(kept);
    for column in &mut values {
        column.truncate(kept);
        for value in column.iter_mut().filter(|v| !v.is_finite()) {
            *value = f64::NAN;
        }
    }
    Ok(Ordered { stamps, values, quality })
}
