/* Planes are fitted with weights that fall with the distance, and in all but the first round with the height over the
 * plane before: 1 on it, 1/4 at 1.4 times the weighted spread of heights (Geman, McClure).  The spread falls from round
 * to round, so a plane between two layers goes over to one of them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/clean/offsets.h"

#include <assert.h>
#include <float.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/clean/around.h"
#include "core/cloud/cloud.h"
#include "core/math/quantile.h"
#include "core/math/sym3.h"

enum { GRAIN = 1024, AT_ONCE = 256, K = OFFSETS_K, SPACING_K = 8, ROUNDS = 4 };
enum { AMONG_SOME = 32, AMONG_ALL = KNN_MAX_K }; /* so many are looked at, where some aren't trusted */
enum { REGAINED_FEW = 64 };                      /* points that are compared with each other one by one */
static const double RIM_SQ = 1.44;               /* where weights end, of the squared distance to the last neighbour */
static const double SPREAD_SQ = 2;               /* tolerance of squared heights, of the weighted mean of them */
static const double ROUNDING = 1 + 1e-6;         /* more than radii lose as float */
static const double LEAST_SQ = 1e-24;            /* of the squared radius: spread that is none */

/* What is to be measured for a point, and for those whose neighbour it is. */
enum { NEAR_CHANGED = 1, PLANE_CHANGED = 2 };

/* Who isn't trusted may be nearer to a point than the last of its neighbours; too few of those that were found are; its
 * neighbours aren't what they were. */
enum { PASSES = 1, LACKS = 2, ANEW = 4 };

struct planes {
    const vec3 *point;
    size_t n;
    const uint8_t *trusted; /* borrowed while it is measured */
    uint8_t *was_trusted;   /* n: when neighbours were looked for the last time */
    bool was_looked;        /* they were */
    uint32_t *listened_id;  /* which the points are among which it is looked; NULL = all */
    const struct knn *all;  /* over all points */
    const struct knn *knn;  /* that, or over the trusted points */
    uint8_t sought;         /* flag of those whose neighbours are looked for */
    uint32_t *near;         /* n * K: ids of trusted points, nearest first, the point itself left out */
    uint8_t *passes;        /* n: as above */
    uint8_t *has_plane;     /* n: of the neighbours as they are */
    uint8_t *changed;       /* n: as above */
    uint8_t *off_anew;      /* n: offsets have been measured again */
    bool measured;          /* all have been */
    float *spacing;         /* n: mean distance to the nearest SPACING_K */
    vec3 *normal;           /* n: of the plane of a trusted point */
    double *height;         /* n: of that plane over the origin */
    enum status *chunk_status;
    struct offsets made;
};

static double square_of(double x) { return x * x; }

/* ------------------------------------------------------------------------------------------------ neighbours */

/* Takes for p's neighbours the trusted ones of a row of k that were found, by increasing distance, but itself; false:
 * there are too few.  id: what they are called, NULL = as they are found. */
static bool take_row(struct planes *s, size_t p, const uint32_t *found, const double *distance_sq, unsigned k,
                     const uint32_t *id) {
    double sum = 0, last = 0;
    uint32_t *near = &s->near[p * K];
    unsigned taken = 0;
    for (unsigned i = 0; i < k && taken < K && found[i] != NONE; i++) {
        uint32_t q = id ? id[found[i]] : found[i];
        if (q == p || (s->trusted && !s->trusted[q])) continue;
        last = sqrt(distance_sq[i]);
        if (taken < SPACING_K) sum += last;
        if (near[taken] != q) s->changed[p] = NEAR_CHANGED;
        near[taken++] = q;
    }
    if (taken < K) return false;
    s->spacing[p] = fmaxf((float)(sum / SPACING_K), FLT_MIN);
    s->made.radius[p] = fmaxf((float)last, FLT_MIN);
    return true;
}

