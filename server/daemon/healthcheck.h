/* `whittled healthcheck`: asks a running service how it is.  Its code is daemon/healthcheck.c.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_DAEMON_HEALTHCHECK_H
#define WHITTLE_SERVER_DAEMON_HEALTHCHECK_H

/* Takes --url http://HOST:PORT/PATH, or the settings of the service, whose address it then asks for /healthz.  Returns
 * the exit status: 0 = it answered 2xx within a few seconds, 1 = it did not, or an argument is wrong.  Says why on
 * standard error. */
int healthcheck_main(int argc, char **argv);

#endif
