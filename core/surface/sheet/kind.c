/* Two things tell sheets from solids.
 *
 * Seen along any direction a solid has a back: points lie above each other.  A sheet of terrain, or what is seen from
 * one place, has none along the right direction.  Of some points the nearest ones in the plane across the direction are
 * looked at: where several of them are much higher or lower than they are far, or off the tangent plane by more than
 * that, there is a layer above or below, or a wall.
 *
 *      . ' . '  one layer       . ' . '
 *                               . . ' .  two
 *
 * And a closed mesh of a sheet, or of a room, has a lid over what wasn't scanned, where no points are.  Where that is
 * small it may be the bottom of a statue, or the scan may have no inside, and its closed mesh goes to and fro between
 * its walls: far from some points, or through them, but not as they lie, with more area than a mesh with borders and
 * across their normals.
 *
 * Source of the limits: measured on scans and solids, core/surface/DECISIONS.md.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/kind.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/math/quantile.h"
#include "core/math/sym3.h"
#include "core/spatial/bvh.h"

enum { SAMPLES = 2000, NEAR = 9, ABOVE = 3 /* of those near, so many make a layer */, RINGS = 3 };
enum { MANY_STRAYS = 50 /* one of so many points */ };
enum { BOX_SAMPLES = 2048, CROWD = 256 };
enum { GRAIN = 4096, LOOKS_GRAIN = 64 };
static const double MARGIN = 0.01;       /* so many points on either side may be strays */
static const double HEIGHT = 6, OFF = 2; /* of the distance of the farthest of those near, in the plane */
static const double LEANS = 0.5;         /* cosine to the direction: below, the surface is steep */
static const double FIELD_LAYERED = 0.1, FIELD_STEEP = 0.15, OPEN_LAYERED = 0.4, SURE_LAYERED = 0.35;
static const struct sheet_limit LID_FAR = {3, INFINITY, 0, 0, 0}, FIELD_FAR = {5, 4.5, 0, 0, 0};
static const double RIM_MEDIANS = 6;
static const double OPEN_LID = 0.07, SURE_CLOSED = 0.004, SURE_OPEN = 0.12;
static const double FIELD_LID = 0.01; /* as much of a mesh may be far from all points */
/* Trees and roofs stand over ground, but little of them leans; a height field of them goes down their sides. */
static const double LANDSCAPE_LAYERED = 0.25, LANDSCAPE_STEEP = 0.25, LANDSCAPE_LID = 0.4;
/* Of a landscape's that one place sees, or may, as it is steep: steps to what is behind. */
static const double SEEN_LID = 0.05, STEPS_STEEP = 0.1;
static const double CITY_LAYERED = 0.45, CITY_STEEP = 0.13; /* walls; crowns that one sees through are less steep */
static const double ONE_PLACE = 0.03; /* what is seen from one place, as a depth image, is layered less */
static const double UPRIGHT = 0.9;    /* cosine of z and the direction that a landscape is seen from best */
static const double ALIKE = 0.9;      /* unevenness in the plane: from above each part of it is seen as well */
static const double WOODS_STEEP = 0.37, WOODS_ALIKE = 0.55; /* conifers, whose crowns are steep */
static const double ABOVE_STEEP = 0.4, ABOVE_ALIKE = 1.15;  /* what is seen from above, whatever its surface is */
/* A mesh with borders takes the place of a closed one that isn't surely right where
 * - the points are so many times as far from the closed one, or, of one that faces what it sees as a room does, */
static const double NEARER = 1.2, NEARER_INWARDS = 0.93;
/* - the closed one has so many times its area and leans so much more across the points' normals, and the points are
 *   at most so many times as far from the one with borders, by either pair, */
static const double LESS_AREA = 1.2, AS_NEAR = 2, LITTLE_LESS = 1.1, NEARLY_AS_NEAR = 1.4, MORE_LEANING = 1.4;
/* where what is off by so much of the points' spacing is as near as a mesh that goes through all of them, */
static const double HARDLY_OFF = 0.01;
/* - or the closed one has so many times its area, and it misses at most so many of the points more. */
static const double FAR_LESS_AREA = 2.4, UNCOVERED = 0.1;
/* - or the closed one leans so much across the points' normals that it isn't their skin, and the other misses at most
 * so many of them more: foliage has .375 to .42 at all ratios, random directions .5, solids .02 to .3; or it leans
 * less, as where rocks are among trees (.32), has so many times the area (LESS_AREA), and the points are hardly nearer.
 */
