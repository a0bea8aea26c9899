//! The exponential of four numbers that are not positive, as the guides need it eight times per step.
//!
//! `f64x4::exp` of `wide` handles infinities, overflow and subnormal results, which costs a third of the plant's time.

use wide::{bytemuck, f64x4, i64x4};

/// Below, the result stays at exp(-708) = 3e-308, the last before subnormal numbers.
const SMALLEST: f64 = -708.0;
/// 1.5 * 2^52: adding it rounds to a whole number, which then stands in the lowest bits.
const ROUNDING: f64 = 6_755_399_441_055_744.0;
/// ln 2 in two parts; the first has 32 trailing zero bits, so that its product with a whole number is exact
/// (fdlibm, e_exp.c, Sun Microsystems 1993).
const LN_2_HIGH: f64 = f64::from_bits(0x3fe6_2e42_fee0_0000);
const LN_2_LOW: f64 = f64::from_bits(0x3dea_39ef_3579_3c76);

/// exp(x) for x <= 0, within 2 units in the last place (5e-16) of the standard library's down to x = -708,
/// exactly 1 at 0; beneath -708 it is 3e-308 instead of less. NaN stays NaN.
///
/// x = n ln 2 + r with whole n and |r| <= ln 2 / 2; exp(r) by its Taylor series to r^13, the rest of which is below
/// 6e-18; 2^n by adding n to the exponent. Only IEEE additions and multiplications, none fused: the same bits everywhere.
#[inline(always)]
pub(super) fn exp_of_negative(x: f64x4) -> f64x4 {
    // In this order a NaN in x comes through.
    let x = f64x4::splat(SMALLEST).fast_max(x);
    let shifted = x * f64x4::splat(std::f64::consts::LOG2_E) + f64x4::splat(ROUNDING);
    let n = shifted - f64x4::splat(ROUNDING);
    let r = x - n * f64x4::splat(LN_2_HIGH) - n * f64x4::splat(LN_2_LOW);
    // Estrin's scheme: pairs of terms, then pairs of pairs.
    let pair = |k: usize| f64x4::splat(INVERSE_FACTORIALS[k]) + f64x4::splat(INVERSE_FACTORIALS[k + 1]) * r;
    let r2 = r * r;
    let r4 = r2 * r2;
    let r8 = r4 * r4;
    let low = (pair(0) + pair(2) * r2) + (pair(4) + pair(6) * r2) * r4;
    let high = (pair(8) + pair(10) * r2) + pair(12) * r4;
    let series = low + high * r8;
    let exponent: i64x4 = bytemuck::cast::<f64x4, i64x4>(shifted) << 52;
    bytemuck::cast(bytemuck::cast::<f64x4, i64x4>(series) + exponent)
}

/// 1/k!
const INVERSE_FACTORIALS: [f64; 14] = {
    let mut table = [1.0; 14];
    let mut factorial = 1.0;
    let mut k = 1;
    while k < table.len() {
        factorial *= k as f64;
        table[k] = 1.0 / factorial;
        k += 1;
    }
    table
};

#[cfg(test)]
mod tests {
    use super::*;

    fn exp(x: f64) -> f64 {
        let lanes = exp_of_negative(f64x4::new([x, -1.0, 0.0, x])).to_array();
        assert_eq!(lanes[0].to_bits(), lanes[3].to_bits(), "lanes are alike");
        lanes[0]
    }

    #[test]
    fn agrees_with_the_standard_library_down_to_its_smallest_argument() {
        let mut worst = (0.0, 0.0);
        // Steps that meet all of the range of r, and every power of two.
        for k in 0..1_416_000 {
            let x = f64::from(k) * -0.000_499_97;
            let error = (exp(x) / x.exp() - 1.0).abs();
            worst = if error > worst.0 { (error, x) } else { worst };
        }
        println!("largest relative error {:e} at {}", worst.0, worst.1);
        assert!(worst.0 <= 2.0 * f64::EPSILON, "{worst:?}");
    }

    #[test]
    fn is_exactly_one_at_zero_and_practically_zero_far_below() {
        assert_eq!(exp(0.0), 1.0);
        assert_eq!(exp(-0.0), 1.0);
        assert_eq!(exp(-1e-20), 1.0);
        for x in [-708.1, -1e4, -1e300, f64::NEG_INFINITY] {
            let tiny = exp(x);
            assert!(tiny > 0.0 && tiny < 4e-308, "{x}: {tiny}");
        }
    }

    #[test]
    fn a_nan_stays_a_nan() {
        assert!(exp(f64::NAN).is_nan());
    }
}
