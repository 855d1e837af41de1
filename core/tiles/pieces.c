/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/tiles/pieces.h"

#include <stdlib.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/base/par.h"

struct taking {
    const struct pieces *pieces;
    unsigned char *record; /* PIECES_MOST_POINTS; owned, as the next two */
    vec3 *point, *next;    /* PIECES_MOST_POINTS each */
    size_t count, next_count;
    size_t tile;    /* that is read */
    uint64_t first; /* of the tile, that is read next */
    struct scratch_check check;
    enum status status, next_status; /* of taking, of reading */
};

static enum status read_piece(struct taking *t) {
    const struct pieces *pieces = t->pieces;
    const struct scratch_coding *coding = &pieces->scratch->head.coding;
    const struct ordered_points *frame = &pieces->scratch->head.whole;
    const struct grid_tile *tile = &pieces->scratch->tile[t->tile];
    size_t each = scratch_record_bytes(coding);
    uint64_t left = tile->points - t->first;
    size_t n = left < PIECES_MOST_POINTS ? (size_t)left : PIECES_MOST_POINTS;
    char path[SCRATCH_PATH_BYTES];
    if (t->first == 0) t->check = (struct scratch_check){pieces->scratch, tile->first, 0, 0};
    int fd = scratch_open_file(pieces->folder, "points", t->tile, path);
    bool is_short = scratch_ends_before(fd, (t->first + n) * each);
    enum status status =
        is_short ? STATUS_OK : scratch_read(fd, t->record, n * each, t->first * each, path, pieces->error);
    if (fd >= 0) close(fd);
    if (!status && (is_short || !scratch_check_next(&t->check, t->record, n)))
        status = scratch_damaged(pieces->folder, "points", t->tile, pieces->error);
    for (size_t i = 0; !status && i < n; i++) {
        uint32_t id;
        t->next[i] = order_in_frame(frame, scratch_decode(coding, t->record + i * each, &id));
    }
    t->next_count = n;
    t->first += n;
    if (t->first < tile->points) return status;
    t->first = 0;
    t->tile++;
    return status;
}

static void read_next(void *ctx) {
    struct taking *t = ctx;
    t->next_count = 0;
    if (t->tile < t->pieces->scratch->head.tiles) t->next_status = read_piece(t);
}

static void take_piece(void *ctx) {
    struct taking *t = ctx;
    if (t->count) t->status = t->pieces->take(t->pieces->ctx, t->point, t->count);
}

static enum status take_all(struct taking *t) {
    const struct pieces *pieces = t->pieces;
    read_next(t);
    while (!t->next_status && t->next_count) {
        vec3 *point = t->point;
        t->point = t->next, t->next = point;
        t->count = t->next_count;
        par_beside(pieces->threads, take_piece, read_next, t);
        if (t->status) return t->status;
        double done = (double)t->tile / (double)pieces->scratch->head.tiles;
        if (pieces->tick(pieces->ctx, done)) return STATUS_CANCELLED;
    }
    return t->next_status;
}

enum status pieces_take(const struct pieces *pieces) {
    struct taking t = {.pieces = pieces,
                       .record = alloc_array(PIECES_MOST_POINTS, scratch_record_bytes(&pieces->scratch->head.coding)),
                       .point = alloc_array(PIECES_MOST_POINTS, sizeof *t.point),
                       .next = alloc_array(PIECES_MOST_POINTS, sizeof *t.next)};
    enum status status = t.record && t.point && t.next ? take_all(&t) : STATUS_NO_MEMORY;
    free(t.record), free(t.point), free(t.next);
    return status;
}
