/* libpq, shorter: the only file that knows it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/postgres/pq.h"

#include <errno.h>
#include <poll.h>
#include <postgresql/libpq-fe.h>
#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "core/base/alloc.h"
#include "core/base/clock.h"
#include "core/base/fault.h"
#include "server/base/away.h"
#include "server/catalog/rows.h"

/* A statement's deadline, that of all that is to be done soon, and how many connections there are. */
enum { DEADLINE_MS = 5000, SOON_MS = 1000, LINKS = 8, MAX_VALUES = CATALOG_MAX_COLUMNS, NUMBER_BYTES = 40 };
/* What a host that is stopped amid a transaction has locked is free then: it could have been everybody's turn. */
#define IDLE_MS "5000"
enum { OID_INT8 = 20, OID_TEXT = 25, OID_FLOAT8 = 701 };

struct pq_link {
    struct pq *pq;
    PGconn *conn; /* NULL = not connected */
    bool is_taken;
    int64_t until_ms;   /* when all has to be done; 0 = each statement has a deadline of its own */
    unsigned departure; /* the pool's when it was connected */
    bool is_in;         /* a transaction, */
    bool begins;        /* whose BEGIN goes out with its first statement */
    unsigned queued; /* statements that were sent and whose answers weren't taken: the connection is in pipeline mode */
};

/* Several servers may be named, of which one takes changes.  One that is left (leave_server) is asked last from then
 * on, and what is connected to it is connected anew. */
enum { HOSTS, ADDRESSES, PORTS, LISTS };

struct pq {
    char *conninfo;
    pthread_mutex_t lock;
    pthread_cond_t given;
    _Atomic bool is_silent;     /* the last one who asked the server has had no answer */
    _Atomic unsigned departure; /* how often a server was left */
    _Atomic size_t first;       /* the server that is asked first */
    char *list[LISTS];          /* as libpq has them, separated by commas; NULL = not named */
    struct pq_link link[LINKS];
};

struct pq_rows {
    PGresult *result;
    int row;
};

/* The first line of what the server says; it never holds the password. */
static enum status refused(enum status status, const char *text, struct error *error) {
    return error_set(error, status, "database", "the database says: %.*s", (int)strcspn(text, "\n"), text);
}

/* The same of libpq, where there is no server that says anything. */
static enum status away(const char *text, struct error *error) {
    return error_set(error, STATUS_IO, AWAY, "the database isn't there: %.*s", (int)strcspn(text, "\n"), text);
}

/* ------------------------------------------------------------------------------------------------ connections */

bool pq_valid(const char *conninfo) {
    PQconninfoOption *options = PQconninfoParse(conninfo, NULL);
    PQconninfoFree(options);
    return options != NULL;
}

static void disconnect(struct pq_link *link) {
    PQfinish(link->conn);
    link->conn = NULL;
    link->queued = 0;
}

static void ignore_notice(void *ctx, const PGresult *result) {
    (void)ctx;
    (void)result;
}

static const char *const list_names[LISTS] = {[HOSTS] = "host", [ADDRESSES] = "hostaddr", [PORTS] = "port"};

/* What the address names of them; the environment's and a service file's stay as they are. */
static enum status read_servers(struct pq *pq, struct error *error) {
    PQconninfoOption *options = PQconninfoParse(pq->conninfo, NULL);
    bool has_memory = options != NULL;
    for (PQconninfoOption *option = options; has_memory && option->keyword; option++)
        for (int l = 0; has_memory && l < LISTS; l++) {
            if (strcmp(option->keyword, list_names[l]) != 0 || !option->val || !*option->val) continue;
            pq->list[l] = strdup(option->val);
            has_memory = pq->list[l] != NULL;
        }
    PQconninfoFree(options);
    return has_memory ? STATUS_OK : error_set(error, STATUS_NO_MEMORY, "database", "no memory");
}

static size_t count_items(const char *list) {
    size_t count = list ? 1 : 0;
    for (; list && *list; list++) count += *list == ',';
    return count;
}

static const char *find_item(const char *list, size_t number) {
    while (number--) list += strcspn(list, ",") + 1;
    return list;
}

static size_t count_servers(const struct pq *pq) {
    return count_items(pq->list[HOSTS] ? pq->list[HOSTS] : pq->list[ADDRESSES]);
}

