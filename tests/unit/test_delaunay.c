/* The Delaunay shim: what every consumer of struct tets relies on, on points that are hard for it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <fcntl.h>
#include <malloc.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/base/alloc.h"
#include "core/cloud/cloud.h"
#include "core/surface/delaunay_cgal.h"
#include "tests/unit/shapes.h"

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { SANITIZED = 1 };
#else
enum { SANITIZED = 0 };
#endif

static vec3 *grid(size_t nx, size_t ny, size_t nz) {
    vec3 *point = alloc_array(nx * ny * nz, sizeof *point);
    assert_non_null(point);
    size_t n = 0;
    for (size_t x = 0; x < nx; x++)
        for (size_t y = 0; y < ny; y++)
            for (size_t z = 0; z < nz; z++)
                point[n++] = (vec3){(double)x / 8 - 0.25, (double)y / 8 - 0.25, (double)z / 8 - 0.25};
    return point;
}

static vec3 *random_points(size_t n, uint64_t seed) {
    vec3 *point = alloc_array(n, sizeof *point);
    assert_non_null(point);
    for (size_t i = 0; i < n; i++) {
        point[i].x = random_unit(&seed) - 0.5;
        point[i].y = random_unit(&seed) - 0.5;
        point[i].z = random_unit(&seed) - 0.5;
    }
    return point;
}

static struct tets build(const vec3 *point, size_t n) {
    struct tets tets = {0};
    struct error error = {0};
    assert_int_equal(delaunay_build(point, n, 1, NULL, &tets, &error), STATUS_OK);
    return tets;
}

static double six_volumes(const vec3 *p, const uint32_t v[4]) {
    return vec3_dot(vec3_triangle_normal(p[v[0]], p[v[1]], p[v[2]]), vec3_sub(p[v[3]], p[v[0]]));
}

static bool has(const uint32_t v[4], uint32_t id) { return v[0] == id || v[1] == id || v[2] == id || v[3] == id; }

/* The facet across which c and d meet has the same three vertices in both, and d says the same of c. */
static void check_neighbour(const struct tets *tets, uint32_t c, int i) {
    uint32_t d = tets->neighbour[c][i];
    int shared = 0, back = 0;
    assert_true(d < tets->cell_count && d != c);
    for (int k = 0; k < 4; k++) {
        shared += k != i && has(tets->vertex[d], tets->vertex[c][k]);
        back += tets->neighbour[d][k] == c;
    }
    assert_int_equal(shared, 3);
    assert_true(back > 0);
}

static void check_cell(const struct tets *tets, const vec3 *point, uint32_t c) {
    int infinite = 0;
    for (int i = 0; i < 4; i++) {
        infinite += tets->vertex[c][i] == NONE;
        check_neighbour(tets, c, i);
    }
    assert_int_equal(infinite, c >= tets->finite_count);
    if (infinite) return;
    assert_true(six_volumes(point, tets->vertex[c]) > 0);
    assert_true(vec3_is_finite(tets->circumcentre[c]));
}

/* Structure, orientation, and the volume of all cells. */
static double check(const struct tets *tets, const vec3 *point) {
    double volume = 0;
    for (uint32_t c = 0; c < tets->cell_count; c++) check_cell(tets, point, c);
    for (uint32_t c = 0; c < tets->finite_count; c++) volume += six_volumes(point, tets->vertex[c]) / 6;
    return volume;
}

static void four_points_make_one_cell_and_four_infinite_ones(void **state) {
    (void)state;
    const vec3 point[] = {{0, 0, 0}, {0.5, 0, 0}, {0, 0.5, 0}, {0, 0, 0.5}};
    struct tets tets = build(point, 4);
    assert_int_equal(tets.dimension, 3);
    assert_int_equal(tets.finite_count, 1);
    assert_int_equal(tets.cell_count, 5);
    assert_true(fabs(check(&tets, point) - 0.5 * 0.5 * 0.5 / 6) < 1e-15);
    assert_true(vec3_distance(tets.circumcentre[0], (vec3){0.25, 0.25, 0.25}) < 1e-15);
    tets_done(&tets);
}

