#!/bin/sh
# Makes the Debian package from the tree that dist.sh leaves.  With npm, the service has its page (make page); without
# it, or where npm can't fetch what that takes, the plain one, which is said.
# Usage: deb.sh FOLDER        prints the packages' paths, that of the programs first
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
here=$(cd "$(dirname "$0")/.." && pwd)
mkdir -p "$1"
folder=$(cd "$1" && pwd)
version=$("$here/deploy/version.sh")
SOURCE_DATE_EPOCH=$("$here/deploy/version.sh" --epoch)
export SOURCE_DATE_EPOCH

"$here/deploy/dist.sh" "$folder" >/dev/null
cd "$folder/whittle-$version"
cp -r deploy/debian debian
cat >debian/changelog <<END
whittle ($version) unstable; urgency=medium

  * As in the history of the source.

 -- The whittle developers <whittle@packages.invalid>  $(LC_ALL=C date -u -R -d "@$SOURCE_DATE_EPOCH")
END
{ command -v npm && make page-files && rm -rf server/page/node_modules; } >"$folder/page.log" 2>&1 ||
    echo "deb: with the plain page, for there is no npm, or it failed: $folder/page.log" >&2
dpkg-buildpackage -b -us -uc -j"$(nproc)" >"$folder/build.log" 2>&1 || { tail -n 40 "$folder/build.log" >&2; exit 1; }
ls "$folder"/whittle_"$version"_*.deb
ls "$folder"/lib*whittle*_"$version"_*.deb "$folder"/python3-whittle_"$version"_*.deb | grep -v dbgsym
