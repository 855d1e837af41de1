# A mesh into Blender: blender --background --python blender.py -- mesh.glb scene.blend
#
# GLB has colours, normals and the local frame with it: y is up in the file, and Blender turns that.  Coordinates are
# around the centre of the box, which is the place of its node, which also turns z upwards, so a survey keeps its place.
#
# SPDX-License-Identifier: GPL-3.0-or-later
import sys

import bpy
import numpy

if not hasattr(numpy, "bool"):
    numpy.bool = bool  # the importer of Debian 12's Blender uses it, and Debian 12's numpy has it no more

mesh, scene = sys.argv[sys.argv.index("--") + 1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.import_scene.gltf(filepath=mesh)
made = [item for item in bpy.data.objects if item.type == "MESH"]
print("vertices", sum(len(item.data.vertices) for item in made), "faces", sum(len(item.data.polygons) for item in made))
bpy.ops.wm.save_as_mainfile(filepath=scene)
