/* What the service says of itself: parameters, limits, contract, health, and a page for people.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

#include "api/codecs/job_json.h"
#include "api/codecs/params_json.h"
#include "api/docs_page.h"
#include "api/links.h"
#include "api/openapi/openapi.h"
#include "api/site.h"
#include "core/base/version.h"
#include "server/handlers/handlers.h"
#include "server/handlers/page.h"
#include "server/jobs/metrics.h"
#include "server/jobs/readiness.h"

/* A page that loads nothing; takes text. */
static void answer_page(char *text, struct response *response) {
    response_text(response, 200, "text/html; charset=utf-8", text);
    response_header(response, "Content-Security-Policy", "default-src 'none'; style-src 'unsafe-inline'");
}

/* Where the request found the service: "https://host/base", without http:// as curl has it by itself.  A proxy that
 * ended TLS says so. */
static void put_address(FILE *out, const struct request *request) {
    const char *host = request->header[HEADER_HOST], *forwarded = request->header[HEADER_FORWARDED_PROTO];
    bool secure = request->secure || (forwarded && strcasecmp(forwarded, "https") == 0);
    fprintf(out, "%s%s%s", secure ? "https://" : "", host && site_host_is_plain(host) ? host : "localhost:8080",
            links_base());
}

/* What stands for something else in the page, and what puts it there. */
static void put_base(FILE *out, const struct request *request) {
    (void)request;
    fputs(links_base(), out);
}

static const struct place {
    const char *name;
    void (*put)(FILE *out, const struct request *request);
} places[] = {{"$HERE", put_address}, {"$BASE", put_base}};
enum { PLACES = sizeof places / sizeof *places };

/* The page with its links and curl lines for this address; returns new, NULL: no memory. */
static char *page_here(const struct request *request) {
    size_t left, bytes;
    const char *from = page_document(&left), *found;
    char *text = NULL;
    FILE *out = open_memstream(&text, &bytes);
    while (out && (found = memchr(from, '$', left))) {
        size_t before = (size_t)(found - from), i = 0;
        fwrite(from, 1, before, out);
        from = found, left -= before;
        while (i < PLACES && (left < 5 || memcmp(from, places[i].name, 5) != 0)) i++;
        size_t used = i < PLACES ? strlen(places[i].name) : 1;
        if (i < PLACES)
            places[i].put(out, request);
        else
            fputc('$', out);
        from += used, left -= used;
    }
    if (out) fwrite(from, 1, left, out);
    if (out && fclose(out) == 0) return text;
    free(text);
    return NULL;
}

/* What the page may load: its own files, and nothing from anywhere else. */
static const char page_policy[] =
    "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' blob: data:; "
    "worker-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

static void send_page(const struct request *request, struct response *response) {
    if (!page_has_files()) {
        answer_page(page_here(request), response);
    } else {
        response_text(response, 200, "text/html; charset=utf-8", page_here(request));
        response_header(response, "Content-Security-Policy", "%s", page_policy);
        response_header(response, "Referrer-Policy", "no-referrer");
    }
    response_header(response, "Cache-Control", "no-cache");
    response_header(response, "Vary", "Host");
}

static void get_page(struct service *service, struct request *request, struct response *response) {
    (void)service;
    if (handlers_takes_no_query(request, response)) send_page(request, response);
}

const struct handler handlers_get_page = {.run = get_page, .quick = true};

/* A browser names what it shows; programs ask for anything, or for JSON. */
static bool is_browser(const struct request *request) {
    const char *accepted = request->header[HEADER_ACCEPT];
    return accepted && strcasestr(accepted, "text/html");
}

/* The same page, which shows the job that its address names: whether there is one, and whose, the page asks. */
static void get_job_page(struct service *service, struct request *request, struct response *response) {
    (void)service;
    if (!handlers_takes_no_query(request, response)) return;
    if (job_id_valid(request->match.capture[0])) {
        send_page(request, response);
    } else if (is_browser(request)) {
        answer_page(problem_page(problem_type_of_slug("no-such-job")), response);
        response->status = 404;
    } else {
        response_refuse(response, PROBLEM_NO_SUCH_RESOURCE, "a job's page is at /jobs/ and its id");
    }
    response_header(response, "Vary", "Accept");
}

const struct handler handlers_get_job_page = {.run = get_job_page, .quick = true};

/* Whether the client takes gzip: where it names it, or *, and not with q=0. */
static bool takes_gzip(const struct request *request) {
    const char *list = request->header[HEADER_ACCEPT_ENCODING];
    while (list && *list) {
        list += strspn(list, " \t,");
        size_t name = strcspn(list, " \t;,"), whole = strcspn(list, ",");
        bool is_it = (name == 4 && strncasecmp(list, "gzip", 4) == 0) || (name == 1 && *list == '*');
        const char *weight = memmem(list, whole, "q=", 2);
        if (is_it) return !weight || strtod(weight + 2, NULL) > 0;
        list += whole;
    }
    return false;
}

