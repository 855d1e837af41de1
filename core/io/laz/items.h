/* Between the files of this folder: the items that a point of LAZ is made of, and what codes them.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#ifndef WHITTLE_CORE_IO_LAZ_ITEMS_H
#define WHITTLE_CORE_IO_LAZ_ITEMS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "core/io/laz/coder.h"
#include "core/io/laz/laz.h"

/* Types of items, as files number them. */
enum laz_type {
    LAZ_BYTES = 0,
    LAZ_POINT10 = 6, /* the 20 bytes that formats 0 to 5 begin with */
    LAZ_TIME11 = 7,
    LAZ_RGB12 = 8,
    LAZ_WAVE13 = 9,
    LAZ_POINT14 = 10, /* the 30 bytes that formats 6 to 10 begin with */
    LAZ_RGB14 = 11,
    LAZ_RGBNIR14 = 12,
    LAZ_WAVE14 = 13,
    LAZ_BYTES14 = 14
};

/* Points one after the other, in one coder.  lay as laz_room says; begin with the first point of a chunk, as it is;
 * code the others, of layout->record_bytes each. */
struct laz_pointwise;
struct laz_pointwise *laz_pointwise_new(const struct laz_layout *layout);
void laz_pointwise_free(struct laz_pointwise *pointwise);
void laz_pointwise_begin(struct laz_pointwise *pointwise, const unsigned char *first);
void laz_pointwise_read(struct laz_pointwise *pointwise, struct laz_coder *coder, unsigned char *record);
void laz_pointwise_write(struct laz_pointwise *pointwise, struct laz_coder *coder, const unsigned char *record);

/* Points in layers, each with a coder of its own: laz_layers of them, in the file's order. */
struct laz_layered;
size_t laz_layers(const struct laz_layout *layout);
struct laz_layered *laz_layered_new(const struct laz_layout *layout);
void laz_layered_free(struct laz_layered *layered);
void laz_layered_begin(struct laz_layered *layered, const unsigned char *first);
/* Of a layer that isn't there (bytes 0) all values are as the last ones. */
void laz_layered_read_layer(struct laz_layered *layered, size_t layer, const unsigned char *bytes, size_t n);
void laz_layered_read(struct laz_layered *layered, unsigned char *record);
/* The coder of a layer: what is missing, left or broken in it. */
const struct laz_coder *laz_layered_coder(const struct laz_layered *layered, size_t layer);
void laz_layered_write(struct laz_layered *layered, const unsigned char *record);
/* Appends the sizes of all layers, and the layers.  Those that never changed are left out. */
void laz_layered_finish(struct laz_layered *layered, struct laz_bytes *out);

/* ------------------------------------------------------------------------------------------------ bytes */

static inline uint32_t laz_load16(const unsigned char *p) { return p[0] | (uint32_t)p[1] << 8; }
static inline uint32_t laz_load32(const unsigned char *p) { return laz_load16(p) | laz_load16(p + 2) << 16; }
static inline uint64_t laz_load64(const unsigned char *p) { return laz_load32(p) | (uint64_t)laz_load32(p + 4) << 32; }
static inline void laz_store16(unsigned char *p, uint32_t value) {
    p[0] = (unsigned char)value, p[1] = (unsigned char)(value >> 8);
}
static inline void laz_store32(unsigned char *p, uint32_t value) {
    laz_store16(p, value), laz_store16(p + 2, value >> 16);
}
static inline void laz_store64(unsigned char *p, uint64_t value) {
    laz_store32(p, (uint32_t)value), laz_store32(p + 4, (uint32_t)(value >> 32));
}

/* ------------------------------------------------------------------------------------------------ shared parts */

/* The middle of the last five differences, about: of five in order the largest or the smallest makes room, in turns
 * that change when one comes at the other side of the middle. */
struct laz_median {
    int32_t value[5];
    bool drops_smallest;
};

