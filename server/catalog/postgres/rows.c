/* Rows as they are, for moving them to another catalog.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <string.h>

#include "server/catalog/postgres/catalog_postgres.h"

static int64_t cell_integer(void *row, int column) { return pq_integer(row, column); }
static double cell_real(void *row, int column) { return pq_real(row, column); }
static const char *cell_text(void *row, int column) { return pq_text(row, column); }
static char *cell_new_text(void *row, int column) { return pq_new_text(row, column); }

struct catalog_cells catalog_postgres_cells(struct pq_rows *row) {
    return (struct catalog_cells){row, cell_integer, cell_real, cell_text, cell_new_text};
}

enum status catalog_postgres_read_rows(struct catalog *catalog, enum catalog_table_name table, const char *of,
                                       uint64_t skip, struct catalog_row *rows, size_t max, size_t *count,
                                       struct error *error) {
    const struct catalog_table *shape = &catalog_tables[table];
    struct pq_link *link;
    struct pq_rows *from;
    char columns[CATALOG_COLUMNS_BYTES], text[CATALOG_STATEMENT_BYTES];
    *count = 0;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    catalog_rows_list_columns(shape, columns);
    snprintf(text, sizeof text, "SELECT %s FROM %s WHERE $1::TEXT IS NULL OR %s = $1 ORDER BY %s LIMIT $2 OFFSET $3",
             columns, shape->name, shape->column[0].name, shape->order);
    status = pq_select(link, text, VALUES(T(of), I(max), I(skip)), &from, error);
    if (status == STATUS_OK) {
        struct catalog_cells cells = catalog_postgres_cells(from);
        while (*count < max && pq_next(from)) catalog_cells_read_row(&cells, table, &rows[(*count)++]);
        pq_free(from);
    }
    pq_done(link);
    return status;
}

static enum status add_row(struct pq_link *link, const struct catalog_row *row, uint64_t *added, struct error *error) {
    const struct catalog_table *shape = &catalog_tables[row->table];
    struct pq_value values[CATALOG_MAX_COLUMNS];
    char columns[CATALOG_COLUMNS_BYTES], text[CATALOG_STATEMENT_BYTES];
    size_t count = catalog_table_columns(shape);
    int64_t changed = 0;
    bool is_job = row->table == CATALOG_TABLE_JOBS;
    catalog_rows_list_columns(shape, columns);
    int length =
        snprintf(text, sizeof text, "INSERT INTO %s (%s%s) SELECT ", shape->name, columns, is_job ? ", due" : "");
    for (size_t i = 0; i < count; i++) {
        length += snprintf(text + length, sizeof text - (size_t)length, "%s$%zu AS %s", i ? ", " : "", i + 1,
                           shape->column[i].name);
        values[i] = shape->column[i].type == CATALOG_INTEGER ? I(row->cell[i].integer)
                    : shape->column[i].type == CATALOG_REAL  ? R(row->cell[i].real)
                                                             : T(row->cell[i].text);
    }
    snprintf(text + length, sizeof text - (size_t)length, "%s ON CONFLICT DO NOTHING", is_job ? ", 0" : "");
    enum status status = pq_run(link, text, values, count, &changed, error);
    if (status == STATUS_OK && is_job && changed)
        status = pq_run(link, "UPDATE jobs SET due = created - priority * $2 WHERE id = $1",
                        VALUES(T(row->cell[CATALOG_JOB_ID].text), I(JOB_PRIORITY_AGING_MS)), NULL, error);
    if (status == STATUS_OK) *added += (uint64_t)changed;
    return status;
}

enum status catalog_postgres_add_rows(struct catalog *catalog, const struct catalog_row *rows, size_t count,
                                      uint64_t *added, struct error *error) {
    struct pq_link *link;
    uint64_t more = 0;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    if (status == STATUS_OK) /* clouds that were removed come back */
        status = pq_run(link, "UPDATE expected SET removal = 0, removed = 0 WHERE removed = 1", NULL, 0, NULL, error);
    for (size_t i = 0; status == STATUS_OK && i < count; i++) status = add_row(link, &rows[i], &more, error);
    status = pq_end(link, status, NULL, error);
    if (status == STATUS_OK) *added += more;
    return status;
}

enum status catalog_postgres_is_served(struct catalog *catalog, bool *served, struct error *error) {
    struct catalog_postgres *postgres = catalog_postgres_of(catalog);
    struct pq_link *link;
    int64_t sessions = 0;
    enum status status = pq_take(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_number(link, "SELECT count(*) FROM sessions WHERE lease > whittle_now() AND id <> $1",
                       VALUES(T(postgres->session)), &sessions, error);
    pq_done(link);
    *served = sessions > 0;
    return status;
}
