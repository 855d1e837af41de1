/* Some pairs at a time (math/simd.h): costs of pairs are most of the work of contraction.
 *
 * The first ten coefficients of a packed quadric are what these monomials of the offset x are multiplied by:
 *
 *     xx  2xy  2xz  yy  2yz  zz  2x  2y  2z  1
 *
 * With the offset from q to p they give E_q at p; with the opposite one, which is as much as the other sign of the
 * three of b, E_p at q.  Even terms and odd ones are summed up apart.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/simplify/pair_cost.h"

#include "core/math/simd.h"

enum { TERMS = 10, LAST_FOUR = 7, SQUARES = 6 };

/* The four coefficients from `at` on of some quadrics, each in a vector of its own. */
INLINE void coefficients_at(const struct packed_quadric *all, const uint32_t id[F64_LANES], size_t at, f64v out[4]) {
    const float *row[F64_LANES];
    for (size_t k = 0; k < F64_LANES; k++) row[k] = (const float *)&all[id[k]] + at;
    f64_columns(row, out);
}

INLINE void coefficients_of(const struct packed_quadric *all, const uint32_t id[F64_LANES], f64v coefficient[TERMS]) {
    f64v last[4];
    coefficients_at(all, id, 0, coefficient);
    coefficients_at(all, id, 4, coefficient + 4);
    coefficients_at(all, id, LAST_FOUR, last); /* from the second of b on; the weight is with them */
    coefficient[8] = last[1];
    coefficient[9] = last[2];
}

/* Those that aren't 0 of quadrics about a point that all of their planes go through. */
INLINE void squares_of(const struct packed_quadric *all, const uint32_t id[F64_LANES], f64v coefficient[SQUARES]) {
    f64v last[4];
    coefficients_at(all, id, 0, coefficient);
    coefficients_at(all, id, SQUARES - 4, last);
    coefficient[4] = last[2];
    coefficient[5] = last[3];
}

INLINE f64v value_of_squares(const f64v c[SQUARES], const f64v m[SQUARES]) {
    return f64_positive((c[0] * m[0] + c[2] * m[2] + c[4] * m[4]) + (c[1] * m[1] + c[3] * m[3] + c[5] * m[5]));
}

INLINE f64v value_of(const f64v c[TERMS], const f64v m[TERMS]) {
    f64v even = c[0] * m[0] + c[2] * m[2] + c[4] * m[4] + c[6] * m[6] + c[8] * m[8];
    f64v odd = c[1] * m[1] + c[3] * m[3] + c[5] * m[5] + c[7] * m[7] + c[9] * m[9];
    return f64_positive(even + odd);
}

/* E_p + E_q with either end staying, and the squared length. */
struct errors {
    f64v p_stays, q_stays, length_sq;
};

/* The offsets from each q to its p. */
INLINE struct f64v3 offsets_of(const struct pair_field *f, const uint32_t p[F64_LANES], const uint32_t q[F64_LANES]) {
    const vec3 *a[F64_LANES], *b[F64_LANES];
    for (size_t k = 0; k < F64_LANES; k++) a[k] = &f->point[p[k]], b[k] = &f->point[q[k]];
    return f64v3_sub(f64v3_gather(a), f64v3_gather(b));
}

INLINE struct errors errors_of(const struct pair_field *f, const uint32_t p[F64_LANES], const uint32_t q[F64_LANES]) {
    struct f64v3 offset = offsets_of(f, p, q);
    f64v x = offset.x, y = offset.y, z = offset.z, x2 = x + x, y2 = y + y, z2 = z + z, c[TERMS];
    f64v monomial[TERMS] = {x * x, x * y2, x2 * z, y * y, z * y2, z * z, x2, y2, z2, f64_all(1)};
    struct errors errors = {.length_sq = monomial[0] + monomial[3] + monomial[5]};
    coefficients_of(f->quadric, q, c);
    f64v own_q = f64_positive(c[9]), moved_q = value_of(c, monomial);
    coefficients_of(f->quadric, p, c);
    c[6] = -c[6], c[7] = -c[7], c[8] = -c[8];
    errors.p_stays = f64_positive(c[9]) + moved_q;
    errors.q_stays = own_q + value_of(c, monomial);
    return errors;
}

/* The same of quadrics whose other coefficients are 0. */
INLINE struct errors first_errors_of(const struct pair_field *f, const uint32_t p[F64_LANES],
                                     const uint32_t q[F64_LANES]) {
    struct f64v3 offset = offsets_of(f, p, q);
    f64v x = offset.x, y = offset.y, z = offset.z, y2 = y + y, c[SQUARES];
    f64v monomial[SQUARES] = {x * x, x * y2, (x + x) * z, y * y, z * y2, z * z};
    struct errors errors = {.length_sq = monomial[0] + monomial[3] + monomial[5]};
    squares_of(f->quadric, q, c);
    errors.p_stays = value_of_squares(c, monomial);
    squares_of(f->quadric, p, c);
    errors.q_stays = value_of_squares(c, monomial);
    return errors;
}

/* What a contraction costs: E_p + E_q at the end where it is less, and the length's part. */
INLINE f64v cost_of(const struct pair_field *f, const struct errors *e) {
    return f64_min(e->p_stays, e->q_stays) + f64_all(f->length_bias) * e->length_sq;
}

/* Fills the last vector up. */
INLINE void repeat_last(uint32_t *p, uint32_t *q, size_t n) {
    for (size_t i = n; i % F64_LANES; i++) p[i] = p[n - 1], q[i] = q[n - 1];
}

FOR_EACH_PROCESSOR(void, pair_costs)
(const struct pair_field *field, uint32_t *p, uint32_t *q, size_t n, float *cost) {
    repeat_last(p, q, n);
    for (size_t i = 0; i < n; i += F64_LANES) {
        struct errors e = field->untouched ? first_errors_of(field, &p[i], &q[i]) : errors_of(field, &p[i], &q[i]);
        f64_store_f32(&cost[i], cost_of(field, &e));
    }
}

FOR_EACH_PROCESSOR(void, pair_errors)
(const struct pair_field *field, uint32_t *p, uint32_t *q, size_t n, double *p_stays, double *q_stays) {
    repeat_last(p, q, n);
    for (size_t i = 0; i < n; i += F64_LANES) {
        struct errors e = errors_of(field, &p[i], &q[i]);
        f64_store(&p_stays[i], e.p_stays);
        f64_store(&q_stays[i], e.q_stays);
    }
}
