/* A file is mapped, as for core/io/read.c, but what has been read of it is given back, so that it counts to nobody's
 * memory.  One file is open at a time, and the first one's description stays.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/stream.h"

#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "core/base/alloc.h"
#include "core/cloud/attribute_names.h"
#include "core/io/build.h"
#include "core/io/formats/las_fields.h"
#include "core/io/parts.h"
#include "core/io/sniff.h"
#include "core/io/temporary.h"

enum { SYSTEM_BYTES = 128, NOTE_BYTES = 512 };

struct file {
    unsigned char *map; /* NULL: none */
    size_t bytes, given_back;
    size_t on_disk;  /* bytes, as the file is */
    size_t unpacked; /* and those that were decompressed beside it */
    bool is_read;    /* to the end */
    size_t scans;    /* that its points tell of, by now */
    struct cloud_parts *parts;
};

struct cloud_stream {
    struct cloud_limits limits;
    char *columns; /* of limits; owned, as is the next */
    char *scratch;
    size_t count, next; /* files; the one to open after this */
    char **path;        /* owned, each */
    uint64_t *before;   /* count + 1: bytes of the files before each; owned */
    uint64_t dropped, unpacked;
    struct selection selection;
    size_t scans, views;      /* of the files that are read to the end; where views isn't 0, it is scans */
    vec3 *view;               /* owned */
    struct cloud notes;       /* left_out alone: of the files that are read to the end */
    struct file first, other; /* the first one stays for what it says */
};

static void close_file(struct file *file) {
    if (file->parts) file->parts->free(file->parts);
    if (file->map) munmap(file->map, file->bytes);
    *file = (struct file){0};
}

static bool is_standard_input(const char *path) { return strcmp(path, "-") == 0; }

static enum status map_file(const char *path, struct file *file, struct error *error) {
    struct stat about;
    int fd = is_standard_input(path) ? fcntl(STDIN_FILENO, F_DUPFD_CLOEXEC, 0) : open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return error_set(error, STATUS_IO, "read", "can't open %s: %s", path, strerror(errno));
    enum status status = STATUS_OK;
    if (fstat(fd, &about) != 0 || S_ISDIR(about.st_mode))
        status = error_set(error, STATUS_IO, "read", "can't read %s", path);
    else if (!S_ISREG(about.st_mode))
        status = error_set(error, STATUS_UNSUPPORTED, "read", "%s is no regular file, which parts are read of", path);
    else if (about.st_size == 0)
        status = error_set_at(error, STATUS_MALFORMED, "read", 0, 0, "the file is empty");
    if (!status) {
        void *map = mmap(NULL, (size_t)about.st_size, PROT_READ, MAP_PRIVATE, fd, 0);
        if (map == MAP_FAILED)
            status = error_set(error, STATUS_IO, "read", "can't map %s: %s", path, strerror(errno));
        else
            *file = (struct file){.map = map, .bytes = (size_t)about.st_size, .on_disk = (size_t)about.st_size};
    }
    close(fd);
    return status;
}

/* Puts what a compressed file becomes in its place. */
static enum status decompress(const struct cloud_stream *s, struct file *file, struct error *error) {
    enum inflate_kind kind;
    unsigned char *map;
    size_t bytes;
    if (!s->limits.scratch || !inflate_sniff(file->map, file->bytes, &kind)) return STATUS_OK;
    (void)madvise(file->map, file->bytes, MADV_SEQUENTIAL);
    enum status status = temporary_inflate(s->limits.scratch, kind, file->map, file->bytes, &map, &bytes, error);
    if (status) return status;
    munmap(file->map, file->bytes);
    file->map = map;
    file->bytes = file->unpacked = bytes;
    return STATUS_OK;
}

