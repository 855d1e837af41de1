/* Walks tests/fixtures/{valid,invalid}/NAME/{input.*,expect}, so that adding a case needs no C.
 *
 * expect has one fact on each line; a fact's name is its first word:
 *     valid:   format NAME | count N | triangles N | properties NAME:TYPE ... (a list is NAME:list:COUNT_TYPE:TYPE)
 *              value VERTEX PROPERTY NUMBER | list VERTEX PROPERTY NUMBER ... | triangle T A B C | comment TEXT
 *              left_out TEXT
 *     invalid: status NAME | line N | byte_offset N | where TEXT | text PART
 *     both:    columns LIST, the parameter that it is read with
 * A valid case is read from memory, through a file and through a pipe; an invalid one must leave its output alone.
 * Every valid case is also written in both encodings and read again.  Run from the root of the tree.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <dirent.h>
#include <fcntl.h>
#include <inttypes.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/io/out/write.h"
#include "core/io/read.h"

enum { PATH_BYTES = 512, LINE_BYTES = 1024, LEAST_CASES = 25, PIPE_BYTES = 131072 };

/* ------------------------------------------------------------------------------------------------ facts */

static const struct property *find(const struct cloud *cloud, const char *name) {
    for (size_t j = 0; j < cloud->property_count; j++)
        if (strcmp(cloud->property[j].name, name) == 0) return &cloud->property[j];
    fail_msg("no property %s", name);
    return NULL;
}

static void check_properties(const struct cloud *cloud, const char *expected) {
    char found[LINE_BYTES] = "";
    for (size_t j = 0; j < cloud->property_count; j++) {
        const struct property *p = &cloud->property[j];
        size_t used = strlen(found);
        const char *type = cloud_write_type_name(p->type), *gap = j ? " " : "";
        if (p->is_list)
            snprintf(found + used, sizeof found - used, "%s%s:list:%s:%s", gap, p->name,
                     cloud_write_type_name(p->count_type), type);
        else
            snprintf(found + used, sizeof found - used, "%s%s:%s", gap, p->name, type);
    }
    assert_string_equal(found, expected);
}

static void check_value(const struct cloud *cloud, const char *rest) {
    size_t vertex;
    char name[64], number[64];
    assert_int_equal(sscanf(rest, "%zu %63s %63s", &vertex, name, number), 3);
    assert_true(vertex < cloud->count);
    const struct property *p = find(cloud, name);
    double expected = strtod(number, NULL);
    double found = scalar_load(cloud->record + vertex * cloud->record_bytes + p->offset_bytes, p->type);
    if (p->type == SCALAR_FLOAT32) expected = (double)(float)expected;
    if (!(found == expected || (isnan(found) && isnan(expected))))
        fail_msg("vertex %zu: %s is %.17g, not %s", vertex, name, found, number);
}

static void check_list(const struct cloud *cloud, const char *rest) {
    size_t vertex;
    char name[64];
    int used;
    assert_int_equal(sscanf(rest, "%zu %63s%n", &vertex, name, &used), 2);
    const struct property *p = find(cloud, name);
    const unsigned char *at = p->list_data + p->list_offset[vertex], *end = p->list_data + p->list_offset[vertex + 1];
    char *next = (char *)(uintptr_t)(rest + used);
    for (; at < end; at += scalar_bytes(p->type)) {
        const char *before = next;
        double expected = strtod(before, &next);
        assert_ptr_not_equal(before, next);
        assert_true(scalar_load(at, p->type) == expected);
    }
    assert_string_equal(next, "");
}

static void check_triangle(const struct cloud *cloud, const char *rest) {
    size_t t;
    uint32_t v[3];
    assert_int_equal(sscanf(rest, "%zu %" SCNu32 " %" SCNu32 " %" SCNu32, &t, &v[0], &v[1], &v[2]), 4);
    assert_true(t < cloud->triangle_count);
    assert_memory_equal(cloud->triangle[t], v, sizeof v);
}

static void check_count(const struct cloud *cloud, const char *rest) {
    assert_int_equal(cloud->count, strtoull(rest, NULL, 10));
}

static void check_triangles(const struct cloud *cloud, const char *rest) {
    assert_int_equal(cloud->triangle_count, strtoull(rest, NULL, 10));
}

static void check_format(const struct cloud *cloud, const char *rest) { assert_string_equal(cloud->form, rest); }

