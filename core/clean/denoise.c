/* Smoothing that knows of curvature and edges.
 *
 * A point p looks at a neighbour q from half-way between their two tangent planes,
 *
 *     h_pq = (n_p + n_q) / 2 . (q - p),
 *
 * which is zero for any two points of a plane, a sphere or a cylinder, and of third order in the distance elsewhere: so
 * what is left of it is noise, and its spread around p measures how much.  p moves along n_p by a mean of h_pq whose
 * weights fall with the distance, with the angle between the normals (nobody is heard across an edge), and with h_pq
 * against the noise (nor from the other side of a thin sheet).
 *
 * Normals come first: of a weighted plane, fitted again without who lies off it, then filtered in the same bilateral
 * manner, so that each side of an edge keeps its own.  How far to look follows from the noise: the smallest of a few
 * neighbourhoods that is wide against it.  All of that is done a few times; what noise is left falls each time.
 *
 * Fleishman, Drori, Cohen-Or: Bilateral mesh denoising (2003); Oztireli, Guennebaud, Gross: Feature preserving point
 * set surfaces based on non-linear kernel regression (2009); the mean of two normals is in Rusinkiewicz: A symmetric
 * objective function for ICP (2019).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/clean/denoise.h"

#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/clean/around.h"
#include "core/clean/shell.h"
#include "core/cloud/cloud.h"
#include "core/math/quantile.h"
#include "core/math/sym3.h"
#include "core/spatial/knn.h"

enum { GRAIN = 1024, AT_ONCE = 256, LEAST_K = DENOISE_NEAR, MOST_K = 63, AROUND = 15, ROUNDS = 3, FILTERS = 1 };
static const double RIM = 1.2;                     /* where weights end, of the distance to the last neighbour */
static const double ANGLE = 0.3;                   /* between normals: the tolerance where there is no noise; in rad */
static const double HEIGHT = 4;                    /* tolerance of heights, of the noise */
static const double THICK_EVERYWHERE = 6.5;        /* times its noise that the usual finest neighbourhood reaches */
static const double STRAY = 5, STRAY_LEAST = 0.25; /* of the noise; of the radius */

/* Neighbourhoods from small to wide: k neighbours among every step-th point, taken where the radius of the one before
 * is less than `width` times the noise, or of a shell, whose last one is FINEST_LAST, than `in_shell` times. */
static const struct level {
    unsigned k, step;
    double width, in_shell;
} levels[] = {{LEAST_K, 1, 0, 0}, {31, 1, 8, 5},     {MOST_K, 1, 7, 6}, {MOST_K, 2, 4, 0},
              {MOST_K, 4, 4, 0},  {MOST_K, 8, 4, 0}, {MOST_K, 16, 4, 0}};
enum { LEVELS = sizeof levels / sizeof levels[0], FINEST_LAST = 2 /* where rounds end, at most */ };

struct surface {
    size_t n;
    unsigned threads;
    unsigned looked_at;     /* the level that neighbours are looked for at */
    unsigned unmoved_below; /* levels below share an index, until points move */
    vec3 *listened;         /* the points that may be neighbours there, and their index */
    struct knn *knn;
    size_t stride;               /* every so many-th point alone is looked at */
    uint8_t *level, *wanted;     /* n: the level of p's neighbours as they are, and that which is wide enough */
    const uint32_t *near;        /* n rows of LEAST_K, nearest first, of the first level */
    uint32_t *own_near;          /* that, where it wasn't known before */
    uint32_t *wide, *row;        /* rows of MOST_K, of the other levels; n: which one is p's, NONE = none so far */
    size_t rows;                 /* of wide */
    bool is_known;               /* the rows of the level that is looked at are there already */
    float *rim_sq;               /* n: squared distance at which the weight of a neighbour ends */
    vec3 *point, *normal, *next; /* next: of points or normals, while they are made */
    float *spread;               /* n: standard deviation of the heights around p */
    double usual;                /* median of spread */
    bool fits_level;             /* planes are fitted where neighbours have been found alone */
    bool is_fitted;              /* they are of the neighbours as they are */
    bool is_shell;               /* noise exceeds the distances between points, and differs by place */
    float *noise, *first_noise;  /* n: what is taken for the deviation of points around p; at first */
    enum status *chunk_status;
};

