//! Spherical harmonics: the basis, and radiance and irradiance written in it.
//!
//! Real, orthonormal, without the Condon-Shortley sign; function (l, m) has the index l(l+1)+m. The polynomials in a
//! unit direction (x, y, z), from band 0: 1, y, z, x, xy, yz, 3z²-1, xz, x²-y², … each positive where x, y and z are
//! positive and its factors are. Bands 0..=4: 25 functions. "L2" means all bands up to 2, 9 functions.
//!
//! Radiance and irradiance are two types with the same bytes. For radiance L the coefficients are
//! `L_lm = ∫ L(ω) Y_lm(ω) dω`. The irradiance on a surface with the normal n is its convolution with a clamped cosine,
//! `E(n) = ∫ L(ω) max(n·ω, 0) dω = Σ A_l L_lm Y_lm(n)`, A = π, 2π/3, π/4, 0, -π/24.
//! A Lambertian surface then reflects `diffuse = albedo / PI * irradiance`: the 1/π is the caller's, never in here.
//!
//! Based on: R. Ramamoorthi and P. Hanrahan, "On the relationship between radiance and irradiance" (2001), eqs. 19 to
//! 24; P.-P. Sloan, "Stupid Spherical Harmonics (SH) Tricks" (2008), appendix A2, less its signs.

use crate::math::{power, square_root};
use core::f32::consts::PI;

/// The highest band known.
pub const MAX_BANDS: u32 = 4;

/// How many coefficients bands 0 to [`MAX_BANDS`] have.
pub const MAX_COEFFICIENTS: usize = coefficient_count(MAX_BANDS);

/// The constant basis function, sqrt(1/4π).
pub const Y00: f32 = 0.282_094_79;

/// A_l: what a clamped cosine does to band l.
pub const COSINE: [f32; 5] = [PI, 2.0 * PI / 3.0, PI / 4.0, 0.0, -PI / 24.0];

/// [`COSINE`] for each coefficient.
pub(crate) const COSINE_OF: [f32; MAX_COEFFICIENTS] = {
    let mut factors = [0.0; MAX_COEFFICIENTS];
    let mut index = 0;
    while index < MAX_COEFFICIENTS {
        factors[index] = COSINE[band_of(index)];
        index += 1;
    }
    factors
};

/// How many coefficients bands 0 to `bands` have: (bands + 1)².
///
/// # Panics
/// If `bands` is above [`MAX_BANDS`].
pub const fn coefficient_count(bands: u32) -> usize {
    assert!(bands <= MAX_BANDS, "there are bands 0 to 4");
    ((bands + 1) * (bands + 1)) as usize
}

/// The band that coefficient `index` belongs to.
pub const fn band_of(index: usize) -> usize {
    index.isqrt()
}

