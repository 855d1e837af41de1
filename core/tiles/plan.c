/* The plan: two readings of the input, and a sample.
 *
 *  1 count       the box, the cells, and how positions can be written shorter
 *  2 divide      cells into tiles
 *  3 deal        each point to its tile's file, in the order of the input
 *  4 sort        each tile's points by cell
 *  5 sample      blocks from all over the cloud, with what lies around them, are contracted as far as tiles will be:
 *                whether there is noise, the average operator, and which pairs are among the cheapest of each pass
 *
 * A cloud that is no larger than the sample may be is the sample.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/cloud/most.h"
#include "core/cloud/select.h"
#include "core/io/formats/las_fields.h"
#include "core/io/out/file_out.h"
#include "core/io/out/sink.h"
#include "core/io/stream.h"
#include "core/tiles/left.h"
#include "core/tiles/part.h"
#include "core/tiles/scratch.h"
#include "core/tiles/tiles.h"

enum { BLOCK_POINTS = 1 << 16, MOST_BLOCKS = 96, MOST_PASSES = 200, DEAL_BYTES = 16 << 20 };
static const double RINGS = 8, PASS_RINGS = 4, MOST_REACH = 400; /* spacings: what stages and passes look at */

struct planning {
    const struct tiles_job *job;
    const struct progress *progress;
    struct error *error;
    struct scratch scratch;
    struct grid grid;
    size_t tiles;
    unsigned threads;
    uint64_t unpacked; /* bytes of the input on the disk while it is read, where it is compressed */
    uint32_t *cell;    /* of each point of the part that is read; owned */
    size_t cell_room;
};

static enum status plan_no_memory(struct error *error) {
    return error_set(error, STATUS_NO_MEMORY, "tiles", "not enough memory to plan tiles");
}

static enum status cancelled(struct error *error) { return error_set(error, STATUS_CANCELLED, "tiles", "cancelled"); }

static enum status make_cells(struct planning *plan, size_t n) {
    if (n <= plan->cell_room) return STATUS_OK;
    free(plan->cell);
    plan->cell = alloc_array(n, sizeof *plan->cell);
    plan->cell_room = plan->cell ? n : 0;
    return plan->cell ? STATUS_OK : plan_no_memory(plan->error);
}

/* ------------------------------------------------------------------------------------------------ goal */

static enum status find_goal(struct planning *plan, struct fit_goal *goal) {
    struct scratch_head *head = &plan->scratch.head;
    const struct fit_cloud cloud = {.points = head->points,
                                    .record_bytes = head->record_bytes,
                                    .each = (double)scratch_record_bytes(&head->coding),
                                    .room = head->room,
                                    .tile_points = plan->job->tile_points};
    *goal = fit_goal(&head->params, &cloud);
    head->wanted = (uint64_t)goal->wanted;
    head->ranks_all = goal->ranks_all;
    head->tells_normals = goal->tells_normals;
    return fit_kept(&head->params, head->points, head->record_bytes, head->room, plan->error);
}

/* ------------------------------------------------------------------------------------------------ count */

struct counting {
    vec3 least, most;
    bool f32, scaled, far; /* far: a coordinate is too large, or none */
    struct scratch_coding single, whole;
};

enum { COUNT_GRAIN = 1 << 14 };

struct counting_part {
    const vec3 *point;
    struct counting *range; /* of each range of COUNT_GRAIN points: begun alike */
};

static void count_range(void *ctx, size_t begin, size_t end) {
    const struct counting_part *part = ctx;
    struct counting c = part->range[begin / COUNT_GRAIN];
    for (size_t i = begin; i < end; i++) {
        vec3 p = part->point[i];
        c.least = vec3_min(c.least, p);
        c.most = vec3_max(c.most, p);
        c.far = c.far || !(fabs(p.x) < ORDER_LARGEST && fabs(p.y) < ORDER_LARGEST && fabs(p.z) < ORDER_LARGEST);
        c.f32 = c.f32 && scratch_codes(&c.single, p);
        c.scaled = c.scaled && scratch_codes(&c.whole, p);
    }
    part->range[begin / COUNT_GRAIN] = c;
}

static enum status count_part(const struct planning *plan, struct counting *c, const vec3 *point, size_t n) {
    size_t ranges = (n + COUNT_GRAIN - 1) / COUNT_GRAIN;
    struct counting_part part = {point, alloc_array(ranges, sizeof *part.range)};
    if (!part.range) return plan_no_memory(plan->error);
    for (size_t r = 0; r < ranges; r++) part.range[r] = *c;
    par_for(plan->threads, n, COUNT_GRAIN, count_range, &part);
    for (size_t r = 0; r < ranges; r++) {
        c->least = vec3_min(c->least, part.range[r].least);
        c->most = vec3_max(c->most, part.range[r].most);
        c->f32 = c->f32 && part.range[r].f32;
        c->scaled = c->scaled && part.range[r].scaled;
        c->far = c->far || part.range[r].far;
    }
    free(part.range);
    if (!c->far) return STATUS_OK;
    return error_set(plan->error, STATUS_MALFORMED, "tiles", "a point has a coordinate over %g", ORDER_LARGEST);
}

