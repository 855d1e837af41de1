#!/bin/bash
# The core for arm64, cross compiled: its unit tests under qemu, and whether whittle writes there what it writes here, to
# the bit.  Skips with a reason where a compiler, qemu or the libraries can't be had.  The libraries are Debian's for
# arm64, unpacked into build/arm64/sysroot; nothing is installed.
# Usage: arm64.sh            from the root of the tree; WHITTLE_CLOUDS="horse kitten" are compared
# SPDX-License-Identifier: GPL-3.0-or-later
set -euo pipefail

triplet=aarch64-linux-gnu
build=build/arm64
root=$build/sysroot
libraries="libcmocka0 libcmocka-dev zlib1g zlib1g-dev libzstd1 libzstd-dev liblz4-1 liblz4-dev libgmp10 libgmp-dev
           libexpat1 libexpat1-dev libpng16-16 libpng-dev libmpfr6 libmpfr-dev libjansson4 libjansson-dev"

for program in $triplet-gcc $triplet-g++ qemu-aarch64; do
    command -v $program >/dev/null ||
        { echo "test-arm64: skipped: $program isn't installed (packages g++-$triplet, qemu-user)"; exit 0; }
done

unpack_libraries() { # apt with lists and a state of its own, for another architecture
    local part=$build/sysroot.part
    rm -rf "$part"
    mkdir -p "$part/apt/state/lists/partial" "$part/apt/cache/archives/partial" "$part/debs"
    touch "$part/apt/status"
    local apt=(apt-get -qq -o APT::Architecture=arm64 -o APT::Architectures::=arm64 -o APT::Sandbox::User=
        -o "Dir::State=$PWD/$part/apt/state" -o "Dir::State::status=$PWD/$part/apt/status"
        -o "Dir::Cache=$PWD/$part/apt/cache" -o Debug::NoLocking=1)
    # shellcheck disable=SC2086
    "${apt[@]}" update && (cd "$part/debs" && "${apt[@]}" download $libraries) || return
    for deb in "$part"/debs/*.deb; do dpkg-deb -x "$deb" "$part"; done
    rm -rf "$part/apt" "$part/debs"
    mv -T "$part" "$root"
}

[ -d "$root" ] || unpack_libraries || { echo "test-arm64: skipped: can't download libraries for arm64"; exit 0; }

make --no-print-directory -j"$(nproc)" config=arm64 CC="${CC_ARM64:-$triplet-gcc}" CXX="${CXX_ARM64:-$triplet-g++}" \
    AR=$triplet-ar core-units $build/whittle

libs=$PWD/$root/usr/lib/$triplet:$PWD/$root/lib/$triplet
emulate=(qemu-aarch64 -L /usr/$triplet -E "LD_LIBRARY_PATH=$libs" -E WHITTLE_EMULATED=1)
printf '#!/bin/sh\nexec qemu-aarch64 -L /usr/%s -E LD_LIBRARY_PATH=%s %s "$@"\n' \
    $triplet "$libs" "$PWD/$build/whittle" >"$build/whittle-emulated"
chmod +x "$build/whittle-emulated"

failed=0
for program in "$build"/tests/unit/test_*; do
    [ -x "$program" ] && [ ! -d "$program" ] || continue
    case $program in *.o | *.d | *.log) continue ;; esac
    if "${emulate[@]}" "$program" >"$program.log" 2>&1; then
        echo "  OK $program $(grep -c '^\[       OK' "$program.log") tests"
    else
        tail -20 "$program.log"
        echo "  FAILED $program"
        failed=1
    fi
done
[ $failed = 0 ] || exit 1

make --no-print-directory -j"$(nproc)" config=release build/release/whittle
# shellcheck disable=SC2086
/usr/bin/python3 tests/tools/same_bits.py --clouds ${WHITTLE_CLOUDS:-horse kitten} -- \
    build/release/whittle "$build/whittle-emulated"
