/* What web pages may do with the service: hosts, origins and CORS (the Fetch standard, section 3.2).
 *
 * A browser sends what any page tells it to, also to a service on the reader's own machine, where it needs no token.
 * Two checks keep other people's pages out, and leave programs (curl, REST clients) alone:
 *
 *  - Host.  A page whose name server answers with our address would count as ours (DNS rebinding).  Its requests carry
 *    its name, so only names that are ours are answered: addresses and localhost, the one that --listen names, the
 *    machine's own, and those in --allowed-hosts.  Where tokens are wanted a page has none, and every host is answered
 *    unless --allowed-hosts says which; where the service is open to a network (--insecure-open), names without a dot
 *    are taken as well.  Health is told to every host.
 *  - Origin.  What changes something is refused when the browser says that a page of another origin sends it
 *    (Sec-Fetch-Site, else Origin).  --cors-origins names pages that may; they are given the CORS headers too.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/http/http_internal.h"

#include <limits.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

#include "api/site.h"

/* What a page's script may read of a response, beyond what the Fetch standard lets it. */
static const char exposed[] =
    "Accept-Patch, Accept-Ranges, Allow, Cache-Status, Content-Disposition, Content-Range, ETag, Job-Stats, Link, "
    "Location, "
    "Preference-Applied, Repr-Digest, Retry-After, Server-Timing, Tus-Checksum-Algorithm, Tus-Extension, Tus-Max-Size, "
    "Tus-Resumable, Tus-Version, Upload-Complete, Upload-Concat, Upload-Defer-Length, Upload-Draft-Interop-Version, "
    "Upload-Expires, Upload-Length, Upload-Limit, Upload-Metadata, "
    "Upload-Offset, "
    "Whittle-Cloud, WWW-Authenticate, X-Request-Id";
/* And what it may send. */
static const char sent[] =
    "Accept, Authorization, Cache-Control, Content-Digest, Content-Encoding, Content-Type, Idempotency-Key, If-Match, "
    "If-None-Match, If-Range, Last-Event-ID, Prefer, Range, Repr-Digest, traceparent, Tus-Resumable, Upload-Checksum, "
    "Upload-Complete, Upload-Concat, Upload-Defer-Length, Upload-Draft-Interop-Version, Upload-Length, "
    "Upload-Metadata, Upload-Offset, X-HTTP-Method-Override, "
    "X-Request-Id, X-Requested-With";
_Static_assert(sizeof exposed <= RESPONSE_HEADER_BYTES && sizeof sent <= RESPONSE_HEADER_BYTES, "a header holds them");

enum { PREFLIGHT_AGE_S = 7200 /* browsers take no more */ };

/* ------------------------------------------------------------------------------------------------ hosts */

static bool is_health(const struct route *route) {
    return route && (route->operation == OPERATION_GET_HEALTH || route->operation == OPERATION_GET_READINESS);
}

static bool is_this_machine(const char *authority) {
    char name[HOST_NAME_MAX + 1] = "";
    return gethostname(name, sizeof name - 1) == 0 && name[0] && site_host_listed(name, authority);
}

/* --listen, without its port. */
static bool is_listened_on(const char *listen, const char *authority) {
    const char *colon = strrchr(listen, ':');
    size_t length = colon ? (size_t)(colon - listen) : 0;
    return length && strncasecmp(listen, authority, length) == 0 && (!authority[length] || authority[length] == ':');
}

bool cross_site_admit_host(const struct config *config, const struct request *request, struct response *response) {
    const char *host = request->header[HEADER_HOST];
    if (!host || is_health(request->match.route)) return true;
    if (config->tokens_file[0] && !config->allowed_hosts[0]) return true;
    if (site_host_is_local(host) || site_host_listed(config->allowed_hosts, host)) return true;
    if (config->insecure_open && site_host_is_short(host)) return true;
    if (is_listened_on(config->listen, host) || is_this_machine(host)) return true;
    response_refuse(response, PROBLEM_UNKNOWN_HOST, "Host: %.200s is no name of this service; --allowed-hosts adds it",
                    host);
    return false;
}

/* ------------------------------------------------------------------------------------------------ origins */

static bool is_shared(const struct config *config, const struct request *request) {
    const char *origin = request->header[HEADER_ORIGIN];
    return origin && site_origin_listed(config->cors_origins, origin);
}

static bool changes_something(const char *method) {
    return strcmp(method, "GET") != 0 && strcmp(method, "HEAD") != 0 && strcmp(method, "OPTIONS") != 0;
}

/* Whether the browser says so; who sends neither header is none. */
static bool is_foreign(const struct request *request) {
    const char *site = request->header[HEADER_SEC_FETCH_SITE], *origin = request->header[HEADER_ORIGIN];
    if (site) return strcasecmp(site, "same-origin") != 0 && strcasecmp(site, "none") != 0;
    return origin && !(request->header[HEADER_HOST] && site_origin_is_of(origin, request->header[HEADER_HOST]));
}

bool cross_site_admit_origin(const struct config *config, const struct request *request, struct response *response) {
    const char *origin = request->header[HEADER_ORIGIN];
    if (!changes_something(request->method) || is_shared(config, request) || !is_foreign(request)) return true;
    response_refuse(response, PROBLEM_CROSS_SITE,
                    "a web page of %.200s sends this, which is another origin; --cors-origins allows it",
                    origin ? origin : "another site");
    return false;
}

/* ------------------------------------------------------------------------------------------------ CORS */

bool cross_site_preflight(const struct config *config, const struct request *request, struct response *response) {
    if (strcmp(request->method, "OPTIONS") != 0 || !request->header[HEADER_REQUEST_METHOD]) return false;
    if (!request->match.allow[0] || !is_shared(config, request)) return false;
    response->status = 204;
    response_header(response, "Access-Control-Allow-Methods", "%s", request->match.allow);
    response_header(response, "Access-Control-Allow-Headers", "%s", sent);
    response_header(response, "Access-Control-Max-Age", "%d", PREFLIGHT_AGE_S);
    return true;
}

void cross_site_share(const struct config *config, const struct request *request, struct response *response) {
    if (!config->cors_origins[0]) return;
    bool all = site_origin_listed(config->cors_origins, "*");
    if (!all) response_header(response, "Vary", "Origin");
    if (!is_shared(config, request)) return;
    response_header(response, "Access-Control-Allow-Origin", "%s", all ? "*" : request->header[HEADER_ORIGIN]);
    response_header(response, "Access-Control-Expose-Headers", "%s", exposed);
}
