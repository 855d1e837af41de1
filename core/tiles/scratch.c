/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/tiles/scratch.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/base/hash64.h"
#include "core/base/par.h"
#include "core/base/version.h"
#include "core/io/out/file_out.h"
#include "core/io/out/sink.h"
#include "core/tiles/tiles.h"

static const char mark[16] = "whittle tiles 6"; /* of the head and what follows it; the last letter counts */
enum { ID_BYTES = sizeof(uint32_t), LOOK_BYTES = 64 * 1024, PIECES = 7 };

void scratch_path(char path[SCRATCH_PATH_BYTES], const char *folder, const char *name, size_t number) {
    if (strncmp(folder, TILES_GIVEN, sizeof TILES_GIVEN - 1) == 0) folder = ".";
    if (strcmp(name, "plan") == 0)
        snprintf(path, SCRATCH_PATH_BYTES, "%s/plan", folder);
    else
        snprintf(path, SCRATCH_PATH_BYTES, "%s/%s.%zu", folder, name, number);
}

/* The descriptor that the folder's name says the file is; -1: it says none. */
static int given_fd(const char *folder, const char *name, size_t number) {
    char entry[64];
    if (strncmp(folder, TILES_GIVEN, sizeof TILES_GIVEN - 1) != 0) return -1;
    int n = snprintf(entry, sizeof entry, "%s.%zu=", name, number);
    for (const char *at = folder + sizeof TILES_GIVEN - 1; *at; at += strcspn(at, ","), at += *at == ',')
        if (strncmp(at, entry, (size_t)n) == 0) return (int)strtol(at + n, NULL, 10);
    return -1;
}

int scratch_open_file(const char *folder, const char *name, size_t number, char path[SCRATCH_PATH_BYTES]) {
    int fd = given_fd(folder, name, number);
    scratch_path(path, folder, name, number);
    return fd >= 0 ? fcntl(fd, F_DUPFD_CLOEXEC, 0) : open(path, O_RDONLY | O_CLOEXEC);
}

bool scratch_has(const char *folder, const char *name, size_t number) {
    char path[SCRATCH_PATH_BYTES];
    if (given_fd(folder, name, number) >= 0) return true;
    scratch_path(path, folder, name, number);
    return access(path, R_OK) == 0;
}

enum status scratch_read(int fd, void *to, size_t n, uint64_t at, const char *path, struct error *error) {
    for (size_t done = 0; done < n;) {
        ssize_t got = pread(fd, (char *)to + done, n - done, (off_t)(at + done));
        if (got < 0 && errno == EINTR) continue;
        if (got <= 0)
            return error_set(error, STATUS_IO, "tiles", "can't read %s: %s", path,
                             got < 0 ? strerror(errno) : "it is too short");
        done += (size_t)got;
    }
    return STATUS_OK;
}

bool scratch_ends_before(int fd, uint64_t bytes) {
    struct stat about;
    return fd >= 0 && fstat(fd, &about) == 0 && (uint64_t)about.st_size < bytes;
}

/* ------------------------------------------------------------------------------------------------ the plan */

void scratch_done(struct scratch *scratch) {
    if (!scratch) return;
    free(scratch->input), free(scratch->tile), free(scratch->cell), free(scratch->sum), free(scratch->limit);
    free(scratch->view), free(scratch->left_out);
    *scratch = (struct scratch){0};
}

static uint64_t hash_of(uint64_t hash, const void *bytes, size_t n) {
    const unsigned char *at = bytes;
    for (; n >= 8; n -= 8, at += 8) {
        uint64_t word;
        memcpy(&word, at, sizeof word);
        hash = hash64(hash + word);
    }
    for (; n; n--, at++) hash = hash64(hash + *at + 1);
    return hash;
}

struct piece {
    void **array;
    size_t count, size;
};

