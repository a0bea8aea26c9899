//! The power of two of four numbers that are not positive: the exponentials of the guides, eight of
//! them per step.
//!
//! The guides are bound by latency: each step waits for two exponentials in a row. `f64x4::exp` of
//! `wide` also handles infinities, overflow and subnormal results; with it a step took 71 ns
//! instead of 51 (AMD Zen 5).

use wide::{bytemuck, f64x4, i64x4};

/// Below, the result stays at 2^-1021 = 4e-308, twice the smallest normal number.
const SMALLEST: f64 = -1021.0;
/// 1.5 * 2^52: adding it rounds to a whole number, which then stands in the lowest bits.
const ROUNDING: f64 = 6_755_399_441_055_744.0;
/// Terms of the series.
const TERMS: usize = 14;
/// (ln 2)^k / k!: the Taylor series of 2^f. For |f| <= 1/2 what is left out is below 6e-18.
const SERIES: [f64; TERMS] = {
    let mut series = [1.0; TERMS];
    let mut k = 1;
    while k < TERMS {
        series[k] = series[k - 1] * std::f64::consts::LN_2 / k as f64;
        k += 1;
    }
    series
};

/// 2^x for x <= 0, within 2 units in the last place (5e-16) of the standard library's down to x =
/// -1021, exact at whole numbers; beneath it is 2^-1021 instead of less. NaN stays NaN.
///
/// x = n + f with whole n and |f| <= 1/2; 2^f by its series, 2^n by adding n to the exponent. Only
/// IEEE additions and multiplications, none of them fused: the same bits on every processor.
#[inline(always)]
pub(super) fn exp2_of_negative(x: f64x4) -> f64x4 {
    // In this order a NaN in x comes through.
    let x = f64x4::splat(SMALLEST).fast_max(x);
    let shifted = x + f64x4::splat(ROUNDING);
    let f = x - (shifted - f64x4::splat(ROUNDING));
    // Estrin's scheme: pairs of terms, then pairs of pairs.
    let pair = |k: usize| f64x4::splat(SERIES[k]) + f64x4::splat(SERIES[k + 1]) * f;
    let f2 = f * f;
    let f4 = f2 * f2;
    let f8 = f4 * f4;
    let low = (pair(0) + pair(2) * f2) + (pair(4) + pair(6) * f2) * f4;
    let high = (pair(8) + pair(10) * f2) + pair(12) * f4;
    let series = low + high * f8;
    let n: i64x4 = bytemuck::cast::<f64x4, i64x4>(shifted) << 52;
    bytemuck::cast(bytemuck::cast::<f64x4, i64x4>(series) + n)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn exp2(x: f64) -> f64 {
        let lanes = exp2_of_negative(f64x4::new([x, -1.0, 0.0, x])).to_array();
        assert_eq!(lanes[0].to_bits(), lanes[3].to_bits(), "lanes are alike");
        lanes[0]
    }

    #[test]
    fn agrees_with_the_standard_library_down_to_its_smallest_argument() {
        let mut worst = (0.0, 0.0);
        // Steps that meet all fractions at every power of two.
        for k in 0..2_042_000 {
            let x = f64::from(k) * -0.000_499_97;
            let error = (exp2(x) / x.exp2() - 1.0).abs();
            worst = if error > worst.0 { (error, x) } else { worst };
        }
        println!("largest relative error {:e} at {}", worst.0, worst.1);
        assert!(worst.0 <= 2.0 * f64::EPSILON, "{worst:?}");
    }

    #[test]
    fn is_exact_at_whole_numbers_and_practically_zero_far_below() {
        for n in -1021..=0 {
            assert_eq!(exp2(f64::from(n)), 2f64.powi(n), "{n}");
        }
        assert_eq!(exp2(-0.0), 1.0);
        assert_eq!(exp2(-1e-20), 1.0);
        for x in [-1021.5, -1e4, -1e300, f64::NEG_INFINITY] {
            assert_eq!(exp2(x), 2f64.powi(-1021), "{x}");
        }
    }

    #[test]
    fn a_nan_stays_a_nan() {
        assert!(exp2(f64::NAN).is_nan());
    }
}
