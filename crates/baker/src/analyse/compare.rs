//! A volume, or several of one level, against truth at places: another volume's nodes, or a reference.
//!
//! Where the volume has the very places of the truth, in the same order, it is compared node against node. Else a grid is
//! sampled at them, interpolated as an engine would; points and vertices answer for the places that they hold, and no
//! others: the light of a node half a metre away says nothing about the method. What is left out is counted.
//!
//! A place is held when a node is within a millimetre of it, or a ten-thousandth of the truth's box if that is less (what
//! a round trip through text or single floats moves a place by), and, where both have a normal, faces the same way.

use gdibl_runtime::set::Share;
use gdibl_runtime::{RadianceSh, Volume, VolumeSet};
use serde::Serialize;

use super::error::{ErrorDirections, IrradianceError, Light, Pair, Tally};
use super::noise::{coefficient_variance, node_variances, sample_variance};
use super::truth::{Truth, TruthLight, TruthNoise};

/// Places are the same within this, metres, or
const REACH: f64 = 1e-3;
/// this share of the diagonal of the truth's box, whichever is less.
const REACH_SHARE: f64 = 1e-4;
/// Normals are the same within this cosine: 26°. Levels are polyhedra, references may be smooth.
const SAME_NORMAL: f32 = 0.9;
/// Places listed as worst.
const WORST: usize = 5;

/// What is judged.
#[derive(Debug, Clone, Copy)]
pub enum Found<'a> {
    /// A volume.
    Volume(&'a Volume),
    /// Several volumes of a level, as the runtime reads them.
    Set(&'a VolumeSet),
}

impl<'a> From<&'a Volume> for Found<'a> {
    fn from(volume: &'a Volume) -> Self {
        Found::Volume(volume)
    }
}

impl<'a> From<&'a VolumeSet> for Found<'a> {
    fn from(set: &'a VolumeSet) -> Self {
        Found::Set(set)
    }
}

impl Found<'_> {
    /// The most of any volume.
    fn bands(self) -> u32 {
        match self {
            Found::Volume(volume) => volume.header().bands,
            Found::Set(set) => set.volumes().map(|volume| volume.header().bands).max().unwrap_or(0),
        }
    }

    /// Variance of E of the nodes of each volume; `None` where one holds no standard errors.
    fn variances(self) -> Option<Vec<Vec<f64>>> {
        match self {
            Found::Volume(volume) => Some(vec![node_variances(volume)?]),
            Found::Set(set) => set.volumes().map(node_variances).collect(),
        }
    }
}

/// How to compare.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CompareSettings {
    /// Both sides were baked from the same seed. Nodes of the same index then took the same directions: their noise is
    /// not independent, and cannot be told from the rest.
    pub common_seed: bool,
}

/// A volume against truth.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// What bands counted.
    pub bands: BandsCompared,
    /// What places counted.
    pub places: Places,
    /// Over all sets.
    pub all: IrradianceError,
    /// Why the noise of `all` is not known; empty where it is.
    pub noise_unknown: Vec<NoiseUnknown>,
    /// Set by set; sets of which no place was compared are not here.
    pub sets: Vec<SetComparison>,
    /// The places of greatest relative error, worst first; those without error are not here.
    pub worst: Vec<WorstPlace>,
}

/// Bands on both sides; the lower of both counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct BandsCompared {
    /// Highest of the volume.
    pub found: u32,
    /// Highest of the truth; `None` where it is irradiance.
    pub truth: Option<u32>,
}

/// Where the places of the truth went.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Places {
    /// Places of the truth.
    pub truth: usize,
    /// Those that count in the error.
    pub compared: usize,
    /// Of those, where the volume has filled light alone, none of its own.
    pub filled: usize,
    /// Left out: not valid in the truth.
    pub invalid: usize,
    /// Left out: outside the box of the volume's grid.
    pub outside: usize,
    /// Left out: none of the volume's points or vertices is there.
    pub not_held: usize,
}

/// Why noise is not known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum NoiseUnknown {
    /// The volume holds no standard errors.
    Found,
    /// The truth holds none.
    Truth,
    /// Both have the same noise, see [`CompareSettings::common_seed`].
    CommonSeed,
}

/// How the volume answered for the places of a set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Answer {
    /// Both sides have the same places: node against node.
    SameNodes,
    /// From a grid, between its nodes.
    Interpolated,
    /// From those points or vertices that are there.
    Held,
}

