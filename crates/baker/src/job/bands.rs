//! How many bands of spherical harmonics a baked volume needs: what is off without the higher ones, node by node.
//!
//! Irradiance has few: of band 3 nothing, of band 4 at most a few per cent. How little bands 1 and 2 are needed depends on the light:
//! under a sky without a sun L1 may do, in a fog L0.

use gdibl_runtime::sh;
use serde::Serialize;

use super::records::ErrorSummary;
use crate::bake::Baked;
use crate::rows::Table;

/// What fewer bands lose.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Truncation {
    /// Highest band that is left.
    pub bands: u32,
    /// Of irradiance at valid nodes against that of all bands: root mean square over normals and channels, over the larger of the
    /// node's own and a tenth of the volume's median.
    pub error: ErrorSummary,
}

/// What each number of bands loses that is less than the volume has, and says something that fewer do not. Empty without a valid
/// node.
pub fn truncations(baked: &Baked) -> Vec<Truncation> {
    // Per node and band: Σ (A_l L_lm)², which is that of irradiance over all normals. Found anew each time, not kept: a level of a
    // million nodes would take as much memory for it as for its file.
    let powers = || baked.valid_nodes().map(|node| band_powers(&baked.node(node)));
    let mut sizes: Vec<f64> = powers().map(|powers| powers.iter().sum::<f64>().sqrt()).collect();
    if sizes.is_empty() {
        return Vec::new();
    }
    let middle = sizes.len() / 2;
    let floor = 0.1 * *sizes.select_nth_unstable_by(middle, f64::total_cmp).1;
    drop(sizes);
    let error = |powers: BandPowers, bands: u32| {
        let lost = powers[bands as usize + 1..].iter().sum::<f64>().sqrt();
        let size = powers.iter().sum::<f64>().sqrt().max(floor);
        if lost == 0.0 { 0.0 } else { lost / size }
    };
    let bands = (0..baked.bands).filter(|bands| sh::COSINE[*bands as usize] != 0.0);
    bands
        .filter_map(|bands| {
            let error = ErrorSummary::of(powers().map(|powers| error(powers, bands)))?;
            Some(Truncation { bands, error })
        })
        .collect()
}

/// 0 in those above the volume's.
type BandPowers = [f64; sh::MAX_BANDS as usize + 1];

fn band_powers(radiance: &[f32]) -> BandPowers {
    let mut powers = BandPowers::default();
    for (index, rgb) in radiance.chunks_exact(3).enumerate() {
        let band = sh::band_of(index);
        powers[band] += rgb.iter().map(|value| (f64::from(sh::COSINE[band]) * f64::from(*value)).powi(2)).sum::<f64>();
    }
    powers
}

/// The fewest bands with which 95 % of the nodes are right to `tolerance`; `all` if none are.
pub fn fewest(truncations: &[Truncation], tolerance: f64, all: u32) -> u32 {
    truncations.iter().find(|truncation| truncation.error.p95 <= tolerance).map_or(all, |truncation| truncation.bands)
}

/// The same volume with fewer bands.
pub fn truncate(baked: &mut Baked, bands: u32) {
    let [from, to] = [baked.bands, bands].map(|bands| 3 * sh::coefficient_count(bands));
    let errors = &mut baked.coefficient_error;
    *errors = errors.chunks_exact(from).flat_map(|node| &node[..to]).copied().collect();
    baked.sh = std::mem::replace(&mut baked.sh, Table::held(to, Vec::new())).narrowed(to);
    baked.bands = bands;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn volume(nodes: &[Vec<f32>]) -> Baked {
        Baked::of_rows(4, Table::held(nodes[0].len(), nodes.concat()))
    }

    /// Radiance of each band's first coefficient, grey.
    fn node(bands: [f32; 5]) -> Vec<f32> {
        let mut values = vec![0.0; 75];
        for (band, value) in bands.into_iter().enumerate() {
            values[3 * band * band..3 * band * band + 3].fill(value);
        }
        values
    }

    #[test]
    fn errors_are_those_of_irradiance_and_the_fewest_bands_are_found() {
        // E: band 0 times pi, band 1 times 2/3 pi, band 2 times a quarter of it.
        let baked = volume(&[node([1.0, 0.15, 0.08, 5.0, 0.0])]);
        let found = truncations(&baked);
        assert_eq!(found.iter().map(|t| t.bands).collect::<Vec<_>>(), [0, 1, 2]);
        let [e0, e1, e2] = [1.0f64, 0.1, 0.02];
        let size = (e0 * e0 + e1 * e1 + e2 * e2).sqrt();
        let expected = [(e1 * e1 + e2 * e2).sqrt() / size, e2 / size, 0.0];
        for (truncation, expected) in found.iter().zip(expected) {
            assert!((truncation.error.max - expected).abs() < 1e-6, "{truncation:?} {expected}");
        }
        assert_eq!([0.2, 0.05, 0.01].map(|tolerance| fewest(&found, tolerance, 4)), [0, 1, 2]);
        // Band 3 adds nothing to irradiance, band 4 does.
        let with_band_4 = volume(&[node([1.0, 0.0, 0.0, 0.0, 2.0])]);
        assert_eq!(fewest(&truncations(&with_band_4), 0.01, 4), 4);
        // A dark node is not held to its own light.
        let dark = volume(
            &[node([1.0, 0.0, 0.0, 0.0, 0.0]), node([1e-3, 1e-3, 0.0, 0.0, 0.0])]
                .concat()
                .chunks(75)
                .map(<[f32]>::to_vec)
                .collect::<Vec<_>>(),
        );
        assert!(truncations(&dark)[0].error.max < 0.01);
    }

    #[test]
    fn truncating_keeps_the_lower_bands() {
        let mut baked = volume(&[node([1.0, 2.0, 3.0, 4.0, 5.0]), node([6.0, 7.0, 8.0, 9.0, 1.0])]);
        truncate(&mut baked, 1);
        assert_eq!((baked.bands, baked.sh.width()), (1, 12));
        assert_eq!((baked.node(0)[3], baked.node(1)[0], baked.node(1)[5]), (2.0, 6.0, 7.0));
    }
}
