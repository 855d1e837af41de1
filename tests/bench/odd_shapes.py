# SPDX-License-Identifier: GPL-3.0-or-later
"""Geometries that are unlike scans, as functions of a count: each returns points, or points and faces.

Each is a row of SHAPES by its name. Where a shape has a parameter it is what makes it odd: how far a stray lies, how
many corners a face has.
"""
import math
import random
import struct

GOLDEN = math.pi * (3 - math.sqrt(5))


def seeded(name):
    return random.Random(name)


# ----------------------------------------------------------------------------------------------------- surfaces

def sphere(n, centre=(0, 0, 0), radius=1.0):
    points = []
    for i in range(n):
        z = 1 - (2 * i + 1) / n
        r = math.sqrt(1 - z * z)
        points.append((centre[0] + radius * r * math.cos(GOLDEN * i), centre[1] + radius * r * math.sin(GOLDEN * i),
                       centre[2] + radius * z))
    return points


def plain(n):
    """A closed surface with bumps, as a scan sees it."""
    rng, points = seeded("plain"), []
    for x, y, z in sphere(n):
        r = 1 + 0.1 * math.sin(5 * x) * math.cos(4 * y) + 0.05 * math.sin(9 * z) + 1e-4 * rng.gauss(0, 1)
        points.append((r * x, r * y, r * z))
    return points


def moved(points, offset, scale=1.0):
    return [tuple(offset[i] + scale * p[i] for i in range(3)) for p in points]


def torus(n):
    side = math.isqrt(n)
    points = []
    for i in range(side):
        for j in range(side):
            u, v = 2 * math.pi * i / side, 2 * math.pi * j / side
            points.append(((2 + math.cos(v)) * math.cos(u), (2 + math.cos(v)) * math.sin(u), math.sin(v)))
    return points


def cylinder_grid(n):
    side = math.isqrt(n)
    return [(math.cos(2 * math.pi * i / side), math.sin(2 * math.pi * i / side), 6 * j / side)
            for i in range(side) for j in range(side)]


def cone(n):
    rng, points = seeded("cone"), []
    for _ in range(n):
        h, a = rng.random(), 2 * math.pi * rng.random()
        points.append((h * math.cos(a), h * math.sin(a), 2 * h))
    return points


