//! A 3-D texture as a graphics processor filters it.

/// RGBA texels; x runs fastest, then y, then z.
pub(crate) struct Texture {
    pub size: [usize; 3],
    pub texels: Vec<[f32; 4]>,
}

impl Texture {
    /// The value at texture coordinates (0..=1 from edge to edge): linear between the eight texel centres around,
    /// clamped to the edge.
    ///
    /// Based on: Vulkan 1.3, "Texel filtering", eqs. for linear filtering and `CLAMP_TO_EDGE`; here with exact weights,
    /// where hardware has 8 bits of fraction.
    pub fn sample(&self, uvw: [f64; 3]) -> [f64; 4] {
        let place: [f64; 3] = std::array::from_fn(|k| uvw[k] * self.size[k] as f64 - 0.5);
        let mut sum = [0.0; 4];
        for corner in 0..8 {
            let mut weight = 1.0;
            let texel: [usize; 3] = std::array::from_fn(|k| {
                let (low, share) = (place[k].floor(), place[k] - place[k].floor());
                let higher = corner >> k & 1 == 1;
                weight *= if higher { share } else { 1.0 - share };
                let index = if higher { low + 1.0 } else { low };
                index.clamp(0.0, (self.size[k] - 1) as f64) as usize
            });
            let value = self.texels[texel[0] + self.size[0] * (texel[1] + self.size[1] * texel[2])];
            for (sum, value) in sum.iter_mut().zip(value) {
                *sum += weight * f64::from(value);
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sample_is_linear_between_centres_and_constant_beyond() {
        let size = [4, 3, 2];
        let texel = |i: usize| [(i % 4) as f32, (i / 4 % 3) as f32, (i / 12) as f32, 1.0];
        let texture = Texture { size, texels: (0..24).map(texel).collect() };
        let [x, y, z, w] = texture.sample([1.75 / 4.0, 1.0 / 3.0, 0.5]);
        assert!((x - 1.25).abs() < 1e-12 && (y - 0.5).abs() < 1e-12 && (z - 0.5).abs() < 1e-12 && w == 1.0);
        assert_eq!(texture.sample([0.01, -3.0, 9.0]), [0.0, 0.0, 1.0, 1.0]);
    }
}
