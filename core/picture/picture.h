/* What became of a cloud, as a picture: before, after, and how far apart they are, side by side.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PICTURE_PICTURE_H
#define WHITTLE_CORE_PICTURE_PICTURE_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"
#include "core/cloud/cloud.h"
#include "core/mesh/mesh.h"
#include "core/picture/view.h"

/* Rows from above, three bytes of sRGB for each pixel. */
struct picture {
    size_t width, height;
    unsigned char *rgb; /* owned */
};

/* What is shown; everything is borrowed. */
struct picture_scene {
    const struct cloud *cloud; /* before, in its own colours where it has some but black */
    const float (*normal)[3];  /* of each of its points: unit length, either side, or zero; NULL = none are known */
    const float *deviation;    /* of each of its points, in the file's units, >= 0; NULL = there is no third picture */
    const struct mesh *mesh;   /* after; NULL, or without triangles: the kept points are */
    const uint32_t *kept;      /* ids into the cloud */
    size_t kept_count;
    double mean, largest; /* of the deviations, as the report has them */
};

struct picture_view {
    size_t size;               /* pixels: the width of each of the pictures side by side */
    double azimuth, elevation; /* degrees: view_fit; azimuth NAN = the widest side */
    enum view_up up;
};

/* PICTURE_MOST_POINTS of the cloud, and of the kept points, are drawn at most: more than there are pixels of them. */
enum { PICTURE_MOST_POINTS = 250000 };

/* Fills *picture, the caller's, for picture_done.  Same bits for any number of threads (0 = all processors).
 * O(points + size^2), and O(P log P) of the P points drawn.  STATUS_NO_MEMORY. */
enum status picture_make(const struct picture_scene *scene, const struct picture_view *view, unsigned threads,
                         struct picture *picture) MUST_CHECK;

/* Bytes that picture_make holds at most, for so many points: either what fits the camera, or the samples of one canvas
 * and the points drawn with their index, beside the picture. */
enum { PICTURE_FACTOR = 2 /* samples of a pixel along a side */, PICTURE_SAMPLE_BYTES = 48, PICTURE_POINT_BYTES = 150 };
static inline double picture_bytes(double points, size_t size) {
    double drawn = points < PICTURE_MOST_POINTS ? points : PICTURE_MOST_POINTS, pixels = (double)size * (double)size;
    double fit = 8 * points, canvas = PICTURE_FACTOR * PICTURE_FACTOR * PICTURE_SAMPLE_BYTES * pixels;
    double parts = canvas + PICTURE_POINT_BYTES * drawn;
    return 11 * pixels + (fit > parts ? fit : parts);
}

void picture_done(struct picture *picture);

/* The colour, sRGB, of a share of the largest deviation that is shown: 0 = none. */
void picture_deviation_colour(double share, unsigned char rgb[3]);

#endif
