//! What a field of a text table says: a number, a time, nothing, or words.
//!
//! Numbers may have a decimal comma and marks between thousands; times may be ISO 8601, a date as a
//! spreadsheet or a logger writes it, or a time of day.

use chrono::NaiveDate;

/// What a number looks like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decimal {
    /// 1234.5, also 1,234.5.
    Point,
    /// 1234,5, also 1.234,5.
    Comma,
}

/// What a field says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Value {
    /// A number; `marked` where it has a point or comma, which another reading takes otherwise.
    Number {
        value: f64,
        marked: bool,
    },
    /// A time, ns, and whether it has a date.
    Time {
        nanoseconds: i64,
        has_date: bool,
    },
    /// No value: nothing, or a word that says so.
    Missing,
    Text,
}

/// Words for a value that is not there.
const MISSING: [&str; 13] =
    ["", "na", "n/a", "#n/a", "#na", "null", "none", "nil", "missing", "-", "--", "---", "nan"];

impl Value {
    pub fn of(field: &[u8], decimal: Decimal) -> Value {
        let Ok(text) = std::str::from_utf8(field) else { return Value::of_marked(field, decimal) };
        let text = text.trim();
        if let Some((value, marked)) = number(text, decimal) {
            return Value::Number { value, marked };
        }
        if MISSING.iter().any(|word| word.eq_ignore_ascii_case(text)) {
            return Value::Missing;
        }
        match time(text) {
            Some((nanoseconds, has_date)) => Value::Time { nanoseconds, has_date },
            None => Value::Text,
        }
    }

    /// A number with no-break spaces of Latin-1 between its thousands.
    fn of_marked(field: &[u8], decimal: Decimal) -> Value {
        let plain: Vec<u8> =
            field.iter().copied().map(|b| if b == 0xa0 { b' ' } else { b }).collect();
        if plain.is_ascii() { Value::of(&plain, decimal) } else { Value::Text }
    }

    /// Whether it is a number or a time.
    pub fn is_value(&self) -> bool {
        matches!(self, Value::Number { .. } | Value::Time { .. })
    }
}

/// A number, and whether it has a point or comma.
fn number(text: &str, decimal: Decimal) -> Option<(f64, bool)> {
    let (mark, thousands) = match decimal {
        Decimal::Point => ('.', ','),
        Decimal::Comma => (',', '.'),
    };
    let unsigned = text.trim_start_matches(['+', '-']);
    if ["inf", "infinity"].iter().any(|word| word.eq_ignore_ascii_case(unsigned)) {
        let sign = if text.starts_with('-') { -1.0 } else { 1.0 };
        return Some((sign * f64::INFINITY, false));
    }
    let begins_like_one = |c: char| c.is_ascii_digit() || matches!(c, '+' | '-' | '.' | ',');
    if !text.starts_with(begins_like_one) {
        return None;
    }
    let marked = text.contains(['.', ',']);
    if decimal == Decimal::Point
        && let Ok(value) = text.parse::<f64>()
    {
        return Some((value, marked));
    }
    let (whole, fraction) = match text.split_once(mark) {
        Some((whole, fraction)) => (whole, Some(fraction)),
        None => (text, None),
    };
    let whole = without_thousands(whole, thousands)?;
    let plain = match fraction {
        Some(fraction) => format!("{whole}.{fraction}"),
        None => whole,
    };
    Some((plain.parse().ok()?, marked))
}

/// Digits without what stands between groups of three: `mark`, a blank or an apostrophe.
fn without_thousands(whole: &str, mark: char) -> Option<String> {
    let separators = [mark, ' ', '\u{a0}', '\u{202f}', '\'', '\u{2019}'];
    let Some(separator) = separators.into_iter().find(|c| whole.contains(*c)) else {
        return Some(whole.to_owned());
    };
    let sign = whole.len() - whole.trim_start_matches(['+', '-']).len();
    let groups: Vec<&str> = whole[sign..].split(separator).collect();
    let digits = |group: &&str| group.bytes().all(|byte| byte.is_ascii_digit());
    // A leading zero is no thousands: 0.125.
    let first = (1..=3).contains(&groups[0].len()) && !groups[0].starts_with('0');
    let others = groups[1..].iter().all(|group| group.len() == 3);
    (first && others && groups.iter().all(digits))
        .then(|| format!("{}{}", &whole[..sign], groups.concat()))
}

