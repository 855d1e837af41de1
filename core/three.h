/* Places and directions as three vectors of numbers: of four doubles or of eight floats, whichever of lanes.h and
 * lanes8.h has been included before.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_THREE_H
#define WHITTLE_CORE_THREE_H

#include "core/processor.h"

struct three {
    lanes x, y, z;
};

INLINE struct three three_sub(struct three a, struct three b) {
    return (struct three){a.x - b.x, a.y - b.y, a.z - b.z};
}
INLINE struct three three_scale(struct three a, lanes s) { return (struct three){a.x * s, a.y * s, a.z * s}; }
INLINE lanes three_dot(struct three a, struct three b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
INLINE struct three three_cross(struct three a, struct three b) {
    return (struct three){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

#endif
