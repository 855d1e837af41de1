/* A scanner's rays are evenly spread as it sees them, whatever they meet: near surfaces get more points than far ones,
 * and slanted ones less.  So from the right place equal parts of the sphere hold equally many points, or none; from
 * another place they don't, and points of two surfaces lie behind each other.
 *
 *      wall  . . . . . . . .        from e the points of wall and box are as far apart from each other,
 *             \ \ ...box/ /         and none is behind another
 *                 \ | /
 *                   e
 *
 * The sphere is a cube, whose sides are divided into squares as large as to hold some points each.  A grid of places,
 * within the points' box and around it, is tried; the best ones are moved until none beside them is better.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/eye.h"

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/base/quantile.h"
#include "core/spatial/knn.h"

enum { POINTS = EYE_POINTS, BESIDE = 17 /* the point itself and others */, STARTS = 12, STEPS = 8 };
enum { FINEST = 128, COARSEST = 8, CELL_MOST = 32 /* points in the mean */, CELL_LAYERED = 8 };
enum { PLACES = 1 + EYE_PLACES };
static const double REACH = 2, INNER = 0.9; /* of half the box */
static const double BEYOND = 0.3;           /* of the extent of most points */
static const double FIRST_STEP = 0.2, SHRINK = 0.6;
static const double LAYERS = 2;              /* what a layered point counts against the spread */
static const double MOST = 0.5, EVEN = 0.55; /* spread and layers of an eye; and by that of the surface */
static const double UNEVEN = 0.65;           /* of the surface: below, there is nothing to be explained */
static const double FARTHEST = 8;            /* of half the box: beyond, all is seen in one direction, and evenly */
static const double MARGIN_OUT = 0.01;       /* so many points on either side may be strays */
enum { FEW = 8 /* of so many points of a sample one tells how uneven it is about */ };
static const double CLEARLY_EVEN = 0.45; /* of the surface by those: far below UNEVEN for what they tell */

struct sample {
    size_t n;
    vec3 *point;
};

/* How points are seen from a place: the cell of each, of the finest division, and how far it is. */
struct view {
    uint32_t cell[POINTS];
    float distance[POINTS];
    uint16_t count[6 * FINEST * FINEST], end[6 * FINEST * FINEST]; /* of each cell: points; find_layers' own */
};

static uint32_t square_of(double x, double along) {
    double at = (x / along + 1) / 2 * FINEST;
    return at <= 0 ? 0 : at >= FINEST ? FINEST - 1 : (uint32_t)at;
}

/* Side of the cube, column and row, 7 bits each. */
static uint32_t cell_towards(vec3 d) {
    double x = fabs(d.x), y = fabs(d.y), z = fabs(d.z);
    if (x >= y && x >= z) return (uint32_t)(d.x < 0) << 14 | square_of(d.y, x) << 7 | square_of(d.z, x);
    if (y >= z) return (2U + (d.y < 0)) << 14 | square_of(d.z, y) << 7 | square_of(d.x, y);
    return (4U + (d.z < 0)) << 14 | square_of(d.x, z) << 7 | square_of(d.y, z);
}

/* The cell at a coarser division: 2^shift squares along a side become one. */
static uint32_t coarser(uint32_t cell, unsigned shift) {
    uint32_t squares = FINEST >> shift, column = (cell >> 7 & 127) >> shift, row = (cell & 127) >> shift;
    return ((cell >> 14) * squares + column) * squares + row;
}

static unsigned bits_of(int squares) {
    unsigned bits = 0;
    while (FINEST >> bits > squares) bits++;
    return bits;
}

/* Counts points by cells that hold up to CELL_MOST in the mean; how many hold some. */
static size_t count_cells(struct view *view, size_t n, unsigned *shift) {
    size_t held = 0;
    for (int squares = COARSEST; squares <= FINEST; squares *= 2) {
        *shift = bits_of(squares), held = 0;
        memset(view->count, 0, 6 * (size_t)squares * (size_t)squares * sizeof *view->count);
        for (size_t i = 0; i < n; i++) held += view->count[coarser(view->cell[i], *shift)]++ == 0;
        if (n <= held * CELL_MOST) break;
    }
    return held;
}

/* From the first quarter to the third. */
static double spread_of_values(float *value, size_t n) {
    double low = (double)quantile_of(value, n, 0.25), high = (double)quantile_of(value, n, 0.75);
    return high - low;
}

