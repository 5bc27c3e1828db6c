//! KHR_lights_punctual, placed in the world.

use glam::{DVec3, Vec3};

use super::document::{Document, Light};
use super::findings::Findings;
use super::hierarchy::PlacedNode;
use crate::Result;
use crate::scene::{PunctualKind, PunctualLight};

/// The lights of `nodes`, in their order. Nodes that are ignored bring none.
pub(super) fn read(document: &Document, nodes: &[PlacedNode], findings: &mut Findings) -> Result<Vec<PunctualLight>> {
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
    Ok(lights)
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
