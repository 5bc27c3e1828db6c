// Samples a gdibl irradiance volume (a grid, sparse or not): irradiance at a position, trilinear between nodes, with validity and walls.
//
//     float3 irradiance = gdibl_irradiance(world_position - volume_min, normal);
//     float3 diffuse = albedo / 3.14159265 * max(irradiance, 0.0);    // here is the 1/pi
//
// Include this file, and upload what `Volume::gpu_buffers` of the crate gdibl-runtime returns. The same in WGSL and GLSL
// lies beside it. What it computes is said in FORMAT.md, "Light at a position", "Sparse grids", "Walls" and "From coefficients to
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
// Shader model 5.0 and up.

// Define these to your own before; from shader model 5.1 on with the space: `t0, space1`.
#ifndef GDIBL_VOLUME
#define GDIBL_VOLUME b0
#define GDIBL_COEFFICIENTS t0
#define GDIBL_MARKS t1
#define GDIBL_WALLS t2
#endif

cbuffer GdiblVolume : register(GDIBL_VOLUME) {
    float3 gdibl_nodes_per_metre; // per axis; 0 on an axis with one node: nothing varies along it
    float gdibl_scale;            // coefficient = f16 * scale
    uint3 gdibl_counts;           // nodes per axis; node (x, y, z) is x + counts.x * (y + counts.y * z). Of a sparse grid places
    uint gdibl_bands;             // 0, 1, 2: 1, 4, 9 coefficients per channel
    float3 gdibl_extent;          // max - min of the box, metres
    float gdibl_bias;             // metres along the normal: a surface in a wall's plane falls to the side that it faces
    uint gdibl_marked;            // 0: every node is valid and there are no walls
    uint gdibl_levels;            // 0: a grid. Else a sparse one, its largest cells 2^levels places wide
    uint gdibl_valid_at;          // sparse: where in gdibl_marks the bits of valid nodes begin
    float gdibl_step;             // of packed coefficients; 0: they are f16
};

// Radiance coefficients as pairs of f16, 2, 6 or 14 words per node: red, green, blue of coefficient 0, then of 1, ...
// Or packed, where the volume has a step: per 64 nodes a head of 3 C + 3 words (C = 1, 4, 9), then rows of bits; see gdibl_packed.
StructuredBuffer<uint> gdibl_coefficients : register(GDIBL_COEFFICIENTS);

// Grid: 3 words per 32 nodes: bits of valid nodes; bits of nodes which are the lowest corner of a cell with walls; where in
// gdibl_walls the record of the first of these cells is.
// Sparse grid: 38 words per brick of 8 x 8 x 8 places: its first node; where the record of its first cell with walls is; the
// nodes before each z, 16 bits each; 16 words of bits of nodes, two per z; as many of lowest corners of cells with walls.
StructuredBuffer<uint> gdibl_marks : register(GDIBL_MARKS);

// First the planes: unit normal and distance, as bits of floats. Then the cells:
//     x  indices of planes 0 and 1, 16 bits each      y  index of plane 2; from bit 16 on the corners where walls end
//     z, w  8 masks of 8 bits: the corners that count in each part of the cell
StructuredBuffer<uint4> gdibl_walls : register(GDIBL_WALLS);

// Weights that add up to less than this are those of nobody.
static const float GDIBL_LEAST = 1e-6;
static const uint GDIBL_NO_PLANE = 0xffffu;
// No node, no record.
static const uint GDIBL_NONE = 0xffffffffu;

float2 gdibl_pair(uint at) {
    uint word = gdibl_coefficients[at];
    return float2(f16tof32(word & 0xffffu), f16tof32(word >> 16u));
}

// The next number of a row: what is over the least of its 64 nodes, in as many bits as that takes. `place` is that of its words
// in the head, and of its first bit in the rows; both move on.
int gdibl_number(uint rows, inout uint2 place) {
    uint head = gdibl_coefficients[place.x];
    uint width = head >> 16u;
    uint word = rows + (place.y >> 5u);
    uint shift = place.y & 31u;
    uint bits = gdibl_coefficients[word] >> shift;
    if (shift + width > 32u) {
        bits |= gdibl_coefficients[word + 1u] << (32u - shift);
    }
    place += uint2(1u, width);
    return (asint(head << 16u) >> 16) + int(bits & ((1u << width) - 1u));
}

