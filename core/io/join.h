/* Several clouds as one: the tiles of a survey, the scans of a building.
 *
 *     struct cloud_join join = {0};
 *     status = cloud_join_add(&join, &cloud, name, error) for each
 *     status = cloud_join_end(&join, &cloud, error), or cloud_join_done(&join)
 *
 * Attributes that say the same (core/cloud/attribute_names.h) become one, of a type that holds all their values and
 * under the first one's name; colours of different depths become 16 bits.  Points of a cloud that lacks an attribute
 * have 0 there (an empty list), and the joined cloud's left_out says so, as it says what couldn't be joined: faces that
 * only some clouds have, lists of different kinds.  Scanners' places are numbered on; numbers of scans with them.
 *
 * Clouds that were LAS stay LAS where their points have the same fields, with a scale that holds them all.  Where
 * others are among them, their coordinate system stays.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_JOIN_H
#define WHITTLE_CORE_IO_JOIN_H

#include "core/base/status.h"
#include "core/cloud/cloud.h"

enum { JOIN_NAME_BYTES = 64, JOIN_SYSTEM_BYTES = 128 };

/* Zero-initialise. */
struct cloud_join {
    size_t inputs;
    struct cloud cloud; /* of those added so far; owned */
    size_t scans;       /* that they have */
    char first[JOIN_NAME_BYTES];
    char system[JOIN_SYSTEM_BYTES], system_of[JOIN_NAME_BYTES]; /* "" = none named one */
    size_t untold;                                              /* inputs that named none, or by name alone */
    size_t lacks[CLOUD_MAX_PROPERTIES];                         /* inputs without this property of the cloud */
    char lacking[CLOUD_MAX_PROPERTIES][JOIN_NAME_BYTES];        /* the first of those */
    bool faces_lost;
};

/* Adds the points of a cloud behind those that are there; takes the cloud, whatever happens.  name (borrowed) is the
 * input's, for messages.  STATUS_MALFORMED: its coordinate system is another one than that of those before;
 * STATUS_LIMIT: more points or properties than a cloud can have; STATUS_NO_MEMORY.  O(points there and added). */
enum status cloud_join_add(struct cloud_join *join, struct cloud *cloud, const char *name,
                           struct error *error) MUST_CHECK;

/* *cloud is the caller's, for cloud_done: of one input, that input as it was.  At least one was added.
 * STATUS_NO_MEMORY.  Ends the join in any case. */
enum status cloud_join_end(struct cloud_join *join, struct cloud *cloud, struct error *error) MUST_CHECK;

/* Ends one that leads to no cloud.  Accepts a zeroed one. */
void cloud_join_done(struct cloud_join *join);

#endif
