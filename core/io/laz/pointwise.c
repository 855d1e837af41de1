/* Items of points that stand one after the other: formats 0 to 5.
 *
 * Each item is predicted from the last point.  X and Y: the median of recent steps among points of the same kind of
 * return (its number and how many there were); Z: the last one of the same level of returns.  What seldom changes is
 * told by one symbol, of which attributes changed.
 *
 * Version 1 of the items is that of files before 2011; it is read, and written for tests alone.
 *
 * SPDX-License-Identifier: GPL-3.0-or-later */
#include <stdlib.h>
#include <string.h>

#include "core/base/alloc.h"
#include "core/io/laz/items.h"

/* By number of returns and number of the return: the kind, and how many more returns there are, or were before. */
static const uint8_t return_kind[8][8] = {
    {15, 14, 13, 12, 11, 10, 9, 8},  {14, 0, 1, 3, 6, 10, 10, 9},    {13, 1, 2, 4, 7, 11, 11, 10},
    {12, 3, 4, 5, 8, 12, 12, 11},    {11, 6, 7, 8, 9, 13, 13, 12},   {10, 10, 11, 12, 13, 14, 14, 13},
    {9, 10, 11, 12, 13, 14, 15, 14}, {8, 9, 10, 11, 12, 13, 14, 15},
};

enum { POINT_BYTES = 20, KINDS = 16, LEVELS = 8, Y_CONTEXT = 20, Z_CONTEXT = 18, OLD_CONTEXT = 19 };

struct point10 {
    struct laz_model changed, angle[2], returns[256], class[256], user[256];
    struct laz_integer intensity, source, dx, dy, z, old_angle;
    unsigned char last[POINT_BYTES];
    uint32_t last_intensity[KINDS], last_z[LEVELS];
    struct laz_median step_x[KINDS], step_y[KINDS];
    int32_t old_x[3], old_y[3]; /* version 1: the last steps, and which is replaced next */
    unsigned oldest;
};

/* Version 1 of the others. */
struct old_time {
    struct laz_model first_step, multiple;
    struct laz_integer step;
    uint64_t last;
    uint32_t last_step;
    unsigned extremes;
};

struct old_rgb {
    struct laz_model used;
    struct laz_integer byte;
};

struct laz_pointwise {
    struct laz_layout layout;
    struct point10 point;
    struct laz_time time;
    struct old_time old_time;
    struct laz_rgb rgb;
    struct old_rgb old_rgb;
    struct laz_wave wave;
    uint16_t last_colour[3];
    size_t extra;                /* bytes */
    unsigned char *last_byte;    /* extra */
    struct laz_model *byte;      /* extra */
    struct laz_integer old_byte; /* version 1: a context for each */
    uint16_t *data;              /* of all models */
};

/* ------------------------------------------------------------------------------------------------ POINT10 */

/* Bits of the symbol that tells what changed. */
enum { RETURNS = 32, INTENSITY = 16, CLASS = 8, ANGLE = 4, USER = 2, SOURCE = 1 };

static uint32_t pointwise_changes_of(const struct point10 *p, const unsigned char *item, uint32_t last_intensity) {
    const unsigned char *last = p->last;
    return (item[14] != last[14] ? RETURNS : 0) | (laz_load16(item + 12) != last_intensity ? INTENSITY : 0) |
           (item[15] != last[15] ? CLASS : 0) | (item[16] != last[16] ? ANGLE : 0) | (item[17] != last[17] ? USER : 0) |
           (laz_load16(item + 18) != laz_load16(last + 18) ? SOURCE : 0);
}

static inline size_t kind_of(unsigned returns) { return return_kind[returns >> 3 & 7][returns & 7]; }