def cube_surface_grid(n):
    side = math.isqrt(n // 6)
    points = set()
    for i in range(side + 1):
        for j in range(side + 1):
            u, v = i / side, j / side
            points |= {(u, v, 0.0), (u, v, 1.0), (u, 0.0, v), (u, 1.0, v), (0.0, u, v), (1.0, u, v)}
    return sorted(points)


def plane_grid(n):
    side = math.isqrt(n)
    return [(i / side, j / side, 0.0) for i in range(side) for j in range(side)]


def tilted_plane(n):
    rng, points = seeded("tilted"), []
    for _ in range(n):
        u, v = rng.random(), rng.random()
        points.append((u + 0.3 * v, v - 0.2 * u, 0.7 * u + 0.1 * v))
    return points


def rough_plane(n, height=1e-4):
    rng = seeded("rough")
    return [(rng.random(), rng.random(), height * rng.random()) for _ in range(n)]


def two_planes(n, gap=1e-3):
    side = math.isqrt(n // 2)
    return [(i / side, j / side, gap * k) for i in range(side) for j in range(side) for k in range(2)]


def nested_spheres(n, gap=1e-6):
    return sphere(n // 2) + sphere(n - n // 2, radius=1 + gap)


def ellipsoid(n, longest=1e6):
    return [(longest * x, y, z) for x, y, z in plain(n)]


def dense_spot(n, ratio=1e6):
    """The spacing on a sphere shrinks towards a pole, by the ratio."""
    rng, points = seeded("spot"), []
    for _ in range(n):
        angle = math.pi * ratio ** (rng.random() - 1)
        turn = 2 * math.pi * rng.random()
        points.append((math.sin(angle) * math.cos(turn), math.sin(angle) * math.sin(turn), math.cos(angle)))
    return points


def scan_lines(n):
    """A hundred times as dense along lines as across."""
    lines = max(2, math.isqrt(n // 100))
    each = n // lines
    return [(math.cos(2 * math.pi * i / each), math.sin(2 * math.pi * i / each) * (1 + 0.1 * math.sin(7 * j / lines)),
             4 * j / lines) for j in range(lines) for i in range(each)]


def parallel_lines(n, lines=97):
    """So many scan lines around, however many points there are: the more points, the more tetrahedra for each."""
    each = n // lines
    return [(math.cos(2 * math.pi * i / each), math.sin(2 * math.pi * i / each) * (1 + 0.1 * math.sin(7 * j / lines)),
             4 * j / lines) for j in range(lines) for i in range(each)]


def staves(n, lines=30):
    """Straight lines along a barrel."""
    each = n // lines
    return [(math.cos(a) * r, math.sin(a) * r, 3 * i / each)
            for k in range(lines) for i in range(each)
            for a, r in [(2 * math.pi * k / lines, 1 + 0.3 * math.sin(math.pi * i / each))]]


def rotating_lidar(n, rings=64):
    """What a scanner with so many beams, turning in a room of 12 by 8 by 3 m, measures to 2 mm."""
    rng, each, points = seeded("lidar"), n // rings, []
    eye, room = (5.0, 3.0, 1.2), (12.0, 8.0, 3.0)
    for k in range(rings):
        up = math.radians(-25 + 40 * k / (rings - 1))
        for i in range(each):
            a = 2 * math.pi * (i + 0.3 * rng.random()) / each
            d = (math.cos(up) * math.cos(a), math.cos(up) * math.sin(a), math.sin(up))
            t = min(((room[q] if d[q] > 0 else 0) - eye[q]) / d[q] for q in range(3) if d[q]) + rng.gauss(0, 0.002)
            points.append(tuple(eye[q] + t * d[q] for q in range(3)))
    return points


def cone_of_lines(n, lines=97):
    each = n // lines
    return [((i + 1) / each * math.cos(2 * math.pi * k / lines), (i + 1) / each * math.sin(2 * math.pi * k / lines),
             2 * (i + 1) / each) for k in range(lines) for i in range(each)]


def quantised(n, steps=64):
    return [tuple(round(c * steps) / steps for c in p) for p in plain(n)]


# ------------------------------------------------------------------------------------------------------- curves

def skew_lines(n, lines=2):
    points = []
    for k in range(lines):
        a = math.pi * k / lines
        m = n // lines
        points += [(math.cos(a) * (2 * i / m - 1), math.sin(a) * (2 * i / m - 1), float(k)) for i in range(m)]
    return points


def helix(n, turns=20):
    return [(math.cos(2 * math.pi * turns * i / n), math.sin(2 * math.pi * turns * i / n), 4 * i / n)
            for i in range(n)]


def conical_spiral(n, turns=50):
    return [(i / n * math.cos(2 * math.pi * turns * i / n), i / n * math.sin(2 * math.pi * turns * i / n), 2 * i / n)
            for i in range(n)]


def flat_spiral(n, turns=30):
    return [(i / n * math.cos(2 * math.pi * turns * i / n), i / n * math.sin(2 * math.pi * turns * i / n), 0.0)
            for i in range(n)]


def shrinking_spiral(n, ratio=1e9):
    points = []
    for i in range(n):
        r = ratio ** (-i / n)
        points.append((r * math.cos(0.01 * i), r * math.sin(0.01 * i), r))
    return points


def moment_curve(n):
    return [((i / n), (i / n) ** 2, (i / n) ** 3) for i in range(n)]


def line(n):
    return [(i / n, 2 * i / n, -3 * i / n) for i in range(n)]


def nearly_line(n, width=1e-9):
    rng = seeded("line")
    return [(i / n, width * rng.random(), width * rng.random()) for i in range(n)]


def circle(n):
    return [(math.cos(2 * math.pi * i / n), math.sin(2 * math.pi * i / n), 0.0) for i in range(n)]


def linked_circles(n):
    half = n // 2
    return circle(half) + [(1 + x, 0.0, y) for x, y, _ in circle(half)]


def random_walk(n):
    rng, place, points = seeded("walk"), [0.0, 0.0, 0.0], []
    for _ in range(n):
        place = [c + rng.gauss(0, 1) for c in place]
        points.append(tuple(place))
    return points


# ------------------------------------------------------------------------------------------------------ volumes

def lattice(n):
    side = round(n ** (1 / 3))
    return [(float(i), float(j), float(k)) for i in range(side) for j in range(side) for k in range(side)]


def centred_lattice(n):
    side = round((n / 2) ** (1 / 3))
    corners = [(float(i), float(j), float(k)) for i in range(side) for j in range(side) for k in range(side)]
    return corners + moved(corners, (0.5, 0.5, 0.5))


def cube(n):
    rng = seeded("cube")
    return [(rng.random(), rng.random(), rng.random()) for _ in range(n)]


def ball(n):
    rng = seeded("ball")
    return [(rng.gauss(0, 1), rng.gauss(0, 1), rng.gauss(0, 1)) for _ in range(n)]


def dust(n):
    """Cantor's: clusters of clusters, over twelve scales."""
    rng, points = seeded("dust"), []
    for _ in range(n):
        points.append(tuple(sum(2 * rng.getrandbits(1) * 3.0 ** -(k + 1) for k in range(12)) for _ in range(3)))
    return points


def surface_in_noise(n):
    return plain(n // 2) + [tuple(2 * c - 1 for c in p) for p in cube(n - n // 2)]


# --------------------------------------------------------------------------------------------- strays and clusters

UTM = (500_000.0, 5_400_000.0, 300.0)


def in_utm(n):
    return moved(plain(n), UTM, 20)


def stray_at_zero(n):
    return in_utm(n - 1) + [(0.0, 0.0, 0.0)]


def stray(n, distance):
    return plain(n - 1) + [(distance, distance / 3, distance / 7)]


def strays_at_all_scales(n, count=30):
    return plain(n - count) + [(4.0 ** i, -(4.0 ** i) / 3, 4.0 ** i / 5) for i in range(1, count + 1)]


def two_clusters(n, distance=1e9):
    return plain(n // 2) + moved(plain(n - n // 2), (distance, 0, 0))


def many_clusters(n, count=100, size=1e-6):
    rng, points = seeded("clusters"), []
    for _ in range(count):
        points += moved(plain(n // count), (rng.random(), rng.random(), rng.random()), size)
    return points


def clusters_of_all_sizes(n, count=16):
    points = []
    for k in range(count):
        points += moved(plain(n // count), (10.0 ** -k * 5, 10.0 ** -k * 3, 0), 10.0 ** -k)
    return points


def one_cell(n, size=1e-9):
    """All but two points in so small a part of the box."""
    return moved(plain(n - 2), (0.3, 0.4, 0.5), size) + [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)]


def duplicates(n):
    return plain(n // 10) * 10


def four_places(n):
    corners = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]
    return [corners[i % 4] for i in range(n)]


# -------------------------------------------------------------------------------------------------------- faces

def globe(n):
    """A closed grid and its triangles."""
    side = math.isqrt(n)
    points = [(math.sin(math.pi * (j + 0.5) / side) * math.cos(2 * math.pi * i / side),
               math.sin(math.pi * (j + 0.5) / side) * math.sin(2 * math.pi * i / side),
               math.cos(math.pi * (j + 0.5) / side)) for j in range(side) for i in range(side)]
    faces = []
    for j in range(side - 1):
        for i in range(side):
            a, b = j * side + i, j * side + (i + 1) % side
            faces += [(a, b, b + side), (a, b + side, a + side)]
    return points, faces


def faces_of_one_point(n):
    return plain(n), [(0, 0, 0)] * n


def faces_repeated(n):
    points, faces = globe(n)
    return points, faces + [faces[7]] * n


def faces_of_a_line(n):
    points = plain(n // 2) + [(i / n, i / n, i / n) for i in range(n // 2)]
    half = n // 2
    return points, [(half + i, half + i + 1, half + i + 2) for i in range(half - 3)] * 2


def faces_of_many_corners(n, corners=255):
    """Small discs all over a sphere, each one face."""
    points, faces = [], []
    for x, y, z in sphere(n // corners):
        first, turn = len(points), math.hypot(x, y)
        across, along = (-y / turn, x / turn, 0.0), (-z * x / turn, -z * y / turn, turn)
        for j in range(corners):
            u, v = (0.1 * f(2 * math.pi * j / corners) for f in (math.cos, math.sin))
            points.append(tuple(c + u * a + v * b for c, a, b in zip((x, y, z), across, along)))
        faces.append(tuple(range(first, first + corners)))
    return points, faces


def faces_all_across(n):
    """Each from one side of the cloud to the other."""
    return plain(n), [(i, (i + n // 2) % n, (i + n // 3) % n) for i in range(n)]


def some_faces_across(n, one_in=100):
    """A grid's, and one in so many from one side of it to the other."""
    points, faces = globe(n)
    m = len(points)
    return points, faces + [(i % m, (i + m // 2) % m, (i + m // 3) % m) for i in range(0, len(faces), one_in)]


def some_faces_doubled(n, one_in=1):
    """One in so many faces is there once more, at points of its own a hair above it, as exporters of two sides write."""
    points, faces = globe(n)
    doubled = faces[::one_in]
    number = {}
    for face in doubled:
        for v in face:
            number.setdefault(v, len(points) + len(number))
    points = points + [tuple((1 + 1e-9) * c for c in points[v]) for v in number]
    return points, faces + [tuple(number[v] for v in reversed(face)) for face in doubled]


def faces_knotted(n):
    """A grid's, and on the edge of each a further one, to a point next to it."""
    points, faces = globe(n)
    rng, near = seeded("knotted"), {}
    for face in faces:
        for v in face:
            near.setdefault(v, set()).update(face)
    return points, faces + [(a, b, rng.choice(sorted(near[c] - {a, b, c}))) for a, b, c in faces if near[c] - {a, b, c}]


def fans_all_across(n, corners=255):
    """The same of faces with many corners."""
    points = plain(n)
    return points, [tuple((i + 97 * j * n // 255) % n for j in range(corners)) for i in range(0, n, n // (n // corners))]


def faces_of_a_stray(n):
    points, faces = globe(n)
    return moved(points, UTM, 20) + [(0.0, 0.0, 0.0)], faces + [(0, 1, len(points))]


def faces_in_one_cell(n):
    points, faces = globe(n)
    return moved(points, (0.3, 0.4, 0.5), 1e-9) + [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)], faces


SHAPES = {
    "plain": plain,
    "sphere": sphere,
    "torus": torus,
    "cylinder grid": cylinder_grid,
    "cone": cone,
    "cube's surface": cube_surface_grid,
    "plane grid": plane_grid,
    "tilted plane": tilted_plane,
    "plane rough by 1e-4": rough_plane,
    "plane rough by 1e-8": lambda n: rough_plane(n, 1e-8),
    "two planes 1e-3 apart": two_planes,
    "two planes 1e-7 apart": lambda n: two_planes(n, 1e-7),
    "nested spheres": nested_spheres,
    "ellipsoid 1e6 long": ellipsoid,
    "density varying by 1e6": dense_spot,
    "density varying by 1e12": lambda n: dense_spot(n, 1e12),
    "scan lines": scan_lines,
    "97 scan lines": parallel_lines,
    "14 scan lines": lambda n: parallel_lines(n, 14),
    "staves": staves,
    "rotating lidar": rotating_lidar,
    "cone of lines": cone_of_lines,
    "quantised": quantised,
    "two skew lines": skew_lines,
    "five skew lines": lambda n: skew_lines(n, 5),
    "helix": helix,
    "conical spiral": conical_spiral,
    "flat spiral": flat_spiral,
    "shrinking spiral": shrinking_spiral,
    "moment curve": moment_curve,
    "line": line,
    "nearly a line": nearly_line,
    "circle": circle,
    "linked circles": linked_circles,
    "random walk": random_walk,
    "lattice": lattice,
    "centred lattice": centred_lattice,
    "cube": cube,
    "ball": ball,
    "Cantor's dust": dust,
    "surface in noise": surface_in_noise,
    "UTM": in_utm,
    "UTM and a stray at zero": stray_at_zero,
    "stray 10 away": lambda n: stray(n, 10.0),
    "stray 1e5 away": lambda n: stray(n, 1e5),
    "stray 1e9 away": lambda n: stray(n, 1e9),
    "stray 1e14 away": lambda n: stray(n, 1e14),
    "stray 1e250 away": lambda n: stray(n, 1e250),
    "strays at all scales": strays_at_all_scales,
    "two clusters 1e9 apart": two_clusters,
    "two clusters 1e4 apart": lambda n: two_clusters(n, 1e4),
    "hundred clusters of 1e-6": many_clusters,
    "clusters of 16 sizes": clusters_of_all_sizes,
    "one Morton cell": one_cell,
    "one cell of 1e-14": lambda n: one_cell(n, 1e-14),
    "duplicates": duplicates,
    "four places": four_places,
    "offset 1e9": lambda n: moved(plain(n), (1e9, -1e9, 1e9)),
    "offset 1e15": lambda n: moved(plain(n), (1e15, -1e15, 1e15)),
    "extent 1e-310": lambda n: moved(plain(n), (0, 0, 0), 1e-310),
    "extent 1e-30": lambda n: moved(plain(n), (0, 0, 0), 1e-30),
    "extent 1e290": lambda n: moved(plain(n), (0, 0, 0), 1e290),
    "faces": globe,
    "faces of one point": faces_of_one_point,
    "faces repeated": faces_repeated,
    "faces of a line": faces_of_a_line,
    "faces of 255 corners": faces_of_many_corners,
    "faces all across": faces_all_across,
    "fans all across": fans_all_across,
    "one face in 100 across": some_faces_across,
    "one face in 10 across": lambda n: some_faces_across(n, 10),
    "faces doubled": some_faces_doubled,
    "a face in 100 doubled": lambda n: some_faces_doubled(n, 100),
    "a face in 10 doubled": lambda n: some_faces_doubled(n, 10),
    "faces knotted": faces_knotted,
    "faces of a stray": faces_of_a_stray,
    "faces in one cell": faces_in_one_cell,
}


def write(name, n, path):
    """Writes the shape as binary PLY of doubles; returns the number of its points."""
    made = SHAPES[name](n)
    points, faces = made if isinstance(made, tuple) else (made, [])
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n" \
             "property double x\nproperty double y\nproperty double z\n"
    if faces:
        header += f"element face {len(faces)}\nproperty list uchar int vertex_indices\n"
    with open(path, "wb") as file:
        file.write(header.encode() + b"end_header\n")
        file.write(b"".join(struct.pack("<3d", *p) for p in points))
        file.write(b"".join(struct.pack(f"<B{len(f)}i", len(f), *f) for f in faces))
    return len(points)