static const double ACROSS = 0.33, PARTLY_ACROSS = 0.25, HARDLY_LESS = 0.9;
/* A height field of many points that isn't nearer than so many times what one of few is has walls. */
static const double HARDLY_NEARER = 0.75;
static const double WEIGHED_LAYERED = 0.7; /* more is a solid's, or a room's */
/* A height field takes the place of another surface from which the points are so much nearer at most; from solids of
 * such signs fields are twice as far or more, so a closed mesh goes even for one that is farther.  Where it alone is of
 * more points than are kept it would be .77 to .95 times as far for that; where it was left for its steps both are of
 * as many, and it has to be nearer. */
static const double HARDLY_FARTHER = 1.2, HARDLY_FARTHER_OF_MORE = 1.05, FARTHER_THAN_CLOSED = 1.4;
static const double NEARER_AFTER_ALL = 0.95;
/* Of points that fill a volume, as leaves do, no surface goes through all; of few of them a field is so much farther.
 */
static const double VOLUME_FARTHER = 1.75;
static const double LARGEST_TOLD = 1000;
static const double FAR_SPACINGS = 3, MISSED_SPACINGS = 1.5;
enum { MATCHED = 16384, MATCHED_AT_ONCE = 1024 /* points */ };
enum { SIGNS_LEAST = 1000 /* points that signs can be read off */ };

/* Points by the cells of a grid in the plane across a direction.  The cells are as large as the density of most points
 * has it, so that strays don't make all others one cell's; what lies beyond them is in the outermost ones. */
struct grid {
    vec3 u, v;
    double low[2], side;
    size_t cells[2];
    uint32_t *begin, *point; /* begin: one more than cells */
};

static size_t grid_cell(const struct grid *g, double x, int axis) {
    double at = floor((x - g->low[axis]) / g->side);
    return at <= 0 ? 0 : at >= (double)g->cells[axis] ? g->cells[axis] - 1 : (size_t)at;
}

static size_t cell_at(const struct grid *g, vec3 p) {
    return grid_cell(g, vec3_dot(p, g->v), 1) * g->cells[0] + grid_cell(g, vec3_dot(p, g->u), 0);
}

/* The extent of most of n points along an axis, by some of them. */
static double extent_along(const vec3 *point, size_t n, vec3 axis, double *low) {
    float at[BOX_SAMPLES];
    size_t count = n < BOX_SAMPLES ? n : BOX_SAMPLES;
    for (size_t i = 0; i < count; i++) at[i] = (float)vec3_dot(point[i * n / count], axis);
    *low = (double)quantile_of(at, count, MARGIN);
    double extent = (double)quantile_of(at, count, 1 - MARGIN) - *low;
    *low -= MARGIN * extent;
    return extent * (1 + 2 * MARGIN);
}

/* The cell of each point. */
struct cells {
    const struct grid *grid;
    const vec3 *point;
    uint32_t *cell;
};

static void cells_range(void *ctx, size_t begin, size_t end) {
    const struct cells *cells = ctx;
    for (size_t i = begin; i < end; i++) cells->cell[i] = (uint32_t)cell_at(cells->grid, cells->point[i]);
}

