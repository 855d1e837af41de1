/* Who makes a request, and whether it may.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/http/access.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <time.h>

#include "server/auth/tokens.h"

static const char *scope_name(enum routes_scope scope) {
    return scope == ROUTES_SUBMIT ? "submit" : scope == ROUTES_READ ? "read" : "admin";
}

/* ------------------------------------------------------------------------------------------------ refusals */

static bool refuse_unknown(const char *detail, const char *code, struct response *response) {
    response_refuse(response, PROBLEM_UNAUTHORIZED, "%s", detail);
    response_header(response, "WWW-Authenticate", "Bearer realm=\"whittled\"%s%s%s", *code ? ", error=\"" : "", code,
                    *code ? "\"" : "");
    return false;
}

static bool refuse_scope(enum routes_scope scope, struct response *response) {
    struct problem problem;
    problem_set(&problem, PROBLEM_FORBIDDEN, "the token does not have the scope %s", scope_name(scope));
    problem_add_text(&problem, "scope", scope_name(scope));
    response_problem(response, &problem);
    response_header(response, "WWW-Authenticate",
                    "Bearer realm=\"whittled\", error=\"insufficient_scope\", scope=\"%s\"", scope_name(scope));
    return false;
}

/* ------------------------------------------------------------------------------------------------ signatures */

void access_output_path(const char *id, const char *name, char path[ACCESS_PATH_BYTES]) {
    snprintf(path, ACCESS_PATH_BYTES, "/v1/jobs/%s/outputs/%s", id, name);
}

/* Takes the first argument of this name out of the query; NULL where there is none. */
static const char *take_signature_argument(struct request *request, const char *name) {
    size_t i = 0;
    while (i < request->query_count && strcmp(request->query[i].name, name) != 0) i++;
    if (i == request->query_count) return NULL;
    const char *value = request->query[i].value ? request->query[i].value : "";
    memmove(&request->query[i], &request->query[i + 1], (--request->query_count - i) * sizeof request->query[0]);
    return value;
}

static bool check_signature(const struct service *service, struct request *request, const char *expires,
                            const char *signature, struct response *response) {
    char path[ACCESS_PATH_BYTES], *end = NULL;
    long long until = expires && expires[0] >= '0' && expires[0] <= '9' ? strtoll(expires, &end, 10) : -1;
    access_output_path(request->match.capture[0], request->match.capture[1], path);
    bool holds = end && !*end && strlen(expires) <= 15 && signature &&
                 signature_holds(&service->signing_key, path, until, signature);
    if (holds && until > (long long)time(NULL)) {
        request->principal = (struct principal){.scopes = ROUTES_READ, .by_signature = true};
        return true;
    }
    response_refuse(response, PROBLEM_FORBIDDEN,
                    holds ? "the link has expired" : "the signature of the link is not valid");
    return false;
}

/* ------------------------------------------------------------------------------------------------ tokens */

/* The token of "Bearer TOKEN"; NULL where it is something else. */
static const char *bearer_token(const char *header) {
    static const char scheme[] = "Bearer";
    if (strncasecmp(header, scheme, sizeof scheme - 1) != 0 || header[sizeof scheme - 1] != ' ') return NULL;
    header += sizeof scheme - 1;
    return header + strspn(header, " ");
}

static bool check_token(const struct service *service, struct request *request, struct response *response) {
    const char *header = request->header[HEADER_AUTHORIZATION], *token = header ? bearer_token(header) : NULL;
    enum routes_scope scope = request->match.route->scope;
    bool known = token && tokens_find(service->tokens, token, &request->principal);
    if (!known) request->principal = (struct principal){0};
    if (scope == ROUTES_PUBLIC) return true;
    if (!header) return refuse_unknown("this operation needs Authorization: Bearer and a token", "", response);
    if (!token) return refuse_unknown("Authorization has to be Bearer and a token", "invalid_request", response);
    if (!known) return refuse_unknown("this token is unknown", "invalid_token", response);
    return (request->principal.scopes & (scope | ROUTES_ADMIN)) || refuse_scope(scope, response);
}

bool access_admit(struct service *service, struct request *request, struct response *response) {
    if (request->match.route->operation == OPERATION_GET_OUTPUT) {
        const char *expires = take_signature_argument(request, "exp"),
                   *signature = take_signature_argument(request, "sig");
        if (expires || signature) return check_signature(service, request, expires, signature, response);
    }
    return !service->tokens || check_token(service, request, response);
}
