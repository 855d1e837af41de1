/* What a backend of the catalog implements, for the folders below this one alone.
 *
 * A backend keeps a struct of its own that begins with a struct catalog.  Another one is a folder and a row here;
 * the tests over tests/unit/catalog_fixture.c are what it has to pass.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_CATALOG_BACKEND_H
#define WHITTLE_SERVER_CATALOG_CATALOG_BACKEND_H

#include "server/catalog/catalog.h"

/* One function for each of catalog_operations.def, with the prototype that catalog.h gives it. */
struct catalog_backend {
    const char *scheme; /* of its URLs, such as "sqlite:"; `where` is what follows it */
    bool is_shared;     /* by any number of hosts */
    bool (*is_valid)(const char *where);
    bool (*exists)(const char *where);
    enum status (*open)(const char *where, bool as_is, struct catalog **catalog, struct error *error);
    enum status (*migrate)(const char *where, struct error *error);
    void (*watch)(struct catalog *catalog); /* tell is set from now on; NULL = it need not know */
#define OPERATION(name) __typeof__(catalog_##name) *name;
#include "server/catalog/catalog_operations.def"
#define OPERATION(name) __typeof__(catalog_##name) *name;
#include "server/catalog/catalog_shared_operations.def"
};

struct catalog {
    const struct catalog_backend *backend;
    void (*tell)(void *ctx, enum catalog_change change, const char *id); /* NULL = nobody is told */
    void *ctx;
};

/* For backends: after the commit, with no lock held. */
static inline void catalog_tell(const struct catalog *catalog, enum catalog_change change, const char *id) {
    if (catalog->tell) catalog->tell(catalog->ctx, change, id);
}

/* All there are. */
#define CATALOG_BACKENDS(ROW)                                                                                          \
    ROW(catalog_sqlite)                                                                                                \
    ROW(catalog_postgres)

#define CATALOG_BACKEND(name) extern const struct catalog_backend name;
CATALOG_BACKENDS(CATALOG_BACKEND)
#undef CATALOG_BACKEND

#endif