static enum status grid_init(struct grid *g, const vec3 *point, size_t n, vec3 up, unsigned threads) {
    vec3_basis(up, &g->u, &g->v);
    double x = extent_along(point, n, g->u, &g->low[0]), y = extent_along(point, n, g->v, &g->low[1]);
    g->side = fmax(sqrt(x * y * NEAR / (double)n), fmax(x, y) * NEAR / (double)n);
    g->cells[0] = g->side > 0 ? (size_t)(x / g->side) + 1 : 1;
    g->cells[1] = g->side > 0 ? (size_t)(y / g->side) + 1 : 1;
    size_t cells = g->cells[0] * g->cells[1];
    g->begin = alloc_zeroed(cells + 2, sizeof *g->begin);
    g->point = alloc_array(n, sizeof *g->point);
    struct cells of = {g, point, alloc_array(n, sizeof *of.cell)};
    bool ok = g->begin && g->point && of.cell;
    if (ok) {
        par_for(threads, n, GRAIN, cells_range, &of);
        for (size_t i = 0; i < n; i++) g->begin[of.cell[i] + 2]++;
        for (size_t c = 1; c < cells + 2; c++) g->begin[c] += g->begin[c - 1];
        for (uint32_t i = 0; i < n; i++) g->point[g->begin[of.cell[i] + 1]++] = i;
    }
    free(of.cell);
    return ok ? STATUS_OK : STATUS_NO_MEMORY;
}

struct neighbour {
    double distance_sq; /* in the plane */
    uint32_t id;
};

static void insert(struct neighbour near[NEAR], size_t *count, struct neighbour new) {
    if (*count == NEAR && new.distance_sq >= near[NEAR - 1].distance_sq) return;
    size_t i = *count < NEAR ? (*count)++ : NEAR - 1;
    for (; i > 0 && near[i - 1].distance_sq > new.distance_sq; i--) near[i] = near[i - 1];
    near[i] = new;
}

/* The nearest in the plane, of those in the cells up to so many rings away; of very many in a cell an even choice. */
static size_t find_near(const struct grid *g, const vec3 *point, uint32_t p, size_t rings,
                        struct neighbour near[NEAR]) {
    size_t count = 0, x = grid_cell(g, vec3_dot(point[p], g->u), 0), y = grid_cell(g, vec3_dot(point[p], g->v), 1);
    for (size_t j = y < rings ? 0 : y - rings; j <= y + rings && j < g->cells[1]; j++)
        for (size_t i = x < rings ? 0 : x - rings; i <= x + rings && i < g->cells[0]; i++) {
            const uint32_t *begin = &g->begin[j * g->cells[0] + i];
            for (uint32_t k = begin[0]; k < begin[1]; k += 1 + (begin[1] - begin[0]) / CROWD) {
                vec3 to = vec3_sub(point[g->point[k]], point[p]);
                double a = vec3_dot(to, g->u), b = vec3_dot(to, g->v);
                if (g->point[k] != p) insert(near, &count, (struct neighbour){a * a + b * b, g->point[k]});
            }
        }
    return count;
}

static bool is_layered(const struct grid *g, const vec3 *point, vec3 normal, vec3 up, uint32_t p) {
    struct neighbour near[NEAR];
    size_t count = 0;
    unsigned above = 0;
    for (size_t rings = 1; rings <= RINGS && count < NEAR; rings++) count = find_near(g, point, p, rings, near);
    for (size_t k = 0; k < count; k++) {
        vec3 to = vec3_sub(point[near[k].id], point[p]);
        double reach = sqrt(near[count - 1].distance_sq);
        above += fabs(vec3_dot(to, up)) > HEIGHT * reach || fabs(vec3_dot(to, normal)) > OFF * reach;
    }
    return above >= ABOVE;
}

/* Standard deviation of the number of points in the cells that have any, by their mean. */
static double unevenness(const struct grid *g) {
    double occupied = 0, sum = 0, squares = 0;
    for (size_t c = 0; c < g->cells[0] * g->cells[1]; c++) {
        double count = g->begin[c + 1] - g->begin[c];
        occupied += count > 0, sum += count, squares += count * count;
    }
    return sum > 0 ? sqrt(fmax(0, squares * occupied / (sum * sum) - 1)) : 0;
}

/* Some of the points, seen along a direction. */
struct looks {
    const struct grid *grid;
    const vec3 *point, *normal;
    size_t n, samples;
    vec3 up;
    bool layered[SAMPLES];
};

static void layers_range(void *ctx, size_t begin, size_t end) {
    struct looks *looks = ctx;
    for (size_t i = begin; i < end; i++) {
        uint32_t p = (uint32_t)(i * looks->n / looks->samples);
        looks->layered[i] = is_layered(looks->grid, looks->point, looks->normal[p], looks->up, p);
    }
}

