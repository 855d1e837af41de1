/* The bottom of the core: statuses, allocation, parallel loops, vectors, eigenvectors.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <inttypes.h>
#include <pthread.h>
#include <sched.h>
#include <setjmp.h>
#include <signal.h>
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

#include "core/base/alloc.h"
#include "core/base/par.h"
#include "core/base/process_memory.h"
#include "core/base/status.h"
#include "core/math/sym3.h"
#include "tests/unit/shapes.h"

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
enum { SANITIZED = 1 };
#else
enum { SANITIZED = 0 };
#endif

static void every_status_has_a_name_that_leads_back(void **state) {
    (void)state;
    for (int i = 0; i < STATUS_COUNT; i++) assert_int_equal(status_from_name(status_name((enum status)i)), i);
    assert_string_equal(status_name((enum status)99), "unknown");
    assert_int_equal(status_from_name("nonsense"), STATUS_ENGINE);
}

static void an_error_that_does_not_fit_is_cut(void **state) {
    (void)state;
    char text[2 * ERROR_TEXT_BYTES];
    memset(text, 'x', sizeof text - 1);
    text[sizeof text - 1] = 0;
    struct error error = {0};
    assert_int_equal(error_set_at(&error, STATUS_MALFORMED, text, 7, 9, "%s", text), STATUS_MALFORMED);
    assert_int_equal(strlen(error.text), ERROR_TEXT_BYTES - 1);
    assert_int_equal(strlen(error.where), ERROR_WHERE_BYTES - 1);
    assert_int_equal(error.line, 7);
    assert_int_equal(error.byte_offset, 9);
    assert_int_equal(error_set(NULL, STATUS_IO, "x", "y"), STATUS_IO);
}

static void an_array_whose_size_overflows_is_refused(void **state) {
    (void)state;
    assert_null(alloc_array(SIZE_MAX / 2, 16));
    assert_null(alloc_zeroed(SIZE_MAX / 4, 8));
    void *none = alloc_array(0, 8);
    assert_non_null(none);
    free(none);
}

/* Whether the kernel was asked for huge pages where this byte lies. */
static bool is_of_huge_pages(const void *byte) {
    FILE *maps = fopen("/proc/self/smaps", "r");
    char line[512];
    bool here = false, huge = false;
    assert_non_null(maps);
    while (fgets(line, sizeof line, maps)) {
        uintptr_t from, to;
        if (sscanf(line, "%" SCNxPTR "-%" SCNxPTR " ", &from, &to) == 2)
            here = from <= (uintptr_t)byte && (uintptr_t)byte < to;
        if (here && strncmp(line, "VmFlags:", 8) == 0) huge = strstr(line, " hg") != NULL;
    }
    fclose(maps);
    return huge;
}

static void a_large_array_is_of_huge_pages(void **state) {
    (void)state;
    if (access("/sys/kernel/mm/transparent_hugepage", F_OK) != 0) return; /* the kernel has none */
    char *large = alloc_array(2 * ALLOC_HUGE_BYTES, 1), *small = alloc_array(ALLOC_HUGE_BYTES / 2, 1);
    assert_non_null(large);
    assert_non_null(small);
    assert_true(is_of_huge_pages(large + ALLOC_HUGE_BYTES));
    assert_false(is_of_huge_pages(small + ALLOC_HUGE_BYTES / 4));
    free(large), free(small);
}

static size_t resident_bytes(void) {
    FILE *file = fopen("/proc/self/statm", "r");
    size_t all, resident;
    assert_non_null(file);
    assert_int_equal(fscanf(file, "%zu %zu", &all, &resident), 2);
    fclose(file);
    return resident * (size_t)sysconf(_SC_PAGESIZE);
}

