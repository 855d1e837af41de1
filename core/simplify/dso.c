/* For a unit tangent t, |dN(t)|^2 = kappa_n^2 + tau_g^2: the squared normal curvature plus the squared geodesic torsion
 * (do Carmo, section 3-3).  That is what both forms estimate from differences of normals over distances.
 *
 * Close pairs would make d tiny and noise huge, so 1 / d is replaced by d / (d^2 + eta^2), eta a quarter of the
 * spacing.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/simplify/dso.h"

#include "core/base/par.h"

enum { GRAIN = 2048 };
static const double SOFTENING = 0.25;
static const double WEIGHT_FLOOR = 1e-2, WEIGHT_MIN = 1e-3, WEIGHT_MAX = 1e3;

struct shape {
    const vec3 *point, *normal;
    const struct neighbourhood *neighbours;
    enum dso_form form;
    float *dso;
};

static vec3 aligned(vec3 normal, vec3 to) { return vec3_dot(normal, to) < 0 ? vec3_scale(normal, -1) : normal; }

static double inverse_distance(double d, double eta) { return d / (d * d + eta * eta); }

static double rms_form(const struct shape *shape, size_t p) {
    const struct neighbourhood *neighbours = shape->neighbours;
    double eta = SOFTENING * (double)neighbours->spacing[p], sum = 0;
    for (unsigned i = 0; i < neighbours->count[p]; i++) {
        uint32_t q = neighbours->id[p * neighbours->stride + i];
        double w = inverse_distance(vec3_distance(shape->point[p], shape->point[q]), eta);
        sum += w * w * vec3_distance_sq(shape->normal[p], aligned(shape->normal[q], shape->normal[p]));
    }
    return neighbours->count[p] ? sqrt(sum / neighbours->count[p]) : 0;
}

/* The direction of e in the plane across unit n; zero where e is along n. */
static vec3 tangent(vec3 e, vec3 n) {
    vec3 t = vec3_sub(e, vec3_scale(n, vec3_dot(e, n)));
    return vec3_length_sq(t) <= 1e-18 * vec3_length_sq(e) ? (vec3){0, 0, 0} : vec3_unit(t);
}

static double sum_form(const struct shape *shape, size_t p) {
    const struct neighbourhood *neighbours = shape->neighbours;
    vec3 np = shape->normal[p], k = {0, 0, 0}, tau = {0, 0, 0};
    double eta = SOFTENING * (double)neighbours->spacing[p];
    for (unsigned i = 0; i < neighbours->count[p]; i++) {
        uint32_t q = neighbours->id[p * neighbours->stride + i];
        vec3 e = vec3_sub(shape->point[q], shape->point[p]), nq = aligned(shape->normal[q], np);
        vec3 tp = tangent(e, np), tq = tangent(e, nq);
        if (vec3_length_sq(tp) == 0 || vec3_length_sq(tq) == 0) continue;
        double w = inverse_distance(vec3_length(e), eta);
        k = vec3_add(k, vec3_scale(vec3_sub(tp, tq), w));
        tau = vec3_add(tau, vec3_scale(vec3_sub(vec3_cross(tp, np), vec3_cross(tq, nq)), w));
    }
    return neighbours->count[p] ? sqrt(vec3_length_sq(k) + vec3_length_sq(tau)) / neighbours->count[p] : 0;
}

static void dso_range(void *ctx, size_t begin, size_t end) {
    const struct shape *shape = ctx;
    for (size_t p = begin; p < end; p++)
        shape->dso[p] = shape->form == DSO_RMS   ? (float)rms_form(shape, p)
                        : shape->form == DSO_SUM ? (float)sum_form(shape, p)
                                                 : 1;
}

void dso_compute(const vec3 *point, const vec3 *normal, const struct neighbourhood *neighbourhood, enum dso_form form,
                 unsigned threads, float *dso) {
    struct shape shape = {point, normal, neighbourhood, form, dso};
    par_for(threads, neighbourhood->n, GRAIN, dso_range, &shape);
}

struct smoothing {
    const struct neighbourhood *neighbours;
    const float *dso;
    float *smooth;
};

static void smooth_range(void *ctx, size_t begin, size_t end) {
    const struct smoothing *s = ctx;
    for (size_t p = begin; p < end; p++) {
        const uint32_t *near = s->neighbours->id + p * s->neighbours->stride;
        double sum = (double)s->dso[p];
        for (unsigned i = 0; i < s->neighbours->count[p]; i++) sum += (double)s->dso[near[i]];
        s->smooth[p] = (float)(sum / (1.0 + s->neighbours->count[p]));
    }
}

void dso_smooth(const float *dso, const struct neighbourhood *neighbourhood, unsigned threads, float *smooth) {
    struct smoothing smoothing = {neighbourhood, dso, smooth};
    par_for(threads, neighbourhood->n, GRAIN, smooth_range, &smoothing);
}

double dso_average(const float *dso, const uint8_t *own, size_t n) {
    double sum = 0;
    size_t count = 0;
    for (size_t i = 0; i < n; i++) {
        if (own && !own[i]) continue;
        sum += (double)dso[i];
        count++;
    }
    return count ? sum / (double)count : 0;
}

struct weighting {
    const float *dso;
    double average, exponent;
    float *weight;
};

static void weight_range(void *ctx, size_t begin, size_t end) {
    const struct weighting *w = ctx;
    for (size_t i = begin; i < end; i++) {
        double relative = w->average > 0 ? ((double)w->dso[i] / w->average + WEIGHT_FLOOR) / (1 + WEIGHT_FLOOR) : 1;
        w->weight[i] = (float)fmin(fmax(pow(relative, w->exponent), WEIGHT_MIN), WEIGHT_MAX);
    }
}

void dso_weights(const float *dso, size_t n, double average, double exponent, unsigned threads, float *weight) {
    struct weighting weighting = {dso, average, exponent, weight};
    par_for(threads, n, GRAIN, weight_range, &weighting);
}
