//! A primitive in the world: positions in f64, winding, unit normals.

use glam::{DAffine3, DMat3, DVec3, Vec3};

use super::primitive::{LocalPrimitive, Shape, compact, shape_of};
use crate::scene::Mesh;

/// What placing dropped and repaired.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub(super) struct Losses {
    pub non_finite: u64,
    pub zero_area: u64,
    /// Normals of the file without a direction.
    pub bad_normals: u64,
}

/// Places `local` by `transform`, or each vertex by its own, where it is skinned; `frame` carries what does not depend on
/// the place (node, role, material ...).
pub(super) fn place(local: &LocalPrimitive, transform: &DAffine3, frame: Mesh) -> (Mesh, Losses) {
    let mut losses = Losses { non_finite: local.non_finite, zero_area: local.zero_area, bad_normals: 0 };
    let own = |vertex: usize| local.transforms.get(vertex).unwrap_or(transform);
    let positions = local.positions.iter().enumerate();
    let mut mesh = Mesh {
        positions: positions.map(|(vertex, p)| own(vertex).transform_point3(p.as_dvec3())).collect(),
        uvs: local.uvs.clone(),
        colors: local.colors.clone(),
        triangles: local.triangles.clone(),
        smooth: !local.normals.is_empty(),
        file_count: local.file_count,
        ..frame
    };

    // A mirrored node turns its triangles inside out; turn them round. Joints may mirror some.
    let linear = transform.matrix3;
    let is_mirrored = linear.determinant() < 0.0;
    if !local.transforms.is_empty() {
        let side = |vertex: u32| own(vertex as usize).matrix3.determinant().signum();
        let is_mirrored = |triangle: &[u32; 3]| triangle.map(side).into_iter().sum::<f64>() < 0.0;
        mesh.triangles.iter_mut().filter(|triangle| is_mirrored(triangle)).for_each(|triangle| triangle.swap(1, 2));
    } else if is_mirrored {
        mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
    }

    // Huge places overflow, flat ones (a scale of 0) leave no area.
    let positions = &mesh.positions;
    mesh.triangles.retain(|triangle| {
        let shape = shape_of(triangle.map(|i| positions[i as usize]));
        losses.non_finite += u64::from(shape == Shape::NonFinite);
        losses.zero_area += u64::from(shape == Shape::ZeroArea);
        shape == Shape::Good
    });

    let normal_matrix = normal_matrix(&linear);
    let from_file = local.normals.iter().enumerate().map(|(vertex, n)| {
        let matrix = local.transforms.get(vertex).map_or(normal_matrix, |own| self::normal_matrix(&own.matrix3));
        (matrix * n.as_dvec3()).try_normalize().map(|n| n.as_vec3())
    });
    let from_file: Vec<Option<Vec3>> = from_file.collect();
    losses.bad_normals = from_file.iter().filter(|n| n.is_none()).count() as u64;
    mesh.normals = if losses.bad_normals == 0 && !from_file.is_empty() {
        from_file.into_iter().flatten().collect()
    } else {
        let mut normals = area_weighted_normals(&mesh.positions, &mesh.triangles);
        for (normal, given) in normals.iter_mut().zip(from_file) {
            *normal = given.unwrap_or(*normal);
        }
        normals
    };

    drop_unused_vertices(&mut mesh, &local.file_numbers);
    (mesh, losses)
}

/// Normals go by the inverse transpose; cofactors are the same up to length and the determinant's sign, and exist for flat
/// transforms too. Scaled to about 1 first, so that they cannot underflow.
fn normal_matrix(linear: &DMat3) -> DMat3 {
    let largest = linear.to_cols_array().iter().fold(0.0_f64, |m, x| m.max(x.abs()));
    let scaled = if largest > 0.0 { *linear * (1.0 / largest) } else { *linear };
    let sign = if linear.determinant() < 0.0 { -1.0 } else { 1.0 };
    DMat3::from_cols(
        scaled.y_axis.cross(scaled.z_axis),
        scaled.z_axis.cross(scaled.x_axis),
        scaled.x_axis.cross(scaled.y_axis),
    ) * sign
}

/// The normal of each vertex: the sum of its triangles' normals by area; where they cancel, that of one of them.
fn area_weighted_normals(positions: &[DVec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let cross = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|i| positions[i as usize]);
        (b - a).cross(c - a)
    };
    let mut sums = vec![DVec3::ZERO; positions.len()];
    for triangle in triangles {
        let normal = cross(triangle);
        triangle.iter().for_each(|&i| sums[i as usize] += normal);
    }
    let mut normals: Vec<Option<Vec3>> =
        sums.iter().map(|sum| sum.try_normalize().map(|normal| normal.as_vec3())).collect();
    for triangle in triangles {
        for &i in triangle {
            normals[i as usize].get_or_insert_with(|| cross(triangle).normalize_or(DVec3::Y).as_vec3());
        }
    }
    // A vertex without a triangle is dropped right after.
    normals.into_iter().map(|normal| normal.unwrap_or(Vec3::Y)).collect()
}

