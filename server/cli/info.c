/* whittle info FILE: what a cloud is, as a table or as JSON.
 *
 * What the file says, and three things that its points say: how far apart they are, how far off their surface, and what
 * they are of.  The last is what a mesh of the cloud would be made as, so one is made, of a tenth of the points as by
 * default.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/cli_internal.h"

#include <errno.h>
#include <getopt.h>
#include <inttypes.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "api/codecs/info_json.h"
#include "core/base/alloc.h"
#include "core/cloud/attribute_names.h"
#include "core/cloud/morton.h"
#include "core/io/formats/las_fields.h"
#include "core/io/out/write.h"
#include "core/io/read.h"
#include "core/math/quantile.h"
#include "core/params.h"
#include "core/pipeline/pipeline.h"
#include "core/spatial/knn.h"
#include "core/text/column_list.h"
#include "server/cli/input.h"
#include "server/cli/output.h"
#include "server/shared/worker_protocol.h"

enum { MESH_POINTS = 50000, MESH_LEAST = 100, TENTH = 10, SYSTEM_BYTES = 128, MOST_THREADS = 256 };

struct request {
    const char *path;
    const char *columns; /* of a text; NULL = not given */
    unsigned threads;
    bool json, quick;
};

/* ------------------------------------------------------------------------------------------------- command line */

enum outcome { LOOK, TOLD, REFUSED };

static void info_print_help(void) {
    puts(
        "Usage: whittle info FILE [--json] [--quick] [--columns LIST] [--threads N]\n"
        "\n"
        "Tells what a cloud is: its format, points, box, attributes and coordinate system (of LAS), the median\n"
        "distance of a point to its nearest neighbour (spacing), the standard deviation of points from the surface\n"
        "that they seem to be of (noise), and whether that is closed, open or a height field, as --surface auto finds\n"
        "it. FILE is of any format that whittle reads; - is standard input.\n"
        "\n"
        "  --quick         Only what the file says: no spacing, noise and surface.\n"
        "  --columns LIST  What the columns of a text are, as for simplifying.\n"
        "  --threads N     Default 0: all processors. The figures don't depend on it.\n"
        "  --json          JSON instead of a table.\n"
        "  -h, --help\n"
        "\n"
        "Exit status: 0 done; 64 an argument is wrong; 65 the file is malformed or of no format that is read;\n"
        "66 it can't be opened; 71 out of memory; 74 reading or writing failed.");
}

static enum outcome info_refuse(const char *what, const char *why) {
    fprintf(stderr, "whittle info: %s: %s\nUse 'whittle info --help' for all options.\n", what, why);
    return REFUSED;
}

static enum outcome set_threads(struct request *request, const char *text) {
    char *end;
    errno = 0;
    unsigned long threads = strtoul(text, &end, 10);
    if (text[0] < '0' || text[0] > '9' || errno || *end || threads > MOST_THREADS)
        return info_refuse("--threads", "use a number from 0 to 256");
    request->threads = (unsigned)threads;
    return LOOK;
}

static enum outcome info_set_option(struct request *request, int option, const char *value) {
    switch (option) {
    case 'h': info_print_help(); return TOLD;
    case 'j': request->json = true; return LOOK;
    case 'k': request->quick = true; return LOOK;
    case 't': return set_threads(request, value);
    case 'c':
        request->columns = value;
        return column_list_is_valid(value) ? LOOK : info_refuse("--columns", "use names in their order, as -,x,y,z");
    default: fprintf(stderr, "Use 'whittle info --help' for all options.\n"); return REFUSED;
    }
}

static enum outcome info_parse(struct request *request, int argc, char **argv) {
    static const struct option options[] = {
        {"json", no_argument, NULL, 'j'},          {"quick", no_argument, NULL, 'k'},
        {"columns", required_argument, NULL, 'c'}, {"threads", required_argument, NULL, 't'},
        {"help", no_argument, NULL, 'h'},          {NULL, 0, NULL, 0},
    };
    enum outcome outcome = LOOK;
    argv[0] = "whittle info";
    optind = 0; /* glibc: start afresh */
    for (int option; outcome == LOOK && (option = getopt_long(argc, argv, "h", options, NULL)) != -1;)
        outcome = info_set_option(request, option, optarg);
    if (outcome != LOOK) return outcome;
    if (argc - optind != 1) return info_refuse("FILE", "use the name of one cloud, or - for standard input");
    request->path = argv[optind];
    return LOOK;
}

