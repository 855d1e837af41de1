/* Clouds larger than memory: cut into tiles on disk, each simplified with what lies around it, and finished in memory.
 *
 *     plan    reads the input twice: cells are counted, then each point goes to its tile's file; a sample of the cloud
 *             tells what no tile knows alone
 *     run     one tile: points around it take part, and what is left of its own is written
 *     merge   what is left of all tiles is contracted on, as in memory, and the kept points are read once more
 *
 * All three are idempotent: what is there isn't made again, and files appear whole or not at all.  The result depends
 * on the input, the parameters and tile_points; on nothing else.  DECISIONS.md says why.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILES_TILES_H
#define WHITTLE_CORE_TILES_TILES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/progress.h"
#include "core/base/status.h"
#include "core/io/out/kept_file.h"
#include "core/params.h"
#include "core/pipeline/pipeline.h"
#include "core/tiles/fit.h"

struct tiles_job {
    const char *const *input; /* regular files, core/io/stream.h; "-" is standard input, which is one too */
    size_t inputs;
    const char *folder;          /* scratch; made where it isn't there */
    const struct params *params; /* resolved; memory_bytes bounds what plan, run and merge take each */
    uint64_t tile_points;        /* of a tile's own, at most; 0 = what memory has room for */
};

/* What a plan says. */
struct tiles_facts {
    uint64_t points, tile_points;
    size_t tiles, done;   /* done: tiles that have been run */
    size_t passes;        /* that are made of tiles */
    uint64_t left_points; /* after these, about */
    bool for_tileset;     /* and nothing else: more is kept than can be finished in memory */
};

/* A folder's name may say what some of its files are among the descriptors of this process, which opens none by name
 * where it is confined: TILES_GIVEN "plan.0=4,points.7=5".  What isn't said lies in the current folder. */
#define TILES_GIVEN "given:"

/* Plans, unless the folder has this plan already.  STATUS_BAD_PARAMETER where it has another one (another input, other
 * parameters); STATUS_NO_MEMORY where params->memory_bytes have no room for it, STATUS_NO_SPACE, STATUS_IO, what
 * reading says; STATUS_CANCELLED. */
enum status tiles_plan(const struct tiles_job *job, const struct progress *progress, struct tiles_facts *facts,
                       struct error *error) MUST_CHECK;

/* What the folder's plan says; params (may be NULL) gets what it was made with. */
enum status tiles_look(const char *folder, struct tiles_facts *facts, struct params *params,
                       struct error *error) MUST_CHECK;

/* The inputs that it was made of. */
struct tiles_inputs {
    size_t count;
    char **path; /* owned, each */
};
enum status tiles_inputs(const char *folder, struct tiles_inputs *inputs, struct error *error) MUST_CHECK;
void tiles_inputs_done(struct tiles_inputs *inputs);

/* The tiles whose points running this one reads, its own among them: is_read[t] of each. */
enum status tiles_around(const char *folder, size_t tile, bool *is_read, struct error *error) MUST_CHECK;

/* Whether this tile has been run. */
bool tiles_is_done(const char *folder, size_t tile);

/* Runs a tile of the plan, unless that is done.  threads: 0 = all processors. */
enum status tiles_run(const char *folder, size_t tile, unsigned threads, const struct progress *progress,
                      struct error *error) MUST_CHECK;

/* Makes the result of the tiles, all of which must be done (STATUS_BAD_PARAMETER).  *cloud is the kept points alone, in
 * the order of the input, result->kept their ranking; both are the caller's.
 *
 * Where more is made of the kept points (fit_ends_in_memory), result->facing has their normals, if tiles tell them.
 *
 * Where the plan is for a tileset of more points than memory holds, they are in a file of the folder instead, *file,
 * which is the caller's; the cloud says what its records are, of no point, and result->kept is NULL.  Else file->path
 * is NULL.  What is there of it isn't made again; tiles_kept_remove removes it. */
enum status tiles_merge(const char *folder, unsigned threads, const struct progress *progress, struct cloud *cloud,
                        struct kept_file *file, struct pipeline_result *result, struct error *error) MUST_CHECK;

/* Measures all points of the input, where pipeline_run has made meshes of the kept ones (cloud, as tiles_merge left it)
 * and measured these alone: for each level the report's input_to_mesh and tangent become those of all points but the
 * dropped ones, symmetric what follows.  facing: of each kept point, as tiles_merge has it; NULL: tangent isn't
 * measured then.  Points count as they came, where denoising has moved the kept ones.  *made stays as it is where it
 * fails. */
enum status tiles_measure(const char *folder, unsigned threads, const struct progress *progress,
                          const struct cloud *cloud, const float (*facing)[3], struct pipeline_result *made,
                          struct error *error) MUST_CHECK;

/* Removes the file of kept points, once nothing more is made of it.  Accepts one without a path. */
void tiles_kept_remove(struct kept_file *file);

/* Removes what these have made in the folder, and the folder, where nothing else is in it. */
void tiles_remove(const char *folder);

#endif
