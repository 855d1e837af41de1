/* The reference page: for each tag its operations, for each operation what goes in and what comes out; then the
 * schemas.
 *
 * The document is our own, so what is missing from it is left out silently; the tests hold that nothing is.  Whatever
 * is written passes through put_escaped.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/docs_page.h"

#include <jansson.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "api/links.h"
#include "api/openapi/openapi.h"

static const char style[] =
    ":root{color-scheme:light dark}"
    "body{font:15px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;"
    "color:#23272f;background:#fafaf8}a{color:#8c3b12}"
    "table{border-collapse:collapse;width:100%}td,th{text-align:left;vertical-align:top;padding:.2rem .6rem .2rem 0;"
    "border-bottom:1px solid #8884}td,p{overflow-wrap:break-word}h3{overflow-wrap:anywhere}.scrolls{overflow-x:auto}"
    "pre{background:#8882;border-radius:.5rem;padding:.6rem .8rem;white-space:pre-wrap;overflow-wrap:anywhere;"
    "font-size:90%}"
    "code{font-size:95%}h3{margin-top:2.2rem}"
    "h3 code{background:#8882;padding:.1rem .4rem}"
    "nav{display:flex;flex-wrap:wrap;gap:.2rem 1rem}"
    "form{display:grid;gap:.5rem;padding:.5rem 0}label{display:grid}"
    "input,textarea,button{font:inherit;padding:.3rem .5rem;box-sizing:border-box;max-width:100%;min-width:0}"
    "input,textarea{width:100%}"
    "button{justify-self:start}"
    "@media(max-width:40rem){table,tbody,tr,td{display:block}tr:has(th){display:none}td{border:0;padding:0}"
    "tr{padding:.5rem 0;border-bottom:1px solid #8884}}"
    "@media(prefers-color-scheme:dark){body{color:#e8e8e4;background:#15171b}a{color:#f0a060}}";

#define TABLE "<div class=\"scrolls\" tabindex=\"0\" role=\"group\" aria-label=\"Table\"><table>"

static void put_escaped(FILE *out, const char *text) {
    for (; text && *text; text++) {
        switch (*text) {
        case '<': fputs("&lt;", out); break;
        case '>': fputs("&gt;", out); break;
        case '&': fputs("&amp;", out); break;
        case '"': fputs("&quot;", out); break;
        default: fputc(*text, out);
        }
    }
}

static const char *text_at(const json_t *json, const char *name) {
    const char *text = json_string_value(json_object_get(json, name));
    return text ? text : "";
}

/* Prose; what is between backticks is code. */
static void put_prose(FILE *out, const char *text) {
    bool code = false;
    for (const char *tick; (tick = strchr(text, '`')); text = tick + 1, code = !code) {
        for (; text < tick; text++) put_escaped(out, (char[]){*text, 0});
        fputs(code ? "</code>" : "<code>", out);
    }
    put_escaped(out, text);
    if (code) fputs("</code>", out);
}

static void put_element(FILE *out, const char *element, const char *text) {
    if (!text[0]) return;
    fprintf(out, "<%s>", element);
    put_prose(out, text);
    fprintf(out, "</%s>\n", element);
}

/* Follows "#/components/..." once. */
static const json_t *resolve(const json_t *root, const json_t *node) {
    const char *reference = json_string_value(json_object_get(node, "$ref"));
    if (!reference || strncmp(reference, "#/", 2) != 0) return node;
    for (const char *part = reference + 2; root && *part;) {
        char name[128];
        size_t length = strcspn(part, "/");
        snprintf(name, sizeof name, "%.*s", (int)length, part);
        root = json_object_get(root, name);
        part += length + (part[length] == '/');
    }
    return root;
}

/* ------------------------------------------------------------------------------------------------ types */

/* A number that is whole is written so: 1, not 1.0. */
static void put_json(FILE *out, const char *before, const json_t *value) {
    double number = json_real_value(value);
    if (json_is_real(value) && fabs(number) < 1e15 && number == floor(number)) {
        fprintf(out, "%s%.0f", before, number);
        return;
    }
    char *text = value ? json_dumps(value, JSON_ENCODE_ANY | JSON_COMPACT | JSON_REAL_PRECISION(15)) : NULL;
    if (text) {
        fputs(before, out);
        put_escaped(out, text);
    }
    free(text);
}