/// One set.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SetComparison {
    /// Its name.
    pub name: String,
    /// How the volume answered.
    pub answer: Answer,
    /// Its error.
    #[serde(flatten)]
    pub error: IrradianceError,
}

/// A place and its error.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct WorstPlace {
    /// Name of the set.
    pub set: String,
    /// Index in the set.
    pub node: usize,
    /// World metres.
    pub position: [f64; 3],
    /// Root mean square difference of E, as in [`IrradianceError::per_node`].
    pub relative_error: f64,
}

/// No place could be compared: where they all went.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NothingCompared(pub Places);

impl std::error::Error for NothingCompared {}

impl std::fmt::Display for NothingCompared {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Places { truth, invalid, outside, not_held, .. } = self.0;
        write!(f, "none of the {truth} places could be compared")?;
        if outside > 0 {
            write!(f, "; {outside} are outside the box of its grid: bake one whose --bounds hold them")?;
        }
        if not_held > 0 {
            let instead = "bake a grid over them, or at these very places with --nodes points:FILE.csv";
            write!(f, "; {not_held} are not among its points or vertices: {instead}")?;
        }
        if invalid > 0 {
            write!(f, "; {invalid} are nodes that are not valid on the other side: none of them has light of its own")?;
        }
        Ok(())
    }
}

/// Compares `found` with every set of `truths`, and with all together.
pub fn compare<'a>(
    found: impl Into<Found<'a>>,
    truths: &[Truth],
    settings: &CompareSettings,
) -> Result<Comparison, NothingCompared> {
    let found = found.into();
    let directions = ErrorDirections::new();
    let variances = found.variances();
    let mut places = Places::default();
    let (mut all, mut compared, mut sets) = (Tally::default(), Vec::new(), Vec::new());
    let mut noise_unknown = Vec::new();
    for truth in truths {
        let sampler = Sampler::new(found, truth, variances.as_deref());
        let reasons = sampler.noise_unknown(truth, settings);
        let mut tally = Tally::default();
        places.truth += truth.positions.len();
        for place in 0..truth.positions.len() {
            if !truth.is_valid(place) {
                places.invalid += 1;
                continue;
            }
            let Some(sample) = sampler.sample(truth, place) else {
                *(if sampler.answer == Answer::Held { &mut places.not_held } else { &mut places.outside }) += 1;
                continue;
            };
            places.compared += 1;
            places.filled += usize::from(sample.filled);
            let bands = found.bands();
            let variance = match (sample.variance, truth_variance(truth, place, bands)) {
                (Some(found), Some(truth)) if reasons.is_empty() => Some(found + truth),
                _ => None,
            };
            let node = directions.compare(&Pair { found: sample.radiance, truth: light(truth, place), variance });
            tally.add(&node);
            all.add(&node);
            compared.push((truth, place));
        }
        if !tally.is_empty() {
            let error = tally.finish().0;
            sets.push(SetComparison { name: truth.name.clone(), answer: sampler.answer, error });
            noise_unknown.extend(reasons.into_iter().filter(|r| !noise_unknown.contains(r)).collect::<Vec<_>>());
        }
    }
    if all.is_empty() {
        return Err(NothingCompared(places));
    }
    let (error, per_node) = all.finish();
    let bands = BandsCompared { found: found.bands(), truth: truths.iter().filter_map(highest_band).max() };
    Ok(Comparison { bands, places, all: error, noise_unknown, sets, worst: worst(&compared, &per_node) })
}

/// A place of a truth that a volume answers for.
pub(super) struct Met {
    pub found: RadianceSh,
    pub truth: Light,
    /// Variance of E, mean over normals and channels, of what was found.
    pub variance: Option<f64>,
    pub truth_variance: Option<f64>,
}

/// The places that [`compare`] compares, in its order.
pub(super) fn meet(found: &Volume, truths: &[Truth]) -> Result<Vec<Met>, NothingCompared> {
    let variances = Found::Volume(found).variances();
    let mut met = Vec::new();
    for truth in truths {
        let sampler = Sampler::new(found.into(), truth, variances.as_deref());
        for place in (0..truth.positions.len()).filter(|&place| truth.is_valid(place)) {
            let Some(sample) = sampler.sample(truth, place) else { continue };
            met.push(Met {
                found: sample.radiance,
                truth: light(truth, place),
                variance: sample.variance,
                truth_variance: truth_variance(truth, place, found.header().bands),
            });
        }
    }
    // Why, `compare` knows.
    if met.is_empty() { compare(found, truths, &CompareSettings::default()).map(|_| met) } else { Ok(met) }
}

