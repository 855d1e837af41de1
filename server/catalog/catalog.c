/* The catalog: picks the backend, and hands every use to it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/catalog/catalog.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/catalog/catalog_backend.h"

#define BACKEND(name) &name,
static const struct catalog_backend *const backends[] = {CATALOG_BACKENDS(BACKEND)};
#undef BACKEND
enum { BACKENDS = sizeof backends / sizeof *backends };

/* ------------------------------------------------------------------------------------------------ open */

/* NULL: no backend has URLs like this one. */
static const struct catalog_backend *backend_of(const char *url, const char **where) {
    for (size_t i = 0; i < BACKENDS; i++) {
        size_t length = strlen(backends[i]->scheme);
        *where = url + length;
        if (strncmp(url, backends[i]->scheme, length) == 0 && backends[i]->is_valid(*where)) return backends[i];
    }
    return NULL;
}

bool catalog_url_valid(const char *url) {
    const char *where;
    return backend_of(url, &where) != NULL;
}

void catalog_url(const char *setting, const char *folder, char url[CATALOG_URL_BYTES]) {
    if (setting[0])
        snprintf(url, CATALOG_URL_BYTES, "%.4100s", setting);
    else
        snprintf(url, CATALOG_URL_BYTES, "sqlite:%.4100s/whittled.db", folder);
}

bool catalog_exists(const char *url) {
    const char *where;
    const struct catalog_backend *backend = backend_of(url, &where);
    return backend && backend->exists(where);
}

bool catalog_is_shared(const char *url) {
    const char *where;
    const struct catalog_backend *backend = backend_of(url, &where);
    return backend && backend->is_shared;
}

enum status catalog_migrate(const char *url, struct error *error) {
    const char *where;
    const struct catalog_backend *backend = backend_of(url, &where);
    if (!backend) return error_set(error, STATUS_BAD_PARAMETER, "catalog", "'%.200s' is no URL of a catalog", url);
    return backend->migrate(where, error);
}

static enum status open_url(const char *url, bool as_is, struct catalog **catalog, struct error *error) {
    const char *where;
    const struct catalog_backend *backend = backend_of(url, &where);
    if (!backend) return error_set(error, STATUS_BAD_PARAMETER, "catalog", "'%.200s' is no URL of a catalog", url);
    return backend->open(where, as_is, catalog, error);
}

enum status catalog_open(const char *url, struct catalog **catalog, struct error *error) {
    return open_url(url, false, catalog, error);
}

enum status catalog_open_as_is(const char *url, struct catalog **catalog, struct error *error) {
    return open_url(url, true, catalog, error);
}

void catalog_close(struct catalog *catalog) {
    if (catalog) catalog->backend->close(catalog);
}

void catalog_watch(struct catalog *catalog, void (*tell)(void *ctx, enum catalog_change change, const char *id),
                   void *ctx) {
    catalog->tell = tell;
    catalog->ctx = ctx;
    if (catalog->backend->watch) catalog->backend->watch(catalog);
}

/* ------------------------------------------------------------------------------------------------ values */

void catalog_cloud_done(struct catalog_cloud *cloud) {
    free(cloud->report);
    memset(cloud, 0, sizeof *cloud);
}

int catalog_batch_state(const struct catalog_batch *batch) {
    int state = 2 * (int)(batch->size - batch->job_count);
    for (size_t i = 0; i < batch->job_count; i++)
        state += batch->job[i].state == JOB_RUNNING ? 1 : job_ended(batch->job[i].state) ? 2 : 0;
    return state;
}

void catalog_batch_done(struct catalog_batch *batch) {
    free(batch->job);
    memset(batch, 0, sizeof *batch);
}

bool catalog_cloud_id_valid(const char *text) {
    return strlen(text) == JOB_HASH_BYTES - 1 && strspn(text, "0123456789abcdef") == JOB_HASH_BYTES - 1;
}

void catalog_reply_done(struct catalog_reply *reply) {
    free(reply->reply);
    memset(reply, 0, sizeof *reply);
}

bool catalog_key_valid(const char *key) {
    size_t length = strlen(key);
    for (const char *c = key; *c; c++)
        if (*c <= ' ' || *c > '~') return false;
    return length > 0 && length < CATALOG_KEY_BYTES;
}

/* ------------------------------------------------------------------------------------------------ operations */

enum status catalog_identity(struct catalog *catalog, char id[CATALOG_IDENTITY_BYTES], struct error *error) {
    return catalog->backend->identity(catalog, id, error);
}

enum status catalog_set_identity(struct catalog *catalog, const char *id, struct error *error) {
    return catalog->backend->set_identity(catalog, id, error);
}

enum status catalog_takes_changes(struct catalog *catalog, struct error *error) {
    return catalog->backend->takes_changes(catalog, error);
}