/* The coding that LAS has. */
static bool whole_numbers_of(const struct cloud *cloud, struct scratch_coding *coding) {
    *coding = (struct scratch_coding){.kind = CODING_SCALED};
    if (!cloud->las) return false;
    for (size_t axis = 0; axis < 3; axis++) {
        const struct las_field *field = &cloud->las->field[cloud->xyz[axis]];
        if (!field->scaled) return false;
        coding->scale[axis] = field->scale;
        coding->add[axis] = field->add;
    }
    return true;
}

/* Where the scanners stood, which shows once all points have been read. */
static enum status copy_left_out(struct planning *plan, const struct cloud_stream *stream) {
    struct scratch *s = &plan->scratch;
    const char *left_out = cloud_stream_left_out(stream);
    s->head.left_out_bytes = left_out ? strlen(left_out) + 1 : 0;
    s->left_out = alloc_array(s->head.left_out_bytes, 1);
    if (!s->left_out) return plan_no_memory(plan->error);
    if (left_out) memcpy(s->left_out, left_out, s->head.left_out_bytes);
    return STATUS_OK;
}

static enum status copy_views(struct planning *plan, const struct cloud_stream *stream) {
    struct scratch *s = &plan->scratch;
    const vec3 *view = cloud_stream_views(stream, &s->head.views);
    s->view = alloc_array(s->head.views, sizeof *s->view);
    if (!s->view) return plan_no_memory(plan->error);
    if (s->head.views) memcpy(s->view, view, s->head.views * sizeof *view);
    return STATUS_OK;
}

static enum status count(struct planning *plan, struct cloud_stream *stream) {
    struct scratch_head *head = &plan->scratch.head;
    const struct cloud *part;
    struct counting c = {.f32 = true, .single = {.kind = CODING_F32}};
    c.scaled = whole_numbers_of(cloud_stream_cloud(stream), &c.whole);
    head->record_bytes = cloud_stream_cloud(stream)->record_bytes;
    enum status status;
    for (;;) {
        status = cloud_stream_next(stream, &part, plan->error);
        if (!status && progress_tick(plan->progress, "count", 0.35 * cloud_stream_fraction(stream)))
            status = cancelled(plan->error);
        if (status) return status;
        if (part->count == 0) break;
        if (head->points == 0) c.least = c.most = part->position[0];
        status = count_part(plan, &c, part->position, part->count);
        if (!status) status = make_cells(plan, part->count);
        if (status) return status;
        if (head->points == 0 && grid_init(&plan->grid, part->position, part->count))
            return plan_no_memory(plan->error);
        grid_count(&plan->grid, part->position, part->count, plan->threads, plan->cell);
        head->points += part->count;
        if (head->points >= NONE)
            return error_set(plan->error, STATUS_LIMIT, "points", "more than %u points", NONE - 1);
    }
    plan->unpacked = cloud_stream_unpacked(stream);
    head->dropped = cloud_stream_dropped(stream);
    head->selection = cloud_stream_selection(stream);
    status = copy_views(plan, stream);
    if (!status) status = copy_left_out(plan, stream);
    if (status) return status;
    uint64_t others = head->selection.cropped + head->selection.filtered;
    if (head->points == 0 && others > 0)
        return error_set(plan->error, STATUS_BAD_PARAMETER, head->selection.filtered ? "where" : "crop",
                         "no point is left of %" PRIu64, others);
    if (head->points == 0) return error_set(plan->error, STATUS_MALFORMED, "read", "no points");
    grid_ripen(&plan->grid);
    order_frame_of(c.least, c.most, &head->whole);
    head->coding = c.f32 ? c.single : c.scaled ? c.whole : (struct scratch_coding){.kind = CODING_F64};
    return STATUS_OK;
}

static int compare_edges(const void *a, const void *b) {
    const double *p = a, *q = b;
    return (*p > *q) - (*p < *q);
}

