/* Jobs: the transition table, ids, and parameters as stored text.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/job.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "server/base/random.h"
#include "server/base/wall_clock.h"

static const char *const names[JOB_STATE_COUNT] = {"accepted", "running", "successful", "failed", "dismissed"};

/* Each event happens in one state, and leads to one. */
static const struct {
    enum job_state from, next;
} transitions[JOB_EVENT_COUNT] = {
    [JOB_CLAIM] = {JOB_ACCEPTED, JOB_RUNNING},      [JOB_DONE] = {JOB_RUNNING, JOB_SUCCESSFUL},
    [JOB_FAIL] = {JOB_RUNNING, JOB_FAILED},         [JOB_DISMISS] = {JOB_RUNNING, JOB_DISMISSED},
    [JOB_REQUEUE] = {JOB_RUNNING, JOB_ACCEPTED},    [JOB_REUSE] = {JOB_ACCEPTED, JOB_SUCCESSFUL},
    [JOB_WITHDRAW] = {JOB_ACCEPTED, JOB_DISMISSED},
};

void job_done(struct job *job) {
    free(job->report);
    free(job->problem);
    memset(job, 0, sizeof *job);
}

const char *job_state_name(enum job_state state) { return names[state]; }

bool job_state_from_name(const char *name, enum job_state *state) {
    for (int i = 0; i < JOB_STATE_COUNT; i++) {
        if (strcmp(names[i], name) != 0) continue;
        *state = (enum job_state)i;
        return true;
    }
    return false;
}

bool job_transition(enum job_state state, enum job_event event, enum job_state *next) {
    if (transitions[event].from != state) return false;
    *next = transitions[event].next;
    return true;
}

void job_become_task(struct job *job, const struct job *task) {
    job->task = task->task;
    job->attempt = task->attempt;
    memcpy(job->owner, task->owner, sizeof job->owner);
    job->lease_end_ms = task->lease_end_ms;
    job->failures = task->failures;
    job->interruptions = task->interruptions;
}

enum job_step job_step_of(const struct job *job, enum job_event event, enum job_state *next) {
    *next = event == JOB_DONE ? JOB_SUCCESSFUL : event == JOB_FAIL ? JOB_FAILED : JOB_DISMISSED;
    if (event == JOB_REQUEUE) return job->task == JOB_TASK_NONE ? JOB_STEP_RESTART : JOB_STEP_AGAIN;
    if (event != JOB_DONE || job->task > job->tiles) return JOB_STEP_END;
    return job->task == JOB_TASK_PLAN ? JOB_STEP_PLANNED : JOB_STEP_TILE;
}

bool job_ended(enum job_state state) { return state != JOB_ACCEPTED && state != JOB_RUNNING; }

/* ------------------------------------------------------------------------------------------------ ids */

void job_new_id(const struct timespec *now, char id[JOB_ID_BYTES]) {
    uint64_t ms = (uint64_t)now->tv_sec * 1000 + (uint64_t)now->tv_nsec / 1000000, random = 0;
    uint64_t fraction = (uint64_t)(now->tv_nsec % 1000000) * 4096 / 1000000;
    random_fill(&random, sizeof random);
    snprintf(id, JOB_ID_BYTES, "%08x-%04x-7%03x-%04x-%012llx", (unsigned)(ms >> 16), (unsigned)(ms & 0xffff),
             (unsigned)(fraction & 0xfff), (unsigned)(0x8000 | (random >> 48 & 0x3fff)),
             (unsigned long long)(random & 0xffffffffffff));
}

void job_another_id(char id[JOB_ID_BYTES]) {
    enum { RANDOM_AT = 18 };
    uint64_t random = 0;
    random_fill(&random, sizeof random);
    snprintf(id + RANDOM_AT, JOB_ID_BYTES - RANDOM_AT, "-%04x-%012llx", (unsigned)(0x8000 | (random >> 48 & 0x3fff)),
             (unsigned long long)(random & 0xffffffffffff));
}

bool job_id_valid(const char *text) {
    static const char shape[] = "xxxxxxxx-xxxx-xxxx-xxxx-xxxxxxxxxxxx";
    if (strlen(text) != sizeof shape - 1) return false;
    for (size_t i = 0; shape[i]; i++)
        if (shape[i] == '-' ? text[i] != '-' : !strchr("0123456789abcdef", text[i])) return false;
    return true;
}

