//! Where a probe stood, from and to the attributes of an EXR file.
//!
//! - `gdibl:position`: `v3f` (or `v3d`), metres in the world. `gdibl:rotation`: the quaternion x y z w, probe to
//!   world, as `v4f` (four little-endian floats; or `v4d`, or a `string` of four numbers for tools that can write
//!   nothing else).
//! - else `worldToCamera` (`m44f`): OpenEXR writes matrices row by row and multiplies row vectors,
//!   `camera = world · M`, so the translation is in the last row; the camera looks along its -Z, up is +Y, and +X is
//!   on the right of its image.
//!
//! A panorama's axes are not the camera's: gdibl's lat-long has +Z in the image centre and +X on the *left*. A
//! renderer's spherical camera has its viewing direction in the image centre. So the probe is the camera turned
//! half around Y:
//!
//! ```text
//!   image centre: probe +Z = camera -Z        image right: probe -X = camera +X        up: probe +Y = camera +Y
//! ```

use std::path::Path;

use exr::meta::attribute::{AttributeValue, Text};
use exr::meta::header::Header;
use glam::{DMat3, DQuat, DVec3, DVec4};

use crate::panorama::Mapping;
use crate::{Error, Finding, Result};

/// Position and orientation of a probe; each `None` where the file does not say.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose {
    /// Metres in the world.
    pub position: Option<DVec3>,
    /// Unit quaternion, probe to world.
    pub rotation: Option<DQuat>,
}

/// Attribute names.
pub(super) const POSITION: &str = "gdibl:position";
pub(super) const ROTATION: &str = "gdibl:rotation";
/// The name of the layout, where EXR's own `envmap` has none for it.
pub(super) const MAPPING: &str = "gdibl:mapping";

/// Reads the pose of a layer. Our own attributes must be right; a `worldToCamera` that gives no pose is a finding.
pub(super) fn read(path: &Path, header: &Header, findings: &mut Vec<Finding>) -> Result<Pose> {
    let attribute = |name: &str| {
        let name = Text::from(name);
        header.own_attributes.other.get(&name).or_else(|| header.shared_attributes.other.get(&name))
    };
    let mut pose = Pose::default();
    if let Some(matrix) = header.own_attributes.world_to_camera {
        match from_world_to_camera(&matrix) {
            Some(found) => pose = found,
            None => findings.push(Finding::new(
                "world-to-camera",
                1,
                "the attribute worldToCamera is not the matrix of a camera in the world and was ignored",
            )),
        }
    }
    if let Some(value) = attribute(POSITION) {
        let numbers = numbers(value).filter(|n| n.len() == 3 && n.iter().all(|v| v.is_finite()));
        let Some(n) = numbers else {
            return Err(Error::invalid(
                path,
                format!("attribute {POSITION} is {value:?}; expected three finite numbers (v3f), metres"),
            ));
        };
        pose.position = Some(DVec3::new(n[0], n[1], n[2]));
    }
    if let Some(value) = attribute(ROTATION) {
        let length = |n: &[f64]| n.iter().map(|v| v * v).sum::<f64>().sqrt();
        // A quaternion of length 0.5 or 2 is not a rounding error.
        let numbers = numbers(value).filter(|n| n.len() == 4 && (length(n) - 1.0).abs() < 0.01);
        let Some(n) = numbers else {
            return Err(Error::invalid(
                path,
                format!("attribute {ROTATION} is {value:?}; expected a unit quaternion x y z w (v4f), probe to world"),
            ));
        };
        pose.rotation = Some(DQuat::from_vec4(DVec4::new(n[0], n[1], n[2], n[3])).normalize());
    }
    Ok(pose)
}

/// The layout that our own attribute names.
pub(super) fn mapping(path: &Path, header: &Header) -> Result<Option<Mapping>> {
    match header.own_attributes.other.get(&Text::from(MAPPING)) {
        None => Ok(None),
        Some(AttributeValue::Text(name)) if Mapping::parse(&name.to_string()).is_some() => {
            Ok(Mapping::parse(&name.to_string()))
        }
        Some(value) => {
            Err(Error::invalid(path, format!("attribute {MAPPING} is {value:?}; expected a mapping's name")))
        }
    }
}

/// Three or four numbers in the types they can be stored in.
fn numbers(value: &AttributeValue) -> Option<Vec<f64>> {
    match value {
        AttributeValue::FloatVec3((x, y, z)) => Some([*x, *y, *z].map(f64::from).to_vec()),
        AttributeValue::Text(text) => text
            .to_string()
            .split(|c: char| c.is_whitespace() || c == ',')
            .filter(|word| !word.is_empty())
            .map(|word| word.parse().ok())
            .collect(),
        AttributeValue::Custom { kind, bytes } => match kind.to_string().as_str() {
            "v3f" | "v4f" => Some(bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b).into()).collect()),
            "v3d" | "v4d" => Some(bytes.as_chunks().0.iter().map(|b| f64::from_le_bytes(*b)).collect()),
            _ => None,
        },
        _ => None,
    }
}