/* How many points are in the cell of that point which has this share of all in emptier cells. */
static size_t count_at(const uint16_t points_of[POINTS + 1], size_t n, double share) {
    size_t rank = (size_t)(share * (double)(n - 1)), count = 1;
    for (size_t passed = points_of[1]; passed <= rank; passed += points_of[count]) count++;
    return count;
}

/* The same of the logarithms of how many points are in each point's cell. */
static double spread_of_cells(const struct view *view, size_t n, size_t cells) {
    uint16_t points_of[POINTS + 1] = {0}; /* cells of so many points hold that many of them */
    for (size_t i = 0; i < cells; i++) points_of[view->count[i]] += view->count[i];
    float low = logf((float)count_at(points_of, n, 0.25)), high = logf((float)count_at(points_of, n, 0.75));
    return (double)high - (double)low;
}

/* Looks from a place, but not for layers. */
static void look_from(const struct sample *sample, vec3 place, struct view *view, struct eye *eye) {
    size_t n = sample->n;
    unsigned shift = 0;
    for (size_t i = 0; i < n; i++) {
        vec3 to = vec3_sub(sample->point[i], place);
        view->cell[i] = cell_towards(to);
        view->distance[i] = (float)vec3_length(to);
    }
    size_t held = count_cells(view, n, &shift), squares = FINEST >> shift;
    *eye = (struct eye){.at = place, .seen = (double)held / (double)(6 * squares * squares)};
    eye->spread = spread_of_cells(view, n, 6 * squares * squares);
}

static int nearer(const void *a, const void *b) {
    const float *x = a, *y = b;
    return (*x > *y) - (*x < *y);
}

/* Whether what is seen in a cell, the nearest first, is two surfaces: the widest gap between them, but for a fifth of
 * the points on either side, is as wide as all the rest. */
static bool cell_is_layered(const float *seen, size_t n) {
    double gap = 0, all = log((double)seen[n - 1] / fmax((double)seen[0], 1e-30));
    for (size_t i = n / 5; i + n / 5 < n; i++)
        if (i > 0) gap = fmax(gap, log((double)seen[i] / fmax((double)seen[i - 1], 1e-30)));
    return gap > all - gap;
}

/* Puts the distances of each cell's points one after the other; end[cell] is where those of a cell end. */
static void gather_by_cell(const struct view *view, size_t n, unsigned shift, float seen[POINTS],
                           uint16_t end[6 * FINEST * FINEST]) {
    size_t squares = FINEST >> shift;
    uint16_t at = 0;
    for (size_t c = 0; c < 6 * squares * squares; c++) end[c] = at, at += view->count[c];
    for (size_t i = 0; i < n; i++) seen[end[coarser(view->cell[i], shift)]++] = view->distance[i];
}

/* After look_from. */
static void find_layers(const struct sample *sample, struct view *view, struct eye *eye) {
    float seen[POINTS];
    size_t counted = 0, layered = 0;
    unsigned shift = 0;
    count_cells(view, sample->n, &shift);
    gather_by_cell(view, sample->n, shift, seen, view->end);
    size_t squares = FINEST >> shift;
    for (size_t c = 0; c < 6 * squares * squares; c++) {
        size_t n = view->count[c];
        if (n < CELL_LAYERED) continue;
        float *first = &seen[view->end[c] - n];
        qsort(first, n, sizeof *first, nearer);
        counted += n;
        layered += cell_is_layered(first, n) ? n : 0;
    }
    eye->layered = counted > 0 ? (double)layered / (double)counted : 1;
}

static double badness(const struct eye *eye) { return eye->spread + LAYERS * eye->layered; }

/* ------------------------------------------------------------------------------------------------ the search */

struct search {
    const struct sample *sample;
    vec3 *place;
    struct eye *eye;
    uint8_t *lacks; /* memory, for each place */
    double step, last;
};

static void try_range(void *ctx, size_t begin, size_t end) {
    struct search *s = ctx;
    struct view *view = alloc_array(1, sizeof *view);
    for (size_t i = begin; i < end; i++) {
        s->lacks[i] = !view;
        if (view) look_from(s->sample, s->place[i], view, &s->eye[i]);
    }
    free(view);
}

