/* Formats: files cut short anywhere, failing allocations, limits, and round trips attribute by attribute.  Single good
 * and bad files are folders under tests/fixtures.  Run from the root of the tree.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <dirent.h>
#include <jansson.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/io/codec/lzf.h"
#include "core/io/out/glb_write.h"
#include "core/io/out/las_write.h"
#include "core/io/out/obj_write.h"
#include "core/io/out/pcd_write.h"
#include "core/io/out/stl_write.h"
#include "core/io/out/write.h"
#include "core/io/read.h"

enum { PATH_BYTES = 700, MOST_CUTS = 1500, HEADER_BYTES = 256 };

struct file {
    unsigned char *bytes;
    size_t n;
};

static struct file load(FILE *from) {
    struct file file = {0};
    assert_non_null(from);
    assert_int_equal(fseek(from, 0, SEEK_END), 0);
    file.n = (size_t)ftell(from);
    file.bytes = malloc(file.n + 1);
    rewind(from);
    assert_int_equal(fread(file.bytes, 1, file.n, from), file.n);
    fclose(from);
    return file;
}

static bool is_new_format(const char *name) {
    static const char *const first[] = {"off", "obj", "stl", "pcd", "las", "laz", "glb", "gzip", "zstd"};
    for (size_t i = 0; i < sizeof first / sizeof *first; i++)
        if (strncmp(name, first[i], strlen(first[i])) == 0) return true;
    return false;
}

/* Calls check with the input of each valid fixture of these formats. */
static void each_fixture(void (*check)(const struct file *file)) {
    DIR *dir = opendir("tests/fixtures/valid");
    assert_non_null(dir);
    int cases = 0;
    for (struct dirent *entry; (entry = readdir(dir));) {
        char folder[PATH_BYTES], path[2 * PATH_BYTES] = "";
        if (!is_new_format(entry->d_name)) continue;
        snprintf(folder, sizeof folder, "tests/fixtures/valid/%s", entry->d_name);
        DIR *inner = opendir(folder);
        for (struct dirent *e; (e = readdir(inner));)
            if (strncmp(e->d_name, "input.", 6) == 0) snprintf(path, sizeof path, "%s/%s", folder, e->d_name);
        closedir(inner);
        struct file file = load(fopen(path, "rb"));
        check(&file);
        free(file.bytes);
        cases++;
    }
    closedir(dir);
    assert_true(cases >= 30);
}

/* ------------------------------------------------------------------------------------------------ hostile */

/* A copy of its own, so that a sanitizer sees a byte that is read beyond the end. */
static enum status read_copy(const unsigned char *bytes, size_t n, struct cloud *cloud, struct error *error) {
    unsigned char *copy = malloc(n ? n : 1);
    memcpy(copy, bytes, n);
    enum status status = cloud_read_memory(copy, n, NULL, NULL, cloud, error);
    free(copy);
    return status;
}

static void cut_everywhere(const struct file *file) {
    for (size_t n = 0; n < file->n && n < MOST_CUTS; n++) {
        struct cloud cloud = {0};
        struct error error = {0};
        enum status status = read_copy(file->bytes, n, &cloud, &error);
        assert_true(status == STATUS_OK ? cloud.count > 0 : error.code == status && error.text[0]);
        cloud_done(&cloud);
    }
}

static void files_cut_short_at_any_byte_are_told(void **state) {
    (void)state;
    each_fixture(cut_everywhere);
}

/* An emulator keeps memory for each reading: not every byte there. */
static size_t stride_of_bytes(void) { return getenv("WHITTLE_EMULATED") ? 16 : 1; }

/* Every value at every byte takes minutes under sanitizers and is for `make test-long`.  Else the values take turns:
 * half of them where headers are, one behind. */
static size_t turns_of_values(size_t i) { return getenv("WHITTLE_LONG") ? 1 : i < HEADER_BYTES ? 2 : 6; }

static void change_everywhere(const struct file *file) {
    static const unsigned char values[] = {0, 255, '\r', '-', '9', 0x80};
    for (size_t i = 0; i < file->n && i < MOST_CUTS; i += stride_of_bytes())
        for (size_t turns = turns_of_values(i), k = i % turns; k < sizeof values; k += turns) {
            struct cloud cloud = {0};
            struct error error = {0};
            unsigned char before = file->bytes[i];
            file->bytes[i] = values[k];
            enum status status = read_copy(file->bytes, file->n, &cloud, &error);
            file->bytes[i] = before;
            assert_true(status == STATUS_OK ? cloud.count > 0 : error.code == status);
            for (size_t t = 0; t < cloud.triangle_count; t++)
                for (int c = 0; c < 3; c++) assert_true(cloud.triangle[t][c] < cloud.count);
            cloud_done(&cloud);
        }
}

