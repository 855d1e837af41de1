/* Clouds in tiles: what each tile sees is what the whole cloud has, and no point is lost or there twice.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <dirent.h>
#include <fcntl.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/io/read.h"
#include "core/pipeline/pipeline.h"
#include "core/simplify/dso.h"
#include "core/simplify/normals.h"
#include "core/tiles/grid.h"
#include "core/tiles/left.h"
#include "core/tiles/part.h"
#include "core/tiles/scratch.h"
#include "core/tiles/tiles.h"
#include "core/tiles/told.h"
#include "tests/unit/folder.h"
#include "tests/unit/shapes.h"

enum { PATH_BYTES = 256, POINTS = 40000, TWICE = 500, TILE = 4500 };

static char base[PATH_BYTES - 64], input[PATH_BYTES], scratch_folder[PATH_BYTES];

/* A bumpy sheet, some points of it twice, as text: positions need all of a double. */
static void write_input(void) {
    uint64_t seed = 11;
    snprintf(input, sizeof input, "%s/sheet.txt", base);
    FILE *file = fopen(input, "w");
    assert_non_null(file);
    char last[128] = "";
    for (size_t i = 0; i < POINTS; i++) {
        double x = random_unit(&seed), y = random_unit(&seed);
        double z = 0.05 * sin(9 * x) * cos(7 * y) + 0.01 * sin(50 * x);
        if (i % (POINTS / TWICE) != 1) snprintf(last, sizeof last, "%.17g %.17g %.17g", 4000 + x, y, z);
        assert_true(fprintf(file, "%s\n", last) > 0);
    }
    assert_int_equal(fclose(file), 0);
}

static void links_come_back(void **state) {
    (void)state;
    static const uint32_t place[] = {0, 1, 63, 64, 8191, 8192, 1u << 20, 1u << 31, NONE - 1};
    unsigned char link[LEFT_LINK_BYTES];
    size_t places = sizeof place / sizeof *place;
    for (size_t i = 0; i < places; i++)
        for (size_t j = 0; j <= places; j++) {
            uint32_t to = j < places ? place[j] : NONE, found = 1, id = 1;
            if (i == j) continue;
            size_t n = left_put_link(place[i], to, 0x80ff00ff, link);
            assert_true(n > 0 && n <= LEFT_LINK_BYTES);
            assert_int_equal(left_get_link(place[i], link, n - 1, &found, &id), 0);
            assert_int_equal(left_get_link(place[i], link, n, &found, &id), n);
            assert_int_equal(found, to);
            if (to == NONE) assert_int_equal(id, 0x80ff00ff);
        }
    assert_int_equal(left_put_link(100, 163, 0, link), 1);
    assert_int_equal(left_put_link(100, 37, 0, link), 1);
}

/* Numbers to the bit, directions nearly. */
static void what_is_told_comes_back(void **state) {
    (void)state;
    static const uint32_t id[] = {0, 1, 128, 129, 16512, 5000000, UINT32_MAX - 2};
    enum { TOLD = sizeof id / sizeof *id, NORMALS = 5000 };
    struct told told;
    struct sink sink;
    uint64_t seed = 7;
    uint32_t back[TOLD];
    assert_int_equal(told_new(&told, TOLD, false), STATUS_OK);
    for (size_t i = 0; i < TOLD; i++) told.id[i] = id[i], told.key[i] = GONE_FIRST;
    assert_int_equal(sink_init_memory(&sink), STATUS_OK);
    told_put(&sink, &told);
    const unsigned char *gaps = sink.buffer + sizeof told.key[0] * TOLD;
    size_t bytes = told_gap_bytes(&told);
    assert_int_equal(sink.used, sizeof told.key[0] * TOLD + bytes);
    assert_int_equal(bytes, 1 + 1 + 1 + 1 + 2 + 4 + 5);
    assert_true(told_get_ids(gaps, bytes, back, TOLD));
    assert_memory_equal(back, id, sizeof id);
    assert_false(told_get_ids(gaps, bytes - 1, back, TOLD));
    assert_false(told_get_ids(gaps, bytes, back, TOLD - 1));
    assert_int_equal(sink_done(&sink, STATUS_OK, NULL), STATUS_OK);
    told_done(&told);
    for (int i = 0; i < NORMALS; i++) {
        vec3 n = {2 * random_unit(&seed) - 1, 2 * random_unit(&seed) - 1, 2 * random_unit(&seed) - 1};
        n = i < 6 ? (vec3){i / 2 == 0, i / 2 == 1, i / 2 == 2} : vec3_unit(n);
        if (i % 2) n = vec3_scale(n, -1);
        struct told_normal code = told_normal_of(n);
        vec3 found = told_normal_back(&code);
        assert_true(vec3_length_sq(vec3_sub(found, n)) < 3e-7 * 3e-7);
    }
}

