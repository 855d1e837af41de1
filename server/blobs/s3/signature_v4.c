/* AWS Signature Version 4.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/blobs/s3/signature_v4.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "server/base/digest.h"

enum { RAW_BYTES = 32, DAY_BYTES = 8 };

static void to_raw(const char hex[DIGEST_HEX_BYTES], unsigned char raw[RAW_BYTES]) {
    static const char digits[] = "0123456789abcdef";
    for (size_t i = 0; i < RAW_BYTES; i++)
        raw[i] =
            (unsigned char)((strchr(digits, hex[2 * i]) - digits) * 16 + (strchr(digits, hex[2 * i + 1]) - digits));
}

/* The key of a day, a region and a service: each is mixed in by an HMAC of its own. */
static void make_key(const struct signature_v4_keys *keys, const char *day, unsigned char key[RAW_BYTES]) {
    char first[160], hex[DIGEST_HEX_BYTES];
    const char *const parts[] = {day, keys->region, "s3", "aws4_request"};
    int n = snprintf(first, sizeof first, "AWS4%s", keys->secret);
    digest_hmac(first, (size_t)n, parts[0], strlen(parts[0]), hex);
    to_raw(hex, key);
    for (size_t i = 1; i < sizeof parts / sizeof *parts; i++) {
        digest_hmac(key, RAW_BYTES, parts[i], strlen(parts[i]), hex);
        to_raw(hex, key);
    }
}

/* The request as both sides write it down; returns new, NULL when memory runs out. */
static char *make_canonical(const struct signature_v4_request *request, const char *signed_headers) {
    char *text = NULL;
    int n = asprintf(&text, "%s\n%s\n%s\nhost:%s\nx-amz-content-sha256:%s\n%s%s%sx-amz-date:%s\n\n%s\n%s",
                     request->method, request->path, request->query, request->host, request->body_sha256,
                     request->copy_source ? "x-amz-copy-source:" : "", request->copy_source ? request->copy_source : "",
                     request->copy_source ? "\n" : "", request->date, signed_headers, request->body_sha256);
    return n < 0 ? NULL : text;
}

/* The signature of a canonical request (takes it; NULL = memory ran out) at a date; with the scope of the keys. */
static bool sign_canonical(const struct signature_v4_keys *keys, char *canonical, const char *date, char scope[128],
                           char signature[DIGEST_HEX_BYTES]) {
    char day[DAY_BYTES + 1], hash[DIGEST_HEX_BYTES], text[320];
    unsigned char key[RAW_BYTES];
    snprintf(day, sizeof day, "%.8s", date);
    bool ok = canonical && digest_text(canonical, hash);
    free(canonical);
    if (!ok) return false;
    snprintf(scope, 128, "%s/%s/s3/aws4_request", day, keys->region);
    int n = snprintf(text, sizeof text, "AWS4-HMAC-SHA256\n%s\n%s\n%s", date, scope, hash);
    make_key(keys, day, key);
    digest_hmac(key, sizeof key, text, (size_t)n, signature);
    explicit_bzero(key, sizeof key);
    return true;
}

bool signature_v4_make(const struct signature_v4_keys *keys, const struct signature_v4_request *request,
                       char value[SIGNATURE_V4_BYTES]) {
    const char *signed_headers = request->copy_source ? "host;x-amz-content-sha256;x-amz-copy-source;x-amz-date"
                                                      : "host;x-amz-content-sha256;x-amz-date";
    char scope[128], signature[DIGEST_HEX_BYTES];
    if (!sign_canonical(keys, make_canonical(request, signed_headers), request->date, scope, signature)) return false;
    snprintf(value, SIGNATURE_V4_BYTES, "AWS4-HMAC-SHA256 Credential=%s/%s, SignedHeaders=%s, Signature=%s",
             keys->access, scope, signed_headers, signature);
    return true;
}

bool signature_v4_presign(const struct signature_v4_keys *keys, const struct signature_v4_request *request,
                          unsigned seconds, char *query, size_t bytes) {
    char *canonical = NULL, scope[128], signature[DIGEST_HEX_BYTES];
    int n = snprintf(query, bytes,
                     "X-Amz-Algorithm=AWS4-HMAC-SHA256&X-Amz-Credential=%s%%2F%.8s%%2F%s%%2Fs3%%2Faws4_request&"
                     "X-Amz-Date=%s&X-Amz-Expires=%u&X-Amz-SignedHeaders=host%s%s",
                     keys->access, request->date, keys->region, request->date, seconds, request->query[0] ? "&" : "",
                     request->query);
    if (n < 0 || (size_t)n + sizeof "&X-Amz-Signature=" + DIGEST_HEX_BYTES > bytes) return false;
    if (asprintf(&canonical, "%s\n%s\n%s\nhost:%s\n\nhost\nUNSIGNED-PAYLOAD", request->method, request->path, query,
                 request->host) < 0)
        return false;
    if (!sign_canonical(keys, canonical, request->date, scope, signature)) return false;
    snprintf(query + n, bytes - (size_t)n, "&X-Amz-Signature=%s", signature);
    return true;
}
