/* Where samples lie.
 *
 * Counts are spread by error diffusion: an element gets the whole part of the weight so far, less what the elements
 * before it have had.  So any run of neighbouring elements has its share to within one sample, however small the
 * elements are.  Which elements get one is shifted by the seed.
 *
 * Within a triangle, uniform samples follow the additive sequence of the plastic number (R2; Roberts 2018) from a start
 * that depends on seed and triangle.  It is computed in 64-bit fixed point, so sample j needs no sample before it.  The
 * unit square becomes the triangle by folding its upper half down.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/measure/sampler.h"

#include <assert.h>
#include <stdbool.h>
#include <stdlib.h>

#include "core/base/alloc.h"
#include "core/base/hash64.h"
#include "core/cloud/cloud.h"

/* 1 / g and 1 / g^2 as fractions of 2^64, g the real root of x^3 = x + 1. */
#define STEP_U 0xC13FA9A902A6328Fu
#define STEP_V 0x91E10DA5C79E7B1Du

/* ------------------------------------------------------------------------------------------------- places */

static uint64_t random_bits(uint64_t seed, uint64_t index) {
    return hash64(hash64(seed + 0x9E3779B97F4A7C15u) + index * 0x9E3779B97F4A7C15u);
}

/* [0, 1) */
static double fraction(uint64_t bits) { return (double)(bits >> 11) * 0x1p-53; }

static vec3 in_triangle(const struct sampler *s, size_t t, double u, double v) {
    vec3 a = s->position[s->triangle[t][0]];
    vec3 ab = vec3_sub(s->position[s->triangle[t][1]], a), ac = vec3_sub(s->position[s->triangle[t][2]], a);
    return vec3_add(a, vec3_add(vec3_scale(ab, u), vec3_scale(ac, v)));
}

static vec3 place_point(const struct sampler *s, size_t i, size_t j, size_t of) {
    (void)j, (void)of;
    return s->position[s->vertex ? s->vertex[i] : i];
}

static vec3 place_uniform(const struct sampler *s, size_t t, size_t j, size_t of) {
    (void)of;
    uint64_t start = random_bits(s->seed, t);
    double u = fraction(start + j * STEP_U), v = fraction(hash64(start) + j * STEP_V);
    return u + v > 1 ? in_triangle(s, t, 1 - u, 1 - v) : in_triangle(s, t, u, v);
}

static vec3 place_edge(const struct sampler *s, size_t e, size_t j, size_t of) {
    return vec3_lerp(s->position[s->edge[e][0]], s->position[s->edge[e][1]], (double)(j + 1) / (double)(of + 1));
}

/* The longest of `of` rows together: of = rows (rows + 1) / 2. */
static size_t rows_of(size_t of) { return (size_t)((sqrt(8 * (double)of + 1) - 1) / 2); }

/* Row i = 1, 2 ... has rows + 1 - i samples. */
static vec3 place_face(const struct sampler *s, size_t t, size_t j, size_t of) {
    size_t rows = rows_of(of), i = 1;
    for (size_t length = rows; j >= length; length--, i++) j -= length;
    double parts = (double)(rows + 2);
    return in_triangle(s, t, (double)i / parts, (double)(j + 1) / parts);
}

static vec3 (*const place[])(const struct sampler *s, size_t element, size_t j, size_t of) = {
    [SAMPLER_POINTS] = place_point,
    [SAMPLER_UNIFORM] = place_uniform,
    [SAMPLER_EDGES] = place_edge,
    [SAMPLER_FACES] = place_face,
};

size_t sampler_element(const struct sampler *s, size_t i) {
    if (!s->first) return i;
    size_t low = 0, high = s->element_count;
    while (high - low > 1) {
        size_t middle = low + (high - low) / 2;
        if (s->first[middle] <= i)
            low = middle;
        else
            high = middle;
    }
    return low;
}

void sampler_fill(const struct sampler *s, size_t begin, size_t end, vec3 *out) {
    assert(begin <= end && end <= s->count);
    if (begin == end) return;
    size_t element = sampler_element(s, begin);
    for (size_t i = begin; i < end; i++) {
        while (s->first && s->first[element + 1] <= i) element++;
        size_t first = s->first ? s->first[element] : element, last = s->first ? s->first[element + 1] : element + 1;
        *out++ = place[s->kind](s, element, i - first, last - first);
        if (!s->first) element++;
    }
}

/* ------------------------------------------------------------------------------------------------- counts */

struct sampler sampler_points(const vec3 *point, size_t n) {
    return (struct sampler){.kind = SAMPLER_POINTS, .count = n, .element_count = n, .position = point};
}

static double triangle_area(const struct mesh *mesh, size_t t) {
    return vec3_length(mesh_triangle_normal(mesh, t)) / 2;
}

static double mesh_area(const struct mesh *mesh) {
    double area = 0;
    for (size_t t = 0; t < mesh->triangle_count; t++) area += triangle_area(mesh, t);
    return area;
}

enum status sampler_uniform(const struct mesh *mesh, size_t count, uint64_t seed, struct sampler *sampler) {
    size_t n = mesh->triangle_count;
    size_t *first = alloc_array(n + 1, sizeof *first);
    if (!first) return STATUS_NO_MEMORY;
    double area = mesh_area(mesh), sum = 0, shift = fraction(random_bits(seed, NONE));
    for (size_t t = 0; t < n; t++) {
        first[t] = (size_t)(sum * (double)count + shift);
        sum += area > 0 ? triangle_area(mesh, t) / area : 1 / (double)n;
        if (first[t] > count) first[t] = count;
    }
    first[0] = 0;
    first[n] = n ? count : 0;
    *sampler = (struct sampler){.kind = SAMPLER_UNIFORM,
                                .count = first[n],
                                .element_count = n,
                                .seed = seed,
                                .position = mesh->vertex,
                                .triangle = mesh->triangle,
                                .first = first};
    return STATUS_OK;
}

