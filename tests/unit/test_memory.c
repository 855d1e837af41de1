/* The predicted peak of a job against the peak of a process that runs it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/io/read.h"
#include "core/picture/picture.h"
#include "core/pipeline/memory.h"
#include "core/pipeline/pipeline.h"
#include "tests/unit/shapes.h"

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { SANITIZED = 1 };
#else
enum { SANITIZED = 0 };
#endif

static struct params params_of(const char *settings) {
    struct params params;
    char name[64], value[64];
    int used;
    params_defaults(&params);
    for (; sscanf(settings, " %63s %63s%n", name, value, &used) == 2; settings += used)
        assert_int_equal(params_set(&params, name, value, NULL), STATUS_OK);
    assert_int_equal(params_resolve(&params, NULL), STATUS_OK);
    return params;
}

/* ------------------------------------------------------------------------------------------------ measured */

enum { CUBE = 1 }; /* as noise: there is none, and the points are a cube's */

/* A sphere with noise, or a cube of about as many points, as PLY with `attributes` floats beside the coordinates. */
static void write_scan(const char *path, size_t n, double noise, unsigned attributes) {
    FILE *file = fopen(path, "wb");
    bool is_cube = noise >= CUBE;
    vec3 *point = is_cube ? shape_cube((size_t)sqrt((double)n / 6), 0.2, &n) : shape_sphere(n, 1);
    if (is_cube) noise = 0;
    uint64_t state = 7;
    fprintf(file,
            "ply\nformat binary_little_endian 1.0\nelement vertex %zu\nproperty float x\nproperty float y\n"
            "property float z\n",
            n);
    for (unsigned a = 0; a < attributes; a++) fprintf(file, "property float a%u\n", a);
    fprintf(file, "end_header\n");
    for (size_t i = 0; i < n; i++) {
        double r = 1 + noise * (random_unit(&state) - 0.5);
        float record[35] = {(float)(r * point[i].x), (float)(r * point[i].y), (float)(r * point[i].z)};
        assert_int_equal(fwrite(record, (3 + attributes) * sizeof(float), 1, file), 1);
    }
    assert_int_equal(fclose(file), 0);
    free(point);
}

static int run_job(const char *path, const struct params *params) {
    struct cloud cloud = {0};
    struct pipeline_result result = {0};
    if (cloud_read_path(path, NULL, NULL, &cloud, NULL)) return 1;
    if (pipeline_run(&cloud, params, NULL, &result, NULL)) return 1;
    const struct picture_scene scene = {.cloud = &cloud,
                                        .normal = (const float(*)[3])result.facing,
                                        .deviation = result.distance,
                                        .mesh = &result.level[0].mesh,
                                        .kept = result.kept,
                                        .kept_count = result.level[0].kept_count};
    const struct picture_view view = {params->preview_size, 30, 25, VIEW_UP_AUTO};
    struct picture picture;
    return params->outputs & OUTPUT_PREVIEW && picture_make(&scene, &view, 0, &picture) ? 1 : 0;
}

static double peak_of(const char *path, const struct params *params) {
    pid_t child = fork();
    assert_true(child >= 0);
    if (child == 0) _exit(run_job(path, params));
    int how;
    struct rusage usage;
    assert_int_equal(wait4(child, &how, 0, &usage), child);
    assert_true(WIFEXITED(how) && WEXITSTATUS(how) == 0);
    return (double)usage.ru_maxrss * 1024;
}

static double predicted_for(const char *path, const struct params *params) {
    unsigned char first[4096];
    FILE *file = fopen(path, "rb");
    size_t n = fread(first, 1, sizeof first, file);
    assert_int_equal(fseek(file, 0, SEEK_END), 0);
    struct memory_job job;
    assert_int_equal(memory_job_of(first, n, (uint64_t)ftell(file), &job), STATUS_OK);
    fclose(file);
    return (double)memory_predict(&job, params);
}

/* times: how much more than the peak may be predicted; noise is counted in, so clouds without it take less, and as many
 * tetrahedra as there may be, where surfaces have two thirds of them. */
