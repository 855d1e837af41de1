/* The identity of a folder and its database: read, compared, made.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/jobs/identity.h"

#include <inttypes.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "server/base/random.h"
#include "server/storage/uploads.h"

_Static_assert((int)SCRATCH_IDENTITY_BYTES == (int)CATALOG_IDENTITY_BYTES, "both keep the same");

/* The URL comes last: its length has no limit. */
static enum status refuse(const char *url, const char *what, struct error *error) {
    return error_set(
        error, STATUS_UNSUPPORTED, "identity",
        "the database %s. Put this folder's own back, from a backup; if there is none, run `whittled check "
        "--adopt`, and unknown files go to lost+found at the next start: %s",
        what, url);
}

/* ------------------------------------------------------------------------------------------------ what is there */

struct survey {
    struct store *store;
    struct catalog *catalog;
    uint64_t files, known;
};

static void look_at(void *ctx, enum store_thing thing, const char *name) {
    struct survey *survey = ctx;
    struct error error = {0};
    struct job job = {0};
    enum catalog_presence presence = CATALOG_ABSENT;
    struct catalog_tombstone tombstone;
    uint64_t uses = 0;
    if (thing == STORE_TEMPORARY) return;
    survey->files++;
    if (!survey->catalog || survey->known) return; /* one is enough */
    enum status status = STATUS_OK;
    if (thing == STORE_CLOUD) status = catalog_cloud_uses(survey->catalog, name, &uses, &error);
    if (thing == STORE_JOB) status = catalog_get(survey->catalog, name, &job, &presence, &tombstone, &error);
    job_done(&job);
    survey->known += status == STATUS_OK && (uses || presence != CATALOG_ABSENT);
}

static enum status look_for_uploads(struct survey *survey, struct error *error) {
    struct catalog_upload row = {0};
    bool found = true;
    enum status status = STATUS_OK;
    while (status == STATUS_OK && found && !survey->known) {
        status = catalog_next_upload(survey->catalog, row.id, &row, &found, error);
        int fd = status == STATUS_OK && found ? scratch_part_open(store_scratch(survey->store), row.id, false) : -1;
        if (fd < 0) continue;
        survey->known++;
        close(fd);
    }
    return status;
}

/* ------------------------------------------------------------------------------------------------ the whole */

enum status identity_expect_database(struct store *store, const char *url, struct error *error) {
    struct survey survey = {.store = store};
    if (catalog_exists(url)) return STATUS_OK;
    enum status status = store_each(store, look_at, &survey, error);
    return status == STATUS_OK && survey.files ? refuse(url, "is missing or empty, and the folder has files", error)
                                               : status;
}

/* Of a pair of which one part has no identity. */
static enum status check_content(struct store *store, struct catalog *catalog, const char *url, struct error *error) {
    struct survey survey = {.store = store, .catalog = catalog};
    enum status status = store_each(store, look_at, &survey, error);
    if (status == STATUS_OK && survey.files) status = look_for_uploads(&survey, error);
    if (status != STATUS_OK || !survey.files || survey.known) return status;
    return refuse(url, "knows none of the folder's files", error);
}

static enum status set_both(struct store *store, struct catalog *catalog, const char *id, struct error *error) {
    enum status status = scratch_set_identity(store_scratch(store), id, error);
    return status == STATUS_OK ? catalog_set_identity(catalog, id, error) : status;
}

enum status identity_check(struct store *store, struct catalog *catalog, const char *url, bool is_elsewhere,
                           struct error *error) {
    char folders[SCRATCH_IDENTITY_BYTES], databases[CATALOG_IDENTITY_BYTES], fresh[SCRATCH_IDENTITY_BYTES];
    enum status status = scratch_identity(store_scratch(store), folders, error);
    if (status == STATUS_OK) status = catalog_identity(catalog, databases, error);
    if (status != STATUS_OK) return status;
    if (folders[0] && databases[0])
        return strcmp(folders, databases) == 0 ? STATUS_OK : refuse(url, "is another folder's", error);
    if (databases[0] && is_elsewhere) return refuse(url, "is another folder's", error);
    status = check_content(store, catalog, url, error);
    if (status != STATUS_OK) return status;
    random_name(fresh);
    return set_both(store, catalog, folders[0] ? folders : databases[0] ? databases : fresh, error);
}

enum status identity_of_host(struct store *store, struct error *error) {
    char id[SCRATCH_IDENTITY_BYTES];
    enum status status = scratch_identity(store_scratch(store), id, error);
    if (status != STATUS_OK || id[0]) return status;
    random_name(id);
    return scratch_set_identity(store_scratch(store), id, error);
}

enum status identity_adopt(struct store *store, struct catalog *catalog, struct error *error) {
    char id[SCRATCH_IDENTITY_BYTES];
    random_name(id);
    return set_both(store, catalog, id, error);
}
