//! Several volumes of one level as one light.
//!
//! `gdibl bake` writes one file for each box that an artist placed, and a list of them as JSON (FORMAT.md). A program reads the
//! list with its own JSON library, parses the files, and puts them together here in the list's order, the finest first.
//!
//! **Which volume counts.** The depth of a position in a box is the least distance to the planes of its six faces, negative outside:
//! ```text
//! depth_i = min over axes of min(position - min_i, max_i - position)          metres
//! deepest = max over volumes of depth_i
//! width_i = spacing_i, but at most half the shortest edge of box i            where volume i is blended
//! take_i  = clamp(1 - (min(deepest, width_i) - depth_i) / width_i, 0, 1)
//! share_1 = take_1,   share_2 = (1 - share_1) take_2,   share_3 = (1 - share_1 - share_2) take_3 …
//! ```
//! So deeper than its width in its box a volume is alone, whatever lies behind it in the list. From there to its border it gives way
//! to those behind it, as far as these hold the position. At borders that no other box reaches beyond, nothing is blended. Outside all
//! boxes the nearest counts, and near the middle between two both do. All of these are continuous, so light is continuous
//! wherever it is in each volume. The deepest volume takes all that is left, so shares add up to 1.

use crate::error::text;
use crate::grid::box_contains;
use crate::{Error, Kind, RadianceSh, Sample, Volume};
use alloc::vec::Vec;

/// Several volumes of one level, and which of them counts where.
#[derive(Clone, Debug)]
pub struct VolumeSet {
    members: Vec<Member>,
}

#[derive(Clone, Debug)]
struct Member {
    volume: Volume,
    /// Where it is blended, metres, over 0.
    width: f64,
}

/// A volume and how much of the light at a position is its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Share {
    /// Index of the volume, in the order in which they were given.
    pub volume: usize,
    /// Over 0, at most 1.
    pub weight: f32,
}

/// Coordinates beyond this count as this, metres: differences of distances stay finite.
const FARTHEST: f64 = 1e150;

impl VolumeSet {
    /// Puts grids together, each with its spacing in metres, in the order of the list: an earlier one wins over a later one.
    ///
    /// # Errors
    /// There is none, one is not a grid, or a spacing is not a finite number over 0.
    pub fn new(volumes: impl IntoIterator<Item = (Volume, f64)>) -> Result<VolumeSet, Error> {
        let mut members: Vec<Member> = Vec::new();
        for (volume, spacing) in volumes {
            let number = members.len();
            let invalid = |found, expected| Err(Error::invalid(text!("volume {number} of the set"), found, expected));
            if !matches!(volume.header.kind, Kind::Grid | Kind::Sparse) {
                return invalid(text!("{:?}", volume.header.kind), "a grid: light is read between nodes");
            }
            if !(spacing > 0.0 && spacing.is_finite()) {
                return invalid(text!("spacing {spacing}"), "metres over 0");
            }
            let shortest = (0..3).map(|k| volume.header.max[k] - volume.header.min[k]).fold(f64::INFINITY, f64::min);
            // In a flat box there is nothing to be deep in.
            members.push(Member { width: spacing.min(0.5 * shortest).max(f64::MIN_POSITIVE), volume });
        }
        match members.is_empty() {
            true => Err(Error::invalid("the set of volumes", "none", "at least one")),
            false => Ok(VolumeSet { members }),
        }
    }

    /// How many volumes there are; at least 1.
    pub fn len(&self) -> usize {
        self.members.len()
    }

    /// Never: see [`VolumeSet::new`].
    pub fn is_empty(&self) -> bool {
        self.members.is_empty()
    }

    /// The volumes, in the order in which they were given.
    pub fn volumes(&self) -> impl ExactSizeIterator<Item = &Volume> {
        self.members.iter().map(|member| &member.volume)
    }

