/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/spatial/kurtosis.h"

#include <math.h>

#include "core/math/sym3.h"

double kurtosis_of_heights(const vec3 *point, const uint32_t *id, unsigned k) {
    vec3 sum = {0, 0, 0}, across;
    sym3 moment = {0};
    double least, squares = 0, fourths = 0;
    for (unsigned i = 0; i < k; i++) {
        vec3 e = vec3_sub(point[id[i]], point[id[0]]);
        sum = vec3_add(sum, e);
        moment = sym3_add(moment, sym3_outer(e));
    }
    vec3 mean = vec3_scale(sum, 1.0 / k);
    moment = sym3_add(moment, sym3_scale(sym3_outer(sum), -1.0 / k));
    sym3_least(&moment, 1, &least, &across);
    for (unsigned i = 0; i < k; i++) {
        double height = vec3_dot(across, vec3_sub(vec3_sub(point[id[i]], point[id[0]]), mean));
        squares += height * height, fourths += height * height * height * height;
    }
    return squares > 0 ? fourths * k / (squares * squares) : INFINITY;
}
