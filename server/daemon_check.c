/* The offline check: database against files, in both directions.
 *
 *     damaged: ...       content is missing or not what its hash says, or the database is broken; exit status 1
 *     unfinished: ...    what a crash leaves and the next start mends: running jobs, files without rows
 *
 * Every cloud and every output that a row names is read and hashed, so it takes as long as reading all of the folder.
 * It asks the tables by SQL of its own, with columns that every version of the schema has, so that it can look at what
 * an older or a broken service left.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/check.h"
#include "server/config.h"
#include "server/digest.h"
#include "server/job.h"
#include "server/schema.h"
#include "server/sql.h"
#include "server/store.h"

enum { WHOLE = 0, DAMAGED = 1 };

struct check {
    struct store *store;
    struct sql *sql;
    int64_t cloud_tables; /* 1 where the database is new enough to have one */
    size_t jobs, clouds, outputs, damaged, unfinished;
};

static void tell(const char *kind, const char *format, va_list args) {
    printf("%s: ", kind);
    vprintf(format, args);
    putchar('\n');
}

__attribute__((format(printf, 2, 3))) static void damaged(struct check *check, const char *format, ...) {
    va_list args;
    va_start(args, format);
    tell("damaged", format, args);
    va_end(args);
    check->damaged++;
}

__attribute__((format(printf, 2, 3))) static void unfinished(struct check *check, const char *format, ...) {
    va_list args;
    va_start(args, format);
    tell("unfinished", format, args);
    va_end(args);
    check->unfinished++;
}

/* ------------------------------------------------------------------------------------------------ rows */

/* Calls look for each row; what the database refuses is damage. */
static void each_row(struct check *check, const char *text, void (*look)(struct check *check, struct sql_rows *rows)) {
    struct error error = {0};
    struct sql_rows *rows;
    enum status status = sql_select(check->sql, text, NULL, 0, &rows, &error);
    while (status == STATUS_OK && sql_next(rows)) look(check, rows);
    if (status == STATUS_OK) status = sql_finish(rows, &error);
    if (status != STATUS_OK) damaged(check, "%s", error.text);
}

static void look_at_integrity(struct check *check, struct sql_rows *rows) {
    if (strcmp(sql_text(rows, 0), "ok") != 0) damaged(check, "database: %s", sql_text(rows, 0));
}

/* Compares an open file with what is known of it; bytes UINT64_MAX: its hash alone. */
static void look_at_file(struct check *check, int fd, const char *name, uint64_t bytes, const char *sha256) {
    char found[DIGEST_HEX_BYTES];
    uint64_t length;
    if (fd < 0)
        damaged(check, "%s is missing", name);
    else if (digest_file(fd, found, &length) != 0)
        damaged(check, "%s can't be read", name);
    else if (bytes != UINT64_MAX && length != bytes)
        damaged(check, "%s has %llu bytes, not %llu", name, (unsigned long long)length, (unsigned long long)bytes);
    else if (strcmp(found, sha256) != 0)
        damaged(check, "%s has the hash %s", name, found);
    if (fd >= 0) close(fd);
}

static void look_at_cloud(struct check *check, struct sql_rows *rows) {
    char name[JOB_HASH_BYTES + 16];
    const char *sha256 = sql_text(rows, 0);
    check->clouds++;
    snprintf(name, sizeof name, "clouds/%.64s", sha256);
    look_at_file(check, store_cloud_open(check->store, sha256), name, UINT64_MAX, sha256);
}

static void look_at_output(struct check *check, struct sql_rows *rows) {
    char name[JOB_ID_BYTES + JOB_OUTPUT_NAME_BYTES + 32];
    const char *id = sql_text(rows, 0), *output = sql_text(rows, 1);
    check->outputs++;
    snprintf(name, sizeof name, "jobs/%.40s/outputs/%.60s", id, output);
    look_at_file(check, store_output_open(check->store, id, output), name, (uint64_t)sql_integer(rows, 2),
                 sql_text(rows, 3));
}

static void look_at_job(struct check *check, struct sql_rows *rows) {
    const char *id = sql_text(rows, 0);
    int64_t state = sql_integer(rows, 1), outputs = sql_integer(rows, 2);
    check->jobs++;
    if (!job_id_valid(id)) damaged(check, "'%.60s' is no job's id", id);
    if (state < 0 || state >= JOB_STATE_COUNT) damaged(check, "job %s has no state %lld", id, (long long)state);
    if (state == JOB_RUNNING) unfinished(check, "job %s was running; it will be queued again", id);
    if (state == JOB_SUCCESSFUL && !outputs) damaged(check, "job %s is successful and has no outputs", id);
    if (state != JOB_SUCCESSFUL && outputs) damaged(check, "job %s has outputs and is not successful", id);
    int there = state == JOB_SUCCESSFUL ? store_outputs_count(check->store, id) : -1;
    if (there > outputs) damaged(check, "jobs/%s/outputs has %d files, not %lld", id, there, (long long)outputs);
    if (state != JOB_SUCCESSFUL && store_outputs_exist(check->store, id))
        unfinished(check, "jobs/%s/outputs are of a run whose end was not recorded", id);
}