static int by_ends(const void *a, const void *b) {
    const uint32_t *x = a, *y = b;
    if (x[0] != y[0]) return x[0] < y[0] ? -1 : 1;
    return x[1] < y[1] ? -1 : x[1] > y[1];
}

/* All edges of the mesh, each once: those of all triangles, sorted, without repetition. */
static size_t list_edges(const struct mesh *mesh, uint32_t (*edge)[2]) {
    size_t n = 0, kept = 0;
    for (size_t t = 0; t < mesh->triangle_count; t++)
        for (int i = 0; i < 3; i++, n++) {
            uint32_t a = mesh->triangle[t][i], b = mesh->triangle[t][(i + 1) % 3];
            edge[n][0] = a < b ? a : b;
            edge[n][1] = a < b ? b : a;
        }
    if (n) qsort(edge, n, sizeof *edge, by_ends);
    for (size_t i = 0; i < n; i++) {
        if (i > 0 && by_ends(edge[i], edge[i - 1]) == 0) continue;
        edge[kept][0] = edge[i][0];
        edge[kept++][1] = edge[i][1];
    }
    return kept;
}

static enum status every_vertex(const struct mesh *mesh, struct sampler *s) {
    *s = sampler_points(mesh->vertex, 0);
    bool *used = alloc_zeroed(mesh->vertex_count, sizeof *used);
    s->vertex = alloc_array(mesh->vertex_count, sizeof *s->vertex);
    if (used && s->vertex) {
        for (size_t t = 0; t < mesh->triangle_count; t++)
            for (int i = 0; i < 3; i++) used[mesh->triangle[t][i]] = true;
        for (size_t v = 0; v < mesh->vertex_count; v++)
            if (used[v]) s->vertex[s->count++] = (uint32_t)v;
        s->element_count = s->count;
    }
    enum status status = used && s->vertex ? STATUS_OK : STATUS_NO_MEMORY;
    free(used);
    return status;
}

/* per_length samples on each unit of length, spread by error diffusion. */
static enum status along_edges(const struct mesh *mesh, double per_length, struct sampler *s) {
    *s = (struct sampler){.kind = SAMPLER_EDGES, .position = mesh->vertex};
    s->edge = alloc_array(3 * mesh->triangle_count, sizeof *s->edge);
    if (!s->edge) return STATUS_NO_MEMORY;
    s->element_count = list_edges(mesh, s->edge);
    s->first = alloc_array(s->element_count + 1, sizeof *s->first);
    if (!s->first) return STATUS_NO_MEMORY;
    double due = 0;
    for (size_t e = 0; e < s->element_count; e++) {
        s->first[e] = s->count;
        due += vec3_distance(mesh->vertex[s->edge[e][0]], mesh->vertex[s->edge[e][1]]) * per_length;
        size_t n = (size_t)due;
        due -= (double)n;
        s->count += n;
    }
    s->first[s->element_count] = s->count;
    return STATUS_OK;
}

/* The most that full rows hold of n samples: Metro divides the edges of the triangle into k - 1 parts,
 * k = floor((sqrt(1 + 8n) + 5) / 2), and takes the points of that lattice that lie inside. */
static size_t full_rows(size_t n) {
    size_t k = (size_t)((sqrt(1 + 8 * (double)n) + 5) / 2);
    return (k - 2) * (k - 3) / 2;
}

static enum status inside_faces(const struct mesh *mesh, double per_area, struct sampler *s) {
    *s = (struct sampler){.kind = SAMPLER_FACES, .position = mesh->vertex, .triangle = mesh->triangle};
    s->element_count = mesh->triangle_count;
    s->first = alloc_array(s->element_count + 1, sizeof *s->first);
    if (!s->first) return STATUS_NO_MEMORY;
    double due = 0;
    for (size_t t = 0; t < s->element_count; t++) {
        s->first[t] = s->count;
        due += triangle_area(mesh, t) * per_area;
        size_t n = (size_t)due;
        due -= (double)n;
        s->count += full_rows(n);
    }
    s->first[s->element_count] = s->count;
    return STATUS_OK;
}

/* What is left of count after the samplers so far, for each unit of area. */
static double density(size_t count, size_t taken, double area) {
    return area > 0 && count > taken ? (double)(count - taken) / area : 0;
}

enum status sampler_metro(const struct mesh *mesh, size_t count, struct sampler sampler[3]) {
    struct sampler s[3] = {0};
    double area = mesh_area(mesh);
    enum status status = every_vertex(mesh, &s[0]);
    if (!status) status = along_edges(mesh, sqrt(density(count, s[0].count, area)), &s[1]);
    if (!status) status = inside_faces(mesh, density(count, s[0].count + s[1].count, area), &s[2]);
    for (int i = 0; i < 3; i++) {
        if (status)
            sampler_done(&s[i]);
        else
            sampler[i] = s[i];
    }
    return status;
}

void sampler_done(struct sampler *sampler) {
    if (!sampler) return;
    free(sampler->edge);
    free(sampler->vertex);
    free(sampler->first);
    *sampler = (struct sampler){0};
}
