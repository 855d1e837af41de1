/* Vectors: as many numbers as a register of the processor holds, and what is done with them.
 *
 *                     f32v, i32v   f64v, i64v
 *     AVX2                     8            4
 *     SSE2, NEON               4            2
 *     SIMD_SCALAR              1            1     plain numbers: make config=scalar
 *
 * A kernel is written once, over vectors of F32_LANES or F64_LANES numbers, and compiled for each width
 * (FOR_EACH_PROCESSOR of base/processor.h).  At a width of one it is its own scalar twin: + - * / and & | ~ are the
 * language's, and all else is one of the functions below, each of which says in its scalar form what it does to a
 * number.
 *
 * Every width gives the same bits.  Each number of a result depends on the numbers of its own place alone, nothing is
 * fused, and what is added up over many is kept in SIMD_SUMS parts, whatever the width, and added in one order.
 *
 * A mask has all bits of a place set (true) or none: i32v for numbers of 32 bits, i64v for those of 64.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_MATH_SIMD_H
#define WHITTLE_CORE_MATH_SIMD_H

#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "core/base/processor.h"
#include "core/math/vec3.h"

#if defined(SIMD_SCALAR)
#define SIMD_WIDTH 1
#elif defined(__AVX2__)
#define SIMD_WIDTH 8
#else
#define SIMD_WIDTH 4
#endif
#if SIMD_WIDTH > 1 && defined(__SSE2__)
#define SIMD_X86
#include <immintrin.h>
#endif

#if SIMD_WIDTH == 1
enum { F32_LANES = 1, F64_LANES = 1 };
typedef float f32v;
typedef double f64v;
typedef int32_t i32v;
typedef int64_t i64v;
#define SIMD_MASK(type, truth) ((type) - (truth))
#define SIMD_LANE(x, k) ((void)(k), (x))
#define SIMD_ALL32(type, x) ((void)0, (type)(x))
#define SIMD_ALL64(type, x) ((void)0, (type)(x))
#else
enum { F32_LANES = SIMD_WIDTH, F64_LANES = SIMD_WIDTH / 2 };
typedef float f32v __attribute__((vector_size(4 * SIMD_WIDTH)));
typedef double f64v __attribute__((vector_size(4 * SIMD_WIDTH)));
typedef int32_t i32v __attribute__((vector_size(4 * SIMD_WIDTH)));
typedef int64_t i64v __attribute__((vector_size(4 * SIMD_WIDTH)));
#define SIMD_MASK(type, truth) ((type)(truth))
#define SIMD_LANE(x, k) ((x)[k])
#if SIMD_WIDTH == 8
#define SIMD_ALL32(type, x) ((type){x, x, x, x, x, x, x, x})
#define SIMD_ALL64(type, x) ((type){x, x, x, x})
#else
#define SIMD_ALL32(type, x) ((type){x, x, x, x})
#define SIMD_ALL64(type, x) ((type){x, x})
#endif
#endif

/* Sums over many are kept in so many parts: number i is in part i % F32_SUMS, or F64_SUMS.  F32_PARTS vectors hold
 * them. */
enum { F32_SUMS = 8, F64_SUMS = 4, F32_PARTS = F32_SUMS / F32_LANES, F64_PARTS = F64_SUMS / F64_LANES };

/* ------------------------------------------------------------------------------------------------ 32 bits */

INLINE f32v f32_all(float x) { return SIMD_ALL32(f32v, x); }
INLINE i32v i32_all(int32_t x) { return SIMD_ALL32(i32v, x); }

INLINE f32v f32_load(const float *p) {
    f32v x;
    memcpy(&x, p, sizeof x);
    return x;
}
INLINE i32v i32_load(const void *p) {
    i32v x;
    memcpy(&x, p, sizeof x);
    return x;
}
INLINE void f32_store(float *p, f32v x) { memcpy(p, &x, sizeof x); }

INLINE i32v f32_less(f32v a, f32v b) { return SIMD_MASK(i32v, a < b); }
INLINE i32v f32_at_least(f32v a, f32v b) { return SIMD_MASK(i32v, a >= b); }
INLINE i32v f32_equal(f32v a, f32v b) { return SIMD_MASK(i32v, a == b); }
INLINE i32v i32_less(i32v a, i32v b) { return SIMD_MASK(i32v, a < b); }
INLINE i32v f32_is_positive(f32v a) { return f32_less(f32_all(0), a); }

