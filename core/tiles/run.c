/* One tile: its points and those around it go through the stages and the passes as in the whole cloud, and those of its
 * own that are left are written.
 *
 * What happens to the points around is another tile's to write; here they are simulated, so that the tile's own points
 * meet what they would meet.  Near the outer border they meet too little, which the width of what is taken along keeps
 * away from the tile.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/base/radix.h"
#include "core/io/out/file_out.h"
#include "core/io/out/sink.h"
#include "core/tiles/left.h"
#include "core/tiles/part.h"
#include "core/tiles/scratch.h"
#include "core/tiles/tiles.h"
#include "core/tiles/told.h"

static const double SPARSE = 0.9; /* of the points are no farther apart than what the width is counted in */

struct running {
    const char *folder;
    size_t tile;
    struct scratch scratch;
    struct grid grid;
    const struct progress *progress;
    struct error *error;
};

static enum status run_no_memory(const struct running *run) {
    return error_set(run->error, STATUS_NO_MEMORY, "tiles", "not enough memory for tile %zu", run->tile);
}

/* What a tile has found of its points and those around it. */
struct found {
    const struct running *run;
    const struct part *part;
    const struct scratch_points *points;
    const struct contract_left *left;
    uint32_t *place; /* of each that is left, among the tile's own; NONE: another's */
    const struct told *told;
};

/* The links of the i-th point that is left; returns the number of bytes. */
static size_t links_of(const struct found *of, size_t i, unsigned char link[UINT8_MAX * LEFT_LINK_BYTES]) {
    const struct contract_left *left = of->left;
    const uint32_t *list = &left->near.list[left->near.start[i]];
    size_t bytes = 0;
    for (unsigned k = 0; k < left->near.degree[i]; k++) {
        uint32_t id = of->points->id[of->part->points.original[left->id[list[k]]]];
        bytes += left_put_link(of->place[i], of->place[list[k]], id, link + bytes);
    }
    return bytes;
}

/* Numbers those left that are the tile's own; fills what the head tells. */
static struct left_head head_of(const struct found *of) {
    struct left_head head = {.mark = LEFT_MARK, .plan = scratch_identity(&of->run->scratch), .error = of->left->error};
    const struct part *part = of->part;
    unsigned char link[UINT8_MAX * LEFT_LINK_BYTES];
    for (size_t i = 0; i < of->left->n; i++) of->place[i] = part->own[of->left->id[i]] ? (uint32_t)head.count++ : NONE;
    for (size_t i = 0; i < of->left->n; i++) {
        if (of->place[i] == NONE) continue;
        head.links += of->left->near.degree[i];
        head.link_bytes += links_of(of, i, link);
    }
    for (size_t i = 0; i < part->points.count; i++) head.distinct += part->own[i];
    head.told = of->told->count;
    head.gap_bytes = told_gap_bytes(of->told);
    return head;
}

/* What the contractions of each pass had come to. */
static void put_errors(struct sink *sink, const struct contract_left *left) {
    const struct contract_gone *gone = &left->gone;
    for (size_t p = 0; p < left->passes; p++) {
        float error = gone->end[p] ? gone->error[gone->end[p] - 1] : 0;
        sink_bytes(sink, &error, sizeof error);
    }
}

/* Array by array, of those that are the tile's own. */
static void put_left(struct sink *sink, const struct found *of) {
    enum { RECORDS, QUADRICS, NORMALS, DEGREES, LINKS, ARRAYS };
    const struct left_head head = head_of(of);
    const struct scratch_coding *coding = &of->run->scratch.head.coding;
    const struct contract_left *left = of->left;
    sink_bytes(sink, &head, sizeof head);
    for (int array = 0; array < ARRAYS; array++)
        for (size_t i = 0; i < left->n; i++) {
            unsigned char record[SCRATCH_RECORD_BYTES], link[UINT8_MAX * LEFT_LINK_BYTES];
            if (of->place[i] == NONE) continue;
            uint32_t p = left->id[i], original = of->part->points.original[p];
            const vec3 *normal = &of->part->normal[p];
            if (array == RECORDS) {
                scratch_encode(coding, of->points->position[original], of->points->id[original], record);
                sink_bytes(sink, record, scratch_record_bytes(coding));
            }
            if (array == QUADRICS) sink_bytes(sink, &left->quadric[i], sizeof left->quadric[i]);
            if (array == NORMALS) sink_bytes(sink, (float[]){(float)normal->x, (float)normal->y, (float)normal->z}, 12);
            if (array == DEGREES) sink_bytes(sink, &left->near.degree[i], sizeof left->near.degree[i]);
            if (array == LINKS) sink_bytes(sink, link, links_of(of, i, link));
        }
    if (of->run->scratch.head.told_key) put_errors(sink, left);
    told_put(sink, of->told);
}

