//! What a volume is compared with: light at places, and how sure it is.

use gdibl_runtime::{RadianceSh, Volume, VolumeSet};

use super::noise::node_variances;

/// Light at places. All lists are as long as `positions`, or empty where that is said.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    /// How a person tells this set from others.
    pub name: String,
    /// File name of the level that it is the light of; empty where that is not known.
    pub level: String,
    /// World metres.
    pub positions: Vec<[f64; 3]>,
    /// Unit normals; empty where places have none.
    pub normals: Vec<[f32; 3]>,
    /// Which places count; empty: all.
    pub valid: Vec<bool>,
    /// What is known there.
    pub light: TruthLight,
    /// How sure it is.
    pub noise: TruthNoise,
}

/// Light at each place.
#[derive(Debug, Clone, PartialEq)]
pub enum TruthLight {
    /// From all directions.
    Radiance(Vec<RadianceSh>),
    /// E of linear R, G, B on a surface with the place's normal.
    Irradiance(Vec<[f32; 3]>),
}

/// Standard errors of the light.
#[derive(Debug, Clone, PartialEq)]
pub enum TruthNoise {
    /// Not known.
    Unknown,
    /// Of every coefficient.
    Radiance(Vec<RadianceSh>),
    /// Of E of linear R, G, B.
    Irradiance(Vec<[f32; 3]>),
    /// Variance of E, mean over normals and channels.
    Variance(Vec<f64>),
}

impl Truth {
    /// The name of the one set that a volume is.
    pub const VOLUME: &str = "nodes";

    /// Every node of a volume, of which the valid ones count.
    pub fn of_volume(volume: &Volume) -> Truth {
        let nodes = || 0..volume.node_count();
        Truth {
            name: Truth::VOLUME.into(),
            level: String::new(),
            positions: nodes().map(|n| volume.node_position(n)).collect(),
            normals: nodes().filter_map(|n| volume.node_normal(n)).collect(),
            valid: nodes().map(|n| volume.is_valid(n)).collect(),
            light: TruthLight::Radiance(nodes().map(|n| volume.node_sh(n)).collect()),
            noise: node_variances(volume).map_or(TruthNoise::Unknown, TruthNoise::Variance),
        }
    }

    /// The nodes of a set's volumes, a truth for each in the set's order: those that nothing of another volume is blended
    /// into, so that they are what one reads there.
    pub fn of_set(set: &VolumeSet) -> Vec<Truth> {
        let of_volume = |(place, volume): (usize, &Volume)| {
            let mut truth = Truth::of_volume(volume);
            let is_alone = |position: &[f64; 3]| set.shares(*position).all(|share| share.volume == place);
            let alone: Vec<bool> = truth.positions.iter().map(is_alone).collect();
            truth.valid.iter_mut().zip(alone).for_each(|(valid, alone)| *valid &= alone);
            truth
        };
        set.volumes().enumerate().map(of_volume).collect()
    }

    /// Whether place `index` counts.
    pub fn is_valid(&self, index: usize) -> bool {
        self.valid.is_empty() || self.valid[index]
    }
}

/// Those sets of `truths` that have one of the `names`; without names those of radiance, or, if there is none, all.
/// An error is the first name that no set has.
pub fn choose_sets(truths: Vec<Truth>, names: &[String]) -> Result<Vec<Truth>, String> {
    if let Some(unknown) = names.iter().find(|name| truths.iter().all(|truth| truth.name != **name)) {
        return Err(unknown.clone());
    }
    let radiance = |truth: &Truth| matches!(truth.light, TruthLight::Radiance(_));
    let any_radiance = truths.iter().any(radiance);
    let wanted = |truth: &Truth| match names {
        [] => radiance(truth) || !any_radiance,
        names => names.contains(&truth.name),
    };
    Ok(truths.into_iter().filter(wanted).collect())
}
