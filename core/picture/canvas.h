/* A depth buffer that splats and triangles are drawn into, and its shading.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_PICTURE_CANVAS_H
#define WHITTLE_CORE_PICTURE_CANVAS_H

#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

/* What is seen in a pixel: sums over what was drawn there, to be divided by weight; weight 0 = nothing. */
struct sample {
    float depth;     /* of the nearest */
    float behind;    /* that the others are, not negative */
    float normal[3]; /* right, up, towards; of any length */
    float colour[3]; /* linear light, 0 .. 1 */
    float value;
    float weight;
    float light; /* that comes there; set by canvas_light */
};

struct canvas {
    size_t width, height;
    struct sample *sample; /* row by row from above; owned */
};

/* A disc in space: its middle in pixels (view_project), its radius in pixels, its normal (unit, towards.z >= 0). */
struct splat {
    float x, y, depth, radius;
    float normal[3], colour[3], value;
};

/* A corner of a triangle. */
struct corner {
    float x, y, depth;
    float colour[3], value;
};

/* An empty canvas, to be given to canvas_done.  STATUS_NO_MEMORY. */
enum status canvas_init(struct canvas *canvas, size_t width, size_t height) MUST_CHECK;
void canvas_done(struct canvas *canvas);

/* Draws n splats.  Those that lie on each other within a radius are blended, so that they look like one surface.  On up
 * to `threads` threads; same bits for any number.  O(bands n + pixels covered). */
void canvas_splats(struct canvas *canvas, const struct splat *splat, size_t n, unsigned threads);

/* Draws n triangles, flat; corner holds what triangle refers to.  Both sides are seen.  Likewise. */
void canvas_triangles(struct canvas *canvas, const struct corner *corner, const uint32_t (*triangle)[3], size_t n,
                      unsigned threads);

/* Lights what was drawn from above left, and darkens what lies deep: once, when all is drawn.  On up to `threads`
 * threads. */
void canvas_light(struct canvas *canvas, unsigned threads);

/* Shows what was lit.  paint (NULL = the samples' own colours) gives the colour in linear light of a value.  Each pixel
 * of rgb (width / factor x height / factor, sRGB, `stride` bytes from row to row) is the mean of factor x factor
 * samples; where there is nothing the background (sRGB) shows. */
struct canvas_show {
    void (*paint)(void *ctx, float value, float colour[3]);
    void *ctx;
    unsigned char background[3];
    unsigned factor, threads;
};
void canvas_show(const struct canvas *canvas, const struct canvas_show *show, unsigned char *rgb, size_t stride);

/* Between 8 bits of sRGB and linear light. */
float canvas_linear(unsigned char srgb);
unsigned char canvas_srgb(float linear);

#endif
