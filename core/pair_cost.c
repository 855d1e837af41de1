/* Four pairs at a time: costs of pairs are most of the work of contraction.
 *
 * The first ten coefficients of a packed quadric are what these monomials of the offset x are multiplied by:
 *
 *     xx  2xy  2xz  yy  2yz  zz  2x  2y  2z  1
 *
 * With the offset from q to p they give E_q at p; with the opposite one, which is as much as the other sign of the
 * three of b, E_p at q.  Even terms and odd ones are summed up apart.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/pair_cost.h"

#include <string.h>

#include "core/lanes.h"

enum { TERMS = 10, LAST_FOUR = 7, SQUARES = 6 };

typedef float floats __attribute__((vector_size(16)));

/* Without a register to be in, the numbers would be loaded one by one. */
INLINE lanes widened(floats x) {
#if defined(__x86_64__)
    __asm__("" : "+x"(x));
#endif
    return (lanes){(double)x[0], (double)x[1], (double)x[2], (double)x[3]};
}

INLINE floats floats_at(const struct packed_quadric *q, size_t at) {
    floats four;
    memcpy(&four, (const float *)q + at, sizeof four);
    return four;
}

/* Of four quadrics the four coefficients from one on, each in a vector of its own. */
INLINE void across(const struct packed_quadric *all, const uint32_t id[LANES], size_t at, lanes coefficient[LANES]) {
    floats a = floats_at(&all[id[0]], at), b = floats_at(&all[id[1]], at);
    floats c = floats_at(&all[id[2]], at), d = floats_at(&all[id[3]], at);
    floats ab = __builtin_shufflevector(a, b, 0, 4, 1, 5), cd = __builtin_shufflevector(c, d, 0, 4, 1, 5);
    coefficient[0] = widened(__builtin_shufflevector(ab, cd, 0, 1, 4, 5));
    coefficient[1] = widened(__builtin_shufflevector(ab, cd, 2, 3, 6, 7));
    ab = __builtin_shufflevector(a, b, 2, 6, 3, 7), cd = __builtin_shufflevector(c, d, 2, 6, 3, 7);
    coefficient[2] = widened(__builtin_shufflevector(ab, cd, 0, 1, 4, 5));
    coefficient[3] = widened(__builtin_shufflevector(ab, cd, 2, 3, 6, 7));
}

INLINE void coefficients_of(const struct packed_quadric *all, const uint32_t id[LANES], lanes coefficient[TERMS]) {
    lanes last[LANES];
    across(all, id, 0, coefficient);
    across(all, id, 4, coefficient + 4);
    across(all, id, LAST_FOUR, last); /* from the second of b on; the weight is with them */
    coefficient[8] = last[1];
    coefficient[9] = last[2];
}

/* Those that aren't 0 of quadrics about a point that all of their planes go through. */
INLINE void squares_of(const struct packed_quadric *all, const uint32_t id[LANES], lanes coefficient[SQUARES]) {
    lanes last[LANES];
    across(all, id, 0, coefficient);
    across(all, id, SQUARES - LANES, last);
    coefficient[4] = last[2];
    coefficient[5] = last[3];
}

INLINE lanes value_of_squares(const lanes c[SQUARES], const lanes m[SQUARES]) {
    return lanes_positive((c[0] * m[0] + c[2] * m[2] + c[4] * m[4]) + (c[1] * m[1] + c[3] * m[3] + c[5] * m[5]));
}

INLINE lanes value_of(const lanes c[TERMS], const lanes m[TERMS]) {
    lanes even = c[0] * m[0] + c[2] * m[2] + c[4] * m[4] + c[6] * m[6] + c[8] * m[8];
    lanes odd = c[1] * m[1] + c[3] * m[3] + c[5] * m[5] + c[7] * m[7] + c[9] * m[9];
    return lanes_positive(even + odd);
}

struct errors {
    lanes p_stays, q_stays, length_sq;
};

