/* The settings of a run, and what they name: tokens, certificate and addresses.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_DAEMON_SETTINGS_H
#define WHITTLE_SERVER_DAEMON_SETTINGS_H

#include "server/auth/tokens.h"
#include "server/http/tls.h"
#include "server/jobs/config.h"

/* As config_read, with this process' environment; does what --check-config asks for: CONFIG_TOLD where all of it is
 * allowed, else CONFIG_REFUSED. */
enum config_request settings_read(struct config *config, int argc, char **argv, struct error *error) MUST_CHECK;

/* Who may come in, and how: opens tokens and certificate where the settings name them.  Both are the caller's, and stay
 * as they are where there are none; *tokens may be there even on failure. */
enum status settings_open_doors(const struct config *config, struct tokens **tokens, struct tls **tls,
                                struct error *error) MUST_CHECK;

#endif