INLINE bool i32_any(i32v m) {
    uint64_t part[(sizeof m + 7) / 8] = {0}, all = 0;
    memcpy(part, &m, sizeof m);
    for (size_t k = 0; k < sizeof part / sizeof *part; k++) all |= part[k];
    return all != 0;
}

#if SIMD_WIDTH == 1
INLINE f32v f32_pick(i32v m, f32v a, f32v b) { return m ? a : b; }
INLINE i32v i32_pick(i32v m, i32v a, i32v b) { return m ? a : b; }
INLINE f32v f32_where(i32v m, f32v a) { return m ? a : 0; }
INLINE f32v f32_abs(f32v a) { return fabsf(a); }
INLINE f32v f32_sqrt(f32v a) { return sqrtf(a); }
INLINE i32v i32_count(void) { return 0; } /* 0, 1, 2, ... */
#else
INLINE f32v f32_pick(i32v m, f32v a, f32v b) { return (f32v)((m & (i32v)a) | (~m & (i32v)b)); }
INLINE i32v i32_pick(i32v m, i32v a, i32v b) { return (m & a) | (~m & b); }
INLINE f32v f32_where(i32v m, f32v a) { return (f32v)(m & (i32v)a); }
INLINE f32v f32_abs(f32v a) { return (f32v)((i32v)a & INT32_MAX); }
#if SIMD_WIDTH == 8
INLINE f32v f32_sqrt(f32v a) { return (f32v)_mm256_sqrt_ps((__m256)a); }
INLINE i32v i32_count(void) { return (i32v){0, 1, 2, 3, 4, 5, 6, 7}; }
#else
INLINE i32v i32_count(void) { return (i32v){0, 1, 2, 3}; }
#ifdef SIMD_X86
INLINE f32v f32_sqrt(f32v a) { return (f32v)_mm_sqrt_ps((__m128)a); }
#else
INLINE f32v f32_sqrt(f32v a) { return (f32v){sqrtf(a[0]), sqrtf(a[1]), sqrtf(a[2]), sqrtf(a[3])}; }
#endif
#endif
#endif

/* a < b ? a : b, a > b ? a : b: the second one where either isn't a number. */
#if SIMD_WIDTH == 8
INLINE f32v f32_min(f32v a, f32v b) { return (f32v)_mm256_min_ps((__m256)a, (__m256)b); }
INLINE f32v f32_max(f32v a, f32v b) { return (f32v)_mm256_max_ps((__m256)a, (__m256)b); }
#elif defined(SIMD_X86)
INLINE f32v f32_min(f32v a, f32v b) { return (f32v)_mm_min_ps((__m128)a, (__m128)b); }
INLINE f32v f32_max(f32v a, f32v b) { return (f32v)_mm_max_ps((__m128)a, (__m128)b); }
#else
INLINE f32v f32_min(f32v a, f32v b) { return f32_pick(f32_less(a, b), a, b); }
INLINE f32v f32_max(f32v a, f32v b) { return f32_pick(f32_less(b, a), a, b); }
#endif
INLINE f32v f32_positive(f32v a) { return f32_max(a, f32_all(0)); }

/* table[which], each in 0 .. 7; neighbours mostly the same. */
INLINE f32v f32_lookup(const float table[8], i32v which) {
#if SIMD_WIDTH == 1
    return table[which];
#elif SIMD_WIDTH == 8
    return (f32v)_mm256_permutevar8x32_ps((__m256)f32_load(table), (__m256i)which);
#else
    return (f32v){table[which[0]], table[which[1]], table[which[2]], table[which[3]]};
#endif
}

/* The sum of F32_SUMS parts. */
INLINE double f32_total(const f32v sum[F32_PARTS]) {
#define SIMD_PART(k) ((double)SIMD_LANE(sum[(k) / F32_LANES], (k) % F32_LANES))
    double low = (SIMD_PART(0) + SIMD_PART(1)) + (SIMD_PART(2) + SIMD_PART(3));
    double high = (SIMD_PART(4) + SIMD_PART(5)) + (SIMD_PART(6) + SIMD_PART(7));
#undef SIMD_PART
    return low + high;
}

