/* What the offline check asks.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <string.h>

#include "server/catalog/postgres/catalog_postgres.h"
#include "server/catalog/postgres/tables.h"

struct examination {
    const struct catalog_examiner *examiner;
    struct pq_link *link;
};

/* Calls look for each row; what the database refuses is damage. */
static void each_row(const struct examination *e, const char *text,
                     void (*look)(const struct catalog_examiner *examiner, const struct pq_rows *rows)) {
    struct error error = {0};
    struct pq_rows *rows;
    if (pq_select(e->link, text, NULL, 0, &rows, &error) != STATUS_OK) {
        e->examiner->damaged(e->examiner->ctx, error.text);
        return;
    }
    while (pq_next(rows)) look(e->examiner, rows);
    pq_free(rows);
}

static void look_at_job(const struct catalog_examiner *examiner, const struct pq_rows *rows) {
    examiner->job(examiner->ctx, pq_text(rows, 0), (int)pq_integer(rows, 1), pq_integer(rows, 2),
                  (uint64_t)pq_integer(rows, 3));
}

static void look_at_cloud(const struct catalog_examiner *examiner, const struct pq_rows *rows) {
    examiner->cloud(examiner->ctx, pq_text(rows, 0));
}

static void look_at_output(const struct catalog_examiner *examiner, const struct pq_rows *rows) {
    struct job_output output = {.bytes = (uint64_t)pq_integer(rows, 2)};
    pq_copy_text(rows, 1, output.name, sizeof output.name);
    pq_copy_text(rows, 3, output.sha256, sizeof output.sha256);
    examiner->output(examiner->ctx, pq_text(rows, 0), (int)pq_integer(rows, 4), &output);
}

static void look_at_stray(const struct catalog_examiner *examiner, const struct pq_rows *rows) {
    char text[120];
    snprintf(text, sizeof text, "database: outputs of no job, %.60s", pq_text(rows, 0));
    examiner->damaged(examiner->ctx, text);
}

void catalog_postgres_examine(struct catalog *catalog, const struct catalog_examiner *examiner) {
    struct examination e = {.examiner = examiner};
    struct error error = {0};
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &e.link, &error);
    if (status == STATUS_OK) status = tables_check(e.link, &error);
    if (status != STATUS_OK) {
        examiner->damaged(examiner->ctx, error.text);
    } else {
        each_row(&e, "SELECT id, attempt, state, (SELECT count(*) FROM outputs WHERE job = id) FROM jobs ORDER BY id",
                 look_at_job);
        each_row(&e, "SELECT cloud FROM jobs UNION SELECT sha256 FROM clouds ORDER BY 1", look_at_cloud);
        each_row(&e,
                 "SELECT job, name, bytes, sha256, (SELECT attempt FROM jobs WHERE id = job) FROM outputs "
                 "ORDER BY job, position",
                 look_at_output);
        each_row(&e, "SELECT DISTINCT job FROM outputs WHERE job NOT IN (SELECT id FROM jobs)", look_at_stray);
    }
    if (e.link) pq_done(e.link);
}

enum status catalog_postgres_knows(struct catalog *catalog, enum catalog_thing thing, const char *name, bool *known,
                                   struct error *error) {
    static const char *const questions[] = {
        [CATALOG_JOB] = "SELECT count(*) FROM jobs WHERE id = $1",
        [CATALOG_UPLOAD] = "SELECT count(*) FROM uploads WHERE id = $1",
        [CATALOG_CLOUD] =
            "SELECT count(*) FROM (SELECT cloud FROM jobs UNION ALL SELECT sha256 FROM clouds) AS c WHERE cloud = $1"};
    struct pq_link *link;
    int64_t number = 0;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_number(link, questions[thing], VALUES(T(name)), &number, error);
    pq_done(link);
    if (status == STATUS_OK) *known = number > 0;
    return status;
}
