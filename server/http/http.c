/* The HTTP listener, on libmicrohttpd: the only file that knows it.
 *
 * Its threads serve connections and must never block, so a handler runs on a thread of the pool while its connection is
 * suspended:
 *
 *     headers -> admit --(no)--> refuse: answer at once, or read the body away first, then answer
 *                  |
 *                (yes)  body -> body_write     each piece is hashed and written to the page cache
 *                  |
 *                park -> handler -> unpark -> answer
 *                          |  ^
 *                   WAIT   v  | job changed, deadline, client gone      (jobs/change_feed.h)
 *                        waiting
 *
 * An event stream parks again each time its reader has sent what there was.
 *
 * A refusal is answered before the body where the client waits for 100 Continue, or where its body is longer than we
 * would read.  Otherwise the body is read away, up to a limit, because many clients don't listen before they have sent
 * everything; over the limit the connection is cut.
 *
 * Invariants: an exchange is touched by one thread at a time: libmicrohttpd's, or, while it is parked, the one that
 * runs its handler or wakes it.  Parked exchanges are counted, and nothing parks once the service stops, so no
 * connection is suspended when libmicrohttpd ends.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/http/http.h"

#include <microhttpd.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/socket.h>
#include <unistd.h>

#include "api/links.h"
#include "core/base/clock.h"
#include "server/base/address.h"
#include "server/base/log.h"
#include "server/base/notify.h"
#include "server/base/thread_pool.h"
#include "server/http/handler.h"
#include "server/http/http_internal.h"
#include "server/http/peers.h"
#include "server/http/tls.h"
#include "server/jobs/metrics.h"

enum {
    MAX_SERVING_THREADS = 4,
    POOL_THREADS = 8,
    CONNECTION_MEMORY = 128 * 1024,
    STREAM_BLOCK = 32 * 1024,
    FILE_BLOCK = 64 * 1024 /* a slow download holds it: a connection stays below 160 KiB */
};
enum { LOG_PATH_BYTES = 160, GOODBYE_S = 2, ADMIN_CONNECTIONS = 64 };

/* One of the two sockets that are listened on. */
struct listener {
    struct http *http;
    struct MHD_Daemon *daemon;
    struct acceptor *acceptor;
    struct watchdog *watchdog; /* its own: looking at a thousand connections holds a lock for a while */
    struct peers *peers;
    pthread_mutex_t heads_lock;
    struct client *heads; /* those whose head is on its way in */
    int fd;
    bool admin;  /* serves health and metrics alone */
    bool secure; /* speaks TLS */
};

/* One connection. */
struct client {
    struct watched *watched;
    struct MHD_Connection *connection; /* this and the rest: while its head is on its way in */
    pthread_t thread;
    struct client *next_head, **head_link; /* head_link NULL: it isn't */
};

struct http {
    struct service *service;
    const struct handlers *handlers;
    struct listener main, admin;
    struct thread_pool *pool;
    struct tally tally;
};

enum phase {
    PHASE_BODY,     /* takes the body, if there is one */
    PHASE_REFUSING, /* the response is there; the body is read away */
    PHASE_WHOLE,    /* all of the request is there */
    PHASE_PARKED,   /* suspended, the handler's turn */
    PHASE_ANSWER,   /* the response is there */
    PHASE_SENT
};

struct exchange {
    struct http *http;
    bool admin;     /* came to the admin listener */
    bool secure;    /* came by TLS */
    bool uploading; /* tallied as one whose body is coming */
    struct MHD_Connection *connection;
    struct watched *watched;
    const struct handler *handler;
    enum phase phase;
    struct request request;
    struct response response;
    uint64_t received_bytes, sent_bytes, drained_bytes; /* of bodies */
    int64_t began_ms, refused_ms;
    size_t stream_sent; /* of response.text */
    bool streaming;
    struct thread_pool_task task;
    struct change_feed_waiter waiter;
    int status, problem; /* of the response that was sent; problem -1 = it is none */
    char log_method[16], log_path[LOG_PATH_BYTES];
};

/* ------------------------------------------------------------------------------------------------ parking */

/* Suspends the connection; false when the service stops. */
static bool park(struct exchange *x) {
    if (!tally_park(&x->http->tally)) return false;
    watchdog_enter(x->watched, WATCHDOG_BUSY);
    MHD_suspend_connection(x->connection);
    return true;
}

/* The exchange may be gone when this returns. */
static void unpark(struct exchange *x) {
    struct http *http = x->http;
    MHD_resume_connection(x->connection);
    tally_unpark(&http->tally);
}

/* From the change feed's thread, or whoever publishes. */
static void wake(void *ctx, enum change_feed_why why) {
    struct exchange *x = ctx;
    x->request.wait.why = why;
    thread_pool_post(x->http->pool, &x->task);
}

