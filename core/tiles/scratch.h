/* What lies in the scratch folder.  Numbers are as the machine has them: who shares the folder has the same kind.
 *
 *     plan        what tells all about it: the input, the parameters, the grid and its tiles, the limits
 *     points.N    the points of tile N, cell by cell: position and number in the input
 *     left.N      what running tile N has left of them
 *     gone.N      and what it has not, in the order of importance; only where that is kept
 *     kept.0      the kept points in the order of the input, where they don't fit into memory; kept.0.N parts of it
 *     raw.N       points.N while the plan is being made, in the order of the input
 *
 * Files are written beside their names, flushed, and renamed (core/io/out/file_out.h), but for points.N, which are
 * flushed after that, before the plan is written, and raw.N, which nobody needs after a crash.  What they hold is
 * summed up, and the sums are compared when it is read: the plan has its own and one for each cell of points.N; left.N
 * and gone.N end with theirs.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILES_SCRATCH_H
#define WHITTLE_CORE_TILES_SCRATCH_H

#include <stdbool.h>
#include <stdio.h>

#include "core/cloud/cloud.h"
#include "core/cloud/morton.h"
#include "core/cloud/select.h"
#include "core/params.h"
#include "core/simplify/contract.h"
#include "core/tiles/grid.h"

enum { SCRATCH_PATH_BYTES = 4096, SCRATCH_VERSION_BYTES = 64, SCRATCH_RECORD_BYTES = 28 /* of a point, at most */ };

/* How a position is written: whatever of these gives all of them back to the bit. */
struct scratch_coding {
    enum { CODING_F64, CODING_F32, CODING_SCALED } kind; /* scaled: whole numbers of 32 bits, times scale, plus add */
    double scale[3], add[3];
};

struct scratch_input {
    char path[SCRATCH_PATH_BYTES]; /* absolute */
    uint64_t bytes, modified_ns, hash;
};

struct scratch_head {
    char mark[16];
    char version[SCRATCH_VERSION_BYTES]; /* of whittle */
    struct params params;
    uint64_t inputs, tiles, cells;
    uint64_t points, tile_points;
    uint64_t room; /* points that a part may have, with those around it */
    uint64_t passes;
    double reach;                /* in spacings: how far around a tile points take part */
    struct ordered_points whole; /* the frame alone */
    vec3 anchor;
    int level;
    bool noisy;
    double average, length_bias; /* of the operator; contract.h */
    double noise;                /* of the sample, in the frame */
    uint64_t dropped;            /* points of the input without a position */
    struct selection selection;  /* points that weren't asked for */
    struct scratch_coding coding;
    bool ranks_all;        /* more is kept than can be finished in memory: tiles say what has gone, too */
    bool tells_normals;    /* of what is told */
    uint32_t told_key;     /* what has gone with this key or a lower one is told beside what is left; 0: none */
    uint64_t wanted;       /* points that the merge is to leave */
    uint64_t record_bytes; /* of the input's points */
    uint64_t views;        /* core/io/stream.h */
    uint64_t left_out_bytes;
};

struct scratch {
    struct scratch_head head;
    uint64_t hash;               /* of what was loaded */
    struct scratch_input *input; /* owned, as all that follows */
    struct grid_tile *tile;
    struct grid_cell *cell;
    uint64_t *sum; /* of each cell's records, scratch_sum */
    struct contract_limit *limit;
    vec3 *view;
    char *left_out; /* what all inputs have and no cloud can hold, as a cloud's; bytes with the 0 at the end, or none */
};

void scratch_done(struct scratch *scratch);

/* Writes and reads the plan.  Reading: STATUS_IO where there is none, STATUS_MALFORMED, STATUS_BAD_PARAMETER where
 * another version has made it. */
enum status scratch_save(const char *folder, const struct scratch *scratch, struct error *error) MUST_CHECK;
enum status scratch_load(const char *folder, struct scratch *scratch, struct error *error) MUST_CHECK;

