/* A service as it runs, on a port of loopback, but for its jobs: nothing computes, and they end well as soon as they
 * are submitted.  There may be one in a program, which then has no supervisor and takes no sockets from outside.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_TESTS_UNIT_INSTANT_SERVICE_H
#define WHITTLE_TESTS_UNIT_INSTANT_SERVICE_H

#include <netinet/in.h>

#include "server/http/http.h"
#include "server/jobs/service.h"

struct instant_service {
    struct service service;
    struct http *http;
    struct sockaddr_in address;
    void (*before)(void), (*after)(void); /* around the ending of jobs, on whichever thread; NULL: nothing */
};

/* Borrows config.  Nothing is open where it fails. */
enum status instant_service_open(struct instant_service *instant, const struct config *config,
                                 struct error *error) MUST_CHECK;
void instant_service_close(struct instant_service *instant);

/* A stream socket that is connected to it. */
int instant_service_connect(const struct instant_service *instant);

/* Writes a file of this text into a folder. */
void instant_service_write(const char *folder, const char *name, const char *text);

#endif
