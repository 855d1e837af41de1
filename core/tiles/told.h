/* Kept points that no tile has left: the most important of those that have gone, by the pass in which they went and
 * what that cost, as the whole cloud ranks them.  They take an eighth of what one that is left does on the disk, where
 * twice the input hasn't room for the quadrics and links of all that is kept.
 *
 * After what is left, in left.N:
 *
 *     errors | keys | normals | gaps
 *
 * errors as those of gone.N (left.h); keys, normals (where they are told) and numbers in the input of the tile's points
 * in the order of these numbers, each of which says how far it is on from the one before, 7 bits a byte, the lowest
 * first, all but the last with the eighth.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_TILES_TOLD_H
#define WHITTLE_CORE_TILES_TOLD_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/io/out/sink.h"
#include "core/math/vec3.h"

/* A direction in two numbers of 24 bits: to 3e-7. */
enum { TOLD_NORMAL_BYTES = 6, TOLD_GAP_BYTES = 5 /* at most */ };
struct told_normal {
    unsigned char code[TOLD_NORMAL_BYTES];
};
struct told_normal told_normal_of(vec3 unit);
vec3 told_normal_back(const struct told_normal *normal);

struct told {
    size_t count;
    uint32_t *key;              /* left.h; owned, as all that follows */
    uint32_t *id;               /* in the input */
    struct told_normal *normal; /* NULL: they aren't told */
};

/* Room for n, with normals or without.  STATUS_NO_MEMORY. */
enum status told_new(struct told *told, size_t n, bool with_normals) MUST_CHECK;

/* Accepts a zeroed one. */
void told_done(struct told *told);

/* How many bytes the gaps take, and all of it; writes keys, normals and gaps of those that are in order of numbers. */
size_t told_gap_bytes(const struct told *told);
void told_put(struct sink *sink, const struct told *told);

/* The numbers of n points back, from all of their gaps' bytes: false where it isn't these that the bytes hold. */
bool told_get_ids(const unsigned char *gaps, size_t bytes, uint32_t *id, size_t n);

/* Leaves the `most` most important ones, or all, in that order; of the same key a hash of their numbers decides.
 * STATUS_NO_MEMORY. */
enum status told_rank(struct told *told, size_t most, unsigned threads) MUST_CHECK;

#endif