static void pieces_of(struct scratch *s, struct piece piece[PIECES]) {
    piece[0] = (struct piece){(void **)&s->input, s->head.inputs, sizeof *s->input};
    piece[1] = (struct piece){(void **)&s->tile, s->head.tiles, sizeof *s->tile};
    piece[2] = (struct piece){(void **)&s->cell, s->head.cells, sizeof *s->cell};
    piece[3] = (struct piece){(void **)&s->limit, s->head.passes, sizeof *s->limit};
    piece[4] = (struct piece){(void **)&s->view, s->head.views, sizeof *s->view};
    piece[5] = (struct piece){(void **)&s->left_out, s->head.left_out_bytes, 1};
    piece[6] = (struct piece){(void **)&s->sum, s->head.cells, sizeof *s->sum};
}

enum status scratch_save(const char *folder, const struct scratch *scratch, struct error *error) {
    char path[SCRATCH_PATH_BYTES];
    struct scratch copy = *scratch;
    struct file_out file;
    struct sink sink;
    struct piece piece[PIECES];
    memcpy(copy.head.mark, mark, sizeof mark);
    snprintf(copy.head.version, sizeof copy.head.version, "%s", whittle_version());
    pieces_of(&copy, piece);
    scratch_path(path, folder, "plan", 0);
    enum status status = file_out_begin(&file, path, error);
    if (status) return status;
    status = sink_init(&sink, file.fd);
    uint64_t hash = hash_of(0, &copy.head, sizeof copy.head);
    sink_bytes(&sink, &copy.head, sizeof copy.head);
    for (size_t i = 0; i < PIECES; i++) {
        hash = hash_of(hash, *piece[i].array, piece[i].count * piece[i].size);
        sink_bytes(&sink, *piece[i].array, piece[i].count * piece[i].size);
    }
    sink_bytes(&sink, &hash, sizeof hash);
    status = sink_done(&sink, status, error);
    if (status)
        file_out_abort(&file);
    else
        status = file_out_commit(&file, 1, error);
    return status;
}

static enum status load(int fd, const char *path, struct scratch *s, struct error *error) {
    struct scratch_head *head = &s->head;
    struct piece piece[PIECES];
    enum status status = scratch_read(fd, head, sizeof *head, 0, path, error);
    if (status) return status;
    if (memcmp(head->mark, mark, sizeof mark) != 0 && memcmp(head->mark, mark, sizeof mark - 2) == 0)
        return error_set(error, STATUS_BAD_PARAMETER, "version",
                         "%s was made by another version of whittle; use another folder", path);
    if (memcmp(head->mark, mark, sizeof mark) != 0)
        return error_set(error, STATUS_MALFORMED, "tiles", "%s is no plan of tiles", path);
    head->version[sizeof head->version - 1] = '\0';
    if (strcmp(head->version, whittle_version()) != 0)
        return error_set(error, STATUS_BAD_PARAMETER, "version", "%s was made by whittle %s; use another folder", path,
                         head->version);
    uint64_t at = sizeof *head, found = 0, hash = hash_of(0, head, sizeof *head);
    if (head->cells > GRID_MOST_CELLS || head->tiles > GRID_MOST_CELLS || head->inputs > GRID_MOST_CELLS ||
        head->passes > GRID_MOST_CELLS || head->views > GRID_MOST_CELLS || head->left_out_bytes > GRID_MOST_CELLS)
        return error_set(error, STATUS_MALFORMED, "tiles", "%s is damaged", path);
    pieces_of(s, piece);
    for (size_t i = 0; !status && i < PIECES; i++) {
        size_t n = piece[i].count * piece[i].size;
        *piece[i].array = alloc_array(piece[i].count, piece[i].size);
        if (!*piece[i].array) return error_set(error, STATUS_NO_MEMORY, "tiles", "no memory for the plan");
        status = scratch_read(fd, *piece[i].array, n, at, path, error);
        if (!status) hash = hash_of(hash, *piece[i].array, n);
        at += n;
    }
    if (!status) status = scratch_read(fd, &found, sizeof found, at, path, error);
    bool ends = !head->left_out_bytes || (!status && s->left_out[head->left_out_bytes - 1] == '\0');
    if (!status && (found != hash || !ends))
        status = error_set(error, STATUS_MALFORMED, "tiles", "%s is damaged", path);
    s->hash = hash;
    return status;
}