static void wait_for_job(struct exchange *x) {
    const struct request_wait *wait = &x->request.wait;
    const union MHD_ConnectionInfo *info = MHD_get_connection_info(x->connection, MHD_CONNECTION_INFO_CONNECTION_FD);
    x->waiter = (struct change_feed_waiter){.seen = wait->seen,
                                            .deadline_ms = wait->deadline_ms,
                                            .fd = info ? info->connect_fd : -1,
                                            .wake = wake,
                                            .ctx = x};
    memcpy(x->waiter.id, wait->id, sizeof x->waiter.id);
    change_feed_wait(x->http->service->feed, &x->waiter);
}

/* Lets go what the request holds for itself alone: the client that has its answer may come again at once, and must find
 * its key and its place free. */
static void let_go(struct exchange *x) {
    body_free(x->request.body);
    x->request.body = NULL;
    catalog_release_key(x->http->service->catalog, &x->request.claim);
}

/* On a thread of the pool, parked. */
static void run_handler(void *ctx) {
    struct exchange *x = ctx;
    response_done(&x->response);
    x->stream_sent = 0;
    x->handler->run(x->http->service, &x->request, &x->response);
    x->request.wait.calls++;
    bool nothing_yet =
        x->response.kind == RESPONSE_WAIT || (x->streaming && !x->response.text_bytes && !x->response.last);
    if (nothing_yet) {
        wait_for_job(x);
        return;
    }
    let_go(x);
    x->phase = PHASE_ANSWER;
    unpark(x);
}

/* ------------------------------------------------------------------------------------------------ answering */

/* Gives libmicrohttpd the next bytes of a stream. */
static ssize_t read_stream(void *ctx, uint64_t position, char *buffer, size_t most) {
    struct exchange *x = ctx;
    (void)position;
    size_t left = x->response.text_bytes - x->stream_sent, count = left < most ? left : most;
    if (count) {
        memcpy(buffer, x->response.text + x->stream_sent, count);
        x->stream_sent += count;
        x->sent_bytes += count;
        return (ssize_t)count;
    }
    if (x->response.last || !park(x)) return MHD_CONTENT_READER_END_OF_STREAM;
    wait_for_job(x);
    return 0;
}

/* The same of a file.  libmicrohttpd itself would read it in pieces of a page with TLS; without, it would send it
 * corked, so that no segment asks to be acknowledged at once, and a client on this machine waits for 40 ms now and
 * then. */
static ssize_t read_file(void *ctx, uint64_t position, char *buffer, size_t most) {
    const struct exchange *x = ctx;
    ssize_t n = pread(x->response.fd, buffer, most, (off_t)(x->response.file_offset + position));
    return n > 0 ? n : MHD_CONTENT_READER_END_WITH_ERROR;
}

/* The body as libmicrohttpd's response; takes it out of ours. */
static struct MHD_Response *make_response(struct exchange *x) {
    struct response *r = &x->response;
    struct MHD_Response *made = NULL;
    switch (r->kind) {
    case RESPONSE_FILE:
        x->sent_bytes = r->status == 304 ? 0 : r->file_bytes;
        made = MHD_create_response_from_callback(r->file_bytes, FILE_BLOCK, read_file, x, NULL);
        break;
    case RESPONSE_STREAM:
        x->streaming = true;
        made = MHD_create_response_from_callback(MHD_SIZE_UNKNOWN, STREAM_BLOCK, read_stream, x, NULL);
        break;
    case RESPONSE_TEXT:
        x->sent_bytes = r->text_bytes;
        made = MHD_create_response_from_buffer(r->text_bytes, r->text, MHD_RESPMEM_MUST_FREE);
        if (made) r->text = NULL;
        break;
    case RESPONSE_WAIT: break; /* never comes here */
    }
    return made;
}

/* If-Match of what is read: the content is known only now. */
static void hold_to_match(struct exchange *x) {
    struct response *r = &x->response;
    bool reads = strcmp(x->request.method, "GET") == 0 || x->request.head, has_content = r->status < 400;
    if (!reads || !has_content || request_match(&x->request, response_find_header(r, "ETag"))) return;
    response_done(r);
    response_refuse(r, PROBLEM_PRECONDITION_FAILED, "the ETag of the content is not in If-Match, or there is none");
}

static enum MHD_Result answer(struct exchange *x) {
    struct response *r = &x->response;
    hold_to_match(x);
    cross_site_share(x->http->service->config, &x->request, r);
    struct MHD_Response *made = make_response(x);
    let_go(x);
    if (!made) return MHD_NO;
    for (size_t i = 0; i < r->header_count; i++) MHD_add_response_header(made, r->header[i].name, r->header[i].value);
    if (r->location) MHD_add_response_header(made, "Location", r->location);
    MHD_add_response_header(made, "X-Content-Type-Options", "nosniff");
    MHD_add_response_header(made, "X-Request-Id", x->request.id);
    if (x->request.tus) MHD_add_response_header(made, "Tus-Resumable", "1.0.0");
    /* To HEAD libmicrohttpd would send a stream's last chunk, and the next response would seem to begin with it. */
    if (x->streaming && x->request.head) MHD_set_response_options(made, MHD_RF_HTTP_1_0_COMPATIBLE_STRICT, MHD_RO_END);
    x->phase = PHASE_SENT;
    x->status = r->status;
    x->problem = r->problem;
    enum MHD_Result result = MHD_queue_response(x->connection, (unsigned)r->status, made);
    MHD_destroy_response(made);
    return result;
}