/* The list from one of its items on, the others behind; new.  One port is for all servers. */
static char *turn_list(const char *list, size_t first) {
    size_t bytes = list ? strlen(list) + 2 : 0;
    char *turned = list ? malloc(bytes) : NULL;
    if (!turned) return NULL;
    const char *from = first < count_items(list) ? find_item(list, first) : list;
    int before = from > list ? (int)(from - list - 1) : 0;
    snprintf(turned, bytes, "%s%s%.*s", from, before ? "," : "", before, list);
    return turned;
}

static bool is_item(const char *list, size_t number, const char *text) {
    const char *item = find_item(list, number);
    size_t length = strcspn(item, ",");
    return strlen(text) == length && memcmp(item, text, length) == 0;
}

/* A server that hangs may be one that isn't the primary any more and doesn't know it: its commits wait for a standby
 * that has become another's, and it still says that it takes changes.  All leave it who are connected to it. */
static void leave_server(struct pq_link *link) {
    struct pq *pq = link->pq;
    size_t servers = count_servers(pq);
    const char *host = PQhost(link->conn), *port = PQport(link->conn);
    const char *names = pq->list[HOSTS] ? pq->list[HOSTS] : pq->list[ADDRESSES];
    bool has_ports = count_items(pq->list[PORTS]) == servers && servers > 1;
    pthread_mutex_lock(&pq->lock);
    if (link->departure == pq->departure) {
        for (size_t i = 0; host && i < servers; i++)
            if (is_item(names, i, host) && (!has_ports || is_item(pq->list[PORTS], i, port)))
                pq->first = (i + 1) % servers;
        pq->departure++;
    }
    pthread_mutex_unlock(&pq->lock);
}

/* Settings that the address doesn't name itself: what libpq can see of a dead server, it is to see soon.  What follows
 * the address is instead of what it names. */
static enum status connect_link(struct pq_link *link, struct error *error) {
    const char *const names[] = {"connect_timeout",
                                 "tcp_user_timeout",
                                 "keepalives_idle",
                                 "keepalives_interval",
                                 "keepalives_count",
                                 "target_session_attrs",
                                 "fallback_application_name",
                                 "client_encoding",
                                 "options",
                                 "dbname",
                                 list_names[HOSTS],
                                 list_names[ADDRESSES],
                                 list_names[PORTS],
                                 NULL};
    struct pq *pq = link->pq;
    char *list[LISTS];
    if (fault_at("database-connect")) return away(strerror(errno), error);
    disconnect(link);
    link->departure = pq->departure;
    for (int l = 0; l < LISTS; l++) list[l] = turn_list(pq->list[l], pq->first);
    const char *values[] = {"3",          "5000",      "2",
                            "1",          "3",         "read-write",
                            "whittled",   "UTF8",      "-c idle_in_transaction_session_timeout=" IDLE_MS,
                            pq->conninfo, list[HOSTS], list[ADDRESSES],
                            list[PORTS],  NULL};
    link->conn = PQconnectdbParams(names, values, 1);
    for (int l = 0; l < LISTS; l++) free(list[l]);
    if (!link->conn) return error_set(error, STATUS_NO_MEMORY, "database", "no memory");
    if (PQstatus(link->conn) == CONNECTION_OK) {
        PQsetNoticeReceiver(link->conn, ignore_notice, NULL);
        return STATUS_OK;
    }
    enum status status = away(PQerrorMessage(link->conn), error);
    link->pq->is_silent = true;
    disconnect(link);
    return status;
}

enum status pq_open(const char *conninfo, struct pq **pq, struct error *error) {
    struct pq *opened = alloc_zeroed(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "database", "no memory");
    pthread_condattr_t by_monotonic;
    pthread_mutex_init(&opened->lock, NULL);
    pthread_condattr_init(&by_monotonic);
    pthread_condattr_setclock(&by_monotonic, CLOCK_MONOTONIC);
    pthread_cond_init(&opened->given, &by_monotonic);
    pthread_condattr_destroy(&by_monotonic);
    for (int i = 0; i < LINKS; i++) opened->link[i].pq = opened;
    opened->conninfo = strdup(conninfo);
    enum status status =
        opened->conninfo ? read_servers(opened, error) : error_set(error, STATUS_NO_MEMORY, "database", "no memory");
    if (status == STATUS_OK) status = connect_link(&opened->link[0], error);
    if (status == STATUS_OK)
        *pq = opened;
    else
        pq_close(opened);
    return status;
}