static void any_byte_may_be_wrong(void **state) {
    (void)state;
    each_fixture(change_everywhere);
}

static bool fail_at(void *ctx) {
    int *left = ctx;
    return (*left)-- == 0;
}

static void fail_everywhere(const struct file *file) {
    enum status status = STATUS_NO_MEMORY;
    for (int n = 0; status != STATUS_OK; n++) {
        struct cloud cloud = {0};
        struct error error = {0};
        int left = n;
        alloc_fail = fail_at;
        alloc_fail_ctx = &left;
        status = cloud_read_memory(file->bytes, file->n, NULL, NULL, &cloud, &error);
        alloc_fail = NULL;
        assert_true(status == STATUS_OK || status == STATUS_NO_MEMORY);
        cloud_done(&cloud);
        assert_true(n < 200);
    }
}

static void any_allocation_may_fail(void **state) {
    (void)state;
    each_fixture(fail_everywhere);
}

static void limit_everywhere(const struct file *file) {
    struct cloud cloud = {0};
    struct error error = {0};
    struct cloud_limits limits = {0};
    assert_int_equal(cloud_read_memory(file->bytes, file->n, NULL, NULL, &cloud, &error), STATUS_OK);
    size_t count = cloud.count, properties = cloud.property_count;
    bool leaves_out = cloud.left_out && strstr(cloud.left_out, "without a position");
    cloud_done(&cloud);
    limits = (struct cloud_limits){.max_points = count, .max_properties = (uint32_t)properties};
    if (!leaves_out) {
        assert_int_equal(cloud_read_memory(file->bytes, file->n, &limits, NULL, &cloud, &error), STATUS_OK);
        cloud_done(&cloud);
    }
    limits.max_points--;
    if (count > 1)
        assert_int_equal(cloud_read_memory(file->bytes, file->n, &limits, NULL, &cloud, &error), STATUS_LIMIT);
    limits = (struct cloud_limits){.max_properties = (uint32_t)properties - 1};
    assert_int_equal(cloud_read_memory(file->bytes, file->n, &limits, NULL, &cloud, &error), STATUS_LIMIT);
}

static void limits_hold_to_the_point(void **state) {
    (void)state;
    each_fixture(limit_everywhere);
}

/* A binary glTF without a binary part. */
static struct file glb_of(const char *first, const char *repeated, size_t times, const char *last) {
    enum { BEFORE = 20 };
    size_t head = strlen(first), each = strlen(repeated), tail = strlen(last), json = head + times * each + tail;
    struct file file = {malloc(BEFORE + json), BEFORE + json};
    const uint32_t words[] = {0x46546c67, 2, (uint32_t)file.n, (uint32_t)json, 0x4e4f534a};
    memcpy(file.bytes, words, BEFORE);
    memcpy(file.bytes + BEFORE, first, head);
    for (size_t i = 0; i < times; i++) memcpy(file.bytes + BEFORE + head + i * each, repeated, each);
    memcpy(file.bytes + file.n - tail, last, tail);
    return file;
}

static size_t json_room, json_used;

static void *json_allocate(size_t bytes) {
    if (json_used + bytes > json_room) return NULL;
    json_used += bytes;
    return malloc(bytes);
}

/* Nothing is given back, so that what is taken in all is counted. */
static void json_free(void *memory) { free(memory); }

/* What is nested takes eighty times its text. */
static void a_scene_of_millions_of_parts_is_refused_before_it_takes_memory(void **state) {
    (void)state;
    static const char *const parts[][2] = {{"{},", "{}]}"}, {"[],", "[]]}"}, {"0,", "0]}"}, {"\"\",", "0]}"}};
    json_room = SIZE_MAX, json_used = 0;
    json_set_alloc_funcs(json_allocate, json_free);
    for (size_t i = 0; i < sizeof parts / sizeof *parts; i++) {
        struct cloud cloud = {0};
        struct error error = {0};
        struct file many = glb_of("{\"nodes\":[", parts[i][0], 12000000, parts[i][1]);
        assert_int_equal(cloud_read_memory(many.bytes, many.n, NULL, NULL, &cloud, &error), STATUS_LIMIT);
        assert_string_equal(error.where, "JSON");
        assert_int_equal(json_used, 0);
        free(many.bytes);
        struct file few =
            glb_of("{\"nodes\":[", parts[i][0], 50000, parts[i][1]); /* and what isn't, keeps to 240 a part */
        assert_int_equal(cloud_read_memory(few.bytes, few.n, NULL, NULL, &cloud, &error), STATUS_MALFORMED);
        assert_in_range(json_used, 50000, 50000 * 300);
        json_used = 0;
        free(few.bytes);
    }
    json_set_alloc_funcs(malloc, free);
}