    /// Which volumes count at a position in metres, in their order. Weights add up to 1.
    pub fn shares(&self, position: [f64; 3]) -> impl Iterator<Item = Share> {
        // A coordinate that is no number counts as far below.
        let within = |x: f64| if x.is_nan() { -FARTHEST } else { x.clamp(-FARTHEST, FARTHEST) };
        let position = position.map(within);
        let depths = self.members.iter().map(move |member| member.depth(position));
        let deepest = depths.fold(f64::NEG_INFINITY, f64::max);
        let mut left = 1.0;
        let share = move |(volume, member): (usize, &Member)| {
            if left <= 0.0 {
                return None;
            }
            let share = left * member.take(position, deepest);
            left -= share;
            Some(Share { volume, weight: share as f32 })
        };
        self.members.iter().enumerate().map_while(share).filter(|share| share.weight > 0.0)
    }

    /// Light at a position, see [`Volume::sample`]. Of several volumes the bands are those of the one that has most.
    pub fn sample(&self, position: [f32; 3], normal: [f32; 3]) -> Sample {
        self.sample_f64(position.map(f64::from), normal)
    }

    /// The same for levels far from the origin.
    pub fn sample_f64(&self, position: [f64; 3], normal: [f32; 3]) -> Sample {
        if let [only] = &self.members[..] {
            return only.volume.sample_f64(position, normal);
        }
        let mut all = Sample { sh: RadianceSh::zero(0), validity: 0.0, inside: self.contains(position) };
        for Share { volume, weight } in self.shares(position) {
            let sample = self.members[volume].volume.sample_f64(position, normal);
            all.sh.add_scaled(&sample.sh, weight);
            all.validity += weight * sample.validity;
        }
        all
    }

    /// What falls on a surface: `diffuse = albedo / PI * irradiance`. See [`Volume::irradiance`].
    #[inline]
    pub fn irradiance(&self, position: [f32; 3], normal: [f32; 3]) -> [f32; 3] {
        self.irradiance_f64(position.map(f64::from), normal)
    }

    /// The same for levels far from the origin.
    #[inline]
    pub fn irradiance_f64(&self, position: [f64; 3], normal: [f32; 3]) -> [f32; 3] {
        match &self.members[..] {
            [only] => only.volume.irradiance_f64(position, normal),
            _ => self.irradiance_of_several(position, normal),
        }
    }

    #[inline(never)]
    fn irradiance_of_several(&self, position: [f64; 3], normal: [f32; 3]) -> [f32; 3] {
        let mut sum = [0.0; 3];
        for Share { volume, weight } in self.shares(position) {
            let irradiance = self.members[volume].volume.irradiance_f64(position, normal);
            sum.iter_mut().zip(irradiance).for_each(|(sum, irradiance)| *sum += weight * irradiance);
        }
        sum
    }

    /// [`irradiance`](VolumeSet::irradiance) at many positions. In a set of one it is
    /// [`Volume::irradiance_batch`], in others it takes as long as one by one.
    ///
    /// # Panics
    /// If the three slices differ in length.
    pub fn irradiance_batch<P: Copy + Into<f64>>(
        &self,
        positions: &[[P; 3]],
        normals: &[[f32; 3]],
        irradiance: &mut [[f32; 3]],
    ) {
        if let [only] = &self.members[..] {
            return only.volume.irradiance_batch(positions, normals, irradiance);
        }
        let counts = [positions.len(), normals.len(), irradiance.len()];
        assert!(counts == [counts[0]; 3], "{} positions, {} normals, {} answers", counts[0], counts[1], counts[2]);
        for ((position, normal), irradiance) in positions.iter().zip(normals).zip(irradiance) {
            *irradiance = self.irradiance_f64(position.map(Into::into), *normal);
        }
    }

    /// Whether the position is in the box of some volume.
    pub fn contains(&self, position: [f64; 3]) -> bool {
        self.volumes().any(|volume| box_contains(volume.header.min, volume.header.max, position))
    }
}

impl Member {
    /// How deep a position is in the box, metres; negative outside.
    #[inline]
    fn depth(&self, position: [f64; 3]) -> f64 {
        let (min, max) = (&self.volume.header.min, &self.volume.header.max);
        (0..3).map(|k| (position[k] - min[k]).min(max[k] - position[k])).fold(f64::INFINITY, f64::min)
    }

    /// The share that it takes of what volumes before it leave, 0 to 1; of the deepest 1.
    #[inline]
    fn take(&self, position: [f64; 3], deepest: f64) -> f64 {
        (1.0 - (deepest.min(self.width) - self.depth(position)) / self.width).clamp(0.0, 1.0)
    }
}