LAZ_CODES void code_point10(struct laz_coder *coder, struct point10 *p, unsigned char *item, const bool write) {
    unsigned char *last = p->last;
    uint32_t changed = write ? pointwise_changes_of(p, item, p->last_intensity[kind_of(item[14])]) : 0;
    changed = laz_code_symbol(coder, &p->changed, changed, write);
    if (changed & RETURNS) last[14] = (unsigned char)laz_code_symbol(coder, &p->returns[last[14]], item[14], write);
    unsigned number = last[14] & 7, of = last[14] >> 3 & 7, level = number > of ? number - of : of - number;
    size_t kind = return_kind[of][number], single = of == 1;
    if (changed & INTENSITY)
        p->last_intensity[kind] = laz_code_integer(coder, &p->intensity, p->last_intensity[kind], kind < 3 ? kind : 3,
                                                   laz_load16(item + 12), write);
    laz_store16(last + 12, p->last_intensity[kind]);
    if (changed & CLASS) last[15] = (unsigned char)laz_code_symbol(coder, &p->class[last[15]], item[15], write);
    if (changed & ANGLE)
        last[16] = (unsigned char)laz_code_byte(coder, &p->angle[last[14] >> 6 & 1], last[16], item[16], write);
    if (changed & USER) last[17] = (unsigned char)laz_code_symbol(coder, &p->user[last[17]], item[17], write);
    if (changed & SOURCE)
        laz_store16(last + 18,
                    laz_code_integer(coder, &p->source, laz_load16(last + 18), 0, laz_load16(item + 18), write));

    uint32_t x = laz_load32(last), y = laz_load32(last + 4), z = write ? laz_load32(item + 8) : 0;
    uint32_t step = laz_code_integer(coder, &p->dx, (uint32_t)p->step_x[kind].value[2], single,
                                     write ? laz_load32(item) - x : 0, write);
    laz_median_add(&p->step_x[kind], (int32_t)step);
    laz_store32(last, x + step);
    step = laz_code_integer(coder, &p->dy, (uint32_t)p->step_y[kind].value[2],
                            single + laz_size_context(p->dx.k, Y_CONTEXT), write ? laz_load32(item + 4) - y : 0, write);
    laz_median_add(&p->step_y[kind], (int32_t)step);
    laz_store32(last + 4, y + step);
    z = laz_code_integer(coder, &p->z, p->last_z[level], single + laz_size_context((p->dx.k + p->dy.k) / 2, Z_CONTEXT),
                         z, write);
    p->last_z[level] = z;
    laz_store32(last + 8, z);
    if (!write) memcpy(item, last, POINT_BYTES);
}

/* ------------------------------------------------------------------------------------------------ version 1 */

static uint32_t middle_of(const int32_t v[3]) {
    int32_t low = v[0] < v[1] ? v[0] : v[1], high = v[0] < v[1] ? v[1] : v[0];
    return (uint32_t)(v[2] < low ? low : v[2] > high ? high : v[2]);
}

LAZ_CODES void code_old_point10(struct laz_coder *coder, struct point10 *p, unsigned char *item, const bool write) {
    enum { OLD_INTENSITY = 32, OLD_RETURNS = 16 };
    unsigned char *last = p->last;
    uint32_t x = laz_load32(last), y = laz_load32(last + 4), changed = 0;
    uint32_t step_x = laz_code_integer(coder, &p->dx, middle_of(p->old_x), 0, write ? laz_load32(item) - x : 0, write);
    uint32_t k = p->dx.k;
    uint32_t step_y = laz_code_integer(coder, &p->dy, middle_of(p->old_y), k < OLD_CONTEXT ? k : OLD_CONTEXT,
                                       write ? laz_load32(item + 4) - y : 0, write);
    k = (p->dx.k + p->dy.k) / 2;
    uint32_t z = laz_code_integer(coder, &p->z, laz_load32(last + 8), k < OLD_CONTEXT ? k : OLD_CONTEXT,
                                  write ? laz_load32(item + 8) : 0, write);
    if (write) {
        changed = pointwise_changes_of(p, item, laz_load16(last + 12));
        changed = (changed & INTENSITY) << 1 | (changed & RETURNS) >> 1 | (changed & (CLASS | ANGLE | USER | SOURCE));
    }
    changed = laz_code_symbol(coder, &p->changed, changed, write);
    if (changed & OLD_INTENSITY)
        laz_store16(last + 12,
                    laz_code_integer(coder, &p->intensity, laz_load16(last + 12), 0, laz_load16(item + 12), write));
    if (changed & OLD_RETURNS) last[14] = (unsigned char)laz_code_symbol(coder, &p->returns[last[14]], item[14], write);
    if (changed & CLASS) last[15] = (unsigned char)laz_code_symbol(coder, &p->class[last[15]], item[15], write);
    if (changed & ANGLE)
        last[16] = (unsigned char)laz_code_integer(coder, &p->old_angle, last[16], k < 3, item[16], write);
    if (changed & USER) last[17] = (unsigned char)laz_code_symbol(coder, &p->user[last[17]], item[17], write);
    if (changed & SOURCE)
        laz_store16(last + 18,
                    laz_code_integer(coder, &p->source, laz_load16(last + 18), 0, laz_load16(item + 18), write));
    p->old_x[p->oldest] = (int32_t)step_x;
    p->old_y[p->oldest] = (int32_t)step_y;
    p->oldest = (p->oldest + 1) % 3;
    laz_store32(last, x + step_x);
    laz_store32(last + 4, y + step_y);
    laz_store32(last + 8, z);
    if (!write) memcpy(item, last, POINT_BYTES);
}