/* The place of the first of F32_SUMS numbers that none is less than. */
INLINE unsigned f32_place_of_least(const f32v x[F32_PARTS]) {
#if SIMD_WIDTH == 8
    f32v least = x[0];
    least = f32_min(least, f32_lookup((const float *)&least, (i32v){4, 5, 6, 7, 0, 1, 2, 3}));
    least = f32_min(least, f32_lookup((const float *)&least, (i32v){2, 3, 0, 1, 6, 7, 4, 5}));
    least = f32_min(least, f32_lookup((const float *)&least, (i32v){1, 0, 3, 2, 5, 4, 7, 6}));
    unsigned places = (unsigned)_mm256_movemask_ps((__m256)f32_equal(x[0], least));
    return places ? (unsigned)__builtin_ctz(places) : F32_SUMS - 1;
#elif defined(SIMD_X86)
    __m128 least = _mm_min_ps((__m128)x[0], (__m128)x[1]);
    least = _mm_min_ps(least, _mm_shuffle_ps(least, least, _MM_SHUFFLE(1, 0, 3, 2)));
    least = _mm_min_ps(least, _mm_shuffle_ps(least, least, _MM_SHUFFLE(2, 3, 0, 1)));
    int low = _mm_movemask_ps(_mm_cmpeq_ps((__m128)x[0], least)),
        high = _mm_movemask_ps(_mm_cmpeq_ps((__m128)x[1], least));
    unsigned places = (unsigned)(low | high << 4);
    return places ? (unsigned)__builtin_ctz(places) : F32_SUMS - 1;
#else
    float each[F32_SUMS];
    unsigned place = 0;
    memcpy(each, x, sizeof each);
    for (unsigned k = 1; k < F32_SUMS; k++) place = each[k] < each[place] ? k : place;
    return place;
#endif
}

/* ------------------------------------------------------------------------------------------------ 64 bits */

INLINE f64v f64_all(double x) { return SIMD_ALL64(f64v, x); }
INLINE i64v i64_all(int64_t x) { return SIMD_ALL64(i64v, x); }

INLINE f64v f64_load(const double *p) {
    f64v x;
    memcpy(&x, p, sizeof x);
    return x;
}
INLINE void f64_store(double *p, f64v x) { memcpy(p, &x, sizeof x); }

INLINE i64v f64_less(f64v a, f64v b) { return SIMD_MASK(i64v, a < b); }
INLINE i64v f64_at_least(f64v a, f64v b) { return SIMD_MASK(i64v, a >= b); }
INLINE i64v f64_is_positive(f64v a) { return f64_less(f64_all(0), a); }

/* How many places of a mask are true, negative. */
INLINE int64_t i64_total(i64v m) {
    int64_t sum = 0;
    for (int k = 0; k < F64_LANES; k++) sum += SIMD_LANE(m, k);
    return sum;
}

/* A bit for each lane of a mask. */
INLINE uint32_t i64_bits_of(i64v m) {
#if SIMD_WIDTH == 8
    return (uint32_t)_mm256_movemask_pd((__m256d)m);
#elif defined(SIMD_X86)
    return (uint32_t)_mm_movemask_pd((__m128d)m);
#else
    uint32_t bits = 0;
    for (int k = 0; k < F64_LANES; k++) bits |= (uint32_t)(SIMD_LANE(m, k) & 1) << k;
    return bits;
#endif
}

INLINE bool i64_any(i64v m) {
    int64_t any = 0;
    for (int k = 0; k < F64_LANES; k++) any |= SIMD_LANE(m, k);
    return any != 0;
}

#if SIMD_WIDTH == 1
INLINE f64v f64_pick(i64v m, f64v a, f64v b) { return m ? a : b; }
INLINE f64v f64_where(i64v m, f64v a) { return m ? a : 0; }
INLINE f64v f64_abs(f64v a) { return fabs(a); }
INLINE f64v f64_sqrt(f64v a) { return sqrt(a); }
INLINE i64v i64_count(void) { return 0; }
INLINE i64v f64_bits(f64v a) {
    i64v bits;
    memcpy(&bits, &a, sizeof bits);
    return bits;
}
INLINE f64v f64_of_bits(i64v bits) {
    f64v a;
    memcpy(&a, &bits, sizeof a);
    return a;
}
#else
INLINE f64v f64_pick(i64v m, f64v a, f64v b) { return (f64v)((m & (i64v)a) | (~m & (i64v)b)); }
INLINE f64v f64_where(i64v m, f64v a) { return (f64v)(m & (i64v)a); }
INLINE f64v f64_abs(f64v a) { return (f64v)((i64v)a & INT64_MAX); }
INLINE i64v f64_bits(f64v a) { return (i64v)a; }
INLINE f64v f64_of_bits(i64v bits) { return (f64v)bits; }
#if SIMD_WIDTH == 8
INLINE f64v f64_sqrt(f64v a) { return (f64v)_mm256_sqrt_pd((__m256d)a); }
INLINE i64v i64_count(void) { return (i64v){0, 1, 2, 3}; }
#else
INLINE i64v i64_count(void) { return (i64v){0, 1}; }
#ifdef SIMD_X86
INLINE f64v f64_sqrt(f64v a) { return (f64v)_mm_sqrt_pd((__m128d)a); }
#else
INLINE f64v f64_sqrt(f64v a) { return (f64v){sqrt(a[0]), sqrt(a[1])}; }
#endif
#endif
#endif

