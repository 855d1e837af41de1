/* Fuzzes the PLY reader, the header check and the writers.  What reads must also write and read again the same.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include "core/io/formats/ply_header.h"
#include "core/io/out/write.h"
#include "core/io/reader.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void require(int condition) {
    if (!condition) abort();
}

/* NaN's payload is lost in text, so records are compared by value there. */
static int same_scalar(const unsigned char *a, const unsigned char *b, enum scalar_type type, enum encoding encoding) {
    if (memcmp(a, b, scalar_bytes(type)) == 0) return 1;
    return encoding == ENCODING_ASCII && isnan(scalar_load(a, type)) && isnan(scalar_load(b, type));
}

static void compare(const struct cloud *a, const struct cloud *b, enum encoding encoding) {
    require(a->count == b->count && a->record_bytes == b->record_bytes && a->property_count == b->property_count);
    for (size_t j = 0; j < a->property_count; j++) {
        const struct property *p = &a->property[j], *q = &b->property[j];
        require(strcmp(p->name, q->name) == 0 && p->type == q->type && p->is_list == q->is_list);
        for (size_t i = 0; i < a->count; i++) {
            size_t at = i * a->record_bytes + p->offset_bytes;
            if (p->is_list)
                require(p->list_offset[i + 1] == q->list_offset[i + 1]);
            else
                require(same_scalar(a->record + at, b->record + at, p->type, encoding));
        }
    }
}

static void write_and_read_again(const struct cloud *cloud, enum encoding encoding) {
    int fd = memfd_create("fuzz", 0);
    require(fd >= 0);
    require(cloud_write_ply(fd, cloud, NULL, cloud->count, encoding, NULL) == STATUS_OK);
    size_t size = (size_t)lseek(fd, 0, SEEK_END);
    void *map = mmap(NULL, size, PROT_READ, MAP_PRIVATE, fd, 0);
    require(map != MAP_FAILED);
    struct cloud again;
    require(cloud_ply_read(map, size, NULL, NULL, &again, NULL) == STATUS_OK);
    compare(cloud, &again, encoding);
    cloud_done(&again);
    munmap(map, size);
    close(fd);
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    struct cloud cloud = {0};
    struct error error = {0};
    struct ply_summary summary;
    enum status checked = ply_header_check(data, size, size, &summary, &error);
    enum status status =
        cloud_ply_read(data, size, &(struct cloud_limits){.max_points = 1 << 20}, NULL, &cloud, &error);
    require(status == STATUS_OK || error.code == status);
    require(status != STATUS_OK || (checked == STATUS_OK && summary.complete && summary.vertex_count >= cloud.count));
    if (status == STATUS_OK && cloud.count < 1000 && cloud.property_count < 200) {
        write_and_read_again(&cloud, ENCODING_BINARY);
        write_and_read_again(&cloud, ENCODING_ASCII);
    }
    for (size_t t = 0; t < cloud.triangle_count; t++)
        for (int k = 0; k < 3; k++) require(cloud.triangle[t][k] < cloud.count);
    cloud_done(&cloud);
    return 0;
}