/* The offsets from each q to its p. */
INLINE void offsets_of(const struct pair_field *f, const uint32_t p[LANES], const uint32_t q[LANES], lanes offset[3]) {
    const vec3 *a = f->point, *b = f->point;
    lanes x = (lanes){a[p[0]].x, a[p[1]].x, a[p[2]].x, a[p[3]].x} - (lanes){b[q[0]].x, b[q[1]].x, b[q[2]].x, b[q[3]].x};
    lanes y = (lanes){a[p[0]].y, a[p[1]].y, a[p[2]].y, a[p[3]].y} - (lanes){b[q[0]].y, b[q[1]].y, b[q[2]].y, b[q[3]].y};
    lanes z = (lanes){a[p[0]].z, a[p[1]].z, a[p[2]].z, a[p[3]].z} - (lanes){b[q[0]].z, b[q[1]].z, b[q[2]].z, b[q[3]].z};
    offset[0] = x, offset[1] = y, offset[2] = z;
}

INLINE struct errors errors_of(const struct pair_field *f, const uint32_t p[LANES], const uint32_t q[LANES]) {
    lanes offset[3];
    offsets_of(f, p, q, offset);
    lanes x = offset[0], y = offset[1], z = offset[2];
    lanes x2 = x + x, y2 = y + y, z2 = z + z, c[TERMS];
    lanes monomial[TERMS] = {x * x, x * y2, x2 * z, y * y, z * y2, z * z, x2, y2, z2, lanes_all(1)};
    struct errors errors = {.length_sq = monomial[0] + monomial[3] + monomial[5]};
    coefficients_of(f->quadric, q, c);
    lanes own_q = lanes_positive(c[9]), moved_q = value_of(c, monomial);
    coefficients_of(f->quadric, p, c);
    c[6] = -c[6], c[7] = -c[7], c[8] = -c[8];
    errors.p_stays = lanes_positive(c[9]) + moved_q;
    errors.q_stays = own_q + value_of(c, monomial);
    return errors;
}

/* The same of quadrics whose other coefficients are 0. */
INLINE struct errors first_errors_of(const struct pair_field *f, const uint32_t p[LANES], const uint32_t q[LANES]) {
    lanes offset[3];
    offsets_of(f, p, q, offset);
    lanes x = offset[0], y = offset[1], z = offset[2], y2 = y + y, c[SQUARES];
    lanes monomial[SQUARES] = {x * x, x * y2, (x + x) * z, y * y, z * y2, z * z};
    struct errors errors = {.length_sq = monomial[0] + monomial[3] + monomial[5]};
    squares_of(f->quadric, q, c);
    errors.p_stays = value_of_squares(c, monomial);
    squares_of(f->quadric, p, c);
    errors.q_stays = value_of_squares(c, monomial);
    return errors;
}

/* Fills the last four up. */
static void repeat_last(uint32_t *p, uint32_t *q, size_t n) {
    for (size_t i = n; i % LANES; i++) p[i] = p[n - 1], q[i] = q[n - 1];
}

FOR_EACH_PROCESSOR
void pair_costs(const struct pair_field *field, uint32_t *p, uint32_t *q, size_t n, float *cost) {
    repeat_last(p, q, n);
    for (size_t i = 0; i < n; i += LANES) {
        struct errors e = field->untouched ? first_errors_of(field, &p[i], &q[i]) : errors_of(field, &p[i], &q[i]);
        lanes sum = lanes_lower(e.p_stays, e.q_stays) + lanes_all(field->length_bias) * e.length_sq;
        floats rounded = __builtin_convertvector(sum, floats);
        memcpy(&cost[i], &rounded, sizeof rounded);
    }
}

FOR_EACH_PROCESSOR
void pair_errors(const struct pair_field *field, uint32_t *p, uint32_t *q, size_t n, double *p_stays, double *q_stays) {
    repeat_last(p, q, n);
    for (size_t i = 0; i < n; i += LANES) {
        struct errors e = errors_of(field, &p[i], &q[i]);
        lanes_store(&p_stays[i], e.p_stays);
        lanes_store(&q_stays[i], e.q_stays);
    }
}