/* By key, then by nothing that has to do with where points are in the input or its files. */
static void what_is_told_is_ranked(void **state) {
    (void)state;
    enum { TOLD = 3000, MOST = 1700 };
    struct told told[2];
    double sum = 0;
    for (int turn = 0; turn < 2; turn++) {
        assert_int_equal(told_new(&told[turn], TOLD, true), STATUS_OK);
        for (uint32_t i = 0; i < TOLD; i++) {
            uint32_t id = turn ? TOLD - 1 - i : i;
            told[turn].id[i] = id;
            told[turn].key[i] = GONE_FIRST + (id < TOLD / 2 ? 5 : 3) - (id % 1000 == 999);
            told[turn].normal[i] = told_normal_of((vec3){(double)id, TOLD, 0});
        }
        assert_int_equal(told_rank(&told[turn], MOST, 2), STATUS_OK);
        assert_int_equal(told[turn].count, MOST);
    }
    assert_memory_equal(told[0].id, told[1].id, MOST * sizeof *told[0].id);
    for (size_t i = 0; i < MOST; i++) {
        vec3 normal = told_normal_back(&told[0].normal[i]);
        assert_true(fabs(normal.x / normal.y * TOLD - told[0].id[i]) < 0.01);
        if (i > 0) assert_true(told[0].key[i] >= told[0].key[i - 1]);
        if (told[0].key[i] == GONE_FIRST + 5) sum += told[0].id[i];
    }
    sum /= MOST - TOLD / 2 - 1; /* of half of the points those with the first numbers would have 100 */
    assert_true(sum > 600 && sum < 900);
    told_done(&told[0]), told_done(&told[1]);
}

static struct params make_params(void) {
    struct params params;
    struct error error = {0};
    params_defaults(&params);
    params.ratio = 0.05;
    params.outputs = OUTPUT_CLOUD;
    params.memory_bytes = (uint64_t)1 << 30;
    assert_int_equal(params_resolve(&params, &error), STATUS_OK);
    return params;
}

static struct tiles_facts plan_input(const char *name, const struct params *params) {
    struct tiles_facts facts;
    struct error error = {0};
    const char *const inputs[] = {input};
    snprintf(scratch_folder, sizeof scratch_folder, "%s/%s", base, name);
    const struct tiles_job job = {inputs, 1, scratch_folder, params, TILE};
    if (tiles_plan(&job, NULL, &facts, &error)) fail_msg("%s: %s", error.where, error.text);
    return facts;
}

static struct cloud read_input(void) {
    struct cloud cloud = {0};
    struct error error = {0};
    assert_int_equal(cloud_read_path(input, NULL, NULL, &cloud, &error), STATUS_OK);
    return cloud;
}

static void every_point_is_in_one_tile(void **state) {
    (void)state;
    struct params params = make_params();
    struct tiles_facts facts = plan_input("one", &params);
    struct scratch s = {0};
    struct grid grid = {0};
    struct error error = {0};
    struct cloud cloud = read_input();
    uint8_t *seen = alloc_zeroed(POINTS, 1);
    size_t most = 0;
    assert_non_null(seen);
    assert_true(facts.tiles >= 8);
    assert_int_equal(facts.points, POINTS);
    assert_int_equal(scratch_load(scratch_folder, &s, &error), STATUS_OK);
    assert_int_equal(grid_from(&grid, s.head.anchor, s.head.level, s.cell, s.head.cells), STATUS_OK);
    for (size_t t = 0; t < facts.tiles; t++) {
        struct scratch_points points;
        size_t own = 0;
        assert_int_equal(scratch_gather(scratch_folder, &s, &grid, &s.tile[t], 0.05, POINTS, 2, &points, &error),
                         STATUS_OK);
        for (size_t i = 0; i < points.count; i++) {
            assert_memory_equal(&points.position[i], &cloud.position[points.id[i]], sizeof(vec3));
            own += points.own[i];
            if (points.own[i]) assert_int_equal(seen[points.id[i]]++, 0);
        }
        assert_int_equal(own, s.tile[t].points);
        assert_true(own <= TILE && points.count > own);
        if (own > most) most = own;
        scratch_points_done(&points);
    }
    for (size_t i = 0; i < POINTS; i++) assert_int_equal(seen[i], 1);
    assert_true(most > TILE / 2);
    free(seen);
    grid_done(&grid);
    scratch_done(&s);
    cloud_done(&cloud);
}

