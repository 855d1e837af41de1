/* Requests to an S3 store.
 *
 * A store that is stopped, or full, doesn't refuse but hangs: whoever moves fewer than MIN_BYTES_S for STALL_S is cut
 * off.  Every request may be made again (a name stands for one content), so one that had no answer is, twice.
 *
 * Proxies stand between, which break answers off, or answer themselves.  An answer is taken for the store's where it
 * is whole: objects have the length and the hash that they are known by, texts their end, errors a code of S3's (a
 * page that says 404 doesn't mean that an object isn't there).
 *
 * A store refuses what was signed at another time than its own.  So requests are signed by the store's clock, as its
 * answers tell it, where the machine's is off.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/blobs/s3/s3_client.h"

#include <curl/curl.h>
#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <time.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/base/clock.h"
#include "core/base/fault.h"
#include "server/base/away.h"
#include "server/base/digest.h"
#include "server/base/setting_file.h"
#include "server/blobs/s3/signature_v4.h"

enum { CONNECT_S = 5, STALL_S = 15, MIN_BYTES_S = 512, TRIES = 3, PAUSE_MS = 200, HANDLES = 8 };
enum { CLOCK_SLACK_S = 2 /* of answers on their way */, CLOCK_OFF_S = 60, DATE_BYTES = 64 };
enum { PART_BYTES = 512, URL_BYTES = 2048, TEXT_MAX_BYTES = 8 << 20 };
enum { CONTENT_RANGE_BYTES = 96 };

struct s3_client {
    char endpoint[PART_BYTES], host[PART_BYTES], bucket[PART_BYTES], prefix[PART_BYTES], ca[PART_BYTES];
    bool is_host_style; /* the bucket is named by the host, not by the path */
    struct signature_v4_keys keys;
    pthread_mutex_t lock;
    CURL *idle[HANDLES]; /* with their connections */
    int idle_count;
    _Atomic int64_t since_s; /* the store's clock when clock_ms was 0: it stays right when the time of day jumps */
    uint64_t part_bytes;
};

static const char empty_sha256[] = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855";

/* ------------------------------------------------------------------------------------------------ open */

static bool copy_part(char to[PART_BYTES], const char *from, size_t length) {
    if (length >= PART_BYTES) return false;
    memcpy(to, from, length);
    to[length] = 0;
    return true;
}

static bool copy_decoded(char to[PART_BYTES], const char *from, size_t length) {
    int decoded_length = 0;
    char *decoded = curl_easy_unescape(NULL, from, (int)length, &decoded_length);
    bool ok = decoded && copy_part(to, decoded, (size_t)decoded_length);
    curl_free(decoded);
    return ok;
}

/* The host as the header Host names it: of the endpoint, without its scheme, the bucket in front where it is there. */
static bool read_endpoint(struct s3_client *client) {
    const char *host = strstr(client->endpoint, "://");
    bool is_web = strncmp(client->endpoint, "http://", 7) == 0 || strncmp(client->endpoint, "https://", 8) == 0;
    if (!is_web || !host[3] || strchr(host + 3, '/')) return false;
    int n = snprintf(client->host, PART_BYTES, "%s%s%s", client->is_host_style ? client->bucket : "",
                     client->is_host_style ? "." : "", host + 3);
    return n > 0 && n < PART_BYTES;
}