/// Vertices that only dropped triangles used may be non-finite: nobody should meet them. Where the file has more than are
/// left, the mesh keeps their numbers.
fn drop_unused_vertices(mesh: &mut Mesh, file_numbers: &[u32]) {
    let (used, triangles) = compact(std::mem::take(&mut mesh.triangles), mesh.positions.len());
    mesh.triangles = triangles;
    if used.len() < mesh.positions.len() {
        fn keep<T: Copy>(values: &mut Vec<T>, used: &[u32]) {
            if !values.is_empty() {
                *values = used.iter().map(|&i| values[i as usize]).collect();
            }
        }
        keep(&mut mesh.positions, &used);
        keep(&mut mesh.normals, &used);
        mesh.uvs.iter_mut().for_each(|uvs| keep(uvs, &used));
        keep(&mut mesh.colors, &used);
    }
    if mesh.positions.len() < mesh.file_count as usize {
        mesh.file_numbers = used.iter().map(|&i| file_numbers[i as usize]).collect();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;

    fn triangle() -> LocalPrimitive {
        LocalPrimitive {
            positions: vec![Vec3::ZERO, Vec3::X, Vec3::Y],
            triangles: vec![[0, 1, 2]],
            ..Default::default()
        }
    }

    fn geometric_normal(mesh: &Mesh) -> DVec3 {
        let [a, b, c] = mesh.triangles[0].map(|i| mesh.positions[i as usize]);
        (b - a).cross(c - a).normalize()
    }

    #[test]
    fn mirrored_nodes_keep_their_front() {
        let local = LocalPrimitive { normals: vec![Vec3::Z; 3], ..triangle() };
        for scale in [DVec3::new(-1.0, 1.0, 1.0), DVec3::new(2.0, -3.0, 1.0), DVec3::new(1.0, 1.0, -1.0)] {
            let transform = DAffine3::from_scale(scale);
            let (mesh, losses) = place(&local, &transform, Mesh::default());
            let front = DVec3::Z * scale.z.signum();
            assert_eq!(losses, Losses::default());
            assert!(mesh.smooth && (geometric_normal(&mesh) - front).length() < 1e-12, "{scale}");
            assert!((mesh.normals[0].as_dvec3() - front).length() < 1e-6, "{scale}: {}", mesh.normals[0]);
        }
    }

    #[test]
    fn normals_stay_perpendicular_under_uneven_scale() {
        let normal = Vec3::new(1.0, 1.0, 0.0).normalize();
        let local = LocalPrimitive {
            positions: vec![Vec3::ZERO, Vec3::new(-1.0, 1.0, 0.0), Vec3::Z],
            normals: vec![normal; 3],
            triangles: vec![[0, 1, 2]],
            ..Default::default()
        };
        let transform = DAffine3::from_scale_rotation_translation(
            DVec3::new(10.0, 0.1, 3.0),
            DQuat::from_rotation_y(0.7),
            DVec3::new(1e7, -5.0, 2.0),
        );
        let (mesh, _) = place(&local, &transform, Mesh::default());
        assert!((geometric_normal(&mesh) - mesh.normals[0].as_dvec3()).length() < 1e-6);
    }

    #[test]
    fn flat_nodes_lose_their_triangles() {
        let (mesh, losses) = place(&triangle(), &DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0)), Mesh::default());
        assert_eq!(losses.zero_area, 1);
        assert!(mesh.triangles.is_empty() && mesh.positions.is_empty());
        // Flattened along the normal there is still a triangle, with its normal.
        let local = LocalPrimitive { normals: vec![Vec3::Z; 3], ..triangle() };
        let (mesh, losses) = place(&local, &DAffine3::from_scale(DVec3::new(1.0, 1.0, 0.0)), Mesh::default());
        assert_eq!(losses, Losses::default());
        assert_eq!(mesh.normals[0], Vec3::Z);
    }

    #[test]
    fn computed_normals_weigh_by_area() {
        // A vertex between a triangle of area 3/2 facing +Z and one of area 1/2 facing +X.
        let local = LocalPrimitive {
            positions: vec![Vec3::ZERO, Vec3::X * 3.0, Vec3::Y, Vec3::Z],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Default::default()
        };
        let (mesh, _) = place(&local, &DAffine3::IDENTITY, Mesh::default());
        assert!((mesh.normals[0] - Vec3::new(1.0, 0.0, 3.0).normalize()).length() < 1e-6);
        assert!(!mesh.smooth, "computed normals are not for shading");
    }

    #[test]
    fn normals_that_cancel_take_one_of_their_triangles() {
        let local = LocalPrimitive { triangles: vec![[0, 1, 2], [0, 2, 1]], ..triangle() };
        let (mesh, _) = place(&local, &DAffine3::IDENTITY, Mesh::default());
        assert_eq!(mesh.normals, [Vec3::Z; 3]);
    }

    #[test]
    fn a_normal_without_direction_is_computed() {
        let local = LocalPrimitive { normals: vec![Vec3::X, Vec3::ZERO, Vec3::splat(f32::NAN)], ..triangle() };
        let (mesh, losses) = place(&local, &DAffine3::IDENTITY, Mesh::default());
        assert_eq!(losses.bad_normals, 2);
        assert_eq!(mesh.normals, [Vec3::X, Vec3::Z, Vec3::Z]);
    }
}
