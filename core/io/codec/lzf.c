/* LZF.
 *
 *     data    = { literal | copy }
 *     literal = 000nnnnn, n + 1 bytes
 *     copy    = nnnooooo [more], oooooooo      n from 1 to 6: n + 2 bytes, from o + 1 bytes back (o: 13 bits)
 *     more    = a byte that is added to n, where n is 7
 *
 * A copy may reach into what it writes itself.  Invariant: from <= end, made <= bytes.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/codec/lzf.h"

#include <string.h>

enum { LITERAL_LIMIT = 32, LONG_COPY = 7 };

struct unpack {
    const unsigned char *from, *end;
    unsigned char *to;
    size_t made, bytes;
};

static bool take_literal(struct unpack *u, size_t n) {
    if ((size_t)(u->end - u->from) < n || u->bytes - u->made < n) return false;
    memcpy(u->to + u->made, u->from, n);
    u->from += n;
    u->made += n;
    return true;
}

static bool take_copy(struct unpack *u, unsigned control) {
    size_t n = control >> 5, back = (size_t)(control & 31) << 8;
    if (n == LONG_COPY) {
        if (u->from == u->end) return false;
        n += *u->from++;
    }
    if (u->from == u->end) return false;
    back += (size_t)*u->from++ + 1;
    n += 2;
    if (back > u->made || u->bytes - u->made < n) return false;
    for (size_t i = 0; i < n; i++, u->made++) u->to[u->made] = u->to[u->made - back];
    return true;
}

bool lzf_decompress(const void *packed, size_t n, void *to, size_t bytes) {
    struct unpack u = {packed, (const unsigned char *)packed + n, to, 0, bytes};
    while (u.from < u.end) {
        unsigned control = *u.from++;
        if (!(control < LITERAL_LIMIT ? take_literal(&u, control + 1) : take_copy(&u, control))) return false;
    }
    return u.made == bytes;
}
