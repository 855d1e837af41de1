/* One fault, armed from the command line: the crash campaign ends the service at each of these points in turn.
 *
 *     upload-open -write -sync -rename -folder-sync       a body on its way to being a cloud
 *     submit-kept -committed                              the cloud has its name; the job's row is there too
 *     claimed started                                     a job is running for the queue; its process exists
 *     outputs-begin, output-open -sync,                   outputs on their way to being visible
 *     outputs-rename -folder-sync -kept, job-recorded     ... and the end's row
 *     delete-committed, remove-rename removed             the row is gone; the name is; the files are
 *     commit                                              any change of the database
 *     database-open -read -write -sync -truncate -map     the database's own files (sql_faults.c)
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/daemon_fault.h"

#include <errno.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/fault.h"

enum { KILL = -1, HANG = -2 };

static const struct {
    const char *name;
    int number;
} actions[] = {{"kill", KILL}, {"hang", HANG},     {"enospc", ENOSPC},
               {"eio", EIO},   {"emfile", EMFILE}, {"enomem", ENOMEM}};
enum { ACTIONS = sizeof actions / sizeof actions[0] };

/* Written once, before there are other threads. */
static char armed_point[64];
static int armed_number;
static long first_pass = 1, last_pass;
static atomic_long passes;

static int ask(const char *point) {
    if (strcmp(point, armed_point) != 0) return 0;
    long pass = atomic_fetch_add(&passes, 1) + 1;
    if (pass < first_pass || pass > last_pass) return 0;
    if (armed_number == KILL) raise(SIGKILL);
    while (armed_number == HANG) pause();
    return armed_number;
}

enum status fault_arm(const char *text, struct error *error) {
    char action[16] = "";
    size_t i = 0;
    if (!text[0]) return STATUS_OK;
    int found = sscanf(text, "%63[a-z-]=%15[a-z]:%ld-%ld", armed_point, action, &first_pass, &last_pass);
    if (found < 4) last_pass = first_pass;
    while (i < ACTIONS && strcmp(actions[i].name, action) != 0) i++;
    if (found < 2 || i == ACTIONS || first_pass < 1 || last_pass < first_pass)
        return error_set(error, STATUS_BAD_PARAMETER, "fault", "'%.80s' is not like POINT=ACTION:N", text);
    armed_number = actions[i].number;
    fault_ask = ask;
    return STATUS_OK;
}