void pq_close(struct pq *pq) {
    if (!pq) return;
    for (int i = 0; i < LINKS; i++) disconnect(&pq->link[i]);
    pthread_cond_destroy(&pq->given);
    pthread_mutex_destroy(&pq->lock);
    for (int l = 0; l < LISTS; l++) free(pq->list[l]);
    free(pq->conninfo);
    free(pq);
}

/* One that nobody has: connected already, if there is such. */
static struct pq_link *find_link(struct pq *pq) {
    struct pq_link *found = NULL;
    for (int i = 0; i < LINKS; i++)
        if (!pq->link[i].is_taken && (!found || (!found->conn && pq->link[i].conn))) found = &pq->link[i];
    return found;
}

/* until_ms 0: for as long as it takes. */
static enum status take(struct pq *pq, int64_t until_ms, struct pq_link **link, struct error *error) {
    const struct timespec until = {.tv_sec = until_ms / 1000, .tv_nsec = until_ms % 1000 * 1000000};
    struct pq_link *found;
    int late = 0;
    pthread_mutex_lock(&pq->lock);
    while (!(found = find_link(pq)) && !late)
        late =
            until_ms ? pthread_cond_timedwait(&pq->given, &pq->lock, &until) : pthread_cond_wait(&pq->given, &pq->lock);
    if (found) found->is_taken = true;
    pthread_mutex_unlock(&pq->lock);
    if (!found) return error_set(error, STATUS_IO, AWAY, "the database has no time");
    found->until_ms = until_ms;
    if (found->departure != pq->departure) disconnect(found);
    enum status status = found->conn ? STATUS_OK : connect_link(found, error);
    if (status == STATUS_OK)
        *link = found;
    else
        pq_done(found);
    return status;
}

enum status pq_take(struct pq *pq, struct pq_link **link, struct error *error) { return take(pq, 0, link, error); }

enum status pq_take_soon(struct pq *pq, struct pq_link **link, struct error *error) {
    if (pq->is_silent) return error_set(error, STATUS_IO, AWAY, "the database doesn't answer");
    return take(pq, clock_ms() + SOON_MS, link, error);
}

void pq_done(struct pq_link *link) {
    struct pq *pq = link->pq;
    link->is_in = link->begins = false;
    if (link->conn && (PQstatus(link->conn) != CONNECTION_OK || PQtransactionStatus(link->conn) != PQTRANS_IDLE))
        disconnect(link);
    pthread_mutex_lock(&pq->lock);
    link->is_taken = false;
    pthread_cond_signal(&pq->given);
    pthread_mutex_unlock(&pq->lock);
}

/* ------------------------------------------------------------------------------------------------ statements */

/* Waits for the socket; false, and the connection is closed: the deadline has come, or it is broken. */
static bool wait_for(struct pq_link *link, short events, int64_t deadline_ms, struct error *error) {
    int64_t left = deadline_ms - clock_ms();
    struct pollfd socket = {.fd = PQsocket(link->conn), .events = events};
    int n = left > 0 ? poll(&socket, 1, (int)left) : 0;
    if (n > 0 || (n < 0 && errno == EINTR)) return true;
    error_set(error, STATUS_IO, AWAY, "the database doesn't answer");
    link->pq->is_silent = true;
    if (!link->until_ms) leave_server(link);
    disconnect(link);
    return false;
}

/* Sends what is buffered, and takes in what comes, until the answer is whole. */
static bool finish_query(struct pq_link *link, int64_t deadline_ms, struct error *error) {
    int rest = PQflush(link->conn);
    while (rest > 0) {
        if (!wait_for(link, POLLIN | POLLOUT, deadline_ms, error)) return false;
        if (!PQconsumeInput(link->conn)) break;
        rest = PQflush(link->conn);
    }
    while (rest == 0 && PQisBusy(link->conn)) {
        if (!wait_for(link, POLLIN, deadline_ms, error)) return false;
        if (!PQconsumeInput(link->conn)) break;
    }
    return true;
}

