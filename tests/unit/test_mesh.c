/* Facts about small meshes, meshes as PLY, and files that appear complete or not at all.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <dirent.h>
#include <fcntl.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/io/out/file_out.h"
#include "core/io/out/ply_write.h"
#include "core/io/read.h"
#include "core/mesh/components.h"
#include "core/mesh/mesh.h"

static vec3 corner[] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 1, 1},
                        {5, 5, 5}, {6, 5, 5}, {5, 6, 5}, {5, 5, 6}};
static uint32_t tetrahedron[][3] = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}};

static struct mesh_facts examine(uint32_t (*triangle)[3], size_t triangles, size_t vertices) {
    struct mesh mesh = {.vertex_count = vertices, .vertex = corner, .triangle_count = triangles, .triangle = triangle};
    struct mesh_facts facts;
    size_t components = 9;
    assert_int_equal(mesh_examine(&mesh, &facts), STATUS_OK);
    assert_int_equal(components_count(&mesh, &components), STATUS_OK);
    assert_int_equal(components, facts.components);
    return facts;
}

static void tetrahedron_is_watertight(void **state) {
    (void)state;
    struct mesh_facts f = examine(tetrahedron, 4, 4);
    assert_int_equal(f.edges, 6);
    assert_int_equal(f.boundary_edges + f.nonmanifold_edges + f.misoriented_edges + f.nonmanifold_vertices, 0);
    assert_int_equal(f.unused_vertices, 0);
    assert_int_equal(f.components, 1);
    assert_int_equal(f.euler, 2);
    assert_true(f.watertight && f.manifold);
    assert_true(fabs(f.volume - 1.0 / 6) < 1e-15);
    assert_true(fabs(f.area - (1.5 + sqrt(3) / 2)) < 1e-15);
}

static void inside_out_has_negative_volume(void **state) {
    (void)state;
    uint32_t t[][3] = {{0, 1, 2}, {0, 3, 1}, {0, 2, 3}, {1, 3, 2}};
    struct mesh_facts f = examine(t, 4, 4);
    assert_true(f.watertight && f.manifold && fabs(f.volume + 1.0 / 6) < 1e-15);
}

static void missing_triangle_leaves_a_boundary(void **state) {
    (void)state;
    struct mesh_facts f = examine(tetrahedron, 3, 4);
    assert_int_equal(f.boundary_edges, 3);
    assert_int_equal(f.euler, 1);
    assert_true(f.manifold && !f.watertight);
}

static void turned_triangle_is_misoriented(void **state) {
    (void)state;
    uint32_t t[][3] = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 3, 2}};
    struct mesh_facts f = examine(t, 4, 4);
    assert_int_equal(f.misoriented_edges, 3);
    assert_int_equal(f.boundary_edges, 0);
    assert_false(f.watertight);
}

static void three_triangles_at_an_edge_are_nonmanifold(void **state) {
    (void)state;
    uint32_t t[][3] = {{0, 1, 2}, {1, 0, 3}, {0, 1, 4}};
    struct mesh_facts f = examine(t, 3, 5);
    assert_int_equal(f.nonmanifold_edges, 1);
    assert_int_equal(f.boundary_edges, 6);
    assert_int_equal(f.nonmanifold_vertices, 0);
    assert_false(f.manifold || f.watertight);
}

static void two_fans_at_a_vertex_are_nonmanifold(void **state) {
    (void)state;
    uint32_t t[][3] = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}, {0, 6, 5}, {0, 5, 7}, {0, 7, 6}, {5, 6, 7}};
    struct mesh_facts f = examine(t, 8, 8);
    assert_int_equal(f.nonmanifold_vertices, 1);
    assert_int_equal(f.nonmanifold_edges, 0);
    assert_int_equal(f.components, 1);
    assert_int_equal(f.unused_vertices, 1);
    assert_int_equal(f.euler, 3);
    assert_true(f.watertight && !f.manifold);
}

static void separate_pieces_are_components(void **state) {
    (void)state;
    uint32_t t[][3] = {{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}, {5, 7, 6}, {5, 6, 8}, {5, 8, 7}, {6, 7, 8}};
    struct mesh_facts f = examine(t, 8, 9);
    assert_int_equal(f.components, 2);
    assert_int_equal(f.unused_vertices, 1);
    assert_int_equal(f.euler, 4);
    assert_true(f.watertight && f.manifold);
    assert_true(fabs(f.volume - 2.0 / 6) < 1e-12);
}

static void no_triangles_are_not_watertight(void **state) {
    (void)state;
    struct mesh_facts f = examine(tetrahedron, 0, 4);
    assert_int_equal(f.unused_vertices, 4);
    assert_int_equal(f.components, 0);
    assert_false(f.watertight || f.manifold);
    f = examine(NULL, 0, 0);
    assert_int_equal(f.euler, 0);
}

/* A ring of n x m squares closed both ways: V - E + F = 0. */
static void torus_has_euler_number_zero(void **state) {
    (void)state;
    enum { N = 12, M = 7 };
    vec3 vertex[N * M];
    uint32_t t[2 * N * M][3];
    for (uint32_t i = 0; i < N; i++)
        for (uint32_t j = 0; j < M; j++) {
            double u = 2 * 3.14159265358979 * i / N, v = 2 * 3.14159265358979 * j / M;
            vertex[i * M + j] = (vec3){(3 + cos(v)) * cos(u), (3 + cos(v)) * sin(u), sin(v)};
            uint32_t a = i * M + j, b = (i + 1) % N * M + j, c = (i + 1) % N * M + (j + 1) % M, d = i * M + (j + 1) % M;
            memcpy(t[2 * a], (uint32_t[3]){a, b, c}, sizeof *t);
            memcpy(t[2 * a + 1], (uint32_t[3]){a, c, d}, sizeof *t);
        }
    struct mesh mesh = {.vertex_count = N * M, .vertex = vertex, .triangle_count = 2 * N * M, .triangle = t};
    struct mesh_facts f;
    assert_int_equal(mesh_examine(&mesh, &f), STATUS_OK);
    assert_int_equal(f.edges, 3 * N * M);
    assert_int_equal(f.euler, 0);
    assert_true(f.watertight && f.manifold && f.volume > 0);
}

