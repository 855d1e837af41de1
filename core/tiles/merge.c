/* What is left of all tiles, contracted on in memory as if it had been there all the time; then the kept points, read
 * from the input once more.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/base/clock.h"
#include "core/base/hash64.h"
#include "core/base/par.h"
#include "core/base/process_memory.h"
#include "core/base/radix.h"
#include "core/io/build.h"
#include "core/io/formats/las_fields.h"
#include "core/io/stream.h"
#include "core/measure/tangent.h"
#include "core/pipeline/sides.h"
#include "core/spatial/knn.h"
#include "core/tiles/left.h"
#include "core/tiles/pieces.h"
#include "core/tiles/ranks.h"
#include "core/tiles/scratch.h"
#include "core/tiles/spaced.h"
#include "core/tiles/tiles.h"
#include "core/tiles/told.h"

enum { PIECE = 1 << 18, NOTE_BYTES = 96 };

struct merging {
    const char *folder;
    unsigned threads;
    const struct progress *progress;
    struct error *error;
    struct scratch scratch;
    uint64_t count, links, distinct; /* of all tiles */
    float largest;
    struct left_head *head; /* of each tile; owned, as all that follows */
    vec3 *position;         /* in the order of the files */
    uint32_t *id;
    struct ordered_points points; /* along the curve */
    struct packed_quadric *quadrics;
    float (*normal)[3];
    struct adjacency near;
    struct contraction contraction;
    struct spaced spaced;     /* zeroed unless points are chosen by their distance */
    struct told told;         /* the kept ones that aren't left; zeroed unless tiles tell of some */
    float *told_error;        /* of each pass */
    const struct cloud *kept; /* borrowed, once they have been gathered, as their places in the ranking */
    const uint32_t *kept_place;
};

static enum status merge_no_memory(const struct merging *m) {
    return error_set(m->error, STATUS_NO_MEMORY, "tiles", "not enough memory for %" PRIu64 " points that are left",
                     m->count);
}

/* ------------------------------------------------------------------------------------------------ reading */

static int open_left(const struct merging *m, size_t tile, char path[SCRATCH_PATH_BYTES]) {
    return scratch_open_file(m->folder, "left", tile, path);
}

/* Whether what the tiles have written is what they wrote. */
static enum status check_files(const struct merging *m) {
    bool tells_gone = m->scratch.head.ranks_all || fit_is_spaced(&m->scratch.head.params);
    enum status status = STATUS_OK;
    for (size_t t = 0; !status && t < m->scratch.head.tiles; t++) {
        status = scratch_check_seal(m->folder, "left", t, m->error);
        if (!status && tells_gone) status = scratch_check_seal(m->folder, "gone", t, m->error);
    }
    return status;
}

static enum status read_heads(struct merging *m) {
    char path[SCRATCH_PATH_BYTES];
    size_t tiles = m->scratch.head.tiles;
    uint64_t plan = scratch_identity(&m->scratch);
    enum status status = STATUS_OK;
    m->head = alloc_zeroed(tiles, sizeof *m->head);
    if (!m->head) return merge_no_memory(m);
    for (size_t t = 0; !status && t < tiles; t++) {
        struct left_head *head = &m->head[t];
        int fd = open_left(m, t, path);
        if (fd < 0 && errno == ENOENT)
            return error_set(m->error, STATUS_BAD_PARAMETER, "scratch", "tile %zu of %zu isn't done yet", t, tiles);
        if (fd < 0) return error_set(m->error, STATUS_IO, "tiles", "can't open %s: %s", path, strerror(errno));
        bool is_short = scratch_ends_before(fd, sizeof *head);
        if (!is_short) status = scratch_read(fd, head, sizeof *head, 0, path, m->error);
        close(fd);
        if (!status && (is_short || memcmp(head->mark, LEFT_MARK, sizeof head->mark) != 0 || head->plan != plan ||
                        head->count + head->told > m->scratch.tile[t].points))
            status = scratch_damaged(m->folder, "left", t, m->error);
        m->count += head->count;
        m->links += head->links;
        m->distinct += head->distinct;
        if (head->error > m->largest) m->largest = head->error;
    }
    if (!status) status = check_files(m);
    if (!status && (m->count == 0 || m->count >= NONE || m->links >= NONE))
        status = error_set(m->error, STATUS_LIMIT, "tiles", "%" PRIu64 " points are left", m->count);
    return status;
}

