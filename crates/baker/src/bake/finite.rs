//! No volume holds a number that is not finite: a bake ends before it writes one, and says where it came from.

use glam::Vec3;

use super::{Baked, Nodes};
use crate::scene::{PunctualLight, Scene};

/// An error that names the first node whose light is not finite, and what in the level is brightest.
pub fn check_finite(nodes: &Nodes, baked: &Baked, scene: &Scene) -> std::result::Result<(), String> {
    let Some(node) = (0..baked.len()).find(|node| !baked.node(*node).iter().all(|value| value.is_finite())) else {
        return Ok(());
    };
    let glowing = scene.meshes.iter().map(|mesh| mesh.material).max_by(|a, b| {
        let brightness = |material: u32| scene.materials[material as usize].emission.max_element();
        brightness(*a).total_cmp(&brightness(*b))
    });
    let glowing = glowing.map(|number| (number, &scene.materials[number as usize]));
    let glowing = glowing.filter(|(_, material)| material.emission != Vec3::ZERO);
    let lamp = scene.lights.iter().max_by(|a, b| {
        let brightness = |light: &PunctualLight| light.intensity.max_element();
        brightness(a).total_cmp(&brightness(b))
    });
    let mut sources = Vec::new();
    if let Some((number, material)) = glowing {
        // The first material is glTF's default.
        let number = number.saturating_sub(1);
        sources.push(format!(
            "material {number} ({}) with an emission of {:e}",
            material.name,
            material.emission.max_element()
        ));
    }
    if let Some(light) = lamp {
        sources.push(format!("the light {} with an intensity of {:e}", light.name, light.intensity.max_element()));
    }
    let sources = match sources.is_empty() {
        true => "the distant panorama or a probe: nothing in the level gives light".to_owned(),
        false => format!("brightest in the level are {}; else look at the panoramas", sources.join(" and ")),
    };
    let position = nodes.position(node);
    Err(format!(
        "the light of node {node} at {position} is not finite, so nothing was written; {sources}. Lower what is too bright"
    ))
}
