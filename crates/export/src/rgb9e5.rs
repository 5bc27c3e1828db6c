//! Three colours in 32 bits: 9 bits each and one exponent.
//!
//! ```text
//! bit 31      27 26       18 17        9 8         0
//!     |exponent | blue      | green     | red       |      value = mantissa · 2^(exponent - 15 - 9)
//! ```
//! Based on: Khronos, `EXT_texture_shared_exponent` (2006), section 2.1, which also gives the rounding.

/// The largest value, 65 408.
pub(crate) const MAX: f32 = (511.0 / 512.0) * 65_536.0;

const BIAS: i32 = 15;
const MANTISSA_BITS: i32 = 9;

/// The nearest triple that fits; below 0 becomes 0, above [`MAX`] that.
pub(crate) fn encode(rgb: [f32; 3]) -> u32 {
    // Not a number becomes 0, too.
    let rgb = rgb.map(|v| if v.is_nan() { 0.0 } else { f64::from(v.clamp(0.0, MAX)) });
    let largest = rgb[0].max(rgb[1]).max(rgb[2]);
    let floor_log2 = if largest > 0.0 { exponent_of(largest) } else { -BIAS - 1 };
    let mut exponent = floor_log2.max(-BIAS - 1) + 1 + BIAS;
    let unit = |exponent: i32| 2.0_f64.powi(exponent - BIAS - MANTISSA_BITS);
    // The largest may round up to 512, which needs the next exponent.
    if (largest / unit(exponent) + 0.5).floor() as i32 == 1 << MANTISSA_BITS {
        exponent += 1;
    }
    let [r, g, b] = rgb.map(|v| (v / unit(exponent) + 0.5).floor() as u32);
    r | g << 9 | b << 18 | (exponent as u32) << 27
}

/// The values.
pub(crate) fn decode(bits: u32) -> [f32; 3] {
    let unit = 2.0_f32.powi((bits >> 27) as i32 - BIAS - MANTISSA_BITS);
    [0, 9, 18].map(|shift| (bits >> shift & 0x1ff) as f32 * unit)
}

/// floor(log2(v)) of a normal number.
fn exponent_of(v: f64) -> i32 {
    ((v.to_bits() >> 52 & 0x7ff) as i32) - 1023
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decoded_values_encode_to_the_same_bits_or_the_same_values() {
        for i in 0..200_000_u32 {
            let bits = i.wrapping_mul(2_654_435_761);
            let values = decode(bits);
            assert_eq!(decode(encode(values)), values, "{bits:08x}");
        }
    }

    #[test]
    fn error_is_half_a_step_of_the_largest_channel() {
        for i in 1..20_000 {
            let t = f64::from(i);
            let scale = 2.0_f64.powf((t * 0.37).sin() * 14.0);
            let rgb = [0.61, 0.23, 0.77].map(|f| (scale * (t * f).sin().abs()) as f32);
            let largest = rgb.iter().copied().fold(0.0, f32::max);
            for (found, truth) in decode(encode(rgb)).iter().zip(rgb) {
                assert!((found - truth).abs() <= largest / 512.0 + 2.0_f32.powi(-25), "{rgb:?} {found}");
            }
        }
    }

    #[test]
    fn what_does_not_fit_is_clamped() {
        assert_eq!(decode(encode([-1.0, f32::NAN, 1e9])), [0.0, 0.0, MAX]);
        assert_eq!(encode([0.0; 3]), 0);
        // Rounds up past nine bits.
        assert_eq!(decode(encode([1.999_9, 0.0, 0.0]))[0], 2.0);
    }
}