enum status catalog_now(struct catalog *catalog, int64_t *now_ms, struct error *error) {
    return catalog->backend->now(catalog, now_ms, error);
}

enum status catalog_secret(struct catalog *catalog, const char *name, const char *brought,
                           char secret[CATALOG_SECRET_BYTES], struct error *error) {
    return catalog->backend->secret(catalog, name, brought, secret, error);
}

enum status catalog_submit(struct catalog *catalog, const struct job *job, const struct catalog_limits *limits,
                           struct error *error) {
    return catalog->backend->submit(catalog, job, limits, error);
}

enum status catalog_submit_ended(struct catalog *catalog, const struct job *job, const struct catalog_limits *limits,
                                 struct error *error) {
    return catalog->backend->submit_ended(catalog, job, limits, error);
}

enum status catalog_submit_batch(struct catalog *catalog, const struct catalog_batch *batch, const struct job *jobs,
                                 const struct catalog_limits *limits, struct error *error) {
    return catalog->backend->submit_batch(catalog, batch, jobs, limits, error);
}

enum status catalog_get_batch(struct catalog *catalog, const char *id, struct catalog_batch *batch, bool *found,
                              struct error *error) {
    return catalog->backend->get_batch(catalog, id, batch, found, error);
}

enum status catalog_list_batches(struct catalog *catalog, const char *principal, const char *after,
                                 struct catalog_batch *batches, size_t max, size_t *count, struct error *error) {
    return catalog->backend->list_batches(catalog, principal, after, batches, max, count, error);
}

enum status catalog_find_result(struct catalog *catalog, const char *result, const char *principal, struct job *job,
                                bool *found, struct error *error) {
    return catalog->backend->find_result(catalog, result, principal, job, found, error);
}

enum status catalog_claim(struct catalog *catalog, const struct catalog_claim *claim, struct job *job, bool *found,
                          struct error *error) {
    return catalog->backend->claim(catalog, claim, job, found, error);
}

enum status catalog_progress(struct catalog *catalog, const struct job *job, bool *held, struct error *error) {
    return catalog->backend->progress(catalog, job, held, error);
}

enum status catalog_renew(struct catalog *catalog, const char *owner, int64_t lease_ms, struct catalog_lease *leases,
                          size_t max, size_t *count, struct error *error) {
    return catalog->backend->renew(catalog, owner, lease_ms, leases, max, count, error);
}

enum status catalog_list_lost(struct catalog *catalog, const char *owner, struct job *jobs, size_t max, size_t *count,
                              struct error *error) {
    return catalog->backend->list_lost(catalog, owner, jobs, max, count, error);
}

enum status catalog_cancel(struct catalog *catalog, const char *id, struct error *error) {
    return catalog->backend->cancel(catalog, id, error);
}

enum status catalog_finish(struct catalog *catalog, enum job_event event, const struct job *job, bool *changed,
                           struct error *error) {
    return catalog->backend->finish(catalog, event, job, changed, error);
}

enum status catalog_get(struct catalog *catalog, const char *id, struct job *job, enum catalog_presence *presence,
                        struct catalog_tombstone *tombstone, struct error *error) {
    return catalog->backend->get(catalog, id, job, presence, tombstone, error);
}

enum status catalog_list(struct catalog *catalog, const struct catalog_filter *filter, struct job *jobs, size_t max,
                         size_t *count, struct error *error) {
    return catalog->backend->list(catalog, filter, jobs, max, count, error);
}

enum status catalog_delete(struct catalog *catalog, const char *id, const char *reason, bool *changed,
                           struct error *error) {
    return catalog->backend->delete (catalog, id, reason, changed, error);
}

enum status catalog_expired(struct catalog *catalog, int64_t now_ms, int64_t tombstones_before_ms,
                            char (*ids)[JOB_ID_BYTES], size_t max, size_t *count, struct error *error) {
    return catalog->backend->expired(catalog, now_ms, tombstones_before_ms, ids, max, count, error);
}

enum status catalog_move_times(struct catalog *catalog, int64_t step_ms, struct error *error) {
    return catalog->backend->move_times(catalog, step_ms, error);
}

void catalog_outlook(struct catalog *catalog, const char *id,
                     void (*visit)(void *ctx, const struct job_cost *cost, int64_t started_ms), void *ctx) {
    catalog->backend->outlook(catalog, id, visit, ctx);
}

void catalog_depth(struct catalog *catalog, uint64_t *waiting, uint64_t *running) {
    catalog->backend->depth(catalog, waiting, running);
}

struct catalog_usage catalog_usage(struct catalog *catalog, const char *principal) {
    return catalog->backend->usage(catalog, principal);
}

