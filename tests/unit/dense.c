/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "tests/unit/dense.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#include "core/spatial/knn.h"

struct dense dense_new(size_t n) {
    struct dense dense = {n, calloc(n, sizeof(vec3)), calloc(n, sizeof(vec3)), calloc(n, sizeof(float))};
    assert_true(dense.point && dense.normal && dense.spacing);
    return dense;
}

void dense_done(struct dense *dense) { free(dense->point), free(dense->normal), free(dense->spacing); }

struct refine_input dense_input(const struct dense *dense) {
    return (struct refine_input){
        .points = dense->point, .normals = dense->normal, .spacing = dense->spacing, .n = dense->n};
}

struct dense dense_field(size_t side, double (*f)(double x, double y)) {
    struct dense dense = dense_new(side * side);
    for (size_t i = 0; i < side * side; i++) {
        double x = (double)(i % side) / (double)(side - 1), y = (double)(i / side) / (double)(side - 1), e = 1e-6;
        dense.point[i] = (vec3){x, y, f(x, y)};
        dense.normal[i] =
            vec3_unit((vec3){(f(x - e, y) - f(x + e, y)) / (2 * e), (f(x, y - e) - f(x, y + e)) / (2 * e), 1});
        dense.spacing[i] = 1.0f / (float)(side - 1);
    }
    return dense;
}

double dense_flat(double x, double y) { return 0 * x * y; }

struct neighbourhood dense_neighbourhood(const struct dense *dense) {
    struct knn *knn = NULL;
    struct error error;
    struct neighbourhood neighbours;
    struct neighbourhood_options options = {3, 6, 16, 1};
    assert_int_equal(knn_new(dense->point, dense->n, 1, &knn, &error), STATUS_OK);
    assert_int_equal(neighbourhood_find(knn, dense->point, dense->n, &options, &neighbours), STATUS_OK);
    knn_free(knn);
    return neighbours;
}
