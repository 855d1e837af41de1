#!/bin/bash
# Takes one of the models of Debian's libcgal-demo package as a cloud: the vertices of an OFF file as XYZ.
# The package's folder is left out where documentation is excluded at install, so the .deb itself is taken apart.
# Usage: scan.sh NAME OUTPUT.xyz        scan.sh --unpack (prints the folder of all of them)
# SPDX-License-Identifier: GPL-3.0-or-later
set -euo pipefail

cache=${WHITTLE_SCANS:-${TMPDIR:-/tmp}/whittle-scans-$(id -u)}
archive=usr/share/doc/libcgal-dev/data.tar.gz

unpack() { # into $cache, once
    [ -e "$cache/complete" ] && return
    local part
    part=$(mktemp -d "$cache.XXXXXX")
    if [ -r "/$archive" ]; then
        tar -xzf "/$archive" -C "$part"
    else
        (cd "$part" && apt-get download -qq libcgal-demo >/dev/null 2>&1) ||
            { rm -rf "$part"; echo "scan: can't download the package libcgal-demo; run apt-get update" >&2; exit 1; }
        dpkg-deb --fsys-tarfile "$part"/libcgal-demo_*.deb | tar -xO "./$archive" | tar -xz -C "$part"
        rm -f "$part"/libcgal-demo_*.deb
    fi
    touch "$part/complete"
    rm -rf "$cache"
    mv -T "$part" "$cache"
}

off_to_xyz() { # the vertices alone
    awk '/^#/ || NF == 0 { next }
         !n { if ($1 ~ /^[A-Z]*OFF$/) { if (NF < 4) next; n = $2 } else n = $1; next }
         seen < n { print $1, $2, $3; seen++ }' "$1"
}

unpack
if [ "$1" = --unpack ]; then
    echo "$cache/data"
    exit
fi
model=$(find "$cache" -name "$1.off" -o -name "$1.xyz" | sort | head -n 1)
[ -n "$model" ] || { echo "scan: libcgal-demo has no $1" >&2; exit 1; }
case $model in
*.off) off_to_xyz "$model" >"$2" ;;
*) cp "$model" "$2" ;;
esac
