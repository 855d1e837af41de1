/* The discrete shape operator: how fast the normal turns around a point (Lee, Jong sections 3 and 4.3).
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_SIMPLIFY_DSO_H
#define WHITTLE_CORE_SIMPLIFY_DSO_H

#include "core/params.h"
#include "core/spatial/neighbourhood.h"

/* dso[p], n of them: in 1 / diagonal (the inverse of a radius of curvature, in the normalised frame), never negative.
 *   DSO_RMS   sqrt( mean |n_p - s n_q|^2 / d^2 ), s = the sign that aligns the two normals: does not cancel on saddles
 *   DSO_SUM   the paper's: sqrt( k^2 + tau^2 ), k = | sum (T_p - T_q) / d |, tau = | sum (B_p - B_q) / d |, divided by
 *             the number of neighbours so that it doesn't depend on the density (Lee, Jong section 3)
 *   DSO_NONE  1 everywhere
 *
 * In place of 1 / d stands what is softened where neighbours are very near (dso.c).  O(n). */
void dso_compute(const vec3 *point, const vec3 *normal, const struct neighbourhood *neighbourhood, enum dso_form form,
                 unsigned threads, float *dso);

/* smooth[p] = the mean of dso over p and its neighbours; smooth is not dso.  A single point's operator is noisy, and a
 * weight that changes from point to point favours some neighbours over others without a reason in the shape.  O(n). */
void dso_smooth(const float *dso, const struct neighbourhood *neighbourhood, unsigned threads, float *smooth);

/* The mean of dso over the points that own marks, or over all n (own NULL); 0 of none. */
double dso_average(const float *dso, const uint8_t *own, size_t n);

/* weight[p] = (dso[p] / average)^exponent, kept within 1e-3 .. 1e3 and with a floor that keeps flat regions alive; 1
 * where the average is 0 (a plane) or the exponent is 0.  point_quadrics.h says what is given for dso. */
void dso_weights(const float *dso, size_t n, double average, double exponent, unsigned threads, float *weight);

#endif
