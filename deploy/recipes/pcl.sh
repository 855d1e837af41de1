#!/bin/sh
# A cloud into PCL's tools: normals and colours come as they expect them (normal_x, rgb), coordinates in float32 around
# an origin, or in double with --pcd-precision double for readers that know it.
#
#     pcl.sh scan.laz small.pcd [--ratio 0.1 ...]
#
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
in=$1 out=$2
shift 2
"${WHITTLE:-whittle}" "$in" --quiet --normals true "$@" -o "$out"
pcl_pcd2ply -format 0 "$out" "${out%.pcd}.ply"
