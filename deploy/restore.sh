#!/bin/sh
# Puts a backup back into an empty data folder, and checks it.  The service must not be running.
# Usage: restore.sh BACKUP.tar DATA_FOLDER
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
[ $# = 2 ] && [ -r "$1" ] || { echo "usage: restore.sh BACKUP.tar DATA_FOLDER" >&2; exit 2; }
mkdir -p "$2"
[ -z "$(ls -A "$2")" ] || { echo "restore: $2 is not empty" >&2; exit 1; }
tar -xpf "$1" -C "$2" --no-overwrite-dir
# Outputs of a job that was deleted while the backup was made are missed here; the start forgets the job.
status=0
if command -v "${WHITTLED:=whittled}" >/dev/null; then "$WHITTLED" check --data "$2" || status=$?; fi
# What root unpacked, and what the check made, belongs to whoever the folder belongs to.
chown -R --reference="$2" "$2" 2>/dev/null || true
exit $status