/* ------------------------------------------------------------------------------------------------- looking */

static enum status find_spacing(const struct ordered_points *points, unsigned threads, double *spacing) {
    enum { TWO = 2 };
    size_t n = points->count;
    struct knn *knn = NULL;
    *spacing = 0;
    if (n < TWO) return STATUS_OK;
    uint32_t *id = alloc_array(n, TWO * sizeof *id);
    double *distance_sq = alloc_array(n, TWO * sizeof *distance_sq);
    float *distance = alloc_array(n, sizeof *distance);
    enum status status = id && distance_sq && distance ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) status = knn_new(points->point, n, threads, &knn, NULL);
    if (!status) status = knn_search(knn, points->point, n, TWO, threads, id, distance_sq);
    for (size_t i = 0; !status && i < n; i++) distance[i] = (float)sqrt(distance_sq[TWO * i + 1]);
    if (!status) *spacing = (double)quantile_of(distance, n, 0.5) * points->scale;
    knn_free(knn);
    free(id), free(distance_sq), free(distance);
    return status;
}

/* As many as a mesh has by default, but for those of the largest clouds and of the smallest. */
static size_t points_of_mesh(size_t count) {
    size_t kept = count / TENTH < MESH_POINTS ? count / TENTH : MESH_POINTS;
    size_t least = count < MESH_LEAST ? count : MESH_LEAST;
    return kept > least ? kept : least;
}

/* As a report tells them: where points would be smoothed before there is a mesh, noise is what would be taken off.
 * Where no mesh can be made, surface->kind stays "". */
static enum status find_noise_and_surface(const struct cloud *cloud, unsigned threads, double *noise,
                                          struct report_surface *surface) {
    enum { FEWEST = 32 }; /* points that tell noise */
    struct report report = {0};
    struct params params;
    struct error error = {0};
    params_defaults(&params);
    params.outputs = OUTPUT_MESH;
    params.refine = REFINE_NONE;
    params.reference = REFERENCE_POINTS;
    params.threads = threads;
    params.points = points_of_mesh(cloud->count);
    enum status status = params_resolve(&params, &error);
    if (!status) status = pipeline_find_surface(cloud, &params, &report, &error);
    if (status && status != STATUS_DEGENERATE) return status;
    *noise = report.points_distinct < FEWEST ? NAN : fmax(report.noise, report.noise_level);
    *surface = report.surface;
    return STATUS_OK;
}

