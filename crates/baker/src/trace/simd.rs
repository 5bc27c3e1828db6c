//! The tests of boxes and triangles by AVX2. With `stack` one of the two files with `unsafe`.
//!
//! What AVX2 does has a safe twin in `traverse` and `triangle`: the same operations in the same order, no fused multiply-add,
//! so the same bits come out; `tests/watertight` compares the two. The traversal itself is one for both.

#![allow(unsafe_code, reason = "SIMD; a proof stands at each block")]

#[cfg(target_arch = "x86_64")]
pub use avx2::Avx2;

/// No such thing on this processor.
#[cfg(not(target_arch = "x86_64"))]
#[derive(Debug, Clone, Copy)]
pub enum Avx2 {}

#[cfg(not(target_arch = "x86_64"))]
impl Avx2 {
    pub fn detect() -> Option<Avx2> {
        None
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use std::arch::x86_64::*;

    use crate::trace::node::{Hierarchy, Node};
    use crate::trace::traverse::{FAR_MARGIN, Slabs, traverse};
    use crate::trace::triangle::{Edges, LANES, Lanes, ShearedRay, TreeHit, TriangleBlock};

    /// Proof that this processor has AVX2: [`Avx2::detect`] alone makes one.
    #[derive(Debug, Clone, Copy)]
    pub struct Avx2(());

    impl Avx2 {
        /// The proof, where it is true.
        pub fn detect() -> Option<Avx2> {
            is_x86_feature_detected!("avx2").then_some(Avx2(()))
        }

        /// [`Tree::closest`](crate::trace::Tree::closest).
        #[inline]
        pub fn closest(
            self,
            hierarchy: &Hierarchy,
            ray: (Slabs, ShearedRay),
            range: (f32, f32),
            accept: impl FnMut(&TreeHit) -> bool,
        ) -> Option<TreeHit> {
            // The processor has AVX2: `self` says so.
            unsafe { closest(hierarchy, ray, range, accept) }
        }

        /// [`Tree::any`](crate::trace::Tree::any).
        #[inline]
        pub fn any(
            self,
            hierarchy: &Hierarchy,
            ray: (Slabs, ShearedRay),
            range: (f32, f32),
            visit: impl FnMut(&TreeHit) -> bool,
        ) {
            // The processor has AVX2: `self` says so.
            unsafe { any(hierarchy, ray, range, visit) }
        }
    }

    /// As [`ShearedRay::intersect`]. Where the line meets no triangle of the block, the closure that asks returns true at
    /// once. A macro, because `inline(always)` does not go with `target_feature`, and a call costs 2 to 7 %.
    macro_rules! intersect {
        ($ray:expr, $block:expr) => {{
            let [kx, ky, kz] = $ray.axes;
            let [ox, oy, oz] = $ray.origin;
            let [sx, sy, sz] = $ray.shear;
            let [c0, c1, c2] = &$block.corners;
            let depth0 = _mm256_sub_ps(load(&c0[kz]), oz);
            let depth1 = _mm256_sub_ps(load(&c1[kz]), oz);
            let depth2 = _mm256_sub_ps(load(&c2[kz]), oz);
            let x0 = _mm256_sub_ps(_mm256_sub_ps(load(&c0[kx]), ox), _mm256_mul_ps(sx, depth0));
            let x1 = _mm256_sub_ps(_mm256_sub_ps(load(&c1[kx]), ox), _mm256_mul_ps(sx, depth1));
            let x2 = _mm256_sub_ps(_mm256_sub_ps(load(&c2[kx]), ox), _mm256_mul_ps(sx, depth2));
            let y0 = _mm256_sub_ps(_mm256_sub_ps(load(&c0[ky]), oy), _mm256_mul_ps(sy, depth0));
            let y1 = _mm256_sub_ps(_mm256_sub_ps(load(&c1[ky]), oy), _mm256_mul_ps(sy, depth1));
            let y2 = _mm256_sub_ps(_mm256_sub_ps(load(&c2[ky]), oy), _mm256_mul_ps(sy, depth2));
            let mut u = _mm256_sub_ps(_mm256_mul_ps(x2, y1), _mm256_mul_ps(y2, x1));
            let mut v = _mm256_sub_ps(_mm256_mul_ps(x0, y2), _mm256_mul_ps(y0, x2));
            let mut w = _mm256_sub_ps(_mm256_mul_ps(x1, y0), _mm256_mul_ps(y1, x0));
            let zero = _mm256_setzero_ps();
            let on_edge = _mm256_or_ps(
                _mm256_cmp_ps::<_CMP_EQ_OQ>(u, zero),
                _mm256_or_ps(_mm256_cmp_ps::<_CMP_EQ_OQ>(v, zero), _mm256_cmp_ps::<_CMP_EQ_OQ>(w, zero)),
            );
            if _mm256_movemask_ps(on_edge) != 0 {
                [u, v, w] = recheck([u, v, w], [x0, x1, x2], [y0, y1, y2]);
            }
            let lowest = _mm256_min_ps(_mm256_min_ps(u, v), w);
            let highest = _mm256_max_ps(_mm256_max_ps(u, v), w);
            let one_sign =
                _mm256_or_ps(_mm256_cmp_ps::<_CMP_GE_OQ>(lowest, zero), _mm256_cmp_ps::<_CMP_LE_OQ>(highest, zero));
            if _mm256_movemask_ps(one_sign) == 0 {
                return true;
            }
            let determinant = _mm256_add_ps(_mm256_add_ps(u, v), w);
            let inside = _mm256_and_ps(one_sign, _mm256_cmp_ps::<_CMP_NEQ_UQ>(determinant, zero));
            let [z0, z1, z2] = [depth0, depth1, depth2].map(|depth| _mm256_mul_ps(sz, depth));
            let scaled = _mm256_add_ps(_mm256_add_ps(_mm256_mul_ps(u, z0), _mm256_mul_ps(v, z1)), _mm256_mul_ps(w, z2));
            let reciprocal = _mm256_div_ps(_mm256_set1_ps(1.0), determinant);
            Met { inside, t: _mm256_mul_ps(scaled, reciprocal), v, w, reciprocal }
        }};
    }

    #[target_feature(enable = "avx2")]
    fn closest(
        hierarchy: &Hierarchy,
        (slabs, sheared): (Slabs, ShearedRay),
        (t_min, t_max): (f32, f32),
        mut accept: impl FnMut(&TreeHit) -> bool,
    ) -> Option<TreeHit> {
        let sheared = Sheared::new(&sheared);
        let boxes = Boxes::new(&slabs);
        let after = _mm256_set1_ps(t_min);
        let mut best = None;
        traverse::<true>(
            hierarchy,
            t_max,
            |node, nearest| boxes.entries(node, nearest),
            |block, nearest| {
                let met = intersect!(sheared, block);
                let within = _mm256_and_ps(
                    _mm256_cmp_ps::<_CMP_GT_OQ>(met.t, after),
                    _mm256_cmp_ps::<_CMP_LE_OQ>(met.t, _mm256_set1_ps(*nearest)),
                );
                let lanes = _mm256_movemask_ps(_mm256_and_ps(within, met.inside)) as u32;
                if lanes != 0 {
                    for hit in met.hits(block, lanes) {
                        hit.keep_nearest(t_max, &mut accept, &mut best, nearest);
                    }
                }
                true
            },
        );
        best
    }

    #[target_feature(enable = "avx2")]
    fn any(
        hierarchy: &Hierarchy,
        (slabs, sheared): (Slabs, ShearedRay),
        (t_min, t_max): (f32, f32),
        mut visit: impl FnMut(&TreeHit) -> bool,
    ) {
        let sheared = Sheared::new(&sheared);
        let boxes = Boxes::new(&slabs);
        let (after, before) = (_mm256_set1_ps(t_min), _mm256_set1_ps(t_max));
        traverse::<false>(
            hierarchy,
            t_max,
            |node, nearest| boxes.entries(node, nearest),
            |block, _| {
                let met = intersect!(sheared, block);
                let within = _mm256_and_ps(
                    _mm256_cmp_ps::<_CMP_GT_OQ>(met.t, after),
                    _mm256_cmp_ps::<_CMP_LT_OQ>(met.t, before),
                );
                let lanes = _mm256_movemask_ps(_mm256_and_ps(within, met.inside)) as u32;
                lanes == 0 || met.hits(block, lanes).all(|hit| visit(&hit))
            },
        );
    }

    /// [`Slabs`], each number in all lanes.
    struct Boxes {
        origin: [__m256; 3],
        reciprocal: [__m256; 3],
        near: [usize; 3],
    }

    impl Boxes {
        #[inline]
        #[target_feature(enable = "avx2")]
        fn new(slabs: &Slabs) -> Boxes {
            Boxes {
                origin: slabs.origin.map(|o| _mm256_set1_ps(o)),
                reciprocal: slabs.reciprocal.map(|r| _mm256_set1_ps(r)),
                near: slabs.near,
            }
        }

        /// As [`Slabs::entries`].
        #[inline]
        #[target_feature(enable = "avx2")]
        fn entries(&self, node: &Node, nearest: f32) -> (u32, Lanes) {
            let [ox, oy, oz] = self.origin;
            let [rx, ry, rz] = self.reciprocal;
            let [nx, ny, nz] = self.near;
            let [bx, by, bz] = &node.bounds;
            let entry_x = _mm256_mul_ps(_mm256_sub_ps(load(&bx[nx]), ox), rx);
            let entry_y = _mm256_mul_ps(_mm256_sub_ps(load(&by[ny]), oy), ry);
            let entry_z = _mm256_mul_ps(_mm256_sub_ps(load(&bz[nz]), oz), rz);
            let exit_x = _mm256_mul_ps(_mm256_sub_ps(load(&bx[1 - nx]), ox), rx);
            let exit_y = _mm256_mul_ps(_mm256_sub_ps(load(&by[1 - ny]), oy), ry);
            let exit_z = _mm256_mul_ps(_mm256_sub_ps(load(&bz[1 - nz]), oz), rz);
            let entry = _mm256_max_ps(_mm256_max_ps(entry_x, entry_y), _mm256_max_ps(entry_z, _mm256_setzero_ps()));
            let exit = _mm256_min_ps(_mm256_min_ps(exit_x, exit_y), exit_z);
            let exit = _mm256_min_ps(_mm256_mul_ps(exit, _mm256_set1_ps(FAR_MARGIN)), _mm256_set1_ps(nearest));
            (_mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(entry, exit)) as u32, lanes_of(entry))
        }
    }