static void what_is_freed_stays_where_that_is_asked_for(void **state) {
    (void)state;
    const size_t much = 64 << 20;
    if (SANITIZED) {
        print_message("skipped: sanitizers take memory of their own\n");
        skip();
    }
    for (int keep = 1; keep >= 0; keep--) {
        size_t before = resident_bytes();
        alloc_keep_freed(keep);
        volatile char *array = alloc_array(much, 1);
        assert_non_null(array);
        for (size_t i = 0; i < much; i += 512) array[i] = 1;
        free((void *)(uintptr_t)array);
        if (keep) assert_true(resident_bytes() > before + much / 2);
        alloc_keep_freed(false);
        assert_true(resident_bytes() < before + much / 2);
    }
}

static bool always_fails(void *ctx) {
    (*(int *)ctx)++;
    return true;
}

static void a_large_array_begins_with_a_cache_line(void **state) {
    (void)state;
    for (size_t n = 4096; n < 4096 * 64; n += 4097) {
        char *array = alloc_array(n, 1);
        assert_non_null(array);
        assert_int_equal((uintptr_t)array % 64, 0);
        memset(array, 1, n);
        free(array);
    }
}

static void the_seam_makes_allocations_fail(void **state) {
    (void)state;
    int asked = 0;
    alloc_fail = always_fails, alloc_fail_ctx = &asked;
    void *a = alloc_array(1, 1), *b = alloc_zeroed(1, 1), *c = alloc_resize(NULL, 1, 1);
    alloc_fail = NULL;
    assert_null(a);
    assert_null(b);
    assert_null(c);
    assert_int_equal(asked, 3);
}

static void count_range(void *ctx, size_t begin, size_t end) {
    unsigned char *seen = ctx;
    for (size_t i = begin; i < end; i++) seen[i]++;
}

static void a_parallel_loop_visits_every_index_once(void **state) {
    (void)state;
    for (unsigned threads = 0; threads < 9; threads += 3)
        for (size_t n = 0; n < 3000; n += 499) {
            unsigned char seen[3000] = {0};
            par_for(threads, n, 100, count_range, seen);
            for (size_t i = 0; i < sizeof seen; i++) assert_int_equal(seen[i], i < n);
        }
}

struct meeting {
    pthread_barrier_t barrier;
    pid_t who[2];
};

/* Two ranges that wait for each other are run by two threads. */
static void meet(void *ctx, size_t begin, size_t end) {
    struct meeting *meeting = ctx;
    (void)end;
    pthread_barrier_wait(&meeting->barrier);
    meeting->who[begin] = gettid();
}

static void a_team_s_threads_stay_from_loop_to_loop(void **state) {
    (void)state;
    struct meeting meeting;
    pid_t self = gettid(), helper = 0;
    pthread_barrier_init(&meeting.barrier, NULL, 2);
    struct par_team *team = par_team_new();
    assert_non_null(team);
    for (int i = 0; i < 300; i++) {
        par_for(2, 2, 1, meet, &meeting);
        unsigned mine = meeting.who[1] == self;
        assert_int_equal(meeting.who[mine], self);
        assert_true(i == 0 || meeting.who[1 - mine] == helper);
        helper = meeting.who[1 - mine];
    }
    par_team_free(team);
    par_team_free(NULL);
    while (tgkill(getpid(), helper, 0) == 0) sched_yield(); /* until it has gone home */
    par_for(2, 2, 1, meet, &meeting);
    pthread_barrier_destroy(&meeting.barrier);
}

/* Two that wait for each other are on two threads; so are the ranges of a loop that is left when one is done. */
struct sides {
    struct meeting meeting, loop;
    bool loop_is_mine;
};

static void do_side(struct sides *sides, bool mine) {
    meet(&sides->meeting, mine, 0);
    if (mine == sides->loop_is_mine) par_for(2, 2, 1, meet, &sides->loop);
}

static void do_mine(void *ctx) { do_side(ctx, true); }
static void do_others(void *ctx) { do_side(ctx, false); }

