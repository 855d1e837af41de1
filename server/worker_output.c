/* What whittle writes: a table of files, one row for each bit of the parameter `outputs`.
 *
 * The report comes last, because it lists what the others could not hold.  Files get their names together, at the end,
 * or whenever there are many of them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/worker_output.h"

#include <errno.h>
#include <inttypes.h>
#include <libgen.h>
#include <limits.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "api/report_json.h"
#include "core/cloud_pcd_write.h"
#include "core/cloud_write.h"
#include "core/file_out.h"
#include "core/mesh_attributes.h"
#include "core/mesh_glb.h"
#include "core/mesh_obj.h"
#include "core/mesh_ply.h"
#include "core/mesh_stl.h"
#include "core/paint.h"

enum { MOST_OPEN = 16 };

struct outputs {
    const struct worker_options *options;
    const struct cloud *cloud;
    const struct pipeline_result *result;
    const struct pipeline_level *level; /* the one to write */
    struct losses *losses;              /* of the report */
    struct file_out file[MOST_OPEN];    /* written, without their names yet */
    size_t files;
};

static enum status write_cloud(int fd, const struct outputs *o, struct error *error) {
    return cloud_write_ply(fd, o->cloud, o->result->kept, o->level->kept_count,
                           (enum encoding)o->options->params.encoding, error);
}

static enum status write_xyz(int fd, const struct outputs *o, struct error *error) {
    for (size_t j = 0; j < o->cloud->property_count; j++)
        if (o->cloud->property[j].is_list)
            losses_add(o->losses, "cloud.xyz", "%s: lines of text have no lists", o->cloud->property[j].name);
    return cloud_write_xyz(fd, o->cloud, o->result->kept, o->level->kept_count, error);
}

static enum status write_pcd(int fd, const struct outputs *o, struct error *error) {
    return cloud_write_pcd(fd, o->cloud, o->result->kept, o->level->kept_count, o->losses, error);
}

static bool is_scalar(const struct mesh_attributes *attributes, const struct property *property) {
    (void)attributes;
    return !property->is_list;
}

static enum status write_mesh(int fd, const struct outputs *o, struct error *error) {
    struct mesh_attributes attributes;
    mesh_attributes_find(&o->level->mesh, o->cloud, &attributes);
    mesh_attributes_note(&attributes, o->cloud, "mesh.ply", is_scalar, true, o->losses);
    return mesh_write_ply(fd, &o->level->mesh, o->cloud, (enum encoding)o->options->params.encoding, error);
}

static enum status write_obj(int fd, const struct outputs *o, struct error *error) {
    return mesh_write_obj(fd, &o->level->mesh, o->cloud, o->losses, error);
}

static enum status write_stl(int fd, const struct outputs *o, struct error *error) {
    return mesh_write_stl(fd, &o->level->mesh, o->cloud, o->losses, error);
}

static enum status write_glb(int fd, const struct outputs *o, struct error *error) {
    return mesh_write_glb(fd, &o->level->mesh, o->cloud, o->losses, error);
}

static enum status write_report(int fd, const struct outputs *o, struct error *error) {
    return report_json_write(fd, &o->result->report, &o->options->params, error);
}

static enum status write_painted(int fd, const struct outputs *o, const char *name, const float *value,
                                 struct error *error) {
    struct cloud painted = {0};
    if (paint_cloud(o->cloud, name, value, &painted))
        return error_set(error, STATUS_NO_MEMORY, name, "no memory for the painted cloud");
    enum status status =
        cloud_write_ply(fd, &painted, NULL, painted.count, (enum encoding)o->options->params.encoding, error);
    cloud_done(&painted);
    return status;
}

static enum status write_dso(int fd, const struct outputs *o, struct error *error) {
    return write_painted(fd, o, "dso", o->result->dso, error);
}

static enum status write_error(int fd, const struct outputs *o, struct error *error) {
    return write_painted(fd, o, "distance", o->result->distance, error);
}

struct file {
    uint32_t bit;            /* of params.outputs */
    const char *stem, *type; /* of the name */
    bool each_level;         /* one for each of the levels too, named stem_RATIO.type */
    enum status (*write)(int fd, const struct outputs *outputs, struct error *error);
};

static const struct file files[] = {
    {OUTPUT_CLOUD, "cloud", "ply", true, write_cloud},   {OUTPUT_CLOUD_XYZ, "cloud", "xyz", true, write_xyz},
    {OUTPUT_CLOUD_PCD, "cloud", "pcd", true, write_pcd}, {OUTPUT_MESH, "mesh", "ply", true, write_mesh},
    {OUTPUT_MESH_OBJ, "mesh", "obj", true, write_obj},   {OUTPUT_MESH_STL, "mesh", "stl", true, write_stl},
    {OUTPUT_MESH_GLB, "mesh", "glb", true, write_glb},   {OUTPUT_DSO, "dso", "ply", false, write_dso},
    {OUTPUT_ERROR, "error", "ply", false, write_error},  {OUTPUT_REPORT, "report", "json", false, write_report},
};
enum { FILES = sizeof files / sizeof files[0] };

static enum status commit_files(struct outputs *outputs, struct error *error) {
    size_t count = outputs->files;
    outputs->files = 0;
    return count ? file_out_commit(outputs->file, count, error) : STATUS_OK;
}

static enum status write_file(struct outputs *outputs, const struct file *file, const char *suffix,
                              struct error *error) {
    char path[PATH_MAX];
    struct file_out *out = &outputs->file[outputs->files];
    snprintf(path, sizeof path, "%s/%s%s.%s", outputs->options->output, file->stem, suffix, file->type);
    enum status status = file_out_begin(out, path, error);
    if (status) return status;
    outputs->files++;
    status = file->write(out->fd, outputs, error);
    return !status && outputs->files == MOST_OPEN ? commit_files(outputs, error) : status;
}