/// The basis functions of bands 0 to `bands` in a unit `direction`: the first [`coefficient_count`] of `out`. The
/// others are left as they are.
///
/// # Panics
/// If `bands` is above [`MAX_BANDS`].
#[inline]
pub fn basis(bands: u32, direction: [f32; 3], out: &mut [f32; MAX_COEFFICIENTS]) {
    assert!(bands <= MAX_BANDS, "there are bands 0 to 4, not {bands}");
    let [x, y, z] = direction;
    out[0] = 0.282_094_79; // sqrt(1 / 4π)
    if bands == 0 {
        return;
    }
    out[1] = 0.488_602_5 * y; // sqrt(3 / 4π)
    out[2] = 0.488_602_5 * z;
    out[3] = 0.488_602_5 * x;
    if bands == 1 {
        return;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (xy, yz, xz) = (x * y, y * z, x * z);
    out[4] = 1.092_548_4 * xy; // sqrt(15 / 4π)
    out[5] = 1.092_548_4 * yz;
    out[6] = 0.315_391_57 * (3.0 * zz - 1.0); // sqrt(5 / 16π)
    out[7] = 1.092_548_4 * xz;
    out[8] = 0.546_274_2 * (xx - yy); // sqrt(15 / 16π)
    if bands == 2 {
        return;
    }
    // r cos 3φ and r sin 3φ over r³, r² = x² + y².
    let cosine_3 = x * (xx - 3.0 * yy);
    let sine_3 = y * (3.0 * xx - yy);
    out[9] = 0.590_043_6 * sine_3; // sqrt(35 / 32π)
    out[10] = 2.890_611_4 * xy * z; // sqrt(105 / 4π)
    out[11] = 0.457_045_8 * y * (5.0 * zz - 1.0); // sqrt(21 / 32π)
    out[12] = 0.373_176_33 * z * (5.0 * zz - 3.0); // sqrt(7 / 16π)
    out[13] = 0.457_045_8 * x * (5.0 * zz - 1.0);
    out[14] = 1.445_305_7 * z * (xx - yy); // sqrt(105 / 16π)
    out[15] = 0.590_043_6 * cosine_3;
    if bands == 3 {
        return;
    }
    out[16] = 2.503_343 * xy * (xx - yy); // sqrt(315 / 16π)
    out[17] = 1.770_130_8 * z * sine_3; // sqrt(315 / 32π)
    out[18] = 0.946_174_7 * xy * (7.0 * zz - 1.0); // sqrt(45 / 16π)
    out[19] = 0.669_046_5 * yz * (7.0 * zz - 3.0); // sqrt(45 / 32π)
    out[20] = 0.105_785_55 * ((35.0 * zz - 30.0) * zz + 3.0); // sqrt(9 / 256π)
    out[21] = 0.669_046_5 * xz * (7.0 * zz - 3.0);
    out[22] = 0.473_087_35 * (xx - yy) * (7.0 * zz - 1.0); // sqrt(45 / 64π)
    out[23] = 1.770_130_8 * z * cosine_3;
    out[24] = 0.625_835_7 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy)); // sqrt(315 / 256π)
}

