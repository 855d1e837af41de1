#!/bin/sh
# A mesh into MeshLab's filters without its window: distances of all points of a scan from the mesh, as their quality in a
# PLY, which MeshLab colours (Render, Quality). Any other filter goes the same way: meshlabserver -d names them all.
#
#     meshlab.sh scan.ply distances.ply [--ratio 0.1 ...]
#
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
in=$1 out=$2
shift 2
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
# MeshLab keeps coordinates in float32: of a survey move them to the origin first.
"${WHITTLE:-whittle}" "$in" --quiet --outputs mesh "$@" -o "$folder/"
"${WHITTLE:-whittle}" convert "$in" "$folder/cloud.ply" --quiet
cat > "$folder/filters.mlx" <<'FILTERS'
<!DOCTYPE FilterScript>
<FilterScript>
 <filter name="Hausdorff Distance">
  <Param type="RichMesh" name="SampledMesh" value="1"/>
  <Param type="RichMesh" name="TargetMesh" value="0"/>
  <Param type="RichBool" name="SaveSample" value="false"/>
  <Param type="RichBool" name="SampleVert" value="true"/>
  <Param type="RichBool" name="SampleEdge" value="false"/>
  <Param type="RichBool" name="SampleFauxEdge" value="false"/>
  <Param type="RichBool" name="SampleFace" value="false"/>
  <Param type="RichInt" name="SampleNum" value="1000000000"/>
  <Param type="RichAbsPerc" name="MaxDist" value="1e30" min="0" max="1e30"/>
 </filter>
</FilterScript>
FILTERS
# Its filters want OpenGL, and with it a display; on none, xvfb has one.
display=
[ -n "${DISPLAY:-}" ] || display="xvfb-run -a"
$display meshlabserver -i "$folder/mesh.ply" "$folder/cloud.ply" -s "$folder/filters.mlx" -o "$out" -m vq \
    > "$folder/log" 2>&1 && [ -s "$out" ] || { cat "$folder/log" >&2; exit 1; }