const SECOND: i64 = 1_000_000_000;
const DAY: i64 = 86_400 * SECOND;

/// A time, ns since 1970 or since midnight, and whether it has a date.
fn time(text: &str) -> Option<(i64, bool)> {
    // Most fields are none.
    if !text.starts_with(|c: char| c.is_ascii_digit()) || !text.contains(':') {
        return None;
    }
    let (date, clock) = match text.split_once(['T', 't', ' ']) {
        Some((date, clock)) if !date.contains(':') => (Some(date), clock.trim()),
        _ => (None, text),
    };
    let (clock, zone) = split_zone(clock)?;
    let (clock, half) = split_half(clock);
    let mut parts = clock.split(':');
    let hours: i64 = parts.next()?.trim().parse().ok()?;
    let minutes: i64 = parts.next()?.parse().ok()?;
    let seconds = parts.next().map_or(Some(0), nanoseconds)?;
    if parts.next().is_some() || !(0..24).contains(&hours) || !(0..60).contains(&minutes) {
        return None;
    }
    let hours = match half {
        None => hours,
        Some(shift) if (1..=12).contains(&hours) => hours % 12 + shift,
        Some(_) => return None,
    };
    let of_day = (hours * 60 + minutes) * 60 * SECOND + seconds - zone;
    match date {
        None => Some((of_day, false)),
        Some(date) => Some((day(date)?.checked_mul(DAY)?.checked_add(of_day)?, true)),
    }
}

/// The time before `Z` or `+02:00`, and how far the zone is ahead, ns.
fn split_zone(clock: &str) -> Option<(&str, i64)> {
    if let Some(clock) = clock.strip_suffix(['Z', 'z']) {
        return Some((clock, 0));
    }
    let Some(at) = clock.rfind(['+', '-']) else { return Some((clock, 0)) };
    let digits: String = clock[at + 1..].chars().filter(|c| *c != ':').collect();
    if !digits.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let (hours, minutes) = match digits.len() {
        2 => (digits.parse::<i64>().ok()?, 0),
        4 => (digits[..2].parse().ok()?, digits[2..].parse().ok()?),
        _ => return None,
    };
    let ahead = (hours * 60 + minutes) * 60 * SECOND;
    Some((&clock[..at], if clock[at..].starts_with('-') { -ahead } else { ahead }))
}

/// The time before AM or PM, and the hours that this adds.
fn split_half(clock: &str) -> (&str, Option<i64>) {
    let upper = clock.to_ascii_uppercase();
    for (word, shift) in [("AM", 0), ("PM", 12)] {
        if upper.ends_with(word) {
            return (clock[..clock.len() - word.len()].trim_end(), Some(shift));
        }
    }
    (clock, None)
}

/// Seconds with a fraction, below 61, as ns; exact.
fn nanoseconds(seconds: &str) -> Option<i64> {
    let (whole, fraction) = seconds.split_once(['.', ',']).unwrap_or((seconds, ""));
    let seconds: i64 = whole.parse().ok()?;
    let is_digits = fraction.bytes().all(|byte| byte.is_ascii_digit());
    if !(0..=60).contains(&seconds) || !is_digits {
        return None;
    }
    let nine: String = fraction.chars().chain(std::iter::repeat('0')).take(9).collect();
    Some(seconds * SECOND + nine.parse::<i64>().ok()?)
}

