//! Least squares of a sine, a cosine and a constant.

use nalgebra::{Matrix3, Vector3};

use super::linear::solve_normal;

/// Sums over samples at known phases.
#[derive(Clone, Debug, Default)]
pub struct SinusoidSums {
    normal: Matrix3<f64>,
    right: Vector3<f64>,
}

/// a sin + b cos + c that leaves least of the samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sinusoid {
    /// a
    pub sine: f64,
    /// b
    pub cosine: f64,
    /// c
    pub constant: f64,
    /// Reduction of the sum of squares of the samples.
    pub explained: f64,
}

impl SinusoidSums {
    /// Adds a sample at a phase, rad.
    pub fn add(&mut self, phase: f64, value: f64) {
        let row = Vector3::new(phase.sin(), phase.cos(), 1.0);
        self.normal += row * row.transpose();
        self.right += row * value;
    }

    /// Sum of the values.
    pub fn total(&self) -> f64 {
        self.right[2]
    }

    /// `None` where the phases do not tell the three apart.
    pub fn solve(&self) -> Option<Sinusoid> {
        let solution = solve_normal(&self.normal, &self.right)?;
        let [sine, cosine, constant] = solution.into();
        Some(Sinusoid { sine, cosine, constant, explained: solution.dot(&self.right) })
    }
}

impl Sinusoid {
    /// Half of its span.
    pub fn amplitude(&self) -> f64 {
        self.sine.hypot(self.cosine)
    }

    /// Of amplitude sin(x + phase), rad.
    pub fn phase(&self) -> f64 {
        self.cosine.atan2(self.sine)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amplitude_phase_and_constant_are_found_along_part_of_a_period() {
        let mut sums = SinusoidSums::default();
        assert_eq!(sums.solve(), None);
        let mut squares = 0.0;
        for k in 0..100 {
            let x = 0.02 * f64::from(k);
            let value = 3.0 * (x + 0.7).sin() - 5.0;
            squares += value * value;
            sums.add(x, value);
        }
        let found = sums.solve().unwrap();
        assert!((found.amplitude() - 3.0).abs() < 1e-9, "{found:?}");
        assert!((found.phase() - 0.7).abs() < 1e-9 && (found.constant + 5.0).abs() < 1e-9);
        assert!((found.explained / squares - 1.0).abs() < 1e-9);
    }
}
