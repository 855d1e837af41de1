/* Tar archives: all clouds in one, joined in their order.
 *
 * Members are whatever cloud_read_memory reads, compressed or not, but no archives.  What isn't a file, and files whose
 * names begin with a dot, are passed over.
 *
 * Invariant: a member's size is believed where the archive has so many bytes left, and allocates nothing.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <inttypes.h>
#include <stdio.h>
#include <string.h>

#include "core/io/formats/tar_members.h"
#include "core/io/join.h"
#include "core/io/read.h"
#include "core/io/reader.h"
#include "core/io/sniff.h"

/* The progress of one member within that of the archive. */
struct part {
    const struct progress *whole;
    double begin, share;
};

static int tick_part(void *ctx, const char *stage, double fraction) {
    const struct part *part = ctx;
    return progress_tick(part->whole, stage, part->begin + part->share * fraction);
}

/* What is left of the limits for the next member. */
static struct cloud_limits limits_left(const struct cloud_limits *limits, const struct cloud *cloud) {
    struct cloud_limits left = limits ? *limits : (struct cloud_limits){0};
    left.columns_if_text = true;
    if (left.max_points) left.max_points = left.max_points > cloud->count ? left.max_points - cloud->count : 1;
    if (left.max_triangles)
        left.max_triangles =
            left.max_triangles > cloud->triangle_count ? left.max_triangles - cloud->triangle_count : 1;
    return left;
}

/* The same error, of the member. */
static void name_member(const char *name, struct error *error) {
    char text[ERROR_TEXT_BYTES];
    if (!error) return;
    snprintf(text, sizeof text, "%.63s: %.*s", name, (int)sizeof text - 80, error->text);
    memcpy(error->text, text, sizeof text);
}

static enum status read_member(const void *bytes, size_t n, const struct tar_member *member,
                               const struct cloud_limits *limits, const struct progress *progress,
                               struct cloud_join *join, struct error *error) {
    const char *first = (const char *)bytes + member->first;
    struct part part = {progress, (double)member->first / (double)n, (double)member->bytes / (double)n};
    const struct progress tick = {tick_part, &part};
    const struct cloud_limits left = limits_left(limits, &join->cloud);
    struct cloud cloud = {0};
    if (member->bytes > n - member->first)
        return error_set_at(error, STATUS_MALFORMED, "archive", 0, n,
                            "%.63s has %" PRIu64 " bytes, but the archive ends", member->name, member->bytes);
    if (cloud_sniff(first, (size_t)member->bytes).kind == CLOUD_KIND_TAR)
        return error_set_at(error, STATUS_UNSUPPORTED, "archive", 0, member->first, "%.63s is an archive itself",
                            member->name);
    enum status status = cloud_read_memory(first, (size_t)member->bytes, &left, &tick, &cloud, error);
    if (!status) return cloud_join_add(join, &cloud, member->name, error);
    name_member(member->name, error);
    return status;
}

enum status cloud_tar_read(const void *bytes, size_t n, const struct cloud_limits *limits,
                           const struct progress *progress, struct cloud *cloud, struct error *error) {
    struct cloud_join join = {0};
    struct tar_member member = {0};
    enum status status = STATUS_OK;
    while (!status && tar_next(bytes, n, &member))
        status = read_member(bytes, n, &member, limits, progress, &join, error);
    if (!status && member.wrong)
        status = error_set_at(error, STATUS_MALFORMED, "archive", 0, member.at, "%s", member.wrong);
    if (!status && !join.inputs) status = error_set_at(error, STATUS_MALFORMED, "archive", 0, 0, "no cloud is in it");
    if (!status && limits && limits->max_points && join.cloud.count > limits->max_points)
        status = error_set(error, STATUS_LIMIT, "points", "%zu points, at most %" PRIu64 " are allowed",
                           join.cloud.count, limits->max_points);
    struct cloud joined;
    if (!status) status = cloud_join_end(&join, &joined, error);
    cloud_join_done(&join);
    if (status) return status;
    joined.form = "tar";
    *cloud = joined;
    return STATUS_OK;
}
