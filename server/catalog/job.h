/* A job: its states, what is known of it, and the table of what may become of it.
 *
 *        +------------ reuse: an earlier job's outputs serve ---+
 *        |         claim                 done                   v
 *     accepted ------------> running ---------------------> successful
 *        |                    |  |  \  fail (its own fault, or it was tried often enough)
 *        | withdraw   dismiss |  |   +-----------> failed
 *        +------> dismissed <-+  +--> accepted   requeue (the host's fault: killed, or the service stops; or
 *                                                it takes more memory than predicted, and may have more)
 *
 * A job isn't given up for an end of the service as for one of its own process.  Which of the jobs that ran then ended
 * the service, if any, nobody can tell; so those that were interrupted JOB_ALONE_AFTER times run alone from then on,
 * which frees the innocent, and JOB_MAX_INTERRUPTIONS fail the one that still ends it.
 *
 * A job that is made in tiles (core/tiles/tiles.h) runs as tasks: the plan, each tile, the merge.  Hosts claim these
 * rather than the job, each by a lease of its own, as many of them at a time as there is room for; the job runs from
 * its first claim to its end, and nobody owns it.
 *
 *     plan --> tile 1, tile 2, ... tile N --> merge
 *
 * A task that is lost waits again, and nothing else does.  The end of a task is the job's where it has failed, or was
 * the merge.
 *
 * A member that is kept: server/catalog/README.md has the list of places.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_JOB_H
#define WHITTLE_SERVER_CATALOG_JOB_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <time.h>

#include "core/params.h"

enum job_state { JOB_ACCEPTED, JOB_RUNNING, JOB_SUCCESSFUL, JOB_FAILED, JOB_DISMISSED };
#define JOB_STATE_COUNT 5

enum job_event { JOB_CLAIM, JOB_DONE, JOB_FAIL, JOB_DISMISS, JOB_REQUEUE, JOB_REUSE, JOB_WITHDRAW };
#define JOB_EVENT_COUNT 7

enum {
    JOB_ID_BYTES = 37,
    JOB_LABEL_BYTES = 129,
    JOB_STAGE_BYTES = 32,
    JOB_MESSAGE_BYTES = 256,
    JOB_HASH_BYTES = 65,
    JOB_FORMAT_BYTES = 32,
    JOB_PRINCIPAL_BYTES = 65,
    JOB_OWNER_BYTES = 33,
    JOB_OUTPUT_NAME_BYTES = 48,
    JOB_MAX_OUTPUTS = PARAMS_MAX_FILES,
    JOB_WEBHOOK_BYTES = 2048,
    JOB_MAX_FAILURES = 3,                   /* ends of its process that weren't its own fault */
    JOB_MAX_INTERRUPTIONS = 20,             /* ends of the service while it ran */
    JOB_ALONE_AFTER = 2,                    /* interrupted so often, it runs while nothing else does */
    JOB_PRIORITY_AGING_MS = 10 * 60 * 1000, /* what a step of priority is worth in waiting */
    JOB_PRIORITY_MAX = 9,
    JOB_PRIORITY_DEFAULT = 5,
    JOB_TILES_UNPLANNED = -1, /* a number of tiles: it is to be found */
    JOB_MAX_TILES = 100000,
    JOB_TASK_NONE = -1, /* a task: the job as a whole */
    JOB_TASK_PLAN = 0   /* 1 to the number of tiles: one of these; one more: the merge */
};

/* No lease ends then: of a job whose tasks have owners rather than itself. */
#define JOB_LEASE_NEVER (INT64_C(1) << 52)

struct job_output {
    char name[JOB_OUTPUT_NAME_BYTES];
    uint64_t bytes;
    char sha256[JOB_HASH_BYTES];
};

/* What a job costs, as far as that is known before it runs (estimate.h). */
struct job_cost {
    uint64_t kind; /* jobs of the same kind do the same work */
    uint64_t size; /* points or, where they are not known, bytes */
};

/* The Idempotency-Key of the request that made a job, and a fingerprint of that request. */
struct job_key {
    const char *key; /* borrowed */
    char fingerprint[JOB_HASH_BYTES];
};