static void a_scene_for_which_memory_runs_out_is_no_other_one(void **state) {
    (void)state;
    struct file file = load(fopen("tests/fixtures/valid/glb-all-attributes/input.glb", "rb"));
    json_set_alloc_funcs(json_allocate, json_free);
    enum status status = STATUS_NO_MEMORY;
    for (json_room = 0; status; json_room += 64) {
        struct cloud cloud = {0};
        struct error error = {0};
        json_used = 0;
        status = cloud_read_memory(file.bytes, file.n, NULL, NULL, &cloud, &error);
        if (!status) assert_true(cloud.property_count >= 10);
        cloud_done(&cloud);
        assert_true(json_room < 1 << 20);
    }
    assert_true(json_room > 4096);
    json_set_alloc_funcs(malloc, free);
    free(file.bytes);
}

static void lzf_takes_and_makes_exactly_what_is_there(void **state) {
    (void)state;
    char to[16];
    assert_true(lzf_decompress("\x02"
                               "abc"
                               "\x20\x02",
                               6, to, 6));
    assert_memory_equal(to, "abcabc", 6);
    assert_true(lzf_decompress("\x00"
                               "a"
                               "\xe0\x03\x00",
                               5, to, 13)); /* a copy that reads what it writes */
    assert_memory_equal(to, "aaaaaaaaaaaaa", 13);
    assert_false(lzf_decompress("\x02"
                                "abc"
                                "\x20\x02",
                                6, to, 5));
    assert_false(lzf_decompress("\x02"
                                "abc"
                                "\x20\x02",
                                6, to, 7));
    assert_false(lzf_decompress("\x02"
                                "abc"
                                "\x20\x03",
                                6, to, 6)); /* from before the beginning */
    assert_false(lzf_decompress("\x02"
                                "ab",
                                3, to, 3));
    assert_false(lzf_decompress("\x00"
                                "a"
                                "\xe0",
                                3, to, 10));
    assert_true(lzf_decompress("", 0, to, 0));
}

/* ------------------------------------------------------------------------------------------------ round trips */

static const char every_type[] =
    "ply\nformat ascii 1.0\ncomment viewpoint 1 2 3 0.5 0.5 0.5 0.5\ncomment hello\nelement vertex 4\n"
    "property float x\nproperty float y\nproperty float z\nproperty float nx\nproperty float ny\nproperty float nz\n"
    "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar alpha\n"
    "property char c\nproperty uchar uc\nproperty short s\nproperty ushort us\nproperty int i\nproperty uint ui\n"
    "property float f\nproperty double d\nproperty list uchar int l\nend_header\n"
    "0.1 0 0 0 0 1 1 2 3 4 -128 255 -32768 65535 -2147483648 4294967295 0.3 0.1 1 5\n"
    "1 0.2 0 0 1 0 255 254 253 252 127 0 32767 0 2147483647 0 -inf 1e300 0\n"
    "0 1 0.3 1 0 0 0 0 0 0 0 0 0 0 0 0 nan nan 2 7 8\n"
    "0 0 1 0.6 0.8 0 9 8 7 6 1 2 3 4 5 6 7 8 0\n";

static struct cloud read_text(const char *text) {
    struct cloud cloud = {0};
    struct error error = {0};
    if (cloud_read_memory(text, strlen(text), NULL, NULL, &cloud, &error)) fail_msg("%s", error.text);
    return cloud;
}

static struct cloud read_file(FILE *file) {
    struct cloud cloud = {0};
    struct error error = {0};
    rewind(file);
    if (cloud_read(fileno(file), NULL, NULL, &cloud, &error)) fail_msg("line %d: %s", (int)error.line, error.text);
    return cloud;
}