static void infinite_cells_turn_as_if_infinity_lay_outside(void **state) {
    (void)state;
    vec3 *point = random_points(60, 3);
    struct tets tets = build(point, 60);
    for (size_t c = tets.finite_count; c < tets.cell_count; c++) {
        uint32_t v[4];
        memcpy(v, tets.vertex[c], sizeof v);
        int i = 0;
        while (v[i] != NONE) i++;
        /* The inner cell's vertex across the hull facet, put in infinity's place, turns the cell over. */
        uint32_t inner = tets.neighbour[c][i];
        for (int k = 0; k < 4; k++)
            if (!has(tets.vertex[c], tets.vertex[inner][k])) v[i] = tets.vertex[inner][k];
        assert_true(six_volumes(point, v) < 0);
    }
    tets_done(&tets);
    free(point);
}

static void no_point_is_inside_a_circumsphere(void **state) {
    (void)state;
    enum { N = 120 };
    vec3 *point = random_points(N, 7);
    struct tets tets = build(point, N);
    check(&tets, point);
    for (size_t c = 0; c < tets.finite_count; c++) {
        double radius = vec3_distance(tets.circumcentre[c], point[tets.vertex[c][0]]);
        for (size_t i = 0; i < N; i++)
            assert_true(vec3_distance(tets.circumcentre[c], point[i]) > radius * (1 - 1e-9) - 1e-12);
    }
    tets_done(&tets);
    free(point);
}

static void a_cospherical_grid_fills_its_box(void **state) {
    (void)state;
    vec3 *point = grid(5, 4, 3);
    struct tets tets = build(point, 60);
    assert_true(fabs(check(&tets, point) - 0.5 * 0.375 * 0.25) < 1e-12);
    tets_done(&tets);
    free(point);
}

static void slivers_have_finite_circumcentres(void **state) {
    (void)state;
    enum { N = 400 };
    vec3 *point = random_points(N, 11);
    for (size_t i = 0; i < N; i++) point[i].z *= 1e-14;
    struct tets tets = build(point, N);
    if (tets.dimension == 3) check(&tets, point);
    tets_done(&tets);
    free(point);
}

/* Corners (0, 0, 0), (1, 0, e), (0, 1, e), (1, 1, 4 e) have theirs at (1/2 - 3 e^2, 1/2 - 3 e^2, 7/2 e). */
static void flat_cells_have_exact_circumcentres(void **state) {
    (void)state;
    static const int scales[] = {0, 100, -60, -100, -300};
    for (size_t i = 0; i < sizeof scales / sizeof *scales; i++) {
        double e = 0x1p-40, s = ldexp(1, scales[i]);
        const vec3 point[] = {{0, 0, 0}, {s, 0, s * e}, {0, s, s * e}, {s, s, 4 * s * e}};
        struct tets tets = build(point, 4);
        assert_int_equal(tets.finite_count, 1);
        vec3 centre = vec3_scale(tets.circumcentre[0], 1 / s);
        assert_true(fabs(centre.x - (0.5 - 3 * e * e)) < 1e-15);
        assert_true(fabs(centre.y - (0.5 - 3 * e * e)) < 1e-15);
        assert_true(fabs(centre.z / e - 3.5) < 1e-14);
        tets_done(&tets);
    }
}

static void coplanar_points_give_triangles_that_turn_the_same_way(void **state) {
    (void)state;
    vec3 *point = grid(1, 6, 5);
    struct tets tets = build(point, 30);
    assert_int_equal(tets.dimension, 2);
    assert_int_equal(tets.cell_count, 0);
    assert_int_equal(tets.planar_count, 5 * 4 * 2);
    double first = 0, area = 0;
    for (size_t t = 0; t < tets.planar_count; t++) {
        const uint32_t *v = tets.planar[t];
        double x = vec3_triangle_normal(point[v[0]], point[v[1]], point[v[2]]).x;
        if (t == 0) first = x;
        assert_true(x * first > 0);
        area += fabs(x) / 2;
    }
    assert_true(fabs(area - 5.0 / 8 * 4 / 8) < 1e-12);
    tets_done(&tets);
    free(point);
}

static void plane_triangles(const vec3 *feet, size_t n, unsigned threads, uint32_t (**triangle)[3], size_t *count) {
    struct error error = {0};
    *triangle = NULL;
    assert_int_equal(delaunay_in_plane(feet, n, threads, NULL, triangle, count, &error), STATUS_OK);
}

