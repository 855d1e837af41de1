/* Moves all that a service has from one catalog and blob store to others, such as from one machine to many hosts.
 *
 *     whittled export --to FOLDER --catalog postgresql://... --blobs s3://...      into a new data folder
 *     whittled import --from FOLDER --catalog postgresql://... --blobs s3://...    out of a data folder
 *
 * So what is exported is a data folder like any other: one machine can serve it, a backup can keep it.  Nobody may
 * serve either side meanwhile.
 *
 * A job's blobs are put before its row is, which comes with the rows of its outputs in one transaction; a row that is
 * there already is passed by, with its blobs.  So whatever ended it, the same command goes on where it was, and does
 * nothing where all is there.  Every byte is hashed as it is moved, and what isn't what its row says ends the transfer.
 * Nothing is ever removed.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/daemon/transfer.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/base/digest.h"
#include "server/base/folders.h"
#include "server/base/signature.h"
#include "server/catalog/catalog.h"
#include "server/daemon/fault_point.h"
#include "server/daemon/settings.h"
#include "server/jobs/identity.h"
#include "server/storage/store.h"

enum { EXIT_USAGE = 2, PAGE = 64, JOB_ROWS = JOB_MAX_OUTPUTS + 2 };

/* Where it comes from, or goes to. */
struct side {
    struct store *store;
    struct catalog *catalog;
    bool is_shared;
};

struct transfer {
    struct side from, to;
    size_t jobs, clouds, outputs; /* moved, not those that were there */
};

static enum status refused(struct error *error, const char *what, const char *name) {
    return error_set(error, status_from_errno(errno), "transfer", "can't %s %.200s: %s", what, name, strerror(errno));
}

/* ------------------------------------------------------------------------------------------------ blobs */

/* Copies an open file to another one, and flushes it; closes the first. */
static enum status copy_file(int from_fd, int to_fd, const char *name, struct error *error) {
    enum status status = STATUS_OK;
    if (from_fd < 0)
        status = refused(error, "open", name);
    else if (to_fd < 0 || folders_copy(from_fd, to_fd) != 0 || fsync(to_fd) != 0)
        status = refused(error, "copy", name);
    if (from_fd >= 0) close(from_fd);
    return status;
}

static enum status differs(struct error *error, const char *name) {
    return error_set(error, STATUS_MALFORMED, "transfer", "%.200s isn't what its row says: run whittled check", name);
}

static enum status move_cloud(struct transfer *t, const char *sha256, struct error *error) {
    struct scratch *scratch = store_scratch(t->to.store);
    struct scratch_file file = {.fd = -1};
    char name[JOB_HASH_BYTES + 16], found[DIGEST_HEX_BYTES];
    uint64_t bytes;
    snprintf(name, sizeof name, "clouds/%.64s", sha256);
    int there = store_cloud_open(t->to.store, sha256);
    if (there >= 0) {
        bool is_same = digest_file(there, found, &bytes) == 0 && strcmp(found, sha256) == 0;
        close(there);
        if (is_same) return STATUS_OK;
    }
    enum status status = scratch_file_begin(scratch, &file, error);
    if (status == STATUS_OK) status = copy_file(store_cloud_open(t->from.store, sha256), file.fd, name, error);
    if (status == STATUS_OK && digest_file(file.fd, found, &bytes) != 0) status = refused(error, "read", name);
    if (status == STATUS_OK && strcmp(found, sha256) != 0) status = differs(error, name);
    if (status == STATUS_OK) status = scratch_file_sync(&file, error);
    if (status == STATUS_OK) status = store_upload_keep(t->to.store, &file, sha256, error);
    if (status == STATUS_OK) t->clouds++;
    scratch_file_drop(scratch, &file);
    return status;
}

enum { OUTPUT_POSITION = 1, OUTPUT_NAME, OUTPUT_BYTES, OUTPUT_SHA256 }; /* columns of that table */

