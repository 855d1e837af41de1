/* What a task of a job in tiles reads of what others have made, and what share of the job it is.
 *
 *     plan     nothing: the cloud alone                     makes  plan, around, points.0 ... points.N-1
 *     tile     plan, and the points that `around` names     makes  left.T, and for a tileset perhaps gone.T
 *     merge    plan, all points, all that is left and gone  makes  the outputs
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_RUNNER_TASK_FILES_H
#define WHITTLE_SERVER_RUNNER_TASK_FILES_H

#include <stdbool.h>
#include <stddef.h>

#include "core/base/status.h"
#include "server/catalog/job.h"
#include "server/storage/store.h"

struct task_files {
    char task[24]; /* as `whittle tiles work` takes it */
    char *names;   /* "plan.0=4,points.7=5": which each will be; owned */
    int *fd;       /* owned, open */
    size_t count, room;
};

/* Opens what the job's task reads; task_files_close takes a zeroed one.  STATUS_IO where it isn't there, or its store
 * is away; STATUS_NO_MEMORY. */
enum status task_files_open(struct task_files *files, struct store *store, const struct job *job,
                            struct error *error) MUST_CHECK;
void task_files_close(struct task_files *files);

/* Whether the job, in tiles or not, has come to what its client asked for. */
bool task_makes_outputs(const struct job *job);

/* Whether it is a tile's task: that doesn't read the cloud. */
bool task_is_tile(const struct job *job);

/* Whether its tiles may say which points have gone, too. */
bool task_tells_gone(const struct job *job);

/* How far the job is when its task is so far; of tiles that run beside each other the one that is farthest counts. */
double task_fraction(const struct job *job, double fraction);

#endif
