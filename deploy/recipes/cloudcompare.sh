#!/bin/sh
# A cloud and its simplified mesh into CloudCompare: distances of all points from the mesh, as a scalar field of a text.
#
#     cloudcompare.sh scan.ply distances.asc [--ratio 0.1 ...]
#
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
in=$1 out=$2
shift 2
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
# CloudCompare keeps all coordinates in float32: what is far from 0 is shifted by it when a program asks (-GLOBAL_SHIFT).
"${WHITTLE:-whittle}" "$in" --quiet --outputs mesh "$@" -o "$folder/"
"${WHITTLE:-whittle}" convert "$in" "$folder/cloud.ply" --quiet
QT_QPA_PLATFORM=${QT_QPA_PLATFORM:-offscreen} CloudCompare -SILENT -AUTO_SAVE OFF -C_EXPORT_FMT ASC -ADD_HEADER -PREC 9 \
    -O -GLOBAL_SHIFT AUTO "$folder/cloud.ply" -O -GLOBAL_SHIFT AUTO "$folder/mesh.ply" -C2M_DIST \
    -SAVE_CLOUDS FILE "$out" > "$folder/log" || { cat "$folder/log" >&2; exit 1; }