static enum status look_along(const vec3 *point, const vec3 *normal, size_t n, vec3 up, unsigned threads,
                              struct surface_signs *signs) {
    struct grid grid = {0};
    enum status status = grid_init(&grid, point, n, up, threads);
    size_t samples = n < SAMPLES ? n : SAMPLES, layered = 0, steep = 0;
    struct looks looks = {.grid = &grid, .point = point, .normal = normal, .n = n, .samples = samples, .up = up};
    if (!status) par_for(threads, samples, LOOKS_GRAIN, layers_range, &looks);
    for (size_t i = 0; i < samples && !status; i++) {
        layered += looks.layered[i];
        steep += fabs(vec3_dot(normal[i * n / samples], up)) < LEANS;
    }
    if (!status)
        *signs = (struct surface_signs){n, up, (double)layered / (double)samples, (double)steep / (double)samples,
                                        unevenness(&grid)};
    free(grid.begin), free(grid.point);
    return status;
}

/* Largest component positive. */
static vec3 upwards(vec3 axis) {
    double x = fabs(axis.x), y = fabs(axis.y), z = fabs(axis.z);
    double largest = z >= x && z >= y ? axis.z : y >= x ? axis.y : axis.x;
    return largest < 0 ? vec3_scale(axis, -1) : axis;
}

static bool is_field(const struct surface_signs *signs) {
    return signs->layered < FIELD_LAYERED && signs->steep < FIELD_STEEP;
}

bool surface_is_landscape(const struct surface_signs *signs) {
    bool layered = signs->layered > ONE_PLACE && signs->layered < CITY_LAYERED;
    bool woods = signs->steep < WOODS_STEEP && signs->uneven < WOODS_ALIKE;
    return layered && (signs->steep < LANDSCAPE_STEEP || woods) && signs->up.z > UPRIGHT && signs->uneven < ALIKE;
}

bool surface_is_from_above(const struct surface_signs *signs) {
    bool from_above = signs->layered > ONE_PLACE && signs->layered < CITY_LAYERED && signs->up.z > UPRIGHT;
    return from_above && signs->steep < ABOVE_STEEP && signs->uneven < ABOVE_ALIKE;
}

enum status surface_signs_of(const vec3 *point, const vec3 *normal, size_t n, unsigned threads,
                             struct surface_signs *signs) {
    sym3 spread = {0}, normals = {0};
    vec3 mean = {0, 0, 0}, axis[3], along[3];
    double value[3];
    for (size_t i = 0; i < n; i++) mean = vec3_add(mean, point[i]);
    mean = vec3_scale(mean, 1 / (double)n);
    for (size_t i = 0; i < n; i++) {
        spread = sym3_add(spread, sym3_outer(vec3_sub(point[i], mean)));
        normals = sym3_add(normals, sym3_outer(normal[i]));
    }
    sym3_eigen(spread, value, axis);
    sym3_eigen(normals, value, along);
    vec3 ups[] = {{0, 0, 1}, upwards(axis[0]), upwards(along[2])};
    enum status status = look_along(point, normal, n, ups[0], threads, signs);
    for (int i = 1; i < 3 && !status && !is_field(signs); i++) {
        struct surface_signs other;
        status = look_along(point, normal, n, ups[i], threads, &other);
        if (!status && (is_field(&other) || other.layered < signs->layered)) *signs = other;
    }
    return status;
}

static int percent(double share) { return (int)lround(100 * share); }

