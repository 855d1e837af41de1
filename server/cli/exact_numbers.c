/* GMP has no way to tell its caller that memory has run out, and nothing may be thrown through it.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/cli/cli_internal.h"

#include <gmp.h>
#include <stdlib.h>

static void (*end_without_memory)(void);

static void *there_is(void *memory) {
    if (!memory) end_without_memory();
    return memory;
}

static void *allocate(size_t bytes) { return there_is(malloc(bytes)); }

static void *resize(void *memory, size_t old_bytes, size_t bytes) {
    (void)old_bytes;
    return there_is(realloc(memory, bytes));
}

static void release(void *memory, size_t bytes) {
    (void)bytes;
    free(memory);
}

void command_exact_numbers_end_by(void (*end)(void)) {
    end_without_memory = end;
    mp_set_memory_functions(allocate, resize, release);
}
