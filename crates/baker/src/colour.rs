//! Colour spaces by their CIE chromaticities, and the way from them to linear Rec.709, gdibl's own.
//!
//! A colour c of a linear space is the tristimulus value `X = P · diag(s) · c`: the columns of P are (x, y, 1 - x - y)
//! of the primaries, and s makes (1, 1, 1) the white point: `P · s = white / y_white`. The white point is adapted with
//! the cone responses of Bradford (B), so that white stays white:
//!
//! ```text
//! rec709 = M709⁻¹ · B⁻¹ · diag(B white_709 / B white) · B · M · c
//! ```
//! Based on: SMPTE RP 177 (primaries to a matrix); Lam, *Metamerism and Colour Constancy*, 1985, as in the ICC profile
//! specification, annex E (Bradford). All in f64.

use glam::{DMat3, DVec3};

/// Chromaticities (x, y) are the same within this: what the Color Interop Forum recommends to compare them with.
const SAME: f64 = 1e-3;

/// (x, y) of what red, green and blue of a space are, and of its white (1, 1, 1).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Primaries {
    pub red: [f64; 2],
    pub green: [f64; 2],
    pub blue: [f64; 2],
    pub white: [f64; 2],
}

const D65: [f64; 2] = [0.3127, 0.3290];
/// The white of ACES.
const ACES_WHITE: [f64; 2] = [0.32168, 0.33767];
const D50: [f64; 2] = [0.3457, 0.3585];

const fn primaries(red: [f64; 2], green: [f64; 2], blue: [f64; 2], white: [f64; 2]) -> Primaries {
    Primaries { red, green, blue, white }
}

impl Primaries {
    pub const REC709: Primaries = primaries([0.64, 0.33], [0.30, 0.60], [0.15, 0.06], D65);
    pub const REC2020: Primaries = primaries([0.708, 0.292], [0.170, 0.797], [0.131, 0.046], D65);
    pub const P3_D65: Primaries = primaries([0.680, 0.320], [0.265, 0.690], [0.150, 0.060], D65);
    pub const ADOBE_RGB: Primaries = primaries([0.64, 0.33], [0.21, 0.71], [0.15, 0.06], D65);
    pub const AP0: Primaries = primaries([0.7347, 0.2653], [0.0, 1.0], [0.0001, -0.0770], ACES_WHITE);
    pub const AP1: Primaries = primaries([0.713, 0.293], [0.165, 0.830], [0.128, 0.044], ACES_WHITE);
    pub const PROPHOTO: Primaries = primaries([0.7347, 0.2653], [0.1596, 0.8404], [0.0366, 0.0001], D50);
    /// CIE XYZ, whose (1, 1, 1) is the equal-energy white.
    pub const XYZ: Primaries = primaries([1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [1.0 / 3.0, 1.0 / 3.0]);

    /// The same primaries and white, within rounding.
    pub fn is_close_to(&self, other: &Primaries) -> bool {
        let all = |p: &Primaries| [p.red, p.green, p.blue, p.white];
        all(self).as_flattened().iter().zip(all(other).as_flattened()).all(|(a, b)| (a - b).abs() <= SAME)
    }

    /// The red, green and blue of both are the same; the white may differ.
    pub fn has_primaries_of(&self, other: &Primaries) -> bool {
        Primaries { white: other.white, ..*self }.is_close_to(other)
    }

    /// The matrix from this space to CIE XYZ with Y = 1 for white; `None` where the primaries span no triangle with the
    /// white point in it.
    fn to_xyz(self) -> Option<DMat3> {
        let column = |[x, y]: [f64; 2]| DVec3::new(x, y, 1.0 - x - y);
        let columns = DMat3::from_cols(column(self.red), column(self.green), column(self.blue));
        let scale = columns.inverse() * tristimulus(self.white);
        let usable = columns.determinant().abs() > 1e-6 && self.white[1] > 1e-6;
        (usable && scale.is_finite() && scale.cmpgt(DVec3::ZERO).all()).then(|| columns * DMat3::from_diagonal(scale))
    }

    /// The matrix from this space to linear Rec.709, white adapted; `None` as for primaries that span no triangle.
    pub fn to_rec709(self) -> Option<DMat3> {
        Some(xyz_to_rec709(self.white) * self.to_xyz()?)
    }
}

/// The matrix from CIE XYZ to linear Rec.709 that takes `white` to (1, 1, 1).
pub(crate) fn xyz_to_rec709(white: [f64; 2]) -> DMat3 {
    let rec709 = Primaries::REC709.to_xyz().expect("Rec.709 is a triangle around its white");
    rec709.inverse() * adaptation(white, Primaries::REC709.white)
}

/// The matrix from CIE XYZ with D65 as white to linear Rec.709.
pub(crate) fn xyz_d65_to_rec709() -> DMat3 {
    xyz_to_rec709(D65)
}

/// Bradford's adaptation of XYZ from one white point to another.
fn adaptation(from: [f64; 2], to: [f64; 2]) -> DMat3 {
    let bradford = DMat3::from_cols(
        DVec3::new(0.8951, -0.7502, 0.0389),
        DVec3::new(0.2664, 1.7135, -0.0685),
        DVec3::new(-0.1614, 0.0367, 1.0296),
    );
    let gain = (bradford * tristimulus(to)) / (bradford * tristimulus(from));
    bradford.inverse() * DMat3::from_diagonal(gain) * bradford
}

/// XYZ of a chromaticity, Y = 1.
fn tristimulus([x, y]: [f64; 2]) -> DVec3 {
    DVec3::new(x / y, 1.0, (1.0 - x - y) / y)
}

/// How numbers in a file stand for linear light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Curve {
    Linear,
    /// IEC 61966-2-1.
    Srgb,
    /// A power: light = value^gamma.
    Gamma(f64),
}

