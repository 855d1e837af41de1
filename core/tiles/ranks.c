/* Keys are of 64 bits, so the one that so many points are below shows digit by digit, by counting.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/tiles/ranks.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/io/out/file_out.h"

enum { PIECE = 1 << 15, DIGITS = 3, MOST_BITS = 22, ID_KEY_BYTES = 4 };
static const unsigned digit_bits[DIGITS] = {MOST_BITS, 21, 21};

static enum status ranks_no_memory(const struct ranks *ranks) {
    return error_set(ranks->error, STATUS_NO_MEMORY, "tiles", "not enough memory to rank what is kept");
}

/* ------------------------------------------------------------------------------------------------ what has gone */

static enum status check_gone(const struct ranks *ranks, const struct gone_head *head, size_t tile, const char *path) {
    if (memcmp(head->mark, GONE_MARK, sizeof head->mark) == 0 && head->count <= ranks->scratch->tile[tile].points &&
        head->passes == ranks->scratch->head.passes)
        return STATUS_OK;
    return error_set(ranks->error, STATUS_MALFORMED, "tiles", "%s is damaged", path);
}

enum status ranks_read_gone(const struct ranks *ranks, size_t tile, ranks_take *take, void *ctx) {
    struct gone_item *piece = alloc_array(PIECE, sizeof *piece);
    char path[SCRATCH_PATH_BYTES];
    struct gone_head head = {0};
    int fd = scratch_open_file(ranks->folder, "gone", tile, path);
    enum status status = piece ? STATUS_OK : ranks_no_memory(ranks);
    if (!status && fd < 0)
        status = error_set(ranks->error, STATUS_IO, "tiles", "can't open %s: %s", path, strerror(errno));
    if (!status) status = scratch_read(fd, &head, sizeof head, 0, path, ranks->error);
    if (!status) status = check_gone(ranks, &head, tile, path);
    uint64_t from = sizeof head + head.passes * sizeof(float);
    for (uint64_t i = 0; !status && i < head.count; i += PIECE) {
        size_t n = head.count - i < PIECE ? (size_t)(head.count - i) : PIECE;
        status = scratch_read(fd, piece, n * sizeof *piece, from + i * sizeof *piece, path, ranks->error);
        for (size_t k = 0; !status && k < n; k++) take(ctx, piece[k]);
    }
    if (fd >= 0) close(fd);
    free(piece);
    return status;
}

