//! Several bristles in parallel that meet stiffnesses which one bristle cannot: fit in closed form.
//!
//! One LuGre bristle has k(A) = Fs tanh(sigma0 A/Fs)/A, so two numbers fix the rest. Three in
//! parallel (`distributed_bristles`) have the sum over elements of K_i d_i tanh(A/d_i)/A, with
//! stiffness K_i and break-away distance d_i each; the sum of K_i d_i is the static friction Fs
//! (Iwan, J. Appl. Mech. 33, 1966, with the smooth LuGre element).

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

/// A stiffness (N/m) at an amplitude (m).
pub type StiffnessAt = (f64, f64);

/// Three elements that meet three stiffnesses and a static friction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct DistributedFit {
    /// Sum of the elements' stiffnesses, N/m: sigma0 of the guide.
    pub stiffness: f64,
    /// Part of the stiffness in each element, sum 1: parameters of the effect.
    pub stiffness_shares: [f64; 3],
    /// Part of the static friction in each element, sum 1: parameters of the effect.
    pub strength_shares: [f64; 3],
    /// N
    pub static_force: f64,
}

/// Three stiffnesses that no three elements of this kind can have.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "no three bristles with positive shares have {} N/m at {} m, {} N/m at {} m and {} N/m at {} m \
     under {static_force} N: the stiffness must fall with the amplitude and stay below \
     {static_force} N over it",
    of[0].1, of[0].0, of[1].1, of[1].0, of[2].1, of[2].0
)]
pub struct NoDistributedFit {
    /// Stiffnesses that were to be met, at ascending amplitudes.
    pub of: [StiffnessAt; 3],
    /// Static friction that was to be met, N.
    pub static_force: f64,
}

/// Fits three elements to three stiffnesses at ascending amplitudes.
///
/// Break-away distances of the first two: the geometric means of neighbouring amplitudes (assumed:
/// an element shows between the two that it tells apart). The third has the friction that is left.
/// Stiffnesses then follow linearly, iterated over its distance.
pub fn fit(of: [StiffnessAt; 3], static_force: f64) -> Result<DistributedFit, NoDistributedFit> {
    let refused = NoDistributedFit { of, static_force };
    let (first, second) = ((of[0].0 * of[1].0).sqrt(), (of[1].0 * of[2].0).sqrt());
    let share =
        |amplitude: f64, distance: f64| distance * (amplitude / distance).tanh() / amplitude;
    let right = Vector3::from_fn(|row, _| of[row].1);
    let mut third = static_force / of[2].1;
    let mut stiffness = Vector3::zeros();
    for _ in 0..500 {
        let distances = [first, second, third];
        let matrix = Matrix3::from_fn(|row, column| share(of[row].0, distances[column]));
        stiffness = matrix.lu().solve(&right).ok_or(refused)?;
        let next = (static_force - stiffness[0] * first - stiffness[1] * second) / stiffness[2];
        if !(next.is_finite() && next > 0.0) {
            return Err(refused);
        }
        let change = next - third;
        third += 0.5 * change;
        if change.abs() < 1e-12 * third {
            break;
        }
    }
    if !stiffness.iter().all(|k| *k > 0.0) {
        return Err(refused);
    }
    let sum = stiffness.sum();
    let distances = [first, second, third];
    let found = DistributedFit {
        stiffness: sum,
        stiffness_shares: std::array::from_fn(|i| stiffness[i] / sum),
        strength_shares: std::array::from_fn(|i| stiffness[i] * distances[i] / static_force),
        static_force,
    };
    let met = of
        .iter()
        .all(|(amplitude, k)| (found.effective_stiffness(*amplitude) / k - 1.0).abs() < 1e-3);
    if met { Ok(found) } else { Err(refused) }
}

impl DistributedFit {
    /// Stiffness of a slow loop of this amplitude (m), N/m: the closed form.
    pub fn effective_stiffness(&self, amplitude: f64) -> f64 {
        self.stiffness_shares
            .iter()
            .zip(self.strength_shares)
            .map(|(a, b)| {
                let strength = b * self.static_force;
                strength * (a * self.stiffness * amplitude / strength).tanh() / amplitude
            })
            .sum()
    }
}

/// The single bristle that comes nearest, in the root mean square of the relative errors: its
/// stiffness sigma0, N/m, with the static friction kept (N). The best of a fine grid.
pub fn best_single(of: &[StiffnessAt], static_force: f64) -> f64 {
    let error = |stiffness: f64| -> f64 {
        of.iter()
            .map(|(amplitude, k)| {
                let found =
                    static_force * (stiffness * amplitude / static_force).tanh() / amplitude;
                (found / k - 1.0).powi(2)
            })
            .sum()
    };
    let top = of.iter().fold(0.0f64, |top, (_, k)| top.max(*k));
    (1..=4000)
        .map(|step| 2.0 * top * step as f64 / 4000.0)
        .min_by(|a, b| error(*a).total_cmp(&error(*b)))
        .unwrap_or(top)
}

#[cfg(test)]
mod tests {
    use super::*;

    const GUIDE_1: [StiffnessAt; 3] = [(10e-9, 7.5e5), (1e-6, 4.5e5), (40e-6, 2.3e5)];

    #[test]
    fn three_elements_meet_the_three_stiffnesses_of_the_paper_and_one_cannot() {
        let found = fit(GUIDE_1, 16.8).unwrap();
        for (amplitude, k) in GUIDE_1 {
            assert!((found.effective_stiffness(amplitude) / k - 1.0).abs() < 1e-3, "{found:?}");
        }
        for shares in [found.stiffness_shares, found.strength_shares] {
            assert!(
                (shares.iter().sum::<f64>() - 1.0).abs() < 1e-9 && shares.iter().all(|s| *s > 0.0),
                "{found:?}"
            );
        }
        // Far beyond every break-away distance only the static friction is left.
        assert!((found.effective_stiffness(10e-3) * 10e-3 / 16.8 - 1.0).abs() < 1e-3);
        let single = best_single(&GUIDE_1, 16.8);
        let worst = GUIDE_1
            .iter()
            .map(|(a, k)| (16.8 * (single * a / 16.8f64).tanh() / a / k - 1.0).abs())
            .fold(0.0, f64::max);
        assert!(worst > 0.2, "{single}: {worst}");
    }

    #[test]
    fn stiffness_that_grows_with_amplitude_is_refused() {
        let error = fit([(10e-9, 2e5), (1e-6, 4e5), (40e-6, 3e5)], 16.8).unwrap_err();
        assert!(error.to_string().contains("must fall with the amplitude"), "{error}");
    }
}