/* The quadrics of the whole cloud by the pipeline's stages, by the input's numbers of points. */
static struct packed_quadric *quadrics_of(const struct cloud *cloud, const struct params *params) {
    struct ordered_points points;
    struct knn *knn;
    struct neighbourhood hood;
    const struct neighbourhood_options near = {params->neighbourhood, (unsigned)params->neighbours_min,
                                               (unsigned)params->neighbours_max, 2};
    assert_int_equal(order_points(cloud->position, cloud->count, 2, &points), STATUS_OK);
    size_t n = points.count;
    assert_true(n < cloud->count);
    assert_int_equal(knn_new(points.point, n, 2, &knn, NULL), STATUS_OK);
    assert_int_equal(neighbourhood_find(knn, points.point, n, &near, &hood), STATUS_OK);
    vec3 *normal = alloc_array(n, sizeof *normal);
    float *dso = alloc_array(n, sizeof *dso), *smooth = alloc_array(n, sizeof *smooth);
    float *weight = alloc_array(n, sizeof *weight);
    struct packed_quadric *along = alloc_array(n, sizeof *along), *all = alloc_zeroed(cloud->count, sizeof *all);
    const struct quadric_options options = {(enum area_weight)params->area_weight, params->line_quadric, 2};
    assert_true(normal && dso && smooth && weight && along && all);
    normals_fit(points.point, &hood, 2, normal, NULL);
    dso_compute(points.point, normal, &hood, (enum dso_form)params->dso, 2, dso);
    dso_smooth(dso, &hood, 2, smooth);
    dso_weights(smooth, n, dso_average(smooth, NULL, n), params->dso_exponent, 2, weight);
    quadric_assemble(points.point, normal, &hood, weight, &options, along);
    for (size_t i = 0; i < n; i++) all[points.original[i]] = along[i];
    free(normal), free(dso), free(smooth), free(weight), free(along);
    neighbourhood_done(&hood);
    knn_free(knn);
    ordered_points_done(&points);
    return all;
}

/* The sample is the whole cloud here, so that what the plan has found is exact. */
static void quadrics_are_those_of_the_whole(void **state) {
    (void)state;
    struct params params = make_params();
    struct tiles_facts facts = plan_input("one", &params);
    struct scratch s = {0};
    struct grid grid = {0};
    struct error error = {0};
    struct cloud cloud = read_input();
    struct packed_quadric *expected = quadrics_of(&cloud, &params);
    size_t looked_at = 0;
    assert_int_equal(scratch_load(scratch_folder, &s, &error), STATUS_OK);
    assert_int_equal(grid_from(&grid, s.head.anchor, s.head.level, s.cell, s.head.cells), STATUS_OK);
    for (size_t t = 0; t < facts.tiles; t++) {
        struct scratch_points points;
        struct part part = {.params = &params, .threads = 2};
        struct part_whole whole = {s.head.whole, s.head.noisy, s.head.average, s.head.length_bias, 0};
        assert_int_equal(scratch_gather(scratch_folder, &s, &grid, &s.tile[t], 0.1, POINTS, 2, &points, &error),
                         STATUS_OK);
        assert_true(points.count < POINTS);
        assert_int_equal(part_make(&part, &points, false, &whole, NULL, &error), STATUS_OK);
        for (size_t i = 0; i < part.points.count; i++) {
            uint32_t id = points.id[part.points.original[i]];
            if (!part.own[i]) continue;
            assert_memory_equal(&part.quadrics[i], &expected[id], sizeof *expected);
            looked_at++;
        }
        part_done(&part);
        scratch_points_done(&points);
    }
    assert_int_equal(looked_at, POINTS - TWICE);
    free(expected);
    grid_done(&grid);
    scratch_done(&s);
    cloud_done(&cloud);
}

static int compare_numbers(const void *a, const void *b) {
    uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;
    return (x > y) - (x < y);
}

static int compare_places(const void *a, const void *b) { return memcmp(a, b, sizeof(vec3)); }

/* Bytes of the files in the folder. */
static double folder_bytes(void) {
    DIR *folder = opendir(scratch_folder);
    double sum = 0;
    assert_non_null(folder);
    for (struct dirent *entry; (entry = readdir(folder));) {
        struct stat about;
        assert_int_equal(fstatat(dirfd(folder), entry->d_name, &about, 0), 0);
        if (S_ISREG(about.st_mode)) sum += (double)about.st_size;
    }
    closedir(folder);
    return sum;
}

/* In what was foretold, which is twice the input. */
static void expect_disk(const struct params *params) {
    const uint64_t record = sizeof(vec3);
    double bytes = folder_bytes(), told = (double)tiles_predict(POINTS, record, params).disk_bytes;
    if (bytes > told || told > FIT_DISK * (double)record * POINTS || bytes < 0.7 * told)
        fail_msg("%.0f bytes of %.0f that were foretold", bytes, told);
}