fn worst(compared: &[(&Truth, usize)], per_node: &[f64]) -> Vec<WorstPlace> {
    let mut order: Vec<usize> = (0..compared.len()).collect();
    order.sort_by(|&a, &b| per_node[b].total_cmp(&per_node[a]).then(a.cmp(&b)));
    let row = |&i: &usize| {
        let (truth, node) = compared[i];
        WorstPlace { set: truth.name.clone(), node, position: truth.positions[node], relative_error: per_node[i] }
    };
    order.iter().filter(|&&i| per_node[i] > 0.0).take(WORST).map(row).collect()
}

fn light(truth: &Truth, place: usize) -> Light {
    match &truth.light {
        TruthLight::Radiance(radiance) => Light::Radiance(radiance[place]),
        TruthLight::Irradiance(irradiance) => {
            Light::Irradiance { normal: truth.normals[place], irradiance: irradiance[place] }
        }
    }
}

fn highest_band(truth: &Truth) -> Option<u32> {
    match &truth.light {
        TruthLight::Radiance(radiance) => radiance.iter().map(|radiance| radiance.bands).max(),
        TruthLight::Irradiance(_) => None,
    }
}

/// Variance of E of the truth itself, of bands 0 to `bands`.
fn truth_variance(truth: &Truth, place: usize, bands: u32) -> Option<f64> {
    match &truth.noise {
        TruthNoise::Unknown => None,
        TruthNoise::Radiance(errors) => Some(coefficient_variance(&errors[place], bands)),
        TruthNoise::Irradiance(errors) => Some(errors[place].iter().map(|&e| f64::from(e).powi(2)).sum::<f64>() / 3.0),
        TruthNoise::Variance(variances) => Some(variances[place]),
    }
}

/// What the volume says at a place of the truth.
struct Sampled {
    radiance: RadianceSh,
    /// All of it is filled.
    filled: bool,
    variance: Option<f64>,
}

/// Asks a volume at the places of one set.
struct Sampler<'a> {
    found: Found<'a>,
    variances: Option<&'a [Vec<f64>]>,
    answer: Answer,
    /// Nodes this near are at the place, metres.
    reach: f64,
}

impl<'a> Sampler<'a> {
    fn new(found: Found<'a>, truth: &Truth, variances: Option<&'a [Vec<f64>]>) -> Sampler<'a> {
        let mut sampler = Sampler { found, variances, answer: Answer::Interpolated, reach: reach(&truth.positions) };
        if let Found::Volume(found) = found {
            let mut places = 0..truth.positions.len();
            let same = found.node_count() == places.len() && places.all(|i| sampler.holds(found, i, truth, i));
            sampler.answer = match found.grid() {
                _ if same => Answer::SameNodes,
                Some(_) => Answer::Interpolated,
                None => Answer::Held,
            };
        }
        sampler
    }

    /// Whether node `node` is at the place and faces as it does.
    fn holds(&self, found: &Volume, node: usize, truth: &Truth, place: usize) -> bool {
        let faces = match (found.node_normal(node), truth.normals.get(place)) {
            (Some(a), Some(b)) => a.iter().zip(b).map(|(a, b)| a * b).sum::<f32>() >= SAME_NORMAL,
            _ => true,
        };
        faces && distance(found.node_position(node), truth.positions[place]) <= self.reach
    }

    /// `None` where the volume has no light of that place.
    fn sample(&self, truth: &Truth, place: usize) -> Option<Sampled> {
        let position = truth.positions[place];
        let node = match (self.answer, self.found) {
            (Answer::SameNodes, Found::Volume(_)) => place,
            (Answer::Held, Found::Volume(found)) => {
                let normal = truth.normals.get(place).copied().unwrap_or_default();
                found.nearest_node(position, normal).filter(|&node| self.holds(found, node, truth, place))?
            }
            _ => return self.interpolate(position),
        };
        let Found::Volume(found) = self.found else { return None };
        Some(Sampled {
            radiance: found.node_sh(node),
            filled: !found.is_valid(node),
            variance: self.variances.map(|variances| variances[0][node]),
        })
    }

    /// Between nodes; `None` outside all boxes.
    fn interpolate(&self, position: [f64; 3]) -> Option<Sampled> {
        let normal = [0.0; 3];
        let (sample, variance) = match self.found {
            Found::Volume(found) => {
                let variance = self.variances.map(|variances| sample_variance(found, &variances[0], position));
                (found.sample_f64(position, normal), variance)
            }
            Found::Set(set) => {
                let of_share = |share: Share, variances: &[Vec<f64>]| {
                    let volume = set.volumes().nth(share.volume)?;
                    let variance = sample_variance(volume, &variances[share.volume], position);
                    Some(f64::from(share.weight).powi(2) * variance)
                };
                let variance =
                    |variances: &'a [Vec<f64>]| set.shares(position).filter_map(|s| of_share(s, variances)).sum();
                (set.sample_f64(position, normal), self.variances.map(variance))
            }
        };
        let filled = sample.validity == 0.0;
        sample.inside.then_some(Sampled { radiance: sample.sh, filled, variance })
    }

    fn noise_unknown(&self, truth: &Truth, settings: &CompareSettings) -> Vec<NoiseUnknown> {
        // Nodes of a set that are at places of the truth are not told from others.
        let is_set = matches!(self.found, Found::Set(_));
        let common = settings.common_seed && (is_set || self.answer == Answer::SameNodes);
        let reasons = [
            (self.variances.is_none(), NoiseUnknown::Found),
            (truth.noise == TruthNoise::Unknown, NoiseUnknown::Truth),
            (common, NoiseUnknown::CommonSeed),
        ];
        reasons.into_iter().filter(|(applies, _)| *applies).map(|(_, reason)| reason).collect()
    }
}