/* Puts those first who lack neighbours after all, and counts them. */
static enum status search_among(struct planes *s, unsigned k, uint32_t *some, size_t *count) {
    uint32_t found[AT_ONCE * AMONG_ALL];
    double distance_sq[AT_ONCE * AMONG_ALL];
    vec3 query[AT_ONCE] = {{0, 0, 0}};
    size_t lacking = 0;
    for (size_t i = 0; i < *count; i++) query[i] = s->point[some[i]];
    enum status status = knn_search(s->knn, query, *count, k, 1, found, distance_sq);
    for (size_t i = 0; i < *count && !status; i++) {
        uint32_t p = some[i];
        bool enough = take_row(s, p, &found[i * k], &distance_sq[i * k], k, s->listened_id);
        s->passes[p] = (uint8_t)((s->passes[p] & PASSES) | (enough ? 0 : LACKS));
        if (!enough) some[lacking++] = p;
    }
    *count = lacking;
    return status;
}

/* Among all points some more are looked at, and then as many as can be, where some aren't trusted. */
static enum status search_some(struct planes *s, uint32_t *some, size_t count) {
    bool among_all = s->trusted && s->knn == s->all;
    enum status status = search_among(s, among_all ? AMONG_SOME : K + 1, some, &count);
    return among_all && count > 0 && !status ? search_among(s, AMONG_ALL, some, &count) : status;
}

static void find_near_range(void *ctx, size_t begin, size_t end) {
    struct planes *s = ctx;
    uint32_t some[AT_ONCE];
    size_t count = 0;
    enum status status = STATUS_OK;
    for (size_t p = begin; p < end && !status; p++) {
        if (s->passes[p] & s->sought) some[count++] = (uint32_t)p;
        if (count == AT_ONCE || (count > 0 && p + 1 == end)) status = search_some(s, some, count), count = 0;
    }
    s->chunk_status[begin / GRAIN] = status;
}

static enum status find_near(struct planes *s, const struct knn *knn, uint8_t sought, unsigned threads) {
    s->knn = knn, s->sought = sought;
    par_for(threads, s->n, GRAIN, find_near_range, s);
    for (size_t i = 0; i <= s->n / GRAIN; i++)
        if (s->chunk_status[i]) return s->chunk_status[i];
    return STATUS_OK;
}

/* Those who are trusted again, if they are few. */
struct regained {
    struct planes *planes;
    vec3 point[REGAINED_FEW];
    size_t count; /* over REGAINED_FEW: too many */
};

static void find_regained(struct regained *regained) {
    const struct planes *s = regained->planes;
    for (size_t p = 0; p < s->n && regained->count <= REGAINED_FEW; p++) {
        if (!s->trusted[p] || s->was_trusted[p]) continue;
        if (regained->count < REGAINED_FEW) regained->point[regained->count] = s->point[p];
        regained->count++;
    }
}

/* Whether one of them may be nearer to p than the last of its neighbours. */
static bool is_regained_near(const struct regained *regained, size_t p) {
    double reach = ROUNDING * (double)regained->planes->made.radius[p];
    bool any = regained->count > REGAINED_FEW;
    for (size_t i = 0; i < regained->count && !any; i++)
        any = vec3_distance_sq(regained->point[i], regained->planes->point[p]) <= reach * reach;
    return any;
}

/* Neighbours are what they were where all are trusted, and nobody nearer is again. */
static void lose_range(void *ctx, size_t begin, size_t end) {
    const struct regained *regained = ctx;
    struct planes *s = regained->planes;
    for (size_t p = begin; p < end; p++) {
        unsigned lost = 0;
        for (unsigned i = 0; i < K; i++) lost |= !s->trusted[s->near[p * K + i]];
        if (lost) s->passes[p] |= PASSES | ANEW;
        if ((s->passes[p] & PASSES) && (!s->was_looked || is_regained_near(regained, p))) s->passes[p] |= ANEW;
    }
}

static size_t count_flagged(const struct planes *s, uint8_t flag) {
    size_t count = 0;
    for (size_t p = 0; p < s->n; p++) count += (s->passes[p] & flag) != 0;
    return count;
}

/* Points that follow each other, some at a time, each some within a box. */
struct stretch {
    vec3 least, most;
};

struct lacking {
    struct planes *planes;
    struct stretch *stretch;
    size_t count;
};

enum { STRETCH = 64 };

static size_t end_of_stretch(const struct planes *s, size_t i) {
    return (i + 1) * STRETCH < s->n ? (i + 1) * STRETCH : s->n;
}