/// The pose of the panorama whose camera has this matrix; `None` if it is not finite, not invertible, or mirrors.
fn from_world_to_camera(matrix: &[f32; 16]) -> Option<Pose> {
    let m = matrix.map(f64::from);
    // Row vectors, row by row: the same numbers are a column-vector matrix, column by column.
    let linear = DMat3::from_cols_array(&[m[0], m[1], m[2], m[4], m[5], m[6], m[8], m[9], m[10]]);
    let translation = DVec3::new(m[12], m[13], m[14]);
    let scale = linear.determinant().cbrt();
    let affine = m[3] == 0.0 && m[7] == 0.0 && m[11] == 0.0 && m[15] == 1.0;
    if !(m.iter().all(|v| v.is_finite()) && affine && scale > 1e-12) {
        return None;
    }
    // Up to a uniform scale the matrix must be a rotation: a shear or an uneven scale is no camera.
    let rotation = linear * (1.0 / scale);
    let error = (rotation.transpose() * rotation - DMat3::IDENTITY).to_cols_array();
    if error.iter().any(|e| e.abs() > 1e-3) {
        return None;
    }
    let camera_to_world = rotation.transpose();
    let probe_to_camera = DMat3::from_diagonal(DVec3::new(-1.0, 1.0, -1.0));
    Some(Pose {
        position: Some(linear.inverse() * -translation),
        rotation: Some(DQuat::from_mat3(&(camera_to_world * probe_to_camera)).normalize()),
    })
}

/// The attribute values of a pose, for writing.
pub(super) fn position_value(position: DVec3) -> AttributeValue {
    let p = position.as_vec3();
    AttributeValue::FloatVec3((p.x, p.y, p.z))
}

/// See [`position_value`]; `v4f` is a type that OpenEXR itself does not know, so it goes as bytes.
pub(super) fn rotation_value(rotation: DQuat) -> AttributeValue {
    let bytes = rotation.normalize().to_array().map(|v| (v as f32).to_le_bytes());
    AttributeValue::Custom { kind: Text::from("v4f"), bytes: bytes.as_flattened().iter().copied().collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat4;

    #[test]
    fn world_to_camera_puts_the_viewing_direction_in_the_image_centre() {
        let position = DVec3::new(3.0, -2.0, 7.0);
        let camera_to_world = DMat4::from_rotation_translation(
            DQuat::from_rotation_y(0.7) * DQuat::from_rotation_x(-0.4) * DQuat::from_rotation_z(0.2),
            position,
        );
        // glam's column-vector matrix, column by column, is OpenEXR's row-vector matrix, row by row.
        let matrix = camera_to_world.inverse().to_cols_array().map(|v| v as f32);
        let pose = from_world_to_camera(&matrix).unwrap();
        assert!((pose.position.unwrap() - position).length() < 1e-5);
        let rotation = pose.rotation.unwrap();
        let view = camera_to_world.transform_vector3(DVec3::NEG_Z);
        let right = camera_to_world.transform_vector3(DVec3::X);
        let up = camera_to_world.transform_vector3(DVec3::Y);
        assert!((rotation * DVec3::Z - view).length() < 1e-6, "image centre");
        assert!((rotation * DVec3::NEG_X - right).length() < 1e-6, "image right");
        assert!((rotation * DVec3::Y - up).length() < 1e-6, "up");
    }

    #[test]
    fn world_to_camera_in_numbers_as_a_file_has_them() {
        // A camera at (1, 2, 3) that looks along -Z: camera = world - (1, 2, 3), translation in the last row.
        let matrix = [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., -1., -2., -3., 1.];
        let pose = from_world_to_camera(&matrix).unwrap();
        assert_eq!(pose.position.unwrap(), DVec3::new(1.0, 2.0, 3.0));
        assert!((pose.rotation.unwrap() * DVec3::Z - DVec3::NEG_Z).length() < 1e-12);
        assert!((pose.rotation.unwrap() * DVec3::X - DVec3::NEG_X).length() < 1e-12);
    }

    #[test]
    fn world_to_camera_in_centimetres_gives_metres_of_the_world() {
        // Camera space 100 times as fine as the world: only the place matters, and it is in world units.
        let m = [100., 0., 0., 0., 0., 100., 0., 0., 0., 0., 100., 0., -100., 0., 0., 1.];
        assert!((from_world_to_camera(&m).unwrap().position.unwrap() - DVec3::X).length() < 1e-12);
    }

    #[test]
    fn world_to_camera_refuses_what_is_no_camera() {
        let identity = DMat4::IDENTITY.to_cols_array().map(|v| v as f32);
        assert!(from_world_to_camera(&identity).is_some());
        let with = |i: usize, v: f32| {
            let mut m = identity;
            m[i] = v;
            from_world_to_camera(&m)
        };
        assert_eq!(with(0, f32::NAN), None, "NaN");
        assert_eq!(with(12, f32::INFINITY), None, "infinity");
        assert_eq!(with(0, 0.0), None, "singular");
        assert_eq!(with(0, -1.0), None, "mirroring");
        assert_eq!(with(0, 2.0), None, "uneven scale");
        assert_eq!(with(1, 0.5), None, "shear");
        assert_eq!(with(3, 0.5), None, "perspective");
    }
}