/* Names have a hash of the content, so what is behind one never changes. */
static void get_page_file(struct service *service, struct request *request, struct response *response) {
    static const char for_ever[] = "public, max-age=31536000, immutable";
    struct page_file file;
    char etag[ROUTES_CAPTURE_BYTES + 8];
    (void)service;
    if (!handlers_takes_no_query(request, response)) return;
    if (!page_file(request->match.capture[0], &file)) {
        response_refuse(response, PROBLEM_NO_SUCH_RESOURCE, "the page has no file of this name");
        return;
    }
    bool packed = takes_gzip(request);
    size_t bytes = packed ? file.packed_bytes : file.plain_bytes;
    snprintf(etag, sizeof etag, "\"%s%s\"", request->match.capture[0], packed ? ".gz" : "");
    if (request_none_match(request, etag)) {
        response_unchanged(response, etag, for_ever, bytes);
    } else {
        char *text = malloc(bytes + 1);
        if (text) memcpy(text, packed ? file.packed : file.plain, bytes), text[bytes] = 0;
        response_text(response, 200, file.type, text);
        if (text) response->text_bytes = bytes; /* which may have bytes of 0 */
        response_header(response, "ETag", "%s", etag);
        response_header(response, "Cache-Control", "%s", for_ever);
        if (packed) response_header(response, "Content-Encoding", "gzip");
        response_header(response, "Content-Security-Policy", "%s", page_policy);
    }
    response_header(response, "Vary", "Accept-Encoding");
}

const struct handler handlers_get_page_file = {.run = get_page_file, .quick = true};

/* The script beside the page's files, and what it asks of this service. */
static const char docs_policy[] =
    "default-src 'none'; script-src 'self'; connect-src 'self'; style-src 'unsafe-inline'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

static void get_docs(struct service *service, struct request *request, struct response *response) {
    char *here = NULL;
    size_t bytes;
    (void)service;
    if (!handlers_takes_no_query(request, response)) return;
    FILE *out = open_memstream(&here, &bytes);
    if (out) put_address(out, request);
    bool whole = out && fclose(out) == 0;
    const char *script = page_docs_script();
    char *text = whole ? docs_page(here, script) : NULL;
    if (script) {
        response_text(response, 200, "text/html; charset=utf-8", text);
        response_header(response, "Content-Security-Policy", "%s", docs_policy);
    } else {
        answer_page(text, response);
    }
    response_header(response, "Vary", "Host");
    free(here);
}

const struct handler handlers_get_docs = {.run = get_docs, .quick = true};

static void get_parameters(struct service *service, struct request *request, struct response *response) {
    (void)service;
    if (handlers_takes_no_query(request, response))
        response_text(response, 200, "application/schema+json", params_schema());
}

const struct handler handlers_get_parameters = {.run = get_parameters, .quick = true};

static bool measure(void *ctx, size_t i, const char **name, int64_t *value) {
    const struct service *service = ctx;
    if (i >= SERVICE_MEASURES || !service->confinement[i].name) return false;
    *name = service->confinement[i].name;
    *value = service->confinement[i].value;
    return true;
}

static void get_info(struct service *service, struct request *request, struct response *response) {
    if (!handlers_takes_no_query(request, response)) return;
    struct config settings = *service->config;
    struct job_info_list limits = {config_limit, &settings}, confinement = {measure, service};
    response_text(response, 200, "application/json", job_info_encode(whittle_version(), limits, confinement));
}

const struct handler handlers_get_info = {.run = get_info, .quick = true};

static void get_contract(struct service *service, struct request *request, struct response *response) {
    (void)service;
    if (handlers_takes_no_query(request, response)) response_text(response, 200, "application/json", openapi_here());
}

const struct handler handlers_get_contract = {.run = get_contract, .quick = true};

static void get_problem(struct service *service, struct request *request, struct response *response) {
    const struct problem_type *type = problem_type_of_slug(request->match.capture[0]);
    (void)service;
    if (!handlers_takes_no_query(request, response)) return;
    if (type)
        answer_page(problem_page(type), response);
    else
        response_refuse(response, PROBLEM_NO_SUCH_RESOURCE, "there is no problem of this name");
}

const struct handler handlers_get_problem = {.run = get_problem, .quick = true};

static void get_health(struct service *service, struct request *request, struct response *response) {
    (void)service;
    (void)request;
    response_text(response, 200, "application/json", strdup("{\"status\":\"alive\"}"));
    response_header(response, "Cache-Control", "no-store");
}

const struct handler handlers_get_health = {.run = get_health, .quick = true};

static void get_readiness(struct service *service, struct request *request, struct response *response) {
    uint64_t waiting, running;
    struct problem problem;
    (void)request;
    catalog_depth(service->catalog, &waiting, &running);
    if (atomic_load(&service->draining))
        response_refuse(response, PROBLEM_DRAINING, "the service is shutting down");
    else if (waiting >= (uint64_t)service->config->max_queue)
        response_refuse(response, PROBLEM_QUEUE_FULL, "%llu jobs are waiting", (unsigned long long)waiting);
    else if (!readiness_is_given(service->readiness, &problem))
        response_problem(response, &problem);
    else
        response_text(response, 200, "application/json", strdup("{\"status\":\"ready\"}"));
    response_header(response, "Cache-Control", "no-store");
}

const struct handler handlers_get_readiness = {.run = get_readiness, .quick = true};

static void get_metrics(struct service *service, struct request *request, struct response *response) {
    if (!handlers_takes_no_query(request, response)) return;
    response_text(response, 200, "text/plain; version=0.0.4; charset=utf-8", metrics_text(service->metrics, service));
    response_header(response, "Cache-Control", "no-store");
}

const struct handler handlers_get_metrics = {.run = get_metrics, .quick = true};