/* ------------------------------------------------------------------------------------------------ files */

/* Without and with the table of clouds. */
static const char *const all_clouds[] = {"SELECT DISTINCT cloud FROM jobs ORDER BY 1",
                                         "SELECT cloud FROM jobs UNION SELECT sha256 FROM clouds ORDER BY 1"};
static const char *const cloud_uses[] = {
    "SELECT count(*) FROM jobs WHERE cloud = ?1",
    "SELECT (SELECT count(*) FROM jobs WHERE cloud = ?1) + (SELECT count(*) FROM clouds WHERE sha256 = ?1)"};

static void look_at_name(struct check *check, const char *sql, const char *folder, const char *name) {
    struct error error = {0};
    int64_t uses = 0;
    if (sql_number(check->sql, sql, VALUES(T(name)), &uses, &error) != STATUS_OK)
        damaged(check, "%s", error.text);
    else if (!uses)
        unfinished(check, "%s/%s belongs to nothing", folder, name);
}

static void look_at_thing(void *ctx, enum store_thing thing, const char *name) {
    struct check *check = ctx;
    switch (thing) {
    case STORE_CLOUD: look_at_name(check, cloud_uses[check->cloud_tables], "clouds", name); break;
    case STORE_JOB: look_at_name(check, "SELECT count(*) FROM jobs WHERE id = ?1", "jobs", name); break;
    case STORE_PART: look_at_name(check, "SELECT count(*) FROM uploads WHERE id = ?1", "uploads", name); break;
    case STORE_TEMPORARY: unfinished(check, "tmp/%s is half written, or half removed", name); break;
    }
}

/* ------------------------------------------------------------------------------------------------ the whole */

static void look_at_schema(struct check *check) {
    struct error error = {0};
    int64_t version = 0;
    if (sql_number(check->sql, "PRAGMA user_version", NULL, 0, &version, &error) != STATUS_OK)
        damaged(check, "%s", error.text);
    else if (version > schema_version())
        damaged(check, "the database has schema %lld, this program knows %d", (long long)version, schema_version());
    else if (version < schema_version())
        unfinished(check, "the database has schema %lld; the next start makes it %d", (long long)version,
                   schema_version());
    if (sql_number(check->sql, "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = 'clouds'", NULL, 0,
                   &check->cloud_tables, &error) != STATUS_OK)
        damaged(check, "%s", error.text);
}

static void look_at_everything(struct check *check) {
    struct error error = {0};
    each_row(check, "PRAGMA integrity_check", look_at_integrity);
    look_at_schema(check);
    each_row(check, "SELECT id, state, (SELECT count(*) FROM outputs WHERE job = id) FROM jobs ORDER BY id",
             look_at_job);
    each_row(check, all_clouds[check->cloud_tables], look_at_cloud);
    each_row(check, "SELECT job, name, bytes, sha256 FROM outputs ORDER BY job, position", look_at_output);
    each_row(check, "SELECT 'outputs of no job, ' || job FROM outputs WHERE job NOT IN (SELECT id FROM jobs)",
             look_at_integrity);
    if (store_each(check->store, look_at_thing, check, &error) != STATUS_OK) damaged(check, "%s", error.text);
}

static enum status open_folder(const char *folder, struct check *check, struct error *error) {
    char path[STORE_PATH_BYTES];
    snprintf(path, sizeof path, "%.4000s/whittled.db", folder);
    if (access(path, F_OK) != 0) return error_set(error, STATUS_IO, "check", "there is no %s", path);
    enum status status = store_open(folder, &check->store, error);
    return status == STATUS_OK ? sql_open(path, &check->sql, error) : status;
}

int check_main(int argc, char **argv) {
    struct check check = {0};
    struct config config;
    struct error error = {0};
    enum config_request request = config_read(&config, argc, argv, environ, &error);
    if (request == CONFIG_TOLD) return WHOLE;
    enum status status = request == CONFIG_RUN ? open_folder(config.data, &check, &error) : error.code;
    if (status == STATUS_OK) {
        look_at_everything(&check);
        printf("checked %zu jobs, %zu clouds, %zu outputs: %zu damaged, %zu unfinished\n", check.jobs, check.clouds,
               check.outputs, check.damaged, check.unfinished);
    } else {
        fprintf(stderr, "whittled: %s: %s\n", error.where, error.text);
    }
    sql_close(check.sql);
    store_close(check.store);
    return status == STATUS_OK && !check.damaged ? WHOLE : DAMAGED;
}
