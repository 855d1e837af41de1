/* Files without a name, for what is decompressed and doesn't fit into memory: pages of them that are mapped can always
 * be written back.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_TEMPORARY_H
#define WHITTLE_CORE_IO_TEMPORARY_H

#include <stddef.h>

#include "core/base/status.h"
#include "core/io/codec/inflate.h"

/* Decompresses the n bytes at `packed` into such a file of the folder, which is mapped: *map, *bytes of it, for munmap.
 * STATUS_NO_SPACE, STATUS_IO, statuses of inflate_push. */
enum status temporary_inflate(const char *folder, enum inflate_kind kind, const void *packed, size_t n,
                              unsigned char **map, size_t *bytes, struct error *error) MUST_CHECK;

/* Maps a file of n zeros that can be written to. */
enum status temporary_map(const char *folder, size_t n, unsigned char **map, struct error *error) MUST_CHECK;

#endif
