/* Server-sent events: see event_stream.h, and the HTML standard's chapter on them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/handlers/event_stream.h"

#include <inttypes.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/clock.h"

enum { HEARTBEAT_MS = 15000 };

void event_put(FILE *out, const char *name, uint64_t sequence, const char *data) {
    fprintf(out, "event: %s\nid: %" PRIu64 "\ndata: %s\n\n", name, sequence, data ? data : "{}");
}

static void put_source(FILE *out, const char *name, const struct event_source *source) {
    char *data = source->data(source->of);
    event_put(out, name, source->sequence, data);
    free(data);
}

/* What is new since the last piece, as events; a comment where nothing is. */
static void put_news(FILE *out, struct request_wait *wait, const struct event_source *source) {
    bool state_changed = wait->calls == 0 || wait->state != source->state;
    bool progressed = !state_changed && wait->sequence != source->sequence;
    if (state_changed) put_source(out, "status", source);
    if (progressed) put_source(out, "progress", source);
    if (source->ended) {
        if (source->before_end) source->before_end(out, source->of);
        put_source(out, "end", source);
    } else if (!state_changed && !progressed && wait->why == CHANGE_FEED_DEADLINE) {
        fputs(": still here\n\n", out);
    }
    wait->state = source->state;
    wait->sequence = source->sequence;
}

/* Whether the client has seen the last event that there will be. */
static bool has_seen_the_end(const struct request *request, const struct event_source *source) {
    const char *last = request->header[HEADER_LAST_EVENT_ID];
    char sequence[24];
    snprintf(sequence, sizeof sequence, "%" PRIu64, source->sequence);
    return source->ended && last && strcmp(last, sequence) == 0;
}

static void put_piece(struct request_wait *wait, const struct event_source *source, struct response *response) {
    FILE *out = open_memstream(&response->text, &response->text_bytes);
    if (out) put_news(out, wait, source);
    bool written = out && fclose(out) == 0;
    response->kind = RESPONSE_STREAM;
    response->last = !written || source->ended ||
                     (wait->calls && (wait->why == CHANGE_FEED_HANGUP || wait->why == CHANGE_FEED_CLOSED));
    wait->deadline_ms = clock_ms() + HEARTBEAT_MS;
    snprintf(wait->id, sizeof wait->id, "%s", source->job_id);
}

void event_stream_answer(struct request *request, const struct event_source *source, struct response *response) {
    response_header(response, "Cache-Control", "no-cache");
    if (!request->wait.calls && has_seen_the_end(request, source)) {
        response->status = 204;
        return;
    }
    put_piece(&request->wait, source, response);
    response_header(response, "Content-Type", "text/event-stream");
    response_header(response, "X-Accel-Buffering", "no");
}

void event_stream_gone(struct response *response) {
    response_done(response);
    response->kind = RESPONSE_STREAM;
    response->last = true;
}
