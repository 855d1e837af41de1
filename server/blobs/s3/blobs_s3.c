/* Blobs as objects of an S3 store: prefix/name is the object's key.
 *
 * The store checks the hash of what is put: whole, or of each part of what is long, and the whole's is compared here.
 * What is read, all or a range, comes as a copy, into a file without a name in the folder that the store was opened
 * with, and is compared with what the reader knows of it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/base/fault.h"
#include "server/base/away.h"
#include "server/base/digest.h"
#include "server/base/folders.h"
#include "server/base/log.h"
#include "server/blobs/blobs_backend.h"
#include "server/blobs/s3/s3_client.h"

enum { FOLDER_BYTES = 4096, QUERY_BYTES = 4096, PATH_BYTES = 2 * BLOBS_NAME_BYTES };

struct blobs_s3 {
    struct blobs blobs; /* first */
    struct s3_client *client;
    char folder[FOLDER_BYTES]; /* for copies */
};

static struct blobs_s3 *s3_of(struct blobs *blobs) { return (struct blobs_s3 *)(void *)blobs; }

/* An answer that isn't the one that was hoped for: whoever asked for it may come again. */
static enum status refused(struct error *error, const char *what, const char *name, int code) {
    return error_set(error, STATUS_IO, AWAY, "can't %s %.200s: the store answered %d", what, name, code);
}

/* ------------------------------------------------------------------------------------------------ list */

/* The text between two tags, from *at on, which moves behind it; false: there is none. */
static bool next_between(const char **at, const char *open, const char *close, const char **text, size_t *length) {
    const char *start = strstr(*at, open);
    const char *end = start ? strstr(start, close) : NULL;
    if (!end) return false;
    *text = start + strlen(open);
    *length = (size_t)(end - *text);
    *at = end + strlen(close);
    return true;
}

struct listing {
    const char *prefix; /* of the keys, the client's own included */
    size_t skip;        /* so much of a key comes before the name */
    bool deep;          /* all below, else one level */
    void (*found)(void *ctx, const char *name);
    void *ctx;
};

/* Keys and, one level deep, the folders beside them; each without what it begins with and without a slash. */
static void tell_names(const struct listing *listing, const char *text, const char *open, const char *close) {
    const char *key;
    size_t length;
    while (next_between(&text, open, close, &key, &length)) {
        char name[PATH_BYTES];
        if (length <= listing->skip || length - listing->skip >= sizeof name) continue;
        if (strncmp(key, listing->prefix, listing->skip) != 0) continue;
        snprintf(name, sizeof name, "%.*s", (int)(length - listing->skip), key + listing->skip);
        if (name[strlen(name) - 1] == '/') name[strlen(name) - 1] = 0;
        listing->found(listing->ctx, name);
    }
}

/* Parameters in the order in which they are signed. */
static bool make_query(const struct listing *listing, const char *token, int most, char query[QUERY_BYTES]) {
    char *prefix = s3_client_encode(listing->prefix), *next = token ? s3_client_encode(token) : NULL;
    bool ok = prefix && (next || !token);
    int n = ok ? snprintf(query, QUERY_BYTES, "%s%s%s%slist-type=2&max-keys=%d&prefix=%s",
                          next ? "continuation-token=" : "", next ? next : "", next ? "&" : "",
                          listing->deep ? "" : "delimiter=%2F&", most, prefix)
               : 0;
    free(prefix);
    free(next);
    return ok && n > 0 && n < QUERY_BYTES;
}

/* Page by page. */
static enum status list_keys(struct blobs_s3 *s3, const struct listing *listing, struct error *error) {
    enum { PAGE = 1000 };
    char query[QUERY_BYTES], token[1024] = "";
    bool more = true;
    while (more) {
        struct s3_request request = {
            .method = "GET", .query = query, .to_fd = -1, .body_fd = -1, .ends_with = "</ListBucketResult>"};
        int code;
        if (!make_query(listing, token[0] ? token : NULL, PAGE, query))
            return error_set(error, STATUS_NO_MEMORY, "blobs", "no memory");
        enum status status = s3_client_ask(s3->client, &request, &code, error);
        if (status == STATUS_OK && code != 200) status = refused(error, "list", listing->prefix, code);
        more = false;
        if (status == STATUS_OK && request.text) {
            const char *at = request.text, *text;
            size_t length;
            tell_names(listing, request.text, "<Key>", "</Key>");
            tell_names(listing, request.text, "<CommonPrefixes><Prefix>", "</Prefix>");
            more = next_between(&at, "<NextContinuationToken>", "</NextContinuationToken>", &text, &length) &&
                   length < sizeof token;
            if (more) snprintf(token, sizeof token, "%.*s", (int)length, text);
            if (!more && strstr(request.text, "<IsTruncated>true"))
                status =
                    error_set(error, STATUS_IO, AWAY, "the store doesn't tell how %.200s goes on", listing->prefix);
        }
        free(request.text);
        if (status != STATUS_OK) return status;
    }
    return STATUS_OK;
}