/* The same, and nothing more is read from this connection. */
static enum MHD_Result answer_and_close(struct exchange *x) {
    response_header(&x->response, "Connection", "close");
    return answer(x);
}

/* Answers with the response that is there: now, or when the body is read away. */
static enum MHD_Result refuse(struct exchange *x) {
    const struct config *config = x->http->service->config;
    const struct request *request = &x->request;
    const char *expect = request->header[HEADER_EXPECT];
    bool waits = expect && strcasecmp(expect, "100-continue") == 0;
    bool too_long =
        request->content_length != UINT64_MAX && request->content_length > (uint64_t)config->refuse_drain_bytes;
    let_go(x);
    x->phase = PHASE_REFUSING;
    x->refused_ms = clock_ms();
    return request->has_body && (waits || too_long) ? answer(x) : MHD_YES;
}

/* ------------------------------------------------------------------------------------------------ headers */

/* How the head lies in memory, to see what libmicrohttpd leaves out: names and values are where they came in, and only
 * the end of a line is between a value and the next name.  A value that seems to end before its line does holds NUL. */
struct head_walk {
    struct request *request;
    const char *value_end; /* of the header before; NULL = there is none yet */
};

enum { LINE_END_BYTES = 2 };

static void check_gap(struct head_walk *walk, const char *next, size_t most) {
    bool longer = walk->value_end && next > walk->value_end && (size_t)(next - walk->value_end) > most;
    if (longer) walk->request->fault = "a header holds NUL, or its line is folded";
}

static enum MHD_Result add_header(void *ctx, enum MHD_ValueKind kind, const char *name, size_t name_bytes,
                                  const char *value, size_t value_bytes) {
    struct head_walk *walk = ctx;
    (void)kind;
    (void)name_bytes; /* the name ends at its first NUL, and isn't one that the service knows then */
    check_gap(walk, name, LINE_END_BYTES);
    walk->value_end = value ? value + value_bytes : NULL;
    request_take_header(walk->request, name, value ? value : "", value_bytes);
    return MHD_YES;
}

static enum MHD_Result add_argument(void *ctx, enum MHD_ValueKind kind, const char *name, size_t name_bytes,
                                    const char *value, size_t value_bytes) {
    (void)kind;
    request_take_argument(ctx, name, name_bytes, value, value_bytes);
    return MHD_YES;
}

/* Takes what the request's head says; returns its length. */
static uint64_t take_head(struct exchange *x) {
    struct request *request = &x->request;
    struct head_walk walk = {request, NULL};
    const union MHD_ConnectionInfo *info =
        MHD_get_connection_info(x->connection, MHD_CONNECTION_INFO_REQUEST_HEADER_SIZE);
    uint64_t bytes = info ? info->header_size : 0;
    MHD_get_connection_values_n(x->connection, MHD_HEADER_KIND, add_header, &walk);
    if (bytes) check_gap(&walk, request->method + bytes, 2 * LINE_END_BYTES); /* the head begins with the method */
    MHD_get_connection_values_n(x->connection, MHD_GET_ARGUMENT_KIND, add_argument, request);
    request_identify(request);
    request_read_framing(request);
    return bytes;
}

/* Counts the exchange among the uploads while its body comes. */
static void set_uploading(struct exchange *x, bool uploading) {
    if (x->uploading == uploading) return;
    x->uploading = uploading;
    tally_upload(&x->http->tally, uploading);
}

static enum MHD_Result begin(struct exchange *x, const char *method, const char *target, const char *version) {
    struct request *request = &x->request;
    struct service *service = x->http->service;
    const char *path = head_path(target);
    request->method = method;
    request->path = links_below_base(path);
    request->secure = x->secure;
    request->head = strcmp(method, "HEAD") == 0;
    snprintf(x->log_method, sizeof x->log_method, "%s", method);
    log_plain(x->log_path, sizeof x->log_path, path);
    uint64_t bytes = take_head(x);
    if (!head_is_of(target, request->header[HEADER_HOST])) request->fault = "the target is of another host than Host";
    if (!head_check(service->config, request, version, bytes, &x->response)) return answer_and_close(x);
    watchdog_enter(x->watched, request->has_body ? WATCHDOG_BODY : WATCHDOG_BUSY);
    x->handler = head_admit(service, x->http->handlers, request, x->admin, &x->response);
    if (!x->handler) return refuse(x);
    set_uploading(x, request->body != NULL);
    return MHD_YES;
}

