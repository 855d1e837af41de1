/* Buffered writing to a descriptor, or to memory.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_OUT_SINK_H
#define WHITTLE_CORE_IO_OUT_SINK_H

#include <stddef.h>
#include <sys/types.h>

#include "core/base/status.h"

/* The first failure sticks: later writes do nothing, and sink_done tells. */
struct sink {
    int fd; /* borrowed; -1: memory */
    size_t used, capacity;
    unsigned char *buffer; /* owned */
    int failure;           /* errno of the first write that failed; 0 = none */
};

/* STATUS_NO_MEMORY only, which sink_done tells.  That must follow in any case. */
enum status sink_init(struct sink *sink, int fd) MUST_CHECK;

/* The same to memory, which grows: used bytes of buffer, until sink_done frees them.  Where it can't grow, failure is
 * ENOMEM. */
enum status sink_init_memory(struct sink *sink) MUST_CHECK;

/* Begins again with the memory that there is. */
void sink_restart(struct sink *sink);

/* Room for n bytes (at most 4096), to be filled by the caller and then counted with sink_advance. */
unsigned char *sink_reserve(struct sink *sink, size_t n);
void sink_advance(struct sink *sink, size_t n);

/* Writes n bytes, or a string, or a printf-formatted text of at most 4095 bytes. */
void sink_bytes(struct sink *sink, const void *bytes, size_t n);
void sink_text(struct sink *sink, const char *text);
void sink_format(struct sink *sink, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Writes n bytes over those at `at` of the file, which were written before; where fd stands doesn't change. */
void sink_rewrite(struct sink *sink, const void *bytes, size_t n, off_t at);

/* Writes what is left and frees the buffer; fd stays open.  STATUS_IO with the reason when any write failed.  status is
 * what the caller has so far: when it isn't STATUS_OK, nothing more is written and it is returned. */
enum status sink_done(struct sink *sink, enum status status, struct error *error) MUST_CHECK;

#endif
