//! The position of a record without the encoder's noise where the carriage hardly moves. What
//! shakes it there is mostly what the controller makes of that noise, too fast and too small to be
//! seen; bristles relax with it all the same.

use crate::record::lowpass::ZeroPhaseLowpass;

/// Corner below which the encoder says how the carriage moves at rest, Hz; above it the command
/// does, over the mass and integrated twice. Assumed: well above the resonance of a mass on its
/// bristles, 30 to 60 Hz, where friction has a part in the motion.
const REST_CORNER: f64 = 100.0;
/// Speeds, in standard deviations of the apparent speed from encoder noise, below which the
/// position is smoothed wholly and above which it is left as it is. Assumed: a LuGre bristle
/// relaxes with |v|, so apparent speed makes it drift; well above it |v| is right by itself.
pub(super) const REST_SPEED: (f64, f64) = (24.0, 93.0);
/// What rings above the corner, rms in standard deviations of the encoder's noise, below which the
/// position is smoothed wholly and above which it is left as it is. Assumed.
const RINGING: (f64, f64) = (3.0, 6.0);

/// What an encoder shows of a position at rest, whatever force shakes the carriage there.
#[derive(Clone, Debug)]
pub(super) struct AtRest {
    lowpass: ZeroPhaseLowpass,
    /// Below the corner, m.
    slow: Vec<f64>,
    /// Share of the position that is left as it is.
    share: Vec<f64>,
    /// Samples at which the command has a part in the motion, with the slow part of what the
    /// lowpass leaves of the position there, m.
    shaken_samples: Vec<usize>,
    slow_of_rest: Vec<f64>,
}

impl AtRest {
    /// Of a position, m, at a rate, Hz, that an encoder of this noise has read, m.
    pub(super) fn new(position: &[f64], rate: f64, noise: f64) -> AtRest {
        let lowpass = ZeroPhaseLowpass::new(REST_CORNER.min(rate / 5.0), rate).keeping_all();
        let (count, half) = (position.len(), lowpass.half());
        let apparent = 2f64.sqrt() * noise * rate;
        let slow = lowpassed(position, &lowpass);
        let left = rest_of(position, &slow);
        let squares: Vec<f64> = std::iter::once(0.0)
            .chain(left.iter().scan(0.0, |sum, left| {
                *sum += left * left;
                Some(*sum)
            }))
            .collect();
        // The largest speed around, so that the onset of a motion is left as it is.
        let speed = |k: usize| {
            let (before, after) = (k.saturating_sub(half), (k + half).min(count - 1));
            let mut largest = 0f64;
            let mut at = before;
            while at < after {
                let next = (at + half / 2).min(after);
                largest = largest.max((slow[next] - slow[at]).abs() * rate / (next - at) as f64);
                at = next;
            }
            largest
        };
        let beyond =
            |value: f64, (low, high): (f64, f64)| ((value - low) / (high - low)).clamp(0.0, 1.0);
        let share_at = |k: usize| {
            let (before, after) = (k.saturating_sub(half), (k + half + 1).min(count));
            let ringing = ((squares[after] - squares[before]) / (after - before) as f64).sqrt();
            beyond(speed(k) / apparent, REST_SPEED).max(beyond(ringing / noise, RINGING))
        };
        let share: Vec<f64> = (0..count).map(share_at).collect();
        let shaken_samples: Vec<usize> = inner(count, half).filter(|k| share[*k] < 1.0).collect();
        let slow_of_rest = lowpass.at_all(&left, &shaken_samples);
        AtRest { lowpass, slow, share, shaken_samples, slow_of_rest }
    }

    /// The position that it is of without the noise, m. `shaken`: second differences of the
    /// position by the command alone, m.
    pub(super) fn smoothed(&self, position: &[f64], shaken: Option<&[f64]>) -> Vec<f64> {
        let mut smooth = self.slow.clone();
        if let Some(shaken) = shaken {
            // The slow part of the command is what friction holds: of the rest of the position
            // again the slow part is the encoder's and the quick one the command's, so that
            // together they pass all frequencies alike.
            let shaken = rest_of(shaken, &lowpassed(shaken, &self.lowpass));
            let rest = self.lowpass.rest_of_second_differences();
            let by_command = rest.at_all(&shaken, &self.shaken_samples);
            let quick = self.slow_of_rest.iter().zip(by_command);
            for (k, (by_encoder, by_command)) in self.shaken_samples.iter().zip(quick) {
                smooth[*k] += by_encoder + by_command;
            }
        }
        let read = position.iter().zip(&self.share);
        smooth.iter_mut().zip(read).for_each(|(smooth, (read, share))| {
            *smooth += share * (read - *smooth);
        });
        smooth
    }
}

/// Samples with a whole filter around them.
fn inner(count: usize, half: usize) -> impl Iterator<Item = usize> {
    half..count.saturating_sub(half)
}

/// The filtered signal, as it is where the filter would reach beyond it.
fn lowpassed(signal: &[f64], lowpass: &ZeroPhaseLowpass) -> Vec<f64> {
    let rows: Vec<usize> = inner(signal.len(), lowpass.half()).collect();
    let mut filtered = signal.to_vec();
    if let (Some(first), Some(last)) = (rows.first(), rows.last()) {
        filtered[*first..=*last].copy_from_slice(&lowpass.at_all(signal, &rows));
    }
    filtered
}

fn rest_of(signal: &[f64], slow: &[f64]) -> Vec<f64> {
    signal.iter().zip(slow).map(|(whole, slow)| whole - slow).collect()
}