static void box_stretches(struct lacking *lacking) {
    const struct planes *s = lacking->planes;
    for (size_t i = 0; i < lacking->count; i++) {
        struct stretch box = {s->point[i * STRETCH], s->point[i * STRETCH]};
        for (size_t q = i * STRETCH; q < end_of_stretch(s, i); q++)
            box.least = vec3_min(box.least, s->point[q]), box.most = vec3_max(box.most, s->point[q]);
        lacking->stretch[i] = box;
    }
}

/* The K + 1 nearest trusted points of those that were looked at, nearest first, of equals the lower id. */
struct nearest {
    uint32_t id[K + 1];
    double distance_sq[K + 1];
    unsigned count;
};

static double last_of(const struct nearest *found) { return found->count > K ? found->distance_sq[K] : INFINITY; }

static void look_at_stretch(const struct planes *s, size_t p, size_t i, struct nearest *found) {
    for (size_t q = i * STRETCH; q < end_of_stretch(s, i); q++) {
        if (!s->trusted[q]) continue;
        double apart_sq = vec3_distance_sq(s->point[q], s->point[p]);
        if (!(apart_sq < last_of(found))) continue;
        unsigned at = found->count <= K ? found->count++ : K;
        for (; at > 0 && found->distance_sq[at - 1] > apart_sq; at--)
            found->distance_sq[at] = found->distance_sq[at - 1], found->id[at] = found->id[at - 1];
        found->distance_sq[at] = apart_sq, found->id[at] = (uint32_t)q;
    }
}

/* Looks at all points for the nearest that are trusted, but for stretches that are farther than what is beside p in the
 * order: an index of the trusted ones would take as long as some hundred such. */
static void look_at_all(const struct lacking *lacking, size_t p) {
    struct planes *s = lacking->planes;
    struct nearest beside = {.count = 0}, found = {.count = 0};
    size_t own = p / STRETCH;
    for (size_t i = own > 0 ? own - 1 : 0; i <= own + 1 && i < lacking->count; i++) look_at_stretch(s, p, i, &beside);
    for (size_t i = 0; i < lacking->count; i++) {
        const struct stretch *box = &lacking->stretch[i];
        double apart_sq = vec3_distance_sq(vec3_min(vec3_max(s->point[p], box->least), box->most), s->point[p]);
        if (apart_sq <= last_of(&beside) && apart_sq < last_of(&found)) look_at_stretch(s, p, i, &found);
    }
    if (take_row(s, p, found.id, found.distance_sq, found.count, NULL)) s->passes[p] &= PASSES;
}

static void look_at_all_range(void *ctx, size_t begin, size_t end) {
    const struct lacking *lacking = ctx;
    for (size_t p = begin; p < end; p++)
        if (lacking->planes->passes[p] & LACKS) look_at_all(lacking, p);
}

static enum status find_few_lacking(struct planes *s, unsigned threads) {
    struct lacking lacking = {s, NULL, (s->n - 1) / STRETCH + 1};
    lacking.stretch = alloc_array(lacking.count, sizeof *lacking.stretch);
    if (!lacking.stretch) return STATUS_NO_MEMORY;
    box_stretches(&lacking);
    par_for(threads, s->n, GRAIN, look_at_all_range, &lacking);
    free(lacking.stretch);
    return STATUS_OK;
}

/* Looks among the trusted points alone for the neighbours of those around whom they are few. */
static enum status find_lacking(struct planes *s, unsigned threads) {
    enum { FEW = 64 };
    if (count_flagged(s, LACKS) <= FEW) return find_few_lacking(s, threads);
    size_t m = 0;
    struct knn *knn = NULL;
    vec3 *listened = alloc_array(s->n, sizeof *listened);
    s->listened_id = alloc_array(s->n, sizeof *s->listened_id);
    enum status status = listened && s->listened_id ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t p = 0; p < s->n && !status; p++)
        if (s->trusted[p]) listened[m] = s->point[p], s->listened_id[m++] = (uint32_t)p;
    if (!status) status = knn_new(listened, m, threads, &knn, NULL);
    if (!status) status = find_near(s, knn, LACKS, threads);
    knn_free(knn);
    free(listened), free(s->listened_id);
    s->listened_id = NULL;
    return status;
}