/* A word as it is, several with commas between, all else as JSON; nothing where there is no value. */
static void put_words(FILE *out, const char *before, const json_t *value) {
    size_t i;
    const json_t *each;
    json_array_foreach(value, i, each) put_words(out, i ? "," : before, each);
    if (json_is_string(value))
        fputs(before, out), put_escaped(out, json_string_value(value));
    else if (!json_is_array(value))
        put_json(out, before, value);
}

/* What may be chosen, with places between where a line may end: a table is as wide as its longest word. */
static void put_choices(FILE *out, const json_t *list) {
    size_t i;
    const json_t *each;
    json_array_foreach(list, i, each) put_words(out, i ? ", " : ": one of ", each);
}

/* "integer, from 1, default 5", "string: one of a, b", or the name of a schema as a link. */
static void put_type(FILE *out, const json_t *schema) {
    const char *reference = json_string_value(json_object_get(schema, "$ref"));
    if (reference) {
        const char *name = strrchr(reference, '/') + 1;
        fprintf(out, "<a href=\"#%s\">%s</a>", name, name);
        return;
    }
    const json_t *type = json_object_get(schema, "type"), *items = json_object_get(schema, "items"), *each;
    size_t i;
    if (json_is_string(type)) put_escaped(out, json_string_value(type));
    json_array_foreach(type, i, each) {
        fputs(i ? " or " : "", out);
        put_escaped(out, json_string_value(each));
    }
    if (items) fputs(" of ", out), put_type(out, items);
    put_choices(out, json_object_get(schema, "enum"));
    put_json(out, ", from ", json_object_get(schema, "minimum"));
    put_json(out, ", over ", json_object_get(schema, "exclusiveMinimum"));
    put_json(out, ", at most ", json_object_get(schema, "maximum"));
    put_words(out, json_object_get(schema, "enum") ? "; default " : ", default ", json_object_get(schema, "default"));
}

static void put_row(FILE *out, const char *name, const char *where, const json_t *schema, const char *description) {
    fputs("<tr><td><code>", out);
    put_escaped(out, name);
    fputs("</code>", out);
    if (where) fputs("<td>", out), put_escaped(out, where);
    fputs("<td>", out);
    put_type(out, schema);
    fputs("<td>", out);
    put_prose(out, description);
    fputs("\n", out);
}

/* ------------------------------------------------------------------------------------------------ operations */

static void put_parameters(FILE *out, const json_t *root, const json_t *list) {
    size_t i;
    const json_t *each;
    json_array_foreach(list, i, each) {
        const json_t *parameter = resolve(root, each);
        put_row(out, text_at(parameter, "name"), text_at(parameter, "in"), json_object_get(parameter, "schema"),
                text_at(parameter, "description"));
    }
}

static void put_media(FILE *out, const json_t *content) {
    const char *media, *between = "";
    json_t *each;
    json_object_foreach((json_t *)content, media, each) {
        const json_t *schema = json_object_get(each, "schema");
        fprintf(out, "%s<code>%s</code>", between, media);
        if (json_object_get(schema, "$ref")) fputs(" ", out), put_type(out, schema);
        between = ", ";
    }
}

/* A description; the problems that it names lead to their pages. */
static void put_response(FILE *out, const json_t *response) {
    static const char prefix[] = "A problem document: ";
    const char *text = text_at(response, "description");
    if (strncmp(text, prefix, sizeof prefix - 1) != 0) {
        put_escaped(out, text);
        return;
    }
    for (const char *slug = text + sizeof prefix - 1; *slug;) {
        int length = (int)strcspn(slug, ",.");
        fprintf(out, "<a href=\"problems/%.*s\">%.*s</a> ", length, slug, length, slug);
        slug += length;
        slug += strspn(slug, ",. ");
    }
}

static void put_responses(FILE *out, const json_t *root, const json_t *responses) {
    const char *status;
    json_t *each;
    fputs(TABLE "<tr><th>Status<th>Meaning<th>Content\n", out);
    json_object_foreach((json_t *)responses, status, each) {
        const json_t *response = resolve(root, each);
        fprintf(out, "<tr><td>%s<td>", status);
        put_response(out, response);
        fputs("<td>", out);
        put_media(out, json_object_get(response, "content"));
        fputs("\n", out);
    }
    fputs("</table></div>\n", out);
}

