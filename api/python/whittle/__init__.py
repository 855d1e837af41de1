# SPDX-License-Identifier: GPL-3.0-or-later
"""Point clouds made small with their features kept, and meshes of them: libwhittle for Python.

    import whittle
    result = whittle.simplify(points, ratio=0.1, outputs=("cloud", "mesh"))
    result.points                 # (m, 3) float64: the points that are kept, the most important first
    result.ids                    # (m,) uint32: which of the input's points they are
    result.mesh.vertices, result.mesh.triangles
    result.report["error.symmetric.max"]

`points` is an (n, 3) array, a path, a whittle.Cloud, or an object of Open3D or trimesh.  Options are those of the
command line, by the same names (whittle.options() lists them).  Needs numpy and the shared library libwhittle.
"""
from ._library import Error, Cancelled, options, version
from .cloud import Cloud
from .result import Level, Mesh, Result, simplify

__all__ = ["Cancelled", "Cloud", "Error", "Level", "Mesh", "Result", "options", "simplify", "version"]
__version__ = version()
