//! How far the carriage can go: the stroke and the end stops at its ends.

use serde::{Deserialize, Serialize};

use super::error::{self, ModelError};

/// The way that the carriage has, with an end stop at either end; position 0, where a stage starts,
/// lies within it.
///
/// A stop pushes back with stiffness times penetration and, while the carriage moves into it,
/// damping times velocity; it never pulls. Stiffness and damping are assumed where a model does not
/// give them: rubber buffers that 40 kg at 1 m/s press in by about 4 mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stroke {
    /// Position of the lower stop, m, negative.
    pub low: f64,
    /// Position of the upper stop, m, positive.
    pub high: f64,
    /// Stiffness of a stop, N/m.
    #[serde(default = "default_stiffness")]
    pub stiffness: f64,
    /// Damping of a stop, N s/m.
    #[serde(default = "default_damping")]
    pub damping: f64,
}

fn default_stiffness() -> f64 {
    2e6
}

fn default_damping() -> f64 {
    5e3
}

impl Stroke {
    /// A stroke of `reach` m to either side, with stops as assumed.
    pub fn symmetric(reach: f64) -> Stroke {
        Stroke {
            low: -reach,
            high: reach,
            stiffness: default_stiffness(),
            damping: default_damping(),
        }
    }

    /// Whether `position`, m, lies within the stroke.
    pub fn contains(&self, position: f64) -> bool {
        (self.low..=self.high).contains(&position)
    }

    /// How far a carriage at `position`, m, is pressed into a stop, m: positive at the upper one,
    /// negative at the lower one, 0 between them.
    pub fn penetration(&self, position: f64) -> f64 {
        (position - self.high).max(0.0) + (position - self.low).min(0.0)
    }

    /// Force of the stops along +x on a carriage at `position`, m, with `velocity`, m/s, in N.
    pub fn force(&self, position: f64, velocity: f64) -> f64 {
        let pressed = self.penetration(position);
        if pressed == 0.0 {
            return 0.0;
        }
        let force = -self.stiffness * pressed - self.damping * velocity;
        // A buffer that the carriage leaves faster than it expands lets go.
        if force * pressed < 0.0 { force } else { 0.0 }
    }

    pub(super) fn check(&self) -> Result<(), ModelError> {
        error::positive("stroke.high", self.high)?;
        if !(self.low.is_finite() && self.low < 0.0) {
            let limit = "be below 0: a stage starts at position 0, within its stroke";
            return Err(error::refused("stroke.low", self.low, limit));
        }
        error::positive("stroke.low (its size)", -self.low)?;
        error::positive("stroke.stiffness", self.stiffness)?;
        error::not_negative("stroke.damping", self.damping)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stop_pushes_back_and_never_pulls() {
        let stroke = Stroke { low: -0.1, high: 0.2, stiffness: 1e6, damping: 1e3 };
        assert_eq!(stroke.force(0.2, 5.0), 0.0);
        assert_eq!(stroke.force(-0.05, -5.0), 0.0);
        assert!((stroke.force(0.201, 0.0) + 1000.0).abs() < 1e-6);
        assert!((stroke.force(0.201, 0.5) + 1500.0).abs() < 1e-6);
        assert!((stroke.force(-0.102, 0.0) - 2000.0).abs() < 1e-6);
        // Leaving at 2 m/s the damper alone would pull with 2000 N.
        assert_eq!(stroke.force(0.201, -2.0), 0.0);
    }
}