bool surface_choose_by_signs(const struct surface_signs *signs, struct surface_choice *choice) {
    bool as_field = signs->layered < LANDSCAPE_LAYERED || signs->steep > CITY_STEEP; /* if it is a landscape */
    bool field = is_field(signs) || (surface_is_landscape(signs) && as_field);
    if (signs->points < SIGNS_LEAST || (!field && signs->layered >= OPEN_LAYERED)) return false;
    choice->up = signs->up;
    choice->form = field ? SURFACE_HEIGHTFIELD : SURFACE_OPEN;
    choice->sure = signs->layered < SURE_LAYERED;
    if (choice->form == SURFACE_HEIGHTFIELD)
        snprintf(choice->reason, sizeof choice->reason,
                 "seen along (%.2f, %.2f, %.2f), %d %% of the points have others above or below them", signs->up.x,
                 signs->up.y, signs->up.z, percent(signs->layered));
    else
        snprintf(choice->reason, sizeof choice->reason,
                 "a solid has a back, but seen along (%.2f, %.2f, %.2f) %d %% of the points alone have others above or "
                 "below them",
                 signs->up.x, signs->up.y, signs->up.z, percent(signs->layered));
    return true;
}

/* Marks the vertices whose triangles don't count: strays, and where there are many, as outliers, what is beside them.
 * aside: all zero. */
static void set_aside(const struct mesh *mesh, const struct sheet_points *points, uint8_t *aside) {
    enum { STRAY = 1, BESIDE = 2 };
    size_t count = 0;
    for (size_t v = 0; points->stray && v < mesh->vertex_count; v++)
        count += aside[v] = points->stray[mesh->source[v]] ? STRAY : 0;
    if (count * MANY_STRAYS < mesh->vertex_count) return;
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangle[t];
        if (aside[v[0]] != STRAY && aside[v[1]] != STRAY && aside[v[2]] != STRAY) continue;
        for (int k = 0; k < 3; k++)
            if (!aside[v[k]]) aside[v[k]] = BESIDE;
    }
}

/* The part of a mesh's area that is far, without what is set aside. */
static double far_area(const struct mesh *mesh, const uint8_t *aside, const float *far) {
    double all = 0, without = 0;
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        const uint32_t *v = mesh->triangle[t];
        if (aside[v[0]] || aside[v[1]] || aside[v[2]]) continue;
        double area = vec3_length(mesh_triangle_normal(mesh, t));
        all += area;
        without += area * (double)far[t];
    }
    return all > 0 ? without / all : 0;
}

enum status surface_lid_of(const struct mesh *mesh, const struct sheet_points *points, enum surface_form of,
                           unsigned threads, struct surface_lid *lid) {
    uint8_t *aside = alloc_zeroed(mesh->vertex_count, 1);
    float *far = alloc_array(mesh->triangle_count, sizeof *far),
          *to_rims = alloc_array(mesh->triangle_count, sizeof *far);
    bool field = of == SURFACE_HEIGHTFIELD;
    struct sheet_limit limit = field ? FIELD_FAR : LID_FAR;
    enum status status = aside && far && to_rims ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status)
        status = sheet_far_share(mesh, points, limit, field ? limit.medians : RIM_MEDIANS, threads, far, to_rims);
    if (!status) {
        set_aside(mesh, points, aside);
        *lid = (struct surface_lid){far_area(mesh, aside, far), far_area(mesh, aside, to_rims)};
    }
    free(aside), free(far), free(to_rims);
    return status;
}

void surface_choose_by_lid(const struct surface_signs *signs, const struct surface_lid *lid,
                           struct surface_choice *choice) {
    choice->up = signs->up;
    choice->form = lid->share > OPEN_LID ? SURFACE_OPEN : SURFACE_CLOSED;
    choice->sure = lid->share > SURE_OPEN || lid->to_rims < SURE_CLOSED;
    snprintf(choice->reason, sizeof choice->reason,
             "a first closed mesh, tried for this, had %.1f %% of its area where there are no points; an open one is "
             "made from %.1f %% on",
             100 * lid->share, 100 * OPEN_LID);
}

bool surface_may_have_steps(const struct surface_signs *signs, double share) {
    return surface_is_landscape(signs) && share > SEEN_LID;
}

bool surface_leave_field(const struct surface_signs *signs, double share, bool seen, struct surface_choice *choice) {
    double landscape = seen || signs->steep > STEPS_STEEP ? SEEN_LID : LANDSCAPE_LID;
    if (share <= (surface_is_landscape(signs) ? landscape : FIELD_LID)) return false;
    choice->form = SURFACE_OPEN;
    snprintf(choice->reason, sizeof choice->reason,
             "seen along (%.2f, %.2f, %.2f) there are steps or walls: a height field has %.1f %% of its area where "
             "there are no points",
             choice->up.x, choice->up.y, choice->up.z, 100 * share);
    return true;
}