/* A document of the contract, as it is sent, folded. */
static void put_document(FILE *out, const json_t *value, const char *title) {
    char *text = value ? json_dumps(value, JSON_INDENT(2) | JSON_ENCODE_ANY | JSON_REAL_PRECISION(15)) : NULL;
    if (!text) return;
    fputs("<details><summary>", out);
    put_escaped(out, title);
    fputs("</summary><pre tabindex=\"0\">", out);
    put_escaped(out, text);
    fputs("</pre></details>\n", out);
    free(text);
}

/* The example of a content, a parameter or a header; NULL where there is none. */
static const json_t *example_of(const json_t *root, const json_t *of) {
    const json_t *own = json_object_get(of, "example");
    void *first = json_object_iter(json_object_get(of, "examples"));
    return own || !first ? own : json_object_get(resolve(root, json_object_iter_value(first)), "value");
}

/* Puts a parameter's example as a part of an address or a header: lists with commas between. */
static void put_value(FILE *out, const json_t *value) {
    const json_t *each;
    size_t i;
    json_array_foreach(value, i, each) {
        fputs(i ? "," : "", out);
        put_value(out, each);
    }
    if (json_is_array(value)) return;
    if (json_is_string(value))
        put_escaped(out, json_string_value(value));
    else
        put_json(out, "", value);
}

static const json_t *parameter_named(const json_t *root, const json_t *list, const char *name) {
    size_t i;
    const json_t *each;
    json_array_foreach(list, i, each) {
        const json_t *parameter = resolve(root, each);
        if (strcmp(text_at(parameter, "name"), name) == 0) return parameter;
    }
    return NULL;
}

/* The path, with examples for what is in braces. */
static void put_path(FILE *out, const json_t *root, const char *path, const json_t *shared, const json_t *own) {
    for (char name[64]; *path; path++) {
        size_t length = *path == '{' ? strcspn(path + 1, "}") : 0;
        if (!length) {
            put_escaped(out, (char[]){*path, 0});
            continue;
        }
        snprintf(name, sizeof name, "%.*s", (int)length, path + 1);
        const json_t *parameter = parameter_named(root, shared, name);
        put_value(out, example_of(root, parameter ? parameter : parameter_named(root, own, name)));
        path += length + 1;
    }
}

#define TUS_MEDIA "application/offset+octet-stream"

/* What has to be said, and what goes into the body. */
static void put_given(FILE *out, const json_t *root, const char *method, const json_t *own, const json_t *body) {
    const json_t *content = json_object_get(body, "content"), *document = json_object_get(content, "application/json");
    const json_t *example = example_of(root, document), *each;
    size_t i;
    json_array_foreach(own, i, each) {
        const json_t *parameter = resolve(root, each);
        bool wanted = json_is_true(json_object_get(parameter, "required")) ||
                      (strcmp(text_at(parameter, "name"), "Upload-Length") == 0 && strcmp(method, "post") == 0);
        if (!wanted || strcmp(text_at(parameter, "in"), "header") != 0) continue;
        fprintf(out, " -H '%s: ", text_at(parameter, "name"));
        put_value(out, example_of(root, parameter));
        fputs("'", out);
    }
    if (json_object_size(content) && (!example || json_object_size(content) > 1)) {
        if (json_object_get(content, TUS_MEDIA)) fputs(" -H 'Content-Type: " TUS_MEDIA "'", out);
        fputs(" -T scan.ply", out);
    } else if (example) {
        fputs(" --json '", out);
        put_json(out, "", example);
        fputs("'", out);
    }
}

/* A line for a shell that asks for this operation. */
static void put_call(FILE *out, const json_t *root, const char *path, const char *method, const json_t *shared,
                     const json_t *operation, const char *here) {
    const json_t *own = json_object_get(operation, "parameters");
    fputs("<pre tabindex=\"0\">curl -sS --fail-with-body", out);
    if (strcmp(method, "head") == 0) fputs(" -I", out);
    if (strcmp(method, "get") != 0 && strcmp(method, "head") != 0) {
        fputs(" -X ", out);
        for (const char *c = method; *c; c++) fputc(*c - 'a' + 'A', out);
    }
    put_given(out, root, method, own, json_object_get(operation, "requestBody"));
    fputs(" '", out);
    put_escaped(out, here);
    put_path(out, root, path, shared, own);
    const char *between = "?";
    const json_t *each;
    size_t i;
    json_array_foreach(own, i, each) {
        const json_t *parameter = resolve(root, each);
        bool wanted = json_is_true(json_object_get(parameter, "required")) ||
                      (strcmp(text_at(parameter, "name"), "ratio") == 0 && !strstr(path, "{name}"));
        if (!wanted || strcmp(text_at(parameter, "in"), "query") != 0) continue;
        fprintf(out, "%s%s=", between, text_at(parameter, "name"));
        put_value(out, example_of(root, parameter));
        between = "&amp;";
    }
    fputs("'</pre>\n", out);
}

