"""Models to measure on: closed triangle meshes with their vertices as clouds, as PLY files that all programs read.

Where they come from: horse.mesh.ply and venus.mesh.ply, which the paper measured on, from ../shared/data if that folder
is there; and the closed models of more than 5000 points of Debian's libcgal-demo.  A model is closed if each directed
edge of its triangles occurs once and so does its reverse, and each vertex belongs to a triangle; only then is there a
true surface that an error can be measured against.

Converted models are kept in build/models.  Reading and writing PLY (any scalar properties, triangles) lives here too.

SPDX-License-Identifier: GPL-3.0-or-later
"""
import array
import collections
import pathlib
import struct
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
CACHE = ROOT / "build" / "models"
SHARED = ROOT.parent / "shared" / "data"
FROM_THE_PAPER = ("horse", "venus")
LEAST_POINTS = 5000

Model = collections.namedtuple("Model", "name mesh cloud points")  # two paths and a count

SCALARS = {"char": "b", "uchar": "B", "short": "h", "ushort": "H", "int": "i", "uint": "I", "float": "f", "double": "d",
           "int8": "b", "uint8": "B", "int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f",
           "float64": "d"}


# ---------------------------------------------------------------------------------------------------- files
def read_ply_header(file):
    """[(element, count, [(name, code) or (name, count code, item code)])] of a binary little-endian PLY."""
    elements = []
    for line in file:
        words = line.decode("ascii", "replace").split()
        if words[:1] == ["format"] and words[1] != "binary_little_endian":
            raise ValueError(f"{file.name}: only binary_little_endian is read here")
        if words[:1] == ["element"]:
            elements.append((words[1], int(words[2]), []))
        elif words[:2] == ["property", "list"]:
            elements[-1][2].append((words[4], SCALARS[words[2]], SCALARS[words[3]]))
        elif words[:1] == ["property"]:
            elements[-1][2].append((words[2], SCALARS[words[1]]))
        elif words == ["end_header"]:
            return elements
    raise ValueError(f"{file.name}: no end_header")


def count_of(path):
    """How many vertices a PLY has."""
    with open(path, "rb") as file:
        return next(count for element, count, _ in read_ply_header(file) if element == "vertex")


def read_ply(path):
    """({property: values of the vertices}, triangles as flat corners)."""
    columns, corners = {}, array.array("i")
    with open(path, "rb") as file:
        for element, count, properties in read_ply_header(file):
            if element == "face":
                corners = read_triangles(file, count, properties)
                continue
            row = struct.Struct("<" + "".join(code for _, code in properties))
            values = list(zip(*row.iter_unpack(file.read(count * row.size)))) or [()] * len(properties)
            if element == "vertex":
                columns = {name: values[i] for i, (name, _) in enumerate(properties)}
    return columns, corners


def read_triangles(file, count, properties):
    codes = "".join(p[1] if len(p) == 2 else p[1] + 3 * p[2] for p in properties)
    before = sum(len(p) for p in properties[:next(i for i, p in enumerate(properties) if len(p) == 3)]) // 2
    row = struct.Struct("<" + codes)
    corners = array.array("i")
    for values in row.iter_unpack(file.read(count * row.size)):
        if values[before] != 3:
            raise ValueError(f"{file.name}: a face is no triangle")
        corners.extend(values[before + 1:before + 4])
    return corners


def write_ply(path, xyz, corners=()):
    """xyz: flat coordinates; corners: three indices for each triangle."""
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(xyz) // 3}\n"
    header += "".join(f"property double {axis}\n" for axis in "xyz")
    if corners:
        header += f"element face {len(corners) // 3}\nproperty list uchar int vertex_indices\n"
    with open(path, "wb") as file:
        file.write(header.encode() + b"end_header\n")
        file.write(array.array("d", xyz).tobytes())
        row = struct.Struct("<Biii")
        file.write(b"".join(row.pack(3, *corners[i:i + 3]) for i in range(0, len(corners), 3)))


def to_plain(source, target):
    """Rewrites any PLY that read_ply understands as the one that the peers read."""
    columns, corners = read_ply(source)
    write_ply(target, [c for point in zip(*(columns[axis] for axis in "xyz")) for c in point], corners)


