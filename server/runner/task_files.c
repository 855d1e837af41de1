/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/runner/task_files.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/tiles/fit.h"
#include "server/runner/spawn.h"

static const double PLAN_SHARE = 0.3, RUN_SHARE = 0.85; /* of the whole, at whose end each is */

bool task_is_tile(const struct job *job) {
    return job->tiles > 0 && job->task > JOB_TASK_PLAN && job->task <= job->tiles;
}

bool task_makes_outputs(const struct job *job) { return !job->tiles || (job->tiles > 0 && job->task > job->tiles); }

bool task_tells_gone(const struct job *job) { return fit_tells_gone(&job->params); }

double task_fraction(const struct job *job, double fraction) {
    if (!job->tiles) return fraction;
    if (job->task == JOB_TASK_PLAN) return PLAN_SHARE * fraction;
    if (task_makes_outputs(job)) return RUN_SHARE + (1 - RUN_SHARE) * fraction;
    return PLAN_SHARE + (RUN_SHARE - PLAN_SHARE) * ((double)job->tiles_done + fraction) / (double)job->tiles;
}

/* ------------------------------------------------------------------------------------------------ files */

static enum status no_memory(struct error *error) {
    return error_set(error, STATUS_NO_MEMORY, "worker", "no memory for the files of a task");
}

static enum status add_file(struct task_files *files, FILE *names, struct store *store, const struct job *job,
                            const char *name, int64_t number, bool is_optional, struct error *error) {
    char blob[64];
    if (files->count == files->room) {
        size_t room = files->room ? 2 * files->room : 64;
        int *fd = realloc(files->fd, room * sizeof *fd);
        if (!fd) return no_memory(error);
        files->fd = fd;
        files->room = room;
    }
    snprintf(blob, sizeof blob, strcmp(name, "plan") == 0 ? "%s" : "%s.%lld", name, (long long)number);
    int fd = store_tiles_open(store, job->id, blob);
    if (fd < 0 && errno == ENOENT && is_optional) return STATUS_OK;
    if (fd < 0) return error_set(error, STATUS_IO, "worker", "can't open %s of the job: %s", blob, strerror(errno));
    files->fd[files->count] = fd;
    fprintf(names, "%s%s.%lld=%zu", files->count ? "," : "", name, (long long)number, SPAWN_FIRST_FILE + files->count);
    files->count++;
    return STATUS_OK;
}

/* The line of `around` for a tile; returns new, NULL where there is none. */
static char *line_of(struct store *store, const struct job *job, int64_t tile) {
    int fd = store_tiles_open(store, job->id, "around");
    FILE *around = fd >= 0 ? fdopen(fd, "r") : NULL;
    char *line = NULL;
    size_t room = 0;
    bool found = around != NULL;
    if (fd >= 0 && !around) close(fd);
    for (int64_t t = 0; found && t <= tile; t++) found = getline(&line, &room, around) > 0;
    if (around) fclose(around);
    if (found) return line;
    free(line);
    return NULL;
}

/* Another process has written the line: a number that is no tile's is none. */
static enum status add_around(struct task_files *files, FILE *names, struct store *store, const struct job *job,
                              struct error *error) {
    char *line = line_of(store, job, job->task - 1), *end = line;
    enum status status =
        line ? STATUS_OK
             : error_set(error, STATUS_IO, "worker", "can't read what lies around tile %lld", (long long)job->task - 1);
    int64_t before = -1;
    for (char *at = line; status == STATUS_OK; at = end) {
        long long t = strtoll(at, &end, 10);
        if (end == at) break;
        if (t > before && t < job->tiles) status = add_file(files, names, store, job, "points", t, false, error);
        before = t > before ? t : before;
    }
    free(line);
    return status;
}

static enum status add_all(struct task_files *files, FILE *names, struct store *store, const struct job *job,
                           struct error *error) {
    enum status status = STATUS_OK;
    for (int64_t t = 0; status == STATUS_OK && t < job->tiles; t++) {
        status = add_file(files, names, store, job, "points", t, false, error);
        if (status == STATUS_OK) status = add_file(files, names, store, job, "left", t, false, error);
        if (status == STATUS_OK && task_tells_gone(job))
            status = add_file(files, names, store, job, "gone", t, true, error);
    }
    return status;
}

enum status task_files_open(struct task_files *files, struct store *store, const struct job *job, struct error *error) {
    size_t bytes;
    *files = (struct task_files){0};
    FILE *names = open_memstream(&files->names, &bytes);
    if (!names) return no_memory(error);
    enum status status = STATUS_OK;
    snprintf(files->task, sizeof files->task, "plan");
    if (job->task != JOB_TASK_PLAN) status = add_file(files, names, store, job, "plan", 0, false, error);
    if (task_is_tile(job)) {
        snprintf(files->task, sizeof files->task, "%lld", (long long)job->task - 1);
        if (status == STATUS_OK) status = add_around(files, names, store, job, error);
    } else if (job->task != JOB_TASK_PLAN) {
        snprintf(files->task, sizeof files->task, "merge");
        if (status == STATUS_OK) status = add_all(files, names, store, job, error);
    }
    if (!files->count) fputs("none", names);
    if (fclose(names) != 0 && status == STATUS_OK) status = no_memory(error);
    if (status != STATUS_OK) task_files_close(files);
    return status;
}

void task_files_close(struct task_files *files) {
    for (size_t i = 0; i < files->count; i++) close(files->fd[i]);
    free(files->fd);
    free(files->names);
    *files = (struct task_files){0};
}