/* false: it is no URL of a store. */
static bool read_url(const char *where, struct s3_client *client, char keys_file[PART_BYTES]) {
    char part[PART_BYTES] = "64", style[PART_BYTES] = "path", *rest;
    size_t path = strcspn(where, "?"), bucket = strcspn(where, "/?");
    struct {
        const char *name;
        char *to;
    } const parameters[] = {{"endpoint=", client->endpoint},
                            {"region=", client->keys.region},
                            {"keys=", keys_file},
                            {"ca=", client->ca},
                            {"style=", style},
                            {"part=", part}};
    enum { PARAMETERS = sizeof parameters / sizeof *parameters };
    if (!bucket || !copy_part(client->bucket, where, bucket)) return false;
    if (path > bucket + 1 && !copy_part(client->prefix, where + bucket + 1, path - bucket - 1)) return false;
    size_t length = strlen(client->prefix);
    if (length && client->prefix[length - 1] != '/' && length + 1 < PART_BYTES) client->prefix[length] = '/';
    for (const char *next = where[path] ? where + path + 1 : ""; *next;) {
        size_t end = strcspn(next, "&"), i = 0;
        while (i < PARAMETERS && strncmp(next, parameters[i].name, strlen(parameters[i].name)) != 0) i++;
        char value[PART_BYTES];
        if (i == PARAMETERS) return false;
        size_t skip = strlen(parameters[i].name);
        if (!copy_decoded(value, next + skip, end - skip) || (i == 1 && strlen(value) >= sizeof client->keys.region))
            return false;
        memcpy(parameters[i].to, value, strlen(value) + 1);
        next += end + (next[end] == '&');
    }
    unsigned long mebibytes = strtoul(part, &rest, 10);
    client->part_bytes = (uint64_t)mebibytes << 20;
    client->is_host_style = strcmp(style, "host") == 0;
    if (!client->is_host_style && strcmp(style, "path") != 0) return false;
    return !*rest && mebibytes >= 5 && mebibytes <= 5000 && read_endpoint(client);
}

bool s3_client_valid(const char *where) {
    struct s3_client client = {.keys.region = "us-east-1"};
    char keys_file[PART_BYTES] = "";
    return read_url(where, &client, keys_file);
}

static enum status read_keys(struct s3_client *client, const char *path, struct error *error) {
    char line[300] = "";
    FILE *file;
    const char *access = getenv("AWS_ACCESS_KEY_ID"), *secret = getenv("AWS_SECRET_ACCESS_KEY");
    if (path[0]) {
        enum status status = setting_file_open("blobs", path, &file, error);
        if (status != STATUS_OK) return status;
        if (!fgets(line, sizeof line, file)) line[0] = 0;
        fclose(file);
        line[strcspn(line, "\r\n")] = 0;
        char *colon = strchr(line, ':');
        if (colon) *colon = 0;
        access = colon ? line : NULL;
        secret = colon ? colon + 1 : NULL;
    }
    bool fits = access && secret && access[0] && secret[0] && strlen(access) < sizeof client->keys.access &&
                strlen(secret) < sizeof client->keys.secret;
    if (fits) {
        memcpy(client->keys.access, access, strlen(access) + 1);
        memcpy(client->keys.secret, secret, strlen(secret) + 1);
    }
    explicit_bzero(line, sizeof line);
    return fits ? STATUS_OK
                : error_set(error, STATUS_BAD_PARAMETER, "blobs",
                            "an S3 store needs keys: keys=FILE with a line access:secret, or AWS_ACCESS_KEY_ID and "
                            "AWS_SECRET_ACCESS_KEY");
}

enum status s3_client_open(const char *where, struct s3_client **client, struct error *error) {
    char keys_file[PART_BYTES] = "";
    struct s3_client *opened = alloc_zeroed(1, sizeof *opened);
    if (!opened || curl_global_init(CURL_GLOBAL_DEFAULT) != CURLE_OK) {
        free(opened);
        return error_set(error, STATUS_NO_MEMORY, "blobs", "no memory");
    }
    pthread_mutex_init(&opened->lock, NULL);
    opened->since_s = (int64_t)time(NULL) - clock_ms() / 1000; /* until the store has said what time it is */
    snprintf(opened->keys.region, sizeof opened->keys.region, "us-east-1");
    enum status status = read_url(where, opened, keys_file)
                             ? read_keys(opened, keys_file, error)
                             : error_set(error, STATUS_BAD_PARAMETER, "blobs", "it is no URL of an S3 store");
    if (status == STATUS_OK)
        *client = opened;
    else
        s3_client_close(opened);
    return status;
}

void s3_client_close(struct s3_client *client) {
    if (!client) return;
    while (client->idle_count) curl_easy_cleanup(client->idle[--client->idle_count]);
    pthread_mutex_destroy(&client->lock);
    explicit_bzero(&client->keys, sizeof client->keys);
    free(client);
    curl_global_cleanup();
}

