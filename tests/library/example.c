/* Simplifies a file by libwhittle and prints what came of it: an example of the library, which its tests build.
 *
 *     cc example.c $(pkg-config --cflags --libs whittle) -o example && ./example scan.ply 0.1
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdio.h>
#include <whittle.h>

int main(int argc, char **argv) {
    struct whittle_error error = {WHITTLE_OK, 0, 0, "", ""};
    struct whittle_cloud *cloud = NULL;
    struct whittle_result *result = NULL;
    struct whittle_options *options = whittle_options_new();
    size_t kept = 0, triangles = 0;
    double largest = 0;
    if (argc != 3 || !options) {
        fprintf(stderr, "usage: example FILE RATIO\n");
        return 64;
    }
    if (whittle_cloud_read(argv[1], NULL, NULL, &cloud, &error) ||
        whittle_options_set(options, "ratio", argv[2], &error) ||
        whittle_options_set(options, "outputs", "cloud,mesh", &error) ||
        whittle_simplify(cloud, options, NULL, &result, &error)) {
        fprintf(stderr, "example: %s: %s\n", error.where, error.text);
    } else {
        const uint32_t *id = whittle_result_kept(result, 0, &kept);
        whittle_result_triangles(result, 0, &triangles);
        whittle_result_number(result, 0, "error.symmetric.max", &largest);
        printf("%zu of %zu points, the first is number %u; %zu triangles; largest error %g\n", kept,
               whittle_cloud_count(cloud), (unsigned)id[0], triangles, largest);
    }
    whittle_result_free(result);
    whittle_options_free(options);
    whittle_cloud_free(cloud);
    return error.code ? 1 : 0;
}