static double square(double x) { return x * x; }

/* p's neighbours of some level, nearest first. */
static const uint32_t *row_at(const struct surface *s, size_t p, unsigned level) {
    return level == 0 ? &s->near[p * LEAST_K] : &s->wide[(size_t)s->row[p] * MOST_K];
}

static const uint32_t *row_of(const struct surface *s, size_t p) { return row_at(s, p, s->level[p]); }
static unsigned count_of(const struct surface *s, size_t p) { return levels[s->level[p]].k; }
static double radius_of(const struct surface *s, size_t p) { return sqrt((double)s->rim_sq[p]) / RIM; }

static struct around_place place_of(const struct surface *s, size_t p) {
    return (struct around_place){.point = s->point,
                                 .normal = s->normal,
                                 .near = row_of(s, p),
                                 .n = count_of(s, p),
                                 .p = p,
                                 .rim_sq = (double)s->rim_sq[p]};
}

/* ------------------------------------------------------------------------------------------------ neighbours */

/* Of the level that is looked at; it suits p, who has neighbours of another one or none. */
static bool lacks_neighbours(const struct surface *s, size_t p) {
    return s->wanted[p] >= s->looked_at && s->level[p] != s->looked_at && p % s->stride == 0;
}

static bool has_points_for(const struct surface *s, unsigned level) {
    return s->n / levels[level].step > 2 * levels[level].k;
}

/* How many are looked for: of a shell at once as many as the last level has, of which the others are the first. */
static unsigned count_sought(const struct surface *s) {
    bool ahead = s->is_shell && s->looked_at > 0 && has_points_for(s, FINEST_LAST);
    return ahead ? MOST_K : levels[s->looked_at].k;
}

static void set_level(const struct surface *s, size_t p, double last_sq) {
    s->rim_sq[p] = fmaxf((float)(RIM * RIM * last_sq), FLT_MIN); /* what is divided by */
    s->level[p] = (uint8_t)s->looked_at;
}

/* Those of so few points at once that what is found stays in the cache. */
static enum status find_some(const struct surface *s, const uint32_t *lacking, size_t count) {
    const struct level *level = &levels[s->looked_at];
    uint32_t found[AT_ONCE * (MOST_K + 1)];
    double distance_sq[AT_ONCE * (MOST_K + 1)];
    vec3 query[AT_ONCE] = {{0, 0, 0}};
    size_t k = count_sought(s);
    for (size_t i = 0; i < count; i++) query[i] = s->point[lacking[i]];
    enum status status = knn_search(s->knn, query, count, (unsigned)k + 1, 1, found, distance_sq);
    for (size_t i = 0; !status && i < count; i++) {
        size_t first = i * (k + 1), p = lacking[i];
        uint32_t *row = s->looked_at == 0 ? &s->own_near[p * LEAST_K] : &s->wide[(size_t)s->row[p] * MOST_K];
        unsigned taken = 0;
        for (unsigned j = 0; j <= k && taken < k; j++)
            if (found[first + j] * level->step != p) row[taken++] = found[first + j] * level->step;
        set_level(s, p, distance_sq[first + level->k]);
    }
    return status;
}

static enum status find_chunk(const struct surface *s, size_t begin, size_t end) {
    uint32_t lacking[AT_ONCE];
    size_t count = 0;
    unsigned last = levels[s->looked_at].k - 1;
    enum status status = STATUS_OK;
    for (size_t p = begin; p < end && !status; p++) {
        if (!lacks_neighbours(s, p)) continue;
        if (s->is_known)
            set_level(s, p, vec3_distance_sq(s->point[p], s->point[row_at(s, p, s->looked_at)[last]]));
        else
            lacking[count++] = (uint32_t)p;
        if (count == AT_ONCE) status = find_some(s, lacking, count), count = 0;
    }
    return count > 0 && !status ? find_some(s, lacking, count) : status;
}