/* How many of the most important n points are the same. */
static size_t count_common(const struct cloud *a, const uint32_t *a_kept, const struct cloud *b, const uint32_t *b_kept,
                           size_t n) {
    struct place {
        vec3 at;
    } *of = alloc_array(2 * n, sizeof *of);
    size_t common = 0;
    assert_non_null(of);
    for (size_t i = 0; i < n; i++) {
        of[2 * i] = (struct place){a->position[a_kept[i]]};
        of[2 * i + 1] = (struct place){b->position[b_kept[i]]};
    }
    qsort(of, 2 * n, sizeof *of, compare_places);
    for (size_t i = 0; i + 1 < 2 * n; i++) common += compare_places(&of[i], &of[i + 1]) == 0;
    free(of);
    return common;
}

static void expect_memorys(double ratio) {
    struct params params = make_params();
    params.ratio = ratio;
    struct tiles_facts facts = plan_input(ratio > 0.1 ? "told" : "kept", &params);
    struct error error = {0};
    struct cloud cloud = read_input(), kept = {0};
    struct kept_file file = {0};
    struct pipeline_result inside = {0}, tiled = {0};
    assert_true(facts.passes > 0);
    for (size_t t = facts.tiles; t-- > 0;) {
        assert_false(tiles_is_done(scratch_folder, t));
        assert_int_equal(tiles_merge(scratch_folder, 1, NULL, &kept, &file, &tiled, &error), STATUS_BAD_PARAMETER);
        assert_int_equal(tiles_run(scratch_folder, t, 2, NULL, &error), STATUS_OK);
        assert_int_equal(tiles_run(scratch_folder, t, 2, NULL, &error), STATUS_OK);
    }
    assert_int_equal(tiles_run(scratch_folder, facts.tiles, 2, NULL, &error), STATUS_BAD_PARAMETER);
    assert_int_equal(tiles_merge(scratch_folder, 2, NULL, &kept, &file, &tiled, &error), STATUS_OK);
    assert_int_equal(pipeline_run(&cloud, &params, NULL, &inside, &error), STATUS_OK);
    size_t n = inside.level[0].kept_count, common = 0;
    expect_disk(&params);
    assert_int_equal(tiled.level[0].kept_count, n);
    assert_int_equal(kept.count, n);
    assert_int_equal(tiled.report.points_in, inside.report.points_in);
    assert_int_equal(tiled.report.points_distinct, inside.report.points_distinct);
    assert_true(tiled.report.diagonal == inside.report.diagonal);
    const struct distance_stats *a_planes = &inside.report.level[0].tangent, *b_planes = &tiled.report.level[0].tangent;
    assert_int_equal(b_planes->count, POINTS);
    assert_true(fabs(b_planes->mean - a_planes->mean) < 0.02 * a_planes->mean);
    assert_true(fabs(b_planes->max - a_planes->max) < 0.02 * a_planes->max);
    double a_error = inside.report.level[0].contraction_error, b_error = tiled.report.level[0].contraction_error;
    assert_true(fabs(b_error - a_error) < 0.2 * a_error);
    assert_true(count_common(&cloud, inside.kept, &kept, tiled.kept, n / 4) > 0.97 * (double)(n / 4));
    qsort(inside.kept, n, sizeof *inside.kept, compare_numbers);
    size_t a = 0, b = 0;
    for (uint32_t id = 0; id < POINTS; id++) { /* both are in the order of the input */
        bool in_a = a < n && inside.kept[a] == id;
        bool in_b = b < n && memcmp(&cloud.position[id], &kept.position[b], sizeof(vec3)) == 0;
        common += in_a && in_b;
        a += in_a, b += in_b;
    }
    assert_int_equal(a, n);
    assert_int_equal(b, n);
    assert_true((double)common > 0.995 * (double)n);
    pipeline_result_done(&inside);
    pipeline_result_done(&tiled);
    cloud_done(&cloud);
    cloud_done(&kept);
}

/* Whatever points are and however many of them are kept, of what can be finished in memory where all have no room. */
static void twice_the_input_is_enough_disk(void **state) {
    static const uint64_t points[] = {1000000, 30000000, 1000000000}, record[] = {12, 16, 24, 26, 60};
    static const double ratio[] = {0.001, 0.01, 0.05, 0.07, 0.1, 0.18, 0.25, 0.34};
    (void)state;
    for (size_t i = 0; i < 3 * 5 * 8; i++) {
        struct params params = make_params();
        uint64_t n = points[i / 40], bytes = record[i / 8 % 5];
        double input_bytes = (double)(n * bytes), least = bytes < 24 ? 16 : 28;
        params.ratio = ratio[i % 8];
        params.memory_bytes = n * 250;
        double disk = (double)tiles_predict(n, bytes, &params).disk_bytes;
        if (disk > FIT_DISK * input_bytes || disk < least * (double)n)
            fail_msg("%.0f of %.0f bytes, %g kept", disk, input_bytes, params.ratio);
    }
}