/* Where a few points lie so far off that the box says nothing of the others, the frame is that of most. */
static enum status choose_frame(struct planning *plan) {
    struct scratch_head *head = &plan->scratch.head;
    struct grid *grid = &plan->grid;
    struct {
        double at, points;
    } *along = alloc_array(grid->count, sizeof *along);
    double side = grid_side(grid), least[3], most[3], sum_sq = 0;
    const double anchor[3] = {grid->anchor.x, grid->anchor.y, grid->anchor.z};
    if (!along) return plan_no_memory(plan->error);
    for (int axis = 0; axis < 3; axis++) {
        for (size_t i = 0; i < grid->count; i++) {
            along[i].at = (double)grid->cell[i].place.at[axis];
            along[i].points = (double)grid->cell[i].count;
        }
        qsort(along, grid->count, sizeof *along, compare_edges);
        double sum = 0, outer = (double)head->points / MOST_OUTERMOST;
        size_t first = 0, last = 0;
        for (size_t i = 0; i < grid->count; i++) {
            if (sum <= outer) first = i;
            if (sum <= (double)head->points - outer) last = i;
            sum += along[i].points;
        }
        least[axis] = anchor[axis] + side * along[first].at;
        most[axis] = anchor[axis] + side * (along[last].at + 1);
        sum_sq += (most[axis] - least[axis]) * (most[axis] - least[axis]);
    }
    free(along);
    if (sqrt(sum_sq) * MOST_SPOILT >= head->whole.diagonal) return STATUS_OK;
    head->whole.centre = (vec3){(least[0] + most[0]) / 2, (least[1] + most[1]) / 2, (least[2] + most[2]) / 2};
    head->whole.scale = sqrt(sum_sq);
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ divide */

static enum status divide(struct planning *plan) {
    struct scratch *s = &plan->scratch;
    if (grid_divide(&plan->grid, 0, plan->grid.count, s->head.tile_points, &s->tile, &plan->tiles))
        return plan_no_memory(plan->error);
    for (size_t t = 0; t < plan->tiles; t++)
        if (s->tile[t].points > s->head.room)
            return error_set(plan->error, STATUS_NO_MEMORY, "memory",
                             "%" PRIu64
                             " points lie within %g of each other; allow more memory, or thin them out before",
                             s->tile[t].points, grid_side(&plan->grid));
    grid_settle(&plan->grid, s->tile, plan->tiles);
    s->cell = alloc_array(plan->grid.count, sizeof *s->cell);
    s->sum = alloc_zeroed(plan->grid.count, sizeof *s->sum);
    if (!s->cell || !s->sum) return plan_no_memory(plan->error);
    memcpy(s->cell, plan->grid.cell, plan->grid.count * sizeof *s->cell);
    s->head.tiles = plan->tiles;
    s->head.cells = plan->grid.count;
    s->head.anchor = plan->grid.anchor;
    s->head.level = plan->grid.level;
    return STATUS_OK;
}

static enum status check_disk(const struct planning *plan, double needed) {
    struct statvfs about;
    if (statvfs(plan->job->folder, &about) != 0) return STATUS_OK;
    double there = (double)about.f_bavail * (double)about.f_frsize;
    if (needed <= there) return STATUS_OK;
    return error_set(plan->error, STATUS_NO_SPACE, "scratch", "%s has %.0f MiB free, and tiles take %.0f MiB",
                     plan->job->folder, floor(there / 0x1p20), ceil(needed / 0x1p20));
}

/* ------------------------------------------------------------------------------------------------ deal, sort */

struct dealer {
    size_t room; /* bytes for each tile */
    size_t *used;
    unsigned char *bytes, *record; /* record: BATCH_POINTS */
};

static enum status write_all(const char *path, int flags, const void *bytes, size_t n, struct error *error) {
    int fd = open(path, O_WRONLY | O_CREAT | O_CLOEXEC | flags, 0666);
    size_t done = 0;
    while (fd >= 0 && done < n) {
        ssize_t wrote = write(fd, (const char *)bytes + done, n - done);
        if (wrote < 0 && errno == EINTR) continue;
        if (wrote <= 0) break;
        done += (size_t)wrote;
    }
    int failure = errno;
    if (fd >= 0 && close(fd) == 0 && done == n) return STATUS_OK;
    return error_set(error, status_from_errno(failure), "scratch", "can't write %s: %s", path, strerror(failure));
}

static enum status flush(const struct planning *plan, struct dealer *dealer, size_t tile) {
    char path[SCRATCH_PATH_BYTES];
    scratch_path(path, plan->job->folder, "raw", tile);
    enum status status =
        write_all(path, O_APPEND, dealer->bytes + tile * dealer->room, dealer->used[tile], plan->error);
    dealer->used[tile] = 0;
    return status;
}

/* Points of a part that are written at a time: as records in the order of the input, and each one's tile. */
enum { BATCH_POINTS = 1 << 17 };

struct dealing {
    const struct planning *plan;
    const vec3 *point;
    uint64_t id; /* of the first */
    uint32_t *tile;
    unsigned char *record;
};

/* tile: the cell before, the tile afterwards; NONE of a point that wasn't counted. */
static void deal_range(void *ctx, size_t begin, size_t end) {
    const struct dealing *d = ctx;
    const struct scratch_coding *coding = &d->plan->scratch.head.coding;
    size_t each = scratch_record_bytes(coding);
    for (size_t i = begin; i < end; i++) {
        bool known = d->tile[i] != NONE && scratch_codes(coding, d->point[i]);
        d->tile[i] = known ? d->plan->grid.cell[d->tile[i]].tile : NONE;
        if (known) scratch_encode(coding, d->point[i], (uint32_t)(d->id + i), d->record + i * each);
    }
}

static enum status deal_batch(struct planning *plan, struct dealer *dealer, const vec3 *point, size_t n, uint64_t id) {
    enum { GRAIN = 1 << 13 };
    size_t each = scratch_record_bytes(&plan->scratch.head.coding);
    struct dealing d = {plan, point, id, plan->cell, dealer->record};
    enum status status = STATUS_OK;
    grid_find(&plan->grid, point, n, plan->threads, plan->cell);
    par_for(plan->threads, n, GRAIN, deal_range, &d);
    for (size_t i = 0; !status && i < n; i++) {
        size_t tile = d.tile[i];
        if (tile == NONE) return error_set(plan->error, STATUS_IO, "read", "the input has changed while it was read");
        memcpy(dealer->bytes + tile * dealer->room + dealer->used[tile], d.record + i * each, each);
        dealer->used[tile] += each;
        if (dealer->used[tile] + each > dealer->room) status = flush(plan, dealer, tile);
    }
    return status;
}

static enum status deal_part(struct planning *plan, struct dealer *dealer, const struct cloud *part, uint64_t first) {
    enum status status = STATUS_OK;
    for (size_t at = 0; !status && at < part->count; at += BATCH_POINTS) {
        size_t n = part->count - at < BATCH_POINTS ? part->count - at : BATCH_POINTS;
        status = deal_batch(plan, dealer, part->position + at, n, first + at);
    }
    return status;
}

static enum status deal(struct planning *plan, struct cloud_stream *stream) {
    struct dealer dealer = {.room = DEAL_BYTES / plan->tiles};
    if (dealer.room < 4096) dealer.room = 4096;
    dealer.used = alloc_zeroed(plan->tiles, sizeof *dealer.used);
    dealer.bytes = alloc_array(plan->tiles, dealer.room);
    dealer.record = alloc_array(BATCH_POINTS, scratch_record_bytes(&plan->scratch.head.coding));
    bool room = dealer.used && dealer.bytes && dealer.record;
    enum status status = room ? make_cells(plan, BATCH_POINTS) : plan_no_memory(plan->error);
    uint64_t dealt = 0;
    char path[SCRATCH_PATH_BYTES];
    for (size_t t = 0; !status && t < plan->tiles; t++) {
        scratch_path(path, plan->job->folder, "raw", t);
        status = write_all(path, O_TRUNC, "", 0, plan->error);
    }
    while (!status) {
        const struct cloud *part;
        status = cloud_stream_next(stream, &part, plan->error);
        if (status || part->count == 0) break;
        if (progress_tick(plan->progress, "deal", 0.35 + 0.35 * cloud_stream_fraction(stream)))
            status = cancelled(plan->error);
        if (!status) status = deal_part(plan, &dealer, part, dealt);
        dealt += part->count;
    }
    for (size_t t = 0; !status && t < plan->tiles; t++) status = flush(plan, &dealer, t);
    if (!status && dealt != plan->scratch.head.points)
        status = error_set(plan->error, STATUS_IO, "read", "the input has changed while it was read");
    free(dealer.used), free(dealer.bytes), free(dealer.record);
    return status;
}

/* The records of a tile by cell, each cell's in the order of the input. */
static enum status put_by_cell(const struct planning *plan, size_t t, const unsigned char *from, unsigned char *to) {
    enum { BATCH = 1 << 12 };
    const struct scratch_coding *coding = &plan->scratch.head.coding;
    const struct grid_tile *tile = &plan->scratch.tile[t];
    size_t each = scratch_record_bytes(coding);
    uint64_t *next = alloc_array(tile->cells, sizeof *next);
    vec3 *point = alloc_array(BATCH, sizeof *point);
    uint32_t *cell = alloc_array(BATCH, sizeof *cell), id;
    bool room = next && point && cell;
    for (size_t i = 0; room && i < tile->cells; i++) next[i] = plan->grid.cell[tile->first + i].first;
    for (uint64_t first = 0; room && first < tile->points; first += BATCH) {
        size_t n = tile->points - first < BATCH ? (size_t)(tile->points - first) : BATCH;
        for (size_t i = 0; i < n; i++) point[i] = scratch_decode(coding, from + (first + i) * each, &id);
        grid_find(&plan->grid, point, n, 1, cell);
        for (size_t i = 0; i < n; i++) {
            memcpy(to + next[cell[i] - tile->first]++ * each, from + (first + i) * each, each);
            plan->scratch.sum[cell[i]] += scratch_sum(coding, from + (first + i) * each, 1);
        }
    }
    free(next), free(point), free(cell);
    return room ? STATUS_OK : STATUS_NO_MEMORY;
}

static enum status sort_tile(const struct planning *plan, size_t t, struct error *error) {
    char raw[SCRATCH_PATH_BYTES], path[SCRATCH_PATH_BYTES];
    size_t bytes = (size_t)plan->scratch.tile[t].points * scratch_record_bytes(&plan->scratch.head.coding);
    unsigned char *from = alloc_array(bytes, 1), *to = alloc_array(bytes, 1);
    struct file_out file = {0};
    struct sink sink;
    enum status status = from && to ? STATUS_OK : plan_no_memory(error);
    scratch_path(raw, plan->job->folder, "raw", t);
    scratch_path(path, plan->job->folder, "points", t);
    int fd = status ? -1 : open(raw, O_RDONLY | O_CLOEXEC);
    if (!status) status = scratch_read(fd, from, bytes, 0, raw, error);
    if (fd >= 0) close(fd);
    if (!status) unlink(raw); /* while a plan is made nothing is gone on with after a crash */
    if (!status && put_by_cell(plan, t, from, to)) status = plan_no_memory(error);
    if (!status) status = file_out_begin(&file, path, error);
    if (!status) {
        status = sink_init(&sink, file.fd);
        sink_bytes(&sink, to, bytes);
        status = sink_done(&sink, status, error);
        if (!status) status = file_out_name(&file, error); /* which sync_points makes last */
    }
    if (status) file_out_abort(&file);
    free(from), free(to);
    return status;
}

enum { SORTED_AT_ONCE = 4 /* tiles, whose points are twice in memory: less than a part takes */ };

struct sorting {
    const struct planning *plan;
    size_t first;
    enum status status[SORTED_AT_ONCE];
    struct error error[SORTED_AT_ONCE];
};

static void sort_some(void *ctx, size_t begin, size_t end) {
    struct sorting *s = ctx;
    for (size_t i = begin; i < end; i++) s->status[i] = sort_tile(s->plan, s->first + i, &s->error[i]);
}

static enum status sort(const struct planning *plan) {
    struct sorting s = {.plan = plan};
    for (; s.first < plan->tiles; s.first += SORTED_AT_ONCE) {
        size_t n = plan->tiles - s.first < SORTED_AT_ONCE ? plan->tiles - s.first : SORTED_AT_ONCE;
        if (progress_tick(plan->progress, "sort", 0.7 + 0.15 * (double)s.first / (double)plan->tiles))
            return cancelled(plan->error);
        par_for(plan->threads, n, 1, sort_some, &s);
        for (size_t i = 0; i < n; i++) {
            if (s.status[i] && plan->error) *plan->error = s.error[i];
            if (s.status[i]) return s.status[i];
        }
    }
    return STATUS_OK;
}

/* Waits until all tiles' points are on the disk, which writes them while the sample is made. */
static enum status sync_points(const struct planning *plan) {
    char path[SCRATCH_PATH_BYTES];
    enum status status = STATUS_OK;
    for (size_t t = 0; !status && t < plan->tiles; t++) {
        scratch_path(path, plan->job->folder, "points", t);
        status = file_out_sync(path, plan->error);
    }
    return status;
}

/* ------------------------------------------------------------------------------------------------ sample */

/* How far, in spacings, what is done to a point depends on others: rings of neighbours for the stages, and some more
 * for each pass, wider apart each time. */
static double reach_of(size_t passes, double share) {
    double growth = passes ? pow(share, -0.5 / (double)passes) : 1, sum = RINGS;
    for (size_t i = 0; i < passes; i++) sum += PASS_RINGS * pow(growth, (double)i);
    return fmin(sum, MOST_REACH);
}

/* Points of a block: fewer where there is little room. */
static uint64_t block_points_of(const struct scratch_head *head) {
    uint64_t most = head->room / (4 * FIT_FEWEST_BLOCKS);
    return most < FIT_LEAST_BLOCK_POINTS ? FIT_LEAST_BLOCK_POINTS : most < BLOCK_POINTS ? most : BLOCK_POINTS;
}

/* Boxes of some thousand points each, all of the cloud. */
static enum status find_blocks(const struct planning *plan, struct grid_tile **block, size_t *blocks) {
    struct grid copy = {0};
    enum status status = grid_from(&copy, plan->grid.anchor, plan->grid.level, plan->grid.cell, plan->grid.count);
    if (!status) status = grid_divide(&copy, 0, copy.count, block_points_of(&plan->scratch.head), block, blocks);
    grid_done(&copy);
    return status ? plan_no_memory(plan->error) : STATUS_OK;
}

static enum status append_points(struct scratch_points *all, const struct scratch_points *more, bool own) {
    size_t count = 0;
    for (size_t i = 0; i < more->count; i++) count += more->own[i] == own;
    void *position = alloc_resize(all->position, all->count + count, sizeof *all->position);
    if (position) all->position = position;
    void *id = alloc_resize(all->id, all->count + count, sizeof *all->id);
    if (id) all->id = id;
    void *mark = alloc_resize(all->own, all->count + count, sizeof *all->own);
    if (mark) all->own = mark;
    if (!position || !id || !mark) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < more->count; i++) {
        if (more->own[i] != own) continue;
        all->position[all->count] = more->position[i];
        all->id[all->count] = more->id[i];
        all->own[all->count++] = own;
    }
    return STATUS_OK;
}