bool surface_leave_walls(const struct surface_signs *signs, const struct surface_match *few,
                         const struct surface_match *many, struct surface_choice *choice) {
    if (signs->layered < FIELD_LAYERED || many->distance <= HARDLY_NEARER * few->distance) return false;
    choice->form = SURFACE_OPEN;
    choice->sure = false;
    snprintf(choice->reason, sizeof choice->reason,
             "seen along (%.2f, %.2f, %.2f) there are walls: of a height field of many points these are %.1f times as "
             "far as of one of few",
             choice->up.x, choice->up.y, choice->up.z, fmin(many->distance / few->distance, LARGEST_TOLD));
    return true;
}

bool surface_may_be_field(const struct surface_signs *signs, bool volume) {
    bool layered = signs->layered > ONE_PLACE && (volume || signs->layered < WEIGHED_LAYERED);
    return layered && signs->up.z > UPRIGHT && signs->uneven < ABOVE_ALIKE && signs->points >= SIGNS_LEAST;
}

bool surface_take_field(const struct surface_signs *signs, const struct surface_match *other,
                        const struct surface_match *field, bool of_more, bool left, struct surface_choice *choice) {
    bool closed = choice->form == SURFACE_CLOSED;
    double most = left      ? NEARER_AFTER_ALL
                  : closed  ? FARTHER_THAN_CLOSED
                  : of_more ? HARDLY_FARTHER_OF_MORE
                            : HARDLY_FARTHER;
    bool evenly_seen = signs->uneven < WOODS_ALIKE;
    bool misses_few = field->missed < other->missed + UNCOVERED || field->distance < VOLUME_FARTHER * other->distance;
    bool none_is_near = choice->volume && evenly_seen && misses_few;
    if (!(field->distance > 0) || (field->distance > most * other->distance && !none_is_near)) return false;
    choice->form = SURFACE_HEIGHTFIELD, choice->up = signs->up, choice->sure = false;
    snprintf(
        choice->reason, sizeof choice->reason,
        "seen from above, %d %% of the points have others above or below them, but they are only %.2f times as far "
        "from a height field as from a %s",
        percent(signs->layered), field->distance / other->distance, closed ? "closed mesh" : "surface with borders");
    return true;
}

/* Distances of some of the points to a mesh. */
static enum status find_distances(const struct mesh *mesh, const struct surface_points *points, unsigned threads,
                                  struct surface_match *match) {
    struct bvh *bvh = NULL;
    struct bvh_hit hit[MATCHED_AT_ONCE];
    vec3 p[MATCHED_AT_ONCE];
    size_t each = 1 + points->n / MATCHED, count = 0, sampled = (points->n + each - 1) / each;
    double sum = 0, missed = 0, spacings = 0;
    enum status status = bvh_new(mesh, threads, &bvh);
    for (size_t first = 0; !status && first < sampled; first += count) {
        count = sampled - first < MATCHED_AT_ONCE ? sampled - first : MATCHED_AT_ONCE;
        for (size_t i = 0; i < count; i++) p[i] = points->point[(first + i) * each];
        bvh_closest_all(bvh, p, count, threads, hit);
        for (size_t i = 0; i < count; i++) {
            double distance = sqrt(hit[i].distance_sq), spacing = (double)points->spacing[(first + i) * each];
            sum += fmin(distance, FAR_SPACINGS * spacing);
            spacings += spacing;
            missed += distance > MISSED_SPACINGS * spacing;
        }
    }
    bvh_free(bvh);
    match->distance = sum / (double)sampled;
    match->spacing = spacings / (double)sampled;
    match->missed = missed / (double)sampled;
    return status;
}

