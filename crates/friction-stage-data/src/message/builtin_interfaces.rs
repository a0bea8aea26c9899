//! `builtin_interfaces`: time stamps and durations.

use serde::{Deserialize, Serialize};

use super::{Definition, RosMessage};

const NANOS: i64 = 1_000_000_000;

/// Splits nanoseconds into whole seconds (rounded down) and the rest in 0..1e9; beyond the range of
/// `i32` seconds the nearest representable value.
fn split(nanos: i64) -> (i32, u32) {
    match i32::try_from(nanos.div_euclid(NANOS)) {
        Ok(sec) => (sec, nanos.rem_euclid(NANOS) as u32),
        Err(_) if nanos > 0 => (i32::MAX, NANOS as u32 - 1),
        Err(_) => (i32::MIN, 0),
    }
}

fn join(sec: i32, nanosec: u32) -> i64 {
    i64::from(sec) * NANOS + i64::from(nanosec)
}

/// A point in time: seconds since the epoch of its clock (0 at start for simulated time).
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct Time {
    /// Whole seconds, rounded down: -1.7 s is `sec: -2, nanosec: 300_000_000`.
    pub sec: i32,
    /// Nanoseconds to add, 0..1e9.
    pub nanosec: u32,
}

impl Time {
    /// From nanoseconds; saturates at the range of `sec` (68 years).
    pub fn from_nanos(nanos: i64) -> Self {
        let (sec, nanosec) = split(nanos);
        Self { sec, nanosec }
    }

    /// In nanoseconds. A `nanosec` of 1e9 or more, which only a faulty peer sends, carries over.
    pub fn to_nanos(self) -> i64 {
        join(self.sec, self.nanosec)
    }
}

impl RosMessage for Time {
    const PACKAGE: &'static str = "builtin_interfaces";
    const NAME: &'static str = "Time";
    const TYPE_HASH: &'static str =
        "RIHS01_b106235e25a4c5ed35098aa0a61a3ee9c9b18d197f398b0e4206cea9acf9c197";
    const TEXT: &'static str = "int32 sec\nuint32 nanosec";
    const DEPENDENCIES: &'static [Definition] = &[];
}

/// A span of time, split as [`Time`].
#[derive(
    Debug, Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
)]
pub struct Duration {
    /// Whole seconds, rounded down.
    pub sec: i32,
    /// Nanoseconds to add, 0..1e9.
    pub nanosec: u32,
}

impl Duration {
    /// From nanoseconds; saturates at the range of `sec` (68 years).
    pub fn from_nanos(nanos: i64) -> Self {
        let (sec, nanosec) = split(nanos);
        Self { sec, nanosec }
    }

    /// In nanoseconds.
    pub fn to_nanos(self) -> i64 {
        join(self.sec, self.nanosec)
    }
}

impl RosMessage for Duration {
    const PACKAGE: &'static str = "builtin_interfaces";
    const NAME: &'static str = "Duration";
    const TYPE_HASH: &'static str =
        "RIHS01_e8d009f659816f758b75334ee1a9ca5b5c0b859843261f14c7f937349599d93b";
    const TEXT: &'static str = "int32 sec\nuint32 nanosec";
    const DEPENDENCIES: &'static [Definition] = &[];
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn negative_time_rounds_seconds_down() {
        let time = Time::from_nanos(-1_700_000_000);
        assert_eq!((time.sec, time.nanosec), (-2, 300_000_000));
        assert_eq!(time.to_nanos(), -1_700_000_000);
    }

    #[test]
    fn time_beyond_the_range_saturates() {
        assert_eq!(Time::from_nanos(i64::MAX).sec, i32::MAX);
        assert_eq!(Time::from_nanos(i64::MIN).sec, i32::MIN);
        let last = join(i32::MAX, 999_999_999);
        assert_eq!(Time::from_nanos(last).to_nanos(), last);
        assert_eq!(Time::from_nanos(last + 1).to_nanos(), last);
    }
}