/* Of blocks evenly along their list, which is along the cloud.  Own points come first, so that one which lies around
 * another block too counts. */
static enum status gather_blocks(const struct planning *plan, const struct grid_tile *block, size_t blocks,
                                 double reach, struct scratch_points *sample) {
    const struct scratch *s = &plan->scratch;
    struct scratch_points around = {0};
    double each = (double)block_points_of(&s->head), wide = 1 + 2 * reach / sqrt(each);
    size_t chosen = (size_t)fmin(fmax((double)s->head.room / (each * wide * wide), FIT_FEWEST_BLOCKS), MOST_BLOCKS);
    enum status status = STATUS_OK;
    if (chosen > blocks) chosen = blocks;
    for (size_t i = 0; !status && i < chosen; i++) {
        const struct grid_tile *box = &block[(2 * i + 1) * blocks / (2 * chosen)];
        struct scratch_points points;
        double spacing = grid_side(&plan->grid) * sqrt((double)box->cells / (double)box->points);
        status = scratch_gather(plan->job->folder, s, &plan->grid, box, reach * spacing, s->head.room / chosen,
                                plan->threads, &points, plan->error);
        if (status) break;
        status = append_points(sample, &points, true);
        if (!status) status = append_points(&around, &points, false);
        scratch_points_done(&points);
    }
    if (!status) status = append_points(sample, &around, false);
    scratch_points_done(&around);
    return status == STATUS_NO_MEMORY ? plan_no_memory(plan->error) : status;
}