struct job {
    char id[JOB_ID_BYTES]; /* UUIDv7: ids sort by their time */
    enum job_state state;
    uint64_t sequence;           /* grows with every change: milliseconds since 1970, or the last one + 1 */
    int attempt;                 /* how often it was claimed: with the owner, who may end it */
    char owner[JOB_OWNER_BYTES]; /* the host that runs it; "" = none */
    int64_t lease_end_ms;        /* from then on another host may take it, unless it renews */
    bool is_cancelled;           /* it runs, and somebody wants it to end */
    int failures;                /* how often its process was ended by the host, or stood still */
    int interruptions;           /* how often the service ended while it ran */
    int64_t created_ms, started_ms, finished_ms, updated_ms, expires_ms; /* since 1970; 0 = not yet */
    char label[JOB_LABEL_BYTES];
    int priority;                        /* 0 to JOB_PRIORITY_MAX, larger is sooner */
    char principal[JOB_PRINCIPAL_BYTES]; /* who submitted it; "" = anonymous */
    char batch[JOB_ID_BYTES];            /* the batch that it is of (catalog.h); "" = none */

    char cloud[JOB_HASH_BYTES];
    uint64_t input_bytes, input_points; /* points: as the header says; 0 = not known */
    char input_format[JOB_FORMAT_BYTES];
    struct params params;
    bool is_strange;             /* it has parameters that this program doesn't know, and so it can't run it */
    char result[JOB_HASH_BYTES]; /* names what it computes: jobs with the same have the same outputs; "" = none */

    const struct job_key *key; /* borrowed, and kept with the job when it is submitted; NULL = none */
    const char *webhook;       /* the same: where to tell of its end */

    int64_t tiles;      /* that it is made in; 0 = it is made in one piece */
    int64_t tiles_done; /* of these */
    int64_t task; /* what was claimed, where there are tiles; then owner, attempt, failures, interruptions are its */
    double task_cpu_s; /* processor time of that alone */

    char stage[JOB_STAGE_BYTES], message[JOB_MESSAGE_BYTES];
    double fraction;
    uint64_t ahead; /* accepted jobs whose turn comes before its own; filled by catalog_get and catalog_list */

    double cpu_s, wall_s;
    uint64_t peak_rss_bytes;
    uint64_t memory_bytes;  /* that it is predicted to take; 0 = not known */
    char *report, *problem; /* JSON text; owned; NULL = none */

    size_t output_count;
    struct job_output output[JOB_MAX_OUTPUTS];
};

/* Frees what the job owns and zeroes it.  Accepts a zeroed job. */
void job_done(struct job *job);

/* "accepted", ...; and back: false where there is no such state. */
const char *job_state_name(enum job_state state);
bool job_state_from_name(const char *name, enum job_state *state);

/* Whether the event may happen in this state, and then which state follows. */
bool job_transition(enum job_state state, enum job_event event, enum job_state *next);

/* What an event means to a job with tiles, by the task that it happened to. */
enum job_step {
    JOB_STEP_PLANNED, /* its tiles may be claimed; job->tiles says how many */
    JOB_STEP_TILE,    /* one more is done */
    JOB_STEP_AGAIN,   /* the task waits again */
    JOB_STEP_RESTART, /* all of it begins anew */
    JOB_STEP_END      /* the job is in state *next */
};
enum job_step job_step_of(const struct job *job, enum job_event event, enum job_state *next);

/* Makes a job that was read with its row the task of it that the other one says. */
void job_become_task(struct job *job, const struct job *task);

/* Whether a job in this state is over. */
bool job_ended(enum job_state state);

/* A new UUIDv7 of this time (CLOCK_REALTIME): the milliseconds, the quarter microseconds within them, 62 random bits.
 * So ids sort by their time. */
void job_new_id(const struct timespec *now, char id[JOB_ID_BYTES]);

/* Makes it another one of the same time. */
void job_another_id(char id[JOB_ID_BYTES]);

/* Whether text has the form of an id (hexadecimal digits in lower case, dashes in their places). */
bool job_id_valid(const char *text);

/* Parameters as lines of name=value; returns new, NULL when memory runs out. */
char *job_params_text(const struct params *params);

/* The same for storing, with one more line that says which of them aren't at their defaults.  And back, over the
 * defaults: a name that is gone from the table is skipped.  false: a newer program has stored something that this one
 * doesn't know, another value or a parameter that isn't at its default, so the parameters are others. */
char *job_params_stored(const struct params *params);
bool job_params_read(const char *text, struct params *params);

/* Text that two jobs have in common exactly when the same engine computes the same outputs for both: the cloud, every
 * parameter that affects results, the version.  Returns new, NULL when memory runs out. */
char *job_result_text(const struct job *job, const char *version);

/* Milliseconds since 1970, by the service's own clock (server/base/wall_clock.h). */
int64_t job_now_ms(void);

/* The same as text, "2026-01-31T12:00:00.123Z"; returns text. */
enum { JOB_TIME_BYTES = 32 };
const char *job_time_text(int64_t ms, char text[JOB_TIME_BYTES]);

#endif
