/* The file that an E57 file holds: pages without their checksums, one behind the other.
 *
 * A physical page is 1024 bytes: 1020 of the logical file, and the CRC-32C of these, big endian (ASTM E2807, 6.1).
 * Offsets that the file tells are physical ones.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_FORMATS_E57_PAGES_H
#define WHITTLE_CORE_IO_FORMATS_E57_PAGES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/status.h"

enum { E57_PAGE = 1024, E57_PAYLOAD = 1020, E57_HEADER_BYTES = 48 };

struct e57_pages {
    const unsigned char *bytes; /* borrowed */
    uint64_t logical_bytes;     /* of the whole pages that are there */
};

/* CRC-32C (Castagnoli) of n bytes. */
uint32_t e57_checksum(const unsigned char *bytes, size_t n);

/* The pages of a file of n bytes, every checksum compared.  gives_back: the bytes are a mapping of the file's, whose
 * pages needn't stay in memory once they were looked at.  STATUS_MALFORMED with the page's offset. */
enum status e57_pages_open(const void *bytes, size_t n, bool gives_back, struct e57_pages *pages,
                           struct error *error) MUST_CHECK;

/* The logical offset of a physical one; UINT64_MAX where it is in no page's payload. */
uint64_t e57_pages_logical(const struct e57_pages *pages, uint64_t physical);

/* The bytes from a logical offset (< logical_bytes) to the end of its page; *n = how many. */
const unsigned char *e57_pages_at(const struct e57_pages *pages, uint64_t logical, size_t *n);

/* Copies n bytes from a logical offset; false where they aren't all there. */
int e57_pages_copy(const struct e57_pages *pages, uint64_t logical, void *to, size_t n);

#endif