/* Moves a place along the axes while that is better. */
static void improve_range(void *ctx, size_t begin, size_t end) {
    static const vec3 way[] = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
    struct search *s = ctx;
    struct view *view = alloc_array(1, sizeof *view);
    for (size_t i = begin; i < end; i++) {
        struct eye best = s->eye[i], tried;
        s->lacks[i] = !view;
        if (!view) continue;
        look_from(s->sample, best.at, view, &best);
        find_layers(s->sample, view, &best);
        double step = s->step;
        for (int shrunk = 0, moves = 0; shrunk < STEPS && moves < 4 * STEPS;) {
            struct eye from = best;
            for (size_t w = 0; w < sizeof way / sizeof *way; w++) {
                look_from(s->sample, vec3_add(from.at, vec3_scale(way[w], step)), view, &tried);
                if (tried.spread >= badness(&best)) continue;
                find_layers(s->sample, view, &tried);
                if (badness(&tried) < badness(&best)) best = tried;
            }
            bool moved = badness(&best) < badness(&from);
            moves += moved, shrunk += !moved;
            if (!moved) step *= SHRINK;
        }
        s->eye[i] = best;
    }
    free(view);
}

static int less_spread(const void *a, const void *b) {
    const struct eye *x = a, *y = b;
    return (x->spread > y->spread) - (x->spread < y->spread);
}

/* Middle and half the extent of most points. */
static vec3 box_of(const vec3 *point, size_t n, vec3 *half) {
    float at[POINTS];
    double middle[3], extent[3];
    for (int axis = 0; axis < 3; axis++) {
        for (size_t i = 0; i < n; i++) at[i] = (float)(axis == 0 ? point[i].x : axis == 1 ? point[i].y : point[i].z);
        double low = (double)quantile_of(at, n, MARGIN_OUT), high = (double)quantile_of(at, n, 1 - MARGIN_OUT);
        middle[axis] = (low + high) / 2, extent[axis] = (high - low) / 2;
    }
    *half = (vec3){extent[0], extent[1], extent[2]};
    return (vec3){middle[0], middle[1], middle[2]};
}

/* side^3 places of a grid of this half size. */
static size_t lay_grid(vec3 middle, vec3 half, int side, vec3 *place) {
    size_t count = 0;
    for (int i = 0; i < side * side * side; i++) {
        vec3 at = {i % side, i / side % side, i / (side * side)};
        vec3 share = vec3_sub(vec3_scale(at, 2.0 / (side - 1)), (vec3){1, 1, 1});
        place[count++] = vec3_add(middle, (vec3){share.x * half.x, share.y * half.y, share.z * half.z});
    }
    return count;
}

/* Middle and half the size of the grid around points, and of that within them; half of the points' longest side. */
static double grids_of(const vec3 *point, size_t n, vec3 *middle, vec3 *around, vec3 *within) {
    vec3 half;
    *middle = box_of(point, n, &half);
    double most = fmax(half.x, fmax(half.y, half.z)), wide = REACH * most, thin = 0.15 * most;
    *around = (vec3){wide, wide, wide};
    *within = vec3_scale(vec3_max(half, (vec3){thin, thin, thin}), INNER);
    return most;
}

double eye_places_around(const vec3 *point, size_t n, vec3 place[EYE_PLACES_AROUND]) {
    vec3 middle, around, within;
    double most = grids_of(point, n, &middle, &around, &within);
    lay_grid(middle, around, EYE_AROUND, place);
    return FIRST_STEP * most;
}

double eye_places(const vec3 *point, size_t n, vec3 place[EYE_PLACES]) {
    vec3 middle, around, within;
    double most = grids_of(point, n, &middle, &around, &within);
    size_t count = lay_grid(middle, around, EYE_AROUND, place);
    lay_grid(middle, within, EYE_WITHIN, &place[count]);
    return FIRST_STEP * most;
}

void eye_places_dense(const vec3 *point, size_t n, vec3 place[EYE_PLACES_DENSE]) {
    static const double share[EYE_DENSE] = {0.02, 0.02, 0.1, 0.25, 0.5, 0.75, 0.9, 0.98, 0.98};
    double own[3][EYE_DENSE];
    float at[EYE_POINTS];
    for (int axis = 0; axis < 3; axis++) {
        for (size_t i = 0; i < n; i++) at[i] = (float)(axis == 0 ? point[i].x : axis == 1 ? point[i].y : point[i].z);
        for (int k = 0; k < EYE_DENSE; k++) own[axis][k] = (double)quantile_of(at, n, share[k]);
        double beyond = BEYOND * (own[axis][EYE_DENSE - 1] - own[axis][0]);
        own[axis][0] -= beyond, own[axis][EYE_DENSE - 1] += beyond;
    }
    for (int i = 0; i < EYE_PLACES_DENSE; i++)
        place[i] =
            (vec3){own[0][i % EYE_DENSE], own[1][i / EYE_DENSE % EYE_DENSE], own[2][i / (EYE_DENSE * EYE_DENSE)]};
}

