#!/usr/bin/env python3
"""Reads a .gdibl file straight from crates/runtime/FORMAT.md and prints irradiance: a second opinion on ours.

    format_reader.py FILE.gdibl < queries.csv

A query is a line x,y,z,nx,ny,nz; the answer a line r,g,b: E on a surface there, nine significant digits. Shares no code
with the project and uses the standard library only; zstd needs Python 3.14 (compression.zstd). Everything is computed
in double precision. Exit code 3, with a line on stderr, for a file that FORMAT.md does not allow.
"""

import math
import struct
import sys
import zlib

PI = math.pi


class Refused(Exception):
    pass


def demand(condition, message):
    if not condition:
        raise Refused(message)


# --- the container ----------------------------------------------------------------------------------------------------

ELEMENT_SIZES = {b"COVR": 2, b"SERR": 2, b"POSN": 4, b"NORM": 4, b"MESH": 4}


class Volume:
    def __init__(self, data):
        demand(data[:8] == bytes.fromhex("89474449424c0a1a"), "not a .gdibl file")
        demand(len(data) >= 100, "file is cut off in the header")
        version, self.kind = struct.unpack_from("<2I", data, 8)
        demand(version == 1, f"version {version}")
        self.counts = struct.unpack_from("<3I", data, 16)
        self.bands, self.encoding = struct.unpack_from("<2I", data, 28)
        (self.scale,) = struct.unpack_from("<f", data, 36)
        units, section_count = struct.unpack_from("<2I", data, 40)
        self.min = struct.unpack_from("<3d", data, 48)
        self.max = struct.unpack_from("<3d", data, 72)
        demand(self.kind <= 3, f"kind {self.kind}")
        demand(self.bands <= 4, f"bands {self.bands}")
        demand(self.encoding <= 2, f"encoding {self.encoding}")
        demand(units <= 1, f"units {units}")  # 1 is de-ringed, and reads alike
        demand(section_count <= 64, f"{section_count} sections")
        demand(min(self.counts) >= 1, f"counts {self.counts}")
        demand(self.kind == 0 or self.counts[1:] == (1, 1), f"counts {self.counts}")
        for low, high in zip(self.min, self.max):
            demand(math.isfinite(high - low) and low <= high, f"box {self.min} to {self.max}")
        if self.encoding == 2:
            demand(2**-13 <= self.scale <= 1, f"step {self.scale}")
        else:
            mantissa, exponent = math.frexp(self.scale)
            demand(mantissa == 0.5 and -100 <= exponent - 1 <= 100, f"scale {self.scale}")
            demand(self.encoding == 1 or self.scale == 1, f"scale {self.scale} for f32")
        self.node_count = math.prod(self.counts)
        demand(self.node_count < 2**32, f"counts {self.counts}")
        self.sections = self.read_sections(data, section_count)
        self.read_contents()

    def read_sections(self, data, count):
        end = 96 + 40 * count
        demand(len(data) >= end + 4, "file is cut off in the section table")
        demand(struct.unpack_from("<I", data, end)[0] == zlib.crc32(data[:end]), "table is damaged")
        end += 4
        sections = {}
        for row in range(count):
            ident, codec, shuffled, offset, stored_size, raw_size, crc, reserved = struct.unpack_from(
                "<4s2H3Q2I", data, 96 + 40 * row
            )
            start = (end + 7) // 8 * 8
            demand(offset == start, f"{ident}: offset {offset}, not {start}")
            demand(start + stored_size <= len(data), f"{ident}: ends beyond the file")
            demand(not any(data[end:start]), f"{ident}: padding is not zero")
            demand(ident not in sections, f"{ident}: twice")
            demand(reserved == 0, f"{ident}: reserved {reserved}")
            end = start + stored_size
            stored = data[start:end]
            demand(zlib.crc32(stored) == crc, f"{ident}: damaged")
            sections[ident] = self.decode(ident, codec, shuffled, stored, raw_size)
        demand(end == len(data), "bytes after the last section")
        return sections

    def decode(self, ident, codec, shuffled, data, raw_size):
        demand(codec <= 2, f"{ident}: codec {codec}")
        demand(codec < 2 or shuffled == 0, f"{ident}: bits with a filter")
        if codec == 2:
            data = unpack_bits(ident, data, raw_size)
        if codec == 1:
            try:
                from compression import zstd
            except ImportError:
                raise Refused(f"{ident}: zstd needs Python 3.14") from None
            data = zstd.decompress(data)
        demand(len(data) == raw_size, f"{ident}: {len(data)} bytes, not {raw_size}")
        demand(shuffled <= 1, f"{ident}: filter {shuffled}")
        if shuffled == 1:
            size = (4, 2, 2)[self.encoding] if ident == b"RSH " else ELEMENT_SIZES.get(ident)
            demand(size and raw_size % size == 0, f"{ident}: shuffled")
            count = raw_size // size
            plain = bytearray(raw_size)
            for k in range(size):
                plain[k::size] = data[k * count : (k + 1) * count]
            data = bytes(plain)
        return data

    def numbers(self, ident, letter, per_node, required):
        data = self.sections.get(ident)
        if data is None:
            demand(not required, f"no section {ident}")
            return None
        count = self.node_count * per_node
        size = struct.calcsize("<" + letter)
        demand(len(data) == count * size, f"{ident}: {len(data)} bytes, not {count * size}")
        return struct.unpack(f"<{count}{letter}", data)

    def read_contents(self):
        planes = 3 * (self.bands + 1) ** 2
        if self.encoding == 2:
            self.radiance, self.scale = self.unpack(planes), 1.0
        else:
            self.radiance = self.numbers(b"RSH ", "fe"[self.encoding], planes, True)
            demand(all(map(math.isfinite, self.radiance)), "RSH : not finite")
        self.valid = self.numbers(b"VALD", "B", 1, False)
        demand(self.valid is None or max(self.valid) <= 1, "VALD: neither 0 nor 1")
        self.read_bricks()
        self.read_walls()
        self.positions = self.numbers(b"POSN", "f", 3, self.kind in (1, 2))
        self.normals = self.numbers(b"NORM", "f", 3, self.kind == 2)

    def read_bricks(self):
        """The grid that cells are made of, and the nodes in it: {place: node}."""
        self.grid = self.counts
        self.levels = 0
        data = self.sections.get(b"BRIK")
        demand((data is not None) == (self.kind == 3), "BRIK: in sparse grids and nowhere else")
        if data is None:
            return
        demand(len(data) >= 16, "BRIK: cut off")
        *grid, self.levels = struct.unpack_from("<4I", data)
        self.grid = tuple(grid)
        coarsest = 1 << self.levels
        demand(1 <= self.levels <= 3, f"BRIK: {self.levels} levels")
        demand(all(n == 1 or n > 1 and (n - 1) % coarsest == 0 for n in grid), f"BRIK: counts {grid}")
        bricks = [(x, y, z) for z in range(0, grid[2], 8) for y in range(0, grid[1], 8) for x in range(0, grid[0], 8)]
        flags = data[16 : 16 + len(bricks)]
        demand(len(data) == 16 + len(bricks) + 64 * sum(flags) and set(flags) <= {0, 1}, "BRIK: size")
        at = 16 + len(bricks)
        self.nodes = {}
        for (x0, y0, z0), flag in zip(bricks, flags):
            bits = data[at : at + 64] if flag else None
            at += 64 * flag
            for z in range(8):
                for y in range(8):
                    for x in range(8):
                        place = (x0 + x, y0 + y, z0 + z)
                        if bits:
                            is_node = bits[8 * z + y] >> x & 1
                        else:
                            is_node = not any(p % coarsest for p in place) and all(p < n for p, n in zip(place, grid))
                        if is_node:
                            self.nodes[place] = len(self.nodes)
        demand(len(self.nodes) == self.node_count, f"BRIK: {len(self.nodes)} nodes, not {self.node_count}")

    def unpack(self, count):
        """Packed coefficients, as planes of numbers."""
        folded = self.numbers(b"RSH ", "H", count + 1, True)
        planes = []
        for start in range(0, len(folded), self.node_count):
            number, plane = 0, []
            for f in folded[start : start + self.node_count]:
                number += (f >> 1) ^ -(f & 1)
                number = (number + 32768) % 65536 - 32768
                plane.append(number)
            planes.append(plane)
        codes = planes.pop(0)
        demand(min(codes) >= 0, "RSH : a code below 0")
        magnitudes = [2 ** ((code - 16384) / 256) if code > 0 else 0.0 for code in codes]
        radiance = []
        for index in range(count // 3):
            weight = (PI, 2 * PI / 3, PI / 4, PI / 24, PI / 24)[math.isqrt(index)]
            triples = []
            for m, *q in zip(magnitudes, *planes[3 * index : 3 * index + 3]):
                k = [m * self.scale * number / weight for number in q]
                k[0] += m / weight if index == 0 else 0.0
                a, b, c = k[0] / 3**0.5, k[1] / 2**0.5, k[2] / 6**0.5
                triples.append((a + b - c, a + 2 * c, a - b - c))
            for channel in range(3):
                radiance.extend(triple[channel] for triple in triples)
        return radiance

    def read_walls(self):
        """Cells with walls: {lowest node: ([(normal, distance)], ends, masks)}."""
        self.walls = None
        data = self.sections.get(b"WALL")
        if data is None:
            return
        demand(self.kind in (0, 3), "WALL: not in a grid")
        demand(len(data) >= 8, "WALL: cut off")
        plane_count, cell_count = struct.unpack_from("<2I", data)
        demand(len(data) == 8 + 16 * plane_count + 20 * cell_count, "WALL: size")
        planes = [struct.unpack_from("<4f", data, 8 + 16 * k) for k in range(plane_count)]
        demand(all(math.isfinite(v) for plane in planes for v in plane), "WALL: not finite")
        self.walls = {}
        last = -1
        for k in range(cell_count):
            cell, a, b, c, ends, _, *masks = struct.unpack_from("<I3H10B", data, 8 + 16 * plane_count + 20 * k)
            used = [a, b, c, 65535].index(65535)
            demand(cell > last and cell < math.prod(self.grid), f"WALL: cell {cell}")
            demand(max([-1, *(a, b, c)[:used]]) < plane_count, f"WALL: cell {cell}: planes")
            self.walls[cell] = ([planes[p] for p in (a, b, c)[:used]], ends, masks)
            last = cell

    # --- light at a position ------------------------------------------------------------------------------------------

    def coefficient(self, node, index, channel):
        return self.radiance[(3 * index + channel) * self.node_count + node] * self.scale

    def is_valid(self, node):
        return self.valid is None or self.valid[node] == 1

    def weights(self, position, normal):
        """[(node, weight)] whose weights add up to 1."""
        if self.kind in (0, 3):
            return self.grid_weights(position, normal)
        return [(self.nearest(position, normal), 1.0)]

    def grid_weights(self, position, normal):
        if self.walls is not None:
            steps = [(h - l) / (n - 1) for l, h, n in zip(self.min, self.max, self.grid) if n > 1 and h > l]
            bias = 1e-4 * min(steps, default=0.0)
            position = [p + bias * n for p, n in zip(position, normal)]
        place = []
        for p, low, high, count in zip(position, self.min, self.max, self.grid):
            if high > low:
                t = (p - low) / (high - low) * (count - 1)
            else:
                t = count - 1 if p > low else 0
            place.append(min(max(t, 0.0), count - 1.0) if t == t else 0.0)
        lowest, width = self.leaf([min(math.floor(t), max(count - 2, 0)) for t, count in zip(place, self.grid)])
        share = [(t - low) / width for t, low in zip(place, lowest)]
        # The corners by their numbers in the file: an axis with one place has lower ones alone.
        wide = [count > 1 for count in self.grid]
        bits = [k for k in range(8) if all(wide[a] or not k >> a & 1 for a in range(3))]
        weights = {k: math.prod(share[a] if k >> a & 1 else 1 - share[a] for a in range(3)) for k in bits}
        places = {k: tuple(low + (k >> a & 1) * width for a, low in enumerate(lowest)) for k in bits}
        if self.kind == 3:
            self.spread(lowest, width, weights, places)
            corners = [(self.nodes[places[k]], weights[k]) for k in bits]
        else:
            corners = [(self.index_of(places[k]), weights[k]) for k in bits]
        cell = self.walls and self.walls.get(self.index_of(lowest))
        if cell:
            planes, ends, masks = cell
            q = [min(max(p, low), high) - low for p, low, high in zip(position, self.min, self.max)]
            part = sum((n0 * q[0] + n1 * q[1] + n2 * q[2] > d) << k for k, (n0, n1, n2, d) in enumerate(planes))
            at_ends = sum(weight for (_, weight), k in zip(corners, bits) if ends >> k & 1)
            hidden = max(0.0, 2 * at_ends - 1)
            shares = [1.0 if masks[part] >> k & 1 else hidden for k in bits]
            seen = [(n, w * share) for (n, w), share in zip(corners, shares) if self.is_valid(n)]
            total = sum(weight for _, weight in seen)
            if total >= 1e-6:
                return [(node, weight / total) for node, weight in seen]
        valid = sum(weight for node, weight in corners if self.is_valid(node))
        if valid < 1e-6:
            return corners
        return [(node, weight / valid) for node, weight in corners if self.is_valid(node)]

    def index_of(self, place):
        return place[0] + self.grid[0] * (place[1] + self.grid[1] * place[2])

    def leaf(self, cell):
        """Lowest place and width of the leaf that a cell of the fine grid is part of."""
        for level in range(self.levels, 0, -1):
            width = 1 << level
            lowest = tuple(p // width * width for p in cell)
            middle = tuple(p + width // 2 if n > 1 else 0 for p, n in zip(lowest, self.grid))
            if middle not in self.nodes:
                return lowest, width
        return tuple(cell), 1

    def spread(self, lowest, width, weights, places):
        """Weights of corners become weights of nodes, which take the corners' places."""
        parent = [low // (2 * width) * (2 * width) for low in lowest]
        shared = sum((low != p) << a for a, (low, p) in enumerate(zip(lowest, parent)))
        def odd_axes(k):
            return [a for a in range(3) if places[k][a] // width % 2]

        hanging = [k for k, place in places.items() if place not in self.nodes]
        for k in sorted(hanging, key=lambda k: len(odd_axes(k))):
            odd = odd_axes(k)
            share = weights[k] / 2 ** len(odd)
            weights[k] = share
            weights[shared] += share
            if len(odd) == 2:
                for a in odd:
                    weights[shared ^ 1 << a] += share
            far = list(places[k])
            for a in odd:
                far[a] = 2 * parent[a] + 2 * width - places[shared][a]
            places[k] = tuple(far)

    def nearest(self, position, normal):
        # A coordinate that is no finite number counts as the box's min.
        x, y, z = (p - low if math.isfinite(p - low) else 0.0 for p, low in zip(position, self.min))
        places = self.positions
        squared = [
            (x - places[k]) ** 2 + (y - places[k + 1]) ** 2 + (z - places[k + 2]) ** 2
            for k in range(0, len(places), 3)
        ]
        nearest = min(squared)
        if self.kind == 1:
            return squared.index(nearest)
        radius = math.sqrt(nearest) + 1e-5 * math.dist(self.min, self.max)
        candidates = [node for node, s in enumerate(squared) if s <= radius * radius]
        return max(candidates, key=lambda node: sum(self.normals[3 * node + k] * normal[k] for k in range(3)))

    def irradiance(self, position, normal):
        basis = spherical_harmonics(*normal)[: (self.bands + 1) ** 2]
        weights = self.weights(position, normal)
        result = []
        for channel in range(3):
            terms = []
            for index, value in enumerate(basis):
                radiance = sum(weight * self.coefficient(node, index, channel) for node, weight in weights)
                terms.append(COSINE[math.isqrt(index)] * radiance * value)
            result.append(math.fsum(terms))
        return result


# --- packed bits ------------------------------------------------------------------------------------------------------


def unpack_bits(ident, data, raw_size):
    demand(len(data) >= 5 and data[-3:] == bytes(3), f"{ident}: cut off")
    flags, planes = data[0], data[1]
    demand(flags < 64, f"{ident}: flags {flags}")
    size = 2 if flags & 32 else 1
    demand(planes > 0 and raw_size % (planes * size) == 0, f"{ident}: {raw_size} bytes in {planes} planes")
    count = raw_size // (planes * size)
    end = len(data) - 3
    demand(2 + 2 * planes * -(-count // 128) <= end, f"{ident}: cut off")
    at = 2
    elements = [[] for _ in range(planes)]
    for first in range(0, count, 128):
        for plane in elements:
            numbers, at = unpack_block(ident, data, at, end, min(128, count - first))
            plane.extend(numbers)
    demand(at == end, f"{ident}: {end - at} bytes left")
    result = bytearray()
    for plane in elements:
        before = 0
        for number in plane:
            if flags & 16:
                number = (before + ((number >> 1) ^ -(number & 1))) % 65536
                before = number
            result += (number << (flags & 15) & 0xFFFF).to_bytes(2, "little")[:size]
    return bytes(result)


def unpack_block(ident, data, at, end, count):
    demand(at + 2 <= end, f"{ident}: cut off")
    (head,) = struct.unpack_from("<H", data, at)
    width, high_width, outliers = head & 31, (head >> 5 & 15) + 1, head >> 9
    demand(width <= 16 and (outliers == 0 or width + high_width <= 16), f"{ident}: widths {width}, {high_width}")
    lanes = -(-count // 16)
    outlier_bits = 7 + high_width
    outlier_size = -(-outliers * outlier_bits // 8)
    at += 2
    demand(at + 2 * lanes * width + outlier_size <= end, f"{ident}: cut off")
    words = struct.unpack_from(f"<{lanes * width}H", data, at)
    at += 2 * lanes * width
    numbers = []
    for lane in range(lanes):
        string = sum(word << 16 * k for k, word in enumerate(words[lane::lanes]))
        numbers += [string >> width * k & (1 << width) - 1 for k in range(16)]
    string = int.from_bytes(data[at : at + outlier_size], "little")
    for k in range(outliers):
        outlier = string >> k * outlier_bits
        place = outlier & 127
        i = place % 8 * 16 + place // 8
        demand(i < count, f"{ident}: an outlier at {i} of {count}")
        numbers[i] += (outlier >> 7 & (1 << high_width) - 1) << width
    return numbers[:count], at + outlier_size


# --- spherical harmonics ----------------------------------------------------------------------------------------------

COSINE = (PI, 2 * PI / 3, PI / 4, 0.0, -PI / 24)


def spherical_harmonics(x, y, z):
    def root(numerator, denominator):
        return math.sqrt(numerator / (denominator * PI))

    return [
        root(1, 4),
        root(3, 4) * y,
        root(3, 4) * z,
        root(3, 4) * x,
        root(15, 4) * x * y,
        root(15, 4) * y * z,
        root(5, 16) * (3 * z**2 - 1),
        root(15, 4) * x * z,
        root(15, 16) * (x**2 - y**2),
        root(35, 32) * y * (3 * x**2 - y**2),
        root(105, 4) * x * y * z,
        root(21, 32) * y * (5 * z**2 - 1),
        root(7, 16) * z * (5 * z**2 - 3),
        root(21, 32) * x * (5 * z**2 - 1),
        root(105, 16) * z * (x**2 - y**2),
        root(35, 32) * x * (x**2 - 3 * y**2),
        root(315, 16) * x * y * (x**2 - y**2),
        root(315, 32) * y * z * (3 * x**2 - y**2),
        root(45, 16) * x * y * (7 * z**2 - 1),
        root(45, 32) * y * z * (7 * z**2 - 3),
        root(9, 256) * (35 * z**4 - 30 * z**2 + 3),
        root(45, 32) * x * z * (7 * z**2 - 3),
        root(45, 64) * (x**2 - y**2) * (7 * z**2 - 1),
        root(315, 32) * x * z * (x**2 - 3 * y**2),
        root(315, 256) * (x**2 * (x**2 - 3 * y**2) - y**2 * (3 * x**2 - y**2)),
    ]


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    try:
        with open(sys.argv[1], "rb") as file:
            volume = Volume(file.read())
    except Refused as reason:
        print(f"{sys.argv[1]}: {reason}", file=sys.stderr)
        sys.exit(3)
    for line in sys.stdin:
        if not line.strip():
            continue
        numbers = [float(word) for word in line.split(",")]
        position, normal = numbers[:3], numbers[3:6]
        print(",".join(f"{value:.8e}" for value in volume.irradiance(position, normal)))


if __name__ == "__main__":
    main()
