/* Files as responses, for the handlers of outputs, clouds and links.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HANDLERS_OUTPUTS_H
#define WHITTLE_SERVER_HANDLERS_OUTPUTS_H

#include <stdbool.h>
#include <stdint.h>

#include "server/http/request.h"
#include "server/jobs/service.h"

/* A file's content, or the range of it that was asked for; takes fd.  etag NULL: none, nothing is conditional. */
void handlers_send_file(const struct request *request, int fd, uint64_t bytes, const char *etag,
                        struct response *response);

/* The media type of an output of this name, "model/ply". */
const char *handlers_media_type(const char *name);

/* An output of a successful job with all of its headers, or 304, 404. */
void handlers_send_output(struct service *service, const struct request *request, const struct job *job,
                          const char *name, struct response *response);

/* The same of a cloud, called as the output says. */
void handlers_send_cloud(struct service *service, const struct request *request, const struct job_output *output,
                         struct response *response);

/* The same for content that is open already; takes fd (-1: it could not be opened).  output names, measures and hashes
 * it. */
void handlers_send_content(const struct request *request, const struct job *job, const struct job_output *output,
                           int fd, struct response *response);

/* Reads the job of the path; false: the response says that there is none, or that it was not successful.  The job is
 * the caller's either way. */
bool handlers_read_successful(struct service *service, const struct request *request, struct job *job,
                              struct response *response);

/* The job's output of this name; NULL where it has none. */
const struct job_output *handlers_find_output(const struct job *job, const char *name);

#endif
