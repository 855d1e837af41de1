/* Fuzzes the E57 reader: as the bytes are, and as whole pages with the right checksums, or nothing would ever get past
 * these.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/formats/e57_pages.h"
#include "core/io/reader.h"
#include "tests/fuzz/fuzz_reader.h"

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size) {
    size_t whole = (size + E57_PAGE - 1) / E57_PAGE * E57_PAGE;
    (void)fuzz_reader(cloud_e57_read, data, size);
    if (whole == 0) return 0;
    uint8_t *pages = calloc(whole, 1);
    fuzz_require(pages != NULL);
    memcpy(pages, data, size);
    for (size_t at = 0; at < whole; at += E57_PAGE) {
        uint32_t sum = e57_checksum(pages + at, E57_PAYLOAD);
        for (int k = 0; k < 4; k++) pages[at + E57_PAYLOAD + (size_t)k] = (uint8_t)(sum >> 8 * (3 - k));
    }
    (void)fuzz_reader(cloud_e57_read, pages, whole);
    free(pages);
    return 0;
}