/// Days since 1970 of a date: year first; or day, month, year with points; or with strokes, the
/// month first unless it can be none.
fn day(date: &str) -> Option<i64> {
    let separator = date.chars().find(|c| !c.is_ascii_digit())?;
    let parts: Vec<u32> =
        date.split(separator).map(|part| part.parse().ok()).collect::<Option<_>>()?;
    let &[first, second, third] = parts.as_slice() else { return None };
    let (year, month, day) = match separator {
        '-' | '/' | '.' if date.find(separator) == Some(4) => (first, second, third),
        '.' => (third, second, first),
        '-' | '/' if first > 12 => (third, second, first),
        '-' | '/' => (third, first, second),
        _ => return None,
    };
    let year = if year < 100 { 2000 + year } else { year };
    let date = NaiveDate::from_ymd_opt(i32::try_from(year).ok()?, month, day)?;
    Some((date - NaiveDate::default()).num_days())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number_of(text: &str, decimal: Decimal) -> Option<f64> {
        match Value::of(text.as_bytes(), decimal) {
            Value::Number { value, .. } => Some(value),
            _ => None,
        }
    }

    #[test]
    fn numbers_with_marks_between_thousands() {
        use Decimal::{Comma, Point};
        for (text, decimal, value) in [
            ("1.5", Point, Some(1.5)),
            ("-1e-3", Point, Some(-1e-3)),
            ("+.5", Point, Some(0.5)),
            ("1,234.5", Point, Some(1234.5)),
            ("-12,345,678", Point, Some(-12_345_678.0)),
            ("12,34", Point, None),
            ("0,123", Point, None),
            ("1'234.5", Point, Some(1234.5)),
            ("1,5", Comma, Some(1.5)),
            ("68.368", Comma, Some(68_368.0)),
            ("1.234.567,25", Comma, Some(1_234_567.25)),
            ("0.125", Comma, None),
            ("68.36", Comma, None),
            ("1\u{a0}234,5", Comma, Some(1234.5)),
            ("1,5e-3", Comma, Some(1.5e-3)),
            ("1e999", Point, Some(f64::INFINITY)),
            ("inf", Point, Some(f64::INFINITY)),
            ("-Infinity", Comma, Some(f64::NEG_INFINITY)),
            ("1 2", Point, None),
        ] {
            assert_eq!(number_of(text, decimal), value, "{text} {decimal:?}");
        }
        assert_eq!(
            Value::of(b"1\xa0234,5", Decimal::Comma),
            Value::Number { value: 1234.5, marked: true }
        );
        for word in ["", "NaN", "n/a", "NULL", "--", " "] {
            assert_eq!(Value::of(word.as_bytes(), Point), Value::Missing, "{word}");
        }
    }

    #[test]
    fn times_are_read_to_the_nanosecond() {
        // Python: datetime(2024, 5, 1, 10, 0, 0, 1000, timezone.utc).timestamp()
        let first_of_may = 1_714_557_600_001_000_000;
        for text in [
            "2024-05-01T10:00:00.001Z",
            "2024-05-01 10:00:00,001",
            "2024-05-01T12:00:00.001+02:00",
            "2024/05/01 10:00:00.001000",
            "01.05.2024 10:00:00.001",
            "5/1/2024 10:00:00.001 AM",
        ] {
            let read = Value::of(text.as_bytes(), Decimal::Point);
            assert_eq!(read, Value::Time { nanoseconds: first_of_may, has_date: true }, "{text}");
        }
        for (text, nanoseconds) in [
            ("10:00:00.001", 36_000_001_000_000),
            ("00:00:00.000000001", 1),
            ("12:30 PM", 45_000_000_000_000),
            ("23:59:59", 86_399_000_000_000),
        ] {
            let read = Value::of(text.as_bytes(), Decimal::Point);
            assert_eq!(read, Value::Time { nanoseconds, has_date: false }, "{text}");
        }
        for text in ["25:00:00", "10:61:00", "2024-13-01T10:00:00", "10:00:00:00", "1:2:x"] {
            assert_eq!(Value::of(text.as_bytes(), Decimal::Point), Value::Text, "{text}");
        }
    }
}