static void what_is_beside_runs_at_once_and_whoever_is_done_helps(void **state) {
    (void)state;
    struct sides sides;
    pthread_barrier_init(&sides.meeting.barrier, NULL, 2);
    pthread_barrier_init(&sides.loop.barrier, NULL, 2);
    struct par_team *team = par_team_new();
    for (int i = 0; i < 300; i++) {
        sides.loop_is_mine = i % 2;
        par_beside(2, do_mine, do_others, &sides);
        assert_int_equal(sides.meeting.who[1], gettid());
        assert_int_not_equal(sides.meeting.who[0], gettid());
        assert_int_not_equal(sides.loop.who[0], sides.loop.who[1]);
    }
    par_team_free(team);
    pthread_barrier_destroy(&sides.meeting.barrier);
    pthread_barrier_destroy(&sides.loop.barrier);
}

static void double_it(void *ctx) { *(int *)ctx *= 2; }
static void add_one(void *ctx) { *(int *)ctx += 1; }

static void without_a_team_the_others_come_after(void **state) {
    (void)state;
    int value = 5;
    par_beside(2, double_it, add_one, &value);
    assert_int_equal(value, 11);
    struct par_team *team = par_team_new();
    par_beside(1, double_it, add_one, &value);
    par_team_free(team);
    assert_int_equal(value, 23);
}

static void count_nested(void *ctx, size_t begin, size_t end) {
    for (size_t i = begin; i < end; i++) par_for(3, 100, 10, count_range, (unsigned char *)ctx + i * 100);
}

static void a_team_visits_every_index_once(void **state) {
    (void)state;
    struct par_team *team = par_team_new();
    a_parallel_loop_visits_every_index_once(NULL);
    unsigned char seen[2000] = {0};
    par_for(4, 20, 1, count_nested, seen);
    for (size_t i = 0; i < sizeof seen; i++) assert_int_equal(seen[i], 1);
    par_team_free(team);
}

static void a_basis_is_orthonormal_and_right_handed(void **state) {
    (void)state;
    uint64_t seed = 1;
    for (int i = 0; i < 100; i++) {
        vec3 n = vec3_unit((vec3){random_unit(&seed) - .5, random_unit(&seed) - .5, random_unit(&seed) - .5}), u, v;
        vec3_basis(n, &u, &v);
        assert_true(fabs(vec3_dot(u, v)) < 1e-12 && fabs(vec3_dot(u, n)) < 1e-12);
        assert_true(vec3_distance(vec3_cross(u, v), n) < 1e-12);
    }
}

static void check_least(sym3 m, double least) {
    double value, scale = fabs(sym3_trace(m)) + 1e-300;
    vec3 vector;
    sym3_least(&m, 1, &value, &vector);
    vec3 residual = vec3_sub(sym3_mul(m, vector), vec3_scale(vector, value));
    assert_true(fabs(value - least) < 1e-13 * scale);
    assert_true(vec3_length(residual) < 1e-12 * scale);
    assert_true(fabs(vec3_length(vector) - 1) < 1e-12);
}

/* One has a double root, one is zero, one is large: they are looked for as long as it takes each. */
static void least_ones_do_not_depend_on_their_company(void **state) {
    (void)state;
    const sym3 all[] = {{1, 0.2, 0.1, 2, 0.3, 3},
                        {2, 0, 0, 2, 0, 5},
                        {0, 0, 0, 0, 0, 0},
                        {4e8, 1e7, 0, 9e8, 3e7, 1e8},
                        {1, 1, 1, 1, 1, 1}};
    for (unsigned first = 0; first < 5; first++)
        for (unsigned n = 1; n <= SYM3_FEW; n++) {
            sym3 m[SYM3_FEW];
            double value[SYM3_FEW], alone;
            vec3 vector[SYM3_FEW], axis;
            for (unsigned i = 0; i < n; i++) m[i] = all[(first + i) % 5];
            sym3_least(m, n, value, vector);
            for (unsigned i = 0; i < n; i++) {
                sym3_least(&m[i], 1, &alone, &axis);
                assert_true(value[i] == alone && vec3_equal(vector[i], axis));
            }
        }
}