/* Whether what was put is what the rows say. */
static bool are_same(const struct catalog_row *rows, size_t count, const struct job_output *outputs, size_t found) {
    bool same = count == found;
    for (size_t i = 0; same && i < count; i++) {
        size_t at = 0;
        while (at < found && strcmp(outputs[at].name, rows[i].cell[OUTPUT_NAME].text) != 0) at++;
        same = at < found && outputs[at].bytes == (uint64_t)rows[i].cell[OUTPUT_BYTES].integer &&
               strcmp(outputs[at].sha256, rows[i].cell[OUTPUT_SHA256].text) == 0;
    }
    return same;
}

static enum status move_outputs(struct transfer *t, const char *id, int attempt, const struct catalog_row *rows,
                                size_t count, struct error *error) {
    struct scratch *scratch = store_scratch(t->to.store);
    char path[SCRATCH_PATH_BYTES];
    struct job_output outputs[JOB_MAX_OUTPUTS];
    size_t found = 0;
    if (!count) return STATUS_OK;
    enum status status = scratch_run_begin(scratch, id, attempt, path, error);
    int folder_fd = status == STATUS_OK ? scratch_run_open(scratch, id, attempt) : -1;
    for (size_t i = 0; status == STATUS_OK && i < count; i++) {
        const char *name = rows[i].cell[OUTPUT_NAME].text;
        int to_fd = strchr(name, '/') ? -1
                                      : openat(folder_fd, name, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC | O_NOFOLLOW,
                                               FOLDERS_FILE_MODE);
        status = copy_file(store_output_open(t->from.store, id, attempt, name), to_fd, name, error);
        if (to_fd >= 0) close(to_fd);
    }
    if (status == STATUS_OK) status = store_outputs_keep(t->to.store, id, attempt, NULL, outputs, &found, error);
    if (status == STATUS_OK && !are_same(rows, count, outputs, found)) status = differs(error, path);
    if (status == STATUS_OK) t->outputs += count;
    if (folder_fd >= 0) close(folder_fd);
    scratch_run_drop(scratch, id, attempt);
    return status;
}

/* A host's log in its own folder, or what hosts have shared of theirs; there need be none. */
static enum status move_log(struct transfer *t, const char *id, struct error *error) {
    struct scratch *scratch = store_scratch(t->to.store);
    int from_fd = t->from.is_shared ? store_log_gather(t->from.store, id) : store_log_open(t->from.store, id, false);
    if (from_fd < 0) return STATUS_OK;
    int to_fd = store_log_open(t->to.store, id, true);
    enum status status = to_fd >= 0 && ftruncate(to_fd, 0) != 0 ? refused(error, "empty the log of", id) : STATUS_OK;
    if (status == STATUS_OK)
        status = copy_file(from_fd, to_fd, "a log", error);
    else
        close(from_fd);
    if (to_fd >= 0) close(to_fd);
    if (status != STATUS_OK || !t->to.is_shared) return status;
    status = store_log_share(t->to.store, id, "import", error);
    scratch_log_delete(scratch, id);
    return status;
}

/* ------------------------------------------------------------------------------------------------ rows */

static void done_rows(struct catalog_row *rows, size_t count) {
    for (size_t i = 0; i < count; i++) catalog_row_done(&rows[i]);
}

/* The job with all that is its own: rows[0] is the job's. */
static enum status move_job(struct transfer *t, struct catalog_row *job, struct error *error) {
    const char *id = job->cell[CATALOG_JOB_ID].text;
    struct catalog_row *rows = calloc(JOB_ROWS, sizeof *rows);
    size_t outputs = 0, webhooks = 0;
    uint64_t added = 0;
    bool known = false;
    enum status status = rows ? catalog_knows(t->to.catalog, CATALOG_JOB, id, &known, error)
                              : error_set(error, STATUS_NO_MEMORY, "transfer", "no memory");
    if (status == STATUS_OK && !known) {
        int attempt = (int)job->cell[CATALOG_JOB_ATTEMPT].integer;
        status = catalog_read_rows(t->from.catalog, CATALOG_TABLE_OUTPUTS, id, 0, rows + 1, JOB_MAX_OUTPUTS, &outputs,
                                   error);
        if (status == STATUS_OK)
            status = catalog_read_rows(t->from.catalog, CATALOG_TABLE_WEBHOOKS, id, 0, rows + 1 + outputs, 1, &webhooks,
                                       error);
        if (status == STATUS_OK) status = move_cloud(t, job->cell[CATALOG_JOB_CLOUD].text, error);
        if (status == STATUS_OK) status = move_outputs(t, id, attempt, rows + 1, outputs, error);
        if (status == STATUS_OK) status = move_log(t, id, error);
        rows[0] = *job;
        if (status == STATUS_OK) status = catalog_add_rows(t->to.catalog, rows, 1 + outputs + webhooks, &added, error);
        if (status == STATUS_OK) t->jobs++;
        done_rows(rows + 1, outputs + webhooks);
    }
    free(rows);
    return status;
}

