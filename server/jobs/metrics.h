/* What the service counts, and its text for Prometheus.
 *
 * Counting is one atomic addition, from any thread, without a lock.  The text is made of the counters, of the queue's
 * numbers in memory, and of a few calls to the kernel; no database is asked, so it comes under any load.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_JOBS_METRICS_H
#define WHITTLE_SERVER_JOBS_METRICS_H

#include <stdbool.h>
#include <stdint.h>

#include "api/problem.h"
#include "api/routes.h"
#include "server/catalog/job.h"

struct metrics;
struct service;

/* Returns new, NULL when memory runs out; metrics_free accepts NULL. */
struct metrics *metrics_new(void);
void metrics_free(struct metrics *metrics);

/* A request that is over.  route NULL: nothing is at its path; status 0: the connection was cut before an answer. */
void metrics_request(struct metrics *metrics, const struct route *route, int status, int64_t ms);

/* Bytes of bodies. */
void metrics_received(struct metrics *metrics, uint64_t bytes);
void metrics_sent(struct metrics *metrics, uint64_t bytes);

/* A problem document was sent. */
void metrics_problem(struct metrics *metrics, enum problem_kind kind);

void metrics_connection(struct metrics *metrics, bool opened);

/* Why the watchdog cut a connection. */
enum metrics_cut { METRICS_CUT_HEADERS, METRICS_CUT_IDLE, METRICS_CUT_SLOW, METRICS_CUT_HALF_CLOSED };
#define METRICS_CUT_COUNT 4
void metrics_cut(struct metrics *metrics, enum metrics_cut why);

/* A job was accepted; a run of a job has ended with this event. */
void metrics_submitted(struct metrics *metrics);
void metrics_run(struct metrics *metrics, enum job_event event, double cpu_s, double wall_s);

/* Everything, as text in Prometheus' format; returns new, NULL when memory runs out. */
char *metrics_text(struct metrics *metrics, struct service *service);

#endif