static const struct {
    size_t points;
    double noise;
    unsigned attributes;
    const char *settings;
    double times;
} jobs[] = {
    {20000, 0, 0, "", 1.7},
    {100000, 0, 0, "", 1.8},
    {100000, 0.02, 0, "", 1.5},
    {100000, 0.02, 0, "neighbours_max 16 neighbours_min 12", 1.5},
    {100000, 0, 32, "ratio 0.5", 1.8},
    {100000, 0.03, 0, "denoise full", 1.5}, /* wide neighbourhoods: those of less noise take less */
    {30000, 0, 0, "outputs cloud,mesh,report", 1.8},
    {100000, 0.02, 0, "outputs cloud,mesh,report", 1.6},
    {100000, 0.05, 0, "outputs cloud,mesh,report", 1.6},
    {30000, 0.02, 0, "outputs cloud,mesh,report ratio 0.5 placement optimal", 1.5},
    {60000, 0.02, 0, "outputs cloud,mesh,report ratio 0.2 placement optimal order simplify-first", 1.5},
    {60000, 0.02, 0, "outputs cloud,mesh,report ratio 0.5 placement optimal surface open", 1.5},
    {30000, 0, 0, "outputs cloud,mesh,report ratio 0.5 refine none", 2.1},
    {30000, 0, 0, "outputs cloud,mesh,report ratio 0.9", 2.0},
    {30000, 0, 0, "outputs cloud,mesh,report ratio 0.2 placement optimal", 1.7},
    {30000, 0, 0, "outputs cloud,mesh,report ratio 0.9 placement optimal", 1.7},
    {80000, CUBE, 0, "outputs cloud,mesh,report ratio 0.1 placement optimal", 1.7},
    {30000, 0, 0, "outputs cloud,mesh,report,dso,error levels 0.4,0.2,0.1", 1.9},
    {30000, 0, 0, "outputs mesh,preview.png", 1.9},
    {1000, 0, 0, "outputs preview.png preview_size 600", 1.6},
    {400000, 0, 0, "outputs preview.png preview_size 300", 1.8},
    {30000, 0, 0, "outputs cloud,mesh,report ratio 0.1 reference reconstruction refine none", 2.1},
};

static void jobs_stay_below_the_prediction_and_near_it(void **state) {
    (void)state;
    unsigned missed = 0;
    char path[] = "/tmp/whittle-memory-XXXXXX";
    if (SANITIZED) {
        print_message("skipped: sanitizers take memory of their own\n");
        skip();
    }
    if (getenv("WHITTLE_EMULATED")) {
        print_message("skipped: an emulator takes memory of its own\n");
        skip();
    }
    int fd = mkstemp(path);
    assert_true(fd >= 0);
    close(fd);
    for (size_t i = 0; i < sizeof jobs / sizeof jobs[0]; i++) {
        struct params params = params_of(jobs[i].settings);
        write_scan(path, jobs[i].points, jobs[i].noise, jobs[i].attributes);
        double peak = peak_of(path, &params), predicted = predicted_for(path, &params);
        print_message("%7zu points, noise %g, '%s': took %.1f MB, predicted %.2f times that\n", jobs[i].points,
                      jobs[i].noise, jobs[i].settings, peak / 1e6, predicted / peak);
        missed += predicted < peak || predicted > jobs[i].times * peak;
    }
    unlink(path);
    assert_int_equal(missed, 0);
}

/* ------------------------------------------------------------------------------------------------ what comes */

/* Faces of many corners are as many triangles as their bytes have room for; of three, as many as there are. */
static void corners_are_counted_by_their_bytes(void **state) {
    (void)state;
    static const char header[] = "ply\nformat binary_little_endian 1.0\nelement vertex 100\nproperty float x\n"
                                 "property float y\nproperty float z\nelement face 50\n"
                                 "property list uchar int vertex_indices\nend_header\n";
    struct memory_job job;
    const uint64_t points_end = sizeof header - 1 + 1200;
    assert_int_equal(memory_job_of(header, sizeof header - 1, points_end + 50 * 13, &job), STATUS_OK);
    assert_int_equal(job.faces, 50);
    assert_int_equal(memory_job_of(header, sizeof header - 1, points_end + 50 * (1 + 4 * 255), &job), STATUS_OK);
    assert_int_equal(job.faces, 50 * 253);
    assert_int_equal(memory_job_of(header, sizeof header - 1, UINT64_MAX, &job), STATUS_OK);
    assert_true(job.faces == 50 && job.faces_most == UINT64_MAX);
    static const char fan[] = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3 1 2 3 1 2 3 1 2 3\n";
    struct params params = params_of("outputs mesh");
    assert_int_equal(memory_job_of(fan, sizeof fan - 1, 1000000, &job), STATUS_OK);
    assert_true(job.faces <= 3 * job.points && job.faces_most == 500000);
    params.memory_bytes = memory_predict(&job, &params);
    struct memory_job read = {job.points, job.record_bytes, 499998, 0, 0};
    assert_true(memory_lacks_for_faces(&read, &params));
    assert_true(memory_triangles(&params) >= job.faces);
    read.faces = job.faces;
    assert_false(memory_lacks_for_faces(&read, &params));
    params.memory_bytes = memory_predict_most(&job, &params);
    read.faces = 499998;
    assert_false(memory_lacks_for_faces(&read, &params));
    assert_true(memory_triangles(&params) > 499998);
    params.memory_bytes = 0;
    assert_true(!memory_lacks_for_faces(&read, &params) && memory_triangles(&params) == 0);
}