/* A number of what the plan is made of, the same for the same inputs, parameters and sizes of tiles. */
uint64_t scratch_identity(const struct scratch *scratch);

/* Which file this is, for as long as nobody writes to it: its length, time and some of its bytes.  Standard input ("-")
 * has no time: whoever gives it knows that it is the same. */
enum status scratch_identify(const char *path, struct scratch_input *input, struct error *error) MUST_CHECK;

/* Whether the plan's inputs are what they were: STATUS_BAD_PARAMETER, which says since when one isn't; STATUS_IO. */
enum status scratch_check_inputs(const struct scratch *scratch, const char *since, struct error *error) MUST_CHECK;

/* "FOLDER/NAME.N". */
void scratch_path(char path[SCRATCH_PATH_BYTES], const char *folder, const char *name, size_t number);
bool scratch_has(const char *folder, const char *name, size_t number);

/* Opens a file of the folder for reading, the descriptor that its name says (TILES_GIVEN) where it says one; path gets
 * its name in any case.  -1 with errno. */
int scratch_open_file(const char *folder, const char *name, size_t number, char path[SCRATCH_PATH_BYTES]);

/* ------------------------------------------------------------------------------------------------ points */

size_t scratch_record_bytes(const struct scratch_coding *coding);
void scratch_encode(const struct scratch_coding *coding, vec3 p, uint32_t id, unsigned char *record);
vec3 scratch_decode(const struct scratch_coding *coding, const unsigned char *record, uint32_t *id);

/* A checksum of n records: that of some and that of others add up to that of all, in any order. */
uint64_t scratch_sum(const struct scratch_coding *coding, const unsigned char *record, size_t n);

/* Of records that are read one after the other, from the first of a cell on. */
struct scratch_check {
    const struct scratch *scratch; /* borrowed */
    size_t cell;
    uint64_t seen, sum; /* of the cell */
};

/* Whether the next n records are what they were, as far as they end cells. */
bool scratch_check_next(struct scratch_check *check, const unsigned char *record, size_t n);

/* Whether this coding gives the position back to the bit. */
bool scratch_codes(const struct scratch_coding *coding, vec3 p);

/* Points of a part of the cloud: those of a box of cells, and those around it. */
struct scratch_points {
    size_t count;
    vec3 *position; /* owned */
    uint32_t *id;   /* in the input; owned */
    uint8_t *own;   /* within the box; owned */
};
void scratch_points_done(struct scratch_points *points);

/* Reads the points of a box and of the space around it, `width` wide; less where there are more than `room`.  What is
 * left of the width is what room has, by steps, so the same points always.  STATUS_IO, STATUS_NO_MEMORY. */
enum status scratch_gather(const char *folder, const struct scratch *scratch, const struct grid *grid,
                           const struct grid_tile *box, double width, uint64_t room, unsigned threads,
                           struct scratch_points *points, struct error *error) MUST_CHECK;

/* Whether the space around the box, `width` wide, holds points of a tile. */
bool scratch_touches(const struct scratch *scratch, const struct grid *grid, const struct grid_tile *box, double width,
                     size_t tile);

/* Whole files: n bytes from `at`; STATUS_IO where they aren't there. */
enum status scratch_read(int fd, void *to, size_t n, uint64_t at, const char *path, struct error *error) MUST_CHECK;

/* Whether a file that is there has less than so many bytes: it isn't what was written. */
bool scratch_ends_before(int fd, uint64_t bytes);

/* Puts a checksum at the end of a file that has been written, and compares it: STATUS_IO, TILES_DAMAGED.  One that
 * isn't there is as it was. */
enum status scratch_seal(int fd, const char *path, struct error *error) MUST_CHECK;
enum status scratch_check_seal(const char *folder, const char *name, size_t number, struct error *error) MUST_CHECK;

/* Removes a damaged file, and what says that it was made.  Returns STATUS_IO, and says what has to be done again. */
enum status scratch_damaged(const char *folder, const char *name, size_t number, struct error *error) MUST_CHECK;

#endif
