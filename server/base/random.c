/* The kernel's generator; it waits for its first seed when the machine has just started.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "server/base/random.h"

#include <assert.h>
#include <errno.h>
#include <stdint.h>
#include <stdio.h>
#include <sys/random.h>

void random_fill(void *bytes, size_t n) {
    assert(n <= RANDOM_MOST_BYTES);
    ssize_t filled;
    do filled = getrandom(bytes, n, 0);
    while (filled < 0 && errno == EINTR);
    assert(filled == (ssize_t)n);
}

void random_name(char name[RANDOM_NAME_BYTES]) {
    uint64_t random[2];
    random_fill(random, sizeof random);
    snprintf(name, RANDOM_NAME_BYTES, "%016llx%016llx", (unsigned long long)random[0], (unsigned long long)random[1]);
}
