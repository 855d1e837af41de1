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
                    "INSERT INTO uploads (" CATALOG_UPLOAD_COLUMNS ") "
                    "VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10) ON CONFLICT (id) DO UPDATE SET "
                    "metadata = excluded.metadata, cloud = excluded.cloud, expires = excluded.expires, "
                    "position = excluded.position, length = excluded.length, boot = excluded.boot",
                    VALUES(T(row->id), T(row->principal), T(row->metadata), T(row->cloud), I(row->created_ms),
                           I(row->expires_ms), I(row->offset), I(row->length), T(row->boot), T(row->concat)),
                    NULL, error);
    return pq_end(link, status, NULL, error);
}

/* A writer that puts the end off at the same time has the row locked: the condition is looked at again behind it. */
enum status catalog_postgres_delete_upload(struct catalog *catalog, const char *id, int64_t by_ms, bool *deleted,
                                           struct error *error) {
    struct pq_link *link;
    int64_t left = 1;
    *deleted = false;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    /* A part says first that it is known as one (tables.c). */
    status = pq_run(link, "UPDATE uploads SET concat = '' WHERE id = $1 AND concat = 'partial' AND expires <= $2",
                    VALUES(T(id), I(by_ms)), NULL, error);
    if (status == STATUS_OK)
        status =
            pq_run(link, "DELETE FROM uploads WHERE id = $1 AND expires <= $2", VALUES(T(id), I(by_ms)), NULL, error);
    if (status == STATUS_OK)
        status = pq_number(link, "SELECT count(*) FROM uploads WHERE id = $1", VALUES(T(id)), &left, error);
    if (status == STATUS_OK && !left)
        status = pq_run(link, "DELETE FROM pieces WHERE upload = $1", VALUES(T(id)), NULL, error);
    if (status == STATUS_OK && !left)
        status = pq_run(link, MARK("'uploads/' || $1", "whittle_now() + " GRACE_MS), VALUES(T(id)), NULL, error);
    status = pq_end(link, status, NULL, error);
    *deleted = status == STATUS_OK && !left;
    return status;
}

/* The first row of a SELECT of CATALOG_UPLOAD_COLUMNS; row is untouched where there is none. */
static enum status select_upload(struct pq_link *link, const char *text, const struct pq_value *values, size_t count,
                                 struct catalog_upload *row, bool *found, struct error *error) {
    struct pq_rows *rows;
    *found = false;
    enum status status = pq_select(link, text, values, count, &rows, error);
    if (status != STATUS_OK) return status;
    *found = pq_next(rows);
    struct catalog_cells cells = catalog_postgres_cells(rows);
    if (*found) catalog_cells_read_upload(&cells, row);
    pq_free(rows);
    return STATUS_OK;
}

enum status catalog_postgres_next_upload(struct catalog *catalog, const char *after, struct catalog_upload *row,
                                         bool *found, struct error *error) {
    struct pq_link *link;
    char behind[JOB_ID_BYTES]; /* after may be row's own */
    snprintf(behind, sizeof behind, "%s", after);
    *found = false;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = select_upload(link, "SELECT " CATALOG_UPLOAD_COLUMNS " FROM uploads WHERE id > $1 ORDER BY id LIMIT 1",
                           VALUES(T(behind)), row, found, error);
    pq_done(link);
    return status;
}

