//! Numerical methods that more than one room uses.

pub mod correlation;
pub mod least_squares;
pub mod linear;
pub mod noise;
pub mod sinusoid;
pub mod steady_state;

/// Half of a two-sided 95 % interval in standard deviations: 97.5 % quantile of the normal
/// distribution.
pub const TWO_SIDED_95: f64 = 1.959_963_984_540_054;

/// A value to so many digits that count; what is not finite as it is.
pub fn rounded(value: f64, digits: usize) -> f64 {
    let decimals = digits.saturating_sub(1);
    match format!("{value:.decimals$e}").parse::<f64>() {
        Ok(found) if found.is_finite() => found,
        _ => value,
    }
}

/// Least and largest of some values; infinite, the wrong way round, where there are none.
pub fn range(values: &[f64]) -> (f64, f64) {
    values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), value| {
        (least.min(*value), most.max(*value))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_keeps_the_digits_that_count() {
        let cases = [(0.984665, 0.9847), (-170567.0, -170600.0), (9.9999e-9, 1e-8), (0.0, 0.0)];
        for (value, expected) in cases {
            assert_eq!(rounded(value, 4), expected);
        }
        assert_eq!(rounded(f64::MAX, 4), f64::MAX);
        assert!(rounded(f64::NAN, 4).is_nan());
    }
}
