/* Who makes a request, and what it may do.
 *
 * Where no tokens are configured everyone is the anonymous principal, with every scope.  A principal sees its own jobs
 * and clouds; one with the scope admin sees everybody's.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_AUTH_PRINCIPAL_H
#define WHITTLE_SERVER_AUTH_PRINCIPAL_H

#include <stdbool.h>
#include <string.h>

#include "api/routes.h"
#include "server/catalog/job.h"

struct principal {
    char name[JOB_PRINCIPAL_BYTES]; /* "" = anonymous */
    unsigned scopes;                /* a set of enum routes_scope */
    bool by_signature;              /* has a signed link to what it asks for, whoever's it is */
};

static inline struct principal principal_anonymous(void) { return (struct principal){.scopes = ROUTES_ALL_SCOPES}; }

/* Whether what belongs to owner is there for this principal. */
static inline bool principal_sees(const struct principal *principal, const char *owner) {
    return (principal->scopes & ROUTES_ADMIN) || principal->by_signature || strcmp(principal->name, owner) == 0;
}

#endif