static enum status open_file(struct cloud_stream *s, const char *path, struct file *file, struct error *error) {
    enum status status = map_file(path, file, error);
    if (!status) status = decompress(s, file, error);
    if (status) {
        close_file(file);
        return status;
    }
    struct cloud_guess guess = cloud_sniff(file->map, file->bytes);
    const struct cloud_limits *limits = &s->limits;
    switch (guess.kind) {
    case CLOUD_KIND_LAS: status = cloud_las_parts(file->map, file->bytes, limits, &file->parts, error); break;
    case CLOUD_KIND_PLY: status = cloud_ply_parts(file->map, file->bytes, limits, &file->parts, error); break;
    case CLOUD_KIND_PCD: status = cloud_pcd_parts(file->map, file->bytes, limits, &file->parts, error); break;
    case CLOUD_KIND_E57: status = cloud_e57_parts(file->map, file->bytes, limits, &file->parts, error); break;
    case CLOUD_KIND_PTX: status = cloud_ptx_parts(file->map, file->bytes, limits, &file->parts, error); break;
    case CLOUD_KIND_TEXT: status = cloud_xyz_parts(file->map, file->bytes, limits, &file->parts, error); break;
    default:
        status = error_set(error, STATUS_UNSUPPORTED, "read",
                           "%s looks like %s, which can't be read part by part; convert it to LAS, LAZ or PLY", path,
                           guess.looks_like);
    }
    (void)madvise(file->map, file->bytes, MADV_SEQUENTIAL);
    (void)madvise(file->map, file->bytes, MADV_DONTNEED); /* what was looked at to begin with: a file, which is there */
    if (!status) file->unpacked += file->parts->on_disk;
    if (!status && s->unpacked < s->first.unpacked + s->other.unpacked)
        s->unpacked = s->first.unpacked + s->other.unpacked;
    if (status) close_file(file);
    return status;
}

static bool same_properties(const struct cloud *a, const struct cloud *b) {
    if (a->property_count != b->property_count || a->record_bytes != b->record_bytes) return false;
    for (size_t j = 0; j < a->property_count; j++)
        if (strcmp(a->property[j].name, b->property[j].name) != 0 || a->property[j].type != b->property[j].type)
            return false;
    return true;
}

/* LAS of another scale or coordinate system isn't written as one; offsets may differ by whole steps of the scale. */
static enum status check_las(const struct cloud *a, const struct cloud *b, const char *path, struct error *error) {
    char first[SYSTEM_BYTES], other[SYSTEM_BYTES];
    if (!a->las || !b->las) return STATUS_OK;
    for (size_t axis = 0; axis < 3; axis++) {
        const struct las_field *f = &a->las->field[a->xyz[axis]], *g = &b->las->field[b->xyz[axis]];
        double steps = (g->add - f->add) / f->scale;
        if (f->scale != g->scale || fabs(steps - nearbyint(steps)) > 1e-6)
            return error_set(error, STATUS_UNSUPPORTED, "read",
                             "%s has coordinates of another scale or offset than the first input", path);
    }
    las_records_system(a->las, first, sizeof first);
    las_records_system(b->las, other, sizeof other);
    if (strcmp(first, other) == 0) return STATUS_OK;
    return error_set(error, STATUS_MALFORMED, "read", "%s is in the coordinate system %s, the first input in %s", path,
                     other[0] ? other : "of no name", first[0] ? first : "of no name");
}

/* The next file, whose points follow. */
static enum status go_on(struct cloud_stream *s, struct error *error) {
    const char *path = s->path[s->next];
    if (s->next == 0) {
        enum status status = open_file(s, path, &s->first, error);
        s->next += !status;
        return status;
    }
    close_file(&s->other);
    enum status status = open_file(s, path, &s->other, error);
    if (status) return status;
    s->next++;
    const struct cloud *first = s->first.parts->cloud, *now = s->other.parts->cloud;
    if (same_properties(first, now)) return check_las(first, now, path, error);
    return error_set(error, STATUS_UNSUPPORTED, "read", "%s has other properties than %s", path, s->path[0]);
}

static enum status copy_text(const char *from, char **to) {
    if (!from) return STATUS_OK;
    size_t n = strlen(from) + 1;
    *to = alloc_array(n, 1);
    if (*to) memcpy(*to, from, n);
    return *to ? STATUS_OK : STATUS_NO_MEMORY;
}