static bool countdown(void *ctx) { return (*(int *)ctx)-- == 0; }

static void every_failing_allocation_is_survived(void **state) {
    (void)state;
    struct mesh mesh = {.vertex_count = 4, .vertex = corner, .triangle_count = 4, .triangle = tetrahedron};
    struct mesh_facts facts;
    memset(&facts, 0x5a, sizeof facts);
    struct mesh_facts untouched = facts;
    enum status status = STATUS_NO_MEMORY;
    int n = 0;
    for (; status == STATUS_NO_MEMORY && n < 100; n++) {
        assert_memory_equal(&facts, &untouched, sizeof facts);
        int left = n;
        alloc_fail = countdown;
        alloc_fail_ctx = &left;
        status = mesh_examine(&mesh, &facts);
        alloc_fail = NULL;
    }
    assert_int_equal(status, STATUS_OK);
    assert_true(n > 4);
}

/* ------------------------------------------------------------------------------------------------ as PLY */

static const char source_text[] = "ply\nformat ascii 1.0\ncomment source\nelement vertex 5\nproperty uchar tag\n"
                                  "property float y\nproperty float x\nproperty float z\nproperty list uchar int a\n"
                                  "property double w\nend_header\n1 0.1 0 0 0 0.5\n2 0 0.1 0 1 7 1.5\n3 0.3 0 0 0 2.5\n"
                                  "4 0 0 0.1 0 3.5\n5 9 9 9 0 4.5\n";

static struct cloud read_text(const char *text) {
    struct cloud cloud = {0};
    struct error error = {0};
    if (cloud_read_memory(text, strlen(text), NULL, NULL, &cloud, &error)) fail_msg("%s", error.text);
    return cloud;
}

static struct cloud rewrite(const struct mesh *mesh, const struct cloud *cloud, enum encoding encoding) {
    FILE *file = tmpfile();
    assert_non_null(file);
    struct cloud again = {0};
    struct error error = {0};
    assert_int_equal(mesh_write_ply(fileno(file), mesh, cloud, encoding, &error), STATUS_OK);
    rewind(file);
    if (cloud_read(fileno(file), NULL, NULL, &again, &error)) fail_msg("%s", error.text);
    fclose(file);
    return again;
}

/* A tetrahedron on points 3, 2, 1, 0 of the cloud. */
static struct mesh on_points(const struct cloud *cloud, vec3 vertex[4], uint32_t source[4]) {
    for (uint32_t i = 0; i < 4; i++) {
        source[i] = 3 - i;
        vertex[i] = cloud->position[3 - i];
    }
    return (struct mesh){
        .vertex_count = 4, .vertex = vertex, .source = source, .triangle_count = 4, .triangle = tetrahedron};
}