static void find_range(void *ctx, size_t begin, size_t end) {
    struct surface *s = ctx;
    s->chunk_status[begin / GRAIN] = find_chunk(s, begin, end);
}

/* ------------------------------------------------------------------------------------------------ normals */

/* A plane of least squares through p's neighbourhood. */
struct plane_fit {
    size_t p;
    vec3 mean, normal; /* of the plane */
    double scale_sq;   /* who is by more off the plane before counts less; 0: nobody does */
    double total;      /* of weights */
};

/* Moments of n neighbourhoods about their means, a point at height z over the plane so far weighing less the more its
 * height exceeds the scale. */
static void weigh_neighbours(const struct around *around, struct plane_fit *fit, unsigned n, sym3 *moment) {
    double by_plane[AROUND_FEW][AROUND_MOST];
    const double *weight[AROUND_FEW] = {NULL};
    struct around_sums sums[AROUND_FEW];
    for (unsigned i = 0; i < n; i++) {
        bool has_plane = fit[i].scale_sq > 0;
        weight[i] = has_plane ? by_plane[i] : around[i].near;
        if (has_plane) around_plane(&around[i], fit[i].mean, fit[i].normal, fit[i].scale_sq, by_plane[i]);
    }
    around_sum_up(around, weight, n, sums);
    for (unsigned i = 0; i < n; i++) {
        fit[i].total = sums[i].total;
        fit[i].mean = vec3_scale(sums[i].sum, 1 / sums[i].total);
        moment[i] = sym3_add(sums[i].moment, sym3_scale(sym3_outer(sums[i].sum), -1 / sums[i].total));
    }
}

/* spread_sq[i]: the mean square of heights. */
static void fit_planes(struct around *around, struct plane_fit *fit, unsigned n, double *spread_sq) {
    static_assert((int)AROUND_FEW == (int)SYM3_FEW, "as many at once");
    sym3 moment[SYM3_FEW] = {0};
    double least[SYM3_FEW];
    vec3 normal[SYM3_FEW];
    weigh_neighbours(around, fit, n, moment);
    sym3_least(moment, n, least, normal);
    for (unsigned i = 0; i < n; i++) {
        fit[i].normal = normal[i];
        spread_sq[i] = square((double)(float)sqrt(fmax(least[i], 0) / fit[i].total));
    }
}

static void fit_few(const struct surface *s, struct plane_fit *fit, unsigned n) {
    struct around around[SYM3_FEW];
    double spread_sq[SYM3_FEW], ignored[SYM3_FEW];
    for (unsigned i = 0; i < n; i++) {
        struct around_place place = place_of(s, fit[i].p);
        around_gather(&place, true, &around[i]);
    }
    fit_planes(around, fit, n, spread_sq);
    for (unsigned i = 0; i < n; i++) {
        fit[i].scale_sq = 4 * spread_sq[i];
        s->spread[fit[i].p] = (float)sqrt(spread_sq[i]);
    }
    fit_planes(around, fit, n, ignored);
    for (unsigned i = 0; i < n; i++) s->normal[fit[i].p] = fit[i].normal;
}

/* Of those whose neighbours are of the level that is looked at. */
static void fit_range(void *ctx, size_t begin, size_t end) {
    const struct surface *s = ctx;
    struct plane_fit fit[SYM3_FEW];
    unsigned n = 0;
    for (size_t p = begin; p < end; p++) {
        if (s->fits_level && (s->level[p] != s->looked_at || p % s->stride != 0)) continue;
        fit[n++] = (struct plane_fit){.p = p};
        if (n == SYM3_FEW) fit_few(s, fit, n), n = 0;
    }
    if (n > 0) fit_few(s, fit, n);
}

