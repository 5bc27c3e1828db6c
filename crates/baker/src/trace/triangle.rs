//! Ray against a block of triangles at once, watertight.
//!
//! Based on: Woop, Benthin, Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013. The ray is sheared so
//! that it runs along +z from the origin; a triangle is hit where its three 2-D edge functions have one sign. An
//! edge shared by two triangles gives the same number in both (no fused multiply-add), so no ray slips between;
//! an edge function that is exactly zero is computed again in f64. Both sides block.
//!
//! Here for any processor; `simd` does the same operations in the same order, and returns the same bits.

use glam::Vec3;

/// Lanes of a block. Leaves of the tree are whole blocks.
pub const LANES: usize = 8;

/// One number per lane.
pub type Lanes = [f32; LANES];

/// Triangles side by side, one coordinate per row: `corners[corner][axis][lane]`. Empty lanes hold NaN, which no
/// test accepts.
#[derive(Debug, Clone)]
#[repr(C, align(64))]
pub struct TriangleBlock {
    pub corners: [[Lanes; 3]; 3],
    /// Which triangle a lane holds; `u32::MAX` where empty.
    pub id: [u32; LANES],
}

impl TriangleBlock {
    /// No triangle yet.
    pub const EMPTY: TriangleBlock = TriangleBlock { corners: [[[f32::NAN; LANES]; 3]; 3], id: [u32::MAX; LANES] };

    /// Puts a triangle into a lane.
    pub fn set(&mut self, lane: usize, id: u32, corners: [Vec3; 3]) {
        self.id[lane] = id;
        for (corner, position) in corners.iter().enumerate() {
            for axis in 0..3 {
                self.corners[corner][axis][lane] = position[axis];
            }
        }
    }
}

/// A hit as the tree knows it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TreeHit {
    /// In lengths of the ray's direction.
    pub t: f32,
    /// Index of the triangle as given to [`Tree::build`](super::Tree::build).
    pub triangle: u32,
    /// Weight of corner 1.
    pub v: f32,
    /// Weight of corner 2.
    pub w: f32,
}

impl TreeHit {
    /// Takes the place of `best` if it is nearer, of equally near ones the triangle of the lower index, and `accept` lets
    /// it count.
    #[inline(always)]
    pub(super) fn keep_nearest(
        self,
        t_max: f32,
        accept: &mut impl FnMut(&TreeHit) -> bool,
        best: &mut Option<TreeHit>,
        nearest: &mut f32,
    ) {
        let nearer = best.is_none_or(|b| self.t < b.t || (self.t == b.t && self.triangle < b.triangle));
        if nearer && self.t < t_max && accept(&self) {
            *best = Some(self);
            *nearest = self.t;
        }
    }
}

/// A ray prepared for triangle tests: axes permuted so that the longest direction component comes last.
#[derive(Debug, Clone, Copy)]
pub struct ShearedRay {
    pub origin: [f32; 3],
    pub axes: [usize; 3],
    pub shear: [f32; 3],
}

impl ShearedRay {
    /// `direction` need not be a unit vector; t counts in its lengths.
    #[inline(always)]
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        let (origin, size, direction) = (origin.to_array(), direction.abs(), direction.to_array());
        let kz = if size.x > size.y && size.x > size.z {
            0
        } else if size.y > size.z {
            1
        } else {
            2
        };
        // Keep the winding: swap the other two where the ray runs backwards.
        let next = [1, 2, 0, 1][kz];
        let after = [1, 2, 0, 1][kz + 1];
        let (kx, ky) = if direction[kz] < 0.0 { (after, next) } else { (next, after) };
        ShearedRay {
            origin: [origin[kx], origin[ky], origin[kz]],
            axes: [kx, ky, kz],
            shear: [direction[kx] / direction[kz], direction[ky] / direction[kz], 1.0 / direction[kz]],
        }
    }

    /// The hits of the line on which the ray lies, t of any sign, lane by lane.
    #[inline(always)]
    pub fn intersect(&self, block: &TriangleBlock) -> impl Iterator<Item = TreeHit> {
        let [kx, ky, kz] = self.axes;
        let [sx, sy, sz] = self.shear;
        // Sheared corners: x and y per corner, and z scaled to ray lengths.
        let mut x = [[0.0f32; LANES]; 3];
        let mut y = [[0.0f32; LANES]; 3];
        let mut z = [[0.0f32; LANES]; 3];
        for corner in 0..3 {
            let c = &block.corners[corner];
            for lane in 0..LANES {
                let depth = c[kz][lane] - self.origin[2];
                x[corner][lane] = (c[kx][lane] - self.origin[0]) - sx * depth;
                y[corner][lane] = (c[ky][lane] - self.origin[1]) - sy * depth;
                z[corner][lane] = sz * depth;
            }
        }
        let mut edges = Edges::default();
        let mut zero = false;
        for lane in 0..LANES {
            edges.u[lane] = x[2][lane] * y[1][lane] - y[2][lane] * x[1][lane];
            edges.v[lane] = x[0][lane] * y[2][lane] - y[0][lane] * x[2][lane];
            edges.w[lane] = x[1][lane] * y[0][lane] - y[1][lane] * x[0][lane];
            zero |= edges.u[lane] == 0.0 || edges.v[lane] == 0.0 || edges.w[lane] == 0.0;
        }
        if zero {
            edges.recheck(&x, &y);
        }
        let Edges { u, v, w } = edges;
        let mut met = [false; LANES];
        for lane in 0..LANES {
            let (u, v, w) = (u[lane], v[lane], w[lane]);
            met[lane] = ((u >= 0.0) & (v >= 0.0) & (w >= 0.0)) | ((u <= 0.0) & (v <= 0.0) & (w <= 0.0));
        }
        let hit = move |lane: usize| {
            let (u, v, w) = (u[lane], v[lane], w[lane]);
            let determinant = u + v + w;
            let scaled = u * z[0][lane] + v * z[1][lane] + w * z[2][lane];
            let reciprocal = 1.0 / determinant;
            let hit =
                TreeHit { t: scaled * reciprocal, triangle: block.id[lane], v: v * reciprocal, w: w * reciprocal };
            (determinant != 0.0).then_some(hit)
        };
        (0..LANES).filter(move |lane| met[*lane]).filter_map(hit)
    }
}

/// The edge functions of a block: twice the areas of the triangles that the ray makes with each edge.
#[derive(Debug, Default)]
pub struct Edges {
    /// Opposite corner 0, 1, 2.
    pub u: Lanes,
    pub v: Lanes,
    pub w: Lanes,
}

impl Edges {
    /// Where one is exactly zero: all three again, in f64, where the products of f32 are exact.
    #[cold]
    pub fn recheck(&mut self, x: &[Lanes; 3], y: &[Lanes; 3]) {
        for lane in 0..LANES {
            if self.u[lane] == 0.0 || self.v[lane] == 0.0 || self.w[lane] == 0.0 {
                let edge = |a: usize, b: usize| {
                    (f64::from(x[a][lane]) * f64::from(y[b][lane]) - f64::from(y[a][lane]) * f64::from(x[b][lane]))
                        as f32
                };
                self.u[lane] = edge(2, 1);
                self.v[lane] = edge(0, 2);
                self.w[lane] = edge(1, 0);
            }
        }
    }
}