static inline void laz_median_add(struct laz_median *median, int32_t value) {
    int32_t *v = median->value, middle = v[2];
    if (median->drops_smallest) {
        int i = 0;
        for (; i < 4 && v[i + 1] < value; i++) v[i] = v[i + 1];
        v[i] = value;
        if (value <= middle) median->drops_smallest = false;
    } else {
        int i = 4;
        for (; i > 0 && v[i - 1] > value; i--) v[i] = v[i - 1];
        v[i] = value;
        if (value >= middle) median->drops_smallest = true;
    }
}

/* Contexts of Y and Z: how many bits the differences before had, in pairs. */
static inline size_t laz_size_context(uint32_t k, uint32_t most) { return k < most ? k & ~1u : most; }

/* Colours of 16 bits in bytes: which have changed is one symbol; green and blue are predicted from what red did. */
struct laz_rgb {
    struct laz_model used, byte[6];
};

static inline uint32_t laz_clamp(int32_t value) { return value < 0 ? 0 : value > 255 ? 255 : (uint32_t)value; }

LAZ_CODES uint32_t laz_code_byte(struct laz_coder *coder, struct laz_model *model, uint32_t predicted, uint32_t value,
                                 const bool write) {
    return (predicted + laz_code_symbol(coder, model, (value - predicted) & 255, write)) & 255;
}

/* The low byte of the first, its high one, the low one of the second ... */
static inline uint32_t laz_colour_byte(const uint16_t *colour, unsigned i) {
    return (uint32_t)colour[i / 2] >> 8 * (i % 2) & 255;
}

/* colour: three of them, taken or set; last: of the point before. */
LAZ_CODES void laz_code_rgb(struct laz_coder *coder, struct laz_rgb *rgb, const uint16_t last[3], uint16_t colour[3],
                            const bool write) {
    enum { GREY = 64 }; /* the bit that is set where the three aren't the same */
    uint32_t used = 0, now[6], before[6];
    for (unsigned i = 0; i < 6; i++) { /* low and high byte of red, then of green, then of blue */
        before[i] = laz_colour_byte(last, i);
        now[i] = write ? laz_colour_byte(colour, i) : before[i];
        used |= (uint32_t)(now[i] != before[i]) << i;
    }
    if (write && (now[0] != now[2] || now[0] != now[4] || now[1] != now[3] || now[1] != now[5])) used |= GREY;
    used = laz_code_symbol(coder, &rgb->used, used, write);
    for (unsigned i = 0; i < 2; i++)
        if (used >> i & 1) now[i] = laz_code_byte(coder, &rgb->byte[i], before[i], now[i], write);
    for (unsigned i = 0; i < 2; i++) {
        if (!(used & GREY)) {
            now[2 + i] = now[4 + i] = now[i];
            continue;
        }
        int32_t step = (int32_t)now[i] - (int32_t)before[i];
        if (used >> (2 + i) & 1)
            now[2 + i] =
                laz_code_byte(coder, &rgb->byte[2 + i], laz_clamp(step + (int32_t)before[2 + i]), now[2 + i], write);
        if (used >> (4 + i) & 1) {
            step = (step + (int32_t)now[2 + i] - (int32_t)before[2 + i]) / 2;
            now[4 + i] =
                laz_code_byte(coder, &rgb->byte[4 + i], laz_clamp(step + (int32_t)before[4 + i]), now[4 + i], write);
        }
    }
    if (write) return;
    for (unsigned i = 0; i < 3; i++) colour[i] = (uint16_t)(now[2 * i] | now[2 * i + 1] << 8);
}

void laz_rgb_lay(struct laz_rgb *rgb, struct laz_room *room);
void laz_rgb_begin(struct laz_rgb *rgb);

/* The description of a waveform packet: its number, where it lies, its size, four floats by their bits. */
enum { LAZ_WAVE_BYTES = 29 };
struct laz_wave {
    struct laz_model index, step[4];
    struct laz_integer offset, size, location, xyz;
    uint32_t last_step, last_offset_step;
    unsigned char last[LAZ_WAVE_BYTES];
};

