/* The tables that are moved, as every backend has them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/rows.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define INTEGER(column)                                                                                                \
    { column, CATALOG_INTEGER }
#define REAL(column)                                                                                                   \
    { column, CATALOG_REAL }
#define TEXT(column)                                                                                                   \
    { column, CATALOG_TEXT }

/* Columns that the next version adds are added here, too; one that only a backend has is its own to fill in. */
const struct catalog_table catalog_tables[CATALOG_TABLE_COUNT] = {
    [CATALOG_TABLE_CLOUDS] = {"clouds",
                              "sha256, principal",
                              {TEXT("sha256"), TEXT("principal"), INTEGER("created"), INTEGER("expires"),
                               INTEGER("bytes"), INTEGER("points"), TEXT("format")}},
    [CATALOG_TABLE_JOBS] = {"jobs",
                            "id",
                            {TEXT("id"),
                             INTEGER("state"),
                             INTEGER("attempt"),
                             TEXT("cloud"),
                             INTEGER("sequence"),
                             INTEGER("created"),
                             INTEGER("started"),
                             INTEGER("finished"),
                             INTEGER("updated"),
                             INTEGER("expires"),
                             TEXT("label"),
                             INTEGER("input_bytes"),
                             TEXT("input_format"),
                             INTEGER("input_points"),
                             TEXT("params"),
                             TEXT("stage"),
                             TEXT("message"),
                             REAL("fraction"),
                             REAL("cpu"),
                             REAL("wall"),
                             INTEGER("rss"),
                             TEXT("report"),
                             TEXT("problem"),
                             TEXT("principal"),
                             INTEGER("priority"),
                             TEXT("result"),
                             INTEGER("memory"),
                             INTEGER("failures"),
                             INTEGER("interruptions"),
                             INTEGER("cancelled"),
                             INTEGER("tiles"),
                             INTEGER("tiles_done"),
                             TEXT("batch")}},
    [CATALOG_TABLE_BATCHES] = {"batches",
                               "id",
                               {TEXT("id"), TEXT("principal"), TEXT("label"), INTEGER("created"), INTEGER("size")}},
    [CATALOG_TABLE_OUTPUTS] = {"outputs",
                               "job, position",
                               {TEXT("job"), INTEGER("position"), TEXT("name"), INTEGER("bytes"), TEXT("sha256")}},
    [CATALOG_TABLE_WEBHOOKS] = {"outbox", "job", {TEXT("job"), TEXT("url"), INTEGER("attempts"), INTEGER("due")}},
    [CATALOG_TABLE_REPLIES] = {"replies",
                               "principal, key",
                               {TEXT("principal"), TEXT("key"), TEXT("fingerprint"), TEXT("made"), INTEGER("at"),
                                INTEGER("status"), TEXT("etag"), TEXT("reply")}},
    [CATALOG_TABLE_TOMBSTONES] = {"tombstones", "id", {TEXT("id"), TEXT("reason"), INTEGER("at"), TEXT("principal")}},
};

size_t catalog_table_columns(const struct catalog_table *table) {
    size_t count = 0;
    while (count < CATALOG_MAX_COLUMNS && table->column[count].name) count++;
    return count;
}

void catalog_row_done(struct catalog_row *row) {
    for (size_t i = 0; i < CATALOG_MAX_COLUMNS; i++) free(row->cell[i].text);
    memset(row, 0, sizeof *row);
}

void catalog_rows_list_columns(const struct catalog_table *table, char text[CATALOG_COLUMNS_BYTES]) {
    int length = 0;
    for (size_t i = 0; i < catalog_table_columns(table); i++)
        length += snprintf(text + length, (size_t)(CATALOG_COLUMNS_BYTES - length), "%s%s", i ? ", " : "",
                           table->column[i].name);
}
