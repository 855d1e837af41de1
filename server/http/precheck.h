/* What a request's head decides, before its body: whether it can be understood, which operation it is, and whether that
 * wants the body.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_PRECHECK_H
#define WHITTLE_SERVER_HTTP_PRECHECK_H

#include "server/http/handler.h"
#include "server/http/request.h"
#include "server/jobs/service.h"

/* The path of a target in absolute form, "http://host/path"; else the target itself.  Borrows. */
const char *head_path(const char *target);

/* Whether the head, of so many bytes, is within limits and says one thing; version as in "HTTP/1.1".  false: the
 * response says why not, and where the next request begins is uncertain. */
bool head_check(const struct config *config, const struct request *request, const char *version, uint64_t bytes,
                struct response *response);

/* Finds the operation (admin: of those that the admin listener serves), and asks it whether it wants the body.  NULL:
 * the response says why not. */
const struct handler *head_admit(struct service *service, const struct handlers *handlers, struct request *request,
                                 bool admin, struct response *response);

#endif