static void mesh_keeps_the_bytes_of_its_points(void **state) {
    (void)state;
    for (int encoding = ENCODING_BINARY; encoding <= ENCODING_ASCII; encoding++) {
        struct cloud cloud = read_text(source_text);
        vec3 vertex[4];
        uint32_t source[4];
        struct mesh mesh = on_points(&cloud, vertex, source);
        struct cloud again = rewrite(&mesh, &cloud, (enum encoding)encoding);
        assert_int_equal(again.property_count, 5); /* all but the list */
        assert_int_equal(again.record_bytes, cloud.record_bytes);
        assert_string_equal(again.comments, "comment source\n");
        for (uint32_t i = 0; i < 4; i++)
            assert_memory_equal(again.record + i * again.record_bytes, cloud.record + (3 - i) * cloud.record_bytes,
                                cloud.record_bytes);
        assert_int_equal(again.triangle_count, 4);
        assert_memory_equal(again.triangle, tetrahedron, sizeof tetrahedron);
        cloud_done(&again);
        cloud_done(&cloud);
    }
}

static void free_vertex_drops_attributes_and_keeps_the_type(void **state) {
    (void)state;
    struct cloud cloud = read_text(source_text);
    vec3 vertex[4];
    uint32_t source[4];
    struct mesh mesh = on_points(&cloud, vertex, source);
    source[1] = NONE;
    vertex[1] = (vec3){0.1, 0.2, 0.3};
    vertex[2].x = 0.7; /* moved away from its point */
    struct cloud again = rewrite(&mesh, &cloud, ENCODING_BINARY);
    assert_int_equal(again.property_count, 3);
    assert_int_equal(again.property[again.xyz[0]].type, SCALAR_FLOAT32);
    assert_true(again.position[1].x == (double)0.1f && again.position[2].x == (double)0.7f);
    assert_true(vec3_equal(again.position[0], cloud.position[3]));
    cloud_done(&again);
    cloud_done(&cloud);
}

static void integer_coordinates_widen_only_when_they_must(void **state) {
    (void)state;
    struct cloud cloud = read_text("ply\nformat ascii 1.0\nelement vertex 4\nproperty short x\nproperty short y\n"
                                   "property short z\nend_header\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n");
    vec3 vertex[4];
    uint32_t source[4];
    struct mesh mesh = on_points(&cloud, vertex, source);
    struct cloud again = rewrite(&mesh, &cloud, ENCODING_BINARY);
    assert_int_equal(again.property[0].type, SCALAR_INT16);
    cloud_done(&again);
    vertex[0].x = 0.25;
    again = rewrite(&mesh, &cloud, ENCODING_BINARY);
    assert_int_equal(again.property[0].type, SCALAR_FLOAT64);
    assert_true(again.position[0].x == 0.25 && vec3_equal(again.position[1], cloud.position[2]));
    cloud_done(&again);
    cloud_done(&cloud);
}

static void filled_holes_are_marked(void **state) {
    (void)state;
    uint8_t tag[4] = {MESH_SUPPORTED, MESH_HOLE_FILL, MESH_SUPPORTED, MESH_SUPPORTED};
    struct mesh mesh = {.vertex_count = 4, .vertex = corner, .triangle_count = 4, .triangle = tetrahedron, .tag = tag};
    FILE *file = tmpfile();
    assert_non_null(file);
    struct error error = {0};
    assert_int_equal(mesh_write_ply(fileno(file), &mesh, NULL, ENCODING_ASCII, &error), STATUS_OK);
    rewind(file);
    char text[1024] = "";
    assert_true(fread(text, 1, sizeof text - 1, file) > 0);
    assert_string_equal(text, "ply\nformat ascii 1.0\nelement vertex 4\nproperty double x\nproperty double y\n"
                              "property double z\nelement face 4\nproperty list uchar int vertex_indices\n"
                              "property uchar hole_fill\nend_header\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1 0\n3 0 1 3 1\n"
                              "3 0 3 2 0\n3 1 2 3 0\n");
    fclose(file);
    memset(tag, 0, sizeof tag);
    struct cloud again = rewrite(&mesh, NULL, ENCODING_BINARY);
    assert_int_equal(again.triangle_count, 4);
    cloud_done(&again);
}

/* ------------------------------------------------------------------------------------------------ files */

static int entries(const char *folder) {
    DIR *dir = opendir(folder);
    assert_non_null(dir);
    int n = 0;
    while (readdir(dir)) n++;
    closedir(dir);
    return n - 2;
}

static int in_new_folder(void **state) {
    char name[] = "/tmp/whittle-test-XXXXXX";
    if (!mkdtemp(name)) return -1;
    *state = strdup(name);
    return 0;
}

static int remove_folder(void **state) {
    char path[128];
    snprintf(path, sizeof path, "%s/out", (char *)*state);
    unlink(path);
    int result = rmdir(*state);
    free(*state);
    return result;
}

