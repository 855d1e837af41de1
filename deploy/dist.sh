#!/bin/sh
# Makes whittle-VERSION.tar.xz of the tree: the same bytes whenever, wherever and by whom it is made, also from an
# unpacked whittle-VERSION.tar.xz.
# Usage: dist.sh FOLDER       (also leaves the tree in FOLDER/whittle-VERSION)
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
here=$(cd "$(dirname "$0")/.." && pwd)
mkdir -p "$1"
folder=$(cd "$1" && pwd)
version=$("$here/deploy/version.sh") epoch=$("$here/deploy/version.sh" --epoch)
name=whittle-$version

files() { # without what building leaves
    cd "$here"
    if [ -e .git ]; then
        git ls-files -z --cached
    else
        find . -mindepth 1 \( -path ./build -o -path ./out -o -name __pycache__ -o -name node_modules \
            -o -name .pytest_cache \) -prune -o \( -type f -o -type l \) ! -path ./.version -printf '%P\0'
    fi
}

rm -rf "${folder:?}/$name"
mkdir "$folder/$name"
(cd "$here" && files | tar --null --no-recursion -T - -cf -) | tar -xf - -C "$folder/$name"
echo "$version $epoch" >"$folder/$name/.version"
LC_ALL=C tar --sort=name --format=ustar --mtime="@$epoch" --owner=0 --group=0 --numeric-owner \
    --mode=u+rwX,go+rX,go-w -cf - -C "$folder" "$name" | xz -T1 -6 >"$folder/$name.tar.xz.part"
mv "$folder/$name.tar.xz.part" "$folder/$name.tar.xz"
echo "$folder/$name.tar.xz"