static enum status read_positions(struct merging *m) {
    char path[SCRATCH_PATH_BYTES];
    enum status status = STATUS_OK;
    const struct scratch_coding *coding = &m->scratch.head.coding;
    size_t at = 0, each = scratch_record_bytes(coding);
    unsigned char *piece = alloc_array(PIECE, each);
    m->position = alloc_array(m->count, sizeof *m->position);
    m->id = alloc_array(m->count, sizeof *m->id);
    if (!piece || !m->position || !m->id) status = merge_no_memory(m);
    for (size_t t = 0; !status && t < m->scratch.head.tiles; t++) {
        int fd = open_left(m, t, path);
        for (size_t first = 0; !status && first < m->head[t].count; first += PIECE) {
            size_t n = m->head[t].count - first < PIECE ? (size_t)m->head[t].count - first : PIECE;
            status = scratch_read(fd, piece, n * each, sizeof *m->head + first * each, path, m->error);
            for (size_t i = 0; !status && i < n; i++, at++)
                m->position[at] = scratch_decode(coding, piece + i * each, &m->id[at]);
        }
        if (fd >= 0) close(fd);
    }
    free(piece);
    return status;
}

/* Links of the tile whose points begin at `at`, from bytes as the tile has written them to numbers in the input. */
static bool unpack_links(const struct merging *m, size_t tile, size_t at, const uint8_t *degree,
                         const unsigned char *packed, uint32_t *link) {
    const struct left_head *head = &m->head[tile];
    size_t used = 0, made = 0;
    for (uint32_t i = 0; i < head->count; i++)
        for (unsigned k = 0; k < degree[i]; k++, made++) {
            uint32_t to, id;
            size_t n = left_get_link(i, packed + used, head->link_bytes - used, &to, &id);
            if (n == 0 || made == head->links || (to != NONE && to >= head->count)) return false;
            link[made] = to == NONE ? id : m->id[at + to];
            used += n;
        }
    return made == head->links && used == head->link_bytes;
}

/* The quadrics, degrees and links of the tile whose points begin at `at`; each to its point's place along the curve. */
static enum status read_rest_of(struct merging *m, size_t tile, size_t at, size_t link) {
    char path[SCRATCH_PATH_BYTES];
    size_t n = m->head[tile].count;
    uint64_t from = sizeof *m->head + n * scratch_record_bytes(&m->scratch.head.coding);
    struct packed_quadric *own = alloc_array(n, sizeof *own);
    float(*normal)[3] = alloc_array(n, sizeof *normal);
    uint8_t *degree = alloc_array(n, sizeof *degree);
    unsigned char *packed = alloc_array(m->head[tile].link_bytes, 1);
    int fd = open_left(m, tile, path);
    enum status status = own && normal && degree && packed ? STATUS_OK : merge_no_memory(m);
    if (!status) status = scratch_read(fd, own, n * sizeof *own, from, path, m->error);
    from += n * sizeof *own;
    if (!status) status = scratch_read(fd, normal, n * sizeof *normal, from, path, m->error);
    from += n * sizeof *normal;
    if (!status) status = scratch_read(fd, degree, n, from, path, m->error);
    if (!status) status = scratch_read(fd, packed, m->head[tile].link_bytes, from + n, path, m->error);
    if (!status && !unpack_links(m, tile, at, degree, packed, m->near.list + link))
        status = scratch_damaged(m->folder, "left", tile, m->error);
    for (size_t i = 0; !status && i < n; i++) {
        uint32_t p = m->points.distinct[at + i];
        m->quadrics[p] = own[i];
        memcpy(m->normal[p], normal[i], sizeof *normal);
        m->near.start[p] = (uint32_t)link;
        m->near.degree[p] = degree[i];
        link += degree[i];
    }
    if (fd >= 0) close(fd);
    free(own), free(normal), free(degree), free(packed);
    return status;
}

static enum status read_rest(struct merging *m) {
    enum status status = STATUS_OK;
    size_t n = m->points.count, at = 0, link = 0;
    m->quadrics = alloc_array(n, sizeof *m->quadrics);
    m->near = (struct adjacency){.n = n, .capacity = m->links};
    m->near.start = alloc_array(n, sizeof *m->near.start);
    m->near.degree = alloc_array(n, sizeof *m->near.degree);
    m->near.list = alloc_array(m->links, sizeof *m->near.list);
    m->normal = alloc_array(n, sizeof *m->normal);
    if (!m->normal || !m->quadrics || !m->near.start || !m->near.degree || !m->near.list) return merge_no_memory(m);
    for (size_t t = 0; !status && t < m->scratch.head.tiles; t++) {
        status = read_rest_of(m, t, at, link);
        at += m->head[t].count;
        link += m->head[t].links;
    }
    return status;
}

/* ------------------------------------------------------------------------------------------------ links */

/* Points along the curve by their numbers in the input. */
struct directory {
    size_t slots;
    uint32_t *slot; /* owned */
};

