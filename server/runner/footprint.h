/* What a job's process has taken of what no limit of the kernel's bounds everywhere: threads, files, bytes in their
 * sum; and whether it has left what it was asked for.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_RUNNER_FOOTPRINT_H
#define WHITTLE_SERVER_RUNNER_FOOTPRINT_H

#include <stdbool.h>
#include <stdint.h>
#include <sys/types.h>

#include "core/base/status.h"
#include "core/params.h"
#include "server/catalog/job.h"

struct footprint {
    uint64_t threads, files; /* files: in its folder, whatever they are */
    uint64_t written_bytes;  /* since it began, to files that are gone too; where the kernel doesn't count them, what
                                its folder takes on the disk */
};

/* The most that a job with these parameters and so many threads may take. */
struct footprint footprint_most(const struct params *params, uint64_t threads, uint64_t written_bytes);

/* Looks at a process that hasn't been reaped, and at its folder.  What can't be found out is 0.  Stops counting files
 * at files_most + 1. */
struct footprint footprint_of(pid_t pid, const char *folder, uint64_t files_most);

/* Whether the folder of a process that said it was done holds the files that its parameters ask for and nothing else,
 * hidden ones included: each a file with this one name, and not empty.  What belonged to the account of the jobs
 * becomes ours.  STATUS_ENGINE with a text for the client. */
enum status footprint_check(const char *folder, const struct params *params, struct error *error) MUST_CHECK;

/* The same of a task of a job in tiles: of a plan also into how many it has cut the cloud.  may_have_gone: a tile may
 * also say what it hasn't left. */
enum status footprint_check_task(const char *folder, int64_t task, bool may_have_gone, int64_t *tiles,
                                 struct error *error) MUST_CHECK;

/* The most that a task may take, of a plan for instance a file for each tile twice. */
struct footprint footprint_most_of_task(const struct params *params, uint64_t threads, uint64_t written_bytes);

#endif
