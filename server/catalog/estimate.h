/* How long a job will take, from how long jobs like it took.
 *
 * Jobs are alike when their parameters are, but for those that don't change the work (seed, threads) and those that
 * change it by degrees (how many points to keep, in steps of a factor of two), and their inputs have the same format
 * and a size within a factor of four.  Where fewer than ESTIMATE_MIN_SAMPLES such jobs have ended nothing is claimed.
 *
 * May be called from any thread.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_CATALOG_ESTIMATE_H
#define WHITTLE_SERVER_CATALOG_ESTIMATE_H

#include <stdint.h>

#include "server/catalog/job.h"

struct estimate;

enum { ESTIMATE_MIN_SAMPLES = 2 };

/* Returns new, NULL when memory runs out.  estimate_free accepts NULL. */
struct estimate *estimate_new(void);
void estimate_free(struct estimate *estimate);

/* What a job costs, as far as that is known before it runs. */
struct job_cost estimate_cost(const struct job *job);

/* A job of this cost took so long (wall time), and ended then.  The latest few of each kind are remembered. */
void estimate_learn(struct estimate *estimate, const struct job_cost *cost, double seconds, int64_t finished_ms);

/* How long a job of this cost will take; NAN = not known. */
double estimate_seconds(struct estimate *estimate, const struct job_cost *cost);

/* When a number of workers will be free: workers[i] is seconds from now.  Gives the job to the one that is free first;
 * returns when it will have ended.  NAN in, NAN out. */
double estimate_assign(double *workers, unsigned count, double seconds);

/* How long a job still takes that has run for elapsed_s and says that it has done this fraction: the rest of what such
 * jobs take or, where it is over that, what its own pace comes to.  NAN = not known. */
double estimate_rest(double expected_s, double elapsed_s, double fraction);

#endif
