/* The simplifier: contraction of virtual edges, in the order of their quadric error (Lee, Jong section 4.4, steps 2 to
 * 6; reference/contract.c is that by the letter).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SIMPLIFY_CONTRACT_H
#define WHITTLE_CORE_SIMPLIFY_CONTRACT_H

#include <stdbool.h>

#include "core/base/progress.h"
#include "core/simplify/adjacency.h"
#include "core/simplify/contraction.h"
#include "core/simplify/quadric.h"

struct contract_options {
    unsigned threads; /* 0 = all processors */
    size_t least;     /* contraction ends where so few points are left, unranked; 0 or 1: at the last */
};

/* Contracts the near->n >= 1 points along the edges of near, which is taken, with placement at one of the two ends. The
 * quadrics are working memory and hold nothing of use afterwards.  The same result for any number of threads.  About
 * O(n k).  STATUS_NO_MEMORY, STATUS_CANCELLED. */
enum status contract(const vec3 *point, struct adjacency *near, struct packed_quadric *quadrics,
                     const struct contract_options *options, const struct progress *progress,
                     struct contraction *out) MUST_CHECK;

/* The weight of a pair's length, which is that of the points' quadrics: of all, or (counted not NULL) of those marked.
 */
double contract_length_bias(const struct packed_quadric *quadrics, const uint8_t *counted, size_t n);

/* contract with a length's weight that is given: of a cloud that has been contracted to these points.  error begins
 * with the largest of what was made before. */
enum status contract_rest(const vec3 *point, struct adjacency *near, struct packed_quadric *quadrics,
                          double length_bias, float error, const struct contract_options *options,
                          const struct progress *progress, struct contraction *out) MUST_CHECK;

/* ------------------------------------------------------------------------------------------------ parts
 *
 * What a pass does to a point depends on the points around it alone, but for two numbers: which of the pairs are among
 * the cheapest.  Given those, a part of a cloud with enough points around it is contracted as in the whole. */

/* The pairs that a pass may take: those that cost less, and of those that cost as much this share, by a hash of where
 * they are. */
struct contract_limit {
    float cost, share;
};

struct contract_part {
    unsigned threads;
    double length_bias;
    size_t passes;                /* at most, where points are counted */
    struct contract_limit *limit; /* passes of them: given, or, where points are counted, found */
    const uint8_t *counted;       /* of each point: it counts for the limits, as a sample; NULL: they are given */
    double least_share;           /* of those that count: no pass is begun with so few left */
    bool keeps_gone;              /* contract_left says which points have gone, too */
};

/* The points that have gone, in the order that they went. */
struct contract_gone {
    size_t n;
    uint32_t *id; /* owned, as all that follows */
    float *cost;  /* of the pair that each went with */
    float *error; /* as of a contraction */
    size_t *end;  /* of each pass: how many had gone after it */
};

/* The points that are left, in the order that they had; what this owns is for contract_left_done. */
struct contract_left {
    size_t n;
    uint32_t *id;                   /* n, ascending; owned */
    struct packed_quadric *quadric; /* n, each about its own point; borrowed: the beginning of those given */
    struct adjacency near;          /* between them, by their places here; owned */
    float error;                    /* as of a contraction, the largest until now */
    size_t passes;                  /* that were made */
    double share;                   /* of the points that count, what is left */
    struct contract_gone gone;      /* zeroed unless that was asked for */
};

/* Makes so many passes, or until few enough of the points that count are left.  As contract otherwise. */
enum status contract_some(const vec3 *point, struct adjacency *near, struct packed_quadric *quadrics,
                          const struct contract_part *part, const struct progress *progress,
                          struct contract_left *left) MUST_CHECK;

/* Accepts a zeroed one. */
void contract_left_done(struct contract_left *left);

#endif