static void file_appears_at_commit_alone(void **state) {
    char path[128], text[8] = "";
    struct stat about;
    struct error error = {0};
    struct file_out file;
    snprintf(path, sizeof path, "%s/out", (char *)*state);
    assert_int_equal(file_out_begin(&file, path, &error), STATUS_OK);
    assert_int_equal(write(file.fd, "new", 3), 3);
    assert_int_not_equal(stat(path, &about), 0);
    assert_int_equal(entries(*state), 1);
    assert_int_equal(file_out_commit(&file, 1, &error), STATUS_OK);
    file_out_abort(&file); /* does nothing */
    assert_int_equal(entries(*state), 1);
    int fd = open(path, O_RDONLY);
    assert_int_equal(read(fd, text, sizeof text), 3);
    assert_string_equal(text, "new");
    close(fd);
}

/* The second one's name is that of a folder. */
static void files_get_their_names_in_their_order(void **state) {
    enum { FILES = 3 };
    char path[FILES][128];
    struct error error = {0};
    struct file_out file[FILES];
    struct stat about;
    for (int blocked = 0; blocked < 2; blocked++) {
        for (int i = 0; i < FILES; i++) {
            snprintf(path[i], sizeof path[i], "%s/%c", (char *)*state, 'a' + i);
            assert_int_equal(file_out_begin(&file[i], path[i], &error), STATUS_OK);
        }
        if (blocked) assert_int_equal(mkdir(path[1], 0700), 0);
        assert_int_equal(file_out_commit(file, FILES, &error), blocked ? STATUS_IO : STATUS_OK);
        for (int i = 0; i < FILES; i++) {
            bool there = stat(path[i], &about) == 0 && S_ISREG(about.st_mode);
            assert_int_equal(there, !blocked || i == 0);
            if (there) assert_int_equal(unlink(path[i]), 0);
        }
        assert_int_equal(entries(*state), blocked);
    }
    assert_int_equal(rmdir(path[1]), 0);
}

static void aborted_file_leaves_what_was_there(void **state) {
    char path[128];
    struct error error = {0};
    struct file_out file;
    struct stat about;
    snprintf(path, sizeof path, "%s/out", (char *)*state);
    close(open(path, O_CREAT | O_WRONLY, 0600));
    assert_int_equal(file_out_begin(&file, path, &error), STATUS_OK);
    assert_int_equal(write(file.fd, "new", 3), 3);
    file_out_abort(&file);
    assert_int_equal(entries(*state), 1);
    assert_int_equal(stat(path, &about), 0);
    assert_int_equal(about.st_size, 0);
}

static void file_out_tells_why_it_cannot(void **state) {
    char path[128];
    struct error error = {0};
    struct file_out file;
    snprintf(path, sizeof path, "%s/none/out", (char *)*state);
    assert_int_equal(file_out_begin(&file, path, &error), STATUS_IO);
    assert_non_null(strstr(error.text, "No such file"));
    file_out_abort(&file);
    snprintf(path, sizeof path, "%s/out", (char *)*state);
    for (int n = 0; n < 2; n++) {
        int left = n;
        alloc_fail = countdown;
        alloc_fail_ctx = &left;
        assert_int_equal(file_out_begin(&file, path, &error), STATUS_NO_MEMORY);
        alloc_fail = NULL;
    }
    assert_int_equal(entries(*state), 0);
    assert_int_equal(file_out_begin(&file, *state, &error), STATUS_OK); /* the name of a folder: fails at commit */
    assert_int_equal(file_out_commit(&file, 1, &error), STATUS_IO);
    assert_int_equal(entries(*state), 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(tetrahedron_is_watertight),
        cmocka_unit_test(inside_out_has_negative_volume),
        cmocka_unit_test(missing_triangle_leaves_a_boundary),
        cmocka_unit_test(turned_triangle_is_misoriented),
        cmocka_unit_test(three_triangles_at_an_edge_are_nonmanifold),
        cmocka_unit_test(two_fans_at_a_vertex_are_nonmanifold),
        cmocka_unit_test(separate_pieces_are_components),
        cmocka_unit_test(no_triangles_are_not_watertight),
        cmocka_unit_test(torus_has_euler_number_zero),
        cmocka_unit_test(every_failing_allocation_is_survived),
        cmocka_unit_test(mesh_keeps_the_bytes_of_its_points),
        cmocka_unit_test(free_vertex_drops_attributes_and_keeps_the_type),
        cmocka_unit_test(integer_coordinates_widen_only_when_they_must),
        cmocka_unit_test(filled_holes_are_marked),
        cmocka_unit_test_setup_teardown(file_appears_at_commit_alone, in_new_folder, remove_folder),
        cmocka_unit_test_setup_teardown(files_get_their_names_in_their_order, in_new_folder, remove_folder),
        cmocka_unit_test_setup_teardown(aborted_file_leaves_what_was_there, in_new_folder, remove_folder),
        cmocka_unit_test_setup_teardown(file_out_tells_why_it_cannot, in_new_folder, remove_folder),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
