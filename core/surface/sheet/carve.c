/* A point that is off by metres, as of a wrong match of two images, hangs in the air before what is behind it.  A few
 * of them have triangles between them, since they are as far from each other as they are dense:
 *
 *        . . . . . . .  wall       rays to the wall went through the triangle a b, but those to a and b
 *         \ \ | / /
 *          a-----b
 *           \ | /
 *             e
 *
 * The sphere around the place is a cube, whose sides are divided into squares that hold some points each, and how far
 * the nearest of these is.  Places of a triangle are seen through where that is much farther; an empty square tells
 * nothing.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/carve.h"

#include <math.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"

enum { GRAIN = 1024 };
enum { COARSEST = 16, FINEST = 1024, POINTS_EACH = 4 /* of a square that holds some, at most */, SIDES = 6 };
enum { SQUARES_EACH = 8 /* for a point, at most: a camera sees a fifteenth of the sphere, and curves hardly any */ };
static const double BEHIND = 1.2; /* by how far a triangle's place is */

struct surroundings {
    vec3 place;
    int squares;    /* along a side of the cube */
    float *nearest; /* of each square: 0 = it is empty */
};

static int square_on(double x, double along, int squares) {
    int at = (int)((x / along + 1) / 2 * squares);
    return at < 0 ? 0 : at >= squares ? squares - 1 : at;
}

/* Side of the cube, column and row. */
static void find_square(const struct surroundings *around, vec3 d, int at[3]) {
    double x = fabs(d.x), y = fabs(d.y), z = fabs(d.z), most = fmax(x, fmax(y, z));
    double u = x >= y && x >= z ? d.y : d.x, v = x < z && y < z ? d.y : d.z;
    if (!(x >= y && x >= z) && y >= z) u = d.x, v = d.z;
    at[0] = x >= y && x >= z ? d.x < 0 : y >= z ? 2 + (d.y < 0) : 4 + (d.z < 0);
    at[1] = square_on(u, fmax(most, 1e-30), around->squares), at[2] = square_on(v, fmax(most, 1e-30), around->squares);
}

static size_t number_of(const struct surroundings *around, const int at[3]) {
    size_t squares = (size_t)around->squares;
    return ((size_t)at[0] * squares + (size_t)at[1]) * squares + (size_t)at[2];
}

/* Fills the squares; how many hold some. */
static size_t fill_squares(struct surroundings *around, const vec3 *point, size_t n) {
    size_t all = 6 * (size_t)around->squares * (size_t)around->squares, held = 0;
    for (size_t i = 0; i < all; i++) around->nearest[i] = 0;
    for (size_t i = 0; i < n; i++) {
        int at[3];
        vec3 d = vec3_sub(point[i], around->place);
        find_square(around, d, at);
        float *nearest = &around->nearest[number_of(around, at)], distance = fmaxf((float)vec3_length(d), 1e-30F);
        held += *nearest == 0;
        if (*nearest == 0 || distance < *nearest) *nearest = distance;
    }
    return held;
}

enum look { NOTHING, ON, THROUGH };

static enum look look_at(const struct surroundings *around, vec3 p) {
    int at[3];
    vec3 d = vec3_sub(p, around->place);
    find_square(around, d, at);
    double nearest = (double)around->nearest[number_of(around, at)];
    return nearest == 0 ? NOTHING : nearest > BEHIND * vec3_length(d) ? THROUGH : ON;
}

static bool is_seen_through(const struct surroundings *around, const struct mesh *mesh, size_t t) {
    const uint32_t *v = mesh->triangle[t];
    size_t looks[] = {[NOTHING] = 0, [ON] = 0, [THROUGH] = 0};
    for (int i = 0; i <= SIDES; i++)
        for (int k = 0; i + k <= SIDES; k++) {
            double a = (double)i / SIDES, b = (double)k / SIDES;
            vec3 p = vec3_add(vec3_scale(mesh->vertex[v[0]], 1 - a - b),
                              vec3_add(vec3_scale(mesh->vertex[v[1]], a), vec3_scale(mesh->vertex[v[2]], b)));
            looks[look_at(around, p)]++;
        }
    return looks[THROUGH] > looks[ON];
}

/* Whether it is told by few squares that no place of a triangle is seen through, as of most it is: those around its
 * corners' ones, if all are on one side of the cube, hold nothing that is much farther than the triangle may be. */
static bool is_told_by_squares(const struct surroundings *around, const struct mesh *mesh, size_t t) {
    enum { FEW = 9 };
    static const double ROUNDING = 1 - 1e-6;
    const uint32_t *v = mesh->triangle[t];
    int low[3], high[3];
    double range = INFINITY, edge = 0;
    for (int k = 0; k < 3; k++) {
        vec3 p = mesh->vertex[v[k]], d = vec3_sub(p, around->place);
        int at[3];
        find_square(around, d, at);
        for (int i = 0; i < 3; i++) {
            low[i] = k == 0 || at[i] < low[i] ? at[i] : low[i];
            high[i] = k == 0 || at[i] > high[i] ? at[i] : high[i];
        }
        range = fmin(range, vec3_length_sq(d));
        edge = fmax(edge, vec3_distance_sq(p, mesh->vertex[v[(k + 1) % 3]]));
    }
    if (low[0] != high[0] || (high[1] - low[1] + 1) * (high[2] - low[2] + 1) > FEW) return false;
    double most = BEHIND * ROUNDING * (sqrt(range) - sqrt(edge));
    for (int column = low[1]; column <= high[1]; column++)
        for (int row = low[2]; row <= high[2]; row++)
            if ((double)around->nearest[number_of(around, (int[]){low[0], column, row})] > most) return false;
    return true;
}

struct carving {
    const struct surroundings *around;
    const struct mesh *mesh;
    uint8_t *out;
};

static void carve_range(void *ctx, size_t begin, size_t end) {
    const struct carving *carving = ctx;
    for (size_t t = begin; t < end; t++)
        carving->out[t] = !is_told_by_squares(carving->around, carving->mesh, t) &&
                          is_seen_through(carving->around, carving->mesh, t);
}

enum status carve_seen_through(const struct mesh *mesh, const vec3 *point, size_t n, vec3 place, unsigned threads,
                               uint8_t *out) {
    struct surroundings around = {.place = place};
    struct carving carving = {&around, mesh, out};
    int finest = COARSEST;
    while (finest < FINEST && 6 * 4 * (size_t)finest * (size_t)finest <= SQUARES_EACH * n) finest *= 2;
    around.nearest = alloc_array(6 * (size_t)finest * (size_t)finest, sizeof *around.nearest);
    if (!around.nearest) return STATUS_NO_MEMORY;
    for (around.squares = COARSEST; around.squares <= finest; around.squares *= 2)
        if (n <= POINTS_EACH * fill_squares(&around, point, n) || around.squares == finest) break;
    par_for(threads, mesh->triangle_count, GRAIN, carve_range, &carving);
    free(around.nearest);
    return STATUS_OK;
}