LAZ_CODES void laz_code_wave(struct laz_coder *coder, struct laz_wave *wave, const unsigned char *last,
                             unsigned char *item, const bool write) {
    enum { SAME, BEHIND, NEAR, ANYWHERE };
    uint64_t before = laz_load64(last + 1), offset = write ? laz_load64(item + 1) : 0;
    uint32_t size = laz_load32(last + 9), step = ANYWHERE, difference = (uint32_t)(offset - before);
    if (offset - before == (uint64_t)(int64_t)(int32_t)difference) step = NEAR;
    if (offset - before == size) step = BEHIND;
    if (offset == before) step = SAME;
    item[0] = (unsigned char)laz_code_symbol(coder, &wave->index, item[0], write);
    step = wave->last_step = laz_code_symbol(coder, &wave->step[wave->last_step], step, write);
    if (step == SAME) offset = before;
    if (step == BEHIND) offset = before + size;
    if (step == NEAR) {
        difference = laz_code_integer(coder, &wave->offset, wave->last_offset_step, 0, difference, write);
        wave->last_offset_step = difference;
        offset = before + (uint64_t)(int64_t)(int32_t)difference;
    }
    if (step == ANYWHERE) offset = laz_code_raw64(coder, offset, write);
    laz_store64(item + 1, offset);
    laz_store32(item + 9, laz_code_integer(coder, &wave->size, size, 0, laz_load32(item + 9), write));
    laz_store32(item + 13,
                laz_code_integer(coder, &wave->location, laz_load32(last + 13), 0, laz_load32(item + 13), write));
    for (size_t axis = 0; axis < 3; axis++) {
        size_t at = 17 + 4 * axis;
        laz_store32(item + at,
                    laz_code_integer(coder, &wave->xyz, laz_load32(last + at), axis, laz_load32(item + at), write));
    }
}

void laz_wave_lay(struct laz_wave *wave, struct laz_room *room);
void laz_wave_begin(struct laz_wave *wave, const unsigned char *first);

void laz_models_begin(struct laz_model *model, size_t n);

/* The time: four sequences at once; in each the last step, of which the next one is a multiple, most often once. */
struct laz_time {
    struct laz_model first_step, multiple;
    struct laz_integer step;
    unsigned now, newest;
    uint64_t last[4];
    uint32_t last_step[4];
    unsigned extremes[4];
};

/* Item 7 and item 10 number their symbols differently: item 10 tells elsewhere that the time is the same. */
enum { LAZ_TIME_MOST = 500, LAZ_TIME_LEAST = -10 };

void laz_time_lay(struct laz_time *time, bool tells_same, struct laz_room *room);
void laz_time_begin(struct laz_time *time, uint64_t first);

LAZ_CODES bool laz_time_fits(const struct laz_time *time, unsigned sequence, uint64_t value) {
    uint64_t step = value - time->last[sequence];
    return step == (uint64_t)(int64_t)(int32_t)(uint32_t)step;
}

/* The other sequence that the value goes on, as how many further, 1 to 3; 0: none. */
LAZ_CODES unsigned laz_time_other(const struct laz_time *time, uint64_t value) {
    for (unsigned i = 1; i < 4; i++)
        if (laz_time_fits(time, (time->now + i) & 3, value)) return i;
    return 0;
}

LAZ_CODES void laz_code_time_anew(struct laz_coder *coder, struct laz_time *time, uint64_t value, const bool write) {
    uint32_t upper = laz_code_integer(coder, &time->step, (uint32_t)(time->last[time->now] >> 32), 8,
                                      (uint32_t)(value >> 32), write);
    time->now = time->newest = (time->newest + 1) & 3;
    time->last[time->now] = (uint64_t)upper << 32 | laz_code_raw(coder, 32, (uint32_t)value, write);
    time->last_step[time->now] = 0;
    time->extremes[time->now] = 0;
}