/* ------------------------------------------------------------------------------------------------ body */

/* A piece of a body that nobody wants; MHD_NO cuts the connection. */
static enum MHD_Result drain(struct exchange *x, size_t count) {
    const struct config *config = x->http->service->config;
    x->drained_bytes += count;
    bool too_much = x->drained_bytes > (uint64_t)config->refuse_drain_bytes;
    bool too_long = x->phase == PHASE_REFUSING && clock_ms() - x->refused_ms > config->refuse_drain_ms;
    return too_much || too_long ? MHD_NO : MHD_YES;
}

static enum MHD_Result take_body(struct exchange *x, const char *bytes, size_t count) {
    struct problem problem;
    watchdog_count(x->watched, count);
    x->received_bytes += count;
    if (x->phase != PHASE_BODY || !x->request.body) return drain(x, count);
    if (body_write(x->request.body, bytes, count, &problem)) return MHD_YES;
    response_problem(&x->response, &problem);
    let_go(x);
    x->phase = PHASE_REFUSING;
    x->refused_ms = clock_ms();
    return MHD_YES;
}

/* The request is complete. */
static enum MHD_Result dispatch(struct exchange *x) {
    watchdog_enter(x->watched, WATCHDOG_BUSY);
    if (x->handler->quick) {
        x->handler->run(x->http->service, &x->request, &x->response);
        return answer(x);
    }
    if (x->handler->at_hand && x->handler->at_hand(x->http->service, &x->request, &x->response)) return answer(x);
    x->phase = PHASE_WHOLE;
    return MHD_YES;
}

/* The call after that.  A connection that is suspended in the call that told that the request is whole still counts as
 * one to be read from: once resumed, libmicrohttpd may read before it calls us, find that the client has closed its
 * half, and close the connection without the answer.  After a call without a response it reads no more. */
static enum MHD_Result hand_over(struct exchange *x) {
    x->phase = PHASE_PARKED;
    if (!park(x)) {
        response_refuse(&x->response, PROBLEM_DRAINING, "the service is shutting down");
        return answer(x);
    }
    set_uploading(x, false);                                              /* parked by now: closing waits for it */
    x->task.slow = strcmp(x->log_method, "GET") != 0 && !x->request.head; /* who changes something waits for others */
    thread_pool_post(x->http->pool, &x->task);
    return MHD_YES;
}

/* ------------------------------------------------------------------------------------------------ exchanges */

static struct client *client_of(struct MHD_Connection *connection) {
    const union MHD_ConnectionInfo *info = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_SOCKET_CONTEXT);
    return info ? info->socket_context : NULL;
}

static struct exchange *new_exchange(struct listener *listener, struct MHD_Connection *connection) {
    struct http *http = listener->http;
    struct exchange *x = calloc(1, sizeof *x);
    const struct client *client = client_of(connection);
    if (!x) return NULL;
    x->http = http;
    x->admin = listener->admin;
    x->secure = listener->secure;
    x->connection = connection;
    x->watched = client ? client->watched : NULL;
    x->began_ms = clock_ms();
    x->task = (struct thread_pool_task){.run = run_handler, .ctx = x};
    x->request.principal = principal_anonymous();
    x->problem = -1;
    response_init(&x->response);
    tally_begin(&http->tally);
    return x;
}

static void log_access(struct exchange *x, bool whole) {
    const union MHD_ConnectionInfo *info = MHD_get_connection_info(x->connection, MHD_CONNECTION_INFO_CLIENT_ADDRESS);
    const struct principal *who = &x->request.principal;
    char peer[LISTEN_NAME_BYTES] = "-";
    if (info && info->client_addr) listen_peer(info->client_addr, peer);
    log_line(LOG_INFO, "http id=%s peer=%s who=%s method=%s path=%s status=%d ms=%lld in=%llu out=%llu end=%s",
             x->request.id, peer,
             who->by_signature ? "link"
             : who->name[0]    ? who->name
                               : "-",
             x->log_method, x->log_path, x->status, (long long)(clock_ms() - x->began_ms),
             (unsigned long long)x->received_bytes, (unsigned long long)(whole && !x->request.head ? x->sent_bytes : 0),
             whole ? "whole" : "cut");
}

static void count(struct exchange *x, bool whole) {
    struct metrics *metrics = x->http->service->metrics;
    metrics_request(metrics, x->request.match.route, x->status, clock_ms() - x->began_ms);
    metrics_received(metrics, x->received_bytes);
    if (whole && !x->request.head) metrics_sent(metrics, x->sent_bytes);
    if (x->problem >= 0) metrics_problem(metrics, (enum problem_kind)x->problem);
}