/* Of a few all are left of tiles; more are told, which only their ranks show. */
static void tiles_keep_what_memory_keeps(void **state) {
    static const double ratio[] = {0.05, 0.2};
    for (size_t i = 0; i < sizeof ratio / sizeof *ratio; i++) expect_memorys(ratio[i]);
    (void)state;
}

/* Changes a byte in the middle of a file of the folder, or leaves nothing of it. */
static void damage(const char *name, size_t number, bool empties) {
    char path[SCRATCH_PATH_BYTES];
    unsigned char byte;
    scratch_path(path, scratch_folder, name, number);
    int fd = open(path, O_RDWR);
    assert_true(fd >= 0);
    off_t middle = lseek(fd, 0, SEEK_END) / 2;
    assert_int_equal(pread(fd, &byte, 1, middle), 1);
    byte ^= 4;
    assert_int_equal(pwrite(fd, &byte, 1, middle), 1);
    if (empties) assert_int_equal(ftruncate(fd, 0), 0);
    close(fd);
}

static void expect_damage(enum status status, const struct error *error, const char *says) {
    assert_int_equal(status, STATUS_IO);
    assert_string_equal(error->where, TILES_DAMAGED);
    assert_non_null(strstr(error->text, says));
}

/* Of points the plan is made again, with which tiles that are done go on; of what is left the tile.  Normals and what
 * has gone take part where the points are apart, what is told where many are kept; there files
 * are empty, as they may be where a disk says too early that it holds them. */
static void what_is_damaged_is_made_again(void **state) {
    (void)state;
    struct error error = {0};
    for (int turn = 0; turn < 3; turn++) {
        bool apart = turn == 1, empties = turn == 2;
        struct params params = make_params();
        if (turn == 2) params.ratio = 0.2;
        if (apart) params.ratio = NAN, params.spacing = 0.004;
        struct cloud kept[2] = {{0}, {0}};
        for (int damaged = 0; damaged < 2; damaged++) {
            struct kept_file file = {0};
            struct pipeline_result result = {0};
            struct tiles_facts facts = plan_input(damaged ? "damaged" : "whole", &params);
            assert_int_equal(tiles_run(scratch_folder, 0, 2, NULL, &error), STATUS_OK);
            if (damaged) {
                damage("points", 1, empties);
                expect_damage(tiles_run(scratch_folder, 1, 2, NULL, &error), &error, "plan again");
                assert_true(tiles_is_done(scratch_folder, 0) && !scratch_has(scratch_folder, "points", 1));
                facts = plan_input("damaged", &params);
                assert_int_equal(facts.done, 1);
            }
            for (size_t t = 0; t < facts.tiles; t++)
                assert_int_equal(tiles_run(scratch_folder, t, 2, NULL, &error), STATUS_OK);
            if (damaged) { /* where the merge reads them */
                damage("points", 1, empties);
                expect_damage(tiles_merge(scratch_folder, 2, NULL, &kept[1], &file, &result, &error), &error,
                              "plan again");
                facts = plan_input("damaged", &params);
                assert_int_equal(facts.done, facts.tiles);
            }
            for (int which = 0; damaged && which <= apart; which++) {
                damage(which ? "gone" : "left", 1, empties);
                expect_damage(tiles_merge(scratch_folder, 2, NULL, &kept[1], &file, &result, &error), &error, "tile 1");
                assert_false(tiles_is_done(scratch_folder, 1));
                assert_int_equal(tiles_run(scratch_folder, 1, 2, NULL, &error), STATUS_OK);
            }
            assert_int_equal(tiles_merge(scratch_folder, 2, NULL, &kept[damaged], &file, &result, &error), STATUS_OK);
            pipeline_result_done(&result);
            tiles_remove(scratch_folder);
        }
        assert_int_equal(kept[0].count, kept[1].count);
        assert_memory_equal(kept[0].position, kept[1].position, kept[0].count * sizeof *kept[0].position);
        cloud_done(&kept[0]), cloud_done(&kept[1]);
    }
}

