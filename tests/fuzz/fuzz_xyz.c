/* Fuzzes the choice of a format, the XYZ reader and its writer.  What reads must also write and read again the same.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "core/io/out/write.h"
#include "core/io/read.h"
#include "core/io/reader.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void require(int condition) {
    if (!condition) abort();
}

/* Properties may come back in another order: x, y, z first. */
static void compare(const struct cloud *a, const struct cloud *b, bool named) {
    require(a->count == b->count && a->property_count == b->property_count);
    require(memcmp(a->position, b->position, a->count * sizeof *a->position) == 0);
    for (size_t j = 0; j < a->property_count; j++) {
        size_t k = 0;
        while (k < b->property_count && strcmp(a->property[j].name, b->property[k].name) != 0) k++;
        if (named && strncmp(a->property[j].name, "column", 6) != 0) require(k < b->property_count);
    }
}

static void write_and_read_again(const struct cloud *cloud, enum xyz_header header) {
    int fd = memfd_create("fuzz", 0);
    require(fd >= 0);
    require(cloud_write_xyz(fd, cloud, NULL, cloud->count, header, NULL) == STATUS_OK);
    size_t size = (size_t)lseek(fd, 0, SEEK_END);
    void *map = mmap(NULL, size, PROT_READ, MAP_PRIVATE, fd, 0);
    require(map != MAP_FAILED);
    struct cloud again;
    require(cloud_xyz_read(map, size, NULL, NULL, &again, NULL) == STATUS_OK);
    compare(cloud, &again, header != HEADER_NONE);
    cloud_done(&again);
    munmap(map, size);
    close(fd);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    struct cloud cloud = {0};
    struct error error = {0};
    enum status status = cloud_read_memory(data, size, NULL, NULL, &cloud, &error);
    require(status == STATUS_OK || error.code == status);
    cloud_done(&cloud);
    error.code = STATUS_OK;
    status = cloud_xyz_read(data, size, &(struct cloud_limits){.max_points = 1 << 20}, NULL, &cloud, &error);
    require(status == STATUS_OK || error.code == status);
    require(status != STATUS_OK || cloud.count > 0);
    for (int header = HEADER_NONE; header <= HEADER_HASH; header++)
        if (status == STATUS_OK && cloud.count < 1000) write_and_read_again(&cloud, (enum xyz_header)header);
    cloud_done(&cloud);
    return 0;
}