/* Its end. */
static void end_exchange(struct listener *listener, struct exchange *x, bool whole) {
    set_uploading(x, false);
    log_access(x, whole);
    count(x, whole);
    watchdog_enter(x->watched, WATCHDOG_IDLE);
    let_go(x);
    response_done(&x->response);
    free(x);
    tally_end(&listener->http->tally);
}

/* ------------------------------------------------------------------------------------------------ own refusals */

/* What libmicrohttpd finds in a head before it calls us it refuses by itself; and when it has all of the head by then
 * (a Content-Length that is none, more cookies than memory), it goes on as if it hadn't, and answers twice.  Between
 * the two it calls nobody, but before the first it says in its log what it is about to do.  So the answer is written
 * there, and the connection's half closed, and it finds that it can't send any of its own.
 *
 * The log doesn't say which connection it is: it is the one on this thread whose head is there and of which we weren't
 * told yet.  There is no other, as we are told right after that. */

static void head_begins(struct listener *listener, struct MHD_Connection *connection) {
    struct client *client = client_of(connection);
    if (!client) return;
    pthread_mutex_lock(&listener->heads_lock);
    if (!client->head_link) {
        client->next_head = listener->heads;
        if (client->next_head) client->next_head->head_link = &client->next_head;
        client->head_link = &listener->heads;
        listener->heads = client;
    }
    client->connection = connection;
    client->thread = pthread_self();
    pthread_mutex_unlock(&listener->heads_lock);
}

static void head_ends(struct listener *listener, struct client *client) {
    pthread_mutex_lock(&listener->heads_lock);
    if (client && client->head_link) {
        *client->head_link = client->next_head;
        if (client->next_head) client->next_head->head_link = client->head_link;
        client->head_link = NULL;
    }
    pthread_mutex_unlock(&listener->heads_lock);
}

/* Whether all of the head is there. */
static bool has_head(struct MHD_Connection *connection) {
    const union MHD_ConnectionInfo *info = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_REQUEST_HEADER_SIZE);
    return info && info->header_size;
}

/* The connection on this thread whose head is being refused; NULL = its head isn't whole, and it is answered once. */
static struct MHD_Connection *find_refused(struct listener *listener) {
    struct MHD_Connection *found = NULL;
    pthread_mutex_lock(&listener->heads_lock);
    for (const struct client *client = listener->heads; client && !found; client = client->next_head)
        if (pthread_equal(client->thread, pthread_self()) && has_head(client->connection)) found = client->connection;
    pthread_mutex_unlock(&listener->heads_lock);
    return found;
}

/* Sends the response past libmicrohttpd, and nothing can follow.  A client that doesn't take it gets less. */
static void send_past(struct exchange *x) {
    const union MHD_ConnectionInfo *fd = MHD_get_connection_info(x->connection, MHD_CONNECTION_INFO_CONNECTION_FD);
    const union MHD_ConnectionInfo *tls = MHD_get_connection_info(x->connection, MHD_CONNECTION_INFO_GNUTLS_SESSION);
    size_t bytes;
    char *text = response_bytes(&x->response, MHD_get_reason_phrase_for((unsigned)x->response.status), &bytes);
    if (text && tls && x->secure)
        tls_send_last(tls->tls_session, text, bytes);
    else if (text && fd)
        x->sent_bytes = send(fd->connect_fd, text, bytes, MSG_NOSIGNAL | MSG_DONTWAIT) > 0 ? x->response.text_bytes : 0;
    if (fd) shutdown(fd->connect_fd, SHUT_WR);
    free(text);
}

static void refuse_head(struct listener *listener, struct MHD_Connection *connection, unsigned status) {
    struct exchange *x = new_exchange(listener, connection);
    head_ends(listener, client_of(connection));
    if (!x) return;
    struct head_walk walk = {&x->request, NULL};
    MHD_get_connection_values_n(connection, MHD_HEADER_KIND, add_header, &walk);
    request_identify(&x->request);
    snprintf(x->log_method, sizeof x->log_method, "-");
    snprintf(x->log_path, sizeof x->log_path, "-");
    if (status == MHD_HTTP_CONTENT_TOO_LARGE)
        response_refuse(&x->response, PROBLEM_BODY_TOO_LARGE, "Content-Length is over 64 bits");
    else if (status == MHD_HTTP_REQUEST_HEADER_FIELDS_TOO_LARGE)
        response_refuse(&x->response, PROBLEM_HEADERS_TOO_LARGE, "the cookies need more memory than a connection has");
    else
        response_refuse(&x->response, PROBLEM_MALFORMED_REQUEST, "Content-Length is not a whole number");
    response_header(&x->response, "X-Content-Type-Options", "nosniff");
    response_header(&x->response, "X-Request-Id", "%s", x->request.id);
    response_header(&x->response, "Connection", "close");
    x->status = x->response.status;
    x->problem = x->response.problem;
    send_past(x);
    end_exchange(listener, x, true);
}