LAZ_CODES uint64_t code_old_time(struct laz_coder *coder, struct old_time *t, uint64_t value, const bool write) {
    enum { MOST = 509, ANEW = 510, SAME = 511 }; /* multiples are below */
    bool begins = t->last_step == 0;
    uint64_t wide = value - t->last;
    uint32_t step = (uint32_t)wide, symbol = 0;
    bool fits = wide == (uint64_t)(int64_t)(int32_t)step;
    if (begins) {
        if (write) symbol = wide == 0 ? 0 : fits ? 1 : 2;
        symbol = laz_code_symbol(coder, &t->first_step, symbol, write);
        if (symbol == 1) {
            t->last_step = laz_code_integer(coder, &t->step, 0, 0, step, write);
            t->last += (uint64_t)(int64_t)(int32_t)t->last_step;
        } else if (symbol == 2) {
            t->last = laz_code_raw64(coder, value, write);
        }
        return t->last;
    }
    if (write) {
        float ratio = (float)(int32_t)step / (float)(int32_t)t->last_step;
        symbol = ratio >= MOST ? MOST : ratio < 0.5f ? 0 : (uint32_t)(ratio + 0.5f);
        if (!fits) symbol = ANEW;
        if (wide == 0) symbol = SAME;
    }
    symbol = laz_code_symbol(coder, &t->multiple, symbol, write);
    if (symbol == ANEW) t->last = laz_code_raw64(coder, value, write);
    if (symbol >= ANEW) return t->last;
    size_t context = symbol == 1 ? 1 : symbol == 0 ? 2 : symbol < 10 ? 3 : symbol < 50 ? 4 : 5;
    uint32_t predicted = symbol ? symbol * t->last_step : (uint32_t)((int32_t)t->last_step / 4);
    step = laz_code_integer(coder, &t->step, predicted, context, step, write);
    bool extreme = symbol == 0 || symbol == MOST;
    if (symbol == 1 || (extreme && ++t->extremes > 3)) {
        t->last_step = step;
        t->extremes = 0;
    }
    return t->last += (uint64_t)(int64_t)(int32_t)step;
}

LAZ_CODES void code_old_rgb(struct laz_coder *coder, struct old_rgb *rgb, const uint16_t last[3], uint16_t colour[3],
                            const bool write) {
    uint32_t used = 0, now[3] = {0};
    for (unsigned i = 0; write && i < 6; i++)
        used |= (uint32_t)(laz_colour_byte(colour, i) != laz_colour_byte(last, i)) << i;
    used = laz_code_symbol(coder, &rgb->used, used, write);
    for (unsigned i = 0; i < 6; i++) {
        unsigned shift = 8 * (i % 2);
        uint32_t byte = laz_colour_byte(last, i);
        if (used >> i & 1)
            byte = laz_code_integer(coder, &rgb->byte, byte, i, write ? laz_colour_byte(colour, i) : 0, write);
        now[i / 2] |= byte << shift;
    }
    for (unsigned i = 0; i < 3; i++) colour[i] = (uint16_t)now[i];
}

/* ------------------------------------------------------------------------------------------------ a point */