enum status scratch_load(const char *folder, struct scratch *scratch, struct error *error) {
    char path[SCRATCH_PATH_BYTES];
    struct scratch loaded = {0};
    int fd = scratch_open_file(folder, "plan", 0, path);
    if (fd < 0) return error_set(error, STATUS_IO, "tiles", "there is no plan %s: %s", path, strerror(errno));
    enum status status = load(fd, path, &loaded, error);
    close(fd);
    if (status)
        scratch_done(&loaded);
    else
        *scratch = loaded;
    return status;
}

/* The first, the middle and the last bytes are looked at. */
enum status scratch_identify(const char *path, struct scratch_input *input, struct error *error) {
    unsigned char look[LOOK_BYTES];
    struct stat about;
    memset(input, 0, sizeof *input);
    bool standard = strcmp(path, "-") == 0;
    char *whole = standard ? NULL : realpath(path, NULL);
    const char *name = standard ? path : whole;
    int fd = standard ? fcntl(STDIN_FILENO, F_DUPFD_CLOEXEC, 0) : whole ? open(whole, O_RDONLY | O_CLOEXEC) : -1;
    enum status status = STATUS_OK;
    if (fd < 0 || fstat(fd, &about) != 0)
        status = error_set(error, STATUS_IO, "read", "can't open %s: %s", path, strerror(errno));
    else if (!S_ISREG(about.st_mode))
        status = error_set(error, STATUS_UNSUPPORTED, "tiles",
                           "%s is no regular file; what doesn't fit into memory is read more than once", path);
    else if (strlen(name) >= sizeof input->path)
        status = error_set(error, STATUS_LIMIT, "tiles", "the path of %s is too long", path);
    if (!status) {
        snprintf(input->path, sizeof input->path, "%s", name ? name : "");
        input->bytes = (uint64_t)about.st_size;
        if (!standard)
            input->modified_ns = (uint64_t)about.st_mtim.tv_sec * 1000000000u + (uint64_t)about.st_mtim.tv_nsec;
        size_t n = input->bytes < sizeof look ? (size_t)input->bytes : sizeof look;
        const uint64_t at[] = {0, (input->bytes - n) / 2, input->bytes - n};
        for (size_t i = 0; !status && i < 3; i++) {
            status = scratch_read(fd, look, n, at[i], path, error);
            if (!status) input->hash = hash_of(input->hash, look, n);
        }
    }
    if (fd >= 0) close(fd);
    free(whole);
    return status;
}

enum status scratch_check_inputs(const struct scratch *scratch, const char *since, struct error *error) {
    for (size_t i = 0; i < scratch->head.inputs; i++) {
        struct scratch_input now;
        const struct scratch_input *then = &scratch->input[i];
        enum status status = scratch_identify(then->path, &now, error);
        if (status) return status;
        if (now.bytes != then->bytes || now.hash != then->hash || now.modified_ns != then->modified_ns)
            return error_set(error, STATUS_BAD_PARAMETER, "input", "%s isn't what it was %s", then->path, since);
    }
    return STATUS_OK;
}

uint64_t scratch_identity(const struct scratch *scratch) {
    const struct scratch_head *head = &scratch->head;
    const uint64_t sizes[] = {head->inputs, head->room, head->tile_points};
    uint64_t hash = hash_of(0, sizes, sizeof sizes);
    size_t rows;
    const struct param *row = params_table(&rows);
    for (size_t i = 0; i < head->inputs; i++) {
        const uint64_t of[] = {scratch->input[i].bytes, scratch->input[i].modified_ns, scratch->input[i].hash};
        hash = hash_of(hash, of, sizeof of);
    }
    for (size_t i = 0; i < rows; i++) {
        char text[PARAMS_TEXT_BYTES];
        if (!row[i].affects_result) continue;
        params_format(&head->params, &row[i], text, sizeof text);
        hash = hash_of(hash, text, strlen(text) + 1);
    }
    return hash;
}