static enum status write_levels(struct outputs *outputs, const struct file *file, struct error *error) {
    const struct param_levels *levels = &outputs->options->params.levels;
    enum status status = STATUS_OK;
    for (uint32_t i = 0; i < levels->count && !status; i++) {
        char suffix[40];
        snprintf(suffix, sizeof suffix, "_%.10g", levels->ratio[i]);
        outputs->level = &outputs->result->level[i];
        status = write_file(outputs, file, suffix, error);
    }
    return status;
}

/* The lines of what the input's reader left out. */
static void note_input(const struct cloud *cloud, struct losses *losses) {
    for (const char *at = cloud->left_out; at && *at;) {
        size_t n = strcspn(at, "\n");
        losses_add(losses, "input", "%.*s", (int)n, at);
        at += n + (at[n] == '\n');
    }
}

/* The one output, to standard output. */
static enum status write_standard(struct outputs *outputs, struct error *error) {
    size_t i = 0;
    while (i + 1 < FILES && !(outputs->options->params.outputs & files[i].bit)) i++;
    return files[i].write(STDOUT_FILENO, outputs, error);
}

enum status worker_output_check(const struct worker_options *options, struct error *error) {
    char path[PATH_MAX];
    if (options->to_standard) return STATUS_OK;
    snprintf(path, sizeof path, "%s/.", options->output);
    if (access(path, W_OK | X_OK) == 0) return STATUS_OK;
    if (errno != ENOENT)
        return error_set(error, status_from_errno(errno), "output", "can't write into the folder %s: %s",
                         options->output, strerror(errno));
    snprintf(path, sizeof path, "%s", options->output);
    if (access(dirname(path), W_OK | X_OK) == 0) return STATUS_OK;
    return error_set(error, status_from_errno(errno), "output", "can't make the folder %s: %s", options->output,
                     strerror(errno));
}

static enum status write_files(struct outputs *outputs, struct error *error) {
    enum status status = STATUS_OK;
    for (size_t i = 0; i < FILES && !status; i++) {
        if (!(outputs->options->params.outputs & files[i].bit)) continue;
        if (files[i].each_level) status = write_levels(outputs, &files[i], error);
        outputs->level = &outputs->result->level[0];
        if (!status) status = write_file(outputs, &files[i], "", error);
    }
    return status ? status : commit_files(outputs, error);
}

static enum status write_folder(struct outputs *outputs, struct error *error) {
    const char *folder = outputs->options->output;
    if (mkdir(folder, 0777) != 0 && errno != EEXIST)
        return error_set(error, status_from_errno(errno), "output", "can't make the folder %s: %s", folder,
                         strerror(errno));
    enum status status = write_files(outputs, error);
    for (size_t i = 0; i < outputs->files; i++) file_out_abort(&outputs->file[i]);
    return status;
}

enum status worker_output_write(const struct worker_options *options, const struct cloud *cloud,
                                struct pipeline_result *result, struct error *error) {
    struct outputs outputs = {.options = options,
                              .cloud = cloud,
                              .result = result,
                              .level = &result->level[0],
                              .losses = &result->report.losses};
    note_input(cloud, outputs.losses);
    return options->to_standard ? write_standard(&outputs, error) : write_folder(&outputs, error);
}

static void print_distances(FILE *to, const char *name, const struct distance_stats *stats, double diagonal) {
    if (!stats->count) return;
    fprintf(to, "%-16s mean %.3e  rms %.3e  max %.3e of the diagonal\n", name, stats->mean / diagonal,
            stats->rms / diagonal, stats->max / diagonal);
}

static void summarise_level(const struct report *report, const struct report_level *r, FILE *to) {
    fprintf(to, "%-16s %" PRIu64 " of %" PRIu64 "\n", "points", r->points_out, report->points_in);
    print_distances(to, "tangent error", &r->tangent, report->diagonal);
    if (r->has_mesh)
        fprintf(to, "%-16s %" PRIu64 " triangles, %s, %" PRIu64 " kept points lost\n", "mesh", r->triangles,
                r->watertight ? "watertight" : "open", r->points_lost);
    print_distances(to, "points to mesh", &r->forward, report->diagonal);
    print_distances(to, "mesh to surface", &r->backward, report->diagonal);
    print_distances(to, "surface to mesh", &r->surface, report->diagonal);
}

void worker_output_summary(const struct report *report, FILE *to) {
    for (size_t i = 0; i < report->level_count; i++) summarise_level(report, &report->level[i], to);
    if (report->points_outliers) fprintf(to, "%-16s %" PRIu64 " points\n", "outliers", report->points_outliers);
    if (report->noise > 0) fprintf(to, "%-16s %.3e of the diagonal\n", "noise", report->noise / report->diagonal);
    for (size_t i = 0; i < report->losses.count; i++)
        fprintf(to, "%-16s %s: %s\n", i ? "" : "left out", report->losses.loss[i].where, report->losses.loss[i].what);
    fprintf(to, "%-16s %.0f ms, %.1f MiB at the peak\n", "cost", report->total_ms,
            (double)report->peak_rss_bytes / 1048576);
}

void worker_output_explain(const char *input, enum status status, const struct error *error, FILE *to) {
    fprintf(to, "whittle: %s: ", input);
    if (error->line) fprintf(to, "line %" PRIu64 ": ", error->line);
    if (!error->line && error->byte_offset != UINT64_MAX && error->code)
        fprintf(to, "byte %" PRIu64 ": ", error->byte_offset);
    if (error->where[0]) fprintf(to, "%s: ", error->where);
    fprintf(to, "%s\n", error->text[0] ? error->text : status_name(status));
}
