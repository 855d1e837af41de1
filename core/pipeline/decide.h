/* How it is decided what surface the points are of: closed, open or a height field.  README.md has the order of what
 * decides.  All of them fill run->surface and run->decision where they tell, and return STATUS_NO_MEMORY or
 * STATUS_CANCELLED where they fail.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PIPELINE_DECIDE_H
#define WHITTLE_CORE_PIPELINE_DECIDE_H

#include "core/pipeline/pipeline_run.h"

enum { DECIDE_ENOUGH = 2000 }; /* kept points, for their mesh to tell what the points are of */

/* Whether a closed surface that isn't as good as it gets tells that none is closed: its lid is too large, or it faces
 * away from where the points were seen from. */
struct closed_probe {
    struct run *run;
    const struct sites *sites;
};

/* Fills run->bars and run->rods, once, where the surface may be closed: whether many points are on thin bars. */
enum status decide_find_bars(struct run *run) MUST_CHECK;

/* Decides what surface the cloud has where that needs no mesh of the kept points. */
enum status decide_by_points(struct run *run) MUST_CHECK;

/* Decides by a quarter of the kept points where nothing else is asked before them, so that tetrahedra of all are made
 * only where they are needed. */
enum status decide_early(struct run *run) MUST_CHECK;

/* Where a closed mesh of all points has a lid, however small, or isn't closed, the two heights aren't those of thin
 * walls but of one surface that was scanned twice, and it is decided as if there weren't any. */
enum status decide_by_walls(struct run *run) MUST_CHECK;

/* Decides what surface the cloud has by a closed mesh of the k most important points, unless they have none. */
enum status decide_by_others(struct run *run, size_t k) MUST_CHECK;

/* Where fewer points lie over each other than those of solids do, the labels of a quarter of many kept ones are asked
 * first: a large lid hardly depends on how many there are. */
enum status decide_by_quarter(struct run *run, size_t kept) MUST_CHECK;

/* Decides for a surface with borders, since no closed one could be found. */
void decide_none_is_closed(struct run *run);

/* A probe (core/surface/reconstruct.h) of a closed surface that is being made; ctx: a closed_probe.  Tells how to go
 * on, and decides where that is clear. */
enum status decide_is_none_closed(void *ctx, const struct mesh *rough, enum reconstruct_stage stage,
                                  enum reconstruct_answer *answer) MUST_CHECK;

/* Decides by a closed mesh whether it should be one. */
enum status decide_by_lid(struct run *run, const struct mesh *closed) MUST_CHECK;

/* Decides by a height field's mesh, of what looks like one, whether it should be one.  A landscape's walls aren't all
 * that counts: of that the surface with borders is compared with it, unless one place sees it all. */
enum status decide_by_field(struct run *run, const struct mesh *field) MUST_CHECK;

/* Whether a closed mesh of few points may have been found to be none for its walls alone: what of these is lost, its
 * inner or its outer side, spans where no points are. */
enum status decide_may_be_walls(const struct run *run, const struct mesh *closed, bool *may) MUST_CHECK;

/* Whether a height field is tried where a surface of another kind is there. */
bool decide_may_try_field(const struct run *run);

/* Of how many points at least a mesh has to be that decides: small clouds are to be of one kind however many are kept.
 */
size_t decide_enough_of(const struct run *run);

/* Whether so many sites are fewer than that. */
bool decide_are_few(const struct run *run, size_t sites);

/* Principal axes of n points of the normalised frame, the shortest first, and of how many dimensions they are: 0 where
 * they coincide, 3 where they span space, but for what rounding of coordinates makes. */
int pipeline_dimension_of(const vec3 *point, size_t n, vec3 axis[3]);

#endif
