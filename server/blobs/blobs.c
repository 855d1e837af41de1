/* Blobs: picks the backend, and hands every use to it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/blobs/blobs.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>

#include "server/blobs/blobs_backend.h"

#define BACKEND(name) &name,
static const struct blobs_backend *const backends[] = {BLOBS_BACKENDS(BACKEND)};
#undef BACKEND
enum { BACKENDS = sizeof backends / sizeof *backends };

/* NULL: no backend has URLs like this one. */
static const struct blobs_backend *backend_of_url(const char *url, const char **where) {
    for (size_t i = 0; i < BACKENDS; i++) {
        size_t length = strlen(backends[i]->scheme);
        *where = url + length;
        if (strncmp(url, backends[i]->scheme, length) == 0 && backends[i]->is_valid(*where)) return backends[i];
    }
    return NULL;
}

bool blobs_url_valid(const char *url) {
    const char *where;
    return backend_of_url(url, &where) != NULL;
}

void blobs_url(const char *setting, const char *folder, char url[BLOBS_URL_BYTES]) {
    snprintf(url, BLOBS_URL_BYTES, "%s%.4100s", setting[0] ? "" : "file:", setting[0] ? setting : folder);
}

enum status blobs_open(const char *url, const char *folder, struct blobs **blobs, struct error *error) {
    const char *where;
    const struct blobs_backend *backend = backend_of_url(url, &where);
    if (!backend) return error_set(error, STATUS_BAD_PARAMETER, "blobs", "'%.200s' is no URL of a blob store", url);
    return backend->open(where, folder, blobs, error);
}

void blobs_close(struct blobs *blobs) {
    if (blobs) blobs->backend->close(blobs);
}

/* Names are made of ids and hashes, and of what clients say a job's output is called: one that leads elsewhere, or to
 * what is hidden, is nobody's. */
static bool is_name(const char *name) {
    bool starts = true;
    for (const char *c = name; *c; c++) {
        if (starts && (*c == '.' || *c == '/')) return false;
        starts = *c == '/';
    }
    return !starts && strlen(name) < BLOBS_NAME_BYTES;
}

enum status blobs_put(struct blobs *blobs, const char *folder, const struct blobs_source *sources, size_t count,
                      struct error *error) {
    bool are_names = is_name(folder);
    for (size_t i = 0; i < count; i++)
        are_names = are_names && is_name(sources[i].name) && !strchr(sources[i].name, '/') &&
                    strlen(folder) + 1 + strlen(sources[i].name) < BLOBS_NAME_BYTES;
    if (!are_names) return error_set(error, STATUS_BAD_PARAMETER, "blobs", "%.200s has no names of blobs", folder);
    return blobs->backend->put(blobs, folder, sources, count, error);
}

enum status blobs_copy(struct blobs *blobs, const char *from_folder, const char *to_folder, struct error *error) {
    return blobs->backend->copy(blobs, from_folder, to_folder, error);
}

int blobs_read(struct blobs *blobs, const char *name, const struct blobs_facts *facts) {
    errno = ENOENT;
    return is_name(name) ? blobs->backend->read(blobs, name, facts) : -1;
}

int blobs_read_range(struct blobs *blobs, const char *name, const struct blobs_facts *facts, uint64_t first,
                     uint64_t last) {
    if (!blobs->backend->read_range) return blobs_read(blobs, name, facts);
    errno = ENOENT;
    return is_name(name) ? blobs->backend->read_range(blobs, name, facts, first, last) : -1;
}

bool blobs_link(struct blobs *blobs, const char *name, unsigned seconds, const char *type, const char *disposition,
                char *url, size_t bytes) {
    return blobs->backend->link && is_name(name) &&
           blobs->backend->link(blobs, name, seconds, type, disposition, url, bytes);
}

void blobs_watch_unfinished(struct blobs *blobs, const struct blobs_unfinished *unfinished) {
    blobs->unfinished = *unfinished;
}

bool blobs_give_up(struct blobs *blobs, const char *what) {
    return !blobs->backend->give_up || blobs->backend->give_up(blobs, what);
}

bool blobs_exist(struct blobs *blobs, const char *name) { return is_name(name) && blobs->backend->exist(blobs, name); }

bool blobs_remove(struct blobs *blobs, const char *name, struct blobs_removal *removal) {
    struct blobs_removal unasked = {0};
    if (!removal) removal = &unasked;
    removal->is_settled = true;
    return is_name(name) && blobs->backend->remove(blobs, name, removal);
}

bool blobs_is_remote(const struct blobs *blobs) { return blobs->backend->is_remote; }

enum status blobs_list(struct blobs *blobs, const char *folder, void (*found)(void *ctx, const char *name), void *ctx,
                       struct error *error) {
    return blobs->backend->list(blobs, folder, found, ctx, error);
}

enum status blobs_set_aside(struct blobs *blobs, const char *start, const char *folder, const char *name,
                            char place[64], struct error *error) {
    return blobs->backend->set_aside(blobs, start, folder, name, place, error);
}