static void a_header_says_how_many_points_come(void **state) {
    (void)state;
    static const char header[] = "ply\nformat ascii 1.0\nelement vertex 5000000000\nproperty double x\n"
                                 "property double y\nproperty double z\nproperty uchar red\nelement face 7\n"
                                 "property list uchar int vertex_indices\nend_header\n";
    struct memory_job job;
    assert_int_equal(memory_job_of(header, sizeof header - 1, UINT64_MAX, &job), STATUS_OK);
    assert_true(job.points == 5000000000 && job.record_bytes == 25 && job.faces == 2 * 7 &&
                job.faces_most == UINT64_MAX);
    assert_int_equal(memory_job_of(header, 40, 100000, &job), STATUS_MALFORMED);
}

static void the_first_lines_say_how_many_points_come(void **state) {
    (void)state;
    static const char text[] = "1.5 2.5 3.5\n4.5 5.5 6.5\n";
    struct memory_job job;
    assert_int_equal(memory_job_of(text, sizeof text - 1, 24000, &job), STATUS_OK);
    assert_true(job.points >= 2000 && job.points <= 2400 && job.record_bytes == 24 && job.input_bytes == 24000);
    static const char pcd[] = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 8\nTYPE F F F\nWIDTH 70\nDATA binary_compressed\n";
    assert_int_equal(memory_job_of(pcd, sizeof pcd - 1, 5000, &job), STATUS_OK);
    assert_true(job.points == 70 && job.record_bytes == 16 && job.input_bytes == 5000 + 70 * 16);
    unsigned char las[375] = "LASF";
    las[24] = 1, las[25] = 4, las[105] = 30, las[247] = 9;
    assert_int_equal(memory_job_of(las, sizeof las, 1000, &job), STATUS_OK);
    assert_true(job.points == 9 && job.record_bytes >= 30);
    assert_int_equal(memory_job_of(las, 100, 1000, &job), STATUS_MALFORMED);
    unsigned char stl[84 + 4 * 50] = {0};
    stl[80] = 4;
    assert_int_equal(memory_job_of(stl, sizeof stl, sizeof stl, &job), STATUS_OK);
    assert_true(job.points == 4 && job.faces == 4 && job.record_bytes == 28);
    assert_int_equal(memory_job_of("v 0 0 0\nf 1 1 1\n", 16, 16, &job), STATUS_OK);
    assert_true(job.points >= 1 && job.faces >= 1);
    assert_int_equal(memory_job_of("\x1f\x8b\x08", 3, 3, &job), STATUS_UNSUPPORTED);
    assert_int_equal(memory_job_of("\x89PNG\r\n\x1a\n", 8, 8, &job), STATUS_UNSUPPORTED);
    assert_int_equal(memory_job_of("", 0, 0, &job), STATUS_MALFORMED);
}

static void points_are_counted_whatever_ends_their_lines(void **state) {
    (void)state;
    static const char *const twelve_bytes_each[] = {"1.5 2.5 3.5\r4.5 5.5 6.5\r", "1.5 2.5 3.\r\n4.5 5.5 6.\r\n"};
    struct memory_job job;
    for (size_t i = 0; i < 2; i++) {
        assert_int_equal(memory_job_of(twelve_bytes_each[i], 24, 24000, &job), STATUS_OK);
        assert_true(job.points >= 2000 && job.points <= 2400 && job.record_bytes == 24);
    }
    char line[4096] = "OFF 1000 0 0";
    for (size_t n = strlen(line); n + 12 < sizeof line; n += 12) memcpy(line + n, " 1.5 2.5 3.5", 12);
    assert_int_equal(memory_job_of(line, strlen(line), 12012, &job), STATUS_OK);
    assert_true(job.points >= 1000 && job.points <= 1300 && job.record_bytes == 24);
}