uint64_t s3_client_part_bytes(const struct s3_client *client) { return client->part_bytes; }

const char *s3_client_prefix(const struct s3_client *client) { return client->prefix; }

char *s3_client_encode(const char *text) {
    char *encoded = curl_easy_escape(NULL, text, 0), *copy = encoded ? strdup(encoded) : NULL;
    curl_free(encoded);
    return copy;
}

/* ------------------------------------------------------------------------------------------------ one try */

struct exchange {
    struct s3_request *request;
    CURL *curl;
    uint64_t sent, text_bytes, taken; /* taken: of an object */
    struct digest *digest;            /* of what is taken; NULL = nobody knows what it should be */
    bool is_short_of_memory, is_too_long;
    int write_errno;
    time_t answered_s; /* by the store's clock; 0 = it didn't say */
    char content_range[CONTENT_RANGE_BYTES];
};

/* Whether a header is called so ("etag:"); its value goes to text, "" where it is too long. */
static bool read_header(const char *bytes, size_t length, const char *name, char *text, size_t room) {
    size_t skip = strlen(name);
    if (length < skip || strncasecmp(bytes, name, skip) != 0) return false;
    while (skip < length && bytes[skip] == ' ') skip++;
    int n = snprintf(text, room, "%.*s", (int)(length - skip), bytes + skip);
    if (n < 0 || (size_t)n >= room) text[0] = 0;
    text[strcspn(text, "\r\n")] = 0;
    return true;
}

/* Keeps the time at which the store has answered, the object's tag, and which part of it comes. */
static size_t take_header(char *bytes, size_t size, size_t count, void *ctx) {
    struct exchange *exchange = ctx;
    size_t length = size * count;
    char text[DATE_BYTES];
    if (read_header(bytes, length, "date:", text, sizeof text)) {
        time_t said = curl_getdate(text, NULL);
        if (said > 0) exchange->answered_s = said;
    }
    read_header(bytes, length, "etag:", exchange->request->etag, S3_ETAG_BYTES);
    read_header(bytes, length, "content-range:", exchange->content_range, CONTENT_RANGE_BYTES);
    return length;
}

static size_t give_body(char *bytes, size_t size, size_t count, void *ctx) {
    struct exchange *exchange = ctx;
    const struct s3_request *request = exchange->request;
    uint64_t left = request->body_bytes - exchange->sent, room = size * count;
    ssize_t n =
        pread(request->body_fd, bytes, room < left ? room : left, (off_t)(request->body_offset + exchange->sent));
    if (n < 0) return CURL_READFUNC_ABORT;
    exchange->sent += (uint64_t)n;
    return (size_t)n;
}

static size_t take_text(struct exchange *exchange, const char *bytes, size_t count) {
    struct s3_request *request = exchange->request;
    if (exchange->text_bytes + count > TEXT_MAX_BYTES) return 0;
    char *grown = realloc(request->text, exchange->text_bytes + count + 1);
    if (!grown) {
        exchange->is_short_of_memory = true;
        return 0;
    }
    request->text = grown;
    memcpy(grown + exchange->text_bytes, bytes, count);
    exchange->text_bytes += count;
    grown[exchange->text_bytes] = 0;
    return count;
}

/* The status with which an object comes. */
static int wanted_code(const struct s3_request *request) { return request->is_range ? 206 : 200; }

/* How many bytes are to come of the object; UINT64_MAX: nobody knows. */
static uint64_t wanted_bytes(const struct s3_request *request) {
    if (request->is_range) return request->last - request->first + 1;
    return request->expected.bytes ? request->expected.bytes : UINT64_MAX;
}

