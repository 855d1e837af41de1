/* The store: names, and what lies where.
 *
 * Names come from ids and hashes that this program made, or are checked against the catalog before they get here; all
 * the same a blob whose name leads elsewhere is refused (blobs/blobs.h).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/storage/store.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/base/fault.h"
#include "server/base/away.h"
#include "server/base/digest.h"
#include "server/blobs/blobs.h"
#include "server/blobs/lost_found.h"

static const char clouds[] = "clouds", jobs[] = "jobs", uploads[] = "uploads";

struct store {
    struct scratch *scratch;
    struct blobs *blobs;
    bool is_apart; /* the blobs aren't in the scratch's folder */
};

static enum status store_refused(struct error *error, const char *what, const char *name) {
    return error_set(error, status_from_errno(errno), "store", "can't %s %s: %s", what, name, strerror(errno));
}

/* ------------------------------------------------------------------------------------------------ open */

enum status store_open(const char *folder, const char *blobs, struct store **store, struct error *error) {
    char url[BLOBS_URL_BYTES];
    struct store *opened = alloc_zeroed(1, sizeof *opened);
    if (!opened) return error_set(error, STATUS_NO_MEMORY, "store", "no memory");
    opened->is_apart = blobs[0] != 0;
    enum status status = scratch_open(folder, &opened->scratch, error);
    if (status == STATUS_OK) {
        blobs_url(blobs, scratch_folder(opened->scratch), url);
        status = blobs_open(url, scratch_folder(opened->scratch), &opened->blobs, error);
    }
    if (status == STATUS_OK)
        *store = opened;
    else
        store_close(opened);
    return status;
}

void store_close(struct store *store) {
    if (!store) return;
    blobs_close(store->blobs);
    scratch_close(store->scratch);
    free(store);
}

struct scratch *store_scratch(struct store *store) {
    return store->scratch;
}

/* ------------------------------------------------------------------------------------------------ clouds */

static void cloud_name(const char *sha256, char name[BLOBS_NAME_BYTES]) {
    snprintf(name, BLOBS_NAME_BYTES, "%s/%.80s", clouds, sha256);
}

enum status store_upload_keep(struct store *store, struct scratch_file *upload, const char *sha256,
                              struct error *error) {
    struct blobs_source source = scratch_file_source(store->scratch, upload, sha256, sha256);
    enum status status = blobs_put(store->blobs, clouds, &source, 1, error);
    if (status == STATUS_OK) scratch_file_drop(store->scratch, upload);
    return status;
}

void store_watch_unfinished(struct store *store, const struct blobs_unfinished *unfinished) {
    blobs_watch_unfinished(store->blobs, unfinished);
}

bool store_give_up(struct store *store, const char *what) { return blobs_give_up(store->blobs, what); }

static int read_part(struct store *store, const char *name, const struct blobs_facts *known,
                     const struct store_range *range) {
    struct blobs_facts facts = *known;
    if (!range) return blobs_read(store->blobs, name, &facts);
    if (range->of) facts.bytes = range->of;
    return blobs_read_range(store->blobs, name, &facts, range->first, range->last);
}

static bool link_to(struct store *store, const char *name, const struct store_link *link) {
    return blobs_link(store->blobs, name, link->seconds, link->type, link->disposition, link->url, BLOBS_LINK_BYTES);
}

int store_cloud_open(struct store *store, const char *sha256) { return store_cloud_open_range(store, sha256, NULL); }

int store_cloud_open_range(struct store *store, const char *sha256, const struct store_range *range) {
    const struct blobs_facts facts = {.sha256 = sha256};
    char name[BLOBS_NAME_BYTES];
    cloud_name(sha256, name);
    return read_part(store, name, &facts, range);
}

bool store_cloud_link(struct store *store, const char *sha256, const struct store_link *link) {
    char name[BLOBS_NAME_BYTES];
    cloud_name(sha256, name);
    return link_to(store, name, link);
}

