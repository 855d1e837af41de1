/* From where a scanner stood the ray to a point is midway between those to the points before and after it in the order,
 * along rows and columns of a camera as on the rings of a scanner that turns, however far each ray goes:
 *
 *      a    c       a - 2 b + c of the directions is next to nothing from e, by what the rays are apart; from elsewhere
 *        b          errors of b's distance, and steps to what is behind, turn it aside
 *       \|/
 *        e
 *
 * Errors along the rays don't count, and smooth surfaces tell nothing, so that it is by noise and steps alone that the
 * true place is told from those beside it, but exactly.  Ends of rows and gaps in them count no more than others that
 * tell of another place: the squares of what is uneven are divided by what they are and a limit, which shrinks to what
 * most of them have.
 *
 * Least squares of that by Levenberg and Marquardt.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/sheet/centre.h"

#include <math.h>

#include "core/math/quantile.h"
#include "core/math/sym3.h"
#include "core/surface/sheet/rays.h"

enum { APPROACHES = 16, MOVES = 40, NARROWINGS = 2, AT_ONCE = 64 };
static const double WIDE = 0.5, NARROW = 0.05, BY_MEDIAN = 2.5; /* the limit, of the rays' step */
static const double DAMPED = 1e-3, EASED = 0.25, STIFFENED = 8, STIFFEST = 1e6;
static const double NO_MORE = 1e-9, LONGEST = 0.5; /* a step, of the distance to the points */
static const double FARTHEST = 8; /* from the points, of their extent: beyond, rays are as good as parallel */

void centre_add(struct centre_triples *triples, uint32_t first, uint32_t between, uint32_t last) {
    uint32_t *of = triples->of[triples->count++];
    of[0] = first, of[1] = between, of[2] = last;
}

void centre_take(struct centre_triples *triples, size_t begin, size_t end, size_t most) {
    size_t all = end - begin < 3 ? 0 : end - begin - 2, room = CENTRE_TRIPLES - triples->count;
    size_t n = all < most ? all : most;
    if (n > room) n = room;
    for (size_t i = 0; i < n; i++) {
        uint32_t middle = (uint32_t)(begin + 1 + i * all / n);
        centre_add(triples, middle - 1, middle, middle + 1);
    }
}

struct three {
    vec3 first, between, last;
};

static struct three three_of(const struct centre_triples *triples, size_t i) {
    const uint32_t *of = triples->of[i];
    return (struct three){triples->point[of[0]], triples->point[of[1]], triples->point[of[2]]};
}

/* Of the n triples from the first on. */
static size_t turned_at(const struct centre_triples *triples, size_t first, vec3 place, double square[AT_ONCE]) {
    size_t left = triples->count - first, n = left < AT_ONCE ? left : AT_ONCE;
    rays_turned(triples->point, &triples->of[first], n, place, square);
    return n;
}

static double unevenness_by(const struct centre_triples *triples, vec3 place, double limit) {
    double sum = 0, square[AT_ONCE];
    for (size_t i = 0, n; i < triples->count; i += n) {
        n = turned_at(triples, i, place, square);
        for (size_t k = 0; k < n; k++) sum += square[k] / (square[k] + limit * limit);
    }
    return triples->count ? sum / (double)triples->count : 1;
}

double centre_unevenness(const struct centre_triples *triples, vec3 place) {
    return unevenness_by(triples, place, WIDE);
}

void centre_unevenness_each(const vec3 *point, const uint32_t (*of)[3], size_t n, vec3 place, double *uneven) {
    rays_turned(point, of, n, place, uneven);
    for (size_t i = 0; i < n; i++) uneven[i] = uneven[i] / (uneven[i] + WIDE * WIDE);
}

double centre_unevenness_of_points(const struct centre_triples *triples) {
    double sum = 0;
    for (size_t i = 0; i < triples->count; i++) {
        struct three p = three_of(triples, i);
        double apart = vec3_distance_sq(p.first, p.last),
               aside = 4 * vec3_distance_sq(vec3_add(p.first, p.last), vec3_scale(p.between, 2));
        sum += aside > 0 ? aside / (aside + WIDE * WIDE * apart) : 0;
    }
    return triples->count ? sum / (double)triples->count : 0;
}