macro_rules! sh_type {
    ($(#[$documentation:meta])* $name:ident) => {
        $(#[$documentation])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[repr(C)]
        pub struct $name {
            /// The highest band, 0..=4.
            pub bands: u32,
            /// RGB per coefficient, index l(l+1)+m; 0 above `bands`.
            pub coefficients: [[f32; 3]; MAX_COEFFICIENTS],
        }

        impl $name {
            /// Darkness, with bands 0 to `bands`.
            pub const fn zero(bands: u32) -> $name {
                assert!(bands <= MAX_BANDS, "there are bands 0 to 4");
                $name { bands, coefficients: [[0.0; 3]; MAX_COEFFICIENTS] }
            }

            /// Adds `weight` times `other`; the result has the bands of whichever has more.
            pub fn add_scaled(&mut self, other: &$name, weight: f32) {
                self.bands = self.bands.max(other.bands);
                for (sum, term) in self.coefficients.iter_mut().zip(&other.coefficients) {
                    for c in 0..3 {
                        sum[c] += weight * term[c];
                    }
                }
            }

            /// (1 - t) self + t other, t usually 0..=1.
            #[must_use]
            pub fn lerp(&self, other: &$name, t: f32) -> $name {
                let mut mixed = $name::zero(self.bands);
                mixed.add_scaled(self, 1.0 - t);
                mixed.add_scaled(other, t);
                mixed
            }

            /// The same without the bands above `bands`.
            #[must_use]
            pub fn truncate(mut self, bands: u32) -> $name {
                self.bands = self.bands.min(bands);
                self.coefficients[coefficient_count(self.bands)..].fill([0.0; 3]);
                self
            }

            fn sum(&self, direction: [f32; 3]) -> [f32; 3] {
                let mut basis_values = [0.0; MAX_COEFFICIENTS];
                basis(self.bands, direction, &mut basis_values);
                let mut sum = [0.0; 3];
                let count = coefficient_count(self.bands);
                for (coefficient, value) in self.coefficients[..count].iter().zip(basis_values) {
                    for c in 0..3 {
                        sum[c] += coefficient[c] * value;
                    }
                }
                sum
            }
        }
    };
}

sh_type! {
    /// Radiance over all directions, linear Rec.709.
    RadianceSh
}

sh_type! {
    /// Irradiance over all normals, linear Rec.709: [`RadianceSh::convolve`] makes it.
    /// `diffuse = albedo / PI * irradiance`.
    IrradianceSh
}

impl RadianceSh {
    /// The radiance arriving from a unit `direction`, as far as the bands can tell. May be negative beside something
    /// bright: a few bands ring.
    pub fn evaluate(&self, direction: [f32; 3]) -> [f32; 3] {
        self.sum(direction)
    }

    /// Radiance to irradiance: band l times A_l. The one place where this happens.
    #[must_use]
    pub fn convolve(&self) -> IrradianceSh {
        let mut irradiance = IrradianceSh::zero(self.bands);
        let count = coefficient_count(self.bands);
        for (index, coefficient) in self.coefficients[..count].iter().enumerate() {
            irradiance.coefficients[index] = coefficient.map(|value| COSINE_OF[index] * value);
        }
        irradiance
    }

    /// Irradiance on a surface with the unit `normal`, from bands 0 and 1 alone, never negative.
    ///
    /// The linear sum of L1 is off by 20 % of E on real HDR environments and goes negative; this lobe of the same mean
    /// and direction is off by 10 %. With C0 and C1 = (c3, c1, c2) of a channel:
    /// ```text
    /// r = |C1| / (√3 C0)     0 for light from everywhere alike, 1 for light from one direction
    /// q = (1 + n·C1/|C1|) / 2,   p = 1 + 2r,   a = (1 - r) / (1 + r)
    /// E = π Y00 C0 (a + (1 - a) (p + 1) q^p)
    /// ```
    /// A channel with C0 <= 0 gives 0; r is held at 1; where C1 is 0 the lobe is a constant. On a function of bands 0
    /// and 1 it agrees with `convolve().evaluate(normal)` to first order in r.
    ///
    /// Of coefficients as projected: de-ringed ones have r at 1/2 or less, and make the lobe too flat.
    ///
    /// Based on: G. Hazel, "Reconstructing diffuse lighting from spherical harmonic data" (2018); his R1 is half of a
    /// mean radiance's gradient, hence the 1/√3 for an orthonormal basis.
    pub fn irradiance_l1_nonlinear(&self, normal: [f32; 3]) -> [f32; 3] {
        const SQRT_3: f32 = 1.732_050_8;
        core::array::from_fn(|c| {
            let c0 = self.coefficients[0][c];
            if c0 <= 0.0 || c0.is_nan() {
                return 0.0;
            }
            let c1 = [3, 1, 2].map(|index: usize| self.coefficients[index][c]);
            let squared: f64 = c1.iter().map(|&v| f64::from(v) * f64::from(v)).sum();
            let length = square_root(squared) as f32;
            let mut lobe = 1.0;
            if length > 0.0 {
                let r = (length / (SQRT_3 * c0)).min(1.0);
                let cosine = (0..3).map(|k| normal[k] * (c1[k] / length)).sum::<f32>();
                let q = (0.5 * (1.0 + cosine)).clamp(0.0, 1.0);
                let p = 1.0 + 2.0 * r;
                let a = (1.0 - r) / (1.0 + r);
                lobe = a + (1.0 - a) * (p + 1.0) * power(q, p);
            }
            PI * Y00 * c0 * lobe
        })
    }
}

impl IrradianceSh {
    /// The irradiance on a surface with the unit `normal`: what falls on it, so
    /// `diffuse = albedo / PI * irradiance`.
    ///
    /// Not clamped: on the side away from something very bright the bands may ring below 0 (L2 by some 2 % of the
    /// mean on real HDR environments, L1 by up to 70 %). Clamp where you shade, not where you still add lights up. Volumes
    /// whose header [says so](crate::Header::is_deringed) do not ring.
    pub fn evaluate(&self, normal: [f32; 3]) -> [f32; 3] {
        self.sum(normal)
    }
}

#[cfg(test)]
mod tests;