enum status catalog_postgres_find_upload(struct catalog *catalog, const char *id, struct catalog_upload *row,
                                         bool *found, struct error *error) {
    struct pq_link *link;
    *found = false;
    enum status status = pq_take_soon(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = select_upload(link, "SELECT " CATALOG_UPLOAD_COLUMNS " FROM uploads WHERE id = $1", VALUES(T(id)), row,
                           found, error);
    if (status == STATUS_OK && !*found) status = catalog_postgres_confirm(link, error);
    pq_done(link);
    return status;
}

enum status catalog_postgres_find_final(struct catalog *catalog, const char *principal, const char *concat,
                                        struct catalog_upload *row, bool *found, struct error *error) {
    struct pq_link *link;
    *found = false;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = select_upload(link,
                           "SELECT " CATALOG_UPLOAD_COLUMNS " FROM uploads WHERE principal = $1 AND concat = $2 "
                           "AND position = length ORDER BY id LIMIT 1",
                           VALUES(T(principal), T(concat)), row, found, error);
    pq_done(link);
    return status;
}

/* ------------------------------------------------------------------------------------------------ pieces */

/* Of one lock for all who open uploads. */
#define LOCK_UPLOADS "SELECT pg_advisory_xact_lock(7741163)"

static enum status check_upload_counts(struct pq_link *link, const char *principal,
                                       const struct catalog_upload_limits *limits, struct error *error) {
    int64_t all = 0, own = 0;
    enum status status = pq_number(link, "SELECT count(*) FROM uploads", NULL, 0, &all, error);
    if (status == STATUS_OK)
        status =
            pq_number(link, "SELECT count(*) FROM uploads WHERE principal = $1", VALUES(T(principal)), &own, error);
    if (status != STATUS_OK) return status;
    if ((uint64_t)all >= limits->all)
        return error_set(error, STATUS_LIMIT, "max_uploads", "max_uploads is %llu, and as many are there",
                         (unsigned long long)limits->all);
    if ((uint64_t)own >= limits->of_principal)
        return error_set(error, STATUS_LIMIT, "principal_uploads", "principal_uploads is %llu, and as many are there",
                         (unsigned long long)limits->of_principal);
    return STATUS_OK;
}

enum status catalog_postgres_open_upload(struct catalog *catalog, const struct catalog_upload *row, const char *token,
                                         const struct catalog_upload_limits *limits, struct error *error) {
    struct catalog_postgres *postgres = catalog_postgres_of(catalog);
    struct pq_link *link;
    bool unknown = false, found = false;
    enum status status = pq_begin(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_run(link, LOCK_UPLOADS, NULL, 0, NULL, error);
    if (status == STATUS_OK) status = check_upload_counts(link, row->principal, limits, error);
    if (status == STATUS_OK)
        status = catalog_postgres_check_bytes(link, row->principal, row->length == UINT64_MAX ? 0 : row->length,
                                              limits->principal_bytes, error);
    if (status == STATUS_OK)
        status =
            pq_run(link,
                   "INSERT INTO uploads (id, principal, metadata, cloud, created, expires, position, length, boot, "
                   "writer, concat) VALUES ($1, $2, $3, '', $4, $5, 0, $6, '', '+' || $7, $8)",
                   VALUES(T(row->id), T(row->principal), T(row->metadata), I(row->created_ms), I(row->expires_ms),
                          I(row->length), T(token), T(row->concat)),
                   NULL, error);
    status = pq_end(link, status, &unknown, error);
    if (!unknown) return status;
    struct catalog_upload made;
    struct error ignored;
    return catalog_postgres_find_upload(catalog, row->id, &made, &found, &ignored) == STATUS_OK && found ? STATUS_OK
                                                                                                         : status;
}

/* Whether the upload goes on there, with that length. */
static bool is_next(const struct catalog_upload *row, uint64_t offset, uint64_t length) {
    bool is_known = row->length != UINT64_MAX;
    if (row->cloud[0] || (offset != UINT64_MAX && offset != row->offset)) return false;
    return length == UINT64_MAX || (is_known ? length == row->length : length >= row->offset);
}

enum status catalog_postgres_seize_upload(struct catalog *catalog, const char *id, const char *token, uint64_t offset,
                                          uint64_t length, uint64_t principal_bytes, struct catalog_upload *row,
                                          bool *seized, struct error *error) {
    struct pq_link *link;
    bool found = false;
    *seized = false;
    memset(row, 0, sizeof *row);
    enum status status = pq_begin_soon(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = select_upload(link, "SELECT " CATALOG_UPLOAD_COLUMNS " FROM uploads WHERE id = $1 FOR UPDATE",
                           VALUES(T(id)), row, &found, error);
    bool is_right = status == STATUS_OK && found && is_next(row, offset, length);
    if (is_right && length != UINT64_MAX && row->length == UINT64_MAX) {
        row->length = length;
        status = catalog_postgres_check_bytes(link, row->principal, length - row->offset, principal_bytes, error);
    }
    if (is_right && status == STATUS_OK)
        status = pq_run(link, "UPDATE uploads SET writer = '+' || $2, length = $3 WHERE id = $1",
                        VALUES(T(id), T(token), I(row->length)), NULL, error);
    status = pq_end(link, status, NULL, error); /* done without our knowing, it fences others and harms nobody */
    *seized = status == STATUS_OK && is_right;
    return status;
}

enum status catalog_postgres_add_piece(struct catalog *catalog, const char *id, const char *token,
                                       const struct catalog_piece *piece, int64_t expires_ms, bool *held,
                                       struct error *error) {
    struct catalog_postgres *postgres = catalog_postgres_of(catalog);
    struct pq_link *link;
    int64_t changed = 0, known = 0;
    bool unknown = false;
    *held = false;
    enum status status = pq_begin(postgres->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_run(link,
                    "UPDATE uploads SET position = position + $4, expires = $5 "
                    "WHERE id = $1 AND writer = '+' || $2 AND position = $3 AND cloud = ''",
                    VALUES(T(id), T(token), I(piece->offset), I(piece->bytes), I(expires_ms)), &changed, error);
    if (status == STATUS_OK && changed && piece->bytes)
        status = pq_run(link, "INSERT INTO pieces (upload, position, bytes, name) VALUES ($1, $2, $3, $4)",
                        VALUES(T(id), I(piece->offset), I(piece->bytes), T(piece->name)), NULL, error);
    if (status == STATUS_OK && changed && piece->reserved)
        status = pq_run(link,
                        "UPDATE reservations SET bytes = greatest(bytes - $3, 0) "
                        "WHERE principal = (SELECT principal FROM uploads WHERE id = $2) AND session = $1",
                        VALUES(T(postgres->session), T(id), I(piece->reserved)), NULL, error);
    status = pq_end(link, status, &unknown, error);
    *held = status == STATUS_OK && changed;
    if (!unknown || !changed) return status;
    struct error ignored; /* a commit without an answer: the piece's name, which nobody else makes, tells */
    if (pq_take(postgres->pq, &link, &ignored) != STATUS_OK) return status;
    enum status looked = pq_number(link, "SELECT count(*) FROM pieces WHERE upload = $1 AND name = $2",
                                   VALUES(T(id), T(piece->name)), &known, &ignored);
    pq_done(link);
    *held = looked == STATUS_OK && known;
    return *held ? STATUS_OK : status;
}

enum status catalog_postgres_list_pieces(struct catalog *catalog, const char *id, uint64_t offset,
                                         struct catalog_piece *pieces, size_t max, size_t *count, struct error *error) {
    struct pq_link *link;
    struct pq_rows *rows;
    *count = 0;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_select(link,
                       "SELECT position, bytes, name FROM pieces WHERE upload = $1 AND position >= $2 "
                       "ORDER BY position LIMIT $3",
                       VALUES(T(id), I(offset), I(max)), &rows, error);
    if (status == STATUS_OK) {
        while (*count < max && pq_next(rows)) {
            struct catalog_piece *piece = &pieces[(*count)++];
            piece->offset = (uint64_t)pq_integer(rows, 0);
            piece->bytes = (uint64_t)pq_integer(rows, 1);
            pq_copy_text(rows, 2, piece->name, sizeof piece->name);
        }
        pq_free(rows);
    }
    pq_done(link);
    return status;
}

enum status catalog_postgres_complete_upload(struct catalog *catalog, const char *id, const char *cloud,
                                             struct error *error) {
    struct pq_link *link;
    int64_t changed = 0;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_run(link, "UPDATE uploads SET cloud = $2, writer = '' WHERE id = $1 AND cloud = ''",
                    VALUES(T(id), T(cloud)), &changed, error);
    if (status == STATUS_OK && changed)
        status = pq_run(link, "DELETE FROM pieces WHERE upload = $1", VALUES(T(id)), NULL, error);
    if (status == STATUS_OK && changed)
        status = pq_run(link, MARK("'uploads/' || $1", "whittle_now() + " GRACE_MS), VALUES(T(id)), NULL, error);
    return pq_end(link, status, NULL, error);
}

/* Up to max texts of the first column. */
static enum status list_texts(struct catalog *catalog, const char *query, int64_t now_ms, char *texts, size_t bytes,
                              size_t max, size_t *count, struct error *error) {
    struct pq_link *link;
    struct pq_rows *rows;
    *count = 0;
    enum status status = pq_take(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    status = pq_select(link, query, VALUES(I(now_ms), I(max)), &rows, error);
    if (status == STATUS_OK) {
        while (*count < max && pq_next(rows)) pq_copy_text(rows, 0, texts + bytes * (*count)++, bytes);
        pq_free(rows);
    }
    pq_done(link);
    return status;
}

enum status catalog_postgres_expired_uploads(struct catalog *catalog, int64_t now_ms, char (*ids)[JOB_ID_BYTES],
                                             size_t max, size_t *count, struct error *error) {
    return list_texts(catalog, "SELECT id FROM uploads WHERE expires <= $1 ORDER BY expires LIMIT $2", now_ms, ids[0],
                      JOB_ID_BYTES, max, count, error);
}

/* ------------------------------------------------------------------------------------------------ marks */

enum status catalog_postgres_mark(struct catalog *catalog, const char *name, int64_t until_ms, struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    return pq_end(link, pq_run(link, MARK("$1", "$2"), VALUES(T(name), I(until_ms)), NULL, error), NULL, error);
}

enum status catalog_postgres_unmark(struct catalog *catalog, const char *name, struct error *error) {
    struct pq_link *link;
    enum status status = pq_begin(catalog_postgres_of(catalog)->pq, &link, error);
    if (status != STATUS_OK) return status;
    return pq_end(link, pq_run(link, "DELETE FROM marks WHERE name = $1", VALUES(T(name)), NULL, error), NULL, error);
}

enum status catalog_postgres_claim_marks(struct catalog *catalog, int64_t now_ms, char (*names)[CATALOG_MARK_BYTES],
                                         size_t max, size_t *count, struct error *error) {
    return list_texts(catalog,
                      "UPDATE marks SET until = whittle_now() + 60000 WHERE name IN (SELECT name FROM marks "
                      "WHERE until <= $1 ORDER BY until LIMIT $2 FOR UPDATE SKIP LOCKED) RETURNING name",
                      now_ms, names[0], CATALOG_MARK_BYTES, max, count, error);
}