/* A server that ends, or that isn't the one which takes changes any more, is left: another one is asked next time. */
static bool is_leaving(const char *state) {
    static const char *const states[] = {"08", "57P", "25006", "53300"};
    for (size_t i = 0; state && i < sizeof states / sizeof *states; i++)
        if (strncmp(state, states[i], strlen(states[i])) == 0) return true;
    return false;
}

static enum status status_of(const PGresult *result, struct pq_link *link, struct error *error) {
    ExecStatusType kind = PQresultStatus(result);
    link->pq->is_silent = PQstatus(link->conn) != CONNECTION_OK;
    if (kind == PGRES_COMMAND_OK || kind == PGRES_TUPLES_OK) return STATUS_OK;
    const char *state = result ? PQresultErrorField(result, PG_DIAG_SQLSTATE) : NULL;
    const char *text = result ? PQresultErrorField(result, PG_DIAG_MESSAGE_PRIMARY) : NULL;
    if (is_leaving(state) || PQstatus(link->conn) != CONNECTION_OK) {
        enum status status = away(text ? text : PQerrorMessage(link->conn), error);
        disconnect(link);
        return status;
    }
    /* Rolled back for the sake of another transaction, which has made at the same time what has this key, too: whoever
     * comes again finds the way free, or what was made. */
    if (state && (strncmp(state, "40", 2) == 0 || strcmp(state, "23505") == 0))
        return error_set(error, STATUS_IO, AWAY, "the database rolled it back: %s", text ? text : "");
    bool is_full = state && (strcmp(state, "53100") == 0), is_short = state && strcmp(state, "53200") == 0;
    return refused(is_full    ? STATUS_NO_SPACE
                   : is_short ? STATUS_NO_MEMORY
                              : STATUS_IO,
                   text ? text : PQerrorMessage(link->conn), error);
}

/* Takes what a statement has come to: its last result, or the first that failed, of these and of *last.  false: the
 * connection is closed. */
static bool take_next(struct pq_link *link, int64_t deadline_ms, PGresult **last, struct error *error) {
    for (PGresult *next;;) {
        if (!finish_query(link, deadline_ms, error)) return false;
        next = PQgetResult(link->conn);
        if (!next) return true;
        bool was_fine = !*last || PQresultStatus(*last) == PGRES_COMMAND_OK || PQresultStatus(*last) == PGRES_TUPLES_OK;
        PQclear(was_fine ? *last : next);
        if (was_fine) *last = next;
    }
}

/* The last result of what was sent. */
static enum status take_result(struct pq_link *link, int sent, PGresult **result, struct error *error) {
    int64_t deadline_ms = link->until_ms ? link->until_ms : clock_ms() + DEADLINE_MS;
    *result = NULL;
    if (!sent) {
        enum status status = away(PQerrorMessage(link->conn), error);
        disconnect(link);
        return status;
    }
    if (!take_next(link, deadline_ms, result, error)) {
        PQclear(*result);
        *result = NULL;
        return STATUS_IO;
    }
    enum status status = status_of(*result, link, error);
    if (status == STATUS_OK) return STATUS_OK;
    PQclear(*result);
    *result = NULL;
    return status;
}

static bool send_statement(struct pq_link *link, const char *text, const struct pq_value *values, size_t count) {
    Oid types[MAX_VALUES];
    const char *texts[MAX_VALUES];
    char numbers[MAX_VALUES][NUMBER_BYTES];
    for (size_t i = 0; i < count; i++) {
        const struct pq_value *value = &values[i];
        types[i] = value->type == PQ_VALUE_INTEGER ? OID_INT8 : value->type == PQ_VALUE_REAL ? OID_FLOAT8 : OID_TEXT;
        texts[i] = value->type == PQ_VALUE_TEXT ? value->text : numbers[i];
        if (value->type == PQ_VALUE_INTEGER) snprintf(numbers[i], NUMBER_BYTES, "%lld", (long long)value->integer);
        if (value->type == PQ_VALUE_REAL) snprintf(numbers[i], NUMBER_BYTES, "%.17g", value->real);
    }
    return PQsendQueryParams(link->conn, text, (int)count, types, texts, NULL, NULL, 0);
}

/* ---- several statements, one round trip: what needs no answer waits for the next that does ---- */