// Irradiance of one node in packed coefficients. Its numbers q are steps of irradiance's coefficients in M, which is the first of
// all in an orthonormal basis of colour: (r + g + b) / sqrt(3), (r - b) / sqrt(2), (2 g - r - b) / sqrt(6). The constants are
// those of the basis functions.
float3 gdibl_packed(uint node, float3 n) {
    float functions[9];
    functions[0] = 0.28209479;
    functions[1] = 0.48860251 * n.y;
    functions[2] = 0.48860251 * n.z;
    functions[3] = 0.48860251 * n.x;
    functions[4] = 1.0925484 * n.x * n.y;
    functions[5] = 1.0925484 * n.y * n.z;
    functions[6] = 0.31539157 * (3.0 * n.z * n.z - 1.0);
    functions[7] = 1.0925484 * n.x * n.z;
    functions[8] = 0.54627422 * (n.x * n.x - n.y * n.y);
    uint count = (gdibl_bands + 1u) * (gdibl_bands + 1u);
    uint head = (node >> 6u) * (3u * count + 3u);
    uint rows = gdibl_coefficients[head];
    uint2 place = uint2(head + 2u, (node & 63u) * gdibl_coefficients[head + 1u]);
    int code = gdibl_number(rows, place);
    if (code < 1) {
        return float3(0.0, 0.0, 0.0);
    }
    float m = exp2(float(code - 16384) / 256.0);
    float3 k = float3(0.0, 0.0, 0.0);
    [loop] for (uint i = 0u; i < count; i++) {
        int q0 = gdibl_number(rows, place);
        int q1 = gdibl_number(rows, place);
        int q2 = gdibl_number(rows, place);
        k += functions[i] * float3(float(q0), float(q1), float(q2));
    }
    k = gdibl_step * k + float3(functions[0], 0.0, 0.0);
    k *= m * float3(0.57735027, 0.70710678, 0.40824829);
    return float3(k.x + k.y - k.z, k.x + 2.0 * k.z, k.x - k.y - k.z);
}

// Irradiance of one node over `scale`, for a surface with this normal: sum of A_l L_lm Y_lm(normal), A = pi, 2 pi/3, pi/4.
// The constants are A_l times that of the basis function.
float3 gdibl_node_irradiance(uint node, float3 n) {
    if (gdibl_step > 0.0) {
        return gdibl_packed(node, n);
    }
    // Band 0.
    uint at = node * (gdibl_bands == 0u ? 2u : (gdibl_bands == 1u ? 6u : 14u));
    float2 a0 = gdibl_pair(at);
    float2 a1 = gdibl_pair(at + 1u);
    float3 sum = 0.88622693 * float3(a0, a1.x);
    if (gdibl_bands == 0u) {
        return sum;
    }
    // Band 1: y, z, x.
    float2 a2 = gdibl_pair(at + 2u);
    float2 a3 = gdibl_pair(at + 3u);
    float2 a4 = gdibl_pair(at + 4u);
    float2 a5 = gdibl_pair(at + 5u);
    sum += 1.0233267 * (n.y * float3(a1.y, a2) + n.z * float3(a3, a4.x) + n.x * float3(a4.y, a5));
    if (gdibl_bands == 1u) {
        return sum;
    }
    // Band 2: xy, yz, 3zz - 1, xz, xx - yy.
    float2 a6 = gdibl_pair(at + 6u);
    float2 a7 = gdibl_pair(at + 7u);
    float2 a8 = gdibl_pair(at + 8u);
    float2 a9 = gdibl_pair(at + 9u);
    float2 a10 = gdibl_pair(at + 10u);
    float2 a11 = gdibl_pair(at + 11u);
    float2 a12 = gdibl_pair(at + 12u);
    float2 a13 = gdibl_pair(at + 13u);
    sum += 0.8580855 * (n.x * n.y * float3(a6, a7.x) + n.y * n.z * float3(a7.y, a8));
    sum += 0.24770796 * (3.0 * n.z * n.z - 1.0) * float3(a9, a10.x);
    sum += 0.8580855 * n.x * n.z * float3(a10.y, a11);
    sum += 0.42904275 * (n.x * n.x - n.y * n.y) * float3(a12, a13.x);
    return sum;
}

