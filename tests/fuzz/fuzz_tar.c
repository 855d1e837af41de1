/* Fuzzes the reader of tar archives, and with it joining.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/reader.h"
#include "tests/fuzz/fuzz_reader.h"

/* Lists have no bytes in a record; all else is as of any reader. */
int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    struct cloud cloud = {0};
    struct error error = {0};
    enum status status =
        cloud_tar_read(data, size, &(struct cloud_limits){.max_points = 1 << 20, .threads = 1}, NULL, &cloud, &error);
    fuzz_require(status == STATUS_OK || (error.code == status && error.text[0]));
    fuzz_require(status != STATUS_ENGINE && status != STATUS_IO);
    if (status == STATUS_OK) {
        size_t bytes = 0;
        fuzz_require(cloud.count > 0 && cloud.property_count >= 3);
        for (size_t j = 0; j < cloud.property_count; j++) {
            const struct property *p = &cloud.property[j];
            fuzz_require(p->name[0] != '\0' && (p->is_list || p->offset_bytes == bytes));
            if (p->is_list) fuzz_require(p->list_offset[0] == 0);
            for (size_t i = 0; p->is_list && i < cloud.count; i++)
                fuzz_require(p->list_offset[i] <= p->list_offset[i + 1]);
            if (!p->is_list) bytes += scalar_bytes(p->type);
        }
        fuzz_require(cloud.record_bytes == bytes);
        for (size_t t = 0; t < cloud.triangle_count; t++)
            for (int k = 0; k < 3; k++) fuzz_require(cloud.triangle[t][k] < cloud.count);
    }
    cloud_done(&cloud);
    return 0;
}
