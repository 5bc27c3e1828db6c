// Samples a gdibl irradiance volume (a grid): irradiance at a position, trilinear between nodes, with validity and walls.
//
//     vec3 irradiance = gdibl_irradiance(world_position - volume_min, normal);
//     vec3 diffuse = albedo / 3.14159265 * max(irradiance, 0.0);    // here is the 1/pi
//
// Include this file, and upload what `Volume::gpu_buffers` of the crate gdibl-runtime returns. The same in WGSL and HLSL
// lies beside it. What it computes is said in FORMAT.md, "Light at a position", "Walls" and "From coefficients to
// irradiance"; the CPU's twin is src/sample.rs, and a test compares the two.
//
// position  metres, RELATIVE TO THE BOX'S MIN, so that a float is enough however far the level is from the origin: subtract
//           `GpuBuffers::min` where you have doubles. Outside the box the answer is that of the nearest position in it.
//           Finite.
// normal    unit length, the level's axes: right-handed, Y up.
// Returns   linear Rec.709 irradiance. Few bands ring beside bright lights, so it may be slightly negative: clamp it where
//           you shade, not where you still add lights up.
//
// Bands 0 to 2. Band 3 adds nothing to irradiance, and band 4 nearly nothing.
//
// GLSL 4.30 and up, Vulkan, or ES 3.10 with `precision highp float; precision highp int;`.

// Define these to your own before; in Vulkan with the set: `set = 1, binding = 0`.
#ifndef GDIBL_VOLUME
#define GDIBL_VOLUME binding = 0
#define GDIBL_COEFFICIENTS binding = 1
#define GDIBL_MARKS binding = 2
#define GDIBL_WALLS binding = 3
#endif

layout(std140, GDIBL_VOLUME) uniform GdiblVolume {
    vec3 nodes_per_metre; // per axis; 0 on an axis with one node: nothing varies along it
    float scale;          // coefficient = f16 * scale
    uvec3 counts;         // nodes per axis; node (x, y, z) is x + counts.x * (y + counts.y * z)
    uint bands;           // 0, 1, 2: 1, 4, 9 coefficients per channel
    vec3 extent;          // max - min of the box, metres
    float bias;           // metres along the normal: a surface in a wall's plane falls to the side that it faces
    uint marked;          // 0: every node is valid and there are no walls
    uint zero_0;
    uint zero_1;
    uint zero_2;
} gdibl_volume;

// Radiance coefficients as pairs of f16, 2, 6 or 14 words per node: red, green, blue of coefficient 0, then of 1, ...
layout(std430, GDIBL_COEFFICIENTS) readonly buffer GdiblCoefficients {
    uint gdibl_coefficients[];
};

// 3 words per 32 nodes: bits of valid nodes; bits of nodes which are the lowest corner of a cell with walls; where in
// gdibl_walls the record of the first of these cells is.
layout(std430, GDIBL_MARKS) readonly buffer GdiblMarks {
    uint gdibl_marks[];
};

// First the planes: unit normal and distance, as bits of floats. Then the cells:
//     x  indices of planes 0 and 1, 16 bits each      y  index of plane 2; from bit 16 on the corners where walls end
//     z, w  8 masks of 8 bits: the corners that count in each part of the cell
layout(std430, GDIBL_WALLS) readonly buffer GdiblWalls {
    uvec4 gdibl_walls[];
};

// Weights that add up to less than this are those of nobody.
const float GDIBL_LEAST = 1e-6;
const uint GDIBL_NO_PLANE = 0xffffu;

vec2 gdibl_pair(uint at) {
    return unpackHalf2x16(gdibl_coefficients[at]);
}

// Irradiance of one node over `scale`, for a surface with this normal: sum of A_l L_lm Y_lm(normal), A = pi, 2 pi/3, pi/4.
// The constants are A_l times that of the basis function.
vec3 gdibl_node_irradiance(uint node, vec3 n) {
    // Band 0.
    uint at = node * (gdibl_volume.bands == 0u ? 2u : gdibl_volume.bands == 1u ? 6u : 14u);
    vec2 a0 = gdibl_pair(at);
    vec2 a1 = gdibl_pair(at + 1u);
    vec3 sum = 0.88622693 * vec3(a0, a1.x);
    if (gdibl_volume.bands == 0u) {
        return sum;
    }
    // Band 1: y, z, x.
    vec2 a2 = gdibl_pair(at + 2u);
    vec2 a3 = gdibl_pair(at + 3u);
    vec2 a4 = gdibl_pair(at + 4u);
    vec2 a5 = gdibl_pair(at + 5u);
    sum += 1.0233267 * (n.y * vec3(a1.y, a2) + n.z * vec3(a3, a4.x) + n.x * vec3(a4.y, a5));
    if (gdibl_volume.bands == 1u) {
        return sum;
    }
    // Band 2: xy, yz, 3zz - 1, xz, xx - yy.
    vec2 a6 = gdibl_pair(at + 6u);
    vec2 a7 = gdibl_pair(at + 7u);
    vec2 a8 = gdibl_pair(at + 8u);
    vec2 a9 = gdibl_pair(at + 9u);
    vec2 a10 = gdibl_pair(at + 10u);
    vec2 a11 = gdibl_pair(at + 11u);
    vec2 a12 = gdibl_pair(at + 12u);
    vec2 a13 = gdibl_pair(at + 13u);
    sum += 0.8580855 * (n.x * n.y * vec3(a6, a7.x) + n.y * n.z * vec3(a7.y, a8));
    sum += 0.24770796 * (3.0 * n.z * n.z - 1.0) * vec3(a9, a10.x);
    sum += 0.8580855 * n.x * n.z * vec3(a10.y, a11);
    sum += 0.42904275 * (n.x * n.x - n.y * n.y) * vec3(a12, a13.x);
    return sum;
}