enum status surface_match_of(const struct mesh *mesh, const struct surface_points *points, unsigned threads,
                             struct surface_match *match) {
    double along = 0;
    *match = (struct surface_match){0};
    if (mesh->triangle_count == 0) return STATUS_OK;
    for (size_t t = 0; t < mesh->triangle_count; t++) {
        vec3 normal = mesh_triangle_normal(mesh, t); /* as long as twice the area */
        match->area += vec3_length(normal) / 2;
        for (int k = 0; k < 3; k++)
            along += fabs(vec3_dot(normal, points->normal[mesh->source[mesh->triangle[t][k]]])) / 6;
    }
    match->leaning = match->area > 0 ? 1 - along / match->area : 0;
    return find_distances(mesh, points, threads, match);
}

/* Whether the points are at most so many times as far from it as from the other. */
static bool is_as_near(const struct surface_match *mesh, const struct surface_match *other, double times) {
    return mesh->distance <= fmax(times * other->distance, HARDLY_OFF * other->spacing);
}

bool surface_leave_away(const struct surface_match *closed, const struct surface_match *open,
                        struct surface_choice *choice) {
    if (!(open->area > 0) || open->missed >= closed->missed + UNCOVERED) return false;
    choice->form = SURFACE_OPEN;
    choice->sure = true;
    snprintf(choice->reason, sizeof choice->reason,
             "the outside of a closed mesh, or a part of it, faces away from where the points were seen from");
    return true;
}

bool surface_leave_room(const struct surface_match *closed, const struct surface_match *open, double hidden,
                        struct surface_choice *choice) {
    if (!(open->area > 0) || open->missed >= UNCOVERED || !is_as_near(open, closed, AS_NEAR)) return false;
    choice->form = SURFACE_OPEN;
    choice->sure = false, choice->room = true;
    snprintf(choice->reason, sizeof choice->reason,
             "all can be seen from within, as of a room, but %d %% of it can't from outside", percent(hidden));
    return true;
}

bool surface_leave_closed(const struct surface_match *closed, const struct surface_match *open, bool inwards,
                          struct surface_choice *choice) {
    bool nearer = closed->distance > (inwards ? NEARER_INWARDS : NEARER) * open->distance;
    bool less = closed->area > LESS_AREA * open->area && is_as_near(open, closed, AS_NEAR);
    bool lid = closed->area > LITTLE_LESS * open->area && is_as_near(open, closed, NEARLY_AS_NEAR);
    bool leaner = (less || lid) && closed->leaning > MORE_LEANING * open->leaning;
    bool wider = closed->area > FAR_LESS_AREA * open->area && open->missed < closed->missed + UNCOVERED;
    bool partly = closed->leaning > PARTLY_ACROSS && closed->area > LESS_AREA * open->area &&
                  closed->distance > HARDLY_LESS * open->distance;
    bool across = (closed->leaning > ACROSS || partly) && open->missed < closed->missed + UNCOVERED;
    if (!(open->area > 0) || (!nearer && !leaner && !wider && !across)) return false;
    choice->form = SURFACE_OPEN, choice->room = nearer && inwards;
    choice->lid = lid && leaner && !nearer && !wider && !across;
    choice->volume = across;
    double times = fmin(closed->distance / open->distance, LARGEST_TOLD);
    if (across)
        snprintf(choice->reason, sizeof choice->reason,
                 "a closed mesh lies across the points' normals, as it does in foliage: by %d %%, where one at random "
                 "does by 50 %%",
                 percent(closed->leaning));
    else if (nearer && inwards)
        snprintf(
            choice->reason, sizeof choice->reason,
            "a mesh with borders faces inwards, as of a room, and a closed one is %.2f times as far from the points",
            times);
    else if (nearer)
        snprintf(choice->reason, sizeof choice->reason,
                 "the points are %.1f times as far from a closed mesh as from one with borders", times);
    else if (wider)
        snprintf(choice->reason, sizeof choice->reason,
                 "a closed mesh has %.1f times the area of one with borders, which %d %% of the points are far from",
                 fmin(closed->area / open->area, LARGEST_TOLD), percent(open->missed));
    else
        snprintf(choice->reason, sizeof choice->reason,
                 "a closed mesh has %d %% more area than one with borders, and lies across the points' normals",
                 percent(closed->area / open->area - 1));
    return true;
}