enum status cloud_stream_open(const char *const *path, size_t count, const struct cloud_limits *limits,
                              struct cloud_stream **out, struct error *error) {
    struct cloud_stream *s = alloc_zeroed(1, sizeof *s);
    if (!s) return error_set(error, STATUS_NO_MEMORY, "read", "no memory to read with");
    s->path = alloc_zeroed(count, sizeof *s->path);
    s->before = alloc_zeroed(count + 1, sizeof *s->before);
    enum status status = s->path && s->before ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < count; i++) {
        struct stat about;
        s->count++;
        status = copy_text(path[i], &s->path[i]);
        bool known = (is_standard_input(path[i]) ? fstat(STDIN_FILENO, &about) : stat(path[i], &about)) == 0;
        s->before[i + 1] = s->before[i] + (known ? (uint64_t)about.st_size : 0);
    }
    if (!status && limits) status = copy_text(limits->columns, &s->columns);
    if (!status && limits) status = copy_text(limits->scratch, &s->scratch);
    if (status) error_set(error, STATUS_NO_MEMORY, "read", "no memory to read with");
    if (limits) s->limits.threads = limits->threads, s->limits.select = limits->select;
    s->limits.columns = s->columns;
    s->limits.scratch = s->scratch;
    s->limits.columns_if_text = true;
    s->limits.numbers_scans = count > 1;
    if (!status) status = go_on(s, error);
    if (status)
        cloud_stream_free(s);
    else
        *out = s;
    return status;
}

const struct cloud *cloud_stream_cloud(const struct cloud_stream *stream) { return stream->first.parts->cloud; }

/* Pages that have been read count to the process as long as they are mapped. */
static void give_back(struct file *file) {
    size_t page = (size_t)sysconf(_SC_PAGESIZE), end = file->parts->done_bytes / page * page;
    if (end <= file->given_back) return;
    (void)madvise(file->map + file->given_back, end - file->given_back, MADV_DONTNEED);
    file->given_back = end;
}

/* Closes the gaps that other points leave.  kept: of each point, whether it is one; NULL = those with a position. */
static size_t close_gaps(struct cloud *part, const uint8_t *is_kept) {
    size_t kept = 0;
    for (size_t i = 0; i < part->count; i++) {
        if (is_kept ? !is_kept[i] : !vec3_is_finite(part->position[i])) continue;
        if (kept < i) {
            part->position[kept] = part->position[i];
            memcpy(part->record + kept * part->record_bytes, part->record + i * part->record_bytes, part->record_bytes);
        }
        kept++;
    }
    size_t gone = part->count - kept;
    part->count = kept;
    return gone;
}

/* Leaves the points that are asked for. */
static enum status select_of(struct cloud_stream *s, struct cloud *part, struct error *error) {
    struct selection selection;
    if (!s->limits.select || !select_is_asked(s->limits.select)) return STATUS_OK;
    uint8_t *kept = alloc_array(part->count, sizeof *kept);
    if (!kept) return error_set(error, STATUS_NO_MEMORY, "crop", "no memory for %zu points", part->count);
    enum status status = select_part(part, s->limits.select, kept, &selection, error);
    if (!status) {
        s->selection.cropped += selection.cropped;
        s->selection.filtered += selection.filtered;
        close_gaps(part, kept);
    }
    free(kept);
    return status;
}

/* The numbers of a file's scans follow those of the files before. */
static enum status number_scans(struct cloud_stream *s, struct file *file, struct error *error) {
    struct cloud *part = file->parts->cloud;
    const struct property *scan = s->count > 1 ? attribute_find(part, CLOUD_SCAN) : NULL;
    for (size_t i = 0; scan && i < part->count; i++) {
        unsigned char *at = part->record + i * part->record_bytes + scan->offset_bytes;
        double number = scalar_load(at, scan->type), next = number + (double)s->scans;
        if (number >= (double)file->scans && number < CLOUD_SCANS_MOST) file->scans = (size_t)number + 1;
        if (s->scans == 0) continue;
        scalar_store(at, scan->type, next);
        if (scalar_load(at, scan->type) != next)
            return error_set(error, STATUS_LIMIT, "read",
                             "scan %.0f of all inputs is more than their property %s holds", next, scan->name);
    }
    return STATUS_OK;
}

