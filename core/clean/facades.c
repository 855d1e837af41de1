/* A scanner in the air sees ground and roofs densely and walls hardly, from the side:
 *
 *      . . . . .            s   a stray: all points beside it in the plan are lower
 *              .
 *              w            w   of a wall: roof and ground are beside it
 *                . . . .
 *
 * Heights are those along z, since nothing else is known of points yet.  Points of a scan from above have others above
 * or below them at few places; other clouds are left alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/clean/facades.h"

#include <math.h>
#include <stdbool.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/spatial/knn.h"

enum { PLACES = 1024, BESIDE = 16, ABOVE = 3 /* of those beside, so many make a layer */ };
static const double LAYER = 6;      /* higher or lower than the farthest of those beside is far */
static const double LAYERED = 0.45; /* share of the places; cities have up to .4, solids and rooms over .5 */
static const double STEP = 2;       /* from the lowest beside a wall to the highest, of how far these are */

/* The points that stand nowhere off, and their plan. */
struct plan {
    size_t n;
    vec3 *foot;     /* z = 0 */
    double *height; /* z */
    struct knn *knn;
};

/* What is beside one place. */
struct beside {
    double radius, low, high;
    int layer; /* how many are far above or below */
};

static void plan_done(struct plan *plan) {
    knn_free(plan->knn);
    free(plan->foot), free(plan->height);
}

static enum status plan_init(struct plan *plan, const vec3 *point, const uint8_t *outlier, size_t n, unsigned threads) {
    *plan = (struct plan){0};
    plan->foot = alloc_array(n, sizeof *plan->foot);
    plan->height = alloc_array(n, sizeof *plan->height);
    if (!plan->foot || !plan->height) return STATUS_NO_MEMORY;
    for (size_t p = 0; p < n; p++) {
        if (outlier[p]) continue;
        plan->foot[plan->n] = (vec3){point[p].x, point[p].y, 0};
        plan->height[plan->n++] = point[p].z;
    }
    return plan->n > 0 ? knn_new(plan->foot, plan->n, threads, &plan->knn, NULL) : STATUS_OK;
}

/* What is beside m places. */
static enum status look_beside(const struct plan *plan, const vec3 *place, size_t m, unsigned threads,
                               struct beside *beside) {
    vec3 *foot = alloc_array(m, sizeof *foot);
    uint32_t *id = alloc_array(m * BESIDE, sizeof *id);
    double *distance_sq = alloc_array(m * BESIDE, sizeof *distance_sq);
    enum status status = foot && id && distance_sq ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t i = 0; i < m && !status; i++) foot[i] = (vec3){place[i].x, place[i].y, 0};
    if (!status) status = knn_search(plan->knn, foot, m, BESIDE, threads, id, distance_sq);
    for (size_t i = 0; i < m && !status; i++) {
        struct beside found = {.low = INFINITY, .high = -INFINITY};
        found.radius = sqrt(distance_sq[i * BESIDE + BESIDE - 1]);
        for (size_t k = 0; k < BESIDE; k++) {
            double z = plan->height[id[i * BESIDE + k]];
            found.low = fmin(found.low, z), found.high = fmax(found.high, z);
            found.layer += fabs(z - place[i].z) > LAYER * found.radius;
        }
        beside[i] = found;
    }
    free(foot), free(id), free(distance_sq);
    return status;
}

static enum status is_from_above(const struct plan *plan, unsigned threads, bool *from_above) {
    struct beside beside[PLACES];
    vec3 place[PLACES];
    size_t layered = 0;
    for (size_t i = 0; i < PLACES; i++) {
        size_t p = i * plan->n / PLACES;
        place[i] = (vec3){plan->foot[p].x, plan->foot[p].y, plan->height[p]};
    }
    enum status status = look_beside(plan, place, PLACES, threads, beside);
    for (size_t i = 0; i < PLACES && !status; i++) layered += beside[i].layer >= ABOVE;
    *from_above = !status && (double)layered < LAYERED * PLACES;
    return status;
}

static bool is_wall(const struct beside *beside, double z) {
    return beside->low < z && z < beside->high && beside->high - beside->low > STEP * beside->radius;
}

static enum status spare(const struct plan *plan, const vec3 *point, size_t n, unsigned threads, uint8_t *outlier,
                         size_t *spared) {
    size_t count = 0, m = 0;
    for (size_t p = 0; p < n; p++) count += outlier[p] != 0;
    vec3 *place = alloc_array(count, sizeof *place);
    struct beside *beside = alloc_array(count, sizeof *beside);
    enum status status = place && beside ? STATUS_OK : STATUS_NO_MEMORY;
    for (size_t p = 0; p < n && !status; p++)
        if (outlier[p]) place[m++] = point[p];
    if (!status) status = look_beside(plan, place, count, threads, beside);
    for (size_t p = 0, i = 0; p < n && !status; p++) {
        if (!outlier[p] || !is_wall(&beside[i++], point[p].z)) continue;
        outlier[p] = 0, (*spared)++;
    }
    free(place), free(beside);
    return status;
}

enum status facades_spare(const vec3 *point, size_t n, unsigned threads, uint8_t *outlier, size_t *spared) {
    struct plan plan;
    bool any = false, from_above = false;
    *spared = 0;
    for (size_t p = 0; p < n && !any; p++) any = outlier[p];
    if (!any || n < FACADES_MIN_POINTS) return STATUS_OK;
    enum status status = plan_init(&plan, point, outlier, n, threads);
    if (!status && plan.n >= FACADES_MIN_POINTS / 2) status = is_from_above(&plan, threads, &from_above);
    if (!status && from_above) status = spare(&plan, point, n, threads, outlier, spared);
    plan_done(&plan);
    return status;
}
