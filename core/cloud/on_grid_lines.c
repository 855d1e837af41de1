/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/cloud/on_grid_lines.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/base/hash64.h"
#include "core/base/radix.h"

enum { MANY = 8 /* points of one coordinate: those of a plane of the grid */, ON_LINE = 2 /* planes */ };
static const double NEARLY_ALL = 0.9;

static uint32_t hash_of(double coordinate) {
    uint64_t bits;
    coordinate += 0.0; /* there are two zeros */
    memcpy(&bits, &coordinate, sizeof bits);
    return (uint32_t)(hash64(bits) >> 32);
}

static void count_planes(const uint64_t *sorted, size_t n, uint8_t *planes) {
    for (size_t first = 0, end; first < n; first = end) {
        for (end = first + 1; end < n && radix_key(sorted[end]) == radix_key(sorted[first]);) end++;
        for (size_t i = first; end - first >= MANY && i < end; i++) planes[radix_value(sorted[i])]++;
    }
}

enum status on_grid_lines(const vec3 *point, size_t n, unsigned threads, bool *are) {
    uint64_t *item = alloc_array(n, sizeof *item), *spare = alloc_array(n, sizeof *spare);
    uint8_t *planes = alloc_zeroed(n, 1);
    size_t count = 0;
    enum status status = item && spare && planes ? STATUS_OK : STATUS_NO_MEMORY;
    for (int axis = 0; axis < 3 && !status; axis++) {
        for (size_t i = 0; i < n; i++) {
            const double coordinate[3] = {point[i].x, point[i].y, point[i].z};
            item[i] = radix_item(hash_of(coordinate[axis]), (uint32_t)i);
        }
        count_planes(radix_sort(item, spare, n, threads), n, planes);
    }
    for (size_t i = 0; i < n && !status; i++) count += planes[i] >= ON_LINE;
    *are = !status && (double)count > NEARLY_ALL * (double)n;
    free(item), free(spare), free(planes);
    return status;
}
