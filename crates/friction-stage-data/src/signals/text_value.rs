//! What a field of a text table says: a number, a time, nothing, or words.
//!
//! Numbers may have a decimal comma and marks between thousands; times may be ISO 8601, a date as a
//! spreadsheet or a logger writes it, a time of day, or a duration.

use std::borrow::Cow;

use chrono::NaiveDate;

/// What a number looks like.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decimal {
    /// 1234.5, also 1,234.5.
    Point,
    /// 1234,5, also 1.234,5.
    Comma,
}

impl Decimal {
    /// The one that it is not.
    pub(super) fn other(self) -> Decimal {
        match self {
            Decimal::Point => Decimal::Comma,
            Decimal::Comma => Decimal::Point,
        }
    }
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

/// Words for a missing value. Words for a value out of range are not among them: a fit must not
/// ignore such a value unnoticed.
const MISSING: [&str; 14] = [
    "", "na", "n/a", "n.a.", "null", "none", "nil", "missing", "-", "--", "---", "nan", "nat", "?",
];

impl Value {
    pub fn of(field: &[u8], decimal: Decimal) -> Value {
        let Ok(text) = std::str::from_utf8(field) else { return Value::of_marked(field, decimal) };
        let text = &*with_plain_minus(text.trim());
        if let Some((value, marked)) = number(text, decimal) {
            return Value::Number { value, marked };
        }
        if is_missing(text) {
            return Value::Missing;
        }
        match time(text) {
            Some((nanoseconds, has_date)) => Value::Time { nanoseconds, has_date },
            None => Value::Text,
        }
    }

    /// As [`Value::of`]; the words `missing` stand for no value, too.
    pub fn among(field: &[u8], decimal: Decimal, missing: &[String]) -> Value {
        let is_word = |word: &String| word.as_bytes().eq_ignore_ascii_case(field.trim_ascii());
        if missing.iter().any(is_word) { Value::Missing } else { Value::of(field, decimal) }
    }

    /// A number with no-break spaces of Latin-1 between its thousands, or with the dash of Windows
    /// for a minus.
    fn of_marked(field: &[u8], decimal: Decimal) -> Value {
        let plain = |byte: u8| match byte {
            0xa0 => b' ',
            0x96 => b'-',
            byte => byte,
        };
        let plain: Vec<u8> = field.iter().copied().map(plain).collect();
        if plain.is_ascii() { Value::of(&plain, decimal) } else { Value::Text }
    }

    /// Whether it is a number or a time.
    pub fn is_value(&self) -> bool {
        matches!(self, Value::Number { .. } | Value::Time { .. })
    }
}

/// A text with `-` where a typographic minus stands, or the dash that is taken for one.
fn with_plain_minus(text: &str) -> Cow<'_, str> {
    const MINUS: [char; 4] = ['\u{2212}', '\u{2013}', '\u{fe63}', '\u{ff0d}'];
    if text.is_ascii() || !text.contains(MINUS) {
        return Cow::Borrowed(text);
    }
    Cow::Owned(text.replace(MINUS, "-"))
}

/// Whether a text says that there is no value: a word for it, also in brackets (`<NA>`, `(null)`);
/// what C libraries write for what is no number (`-1.#IND`, `nan(ind)`); or an error of a
/// spreadsheet, which begins with `#` in every language (`#DIV/0!`, `#WERT!`, `####`).
fn is_missing(text: &str) -> bool {
    let is_word = |text: &str| MISSING.iter().any(|word| word.eq_ignore_ascii_case(text));
    if is_word(text) {
        return true;
    }
    let inside = |open, close| text.strip_prefix(open)?.strip_suffix(close);
    let brackets = inside('<', '>').or_else(|| inside('(', ')')).or_else(|| inside('[', ']'));
    if brackets.is_some_and(|text| !text.is_empty() && is_word(text.trim())) {
        return true;
    }
    if let Some(error) = text.strip_prefix('#') {
        return !error.starts_with(|c: char| c.is_ascii_digit() || c.is_whitespace());
    }
    let unsigned = text.strip_prefix(['+', '-']).unwrap_or(text).to_ascii_lowercase();
    let is_nan = unsigned
        .strip_prefix("nan")
        .is_some_and(|rest| rest.is_empty() || rest.starts_with('(') && rest.ends_with(')'));
    is_nan || of_c_library(&unsigned).is_some_and(|word| !word.starts_with("inf"))
}