// What each corner of a cell with walls counts at a position in it: 1 if it is seen from there, less if not.
// `record` is the cell's, `weights` are its trilinear ones. Corners: see gdibl_irradiance.
void gdibl_shares(uvec4 record, vec3 position, float weights[8], out float shares[8]) {
    // Which part of the cell: one bit for each plane that the position lies above.
    uvec3 planes = uvec3(record.x & 0xffffu, record.x >> 16u, record.y & 0xffffu);
    uint part = 0u;
    for (int k = 0; k < 3; k++) {
        if (planes[k] != GDIBL_NO_PLANE) {
            vec4 plane = uintBitsToFloat(gdibl_walls[planes[k]]);
            part |= dot(plane.xyz, position) > plane.w ? 1u << uint(k) : 0u;
        }
    }
    uint mask = ((part >= 4u ? record.w : record.z) >> (8u * (part & 3u))) & 0xffu;
    // Toward the corners where walls end the hidden corners fade in, so that nothing jumps where the next cell has no wall.
    float at_ends = 0.0;
    for (int k = 0; k < 8; k++) {
        at_ends += weights[k] * float((record.y >> uint(16 + k)) & 1u);
    }
    float hidden = max(0.0, 2.0 * at_ends - 1.0);
    for (int k = 0; k < 8; k++) {
        shares[k] = ((mask >> uint(k)) & 1u) == 1u ? 1.0 : hidden;
    }
}

vec3 gdibl_irradiance(vec3 position, vec3 normal) {
    uvec3 counts = gdibl_volume.counts;
    // The position in units of nodes, held within the grid; the cell around it, and the share of its higher nodes.
    vec3 biased = position + gdibl_volume.bias * normal;
    vec3 place = clamp(biased * gdibl_volume.nodes_per_metre, vec3(0.0), vec3(counts - 1u));
    uvec3 lowest = min(uvec3(place), max(counts, uvec3(2u)) - 2u);
    vec3 share = place - vec3(lowest);

    // Corner k is the higher one in x, y, z where bit 0, 1, 2 of k is set. With one node on an axis both are the same.
    uvec3 steps = uvec3(
        counts.x > 1u ? 1u : 0u,
        counts.y > 1u ? counts.x : 0u,
        counts.z > 1u ? counts.x * counts.y : 0u
    );
    uint first = lowest.x + counts.x * (lowest.y + counts.y * lowest.z);
    uint nodes[8];
    float weights[8];
    for (int k = 0; k < 8; k++) {
        uvec3 high = uvec3(uint(k) & 1u, (uint(k) >> 1u) & 1u, uint(k) >> 2u);
        vec3 along = mix(1.0 - share, share, vec3(high));
        nodes[k] = first + high.x * steps.x + high.y * steps.y + high.z * steps.z;
        weights[k] = along.x * along.y * along.z;
    }

    if (gdibl_volume.marked != 0u) {
        // Of valid nodes alone.
        float valid[8];
        float valid_sum = 0.0;
        for (int k = 0; k < 8; k++) {
            uint bits = gdibl_marks[3u * (nodes[k] >> 5u)];
            valid[k] = weights[k] * float((bits >> (nodes[k] & 31u)) & 1u);
            valid_sum += valid[k];
        }
        // Of those, what is seen from here.
        float seen[8];
        float seen_sum = 0.0;
        uint block = 3u * (first >> 5u);
        uint walled = gdibl_marks[block + 1u];
        uint bit = 1u << (first & 31u);
        if ((walled & bit) != 0u) {
            uvec4 record = gdibl_walls[gdibl_marks[block + 2u] + uint(bitCount(walled & (bit - 1u)))];
            vec3 held = clamp(biased, vec3(0.0), gdibl_volume.extent);
            gdibl_shares(record, held, weights, seen);
            for (int k = 0; k < 8; k++) {
                seen[k] *= valid[k];
                seen_sum += seen[k];
            }
        }
        // Weights add up to 1 again. Where no node is seen, all valid ones count; where none is valid, all do.
        for (int k = 0; k < 8; k++) {
            if (seen_sum >= GDIBL_LEAST) {
                weights[k] = seen[k] / seen_sum;
            } else if (valid_sum >= GDIBL_LEAST) {
                weights[k] = valid[k] / valid_sum;
            }
        }
    }

    vec3 sum = vec3(0.0);
    for (int k = 0; k < 8; k++) {
        // Nodes without weight are not read.
        if (weights[k] > 0.0) {
            sum += weights[k] * gdibl_node_irradiance(nodes[k], normal);
        }
    }
    return gdibl_volume.scale * sum;
}
