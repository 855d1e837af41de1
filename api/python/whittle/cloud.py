# SPDX-License-Identifier: GPL-3.0-or-later
"""Clouds: from arrays, files, and the objects of Open3D and trimesh."""
import ctypes
import os

import numpy

from ._library import (CAttribute, Handle, LIBRARY, array_at, byref, c_double, c_size_t, c_uint32, c_void_p, call,
                       call_with_progress, option_text)

TYPES = [numpy.dtype(t) for t in ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")]
BYTES = (bytes, bytearray, memoryview)


def _column(values, count, name):
    """A column of a type that the library has: of integers it hasn't, and booleans, the nearest that holds them."""
    column = numpy.asarray(values)
    if column.shape != (count,):
        raise ValueError(f"attribute {name}: shape {column.shape} where there are {count} points")
    if column.dtype == numpy.bool_:
        column = column.astype("u1")
    if not column.dtype.isnative:
        column = column.astype(column.dtype.newbyteorder("="))
    if column.dtype not in TYPES:
        if column.dtype.kind not in "iuf":
            raise TypeError(f"attribute {name}: {column.dtype} is no number")
        column = column.astype("f8")
    return numpy.ascontiguousarray(column)


class Cloud(Handle):
    """A cloud of points with attributes.

    points: (n, 3) array of coordinates (float32 stays float32, all else becomes float64).  attributes: a dict of
    arrays of n numbers; colors (n, 3) and normals (n, 3) are short for red, green, blue and nx, ny, nz.  triangles:
    (m, 3) indices of the cloud's own surface, against which errors are measured then.  Everything is copied.
    """

    def __init__(self, points, attributes=None, triangles=None, colors=None, normals=None):
        if numpy.ma.is_masked(points):
            raise ValueError("points are masked: give those that are to be there, points[~points.mask.any(axis=1)].data")
        points = numpy.asarray(points)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"points has the shape {points.shape}, (n, 3) is wanted")
        points = points.astype("f4" if points.dtype == numpy.float32 else "f8", copy=False)
        columns = dict(zip("xyz", points.T))
        for names, group in ((("red", "green", "blue"), colors), (("nx", "ny", "nz"), normals)):
            if group is not None:
                columns.update(zip(names, numpy.asarray(group).T))
        columns.update(attributes or {})
        columns = {name: _column(values, len(points), name) for name, values in columns.items()}
        table = (CAttribute * len(columns))(*(CAttribute(name.encode(), TYPES.index(c.dtype), c.ctypes.data, 0)
                                              for name, c in columns.items()))
        pointer = c_void_p()
        call("cloud_new", len(points), table, len(columns), byref(pointer))
        super().__init__(pointer.value, "cloud_free")
        if triangles is not None:
            self._set_triangles(triangles)

    def _set_triangles(self, triangles):
        corners = numpy.asarray(triangles)
        if corners.ndim != 2 or corners.shape[1] != 3:
            raise ValueError(f"triangles has the shape {corners.shape}, (m, 3) is wanted")
        if corners.size and (corners.min() < 0 or corners.max() >= len(self)):
            raise ValueError(f"triangles has indices outside 0 .. {len(self) - 1}")
        corners = numpy.ascontiguousarray(corners, dtype="u4")
        call("cloud_set_triangles", self.pointer, corners.ctypes.data, len(corners))

    @classmethod
    def read(cls, path, progress=None, columns=None):
        """A file of any format that whittle reads, told by its content: its path, or that content as bytes.  columns:
        what the columns of a text are, as the option of that name has it: "-,x,y,z", or a list."""
        pointer = c_void_p()
        named = option_text(columns).encode() if columns else None
        if isinstance(path, BYTES):
            content = bytes(path)
            call_with_progress("cloud_read_memory", (content, len(content), named), progress, (byref(pointer),))
        else:
            call_with_progress("cloud_read", (os.fsencode(path), named), progress, (byref(pointer),))
        cloud = cls.__new__(cls)
        Handle.__init__(cloud, pointer.value, "cloud_free")
        return cloud

    @classmethod
    def of(cls, source, progress=None, columns=None, **parts):
        """A Cloud of whatever it is: a Cloud, a path, a file's content as bytes, an array, or an object of Open3D or
        trimesh."""
        if isinstance(source, cls) and not columns:
            return source
        if isinstance(source, (str, os.PathLike, *BYTES)):
            return cls.read(source, progress, columns)
        if columns:
            raise ValueError("columns names those of a text file, and this is none")
        return cls(*_points_of(source), **{**_parts_of(source), **parts})

    def __len__(self):
        return LIBRARY["cloud_count"](self.pointer)

    @property
    def points(self):
        """(n, 3) float64, read-only."""
        return array_at(LIBRARY["cloud_positions"](self.pointer), c_double, (len(self), 3), self)

    @property
    def triangles(self):
        """(m, 3) uint32, read-only; None where the cloud has none."""
        count = c_size_t()
        pointer = LIBRARY["cloud_triangles"](self.pointer, byref(count))
        return array_at(pointer, c_uint32, (count.value, 3), self)

    @property
    def attributes(self):
        """A dict of all columns, x, y and z among them, in the types that they came in."""
        columns = {}
        for i in range(LIBRARY["cloud_attribute_count"](self.pointer)):
            a = LIBRARY["cloud_attribute"](self.pointer, i)
            if not a.values:
                continue  # a list
            kind = TYPES[a.type]
            length = (len(self) - 1) * a.stride_bytes + kind.itemsize
            buffer = (ctypes.c_ubyte * length).from_address(a.values)
            column = numpy.ndarray((len(self),), kind, buffer, 0, (a.stride_bytes,))
            columns[a.name.decode()] = column.copy()
        return columns


def _has(source, *names):
    return all(hasattr(source, name) for name in names)


def _points_of(source):
    """The points of an array, an Open3D cloud (points) or mesh (vertices), a trimesh mesh or cloud (vertices)."""
    if _has(source, "vertices"):
        return (numpy.asarray(source.vertices),)
    if _has(source, "points"):
        return (numpy.asarray(source.points),)
    return (source,)


def _parts_of(source):
    parts = {}
    if _has(source, "has_colors", "colors") and source.has_colors():  # an Open3D cloud: 0 to 1
        parts["colors"] = numpy.rint(numpy.asarray(source.colors) * 255).astype("u1")
    if _has(source, "has_vertex_colors", "vertex_colors") and source.has_vertex_colors():
        parts["colors"] = numpy.rint(numpy.asarray(source.vertex_colors) * 255).astype("u1")
    if _has(source, "has_normals", "normals") and source.has_normals():
        parts["normals"] = numpy.asarray(source.normals)
    for name in ("triangles", "faces"):  # Open3D, trimesh
        if _has(source, "vertices", name) and len(getattr(source, name)):
            parts["triangles"] = numpy.asarray(getattr(source, name))
    return parts