// What each corner of a cell with walls counts at a position in it: 1 if it is seen from there, less if not.
// `record` is the cell's, `weights` are its trilinear ones. Corners: see gdibl_irradiance.
void gdibl_shares(uint4 record, float3 position, float weights[8], out float shares[8]) {
    // Which part of the cell: one bit for each plane that the position lies above.
    uint3 planes = uint3(record.x & 0xffffu, record.x >> 16u, record.y & 0xffffu);
    uint part = 0u;
    [unroll] for (int k = 0; k < 3; k++) {
        if (planes[k] != GDIBL_NO_PLANE) {
            float4 plane = asfloat(gdibl_walls[planes[k]]);
            part |= dot(plane.xyz, position) > plane.w ? 1u << uint(k) : 0u;
        }
    }
    uint mask = ((part >= 4u ? record.w : record.z) >> (8u * (part & 3u))) & 0xffu;
    // Toward the corners where walls end the hidden corners fade in, so that nothing jumps where the next cell has no wall.
    float at_ends = 0.0;
    [unroll] for (int k = 0; k < 8; k++) {
        at_ends += weights[k] * float((record.y >> uint(16 + k)) & 1u);
    }
    float hidden = max(0.0, 2.0 * at_ends - 1.0);
    [unroll] for (int k = 0; k < 8; k++) {
        shares[k] = ((mask >> uint(k)) & 1u) == 1u ? 1.0 : hidden;
    }
}

// Where in gdibl_marks the brick that holds a place begins.
uint gdibl_brick(uint3 place) {
    uint3 bricks = (gdibl_counts + 7u) >> 3u;
    uint3 brick = place >> 3u;
    return 38u * (brick.x + bricks.x * (brick.y + bricks.y * brick.z));
}

// Which of a brick's words of bits a place is in, and which bit it is.
uint2 gdibl_bit(uint3 place) {
    uint3 within = place & 7u;
    return uint2(2u * within.z + (within.y >> 2u), within.x + 8u * (within.y & 3u));
}

// The node at a place of a sparse grid.
uint gdibl_node_at(uint3 place) {
    uint brick = gdibl_brick(place);
    uint2 at = gdibl_bit(place);
    uint bits = gdibl_marks[brick + 6u + at.x];
    if (((bits >> at.y) & 1u) == 0u) {
        return GDIBL_NONE;
    }
    uint before = gdibl_marks[brick + 2u + (at.x >> 2u)] >> (8u * (at.x & 2u));
    uint node = gdibl_marks[brick] + (before & 0xffffu) + countbits(bits & ((1u << at.y) - 1u));
    if ((at.x & 1u) == 1u) {
        node += countbits(gdibl_marks[brick + 5u + at.x]);
    }
    return node;
}

// The nodes and weights of the cell of a sparse grid that holds `place`, which is in `lowest` of the finest. Returns where
// its record is if walls go through it.
uint gdibl_sparse_cell(float3 place, uint3 lowest, out uint nodes[8], out float weights[8]) {
    uint3 wide = min(gdibl_counts - 1u, uint3(1u, 1u, 1u));
    uint brick = gdibl_brick(lowest);
    // From the largest cells downward: a cell is divided if its middle is a node.
    uint level = gdibl_levels;
    uint3 origin = (lowest >> level) << level;
    while (level > 0u) {
        uint2 at = gdibl_bit(origin + ((1u << level) >> 1u) * wide);
        if (((gdibl_marks[brick + 6u + at.x] >> at.y) & 1u) == 0u) {
            break;
        }
        level -= 1u;
        origin = (lowest >> level) << level;
    }
    uint width = 1u << level;
    float3 share = (place - float3(origin)) / float(width);
    // The corner that is the larger cell's, too.
    uint3 upper = (origin >> level) & 1u;
    uint shared_corner = upper.x | (upper.y << 1u) | (upper.z << 2u);
    // A corner that is no node lies in the middle of the larger cell's edge or face: its far end takes the place.
    uint hanging = 0u;
    [unroll] for (int k = 0; k < 8; k++) {
        uint3 high = uint3(uint(k) & 1u, (uint(k) >> 1u) & 1u, uint(k) >> 2u);
        float3 along = lerp(1.0 - share, share, float3(high));
        weights[k] = along.x * along.y * along.z;
        uint3 corner = origin + width * high * wide;
        uint node = gdibl_node_at(corner);
        if (node == GDIBL_NONE) {
            hanging |= 1u << uint(k);
            // One step up from the lower half, one step down from the upper; none on the other axes.
            uint3 middle = (corner >> level) & 1u;
            node = gdibl_node_at(corner + width * middle * (1u - upper) - width * middle * upper);
        }
        nodes[k] = node;
    }
    // Edges: half of the weight stays, half is that of the shared corner.
    [unroll] for (uint axis = 0u; axis < 3u; axis++) {
        uint k = shared_corner ^ (1u << axis);
        if (((hanging >> k) & 1u) == 1u) {
            weights[k] *= 0.5;
            weights[shared_corner] += weights[k];
        }
    }
    // Faces, across each axis: a quarter stays, a quarter each is that of the others in the larger cell's face.
    [unroll] for (uint axis = 0u; axis < 3u; axis++) {
        uint one = 1u << ((axis + 1u) % 3u);
        uint two = 1u << ((axis + 2u) % 3u);
        uint k = shared_corner ^ one ^ two;
        if (((hanging >> k) & 1u) == 1u) {
            weights[k] *= 0.25;
            weights[shared_corner] += weights[k];
            weights[shared_corner ^ one] += weights[k];
            weights[shared_corner ^ two] += weights[k];
        }
    }
    uint2 at = gdibl_bit(origin);
    uint walled = gdibl_marks[brick + 22u + at.x];
    if (((walled >> at.y) & 1u) == 0u) {
        return GDIBL_NONE;
    }
    uint record = gdibl_marks[brick + 1u] + countbits(walled & ((1u << at.y) - 1u));
    for (uint word = 0u; word < at.x; word++) {
        record += countbits(gdibl_marks[brick + 22u + word]);
    }
    return record;
}