    /// [`ShearedRay`], each number in all lanes.
    struct Sheared {
        origin: [__m256; 3],
        axes: [usize; 3],
        shear: [__m256; 3],
    }

    impl Sheared {
        #[inline]
        #[target_feature(enable = "avx2")]
        fn new(ray: &ShearedRay) -> Sheared {
            Sheared {
                origin: ray.origin.map(|o| _mm256_set1_ps(o)),
                axes: ray.axes,
                shear: ray.shear.map(|s| _mm256_set1_ps(s)),
            }
        }
    }

    /// The triangles of a block that the line of a ray meets: t, and v and w times the determinant.
    struct Met {
        inside: __m256,
        t: __m256,
        v: __m256,
        w: __m256,
        reciprocal: __m256,
    }

    impl Met {
        /// The hits of these lanes.
        #[inline]
        #[target_feature(enable = "avx2")]
        fn hits(&self, block: &TriangleBlock, mut lanes: u32) -> impl Iterator<Item = TreeHit> {
            let t = lanes_of(self.t);
            let v = lanes_of(_mm256_mul_ps(self.v, self.reciprocal));
            let w = lanes_of(_mm256_mul_ps(self.w, self.reciprocal));
            std::iter::from_fn(move || {
                if lanes == 0 {
                    return None;
                }
                let lane = lanes.trailing_zeros() as usize % LANES;
                lanes &= lanes - 1;
                Some(TreeHit { t: t[lane], triangle: block.id[lane], v: v[lane], w: w[lane] })
            })
        }
    }

    /// [`Edges::recheck`].
    #[cold]
    #[inline(never)]
    #[target_feature(enable = "avx2")]
    fn recheck([u, v, w]: [__m256; 3], x: [__m256; 3], y: [__m256; 3]) -> [__m256; 3] {
        let mut edges = Edges { u: lanes_of(u), v: lanes_of(v), w: lanes_of(w) };
        edges.recheck(&x.map(|x| lanes_of(x)), &y.map(|y| lanes_of(y)));
        [load(&edges.u), load(&edges.v), load(&edges.w)]
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn load(lanes: &Lanes) -> __m256 {
        // Eight f32 behind a reference; no alignment is asked for.
        unsafe { _mm256_loadu_ps(lanes.as_ptr()) }
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn lanes_of(vector: __m256) -> Lanes {
        let mut lanes = [0.0; LANES];
        // Room for the eight f32 that are written; no alignment is asked for.
        unsafe { _mm256_storeu_ps(lanes.as_mut_ptr(), vector) };
        lanes
    }
}
