/* What a request for a job says besides its query: the members of a JSON document, or the fields of a form.
 *
 * Both end as names with values, as a query holds them, so that one place decides what is allowed.  Documents are
 * strict: unknown members, members that come twice and wrong types are refused, each named by its path, all at once.
 *
 *     {"input": "/v1/clouds/<sha256>", "join": ["/v1/clouds/<sha256>"], "params": {"ratio": 0.1, "outputs": ["cloud",
 * "mesh"]}, "label": "horse"}
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_API_CODECS_JOB_REQUEST_H
#define WHITTLE_API_CODECS_JOB_REQUEST_H

#include <stdbool.h>
#include <stddef.h>

#include "api/problem.h"
#include "api/query.h"

enum {
    JOB_REQUEST_MAX_FIELDS = 64,
    JOB_REQUEST_VALUE_BYTES = 512,
    JOB_REQUEST_INPUT_BYTES = 65,
    JOB_REQUEST_MAX_JOINED = 255
};

/* Zero-initialise. */
struct job_request {
    char input[JOB_REQUEST_INPUT_BYTES]; /* the cloud's sha256; "" = none was named */
    size_t joined;                       /* clouds that are one with the input, in their order behind it */
    char join[JOB_REQUEST_MAX_JOINED][JOB_REQUEST_INPUT_BYTES];
    size_t count;
    struct job_request_field {
        char name[64], value[JOB_REQUEST_VALUE_BYTES];
    } field[JOB_REQUEST_MAX_FIELDS];
};

/* Adds a field; false: name or value are too long or not UTF-8, or there are too many. */
bool job_request_add(struct job_request *request, const char *name, const char *value, size_t value_bytes,
                     struct problem *problem);

/* Reads the whole document.  names: the members besides input, join and params that the operation takes
 * (NULL-terminated); with "clouds" among them, a list of 1 to 256 that become input and join, it takes neither of
 * these.  input: the id of the cloud where the operation's path names it, and the document doesn't; NULL =
 * the document has to, by input, or by join alone: then the first of these is the input. */
bool job_request_read(struct job_request *request, const char *text, size_t bytes, const char *const *names,
                      const char *input, struct problem *problem);

/* Reads `params` alone, as a form holds it. */
bool job_request_read_params(struct job_request *request, const char *text, size_t bytes, struct problem *problem);

#endif