/* What follows another status than the one that was hoped for is text, whatever was asked for. */
static size_t take_bytes(char *bytes, size_t size, size_t count, void *ctx) {
    struct exchange *exchange = ctx;
    size_t length = size * count;
    long code = 0;
    curl_easy_getinfo(exchange->curl, CURLINFO_RESPONSE_CODE, &code);
    if (exchange->request->to_fd < 0 || code != wanted_code(exchange->request))
        return take_text(exchange, bytes, length);
    exchange->is_too_long = length > wanted_bytes(exchange->request) - exchange->taken;
    if (exchange->is_too_long) return 0;
    exchange->taken += length;
    if (exchange->digest) digest_update(exchange->digest, bytes, length);
    for (size_t done = 0; done < length;) {
        ssize_t n = write(exchange->request->to_fd, bytes + done, length - done);
        if (n < 0 && errno != EINTR) {
            exchange->write_errno = errno;
            return 0;
        }
        if (n > 0) done += (size_t)n;
    }
    return length;
}

/* Each part of a path, encoded; the slashes between them stay.  NULL is the bucket's own. */
static bool encode_path(const struct s3_client *client, bool with_bucket, const char *name, char path[URL_BYTES]) {
    char plain[URL_BYTES];
    size_t length = 0;
    int n = snprintf(plain, sizeof plain, "%s%s%s%s%s", with_bucket ? "/" : "", with_bucket ? client->bucket : "",
                     name || !with_bucket ? "/" : "", name ? client->prefix : "", name ? name : "");
    bool ok = n > 0 && n < URL_BYTES;
    for (const char *c = plain; ok && *c; c++) {
        bool is_plain = (*c >= 'a' && *c <= 'z') || (*c >= 'A' && *c <= 'Z') || (*c >= '0' && *c <= '9') ||
                        strchr("-._~/", *c) != NULL;
        ok = length + 4 < URL_BYTES;
        if (ok && is_plain) path[length++] = *c;
        if (ok && !is_plain) length += (size_t)snprintf(path + length, 4, "%%%02X", (unsigned char)*c);
    }
    path[length] = 0;
    return ok;
}

/* query: NULL = none.  false: it doesn't fit. */
static bool make_url(const struct s3_client *client, const char *path, const char *query, char *url, size_t bytes) {
    int scheme = (int)(strchr(client->endpoint, ':') - client->endpoint);
    int n = snprintf(url, bytes, "%.*s://%s%s%s%s", scheme, client->endpoint, client->host, path, query ? "?" : "",
                     query ? query : "");
    return n > 0 && (size_t)n < bytes;
}

/* By the store's clock; at_ms is of clock_ms, 0 = now. */
static void write_date(const struct s3_client *client, int64_t at_ms, char date[SIGNATURE_V4_DATE_BYTES]) {
    time_t at = (time_t)(atomic_load(&client->since_s) + (at_ms ? at_ms : clock_ms()) / 1000);
    struct tm tm;
    gmtime_r(&at, &tm);
    strftime(date, SIGNATURE_V4_DATE_BYTES, "%Y%m%dT%H%M%SZ", &tm);
}

/* Host is libcurl's own, the same as is signed. */
static struct curl_slist *sign(const struct s3_client *client, const struct s3_request *request, const char *path,
                               const char *copy_source) {
    struct signature_v4_request to_sign = {.method = request->method,
                                           .host = client->host,
                                           .path = path,
                                           .query = request->query ? request->query : "",
                                           .body_sha256 = request->sha256 ? request->sha256 : empty_sha256,
                                           .copy_source = copy_source};
    char authorization[SIGNATURE_V4_BYTES], header[URL_BYTES + 64];
    write_date(client, request->signed_ms, to_sign.date);
    if (!signature_v4_make(&client->keys, &to_sign, authorization)) return NULL;
    struct curl_slist *headers = curl_slist_append(NULL, "Expect:");
    snprintf(header, sizeof header, "Authorization: %s", authorization);
    headers = curl_slist_append(headers, header);
    snprintf(header, sizeof header, "x-amz-date: %s", to_sign.date);
    headers = curl_slist_append(headers, header);
    snprintf(header, sizeof header, "x-amz-content-sha256: %s", to_sign.body_sha256);
    headers = curl_slist_append(headers, header);
    if (request->is_range) {
        snprintf(header, sizeof header, "Range: bytes=%llu-%llu", (unsigned long long)request->first,
                 (unsigned long long)request->last);
        headers = curl_slist_append(headers, header);
    }
    snprintf(header, sizeof header, "x-amz-copy-source: %s", copy_source ? copy_source : "");
    return copy_source ? curl_slist_append(headers, header) : headers;
}