static const struct property *find(const struct cloud *cloud, const char *name) {
    for (size_t j = 0; j < cloud->property_count; j++)
        if (strcmp(cloud->property[j].name, name) == 0) return &cloud->property[j];
    return NULL;
}

/* All scalar properties of a are in b, with the same type and bits. */
static void check_all_kept(const struct cloud *a, const struct cloud *b) {
    assert_int_equal(a->count, b->count);
    for (size_t j = 0; j < a->property_count; j++) {
        const struct property *p = &a->property[j], *q = find(b, p->name);
        if (p->is_list) continue;
        if (!q) fail_msg("%s is gone", p->name);
        assert_int_equal(p->type, q->type);
        for (size_t i = 0; i < a->count; i++)
            assert_memory_equal(a->record + i * a->record_bytes + p->offset_bytes,
                                b->record + i * b->record_bytes + q->offset_bytes, scalar_bytes(p->type));
    }
}

static void pcd_keeps_every_scalar_bit_for_bit(void **state) {
    (void)state;
    struct cloud cloud = read_text(every_type);
    struct left_out left_out = {0};
    FILE *file = tmpfile();
    assert_int_equal(cloud_write_pcd(fileno(file), &cloud, NULL, cloud.count, PCD_DOUBLE, &left_out, NULL), STATUS_OK);
    struct cloud again = read_file(file);
    assert_string_equal(again.form, "pcd/binary");
    check_all_kept(&cloud, &again);
    assert_int_equal(again.property_count, cloud.property_count - 1);
    assert_int_equal(left_out.count, 1);
    assert_non_null(strstr(left_out.loss[0].what, "l: "));
    assert_non_null(strstr(again.comments, "comment viewpoint 1 2 3 0.5 0.5 0.5 0.5\n"));
    assert_non_null(strstr(again.comments, "comment hello\n"));
    fclose(file);
    cloud_done(&cloud), cloud_done(&again);
}

/* A survey: coordinates far from 0 in double, normals and a time that needs double, intensity, a viewpoint. */
static const char survey[] =
    "ply\nformat ascii 1.0\ncomment viewpoint 389000 5820010 2 1 0 0 0\nelement vertex 3\nproperty double x\n"
    "property double y\nproperty double z\nproperty double nx\nproperty double ny\nproperty double nz\n"
    "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty ushort intensity\n"
    "property double gps_time\nend_header\n389123.456 5820001.5 34.25 0 0 1 1 2 3 65535 123456789.123\n"
    "389223.457 5820051.25 44.5 0.6 0.8 0 4 5 6 0 1\n389173.5 5820101.125 54 1 0 0 7 8 9 17 2\n";

static const char *header_of(FILE *file) {
    static char text[2048];
    rewind(file);
    text[fread(text, 1, sizeof text - 1, file)] = '\0';
    return text;
}

static void pcd_of_floats_is_around_an_origin_that_is_told(void **state) {
    (void)state;
    struct cloud cloud = read_text(survey);
    struct left_out left_out = {0};
    FILE *file = tmpfile();
    assert_int_equal(cloud_write_pcd(fileno(file), &cloud, NULL, 3, PCD_FLOAT, &left_out, NULL), STATUS_OK);
    const char *header = header_of(file);
    assert_non_null(strstr(header, "# origin 389200 5820100 0 is to be added to x y z\n"));
    assert_non_null(strstr(header, "\nFIELDS x y z normal_x normal_y normal_z rgb intensity gps_time\n"
                                   "SIZE 4 4 4 4 4 4 4 4 8\nTYPE F F F F F F F F F\n"));
    assert_non_null(strstr(header, "\nVIEWPOINT -200 -90 2 1 0 0 0\n"));
    struct cloud again = read_file(file);
    double worst = 0;
    for (size_t i = 0; i < 3; i++)
        for (int axis = 0; axis < 3; axis++)
            worst = fmax(worst, fabs((&again.position[i].x)[axis] - (&cloud.position[i].x)[axis]));
    assert_true(worst > 0 && worst < 1e-5);
    char told[LEFT_OUT_TEXT_BYTES];
    snprintf(told, sizeof told,
             "precision: x, y, z are float32 around 389200 5820100 0, off by up to %.2g (pcd_precision=double)", worst);
    assert_int_equal(left_out.count, 3);
    assert_string_equal(left_out.loss[0].what, "normal_x is float32, off by up to 2.4e-08");
    assert_non_null(strstr(left_out.loss[1].what, "normal_y"));
    assert_string_equal(left_out.loss[2].what, told);
    assert_int_equal(again.property[again.xyz[0]].type, SCALAR_FLOAT64);
    assert_int_equal(find(&again, "gps_time")->type, SCALAR_FLOAT64);
    assert_int_equal(find(&again, "red")->type, SCALAR_UINT8);
    assert_non_null(strstr(again.comments, "comment viewpoint 389000 5820010 2 1 0 0 0\n"));
    assert_null(strstr(again.comments, "origin"));
    fclose(file);
    cloud_done(&cloud), cloud_done(&again);
}

