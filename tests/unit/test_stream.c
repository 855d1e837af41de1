/* Clouds read part by part are the clouds that are read whole.
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
#include <zlib.h>

#include "core/base/alloc.h"
#include "core/io/out/las_write.h"
#include "core/io/out/pcd_write.h"
#include "core/io/out/write.h"
#include "core/io/read.h"
#include "core/io/stream.h"
#include "tests/unit/folder.h"
#include "tests/unit/shapes.h"

enum { PATH_BYTES = 512, POINTS = 600000, FOLDER_BYTES = 256 };

static char folder[PATH_BYTES];

/* What was told of a whole file is told of its parts; of points without a position there are numbers, and triangles
 * aren't taken. */
static void check_notes(const char *of_parts, const struct cloud *whole) {
    char note[PATH_BYTES];
    for (const char *at = whole->left_out; at && *at; at += strcspn(at, "\n") + 1) {
        snprintf(note, sizeof note, "%.*s", (int)strcspn(at, "\n"), at);
        if (strstr(note, "without a position") || strstr(note, "triangle")) continue;
        if (!of_parts || !strstr(of_parts, note)) fail_msg("\"%s\" isn't told of parts", note);
    }
}

/* Reads the files part by part and compares with the clouds, one after the other; returns how many parts there were. */
static size_t check_parts(const char *const *path, size_t files, const struct cloud *const *whole) {
    const struct cloud_limits limits = {.scratch = folder};
    struct cloud_stream *stream = NULL;
    const struct cloud *part;
    size_t parts = 0, file = 0, at = 0;
    struct error error = {0};
    assert_int_equal(cloud_stream_open(path, files, &limits, &stream, &error), STATUS_OK);
    assert_int_equal(cloud_stream_cloud(stream)->property_count, whole[0]->property_count);
    assert_string_equal(cloud_stream_cloud(stream)->form, whole[0]->form);
    for (;; parts++) {
        assert_int_equal(cloud_stream_next(stream, &part, &error), STATUS_OK);
        if (part->count == 0) break;
        if (at == whole[file]->count) file++, at = 0;
        assert_true(file < files && at + part->count <= whole[file]->count);
        assert_int_equal(part->record_bytes, whole[file]->record_bytes);
        assert_memory_equal(part->record, whole[file]->record + at * part->record_bytes,
                            part->count * part->record_bytes);
        assert_memory_equal(part->position, whole[file]->position + at, part->count * sizeof *part->position);
        at += part->count;
    }
    assert_int_equal(file, files - 1);
    assert_int_equal(at, whole[file]->count);
    assert_true(cloud_stream_fraction(stream) > 0);
    for (size_t i = 0; i < files; i++) check_notes(cloud_stream_left_out(stream), whole[i]);
    cloud_stream_free(stream);
    return parts;
}

static struct cloud make_cloud(void) {
    static const char header[] = "ply\nformat binary_little_endian 1.0\nelement vertex 600000\nproperty float x\n"
                                 "property float y\nproperty float z\nproperty ushort intensity\nend_header\n";
    struct cloud cloud = {0};
    struct error error = {0};
    uint64_t seed = 5;
    size_t head = strlen(header), each = 14;
    unsigned char *bytes = alloc_array(head + POINTS * each, 1);
    assert_non_null(bytes);
    memcpy(bytes, header, head);
    for (size_t i = 0; i < POINTS; i++) {
        float p[3];
        uint16_t intensity = (uint16_t)random_next(&seed);
        for (int axis = 0; axis < 3; axis++) p[axis] = (float)(0.001 * floor(1e6 * random_unit(&seed)));
        memcpy(bytes + head + i * each, p, sizeof p);
        memcpy(bytes + head + i * each + sizeof p, &intensity, sizeof intensity);
    }
    assert_int_equal(cloud_read_memory(bytes, head + POINTS * each, NULL, NULL, &cloud, &error), STATUS_OK);
    free(bytes);
    return cloud;
}