enum status planes_trust(struct planes *planes, const uint8_t *trusted, unsigned threads) {
    struct planes *s = planes;
    enum status status = STATUS_OK;
    s->trusted = trusted;
    if (s->was_looked && memcmp(s->was_trusted, trusted, s->n) == 0) return STATUS_OK;
    struct regained regained = {.planes = s};
    find_regained(&regained);
    par_for(threads, s->n, GRAIN, lose_range, &regained);
    if (count_flagged(s, ANEW) > 0) status = find_near(s, s->all, ANEW, threads);
    if (!status && count_flagged(s, LACKS) > 0) status = find_lacking(s, threads);
    memcpy(s->was_trusted, trusted, s->n);
    s->was_looked = !status;
    return status;
}

/* ------------------------------------------------------------------------------------------------ planes */

/* The plane through p's neighbourhood, relative to p, round by round. */
struct robust_fit {
    size_t p;
    vec3 normal;
    double radius_sq, spread_sq, height;
};

static void begin_fit(const struct planes *s, size_t p, struct robust_fit *fit, struct around *around) {
    *fit = (struct robust_fit){.p = p, .radius_sq = square_of((double)s->made.radius[p])};
    const struct around_place place = {
        .point = s->point, .near = &s->near[p * K], .n = K, .p = p, .rim_sq = RIM_SQ * fit->radius_sq};
    around_gather(&place, true, around);
}

static void fit_robustly(struct planes *s, struct robust_fit *fit, const struct around *around, unsigned n) {
    static_assert((int)AROUND_FEW == (int)SYM3_FEW && (int)K < (int)AROUND_MOST, "as many at once");
    double by_height[AROUND_FEW][AROUND_MOST];
    const double *weight[AROUND_FEW] = {NULL};
    for (int round = 0; round < ROUNDS; round++) {
        struct around_sums sums[AROUND_FEW];
        sym3 moment[SYM3_FEW];
        double least[SYM3_FEW];
        vec3 normal[SYM3_FEW];
        for (unsigned i = 0; i < n; i++) {
            double scale_sq = SPREAD_SQ * fmax(fit[i].spread_sq, LEAST_SQ * fit[i].radius_sq);
            weight[i] = round > 0 ? by_height[i] : around[i].near;
            if (round > 0) around_level(&around[i], fit[i].normal, fit[i].height, scale_sq, by_height[i]);
        }
        around_sum_up(around, weight, n, sums);
        for (unsigned i = 0; i < n; i++)
            moment[i] = sym3_add(sums[i].moment, sym3_scale(sym3_outer(sums[i].sum), -1 / sums[i].total));
        sym3_least(moment, n, least, normal);
        for (unsigned i = 0; i < n; i++) {
            if (!(sums[i].total > 0)) continue;
            fit[i].normal = normal[i];
            fit[i].spread_sq = fmax(least[i], 0) / sums[i].total;
            fit[i].height = vec3_dot(normal[i], sums[i].sum) / sums[i].total;
        }
    }
    for (unsigned i = 0; i < n; i++) {
        size_t p = fit[i].p;
        s->normal[p] = fit[i].normal, s->height[p] = fit[i].height;
        s->has_plane[p] = 1;
        s->changed[p] |= PLANE_CHANGED;
    }
}

static void plane_range(void *ctx, size_t begin, size_t end) {
    struct planes *s = ctx;
    struct robust_fit fit[AROUND_FEW];
    struct around around[AROUND_FEW];
    unsigned n = 0;
    for (size_t p = begin; p < end; p++) {
        if (s->changed[p]) s->has_plane[p] = 0;
        if (!s->trusted[p] || s->has_plane[p]) continue;
        begin_fit(s, p, &fit[n], &around[n]);
        if (++n == AROUND_FEW) fit_robustly(s, fit, around, n), n = 0;
    }
    if (n > 0) fit_robustly(s, fit, around, n);
}

/* Whether p or one of its neighbours has one of some flags. */
static bool any_near(const struct planes *s, size_t p, const uint8_t *flag, uint8_t mask) {
    unsigned any = flag[p] & mask;
    for (unsigned i = 0; i < K; i++) any |= flag[s->near[p * K + i]] & mask;
    return any != 0;
}