/* ------------------------------------------------------------------------------------------------ callbacks */

/* Faults of request lines; the address of one marks its request until it has an exchange. */
static const char *const nul_in_target = "the target holds NUL", *const blank_in_target = "the target holds a blank",
                         *const slash_in_part = NULL; /* none of the head's: there is nothing at such a path */

/* Ends a query after so many arguments: libmicrohttpd has memory for some thousand, and answers nothing to more. An
 * empty one at the end is none to it, so one more than are too many is left. */
static void cut_query(char *query, size_t arguments) {
    for (; query && arguments; arguments--) query = strchr(query + 1, '&');
    if (query) *query = 0;
}

/* Gets the target before it is decoded, in libmicrohttpd's memory: a path would seem to end at its first NUL, whether
 * that is written %00 or is there (then the line's HTTP/ doesn't follow), and a slash that belongs to a part of the
 * path would seem to end the part. */
static void *on_target(void *ctx, const char *target, struct MHD_Connection *connection) {
    size_t length = strlen(target), path = strcspn(target, "?");
    const char *nul = strstr(target, "%00"), *slash = strcasestr(target, "%2f");
    head_begins(ctx, connection);
    cut_query((char *)target + path, REQUEST_MAX_QUERY + 2);
    if (strpbrk(target, " \t")) return (void *)&blank_in_target;
    if ((nul && nul < target + path) || strncmp(target + length + 1, "HTTP/", 5) != 0) return (void *)&nul_in_target;
    return slash && slash < target + path ? (void *)&slash_in_part : NULL;
}

static bool is_fault(const void *state) {
    return state == &nul_in_target || state == &blank_in_target || state == &slash_in_part;
}

static enum MHD_Result on_request(void *ctx, struct MHD_Connection *connection, const char *path, const char *method,
                                  const char *version, const char *body, size_t *body_bytes, void **state) {
    struct exchange *x = *state;
    if (!x || is_fault(x)) {
        const char *const *fault = *state;
        head_ends(ctx, client_of(connection));
        *state = x = new_exchange(ctx, connection);
        if (x && fault) x->request.fault = *fault;
        if (x) x->request.nowhere = fault == &slash_in_part;
        return x ? begin(x, method, path, version) : MHD_NO;
    }
    if (*body_bytes) {
        size_t count = *body_bytes;
        *body_bytes = 0;
        return take_body(x, body, count);
    }
    switch (x->phase) {
    case PHASE_BODY: return dispatch(x);
    case PHASE_WHOLE: return hand_over(x);
    case PHASE_REFUSING:
    case PHASE_ANSWER: return answer(x);
    case PHASE_PARKED:
    case PHASE_SENT: break;
    }
    return MHD_YES;
}

static void on_completed(void *ctx, struct MHD_Connection *connection, void **state,
                         enum MHD_RequestTerminationCode why) {
    struct exchange *x = *state;
    (void)connection;
    if (!x || is_fault(x)) return;
    *state = NULL;
    end_exchange(ctx, x, why == MHD_REQUEST_TERMINATED_COMPLETED_OK);
}

/* Whether a connection is taken at all. */
/* Takes a connection over from the acceptor. */
static bool take_connection(void *ctx, int fd, const struct sockaddr *address, socklen_t bytes) {
    struct listener *listener = ctx;
    char peer[LISTEN_NAME_BYTES];
    if (!peers_enter(listener->peers, address)) {
        listen_peer(address, peer);
        log_line_seldom(LOG_WARNING, "peer=%s refused: it has as many connections as connections-per-address allows",
                        peer);
        close(fd);
        return false;
    }
    if (MHD_add_connection(listener->daemon, fd, address, bytes) == MHD_YES) return true;
    peers_leave(listener->peers, address);
    return false;
}

static struct client *new_client(struct listener *listener, struct MHD_Connection *connection) {
    const union MHD_ConnectionInfo *fd = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CONNECTION_FD);
    struct client *client = calloc(1, sizeof *client);
    if (client && fd) client->watched = watchdog_add(listener->watchdog, fd->connect_fd);
    return client;
}

static void on_connection(void *ctx, struct MHD_Connection *connection, void **socket_context,
                          enum MHD_ConnectionNotificationCode code) {
    struct listener *listener = ctx;
    struct client *client = *socket_context;
    metrics_connection(listener->http->service->metrics, code == MHD_CONNECTION_NOTIFY_STARTED);
    if (code == MHD_CONNECTION_NOTIFY_STARTED) {
        *socket_context = new_client(listener, connection);
        acceptor_started(listener->acceptor);
        return;
    }
    const union MHD_ConnectionInfo *from = MHD_get_connection_info(connection, MHD_CONNECTION_INFO_CLIENT_ADDRESS);
    *socket_context = NULL;
    if (client) {
        head_ends(listener, client);
        watchdog_remove(listener->watchdog, client->watched);
        free(client);
    }
    peers_leave(listener->peers, from->client_addr);
    acceptor_left(listener->acceptor);
}