impl Curve {
    /// Linear light of an encoded value >= 0; beyond 1 the curve goes on.
    pub fn decode(self, value: f64) -> f64 {
        match self {
            Curve::Linear => value,
            Curve::Srgb if value <= 0.04045 => value / 12.92,
            Curve::Srgb => ((value + 0.055) / 1.055).powf(2.4),
            Curve::Gamma(gamma) => value.powf(gamma),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ALL: [Primaries; 8] = [
        Primaries::REC709,
        Primaries::REC2020,
        Primaries::P3_D65,
        Primaries::ADOBE_RGB,
        Primaries::AP0,
        Primaries::AP1,
        Primaries::PROPHOTO,
        Primaries::XYZ,
    ];

    #[test]
    fn white_stays_white_and_rec709_stays_itself() {
        for space in ALL {
            let white = space.to_rec709().unwrap() * DVec3::ONE;
            assert!((white - DVec3::ONE).length() < 1e-12, "{space:?}: {white}");
        }
        assert!((xyz_d65_to_rec709() * tristimulus(D65) - DVec3::ONE).length() < 1e-12);
        let same = (Primaries::REC709.to_rec709().unwrap() - DMat3::IDENTITY).to_cols_array();
        assert!(same.iter().all(|v| v.abs() < 1e-12), "{same:?}");
    }

    #[test]
    fn primaries_keep_their_chromaticity_where_the_white_is_the_same() {
        let to_xyz = Primaries::REC709.to_xyz().unwrap();
        for space in ALL.iter().filter(|space| space.white == D65) {
            let matrix = to_xyz * space.to_rec709().unwrap();
            for (column, [x, y]) in [space.red, space.green, space.blue].into_iter().enumerate() {
                let xyz = matrix.col(column);
                let sum = xyz.element_sum();
                assert!((xyz.x / sum - x).abs() < 1e-12 && (xyz.y / sum - y).abs() < 1e-12, "{space:?} {column}");
            }
        }
    }

    /// Matrices as others print them: ITU-R BT.2087, and ACEScg to Rec.709 of the ACES reference with Bradford.
    #[test]
    fn known_matrices_are_met() {
        let rows = |space: Primaries| space.to_rec709().unwrap().transpose().to_cols_array();
        let rec2020 = [1.6605, -0.5876, -0.0728, -0.1246, 1.1329, -0.0083, -0.0182, -0.1006, 1.1187];
        let ap1 = [1.70505, -0.62179, -0.08326, -0.13026, 1.14080, -0.01055, -0.02400, -0.12897, 1.15297];
        for (space, expected, digits) in [(Primaries::REC2020, rec2020, 1e-4), (Primaries::AP1, ap1, 2e-5)] {
            for (found, expected) in rows(space).iter().zip(expected) {
                assert!((found - expected).abs() < digits, "{space:?}: {found} for {expected}");
            }
        }
    }

    #[test]
    fn what_spans_no_triangle_gives_no_matrix() {
        let zero = primaries([0.0; 2], [0.0; 2], [0.0; 2], [0.0; 2]);
        let line = primaries([0.1, 0.1], [0.2, 0.2], [0.3, 0.3], D65);
        let outside = Primaries { white: [0.8, 0.1], ..Primaries::REC709 };
        let nan = Primaries { red: [f64::NAN, 0.33], ..Primaries::REC709 };
        for space in [zero, line, outside, nan] {
            assert_eq!(space.to_rec709(), None, "{space:?}");
        }
    }

    #[test]
    fn curves_decode_their_ends_and_go_on() {
        for curve in [Curve::Linear, Curve::Srgb, Curve::Gamma(2.2)] {
            assert_eq!(curve.decode(0.0), 0.0);
            assert!((curve.decode(1.0) - 1.0).abs() < 1e-15);
            assert!(curve.decode(2.0) >= 2.0);
        }
        // IEC 61966-2-1: both pieces meet.
        assert!((Curve::Srgb.decode(0.04045) - Curve::Srgb.decode(0.04045 + 1e-12)).abs() < 1e-7);
        assert!((Curve::Srgb.decode(0.5) - 0.214041).abs() < 1e-6);
    }
}
