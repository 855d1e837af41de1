/* File descriptors.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/jobs/descriptors.h"

#include <sys/resource.h>

enum {
    OWN = 64,      /* database, folders, listeners, what threads are woken by; an idle service has 34 */
    ADMIN = 64,    /* connections of the admin listener */
    HANDLERS = 32, /* files that handlers open and close */
    WEBHOOKS = 64, /* sockets, and what resolving a name takes */
    PER_WORKER = 8 /* a job's process, pipe, log and outputs */
};

void descriptors_raise_limit(void) {
    struct rlimit files;
    if (getrlimit(RLIMIT_NOFILE, &files) != 0) return;
    files.rlim_cur = files.rlim_max;
    setrlimit(RLIMIT_NOFILE, &files);
}

int64_t descriptors_limit(void) {
    struct rlimit files;
    bool limited = getrlimit(RLIMIT_NOFILE, &files) == 0 && files.rlim_cur <= INT64_MAX;
    return limited ? (int64_t)files.rlim_cur : INT64_MAX;
}

int64_t descriptors_reserve(const struct config *config) {
    return OWN + ADMIN + HANDLERS + (config->webhooks ? WEBHOOKS : 0) + PER_WORKER * config->workers;
}

int64_t descriptors_connections(const struct config *config) {
    int64_t left = descriptors_limit() - descriptors_reserve(config);
    return left > 0 ? left / DESCRIPTORS_PER_CONNECTION : 0;
}
