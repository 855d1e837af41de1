/* Makes a clean scan a bad one, so that what denoising does can be measured against the truth.
 *
 *     add_noise IN.ply OUT.ply --noise 0.005 --outliers 0.05 --seed 1
 *
 * Every point is moved by Gaussian noise in all directions, of a standard deviation in each coordinate of `noise` times
 * the diagonal of the bounding box; then `outliers` times as many points are added, spread evenly over that box, each
 * with the other properties of some point of the scan.  The same seed makes the same file.  Faces are left out.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <errno.h>
#include <fcntl.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "core/io/out/write.h"
#include "core/io/read.h"

struct task {
    const char *in, *out;
    double noise, outliers;
    uint64_t seed;
};

/* splitmix64 (Steele, Lea, Flood 2014). */
static uint64_t random_bits(uint64_t *state) {
    uint64_t z = *state += 0x9e3779b97f4a7c15;
    z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9;
    z = (z ^ z >> 27) * 0x94d049bb133111eb;
    return z ^ z >> 31;
}

/* 0 <= x < 1 */
static double random_share(uint64_t *state) { return (double)(random_bits(state) >> 11) * 0x1p-53; }

/* Box and Muller's. */
static double random_gauss(uint64_t *state) {
    double radius = sqrt(-2 * log(1 - random_share(state)));
    return radius * cos(2 * M_PI * random_share(state));
}

static int fail(const char *what, const char *why) {
    fprintf(stderr, "add_noise: %s: %s\n", what, why);
    return 1;
}

static int parse(struct task *task, int argc, char **argv) {
    if (argc < 3 || argc % 2 == 0) return fail("usage", "IN OUT [--noise X] [--outliers X] [--seed N]");
    *task = (struct task){.in = argv[1], .out = argv[2], .seed = 1};
    for (int i = 3; i < argc; i += 2) {
        if (strcmp(argv[i], "--noise") == 0)
            task->noise = strtod(argv[i + 1], NULL);
        else if (strcmp(argv[i], "--outliers") == 0)
            task->outliers = strtod(argv[i + 1], NULL);
        else if (strcmp(argv[i], "--seed") == 0)
            task->seed = strtoull(argv[i + 1], NULL, 10);
        else
            return fail(argv[i], "unknown option");
    }
    return task->noise >= 0 && task->outliers >= 0 ? 0 : fail("usage", "noise and outliers are not negative");
}

/* Gives the cloud room for more points, which are copies of some of the first ones. */
static int grow(struct cloud *cloud, size_t more, uint64_t *state) {
    size_t bytes = cloud->record_bytes, n = cloud->count;
    for (size_t j = 0; j < cloud->property_count; j++)
        if (cloud->property[j].is_list) return fail(cloud->property[j].name, "lists are not supported");
    unsigned char *record = realloc(cloud->record, (n + more) * bytes);
    if (record) cloud->record = record;
    vec3 *position = realloc(cloud->position, (n + more) * sizeof *position);
    if (position) cloud->position = position;
    if (!record || !position) return fail("memory", strerror(ENOMEM));
    for (size_t i = n; i < n + more; i++) {
        size_t model = (size_t)(random_share(state) * (double)n);
        memcpy(&record[i * bytes], &record[model * bytes], bytes);
    }
    cloud->count = n + more;
    return 0;
}

static void disturb(struct cloud *cloud, size_t scanned, const struct task *task, uint64_t *state) {
    vec3 low = cloud->position[0], high = low;
    for (size_t i = 0; i < scanned; i++)
        low = vec3_min(low, cloud->position[i]), high = vec3_max(high, cloud->position[i]);
    vec3 side = vec3_sub(high, low);
    double deviation = task->noise * vec3_length(side);
    for (size_t i = 0; i < scanned; i++) {
        double x = random_gauss(state), y = random_gauss(state), z = random_gauss(state);
        cloud->position[i] = vec3_add(cloud->position[i], vec3_scale((vec3){x, y, z}, deviation));
    }
    for (size_t i = scanned; i < cloud->count; i++) {
        double x = random_share(state), y = random_share(state), z = random_share(state);
        cloud->position[i] = vec3_add(low, (vec3){x * side.x, y * side.y, z * side.z});
    }
    cloud_move(cloud, cloud->position);
}

static int write_file(const char *path, const struct cloud *cloud) {
    struct error error = {0};
    int fd = open(path, O_WRONLY | O_CREAT | O_TRUNC, 0666);
    if (fd < 0) return fail(path, strerror(errno));
    enum status status = cloud_write_ply(fd, cloud, NULL, cloud->count, ENCODING_BINARY, &error);
    if (close(fd) != 0 && !status) return fail(path, strerror(errno));
    return status ? fail(path, error.text) : 0;
}

int main(int argc, char **argv) {
    struct task task;
    struct cloud cloud = {0};
    struct error error = {0};
    if (parse(&task, argc, argv)) return 2;
    if (cloud_read_path(task.in, NULL, NULL, &cloud, &error)) return fail(task.in, error.text);
    uint64_t state = task.seed;
    size_t scanned = cloud.count;
    int rc = grow(&cloud, (size_t)(task.outliers * (double)scanned), &state);
    if (!rc) disturb(&cloud, scanned, &task, &state);
    if (!rc) rc = write_file(task.out, &cloud);
    cloud_done(&cloud);
    return rc;
}