/* The request as a URL, which is all that is signed; returns its headers. */
static struct curl_slist *sign_url(const struct s3_client *client, const struct s3_request *request, const char *path,
                                   char *url, size_t bytes) {
    struct signature_v4_request to_sign = {
        .method = request->method, .host = client->host, .path = path, .query = request->query ? request->query : ""};
    char query[URL_BYTES];
    write_date(client, request->signed_ms, to_sign.date);
    if (!signature_v4_presign(&client->keys, &to_sign, request->valid_s, query, sizeof query) ||
        !make_url(client, path, query, url, bytes))
        return NULL;
    return curl_slist_append(NULL, "Expect:");
}

static void configure(const struct s3_client *client, CURL *curl, const char *url, struct curl_slist *headers,
                      struct exchange *exchange, char *why) {
    const struct s3_request *request = exchange->request;
    bool is_put = strcmp(request->method, "PUT") == 0;
    curl_easy_setopt(curl, CURLOPT_URL, url);
    curl_easy_setopt(curl, CURLOPT_PATH_AS_IS, 1L);
    curl_easy_setopt(curl, CURLOPT_NOSIGNAL, 1L);
    curl_easy_setopt(curl, CURLOPT_NOPROXY, "*");
    curl_easy_setopt(curl, CURLOPT_CONNECTTIMEOUT, (long)CONNECT_S);
    curl_easy_setopt(curl, CURLOPT_LOW_SPEED_TIME, (long)STALL_S);
    curl_easy_setopt(curl, CURLOPT_LOW_SPEED_LIMIT, (long)MIN_BYTES_S);
    curl_easy_setopt(curl, CURLOPT_HTTPHEADER, headers);
    curl_easy_setopt(curl, CURLOPT_WRITEFUNCTION, take_bytes);
    curl_easy_setopt(curl, CURLOPT_WRITEDATA, exchange);
    curl_easy_setopt(curl, CURLOPT_HEADERFUNCTION, take_header);
    curl_easy_setopt(curl, CURLOPT_HEADERDATA, exchange);
    curl_easy_setopt(curl, CURLOPT_ERRORBUFFER, why);
    if (client->ca[0]) curl_easy_setopt(curl, CURLOPT_CAINFO, client->ca);
    if (strcmp(request->method, "HEAD") == 0) curl_easy_setopt(curl, CURLOPT_NOBODY, 1L);
    if (is_put) {
        curl_easy_setopt(curl, CURLOPT_UPLOAD, 1L);
        curl_easy_setopt(curl, CURLOPT_READFUNCTION, give_body);
        curl_easy_setopt(curl, CURLOPT_READDATA, exchange);
        curl_easy_setopt(curl, CURLOPT_INFILESIZE_LARGE, (curl_off_t)(request->copy_of ? 0 : request->body_bytes));
    }
    if (strcmp(request->method, "POST") == 0) {
        curl_easy_setopt(curl, CURLOPT_POST, 1L);
        curl_easy_setopt(curl, CURLOPT_POSTFIELDS, request->body_text ? request->body_text : "");
    }
    if (strcmp(request->method, "DELETE") == 0) curl_easy_setopt(curl, CURLOPT_CUSTOMREQUEST, "DELETE");
}

/* Takes the time from an answer of the store.  Whether the request was refused for its time, and may be signed anew. */
static bool adopt_clock(struct s3_client *client, const struct exchange *exchange, int code) {
    if (!exchange->answered_s) return false;
    int64_t since_s = (int64_t)exchange->answered_s - clock_ms() / 1000;
    int64_t off_s = since_s - atomic_load(&client->since_s);
    if (off_s > CLOCK_SLACK_S || off_s < -CLOCK_SLACK_S) atomic_store(&client->since_s, since_s);
    return code == 403 && (off_s >= CLOCK_OFF_S || off_s <= -CLOCK_OFF_S);
}

