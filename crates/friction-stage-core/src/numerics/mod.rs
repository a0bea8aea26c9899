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

/// A value for a message: in digits, or with an exponent where digits are zeros mostly.
pub fn plain(value: f64) -> String {
    let size = value.abs();
    let is_short = value == 0.0 || !value.is_finite() || (1e-6..1e15).contains(&size);
    if is_short { format!("{value}") } else { format!("{value:e}") }
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
    fn a_message_has_no_row_of_zeros() {
        let values = [40.0, -0.005, 0.0, 2e12, 1e300, -1e-320, f64::NAN];
        let expected = ["40", "-0.005", "0", "2000000000000", "1e300", "-1e-320", "NaN"];
        assert_eq!(values.map(plain), expected);
    }

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