enum status catalog_reserve(struct catalog *catalog, const char *principal, uint64_t bytes, uint64_t limit,
                            struct error *error) {
    return catalog->backend->reserve(catalog, principal, bytes, limit, error);
}

void catalog_release(struct catalog *catalog, const char *principal, uint64_t bytes) {
    catalog->backend->release(catalog, principal, bytes);
}

enum status catalog_put_cloud(struct catalog *catalog, const struct catalog_cloud *cloud, uint64_t principal_bytes,
                              struct error *error) {
    return catalog->backend->put_cloud(catalog, cloud, principal_bytes, error);
}

enum status catalog_get_cloud(struct catalog *catalog, const char *sha256, const char *principal,
                              struct catalog_cloud *cloud, bool *found, struct error *error) {
    return catalog->backend->get_cloud(catalog, sha256, principal, cloud, found, error);
}

enum status catalog_list_clouds(struct catalog *catalog, const char *principal, const char *after,
                                struct catalog_cloud *clouds, size_t max, size_t *count, struct error *error) {
    return catalog->backend->list_clouds(catalog, principal, after, clouds, max, count, error);
}

enum status catalog_delete_cloud(struct catalog *catalog, const char *sha256, const char *principal,
                                 struct error *error) {
    return catalog->backend->delete_cloud(catalog, sha256, principal, error);
}

enum status catalog_expire_clouds(struct catalog *catalog, int64_t now_ms, char (*names)[JOB_HASH_BYTES], size_t max,
                                  size_t *count, struct error *error) {
    return catalog->backend->expire_clouds(catalog, now_ms, names, max, count, error);
}

enum status catalog_next_cloud(struct catalog *catalog, const char *after, char name[JOB_HASH_BYTES], bool *found,
                               struct error *error) {
    return catalog->backend->next_cloud(catalog, after, name, found, error);
}

enum status catalog_cloud_uses(struct catalog *catalog, const char *cloud, uint64_t *uses, struct error *error) {
    return catalog->backend->cloud_uses(catalog, cloud, uses, error);
}

enum status catalog_expect_cloud(struct catalog *catalog, const char *cloud, int64_t until_ms, struct error *error) {
    return catalog->backend->expect_cloud(catalog, cloud, until_ms, error);
}

enum status catalog_remove_cloud(struct catalog *catalog, const char *cloud, const struct catalog_removal *removal,
                                 bool *removed, struct error *error) {
    return catalog->backend->remove_cloud(catalog, cloud, removal, removed, error);
}

enum status catalog_list_unused_clouds(struct catalog *catalog, int64_t now_ms, char (*names)[JOB_HASH_BYTES],
                                       size_t max, size_t *count, struct error *error) {
    return catalog->backend->list_unused_clouds(catalog, now_ms, names, max, count, error);
}

enum status catalog_put_upload(struct catalog *catalog, const struct catalog_upload *upload, struct error *error) {
    return catalog->backend->put_upload(catalog, upload, error);
}

enum status catalog_delete_upload(struct catalog *catalog, const char *id, int64_t by_ms, bool *deleted,
                                  struct error *error) {
    return catalog->backend->delete_upload(catalog, id, by_ms, deleted, error);
}

enum status catalog_next_upload(struct catalog *catalog, const char *after, struct catalog_upload *upload, bool *found,
                                struct error *error) {
    return catalog->backend->next_upload(catalog, after, upload, found, error);
}

enum status catalog_open_upload(struct catalog *catalog, const struct catalog_upload *upload, const char *token,
                                const struct catalog_upload_limits *limits, struct error *error) {
    return catalog->backend->open_upload(catalog, upload, token, limits, error);
}

enum status catalog_find_upload(struct catalog *catalog, const char *id, struct catalog_upload *upload, bool *found,
                                struct error *error) {
    return catalog->backend->find_upload(catalog, id, upload, found, error);
}

enum status catalog_find_final(struct catalog *catalog, const char *principal, const char *concat,
                               struct catalog_upload *upload, bool *found, struct error *error) {
    return catalog->backend->find_final(catalog, principal, concat, upload, found, error);
}

enum status catalog_seize_upload(struct catalog *catalog, const char *id, const char *token, uint64_t offset,
                                 uint64_t length, uint64_t principal_bytes, struct catalog_upload *upload, bool *seized,
                                 struct error *error) {
    return catalog->backend->seize_upload(catalog, id, token, offset, length, principal_bytes, upload, seized, error);
}

enum status catalog_add_piece(struct catalog *catalog, const char *id, const char *token,
                              const struct catalog_piece *piece, int64_t expires_ms, bool *held, struct error *error) {
    return catalog->backend->add_piece(catalog, id, token, piece, expires_ms, held, error);
}