def read_off(path):
    """(flat coordinates, flat corners) of an OFF file; polygons become fans.  None: too small, or not to be read."""
    with open(path, encoding="latin-1") as file:
        words = (word for line in file for word in line.partition("#")[0].split())
        try:
            first = next(words)
            vertices = int(next(words) if first == "OFF" else first)
            faces = int(next(words))
            next(words)
            if vertices <= LEAST_POINTS or first not in ("OFF", str(vertices)):
                return None
            xyz = [float(next(words)) for _ in range(3 * vertices)]
            corners = []
            for _ in range(faces):
                face = [int(next(words)) for _ in range(int(next(words)))]
                for i in range(2, len(face)):
                    corners += (face[0], face[i - 1], face[i])
            return xyz, corners
        except (StopIteration, ValueError, RuntimeError):
            return None


def is_closed(vertices, corners):
    edges = set()
    for i in range(0, len(corners), 3):
        a, b, c = corners[i:i + 3]
        edges.update((a * vertices + b, b * vertices + c, c * vertices + a))
    used = len(set(corners))
    return used == vertices and len(edges) == len(corners) and all(
        (edge % vertices) * vertices + edge // vertices in edges for edge in edges)


# ---------------------------------------------------------------------------------------------------- finding them
def store(name, xyz, corners):
    write_ply(CACHE / f"{name}.cloud.ply", xyz)
    write_ply(CACHE / f"{name}.mesh.ply.part", xyz, corners)
    (CACHE / f"{name}.mesh.ply.part").rename(CACHE / f"{name}.mesh.ply")


def fetch_from_the_paper():
    for name in FROM_THE_PAPER:
        source = SHARED / f"{name}.mesh.ply"
        if (CACHE / f"{name}.mesh.ply").exists():
            continue
        if not source.exists():
            print(f"models: {name} is left out, since ../shared/data/{name}.mesh.ply isn't there", file=sys.stderr)
            continue
        columns, corners = read_ply(source)
        store(name, [c for point in zip(*(columns[axis] for axis in "xyz")) for c in point], corners)


def fetch_scans():
    if (CACHE / "scans").exists():
        return
    folder = subprocess.run([ROOT / "tests/demo/scan.sh", "--unpack"], check=True, capture_output=True, text=True)
    names = []
    for path in sorted(pathlib.Path(folder.stdout.strip()).rglob("*.off")):
        mesh = read_off(path)
        if mesh and path.stem not in names and is_closed(len(mesh[0]) // 3, mesh[1]):
            store(path.stem, *mesh)
            names.append(path.stem)
    (CACHE / "scans").write_text("".join(name + "\n" for name in names))


def find(names=None):
    """The models of these names (None: all), those of the paper first."""
    CACHE.mkdir(parents=True, exist_ok=True)
    fetch_from_the_paper()
    if names is None or set(names) - set(FROM_THE_PAPER):
        fetch_scans()
    scans = (CACHE / "scans").read_text().split() if (CACHE / "scans").exists() else []
    known = [n for n in FROM_THE_PAPER if (CACHE / f"{n}.mesh.ply").exists()] + scans
    unknown = set(names or ()) - set(known) - set(FROM_THE_PAPER)
    if unknown:
        sys.exit(f"models: no {', '.join(sorted(unknown))}; there are {', '.join(known)}")
    models = []
    for name in known:
        if names is None or name in names:
            cloud = CACHE / f"{name}.cloud.ply"
            with open(cloud, "rb") as file:
                models.append(Model(name, CACHE / f"{name}.mesh.ply", cloud, read_ply_header(file)[0][1]))
    return models


def find_with_solids(names=None):
    """As find, with the closed models of ../shared/data/solids after them."""
    CACHE.mkdir(parents=True, exist_ok=True)
    solids = []
    for mesh in sorted((SHARED / "solids").glob("*.mesh.ply")):
        name, target = mesh.name.removesuffix(".mesh.ply"), CACHE / mesh.name
        if names is not None and name not in names:
            continue
        columns, corners = read_ply(mesh)
        if not is_closed(len(columns["x"]), corners):
            continue
        if not target.exists():
            store(name, [c for point in zip(*(columns[axis] for axis in "xyz")) for c in point], corners)
        solids.append(Model(name, target, CACHE / f"{name}.cloud.ply", len(columns["x"])))
    others = None if names is None else [name for name in names if name not in {model.name for model in solids}]
    return ([] if others == [] else find(others)) + solids


if __name__ == "__main__":
    for model in find():
        print(f"{model.name:24} {model.points:8}")