/* Of those that have gone. */
static void put_gone(struct sink *sink, const struct found *of) {
    const struct part *part = of->part;
    const struct contract_left *left = of->left;
    const struct contract_gone *gone = &left->gone;
    struct gone_head head = {.mark = GONE_MARK, .passes = left->passes};
    for (size_t i = 0; i < gone->n; i++) head.count += part->own[gone->id[i]];
    sink_bytes(sink, &head, sizeof head);
    put_errors(sink, left);
    for (size_t i = 0, pass = 0; i < gone->n; i++) {
        while (i >= gone->end[pass]) pass++;
        struct gone_item item = {gone_key(left->passes, pass, gone->cost[i]),
                                 of->points->id[part->points.original[gone->id[i]]]};
        if (part->own[gone->id[i]]) sink_bytes(sink, &item, sizeof item);
    }
}

/* The tile's own that are told: their places among those that have gone, by their numbers in the input. */
static enum status list_told(const struct found *of, uint64_t **item, uint64_t **spare, uint64_t **sorted, size_t *n) {
    const struct part *part = of->part;
    const struct contract_gone *gone = &of->left->gone;
    uint32_t last = of->run->scratch.head.told_key;
    size_t passes = of->left->passes, first = gone->n;
    for (size_t p = passes; p-- > 0 && gone_key(passes, p, INFINITY) <= last;) first = p ? gone->end[p - 1] : 0;
    *item = alloc_array(gone->n - first, sizeof **item);
    *spare = alloc_array(gone->n - first, sizeof **spare);
    *n = 0;
    if (!*item || !*spare) return STATUS_NO_MEMORY;
    for (size_t i = first, pass = 0; i < gone->n; i++) {
        while (i >= gone->end[pass]) pass++;
        uint32_t p = gone->id[i];
        if (part->own[p] && gone_key(passes, pass, gone->cost[i]) <= last)
            (*item)[(*n)++] = radix_item(of->points->id[part->points.original[p]], (uint32_t)i);
    }
    *sorted = radix_sort(*item, *spare, *n, part->threads);
    return STATUS_OK;
}

static enum status make_told(const struct found *of, struct told *told) {
    const struct contract_gone *gone = &of->left->gone;
    uint64_t *item = NULL, *spare = NULL, *sorted = NULL;
    size_t n = 0;
    enum status status = list_told(of, &item, &spare, &sorted, &n);
    if (!status) status = told_new(told, n, of->run->scratch.head.tells_normals);
    for (size_t i = 0; !status && i < n; i++) {
        size_t place = radix_value(sorted[i]), pass = 0;
        while (place >= gone->end[pass]) pass++;
        told->id[i] = radix_key(sorted[i]);
        told->key[i] = gone_key(of->left->passes, pass, gone->cost[place]);
        if (told->normal) told->normal[i] = told_normal_of(of->part->normal[gone->id[place]]);
    }
    free(item), free(spare);
    return status ? run_no_memory(of->run) : STATUS_OK;
}

typedef void put_points(struct sink *sink, const struct found *of);

static enum status save(const char *name, put_points *put, const struct found *of) {
    const struct running *run = of->run;
    char path[SCRATCH_PATH_BYTES];
    struct file_out file;
    struct sink sink;
    scratch_path(path, run->folder, name, run->tile);
    enum status status = file_out_begin(&file, path, run->error);
    if (status) return status;
    status = sink_init(&sink, file.fd);
    if (!status) put(&sink, of);
    status = sink_done(&sink, status, run->error);
    if (!status) status = scratch_seal(file.fd, path, run->error);
    if (status)
        file_out_abort(&file);
    else
        status = file_out_commit(&file, 1, run->error);
    return status;
}