/* What the whole file says of its scanners comes behind what is there; who says nothing has NAN. */
static enum status add_views(struct cloud_stream *s, struct file *file, struct error *error) {
    const struct cloud *cloud = file->parts->cloud;
    size_t more = file->scans > cloud->view_count ? file->scans : cloud->view_count, all = s->scans + (more ? more : 1);
    if (s->views || cloud->view_count) {
        vec3 *view = alloc_resize(s->view, all, sizeof *view);
        if (!view) return error_set(error, STATUS_NO_MEMORY, "read", "no memory for %zu scans", all);
        for (size_t i = s->views; i < all; i++) view[i] = (vec3){NAN, NAN, NAN};
        if (cloud->view_count) memcpy(view + s->scans, cloud->view, cloud->view_count * sizeof *view);
        s->view = view;
        s->views = all;
    }
    s->scans = all;
    return STATUS_OK;
}

/* Line by line, since what other files have told isn't told again. */
static enum status add_notes(struct cloud_stream *s, const struct file *file, struct error *error) {
    char note[NOTE_BYTES];
    for (const char *at = file->parts->cloud->left_out; at && *at;) {
        size_t n = strcspn(at, "\n");
        snprintf(note, sizeof note, "%.*s", (int)(n < sizeof note ? n : sizeof note - 1), at);
        if (cloud_leave_out(&s->notes, note))
            return error_set(error, STATUS_NO_MEMORY, "read", "no memory for what is told of the files");
        at += n + (at[n] == '\n');
    }
    return STATUS_OK;
}

/* Keeps what is known of a file once all of it is read. */
static enum status end_file(struct cloud_stream *s, struct file *file, struct error *error) {
    if (file->is_read) return STATUS_OK;
    file->is_read = true;
    enum status status = add_views(s, file, error);
    return status ? status : add_notes(s, file, error);
}

uint64_t cloud_stream_unpacked(const struct cloud_stream *stream) { return stream->unpacked; }

const char *cloud_stream_left_out(const struct cloud_stream *stream) { return stream->notes.left_out; }

const vec3 *cloud_stream_views(const struct cloud_stream *stream, uint64_t *count) {
    *count = stream->views;
    return stream->view;
}

enum status cloud_stream_next(struct cloud_stream *stream, const struct cloud **part, struct error *error) {
    for (;;) {
        struct file *file = stream->next > 1 ? &stream->other : &stream->first;
        struct cloud *cloud = file->parts->cloud;
        enum status status = file->parts->next(file->parts, error);
        if (status) return status;
        give_back(file);
        bool ended = cloud->count == 0 && !file->parts->goes_on;
        status = ended ? end_file(stream, file, error) : number_scans(stream, file, error);
        if (status) return status;
        stream->dropped += close_gaps(cloud, NULL);
        status = select_of(stream, cloud, error);
        if (status) return status;
        *part = cloud;
        if (cloud->count || (ended && stream->next == stream->count)) return STATUS_OK;
        if (!ended) continue;
        status = go_on(stream, error);
        if (status) return status;
    }
}

double cloud_stream_fraction(const struct cloud_stream *stream) {
    const struct file *file = stream->next > 1 ? &stream->other : &stream->first;
    uint64_t all = stream->before[stream->count];
    double done = (double)file->parts->done_bytes / (double)file->bytes * (double)file->on_disk;
    return all ? ((double)stream->before[stream->next - 1] + done) / (double)all : 1;
}

uint64_t cloud_stream_dropped(const struct cloud_stream *stream) { return stream->dropped; }

struct selection cloud_stream_selection(const struct cloud_stream *stream) {
    return stream->selection;
}

void cloud_stream_free(struct cloud_stream *stream) {
    if (!stream) return;
    close_file(&stream->first);
    close_file(&stream->other);
    for (size_t i = 0; i < stream->count; i++) free(stream->path[i]);
    cloud_done(&stream->notes);
    free(stream->path), free(stream->before), free(stream->columns), free(stream->scratch), free(stream->view);
    free(stream);
}