/* What float32 holds anyway stays where it is, and nothing is told; small coordinates need no origin. */
static void pcd_of_floats_moves_only_what_lies_far_away(void **state) {
    (void)state;
    static const char *const texts[] = {"5000000.5 1 2\n5000001 4 5\n", "0.1 0.2 0.3\n0.4 0.5 0.6\n"};
    for (int k = 0; k < 2; k++) {
        struct cloud cloud = read_text(texts[k]);
        struct left_out left_out = {0};
        FILE *file = tmpfile();
        assert_int_equal(cloud_write_pcd(fileno(file), &cloud, NULL, 2, PCD_FLOAT, &left_out, NULL), STATUS_OK);
        assert_null(strstr(header_of(file), "# origin"));
        assert_non_null(strstr(header_of(file), "\nSIZE 4 4 4\n"));
        assert_int_equal(left_out.count, k);
        if (k)
            assert_string_equal(left_out.loss[0].what,
                                "precision: x, y, z are float32 around 0 0 0, off by up to 2.4e-08 "
                                "(pcd_precision=double)");
        struct cloud again = read_file(file);
        assert_int_equal(again.property[0].type, SCALAR_FLOAT32);
        fclose(file);
        cloud_done(&cloud), cloud_done(&again);
    }
}

static void pcd_of_some_points_is_in_their_order(void **state) {
    (void)state;
    struct cloud cloud =
        read_text("ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\nproperty double y\n"
                  "property double z\nproperty ushort red\nproperty ushort green\nproperty ushort blue\n"
                  "end_header\n1 2 3 7 8 9\n4 5 6 10 11 12\n7 8 9 65535 1 0\n");
    FILE *file = tmpfile();
    assert_int_equal(cloud_write_pcd(fileno(file), &cloud, (const uint32_t[]){2, 0}, 2, PCD_DOUBLE, NULL, NULL),
                     STATUS_OK);
    struct cloud again = read_file(file);
    assert_int_equal(again.count, 2);
    assert_true(again.position[0].x == 7 && again.position[1].z == 3);
    assert_int_equal(find(&again, "red")->type, SCALAR_UINT16); /* isn't packed: it would lose bits */
    fclose(file);
    cloud_done(&cloud), cloud_done(&again);
}

static void read_valid_as(const struct file *file) {
    struct cloud cloud = {0};
    struct error error = {0};
    assert_int_equal(cloud_read_memory(file->bytes, file->n, NULL, NULL, &cloud, &error), STATUS_OK);
    FILE *out = tmpfile();
    assert_int_equal(cloud_write_pcd(fileno(out), &cloud, NULL, cloud.count, PCD_DOUBLE, NULL, &error), STATUS_OK);
    struct cloud again = read_file(out);
    check_all_kept(&cloud, &again);
    fclose(out);
    cloud_done(&cloud), cloud_done(&again);
}

static void what_any_format_gives_pcd_holds(void **state) {
    (void)state;
    each_fixture(read_valid_as);
}

/* ------------------------------------------------------------------------------------------------ meshes */

static const uint32_t tetrahedron[4][3] = {{0, 2, 1}, {0, 1, 3}, {1, 2, 3}, {0, 3, 2}};

/* The cloud's points as the vertices of a tetrahedron. */
static struct mesh mesh_of(const struct cloud *cloud, uint32_t source[4]) {
    for (uint32_t i = 0; i < 4; i++) source[i] = i;
    return (struct mesh){.vertex_count = 4,
                         .vertex = cloud->position,
                         .source = source,
                         .triangle_count = 4,
                         .triangle = (uint32_t(*)[3])(uintptr_t)tetrahedron};
}