/* Fits planes where neighbours have been found; of the others they are as they were. */
static void fit_level(struct surface *s) {
    s->fits_level = true;
    par_for(s->threads, s->n, GRAIN, fit_range, s);
    s->fits_level = false;
    s->is_fitted = true;
}

/* How noisy it is around each point: as in the whole cloud, but of a shell as among its neighbours. */
static void noise_range(void *ctx, size_t begin, size_t end) {
    const struct surface *s = ctx;
    for (size_t p = begin; p < end; p++) {
        float found[AROUND + 1] = {s->spread[p]};
        unsigned count = s->is_shell ? count_of(s, p) : 0, k = count < AROUND ? count : AROUND;
        for (unsigned i = 0; i < k; i++) found[i + 1] = s->spread[row_of(s, p)[i * (count / k)]];
        s->noise[p] = k ? quantile_of(found, k + 1, 0.5) : (float)s->usual;
    }
}

/* The median of a number of each point that is looked at. */
static enum status find_median(const struct surface *s, const float *value, double *median) {
    size_t m = (s->n - 1) / s->stride + 1;
    double mad;
    float *some = alloc_array(m, sizeof *some);
    enum status status = some ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; i < m && !status; i++) some[i] = value[i * s->stride];
    if (!status) status = quantile_spread(some, m, median, &mad);
    free(some);
    return status;
}

/* Looks at so many points from now on, or at some more; at all if there are hardly more. */
static void look_at_some(struct surface *s, size_t some) { s->stride = s->n > 2 * some ? s->n / some : 1; }

static enum status find_noise_by_spread(struct surface *s) {
    enum status status = find_median(s, s->spread, &s->usual);
    par_for(s->threads, s->n, GRAIN, noise_range, s);
    return status;
}

/* The same, with the square of the tolerance between normals: the noisier the larger. */
static struct around_place look_from(const struct surface *s, size_t p) {
    struct around_place place = place_of(s, p);
    place.angle_sq = square(ANGLE + (double)s->noise[p] / radius_of(s, p));
    return place;
}

static void filter_range(void *ctx, size_t begin, size_t end) {
    const struct surface *s = ctx;
    for (size_t p = begin; p < end; p++) {
        struct around_place place = look_from(s, p);
        s->next[p] = vec3_unit(vec3_add(s->normal[p], around_turned(&place)));
    }
}

static void swap_in(vec3 **current, vec3 **next) {
    vec3 *t = *current;
    *current = *next, *next = t;
}

static void find_normals(struct surface *s) {
    if (!s->is_fitted) par_for(s->threads, s->n, GRAIN, fit_range, s);
    s->is_fitted = false;
    for (int i = 0; i < FILTERS; i++) {
        par_for(s->threads, s->n, GRAIN, filter_range, s);
        swap_in(&s->normal, &s->next);
    }
}

/* ------------------------------------------------------------------------------------------------ heights */

static void spread_range(void *ctx, size_t begin, size_t end) {
    const struct surface *s = ctx;
    for (size_t p = begin; p < end; p++) {
        if (p % s->stride != 0) continue;
        struct around_place place = look_from(s, p);
        struct around_heights of = around_heights(&place, INFINITY);
        double total = 1 + of.total; /* with its own, which is on its plane */
        s->spread[p] = (float)sqrt(fmax(of.sum_sq / total - square(of.sum / total), 0));
    }
}

/* Where noise is the same everywhere some points tell how large it is. */
static enum status find_noise(struct surface *s) {
    enum { SOME = 16384 };
    if (!s->is_shell) look_at_some(s, SOME);
    par_for(s->threads, s->n, GRAIN, spread_range, s);
    enum status status = find_noise_by_spread(s);
    s->stride = 1;
    return status;
}