/// How near is the same place; see [`REACH`]. One place alone has no size.
fn reach(positions: &[[f64; 3]]) -> f64 {
    let bound =
        |axis: usize, least: fn(f64, f64) -> f64| positions.iter().map(|p| p[axis]).reduce(least).unwrap_or(0.0);
    let [min, max] = [f64::min, f64::max].map(|least| [0, 1, 2].map(|axis| bound(axis, least)));
    let diagonal = distance(min, max);
    let coordinate = min.iter().chain(&max).fold(0.0, |most: f64, c| most.max(c.abs()));
    // What a coordinate loses as a single float is no distance.
    let rounding = coordinate * f64::from(f32::EPSILON);
    rounding + if diagonal > 0.0 { REACH.min(REACH_SHARE * diagonal) } else { REACH }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::analyse::{choose_sets, radiance_sh};
    use crate::bake::{Baked, Nodes, Standing, grid_of_counts};
    use crate::pack::volume_of as volume;
    use crate::rows::Table;
    use glam::{DVec3, Vec3};

    /// L0 and L1, linear in the position: a grid reproduces it between its nodes.
    fn light(position: DVec3) -> RadianceSh {
        let [x, y, z] = position.to_array().map(|v| v as f32);
        radiance_sh(1, [[3.0 + x, 3.0 + y, 3.0 + z], [0.1 * x; 3], [0.2, 0.1 * y, 0.0], [0.1, 0.2, 0.1 * z]])
    }

    fn baked(nodes: &Nodes, relative_error: f32) -> Baked {
        let count = nodes.len();
        let values = (0..count).flat_map(|i| light(nodes.position(i)).coefficients[..4].to_vec()).flatten();
        let own = vec![relative_error; count];
        let plain = Baked::of_rows(1, Table::held(12, values.collect()));
        Baked { relative_error: own.clone(), worst_error: own, ..plain }
    }

    fn grid(counts: [u32; 3]) -> Nodes {
        Nodes::Grid(grid_of_counts(DVec3::ZERO, DVec3::splat(2.0), counts))
    }

    fn points(positions: &[[f64; 3]]) -> Nodes {
        Nodes::Points(positions.iter().map(|p| DVec3::from(*p)).collect())
    }

    fn with_errors(nodes: &Nodes, relative_error: f32) -> Volume {
        volume(nodes, &baked(nodes, relative_error))
    }

    fn compared(found: &Volume, truth: &Volume) -> Comparison {
        compare(found, &[Truth::of_volume(truth)], &CompareSettings::default()).unwrap()
    }

    #[test]
    fn volume_against_itself_has_no_error_whatever_its_nodes() {
        let twice = [[0.0; 3], [1.0, 0.5, 0.25], [1.0, 0.5, 0.25]];
        let vertices = Nodes::Vertices {
            positions: twice.map(DVec3::from).into(),
            normals: [Vec3::X, Vec3::Y, -Vec3::Y].into(),
            inward: vec![Vec3::ZERO; 3],
            sets: Vec::new(),
        };
        for nodes in [grid([3, 4, 5]), grid([1, 1, 1]), points(&twice), vertices] {
            // Two nodes at one place may differ.
            let mut baked = baked(&nodes, 0.01);
            let last = nodes.len() - 1;
            baked.sh.update(|node, values| values[0] += if node == 0 || node == last { 0.5 } else { 0.0 });
            let volume = volume(&nodes, &baked);
            let comparison = compared(&volume, &volume);
            assert_eq!(comparison.places.compared, nodes.len());
            assert_eq!((comparison.all.relative_rmse, comparison.all.bias), (0.0, 0.0));
            assert_eq!(comparison.sets[0].answer, Answer::SameNodes);
            assert_eq!(comparison.worst, []);
        }
    }

    #[test]
    fn grid_is_interpolated_at_places_and_those_outside_are_counted() {
        let found = with_errors(&grid([3, 3, 3]), 0.01);
        let truth = with_errors(&points(&[[0.3, 0.9, 1.9], [2.0, 0.0, 1.0], [1.0, 2.5, 1.0], [-0.1, 0.0, 0.0]]), 0.01);
        let comparison = compared(&found, &truth);
        assert_eq!(comparison.places, Places { truth: 4, compared: 2, outside: 2, ..Places::default() });
        assert_eq!(comparison.sets[0].answer, Answer::Interpolated);
        assert!(comparison.all.relative_rmse < 1e-6, "{comparison:?}");
    }

    #[test]
    fn points_answer_for_the_places_that_they_hold() {
        let found = with_errors(&points(&[[0.0; 3], [1.0; 3], [2.0, 1.0, 0.0]]), 0.01);
        // Another order, one place more, one moved by less than the reach, one by more.
        let places = [[2.0, 1.0, 0.0], [1.0, 1.0, 1.0001], [0.0, 0.0, 0.01], [0.7; 3]];
        let comparison = compared(&found, &with_errors(&points(&places), 0.01));
        assert_eq!(comparison.places, Places { truth: 4, compared: 2, not_held: 2, ..Places::default() });
        assert_eq!(comparison.sets[0].answer, Answer::Held);
        assert!(comparison.all.relative_rmse < 1e-4, "{comparison:?}");
    }

    #[test]
    fn vertices_answer_by_normal() {
        let at = |normals: &[Vec3]| Nodes::Vertices {
            positions: vec![DVec3::ONE; normals.len()],
            normals: normals.into(),
            inward: vec![Vec3::ZERO; normals.len()],
            sets: Vec::new(),
        };
        let nodes = at(&[Vec3::X, Vec3::Y]);
        let mut up = baked(&nodes, 0.01);
        up.sh.update(|node, values| values.iter_mut().for_each(|v| *v *= if node == 0 { 1.0 } else { 2.0 }));
        let found = volume(&nodes, &up);
        // The other order, and a side that is not there.
        let nodes = at(&[Vec3::Y, Vec3::NEG_X, Vec3::X]);
        let mut other = baked(&nodes, 0.01);
        other.sh.update(|node, values| values.iter_mut().for_each(|v| *v *= if node == 0 { 2.0 } else { 1.0 }));
        let comparison = compared(&found, &volume(&nodes, &other));
        assert_eq!(comparison.places, Places { truth: 3, compared: 2, not_held: 1, ..Places::default() });
        assert_eq!(comparison.all.relative_rmse, 0.0);
    }

    #[test]
    fn invalid_nodes_of_the_truth_are_left_out_and_filled_ones_of_the_volume_counted() {
        let nodes = grid([2, 2, 2]);
        let (mut found, mut truth) = (baked(&nodes, 0.01), baked(&nodes, 0.01));
        truth.standing[0] = Standing::Solid;
        truth.sh.update(|node, values| values[0] = if node == 0 { 1e3 } else { values[0] });
        found.standing[..2].fill(Standing::Uncovered);
        found.sh.update(|node, values| values[0] += if node == 1 { 1.0 } else { 0.0 });
        let comparison = compared(&volume(&nodes, &found), &volume(&nodes, &truth));
        let expected = Places { truth: 8, compared: 7, invalid: 1, filled: 1, ..Places::default() };
        assert_eq!(comparison.places, expected);
        assert_eq!(comparison.worst.len(), 1);
        assert_eq!((comparison.worst[0].node, comparison.worst[0].position), (1, [2.0, 0.0, 0.0]));
        truth.standing.fill(Standing::Outside);
        let truth = [Truth::of_volume(&volume(&nodes, &truth))];
        let nothing = compare(&volume(&nodes, &found), &truth, &CompareSettings::default()).unwrap_err();
        assert!(nothing.to_string().contains("8 are nodes that are not valid"), "{nothing}");
    }

    #[test]
    fn noise_is_got_back_from_relative_errors() {
        // Light is much the same everywhere, so a share of each node's E is that share of all; one dark node has the
        // floor of a tenth of the median.
        let nodes = grid([4, 4, 4]);
        let mut dark = baked(&nodes, 0.02);
        dark.sh.set(0, &[0.0; 12]);
        let comparison = compared(&volume(&nodes, &dark), &with_errors(&nodes, 0.01));
        let noise = comparison.all.noise.unwrap();
        assert!((noise / 0.02f64.hypot(0.01) - 1.0).abs() < 0.01, "{noise}");
        // In the middle of a cell eight independent nodes share: 1/sqrt(8) of the noise, whose RMS of E at the corners
        // is 3 % over E in the middle.
        let middle = with_errors(&points(&[[1.0; 3]]), 0.0);
        let comparison = compared(&with_errors(&grid([2, 2, 2]), 0.02), &middle);
        let noise = comparison.all.noise.unwrap();
        assert!((noise * 8f64.sqrt() / 0.02 - 1.03).abs() < 0.01, "{noise}");
    }

    #[test]
    fn noise_is_not_known_without_standard_errors_or_with_a_common_seed() {
        let nodes = grid([2, 2, 2]);
        let (sure, unsure) = (with_errors(&nodes, 0.01), with_errors(&nodes, f32::INFINITY));
        for (found, truth, common_seed, expected) in [
            (&sure, &sure, false, &[][..]),
            (&unsure, &sure, false, &[NoiseUnknown::Found]),
            (&sure, &unsure, false, &[NoiseUnknown::Truth]),
            (&unsure, &unsure, true, &[NoiseUnknown::Found, NoiseUnknown::Truth, NoiseUnknown::CommonSeed]),
            (&sure, &sure, true, &[NoiseUnknown::CommonSeed]),
        ] {
            let truths = [Truth::of_volume(truth)];
            let comparison = compare(found, &truths, &CompareSettings { common_seed }).unwrap();
            assert_eq!(comparison.noise_unknown, expected);
            assert_eq!(comparison.all.noise.is_none(), !expected.is_empty());
        }
        // Other places take other directions.
        let truths = [Truth::of_volume(&with_errors(&grid([3, 3, 3]), 0.01))];
        let comparison = compare(&sure, &truths, &CompareSettings { common_seed: true }).unwrap();
        assert_eq!(comparison.noise_unknown, []);
    }

    #[test]
    fn sets_are_chosen_by_name_and_radiance_first() {
        let radiance = Truth::of_volume(&with_errors(&points(&[[0.0; 3]]), 0.0));
        let surface = Truth {
            name: "surface".into(),
            level: String::new(),
            normals: vec![[0.0, 1.0, 0.0]],
            light: TruthLight::Irradiance(vec![[1.0; 3]]),
            noise: TruthNoise::Unknown,
            ..radiance.clone()
        };
        let both = || vec![radiance.clone(), surface.clone()];
        let names = |truths: Vec<Truth>| truths.into_iter().map(|truth| truth.name).collect::<Vec<_>>();
        assert_eq!(names(choose_sets(both(), &[]).unwrap()), ["nodes"]);
        assert_eq!(names(choose_sets(vec![surface.clone()], &[]).unwrap()), ["surface"]);
        assert_eq!(names(choose_sets(both(), &["surface".into()]).unwrap()), ["surface"]);
        assert_eq!(choose_sets(both(), &["surface".into(), "x".into()]), Err("x".into()));
    }
}