LAZ_CODES void code_colour(struct laz_coder *coder, struct laz_pointwise *p, unsigned version, unsigned char *item,
                           const bool write) {
    uint16_t colour[3];
    for (size_t i = 0; i < 3; i++) colour[i] = (uint16_t)laz_load16(item + 2 * i);
    if (version == 1)
        code_old_rgb(coder, &p->old_rgb, p->last_colour, colour, write);
    else
        laz_code_rgb(coder, &p->rgb, p->last_colour, colour, write);
    for (size_t i = 0; i < 3; i++) p->last_colour[i] = colour[i];
    for (size_t i = 0; !write && i < 3; i++) laz_store16(item + 2 * i, colour[i]);
}

LAZ_CODES void code_extra(struct laz_coder *coder, struct laz_pointwise *p, unsigned version, unsigned char *item,
                          const bool write) {
    for (size_t i = 0; i < p->extra; i++) {
        if (version == 1)
            p->last_byte[i] = (unsigned char)laz_code_integer(coder, &p->old_byte, p->last_byte[i], i, item[i], write);
        else
            p->last_byte[i] = (unsigned char)laz_code_byte(coder, &p->byte[i], p->last_byte[i], item[i], write);
        if (!write) item[i] = p->last_byte[i];
    }
}

LAZ_CODES void code_point(struct laz_pointwise *p, struct laz_coder *coder, unsigned char *record, const bool write) {
    for (size_t i = 0; i < p->layout.item_count; i++) {
        unsigned version = p->layout.item[i].version;
        unsigned char *item = record + p->layout.item[i].offset;
        uint64_t time = 0;
        switch (p->layout.item[i].type) {
        case LAZ_POINT10:
            if (version == 1)
                code_old_point10(coder, &p->point, item, write);
            else
                code_point10(coder, &p->point, item, write);
            break;
        case LAZ_TIME11:
            time = write ? laz_load64(item) : 0;
            time = version == 1 ? code_old_time(coder, &p->old_time, time, write)
                                : laz_code_time(coder, &p->time, time, true, write);
            if (!write) laz_store64(item, time);
            break;
        case LAZ_RGB12: code_colour(coder, p, version, item, write); break;
        case LAZ_WAVE13:
            laz_code_wave(coder, &p->wave, p->wave.last, item, write);
            memcpy(p->wave.last, item, LAZ_WAVE_BYTES);
            break;
        default: code_extra(coder, p, version, item, write); break;
        }
    }
}

void laz_pointwise_read(struct laz_pointwise *pointwise, struct laz_coder *coder, unsigned char *record) {
    code_point(pointwise, coder, record, false);
}

void laz_pointwise_write(struct laz_pointwise *pointwise, struct laz_coder *coder, const unsigned char *record) {
    unsigned char copy[LAZ_RECORD_MOST];
    memcpy(copy, record, pointwise->layout.record_bytes);
    code_point(pointwise, coder, copy, true);
}

/* ------------------------------------------------------------------------------------------------ models */

static void lay_point10(struct point10 *p, bool is_old, struct laz_room *room) {
    laz_model_lay(&p->changed, 64, room);
    laz_models_lay(p->angle, 2, 256, room);
    laz_models_lay(p->returns, 256, 256, room);
    laz_models_lay(p->class, 256, 256, room);
    laz_models_lay(p->user, 256, 256, room);
    laz_integer_lay(&p->intensity, 16, 4, room);
    laz_integer_lay(&p->source, 16, 1, room);
    laz_integer_lay(&p->dx, 32, 2, room);
    laz_integer_lay(&p->dy, 32, 22, room);
    laz_integer_lay(&p->z, 32, 20, room);
    if (is_old) laz_integer_lay(&p->old_angle, 8, 2, room);
}

static void lay_pointwise(struct laz_pointwise *p, struct laz_room *room) {
    for (size_t i = 0; i < p->layout.item_count; i++) {
        bool is_old = p->layout.item[i].version == 1;
        switch (p->layout.item[i].type) {
        case LAZ_POINT10: lay_point10(&p->point, is_old, room); break;
        case LAZ_TIME11:
            laz_time_lay(&p->time, true, room);
            laz_model_lay(&p->old_time.first_step, 3, room);
            laz_model_lay(&p->old_time.multiple, 512, room);
            laz_integer_lay(&p->old_time.step, 32, 6, room);
            break;
        case LAZ_RGB12:
            laz_rgb_lay(&p->rgb, room);
            laz_model_lay(&p->old_rgb.used, 64, room);
            laz_integer_lay(&p->old_rgb.byte, 8, 6, room);
            break;
        case LAZ_WAVE13: laz_wave_lay(&p->wave, room); break;
        default:
            if (is_old)
                laz_integer_lay(&p->old_byte, 8, p->extra, room);
            else
                laz_models_lay(p->byte, p->extra, 256, room);
        }
    }
}