/* Names that are kept until all are known: they are told in order, and what is told may ask again. */
struct names {
    char **name;
    size_t count, room;
    bool lost; /* one, for want of memory */
};

static void keep_name(void *ctx, const char *name) {
    struct names *names = ctx;
    if (names->count == names->room) {
        size_t room = names->room ? 2 * names->room : 16;
        char **grown = reallocarray(names->name, room, sizeof *grown);
        names->lost = names->lost || !grown;
        if (!grown) return;
        names->name = grown;
        names->room = room;
    }
    names->name[names->count] = strdup(name);
    if (names->name[names->count])
        names->count++;
    else
        names->lost = true;
}

static void free_names(struct names *names) {
    for (size_t i = 0; i < names->count; i++) free(names->name[i]);
    free(names->name);
}

static int by_bytes(const void *a, const void *b) { return strcmp(*(char *const *)a, *(char *const *)b); }

static enum status collect(struct blobs_s3 *s3, const char *folder, bool deep, struct names *names,
                           struct error *error) {
    char prefix[PATH_BYTES + 512];
    snprintf(prefix, sizeof prefix, "%s%s/", s3_client_prefix(s3->client), folder);
    struct listing listing = {prefix, strlen(prefix), deep, keep_name, names};
    enum status status = list_keys(s3, &listing, error);
    if (status == STATUS_OK && names->lost) status = error_set(error, STATUS_NO_MEMORY, "blobs", "no memory");
    if (status == STATUS_OK && names->count) qsort(names->name, names->count, sizeof *names->name, by_bytes);
    return status;
}

static enum status s3_list(struct blobs *blobs, const char *folder, void (*found)(void *ctx, const char *name),
                           void *ctx, struct error *error) {
    struct names names = {0};
    enum status status = collect(s3_of(blobs), folder, false, &names, error);
    for (size_t i = 0; status == STATUS_OK && i < names.count; i++) found(ctx, names.name[i]);
    free_names(&names);
    return status;
}

/* ------------------------------------------------------------------------------------------------ open */

static void s3_close(struct blobs *blobs) {
    s3_client_close(s3_of(blobs)->client);
    free(blobs);
}

/* A bucket that isn't there, and keys that aren't right, are told at once. */
static enum status s3_open(const char *where, const char *folder, struct blobs **blobs, struct error *error) {
    struct blobs_s3 *s3 = alloc_zeroed(1, sizeof *s3);
    struct names names = {0};
    if (!s3) return error_set(error, STATUS_NO_MEMORY, "blobs", "no memory");
    s3->blobs.backend = &blobs_s3;
    snprintf(s3->folder, sizeof s3->folder, "%s", folder);
    enum status status = s3_client_open(where, &s3->client, error);
    if (status == STATUS_OK) status = collect(s3, "nothing", false, &names, error);
    free_names(&names);
    if (status == STATUS_OK)
        *blobs = &s3->blobs;
    else
        s3_close(&s3->blobs);
    return status;
}

/* ------------------------------------------------------------------------------------------------ put, copy */

/* Whether the file has this hash: who refuses it otherwise has got something else. */
static bool is_content(int fd, const char *sha256) {
    char found[DIGEST_HEX_BYTES];
    uint64_t bytes;
    return digest_file(fd, found, &bytes) == 0 && strcmp(found, sha256) == 0;
}

/* The file whole, in one request.  The store compares its hash. */
static enum status put_whole(struct blobs_s3 *s3, const char *name, int fd, uint64_t bytes, const char *sha256,
                             struct error *error) {
    struct s3_request request = {
        .method = "PUT", .name = name, .body_fd = fd, .body_bytes = bytes, .sha256 = sha256, .to_fd = -1};
    int code;
    enum status status = s3_client_ask(s3->client, &request, &code, error);
    if (status == STATUS_OK && code == 400 && !is_content(fd, sha256))
        status = error_set(error, STATUS_MALFORMED, "blobs", "%.200s isn't what its hash says", name);
    else if (status == STATUS_OK && code != 200)
        status = refused(error, "put", name, code);
    free(request.text);
    return status;
}