static void write_as(const struct cloud *cloud, const char *name, char path[PATH_BYTES]) {
    struct error error = {0};
    enum status status = STATUS_OK;
    snprintf(path, PATH_BYTES, "%.300s/%s", folder, name);
    int fd = open(path, O_RDWR | O_CREAT | O_TRUNC, 0600);
    assert_true(fd >= 0);
    if (strstr(name, ".las") || strstr(name, ".laz"))
        status = cloud_write_las(fd, cloud, NULL, cloud->count, strstr(name, ".laz"), 0, NULL, &error);
    else if (strstr(name, ".pcd"))
        status = cloud_write_pcd(fd, cloud, NULL, cloud->count, PCD_DOUBLE, NULL, &error);
    else if (strstr(name, ".xyz"))
        status = cloud_write_xyz(fd, cloud, NULL, cloud->count, HEADER_PLAIN, &error);
    else
        status = cloud_write_ply(fd, cloud, NULL, cloud->count,
                                 strstr(name, "ascii") ? ENCODING_ASCII : ENCODING_BINARY, &error);
    assert_int_equal(status, STATUS_OK);
    close(fd);
}

/* By zlib's own writer. */
static void gzip_it(const char *path) {
    char packed[PATH_BYTES + 8];
    static unsigned char piece[1 << 16];
    snprintf(packed, sizeof packed, "%s.new", path);
    FILE *from = fopen(path, "rb");
    gzFile to = gzopen(packed, "wb1");
    assert_true(from && to);
    for (size_t n; (n = fread(piece, 1, sizeof piece, from)) > 0;)
        assert_int_equal(gzwrite(to, piece, (unsigned)n), (int)n);
    assert_int_equal(fclose(from), 0);
    assert_int_equal(gzclose(to), Z_OK);
    assert_int_equal(rename(packed, path), 0);
}

static uint64_t bytes_of(const char *path) {
    struct stat about;
    assert_int_equal(stat(path, &about), 0);
    return (uint64_t)about.st_size;
}

/* What lies beside the files while they are read: the first one, and the one after it. */
static void expect_unpacked(const char *const *path, size_t files, uint64_t bytes) {
    const struct cloud_limits limits = {.scratch = folder};
    struct cloud_stream *stream;
    const struct cloud *part;
    struct error error;
    assert_int_equal(cloud_stream_open(path, files, &limits, &stream, &error), STATUS_OK);
    do assert_int_equal(cloud_stream_next(stream, &part, &error), STATUS_OK);
    while (part->count);
    assert_int_equal(cloud_stream_unpacked(stream), bytes);
    cloud_stream_free(stream);
}

static void parts_make_the_whole(void **state) {
    (void)state;
    static const char *const names[] = {"a.ply", "ascii.ply", "a.las",    "a.laz",
                                        "a.xyz", "a.pcd",     "a.ply.gz", "a.laz.gz"};
    struct cloud made = make_cloud();
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) {
        char path[PATH_BYTES];
        struct cloud whole = {0};
        struct error error = {0};
        write_as(&made, names[i], path);
        bool is_packed = strstr(names[i], ".gz");
        uint64_t bytes = bytes_of(path);
        if (is_packed) gzip_it(path);
        assert_int_equal(cloud_read_path(path, NULL, NULL, &whole, &error), STATUS_OK);
        const char *const one[] = {path}, *const two[] = {path, path};
        const struct cloud *const clouds[] = {&whole, &whole};
        expect_unpacked(one, 1, is_packed ? bytes : 0);
        expect_unpacked(two, 2, is_packed ? 2 * bytes : 0);
        assert_true(check_parts(one, 1, clouds) >= 2);
        assert_true(check_parts(two, 2, clouds) >= 4);
        cloud_done(&whole);
    }
    cloud_done(&made);
}

