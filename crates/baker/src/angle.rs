//! Angles for the inner loops, to fewer digits than a C library's and for ordinary numbers alone, in less time; and the same bits on
//! every platform.

use std::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// The angle of (x, y) from the x axis, -π..=π, within 3e-7; exact on the axes, and 0 for (0, 0). Both finite, and neither so small
/// or so large that their sum overflows or their quotient means nothing.
///
/// Based on: S. L. Moshier, Cephes (1989), `atanf`; with one division, and without a branch.
#[inline(always)]
pub fn arctangent(y: f32, x: f32) -> f32 {
    const TAN_PI_8: f32 = 0.414_213_56;
    let (size_y, size_x) = (y.abs(), x.abs());
    let is_steep = size_y > size_x;
    let (near, far) = if is_steep { (size_x, size_y) } else { (size_y, size_x) };
    // 0 to 45 degrees, in two halves: the upper one as seen from its end.
    let upper = if near > TAN_PI_8 * far { 1.0 } else { 0.0 };
    let below = far + upper * near;
    let t = (near - upper * far) / if below > 0.0 { below } else { 1.0 };
    let z = t * t;
    let series = ((8.053_744_5e-2 * z - 1.387_768_6e-1) * z + 1.997_771_1e-1) * z - 3.333_295e-1;
    let angle = upper * FRAC_PI_4 + (series * z * t + t);
    let angle = if is_steep { FRAC_PI_2 - angle } else { angle };
    let angle = if x < 0.0 { PI - angle } else { angle };
    if y < 0.0 { -angle } else { angle }
}

/// Sine and cosine of `turns` · 2π, within 2e-11, for at most a million turns; exact at whole quarters.
#[inline]
pub fn sine_cosine(turns: f64) -> (f64, f64) {
    /// Adding it rounds to a whole number, which then stands in the lowest bits.
    const ROUND: f64 = 1.5 * (1u64 << 52) as f64;
    let shifted = 4.0 * turns + ROUND;
    let quarter = shifted.to_bits();
    // -45 to 45 degrees from a whole quarter.
    let x = (4.0 * turns - (shifted - ROUND)) * std::f64::consts::FRAC_PI_2;
    let z = x * x;
    // Taylor's: what comes next is at most 7e-12 and 4e-13.
    let sine =
        ((((-1.0 / 39_916_800.0 * z + 1.0 / 362_880.0) * z - 1.0 / 5_040.0) * z + 1.0 / 120.0) * z - 1.0 / 6.0) * z * x
            + x;
    let cosine = (((((1.0 / 479_001_600.0 * z - 1.0 / 3_628_800.0) * z + 1.0 / 40_320.0) * z - 1.0 / 720.0) * z
        + 1.0 / 24.0)
        * z
        - 0.5)
        * z
        + 1.0;
    let (sine, cosine) = if quarter & 1 == 0 { (sine, cosine) } else { (cosine, sine) };
    (if quarter & 2 == 0 { sine } else { -sine }, if quarter.wrapping_add(1) & 2 == 0 { cosine } else { -cosine })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arctangents_are_within_the_bound_all_around_and_exact_on_the_axes() {
        let mut worst = 0.0f64;
        for i in 0..1_000_000 {
            let angle = std::f64::consts::TAU * f64::from(i) / 1e6;
            let size = [1.0, 1e-12, 1e12][i as usize % 3];
            let (y, x) = ((size * angle.sin()) as f32, (size * angle.cos()) as f32);
            worst = worst.max((f64::from(arctangent(y, x)) - f64::from(y).atan2(f64::from(x))).abs());
        }
        assert!(worst < 3e-7, "{worst:e}");
        for (y, x, truth) in
            [(0.0, 2.0, 0.0), (3.0, 0.0, FRAC_PI_2), (-3.0, 0.0, -FRAC_PI_2), (0.0, -2.0, PI), (0.0, 0.0, 0.0)]
        {
            assert_eq!(arctangent(y, x), truth, "{y} {x}");
        }
        // Of one angle by its own size: small ones keep their digits.
        for x in [1e-3f32, 1e-10, 1e-30] {
            assert!((arctangent(x, 1.0) / x - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn sines_and_cosines_are_within_the_bound_and_exact_at_quarters() {
        let mut worst = 0.0f64;
        for i in -1_000_000..1_000_000 {
            let turns = f64::from(i) / 999_983.0 * if i % 2 == 0 { 1.0 } else { 100.0 };
            let (sine, cosine) = sine_cosine(turns);
            let angle = std::f64::consts::TAU * (turns - turns.round());
            worst = worst.max((sine - angle.sin()).abs()).max((cosine - angle.cos()).abs());
        }
        assert!(worst < 2e-11, "{worst:e}");
        for (quarter, truth) in [(0.0, 1.0), (1.0, 0.0), (0.0, -1.0), (-1.0, 0.0)].into_iter().enumerate() {
            assert_eq!(sine_cosine(0.25 * quarter as f64 - 7.0), truth);
        }
    }
}
