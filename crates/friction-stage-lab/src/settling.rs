//! How well a move was followed: peak error and time to settle.

use super::paper::Move;

/// Bands to settle into, m: 10 µm, 1 µm, 0.1 µm.
pub const SETTLING_BANDS: [f64; 3] = [10e-6, 1e-6, 0.1e-6];

/// Result of one move, from measured errors.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MoveResult {
    /// Largest |error| from the start of the move to its end, m.
    pub peak_error: f64,
    /// Time from the reference's arrival to the last sample outside of each band, s; `None` where
    /// it stayed outside.
    pub settling: [Option<f64>; 3],
}

/// Evaluates a move on `(time in ns, error in m)` samples of ascending time on the clock of the
/// move.
///
/// A move that never leaves a band after the arrival has settled into it at once (0 s). `None`
/// without any sample.
pub fn settling(the_move: &Move, errors: impl Iterator<Item = (i64, f64)>) -> Option<MoveResult> {
    let mut result: Option<MoveResult> = None;
    let mut last_time = the_move.arrival;
    for (time, error) in errors.filter(|(time, _)| (the_move.start..=the_move.end).contains(time)) {
        let found = result.get_or_insert(MoveResult { peak_error: 0.0, settling: [Some(0.0); 3] });
        found.peak_error = found.peak_error.max(error.abs());
        if time >= the_move.arrival {
            for (settling, band) in found.settling.iter_mut().zip(SETTLING_BANDS) {
                if error.abs() > band {
                    // Settled, if ever, with the sample after this one; the end of the move decides
                    // below.
                    *settling = Some((time - the_move.arrival) as f64 * 1e-9);
                }
            }
            last_time = time;
        }
    }
    let mut result = result?;
    let whole = (last_time - the_move.arrival) as f64 * 1e-9;
    for settling in &mut result.settling {
        if whole > 0.0 && *settling == Some(whole) {
            *settling = None;
        }
    }
    Some(result)
}

#[cfg(test)]
mod tests {
    use super::super::paper::MoveKind;
    use super::*;

    #[test]
    fn settling_times_of_an_exponential_are_its_logarithms() {
        let the_move = Move {
            kind: MoveKind::FastForward,
            start: 0,
            arrival: 100_000_000,
            end: 1_000_000_000,
            target: 0.05,
        };
        // 100 µm at the arrival, time constant 50 ms, constant before.
        let error =
            |time: i64| 100e-6 * (-((time - 100_000_000).max(0) as f64) * 1e-9 / 0.05).exp();
        let result =
            settling(&the_move, (0..=4000).map(|k| (k * 250_000, -error(k * 250_000)))).unwrap();
        assert_eq!(result.peak_error, 100e-6);
        for (settling, ratio) in result.settling.iter().zip([10.0f64, 100.0, 1000.0]) {
            assert!((settling.unwrap() - 0.05 * ratio.ln()).abs() < 3e-4, "{result:?}");
        }
    }

    #[test]
    fn an_error_that_stays_outside_has_not_settled() {
        let the_move =
            Move { kind: MoveKind::FineStep, start: 0, arrival: 10, end: 1000, target: 0.0 };
        let result = settling(&the_move, (0..=1000).map(|time| (time, 5e-6))).unwrap();
        assert_eq!(result.settling, [Some(0.0), None, None]);
        assert_eq!(settling(&the_move, std::iter::empty()), None);
    }
}