float gdibl_is_valid(uint node) {
    uint word = gdibl_levels > 0u ? gdibl_valid_at + (node >> 5u) : 3u * (node >> 5u);
    return float((gdibl_marks[word] >> (node & 31u)) & 1u);
}

float3 gdibl_irradiance(float3 position, float3 normal) {
    uint3 counts = gdibl_counts;
    // The position in units of nodes, held within the grid; the cell around it, and the share of its higher nodes.
    float3 biased = position + gdibl_bias * normal;
    float3 place = clamp(biased * gdibl_nodes_per_metre, float3(0.0, 0.0, 0.0), float3(counts - 1u));
    uint3 lowest = min(uint3(place), max(counts, uint3(2u, 2u, 2u)) - 2u);
    uint nodes[8];
    float weights[8];
    // Of the cell's walls, in gdibl_walls.
    uint record_at = GDIBL_NONE;
    if (gdibl_levels > 0u) {
        record_at = gdibl_sparse_cell(place, lowest, nodes, weights);
    } else {
        // Corner k is the higher one in x, y, z where bit 0, 1, 2 of k is set. With one node on an axis both are the same.
        float3 share = place - float3(lowest);
        uint3 steps = uint3(
            counts.x > 1u ? 1u : 0u,
            counts.y > 1u ? counts.x : 0u,
            counts.z > 1u ? counts.x * counts.y : 0u
        );
        uint first = lowest.x + counts.x * (lowest.y + counts.y * lowest.z);
        [unroll] for (int k = 0; k < 8; k++) {
            uint3 high = uint3(uint(k) & 1u, (uint(k) >> 1u) & 1u, uint(k) >> 2u);
            float3 along = lerp(1.0 - share, share, float3(high));
            nodes[k] = first + high.x * steps.x + high.y * steps.y + high.z * steps.z;
            weights[k] = along.x * along.y * along.z;
        }
        if (gdibl_marked != 0u) {
            uint block = 3u * (first >> 5u);
            uint walled = gdibl_marks[block + 1u];
            uint bit = 1u << (first & 31u);
            if ((walled & bit) != 0u) {
                record_at = gdibl_marks[block + 2u] + countbits(walled & (bit - 1u));
            }
        }
    }

    if (gdibl_marked != 0u) {
        // Of valid nodes alone.
        float valid[8];
        float valid_sum = 0.0;
        [unroll] for (int k = 0; k < 8; k++) {
            valid[k] = weights[k] * gdibl_is_valid(nodes[k]);
            valid_sum += valid[k];
        }
        // Of those, what is seen from here.
        float seen[8];
        float seen_sum = 0.0;
        if (record_at != GDIBL_NONE) {
            float3 held = clamp(biased, float3(0.0, 0.0, 0.0), gdibl_extent);
            gdibl_shares(gdibl_walls[record_at], held, weights, seen);
            [unroll] for (int k = 0; k < 8; k++) {
                seen[k] *= valid[k];
                seen_sum += seen[k];
            }
        }
        // Weights add up to 1 again. Where no node is seen, all valid ones count; where none is valid, all do.
        [unroll] for (int k = 0; k < 8; k++) {
            if (seen_sum >= GDIBL_LEAST) {
                weights[k] = seen[k] / seen_sum;
            } else if (valid_sum >= GDIBL_LEAST) {
                weights[k] = valid[k] / valid_sum;
            }
        }
    }

    float3 sum = float3(0.0, 0.0, 0.0);
    [unroll] for (int k = 0; k < 8; k++) {
        // Nodes without weight are not read.
        if (weights[k] > 0.0) {
            sum += weights[k] * gdibl_node_irradiance(nodes[k], normal);
        }
    }
    return gdibl_scale * sum;
}
