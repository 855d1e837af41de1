/* Pages of E57.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/formats/e57_pages.h"

#include <string.h>
#include <sys/mman.h>

#include "core/base/endian.h"
#include "core/io/codec/crc32.h"
#include "core/io/first_bytes.h"
#include "core/io/reader.h"

enum { PAGE_SIZE_AT = 40, GIVEN_BACK = 4 << 20 /* bytes: whole pages of any machine */ };

uint32_t e57_checksum(const unsigned char *bytes, size_t n) {
    struct crc32 crc;
    crc32_init(&crc, CRC32_CASTAGNOLI);
    return crc32_of(&crc, bytes, n);
}

static uint32_t big_load(const unsigned char *p) {
    return (uint32_t)p[0] << 24 | (uint32_t)p[1] << 16 | (uint32_t)p[2] << 8 | p[3];
}

enum status e57_pages_open(const void *bytes, size_t n, bool gives_back, struct e57_pages *pages, struct error *error) {
    struct crc32 crc;
    const unsigned char *p = bytes;
    if (n < E57_HEADER_BYTES)
        return error_set_at(error, STATUS_MALFORMED, "header", 0, n, "the file ends in its header");
    uint64_t page = load_little_endian(p + PAGE_SIZE_AT, 8);
    if (page != E57_PAGE)
        return error_set_at(error, STATUS_MALFORMED, "header", 0, PAGE_SIZE_AT, "pages of %llu bytes; E57 has %d",
                            (unsigned long long)page, E57_PAGE);
    if (n % E57_PAGE)
        return error_set_at(error, STATUS_MALFORMED, "read", 0, n, "the file ends in the middle of a page");
    crc32_init(&crc, CRC32_CASTAGNOLI);
    for (size_t at = 0; at < n; at += E57_PAGE) {
        if (gives_back && at && at % GIVEN_BACK == 0)
            (void)madvise((unsigned char *)(uintptr_t)bytes + at - GIVEN_BACK, GIVEN_BACK, MADV_DONTNEED);
        if (crc32_of(&crc, p + at, E57_PAYLOAD) != big_load(p + at + E57_PAYLOAD))
            return error_set_at(error, STATUS_MALFORMED, "read", 0, at,
                                "the checksum of page %zu is wrong: the file is damaged", at / E57_PAGE + 1);
    }
    *pages = (struct e57_pages){p, n / E57_PAGE * E57_PAYLOAD};
    return STATUS_OK;
}

uint64_t e57_pages_logical(const struct e57_pages *pages, uint64_t physical) {
    uint64_t in_page = physical % E57_PAGE, logical = physical / E57_PAGE * E57_PAYLOAD + in_page;
    return in_page < E57_PAYLOAD && logical < pages->logical_bytes ? logical : UINT64_MAX;
}

const unsigned char *e57_pages_at(const struct e57_pages *pages, uint64_t logical, size_t *n) {
    size_t in_page = (size_t)(logical % E57_PAYLOAD);
    *n = E57_PAYLOAD - in_page;
    return pages->bytes + logical / E57_PAYLOAD * E57_PAGE + in_page;
}

int e57_pages_copy(const struct e57_pages *pages, uint64_t logical, void *to, size_t n) {
    unsigned char *at = to;
    if (logical > pages->logical_bytes || n > pages->logical_bytes - logical) return 0;
    while (n) {
        size_t there;
        const unsigned char *from = e57_pages_at(pages, logical, &there);
        if (there > n) there = n;
        memcpy(at, from, there);
        at += there, logical += there, n -= there;
    }
    return 1;
}

const char *cloud_e57_look(const struct first_bytes *first) { return first_begins(first, "ASTM-E57", 8) ? "e57" : ""; }