enum status catalog_list_pieces(struct catalog *catalog, const char *id, uint64_t offset, struct catalog_piece *pieces,
                                size_t max, size_t *count, struct error *error) {
    return catalog->backend->list_pieces(catalog, id, offset, pieces, max, count, error);
}

enum status catalog_complete_upload(struct catalog *catalog, const char *id, const char *cloud, struct error *error) {
    return catalog->backend->complete_upload(catalog, id, cloud, error);
}

enum status catalog_expired_uploads(struct catalog *catalog, int64_t now_ms, char (*ids)[JOB_ID_BYTES], size_t max,
                                    size_t *count, struct error *error) {
    return catalog->backend->expired_uploads(catalog, now_ms, ids, max, count, error);
}

enum status catalog_mark(struct catalog *catalog, const char *name, int64_t until_ms, struct error *error) {
    return catalog->backend->mark(catalog, name, until_ms, error);
}

enum status catalog_unmark(struct catalog *catalog, const char *name, struct error *error) {
    return catalog->backend->unmark(catalog, name, error);
}

enum status catalog_claim_marks(struct catalog *catalog, int64_t now_ms, char (*names)[CATALOG_MARK_BYTES], size_t max,
                                size_t *count, struct error *error) {
    return catalog->backend->claim_marks(catalog, now_ms, names, max, count, error);
}

enum status catalog_hold_key(struct catalog *catalog, const char *principal, const char *key,
                             struct catalog_key_hold *hold, struct error *error) {
    return catalog->backend->hold_key(catalog, principal, key, hold, error);
}

void catalog_release_key(struct catalog *catalog, struct catalog_key_hold *hold) {
    catalog->backend->release_key(catalog, hold);
}

enum status catalog_find_reply(struct catalog *catalog, const char *principal, const char *key,
                               struct catalog_reply *reply, bool *found, struct error *error) {
    return catalog->backend->find_reply(catalog, principal, key, reply, found, error);
}

enum status catalog_put_key(struct catalog *catalog, const char *principal, const struct job_key *key, const char *made,
                            int64_t now_ms, struct error *error) {
    return catalog->backend->put_key(catalog, principal, key, made, now_ms, error);
}

enum status catalog_keep_reply(struct catalog *catalog, const char *principal, const char *key, int status,
                               const char *etag, const char *text, struct error *error) {
    return catalog->backend->keep_reply(catalog, principal, key, status, etag, text, error);
}

enum status catalog_forget_keys(struct catalog *catalog, int64_t before_ms, struct error *error) {
    return catalog->backend->forget_keys(catalog, before_ms, error);
}

enum status catalog_each_webhook_due(struct catalog *catalog, int64_t now_ms,
                                     bool (*look)(void *ctx, const struct catalog_webhook *webhook), void *ctx,
                                     struct error *error) {
    return catalog->backend->each_webhook_due(catalog, now_ms, look, ctx, error);
}

enum status catalog_claim_webhook(struct catalog *catalog, const struct catalog_webhook *webhook, const char *owner,
                                  int64_t until_ms, bool *claimed, struct error *error) {
    return catalog->backend->claim_webhook(catalog, webhook, owner, until_ms, claimed, error);
}

enum status catalog_return_webhooks(struct catalog *catalog, const char *owner, const char *job, int64_t due_ms,
                                    struct error *error) {
    return catalog->backend->return_webhooks(catalog, owner, job, due_ms, error);
}

enum status catalog_postpone_webhook(struct catalog *catalog, const char *job, int64_t due_ms, struct error *error) {
    return catalog->backend->postpone_webhook(catalog, job, due_ms, error);
}

enum status catalog_end_webhook(struct catalog *catalog, const char *job, struct error *error) {
    return catalog->backend->end_webhook(catalog, job, error);
}

void catalog_examine(struct catalog *catalog, const struct catalog_examiner *examiner) {
    catalog->backend->examine(catalog, examiner);
}

enum status catalog_knows(struct catalog *catalog, enum catalog_thing thing, const char *name, bool *known,
                          struct error *error) {
    return catalog->backend->knows(catalog, thing, name, known, error);
}

enum status catalog_is_served(struct catalog *catalog, bool *served, struct error *error) {
    return catalog->backend->is_served(catalog, served, error);
}

enum status catalog_read_rows(struct catalog *catalog, enum catalog_table_name table, const char *of, uint64_t skip,
                              struct catalog_row *rows, size_t max, size_t *count, struct error *error) {
    return catalog->backend->read_rows(catalog, table, of, skip, rows, max, count, error);
}

enum status catalog_add_rows(struct catalog *catalog, const struct catalog_row *rows, size_t count, uint64_t *added,
                             struct error *error) {
    return catalog->backend->add_rows(catalog, rows, count, added, error);
}