/* Of a grid, of which four are on each circle, and of random points, some of them twice: the same triangles as those of
 * points in space that lie on one plane, each seen from above, in order, for any number of threads. */
static void feet_have_the_triangles_of_points_on_a_plane(void **state) {
    (void)state;
    enum { SIDE = 40, N = SIDE * SIDE, TWICE = 100 };
    vec3 *regular = grid(SIDE, SIDE, 1), *points[] = {regular, random_points(N, 9)};
    for (int k = 0; k < 2; k++) {
        vec3 *feet = points[k];
        for (size_t i = 0; i < N; i++) feet[i].z = 0;
        for (size_t i = 0; k == 1 && i < TWICE; i++) feet[N - 1 - i] = feet[7 * i];
        struct tets tets = build(feet, N);
        size_t count, more;
        uint32_t(*triangle)[3], (*other)[3];
        plane_triangles(feet, N, 1, &triangle, &count);
        plane_triangles(feet, N, 3, &other, &more);
        assert_int_equal(tets.dimension, 2);
        assert_int_equal(count, tets.planar_count);
        assert_int_equal(more, count);
        assert_memory_equal(other, triangle, count * sizeof *triangle);
        for (size_t t = 0; t < count; t++) {
            const uint32_t *v = triangle[t];
            assert_true(vec3_triangle_normal(feet[v[0]], feet[v[1]], feet[v[2]]).z > 0);
            assert_true(v[0] < v[1] && v[0] < v[2]);
            assert_true(t == 0 || memcmp(v, triangle[t - 1], sizeof *triangle) != 0);
        }
        if (vec3_triangle_normal(feet[tets.planar[0][0]], feet[tets.planar[0][1]], feet[tets.planar[0][2]]).z > 0)
            assert_memory_equal(triangle, tets.planar, count * sizeof *triangle);
        free(triangle), free(other), free(feet);
        tets_done(&tets);
    }
}

static void feet_on_a_line_have_no_triangles(void **state) {
    (void)state;
    vec3 *feet = grid(1, 1, 7);
    for (size_t n = 0; n <= 7; n++) {
        uint32_t(*triangle)[3];
        size_t count = 1;
        for (size_t i = 0; i < n; i++) feet[i] = (vec3){(double)i, 0.5 * (double)i, 0};
        plane_triangles(feet, n, 1, &triangle, &count);
        assert_int_equal(count, 0);
        free(triangle);
    }
    free(feet);
}

static void fewer_dimensions_give_nothing(void **state) {
    (void)state;
    vec3 *point = grid(1, 1, 7);
    for (size_t n = 0; n <= 7; n++) {
        struct tets tets = build(point, n);
        assert_int_equal(tets.dimension, n > 1 ? 1 : 0);
        assert_int_equal(tets.cell_count + tets.planar_count, 0);
        tets_done(&tets);
    }
    free(point);
}

/* Cells of shuffled points, with the ids translated back, as a sorted list. */
static int by_ids(const void *a, const void *b) { return memcmp(a, b, 4 * sizeof(uint32_t)); }

static void sort_ids(uint32_t v[4]) {
    for (int i = 1; i < 4; i++)
        for (int j = i; j > 0 && v[j] < v[j - 1]; j--) {
            uint32_t swap = v[j];
            v[j] = v[j - 1];
            v[j - 1] = swap;
        }
}

static void the_order_of_points_does_not_matter(void **state) {
    (void)state;
    enum { N = 300 };
    vec3 *point = random_points(N, 5), *shuffled = alloc_array(N, sizeof *shuffled);
    uint32_t original[N];
    for (uint32_t i = 0; i < N; i++) {
        original[i] = (i * 7 + 3) % N;
        shuffled[i] = point[original[i]];
    }
    struct tets a = build(point, N), b = build(shuffled, N);
    assert_int_equal(a.cell_count, b.cell_count);
    for (size_t c = 0; c < a.finite_count; c++) {
        for (int i = 0; i < 4; i++) b.vertex[c][i] = original[b.vertex[c][i]];
        sort_ids(a.vertex[c]);
        sort_ids(b.vertex[c]);
    }
    qsort(a.vertex, a.finite_count, sizeof *a.vertex, by_ids);
    qsort(b.vertex, b.finite_count, sizeof *b.vertex, by_ids);
    assert_memory_equal(a.vertex, b.vertex, a.finite_count * sizeof *a.vertex);
    tets_done(&a), tets_done(&b);
    free(point), free(shuffled);
}

