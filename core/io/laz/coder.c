/* SPDX-License-Identifier: GPL-3.0-or-later */
#include "core/io/laz/coder.h"

#include <string.h>

#include "core/base/alloc.h"

enum { BIT_COUNT_MOST = 1 << LAZ_BIT_PARTS_LOG2, BIT_CYCLE_MOST = 64, COUNT_MOST = 1 << LAZ_PARTS_LOG2 };
enum { SEARCHED_SYMBOLS = 16, FIRST_CAPACITY = 65536 };

void laz_put(struct laz_bytes *out, const void *bytes, size_t n) {
    if (n == 0) return; /* bytes may be NULL then */
    if (out->capacity - out->used < n) {
        size_t capacity = out->capacity + out->capacity / 2 + n + FIRST_CAPACITY;
        unsigned char *grown = out->failed ? NULL : alloc_resize(out->bytes, capacity, 1);
        out->failed = !grown;
        if (!grown) return;
        out->bytes = grown;
        out->capacity = capacity;
    }
    memcpy(out->bytes + out->used, bytes, n);
    out->used += n;
}

void laz_put_number(struct laz_bytes *out, uint64_t value, size_t bytes) {
    unsigned char little[8];
    for (size_t i = 0; i < bytes; i++) little[i] = (unsigned char)(value >> 8 * i);
    laz_put(out, little, bytes);
}

/* ------------------------------------------------------------------------------------------------ models */

/* Of the table of a model with more than 16 symbols: 2^this entries, and two. */
static unsigned table_log2(uint32_t symbols) {
    unsigned log2 = 3;
    while (symbols > 1u << (log2 + 2)) log2++;
    return log2;
}

void laz_model_lay(struct laz_model *model, uint32_t symbols, struct laz_room *room) {
    bool has_table = symbols > SEARCHED_SYMBOLS;
    *model = (struct laz_model){.data = room->data ? room->data + room->used : NULL,
                                .symbols = symbols,
                                .shift = has_table ? LAZ_PARTS_LOG2 - table_log2(symbols) : 0};
    room->used += 2 * (size_t)symbols + (has_table ? ((size_t)1 << table_log2(symbols)) + 2 : 0);
}

void laz_models_lay(struct laz_model *model, size_t n, uint32_t symbols, struct laz_room *room) {
    for (size_t i = 0; i < n; i++) laz_model_lay(&model[i], symbols, room);
}

static void fill_table(const struct laz_model *model) {
    const uint16_t *below = model->data;
    uint16_t *table = model->data + 2 * model->symbols;
    uint32_t entries = 1u << (LAZ_PARTS_LOG2 - model->shift), symbol = 0;
    for (uint32_t entry = 0; entry < entries; entry++) {
        while (symbol + 1 < model->symbols && below[symbol + 1] <= entry << model->shift) symbol++;
        table[entry] = (uint16_t)symbol;
    }
    table[entries] = table[entries + 1] = (uint16_t)(model->symbols - 1);
}

void laz_model_update(struct laz_model *model) {
    uint16_t *below = model->data, *count = model->data + model->symbols;
    bool begins = model->all == 0;
    if (begins) {
        for (uint32_t i = 0; i < model->symbols; i++) count[i] = 1;
        model->cycle = model->symbols;
    }
    model->all += model->cycle;
    if (model->all > COUNT_MOST) {
        model->all = 0;
        for (uint32_t i = 0; i < model->symbols; i++) model->all += count[i] = (uint16_t)((count[i] + 1) / 2);
    }
    uint32_t scale = (1u << 31) / model->all, sum = 0, cycle_most = 8 * (model->symbols + 6);
    for (uint32_t i = 0; i < model->symbols; i++) {
        below[i] = (uint16_t)((scale * sum) >> (31 - LAZ_PARTS_LOG2));
        sum += count[i];
    }
    if (model->shift) fill_table(model);
    model->cycle = begins ? (model->symbols + 6) / 2 : 5 * model->cycle / 4;
    if (model->cycle > cycle_most) model->cycle = cycle_most;
    model->left = model->cycle;
}

void laz_bit_update(struct laz_bit *bit) {
    bit->all += bit->cycle;
    if (bit->all > BIT_COUNT_MOST) {
        bit->all = (bit->all + 1) / 2;
        bit->zeros = (bit->zeros + 1) / 2;
        if (bit->zeros == bit->all) bit->all++;
    }
    bit->part = ((1u << 31) / bit->all * bit->zeros) >> (31 - LAZ_BIT_PARTS_LOG2);
    bit->cycle = 5 * bit->cycle / 4;
    if (bit->cycle > BIT_CYCLE_MOST) bit->cycle = BIT_CYCLE_MOST;
    bit->left = bit->cycle;
}

static unsigned last_upper(const struct laz_integer *integer) { return integer->bits < 32 ? integer->bits : 31; }

void laz_integer_lay(struct laz_integer *integer, unsigned bits, size_t contexts, struct laz_room *room) {
    integer->bits = bits;
    laz_models_lay(integer->size, contexts, bits + 1, room);
    for (unsigned k = 1; k <= last_upper(integer); k++)
        laz_model_lay(&integer->upper[k], 1u << (k < LAZ_SYMBOL_BITS ? k : LAZ_SYMBOL_BITS), room);
}

void laz_integer_begin(struct laz_integer *integer) {
    integer->k = 0;
    integer->one = (struct laz_bit){.zeros = 1, .all = 2, .part = BIT_COUNT_MOST / 2, .cycle = 4, .left = 4};
    for (size_t i = 0; i < LAZ_CONTEXTS; i++) integer->size[i].left = integer->size[i].all = 0;
    for (unsigned k = 1; k <= last_upper(integer); k++) integer->upper[k].left = integer->upper[k].all = 0;
}

/* ------------------------------------------------------------------------------------------------ begin, end */

struct laz_coder laz_coder_read(const unsigned char *bytes, size_t n) {
    struct laz_coder coder = {.length = 1, .at = bytes, .end = bytes + n};
    for (int i = 0; i < 4; i++) {
        bool more = coder.at < coder.end;
        coder.low = coder.low << 8 | (more ? *coder.at : 0);
        coder.at += more;
        coder.missing += !more;
    }
    coder.length = UINT32_MAX;
    if (coder.low == coder.length) coder.broken = true, coder.low = 0;
    return coder;
}

struct laz_coder laz_coder_write(struct laz_bytes *out) {
    return (struct laz_coder){.length = UINT32_MAX, .out = out, .out_from = out->used};
}

void laz_coder_carry(struct laz_coder *coder) {
    struct laz_bytes *out = coder->out;
    size_t at = out->used;
    while (at > coder->out_from && ++out->bytes[--at] == 0) {
    }
}

void laz_coder_finish(struct laz_coder *coder) {
    static const unsigned char zeros[3];
    bool long_end = coder->length > 2u * LAZ_LENGTH_LEAST;
    if (long_end)
        laz_narrow(coder, LAZ_LENGTH_LEAST, LAZ_LENGTH_LEAST >> 1, true);
    else
        laz_narrow(coder, LAZ_LENGTH_LEAST >> 1, LAZ_LENGTH_LEAST >> 9, true);
    laz_put(coder->out, zeros, long_end ? 3 : 2);
}