static enum status queue(struct pq_link *link, const char *text, const struct pq_value *values, size_t count,
                         struct error *error) {
    if (!link->conn || count > MAX_VALUES) return error_set(error, STATUS_IO, AWAY, "the connection is gone");
    bool sent = link->queued || PQenterPipelineMode(link->conn);
    if (sent && link->begins) {
        sent = send_statement(link, "BEGIN", NULL, 0);
        link->begins = false;
        link->queued++;
    }
    sent = sent && send_statement(link, text, values, count);
    link->queued++;
    if (sent) return STATUS_OK;
    enum status status = away(PQerrorMessage(link->conn), error);
    disconnect(link);
    return status;
}

/* The result of the last one, or of the first that failed, after which none is done. */
static enum status take_queued(struct pq_link *link, PGresult **result, struct error *error) {
    int64_t deadline_ms = link->until_ms ? link->until_ms : clock_ms() + DEADLINE_MS;
    PGresult *last = NULL;
    bool answers = PQpipelineSync(link->conn);
    if (!answers) {
        away(PQerrorMessage(link->conn), error);
        disconnect(link);
    }
    for (unsigned left = link->queued; answers && left; left--) answers = take_next(link, deadline_ms, &last, error);
    if (answers && (answers = finish_query(link, deadline_ms, error))) PQclear(PQgetResult(link->conn)); /* the end */
    *result = NULL;
    if (!answers) {
        PQclear(last);
        return STATUS_IO;
    }
    link->queued = 0;
    enum status status = status_of(last, link, error);
    if (link->conn && !PQexitPipelineMode(link->conn)) disconnect(link); /* what is there counts all the same */
    if (status == STATUS_OK)
        *result = last;
    else
        PQclear(last);
    return status;
}

static enum status query(struct pq_link *link, const char *text, const struct pq_value *values, size_t count,
                         PGresult **result, struct error *error) {
    *result = NULL;
    if (!link->conn || count > MAX_VALUES) return error_set(error, STATUS_IO, AWAY, "the connection is gone");
    if (!link->is_in) return take_result(link, send_statement(link, text, values, count), result, error);
    enum status status = queue(link, text, values, count, error);
    return status == STATUS_OK ? take_queued(link, result, error) : status;
}

enum status pq_run(struct pq_link *link, const char *text, const struct pq_value *values, size_t count,
                   int64_t *changed, struct error *error) {
    PGresult *result;
    if (link->is_in && !changed) return queue(link, text, values, count, error);
    enum status status = query(link, text, values, count, &result, error);
    if (status == STATUS_OK && changed) *changed = strtoll(PQcmdTuples(result), NULL, 10);
    PQclear(result);
    return status;
}

enum status pq_execute(struct pq_link *link, const char *text, struct error *error) {
    PGresult *result = NULL;
    enum status status = STATUS_OK;
    if (!link->conn) return error_set(error, STATUS_IO, AWAY, "the connection is gone");
    if (link->queued) status = take_queued(link, &result, error);
    PQclear(result);
    result = NULL;
    if (status == STATUS_OK && link->begins) {
        link->begins = false;
        status = pq_execute(link, "BEGIN", error);
    }
    if (status == STATUS_OK) status = take_result(link, PQsendQuery(link->conn, text), &result, error);
    PQclear(result);
    return status;
}

/* Whether the connection has been closed while nobody used it, as far as this machine knows. */
static bool is_closed(struct pq_link *link) {
    struct pollfd socket = {.fd = PQsocket(link->conn), .events = POLLIN};
    while (poll(&socket, 1, 0) > 0)
        if (!PQconsumeInput(link->conn) || PQstatus(link->conn) != CONNECTION_OK) return true;
    return false;
}

static enum status begin(struct pq_link *link, struct error *error) {
    enum status status = is_closed(link) ? connect_link(link, error) : STATUS_OK;
    if (status == STATUS_OK)
        link->is_in = link->begins = true;
    else
        pq_done(link);
    return status;
}

enum status pq_begin(struct pq *pq, struct pq_link **link, struct error *error) {
    enum status status = pq_take(pq, link, error);
    return status == STATUS_OK ? begin(*link, error) : status;
}

enum status pq_begin_soon(struct pq *pq, struct pq_link **link, struct error *error) {
    enum status status = pq_take_soon(pq, link, error);
    return status == STATUS_OK ? begin(*link, error) : status;
}

