/* From the creases among the original points to those among the ones to be meshed.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/surface/cocone/cocone_internal.h"

#include <string.h>

#include "core/base/alloc.h"

enum status cocone_creases_find(const struct reconstruct_input *input, struct creases *creases) {
    const struct reconstruct_dense *dense = input->dense;
    *creases = (struct creases){.of = NULL};
    if (!dense || !dense->site || !dense->creases || !dense->creases->of) return STATUS_OK;
    uint32_t *of = alloc_array(input->n, sizeof *of);
    if (!of) return STATUS_NO_MEMORY;
    memset(of, 0xff, input->n * sizeof *of);
    for (size_t x = 0; x < dense->n; x++) {
        uint32_t site = dense->site[x];
        if (vec3_equal(dense->point[x], input->points[site])) of[site] = dense->creases->of[x];
    }
    *creases = (struct creases){.of = of, .at = dense->creases->at};
    return STATUS_OK;
}