/* Where a plan was removed by hand, what another one's tiles have left is none of this one's. */
static void what_another_plan_has_left_is_made_again(void **state) {
    (void)state;
    struct error error = {0};
    struct params params = make_params();
    struct cloud kept = {0};
    struct kept_file file = {0};
    struct pipeline_result result = {0};
    char path[SCRATCH_PATH_BYTES];
    plan_input("replanned", &params);
    assert_int_equal(tiles_run(scratch_folder, 0, 2, NULL, &error), STATUS_OK);
    scratch_path(path, scratch_folder, "plan", 0);
    assert_int_equal(unlink(path), 0);
    params.ratio = 0.04;
    struct tiles_facts facts = plan_input("replanned", &params);
    for (size_t t = 0; t < facts.tiles; t++) assert_int_equal(tiles_run(scratch_folder, t, 2, NULL, &error), STATUS_OK);
    expect_damage(tiles_merge(scratch_folder, 2, NULL, &kept, &file, &result, &error), &error, "tile 0");
}

static bool is_last(void *ctx) {
    long *left = ctx;
    return --*left == 0;
}

/* One step of the way, as often as it has allocations that may fail, or about: how many were refused. */
static size_t fail_at_each(enum status (*step)(struct error *error)) {
    size_t refused = 0;
    long left = 0;
    for (long nth = 1; left <= 0; nth += 1 + nth / 6) {
        struct error error = {0};
        left = nth;
        alloc_fail_ctx = &left, alloc_fail = is_last;
        enum status status = step(&error);
        alloc_fail = NULL;
        if (status != STATUS_OK && status != STATUS_NO_MEMORY) fail_msg("%s: %s", error.where, error.text);
        assert_true(status == STATUS_OK || error.text[0] != 0);
        refused += status != STATUS_OK;
    }
    return refused;
}

static struct params without_memory;

static enum status step_plan(struct error *error) {
    struct tiles_facts facts;
    const char *const inputs[] = {input};
    const struct tiles_job job = {inputs, 1, scratch_folder, &without_memory, POINTS / 3};
    tiles_remove(scratch_folder);
    return tiles_plan(&job, NULL, &facts, error);
}

static enum status step_run(struct error *error) {
    char path[SCRATCH_PATH_BYTES];
    scratch_path(path, scratch_folder, "left", 0);
    unlink(path);
    return tiles_run(scratch_folder, 0, 1, NULL, error);
}

static enum status step_merge(struct error *error) {
    struct cloud cloud = {0};
    struct kept_file file = {0};
    struct pipeline_result result = {0};
    enum status status = tiles_merge(scratch_folder, 1, NULL, &cloud, &file, &result, error);
    assert_int_equal(file.path != NULL, status == STATUS_OK && fit_is_tileset(&without_memory));
    tiles_kept_remove(&file);
    cloud_done(&cloud);
    pipeline_result_done(&result);
    return status;
}

/* Of tiles that tell what has gone, too. */
static void any_allocation_may_fail(void **state) {
    struct error error = {0};
    struct tiles_facts facts;
    (void)state;
    without_memory = make_params();
    without_memory.outputs = OUTPUT_TILESET;
    without_memory.ratio = 1;
    without_memory.threads = 1;
    snprintf(scratch_folder, sizeof scratch_folder, "%s/%s", base, "none");
    assert_true(fail_at_each(step_plan) > 10);
    assert_int_equal(tiles_look(scratch_folder, &facts, NULL, &error), STATUS_OK);
    assert_true(facts.for_tileset && facts.tiles > 2);
    assert_true(fail_at_each(step_run) > 10);
    for (size_t t = 0; t < facts.tiles; t++) assert_int_equal(tiles_run(scratch_folder, t, 1, NULL, &error), STATUS_OK);
    assert_true(fail_at_each(step_merge) > 10);
}

/* Of the merges that need more than what is left: points that have gone, the sides of normals, what is told. */
static void any_allocation_of_a_merge_may_fail(void **state) {
    struct error error = {0};
    (void)state;
    static const char *const name[] = {"apart", "turned", "all told"};
    for (int turn = 0; turn < 3; turn++) {
        without_memory = make_params();
        without_memory.threads = 1;
        without_memory.normals = turn ? SWITCH_TRUE : SWITCH_FALSE;
        if (!turn) without_memory.ratio = NAN, without_memory.spacing = 0.004;
        if (turn == 2) without_memory.ratio = 0.2;
        struct tiles_facts facts = plan_input(name[turn], &without_memory);
        if (turn == 2) assert_true(fail_at_each(step_run) > 10);
        assert_true(facts.tiles > 2);
        for (size_t t = 0; t < facts.tiles; t++)
            assert_int_equal(tiles_run(scratch_folder, t, 1, NULL, &error), STATUS_OK);
        assert_true(fail_at_each(step_merge) > 10);
    }
}

static struct pipeline_result measured;
static struct cloud measured_cloud;

static enum status step_measure(struct error *error) {
    return tiles_measure(scratch_folder, 1, NULL, &measured_cloud, (const float(*)[3])measured.facing, &measured,
                         error);
}