bool store_cloud_exists(struct store *store, const char *sha256) {
    char name[BLOBS_NAME_BYTES];
    cloud_name(sha256, name);
    return blobs_exist(store->blobs, name);
}

bool store_cloud_delete(struct store *store, const char *sha256, struct blobs_removal *removal) {
    char name[BLOBS_NAME_BYTES];
    cloud_name(sha256, name);
    return blobs_remove(store->blobs, name, removal);
}

bool store_is_remote(const struct store *store) { return blobs_is_remote(store->blobs); }

enum status store_part_keep(struct store *store, const char *id, const char *sha256, struct error *error) {
    struct scratch_file file;
    enum status status = scratch_part_link(store->scratch, id, &file, error);
    if (status != STATUS_OK) return status;
    struct blobs_source source = scratch_file_source(store->scratch, &file, sha256, sha256);
    status = blobs_put(store->blobs, clouds, &source, 1, error);
    scratch_file_drop(store->scratch, &file);
    return status;
}

/* ------------------------------------------------------------------------------------------------ pieces */

enum status store_piece_keep(struct store *store, const char *upload, const char *name, const char *sha256,
                             struct scratch_file *file, struct error *error) {
    char folder[BLOBS_NAME_BYTES];
    struct blobs_source source = scratch_file_source(store->scratch, file, name, sha256);
    snprintf(folder, sizeof folder, "%s/%.60s", uploads, upload);
    enum status status = blobs_put(store->blobs, folder, &source, 1, error);
    scratch_file_drop(store->scratch, file);
    return status;
}

enum status store_piece_copy(struct store *store, const char *upload, const char *name, int to, struct error *error) {
    char path[BLOBS_NAME_BYTES];
    const char *hash = strstr(name, "--");
    const struct blobs_facts facts = {.sha256 = hash ? hash + 2 : NULL};
    snprintf(path, sizeof path, "%s/%.60s/%.80s", uploads, upload, name);
    int fd = blobs_read(store->blobs, path, &facts);
    enum status status = STATUS_OK;
    if (fd < 0 && errno == EHOSTUNREACH)
        status = error_set(error, STATUS_IO, AWAY, "the store doesn't give %s", path);
    else if (fd < 0 || folders_copy(fd, to) != 0)
        status = store_refused(error, "read", path);
    folders_close(fd);
    return status;
}

void store_pieces_delete(struct store *store, const char *upload) {
    char folder[BLOBS_NAME_BYTES];
    snprintf(folder, sizeof folder, "%s/%.60s", uploads, upload);
    blobs_remove(store->blobs, folder, NULL);
}

bool store_marked_delete(struct store *store, const char *name) { return blobs_remove(store->blobs, name, NULL); }

/* ------------------------------------------------------------------------------------------------ outputs */

/* The folder of an attempt's outputs; earlier versions had one name for all. */
static void outputs_name(const char *id, int attempt, char name[BLOBS_NAME_BYTES]) {
    if (attempt > 1)
        snprintf(name, BLOBS_NAME_BYTES, "%s/%.70s/outputs.%d", jobs, id, attempt);
    else
        snprintf(name, BLOBS_NAME_BYTES, "%s/%.70s/outputs", jobs, id);
}

/* The same of outputs that are there already.  Of a data folder that holds its blobs itself, those of a later attempt
 * may be of an earlier version.  Elsewhere the folder without a number is of the first attempt alone, perhaps left by a
 * host that died, and nobody else's. */
static void find_outputs(struct store *store, const char *id, int attempt, char name[BLOBS_NAME_BYTES]) {
    outputs_name(id, attempt, name);
    if (attempt > 1 && !store->is_apart && !blobs_exist(store->blobs, name)) outputs_name(id, 1, name);
}