/* ------------------------------------------------------------------------------------------------ parameters */

enum { VALUE_BYTES = PARAMS_TEXT_BYTES };

static void print_params(FILE *out, const struct params *params, bool all) {
    size_t count;
    const struct param *table = params_table(&count);
    for (size_t i = 0; i < count; i++) {
        char value[VALUE_BYTES];
        if (!all && !table[i].affects_result) continue;
        params_format(params, &table[i], value, sizeof value);
        if (value[0]) fprintf(out, "%s=%s\n", table[i].name, value);
    }
}

/* The text, if all of it was written. */
static char *close_text(FILE *out, char **text) {
    if (fclose(out) == 0) return *text;
    free(*text);
    return NULL;
}

char *job_params_text(const struct params *params) {
    size_t bytes;
    char *text = NULL;
    FILE *out = open_memstream(&text, &bytes);
    if (!out) return NULL;
    print_params(out, params, true);
    return close_text(out, &text);
}

/* What follows this in a line of the text is a list of names, with commas. */
static const char given_line[] = "given=";

char *job_params_stored(const struct params *params) {
    size_t bytes, count;
    char *text = NULL;
    FILE *out = open_memstream(&text, &bytes);
    const struct param *table = params_table(&count);
    struct params defaults;
    if (!out) return NULL;
    print_params(out, params, true);
    fputs(given_line, out);
    params_defaults(&defaults);
    for (size_t i = 0, given = 0; i < count; i++) {
        char value[VALUE_BYTES], usual[VALUE_BYTES];
        params_format(params, &table[i], value, sizeof value);
        params_format(&defaults, &table[i], usual, sizeof usual);
        if (strcmp(value, usual) != 0) fprintf(out, "%s%s", given++ ? "," : "", table[i].name);
    }
    fputs("\n", out);
    return close_text(out, &text);
}

/* The list of names of a stored text; NULL: an earlier program has stored it. */
static const char *find_given(const char *text) {
    for (; text && *text; text = strchr(text, '\n'), text += text != NULL)
        if (strncmp(text, given_line, strlen(given_line)) == 0) return text + strlen(given_line);
    return NULL;
}

static bool is_given(const char *given, const char *name) {
    size_t length = strlen(name), end = given ? strcspn(given, "\n") : 0;
    for (size_t i = 0, n; i < end; i += n + 1) {
        n = strcspn(given + i, ",\n");
        if (n == length && strncmp(given + i, name, n) == 0) return true;
    }
    return false;
}

char *job_result_text(const struct job *job, const char *version) {
    size_t bytes;
    char *text = NULL;
    FILE *out = open_memstream(&text, &bytes);
    if (!out) return NULL;
    fprintf(out, "%s\n%s\n", version, job->cloud);
    print_params(out, &job->params, false);
    if (job->tiles) fprintf(out, "tiles within %llu\n", (unsigned long long)job->memory_bytes);
    return close_text(out, &text);
}

bool job_params_read(const char *text, struct params *params) {
    const char *given = find_given(text);
    bool is_known = true;
    params_defaults(params);
    char line[VALUE_BYTES + 64];
    for (; *text; text += strcspn(text, "\n"), text += *text == '\n') {
        size_t length = strcspn(text, "\n");
        if (length >= sizeof line) continue;
        memcpy(line, text, length);
        line[length] = 0;
        char *equals = strchr(line, '=');
        if (!equals) continue;
        *equals = 0;
        if (params_set(params, line, equals + 1, NULL) == STATUS_OK) continue;
        /* Of an older or a newer program: the default stands. */
        if (params_find(line) ? given != NULL : is_given(given, line)) is_known = false;
    }
    memset(params->alias, 0, sizeof params->alias); /* they were resolved before they were written */
    return is_known;
}

int64_t job_now_ms(void) { return wall_clock_now_ms(); }

const char *job_time_text(int64_t ms, char text[JOB_TIME_BYTES]) {
    time_t seconds = (time_t)(ms / 1000);
    struct tm tm;
    gmtime_r(&seconds, &tm);
    size_t used = strftime(text, JOB_TIME_BYTES, "%Y-%m-%dT%H:%M:%S", &tm);
    snprintf(text + used, JOB_TIME_BYTES - used, ".%03uZ", (unsigned)(ms % 1000) % 1000);
    return text;
}