static enum status read_all_gone(const struct ranks *ranks, ranks_take *take, void *ctx) {
    enum status status = STATUS_OK;
    for (size_t t = 0; !status && t < ranks->scratch->head.tiles; t++) status = ranks_read_gone(ranks, t, take, ctx);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the last one */

struct counting_keys {
    unsigned shift, bits; /* of the digit that is counted */
    uint64_t above;       /* the digits that are known, in their places */
    uint64_t *of;         /* by digit; owned */
};

static void count_key(void *ctx, struct gone_item item) {
    struct counting_keys *c = ctx;
    uint64_t key = whole_key(item.key, item.id);
    unsigned end = c->shift + c->bits;
    if (end < 64 && key >> end != c->above >> end) return;
    c->of[key >> c->shift & (((uint64_t)1 << c->bits) - 1)]++;
}

/* The error that the contractions of a pass have come to. */
static enum status error_of_pass(const struct ranks *ranks, uint64_t pass, float *error_made) {
    enum status status = STATUS_OK;
    *error_made = 0;
    for (size_t t = 0; !status && t < ranks->scratch->head.tiles; t++) {
        char path[SCRATCH_PATH_BYTES];
        float error = 0;
        int fd = scratch_open_file(ranks->folder, "gone", t, path);
        if (fd < 0) return error_set(ranks->error, STATUS_IO, "tiles", "can't open %s: %s", path, strerror(errno));
        status =
            scratch_read(fd, &error, sizeof error, sizeof(struct gone_head) + pass * sizeof error, path, ranks->error);
        close(fd);
        if (error > *error_made) *error_made = error;
    }
    return status;
}

enum status ranks_find_last(const struct ranks *ranks, uint64_t kept, uint64_t *last, float *error_made) {
    *last = UINT64_MAX;
    *error_made = 0;
    if (kept >= ranks->left_count + ranks->gone_count) return STATUS_OK;
    if (kept <= ranks->left_count) {
        *last = whole_key((uint32_t)kept - 1, ranks->left[kept - 1]);
        return STATUS_OK;
    }
    uint64_t wanted = kept - ranks->left_count; /* the last is so many-th of those that share the digits above */
    struct counting_keys c = {.shift = 64, .of = alloc_array(1 << MOST_BITS, sizeof *c.of)};
    enum status status = c.of ? STATUS_OK : ranks_no_memory(ranks);
    for (unsigned digit = 0; !status && digit < DIGITS; digit++) {
        c.bits = digit_bits[digit];
        c.shift -= c.bits;
        memset(c.of, 0, sizeof *c.of << MOST_BITS);
        status = read_all_gone(ranks, count_key, &c);
        uint64_t d = 0;
        while (!status && d + 1 < (uint64_t)1 << c.bits && c.of[d] < wanted) wanted -= c.of[d++];
        c.above |= d << c.shift;
    }
    free(c.of);
    if (status) return status;
    *last = c.above;
    return error_of_pass(ranks, gone_pass(ranks->scratch->head.passes, (uint32_t)(*last >> 32)), error_made);
}

/* ------------------------------------------------------------------------------------------------ writing */

/* Keys of the points first .. first + count - 1 of the input, NONE of those that aren't kept. */
struct span {
    uint64_t first, count, last;
    uint32_t *key; /* owned */
};

static void note_key(struct span *span, uint32_t key, uint32_t id) {
    if (id >= span->first && id - span->first < span->count && whole_key(key, id) <= span->last)
        span->key[id - span->first] = key;
}

static void note_gone(void *ctx, struct gone_item item) { note_key(ctx, item.key, item.id); }

static enum status fill(const struct ranks *ranks, struct span *span) {
    memset(span->key, -1, span->count * sizeof *span->key);
    for (size_t i = 0; i < ranks->left_count; i++) note_key(span, (uint32_t)i, ranks->left[i]);
    return ranks->gone_count && span->last >> 32 >= GONE_FIRST ? read_all_gone(ranks, note_gone, span) : STATUS_OK;
}

/* Half of the memory is for keys. */
static enum status make_span(const struct ranks *ranks, uint64_t last, struct span *span) {
    const struct scratch_head *head = &ranks->scratch->head;
    uint64_t most = head->params.memory_bytes / 2 / ID_KEY_BYTES;
    if (most < PIECE) most = PIECE;
    *span = (struct span){.count = head->points < most ? head->points : most, .last = last};
    span->key = alloc_array(span->count, sizeof *span->key);
    return span->key ? STATUS_OK : ranks_no_memory(ranks);
}

static enum status put_part(const struct ranks *ranks, const struct cloud *part, uint64_t first, struct span *span,
                            struct sink *sink, uint64_t *written) {
    for (size_t i = 0; i < part->count; i++) {
        uint64_t id = first + i;
        if (id - span->first >= span->count) {
            span->first = id;
            enum status status = fill(ranks, span);
            if (status) return status;
        }
        uint32_t key = span->key[id - span->first];
        if (key == NONE) continue;
        kept_put(sink, whole_key(key, (uint32_t)id), part->position[i], part->record + i * part->record_bytes,
                 part->record_bytes);
        ++*written;
    }
    return STATUS_OK;
}

static enum status put_kept(const struct ranks *ranks, uint64_t last, struct cloud_stream *stream,
                            const struct kept_file *file, struct sink *sink) {
    struct kept_head head = {
        .mark = KEPT_MARK, .count = file->count, .record_bytes = file->record_bytes, .of = ranks->scratch->hash};
    struct span span;
    enum status status = make_span(ranks, last, &span);
    uint64_t first = 0, written = 0;
    if (!status) status = fill(ranks, &span);
    sink_bytes(sink, &head, sizeof head);
    while (!status) {
        const struct cloud *part;
        status = cloud_stream_next(stream, &part, ranks->error);
        if (status || part->count == 0) break;
        status = put_part(ranks, part, first, &span, sink, &written);
        first += part->count;
        if (!status && progress_tick(ranks->progress, "gather", 0.6 + 0.4 * cloud_stream_fraction(stream)))
            status = STATUS_CANCELLED;
    }
    free(span.key);
    if (!status && written != file->count)
        status = error_set(ranks->error, STATUS_IO, "read", "the input has changed while it was read");
    return status;
}

enum status ranks_write(const struct ranks *ranks, uint64_t last, struct cloud_stream *stream,
                        const struct kept_file *file) {
    struct file_out out;
    struct sink sink;
    if (kept_file_is(file, ranks->scratch->hash)) return STATUS_OK;
    enum status status = file_out_begin(&out, file->path, ranks->error);
    if (status) return status;
    status = sink_init(&sink, out.fd);
    if (!status) status = put_kept(ranks, last, stream, file, &sink);
    status = sink_done(&sink, status, ranks->error);
    if (status)
        file_out_abort(&out);
    else
        status = file_out_commit(&out, 1, ranks->error);
    return status;
}
