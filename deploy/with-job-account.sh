#!/bin/sh
# Starts whittled in a container so that its jobs run as another account than its own: as root with no more than four
# capabilities (CHOWN, KILL, SETGID, SETUID), which the service's user then keeps.  Arguments are whittled's.
# SPDX-License-Identifier: GPL-3.0-or-later
set -eu
kept=+chown,+kill,+setgid,+setuid
exec /usr/bin/setpriv --reuid=whittle --regid=whittle --clear-groups --inh-caps="$kept" --ambient-caps="$kept" \
    /usr/bin/tini -- /usr/bin/whittled --job-user whittle-job "$@"
