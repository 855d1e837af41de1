/* Blobs: named bytes that never change, kept for as long as the catalog's rows name them.
 *
 * A blob appears whole or not at all, and stays as it is until it is removed; bytes are on disk (or acknowledged by
 * whoever keeps them) when blobs_put returns.  What a blob is for, and so its name, is known above (storage/store.h): a
 * name is a path of two to four parts, such as clouds/<sha256>, made by this program.
 *
 * A backend is a folder below this one that implements these functions (blobs_backend.h); a URL picks it when the
 * service starts.  All functions may be called from any thread, and block on the disk or the network.
 *
 * Statuses: STATUS_IO with a text when the backend refuses, STATUS_NO_SPACE, STATUS_NO_MEMORY; others as said.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_SERVER_BLOBS_BLOBS_H
#define WHITTLE_SERVER_BLOBS_BLOBS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

struct blobs;

enum { BLOBS_URL_BYTES = 4200, BLOBS_NAME_BYTES = 256, BLOBS_LINK_BYTES = 4096, BLOBS_UNFINISHED_BYTES = 480 };

/* Whether a setting may be the URL of a blob store: file:PATH, or s3://BUCKET/PREFIX?endpoint=URL (s3/s3_client.h). */
bool blobs_url_valid(const char *url);

/* The URL that a setting stands for: "" is the data folder. */
void blobs_url(const char *setting, const char *folder, char url[BLOBS_URL_BYTES]);

/* Opens it; folders that are missing are made, buckets not.  Copies of what is read may go to the folder, which is of
 * this host.  blobs_close accepts NULL. */
enum status blobs_open(const char *url, const char *folder, struct blobs **blobs, struct error *error) MUST_CHECK;
void blobs_close(struct blobs *blobs);

/* A file that is to become a blob: complete, and flushed. */
struct blobs_source {
    const char *name; /* below the folder that it is put into; one part */
    int folder_fd;    /* where it is now, with the name that it has there; both borrowed */
    const char *file;
    const char *sha256; /* of its content, in hexadecimal: a backend that copies checks it */
};

/* Makes each file the blob folder/name; one of that name which is there already is replaced.  The files are gone from
 * where they were, or the caller's still.  When it fails, some may be blobs and some not.  STATUS_MALFORMED: the
 * content isn't what its hash says. */
enum status blobs_put(struct blobs *blobs, const char *folder, const struct blobs_source *sources, size_t count,
                      struct error *error) MUST_CHECK;

/* Makes the blobs of one folder those of another one too; removing one leaves the other. */
enum status blobs_copy(struct blobs *blobs, const char *from_folder, const char *to_folder,
                       struct error *error) MUST_CHECK;

/* What is known of a blob by who reads it: a backend that copies compares. */
struct blobs_facts {
    const char *sha256; /* in hexadecimal, or its first digits; NULL = isn't known */
    uint64_t bytes;     /* 0 = aren't known */
};

/* Opens a blob for reading, at any place; -1 with errno, ENOENT where there is none, EHOSTUNREACH where its store is
 * away, ENOSPC where there is no room for a copy, EIO where it isn't what is known of it (NULL = nothing is).  The
 * descriptor stays good when the blob is removed. */
int blobs_read(struct blobs *blobs, const char *name, const struct blobs_facts *facts);

/* The same for bytes first to last alone, at the places that they have in the blob: others of the file are any.  Their
 * hash isn't known.  A range that isn't in the blob: EIO. */
int blobs_read_range(struct blobs *blobs, const char *name, const struct blobs_facts *facts, uint64_t first,
                     uint64_t last);

/* A URL of the blob at its store that anybody may GET for so many seconds, where it is told as this type and this
 * Content-Disposition.  false: there are none. */
bool blobs_link(struct blobs *blobs, const char *name, unsigned seconds, const char *type, const char *disposition,
                char *url, size_t bytes);

/* Who is told of what a store keeps of a put that doesn't end, before there is anything (false: the put fails), and
 * when there is nothing of it any more.  To be set before the first put; without it nobody is told. */
struct blobs_unfinished {
    bool (*begins)(void *ctx, const char *what);
    void (*ends)(void *ctx, const char *what);
    void *ctx;
};
void blobs_watch_unfinished(struct blobs *blobs, const struct blobs_unfinished *unfinished);

/* Removes what there is of it.  false: some may be there still. */
bool blobs_give_up(struct blobs *blobs, const char *what);

/* Whether there is a blob of this name, or one below the folder of this name; a store that doesn't answer may have it.
 */
bool blobs_exist(struct blobs *blobs, const char *name);

enum { BLOBS_REMOVAL_S = 120 }; /* for how long a store takes a request of a removal */

/* The removal of a name that may be used again. */
struct blobs_removal {
    int64_t begun_ms; /* when it was decided, of clock_ms: a store takes no request of it BLOBS_REMOVAL_S later,
                       * however long this process or the request stood still; 0 = the name isn't used again */
    bool is_settled; /* set: nothing that was asked for is still on its way, to remove what is put by that name later */
};

/* Removes a blob, or a folder with all below it; what isn't there is removed already.  It is never seen in part by who
 * asks for it by a name, where the backend can help it.  false: some of it may be there still.  removal NULL: the name
 * isn't used again. */
bool blobs_remove(struct blobs *blobs, const char *name, struct blobs_removal *removal);

/* Whether it is asked over a network: what was asked for may be done when whoever has asked isn't there any more, and
 * nobody looks at the start for what a process that died has left there. */
bool blobs_is_remote(const struct blobs *blobs);

/* Tells of each name that follows the folder's, once, sorted by bytes: of blobs in it, and of folders below it.  A
 * folder that isn't there has none. */
enum status blobs_list(struct blobs *blobs, const char *folder, void (*found)(void *ctx, const char *name), void *ctx,
                       struct error *error) MUST_CHECK;

/* Moves folder/name, a blob or a folder, to where nobody looks, for whoever operates the service (lost_found.h): place
 * says where to.  STATUS_UNSUPPORTED: this backend has no such place. */
enum status blobs_set_aside(struct blobs *blobs, const char *start, const char *folder, const char *name,
                            char place[64], struct error *error) MUST_CHECK;

#endif
