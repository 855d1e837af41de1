/* What every fuzzer of a reader checks.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_TESTS_FUZZ_READER_H
#define WHITTLE_TESTS_FUZZ_READER_H

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "core/io/out/pcd_write.h"
#include "core/io/reader.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static inline void fuzz_require(int condition) {
    if (!condition) abort();
}

/* What a cloud is by its header, whatever it was read from. */
static inline void fuzz_check_cloud(const struct cloud *cloud) {
    size_t bytes = 0;
    fuzz_require(cloud->count > 0 && cloud->property_count >= 3);
    for (size_t j = 0; j < cloud->property_count; j++) {
        fuzz_require(cloud->property[j].offset_bytes == bytes && cloud->property[j].name[0] != '\0');
        bytes += scalar_bytes(cloud->property[j].type);
    }
    fuzz_require(cloud->record_bytes == bytes);
    for (size_t i = 0; i < cloud->count; i++) {
        const unsigned char *record = cloud->record + i * bytes;
        for (int axis = 0; axis < 3; axis++) {
            const struct property *p = &cloud->property[cloud->xyz[axis]];
            double value = (&cloud->position[i].x)[axis];
            fuzz_require(isfinite(value) && scalar_load(record + p->offset_bytes, p->type) == value);
        }
    }
    for (size_t t = 0; t < cloud->triangle_count; t++)
        for (int k = 0; k < 3; k++) fuzz_require(cloud->triangle[t][k] < cloud->count);
}

/* Written as PCD and read again it has the same points. */
static inline void fuzz_write_and_read_again(const struct cloud *cloud) {
    int fd = memfd_create("fuzz", 0);
    fuzz_require(fd >= 0 && cloud_write_pcd(fd, cloud, NULL, cloud->count, PCD_DOUBLE, NULL, NULL) == STATUS_OK);
    size_t size = (size_t)lseek(fd, 0, SEEK_END);
    void *map = mmap(NULL, size, PROT_READ, MAP_PRIVATE, fd, 0);
    struct cloud again;
    fuzz_require(map != MAP_FAILED);
    fuzz_require(cloud_pcd_read(map, size, NULL, NULL, &again, NULL) == STATUS_OK);
    fuzz_require(again.count == cloud->count);
    fuzz_require(memcmp(again.position, cloud->position, cloud->count * sizeof *cloud->position) == 0);
    cloud_done(&again);
    munmap(map, size);
    close(fd);
}

/* The round trip is for names that PCD can hold: "#" begins a comment there, "_" is padding. */
static inline int fuzz_fits_pcd(const struct cloud *cloud) {
    for (size_t j = 0; j < cloud->property_count; j++)
        if (strchr(cloud->property[j].name, '#') || strcmp(cloud->property[j].name, "_") == 0) return 0;
    return 1;
}

static inline int fuzz_reader(enum status (*read)(const void *, size_t, const struct cloud_limits *,
                                                  const struct progress *, struct cloud *, struct error *),
                              const uint8_t *data, size_t size) {
    struct cloud cloud = {0};
    struct error error = {0};
    enum status status =
        read(data, size, &(struct cloud_limits){.max_points = 1 << 20, .threads = 1}, NULL, &cloud, &error);
    fuzz_require(status == STATUS_OK || (error.code == status && error.text[0]));
    fuzz_require(status != STATUS_ENGINE && status != STATUS_IO);
    if (status == STATUS_OK) fuzz_check_cloud(&cloud);
    if (status == STATUS_OK && cloud.count < 1000 && fuzz_fits_pcd(&cloud)) fuzz_write_and_read_again(&cloud);
    cloud_done(&cloud);
    return 0;
}

#endif
