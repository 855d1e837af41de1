/* Whatever is asked of a contraction is a position in its order.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/simplify/contraction.h"

#include <stdlib.h>

#include "core/cloud/cloud.h"

size_t contraction_count_for_error(const struct contraction *contraction, double max_error) {
    size_t low = 0, high = contraction->n - 1; /* errors ascend: the first one that is over */
    while (low < high) {
        size_t middle = low + (high - low) / 2;
        if ((double)contraction->error[middle] > max_error)
            high = middle;
        else
            low = middle + 1;
    }
    return contraction->n - low;
}

void contraction_representatives(const struct contraction *contraction, size_t k, uint32_t *representative) {
    size_t n = contraction->n;
    for (size_t i = n; i-- > 0;) { /* whoever a point went into was removed later: its own answer is there already */
        uint32_t p = contraction->order[i];
        representative[p] = n - i <= k ? p : representative[contraction->into[p]];
    }
}

void contraction_done(struct contraction *contraction) {
    if (!contraction) return;
    free(contraction->order);
    free(contraction->into);
    free(contraction->error);
    *contraction = (struct contraction){0};
}
