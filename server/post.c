/* A POST by libcurl.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/post.h"

#include <curl/curl.h>
#include <stdbool.h>
#include <string.h>
#include <sys/socket.h>

#include "server/inside.h"

struct guard {
    const char *allow;
    bool refused;
};

enum status post_open(struct error *error) {
    if (curl_global_init(CURL_GLOBAL_DEFAULT) == CURLE_OK) return STATUS_OK;
    return error_set(error, STATUS_NO_MEMORY, "webhooks", "libcurl doesn't start");
}

void post_close(void) { curl_global_cleanup(); }

/* libcurl asks for a socket to this very address. */
static curl_socket_t open_socket(void *ctx, curlsocktype purpose, struct curl_sockaddr *address) {
    struct guard *guard = ctx;
    (void)purpose;
    if (inside_is(&address->addr) && !inside_is_listed(&address->addr, guard->allow)) {
        guard->refused = true;
        return CURL_SOCKET_BAD;
    }
    return socket(address->family, address->socktype | SOCK_CLOEXEC, address->protocol);
}

/* The answer's text means nothing here. */
static size_t ignore(char *bytes, size_t size, size_t count, void *ctx) {
    (void)bytes;
    (void)ctx;
    return size * count;
}

/* libcurl asks whether to go on, at least once a second. */
static int goes_on(void *ctx, curl_off_t down_total, curl_off_t down, curl_off_t up_total, curl_off_t up) {
    const struct post *post = ctx;
    (void)down_total, (void)down, (void)up_total, (void)up;
    return atomic_load(post->stop);
}

static void configure(CURL *curl, const struct post *post, struct guard *guard, struct curl_slist *headers, char *why) {
    curl_easy_setopt(curl, CURLOPT_URL, post->url);
    curl_easy_setopt(curl, CURLOPT_PROTOCOLS_STR, "http,https");
    curl_easy_setopt(curl, CURLOPT_FOLLOWLOCATION, 0L);
    curl_easy_setopt(curl, CURLOPT_NOPROXY, "*");
    curl_easy_setopt(curl, CURLOPT_NOSIGNAL, 1L);
    curl_easy_setopt(curl, CURLOPT_TIMEOUT_MS, post->timeout_ms);
    curl_easy_setopt(curl, CURLOPT_MAXFILESIZE_LARGE, (curl_off_t)1 << 20);
    curl_easy_setopt(curl, CURLOPT_HTTPHEADER, headers);
    curl_easy_setopt(curl, CURLOPT_POST, 1L);
    curl_easy_setopt(curl, CURLOPT_POSTFIELDSIZE_LARGE, (curl_off_t)post->body_bytes);
    curl_easy_setopt(curl, CURLOPT_POSTFIELDS, post->body);
    curl_easy_setopt(curl, CURLOPT_OPENSOCKETFUNCTION, open_socket);
    curl_easy_setopt(curl, CURLOPT_OPENSOCKETDATA, guard);
    curl_easy_setopt(curl, CURLOPT_WRITEFUNCTION, ignore);
    curl_easy_setopt(curl, CURLOPT_NOPROGRESS, 0L);
    curl_easy_setopt(curl, CURLOPT_XFERINFOFUNCTION, goes_on);
    curl_easy_setopt(curl, CURLOPT_XFERINFODATA, post);
    curl_easy_setopt(curl, CURLOPT_ERRORBUFFER, why);
}

enum status post_send(const struct post *post, int *http_status, struct error *error) {
    char why[CURL_ERROR_SIZE] = "";
    struct guard guard = {.allow = post->allow};
    struct curl_slist *headers = NULL;
    CURL *curl = curl_easy_init();
    long code = 0;
    if (!curl) return error_set(error, STATUS_NO_MEMORY, "webhook", "no memory");
    for (size_t i = 0; i < POST_MAX_HEADERS && post->header[i]; i++)
        headers = curl_slist_append(headers, post->header[i]);
    configure(curl, post, &guard, headers, why);
    CURLcode result = curl_easy_perform(curl);
    if (result == CURLE_OK) curl_easy_getinfo(curl, CURLINFO_RESPONSE_CODE, &code);
    curl_slist_free_all(headers);
    curl_easy_cleanup(curl);
    *http_status = (int)code;
    if (result == CURLE_OK) return STATUS_OK;
    return error_set(error, STATUS_IO, "webhook", "%s",
                     guard.refused ? "its address is not on the public internet"
                     : why[0]      ? why
                                   : curl_easy_strerror(result));
}

bool post_url_valid(const char *url) {
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
