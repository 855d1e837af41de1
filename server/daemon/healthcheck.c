/* The health check, for containers without curl: one GET over a plain socket.
 *
 * With the settings of the service (from the environment and its file, as the service itself reads them) it finds the
 * address by itself.  An address that stands for all of the host's is asked on loopback.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <errno.h>
#include <netdb.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include "server/daemon/healthcheck.h"
#include "server/daemon/settings.h"

enum { WELL = 0, UNWELL = 1, USAGE = 1, PATIENCE_S = 5, PART_BYTES = 256 };

struct target {
    char host[PART_BYTES], port[16], path[PART_BYTES];
};

/* Takes "HOST:PORT" or "[HOST]:PORT" apart. */
static bool split_address(const char *address, size_t length, struct target *target) {
    const char *colon = memrchr(address, ':', length);
    if (!colon || colon == address) return false;
    size_t host = (size_t)(colon - address), port = length - host - 1;
    bool bracketed = host > 2 && address[0] == '[' && address[host - 1] == ']';
    if (bracketed) address++, host -= 2;
    if (!port || port >= sizeof target->port || host >= sizeof target->host) return false;
    snprintf(target->host, sizeof target->host, "%.*s", (int)host, address);
    snprintf(target->port, sizeof target->port, "%.*s", (int)port, colon + 1);
    if (strcmp(target->host, "0.0.0.0") == 0) snprintf(target->host, sizeof target->host, "127.0.0.1");
    if (strcmp(target->host, "::") == 0) snprintf(target->host, sizeof target->host, "::1");
    return true;
}

static bool split_url(const char *url, struct target *target) {
    static const char scheme[] = "http://";
    if (strncmp(url, scheme, sizeof scheme - 1) != 0) return false;
    url += sizeof scheme - 1;
    size_t length = strcspn(url, "/");
    const char *path = url[length] ? url + length : "/healthz";
    if (strlen(path) >= sizeof target->path || strpbrk(path, " \r\n")) return false;
    snprintf(target->path, sizeof target->path, "%s", path);
    return split_address(url, length, target);
}

static int connect_to(const struct target *target) {
    struct addrinfo hints = {.ai_socktype = SOCK_STREAM}, *found = NULL;
    struct timeval patience = {.tv_sec = PATIENCE_S};
    int fd = -1;
    if (getaddrinfo(target->host, target->port, &hints, &found) != 0) return -1;
    for (struct addrinfo *at = found; at && fd < 0; at = at->ai_next) {
        fd = socket(at->ai_family, at->ai_socktype | SOCK_CLOEXEC, at->ai_protocol);
        if (fd < 0) continue;
        setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
        setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &patience, sizeof patience);
        if (connect(fd, at->ai_addr, at->ai_addrlen) == 0) break;
        close(fd);
        fd = -1;
    }
    freeaddrinfo(found);
    return fd;
}

/* Sends the request; the first bytes of the answer say all. */
static int ask_health(const struct target *target) {
    char answer[64] = "";
    size_t got = 0;
    int fd = connect_to(target), status = UNWELL;
    if (fd < 0) {
        fprintf(stderr, "whittled: nobody answers at %s, port %s\n", target->host, target->port);
        return UNWELL;
    }
    bool sent = dprintf(fd, "GET %s HTTP/1.1\r\nHost: %s:%s\r\nConnection: close\r\n\r\n", target->path, target->host,
                        target->port) > 0;
    while (sent && got + 1 < sizeof answer && !strchr(answer, '\n')) {
        ssize_t n = read(fd, answer + got, sizeof answer - 1 - got);
        if (n <= 0) break;
        got += (size_t)n;
    }
    answer[strcspn(answer, "\r\n")] = 0;
    if (strncmp(answer, "HTTP/1.1 2", 10) == 0)
        status = WELL;
    else
        fprintf(stderr, "whittled: the answer is '%s'\n", answer);
    close(fd);
    return status;
}

/* The address to ask: the main listener's, or, where that speaks TLS, the admin one's. */
static bool find_listener(const struct config *config, struct target *target) {
    bool automatic = strcmp(config->admin_listen, "auto") == 0;
    const char *address = config->tls_cert[0] && !automatic ? config->admin_listen : config->listen;
    if (!split_address(address, strlen(address), target)) return false;
    if (!config->tls_cert[0] || !automatic) return true;
    snprintf(target->host, sizeof target->host, "127.0.0.1");
    snprintf(target->port, sizeof target->port, "%u", (unsigned)(strtoul(target->port, NULL, 10) & 0xffff) + 1);
    return true;
}

int healthcheck_main(int argc, char **argv) {
    struct target target = {.path = "/healthz"};
    struct config config;
    struct error error = {0};
    if (argc == 3 && strcmp(argv[1], "--url") == 0) {
        if (split_url(argv[2], &target)) return ask_health(&target);
        fprintf(stderr, "whittled: --url: '%s' is not like http://HOST:PORT/PATH\n", argv[2]);
        return USAGE;
    }
    enum config_request request = settings_read(&config, argc, argv, &error);
    if (request == CONFIG_TOLD) return WELL;
    if (request == CONFIG_REFUSED)
        fprintf(stderr, "whittled: %s: %s\n", error.where, error.text);
    else if (!find_listener(&config, &target))
        fprintf(stderr, "whittled: listen: '%s' has no port, or HTTPS alone is served\n", config.listen);
    else
        return ask_health(&target);
    return USAGE;
}
