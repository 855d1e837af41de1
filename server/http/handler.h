/* What is done for an operation, as http/ sees it: tables of functions that it is given, so that it needn't know
 * handlers/.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HTTP_HANDLER_H
#define WHITTLE_SERVER_HTTP_HANDLER_H

#include <stdbool.h>

#include "api/routes.h"

struct request;
struct response;
struct service;

struct handler {
    /* Called when the headers are in, before the body: false refuses it, with a response.  Creates request->body for
     * an operation that takes one.  Must not block.  NULL: the operation takes no body, and refuses nothing. */
    bool (*admit)(struct service *service, struct request *request, struct response *response);

    /* Makes the response; may block, unless `quick`. */
    void (*run)(struct service *service, struct request *request, struct response *response);

    /* The same from what is in memory, without blocking; false: it can't, run has to.  NULL: it never can. */
    bool (*at_hand)(struct service *service, struct request *request, struct response *response);

    bool quick; /* run doesn't block: it is called where the connection is served, and so answers under any load */
};

struct handlers {
    /* The handler of an operation, never NULL. */
    const struct handler *(*find)(enum operation operation);

    /* Whether the request's Idempotency-Key, if it has one, lets it go on; else a response.  Must not block. */
    bool (*admit_key)(struct service *service, struct request *request, struct response *response);
};

#endif