/* Points whose neighbourhoods are to be wider than the one that is looked at have moved before. */
static void move_range(void *ctx, size_t begin, size_t end) {
    const struct surface *s = ctx;
    for (size_t p = begin; p < end; p++) {
        double scale_sq = square(HEIGHT * (double)s->noise[p]);
        bool moves = scale_sq > 0 && (s->looked_at <= FINEST_LAST || s->wanted[p] >= s->looked_at);
        s->next[p] = s->point[p];
        if (!moves) continue;
        struct around_place place = look_from(s, p);
        struct around_heights of = around_heights(&place, scale_sq);
        s->next[p] = vec3_add(s->point[p], vec3_scale(s->normal[p], of.sum / (1 + of.total)));
    }
}

/* ------------------------------------------------------------------------------------------------ strays */

/* The distance from x to the tangent planes of p's neighbours that a quarter of them stay below.  Near a surface some
 * of them pass through x, at an edge too. */
static double off_surface(const struct surface *s, size_t p, vec3 x) {
    float distance[MOST_K];
    const uint32_t *near = row_of(s, p);
    unsigned k = count_of(s, p);
    for (unsigned i = 0; i < k; i++) {
        uint32_t q = near[i];
        distance[i] = (float)fabs(vec3_dot(s->normal[q], vec3_sub(x, s->point[q])));
    }
    return (double)quantile_of(distance, k, 0.25);
}

static void stray_range(void *ctx, size_t begin, size_t end) {
    const struct surface *s = ctx;
    for (size_t p = begin; p < end; p++) s->spread[p] = (float)off_surface(s, p, s->point[p]);
}

static bool is_stray(const struct surface *s, size_t p) {
    return (double)s->spread[p] > fmax(STRAY * (double)s->first_noise[p], STRAY_LEAST * radius_of(s, p));
}

static void find_strays(struct surface *s, const vec3 *start, struct denoise_result *made) {
    par_for(s->threads, s->n, GRAIN, stray_range, s);
    size_t count = 0;
    for (size_t p = 0; p < s->n; p++) count += is_stray(s, p);
    for (size_t p = 0; p < s->n && count <= s->n / 2; p++) {
        if (!is_stray(s, p)) continue;
        s->point[p] = start[p];
        made->stray[p] = 1;
        made->stray_count++;
    }
}

/* ------------------------------------------------------------------------------------------------ scale */

static enum status index_listened(struct surface *s) {
    unsigned step = levels[s->looked_at].step;
    size_t m = (s->n - 1) / step + 1;
    knn_free(s->knn);
    free(s->listened);
    s->knn = NULL;
    s->listened = alloc_array(m, sizeof *s->listened);
    if (!s->listened) return STATUS_NO_MEMORY;
    for (size_t i = 0; i < m; i++) s->listened[i] = s->point[i * step];
    return knn_new(s->listened, m, s->threads, &s->knn, NULL);
}

/* A row for each point that is to have neighbours of another level than the first. */
static enum status add_rows(struct surface *s) {
    size_t rows = s->rows;
    for (size_t p = 0; p < s->n; p++)
        if (lacks_neighbours(s, p) && s->row[p] == NONE) s->row[p] = (uint32_t)rows++;
    if (rows == s->rows) return STATUS_OK;
    uint32_t *wide = alloc_resize(s->wide, rows, MOST_K * sizeof *wide);
    if (!wide) return STATUS_NO_MEMORY;
    s->wide = wide, s->rows = rows;
    return STATUS_OK;
}

/* Finds the neighbours of a level for all points that lack them. */
static enum status look_around(struct surface *s, unsigned level) {
    bool is_ahead = s->is_shell && level > 1 && level <= FINEST_LAST;
    s->looked_at = level;
    s->is_known = level == 0 ? !s->own_near : is_ahead;
    bool is_indexed = s->is_known || (s->knn && level < s->unmoved_below);
    enum status status = is_indexed ? STATUS_OK : index_listened(s);
    if (!status && level > 0) status = add_rows(s);
    if (status) return status;
    par_for(s->threads, s->n, GRAIN, find_range, s);
    for (size_t i = 0; i <= s->n / GRAIN; i++)
        if (s->chunk_status[i]) return s->chunk_status[i];
    return STATUS_OK;
}