static void the_number_of_threads_does_not_matter(void **state) {
    (void)state;
    enum { N = 2000 };
    vec3 *point = random_points(N, 11);
    struct tets one = build(point, N);
    for (unsigned threads = 2; threads <= 4; threads++) {
        struct tets many = {0};
        assert_int_equal(delaunay_build(point, N, threads, NULL, &many, NULL), STATUS_OK);
        assert_int_equal(many.cell_count, one.cell_count);
        assert_int_equal(many.finite_count, one.finite_count);
        assert_memory_equal(many.vertex, one.vertex, one.cell_count * sizeof *one.vertex);
        assert_memory_equal(many.neighbour, one.neighbour, one.cell_count * sizeof *one.neighbour);
        assert_memory_equal(many.circumcentre, one.circumcentre, one.finite_count * sizeof *one.circumcentre);
        tets_done(&many);
    }
    tets_done(&one);
    free(point);
}

static int stop(void *ctx, const char *stage, double fraction) {
    (void)fraction;
    assert_string_equal(stage, "delaunay");
    return ++*(int *)ctx == 2;
}

static void it_stops_when_asked(void **state) {
    (void)state;
    vec3 *point = random_points(5000, 1);
    int calls = 0;
    struct progress progress = {stop, &calls};
    struct tets tets = {0};
    struct error error = {0};
    assert_int_equal(delaunay_build(point, 5000, 1, &progress, &tets, &error), STATUS_CANCELLED);
    assert_int_equal(error.code, STATUS_CANCELLED);
    assert_null(tets.vertex);
    uint32_t(*triangle)[3] = NULL;
    size_t count;
    calls = 0;
    assert_int_equal(delaunay_in_plane(point, 5000, 1, &progress, &triangle, &count, &error), STATUS_CANCELLED);
    assert_null(triangle);
    free(point);
}

/* Two skew lines have the square of their points. */
static void it_stops_at_so_many_cells(void **state) {
    (void)state;
    enum { HALF = 1000 };
    vec3 point[2 * HALF];
    struct tets tets = {0};
    struct error error = {0};
    for (int i = 0; i < HALF; i++) {
        point[i] = (vec3){0.5 * i / HALF, 0, 0};
        point[HALF + i] = (vec3){0, 0.5 * i / HALF, 0.5};
    }
    assert_int_equal(delaunay_build_within(point, 2 * HALF, 30000, 1, NULL, &tets, &error), STATUS_LIMIT);
    assert_non_null(strstr(error.text, "outputs=cloud"));
    assert_null(tets.vertex);
    assert_int_equal(delaunay_build_within(point, 200, 30000, 1, NULL, &tets, &error), STATUS_OK);
    tets_done(&tets);
}

static bool is_due(void *ctx) { return (*(int *)ctx)-- == 0; }

static void a_failing_allocation_is_a_status(void **state) {
    (void)state;
    vec3 *point = random_points(50, 2);
    for (int nth = 0; nth < 3; nth++) {
        int left = nth;
        struct tets tets = {0};
        alloc_fail_ctx = &left;
        alloc_fail = is_due;
        enum status status = delaunay_build(point, 50, 1, NULL, &tets, NULL);
        alloc_fail = NULL;
        assert_int_equal(status, STATUS_NO_MEMORY);
        assert_null(tets.vertex);
    }
    int none = 0;
    uint32_t(*triangle)[3] = NULL;
    size_t count;
    alloc_fail_ctx = &none, alloc_fail = is_due;
    enum status status = delaunay_in_plane(point, 50, 1, NULL, &triangle, &count, NULL);
    alloc_fail = NULL;
    assert_int_equal(status, STATUS_NO_MEMORY);
    assert_null(triangle);
    free(point);
}

/* FNV-1a over the cells and their neighbours: nothing of a result stays, so that all its memory is given back. */
static uint64_t fingerprint(struct tets tets) {
    uint64_t hash = 0xcbf29ce484222325;
    for (size_t c = 0; c < tets.cell_count; c++)
        for (int i = 0; i < 4; i++) {
            hash = (hash ^ tets.vertex[c][i]) * 0x100000001b3;
            hash = (hash ^ tets.neighbour[c][i]) * 0x100000001b3;
        }
    tets_done(&tets);
    return hash;
}