/* Whether the bytes that were asked for have come: all of them, from where they were to come, and with their hash. */
static bool is_as_expected(struct exchange *exchange) {
    const struct s3_request *request = exchange->request;
    char found[DIGEST_HEX_BYTES], range[CONTENT_RANGE_BYTES];
    int n = snprintf(range, sizeof range, "bytes %llu-%llu/", (unsigned long long)request->first,
                     (unsigned long long)request->last);
    if (request->expected.bytes)
        snprintf(range + n, sizeof range - (size_t)n, "%llu", (unsigned long long)request->expected.bytes);
    uint64_t wanted = wanted_bytes(request);
    if (wanted != UINT64_MAX && exchange->taken != wanted) return false;
    if (request->is_range) return strncmp(exchange->content_range, range, strlen(range)) == 0;
    if (!exchange->digest) return true;
    digest_finish(exchange->digest, found);
    return strncmp(found, request->expected.sha256, strlen(request->expected.sha256)) == 0;
}

/* What is wrong with an answer that has come to its end. */
static enum status look_at_answer(struct exchange *exchange, int code, struct error *error) {
    const struct s3_request *request = exchange->request;
    const char *name = request->name ? request->name : "the bucket";
    bool is_ok = code == wanted_code(request), is_head = strcmp(request->method, "HEAD") == 0;
    bool is_text_whole = !request->ends_with || (request->text && strstr(request->text, request->ends_with));
    if (code >= 400 && code < 500 && !is_head && (!request->text || !strstr(request->text, "<Code>")))
        return error_set(error, STATUS_IO, AWAY, "somebody before the store answered %d for %.200s", code, name);
    if (request->body_fd >= 0 && code == 200 && !request->etag[0])
        return error_set(error, STATUS_IO, AWAY, "the answer to the put of %.200s isn't the store's", name);
    if (request->to_fd >= 0 && code == 200 && request->is_range)
        return error_set(error, STATUS_MALFORMED, "blobs", "all of %.200s came instead of a part", name);
    if (request->to_fd >= 0 && is_ok && !is_as_expected(exchange))
        return error_set(error, STATUS_MALFORMED, "blobs", "what came of %.200s isn't what was put", name);
    if (request->to_fd < 0 && is_ok && !is_text_whole)
        return error_set(error, STATUS_IO, AWAY, "the store's answer about %.200s isn't whole", name);
    return STATUS_OK;
}

/* *again: it was refused for the time of its signature, and may be signed anew. */
static enum status try_once(struct s3_client *client, CURL *curl, struct s3_request *request, int *code, bool *again,
                            struct error *error) {
    char path[URL_BYTES], copy_source[URL_BYTES], url[2 * URL_BYTES], why[CURL_ERROR_SIZE] = "";
    struct exchange exchange = {.request = request, .curl = curl};
    long answer = 0;
    *code = 0;
    if (!encode_path(client, !client->is_host_style, request->name, path) ||
        (request->copy_of && !encode_path(client, true, request->copy_of, copy_source)) ||
        !make_url(client, path, request->query, url, sizeof url))
        return error_set(error, STATUS_BAD_PARAMETER, "blobs", "a name is too long");
    struct curl_slist *headers = request->valid_s ? sign_url(client, request, path, url, sizeof url)
                                                  : sign(client, request, path, request->copy_of ? copy_source : NULL);
    if (!headers) return error_set(error, STATUS_NO_MEMORY, "blobs", "no memory");
    if (request->to_fd >= 0 && !request->is_range && request->expected.sha256) {
        exchange.digest = digest_new();
        exchange.is_short_of_memory = !exchange.digest;
    }
    curl_easy_reset(curl);
    configure(client, curl, url, headers, &exchange, why);
    CURLcode result = fault_at("blobs-request") ? CURLE_COULDNT_CONNECT : curl_easy_perform(curl);
    curl_easy_getinfo(curl, CURLINFO_RESPONSE_CODE, &answer);
    curl_slist_free_all(headers);
    *code = (int)answer;
    enum status status = STATUS_OK;
    if (exchange.write_errno)
        status = error_set(error, status_from_errno(exchange.write_errno), "blobs",
                           "what is fetched can't be stored: %s", strerror(exchange.write_errno));
    else if (exchange.is_short_of_memory)
        status = error_set(error, STATUS_NO_MEMORY, "blobs", "no memory");
    else if (exchange.is_too_long)
        status = error_set(error, STATUS_MALFORMED, "blobs", "more came of %.200s than was put", request->name);
    else if (result != CURLE_OK)
        status = error_set(error, STATUS_IO, AWAY, "the store doesn't answer: %s",
                           why[0] ? why : curl_easy_strerror(result));
    else
        status = look_at_answer(&exchange, *code, error);
    *again = status == STATUS_OK && adopt_clock(client, &exchange, *code);
    if (status != STATUS_OK) *code = 0;
    digest_free(exchange.digest);
    return status;
}

