//! Ray against four triangles at once, watertight.
//!
//! Based on: Woop, Benthin, Wald, "Watertight Ray/Triangle Intersection", JCGT 2(1), 2013. The ray is sheared so
//! that it runs along +z from the origin; a triangle is hit where its three 2-D edge functions have one sign. An
//! edge shared by two triangles gives the same number in both (no fused multiply-add), so no ray slips between;
//! an edge function that is exactly zero is computed again in f64. Both sides block.

use glam::Vec3;

/// Lanes of a block. Leaves of the tree are whole blocks.
pub const LANES: usize = 4;

/// Four triangles, one coordinate per row: `corners[corner][axis][lane]`. Empty lanes hold NaN, which no test
/// accepts.
#[derive(Debug, Clone)]
pub struct TriangleBlock {
    corners: [[[f32; LANES]; 3]; 3],
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

/// A ray prepared for triangle tests: axes permuted so that the longest direction component comes last.
#[derive(Debug, Clone, Copy)]
pub struct ShearedRay {
    origin: [f32; 3],
    axes: [usize; 3],
    shear: [f32; 3],
}

impl ShearedRay {
    /// `direction` need not be a unit vector; t counts in its lengths.
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        let size = direction.abs();
        let kz = if size.x > size.y && size.x > size.z {
            0
        } else if size.y > size.z {
            1
        } else {
            2
        };
        // Keep the winding: swap the other two where the ray runs backwards.
        let (kx, ky) = if direction[kz] < 0.0 { ((kz + 2) % 3, (kz + 1) % 3) } else { ((kz + 1) % 3, (kz + 2) % 3) };
        ShearedRay {
            origin: [origin[kx], origin[ky], origin[kz]],
            axes: [kx, ky, kz],
            shear: [direction[kx] / direction[kz], direction[ky] / direction[kz], 1.0 / direction[kz]],
        }
    }

    /// Tests the four triangles. Returns t per lane (+infinity where missed) and the weights of corners 1 and 2.
    #[inline(always)]
    pub fn intersect(&self, block: &TriangleBlock) -> BlockHit {
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
        let mut u = [0.0f32; LANES];
        let mut v = [0.0f32; LANES];
        let mut w = [0.0f32; LANES];
        let mut zero = false;
        for lane in 0..LANES {
            u[lane] = x[2][lane] * y[1][lane] - y[2][lane] * x[1][lane];
            v[lane] = x[0][lane] * y[2][lane] - y[0][lane] * x[2][lane];
            w[lane] = x[1][lane] * y[0][lane] - y[1][lane] * x[0][lane];
            zero |= u[lane] == 0.0 || v[lane] == 0.0 || w[lane] == 0.0;
        }
        if zero {
            for lane in 0..LANES {
                if u[lane] == 0.0 || v[lane] == 0.0 || w[lane] == 0.0 {
                    let edge = |a: usize, b: usize| {
                        (f64::from(x[a][lane]) * f64::from(y[b][lane]) - f64::from(y[a][lane]) * f64::from(x[b][lane]))
                            as f32
                    };
                    u[lane] = edge(2, 1);
                    v[lane] = edge(0, 2);
                    w[lane] = edge(1, 0);
                }
            }
        }
        let mut hit = BlockHit { t: [f32::INFINITY; LANES], v: [0.0; LANES], w: [0.0; LANES] };
        for lane in 0..LANES {
            let lowest = u[lane].min(v[lane]).min(w[lane]);
            let highest = u[lane].max(v[lane]).max(w[lane]);
            let determinant = u[lane] + v[lane] + w[lane];
            let scaled = u[lane] * z[0][lane] + v[lane] * z[1][lane] + w[lane] * z[2][lane];
            let inside = (lowest >= 0.0 || highest <= 0.0) && determinant != 0.0;
            let reciprocal = 1.0 / determinant;
            hit.t[lane] = if inside { scaled * reciprocal } else { f32::INFINITY };
            hit.v[lane] = v[lane] * reciprocal;
            hit.w[lane] = w[lane] * reciprocal;
        }
        hit
    }
}

/// What [`ShearedRay::intersect`] found, per lane.
#[derive(Debug, Clone, Copy)]
pub struct BlockHit {
    /// Distance in lengths of the direction; +infinity where missed, NaN in an empty lane. May be negative.
    pub t: [f32; LANES],
    /// Weight of corner 1, 0..=1.
    pub v: [f32; LANES],
    /// Weight of corner 2, 0..=1.
    pub w: [f32; LANES],
}