static void offset_range(void *ctx, size_t begin, size_t end) {
    static const double shares[] = {1.0 / (K - 1), 2.0 / (K - 1), 4.0 / (K - 1)};
    struct planes *s = ctx;
    for (size_t p = begin; p < end; p++) {
        float off[K], spacing[K], found[sizeof shares / sizeof *shares];
        s->off_anew[p] = !s->measured || any_near(s, p, s->changed, NEAR_CHANGED | PLANE_CHANGED);
        if (!s->off_anew[p]) continue;
        for (unsigned i = 0; i < K; i++) {
            uint32_t q = s->near[p * K + i];
            off[i] = (float)fabs(vec3_dot(s->normal[q], vec3_sub(s->point[p], s->point[q])) - s->height[q]);
            spacing[i] = s->spacing[q];
        }
        quantiles_of(off, K, shares, sizeof shares / sizeof *shares, found);
        s->made.second[p] = found[0], s->made.third[p] = found[1], s->made.quarter[p] = found[2];
        s->made.sparsity[p] = s->spacing[p] / quantile_of(spacing, K, 0.75);
    }
}

static void usual_range(void *ctx, size_t begin, size_t end) {
    static const double shares[] = {0.25, 0.75};
    const struct planes *s = ctx;
    for (size_t p = begin; p < end; p++) {
        float off[K], found[2];
        if (s->measured && !any_near(s, p, s->off_anew, 1)) continue;
        for (unsigned i = 0; i < K; i++) off[i] = s->made.quarter[s->near[p * K + i]];
        quantiles_of(off, K, shares, 2, found);
        s->made.usual[p] = found[0], s->made.rough[p] = found[1];
    }
}

/* ------------------------------------------------------------------------------------------------ the whole */

static enum status allocate_planes(struct planes *s) {
    struct offsets *made = &s->made;
    float **each[] = {&made->second, &made->third,  &made->quarter,  &made->usual,
                      &made->rough,  &made->radius, &made->sparsity, &s->spacing};
    uint8_t **flag[] = {&s->passes, &s->has_plane, &s->changed, &s->off_anew, &s->was_trusted};
    bool all = true;
    for (size_t i = 0; i < sizeof each / sizeof *each; i++) all = (*each[i] = alloc_array(s->n, sizeof(float))) && all;
    for (size_t i = 0; i < sizeof flag / sizeof *flag; i++) all = (*flag[i] = alloc_zeroed(s->n, 1)) && all;
    s->near = alloc_zeroed(s->n, K * sizeof *s->near);
    s->normal = alloc_array(s->n, sizeof *s->normal);
    s->height = alloc_array(s->n, sizeof *s->height);
    s->chunk_status = alloc_zeroed(s->n / GRAIN + 1, sizeof *s->chunk_status);
    return all && s->near && s->normal && s->height && s->chunk_status ? STATUS_OK : STATUS_NO_MEMORY;
}

enum status planes_new(const struct knn *knn, const vec3 *point, size_t n, unsigned threads, struct planes **planes) {
    struct planes *s = alloc_zeroed(1, sizeof *s);
    enum status status = STATUS_NO_MEMORY;
    if (s) {
        s->point = point, s->n = n;
        status = allocate_planes(s);
    }
    if (!status) {
        s->all = knn;
        memset(s->passes, PASSES, n);
        status = find_near(s, knn, PASSES, threads);
        memset(s->passes, 0, n);
    }
    if (!status)
        *planes = s;
    else
        planes_free(s);
    return status;
}

const uint32_t *planes_near(const struct planes *planes, size_t p) { return &planes->near[p * K]; }

enum status planes_measure(struct planes *planes, const uint8_t *trusted, unsigned threads,
                           const struct offsets **offsets) {
    struct planes *s = planes;
    enum status status = planes_trust(planes, trusted, threads);
    if (status) return status;
    par_for(threads, s->n, GRAIN, plane_range, s);
    par_for(threads, s->n, GRAIN, offset_range, s);
    par_for(threads, s->n, GRAIN, usual_range, s);
    memset(s->changed, 0, s->n);
    s->measured = true;
    *offsets = &s->made;
    return STATUS_OK;
}

void planes_free(struct planes *planes) {
    if (!planes) return;
    struct planes *s = planes;
    free(s->near), free(s->passes), free(s->has_plane), free(s->changed), free(s->off_anew), free(s->was_trusted);
    free(s->spacing), free(s->normal), free(s->height), free(s->chunk_status);
    free(s->made.second), free(s->made.third), free(s->made.quarter);
    free(s->made.usual), free(s->made.rough), free(s->made.radius), free(s->made.sparsity);
    free(s);
}
