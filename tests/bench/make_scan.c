/* Writes a synthetic scan: make_scan POINTS [SEED [NOISE]] > scan.ply
 *
 * A closed surface with features: a sphere with bumps, a groove and a flattened cap with a sharp rim, sampled unevenly
 * (twice as dense on one side) and with noise of a tenth of the spacing, or of NOISE of it: with 0 the same points on
 * the surface.  The same bytes for the same arguments.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

static uint64_t next(uint64_t *state) { /* splitmix64 */
    uint64_t z = *state += 0x9e3779b97f4a7c15;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9;
    z = (z ^ z >> 27) * 0x94d049bb133111eb;
    return z ^ z >> 31;
}

static double unit(uint64_t *state) { return (double)(next(state) >> 11) * 0x1p-53; }

/* Distance of the surface from the centre in the direction (x, y, z). */
static double radius(double x, double y, double z) {
    double bumps = 0.03 * sin(9 * x) * sin(8 * y + 1) * sin(7 * z + 2);
    double groove = -0.06 * exp(-pow((x + 0.3 * z) / 0.05, 2));
    double r = 1 + bumps + groove;
    return z > 0 && r * z > 0.8 ? 0.8 / z : r; /* the cap */
}

int main(int argc, char **argv) {
    if (argc < 2 || argc > 4) {
        fprintf(stderr, "Usage: make_scan POINTS [SEED [NOISE]] > scan.ply\n");
        return 2;
    }
    size_t n = strtoull(argv[1], NULL, 10);
    uint64_t state = argc > 2 ? strtoull(argv[2], NULL, 10) : 1;
    double noise = (argc > 3 ? strtod(argv[3], NULL) : 0.1) * sqrt(4 * M_PI / (double)(n ? n : 1));
    printf("ply\nformat binary_little_endian 1.0\nelement vertex %zu\n"
           "property float x\nproperty float y\nproperty float z\nend_header\n",
           n);
    for (size_t i = 0; i < n;) {
        double z = 2 * unit(&state) - 1, angle = 2 * M_PI * unit(&state), s = sqrt(1 - z * z);
        double x = s * cos(angle), y = s * sin(angle);
        if (unit(&state) > 0.75 + 0.25 * x) continue; /* denser towards +x */
        double r = radius(x, y, z) + noise * (unit(&state) + unit(&state) + unit(&state) - 1.5);
        float p[3] = {(float)(r * x), (float)(r * y), (float)(r * z)};
        if (fwrite(p, sizeof p, 1, stdout) != 1) return 1;
        i++;
    }
    return fclose(stdout) != 0;
}
