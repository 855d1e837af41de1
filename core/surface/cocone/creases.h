/* Where sheets of the surface meet at the points to be meshed, as the original points tell: on a crease no facet lies
 * along the point's normal, but each along one of the sheets'.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SURFACE_COCONE_CREASES_H
#define WHITTLE_CORE_SURFACE_COCONE_CREASES_H

#include "core/spatial/sheets.h"
#include "core/surface/reconstruct.h"

/* The creases among the points to be meshed: their `of` is the caller's to free, their sheets are borrowed of
 * input->dense.  Zeroed where nothing is known.  O(n).  STATUS_NO_MEMORY. */
enum status cocone_creases_find(const struct reconstruct_input *input, struct creases *creases) MUST_CHECK;

/* The largest cosines between a unit vector, and its opposite, and the normals at a point: those of its sheets, on the
 * side of its oriented normal, or that normal itself. */
struct cocone_cosines {
    double along, against;
};

static inline struct cocone_cosines cocone_creases_cosines(const struct creases *creases, uint32_t point, vec3 normal,
                                                           vec3 direction) {
    const struct sheets *sheets = creases_at(creases, point);
    double cosine = vec3_dot(normal, direction);
    struct cocone_cosines most = {cosine, -cosine};
    if (!sheets) return most;
    most = (struct cocone_cosines){-1, -1};
    for (unsigned k = 0; k < sheets->count; k++) {
        vec3 own = sheets_normal(sheets, k);
        cosine = vec3_dot(own, direction);
        if (vec3_dot(own, normal) < 0) cosine = -cosine;
        most.along = fmax(most.along, cosine), most.against = fmax(most.against, -cosine);
    }
    return most;
}

#endif