struct laz_pointwise *laz_pointwise_new(const struct laz_layout *layout) {
    struct laz_pointwise *p = alloc_zeroed(1, sizeof *p);
    struct laz_room room = {0};
    if (!p) return NULL;
    p->layout = *layout;
    const struct laz_item *last = &layout->item[layout->item_count - 1];
    p->extra = last->type == LAZ_BYTES ? last->bytes : 0;
    p->last_byte = alloc_array(p->extra, 1);
    p->byte = alloc_array(p->extra, sizeof *p->byte);
    if (p->byte) lay_pointwise(p, &room);
    room.data = alloc_array(room.used, sizeof *room.data);
    room.used = 0;
    p->data = room.data;
    if (p->last_byte && p->byte && p->data) {
        lay_pointwise(p, &room);
        return p;
    }
    laz_pointwise_free(p);
    return NULL;
}

void laz_pointwise_free(struct laz_pointwise *pointwise) {
    if (!pointwise) return;
    free(pointwise->last_byte), free(pointwise->byte), free(pointwise->data);
    free(pointwise);
}

static void begin_point10(struct point10 *p, const unsigned char *first, bool is_old) {
    laz_models_begin(&p->changed, 1);
    laz_models_begin(p->angle, 2);
    laz_models_begin(p->returns, 256);
    laz_models_begin(p->class, 256);
    laz_models_begin(p->user, 256);
    struct laz_integer *integers[] = {&p->intensity, &p->source, &p->dx, &p->dy, &p->z};
    for (size_t i = 0; i < sizeof integers / sizeof *integers; i++) laz_integer_begin(integers[i]);
    if (is_old) laz_integer_begin(&p->old_angle);
    memset(p->last_intensity, 0, sizeof p->last_intensity);
    memset(p->last_z, 0, sizeof p->last_z);
    memset(p->step_x, 0, sizeof p->step_x);
    memset(p->step_y, 0, sizeof p->step_y);
    memset(p->old_x, 0, sizeof p->old_x);
    memset(p->old_y, 0, sizeof p->old_y);
    p->oldest = 0;
    memcpy(p->last, first, POINT_BYTES);
}

static void begin_old(struct laz_pointwise *p) {
    laz_models_begin(&p->old_time.first_step, 1);
    laz_models_begin(&p->old_time.multiple, 1);
    if (p->old_time.step.bits) laz_integer_begin(&p->old_time.step);
    p->old_time.last_step = p->old_time.extremes = 0;
    laz_models_begin(&p->old_rgb.used, 1);
    if (p->old_rgb.byte.bits) laz_integer_begin(&p->old_rgb.byte);
    if (p->old_byte.bits) laz_integer_begin(&p->old_byte);
}

void laz_pointwise_begin(struct laz_pointwise *p, const unsigned char *first) {
    begin_old(p);
    for (size_t i = 0; i < p->layout.item_count; i++) {
        const unsigned char *item = first + p->layout.item[i].offset;
        switch (p->layout.item[i].type) {
        case LAZ_POINT10: begin_point10(&p->point, item, p->layout.item[i].version == 1); break;
        case LAZ_TIME11:
            laz_time_begin(&p->time, laz_load64(item));
            p->old_time.last = laz_load64(item);
            break;
        case LAZ_RGB12:
            laz_rgb_begin(&p->rgb);
            for (size_t k = 0; k < 3; k++) p->last_colour[k] = (uint16_t)laz_load16(item + 2 * k);
            break;
        case LAZ_WAVE13: laz_wave_begin(&p->wave, item); break;
        default: laz_models_begin(p->byte, p->extra); memcpy(p->last_byte, item, p->extra);
        }
    }
}