/* ------------------------------------------------------------------------------------------------ damage */

enum status scratch_damaged(const char *folder, const char *name, size_t number, struct error *error) {
    bool removes = strncmp(folder, TILES_GIVEN, sizeof TILES_GIVEN - 1) != 0, is_input = strcmp(name, "points") == 0;
    char path[SCRATCH_PATH_BYTES], said[SCRATCH_PATH_BYTES];
    scratch_path(path, folder, name, number);
    scratch_path(said, folder, is_input ? "plan" : "left", number); /* which says that it is there */
    if (!removes) return error_set(error, STATUS_IO, TILES_DAMAGED, "%s isn't what was written: it is damaged", path);
    unlink(said), unlink(path);
    if (is_input)
        return error_set(error, STATUS_IO, TILES_DAMAGED,
                         "%s wasn't what was written, and has been removed: make the plan again", path);
    return error_set(error, STATUS_IO, TILES_DAMAGED,
                     "%s wasn't what was written, and has been removed: run tile %zu again", path, number);
}

static enum status sum_file(int fd, uint64_t bytes, const char *path, uint64_t *sum, struct error *error) {
    unsigned char look[LOOK_BYTES];
    *sum = hash_of(0, &bytes, sizeof bytes);
    for (uint64_t at = 0; at < bytes; at += sizeof look) {
        size_t n = bytes - at < sizeof look ? (size_t)(bytes - at) : sizeof look;
        enum status status = scratch_read(fd, look, n, at, path, error);
        if (status) return status;
        *sum = hash_of(*sum, look, n);
    }
    return STATUS_OK;
}

enum status scratch_seal(int fd, const char *path, struct error *error) {
    struct stat about;
    uint64_t sum;
    if (fstat(fd, &about) != 0)
        return error_set(error, STATUS_IO, "tiles", "can't look at %s: %s", path, strerror(errno));
    enum status status = sum_file(fd, (uint64_t)about.st_size, path, &sum, error);
    if (status) return status;
    ssize_t wrote = pwrite(fd, &sum, sizeof sum, about.st_size);
    if (wrote == sizeof sum) return STATUS_OK;
    int failure = wrote < 0 ? errno : ENOSPC;
    return error_set(error, status_from_errno(failure), "scratch", "can't write %s: %s", path, strerror(failure));
}

enum status scratch_check_seal(const char *folder, const char *name, size_t number, struct error *error) {
    char path[SCRATCH_PATH_BYTES];
    struct stat about;
    uint64_t sum = 0, then = 0;
    int fd = scratch_open_file(folder, name, number, path);
    if (fd < 0) return STATUS_OK;
    enum status status = STATUS_OK;
    if (fstat(fd, &about) != 0)
        status = error_set(error, STATUS_IO, "tiles", "can't look at %s: %s", path, strerror(errno));
    uint64_t bytes = status || (uint64_t)about.st_size < sizeof then ? 0 : (uint64_t)about.st_size - sizeof then;
    if (!status && bytes) status = sum_file(fd, bytes, path, &sum, error);
    if (!status && bytes) status = scratch_read(fd, &then, sizeof then, bytes, path, error);
    if (!status && (!bytes || sum != then)) status = scratch_damaged(folder, name, number, error);
    close(fd);
    return status;
}

/* ------------------------------------------------------------------------------------------------ points */

size_t scratch_record_bytes(const struct scratch_coding *coding) {
    return ID_BYTES + (coding->kind == CODING_F64 ? 24 : 12);
}

static int32_t whole_of(const struct scratch_coding *coding, int axis, double value) {
    double n = nearbyint((value - coding->add[axis]) / coding->scale[axis]);
    return n >= INT32_MIN && n <= INT32_MAX ? (int32_t)n : 0;
}

