/* The listening socket.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/http/http_internal.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "server/base/address.h"

enum { BACKLOG = 511, PORT_BYTES = 8 };

static bool is_loopback(const struct sockaddr *address) {
    if (address->sa_family == AF_INET) {
        struct in_addr v4 = ((const struct sockaddr_in *)(const void *)address)->sin_addr;
        return ntohl(v4.s_addr) >> 24 == 127;
    }
    if (address->sa_family != AF_INET6) return false;
    return IN6_IS_ADDR_LOOPBACK(&((const struct sockaddr_in6 *)(const void *)address)->sin6_addr);
}

static enum status bind_to(const char *setting, const char *address, const struct addrinfo *info, int *fd,
                           struct error *error) {
    int one = 1, made = socket(info->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (made >= 0 && setsockopt(made, SOL_SOCKET, SO_REUSEADDR, &one, sizeof one) == 0 &&
        bind(made, info->ai_addr, info->ai_addrlen) == 0 && listen(made, BACKLOG) == 0) {
        *fd = made;
        return STATUS_OK;
    }
    error_set(error, STATUS_IO, setting, "can't listen on %.80s: %s", address, strerror(errno));
    if (made >= 0) close(made);
    return STATUS_IO;
}

/* Where a socket is to be bound; freeaddrinfo frees it. */
static enum status find_address(const char *setting, const char *text, bool open, struct addrinfo **info,
                                struct error *error) {
    struct addrinfo hints = {.ai_socktype = SOCK_STREAM, .ai_flags = AI_PASSIVE | AI_NUMERICSERV};
    struct address address;
    char port[PORT_BYTES];
    if (!address_read(text, &address))
        return error_set(error, STATUS_BAD_PARAMETER, setting,
                         "'%.80s' is no HOST:PORT; use 127.0.0.1:8080 or [::1]:8080", text);
    snprintf(port, sizeof port, "%u", address.port);
    int rc = getaddrinfo(address.host, port, &hints, info);
    if (rc) return error_set(error, STATUS_BAD_PARAMETER, setting, "'%.80s': %s", text, gai_strerror(rc));
    if (open || is_loopback((*info)->ai_addr)) return STATUS_OK;
    freeaddrinfo(*info);
    return error_set(error, STATUS_BAD_PARAMETER, setting,
                     "%.80s is beyond loopback, and requests need no token; --tokens-file or --insecure-open allows it",
                     text);
}

enum status listen_check(const char *setting, const char *address, bool open, struct error *error) {
    struct addrinfo *info;
    enum status status = find_address(setting, address, open, &info, error);
    if (status == STATUS_OK) freeaddrinfo(info);
    return status;
}

enum status listen_open(const char *setting, const char *address, bool open, int *fd, struct error *error) {
    struct addrinfo *info;
    enum status status = find_address(setting, address, open, &info, error);
    if (status != STATUS_OK) return status;
    status = bind_to(setting, address, info, fd, error);
    freeaddrinfo(info);
    return status;
}

/* What we can serve on: a TCP socket that listens. */
static bool is_listening_tcp(int fd, struct sockaddr_storage *address) {
    int type = 0, listening = 0;
    socklen_t type_length = sizeof type, listening_length = sizeof listening, length = sizeof *address;
    return getsockopt(fd, SOL_SOCKET, SO_TYPE, &type, &type_length) == 0 && type == SOCK_STREAM &&
           getsockopt(fd, SOL_SOCKET, SO_ACCEPTCONN, &listening, &listening_length) == 0 && listening &&
           getsockname(fd, (struct sockaddr *)address, &length) == 0 &&
           (address->ss_family == AF_INET || address->ss_family == AF_INET6);
}

enum status listen_adopt(int inherited, bool open, int *fd, struct error *error) {
    struct sockaddr_storage address;
    int flags = fcntl(inherited, F_GETFL);
    if (flags < 0 || !is_listening_tcp(inherited, &address))
        return error_set(error, STATUS_BAD_PARAMETER, "listen", "descriptor %d is no listening TCP socket", inherited);
    if (!open && !is_loopback((const struct sockaddr *)&address))
        return error_set(error, STATUS_BAD_PARAMETER, "listen",
                         "the inherited socket is beyond loopback, and requests need no token; "
                         "--tokens-file or --insecure-open allows it");
    if (fcntl(inherited, F_SETFL, flags | O_NONBLOCK) != 0)
        return error_set(error, STATUS_IO, "listen", "descriptor %d: %s", inherited, strerror(errno));
    *fd = inherited;
    return STATUS_OK;
}

void listen_name(int fd, char name[LISTEN_NAME_BYTES]) {
    struct sockaddr_storage address;
    socklen_t length = sizeof address;
    char host[NI_MAXHOST] = "?", port[NI_MAXSERV] = "0";
    if (getsockname(fd, (struct sockaddr *)&address, &length) == 0)
        getnameinfo((struct sockaddr *)&address, length, host, sizeof host, port, sizeof port,
                    NI_NUMERICHOST | NI_NUMERICSERV);
    bool v6 = strchr(host, ':') != NULL;
    snprintf(name, LISTEN_NAME_BYTES, "%s%.80s%s:%.8s", v6 ? "[" : "", host, v6 ? "]" : "", port);
}

void listen_peer(const struct sockaddr *address, char host[LISTEN_NAME_BYTES]) {
    socklen_t length = address->sa_family == AF_INET6 ? sizeof(struct sockaddr_in6) : sizeof(struct sockaddr_in);
    if (getnameinfo(address, length, host, LISTEN_NAME_BYTES, NULL, 0, NI_NUMERICHOST) != 0)
        snprintf(host, LISTEN_NAME_BYTES, "?");
}