static void obj_keeps_positions_normals_and_colours(void **state) {
    (void)state;
    struct cloud cloud = read_text(every_type);
    uint32_t source[4];
    struct mesh mesh = mesh_of(&cloud, source);
    struct left_out left_out = {0};
    FILE *file = tmpfile();
    assert_int_equal(mesh_write_obj(fileno(file), &mesh, &cloud, &left_out, NULL), STATUS_OK);
    struct cloud again = read_file(file);
    assert_int_equal(again.count, 4);
    assert_int_equal(again.triangle_count, 4);
    assert_memory_equal(again.triangle, tetrahedron, sizeof tetrahedron);
    static const char *const same[] = {"x", "y", "z", "nx", "ny", "nz"};
    for (size_t i = 0; i < 4; i++) {
        const unsigned char *a = cloud.record + i * cloud.record_bytes, *b = again.record + i * again.record_bytes;
        for (int k = 0; k < 6; k++) {
            float before, after = (float)scalar_load(b + find(&again, same[k])->offset_bytes, SCALAR_FLOAT64);
            memcpy(&before, a + find(&cloud, same[k])->offset_bytes, sizeof before);
            assert_memory_equal(&before, &after, sizeof before);
        }
        double red = scalar_load(b + find(&again, "red")->offset_bytes, SCALAR_FLOAT64);
        assert_int_equal(lround(red * 255), a[find(&cloud, "red")->offset_bytes]);
    }
    assert_int_equal(left_out.count, 1);
    assert_non_null(strstr(left_out.loss[0].what, "alpha, c, uc"));
    fclose(file);
    cloud_done(&cloud), cloud_done(&again);
}

static void obj_of_doubles_reads_back_to_the_bit(void **state) {
    (void)state;
    struct cloud cloud = read_text("0.1 1e6 3\n1000000.123456789 2 3\n5 1 0.3\n1 2 9\n");
    uint32_t source[4];
    struct mesh mesh = mesh_of(&cloud, source);
    mesh.source = NULL;
    FILE *file = tmpfile();
    assert_int_equal(mesh_write_obj(fileno(file), &mesh, &cloud, NULL, NULL), STATUS_OK);
    struct cloud again = read_file(file);
    assert_memory_equal(again.position, cloud.position, 4 * sizeof *cloud.position);
    fclose(file);
    cloud_done(&cloud), cloud_done(&again);
}

static void obj_groups_fills_of_holes(void **state) {
    (void)state;
    struct cloud cloud = read_text("0 0 0\n1 0 0\n0 1 0\n0 0 1\n");
    uint32_t source[4];
    uint8_t tag[4] = {0, 0, MESH_HOLE_FILL, 0};
    struct mesh mesh = mesh_of(&cloud, source);
    mesh.tag = tag;
    FILE *file = tmpfile();
    assert_int_equal(mesh_write_obj(fileno(file), &mesh, &cloud, NULL, NULL), STATUS_OK);
    rewind(file);
    struct file written = load(file);
    written.bytes[written.n] = 0;
    assert_non_null(strstr((char *)written.bytes, "g hole_fill\nf 2 3 4\ng surface\nf 1 4 3\n"));
    free(written.bytes);
    cloud_done(&cloud);
}

static void stl_keeps_triangles_and_says_what_it_rounds(void **state) {
    (void)state;
    struct cloud cloud = read_text("0 0 0\n1 0 0\n0 1 0\n0 0 1\n");
    uint32_t source[4];
    struct mesh mesh = mesh_of(&cloud, source);
    struct left_out left_out = {0};
    FILE *file = tmpfile();
    assert_int_equal(mesh_write_stl(fileno(file), &mesh, &cloud, &left_out, NULL), STATUS_OK);
    assert_int_equal(left_out.count, 0);
    struct cloud again = read_file(file);
    assert_string_equal(again.form, "stl/binary");
    assert_int_equal(again.count, 4);
    assert_int_equal(again.triangle_count, 4);
    for (size_t t = 0; t < 4; t++)
        for (int k = 0; k < 3; k++)
            assert_true(vec3_equal(again.position[again.triangle[t][k]], cloud.position[tetrahedron[t][k]]));
    fclose(file);
    cloud.position[3].z = 0.1;
    file = tmpfile();
    assert_int_equal(mesh_write_stl(fileno(file), &mesh, &cloud, &left_out, NULL), STATUS_OK);
    assert_int_equal(left_out.count, 1);
    assert_non_null(strstr(left_out.loss[0].what, "precision"));
    fclose(file);
    cloud_done(&cloud), cloud_done(&again);
}