/* ------------------------------------------------------------------------------------------------ requests */

static CURL *take_handle(struct s3_client *client) {
    pthread_mutex_lock(&client->lock);
    CURL *curl = client->idle_count ? client->idle[--client->idle_count] : NULL;
    pthread_mutex_unlock(&client->lock);
    return curl ? curl : curl_easy_init();
}

static void give_handle(struct s3_client *client, CURL *curl) {
    pthread_mutex_lock(&client->lock);
    bool has_room = client->idle_count < HANDLES;
    if (has_room) client->idle[client->idle_count++] = curl;
    pthread_mutex_unlock(&client->lock);
    if (!has_room) curl_easy_cleanup(curl);
}

/* What was taken of an answer that broke off is taken back. */
static void start_again(struct s3_request *request) {
    free(request->text);
    request->text = NULL;
    request->etag[0] = 0;
    if (request->to_fd < 0) return;
    int cut = ftruncate(request->to_fd, 0);
    (void)cut; /* the next answer is longer than what stays, or its length tells */
    lseek(request->to_fd, request->is_range ? (off_t)request->first : 0, SEEK_SET);
}

/* Whether another try may end otherwise: the store has trouble, or what was to be put came to it in part. */
static bool is_for_now(const struct s3_request *request, enum status status, int code) {
    bool was_put = request->body_fd >= 0 && code == 400;
    if (status == STATUS_OK)
        return code >= 500 || code < 200 || code / 100 == 3 || code == 408 || code == 429 || was_put;
    return status == STATUS_IO || status == STATUS_MALFORMED;
}

enum status s3_client_ask(struct s3_client *client, struct s3_request *request, int *code, struct error *error) {
    CURL *curl = take_handle(client);
    if (!curl) return error_set(error, STATUS_NO_MEMORY, "blobs", "no memory");
    enum status status = STATUS_IO;
    for (int i = 0; i < TRIES; i++) {
        if (i) poll(NULL, 0, PAUSE_MS << i);
        start_again(request);
        bool again = false;
        request->tries = i + 1;
        status = try_once(client, curl, request, code, &again, error);
        if (!again && !is_for_now(request, status, *code)) break;
    }
    give_handle(client, curl);
    return status;
}

bool s3_client_presign(struct s3_client *client, const char *name, unsigned seconds, const char *type,
                       const char *disposition, char *url, size_t bytes) {
    char path[URL_BYTES], told[URL_BYTES], query[2 * URL_BYTES];
    char *encoded_type = s3_client_encode(type), *encoded = s3_client_encode(disposition);
    int n = encoded && encoded_type
                ? snprintf(told, sizeof told, "response-content-disposition=%s&response-content-type=%s", encoded,
                           encoded_type)
                : -1;
    free(encoded_type);
    free(encoded);
    if (n < 0 || n >= URL_BYTES || !encode_path(client, !client->is_host_style, name, path)) return false;
    struct signature_v4_request to_sign = {.method = "GET", .host = client->host, .path = path, .query = told};
    write_date(client, 0, to_sign.date);
    return signature_v4_presign(&client->keys, &to_sign, seconds, query, sizeof query) &&
           make_url(client, path, query, url, bytes);
}
