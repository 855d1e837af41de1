/* What SIGHUP does: settings and tokens are read again, and take effect where they can without a restart.  Its code is
 * daemon/reload.c.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_DAEMON_RELOAD_H
#define WHITTLE_SERVER_DAEMON_RELOAD_H

#include "server/jobs/service.h"

struct reload;

/* Remembers where settings come from: the command line (borrowed) and the environment.  NULL when memory runs out. */
struct reload *reload_open(struct service *service, int argc, char **argv);

/* Frees what earlier settings were kept in; when the service has ended.  Accepts NULL. */
void reload_close(struct reload *reload);

/* Reads all again.  What can't be read is logged, and stays as it was. */
void reload_now(struct reload *reload);

#endif
