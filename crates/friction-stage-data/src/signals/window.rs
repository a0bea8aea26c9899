//! Which part of a recording is read.
//!
//! What comes in are times in the order of the recording; what goes out is whether each sample is
//! in the part. Whoever reads samples asks here, and holds no others in memory.

/// How far around a part the other signals are read, ns. Assumed: a few samples of 10 Hz.
const AROUND_NS: i64 = 1_000_000_000;
/// A sample this far beyond the end, ns, shows that no more of the part will come: messages may be
/// late by as much.
const LATEST_NS: i64 = 1_000_000_000;

/// Most samples of a recording that are examined and identified with: a search over twice as many
/// takes more than a gigabyte, and five minutes at 2 kHz are more than a fit needs. Assumed.
pub const MOST_SAMPLES: usize = 600_000;

/// A part of a recording, by the time since its first sample of the position, s. Without limits it
/// is the whole one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Window {
    /// From here on.
    pub from: Option<f64>,
    /// Up to here.
    pub to: Option<f64>,
    /// Samples of the position at most, from the first one on.
    pub most: Option<usize>,
}

/// Where a sample is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    Before,
    Inside,
    After,
    /// So far behind the end that all later ones are, too.
    Beyond,
}

impl Window {
    /// Between two times, s, no more samples than are examined.
    pub fn examined(from: Option<f64>, to: Option<f64>) -> Window {
        Window { from, to, most: Some(MOST_SAMPLES) }
    }
}

/// The limits of a [`Window`] in the time of the recording.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(crate) struct Span {
    window: Window,
    /// First and last time, ns, both inside; unknown before the first sample.
    limits: Option<(i64, i64)>,
    is_of_others: bool,
    /// Samples that are inside, of the position.
    count: usize,
    /// Whether there were others.
    pub is_part: bool,
}

impl Span {
    /// Of the signal whose first sample is the beginning of the recording.
    pub fn of(window: Window) -> Span {
        Span { window, ..Span::default() }
    }

    /// Between two times, ns, for the other signals, and what lies around: between samples of a low
    /// rate, values come from those next to them.
    pub fn between(first: i64, last: i64) -> Span {
        let limits = Some((first.saturating_sub(AROUND_NS), last.saturating_add(AROUND_NS)));
        Span { limits, is_of_others: true, ..Span::default() }
    }

    /// The same span on a clock that is behind by `offset`, ns.
    pub fn on_clock(mut self, offset: i64) -> Span {
        let moved = |stamp: i64| stamp.saturating_sub(offset);
        self.limits = self.limits.map(|(from, to)| (moved(from), moved(to)));
        self
    }

    /// Samples at most.
    pub fn most(&self) -> u64 {
        self.window.most.map_or(u64::MAX, |most| most as u64)
    }

    /// Whether the times were given, by another signal.
    pub fn is_of_others(&self) -> bool {
        self.is_of_others
    }

    /// Where the next sample is.
    pub fn side(&mut self, stamp: i64) -> Side {
        let (from, to) = *self.limits.get_or_insert_with(|| {
            let after = |seconds: Option<f64>, none: i64| {
                seconds.map_or(none, |s| stamp.saturating_add((s * 1e9).round() as i64))
            };
            (after(self.window.from, i64::MIN), after(self.window.to, i64::MAX))
        });
        let is_full = self.window.most.is_some_and(|most| self.count >= most);
        let side = match stamp {
            stamp if stamp < from => Side::Before,
            _ if is_full => Side::Beyond,
            stamp if stamp <= to => Side::Inside,
            stamp if stamp > to.saturating_add(LATEST_NS) => Side::Beyond,
            _ => Side::After,
        };
        self.count += usize::from(side == Side::Inside);
        self.is_part |= side != Side::Inside;
        side
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: i64 = 1_000_000_000;

    #[test]
    fn times_count_from_the_first_sample_and_both_ends_are_inside() {
        let mut span = Span::of(Window { from: Some(2.0), to: Some(4.0), most: None });
        let sides: Vec<Side> =
            [7, 9, 11, 12, 13].iter().map(|seconds| span.side(seconds * S)).collect();
        assert_eq!(sides, [Side::Before, Side::Inside, Side::Inside, Side::After, Side::Beyond]);
        assert!(span.is_part);
    }

    #[test]
    fn the_first_samples_are_taken_and_no_more() {
        let mut span = Span::of(Window { from: Some(1.0), most: Some(2), ..Window::default() });
        let sides: Vec<Side> = (0..5).map(|seconds| span.side(seconds * S)).collect();
        assert_eq!(sides, [Side::Before, Side::Inside, Side::Inside, Side::Beyond, Side::Beyond]);
        let mut whole = Span::of(Window::default());
        assert!((0..5).all(|seconds| whole.side(seconds * S) == Side::Inside) && !whole.is_part);
    }
}
