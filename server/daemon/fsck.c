/* The offline check: database against files, in both directions.
 *
 *     damaged: ...       content is missing or not what its hash says, or the database is broken; exit status 1
 *     unfinished: ...    what a crash leaves and the next start mends: running jobs, files without rows
 *     set aside: ...     what starts found without a row, and moved to lost+found
 *
 * Exit status 2: nothing was looked at, as a service has the folder, or there is none, or a server is away.
 *
 * With --adopt it first gives the folder and its database one identity (jobs/identity.h), where the service refuses
 * them.
 *
 * Every cloud and every output that a row names is read and hashed, so it takes as long as reading all of the folder.
 * The catalog is opened as it is, so that it can look at what an older or a broken service left.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "server/base/away.h"
#include "server/base/digest.h"
#include "server/catalog/catalog.h"
#include "server/catalog/job.h"
#include "server/daemon/fsck.h"
#include "server/daemon/settings.h"
#include "server/jobs/identity.h"
#include "server/storage/store.h"

enum { WHOLE = 0, DAMAGED = 1, NOT_LOOKED_AT = 2 };

struct check {
    struct store *store;
    struct catalog *catalog;
    size_t jobs, clouds, outputs, damaged, unfinished;
};

static void tell_finding(const char *kind, const char *format, va_list args) {
    printf("%s: ", kind);
    vprintf(format, args);
    putchar('\n');
}

__attribute__((format(printf, 2, 3))) static void damaged(struct check *check, const char *format, ...) {
    va_list args;
    va_start(args, format);
    tell_finding("damaged", format, args);
    va_end(args);
    check->damaged++;
}

__attribute__((format(printf, 2, 3))) static void unfinished(struct check *check, const char *format, ...) {
    va_list args;
    va_start(args, format);
    tell_finding("unfinished", format, args);
    va_end(args);
    check->unfinished++;
}

/* ------------------------------------------------------------------------------------------------ rows */

static void hear_of_damage(void *ctx, const char *what) { damaged(ctx, "%s", what); }

static void hear_of_unfinished(void *ctx, const char *what) { unfinished(ctx, "%s", what); }

/* Compares an open file with what is known of it; bytes UINT64_MAX: its hash alone. */
static void look_at_file(struct check *check, int fd, const char *name, uint64_t bytes, const char *sha256) {
    char found[DIGEST_HEX_BYTES];
    uint64_t length;
    if (fd < 0 && errno == ENOENT)
        damaged(check, "%s is missing", name);
    else if (fd < 0)
        damaged(check, errno == EIO ? "%s isn't what its hash says, or can't be read" : "%s can't be read: %s", name,
                strerror(errno));
    else if (digest_file(fd, found, &length) != 0)
        damaged(check, "%s can't be read", name);
    else if (bytes != UINT64_MAX && length != bytes)
        damaged(check, "%s has %llu bytes, not %llu", name, (unsigned long long)length, (unsigned long long)bytes);
    else if (strcmp(found, sha256) != 0)
        damaged(check, "%s has the hash %s", name, found);
    if (fd >= 0) close(fd);
}

static void look_at_cloud(void *ctx, const char *sha256) {
    struct check *check = ctx;
    char name[JOB_HASH_BYTES + 16];
    check->clouds++;
    snprintf(name, sizeof name, "clouds/%.64s", sha256);
    look_at_file(check, store_cloud_open(check->store, sha256), name, UINT64_MAX, sha256);
}

static void look_at_output(void *ctx, const char *id, int attempt, const struct job_output *output) {
    struct check *check = ctx;
    char name[JOB_ID_BYTES + JOB_OUTPUT_NAME_BYTES + 32];
    check->outputs++;
    snprintf(name, sizeof name, "jobs/%.40s/outputs/%.60s", id, output->name);
    look_at_file(check, store_output_open(check->store, id, attempt, output->name), name, output->bytes,
                 output->sha256);
}

static void look_at_job(void *ctx, const char *id, int attempt, int64_t state, uint64_t outputs) {
    struct check *check = ctx;
    check->jobs++;
    if (!job_id_valid(id)) damaged(check, "'%.60s' is no job's id", id);
    if (state < 0 || state >= JOB_STATE_COUNT) damaged(check, "job %s has no state %lld", id, (long long)state);
    if (state == JOB_RUNNING) unfinished(check, "job %s was running; it will be queued again", id);
    if (state == JOB_SUCCESSFUL && !outputs) damaged(check, "job %s is successful and has no outputs", id);
    if (state != JOB_SUCCESSFUL && outputs) damaged(check, "job %s has outputs and is not successful", id);
    int there = state == JOB_SUCCESSFUL ? store_outputs_count(check->store, id, attempt) : -1;
    if (there > (int)outputs)
        damaged(check, "jobs/%s/outputs has %d files, not %llu", id, there, (unsigned long long)outputs);
    if (state != JOB_SUCCESSFUL && store_outputs_exist(check->store, id, attempt))
        unfinished(check, "jobs/%s/outputs are of a run whose end was not recorded", id);
}

/* ------------------------------------------------------------------------------------------------ files */

