/* The copy of the usage table: a list under a lock.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/sqlite/usage.h"

#include <pthread.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "server/catalog/job.h"

struct row {
    char principal[JOB_PRINCIPAL_BYTES];
    struct catalog_usage figures;
};

struct usage {
    pthread_mutex_t lock;
    struct row *row;
    size_t count, room;
};

struct usage *usage_new(void) {
    struct usage *usage = calloc(1, sizeof *usage);
    if (usage) pthread_mutex_init(&usage->lock, NULL);
    return usage;
}

void usage_free(struct usage *usage) {
    if (!usage) return;
    pthread_mutex_destroy(&usage->lock);
    free(usage->row);
    free(usage);
}

static struct row *find(const struct usage *usage, const char *principal) {
    for (size_t i = 0; i < usage->count; i++)
        if (strcmp(usage->row[i].principal, principal) == 0) return &usage->row[i];
    return NULL;
}

/* The principal's row, made where there is none; NULL when memory runs out. */
static struct row *find_or_add(struct usage *usage, const char *principal) {
    struct row *row = find(usage, principal);
    if (row) return row;
    if (usage->count == usage->room) {
        size_t room = usage->room ? 2 * usage->room : 8;
        struct row *grown = reallocarray(usage->row, room, sizeof *grown);
        if (!grown) return NULL;
        usage->row = grown;
        usage->room = room;
    }
    row = &usage->row[usage->count++];
    *row = (struct row){0};
    memcpy(row->principal, principal, strlen(principal) + 1);
    return row;
}

static bool put_usage(struct usage *usage, const char *principal, struct catalog_usage figures) {
    pthread_mutex_lock(&usage->lock);
    struct row *row = find_or_add(usage, principal);
    if (row) {
        figures.reserved = row->figures.reserved;
        row->figures = figures;
    }
    pthread_mutex_unlock(&usage->lock);
    return row != NULL;
}

static uint64_t count_of(struct sql_rows *rows, int column) {
    int64_t value = sql_integer(rows, column);
    return value > 0 ? (uint64_t)value : 0;
}

enum status usage_refresh(struct usage *usage, struct sql *sql, const char *principal, struct error *error) {
    struct sql_rows *rows;
    bool kept = true;
    enum status status =
        sql_select(sql, "SELECT principal, active, bytes FROM usage WHERE ?1 IS NULL OR principal = ?1",
                   VALUES(T(principal)), &rows, error);
    if (status != STATUS_OK) return status;
    while (kept && sql_next(rows)) {
        char name[JOB_PRINCIPAL_BYTES];
        sql_copy_text(rows, 0, name, sizeof name);
        kept = put_usage(usage, name, (struct catalog_usage){.active = count_of(rows, 1), .bytes = count_of(rows, 2)});
    }
    status = sql_finish(rows, error);
    return kept ? status : error_set(error, STATUS_NO_MEMORY, "usage", "no memory");
}

enum status usage_reserve(struct usage *usage, const char *principal, uint64_t bytes, uint64_t limit,
                          struct error *error) {
    pthread_mutex_lock(&usage->lock);
    struct row *row = find_or_add(usage, principal);
    uint64_t has = row ? row->figures.bytes + row->figures.reserved : 0;
    bool fits = !limit || (has <= limit && bytes <= limit - has);
    if (row && fits) row->figures.reserved += bytes;
    pthread_mutex_unlock(&usage->lock);
    if (!row) return error_set(error, STATUS_NO_MEMORY, "usage", "no memory");
    return fits ? STATUS_OK
                : error_set(error, STATUS_LIMIT, "principal_bytes", "%llu bytes are kept for you, %llu may be",
                            (unsigned long long)has, (unsigned long long)limit);
}

void usage_release(struct usage *usage, const char *principal, uint64_t bytes) {
    pthread_mutex_lock(&usage->lock);
    struct row *row = find(usage, principal);
    if (row) row->figures.reserved -= bytes;
    pthread_mutex_unlock(&usage->lock);
}

struct catalog_usage usage_of(struct usage *usage, const char *principal) {
    pthread_mutex_lock(&usage->lock);
    const struct row *row = find(usage, principal);
    struct catalog_usage figures = row ? row->figures : (struct catalog_usage){0};
    pthread_mutex_unlock(&usage->lock);
    return figures;
}