static void roll_back(struct pq_link *link) {
    struct error ignored;
    PGresult *result = NULL;
    if (!link->conn || link->begins) return;
    enum status status = query(link, "ROLLBACK", NULL, 0, &result, &ignored);
    (void)status; /* closing the connection, which follows where it failed, does the same */
    PQclear(result);
}

enum status pq_end(struct pq_link *link, enum status status, bool *unknown, struct error *error) {
    PGresult *result = NULL;
    if (status == STATUS_OK && fault_at("commit"))
        status = error_set(error, status_from_errno(errno), "database", "%s", strerror(errno));
    if (status == STATUS_OK && !link->begins) {
        status = query(link, "COMMIT", NULL, 0, &result, error);
        if (unknown) *unknown = status != STATUS_OK && !link->conn;
        PQclear(result);
    }
    if (status != STATUS_OK) roll_back(link);
    pq_done(link);
    return status;
}

void pq_undo(struct pq_link *link) {
    roll_back(link);
    pq_done(link);
}

/* ------------------------------------------------------------------------------------------------ rows */

/* Outside of a transaction a connection that has died is made anew, once. */
enum status pq_select(struct pq_link *link, const char *text, const struct pq_value *values, size_t count,
                      struct pq_rows **rows, struct error *error) {
    PGresult *result;
    bool is_idle = link->conn && !link->is_in;
    enum status status = query(link, text, values, count, &result, error);
    bool has_time = !link->until_ms || clock_ms() < link->until_ms;
    if (status != STATUS_OK && !link->conn && is_idle && has_time && connect_link(link, error) == STATUS_OK)
        status = query(link, text, values, count, &result, error);
    if (status != STATUS_OK) return status;
    *rows = alloc_zeroed(1, sizeof **rows);
    if (*rows)
        **rows = (struct pq_rows){result, -1};
    else
        PQclear(result);
    return *rows ? STATUS_OK : error_set(error, STATUS_NO_MEMORY, "database", "no memory");
}

bool pq_next(struct pq_rows *rows) { return ++rows->row < PQntuples(rows->result); }

void pq_free(struct pq_rows *rows) {
    PQclear(rows->result);
    free(rows);
}

enum status pq_number(struct pq_link *link, const char *text, const struct pq_value *values, size_t count,
                      int64_t *number, struct error *error) {
    struct pq_rows *rows;
    enum status status = pq_select(link, text, values, count, &rows, error);
    if (status != STATUS_OK) return status;
    if (pq_next(rows)) *number = pq_integer(rows, 0);
    pq_free(rows);
    return STATUS_OK;
}

const char *pq_text(const struct pq_rows *rows, int column) { return PQgetvalue(rows->result, rows->row, column); }

int64_t pq_integer(const struct pq_rows *rows, int column) { return strtoll(pq_text(rows, column), NULL, 10); }

double pq_real(const struct pq_rows *rows, int column) { return strtod(pq_text(rows, column), NULL); }

void pq_copy_text(const struct pq_rows *rows, int column, char *to, size_t bytes) {
    snprintf(to, bytes, "%s", pq_text(rows, column));
}

char *pq_new_text(const struct pq_rows *rows, int column) {
    return PQgetisnull(rows->result, rows->row, column) ? NULL : strdup(pq_text(rows, column));
}

/* ------------------------------------------------------------------------------------------------ notifications */

static bool take_notification(struct pq_link *link, char *text, size_t bytes) {
    PGnotify *note = PQnotifies(link->conn);
    if (note) snprintf(text, bytes, "%s", note->extra);
    PQfreemem(note);
    return note != NULL;
}

enum status pq_wait(struct pq_link *link, int ms, char *text, size_t bytes, bool *notified, struct error *error) {
    if (!link->conn || link->departure != link->pq->departure)
        return error_set(error, STATUS_IO, AWAY, "the connection is gone");
    *notified = take_notification(link, text, bytes);
    if (*notified) return STATUS_OK;
    struct pollfd socket = {.fd = PQsocket(link->conn), .events = POLLIN};
    int n = poll(&socket, 1, ms);
    if (n > 0 && !PQconsumeInput(link->conn)) return away(PQerrorMessage(link->conn), error);
    *notified = take_notification(link, text, bytes);
    return STATUS_OK;
}
