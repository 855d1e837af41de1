/* The entropy coder of LAZ: an adaptive arithmetic coder, and integers by their distance from a prediction.
 *
 * The coder is Said's (Introduction to Arithmetic Coding, HP Labs 2004, chapter 4): an interval of 32 bits, of which
 * bytes leave at the top.  Models count symbols and turn counts into parts of 2^15 (bits: 2^13) ever more rarely.  What
 * is here is as LAZ has it (LAZ Specification 1.4): the numbers below are its format, none may be tuned.
 *
 * A function that codes runs in both directions: with `write` it takes the value and puts it, else it ignores the value
 * and reads one; either way it returns the value.  So each item is described once (pointwise.c, layered.c), and what is
 * written can't differ from what is read.  `write` is a constant at every call: each item is compiled twice.
 *
 * Reading trusts no byte.  Behind the end zeros are read and counted.  Invariant: low < length, so that no step divides
 * by 0 or leaves its tables, whatever the bytes are; what breaks it is noted in `broken`.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_LAZ_CODER_H
#define WHITTLE_CORE_IO_LAZ_CODER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/base/endian.h"

/* Sanitizers' checks make so much of it that two files took a seventh of the time of compiling everything. */
#ifdef __SANITIZE_ADDRESS__
#define LAZ_CODES static inline
#else
#define LAZ_CODES static inline __attribute__((always_inline))
#endif

/* Bytes that grow.  The first failure sticks. */
struct laz_bytes {
    unsigned char *bytes; /* owned by whoever made it, for free() */
    size_t used, capacity;
    bool failed; /* no memory */
};

void laz_put(struct laz_bytes *out, const void *bytes, size_t n);
void laz_put_number(struct laz_bytes *out, uint64_t value, size_t bytes); /* little endian */

enum { LAZ_LENGTH_LEAST = 1 << 24, LAZ_BIT_PARTS_LOG2 = 13, LAZ_PARTS_LOG2 = 15 };

struct laz_coder {
    uint32_t low; /* reading: how far into the interval the code is; writing: where the interval begins */
    uint32_t length;
    const unsigned char *at, *end; /* reading */
    size_t missing;                /* bytes read behind the end */
    bool broken;                   /* the bytes are no code */
    struct laz_bytes *out;         /* writing */
    size_t out_from;               /* of out's bytes, the first that is this coder's */
};

/* Of a bit. */
struct laz_bit {
    uint32_t zeros, all, part, cycle, left;
};

/* Of a symbol.  data is three arrays: the part of 2^15 below each symbol, how often each came, and, for more than 16
 * symbols, where to begin searching.  left = 0: not begun yet. */
struct laz_model {
    uint16_t *data;
    uint32_t symbols, all, cycle, left, shift;
};

/* Where models' data is laid out: run once with data NULL to count, and again with what `used` was. */
struct laz_room {
    uint16_t *data;
    size_t used;
};

void laz_model_lay(struct laz_model *model, uint32_t symbols, struct laz_room *room);
void laz_models_lay(struct laz_model *model, size_t n, uint32_t symbols, struct laz_room *room);
void laz_model_update(struct laz_model *model); /* begins it where left = 0 */
void laz_bit_update(struct laz_bit *bit);

/* The coder begins at n bytes, or behind what `out` holds. */
struct laz_coder laz_coder_read(const unsigned char *bytes, size_t n);
struct laz_coder laz_coder_write(struct laz_bytes *out);
/* Writes what is left, so that a reader has taken every byte when it has read the last value. */
void laz_coder_finish(struct laz_coder *coder);
void laz_coder_carry(struct laz_coder *coder);

/* ------------------------------------------------------------------------------------------------ symbols */

LAZ_CODES void laz_shift(struct laz_coder *coder, const bool write) {
    while (coder->length < LAZ_LENGTH_LEAST) {
        if (write) {
            laz_put(coder->out, &(unsigned char){(unsigned char)(coder->low >> 24)}, 1);
            coder->low <<= 8;
        } else {
            bool more = coder->at < coder->end;
            coder->low = coder->low << 8 | (more ? *coder->at : 0);
            coder->at += more;
            coder->missing += !more;
        }
        coder->length <<= 8;
    }
}

/* The interval becomes the part of it that begins at `from`. */
LAZ_CODES void laz_narrow(struct laz_coder *coder, uint32_t from, uint32_t length, const bool write) {
    uint32_t before = coder->low;
    coder->low = write ? before + from : before - from;
    coder->length = length;
    if (write && coder->low < before) laz_coder_carry(coder);
    laz_shift(coder, write);
}

LAZ_CODES uint32_t laz_code_bit(struct laz_coder *coder, struct laz_bit *bit, uint32_t value, const bool write) {
    uint32_t border = bit->part * (coder->length >> LAZ_BIT_PARTS_LOG2);
    if (!write) value = coder->low >= border;
    if (value)
        laz_narrow(coder, border, coder->length - border, write);
    else
        laz_narrow(coder, 0, border, write), bit->zeros++;
    if (--bit->left == 0) laz_bit_update(bit);
    return value;
}