bool scratch_codes(const struct scratch_coding *coding, vec3 p) {
    const double value[3] = {p.x, p.y, p.z};
    for (int axis = 0; axis < 3; axis++) {
        double back = value[axis];
        if (coding->kind == CODING_F32) back = (double)(float)back;
        if (coding->kind == CODING_SCALED)
            back = (double)whole_of(coding, axis, back) * coding->scale[axis] + coding->add[axis];
        if (memcmp(&back, &value[axis], sizeof back) != 0) return false;
    }
    return true;
}

void scratch_encode(const struct scratch_coding *coding, vec3 p, uint32_t id, unsigned char *record) {
    const double value[3] = {p.x, p.y, p.z};
    if (coding->kind == CODING_F64) {
        memcpy(record, value, sizeof value);
        record += sizeof value;
    }
    for (int axis = 0; coding->kind != CODING_F64 && axis < 3; axis++, record += 4) {
        if (coding->kind == CODING_F32)
            memcpy(record, &(float){(float)value[axis]}, 4);
        else
            memcpy(record, &(int32_t){whole_of(coding, axis, value[axis])}, 4);
    }
    memcpy(record, &id, sizeof id);
}

vec3 scratch_decode(const struct scratch_coding *coding, const unsigned char *record, uint32_t *id) {
    double value[3];
    if (coding->kind == CODING_F64) {
        memcpy(value, record, sizeof value);
        record += sizeof value;
    }
    for (int axis = 0; coding->kind != CODING_F64 && axis < 3; axis++, record += 4) {
        float single;
        int32_t whole;
        memcpy(&single, record, 4);
        memcpy(&whole, record, 4);
        value[axis] =
            coding->kind == CODING_F32 ? (double)single : (double)whole * coding->scale[axis] + coding->add[axis];
    }
    memcpy(id, record, sizeof *id);
    return (vec3){value[0], value[1], value[2]};
}

uint64_t scratch_sum(const struct scratch_coding *coding, const unsigned char *record, size_t n) {
    size_t each = scratch_record_bytes(coding);
    uint64_t sum = 0;
    for (size_t i = 0; i < n; i++) sum += hash_of(1, record + i * each, each);
    return sum;
}

bool scratch_check_next(struct scratch_check *check, const unsigned char *record, size_t n) {
    const struct scratch *s = check->scratch;
    size_t each = scratch_record_bytes(&s->head.coding);
    while (n) {
        uint64_t rest = s->cell[check->cell].count - check->seen;
        size_t some = n < rest ? n : (size_t)rest;
        check->sum += scratch_sum(&s->head.coding, record, some);
        check->seen += some, record += some * each, n -= some;
        if (check->seen < s->cell[check->cell].count) break;
        if (check->sum != s->sum[check->cell]) return false;
        *check = (struct scratch_check){s, check->cell + 1, 0, 0};
    }
    return true;
}

void scratch_points_done(struct scratch_points *points) {
    if (!points) return;
    free(points->position), free(points->id), free(points->own);
    *points = (struct scratch_points){0};
}

static bool is_in(const struct grid_tile *box, struct grid_place place) {
    for (int axis = 0; axis < 3; axis++)
        if (place.at[axis] < box->from.at[axis] || place.at[axis] >= box->to.at[axis]) return false;
    return true;
}

/* Whether the cell reaches into the space around the box; distances in sides of cells. */
static bool is_near(const struct grid_tile *box, struct grid_place place, double width) {
    for (int axis = 0; axis < 3; axis++) {
        double below = (double)box->from.at[axis] - (double)place.at[axis] - 1;
        double above = (double)place.at[axis] - (double)box->to.at[axis];
        if (below > width || above > width) return false;
    }
    return true;
}

/* The space around a box: from a corner to the other, of what is at a grid's anchor. */
struct surroundings {
    vec3 anchor;
    double from[3], to[3];
};