static enum status gather_sample(const struct planning *plan, double reach, struct scratch_points *sample) {
    const struct scratch *s = &plan->scratch;
    struct grid_tile *block = NULL;
    size_t blocks = 0;
    if (s->head.points > s->head.room) {
        enum status status = find_blocks(plan, &block, &blocks);
        if (!status) status = gather_blocks(plan, block, blocks, reach, sample);
        free(block);
        return status;
    }
    struct grid_tile all = s->tile[0];
    for (size_t t = 1; t < plan->tiles; t++)
        for (int axis = 0; axis < 3; axis++) {
            if (s->tile[t].from.at[axis] < all.from.at[axis]) all.from.at[axis] = s->tile[t].from.at[axis];
            if (s->tile[t].to.at[axis] > all.to.at[axis]) all.to.at[axis] = s->tile[t].to.at[axis];
        }
    return scratch_gather(plan->job->folder, s, &plan->grid, &all, 0, s->head.room, plan->threads, sample, plan->error);
}

/* Of a sample's points that count, the one that so many are more important than. */
struct ranked {
    size_t pass; /* in which it went */
    uint32_t key;
};

/* Such a point, if it has gone; none went before the first pass, and none of those left has a key. */
static struct ranked find_ranked(const struct contract_left *left, const uint8_t *counted, double rank) {
    const struct contract_gone *gone = &left->gone;
    double seen = 0;
    for (size_t i = 0; i < left->n; i++) seen += counted[left->id[i]];
    if (seen >= rank) return (struct ranked){left->passes, 0};
    for (size_t i = gone->n, pass = left->passes; i-- > 0;) {
        while (pass > 0 && i < gone->end[pass - 1]) pass--;
        seen += counted[gone->id[i]];
        if (seen >= rank) return (struct ranked){pass, gone_key(left->passes, pass, gone->cost[i])};
    }
    return (struct ranked){0, UINT32_MAX};
}

