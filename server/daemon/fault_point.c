/* Faults, armed from the command line: the crash campaign ends the service at each of these points in turn.
 *
 *     upload-open -write -sync, rename-clouds sync-clouds a body on its way to being a cloud
 *     submit-kept -committed                              the cloud has its name; the job's row is there too
 *     batch-prepared -committed                           what a batch of jobs needs is there; their rows are too
 *     claimed started                                     a job is running for the queue; its process exists
 *     keeper-forked worker-forked                         in the process that forks both: one is there, both are
 *     outputs-begin, output-open -sync,                   outputs on their way to being visible
 *     rename-jobs sync-jobs outputs-kept, job-recorded    ... and the end's row
 *     piece-kept                                          a piece of an upload is a blob, and has no row
 *     delete-committed, remove-rename removed             the row is gone; the name is; the files are
 *     commit                                              any change of the database
 *     database-open -read -write -sync -truncate -map     the database's own files (sql_faults.c)
 *     blobs-request                                       a request to an S3 store
 *     scratch                                             a file that shows whether the disk takes any
 *     seccomp landlock landlock-newer namespaces          what confines jobs, as if the kernel hadn't it (=enosys);
 *     pid-namespace                                       landlock-newer: what came after version 2 of it
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/daemon/fault_point.h"

#include <errno.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/base/fault.h"

enum { KILL = -1, HANG = -2 };

static const struct {
    const char *name;
    int number;
} actions[] = {{"kill", KILL},     {"hang", HANG},     {"enospc", ENOSPC}, {"eio", EIO},
               {"emfile", EMFILE}, {"enomem", ENOMEM}, {"enosys", ENOSYS}, {"erofs", EROFS}};
enum { ACTIONS = sizeof actions / sizeof actions[0] };

enum { MOST_FAULTS = 4 };

struct armed {
    char point[64];
    int number;
    long first_pass, last_pass;
    atomic_long passes;
};

/* Written once, before there are other threads. */
static struct armed armed[MOST_FAULTS];

static int pass(struct armed *fault) {
    long passes = atomic_fetch_add(&fault->passes, 1) + 1;
    if (passes < fault->first_pass || passes > fault->last_pass) return 0;
    if (fault->number == KILL) raise(SIGKILL);
    while (fault->number == HANG) pause();
    return fault->number;
}

static int ask_fault(const char *point) {
    for (size_t i = 0; i < MOST_FAULTS; i++)
        if (strcmp(point, armed[i].point) == 0) return pass(&armed[i]);
    return 0;
}

static bool read_fault(const char *text, struct armed *fault) {
    char action[16] = "";
    size_t i = 0;
    fault->first_pass = 1;
    int found = sscanf(text, "%63[a-z-]=%15[a-z]:%ld-%ld", fault->point, action, &fault->first_pass, &fault->last_pass);
    if (found < 4) fault->last_pass = fault->first_pass;
    while (i < ACTIONS && strcmp(actions[i].name, action) != 0) i++;
    if (found < 2 || i == ACTIONS || fault->first_pass < 1 || fault->last_pass < fault->first_pass) return false;
    fault->number = actions[i].number;
    return true;
}

enum status fault_arm(const char *text, struct error *error) {
    size_t count = 0;
    for (const char *at = text; *at; at += *at == ',') {
        if (count == MOST_FAULTS || !read_fault(at, &armed[count++]))
            return error_set(error, STATUS_BAD_PARAMETER, "fault", "'%.80s' is not like POINT=ACTION:N", at);
        at += strcspn(at, ",");
    }
    if (count) fault_point = ask_fault;
    return STATUS_OK;
}
