/* Server-sent events about something that changes until it ends: a job, a batch.
 *
 * A client gets the current state first, which is all that one that was away has missed, then what is new, piece by
 * piece; a comment where nothing is for a while, so that proxies keep the connection; and an event `end`.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_HANDLERS_EVENT_STREAM_H
#define WHITTLE_SERVER_HANDLERS_EVENT_STREAM_H

#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>

#include "server/http/handler.h"
#include "server/http/request.h"

/* What is followed, as it has just been read. */
struct event_source {
    uint64_t sequence;       /* the id of its events; grows with every change */
    int state;               /* differs when more than progress has changed */
    bool ended;              /* no more will change */
    const char *job_id;      /* the next piece is due when this job changes */
    char *(*data)(void *of); /* its document on one line, for free; NULL without memory, which is sent as {} */
    void (*before_end)(FILE *out, void *of); /* events of its own before `end`; NULL: none */
    void *of;
};

/* One event: its name, id and data, which holds no line end; NULL is sent as {}. */
void event_put(FILE *out, const char *name, uint64_t sequence, const char *data);

/* The next piece of the stream that the request asked for, or the end of it.  204, which tells an EventSource not to
 * come again, where Last-Event-ID says that the client has seen the end. */
void event_stream_answer(struct request *request, const struct event_source *source, struct response *response);

/* The end of a stream whose source was deleted while it was followed. */
void event_stream_gone(struct response *response);

#endif
