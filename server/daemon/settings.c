/* The settings of a run, and what they name.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/daemon/settings.h"

#include <stdio.h>
#include <unistd.h>

#include "server/http/http.h"

enum status settings_open_doors(const struct config *config, struct tokens **tokens, struct tls **tls,
                                struct error *error) {
    enum status status = config->tokens_file[0] ? tokens_open(config->tokens_file, tokens, error) : STATUS_OK;
    if (status == STATUS_OK && (config->tls_cert[0] || config->tls_key[0]))
        status = tls_open(config->tls_cert, config->tls_key, tls, error);
    return status;
}

static enum config_request check(const struct config *config, struct error *error) {
    struct tokens *tokens = NULL;
    struct tls *tls = NULL;
    enum status status = http_check_addresses(config, error);
    if (status == STATUS_OK) status = settings_open_doors(config, &tokens, &tls, error);
    tokens_close(tokens);
    tls_close(tls);
    if (status == STATUS_OK) puts("the settings are allowed");
    return status == STATUS_OK ? CONFIG_TOLD : CONFIG_REFUSED;
}

enum config_request settings_read(struct config *config, int argc, char **argv, struct error *error) {
    enum config_request request = config_read(config, argc, argv, environ, error);
    return request == CONFIG_CHECK ? check(config, error) : request;
}