static struct surroundings around_of(const struct grid_tile *box, const struct grid *grid, double width) {
    struct surroundings around = {.anchor = grid->anchor};
    double side = grid_side(grid);
    for (int axis = 0; axis < 3; axis++) {
        around.from[axis] = (double)box->from.at[axis] * side - width;
        around.to[axis] = (double)box->to.at[axis] * side + width;
    }
    return around;
}

static bool is_inside(const struct surroundings *around, vec3 p) {
    const double at[3] = {p.x - around->anchor.x, p.y - around->anchor.y, p.z - around->anchor.z};
    for (int axis = 0; axis < 3; axis++)
        if (at[axis] < around->from[axis] || at[axis] > around->to[axis]) return false;
    return true;
}

/* Some cells of a tile's file, one after the other. */
struct run {
    size_t tile, cell;
    uint64_t count;
    size_t at;    /* where its points go, with room for all */
    size_t taken; /* how many were near enough */
    bool failed, damaged;
};

struct gathering {
    const char *folder;
    const struct scratch *scratch;
    const struct grid *grid;
    const struct grid_tile *box;
    struct surroundings around;
    struct scratch_points *points;
    struct run *run;
};

enum { RUN_POINTS = 1 << 17 };

/* Reads a run and takes those of its points that are near enough. */
static enum status take_run(const struct gathering *g, struct run *run, struct error *error) {
    enum { PIECE = 1 << 12 };
    const struct scratch_coding *coding = &g->scratch->head.coding;
    struct scratch_check check = {g->scratch, run->cell, 0, 0};
    struct scratch_points *points = g->points;
    size_t each = scratch_record_bytes(coding), to = run->at;
    uint64_t first = g->scratch->cell[run->cell].first;
    char path[SCRATCH_PATH_BYTES];
    unsigned char *piece = alloc_array(PIECE, each);
    struct grid_place *place = alloc_array(PIECE, sizeof *place);
    int fd = scratch_open_file(g->folder, "points", run->tile, path);
    enum status status = STATUS_OK;
    if (fd < 0) status = error_set(error, STATUS_IO, "tiles", "can't open %s: %s", path, strerror(errno));
    if (!piece || !place) status = error_set(error, STATUS_NO_MEMORY, "tiles", "no memory to read points");
    run->damaged = scratch_ends_before(fd, (first + run->count) * each);
    for (uint64_t done = 0; !status && !run->damaged && done < run->count; done += PIECE) {
        size_t n = run->count - done < PIECE ? (size_t)(run->count - done) : PIECE;
        status = scratch_read(fd, piece, n * each, (first + done) * each, path, error);
        run->damaged = !status && !scratch_check_next(&check, piece, n);
        if (status || run->damaged) break;
        for (size_t i = 0; i < n; i++)
            points->position[to + i] = scratch_decode(coding, piece + i * each, &points->id[to + i]);
        grid_places_of(g->grid, points->position + to, n, place);
        for (size_t i = 0, from = to; i < n; i++, from++) {
            bool own = is_in(g->box, place[i]);
            if (!own && !is_inside(&g->around, points->position[from])) continue;
            points->position[to] = points->position[from];
            points->id[to] = points->id[from];
            points->own[to++] = own;
        }
    }
    run->taken = to - run->at;
    if (fd >= 0) close(fd);
    free(piece), free(place);
    return status;
}

static void take_range(void *ctx, size_t begin, size_t end) {
    const struct gathering *g = ctx;
    for (size_t i = begin; i < end; i++) g->run[i].failed = take_run(g, &g->run[i], NULL) != STATUS_OK;
}

/* What has failed is tried once more, which says why. */
static enum status take_runs(const struct gathering *g, size_t runs, unsigned threads, struct error *error) {
    enum status status = STATUS_OK;
    par_for(threads, runs, 1, take_range, (void *)(uintptr_t)g);
    for (size_t i = 0; !status && i < runs; i++) {
        struct run *run = &g->run[i];
        if (run->failed) status = take_run(g, run, error);
        if (run->damaged) status = scratch_damaged(g->folder, "points", run->tile, error);
    }
    return status;
}

