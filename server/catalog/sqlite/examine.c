/* What the offline check asks, of a database of any version: with columns that every version of the schema has.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <string.h>

#include "server/catalog/sqlite/catalog_sqlite.h"
#include "server/catalog/sqlite/schema.h"

struct examination {
    const struct catalog_examiner *examiner;
    struct sql *db;
};

/* Calls look for each row; what the database refuses is damage. */
static void each_row(const struct examination *e, const char *text,
                     void (*look)(const struct catalog_examiner *examiner, struct sql_rows *rows)) {
    struct error error = {0};
    struct sql_rows *rows;
    enum status status = sql_select(e->db, text, NULL, 0, &rows, &error);
    while (status == STATUS_OK && sql_next(rows)) look(e->examiner, rows);
    if (status == STATUS_OK) status = sql_finish(rows, &error);
    if (status != STATUS_OK) e->examiner->damaged(e->examiner->ctx, error.text);
}

static void look_at_integrity(const struct catalog_examiner *examiner, struct sql_rows *rows) {
    char text[400];
    snprintf(text, sizeof text, "database: %.380s", sql_text(rows, 0));
    if (strcmp(sql_text(rows, 0), "ok") != 0) examiner->damaged(examiner->ctx, text);
}

static void look_at_job(const struct catalog_examiner *examiner, struct sql_rows *rows) {
    examiner->job(examiner->ctx, sql_text(rows, 0), (int)sql_integer(rows, 1), sql_integer(rows, 2),
                  (uint64_t)sql_integer(rows, 3));
}

static void look_at_cloud(const struct catalog_examiner *examiner, struct sql_rows *rows) {
    examiner->cloud(examiner->ctx, sql_text(rows, 0));
}

static void look_at_output(const struct catalog_examiner *examiner, struct sql_rows *rows) {
    struct job_output output = {.bytes = (uint64_t)sql_integer(rows, 2)};
    sql_copy_text(rows, 1, output.name, sizeof output.name);
    sql_copy_text(rows, 3, output.sha256, sizeof output.sha256);
    examiner->output(examiner->ctx, sql_text(rows, 0), (int)sql_integer(rows, 4), &output);
}

static void look_at_schema(const struct examination *e) {
    const struct catalog_examiner *examiner = e->examiner;
    struct error error = {0};
    char text[120];
    int64_t version = 0;
    enum status status = sql_number(e->db, "PRAGMA user_version", NULL, 0, &version, &error);
    snprintf(text, sizeof text,
             version > schema_version() ? "the database has schema %lld, this program knows %d"
                                        : "the database has schema %lld; the next start makes it %d",
             (long long)version, schema_version());
    if (status != STATUS_OK)
        examiner->damaged(examiner->ctx, error.text);
    else if (version > schema_version())
        examiner->damaged(examiner->ctx, text);
    else if (version < schema_version())
        examiner->unfinished(examiner->ctx, text);
}

static enum status has_table(struct sql *db, const char *name, int64_t *tables, struct error *error) {
    return sql_number(db, "SELECT count(*) FROM sqlite_master WHERE type = 'table' AND name = ?1", VALUES(T(name)),
                      tables, error);
}

void catalog_sqlite_examine(struct catalog *catalog, const struct catalog_examiner *examiner) {
    struct examination e = {examiner, catalog_sqlite_of(catalog)->reader};
    struct error error = {0};
    int64_t has_clouds = 0;
    each_row(&e, "PRAGMA integrity_check", look_at_integrity);
    look_at_schema(&e);
    if (has_table(e.db, "clouds", &has_clouds, &error) != STATUS_OK) examiner->damaged(examiner->ctx, error.text);
    each_row(&e, "SELECT id, attempt, state, (SELECT count(*) FROM outputs WHERE job = id) FROM jobs ORDER BY id",
             look_at_job);
    each_row(&e,
             has_clouds ? "SELECT cloud FROM jobs UNION SELECT sha256 FROM clouds ORDER BY 1"
                        : "SELECT DISTINCT cloud FROM jobs ORDER BY 1",
             look_at_cloud);
    each_row(&e,
             "SELECT job, name, bytes, sha256, (SELECT attempt FROM jobs WHERE id = job) FROM outputs ORDER BY job, "
             "position",
             look_at_output);
    each_row(&e, "SELECT 'outputs of no job, ' || job FROM outputs WHERE job NOT IN (SELECT id FROM jobs)",
             look_at_integrity);
}

enum status catalog_sqlite_knows(struct catalog *catalog, enum catalog_thing thing, const char *name, bool *known,
                                 struct error *error) {
    static const struct {
        const char *table, *before, *now; /* the table that newer versions have, and what to ask without and with it */
    } questions[] = {[CATALOG_JOB] = {"jobs", "SELECT ?1 IS NULL", "SELECT count(*) FROM jobs WHERE id = ?1"},
                     [CATALOG_UPLOAD] = {"uploads", "SELECT ?1 IS NULL", "SELECT count(*) FROM uploads WHERE id = ?1"},
                     [CATALOG_CLOUD] = {"clouds", "SELECT count(*) FROM jobs WHERE cloud = ?1",
                                        "SELECT (SELECT count(*) FROM jobs WHERE cloud = ?1) + "
                                        "(SELECT count(*) FROM clouds WHERE sha256 = ?1)"}};
    struct sql *db = catalog_sqlite_of(catalog)->reader;
    int64_t tables = 0, number = 0;
    sql_lock(db);
    enum status status = has_table(db, questions[thing].table, &tables, error);
    const char *question = tables ? questions[thing].now : questions[thing].before;
    if (status == STATUS_OK) status = sql_number(db, question, VALUES(T(name)), &number, error);
    sql_unlock(db);
    if (status == STATUS_OK) *known = number > 0;
    return status;
}