static enum status contract_tile(const struct running *run, struct part *part, struct contract_left *left) {
    const struct scratch_head *head = &run->scratch.head;
    const struct contract_part some = {.threads = part->threads,
                                       .length_bias = head->length_bias,
                                       .passes = head->passes,
                                       .limit = run->scratch.limit,
                                       .keeps_gone = head->ranks_all || head->told_key || fit_is_spaced(&head->params)};
    enum status status = contract_some(part->points.point, &part->near, part->quadrics, &some, run->progress, left);
    if (status == STATUS_CANCELLED) error_set(run->error, status, "tiles", "cancelled");
    return status == STATUS_NO_MEMORY ? run_no_memory(run) : status;
}

static enum status run_tile(struct running *run, unsigned threads) {
    const struct scratch *s = &run->scratch;
    const struct grid_tile *tile = &s->tile[run->tile];
    struct scratch_points points = {0};
    struct part part = {.params = &s->head.params, .threads = threads};
    struct part_whole whole = {s->head.whole, s->head.noisy, s->head.average, s->head.length_bias, 0};
    struct contract_left left = {0};
    double spacing;
    if (grid_from(&run->grid, s->head.anchor, s->head.level, s->cell, s->head.cells) ||
        grid_spacing(&run->grid, tile, SPARSE, &spacing))
        return run_no_memory(run);
    enum status status = scratch_gather(run->folder, s, &run->grid, tile, s->head.reach * spacing, s->head.room,
                                        threads, &points, run->error);
    if (!status) status = part_make(&part, &points, false, &whole, run->progress, run->error);
    if (status == STATUS_CANCELLED) error_set(run->error, status, "tiles", "cancelled");
    if (!status) status = contract_tile(run, &part, &left);
    bool tells_gone = s->head.ranks_all || fit_is_spaced(&s->head.params);
    struct told told = {0};
    struct found found = {run, &part, &points, &left, status ? NULL : alloc_array(left.n, sizeof *found.place), &told};
    if (!status && !found.place) status = run_no_memory(run);
    if (!status && s->head.told_key) status = make_told(&found, &told);
    if (!status && tells_gone) status = save("gone", put_gone, &found);
    if (!status) status = save("left", put_left, &found); /* which says that the tile is done */
    free(found.place);
    told_done(&told);
    contract_left_done(&left);
    part_done(&part);
    scratch_points_done(&points);
    return status;
}

/* Where room is short the width is less, so these may be more than are read. */
static enum status find_around(struct running *run, bool *is_read) {
    const struct scratch *s = &run->scratch;
    const struct grid_tile *tile = &s->tile[run->tile];
    double spacing;
    if (grid_from(&run->grid, s->head.anchor, s->head.level, s->cell, s->head.cells) ||
        grid_spacing(&run->grid, tile, SPARSE, &spacing))
        return run_no_memory(run);
    for (size_t t = 0; t < s->head.tiles; t++)
        is_read[t] = scratch_touches(s, &run->grid, tile, s->head.reach * spacing, t);
    return STATUS_OK;
}

enum status tiles_around(const char *folder, size_t tile, bool *is_read, struct error *error) {
    struct running run = {.folder = folder, .tile = tile, .error = error};
    enum status status = scratch_load(folder, &run.scratch, error);
    if (!status) status = find_around(&run, is_read);
    grid_done(&run.grid);
    scratch_done(&run.scratch);
    return status;
}

bool tiles_is_done(const char *folder, size_t tile) { return scratch_has(folder, "left", tile); }

enum status tiles_run(const char *folder, size_t tile, unsigned threads, const struct progress *progress,
                      struct error *error) {
    struct running run = {.folder = folder, .tile = tile, .progress = progress, .error = error};
    enum status status = scratch_load(folder, &run.scratch, error);
    if (!status && tile >= run.scratch.head.tiles)
        status = error_set(error, STATUS_BAD_PARAMETER, "tile", "%zu: the plan has tiles 0 to %" PRIu64, tile,
                           run.scratch.head.tiles - 1);
    if (!status && !scratch_has(folder, "left", tile)) {
        struct par_team *team = par_team_new();
        status = team ? run_tile(&run, threads) : run_no_memory(&run);
        par_team_free(team);
    }
    grid_done(&run.grid);
    scratch_done(&run.scratch);
    return status;
}
