/* The rows of resumable uploads.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <string.h>

#include "server/catalog/postgres/catalog_postgres.h"

enum status catalog_postgres_put_upload(struct catalog *catalog, const struct catalog_upload *row,
                                        struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_run(link,
                    "INSERT INTO uploads (id, principal, metadata, cloud, created, expires, position, length, boot) "
                    "VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9) ON CONFLICT (id) DO UPDATE SET "
                    "metadata = excluded.metadata, cloud = excluded.cloud, expires = excluded.expires, "
                    "position = excluded.position, length = excluded.length, boot = excluded.boot",
                    VALUES(T(row->id), T(row->principal), T(row->metadata), T(row->cloud), I(row->created_ms),
                           I(row->expires_ms), I(row->offset), I(row->length), T(row->boot)),
                    NULL, error);
    return pq_end(link, status, NULL, error);
}

enum status catalog_postgres_delete_upload(struct catalog *catalog, const char *id, struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    return pq_end(link, pq_run(link, "DELETE FROM uploads WHERE id = $1", VALUES(T(id)), NULL, error), NULL, error);
}

enum status catalog_postgres_next_upload(struct catalog *catalog, const char *after, struct catalog_upload *row,
                                         bool *found, struct error *error) {
    struct pq_link *link;
    struct pq_rows *rows;
    char behind[JOB_ID_BYTES]; /* after may be row's own */
    snprintf(behind, sizeof behind, "%s", after);
    *found = false;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_select(link,
                       "SELECT id, principal, metadata, cloud, created, expires, position, length, boot FROM uploads "
                       "WHERE id > $1 ORDER BY id LIMIT 1",
                       VALUES(T(behind)), &rows, error);
    if (status == STATUS_OK) {
        *found = pq_next(rows);
        if (*found) {
            memset(row, 0, sizeof *row);
            pq_copy_text(rows, 0, row->id, sizeof row->id);
            pq_copy_text(rows, 1, row->principal, sizeof row->principal);
            pq_copy_text(rows, 2, row->metadata, sizeof row->metadata);
            pq_copy_text(rows, 3, row->cloud, sizeof row->cloud);
            row->created_ms = pq_integer(rows, 4);
            row->expires_ms = pq_integer(rows, 5);
            row->offset = (uint64_t)pq_integer(rows, 6);
            row->length = (uint64_t)pq_integer(rows, 7); /* -1 is UINT64_MAX */
            pq_copy_text(rows, 8, row->boot, sizeof row->boot);
        }
        pq_free(rows);
    }
    pq_done(link);
    return status;
}
