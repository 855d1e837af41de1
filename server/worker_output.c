/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/worker_output.h"

#include <errno.h>
#include <inttypes.h>
#include <limits.h>
#include <string.h>
#include <sys/stat.h>

#include "api/report_json.h"
#include "core/cloud_write.h"
#include "core/file_out.h"
#include "core/mesh_ply.h"

struct outputs {
    const struct worker_options *options;
    const struct cloud *cloud;
    const struct pipeline_result *result;
};

static enum status write_cloud(int fd, const struct outputs *o, struct error *error) {
    return cloud_write_ply(fd, o->cloud, o->result->kept, o->result->kept_count,
                           (enum encoding)o->options->params.encoding, error);
}

static enum status write_xyz(int fd, const struct outputs *o, struct error *error) {
    return cloud_write_xyz(fd, o->cloud, o->result->kept, o->result->kept_count, error);
}

static enum status write_mesh(int fd, const struct outputs *o, struct error *error) {
    return mesh_write_ply(fd, &o->result->mesh, o->cloud, (enum encoding)o->options->params.encoding, error);
}

static enum status write_report(int fd, const struct outputs *o, struct error *error) {
    return report_json_write(fd, &o->result->report, &o->options->params, error);
}

static const struct {
    uint32_t bit; /* of params.outputs */
    const char *name;
    enum status (*write)(int fd, const struct outputs *outputs, struct error *error);
} files[] = {
    {OUTPUT_CLOUD, "cloud.ply", write_cloud},
    {OUTPUT_CLOUD_XYZ, "cloud.xyz", write_xyz},
    {OUTPUT_MESH, "mesh.ply", write_mesh},
    {OUTPUT_REPORT, "report.json", write_report},
};

static enum status write_file(const struct outputs *outputs, size_t i, struct error *error) {
    char path[PATH_MAX];
    struct file_out file = {0};
    snprintf(path, sizeof path, "%s/%s", outputs->options->output, files[i].name);
    enum status status = file_out_begin(&file, path, error);
    if (!status) status = files[i].write(file.fd, outputs, error);
    if (!status) return file_out_commit(&file, error);
    file_out_abort(&file);
    return status;
}

enum status worker_output_write(const struct worker_options *options, const struct cloud *cloud,
                                const struct pipeline_result *result, struct error *error) {
    struct outputs outputs = {options, cloud, result};
    if (mkdir(options->output, 0777) != 0 && errno != EEXIST)
        return error_set(error, STATUS_IO, "output", "can't make the folder %s: %s", options->output, strerror(errno));
    for (size_t i = 0; i < sizeof files / sizeof files[0]; i++) {
        if (!(options->params.outputs & files[i].bit)) continue;
        enum status status = write_file(&outputs, i, error);
        if (status) return status;
    }
    return STATUS_OK;
}

static void print_distances(FILE *to, const char *name, const struct distance_stats *stats, double diagonal) {
    if (!stats->count) return;
    fprintf(to, "%-16s mean %.3e  rms %.3e  max %.3e of the diagonal\n", name, stats->mean / diagonal,
            stats->rms / diagonal, stats->max / diagonal);
}

void worker_output_summary(const struct report *r, FILE *to) {
    fprintf(to, "%-16s %" PRIu64 " of %" PRIu64 "\n", "points", r->points_out, r->points_in);
    print_distances(to, "tangent error", &r->tangent, r->diagonal);
    if (r->has_mesh)
        fprintf(to, "%-16s %" PRIu64 " triangles, %s, %" PRIu64 " kept points lost\n", "mesh", r->triangles,
                r->watertight ? "watertight" : "open", r->points_lost);
    print_distances(to, "points to mesh", &r->forward, r->diagonal);
    print_distances(to, "mesh to surface", &r->backward, r->diagonal);
    print_distances(to, "surface to mesh", &r->surface, r->diagonal);
    fprintf(to, "%-16s %.0f ms, %.1f MiB at the peak\n", "cost", r->total_ms, (double)r->peak_rss_bytes / 1048576);
}

void worker_output_explain(const char *input, enum status status, const struct error *error, FILE *to) {
    fprintf(to, "whittle: %s: ", input);
    if (error->line) fprintf(to, "line %" PRIu64 ": ", error->line);
    if (!error->line && error->byte_offset != UINT64_MAX && error->code)
        fprintf(to, "byte %" PRIu64 ": ", error->byte_offset);
    if (error->where[0]) fprintf(to, "%s: ", error->where);
    fprintf(to, "%s\n", error->text[0] ? error->text : status_name(status));
}