/* Passes below what is kept tell but which of the kept points are more important, and which quadrics go with them: so
 * points around a tile needn't reach as far as these look. */
static void find_told(struct planning *plan, const struct contract_left *left, const uint8_t *counted, size_t n,
                      const struct fit_goal *goal) {
    struct scratch_head *head = &plan->scratch.head;
    double of = 0, points = (double)head->points;
    for (size_t i = 0; i < n; i++) of += counted[i];
    head->told_key = find_ranked(left, counted, goal->told / points * of).key;
    struct ranked last = find_ranked(left, counted, goal->wanted / points * of);
    if (last.pass < left->passes) head->reach = reach_of(last.pass + 1, goal->wanted / points);
}

static enum status contract_sample(struct planning *plan, struct part *part, double length_bias,
                                   const struct fit_goal *goal) {
    struct scratch *s = &plan->scratch;
    double share = fmin(goal->left / (double)s->head.points, 1);
    s->limit = alloc_zeroed(MOST_PASSES, sizeof *s->limit);
    if (!s->limit) return plan_no_memory(plan->error);
    const struct contract_part some = {.threads = part->threads,
                                       .length_bias = length_bias,
                                       .passes = MOST_PASSES,
                                       .limit = s->limit,
                                       .counted = part->own,
                                       .least_share = share,
                                       .keeps_gone = goal->told > 0};
    struct contract_left left = {0};
    enum status status = contract_some(part->points.point, &part->near, part->quadrics, &some, NULL, &left);
    s->head.passes = left.passes;
    s->head.reach = reach_of(left.passes, left.share);
    if (!status && goal->told > 0) find_told(plan, &left, part->own, part->points.count, goal);
    contract_left_done(&left);
    return status == STATUS_NO_MEMORY ? plan_no_memory(plan->error) : status;
}

