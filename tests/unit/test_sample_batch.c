/* What is computed over lists of samples, eight at a time, against the same one at a time.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/cloud/cloud.h"
#include "core/refine/kernels/sample_batch.h"
#include "tests/unit/shapes.h"

/* A batch of n samples, by way of a list. */
static void gather(struct sample_batch *batch, vec3 origin, const struct sample *sample, uint32_t n) {
    struct sample_buckets lists;
    uint32_t spare = NONE;
    assert_int_equal(sample_buckets_init(&lists, 1, n, 1), STATUS_OK);
    for (uint32_t i = 0; i < n; i++) sample_buckets_add(&lists, 0, i, &sample[i], &spare);
    sample_batch_clear(batch, origin);
    assert_int_equal(sample_batch_add(batch, lists.block, lists.first[0]), NONE);
    assert_int_equal(batch->n, n);
    sample_buckets_done(&lists);
}

static void random_samples(uint64_t *seed, double from, double extent, struct sample *sample, size_t n) {
    for (size_t i = 0; i < n; i++) {
        vec3 place = {from + extent * random_unit(seed), from + extent * random_unit(seed),
                      from + extent * random_unit(seed)};
        sample[i] = (struct sample){.place = place, .weight = 0.5f + (float)random_unit(seed)};
    }
}

static struct surface surface_of(struct triangle_frames *frames, const vec3 (*corner)[3], size_t n) {
    struct triangle_corners corners[FRAMES_MOST];
    for (size_t i = 0; i < n; i++) corners[i] = (struct triangle_corners){&corner[i][0], &corner[i][1], &corner[i][2]};
    return triangle_frames_make(frames, corners, n);
}

/* The kernels against the distance to one triangle after the other, in double. */
static void check_cluster(const struct sample *sample, uint32_t n, const vec3 (*corner)[3], size_t triangles) {
    static struct sample_batch batch;
    struct triangle_frame frame[FRAMES_MOST];
    struct triangle_frames frames;
    struct surface surface = surface_of(&frames, corner, triangles);
    for (size_t j = 0; j < triangles; j++) frame[j] = triangle_frame_of(corner[j][0], corner[j][1], corner[j][2]);
    uint8_t owner[SAMPLE_BATCH_ROOM];
    float distance_sq[SAMPLE_BATCH_ROOM];
    double cost = 0;
    gather(&batch, (vec3){0.3, 0.4, 0.5}, sample, n);
    sample_batch_owners(&batch, &surface, owner, distance_sq);
    for (size_t i = 0; i < n; i++) {
        const struct sample *this = &sample[batch.sample[i]];
        double nearest_sq = INFINITY;
        for (size_t j = 0; j < triangles; j++)
            nearest_sq = fmin(nearest_sq, triangle_frame_hit(&frame[j], this->place).distance_sq);
        double tolerance = 1e-5 * (1 + nearest_sq);
        assert_true(fabs((double)distance_sq[i] - nearest_sq) < tolerance);
        assert_true(triangle_frame_hit(&frame[owner[i]], this->place).distance_sq < nearest_sq + tolerance);
        cost += (double)this->weight * (sqrt(nearest_sq) + 2 * nearest_sq);
    }
    assert_true(fabs(sample_batch_cost(&batch, &surface, 2, INFINITY) - cost) < 1e-4 * cost);
    double part = sample_batch_cost(&batch, &surface, 2, cost / 2);
    assert_true(part > cost / 2 && part <= 1.0001 * cost);
}

static void test_eight_at_a_time_is_one_at_a_time(void **state) {
    (void)state;
    uint64_t seed = 7;
    static struct sample sample[461];
    for (uint32_t n = 1; n <= 461; n += 23) {
        vec3 corner[6][3];
        for (int i = 0; i < 18; i++)
            corner[i / 3][i % 3] = (vec3){random_unit(&seed), random_unit(&seed), random_unit(&seed)};
        random_samples(&seed, -0.5, 2, sample, n);
        check_cluster(sample, n, (const vec3(*)[3])corner, 3);
        check_cluster(sample, n, (const vec3(*)[3])corner, 6);
    }
}

