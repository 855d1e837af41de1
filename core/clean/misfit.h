/* Two scans in one cloud that don't fit each other.
 *
 * Where scans were put together by a registration that is off, a surface that both of them show is there twice.  Points
 * alone don't tell which of the two is true, nor a thin wall's two sides from one side twice.  But files have one scan
 * after the other, so the order of the points tells who belongs to which; and a whole scan is off by one motion, where
 * both sides of a wall are apart along its normal everywhere.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_CLEAN_MISFIT_H
#define WHITTLE_CORE_CLEAN_MISFIT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/math/vec3.h"
#include "core/spatial/knn.h"

struct misfit {
    uint32_t last, first; /* ids: of one scan up to the former, of another from the latter on, none surely between */
    /* How the latter lies off the former, as far as it is along normals: a shift, and radians about axes through a
     * place.  apart: what that comes to at most places. */
    vec3 shift, turn, about;
    double apart;
    bool several; /* there are more than two scans, of which the former are the first */
};

/* How far, and where to, the latter scan is off at a place. */
vec3 misfit_at(const struct misfit *misfit, vec3 place);

/* Looks at some patches of n distinct points, over which knn is, whether they fall apart into two sheets by the points'
 * ids, at the same id everywhere and by one motion.  id[p], below UINT32_MAX: the point's place in the file.
 * *found: *misfit is filled in.  Never of few points, of points in random order, nor where all normals are about the
 * same, as there a motion looks like a board.  O(log n).  The same for any number of threads.  STATUS_NO_MEMORY,
 * STATUS_LIMIT. */
enum status misfit_find(const struct knn *knn, const vec3 *point, const uint32_t *id, size_t n, unsigned threads,
                        bool *found, struct misfit *misfit) MUST_CHECK;

/* Sets is_double[p] to whether p is of the former scan, where there are two and the latter has clearly more points,
 * else of the latter, and the other one has the surface there too, and *count to how many are.  O(n log n).  The same
 * for any number of threads.  STATUS_NO_MEMORY, STATUS_LIMIT. */
enum status misfit_doubles(const vec3 *point, const uint32_t *id, size_t n, const struct misfit *misfit,
                           unsigned threads, uint8_t *is_double, size_t *count) MUST_CHECK;

#endif