/* Hashes and flushes one output. */
static enum status take_output(int folder_fd, const char *name, const struct digest_will *will,
                               struct job_output *output, struct error *error) {
    int fd = fault_at("output-open") ? -1 : openat(folder_fd, name, O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK);
    struct stat facts;
    if (fd < 0) return store_refused(error, "open", name);
    enum status status = STATUS_OK;
    if (fstat(fd, &facts) != 0 || !S_ISREG(facts.st_mode))
        status = error_set(error, STATUS_IO, "store", "%s is no file", name);
    else if (digest_file_while(fd, will, output->sha256, &output->bytes) != 0 || fault_at("output-sync") ||
             fsync(fd) != 0)
        status = store_refused(error, "read", name);
    snprintf(output->name, sizeof output->name, "%.*s", JOB_OUTPUT_NAME_BYTES - 1, name);
    close(fd);
    return status;
}

struct taking {
    int folder_fd;
    const struct digest_will *will;
    struct job_output *outputs;
    size_t count;
    enum status status;
    struct error *error;
};

static void take_next(void *ctx, const char *name) {
    struct taking *taking = ctx;
    if (taking->status != STATUS_OK) return;
    if (taking->count == JOB_MAX_OUTPUTS || strlen(name) >= JOB_OUTPUT_NAME_BYTES)
        taking->status =
            error_set(taking->error, STATUS_IO, "store", "too many outputs, or too long a name: %.80s", name);
    else
        taking->status =
            take_output(taking->folder_fd, name, taking->will, &taking->outputs[taking->count++], taking->error);
}

/* In the data folder those of an earlier version's run, whose end was never recorded, are removed first: it had one
 * name for all attempts. */
static enum status put_outputs(struct store *store, int folder_fd, const char *folder, const struct job_output *outputs,
                               size_t count, struct error *error) {
    struct blobs_source sources[JOB_MAX_OUTPUTS];
    for (size_t i = 0; i < count; i++)
        sources[i] = (struct blobs_source){outputs[i].name, folder_fd, outputs[i].name, outputs[i].sha256};
    if (!store->is_apart) blobs_remove(store->blobs, folder, NULL);
    return blobs_put(store->blobs, folder, sources, count, error);
}

enum status store_outputs_keep(struct store *store, const char *id, int attempt, const struct digest_will *will,
                               struct job_output *outputs, size_t *count, struct error *error) {
    char folder[BLOBS_NAME_BYTES];
    int folder_fd = scratch_run_open(store->scratch, id, attempt);
    struct taking taking = {.folder_fd = folder_fd, .will = will, .outputs = outputs, .error = error};
    if (folder_fd < 0) return store_refused(error, "open the outputs of", id);
    if (folders_each(folder_fd, take_next, &taking) != 0) taking.status = store_refused(error, "list", "outputs");
    outputs_name(id, attempt, folder);
    enum status status = taking.status;
    if (status == STATUS_OK) status = put_outputs(store, folder_fd, folder, outputs, taking.count, error);
    close(folder_fd);
    if (status == STATUS_OK) scratch_run_drop(store->scratch, id, attempt);
    *count = taking.count;
    return status;
}

enum status store_outputs_share(struct store *store, const char *from_id, int from_attempt, const char *to_id,
                                struct error *error) {
    char from[BLOBS_NAME_BYTES], to[BLOBS_NAME_BYTES];
    find_outputs(store, from_id, from_attempt, from);
    outputs_name(to_id, 0, to);
    enum status status = blobs_copy(store->blobs, from, to, error);
    if (status != STATUS_OK) blobs_remove(store->blobs, to, NULL);
    return status;
}

/* false: no output is called so. */
static bool output_path(struct store *store, const char *id, int attempt, const char *name,
                        char path[BLOBS_NAME_BYTES + JOB_OUTPUT_NAME_BYTES]) {
    char folder[BLOBS_NAME_BYTES];
    find_outputs(store, id, attempt, folder);
    snprintf(path, BLOBS_NAME_BYTES + JOB_OUTPUT_NAME_BYTES, "%s/%.*s", folder, JOB_OUTPUT_NAME_BYTES - 1, name);
    return !strchr(name, '/');
}