/* What is answered where all is well. */
static void put_answer(FILE *out, const json_t *root, const json_t *responses) {
    const char *status;
    json_t *each;
    json_object_foreach((json_t *)responses, status, each) {
        const json_t *content = json_object_get(resolve(root, each), "content");
        const json_t *example = example_of(root, json_object_get(content, "application/json"));
        char title[64];
        if (status[0] != '2' || !example) continue;
        snprintf(title, sizeof title, "An answer (%.8s)", status);
        put_document(out, example, title);
        return;
    }
}

static void put_operation(FILE *out, const json_t *root, const char *path, const char *method, const json_t *shared,
                          const json_t *operation, const char *here) {
    fprintf(out, "<h3 id=\"%s\"><code>", text_at(operation, "operationId"));
    for (const char *c = method; *c; c++) fputc(*c - 'a' + 'A', out);
    fputs(" ", out);
    put_escaped(out, path);
    fputs("</code></h3>\n", out);
    put_element(out, "p", text_at(operation, "summary"));
    put_element(out, "p", text_at(operation, "description"));
    const json_t *own = json_object_get(operation, "parameters"), *body = json_object_get(operation, "requestBody");
    put_call(out, root, path, method, shared, operation, here);
    put_answer(out, root, json_object_get(operation, "responses"));
    if (json_array_size(own) || json_array_size(shared)) {
        fputs(TABLE "<tr><th>Parameter<th>In<th>Type<th>Meaning\n", out);
        put_parameters(out, root, shared);
        put_parameters(out, root, own);
        fputs("</table></div>\n", out);
    }
    if (body) {
        fputs("<p>Body: ", out);
        put_media(out, json_object_get(body, "content"));
        fputs("</p>\n", out);
    }
    put_responses(out, root, json_object_get(operation, "responses"));
}

static bool has_tag(const json_t *operation, const char *tag) {
    const char *own = json_string_value(json_array_get(json_object_get(operation, "tags"), 0));
    return own && strcmp(own, tag) == 0;
}

static void put_tag(FILE *out, const json_t *root, const json_t *tag, const char *here) {
    const char *path, *method, *name = text_at(tag, "name");
    json_t *item, *operation;
    fprintf(out, "<h2 id=\"%s\">%s</h2>\n", name, name);
    put_element(out, "p", text_at(tag, "description"));
    json_object_foreach(json_object_get(root, "paths"), path, item)
        json_object_foreach(item, method, operation) if (has_tag(operation, name))
            put_operation(out, root, path, method, json_object_get(item, "parameters"), operation, here);
}

/* ------------------------------------------------------------------------------------------------ the page */

static void put_schema(FILE *out, const char *name, const json_t *schema) {
    const char *member;
    json_t *each;
    fprintf(out, "<h3 id=\"%s\"><code>%s</code></h3>\n", name, name);
    put_element(out, "p", text_at(schema, "description"));
    fputs(TABLE "<tr><th>Member<th>Type<th>Meaning\n", out);
    json_object_foreach(json_object_get(schema, "properties"), member, each)
        put_row(out, member, NULL, each, text_at(each, "description"));
    fputs("</table></div>\n", out);
}