/* The batch with its webhook, where it isn't there yet. */
static enum status move_batch(struct transfer *t, struct catalog_row *batch, struct error *error) {
    struct catalog_row rows[2] = {*batch};
    struct catalog_batch known_batch;
    size_t webhooks = 0;
    uint64_t added = 0;
    bool known = false;
    const char *id = batch->cell[0].text;
    enum status status = catalog_get_batch(t->to.catalog, id, &known_batch, &known, error);
    catalog_batch_done(&known_batch);
    if (status != STATUS_OK || known) return status;
    status = catalog_read_rows(t->from.catalog, CATALOG_TABLE_WEBHOOKS, id, 0, rows + 1, 1, &webhooks, error);
    if (status == STATUS_OK) status = catalog_add_rows(t->to.catalog, rows, 1 + webhooks, &added, error);
    done_rows(rows + 1, webhooks);
    return status;
}

/* All rows of a table, page by page; those of clouds after their bytes. */
static enum status move_table(struct transfer *t, enum catalog_table_name table, struct error *error) {
    struct catalog_row *rows = calloc(PAGE, sizeof *rows);
    size_t count = PAGE;
    uint64_t added = 0;
    enum status status = rows ? STATUS_OK : error_set(error, STATUS_NO_MEMORY, "transfer", "no memory");
    for (uint64_t skip = 0; status == STATUS_OK && count == PAGE; skip += count) {
        status = catalog_read_rows(t->from.catalog, table, NULL, skip, rows, PAGE, &count, error);
        if (status != STATUS_OK) break;
        for (size_t i = 0; status == STATUS_OK && i < count; i++) {
            if (table == CATALOG_TABLE_CLOUDS) status = move_cloud(t, rows[i].cell[0].text, error);
            if (table == CATALOG_TABLE_BATCHES) status = move_batch(t, &rows[i], error);
            if (table == CATALOG_TABLE_JOBS) status = move_job(t, &rows[i], error);
        }
        if (status == STATUS_OK && table != CATALOG_TABLE_JOBS && table != CATALOG_TABLE_BATCHES)
            status = catalog_add_rows(t->to.catalog, rows, count, &added, error);
        done_rows(rows, count);
    }
    free(rows);
    return status;
}

/* Links that were signed stay good, unless the other side has a key of its own. */
static enum status move_key(struct transfer *t, struct error *error) {
    struct signature_key key;
    char path[SCRATCH_PATH_BYTES], brought[SIGNATURE_HEX_BYTES], secret[CATALOG_SECRET_BYTES];
    const struct side *folder = t->from.is_shared ? &t->to : &t->from;
    if (t->from.is_shared == t->to.is_shared) return STATUS_OK;
    scratch_key_path(store_scratch(folder->store), path);
    if (t->to.is_shared) {
        enum status status = access(path, F_OK) == 0 ? signature_open(path, &key, error) : STATUS_OK;
        if (status != STATUS_OK || access(path, F_OK) != 0) return status;
        signature_key_text(&key, brought);
        return catalog_secret(t->to.catalog, "signing.key", brought, secret, error);
    }
    if (access(path, F_OK) == 0) return STATUS_OK;
    enum status status = signature_open(path, &key, error); /* for a catalog that has none yet */
    if (status != STATUS_OK) return status;
    signature_key_text(&key, brought);
    status = catalog_secret(t->from.catalog, "signing.key", brought, secret, error);
    if (status == STATUS_OK && strcmp(secret, brought) != 0) {
        if (!signature_key_read(secret, &key))
            return error_set(error, STATUS_MALFORMED, "transfer", "the catalog's signing.key is no key");
        status = signature_write(path, &key, error);
    }
    return status;
}