/* A put in parts: begun, each part with its hash, then completed; or given up, which whoever watches does for a host
 * that died.  "<upload's id> <name>" is what it is called. */
struct parts {
    const char *name;
    char what[BLOBS_UNFINISHED_BYTES], query[PATH_BYTES]; /* uploadId=... */
    char *list;                                           /* of the parts, as CompleteMultipartUpload has it */
    size_t list_bytes;
    FILE *writer; /* of the list */
};

static enum status begin_parts(struct blobs_s3 *s3, struct parts *parts, struct error *error) {
    struct s3_request request = {.method = "POST",
                                 .name = parts->name,
                                 .query = "uploads=",
                                 .body_fd = -1,
                                 .to_fd = -1,
                                 .ends_with = "</InitiateMultipartUploadResult>"};
    int code;
    enum status status = s3_client_ask(s3->client, &request, &code, error);
    const char *at = request.text, *id;
    size_t length;
    if (status == STATUS_OK && (code != 200 || !at || !next_between(&at, "<UploadId>", "</UploadId>", &id, &length)))
        status = refused(error, "begin to put", parts->name, code);
    if (status == STATUS_OK) {
        char plain[BLOBS_UNFINISHED_BYTES];
        snprintf(plain, sizeof plain, "%.*s", (int)length, id);
        char *encoded = s3_client_encode(plain);
        int n = snprintf(parts->query, sizeof parts->query, "uploadId=%s", encoded ? encoded : "");
        int m = snprintf(parts->what, sizeof parts->what, "%s %s", encoded ? encoded : "", parts->name);
        if (!encoded || n >= (int)sizeof parts->query || m >= (int)sizeof parts->what)
            status = error_set(error, STATUS_IO, "blobs", "the store's name of an upload is too long");
        free(encoded);
    }
    free(request.text);
    return status;
}

static enum status put_part(struct blobs_s3 *s3, struct parts *parts, int number, int fd, uint64_t offset,
                            uint64_t bytes, struct digest *whole, struct error *error) {
    char query[PATH_BYTES + 32], sha256[DIGEST_HEX_BYTES];
    struct digest *digest = digest_new();
    int code = 0;
    if (!digest) return error_set(error, STATUS_NO_MEMORY, "blobs", "no memory");
    bool is_read = digest_range(digest, fd, offset, bytes) == 0 && digest_range(whole, fd, offset, bytes) == 0;
    digest_finish(digest, sha256);
    digest_free(digest);
    if (!is_read) return error_set(error, STATUS_IO, "blobs", "can't read %.200s", parts->name);
    snprintf(query, sizeof query, "partNumber=%d&%s", number, parts->query);
    struct s3_request request = {.method = "PUT",
                                 .name = parts->name,
                                 .query = query,
                                 .body_fd = fd,
                                 .body_offset = offset,
                                 .body_bytes = bytes,
                                 .sha256 = sha256,
                                 .to_fd = -1};
    enum status status = s3_client_ask(s3->client, &request, &code, error);
    if (status == STATUS_OK && code != 200) status = refused(error, "put", parts->name, code);
    if (status == STATUS_OK)
        fprintf(parts->writer, "<Part><PartNumber>%d</PartNumber><ETag>%s</ETag></Part>", number, request.etag);
    free(request.text);
    return status;
}

/* An answer that was lost may have been that it is done: then there is no such upload, but the object. */
static enum status complete_parts(struct blobs_s3 *s3, struct parts *parts, struct error *error) {
    char sha256[DIGEST_HEX_BYTES];
    struct s3_request look = {.method = "HEAD", .name = parts->name, .body_fd = -1, .to_fd = -1};
    int code = 0;
    fputs("</CompleteMultipartUpload>", parts->writer);
    bool is_written = fclose(parts->writer) == 0 && digest_text(parts->list, sha256);
    parts->writer = NULL;
    if (!is_written) return error_set(error, STATUS_NO_MEMORY, "blobs", "no memory");
    struct s3_request request = {.method = "POST",
                                 .name = parts->name,
                                 .query = parts->query,
                                 .body_fd = -1,
                                 .body_text = parts->list,
                                 .sha256 = sha256,
                                 .to_fd = -1,
                                 .ends_with = "</CompleteMultipartUploadResult>"};
    enum status status = s3_client_ask(s3->client, &request, &code, error);
    bool is_done = status == STATUS_OK && code == 200;
    if (status == STATUS_OK && code == 404) {
        status = s3_client_ask(s3->client, &look, &code, error);
        is_done = status == STATUS_OK && code == 200;
    }
    if (status == STATUS_OK && !is_done) status = refused(error, "complete", parts->name, code);
    free(request.text);
    free(look.text);
    return status;
}