static void check_comment(const struct cloud *cloud, const char *rest) {
    assert_non_null(cloud->comments);
    assert_non_null(strstr(cloud->comments, rest));
}

static void check_left_out(const struct cloud *cloud, const char *rest) {
    assert_non_null(cloud->left_out);
    assert_non_null(strstr(cloud->left_out, rest));
}

static const struct {
    const char *name;
    void (*check)(const struct cloud *cloud, const char *rest);
} cloud_facts[] = {{"count", check_count},      {"triangles", check_triangles},
                   {"format", check_format},    {"value", check_value},
                   {"list", check_list},        {"triangle", check_triangle},
                   {"comment", check_comment},  {"properties", check_properties},
                   {"left_out", check_left_out}};

static void check_cloud_fact(const void *cloud, const char *name, const char *rest) {
    for (size_t i = 0; i < sizeof cloud_facts / sizeof *cloud_facts; i++)
        if (strcmp(cloud_facts[i].name, name) == 0) {
            cloud_facts[i].check(cloud, rest);
            return;
        }
    fail_msg("unknown fact '%s'", name);
}

/* What the case is read with: the list of a line "columns LIST" of expect, "" where there is none. */
static const char *columns_of(const char *folder) {
    static char line[LINE_BYTES];
    char path[PATH_BYTES];
    snprintf(path, sizeof path, "%s/expect", folder);
    FILE *file = fopen(path, "r");
    assert_non_null(file);
    bool found = false;
    while (!found && fgets(line, sizeof line, file)) found = strncmp(line, "columns ", 8) == 0;
    fclose(file);
    line[strcspn(line, "\n")] = '\0';
    return found ? line + 8 : "";
}

static void check_error_fact(const void *context, const char *name, const char *rest) {
    const struct error *error = context;
    if (strcmp(name, "status") == 0)
        assert_string_equal(status_name(error->code), rest);
    else if (strcmp(name, "line") == 0)
        assert_int_equal(error->line, strtoull(rest, NULL, 10));
    else if (strcmp(name, "byte_offset") == 0)
        assert_int_equal(error->byte_offset, strtoull(rest, NULL, 10));
    else if (strcmp(name, "where") == 0)
        assert_string_equal(error->where, rest);
    else if (strcmp(name, "text") == 0) {
        if (!strstr(error->text, rest)) fail_msg("'%s' isn't in '%s'", rest, error->text);
    } else
        fail_msg("unknown fact '%s'", name);
}

/* Checks every line of expect; there must be some. */
static void check_expect(const char *folder, void (*check)(const void *, const char *, const char *), const void *of) {
    char path[PATH_BYTES], line[LINE_BYTES];
    snprintf(path, sizeof path, "%s/expect", folder);
    FILE *file = fopen(path, "r");
    assert_non_null(file);
    int facts = 0;
    for (; fgets(line, sizeof line, file); facts++) {
        line[strcspn(line, "\n")] = '\0';
        char *rest = strchr(line, ' ');
        assert_non_null(rest);
        *rest++ = '\0';
        if (strcmp(line, "columns") != 0) check(of, line, rest);
    }
    fclose(file);
    assert_true(facts >= 2);
}

/* ------------------------------------------------------------------------------------------------ cases */

static void find_input(const char *folder, char input[PATH_BYTES + 300]) {
    DIR *dir = opendir(folder);
    assert_non_null(dir);
    input[0] = '\0';
    for (struct dirent *entry; (entry = readdir(dir));)
        if (strncmp(entry->d_name, "input.", 6) == 0) snprintf(input, PATH_BYTES + 300, "%s/%s", folder, entry->d_name);
    closedir(dir);
    assert_string_not_equal(input, "");
}

/* Through a pipe that holds the whole of any fixture. */
static enum status read_piped(const char *input, const struct cloud_limits *limits, struct cloud *cloud,
                              struct error *error) {
    static char bytes[PIPE_BYTES];
    int in = open(input, O_RDONLY), ends[2];
    assert_true(in >= 0 && pipe(ends) == 0);
    assert_true(fcntl(ends[1], F_SETPIPE_SZ, PIPE_BYTES) >= PIPE_BYTES);
    ssize_t n = read(in, bytes, sizeof bytes);
    assert_true(n >= 0 && n < (ssize_t)sizeof bytes && write(ends[1], bytes, (size_t)n) == n);
    close(in);
    close(ends[1]);
    enum status status = cloud_read(ends[0], limits, NULL, cloud, error);
    close(ends[0]);
    return status;
}

