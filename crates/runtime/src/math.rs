//! Square roots and powers, from the standard library, from libm, or from here.
//!
//! `core` has neither. The crate needs them in two places only (the length of a vector, and the exponent of
//! [`RadianceSh::irradiance_l1_nonlinear`](crate::RadianceSh::irradiance_l1_nonlinear)), so the own versions aim at
//! being short and sure, not fast. Bounds, tested below: relative error 1e-15 for `square_root`, 1e-6 for `power`.

#[cfg(feature = "std")]
mod chosen {
    pub(crate) fn square_root(x: f64) -> f64 {
        x.sqrt()
    }
    pub(crate) fn power(x: f32, exponent: f32) -> f32 {
        x.powf(exponent)
    }
}

#[cfg(all(feature = "libm", not(feature = "std")))]
mod chosen {
    pub(crate) fn square_root(x: f64) -> f64 {
        libm::sqrt(x)
    }
    pub(crate) fn power(x: f32, exponent: f32) -> f32 {
        libm::powf(x, exponent)
    }
}

#[cfg(not(any(feature = "std", feature = "libm")))]
use own as chosen;

pub(crate) use chosen::{power, square_root};

#[cfg(any(test, not(any(feature = "std", feature = "libm"))))]
mod own {
    /// The square root: NaN for negative input.
    pub(crate) fn square_root(x: f64) -> f64 {
        const TWO_TO_120: f64 = (1u128 << 120) as f64;
        const TWO_TO_60: f64 = (1u64 << 60) as f64;
        if x < 0.0 {
            return f64::NAN;
        }
        if !(x > 0.0 && x < f64::INFINITY) {
            return x; // 0, infinity, NaN
        }
        if x < f64::MIN_POSITIVE {
            return square_root(x * TWO_TO_120) / TWO_TO_60;
        }
        // Half the exponent, by halving the bits: within 6 %. Each step of Newton's method doubles the digits.
        let mut root = f64::from_bits((x.to_bits() >> 1) + (1023 << 51));
        for _ in 0..5 {
            root = 0.5 * (root + x / root);
        }
        root
    }

    /// x^exponent for x >= 0; 0 where x is not positive.
    pub(crate) fn power(x: f32, exponent: f32) -> f32 {
        if exponent == 0.0 || x == 1.0 {
            return 1.0;
        }
        if x <= 0.0 {
            return 0.0;
        }
        exp2(f64::from(exponent) * log2(f64::from(x))) as f32
    }

    /// log2 of a positive f32 given as f64. With x = m 2^k, m in [0.7, 1.42): k + 2/ln 2 · atanh((m - 1) / (m + 1)).
    fn log2(x: f64) -> f64 {
        if !x.is_finite() {
            return x;
        }
        let bits = x.to_bits();
        let mut exponent = (bits >> 52) as i64 - 1023;
        let mut mantissa = f64::from_bits((bits & ((1 << 52) - 1)) | (1023 << 52));
        if mantissa > core::f64::consts::SQRT_2 {
            mantissa *= 0.5;
            exponent += 1;
        }
        let s = (mantissa - 1.0) / (mantissa + 1.0);
        let s2 = s * s;
        // The series of atanh; the first term left out is below 1e-12.
        let mut sum = 0.0;
        for k in (0..7).rev() {
            sum = sum * s2 + 1.0 / f64::from(2 * k + 1);
        }
        exponent as f64 + 2.0 * s * sum * core::f64::consts::LOG2_E
    }

    /// 2^t: the whole part goes into the exponent, the rest through the series of e^x.
    fn exp2(t: f64) -> f64 {
        if t.is_nan() {
            return t;
        }
        if t < -1000.0 {
            return 0.0;
        }
        if t > 1000.0 {
            return f64::INFINITY;
        }
        let whole = if t < 0.0 { t - 0.5 } else { t + 0.5 } as i64;
        let x = (t - whole as f64) * core::f64::consts::LN_2;
        let mut sum = 1.0;
        for k in (1..=11).rev() {
            sum = 1.0 + sum * x / f64::from(k);
        }
        sum * f64::from_bits(((whole + 1023) as u64) << 52)
    }
}

#[cfg(test)]
mod tests {
    use super::own;

    #[test]
    fn own_square_root_is_within_its_bound() {
        let mut x = 4e-324_f64;
        while x < 1e308 {
            let (found, truth) = (own::square_root(x), x.sqrt());
            assert!((found - truth).abs() <= 1e-15 * truth, "{x:e}: {found} {truth}");
            x *= 1.37;
            if x < 1e-322 {
                x *= 2.0;
            }
        }
        assert_eq!(own::square_root(0.0), 0.0);
        assert_eq!(own::square_root(f64::INFINITY), f64::INFINITY);
        assert!(own::square_root(-1.0).is_nan());
        assert!(own::square_root(f64::NAN).is_nan());
    }

    #[test]
    fn own_power_is_within_its_bound() {
        for i in 0..=2000 {
            let x = i as f32 / 1000.0;
            for j in 1..=40 {
                let exponent = j as f32 / 10.0;
                let (found, truth) = (own::power(x, exponent), x.powf(exponent));
                assert!((found - truth).abs() <= 1e-6 * truth, "{x}^{exponent}: {found} {truth}");
            }
        }
        assert_eq!(own::power(1e-30, 3.0), 0.0);
        assert_eq!(own::power(0.0, 0.0), 1.0);
        assert_eq!(own::power(f32::INFINITY, 2.0), f32::INFINITY);
    }
}
