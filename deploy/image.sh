#!/bin/sh
# Builds the image with what is there: docker, podman or buildah.
# Usage: image.sh NAME
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
cd "$(dirname "$0")/.."
version=$(deploy/version.sh)
for tool in docker podman buildah; do
    command -v "$tool" >/dev/null || continue
    [ "$tool" = docker ] || set -- "$1" --format docker # keeps HEALTHCHECK
    exec "$tool" build -f deploy/Dockerfile --build-arg VERSION="$version" -t "$@" .
done
echo "image: neither docker, podman nor buildah is here" >&2
exit 1
