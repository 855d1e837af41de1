/* whittle measure A B: two files, their distances in both directions, as a table or as JSON.
 *
 * A is the simplified one and B is what it stands for.  A file with faces is a surface, one without is a set of points.
 * What can be measured depends on which of the two are surfaces:
 *
 *     A surface, B surface    forward, surface, backward; or forward and backward in the way of the program Metro
 *     A surface, B points     forward and backward, as the report has them
 *     A points, B surface     surface and backward, the same with the sides changed
 *     A points, B points      forward and backward, each to the nearest point of the other
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/cli_internal.h"

#include <errno.h>
#include <getopt.h>
#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "api/codecs/measure_json.h"
#include "core/base/left_out.h"
#include "core/io/read.h"
#include "core/measure/metro.h"
#include "core/params.h"
#include "core/pipeline/pipeline.h"
#include "core/text/column_list.h"
#include "server/cli/input.h"
#include "server/cli/output.h"
#include "server/shared/worker_protocol.h"

enum method { METHOD_UNIFORM, METHOD_METRO };

static const char *const methods[] = {"uniform", "metro"};

#define MAX_SAMPLES UINT64_C(100000000000)
#define MAX_THREADS 256

struct request {
    const char *path[2]; /* A and B */
    struct metro_options metro;
    enum method method;
    const char *columns; /* of those that are text; NULL = not given */
    bool json;
};

/* ------------------------------------------------------------------------------------------------- command line */

enum outcome { MEASURE, TOLD, REFUSED };

static void measure_print_help(void) {
    puts("Usage: whittle measure A B [--samples N] [--seed S] [--method uniform|metro] [--columns LIST] [--threads N]\n"
         "                           [--json]\n"
         "\n"
         "Measures how far A, the simplified one, is from B, what it stands for: mean, root mean square and largest\n"
         "distance in both directions, in the files' units and relative to the diagonal of the bounding box of B.\n"
         "A and B are clouds or meshes of any format that whittle reads. One without faces is a set of points. Two\n"
         "of them are measured from each point to the nearest of the other, both ways; a mesh and points as in the\n"
         "report: each point to the mesh's surface, and samples of that to the planes that fit the points around.\n"
         "\n"
         "  --samples N     Samples of each surface; default 10 for each triangle, and for uniform at least 100000.\n"
         "  --seed S        Of where the samples lie; default 0. The same seed gives the same figures.\n"
         "  --method M      uniform (the default): all points of B, and samples uniform by area of both surfaces.\n"
         "                  metro: vertices, edges and faces as the program Metro samples them, to compare with "
         "figures\n"
         "                  that it has printed; needs faces in both.\n"
         "  --columns LIST  What the columns of a text are, as for simplifying: names in their order (-,x,y,z), or "
         "pairs of\n"
         "                  a name and a column (x:east,y:north,z:4). Holds for A and B where they are text.\n"
         "  --threads N     Default 0: all processors. The figures don't depend on it.\n"
         "  --json          JSON instead of a table.\n"
         "  -h, --help\n"
         "\n"
         "Exit status: 0 done; 64 an argument is wrong; 65 a file is malformed, of no format that is read, over a "
         "limit,\n"
         "or without the faces that are needed; 66 a file can't be opened; 70 internal error; 71 out of memory;\n"
         "74 reading or writing failed.");
}

static enum outcome measure_refuse(const char *what, const char *why) {
    fprintf(stderr, "whittle measure: %s: %s\nUse 'whittle measure --help' for all options.\n", what, why);
    return REFUSED;
}

static bool parse_count(const char *text, uint64_t max, uint64_t *value) {
    char *end;
    if (text[0] < '0' || text[0] > '9') return false;
    errno = 0;
    unsigned long long parsed = strtoull(text, &end, 10);
    if (errno || *end || parsed > max) return false;
    *value = parsed;
    return true;
}

static enum outcome set_method(struct request *request, const char *name) {
    for (int i = 0; i < 2; i++) {
        if (strcmp(methods[i], name) != 0) continue;
        request->method = (enum method)i;
        return MEASURE;
    }
    return measure_refuse("--method", "it is uniform or metro");
}

static enum outcome set_columns(struct request *request, const char *list) {
    char allowed[256] = "it takes ";
    request->columns = list;
    if (column_list_is_valid(list)) return MEASURE;
    params_allowed(params_find("columns"), allowed + strlen(allowed), sizeof allowed - strlen(allowed));
    return measure_refuse("--columns", allowed);
}

static enum outcome measure_set_option(struct request *request, int option, const char *value) {
    uint64_t threads;
    switch (option) {
    case 'n':
        if (parse_count(value, MAX_SAMPLES, &request->metro.samples) && request->metro.samples > 0) return MEASURE;
        return measure_refuse("--samples", "it is an integer from 1 to 100000000000");
    case 's':
        if (parse_count(value, UINT64_MAX, &request->metro.seed)) return MEASURE;
        return measure_refuse("--seed", "it is an integer, at least 0 and below 2^64");
    case 't':
        if (!parse_count(value, MAX_THREADS, &threads))
            return measure_refuse("--threads", "it is an integer from 0 to 256");
        request->metro.threads = (unsigned)threads;
        return MEASURE;
    case 'm': return set_method(request, value);
    case 'c': return set_columns(request, value);
    case 'j': request->json = true; return MEASURE;
    case 'h': measure_print_help(); return TOLD;
    default: return REFUSED; /* getopt has said why */
    }
}