/* Of the points that tiles have kept a few are the mesh's, and two are said to have been dropped; all others count. */
static void all_points_are_measured(void **state) {
    (void)state;
    enum { DROPPED = 2 };
    struct params params = make_params();
    struct error error = {0};
    struct kept_file file;
    params.outputs = OUTPUT_MESH;
    params.memory_bytes = (uint64_t)160 << 20;
    struct tiles_facts facts = plan_input("measured", &params);
    for (size_t t = 0; t < facts.tiles; t++) assert_int_equal(tiles_run(scratch_folder, t, 1, NULL, &error), STATUS_OK);
    assert_int_equal(tiles_merge(scratch_folder, 2, NULL, &measured_cloud, &file, &measured, &error), STATUS_OK);
    assert_non_null(measured.facing);
    vec3 corner[] = {{3999, -1, 0.01}, {4002, -1, 0.01}, {4002, 2, 0.03}, {3999, 2, 0.03}};
    uint32_t triangle[][3] = {{0, 1, 2}, {0, 2, 3}};
    const struct mesh mesh = {.vertex_count = 4, .vertex = corner, .triangle_count = 2, .triangle = triangle};
    measured.level[0].mesh = mesh;
    measured.level_count = 1;
    measured.level[0].kept_count = measured_cloud.count / 4;
    measured.dropped = alloc_zeroed(measured_cloud.count, sizeof *measured.dropped);
    assert_non_null(measured.dropped);

    struct cloud all = read_input();
    const struct metro_options options = {.threads = 1};
    struct distance_stats expected, *found = &measured.report.level[0].input_to_mesh;
    assert_int_equal(metro_points(all.position, all.count, &mesh, &options, &expected), STATUS_OK);
    assert_int_equal(step_measure(&error), STATUS_OK);
    assert_int_equal(found->count, POINTS);
    assert_true(fabs(found->mean - expected.mean) < 1e-9 && fabs(found->rms - expected.rms) < 1e-9);
    assert_true(fabs(found->max - expected.max) < 1e-9);
    assert_int_equal(measured.report.level[0].tangent.count, POINTS);
    assert_true(measured.report.level[0].tangent.mean > 0 && measured.report.level[0].tangent.mean < 0.001);
    assert_true(measured.report.level[0].symmetric.max == found->max);

    for (size_t i = 0; i < DROPPED; i++) measured.dropped[100 * i] = true;
    measured.report.points_outliers = DROPPED;
    size_t others = 0;
    for (size_t i = 0; i < all.count; i++) {
        const vec3 *p = &all.position[i], *first = &measured_cloud.position[0], *second = &measured_cloud.position[100];
        others += memcmp(p, first, sizeof *p) != 0 && memcmp(p, second, sizeof *p) != 0;
    }
    assert_true(others <= POINTS - DROPPED && others > POINTS - 10);
    assert_int_equal(step_measure(&error), STATUS_OK);
    assert_int_equal(found->count, others);
    assert_true(fail_at_each(step_measure) > 5);
    assert_int_equal(found->count, others);
    measured.level[0].mesh = (struct mesh){0};
    pipeline_result_done(&measured);
    cloud_done(&measured_cloud);
    cloud_done(&all);
}

static void other_runs_are_refused(void **state) {
    (void)state;
    struct params params = make_params();
    struct tiles_facts facts;
    struct error error = {0};
    const char *const inputs[] = {input};
    plan_input("one", &params);
    const struct tiles_job job = {inputs, 1, scratch_folder, &params, TILE};
    assert_int_equal(tiles_plan(&job, NULL, &facts, &error), STATUS_OK);
    params.ratio = 0.04;
    assert_int_equal(tiles_plan(&job, NULL, &facts, &error), STATUS_BAD_PARAMETER);
    assert_non_null(strstr(error.text, "ratio"));
    params.ratio = 0.05;
    params.memory_bytes *= 2;
    assert_int_equal(tiles_plan(&job, NULL, &facts, &error), STATUS_BAD_PARAMETER);
    params.memory_bytes /= 2;
    params.threads = 1;
    assert_int_equal(tiles_plan(&job, NULL, &facts, &error), STATUS_OK);
    params.outputs |= OUTPUT_MESH; /* for which other points are left */
    assert_int_equal(tiles_plan(&job, NULL, &facts, &error), STATUS_BAD_PARAMETER);
    params.outputs |= OUTPUT_DSO;
    assert_int_equal(tiles_plan(&job, NULL, &facts, &error), STATUS_NO_MEMORY);
}

