/* A POST by libcurl.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/webhooks/http_client.h"

#include <ctype.h>
#include <curl/curl.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/socket.h>

#include "core/base/clock.h"
#include "server/webhooks/address_filter.h"

enum { HEAD_MAX_BYTES = 64 * 1024, BODY_MAX_BYTES = 64 * 1024, BODY_MS = 2000 };

/* One POST under way. */
struct attempt {
    const struct http_client_post *post;
    CURL *curl;
    bool refused;      /* its address is an inside one */
    long answer;       /* the status, once the answer's headers are complete; 0 before */
    int64_t answer_ms; /* when that was */
    size_t head_bytes, body_bytes;
};

enum status http_client_open(struct error *error) {
    if (curl_global_init(CURL_GLOBAL_DEFAULT) == CURLE_OK) return STATUS_OK;
    return error_set(error, STATUS_NO_MEMORY, "webhooks", "libcurl doesn't start");
}

void http_client_close(void) { curl_global_cleanup(); }

/* libcurl asks for a socket to this very address. */
static curl_socket_t open_socket(void *ctx, curlsocktype purpose, struct curl_sockaddr *address) {
    struct attempt *attempt = ctx;
    (void)purpose;
    if (address_is_inside(&address->addr) && !address_is_listed(&address->addr, attempt->post->allow)) {
        attempt->refused = true;
        return CURL_SOCKET_BAD;
    }
    return socket(address->family, address->socktype | SOCK_CLOEXEC, address->protocol);
}

/* A line of the answer's headers, those of interim answers among them; what isn't taken ends the transfer. */
static size_t take_header(char *bytes, size_t size, size_t count, void *ctx) {
    struct attempt *attempt = ctx;
    size_t length = size * count;
    long code = 0;
    attempt->head_bytes += length;
    if (attempt->head_bytes > HEAD_MAX_BYTES) return 0;
    bool complete = length == 2 && memcmp(bytes, "\r\n", 2) == 0;
    if (complete) curl_easy_getinfo(attempt->curl, CURLINFO_RESPONSE_CODE, &code);
    if (code >= 200) {
        attempt->answer = code;
        attempt->answer_ms = clock_ms();
    }
    return length;
}

/* The answer's text means nothing here: a short one is read away, so that who sends it isn't cut off. */
static size_t ignore(char *bytes, size_t size, size_t count, void *ctx) {
    struct attempt *attempt = ctx;
    (void)bytes;
    attempt->body_bytes += size * count;
    return attempt->body_bytes > BODY_MAX_BYTES ? 0 : size * count;
}

/* libcurl asks whether to go on, at least once a second. */
static int ends_now(void *ctx, curl_off_t down_total, curl_off_t down, curl_off_t up_total, curl_off_t up) {
    const struct attempt *attempt = ctx;
    (void)down_total, (void)down, (void)up_total, (void)up;
    bool long_enough = attempt->answer && clock_ms() - attempt->answer_ms > BODY_MS;
    return atomic_load(attempt->post->stop) || long_enough;
}

static void configure(struct attempt *attempt, struct curl_slist *headers, char *why) {
    const struct http_client_post *post = attempt->post;
    CURL *curl = attempt->curl;
    curl_easy_setopt(curl, CURLOPT_URL, post->url);
    curl_easy_setopt(curl, CURLOPT_PROTOCOLS_STR, "http,https");
    curl_easy_setopt(curl, CURLOPT_FOLLOWLOCATION, 0L);
    curl_easy_setopt(curl, CURLOPT_NOPROXY, "*");
    curl_easy_setopt(curl, CURLOPT_NOSIGNAL, 1L);
    curl_easy_setopt(curl, CURLOPT_TIMEOUT_MS, post->timeout_ms);
    curl_easy_setopt(curl, CURLOPT_HTTPHEADER, headers);
    curl_easy_setopt(curl, CURLOPT_POST, 1L);
    curl_easy_setopt(curl, CURLOPT_POSTFIELDSIZE_LARGE, (curl_off_t)post->body_bytes);
    curl_easy_setopt(curl, CURLOPT_POSTFIELDS, post->body);
    curl_easy_setopt(curl, CURLOPT_OPENSOCKETFUNCTION, open_socket);
    curl_easy_setopt(curl, CURLOPT_OPENSOCKETDATA, attempt);
    curl_easy_setopt(curl, CURLOPT_HEADERFUNCTION, take_header);
    curl_easy_setopt(curl, CURLOPT_HEADERDATA, attempt);
    curl_easy_setopt(curl, CURLOPT_WRITEFUNCTION, ignore);
    curl_easy_setopt(curl, CURLOPT_WRITEDATA, attempt);
    curl_easy_setopt(curl, CURLOPT_NOPROGRESS, 0L);
    curl_easy_setopt(curl, CURLOPT_XFERINFOFUNCTION, ends_now);
    curl_easy_setopt(curl, CURLOPT_XFERINFODATA, attempt);
    curl_easy_setopt(curl, CURLOPT_ERRORBUFFER, why);
}

enum status http_client_post(const struct http_client_post *post, int *http_status, struct error *error) {
    char why[CURL_ERROR_SIZE] = "";
    struct curl_slist *headers = NULL;
    struct attempt attempt = {.post = post, .curl = curl_easy_init()};
    if (!attempt.curl) return error_set(error, STATUS_NO_MEMORY, "webhook", "no memory");
    for (size_t i = 0; i < HTTP_CLIENT_MAX_HEADERS && post->header[i]; i++)
        headers = curl_slist_append(headers, post->header[i]);
    configure(&attempt, headers, why);
    CURLcode result = curl_easy_perform(attempt.curl);
    curl_slist_free_all(headers);
    curl_easy_cleanup(attempt.curl);
    *http_status = (int)attempt.answer;
    if (attempt.answer) return STATUS_OK; /* whatever became of its text */
    return error_set(error, STATUS_IO, "webhook", "%s",
                     attempt.refused               ? "its address is not on the public internet"
                     : result == CURLE_WRITE_ERROR ? "the answer's headers are longer than 64 KiB"
                     : why[0]                      ? why
                                                   : curl_easy_strerror(result));
}

bool http_client_url_host(const char *url, char *host, size_t bytes) {
    CURLU *parsed = curl_url();
    char *name = NULL, *port = NULL;
    bool ok = parsed && curl_url_set(parsed, CURLUPART_URL, url, 0) == CURLUE_OK &&
              curl_url_get(parsed, CURLUPART_HOST, &name, 0) == CURLUE_OK &&
              curl_url_get(parsed, CURLUPART_PORT, &port, CURLU_DEFAULT_PORT) == CURLUE_OK;
    if (ok) snprintf(host, bytes, "%s:%s", name, port);
    for (char *c = host; ok && *c; c++) *c = (char)tolower((unsigned char)*c);
    curl_free(name);
    curl_free(port);
    curl_url_cleanup(parsed);
    return ok;
}

bool http_client_url_valid(const char *url) {
    CURLU *parsed = curl_url();
    char *scheme = NULL, *host = NULL;
    bool valid = parsed && curl_url_set(parsed, CURLUPART_URL, url, CURLU_DISALLOW_USER) == CURLUE_OK &&
                 curl_url_get(parsed, CURLUPART_SCHEME, &scheme, 0) == CURLUE_OK &&
                 curl_url_get(parsed, CURLUPART_HOST, &host, 0) == CURLUE_OK &&
                 (strcmp(scheme, "http") == 0 || strcmp(scheme, "https") == 0);
    curl_free(scheme);
    curl_free(host);
    curl_url_cleanup(parsed);
    return valid;
}
