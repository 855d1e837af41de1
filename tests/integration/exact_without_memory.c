/* Preloaded into whittle: from the COUNT-th exact number on (WHITTLE_EXACT_NUMBERS=COUNT) GMP gets no memory.
 * test_memory.py compiles it.  What whittle gives GMP for malloc is called by way of here, and malloc fails meanwhile.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <dlfcn.h>
#include <stddef.h>
#include <stdlib.h>

typedef void *(*allocate)(size_t bytes);
typedef void *(*resize)(void *memory, size_t old_bytes, size_t bytes);
typedef void (*release)(void *memory, size_t bytes);

void *__libc_malloc(size_t bytes);
void __gmp_set_memory_functions(allocate a, resize r, release f);

static allocate of_whittle;
static long left;
static _Thread_local int fails;

void *malloc(size_t bytes) { return fails ? NULL : __libc_malloc(bytes); }

static void *allocate_by_way(size_t bytes) {
    fails = left-- <= 0;
    void *memory = of_whittle(bytes);
    fails = 0;
    return memory;
}

void __gmp_set_memory_functions(allocate a, resize r, release f) {
    void (*own)(allocate, resize, release);
    *(void **)&own = dlsym(RTLD_NEXT, "__gmp_set_memory_functions");
    const char *count = getenv("WHITTLE_EXACT_NUMBERS");
    left = count ? strtol(count, NULL, 10) : 0;
    of_whittle = a;
    own(allocate_by_way, r, f);
}