/* Whoever reads "version" in the error knows that it is nobody's fault, and begins anew. */
static void a_plan_of_another_version_is_named_so(void **state) {
    (void)state;
    struct params params = make_params();
    struct tiles_facts facts;
    struct error error = {0};
    char path[SCRATCH_PATH_BYTES];
    plan_input("older", &params);
    scratch_path(path, scratch_folder, "plan", 0);
    FILE *file = fopen(path, "r+b");
    assert_non_null(file);
    assert_int_equal(fseek(file, sizeof "whittle tiles " - 1, SEEK_SET), 0);
    assert_int_equal(fputc('0', file), '0');
    assert_int_equal(fclose(file), 0);
    assert_int_equal(tiles_look(scratch_folder, &facts, NULL, &error), STATUS_BAD_PARAMETER);
    assert_string_equal(error.where, "version");
    assert_int_equal(tiles_run(scratch_folder, 0, 2, NULL, &error), STATUS_BAD_PARAMETER);
    assert_string_equal(error.where, "version");
}

/* Points come in from a corner, so that cells are joined in the middle of a part, and one that is far off joins them
 * again.  Whatever the parts and threads are, each point is counted once, in the cell of its place. */
static void cells_hold_each_point_once(void **state) {
    enum { MANY = 700000, PARTS = 3 };
    static const struct {
        size_t part;
        unsigned threads;
    } way[PARTS] = {{MANY, 2}, {50000, 1}, {333, 2}};
    struct grid grid[PARTS];
    uint32_t *cell = alloc_array(MANY, sizeof *cell), *count = alloc_zeroed(GRID_MOST_CELLS, sizeof *count);
    vec3 *point = alloc_array(MANY, sizeof *point);
    uint64_t seed = 5;
    (void)state;
    assert_true(cell && count && point);
    for (size_t i = 0; i < MANY; i++) {
        double grown = sqrt((double)(i + 1) / MANY);
        point[i] = (vec3){grown * random_unit(&seed), grown * random_unit(&seed), -0.1 * random_unit(&seed)};
    }
    point[MANY / 2] = (vec3){-3e8, 5, 0};
    for (size_t w = 0; w < PARTS; w++) {
        assert_int_equal(grid_init(&grid[w], point, 1000), STATUS_OK);
        for (size_t first = 0; first < MANY; first += way[w].part) {
            size_t n = MANY - first < way[w].part ? MANY - first : way[w].part;
            grid_count(&grid[w], point + first, n, way[w].threads, cell);
        }
        assert_int_equal(grid[w].level, grid[0].level);
        assert_int_equal(grid[w].count, grid[0].count);
        assert_memory_equal(grid[w].cell, grid[0].cell, grid[0].count * sizeof *grid[0].cell);
    }
    grid_find(&grid[0], point, MANY, 2, cell);
    for (size_t i = 0; i < MANY; i++) {
        assert_in_range(cell[i], 0, grid[0].count - 1);
        struct grid_place place = grid_place_of(&grid[0], point[i]);
        double side = grid_side(&grid[0]);
        assert_memory_equal(&place, &grid[0].cell[cell[i]].place, sizeof place);
        assert_true(place.at[2] == (int32_t)floor((point[i].z - grid[0].anchor.z) / side));
        count[cell[i]]++;
    }
    for (size_t i = 0; i < grid[0].count; i++) assert_int_equal(count[i], grid[0].cell[i].count);
    const vec3 none[] = {{1e300, 0, 0}, {0.5, 0.5, 1e9}};
    grid_find(&grid[0], none, 2, 1, cell);
    assert_int_equal(cell[0], NONE);
    assert_int_equal(cell[1], NONE);
    for (size_t w = 0; w < PARTS; w++) grid_done(&grid[w]);
    free(cell), free(count), free(point);
}

static int make_base(void **state) {
    (void)state;
    folder_make_in_memory(base, sizeof base);
    write_input();
    return 0;
}

static int remove_base(void **state) {
    (void)state;
    folder_remove(base);
    return 0;
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(cells_hold_each_point_once),     cmocka_unit_test(links_come_back),
        cmocka_unit_test(what_is_told_comes_back),        cmocka_unit_test(what_is_told_is_ranked),
        cmocka_unit_test(every_point_is_in_one_tile),     cmocka_unit_test(quadrics_are_those_of_the_whole),
        cmocka_unit_test(twice_the_input_is_enough_disk), cmocka_unit_test(tiles_keep_what_memory_keeps),
        cmocka_unit_test(what_is_damaged_is_made_again),  cmocka_unit_test(what_another_plan_has_left_is_made_again),
        cmocka_unit_test(other_runs_are_refused),         cmocka_unit_test(a_plan_of_another_version_is_named_so),
        cmocka_unit_test(any_allocation_may_fail),        cmocka_unit_test(any_allocation_of_a_merge_may_fail),
        cmocka_unit_test(all_points_are_measured)};
    return cmocka_run_group_tests(tests, make_base, remove_base);
}
