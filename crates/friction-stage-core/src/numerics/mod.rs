//! Numerical methods that more than one room uses.

pub mod correlation;
pub mod least_squares;
pub mod linear;
pub mod noise;
pub mod sinusoid;

/// Half of a two-sided 95 % interval in standard deviations: 97.5 % quantile of the normal
/// distribution.
pub const TWO_SIDED_95: f64 = 1.959_963_984_540_054;

/// Least and largest of some values; infinite, the wrong way round, where there are none.
pub fn range(values: &[f64]) -> (f64, f64) {
    values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), value| {
        (least.min(*value), most.max(*value))
    })
}