static uint32_t u32_at(const struct file *file, size_t at) {
    uint32_t value;
    assert_true(at + 4 <= file->n);
    memcpy(&value, file->bytes + at, 4);
    return value;
}

/* The chunks' lengths agree with the file; the JSON is ended by a NUL in place. */
static const char *check_glb(struct file *file, size_t *binary) {
    assert_memory_equal(file->bytes, "glTF", 4);
    assert_int_equal(u32_at(file, 4), 2);
    assert_int_equal(u32_at(file, 8), file->n);
    size_t json = u32_at(file, 12);
    assert_memory_equal(file->bytes + 16, "JSON", 4);
    assert_int_equal(json % 4, 0);
    assert_int_equal(20 + json + 8 + u32_at(file, 20 + json), file->n);
    assert_memory_equal(file->bytes + 24 + json, "BIN\0", 4);
    *binary = 28 + json;
    file->bytes[20 + json] = 0;
    return (const char *)file->bytes + 20;
}

static void glb_holds_positions_attributes_and_indices(void **state) {
    (void)state;
    struct cloud cloud = read_text(every_type);
    uint32_t source[4];
    struct mesh mesh = mesh_of(&cloud, source);
    struct left_out left_out = {0};
    FILE *out = tmpfile();
    size_t binary;
    assert_int_equal(mesh_write_glb(fileno(out), &mesh, &cloud, &(struct glb_packing){0}, UP_Y, &left_out, NULL),
                     STATUS_OK);
    struct file file = load(out);
    const char *json = check_glb(&file, &binary);
    assert_null(strstr(json, "translation")); /* all are float32 */
    static const char *const names[] = {"\"POSITION\":0", "\"NORMAL\":1", "\"COLOR_0\":2", "\"_C\":3", "\"_F\":7"};
    for (size_t i = 0; i < 5; i++) assert_non_null(strstr(json, names[i]));
    for (size_t i = 0; i < 4; i++) {
        float position[3], normal[3];
        memcpy(position, file.bytes + binary + 12 * i, sizeof position);
        memcpy(normal, file.bytes + binary + 48 + 12 * i, sizeof normal);
        assert_memory_equal(position, cloud.record + i * cloud.record_bytes, sizeof position);
        assert_memory_equal(normal, cloud.record + i * cloud.record_bytes + 12, sizeof normal);
    }
    assert_memory_equal(file.bytes + file.n - sizeof tetrahedron, tetrahedron, sizeof tetrahedron);
    assert_non_null(strstr(left_out.loss[0].what, "i, ui, d, l"));
    free(file.bytes);
    cloud_done(&cloud);
}

static void glb_of_large_coordinates_is_moved(void **state) {
    (void)state;
    struct cloud cloud = read_text("5000000.25 0.1 0\n5000001.75 0 0\n5000001 1 0\n5000001 0 1\n");
    uint32_t source[4];
    struct mesh mesh = mesh_of(&cloud, source);
    FILE *out = tmpfile();
    size_t binary;
    float position[3];
    struct left_out left_out = {0};
    assert_int_equal(mesh_write_glb(fileno(out), &mesh, &cloud, &(struct glb_packing){0}, UP_Y, &left_out, NULL),
                     STATUS_OK);
    assert_int_equal(left_out.count, 1);
    assert_string_equal(left_out.loss[0].what,
                        "precision: coordinates are float32 around 5000001 0.5 0.5, off by up to 6e-09");
    left_out.count = 0;
    FILE *stl = tmpfile();
    assert_int_equal(mesh_write_stl(fileno(stl), &mesh, &cloud, &left_out, NULL), STATUS_OK);
    assert_string_equal(left_out.loss[0].what, LEFT_OUT_WARNING
                        "coordinates are float32 around 5000001 0 0, to be added; off by up to 1.5e-09");
    fclose(stl);
    struct file file = load(out);
    const char *json = check_glb(&file, &binary);
    assert_non_null(strstr(json, "\"translation\":[5000001,0.5,0.5]"));
    memcpy(position, file.bytes + binary, sizeof position);
    assert_true(position[0] == -0.75f && position[1] == -0.4f && position[2] == -0.5f);
    free(file.bytes);
    cloud_done(&cloud);
}

/* Whatever a cloud was read from, LAS and LAZ of it have the same points, also where memory runs out somewhere before.
 */