/* Points, segments and slivers for triangles; samples on their corners and edges, and far away. */
static void test_distances_to_degenerate_triangles(void **state) {
    (void)state;
    static const vec3 corner[][3] = {
        {{0.1, 0.2, 0.3}, {0.1, 0.2, 0.3}, {0.1, 0.2, 0.3}}, /* a point */
        {{0, 0, 0}, {0, 0, 0}, {1, 0, 0}},                   /* segments, whichever edge has no length */
        {{0, 0, 0}, {1, 0, 0}, {1, 0, 0}},
        {{0, 0, 0}, {0, 1, 0}, {0, 0, 0}},
        {{0, 0, 0}, {1, 0, 0}, {0.5, 0, 0}}, /* corners in line, in either order */
        {{0, 0, 0}, {0.5, 0, 0}, {1, 0, 0}},
        {{0, 0, 0}, {1, 0, 0}, {0.5, 1e-7, 0}}, /* a sliver */
    };
    uint64_t seed = 5;
    static struct sample sample[64];
    random_samples(&seed, -1, 3, sample, 64);
    for (int k = 0; k < 3; k++) sample[k].place = corner[4][k];
    sample[3].place = (vec3){2, 0, 0}, sample[4].place = (vec3){-1, 0, 0}, sample[5].place = (vec3){0.25, 0, 0};
    sample[6].place = (vec3){1e5, 1e5, -1e5};
    for (size_t i = 0; i < sizeof corner / sizeof *corner; i++) {
        struct triangle_frame frame = triangle_frame_of(corner[i][0], corner[i][1], corner[i][2]);
        check_cluster(sample, 64, &corner[i], 1);
        if (i > 0) assert_true(triangle_frame_hit(&frame, (vec3){2, 0, 0}).distance_sq > 0.99);
    }
}

/* Frames made four at a time are those made one at a time, bit for bit, whatever is beside them. */
static void test_four_frames_are_each_one_frame(void **state) {
    (void)state;
    uint64_t seed = 13;
    for (size_t n = 1; n <= FRAMES_MOST; n++) {
        vec3 corner[FRAMES_MOST][3];
        struct triangle_frames frames;
        for (size_t i = 0; i < 3 * n; i++)
            corner[i / 3][i % 3] = (vec3){random_unit(&seed), random_unit(&seed), random_unit(&seed)};
        corner[n / 2][2] = corner[n / 2][n % 2]; /* without area */
        struct surface surface = surface_of(&frames, (const vec3(*)[3])corner, n);
        for (size_t i = 0; i < n; i++) {
            struct triangle_frame frame = triangle_frame_of(corner[i][0], corner[i][1], corner[i][2]);
            const struct frames_four *four = &surface.four[i / FRAMES_WIDTH];
            size_t k = i % FRAMES_WIDTH;
            assert_true(vec3_equal(surface_normal(&surface, i), frame.n));
            assert_true(vec3_equal((vec3){four->ux[k], four->uy[k], four->uz[k]}, frame.u));
            assert_true(vec3_equal((vec3){four->vx[k], four->vy[k], four->vz[k]}, frame.v));
            assert_true(vec3_equal((vec3){four->ax[k], four->ay[k], four->az[k]}, frame.a));
            assert_true(four->bx[k] == frame.bx && four->cx[k] == frame.cx && four->cy[k] == frame.cy);
            assert_true(four->bc_length[k] == frame.bc.length && four->ac_length[k] == frame.ac.length);
            assert_true(four->bc_x[k] == frame.bc.x && four->ac_y[k] == frame.ac.y);
            assert_true(surface_shape(&surface, i) == triangle_frame_shape(&frame));
            assert_true(vec3_equal(surface_middle(&surface, i), triangle_frame_middle(&frame)));
        }
    }
}

