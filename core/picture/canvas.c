/* Rows are shared out in bands, and each band looks at all that is drawn, in its order: what a pixel holds doesn't
 * depend on the number of threads.
 *
 * Splats are discs in space, drawn twice: for the nearest depth, then for the means of all that is no farther behind
 * that than a radius, weighted down to the rim.  Neighbouring discs melt into a surface that way, and what is behind
 * shows through nowhere.
 *
 *     Zwicker, Pfister, van Baar, Gross: Surface Splatting, SIGGRAPH 2001 (here without the filter of the screen, whose
 *     work the mean of several samples does)
 *
 * Occlusion is looked for in the depth buffer: what stands out in front of the plane of a pixel, in eight directions
 * and at growing distances, takes light away.
 *
 *     Mittring: Finding Next Gen: CryEngine 2, SIGGRAPH 2007 courses
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/picture/canvas.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"

enum { BAND = 24 };
static const float EDGE_ON = 0.25f; /* a disc is seen at least as wide as this share of its height */

float canvas_linear(unsigned char srgb) {
    float c = (float)srgb / 255;
    return c <= 0.04045f ? c / 12.92f : powf((c + 0.055f) / 1.055f, 2.4f);
}

unsigned char canvas_srgb(float linear) {
    float c = fminf(fmaxf(linear, 0), 1);
    c = c <= 0.0031308f ? 12.92f * c : 1.055f * powf(c, 1 / 2.4f) - 0.055f;
    return (unsigned char)(255 * c + 0.5f);
}

enum status canvas_init(struct canvas *canvas, size_t width, size_t height) {
    struct sample *sample = alloc_array(width * height, sizeof *sample);
    if (!sample) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < width * height; i++) sample[i] = (struct sample){.depth = INFINITY};
    *canvas = (struct canvas){width, height, sample};
    return STATUS_OK;
}

void canvas_done(struct canvas *canvas) {
    free(canvas->sample);
    *canvas = (struct canvas){0};
}

/* ------------------------------------------------------------------------------------------------ splats */

/* Pixels from first to last inclusive whose middles may be within reach of x; none where last < first. */
struct reach {
    long first, last;
};

static struct reach splat_reach(float x, float radius, size_t begin, size_t end) {
    float first = fmaxf(ceilf(x - radius - 0.5f), (float)begin),
          last = fminf(floorf(x + radius - 0.5f), (float)end - 1);
    if (!(first <= last)) return (struct reach){0, -1};
    return (struct reach){(long)first, (long)last};
}

struct splatting {
    struct canvas *canvas;
    const struct splat *splat;
    size_t n;
};

/* The depth of the disc at this offset from its middle, and how far that is from the middle (squared, as a share of the
 * radius); the pixel at the very middle belongs to it however small it is. */
static float disc_depth(const struct splat *s, float dx, float dy, float *share_sq) {
    float facing = fmaxf(s->normal[2], EDGE_ON);
    float rise = (s->normal[0] * dx - s->normal[1] * dy) / facing; /* pixels go down, up goes up */
    *share_sq = (dx * dx + dy * dy + rise * rise) / (s->radius * s->radius);
    return s->depth + rise;
}

static bool is_middle(float dx, float dy) { return fabsf(dx) <= 0.5f && fabsf(dy) <= 0.5f; }

static void blend(struct sample *to, const struct splat *s, float weight, float behind) {
    for (int c = 0; c < 3; c++) to->normal[c] += weight * s->normal[c], to->colour[c] += weight * s->colour[c];
    to->value += weight * s->value;
    to->behind += weight * behind;
    to->weight += weight;
}

static void draw_splat(struct canvas *canvas, const struct splat *s, size_t begin, size_t end, bool nearest) {
    float wide = fmaxf(s->radius, 0.5f);
    struct reach rows = splat_reach(s->y, wide, begin, end), columns = splat_reach(s->x, wide, 0, canvas->width);
    for (long y = rows.first; y <= rows.last; y++) {
        struct sample *row = &canvas->sample[(size_t)y * canvas->width];
        for (long x = columns.first; x <= columns.last; x++) {
            float dx = (float)x + 0.5f - s->x, dy = (float)y + 0.5f - s->y, share;
            float depth = disc_depth(s, dx, dy, &share);
            if (share > 1 && !is_middle(dx, dy)) continue;
            if (nearest)
                row[x].depth = fminf(row[x].depth, depth);
            else if (depth <= row[x].depth + s->radius)
                blend(&row[x], s, fmaxf(1 - share, 0) + 0.02f, depth - row[x].depth);
        }
    }
}

static void splat_bands(void *ctx, size_t begin, size_t end) {
    const struct splatting *all = ctx;
    for (size_t i = 0; i < all->n; i++) draw_splat(all->canvas, &all->splat[i], begin, end, true);
    for (size_t i = 0; i < all->n; i++) draw_splat(all->canvas, &all->splat[i], begin, end, false);
}

void canvas_splats(struct canvas *canvas, const struct splat *splat, size_t n, unsigned threads) {
    struct splatting all = {canvas, splat, n};
    par_for(threads, canvas->height, BAND, splat_bands, &all);
}