static enum status sample(struct planning *plan) {
    struct scratch_head *head = &plan->scratch.head;
    struct scratch_points points = {0};
    struct part part = {.params = &head->params, .threads = (unsigned)plan->job->params->threads};
    struct part_whole whole = {.frame = head->whole};
    struct fit_goal goal;
    enum status status = find_goal(plan, &goal);
    double share = fmin(goal.left / (double)head->points, 1);
    if (!status && progress_tick(plan->progress, "sample", 0.85)) status = cancelled(plan->error);
    if (!status) status = gather_sample(plan, reach_of((size_t)ceil(log(share) / log(0.8)), share) / 2, &points);
    if (!status) status = part_make(&part, &points, true, &whole, NULL, plan->error);
    scratch_points_done(&points);
    head->noisy = whole.noisy;
    head->average = whole.average;
    head->length_bias = whole.length_bias;
    head->noise = whole.noise;
    if (!status) status = contract_sample(plan, &part, whole.length_bias, &goal);
    part_done(&part);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the whole */

static enum status open_input(const struct planning *plan, struct cloud_stream **stream) {
    const struct params *params = plan->job->params;
    const struct cloud_limits limits = {.columns = params->columns,
                                        .threads = (unsigned)params->threads,
                                        .select = params,
                                        .scratch = plan->job->folder};
    return cloud_stream_open(plan->job->input, plan->job->inputs, &limits, stream, plan->error);
}

static enum status identify(struct planning *plan) {
    const struct tiles_job *job = plan->job;
    struct scratch *s = &plan->scratch;
    s->input = alloc_zeroed(job->inputs, sizeof *s->input);
    if (!s->input) return plan_no_memory(plan->error);
    s->head.inputs = job->inputs;
    s->head.params = *job->params;
    s->head.room = fit_room(job->params);
    s->head.tile_points = job->tile_points ? job->tile_points : (uint64_t)((double)s->head.room / FIT_AROUND);
    enum status status = STATUS_OK;
    for (size_t i = 0; !status && i < job->inputs; i++)
        status = scratch_identify(job->input[i], &s->input[i], plan->error);
    return status;
}

/* Whether a plan is of this input and these parameters. */
static enum status compare(const struct planning *plan, const struct scratch *there) {
    const struct scratch *mine = &plan->scratch;
    const char *what = NULL;
    size_t rows;
    const struct param *row = params_table(&rows);
    if (mine->head.inputs != there->head.inputs) what = "input";
    for (size_t i = 0; !what && i < mine->head.inputs; i++)
        if (mine->input[i].bytes != there->input[i].bytes || mine->input[i].hash != there->input[i].hash ||
            mine->input[i].modified_ns != there->input[i].modified_ns)
            what = "input";
    if (mine->head.room != there->head.room || mine->head.tile_points != there->head.tile_points) what = "memory";
    for (size_t i = 0; !what && i < rows; i++) {
        char a[PARAMS_TEXT_BYTES], b[PARAMS_TEXT_BYTES];
        if (!row[i].affects_result) continue;
        params_format(&mine->head.params, &row[i], a, sizeof a);
        params_format(&there->head.params, &row[i], b, sizeof b);
        if (strcmp(a, b) != 0) what = row[i].name;
    }
    if (!what) return STATUS_OK;
    return error_set(plan->error, STATUS_BAD_PARAMETER, "scratch",
                     "%s has the tiles of another run (%s differs); use another folder, or remove it",
                     plan->job->folder, what);
}

static enum status make_plan(struct planning *plan) {
    struct cloud_stream *stream = NULL;
    enum status status = open_input(plan, &stream);
    if (!status) status = count(plan, stream);
    cloud_stream_free(stream);
    stream = NULL;
    struct fit_goal goal;
    if (!status) status = find_goal(plan, &goal);
    if (!status) status = choose_frame(plan);
    if (!status) status = divide(plan);
    if (!status) status = check_disk(plan, goal.disk_bytes + (double)plan->unpacked);
    if (!status) status = open_input(plan, &stream);
    if (!status) status = deal(plan, stream);
    cloud_stream_free(stream);
    if (!status) status = scratch_check_inputs(&plan->scratch, "before it was read", plan->error);
    if (!status) status = sort(plan);
    if (!status) status = sample(plan);
    if (!status) status = sync_points(plan);
    return status ? status : scratch_save(plan->job->folder, &plan->scratch, plan->error);
}

static void tell(const char *folder, const struct scratch *s, struct tiles_facts *facts) {
    *facts = (struct tiles_facts){.points = s->head.points,
                                  .tile_points = s->head.tile_points,
                                  .tiles = s->head.tiles,
                                  .passes = s->head.passes,
                                  .for_tileset = s->head.ranks_all};
    for (size_t t = 0; t < s->head.tiles; t++) facts->done += scratch_has(folder, "left", t);
}

enum status tiles_plan(const struct tiles_job *job, const struct progress *progress, struct tiles_facts *facts,
                       struct error *error) {
    struct planning plan = {
        .job = job, .progress = progress, .error = error, .threads = (unsigned)job->params->threads};
    struct scratch there = {0};
    enum status status = tiles_can(job->params, error);
    if (!status && mkdir(job->folder, 0777) != 0 && errno != EEXIST)
        status =
            error_set(error, status_from_errno(errno), "scratch", "can't make %s: %s", job->folder, strerror(errno));
    if (!status) status = identify(&plan);
    if (!status && scratch_has(job->folder, "plan", 0)) {
        status = scratch_load(job->folder, &there, error);
        if (!status) status = compare(&plan, &there);
        if (!status) tell(job->folder, &there, facts);
    } else if (!status) {
        struct par_team *team = par_team_new();
        int lock = open(job->folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
        if (lock >= 0 && flock(lock, LOCK_EX | LOCK_NB) != 0 && errno == EWOULDBLOCK)
            status = error_set(error, STATUS_IO, "scratch", "another run is planning in %s", job->folder);
        else
            status = team ? make_plan(&plan) : plan_no_memory(error);
        if (lock >= 0) close(lock);
        par_team_free(team);
        if (!status) tell(job->folder, &plan.scratch, facts);
    }
    scratch_done(&there);
    scratch_done(&plan.scratch);
    grid_done(&plan.grid);
    free(plan.cell);
    return status;
}

enum status tiles_look(const char *folder, struct tiles_facts *facts, struct params *params, struct error *error) {
    struct scratch s = {0};
    enum status status = scratch_load(folder, &s, error);
    if (status) return status;
    tell(folder, &s, facts);
    if (params) *params = s.head.params;
    scratch_done(&s);
    return STATUS_OK;
}

void tiles_inputs_done(struct tiles_inputs *inputs) {
    for (size_t i = 0; i < inputs->count; i++) free(inputs->path[i]);
    free(inputs->path);
    *inputs = (struct tiles_inputs){0};
}

enum status tiles_inputs(const char *folder, struct tiles_inputs *inputs, struct error *error) {
    struct scratch s = {0};
    enum status status = scratch_load(folder, &s, error);
    if (status) return status;
    *inputs = (struct tiles_inputs){.path = alloc_zeroed(s.head.inputs, sizeof *inputs->path)};
    for (size_t i = 0; inputs->path && !status && i < s.head.inputs; i++) {
        size_t n = strlen(s.input[i].path) + 1;
        inputs->path[inputs->count++] = alloc_array(n, 1);
        if (inputs->path[i])
            memcpy(inputs->path[i], s.input[i].path, n);
        else
            status = plan_no_memory(error);
    }
    if (!inputs->path) status = plan_no_memory(error);
    if (status) tiles_inputs_done(inputs);
    scratch_done(&s);
    return status;
}