/* The seven regions around a triangle. */
static void test_where_on_a_triangle_is_nearest(void **state) {
    (void)state;
    struct triangle_frame frame = triangle_frame_of((vec3){0, 0, 0}, (vec3){4, 0, 0}, (vec3){1, 3, 0});
    static const struct {
        vec3 place;
        enum triangle_feature feature;
        uint8_t corner;
        double distance_sq;
    } expect[] = {
        {{1.5, 1, 2}, TRIANGLE_INSIDE, 0, 4}, {{2, -3, 1}, TRIANGLE_EDGE, 0, 10},   {{4, 3, 0}, TRIANGLE_EDGE, 1, 4.5},
        {{-1, 2, 0}, TRIANGLE_EDGE, 2, 2.5},  {{-1, -1, 0}, TRIANGLE_CORNER, 0, 2}, {{6, 0, 0}, TRIANGLE_CORNER, 1, 4},
        {{1, 5, 1}, TRIANGLE_CORNER, 2, 5},
    };
    for (size_t i = 0; i < sizeof expect / sizeof *expect; i++) {
        struct triangle_hit hit = triangle_frame_hit(&frame, expect[i].place);
        assert_int_equal(hit.feature, expect[i].feature);
        assert_int_equal(hit.corner, expect[i].corner);
        assert_true(fabs(hit.distance_sq - expect[i].distance_sq) < 1e-12);
    }
}

/* The nearest of the samples, and values of a quadric, against one sample after the other. */
static void test_nearest_and_values(void **state) {
    (void)state;
    uint64_t seed = 3;
    static struct sample sample[77];
    static struct sample_batch batch;
    float value[SAMPLE_BATCH_ROOM];
    const sym3 a = {2, 0.3, -0.4, 1, 0.2, 3};
    const vec3 place = {0.4, 0.1, 0.7};
    random_samples(&seed, 0, 1, sample, 77);
    gather(&batch, (vec3){0.5, 0.5, 0.5}, sample, 77);
    enum { POINTS = 50 }; /* of the samples; the others have no value */
    sample_batch_values(&batch, &a, place, POINTS, value);
    double nearest_sq = INFINITY, least_sq = INFINITY, weight = 0;
    uint32_t nearest = NONE;
    sample_batch_nearest(&batch, place, &nearest_sq, &nearest);
    for (size_t i = 0; i < 77; i++) {
        vec3 s = vec3_sub(sample[batch.sample[i]].place, place);
        least_sq = fmin(least_sq, vec3_length_sq(s));
        weight += (double)sample[i].weight;
        double expected = batch.sample[i] < POINTS ? vec3_dot(s, sym3_mul(a, s)) : INFINITY;
        assert_true(expected == (double)value[i] || fabs(expected - (double)value[i]) < 1e-5);
    }
    assert_true(fabs(nearest_sq - least_sq) < 1e-5);
    assert_true(fabs(vec3_distance_sq(sample[nearest].place, place) - least_sq) < 1e-5);
    assert_true(fabs(sample_batch_weight(&batch) - weight) < 1e-4);
}

/* A star of five triangles around a vertex near (0.5, 0.5, 0.5), and the same triangles one by one. */
enum { SPOKES = 5 };

static void random_rim(uint64_t *seed, vec3 rim[SPOKES]) {
    for (int i = 0; i < SPOKES; i++) {
        double angle = 2 * M_PI * (i + 0.6 * random_unit(seed)) / SPOKES, length = 0.3 + 0.5 * random_unit(seed);
        rim[i] = (vec3){0.5 + length * cos(angle), 0.5 + length * sin(angle), 0.3 + 0.4 * random_unit(seed)};
    }
}

static struct star_frames star_of(const vec3 rim[SPOKES], vec3 place, vec3 origin) {
    struct star_rim flat = {.n = SPOKES};
    struct star_frames star;
    const vec3 *corner[SPOKES];
    for (int i = 0; i < SPOKES; i++) corner[i] = &rim[i];
    star_vectors_set(&flat.place, corner, SPOKES, origin);
    star_frames_make(&star, &flat, vec3_sub(place, origin));
    return star;
}