/* Closes the gaps that other points have left. */
static void join_runs(struct scratch_points *points, const struct run *run, size_t runs) {
    for (size_t i = 0; i < runs; i++) {
        size_t from = run[i].at, to = points->count, n = run[i].taken;
        if (from != to) {
            memmove(points->position + to, points->position + from, n * sizeof *points->position);
            memmove(points->id + to, points->id + from, n * sizeof *points->id);
            memmove(points->own + to, points->own + from, n * sizeof *points->own);
        }
        points->count += n;
    }
}

/* The points of cells that are near, for a width. */
static uint64_t count_near(const struct scratch *scratch, const struct grid_tile *box, double width) {
    uint64_t sum = 0;
    for (size_t i = 0; i < scratch->head.cells; i++)
        if (is_near(box, scratch->cell[i].place, width)) sum += scratch->cell[i].count;
    return sum;
}

bool scratch_touches(const struct scratch *scratch, const struct grid *grid, const struct grid_tile *box, double width,
                     size_t tile) {
    const struct grid_tile *other = &scratch->tile[tile];
    for (size_t i = other->first; i < other->first + other->cells; i++)
        if (is_near(box, scratch->cell[i].place, width / grid_side(grid))) return true;
    return false;
}

/* Runs of cells that are near, in the order of the files; none of many more points than RUN_POINTS, unless a cell is.
 * run: NULL to count them. */
static size_t find_runs(const struct scratch *scratch, const struct grid_tile *box, double width, struct run *run) {
    size_t runs = 0, at = 0;
    for (size_t t = 0; t < scratch->head.tiles; t++) {
        const struct grid_tile *tile = &scratch->tile[t];
        uint64_t count = RUN_POINTS; /* of the present one */
        for (size_t i = tile->first; i < tile->first + tile->cells; i++) {
            if (!is_near(box, scratch->cell[i].place, width)) {
                count = RUN_POINTS;
                continue;
            }
            if (count >= RUN_POINTS) {
                if (run) run[runs] = (struct run){.tile = t, .cell = i, .at = at};
                runs++;
                count = 0;
            }
            count += scratch->cell[i].count;
            at += (size_t)scratch->cell[i].count;
            if (run) run[runs - 1].count = count;
        }
    }
    return runs;
}

enum status scratch_gather(const char *folder, const struct scratch *scratch, const struct grid *grid,
                           const struct grid_tile *box, double width, uint64_t room, unsigned threads,
                           struct scratch_points *points, struct error *error) {
    const double narrower = 0.85;
    enum { NARROWINGS = 30 };
    double side = grid_side(grid);
    *points = (struct scratch_points){0};
    uint64_t most = count_near(scratch, box, width / side);
    for (int i = 0; most > room; i++) {
        width = i < NARROWINGS ? width * narrower : 0;
        most = count_near(scratch, box, width / side);
        if (i >= NARROWINGS) break; /* the box alone, and cells that touch it */
    }
    points->position = alloc_array(most, sizeof *points->position);
    points->id = alloc_array(most, sizeof *points->id);
    points->own = alloc_array(most, sizeof *points->own);
    struct gathering g = {folder, scratch, grid, box, around_of(box, grid, width), points, NULL};
    size_t runs = find_runs(scratch, box, width / side, NULL);
    g.run = alloc_array(runs, sizeof *g.run);
    enum status status = points->position && points->id && points->own && g.run
                             ? STATUS_OK
                             : error_set(error, STATUS_NO_MEMORY, "tiles", "no memory for %" PRIu64 " points", most);
    if (!status) {
        find_runs(scratch, box, width / side, g.run);
        status = take_runs(&g, runs, threads, error);
    }
    if (!status)
        join_runs(points, g.run, runs);
    else
        scratch_points_done(points);
    free(g.run);
    return status;
}