static enum outcome measure_parse(struct request *request, int argc, char **argv) {
    static const struct option options[] = {
        {"samples", required_argument, NULL, 'n'}, {"seed", required_argument, NULL, 's'},
        {"method", required_argument, NULL, 'm'},  {"columns", required_argument, NULL, 'c'},
        {"threads", required_argument, NULL, 't'}, {"json", no_argument, NULL, 'j'},
        {"help", no_argument, NULL, 'h'},          {NULL, 0, NULL, 0},
    };
    enum outcome outcome = MEASURE;
    optind = 0; /* glibc: start afresh */
    for (int option; outcome == MEASURE && (option = getopt_long(argc, argv, "h", options, NULL)) != -1;)
        outcome = measure_set_option(request, option, optarg);
    if (outcome != MEASURE) return outcome;
    if (argc - optind != 2) return measure_refuse("A B", "use the names of two files");
    request->path[0] = argv[optind];
    request->path[1] = argv[optind + 1];
    return MEASURE;
}

/* ------------------------------------------------------------------------------------------------- measuring */

static struct mesh borrow_mesh(const struct cloud *cloud) {
    return (struct mesh){.vertex_count = cloud->count,
                         .vertex = cloud->position,
                         .triangle_count = cloud->triangle_count,
                         .triangle = cloud->triangle};
}

static enum status measure_metro(const struct request *request, const struct mesh mesh[2], struct measurement *m) {
    struct metro_errors errors;
    enum status status = metro_compatible(&mesh[0], &mesh[1], &request->metro, &errors, &m->metro_diagonal);
    if (status) return status;
    m->forward = errors.forward;
    m->backward = errors.backward;
    m->hausdorff = errors.hausdorff;
    return STATUS_OK;
}

/* The side that has faces against the points of the other one. */
static enum status measure_mesh_and_points(const struct request *request, const struct cloud cloud[2],
                                           struct measurement *m, struct error *error) {
    struct metro_errors errors;
    int faces = cloud[0].triangle_count > 0 ? 0 : 1;
    const struct mesh mesh = borrow_mesh(&cloud[faces]);
    enum status status = pipeline_measure_mesh(&cloud[1 - faces], &mesh, &request->metro, &errors, error);
    if (status) return status;
    *(faces == 0 ? &m->forward : &m->backward) = errors.forward;
    *(faces == 0 ? &m->backward : &m->surface) = errors.backward;
    m->hausdorff = errors.hausdorff;
    return STATUS_OK;
}

static enum status measure_points(const struct request *request, const struct mesh mesh[2], struct measurement *m) {
    struct metro_errors errors;
    const vec3 *const point[2] = {mesh[0].vertex, mesh[1].vertex};
    const size_t n[2] = {mesh[0].vertex_count, mesh[1].vertex_count};
    enum status status = metro_clouds(point, n, &request->metro, &errors);
    if (status) return status;
    m->forward = errors.forward;
    m->backward = errors.backward;
    m->hausdorff = errors.hausdorff;
    return STATUS_OK;
}

static enum status measure_surfaces(const struct request *request, const struct mesh mesh[2], struct measurement *m) {
    struct metro_reference reference = {
        .point_count = mesh[1].vertex_count, .point = mesh[1].vertex, .surface = &mesh[1]};
    struct metro_errors errors;
    enum status status = metro_measure(&mesh[0], &reference, &request->metro, &errors);
    if (status) return status;
    m->forward = errors.forward;
    m->backward = errors.backward;
    m->surface = errors.surface;
    m->hausdorff = errors.hausdorff;
    return STATUS_OK;
}