static void las_everywhere(const struct file *file) {
    struct cloud cloud = {0}, again[2] = {{0}};
    assert_int_equal(cloud_read_memory(file->bytes, file->n, NULL, NULL, &cloud, NULL), STATUS_OK);
    for (int compressed = 0; compressed < 2; compressed++) {
        enum status status = STATUS_NO_MEMORY;
        for (int n = 0; status != STATUS_OK; n++) {
            int fd = memfd_create("las", 0), left = n;
            assert_true(fd >= 0 && n < 100);
            alloc_fail = fail_at;
            alloc_fail_ctx = &left;
            status = cloud_write_las(fd, &cloud, NULL, cloud.count, compressed, 1, NULL, NULL);
            alloc_fail = NULL;
            assert_true(status == STATUS_OK || status == STATUS_NO_MEMORY);
            assert_int_equal(lseek(fd, 0, SEEK_SET), 0);
            if (status == STATUS_OK) assert_int_equal(cloud_read(fd, NULL, NULL, &again[compressed], NULL), STATUS_OK);
            close(fd);
        }
    }
    assert_int_equal(again[0].count, cloud.count);
    assert_int_equal(again[1].count, cloud.count);
    assert_memory_equal(again[0].record, again[1].record, cloud.count * again[0].record_bytes);
    for (size_t i = 0; cloud.las && i < cloud.count; i++)
        assert_memory_equal(&again[0].position[i], &cloud.position[i], sizeof *cloud.position);
    cloud_done(&cloud), cloud_done(&again[0]), cloud_done(&again[1]);
}

static void what_any_format_gives_las_holds(void **state) {
    (void)state;
    each_fixture(las_everywhere);
}

static void a_full_disk_is_told_by_all_writers(void **state) {
    (void)state;
    FILE *full = fopen("/dev/full", "w");
    assert_non_null(full);
    struct cloud cloud = read_text(every_type);
    uint32_t source[4];
    struct mesh mesh = mesh_of(&cloud, source);
    int fd = fileno(full);
    struct error error;
    assert_int_not_equal(cloud_write_pcd(fd, &cloud, NULL, 4, PCD_FLOAT, NULL, &error), STATUS_OK);
    assert_int_not_equal(mesh_write_obj(fd, &mesh, &cloud, NULL, &error), STATUS_OK);
    assert_int_not_equal(mesh_write_stl(fd, &mesh, &cloud, NULL, &error), STATUS_OK);
    assert_int_not_equal(mesh_write_glb(fd, &mesh, &cloud, &(struct glb_packing){0}, UP_Z, NULL, &error), STATUS_OK);
    for (int compressed = 0; compressed < 2; compressed++)
        assert_int_not_equal(cloud_write_las(fd, &cloud, NULL, 4, compressed, 1, NULL, &error), STATUS_OK);
    fclose(full);
    cloud_done(&cloud);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(files_cut_short_at_any_byte_are_told),
                                       cmocka_unit_test(any_byte_may_be_wrong),
                                       cmocka_unit_test(any_allocation_may_fail),
                                       cmocka_unit_test(limits_hold_to_the_point),
                                       cmocka_unit_test(a_scene_of_millions_of_parts_is_refused_before_it_takes_memory),
                                       cmocka_unit_test(a_scene_for_which_memory_runs_out_is_no_other_one),
                                       cmocka_unit_test(lzf_takes_and_makes_exactly_what_is_there),
                                       cmocka_unit_test(pcd_keeps_every_scalar_bit_for_bit),
                                       cmocka_unit_test(pcd_of_floats_is_around_an_origin_that_is_told),
                                       cmocka_unit_test(pcd_of_floats_moves_only_what_lies_far_away),
                                       cmocka_unit_test(pcd_of_some_points_is_in_their_order),
                                       cmocka_unit_test(what_any_format_gives_pcd_holds),
                                       cmocka_unit_test(obj_keeps_positions_normals_and_colours),
                                       cmocka_unit_test(obj_of_doubles_reads_back_to_the_bit),
                                       cmocka_unit_test(obj_groups_fills_of_holes),
                                       cmocka_unit_test(stl_keeps_triangles_and_says_what_it_rounds),
                                       cmocka_unit_test(glb_holds_positions_attributes_and_indices),
                                       cmocka_unit_test(glb_of_large_coordinates_is_moved),
                                       cmocka_unit_test(what_any_format_gives_las_holds),
                                       cmocka_unit_test(a_full_disk_is_told_by_all_writers)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