static enum status move_all(struct transfer *t, struct error *error) {
    static const enum catalog_table_name order[] = {CATALOG_TABLE_CLOUDS, CATALOG_TABLE_BATCHES, CATALOG_TABLE_JOBS,
                                                    CATALOG_TABLE_REPLIES, CATALOG_TABLE_TOMBSTONES};
    bool is_served = false;
    enum status status = catalog_is_served(t->from.catalog, &is_served, error);
    if (status == STATUS_OK && !is_served) status = catalog_is_served(t->to.catalog, &is_served, error);
    if (status == STATUS_OK && is_served)
        status = error_set(error, STATUS_UNSUPPORTED, "transfer",
                           "a host serves the catalog: end all of them (one that was killed counts for a minute)");
    if (status == STATUS_OK) status = move_key(t, error);
    for (size_t i = 0; status == STATUS_OK && i < sizeof order / sizeof *order; i++)
        status = move_table(t, order[i], error);
    if (status == STATUS_OK && !t->to.is_shared) status = identity_adopt(t->to.store, t->to.catalog, error);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the sides */

static enum status open_side(struct side *side, const char *folder, const char *catalog, const char *blobs,
                             bool is_source, struct error *error) {
    char url[CATALOG_URL_BYTES];
    catalog_url(catalog, folder, url);
    side->is_shared = catalog_is_shared(url);
    if (is_source && !catalog_exists(url)) return error_set(error, STATUS_IO, "transfer", "there is no %.300s", url);
    enum status status = store_open(folder, blobs, &side->store, error);
    return status == STATUS_OK ? catalog_open(url, &side->catalog, error) : status;
}

static void close_side(struct side *side) {
    catalog_close(side->catalog);
    store_close(side->store);
}

/* Takes an option and its value out of the arguments; NULL where it isn't there. */
static const char *take_option(const char *name, int *argc, char **argv) {
    for (int i = 1; i + 1 < *argc; i++) {
        const char *value = argv[i + 1];
        if (strcmp(argv[i], name) != 0) continue;
        for (int j = i; j + 2 <= *argc; j++) argv[j] = argv[j + 2];
        *argc -= 2;
        return value;
    }
    return NULL;
}

int transfer_main(int argc, char **argv) {
    struct config config;
    struct error error = {0};
    struct transfer t = {0};
    const bool imports = strcmp(argv[0], "import") == 0;
    const char *option = imports ? "--from" : "--to", *folder = take_option(option, &argc, argv);
    enum config_request request = settings_read(&config, argc, argv, &error);
    if (request == CONFIG_TOLD) return EXIT_SUCCESS;
    if (request == CONFIG_RUN && !folder) {
        fprintf(stderr, "whittled: %s takes %s FOLDER\n", argv[0], option);
        return EXIT_USAGE;
    }
    struct side *settings = imports ? &t.to : &t.from, *other = imports ? &t.from : &t.to;
    enum status status = request == CONFIG_RUN ? fault_arm(config.fault, &error) : error.code;
    if (status == STATUS_OK) status = open_side(settings, config.data, config.catalog, config.blobs, !imports, &error);
    if (status == STATUS_OK) status = open_side(other, folder, "", "", imports, &error);
    if (status == STATUS_OK) status = move_all(&t, &error);
    if (status == STATUS_OK || t.jobs || t.clouds || t.outputs)
        printf("%sed %zu jobs, %zu clouds, %zu outputs that were not there\n", argv[0], t.jobs, t.clouds, t.outputs);
    if (status != STATUS_OK) fprintf(stderr, "whittled: %s: %s\n", error.where, error.text);
    close_side(&t.from);
    close_side(&t.to);
    return status == STATUS_OK ? EXIT_SUCCESS : request == CONFIG_RUN ? EXIT_FAILURE : EXIT_USAGE;
}