static void check_eigen(sym3 m) {
    double value[3], scale = fabs(sym3_trace(m)) + 1e-300;
    vec3 vector[3];
    sym3_eigen(m, value, vector);
    check_least(m, value[0]);
    assert_true(value[0] <= value[1] && value[1] <= value[2]);
    for (int i = 0; i < 3; i++) {
        vec3 residual = vec3_sub(sym3_mul(m, vector[i]), vec3_scale(vector[i], value[i]));
        assert_true(vec3_length(residual) <= 1e-14 * scale);
        assert_true(fabs(vec3_length(vector[i]) - 1) < 1e-14);
        assert_true(fabs(vec3_dot(vector[i], vector[(i + 1) % 3])) < 1e-14);
    }
}

static void eigenvectors_stand_coinciding_eigenvalues(void **state) {
    (void)state;
    check_eigen((sym3){1, 0, 0, 1, 0, 1});
    check_eigen((sym3){2, 0, 0, 2, 0, 1e-9});
    check_eigen(sym3_add(sym3_outer((vec3){1, 2, 3}), sym3_scale((sym3){1, 0, 0, 1, 0, 1}, 1e-13)));
    check_eigen((sym3){0, 0, 0, 0, 0, 0});
    uint64_t seed = 2;
    for (int i = 0; i < 1000; i++) {
        sym3 m = {0};
        for (int j = 0; j < 3; j++)
            m = sym3_add(m, sym3_outer((vec3){random_unit(&seed), random_unit(&seed), random_unit(&seed)}));
        check_eigen(m);
    }
}

/* A child that starts small after its parent was large: wait4's figure is the parent's, /proc's the child's. */
static void the_peak_of_memory_is_a_program_s_own(void **state) {
    (void)state;
    const size_t much = (size_t)64 << 20;
    uint64_t before = process_peak_bytes(0);
    assert_true(before > 0);
    unsigned char *block = malloc(much);
    assert_non_null(block);
    memset(block, 1, much);
    assert_true(block[much / 2] == 1 && process_peak_bytes(0) > before + much / 2);
    int ends[2];
    assert_int_equal(pipe(ends), 0);
    pid_t pid = fork();
    if (pid == 0) {
        dup2(ends[0], STDIN_FILENO);
        close(ends[1]);
        execl("/bin/cat", "cat", (char *)NULL);
        _exit(127);
    }
    assert_true(pid > 0);
    close(ends[0]);
    assert_int_equal(write(ends[1], "x", 1), 1);
    uint64_t seen;
    do {
        seen = process_peak_bytes(pid); /* until it is cat: before, it is a copy of this program */
        sched_yield();
    } while (seen > much / 2);
    assert_true(seen > 0);
    struct rusage usage;
    close(ends[1]);
    assert_int_equal(wait4(pid, NULL, 0, &usage), pid);
    assert_true((uint64_t)usage.ru_maxrss * 1024 > much / 2);
    assert_int_equal(process_peak_bytes(pid), 0);
    free(block);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(least_ones_do_not_depend_on_their_company),
        cmocka_unit_test(the_peak_of_memory_is_a_program_s_own),
        cmocka_unit_test(every_status_has_a_name_that_leads_back),
        cmocka_unit_test(an_error_that_does_not_fit_is_cut),
        cmocka_unit_test(an_array_whose_size_overflows_is_refused),
        cmocka_unit_test(a_large_array_begins_with_a_cache_line),
        cmocka_unit_test(a_large_array_is_of_huge_pages),
        cmocka_unit_test(what_is_freed_stays_where_that_is_asked_for),
        cmocka_unit_test(the_seam_makes_allocations_fail),
        cmocka_unit_test(a_parallel_loop_visits_every_index_once),
        cmocka_unit_test(a_team_s_threads_stay_from_loop_to_loop),
        cmocka_unit_test(what_is_beside_runs_at_once_and_whoever_is_done_helps),
        cmocka_unit_test(without_a_team_the_others_come_after),
        cmocka_unit_test(a_team_visits_every_index_once),
        cmocka_unit_test(a_basis_is_orthonormal_and_right_handed),
        cmocka_unit_test(eigenvectors_stand_coinciding_eigenvalues),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
