/* Who makes a request, and whether it may.
 *
 * Where tokens are configured, every operation but the public ones wants `Authorization: Bearer TOKEN` of a principal
 * with the operation's scope (api/routes.def), or, for an output, a signature in the query: ?exp=SECONDS&sig=HEX, as
 * POST /v1/jobs/{id}/outputs/{name}/link hands it out.  A signature opens that one output, whoever's it is.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_ACCESS_H
#define WHITTLE_SERVER_HTTP_ACCESS_H

#include <stdbool.h>

#include "server/http/request.h"
#include "server/jobs/service.h"

/* Finds the principal of a request whose route was found, and sets request->principal; takes exp and sig out of the
 * query.  false: the response (401, 403) is there.  Doesn't block. */
bool access_admit(struct service *service, struct request *request, struct response *response);

/* The path that a signature for an output is over. */
enum { ACCESS_PATH_BYTES = 300 };
void access_output_path(const char *id, const char *name, char path[ACCESS_PATH_BYTES]);

#endif