/* How often the step before it the step is, rounded. */
LAZ_CODES int32_t laz_time_multiple(uint32_t step, uint32_t last_step) {
    float ratio = (float)(int32_t)step / (float)(int32_t)last_step;
    if (ratio >= LAZ_TIME_MOST) return LAZ_TIME_MOST;
    if (ratio <= LAZ_TIME_LEAST) return LAZ_TIME_LEAST;
    return (int32_t)(ratio >= 0 ? ratio + 0.5f : ratio - 0.5f);
}

/* A step of the present sequence that is about `multiple` times the last one. */
LAZ_CODES void laz_code_time_step(struct laz_coder *coder, struct laz_time *time, int32_t multiple, uint64_t value,
                                  const bool write) {
    unsigned now = time->now;
    bool extreme = multiple == 0 || multiple == LAZ_TIME_MOST || multiple == LAZ_TIME_LEAST;
    size_t context = multiple == 1                ? 1
                     : multiple == 0              ? 7
                     : multiple == LAZ_TIME_MOST  ? 4
                     : multiple == LAZ_TIME_LEAST ? 6
                     : multiple < 0               ? 5
                     : multiple < 10              ? 2
                                                  : 3;
    uint32_t step = laz_code_integer(coder, &time->step, (uint32_t)multiple * time->last_step[now], context,
                                     (uint32_t)(value - time->last[now]), write);
    time->last[now] += (uint64_t)(int64_t)(int32_t)step;
    if (multiple == 1) time->extremes[now] = 0;
    if (extreme && ++time->extremes[now] > 3) {
        time->last_step[now] = step;
        time->extremes[now] = 0;
    }
}

/* tells_same: item 7.  Returns the time, as its bits. */
LAZ_CODES uint64_t laz_code_time(struct laz_coder *coder, struct laz_time *time, uint64_t value, const bool tells_same,
                                 const bool write) {
    const uint32_t same_first = 0, near_first = tells_same ? 1 : 0, anew_first = near_first + 1;
    const uint32_t same = LAZ_TIME_MOST - LAZ_TIME_LEAST + 1, anew = tells_same ? same + 1 : same;
    for (int switches = 0; switches < 4; switches++) {
        unsigned now = time->now, other = 0;
        bool fits = true, begins = time->last_step[now] == 0;
        uint32_t symbol = 0;
        if (write) {
            fits = laz_time_fits(time, now, value);
            other = fits ? 0 : laz_time_other(time, value);
        }
        if (begins) {
            if (write) symbol = fits ? near_first : anew_first + other;
            if (write && tells_same && value == time->last[now]) symbol = same_first;
            symbol = laz_code_symbol(coder, &time->first_step, symbol, write);
            if (tells_same && symbol == same_first) return time->last[now];
            if (symbol == near_first) {
                uint32_t step = laz_code_integer(coder, &time->step, 0, 0, (uint32_t)(value - time->last[now]), write);
                time->last_step[now] = step;
                time->extremes[now] = 0;
                return time->last[now] += (uint64_t)(int64_t)(int32_t)step;
            }
            other = symbol - anew_first;
        } else {
            if (write) {
                int32_t multiple = laz_time_multiple((uint32_t)(value - time->last[now]), time->last_step[now]);
                symbol = !fits          ? anew + other
                         : multiple < 0 ? (uint32_t)(LAZ_TIME_MOST - multiple)
                                        : (uint32_t)multiple;
                if (tells_same && value == time->last[now]) symbol = same;
            }
            symbol = laz_code_symbol(coder, &time->multiple, symbol, write);
            if (tells_same && symbol == same) return time->last[now];
            if (symbol < anew) {
                int32_t multiple = symbol <= LAZ_TIME_MOST ? (int32_t)symbol : LAZ_TIME_MOST - (int32_t)symbol;
                laz_code_time_step(coder, time, multiple, value, write);
                return time->last[now];
            }
            other = symbol - anew;
        }
        if (other == 0) {
            laz_code_time_anew(coder, time, value, write);
            return time->last[time->now];
        }
        time->now = (now + other) & 3;
    }
    coder->broken = true; /* no writer goes on with another sequence twice */
    return time->last[time->now];
}

#endif
