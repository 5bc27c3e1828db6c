//! 16-bit floats (IEEE 754 binary16) to 32-bit: exact, and without a branch, so that loops over it become SIMD. And back,
//! rounded.
//!
//! ```text
//! f16   s eeeee mmmmmmmmmm                 value = 1.m · 2^(e - 15)
//! f32   s eeeeeeee mmmmmmmmmmmmmmmmmmmmmmm  value = 1.m · 2^(e - 127)
//! ```
//! Based on: F. Giesen, "Float to half conversion" (2012), `half_to_float_fast5`. Its shorter twin multiplies by 2^112,
//! but reads 32-bit subnormals: slow on some processors, and zero where an engine has switched them off.

/// The value of a 16-bit float. NaN stays NaN, infinity infinity.
#[inline(always)]
pub fn f16_to_f32(bits: u16) -> f32 {
    const EXPONENT: u32 = 0x7c00 << 13;
    /// The smallest normal f16, 2^-14.
    const SMALLEST_NORMAL: u32 = 113 << 23;
    let bits = bits as u32;
    // Exponent and mantissa move to their places in an f32; the exponent gets f32's bias.
    let moved = (bits & 0x7fff) << 13;
    let normal = moved + ((127 - 15) << 23);
    // Exponent 31 means infinity or NaN, which an f32 writes with 255.
    let special = moved + ((255 - 31) << 23);
    // Exponent 0 has no leading 1: read as if it had one, then take it off.
    let subnormal = (f32::from_bits(moved + SMALLEST_NORMAL) - f32::from_bits(SMALLEST_NORMAL)).to_bits();
    let magnitude = match moved & EXPONENT {
        0 => subnormal,
        EXPONENT => special,
        _ => normal,
    };
    f32::from_bits(magnitude | ((bits & 0x8000) << 16))
}

/// 2^-112 times the value of the 16-bit float in a word's upper half, where that is neither subnormal nor infinite nor NaN:
/// two instructions, where [`f16_to_f32`] takes a dozen. Who adds many up puts the 2^112 into their weights.
#[inline(always)]
pub(crate) fn upper_f16_to_scaled_f32(word: u32) -> f32 {
    // Exponent and mantissa move to their places; the copies of the sign above them go away, and the lower half.
    let moved = (word as i32 >> 3) as u32;
    f32::from_bits(moved & 0x8fff_e000)
}

/// The nearest 16-bit float, of two equally near ones the even one; infinity from 65520 on. NaN gives infinity or NaN.
pub(crate) fn f32_to_f16(value: f32) -> u16 {
    let sign = (value.to_bits() >> 16) as u16 & 0x8000;
    let magnitude = value.to_bits() & 0x7fff_ffff;
    let rounded = if magnitude < 113 << 23 {
        // Below 2^-14 f16's step is 2^-24, which is f32's between 1/2 and 1: adding 1/2 rounds.
        (f32::from_bits(magnitude) + 0.5).to_bits() - 0.5f32.to_bits()
    } else {
        // Half a step is added before the 13 low bits go, and a whole one less where the result would stay even.
        (magnitude - (112 << 23) + 0x0fff + (magnitude >> 13 & 1)) >> 13
    };
    sign | rounded.min(0x7c00) as u16
}

/// Whether a 16-bit float is subnormal: not 0, and below 2^-14.
#[inline(always)]
pub(crate) fn f16_is_subnormal(bits: u16) -> bool {
    (bits & 0x7fff).wrapping_sub(1) < 0x03ff
}

/// Whether a 16-bit float is neither infinite nor NaN.
#[inline(always)]
pub fn f16_is_finite(bits: u16) -> bool {
    bits & 0x7c00 != 0x7c00
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decodes_all_65536_bit_patterns_as_the_half_crate_does() {
        for bits in 0..=u16::MAX {
            let (found, truth) = (f16_to_f32(bits), half::f16::from_bits(bits).to_f32());
            if truth.is_nan() {
                assert!(found.is_nan(), "{bits:#06x}");
            } else {
                assert_eq!(found.to_bits(), truth.to_bits(), "{bits:#06x}");
            }
            assert_eq!(f16_is_finite(bits), truth.is_finite(), "{bits:#06x}");
        }
    }

    #[test]
    fn rounds_to_16_bits_as_the_half_crate_does() {
        // Every 16-bit number, the middle to the next one, and what lies on either side of both.
        for bits in 0..=u16::MAX {
            let number = f16_to_f32(bits);
            if number.is_nan() {
                continue;
            }
            let middle = 0.5 * number + 0.5 * f16_to_f32(bits.wrapping_add(1));
            for exact in [number, middle, number * 1.3, number * 1e-6].map(f32::to_bits) {
                for near in [exact.wrapping_sub(1), exact, exact + 1].map(f32::from_bits) {
                    let truth = half::f16::from_f32(near);
                    assert!(near.is_nan() || f32_to_f16(near) == truth.to_bits(), "{near:e}");
                }
            }
        }
    }

    #[test]
    fn plain_numbers_decode_as_all_do_but_for_the_scale() {
        let mut plain = 0;
        for bits in 0..=u16::MAX {
            let truth = half::f16::from_bits(bits);
            let subnormal = truth.classify() == core::num::FpCategory::Subnormal;
            assert_eq!(f16_is_subnormal(bits), subnormal, "{bits:#06x}");
            if truth.is_finite() && !subnormal {
                let found = upper_f16_to_scaled_f32(u32::from(bits) << 16 | 0x5aa5);
                assert!(found == 0.0 || found.is_normal(), "{bits:#06x}");
                assert_eq!((found * 112f32.exp2()).to_bits(), truth.to_f32().to_bits(), "{bits:#06x}");
                plain += 1;
            }
        }
        assert_eq!(plain, 2 * (1 + 30 * 1024));
    }
}
