//! From linear radiance to what a screen shows: exposure, tone mapping, sRGB.
//!
//! Based on: Khronos Group, "Khronos PBR Neutral Tone Mapper", 2024 (colours under its shoulder stay as they are, so
//! that a white wall is as white as its material says); IEC 61966-2-1 (sRGB).

use glam::Vec3;

use crate::panorama::Image;

/// Luminance that the mean of a picture becomes: photography's middle grey.
const MIDDLE_GREY: f64 = 0.18;

/// Stops that bring the picture's log-mean luminance to middle grey, to a hundredth, so that who reads the number can
/// ask for the same picture again. Black pixels do not count; 0 where all are. Based on: Reinhard et al., "Photographic
/// Tone Reproduction for Digital Images", 2002, eq. 1.
pub fn automatic_exposure_stops(image: &Image) -> f32 {
    let luminances = image.pixels.iter().map(|p| {
        let [r, g, b] = p.map(f64::from);
        0.2126 * r + 0.7152 * g + 0.0722 * b
    });
    let (sum, count) =
        luminances.filter(|l| *l > 0.0).fold((0.0, 0.0), |(sum, count), l| (sum + l.log2(), count + 1.0));
    if count == 0.0 { 0.0 } else { ((MIDDLE_GREY.log2() - sum / count) * 100.0).round() as f32 / 100.0 }
}

/// The picture for a screen: radiance × 2^`exposure_stops`, tone-mapped, sRGB, 8 bit.
pub fn display(image: &Image, exposure_stops: f32) -> Vec<[u8; 3]> {
    let gain = exposure_stops.exp2();
    let pixel = |p: &[f32; 3]| pbr_neutral((Vec3::from(*p) * gain).min(Vec3::splat(f32::MAX))).to_array().map(srgb);
    image.pixels.iter().map(pixel).collect()
}

/// Colours that are meant as they are, 0..=1: sRGB, 8 bit.
pub fn plain(image: &Image) -> Vec<[u8; 3]> {
    image.pixels.iter().map(|pixel| pixel.map(srgb)).collect()
}

/// Khronos PBR Neutral: 0.. → 0..1 per channel. The constants are the specification's.
fn pbr_neutral(color: Vec3) -> Vec3 {
    const FRESNEL: f32 = 0.04;
    const START: f32 = 0.8 - FRESNEL;
    const DESATURATION: f32 = 0.15;
    // What a glossy white surface reflects like a mirror is taken off, the more gently the darker.
    let least = color.min_element();
    let offset = if least < 2.0 * FRESNEL { least - least * least / (4.0 * FRESNEL) } else { FRESNEL };
    let color = color - offset;
    let peak = color.max_element();
    if peak < START {
        return color;
    }
    // The shoulder: what is brighter comes ever closer to 1, and to white.
    let room = 1.0 - START;
    let compressed = 1.0 - room * room / (peak + room - START);
    let color = color * (compressed / peak);
    let white = 1.0 - 1.0 / (DESATURATION * (peak - compressed) + 1.0);
    color.lerp(Vec3::splat(compressed), white)
}

/// Linear 0..=1 → sRGB byte.
fn srgb(linear: f32) -> u8 {
    let linear = linear.clamp(0.0, 1.0);
    let encoded = if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 };
    (encoded * 255.0).round() as u8
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(values: &[f32]) -> Image {
        Image::new(values.len(), 1, values.iter().map(|v| [*v; 3]).collect())
    }

    #[test]
    fn automatic_exposure_makes_the_log_mean_middle_grey() {
        assert_eq!(automatic_exposure_stops(&grey(&[0.18, 0.18])), 0.0);
        assert_eq!(automatic_exposure_stops(&grey(&[0.09, 0.36])), 0.0, "the log-mean");
        assert_eq!(automatic_exposure_stops(&grey(&[1.44, 0.0, 1.44])), -3.0, "black pixels do not count");
        assert_eq!(automatic_exposure_stops(&grey(&[0.0])), 0.0);
        // Red counts by its luminance.
        let red = Image::new(1, 1, vec![[0.18 / 0.2126, 0.0, 0.0]]);
        assert_eq!(automatic_exposure_stops(&red), 0.0);
    }

    #[test]
    fn tone_mapping_is_the_specifications() {
        // Under the shoulder: the colour less 0.04, gently so in the dark.
        assert!((pbr_neutral(Vec3::new(0.5, 0.2, 0.3)) - Vec3::new(0.46, 0.16, 0.26)).length() < 1e-6);
        assert!((pbr_neutral(Vec3::splat(0.04)) - Vec3::splat(0.01)).length() < 1e-6);
        assert_eq!(pbr_neutral(Vec3::ZERO), Vec3::ZERO);
        // Grey stays grey; 1 - 0.24² / (0.96 + 0.24 - 0.76) for white.
        assert!((pbr_neutral(Vec3::ONE) - Vec3::splat(1.0 - 0.0576 / 0.44)).length() < 1e-6);
        // It grows and stays under 1, and a bright colour fades to white.
        let mut last = -1.0;
        for stop in -20..120 {
            let mapped = pbr_neutral(Vec3::new(1.0, 0.5, 0.0) * (stop as f32 / 2.0).exp2());
            assert!(mapped.is_finite() && mapped.x > last - 1e-6 && mapped.x <= 1.0, "{stop}: {mapped}");
            last = mapped.x;
        }
        assert!(pbr_neutral(Vec3::new(1e4, 0.0, 0.0)).y > 0.9);
    }

    #[test]
    fn display_encodes_srgb_and_never_overflows() {
        // 0.22 - 0.04 = 0.18 is byte 118, black is 0; a stop up is twice the light.
        assert_eq!(display(&grey(&[0.22, 0.0]), 0.0), [[118; 3], [0; 3]]);
        assert_eq!(display(&grey(&[0.11]), 1.0), [[118; 3]]);
        assert_eq!(display(&grey(&[f32::MAX]), 100.0), [[255; 3]]);
        assert_eq!([0.0, 1.0].map(srgb), [0, 255]);
    }
}
