# SPDX-License-Identifier: GPL-3.0-or-later
"""Point clouds made small with their features kept, and meshes of them: libwhittle for Python.

    import whittle
    result = whittle.simplify(points, ratio=0.1, outputs=("cloud", "mesh"))
    result.points                 # (m, 3) float64: the points that are kept, the most important first
    result.ids                    # (m,) uint32: which of the input's points they are
    result.mesh.vertices, result.mesh.triangles
    result.report["error.symmetric.max"]

`points` is an (n, 3) array, a path, a file's content as bytes, a whittle.Cloud, or an object of Open3D or trimesh.
Options are those of the command line, by the same names (whittle.options() lists them).  Needs numpy and the shared library libwhittle.

whittle.Client, of the service whittled, needs neither: they are loaded when something else is asked for.
"""
import importlib

from .client import Client, Problem

_HOME = {"Cancelled": "_library", "Error": "_library", "options": "_library", "version": "_library", "Cloud": "cloud",
         "Level": "result", "Mesh": "result", "Result": "result", "simplify": "result"}

__all__ = ["Client", "Problem", *sorted(_HOME)]


def __getattr__(name):
    if name == "__version__":
        return __getattr__("version")()
    if name not in _HOME:
        raise AttributeError(f"module 'whittle' has no attribute {name!r}")
    try:
        value = getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)
    except ModuleNotFoundError as error:
        if error.name != "numpy":
            raise
        raise ModuleNotFoundError(f"whittle.{name} needs numpy: apt install python3-numpy, or pip install numpy", name="numpy") from None
    globals()[name] = value
    return value


def _loads(name):
    try:
        __getattr__(name)
    except ImportError:
        return False
    return True


def __dir__():
    """What help() and completion show: of what needs numpy and libwhittle, what can be had here."""
    return sorted({*globals(), "__version__", *filter(_loads, _HOME)} - {"importlib"})
