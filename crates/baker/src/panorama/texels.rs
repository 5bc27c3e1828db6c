//! The pixels of a panorama as lookups read them: radiance beside distance, in half floats where those hold them without loss.
//!
//! HDR files hold 8 binary digits of a number, most OpenEXR files and all captured probes 11: halves have those, as far as
//! a panorama's light spans no more than some 2^30. Any other is held in full.

use glam::Vec4;

/// R, G, B and distance of each pixel; without distances all are infinite.
#[derive(Debug, Clone)]
pub(super) struct Texels {
    numbers: Numbers,
    /// What a number of 1 stands for.
    unit: Vec4,
}

#[derive(Debug, Clone)]
enum Numbers {
    /// Bits of half floats, none negative. Distances from 65 536 on are infinite.
    Half(Vec<[u16; 4]>),
    Full(Vec<[f32; 4]>),
}

/// What brings the exponent of a half float, moved to where a float has its own, to the right place.
const EXPONENT: f32 = f32::from_bits((127 + 127 - 15) << 23);
/// Bits of an infinite half float.
const INFINITE: u16 = 0x7c00;
/// What an infinite half float would be if its exponent were an ordinary one.
const BEYOND: f32 = 65_536.0;

impl Texels {
    /// As many distances as pixels, or none.
    pub fn new(pixels: &[[f32; 3]], distances: Option<&[f32]>) -> Texels {
        // A power of two that takes the brightest as far up as halves reach: so the darkest has the most room below.
        let brightest = pixels.iter().flatten().fold(0.0f32, |most, value| most.max(*value));
        let unit = f32::from_bits(brightest.max(1e-30).to_bits() & f32::INFINITY.to_bits()) / 32_768.0;
        let distance = |i: usize| distances.map_or(f32::INFINITY, |distances| distances[i]);
        let texels = pixels.iter().enumerate().map(|(i, [r, g, b])| [*r, *g, *b, distance(i)]);
        let in_units = |[r, g, b, distance]: [f32; 4]| [r / unit, g / unit, b / unit, distance];
        // Asked of all first: so the halves are not moved while they become more.
        if texels.clone().all(|texel| in_units(texel).map(halve).map(whole) == in_units(texel)) {
            let halves = texels.map(|texel| in_units(texel).map(halve)).collect();
            Texels { numbers: Numbers::Half(halves), unit: Vec4::new(unit, unit, unit, 1.0) }
        } else {
            Texels { numbers: Numbers::Full(texels.collect()), unit: Vec4::ONE }
        }
    }

    /// R, G, B and distance of some pixels.
    #[inline(always)]
    pub fn at<const N: usize>(&self, indices: [usize; N]) -> [Vec4; N] {
        match &self.numbers {
            Numbers::Half(texels) => indices.map(|index| {
                let [r, g, b, distance] = texels[index].map(moved);
                let texel = Vec4::new(r, g, b, distance) * EXPONENT * self.unit;
                if texel.w < BEYOND { texel } else { texel.with_w(f32::INFINITY) }
            }),
            Numbers::Full(texels) => indices.map(|index| Vec4::from(texels[index]) * self.unit),
        }
    }

    /// Multiplies the radiance of all pixels, channel by channel.
    pub fn tint(&mut self, gains: [f32; 3]) {
        self.unit *= Vec4::new(gains[0], gains[1], gains[2], 1.0);
    }
}

/// Bits of the half float that is `value`, without the sign of a zero; if there is none, those of another.
fn halve(value: f32) -> u16 {
    match value {
        f32::INFINITY => INFINITE,
        _ => ((value.abs() * (1.0 / EXPONENT)).to_bits() >> 13).min(u32::from(INFINITE) - 1) as u16,
    }
}

/// What the bits of a half float stand for.
fn whole(half: u16) -> f32 {
    if half == INFINITE { f32::INFINITY } else { moved(half) * EXPONENT }
}

/// The number whose exponent has the same bits, too small by [`EXPONENT`].
fn moved(half: u16) -> f32 {
    f32::from_bits(u32::from(half) << 13)
}

#[cfg(test)]
mod tests {
    use super::*;
    use half::f16;

    #[test]
    fn halves_are_those_of_the_standard() {
        for bits in 0..=INFINITE {
            assert_eq!(whole(bits), f16::from_bits(bits).to_f32());
            assert_eq!(halve(whole(bits)), bits);
        }
        for none in [1.0 / 3.0, 65_520.0, 1e30, 1e-8, -1.0] {
            assert!(whole(halve(none)) != none);
        }
    }

    fn held(texels: &Texels) -> bool {
        matches!(texels.numbers, Numbers::Half(_))
    }

    #[test]
    fn all_numbers_come_back_as_they_were() {
        // By 8 digits and a common exponent, as HDR files have them; by halves; a sun; and what halves cannot hold.
        let rgbe =
            |i: u32| std::array::from_fn(|c| ((i * 37 + 85 * c as u32) % 256) as f32 * ((i % 25) as f32 - 20.0).exp2());
        let half = |i: u32| std::array::from_fn(|c| f16::from_bits((1024 + i * 15 + c as u32) as u16).to_f32());
        let sun = |i: u32| if i == 7 { [1e5f32, 9e4, 8e4] } else { [0.25, 0.5, 0.0] };
        let bright = |i: u32| half(i).map(|v: f32| v * 1e20f32.log2().round().exp2());
        let dark = |i: u32| half(i).map(|v: f32| v * (-100f32).exp2());
        let third = |i: u32| [i as f32 / 3.0, 1.0, -0.0];
        let wide = |i: u32| if i == 7 { [1e9; 3] } else { [1e-6, 0.5, 0.0] };
        type Pixels<'a> = &'a dyn Fn(u32) -> [f32; 3];
        let cases: [(&str, bool, Pixels); 8] = [
            ("rgbe", true, &rgbe),
            ("half", true, &half),
            ("sun", true, &|i| sun(i).map(|v| f16::from_f32(v / 2.0).to_f32() * 2.0)),
            ("bright", true, &bright),
            ("dark", true, &dark),
            ("black", true, &|_| [0.0, -0.0, 0.0]),
            ("third", false, &third),
            ("wide", false, &wide),
        ];
        let metres = |i: u32| if i.is_multiple_of(3) { f32::INFINITY } else { i as f32 };
        for (name, is_half, pixel) in cases {
            for (fits, distance) in
                [(true, None), (true, Some(&metres as &dyn Fn(u32) -> f32)), (false, Some(&|i| i as f32 / 3.0))]
            {
                let pixels: Vec<[f32; 3]> = (0..1000).map(pixel).collect();
                let distances: Option<Vec<f32>> = distance.map(|distance| (0..1000).map(distance).collect());
                let mut texels = Texels::new(&pixels, distances.as_deref());
                assert_eq!(held(&texels), is_half && fits, "{name}");
                let expected = |i: usize, gains: [f32; 3]| {
                    let [r, g, b] = std::array::from_fn(|c| pixels[i][c] * gains[c]);
                    Vec4::new(r, g, b, distances.as_ref().map_or(f32::INFINITY, |d| d[i]))
                };
                for i in 0..1000 {
                    assert_eq!(texels.at([i]), [expected(i, [1.0; 3])], "{name} {i}");
                }
                texels.tint([0.5, 1.0, 4.0]);
                for i in 0..1000 {
                    assert_eq!(texels.at([i, 3])[0], expected(i, [0.5, 1.0, 4.0]), "{name} {i}");
                }
            }
        }
    }
}