static bool s3_give_up(struct blobs *blobs, const char *what) {
    const char *blank = strchr(what, ' ');
    char query[PATH_BYTES];
    struct error error = {0};
    int code;
    if (!blank) return true;
    snprintf(query, sizeof query, "uploadId=%.*s", (int)(blank - what), what);
    struct s3_request request = {.method = "DELETE", .name = blank + 1, .query = query, .body_fd = -1, .to_fd = -1};
    enum status status = s3_client_ask(s3_of(blobs)->client, &request, &code, &error);
    free(request.text);
    return status == STATUS_OK && (code < 300 || code == 404);
}

static enum status put_parts(struct blobs_s3 *s3, const char *name, int fd, uint64_t bytes, const char *sha256,
                             struct error *error) {
    enum { MOST_PARTS = 10000 };
    const struct blobs_unfinished *unfinished = &s3->blobs.unfinished;
    uint64_t part_bytes = s3_client_part_bytes(s3->client), done = 0;
    struct parts parts = {.name = name};
    char found[DIGEST_HEX_BYTES];
    if (bytes / MOST_PARTS >= part_bytes) part_bytes = bytes / MOST_PARTS + 1;
    struct digest *whole = digest_new();
    parts.writer = open_memstream(&parts.list, &parts.list_bytes);
    enum status status = whole && parts.writer ? STATUS_OK : error_set(error, STATUS_NO_MEMORY, "blobs", "no memory");
    if (status == STATUS_OK) status = begin_parts(s3, &parts, error);
    bool is_begun = status == STATUS_OK;
    if (is_begun && unfinished->begins && !unfinished->begins(unfinished->ctx, parts.what))
        status = error_set(error, STATUS_IO, AWAY, "what is put in parts can't be noted");
    if (status == STATUS_OK) fputs("<CompleteMultipartUpload>", parts.writer);
    for (int number = 1; status == STATUS_OK && done < bytes; number++) {
        uint64_t count = bytes - done < part_bytes ? bytes - done : part_bytes;
        status = put_part(s3, &parts, number, fd, done, count, whole, error);
        fault_at("part-put");
        done += count;
    }
    if (whole) digest_finish(whole, found);
    if (status == STATUS_OK && strcmp(found, sha256) != 0)
        status = error_set(error, STATUS_MALFORMED, "blobs", "%.200s isn't what its hash says", name);
    if (status == STATUS_OK) status = complete_parts(s3, &parts, error);
    bool is_over = status == STATUS_OK || (is_begun && s3_give_up(&s3->blobs, parts.what));
    if (is_begun && is_over && unfinished->ends) unfinished->ends(unfinished->ctx, parts.what);
    if (parts.writer) fclose(parts.writer);
    free(parts.list);
    digest_free(whole);
    return status;
}