/* Finds the neighbours of a level for all that lack them, and how noisy it is among them. */
static enum status fit_around(struct surface *s, unsigned level) {
    enum status status = look_around(s, level);
    if (status) return status;
    fit_level(s);
    return find_noise_by_spread(s);
}

/* How many times its usual noise the usual neighbourhood reaches, of the points that are looked at. */
static enum status usual_width(const struct surface *s, double *width) {
    double rim_sq = 0, spread = 0;
    enum status status = find_median(s, s->rim_sq, &rim_sq);
    if (!status) status = find_median(s, s->spread, &spread);
    if (!status) *width = spread > 0 ? sqrt(rim_sq) / RIM / spread : INFINITY;
    return status;
}

/* The same of a level's neighbourhoods.  Where some points tell that it is clearly less than a limit, nothing is found
 * for the others. */
static enum status find_width(struct surface *s, unsigned level, double limit, double *width) {
    enum { SOME = 4096 };
    static const double CLEARLY = 0.9;
    enum status status = STATUS_OK;
    if (limit > 0) look_at_some(s, SOME);
    if (s->stride > 1) {
        status = look_around(s, level);
        if (!status) fit_level(s);
        if (!status) status = usual_width(s, width);
        s->stride = 1;
        if (status || *width < CLEARLY * limit) return status;
    }
    status = fit_around(s, level);
    return status ? status : usual_width(s, width);
}

/* Under what width the next level is looked at; 0 = there is none, or too few points for it. */
static double limit_after(const struct surface *s, unsigned level) {
    return level + 1 < LEVELS && has_points_for(s, level + 1) ? levels[level + 1].width : 0;
}

/* Of a cloud the width of whose finest neighbourhoods is known: the first level that is wide enough for it, or the last
 * one that there are points for. */
static enum status choose_base(struct surface *s, double width) {
    enum status status = STATUS_OK;
    for (unsigned i = 1; !status && width < limit_after(s, i - 1); i++) {
        memset(s->wanted, (int)i, s->n);
        status = find_width(s, i, limit_after(s, i), &width);
    }
    return status;
}

/* Neighbours of the next level for all whose own aren't wide enough; *any are none. */
static enum status widen(struct surface *s, bool *any) {
    unsigned next = s->looked_at + 1;
    *any = false;
    for (size_t p = 0; p < s->n; p++) {
        if (s->level[p] + 1U < next || (double)s->noise[p] * levels[next].in_shell <= radius_of(s, p)) continue;
        s->wanted[p] = (uint8_t)next;
        *any = true;
    }
    return *any ? fit_around(s, next) : STATUS_OK;
}

/* One level for all; for a shell that is thick in places alone the first one that is wide enough for each point, since
 * noise then grows with the distance from the camera.  Folds and rims would be taken for noise, which in a shell
 * doesn't matter much. */
static enum status choose_levels(struct surface *s) {
    bool any = true;
    double width = 0, limit = limit_after(s, 0);
    enum status status = find_width(s, 0, s->is_shell ? fmin(limit, THICK_EVERYWHERE) : limit, &width);
    if (width < THICK_EVERYWHERE) s->is_shell = false;
    if (!status && !s->is_shell) return choose_base(s, width);
    while (any && !status && s->looked_at < FINEST_LAST && has_points_for(s, s->looked_at + 1)) status = widen(s, &any);
    return status;
}

/* ------------------------------------------------------------------------------------------------ the whole */

static enum status smooth_round(struct surface *s) {
    find_normals(s);
    enum status status = find_noise(s);
    par_for(s->threads, s->n, GRAIN, move_range, s);
    swap_in(&s->point, &s->next);
    return status;
}