INLINE f64v f64_min(f64v a, f64v b) { return f64_pick(f64_less(a, b), a, b); }
INLINE f64v f64_positive(f64v a) { return f64_where(f64_is_positive(a), a); }

/* Rounds to float. */
INLINE void f64_store_f32(float *p, f64v x) {
#if SIMD_WIDTH == 8
    _mm_storeu_ps(p, _mm256_cvtpd_ps((__m256d)x));
#elif defined(SIMD_X86)
    _mm_storel_pi((__m64 *)(void *)p, _mm_cvtpd_ps((__m128d)x));
#else
    for (int k = 0; k < F64_LANES; k++) p[k] = (float)SIMD_LANE(x, k);
#endif
}

/* Rows become columns: place k of out[i] is row[k][i], i = 0 .. 3. */
INLINE void f64_columns(const float *const row[F64_LANES], f64v out[4]) {
#if SIMD_WIDTH == 8
    __m128 a = _mm_loadu_ps(row[0]), b = _mm_loadu_ps(row[1]), c = _mm_loadu_ps(row[2]), d = _mm_loadu_ps(row[3]);
    __m128 ab = _mm_unpacklo_ps(a, b), cd = _mm_unpacklo_ps(c, d);
    out[0] = (f64v)_mm256_cvtps_pd(_mm_movelh_ps(ab, cd));
    out[1] = (f64v)_mm256_cvtps_pd(_mm_movehl_ps(cd, ab));
    ab = _mm_unpackhi_ps(a, b), cd = _mm_unpackhi_ps(c, d);
    out[2] = (f64v)_mm256_cvtps_pd(_mm_movelh_ps(ab, cd));
    out[3] = (f64v)_mm256_cvtps_pd(_mm_movehl_ps(cd, ab));
#elif defined(SIMD_X86)
    __m128 a = _mm_loadu_ps(row[0]), b = _mm_loadu_ps(row[1]);
    __m128 low = _mm_unpacklo_ps(a, b), high = _mm_unpackhi_ps(a, b);
    out[0] = (f64v)_mm_cvtps_pd(low), out[1] = (f64v)_mm_cvtps_pd(_mm_movehl_ps(low, low));
    out[2] = (f64v)_mm_cvtps_pd(high), out[3] = (f64v)_mm_cvtps_pd(_mm_movehl_ps(high, high));
#elif SIMD_WIDTH == 4
    for (int i = 0; i < 4; i++) out[i] = (f64v){(double)row[0][i], (double)row[1][i]};
#else
    for (int i = 0; i < 4; i++) out[i] = (double)row[0][i];
#endif
}

/* ------------------------------------------------------------------------------------------------ places */

/* Places and directions in space, side by side. */
struct f32v3 {
    f32v x, y, z;
};
struct f64v3 {
    f64v x, y, z;
};