static void look_at_name(struct check *check, enum catalog_thing thing, const char *folder, const char *name) {
    struct error error = {0};
    bool known = false;
    if (catalog_knows(check->catalog, thing, name, &known, &error) != STATUS_OK)
        damaged(check, "%s", error.text);
    else if (!known)
        unfinished(check, "%s/%s belongs to nothing", folder, name);
}

static void look_at_thing(void *ctx, enum store_thing thing, const char *name) {
    struct check *check = ctx;
    switch (thing) {
    case STORE_CLOUD: look_at_name(check, CATALOG_CLOUD, "clouds", name); break;
    case STORE_JOB: look_at_name(check, CATALOG_JOB, "jobs", name); break;
    case STORE_PART: look_at_name(check, CATALOG_UPLOAD, "uploads", name); break;
    case STORE_TEMPORARY: unfinished(check, "tmp/%s is half written, or half removed", name); break;
    }
}

/* ------------------------------------------------------------------------------------------------ the whole */

/* A stranger's database, which the start would refuse. */
static void look_at_identity(struct check *check) {
    struct error error = {0};
    char folders[SCRATCH_IDENTITY_BYTES], databases[CATALOG_IDENTITY_BYTES] = "";
    enum status status = scratch_identity(store_scratch(check->store), folders, &error);
    if (status == STATUS_OK) status = catalog_identity(check->catalog, databases, &error);
    if (status != STATUS_OK) damaged(check, "%s", error.text);
    if (folders[0] && databases[0] && strcmp(folders, databases) != 0)
        damaged(check, "the database is of another folder: put this folder's own back, or run check --adopt");
}

static void look_at_lost(const struct check *check) {
    uint64_t count = store_lost(check->store);
    if (count)
        printf("set aside: lost+found has %llu clouds, jobs and uploads that no database knew; remove what isn't "
               "wanted\n",
               (unsigned long long)count);
}

static void look_at_everything(struct check *check) {
    struct error error = {0};
    struct catalog_examiner examiner = {.damaged = hear_of_damage,
                                        .unfinished = hear_of_unfinished,
                                        .job = look_at_job,
                                        .cloud = look_at_cloud,
                                        .output = look_at_output,
                                        .ctx = check};
    catalog_examine(check->catalog, &examiner);
    look_at_identity(check);
    if (store_each(check->store, look_at_thing, check, &error) != STATUS_OK) damaged(check, "%s", error.text);
    look_at_lost(check);
}

static enum status open_both(const struct config *config, struct check *check, struct error *error) {
    char url[CATALOG_URL_BYTES];
    catalog_url(config->catalog, config->data, url);
    if (!catalog_exists(url)) return error_set(error, STATUS_IO, "check", "there is no %s", url);
    enum status status = store_open(config->data, config->blobs, &check->store, error);
    return status == STATUS_OK ? catalog_open_as_is(url, &check->catalog, error) : status;
}

/* Makes folder and database belong together, whatever they were before. */
static enum status adopt(const struct config *config, struct error *error) {
    struct store *store = NULL;
    struct catalog *catalog = NULL;
    char url[CATALOG_URL_BYTES];
    catalog_url(config->catalog, config->data, url);
    enum status status = store_open(config->data, config->blobs, &store, error);
    if (status == STATUS_OK) status = catalog_open(url, &catalog, error);
    if (status == STATUS_OK) status = identity_adopt(store, catalog, error);
    if (status == STATUS_OK) printf("adopted: %s and its files belong together now\n", url);
    catalog_close(catalog);
    store_close(store);
    return status;
}

/* Takes `--adopt` out of the arguments, the rest of which are settings. */
static bool take_adopt(int *argc, char **argv) {
    int kept = 0;
    for (int i = 0; i < *argc; i++)
        if (strcmp(argv[i], "--adopt") != 0) argv[kept++] = argv[i];
    bool found = kept < *argc;
    *argc = kept;
    argv[kept] = NULL;
    return found;
}

int check_main(int argc, char **argv) {
    struct check check = {0};
    struct config config;
    struct error error = {0};
    bool adopts = take_adopt(&argc, argv);
    enum config_request request = settings_read(&config, argc, argv, &error);
    if (request == CONFIG_TOLD) return WHOLE;
    enum status status = request == CONFIG_RUN ? STATUS_OK : error.code;
    if (status == STATUS_OK && adopts) status = adopt(&config, &error);
    if (status == STATUS_OK) status = open_both(&config, &check, &error);
    if (status == STATUS_OK) {
        look_at_everything(&check);
        printf("checked %zu jobs, %zu clouds, %zu outputs: %zu damaged, %zu unfinished\n", check.jobs, check.clouds,
               check.outputs, check.damaged, check.unfinished);
    } else {
        fprintf(stderr, "whittled: %s: %s\n", error.where, error.text);
    }
    bool looked_at = status == STATUS_OK || (check.store && !error_is_away(&error)); /* else the database is broken */
    catalog_close(check.catalog);
    store_close(check.store);
    if (!looked_at) return NOT_LOOKED_AT;
    return status == STATUS_OK && !check.damaged ? WHOLE : DAMAGED;
}