/* What people come for, each as a line for a shell; $H is the service's address. */
static const struct way {
    const char *what, *lines;
} ways[] = {
    {"In one command: a cloud goes in, the simplified one comes back.",
     "curl -sS --fail-with-body -X POST -T scan.ply '$H/v1/simplify?ratio=0.1' -o small.ply"},
    {"As a picture: before, after, and the deviation with its scale.",
     "curl -sS --fail-with-body -X POST -T scan.ply '$H/v1/simplify?ratio=0.1&output=preview.png' -o preview.png"},
    {"As a job, which can make several files: upload, follow, fetch.",
     "curl -sS --fail-with-body -X POST -T scan.ply '$H/v1/jobs?ratio=0.1&outputs=cloud,mesh,preview.png'  # its id\n"
     "ID=...\n"
     "curl -sSN --fail-with-body $H/v1/jobs/$ID/events  # until it has ended\n"
     "curl -sS --fail-with-body $H/v1/jobs/$ID  # figures\n"
     "curl -sSOJ --fail-with-body $H/v1/jobs/$ID/outputs/mesh.ply  # a file"},
    {"Once, for many jobs: the cloud stays, jobs name it.",
     "curl -sS --fail-with-body -X POST -T scan.ply $H/v1/clouds  # its id\n"
     "curl -sS --fail-with-body --json '{\"input\":\"/v1/clouds/SHA256\",\"params\":{\"ratio\":0.05}}' $H/v1/jobs"},
    {"From a form, or compressed.",
     "curl -sS --fail-with-body -F file=@scan.ply -F ratio=0.1 $H/v1/jobs\n"
     "zstd -c scan.ply | curl -sS --fail-with-body -X POST -T - -H 'Content-Encoding: zstd' '$H/v1/jobs?ratio=0.1'"},
    {"Where the service needs a token, every line above takes it as well.",
     "curl -H \"Authorization: Bearer $TOKEN\" ..."},
};

static void put_lines(FILE *out, const char *lines, const char *here) {
    fputs("<pre tabindex=\"0\">", out);
    for (const char *at; (at = strstr(lines, "$H")); lines = at + 2) {
        for (; lines < at; lines++) put_escaped(out, (char[]){*lines, 0});
        put_escaped(out, here);
    }
    put_escaped(out, lines);
    fputs("</pre>\n", out);
}

static void put_ways(FILE *out, const json_t *root, const char *here) {
    fputs("<h2 id=\"upload\">How to upload a cloud</h2>\n", out);
    fputs("<p>In a browser: drop it on <a href=\"./\">the first page</a>. From a command line:</p>\n", out);
    for (size_t i = 0; i < sizeof ways / sizeof *ways; i++) {
        put_element(out, "p", ways[i].what);
        put_lines(out, ways[i].lines, here);
    }
    const json_t *examples = json_object_get(json_object_get(root, "components"), "examples");
    put_document(out, json_object_get(json_object_get(examples, "Job"), "value"), "A job, as it is answered");
    put_document(out, json_object_get(json_object_get(examples, "invalid-parameter"), "value"),
                 "A refusal, as it is answered");
}

static void put_page(FILE *out, const json_t *root, const char *here, const char *script) {
    const json_t *info = json_object_get(root, "info"), *tags = json_object_get(root, "tags"), *tag;
    const char *name;
    json_t *schema;
    size_t i;
    fprintf(out,
            "<!doctype html>\n<html lang=\"en\">\n<meta charset=\"utf-8\">\n"
            "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
            "<title>whittled: reference</title>\n<style>%s</style>\n",
            style);
    if (script) fprintf(out, "<script type=\"module\" src=\"page/%s\"></script>\n", script);
    fputs("<main><h1>whittled</h1>\n", out);
    if (links_base()[0]) fprintf(out, "<p>All paths are below <code>%s</code>.</p>\n", links_base());
    fputs("<nav><a href=\"#upload\">upload</a>", out);
    json_array_foreach(tags, i, tag) fprintf(out, "<a href=\"#%s\">%s</a>", text_at(tag, "name"), text_at(tag, "name"));
    fputs("<a href=\"#schemas\">schemas</a><a href=\"openapi.json\">openapi.json</a></nav>\n", out);
    put_ways(out, root, here);
    fputs("<h2 id=\"all\">What holds for all operations</h2>\n", out);
    put_element(out, "p", text_at(info, "description"));
    json_array_foreach(tags, i, tag) put_tag(out, root, tag, here);
    fputs("<h2 id=\"schemas\">schemas</h2>\n", out);
    json_object_foreach(json_object_get(json_object_get(root, "components"), "schemas"), name, schema)
        put_schema(out, name, schema);
    fputs("</main></html>\n", out);
}

char *docs_page(const char *here, const char *script) {
    size_t bytes, page_bytes;
    const char *document = openapi_document(&bytes);
    char *page = NULL;
    json_t *root = json_loadb(document, bytes, 0, NULL);
    FILE *out = root ? open_memstream(&page, &page_bytes) : NULL;
    if (out) put_page(out, root, here, script);
    bool whole = out && fclose(out) == 0;
    json_decref(root);
    if (whole) return page;
    free(page);
    return NULL;
}