int store_output_open(struct store *store, const char *id, int attempt, const char *name) {
    char path[BLOBS_NAME_BYTES + JOB_OUTPUT_NAME_BYTES];
    errno = ENOENT;
    return output_path(store, id, attempt, name, path) ? blobs_read(store->blobs, path, NULL) : -1;
}

int store_output_open_range(struct store *store, const char *id, int attempt, const struct job_output *output,
                            const struct store_range *range) {
    const struct blobs_facts facts = {output->sha256, output->bytes};
    char path[BLOBS_NAME_BYTES + JOB_OUTPUT_NAME_BYTES];
    errno = ENOENT;
    return output_path(store, id, attempt, output->name, path) ? read_part(store, path, &facts, range) : -1;
}

bool store_output_link(struct store *store, const char *id, int attempt, const char *name,
                       const struct store_link *link) {
    char path[BLOBS_NAME_BYTES + JOB_OUTPUT_NAME_BYTES];
    return output_path(store, id, attempt, name, path) && link_to(store, path, link);
}

bool store_outputs_exist(struct store *store, const char *id, int attempt) {
    char folder[BLOBS_NAME_BYTES];
    find_outputs(store, id, attempt, folder);
    return blobs_exist(store->blobs, folder);
}

static void count_one(void *ctx, const char *name) {
    (void)name;
    ++*(int *)ctx;
}

int store_outputs_count(struct store *store, const char *id, int attempt) {
    char folder[BLOBS_NAME_BYTES];
    struct error error = {0};
    int count = 0;
    find_outputs(store, id, attempt, folder);
    return blobs_list(store->blobs, folder, count_one, &count, &error) == STATUS_OK ? count : -1;
}

void store_outputs_delete(struct store *store, const char *id, int attempt) {
    char folder[BLOBS_NAME_BYTES];
    outputs_name(id, attempt, folder);
    blobs_remove(store->blobs, folder, NULL);
}

/* ------------------------------------------------------------------------------------------------ tiles */

static void tiles_name(const char *id, char name[BLOBS_NAME_BYTES]) {
    snprintf(name, BLOBS_NAME_BYTES, "%s/%.70s/tiles", jobs, id);
}

struct keeping {
    struct store *store;
    const char *folder;
    int folder_fd;
    const struct digest_will *will;
    size_t count;
    enum status status;
    struct error *error;
};

/* One at a time: a plan may have thousands. */
static void keep_next(void *ctx, const char *name) {
    struct keeping *keeping = ctx;
    struct job_output file;
    if (keeping->status != STATUS_OK) return;
    keeping->status = take_output(keeping->folder_fd, name, keeping->will, &file, keeping->error);
    const struct blobs_source source = {file.name, keeping->folder_fd, file.name, file.sha256};
    if (keeping->status == STATUS_OK)
        keeping->status = blobs_put(keeping->store->blobs, keeping->folder, &source, 1, keeping->error);
    if (keeping->status == STATUS_OK) unlinkat(keeping->folder_fd, name, 0); /* where the store has a copy */
    keeping->count++;
}

enum status store_tiles_keep(struct store *store, const char *id, int attempt, const struct digest_will *will,
                             struct error *error) {
    char folder[BLOBS_NAME_BYTES];
    int folder_fd = scratch_run_open(store->scratch, id, attempt);
    struct keeping keeping = {.store = store, .folder = folder, .folder_fd = folder_fd, .will = will, .error = error};
    if (folder_fd < 0) return store_refused(error, "open what was made of", id);
    tiles_name(id, folder);
    do { /* until nothing is left: a listing may leave out names while others go */
        keeping.count = 0;
        if (folders_each(folder_fd, keep_next, &keeping) != 0)
            keeping.status = store_refused(error, "list what was made of", id);
    } while (keeping.status == STATUS_OK && keeping.count);
    close(folder_fd);
    return keeping.status;
}