INLINE struct f32v3 f32v3_sub(struct f32v3 a, struct f32v3 b) {
    return (struct f32v3){a.x - b.x, a.y - b.y, a.z - b.z};
}
INLINE struct f32v3 f32v3_scale(struct f32v3 a, f32v s) { return (struct f32v3){a.x * s, a.y * s, a.z * s}; }
INLINE f32v f32v3_dot(struct f32v3 a, struct f32v3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
INLINE struct f32v3 f32v3_cross(struct f32v3 a, struct f32v3 b) {
    return (struct f32v3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

INLINE struct f64v3 f64v3_sub(struct f64v3 a, struct f64v3 b) {
    return (struct f64v3){a.x - b.x, a.y - b.y, a.z - b.z};
}
INLINE struct f64v3 f64v3_scale(struct f64v3 a, f64v s) { return (struct f64v3){a.x * s, a.y * s, a.z * s}; }
INLINE f64v f64v3_dot(struct f64v3 a, struct f64v3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
INLINE struct f64v3 f64v3_cross(struct f64v3 a, struct f64v3 b) {
    return (struct f64v3){a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}

INLINE struct f64v3 f64v3_gather(const vec3 *const p[F64_LANES]) {
#if SIMD_WIDTH == 8
    return (struct f64v3){{p[0]->x, p[1]->x, p[2]->x, p[3]->x},
                          {p[0]->y, p[1]->y, p[2]->y, p[3]->y},
                          {p[0]->z, p[1]->z, p[2]->z, p[3]->z}};
#elif SIMD_WIDTH == 4
    return (struct f64v3){{p[0]->x, p[1]->x}, {p[0]->y, p[1]->y}, {p[0]->z, p[1]->z}};
#else
    return (struct f64v3){p[0]->x, p[0]->y, p[0]->z};
#endif
}

/* ------------------------------------------------------------------------------------------------ four together */

/* Four numbers that belong together on every processor, as the boxes of a node (spatial/bvh.c): a type of the
 * compilers', who make of it what there is. */
typedef float f32x4 __attribute__((vector_size(16)));
typedef int32_t i32x4 __attribute__((vector_size(16)));
typedef uint32_t u32x4 __attribute__((vector_size(16)));

INLINE f32x4 f32x4_pick(i32x4 m, f32x4 a, f32x4 b) { return (f32x4)((m & (i32x4)a) | (~m & (i32x4)b)); }
INLINE f32x4 f32x4_positive(f32x4 a) { return (f32x4)((i32x4)a & (a > 0)); }

/* ------------------------------------------------------------------------------------------------ ids */

/* Looks for an id in short lists, all of whose entries are read, so that there is no branch to guess wrong.  Room says
 * how many entries may be read, and is a constant where it is inlined. */

#if SIMD_WIDTH == 1
/* Bit i where id[i] == x, i < room <= 32, a multiple of four. */
INLINE uint32_t ids_equal(const uint32_t *id, unsigned room, uint32_t x) {
    uint32_t bits = 0;
    for (unsigned i = 0; i < room; i++) bits |= (uint32_t)(id[i] == x) << i;
    return bits;
}

/* The same of every second one: bit i where id[2 i] == x, i < room <= 32, a multiple of two. */
INLINE uint32_t ids_equal_2(const uint32_t *id, unsigned room, uint32_t x) {
    uint32_t bits = 0;
    for (unsigned i = 0; i < room; i++) bits |= (uint32_t)(id[2 * (size_t)i] == x) << i;
    return bits;
}

/* Whether x is among id[0 .. count), count <= room. */
INLINE bool ids_list(const uint32_t *id, unsigned room, unsigned count, uint32_t x) {
    unsigned any = 0;
    for (unsigned i = 0; i < room; i++) any |= (id[i] == x) & (i < count);
    return any;
}
#else
INLINE u32x4 ids_load(const uint32_t *id) {
    u32x4 x;
    memcpy(&x, id, sizeof x);
    return x;
}

INLINE uint32_t ids_either(u32x4 x) {
    uint64_t half[2];
    memcpy(half, &x, sizeof half);
    half[0] |= half[1];
    return (uint32_t)(half[0] | half[0] >> 32);
}

INLINE uint32_t ids_equal(const uint32_t *id, unsigned room, uint32_t x) {
    u32x4 found = {0};
    for (unsigned i = 0; i < room; i += 4) found |= (u32x4)(ids_load(&id[i]) == x) & ((u32x4){1, 2, 4, 8} << i);
    return ids_either(found);
}

INLINE uint32_t ids_equal_2(const uint32_t *id, unsigned room, uint32_t x) {
    u32x4 found = {0};
    for (unsigned i = 0; i < room; i += 2)
        found |= (u32x4)(ids_load(&id[2 * (size_t)i]) == x) & ((u32x4){1, 0, 2, 0} << i);
    return ids_either(found);
}

/* Four at a time, the last four where they aren't a multiple of it, each one alone where there are fewer. */
INLINE bool ids_list(const uint32_t *id, unsigned room, unsigned count, uint32_t x) {
    unsigned any = 0;
    u32x4 equal = {0};
    if (room < 4) {
        for (unsigned i = 0; i < room; i++) any |= (id[i] == x) & (i < count);
        return any;
    }
    for (unsigned i = 0;;) {
        i32x4 place = (i32x4){0, 1, 2, 3} + (int32_t)i;
        equal |= (u32x4)(ids_load(&id[i]) == x) & (u32x4)(place < (int32_t)count);
        if (i + 4 >= room) break;
        i = i + 8 <= room ? i + 4 : room - 4;
    }
    return ids_either(equal) != 0;
}
#endif

#endif