static void on_log(void *ctx, const char *format, va_list args) {
    static const char refusal[] = "Error processing request (HTTP response code is %u";
    struct MHD_Connection *refused = strncmp(format, refusal, sizeof refusal - 1) == 0 ? find_refused(ctx) : NULL;
    if (refused) {
        va_list copy;
        va_copy(copy, args);
        refuse_head(ctx, refused, va_arg(copy, unsigned));
        va_end(copy);
    }
    log_vline_seldom(LOG_WARNING, format, args);
}

__attribute__((noreturn)) static void on_panic(void *ctx, const char *file, unsigned line, const char *reason) {
    (void)ctx;
    log_line(LOG_ERROR, "libmicrohttpd: %s:%u: %s", file, line, reason ? reason : "panic");
    abort();
}

/* ------------------------------------------------------------------------------------------------ open, close */

/* How many connections may be at a time. */
static unsigned connections_of(const struct listener *listener) {
    return listener->admin ? ADMIN_CONNECTIONS : (unsigned)listener->http->service->config->max_connections;
}

/* Strictness is ours (http/precheck.c, on_target), as libmicrohttpd answers for itself without a problem document.  So
 * is the count of connections: its limit, which it divides by its threads, is one that none of them meets.
 *
 * Health has to come whatever the other listener does, so the admin one has a thread and connections of its own. */
static struct MHD_Daemon *start_daemon(struct listener *listener) {
    const struct config *config = listener->http->service->config;
    long processors = sysconf(_SC_NPROCESSORS_ONLN);
    unsigned threads = processors < MAX_SERVING_THREADS ? (unsigned)processors : MAX_SERVING_THREADS;
    unsigned flags =
        MHD_USE_EPOLL_INTERNAL_THREAD | MHD_USE_NO_LISTEN_SOCKET | MHD_ALLOW_SUSPEND_RESUME | MHD_USE_ERROR_LOG;
    struct MHD_OptionItem more[4];
    size_t count = 0;
    if (!listener->admin && threads > 1)
        more[count++] = (struct MHD_OptionItem){MHD_OPTION_THREAD_POOL_SIZE, (intptr_t)threads, NULL};
    if (listener->secure) {
        flags |= MHD_USE_TLS;
        more[count++] = (struct MHD_OptionItem){MHD_OPTION_HTTPS_CERT_CALLBACK, 0, tls_retrieve_function()};
        more[count++] = (struct MHD_OptionItem){MHD_OPTION_HTTPS_PRIORITIES, 0, (void *)(intptr_t)tls_priorities};
    }
    more[count] = (struct MHD_OptionItem){MHD_OPTION_END, 0, NULL};
    MHD_set_panic_func(on_panic, NULL);
    return MHD_start_daemon(
        flags, 0, NULL, NULL, on_request, listener, MHD_OPTION_EXTERNAL_LOGGER, on_log, listener, MHD_OPTION_ARRAY,
        more, MHD_OPTION_CONNECTION_LIMIT, threads * connections_of(listener), MHD_OPTION_CONNECTION_MEMORY_LIMIT,
        (size_t)CONNECTION_MEMORY, MHD_OPTION_CONNECTION_TIMEOUT, (unsigned)(config->idle_timeout_ms / 1000),
        MHD_OPTION_STRICT_FOR_CLIENT, 0, MHD_OPTION_URI_LOG_CALLBACK, on_target, listener, MHD_OPTION_NOTIFY_COMPLETED,
        on_completed, listener, MHD_OPTION_NOTIFY_CONNECTION, on_connection, listener, MHD_OPTION_END);
}

/* Whether addresses may be beyond loopback. */
static bool is_open(const struct config *config) { return config->insecure_open || config->tokens_file[0]; }

static bool takes_requests(const struct config *config) { return strcmp(config->roles, "work") != 0; }

static enum status start_listener(struct listener *listener, const char *inherited_name, const char *address,
                                  struct error *error) {
    const struct config *config = listener->http->service->config;
    struct watchdog_limits limits = {config->header_timeout_ms,      config->idle_timeout_ms,
                                     config->min_upload_bytes_per_s, config->upload_grace_ms,
                                     connections_of(listener),       listener->secure};
    bool open = is_open(config);
    const char *setting = listener->admin ? "admin-listen" : "listen";
    int inherited = notify_inherited(inherited_name);
    enum status status = inherited >= 0 ? listen_adopt(inherited, open, &listener->fd, error)
                                        : listen_open(setting, address, open, &listener->fd, error);
    if (status != STATUS_OK) return status;
    listener->peers = peers_new(listener->admin ? ADMIN_CONNECTIONS : (unsigned)config->connections_per_address);
    if (!listener->peers) return error_set(error, STATUS_NO_MEMORY, "http", "no memory");
    if (watchdog_open(limits, listener->http->service->metrics, &listener->watchdog) != STATUS_OK)
        return error_set(error, STATUS_NO_MEMORY, "http", "can't start a watchdog");
    listener->daemon = start_daemon(listener);
    if (!listener->daemon) return error_set(error, STATUS_IO, "http", "libmicrohttpd doesn't start");
    status = acceptor_open(listener->fd, connections_of(listener), take_connection, listener, &listener->acceptor);
    return status == STATUS_OK ? status : error_set(error, status, "http", "can't start a thread");
}