/* The symbol whose part this is. */
LAZ_CODES uint32_t laz_find(const struct laz_model *model, uint32_t part) {
    const uint16_t *below = model->data;
    uint32_t symbol = 0, end = model->symbols;
    if (model->shift) {
        const uint16_t *table = model->data + 2 * model->symbols + (part >> model->shift);
        symbol = table[0], end = table[1] + 1u;
    }
    while (end - symbol > 1) {
        uint32_t middle = (symbol + end) / 2;
        if (below[middle] > part)
            end = middle;
        else
            symbol = middle;
    }
    return symbol;
}

/* A symbol beyond the model's is the caller's error. */
LAZ_CODES uint32_t laz_code_symbol(struct laz_coder *coder, struct laz_model *model, uint32_t symbol,
                                   const bool write) {
    if (model->left == 0) laz_model_update(model);
    uint32_t unit = coder->length >> LAZ_PARTS_LOG2;
    if (!write) symbol = laz_find(model, coder->low / unit);
    uint32_t from = model->data[symbol] * unit;
    uint32_t to = symbol + 1 < model->symbols ? model->data[symbol + 1] * unit : coder->length;
    laz_narrow(coder, from, to - from, write);
    model->data[model->symbols + symbol]++;
    if (--model->left == 0) laz_model_update(model);
    return symbol;
}

/* Up to 16 bits, all as likely. */
LAZ_CODES uint32_t laz_code_few(struct laz_coder *coder, unsigned bits, uint32_t value, const bool write) {
    uint32_t unit = coder->length >> bits;
    if (!write) value = coder->low / unit;
    if (value >> bits) { /* behind the last part, where no writer goes */
        coder->broken = true;
        coder->low = value = 0;
    }
    laz_narrow(coder, value * unit, unit, write);
    return value;
}

/* Up to 32 bits; more than 19 in two pieces, the lower 16 first. */
LAZ_CODES uint32_t laz_code_raw(struct laz_coder *coder, unsigned bits, uint32_t value, const bool write) {
    if (bits <= 19) return laz_code_few(coder, bits, value, write);
    uint32_t lower = laz_code_few(coder, 16, value & 0xffff, write);
    return lower | laz_code_few(coder, bits - 16, value >> 16, write) << 16;
}

LAZ_CODES uint64_t laz_code_raw64(struct laz_coder *coder, uint64_t value, const bool write) {
    uint64_t lower = laz_code_raw(coder, 32, (uint32_t)value, write);
    return lower | (uint64_t)laz_code_raw(coder, 32, (uint32_t)(value >> 32), write) << 32;
}

/* ------------------------------------------------------------------------------------------------ integers */

/* Integers of 8, 16 or 32 bits.  What is coded is the difference from a prediction, modulo 2^bits: how many bits it has
 * (by context), and which of those it is: 0 and 1 by a bit, up to 8 bits as a symbol, of more the 8 upper ones as a
 * symbol and the others as they are. */
enum { LAZ_CONTEXTS = 22, LAZ_SYMBOL_BITS = 8 };
struct laz_integer {
    unsigned bits;
    uint32_t k; /* bits of the last difference */
    struct laz_bit one;
    struct laz_model size[LAZ_CONTEXTS];
    struct laz_model upper[33]; /* by k; 1 to `bits` (but for 32) are there */
};

void laz_integer_lay(struct laz_integer *integer, unsigned bits, size_t contexts, struct laz_room *room);
void laz_integer_begin(struct laz_integer *integer);

LAZ_CODES unsigned laz_bits_of(uint32_t difference) {
    int32_t d = (int32_t)difference;
    uint32_t size = d <= 0 ? 0 - difference : difference - 1;
    return size ? 32 - (unsigned)__builtin_clz(size) : 0;
}

/* A difference of k bits, 1 to 31: from -(2^k - 1) to -2^(k-1), and from 2^(k-1) + 1 to 2^k. */
LAZ_CODES uint32_t laz_code_sized(struct laz_coder *coder, struct laz_integer *integer, unsigned k, uint32_t difference,
                                  const bool write) {
    unsigned few = k > LAZ_SYMBOL_BITS ? k - LAZ_SYMBOL_BITS : 0;
    uint32_t half = 1u << (k - 1), place = 0;
    if (write) place = (int32_t)difference < 0 ? difference + (2 * half - 1) : difference - 1;
    uint32_t upper = laz_code_symbol(coder, &integer->upper[k], place >> few, write);
    if (few) upper = upper << few | laz_code_raw(coder, few, place & ((1u << few) - 1), write);
    return upper >= half ? upper + 1 : upper - (2 * half - 1);
}

/* The integer, as its lowest `bits` bits; 32 of them are two's complement. */
LAZ_CODES uint32_t laz_code_integer(struct laz_coder *coder, struct laz_integer *integer, uint32_t predicted,
                                    size_t context, uint32_t value, const bool write) {
    const unsigned bits = integer->bits;
    const uint32_t mask = bits < 32 ? (1u << bits) - 1 : UINT32_MAX;
    uint32_t difference = value - predicted;
    if (write && bits < 32) { /* of those that are the same modulo 2^bits, the one around 0 */
        difference &= mask;
        if (difference >> (bits - 1)) difference -= mask + 1;
    }
    unsigned k = laz_code_symbol(coder, &integer->size[context], write ? laz_bits_of(difference) : 0, write);
    integer->k = k;
    if (k == 0)
        difference = laz_code_bit(coder, &integer->one, difference, write);
    else if (k < 32)
        difference = laz_code_sized(coder, integer, k, difference, write);
    else
        difference = 1u << 31;
    return (predicted + difference) & mask;
}

#endif