/* ------------------------------------------------------------------------------------------------ triangles */

struct filling {
    struct canvas *canvas;
    const struct corner *corner;
    const uint32_t (*triangle)[3];
    size_t n;
};

/* Twice the area of the triangle a b p, positive on one side of the line a b. */
static float side_of(const struct corner *a, const struct corner *b, float x, float y) {
    return (b->x - a->x) * (y - a->y) - (b->y - a->y) * (x - a->x);
}

/* Right, up, towards: of the side that is seen. */
static void facing_normal(const struct corner *const c[3], float normal[3]) {
    float ux = c[1]->x - c[0]->x, uy = c[0]->y - c[1]->y, uz = c[0]->depth - c[1]->depth;
    float vx = c[2]->x - c[0]->x, vy = c[0]->y - c[2]->y, vz = c[0]->depth - c[2]->depth;
    float n[3] = {uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx};
    float length = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]), sign = n[2] < 0 ? -1.0f : 1.0f;
    for (int i = 0; i < 3; i++) normal[i] = length > 0 ? sign * n[i] / length : i == 2;
}

static void fill_triangle(struct canvas *canvas, const struct corner *const c[3], size_t begin, size_t end) {
    float low_x = fminf(c[0]->x, fminf(c[1]->x, c[2]->x)), high_x = fmaxf(c[0]->x, fmaxf(c[1]->x, c[2]->x));
    float low_y = fminf(c[0]->y, fminf(c[1]->y, c[2]->y)), high_y = fmaxf(c[0]->y, fmaxf(c[1]->y, c[2]->y));
    struct reach rows = splat_reach((low_y + high_y) / 2, (high_y - low_y) / 2 + 0.5f, begin, end);
    struct reach columns = splat_reach((low_x + high_x) / 2, (high_x - low_x) / 2 + 0.5f, 0, canvas->width);
    float area = side_of(c[0], c[1], c[2]->x, c[2]->y), normal[3];
    if (area == 0 || rows.last < rows.first) return;
    facing_normal(c, normal);
    for (long y = rows.first; y <= rows.last; y++) {
        struct sample *row = &canvas->sample[(size_t)y * canvas->width];
        for (long x = columns.first; x <= columns.last; x++) {
            float px = (float)x + 0.5f, py = (float)y + 0.5f;
            float a = side_of(c[1], c[2], px, py) / area, b = side_of(c[2], c[0], px, py) / area, d = 1 - a - b;
            if (a < 0 || b < 0 || d < 0) continue;
            float depth = a * c[0]->depth + b * c[1]->depth + d * c[2]->depth;
            if (!(depth < row[x].depth)) continue;
            row[x] = (struct sample){.depth = depth, .weight = 1};
            row[x].value = a * c[0]->value + b * c[1]->value + d * c[2]->value;
            memcpy(row[x].normal, normal, sizeof normal);
            for (int i = 0; i < 3; i++)
                row[x].colour[i] = a * c[0]->colour[i] + b * c[1]->colour[i] + d * c[2]->colour[i];
        }
    }
}

static void fill_bands(void *ctx, size_t begin, size_t end) {
    const struct filling *all = ctx;
    for (size_t i = 0; i < all->n; i++) {
        const uint32_t *t = all->triangle[i];
        const struct corner *const c[3] = {&all->corner[t[0]], &all->corner[t[1]], &all->corner[t[2]]};
        fill_triangle(all->canvas, c, begin, end);
    }
}

void canvas_triangles(struct canvas *canvas, const struct corner *corner, const uint32_t (*triangle)[3], size_t n,
                      unsigned threads) {
    struct filling all = {canvas, corner, triangle, n};
    par_for(threads, canvas->height, BAND, fill_bands, &all);
}

/* ------------------------------------------------------------------------------------------------ light */

/* Unit vectors as right, up, towards, and how much light comes from there: above left, and a little from the right. */
static const float KEY[3] = {-0.480f, 0.640f, 0.600f}, FILL[3] = {0.768f, 0.077f, 0.636f};
static const float KEY_LIGHT = 0.86f, FILL_LIGHT = 0.22f, SKY_LIGHT = 0.30f, GROUND_LIGHT = 0.16f;
/* Of occlusion: what all of it would take, what is left at least, and how far something has to stand out. */
static const float OCCLUSION = 1.5f, LEAST_OPEN = 0.35f, STANDS_OUT = 0.2f;

enum { DIRECTIONS = 8, RINGS = 4, PLACES = DIRECTIONS * RINGS };

/* Where a pixel's surroundings are looked at: whole pixels. */
struct surroundings {
    float dx[PLACES], dy[PLACES], away[PLACES];
};

static struct surroundings look_around(size_t width) {
    static const float towards[DIRECTIONS][2] = {{1, 0},  {0.7071f, 0.7071f},   {0, 1},  {-0.7071f, 0.7071f},
                                                 {-1, 0}, {-0.7071f, -0.7071f}, {0, -1}, {0.7071f, -0.7071f}};
    static const float rings[RINGS] = {0.006f, 0.014f, 0.03f, 0.06f}; /* of the width */
    struct surroundings around;
    for (int i = 0; i < PLACES; i++) {
        around.away[i] = fmaxf(rings[i / DIRECTIONS] * (float)width, 1.5f);
        around.dx[i] = roundf(towards[i % DIRECTIONS][0] * around.away[i]);
        around.dy[i] = roundf(towards[i % DIRECTIONS][1] * around.away[i]);
    }
    return around;
}

