/* What tiles can do, and what they take: known before anything is read, and by the service, which makes none itself.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILES_FIT_H
#define WHITTLE_CORE_TILES_FIT_H

#include <stdbool.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/params.h"

/* Points with those around them, of a tile's own; of a part's room, how many points can be finished; points that are
 * left for the end, of those kept. */
#define FIT_AROUND 1.7
#define FIT_LEFT 0.85
#define FIT_MORE_THAN_KEPT 1.4

/* Disk: of the points in the input, how many times these all tiles may take; what a point that is left takes beside its
 * position and number, about; what is told of a kept one that has gone, and its normal. */
#define FIT_DISK 2.0
#define FIT_LEFT_BYTES 78.0
#define FIT_TOLD_BYTES 6.0
#define FIT_NORMAL_BYTES 6.0

/* Points that are left or told of, of those kept. */
#define FIT_MORE_TOLD 1.2

/* The sample that a plan takes has so many blocks of so many points at least. */
enum { FIT_LEAST_BLOCK_POINTS = 1 << 12, FIT_FEWEST_BLOCKS = 8 };

/* Of the plan of so many points, of which 16 and more lie in a cell, at most. */
double fit_plan_bytes(double points);

/* How many points of a part params->memory_bytes have room for. */
uint64_t fit_room(const struct params *params);

/* Whether what is asked for is made in memory, of as many points as that has room for, and tiles find these: meshes,
 * and what shows distances to them. */
bool fit_ends_in_memory(const struct params *params);

/* Of so many points, with records of so many bytes, how many tiles are to leave; of what ends in memory these are more
 * than are kept. */
double fit_wanted(const struct params *params, uint64_t points, uint64_t record_bytes);

/* Params of the end in memory, where so many points are left of all: as many are kept of these as of all. */
struct params fit_params_of_end(const struct params *params, uint64_t points, uint64_t left);

/* Whether nothing is asked for but a tileset, which is made of files where what is kept doesn't fit. */
bool fit_is_tileset(const struct params *params);

/* Whether tiles choose points by their distance, and by nothing else; and whether they may tell which points have gone,
 * too. */
bool fit_is_spaced(const struct params *params);
bool fit_is_spaced_alone(const struct params *params);
bool fit_tells_gone(const struct params *params);

/* How many points of so many bytes a tileset may hold in memory at a time. */
uint64_t fit_tileset_room(const struct params *params, uint64_t record_bytes);

/* What is known of a cloud before tiles are made. */
struct fit_cloud {
    uint64_t points, record_bytes;
    double each;          /* bytes of a point in the tiles' files, at most */
    uint64_t room;        /* fit_room */
    uint64_t tile_points; /* that somebody has asked for; 0: nobody has */
};

/* Where tiles end. */
struct fit_goal {
    double wanted;      /* points that the merge is to leave */
    double left;        /* so many are left at most */
    double told;        /* of so many of the most important ones, those left among them, the rest is told; 0: none is */
    bool tells_normals; /* of these */
    bool ranks_all;     /* more is kept than can be finished in memory: tiles say what has gone, too */
    double disk_bytes;  /* that scratch holds at most */
};

/* As many are left as the end has room for in memory, and on the disk in FIT_DISK times the points' records (not where
 * all that have gone are told), but more than are kept; where the disk hasn't room for those, fewer, and the most
 * important of the others are told. */
struct fit_goal fit_goal(const struct params *params, const struct fit_cloud *cloud);

/* Whether what is to be kept of points with records of so many bytes can be finished in the room: STATUS_NO_MEMORY says
 * what can. */
enum status fit_kept(const struct params *params, uint64_t points, uint64_t record_bytes, uint64_t room,
                     struct error *error) MUST_CHECK;

/* What it takes, by the number of points in the input, with records of so many bytes (0: nobody knows); disk is the
 * most that scratch holds at once. */
struct tiles_prediction {
    uint64_t disk_bytes;
    double seconds; /* on so many processors as threads says, all stages; by a rule of thumb */
};
struct tiles_prediction tiles_predict(uint64_t points, uint64_t record_bytes, const struct params *params);

/* error->where of STATUS_IO: a file of the folder isn't what was written.  It has been removed, unless it was given, so
 * the same steps once more make it again; tiles that are done stay done. */
#define TILES_DAMAGED "damage"

/* Whether tiles can do what params ask for: STATUS_BAD_PARAMETER or STATUS_NO_MEMORY that say what can't be. */
enum status tiles_can(const struct params *params, struct error *error) MUST_CHECK;

#endif