static enum status put_one(struct blobs_s3 *s3, const char *folder, const struct blobs_source *source,
                           struct error *error) {
    char name[PATH_BYTES];
    struct stat facts;
    int fd = openat(source->folder_fd, source->file, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    snprintf(name, sizeof name, "%s/%s", folder, source->name);
    enum status status = STATUS_OK;
    if (fd < 0 || fstat(fd, &facts) != 0)
        status =
            error_set(error, status_from_errno(errno), "blobs", "can't read %.100s: %s", source->name, strerror(errno));
    else if ((uint64_t)facts.st_size <= s3_client_part_bytes(s3->client))
        status = put_whole(s3, name, fd, (uint64_t)facts.st_size, source->sha256, error);
    else
        status = put_parts(s3, name, fd, (uint64_t)facts.st_size, source->sha256, error);
    folders_close(fd);
    return status;
}

/* Several at once: what a store takes for each is mostly waiting. */
struct putting {
    struct blobs_s3 *s3;
    const char *folder;
    const struct blobs_source *sources;
    size_t count;
    _Atomic size_t next;
    pthread_mutex_t lock;
    enum status status; /* of the first that fails, and its error; what has not begun then doesn't */
    struct error *error;
};

static void *put_others(void *ctx) {
    struct putting *putting = ctx;
    for (;;) {
        struct error error = {0};
        pthread_mutex_lock(&putting->lock);
        bool goes_on = putting->status == STATUS_OK;
        pthread_mutex_unlock(&putting->lock);
        size_t i = goes_on ? atomic_fetch_add(&putting->next, 1) : putting->count;
        if (i >= putting->count) return NULL;
        enum status status = put_one(putting->s3, putting->folder, &putting->sources[i], &error);
        if (status == STATUS_OK) continue;
        pthread_mutex_lock(&putting->lock);
        if (putting->status == STATUS_OK) *putting->error = error;
        if (putting->status == STATUS_OK) putting->status = status;
        pthread_mutex_unlock(&putting->lock);
    }
}

static enum status s3_put(struct blobs *blobs, const char *folder, const struct blobs_source *sources, size_t count,
                          struct error *error) {
    enum { AT_ONCE = 4 };
    struct putting putting = {.s3 = s3_of(blobs),
                              .folder = folder,
                              .sources = sources,
                              .count = count,
                              .lock = PTHREAD_MUTEX_INITIALIZER,
                              .error = error};
    pthread_t others[AT_ONCE - 1];
    size_t started = 0;
    while (started + 1 < count && started + 1 < AT_ONCE &&
           pthread_create(&others[started], NULL, put_others, &putting) == 0)
        started++;
    put_others(&putting);
    for (size_t i = 0; i < started; i++) pthread_join(others[i], NULL);
    pthread_mutex_destroy(&putting.lock);
    return putting.status;
}

static enum status s3_copy(struct blobs *blobs, const char *from_folder, const char *to_folder, struct error *error) {
    struct blobs_s3 *s3 = s3_of(blobs);
    struct names names = {0};
    enum status status = collect(s3, from_folder, true, &names, error);
    if (status == STATUS_OK && !names.count)
        status = error_set(error, STATUS_IO, "blobs", "there is no %.200s", from_folder);
    for (size_t i = 0; status == STATUS_OK && i < names.count; i++) {
        char from[PATH_BYTES], to[PATH_BYTES];
        int code;
        int n = snprintf(from, sizeof from, "%s/%s", from_folder, names.name[i]);
        int m = snprintf(to, sizeof to, "%s/%s", to_folder, names.name[i]);
        struct s3_request request = {.method = "PUT",
                                     .name = to,
                                     .copy_of = from,
                                     .body_fd = -1,
                                     .to_fd = -1,
                                     .ends_with = "</CopyObjectResult>"};
        if (n < 0 || n >= PATH_BYTES || m < 0 || m >= PATH_BYTES) continue;
        status = s3_client_ask(s3->client, &request, &code, error);
        if (status == STATUS_OK && code != 200) status = refused(error, "copy", from, code);
        free(request.text);
    }
    free_names(&names);
    return status;
}

/* ------------------------------------------------------------------------------------------------ read, remove */

static int open_nameless(const char *folder) {
    char path[FOLDER_BYTES + FOLDERS_NAME_BYTES], name[FOLDERS_NAME_BYTES];
    int fd = open(folder, O_RDWR | O_TMPFILE | O_CLOEXEC, FOLDERS_FILE_MODE);
    if (fd >= 0 || (errno != EOPNOTSUPP && errno != EISDIR)) return fd;
    folders_random_name("fetched", name); /* a file system without nameless files */
    snprintf(path, sizeof path, "%s/%s", folder, name);
    fd = open(path, O_RDWR | O_CREAT | O_EXCL | O_CLOEXEC, FOLDERS_FILE_MODE);
    if (fd >= 0) unlink(path);
    return fd;
}

/* As the request says, but for where to. */
static int fetch(struct blobs_s3 *s3, struct s3_request *request) {
    struct error error = {0};
    int code, fd = open_nameless(s3->folder);
    if (fd < 0) return -1;
    request->method = "GET";
    request->body_fd = -1;
    request->to_fd = fd;
    enum status status = s3_client_ask(s3->client, request, &code, &error);
    free(request->text);
    if (status == STATUS_OK && code == (request->is_range ? 206 : 200) && lseek(fd, 0, SEEK_SET) == 0) return fd;
    close(fd);
    bool is_away = status == STATUS_IO || (status == STATUS_OK && code != 416);
    if (status == STATUS_MALFORMED) log_line_seldom(LOG_ERROR, "%s: %s", error.where, error.text);
    errno = status == STATUS_OK && code == 404 ? ENOENT
            : status == STATUS_NO_SPACE        ? ENOSPC
            : status == STATUS_NO_MEMORY       ? ENOMEM
            : is_away                          ? EHOSTUNREACH
                                               : EIO;
    return -1;
}

static const struct blobs_facts nothing_known = {0};

static int s3_read(struct blobs *blobs, const char *name, const struct blobs_facts *facts) {
    struct s3_request request = {.name = name, .expected = facts ? *facts : nothing_known};
    return fetch(s3_of(blobs), &request);
}

static int s3_read_range(struct blobs *blobs, const char *name, const struct blobs_facts *facts, uint64_t first,
                         uint64_t last) {
    struct s3_request request = {
        .name = name, .is_range = true, .first = first, .last = last, .expected = facts ? *facts : nothing_known};
    return fetch(s3_of(blobs), &request);
}

static bool s3_link(struct blobs *blobs, const char *name, unsigned seconds, const char *type, const char *disposition,
                    char *url, size_t bytes) {
    return s3_client_presign(s3_of(blobs)->client, name, seconds, type, disposition, url, bytes);
}

/* Whether a listing has the name itself, or one below it. */
struct looking {
    const char *name;
    bool is_found;
};

static void look_for(void *ctx, const char *name) {
    struct looking *looking = ctx;
    size_t length = strlen(looking->name);
    looking->is_found =
        looking->is_found || (strncmp(name, looking->name, length) == 0 && (!name[length] || name[length] == '/'));
}

/* An answer to HEAD has no text that could say whose it is: that there is none is what a listing says. */
static bool s3_exist(struct blobs *blobs, const char *name) {
    struct blobs_s3 *s3 = s3_of(blobs);
    struct s3_request request = {.method = "HEAD", .name = name, .body_fd = -1, .to_fd = -1};
    struct looking looking = {.name = name};
    struct error error = {0};
    char prefix[PATH_BYTES + 512];
    int code;
    enum status status = s3_client_ask(s3->client, &request, &code, &error);
    free(request.text);
    if (status != STATUS_OK || code != 404) return true;
    snprintf(prefix, sizeof prefix, "%s%s", s3_client_prefix(s3->client), name);
    struct listing listing = {prefix, strlen(s3_client_prefix(s3->client)), true, look_for, &looking};
    return list_keys(s3, &listing, &error) != STATUS_OK || looking.is_found;
}

/* A try that had no answer may come to the store later than the next one, which has. */
static bool delete_one(struct blobs_s3 *s3, const char *name, struct blobs_removal *removal) {
    struct s3_request request = {.method = "DELETE",
                                 .name = name,
                                 .body_fd = -1,
                                 .to_fd = -1,
                                 .signed_ms = removal->begun_ms,
                                 .valid_s = removal->begun_ms ? BLOBS_REMOVAL_S : 0};
    struct error error = {0};
    int code;
    enum status status = s3_client_ask(s3->client, &request, &code, &error);
    free(request.text);
    bool is_gone = status == STATUS_OK && (code < 300 || code == 404);
    removal->is_settled = removal->is_settled && is_gone && request.tries == 1;
    return is_gone;
}

static bool s3_remove(struct blobs *blobs, const char *name, struct blobs_removal *removal) {
    struct blobs_s3 *s3 = s3_of(blobs);
    struct names names = {0};
    struct error error = {0};
    bool is_gone = delete_one(s3, name, removal) && collect(s3, name, true, &names, &error) == STATUS_OK;
    for (size_t i = 0; i < names.count; i++) {
        char below[PATH_BYTES];
        int n = snprintf(below, sizeof below, "%s/%s", name, names.name[i]);
        is_gone = n > 0 && n < PATH_BYTES && delete_one(s3, below, removal) && is_gone;
    }
    free_names(&names);
    return is_gone;
}

static enum status s3_set_aside(struct blobs *blobs, const char *start, const char *folder, const char *name,
                                char place[64], struct error *error) {
    (void)blobs, (void)start, (void)folder, (void)place;
    return error_set(error, STATUS_UNSUPPORTED, "blobs", "%.100s stays in the store, which other hosts have, too",
                     name);
}

const struct blobs_backend blobs_s3 = {
    .scheme = "s3://",
    .is_remote = true,
    .is_valid = s3_client_valid,
    .open = s3_open,
    .close = s3_close,
    .put = s3_put,
    .copy = s3_copy,
    .read = s3_read,
    .read_range = s3_read_range,
    .link = s3_link,
    .give_up = s3_give_up,
    .exist = s3_exist,
    .remove = s3_remove,
    .list = s3_list,
    .set_aside = s3_set_aside,
};
