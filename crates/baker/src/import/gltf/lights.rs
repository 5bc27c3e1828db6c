//! KHR_lights_punctual, placed in the world.

use glam::{DVec3, Vec3};
use std::f64::consts::PI;

use super::document::{Document, Light};
use super::findings::Findings;
use super::hierarchy::PlacedNode;
use crate::Result;
use crate::scene::{Mesh, PunctualKind, PunctualLight, Scene};

/// The lights of `nodes`, in their order, their intensities divided by `lumens_per_watt`. Nodes that are ignored bring none.
pub(super) fn read(
    document: &Document,
    nodes: &[PlacedNode],
    lumens_per_watt: Option<f32>,
    findings: &mut Findings,
) -> Result<Vec<PunctualLight>> {
    let mut lights = Vec::new();
    for placed in nodes.iter().filter(|placed| placed.role.is_some()) {
        let Some(extension) = document.nodes[placed.node].extensions.get("KHR_lights_punctual") else { continue };
        let label = document.node_label(placed.node);
        let index = extension.get("light").and_then(|light| light.as_u64()).and_then(|i| usize::try_from(i).ok());
        let index = index.ok_or_else(|| {
            document.invalid(format!("{label}: KHR_lights_punctual: \"light\" is missing or no index"))
        })?;
        let light = document.get(&document.lights, index, "light", &label)?;
        lights.extend(place(document, light, index, placed, findings)?);
    }
    if let Some(lumens) = lumens_per_watt {
        lights.iter_mut().for_each(|light| light.intensity /= lumens);
    }
    Ok(lights)
}

/// Lumens per watt of green light, by which exporters turn watts into the lumens of glTF's lights.
const LUMENS_PER_WATT: f64 = 683.0;
/// A level counts as one where that was done, and emissive surfaces were left in watts, within this factor.
const WITHIN: f64 = 16.0;

/// Says where lamps give about [`LUMENS_PER_WATT`] times what emissive surfaces give.
pub(super) fn compare_with_emitters(scene: &Scene, findings: &mut Findings) {
    let mean = |color: Vec3| f64::from(color.element_sum()) / 3.0;
    // Flux, in the units of radiance × m² × sr. A directional light has none of its own.
    let flux = |light: &PunctualLight| match light.kind {
        PunctualKind::Point => Some(mean(light.intensity) * 4.0 * PI),
        PunctualKind::Spot { outer_cone_radians, .. } => {
            Some(mean(light.intensity) * 2.0 * PI * (1.0 - f64::from(outer_cone_radians).cos()))
        }
        PunctualKind::Directional => None,
    };
    let lamps: Vec<f64> = scene.lights.iter().filter_map(flux).collect();
    let emitted = |mesh: &Mesh| {
        let material = &scene.materials[mesh.material as usize];
        match material.unlit || material.emission == Vec3::ZERO {
            true => 0.0,
            false => mesh.triangles.iter().map(|ids| mesh.area(*ids)).sum::<f64>() * PI * mean(material.emission),
        }
    };
    let emitters: f64 = scene.meshes.iter().map(emitted).sum();
    let ratio = lamps.iter().sum::<f64>() / emitters;
    if emitters > 0.0 && (LUMENS_PER_WATT / WITHIN..=LUMENS_PER_WATT * WITHIN).contains(&ratio) {
        findings.add("lamps-outshine-emitters", lamps.len() as u64, || {
            format!(
                "The level's point and spot lights give {ratio:.0} times what its emissive surfaces give. Blender's export \
                 multiplies lights by 683 lm/W and leaves emissive surfaces as they are: if this level comes from there, bake it \
                 with --lumens-per-watt 683, or export it with Lighting Mode Unitless"
            )
        });
    }
}

fn place(
    document: &Document,
    light: &Light,
    index: usize,
    placed: &PlacedNode,
    findings: &mut Findings,
) -> Result<Option<PunctualLight>> {
    let label = format!("light {index} on {}", document.node_label(placed.node));
    let kind = match light.kind.as_str() {
        "point" => PunctualKind::Point,
        "directional" => PunctualKind::Directional,
        "spot" => {
            let (inner, outer) = (light.spot.inner_cone_angle, light.spot.outer_cone_angle);
            // Equal angles are against the letter of the extension, but mean a hard edge.
            if !(inner >= 0.0 && inner <= outer && outer <= std::f32::consts::FRAC_PI_2 + 1e-5) {
                return Err(document.invalid(format!(
                    "{label}: cone angles {inner} and {outer} radians; expected 0 <= inner < outer <= pi/2"
                )));
            }
            PunctualKind::Spot { inner_cone_radians: inner, outer_cone_radians: outer }
        }
        other => {
            findings
                .add("unknown-lights", 1, || format!("Lights of an unknown type (\"{other}\") were ignored: {label}"));
            return Ok(None);
        }
    };
    let intensity = Vec3::from(light.color) * light.intensity;
    if !intensity.is_finite() || intensity.min_element() < 0.0 {
        return Err(document.invalid(format!("{label}: colour times intensity is {intensity}; expected 0 or more")));
    }
    let range = match light.range {
        None => f32::INFINITY,
        Some(range) if range > 0.0 => range,
        Some(range) => {
            findings.add("light-ranges", 1, || {
                format!("Ranges of lights must be over 0 and were ignored: {label} has {range}")
            });
            f32::INFINITY
        }
    };
    // A light shines along its node's -Z; scale does not matter, unless there is none.
    let direction = (placed.transform.matrix3 * DVec3::NEG_Z).try_normalize();
    let direction = match (direction, kind) {
        (Some(direction), _) => direction.as_vec3(),
        (None, PunctualKind::Point) => Vec3::NEG_Z,
        (None, _) => return Err(document.invalid(format!("{label}: the node's scale is 0, so it has no direction"))),
    };
    let name = document.nodes[placed.node].name.clone().or_else(|| light.name.clone()).unwrap_or_default();
    Ok(Some(PunctualLight { name, kind, intensity, range, position: placed.transform.translation, direction }))
}