static void more_of_anything_takes_no_less(void **state) {
    (void)state;
    struct params cloud = params_of(""), mesh = params_of("outputs cloud,mesh"), all = params_of("points 4000000000");
    struct memory_job small = {1000000, 12, 0, 12000000, 0}, more = {2000000, 12, 0, 24000000, 0};
    struct memory_job wide = {1000000, 120, 0, 120000000, 0};
    struct memory_job most = {UINT64_MAX, UINT64_MAX, UINT64_MAX, UINT64_MAX, UINT64_MAX};
    assert_true(memory_predict(&small, &cloud) < memory_predict(&more, &cloud));
    assert_true(memory_predict(&small, &cloud) < memory_predict(&wide, &cloud));
    assert_true(memory_predict(&small, &cloud) <= memory_predict(&small, &mesh));
    assert_true(memory_predict(&small, &cloud) <= memory_predict(&small, &all));
    assert_true(memory_predict(&most, &mesh) == UINT64_MAX);
}

/* What was predicted has room for the tetrahedra that it counts; more memory has for more, up to a bound. */
static void tetrahedra_have_the_room_that_memory_leaves(void **state) {
    (void)state;
    const struct memory_job job = {1000000, 12, 0, 0, 0};
    struct params params = params_of("outputs mesh ratio 1 refine none");
    uint64_t most = memory_tetrahedra(&job, 1000000, false, &params);
    assert_true(most == MEMORY_MOST_TETRAHEDRA * UINT64_C(1000000));
    params.memory_bytes = memory_predict(&job, &params);
    uint64_t predicted = memory_tetrahedra(&job, 1000000, false, &params);
    assert_true(predicted >= 10500000 && predicted < 11000000);
    params.memory_bytes *= 2;
    assert_true(memory_tetrahedra(&job, 1000000, false, &params) > 2 * predicted);
    params.memory_bytes = memory_predict_most(&job, &params);
    assert_true(memory_tetrahedra(&job, 1000000, false, &params) == most);
    params.memory_bytes = 1;
    assert_true(memory_tetrahedra(&job, 1000000, false, &params) == 0);
    params = params_of("outputs mesh reference reconstruction");
    params.memory_bytes = memory_predict(&job, &params);
    assert_true(memory_tetrahedra(&job, 100000, true, &params) >= 10500000);
    assert_true(memory_predict_most(&job, &params) > 2 * params.memory_bytes);
    params = params_of("outputs cloud");
    assert_true(memory_predict_most(&job, &params) == memory_predict(&job, &params));
}

/* However few of the points are to stay: given faces may let none go. */
static void the_most_has_room_for_given_faces_as_they_are(void **state) {
    (void)state;
    const struct memory_job job = {1000000, 12, 2000000, 0, 0};
    struct params all = params_of("outputs mesh ratio 1 surface given");
    struct params few = params_of("outputs mesh ratio 0.001 surface given");
    struct params open = params_of("outputs mesh ratio 0.001 surface open");
    assert_true(memory_predict_most(&job, &few) >= memory_predict(&job, &all));
    assert_true(2 * memory_predict_most(&job, &open) < memory_predict(&job, &all));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(jobs_stay_below_the_prediction_and_near_it),
        cmocka_unit_test(corners_are_counted_by_their_bytes),
        cmocka_unit_test(a_header_says_how_many_points_come),
        cmocka_unit_test(the_first_lines_say_how_many_points_come),
        cmocka_unit_test(points_are_counted_whatever_ends_their_lines),
        cmocka_unit_test(more_of_anything_takes_no_less),
        cmocka_unit_test(tetrahedra_have_the_room_that_memory_leaves),
        cmocka_unit_test(the_most_has_room_for_given_faces_as_they_are),
    };
    return cmocka_run_group_tests_name("memory", tests, NULL, NULL);
}
