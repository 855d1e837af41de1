/* A flag of each thread's, set where the library's allocations fail.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "api/codecs/json_memory.h"

#include <jansson.h>
#include <stdlib.h>

static _Thread_local bool failed;

static void *allocate(size_t bytes) {
    void *memory = malloc(bytes);
    if (!memory) failed = true;
    return memory;
}

void json_memory_watch(void) { json_set_alloc_funcs(allocate, free); }

void json_memory_reset(void) { failed = false; }

bool json_memory_failed(void) { return failed; }