static enum status look(const struct request *request, const struct cloud *cloud, struct cloud_info *info,
                        struct report_surface *surface, struct error *error) {
    struct ordered_points points = {0};
    info->spacing = 0;
    info->noise = NAN;
    if (cloud->count == 0) return STATUS_OK;
    enum status status = order_points(cloud->position, cloud->count, request->threads, &points);
    if (!status) {
        info->distinct = points.count;
        info->diagonal = vec3_equal(points.box_min, points.box_max) ? 0 : points.diagonal;
        memcpy(info->box_min, &points.box_min, sizeof info->box_min);
        memcpy(info->box_max, &points.box_max, sizeof info->box_max);
    }
    if (!status && !request->quick) status = find_spacing(&points, request->threads, &info->spacing);
    ordered_points_done(&points);
    if (!status && !request->quick) status = find_noise_and_surface(cloud, request->threads, &info->noise, surface);
    return status ? error_set(error, status, "info", "looking at the points failed: %s", status_name(status))
                  : STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------- printing */

static void print_lines(const char *label, const char *lines) {
    for (const char *at = lines; at && *at; label = "") {
        size_t n = strcspn(at, "\n");
        printf("%-18s %.*s\n", label, (int)n, at);
        at += n + (at[n] == '\n');
    }
}

static bool has_attribute(const struct cloud_info *info, const char *name) {
    size_t i = 0;
    while (i < info->attribute_count && !attribute_is_same(info->attribute[i].name, name)) i++;
    return i < info->attribute_count;
}

/* Geometry alone ranks points, which leaves few of them where a wall is flat. */
static void advise_on_colours(const struct cloud_info *info) {
    if (has_attribute(info, "red") && has_attribute(info, "green") && has_attribute(info, "blue"))
        printf("%-18s --weights rgb:0.2 keeps their edges, which smear without it where the surface is flat\n",
               "colours");
}

static void info_print_table(const struct cloud_info *info) {
    printf("%-18s %s\n", "format", info->format);
    printf("%-18s %" PRIu64 ", %" PRIu64 " distinct\n", "points", info->points, info->distinct);
    if (info->triangles) printf("%-18s %" PRIu64 " triangles\n", "faces", info->triangles);
    if (info->points) {
        printf("%-18s %.10g %.10g %.10g\n", "box from", info->box_min[0], info->box_min[1], info->box_min[2]);
        printf("%-18s %.10g %.10g %.10g\n", "to", info->box_max[0], info->box_max[1], info->box_max[2]);
        printf("%-18s %.6g\n", "diagonal", info->diagonal);
    }
    for (size_t i = 0; i < info->attribute_count; i++)
        printf("%-18s %s %s%s\n", i ? "" : "attributes", info->attribute[i].type,
               info->attribute[i].is_list ? "list " : "", info->attribute[i].name);
    advise_on_colours(info);
    if (info->coordinate_system[0]) printf("%-18s %s\n", "coordinate system", info->coordinate_system);
    if (info->spacing > 0) printf("%-18s %.4g\n", "spacing", info->spacing);
    if (!isnan(info->noise))
        printf("%-18s %.3g, %.2g of the diagonal\n", "noise", info->noise, info->noise / info->diagonal);
    if (info->surface->kind[0])
        printf("%-18s %s%s: %s\n", "surface", info->surface->kind, info->surface->sure ? "" : ", not surely",
               info->surface->reason);
    print_lines("left out", info->left_out);
}

static enum status info_print(const struct request *request, const struct cloud_info *info, struct error *error) {
    enum status status = STATUS_OK;
    if (request->json)
        status = info_json_write(stdout, info);
    else
        info_print_table(info);
    if (!status && (fflush(stdout) != 0 || ferror(stdout))) status = STATUS_IO;
    return status ? error_set(error, status, "", "standard output can't be written") : STATUS_OK;
}

static enum status info_tell(const struct request *request, const struct cloud *cloud, const char *system,
                             struct error *error) {
    struct report_surface surface = {0};
    struct cloud_info info = {.format = cloud->form,
                              .points = cloud->count,
                              .triangles = cloud->triangle_count,
                              .coordinate_system = system,
                              .surface = &surface,
                              .left_out = cloud->left_out};
    struct cloud_info_attribute *attribute = alloc_array(cloud->property_count, sizeof *attribute);
    if (!attribute) return error_set(error, STATUS_NO_MEMORY, "info", "no memory for the attributes");
    for (size_t i = 0; i < cloud->property_count; i++) {
        const struct property *property = &cloud->property[i];
        attribute[i] =
            (struct cloud_info_attribute){property->name, cloud_write_type_name(property->type), property->is_list};
    }
    info.attribute = attribute;
    info.attribute_count = cloud->property_count;
    enum status status = look(request, cloud, &info, &surface, error);
    if (!status) status = info_print(request, &info, error);
    free(attribute);
    return status;
}

static enum status info_run(const struct request *request, int *exit_status, struct error *error) {
    const struct cloud_limits limits = {.columns = request->columns, .columns_if_text = true};
    struct cloud cloud = {0};
    char system[SYSTEM_BYTES];
    int input;
    enum status status = command_input_open(request->path, &input, error);
    if (status) {
        *exit_status = WIRE_EXIT_NO_INPUT;
        return status;
    }
    las_coordinate_system(input, system, sizeof system);
    status = cloud_read(input, &limits, NULL, &cloud, error);
    if (!status) status = info_tell(request, &cloud, system, error);
    cloud_done(&cloud);
    command_input_close(input);
    return status;
}

int command_info_main(int argc, char **argv) {
    struct request request = {0};
    enum outcome outcome = info_parse(&request, argc, argv);
    if (outcome != LOOK) return outcome == TOLD ? 0 : WIRE_EXIT_PARAMETER;
    struct error error = {.byte_offset = UINT64_MAX};
    int exit_status = 0;
    enum status status = info_run(&request, &exit_status, &error);
    if (status) command_output_explain(request.path, status, &error, stderr);
    return status && exit_status ? exit_status : wire_exit_status(status);
}