int store_tiles_open(struct store *store, const char *id, const char *name) {
    char folder[BLOBS_NAME_BYTES], path[2 * BLOBS_NAME_BYTES];
    tiles_name(id, folder);
    snprintf(path, sizeof path, "%s/%.100s", folder, name);
    return blobs_read(store->blobs, path, NULL);
}

bool store_tiles_delete(struct store *store, const char *id) {
    char folder[BLOBS_NAME_BYTES];
    tiles_name(id, folder);
    return blobs_remove(store->blobs, folder, NULL);
}

/* ------------------------------------------------------------------------------------------------ jobs */

int store_log_open(struct store *store, const char *id, bool append) {
    return scratch_log_open(store->scratch, id, append);
}

enum status store_log_share(struct store *store, const char *id, const char *host, struct error *error) {
    char folder[BLOBS_NAME_BYTES], name[FOLDERS_NAME_BYTES], sha256[DIGEST_HEX_BYTES];
    struct scratch_file file = {.fd = -1};
    uint64_t bytes;
    int log_fd = scratch_log_open(store->scratch, id, false);
    if (log_fd < 0) return STATUS_OK;
    snprintf(folder, sizeof folder, "%s/%.80s", jobs, id);
    snprintf(name, sizeof name, "log.%.40s", host);
    enum status status = scratch_file_begin(store->scratch, &file, error);
    if (status == STATUS_OK && (folders_copy(log_fd, file.fd) != 0 || digest_file(file.fd, sha256, &bytes) != 0))
        status = store_refused(error, "copy the log of", id);
    if (status == STATUS_OK) status = scratch_file_sync(&file, error);
    if (status == STATUS_OK) {
        struct blobs_source source = scratch_file_source(store->scratch, &file, name, sha256);
        status = blobs_put(store->blobs, folder, &source, 1, error);
    }
    scratch_file_drop(store->scratch, &file);
    close(log_fd);
    return status;
}

struct gathering {
    struct store *store;
    const char *folder;
    int to_fd;
    size_t found;
    int error; /* an errno; 0 = none: all that there was could be read */
};

static void gather_log(void *ctx, const char *name) {
    struct gathering *gathering = ctx;
    char path[2 * BLOBS_NAME_BYTES];
    if (strncmp(name, "log.", 4) != 0) return;
    snprintf(path, sizeof path, "%s/%.200s", gathering->folder, name);
    int fd = blobs_read(gathering->store->blobs, path, NULL);
    if (fd >= 0 && folders_copy(fd, gathering->to_fd) == 0)
        gathering->found++;
    else if (errno != ENOENT)
        gathering->error = errno;
    folders_close(fd);
}

int store_log_gather(struct store *store, const char *id) {
    char folder[BLOBS_NAME_BYTES];
    struct error error = {0};
    struct gathering gathering = {store, folder, scratch_nameless_open(store->scratch), 0, 0};
    if (gathering.to_fd < 0) return -1;
    snprintf(folder, sizeof folder, "%s/%.80s", jobs, id);
    enum status status = blobs_list(store->blobs, folder, gather_log, &gathering, &error);
    bool is_all = status == STATUS_OK && !gathering.error;
    if (is_all && gathering.found && lseek(gathering.to_fd, 0, SEEK_SET) == 0) return gathering.to_fd;
    close(gathering.to_fd);
    int own_fd = scratch_log_open(store->scratch, id, false);
    if (own_fd < 0 && !is_all) errno = gathering.error ? gathering.error : EHOSTUNREACH;
    return own_fd;
}

/* The log lies in the same folder where the blobs are in the data folder. */
bool store_job_delete(struct store *store, const char *id) {
    char folder[BLOBS_NAME_BYTES];
    snprintf(folder, sizeof folder, "%s/%.80s", jobs, id);
    if (store->is_apart) scratch_log_delete(store->scratch, id);
    return blobs_remove(store->blobs, folder, NULL);
}