static uint32_t input_id(const struct merging *m, uint32_t along) { return m->id[m->points.original[along]]; }

static uint32_t *find(const struct merging *m, const struct directory *d, uint32_t id) {
    size_t s = (size_t)hash64(id) & (d->slots - 1);
    while (d->slot[s] != NONE && input_id(m, d->slot[s]) != id) s = (s + 1) & (d->slots - 1);
    return &d->slot[s];
}

/* From numbers in the input to places along the curve, without those that lead nowhere. */
static enum status join(struct merging *m) {
    struct directory d = {.slots = 1};
    size_t n = m->points.count;
    while (d.slots < 2 * n) d.slots *= 2;
    d.slot = alloc_array(d.slots, sizeof *d.slot);
    if (!d.slot) return merge_no_memory(m);
    memset(d.slot, -1, d.slots * sizeof *d.slot);
    for (size_t p = 0; p < n; p++) *find(m, &d, input_id(m, (uint32_t)p)) = (uint32_t)p;
    for (size_t p = 0; p < n; p++) {
        uint32_t *list = &m->near.list[m->near.start[p]];
        unsigned kept = 0;
        for (unsigned i = 0; i < m->near.degree[p]; i++) {
            uint32_t q = *find(m, &d, list[i]);
            if (q != NONE && q != p) list[kept++] = q;
        }
        m->near.degree[p] = (uint8_t)kept;
    }
    free(d.slot);
    return STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ the kept points */

static size_t levels_of(const struct merging *m) {
    const struct params *params = &m->scratch.head.params;
    return params->levels.count && !fit_ends_in_memory(params) ? params->levels.count : 1;
}

static size_t kept_of(const struct merging *m, size_t level) {
    const struct scratch_head *head = &m->scratch.head;
    const struct params *params = &head->params;
    double ratio = params->levels.count ? params->levels.ratio[level] : params->ratio;
    double wanted = params->points ? (double)params->points : floor(ratio * (double)head->points);
    size_t most = head->ranks_all ? (size_t)m->distinct : m->points.count;
    if (fit_ends_in_memory(params)) wanted = (double)head->wanted;
    if (m->spaced.place) most = m->spaced.count;
    if (m->told.count) most = m->points.count + m->told.count;
    if (wanted < 1) wanted = 1;
    return wanted < (double)most ? (size_t)wanted : most;
}

/* The place along the curve of the i-th of the kept points, which is of those that are left. */
static uint32_t along_of(const struct merging *m, size_t i) {
    return m->contraction.order[m->contraction.n - 1 - (m->spaced.place ? m->spaced.place[i] : i)];
}

/* The number in the input of the i-th of the kept points. */
static uint32_t id_of(const struct merging *m, size_t i) {
    bool has_gone = m->spaced.place && i >= m->spaced.left;
    if (m->told.count && i >= m->points.count) return m->told.id[i - m->points.count];
    return has_gone ? m->spaced.id[i - m->spaced.left] : input_id(m, along_of(m, i));
}

/* Whether normals of the first k kept points are known: of those that are left, and of others where they are told. */
static bool has_normals(const struct merging *m, size_t k) {
    return k <= (m->spaced.place ? m->spaced.left : m->points.count) || m->told.normal;
}

/* Of the i-th kept point. */
static vec3 normal_of(const struct merging *m, size_t i) {
    if (m->told.count && i >= m->points.count) return told_normal_back(&m->told.normal[i - m->points.count]);
    const float *normal = m->normal[along_of(m, i)];
    return (vec3){(double)normal[0], (double)normal[1], (double)normal[2]};
}

static enum status read_told_of(struct merging *m, size_t tile, size_t at) {
    const struct scratch_head *plan = &m->scratch.head;
    const struct left_head *head = &m->head[tile];
    char path[SCRATCH_PATH_BYTES];
    size_t each = scratch_record_bytes(&plan->coding) + sizeof(struct packed_quadric) + sizeof *m->normal + 1;
    size_t n = head->told, errors = plan->passes * sizeof(float),
           from = sizeof *head + head->count * each + head->link_bytes;
    float *error = alloc_array(plan->passes, sizeof *error);
    unsigned char *gaps = alloc_array(head->gap_bytes, 1);
    int fd = open_left(m, tile, path);
    enum status status = error && gaps ? STATUS_OK : merge_no_memory(m);
    if (!status) status = scratch_read(fd, error, errors, from, path, m->error);
    from += errors;
    if (!status) status = scratch_read(fd, m->told.key + at, n * sizeof *m->told.key, from, path, m->error);
    from += n * sizeof *m->told.key;
    if (!status && m->told.normal) {
        status = scratch_read(fd, m->told.normal + at, n * sizeof *m->told.normal, from, path, m->error);
        from += n * sizeof *m->told.normal;
    }
    if (!status) status = scratch_read(fd, gaps, head->gap_bytes, from, path, m->error);
    if (!status && !told_get_ids(gaps, head->gap_bytes, m->told.id + at, n))
        status = scratch_damaged(m->folder, "left", tile, m->error);
    for (size_t p = 0; !status && p < plan->passes; p++)
        if (error[p] > m->told_error[p]) m->told_error[p] = error[p];
    if (fd >= 0) close(fd);
    free(error), free(gaps);
    return status;
}

/* The kept points that aren't left, the most important first. */
static enum status read_told(struct merging *m) {
    const struct scratch_head *plan = &m->scratch.head;
    size_t n = 0, at = 0;
    for (size_t t = 0; t < plan->tiles; t++) n += m->head[t].told;
    m->told_error = alloc_zeroed(plan->passes, sizeof *m->told_error);
    if (told_new(&m->told, n, plan->tells_normals) || !m->told_error) return merge_no_memory(m);
    for (size_t t = 0; t < plan->tiles; t++) {
        enum status status = read_told_of(m, t, at);
        if (status) return status;
        at += m->head[t].told;
    }
    size_t left = m->points.count, kept = kept_of(m, 0);
    return told_rank(&m->told, kept > left ? kept - left : 0, m->threads) ? merge_no_memory(m) : STATUS_OK;
}

/* What the whole input says of its points, with room for n; the plan knows what is known at its end. */
static enum status describe(const struct scratch *plan, const struct cloud *from, size_t n, struct cloud *to) {
    *to = (struct cloud){.property_count = from->property_count,
                         .record_bytes = from->record_bytes,
                         .form = from->form,
                         .xyz = {from->xyz[0], from->xyz[1], from->xyz[2]}};
    to->property = alloc_zeroed(from->property_count, sizeof *to->property); /* without lists, until it is whole */
    to->position = alloc_array(n, sizeof *to->position);
    to->record = alloc_array(n, from->record_bytes);
    if (from->comments) to->comments = alloc_array(strlen(from->comments) + 1, 1);
    if (plan->head.left_out_bytes) to->left_out = alloc_array(plan->head.left_out_bytes, 1);
    if (from->las) to->las = alloc_array(1, sizeof *to->las + from->las->records_bytes);
    if (plan->head.views) to->view = alloc_array(plan->head.views, sizeof *to->view);
    bool room = to->property && to->position && to->record && (!from->comments || to->comments) &&
                (!plan->head.left_out_bytes || to->left_out) && (!from->las || to->las) &&
                (!plan->head.views || to->view);
    if (!room) {
        cloud_done(to);
        return STATUS_NO_MEMORY;
    }
    memcpy(to->property, from->property, from->property_count * sizeof *to->property);
    if (to->comments) memcpy(to->comments, from->comments, strlen(from->comments) + 1);
    if (to->left_out) memcpy(to->left_out, plan->left_out, plan->head.left_out_bytes);
    if (to->las) memcpy(to->las, from->las, sizeof *to->las + from->las->records_bytes);
    if (to->view) memcpy(to->view, plan->view, plan->head.views * sizeof *to->view);
    to->view_count = plan->head.views;
    return STATUS_OK;
}

static enum status reopen_input(const struct merging *m, struct cloud_stream **stream) {
    size_t n = m->scratch.head.inputs;
    const char **path = alloc_array(n, sizeof *path);
    const struct params *params = &m->scratch.head.params;
    bool given = strncmp(m->folder, TILES_GIVEN, sizeof TILES_GIVEN - 1) == 0;
    const struct cloud_limits limits = {
        .columns = params->columns, .threads = m->threads, .select = params, .scratch = given ? "." : m->folder};
    if (!path) return merge_no_memory(m);
    for (size_t i = 0; i < n; i++) path[i] = m->scratch.input[i].path;
    enum status status = cloud_stream_open(path, n, &limits, stream, m->error);
    free(path);
    return status;
}

/* wanted: n points' numbers in the input, ascending, each with its rank. */
static enum status read_kept(const struct merging *m, struct cloud_stream *stream, const uint64_t *wanted, size_t n,
                             uint32_t *kept, struct cloud *cloud) {
    uint64_t first = 0;
    while (cloud->count < n) {
        const struct cloud *part;
        enum status status = cloud_stream_next(stream, &part, m->error);
        if (status) return status;
        if (part->count == 0) return error_set(m->error, STATUS_IO, "read", "the input has changed while it was read");
        for (; cloud->count < n && radix_key(wanted[cloud->count]) < first + part->count; cloud->count++) {
            size_t from = (size_t)(radix_key(wanted[cloud->count]) - first), to = cloud->count;
            cloud->position[to] = part->position[from];
            memcpy(cloud->record + to * cloud->record_bytes, part->record + from * cloud->record_bytes,
                   cloud->record_bytes);
            kept[radix_value(wanted[to])] = (uint32_t)to;
        }
        first += part->count;
        double fraction = cloud_stream_fraction(stream);
        if (progress_tick(m->progress, "gather", m->told.count ? 0.5 + 0.3 * fraction : 0.7 + 0.3 * fraction))
            return error_set(m->error, STATUS_CANCELLED, "tiles", "cancelled");
    }
    return STATUS_OK;
}

static enum status gather(const struct merging *m, size_t n, struct cloud *cloud, uint32_t **kept) {
    struct cloud_stream *stream = NULL;
    uint64_t *item = alloc_array(n, sizeof *item), *spare = alloc_array(n, sizeof *spare), *sorted = item;
    *kept = alloc_array(n, sizeof **kept);
    enum status status = item && spare && *kept ? STATUS_OK : merge_no_memory(m);
    for (size_t i = 0; !status && i < n; i++) item[i] = radix_item(id_of(m, i), (uint32_t)i);
    if (!status) sorted = radix_sort(item, spare, n, m->threads);
    if (!status) status = reopen_input(m, &stream);
    if (!status && describe(&m->scratch, cloud_stream_cloud(stream), n, cloud)) status = merge_no_memory(m);
    if (!status) status = read_kept(m, stream, sorted, n, *kept, cloud);
    cloud_stream_free(stream);
    free(item), free(spare);
    return status;
}

static enum status note_dropped(const struct merging *m, struct cloud *cloud) {
    char note[NOTE_BYTES];
    snprintf(note, sizeof note, "%" PRIu64 " points without a position (a coordinate is nan or infinite)",
             m->scratch.head.dropped);
    return cloud_leave_out(cloud, note) ? merge_no_memory(m) : STATUS_OK;
}

/* ------------------------------------------------------------------------------------------------ distances */

/* The planes at the k points that are kept, along the curve. */
static enum status find_planes(const struct merging *m, size_t k, vec3 *point, vec3 *normal) {
    uint64_t *item = alloc_array(k, sizeof *item), *spare = alloc_array(k, sizeof *spare), *sorted;
    if (item && spare) {
        for (size_t i = 0; i < k; i++) item[i] = radix_item(along_of(m, i), 0);
        sorted = radix_sort(item, spare, k, m->threads);
        for (size_t i = 0; i < k; i++) {
            uint32_t p = radix_key(sorted[i]);
            point[i] = m->points.point[p];
            normal[i] = (vec3){(double)m->normal[p][0], (double)m->normal[p][1], (double)m->normal[p][2]};
        }
    }
    bool room = item && spare;
    free(item), free(spare);
    return room ? STATUS_OK : STATUS_NO_MEMORY;
}

/* The same where some of them aren't left, of the points that have been gathered. */
static enum status find_told_planes(const struct merging *m, size_t k, vec3 *point, vec3 *normal) {
    struct ordered_points along = {0};
    for (size_t i = 0; i < k; i++) point[i] = m->kept->position[m->kept_place[i]];
    enum status status = order_points_of(&m->scratch.head.whole, point, k, m->threads, &along);
    for (size_t i = 0; !status && i < along.count; i++) {
        point[i] = along.point[i];
        normal[i] = normal_of(m, along.original[i]);
    }
    if (!status && along.count != k)
        status = error_set(m->error, STATUS_ENGINE, "tiles", "%zu kept points are in two tiles", k - along.count);
    ordered_points_done(&along);
    return status;
}

struct measuring {
    const struct merging *m;
    struct tangent_planes planes;
    struct distance_sum sum;
};

static enum status measure_piece(void *ctx, const vec3 *point, size_t n) {
    struct measuring *s = ctx;
    return tangent_add(&s->planes, point, n, s->m->threads, &s->sum);
}

static int measure_tick(void *ctx, double fraction) {
    const struct merging *m = ((struct measuring *)ctx)->m;
    return progress_tick(m->progress, "measure", (m->kept ? 0.8 : 0.5) + 0.2 * fraction);
}

/* The distance of every point of the input to the tangent plane at the nearest of k kept ones, in the input's units. */
static enum status measure_kept(const struct merging *m, size_t k, struct distance_stats *stats) {
    struct knn *knn = NULL;
    vec3 *kept = alloc_array(k, sizeof *kept), *normal = alloc_array(k, sizeof *normal);
    struct measuring s = {.m = m};
    const struct pieces pieces = {m->folder, &m->scratch, m->threads, measure_piece, measure_tick, &s, m->error};
    enum status status = kept && normal ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) status = m->kept ? find_told_planes(m, k, kept, normal) : find_planes(m, k, kept, normal);
    if (!status) status = knn_new(kept, k, m->threads, &knn, NULL);
    s.planes = (struct tangent_planes){knn, kept, normal};
    if (!status) status = pieces_take(&pieces);
    knn_free(knn);
    free(kept), free(normal);
    if (status == STATUS_NO_MEMORY) return merge_no_memory(m);
    *stats = distance_sum_stats(&s.sum, m->scratch.head.whole.scale);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the whole */

static int contract_tick(void *ctx, const char *stage, double fraction) {
    return progress_tick(ctx, stage, 0.2 + 0.3 * fraction);
}

static enum status finish(struct merging *m) {
    const struct scratch_head *head = &m->scratch.head;
    const struct contract_options options = {m->threads, 1};
    const struct progress progress = {contract_tick, (void *)(uintptr_t)m->progress};
    enum status status = read_heads(m);
    if (!status && progress_tick(m->progress, "join", 0)) return STATUS_CANCELLED;
    if (!status) status = read_positions(m);
    if (!status && order_points_of(&head->whole, m->position, m->count, m->threads, &m->points))
        status = merge_no_memory(m);
    free(m->position);
    m->position = NULL;
    alloc_give_back();
    if (!status && m->points.count != m->count)
        status = error_set(m->error, STATUS_ENGINE, "tiles", "%" PRIu64 " points are in two tiles",
                           m->count - m->points.count);
    if (!status) status = read_rest(m);
    if (!status) status = join(m);
    if (!status) {
        status = contract_rest(m->points.point, &m->near, m->quadrics, head->length_bias, m->largest, &options,
                               &progress, &m->contraction);
        if (status == STATUS_NO_MEMORY) merge_no_memory(m);
    }
    free(m->quadrics);
    m->quadrics = NULL;
    alloc_give_back();
    return status;
}

/* Leaves points that are far enough from each other, and what has gone where there is room between them. */
static enum status keep_apart(struct merging *m) {
    const struct scratch_head *head = &m->scratch.head;
    const struct params *params = &head->params;
    size_t n = m->points.count, enough = fit_is_spaced_alone(params) ? SIZE_MAX : (size_t)fmax(1, (double)head->wanted);
    free(m->id); /* which is read again with the positions */
    enum status status = read_positions(m);
    vec3 *position = alloc_array(n, sizeof *position);
    uint32_t *left = alloc_array(n, sizeof *left);
    const struct ranks ranks = {m->folder, &m->scratch, left, n, m->distinct - n, m->progress, m->error};
    if (!status && (!position || !left)) status = merge_no_memory(m);
    for (size_t i = 0; !status && i < n; i++) {
        uint32_t along = along_of(m, i);
        position[i] = m->position[m->points.original[along]];
        left[i] = input_id(m, along);
    }
    free(m->position);
    m->position = NULL;
    size_t most = (size_t)(FIT_LEFT * (double)head->room / FIT_MORE_THAN_KEPT), room = (size_t)head->room / 2;
    if (room > 2 * head->tile_points) room = (size_t)(2 * head->tile_points);
    if (!status) status = spaced_keep(&ranks, position, enough, most, room, m->threads, &m->spaced);
    free(position), free(left);
    return status;
}

static enum status measure_levels(const struct merging *m, struct pipeline_result *result) {
    enum status status = STATUS_OK;
    bool all = true;
    if (fit_ends_in_memory(&m->scratch.head.params)) return STATUS_OK; /* which measures more */
    for (size_t i = 0; !status && i < levels_of(m); i++) {
        bool measured = has_normals(m, kept_of(m, i));
        if (measured) status = measure_kept(m, kept_of(m, i), &result->report.level[i].tangent);
        all &= measured;
    }
    if (!all && !m->scratch.head.ranks_all)
        left_out_add(&result->report.left_out, "report",
                     "distances to the kept points, some of which no tile had left");
    return status;
}

static enum status measure_stage(const struct merging *m, struct pipeline_result *result) {
    double start_ms = clock_exact_ms();
    enum status status = measure_levels(m, result);
    if (!status) report_add_stage(&result->report, "measure", clock_exact_ms() - start_ms);
    return status;
}

/* The largest of the contractions that so many kept points are left of. */
static double largest_error(const struct merging *m, size_t kept) {
    size_t first = kept; /* in the ranking, of those that aren't kept */
    if (m->spaced.place && kept < m->spaced.left) first = m->spaced.place[kept];
    if (m->spaced.place && first > m->spaced.first_not_kept) first = m->spaced.first_not_kept;
    if (m->told.count && kept > m->points.count)
        return (double)m->told_error[gone_pass(m->scratch.head.passes, m->told.key[kept - m->points.count - 1])];
    return first < m->contraction.n ? (double)m->contraction.error[m->contraction.n - 1 - first] : (double)m->largest;
}

static void report_levels(const struct merging *m, struct pipeline_result *result) {
    const struct scratch_head *head = &m->scratch.head;
    struct report *report = &result->report;
    result->level_count = levels_of(m);
    report->level_count = result->level_count;
    for (size_t i = 0; i < result->level_count; i++) {
        size_t kept = kept_of(m, i);
        result->level[i].kept_count = kept;
        report->level[i].points_out = kept;
        report->level[i].ratio = (double)kept / (double)head->points;
        report->level[i].contraction_error = largest_error(m, kept) * head->whole.scale;
    }
    report->points_in = head->points;
    report->points_cropped = head->selection.cropped;
    report->points_filtered = head->selection.filtered;
    report->points_distinct = m->distinct;
    report->diagonal = head->whole.diagonal;
    report->noise_level = head->noise * head->whole.scale;
    if (m->spaced.place)
        report->spacing = (struct report_spacing){head->params.spacing, m->spaced.count, !m->spaced.is_all};
    memcpy(report->box_min, &head->whole.box_min, sizeof report->box_min);
    memcpy(report->box_max, &head->whole.box_max, sizeof report->box_max);
}

static void left_done(struct merging *m) {
    free(m->head), free(m->position), free(m->id), free(m->quadrics), free(m->normal), free(m->told_error);
    m->told_error = NULL;
    told_done(&m->told);
    m->head = NULL, m->position = NULL, m->id = NULL, m->quadrics = NULL, m->normal = NULL;
    ordered_points_done(&m->points);
    adjacency_done(&m->near);
    contraction_done(&m->contraction);
    spaced_done(&m->spaced);
    alloc_give_back();
}

/* The kept points' normals as the tiles found them, turned by what the kept points show; what is left is freed. */
static enum status turn_normals(struct merging *m, const struct cloud *cloud, struct pipeline_result *made) {
    vec3 *normal = alloc_array(cloud->count, sizeof *normal);
    if (!normal) return merge_no_memory(m);
    for (size_t i = 0; i < cloud->count; i++) normal[made->kept[i]] = normal_of(m, i);
    left_done(m);
    enum status status =
        sides_of_normals(cloud, &m->scratch.head.params, m->threads, normal, &made->normal, &made->report, m->error);
    free(normal);
    return status;
}

/* The same where more is made of the kept points: by what planes distances to them are measured then. */
static enum status hand_on_normals(const struct merging *m, size_t n, struct pipeline_result *made) {
    if (!has_normals(m, n)) return STATUS_OK;
    made->facing = alloc_array(n, sizeof *made->facing);
    if (!made->facing) return merge_no_memory(m);
    for (size_t i = 0; i < n; i++) {
        vec3 normal = normal_of(m, i);
        float *to = made->facing[made->kept[i]];
        to[0] = (float)normal.x, to[1] = (float)normal.y, to[2] = (float)normal.z;
    }
    return STATUS_OK;
}

static void merging_done(struct merging *m) {
    left_done(m);
    scratch_done(&m->scratch);
}

/* ------------------------------------------------------------------------------------------------ beyond memory */

static enum status name_kept(const struct merging *m, size_t kept, struct kept_file *file) {
    char path[SCRATCH_PATH_BYTES];
    const struct scratch_head *head = &m->scratch.head;
    scratch_path(path, m->folder, "kept", 0);
    uint64_t room = fit_tileset_room(&head->params, head->record_bytes), tiles = 2 * head->tile_points;
    *file = (struct kept_file){.path = alloc_array(strlen(path) + 1, 1),
                               .count = kept,
                               .record_bytes = head->record_bytes,
                               .most_points = room < tiles ? room : tiles};
    if (!file->path) return merge_no_memory(m);
    memcpy(file->path, path, strlen(path) + 1);
    return STATUS_OK;
}

/* The kept points into the file; what was left is freed. */
static enum status gather_beyond(struct merging *m, struct cloud *cloud, struct kept_file *file,
                                 struct pipeline_result *made) {
    struct cloud_stream *stream = NULL;
    size_t n = m->points.count, kept = kept_of(m, 0);
    uint32_t *left = alloc_array(n, sizeof *left);
    const struct ranks ranks = {m->folder, &m->scratch, left, n, m->distinct - n, m->progress, m->error};
    uint64_t last = 0;
    float error_made = 0;
    enum status status = left ? name_kept(m, kept, file) : merge_no_memory(m);
    for (size_t i = 0; !status && i < n; i++) left[i] = input_id(m, m->contraction.order[n - 1 - i]);
    if (!status) status = ranks_find_last(&ranks, kept, &last, &error_made);
    if (!status && kept > n) {
        made->report.level[0].contraction_error = (double)error_made * m->scratch.head.whole.scale;
        left_out_add(&made->report.left_out, "report", "distances to the kept points, which don't fit into memory");
    }
    left_done(m);
    if (!status) status = reopen_input(m, &stream);
    if (!status && describe(&m->scratch, cloud_stream_cloud(stream), 0, cloud)) status = merge_no_memory(m);
    if (!status) status = ranks_write(&ranks, last, stream, file);
    cloud_stream_free(stream);
    free(left);
    return status;
}

void tiles_kept_remove(struct kept_file *file) {
    if (file->path) unlink(file->path);
    kept_file_done(file);
}

/* ------------------------------------------------------------------------------------------------ merge */

enum status tiles_merge(const char *folder, unsigned threads, const struct progress *progress, struct cloud *cloud,
                        struct kept_file *file, struct pipeline_result *result, struct error *error) {
    struct merging m = {.folder = folder, .threads = threads, .progress = progress, .error = error};
    struct pipeline_result made = {0};
    struct cloud kept = {0};
    struct kept_file written = {0};
    double start_ms = clock_exact_ms();
    struct par_team *team = par_team_new();
    enum status status = team ? scratch_load(folder, &m.scratch, error) : merge_no_memory(&m);
    if (!status) status = scratch_check_inputs(&m.scratch, "when tiles were planned", error);
    if (!status) status = finish(&m);
    if (!status && fit_is_spaced(&m.scratch.head.params)) status = keep_apart(&m);
    if (!status && m.scratch.head.told_key) status = read_told(&m);
    if (!status) report_add_stage(&made.report, "merge", clock_exact_ms() - start_ms);
    if (!status && !m.told.count) status = measure_stage(&m, &made);
    double gather_ms = clock_exact_ms();
    if (!status) report_levels(&m, &made);
    if (!status)
        status = m.scratch.head.ranks_all ? gather_beyond(&m, &kept, &written, &made)
                                          : gather(&m, kept_of(&m, 0), &kept, &made.kept);
    if (!status) status = scratch_check_inputs(&m.scratch, "before it was read", error);
    if (!status) report_add_stage(&made.report, "gather", clock_exact_ms() - gather_ms);
    m.kept = &kept, m.kept_place = made.kept;
    if (!status && m.told.count) status = measure_stage(&m, &made);
    bool ends = fit_ends_in_memory(&m.scratch.head.params);
    if (!status && ends) status = hand_on_normals(&m, kept.count, &made);
    bool turns = m.scratch.head.params.normals == SWITCH_TRUE && !ends;
    if (!status && turns) status = turn_normals(&m, &kept, &made);
    if (!status && m.scratch.head.dropped) status = note_dropped(&m, &kept);
    par_team_free(team);
    if (status == STATUS_CANCELLED) error_set(error, status, "tiles", "cancelled");
    if (!status) {
        snprintf(made.report.format, sizeof made.report.format, "%s", kept.form);
        made.report.total_ms = clock_exact_ms() - start_ms;
        made.report.peak_rss_bytes = process_peak_bytes(0);
        *cloud = kept;
        *file = written;
        *result = made;
    } else {
        cloud_done(&kept);
        kept_file_done(&written);
        pipeline_result_done(&made);
    }
    merging_done(&m);
    return status;
}

/* ------------------------------------------------------------------------------------------------ removal */

static bool is_ours(const char *name) {
    static const char *const names[] = {"plan",   "points.",  "left.",  "gone.",  "kept.", "raw.",
                                        ".plan.", ".points.", ".left.", ".gone.", ".kept."};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++)
        if (i == 0 ? strcmp(name, names[i]) == 0 : strncmp(name, names[i], strlen(names[i])) == 0) return true;
    return false;
}

void tiles_remove(const char *folder) {
    DIR *entries = opendir(folder);
    for (struct dirent *entry; entries && (entry = readdir(entries));)
        if (is_ours(entry->d_name)) unlinkat(dirfd(entries), entry->d_name, 0);
    if (entries) closedir(entries);
    rmdir(folder);
}