/* Half the gradient of unevenness_by, times the count, and the normal matrix. */
static sym3 equations_at(const struct centre_triples *triples, vec3 place, double limit, vec3 *gradient) {
    struct rays_terms terms[AT_ONCE];
    sym3 normal = {0};
    *gradient = (vec3){0, 0, 0};
    for (size_t i = 0, n; i < triples->count; i += n) {
        n = triples->count - i < AT_ONCE ? triples->count - i : AT_ONCE;
        rays_equations(triples->point, &triples->of[i], n, place, limit * limit, terms);
        for (size_t k = 0; k < n; k++) {
            for (int row = 0; row < 3; row++) normal = sym3_add(normal, terms[k].row[row]);
            *gradient = vec3_add(*gradient, terms[k].gradient);
        }
    }
    return normal;
}

static vec3 damped_step(sym3 normal, vec3 gradient, double damping) {
    double value[3];
    vec3 axis[3], step = {0, 0, 0};
    sym3_eigen(normal, value, axis);
    for (int k = 0; k < 3; k++) {
        double stiff = fmax(value[k], 0) + damping * fmax(value[2], 1e-300);
        step = vec3_sub(step, vec3_scale(axis[k], vec3_dot(axis[k], gradient) / stiff));
    }
    return step;
}

/* The middle of the points, and how far off a place may be. */
static double bounds_of(const struct centre_triples *triples, vec3 *middle) {
    vec3 low = triples->point[triples->of[0][1]], high = low;
    for (size_t i = 1; i < triples->count; i++) {
        vec3 p = triples->point[triples->of[i][1]];
        low = vec3_min(low, p), high = vec3_max(high, p);
    }
    *middle = vec3_lerp(low, high, 0.5);
    return FARTHEST * vec3_distance(low, high);
}

/* Until no step is better or worth it. */
static void descend(const struct centre_triples *triples, double limit, int moves, vec3 *place) {
    vec3 gradient, middle;
    double damping = DAMPED, best = unevenness_by(triples, *place, limit), bound = bounds_of(triples, &middle);
    sym3 normal = equations_at(triples, *place, limit, &gradient);
    for (int move = 0; move < moves && damping < STIFFEST; move++) {
        vec3 step = damped_step(normal, gradient, damping), at = vec3_add(*place, step);
        double length = vec3_length(step), far = vec3_distance(middle, *place);
        if (!(length > NO_MORE * far)) return;
        if (length > LONGEST * far) at = vec3_add(*place, vec3_scale(step, LONGEST * far / length));
        double tried = vec3_distance(at, middle) < bound ? unevenness_by(triples, at, limit) : INFINITY;
        damping *= tried < best ? EASED : STIFFENED;
        if (tried >= best) continue;
        best = tried, *place = at;
        normal = equations_at(triples, *place, limit, &gradient);
    }
}

/* What most triples are uneven by, within bounds. */
static double limit_at(const struct centre_triples *triples, vec3 place) {
    float square[CENTRE_TRIPLES];
    double turned[AT_ONCE];
    for (size_t i = 0, n; i < triples->count; i += n) {
        n = turned_at(triples, i, place, turned);
        for (size_t k = 0; k < n; k++) square[i + k] = (float)fmin(turned[k], 1e6);
    }
    double median = sqrt((double)quantile_of(square, triples->count, 0.5));
    return fmin(fmax(BY_MEDIAN * median, NARROW), WIDE);
}

double centre_approach(const struct centre_triples *triples, vec3 *place) {
    if (triples->count) descend(triples, WIDE, APPROACHES, place);
    return centre_unevenness(triples, *place);
}

double centre_refine(const struct centre_triples *triples, vec3 *place) {
    for (int i = 0; i < NARROWINGS && triples->count; i++) descend(triples, limit_at(triples, *place), MOVES, place);
    return centre_unevenness(triples, *place);
}