static float lit(const float n[3]) {
    float key = n[0] * KEY[0] + n[1] * KEY[1] + n[2] * KEY[2], fill = n[0] * FILL[0] + n[1] * FILL[1] + n[2] * FILL[2];
    float around = GROUND_LIGHT + (SKY_LIGHT - GROUND_LIGHT) * (0.5f + 0.5f * n[1]);
    return around + KEY_LIGHT * (key > 0 ? key : 0) + FILL_LIGHT * (fill > 0 ? fill : 0);
}

static float mean_depth(const struct sample *s) { return s->depth + s->behind / s->weight; }

/* How much of the light is left: 1 in the open. */
static float openness(const struct canvas *canvas, const struct surroundings *around, size_t x, size_t y,
                      const float n[3]) {
    float depth = mean_depth(&canvas->sample[y * canvas->width + x]), taken = 0;
    float facing = n[2] > EDGE_ON ? n[2] : EDGE_ON, slope_x = n[0] / facing, slope_y = -n[1] / facing;
    for (int i = 0; i < PLACES; i++) {
        float sx = (float)x + around->dx[i], sy = (float)y + around->dy[i];
        if (sx < 0 || sy < 0 || sx >= (float)canvas->width || sy >= (float)canvas->height) continue;
        const struct sample *s = &canvas->sample[(size_t)sy * canvas->width + (size_t)sx];
        if (!(s->weight > 0)) continue;
        float there = mean_depth(s), plane = depth + slope_x * around->dx[i] + slope_y * around->dy[i];
        float stands_out = (plane - there) / around->away[i] - STANDS_OUT, nearer = (depth - there) / around->away[i];
        if (stands_out > 0) taken += (stands_out < 1 ? stands_out : 1) / (1 + nearer * nearer / 9);
    }
    return fmaxf(1 - OCCLUSION * taken / PLACES, LEAST_OPEN);
}

struct lighting {
    struct canvas *canvas;
    struct surroundings around;
};

static void light_rows(void *ctx, size_t begin, size_t end) {
    const struct lighting *all = ctx;
    size_t width = all->canvas->width;
    for (size_t i = begin * width; i < end * width; i++) {
        struct sample *s = &all->canvas->sample[i];
        if (!(s->weight > 0)) continue;
        float length = sqrtf(s->normal[0] * s->normal[0] + s->normal[1] * s->normal[1] + s->normal[2] * s->normal[2]);
        float n[3] = {0, 0, 1};
        for (int c = 0; c < 3 && length > 0; c++) n[c] = s->normal[c] / length;
        s->light = lit(n) * openness(all->canvas, &all->around, i % width, i / width, n);
    }
}

void canvas_light(struct canvas *canvas, unsigned threads) {
    struct lighting all = {canvas, look_around(canvas->width)};
    par_for(threads, canvas->height, BAND, light_rows, &all);
}

struct showing {
    const struct canvas *canvas;
    const struct canvas_show *show;
    unsigned char *rgb;
    size_t stride;
};

static void add_sample(const struct canvas_show *show, const struct sample *s, const float background[3],
                       float sum[3]) {
    float colour[3];
    for (int c = 0; c < 3; c++) colour[c] = s->weight > 0 ? s->colour[c] / s->weight : background[c];
    if (show->paint && s->weight > 0) show->paint(show->ctx, s->value / s->weight, colour);
    for (int c = 0; c < 3; c++) sum[c] += fminf(colour[c] * (s->weight > 0 ? s->light : 1), 1);
}

static void show_rows(void *ctx, size_t begin, size_t end) {
    const struct showing *all = ctx;
    size_t factor = all->show->factor, width = all->canvas->width;
    float background[3], share = 1 / (float)(factor * factor);
    for (int c = 0; c < 3; c++) background[c] = canvas_linear(all->show->background[c]);
    for (size_t y = begin; y < end; y++)
        for (size_t x = 0; x < width / factor; x++) {
            const struct sample *first = &all->canvas->sample[y * factor * width + x * factor];
            unsigned char *to = &all->rgb[y * all->stride + 3 * x];
            float sum[3] = {0}, covered = 0;
            for (size_t k = 0; k < factor * factor; k++) {
                const struct sample *s = &first[k / factor * width + k % factor];
                add_sample(all->show, s, background, sum);
                covered += s->weight;
            }
            for (int c = 0; c < 3; c++) to[c] = covered > 0 ? canvas_srgb(sum[c] * share) : all->show->background[c];
        }
}

void canvas_show(const struct canvas *canvas, const struct canvas_show *show, unsigned char *rgb, size_t stride) {
    struct showing all = {canvas, show, rgb, stride};
    par_for(show->threads, canvas->height / show->factor, BAND, show_rows, &all);
}