/* From the widest neighbourhoods that any point needs to the finest. */
static enum status smooth(struct surface *s, struct denoise_result *made) {
    double share = 0;
    enum status status = s->is_shell ? STATUS_OK : index_listened(s);
    if (!status && !s->is_shell) status = shell_find(s->knn, s->point, s->n, s->threads, &share, NULL, NULL);
    s->is_shell = s->is_shell || share >= SHELL_MANY;
    if (!status) status = choose_levels(s);
    unsigned level = s->looked_at;
    for (int round = 0; round < ROUNDS && !status; round++) {
        status = smooth_round(s);
        if (made->noise == 0) {
            memcpy(s->first_noise, s->noise, s->n * sizeof *s->noise);
            made->noise = s->usual;
        }
        bool is_last = round + 1 == ROUNDS;
        if (is_last && level > FINEST_LAST && !status)
            s->unmoved_below = 0, status = look_around(s, --level), round = -1;
    }
    return status;
}

static enum status allocate(struct surface *s) {
    size_t n = s->n;
    s->unmoved_below = FINEST_LAST + 1;
    s->stride = 1;
    if (!s->near) s->near = s->own_near = alloc_array(n, LEAST_K * sizeof *s->own_near);
    s->row = alloc_array(n, sizeof *s->row);
    s->level = alloc_array(n, 1), s->wanted = alloc_zeroed(n, 1);
    s->noise = alloc_zeroed(n, sizeof *s->noise), s->first_noise = alloc_array(n, sizeof *s->first_noise);
    if (!s->near || !s->row || !s->level || !s->wanted || !s->noise || !s->first_noise) return STATUS_NO_MEMORY;
    memset(s->level, LEVELS, n);
    for (size_t p = 0; p < n; p++) s->row[p] = NONE;
    s->normal = alloc_array(n, sizeof *s->normal);
    s->next = alloc_array(n, sizeof *s->next);
    s->rim_sq = alloc_array(n, sizeof *s->rim_sq);
    s->spread = alloc_array(n, sizeof *s->spread);
    s->chunk_status = alloc_zeroed(n / GRAIN + 1, sizeof *s->chunk_status);
    return s->normal && s->next && s->rim_sq && s->spread && s->chunk_status ? STATUS_OK : STATUS_NO_MEMORY;
}

static void surface_done(struct surface *s) {
    knn_free(s->knn);
    free(s->listened), free(s->own_near), free(s->wide), free(s->row), free(s->rim_sq), free(s->spread);
    free(s->chunk_status), free(s->level), free(s->wanted), free(s->noise), free(s->first_noise);
    free(s->point), free(s->normal), free(s->next);
}

enum status denoise_smooth(const vec3 *point, size_t n, const struct denoise_known *known, unsigned threads,
                           struct denoise_result *result) {
    struct surface s = {.n = n, .threads = threads, .near = known->near, .is_shell = known->is_shell};
    struct denoise_result made = {0};
    enum status status = STATUS_NO_MEMORY;
    s.point = alloc_array(n, sizeof *s.point);
    made.stray = alloc_zeroed(n, sizeof *made.stray);
    if (!s.point || !made.stray) goto out;
    memcpy(s.point, point, n * sizeof *s.point);
    status = n < DENOISE_MIN_POINTS ? STATUS_OK : allocate(&s);
    if (status || n < DENOISE_MIN_POINTS) goto out;
    status = smooth(&s, &made);
    if (!status) find_strays(&s, point, &made);
out:
    if (!status) made.point = s.point, s.point = NULL;
    surface_done(&s);
    if (status)
        denoise_done(&made);
    else
        *result = made;
    return status;
}

void denoise_done(struct denoise_result *result) {
    if (!result) return;
    free(result->point);
    free(result->stray);
    *result = (struct denoise_result){0};
}
