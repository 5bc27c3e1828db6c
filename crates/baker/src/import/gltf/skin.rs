//! Skinned meshes in the pose that the file's nodes give their joints: glTF 2.0, 3.7.3. The node that carries the mesh does not
//! place it, its joints do.

use glam::{DAffine3, DMat3, DVec3};
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::mesh::{Primitive, Semantic};

use super::accessor::{Elements, attribute};
use super::buffers::Buffers;
use crate::Result;

/// Mesh to world for each vertex of a primitive: the sum of its joints' transforms by weight. `None`: it names no joints.
pub(super) fn vertex_transforms(
    buffers: &Buffers,
    primitive: &Primitive,
    place: &str,
    used: &[u32],
    vertices: usize,
    joints: &[DAffine3],
) -> Result<Option<Vec<DAffine3>>> {
    let document = buffers.document;
    let mut sums = vec![(DMat3::ZERO, DVec3::ZERO, 0.0); used.len()];
    let mut sets = 0;
    while let (Some(numbers), Some(weights)) =
        (attribute(primitive, Semantic::Joints(sets)), attribute(primitive, Semantic::Weights(sets)))
    {
        let open = |accessor: usize, name: &str| -> Result<Elements> {
            let elements = Elements::open(buffers, accessor, &[Type::Vec4], &format!("{place}: {name}_{sets}"))?;
            if elements.count != vertices {
                return Err(document.invalid(format!(
                    "{place}: {name}_{sets} (accessor {accessor}) has {} elements, POSITION {vertices}; expected the same number",
                    elements.count
                )));
            }
            Ok(elements)
        };
        let numbers = open(numbers.value(), "JOINTS")?;
        let mut weights = open(weights.value(), "WEIGHTS")?;
        if !matches!(numbers.component, ComponentType::U8 | ComponentType::U16) {
            return Err(document.invalid(format!(
                "{place}: JOINTS_{sets} has components {:?}; expected U8 or U16",
                numbers.component
            )));
        }
        weights.normalize();
        for (&vertex, (matrix, translation, total)) in used.iter().zip(&mut sums) {
            let [numbers, weights] = [&numbers, &weights].map(|elements| elements.vector::<4>(vertex as usize));
            for (number, weight) in numbers.into_iter().zip(weights) {
                if !weight.is_finite() || weight < 0.0 {
                    return Err(document
                        .invalid(format!("{place}: WEIGHTS_{sets} of vertex {vertex} is {weight}; expected 0 to 1")));
                }
                if weight == 0.0 {
                    continue;
                }
                let joint = joints.get(number as usize).ok_or_else(|| {
                    document.invalid(format!(
                        "{place}: JOINTS_{sets} of vertex {vertex} names joint {number}; its skin has {}",
                        joints.len()
                    ))
                })?;
                *matrix += joint.matrix3 * f64::from(weight);
                *translation += joint.translation * f64::from(weight);
                *total += f64::from(weight);
            }
        }
        sets += 1;
    }
    if sets == 0 || joints.is_empty() {
        return Ok(None);
    }
    // Weights should sum to 1, and exporters round. A vertex without any goes with the first joint.
    let transform = |(matrix, translation, total): (DMat3, DVec3, f64)| match total > 0.0 {
        true => DAffine3::from_mat3_translation(matrix * (1.0 / total), translation / total),
        false => joints[0],
    };
    Ok(Some(sums.into_iter().map(transform).collect()))
}
