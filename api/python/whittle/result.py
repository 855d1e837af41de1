# SPDX-License-Identifier: GPL-3.0-or-later
"""The call, and what comes of it as arrays."""
import ctypes
from dataclasses import dataclass

import numpy

from ._library import (Handle, LIBRARY, array_at, byref, c_double, c_float, c_size_t, c_uint32, c_void_p, call,
                       call_with_progress, option_text)
from .cloud import Cloud

NO_POINT = 2 ** 32 - 1
NORMALS = ("nx", "ny", "nz")


@dataclass(frozen=True)
class Mesh:
    """vertices (n, 3) float64; triangles (m, 3) uint32, counter-clockwise seen from outside; sources (n,) uint32: the
    input's point that each vertex stands for, whittle.result.NO_POINT where it was moved freely."""
    vertices: numpy.ndarray
    triangles: numpy.ndarray
    sources: numpy.ndarray

    def to_open3d(self):
        """An open3d.geometry.TriangleMesh."""
        import open3d
        mesh = open3d.geometry.TriangleMesh(open3d.utility.Vector3dVector(self.vertices),
                                            open3d.utility.Vector3iVector(self.triangles.astype("i4")))
        return mesh

    def to_trimesh(self):
        """A trimesh.Trimesh with these vertices, none merged."""
        import trimesh
        return trimesh.Trimesh(self.vertices, self.triangles, process=False)


@dataclass(frozen=True)
class Level:
    """One of the levels: ids (m,) uint32 of the points that it keeps; its mesh, or None; report, a dict of figures;
    warnings: sentences on what is to be known before it is used."""
    ids: numpy.ndarray
    mesh: Mesh
    report: dict
    warnings: list


class Result(Handle):
    """What came of simplify.  ids, mesh, report and warnings are those of the finest level; levels has all of
    them.

    operator and distances are (n,) float32 over all points of the input, where "dso" or "error" was among the outputs.
    Arrays are read-only views that keep the result alive.
    """

    def __init__(self, pointer, cloud):
        super().__init__(pointer, "result_free")
        self.cloud = cloud
        self.levels = [self._level(i) for i in range(LIBRARY["result_levels"](pointer))]
        first = self.levels[0]
        self.ids, self.mesh, self.report, self.warnings = first.ids, first.mesh, first.report, first.warnings

    def _array(self, name, ctype, shape, *arguments):
        return array_at(LIBRARY["result_" + name](self.pointer, *arguments), ctype, shape, _Keeper(self))

    def _level(self, level):
        count = c_size_t()
        pointer = LIBRARY["result_kept"](self.pointer, level, byref(count))
        ids = array_at(pointer, c_uint32, (count.value,), _Keeper(self)).copy()
        return Level(ids, self._mesh(level), self._report(level), self._warnings(level))

    def _mesh(self, level):
        vertices, triangles = c_size_t(), c_size_t()
        at = LIBRARY["result_vertices"](self.pointer, level, byref(vertices))
        corners = LIBRARY["result_triangles"](self.pointer, level, byref(triangles))
        if not at:
            return None
        sources = LIBRARY["result_sources"](self.pointer, level)
        return Mesh(array_at(at, c_double, (vertices.value, 3), None).copy(),
                    array_at(corners, c_uint32, (triangles.value, 3), None).copy(),
                    array_at(sources, c_uint32, (vertices.value,), None).copy())

    def _report(self, level):
        report, value, i = {}, c_double(), 0
        while name := LIBRARY["result_number_name"](i):
            if LIBRARY["result_number"](self.pointer, level, name, byref(value)):
                report[name.decode()] = value.value
            i += 1
        return report

    def _warnings(self, level):
        found, text = [], ctypes.create_string_buffer(320)
        while LIBRARY["result_warning"](self.pointer, level, len(found), text, len(text)):
            found.append(text.value.decode())
        return found

    @property
    def points(self):
        """(m, 3) float64: the kept points; where denoising has moved them, their new places."""
        return self._positions()[self.ids]

    def _positions(self):
        moved = self._array("moved", c_double, (len(self.cloud), 3))
        return self.cloud.points if moved is None else moved

    @property
    def attributes(self):
        """A dict of the kept points' attributes, in the types that they came in; coordinates are in points."""
        return {name: column[self.ids] for name, column in self.cloud.attributes.items() if name not in ("x", "y", "z")}

    @property
    def normals(self):
        """(m, 3) float32: the kept points' unit normals, computed where the option normals is true and the cloud has
        none that fit its points, else the cloud's own; None where there are none."""
        computed = self._array("normals", c_float, (len(self.cloud), 3))
        if computed is not None:
            return computed[self.ids]
        own = self.attributes
        return numpy.stack([own[n] for n in NORMALS], axis=1).astype("f4") if own.keys() >= set(NORMALS) else None

    @property
    def operator(self):
        """The discrete shape operator at every point of the input, in 1 / length; None unless asked for."""
        return self._array("operator", c_float, (len(self.cloud),))

    @property
    def distances(self):
        """The distance of every point of the input to the mesh; None unless asked for."""
        return self._array("distances", c_float, (len(self.cloud),))

    @property
    def left_out(self):
        """What the cloud couldn't hold of the input, as sentences."""
        found = []
        while text := LIBRARY["result_left_out"](self.pointer, len(found)):
            found.append(text.decode())
        return found

    def to_open3d(self):
        """The kept points as an open3d.geometry.PointCloud, with colours (of 0 to 255) and normals."""
        import open3d
        vectors, columns = open3d.utility.Vector3dVector, self.attributes
        cloud = open3d.geometry.PointCloud(vectors(self.points))
        if {"red", "green", "blue"} <= columns.keys():
            colours = numpy.stack([columns[c] for c in ("red", "green", "blue")], axis=1)
            cloud.colors = vectors(colours / (255.0 if colours.dtype.kind in "iu" else 1.0))
        normals = self.normals
        if normals is not None:
            cloud.normals = vectors(normals.astype("f8"))
        return cloud

    def to_trimesh(self):
        """The mesh as a trimesh.Trimesh, or without one the kept points as a trimesh.PointCloud."""
        if self.mesh is not None:
            return self.mesh.to_trimesh()
        import trimesh
        return trimesh.PointCloud(self.points)


class _Keeper:  # keeps a result alive as long as an array over its memory
    def __init__(self, result):
        self.result = result


def simplify(points, /, *, attributes=None, triangles=None, colors=None, normals=None, progress=None, **options):
    """Simplifies a cloud: see Cloud for what points may be, whittle.options() for the options.

    normals are those that the points have, (n, 3); or the option of that name: True has them computed
    (Result.normals).  progress(stage, fraction) is called each few milliseconds; a true answer cancels
    (whittle.Cancelled).  What it raises, and Ctrl-C with or without it, cancels and comes out.  Raises whittle.Error
    with what was wrong and where.  Other threads run meanwhile.
    """
    if isinstance(normals, (bool, numpy.bool_, str)):
        options["normals"], normals = normals, None
    parts = {"attributes": attributes, "triangles": triangles, "colors": colors, "normals": normals}
    cloud = Cloud.of(points, progress, options.get("columns"), **{k: v for k, v in parts.items() if v is not None})
    settings = Handle(LIBRARY["options_new"](), "options_free")
    if not settings.pointer:
        raise MemoryError("no memory for the options")
    for name, value in options.items():
        if value is not None:
            call("options_set", settings.pointer, name.encode(), option_text(value).encode())
    pointer = c_void_p()
    call_with_progress("simplify", (cloud, settings), progress, (byref(pointer),))
    return Result(pointer.value, cloud)