static void test_star_costs_what_its_triangles_do(void **state) {
    (void)state;
    uint64_t seed = 13;
    static struct sample sample[83];
    static struct sample_batch batch;
    const vec3 origin = {0.4, 0.6, 0.5};
    for (uint32_t n = 1; n <= 83; n += 9) {
        vec3 rim[SPOKES], place = {0.45 + 0.1 * random_unit(&seed), 0.5, 0.45 + 0.1 * random_unit(&seed)};
        vec3 corner[SPOKES][3];
        struct triangle_frames frames;
        random_rim(&seed, rim);
        random_samples(&seed, 0, 1, sample, n);
        gather(&batch, origin, sample, n);
        for (int i = 0; i < SPOKES; i++)
            corner[i][0] = place, corner[i][1] = rim[i], corner[i][2] = rim[(i + 1) % SPOKES];
        struct surface surface = surface_of(&frames, (const vec3(*)[3])corner, SPOKES);
        struct star_frames star = star_of(rim, place, origin);
        double cost = sample_batch_cost(&batch, &surface, 2, INFINITY);
        assert_true(fabs(sample_batch_star_cost(&batch, &star, 2, INFINITY) - cost) < 1e-5 * cost);
        float distance_sq[SAMPLE_BATCH_ROOM];
        double sum = 0;
        sample_batch_star_distances(&batch, &star, distance_sq);
        for (uint32_t i = 0; i < n; i++)
            sum += (double)batch.weight[i] * (sqrt((double)distance_sq[i]) + 2 * (double)distance_sq[i]);
        assert_true(fabs(sum - cost) < 1e-5 * cost);
        double part = sample_batch_star_cost(&batch, &star, 2, cost / 2);
        assert_true(part > cost / 2 && part <= 1.0001 * cost);
        for (size_t i = 0; i < SPOKES; i++) {
            assert_true(fabs((double)star.shape[i] - surface_shape(&surface, i)) < 1e-5);
            vec3 normal = {(double)star.normal.x[i], (double)star.normal.y[i], (double)star.normal.z[i]};
            assert_true(vec3_distance(normal, surface_normal(&surface, i)) < 1e-5);
        }
    }
}

/* The quadric's linear part is how the cost changes when the vertex moves: against differences, for samples that are
 * nearest to the triangle that they are said to belong to. */