static bool is_named(const char *admin_listen) {
    return strcmp(admin_listen, "off") != 0 && strcmp(admin_listen, "auto") != 0;
}

/* "auto" is loopback and the port after the main one; a free one where that is free. */
static enum status start_admin(struct http *http, struct error *error) {
    const struct config *config = http->service->config;
    char address[LISTEN_NAME_BYTES];
    if (strcmp(config->admin_listen, "off") == 0) return STATUS_OK;
    if (is_named(config->admin_listen)) return start_listener(&http->admin, "admin", config->admin_listen, error);
    struct address after;
    unsigned port = address_read(config->listen, &after) ? after.port : 0;
    snprintf(address, sizeof address, "127.0.0.1:%u", port ? port + 1 : 0);
    enum status status = start_listener(&http->admin, "admin", address, error);
    if (status == STATUS_IO)
        error_set(error, status, "admin-listen", "can't listen on %s; --admin-listen names another address, or off",
                  address);
    return status;
}

static enum status start_listening(struct http *http, struct error *error) {
    const struct config *config = http->service->config;
    if (thread_pool_open(POOL_THREADS, &http->pool) != STATUS_OK)
        return error_set(error, STATUS_NO_MEMORY, "http", "can't start threads");
    http->main.secure = http->service->tls != NULL;
    enum status status =
        takes_requests(config) ? start_listener(&http->main, NOTIFY_MAIN_SOCKET, config->listen, error) : STATUS_OK;
    return status == STATUS_OK ? start_admin(http, error) : status;
}

enum status http_check_addresses(const struct config *config, struct error *error) {
    bool open = is_open(config);
    enum status status = takes_requests(config) ? listen_check("listen", config->listen, open, error) : STATUS_OK;
    if (status != STATUS_OK || !is_named(config->admin_listen)) return status;
    return listen_check("admin-listen", config->admin_listen, open, error);
}

/* Its URL. */
static void name_listener(const struct listener *listener, char url[HTTP_ADDRESS_BYTES]) {
    char name[LISTEN_NAME_BYTES];
    if (listener->fd < 0) return;
    listen_name(listener->fd, name);
    snprintf(url, HTTP_ADDRESS_BYTES, "%s://%s", listener->secure ? "https" : "http", name);
}

enum status http_open(struct service *service, const struct handlers *handlers, struct http **http,
                      struct http_addresses *addresses, struct error *error) {
    struct http *opened = calloc(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "http", "no memory");
    opened->service = service;
    opened->handlers = handlers;
    opened->main = (struct listener){.http = opened, .fd = -1};
    opened->admin = (struct listener){.http = opened, .fd = -1, .admin = true};
    pthread_mutex_init(&opened->main.heads_lock, NULL);
    pthread_mutex_init(&opened->admin.heads_lock, NULL);
    tally_init(&opened->tally);
    memset(addresses, 0, sizeof *addresses);
    enum status status = start_listening(opened, error);
    if (status == STATUS_OK) {
        name_listener(&opened->main, addresses->main);
        name_listener(&opened->admin, addresses->admin);
        *http = opened;
    } else {
        http_close(opened);
    }
    return status;
}

unsigned http_uploads(struct http *http) { return tally_uploads(&http->tally); }

/* libmicrohttpd 0.9.75 looks at an answer of its own that it hasn't queued, where it refuses a head while it is being
 * stopped: so all connections end before. */
static void stop_listener(struct listener *listener) {
    watchdog_end_all(listener->watchdog);
    if (listener->daemon) MHD_stop_daemon(listener->daemon);
    acceptor_free(listener->acceptor);
    watchdog_close(listener->watchdog);
    peers_free(listener->peers);
    if (listener->fd >= 0) close(listener->fd);
}

void http_close(struct http *http) {
    if (!http) return;
    acceptor_stop(http->main.acceptor, GOODBYE_S);
    if (http->main.daemon) tally_stop(&http->tally, GOODBYE_S);
    stop_listener(&http->main);
    acceptor_stop(http->admin.acceptor, GOODBYE_S);
    stop_listener(&http->admin);
    thread_pool_close(http->pool);
    tally_done(&http->tally);
    pthread_mutex_destroy(&http->main.heads_lock);
    pthread_mutex_destroy(&http->admin.heads_lock);
    free(http);
}