/* ------------------------------------------------------------------------------------------------ all of it */

struct telling {
    void (*found)(void *ctx, enum store_thing thing, const char *name);
    void *ctx;
    enum store_thing thing;
};

static void tell_one(void *ctx, const char *name) {
    const struct telling *telling = ctx;
    telling->found(telling->ctx, telling->thing, name);
}

/* Tells of each cloud, job and part; jobs that have a log alone among them. */
enum status store_each(struct store *store, void (*found)(void *ctx, enum store_thing thing, const char *name),
                       void *ctx, struct error *error) {
    struct telling telling = {found, ctx, STORE_CLOUD};
    enum status status = blobs_list(store->blobs, clouds, tell_one, &telling, error);
    telling.thing = STORE_JOB;
    if (status == STATUS_OK) status = blobs_list(store->blobs, jobs, tell_one, &telling, error);
    if (status != STATUS_OK) return status;
    telling.thing = STORE_PART;
    bool listed = scratch_each_part(store->scratch, tell_one, &telling) == 0;
    telling.thing = STORE_TEMPORARY;
    listed = listed && scratch_each_temporary(store->scratch, tell_one, &telling) == 0;
    return listed ? STATUS_OK : store_refused(error, "list", scratch_folder(store->scratch));
}

/* ------------------------------------------------------------------------------------------------ clean */

struct cleaning {
    struct store *store;
    enum store_fate (*fate)(void *ctx, enum store_thing thing, const char *name);
    void *ctx;
    char start[LOST_FOUND_NAME_BYTES];
    struct store_cleaned *cleaned;
};

static void remove_thing(struct store *store, enum store_thing thing, const char *name) {
    if (thing == STORE_CLOUD) store_cloud_delete(store, name, NULL);
    if (thing == STORE_JOB) store_job_delete(store, name);
    if (thing == STORE_PART) scratch_part_delete(store->scratch, name);
}

static bool set_thing_aside(struct cleaning *cleaning, enum store_thing thing, const char *name) {
    struct store *store = cleaning->store;
    struct error error = {0};
    char *place = cleaning->cleaned->place;
    if (thing == STORE_PART) return scratch_part_set_aside(store->scratch, cleaning->start, name, place);
    return blobs_set_aside(store->blobs, cleaning->start, thing == STORE_CLOUD ? clouds : jobs, name, place, &error) ==
           STATUS_OK;
}

static void clean_one(void *ctx, enum store_thing thing, const char *name) {
    struct cleaning *cleaning = ctx;
    if (thing == STORE_TEMPORARY) return;
    enum store_fate fate = cleaning->fate(cleaning->ctx, thing, name);
    if (fate == STORE_REMOVE) {
        remove_thing(cleaning->store, thing, name);
        cleaning->cleaned->removed++;
    } else if (fate == STORE_SET_ASIDE && set_thing_aside(cleaning, thing, name)) {
        cleaning->cleaned->set_aside++;
    } else if (fate == STORE_SET_ASIDE) {
        cleaning->cleaned->left++;
    }
}

enum status store_clean(struct store *store,
                        enum store_fate (*fate)(void *ctx, enum store_thing thing, const char *name), void *ctx,
                        struct store_cleaned *cleaned, struct error *error) {
    struct cleaning cleaning = {.store = store, .fate = fate, .ctx = ctx, .cleaned = cleaned};
    *cleaned = (struct store_cleaned){0};
    lost_found_name_start(cleaning.start);
    if (scratch_wipe(store->scratch, &cleaned->removed) != 0)
        return store_refused(error, "list", scratch_folder(store->scratch));
    return store_each(store, clean_one, &cleaning, error);
}

uint64_t store_lost(struct store *store) { return scratch_lost(store->scratch); }