static void test_model_is_the_slope_of_the_cost(void **state) {
    (void)state;
    uint64_t seed = 11;
    static struct sample sample[29];
    static struct sample_batch batch;
    const vec3 a = {0.5, 0.5, 0.5};
    vec3 rim[SPOKES];
    random_rim(&seed, rim);
    for (uint32_t i = 0; i < 29; i++) {
        vec3 over = vec3_add(vec3_scale(a, 0.5), vec3_scale(vec3_add(rim[0], rim[1]), 0.25));
        double side = 0.1 * (random_unit(&seed) - 0.5), along = 0.1 * (random_unit(&seed) - 0.5);
        vec3 place = vec3_add(over, (vec3){side, along, i % 2 ? 0.02 : -0.02});
        sample[i] = (struct sample){.place = place, .weight = 1};
    }
    gather(&batch, a, sample, 29);
    struct star_frames star = star_of(rim, a, a);
    struct sample_batch_model model = {0};
    sample_batch_fit(&batch, (size_t[SPOKES + 1]){0, 29, 29, 29, 29, 29}, &star, 1e-6f, 0, &model);
    vec3 step[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    for (int k = 0; k < 3; k++) {
        double h = 2e-3;
        star = star_of(rim, vec3_add(a, vec3_scale(step[k], h)), a);
        double rise = sample_batch_star_cost(&batch, &star, 0, INFINITY);
        star = star_of(rim, vec3_sub(a, vec3_scale(step[k], h)), a);
        double slope = (rise - sample_batch_star_cost(&batch, &star, 0, INFINITY)) / (2 * h);
        assert_true(fabs(slope + vec3_dot(model.g, step[k])) < 0.02);
    }
}

/* What a star may become, one reason at a time. */
static void test_star_may_become(void **state) {
    (void)state;
    const vec3 rim[SPOKES] = {{1, 0, 0}, {0.3, 1, 0}, {-0.8, 0.6, 0}, {-0.8, -0.6, 0}, {0.3, -1, 0}};
    const vec3 origin = {0}, up = {0, 0, 1}, down = {0, 0, -1};
    const struct star_limits limits = {.turn = 0.5f, .thin = 0.02f};
    const struct {
        vec3 from, to, outside;
        bool may;
    } expect[] = {
        {origin, {0.1, 0.1, 0.1}, up, true},
        {origin, {0, 0, 2}, up, false},                   /* turns too far */
        {origin, {1.5, 0, 0}, up, false},                 /* turns over */
        {origin, {0.64, 0.4853, 0}, up, false},           /* gets too thin */
        {{0.64, 0.4853, 0}, {0.638, 0.485, 0}, up, true}, /* was thinner */
        {{0.1, 0.1, 0.3}, origin, down, false},           /* folds further onto its neighbours */
        {origin, {0.1, 0.1, 0.3}, down, true},            /* was folded further */
        {{0.1, 0.1, 0.3}, origin, origin, true},          /* no neighbours */
    };
    for (size_t i = 0; i < sizeof expect / sizeof *expect; i++) {
        const vec3 *normal[SPOKES];
        struct star_vectors outside;
        for (int k = 0; k < SPOKES; k++) normal[k] = &expect[i].outside;
        star_vectors_set(&outside, normal, SPOKES, origin);
        struct star_frames old = star_of(rim, expect[i].from, origin), new = star_of(rim, expect[i].to, origin);
        assert_int_equal(star_may_become(&old, &new, &outside, limits), expect[i].may);
    }
}

/* Lists that are emptied and filled in turns never need more blocks than there are, and lose nothing. */
static void test_lists_are_filled_again(void **state) {
    (void)state;
    enum { LISTS = 5, SAMPLES = 203 };
    static struct sample sample[SAMPLES];
    uint64_t seed = 9;
    struct sample_buckets lists;
    uint32_t spare = NONE;
    random_samples(&seed, 0, 1, sample, SAMPLES);
    assert_int_equal(sample_buckets_init(&lists, LISTS, SAMPLES, 1), STATUS_OK);
    for (uint32_t i = 0; i < SAMPLES; i++) sample_buckets_add(&lists, i % LISTS, i, &sample[i], &spare);
    for (int round = 0; round < 100; round++) {
        uint32_t from = (uint32_t)(random_unit(&seed) * LISTS), to = (uint32_t)(random_unit(&seed) * LISTS);
        uint32_t id[SAMPLES], count = 0;
        spare = sample_buckets_take(&lists, from);
        assert_int_equal(lists.first[from], NONE);
        for (uint32_t b = spare; b != NONE; b = lists.block[b].next)
            for (uint32_t i = 0; i < lists.block[b].count; i++) id[count++] = lists.block[b].sample[i];
        for (uint32_t i = 0; i < count; i++)
            sample_buckets_add(&lists, i % 2 ? to : from, id[i], &sample[id[i]], &spare);
        sample_buckets_give(&lists, spare);
        assert_true(lists.fresh <= SAMPLES / SAMPLE_BLOCK + LISTS);
    }
    bool seen[SAMPLES] = {false};
    for (size_t k = 0; k < LISTS; k++)
        for (uint32_t b = lists.first[k]; b != NONE; b = lists.block[b].next)
            for (uint32_t i = 0; i < lists.block[b].count; i++) seen[lists.block[b].sample[i]] = true;
    for (size_t i = 0; i < SAMPLES; i++) assert_true(seen[i]);
    sample_buckets_done(&lists);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_eight_at_a_time_is_one_at_a_time),
        cmocka_unit_test(test_distances_to_degenerate_triangles),
        cmocka_unit_test(test_four_frames_are_each_one_frame),
        cmocka_unit_test(test_where_on_a_triangle_is_nearest),
        cmocka_unit_test(test_nearest_and_values),
        cmocka_unit_test(test_lists_are_filled_again),
        cmocka_unit_test(test_star_costs_what_its_triangles_do),
        cmocka_unit_test(test_model_is_the_slope_of_the_cost),
        cmocka_unit_test(test_star_may_become),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
