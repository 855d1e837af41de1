/* Rows as they are, for moving them to another catalog.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <string.h>

#include "server/catalog/sqlite/catalog_sqlite.h"
#include "server/catalog/sqlite/job_rows.h"

static int64_t cell_integer(void *row, int column) { return sql_integer(row, column); }
static double cell_real(void *row, int column) { return sql_real(row, column); }
static const char *cell_text(void *row, int column) { return sql_text(row, column); }
static char *cell_new_text(void *row, int column) { return sql_new_text(row, column); }

struct catalog_cells catalog_sqlite_cells(struct sql_rows *row) {
    return (struct catalog_cells){row, cell_integer, cell_real, cell_text, cell_new_text};
}

enum status catalog_sqlite_read_rows(struct catalog *catalog, enum catalog_table_name table, const char *of,
                                     uint64_t skip, struct catalog_row *rows, size_t max, size_t *count,
                                     struct error *error) {
    const struct catalog_table *shape = &catalog_tables[table];
    struct sql *reader = catalog_sqlite_of(catalog)->reader;
    struct sql_rows *from;
    char columns[CATALOG_COLUMNS_BYTES], text[CATALOG_STATEMENT_BYTES];
    catalog_rows_list_columns(shape, columns);
    snprintf(text, sizeof text, "SELECT %s FROM %s WHERE ?1 IS NULL OR %s = ?1 ORDER BY %s LIMIT ?2 OFFSET ?3", columns,
             shape->name, shape->column[0].name, shape->order);
    *count = 0;
    sql_lock(reader);
    enum status status = sql_select(reader, text, VALUES(T(of), I(max), I(skip)), &from, error);
    if (status == STATUS_OK) {
        struct catalog_cells cells = catalog_sqlite_cells(from);
        while (*count < max && sql_next(from)) catalog_cells_read_row(&cells, table, &rows[(*count)++]);
        status = sql_finish(from, error);
    }
    sql_unlock(reader);
    return status;
}

static enum status add_row(struct sql *db, const struct catalog_row *row, struct error *error) {
    const struct catalog_table *shape = &catalog_tables[row->table];
    struct sql_value values[CATALOG_MAX_COLUMNS];
    char columns[CATALOG_COLUMNS_BYTES], text[CATALOG_STATEMENT_BYTES];
    size_t count = catalog_table_columns(shape);
    catalog_rows_list_columns(shape, columns);
    int length = snprintf(text, sizeof text, "INSERT INTO %s (%s) VALUES (", shape->name, columns);
    for (size_t i = 0; i < count; i++) {
        length += snprintf(text + length, sizeof text - (size_t)length, "%s?%zu", i ? ", " : "", i + 1);
        values[i] = shape->column[i].type == CATALOG_INTEGER ? I(row->cell[i].integer)
                    : shape->column[i].type == CATALOG_REAL  ? R(row->cell[i].real)
                                                             : T(row->cell[i].text);
    }
    snprintf(text + length, sizeof text - (size_t)length, ") ON CONFLICT DO NOTHING");
    return sql_run(db, text, values, count, error);
}

enum status catalog_sqlite_add_rows(struct catalog *catalog, const struct catalog_row *rows, size_t count,
                                    uint64_t *added, struct error *error) {
    struct sql *db = catalog_sqlite_enter(catalog_sqlite_of(catalog));
    uint64_t more = 0;
    enum status status = sql_begin(db, error);
    if (status == STATUS_OK) {
        for (size_t i = 0; status == STATUS_OK && i < count; i++) {
            status = add_row(db, &rows[i], error);
            if (status == STATUS_OK) more += (uint64_t)sql_changes(db);
        }
        status = sql_end(db, status, error);
    }
    sql_unlock(db);
    if (status == STATUS_OK) *added += more;
    return status;
}

enum status catalog_sqlite_is_served(struct catalog *catalog, bool *served, struct error *error) {
    (void)catalog, (void)error;
    *served = false;
    return STATUS_OK;
}