static enum status measure(const struct request *request, const struct cloud cloud[2], struct measurement *m,
                           struct error *error) {
    const struct mesh mesh[2] = {borrow_mesh(&cloud[0]), borrow_mesh(&cloud[1])};
    bool faces[2] = {mesh[0].triangle_count > 0, mesh[1].triangle_count > 0};
    if (request->method == METHOD_METRO && !(faces[0] && faces[1]))
        return error_set(error, STATUS_DEGENERATE, "", "the method metro needs faces in both");
    *m = (struct measurement){.method = methods[request->method],
                              .points = {mesh[0].vertex_count, mesh[1].vertex_count},
                              .triangles = {mesh[0].triangle_count, mesh[1].triangle_count},
                              .diagonal = metro_diagonal(mesh[1].vertex, mesh[1].vertex_count)};
    enum status status = request->method == METHOD_METRO ? measure_metro(request, mesh, m)
                         : faces[0] && faces[1]          ? measure_surfaces(request, mesh, m)
                         : faces[0] || faces[1]          ? measure_mesh_and_points(request, cloud, m, error)
                                                         : measure_points(request, mesh, m);
    return status ? error_set(error, status, "measure", "the measuring failed: %s", status_name(status)) : STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------- printing */

static void print_row(const char *label, const struct distance_stats *s, double diagonal) {
    if (!s->count) return;
    printf("%-18s %10" PRIu64, label, s->count);
    printf("  %11.5e %11.5e %11.5e", s->mean, s->rms, s->max);
    printf("  %11.5e %11.5e %11.5e\n", s->mean / diagonal, s->rms / diagonal, s->max / diagonal);
}

static void measure_print_table(const struct measurement *m) {
    bool metro = m->metro_diagonal > 0;
    const struct distance_stats *side[2];
    measure_json_sides(m, side);
    printf("diagonal of B      %.9g\n", m->diagonal);
    if (metro) printf("diagonal of Metro  %.9g\n", m->metro_diagonal);
    printf("\n%-18s %10s  %11s %11s %11s  %11s %11s %11s\n", "", "samples", "mean", "rms", "max", "mean / diag",
           "rms / diag", "max / diag");
    print_row(metro ? "B to A" : "points of B to A", &m->forward, m->diagonal);
    print_row("surface of B to A", &m->surface, m->diagonal);
    print_row(m->triangles[0] ? "surface of A to B" : "points of A to B", &m->backward, m->diagonal);
    putchar('\n');
    double mean = side[0] ? (side[0]->mean + side[1]->mean) / 2 : 0;
    if (side[0]) printf("mean of both       %.6e  %.6e of the diagonal\n", mean, mean / m->diagonal);
    printf("Hausdorff          %.6e  %.6e of the diagonal\n", m->hausdorff, m->hausdorff / m->diagonal);
    if (metro) printf("%-18s %12s  %.6e of the diagonal of Metro\n", "", "", m->hausdorff / m->metro_diagonal);
}

static enum status measure_print(const struct request *request, const struct measurement *m, struct error *error) {
    enum status status = STATUS_OK;
    if (request->json)
        status = measure_json_write(stdout, m);
    else
        measure_print_table(m);
    if (!status && (fflush(stdout) != 0 || ferror(stdout))) status = STATUS_IO;
    return status ? error_set(error, status, "", "standard output can't be written") : STATUS_OK;
}

static bool is_text(const struct cloud *cloud) { return strcmp(cloud->form, "xyz") == 0; }

static enum status read_side(const struct request *request, int i, struct cloud *cloud, int *exit_status,
                             struct error *error) {
    const struct cloud_limits limits = {.columns = request->columns, .columns_if_text = true};
    int input;
    enum status status = command_input_open(request->path[i], &input, error);
    if (status) *exit_status = WIRE_EXIT_NO_INPUT;
    if (!status) status = cloud_read(input, &limits, NULL, cloud, error);
    command_input_close(input);
    if (!status && cloud->count == 0) status = error_set(error, STATUS_DEGENERATE, "points", "the cloud has no points");
    return status;
}

/* What should be known before its distances are used. */
static void warn_of_side(const char *path, const struct cloud *cloud) {
    const size_t length = strlen(LEFT_OUT_WARNING);
    for (const char *at = cloud->left_out; at && *at;) {
        size_t n = strcspn(at, "\n");
        if (strncmp(at, LEFT_OUT_WARNING, length) == 0)
            fprintf(stderr, "whittle: warning: %s: %.*s\n", path, (int)(n - length), at + length);
        at += n + (at[n] == '\n');
    }
}

static enum status measure_run(const struct request *request, const char **culprit, int *exit_status,
                               struct error *error) {
    struct cloud cloud[2] = {0};
    enum status status = STATUS_OK;
    struct measurement m = {0};
    for (int i = 0; !status && i < 2; i++) {
        *culprit = request->path[i];
        status = read_side(request, i, &cloud[i], exit_status, error);
        if (!status) warn_of_side(request->path[i], &cloud[i]);
    }
    if (!status && request->columns && !is_text(&cloud[0]) && !is_text(&cloud[1])) {
        *culprit = "--columns";
        status =
            error_set(error, STATUS_BAD_PARAMETER, "", "neither file is text; others name their columns themselves");
    }
    if (!status) {
        *culprit = "measure";
        status = measure(request, cloud, &m, error);
    }
    if (!status) status = measure_print(request, &m, error);
    cloud_done(&cloud[0]);
    cloud_done(&cloud[1]);
    return status;
}

int command_measure_main(int argc, char **argv) {
    struct request request = {0};
    enum outcome outcome = measure_parse(&request, argc, argv);
    if (outcome != MEASURE) return outcome == TOLD ? 0 : WIRE_EXIT_PARAMETER;
    struct error error = {.byte_offset = UINT64_MAX};
    const char *culprit = "";
    int exit_status = 0;
    enum status status = measure_run(&request, &culprit, &exit_status, &error);
    if (status) command_output_explain(culprit, status, &error, stderr);
    return status && exit_status ? exit_status : wire_exit_status(status);
}