/// The word of `1.#QNAN` or `1.#INF00`.
fn of_c_library(unsigned: &str) -> Option<&str> {
    let word = unsigned.strip_prefix("1.#").or_else(|| unsigned.strip_prefix("1,#"))?;
    let words = ["inf", "ind", "nan", "qnan", "snan"];
    words.contains(&word.trim_end_matches('0')).then_some(word)
}

/// A number with a power of ten as Fortran writes it, `1.5D-03`, with an `e` for it. Without the
/// sign it could be a hexadecimal one.
fn with_plain_exponent(text: &str) -> Option<String> {
    let (mantissa, exponent) = text.split_once(['d', 'D'])?;
    let digits = exponent.strip_prefix(['+', '-'])?;
    let is_one = mantissa.ends_with(|c: char| c.is_ascii_digit() || matches!(c, '.' | ','))
        && !digits.is_empty()
        && digits.bytes().all(|byte| byte.is_ascii_digit());
    is_one.then(|| format!("{mantissa}e{exponent}"))
}

/// A number, and whether it has a point or comma.
fn number(text: &str, decimal: Decimal) -> Option<(f64, bool)> {
    let (mark, thousands) = match decimal {
        Decimal::Point => ('.', ','),
        Decimal::Comma => (',', '.'),
    };
    let unsigned = text.trim_start_matches(['+', '-']);
    let is_infinite = |text: &str| {
        ["inf", "infinity", "\u{221e}"].iter().any(|word| word.eq_ignore_ascii_case(text))
    };
    let is_of_c_library = || {
        unsigned.contains('#')
            && of_c_library(&unsigned.to_ascii_lowercase()).is_some_and(|w| w.starts_with("inf"))
    };
    if is_infinite(unsigned) || is_of_c_library() {
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
        return (!value.is_nan()).then_some((value, marked));
    }
    if let Some(plain) = with_plain_exponent(text) {
        return number(&plain, decimal);
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
    let value: f64 = plain.parse().ok()?;
    (!value.is_nan()).then_some((value, marked))
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
/// No recording is longer, days.
const CENTURY: i64 = 36_525;
/// So many minutes are written as hours, if not before: a day.
const MINUTES: i64 = 1_440;

/// A time, ns since 1970 or since midnight, and whether it has a date, or is a duration in days:
/// then it does not begin again at midnight.
fn time(text: &str) -> Option<(i64, bool)> {
    // Most fields are none.
    if !text.starts_with(|c: char| c.is_ascii_digit() || c == '-') {
        return None;
    }
    // A duration as MATLAB writes it.
    if let Some(seconds) = text.strip_suffix(" sec") {
        let (sign, seconds) = match seconds.strip_prefix('-') {
            Some(seconds) => (-1, seconds),
            None => (1, seconds),
        };
        let (whole, part) = seconds.split_once('.').unwrap_or((seconds, "0"));
        let whole: i64 = whole.parse().ok().filter(|whole| *whole < CENTURY * 86_400)?;
        return Some((sign * (whole * SECOND + nanoseconds(&format!("0.{part}"))?), true));
    }
    if !text.contains(':') {
        return None;
    }
    if let Some(duration) = duration(text) {
        return Some((duration, true));
    }
    if text.starts_with('-') {
        return None;
    }
    let splits = [text.split_once(' '), text.split_once(['T', 't'])];
    let dated = splits.into_iter().flatten().find(|(date, _)| !date.contains(':'));
    let (date, clock) = match dated {
        Some((date, clock)) => (Some(date), clock.trim()),
        None => (None, text),
    };
    let (clock, zone) = split_zone(clock)?;
    let (clock, half) = split_half(clock);
    let (hours, minutes, seconds) = match clock.split(':').collect::<Vec<_>>().as_slice() {
        // A spreadsheet shows `00:01,5` for minutes and seconds; hours have no fraction.
        [minutes, seconds] if date.is_none() && half.is_none() && seconds.contains(['.', ',']) => {
            let minutes = minutes.parse().ok().filter(|minutes| (0..MINUTES).contains(minutes))?;
            return Some((minutes * 60 * SECOND + nanoseconds(seconds)?, false));
        }
        [hours, minutes] => (*hours, *minutes, 0),
        [hours, minutes, seconds] => (*hours, *minutes, nanoseconds(seconds)?),
        // Two digits behind the third colon count frames of a film, of unknown length.
        [hours, minutes, seconds, fraction] if [3, 6, 9].contains(&fraction.len()) => {
            let seconds = format!("{seconds}.{fraction}");
            (*hours, *minutes, nanoseconds(&seconds)?)
        }
        _ => return None,
    };
    let hours: i64 = hours.trim().parse().ok()?;
    let minutes: i64 = minutes.trim().parse().ok()?;
    if !(0..24).contains(&hours) || !(0..60).contains(&minutes) {
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

/// A duration of days and a time, `-1 days +23:59:59.5`, ns.
fn duration(text: &str) -> Option<i64> {
    let (days, clock) = text.split_once("day")?;
    let days: i64 =
        days.trim_end().parse().ok().filter(|days| (-CENTURY..CENTURY).contains(days))?;
    let clock = clock.strip_prefix('s').unwrap_or(clock).trim_start_matches([',', ' ', '+']);
    let parts: Vec<&str> = clock.split(':').collect();
    let &[hours, minutes, seconds] = parts.as_slice() else { return None };
    let (hours, minutes): (i64, i64) = (hours.parse().ok()?, minutes.parse().ok()?);
    if !(0..24).contains(&hours) || !(0..60).contains(&minutes) {
        return None;
    }
    Some(days * DAY + (hours * 60 + minutes) * 60 * SECOND + nanoseconds(seconds)?)
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

/// The month of a name, by its first three letters in English or German.
fn month_named(name: &str) -> Option<u32> {
    const MONTHS: [&str; 12] = [
        "jan",
        "feb",
        "mar mär mrz",
        "apr",
        "may mai",
        "jun",
        "jul",
        "aug",
        "sep",
        "oct okt",
        "nov",
        "dec dez",
    ];
    let short: String = name.to_lowercase().chars().take(3).collect();
    let is_one = |names: &&str| names.split(' ').any(|known| known == short);
    let place = MONTHS.iter().position(is_one)?;
    u32::try_from(place + 1).ok()
}

/// Days since 1970 of a date: year first; or day, month, year with points; or with strokes, the
/// month first unless it can be none; or with the name of the month between day and year.
fn day(date: &str) -> Option<i64> {
    let separator = date.chars().find(|c| !c.is_ascii_digit())?;
    let texts: Vec<&str> = date.split(separator).collect();
    let named = texts.get(1).and_then(|month| month_named(month));
    let number = |(at, text): (usize, &&str)| match named {
        Some(month) if at == 1 => Some(month),
        _ => text.parse().ok(),
    };
    let parts: Vec<u32> = texts.iter().enumerate().map(number).collect::<Option<_>>()?;
    let &[first, second, third] = parts.as_slice() else { return None };
    let (year, month, day) = match separator {
        '-' | '/' | '.' if named.is_some() && texts[0].len() < 4 => (third, second, first),
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
            ("\u{2212}0,007", Comma, Some(-0.007)),
            ("\u{2212}1.5e\u{2212}3", Point, Some(-1.5e-3)),
            ("\u{2013}2", Point, Some(-2.0)),
            ("-6.605243D-03", Point, Some(-6.605243e-3)),
            ("1,25d+02", Comma, Some(125.0)),
            // A hexadecimal number, or a name.
            ("1D5", Point, None),
            ("1.#INF", Point, Some(f64::INFINITY)),
            ("-1,#INF00", Comma, Some(f64::NEG_INFINITY)),
            ("-\u{221e}", Point, Some(f64::NEG_INFINITY)),
        ] {
            assert_eq!(number_of(text, decimal), value, "{text} {decimal:?}");
        }
        assert_eq!(
            Value::of(b"1\xa0234,5", Decimal::Comma),
            Value::Number { value: 1234.5, marked: true }
        );
        assert_eq!(
            Value::of(b"\x961,5", Decimal::Comma),
            Value::Number { value: -1.5, marked: true }
        );
        for word in ["", "NaN", "n/a", "NULL", "--", " "] {
            assert_eq!(Value::of(word.as_bytes(), Point), Value::Missing, "{word}");
        }
    }

    #[test]
    fn what_programs_write_for_no_number_is_missing() {
        for word in [
            "1.#QNAN",
            "-1.#IND",
            "1,#QNAN0",
            "1.#SNAN",
            "nan(ind)",
            "-nan",
            "-nan(snan)",
            "<NA>",
            "(null)",
            "[None]",
            "NaT",
            "?",
            "#DIV/0!",
            "#WERT!",
            "#NAME?",
            "#NV",
            "#\u{a1}VALOR!",
            "####",
            "\u{2013}",
        ] {
            for decimal in [Decimal::Point, Decimal::Comma] {
                assert_eq!(Value::of(word.as_bytes(), decimal), Value::Missing, "{word}");
            }
        }
        // Values that were there, numbers of things, and words.
        for word in ["OverRange", "overload", "#12", "# t", "nano", "<x>", "1.#ABC", "()"] {
            assert_eq!(Value::of(word.as_bytes(), Decimal::Point), Value::Text, "{word}");
        }
        let over = ["OverRange".to_owned(), "-9999".to_owned()];
        for word in ["overrange", "-9999", " OverRange "] {
            let value = Value::among(word.as_bytes(), Decimal::Point, &over);
            assert_eq!(value, Value::Missing, "{word}");
        }
        assert_eq!(Value::among(b"OverRang", Decimal::Point, &over), Value::Text);
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
            ("10:00:00:001", 36_000_001_000_000),
            ("10:00:00:001500", 36_000_001_500_000),
            ("10:00:00:000000007", 36_000_000_000_007),
            ("00:01,5", 1_500_000_000),
            ("59:30.001", 3_570_001_000_000),
            ("60:00.5", 3_600_500_000_000),
        ] {
            let read = Value::of(text.as_bytes(), Decimal::Point);
            assert_eq!(read, Value::Time { nanoseconds, has_date: false }, "{text}");
        }
        for (text, nanoseconds) in [
            ("0 days 00:00:00.001000", 1_000_000),
            ("1 day, 0:00:01", 86_401_000_000_000),
            ("-1 days +23:59:59.5", -500_000_000),
        ] {
            let read = Value::of(text.as_bytes(), Decimal::Point);
            assert_eq!(read, Value::Time { nanoseconds, has_date: true }, "{text}");
        }
        for text in [
            "25:00:00",
            "10:61:00",
            "2024-13-01T10:00:00",
            "10:00:00:00",
            "10:00:00:0001",
            "10:00:00.5:001",
            "1:2:x",
            "1440:00.5",
            "12:30.5 PM",
            "-5:00.5",
            "-10:00:00",
            "99999999 days 00:00:00",
        ] {
            assert_eq!(Value::of(text.as_bytes(), Decimal::Point), Value::Text, "{text}");
        }
    }
}