/* Of small files, whatever is odd about them; those that can't be read so are refused, and only some kinds may be. */
static void fixtures_are_the_same(void **state) {
    (void)state;
    DIR *cases = opendir("tests/fixtures/valid");
    assert_non_null(cases);
    size_t read = 0;
    for (struct dirent *entry; (entry = readdir(cases));) {
        char name[PATH_BYTES], path[2 * PATH_BYTES] = "";
        snprintf(name, sizeof name, "tests/fixtures/valid/%.200s", entry->d_name);
        DIR *files = entry->d_name[0] == '.' || strstr(name, "columns") ? NULL : opendir(name);
        for (struct dirent *file; files && (file = readdir(files));)
            if (strncmp(file->d_name, "input", 5) == 0) snprintf(path, sizeof path, "%s/%.200s", name, file->d_name);
        if (files) closedir(files);
        if (!path[0]) continue;
        struct cloud whole = {0};
        struct cloud_stream *stream = NULL;
        struct error error = {0};
        const char *const one[] = {path};
        const struct cloud *const clouds[] = {&whole};
        assert_int_equal(cloud_read_path(path, NULL, NULL, &whole, &error), STATUS_OK);
        const struct cloud_limits limits = {.scratch = folder};
        enum status status = cloud_stream_open(one, 1, &limits, &stream, &error);
        if (status && status != STATUS_UNSUPPORTED) fail_msg("%s: %s", path, error.text);
        cloud_stream_free(stream);
        if (!status && whole.count) {
            check_parts(one, 1, clouds);
            read++;
        }
        cloud_done(&whole);
    }
    closedir(cases);
    assert_true(read >= 60);
}

/* More faces than are passed by at a time, and bytes that nothing counts. */
static void what_stands_behind_faces_is_told(void **state) {
    (void)state;
    enum { FACES = 600001, FACE_BYTES = 13 };
    static const char header[] =
        "ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\n"
        "property float y\nproperty float z\nelement face 600001\n"
        "property list uchar int vertex_indices\nelement nothing 0\nproperty int a\nend_header\n";
    static const unsigned char face[FACE_BYTES] = {3, 0, 0, 0, 0, 1, 0, 0, 0, 2};
    static const float corner[3][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}};
    char path[PATH_BYTES];
    struct cloud whole = {0};
    struct error error = {0};
    snprintf(path, sizeof path, "%.300s/faces.ply", folder);
    FILE *file = fopen(path, "wb");
    assert_true(file && fputs(header, file) >= 0 && fwrite(corner, sizeof corner, 1, file) == 1);
    for (size_t i = 0; i < FACES; i++) assert_int_equal(fwrite(face, sizeof face, 1, file), 1);
    assert_true(fputs("not counted", file) >= 0 && fclose(file) == 0);
    assert_int_equal(cloud_read_path(path, NULL, NULL, &whole, &error), STATUS_OK);
    assert_non_null(strstr(whole.left_out, "11"));
    const char *const two[] = {path, path};
    const struct cloud *const clouds[] = {&whole, &whole};
    assert_int_equal(check_parts(two, 2, clouds), 2);
    cloud_done(&whole);
}

static void other_properties_are_refused(void **state) {
    (void)state;
    static const char text[] = "1 2 3 4\n", other[] = "1 2 3\n";
    char a[PATH_BYTES], b[PATH_BYTES];
    const struct cloud *part;
    struct cloud_stream *stream = NULL;
    struct error error = {0};
    snprintf(a, sizeof a, "%.300s/four.txt", folder);
    snprintf(b, sizeof b, "%.300s/three.txt", folder);
    FILE *file = fopen(a, "w");
    assert_true(file && fputs(text, file) >= 0 && fclose(file) == 0);
    file = fopen(b, "w");
    assert_true(file && fputs(other, file) >= 0 && fclose(file) == 0);
    const char *const both[] = {a, b};
    assert_int_equal(cloud_stream_open(both, 2, NULL, &stream, &error), STATUS_OK);
    assert_int_equal(cloud_stream_next(stream, &part, &error), STATUS_OK);
    assert_int_equal(part->count, 1);
    assert_int_equal(cloud_stream_next(stream, &part, &error), STATUS_UNSUPPORTED);
    cloud_stream_free(stream);
}

static int make_folder(void **state) {
    (void)state;
    folder_make_in_memory(folder, FOLDER_BYTES);
    return 0;
}

static int remove_folder(void **state) {
    (void)state;
    folder_remove(folder);
    return 0;
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(parts_make_the_whole), cmocka_unit_test(fixtures_are_the_same),
                                       cmocka_unit_test(what_stands_behind_faces_is_told),
                                       cmocka_unit_test(other_properties_are_refused)};
    return cmocka_run_group_tests(tests, make_folder, remove_folder);
}