/* Written and read again, all properties are the same to the bit (NaN to NaN). */
static void check_rewritten(const struct cloud *cloud, enum encoding encoding) {
    FILE *file = tmpfile();
    assert_non_null(file);
    struct error error = {0};
    struct cloud again = {0};
    assert_int_equal(cloud_write_ply(fileno(file), cloud, NULL, cloud->count, encoding, &error), STATUS_OK);
    rewind(file);
    enum status status = cloud_read(fileno(file), NULL, NULL, &again, &error);
    if (status) fail_msg("written and read again: %s", error.text);
    fclose(file);
    assert_int_equal(again.count, cloud->count);
    assert_int_equal(again.record_bytes, cloud->record_bytes);
    assert_memory_equal(again.record, cloud->record, cloud->count * cloud->record_bytes);
    assert_memory_equal(again.position, cloud->position, cloud->count * sizeof *cloud->position);
    if (cloud->comments) assert_string_equal(again.comments, cloud->comments);
    for (size_t j = 0; j < cloud->property_count; j++) {
        const struct property *p = &cloud->property[j], *q = &again.property[j];
        assert_string_equal(p->name, q->name);
        assert_int_equal(p->type, q->type);
        if (!p->is_list) continue;
        assert_memory_equal(p->list_offset, q->list_offset, (cloud->count + 1) * sizeof *p->list_offset);
        assert_memory_equal(p->list_data, q->list_data, p->list_offset[cloud->count]);
    }
    cloud_done(&again);
}

static void run_valid(const char *folder, const char *input) {
    struct error error = {0};
    struct cloud cloud = {0};
    const struct cloud_limits limits = {.columns = columns_of(folder)};
    enum status status = cloud_read_path(input, &limits, NULL, &cloud, &error);
    if (status) fail_msg("%s line %" PRIu64 ": %s", status_name(status), error.line, error.text);
    check_expect(folder, check_cloud_fact, &cloud);
    check_rewritten(&cloud, ENCODING_BINARY);
    check_rewritten(&cloud, ENCODING_ASCII);
    cloud_done(&cloud);
    assert_int_equal(read_piped(input, &limits, &cloud, &error), STATUS_OK);
    check_expect(folder, check_cloud_fact, &cloud);
    cloud_done(&cloud);
}

static void check_refused(const char *folder, enum status status, const struct cloud *cloud,
                          const struct error *error) {
    struct cloud untouched;
    memset(&untouched, 0x5a, sizeof untouched);
    assert_int_not_equal(status, STATUS_OK);
    assert_int_equal(status, error->code);
    assert_memory_equal(cloud, &untouched, sizeof untouched);
    check_expect(folder, check_error_fact, error);
}

static void run_invalid(const char *folder, const char *input) {
    struct cloud cloud;
    memset(&cloud, 0x5a, sizeof cloud);
    struct error error = {0};
    const struct cloud_limits limits = {.columns = columns_of(folder)};
    check_refused(folder, cloud_read_path(input, &limits, NULL, &cloud, &error), &cloud, &error);
    error = (struct error){0};
    check_refused(folder, read_piped(input, &limits, &cloud, &error), &cloud, &error);
}

static void walk(const char *root, void (*run)(const char *folder, const char *input)) {
    DIR *dir = opendir(root);
    assert_non_null(dir);
    int cases = 0;
    for (struct dirent *entry; (entry = readdir(dir));) {
        char folder[PATH_BYTES], input[PATH_BYTES + 300];
        if (entry->d_name[0] == '.') continue;
        snprintf(folder, sizeof folder, "%s/%s", root, entry->d_name);
        print_message("    %s\n", folder);
        find_input(folder, input);
        run(folder, input);
        cases++;
    }
    closedir(dir);
    assert_true(cases >= LEAST_CASES);
}

static void valid_inputs_read_as_expected(void **state) {
    (void)state;
    walk("tests/fixtures/valid", run_valid);
}

static void invalid_inputs_are_refused_with_a_place(void **state) {
    (void)state;
    walk("tests/fixtures/invalid", run_invalid);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(valid_inputs_read_as_expected),
                                       cmocka_unit_test(invalid_inputs_are_refused_with_a_place)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