static rlim_t address_space_bytes(void) {
    char text[64] = "";
    int fd = open("/proc/self/statm", O_RDONLY);
    ssize_t n = read(fd, text, sizeof text - 1);
    close(fd);
    return n > 0 ? strtoull(text, NULL, 10) * (rlim_t)sysconf(_SC_PAGESIZE) : 0;
}

static bool limit_addresses(rlim_t bytes) { return setrlimit(RLIMIT_AS, &(struct rlimit){bytes, RLIM_INFINITY}) == 0; }

/* Whether a process may be kept from getting more: an emulator takes the limit, and doesn't hold to it. */
static bool limits_hold(void) {
    pid_t child = fork();
    assert_true(child >= 0);
    if (child == 0) {
        bool limited = limit_addresses(address_space_bytes());
        _exit(limited && mmap(NULL, 16 << 20, PROT_READ, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0) == MAP_FAILED);
    }
    int how;
    assert_int_equal(waitpid(child, &how, 0), child);
    return WIFEXITED(how) && WEXITSTATUS(how) == 1;
}

/* Gives a triangulation ever more memory until it is enough; after each that failed the next one, in the same thread,
 * has to be as any other.  *failures: how many did. */
static bool recovers(const vec3 *point, size_t n, unsigned *failures) {
    const rlim_t step = 16 << 10;
    uint64_t right = fingerprint(build(point, n));
    enum status status = STATUS_NO_MEMORY;
    for (rlim_t more = 0; status == STATUS_NO_MEMORY; more += step) {
        struct tets tets = {0};
        malloc_trim(0);
        rlim_t now = address_space_bytes();
        if (!now || !limit_addresses(now + more)) return false;
        status = delaunay_build(point, n, 1, NULL, &tets, NULL);
        if (!limit_addresses(RLIM_INFINITY)) return false;
        if (status == STATUS_OK && fingerprint(tets) != right) return false;
        if (fingerprint(build(point, n)) != right) return false;
        *failures += status == STATUS_NO_MEMORY;
    }
    return status == STATUS_OK;
}

static void it_recovers_from_memory_that_failed_anywhere(void **state) {
    (void)state;
    enum { POINTS = 3000, FAILURES = 100, RECOVERED = 0, WRONG = 1, NEVER_FAILED = 2 };
    if (SANITIZED) {
        print_message("skipped: sanitizers reserve address space\n");
        skip();
    }
    if (!limits_hold()) {
        print_message("skipped: limits of memory don't hold here\n");
        skip();
    }
    vec3 *point = random_points(POINTS, 5);
    pid_t child = fork();
    assert_true(child >= 0);
    if (child == 0) {
        unsigned failures = 0;
        bool recovered = recovers(point, POINTS, &failures);
        _exit(!recovered ? WRONG : failures < FAILURES ? NEVER_FAILED : RECOVERED);
    }
    int how;
    assert_int_equal(waitpid(child, &how, 0), child);
    assert_true(WIFEXITED(how));
    assert_int_equal(WEXITSTATUS(how), RECOVERED);
    free(point);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(four_points_make_one_cell_and_four_infinite_ones),
        cmocka_unit_test(infinite_cells_turn_as_if_infinity_lay_outside),
        cmocka_unit_test(no_point_is_inside_a_circumsphere),
        cmocka_unit_test(a_cospherical_grid_fills_its_box),
        cmocka_unit_test(slivers_have_finite_circumcentres),
        cmocka_unit_test(flat_cells_have_exact_circumcentres),
        cmocka_unit_test(coplanar_points_give_triangles_that_turn_the_same_way),
        cmocka_unit_test(feet_have_the_triangles_of_points_on_a_plane),
        cmocka_unit_test(feet_on_a_line_have_no_triangles),
        cmocka_unit_test(fewer_dimensions_give_nothing),
        cmocka_unit_test(the_order_of_points_does_not_matter),
        cmocka_unit_test(the_number_of_threads_does_not_matter),
        cmocka_unit_test(it_stops_when_asked),
        cmocka_unit_test(it_stops_at_so_many_cells),
        cmocka_unit_test(a_failing_allocation_is_a_status),
        cmocka_unit_test(it_recovers_from_memory_that_failed_anywhere),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