static bool is_eye(const struct eye *eye, double uneven) { return badness(eye) < MOST && badness(eye) < EVEN * uneven; }

/* The best of all places; the origin where that is one. */
static enum status search_eye(const struct sample *sample, vec3 origin, double uneven, unsigned threads,
                              struct eye *eye) {
    enum { CHUNK = 32 };
    struct search s = {.sample = sample};
    vec3 half, middle = box_of(sample->point, sample->n, &half);
    bool near = vec3_distance(origin, middle) < FARTHEST * vec3_length(half);
    s.place = alloc_array(PLACES, sizeof *s.place);
    s.eye = alloc_zeroed(PLACES, sizeof *s.eye);
    s.lacks = alloc_zeroed(PLACES, 1);
    struct view *view = alloc_array(1, sizeof *view);
    enum status status = s.place && s.eye && s.lacks && view ? STATUS_OK : STATUS_NO_MEMORY;
    if (!status) {
        look_from(sample, origin, view, eye);
        find_layers(sample, view, eye);
    }
    if (!status && !(near && is_eye(eye, uneven))) {
        s.place[0] = near ? origin : middle;
        s.step = eye_places(sample->point, sample->n, &s.place[1]);
        par_for(threads, PLACES, CHUNK, try_range, &s);
        qsort(s.eye, PLACES, sizeof *s.eye, less_spread);
        par_for(threads, STARTS, 1, improve_range, &s);
        *eye = s.eye[0];
        for (int i = 1; i < STARTS; i++)
            if (badness(&s.eye[i]) < badness(eye)) *eye = s.eye[i];
        for (size_t i = 0; i < PLACES; i++)
            if (s.lacks[i]) status = STATUS_NO_MEMORY;
    }
    free(s.place), free(s.eye), free(s.lacks), free(view);
    return status;
}

/* How unevenly points lie on their surface: how far the 16th neighbour of each is, twice its logarithm.  By all points
 * of the sample, or one of `each`. */
static enum status find_uneven(const struct sample *sample, size_t each, unsigned threads, double *uneven) {
    struct knn *knn = NULL;
    size_t n = sample->n / each;
    vec3 *asked = alloc_array(n, sizeof *asked);
    uint32_t *id = alloc_array(n * BESIDE, sizeof *id);
    double *distance_sq = alloc_array(n * BESIDE, sizeof *distance_sq);
    float *density = alloc_array(n, sizeof *density);
    enum status status = asked && id && distance_sq && density ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; !status && i < n; i++) asked[i] = sample->point[i * each];
    if (!status) status = knn_new(sample->point, sample->n, threads, &knn, NULL);
    if (!status) status = knn_search(knn, asked, n, BESIDE, threads, id, distance_sq);
    for (size_t i = 0; !status && i < n; i++)
        density[i] = logf(fmaxf((float)distance_sq[i * BESIDE + BESIDE - 1], 1e-30F));
    if (!status) *uneven = spread_of_values(density, n);
    knn_free(knn);
    free(asked), free(id), free(distance_sq), free(density);
    return status;
}

/* Some of the points; nothing of few. */
static enum status take_sample(const vec3 *point, size_t n, struct sample *sample) {
    *sample = (struct sample){POINTS, NULL};
    if (n < POINTS) return STATUS_OK;
    sample->point = alloc_array(POINTS, sizeof *sample->point);
    if (!sample->point) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < POINTS; i++) sample->point[i] = point[i * n / POINTS];
    return STATUS_OK;
}

enum status eye_is_sought(const vec3 *point, size_t n, unsigned threads, bool *sought) {
    struct sample sample;
    double uneven = 0;
    enum status status = take_sample(point, n, &sample);
    if (!status && sample.point) status = find_uneven(&sample, FEW, threads, &uneven);
    if (!status && uneven > CLEARLY_EVEN) status = find_uneven(&sample, 1, threads, &uneven);
    *sought = !status && uneven > UNEVEN;
    free(sample.point);
    return status;
}

enum status eye_find(const vec3 *point, size_t n, vec3 origin, unsigned threads, struct eye *eye) {
    struct sample sample;
    *eye = (struct eye){0};
    enum status status = take_sample(point, n, &sample);
    double uneven = 0;
    if (!status && sample.point) status = find_uneven(&sample, 1, threads, &uneven);
    if (!status && uneven > UNEVEN) status = search_eye(&sample, origin, uneven, threads, eye);
    eye->uneven = uneven;
    eye->found = !status && uneven > UNEVEN && is_eye(eye, uneven);
    free(sample.point);
    return status;
}
