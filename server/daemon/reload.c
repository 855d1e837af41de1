/* SIGHUP: settings, tokens and certificate again.
 *
 * Other threads may be reading the settings that are replaced, at any time and without a lock: so they are not freed
 * before the service has ended.  Whoever needs two settings that belong together takes service->config once.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/auth/tokens.h"
#include "server/base/log.h"
#include "server/daemon/reload.h"
#include "server/http/tls.h"

struct generation {
    struct config config;
    struct generation *older;
};

struct reload {
    struct service *service;
    int argc;
    char **argv;
    struct generation *latest;
};

struct reload *reload_open(struct service *service, int argc, char **argv) {
    struct reload *reload = calloc(1, sizeof *reload);
    if (reload) *reload = (struct reload){.service = service, .argc = argc, .argv = argv};
    return reload;
}

void reload_close(struct reload *reload) {
    if (!reload) return;
    for (struct generation *g = reload->latest, *older; g; g = older) {
        older = g->older;
        free(g);
    }
    free(reload);
}

static void tell_setting(const char *name, bool live) {
    if (live)
        log_line(LOG_INFO, "reload: %s has changed", name);
    else
        log_line(LOG_WARNING, "reload: %s has changed, which takes a restart", name);
}

static void reload_config(struct reload *reload) {
    struct error error = {0};
    struct generation *next = calloc(1, sizeof *next);
    if (!next) return;
    enum status status = config_reload(reload->service->config, reload->argc, reload->argv, environ, &next->config,
                                       tell_setting, &error);
    if (status != STATUS_OK) {
        log_line(LOG_ERROR, "reload: the settings stay as they were: %s: %s", error.where, error.text);
        free(next);
        return;
    }
    next->older = reload->latest;
    reload->latest = next;
    reload->service->config = &next->config;
    scratch_keep_free(store_scratch(reload->service->store), (uint64_t)next->config.min_free_bytes);
}

static void reload_tokens(struct reload *reload) {
    struct error error = {0};
    struct tokens *tokens = reload->service->tokens;
    if (!tokens) return;
    if (tokens_reload(tokens, &error) == STATUS_OK)
        log_line(LOG_INFO, "reload: %zu tokens", tokens_count(tokens));
    else
        log_line(LOG_ERROR, "reload: the tokens stay as they were: %s", error.text);
}

static void reload_certificate(struct reload *reload) {
    struct error error = {0};
    struct tls *tls = reload->service->tls;
    if (!tls) return;
    if (tls_reload(tls, &error) == STATUS_OK)
        log_line(LOG_INFO, "reload: the certificate is read");
    else
        log_line(LOG_ERROR, "reload: the certificate stays as it was: %s: %s", error.where, error.text);
}

void reload_now(struct reload *reload) {
    log_line(LOG_INFO, "reload: reading settings, tokens and certificate again");
    reload_config(reload);
    reload_certificate(reload);
    reload_tokens(reload);
}
