//! Where a word has room in a drawing: on no curve, no other word and no edge of the frame.
//!
//! Lengths in the units of the drawing, the ordinate downwards. `assets/plot.js` does the same on a
//! screen.

/// Left, top, right and bottom.
pub(crate) type Rect = [i32; 4];

/// What is drawn already.
pub(crate) struct Room {
    /// What a word may not leave.
    pub frame: Rect,
    /// Each as the points that straight lines join.
    pub curves: Vec<Vec<(i32, i32)>>,
    /// Words.
    pub taken: Vec<Rect>,
}

/// Rows of words above and below a point that are looked at, and their height over that of a word.
const ROWS: i32 = 5;
const ROW: f64 = 1.2;

impl Room {
    /// Takes the first of some places that is free; of those that only curves cross the one that
    /// the fewest do. `None` where all of them lie on words or leave the frame.
    pub fn take(&mut self, places: impl IntoIterator<Item = Rect>) -> Option<Rect> {
        let [left, top, right, bottom] = self.frame;
        let is_free = |place: &Rect| {
            let inside = place[0] >= left && place[1] >= top;
            let inside = inside && place[2] <= right && place[3] <= bottom;
            let overlaps = |other: &Rect| {
                place[0] < other[2]
                    && other[0] < place[2]
                    && place[1] < other[3]
                    && other[1] < place[3]
            };
            inside && !self.taken.iter().any(overlaps)
        };
        let places = places.into_iter().filter(is_free);
        let best = places.min_by_key(|place| self.crossings(place))?;
        self.taken.push(best);
        Some(best)
    }

    /// Pieces of curves that cross a place.
    fn crossings(&self, place: &Rect) -> usize {
        let pieces = self.curves.iter().flat_map(|curve| curve.windows(2));
        pieces.filter(|piece| crosses(piece[0], piece[1], place)).count()
    }
}

/// Places for a word of this size at a point, the nearest first: above it, below it, and farther
/// off along both axes.
pub(crate) fn places_at((x, y): (i32, i32), (width, height): (i32, i32), gap: i32) -> Vec<Rect> {
    let mut places = Vec::new();
    for row in 0..ROWS {
        let off = (f64::from(row * height) * ROW) as i32 + gap;
        for aside in [0, -(width / 2 + gap), width / 2 + gap] {
            let left = x - width / 2 + aside;
            for top in [y - off - height, y + off] {
                places.push([left, top, left + width, top + height]);
            }
        }
    }
    places
}

/// Whether a straight line goes through a rectangle.
fn crosses(from: (i32, i32), to: (i32, i32), [left, top, right, bottom]: &Rect) -> bool {
    let [(x0, y0), (x1, y1)] = [from, to].map(|(x, y)| (f64::from(x), f64::from(y)));
    // The part of the line, 0 to 1, that is within both pairs of edges.
    let mut part = (0.0f64, 1.0f64);
    for (at, by, low, high) in [(x0, x1 - x0, left, right), (y0, y1 - y0, top, bottom)] {
        let (low, high) = (f64::from(*low), f64::from(*high));
        if by == 0.0 {
            if at < low || at > high {
                return false;
            }
            continue;
        }
        let (a, b) = ((low - at) / by, (high - at) / by);
        part = (part.0.max(a.min(b)), part.1.min(a.max(b)));
    }
    part.0 <= part.1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_word_is_where_no_curve_is() {
        let mut room = Room {
            frame: [0, 0, 400, 200],
            // A hill whose top is at (200, 100), and a line just above it.
            curves: vec![vec![(0, 180), (200, 100), (400, 180)], vec![(0, 85), (400, 85)]],
            taken: Vec::new(),
        };
        let word = || places_at((200, 100), (60, 14), 6);
        let first = room.take(word()).unwrap();
        assert_eq!(room.crossings(&first), 0, "{first:?}");
        let second = room.take(word()).unwrap();
        assert_eq!(room.crossings(&second), 0, "{second:?}");
        let apart = first[2] <= second[0]
            || second[2] <= first[0]
            || first[3] <= second[1]
            || second[3] <= first[1];
        assert!(apart, "{first:?} {second:?}");
        // Where curves are everywhere, it is still written; where a word is everywhere, it is not.
        room.curves = (0..20).map(|k| vec![(0, 10 * k), (400, 10 * k)]).collect();
        assert!(room.take(word()).is_some());
        room.taken = vec![[0, 0, 400, 200]];
        assert_eq!(room.take(word()), None);
    }

    #[test]
    fn a_line_crosses_what_it_goes_through() {
        let place = [10, 10, 20, 20];
        for (from, to, expected) in [
            ((0, 0), (30, 30), true),
            ((0, 15), (30, 15), true),
            ((15, 0), (15, 5), false),
            ((0, 25), (15, 40), false),
            ((0, 12), (12, 0), false),
            ((12, 12), (13, 13), true),
        ] {
            assert_eq!(crosses(from, to, &place), expected, "{from:?} {to:?}");
        }
    }
}
